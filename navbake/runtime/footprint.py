"""Where an agent that isn't round can stand, heading by heading.

As with a disc, the polygon must not meet the square of an occupied cell; floors more than a step
higher or lower and the cells of other levels count as in `navbake.runtime.surroundings`.
Touching is not meeting. A floor is needed under the agent's origin only.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.polygon import find_fault
from navbake.runtime.inflation import check_ledges
from navbake.runtime.surroundings import block_by_others, find_surroundings
from navbake.types import Bool, Float, Int

kernels = lazy("navbake.runtime.kernels.inflation")  # numba loads slowly

MAX_HEADINGS = 720
MAX_REACH = 1000  # [cells]
TOUCH = 1e-9  # [cells] by which a polygon may overlap a square that it touches


def inflate_footprint(
    grid: NavGrid, polygon: ArrayLike, num_headings: int = 16, *, ledges: str = "avoid"
) -> list[Bool]:
    """Where an agent that isn't round can stand, heading by heading.

    Args:
        polygon: its outline from above, shape (n, 2), n >= 3, in its own frame [m]: x ahead,
            y to the left, its centre at the origin. Without crossings.
        num_headings: how many headings; number k looks along ``2 π k / num_headings``,
            counter-clockwise from the world's x.
        ledges: as of `inflate`.

    Returns:
        For each level, shape (num_headings, height, width), bool: whether the cell is free
        and the polygon, its origin on the cell's centre, meets no occupied cell's square;
        see the module.

    Raises:
        QueryError: the polygon is none, or there is no heading.
    """
    outline = _check_polygon(polygon)
    check_ledges(ledges)
    if not isinstance(num_headings, int | np.integer) or not 1 <= num_headings <= MAX_HEADINGS:
        raise QueryError(f"expected 1 to {MAX_HEADINGS} headings, got {num_headings!r}")
    masks = []
    for number, level in enumerate(grid.levels):
        radius = float(np.hypot(*outline.T).max())
        reach = math.ceil(radius / level.lattice.cell_size) + 1
        if reach > MAX_REACH:
            raise QueryError(f"expected a polygon within {MAX_REACH} cells, got one of {reach}")
        storeys, inside = find_surroundings(grid, number, reach)
        free = np.empty((num_headings, *level.shape), dtype=np.bool_)
        for k in range(num_headings):
            turned = _turn(outline / level.lattice.cell_size, 2 * math.pi * k / num_headings)
            offsets = _footprint_offsets(turned)
            blocked = kernels.meets_runs(storeys.occupied[storeys.level], _to_runs(offsets))
            block_by_others(grid, number, storeys, radius, offsets, ledges, blocked)
            free[k] = level.free_for_point & ~blocked[inside]
        masks.append(free)
    return masks


def _footprint_offsets(outline: Float) -> Int:
    """Steps (row, col) from a cell to those whose squares a polygon on its centre meets.

    A polygon [cells] meets a square where an edge runs through the square's inside, or where the
    square's centre is within the polygon. Sorted by row, then column.
    """
    x, y = outline[:, 0], -outline[:, 1]  # rows run against y
    low, high = math.floor(min(y.min(), 0) - 0.5), math.ceil(max(y.max(), 0) + 0.5)
    left, right = math.floor(min(x.min(), 0) - 0.5), math.ceil(max(x.max(), 0) + 0.5)
    rows, cols = np.mgrid[low : high + 1, left : right + 1].astype(np.float64)
    meets = _is_within(cols, rows, x, y)
    for k in range(len(x)):
        meets |= _runs_through(cols, rows, (x[k - 1], y[k - 1]), (x[k], y[k]))
    offsets: Int = np.argwhere(meets) + np.array([low, left], dtype=np.int64)
    return offsets


def _is_within(px: Float, py: Float, x: Float, y: Float) -> Bool:
    """Whether points are inside a polygon, by the parity of a ray's crossings."""
    inside = np.zeros(px.shape, dtype=np.bool_)
    for k in range(len(x)):
        x0, y0, x1, y1 = x[k - 1], y[k - 1], x[k], y[k]
        spans = (y0 > py) != (y1 > py)
        with np.errstate(divide="ignore", invalid="ignore"):
            inside ^= spans & (px < x0 + (py - y0) / (y1 - y0) * (x1 - x0))
    return inside


def _runs_through(px: Float, py: Float, a: tuple[float, float], b: tuple[float, float]) -> Bool:
    """Whether a segment has points inside of squares round some centres (Liang and Barsky 1984)."""
    enters, leaves = np.zeros(px.shape), np.ones(px.shape)
    half = 0.5 - TOUCH
    for start, end, centre in ((a[0], b[0], px), (a[1], b[1], py)):
        step = end - start
        if abs(step) < TOUCH:
            leaves = np.where(np.abs(start - centre) < half, leaves, -1.0)
            continue
        near, far = (centre - half - start) / step, (centre + half - start) / step
        enters = np.maximum(enters, np.minimum(near, far))
        leaves = np.minimum(leaves, np.maximum(near, far))
    return np.asarray(enters < leaves)


def _to_runs(offsets: Int) -> Int:
    """Pack steps, by row and column, into runs: row, first column, last column."""
    row, col = offsets.T
    is_first = np.ones(len(row), dtype=np.bool_)
    is_first[1:] = (row[1:] != row[:-1]) | (col[1:] != col[:-1] + 1)
    first = np.flatnonzero(is_first)
    last = np.append(first[1:], len(row)) - 1
    return np.stack([row[first], col[first], col[last]], axis=1)


def _turn(outline: Float, angle: float) -> Float:
    cos, sin = math.cos(angle), math.sin(angle)
    x, y = outline.T
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)


def _check_polygon(polygon: ArrayLike) -> Float:
    try:
        outline = np.asarray(polygon, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise QueryError(f"expected a polygon of shape (n, 2) [m], got {polygon!r}") from error
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3:
        raise QueryError(f"expected a polygon of shape (n, 2) [m], n >= 3, got {outline.shape}")
    if not np.isfinite(outline).all():
        raise QueryError("expected a polygon of finite numbers [m]")
    fault = find_fault(outline)
    if fault:
        raise QueryError(f"expected the outline of an area, got {fault}")
    return outline
