"""Graphs of a grid: its cells as a `PathFinder` searches them, and its rooms."""

from __future__ import annotations

import io
import math
import os
import re
from collections.abc import Iterable, Iterator
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
from navbake.navgrid.rooms import MAX_DOOR_DISTANCE, Door, Room
from navbake.runtime.flat_grid import map_rooms
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int, Int32, Vector3

if TYPE_CHECKING:
    import networkx
    import scipy.sparse

sparse = lazy("scipy.sparse")
csgraph = lazy("scipy.sparse.csgraph")

OUTSIDE = "(outside)"  # the node that doors without a second room lead to


class _Neighbor(NamedTuple):
    """One of the eight cells around a cell."""

    down: int  # how many rows further down
    right: int  # how many columns further right
    move_bit: int  # the bit of this move in a cell's moves, see `navbake.runtime.grid_arrays`


# in the order that their columns have in a row of the matrix
NEIGHBORS = (
    _Neighbor(-1, -1, 5),
    _Neighbor(-1, 0, 1),
    _Neighbor(-1, 1, 4),
    _Neighbor(0, -1, 2),
    _Neighbor(0, 1, 0),
    _Neighbor(1, -1, 6),
    _Neighbor(1, 0, 3),
    _Neighbor(1, 1, 7),
)


def make_graph(
    grid: NavGrid, kind: str = "cells", *, cut_corners: bool = False
) -> CellGraph | RoomGraph:
    """Make the graph of a grid's cells or rooms, as they are now.

    Args:
        grid: the grid.
        kind: ``cells``, see `make_cell_graph`, or ``rooms``, see `make_room_graph`.
        cut_corners: allow diagonal steps past blocked corners, in a graph of cells.

    Returns:
        The graph.

    Raises:
        QueryError: the kind is unknown, or a weight of the grid is negative.
    """
    if kind == "cells":
        return make_cell_graph(grid, cut_corners=cut_corners)
    if kind == "rooms":
        return make_room_graph(grid)
    raise QueryError(
        f"expected cells or rooms as kind of graph, got {kind!r}",
        key="kind",
        value=kind,
        expected="cells or rooms",
    )


# ---------------------------------------------------------------- cells


