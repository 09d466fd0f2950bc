"""Graphs of routes: named places (nodes), and the lanes between them that an agent can drive."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lazy import lazy
from navbake.routes.graph_methods import RouteGraphMethods
from navbake.types import Float, Json, Vector3

csgraph = lazy("scipy.sparse.csgraph")
sparse = lazy("scipy.sparse")

FLOOR = "floor"  # kind of a lane along a straight line on one level
RECORD_FIELDS = ("cars", "doorways")  # fields of a graph that are tuples of records


@dataclass(frozen=True)
class Node:
    """A place of a graph of routes."""

    name: str  #: Unique in the graph.
    position: Vector3  #: World x, y and floor z [m].
    level: int = 0  #: 0 is the lowest.
    #: ``door``, ``room``, ``stop`` (of a link or stairs), ``junction`` or ``waypoint``.
    kind: str = "waypoint"
    room: str | None = None  #: The id of its room.
    door: str | None = None  #: The id of the door that it stands in.
    link: str | None = None  #: The name of the link that it is a stop of.


@dataclass(frozen=True)
class Lane:
    """A connection of one node to another, along a straight line or over a link."""

    start: int  #: Index of the node that it leads from.
    end: int  #: Index of the node that it leads to.
    name: str
    length: float  #: Seen from above [m].
    cost: float  #: Its length times the mean weight of its cells, or a link's cost [m].
    two_way: bool = True
    kind: str = FLOOR  #: ``floor``, ``stairs``, ``ramp``, or the kind of a link.
    speed: float | None = None  #: The speed limit on it [m/s]; None for the agent's speed.
    #: How long it takes if it leads over a link [s]; None for its length at its speed.
    seconds: float | None = None
    door: str | None = None  #: The id of the door that it leads through.
    link: str | None = None  #: The name of the link that it leads over.


@dataclass(frozen=True)
class LiftCar:
    """The car of a lift, which agents ride in."""

    name: str  #: The name of the lift, as nodes and lanes have it as their `link`.
    x: float  #: World x of its middle [m].
    y: float  #: World y of its middle [m].
    yaw: float  #: Direction of its width, about z from x [rad].
    width: float  #: [m]
    depth: float  #: [m]


@dataclass(frozen=True)
class Doorway:
    """The line across a doorway, which the leaf of a door closes."""

    door: str  #: The id of the door, as nodes and lanes have it.
    level: int  #: 0 is the lowest.
    start: tuple[float, float]  #: One end, world x, y [m].
    end: tuple[float, float]  #: The other end, world x, y [m].


@dataclass(frozen=True)
class RouteGraph(RouteGraphMethods):
    """Named places and the lanes between them, for agents of one size and speed."""

    nodes: tuple[Node, ...]
    lanes: tuple[Lane, ...]
    scene_id: str | None = None
    level_names: tuple[str, ...] = ("level 0",)
    agent: str | None = None  #: The agent's name.
    radius: float = 0.0  #: The agent's radius [m].
    speed: float = 1.0  #: The agent's speed [m/s].
    cars: tuple[LiftCar, ...] = ()  #: The cars of those lifts whose cars are known.
    doorways: tuple[Doorway, ...] = ()  #: The lines of doors, by level.

    def __repr__(self) -> str:
        num_one_way = sum(not lane.two_way for lane in self.lanes)
        text = f"RouteGraph({len(self.nodes)} nodes, {len(self.lanes)} lanes"
        return f"{text}, {num_one_way} of them one-way)" if num_one_way else f"{text})"

    @property
    def positions(self) -> Float:
        """The nodes' positions, shape (n, 3), float64 [m]."""
        return np.array([node.position for node in self.nodes], dtype=np.float64).reshape(-1, 3)

    @property
    def costs(self) -> Any:
        """The costs of the lanes as a sparse matrix, a scipy csr_array, shape (n, n).

        Entry (i, j) is the cost of the cheapest lane from node i to node j [m]. There is no entry
        if no lane leads from i to j.
        """
        cheapest_costs: dict[tuple[int, int], float] = {}
        for lane in split_two_way_lanes(self.lanes):
            node_pair = (lane.start, lane.end)
            cheapest_costs[node_pair] = min(lane.cost, cheapest_costs.get(node_pair, math.inf))
        shape = (len(self.nodes), len(self.nodes))
        if not cheapest_costs:
            return sparse.csr_array(shape)
        node_pairs = np.array(list(cheapest_costs)).T
        return sparse.csr_array((list(cheapest_costs.values()), node_pairs), shape=shape)

    def distances(self) -> Float:
        """Compute the cost of the cheapest route between each two nodes.

        It is the sum of lanes' costs, not of lengths.

        Returns:
            At (i, j) the cost from node i to node j [m], inf for no route, shape (n, n).
        """
        route_costs: Float = csgraph.dijkstra(self.costs)
        return route_costs

    def route(self, start: int | str, end: int | str) -> list[int] | None:
        """Find the cheapest route between two nodes.

        Args:
            start: the first node, by index or name.
            end: the last node, by index or name.

        Returns:
            The indices of its nodes, from start to end; None if there is no route.

        Raises:
            QueryError: there is no such node.

        Example:
            >>> graph.route("Kitchen", "Hall")
            [3, 17, 5]
        """
        start_index = self.index_of(start)
        end_index = self.index_of(end)
        _, predecessors = csgraph.dijkstra(
            self.costs, indices=start_index, return_predecessors=True
        )
        backward_route = [end_index]
        while backward_route[-1] != start_index:
            backward_route.append(int(predecessors[backward_route[-1]]))
            if backward_route[-1] < 0:
                return None
        return backward_route[::-1]

    def index_of(self, node: int | str) -> int:
        """Return the index of a node.

        Args:
            node: the node's index or name.

        Raises:
            QueryError: there is no such node.
        """
        names = [graph_node.name for graph_node in self.nodes]
        if isinstance(node, str) and node in names:
            return names.index(node)
        if isinstance(node, str) or not 0 <= node < len(names):
            raise QueryError(f"no node {node!r} in the graph: {suggest(str(node), names)}")
        return int(node)

    def on_level(self, number: int) -> RouteGraph:
        """Return the part of the graph on one level: the level's nodes, and the lanes between them.

        Args:
            number: number of the level, 0 is the lowest; in the new graph it is level 0.

        Raises:
            QueryError: the graph has no such level.
        """
        if not 0 <= number < len(self.level_names):
            count = len(self.level_names)
            raise QueryError(f"no level {number}: the graph has {count}, counted from 0")
        node_indices = [index for index, node in enumerate(self.nodes) if node.level == number]
        new_index_of_node = {index: place for place, index in enumerate(node_indices)}
        lanes = [
            replace(lane, start=new_index_of_node[lane.start], end=new_index_of_node[lane.end])
            for lane in self.lanes
            if lane.start in new_index_of_node and lane.end in new_index_of_node
        ]
        nodes = [replace(self.nodes[index], level=0) for index in node_indices]
        links = {lane.link for lane in lanes}
        doorways = [
            replace(doorway, level=0) for doorway in self.doorways if doorway.level == number
        ]
        return replace(
            self,
            nodes=tuple(nodes),
            lanes=tuple(lanes),
            level_names=(self.level_names[number],),
            cars=tuple(car for car in self.cars if car.name in links),
            doorways=tuple(doorways),
        )


