"""Cast columns: find where the vertical line through each cell's centre crosses surfaces.

Shapes are first listed by the tiles that they lie over, squares of 8 x 8 cells (`tile_shapes`).
Then lines are cast: through the centres of cells (`cast_columns`), or through given points
(`cast_points`).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.hit_kernels import RIM_WIDTH
from navbake.baker.columns.ray_kernels import LINES_PER_CALL, Geometry, Lines, cast_lines
from navbake.baker.core.arrays import ColumnHits, Facets, HeightRange, ShapeIndex
from navbake.baker.core.blocks import join_arrays
from navbake.baker.core.tiles import TILE, list_boxes_by_tile
from navbake.baker.geometry.shapes import Shapes, boxes_in_batches
from navbake.navgrid.lattice import Lattice
from navbake.threads import num_threads, run_in_chunks
from navbake.types import Float, Int, Int32

# Lines are cast for about this many cells at a time, to limit the memory that it takes
CELLS_PER_CHUNK = 1 << 20
# Fewer lines than this are not worth a call on another thread
MIN_POINTS_PER_CALL = 1024
# Boxes are listed on several threads, in this many chunks for each, if there are more than
# MIN_BOXES_PER_TILE_FOR_THREADS boxes for each tile; fewer are listed on one thread
BOX_CHUNKS_PER_THREAD = 2
MIN_BOXES_PER_TILE_FOR_THREADS = 4
WORLD_AXES = np.eye(3)
"""The axes of the world frame, in which lines are vertical."""


class RowChunk(NamedTuple):
    """A range of rows of a lattice: the part of a large lattice that is worked on at a time.

    Attributes:
        first: index of the first row.
        end: index after the last row.
    """

    first: int
    end: int

    def cell_range(self, lattice: Lattice) -> tuple[int, int]:
        """Return the id of the first cell in these rows, and the id after the last one."""
        return self.first * lattice.width, self.end * lattice.width


def split_into_row_chunks(
    lattice: Lattice, num_in_memory: int = 1, max_rows: float = math.inf
) -> list[RowChunk]:
    """Split a lattice into chunks of rows, so that all chunks in memory have about the same size.

    They have about `CELLS_PER_CHUNK` cells together. A chunk consists of entire rows of tiles.

    Args:
        lattice: the cells.
        num_in_memory: how many chunks will be in memory at a time.
        max_rows: about how many rows of cells all chunks in memory may have together; inf for no
            limit.
    """
    rows_in_memory = min(CELLS_PER_CHUNK / lattice.width, max_rows)
    num_rows = max(int(rows_in_memory / (num_in_memory * TILE)), 1) * TILE
    first_rows = range(0, lattice.height, num_rows)
    return [
        RowChunk(first_row, min(first_row + num_rows, lattice.height)) for first_row in first_rows
    ]


def tiles_of_rows(lattice: Lattice, rows: RowChunk) -> range:
    """Return the ids of the tiles in some rows of cells.

    Args:
        lattice: the cells.
        rows: the rows of cells, which make up entire rows of tiles.
    """
    tiles_per_row = -(-lattice.width // TILE)
    return range(rows.first // TILE * tiles_per_row, -(-rows.end // TILE) * tiles_per_row)


@dataclass(frozen=True)
class TiledShapes:
    """Shapes on a lattice, listed by the tiles of cells that they lie over.

    Attributes:
        shapes: the shapes.
        lattice: the cells.
        facets: the listed triangles: all triangles of `shapes`, or some of them.
        tile_index: which solids and facets lie over each tile of 8 x 8 cells.
    """

    shapes: Shapes
    lattice: Lattice
    facets: Facets
    tile_index: ShapeIndex
    is_chunked = False

    def row_chunks(self, num_in_memory: int = 1) -> list[RowChunk]:
        """Split the lattice into chunks of rows of about equal size; implements `ShapeSource`.

        Args:
            num_in_memory: how many chunks will be in memory at a time.
        """
        return split_into_row_chunks(self.lattice, num_in_memory)

    def shapes_near_rows(self, rows: RowChunk) -> "TiledShapes":
        """Return all shapes, whatever the rows; implements `ShapeSource`."""
        return self

    def shapes_near_cells(self, cells: Int) -> "TiledShapes":
        """Return all shapes, whatever the cells; implements `ShapeSource`."""
        return self

    @cached_property
    def tile_row_index(self) -> ShapeIndex:
        """The solids and triangles that lie over a cell's centre, for each row of tiles."""
        solid_start, solid_indices = list_by_tile_row(
            self.shapes.solids.bounds, RIM_WIDTH, self.lattice
        )
        triangle_start, triangle_indices = list_by_tile_row(self.facets, RIM_WIDTH, self.lattice)
        return ShapeIndex(solid_start, solid_indices, triangle_start, triangle_indices)

    @property
    def geometry(self) -> Geometry:
        """Return the listed shapes as kernels take them."""
        shapes = self.shapes
        return Geometry(shapes.solids, self.facets, shapes.planes, self.height_range)

    @cached_property
    def height_range(self) -> HeightRange:
        """Return a height below all shapes over the lattice, and one above all of them [m]."""
        return height_range(self.shapes, self.lattice)


