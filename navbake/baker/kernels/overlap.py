"""Does a geom meet an upright prism? Answers that are proved, one way or the other.

A prism is a cell's square or the agent's disc, extruded over a band of heights. For solids the
Gilbert-Johnson-Keerthi iteration looks for a proof: a plane between the two (apart), or a
tetrahedron of their Minkowski difference round the origin (they meet). Where rounding leaves
neither, the answer is OPEN and somebody else's to give. Triangles are clipped, which needs no
iteration.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from navbake.baker.kernels.tiles import TILE

APART, MEETS, OPEN = 0, 1, 2

SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX = 2, 3, 4, 5, 6

MOST_STEPS = 128
ROUNDING = 1e-3  # by how much of itself a distance may seem to grow while it shrinks
NEAR = 1e-7  # the two meet when they are proved to be this near, less than TOUCH, to each other [m]


@njit(cache=True)
def outside(boxes, i, x, y, reach, low, high):
    """Whether a box is beside a prism; touching is beside it."""
    return (
        boxes[i, 0] >= x + reach
        or boxes[i, 3] <= x - reach
        or boxes[i, 1] >= y + reach
        or boxes[i, 4] <= y - reach
        or boxes[i, 2] >= high
        or boxes[i, 5] <= low
    )


@njit(cache=True, inline="always")
def _support_solid(kind, pos, mat, size, dx, dy, dz, out):
    """The farthest point of a solid along a direction, into out."""
    # direction in the solid's own frame: transpose of the row-major matrix
    lx = mat[0] * dx + mat[3] * dy + mat[6] * dz
    ly = mat[1] * dx + mat[4] * dy + mat[7] * dz
    lz = mat[2] * dx + mat[5] * dy + mat[8] * dz
    px, py, pz = 0.0, 0.0, 0.0
    if kind == BOX:
        px = size[0] if lx > 0.0 else -size[0]
        py = size[1] if ly > 0.0 else -size[1]
        pz = size[2] if lz > 0.0 else -size[2]
    elif kind == CYLINDER:
        across = math.sqrt(lx * lx + ly * ly)
        if across > 0.0:
            px = size[0] * lx / across
            py = size[0] * ly / across
        pz = size[1] if lz > 0.0 else -size[1]
    elif kind == ELLIPSOID:
        ax, ay, az = size[0] * lx, size[1] * ly, size[2] * lz
        norm = math.sqrt(ax * ax + ay * ay + az * az)
        if norm > 0.0:
            px = size[0] * ax / norm
            py = size[1] * ay / norm
            pz = size[2] * az / norm
    else:
        norm = math.sqrt(lx * lx + ly * ly + lz * lz)
        if norm > 0.0:
            px = size[0] * lx / norm
            py = size[0] * ly / norm
            pz = size[0] * lz / norm
        if kind == CAPSULE:
            pz += size[1] if lz > 0.0 else -size[1]
    out[0] = pos[0] + mat[0] * px + mat[1] * py + mat[2] * pz
    out[1] = pos[1] + mat[3] * px + mat[4] * py + mat[5] * pz
    out[2] = pos[2] + mat[6] * px + mat[7] * py + mat[8] * pz


@njit(cache=True, inline="always")
def _subtract_prism(cx, cy, cz, half, half_z, is_round, dx, dy, dz, out):
    """Take the prism's farthest point along a direction off a point, in place."""
    if is_round:
        across = math.sqrt(dx * dx + dy * dy)
        if across > 0.0:
            out[0] -= cx + half * dx / across
            out[1] -= cy + half * dy / across
        else:
            out[0] -= cx
            out[1] -= cy
    else:
        out[0] -= cx + (half if dx > 0.0 else -half)
        out[1] -= cy + (half if dy > 0.0 else -half)
    out[2] -= cz + (half_z if dz > 0.0 else -half_z)


