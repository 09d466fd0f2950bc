"""Provide columns and shapes, also of lattices that are too large to keep in memory.

A column is the vertical line through a cell's centre, with all places where it crosses a geom.
Columns of large lattices are cast chunk by chunk of rows, and cast again on each request.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navbake.baker.columns.columns import (
    Columns,
    ColumnsBuilder,
    ColumnSource,
    RowChunk,
    ShapeSource,
    TiledShapes,
    cast_columns,
    cast_points,
    list_by_tile,
    select_columns,
    split_into_row_chunks,
    tile_of,
    tile_shapes,
)
from navbake.baker.columns.rough_ground import foot_radius, replace_rough_ground_normals
from navbake.baker.columns.seams import close_cracks, resolve_seams
from navbake.baker.core.arrays import ColumnHits
from navbake.baker.core.clock import StageClock
from navbake.baker.core.tiles import TILE
from navbake.baker.core.windows import Window
from navbake.baker.geometry.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.processes import give_back_memory
from navbake.threads import run_beside
from navbake.types import Bool, Int, Int32

# Columns of lattices with at most this many cells stay in memory: they take about 100 bytes a cell
MAX_CELLS_IN_MEMORY = 1 << 22
# How many chunks of rows are in memory at a time: the one that the caller works on, and the next
CHUNKS_IN_MEMORY = 2
# Up to this many triangles are expanded once and stay in memory: about 60 bytes each
MAX_TRIANGLES_EXPANDED_AT_ONCE = 1 << 20
# More triangles than this are expanded chunk by chunk also where columns stay in memory
MAX_TRIANGLES_BESIDE_COLUMNS = 1 << 23
# About so many triangles of a chunk are expanded at a time
TRIANGLES_PER_CHUNK = 1 << 19
# More triangles are expanded chunk by chunk, again and again. If that would expand each triangle
# more than this many times on average, all are expanded once and stay in memory nevertheless
MAX_EXPANSIONS_PER_TRIANGLE = 2.0


class ChunkedShapes:
    """Lists the shapes near requested cells, for scenes with too many triangles to keep in memory.

    It implements `ShapeSource`. Triangles of meshes are computed anew on each request, and only
    those near the requested cells. Solids and planes are few, and are kept.

    Attributes:
        lattice: the cells.
    """

    is_chunked = True

    def __init__(self, shapes: Shapes, lattice: Lattice, margin: float) -> None:
        """List the solids by tile; triangles are listed later, on request.

        Args:
            shapes: the shapes.
            lattice: the cells.
            margin: shapes within this distance of a tile count as over it [m].
        """
        self.lattice = lattice
        self._shapes = shapes
        self._margin = margin
        empty_meshes = shapes.meshes.only(np.zeros(len(shapes.meshes.geom), dtype=np.bool_))
        self._solids = tile_shapes(shapes, lattice, margin, empty_meshes.expand())

    def row_chunks(self, num_in_memory: int = 1) -> list[RowChunk]:
        """Split the lattice into chunks of rows, so that the shapes near a chunk fit into memory.

        Args:
            num_in_memory: how many chunks will be in memory at a time.
        """
        return split_by_triangles(
            int(self._shapes.meshes.num_triangles.sum()), self.lattice, num_in_memory
        )

    def shapes_near_rows(self, rows: RowChunk) -> TiledShapes:
        """Return all shapes near some rows of cells, and maybe others; implements `ShapeSource`."""
        y_max = self.lattice.y_max
        cell_size = self.lattice.cell_size
        boxes = self._shapes.meshes.boxes
        margin = self._margin + foot_radius(self.lattice)
        is_near = boxes[:, 4] >= y_max - rows.end * cell_size - margin
        is_near &= boxes[:, 1] <= y_max - rows.first * cell_size + margin
        return self._expand(is_near)

    def shapes_near_cells(self, cells: Int) -> TiledShapes:
        """Return all shapes near some cells (ids), and maybe others; implements `ShapeSource`."""
        boxes = self._shapes.meshes.boxes
        margin = self._margin + foot_radius(self.lattice)
        tile_start, mesh_indices_by_tile = list_by_tile(boxes, margin, self.lattice)
        holds_cell = np.zeros(len(tile_start) - 1, dtype=np.bool_)
        holds_cell[tile_of(self.lattice, cells)] = True
        is_near = np.zeros(len(boxes), dtype=np.bool_)
        is_near[mesh_indices_by_tile[np.repeat(holds_cell, np.diff(tile_start))]] = True
        return self._expand(is_near)

    def _expand(self, is_near: Bool) -> TiledShapes:
        """List the triangles of some meshes, and all solids, by tile.

        Args:
            is_near: marks the meshes whose triangles are listed, shape (meshes,).
        """
        facets = self._shapes.meshes.only(is_near).expand()
        tile_start, facet_indices_by_tile = list_by_tile(facets, self._margin, self.lattice)
        tile_index = self._solids.tile_index._replace(
            triangle_start=tile_start, triangle_indices=facet_indices_by_tile
        )
        return TiledShapes(self._shapes, self.lattice, facets, tile_index)


def make_shape_source(shapes: Shapes, lattice: Lattice, margin: float) -> ShapeSource:
    """Make an object that lists the shapes near given rows or cells of a lattice.

    Args:
        shapes: the shapes.
        lattice: the cells.
        margin: shapes within this distance of a tile of cells are listed for it [m].

    Returns:
        A `ChunkedShapes` if the scene has too many triangles to keep all in memory, else a
        `TiledShapes`.
    """
    if expands_on_request(shapes, lattice, margin):
        return ChunkedShapes(shapes, lattice, margin)
    return tile_shapes(shapes, lattice, margin)


def expands_on_request(shapes: Shapes, lattice: Lattice, margin: float) -> bool:
    """Return whether triangles are computed for each chunk of rows, or kept in memory all at once.

    They are computed chunk by chunk if there are more than a limit, which is higher for a lattice
    that is small enough for its columns to stay in memory. If meshes are so large that most
    triangles would be computed for several chunks, all are kept nevertheless.

    Args:
        shapes: the shapes.
        lattice: the cells.
        margin: shapes within this distance of a tile of cells are listed for it [m].

    Returns:
        True if they are computed chunk by chunk.
    """
    num_triangles = shapes.meshes.num_triangles
    boxes = shapes.meshes.boxes
    keeps_columns = lattice.width * lattice.height <= MAX_CELLS_IN_MEMORY
    max_triangles = (
        MAX_TRIANGLES_BESIDE_COLUMNS if keeps_columns else MAX_TRIANGLES_EXPANDED_AT_ONCE
    )
    if num_triangles.sum() <= max_triangles:
        return False
    chunks = split_by_triangles(int(num_triangles.sum()), lattice, CHUNKS_IN_MEMORY)
    chunk_length = chunks[0].end * lattice.cell_size
    mesh_lengths = boxes[:, 4] - boxes[:, 1] + 2 * margin
    num_expanded_triangles = num_triangles * (
        1.0 + mesh_lengths / chunk_length
    )  # for all chunks together
    return bool(num_expanded_triangles.sum() <= MAX_EXPANSIONS_PER_TRIANGLE * num_triangles.sum())


def split_by_triangles(num_triangles: int, lattice: Lattice, num_in_memory: int) -> list[RowChunk]:
    """Split a lattice into chunks of rows, each with few enough cells and triangles for memory.

    Args:
        num_triangles: how many triangles lie over the whole lattice. They are assumed to be spread
            evenly over it.
        lattice: the cells.
        num_in_memory: how many chunks will be in memory at a time.
    """
    max_rows = TRIANGLES_PER_CHUNK * lattice.height / max(num_triangles, 1)
    return split_into_row_chunks(lattice, num_in_memory, max_rows)


def split_cells(shapes: ShapeSource, cells: Int) -> Iterator[Int | slice]:
    """Split cells into groups, so that the shapes near a group's cells fit into memory.

    Args:
        shapes: the shapes on the lattice.
        cells: ids of the cells, in any order, (n,).

    Yields:
        Indices into `cells`, group by group; one group with all cells if the shapes are in memory.
    """
    if not shapes.is_chunked:
        yield slice(None)
        return
    for rows in shapes.row_chunks():
        first_cell, end_cell = rows.cell_range(shapes.lattice)
        indices_in_rows = np.flatnonzero((first_cell <= cells) & (cells < end_cell))
        if len(indices_in_rows):
            yield indices_in_rows


class ColumnCaster:
    """Intersects the vertical lines through cells' centres with shapes; implements `ColumnSource`.

    A line with all its hits is a column. The columns of a small lattice are computed once and kept.
    Those of a large lattice are computed on each request; repeated requests return equal columns.

    Attributes:
        lattice: the cells.
    """

    def __init__(
        self,
        shapes: ShapeSource,
        agent: AgentSettings,
        max_crack_distance: float,
        clock: StageClock,
    ) -> None:
        """Cast the columns if they are to be kept.

        Args:
            shapes: the shapes on the lattice, listed for lines up to `max_crack_distance` away.
            agent: the agent: cracks are closed in floors that it can stand on.
            max_crack_distance: how wide cracks may be to be closed, see `close_cracks` [m].
            clock: times the casting.
        """
        self.lattice = shapes.lattice
        self._shapes = shapes
        self._agent = agent
        self._crack = max_crack_distance
        self._clock = clock
        self._all_columns: Columns | None = None
        self._last_cells: Int = np.empty(0, dtype=np.int64)  # of the last call of `columns_at`
        self._last_columns: Columns | None = None
        with clock.stage("columns"):
            if self.lattice.width * self.lattice.height <= MAX_CELLS_IN_MEMORY:
                self._all_columns = self._cast_all()

    def row_chunks(self) -> Iterator[Columns]:
        """Yield the columns of all rows, as chunks of rows in their order.

        The next chunk is cast on another thread while the caller works on the one before it. The
        clock counts only the time that the caller waits.
        """
        if self._all_columns is not None:
            if self._shapes.is_chunked:
                yield from map(self._all_columns.select_rows, self._shapes.row_chunks())
            else:
                yield self._all_columns
            return
        chunks = self._shapes.row_chunks(CHUNKS_IN_MEMORY)
        next_columns = run_beside(self._cast_rows, chunks[0])
        for rows in [*chunks[1:], None]:
            chunk_columns = [self._wait(next_columns)]
            if rows is not None:
                next_columns = run_beside(self._cast_rows, rows)
            # popped, so that no reference is held here while the caller works on it
            yield chunk_columns.pop()
        give_back_memory()  # memory that is freed between arrays in use stays reserved

    def _wait(self, next_columns: Callable[[], Columns]) -> Columns:
        """Wait for columns that another thread casts, and add the time to the clock's stage."""
        with self._clock.add_to_stage("columns"):
            return next_columns()

    def columns_at(self, cells: Int | Int32) -> Columns:
        """Return the columns of some cells; implements `ColumnSource`.

        Args:
            cells: ids of the cells, in any order.

        Returns:
            Columns of the whole lattice. Those of `cells` are valid; all others may be invalid.
        """
        if self._all_columns is not None:
            return self._all_columns
        if self._last_columns is not None and np.isin(cells, self._last_cells).all():
            return self._last_columns
        ascending_cells = unique_cells(self.lattice, cells)
        with self._clock.add_to_stage("columns"):
            columns = cast_cells(self._shapes, self._agent, self._crack, ascending_cells)
            give_back_memory()
        self._last_cells = ascending_cells
        self._last_columns = columns
        return columns

    def release_memory(self) -> None:
        """Give free memory back, in a large lattice; implements `ColumnSource`."""
        self._last_cells = np.empty(0, dtype=np.int64)
        self._last_columns = None
        if self._all_columns is None:  # in a small lattice, giving it back takes more than it saves
            give_back_memory()

    def _cast_rows(self, rows: RowChunk) -> Columns:
        """Cast the columns of a chunk of rows."""
        tiled_shapes = self._shapes.shapes_near_rows(rows)
        columns = self._correct_columns(
            cast_columns(tiled_shapes, rows).select_rows(rows), tiled_shapes
        )
        return replace(columns, nearby_shapes=tiled_shapes)

    def _cast_all(self) -> Columns:
        """Cast the columns of all cells, chunk by chunk to limit the memory that it takes."""
        chunks = self._shapes.row_chunks()
        if len(chunks) == 1:
            tiled_shapes = self._shapes.shapes_near_rows(chunks[0])
            return self._correct_columns(cast_columns(tiled_shapes), tiled_shapes)
        builder = ColumnsBuilder(self.lattice)
        for rows in chunks:
            builder.add(self._cast_rows(rows), rows)
        return builder.build()

    def _correct_columns(self, columns: Columns, tiled_shapes: TiledShapes) -> Columns:
        """Correct columns where they are not what an agent would meet, after they were cast.

        Lines in seams between geoms get the hits of one geom, steep facets of rough ground get the
        normal of the ground, and lines in cracks of a floor get a hit of the floor.
        """
        columns = resolve_seams(columns, tiled_shapes)
        columns = replace_rough_ground_normals(columns, tiled_shapes, self._agent)
        return close_cracks(columns, tiled_shapes, self._agent, self._crack)


