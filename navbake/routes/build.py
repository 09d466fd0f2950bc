"""Makes the graph of routes of a grid: nodes where agents turn, and lanes that are free for them.

Nodes are doors, the widest places of rooms, the stops of links and stairs, and junctions of the
medial axis of the free cells. Where a free cell is farther than `MAX_NODE_DISTANCE` from all of
these, waypoints are added. Lanes are straight lines on which the disc of an agent overlaps no
obstacle (`Search.can_pass`), and links. They form a greedy spanner: a lane is left out if a route
over shorter lanes costs at most 5 % more. Where two nodes are near and such a route is missing, the
corners of the path between them become nodes.

Source: Althöfer et al. 1993 for the spanner; Zhang and Suen 1984 for thinning.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navbake.lazy import lazy
from navbake.navgrid.door_states import find_door_lines
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.links import DEFAULT_SPEED, Agent, Link
from navbake.routes.graph import FLOOR, Doorway, Lane, LiftCar, Node, RouteGraph
from navbake.runtime.agents import find_agent, fit_grid
from navbake.runtime.flat_grid import FlatGrid, find_leaf_cells, find_stairs
from navbake.runtime.paths import find_path
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int

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
DECIMALS = 6  # positions and lengths are rounded to this many decimals: to micrometres


def make_routes(grid: NavGrid, agent: str | Agent | None = None) -> RouteGraph:
    """Make the graph of routes of a grid for an agent, as the grid is now.

    The grid is inflated to the agent's radius.

    Args:
        grid: the grid, with its doors and obstacles in their present states.
        agent: an agent's name in the grid, or an Agent; None for an agent of the grid's radius that
            may use all links and enter all areas.

    Returns:
        The graph, with positions in world coordinates [m].

    Raises:
        QueryError: the grid has no agent of that name, or was not made for one of its size.
    """
    return _Builder(grid, find_agent(grid, agent)).build()


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
        self.node_positions = np.empty((0, 3))  # the nodes' positions [m]
        self.lanes: list[Lane] = []
        self.route_costs = np.empty((0, 0))  # of the cheapest routes between nodes [m]

    def build(self) -> RouteGraph:
        """Add all nodes and lanes, and return the graph."""
        self._add_named_places()
        self._add_junctions()
        self._add_waypoints()
        self._add_lanes_of_links()
        self._add_lanes_in_sight()
        self._add_paths_between_neighbors()
        return self._make_graph()

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
        node_position = np.round(self.flat.positions(cell), DECIMALS) + 0.0
        x, y, z = node_position.tolist()
        node = Node(
            name,
            position=(x, y, z),
            level=int(self.flat.level_of(cell)),
            kind=kind,
            room=self.search.rooms.id_of(int(self.search.rooms.number[cell])),
            door=door,
            link=link or None,
        )
        for index, earlier_node in enumerate(self.nodes):
            is_of_other_link = link and earlier_node.link and link != earlier_node.link
            if self.node_cells[index] == cell and not is_of_other_link:
                if earlier_node.kind in ("junction", "waypoint") and kind != "waypoint":
                    self.nodes[index] = node
                return index
        self.node_cells.append(cell)
        self.nodes.append(node)
        self.node_positions = np.concatenate([self.node_positions, node_position[None]])
        self.route_costs = np.pad(self.route_costs, (0, 1), constant_values=math.inf)
        self.route_costs[-1, -1] = 0.0
        return len(self.nodes) - 1

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
            _, num_branches = _count_neighbors(np.pad(is_on_axis, 1))
            junction_cells = np.flatnonzero(is_on_axis & (num_branches >= 3))
            cells_of_levels.append(level_cells.start + junction_cells)
        cells = np.concatenate(cells_of_levels)
        sort_indices = np.argsort(-np.round(self.clearance[cells], DECIMALS), kind="stable")
        for cell in cells[sort_indices].tolist():
            level_number = int(self.flat.level_of(cell))
            distances = np.hypot(*(self.node_positions - self.flat.positions(cell))[:, :2].T)
            near_node_indices = np.flatnonzero(distances < MIN_JUNCTION_SPACING).tolist()
            if not any(
                self.nodes[node].level == level_number and self._sees(self.node_cells[node], cell)
                for node in near_node_indices
            ):
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
        from navbake.runtime.grid_arrays import COL_STEP, ROW_STEP  # numba loads slowly

        level = int(self.flat.level_of(cell))
        start_position, end_position = self.flat.positions(np.array([cell, target_cell]))
        start_xy = np.round(start_position[:2], DECIMALS)
        end_xy = np.round(end_position[:2], DECIMALS)
        if self.search.can_pass(start_xy, end_xy, level):
            return True
        _, (row, target_row), (col, target_col) = self.flat.to_cells(np.array([cell, target_cell]))
        row_offset = int(target_row - row)
        col_offset = int(target_col - col)
        num_steps = max(abs(row_offset), abs(col_offset))
        is_straight = row_offset == 0 or col_offset == 0 or abs(row_offset) == abs(col_offset)
        if not num_steps or not is_straight:
            return False
        row_step = row_offset // num_steps
        col_step = col_offset // num_steps
        directions = list(zip(ROW_STEP, COL_STEP, strict=True))
        direction_bit = directions.index((row_step, col_step))
        cell_step = row_step * int(self.flat.layout.width[level]) + col_step
        crossed_cells = cell + cell_step * np.arange(num_steps)
        return bool((self.search.graph.moves[crossed_cells] >> direction_bit & 1).all())

    # ---------------------------------------------------------------- lanes

    def _distance(self, node: int, target_node: int) -> float:
        """Compute the distance between two nodes, seen from above [m]."""
        position_offset = self.node_positions[node] - self.node_positions[target_node]
        return float(np.hypot(position_offset[0], position_offset[1]))

    def _lane_cost(self, node: int, target_node: int) -> float:
        """Compute the cost of a lane between two nodes [m].

        On one level, it is the cost of the straight line; between levels, its length seen from
        above.
        """
        level = self.nodes[node].level
        if level != self.nodes[target_node].level:
            return self._distance(node, target_node)
        return self._line_cost(self.node_positions[[node, target_node], :2], level)

    def _line_cost(self, points: Float, level: int) -> float:
        """Compute the cost of a polyline on a level [m]; `points` are x, y, shape (n, 2) [m]."""
        return sum(
            float(np.hypot(*(end - start))) * self._mean_weight(start, end, level)
            for start, end in itertools.pairwise(points)
        )

    def _mean_weight(self, start: Float, end: Float, level: int) -> float:
        """Compute the mean weight of the cells on a straight line between two points x, y [m]."""
        return float(self.flat.weight[self._cells_on_line(start, end, level)].mean())

    def _cells_on_line(self, start: Float, end: Float, level: int) -> Int:
        """List the cells of points on a line, about a quarter of a cell apart, by flat id."""
        cell_size = float(self.flat.layout.cell_size[level])
        num_points = math.ceil(float(np.linalg.norm(end - start)) / cell_size * 4) + 1
        fractions = (np.arange(num_points) + 0.5)[:, None] / num_points
        return self.flat.cells_at(start + fractions * (end - start), level)

    def _doors_on_lane(self, node: int, target_node: int) -> set[str | None]:
        """List the ids of the doors that a lane leads through, and None.

        A lane leads through a door if it crosses the leaf, or if a node at its end stands in the
        door.
        """
        start, end = self.node_positions[[node, target_node], :2]
        cells = self._cells_on_line(start, end, self.nodes[node].level)
        crossed_doors = {self.leaf_doors.get(cell) for cell in cells.tolist()}
        return crossed_doors | self._doors_of_ends(node, target_node)

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
        """Add a lane, and update the costs of the cheapest routes between all nodes."""
        self.lanes.append(lane)
        directions = [(lane.start, lane.end)]
        if lane.two_way:
            directions.append((lane.end, lane.start))
        for start, end in directions:
            costs_over_lane = (
                self.route_costs[:, start, None] + lane.cost + self.route_costs[None, end]
            )
            np.minimum(self.route_costs, costs_over_lane, out=self.route_costs)

    def _add_straight_lane(self, node: int, target_node: int, kind: str = FLOOR) -> None:
        """Add the lane along the straight line between two nodes."""
        self._add_lane(
            Lane(
                node,
                target_node,
                name="",
                length=self._distance(node, target_node),
                cost=self._lane_cost(node, target_node),
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
            self._add_straight_lane(node_of_cell[lower_cell], node_of_cell[upper_cell], stairs.kind)

    def _add_lanes_in_sight(self) -> None:
        """Add lanes between nodes that see each other, unless a route over shorter lanes exists.

        Such a route counts if it costs at most `MAX_DETOUR_FACTOR` as much as the lane.
        """
        levels = self.flat.level_of(np.array(self.node_cells, dtype=np.int64))
        pairs_of_levels = []
        for level in range(self.flat.num_levels):
            nodes = np.flatnonzero(levels == level)
            if len(nodes) > 1:
                node_tree = spatial.cKDTree(self.node_positions[nodes, :2])
                near_pairs = node_tree.query_pairs(MAX_LANE_LENGTH, output_type="ndarray")
                pairs_of_levels.append(nodes[near_pairs])
        if not pairs_of_levels:
            return
        node_pairs = np.sort(np.concatenate(pairs_of_levels), axis=1)
        for node, target_node, length in self._shortest_first(node_pairs):
            if (
                self.route_costs[node, target_node] > MAX_DETOUR_FACTOR * length * self.least_weight
                and self.route_costs[node, target_node]
                > MAX_DETOUR_FACTOR * self._lane_cost(node, target_node)
                and self._is_lane_free(node, target_node, self._doors_of_ends(node, target_node))
            ):
                self._add_straight_lane(node, target_node)

    def _shortest_first(self, node_pairs: Int) -> list[tuple[int, int, float]]:
        """Sort pairs of nodes, shape (n, 2), by their distance.

        Returns:
            The nodes of each pair, and their distance [m]; the shortest first.
        """
        first_nodes, second_nodes = node_pairs.T
        position_offsets = self.node_positions[first_nodes] - self.node_positions[second_nodes]
        lengths = np.round(np.hypot(position_offsets[:, 0], position_offsets[:, 1]), DECIMALS)
        sort_indices = np.lexsort((second_nodes, first_nodes, lengths))
        return [
            (int(first_nodes[index]), int(second_nodes[index]), float(lengths[index]))
            for index in sort_indices
        ]

    def _add_paths_between_neighbors(self) -> None:
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
        for node, target_node, length in self._shortest_first(near_pairs):
            if self.route_costs[node, target_node] > MAX_DETOUR_FACTOR * length * self.least_weight:
                self._add_path(node, target_node, self._doors_of_ends(node, target_node))
        # through doors that stand side by side
        for node, target_node in self._find_touching_nodes().tolist():
            if not math.isfinite(self.route_costs[node, target_node]):
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
        node_pairs = np.unique(np.concatenate(pairs_of_levels), axis=0)
        both_have_nodes = (node_pairs >= 0).all(axis=1)
        touching_pairs: Int = node_pairs[both_have_nodes & (node_pairs[:, 0] != node_pairs[:, 1])]
        return touching_pairs

    def _add_path(self, start_node: int, end_node: int, allowed_doors: set[str | None]) -> None:
        """Add the path between two nodes of a level: nodes at its corners, and lanes between them.

        Nothing is added if a route over lanes is about as short, or the path leaves the level.

        Args:
            start_node: index of the first node.
            end_node: index of the last node.
            allowed_doors: ids of the doors that the lanes may lead through, and None.
        """
        level = self.nodes[start_node].level
        if level != self.nodes[end_node].level:
            return
        start = self.node_positions[start_node, :2]
        end = self.node_positions[end_node, :2]
        path = find_path(self.search, start, end, level, by="cost", smooth=True)
        if path is None or path.links or (path.levels != level).any():
            return
        path_cost = self._line_cost(path.positions[:, :2], level)
        if self.route_costs[start_node, end_node] <= MAX_DETOUR_FACTOR * path_cost:
            return
        corner_nodes = self._corner_nodes(start_node, end_node, path.positions[:, :2], level)
        for corner_node, next_corner_node in itertools.pairwise(corner_nodes):
            if (
                corner_node != next_corner_node
                and self.route_costs[corner_node, next_corner_node]
                > self._lane_cost(corner_node, next_corner_node)
                and self._is_lane_free(corner_node, next_corner_node, allowed_doors)
            ):
                self._add_straight_lane(corner_node, next_corner_node)

    def _corner_nodes(self, start_node: int, end_node: int, path: Float, level: int) -> list[int]:
        """Find nodes at the corners of a path, so that each sees the next; add missing ones.

        A corner is skipped if the straight line past it costs at most `MAX_DETOUR_FACTOR` as much.

        Args:
            start_node: index of the node at the path's start.
            end_node: index of the node at its end.
            path: x, y of the path's points, shape (n, 2) [m].
            level: number of the level.

        Returns:
            The indices of the nodes, from `start_node` to `end_node`.
        """
        inner_points = path[1:-1]
        cells = self.flat.cells_at(inner_points, level)
        centers = self.flat.positions(cells)[:, :2]
        # corners are at cells' centres; at other points, only the height of the floor bends
        is_corner = np.abs(centers - inner_points).max(axis=1, initial=0.0) < 1e-6
        remaining_cells = [*cells[is_corner].tolist(), self.node_cells[end_node]]
        corner_nodes = [start_node]
        while remaining_cells:
            previous_node = corner_nodes[-1]
            remaining_xy = self.flat.positions(np.array(remaining_cells))[:, :2]
            line_points = np.concatenate([self.node_positions[[previous_node], :2], remaining_xy])
            farthest_index = 0
            for remaining_index, cell in enumerate(remaining_cells):
                if self._sees(self.node_cells[previous_node], cell):
                    straight_cost = self._line_cost(line_points[[0, remaining_index + 1]], level)
                    path_cost = self._line_cost(line_points[: remaining_index + 2], level)
                    if straight_cost <= MAX_DETOUR_FACTOR * path_cost:
                        farthest_index = remaining_index
            cell = remaining_cells[farthest_index]
            next_cells = remaining_cells[farthest_index + 1 : farthest_index + 2]
            corner_node = None
            if next_cells:
                mean_weight = self._mean_weight(
                    line_points[0], line_points[farthest_index + 1], level
                )
                corner_node = self._node_in_place_of(
                    cell, previous_node, next_cells[0], mean_weight
                )
            if corner_node is None:
                corner_node = self._add_node(cell, "waypoint")
            corner_nodes.append(corner_node)
            remaining_cells = remaining_cells[farthest_index + 1 :]
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
        level = int(self.flat.level_of(cell))
        distance = np.hypot(*(self.node_positions - self.flat.positions(cell))[:, :2].T)
        candidate_nodes = [
            index
            for index in np.flatnonzero(distance < CORNER_SNAP_DISTANCE).tolist()
            if self.nodes[index].level == level
            and self._sees(self.node_cells[index], self.node_cells[previous_node])
            and self._sees(self.node_cells[index], next_cell)
            and self._lane_cost(previous_node, index)
            <= MAX_DETOUR_FACTOR * mean_weight * self._distance(previous_node, index)
        ]
        return min(candidate_nodes, key=distance.__getitem__, default=None)

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
        start_xy, end_xy = self.node_positions[[lane.start, lane.end], :2]
        cells = self._cells_on_line(start_xy, end_xy, start.level)
        area_numbers = [number for number in np.unique(self.area_of_cell[cells]).tolist() if number]
        speeds = [self.grid.areas[number - 1].speed for number in area_numbers]
        speed_limits = [speed for speed in speeds if speed is not None]
        return replace(lane, door=min(doors, default=None), speed=min(speed_limits, default=None))


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


def _count_neighbors(padded_mask: Bool) -> tuple[Int, Int]:
    """Count the neighbours in a mask that each cell has, and the runs that they form around it.

    Args:
        padded_mask: the mask with one more cell on each side.

    Returns:
        How many of the eight neighbours are in the mask, shape (height, width) without the padding;
        and how many runs they form on the ring of neighbours, of the same shape.
    """
    height, width = padded_mask[1:-1, 1:-1].shape
    # clockwise from the upper neighbour
    offsets = ((0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0), (0, 0))
    ring = [
        padded_mask[row : row + height, col : col + width].view(np.int8) for row, col in offsets
    ]
    next_in_ring = ring[1:] + ring[:1]
    begins_run = [
        (neighbor == 0) & (next_neighbor == 1)
        for neighbor, next_neighbor in zip(ring, next_in_ring, strict=True)
    ]
    return np.sum(ring, axis=0), np.sum(begins_run, axis=0)


def thin_mask(mask: Bool) -> Bool:
    """Thin a mask to lines one cell wide (Zhang and Suen 1984).

    Args:
        mask: shape (height, width).

    Returns:
        The thinned mask, of the same shape.
    """
    padded_mask = np.pad(mask, 1)
    inner_mask = padded_mask[1:-1, 1:-1]  # a view
    while True:
        num_cells_before = np.count_nonzero(padded_mask)
        for is_first_pass in (True, False):
            num_neighbors, num_runs = _count_neighbors(padded_mask)
            north = padded_mask[:-2, 1:-1]
            east = padded_mask[1:-1, 2:]
            south = padded_mask[2:, 1:-1]
            west = padded_mask[1:-1, :-2]
            if is_first_pass:
                must_stay = (north & east & south) | (east & south & west)
            else:
                must_stay = (north & east & west) | (north & south & west)
            is_border = (num_neighbors >= 2) & (num_neighbors <= 6) & (num_runs == 1)
            inner_mask[inner_mask & is_border & ~must_stay] = False
        if np.count_nonzero(padded_mask) == num_cells_before:
            return inner_mask
