"""Arrays and numbers that belong together, as kernels take them.

numba passes a named tuple to a kernel whole, at no cost in its loops. A literal is a type of its
own, and would compile all that takes it twice, hence ``np.int64(...)`` here and there.
Kernels also take tuples that only callers make: `Lattice`, `Solids`, `Planes`, `Footprint` and
others.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.types import Bool, Float, Int, Int32


class Crossings(NamedTuple):
    """All crossings of all columns, ragged: cell i holds ``[start[i], start[i + 1])``.

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
    """Triangles with what kernels want to know of them at once.

    Attributes:
        geom: MuJoCo's geom ids, ascending, (m,) int32.
        part: the geom's part that each belongs to, (m,) int32.
        closed: what that part encloses, see `constants`, (m,) uint8.
        corners: (m, 3, 3) float64 [m].
        bounds: boxes round them, (m, 6) float64: lower corner, upper corner [m].
    """

    geom: Int32
    part: Int32
    closed: NDArray[np.uint8]
    corners: Float
    bounds: Float


class Tiles(NamedTuple):
    """Which solids and triangles lie over which tile of cells, ascending, see `list_boxes`.

    Tile t holds ``solid_item[solid_start[t] : solid_start[t + 1]]``; so with the triangles.
    """

    solid_start: Int
    solid_item: Int32
    triangle_start: Int
    triangle_item: Int32


class BandItems(NamedTuple):
    """Which solids and triangles lie over centres of which band of rows, see `list_boxes`.

    Band b holds ``solid_item[solid_start[b] : solid_start[b + 1]]``; so with the triangles.
    `is_crossed`, bool, is of the length of `triangle_item`: whether any line of the band crosses
    the triangle; while crossings are counted, it receives that.
    """

    solid_start: Int
    solid_item: Int32
    triangle_start: Int
    triangle_item: Int32
    is_crossed: Bool


class Band(NamedTuple):
    """Two heights [m]."""

    low: float
    high: float


class Probe(NamedTuple):
    """A band above the floor, and the geoms that are looked for in it.

    Attributes:
        low, high: distances above the floor [m].
        geoms: by geom id, bool.
    """

    low: float
    high: float
    geoms: Bool


class Prism(NamedTuple):
    """A square joined with a disc round (x, y), extruded between two heights [m].

    Attributes:
        x, y: the middle.
        low, high: the heights.
        square: half of the square's edge, 0 for none.
        radius: the disc's radius, 0 for none.
    """

    x: float
    y: float
    low: float
    high: float
    square: float
    radius: float


class Queries(NamedTuple):
    """Questions whether cells are occupied, and their answers.

    Attributes:
        cell: cell ids, ascending, (n,) int64.
        floor: floor heights, (n,) float64 [m].
        state: (n,) uint8, receives APART, MEETS or UNDECIDED.
        by_line: (n,) bool, receives whether the cell's line alone proved it.
    """

    cell: Int
    floor: Float
    state: NDArray[np.uint8]
    by_line: Bool


class StoreyCells(NamedTuple):
    """The cells of a storey, and the list of what stands in each.

    Attributes:
        floor, ceiling: (cells,) float64, NaN where there is no floor [m]; a ceiling is at least
            as high as the agent.
        occupied: (cells,) bool, see `check_cells`.
        slot: (cells + 1,) int64: cell i may write into ``[slot[i], slot[i + 1])``, see
            `count_candidates`.
        geom, flags: int32 and uint8 of length ``slot[-1]``, flags 0 at first; receive each
            cell's geoms, ascending, and what they meet, see `flags`.
    """

    floor: Float
    ceiling: Float
    occupied: Bool
    slot: Int
    geom: Int32
    flags: NDArray[np.uint8]


class AgentLimits(NamedTuple):
    """What an agent can stand and walk on.

    Attributes:
        min_up: cosine of the largest slope, less a slack.
        headroom: the agent's height [m].
        step: the largest step [m].
    """

    min_up: float
    headroom: float
    step: float