# ---------------------------------------------------------------- for files


def split_two_way_lanes(lanes: Iterable[Lane]) -> list[Lane]:
    """Replace each lane for both directions by two lanes, the second from its end to its start."""
    one_way_lanes = []
    for lane in lanes:
        one_way_lanes.append(replace(lane, two_way=False))
        if lane.two_way:
            one_way_lanes.append(replace(lane, two_way=False, start=lane.end, end=lane.start))
    return one_way_lanes


def join_opposite_lanes(lanes: Sequence[Lane]) -> tuple[Lane, ...]:
    """Replace each pair of lanes that differ only in direction by one lane in both directions.

    This is the inverse of `split_two_way_lanes`.
    """
    joined_lanes: list[Lane] = []
    # lane without a lane back so far -> indices in `joined_lanes`
    indices_without_return: dict[Lane, list[int]] = {}
    for lane in lanes:
        lane_back = replace(lane, start=lane.end, end=lane.start)
        if indices_without_return.get(lane_back):
            lane_index = indices_without_return[lane_back].pop()
            joined_lanes[lane_index] = replace(joined_lanes[lane_index], two_way=True)
        else:
            indices_without_return.setdefault(lane, []).append(len(joined_lanes))
            joined_lanes.append(lane)
    return tuple(joined_lanes)


def encode_element(element: Node | Lane | RouteGraph, *omitted_names: str) -> Json:
    """Return the fields of a node, a lane or a graph as JSON.

    Fields that are None, empty tables, and the nodes and lanes of a graph, are left out.

    Args:
        element: the node, lane or graph.
        omitted_names: names of further fields to leave out.
    """
    all_omitted_names = {"nodes", "lanes", *omitted_names}
    field_values = {name: getattr(element, name) for name in element.__dataclass_fields__}
    entry = {
        name: value
        for name, value in field_values.items()
        if value is not None and name not in all_omitted_names
    }
    for name in RECORD_FIELDS:
        if name in entry:
            entry[name] = [asdict(row) for row in entry[name]]
            for doorway in entry[name] if name == "doorways" else ():
                doorway |= {"start": list(doorway["start"]), "end": list(doorway["end"])}
            if not entry[name]:
                del entry[name]
    return entry
