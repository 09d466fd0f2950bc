"""The widest agent that passes from one place to another, and the reason why there is no path.

A larger radius never frees a cell, so a bisection is exact over the few radii at which cells
change: a disc round a cell's centre touches a square or a centre of another cell, so that four
times the squared radius, in cells, is a whole number; or the baked radius, up to which higher
floors don't count.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.known_names import list_first
from navbake.lazy import lazy
from navbake.navgrid.cells import place_in
from navbake.navgrid.grid import MAX_RADIUS, NavGrid
from navbake.runtime import inflation
from navbake.runtime.flat_grid import (
    RISE,
    doors_on,
    find_leaf_cells,
    find_stairs,
    map_islands,
    text_of,
)
from navbake.runtime.paths import Goal, find_target
from navbake.runtime.search import NO_CELLS, Search
from navbake.runtime.surroundings import free_for
from navbake.types import Bool, Float, Int

spatial = lazy("scipy.spatial")  # saves scipy at start-up

NARROW = 1000.0  # weight of a cell that is blocked for a larger agent: a way avoids it if it can
SHUT = 10_000.0  # weight of a cell that a door blocks: a way of 10 km costs as much as 1 m of it
MAX_NAMES = 4  # of obstacles, listed in a sentence
LEAST_AREA = 0.5  # m² on both levels: what steps that stay free have to lead to
BESIDE = 3  # cells along a route before and after its block, for its rise


Widest = tuple[float, Bool, Bool]
"""The largest radius that passes [m], inf if none is too large, and the cells that are free for it
and for the next larger one."""


@dataclass(frozen=True, eq=False)
class Passage:
    """The widest agent that passes from one place to another."""

    radius: float  #: Of the agent [m]; inf where no radius is too large.
    position: Float | None
    """World x, y and floor z [m] of the first bottleneck, shape (3,): the centre of a cell that is
    blocked for any larger agent. None where no radius is too large."""


def find_passage(
    search: Search, start: ArrayLike, goal: Goal, level: int | None, ledges: str
) -> Passage | None:
    """`PathFinder.max_radius`."""
    inflation.check_word(ledges, inflation.LEDGES, "ledges")
    grid = deflated(search.grid)
    flat = search.flat
    corners = search.cut_corners
    standable = free_for(grid, 0.0, ledges)

    def reason(inside: bool) -> str:
        return "no agent can stand there" if inside else "it lies beside the grid"

    p, origin = flat.locate(start, level, "start")
    if origin < 0 or not standable[origin]:
        raise QueryError(f"no way from {text_of(p)}: {reason(origin >= 0)}")
    if isinstance(goal, str) and goal.startswith("object:"):
        because = "how near an agent gets to an object depends on its radius"
        raise QueryError(f"expected a position or room:NAME as goal, got {goal!r}: {because}")
    target = find_target(search, goal, level)
    goals = np.unique(target.cells[target.cells >= 0])
    goals = goals[standable[goals]]
    if not len(goals):
        raise QueryError(f"no way to {target.name}: {reason(bool((target.cells >= 0).any()))}")
    widest = find_widest(grid, search, origin, goals, ledges, corners=corners)
    if widest is None:
        return None
    radius = widest[0]
    if math.isinf(radius):
        return Passage(math.inf, None)
    cell = find_bottleneck(grid, search, origin, goals, widest, corners)
    return Passage(radius, flat.positions(cell))


def find_widest(
    grid: NavGrid, search: Search, origin: int, goals: Int, ledges: str, *, corners: bool = False
) -> Widest | None:
    """Find the largest radius that passes from a cell to the nearest of several, by flat ids.

    None if not even a point passes. Links and areas are as `search` has them.
    """
    flat = search.flat
    is_barred = ~np.isfinite(search.flat.price)

    def passes(radius: float) -> bool:
        free = free_for(grid, radius, ledges) & ~is_barred
        ends = goals[free[goals]]
        if not free[origin] or not len(ends):
            return False
        moves = None
        if corners:  # they join islands, too
            weights = np.where(free, 1.0, np.inf)
            moves = Search(with_weights(grid, weights), cut_corners=True).graph.moves
        islands = map_islands(replace(flat, free=free), radius, moves)
        reached = islands.reached_from(int(islands.number[origin]))
        return bool(np.isin(islands.number[ends], reached).any())

    if not passes(0.0):
        return None
    # the largest radius is in [low, high)
    size = float(flat.layout.cell_size.min())
    low = 0.0
    high = size
    while passes(high):
        if high == MAX_RADIUS:
            free = free_for(grid, high, ledges)
            return math.inf, free, free
        low = high
        high = min(2.0 * high, MAX_RADIUS)
    while high - low > size:  # so that few radii are left
        middle = (low + high) / 2
        low, high = (middle, high) if passes(middle) else (low, middle)
    told_apart = [np.array([grid.agent_radius]), search.flat.arcs.width / 2.0]
    for cell in set(flat.layout.cell_size.tolist()):
        first = math.floor((2 * low / cell) ** 2)
        last = math.ceil((2 * high / cell) ** 2)
        told_apart.append(np.sqrt(np.arange(first, last + 1)) * (cell / 2))
    listed = np.unique(np.concatenate(told_apart))
    radii = [*listed[(listed >= low) & (listed < high)].tolist(), high]
    good = 0
    bad = len(radii) - 1
    while bad - good > 1:
        half = (good + bad) // 2
        good, bad = (half, bad) if passes(radii[half]) else (good, half)
    return radii[good], *(free_for(grid, radii[k], ledges) for k in (good, good + 1))


def find_closed_connections(before: Search, after: Search) -> list[tuple[str, Int]]:
    """Find the steps between levels, the links and the doors that only one of two grids has open.

    Steps side by side are one way. They are closed where no free step is left, or where the free
    ones lead to less than 0.5 m² on one of the levels, as a landing between blocked treads. A door
    is closed where none of its leaf's cells is free, a link where it is too narrow, or where fewer
    than two of its stops are. Both searches are on the same cells.
    """
    flat = before.flat
    found = list[tuple[str, Int]]()
    for low, high, what, ends in find_stairs(before.grid, flat):
        leads = []  # whether a step is free, and leads to enough of both levels
        for search in (before, after):
            number = search.islands.number
            count = np.zeros(ends.shape, dtype=np.int64)
            for side, level in enumerate((low, high)):
                on_level = np.bincount(number[flat.cells_of(level)])
                count[:, side] = on_level[number[ends[:, side]]]
            size = flat.layout.cell_size[[low, high]] ** 2
            leads.append((search.flat.free[ends] & (count * size >= LEAST_AREA)).all(axis=1).any())
        if leads[0] and not leads[1]:
            x, y, _ = flat.positions(ends).mean(axis=(0, 1))
            name = f"the {what} between level {low} and {high} near ({x:.2f}, {y:.2f})"
            found.append((name, ends.ravel()))
    for link in before.grid.links:
        cells = np.array([flat.layout.start[stop.level] + stop.cell for stop in link.stops])
        was_fit = before.flat.free[cells].sum() > 1 and link.fits(before.radius)
        is_fit = after.flat.free[cells].sum() > 1 and link.fits(after.radius)
        if was_fit and not is_fit:
            found.append((f"the link {link.name!r} ({link.kind})", cells))
    for door in before.grid.doors:
        cells = find_leaf_cells(door, flat)
        cells = cells[flat.free[cells]]
        if len(cells) and not after.flat.free[cells].any():
            found.append((f"door {door.id!r}", cells))
    return found


def deflated(grid: NavGrid) -> NavGrid:
    """The grid for a point agent: weights of 1 where a point can stand, inf elsewhere.

    The grid itself if it was never inflated.
    """
    if "inflation" not in grid.metadata:
        return grid
    free = [(v.solid == 0) & ~np.isnan(v.floor_height) | v.free for v in grid.levels]
    return with_weights(grid, np.where(np.concatenate([m.ravel() for m in free]), 1.0, np.inf))


def with_weights(grid: NavGrid, weights: Float) -> NavGrid:
    """The grid with other weights, by flat id, as if never inflated."""
    metadata = {key: value for key, value in grid.metadata.items() if key != "inflation"}
    ends = np.cumsum([level.free.size for level in grid.levels])
    pairs = zip(grid.levels, np.split(weights, ends[:-1]), strict=True)
    return grid.with_levels(
        [level.with_layers(weights=w.reshape(level.shape)) for level, w in pairs], metadata
    )


def find_route(grid: NavGrid, like: Search, origin: int, goals: Int) -> Int | None:
    """The cells of the cheapest route on a grid, for the agent of a search whatever its size."""
    found = search_as(grid, like).route(origin, goals)
    return found and found.cells


def search_as(grid: NavGrid, like: Search, **options: Any) -> Search:
    """A search on another grid by the rules of one, for its agent whatever its size."""
    agent = like.agent and like.agent.of_any_size()
    options = {"cut_corners": like.cut_corners, "radius": like.radius} | options
    return Search(grid, agent=agent, **options)


def find_bottleneck(
    grid: NavGrid, search: Search, origin: int, goals: Int, widest: Widest, corners: bool
) -> int:
    """Find the flat id of the bottleneck, the cell where the widest agent only just fits.

    The route avoids the cells that are lost to a larger agent if it can. The bottleneck is the
    middle of the first run of them on it; without one, the stop of a link, or a lost cell beside a
    diagonal step.
    """
    flat = search.flat
    radius, free, for_larger = widest
    lost = free & ~for_larger
    weights = np.where(free, np.where(lost, NARROW, 1.0), np.inf)
    like = search_as(with_weights(grid, weights), search, cut_corners=corners, radius=radius)
    found = like.route(origin, goals)
    assert found is not None  # the islands say that there is one
    route = found.cells
    stops = np.flatnonzero(lost[route])
    if len(stops):
        row = np.split(stops, np.flatnonzero(np.diff(stops) > 1) + 1)[0]
        return int(route[row[(len(row) - 1) // 2]])
    for at in np.flatnonzero(found.by_link).tolist():
        is_taken = (flat.arcs.ends == route[at - 1 : at + 1]).all(axis=1)
        if is_taken.any() and math.isclose(flat.arcs.width[is_taken].max(), 2.0 * radius):
            return int(route[at - 1])
    # the route passes diagonally between two cells
    level, row, col = flat.split(route)
    one = np.flatnonzero((np.abs(np.diff([level, row, col])).T == (0, 1, 1)).all(axis=1))
    across = col[one + 1] - col[one]
    beside = np.concatenate([route[one] + across, route[one + 1] - across])
    return int(beside[lost[beside]][0])


def why_not(search: Search, start: ArrayLike, goal: Goal, level: int | None) -> str | None:
    """`PathFinder.why_not`."""
    flat = search.flat
    p, origin = flat.locate(start, level, "start")
    target = find_target(search, goal, level)
    if origin < 0 or not flat.free[origin]:
        return f"the start {_why_not_free(search, p, origin)}"
    goals = target.free_cells(flat)
    if not len(goals):
        if target.positions is not None:
            first = _why_not_free(search, target.positions[0], int(target.cells[0]))
            if len(target.positions) == 1:
                return f"the goal {first}"
            return f"none of the {len(target.positions)} goals is free: the first {first}"
        where = f"no cell of {target.name}"
        if not target.name.startswith("room"):
            where = f"no cell within 1 m of {target.name}, not counting those behind walls,"
        return f"{where} is free for a radius of {search.grid.radius:g} m"
    if search.route(origin, goals) is not None:
        return None
    apart, cells = _apart(search, origin, goals)
    answers = (name(search, origin, goals) for name in CAUSES)
    because = next((answer for answer in answers if answer), None)
    if not because and cells is not None:  # objects on the line between the nearest cells
        on, row, col = flat.split(cells)
        count = int(np.abs(np.diff([row, col])).max()) + 1
        line = np.rint(np.linspace((row[0], col[0]), (row[1], col[1]), count)).astype(np.int64)
        first = flat.layout.start[on[0]]
        width = flat.layout.width[on[0]]
        names = _names(search, first + line @ [width, 1])
        because = f"between them: {names}" if names else None
    return f"{apart}; {because}" if because else apart


def _why_not_free(search: Search, position: Float, cell: int) -> str:
    """Say why a position isn't free, and where the nearest free cell is."""
    grid = search.grid
    flat = search.flat
    if cell < 0:
        boxes = np.array([level.lattice.bounds for level in grid.levels])
        x0, y0 = boxes[:, :2].min(axis=0)
        x1, y1 = boxes[:, 2:].max(axis=0)
        what = f"lies beside the grid, x {x0:g} to {x1:g}, y {y0:g} to {y1:g}"
        if x0 <= position[0] <= x1 and y0 <= position[1] <= y1:
            what = "has no floor below it"
    elif (area := _barring_area(search, cell)) is not None:
        what = f"lies in the {', which '.join(area)}"
    elif (place := place_in(grid, flat.cell(cell))).is_blocked:
        what = "is blocked for now"
    elif place.floor is None:
        what = "is on no floor"
    elif place.occupied:
        names = _names(search, np.array([cell]))
        what = f"is where something stands{f' ({names})' if names else ''}"
    else:
        what = f"is too near to what stands beside it for a radius of {grid.radius:g} m"
    what = f"{_text(position)} {what}"
    free = np.flatnonzero(flat.free)
    if not len(free):
        return f"{what}, and no cell is free at all"
    level = 0 if cell < 0 else int(flat.level_of(cell))
    z = position[2] if len(position) == 3 else flat.floors.ground[level]
    places = flat.positions(free)
    distance = np.linalg.norm(places - [position[0], position[1], z], axis=1)
    k = int(np.argmin(distance))
    return f"{what}; the nearest free cell is at {_text(places[k])}, {distance[k]:.2f} m away"


