"""Finds the widest agent that gets from one place to another, and where a wider one is stopped.

A larger radius never frees a cell, and cells get blocked at few radii only. So a bisection over
these radii finds the exact answer. They are the radii r at which a disc round a cell's centre
touches the square or the centre of another cell: there (2 r / cell size)² is a whole number. The
baked radius is one more, as higher floors may block only larger agents.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.known_names import check_choice
from navbake.lengths import format_length, format_position
from navbake.navgrid.grid import MAX_RADIUS, NavGrid
from navbake.runtime import inflation
from navbake.runtime.flat_grid import (
    find_leaf_cells,
    find_stairs,
    map_islands,
)
from navbake.runtime.paths import Goal, find_target
from navbake.runtime.search import Search
from navbake.runtime.surroundings import RADIUS_SLACK, find_free
from navbake.types import Bool, Float, Int

# weight of a cell that is too narrow for a larger agent: a route avoids such cells if it can
NARROW_WEIGHT = 1000.0
LEAST_AREA = 0.5  # [m²] of free cells that passable stairs lead to, at least, on each of two levels


@dataclass(frozen=True, eq=False)
class Passage:
    """The widest agent that gets from one place to another, and where it only just fits."""

    radius: float  #: The agent's radius [m]; inf where no radius is too large.
    position: Float | None
    """World x, y and floor z [m] of the first bottleneck, shape (3,): the centre of a cell that is
    blocked for any larger agent. None where no radius is too large."""


class WidestRadius(NamedTuple):
    """The largest radius of an agent that gets from one place to another.

    Attributes:
        radius: the agent's radius [m]; inf where no radius is too large.
        is_free: mask of the cells that are free at this radius, by flat id.
        is_free_for_next: mask of the cells that are free at the next larger radius, by flat id.
    """

    radius: float
    is_free: Bool
    is_free_for_next: Bool


class LostConnection(NamedTuple):
    """A link, a door or stairs between levels that are passable on one grid but not on another.

    Attributes:
        name: the connection's name in a sentence.
        cells: flat ids of the ends of the stairs' steps, of the link's stops, or of the cells under
            the door's leaf.
    """

    name: str
    cells: Int


# ---------------------------------------------------------------- the widest agent


def find_passage(
    search: Search, start: ArrayLike, goal: Goal, level: int | None, ledges: str
) -> Passage | None:
    """Find the radius of the widest agent that gets to a goal, and its bottleneck.

    This is the code of `PathFinder.max_radius`.

    Args:
        search: the search on the grid, up to date with added obstacles.
        start: world x, y, z [m].
        goal: a position, several of them, or ``room:NAME``.
        level: the level of positions; None finds each one's level by its z.
        ledges: ``avoid`` to keep agents away from drops, or ``ignore``, see `grid.inflate`.

    Returns:
        The radius and the bottleneck; None if not even a point passes.

    Raises:
        QueryError: start or goal is outside the grid or occupied, or the goal is an object.
    """
    check_choice(ledges, inflation.LEDGE_RULES, "ledges", QueryError)
    grid = without_inflation(search.grid)
    flat = search.flat
    is_standable = find_free(grid, 0.0, ledges)

    def describe_refusal(is_in_grid: bool) -> str:
        return "no agent can stand there" if is_in_grid else "it lies beside the grid"

    start_position, start_cell = flat.locate(start, level, "start")
    if start_cell < 0 or not is_standable[start_cell]:
        reason = describe_refusal(start_cell >= 0)
        raise QueryError(f"no way from {format_position(start_position)}: {reason}")
    if isinstance(goal, str) and goal.startswith("object:"):
        explanation = "how near an agent gets to an object depends on its radius"
        raise QueryError(f"expected a position or room:NAME as goal, got {goal!r}: {explanation}")
    target = find_target(search, goal, level)
    goal_cells = np.unique(target.cells[target.cells >= 0])
    goal_cells = goal_cells[is_standable[goal_cells]]
    if not len(goal_cells):
        reason = describe_refusal(bool((target.cells >= 0).any()))
        raise QueryError(f"no way to {target.name}: {reason}")
    widest = find_widest(
        grid, search, start_cell, goal_cells, ledges, cut_corners=search.cut_corners
    )
    if widest is None:
        return None
    if math.isinf(widest.radius):
        return Passage(math.inf, None)
    cell = find_bottleneck(
        grid, search, start_cell, goal_cells, widest, cut_corners=search.cut_corners
    )
    return Passage(widest.radius, flat.positions(cell))


def find_widest(
    grid: NavGrid,
    search: Search,
    start_cell: int,
    goal_cells: Int,
    ledges: str,
    *,
    cut_corners: bool = False,
) -> WidestRadius | None:
    """Find the largest radius of an agent that can get from a cell to any of several goals.

    Args:
        grid: the grid for radius 0, see `without_inflation`.
        search: a search on a grid of the same cells, whose links and areas count.
        start_cell: flat id.
        goal_cells: flat ids.
        ledges: ``avoid`` to keep agents away from drops, or ``ignore``, see `grid.inflate`.
        cut_corners: whether diagonal steps past blocked corners are allowed.

    Returns:
        The radius, and the cells that are free at it; None if not even a point passes.
    """
    flat = search.flat
    is_barred = ~np.isfinite(flat.area_factor)

    def passes(radius: float) -> bool:
        is_free = find_free(grid, radius, ledges) & ~is_barred
        free_goals = goal_cells[is_free[goal_cells]]
        if not is_free[start_cell] or not len(free_goals):
            return False
        moves = None
        if cut_corners:  # diagonal moves join islands, too
            weights = np.where(is_free, 1.0, np.inf)
            moves = Search(with_weights(grid, weights), cut_corners=True).graph.moves
        islands = map_islands(replace(flat, free=is_free), radius, moves)
        reached_islands = islands.reached_from(int(islands.number[start_cell]))
        return bool(np.isin(islands.number[free_goals], reached_islands).any())

    if not passes(0.0):
        return None
    # the largest radius is in [passing_radius, failing_radius)
    smallest_cell_size = float(flat.layout.cell_size.min())
    passing_radius = 0.0
    failing_radius = smallest_cell_size
    while passes(failing_radius):
        if failing_radius == MAX_RADIUS:
            is_free = find_free(grid, failing_radius, ledges)
            return WidestRadius(math.inf, is_free, is_free)
        passing_radius = failing_radius
        failing_radius = min(2.0 * failing_radius, MAX_RADIUS)
    while failing_radius - passing_radius > smallest_cell_size:  # so that few radii remain
        middle_radius = (passing_radius + failing_radius) / 2
        if passes(middle_radius):
            passing_radius = middle_radius
        else:
            failing_radius = middle_radius
    radii = _radii_that_change_cells(grid, search, passing_radius, failing_radius)
    passing_index = 0
    failing_index = len(radii) - 1
    while failing_index - passing_index > 1:
        middle_index = (passing_index + failing_index) // 2
        if passes(radii[middle_index]):
            passing_index = middle_index
        else:
            failing_index = middle_index
    return WidestRadius(
        radius=radii[passing_index],
        is_free=find_free(grid, radii[passing_index], ledges),
        is_free_for_next=find_free(grid, radii[passing_index + 1], ledges),
    )


def _radii_that_change_cells(
    grid: NavGrid, search: Search, min_radius: float, max_radius: float
) -> list[float]:
    """List the radii at which cells or links may become too narrow, between two radii.

    Returns the radii from `min_radius` on and below `max_radius`, ascending, and then `max_radius`
    itself [m]. A radius that is less than `min_radius` by no more than rounding counts as equal to
    it: no cell that is free for it is blocked at `min_radius`.
    """
    flat = search.flat
    candidate_radii = [np.array([grid.agent_radius]), flat.arcs.width / 2.0]
    for cell_size in set(flat.layout.cell_size.tolist()):
        first_squared_diameter = math.floor((2 * min_radius / cell_size) ** 2)
        last_squared_diameter = math.ceil((2 * max_radius / cell_size) ** 2)
        candidate_radii.append(
            np.sqrt(np.arange(first_squared_diameter, last_squared_diameter + 1)) * (cell_size / 2)
        )
    radii = np.unique(np.concatenate(candidate_radii))
    is_between = (radii >= min_radius * (1.0 - RADIUS_SLACK)) & (radii < max_radius)
    return [*radii[is_between].tolist(), max_radius]


def find_bottleneck(
    grid: NavGrid,
    search: Search,
    start_cell: int,
    goal_cells: Int,
    widest: WidestRadius,
    *,
    cut_corners: bool,
) -> int:
    """Find the bottleneck, the cell where the widest agent only just fits.

    Cells that are free for the widest agent, but not for the next larger one, are critical. The
    route avoids critical cells where it can. The bottleneck is the middle of the first run of
    critical cells on the route. If the route has none, a link or a diagonal step limits the radius:
    the bottleneck is then the stop before the link that is just as wide as the agent, or a critical
    cell beside the diagonal step.

    Args:
        grid: the grid for radius 0, see `without_inflation`.
        search: a search on a grid of the same cells; the route is planned for its agent (speed, and
            which areas and links it may use).
        start_cell: flat id.
        goal_cells: flat ids.
        widest: the result of `find_widest` for the same arguments.
        cut_corners: whether diagonal steps past blocked corners are allowed.

    Returns:
        The flat id of the bottleneck.
    """
    flat = search.flat
    is_critical = widest.is_free & ~widest.is_free_for_next
    weights = np.where(widest.is_free, np.where(is_critical, NARROW_WEIGHT, 1.0), np.inf)
    weighted_search = similar_search(
        with_weights(grid, weights), search, cut_corners=cut_corners, radius=widest.radius
    )
    route = weighted_search.find_route(start_cell, goal_cells)
    assert route is not None  # the islands say that there is one
    critical_indices = np.flatnonzero(is_critical[route.cells])
    if len(critical_indices):
        run_starts = np.flatnonzero(np.diff(critical_indices) > 1) + 1
        first_run = np.split(critical_indices, run_starts)[0]
        return int(route.cells[first_run[(len(first_run) - 1) // 2]])
    for route_index in np.flatnonzero(route.is_by_link).tolist():
        link_ends = route.cells[route_index - 1 : route_index + 1]
        is_taken_arc = (flat.arcs.ends == link_ends).all(axis=1)
        if is_taken_arc.any():
            width = flat.arcs.width[is_taken_arc].max()
            if math.isclose(width, 2.0 * widest.radius):
                return int(route.cells[route_index - 1])
    # the route passes diagonally between two cells
    levels, rows, cols = flat.to_cells(route.cells)
    step_sizes = np.abs(np.diff([levels, rows, cols])).T
    diagonal_steps = np.flatnonzero((step_sizes == (0, 1, 1)).all(axis=1))
    col_step = cols[diagonal_steps + 1] - cols[diagonal_steps]
    cells_beside = np.concatenate([
        route.cells[diagonal_steps] + col_step,
        route.cells[diagonal_steps + 1] - col_step,
    ])  # fmt: skip
    return int(cells_beside[is_critical[cells_beside]][0])


# ---------------------------------------------------------------- other grids of the same cells


def without_inflation(grid: NavGrid) -> NavGrid:
    """Make the grid for an agent of radius 0: weights of 1 where a point can stand, inf elsewhere.

    Returns:
        A new grid; the grid itself if it was never inflated.
    """
    if "inflation" not in grid.metadata:
        return grid
    free_masks = [
        (level.solid == 0) & ~np.isnan(level.floor_height) | level.free for level in grid.levels
    ]
    is_free = np.concatenate([free_mask.ravel() for free_mask in free_masks])
    return with_weights(grid, np.where(is_free, 1.0, np.inf))


def make_point_grid(grid: NavGrid) -> NavGrid:
    """Copy a baked grid for an agent of radius 0.

    If the grid has a layer ``solid``, cells that are blocked only by the baked radius become free.

    Args:
        grid: a grid that was never inflated.
    """
    is_free = np.concatenate([level.free_for_point.ravel() for level in grid.levels])
    return with_weights(grid, np.where(is_free, 1.0, np.inf))


def with_weights(grid: NavGrid, weights: Float) -> NavGrid:
    """Copy a grid with new weights, and without the record of its inflations.

    Args:
        grid: the grid, which stays as it is.
        weights: by flat id, inf where an agent can't stand.
    """
    metadata = {key: value for key, value in grid.metadata.items() if key != "inflation"}
    level_ends = np.cumsum([level.free.size for level in grid.levels])
    weights_by_level = np.split(weights, level_ends[:-1])
    levels = [
        level.with_layers(weights=level_weights.reshape(level.shape))
        for level, level_weights in zip(grid.levels, weights_by_level, strict=True)
    ]
    return grid.with_levels(levels, metadata)


def similar_search(
    grid: NavGrid,
    search: Search,
    *,
    cut_corners: bool | None = None,
    radius: float | None = None,
    penalty: float | None = None,
) -> Search:
    """Make a search with the settings of another one, on a grid of the same cells.

    The agent's speed, and which areas and links it may use, are kept; its size is ignored.

    Args:
        grid: the grid of the new search; may be the grid of the other one.
        search: the search whose settings are used.
        cut_corners: whether diagonal steps past blocked corners are allowed; if None, as in
            `search`.
        radius: links that are narrower than twice this are left out [m]; the radius of `search` if
            None.
        penalty: None to keep the agent off links and areas that bar it. A number lets it use them
            at a higher cost, see `navbake.runtime.flat_grid.flatten`.
    """
    return Search(
        grid,
        cut_corners=search.cut_corners if cut_corners is None else cut_corners,
        agent=search.agent and search.agent.without_sizes(),
        radius=search.radius if radius is None else radius,
        penalty=penalty,
    )


def find_route_cells(grid: NavGrid, search: Search, start_cell: int, goal_cells: Int) -> Int | None:
    """Find the cheapest route on a grid, with the settings of a search made for another grid.

    Args:
        grid: the grid of the route, of the same cells as the grid of `search`.
        search: the search whose settings are used.
        start_cell: flat id.
        goal_cells: flat ids.

    Returns:
        The flat ids of the route's cells; None if there is no route.
    """
    route = similar_search(grid, search).find_route(start_cell, goal_cells)
    return None if route is None else route.cells


def find_lost_connections(search_before: Search, search_after: Search) -> list[LostConnection]:
    """Find the links, doors and stairs that an agent can pass on one grid but not on another.

    - A link is impassable if it is too narrow for the agent, or if fewer than two of its stops are
      free.
    - A door is impassable if no cell under its leaf is free.
    - Stairs are a group of steps between two levels, side by side. They are passable if a free
      step joins at least 0.5 m² of free floor on each of the two levels. A landing between blocked
      treads is smaller.

    Args:
        search_before: a search on the first grid.
        search_after: a search on the second grid, of the same cells.
    """
    flat = search_before.flat
    lost_connections: list[LostConnection] = []
    for stairs in find_stairs(search_before.grid, flat):
        levels = [stairs.lower_level, stairs.upper_level]
        if _has_open_step(search_before, levels, stairs.steps) and not _has_open_step(
            search_after, levels, stairs.steps
        ):
            x, y, _ = flat.positions(stairs.steps).mean(axis=(0, 1))
            between_text = f"between level {stairs.lower_level} and {stairs.upper_level}"
            name = f"the {stairs.kind} {between_text} near ({format_length(x)}, {format_length(y)})"
            lost_connections.append(LostConnection(name, stairs.steps.ravel()))
    for link in search_before.grid.links:
        cells = np.array([flat.layout.start[stop.level] + stop.cell for stop in link.stops])
        was_open = search_before.flat.free[cells].sum() > 1 and link.fits(search_before.radius)
        is_open = search_after.flat.free[cells].sum() > 1 and link.fits(search_after.radius)
        if was_open and not is_open:
            lost_connections.append(LostConnection(f"the link {link.name!r} ({link.kind})", cells))
    for door in search_before.grid.doors:
        cells = find_leaf_cells(door, flat)
        cells = cells[flat.free[cells]]
        if len(cells) and not search_after.flat.free[cells].any():
            lost_connections.append(LostConnection(f"door {door.id!r}", cells))
    return lost_connections


def _has_open_step(search: Search, levels: list[int], steps: Int) -> bool:
    """Whether one of the steps between two levels is free, and leads to enough of both levels.

    Args:
        search: the search on the grid.
        levels: numbers of the two levels.
        steps: flat ids of each step's cells on the first and the second level, shape (n, 2).
    """
    flat = search.flat
    island_numbers = search.islands.number
    # for each cell, how many cells of its island are on its level
    num_cells = np.zeros(steps.shape, dtype=np.int64)
    for end_index, level in enumerate(levels):
        cells_by_island = np.bincount(island_numbers[flat.cells_of(level)])
        num_cells[:, end_index] = cells_by_island[island_numbers[steps[:, end_index]]]
    areas = num_cells * flat.layout.cell_size[levels] ** 2
    return bool((flat.free[steps] & (areas >= LEAST_AREA)).all(axis=1).any())
