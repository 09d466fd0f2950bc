"""Decide in closed form whether triangles, half-spaces and lines meet an upright prism.

Triangles are clipped to the prism, plane by plane (Sutherland and Hodgman, Reentrant polygon
clipping, 1974); half-spaces are tested by the prism's deepest point (the separating axis is their
normal). A shape that only touches a prism does not meet it, but for open surfaces, see
`facet_meets_prism`.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.core.arrays import HeightRange, Prism
from navbake.baker.core.constants import OPEN_SURFACE
from navbake.baker.core.tolerances import TOUCH_DEPTH
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float

# Room for a polygon's corners: a triangle that six planes have clipped has at most nine
MAX_CORNERS = 12
# Axes; for plain ints, numba would compile functions once for each
X = np.int64(0)
Y = np.int64(1)
Z = np.int64(2)
# In place of a geom's id: all geoms count
ANY_GEOM = np.int32(-1)


class Polygons(NamedTuple):
    """Room for clipping: a polygon is clipped from the first array into the second, then back.

    Attributes:
        first, second: corners, (MAX_CORNERS, 3) float64 [m].
    """

    first: Float
    second: Float


@subkernel
def make_polygons():
    """Allocate room for two polygons."""
    return Polygons(np.empty((MAX_CORNERS, 3)), np.empty((MAX_CORNERS, 3)))


@subkernel(inline="always")
def is_beside_prism(boxes, i, prism):
    """Return whether a box does not meet a prism: it is beside, above or below it, or touches it.

    Args:
        boxes: (n, 6) float64, lower corner, upper corner [m].
        i: index of the box.
        prism: the prism, as `Prism`; a round one counts as its square.
    """
    half = prism.half
    return (
        boxes[i, 0] >= prism.x + half
        or boxes[i, 3] <= prism.x - half
        or boxes[i, 1] >= prism.y + half
        or boxes[i, 4] <= prism.y - half
        or boxes[i, 2] >= prism.high
        or boxes[i, 5] <= prism.low
    )


@subkernel(inline="always")
def facet_meets_prism(facets, t, prism, polygons):
    """Return whether a triangle meets a prism.

    A triangle of a solid must reach TOUCH_DEPTH into the prism from the side. A triangle of an open
    surface (a sheet that encloses nothing) also counts up to TOUCH_DEPTH outside: otherwise a wall
    without thickness between two cells would meet neither.

    Args:
        facets: the triangles, as `Facets`.
        t: index of the triangle.
        prism: the prism, as `Prism`, already narrowed by TOUCH_DEPTH; for open surfaces it is
            widened here by twice that.
        polygons: room for clipping, see `make_polygons`.
    """
    margin = 2.0 * TOUCH_DEPTH if facets.closed[t] == OPEN_SURFACE else 0.0
    widened = Prism(prism.x, prism.y, prism.low, prism.high, prism.half + margin, prism.is_round)
    if is_beside_prism(facets.bounds, t, widened):  # true for most triangles
        return False
    return triangle_meets_prism(facets.corners[t], widened, polygons)


@subkernel(**NO_REFCOUNT)
def clip(points, num, out, axis, limit, sign):
    """Clip a polygon by a plane across an axis: keep where ``sign * (coordinate - limit) >= 0``.

    Args:
        points: corners, (>= num, 3) float64 [m].
        num: number of corners.
        out: receives the corners of the clipped polygon, (MAX_CORNERS, 3) float64.
        axis: which coordinate: X, Y or Z.
        limit: the limit [m].
        sign: 1 or -1.

    Returns:
        The number of corners of the clipped polygon; 0 if nothing is left.
    """
    num_out = 0
    for i in range(num):
        j = i + 1 if i + 1 < num else 0
        di = sign * (points[i, axis] - limit)
        dj = sign * (points[j, axis] - limit)
        if di >= 0.0:
            out[num_out, 0] = points[i, 0]
            out[num_out, 1] = points[i, 1]
            out[num_out, 2] = points[i, 2]
            num_out += 1
        # an edge that ends on the limit does not cross it: its end is a corner already
        if (di > 0.0 and dj < 0.0) or (di < 0.0 and dj > 0.0):
            t = di / (di - dj)
            for k in range(3):
                out[num_out, k] = points[i, k] + t * (points[j, k] - points[i, k])
            out[num_out, axis] = limit  # exactly, so that the next clip sees no rounding
            num_out += 1
    return num_out


@subkernel(**NO_REFCOUNT)
def clip_between(points, num, spare, axis, limits, out):
    """Clip a polygon to a range of a coordinate.

    Args:
        points: corners, (>= num, 3) float64 [m].
        num: number of corners.
        spare: room for a polygon in between, (MAX_CORNERS, 3) float64.
        axis: which coordinate: X, Y or Z.
        limits: the least and the greatest coordinate [m].
        out: receives the corners of the clipped polygon, (MAX_CORNERS, 3) float64; may be `points`.

    Returns:
        The number of corners of the clipped polygon; 0 if nothing is left.
    """
    num = clip(points, num, spare, axis, limits[0], 1.0)
    return clip(spare, num, out, axis, limits[1], -1.0)


@subkernel(inline="always")
def _disc_meets_polygon(points, num, prism):
    """Return whether a polygon, seen from above, overlaps a round prism's disc."""
    is_left_of_any = False
    is_right_of_any = False
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
        is_left_of_any = is_left_of_any or side > 0.0
        is_right_of_any = is_right_of_any or side < 0.0
    # the middle is on one side of all edges: it is inside of the polygon, which is convex
    return is_left_of_any != is_right_of_any