def _apart(search: Search, origin: int, goals: Int) -> tuple[str, Int | None]:
    """Name the two islands, and find their two nearest cells on one level."""
    flat = search.flat
    islands = search.islands
    home = islands.number[origin]
    away = np.unique(islands.number[goals])
    edge = flat.free & (search.graph.moves != 255)
    ones = np.flatnonzero(edge & np.isin(islands.number, home))
    others = np.flatnonzero(edge & np.isin(islands.number, away))
    # One tree for all levels: as a third coordinate, each level is farther from the next than any
    # two cells of one level can be.
    reach = 10.0 * float(flat.layout.start[-1])
    here = np.column_stack([flat.positions(ones)[:, :2], flat.level_of(ones) * reach])
    there = np.column_stack([flat.positions(others)[:, :2], flat.level_of(others) * reach])
    distance, index = spatial.cKDTree(there).query(here)
    one = int(np.argmin(distance))
    cells = np.array([ones[one], others[index[one]]])
    goal = int(islands.number[cells[1]])
    its = f"{goal} ({islands.areas[goal]:.2f} m²)"
    own = f"{home} ({islands.areas[home]:.2f} m²)"
    text = f"the goal is in island {its}, the start in island {own}"
    if distance[one] >= reach:
        return f"{text}, which have no level in common", None
    a, b = (_text(place) for place in flat.positions(cells))
    return f"{text}; their nearest cells are {distance[one]:.2f} m apart, at {a} and {b}", cells


