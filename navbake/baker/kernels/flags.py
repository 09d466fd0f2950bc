"""What one geom meets of one cell: proved by the cell's line, or else by the geom's shape.

A cheap test goes before an exact one: the line's winding number, then boxes (broad phase), then
the shapes' own tests in `overlap` (clipping) and `solids` (closed forms, then GJK). Each function
adds flags to those that are known already.
"""

from typing import NamedTuple

from numba import njit

from navbake.baker.kernels.arrays import Prism
from navbake.baker.kernels.constants import APART, MEETS, UNDECIDED
from navbake.baker.kernels.gjk import SQUARE
from navbake.baker.kernels.overlap import (
    facet_meets_prism,
    line_is_blocked,
    outside,
    plane_meets_prism,
    with_edges,
)
from navbake.baker.kernels.solids import disc_too, part_of_solid

# It stands in the cell, it meets the occupancy's volume, it meets the square in the probed band,
# and it meets the occupancy's volume or not, without a proof either way
STANDS, BLOCKS, PROBED, UNPROVED = 1, 2, 4, 8


class Volumes(NamedTuple):
    """The parts of a cell's column that are asked about, one for each of three flags.

    Attributes:
        stands: the cell's square between floor and ceiling.
        blocks: the occupancy's volume.
        probed: the cell's square in the probed band.
    """

    stands: Prism
    blocks: Prism
    probed: Prism


@njit(cache=True)
def line_flags(crossings, cell, geom, volumes, wanted):
    """The flags that a cell's line alone proves of a geom, of those that are wanted."""
    flags = 0
    if wanted & STANDS and line_is_blocked(crossings, cell, volumes.stands, geom):
        flags |= STANDS
    if wanted & BLOCKS and line_is_blocked(crossings, cell, volumes.blocks, geom):
        flags |= BLOCKS
    if wanted & PROBED and line_is_blocked(crossings, cell, volumes.probed, geom):
        flags |= PROBED
    return flags


@njit(inline="always")
def plane_flags(planes, p, volumes, is_taken, flags):
    """Add what the half-space behind a plane meets; `is_taken` tells if anything may block."""
    if plane_meets_prism(planes, p, volumes.stands):
        flags |= STANDS
    if is_taken and plane_meets_prism(planes, p, volumes.blocks):
        flags |= BLOCKS
    return flags


@njit(inline="always")
def triangle_flags(items, facets, volumes, flags, wanted, polygons):
    """Add what a geom's triangles meet, until all wanted flags are set."""
    blocks, stands = with_edges(volumes.blocks), with_edges(volumes.stands)
    probed = with_edges(volumes.probed)
    for t in items:
        if flags & wanted == wanted:
            break
        for flag, prism, wide in (
            (BLOCKS, volumes.blocks, blocks),
            (STANDS, volumes.stands, stands),
            (PROBED, volumes.probed, probed),
        ):
            if not wanted & ~flags & flag:
                continue
            if facet_meets_prism(facets, t, prism, wide, polygons):
                flags |= flag
    return flags


@njit(inline="always")
def solid_flags(solids, s, volumes, flags, wanted, simplex):
    """Add what a solid meets of the wanted flags."""
    if wanted & ~flags & BLOCKS and not outside(solids.bounds, s, volumes.blocks):
        part = part_of_solid(solids, s, volumes.blocks, SQUARE, simplex)
        if part != APART:
            flags |= STANDS  # the cell's square is the footprint's
        part = disc_too(solids, s, volumes.blocks, part, simplex)
        if part == MEETS:
            flags |= BLOCKS
        elif part == UNDECIDED:
            flags |= UNPROVED
    for flag, prism in ((STANDS, volumes.stands), (PROBED, volumes.probed)):
        if not wanted & ~flags & flag or outside(solids.bounds, s, prism):
            continue
        if part_of_solid(solids, s, prism, SQUARE, simplex) != APART:
            flags |= flag
    return flags