def join_columns(source: ColumnSource, window: Window, lattice: Lattice) -> Columns:
    """Copy the columns of a window of a lattice to columns of the window's own lattice.

    Args:
        source: the columns of the whole lattice.
        window: the rows and columns of that lattice to copy.
        lattice: the lattice of the window alone; its cells are at the same places in the world.
    """
    builder = ColumnsBuilder(lattice)
    is_entire_lattice = lattice == source.lattice
    for columns in source.row_chunks():
        if is_entire_lattice and columns.row_chunk is None:
            return columns
        cropped_columns = columns if is_entire_lattice else columns.crop(*window, lattice)
        builder.add(cropped_columns, cropped_columns.valid_rows)
    return builder.build()


class WindowColumns(NamedTuple):
    """Provides the columns of a window of a lattice; implements `ColumnSource`.

    Attributes:
        source: the columns of the whole lattice.
        window: the rows and columns of that lattice which the window has.
        lattice: the lattice of the window alone; its cells are at the same places in the world.
    """

    source: ColumnSource
    window: Window
    lattice: Lattice

    def row_chunks(self) -> Iterator[Columns]:
        """Yield all columns as one chunk."""
        yield join_columns(self.source, self.window, self.lattice)

    def columns_at(self, cells: Int | Int32) -> Columns:
        """Return the columns of some cells; implements `ColumnSource`.

        Args:
            cells: ids of the cells in the window, in any order.

        Returns:
            Columns of the whole window. Those of `cells` are valid; all others may be invalid.
        """
        window_cells = unique_cells(self.lattice, cells)
        source_cells = self.to_source_cells(window_cells)
        hits = select_columns(self.source.columns_at(source_cells).hits, source_cells)
        return index_by_cell(self.lattice, window_cells, hits)

    def release_memory(self) -> None:
        """Give free memory back, in a large lattice; implements `ColumnSource`."""
        self.source.release_memory()

    def to_source_cells(self, cells: Int) -> Int:
        """Turn ids of cells in the window into ids in the lattice of the source."""
        row, col = np.divmod(cells, self.lattice.width)
        rows, cols = self.window
        source_row = row + rows.start
        source_cells: Int = source_row * self.source.lattice.width + col + cols.start
        return source_cells


