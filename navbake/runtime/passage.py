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
from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.inflation import MAX_RADIUS, check_ledges, exact_radius, ledges_of
from navbake.runtime.paths import Goal, find_target
from navbake.runtime.regions import map_islands
from navbake.runtime.search import Search
from navbake.runtime.surroundings import find_blocked
from navbake.types import Bool, Float, Int

routes = lazy("navbake.runtime.kernels.routes")  # numba loads slowly

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


def find_passage(
    search: Search, start: ArrayLike, goal: Goal, level: int | None, ledges: str
) -> Passage | None:
    """`PathFinder.max_radius`.

    The way of the widest agent goes round the cells that a larger agent loses wherever it can. The
    first row of such cells that is left on it is the bottleneck, and the middle one of the row is
    its place.
    """
    check_ledges(ledges)
    grid, flat, corners = deflated(search.grid), search.flat, search.cut_corners
    standable = free_for(grid, 0.0, ledges)

    def reason(inside: bool) -> str:
        return "no agent can stand there" if inside else "it lies beside the grid"

    p, origin = flat.locate(start, level, "start")
    if origin < 0 or not standable[origin]:
        where = ", ".join(f"{v:g}" for v in p)
        raise QueryError(f"no way from {where}: {reason(origin >= 0)}")
    if isinstance(goal, str) and goal.startswith("object:"):
        raise QueryError(
            f"expected a position or room:NAME as goal, got {goal!r}: how near an agent gets to an "
            "object depends on its radius"
        )
    target = find_target(search, goal, level)
    goals = np.unique(target.cells[target.cells >= 0])
    goals = goals[standable[goals]]
    if not len(goals):
        raise QueryError(f"no way to {target.name}: {reason(bool((target.cells >= 0).any()))}")
    widest = find_widest(grid, flat, origin, goals, ledges, corners=corners)
    if widest is None:
        return None
    radius, free, for_larger = widest
    if math.isinf(radius):
        return Passage(math.inf, None)
    lost = free & ~for_larger
    weights = np.where(free, np.where(lost, NARROW, 1.0), np.inf)
    route = Search(with_weights(grid, weights), cut_corners=corners).route(origin, goals)
    assert route is not None  # the islands say that there is one
    stops = np.flatnonzero(lost[route])
    if len(stops):
        row = np.split(stops, np.flatnonzero(np.diff(stops) > 1) + 1)[0]
        return Passage(radius, flat.positions(int(route[row[(len(row) - 1) // 2]])))
    beside = flanks(flat, route)  # it squeezes through diagonally
    return Passage(radius, flat.positions(int(beside[lost[beside]][0])))


def find_widest(
    grid: NavGrid, flat: FlatGrid, origin: int, goals: Int, ledges: str, *, corners: bool = False
) -> tuple[float, Bool, Bool] | None:
    """Find the largest radius that gets from a cell to the nearest of several, by flat ids.

    The grid isn't inflated. None if not even an agent without a radius gets there; else the radius
    [m], inf where none is too large, what is free for it, and what is free for the next radius that
    inflation tells from it, by flat id.
    """

    def passes(radius: float) -> bool:
        free = free_for(grid, radius, ledges)
        ends = goals[free[goals]]
        if not free[origin] or not len(ends):
            return False
        moves = None
        if corners:
            moves = np.zeros(flat.num_cells, dtype=np.uint8)
            for number, level in enumerate(grid.levels):
                routes.find_moves(
                    free, free, flat.floors, flat.slopes, True, flat.layout, number,
                    (0, level.height, 0, level.width), moves,
                )  # fmt: skip
        islands = map_islands(replace(flat, free=free), moves).number
        return bool((islands[ends] == islands[origin]).any())

    if not passes(0.0):
        return None
    # the largest radius is in [low, high)
    low, high = 0.0, float(flat.layout.cell_size.min())
    while passes(high):
        if high == MAX_RADIUS:
            free = free_for(grid, MAX_RADIUS, ledges)
            return math.inf, free, free
        low, high = high, min(2.0 * high, MAX_RADIUS)
    while (listed := _radii_between(grid, low, high)) is None:
        middle = (low + high) / 2
        low, high = (middle, high) if passes(middle) else (low, middle)
    radii = [*listed.tolist(), high]
    good, bad = 0, len(radii) - 1
    while bad - good > 1:
        half = (good + bad) // 2
        good, bad = (half, bad) if passes(radii[half]) else (good, half)
    return radii[good], *(free_for(grid, radii[k], ledges) for k in (good, good + 1))


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


def find_gap(grid: NavGrid, flat: FlatGrid, origin: int, goals: Int) -> tuple[float, Float] | None:
    """Find the gap that keeps an agent of an inflated grid's radius from a goal.

    Origin and goals are free cells, by flat id, in different islands. Its width is that between the
    obstacles [m] (on the centres of cells, up to a cell more is needed), and its position world
    x, y, z of a cell there [m]. None if the grid isn't inflated, or no smaller radius passes.
    """
    if exact_radius(grid) == 0.0:
        return None
    plain = deflated(grid.without_blocks())
    widest = find_widest(plain, flat, origin, goals, ledges_of(grid))
    if widest is None or math.isinf(widest[0]):
        return None
    radius, free, for_larger = widest
    route = Search(with_weights(plain, np.where(free, 1.0, np.inf))).route(origin, goals)
    if route is None:
        return None
    # of the widest way, the cells that a slightly larger agent loses: the gap is one of them
    taken = np.concatenate([route, flanks(flat, route)])
    stops = taken[~for_larger[taken]]
    if not len(stops):
        return None
    # the narrowest of them, and the width from what is nearest there to the other side
    best, width, narrowest = np.inf, 2 * radius, int(stops[0])
    for stop in stops[:MAX_STOPS].tolist():
        # the occupied squares round it
        number, row, col = flat.cell(stop)
        level, size = plain.levels[number], flat.layout.cell_size[number]
        span = int(4 * radius / size) + 2
        row0, col0 = max(row - span, 0), max(col - span, 0)
        rows, cols = np.nonzero(level.solid[row0 : row + span + 1, col0 : col + span + 1])
        centers = level.lattice.positions(rows + row0, cols + col0)
        here, low, high = level.lattice.positions(row, col), centers - size / 2, centers + size / 2
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
    return width, flat.positions(narrowest)
