"""Graphs of a grid: its cells as a `PathFinder` searches them, and its rooms."""

from __future__ import annotations

import io
import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.formats.source import Files, import_extra, write_bytes
from navbake.lazy import lazy
from navbake.navgrid.door_states import find_leaf_ends
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.lattice import rounded
from navbake.navgrid.rooms import DOOR_REACH, Door, Room
from navbake.runtime.flat_grid import map_rooms
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int, Vector3

if TYPE_CHECKING:
    import networkx

sparse = lazy("scipy.sparse")
csgraph = lazy("scipy.sparse.csgraph")

OUTSIDE = "(outside)"  # the node that doors without a second room lead to
# a cell's neighbours by their place in a row of the matrix: row and column steps, bit of its moves
# (see `navbake.runtime.grid_arrays`)
WAYS = (
    (-1, -1, 5), (-1, 0, 1), (-1, 1, 4), (0, -1, 2), (0, 1, 0), (1, -1, 6), (1, 0, 3), (1, 1, 7),
)  # fmt: skip


def make_graph(
    grid: NavGrid, kind: str = "cells", *, cut_corners: bool = False
) -> CellGraph | RoomGraph:
    """Make the graph of a grid's cells (``cells``) or rooms (``rooms``), as they are now.

    See `make_cell_graph` and `make_room_graph`; `cut_corners` allows diagonal steps past blocked
    corners. Raises a QueryError for an unknown kind or a negative weight.
    """
    if kind == "cells":
        return make_cell_graph(grid, cut_corners=cut_corners)
    if kind == "rooms":
        return make_room_graph(grid)
    raise QueryError(f"expected cells or rooms as kind of graph, got {kind!r}")


# ---------------------------------------------------------------- cells