@dataclass(frozen=True, eq=False)
class CellGraph:
    """The free cells of a grid as nodes, and the steps between them as edges.

    Attributes:
        matrix: ``matrix[i, j]`` is the cost of the step from node i to node j: its length [m]
            times the weight of the cell of j; over a link, plus the link's cost. A scipy csr_array,
            shape (n, n), float64, columns ascending. A missing entry means that there is no step; a
            stored 0 is a step to a cell of weight 0.
        level: the level of each node's cell, shape (n,), int64.
        row: the row of each node's cell on its level, shape (n,), int64.
        col: the column of each node's cell, shape (n,), int64.
        cell: the id of each node's cell on its level, ``col + row * width``, shape (n,), int64.
        position: world x, y, z of each cell's centre on its floor [m], shape (n, 3), float64.
        grid: the grid that the graph was made of.
    """

    matrix: scipy.sparse.csr_array
    level: Int
    row: Int
    col: Int
    cell: Int
    position: Float
    grid: NavGrid

    def node_at(self, position: ArrayLike, level: int | None = None) -> int | None:
        """Find the node of the cell at a position, see `grid.cell_at`.

        Args:
            position: world x, y and perhaps z [m].
            level: the number of the level; None to find it by z.

        Returns:
            The index of the node; None if there is no free cell.
        """
        cell = self.grid.cell_at(position, level)
        if cell is None:
            return None
        first_node, stop_node = np.searchsorted(self.level, [cell.level, cell.level + 1])
        cell_id = cell.col + cell.row * self.grid.levels[cell.level].width
        node = int(first_node + np.searchsorted(self.cell[first_node:stop_node], cell_id))
        return node if node < stop_node and self.cell[node] == cell_id else None

    def to_networkx(self) -> networkx.DiGraph[Any]:
        """Convert the graph to networkx; only for small grids, as each node is a Python object.

        Nodes are (level, row, col) with ``position``, x, y, z [m]; edges have ``weight``, the cost
        of the step. Raises a MissingDependencyError without networkx.
        """
        graph: networkx.DiGraph[Any] = import_extra("networkx").DiGraph()
        node_names = list(
            zip(self.level.tolist(), self.row.tolist(), self.col.tolist(), strict=True)
        )
        for node_name, position in zip(node_names, self.position.tolist(), strict=True):
            graph.add_node(node_name, position=tuple(position))
        matrix = self.matrix.tocoo()
        steps = zip(matrix.row.tolist(), matrix.col.tolist(), matrix.data.tolist(), strict=True)
        graph.add_weighted_edges_from(
            (node_names[source], node_names[target], cost) for source, target, cost in steps
        )
        return graph

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an ``.npz`` that `scipy.sparse.load_npz` reads as the matrix.

        The file also has ``level``, ``row``, ``col``, ``cell`` and ``position`` of the nodes.

        Raises:
            FormatError: the file can't be written.
        """
        write_bytes(self._pack(), path)

    def _pack(self) -> bytes:
        file = io.BytesIO()
        np.savez_compressed(
            file,
            # the matrix as `scipy.sparse.save_npz` writes it
            indices=self.matrix.indices,
            indptr=self.matrix.indptr,
            shape=np.array(self.matrix.shape),
            data=self.matrix.data,
            format=np.array(b"csr"),
            _is_array=np.array(True),
            # the nodes
            level=self.level,
            row=self.row,
            col=self.col,
            cell=self.cell,
            position=self.position,
        )
        return file.getvalue()


def make_cell_graph(grid: NavGrid, *, cut_corners: bool = False) -> CellGraph:
    """Make the graph of a grid's free cells, as they are now.

    The edges are the steps of `PathFinder`: over edges and corners of cells whose floors differ by
    at most the grid's `traversableFloorHeight`, and over the grid's steps and links. The rules for
    corners, ramps and inflated grids are the same, too. So shortest paths have the same costs.

    Args:
        grid: the grid.
        cut_corners: allow diagonal steps past blocked corners.

    Returns:
        The graph.

    Raises:
        QueryError: a weight is negative.
    """
    search = Search(grid, cut_corners=cut_corners)
    flat_grid = search.flat
    moves = search.graph.moves
    links = search.graph.links
    cells = np.flatnonzero(flat_grid.free)
    # the dtype that scipy would choose, so that it copies nothing
    fits_int32 = len(cells) * len(NEIGHBORS) <= np.iinfo(np.int32).max
    index_dtype = np.int32 if fits_int32 else np.int64
    node_of_cell: NDArray[Any] = np.full(flat_grid.num_cells, -1, dtype=index_dtype)  # of each cell
    node_of_cell[cells] = np.arange(len(cells))
    level, row, col = flat_grid.to_cells(cells)
    width = flat_grid.layout.width[level]
    cell_sizes = flat_grid.layout.cell_size[level]
    # of each cell and neighbour, shape (n, 8)
    is_step: Bool = np.stack(
        [moves[cells] >> neighbor.move_bit & 1 for neighbor in NEIGHBORS], axis=1
    ).astype(bool)
    id_offsets = np.stack(
        [neighbor.down * width + neighbor.right for neighbor in NEIGHBORS], axis=1
    )
    length_factors = np.array(
        [np.sqrt(2.0) if neighbor.down and neighbor.right else 1.0 for neighbor in NEIGHBORS]
    )
    target_cell = (cells[:, None] + id_offsets)[is_step]
    costs = (cell_sizes[:, None] * length_factors)[is_step] * flat_grid.weight[target_cell]
    row_starts = np.zeros(len(cells) + 1, dtype=index_dtype)
    np.cumsum(np.count_nonzero(is_step, axis=1), out=row_starts[1:])
    # neighbours are in the matrix's order already
    shape = (len(cells), len(cells))
    matrix = sparse.csr_array((costs, node_of_cell[target_cell], row_starts), shape=shape)

    link_source_cell = np.repeat(links.cell, np.diff(links.start))
    link_target_cell = links.target
    is_open = flat_grid.free[link_source_cell] & flat_grid.free[link_target_cell]
    if is_open.any():  # if a link joins neighbours, the cheaper step counts
        link_weight = flat_grid.weight[link_target_cell[is_open]]
        link_cost = links.length[is_open] * link_weight + links.cost[is_open]
        steps = matrix.tocoo()
        costs = np.append(steps.data, link_cost)
        sources = np.append(steps.row, node_of_cell[link_source_cell[is_open]])
        targets = np.append(steps.col, node_of_cell[link_target_cell[is_open]])
        sort_indices = np.lexsort((costs, targets, sources))
        costs = costs[sort_indices]
        sources = sources[sort_indices]
        targets = targets[sort_indices]
        is_cheapest = np.append(True, (np.diff(sources) != 0) | (np.diff(targets) != 0))
        entries = (costs[is_cheapest], (sources[is_cheapest], targets[is_cheapest]))
        matrix = sparse.csr_array(entries, shape=shape, dtype=np.float64)
    return CellGraph(
        matrix=matrix,
        level=level,
        row=row,
        col=col,
        cell=row * width + col,
        position=flat_grid.positions(cells),
        grid=grid,
    )


def encode_cell_graph(grid: NavGrid, path: Path, *, cut_corners: bool = False) -> Files:
    """Encode a grid's cell graph as ``.npz``, see `CellGraph.save`.

    Args:
        grid: the grid.
        path: the path of the file.
        cut_corners: allow diagonal steps past blocked corners.

    Returns:
        The file's content by its path.

    Raises:
        QueryError: a weight is negative.
    """
    return {path: make_cell_graph(grid, cut_corners=cut_corners)._pack()}


# ---------------------------------------------------------------- rooms


@dataclass(frozen=True)
class RoomWay:
    """A connection between two rooms.

    Attributes:
        rooms: the ids of both rooms, in the grid's order.
        kind: ``door``, ``open`` (an opening without a door) or ``link`` (a step to another level,
            or a named link).
        door: the door's id, None unless the kind is ``door``.
        state: the door's current state, None unless the kind is ``door``.
        passable: whether steps lead through the connection now; always False for a connection to
            the outside, where the grid ends.
        width: the width [m]: for a door, from jamb to jamb; for an opening, from its first to its
            last free cell, both included; for a link, the longer side of the rectangle round the
            cells that it starts from.
        position: the middle of the connection on the floor, world x, y, z [m].
        length: the distance from the first room's centre straight to `position`, and on to the
            second room's centre [m].
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
    """Rooms and the connections between them: the topological map of a grid.

    Attributes:
        rooms: the rooms in the grid's table of rooms, in its order, then the rooms that are not in
            the table.
        ways: the connections, sorted by rooms, kind and position; two rooms may have several. A
            door with a room on only one side leads to ``(outside)``.
        level_names: the names of the grid's levels.
    """

    rooms: list[Room]
    ways: list[RoomWay]
    level_names: list[str]

    def to_networkx(self) -> networkx.MultiGraph[Any]:
        """Convert the graph to networkx: rooms by their id, connections as edges between them.

        Nodes have ``name``, ``level``, ``level_name``, ``area`` [m²], ``x``, ``y``, ``z`` of the
        centre [m], ``outdoors``; edges have ``kind``, ``door``, ``state``, ``passable``,
        ``width``, ``x``, ``y``, ``z``, ``length`` [m]. A missing name, door or state is "". Raises
        a MissingDependencyError without networkx.
        """
        graph: networkx.MultiGraph[Any] = import_extra("networkx").MultiGraph()
        for room in self.rooms:
            x, y, z = room.centroid
            graph.add_node(
                room.id,
                name=room.name or "",
                level=room.level,
                level_name=self.level_names[room.level],
                area=float(room.area),
                x=float(x),
                y=float(y),
                z=float(z),
                outdoors=room.outdoors,
            )
        if any(OUTSIDE in connection.rooms for connection in self.ways):
            graph.add_node(OUTSIDE, name="", outdoors=True)
        for connection in self.ways:
            first_room, second_room = connection.rooms
            x, y, z = connection.position
            graph.add_edge(
                first_room,
                second_room,
                kind=connection.kind,
                door=connection.door or "",
                state=connection.state or "",
                passable=connection.passable,
                width=connection.width,
                x=x,
                y=y,
                z=z,
                length=connection.length,
            )
        return graph


