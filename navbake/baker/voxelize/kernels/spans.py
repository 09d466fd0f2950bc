"""Between which heights is a solid met by an upright column of square cross-section?

A solid is convex, so what it has in common with a column without end is too, and the heights of
that are one span. Its upper end is the greatest height over the square: at the top of the solid,
at the top of its cut by one of the column's faces, or at a corner of the square. All three have a
closed form, so nothing is sampled or iterated. All these solids are symmetric about their centre;
the lower end is the upper one of the square seen from the other side.

Candidates from the three places are all computed, and the greatest that lies over the square
counts: a candidate outside it belongs to no part of the column. Squares and heights are relative
to the solid's centre. An empty span has the upper end -inf.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.kernels.constants import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE
from navbake.baker.kernels.overlap import X, Y, clip_between
from navbake.compiled import part

UPRIGHT = 1e-8  # a solid that leans by less than this stands upright [m]
FLAT = 1e-9  # a direction of which less than this leaves a plane lies in it
NONE = -math.inf


class Square(NamedTuple):
    """An upright column's cross-section [m]."""

    x0: float
    x1: float
    y0: float
    y1: float


@part(inline="always")
def _best_in_square(best, x, y, z, square):
    """The higher of two candidates; the second counts only over the square."""
    if z > best and square.x0 <= x <= square.x1 and square.y0 <= y <= square.y1:
        return z
    return best


@part
def _sphere_top(radius, x, y, z, square):
    """Top of the sphere at (x, y, z) over the square."""
    dx = max(square.x0 - x, 0.0, x - square.x1)
    dy = max(square.y0 - y, 0.0, y - square.y1)
    left = radius * radius - dx * dx - dy * dy
    return z + math.sqrt(left) if left > 0.0 else NONE


@part(inline="always")
def _ellipsoid_top(mat, size, square):
    # the ellipsoid is all M u with |u| <= 1; s = M M'
    sxx, sxy, sxz, syy, syz, szz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        mx, my, mz = mat[k] * size[k], mat[3 + k] * size[k], mat[6 + k] * size[k]
        sxx += mx * mx
        sxy += mx * my
        sxz += mx * mz
        syy += my * my
        syz += my * mz
        szz += mz * mz
    high = math.sqrt(szz)
    # its very top, then the tops of the ellipses that the column's faces cut out of it
    best = _best_in_square(NONE, sxz / high, syz / high, high, square)
    for face in range(2):
        x = square.x0 if face == 0 else square.x1
        left = 1.0 - x * x / sxx
        if left > 0.0:
            vyz, vzz = syz - sxy * sxz / sxx, szz - sxz * sxz / sxx
            high = math.sqrt(vzz * left)
            y = sxy / sxx * x + (vyz / vzz * high if vzz > 0.0 else 0.0)
            best = _best_in_square(best, x, y, sxz / sxx * x + high, square)
        y = square.y0 if face == 0 else square.y1
        left = 1.0 - y * y / syy
        if left > 0.0:
            vxz, vzz = sxz - sxy * syz / syy, szz - syz * syz / syy
            high = math.sqrt(vzz * left)
            x = sxy / syy * y + (vxz / vzz * high if vzz > 0.0 else 0.0)
            best = _best_in_square(best, x, y, syz / syy * y + high, square)
    # upright lines through the square's corners: a quadratic in z
    det = sxx * syy - sxy * sxy
    if det > 0.0:
        wx, wy = (sxz * syy - syz * sxy) / det, (syz * sxx - sxz * sxy) / det
        thick = szz - wx * sxz - wy * syz
        for corner in range(4):
            x = square.x0 if corner < 2 else square.x1
            y = square.y0 if corner % 2 == 0 else square.y1
            left = 1.0 - (x * x * syy - 2.0 * x * y * sxy + y * y * sxx) / det
            if left >= 0.0:
                best = max(best, wx * x + wy * y + math.sqrt(left * max(thick, 0.0)))
    return best


@part(inline="always")
def _cut_top(radius, half, ax, ay, az, x, y0, y1):
    """Top of a cylinder's cut by the plane of one x, between two y."""
    best = NONE
    # where the mantle's cut has its top: along the line that touches it there
    if abs(ax) > FLAT:
        across = math.copysign(math.hypot(ax, az), ax)
        px, pz = -radius * az / across, radius * ax / across
        t = (x - px) / ax
        if abs(t) <= half and y0 <= t * ay <= y1:
            best = pz + t * az
    # the cuts of the two caps are chords: their ends
    beside = ay * ay + az * az
    if beside > FLAT * FLAT:
        for sign in (-1.0, 1.0):
            off = x - sign * half * ax
            square = radius * radius - off * off / beside
            if square < 0.0:
                continue
            width = math.sqrt(square / beside)
            my = sign * half * ay - off * ax * ay / beside
            mz = sign * half * az - off * ax * az / beside
            for end in (-width, width):
                y, z = my + end * az, mz - end * ay
                if z > best and y0 <= y <= y1:
                    best = z
    return best


@part(inline="always")
def _line_top(radius, half, ax, ay, az, x, y):
    """Top of a cylinder on an upright line."""
    low, high = -math.inf, math.inf
    on_axis = ax * x + ay * y  # of the line's foot; z adds az * z
    if abs(az) > FLAT:
        one, other = (-half - on_axis) / az, (half - on_axis) / az
        low, high = min(one, other), max(one, other)
    elif abs(on_axis) > half:
        return NONE
    # |p - (a.p) a| <= r is a quadratic in z
    a = ax * ax + ay * ay  # 1 - az * az would lose all digits of a slight lean
    b = -az * on_axis
    c = x * x + y * y - on_axis * on_axis - radius * radius
    square = b * b - a * c
    if square < 0.0:
        return NONE
    root = math.sqrt(square)
    low, high = max(low, (-b - root) / a), min(high, (-b + root) / a)
    return high if low <= high else NONE


