"""Says in one sentence why there is no path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.navgrid.block_state import BLOCKED
from navbake.runtime.inflation.margins import agent_radius, exact_radius
from navbake.runtime.paths.door_map import doors_on, map_doors
from navbake.runtime.paths.gap import deflated, find_gap
from navbake.runtime.paths.goals import Target
from navbake.runtime.paths.search import Search

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.path_finder import PathFinder

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MAX_NAMES = 4  # of what blocks, listed in a sentence
RISE = 0.05  # metres over which the floor rises beside what is called stairs
BESIDE = 3  # cells along a route that are beside


def explain(finder: PathFinder, start: Floats, origin: int, target: Target) -> str | None:
    """Say why there is no path.

    Args:
        finder: plans on the grid.
        start: world position [m].
        origin: flat id of its cell, -1 for none.
        target: where to.

    Returns:
        One sentence; None if there is a path.
    """
    search = finder.search
    if origin < 0 or not search.walk.free[origin]:
        return f"the start {_trouble(finder, start, origin)}"
    goals = target.free_cells(search.walk)
    if not len(goals):
        return _goals_trouble(finder, target)
    if search.route(origin, goals) is not None:
        return None
    parted, cells = _parted(finder, origin, goals)
    because = (
        _blocked_for_now(finder, origin, goals)
        or _doors(finder, origin, goals)
        or _gap(finder, origin, goals)
        or _links(finder, origin, goals)
        or _between(finder, cells)
    )
    return f"{parted}; {because}" if because else parted


def _goals_trouble(finder: PathFinder, target: Target) -> str:
    if target.positions is not None and len(target.positions) == 1:
        return f"the goal {_trouble(finder, target.positions[0], int(target.cells[0]))}"
    if target.positions is not None:
        first = _trouble(finder, target.positions[0], int(target.cells[0]))
        return f"none of the {len(target.positions)} goals is free: the first {first}"
    if target.name.startswith("room"):
        return f"no cell of {target.name} is free for a radius of {_radius(finder.grid)}"
    return f"no cell within 1 m of {target.name} is free for a radius of {_radius(finder.grid)}"


def _radius(grid: NavGrid) -> str:
    return f"{agent_radius(grid):g} m"


def _trouble(finder: PathFinder, position: Floats, cell: int) -> str:
    """What is wrong with a place, and where the nearest good one is."""
    grid, walk = finder.grid, finder.search.walk
    here = _text(position)
    if cell < 0:
        boxes = np.array([level.lattice.bounds for level in grid.levels])
        x0, y0 = boxes[:, :2].min(axis=0)
        x1, y1 = boxes[:, 2:].max(axis=0)
        if x0 <= position[0] <= x1 and y0 <= position[1] <= y1:
            what = f"{here} has no floor below it"
        else:
            what = f"{here} lies beside the grid, x {x0:g} to {x1:g}, y {y0:g} to {y1:g}"
    else:
        what = f"{here} {_not_free(finder, cell)}"
    free = np.flatnonzero(walk.free)
    if not len(free):
        return f"{what}, and no cell is free at all"
    level = 0 if cell < 0 else int(walk.level_of(np.array(cell)))
    z = position[2] if len(position) == 3 else walk.ground[level]
    places = walk.positions(free)
    distance = np.linalg.norm(places - [position[0], position[1], z], axis=1)
    k = int(np.argmin(distance))
    return f"{what}; the nearest free cell is at {_text(places[k])}, {distance[k]:.2f} m away"


def _not_free(finder: PathFinder, cell: int) -> str:
    grid, walk = finder.grid, finder.search.walk
    level = int(walk.level_of(np.array(cell)))
    part, at = grid.levels[level], cell - int(walk.start[level])
    row, col = divmod(at, part.width)
    changes = part.block_state
    if changes is not None and changes.count[BLOCKED, at]:
        return "is blocked for now"
    if np.isnan(part.floor_height[row, col]):
        return "is on no floor"
    if part.occupancy[row, col]:
        names = _names(finder, np.array([cell]))
        return f"is where something stands{f' ({names})' if names else ''}"
    return f"is too near to what stands beside it for a radius of {_radius(grid)}"


def _parted(finder: PathFinder, origin: int, goals: Ints) -> tuple[str, Ints | None]:
    """Tell of the two islands; and the cells where they are nearest, if on one level."""
    from scipy.spatial import cKDTree

    walk, islands = finder.search.walk, finder.islands
    home = islands.number[origin]
    away = np.unique(islands.number[goals])
    edge = walk.free & (finder.search.moves != 255)
    ones, others = (np.flatnonzero(edge & np.isin(islands.number, which)) for which in (home, away))
    reach = 10.0 * float(walk.start[-1])  # a level apart: farther than anything on one
    places = [
        np.column_stack([walk.positions(c)[:, :2], walk.level_of(c) * reach])
        for c in (ones, others)
    ]
    distance, index = cKDTree(places[1]).query(places[0])
    one = int(np.argmin(distance))
    cells = np.array([ones[one], others[index[one]]])
    goal = int(islands.number[cells[1]])
    text = (
        f"the goal is in island {goal} ({islands.areas[goal]:.2f} m²), the start in island "
        f"{home} ({islands.areas[home]:.2f} m²)"
    )
    if distance[one] >= reach:
        return f"{text}, which have no level in common", None
    a, b = (_text(place) for place in walk.positions(cells))
    return f"{text}; their nearest cells are {distance[one]:.2f} m apart, at {a} and {b}", cells


def _blocked_for_now(finder: PathFinder, origin: int, goals: Ints) -> str | None:
    """What `grid.block` blocks on the way there would be."""
    grid, walk = finder.grid, finder.search.walk
    clean = grid.without_blocks()
    if clean is grid:
        return None
    route = Search(clean, cut_corners=finder.search.cut_corners).route(origin, goals)
    if route is None:
        return None
    stops = np.flatnonzero(~walk.free[route])
    around = route[max(stops[0] - BESIDE, 0) : stops[-1] + BESIDE + 1]
    heights = walk.positions(around)[:, 2]
    what = "the stairs" if np.ptp(heights) > RISE else "the way"
    text = f"{what} at {_text(walk.positions(route[stops[0]]))}"
    if what == "the stairs":
        levels = np.unique(walk.level_of(route))
        if len(levels) > 1:
            text += f" between {_level(grid, int(levels[0]))} and {_level(grid, int(levels[-1]))}"
    for low, high, total in _closed_links(finder):
        text += f", {_steps(grid, low, high, total)},"
    return f"{text.rstrip(',')} {'are' if what == 'the stairs' else 'is'} blocked for now"


def _doors(finder: PathFinder, origin: int, goals: Ints) -> str | None:
    """The doors that would join start and goal if they weren't there."""
    grid, walk = finder.grid, finder.search.walk
    if not grid.doors:
        return None
    radius = exact_radius(grid)
    without = deflated(grid.without_blocks()).with_doors("removed")
    if radius:
        without = without.inflate(radius)
    route = Search(without, cut_corners=finder.search.cut_corners).route(origin, goals)
    if route is None:
        return None
    passed = doors_on(map_doors(grid, walk), route[~walk.free[route]])
    names = list(dict.fromkeys(passed))
    if not names:
        return None
    states = {door.id: door.state for door in grid.doors}
    states |= {name: "as modelled" for name, state in states.items() if state == "modelled"}
    listed = " and ".join(f"{name!r} ({states[name]})" for name in names)
    return f"doors {listed} are in the way" if len(names) > 1 else f"door {listed} is in the way"