class _Opening(NamedTuple):
    """An opening between two rooms: connected sides of cells, or links."""

    rooms: tuple[int, int]  # the rooms' numbers from 1, ascending
    kind: str  # ``open`` or ``link``, see `RoomWay`
    cells: Int  # flat ids of the cells on both sides
    width: float  # [m]
    position: Float  # middle, world x, y, z [m]


def make_room_graph(grid: NavGrid) -> RoomGraph:
    """Make the graph of a grid's rooms, as they are now.

    Two rooms are connected if a step leads from one to the other, see `PathFinder`: over the common
    side of neighbouring cells, or over a link. Sides that share corners are one opening. An opening
    that is within 0.4 m of a door's leaf and joins the door's rooms belongs to that door. A door
    that no step leads through (because it is closed or blocked) is a connection that is not
    passable. Cells outside of all rooms are not in the graph.

    Args:
        grid: the grid.

    Returns:
        The graph.

    Raises:
        QueryError: a weight of the grid is negative.
    """
    search = Search(grid)
    room_map = map_rooms(grid)
    flat_grid = search.flat
    rooms = room_map.rooms
    openings = dict(enumerate(_find_openings(search, room_map.number)))
    # id of a room -> its number, from 1; 0 stands for the outside
    number_of_room: dict[str | None, int] = {
        room.id: room_number for room_number, room in enumerate(rooms, 1)
    }
    connections: list[tuple[tuple[int, int], RoomWay]] = []  # (numbers of the rooms, connection)

    def add_connection(
        room_numbers: tuple[int, int],
        kind: str,
        width: float,
        position: Iterable[float],
        door: Door | None = None,
        passable: bool = True,
    ) -> None:
        x, y, z = map(rounded, position)
        room_ids = [rooms[number - 1].id if number else OUTSIDE for number in room_numbers]
        length = sum(
            math.dist(rooms[number - 1].centroid, (x, y, z)) for number in room_numbers if number
        )
        connection = RoomWay(
            rooms=(room_ids[0], room_ids[1]),
            kind=kind,
            door=door.id if door else None,
            state=door.state if door else None,
            passable=passable,
            width=round(width, 6),
            position=(x, y, z),
            length=round(length, 6),
        )
        connections.append((room_numbers, connection))

    for door in grid.doors:
        door_rooms = sorted(number_of_room.get(room, 0) for room in door.rooms)
        if len(door_rooms) != 2 or door_rooms[0] == door_rooms[1]:
            continue  # the door joins no two rooms
        joined_rooms = (door_rooms[0], door_rooms[1])
        levels_and_ends = [(level, find_leaf_ends(grid, door, level)) for level in door.levels]
        levels_with_line = [(level, ends) for level, ends in levels_and_ends if ends is not None]
        if not levels_with_line:
            continue  # on no level the door has a line
        level, line_ends = levels_with_line[0]
        leaf_ends = np.array(line_ends)
        # the openings that the door closes
        opening_numbers = [
            number
            for number, opening in openings.items()
            if opening.kind == "open"
            and opening.rooms == joined_rooms
            and int(flat_grid.level_of(opening.cells[0])) == level
            and _find_distance(leaf_ends, flat_grid.positions(opening.cells)[:, :2])
            <= MAX_DOOR_DISTANCE
        ]
        for number in opening_numbers:
            del openings[number]
        x, y = leaf_ends.mean(axis=0)
        cell = grid.cell_at((x, y), level)
        z = grid.levels[level].ground if cell is None else float(grid.position_of(cell)[2])
        add_connection(
            joined_rooms,
            kind="door",
            width=float(np.linalg.norm(leaf_ends[1] - leaf_ends[0])),
            position=(x, y, z),
            door=door,
            passable=bool(opening_numbers),
        )
    for opening in openings.values():
        add_connection(opening.rooms, opening.kind, opening.width, opening.position)
    connections.sort(key=lambda entry: (entry[0], entry[1].kind, entry[1].position))
    return RoomGraph(rooms, [connection for _, connection in connections], grid.level_names)


