"""Decide whether a solid meets an upright prism: in closed form if possible, else by GJK.

For spheres, upright boxes and upright cylinders, the distance to a prism has a closed form. It
combines the distance of two figures in the plane (points, rectangles, discs) with the distance of
two intervals of height. For other cylinders, and capsules, there is a lower bound. `gjk_kernels`
decides the rest: distances that are 0 within rounding, and other leaning solids.
"""

import math

from navbake.baker.core.arrays import NOT_ROUND
from navbake.baker.core.constants import APART, BOX, CAPSULE, CYLINDER, MEETS, SPHERE
from navbake.baker.geometry.gjk_kernels import gjk_meets_prism
from navbake.compiled import NO_REFCOUNT, subkernel

MIN_PROVED_DISTANCE = 1e-9  # a gap or an overlap larger than this is not due to rounding [m]


@subkernel(inline="always")
def _point_distance(dx, dy, half_width, is_round):
    """Return the distance in the plane from a point to a square or a disc around the origin [m].

    It is 0 inside. `half_width` is half of the square's edge, or the disc's radius [m].
    """
    if is_round:
        return max(math.hypot(dx, dy) - half_width, 0.0)
    return math.hypot(max(abs(dx) - half_width, 0.0), max(abs(dy) - half_width, 0.0))


@subkernel(inline="always")
def _distance_from_above(solids, solid, upright_axis, dx, dy, half_width, is_round):
    """Return the distance from an upright box or cylinder to a prism, seen from above [m].

    It is negative if they overlap. For a box and a square prism it may be less than the distance.

    Args:
        solids: the solids, as `Solids`.
        solid: index of the solid.
        upright_axis: number of the solid's own axis that points up or down.
        dx, dy: the prism's axis, from the solid's centre [m].
        half_width: half of the prism's edge, or its radius [m].
        is_round: whether the prism is round.
    """
    mat = solids.mat[solid]
    size = solids.size[solid]
    if solids.kind[solid] == CYLINDER:
        if is_round:
            return math.hypot(dx, dy) - size[0] - half_width
        return _point_distance(dx, dy, half_width, NOT_ROUND) - size[0]
    first_axis = (upright_axis + 1) % 3
    second_axis = (upright_axis + 2) % 3
    ax = mat[first_axis]
    ay = mat[3 + first_axis]
    bx = mat[second_axis]
    by = mat[3 + second_axis]
    gap_along_first = abs(dx * ax + dy * ay) - size[first_axis]
    gap_along_second = abs(dx * bx + dy * by) - size[second_axis]
    if is_round:
        return math.hypot(max(gap_along_first, 0.0), max(gap_along_second, 0.0)) - half_width
    # two rectangles are apart when one of their four axes separates them
    distance = max(
        gap_along_first - half_width * (abs(ax) + abs(ay)),
        gap_along_second - half_width * (abs(bx) + abs(by)),
    )
    distance = max(
        distance, abs(dx) - half_width - abs(ax) * size[first_axis] - abs(bx) * size[second_axis]
    )
    return max(
        distance, abs(dy) - half_width - abs(ay) * size[first_axis] - abs(by) * size[second_axis]
    )


@subkernel(inline="always")
def _axis_distance_bound(solids, solid, prism, half_width, is_round):
    """Return a lower bound of the distance between a capsule or cylinder and a prism [m].

    It is used where the solid leans, and for capsules. It is negative only if the two overlap.

    Args:
        solids: the solids, as `Solids`.
        solid: index of the solid.
        prism: the prism, as `Prism`.
        half_width: half of the prism's edge, or its radius [m].
        is_round: whether the prism is round.
    """
    pos = solids.pos[solid]
    mat = solids.mat[solid]
    radius = solids.size[solid, 0]
    half_length = solids.size[solid, 1]
    dx = prism.x - pos[0]
    dy = prism.y - pos[1]
    ax = mat[2] * half_length
    ay = mat[5] * half_length
    az = mat[8] * half_length
    squared_plan_length = ax * ax + ay * ay  # of the axis seen from above
    # the point of the axis that is nearest to the prism's axis, seen from above
    axis_fraction = (
        min(max((dx * ax + dy * ay) / squared_plan_length, -1.0), 1.0)
        if squared_plan_length > 0.0
        else 0.0
    )
    px = dx - axis_fraction * ax
    py = dy - axis_fraction * ay
    pz = pos[2] + axis_fraction * az
    if solids.kind[solid] == CAPSULE:  # the ball around that point proves most overlaps
        height_distance = max(prism.low - pz, pz - prism.high, 0.0)
        distance = (
            math.hypot(_point_distance(px, py, half_width, is_round), height_distance) - radius
        )
        if distance < 0.0:
            return distance
    radius_sum = radius + (half_width if is_round else half_width * math.sqrt(2.0))
    return max(math.hypot(px, py) - radius_sum, 0.0)


@subkernel(inline="always")
def _distance_bound(solids, solid, prism, half_width, is_round):
    """Return a lower bound of the distance between a solid and a prism [m].

    It is negative only if the two overlap, and 0 if nothing is known.

    Args:
        solids: the solids, as `Solids`.
        solid: index of the solid.
        prism: the prism, as `Prism`.
        half_width: half of the prism's edge, or its radius [m].
        is_round: whether the prism is round.
    """
    kind = solids.kind[solid]
    pos = solids.pos[solid]
    dx = prism.x - pos[0]
    dy = prism.y - pos[1]
    if kind == SPHERE:
        height_distance = max(prism.low - pos[2], pos[2] - prism.high, 0.0)
        return (
            math.hypot(_point_distance(dx, dy, half_width, is_round), height_distance)
            - solids.size[solid, 0]
        )
    for axis in range(3):
        is_upright = abs(solids.mat[solid, 6 + axis]) >= 1.0 - 1e-12
        if is_upright and (kind == BOX or (kind == CYLINDER and axis == 2)):
            height_distance = max(
                solids.bounds[solid, 2] - prism.high, prism.low - solids.bounds[solid, 5]
            )
            return max(
                _distance_from_above(solids, solid, axis, dx, dy, half_width, is_round),
                height_distance,
            )
    if kind in (CAPSULE, CYLINDER):
        return _axis_distance_bound(solids, solid, prism, half_width, is_round)
    return 0.0


@subkernel(**NO_REFCOUNT)
def solid_meets_prism(solids, solid, prism, simplex):
    """Decide whether a solid meets a prism.

    Args:
        solids: the solids, as `Solids`.
        solid: index of the solid.
        prism: the prism, as `Prism`.
        simplex: scratch for the iteration of GJK, see `allocate_simplex`.

    Returns:
        APART, MEETS or UNDECIDED.
    """
    distance_bound = _distance_bound(solids, solid, prism, prism.half_width, prism.is_round)
    if abs(distance_bound) > MIN_PROVED_DISTANCE:
        return APART if distance_bound > 0.0 else MEETS
    return gjk_meets_prism(solids, solid, prism, simplex)