@part(inline="always")
def _cylinder_top(radius, half, ax, ay, az, square):
    """Top of a cylinder (half-length, unit axis) over the square."""
    x0, x1, y0, y1 = square
    rise = math.hypot(ax, ay)
    if rise * (radius + half) < UPRIGHT:
        dx, dy = max(x0, 0.0, -x1), max(y0, 0.0, -y1)
        return half if dx * dx + dy * dy < radius * radius else NONE
    best = NONE
    ux, uy = -az * ax / rise * radius, -az * ay / rise * radius
    for t in (-half, half):
        z = t * az + radius * rise
        best = _best_in_square(best, t * ax + ux, t * ay + uy, z, square)
    for side in range(4):  # one call of each: every copy of them takes the compiler a second
        is_far = side % 2 == 1
        if side < 2:
            across, along, at, start, end = ax, ay, x1 if is_far else x0, y0, y1
        else:  # the same with x and y exchanged
            across, along, at, start, end = ay, ax, y1 if is_far else y0, x0, x1
        best = max(best, _cut_top(radius, half, across, along, az, at, start, end))
        x, y = x1 if is_far else x0, y1 if side >= 2 else y0
        best = max(best, _line_top(radius, half, ax, ay, az, x, y))
    return best


@part(inline="always")
def _upright_box_top(mat, size, up, square):
    """Top of a box, one of whose axes points up or down: rectangles that overlap in the plane."""
    x0, x1, y0, y1 = square
    a, b = (up + 1) % 3, (up + 2) % 3
    ax, ay, bx, by = mat[a], mat[3 + a], mat[b], mat[3 + b]
    x, y, half_x, half_y = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2, (y1 - y0) / 2
    if (
        abs(x * ax + y * ay) >= size[a] + half_x * abs(ax) + half_y * abs(ay)
        or abs(x * bx + y * by) >= size[b] + half_x * abs(bx) + half_y * abs(by)
        or abs(x) >= half_x + size[a] * abs(ax) + size[b] * abs(bx)
        or abs(y) >= half_y + size[a] * abs(ay) + size[b] * abs(by)
    ):
        return NONE
    return size[up]


@part(inline="always")
def _box_top(mat, size, square, polygons):
    """Top of a box however it lies: that of its faces, each clipped to the square."""
    one, other = polygons.one, polygons.other
    best = NONE
    for face in range(6):
        axis, sign = face // 2, -1.0 if face % 2 else 1.0
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for corner in range(4):
            s = size[a] if corner in (1, 2) else -size[a]
            t = size[b] if corner >= 2 else -size[b]
            for k in range(3):
                one[corner, k] = (
                    sign * size[axis] * mat[3 * k + axis] + s * mat[3 * k + a] + t * mat[3 * k + b]
                )
        num = clip_between(one, np.int64(4), other, X, (square.x0, square.x1), one)
        num = clip_between(one, num, other, Y, (square.y0, square.y1), one)
        for i in range(num):
            best = max(best, one[i, 2])
    return best


@part(inline="always")
def _top(kind, mat, size, square, polygons):
    if kind == SPHERE:
        return _sphere_top(size[0], 0.0, 0.0, 0.0, square)
    if kind == BOX:
        longest = max(size[0], size[1], size[2])
        for axis in range(3):
            if math.hypot(mat[axis], mat[3 + axis]) * longest < UPRIGHT:
                return _upright_box_top(mat, size, axis, square)
        return _box_top(mat, size, square, polygons)
    if kind == ELLIPSOID:
        return _ellipsoid_top(mat, size, square)
    if kind not in (CYLINDER, CAPSULE):
        return NONE
    ax, ay, az = mat[2], mat[5], mat[8]
    best = _cylinder_top(size[0], size[1], ax, ay, az, square)
    for end in range(2 if kind == CAPSULE else 0):
        t = size[1] if end else -size[1]
        best = max(best, _sphere_top(size[0], t * ax, t * ay, t * az, square))
    return best


@part
def solid_span(solids, s, square, polygons):
    """The heights between which a solid is over a square, world frame; -inf twice if nowhere."""
    kind, pos, mat, size = solids.kind[s], solids.pos[s], solids.mat[s], solids.size[s]
    x0, x1, y0, y1 = square.x0 - pos[0], square.x1 - pos[0], square.y0 - pos[1], square.y1 - pos[1]
    high = NONE
    for way in range(2):
        top = _top(kind, mat, size, Square(x0, x1, y0, y1), polygons)
        if top == NONE or way == 1:
            break
        high = top
        x0, x1, y0, y1 = -x1, -x0, -y1, -y0
    return (NONE, NONE) if high == NONE else (pos[2] - top, pos[2] + high)


@part(inline="always")
def plane_span(planes, p, square):
    """The heights between which the half-space behind an infinite plane is over a square."""
    pos, mat = planes.pos[p], planes.mat[p]
    nx, ny, nz = mat[2], mat[5], mat[8]
    x = square.x0 if nx > 0.0 else square.x1  # the corner that lies deepest
    y = square.y0 if ny > 0.0 else square.y1
    depth = nx * (x - pos[0]) + ny * (y - pos[1])
    if abs(nz) < 1e-12:
        return (-math.inf, math.inf) if depth < 0.0 else (NONE, NONE)
    height = pos[2] - depth / nz
    return (-math.inf, height) if nz > 0.0 else (height, math.inf)


@part
def polygon_span(points, num):
    """The least and the greatest height of a polygon's corners."""
    low, high = points[0, 2], points[0, 2]
    for i in range(1, num):
        low, high = min(low, points[i, 2]), max(high, points[i, 2])
    return low, high
