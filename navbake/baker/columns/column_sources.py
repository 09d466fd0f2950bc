"""The columns of all that stands, which may be too many to keep: found block by block, again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navbake.baker.columns.columns import (
    Columns,
    ColumnSource,
    GatheredColumns,
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

# Columns of at most so many cells are kept: they take about 100 bytes each
KEPT_CELLS = 1 << 22
# Blocks that there are at a time: the one that is looked at, and the next one
ALIVE = 2
# So many triangles are kept expanded: they take about 130 bytes each. More are, too, unless all
# blocks of rows together are near to at most so many times as many
KEPT_TRIANGLES = 1 << 20
TIMES = 2.0


class ChunkedShapes:
    """The shapes on a large lattice: triangles are expanded near what is asked for, each time.

    Args:
        reach: how far from cells' centres shapes are listed [m].
    """

    def __init__(self, shapes: Shapes, lattice: Lattice, reach: float) -> None:
        self.lattice = lattice
        self._shapes = shapes
        self._reach = reach
        nothing = shapes.meshes.only(np.zeros(len(shapes.meshes.geom), dtype=np.bool_))
        self._solids = tile_shapes(shapes, lattice, reach, nothing.expand())

    def near_rows(self, rows: RowChunk) -> TiledShapes:
        """Shapes with all that are near some rows of whole bands."""
        y = self.lattice.y_max
        size = self.lattice.cell_size
        boxes = self._shapes.meshes.boxes
        far = self._reach + size
        is_near = boxes[:, 4] >= y - rows.end * size - far
        return self._expand(is_near & (boxes[:, 1] <= y - rows.first * size + far))

    def near_cells(self, cells: Int) -> TiledShapes:
        """Shapes with all that are near some cells."""
        lattice = self.lattice
        boxes = self._shapes.meshes.boxes
        start, item = list_by_tile(boxes, self._reach, lattice)
        asked = np.zeros(len(start) - 1, dtype=np.bool_)
        asked[tile_of(lattice, cells)] = True
        is_near = np.zeros(len(boxes), dtype=np.bool_)
        is_near[item[np.repeat(asked, np.diff(start))]] = True
        return self._expand(is_near)

    def _expand(self, chosen: Bool) -> TiledShapes:
        facets = self._shapes.meshes.only(chosen).expand()
        start, item = list_by_tile(facets.bounds, self._reach, self.lattice)
        tiles = self._solids.tile_index._replace(triangle_start=start, triangle_item=item)
        return TiledShapes(self._shapes, self.lattice, facets, tiles)


def make_shape_source(shapes: Shapes, lattice: Lattice, reach: float) -> ShapeSource:
    """List the shapes on a lattice: all, or if they are many, those near what is asked for later.

    All are expanded, too, where the columns of all cells are kept, or if most of them are near
    several blocks of rows.

    Args:
        reach: how far from cells' centres [m].
    """
    counts = shapes.meshes.counts
    boxes = shapes.meshes.boxes
    height = split_into_row_chunks(lattice, ALIVE)[0].end * lattice.cell_size
    near = counts * (1.0 + (boxes[:, 4] - boxes[:, 1] + 2 * reach) / height)
    is_large = lattice.width * lattice.height > KEPT_CELLS and counts.sum() > KEPT_TRIANGLES
    if is_large and near.sum() <= TIMES * counts.sum():
        return ChunkedShapes(shapes, lattice, reach)
    return tile_shapes(shapes, lattice, reach)


class ColumnCaster:
    """The columns of a lattice: kept where they are few, else cast again for whoever asks.

    It is all the same to who asks.

    Args:
        clock: times the casting.
    """

    def __init__(
        self, shapes: ShapeSource, agent: AgentSettings, crack: float, clock: StageClock
    ) -> None:
        self.lattice = shapes.lattice
        self._shapes = shapes
        self._agent = agent
        self._crack = crack
        self._clock = clock
        self._kept: Columns | None = None
        self._some: tuple[Int, Columns] | None = None  # the cells that were asked for last
        with clock.stage("columns"):
            if self.lattice.width * self.lattice.height <= KEPT_CELLS:
                self._kept = self._find_all()

    def row_chunks(self) -> Iterator[Columns]:
        """The columns of all rows, by bands of them, in their order.

        The next ones are found on another thread while the caller looks at those before them.
        The clock has only the time that the caller waits.
        """
        if self._kept is not None:
            yield self._kept
            return
        bands = self._bands()
        coming = run_beside(self._find, bands[0])
        for rows in [*bands[1:], None]:
            found = [self._wait(coming)]
            if rows is not None:
                coming = run_beside(self._find, rows)
            yield found.pop()  # nothing here holds it while the caller waits for the next one
        give_back_memory()  # of pieces between what lasts

    def _bands(self) -> list[RowChunk]:
        return split_into_row_chunks(self.lattice, ALIVE)

    def _wait(self, found: Callable[[], Columns]) -> Columns:
        with self._clock.part("columns"):
            return found()

    def covering(self, cells: Int | Int32) -> Columns:
        """Columns in which those of some cells are known, whatever the order of their ids."""
        if self._kept is not None:
            return self._kept
        if self._some is None or not np.isin(cells, self._some[0]).all():
            asked = unique_cells(self.lattice, cells)
            with self._clock.part("columns"):
                self._some = asked, cast_cells(self._shapes, self._agent, self._crack, asked)
        return self._some[1]

    def _find(self, rows: RowChunk) -> Columns:
        tiled = self._shapes.near_rows(rows)
        columns = self._close(cast_columns(tiled, rows).select_rows(rows), tiled)
        return replace(columns, nearby_shapes=tiled)

    def _find_all(self) -> Columns:
        """The columns of all cells, found band by band for the memory that it takes."""
        bands = split_into_row_chunks(self.lattice)
        if len(bands) == 1:
            tiled = self._shapes.near_rows(bands[0])
            return self._close(cast_columns(tiled), tiled)
        gathered = GatheredColumns(self.lattice)
        for rows in bands:
            gathered.add(self._find(rows), rows)
        return gathered.join()

    def _close(self, columns: Columns, tiled: TiledShapes) -> Columns:
        columns = resolve_seams(columns, tiled)
        return close_cracks(columns, tiled, self._agent, self._crack)


def join_columns(source: ColumnSource, window: Window, lattice: Lattice) -> Columns:
    """The columns of a window of a lattice together, whose own lattice is given."""
    gathered = GatheredColumns(lattice)
    is_whole = lattice == source.lattice
    for columns in source.row_chunks():
        if is_whole and columns.rows is None:
            return columns
        part = columns if is_whole else columns.crop(*window, lattice)
        gathered.add(part, part.valid_rows)
    return gathered.join()


class WindowColumns(NamedTuple):
    """The columns of a window of another lattice, with a lattice of its own; a `ColumnSource`."""

    source: ColumnSource
    window: Window
    lattice: Lattice

    def row_chunks(self) -> Iterator[Columns]:
        """All columns, in one block."""
        yield join_columns(self.source, self.window, self.lattice)

    def covering(self, cells: Int | Int32) -> Columns:
        """Columns in which those of some cells are known, whatever the order of their ids."""
        asked = unique_cells(self.lattice, cells)
        whole = self.outer(asked)
        return index_by_cell(
            self.lattice, asked, select_columns(self.source.covering(whole).hits, whole)
        )

    def outer(self, cells: Int) -> Int:
        """The ids that cells of the window have on the lattice that it is cut from."""
        row, col = np.divmod(cells, self.lattice.width)
        rows, cols = self.window
        found: Int = (row + rows.start) * self.source.lattice.width + col + cols.start
        return found


def unique_cells(lattice: Lattice, cells: Int | Int32) -> Int:
    """The ids of some cells, ascending, each once."""
    mask = np.zeros(lattice.width * lattice.height, dtype=np.bool_)
    mask[cells] = True
    return np.flatnonzero(mask)


def cast_cells(shapes: ShapeSource, agent: AgentSettings, crack: float, cells: Int) -> Columns:
    """Cast the columns of some cells, ascending; others mean nothing."""
    tiled = shapes.near_cells(cells)
    lattice = shapes.lattice
    found = cast_points(tiled, cells, lattice.positions(*np.divmod(cells, lattice.width)))
    columns = index_by_cell(lattice, cells, found)
    columns = resolve_seams(columns, tiled, cells)
    is_asked = np.zeros(len(columns.start) - 1, dtype=np.bool_)
    is_asked[cells] = True
    return close_cracks(columns, tiled, agent, crack, is_asked)


def index_by_cell(lattice: Lattice, cells: Int, hits: ColumnHits) -> Columns:
    """Turn hits listed per cell in `cells` (ascending ids) into columns indexed by cell id."""
    start = np.zeros(lattice.width * lattice.height + 1, dtype=np.int64)
    start[cells] = hits.start[:-1]
    start[cells + 1] = hits.start[1:]
    rows = (0, 0) if not len(cells) else (cells[[0, -1]] // lattice.width).tolist()
    asked = RowChunk(rows[0] // TILE * TILE, min(rows[1] // TILE * TILE + TILE, lattice.height))
    return Columns(lattice, hits._replace(start=start), asked)