@njit(cache=True, inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def _nearest_on_segment(a, b, keep, v):
    """Nearest point of a segment to the origin into v; keep says which ends it needs."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    length = abx * abx + aby * aby + abz * abz
    t = -(a[0] * abx + a[1] * aby + a[2] * abz)
    if t <= 0.0 or length == 0.0:
        v[0], v[1], v[2] = a[0], a[1], a[2]
        keep[0], keep[1] = True, False
    elif t >= length:
        v[0], v[1], v[2] = b[0], b[1], b[2]
        keep[0], keep[1] = False, True
    else:
        t /= length
        v[0], v[1], v[2] = a[0] + t * abx, a[1] + t * aby, a[2] + t * abz
        keep[0], keep[1] = True, True


@njit(cache=True)
def _nearest_on_triangle(a, b, c, keep, v):
    """Nearest point of a triangle to the origin into v (Voronoi regions of its features)."""
    keep[0], keep[1], keep[2] = False, False, False
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    d1 = -(abx * a[0] + aby * a[1] + abz * a[2])
    d2 = -(acx * a[0] + acy * a[1] + acz * a[2])
    if d1 <= 0.0 and d2 <= 0.0:
        v[0], v[1], v[2] = a[0], a[1], a[2]
        keep[0] = True
        return
    d3 = -(abx * b[0] + aby * b[1] + abz * b[2])
    d4 = -(acx * b[0] + acy * b[1] + acz * b[2])
    if d3 >= 0.0 and d4 <= d3:
        v[0], v[1], v[2] = b[0], b[1], b[2]
        keep[1] = True
        return
    d5 = -(abx * c[0] + aby * c[1] + abz * c[2])
    d6 = -(acx * c[0] + acy * c[1] + acz * c[2])
    if d6 >= 0.0 and d5 <= d6:
        v[0], v[1], v[2] = c[0], c[1], c[2]
        keep[2] = True
        return
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        v[0], v[1], v[2] = a[0] + t * abx, a[1] + t * aby, a[2] + t * abz
        keep[0], keep[1] = True, True
        return
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        v[0], v[1], v[2] = a[0] + t * acx, a[1] + t * acy, a[2] + t * acz
        keep[0], keep[2] = True, True
        return
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v[0] = b[0] + t * (c[0] - b[0])
        v[1] = b[1] + t * (c[1] - b[1])
        v[2] = b[2] + t * (c[2] - b[2])
        keep[1], keep[2] = True, True
        return
    # inside: the foot of the origin on the plane, straight from its normal
    nx = aby * acz - abz * acy
    ny = abz * acx - abx * acz
    nz = abx * acy - aby * acx
    scale = (a[0] * nx + a[1] * ny + a[2] * nz) / (nx * nx + ny * ny + nz * nz)
    v[0], v[1], v[2] = nx * scale, ny * scale, nz * scale
    keep[0], keep[1], keep[2] = True, True, True


@njit(cache=True)
def _origin_outside(a, b, c, d):
    """Whether the origin lies beyond the face a, b, c of a tetrahedron, or d in its plane."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx = aby * acz - abz * acy
    ny = abz * acx - abx * acz
    nz = abx * acy - aby * acx
    to_d = nx * (d[0] - a[0]) + ny * (d[1] - a[1]) + nz * (d[2] - a[2])
    to_origin = -(nx * a[0] + ny * a[1] + nz * a[2])
    if abs(to_d) <= 1e-12 * math.sqrt(nx * nx + ny * ny + nz * nz):
        return True  # flat: no volume to be inside of
    return to_d * to_origin <= 0.0


FACES = np.array([[0, 1, 2, 3], [0, 1, 3, 2], [0, 2, 3, 1], [1, 2, 3, 0]])


@njit(cache=True)
def _nearest_on_simplex(points, num, keep, best_keep, v, trial):
    """Reduce a simplex to the part that is nearest to the origin, and put that point into v.

    Returns:
        The number of points kept, or 4 with the origin proved inside.
    """
    if num == 1:
        v[0], v[1], v[2] = points[0, 0], points[0, 1], points[0, 2]
        return 1
    if num == 2:
        keep[2] = keep[3] = False
        _nearest_on_segment(points[0], points[1], keep, v)
    elif num == 3:
        keep[3] = False
        _nearest_on_triangle(points[0], points[1], points[2], keep, v)
    else:
        best = math.inf
        outside = False
        for f in range(4):
            i, j, k, m = FACES[f, 0], FACES[f, 1], FACES[f, 2], FACES[f, 3]
            if not _origin_outside(points[i], points[j], points[k], points[m]):
                continue
            outside = True
            _nearest_on_triangle(points[i], points[j], points[k], keep, trial)
            distance = _dot(trial, trial)
            if distance < best:
                best = distance
                v[0], v[1], v[2] = trial[0], trial[1], trial[2]
                best_keep[:] = False
                best_keep[i], best_keep[j], best_keep[k] = keep[0], keep[1], keep[2]
        if not outside:
            return 4
        keep[:] = best_keep
    kept = 0
    for i in range(num):
        if keep[i]:
            points[kept, 0] = points[i, 0]
            points[kept, 1] = points[i, 1]
            points[kept, 2] = points[i, 2]
            kept += 1
    return kept


@njit(cache=True)
def solid_meets_prism(
    kind, pos, mat, size, cx, cy, cz, half, half_z, is_round, points, keep, best_keep, v, trial
):
    """Does a solid meet an upright prism?

    Args:
        kind, pos, mat, size: the solid, as MuJoCo has it.
        cx, cy, cz: the prism's centre [m].
        half: half of the square's edge, or the disc's radius [m].
        half_z: half of the prism's height [m].
        is_round: a disc rather than a square.
        points, keep, best_keep, v, trial: scratch, (4, 3) and (3,) float64, (4,) bool.

    Returns:
        APART or MEETS where that is proved, else OPEN.
    """
    v[0], v[1], v[2] = pos[0] - cx, pos[1] - cy, pos[2] - cz
    if v[0] == 0.0 and v[1] == 0.0 and v[2] == 0.0:
        return MEETS  # both centres are inside
    num = 0
    last = math.inf
    for _ in range(MOST_STEPS):
        w = points[num]
        _support_solid(kind, pos, mat, size, -v[0], -v[1], -v[2], w)
        _subtract_prism(cx, cy, cz, half, half_z, is_round, v[0], v[1], v[2], w)
        if _dot(v, w) > 1e-15 * math.sqrt(_dot(v, v)):
            return APART
        for i in range(num):
            if points[i, 0] == w[0] and points[i, 1] == w[1] and points[i, 2] == w[2]:
                return OPEN  # no way to come nearer
        num = _nearest_on_simplex(points, num + 1, keep, best_keep, v, trial)
        if num == 4:
            return MEETS
        distance = _dot(v, v)
        if distance < NEAR * NEAR:
            return MEETS  # v is a point of the difference
        if distance > last * (1.0 + ROUNDING):
            return OPEN
        last = distance
    return OPEN


@njit(cache=True, inline="always")
def _clip(points, num, out, axis, limit, sign):
    """Keep the part of a polygon where ``sign * (coordinate - limit) >= 0``."""
    kept = 0
    for i in range(num):
        j = i + 1 if i + 1 < num else 0
        di = sign * (points[i, axis] - limit)
        dj = sign * (points[j, axis] - limit)
        if di >= 0.0:
            out[kept, 0], out[kept, 1], out[kept, 2] = points[i, 0], points[i, 1], points[i, 2]
            kept += 1
        if (di > 0.0 and dj < 0.0) or (di < 0.0 and dj > 0.0):
            t = di / (di - dj)
            for k in range(3):
                out[kept, k] = points[i, k] + t * (points[j, k] - points[i, k])
            out[kept, axis] = limit
            kept += 1
    return kept


@njit(cache=True)
def _disc_meets_polygon(points, num, cx, cy, radius):
    """Whether a polygon, seen from above, comes nearer to (cx, cy) than radius."""
    left, right = False, False
    for i in range(num):
        j = i + 1 if i + 1 < num else 0
        ax, ay = points[i, 0] - cx, points[i, 1] - cy
        ex, ey = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        length = ex * ex + ey * ey
        t = 0.0
        if length > 0.0:
            t = min(max(-(ax * ex + ay * ey) / length, 0.0), 1.0)
        dx, dy = ax + t * ex, ay + t * ey
        if dx * dx + dy * dy < radius * radius:
            return True
        side = ex * ay - ey * ax
        left = left or side > 0.0
        right = right or side < 0.0
    return (left or right) and not (left and right)


@njit(cache=True)
def triangle_meets_prism(
    corners, cx, cy, z_low, z_high, square, radius, one, other
):  # fmt: skip
    """Does a triangle meet the square or the disc round (cx, cy), between two heights?

    Args:
        corners: (3, 3) float64 [m].
        square: half of the square's edge, 0 for none [m].
        radius: the disc's radius, 0 for none [m].
        one, other: scratch, (12, 3) float64.
    """
    for i in range(3):
        for k in range(3):
            one[i, k] = corners[i, k]
    num = _clip(one, 3, other, 2, z_low, 1.0)
    num = _clip(other, num, one, 2, z_high, -1.0)
    if num == 0:
        return False
    if radius > 0.0 and _disc_meets_polygon(one, num, cx, cy, radius):
        return True
    if square > 0.0:
        num = _clip(one, num, other, 0, cx - square, 1.0)
        num = _clip(other, num, one, 0, cx + square, -1.0)
        num = _clip(one, num, other, 1, cy - square, 1.0)
        num = _clip(other, num, one, 1, cy + square, -1.0)
        return num > 0
    return False


@njit(cache=True)
def plane_meets_prism(pos, mat, cx, cy, cz, square, radius, half_z):
    """Does the half-space behind an infinite plane meet the square's or the disc's prism?"""
    nx, ny, nz = mat[2], mat[5], mat[8]
    depth = nx * (cx - pos[0]) + ny * (cy - pos[1]) + nz * (cz - pos[2]) - abs(nz) * half_z
    reach = max(square * (abs(nx) + abs(ny)), radius * math.sqrt(nx * nx + ny * ny))
    return depth - reach < 0.0


@njit(cache=True)
def line_is_blocked(z, normals, geom, closed, first, last, low, high):
    """Whether a cell's line proves that something is between two heights.

    It does where it crosses a geom there, or runs inside a closed one all along.

    Args:
        z, normals, geom: all columns' crossings, ascending in ``[first, last)``.
        closed: by geom id, whether it encloses a volume.
        low, high: the heights [m].
    """
    inside = 0
    for i in range(last - 1, first - 1, -1):
        if z[i] <= low:
            break
        if z[i] < high:
            return True
        if closed[geom[i]]:
            inside += 1 if normals[i, 2] > 0.0 else -1
    return inside > 0


@njit(cache=True)
def tile_of(row, col, width):
    """The tile that holds a cell."""
    return row // TILE * ((width + TILE - 1) // TILE) + col // TILE
