"""NamedTuples of arrays and numbers, as kernels take them.

numba passes a named tuple to a kernel as one argument, at no cost in the kernel's loops. It gives a
literal number a type of its own, and would compile the called function again for it; therefore some
calls have ``np.int64(...)``.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.types import Float, Int, Int32

NOT_ROUND = np.bool_(False)
"""`Prism.is_round` of a square prism; for a plain False, numba would compile kernels once more."""


class ColumnHits(NamedTuple):
    """All hits of all columns: column i has the hits ``start[i]:start[i + 1]`` of the arrays.

    A column is a vertical line, usually through a cell's centre; a hit is one crossing of the line
    with a surface.

    Attributes:
        start: index of each column's first hit, then the number of hits, (columns + 1,) int64.
        z: heights, ascending in a column, (n,) float64 [m].
        normal: unit normals of the surfaces, (n, 3) float32; z > 0 faces up.
        geom: MuJoCo's geom ids, (n,) int32.
        closed: the kind of surface, by what it encloses: OPEN_SURFACE, CLOSED_SURFACE, SOLID or
            CONVEX_SOLID, see `constants`, (n,) uint8.
    """

    start: Int
    z: Float
    normal: NDArray[np.float32]
    geom: Int32
    closed: NDArray[np.uint8]

    @property
    def entries(self) -> tuple[NDArray[Any], ...]:
        """Return the arrays with one entry for each hit: all except `start`."""
        return self[1:]


class Solids(NamedTuple):
    """Convex primitives: spheres, capsules, ellipsoids, cylinders and boxes, in the world frame.

    Attributes:
        geom: MuJoCo's geom ids, (n,) int32.
        kind: MuJoCo's geom types, see `constants`, (n,) int32.
        pos: centres, (n, 3) float64 [m].
        mat: rotation matrices, row-major, (n, 9) float64.
        size: MuJoCo's sizes, (n, 3) float64 [m].
        bounds: exact boxes around them, (n, 6) float64: lower corner, upper corner [m].
    """

    geom: Int32
    kind: Int32
    pos: Float
    mat: Float
    size: Float
    bounds: Float


class Planes(NamedTuple):
    """Infinite planes: half-spaces, solid behind their normal, in the world frame.

    Attributes:
        geom: MuJoCo's geom ids, (n,) int32.
        pos: a point of each plane, (n, 3) float64 [m].
        mat: rotation matrices, row-major, (n, 9) float64; the third column is the normal.
    """

    geom: Int32
    pos: Float
    mat: Float

    @property
    def normal(self) -> Float:
        """Unit normals, shape (n, 3), float64."""
        return np.ascontiguousarray(self.mat[:, [2, 5, 8]])


class Facets(NamedTuple):
    """Triangles of geoms, in the world frame.

    Attributes:
        vertices: points that triangles may share, (n, 3) float64 [m].
        faces: indices of each triangle's vertices, (m, 3) int32.
        geom: MuJoCo's geom ids, ascending, (m,) int32.
        part: the number of the part of the geom's mesh that each triangle belongs to, (m,) int32.
        closed: the kind of surface that the part has, by what it encloses: from OPEN_SURFACE to
            CONVEX_SOLID, see `constants`, (m,) uint8.
    """

    vertices: Float
    faces: Int32
    geom: Int32
    part: Int32
    closed: NDArray[np.uint8]

    @property
    def corners(self) -> Float:
        """Return a copy of the triangles' corners, shape (m, 3, 3), float64 [m]."""
        return self.vertices[self.faces]


class ShapeIndex(NamedTuple):
    """The solids and triangles over each bin of a lattice, see `list_boxes_by_tile`.

    The bins are either tiles or rows of tiles. A tile's bin lists the shapes that reach into the
    tile; the bin of a row of tiles lists the shapes that cover a cell's centre there. Bin b lists
    the solids ``solid_indices[solid_start[b] : solid_start[b + 1]]``, ascending, and the triangles
    ``triangle_indices[triangle_start[b] : triangle_start[b + 1]]``, ascending.

    Attributes:
        solid_start: where each bin's solids begin in `solid_indices`, (bins + 1,) int64.
        solid_indices: indices into `Solids`, (n,) int32.
        triangle_start: where each bin's triangles begin in `triangle_indices`, (bins + 1,) int64.
        triangle_indices: indices into `Facets`, (m,) int32.
    """

    solid_start: Int
    solid_indices: Int32
    triangle_start: Int
    triangle_indices: Int32


class HeightRange(NamedTuple):
    """A range of heights, from `low` to `high` [m].

    Attributes:
        low: the lower end [m].
        high: the upper end [m].
    """

    low: float
    high: float


class Prism(NamedTuple):
    """A square or a disc around (x, y), extruded between two heights.

    Attributes:
        x, y: its axis, world frame [m].
        low, high: heights of its bottom and top [m].
        half_width: half the length of the square's edge, or the disc's radius [m].
        is_round: whether it is a disc.
    """

    x: float
    y: float
    low: float
    high: float
    half_width: float
    is_round: bool | np.bool_
