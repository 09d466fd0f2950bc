"""The widest agent that gets from one place to another, and where it only just fits.

A larger radius never frees a cell. So the radii that get there are those up to a largest one, which
a bisection finds. It is exact, because inflation tells only a few radii apart: those at which a
disc round a cell's centre touches a square or a centre of another cell, so that four times their
square, in cells, is a whole number; and the baked radius, up to which higher floors don't count
(see `navbake.runtime.inflation`). Only these are tried.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.grid import NavGrid
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.grid_cache import GridCache, map_islands
from navbake.runtime.inflation import MAX_RADIUS, check_ledges, exact_radius, ledges_of
from navbake.runtime.paths import Goal, find_target
from navbake.runtime.search import Search
from navbake.runtime.surroundings import find_blocked
from navbake.types import Bool, Float, Int

# Functions import kernels when they run: numba takes long to load.

MAX_LISTED = 4096  # radii that are listed at once; bisection narrows a wider range first
NARROW = 1000.0  # weight of a cell that a larger agent loses: a way goes round it if it can
MAX_STOPS = 200  # cells that are looked at for the narrowest one of a gap


@dataclass(frozen=True, eq=False)
class Passage:
    """The widest agent that gets from one place to another.

    Attributes:
        radius: of the agent [m]; inf where no radius is too large.
        position: world x, y and floor z [m] of the bottleneck, where the agent only just fits,
            shape (3,), float64: the centre of a cell that any larger agent loses. Where there are
            several bottlenecks in a row, the first. None where no radius is too large.
    """

    radius: float
    position: Float | None


@dataclass(frozen=True, eq=False)
class Widest:
    """The largest radius that gets to a goal, and what is free.

    Attributes:
        radius: [m]; inf where none is too large.
        free: for an agent of this radius, by flat id, bool.
        free_for_larger: for one of the next radius that inflation tells from it.
    """

    radius: float
    free: Bool
    free_for_larger: Bool


def find_passage(
    cache: GridCache, start: ArrayLike, goal: Goal, level: int | None, ledges: str
) -> Passage | None:
    """`PathFinder.max_radius`."""
    check_ledges(ledges)
    grid = deflated(cache.grid)
    flat, corners = cache.flat, cache.search.cut_corners
    standable = free_for(grid, 0.0, ledges)
    p, origin = flat.locate(start, level, "start")
    if origin is None or not standable[origin]:
        where = "no agent can stand there" if origin is not None else "it lies beside the grid"
        raise QueryError(f"no way from {_text(p)}: {where}")
    if isinstance(goal, str) and goal.startswith("object:"):
        raise QueryError(
            f"expected a position or room:NAME as goal, got {goal!r}: how near an agent gets to an "
            "object depends on its radius"
        )
    target = find_target(cache, goal, level)
    goals = np.unique(target.cells[target.cells >= 0])
    goals = goals[standable[goals]]
    if not len(goals):
        inside = (target.cells >= 0).any()
        where = "no agent can stand there" if inside else "it lies beside the grid"
        raise QueryError(f"no way to {target.name}: {where}")
    widest = find_widest(grid, flat, (origin, goals), ledges, corners=corners)
    if widest is None:
        return None
    if math.isinf(widest.radius):
        return Passage(math.inf, None)
    return Passage(widest.radius, _bottleneck(grid, flat, (origin, goals), widest, corners))


def find_widest(
    grid: NavGrid, flat: FlatGrid, ends: tuple[int, Int], ledges: str, *, corners: bool = False
) -> Widest | None:
    """Find the largest radius that gets from a cell to the nearest of several, by flat ids.

    Args:
        grid: not inflated.
        ends: the first cell, and the others.
        ledges: see `SceneGrid2D.inflate`.
        corners: whether corners are cut.

    Returns:
        None if not even an agent without a radius gets there.
    """

    def passes(radius: float) -> bool:
        return _joins(flat, free_for(grid, radius, ledges), ends, corners)

    if not passes(0.0):
        return None
    # the largest radius is in [low, high)
    low, high = 0.0, float(flat.layout.cell_size.min())
    while passes(high):
        if high == MAX_RADIUS:
            free = free_for(grid, MAX_RADIUS, ledges)
            return Widest(math.inf, free, free)
        low, high = high, min(2.0 * high, MAX_RADIUS)
    while (listed := _radii_between(grid, low, high)) is None:
        middle = (low + high) / 2
        low, high = (middle, high) if passes(middle) else (low, middle)
    radii = [*listed.tolist(), high]
    good, bad = 0, len(radii) - 1
    while bad - good > 1:
        middle_one = (good + bad) // 2
        if passes(radii[middle_one]):
            good = middle_one
        else:
            bad = middle_one
    larger = free_for(grid, radii[good + 1], ledges)
    return Widest(radii[good], free_for(grid, radii[good], ledges), larger)


def free_for(grid: NavGrid, radius: float, ledges: str) -> Bool:
    """The cells that are free in ``grid.inflate(radius)``, by flat id; the grid isn't inflated."""
    levels = enumerate(grid.levels)
    free = [v.free_for_point & ~find_blocked(grid, k, radius, ledges) for k, v in levels]
    return np.concatenate([mask.ravel() for mask in free])


