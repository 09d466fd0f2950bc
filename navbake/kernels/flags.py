"""What one geom meets of one cell: by the cell's line, then by its shape.

All of them are told a cell's `widths` (half the edge of its square, and the footprint's square and
radius) and `heights` (its column's, the occupancy's band's and the probed band's lower and upper
ends), all in metres, and add flags to those that are known.
"""

from __future__ import annotations

import math

from numba import njit

from navbake.kernels.overlap import (
    APART,
    BOX,
    CAPSULE,
    CYLINDER,
    MEETS,
    OPEN,
    SPHERE,
    plane_meets_prism,
    solid_meets_prism,
    triangle_meets_prism,
)

# It stands in the cell, it meets the occupancy's volume, it meets the square in the probed band,
# and it meets the occupancy's volume or not, without a proof either way
STANDS, BLOCKS, PROBED, UNPROVED = 1, 2, 4, 8


@njit(cache=True)
def outside(boxes, i, x, y, reach, low, high):
    return (
        boxes[i, 0] >= x + reach
        or boxes[i, 3] <= x - reach
        or boxes[i, 1] >= y + reach
        or boxes[i, 4] <= y - reach
        or boxes[i, 2] >= high
        or boxes[i, 5] <= low
    )


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
def _solid_part(s, solids, x, y, low, high, half, is_round, scratch):
    """APART, MEETS or OPEN for a solid and a prism; APART for a prism of no width."""
    kind, pos, mat, size, _ = solids
    points, keep, best_keep, v, trial = scratch
    if half <= 0.0:
        return APART
    return solid_meets_prism(
        kind[s], pos[s], mat[s], size[s], x, y, (low + high) / 2.0, half, (high - low) / 2.0,
        is_round, points, keep, best_keep, v, trial,
    )  # fmt: skip


@njit(cache=True)
def _is_upright(s, solids):
    """Whether a solid has the same section at each of its heights."""
    kind, _, mat, _, _ = solids
    if kind[s] == CYLINDER:
        return abs(mat[s, 8]) >= 1.0 - 1e-12
    steepest = max(abs(mat[s, 6]), abs(mat[s, 7]), abs(mat[s, 8]))
    return kind[s] == BOX and steepest >= 1.0 - 1e-12


@njit(cache=True)
def _is_far(s, solids, x, y, half):
    """Whether a sphere, capsule or cylinder is apart from a column, seen from above."""
    kind, pos, mat, size, _ = solids
    if kind[s] != SPHERE and kind[s] != CAPSULE and kind[s] != CYLINDER:
        return False
    length = 0.0 if kind[s] == SPHERE else size[s, 1]
    ax, ay = mat[s, 2] * length, mat[s, 5] * length
    dx, dy = x - pos[s, 0], y - pos[s, 1]
    square = ax * ax + ay * ay
    t = min(max((dx * ax + dy * ay) / square, -1.0), 1.0) if square > 0.0 else 0.0
    dx, dy = dx - t * ax, dy - t * ay
    reach = size[s, 0] + half * math.sqrt(2.0)
    return dx * dx + dy * dy >= reach * reach


@njit(cache=True)
def is_beside(s, solids, x, y, half, low, high):
    """Whether a solid is apart from the column of a cell whose band nothing meets."""
    if _is_upright(s, solids) and solids[4][s, 2] < high and solids[4][s, 5] > low:
        return True  # apart at one of its heights, apart at all
    return _is_far(s, solids, x, y, half)


@njit(cache=True)
def solid_flags(s, solids, x, y, widths, heights, flags, wanted, scratch):
    """Add what a solid meets; its overlap with the band is asked as `check_cells` asks it."""
    half, square, radius = widths
    floor, ceiling, low, high, probe_low, probe_high = heights
    bounds = solids[4]
    upright, beside = _is_upright(s, solids), False
    if wanted & ~flags & BLOCKS and not outside(bounds, s, x, y, max(square, radius), low, high):
        part = _solid_part(s, solids, x, y, low, high, square, False, scratch)
        beside = upright and square > 0.0 and part == APART
        if square > 0.0 and part != APART:
            flags |= STANDS  # the cell's square is the footprint's
        if part != MEETS:
            disc = _solid_part(s, solids, x, y, low, high, radius, True, scratch)
            part = MEETS if disc == MEETS else max(part, disc)
        if part == MEETS:
            flags |= BLOCKS
        elif part == OPEN:
            flags |= UNPROVED
    if beside or _is_far(s, solids, x, y, half):
        return flags
    if not flags & STANDS and not outside(bounds, s, x, y, half, floor, ceiling):
        part = _solid_part(s, solids, x, y, floor, ceiling, half, False, scratch)
        flags |= STANDS if part != APART else 0
    if wanted & ~flags & PROBED and not outside(bounds, s, x, y, half, probe_low, probe_high):
        part = MEETS if flags & STANDS else APART
        if not upright:
            part = _solid_part(s, solids, x, y, probe_low, probe_high, half, False, scratch)
        flags |= PROBED if part != APART else 0
    return flags