@dataclass(frozen=True)
class Columns:
    """The columns of a lattice: where each cell's vertical line crosses the surfaces of a scene.

    The columns of a large lattice are computed for a chunk of its rows at a time. Then `hits` has
    no hits of other rows. But `hits.start` still has an entry for every cell of the lattice, so
    that kernels find a cell by its id; the entries of other rows have no meaning.

    Attributes:
        lattice: the cells.
        hits: the hits; column i belongs to cell i.
        row_chunk: the rows that have columns; None for all rows.
        nearby_shapes: the shapes near these rows, if shapes are listed chunk by chunk; else None.
    """

    lattice: Lattice
    hits: ColumnHits
    row_chunk: RowChunk | None = None
    nearby_shapes: TiledShapes | None = None

    @property
    def valid_rows(self) -> RowChunk:
        """The rows that have columns: `row_chunk`, or all rows."""
        return self.row_chunk or RowChunk(0, self.lattice.height)

    def select_rows(self, rows: RowChunk) -> "Columns":
        """Return the columns of some of the rows; only `start` is copied, the rest are views."""
        first_cell, end_cell = rows.cell_range(self.lattice)
        first_hit = int(self.start[first_cell])
        end_hit = int(self.start[end_cell])
        old_start = self.start[first_cell : end_cell + 1]
        start = np.zeros(len(self.start), dtype=np.int64)  # whose pages cost nothing until written
        np.subtract(old_start, first_hit, out=start[first_cell : end_cell + 1])
        hit_arrays = [array[first_hit:end_hit] for array in self.hits.entries]
        return Columns(self.lattice, ColumnHits(start, *hit_arrays), rows)

    @property
    def start(self) -> Int:
        """The index of each column's first hit, and at the end the number of hits, (cells + 1,)."""
        return self.hits.start

    @property
    def z(self) -> Float:
        """Heights of the hits, ascending in a column, shape (n,) [m]."""
        return self.hits.z

    @property
    def normal(self) -> NDArray[np.float32]:
        """Unit normals of the surfaces, shape (n, 3), float32; z > 0 faces up."""
        return self.hits.normal

    @property
    def geom(self) -> Int32:
        """MuJoCo's ids of the geoms that are hit, shape (n,), int32."""
        return self.hits.geom

    def crop(self, rows: slice, cols: slice, lattice: Lattice) -> "Columns":
        """Return the columns of a window of the lattice.

        The columns of rows of the window that are not in `valid_rows` have no hits.

        Args:
            rows, cols: the window, as slices of the lattice's rows and columns.
            lattice: the lattice of the window alone; its cells are at the same places in the world.
        """
        first_row, end_row = np.clip(self.valid_rows, rows.start, rows.stop).tolist()
        row_grid, col_grid = np.ogrid[first_row:end_row, cols]
        cells = (row_grid * self.lattice.width + col_grid).ravel()
        hits = select_columns(self.hits, cells)
        cropped_rows = RowChunk(first_row - rows.start, end_row - rows.start)
        first_cell, end_cell = cropped_rows.cell_range(lattice)
        start = np.zeros(lattice.width * lattice.height + 1, dtype=np.int64)
        start[first_cell : end_cell + 1] = hits.start
        has_all_rows = cropped_rows == (0, lattice.height)
        return Columns(lattice, hits._replace(start=start), None if has_all_rows else cropped_rows)

    def row_chunks(self) -> Iterator["Columns"]:
        """Yield all columns as one chunk; implements `ColumnSource`."""
        yield self

    def columns_at(self, cells: Int | Int32) -> "Columns":
        """Return all columns, which are valid for all cells; implements `ColumnSource`."""
        return self

    def release_memory(self) -> None:
        """Do nothing, as all columns stay in memory; implements `ColumnSource`."""