def _gap(finder: PathFinder, origin: int, goals: Ints) -> str | None:
    """How wide the widest way is at its narrowest."""
    gap = find_gap(finder.grid, finder.search.walk, origin, goals)
    if gap is None:
        return None
    return (
        f"the gap between, at {_text(gap.position)}, is {gap.width:.2f} m wide, the agent "
        f"{2 * exact_radius(finder.grid):.2f} m"
    )


def _links(finder: PathFinder, origin: int, goals: Ints) -> str | None:
    """Tell of levels that no step joins, or none any more."""
    walk = finder.search.walk
    home = int(walk.level_of(np.array(origin)))
    away = np.unique(walk.level_of(goals))
    if home in away:
        return None
    closed = [_steps(finder.grid, low, high, total) for low, high, total in _closed_links(finder)]
    if closed:
        leads = "leads" if len(closed) == 1 and closed[0].startswith("the step") else "lead"
        return f"{', '.join(closed)} {leads} to cells that aren't free"
    if not len(walk.link_cell):
        return f"no steps lead from {_level(finder.grid, home)} to another level"
    return None


def _closed_links(finder: PathFinder) -> list[tuple[int, int, int]]:
    """Pairs of levels with steps between them none of which can be taken, and how many."""
    walk = finder.search.walk
    source = np.repeat(walk.link_cell, np.diff(walk.link_start))
    low, high = walk.level_of(source), walk.level_of(walk.link_target)
    is_open = walk.free[source] & walk.free[walk.link_target]
    closed = []
    for a, b in sorted(set(zip(low.tolist(), high.tolist(), strict=True))):
        of_pair = (low == a) & (high == b)
        if a < b and not is_open[of_pair].any():
            closed.append((a, b, int(of_pair.sum())))
    return closed


def _between(finder: PathFinder, cells: Ints | None) -> str | None:
    """What stands on the straight line between the nearest cells."""
    if cells is None:
        return None
    walk = finder.search.walk
    level = int(walk.level_of(cells)[0])
    width = int(walk.width[level])
    rows, cols = np.divmod(cells - walk.start[level], width)
    count = int(np.abs([np.diff(rows), np.diff(cols)]).max()) + 1
    line = [np.rint(np.linspace(v[0], v[1], count)).astype(np.int64) for v in (rows, cols)]
    names = _names(finder, walk.start[level] + line[0] * width + line[1])
    return f"between them: {names}" if names else None


def _names(finder: PathFinder, cells: Ints) -> str:
    """The names of what blocks cells, as far as the file tells."""
    grid, walk = finder.grid, finder.search.walk
    names: dict[str, None] = {}
    for cell in cells.tolist():
        level = int(walk.level_of(np.array(cell)))
        x, y, _ = walk.positions(np.array(cell))
        if not walk.free[cell]:
            names.update(dict.fromkeys(grid.blockers(float(x), float(y), level)))
    listed = list(names)
    more = f" and {len(listed) - MAX_NAMES} more" if len(listed) > MAX_NAMES else ""
    return ", ".join(listed[:MAX_NAMES]) + more


def _steps(grid: NavGrid, low: int, high: int, total: int) -> str:
    if total == 1:
        return f"the step from {_level(grid, low)} to {_level(grid, high)}"
    return f"all {total} steps from {_level(grid, low)} to {_level(grid, high)}"


def _level(grid: NavGrid, number: int) -> str:
    name = grid.level_names[number]
    return name if name == f"level {number}" else f"level {number} ({name})"


def _text(position: ArrayLike) -> str:
    return f"({', '.join(f'{v:.2f}' for v in np.asarray(position))})"
