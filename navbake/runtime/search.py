"""Searches for the cheapest routes over a grid's cells, and caches results such as islands."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.lazy import lazy
from navbake.navgrid.cells import Cells, check_level
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.links import Agent
from navbake.navgrid.obstacle_state import NO_DIAGONAL, NO_OFF_CENTER, CellRange, ObstacleState
from navbake.runtime import flat_grid
from navbake.runtime.agents import find_agent, fit_grid
from navbake.runtime.flat_grid import octile_length
from navbake.runtime.inflation import OffCenterMasks, find_off_center_masks
from navbake.runtime.name_map import NameMap, map_names
from navbake.types import Bool, Float, Int, Int32

if TYPE_CHECKING:
    from navbake.runtime.grid_arrays import Graph, OffCenter, Visits

arrays = lazy("navbake.runtime.grid_arrays")  # numba loads slowly
line_kernels = lazy("navbake.runtime.line_kernels")
search_kernels = lazy("navbake.runtime.search_kernels")
walk_kernels = lazy("navbake.runtime.walk_kernels")

LAST_SEARCH = 2**31 // 64 - 2  # `mark` is int32 and holds the number of a search times 64
FIRST_QUEUE_SIZE = 1 << 15  # number of entries of the queue at first
MAX_CACHED = 8  # number of cached results of each kind
NO_CELLS = np.empty(0, dtype=np.int64)
NO_ROOMS = np.empty(0, dtype=np.int32)
CachedResult = TypeVar("CachedResult")


class Route(NamedTuple):
    """The cheapest sequence of cells from one cell to another.

    Attributes:
        cells: flat ids, from the start to the goal, shape (n,).
        is_by_link: whether the route enters each cell over a link or from another level, shape
            (n,).
        cost: the route's cost, in [m] if it was planned by cost, in [s] if by time.
    """

    cells: Int
    is_by_link: Bool
    cost: float


class TakenLink(NamedTuple):
    """A named link that a route takes.

    Attributes:
        cell_index: index in the route of the cell that the link leads to.
        name: the link's name.
    """

    cell_index: int
    name: str


class RouteCosts(NamedTuple):
    """The cost and the duration of a route, and the named links on it.

    Attributes:
        cost: the route's cost [m].
        seconds: how long the agent takes for it [s].
        links: the links, in the route's order.
    """

    cost: float
    seconds: float
    links: list[TakenLink]


class Search:
    """Finds routes over the cells of all levels of a grid, and caches results.

    Not thread-safe.

    Args:
        grid: the grid as it was loaded or baked.
        cut_corners: whether diagonal steps past blocked corners are allowed.
        agent: the agent that plans: an `Agent`, the name of one that the grid lists, or None.
        radius: the search leaves out links that are narrower than twice this [m]; None for the
            grid's radius.
        penalty: None to keep the agent off links and areas that bar it. A number lets it use them
            at a higher cost, see `navbake.runtime.flat_grid.flatten`.

    Attributes:
        agent: the agent that plans.
        original_grid: the grid as it was loaded or baked.
        grid: the grid for the agent's size, see `navbake.runtime.agents.fit_grid`.
        cut_corners: whether diagonal steps past blocked corners are allowed.
        radius: links that are narrower than twice this are left out [m].
        flat: the grid's cells.
        graph: the steps between cells, and their costs [m].
        free_diagonally: mask of the free cells with room for a diagonal step, by flat id.
        off_center: where the agent fits when it isn't at the centre of a cell.
        version: how often `update` has found cells that obstacles blocked or freed.

    Raises:
        QueryError: a weight is negative, or the grid can't be fitted to the agent.
    """

    def __init__(
        self,
        grid: NavGrid,
        *,
        cut_corners: bool = False,
        agent: str | Agent | None = None,
        radius: float | None = None,
        penalty: float | None = None,
    ) -> None:
        self.agent = find_agent(grid, agent)
        self.original_grid = grid
        self.grid = fit_grid(grid, self.agent)
        self.cut_corners = cut_corners
        self.version = 0
        self.radius = self.grid.radius if radius is None else radius
        grid_without_added = self.grid.without_obstacles()
        self.flat = flat_grid.flatten(grid_without_added, self.agent, penalty)
        self._cache: dict[str, dict[Hashable, object]] = {}
        flat = self.flat
        # of the grid without obstacles; None if only free cells count
        self._masks_without_obstacles = find_off_center_masks(grid_without_added)
        masks_without_obstacles = self._masks_without_obstacles or OffCenterMasks(
            flat.free, flat.free, flat.free
        )
        self._masks = OffCenterMasks(
            diagonal=masks_without_obstacles.diagonal & flat.free,
            anywhere=masks_without_obstacles.anywhere & flat.free,
            sweepable=masks_without_obstacles.sweepable & flat.free,
        )
        self.free_diagonally = self._masks.diagonal
        self.off_center = self._make_off_center(grid_without_added)
        least_weight = flat.weight[flat.free].min(initial=0.0)
        if least_weight < 0:
            raise QueryError(
                f"expected weights >= 0, got {least_weight:g}: no path is the cheapest then"
            )
        # the graph is made without obstacles, so that its buckets fit the weights of all cells
        self._moves = np.zeros(flat.num_cells, dtype=np.uint8)
        self.graph = self._make_graph("cost", False)
        self._visits: Visits = arrays.Visits(
            mark=np.zeros(flat.num_cells, dtype=np.int32),
            cost=np.zeros(flat.num_cells, dtype=np.float64),
            link_from=np.zeros(len(self.graph.links.cell), dtype=np.int64),
            entry_cell=np.empty(FIRST_QUEUE_SIZE, dtype=np.int32),
            entry_next=np.empty(FIRST_QUEUE_SIZE, dtype=np.int32),
        )
        self._search_number = 0
        self._seen_revisions = [0] * flat.num_levels
        for level_number, level in enumerate(self.grid.levels):
            self._update_moves(level_number, (0, level.height, 0, level.width))
        self.update()

    def _make_off_center(self, grid_without_added: NavGrid) -> OffCenter:
        """Make `off_center`, with the solid cells of the grid without obstacles."""
        num_solid_before = np.zeros(1, dtype=np.int32)
        if self._masks_without_obstacles is not None:
            is_solid = np.concatenate(
                [level.solid.ravel() != 0 for level in grid_without_added.levels]
            )
            num_solid_before = np.append(np.int32(0), np.cumsum(is_solid, dtype=np.int32))
        off_center: OffCenter = arrays.OffCenter(
            anywhere=self._masks.anywhere,
            sweepable=self._masks.sweepable,
            num_solid_before=num_solid_before,
            radius=self.grid.inflated_radius,
        )
        return off_center

    # ---------------------------------------------------------------- the graph

    def graph_with_costs(self, by: str, *, reverse_links: bool = False) -> Graph:
        """Return the graph of the steps between cells, with the costs that a search minimizes.

        Args:
            by: ``cost`` for lengths times the cells' weights [m]; ``time`` for seconds; ``length``
                for lengths alone [m]. Links add their own costs to lengths.
            reverse_links: whether each link leads from its end to its start.
        """
        if by == "cost" and not (reverse_links and len(self.flat.arcs.ends)):
            return self.graph
        make_graph = partial(self._make_graph, by, reverse_links)
        return self.cached_result("graphs", (by, reverse_links), make_graph)

    def _make_graph(self, by: str, reverse_links: bool) -> Graph:
        """Make the graph that `graph_with_costs` returns."""
        flat = self.flat
        weight = flat.weight
        free_weights = np.ones(1)
        if by == "time":
            free_weights = flat.pace
            if len(flat.pace) > 1:
                weight = np.where(flat.free, flat.pace, np.inf)
                free_weights = flat.pace[flat.free]
        elif by == "cost":
            free_weights = flat.weight[flat.free]
        least_weight = float(free_weights.min()) if free_weights.size else 1.0
        greatest_weight = float(free_weights.max()) if free_weights.size else 1.0
        links = flat.links(self.radius, by_time=by == "time", are_reversed=reverse_links)
        is_passable = flat.arcs.fits_radius(self.radius)
        sources, targets = flat.positions(flat.arcs.ends[is_passable].T)
        estimated_costs = least_weight * octile_length(sources - targets)
        passage_costs = (flat.arcs.seconds if by == "time" else flat.arcs.cost)[is_passable]
        bucket_width, num_buckets = search_kernels.plan_buckets(
            cell_size=float(flat.layout.cell_size.min()),
            least_weight=least_weight,
            greatest_weight=greatest_weight,
            longest_step=float(links.length.max(initial=0)),
            highest_passage_cost=float((passage_costs + estimated_costs).max(initial=0.0)),
        )
        graph: Graph = arrays.Graph(
            layout=flat.layout,
            links=links,
            moves=self._moves,
            weight=weight,
            uniform_weight=least_weight if least_weight == greatest_weight else 0.0,
            least_weight=least_weight,
            bucket_width=bucket_width,
            num_buckets=num_buckets,
        )
        return graph

    def update(self) -> None:
        """Update weights and moves of the cells that were blocked or freed since the last call."""
        for level_number, level in enumerate(self.grid.levels):
            obstacle_state = level.obstacle_state
            if (
                obstacle_state is None
                or obstacle_state.revision == self._seen_revisions[level_number]
            ):
                continue
            changed_ranges = obstacle_state.changes_since(self._seen_revisions[level_number])
            for changed_range in changed_ranges or [(0, level.height, 0, level.width)]:
                self._update_cells(level_number, changed_range, obstacle_state)
            self._seen_revisions[level_number] = obstacle_state.revision
            self.version += 1

    def _update_cells(
        self, level_number: int, changed_range: CellRange, obstacle_state: ObstacleState
    ) -> None:
        """Update weights, masks and moves of some cells of a level, by its `obstacle_state`."""
        level = self.grid.levels[level_number]
        first_row, stop_row, first_col, stop_col = changed_range
        window = np.s_[first_row:stop_row, first_col:stop_col]
        first_cell = self.flat.cells_of(level_number).start
        rows = np.arange(first_row, stop_row)[:, None]
        cols = np.arange(first_col, stop_col)
        cells = first_cell + rows * level.width + cols
        weight = level.weights[window].astype(np.float64)
        self.flat.weight[cells] = self.flat.weights_for_agent(weight, cells)
        is_free = np.isfinite(self.flat.weight[cells])
        self.flat.free[cells] = is_free
        for mask_index, layer in enumerate((NO_DIAGONAL, NO_OFF_CENTER, NO_OFF_CENTER)):
            cell_mask = self._masks[mask_index]
            cell_mask[cells] = is_free
            if self._masks_without_obstacles is not None:
                mask_without_obstacles = self._masks_without_obstacles[mask_index]
                cell_mask[cells] &= mask_without_obstacles[cells] & (
                    obstacle_state.count[layer][window] == 0
                )
        self._update_moves(level_number, (first_row - 1, stop_row + 1, first_col - 1, stop_col + 1))

    def _update_moves(self, level_number: int, cell_range: CellRange) -> None:
        """Compute the moves of some cells of a level again."""
        search_kernels.find_moves(
            self.flat.free,
            self.free_diagonally,
            self.flat.floors,
            self.flat.slope_bits,
            self.cut_corners,
            self.flat.layout,
            level_number,
            cell_range,
            self._moves,
        )

    # ---------------------------------------------------------------- cached results

    def cached_result(
        self,
        kind: str,
        key: Hashable,
        compute: Callable[[], CachedResult],
        limit: int = MAX_CACHED,
    ) -> CachedResult:
        """Return the result of a function; from the cache, if obstacles haven't changed since.

        Args:
            kind: name of the kind of results, such as ``islands``.
            key: tells results of one kind apart, such as by their goal; None if there is only one.
            compute: the function; called if its result isn't in the cache.
            limit: how many results of the kind stay in the cache, the most recently used ones.
        """
        results = self._cache.setdefault(kind, {})
        versioned_key = (self.version, key)
        if versioned_key in results:
            result = cast("CachedResult", results.pop(versioned_key))
        else:
            result = compute()
        results[versioned_key] = result  # most recently used last
        for old_key in list(results)[:-limit]:
            del results[old_key]
        return result

    @cached_property
    def rooms(self) -> flat_grid.RoomMap:
        """The rooms of the grid, and the number of each cell's room."""
        return flat_grid.map_rooms(self.grid)

    @cached_property
    def doors(self) -> flat_grid.DoorMap:
        """The ids of the doors of each cell, by flat id."""
        return flat_grid.map_doors(self.grid, self.flat)

    @cached_property
    def names(self) -> NameMap:
        """The names of the things in the cells."""
        return map_names(self.grid)

    @property
    def islands(self) -> flat_grid.IslandMap:
        """The islands: the connected parts of the currently free cells."""
        moves = self.graph.moves if self.cut_corners else None
        find_islands = partial(flat_grid.map_islands, self.flat, self.radius, moves)
        return self.cached_result("islands", None, find_islands, 1)

    @property
    def occupied(self) -> Bool:
        """Mask of the cells that are occupied now or have no floor, by flat id (`solid`)."""

        def find_occupied() -> Bool:
            return np.concatenate([level.solid.ravel() != 0 for level in self.grid.levels])

        return self.cached_result("occupied", None, find_occupied, 1)

    # ---------------------------------------------------------------- selections of cells

    def mark_allowed(
        self,
        *,
        level: int | None = None,
        room: str | None = None,
        islands: Sequence[int] | None = None,
        outdoors: bool = True,
    ) -> Bool:
        """Mark the free cells that are on a level, in a room and on one of several islands.

        Args:
            level: number of the level; None for any.
            room: id or name of the room; None for any, and cells without a room.
            islands: numbers of the islands; None for any.
            outdoors: whether cells of rooms that are outdoors are marked, too.

        Returns:
            The mask, bool, by flat id; it may be the array `flat.free` itself.

        Raises:
            QueryError: there is no such level or room.
        """
        is_allowed = self.flat.free
        if level is not None:
            check_level(level, self.flat.num_levels)
            level_cells = self.flat.cells_of(level)
            is_allowed = np.zeros_like(is_allowed)
            is_allowed[level_cells] = self.flat.free[level_cells]
        if room is not None:
            is_allowed = is_allowed & (self.rooms.number == self.rooms.find(room))
        if islands is not None:
            is_allowed = is_allowed & np.isin(self.islands.number, islands)
        if not outdoors:
            is_allowed = is_allowed & ~self.mark_outdoors()
        return is_allowed

    def mark_outdoors(self) -> Bool:
        """Mark the cells in rooms that are outdoors, free or not; bool, by flat id."""
        is_outdoor_room = np.array([False, *(room.outdoors for room in self.rooms.rooms)])
        is_outdoors: Bool = is_outdoor_room[self.rooms.number]
        return is_outdoors

    def allowed_islands(
        self, island: int | None, reachable_from: ArrayLike | None
    ) -> tuple[int, ...] | None:
        """Return the numbers of the islands to which a query is restricted.

        Args:
            island: number of the only island that is allowed; None for any.
            reachable_from: a free position, world x, y, z [m]: only islands that paths from it
                reach are allowed. None for no such condition.

        Returns:
            The numbers; None for no restriction.

        Raises:
            QueryError: there is no such island, or no path leads from the position to it.
        """
        if reachable_from is None:
            return None if island is None else (self.islands.check(island),)
        _, start_cell = self.flat.free_cell_at(reachable_from)
        start_island = int(self.islands.number[start_cell])
        reached_islands = self.islands.reached_from(start_island)
        if island is None:
            return reached_islands
        if island not in reached_islands:
            raise QueryError(
                f"island {island} can't be reached: the position is on {start_island}",
                key="island",
                value=island,
            )
        return (island,)

    # ---------------------------------------------------------------- lines

    def can_pass(self, start: Float, end: Float, level: int) -> bool:
        """Whether an agent can currently move along a line between points x, y of a level [m].

        Args:
            start: world x, y [m], shape (2,).
            end: world x, y [m], shape (2,).
            level: number of the level.
        """
        return bool(line_kernels.can_pass(start, end, level, self.graph, self.off_center))

    def first_in_sight(
        self, cell: int, point: Float, cells: Int, points: Float, room_numbers: Int32 = NO_ROOMS
    ) -> int:
        """Find the first of several points that is in sight of a point.

        Occupied cells block the line of sight; heights are not compared.

        Args:
            cell: flat id of the cell that `point` is in.
            point: world x, y [m], shape (2,) or (3,).
            cells: flat ids of the cells of `points`, shape (n,).
            points: world x, y [m], shape (n, 2) or (n, 3), C-contiguous.
            room_numbers: empty if the point must not be in an occupied cell. Else the number of
                each cell's room, by flat id: the line may then start inside an object, and must
                leave the object's occupied cells without leaving the room of `cell`.

        Returns:
            The point's index in `points`, -1 for none.
        """
        is_clear = self.cached_result("clear", None, lambda: ~self.occupied, 1)
        floors = self.flat.floors._replace(max_step=math.inf)
        visible_index = walk_kernels.first_in_sight(
            self.flat.layout,
            self.flat.steps,
            floors,
            is_clear,
            room_numbers,
            cell,
            point,
            cells,
            points,
        )
        return int(visible_index)

    # ---------------------------------------------------------------- routes

    def find_route(self, start_cell: int, goal_cells: Int, by: str = "cost") -> Route | None:
        """Find the cheapest route from a cell to any of several cells.

        Args:
            start_cell: flat id of a free cell.
            goal_cells: flat ids of free cells, int64.
            by: ``cost`` or ``time``.

        Returns:
            The route, None if there is none.
        """
        if (goal_cells == start_cell).any():
            return Route(np.array([start_cell]), np.zeros(1, dtype=np.bool_), 0.0)
        graph = self.graph_with_costs(by)
        if len(self.flat.arcs.ends):
            link_saving = self._largest_link_saving(goal_cells, by, graph.least_weight)
            graph = graph._replace(link_saving=link_saving)
        cells = self._run_search(graph, np.array([start_cell]), goal_cells)
        if not len(cells):
            return None
        moves = self._visits.mark[cells] & search_kernels.MOVE_BITS
        return Route(
            cells=cells,
            is_by_link=moves == search_kernels.BY_LINK,
            cost=float(self._visits.cost[cells[-1]]),
        )

    def _largest_link_saving(self, goal_cells: Int, by: str, least_weight: float) -> float:
        """Compute by how much, at most, links make a route cheaper than the search estimates.

        The estimate is the octile distance to the box round the goals, times `least_weight`.
        """
        flat = self.flat
        compute_costs = partial(
            flat.costs_between_stops, self.radius, least_weight, by_time=by == "time"
        )
        stop_positions, costs = self.cached_result("costs between stops", by, compute_costs)
        if not len(stop_positions):
            return 0.0
        goal_positions = flat.positions(goal_cells)[:, :2]
        box_min = goal_positions.min(axis=0)
        box_max = goal_positions.max(axis=0)
        box_distances = np.maximum(
            np.maximum(box_min - stop_positions, stop_positions - box_max), 0.0
        )
        cost_estimates = least_weight * octile_length(box_distances)
        costs_over_links = (costs + cost_estimates).min(axis=1)
        return float((cost_estimates - costs_over_links).max())

    def measure_route(self, route: Route, route_cells: Cells, by: str) -> RouteCosts:
        """Compute the cost and the duration of a route, and list the named links on it.

        Args:
            route: a route that this search found.
            route_cells: level, row and column of the route's cells.
            by: the criterion that the route was planned by, ``cost`` or ``time``.

        Returns:
            The cost [m], the duration [s], and the links in the order of the route.
        """
        flat = self.flat
        graph = self.graph
        has_links = bool(route.is_by_link.any())
        has_uniform_costs = graph.uniform_weight > 0.0 and len(flat.pace) == 1 and not has_links
        if by == "cost" and has_uniform_costs:
            seconds = route.cost / graph.uniform_weight * float(flat.pace[0])
            return RouteCosts(route.cost, seconds, [])
        step_lengths = flat.layout.cell_size[route_cells.level]
        is_diagonal = (np.diff(route_cells.row) != 0) & (np.diff(route_cells.col) != 0)
        step_lengths[1:][is_diagonal] *= math.sqrt(2.0)
        step_lengths[0] = 0.0
        pace = flat.pace[route.cells] if len(flat.pace) > 1 else flat.pace
        if by == "cost" and not has_links:
            return RouteCosts(route.cost, float((step_lengths * pace).sum()), [])

        passage_costs = np.zeros_like(step_lengths)
        passage_seconds = np.zeros_like(step_lengths)
        taken_links: list[TakenLink] = []
        step_sources, step_targets = flat.step_ends()
        planning_graph = self.graph_with_costs(by)
        planning_arc_costs = flat.arcs.seconds if by == "time" else flat.arcs.cost
        for route_index in np.flatnonzero(route.is_by_link).tolist():
            link_ends = route.cells[route_index - 1 : route_index + 1]
            step_indices = np.flatnonzero(
                (step_sources == link_ends[0]) & (step_targets == link_ends[1])
            )
            step_lengths[route_index] = (
                flat.steps.length[step_indices[0]] if len(step_indices) else 0.0
            )
            is_candidate = (flat.arcs.ends == link_ends).all(axis=1)
            is_candidate &= flat.arcs.fits_radius(self.radius)
            if not is_candidate.any():
                continue
            arc_index = int(np.argmin(np.where(is_candidate, planning_arc_costs, np.inf)))
            weight = planning_graph.uniform_weight or planning_graph.weight[link_ends[1]]
            if (
                not len(step_indices)
                or planning_arc_costs[arc_index] < step_lengths[route_index] * weight
            ):
                taken_links.append(
                    TakenLink(route_index, self.grid.links[flat.arcs.link[arc_index]].name)
                )
                step_lengths[route_index] = 0.0
                passage_costs[route_index] = flat.arcs.cost[arc_index]
                passage_seconds[route_index] = flat.arcs.seconds[arc_index]
        move_costs = passage_costs + step_lengths * flat.weight[route.cells]
        move_seconds = passage_seconds + step_lengths * pace
        return RouteCosts(
            cost=route.cost if by == "cost" else float(move_costs.sum()),
            seconds=float(move_seconds.sum()),
            links=taken_links,
        )

    def compute_cost_field(self, goal_cells: Int, *, by: str = "cost") -> Float:
        """Compute the cost of the cheapest route from each cell to any of several goals.

        Args:
            goal_cells: flat ids of free cells, int64.
            by: ``cost``, ``time`` or ``length``, see `graph_with_costs`.

        Returns:
            float64, by flat id; inf for no route.
        """
        cost, _ = self._search_all_cells(goal_cells, by, reverse_links=True)
        return cost

    def lengths_from(self, sources: Int) -> Float:
        """Compute the length of the shortest route to each cell from the nearest of several cells.

        Links add their costs to the length.

        Args:
            sources: flat ids of free cells, int64.

        Returns:
            float64 [m], by flat id; inf for no route.
        """
        # A flood from cells weights each step by the cell that it leads away from. So it gives the
        # costs of routes from these cells only where all weights are equal, as for lengths.
        lengths, _ = self._search_all_cells(sources, "length", reverse_links=False)
        return lengths

    def find_next_cells(self, goal_cells: Int) -> tuple[Float, Int]:
        """For each cell, find the next cell on the cheapest route to a goal, and the route's cost.

        Args:
            goal_cells: flat ids of free cells, int64.

        Returns:
            The costs [m], by flat id, inf for no route; and the flat id of the next cell, by flat
            id: the cell itself at a goal, -1 for no route.
        """
        flat = self.flat
        links = self.graph.links
        cost, moves = self._search_all_cells(goal_cells, "cost", reverse_links=True)
        cells = np.arange(flat.num_cells)
        # the search ran from the goals, so the move that reached a cell leads from its next cell
        row_steps = np.zeros(search_kernels.MOVE_BITS + 1, dtype=np.int64)
        col_steps = np.zeros(search_kernels.MOVE_BITS + 1, dtype=np.int64)
        row_steps[: len(arrays.ROW_STEP)] = arrays.ROW_STEP
        col_steps[: len(arrays.COL_STEP)] = arrays.COL_STEP
        row_offsets = row_steps[moves]
        col_offsets = col_steps[moves]
        width = flat.layout.width[flat.level_of(cells)]
        next_cells = np.where(np.isfinite(cost), cells - row_offsets * width - col_offsets, -1)
        is_by_link = (moves[links.cell] == search_kernels.BY_LINK) & (next_cells[links.cell] >= 0)
        next_cells[links.cell[is_by_link]] = self._visits.link_from[is_by_link]
        return cost, next_cells

    def _search_all_cells(
        self, sources: Int, by: str, *, reverse_links: bool
    ) -> tuple[Float, Int32]:
        """Reach all cells from several cells, without a goal.

        Args:
            sources: flat ids of free cells, int64.
            by: ``cost``, ``time`` or ``length``, see `graph_with_costs`.
            reverse_links: whether links are taken from their ends to their starts, as for routes
                that lead to the sources.

        Returns:
            Each cell's cost, inf where none is reached; and the move that reached the cell, see
            `navbake.runtime.search_kernels`; both by flat id.
        """
        graph = self.graph_with_costs(by, reverse_links=reverse_links)
        self._run_search(graph, sources, NO_CELLS)
        mark = self._visits.mark
        is_reached = mark >= self._search_number * search_kernels.SEARCH_UNIT
        cost = np.where(is_reached, self._visits.cost, np.inf)
        return cost, mark & search_kernels.MOVE_BITS

    def _run_search(self, graph: Graph, sources: Int, goal_cells: Int) -> Int:
        """Call `navbake.runtime.search_kernels.find_route`, with a queue that grows as needed."""
        while True:
            # marks of earlier searches stay, as each search has its own number
            self._search_number += 1
            if self._search_number > LAST_SEARCH:
                self._visits.mark[:] = 0
                self._search_number = 1
            status, route = search_kernels.find_route(
                graph, sources, goal_cells, self._search_number, self._visits
            )
            if status == search_kernels.SEARCH_DONE:
                return np.asarray(route)
            queue_size = 4 * len(self._visits.entry_cell)
            self._visits = self._visits._replace(
                entry_cell=np.empty(queue_size, dtype=np.int32),
                entry_next=np.empty(queue_size, dtype=np.int32),
            )