class ColumnSource(Protocol):
    """Protocol of objects that provide the columns of a lattice: all at once, or chunk by chunk."""

    @property
    def lattice(self) -> Lattice:
        """Return the lattice."""

    def row_chunks(self) -> Iterator[Columns]:
        """Yield the columns of all rows, as chunks of rows in their order."""

    def columns_at(self, cells: Int | Int32) -> Columns:
        """Return the columns of some cells.

        Args:
            cells: ids of the cells, in any order.

        Returns:
            Columns of the whole lattice. Those of `cells` are valid; all others may be invalid.
        """

    def release_memory(self) -> None:
        """Give all memory that is free back to the system, in a large lattice.

        The columns that `columns_at` keeps for its next calls are freed before.
        """


class ShapeSource(Protocol):
    """Protocol of objects that list the shapes near given cells, by tiles of cells.

    A source may keep all shapes in memory, or list those near the requested cells on each request.
    """

    @property
    def lattice(self) -> Lattice:
        """Return the lattice."""

    @property
    def is_chunked(self) -> bool:
        """Return whether each request lists only the shapes near its rows or cells anew.

        False if all shapes stay in memory.
        """

    def row_chunks(self, num_in_memory: int = 1) -> list[RowChunk]:
        """Split the lattice into chunks of rows, so that the shapes near a chunk fit into memory.

        Args:
            num_in_memory: how many chunks will be in memory at a time.
        """

    def shapes_near_rows(self, rows: RowChunk) -> TiledShapes:
        """Return all shapes near some rows of cells, and maybe others.

        Args:
            rows: the rows, which make up entire rows of tiles.
        """

    def shapes_near_cells(self, cells: Int) -> TiledShapes:
        """Return all shapes near some cells, and maybe others.

        Args:
            cells: ids of the cells, in any order.
        """


class ColumnsBuilder:
    """Joins chunks of rows, which are added in order, to the columns of a whole lattice."""

    def __init__(self, lattice: Lattice) -> None:
        """Start without columns.

        Args:
            lattice: the cells.
        """
        self._lattice = lattice
        self._start = np.zeros(lattice.width * lattice.height + 1, dtype=np.int64)
        self._arrays_of_chunks = list[list[NDArray[Any]]]()
        self._num_hits = 0

    def add(self, columns: Columns, rows: RowChunk) -> None:
        """Add the columns of the next rows.

        Args:
            columns: columns that are valid in these rows.
            rows: the rows; the first one follows the last row that was added.
        """
        first_cell, end_cell = rows.cell_range(self._lattice)
        first_hit = int(columns.start[first_cell])
        end_hit = int(columns.start[end_cell])
        np.add(
            columns.start[first_cell + 1 : end_cell + 1],
            self._num_hits - first_hit,
            out=self._start[first_cell + 1 : end_cell + 1],
        )
        self._arrays_of_chunks.append([array[first_hit:end_hit] for array in columns.hits.entries])
        self._num_hits += end_hit - first_hit

    def build(self) -> Columns:
        """Return the columns of all rows; can be called once."""
        return Columns(self._lattice, ColumnHits(self._start, *join_arrays(self._arrays_of_chunks)))


