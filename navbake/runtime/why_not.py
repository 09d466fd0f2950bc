"""Says in one sentence why there is no path."""

import numpy as np
from numpy.typing import ArrayLike

from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid
from navbake.runtime.inflation import agent_radius, exact_radius, ledges_of
from navbake.runtime.passage import deflated, find_gap
from navbake.runtime.paths import Goal, find_target
from navbake.runtime.place import place_in
from navbake.runtime.regions import doors_on
from navbake.runtime.search import Search
from navbake.types import Float, Int

spatial = lazy("scipy.spatial")  # few need it

MAX_NAMES = 4  # of what blocks, listed in a sentence
RISE = 0.05  # metres: where the floor rises by more, the way is called stairs
BESIDE = 3  # cells along a route, before and after what blocks it, that show whether it rises


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
        return f"{where} is free for a radius of {agent_radius(search.grid):g} m"
    if search.route(origin, goals) is not None:
        return None
    apart, cells = _apart(search, origin, goals)
    because = (
        _blocked_for_now(search, origin, goals)
        or _doors(search, origin, goals)
        or _gap(search, origin, goals)
        or _links(search, origin, goals)
        or _obstacles_between(search, cells)
    )
    return f"{apart}; {because}" if because else apart


def _why_not_free(search: Search, position: Float, cell: int) -> str:
    """Why no agent can stand at a position, and where the nearest free cell is."""
    grid, flat = search.grid, search.flat
    if cell < 0:
        boxes = np.array([level.lattice.bounds for level in grid.levels])
        x0, y0 = boxes[:, :2].min(axis=0)
        x1, y1 = boxes[:, 2:].max(axis=0)
        what = f"lies beside the grid, x {x0:g} to {x1:g}, y {y0:g} to {y1:g}"
        if x0 <= position[0] <= x1 and y0 <= position[1] <= y1:
            what = "has no floor below it"
    else:
        place = place_in(grid, flat.cell(cell))
        if place.is_blocked:
            what = "is blocked for now"
        elif place.floor is None:
            what = "is on no floor"
        elif place.occupied:
            names = _names(search, np.array([cell]))
            what = f"is where something stands{f' ({names})' if names else ''}"
        else:
            radius = agent_radius(grid)
            what = f"is too near to what stands beside it for a radius of {radius:g} m"
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
    """Name the two islands, and find their two nearest cells, if on one level."""
    flat, islands = search.flat, search.islands
    home = islands.number[origin]
    away = np.unique(islands.number[goals])
    edge = flat.free & (search.graph.moves != 255)
    ones, others = (np.flatnonzero(edge & np.isin(islands.number, which)) for which in (home, away))
    # One tree for all levels: as a third coordinate, each level is farther from the next than any
    # two cells of one level can be.
    reach = 10.0 * float(flat.layout.start[-1])
    places = [
        np.column_stack([flat.positions(c)[:, :2], flat.level_of(c) * reach])
        for c in (ones, others)
    ]
    distance, index = spatial.cKDTree(places[1]).query(places[0])
    one = int(np.argmin(distance))
    cells = np.array([ones[one], others[index[one]]])
    goal = int(islands.number[cells[1]])
    text = (
        f"the goal is in island {goal} ({islands.areas[goal]:.2f} m²), the start in island "
        f"{home} ({islands.areas[home]:.2f} m²)"
    )
    if distance[one] >= reach:
        return f"{text}, which have no level in common", None
    a, b = (_text(place) for place in flat.positions(cells))
    return f"{text}; their nearest cells are {distance[one]:.2f} m apart, at {a} and {b}", cells


def _blocked_for_now(search: Search, origin: int, goals: Int) -> str | None:
    """What `grid.block` blocks on the way there would be."""
    grid, flat = search.grid, search.flat
    clean = grid.without_blocks()
    if clean is grid:
        return None
    route = Search(clean, cut_corners=search.cut_corners).route(origin, goals)
    if route is None:
        return None
    stops = np.flatnonzero(~flat.free[route])
    around = route[max(stops[0] - BESIDE, 0) : stops[-1] + BESIDE + 1]
    heights = flat.positions(around)[:, 2]
    is_stairs = np.ptp(heights) > RISE
    text = f"the {'stairs' if is_stairs else 'way'} at {_text(flat.positions(route[stops[0]]))}"
    if is_stairs:
        levels = np.unique(flat.level_of(route))
        if len(levels) > 1:
            text += f" between {_level(grid, int(levels[0]))} and {_level(grid, int(levels[-1]))}"
    for low, high, total in _closed_links(search):
        text += f", {_steps(grid, low, high, total)},"
    return f"{text.rstrip(',')} {'are' if is_stairs else 'is'} blocked for now"


