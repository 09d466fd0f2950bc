"""Whether an agent can stand at positions."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.navgrid.cells import check_positions
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.places.checks import check_distance
from navbake.types import Bool

MAX_DROP = 0.5  # metres


def is_navigable(
    flat: FlatGrid, positions: ArrayLike, level: int | None = None, max_drop: float = MAX_DROP
) -> Bool:
    """`PathFinder.is_navigable` of each of many positions, shape (...)."""
    check_distance(max_drop, "max_drop")
    p: NDArray[Any] = positions if isinstance(positions, np.ndarray) else np.empty(0)
    if level is not None or p.dtype != np.float64 or p.ndim != 2 or p.shape[1] != 3:
        p = check_positions(positions, flat.num_levels, level)
    if level is not None or p.shape[-1] == 2:
        cells = flat.cells_at(p, level)
        return np.asarray((cells >= 0) & flat.free[cells])
    from navbake.runtime.kernels.locate import stand_on  # saves numba at start-up

    points = np.ascontiguousarray(p.reshape(-1, 3))
    answers, bad = stand_on(flat.layout, flat.floors, flat.free, float(max_drop), points)
    if bad >= 0:
        check_positions(points[bad], flat.num_levels)  # says what is wrong with it
    found: Bool = answers.reshape(p.shape[:-1])
    return found
