"""The cells of a grid as a graph: what a `PathFinder` searches, as a sparse matrix."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import MissingDependencyError
from navbake.formats.source import Files, write_files
from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int

if TYPE_CHECKING:
    import networkx

sparse = lazy("scipy.sparse")

# a cell's neighbours by their place in a row of the matrix: row and column steps, bit of its moves
# (see `navbake.runtime.kernels.arrays`)
WAYS = (
    (-1, -1, 5), (-1, 0, 1), (-1, 1, 4), (0, -1, 2), (0, 1, 0), (1, -1, 6), (1, 0, 3), (1, 1, 7),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class CellGraph:
    """The free cells of a grid as nodes, and the steps between them as edges.

    Attributes:
        matrix: ``matrix[i, j]`` is what the step from node i to node j costs: its length [m] times
            the weight of the cell of j. A scipy csr_array, shape (n, n), float64, columns
            ascending. What it doesn't store is no step; a stored 0 is a step to a cell of weight 0.
        level: of each node's cell, shape (n,), int64.
        row, col: of each node's cell on its level, shape (n,), int64.
        cell: its id on its level, ``col + row * width``, shape (n,), int64.
        position: world x, y, z of the cell's centre on its floor [m], shape (n, 3), float64.
        grid: the grid.
    """

    matrix: Any
    level: Int
    row: Int
    col: Int
    cell: Int
    position: Float
    grid: NavGrid

    def node_at(self, position: ArrayLike, level: int | None = None) -> int | None:
        """The node of the cell that a position is in; None where no cell is or none is free.

        Args:
            position: world x, y, z [m]; see `GridBase.cell_at`.
            level: which level, 0 is the lowest; then z does not count.
        """
        found = self.grid.cell_at(position, level)
        if found is None:
            return None
        first, last = np.searchsorted(self.level, [found.level, found.level + 1])
        cell = found.col + found.row * self.grid.levels[found.level].width
        node = int(first + np.searchsorted(self.cell[first:last], cell))
        return node if node < last and self.cell[node] == cell else None

    def to_networkx(self) -> networkx.DiGraph[Any]:
        """The graph for networkx, for grids that are not too large: an object for each node.

        Nodes are (level, row, col) with ``position``, x, y, z [m]; edges have ``weight``, the cost
        of the step.

        Raises:
            MissingDependencyError: networkx is not installed.
        """
        graph: networkx.DiGraph[Any] = import_networkx().DiGraph()
        names = list(zip(self.level.tolist(), self.row.tolist(), self.col.tolist(), strict=True))
        for name, place in zip(names, self.position.tolist(), strict=True):
            graph.add_node(name, position=tuple(place))
        steps = self.matrix.tocoo()
        ends = zip(steps.row.tolist(), steps.col.tolist(), steps.data.tolist(), strict=True)
        graph.add_weighted_edges_from((names[a], names[b], cost) for a, b, cost in ends)
        return graph

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an ``.npz`` that `scipy.sparse.load_npz` reads as the matrix.

        Beside it the file has ``level``, ``row``, ``col``, ``cell`` and ``position`` of the nodes.
        """
        write_files({Path(path): pack_graph(self)})


def make_cell_graph(grid: NavGrid, *, cut_corners: bool = False) -> CellGraph:
    """Make the graph of a grid's free cells, as they are now.

    Its steps are those of `PathFinder`: over edges and corners of cells whose floors differ by at
    most the grid's `traversableFloorHeight`, and over links, by the same rules for corners, ramps
    and the margins of inflated grids. So the shortest paths have the costs of its paths.

    Args:
        grid: a grid of one or several levels.
        cut_corners: let diagonal steps pass blocked corners.

    Raises:
        QueryError: a weight is negative.
    """
    search = Search(grid, cut_corners=cut_corners)
    flat, moves, weight = search.flat, search.graph.moves, search.flat.weight
    cells = np.flatnonzero(flat.free)
    # as scipy has its indices, which then takes them as they are
    index = np.int32 if len(cells) * len(WAYS) <= np.iinfo(np.int32).max else np.int64
    node: NDArray[Any] = np.full(flat.num_cells, -1, dtype=index)
    node[cells] = np.arange(len(cells))
    level, row, col = flat.split(cells)
    width, size = flat.layout.width[level], flat.layout.cell_size[level]
    is_step: Bool = np.stack([moves[cells] >> bit & 1 for _, _, bit in WAYS], axis=1).astype(bool)
    offset = np.stack([down * width + right for down, right, _ in WAYS], axis=1)
    factor = np.array([np.sqrt(2.0) if down and right else 1.0 for down, right, _ in WAYS])
    target = (cells[:, None] + offset)[is_step]
    cost = (size[:, None] * factor)[is_step] * weight[target]
    start = np.zeros(len(cells) + 1, dtype=index)
    np.cumsum(np.count_nonzero(is_step, axis=1), out=start[1:])
    # the neighbours are in the matrix's order; links come beside them
    matrix = sparse.csr_array((cost, node[target], start), shape=(len(cells), len(cells)))
    links = _link_steps(search, node)
    if links is not None:
        matrix = _joined(matrix, links)
    return CellGraph(matrix, level, row, col, row * width + col, flat.positions(cells), grid)


def _link_steps(search: Search, node: NDArray[Any]) -> tuple[Float, Int, Int] | None:
    """What the steps over links cost, and from where to where they lead; None without links."""
    flat = search.flat
    one, other = flat.link_ends()
    is_open = flat.free[one] & flat.free[other]
    if not is_open.any():
        return None
    one, other = one[is_open], other[is_open]
    return flat.links.length[is_open] * flat.weight[other], node[one], node[other]


def _joined(matrix: Any, links: tuple[Float, Int, Int]) -> Any:
    """A matrix of steps and links; of a step that is both, the cheaper counts."""
    steps = matrix.tocoo()
    cost, source, target = (
        np.concatenate(pair) for pair in zip((steps.data, steps.row, steps.col), links, strict=True)
    )
    order = np.lexsort((cost, target, source))
    cost, source, target = cost[order], source[order], target[order]
    is_first = np.append(True, (np.diff(source) != 0) | (np.diff(target) != 0))
    cost, source, target = cost[is_first], source[is_first], target[is_first]
    return sparse.csr_array((cost, (source, target)), shape=matrix.shape, dtype=np.float64)


def pack_graph(graph: CellGraph) -> bytes:
    """The content of an ``.npz`` of a graph; see `CellGraph.save`."""
    matrix, file = graph.matrix, io.BytesIO()
    nodes = {name: getattr(graph, name) for name in ("level", "row", "col", "cell", "position")}
    np.savez_compressed(
        file,
        # as `scipy.sparse.save_npz` has it
        indices=matrix.indices, indptr=matrix.indptr, shape=np.array(matrix.shape),
        data=matrix.data, format=np.array(b"csr"), _is_array=np.array(True), **nodes,
    )  # fmt: skip
    return file.getvalue()


def encode_cell_graph(grid: NavGrid, path: Path, *, cut_corners: bool = False) -> Files:
    """Make an ``.npz`` of a grid's cell graph; see `make_cell_graph` and `CellGraph.save`."""
    return {path: pack_graph(make_cell_graph(grid, cut_corners=cut_corners))}


def import_networkx() -> Any:
    """Load networkx, or say how to install it."""
    try:
        import networkx  # of the extra [convert]
    except ImportError as error:
        message = 'graphs for networkx, and GraphML, need networkx: pip install "navbake[convert]"'
        raise MissingDependencyError(message) from error
    return networkx
