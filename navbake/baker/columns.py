"""Columns: every crossing of every cell's vertical line with the scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.rays import cast_lines, load_mujoco_library
from navbake.baker.kernels.tiles import bin_boxes
from navbake.baker.scene.scene import mujoco_library
from navbake.baker.scene.shapes import Planes, Shapes
from navbake.navgrid.lattice import Lattice


@dataclass(frozen=True)
class TiledShapes:
    """Shapes on a lattice, listed by the tiles of cells that they lie over.

    Attributes:
        shapes: the geometry.
        lattice: the cells.
        solid_start, solid_item: the tiles' lists of solids, see `bin_boxes`.
        triangle_start, triangle_item: the tiles' lists of triangles.
        triangle_normal: unit normals, shape (m, 3), float64; 0 for upright triangles' z.
        triangle_bounds: boxes round the triangles, shape (m, 6), float64 [m].
    """

    shapes: Shapes
    lattice: Lattice
    solid_start: NDArray[np.int64]
    solid_item: NDArray[np.int32]
    triangle_start: NDArray[np.int64]
    triangle_item: NDArray[np.int32]
    triangle_normal: NDArray[np.float64]
    triangle_bounds: NDArray[np.float64]


@dataclass(frozen=True)
class Columns:
    """All surfaces of all columns, ragged: cell i holds ``[start[i], start[i + 1])``.

    Attributes:
        lattice: the cells.
        start: shape (cells + 1,), int64.
        z: heights, ascending in a column, shape (n,), float64 [m].
        normal: unit normals, shape (n, 3), float32; z > 0 faces up.
        geom: MuJoCo's geom ids, shape (n,), int32.
    """

    lattice: Lattice
    start: NDArray[np.int64]
    z: NDArray[np.float64]
    normal: NDArray[np.float32]
    geom: NDArray[np.int32]


def tile_shapes(shapes: Shapes, lattice: Lattice, reach: float) -> TiledShapes:
    """List the shapes by tiles.

    Args:
        shapes: the geometry.
        lattice: the cells.
        reach: how far beyond its centre a cell looks for geometry [m].
    """
    place = (lattice.x_min, lattice.y_max, lattice.cell_size, lattice.width, lattice.height)
    bounds = shapes.triangles.bounds
    solid_start, solid_item = bin_boxes(shapes.solids.bounds, reach, *place)
    triangle_start, triangle_item = bin_boxes(bounds, reach, *place)
    return TiledShapes(
        shapes=shapes,
        lattice=lattice,
        solid_start=solid_start,
        solid_item=solid_item,
        triangle_start=triangle_start,
        triangle_item=triangle_item,
        triangle_normal=_unit_normals(shapes.triangles.corners),
        triangle_bounds=bounds,
    )


def cast_columns(tiled: TiledShapes) -> Columns:
    """Cross the vertical line through every cell's centre with all geometry.

    Solids and infinite planes answer to MuJoCo's own rays. Each solid is crossed twice, from
    above and from below; planes from their front only. Lines within 1e-7 m of a rim cross it,
    so that a seam between two geoms never leaks.

    Args:
        tiled: the geometry on its lattice.

    Returns:
        The columns; the same whatever the number of threads.
    """
    lattice, shapes = tiled.lattice, tiled.shapes
    solids, planes, triangles = shapes.solids, shapes.planes, shapes.triangles
    load_mujoco_library(mujoco_library())
    z_low, z_high = _height_range(shapes, planes, lattice)
    arguments = (
        lattice.x_min,
        lattice.y_max,
        lattice.cell_size,
        lattice.width,
        lattice.height,
        z_low,
        z_high,
        tiled.solid_start,
        tiled.solid_item,
        solids.geom,
        solids.kind,
        solids.pos,
        solids.mat,
        solids.size,
        solids.bounds,
        tiled.triangle_start,
        tiled.triangle_item,
        triangles.geom,
        triangles.corners,
        tiled.triangle_normal,
        tiled.triangle_bounds,
        planes.geom,
        planes.pos,
        planes.mat,
    )
    start = np.zeros(lattice.width * lattice.height + 1, dtype=np.int64)
    cast_lines(*arguments, start, *_empty_crossings(0))
    np.cumsum(start, out=start)
    z, normal, geom = _empty_crossings(int(start[-1]))
    if len(z):
        cast_lines(*arguments, start, z, normal, geom)
    return Columns(lattice=lattice, start=start, z=z, normal=normal, geom=geom)


def _empty_crossings(
    count: int,
) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.int32]]:
    return (
        np.empty(count, dtype=np.float64),
        np.empty((count, 3), dtype=np.float32),
        np.empty(count, dtype=np.int32),
    )


def _unit_normals(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    normal: NDArray[np.float64] = np.divide(
        cross, length, out=np.zeros_like(cross), where=length > 0
    )
    normal[np.abs(normal[:, 2]) < 1e-9, 2] = 0.0
    return np.ascontiguousarray(normal)


def _height_range(shapes: Shapes, planes: Planes, lattice: Lattice) -> tuple[float, float]:
    """Heights below and above everything over the lattice, infinite planes included [m]."""
    bounds = shapes.bounds()
    heights = [0.0] if bounds is None else [float(bounds[0, 2]), float(bounds[1, 2])]
    x0, y0, x1, y1 = lattice.bounds
    corners = np.array([[x0, y0], [x0, y1], [x1, y0], [x1, y1]])
    for pos, normal in zip(planes.pos, planes.normal, strict=True):
        if abs(normal[2]) > 1e-6:
            heights.extend(pos[2] - (corners - pos[:2]) @ normal[:2] / normal[2])
    return min(heights) - 1.0, max(heights) + 1.0