def deflated(grid: NavGrid) -> NavGrid:
    """The grid for an agent without a radius, with weights of 1; itself if it wasn't inflated."""
    if "inflation" not in grid.metadata:
        return grid
    free = [(v.solid == 0) & ~np.isnan(v.floor_height) | v.free for v in grid.levels]
    return with_weights(grid, np.where(np.concatenate([m.ravel() for m in free]), 1.0, np.inf))


def with_weights(grid: NavGrid, weights: Float) -> NavGrid:
    """The grid with other weights, by flat id, as if never inflated."""
    metadata = {key: value for key, value in grid.metadata.items() if key != "inflation"}
    ends = np.cumsum([level.width * level.height for level in grid.levels])
    pairs = zip(grid.levels, np.split(weights, ends[:-1]), strict=True)
    return grid.with_levels(
        [level.with_layers(weights=w.reshape(level.shape)) for level, w in pairs], metadata
    )


def flanks(flat: FlatGrid, route: Int) -> Int:
    """The cells beside the diagonal steps of a route, which no step may cut, by flat id."""
    level, row, col = flat.split(route)
    is_diagonal = (np.diff(level) == 0) & (np.abs(np.diff(row)) == 1) & (np.abs(np.diff(col)) == 1)
    one, other = np.flatnonzero(is_diagonal), np.flatnonzero(is_diagonal) + 1
    first, width = flat.layout.start[level[one]], flat.layout.width[level[one]]
    beside = [first + row[a] * width + col[b] for a, b in ((one, other), (other, one))]
    return np.concatenate(beside)


def _joins(flat: FlatGrid, free: Bool, ends: tuple[int, Int], corners: bool) -> bool:
    """Whether steps over free cells lead from a cell to one of several."""
    from navbake.runtime.kernels.arrays import Rect
    from navbake.runtime.kernels.routes import Footing, find_moves

    origin, goals = ends
    goals = goals[free[goals]]
    if not free[origin] or not len(goals):
        return False
    moves = None
    if corners:
        layout, floors, moves = flat.layout, flat.floors, np.zeros(flat.num_cells, dtype=np.uint8)
        footing = Footing(free, free, floors.z, floors.max_step, True, flat.slopes)
        for number in range(flat.num_levels):
            rect = Rect(*(int(v[number]) for v in (layout.start, layout.width, layout.height)))
            find_moves(footing, rect, (0, rect.height, 0, rect.width), moves)
    islands = map_islands(replace(flat, free=free), moves).number
    return bool((islands[goals] == islands[origin]).any())


def _radii_between(grid: NavGrid, low: float, high: float) -> Float | None:
    """The radii that inflation tells apart in [low, high) [m], ascending; None for too many."""
    of_bake = np.array([grid.agent_radius])
    radii, count = [of_bake[(of_bake >= low) & (of_bake < high)]], 1
    for cell in {level.lattice.cell_size for level in grid.levels}:
        first, last = math.floor((2 * low / cell) ** 2), math.ceil((2 * high / cell) ** 2)
        count += last - first + 1
        if count > MAX_LISTED:
            return None
        found = np.sqrt(np.arange(first, last + 1)) * (cell / 2)
        radii.append(found[(found >= low) & (found < high)])
    return np.unique(np.concatenate(radii))


def _bottleneck(
    grid: NavGrid, flat: FlatGrid, ends: tuple[int, Int], widest: Widest, corners: bool
) -> Float:
    """Where the widest agent only just fits.

    Its way goes round the cells that a larger agent loses wherever it can. The first row of such
    cells that is left on it is the bottleneck, and the middle one of the row is its place.
    """
    lost = widest.free & ~widest.free_for_larger
    weights = np.where(widest.free, np.where(lost, NARROW, 1.0), np.inf)
    route = Search(with_weights(grid, weights), cut_corners=corners).route(*ends)
    assert route is not None  # the islands say that there is one
    stops = np.flatnonzero(lost[route])
    if not len(stops):  # it squeezes through diagonally
        beside = flanks(flat, route)
        return flat.positions(int(beside[lost[beside]][0]))
    gaps = np.flatnonzero(np.diff(stops) > 1)
    row = stops[: gaps[0] + 1] if len(gaps) else stops
    return flat.positions(int(route[row[(len(row) - 1) // 2]]))


def _text(position: Float) -> str:
    return ", ".join(f"{v:g}" for v in position)


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
    if exact_radius(grid) == 0.0:
        return None
    plain = deflated(grid.without_blocks())
    widest = find_widest(plain, flat, (origin, goals), ledges_of(grid))
    if widest is None or math.isinf(widest.radius):
        return None
    route = Search(with_weights(plain, np.where(widest.free, 1.0, np.inf))).route(origin, goals)
    if route is None:
        return None
    # of the widest way, the cells that a slightly larger agent loses: the gap is one of them
    taken = np.concatenate([route, flanks(flat, route)])
    stops = taken[~widest.free_for_larger[taken]]
    if not len(stops):
        return None
    # the narrowest of them, and the width from what is nearest there to the other side
    best, width, narrowest = np.inf, 2 * widest.radius, int(stops[0])
    for stop in stops[:MAX_STOPS].tolist():
        here, low, high = _squares_near(plain, flat, stop, 4 * widest.radius)
        nearest = np.clip(here, low, high) - here
        distance = np.linalg.norm(nearest, axis=1)
        if not len(distance) or distance.min() >= best:
            continue
        k = int(np.argmin(distance))
        best, narrowest, width = float(distance[k]), stop, 2 * widest.radius
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
