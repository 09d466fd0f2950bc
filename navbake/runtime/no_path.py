"""Explains why there is no path from a place to a goal, in one sentence."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.known_names import list_first
from navbake.lazy import lazy
from navbake.lengths import format_length
from navbake.navgrid.cells import describe_outside, place_in
from navbake.navgrid.grid import NavGrid
from navbake.runtime.agents import FLOOR_ROUNDING, fit_grid
from navbake.runtime.flat_grid import STAIRS_RISE, list_doors_along
from navbake.runtime.inflation import ledges_setting
from navbake.runtime.passage import (
    NARROW_WEIGHT,
    find_bottleneck,
    find_lost_connections,
    find_route_cells,
    find_widest,
    similar_search,
    with_weights,
    without_inflation,
)
from navbake.runtime.paths import Goal, Target, find_target
from navbake.runtime.search import NO_CELLS, Route, Search
from navbake.types import Float, Int

spatial = lazy("scipy.spatial")  # saves scipy at start-up

# weight of a cell that a door blocks: a route of 10 km costs as much as 1 m of it
DOOR_WEIGHT = 10_000.0
# added to the cost of links that the agent may not use [m], and the factor by which areas that bar
# it multiply weights
FORBIDDEN_PENALTY = 10_000.0
ROUNDING_ERROR = 1e-6  # what floats lose of a length, in millimetres
MAX_NAMES = 4  # how many names of obstacles a sentence lists
RISE_MARGIN = 3  # cells of a route before and after its blocked part that count for its rise
ALL_MOVES = 255  # the moves of a cell from which moves lead in all directions


def why_not(search: Search, start: ArrayLike, goal: Goal, level: int | None) -> str | None:
    """Say in one sentence why there is no path: `PathFinder.why_not`.

    Args:
        search: the search on the grid, up to date with added obstacles.
        start: world x, y, z [m].
        goal: a position, several of them, ``room:NAME`` or ``object:NAME``.
        level: the level of positions; None finds each one's level by its z.

    Returns:
        The sentence; None if there is a path.

    Raises:
        QueryError: an argument is not valid.
    """
    flat = search.flat
    start_position, start_cell = flat.locate(start, level, "start")
    target = find_target(search, goal, level)
    if start_cell < 0 or not flat.free[start_cell]:
        return f"the start {_describe_blocked(search, start_position, start_cell)}"
    goal_cells = target.free_cells(flat)
    if not len(goal_cells):
        return describe_blocked_goal(search, target)
    if search.find_route(start_cell, goal_cells) is not None:
        return None
    description, nearest_cells = _describe_islands(search, start_cell, goal_cells)
    reason = None
    for explain in EXPLANATIONS:
        reason = explain(search, start_cell, goal_cells)
        if reason:
            break
    if not reason and nearest_cells is not None:
        names_text = _name_obstacles(search, _cells_between(search, nearest_cells))
        reason = f"between them: {names_text}" if names_text else None
    return f"{description}; {reason}" if reason else description


def describe_blocked_goal(search: Search, target: Target) -> str:
    """Say in one sentence why no cell of a goal is free.

    Args:
        search: the search on the grid, up to date with added obstacles.
        target: the goal's cells, none of them free.
    """
    if target.positions is not None:
        first_reason = _describe_blocked(search, target.positions[0], int(target.cells[0]))
        if len(target.positions) == 1:
            return f"the goal {first_reason}"
        return f"none of the {len(target.positions)} goals is free: the first {first_reason}"
    cells_text = f"no cell of {target.name}"
    if not target.name.startswith("room"):
        cells_text = f"no cell within 1 m of {target.name}, not counting those behind walls,"
    return f"{cells_text} is free for a radius of {search.grid.radius:g} m"


def _describe_blocked(search: Search, position: Float, cell: int) -> str:
    """Say why a position isn't free, and where the nearest free cell is.

    `cell` is the flat id of the position's cell, -1 for none.
    """
    grid = search.grid
    flat = search.flat
    area = None if cell < 0 else _find_barring_area(search, cell)
    if cell < 0:
        reason = describe_outside(grid, position)
    elif area is not None:
        reason = f"lies in the {area.name}, which {area.verdict}"
    else:
        cell_content = place_in(grid, flat.to_cell(cell))
        if cell_content.is_blocked:
            reason = "is blocked for now"
        elif cell_content.floor is None:
            reason = "is on no floor"
        elif cell_content.occupied:
            names_text = _name_obstacles(search, np.array([cell]))
            reason = f"is where something stands{f' ({names_text})' if names_text else ''}"
        else:
            reason = f"is too near to what stands beside it for a radius of {grid.radius:g} m"
    description = f"{format_point(position)} {reason}"
    free_cells = np.flatnonzero(flat.free)
    if not len(free_cells):
        return f"{description}, and no cell is free at all"
    level = 0 if cell < 0 else int(flat.level_of(cell))
    z = position[2] if len(position) == 3 else flat.floors.ground[level]
    free_positions = flat.positions(free_cells)
    distances = np.linalg.norm(free_positions - [position[0], position[1], z], axis=1)
    nearest_index = int(np.argmin(distances))
    place_text = (
        f"at {format_point(free_positions[nearest_index])}, {distances[nearest_index]:.2f} m away"
    )
    return f"{description}; the nearest free cell is {place_text}"


def _describe_islands(search: Search, start_cell: int, goal_cells: Int) -> tuple[str, Int | None]:
    """Say which islands the start and the goals are in, and how near these are to each other.

    Returns:
        A clause; and the flat ids of the two nearest cells of both islands on one level, None if
        no level has cells of both.
    """
    flat = search.flat
    islands = search.islands
    start_island = islands.number[start_cell]
    goal_islands = np.unique(islands.number[goal_cells])
    is_at_edge = flat.free & (search.graph.moves != ALL_MOVES)
    start_edge_cells = np.flatnonzero(is_at_edge & np.isin(islands.number, start_island))
    goal_edge_cells = np.flatnonzero(is_at_edge & np.isin(islands.number, goal_islands))
    # One tree for all levels: by a fourth coordinate, each level is farther from the next than any
    # two cells of one level can be. Heights count, as the top of a stair is over the floor below.
    level_distance = 10.0 * float(flat.layout.start[-1])

    def to_tree_coordinates(cells: Int) -> Float:
        level_offsets = flat.level_of(cells) * level_distance
        return np.column_stack([flat.positions(cells), level_offsets])

    distances, goal_indices = spatial.cKDTree(to_tree_coordinates(goal_edge_cells)).query(
        to_tree_coordinates(start_edge_cells)
    )
    nearest_index = int(np.argmin(distances))
    nearest_cells = np.array(
        [start_edge_cells[nearest_index], goal_edge_cells[goal_indices[nearest_index]]]
    )
    goal_island = int(islands.number[nearest_cells[1]])
    goal_text = f"{goal_island} ({islands.areas[goal_island]:.2f} m²)"
    start_text = f"{start_island} ({islands.areas[start_island]:.2f} m²)"
    description = f"the goal is in island {goal_text}, the start in island {start_text}"
    if distances[nearest_index] >= level_distance:
        return f"{description}, which have no level in common", None
    start_point, goal_point = flat.positions(nearest_cells)
    points_text = f"at {format_point(start_point)} and {format_point(goal_point)}"
    gap_text = f"their nearest cells are {distances[nearest_index]:.2f} m apart, {points_text}"
    return f"{description}; {gap_text}", nearest_cells


def _cells_between(search: Search, end_cells: Int) -> Int:
    """List the cells on the straight line between two cells of a level, by flat id."""
    flat = search.flat
    level, row, col = flat.to_cells(end_cells)
    num_cells = int(np.abs(np.diff([row, col])).max()) + 1
    line_coordinates = np.linspace((row[0], col[0]), (row[1], col[1]), num_cells)
    rows_and_cols = np.rint(line_coordinates).astype(np.int64)
    width = flat.layout.width[level[0]]
    cells: Int = flat.layout.start[level[0]] + rows_and_cols @ [width, 1]
    return cells


def explain_by_obstacles(search: Search, start_cell: int, goal_cells: Int) -> str | None:
    """Say where added obstacles block the route that would exist without them.

    Args:
        search: the search on the grid, up to date with added obstacles.
        start_cell: flat id of a free cell.
        goal_cells: flat ids of free cells.

    Returns:
        A clause, such as ``the way at (1.00, 2.00, 0.00) is blocked for now``; None if there are
        no added obstacles, or no route without them.
    """
    grid = search.grid
    flat = search.flat
    grid_without_added = grid.without_obstacles()
    if grid_without_added is grid:
        return None
    route_cells = find_route_cells(grid_without_added, search, start_cell, goal_cells)
    if route_cells is None:
        return None
    blocked_indices = np.flatnonzero(~flat.free[route_cells])
    first_index = max(blocked_indices[0] - RISE_MARGIN, 0)
    last_index = blocked_indices[-1] + RISE_MARGIN
    blocked_part_cells = route_cells[first_index : last_index + 1]
    is_stairs = np.ptp(flat.positions(blocked_part_cells)[:, 2]) > STAIRS_RISE
    levels = np.unique(flat.level_of(route_cells)).tolist()
    between_text = ""
    if is_stairs and len(levels) > 1:
        first_level = _name_level(grid, levels[0])
        between_text = f" between {first_level} and {_name_level(grid, levels[-1])}"
    place_text = f"{format_point(flat.positions(route_cells[blocked_indices[0]]))}{between_text}"
    steps_text = "".join(f" {steps}," for steps in _describe_blocked_steps(search))
    comma = "," if steps_text else ""
    if is_stairs:
        return f"the stairs at {place_text}{comma}{steps_text} are blocked for now"
    return f"the way at {place_text}{comma}{steps_text} is blocked for now"


def explain_by_doors(search: Search, start_cell: int, goal_cells: Int) -> str | None:
    """Name the doors in the way of the route that has to pass the fewest blocked cells.

    The route is planned as if all doors and added obstacles were removed.

    Args:
        search: the search on the grid, up to date with added obstacles.
        start_cell: flat id of a free cell.
        goal_cells: flat ids of free cells.

    Returns:
        A clause, such as ``door 'kitchen' (closed) is in the way``; None if no door is in the
        way, or there is no such route.
    """
    grid = search.grid
    flat = search.flat
    if not grid.doors:
        return None
    doorless_grid = without_inflation(grid.without_obstacles()).with_doors("removed")
    is_free = np.concatenate([level.free.ravel() for level in doorless_grid.levels])
    weights = np.where(is_free, np.where(flat.free, 1.0, DOOR_WEIGHT), np.inf)
    doorless_grid = with_weights(doorless_grid, weights)
    if grid.inflated_radius:
        ledge_rule = ledges_setting(grid)
        doorless_grid = doorless_grid.inflate(grid.inflated_radius, ledges=ledge_rule)
    route_cells = find_route_cells(doorless_grid, search, start_cell, goal_cells)
    blocked_cells = NO_CELLS if route_cells is None else route_cells[~flat.free[route_cells]]
    # a door blocks all cells from which the agent's disc reaches it
    leaf_cells = np.array([cell for cell in search.doors if search.occupied[cell]], dtype=np.int64)
    max_distance = grid.radius + 1.5 * float(flat.layout.cell_size.max())
    leaf_tree = spatial.cKDTree(flat.positions(leaf_cells))
    _, nearest_indices = leaf_tree.query(
        flat.positions(blocked_cells), distance_upper_bound=max_distance
    )
    passed_leaf_cells = leaf_cells[nearest_indices[nearest_indices < len(leaf_cells)]]
    door_ids = list(dict.fromkeys(list_doors_along(search.doors, passed_leaf_cells)))
    if not door_ids:
        return None
    state_by_door = {door.id: door.state for door in grid.doors}
    state_word_by_door = {
        name: "as modelled" if state == "modelled" else state
        for name, state in state_by_door.items()
    }
    doors_text = " and ".join(f"{name!r} ({state_word_by_door[name]})" for name in door_ids)
    return (
        f"doors {doors_text} are in the way"
        if len(door_ids) > 1
        else f"door {doors_text} is in the way"
    )


def explain_by_gap(search: Search, start_cell: int, goal_cells: Int) -> str | None:
    """Say which stairs, links or doors are too narrow for the agent, or where the gap is.

    The function plans the route of an agent of radius 0, which avoids cells too narrow for the
    real agent where it can. It names the stairs, links and doors on this route that the real agent
    can't pass. If there are none, it gives the place and the width of the narrowest gap.

    Args:
        search: the search on the grid, up to date with added obstacles.
        start_cell: flat id of a free cell.
        goal_cells: flat ids of free cells.

    Returns:
        A clause, such as ``door 'kitchen' is closed for a radius of 0.3 m, and 0.25 m passes``.
        Of stairs it also says that a link may join their ends.
        None if the grid isn't inflated, or if even an agent of radius 0 can't get to a goal.
    """
    grid = search.grid
    flat = search.flat
    agent_radius = grid.inflated_radius
    if not agent_radius:
        return None
    point_search = similar_search(without_inflation(grid.without_obstacles()), search)
    point_grid = point_search.grid
    ledge_rule = ledges_setting(grid)
    widest = find_widest(point_grid, search, start_cell, goal_cells, ledge_rule)
    if widest is None:
        return None
    radius = widest.radius
    weights = np.where(point_search.flat.free, np.where(flat.free, 1.0, NARROW_WEIGHT), np.inf)
    weighted_grid = with_weights(point_grid, weights)
    route_cells = find_route_cells(weighted_grid, search, start_cell, goal_cells)
    cells_on_route = NO_CELLS if route_cells is None else route_cells
    lost_connection_names = [
        connection.name
        for connection in find_lost_connections(point_search, search)
        if np.isin(connection.cells, cells_on_route).any()
    ]
    if lost_connection_names:
        has_stairs = any(name.startswith("the stairs") for name in lost_connection_names)
        is_singular = len(lost_connection_names) == 1 and not has_stairs
        names_text = f"{' and '.join(lost_connection_names)} {'is' if is_singular else 'are'}"
        closed_text = f"{names_text} closed for a radius of {agent_radius:g} m"
        hint = "; if the agent can climb, a link in `links` joins their ends" if has_stairs else ""
        return f"{closed_text}, and {round_down(radius):g} m passes{hint}"
    if math.isinf(radius):
        return None
    bottleneck_cell = find_bottleneck(
        point_grid, search, start_cell, goal_cells, widest, cut_corners=False
    )
    width = _measure_gap(point_search, bottleneck_cell, radius)
    place_text = format_point(flat.positions(bottleneck_cell))
    agent_width = f"the agent {2 * agent_radius:.2f} m"
    return f"the gap between, at {place_text}, is {width:.2f} m wide, {agent_width}"


def _measure_gap(search: Search, cell: int, radius: float) -> float:
    """Measure the width of the gap between the occupied squares on both sides of a bottleneck.

    Args:
        search: the search on the grid without inflation.
        cell: flat id of the bottleneck.
        radius: the largest radius that passes there [m].

    Returns:
        The width [m]; twice the radius if no squares are on opposite sides of the cell.
    """
    level_number, row, col = search.flat.to_cell(cell)
    level = search.grid.levels[level_number]
    cell_size = search.flat.layout.cell_size[level_number]
    window_radius = int(4 * radius / cell_size) + 2
    first_row = max(row - window_radius, 0)
    first_col = max(col - window_radius, 0)
    window = level.solid[first_row : row + window_radius + 1, first_col : col + window_radius + 1]
    rows, cols = np.nonzero(window)
    centers = level.lattice.positions(rows + first_row, cols + first_col)
    bottleneck = level.lattice.positions(row, col)
    square_min = centers - cell_size / 2
    square_max = centers + cell_size / 2
    offsets_to_squares = np.clip(bottleneck, square_min, square_max) - bottleneck
    distances = np.linalg.norm(offsets_to_squares, axis=1)
    if not len(distances):
        return 2 * radius
    # from the nearest square to those on the other side, within 60 degrees of opposite to it
    nearest_index = int(np.argmin(distances))
    is_opposite = (
        offsets_to_squares @ -offsets_to_squares[nearest_index]
        > 0.5 * distances * distances[nearest_index]
    )
    if not is_opposite.any():
        return 2 * radius
    near_point = bottleneck + offsets_to_squares[nearest_index]
    widths = np.linalg.norm(np.clip(near_point, square_min, square_max) - near_point, axis=1)
    return float(widths[is_opposite].min())


def explain_by_links_and_areas(search: Search, start_cell: int, goal_cells: Int) -> str | None:
    """Say which link or area keeps the agent from the goal.

    The function plans a route that may use links and areas that bar the agent, at a high penalty
    each, and links of any width. It names the first link or area on it that the agent can't use.

    Args:
        search: the search on the grid, up to date with added obstacles.
        start_cell: flat id of a free cell.
        goal_cells: flat ids of free cells.

    Returns:
        A clause, such as ``the area 'lab' bars all agents``; None if there is no such link, area
        or route.
    """
    grid = search.grid
    flat = search.flat
    if not (grid.links or grid.areas):
        return None
    unrestricted_search = similar_search(grid, search, radius=0.0, penalty=FORBIDDEN_PENALTY)
    route = unrestricted_search.find_route(start_cell, goal_cells)
    if route is None:
        return None
    link_name_by_index = dict(
        unrestricted_search.measure_route(route, flat.to_cells(route.cells), "cost").links
    )
    for route_index, cell in enumerate(route.cells.tolist()):
        if route_index in link_name_by_index:
            clause = _explain_link(search, route, route_index, link_name_by_index[route_index])
            if clause:
                return clause
        # a diagonal step also needs the two cells beside it
        is_step = route_index > 0 and not route.is_by_link[route_index]
        previous_cell = int(route.cells[route_index - 1]) if is_step else cell
        col_step = flat.to_cell(cell).col - flat.to_cell(previous_cell).col
        for needed_cell in (previous_cell + col_step, cell - col_step, cell):
            area = _find_barring_area(search, needed_cell)
            if area is not None:
                return f"the {area.name} {area.verdict}"
    return None


def _explain_link(search: Search, route: Route, route_index: int, name: str) -> str | None:
    """Say why the agent can't use a link that a route takes; None if it can.

    Args:
        search: the agent's search.
        route: the route.
        route_index: index in the route of the cell that the link leads to.
        name: the link's name.
    """
    link = next(link for link in search.grid.links if link.name == name)
    first_cells = search.flat.layout.start
    stop_cells = [int(first_cells[stop.level]) + stop.cell for stop in link.stops]
    make_pairs = combinations if link.one_way else permutations
    passages = list(make_pairs(stop_cells, 2))
    from_cell, to_cell = route.cells[route_index - 1 : route_index + 1].tolist()
    reason = None
    # told first: a link that is opened leads no other way than before
    if (from_cell, to_cell) not in passages:
        reason = "leads the other way only"
    elif link.refuses(search.agent) is not None:
        reason = link.refuses(search.agent)
    elif not link.fits(search.radius):
        agent_width = f"the agent's {2.0 * search.radius:g} m"
        reason = f"is {link.width:g} m wide, narrower than {agent_width}"
    return f"the link {link.name!r} ({link.kind}) {reason}" if reason else None


class BarringArea(NamedTuple):
    """An area that bars the agent.

    Attributes:
        name: name of the area in a sentence, such as "area 'lab'".
        verdict: says whom the area bars, such as "bars all agents".
    """

    name: str
    verdict: str


def _find_barring_area(search: Search, cell: int) -> BarringArea | None:
    """Find the area that a cell is in, if it bars the agent; else return None."""
    area_factor = search.flat.area_factor
    agent = search.agent
    if len(area_factor) == 1 or math.isfinite(area_factor[cell]):
        return None
    level, row, col = search.flat.to_cell(cell)
    area = search.grid.areas[search.grid.levels[level].area_index[row, col] - 1]
    barred_agents = repr(agent.name) if agent and math.isfinite(area.cost) else "all agents"
    return BarringArea(f"area {area.name!r}", f"bars {barred_agents}")


def explain_by_rises(search: Search, start_cell: int, goal_cells: Int) -> str | None:
    """Say that the agent takes no steps as high as those of the route that exists for others.

    Args:
        search: the search on the grid, up to date with added obstacles.
        start_cell: flat id of a free cell.
        goal_cells: flat ids of free cells.

    Returns:
        A clause, such as ``the stairs at (1.00, 2.00, 0.00) rise up to 0.19 m a step, and 'robot'
        takes 0.05 m``; None if the agent takes all steps of the grid, or there is no such route.
    """
    agent = search.agent
    if agent is None or agent.step is None:
        return None
    grid_with_all_steps = fit_grid(
        search.original_grid.without_obstacles(), replace(agent, step=None)
    )
    route = similar_search(grid_with_all_steps, search).find_route(start_cell, goal_cells)
    if route is None:
        return None
    positions = search.flat.positions(route.cells)
    rises = np.abs(np.diff(positions[:, 2]))
    too_high_indices = np.flatnonzero((rises > agent.step + FLOOR_ROUNDING) & ~route.is_by_link[1:])
    if not len(too_high_indices):
        return None
    place_text = format_point(positions[too_high_indices[0]])
    rise_text = f"{format_length(rises[too_high_indices].max())} m"
    limit_text = f"{repr(agent.name) if agent.name else 'the agent'} takes {agent.step:g} m"
    if len(too_high_indices) == 1:
        return f"the step at {place_text} rises {rise_text}, and {limit_text}"
    return f"the stairs at {place_text} rise up to {rise_text} a step, and {limit_text}"


def explain_by_steps(search: Search, start_cell: int, goal_cells: Int) -> str | None:
    """Say between which levels all steps are blocked, or that no steps leave the start's level.

    Args:
        search: the search on the grid, up to date with added obstacles.
        start_cell: flat id of a free cell.
        goal_cells: flat ids of free cells.

    Returns:
        A clause; None if a goal is on the start's level, or a step is free between all levels
        that steps join.
    """
    flat = search.flat
    start_level = int(flat.level_of(start_cell))
    if start_level in flat.level_of(goal_cells):
        return None
    blocked_steps = _describe_blocked_steps(search)
    if blocked_steps:
        is_one_step = len(blocked_steps) == 1 and blocked_steps[0].startswith("the step")
        verb = "leads" if is_one_step else "lead"
        return f"{', '.join(blocked_steps)} {verb} to cells that aren't free"
    if not len(flat.steps.cell):
        return f"no steps lead from {_name_level(search.grid, start_level)} to another level"
    return None


def _describe_blocked_steps(search: Search) -> list[str]:
    """Describe the steps between each pair of levels, if all steps between them are blocked."""
    flat = search.flat
    descriptions = []
    sources, targets = flat.step_ends()
    source_levels = flat.level_of(sources)
    target_levels = flat.level_of(targets)
    is_open = flat.free[sources] & flat.free[targets]
    is_upwards = source_levels < target_levels
    level_pairs = np.stack([source_levels, target_levels], axis=1)[is_upwards]
    for lower_level, upper_level in np.unique(level_pairs, axis=0).tolist():
        joins_both_levels = (source_levels == lower_level) & (target_levels == upper_level)
        if not is_open[joins_both_levels].any():
            num_steps = joins_both_levels.sum()
            steps_text = "the step" if num_steps == 1 else f"all {num_steps} steps"
            lower_name = _name_level(search.grid, lower_level)
            upper_name = _name_level(search.grid, upper_level)
            descriptions.append(f"{steps_text} from {lower_name} to {upper_name}")
    return descriptions


EXPLANATIONS: tuple[Callable[[Search, int, Int], str | None], ...] = (
    explain_by_obstacles,
    explain_by_doors,
    explain_by_links_and_areas,
    explain_by_gap,
    explain_by_rises,
    explain_by_steps,
)
"""The functions that explain why there is no path, in the order in which they are called."""


# ---------------------------------------------------------------- words of sentences


def _name_obstacles(search: Search, cells: Int) -> str:
    """List the names of what blocks some cells, in one text; empty if the file has no names."""
    grid = search.grid
    flat = search.flat
    blocked_cells = cells[~flat.free[cells]]
    levels = flat.level_of(blocked_cells)
    positions = flat.positions(blocked_cells)
    names: list[str] = []
    for (x, y, _), level in zip(positions.tolist(), levels.tolist(), strict=True):
        names += grid.blockers((x, y), level)
    return list_first(list(dict.fromkeys(names)), MAX_NAMES)


def _name_level(grid: NavGrid, number: int) -> str:
    """Name a level in a sentence, by its number and the name that the file has for it."""
    name = grid.level_names[number]
    return name if name == f"level {number}" else f"level {number} ({name})"


def format_point(position: ArrayLike) -> str:
    """Format a position for a sentence, to the centimetre and in parentheses."""
    return f"({', '.join(map(format_length, np.asarray(position)))})"


def round_down(length: float) -> float:
    """Round a length [m] down to a whole number of millimetres.

    Rounding errors of floats don't count: 0.35 stays 0.35.
    """
    return math.floor(1000.0 * length + ROUNDING_ERROR) / 1000.0