class _RoomSteps(NamedTuple):
    """Steps from one room to another: over common sides of cells of a level, or over links."""

    kind: str  # ``open`` or ``link``
    ends: Int  # flat ids of the cells at both ends of each step, shape (2, n)
    # for each step, row and column of k corners: both ends of the common side, or all corners of
    # the cell from which a link starts; shape (k, 2, n)
    corners: Int


def _find_openings(search: Search, room_of_cell: Int32) -> Iterator[_Opening]:
    """Yield the openings between two rooms: over sides of cells, level by level, then over links.

    Args:
        search: the search on the grid.
        room_of_cell: by flat id, the number of each cell's room; 0 for none.
    """
    from navbake.runtime.grid_arrays import EAST, SOUTH  # numba loads slowly

    flat_grid = search.flat
    moves = search.graph.moves
    step_groups: list[_RoomSteps] = []  # those of each level, then those between levels
    for level in range(flat_grid.num_levels):
        level_cells = flat_grid.cells_of(level)
        first_cell = level_cells.start
        width = int(flat_grid.layout.width[level])
        ends: list[Int] = []
        corners: list[Int] = []
        # a cell's east side runs from its upper right corner down to the lower right one, its south
        # side from the lower left corner to the lower right one
        for move_bit, id_offset, first_corner in ((EAST, 1, (0, 1)), (SOUTH, width, (1, 0))):
            cells = first_cell + np.flatnonzero(moves[level_cells] & move_bit)
            room = room_of_cell[cells]
            next_room = room_of_cell[cells + id_offset]
            cells = cells[(room != next_room) & (room > 0) & (next_room > 0)]
            row, col = np.divmod(cells - first_cell, width)
            ends.append(np.stack([cells, cells + id_offset]))
            down, right = first_corner
            corners.append(np.array([[row + down, col + right], [row + 1, col + 1]]))
        step_groups.append(
            _RoomSteps("open", np.concatenate(ends, axis=-1), np.concatenate(corners, axis=-1))
        )

    link_ends = np.stack(flat_grid.step_ends())
    level_of_end, row, col = flat_grid.to_cells(link_ends)
    is_neighbor = level_of_end[0] == level_of_end[1]
    is_neighbor &= np.abs(row[0] - row[1]) + np.abs(col[0] - col[1]) == 1
    source_room, target_room = room_of_cell[link_ends]
    # each step exists in both directions, of which one is enough
    joins_rooms = flat_grid.free[link_ends].all(axis=0) & ~is_neighbor
    joins_rooms &= (source_room > 0) & (source_room < target_room)
    # stack the rows of all levels, so that corners of different levels differ
    row_stride = int(flat_grid.layout.height.max()) + 1
    stacked_row = (row + level_of_end * row_stride)[0, joins_rooms]
    source_col = col[0, joins_rooms]
    link_corners = np.array(
        [
            [stacked_row + down, source_col + right]
            for down, right in ((0, 0), (0, 1), (1, 0), (1, 1))
        ]
    )
    step_groups.append(_RoomSteps("link", link_ends[:, joins_rooms], link_corners))

    for steps in step_groups:
        room_pairs = np.sort(room_of_cell[steps.ends], axis=0).astype(np.int64)
        for step_indices in _group_connected(room_pairs, steps.corners):
            corner_extents = np.ptp(steps.corners[:, :, step_indices], axis=(0, 2))
            num_rows, num_cols = corner_extents.tolist()
            group_level = flat_grid.level_of(steps.ends[0, step_indices[0]])
            cell_size = float(flat_grid.layout.cell_size[group_level])
            if steps.kind == "open":
                opening_width = math.hypot(num_rows * cell_size, num_cols * cell_size)
            else:
                opening_width = max(num_rows, num_cols) * cell_size
            group_ends = steps.ends[:, step_indices]
            lower_room, higher_room = room_pairs[:, step_indices[0]].tolist()
            yield _Opening(
                rooms=(lower_room, higher_room),
                kind=steps.kind,
                cells=np.unique(group_ends),
                width=opening_width,
                position=flat_grid.positions(group_ends).mean(axis=(0, 1)),
            )


