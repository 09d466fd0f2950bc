"""The volumes over a cell's floor against which geoms are tested, and the tests.

Over the floor of a cell stand four upright prisms. A geom has a flag in the cell if it meets the
flag's prism. Heights are above the floor, and the highest step is the agent's ground clearance:

    OCCUPYING        the cell's square, from just above the floor to the level's ceiling
    BLOCKING         the agent's disc, or the cell's square if that is wider, from the highest step
                     to the agent's height
    AT_WALL_HEIGHT   the cell's square, at the heights where only walls are
    BLOCKING_SQUARE  the cell's square, from the highest step to the agent's height

A geom with BLOCKING_SQUARE gets BLOCKING, too: the agent's footprint is the disc and the square.

The geom meets a prism if the vertical line through the cell's centre hits the geom in the prism, or
runs inside of the geom there (`find_flags_on_line`), or if one of the geom's shapes meets the prism
(`shape_meets_prism`).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.arrays import NOT_ROUND, Facets, Planes, Prism, Solids
from navbake.baker.core.constants import APART, MEETS
from navbake.baker.core.tiles import cell_center_at
from navbake.baker.core.tolerances import SAME_HEIGHT, TOUCH_DEPTH
from navbake.baker.geometry.gjk_kernels import Simplex
from navbake.baker.geometry.overlap_kernels import (
    Polygons,
    facet_meets_prism,
    is_beside_prism,
    plane_meets_prism,
)
from navbake.baker.geometry.solid_kernels import solid_meets_prism
from navbake.baker.geometry.triangle_kernels import TriangleCopy
from navbake.compiled import NO_REFCOUNT, subkernel
from navbake.types import Bool, Float, Int, Int32

# Flags of a geom in a cell: a bit for each field of `Volumes`, in their order
OCCUPYING = 1
BLOCKING = 2
AT_WALL_HEIGHT = 4
BLOCKING_SQUARE = 8
# Because of rounding it is open whether the geom meets the prism of BLOCKING, or BLOCKING_SQUARE
MAYBE_BLOCKING = 16
MAYBE_BLOCKING_SQUARE = 32

# Kinds of shapes; if they were plain ints, numba would compile functions once for each kind
PLANE_KIND = np.int64(0)
SOLID_KIND = np.int64(1)
TRIANGLE_KIND = np.int64(2)

# How far beyond a prism shapes are searched for: surfaces that enclose nothing are tested against a
# prism that is a little wider, see `facet_meets_prism` [m]
SEARCH_MARGIN = 2.0 * TOUCH_DEPTH


class ShapeArrays(NamedTuple):
    """The shapes of all geoms: primitives, triangles and planes, each in the order of geom ids.

    Attributes:
        solids: the primitives.
        facets: the triangles.
        planes: the infinite planes.
    """

    solids: Solids
    facets: Facets
    planes: Planes


class Queries(NamedTuple):
    """The floors over which geoms are tested, and the flags of the geoms there; shape (n,) each.

    A query is one floor of a cell: the cell and the height of the floor. A flag is a bit that says
    that a geom meets one of the prisms over the floor.

    Attributes:
        cell: cell ids, ascending, int64.
        floor: height of the floor, ascending in each cell, float64 [m].
        highest_prism_z: receives the highest z of the prisms over this floor and the lower ones in
            its cell, float64 [m].
        flags: receives BLOCKING, BLOCKING_SQUARE, MAYBE_BLOCKING and MAYBE_BLOCKING_SQUARE if any
            geom has them, and BLOCKED_BY_LINE, uint8.
        tested_flags: the flags that the current geom is tested for, overwritten by each geom,
            uint8.
        geom_flags: the flags that the current geom has, overwritten by each geom, uint8.
    """

    cell: Int
    floor: Float
    highest_prism_z: Float
    flags: NDArray[np.uint8]
    tested_flags: NDArray[np.uint8]
    geom_flags: NDArray[np.uint8]


class OccupantLists(NamedTuple):
    """Settings for listing the geoms over each floor, and arrays that receive where lists begin.

    If only occupancy is wanted, all arrays are empty.

    Attributes:
        ceiling: for each query, the z up to which geoms count as occupants, at least the agent's
            height above the floor, (n,) float64 [m].
        list_start: receives, for each query, where its list begins, (n,) int32; see `check_tiles`.
        floor_geom: receives the id of the geom whose surface is the floor, -1 for none, (n,) int32.
        gap_below: receives how far below the floor the next surface of another geom lies, inf for
            none, (n,) float64 [m]. Surfaces that are too steep for a floor don't count.
        is_wall_candidate: for each geom id, whether AT_WALL_HEIGHT is tested, (ngeom,) bool.
        wall_low: height above the floor at which the prism of AT_WALL_HEIGHT begins [m].
        wall_high: height above the floor at which that prism ends [m].
        min_normal_z: least z of the unit normal of a surface that is a floor, in [0, 1].
    """

    ceiling: Float
    list_start: Int32
    floor_geom: Int32
    gap_below: Float
    is_wall_candidate: Bool
    wall_low: float
    wall_high: float
    min_normal_z: float


class Volumes(NamedTuple):
    """The four prisms over a floor against which geoms are tested, in the order of flags' bits."""

    occupying: Prism
    blocking: Prism
    at_wall_height: Prism
    blocking_square: Prism