# ---------------------------------------------------------------- casting lines


def tile_shapes(
    shapes: Shapes, lattice: Lattice, margin: float, facets: Facets | None = None
) -> TiledShapes:
    """List shapes by the tiles that they lie over.

    Args:
        shapes: the shapes.
        lattice: the cells.
        margin: shapes within this distance of a tile count as over it [m].
        facets: triangles to list in place of those of `shapes`.
    """
    facets = shapes.triangles if facets is None else facets
    solid_start, solid_indices = list_by_tile(shapes.solids.bounds, margin, lattice)
    triangle_start, triangle_indices = list_by_tile(facets, margin, lattice)
    tile_index = ShapeIndex(solid_start, solid_indices, triangle_start, triangle_indices)
    return TiledShapes(shapes, lattice, facets, tile_index)


def cast_columns(tiled_shapes: TiledShapes, rows: RowChunk | None = None) -> Columns:
    """Find where the vertical lines through cells' centres cross shapes.

    A line crosses a solid's top and its underside, but only the front of a plane. A line that
    misses a shape's rim by at most 1e-7 m crosses it, so that a seam between two geoms never leaks.

    Args:
        tiled_shapes: the shapes on a lattice.
        rows: the rows whose cells' lines are cast; None for all. Other rows of the same tiles are
            cast, too.
    """
    lattice = tiled_shapes.lattice
    cast_rows = rows or RowChunk(0, lattice.height)
    tile_rows = range(cast_rows.first // TILE, -(-cast_rows.end // TILE))
    cast_rows = RowChunk(tile_rows.start * TILE, min(tile_rows.stop * TILE, lattice.height))
    first_cell, end_cell = cast_rows.cell_range(lattice)
    hits = _cast_groups(
        tiled_shapes,
        lines=Lines(np.empty((0, 2)), np.empty((0, 2), dtype=np.int64), WORLD_AXES),
        shape_index=tiled_shapes.tile_row_index,
        group_range=tile_rows,
        start=np.zeros(lattice.width * lattice.height + 1, dtype=np.int64),
        start_slice=slice(first_cell, end_cell + 1),
    )
    return Columns(lattice, hits, rows and cast_rows)


def cast_points(
    tiled_shapes: TiledShapes, cells: Int, points: Float, axes: Float = WORLD_AXES
) -> ColumnHits:
    """Find where the vertical lines through given points cross shapes.

    `cast_columns` does this for the lines through cells' centres. Here, a line is tested only with
    the shapes over the tiles that `cells` names.

    Args:
        tiled_shapes: the shapes on a lattice.
        cells: ids of cells. With one for each line, shape (n,), the line is tested with the shapes
            over the cell's tile. With two, shape (n, 2), it is tested with the shapes over each
            tile of the rectangle between the two cells; a shape over several of these tiles gives
            the line a hit for each.
        points: x and y of each line, shape (n, 2) [m].
        axes: the axes of the frame in which the lines are vertical, one in each row, shape (3, 3).
            The points, the returned normals, and the solids of the shapes are in this frame.

    Returns:
        The hits; column i belongs to line i.
    """
    tiles_of_lines = tile_of(tiled_shapes.lattice, cells)
    if tiles_of_lines.ndim == 1:
        tiles_of_lines = tiles_of_lines.repeat(2).reshape(-1, 2)
    return _cast_groups(
        tiled_shapes,
        lines=Lines(np.ascontiguousarray(points), tiles_of_lines, axes),
        shape_index=tiled_shapes.tile_index,
        group_range=range(-(-len(points) // LINES_PER_CALL)),
        start=np.zeros(len(points) + 1, dtype=np.int64),
        start_slice=slice(None),
        min_groups_per_call=MIN_POINTS_PER_CALL // LINES_PER_CALL,
    )


def _cast_groups(
    tiled_shapes: TiledShapes,
    *,
    lines: Lines,
    shape_index: ShapeIndex,
    group_range: range,
    start: Int,
    start_slice: slice,
    min_groups_per_call: int = 1,
) -> ColumnHits:
    """Intersect lines with shapes, group by group of lines, on all threads; see `cast_lines`.

    Args:
        tiled_shapes: the shapes.
        lines: lines through points; without points, the lines run through the centres of cells.
        shape_index: the shapes by tile for lines through points, else by row of tiles.
        group_range: numbers of the groups to cast: of `LINES_PER_CALL` lines through points, or of
            the lines of a row of tiles.
        start: zeros, (lines + 1,) int64; becomes `ColumnHits.start`.
        start_slice: the part of `start` that belongs to these lines, with the entry after the
            last one.
        min_groups_per_call: smallest number of groups for one call, see `run_in_chunks`.
    """
    geometry = tiled_shapes.geometry
    num_dropped = np.zeros(len(start), dtype=np.int32)
    is_crossed = np.empty(len(shape_index.triangle_indices), dtype=np.bool_)
    end_of_chunk = dict[int, int]()  # by its first group: the index after its last hit

    def cast_chunk(hits: ColumnHits, first_group: int, end_group: int) -> None:
        end_of_chunk[first_group] = cast_lines(
            tiled_shapes.lattice,
            lines,
            geometry,
            shape_index,
            is_crossed,
            hits,
            num_dropped,
            first_group,
            end_group,
        )

    def cast_all(hits: ColumnHits) -> None:
        run_in_chunks(
            cast_chunk,
            len(group_range),
            hits,
            min_chunk_size=min_groups_per_call,
            begin=group_range.start,
        )

    cast_all(empty_hits(start, 0))  # without room for hits, they are only counted
    hit_ends = start[start_slice]
    np.cumsum(hit_ends, out=hit_ends)
    hits = empty_hits(start, int(hit_ends[-1]))
    if len(hits.z):
        cast_all(hits)
    if not num_dropped[start_slice].any():
        return hits
    lines_per_group = LINES_PER_CALL if len(lines.points) else TILE * tiled_shapes.lattice.width
    num_hits = 0
    moves = list[tuple[slice, slice]]()  # of the hits of each chunk: where to, and from where
    for first_group in sorted(end_of_chunk):  # each chunk moves to the end of the one before it
        chunk = slice(int(start[first_group * lines_per_group]), end_of_chunk[first_group])
        place = slice(num_hits, num_hits + chunk.stop - chunk.start)
        moves.append((place, chunk))
        num_hits = place.stop

    def close_gaps(first_array: int, end_array: int) -> None:
        for array in hits.entries[first_array:end_array]:
            for place, chunk in moves:
                array[place] = array[chunk]

    run_in_chunks(close_gaps, len(hits.entries))
    hit_ends -= np.cumsum(num_dropped[start_slice])
    return ColumnHits(start, *(array[:num_hits] for array in hits.entries))


def select_columns(hits: ColumnHits, cells: Int) -> ColumnHits:
    """Select the columns of some cells.

    Args:
        hits: the columns of all cells.
        cells: ids of cells, (n,).

    Returns:
        The hits of n columns; column i belongs to ``cells[i]``.
    """
    first_hit = hits.start[cells]
    return gather_hits(hits.entries, first_hit, hits.start[cells + 1] - first_hit)


def gather_hits(
    old_hit_arrays: Sequence[NDArray[Any]], first_old_hit: Int, num_old_hits: Int
) -> ColumnHits:
    """Copy hits to new columns: each new column receives the hits of one range of the old arrays.

    Args:
        old_hit_arrays: the arrays of the old hits, as `ColumnHits.entries` returns them.
        first_old_hit: index of the first old hit for each new column, (columns,).
        num_old_hits: how many old hits each new column receives, (columns,).
    """
    start = np.concatenate([[0], np.cumsum(num_old_hits)])
    old_indices = np.repeat(first_old_hit - start[:-1], num_old_hits) + np.arange(start[-1])
    return ColumnHits(start, *(array[old_indices] for array in old_hit_arrays))


def empty_hits(start: Int, num_hits: int) -> ColumnHits:
    """Allocate columns whose hits are to be written.

    Args:
        start: index of each column's first hit, then the number of hits; used without a copy.
        num_hits: how many hits there is room for.
    """
    return ColumnHits(
        start=start,
        z=np.empty(num_hits),
        normal=np.empty((num_hits, 3), dtype=np.float32),
        geom=np.empty(num_hits, dtype=np.int32),
        closed=np.empty(num_hits, dtype=np.uint8),
    )


def height_range(shapes: Shapes, lattice: Lattice) -> HeightRange:
    """Return a height 1 m below all shapes over a lattice, and one 1 m above them [m].

    A tilted infinite plane counts by its lowest and highest point over the lattice.
    """
    bounds = shapes.bounds
    heights = [0.0] if bounds is None else [float(bounds[0, 2]), float(bounds[1, 2])]
    x_min, y_min, x_max, y_max = lattice.bounds
    corners = np.array([[x_min, y_min], [x_min, y_max], [x_max, y_min], [x_max, y_max]])
    for plane_pos, plane_normal in zip(shapes.planes.pos, shapes.planes.normal, strict=True):
        if abs(plane_normal[2]) > 1e-6:
            heights.extend(
                plane_pos[2] - (corners - plane_pos[:2]) @ plane_normal[:2] / plane_normal[2]
            )
    return HeightRange(float(min(heights)) - 1.0, float(max(heights)) + 1.0)


# ---------------------------------------------------------------- lists by tile


def tile_of(lattice: Lattice, cell: Int | int) -> Int:
    """Return the tile that holds each cell; tiles are numbered row by row.

    Args:
        lattice: the cells.
        cell: ids of cells, of any shape.
    """
    row, col = np.divmod(cell, lattice.width)
    tile: Int = row // TILE * -(-lattice.width // TILE) + col // TILE
    return tile


def list_by_tile(boxes: Float | Facets, margin: float, lattice: Lattice) -> tuple[Int, Int32]:
    """List, for each tile, the boxes that reach into it.

    Args:
        boxes: lower corner, upper corner, shape (n, 6) [m]; or triangles, for the boxes around
            them.
        margin: how much the boxes are widened on each side [m].
        lattice: the cells.

    Returns:
        Where each tile's list begins, ``start``, shape (tiles + 1,), int64; and the indices of the
        boxes, tile by tile, ``indices``, int32. The list of tile t is ascending:
        ``indices[start[t] : start[t + 1]]``.
    """
    num_tiles = -(-lattice.width // TILE) * -(-lattice.height // TILE)
    return _list_boxes(boxes, margin, lattice, num_tiles, by_tile_row=False)


def list_by_tile_row(boxes: Float | Facets, margin: float, lattice: Lattice) -> tuple[Int, Int32]:
    """List, for each row of tiles, the boxes that lie over the centre of a cell there.

    Args:
        boxes: lower corner, upper corner, shape (n, 6) [m]; or triangles, for the boxes around
            them.
        margin: how much the boxes are widened on each side [m].
        lattice: the cells.

    Returns:
        Where the list of each row of tiles begins, ``start``, shape (rows of tiles + 1,), int64;
        and the indices of the boxes, row by row, ``indices``, int32. The list of row r is
        ascending: ``indices[start[r] : start[r + 1]]``.
    """
    num_tile_rows = -(-lattice.height // TILE)
    return _list_boxes(boxes, margin, lattice, num_tile_rows, by_tile_row=True)


def _list_boxes(
    boxes: Float | Facets, margin: float, lattice: Lattice, num_tiles: int, *, by_tile_row: bool
) -> tuple[Int, Int32]:
    """List boxes by tile, or by row of tiles, on all threads.

    Args:
        boxes: lower corner, upper corner, shape (n, 6) [m]; or triangles, for the boxes around
            them.
        margin: how much the boxes are widened on each side [m].
        lattice: the cells.
        num_tiles: how many tiles the lattice has, or how many rows of tiles.
        by_tile_row: whether boxes are listed by row of tiles; then only boxes that cover a cell's
            centre in a row of tiles are listed for it.

    Returns:
        Where the list of each tile (or row of tiles) begins, ``start``, shape (num_tiles + 1,),
        int64; and the indices of the boxes, list by list, ``indices``, int32. The list of tile t is
        ascending: ``indices[start[t] : start[t + 1]]``.
    """
    num_boxes = len(boxes.faces) if isinstance(boxes, Facets) else len(boxes)
    if not num_boxes:
        return np.zeros(num_tiles + 1, dtype=np.int64), np.empty(0, dtype=np.int32)
    thread_count = num_threads()
    num_chunks = 1
    if thread_count > 1 and num_boxes > MIN_BOXES_PER_TILE_FOR_THREADS * num_tiles:
        # no more counts than boxes, however many threads there are
        num_chunks = min(BOX_CHUNKS_PER_THREAD * thread_count, num_boxes // num_tiles)
    box_slice_of_chunk = [
        slice(num_boxes * chunk // num_chunks, num_boxes * (chunk + 1) // num_chunks)
        for chunk in range(num_chunks)
    ]
    next_list_index = np.zeros((num_chunks, num_tiles), dtype=np.int64)
    tile_range_of_box = np.empty((num_boxes, 4), dtype=np.int32)

    def count_boxes(first_chunk: int, end_chunk: int) -> None:
        for chunk in range(first_chunk, end_chunk):
            box_slice = box_slice_of_chunk[chunk]
            if isinstance(boxes, Facets):
                batches = boxes_in_batches(boxes, box_slice.start, box_slice.stop)
            else:
                batches = iter([(box_slice, boxes[box_slice])])
            for batch, boxes_of_batch in batches:
                list_boxes_by_tile(
                    boxes_of_batch,
                    margin,
                    lattice,
                    by_tile_row,
                    tile_range_of_box[batch],
                    next_list_index[chunk],
                    batch.start,
                    np.empty(0, dtype=np.int32),  # without room, the boxes are only counted
                )

    run_in_chunks(count_boxes, num_chunks)
    for chunk in range(1, num_chunks):
        next_list_index[chunk] += next_list_index[chunk - 1]
    tile_start = np.empty(num_tiles + 1, dtype=np.int64)
    tile_start[0] = 0
    np.cumsum(next_list_index[-1], out=tile_start[1:])
    # each chunk's boxes over a tile follow those of the chunks before it
    for chunk in range(num_chunks - 1, 0, -1):
        np.add(tile_start[:-1], next_list_index[chunk - 1], out=next_list_index[chunk])
    next_list_index[0] = tile_start[:-1]
    box_indices_by_tile = np.empty(tile_start[-1], dtype=np.int32)

    def list_boxes(first_chunk: int, end_chunk: int) -> None:
        for chunk in range(first_chunk, end_chunk):
            box_slice = box_slice_of_chunk[chunk]
            list_boxes_by_tile(
                np.empty((0, 6)),
                margin,
                lattice,
                by_tile_row,
                tile_range_of_box[box_slice],
                next_list_index[chunk],
                box_slice.start,
                box_indices_by_tile,
            )

    if len(box_indices_by_tile):
        run_in_chunks(list_boxes, num_chunks)
    return tile_start, box_indices_by_tile
