"""What one geom meets of one cell: by the cell's line, then by its shape.

All of them are told a cell's `widths` (half the edge of its square, and the footprint's square and
radius) and `heights` (its column's, the occupancy's band's and the probed band's lower and upper
ends), all in metres, and add flags to those that are known.
"""

from __future__ import annotations

from numba import njit

from navbake.baker.kernels.overlap import (
    APART,
    MEETS,
    OPEN,
    outside,
    plane_meets_prism,
    triangle_meets_prism,
)
from navbake.baker.kernels.solids import solid_part

# It stands in the cell, it meets the occupancy's volume, it meets the square in the probed band,
# and it meets the occupancy's volume or not, without a proof either way
STANDS, BLOCKS, PROBED, UNPROVED = 1, 2, 4, 8


@njit(cache=True)
def _line_meets(column, wanted, low, high):
    """Whether a column's line proves that one geom is between two heights."""
    z, normals, geom, closed, first, last = column
    inside = 0
    for i in range(last - 1, first - 1, -1):
        if z[i] <= low:
            break
        if geom[i] != wanted:
            continue
        if z[i] < high:
            return True
        if closed[wanted]:
            inside += 1 if normals[i, 2] > 0.0 else -1
    return inside > 0


@njit(cache=True)
def line_flags(column, geom, heights, taken, probing):
    """What a cell's line alone proves of a geom; `taken` tells whether anything may block."""
    floor, ceiling, low, high, probe_low, probe_high = heights
    flags = 0
    if _line_meets(column, geom, floor, ceiling):
        flags |= STANDS
    if taken and _line_meets(column, geom, low, high):
        flags |= BLOCKS
    if probing and _line_meets(column, geom, probe_low, probe_high):
        flags |= PROBED
    return flags


@njit(cache=True)
def plane_flags(pos, mat, x, y, widths, heights, taken, flags):
    """Add what the half-space behind a plane meets."""
    half, square, radius = widths
    floor, ceiling, low, high, _, _ = heights
    middle, half_z = (floor + ceiling) / 2.0, (ceiling - floor) / 2.0
    if plane_meets_prism(pos, mat, x, y, middle, half, 0.0, half_z):
        flags |= STANDS
    middle, half_z = (low + high) / 2.0, (high - low) / 2.0
    if taken and plane_meets_prism(pos, mat, x, y, middle, square, radius, half_z):
        flags |= BLOCKS
    return flags


@njit(cache=True)
def triangle_flags(items, corners, bounds, x, y, widths, heights, flags, wanted, one, other):
    """Add what a geom's triangles meet, until all wanted flags are set."""
    half, square, radius = widths
    floor, ceiling, low, high, probe_low, probe_high = heights
    for t in items:
        if flags & wanted == wanted:
            break
        for flag, z0, z1, edge, disc in (
            (BLOCKS, low, high, square, radius),
            (STANDS, floor, ceiling, half, 0.0),
            (PROBED, probe_low, probe_high, half, 0.0),
        ):
            if not wanted & ~flags & flag or outside(bounds, t, x, y, max(edge, disc), z0, z1):
                continue
            if triangle_meets_prism(corners[t], x, y, z0, z1, edge, disc, one, other):
                flags |= flag
    return flags


@njit(cache=True)
def solid_flags(s, solids, x, y, widths, heights, flags, wanted, scratch):
    """Add what a solid meets."""
    half, square, radius = widths
    floor, ceiling, low, high, probe_low, probe_high = heights
    bounds = solids[4]
    if wanted & ~flags & BLOCKS and not outside(bounds, s, x, y, max(square, radius), low, high):
        part = solid_part(s, solids, x, y, low, high, square, False, scratch)
        if square > 0.0 and part != APART:
            flags |= STANDS  # the cell's square is the footprint's
        if part != MEETS:
            disc = solid_part(s, solids, x, y, low, high, radius, True, scratch)
            part = MEETS if disc == MEETS else max(part, disc)
        if part == MEETS:
            flags |= BLOCKS
        elif part == OPEN:
            flags |= UNPROVED
    for flag, z0, z1 in ((STANDS, floor, ceiling), (PROBED, probe_low, probe_high)):
        if not wanted & ~flags & flag or outside(bounds, s, x, y, half, z0, z1):
            continue
        if solid_part(s, solids, x, y, z0, z1, half, False, scratch) != APART:
            flags |= flag
    return flags
