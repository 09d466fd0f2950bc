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
    """A simplex of points of the Minkowski difference, and scratch arrays for reducing it.

    Attributes:
        points: the corners, (4, 3) float64 [m]; the first ones are valid.
        is_corner_needed: which corners the nearest point of a face depends on, (4,) bool.
        is_needed_for_best_face: the value of `is_corner_needed` for the face that is the nearest so
            far, (4,) bool.
        nearest_point: the simplex' nearest point to the origin, (3,) float64 [m].
        trial_nearest_point: the nearest point to the origin of the face that is tried, (3,) float64
            [m].
    """

    points: Float
    is_corner_needed: Bool
    is_needed_for_best_face: Bool
    nearest_point: Float
    trial_nearest_point: Float


@subkernel
def allocate_simplex():
    """Allocate a simplex without points."""
    points = np.empty((4, 3))
    is_corner_needed = np.zeros(4, np.bool_)
    is_needed_for_best_face = np.zeros(4, np.bool_)
    return Simplex(points, is_corner_needed, is_needed_for_best_face, np.empty(3), np.empty(3))


@subkernel(inline="always")
def _write_solid_support(kind, pos, mat, size, dx, dy, dz, point):
    """Write the farthest point of a solid along a direction (dx, dy, dz) to `point`, (3,).

    The solid is given by MuJoCo's type, position, rotation matrix and size, see `Solids`.
    """
    # direction in the solid's own frame: transpose of the row-major matrix
    local_dx = mat[0] * dx + mat[3] * dy + mat[6] * dz
    local_dy = mat[1] * dx + mat[4] * dy + mat[7] * dz
    local_dz = mat[2] * dx + mat[5] * dy + mat[8] * dz
    px = 0.0
    py = 0.0
    pz = 0.0
    if kind == BOX:
        px = size[0] if local_dx > 0.0 else -size[0]
        py = size[1] if local_dy > 0.0 else -size[1]
        pz = size[2] if local_dz > 0.0 else -size[2]
    elif kind == CYLINDER:
        radial_length = math.sqrt(local_dx * local_dx + local_dy * local_dy)
        if radial_length > 0.0:
            px = size[0] * local_dx / radial_length
            py = size[0] * local_dy / radial_length
        pz = size[1] if local_dz > 0.0 else -size[1]
    elif kind == ELLIPSOID:
        scaled_dx = size[0] * local_dx
        scaled_dy = size[1] * local_dy
        scaled_dz = size[2] * local_dz
        norm = math.sqrt(scaled_dx * scaled_dx + scaled_dy * scaled_dy + scaled_dz * scaled_dz)
        if norm > 0.0:
            px = size[0] * scaled_dx / norm
            py = size[1] * scaled_dy / norm
            pz = size[2] * scaled_dz / norm
    else:
        norm = math.sqrt(local_dx * local_dx + local_dy * local_dy + local_dz * local_dz)
        if norm > 0.0:
            px = size[0] * local_dx / norm
            py = size[0] * local_dy / norm
            pz = size[0] * local_dz / norm
        if kind == CAPSULE:
            pz += size[1] if local_dz > 0.0 else -size[1]
    point[0] = pos[0] + mat[0] * px + mat[1] * py + mat[2] * pz
    point[1] = pos[1] + mat[3] * px + mat[4] * py + mat[5] * pz
    point[2] = pos[2] + mat[6] * px + mat[7] * py + mat[8] * pz


@subkernel(inline="always")
def _subtract_prism_support(prism, dx, dy, dz, difference):
    """Subtract a prism's farthest point along a direction (dx, dy, dz) from `difference`, (3,)."""
    if prism.is_round:
        horizontal_length = math.sqrt(dx * dx + dy * dy)
        if horizontal_length > 0.0:
            difference[0] -= prism.x + prism.half_width * dx / horizontal_length
            difference[1] -= prism.y + prism.half_width * dy / horizontal_length
        else:
            difference[0] -= prism.x
            difference[1] -= prism.y
    else:
        difference[0] -= prism.x + (prism.half_width if dx > 0.0 else -prism.half_width)
        difference[1] -= prism.y + (prism.half_width if dy > 0.0 else -prism.half_width)
    half_z = (prism.high - prism.low) / 2.0
    difference[2] -= (prism.low + prism.high) / 2.0 + (half_z if dz > 0.0 else -half_z)


