"""The columns of a scene in which things move: only those near what moved are cast again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.columns import (
    Columns,
    TiledShapes,
    cast_points,
    empty_crossings,
    tile_shapes,
)
from navbake.baker.cracks import close_cracks
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.kernels.arrays import Band, Crossings
from navbake.baker.kernels.hits import RIM
from navbake.baker.kernels.tiles import TILE, tile_of
from navbake.baker.scene.shapes import Shapes, Solids, Triangles
from navbake.baker.update.full_bake import FullBake
from navbake.baker.update.kernels import pool as kernels
from navbake.baker.update.kernels.pool import Pool
from navbake.baker.update.kernels.regions import (
    are_in,
    cells_of_boxes,
    near_tiles,
)
from navbake.config.settings import BakeConfig
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Float, Int, Int32

# A line this far beyond a box [cells], more than rounding can be, does not meet what is in it
SPARE = 1e-3
# A pool has so much room more than it needs at first
ROOM = 1.25
# So many cells are worth a call on another thread
LEAST_CELLS = 4096


class Scratch:
    """Arrays over all cells that are as new after each use, so that none costs a pass over them."""

    def __init__(self, lattice: Lattice) -> None:
        cells = lattice.width * lattice.height
        self.start = np.zeros(cells + 1, dtype=np.int64)  # means something where it was written
        self.slot = np.zeros(cells + 1, dtype=np.int64)  # so does this
        self.count = np.zeros(cells, dtype=np.int64)  # and this
        self.local = np.full(cells, -1, dtype=np.int32)
        self.flag = np.zeros(cells, dtype=np.bool_)
        self.floor = np.full(cells, np.nan)
        self.ceiling = np.full(cells, np.nan)


class Region(NamedTuple):
    """The columns of some cells.

    Attributes:
        cells: ids, ascending, shape (n,), int64.
        columns: numbered as the cells are.
    """

    cells: Int
    columns: Crossings

    def number(self, cells: Int) -> Int:
        """The numbers of some of the region's cells, ascending."""
        return np.flatnonzero(are_in(self.cells, cells))

    def only(self, cells: Int) -> Region:
        """A part of the region."""
        start, number = self.columns.start, self.number(cells)
        at = start[number]
        return Region(cells, _copy_columns(start[number + 1] - at, Source(self.columns, at)))

    def by_id(self, scratch: Scratch) -> Crossings:
        """The columns by cell id; the last such is the only one that holds."""
        kernels.point_at(self.cells, self.columns.start, scratch.start)
        return self.columns._replace(start=scratch.start)


class Source(NamedTuple):
    """Where columns are copied from, and the place of each there, -1 for those that it has not."""

    columns: Pool | Crossings
    at: Int


def _copy_columns(length: Int | Int32, *sources: Source) -> Crossings:
    """Columns of some lengths, each from one of the sources."""
    start = np.zeros(len(length) + 1, dtype=np.int64)
    np.cumsum(length, out=start[1:])
    columns = empty_crossings(start, int(start[-1]))
    for source in sources:
        work = kernels.copy_columns, len(length), *source, columns
        run_in_bands(*work, least=LEAST_CELLS)
    return columns


class Boxed(NamedTuple):
    """Triangles' corners, shape (n, 3, 3), and their boxes, (n, 6) [m]."""

    corners: Float
    boxes: Float


