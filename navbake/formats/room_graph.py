"""The rooms of a grid as a graph: which ways lead from room to room, and how wide they are."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from navbake.errors import QueryError
from navbake.formats.cell_graph import CellGraph, import_networkx, make_cell_graph
from navbake.formats.source import Files
from navbake.lazy import lazy
from navbake.navgrid.door_lines import find_ends
from navbake.navgrid.doors import Door
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.rooms import Room
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.regions import map_rooms
from navbake.runtime.search import Search
from navbake.types import Float, Int, Vector3

if TYPE_CHECKING:
    import networkx

sparse = lazy("scipy.sparse")
csgraph = lazy("scipy.sparse.csgraph")

OUTSIDE = "(outside)"  # the node that doors without a second room lead to
DOOR_REACH = 0.4  # how far from a door's cells an opening is that it closes [m]


@dataclass(frozen=True)
class RoomWay:
    """A way from one room to another.

    Attributes:
        rooms: the ids of both, the first as the grid lists them first.
        kind: ``door``, ``open`` (no door between) or ``link`` (a step to another level).
        door: the door's id, None unless the kind is ``door``.
        state: what the door is in now, None unless the kind is ``door``.
        passable: whether steps lead this way now; never to the outside, where the grid ends.
        width: of a door, its length; of an opening, the straight distance from its first to its
            last free cell, each counted whole; of a link, the longer extent of the cells that it
            leads from [m].
        position: its middle on the floor, world x, y, z [m].
        length: from the one room's centre straight to `position`, and on to the other's [m].
    """

    rooms: tuple[str, str]
    kind: str
    door: str | None
    state: str | None
    passable: bool
    width: float
    position: Vector3
    length: float


@dataclass(frozen=True, eq=False)
class RoomGraph:
    """Rooms and the ways between them: the topological map of a grid.

    Attributes:
        rooms: as the grid lists them, then those that only its cells name.
        ways: by the rooms that they lead between, then by kind and place; two rooms may have
            several. A door that leads out of all rooms leads to ``(outside)``.
        level_names: of the grid's levels.
    """

    rooms: list[Room]
    ways: list[RoomWay]
    level_names: list[str]

    def to_networkx(self) -> networkx.MultiGraph[Any]:
        """The graph for networkx: rooms by their id, ways as edges between them.

        Nodes have ``name``, ``level``, ``level_name``, ``area`` [m²], ``x``, ``y``, ``z`` of the
        centre [m], ``outdoors``; edges have ``kind``, ``door``, ``state``, ``passable``,
        ``width``, ``x``, ``y``, ``z``, ``length`` [m]. What has no name, door or state has "".

        Raises:
            MissingDependencyError: networkx is not installed.
        """
        graph: networkx.MultiGraph[Any] = import_networkx().MultiGraph()
        for room in self.rooms:
            x, y, z = room.centroid
            graph.add_node(
                room.id, name=room.name or "", level=room.level,
                level_name=self.level_names[room.level], area=float(room.area),
                x=float(x), y=float(y), z=float(z), outdoors=room.outdoors,
            )  # fmt: skip
        if any(OUTSIDE in way.rooms for way in self.ways):
            graph.add_node(OUTSIDE, name="", outdoors=True)
        for way in self.ways:
            x, y, z = way.position
            graph.add_edge(
                *way.rooms, kind=way.kind, door=way.door or "", state=way.state or "",
                passable=way.passable, width=way.width, x=x, y=y, z=z, length=way.length,
            )  # fmt: skip
        return graph


class _Opening(NamedTuple):
    """Where steps lead from one room to another: connected sides of cells, or links."""

    rooms: tuple[int, int]  # by number, ascending
    kind: str
    cells: Int  # flat ids, on both sides; of a link, on its first level
    width: float
    position: Float


_Way = tuple[tuple[int, int], _Opening, Door | None, bool]
"""The rooms by number, 0 for the outside; where; the door; whether steps lead through."""


def make_room_graph(grid: NavGrid) -> RoomGraph:
    """Make the graph of a grid's rooms, as they are now.

    A way leads between two rooms where a step of an agent does, see `PathFinder`: over the sides of
    neighbouring cells, or over links to another level. Sides that meet are one opening. One within
    0.4 m of a door's cells, between the door's rooms, is that door. A door through which no step
    leads now (it is closed, or something stands in it) is a way, too, but not passable. Cells that
    are in no room are no part of the graph.
    """
    search, room_map = Search(grid), map_rooms(grid)
    flat, number = search.flat, room_map.number
    openings = [*_find_openings(search, number), *_find_links(flat, number)]
    number_of = {room.id: k for k, room in enumerate(room_map.rooms, 1)}
    ways: list[_Way] = []
    taken: set[int] = set()
    for door in grid.doors:
        ways += _door_ways(grid, flat, (door, number_of), openings, taken)
    for k, opening in enumerate(openings):
        if k not in taken:
            ways.append((opening.rooms, opening, None, True))
    rooms = room_map.rooms
    described = [_describe(rooms, *way) for way in ways]
    order = sorted(
        range(len(ways)), key=lambda k: (ways[k][0], described[k].kind, described[k].position)
    )
    return RoomGraph(rooms, [described[k] for k in order], grid.level_names)


def _find_openings(search: Search, number: Any) -> Iterator[_Opening]:
    """Where steps lead between neighbouring cells of two rooms."""
    from navbake.runtime.kernels.arrays import EAST, SOUTH  # numba loads slowly

    flat, moves = search.flat, search.graph.moves
    for level in range(flat.num_levels):
        own = flat.cells_of(level)
        width, size = int(flat.layout.width[level]), float(flat.layout.cell_size[level])
        sides = []
        for bit, step in ((EAST, 1), (SOUTH, width)):
            one = own.start + np.flatnonzero(moves[own] & bit)
            a, b = number[one], number[one + step]
            one = one[(a != b) & (a > 0) & (b > 0)]
            row, col = np.divmod(one - own.start, width)
            # both ends of the side between the cells, as corners of cells
            first = (row, col + 1) if step == 1 else (row + 1, col)
            ends = [r * (width + 1) + c for r, c in (first, (row + 1, col + 1))]
            sides.append(np.stack([one, one + step, *ends]))
        found = np.concatenate(sides, axis=1)
        pairs = np.sort(number[found[:2]], axis=0).astype(np.int64)
        for group in _connected(pairs, found[2:]):
            corners = np.divmod(found[2:, group], width + 1)
            extent = [np.ptp(v) * size for v in corners]
            cells = found[:2, group]
            middle = flat.positions(cells).mean(axis=(0, 1))
            low, high = pairs[:, group[0]].tolist()
            yield _Opening((low, high), "open", np.unique(cells), math.hypot(*extent), middle)


def _find_links(flat: FlatGrid, number: Any) -> Iterator[_Opening]:
    """Where links lead between two rooms."""
    one, other = flat.link_ends()
    level, row, col = flat.split(np.stack([one, other]))
    beside = (level[0] == level[1]) & (np.abs(row[0] - row[1]) + np.abs(col[0] - col[1]) == 1)
    a, b = number[one].astype(np.int64), number[other].astype(np.int64)
    # each link is there both ways
    is_way = flat.free[one] & flat.free[other] & (a > 0) & (b > 0) & (a < b) & ~beside
    one, other = one[is_way], other[is_way]
    level, row, col = (values[0, is_way] for values in (level, row, col))
    if not len(one):
        return
    pairs = np.stack([a[is_way], b[is_way]])
    width = int(flat.layout.width.max()) + 1
    base = level * (int(flat.layout.height.max()) + 1)
    corners = np.stack([(base + row + i) * width + col + j for i in (0, 1) for j in (0, 1)])
    for group in _connected(pairs, corners):
        size = float(flat.layout.cell_size[level[group[0]]])
        extent = max(np.ptp(row[group]), np.ptp(col[group])) + 1
        ends = np.stack([one[group], other[group]])
        middle = flat.positions(ends).mean(axis=(0, 1))
        low, high = pairs[:, group[0]].tolist()
        yield _Opening((low, high), "link", np.unique(one[group]), float(extent * size), middle)


def _connected(pairs: Int, corners: Int) -> Iterator[Int]:
    """Groups of items of one pair of rooms that share corners, by union-find over both.

    `pairs` has shape (2, n), `corners` (k, n); of each group the ascending indices of its items.
    """
    count = pairs.shape[1]
    if not count:
        return
    keys = np.stack([np.broadcast_to(row, corners.shape) for row in (*pairs,)] + [corners])
    _, corner = np.unique(keys.reshape(3, -1), axis=1, return_inverse=True)
    item = np.broadcast_to(np.arange(count), corners.shape).ravel()
    size = count + int(corner.max()) + 1
    graph = sparse.coo_array(
        (np.ones(len(item), dtype=np.int8), (item, count + corner.ravel())), shape=(size, size)
    )
    part = csgraph.connected_components(graph, directed=False)[1][:count]
    order = np.argsort(part, kind="stable")
    yield from np.split(order, np.flatnonzero(np.diff(part[order])) + 1)


def _door_ways(
    grid: NavGrid,
    flat: FlatGrid,
    named: tuple[Door, dict[str, int]],
    openings: list[_Opening],
    taken: set[int],
) -> Iterator[_Way]:
    """The way through a door: the openings that it closes are added to those that are taken."""
    door, number_of = named
    ends = [number_of.get(room, 0) if room is not None else 0 for room in door.rooms]
    if len(ends) != 2 or ends[0] == ends[1]:
        return  # the file says of no two rooms that it joins them
    rooms = min(ends), max(ends)
    lines = [(k, find_ends(grid, door, k)) for k in door.levels]
    placed = [(k, np.array(ends)) for k, ends in lines if ends is not None]
    if not placed:
        return
    level, line = placed[0]
    closes = [
        k
        for k, opening in enumerate(openings)
        if opening.kind == "open" and opening.rooms == rooms and k not in taken
        and int(flat.level_of(opening.cells[0])) == level
        and _distance(line, flat.positions(opening.cells)[:, :2]) <= DOOR_REACH
    ]  # fmt: skip
    taken.update(closes)
    middle = line.mean(axis=0)
    cell = grid.cell_at(middle, level)
    z = grid.levels[level].ground if cell is None else float(grid.position_of(cell)[2])
    width = float(np.linalg.norm(line[1] - line[0]))
    opening = _Opening(rooms, "door", np.empty(0, dtype=np.int64), width, np.array([*middle, z]))
    yield rooms, opening, door, bool(closes)


def _distance(line: Float, points: Float) -> float:
    """From the nearest of some points to a line from one end to the other [m]."""
    start, along = line[0], line[1] - line[0]
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
    return float(np.linalg.norm(points - start - share[:, None] * along, axis=1).min())


def _describe(
    rooms: list[Room], ends: tuple[int, int], opening: _Opening, door: Door | None, passable: bool
) -> RoomWay:
    position = opening.position
    x, y, z = (round(float(v), 6) + 0.0 for v in position)
    length = sum(math.dist(rooms[end - 1].centroid, (x, y, z)) for end in ends if end)
    names = tuple(rooms[end - 1].id if end else OUTSIDE for end in ends)
    return RoomWay(
        rooms=(names[0], names[1]),
        kind=opening.kind,
        door=door.id if door else None,
        state=door.state if door else None,
        passable=passable,
        width=round(opening.width, 6),
        position=(x, y, z),
        length=round(length, 6),
    )


def encode_graphml(grid: NavGrid, path: Path) -> Files:
    """Make a GraphML file of a grid's rooms, see `RoomGraph.to_networkx`.

    Raises:
        MissingDependencyError: networkx is not installed.
    """
    networkx = import_networkx()
    graph = make_room_graph(grid).to_networkx()
    named = networkx.relabel_nodes(graph, {node: _allowed(node) for node in graph})
    for _, entry in named.nodes(data=True):
        entry.update({key: _allowed(v) for key, v in entry.items() if isinstance(v, str)})
    for *_, entry in named.edges(data=True):
        entry.update({key: _allowed(v) for key, v in entry.items() if isinstance(v, str)})
    file = io.BytesIO()
    # this one of its writers needs the standard library alone, so all machines write the same
    networkx.write_graphml_xml(named, file)
    return {path: file.getvalue() + b"\n"}


def _allowed(text: str) -> str:
    """A name without what XML 1.0 can't hold: control characters become replacement characters."""
    return "".join(c if c >= " " and c not in "\ufffe\uffff" else "\ufffd" for c in text)


def make_graph(
    grid: NavGrid, kind: str = "cells", *, cut_corners: bool = False
) -> CellGraph | RoomGraph:
    """Make the graph of a grid's cells (``cells``) or rooms (``rooms``), as they are now.

    Args:
        grid: a grid of one or several levels.
        kind: see `make_cell_graph` and `make_room_graph`.
        cut_corners: let diagonal steps pass blocked corners; of ``cells``.

    Raises:
        QueryError: the kind is unknown, or a weight is negative.
    """
    if kind == "cells":
        return make_cell_graph(grid, cut_corners=cut_corners)
    if kind == "rooms":
        return make_room_graph(grid)
    raise QueryError(f"expected cells or rooms as kind of graph, got {kind!r}")
