"""What one geom meets of one cell: proved by the cell's line, or else by the geom's shape.

A cheap test goes before an exact one: the line's winding number, then boxes (broad phase), then
the shapes' own tests in `overlap` (clipping) and `solids` (closed forms, then GJK). Each function
adds flags to those that are known already.
"""

from typing import NamedTuple

from navbake.baker.kernels.arrays import Prism
from navbake.baker.kernels.constants import APART, MEETS
from navbake.baker.kernels.gjk import DISC, SQUARE
from navbake.baker.kernels.overlap import (
    facet_meets_prism,
    outside,
    plane_meets_prism,
)
from navbake.baker.kernels.solids import part_of_solid
from navbake.compiled import UNCOUNTED, part

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


@part(**UNCOUNTED)
def line_flags(crossings, cell, geom, volumes):
    """The flags that a cell's line alone proves of a geom: `line_is_blocked` for each volume."""
    stands, blocks, probed = volumes
    lowest = min(stands.low, blocks.low, probed.low)
    flags, in_stands, in_blocks, in_probed = 0, 0, 0, 0
    for i in range(crossings.start[cell + 1] - 1, crossings.start[cell] - 1, -1):
        z = crossings.z[i]
        if z <= lowest:
            break
        if crossings.geom[i] != geom:
            continue
        entered = 0
        if crossings.closed[i]:
            entered = 1 if crossings.normal[i, 2] > 0.0 else -1
        # a crossing is within a volume, or counts for the winding number of what is below it
        if z >= stands.high:
            in_stands += entered
        elif z > stands.low:
            flags |= STANDS
        if z >= blocks.high:
            in_blocks += entered
        elif z > blocks.low:
            flags |= BLOCKS
        if z >= probed.high:
            in_probed += entered
        elif z > probed.low:
            flags |= PROBED
    flags |= STANDS if in_stands > 0 else 0
    flags |= BLOCKS if in_blocks > 0 else 0
    return flags | (PROBED if in_probed > 0 else 0)


@part(inline="always")
def plane_flags(planes, p, volumes, is_taken, flags):
    """Add what the half-space behind a plane meets; `is_taken` tells if anything may block."""
    if plane_meets_prism(planes, p, volumes.stands):
        flags |= STANDS
    if is_taken and plane_meets_prism(planes, p, volumes.blocks):
        flags |= BLOCKS
    return flags


@part(inline="always")
def triangle_flags(facets, t, volumes, flags, wanted, polygons):
    """Add what a triangle meets of the wanted flags."""
    for flag, prism in (
        (BLOCKS, volumes.blocks),
        (STANDS, volumes.stands),
        (PROBED, volumes.probed),
    ):
        if not wanted & ~flags & flag:
            continue
        if facet_meets_prism(facets, t, prism, polygons):
            flags |= flag
    return flags


@part(inline="always")
def solid_flags(solids, s, volumes, flags, wanted, simplex):
    """Add what a solid meets of the wanted flags."""
    is_open = False
    for flag, prism, is_round in (
        (BLOCKS, volumes.blocks, SQUARE),
        (BLOCKS, volumes.blocks, DISC),
        (STANDS, volumes.stands, SQUARE),
        (PROBED, volumes.probed, SQUARE),
    ):
        if not wanted & ~flags & flag or outside(solids.bounds, s, prism):
            continue
        part = part_of_solid(solids, s, prism, is_round, simplex)
        if part == APART:
            continue
        if flag != BLOCKS:
            flags |= flag
            continue
        if not is_round:
            flags |= STANDS  # the cell's square is the footprint's
        if part == MEETS:
            flags |= BLOCKS
        else:
            is_open = True
    return flags | (UNPROVED if is_open and not flags & BLOCKS else 0)