class VolumeScratch(NamedTuple):
    """Memory that the tests of shapes against prisms write their intermediate results to.

    Attributes:
        simplex: of a solid and a prism.
        polygons: a triangle that is clipped by a prism.
        triangle_copy: the triangle that is tested.
    """

    simplex: Simplex
    polygons: Polygons
    triangle_copy: TriangleCopy


@subkernel(inline="always")
def make_volumes(lattice, footprint, queries, occupant_lists, query, row, col):
    """Make the four prisms over the floor of a query, a cell with the height of a floor.

    Args:
        lattice: the cells.
        footprint: the volume over a floor that has to be free.
        queries: all queries.
        occupant_lists: the ceilings and the heights of walls; if it is empty, the prisms of
            OCCUPYING and AT_WALL_HEIGHT have no meaning.
        query: number of the query.
        row: row of its cell.
        col: column of its cell.
    """
    floor = queries.floor[query]
    x, y = cell_center_at(lattice, row, col)
    bottom = floor + footprint.low
    top = floor + footprint.high
    half_width = lattice.cell_size / 2 - TOUCH_DEPTH
    is_round = footprint.radius > 0.0
    ceiling = occupant_lists.ceiling[query] if occupant_lists.ceiling.shape[0] > 0 else top
    return Volumes(
        occupying=Prism(x, y, floor + (SAME_HEIGHT + TOUCH_DEPTH), ceiling, half_width, NOT_ROUND),
        blocking=Prism(x, y, bottom, top, footprint.radius if is_round else half_width, is_round),
        at_wall_height=Prism(
            x,
            y,
            floor + occupant_lists.wall_low,
            floor + occupant_lists.wall_high,
            half_width,
            NOT_ROUND,
        ),
        blocking_square=Prism(x, y, bottom, top, half_width, NOT_ROUND),
    )


@subkernel(inline="always")
def make_envelope(lattice, footprint, queries, occupant_lists, query, row, col):
    """Make a prism that contains all prisms that are tested over one floor of a cell (a query).

    It is wider than these by SEARCH_MARGIN on each side, and reaches up to the query's ceiling, if
    there is one.

    Args:
        lattice: the cells.
        footprint: the volume over a floor that has to be free.
        queries: all queries.
        occupant_lists: the settings for listing geoms, of which the ceilings are read. Without
            ceilings, only occupancy is tested, and the prism has the heights of the footprint.
        query: number of the query.
        row: row of its cell.
        col: column of its cell.
    """
    floor = queries.floor[query]
    x, y = cell_center_at(lattice, row, col)
    half_width = max(lattice.cell_size / 2, footprint.half_square, footprint.radius) + SEARCH_MARGIN
    bottom = floor + footprint.low
    top = floor + footprint.high
    if occupant_lists.ceiling.shape[0] > 0:
        bottom = floor
        top = occupant_lists.ceiling[query]
    return Prism(x, y, bottom, top, half_width, NOT_ROUND)