def _group_connected(room_pairs: Int, corners: Int) -> Iterator[Int]:
    """Group steps that join the same two rooms and share corners, directly or through others.

    Steps and corners are the nodes of a graph, whose components are the groups.

    Args:
        room_pairs: the numbers of the two rooms of each step, shape (2, n).
        corners: row and column of k corners of each step, shape (k, 2, n), see `_RoomSteps`.

    Yields:
        The indices of the steps of each group, ascending.
    """
    num_steps = room_pairs.shape[1]
    if not num_steps:
        return
    # a corner together with two rooms, so that steps of different rooms share no corner
    corner_keys = np.concatenate([np.broadcast_to(room_pairs, corners.shape), corners], axis=1)
    corner_keys = corner_keys.swapaxes(0, 1).reshape(4, -1)
    _, corner_number = np.unique(corner_keys, axis=1, return_inverse=True)
    corner_node = num_steps + corner_number.ravel()
    step_node = np.tile(np.arange(num_steps), len(corners))
    num_nodes = num_steps + int(corner_number.max()) + 1
    is_edge = np.ones(len(step_node), dtype=np.int8)
    graph = sparse.coo_array((is_edge, (step_node, corner_node)), shape=(num_nodes, num_nodes))
    _, labels = csgraph.connected_components(graph, directed=False)
    component_of_step = labels[:num_steps]
    sort_indices = np.argsort(component_of_step, kind="stable")
    yield from np.split(sort_indices, np.flatnonzero(np.diff(component_of_step[sort_indices])) + 1)