@subkernel(**NO_REFCOUNT)
def triangle_meets_prism(corners, prism, polygons):
    """Return whether a triangle meets a prism.

    Args:
        corners: (3, 3) float64 [m].
        prism: the prism, as `Prism`.
        polygons: room for clipping, see `make_polygons`.
    """
    polygon = polygons.first
    spare = polygons.second
    heights = (prism.low, prism.high)
    num = clip_between(corners, corners.shape[0], spare, Z, heights, polygon)
    if num == 0:
        return False
    if prism.is_round:
        return _disc_meets_polygon(polygon, num, prism)
    x = prism.x
    y = prism.y
    half = prism.half
    num = clip_between(polygon, num, spare, X, (x - half, x + half), polygon)
    return clip_between(polygon, num, spare, Y, (y - half, y + half), polygon) > 0


@subkernel(**NO_REFCOUNT)
def plane_meets_prism(planes, p, prism):
    """Return whether the half-space behind an infinite plane meets a prism.

    Args:
        planes: the planes, as `Planes`.
        p: index of the plane.
        prism: the prism, as `Prism`.
    """
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
def is_line_blocked(hits, cell, heights, geom):
    """Return whether a column's line crosses a geom in a range of heights, or runs inside of one.

    It runs inside of a geom if, above the range, it leaves geoms more often than it enters them.

    Args:
        hits: the columns, as `ColumnHits`.
        cell: index of the column.
        heights: the range, as `HeightRange`.
        geom: MuJoCo's id of the geom, or ANY_GEOM.
    """
    inside = 0
    for i in range(hits.start[cell + 1] - 1, hits.start[cell] - 1, -1):
        if hits.z[i] <= heights.low:
            break
        if geom != ANY_GEOM and hits.geom[i] != geom:
            continue
        if hits.z[i] < heights.high:
            return True
        if hits.closed[i]:
            inside += 1 if hits.normal[i, 2] > 0.0 else -1
    return inside > 0


@kernel(nogil=True)
def find_blocked_lines(cells, low, high, hits, blocked, first, end):
    """Test for several columns whether something is in the way between two heights.

    Something is in the way if the column's line crosses a geom there, or runs inside of one.

    Args:
        cells: index of the column of each test, (n,) int64.
        low, high: the two heights of each test, (n,) float64 [m].
        hits: the columns' hits, as `ColumnHits`.
        blocked: receives whether the line is blocked, (n,) bool.
        first, end: range of tests.
    """
    for n in range(first, end):
        blocked[n] = is_line_blocked(hits, cells[n], HeightRange(low[n], high[n]), ANY_GEOM)
