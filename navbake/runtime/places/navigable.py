"""Whether an agent can stand at positions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.navgrid.cells import check_positions
from navbake.runtime.places.locate import flat_cells, place_of
from navbake.runtime.places.sample import check_distance

if TYPE_CHECKING:
    from navbake.runtime.flat_grid import Walk

MAX_DROP = 0.5  # metres


def is_navigable(
    walk: Walk, positions: ArrayLike, level: int | None = None, max_drop: float = MAX_DROP
) -> NDArray[np.bool_]:
    """Tell whether an agent can stand at positions.

    It can where the cell is free, and the floor is at most `max_drop` below the position. Which
    cell it is, `navbake.runtime.places.locate.cell_at` tells.

    Args:
        walk: the grid.
        positions: world x, y, z [m], shape (..., 3); (..., 2) will do on one level.
        level: which level all are on, if given; then z does not count.
        max_drop: [m], >= 0.

    Returns:
        Shape (...), bool; False beside the grid.

    Raises:
        QueryError: there is no such level, a position is none, or `max_drop` is.
    """
    check_distance(max_drop, "max_drop")
    p: NDArray[Any] = positions if isinstance(positions, np.ndarray) else np.empty(0)
    if level is not None or p.dtype != np.float64 or p.ndim != 2 or p.shape[1] != 3:
        p = check_positions(positions, walk.num_levels, level)
    if level is not None or p.shape[-1] == 2:
        cells = flat_cells(walk, p, level)
        return np.asarray((cells >= 0) & walk.free[cells])
    from navbake.runtime.kernels.locate import stand_on

    flat = np.ascontiguousarray(p.reshape(-1, 3))
    answers, bad = stand_on(
        place_of(walk), walk.ground, walk.floor, walk.max_step, walk.free, float(max_drop), flat
    )
    if bad >= 0:
        check_positions(flat[bad], walk.num_levels)  # says what is wrong with it
    found: NDArray[np.bool_] = answers.reshape(p.shape[:-1])
    return found