def name_blocks(search: Search, origin: int, goals: Int) -> str | None:
    """Name the current blocks on the route that a grid without them has."""
    grid = search.grid
    flat = search.flat
    clean = grid.without_blocks()
    route = None if clean is grid else find_route(clean, search, origin, goals)
    if route is None:
        return None
    stops = np.flatnonzero(~flat.free[route])
    around = route[max(stops[0] - BESIDE, 0) : stops[-1] + BESIDE + 1]
    is_stairs = np.ptp(flat.positions(around)[:, 2]) > RISE
    levels = np.unique(flat.level_of(route)).tolist()
    between = ""
    if is_stairs and len(levels) > 1:
        between = f" between {_level(grid, levels[0])} and {_level(grid, levels[-1])}"
    where = f"{_text(flat.positions(route[stops[0]]))}{between}"
    what, verb = ("stairs", "are") if is_stairs else ("way", "is")
    closed = "".join(f" {steps}," for steps in _closed_steps(search))
    return f"the {what} at {where}{',' if closed else ''}{closed} {verb} blocked for now"


def name_doors(search: Search, origin: int, goals: Int) -> str | None:
    """Name the doors on the route through the fewest cells that doors block."""
    grid = search.grid
    flat = search.flat
    if not grid.doors:
        return None
    radius = grid.inflated_radius
    without = deflated(grid.without_blocks()).with_doors("removed")
    free = np.concatenate([level.free.ravel() for level in without.levels])
    without = with_weights(without, np.where(free, np.where(flat.free, 1.0, SHUT), np.inf))
    if radius:
        without = without.inflate(radius, ledges=inflation.ledges_of(grid))
    route = find_route(without, search, origin, goals)
    blocked = NO_CELLS if route is None else route[~flat.free[route]]
    # a door blocks all cells from which the agent's disc reaches it
    stands = np.array([cell for cell in search.doors if search.occupied[cell]], dtype=np.int64)
    reach = grid.radius + 1.5 * float(flat.layout.cell_size.max())
    tree = spatial.cKDTree(flat.positions(stands))
    near = tree.query(flat.positions(blocked), distance_upper_bound=reach)[1]
    names = list(dict.fromkeys(doors_on(search.doors, stands[near[near < len(stands)]])))
    if not names:
        return None
    states = {door.id: door.state for door in grid.doors}
    states |= {name: "as modelled" for name, state in states.items() if state == "modelled"}
    listed = " and ".join(f"{name!r} ({states[name]})" for name in names)
    return f"doors {listed} are in the way" if len(names) > 1 else f"door {listed} is in the way"


