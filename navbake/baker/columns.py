"""Columns: every crossing of every cell's vertical line with the scene."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.arrays import Band, BandItems, Crossings, Facets, Tiles
from navbake.baker.kernels.hits import RIM, close_up
from navbake.baker.kernels.rays import cast_lines, cast_points_at, load_mujoco_library
from navbake.baker.kernels.tiles import BAND, tile_of
from navbake.baker.listing import list_by_band, list_by_tile
from navbake.baker.scene.kernels.triangles import measure_boxes
from navbake.baker.scene.model import mujoco_library
from navbake.baker.scene.shapes import Shapes, Triangles
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Float, Int, Int32


@dataclass(frozen=True)
class TiledShapes:
    """Shapes on a lattice, listed by the tiles of cells that they lie over."""

    shapes: Shapes
    lattice: Lattice
    facets: Facets
    tiles: Tiles

    @cached_property
    def heights(self) -> Band:
        """Heights below and above everything over the lattice [m]."""
        return _height_range(self.shapes, self.lattice)


@dataclass(frozen=True)
class Columns:
    """All surfaces of all columns, ragged: cell i holds ``[start[i], start[i + 1])``.

    Attributes:
        lattice: the cells.
        crossings: the surfaces, as kernels take them; the others are parts of it.
        start: shape (cells + 1,), int64.
        z: heights, ascending in a column, shape (n,), float64 [m].
        normal: unit normals, shape (n, 3), float32; z > 0 faces up.
        geom: MuJoCo's geom ids, shape (n,), int32.
    """

    lattice: Lattice
    crossings: Crossings

    @property
    def start(self) -> Int:
        return self.crossings.start

    @property
    def z(self) -> Float:
        return self.crossings.z

    @property
    def normal(self) -> NDArray[np.float32]:
        return self.crossings.normal

    @property
    def geom(self) -> Int32:
        return self.crossings.geom

    def cut(self, rows: slice, cols: slice, lattice: Lattice) -> "Columns":
        """The columns of a window; `lattice` is its own, with cells in the same places."""
        cells = np.arange(len(self.start) - 1).reshape(self.lattice.shape)[rows, cols].ravel()
        first, counts = self.start[cells], np.diff(self.start)[cells]
        start = np.concatenate([[0], np.cumsum(counts)])
        taken = np.repeat(first - start[:-1], counts) + np.arange(start[-1])
        return Columns(lattice, Crossings(start, *(part[taken] for part in self.crossings[1:])))


def cells_of(start: Int) -> Int:
    """The cell of each item of ragged data, from the first item of each cell, (cells + 1,)."""
    cell: Int = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return cell


def tile_shapes(shapes: Shapes, lattice: Lattice, reach: float) -> TiledShapes:
    """List the shapes by tiles; `reach` is how far beyond its centre a cell looks for them [m]."""
    facets = _facets_of(shapes.triangles)
    solids = list_by_tile(shapes.solids.bounds, reach, lattice)
    triangles = list_by_tile(facets.bounds, reach, lattice)
    return TiledShapes(shapes, lattice, facets, Tiles(*solids, *triangles))


def cast_columns(tiled: TiledShapes) -> Columns:
    """Cross the vertical line through every cell's centre with all geometry.

    Rays against solids and infinite planes are MuJoCo's own. Each solid is crossed twice, from
    above and from below; planes from their front only. Lines within 1e-7 m of a rim cross it,
    so that a seam between two geoms never leaks.
    """
    lattice, shapes, facets = tiled.lattice, tiled.shapes, tiled.facets
    load_mujoco_library(mujoco_library())
    triangles = list_by_band(facets.bounds, RIM, lattice)
    is_crossed = np.empty(len(triangles[1]), dtype=np.bool_)
    items = BandItems(*list_by_band(shapes.solids.bounds, RIM, lattice), *triangles, is_crossed)
    geometry = (lattice, shapes.solids, facets, shapes.planes, items, tiled.heights)
    start = np.zeros(lattice.width * lattice.height + 1, dtype=np.int64)
    dropped = np.zeros(-(-lattice.height // BAND), dtype=np.int64)
    # without room for them, the crossings are only counted
    run_in_bands(cast_lines, len(dropped), *geometry, _empty_crossings(start, 0), dropped)
    np.cumsum(start, out=start)
    crossings = _empty_crossings(start, int(start[-1]))
    if len(crossings.z):
        run_in_bands(cast_lines, len(dropped), *geometry, crossings, dropped)
    if dropped.any():
        count = close_up(crossings)
        crossings = Crossings._make([start, *(array[:count] for array in crossings[1:])])
    return Columns(lattice, crossings)


def cast_points(tiled: TiledShapes, cells: Int, points: Float) -> Crossings:
    """Cross vertical lines that lie in or near cells, as `cast_columns` does; one column a line.

    Args:
        cells: the cell that each line is near to, by at most the reach of `tile_shapes`.
        points: x and y of each line, shape (n, 2), world frame [m].
    """
    shapes, heights = tiled.shapes, tiled.heights
    load_mujoco_library(mujoco_library())
    lines = points, tile_of(tiled.lattice, cells)
    geometry = (shapes.solids, tiled.facets, shapes.planes, tiled.tiles, heights)
    start = np.zeros(len(points) + 1, dtype=np.int64)
    cast_points_at(*lines, *geometry, _empty_crossings(start, 0))
    np.cumsum(start, out=start)
    crossings = _empty_crossings(start, int(start[-1]))
    if len(crossings.z):
        cast_points_at(*lines, *geometry, crossings)
    return crossings


def _empty_crossings(start: Int, count: int) -> Crossings:
    z, normal = np.empty(count), np.empty((count, 3), dtype=np.float32)
    geom, closed = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.uint8)
    return Crossings(start, z, normal, geom, closed)


def _facets_of(triangles: Triangles) -> Facets:
    bounds = np.empty((len(triangles.geom), 6))
    run_in_bands(measure_boxes, len(bounds), triangles.corners, bounds, least=4096)
    return Facets(*triangles, bounds)


def _height_range(shapes: Shapes, lattice: Lattice) -> Band:
    """Heights below and above everything over the lattice, infinite planes included [m]."""
    bounds = shapes.bounds()
    heights = [0.0] if bounds is None else [float(bounds[0, 2]), float(bounds[1, 2])]
    x0, y0, x1, y1 = lattice.bounds
    corners = np.array([[x0, y0], [x0, y1], [x1, y0], [x1, y1]])
    for pos, normal in zip(shapes.planes.pos, shapes.planes.normal, strict=True):
        if abs(normal[2]) > 1e-6:
            heights.extend(pos[2] - (corners - pos[:2]) @ normal[:2] / normal[2])
    return Band(float(min(heights)) - 1.0, float(max(heights)) + 1.0)
