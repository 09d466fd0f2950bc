"""Makes the graph of routes of a grid: nodes where agents turn, and lanes that are free for them.

Nodes are doors, the widest places of rooms, the stops of links and stairs, and junctions of the
medial axis of the free cells. Where a free cell is farther than `MAX_NODE_DISTANCE` from all of
these, waypoints are added. Lanes are straight lines on which the disc of an agent overlaps no
obstacle (`Search.can_pass`), and links. They form a greedy spanner: a lane is left out if a route
over shorter lanes costs at most 5 % more. Where two nodes are near and such a route is missing, the
corners of the path between them become nodes. Then the spanner is made again, of all nodes.

Source: Althöfer et al. 1993 for the spanner; Zhang and Suen 1984 for thinning.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navbake.lazy import lazy
from navbake.navgrid.door_states import find_door_lines
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.links import DEFAULT_SPEED, Agent, Link
from navbake.routes.graph import FLOOR, Doorway, Lane, LiftCar, Node, RouteGraph
from navbake.routes.lane_graph import LaneGraph
from navbake.runtime.agents import find_agent, fit_grid
from navbake.runtime.flat_grid import FlatGrid, find_leaf_cells, find_stairs
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int

lane_kernels = lazy("navbake.routes.lane_kernels")  # numba loads slowly
line_kernels = lazy("navbake.runtime.line_kernels")
ndimage = lazy("scipy.ndimage")
sparse = lazy("scipy.sparse")
spatial = lazy("scipy.spatial")

MIN_ISLAND_AREA = 4.0  # smaller islands have no nodes but the stops of links [m²]
MAX_NODE_DISTANCE = 1.8  # largest distance from any cell to its nearest node [m]
MIN_JUNCTION_SPACING = 1.0  # a junction nearer to a node in its sight is left out [m]
CORNER_SNAP_DISTANCE = 0.4  # a node this near to a path's corner may take its place [m]
# a node's region are the cells from which no other node is nearer; two nodes need a short route
# between them if at most this many borders of regions lie between them
MAX_REGION_HOPS = 3
MAX_DETOUR_FACTOR = (
    1.05  # largest cost of a route over other lanes, as a multiple of the lane's own cost
)
MAX_LANE_LENGTH = 20.0  # [m]
SQUARE_EDGE = 1.0  # nodes are listed by squares of this edge, to find those near a place [m]
PROGRESS_INTERVAL = 100  # pairs of nodes after which progress is reported
DECIMALS = 6  # positions and lengths are rounded to this many decimals: to micrometres


def make_routes(
    grid: NavGrid,
    agent: str | Agent | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> RouteGraph:
    """Make the graph of routes of a grid for an agent, as the grid is now.

    The grid is inflated to the agent's radius.

    Args:
        grid: the grid, with its doors and obstacles in their present states.
        agent: an agent's name in the grid, or an Agent; None for an agent of the grid's radius that
            may use all links and enter all areas.
        progress: called with ``routes`` and the fraction that is done, 0 to 1; None for no report.

    Returns:
        The graph, with positions in world coordinates [m].

    Raises:
        QueryError: the grid has no agent of that name, or was not made for one of its size.
    """
    return _Builder(grid, find_agent(grid, agent)).build(progress or (lambda name, fraction: None))


class _Stairs(NamedTuple):
    """Stairs or a ramp between two levels."""

    name: str
    kind: str  # ``stairs`` or ``ramp``
    cells: list[int]  # flat ids of one step between the levels: its lower and its upper cell


class _Builder:
    """Builds the graph of routes of a grid: collects nodes and lanes."""

    def __init__(self, grid: NavGrid, agent: Agent | None) -> None:
        self.speed = DEFAULT_SPEED if agent is None else agent.speed
        fitted_grid = fit_grid(grid, agent)
        self.radius = fitted_grid.radius
        if fitted_grid.inflated_radius < fitted_grid.radius:
            # lines are swept exactly on inflated grids only
            fitted_grid = fitted_grid.inflate(fitted_grid.radius)
        agent_of_any_size = agent and agent.without_sizes()
        self.search = Search(fitted_grid, agent=agent_of_any_size, radius=self.radius)
        self.grid = self.search.grid
        self.flat = self.search.flat
        self.lattices = [level.lattice for level in self.grid.levels]

        # arrays by flat id
        islands = self.search.islands
        is_large = islands.areas >= MIN_ISLAND_AREA
        self.is_routable: Bool = self.flat.free & is_large[islands.number]
        self.clearance = _measure_clearance(self.grid, self.flat)
        self.area_of_cell = np.concatenate([level.area_index.ravel() for level in self.grid.levels])
        self.leaf_doors = {
            cell: door.id
            for door in grid.doors
            for cell in find_leaf_cells(door, self.flat).tolist()
        }
        self.doorways = [
            Doorway(
                door_line.id, level_number, _round_xy(door_line.start), _round_xy(door_line.end)
            )
            for level_number in range(len(grid.levels))
            for door_line in find_door_lines(grid, level_number)
        ]

        self.least_weight = float(self.flat.weight[self.flat.free].min(initial=1.0))
        self.links = [
            link
            for link in self.grid.links
            if link.refuses(self.search.agent) is None and link.fits(self.radius)
        ]
        self.stairs = self._find_stairs()

        self.node_cells: list[int] = []  # flat id of each node's cell
        self.nodes: list[Node] = []
        self.nodes_of_cell: dict[int, list[int]] = {}  # flat id -> indices of the nodes there
        # level, and x and y in units of `SQUARE_EDGE` -> indices of the nodes in this square
        self.nodes_of_square: dict[tuple[int, int, int], list[int]] = {}
        self.lanes: list[Lane] = []
        self.lane_graph = LaneGraph(self.least_weight)

    def build(self, progress: Callable[[str, float], None]) -> RouteGraph:
        """Add all nodes and lanes, and return the graph; see `make_routes` for `progress`."""
        progress("routes", 0.0)
        self._add_named_places()
        self._add_junctions()
        self._add_waypoints()
        self._add_lanes_of_links()
        self._add_lanes_in_sight()
        num_nodes = len(self.nodes)
        self._add_paths_between_neighbors(progress)
        if len(self.nodes) > num_nodes:
            self._choose_floor_lanes_again()
        graph = self._make_graph()
        progress("routes", 1.0)
        return graph

    def _find_stairs(self) -> list[_Stairs]:
        """Find the stairs between levels, and the widest free step of each."""
        stairs = []
        for stairs_number, (_, _, kind, steps) in enumerate(find_stairs(self.grid, self.flat)):
            free_steps = steps[self.is_routable[steps].all(axis=1)]
            if not len(free_steps):
                continue
            clearance = np.round(self.clearance[free_steps].min(axis=1), DECIMALS)
            step_centers = self.flat.positions(free_steps).mean(axis=1)
            center_distances = np.linalg.norm(step_centers - step_centers.mean(axis=0), axis=1)
            best_index = np.lexsort((center_distances, -clearance))[0]
            stairs.append(_Stairs(f"{kind} {stairs_number}", kind, free_steps[best_index].tolist()))
        return stairs

    # ---------------------------------------------------------------- nodes

    def _add_node(
        self, cell: int, kind: str, name: str = "", *, door: str | None = None, link: str = ""
    ) -> int:
        """Add a node at a cell's centre, unless the cell has one already.

        Links that stop on the same cell get a node each, because a node names one link.

        Args:
            cell: flat id.
            kind: see `Node`; a junction or waypoint in the cell gets this kind and name instead.
            name: of the node; empty for a number.
            door: id of the door that the node stands in.
            link: name of the link that the node is a stop of; empty for none.

        Returns:
            The index of the new node, or of the cell's earlier one.
        """
        level, row, col = self.flat.to_cell(cell)
        x, y = _round_xy(self.lattices[level].position(row, col))
        z = round(float(self.flat.floor_heights(cell)), DECIMALS) + 0.0
        node = Node(
            name,
            position=(x, y, z),
            level=level,
            kind=kind,
            room=self.search.rooms.id_of(int(self.search.rooms.number[cell])),
            door=door,
            link=link or None,
        )
        nodes_of_cell = self.nodes_of_cell.setdefault(cell, [])
        for index in nodes_of_cell:
            earlier_node = self.nodes[index]
            is_of_other_link = link and earlier_node.link and link != earlier_node.link
            if not is_of_other_link:
                if earlier_node.kind in ("junction", "waypoint") and kind != "waypoint":
                    self.nodes[index] = node
                return index
        new_index = len(self.nodes)
        self.node_cells.append(cell)
        self.nodes.append(node)
        nodes_of_cell.append(new_index)
        self.nodes_of_square.setdefault(_square_of(node), []).append(new_index)
        self.lane_graph.add_node(x, y)
        return new_index

    def _remove_nodes_from(self, first_node: int) -> None:
        """Remove the nodes from an index on: those that were added last, and have no lanes yet."""
        while len(self.nodes) > first_node:
            node = self.nodes.pop()
            cell = self.node_cells.pop()
            self.nodes_of_cell[cell].pop()
            self.nodes_of_square[_square_of(node)].pop()
            self.lane_graph.remove_last_node()

    def _find_nodes_near(self, cell: int, max_distance: float) -> dict[int, float]:
        """Find the nodes that are nearer to a cell's centre than a distance, on the same level.

        Args:
            cell: flat id.
            max_distance: at most `SQUARE_EDGE` [m].

        Returns:
            Index of a node, ascending -> its distance, seen from above [m].
        """
        level, row, col = self.flat.to_cell(cell)
        center_x, center_y = self.lattices[level].position(row, col)
        first_col = math.floor((center_x - max_distance) / SQUARE_EDGE)
        last_col = math.floor((center_x + max_distance) / SQUARE_EDGE)
        first_row = math.floor((center_y - max_distance) / SQUARE_EDGE)
        last_row = math.floor((center_y + max_distance) / SQUARE_EDGE)
        nodes_in_squares = sorted(
            node
            for row in range(first_row, last_row + 1)
            for col in range(first_col, last_col + 1)
            for node in self.nodes_of_square.get((level, col, row), ())
        )
        distances = {}
        for node in nodes_in_squares:
            x, y, _ = self.nodes[node].position
            distance = math.hypot(x - center_x, y - center_y)
            if distance < max_distance:
                distances[node] = distance
        return distances

    def _add_named_places(self) -> None:
        """Add the stops of links and stairs, doors, and the widest place of each room."""
        for link in self.links:
            for stop_number, cell in enumerate(self._stop_cells(link)):
                if self.flat.free[cell]:
                    self._add_node(cell, "stop", f"{link.name} {stop_number}", link=link.name)
        for stairs in self.stairs:
            for cell in stairs.cells:
                self._add_node(cell, "stop", f"{stairs.name} {self.flat.level_of(cell)}")
        for door in self.grid.doors:
            cells = find_leaf_cells(door, self.flat)
            cells = cells[self.is_routable[cells]]
            if len(cells):
                widest_cell = int(cells[np.argmax(np.round(self.clearance[cells], DECIMALS))])
                self._add_node(widest_cell, "door", door.id, door=door.id)
        rooms = self.search.rooms
        for room_number, room in enumerate(rooms.rooms, 1):
            cells = np.flatnonzero((rooms.number == room_number) & self.is_routable)
            if len(cells):
                # of several with the same clearance, the nearest to the room's centre
                center_distances = np.linalg.norm(
                    self.flat.positions(cells) - room.centroid, axis=1
                )
                clearance = np.round(self.clearance[cells], DECIMALS)
                best_index = np.lexsort((center_distances, -clearance))[0]
                self._add_node(int(cells[best_index]), "room", room.name or room.id)

    def _stop_cells(self, link: Link) -> list[int]:
        """List the flat ids of the cells of a link's stops."""
        level_starts = self.flat.layout.start
        return [int(level_starts[stop.level]) + stop.cell for stop in link.stops]

    def _add_junctions(self) -> None:
        """Add junctions where three branches of the medial axis meet, the widest places first.

        A junction is left out if a node near it sees it.
        """
        cells_of_levels = []
        for level_number, level in enumerate(self.grid.levels):
            level_cells = self.flat.cells_of(level_number)
            is_on_axis = thin_mask(self.is_routable[level_cells].reshape(level.shape))
            axis_cells = np.flatnonzero(is_on_axis)
            rows, cols = np.divmod(axis_cells, level.width)
            padded_axis = np.pad(is_on_axis, 1)
            neighbors = _take_neighbors(padded_axis, (rows + 1) * (level.width + 2) + cols + 1)
            junction_cells = axis_cells[_count_runs(neighbors) >= 3]
            cells_of_levels.append(level_cells.start + junction_cells)
        cells = np.concatenate(cells_of_levels)
        sort_indices = np.argsort(-np.round(self.clearance[cells], DECIMALS), kind="stable")
        for cell in cells[sort_indices].tolist():
            near_nodes = self._find_nodes_near(cell, MIN_JUNCTION_SPACING)
            if not any(self._sees(self.node_cells[node], cell) for node in near_nodes):
                self._add_node(cell, "junction")

    def _add_waypoints(self) -> None:
        """Add waypoints until every cell is near a node, beginning with the farthest cells."""
        cells = np.flatnonzero(self.is_routable)
        positions = self.flat.positions(cells)
        positions[:, 2] += 1e3 * self.flat.level_of(cells)  # other levels are far
        cell_tree = spatial.cKDTree(positions)
        islands = self.search.islands.number[cells]
        while True:
            distances = np.full(len(cells), math.inf)
            if self.node_cells:
                node_cells = np.array(self.node_cells, dtype=np.int64)
                distances = self.search.compute_cost_field(node_cells, by="length")[cells]
            far_indices = np.flatnonzero(distances > MAX_NODE_DISTANCE)
            if not len(far_indices):
                return
            far_indices = far_indices[np.argsort(-distances[far_indices], kind="stable")]
            is_covered = np.zeros(len(cells), dtype=np.bool_)
            for far_index in far_indices.tolist():
                if is_covered[far_index]:
                    continue
                near_indices = np.array(
                    cell_tree.query_ball_point(positions[far_index], MAX_NODE_DISTANCE / 2)
                )
                near_indices = near_indices[islands[near_indices] == islands[far_index]]
                clearance = np.round(self.clearance[cells[near_indices]], DECIMALS)
                widest_index = near_indices[np.lexsort((near_indices, -clearance))[0]]
                # a wider place only where this one is seen from it
                is_seen = self._sees(cells[widest_index], cells[far_index])
                self._add_node(int(cells[widest_index if is_seen else far_index]), "waypoint")
                is_covered[cell_tree.query_ball_point(positions[far_index], MAX_NODE_DISTANCE)] = (
                    True
                )

    def _sees(self, cell: int, target_cell: int) -> bool:
        """Whether an agent may move straight from one cell's centre to another's on the same level.

        It may if `Search.can_pass` allows it, or over steps along a row, column or diagonal.
        """
        return bool(lane_kernels.sees(cell, target_cell, self.search.graph, self.search.off_center))

    # ---------------------------------------------------------------- lanes

    def _distance(self, node: int, target_node: int) -> float:
        """Compute the distance between two nodes, seen from above [m]."""
        x, y, _ = self.nodes[node].position
        target_x, target_y, _ = self.nodes[target_node].position
        return float(np.hypot(x - target_x, y - target_y))

    def _lane_cost(self, node: int, target_node: int) -> float:
        """Compute the cost of a lane between two nodes [m].

        On one level, it is the cost of the straight line; between levels, its length seen from
        above.
        """
        level = self.nodes[node].level
        length = self._distance(node, target_node)
        if level != self.nodes[target_node].level:
            return length
        mean_weight: float = lane_kernels.measure_mean_weight(
            self.nodes[node].position[:2],
            self.nodes[target_node].position[:2],
            level,
            self.search.graph,
        )
        return length * mean_weight

    def _cells_on_lane(self, node: int, target_node: int) -> Int:
        """List the flat ids of the cells on the straight line between two nodes of a level."""
        cells: Int = lane_kernels.sample_line(
            self.nodes[node].position[:2],
            self.nodes[target_node].position[:2],
            self.nodes[node].level,
            self.flat.layout,
        )
        return cells

    def _doors_on_lane(self, node: int, target_node: int) -> set[str | None]:
        """List the ids of the doors that a lane leads through, and None.

        A lane leads through a door if it crosses the leaf, or if a node at its end stands in the
        door.
        """
        doors = self._doors_of_ends(node, target_node)
        if self.leaf_doors:
            cells = self._cells_on_lane(node, target_node)
            doors |= {self.leaf_doors.get(cell) for cell in cells.tolist()}
        return doors

    def _doors_of_ends(self, node: int, target_node: int) -> set[str | None]:
        """List the ids of the doors that two nodes stand in, and None."""
        return {None, self.nodes[node].door, self.nodes[target_node].door}

    def _is_lane_free(self, node: int, target_node: int, allowed_doors: set[str | None]) -> bool:
        """Whether a straight lane is free, and leads through no doors but the allowed ones.

        `allowed_doors` holds the ids of these doors, and None, which stands for no door.
        """
        is_seen = self._sees(self.node_cells[node], self.node_cells[target_node])
        return is_seen and self._doors_on_lane(node, target_node) <= allowed_doors

    def _add_lane(self, lane: Lane) -> None:
        """Add a lane."""
        self.lanes.append(lane)
        self.lane_graph.add_lane(lane.start, lane.end, lane.cost)
        if lane.two_way:
            self.lane_graph.add_lane(lane.end, lane.start, lane.cost)

    def _add_straight_lane(
        self, node: int, target_node: int, cost: float, kind: str = FLOOR
    ) -> None:
        """Add the lane along the straight line between two nodes, of a cost [m]."""
        self._add_lane(
            Lane(
                node,
                target_node,
                name="",
                length=self._distance(node, target_node),
                cost=cost,
                kind=kind,
            )
        )

    def _add_lanes_of_links(self) -> None:
        """Add the lanes over links and stairs."""
        for link in self.links:
            node_of_cell = {
                cell: index
                for index, (cell, node) in enumerate(zip(self.node_cells, self.nodes, strict=True))
                if node.link in (None, link.name)
            }
            cells = self._stop_cells(link)
            for first_stop, last_stop in itertools.combinations(range(len(cells)), 2):
                if cells[first_stop] == cells[last_stop]:
                    continue
                start = node_of_cell.get(cells[first_stop])
                end = node_of_cell.get(cells[last_stop])
                if start is None or end is None:
                    continue
                length = link.length(first_stop, last_stop)
                cost = length if link.cost is None else link.cost
                self._add_lane(
                    Lane(
                        start,
                        end,
                        name="",
                        length=length,
                        cost=cost,
                        two_way=not link.one_way,
                        kind=link.kind,
                        link=link.name,
                        seconds=cost / self.speed if link.seconds is None else link.seconds,
                    )
                )
        node_of_cell = {cell: index for index, cell in enumerate(self.node_cells)}
        for stairs in self.stairs:
            lower_cell, upper_cell = stairs.cells
            start = node_of_cell[lower_cell]
            end = node_of_cell[upper_cell]
            self._add_straight_lane(start, end, self._lane_cost(start, end), stairs.kind)

    def _add_lanes_in_sight(self) -> None:
        """Add lanes between nodes that see each other, as `_add_shortest_lanes` chooses them."""
        self._add_shortest_lanes(self._find_pairs_in_sight(), free_lane_costs={})

    def _choose_floor_lanes_again(self) -> None:
        """Choose the lanes on floors again, as corners of paths have become nodes since.

        The lanes that there are, and all between nodes that see each other, are chosen from. So a
        corner has lanes to the nodes near it, and takes the place of lanes that pass it.
        """
        free_lane_costs = {
            (min(lane.start, lane.end), max(lane.start, lane.end)): lane.cost
            for lane in self.lanes
            if lane.kind == FLOOR
        }
        other_lanes = [lane for lane in self.lanes if lane.kind != FLOOR]
        self.lanes = []
        self.lane_graph = LaneGraph(self.least_weight)
        for node in self.nodes:
            self.lane_graph.add_node(*node.position[:2])
        for lane in other_lanes:
            self._add_lane(lane)
        path_pairs = np.array(list(free_lane_costs), dtype=np.int64).reshape(-1, 2)
        node_pairs = np.concatenate([self._find_pairs_in_sight(), path_pairs])
        self._add_shortest_lanes(np.unique(node_pairs, axis=0), free_lane_costs)

    def _find_pairs_in_sight(self) -> Int:
        """Find the pairs of nodes of a level that may see each other, not too far apart.

        Returns:
            The indices of the nodes, the lower one first, shape (n, 2).
        """
        positions = np.array([node.position for node in self.nodes])
        levels = np.array([node.level for node in self.nodes])
        pairs_of_levels = [np.empty((0, 2), dtype=np.int64)]
        for level in range(self.flat.num_levels):
            nodes = np.flatnonzero(levels == level)
            if len(nodes) > 1:
                node_points = positions[nodes, :2]
                node_tree = spatial.cKDTree(node_points)
                near_pairs = node_tree.query_pairs(MAX_LANE_LENGTH, output_type="ndarray")
                pairs_of_levels.append(nodes[self._drop_blocked(near_pairs, node_points, level)])
        node_pairs: Int = np.sort(np.concatenate(pairs_of_levels), axis=1)
        return node_pairs

    def _add_shortest_lanes(
        self, node_pairs: Int, free_lane_costs: Mapping[tuple[int, int], float]
    ) -> None:
        """Add free lanes between nodes, the shortest first, unless there is a route without them.

        A route counts if it leads over the lanes so far, and costs at most `MAX_DETOUR_FACTOR` as
        much as the lane.

        Args:
            node_pairs: the indices of the nodes, the lower one first, shape (n, 2).
            free_lane_costs: pairs whose lanes are known to be free -> cost of the lane [m]. Other
                lanes may lead through the doors at their ends only.
        """
        if not len(node_pairs):
            return
        for node, target_node, length in self._shortest_first(node_pairs):
            least_cost = length * self.least_weight
            if not self._needs_lane(node, target_node, MAX_DETOUR_FACTOR * least_cost):
                continue
            is_known_free = (node, target_node) in free_lane_costs
            if is_known_free:
                lane_cost = free_lane_costs[node, target_node]
            else:
                lane_cost = self._lane_cost(node, target_node)
            if self._needs_lane(node, target_node, MAX_DETOUR_FACTOR * lane_cost) and (
                is_known_free
                or self._is_lane_free(node, target_node, self._doors_of_ends(node, target_node))
            ):
                self._add_straight_lane(node, target_node, lane_cost)

    def _needs_lane(self, node: int, target_node: int, max_cost: float) -> bool:
        """Whether no route over lanes between two nodes costs at most `max_cost` [m].

        No lane is needed if that is infinite: then a cell on the line is not free.
        """
        if math.isinf(max_cost):
            return False
        return not self.lane_graph.has_route(node, target_node, max_cost)

    def _drop_blocked(self, node_pairs: Int, points: Float, level: int) -> Int:
        """Leave out pairs of nodes with a cell between them that isn't free.

        The lines are tried at their middle, then at their quarters, and so on: most of those that
        are blocked are so at one of the first points. Points are about a cell apart at the end, so
        some blocked lines may remain.

        Args:
            node_pairs: indices in `points`, shape (n, 2).
            points: world x, y, shape (m, 2) [m].
            level: number of the level.

        Returns:
            The remaining pairs, shape (k, 2).
        """
        cell_size = self.lattices[level].cell_size
        starts = points[node_pairs[:, 0]]
        line_vectors = points[node_pairs[:, 1]] - starts
        lengths = np.hypot(line_vectors[:, 0], line_vectors[:, 1])
        is_clear = np.ones(len(node_pairs), dtype=np.bool_)
        num_parts = 2
        while True:
            lines = np.flatnonzero(is_clear & (lengths * 2 > num_parts * cell_size))
            if not len(lines):
                return node_pairs[is_clear]
            for part in range(1, num_parts, 2):
                lines = lines[is_clear[lines]]
                line_points = starts[lines] + part / num_parts * line_vectors[lines]
                is_clear[lines] = self.flat.free[self.flat.cells_at(line_points, level)]
            num_parts *= 2

    def _shortest_first(self, node_pairs: Int) -> list[tuple[int, int, float]]:
        """Sort pairs of nodes, shape (n, 2), by their distance.

        Returns:
            The nodes of each pair, and their distance [m]; the shortest first.
        """
        first_nodes, second_nodes = node_pairs.T
        positions = np.array([node.position for node in self.nodes])
        position_offsets = positions[first_nodes] - positions[second_nodes]
        lengths = np.round(np.hypot(position_offsets[:, 0], position_offsets[:, 1]), DECIMALS)
        sort_indices = np.lexsort((second_nodes, first_nodes, lengths))
        return [
            (int(first_nodes[index]), int(second_nodes[index]), float(lengths[index]))
            for index in sort_indices
        ]

    def _add_paths_between_neighbors(self, progress: Callable[[str, float], None]) -> None:
        """Add paths between nodes whose cells are near, unless a short route over lanes exists.

        Each cell belongs to the node to which the path from it costs the least.
        """
        num_nodes = len(self.nodes)
        if not num_nodes:
            return
        touching_pairs = self._find_touching_nodes()
        edge_values = np.ones(len(touching_pairs), np.int64)
        is_touching = sparse.csr_array(
            (edge_values, tuple(touching_pairs.T)), (num_nodes, num_nodes)
        )
        is_touching = is_touching + is_touching.T
        is_near = is_touching
        for _ in range(MAX_REGION_HOPS - 1):
            is_near = is_near + is_near @ is_touching
        near_pairs = np.stack(sparse.triu(is_near, 1).nonzero(), axis=1)
        sorted_pairs = self._shortest_first(near_pairs)
        for pair_number, (node, target_node, length) in enumerate(sorted_pairs):
            if pair_number % PROGRESS_INTERVAL == 0:
                progress("routes", pair_number / len(sorted_pairs))
            least_cost = length * self.least_weight
            if self._needs_lane(node, target_node, MAX_DETOUR_FACTOR * least_cost):
                self._add_path(node, target_node, self._doors_of_ends(node, target_node))
        # through doors that stand side by side
        for node, target_node in self._find_touching_nodes().tolist():
            if not self.lane_graph.has_route(node, target_node, math.inf):
                self._add_path(node, target_node, {None, *self.leaf_doors.values()})

    def _find_touching_nodes(self) -> Int:
        """Find the pairs of nodes whose cells touch on a level: indices, shape (n, 2)."""
        from navbake.runtime.grid_arrays import EAST, SOUTH  # numba loads slowly

        node_cells = np.array(self.node_cells)
        _, next_cell = self.search.find_next_cells(node_cells)
        nearest_cell = np.where(next_cell < 0, np.arange(len(next_cell)), next_cell)
        while (nearest_cell != nearest_cell[nearest_cell]).any():
            nearest_cell = nearest_cell[nearest_cell]
        node_of_cell = np.full(len(nearest_cell), -1)
        node_of_cell[node_cells] = np.arange(len(node_cells))
        pairs_of_levels = []
        for level in range(self.flat.num_levels):
            level_cells = self.flat.cells_of(level)
            width = int(self.flat.layout.width[level])
            for direction_bit, cell_offset in ((EAST, 1), (SOUTH, width)):
                can_move = self.search.graph.moves[level_cells] & direction_bit
                cells = level_cells.start + np.flatnonzero(can_move)
                node_indices = node_of_cell[nearest_cell[cells]]
                neighbor_indices = node_of_cell[nearest_cell[cells + cell_offset]]
                pairs_of_levels.append(np.stack([node_indices, neighbor_indices], axis=1))
        node_pairs = np.concatenate(pairs_of_levels)
        both_have_nodes = (node_pairs >= 0).all(axis=1)
        touching_pairs: Int = node_pairs[both_have_nodes & (node_pairs[:, 0] != node_pairs[:, 1])]
        return np.unique(touching_pairs, axis=0)

    def _add_path(self, start_node: int, end_node: int, allowed_doors: set[str | None]) -> None:
        """Add the path between two nodes of a level: nodes at its corners, and lanes between them.

        Nothing is added if a route over lanes is about as short, the path leaves the level, or one
        of its lanes is not free or leads through another door.

        Args:
            start_node: index of the first node.
            end_node: index of the last node.
            allowed_doors: ids of the doors that the lanes may lead through, and None.
        """
        level = self.nodes[start_node].level
        if level != self.nodes[end_node].level:
            return
        end_cell = self.node_cells[end_node]
        route = self.search.find_route(self.node_cells[start_node], np.array([end_cell]))
        if route is None:
            return
        # a route takes no links without such steps; to measure it takes long
        if route.is_by_link.any():
            costs = self.search.measure_route(route, self.flat.to_cells(route.cells), "cost")
            if costs.links:
                return
        positions, levels, _ = line_kernels.lay_route(
            route=route.cells,
            is_by_link=route.is_by_link,
            start=np.array(self.nodes[start_node].position[:2]),
            end=np.array(self.nodes[end_node].position[:2]),
            is_smooth=True,
            graph=self.search.graph,
            floors=self.flat.floors,
            off_center=self.search.off_center,
        )
        if (levels != level).any():
            return
        path_cost = lane_kernels.measure_polyline(positions, level, self.search.graph)
        if not self._needs_lane(start_node, end_node, MAX_DETOUR_FACTOR * path_cost):
            return
        num_nodes = len(self.nodes)
        corner_nodes = self._corner_nodes(start_node, end_node, positions, level)
        lane_costs = {
            (corner_node, next_corner_node): self._lane_cost(corner_node, next_corner_node)
            for corner_node, next_corner_node in itertools.pairwise(corner_nodes)
            if corner_node != next_corner_node
        }
        if not all(
            math.isfinite(lane_cost) and self._is_lane_free(*lane_ends, allowed_doors)
            for lane_ends, lane_cost in lane_costs.items()
        ):
            # lanes over some of the corners would lead nowhere
            self._remove_nodes_from(num_nodes)
            return
        for (corner_node, next_corner_node), lane_cost in lane_costs.items():
            if self._needs_lane(corner_node, next_corner_node, lane_cost):
                self._add_straight_lane(corner_node, next_corner_node, lane_cost)

    def _corner_nodes(self, start_node: int, end_node: int, path: Float, level: int) -> list[int]:
        """Find nodes at the corners of a path, so that each sees the next; add missing ones.

        A corner is skipped if the straight line past it costs at most `MAX_DETOUR_FACTOR` as much.

        Args:
            start_node: index of the node at the path's start.
            end_node: index of the node at its end.
            path: world positions of the path's points, shape (n, 3) [m].
            level: number of the level.

        Returns:
            The indices of the nodes, from `start_node` to `end_node`.
        """
        inner_cells = lane_kernels.find_corner_cells(path[1:-1], level, self.flat.layout)
        corner_cells = np.append(inner_cells, self.node_cells[end_node])
        corner_nodes = [start_node]
        first_index = 0  # of the corners after the last node
        while first_index < len(corner_cells):
            previous_node = corner_nodes[-1]
            num_skipped, mean_weight = lane_kernels.find_farthest_corner(
                self.node_cells[previous_node],
                corner_cells[first_index:],
                MAX_DETOUR_FACTOR,
                self.search.graph,
                self.search.off_center,
            )
            farthest_index = first_index + num_skipped
            cell = int(corner_cells[farthest_index])
            corner_node = None
            if farthest_index + 1 < len(corner_cells):
                next_cell = int(corner_cells[farthest_index + 1])
                corner_node = self._node_in_place_of(cell, previous_node, next_cell, mean_weight)
            if corner_node is None:
                corner_node = self._add_node(cell, "waypoint")
            corner_nodes.append(corner_node)
            first_index = farthest_index + 1
        return corner_nodes

    def _node_in_place_of(
        self, cell: int, previous_node: int, next_cell: int, mean_weight: float
    ) -> int | None:
        """Find the nearest node that can take the place of a path's corner.

        It must see the node before and the cell after the corner. The lane from the node before
        must cost at most `MAX_DETOUR_FACTOR` times its length at the path's mean weight.

        Args:
            cell: flat id of the corner's cell.
            previous_node: index of the node before.
            next_cell: flat id of the cell of the next corner.
            mean_weight: mean weight of the cells on the path from the node before.

        Returns:
            The node's index; None if there is none.
        """
        distances = self._find_nodes_near(cell, CORNER_SNAP_DISTANCE)
        for node in sorted(distances, key=distances.__getitem__):
            max_cost = MAX_DETOUR_FACTOR * mean_weight * self._distance(previous_node, node)
            if (
                self._sees(self.node_cells[node], self.node_cells[previous_node])
                and self._sees(self.node_cells[node], next_cell)
                and self._lane_cost(previous_node, node) <= max_cost
            ):
                return node
        return None

    # ---------------------------------------------------------------- the graph

    def _make_graph(self) -> RouteGraph:
        """Make the graph: give nodes unique names, and lanes their names, doors and speeds."""
        used_names = set[str]()
        nodes = list[Node]()
        for node_number, node in enumerate(self.nodes):
            base_name = node.name or f"{node.kind} {node_number}"
            name = base_name
            while name in used_names:
                name = f"{base_name} ({node_number})"
                node_number += 1
            used_names.add(name)
            nodes.append(replace(node, name=name))
        lanes = [self._finish_lane(lane, nodes) for lane in self.lanes]
        return RouteGraph(
            nodes=tuple(nodes),
            lanes=tuple(lanes),
            scene_id=self.grid.scene_id,
            level_names=tuple(self.grid.level_names),
            agent=(self.search.agent and self.search.agent.name) or None,
            radius=self.radius,
            speed=self.speed,
            cars=tuple(
                LiftCar(link.name, *(round(float(value), DECIMALS) for value in link.car))
                for link in self.links
                if link.car is not None
            ),
            doorways=tuple(self.doorways),
        )

    def _finish_lane(self, lane: Lane, nodes: list[Node]) -> Lane:
        """Return a lane with its name, rounded numbers, door, and the lowest speed of its areas."""
        start = nodes[lane.start]
        end = nodes[lane.end]
        lane = replace(
            lane,
            name=f"{start.name} - {end.name}",
            length=round(float(lane.length), DECIMALS),
            cost=round(float(lane.cost), DECIMALS),
            seconds=None if lane.seconds is None else round(float(lane.seconds), DECIMALS),
        )
        if lane.kind != FLOOR:
            return lane
        doors = [door for door in self._doors_on_lane(lane.start, lane.end) if door]
        speed_limits = []
        if self.grid.areas:
            cells = self._cells_on_lane(lane.start, lane.end)
            for number in np.unique(self.area_of_cell[cells]).tolist():
                if number and self.grid.areas[number - 1].speed is not None:
                    speed_limits.append(self.grid.areas[number - 1].speed)
        return replace(lane, door=min(doors, default=None), speed=min(speed_limits, default=None))