@dataclass(frozen=True, eq=False)
class CellGraph:
    """The free cells of a grid as nodes, and the steps between them as edges."""

    #: ``matrix[i, j]`` is the cost of the step from node i to node j: its length [m] times the
    #: weight of the cell of j. A scipy csr_array, shape (n, n), float64, columns ascending. Missing
    #: entries are no step; a stored 0 is a step to a cell of weight 0.
    matrix: Any
    level: Int  #: Of each node's cell, shape (n,), int64.
    row: Int  #: Of each node's cell on its level, shape (n,), int64.
    col: Int  #: Of each node's cell, shape (n,), int64.
    cell: Int  #: Its id on its level, ``col + row * width``, shape (n,), int64.
    position: Float  #: World x, y, z of the cell's centre on its floor [m], shape (n, 3), float64.
    grid: NavGrid

    def node_at(self, position: ArrayLike, level: int | None = None) -> int | None:
        """The node of a position's cell, see `GridBase.cell_at`; None if there is no free cell."""
        found = self.grid.cell_at(position, level)
        if found is None:
            return None
        first, last = np.searchsorted(self.level, [found.level, found.level + 1])
        cell = found.col + found.row * self.grid.levels[found.level].width
        node = int(first + np.searchsorted(self.cell[first:last], cell))
        return node if node < last and self.cell[node] == cell else None

    def to_networkx(self) -> networkx.DiGraph[Any]:
        """Convert the graph to networkx; for small grids, as each node is an object.

        Nodes are (level, row, col) with ``position``, x, y, z [m]; edges have ``weight``, the cost
        of the step. Raises a MissingDependencyError without networkx.
        """
        graph: networkx.DiGraph[Any] = import_extra("networkx").DiGraph()
        names = list(zip(self.level.tolist(), self.row.tolist(), self.col.tolist(), strict=True))
        for name, place in zip(names, self.position.tolist(), strict=True):
            graph.add_node(name, position=tuple(place))
        steps = self.matrix.tocoo()
        ends = zip(steps.row.tolist(), steps.col.tolist(), steps.data.tolist(), strict=True)
        graph.add_weighted_edges_from((names[a], names[b], cost) for a, b, cost in ends)
        return graph

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an ``.npz`` that `scipy.sparse.load_npz` reads as the matrix.

        It also has ``level``, ``row``, ``col``, ``cell`` and ``position`` of the nodes.
        """
        write_bytes(self._pack(), path)

    def _pack(self) -> bytes:
        nodes = {name: getattr(self, name) for name in ("level", "row", "col", "cell", "position")}
        file = io.BytesIO()
        np.savez_compressed(
            file,
            # as `scipy.sparse.save_npz` has it
            indices=self.matrix.indices, indptr=self.matrix.indptr,
            shape=np.array(self.matrix.shape), data=self.matrix.data,
            format=np.array(b"csr"), _is_array=np.array(True), **nodes,
        )  # fmt: skip
        return file.getvalue()


def make_cell_graph(grid: NavGrid, *, cut_corners: bool = False) -> CellGraph:
    """Make the graph of a grid's free cells, as they are now.

    The steps are those of `PathFinder`: over edges and corners of cells whose floors differ by at
    most the grid's `traversableFloorHeight`, and over steps and links, with the same rules for
    corners, ramps and the margins of inflated grids. So shortest paths have the same costs.
    Raises a QueryError if a weight is negative.
    """
    search = Search(grid, cut_corners=cut_corners)
    flat = search.flat
    moves = search.graph.moves
    links = search.graph.links
    cells = np.flatnonzero(flat.free)
    # scipy's own dtype, which it doesn't copy
    index = np.int32 if len(cells) * len(WAYS) <= np.iinfo(np.int32).max else np.int64
    node: NDArray[Any] = np.full(flat.num_cells, -1, dtype=index)
    node[cells] = np.arange(len(cells))
    level, row, col = flat.split(cells)
    width = flat.layout.width[level]
    size = flat.layout.cell_size[level]
    is_step: Bool = np.stack([moves[cells] >> bit & 1 for _, _, bit in WAYS], axis=1).astype(bool)
    offset = np.stack([down * width + right for down, right, _ in WAYS], axis=1)
    factor = np.array([np.sqrt(2.0) if down and right else 1.0 for down, right, _ in WAYS])
    target = (cells[:, None] + offset)[is_step]
    cost = (size[:, None] * factor)[is_step] * flat.weight[target]
    start = np.zeros(len(cells) + 1, dtype=index)
    np.cumsum(np.count_nonzero(is_step, axis=1), out=start[1:])
    # the neighbours are in the matrix's order; links come beside them
    matrix = sparse.csr_array((cost, node[target], start), shape=(len(cells), len(cells)))
    one = np.repeat(links.cell, np.diff(links.start))
    other = links.target
    is_open = flat.free[one] & flat.free[other]
    if is_open.any():  # if a link joins neighbours, the cheaper step counts
        spent = links.length[is_open] * flat.weight[other[is_open]] + links.cost[is_open]
        steps = matrix.tocoo()
        cost = np.append(steps.data, spent)
        source = np.append(steps.row, node[one[is_open]])
        target = np.append(steps.col, node[other[is_open]])
        order = np.lexsort((cost, target, source))
        cost = cost[order]
        source = source[order]
        target = target[order]
        is_first = np.append(True, (np.diff(source) != 0) | (np.diff(target) != 0))
        steps = cost[is_first], (source[is_first], target[is_first])
        matrix = sparse.csr_array(steps, shape=matrix.shape, dtype=np.float64)
    return CellGraph(matrix, level, row, col, row * width + col, flat.positions(cells), grid)


def encode_cell_graph(grid: NavGrid, path: Path, *, cut_corners: bool = False) -> Files:
    """Encode a grid's cell graph as ``.npz``; see `make_cell_graph` and `CellGraph.save`."""
    return {path: make_cell_graph(grid, cut_corners=cut_corners)._pack()}


# ---------------------------------------------------------------- rooms


@dataclass(frozen=True)
class RoomWay:
    """A connection of two rooms."""

    rooms: tuple[str, str]  #: The ids of both, in the grid's order.
    kind: str  #: ``door``, ``open`` (no door between) or ``link`` (a step to another level).
    door: str | None  #: The door's id, None unless the kind is ``door``.
    state: str | None  #: The door's current one, None unless the kind is ``door``.
    passable: bool  #: Whether steps lead this way now; never to the outside, where the grid ends.
    #: Of a door, its length; of an opening, the straight distance from its first to its last free
    #: cell, both included; of a link, the longer extent of the cells that it starts from [m].
    width: float
    position: Vector3  #: Its middle on the floor, world x, y, z [m].
    length: float  #: From one room's centre straight to `position`, and on to the other's [m].


