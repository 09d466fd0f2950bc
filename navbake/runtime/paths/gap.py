"""How wide the way between two places is at its narrowest."""

from dataclasses import dataclass, replace

import numpy as np

from navbake.navgrid.grid import NavGrid
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.inflation.inflate import find_blocked
from navbake.runtime.inflation.margins import exact_radius, ledges_of
from navbake.runtime.paths.search import Search
from navbake.runtime.places.island_map import map_islands
from navbake.types import Bool, Float, Int

FINE = 1e-3  # metres to which a radius is found
MAX_STOPS = 200  # cells that are looked at for the narrowest one


@dataclass(frozen=True, eq=False)
class Gap:
    """The narrowest place on the widest way."""

    width: float  # between the obstacles [m]; on the centres of cells, up to a cell more is needed
    position: Float  # world x, y, z of a cell there [m], shape (3,)


def find_gap(grid: NavGrid, flat: FlatGrid, origin: int, goals: Int) -> Gap | None:
    """Find the gap that keeps an agent of an inflated grid's radius from a goal.

    Origin and goals are free cells, by flat id, in different islands. None if the grid isn't
    inflated, or no smaller radius passes.
    """
    radius = exact_radius(grid)
    plain, ledges = deflated(grid.without_blocks()), ledges_of(grid)
    if radius == 0.0 or not _joins(plain, 0.0, ledges, flat, (origin, goals)):
        return None
    # bisection: a radius that passes lets all smaller ones pass, as no larger one frees a cell
    low, high = 0.0, radius
    while high - low > FINE:
        middle = (low + high) / 2
        if _joins(plain, middle, ledges, flat, (origin, goals)):
            low = middle
        else:
            high = middle
    free = _free_for(plain, low, ledges)
    route = Search(_with_free(plain, free)).route(origin, goals)
    if route is None:
        return None
    # of the widest way, the cells that a slightly larger agent loses: the gap is one of them
    taken = _with_flanks(flat, route)
    stops = taken[~_free_for(plain, high, ledges)[taken]]
    return _measure(plain, flat, stops, low) if len(stops) else None


def _with_flanks(flat: FlatGrid, route: Int) -> Int:
    """The cells of a route and, as no corners are cut, those beside its diagonal steps."""
    level, row, col = flat.split(route)
    is_diagonal = (np.diff(level) == 0) & (np.abs(np.diff(row)) == 1) & (np.abs(np.diff(col)) == 1)
    one, other = np.flatnonzero(is_diagonal), np.flatnonzero(is_diagonal) + 1
    first, width = flat.layout.start[level[one]], flat.layout.width[level[one]]
    flanks = [first + row[a] * width + col[b] for a, b in ((one, other), (other, one))]
    return np.concatenate([route, *flanks])


def _measure(grid: NavGrid, flat: FlatGrid, stops: Int, radius: float) -> Gap:
    """The narrowest of some cells, and the width from what is nearest there to the other side."""
    best, width, narrowest = np.inf, 2 * radius, int(stops[0])
    for stop in stops[:MAX_STOPS].tolist():
        here, low, high = _squares_near(grid, flat, stop, 4 * radius)
        nearest = np.clip(here, low, high) - here
        distance = np.linalg.norm(nearest, axis=1)
        if not len(distance) or distance.min() >= best:
            continue
        k = int(np.argmin(distance))
        best, narrowest, width = float(distance[k]), stop, 2 * radius
        # the other side: what lies within 60 degrees of the opposite direction
        opposite = nearest @ -nearest[k] > 0.5 * distance * distance[k]
        if opposite.any():
            side = here + nearest[k]
            across = np.linalg.norm(np.clip(side, low, high) - side, axis=1)[opposite]
            width = float(across.min())
    return Gap(width, flat.positions(narrowest))


def _squares_near(
    grid: NavGrid, flat: FlatGrid, cell: int, reach: float
) -> tuple[Float, Float, Float]:
    """A cell's centre, and the lower and upper corners of occupied cells round it, x, y [m]."""
    number, row, col = flat.cell(cell)
    level, size = grid.levels[number], flat.layout.cell_size[number]
    span = int(reach / size) + 2
    row0, col0 = max(row - span, 0), max(col - span, 0)
    occupied = level.solid[row0 : row + span + 1, col0 : col + span + 1]
    rows, cols = np.nonzero(occupied)
    centers = level.lattice.positions(rows + row0, cols + col0)
    here = level.lattice.positions(row, col)
    return here, centers - size / 2, centers + size / 2


def deflated(grid: NavGrid) -> NavGrid:
    """The grid for an agent without a radius, with weights of 1; itself if it wasn't inflated."""
    if "inflation" not in grid.metadata:
        return grid
    free = [(v.solid == 0) & ~np.isnan(v.floor_height) | v.free for v in grid.levels]
    return _with_free(grid, np.concatenate([mask.ravel() for mask in free]))


def _with_free(grid: NavGrid, free: Bool) -> NavGrid:
    """The grid with other free cells, by flat id, all of weight 1, as if never inflated."""
    metadata = {key: value for key, value in grid.metadata.items() if key != "inflation"}
    ends = np.cumsum([level.width * level.height for level in grid.levels])
    weights = np.split(np.where(free, 1.0, np.inf), ends[:-1])
    pairs = zip(grid.levels, weights, strict=True)
    return grid.with_levels(
        [level.with_layers(weights=w.reshape(level.shape)) for level, w in pairs], metadata
    )


def _free_for(grid: NavGrid, radius: float, ledges: str) -> Bool:
    levels = enumerate(grid.levels)
    free = [v.free & ~find_blocked(grid, k, radius, ledges) for k, v in levels]
    return np.concatenate([mask.ravel() for mask in free])


def _joins(
    grid: NavGrid, radius: float, ledges: str, flat: FlatGrid, ends: tuple[int, Int]
) -> bool:
    """Whether an agent of a radius gets to a goal."""
    origin, goals = ends
    islands = map_islands(replace(flat, free=_free_for(grid, radius, ledges))).number
    return bool((islands[goals] == islands[origin]).any())
