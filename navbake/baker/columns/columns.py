"""Columns: every crossing of every cell's vertical line with the scene."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.hit_kernels import DROPPED, RIM
from navbake.baker.columns.ray_kernels import GROUP, Lines, cast_lines
from navbake.baker.core.arrays import ColumnHits, Facets, HeightRange, ShapeIndex
from navbake.baker.core.blocks import join_arrays
from navbake.baker.core.tiles import TILE, list_boxes_by_tile
from navbake.baker.geometry.shapes import Shapes
from navbake.navgrid.lattice import Lattice
from navbake.threads import num_threads, run_in_chunks
from navbake.types import Float, Int, Int32

# ColumnHits of so many cells are found at once, for the memory that it takes
BLOCK_CELLS = 1 << 20
# So many lines at points are worth a call on another thread
LEAST_POINTS = 1024
# Chunks for each thread, where there are more boxes than so many a tile
CHUNKS = 2
MIN_BOXES_PER_TILE = 4
WORLD_AXES = np.eye(3)  # the axes of a frame in which vertical lines are upright


class RowChunk(NamedTuple):
    """A band of rows of cells: the first, and past the last."""

    first: int
    end: int

    def cell_range(self, lattice: Lattice) -> tuple[int, int]:
        """The first of their cells, and past the last."""
        return self.first * lattice.width, self.end * lattice.width

    def padded(self, by: int, lattice: Lattice) -> "RowChunk":
        """The rows with some more on both sides, as far as the lattice goes."""
        return RowChunk(max(self.first - by, 0), min(self.end + by, lattice.height))


def split_into_row_chunks(lattice: Lattice, alive: int = 1) -> list[RowChunk]:
    """Split a lattice into blocks of rows, of whole `TILE`s, and about `BLOCK_CELLS` cells.

    Where several are `alive` at a time, they have so many cells together.
    """
    count = max(BLOCK_CELLS // (alive * lattice.width * TILE), 1) * TILE
    firsts = range(0, lattice.height, count)
    return [RowChunk(first, min(first + count, lattice.height)) for first in firsts]


def tiles_of_rows(lattice: Lattice, rows: RowChunk) -> range:
    """The tiles that some rows of cells lie on, which begin and end with whole tiles."""
    num = -(-lattice.width // TILE)
    return range(rows.first // TILE * num, -(-rows.end // TILE) * num)


@dataclass(frozen=True)
class TiledShapes:
    """Shapes on a lattice, listed by the tiles of cells that they lie over."""

    shapes: Shapes
    lattice: Lattice
    facets: Facets
    tile_index: ShapeIndex

    def near_rows(self, rows: RowChunk) -> "TiledShapes":
        """The shapes near some rows, and others; see `ShapeSource`."""
        return self

    def near_cells(self, cells: Int) -> "TiledShapes":
        """The shapes near some cells, and others."""
        return self

    @cached_property
    def tile_row_index(self) -> ShapeIndex:
        """Which of them lie over centres of which band of rows."""
        solids = list_by_tile_row(self.shapes.solids.bounds, RIM, self.lattice)
        return ShapeIndex(*solids, *list_by_tile_row(self.facets.bounds, RIM, self.lattice))

    @cached_property
    def height_range(self) -> HeightRange:
        """Heights below and above everything over the lattice [m]."""
        return height_range(self.shapes, self.lattice)


@dataclass(frozen=True)
class Columns:
    """All surfaces of all columns, ragged: cell i holds ``[start[i], start[i + 1])``.

    Columns of a band of rows have the surfaces of these alone, but `start` has an entry for every
    cell of the lattice, so that kernels find a cell by its id; those of other rows mean nothing.

    Attributes:
        lattice: the cells.
        hits: the surfaces, as kernels take them, with the attributes below.
        rows: the rows of cells that are known, all if None.
        nearby_shapes: the shapes near them, of a block of many.
        start: shape (cells + 1,), int64.
        z: heights, ascending in a column, shape (n,), float64 [m].
        normal: unit normals, shape (n, 3), float32; z > 0 faces up.
        geom: MuJoCo's geom ids, shape (n,), int32.
    """

    lattice: Lattice
    hits: ColumnHits
    rows: RowChunk | None = None
    nearby_shapes: TiledShapes | None = None

    @property
    def valid_rows(self) -> RowChunk:
        """The first row that is known, and past the last."""
        return self.rows or RowChunk(0, self.lattice.height)

    def select_rows(self, rows: RowChunk) -> "Columns":
        """The columns of some of the rows that are known; arrays are parts of these ones."""
        first, end = rows.cell_range(self.lattice)
        begin = int(self.start[first])
        part = slice(begin, int(self.start[end]))
        start = np.zeros(len(self.start), dtype=np.int64)  # whose pages cost nothing until written
        np.subtract(self.start[first : end + 1], begin, out=start[first : end + 1])
        _, z, normal, geom, closed = self.hits
        parts = z[part], normal[part], geom[part], closed[part]
        return Columns(self.lattice, ColumnHits(start, *parts), rows)

    @property
    def start(self) -> Int:
        return self.hits.start

    @property
    def z(self) -> Float:
        return self.hits.z

    @property
    def normal(self) -> NDArray[np.float32]:
        return self.hits.normal

    @property
    def geom(self) -> Int32:
        return self.hits.geom

    def crop(self, rows: slice, cols: slice, lattice: Lattice) -> "Columns":
        """The columns of a window, of those of its rows that are known.

        `lattice` is the window's own, with cells in the same places.
        """
        known = RowChunk(*np.clip(self.valid_rows, rows.start, rows.stop).tolist())
        row, col = np.ogrid[known.first : known.end, cols]
        found = select_columns(self.hits, (row * self.lattice.width + col).ravel())
        start = np.zeros(lattice.width * lattice.height + 1, dtype=np.int64)
        shown = RowChunk(known.first - rows.start, known.end - rows.start)
        place, end = shown.cell_range(lattice)
        start[place : end + 1] = found.start
        parts = found._replace(start=start)
        return Columns(lattice, parts, None if shown == (0, lattice.height) else shown)

    def row_chunks(self) -> Iterator["Columns"]:
        """All columns, in one block."""
        yield self

    def covering(self, cells: Int | Int32) -> "Columns":
        """The columns of some cells, and others."""
        return self


class ColumnSource(Protocol):
    """Where the columns of a lattice come from: all at once, or block by block."""

    @property
    def lattice(self) -> Lattice:
        """The cells."""

    def row_chunks(self) -> Iterator[Columns]:
        """The columns of all rows, by bands of them, in their order."""

    def covering(self, cells: Int | Int32) -> Columns:
        """Columns in which those of some cells are known, whatever the order of their ids."""


class ShapeSource(Protocol):
    """Where the listed shapes on a lattice come from: all at once, or those near what is asked."""

    @property
    def lattice(self) -> Lattice:
        """The cells."""

    def near_rows(self, rows: RowChunk) -> TiledShapes:
        """Shapes with all that are near some rows of whole bands."""

    def near_cells(self, cells: Int) -> TiledShapes:
        """Shapes with all that are near some cells."""


class GatheredColumns:
    """Columns of all rows, joined from bands in the order of rows."""

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice
        self._start = np.zeros(lattice.width * lattice.height + 1, dtype=np.int64)
        self._parts = list[list[NDArray[Any]]]()
        self._count = 0

    def add(self, columns: Columns, rows: RowChunk) -> None:
        """Add the columns of the next rows."""
        first, end = rows.cell_range(self._lattice)
        begin = int(columns.start[first])
        stop = int(columns.start[end])
        ends = self._start[first + 1 : end + 1]
        np.add(columns.start[first + 1 : end + 1], self._count - begin, out=ends)
        self._parts.append([array[begin:stop] for array in columns.hits[1:]])
        self._count += stop - begin

    def join(self) -> Columns:
        """The columns of all rows, once."""
        return Columns(self._lattice, ColumnHits(self._start, *join_arrays(self._parts)))


def tile_shapes(
    shapes: Shapes, lattice: Lattice, reach: float, facets: Facets | None = None
) -> TiledShapes:
    """List the shapes by tiles, within `reach` of cells' centres [m].

    `facets` are in place of their own triangles.
    """
    facets = shapes.triangles if facets is None else facets
    solids = list_by_tile(shapes.solids.bounds, reach, lattice)
    tiles = ShapeIndex(*solids, *list_by_tile(facets.bounds, reach, lattice))
    return TiledShapes(shapes, lattice, facets, tiles)


def cast_columns(tiled: TiledShapes, rows: RowChunk | None = None) -> Columns:
    """Cross the vertical line through every cell's centre with all geometry.

    Each solid is crossed from above and from below, planes from their front only. Lines within
    1e-7 m of a rim cross it, so that a seam between two geoms never leaks.

    Args:
        rows: the rows of cells that are asked about, all if None. They become whole `TILE`s.
    """
    lattice = tiled.lattice
    asked = rows or RowChunk(0, lattice.height)
    bands = range(asked.first // TILE, -(-asked.end // TILE))
    asked = RowChunk(bands.start * TILE, min(bands.stop * TILE, lattice.height))
    first, end = asked.cell_range(lattice)
    start = np.zeros(lattice.width * lattice.height + 1, dtype=np.int64)
    none = Lines(np.empty((0, 2)), np.empty((0, 2), dtype=np.int64), WORLD_AXES)
    known = slice(first, end + 1)
    return Columns(
        lattice, _cast(tiled, none, tiled.tile_row_index, bands, start, known), rows and asked
    )


def cast_points(
    tiled: TiledShapes, cells: Int, points: Float, axes: Float = WORLD_AXES
) -> ColumnHits:
    """Cross lines with the geometry near some cells, as `cast_columns` does; one column a line.

    Args:
        cells: the cell that each line is near to, by at most the reach of `tile_shapes`, (n,); or
            two cells, (n, 2), of a line that lies between them: such a line may cross one thing
            several times, once in each tile of their rectangle.
        points: x and y of each line, shape (n, 2) [m].
        axes: of a frame in which the lines are upright, its rows. The points, the normals and the
            shapes' solids are in this frame.
    """
    tiles = tile_of(tiled.lattice, cells)
    tiles = np.stack([tiles, tiles], axis=1) if tiles.ndim == 1 else tiles
    lines = Lines(np.ascontiguousarray(points), tiles, axes)
    groups = range(-(-len(points) // GROUP))
    start = np.zeros(len(points) + 1, dtype=np.int64)
    return _cast(tiled, lines, tiled.tile_index, groups, start, slice(None), LEAST_POINTS // GROUP)


def _cast(
    tiled: TiledShapes,
    lines: Lines,
    items: ShapeIndex,
    groups: range,
    start: Int,
    known: slice,
    least: int = 1,
) -> ColumnHits:
    """Cross some groups of lines; columns start at the `known` part of `start`, of zeros."""
    geometry = tiled.shapes.solids, tiled.facets, tiled.shapes.planes, tiled.height_range
    dropped = np.zeros(groups.stop, dtype=np.int64)
    crossed = np.empty(len(items.triangle_item), dtype=np.bool_)

    def cast(hits: ColumnHits) -> None:
        asked = tiled.lattice, lines, geometry, items, crossed, hits, dropped
        run_in_chunks(cast_lines, len(groups), *asked, least=least, begin=groups.start)

    cast(no_hits(start, 0))  # without room for them, the hits are only counted
    ends = start[known]
    np.cumsum(ends, out=ends)
    hits = no_hits(start, int(ends[-1]))
    if len(hits.z):
        cast(hits)
    if dropped.any():
        size = GROUP if len(lines.points) else TILE * tiled.lattice.width
        hits = _without_dropped(hits, groups, size, dropped)
    return hits


def _without_dropped(every: ColumnHits, groups: range, size: int, dropped: Int) -> ColumnHits:
    """Leave out the hits that are DROPPED, so many of each group of `size` lines.

    `every.start` is brought up to date in place.
    """
    before = np.append(0, np.cumsum(dropped))
    begin = every.start[groups.start * size :: size][: len(groups)].tolist()
    begin.append(len(every.z))
    hits = no_hits(every.start, len(every.z) - int(before[-1]))

    def keep(first: int, end: int) -> None:
        for group in range(first, end):
            old = slice(*begin[group - groups.start : group - groups.start + 2])
            new = slice(old.start - int(before[group]), old.stop - int(before[group + 1]))
            ends = every.start[group * size + 1 : (group + 1) * size + 1]
            is_kept = every.geom[old] != DROPPED
            ends[:] = new.start + np.append(0, np.cumsum(is_kept))[ends - old.start]
            kept = np.flatnonzero(is_kept)
            layers: Any = zip(every[1:], hits[1:], strict=True)
            for array, own in layers:
                np.take(array[old], kept, axis=0, out=own[new], mode="clip")

    run_in_chunks(keep, len(groups), begin=groups.start)
    return hits


def select_columns(hits: ColumnHits, cells: Int) -> ColumnHits:
    """The columns of some cells, numbered as these are."""
    first = hits.start[cells]
    return take_runs(hits[1:], first, hits.start[cells + 1] - first)


def take_runs(arrays: Sequence[NDArray[Any]], first: Int, counts: Int) -> ColumnHits:
    """Copy `counts[i]` hits from `first[i]` on, for each column i."""
    start = np.concatenate([[0], np.cumsum(counts)])
    taken = np.repeat(first - start[:-1], counts) + np.arange(start[-1])
    return ColumnHits(start, *(array[taken] for array in arrays))


def no_hits(start: Int, count: int) -> ColumnHits:
    """Room for so many hits of columns that start at known places."""
    z = np.empty(count)
    normal = np.empty((count, 3), dtype=np.float32)
    geom = np.empty(count, dtype=np.int32)
    closed = np.empty(count, dtype=np.uint8)
    return ColumnHits(start, z, normal, geom, closed)


def height_range(shapes: Shapes, lattice: Lattice) -> HeightRange:
    """Heights below and above everything over the lattice, infinite planes included [m]."""
    bounds = shapes.bounds
    heights = [0.0] if bounds is None else [float(bounds[0, 2]), float(bounds[1, 2])]
    x0, y0, x1, y1 = lattice.bounds
    corners = np.array([[x0, y0], [x0, y1], [x1, y0], [x1, y1]])
    for pos, normal in zip(shapes.planes.pos, shapes.planes.normal, strict=True):
        if abs(normal[2]) > 1e-6:
            heights.extend(pos[2] - (corners - pos[:2]) @ normal[:2] / normal[2])
    return HeightRange(float(min(heights)) - 1.0, float(max(heights)) + 1.0)


# ---------------------------------------------------------------- lists by tile and band


def tile_of(lattice: Lattice, cell: Int | int) -> Int:
    """The tile that holds each cell; tiles are numbered row by row."""
    row, col = np.divmod(cell, lattice.width)
    tile: Int = row // TILE * -(-lattice.width // TILE) + col // TILE
    return tile


def list_by_tile(boxes: Float, grow: float, lattice: Lattice) -> tuple[Int, Int32]:
    """List, for each tile, the boxes, shape (n, 6), that reach into it, widened by `grow` [m].

    Returns:
        The list of tile t is ``item[start[t] : start[t + 1]]``, ascending; start, shape
        (tiles + 1,), int64, and item, shape (start[-1],), int32.
    """
    tiles = -(-lattice.width // TILE) * -(-lattice.height // TILE)
    return _list(boxes, grow, lattice, tiles, by_band=False)


def list_by_tile_row(boxes: Float, grow: float, lattice: Lattice) -> tuple[Int, Int32]:
    """List, for each band of rows, the boxes that hold a cell's centre there, as `list_by_tile`."""
    return _list(boxes, grow, lattice, -(-lattice.height // TILE), by_band=True)


def _list(
    boxes: Float, grow: float, lattice: Lattice, count: int, *, by_band: bool
) -> tuple[Int, Int32]:
    if not len(boxes):
        return np.zeros(count + 1, dtype=np.int64), np.empty(0, dtype=np.int32)
    threads = num_threads()
    chunks = 1
    if threads > 1 and len(boxes) > MIN_BOXES_PER_TILE * count:
        # no more counts than boxes, however many threads there are
        chunks = min(CHUNKS * threads, len(boxes) // count)
    cursor = np.zeros((chunks, count), dtype=np.int64)
    under = np.empty((len(boxes), 4), dtype=np.int32)
    asked = boxes, grow, lattice, by_band, under, cursor
    run_in_chunks(list_boxes_by_tile, chunks, *asked, np.empty(0, dtype=np.int32))
    start = np.zeros(count + 1, dtype=np.int64)
    np.cumsum(cursor.sum(axis=0), out=start[1:])
    # each chunk's boxes over a tile follow those of the chunks before it
    cursor[:] = np.cumsum(cursor, axis=0) - cursor + start[:-1]
    item = np.empty(start[-1], dtype=np.int32)
    if len(item):
        run_in_chunks(list_boxes_by_tile, chunks, *asked, item)
    return start, item
