"""Makes graphs of routes of what their files hold: nodes by key, and lanes one way each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from navbake.formats.allowance import JsonPath, number
from navbake.navgrid.metadata import read_table
from navbake.routes.graph import Lane, Node, RouteGraph, undirected
from navbake.types import Json


class Rows:
    """Nodes and one-way lanes of a file while it is read.

    A node is found by the key that the file has for it. A ``number`` in an entry is its place in
    the graph, where files group nodes by level.
    """

    def __init__(self) -> None:
        self.nodes: list[tuple[Any, Node]] = []  # each after its number
        self.index: dict[Any, int] = {}  # of a node among these, by its key
        self.lanes: list[tuple[Any, Lane]] = []

    def add_node(self, key: Any, position: Any, entry: Json, place: JsonPath) -> None:
        """Add a node at x, y and maybe z [m]; raises a FormatError."""
        if not isinstance(key, int | str | tuple):
            place.refuse("the id of a node", key)
        if key in self.index:
            place.fail(f"two nodes have the id {key!r}")
        if not isinstance(position, list) or len(position) not in (2, 3):
            place.refuse("a node's x and y [m]", position)
        x, y, z = (float(number(v, place)) for v in [*position, 0.0][:3])
        fields = {"name": str(key), **entry, "position": (x, y, z)}
        made: Node = read_table(fields, Node, f"{place.path} in {place.file}")
        self.index[key] = len(self.nodes)
        self.nodes.append((entry.get("number"), made))

    def add_lane(self, start: Any, end: Any, entry: Json, place: JsonPath) -> None:
        """Add a lane one way between the keys of nodes, its length by them unless stated."""
        for key in (start, end):
            if not isinstance(key, int | str | tuple) or key not in self.index:
                place.refuse("the id of a node", key)
        ends = self.index[start], self.index[end]
        one, other = (self.nodes[k][1] for k in ends)
        length = math.dist(one.position[:2], other.position[:2])
        fields = {"name": "", "length": length, "cost": entry.get("length", length), **entry}
        fields |= {"start": ends[0], "end": ends[1], "two_way": False}
        made: Lane = read_table(fields, Lane, f"{place.path} in {place.file}")
        self.lanes.append((entry.get("number"), made))

    def key_of(self, index: Any, place: JsonPath) -> Any:
        """The key of the node with a number."""
        found = [key for key, k in self.index.items() if self.nodes[k][0] == index]
        return found[0] if found else place.refuse("the number of a node", index)

    def join_lifts(self) -> None:
        """Add lanes between the nodes of a lift on several levels."""
        for one, other in itertools.permutations(range(len(self.nodes)), 2):
            (_, a), (_, b) = self.nodes[one], self.nodes[other]
            if a.link and a.link == b.link and a.level != b.level:
                length = math.dist(a.position, b.position)
                lane = Lane(one, other, a.link, length, length, False, "lift", link=a.link)
                self.lanes.append((None, lane))


def make_graph(
    rows: Rows, about: Any, place: JsonPath, level_names: Sequence[str] = ("level 0",)
) -> RouteGraph:
    """Make a graph of a file's rows, and of its own entry about it if it has one.

    Raises:
        FormatError: an entry is wrong, or two nodes have one name.
    """
    order, ways = _in_order(rows.nodes), _in_order(rows.lanes)
    index = {k: at for at, k in enumerate(order)}
    found = [rows.lanes[k][1] for k in ways]
    lanes = [replace(own, start=index[own.start], end=index[own.end]) for own in found]
    made = tuple(rows.nodes[k][1] for k in order)
    highest = max((node.level for node in made), default=0)
    names = [*level_names, *(f"level {k}" for k in range(len(level_names), highest + 1))]
    stated = {"level_names": names, **(about if isinstance(about, dict) else {})}
    known = {k: v for k, v in stated.items() if k in RouteGraph.__dataclass_fields__}
    fields = {**known, "nodes": made, "lanes": undirected(lanes)}
    where = f"navbake in {place.file}"
    graph: RouteGraph = read_table(fields, RouteGraph, where)
    taken = set[str]()
    for node in made:
        if node.name in taken or not 0 <= node.level < len(graph.level_names):
            place.fail(f"expected nodes of unique names on known levels, got {node}")
        taken.add(node.name)
    return graph


def _in_order(rows: list[tuple[Any, Any]]) -> list[int]:
    """The places of rows by their numbers; as they are if one has none."""
    numbers = [stated for stated, _ in rows]
    if not all(isinstance(stated, int) for stated in numbers):
        return list(range(len(rows)))
    return sorted(range(len(rows)), key=numbers.__getitem__)