def _square_of(node: Node) -> tuple[int, int, int]:
    """Return a node's level, and its x and y in units of `SQUARE_EDGE`, rounded down."""
    x, y, _ = node.position
    return node.level, math.floor(x / SQUARE_EDGE), math.floor(y / SQUARE_EDGE)


def _round_xy(point: Sequence[float]) -> tuple[float, float]:
    """Round world x, y [m] to micrometres."""
    x, y = point
    return round(float(x), DECIMALS) + 0.0, round(float(y), DECIMALS) + 0.0


def _measure_clearance(grid: NavGrid, flat: FlatGrid) -> Float:
    """Measure the distance from each free cell's centre to the nearest one that isn't free.

    Returns distances by flat id, 0 where a cell isn't free [m].
    """
    clearance = []
    for level_number, level in enumerate(grid.levels):
        is_free = flat.free[flat.cells_of(level_number)].reshape(level.shape)
        # beyond the level's edge is no free cell
        distance_in_cells = ndimage.distance_transform_edt(np.pad(is_free, 1))[1:-1, 1:-1]
        clearance.append(distance_in_cells.ravel() * level.lattice.cell_size)
    return np.concatenate(clearance)


def _take_neighbors(padded_mask: Bool, cells: Int) -> Bool:
    """Look up the eight neighbours of cells of a mask.

    Args:
        padded_mask: the mask with one more cell on each side, C-contiguous.
        cells: indices in the flattened `padded_mask`, shape (n,), none of them on its edge.

    Returns:
        Whether each neighbour is in the mask, clockwise from the upper one, shape (8, n).
    """
    width = padded_mask.shape[1]
    offsets = (-width, 1 - width, 1, width + 1, width, width - 1, -1, -width - 1)
    flat_mask = padded_mask.ravel()
    return np.stack([flat_mask[cells + offset] for offset in offsets])


