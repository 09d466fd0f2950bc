"""NamedTuples of arrays and numbers, as kernels take them.

numba passes a named tuple to a kernel whole, at no cost in its loops. A literal has a type of its
own, for which a function is compiled once more, hence ``np.int64(...)`` here and there.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.types import Float, Int, Int32

SQUARE: Any = np.bool_(False)
"""`Prism.is_round` of a square; a plain False would be compiled for once more."""


class ColumnHits(NamedTuple):
    """All hits of all columns, ragged: cell i holds ``[start[i], start[i + 1])``.

    Attributes:
        start: (cells + 1,) int64.
        z: heights, ascending in a column, (n,) float64 [m].
        normal: unit normals, (n, 3) float32; z > 0 faces up.
        geom: MuJoCo's geom ids, (n,) int32.
        closed: what the crossed surface encloses, see `constants`, (n,) uint8.
    """

    start: Int
    z: Float
    normal: NDArray[np.float32]
    geom: Int32
    closed: NDArray[np.uint8]


class Facets(NamedTuple):
    """Triangles, by geom.

    Attributes:
        geom: MuJoCo's geom ids, ascending, (m,) int32.
        part: the geom's part that each belongs to, (m,) int32.
        closed: what that part encloses, see `constants`, (m,) uint8.
        corners: (m, 3, 3) float64 [m].
        bounds: boxes round them, (m, 6) float64: lower corner, upper corner [m].
        facing: hundredths of their unit normals' z, rounded; 0 of upright ones alone, (m,) int8.
    """

    geom: Int32
    part: Int32
    closed: NDArray[np.uint8]
    corners: Float
    bounds: Float
    facing: NDArray[np.int8]


class Tiles(NamedTuple):
    """Which solids and triangles lie over which tile of cells, ascending, see `list_boxes`.

    Tile t holds ``solid_item[solid_start[t] : solid_start[t + 1]]``; so with the triangles. Or so
    with bands of rows, of what lies over centres of their cells.
    """

    solid_start: Int
    solid_item: Int32
    triangle_start: Int
    triangle_item: Int32


class Band(NamedTuple):
    """Two heights [m]."""

    low: float
    high: float


class Prism(NamedTuple):
    """A square or a disc round (x, y), extruded between two heights [m].

    Attributes:
        x, y: the middle.
        low, high: the heights.
        half: half of the square's edge, or the disc's radius.
        is_round: whether it is a disc.
    """

    x: float
    y: float
    low: float
    high: float
    half: float
    is_round: bool