def name_gap(search: Search, origin: int, goals: Int) -> str | None:
    """Name what the agent's radius closed: steps, links and doors on the way, else the gap [m].

    None if the grid isn't inflated, or no smaller radius passes.
    """
    grid = search.grid
    flat = search.flat
    agent = search.grid.inflated_radius
    if not agent:
        return None
    plain = search_as(deflated(grid.without_blocks()), search)
    widest = find_widest(plain.grid, search, origin, goals, inflation.ledges_of(grid))
    if widest is None:
        return None
    radius = widest[0]
    width = 2 * widest[0]
    weights = np.where(plain.flat.free, np.where(flat.free, 1.0, NARROW), np.inf)
    route = find_route(with_weights(plain.grid, weights), search, origin, goals)
    way = NO_CELLS if route is None else route
    closed = [
        name for name, cells in find_closed_connections(plain, search) if np.isin(cells, way).any()
    ]
    if closed:
        is_one = len(closed) == 1 and not closed[0].startswith("the stairs")
        names = f"{' and '.join(closed)} {'is' if is_one else 'are'}"
        return f"{names} closed for a radius of {agent:g} m, and {radius:g} m passes"
    if math.isinf(radius):
        return None
    cell = find_bottleneck(plain.grid, search, origin, goals, widest, False)
    # the occupied squares round it
    number, row, col = flat.cell(cell)
    level = plain.grid.levels[number]
    size = flat.layout.cell_size[number]
    span = int(4 * radius / size) + 2
    row0 = max(row - span, 0)
    col0 = max(col - span, 0)
    rows, cols = np.nonzero(level.solid[row0 : row + span + 1, col0 : col + span + 1])
    centers = level.lattice.positions(rows + row0, cols + col0)
    here = level.lattice.positions(row, col)
    low = centers - size / 2
    high = centers + size / 2
    nearest = np.clip(here, low, high) - here
    distance = np.linalg.norm(nearest, axis=1)
    if len(distance):
        # from the square nearest to the other side, within 60 degrees of the opposite direction
        k = int(np.argmin(distance))
        opposite = nearest @ -nearest[k] > 0.5 * distance * distance[k]
        if opposite.any():
            side = here + nearest[k]
            across = np.linalg.norm(np.clip(side, low, high) - side, axis=1)
            width = float(across[opposite].min())
    where = _text(flat.positions(cell))
    return f"the gap between, at {where}, is {width:.2f} m wide, the agent {2 * agent:.2f} m"