def _count_runs(neighbors: Bool) -> Int:
    """Count the runs that neighbours in a mask form around a cell.

    Args:
        neighbors: of each cell, see `_take_neighbors`, shape (8, n).

    Returns:
        Shape (n,).
    """
    next_neighbors = np.roll(neighbors, -1, axis=0)
    num_runs: Int = np.count_nonzero(~neighbors & next_neighbors, axis=0)
    return num_runs


def thin_mask(mask: Bool) -> Bool:
    """Thin a mask to lines one cell wide (Zhang and Suen 1984).

    Args:
        mask: shape (height, width).

    Returns:
        The thinned mask, of the same shape.
    """
    padded_mask = np.pad(mask, 1)
    flat_mask = padded_mask.ravel()  # a view
    width = padded_mask.shape[1]
    around = np.add.outer((-width, 0, width), (-1, 0, 1)).ravel()
    cells = np.flatnonzero(flat_mask)
    removed_before = cells  # as if cells near all others had been removed
    for is_first_pass in itertools.cycle((True, False)):
        neighbors = _take_neighbors(padded_mask, cells)
        north, _, east, _, south, _, west, _ = neighbors
        if is_first_pass:
            must_stay = (north & east & south) | (east & south & west)
        else:
            must_stay = (north & east & west) | (north & south & west)
        num_neighbors = np.count_nonzero(neighbors, axis=0)
        is_border = (num_neighbors >= 2) & (num_neighbors <= 6) & (_count_runs(neighbors) == 1)
        removed = cells[is_border & ~must_stay]
        flat_mask[removed] = False
        if not len(removed) and not len(removed_before):
            break
        # the next pass leaves all cells as the pass before this one did, but near removed ones
        removed_since = np.concatenate([removed_before, removed])
        cells_near = (removed_since[:, None] + around).ravel()
        cells = np.unique(cells_near[flat_mask[cells_near]])
        removed_before = removed
    return padded_mask[1:-1, 1:-1]