@subkernel(inline="always")
def shape_meets_prism(shape_arrays, shape_kind, shape, prism, scratch):
    """Decide whether a shape of a geom meets a prism.

    A prism is a square or a disc, extruded between two heights.

    Args:
        shape_arrays: all shapes.
        shape_kind: PLANE_KIND, SOLID_KIND or TRIANGLE_KIND.
        shape: number of the plane, solid or triangle.
        prism: a square or a disc between two heights.
        scratch: room for the test, with a copy of the triangle.

    Returns:
        APART or MEETS, which are proved; or, for solids only, UNDECIDED if rounding prevents a
        proof.
    """
    if shape_kind == PLANE_KIND:
        return MEETS if plane_meets_prism(shape_arrays.planes, shape, prism) else APART
    if shape_kind == TRIANGLE_KIND:
        is_meeting = facet_meets_prism(
            shape_arrays.facets, shape, scratch.triangle_copy, prism, scratch.polygons
        )
        return MEETS if is_meeting else APART
    solids = shape_arrays.solids
    if is_beside_prism(solids.bounds, shape, prism):
        return APART
    # GJK's error grows with the prism's height: a tall prism is cut above the solid
    cut_top = min(prism.high, solids.bounds[shape, 5] + 1.0)
    cut_prism = Prism(prism.x, prism.y, prism.low, cut_top, prism.half_width, prism.is_round)
    return solid_meets_prism(solids, shape, cut_prism, scratch.simplex)


@subkernel(**NO_REFCOUNT)
def find_flags_on_line(hits, cell, geom, end_hit, volumes):
    """Return the flags of a geom in a cell that follow from its hits on the cell's vertical line.

    The line proves that the geom meets a prism over the floor if it hits the geom between the
    prism's lower and upper height, or runs inside of the geom there: then the winding number above
    is positive. It is the test of `is_line_blocked`, for one geom and three prisms.
    It never returns BLOCKING_SQUARE.

    Args:
        hits: hits on the vertical line through each cell's centre, as `ColumnHits`.
        cell: cell id.
        geom: geom id.
        end_hit: index of a hit of the cell; no hit of the geom is at or above this index.
        volumes: the prisms over the floor of the cell, as `Volumes`.
    """
    occupying = volumes.occupying
    blocking = volumes.blocking
    at_wall_height = volumes.at_wall_height
    lowest_z = min(occupying.low, blocking.low, at_wall_height.low)
    flags = 0
    # winding numbers at the upper ends of the prisms, while the hits above them are counted
    winding_occupying = 0
    winding_blocking = 0
    winding_at_wall_height = 0
    for hit in range(end_hit - 1, hits.start[cell] - 1, -1):
        z = hits.z[hit]
        if z <= lowest_z:
            break
        if hits.geom[hit] != geom:
            continue
        winding = 0
        if hits.closed[hit]:
            winding = 1 if hits.normal[hit, 2] > 0.0 else -1
        if z >= occupying.high:
            winding_occupying += winding
        elif z > occupying.low:
            flags |= OCCUPYING
        if z >= blocking.high:
            winding_blocking += winding
        elif z > blocking.low:
            flags |= BLOCKING
        if z >= at_wall_height.high:
            winding_at_wall_height += winding
        elif z > at_wall_height.low:
            flags |= AT_WALL_HEIGHT
    flags |= OCCUPYING if winding_occupying > 0 else 0
    flags |= BLOCKING if winding_blocking > 0 else 0
    return flags | (AT_WALL_HEIGHT if winding_at_wall_height > 0 else 0)


@subkernel(inline="always")
def describe_floor(hits, cell, floor, min_normal_z, first_hit_above):
    """Find the geom whose surface is the floor of a cell, and the gap to the next surface below.

    Args:
        hits: hits on the vertical line through each cell's centre, as `ColumnHits`.
        cell: cell id.
        floor: height of the floor [m].
        min_normal_z: least z of the unit normal of a surface that is not too steep for a floor.
        first_hit_above: index of the cell's first hit above the floor.

    Returns:
        The geom's id, -1 if the cell's line hits no such surface at the floor's height; and how far
        below the floor the highest surface of another geom lies, among those at or below the floor
        that are not too steep, inf for none [m].
    """
    floor_geom = np.int32(-1)
    gap_below = np.inf
    first_hit = hits.start[cell]
    for hit in range(first_hit_above - 1, first_hit - 1, -1):
        if hits.z[hit] < floor:
            break
        if hits.normal[hit, 2] >= min_normal_z:
            floor_geom = hits.geom[hit]  # of several, the first one
    for hit in range(first_hit_above - 1, first_hit - 1, -1):
        if hits.normal[hit, 2] >= min_normal_z and hits.geom[hit] != floor_geom:
            gap_below = floor - hits.z[hit]
            break
    return floor_geom, gap_below