def _doors(search: Search, origin: int, goals: Int) -> str | None:
    """The doors that would join start and goal if they weren't there."""
    grid, flat = search.grid, search.flat
    if not grid.doors:
        return None
    radius = exact_radius(grid)
    without = deflated(grid.without_blocks()).with_doors("removed")
    if radius:
        without = without.inflate(radius, ledges=ledges_of(grid))
    route = Search(without, cut_corners=search.cut_corners).route(origin, goals)
    if route is None:
        return None
    names = list(dict.fromkeys(doors_on(search.doors, route[~flat.free[route]])))
    if not names:
        return None
    states = {door.id: door.state for door in grid.doors}
    states |= {name: "as modelled" for name, state in states.items() if state == "modelled"}
    listed = " and ".join(f"{name!r} ({states[name]})" for name in names)
    return f"doors {listed} are in the way" if len(names) > 1 else f"door {listed} is in the way"


def _gap(search: Search, origin: int, goals: Int) -> str | None:
    """How wide the widest way is at its narrowest."""
    gap = find_gap(search.grid, search.flat, origin, goals)
    if gap is None:
        return None
    (width, position), agent = gap, 2 * exact_radius(search.grid)
    return f"the gap between, at {_text(position)}, is {width:.2f} m wide, the agent {agent:.2f} m"


def _links(search: Search, origin: int, goals: Int) -> str | None:
    """Name levels that no step joins, or no step that can be taken."""
    flat = search.flat
    home = int(flat.level_of(origin))
    away = np.unique(flat.level_of(goals))
    if home in away:
        return None
    closed = [_steps(search.grid, low, high, total) for low, high, total in _closed_links(search)]
    if closed:
        leads = "leads" if len(closed) == 1 and closed[0].startswith("the step") else "lead"
        return f"{', '.join(closed)} {leads} to cells that aren't free"
    if not len(flat.links.cell):
        return f"no steps lead from {_level(search.grid, home)} to another level"
    return None


def _closed_links(search: Search) -> list[tuple[int, int, int]]:
    """Pairs of levels with steps between them none of which can be taken, and how many."""
    flat = search.flat
    source, target = flat.link_ends()
    low, high = flat.level_of(source), flat.level_of(target)
    is_open = flat.free[source] & flat.free[target]
    closed = []
    for a, b in np.unique(np.stack([low, high], axis=1)[low < high], axis=0).tolist():
        of_pair = (low == a) & (high == b)
        if not is_open[of_pair].any():
            closed.append((a, b, int(of_pair.sum())))
    return closed


def _obstacles_between(search: Search, cells: Int | None) -> str | None:
    """What stands on the straight line between the nearest cells."""
    if cells is None:
        return None
    flat = search.flat
    level = int(flat.level_of(cells)[0])
    width = int(flat.layout.width[level])
    rows, cols = np.divmod(cells - flat.layout.start[level], width)
    count = int(np.abs([np.diff(rows), np.diff(cols)]).max()) + 1
    line = [np.rint(np.linspace(v[0], v[1], count)).astype(np.int64) for v in (rows, cols)]
    names = _names(search, flat.layout.start[level] + line[0] * width + line[1])
    return f"between them: {names}" if names else None


def _names(search: Search, cells: Int) -> str:
    """The names of what blocks cells, as far as the file tells."""
    grid, flat = search.grid, search.flat
    names: dict[str, None] = {}
    for cell in cells[~flat.free[cells]].tolist():
        x, y, _ = flat.positions(cell).tolist()
        names.update(dict.fromkeys(grid.blockers(x, y, int(flat.level_of(cell)))))
    listed = list(names)
    more = f" and {len(listed) - MAX_NAMES} more" if len(listed) > MAX_NAMES else ""
    return ", ".join(listed[:MAX_NAMES]) + more


def _steps(grid: NavGrid, low: int, high: int, total: int) -> str:
    steps = "the step" if total == 1 else f"all {total} steps"
    return f"{steps} from {_level(grid, low)} to {_level(grid, high)}"


def _level(grid: NavGrid, number: int) -> str:
    name = grid.level_names[number]
    return name if name == f"level {number}" else f"level {number} ({name})"


def _text(position: ArrayLike) -> str:
    return f"({', '.join(f'{v:.2f}' for v in np.asarray(position))})"
