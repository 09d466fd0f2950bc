"""Moving straight towards a point, as far as free cells go, and sliding along what is there."""

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.cells import check_positions
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.places.sight import NO_ROOMS
from navbake.types import Float

# Functions import kernels when they run: numba takes long to load.

FARTHEST = 1e6  # metres


def try_step(
    flat: FlatGrid, start: ArrayLike, end: ArrayLike, slide: bool = True, level: int | None = None
) -> Float:
    """`PathFinder.try_step`."""
    from navbake.runtime.kernels.arrays import Space, put_into  # saves numba at start-up
    from navbake.runtime.kernels.crossing import walk_line
    from navbake.runtime.kernels.slide import slide as slide_along

    p, cell = flat.free_cell_at(start, level)
    q = check_positions(end, flat.num_levels, 0)  # wherever the way leads, its level follows
    if q.ndim != 1:
        raise QueryError(f"expected one end, got an array of shape {q.shape}")
    p = p[:2]
    q = within_reach(p, q[:2])
    space = Space(flat.layout, flat.links, flat.floors, flat.free)
    cell, share = walk_line(space, NO_ROOMS, cell, *p, *q)
    x, y = put_into(flat.layout, cell, *(p + share * (q - p)))
    if share < 1.0 and slide:
        cell, x, y = slide_along(space, cell, x, y, *q)
    return np.array([x, y, flat.positions(cell)[2]])


def within_reach(p: Float, q: Float) -> Float:
    """Ends q moved towards p where they are beyond all grids: no cells are counted up to there."""
    way = q - p
    farthest = np.abs(way).max(axis=-1, keepdims=True)
    return np.where(farthest > FARTHEST, p + way * (FARTHEST / np.maximum(farthest, FARTHEST)), q)
