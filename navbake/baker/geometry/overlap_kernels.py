"""Triangles, half-spaces and a cell's own line against an upright prism: no iteration needed.

Triangles are clipped to the prism, plane by plane (Sutherland and Hodgman, Reentrant polygon
clipping, 1974); half-spaces are tested by the prism's deepest point (the separating axis is their
normal). A prism is open: what only touches it is outside. For triangles that enclose nothing its
sides are closed, or a wall without thickness between two cells would meet neither.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.core.arrays import HeightRange, Prism
from navbake.baker.core.constants import OPEN_SURFACE
from navbake.baker.core.tolerances import TOUCH_DEPTH
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float

# A triangle has at most nine corners when six planes have clipped it
MOST_CORNERS = 12
# Axes; plain integers would compile what takes them once for each
X = np.int64(0)
Y = np.int64(1)
Z = np.int64(2)
ANY_GEOM = np.int32(-1)


class Polygons(NamedTuple):
    """Room for two polygons, which clipping works to and fro between."""

    one: Float
    other: Float


@subkernel
def make_polygons():
    """Empty room for two polygons, (12, 3) float64 each."""
    return Polygons(np.empty((MOST_CORNERS, 3)), np.empty((MOST_CORNERS, 3)))


@subkernel(inline="always")
def is_beside_prism(boxes, i, prism):
    """Whether a box is beside a prism; touching is beside it."""
    reach = prism.half
    return (
        boxes[i, 0] >= prism.x + reach
        or boxes[i, 3] <= prism.x - reach
        or boxes[i, 1] >= prism.y + reach
        or boxes[i, 4] <= prism.y - reach
        or boxes[i, 2] >= prism.high
        or boxes[i, 5] <= prism.low
    )


@subkernel(inline="always")
def facet_meets_prism(facets, t, prism, polygons):
    """Does a triangle meet a prism; or, if it encloses nothing, the prism with closed sides?

    Prisms are narrowed by TOUCH_DEPTH; closed sides are widened by it.
    """
    edge = 2.0 * TOUCH_DEPTH if facets.closed[t] == OPEN_SURFACE else 0.0
    asked = Prism(prism.x, prism.y, prism.low, prism.high, prism.half + edge, prism.is_round)
    if is_beside_prism(facets.bounds, t, asked):  # most are
        return False
    return triangle_meets_prism(facets.corners[t], asked, polygons)


@subkernel(**NO_REFCOUNT)
def clip(points, num, out, axis, limit, sign):
    """Keep the part of a polygon where ``sign * (coordinate - limit) >= 0``.

    `points` and `out` are (>= num, 3) float64. Returns how many corners the part has; 0 for none.
    """
    kept = 0
    for i in range(num):
        j = i + 1 if i + 1 < num else 0
        di = sign * (points[i, axis] - limit)
        dj = sign * (points[j, axis] - limit)
        if di >= 0.0:
            out[kept, 0] = points[i, 0]
            out[kept, 1] = points[i, 1]
            out[kept, 2] = points[i, 2]
            kept += 1
        # an edge that ends on the limit crosses nothing: that corner is kept by itself
        if (di > 0.0 and dj < 0.0) or (di < 0.0 and dj > 0.0):
            t = di / (di - dj)
            for k in range(3):
                out[kept, k] = points[i, k] + t * (points[j, k] - points[i, k])
            out[kept, axis] = limit  # exactly, so that the next clip sees no rounding
            kept += 1
    return kept


@subkernel(**NO_REFCOUNT)
def clip_between(points, num, spare, axis, band, out):
    """Keep the part of a polygon between two limits of a coordinate; `out` may be `points`."""
    num = clip(points, num, spare, axis, band[0], 1.0)
    return clip(spare, num, out, axis, band[1], -1.0)


@subkernel(inline="always")
def _disc_meets_polygon(points, num, prism):
    """Whether a polygon, seen from above, comes nearer to the disc's middle than its radius."""
    left = False
    right = False
    for i in range(num):
        j = i + 1 if i + 1 < num else 0
        ax = points[i, 0] - prism.x
        ay = points[i, 1] - prism.y
        ex = points[j, 0] - points[i, 0]
        ey = points[j, 1] - points[i, 1]
        length = ex * ex + ey * ey
        t = 0.0
        if length > 0.0:
            t = min(max(-(ax * ex + ay * ey) / length, 0.0), 1.0)
        dx = ax + t * ex
        dy = ay + t * ey
        if dx * dx + dy * dy < prism.half * prism.half:
            return True
        side = ex * ay - ey * ax
        left = left or side > 0.0
        right = right or side < 0.0
    # on one side of all edges: the middle is inside (the polygon is convex)
    return (left or right) and not (left and right)


@subkernel(**NO_REFCOUNT)
def triangle_meets_prism(corners, prism, polygons):
    """Does a triangle, (3, 3) float64 [m], meet a prism? The polygons are scratch."""
    one = polygons.one
    other = polygons.other
    num = clip_between(corners, corners.shape[0], other, Z, (prism.low, prism.high), one)
    if num == 0:
        return False
    if prism.is_round:
        return _disc_meets_polygon(one, num, prism)
    x = prism.x
    y = prism.y
    half = prism.half
    num = clip_between(one, num, other, X, (x - half, x + half), one)
    return clip_between(one, num, other, Y, (y - half, y + half), one) > 0


@subkernel(**NO_REFCOUNT)
def plane_meets_prism(planes, p, prism):
    """Does the half-space behind an infinite plane meet a prism?"""
    pos = planes.pos[p]
    mat = planes.mat[p]
    nx = mat[2]
    ny = mat[5]
    nz = mat[8]
    middle = (prism.low + prism.high) / 2.0
    half_z = (prism.high - prism.low) / 2.0
    depth = nx * (prism.x - pos[0]) + ny * (prism.y - pos[1]) + nz * (middle - pos[2])
    depth -= abs(nz) * half_z
    # how far the disc's rim or the square's corner reaches against the normal
    across = math.sqrt(nx * nx + ny * ny) if prism.is_round else abs(nx) + abs(ny)
    return depth - prism.half * across < 0.0


@subkernel(**NO_REFCOUNT)
def is_line_blocked(hits, cell, band, only):
    """Whether a cell's line crosses a geom in a `HeightRange`, or runs inside of one there.

    It runs inside where the winding number of its ray up is positive. `only` is the geom, or
    ANY_GEOM.
    """
    inside = 0
    for i in range(hits.start[cell + 1] - 1, hits.start[cell] - 1, -1):
        if hits.z[i] <= band.low:
            break
        if only != ANY_GEOM and hits.geom[i] != only:
            continue
        if hits.z[i] < band.high:
            return True
        if hits.closed[i]:
            inside += 1 if hits.normal[i, 2] > 0.0 else -1
    return inside > 0


@kernel(nogil=True)
def find_blocked_lines(cells, low, high, hits, out, first, end):
    """Whether each cell's line alone proves that something is between two heights [m], into out."""
    for n in range(first, end):
        out[n] = is_line_blocked(hits, cells[n], HeightRange(low[n], high[n]), ANY_GEOM)