class LiveColumns:
    """The columns of all cells, of which some can be replaced.

    Args:
        columns: of all cells.
    """

    def __init__(self, config: BakeConfig, columns: Columns) -> None:
        self.lattice, self.scratch = columns.lattice, Scratch(columns.lattice)
        self._crack, self._agent = config.floors.crack, config.agent
        self._limits = agent_limits(config.agent)
        self._known: Boxed | None = None
        self._fill(columns.crossings, 0)

    def _fill(self, crossings: Crossings, more: int) -> None:
        """Make the pool of columns, with room for `more` crossings at least."""
        count = np.diff(crossings.start).astype(np.int32)
        self.used = len(crossings.z)
        room = int((self.used + more) * ROOM) + 10_000

        def widen(array: Any) -> Any:
            wide = np.empty((room, *array.shape[1:]), dtype=array.dtype)
            wide[: self.used] = array
            return wide

        _, z, normal, geom, closed = crossings
        layers = widen(z), widen(normal), widen(geom), widen(closed)
        self.pool = Pool(crossings.start[:-1].copy(), count, count.copy(), *layers)

    def gather(self, cells: Int) -> Region:
        """The columns of some cells, ascending."""
        pool = self.pool
        return Region(cells, _copy_columns(pool.length[cells], Source(pool, pool.first[cells])))

    def all(self) -> Columns:
        """The columns of all cells."""
        return Columns(self.lattice, self.gather(np.arange(len(self.pool.first))).columns)

    def blocks(self) -> Iterator[Columns]:
        """The columns of all cells, in one block."""
        yield self.all()

    def at(self, cells: Int | Int32) -> Columns:
        """Columns in which those of some cells are known."""
        region = self.gather(np.unique(cells).astype(np.int64))
        start = np.zeros(len(self.pool.first) + 1, dtype=np.int64)
        kernels.point_at(region.cells, region.columns.start, start)
        return Columns(self.lattice, region.columns._replace(start=start))

    def near(self, shapes: Shapes, cells: Int, reach: float, heights: Band) -> TiledShapes:
        """The part of the geometry that is near some cells, listed by tiles; all planes.

        Args:
            reach: how far beyond its centre a cell looks for geometry [m].
            heights: below and above all geometry [m].
        """
        lattice, solids, triangles = self.lattice, shapes.solids, shapes.triangles
        summed = np.zeros((-(-lattice.height // TILE) + 1, -(-lattice.width // TILE) + 1), np.int64)
        rows, cols = np.divmod(tile_of(lattice, cells), summed.shape[1] - 1)
        summed[rows + 1, cols + 1] = 1
        np.cumsum(summed, axis=0, out=summed)
        np.cumsum(summed, axis=1, out=summed)
        masks = []
        for boxes in (solids.bounds, self._boxes_of(triangles)):
            masks.append(np.empty(len(boxes), dtype=np.bool_))
            near_tiles(boxes, reach, lattice, TILE, summed, masks[-1])
        of_solids, of_triangles = map(np.flatnonzero, masks)
        part = replace(
            shapes,
            solids=Solids._make(array[of_solids] for array in solids),
            triangles=Triangles._make(array[of_triangles] for array in triangles),
        )
        tiled = tile_shapes(part, lattice, reach)
        tiled.__dict__["heights"] = heights
        return tiled

    def _boxes_of(self, triangles: Triangles) -> Float:
        """Boxes round triangles; only those of other corners than the last time are new."""
        corners, known = triangles.corners, self._known
        if known is None or len(known.corners) != len(corners):
            self._known = known = Boxed(corners, _boxes(corners))
        elif known.corners is not corners:
            rows = np.flatnonzero((known.corners != corners).any(axis=(1, 2)))
            known.boxes[rows] = _boxes(corners[rows])
            self._known = known = Boxed(corners, known.boxes)
        return known.boxes

    def asked(self, boxes: Float) -> Int:
        """The cells whose columns may be others when the geometry in boxes is, (n, 6) [m]."""
        reach = max(self._crack, RIM)
        cells: Int = cells_of_boxes(self.lattice, boxes, reach, SPARE, self.scratch.flag)
        return cells

    def cast(self, tiled: TiledShapes, asked: Int) -> Region:
        """Cast the columns of some cells again; gives those that are others now.

        Args:
            tiled: what there is now near them.
        """
        centers = self.lattice.positions(*np.divmod(asked, self.lattice.width))
        found = Region(asked, cast_points(tiled, asked, centers))
        if self._crack > 0:
            found = self._close_cracks(found, tiled)
        is_new = np.empty(len(found.cells), dtype=np.bool_)
        work = kernels.differs, len(is_new), self.pool, *found, is_new
        run_in_bands(*work, least=LEAST_CELLS)
        return found.only(found.cells[is_new])

    def _close_cracks(self, region: Region, tiled: TiledShapes) -> Region:
        """`close_cracks` in a region."""
        is_asked = np.zeros(self.lattice.width * self.lattice.height, dtype=np.bool_)
        is_asked[region.cells] = True
        columns = Columns(self.lattice, region.by_id(self.scratch))
        closed = close_cracks(columns, tiled, self._agent, self._crack, is_asked)
        if closed is columns:
            return region
        first, last = closed.start[region.cells], closed.start[region.cells + 1]
        return Region(region.cells, _copy_columns(last - first, Source(closed.crossings, first)))

    def check_planes(self, shapes: Shapes, old: Band, new: Band) -> None:
        """FullBake where level planes are crossed at other heights by lines that begin elsewhere.

        They are so by rounding alone, as `heights` of all geometry changes.
        """
        planes = shapes.only(np.isin(np.arange(len(shapes.endless)), shapes.planes.geom))
        cell = np.zeros(1, dtype=np.int64)
        center = self.lattice.positions([0], [0])

        def cast(heights: Band) -> Float:
            tiled = tile_shapes(planes, self.lattice, 0.0)
            tiled.__dict__["heights"] = heights
            return cast_points(tiled, cell, center).z

        if not np.array_equal(cast(old), cast(new)):
            raise FullBake("lines cross a plane at another height, by rounding")

    def put(self, region: Region) -> None:
        """Replace columns."""
        if self.used + len(region.columns.z) > len(self.pool.z):
            kept = self.gather(np.arange(len(self.pool.first))).columns
            self._fill(kept, len(region.columns.z))
        self.used = kernels.put(self.pool, *region, self.used)


def _boxes(corners: Float) -> Float:
    return np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
