"""What stands between two positions."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.navgrid.cells import check_positions
from navbake.types import Bool, Int32

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.flat_grid import FlatGrid


class Sight(NamedTuple):
    """What lines of sight depend on, by flat id.

    Attributes:
        clear: where nothing stands, shape (n,), bool.
        room: number of the room, 0 for none, shape (n,), int32.
    """

    clear: Bool
    room: Int32


NO_ROOMS = np.empty(0, dtype=np.int32)


def find_occupied(grid: NavGrid) -> Bool:
    """Where something stands or there is no floor, by flat id, shape (n,), bool.

    In a file without ``occupancy``, where weights are infinite. What a larger radius takes from
    an agent is not occupied.
    """
    return np.concatenate([level.occupancy.ravel() != 0 for level in grid.levels])


def line_of_sight(
    flat: FlatGrid, clear: Bool, a: ArrayLike, b: ArrayLike, level: int | None = None
) -> bool:
    """`PathFinder.line_of_sight`, through the cells of a mask, by flat id."""
    ends = [check_positions(p, flat.num_levels, level) for p in (a, b)]
    cells = [flat.cell_at(p, level) for p in ends]
    if cells[0] is None or cells[1] is None:
        return False
    from navbake.runtime.kernels.crossing import is_in_sight  # saves numba at start-up

    (x0, y0), (x1, y1) = (p[:2] for p in ends)
    space = flat.sight_through(clear)
    return bool(is_in_sight(space, NO_ROOMS, cells[0], x0, y0, cells[1], x1, y1))
