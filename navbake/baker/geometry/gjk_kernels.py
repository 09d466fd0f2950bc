"""Decide by iteration whether a convex solid meets an upright prism, with a proof.

Gilbert, Johnson and Keerthi, A fast procedure for computing the distance between complex objects
in three-dimensional space, 1988. Two convex sets meet where their Minkowski difference, all
points a - b, holds the origin. A simplex of at most four points of the difference moves towards
the origin: each step adds the support, the point of the difference that lies farthest in the
origin's direction, then keeps only the corners that the simplex' nearest point to the origin
needs. That point is found by the Voronoi regions of corners, edges and faces (Ericson, Real-Time
Collision Detection, 2005, 5.1 and 9.5) in place of Johnson's subalgorithm.

Let `v` be the vector from the origin to the simplex' nearest point. Both answers are proofs. APART:
even the support does not reach the plane through the origin perpendicular to `v`, so this plane
separates the two. MEETS: the origin is inside of a tetrahedron of the difference, or at most
CONTACT_DISTANCE from a point of it. If rounding prevents both (`v` grows, or a support is found
twice), the answer is UNDECIDED; the caller then asks FCL.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.core.constants import (
    APART,
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    MEETS,
    UNDECIDED,
)
from navbake.compiled import NO_REFCOUNT, subkernel
from navbake.types import Bool, Float

# The answer is UNDECIDED if this many steps have proved nothing
MAX_STEPS = 128
# Rounding alone may let the squared distance grow in a step by at most this fraction of itself
MAX_ROUNDING_GROWTH = 1e-3
# The solid and the prism meet if they are proved to be this near to each other, which is less than
# TOUCH_DEPTH [m]
CONTACT_DISTANCE = 1e-7


class Simplex(NamedTuple):
    """A simplex of points of the Minkowski difference, and room for reducing it.

    Attributes:
        points: the corners, (4, 3) float64 [m]; the first ones are valid.
        keep: which corners the nearest point of a face depends on, (4,) bool.
        best_keep: the value of `keep` for the nearest face so far, (4,) bool.
        v: the simplex' nearest point to the origin, (3,) float64 [m].
        trial: the nearest point to the origin of the face that is tried, (3,) float64 [m].
    """

    points: Float
    keep: Bool
    best_keep: Bool
    v: Float
    trial: Float


@subkernel
def make_simplex():
    """Allocate a simplex without points."""
    points = np.empty((4, 3))
    keep = np.zeros(4, np.bool_)
    best_keep = np.zeros(4, np.bool_)
    return Simplex(points, keep, best_keep, np.empty(3), np.empty(3))


@subkernel(inline="always")
def _support_solid(kind, pos, mat, size, dx, dy, dz, out):
    """Write the farthest point of a solid along a direction (dx, dy, dz) to `out`, (3,).

    The solid is given by MuJoCo's type, position, rotation matrix and size, see `Solids`.
    """
    # direction in the solid's own frame: transpose of the row-major matrix
    lx = mat[0] * dx + mat[3] * dy + mat[6] * dz
    ly = mat[1] * dx + mat[4] * dy + mat[7] * dz
    lz = mat[2] * dx + mat[5] * dy + mat[8] * dz
    px = 0.0
    py = 0.0
    pz = 0.0
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
        ax = size[0] * lx
        ay = size[1] * ly
        az = size[2] * lz
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


@subkernel(inline="always")
def _subtract_prism(prism, dx, dy, dz, out):
    """Subtract the prism's farthest point along a direction (dx, dy, dz) from `out`, (3,)."""
    if prism.is_round:
        across = math.sqrt(dx * dx + dy * dy)
        if across > 0.0:
            out[0] -= prism.x + prism.half * dx / across
            out[1] -= prism.y + prism.half * dy / across
        else:
            out[0] -= prism.x
            out[1] -= prism.y
    else:
        out[0] -= prism.x + (prism.half if dx > 0.0 else -prism.half)
        out[1] -= prism.y + (prism.half if dy > 0.0 else -prism.half)
    half_z = (prism.high - prism.low) / 2.0
    out[2] -= (prism.low + prism.high) / 2.0 + (half_z if dz > 0.0 else -half_z)


