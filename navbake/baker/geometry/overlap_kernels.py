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
from navbake.baker.core.bisection_kernels import find_first_above
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


class Polygons(NamedTuple):
    """Scratch arrays for clipping: a polygon is clipped from one array into the other, then back.

    Attributes:
        polygon: corners of the polygon, (MAX_CORNERS, 3) float64 [m].
        scratch_polygon: corners of the polygon in between, (MAX_CORNERS, 3) float64 [m].
    """

    polygon: Float
    scratch_polygon: Float


@subkernel
def allocate_polygons():
    """Allocate the scratch arrays for clipping."""
    return Polygons(np.empty((MAX_CORNERS, 3)), np.empty((MAX_CORNERS, 3)))


@subkernel(inline="always")
def is_beside_prism(boxes, box, prism):
    """Return whether a box lies beside, above or below a prism; it may touch the prism.

    Args:
        boxes: (n, 6) float64, lower corner, upper corner [m].
        box: index of the box.
        prism: the prism, as `Prism`; a round one counts as its square.
    """
    half_width = prism.half_width
    return (
        boxes[box, 0] >= prism.x + half_width
        or boxes[box, 3] <= prism.x - half_width
        or boxes[box, 1] >= prism.y + half_width
        or boxes[box, 4] <= prism.y - half_width
        or boxes[box, 2] >= prism.high
        or boxes[box, 5] <= prism.low
    )


@subkernel(inline="always")
def facet_meets_prism(facets, triangle, triangle_copy, prism, polygons):
    """Return whether a triangle meets a prism.

    A triangle of a solid must reach TOUCH_DEPTH into the prism from the side. A triangle of an open
    surface (a sheet that encloses nothing) also counts up to TOUCH_DEPTH outside: otherwise a wall
    without thickness between two cells would meet neither.

    Args:
        facets: the triangles, as `Facets`.
        triangle: index of the triangle.
        triangle_copy: its copy, as `TriangleCopy`.
        prism: the prism, as `Prism`, already narrowed by TOUCH_DEPTH; for open surfaces it is
            widened here by twice that.
        polygons: room for clipping, see `allocate_polygons`.
    """
    margin = 2.0 * TOUCH_DEPTH if facets.closed[triangle] == OPEN_SURFACE else 0.0
    widened_prism = Prism(
        prism.x, prism.y, prism.low, prism.high, prism.half_width + margin, prism.is_round
    )
    if is_beside_prism(triangle_copy.box, 0, widened_prism):  # true for most triangles
        return False
    return triangle_meets_prism(triangle_copy.corners, widened_prism, polygons)


@subkernel(**NO_REFCOUNT)
def clip_polygon(corners, num_corners, clipped_corners, axis, limit, sign):
    """Clip a polygon by a plane across an axis: keep where ``sign * (coordinate - limit) >= 0``.

    Args:
        corners: the polygon's corners, (>= num_corners, 3) float64 [m].
        num_corners: number of corners.
        clipped_corners: receives the corners of the clipped polygon, (MAX_CORNERS, 3) float64.
        axis: which coordinate: X, Y or Z.
        limit: the limit [m].
        sign: 1 or -1.

    Returns:
        The number of corners of the clipped polygon; 0 if nothing is left.
    """
    num_clipped = 0
    for i in range(num_corners):
        j = i + 1 if i + 1 < num_corners else 0
        start_offset = sign * (corners[i, axis] - limit)
        end_offset = sign * (corners[j, axis] - limit)
        if start_offset >= 0.0:
            clipped_corners[num_clipped, 0] = corners[i, 0]
            clipped_corners[num_clipped, 1] = corners[i, 1]
            clipped_corners[num_clipped, 2] = corners[i, 2]
            num_clipped += 1
        # an edge that ends on the limit does not cross it: its end is a corner already
        if (start_offset > 0.0 and end_offset < 0.0) or (start_offset < 0.0 and end_offset > 0.0):
            edge_fraction = start_offset / (start_offset - end_offset)
            for k in range(3):
                clipped_corners[num_clipped, k] = corners[i, k] + edge_fraction * (
                    corners[j, k] - corners[i, k]
                )
            clipped_corners[num_clipped, axis] = (
                limit  # exactly, so that the next clip sees no rounding
            )
            num_clipped += 1
    return num_clipped