@subkernel(inline="always")
def _dot(a, b):
    """Return the dot product of two vectors of (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@subkernel(inline="always")
def _write_nearest_on_segment(a, b, is_corner_needed, nearest_point):
    """Write a segment's nearest point to the origin to `nearest_point`, and mark its ends.

    In `is_corner_needed`, one of the ends a and b is marked if it is the nearest point; both are if
    that lies between.
    """
    abx = b[0] - a[0]
    aby = b[1] - a[1]
    abz = b[2] - a[2]
    squared_length = abx * abx + aby * aby + abz * abz
    fraction = -(a[0] * abx + a[1] * aby + a[2] * abz)
    if fraction <= 0.0 or squared_length == 0.0:
        nearest_point[0] = a[0]
        nearest_point[1] = a[1]
        nearest_point[2] = a[2]
        is_corner_needed[0] = True
        is_corner_needed[1] = False
    elif fraction >= squared_length:
        nearest_point[0] = b[0]
        nearest_point[1] = b[1]
        nearest_point[2] = b[2]
        is_corner_needed[0] = False
        is_corner_needed[1] = True
    else:
        fraction /= squared_length
        nearest_point[0] = a[0] + fraction * abx
        nearest_point[1] = a[1] + fraction * aby
        nearest_point[2] = a[2] + fraction * abz
        is_corner_needed[0] = True
        is_corner_needed[1] = True


@subkernel(**NO_REFCOUNT)
def _write_nearest_on_triangle(a, b, c, is_corner_needed, nearest_point):
    """Write a triangle's nearest point to the origin to `nearest_point`, and mark its corners.

    In `is_corner_needed`, those of the corners a, b, c are marked of which the nearest point is a
    mean: one, two of an edge, or all. The Voronoi regions of the corners, the edges and the face
    are tested in turn.
    """
    is_corner_needed[0] = False
    is_corner_needed[1] = False
    is_corner_needed[2] = False
    abx = b[0] - a[0]
    aby = b[1] - a[1]
    abz = b[2] - a[2]
    acx = c[0] - a[0]
    acy = c[1] - a[1]
    acz = c[2] - a[2]
    # beyond a corner: both edges from it lead away from the origin
    along_ab_from_a = -(abx * a[0] + aby * a[1] + abz * a[2])
    along_ac_from_a = -(acx * a[0] + acy * a[1] + acz * a[2])
    if along_ab_from_a <= 0.0 and along_ac_from_a <= 0.0:
        nearest_point[0] = a[0]
        nearest_point[1] = a[1]
        nearest_point[2] = a[2]
        is_corner_needed[0] = True
        return
    along_ab_from_b = -(abx * b[0] + aby * b[1] + abz * b[2])
    along_ac_from_b = -(acx * b[0] + acy * b[1] + acz * b[2])
    if along_ab_from_b >= 0.0 and along_ac_from_b <= along_ab_from_b:
        nearest_point[0] = b[0]
        nearest_point[1] = b[1]
        nearest_point[2] = b[2]
        is_corner_needed[1] = True
        return
    along_ab_from_c = -(abx * c[0] + aby * c[1] + abz * c[2])
    along_ac_from_c = -(acx * c[0] + acy * c[1] + acz * c[2])
    if along_ac_from_c >= 0.0 and along_ab_from_c <= along_ac_from_c:
        nearest_point[0] = c[0]
        nearest_point[1] = c[1]
        nearest_point[2] = c[2]
        is_corner_needed[2] = True
        return
    # beyond an edge: by the areas that the foot of the origin spans with each edge
    area_ab = along_ab_from_a * along_ac_from_b - along_ab_from_b * along_ac_from_a
    if area_ab <= 0.0 and along_ab_from_a >= 0.0 and along_ab_from_b <= 0.0:
        fraction = along_ab_from_a / (along_ab_from_a - along_ab_from_b)
        nearest_point[0] = a[0] + fraction * abx
        nearest_point[1] = a[1] + fraction * aby
        nearest_point[2] = a[2] + fraction * abz
        is_corner_needed[0] = True
        is_corner_needed[1] = True
        return
    area_ac = along_ab_from_c * along_ac_from_a - along_ab_from_a * along_ac_from_c
    if area_ac <= 0.0 and along_ac_from_a >= 0.0 and along_ac_from_c <= 0.0:
        fraction = along_ac_from_a / (along_ac_from_a - along_ac_from_c)
        nearest_point[0] = a[0] + fraction * acx
        nearest_point[1] = a[1] + fraction * acy
        nearest_point[2] = a[2] + fraction * acz
        is_corner_needed[0] = True
        is_corner_needed[2] = True
        return
    area_bc = along_ab_from_b * along_ac_from_c - along_ab_from_c * along_ac_from_b
    if area_bc <= 0.0 and along_ac_from_b >= along_ab_from_b and along_ab_from_c >= along_ac_from_c:
        fraction = (along_ac_from_b - along_ab_from_b) / (
            (along_ac_from_b - along_ab_from_b) + (along_ab_from_c - along_ac_from_c)
        )
        nearest_point[0] = b[0] + fraction * (c[0] - b[0])
        nearest_point[1] = b[1] + fraction * (c[1] - b[1])
        nearest_point[2] = b[2] + fraction * (c[2] - b[2])
        is_corner_needed[1] = True
        is_corner_needed[2] = True
        return
    # inside: the foot of the origin on the plane, by the plane's normal
    nx = aby * acz - abz * acy
    ny = abz * acx - abx * acz
    nz = abx * acy - aby * acx
    scale = (a[0] * nx + a[1] * ny + a[2] * nz) / (nx * nx + ny * ny + nz * nz)
    nearest_point[0] = nx * scale
    nearest_point[1] = ny * scale
    nearest_point[2] = nz * scale
    is_corner_needed[0] = True
    is_corner_needed[1] = True
    is_corner_needed[2] = True


@subkernel(inline="always")
def _is_origin_outside(a, b, c, d):
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
    side_of_d = nx * (d[0] - a[0]) + ny * (d[1] - a[1]) + nz * (d[2] - a[2])
    side_of_origin = -(nx * a[0] + ny * a[1] + nz * a[2])
    if abs(side_of_d) <= 1e-12 * math.sqrt(nx * nx + ny * ny + nz * nz):
        return True  # flat: no volume to be inside of
    return side_of_d * side_of_origin <= 0.0


# The corners of a tetrahedron's faces, each followed by the opposite corner
TETRAHEDRON_FACES = np.array([[0, 1, 2, 3], [0, 1, 3, 2], [0, 2, 3, 1], [1, 2, 3, 0]])


@subkernel(inline="always")
def _write_nearest_on_faces(simplex, num_corners):
    """Write a triangle's or a tetrahedron's nearest point to the origin to `simplex.nearest_point`.

    `num_corners` is 3 or 4. Returns False if the origin is inside of the tetrahedron.
    """
    points = simplex.points
    least_squared_distance = math.inf
    is_outside = False
    for face in range(4 if num_corners == 4 else 1):  # a triangle is the first face
        i = TETRAHEDRON_FACES[face, 0]
        j = TETRAHEDRON_FACES[face, 1]
        k = TETRAHEDRON_FACES[face, 2]
        opposite_corner = TETRAHEDRON_FACES[face, 3]
        if num_corners == 4 and not _is_origin_outside(
            points[i], points[j], points[k], points[opposite_corner]
        ):
            continue
        is_outside = True
        is_corner_needed = simplex.is_corner_needed
        trial_nearest_point = simplex.trial_nearest_point
        _write_nearest_on_triangle(
            points[i], points[j], points[k], is_corner_needed, trial_nearest_point
        )
        squared_distance = _dot(trial_nearest_point, trial_nearest_point)
        if num_corners == 3 or squared_distance < least_squared_distance:  # a triangle's may be NaN
            least_squared_distance = squared_distance
            simplex.nearest_point[0] = trial_nearest_point[0]
            simplex.nearest_point[1] = trial_nearest_point[1]
            simplex.nearest_point[2] = trial_nearest_point[2]
            simplex.is_needed_for_best_face[i] = is_corner_needed[0]
            simplex.is_needed_for_best_face[j] = is_corner_needed[1]
            simplex.is_needed_for_best_face[k] = is_corner_needed[2]
            simplex.is_needed_for_best_face[opposite_corner] = False
    return is_outside


@subkernel(inline="always")
def _reduce_simplex(simplex, num_corners):
    """Write the simplex' nearest point to the origin to its field; drop unneeded corners.

    Returns how many of the `num_corners` corners remain; 4 if the origin is inside of the
    tetrahedron.
    """
    points = simplex.points
    is_corner_needed = simplex.is_corner_needed
    nearest_point = simplex.nearest_point
    if num_corners == 1:
        nearest_point[0] = points[0, 0]
        nearest_point[1] = points[0, 1]
        nearest_point[2] = points[0, 2]
        return 1
    if num_corners == 2:
        is_corner_needed[2] = False
        is_corner_needed[3] = False
        _write_nearest_on_segment(points[0], points[1], is_corner_needed, nearest_point)
    else:
        if not _write_nearest_on_faces(simplex, num_corners):
            return 4
        for i in range(4):
            is_corner_needed[i] = simplex.is_needed_for_best_face[i]
    num_remaining = 0
    for i in range(num_corners):
        if is_corner_needed[i]:
            points[num_remaining, 0] = points[i, 0]
            points[num_remaining, 1] = points[i, 1]
            points[num_remaining, 2] = points[i, 2]
            num_remaining += 1
    return num_remaining


@subkernel(**NO_REFCOUNT)
def gjk_meets_prism(solids, solid, prism, simplex):
    """Decide by iteration whether a solid meets a prism.

    Args:
        solids: the solids, as `Solids`.
        solid: index of the solid.
        prism: the prism, as `Prism`.
        simplex: scratch for the iteration, see `allocate_simplex`.

    Returns:
        APART or MEETS, which are proved, or UNDECIDED.
    """
    kind = solids.kind[solid]
    pos = solids.pos[solid]
    mat = solids.mat[solid]
    size = solids.size[solid]
    points = simplex.points
    nearest_point = simplex.nearest_point
    # the iteration may begin at any point of the difference: here the difference of the centres
    nearest_point[0] = pos[0] - prism.x
    nearest_point[1] = pos[1] - prism.y
    nearest_point[2] = pos[2] - (prism.low + prism.high) / 2.0
    if nearest_point[0] == 0.0 and nearest_point[1] == 0.0 and nearest_point[2] == 0.0:
        return MEETS  # both centres are inside
    num_corners = 0
    last_squared_distance = math.inf
    for _ in range(MAX_STEPS):
        support_point = points[num_corners]
        _write_solid_support(
            kind,
            pos,
            mat,
            size,
            -nearest_point[0],
            -nearest_point[1],
            -nearest_point[2],
            support_point,
        )
        _subtract_prism_support(
            prism, nearest_point[0], nearest_point[1], nearest_point[2], support_point
        )
        # all of the difference lies beyond the plane through the support point across the vector
        # `nearest_point`, the origin before it
        if _dot(nearest_point, support_point) > 1e-15 * math.sqrt(
            _dot(nearest_point, nearest_point)
        ):
            return APART
        for i in range(num_corners):
            if (
                points[i, 0] == support_point[0]
                and points[i, 1] == support_point[1]
                and points[i, 2] == support_point[2]
            ):
                return UNDECIDED  # the simplex cannot come nearer
        num_corners = _reduce_simplex(simplex, num_corners + 1)
        if num_corners == 4:
            return MEETS
        squared_distance = _dot(nearest_point, nearest_point)
        if squared_distance < CONTACT_DISTANCE * CONTACT_DISTANCE:
            return MEETS  # v is a point of the difference
        if squared_distance > last_squared_distance * (1.0 + MAX_ROUNDING_GROWTH):
            return UNDECIDED
        last_squared_distance = squared_distance
    return UNDECIDED
