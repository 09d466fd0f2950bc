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

SURE = 1e-9  # a gap or an overlap of more than this is no rounding [m]


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
def _plan_gap(s, solids, upright, dx, dy, half, is_round):
    """How far a box or cylinder is from a column, seen from above; negative where they overlap.

    Args:
        upright: number of its own axis that points up or down.
        dx, dy: the column's centre less the solid's [m].
        half: half of the square's edge, or the disc's radius [m].
    """
    kind, _, mat, size, _ = solids
    if kind[s] == CYLINDER:
        if is_round:
            return math.hypot(dx, dy) - size[s, 0] - half
        return math.hypot(max(abs(dx) - half, 0.0), max(abs(dy) - half, 0.0)) - size[s, 0]
    a, b = (upright + 1) % 3, (upright + 2) % 3
    ax, ay, bx, by = mat[s, a], mat[s, 3 + a], mat[s, b], mat[s, 3 + b]
    on_a, on_b = abs(dx * ax + dy * ay) - size[s, a], abs(dx * bx + dy * by) - size[s, b]
    if is_round:
        return math.hypot(max(on_a, 0.0), max(on_b, 0.0)) - half
    gap = max(on_a - half * (abs(ax) + abs(ay)), on_b - half * (abs(bx) + abs(by)))
    gap = max(gap, abs(dx) - half - abs(ax) * size[s, a] - abs(bx) * size[s, b])
    return max(gap, abs(dy) - half - abs(ay) * size[s, a] - abs(by) * size[s, b])


@njit(cache=True)
def _gap(s, solids, x, y, low, high, half, is_round):
    """How far a solid is from a prism, or less; negative where they overlap; 0 for unknown."""
    kind, pos, mat, size, bounds = solids
    dx, dy = x - pos[s, 0], y - pos[s, 1]
    if kind[s] == SPHERE:
        dz = max(low - pos[s, 2], pos[s, 2] - high, 0.0)
        if is_round:
            beside = max(math.hypot(dx, dy) - half, 0.0)
        else:
            beside = math.hypot(max(abs(dx) - half, 0.0), max(abs(dy) - half, 0.0))
        return math.hypot(beside, dz) - size[s, 0]
    for axis in range(3):
        upright = abs(mat[s, 6 + axis]) >= 1.0 - 1e-12
        if upright and (kind[s] == BOX or (kind[s] == CYLINDER and axis == 2)):
            over = max(bounds[s, 2] - high, low - bounds[s, 5])
            return max(_plan_gap(s, solids, axis, dx, dy, half, is_round), over)
    if kind[s] == CAPSULE or kind[s] == CYLINDER:
        ax, ay = mat[s, 2] * size[s, 1], mat[s, 5] * size[s, 1]
        square = ax * ax + ay * ay
        t = min(max((dx * ax + dy * ay) / square, -1.0), 1.0) if square > 0.0 else 0.0
        reach = size[s, 0] + (half if is_round else half * math.sqrt(2.0))
        return max(math.hypot(dx - t * ax, dy - t * ay) - reach, 0.0)
    return 0.0


@njit(cache=True)
def _solid_part(s, solids, x, y, low, high, half, is_round, scratch):
    """APART, MEETS or OPEN for a solid and a prism; APART for a prism of no width."""
    kind, pos, mat, size, _ = solids
    points, keep, best_keep, v, trial = scratch
    if half <= 0.0:
        return APART
    gap = _gap(s, solids, x, y, low, high, half, is_round)
    if abs(gap) > SURE:
        return APART if gap > 0.0 else MEETS
    return solid_meets_prism(
        kind[s], pos[s], mat[s], size[s], x, y, (low + high) / 2.0, half, (high - low) / 2.0,
        is_round, points, keep, best_keep, v, trial,
    )  # fmt: skip


@njit(cache=True)
def solid_flags(s, solids, x, y, widths, heights, flags, wanted, scratch):
    """Add what a solid meets."""
    half, square, radius = widths
    floor, ceiling, low, high, probe_low, probe_high = heights
    bounds = solids[4]
    if wanted & ~flags & BLOCKS and not outside(bounds, s, x, y, max(square, radius), low, high):
        part = _solid_part(s, solids, x, y, low, high, square, False, scratch)
        if square > 0.0 and part != APART:
            flags |= STANDS  # the cell's square is the footprint's
        if part != MEETS:
            disc = _solid_part(s, solids, x, y, low, high, radius, True, scratch)
            part = MEETS if disc == MEETS else max(part, disc)
        if part == MEETS:
            flags |= BLOCKS
        elif part == OPEN:
            flags |= UNPROVED
    for flag, z0, z1 in ((STANDS, floor, ceiling), (PROBED, probe_low, probe_high)):
        if not wanted & ~flags & flag or outside(bounds, s, x, y, half, z0, z1):
            continue
        if _solid_part(s, solids, x, y, z0, z1, half, False, scratch) != APART:
            flags |= flag
    return flags