def name_links_and_areas(search: Search, origin: int, goals: Int) -> str | None:
    """Name the first link or area that the agent can't use on the route with all of them open."""
    grid = search.grid
    flat = search.flat
    if not (grid.links or grid.areas):
        return None
    is_open = search_as(grid, search, radius=0.0, penalty=SHUT)
    found = is_open.route(origin, goals)
    if found is None:
        return None
    numbers = dict(is_open.measure(found, flat.split(found.cells), "cost")[2])
    by_name = {link.name: link for link in grid.links}
    radius = search.radius
    for at, cell in enumerate(found.cells.tolist()):
        if at in numbers:
            link = by_name[numbers[at]]
            why = link.refuses(search.agent)
            if why is None and not link.fits(radius):
                why = f"is {link.width:g} m wide, narrower than the agent's {2.0 * radius:g} m"
            ends = [found.cells[at - 1], cell]
            if why is None and not (flat.arcs.ends == ends).all(axis=1).any():
                why = "leads the other way only"
            if why:
                return f"the link {link.name!r} ({link.kind}) {why}"
        # a diagonal step also needs the two cells beside it
        before = int(found.cells[at - 1]) if at and not found.by_link[at] else cell
        across = flat.cell(cell).col - flat.cell(before).col
        for needed in (before + across, cell - across, cell):
            if (area := _barring_area(search, needed)) is not None:
                return f"the {' '.join(area)}"
    return None


