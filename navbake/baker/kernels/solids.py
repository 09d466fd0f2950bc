"""Does a solid meet an upright prism? By its shape where that is plain, else by iteration."""

from __future__ import annotations

import math

from numba import njit

from navbake.baker.kernels.overlap import (
    APART,
    BOX,
    CAPSULE,
    CYLINDER,
    MEETS,
    SPHERE,
    solid_meets_prism,
)

SURE = 1e-9  # a gap or an overlap of more than this is no rounding [m]


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
        ax, ay, az = mat[s, 2] * size[s, 1], mat[s, 5] * size[s, 1], mat[s, 8] * size[s, 1]
        square = ax * ax + ay * ay
        t = min(max((dx * ax + dy * ay) / square, -1.0), 1.0) if square > 0.0 else 0.0
        px, py, pz = dx - t * ax, dy - t * ay, pos[s, 2] + t * az
        if kind[s] == CAPSULE:  # the ball round its axis where that comes nearest proves most
            over = max(low - pz, pz - high, 0.0)
            if is_round:
                beside = max(math.hypot(px, py) - half, 0.0)
            else:
                beside = math.hypot(max(abs(px) - half, 0.0), max(abs(py) - half, 0.0))
            gap = math.hypot(beside, over) - size[s, 0]
            if gap < 0.0:
                return gap
        reach = size[s, 0] + (half if is_round else half * math.sqrt(2.0))
        return max(math.hypot(px, py) - reach, 0.0)
    return 0.0


@njit(cache=True)
def solid_part(s, solids, x, y, low, high, half, is_round, scratch):
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