@subkernel(**NO_REFCOUNT)
def clip_polygon_between(corners, num_corners, scratch, axis, limits, clipped_corners):
    """Clip a polygon to a range of a coordinate.

    Args:
        corners: the polygon's corners, (>= num_corners, 3) float64 [m].
        num_corners: number of corners.
        scratch: room for a polygon in between, (MAX_CORNERS, 3) float64.
        axis: which coordinate: X, Y or Z.
        limits: the least and the greatest coordinate [m].
        clipped_corners: receives the corners of the clipped polygon, (MAX_CORNERS, 3) float64; may
            be `corners`.

    Returns:
        The number of corners of the clipped polygon; 0 if nothing is left.
    """
    num_corners = clip_polygon(corners, num_corners, scratch, axis, limits[0], 1.0)
    return clip_polygon(scratch, num_corners, clipped_corners, axis, limits[1], -1.0)


@subkernel(inline="always")
def _disc_meets_polygon(corners, num_corners, prism):
    """Return whether a polygon, seen from above, overlaps a round prism's disc."""
    is_left_of_any = False
    is_right_of_any = False
    for i in range(num_corners):
        j = i + 1 if i + 1 < num_corners else 0
        corner_dx = corners[i, 0] - prism.x
        corner_dy = corners[i, 1] - prism.y
        edge_x = corners[j, 0] - corners[i, 0]
        edge_y = corners[j, 1] - corners[i, 1]
        squared_length = edge_x * edge_x + edge_y * edge_y
        edge_fraction = 0.0
        if squared_length > 0.0:
            edge_fraction = min(
                max(-(corner_dx * edge_x + corner_dy * edge_y) / squared_length, 0.0), 1.0
            )
        dx = corner_dx + edge_fraction * edge_x
        dy = corner_dy + edge_fraction * edge_y
        if dx * dx + dy * dy < prism.half_width * prism.half_width:
            return True
        side_sign = edge_x * corner_dy - edge_y * corner_dx
        is_left_of_any = is_left_of_any or side_sign > 0.0
        is_right_of_any = is_right_of_any or side_sign < 0.0
    # the middle is on one side of all edges: it is inside of the polygon, which is convex
    return is_left_of_any != is_right_of_any


@subkernel(**NO_REFCOUNT)
def triangle_meets_prism(corners, prism, polygons):
    """Return whether a triangle meets a prism.

    Args:
        corners: (3, 3) float64 [m].
        prism: the prism, as `Prism`.
        polygons: room for clipping, see `allocate_polygons`.
    """
    polygon = polygons.polygon
    scratch = polygons.scratch_polygon
    height_limits = (prism.low, prism.high)
    num_corners = clip_polygon_between(
        corners, corners.shape[0], scratch, Z, height_limits, polygon
    )
    if num_corners == 0:
        return False
    if prism.is_round:
        return _disc_meets_polygon(polygon, num_corners, prism)
    x = prism.x
    y = prism.y
    half_width = prism.half_width
    num_corners = clip_polygon_between(
        polygon, num_corners, scratch, X, (x - half_width, x + half_width), polygon
    )
    return (
        clip_polygon_between(
            polygon, num_corners, scratch, Y, (y - half_width, y + half_width), polygon
        )
        > 0
    )