@subkernel(inline="always")
def _dot(a, b):
    """Return the dot product of two vectors of (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@subkernel(inline="always")
def _nearest_on_segment(a, b, keep, v):
    """Write a segment's nearest point to the origin to `v`, and to `keep` which ends it lies on.

    Both ends, a and b, are kept if the nearest point lies between them.
    """
    abx = b[0] - a[0]
    aby = b[1] - a[1]
    abz = b[2] - a[2]
    squared_length = abx * abx + aby * aby + abz * abz
    t = -(a[0] * abx + a[1] * aby + a[2] * abz)
    if t <= 0.0 or squared_length == 0.0:
        v[0] = a[0]
        v[1] = a[1]
        v[2] = a[2]
        keep[0] = True
        keep[1] = False
    elif t >= squared_length:
        v[0] = b[0]
        v[1] = b[1]
        v[2] = b[2]
        keep[0] = False
        keep[1] = True
    else:
        t /= squared_length
        v[0] = a[0] + t * abx
        v[1] = a[1] + t * aby
        v[2] = a[2] + t * abz
        keep[0] = True
        keep[1] = True


@subkernel(**NO_REFCOUNT)
def _nearest_on_triangle(a, b, c, keep, v):
    """Write a triangle's nearest point to the origin to `v`, and its corners to keep to `keep`.

    These are the corners a, b, c of which the nearest point is a mean: one, two of an edge, or all.
    The Voronoi regions of the corners, the edges and the face are tested in turn.
    """
    keep[0] = False
    keep[1] = False
    keep[2] = False
    abx = b[0] - a[0]
    aby = b[1] - a[1]
    abz = b[2] - a[2]
    acx = c[0] - a[0]
    acy = c[1] - a[1]
    acz = c[2] - a[2]
    # beyond a corner: both edges from it lead away from the origin
    d1 = -(abx * a[0] + aby * a[1] + abz * a[2])
    d2 = -(acx * a[0] + acy * a[1] + acz * a[2])
    if d1 <= 0.0 and d2 <= 0.0:
        v[0] = a[0]
        v[1] = a[1]
        v[2] = a[2]
        keep[0] = True
        return
    d3 = -(abx * b[0] + aby * b[1] + abz * b[2])
    d4 = -(acx * b[0] + acy * b[1] + acz * b[2])
    if d3 >= 0.0 and d4 <= d3:
        v[0] = b[0]
        v[1] = b[1]
        v[2] = b[2]
        keep[1] = True
        return
    d5 = -(abx * c[0] + aby * c[1] + abz * c[2])
    d6 = -(acx * c[0] + acy * c[1] + acz * c[2])
    if d6 >= 0.0 and d5 <= d6:
        v[0] = c[0]
        v[1] = c[1]
        v[2] = c[2]
        keep[2] = True
        return
    # beyond an edge: vc, vb, va are the areas that the foot of the origin spans with each edge
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        v[0] = a[0] + t * abx
        v[1] = a[1] + t * aby
        v[2] = a[2] + t * abz
        keep[0] = True
        keep[1] = True
        return
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        v[0] = a[0] + t * acx
        v[1] = a[1] + t * acy
        v[2] = a[2] + t * acz
        keep[0] = True
        keep[2] = True
        return
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v[0] = b[0] + t * (c[0] - b[0])
        v[1] = b[1] + t * (c[1] - b[1])
        v[2] = b[2] + t * (c[2] - b[2])
        keep[1] = True
        keep[2] = True
        return
    # inside: the foot of the origin on the plane, by the plane's normal
    nx = aby * acz - abz * acy
    ny = abz * acx - abx * acz
    nz = abx * acy - aby * acx
    scale = (a[0] * nx + a[1] * ny + a[2] * nz) / (nx * nx + ny * ny + nz * nz)
    v[0] = nx * scale
    v[1] = ny * scale
    v[2] = nz * scale
    keep[0] = True
    keep[1] = True
    keep[2] = True


@subkernel(inline="always")
def _origin_outside(a, b, c, d):
    """Return whether the origin is outside of the tetrahedron a, b, c, d, beyond its face a, b, c.

    It counts as outside if the tetrahedron is flat: d lies in the face's plane.
    """
    abx = b[0] - a[0]
    aby = b[1] - a[1]
    abz = b[2] - a[2]
    acx = c[0] - a[0]
    acy = c[1] - a[1]
    acz = c[2] - a[2]
    nx = aby * acz - abz * acy
    ny = abz * acx - abx * acz
    nz = abx * acy - aby * acx
    to_d = nx * (d[0] - a[0]) + ny * (d[1] - a[1]) + nz * (d[2] - a[2])
    to_origin = -(nx * a[0] + ny * a[1] + nz * a[2])
    if abs(to_d) <= 1e-12 * math.sqrt(nx * nx + ny * ny + nz * nz):
        return True  # flat: no volume to be inside of
    return to_d * to_origin <= 0.0


# The corners of a tetrahedron's faces, each followed by the opposite corner
TETRAHEDRON_FACES = np.array([[0, 1, 2, 3], [0, 1, 3, 2], [0, 2, 3, 1], [1, 2, 3, 0]])


@subkernel(inline="always")
def _nearest_on_faces(simplex, num):
    """Write the nearest point of a triangle or a tetrahedron to the origin to `simplex.v`.

    `num` is 3 or 4. Returns False if the origin is inside of the tetrahedron.
    """
    points = simplex.points
    best = math.inf
    outside = False
    for f in range(4 if num == 4 else 1):  # a triangle is the first face
        i = TETRAHEDRON_FACES[f, 0]
        j = TETRAHEDRON_FACES[f, 1]
        k = TETRAHEDRON_FACES[f, 2]
        m = TETRAHEDRON_FACES[f, 3]
        if num == 4 and not _origin_outside(points[i], points[j], points[k], points[m]):
            continue
        outside = True
        keep = simplex.keep
        trial = simplex.trial
        _nearest_on_triangle(points[i], points[j], points[k], keep, trial)
        distance = _dot(trial, trial)
        if num == 3 or distance < best:  # a triangle's may be NaN
            best = distance
            simplex.v[0] = trial[0]
            simplex.v[1] = trial[1]
            simplex.v[2] = trial[2]
            simplex.best_keep[i] = keep[0]
            simplex.best_keep[j] = keep[1]
            simplex.best_keep[k] = keep[2]
            simplex.best_keep[m] = False
    return outside


@subkernel(inline="always")
def _reduce(simplex, num):
    """Write the simplex' nearest point to the origin to `simplex.v`; drop unneeded corners.

    Returns how many of the `num` corners remain; 4 if the origin is inside of the tetrahedron.
    """
    points = simplex.points
    keep = simplex.keep
    v = simplex.v
    if num == 1:
        v[0] = points[0, 0]
        v[1] = points[0, 1]
        v[2] = points[0, 2]
        return 1
    if num == 2:
        keep[2] = False
        keep[3] = False
        _nearest_on_segment(points[0], points[1], keep, v)
    else:
        if not _nearest_on_faces(simplex, num):
            return 4
        for i in range(4):
            keep[i] = simplex.best_keep[i]
    num_remaining = 0
    for i in range(num):
        if keep[i]:
            points[num_remaining, 0] = points[i, 0]
            points[num_remaining, 1] = points[i, 1]
            points[num_remaining, 2] = points[i, 2]
            num_remaining += 1
    return num_remaining


@subkernel(**NO_REFCOUNT)
def gjk_meets_prism(solids, s, prism, simplex):
    """Decide by iteration whether a solid meets a prism.

    Args:
        solids: the solids, as `Solids`.
        s: index of the solid.
        prism: the prism, as `Prism`.
        simplex: room for the iteration, see `make_simplex`.

    Returns:
        APART or MEETS, which are proved, or UNDECIDED.
    """
    kind = solids.kind[s]
    pos = solids.pos[s]
    mat = solids.mat[s]
    size = solids.size[s]
    points = simplex.points
    v = simplex.v
    # the iteration may begin at any point of the difference: here the difference of the centres
    v[0] = pos[0] - prism.x
    v[1] = pos[1] - prism.y
    v[2] = pos[2] - (prism.low + prism.high) / 2.0
    if v[0] == 0.0 and v[1] == 0.0 and v[2] == 0.0:
        return MEETS  # both centres are inside
    num = 0
    last_distance = math.inf
    for _ in range(MAX_STEPS):
        w = points[num]
        _support_solid(kind, pos, mat, size, -v[0], -v[1], -v[2], w)
        _subtract_prism(prism, v[0], v[1], v[2], w)
        # all of the difference lies beyond the plane through w across v, the origin before it
        if _dot(v, w) > 1e-15 * math.sqrt(_dot(v, v)):
            return APART
        for i in range(num):
            if points[i, 0] == w[0] and points[i, 1] == w[1] and points[i, 2] == w[2]:
                return UNDECIDED  # the simplex cannot come nearer
        num = _reduce(simplex, num + 1)
        if num == 4:
            return MEETS
        distance = _dot(v, v)
        if distance < CONTACT_DISTANCE * CONTACT_DISTANCE:
            return MEETS  # v is a point of the difference
        if distance > last_distance * (1.0 + MAX_ROUNDING_GROWTH):
            return UNDECIDED
        last_distance = distance
    return UNDECIDED