def _barring_area(search: Search, cell: int) -> tuple[str, str] | None:
    """The area of a cell that bars the agent, as "area 'lab'", and whom it bars; None for none."""
    price = search.flat.price
    agent = search.agent
    if len(price) == 1 or math.isfinite(price[cell]):
        return None
    level, row, col = search.flat.cell(cell)
    area = search.grid.areas[search.grid.levels[level].area_index[row, col] - 1]
    whom = repr(agent.name) if agent and math.isfinite(area.cost) else "all agents"
    return f"area {area.name!r}", f"bars {whom}"


def name_steps(search: Search, origin: int, goals: Int) -> str | None:
    """Name the levels that no step joins, or only steps that are blocked."""
    flat = search.flat
    home = int(flat.level_of(origin))
    if home in flat.level_of(goals):
        return None
    closed = _closed_steps(search)
    if closed:
        leads = "leads" if len(closed) == 1 and closed[0].startswith("the step") else "lead"
        return f"{', '.join(closed)} {leads} to cells that aren't free"
    if not len(flat.steps.cell):
        return f"no steps lead from {_level(search.grid, home)} to another level"
    return None


def _closed_steps(search: Search) -> list[str]:
    """Describe each pair of levels whose steps are all blocked."""
    flat = search.flat
    closed = []
    source, target = flat.step_ends()
    low = flat.level_of(source)
    high = flat.level_of(target)
    is_open = flat.free[source] & flat.free[target]
    for a, b in np.unique(np.stack([low, high], axis=1)[low < high], axis=0).tolist():
        of_pair = (low == a) & (high == b)
        if not is_open[of_pair].any():
            steps = "the step" if of_pair.sum() == 1 else f"all {of_pair.sum()} steps"
            closed.append(f"{steps} from {_level(search.grid, a)} to {_level(search.grid, b)}")
    return closed


CAUSES = (name_blocks, name_doors, name_links_and_areas, name_gap, name_steps)
"""What may be why there is no path, in the order in which they are looked for."""


def _names(search: Search, cells: Int) -> str:
    """The names of the things that block cells, if the file has them."""
    grid = search.grid
    flat = search.flat
    blocked = cells[~flat.free[cells]]
    levels = flat.level_of(blocked)
    x, y, _ = flat.positions(blocked).T
    ways = zip(x.tolist(), y.tolist(), levels.tolist(), strict=True)
    listed = list(dict.fromkeys(name for at in ways for name in grid.blockers(*at)))
    return list_first(listed, MAX_NAMES)


def _level(grid: NavGrid, number: int) -> str:
    name = grid.level_names[number]
    return name if name == f"level {number}" else f"level {number} ({name})"


def _text(position: ArrayLike) -> str:
    return f"({', '.join(f'{v:.2f}' for v in np.asarray(position))})"