@subkernel(**NO_REFCOUNT)
def plane_meets_prism(planes, plane, prism):
    """Return whether the half-space behind an infinite plane meets a prism.

    Args:
        planes: the planes, as `Planes`.
        plane: index of the plane.
        prism: the prism, as `Prism`.
    """
    pos = planes.pos[plane]
    mat = planes.mat[plane]
    nx = mat[2]
    ny = mat[5]
    nz = mat[8]
    middle_z = (prism.low + prism.high) / 2.0
    half_z = (prism.high - prism.low) / 2.0
    depth = nx * (prism.x - pos[0]) + ny * (prism.y - pos[1]) + nz * (middle_z - pos[2])
    depth -= abs(nz) * half_z
    # how far the disc's rim or the square's corner reaches against the normal
    reach = math.sqrt(nx * nx + ny * ny) if prism.is_round else abs(nx) + abs(ny)
    return depth - prism.half_width * reach < 0.0


@subkernel(**NO_REFCOUNT)
def count_most_hits(hits, cells, first_index, end_index):
    """Return the largest number of hits in a column of some cells.

    Args:
        hits: the columns, as `ColumnHits`.
        cells: cell ids, (n,) int64.
        first_index: index of the first of the cells to look at.
        end_index: index past the last of them.
    """
    most_hits = np.int64(0)
    for i in range(first_index, end_index):
        num_hits = hits.start[cells[i] + 1] - hits.start[cells[i]]
        most_hits = max(most_hits, num_hits)
    return most_hits


@subkernel(**NO_REFCOUNT)
def count_enclosing(hits, cell, num_enclosing):
    """Count how many closed shapes a column's line is inside of, just below each of its hits.

    They are counted from above: a line that leaves a shape there had entered it below.

    Args:
        hits: the columns, as `ColumnHits`.
        cell: index of the column.
        num_enclosing: receives the counts, and a 0 after them; int64, with room for a number more
            than the column has hits.
    """
    first_hit = hits.start[cell]
    num_hits = hits.start[cell + 1] - first_hit
    num_enclosing[num_hits] = 0
    for hit_in_column in range(num_hits - 1, -1, -1):
        winding = 0
        if hits.closed[first_hit + hit_in_column]:
            winding = 1 if hits.normal[first_hit + hit_in_column, 2] > 0.0 else -1
        num_enclosing[hit_in_column] = num_enclosing[hit_in_column + 1] + winding


@subkernel(**NO_REFCOUNT)
def is_line_blocked(hits, cell, heights, num_enclosing, first_hit_above):
    """Return whether a column's line crosses a geom in a range of heights, or runs inside of one.

    Args:
        hits: the columns, as `ColumnHits`.
        cell: index of the column.
        heights: the range, as `HeightRange`; its ends don't belong to it.
        num_enclosing: the column's counts, see `count_enclosing`.
        first_hit_above: index of the column's first hit above the lower end of the range.
    """
    if first_hit_above < hits.start[cell + 1] and hits.z[first_hit_above] < heights.high:
        return True
    return num_enclosing[first_hit_above - hits.start[cell]] > 0


@kernel(nogil=True)
def find_blocked_lines(cells, low_z, high_z, hits, is_blocked, first_test, end_test):
    """Test for several columns whether something is in the way between two heights.

    Something is in the way if the column's line crosses a geom there, or runs inside of one.

    Args:
        cells: index of the column of each test, (n,) int64. It is fastest if the tests of a column
            follow each other.
        low_z: the lower height of each test, (n,) float64 [m].
        high_z: the upper height of each test, (n,) float64 [m].
        hits: the columns' hits, as `ColumnHits`.
        is_blocked: receives whether the line is blocked, (n,) bool.
        first_test: index of the first test.
        end_test: index past the last test.
    """
    most_hits = count_most_hits(hits, cells, first_test, end_test)
    num_enclosing = np.empty(most_hits + 1, np.int64)
    for test_index in range(first_test, end_test):
        if test_index == first_test or cells[test_index] != cells[test_index - 1]:
            count_enclosing(hits, cells[test_index], num_enclosing)
        cell = cells[test_index]
        heights = HeightRange(low_z[test_index], high_z[test_index])
        first_hit_above = find_first_above(
            hits.z, hits.start[cell], hits.start[cell + 1], heights.low
        )
        is_blocked[test_index] = is_line_blocked(
            hits, cell, heights, num_enclosing, first_hit_above
        )
