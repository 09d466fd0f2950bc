"""Moving straight towards a point, as far as free cells go, and sliding along what is there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import check_positions
from navbake.runtime.places.locate import flat_cell, links_of, place_of

if TYPE_CHECKING:
    from navbake.runtime.flat_grid import Walk

FARTHEST = 1e6  # metres
NO_ROOMS = np.empty(0, dtype=np.int32)


def try_step(
    walk: Walk, start: ArrayLike, end: ArrayLike, *, slide: bool = True, level: int | None = None
) -> NDArray[np.float64]:
    """Move straight from a position towards another, and stop where cells are not free.

    The way runs over the map from cell to cell, over the edge that it meets, so no wall is too
    thin for it. Steps are at most `traversable_floor_height` high; links lead to other levels.

    Sliding goes on from where the straight way ends, to the point that is the nearest to the end
    among those that a walk leads to which is no longer than what is left of the way. So it also
    gets along walls that are not parallel to the cells.

    A way may end anywhere in a free cell, so up to half a cell nearer to obstacles than at its
    centre.

    Args:
        walk: the grid.
        start: world x, y, z [m], where an agent can stand; x, y will do on one level.
        end: world x, y, z [m]; its z does not count.
        slide: whether to slide.
        level: which level the start is on; then z does not count.

    Returns:
        World x, y and floor z [m] of where the way ends, shape (3,), float64.

    Raises:
        QueryError: there is no such level, a position is none, or no agent can stand at the
            start.
    """
    p = check_positions(start, walk.num_levels, level)
    q = check_positions(end, walk.num_levels, 0)  # wherever the way leads, its level follows
    if q.ndim != 1:
        raise QueryError(f"expected one end, got an array of shape {q.shape}")
    home = flat_cell(walk, p, level)
    if home is None or not walk.free[home]:
        where = ", ".join(f"{v:g}" for v in p)
        raise QueryError(f"no agent can stand at {where}: snap it to the nearest place first")
    way = q[:2] - p[:2]
    farthest = float(np.abs(way).max())
    if farthest > FARTHEST:  # beyond all grids, so no need to count cells up to there
        q = p[:2] + way * (FARTHEST / farthest)
    return _move(walk, home, p[:2], q[:2], slide)


def _move(
    walk: Walk, cell: int, p: NDArray[np.float64], q: NDArray[np.float64], slides: bool
) -> NDArray[np.float64]:
    from navbake.runtime.kernels.crossing import put_into, walk_line
    from navbake.runtime.kernels.slide import slide

    place, steps = place_of(walk), (links_of(walk), walk.free, walk.floor, walk.max_step)
    cell, share = walk_line(place, *steps, NO_ROOMS, cell, *p, *q)
    x, y = put_into(place, cell, *(p + share * (q - p)))
    if share < 1.0 and slides:
        cell, x, y = slide(place, *steps, cell, x, y, *q)
    return np.array([x, y, walk.positions(np.array(cell))[2]])
