"""Computes normals, areas, volumes and extents of many triangles in one pass.

No temporary arrays are made. Operations have the same order as in numpy's cross product and norm,
so that results are equal bit by bit.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float

QUARTER_TURN = math.pi / 2  # [rad]
# A triangle counts as vertical if its unit normal's z is below this
MAX_VERTICAL_NORMAL_Z = 1e-9


class TriangleCopy(NamedTuple):
    """A copy of one of the triangles of `Facets`, with the box around it.

    Attributes:
        corners: (3, 3) float64 [m].
        box: lower corner, upper corner, (1, 6) float64 [m].
    """

    corners: Float
    box: Float


@subkernel(inline="always")
def area_normal(a, b, c):
    """Return x, y and z of the normal of a triangle, as long as twice its area."""
    ux = b[0] - a[0]
    uy = b[1] - a[1]
    uz = b[2] - a[2]
    vx = c[0] - a[0]
    vy = c[1] - a[1]
    vz = c[2] - a[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@subkernel(inline="always")
def _length(x, y, z):
    """Return the length of a vector."""
    return math.sqrt(x * x + y * y + z * z)


@subkernel(**NO_REFCOUNT)
def unit_normal(a, b, c):
    """Return x, y and z of a triangle's unit normal.

    z is 0 for vertical triangles; all are 0 for triangles without area.

    Args:
        a, b, c: the triangle's corners, (3,) float64 each [m].
    """
    x, y, z = area_normal(a, b, c)
    length = _length(x, y, z)
    if not length > 0.0:
        return 0.0, 0.0, 0.0
    normal_z = z / length
    return x / length, y / length, 0.0 if abs(normal_z) < MAX_VERTICAL_NORMAL_Z else normal_z


@subkernel
def allocate_triangle():
    """Allocate a `TriangleCopy`."""
    return TriangleCopy(np.empty((3, 3)), np.empty((1, 6)))


@subkernel(**NO_REFCOUNT)
def copy_triangle(facets, triangle, triangle_copy):
    """Copy the corners of a triangle, and measure the box around it.

    Args:
        facets: the triangles, as `Facets`.
        triangle: index of the triangle.
        triangle_copy: receives the copy.
    """
    corners = triangle_copy.corners
    box = triangle_copy.box
    vertices = facets.vertices
    a = facets.faces[triangle, 0]
    b = facets.faces[triangle, 1]
    c = facets.faces[triangle, 2]
    for k in range(3):
        corners[0, k] = vertices[a, k]
        corners[1, k] = vertices[b, k]
        corners[2, k] = vertices[c, k]
        box[0, k] = min(vertices[a, k], vertices[b, k], vertices[c, k])
        box[0, 3 + k] = max(vertices[a, k], vertices[b, k], vertices[c, k])


@subkernel(**NO_REFCOUNT)
def faces_up(facets, triangle):
    """Return whether a triangle faces up, however steep it is; `facets` are `Facets`."""
    vertices = facets.vertices
    a = facets.faces[triangle, 0]
    b = facets.faces[triangle, 1]
    c = facets.faces[triangle, 2]
    ux = vertices[b, 0] - vertices[a, 0]
    uy = vertices[b, 1] - vertices[a, 1]
    vx = vertices[c, 0] - vertices[a, 0]
    vy = vertices[c, 1] - vertices[a, 1]
    return ux * vy - uy * vx > 0.0


@kernel(nogil=True, **NO_REFCOUNT)
def measure_boxes(vertices, faces, boxes):
    """Measure the boxes around triangles.

    Args:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, (m, 3) int32.
        boxes: receives the box around each triangle: lower corner, upper corner, (>= m, 6) float64
            [m].
    """
    for face in range(faces.shape[0]):
        a = faces[face, 0]
        b = faces[face, 1]
        c = faces[face, 2]
        for k in range(3):
            boxes[face, k] = min(vertices[a, k], vertices[b, k], vertices[c, k])
            boxes[face, 3 + k] = max(vertices[a, k], vertices[b, k], vertices[c, k])


@kernel(nogil=True, **NO_REFCOUNT)
def measure_areas(vertices, faces, area, first_triangle, end_triangle):
    """Compute the areas of triangles ``range(first_triangle, end_triangle)``.

    Args:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, (m, 3) int32.
        area: receives the areas, (m,) float64 [m²].
        first_triangle: index of the first triangle.
        end_triangle: index past the last one.
    """
    for face in range(first_triangle, end_triangle):
        x, y, z = area_normal(
            vertices[faces[face, 0]], vertices[faces[face, 1]], vertices[faces[face, 2]]
        )
        area[face] = _length(x, y, z) / 2.0


@kernel
def describe_triangles(vertices, faces):
    """Compute the centres, unit normals and areas of triangles.

    Args:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, (m, 3) int32.

    Returns:
        Centres, (m, 3) [m]; unit normals, (m, 3); and areas, (m,) [m²]; float64.
    """
    center = np.empty((faces.shape[0], 3))
    normal = np.empty((faces.shape[0], 3))
    area = np.empty(faces.shape[0])
    for face in range(faces.shape[0]):
        a = vertices[faces[face, 0]]
        b = vertices[faces[face, 1]]
        c = vertices[faces[face, 2]]
        cross_product = area_normal(a, b, c)
        length = _length(cross_product[0], cross_product[1], cross_product[2])
        area[face] = length / 2
        for k in range(3):
            center[face, k] = (a[k] + b[k] + c[k]) / 3
            normal[face, k] = cross_product[k] / max(length, 1e-300)
    return center, normal, area


@kernel(nogil=True, **NO_REFCOUNT)
def measure_part_volumes(
    vertices, faces, is_flipped, part_of_face, volume, area, first_part, end_part
):
    """Sum up the volumes and areas of parts ``range(first_part, end_part)`` of a mesh.

    Triangles are added in their order.

    Args:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, (m, 3) int32.
        is_flipped: which triangles count as facing the other way, (m,) bool.
        part_of_face: the part that each triangle belongs to, (m,) int32.
        volume: zeros, one for each part; receives the volume, positive for parts that face out,
            float64 [m³].
        area: zeros, one for each part; receives the area, float64 [m²].
        first_part: number of the first part.
        end_part: number past the last one.
    """
    origin = vertices[faces[0, 0]]
    current_part = np.int64(first_part)
    volume_sum = 0.0
    area_sum = 0.0
    for face in range(faces.shape[0]):
        face_part = np.int64(part_of_face[face])
        if not first_part <= face_part < end_part:
            continue
        if (
            face_part != current_part
        ):  # most triangles follow others of their part: sums stay in registers
            volume[current_part] = volume_sum
            area[current_part] = area_sum
            current_part = face_part
            volume_sum = volume[face_part]
            area_sum = area[face_part]
        first_corner = 2 if is_flipped[face] else 0
        a = vertices[faces[face, first_corner]]
        b = vertices[faces[face, 1]]
        c = vertices[faces[face, 2 - first_corner]]
        x, y, z = area_normal(a, b, c)
        # from a corner of the mesh, so that rounding doesn't grow with the distance to the origin
        ox = a[0] - origin[0]
        oy = a[1] - origin[1]
        oz = a[2] - origin[2]
        volume_sum += (ox * x + oy * y + oz * z) / 6.0
        area_sum += _length(x, y, z) / 2.0
    volume[current_part] = volume_sum
    area[current_part] = area_sum


@kernel(nogil=True, **NO_REFCOUNT)
def bound_parts(
    vertices, faces, is_flipped, part_of_face, part_boxes, largest_area, largest_triangle
):
    """Find the box and the largest triangle of each part of a mesh.

    Args:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, (m, 3) int32.
        is_flipped: which triangles count as facing the other way, (m,) bool.
        part_of_face: the part that each triangle belongs to, (m,) int32.
        part_boxes: receives the lower and the upper corner of each part's box, (parts, 6) [m]; the
            caller fills it with inf and -inf.
        largest_area: receives twice the area of each part's largest triangle, (parts,) [m²]; the
            caller fills it with a negative number.
        largest_triangle: receives the index of that triangle, (parts,) int64; of several equally
            large triangles, the last one.
    """
    for face in range(faces.shape[0]):
        face_part = part_of_face[face]
        first_corner = 2 if is_flipped[face] else 0
        a = vertices[faces[face, first_corner]]
        b = vertices[faces[face, 1]]
        c = vertices[faces[face, 2 - first_corner]]
        x, y, z = area_normal(a, b, c)
        double_area = _length(x, y, z)
        if double_area >= largest_area[face_part]:
            largest_area[face_part] = double_area
            largest_triangle[face_part] = face
        for k in range(3):
            part_boxes[face_part, k] = min(part_boxes[face_part, k], a[k], b[k], c[k])
            part_boxes[face_part, 3 + k] = max(part_boxes[face_part, 3 + k], a[k], b[k], c[k])


@kernel(nogil=True, **NO_REFCOUNT)
def find_nearest_axes(normal, axes, max_distance, nearest_axis, first_normal, end_normal):
    """Find the axis that each unit normal is nearest to, along the axis or against it.

    This is done for the normals ``range(first_normal, end_normal)``.

    Args:
        normal: unit normals, (n, 3) float64.
        axes: unit vectors with ascending z, (k, 3) float64.
        max_distance: every normal must have an axis within this distance, measured between the ends
            of the unit vectors.
        nearest_axis: receives the index of the nearest axis, (n,) int64.
        first_normal: index of the first normal.
        end_normal: index past the last one.
    """
    for normal_index in range(first_normal, end_normal):
        x = normal[normal_index, 0]
        y = normal[normal_index, 1]
        z = normal[normal_index, 2]
        first_axis = np.searchsorted(axes[:, 2], abs(z) - max_distance)
        largest_cosine = -1.0
        for k in range(first_axis, axes.shape[0]):
            if axes[k, 2] > abs(z) + max_distance:
                break
            cosine = abs(x * axes[k, 0] + y * axes[k, 1] + z * axes[k, 2])
            if cosine > largest_cosine:
                largest_cosine = cosine
                nearest_axis[normal_index] = k


@subkernel(inline="always")
def _modulo_quarter_turn(angle):
    """Return an angle modulo a quarter turn, as `%` does, which takes several times as long [rad].

    Args:
        angle: the angle, from minus half a turn to half a turn [rad].
    """
    # subtraction of a number that is half as large, or larger, rounds nothing, see Sterbenz's lemma
    remainder = abs(angle)
    if remainder >= 2.0 * QUARTER_TURN:
        remainder -= 2.0 * QUARTER_TURN
    if remainder >= QUARTER_TURN:
        remainder -= QUARTER_TURN
    return QUARTER_TURN - remainder if angle < 0.0 and remainder > 0.0 else remainder


@kernel(nogil=True, **NO_REFCOUNT)
def find_facing_directions(
    vertices,
    faces,
    num_directions,
    direction_of_triangle,
    double_side_area,
    area_times_angle,
    first_triangle,
    end_triangle,
):
    """Find the horizontal direction that each triangle faces.

    This is done for the triangles ``range(first_triangle, end_triangle)``. Directions a quarter
    turn apart count as equal.

    Args:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, (m, 3) int32.
        num_directions: how many directions a quarter turn is divided into.
        direction_of_triangle: receives the number of the direction nearest to the triangle's, (m,)
            int32; direction n is at ``n / num_directions`` of a quarter turn from x.
        double_side_area: receives twice the triangle's area as seen from the side, 0 for horizontal
            triangles, (m,) float64 [m²].
        area_times_angle: receives `double_side_area` times the angle from the nearest direction to
            the triangle's own, (m,) float64 [m² rad].
        first_triangle: index of the first triangle.
        end_triangle: index past the last one.
    """
    angle_step = QUARTER_TURN / num_directions
    for triangle in range(first_triangle, end_triangle):
        x, y, _ = area_normal(
            vertices[faces[triangle, 0]], vertices[faces[triangle, 1]], vertices[faces[triangle, 2]]
        )
        direction_of_triangle[triangle] = 0
        double_side_area[triangle] = math.sqrt(x * x + y * y)
        area_times_angle[triangle] = 0.0
        if double_side_area[triangle] > 0.0:
            angle = _modulo_quarter_turn(math.atan2(y, x))
            nearest_direction = np.int64(math.floor(angle / angle_step + 0.5))
            if nearest_direction == num_directions:
                nearest_direction = np.int64(0)
            # wrapped, as the nearest direction may lie across the end of the quarter turn
            angle_offset = _modulo_quarter_turn(
                angle - nearest_direction * angle_step + QUARTER_TURN / 2
            )
            angle_offset -= QUARTER_TURN / 2
            area_times_angle[triangle] = double_side_area[triangle] * angle_offset
            direction_of_triangle[triangle] = nearest_direction


@kernel(nogil=True, **NO_REFCOUNT)
def measure_spans(
    vertices, faces, group_of_triangle, direction, lowest_coordinates, highest_coordinates
):
    """Measure how far groups of triangles extend along a direction, across it, and in height.

    Args:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, (m, 3) int32.
        group_of_triangle: the group of each triangle, (m,) int32.
        direction: horizontal unit vector of each group, (groups, 2) float64.
        lowest_coordinates: receives the least coordinate along the direction, along its left
            normal, and along z, (groups, 3) [m]; the caller fills it with inf.
        highest_coordinates: receives the greatest ones, (groups, 3) [m]; the caller fills it with
            -inf.
    """
    for triangle in range(faces.shape[0]):
        group = group_of_triangle[triangle]
        for corner in range(3):
            vertex = faces[triangle, corner]
            x = vertices[vertex, 0]
            y = vertices[vertex, 1]
            z = vertices[vertex, 2]
            coordinate_along = x * direction[group, 0] + y * direction[group, 1]
            coordinate_across = y * direction[group, 0] - x * direction[group, 1]
            lowest_coordinates[group, 0] = min(lowest_coordinates[group, 0], coordinate_along)
            highest_coordinates[group, 0] = max(highest_coordinates[group, 0], coordinate_along)
            lowest_coordinates[group, 1] = min(lowest_coordinates[group, 1], coordinate_across)
            highest_coordinates[group, 1] = max(highest_coordinates[group, 1], coordinate_across)
            lowest_coordinates[group, 2] = min(lowest_coordinates[group, 2], z)
            highest_coordinates[group, 2] = max(highest_coordinates[group, 2], z)