@dataclass(frozen=True, eq=False)
class RoomGraph:
    """Rooms and the connections between them: the topological map of a grid."""

    rooms: list[Room]  #: As the grid lists them, then those without an entry in its table.
    #: Sorted by rooms, kind and place; two rooms may have several. A door that leads out of all
    #: rooms leads to ``(outside)``.
    ways: list[RoomWay]
    level_names: list[str]  #: Of the grid's levels.

    def to_networkx(self) -> networkx.MultiGraph[Any]:
        """Convert the graph to networkx: rooms by their id, ways as edges between them.

        Nodes have ``name``, ``level``, ``level_name``, ``area`` [m²], ``x``, ``y``, ``z`` of the
        centre [m], ``outdoors``; edges have ``kind``, ``door``, ``state``, ``passable``,
        ``width``, ``x``, ``y``, ``z``, ``length`` [m]. A missing name, door or state is "". Raises
        a MissingDependencyError without networkx.
        """
        graph: networkx.MultiGraph[Any] = import_extra("networkx").MultiGraph()
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
    """An opening between two rooms: connected sides of cells, or links."""

    rooms: tuple[int, int]  # by number, ascending
    kind: str
    cells: Int  # flat ids, on both sides
    width: float
    position: Float


def make_room_graph(grid: NavGrid) -> RoomGraph:
    """Make the graph of a grid's rooms, as they are now.

    A way joins two rooms where a step does, see `PathFinder`: over the sides of neighbouring cells,
    or over links to another level. Sides that meet are one opening. One within 0.4 m of a door's
    cells, between the door's rooms, is that door. A door without steps through it (closed or
    blocked) is a way that is not passable. Cells of no room are no part of the graph.
    """
    search = Search(grid)
    room_map = map_rooms(grid)
    flat = search.flat
    rooms = room_map.rooms
    openings = dict(enumerate(_find_openings(search, room_map.number)))
    number_of: dict[str | None, int] = {room.id: k for k, room in enumerate(rooms, 1)}
    ways: list[tuple[tuple[int, int], RoomWay]] = []

    def add(
        ends: tuple[int, int], kind: str, width: float, position: Any,
        door: Door | None = None, passable: bool = True,
    ) -> None:  # fmt: skip
        x, y, z = map(rounded, position)
        one, other = (rooms[end - 1].id if end else OUTSIDE for end in ends)
        length = sum(math.dist(rooms[end - 1].centroid, (x, y, z)) for end in ends if end)
        way = RoomWay(
            rooms=(one, other), kind=kind, door=door.id if door else None,
            state=door.state if door else None, passable=passable, width=round(width, 6),
            position=(x, y, z), length=round(length, 6),
        )  # fmt: skip
        ways.append((ends, way))

    for door in grid.doors:
        joined = sorted(number_of.get(room, 0) for room in door.rooms)
        lines = [(k, find_leaf_ends(grid, door, k)) for k in door.levels]
        lines = [(k, ends) for k, ends in lines if ends is not None]
        if not lines or len(joined) != 2 or joined[0] == joined[1]:
            continue  # the file names no two rooms for the door
        level = lines[0][0]
        line = np.array(lines[0][1])
        closes = [
            k
            for k, opening in openings.items()
            if opening.kind == "open" and opening.rooms == (joined[0], joined[1])
            and int(flat.level_of(opening.cells[0])) == level
            and _distance(line, flat.positions(opening.cells)[:, :2]) <= DOOR_REACH
        ]  # fmt: skip
        for k in closes:
            del openings[k]
        middle = line.mean(axis=0)
        cell = grid.cell_at(middle, level)
        z = grid.levels[level].ground if cell is None else float(grid.position_of(cell)[2])
        width = float(np.linalg.norm(line[1] - line[0]))
        add((joined[0], joined[1]), "door", width, (*middle, z), door, bool(closes))
    for opening in openings.values():
        add(opening.rooms, opening.kind, opening.width, opening.position)
    ways.sort(key=lambda each: (each[0], each[1].kind, each[1].position))
    return RoomGraph(rooms, [way for _, way in ways], grid.level_names)