def _find_distance(segment: Float, positions: Float) -> float:
    """Return the distance from the nearest of some points to a line segment [m]."""
    start = segment[0]
    extent = segment[1] - segment[0]
    fractions = np.clip(
        (positions - start) @ extent / max(float(extent @ extent), 1e-300), 0.0, 1.0
    )
    return float(np.linalg.norm(positions - start - fractions[:, None] * extent, axis=1).min())


def encode_graphml(grid: NavGrid, path: Path) -> Files:
    """Encode a grid's rooms as GraphML, see `RoomGraph.to_networkx`.

    Two rooms may have several connections; each is an edge with an id of its own. If no two rooms
    have several, networkx reads a simple graph, unless it is called with ``force_multigraph``.

    Args:
        grid: the grid.
        path: the path of the file.

    Returns:
        The file's content by its path.

    Raises:
        MissingDependencyError: networkx is not installed.
    """
    return {path: encode_networkx(_number_edges(make_room_graph(grid).to_networkx()))}


def encode_gml(grid: NavGrid, path: Path) -> Files:
    """Encode a grid's rooms as GML, with the same attributes as `encode_graphml`.

    Args:
        grid: the grid.
        path: the path of the file.

    Returns:
        The file's content by its path.

    Raises:
        MissingDependencyError: networkx is not installed.
    """
    room_graph = _number_edges(make_room_graph(grid).to_networkx())
    return {path: encode_networkx(room_graph, as_gml=True)}


def _number_edges(graph: networkx.MultiGraph[Any]) -> networkx.MultiGraph[Any]:
    """Return a copy whose edges have different keys; networkx counts anew for each two nodes.

    In files, the keys of edges are their ids.
    """
    numbered_graph = graph.__class__()
    numbered_graph.add_nodes_from(graph.nodes(data=True))
    for number, (first_node, second_node, attributes) in enumerate(graph.edges(data=True)):
        numbered_graph.add_edge(first_node, second_node, key=number, **attributes)
    return numbered_graph


def encode_networkx(graph: networkx.Graph[Any], *, as_gml: bool = False) -> bytes:
    """Encode a graph of networkx as GraphML or GML; characters that XML can't hold are replaced.

    Args:
        graph: the graph.
        as_gml: whether to write GML instead.
    """
    networkx_module = import_extra("networkx")

    def replace_characters(value: object) -> object:
        if isinstance(value, str):
            return re.sub("[\0-\x08\x0b-\x1f\ufffe\uffff]", "\ufffd", value)
        return value

    clean_node_names = {node: replace_characters(node) for node in graph}
    clean_graph = networkx_module.relabel_nodes(graph, clean_node_names)
    node_attributes = [attributes for _, attributes in clean_graph.nodes(data=True)]
    edge_attributes = [attributes for _, _, attributes in clean_graph.edges(data=True)]
    for attributes in (clean_graph.graph, *node_attributes, *edge_attributes):
        clean_attributes = {key: replace_characters(value) for key, value in attributes.items()}
        attributes.update(clean_attributes)
    file = io.BytesIO()
    if as_gml:
        networkx_module.write_gml(clean_graph, file)
        return file.getvalue()
    # this writer needs the standard library alone, so all machines write the same bytes
    networkx_module.write_graphml_xml(clean_graph, file)
    return file.getvalue() + b"\n"
