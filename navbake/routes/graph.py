"""What a graph of routes is: named places, and lanes between them that are free for an agent."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lazy import Method, lazy
from navbake.types import Float, Json, Vector3

csgraph = lazy("scipy.sparse.csgraph")
sparse = lazy("scipy.sparse")

FLOOR = "floor"  # kind of a lane along a straight line on one level


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
    """A way from one node to another, along a straight line or over a link."""

    start: int  #: Index of a node.
    end: int  #: Index of another one.
    name: str
    length: float  #: [m]
    cost: float  #: Of a passage: its length times the price of its cells, or a link's cost [m].
    two_way: bool = True
    kind: str = FLOOR  #: ``floor``, ``stairs``, ``ramp``, or the kind of a link.
    speed: float | None = None  #: The highest on it [m/s]; None for the agent's.
    seconds: float | None = None  #: Of a passage of a link; None for its length at its speed.
    door: str | None = None  #: The id of the door that it leads through.
    link: str | None = None  #: The name of the link that it is a passage of.


@dataclass(frozen=True)
class RouteGraph:
    """A graph of routes of one agent."""

    nodes: tuple[Node, ...]
    lanes: tuple[Lane, ...]
    scene_id: str | None = None
    level_names: tuple[str, ...] = ("level 0",)
    agent: str | None = None  #: The agent's name.
    radius: float = 0.0  #: Of the agent [m].
    speed: float = 1.0  #: The agent's [m/s].

    save = Method[list[Any]]("navbake.formats.route_files:write_routes")
    audit = Method[Any]("navbake.auditor.routes:audit_routes")

    def __repr__(self) -> str:
        one_way = sum(not lane.two_way for lane in self.lanes)
        text = f"RouteGraph({len(self.nodes)} nodes, {len(self.lanes)} lanes"
        return f"{text}, {one_way} of them one-way)" if one_way else f"{text})"

    @property
    def positions(self) -> Float:
        """The nodes' positions, shape (n, 3), float64 [m]."""
        return np.array([node.position for node in self.nodes], dtype=np.float64).reshape(-1, 3)

    @property
    def costs(self) -> Any:
        """The cost of the cheapest lane from each node to each other, a scipy csr_array [m]."""
        cheapest: dict[tuple[int, int], float] = {}
        for lane in directed(self.lanes):
            ends = lane.start, lane.end
            cheapest[ends] = min(lane.cost, cheapest.get(ends, math.inf))
        size = len(self.nodes), len(self.nodes)
        if not cheapest:
            return sparse.csr_array(size)
        return sparse.csr_array((list(cheapest.values()), np.array([*cheapest]).T), shape=size)

    def distances(self) -> Float:
        """The costs of the cheapest routes between all nodes [m], shape (n, n), inf for none."""
        found: Float = csgraph.dijkstra(self.costs)
        return found

    def route(self, start: int | str, end: int | str) -> list[int] | None:
        """The nodes of the cheapest route between two, by index or name; None if there is none."""
        first = self.index_of(start)
        last = self.index_of(end)
        _, before = csgraph.dijkstra(self.costs, indices=first, return_predecessors=True)
        way = [last]
        while way[-1] != first:
            way.append(int(before[way[-1]]))
            if way[-1] < 0:
                return None
        return way[::-1]

    def index_of(self, node: int | str) -> int:
        """The index of a node; raises a QueryError for an unknown name or index."""
        names = [own.name for own in self.nodes]
        if isinstance(node, str) and node in names:
            return names.index(node)
        if isinstance(node, str) or not 0 <= node < len(names):
            raise QueryError(f"no node {node!r} in the graph: {suggest(str(node), names)}")
        return int(node)

    def on_level(self, number: int) -> RouteGraph:
        """The nodes of one level, and the lanes between them."""
        if not 0 <= number < len(self.level_names):
            count = len(self.level_names)
            raise QueryError(f"no level {number}: the graph has {count}, counted from 0")
        kept = [k for k, node in enumerate(self.nodes) if node.level == number]
        index = {k: place for place, k in enumerate(kept)}
        lanes = [
            replace(lane, start=index[lane.start], end=index[lane.end])
            for lane in self.lanes
            if lane.start in index and lane.end in index
        ]
        nodes = tuple(replace(self.nodes[k], level=0) for k in kept)
        names = (self.level_names[number],)
        return replace(self, nodes=nodes, lanes=tuple(lanes), level_names=names)


# ---------------------------------------------------------------- for files


def directed(lanes: Iterable[Lane]) -> list[Lane]:
    """The lanes one way each; of one that leads both ways, its way back follows it."""
    found = []
    for lane in lanes:
        found.append(replace(lane, two_way=False))
        if lane.two_way:
            found.append(replace(lane, two_way=False, start=lane.end, end=lane.start))
    return found


def undirected(lanes: Sequence[Lane]) -> tuple[Lane, ...]:
    """Join lanes that differ in nothing but their direction; the inverse of `directed`."""
    waiting: dict[Lane, list[int]] = {}
    found: list[Lane] = []
    for lane in lanes:
        back = replace(lane, start=lane.end, end=lane.start)
        if waiting.get(back):
            place = waiting[back].pop()
            found[place] = replace(found[place], two_way=True)
        else:
            waiting.setdefault(lane, []).append(len(found))
            found.append(lane)
    return tuple(found)


def entry_of(thing: Node | Lane | RouteGraph, *left_out: str) -> Json:
    """The fields of a node, a lane or a graph as JSON, without those that are None.

    Those of a graph lack its nodes and lanes.
    """
    fields = {name: getattr(thing, name) for name in thing.__dataclass_fields__}
    without = {"nodes", "lanes", *left_out}
    return {key: v for key, v in fields.items() if v is not None and key not in without}
