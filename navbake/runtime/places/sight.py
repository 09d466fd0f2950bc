"""What stands between two positions."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.navgrid.cells import check_positions
from navbake.runtime.places.locate import flat_cell, links_of, place_of

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.flat_grid import Walk


class Sight(NamedTuple):
    """What lines of sight depend on, by flat id.

    Attributes:
        clear: where nothing stands, shape (n,), bool.
        room: number of the room, 0 for none, shape (n,), int32.
    """

    clear: NDArray[np.bool_]
    room: NDArray[np.int32]


NO_ROOMS = np.empty(0, dtype=np.int32)


def find_occupied(grid: NavGrid) -> NDArray[np.bool_]:
    """Where something stands or there is no floor, by flat id, shape (n,), bool.

    In a file without ``occupancy``, where weights are infinite. What a larger radius takes from
    an agent is not occupied.
    """
    return np.concatenate([level.occupancy.ravel() != 0 for level in grid.levels])


def line_of_sight(
    walk: Walk, clear: NDArray[np.bool_], a: ArrayLike, b: ArrayLike, level: int | None = None
) -> bool:
    """Tell whether the straight line between two positions meets nothing that is occupied.

    The line runs over the map, from cell to cell, and through a corner of four where one of the
    two beside it is clear. It changes levels where links lead; heights don't count else.

    Args:
        walk: the grid.
        clear: where nothing stands, by flat id, shape (n,), bool.
        a, b: world x, y, z [m]; x, y will do on one level.
        level: which level both are on, if given; then z does not count.

    Returns:
        False also where one of the two is beside the grid, or in something itself.

    Raises:
        QueryError: there is no such level, or a position is none.
    """
    ends = [check_positions(p, walk.num_levels, level) for p in (a, b)]
    cells = [flat_cell(walk, p, level) for p in ends]
    if cells[0] is None or cells[1] is None:
        return False
    from navbake.runtime.kernels.crossing import is_in_sight

    from_xy, to_xy = (ends[0][0], ends[0][1]), (ends[1][0], ends[1][1])
    seen = is_in_sight(
        place_of(walk), links_of(walk), clear, walk.floor, NO_ROOMS,
        cells[0], *from_xy, cells[1], *to_xy,
    )  # fmt: skip
    return bool(seen)