def _find_openings(search: Search, number: Any) -> Iterator[_Opening]:
    """Find the openings between two rooms: over sides of cells, level by level, and over links."""
    from navbake.runtime.grid_arrays import EAST, SOUTH  # numba loads slowly

    flat = search.flat
    moves = search.graph.moves
    # the cells at both ends, (2, n), and corners of cells there as row, col, (k, 2, n)
    found: list[tuple[str, Int, Int]] = []
    for level in range(flat.num_levels):
        own = flat.cells_of(level)
        width = int(flat.layout.width[level])
        both: list[Int] = []
        corners: list[Int] = []
        for bit, step, first in ((EAST, 1, (0, 1)), (SOUTH, width, (1, 0))):
            one = own.start + np.flatnonzero(moves[own] & bit)
            a = number[one]
            b = number[one + step]
            one = one[(a != b) & (a > 0) & (b > 0)]
            row, col = np.divmod(one - own.start, width)
            both.append(np.stack([one, one + step]))
            corners.append(np.array([[row + i, col + j] for i, j in (first, (1, 1))]))
        found.append(("open", np.concatenate(both, axis=-1), np.concatenate(corners, axis=-1)))
    ends = np.stack(flat.step_ends())
    storey, row, col = flat.split(ends)
    beside = (storey[0] == storey[1]) & (np.abs(row[0] - row[1]) + np.abs(col[0] - col[1]) == 1)
    a, b = number[ends]
    # each step is there both ways
    is_way = flat.free[ends].all(axis=0) & (a > 0) & (a < b) & ~beside
    row = (row + storey * (int(flat.layout.height.max()) + 1))[0, is_way]  # on one lattice for all
    around = [[row + i, col[0, is_way] + j] for i in (0, 1) for j in (0, 1)]
    found.append(("link", ends[:, is_way], np.array(around)))
    for kind, ends, points in found:
        pairs = np.sort(number[ends], axis=0).astype(np.int64)
        for group in _connected(pairs, points):
            rows, cols = np.ptp(points[:, :, group], axis=(0, 2)).tolist()
            size = float(flat.layout.cell_size[flat.level_of(ends[0, group[0]])])
            extent = (
                math.hypot(rows * size, cols * size) if kind == "open" else max(rows, cols) * size
            )
            middle = flat.positions(ends[:, group]).mean(axis=(0, 1))
            low, high = pairs[:, group[0]].tolist()
            yield _Opening((low, high), kind, np.unique(ends[:, group]), extent, middle)


def _connected(pairs: Int, points: Int) -> Iterator[Int]:
    """Groups of items of one pair of rooms that share corners, by union-find over both.

    `pairs` has shape (2, n), `points` (k, 2, n); yields each group's item indices, ascending.
    """
    count = pairs.shape[1]
    if not count:
        return
    keys = np.concatenate([np.broadcast_to(pairs, points.shape), points], axis=1)
    keys = keys.swapaxes(0, 1).reshape(4, -1)
    _, corner = np.unique(keys, axis=1, return_inverse=True)
    item = np.tile(np.arange(count), len(points))
    size = count + int(corner.max()) + 1
    ones = np.ones(len(item), dtype=np.int8)
    graph = sparse.coo_array((ones, (item, count + corner.ravel())), shape=(size, size))
    part = csgraph.connected_components(graph, directed=False)[1][:count]
    order = np.argsort(part, kind="stable")
    yield from np.split(order, np.flatnonzero(np.diff(part[order])) + 1)


def _distance(line: Float, points: Float) -> float:
    """From the nearest of some points to a line segment [m]."""
    start = line[0]
    along = line[1] - line[0]
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
    return float(np.linalg.norm(points - start - share[:, None] * along, axis=1).min())


def encode_graphml(grid: NavGrid, path: Path) -> Files:
    """Encode a grid's rooms as GraphML, see `RoomGraph.to_networkx`."""
    return {path: encode_networkx(make_room_graph(grid).to_networkx())}


def encode_networkx(graph: Any) -> bytes:
    """Encode a graph of networkx as GraphML; characters that XML can't hold are replaced."""
    networkx = import_extra("networkx")

    def allowed(value: Any) -> Any:
        is_text = isinstance(value, str)
        return re.sub("[\0-\x08\x0b-\x1f\ufffe\uffff]", "\ufffd", value) if is_text else value

    named = networkx.relabel_nodes(graph, {node: allowed(node) for node in graph})
    nodes = named.nodes(data=True)
    edges = named.edges(data=True)
    for entry in (named.graph, *dict(nodes).values(), *(entry for *_, entry in edges)):
        entry.update({key: allowed(value) for key, value in entry.items()})
    file = io.BytesIO()
    # this writer needs the standard library alone, so all machines write the same bytes
    networkx.write_graphml_xml(named, file)
    return file.getvalue() + b"\n"