def unique_cells(lattice: Lattice, cells: Int | Int32) -> Int:
    """Return ids of cells in ascending order, each once.

    Args:
        lattice: the lattice of the cells.
        cells: the ids, in any order.
    """
    is_requested = np.zeros(lattice.width * lattice.height, dtype=np.bool_)
    is_requested[cells] = True
    return np.flatnonzero(is_requested)


def cast_cells(
    shapes: ShapeSource, agent: AgentSettings, max_crack_distance: float, cells: Int
) -> Columns:
    """Find all hits on the vertical lines through some cells' centres, and correct them.

    Lines in seams between geoms are cast again beside them, steep facets of rough ground get the
    normal of the ground around them, and cracks in floors are closed.

    Args:
        shapes: the shapes on the lattice.
        agent: the agent. Its slope, step and height decide which hits are floors.
        max_crack_distance: a crack is closed if the floors on both sides are nearer to the line
            than this [m], see `close_cracks`.
        cells: ids of the cells, ascending, (n,).

    Returns:
        Columns of the whole lattice, of which only those of these cells are valid.
    """
    tiled_shapes = shapes.shapes_near_cells(cells)
    lattice = shapes.lattice
    row, col = np.divmod(cells, lattice.width)
    hits = cast_points(tiled_shapes, cells, lattice.positions(row, col))
    columns = index_by_cell(lattice, cells, hits)
    columns = resolve_seams(columns, tiled_shapes, cells)
    is_cast = np.zeros(len(columns.start) - 1, dtype=np.bool_)
    is_cast[cells] = True
    columns = replace_rough_ground_normals(columns, tiled_shapes, agent, is_cast)
    return close_cracks(columns, tiled_shapes, agent, max_crack_distance, is_cast)


def index_by_cell(lattice: Lattice, cells: Int, hits: ColumnHits) -> Columns:
    """Make columns that are indexed by cell id, from the hits of some cells.

    Args:
        lattice: the cells.
        cells: ids of cells, ascending, (n,).
        hits: the hits of n columns; column i belongs to ``cells[i]``.

    Returns:
        Columns of the lattice, of which only those of these cells are valid.
    """
    first_row, last_row = (cells[[0, -1]] // lattice.width).tolist() if len(cells) else (0, 0)
    first_valid_row = first_row // TILE * TILE
    end_valid_row = min(last_row // TILE * TILE + TILE, lattice.height)
    valid_rows = RowChunk(first_valid_row, end_valid_row)
    first_valid_cell, end_valid_cell = valid_rows.cell_range(lattice)
    # the entries of other rows have no meaning, and zeros in all of them would take longer to
    # write than a few cells take to cast
    start = np.empty(lattice.width * lattice.height + 1, dtype=np.int64)
    start[first_valid_cell : end_valid_cell + 1] = 0
    start[cells] = hits.start[:-1]
    start[cells + 1] = hits.start[1:]
    return Columns(lattice, hits._replace(start=start), valid_rows)
