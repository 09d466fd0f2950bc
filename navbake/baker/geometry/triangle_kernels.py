"""Normals, areas and spans of many triangles in one pass, without temporary arrays.

Each number is computed in the order of operations of numpy's cross product and norm.
"""

import math

import numpy as np

from navbake.compiled import NO_REFCOUNT, kernel, subkernel

QUARTER_TURN = math.pi / 2  # [rad]
# A triangle counts as vertical if its unit normal's z is below this
MAX_VERTICAL_UP = 1e-9


@subkernel(inline="always")
def _cross(a, b, c):
    """Return the normal of a triangle, as long as twice its area."""
    ux = b[0] - a[0]
    uy = b[1] - a[1]
    uz = b[2] - a[2]
    vx = c[0] - a[0]
    vy = c[1] - a[1]
    vz = c[2] - a[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@subkernel(inline="always")
def _length(x, y, z):
    return math.sqrt(x * x + y * y + z * z)


@subkernel(**NO_REFCOUNT)
def unit_normal(corners, t):
    """Return x, y and z of a triangle's unit normal.

    z is 0 for vertical triangles; all are 0 for triangles without area.

    Args:
        corners: (…, 3, 3) float64 [m].
        t: index of the triangle.
    """
    x, y, z = _cross(corners[t, 0], corners[t, 1], corners[t, 2])
    length = _length(x, y, z)
    if not length > 0.0:
        return 0.0, 0.0, 0.0
    up = z / length
    return x / length, y / length, 0.0 if abs(up) < MAX_VERTICAL_UP else up


@kernel(nogil=True, **NO_REFCOUNT)
def expand_mesh(vertices, faces, corners, bounds, facing, first, end):
    """Write triangles ``range(first, end)`` of a mesh as fields of `Facets`.

    `facing` is 0 only for triangles for which `unit_normal` has a z of 0.

    Args:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, (m, 3) int32.
        corners, bounds, facing: receive the fields of `Facets`.
        first, end: range of triangles.
    """
    for t in range(first, end):
        for i in range(3):
            for k in range(3):
                corners[t, i, k] = vertices[faces[t, i], k]
        a = corners[t, 0]
        b = corners[t, 1]
        c = corners[t, 2]
        for k in range(3):
            bounds[t, k] = min(a[k], b[k], c[k])
            bounds[t, 3 + k] = max(a[k], b[k], c[k])
        x, y, z = _cross(a, b, c)
        length = _length(x, y, z)
        up = z / length if length > 0.0 else 0.0
        facing[t] = np.rint(100.0 * up)
        if facing[t] == 0 and abs(up) >= MAX_VERTICAL_UP:
            facing[t] = 1 if up > 0.0 else -1


@kernel(nogil=True, **NO_REFCOUNT)
def measure_areas(vertices, faces, area, first, end):
    """Compute the areas of triangles ``range(first, end)``.

    Args:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, (m, 3) int32.
        area: receives the areas, (m,) float64 [m²].
        first, end: range of triangles.
    """
    for f in range(first, end):
        x, y, z = _cross(vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]])
        area[f] = _length(x, y, z) / 2.0


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
    for f in range(faces.shape[0]):
        a = vertices[faces[f, 0]]
        b = vertices[faces[f, 1]]
        c = vertices[faces[f, 2]]
        cross = _cross(a, b, c)
        length = _length(cross[0], cross[1], cross[2])
        area[f] = length / 2
        for k in range(3):
            center[f, k] = (a[k] + b[k] + c[k]) / 3
            normal[f, k] = cross[k] / max(length, 1e-300)
    return center, normal, area


@kernel(nogil=True, **NO_REFCOUNT)
def measure_part_volumes(vertices, faces, is_flipped, part, volume, area, first, end):
    """Sum up the volumes and areas of parts ``range(first, end)`` of a mesh.

    Triangles are added in their order.

    Args:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, (m, 3) int32.
        is_flipped: which triangles count as facing the other way, (m,) bool.
        part: the part that each triangle belongs to, (m,) int32.
        volume: zeros, one for each part; receives the volume, positive for parts that face out,
            float64 [m³].
        area: zeros, one for each part; receives the area, float64 [m²].
        first, end: range of parts.
    """
    origin = vertices[faces[0, 0]]
    current_part = np.int64(first)
    volume_sum = 0.0
    area_sum = 0.0
    for f in range(faces.shape[0]):
        p = np.int64(part[f])
        if not first <= p < end:
            continue
        if p != current_part:  # most triangles follow others of their part: sums stay in registers
            volume[current_part] = volume_sum
            area[current_part] = area_sum
            current_part = p
            volume_sum = volume[p]
            area_sum = area[p]
        first_corner = 2 if is_flipped[f] else 0
        a = vertices[faces[f, first_corner]]
        b = vertices[faces[f, 1]]
        c = vertices[faces[f, 2 - first_corner]]
        x, y, z = _cross(a, b, c)
        # from a corner of the mesh, so that rounding doesn't grow with the distance to the origin
        ox = a[0] - origin[0]
        oy = a[1] - origin[1]
        oz = a[2] - origin[2]
        volume_sum += (ox * x + oy * y + oz * z) / 6.0
        area_sum += _length(x, y, z) / 2.0
    volume[current_part] = volume_sum
    area[current_part] = area_sum


@kernel(nogil=True, **NO_REFCOUNT)
def bound_parts(vertices, faces, is_flipped, part, box, largest_area, largest_triangle):
    """Find the box and the largest triangle of each part of a mesh.

    Args:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, (m, 3) int32.
        is_flipped: which triangles count as facing the other way, (m,) bool.
        part: the part that each triangle belongs to, (m,) int32.
        box: receives the lower and the upper corner of each part's box, (parts, 6) [m]; inf and
            -inf before.
        largest_area: receives twice the area of each part's largest triangle, (parts,) [m²];
            negative before.
        largest_triangle: receives the index of that triangle, (parts,) int64; of several equally
            large triangles, the last one.
    """
    for f in range(faces.shape[0]):
        p = part[f]
        first_corner = 2 if is_flipped[f] else 0
        a = vertices[faces[f, first_corner]]
        b = vertices[faces[f, 1]]
        c = vertices[faces[f, 2 - first_corner]]
        x, y, z = _cross(a, b, c)
        double_area = _length(x, y, z)
        if double_area >= largest_area[p]:
            largest_area[p] = double_area
            largest_triangle[p] = f
        for k in range(3):
            box[p, k] = min(box[p, k], a[k], b[k], c[k])
            box[p, 3 + k] = max(box[p, 3 + k], a[k], b[k], c[k])


@kernel(nogil=True, **NO_REFCOUNT)
def find_nearest_axes(normal, axes, max_distance, nearest, first, end):
    """Find the axis that each unit normal is nearest to, for normals ``range(first, end)``.

    A normal may point along the axis or against it.

    Args:
        normal: unit normals, (n, 3) float64.
        axes: unit vectors with ascending z, (k, 3) float64.
        max_distance: every normal must have an axis within this distance, measured between the ends
            of the unit vectors.
        nearest: receives the index of the nearest axis, (n,) int64.
        first, end: range of normals.
    """
    for n in range(first, end):
        x = normal[n, 0]
        y = normal[n, 1]
        z = normal[n, 2]
        first_axis = np.searchsorted(axes[:, 2], abs(z) - max_distance)
        largest_cosine = -1.0
        for k in range(first_axis, axes.shape[0]):
            if axes[k, 2] > abs(z) + max_distance:
                break
            cosine = abs(x * axes[k, 0] + y * axes[k, 1] + z * axes[k, 2])
            if cosine > largest_cosine:
                largest_cosine = cosine
                nearest[n] = k


@kernel(nogil=True, **NO_REFCOUNT)
def find_facing_directions(corners, num_directions, direction, weight, weighted_angle, first, end):
    """Find the horizontal direction that each of the triangles ``range(first, end)`` faces.

    Directions a quarter turn apart count as equal.

    Args:
        corners: corners of the triangles, (m, 3, 3) float64 [m].
        num_directions: how many directions a quarter turn is divided into.
        direction: receives the number of the direction nearest to the triangle's, (m,) int32;
            direction n is at ``n / num_directions`` of a quarter turn from x.
        weight: receives twice the triangle's area as seen from the side, 0 for horizontal
            triangles, (m,) float64 [m²].
        weighted_angle: receives the weight times the angle from the nearest direction to the
            triangle's own, (m,) float64 [m² rad].
        first, end: range of triangles.
    """
    step = QUARTER_TURN / num_directions
    for t in range(first, end):
        x, y, _ = _cross(corners[t, 0], corners[t, 1], corners[t, 2])
        direction[t] = 0
        weight[t] = math.sqrt(x * x + y * y)
        weighted_angle[t] = 0.0
        if weight[t] > 0.0:
            angle = math.atan2(y, x) % QUARTER_TURN
            nearest = np.int64(math.floor(angle / step + 0.5)) % num_directions
            # wrapped, as the nearest direction may lie across the end of the quarter turn
            offset = (angle - nearest * step + QUARTER_TURN / 2) % QUARTER_TURN - QUARTER_TURN / 2
            weighted_angle[t] = weight[t] * offset
            direction[t] = nearest


@kernel(nogil=True, **NO_REFCOUNT)
def measure_spans(corners, group, direction, low, high):
    """Measure how far groups of triangles extend along a direction, across it, and in height.

    Args:
        corners: (m, 3, 3) float64 [m].
        group: of each triangle, (m,) int32.
        direction: horizontal unit vector of each group, (groups, 2) float64.
        low: (groups, 3) of inf; receives the least coordinate along the direction, along its left
            normal, and along z [m].
        high: (groups, 3) of -inf; receives the greatest ones [m].
    """
    for t in range(corners.shape[0]):
        g = group[t]
        for corner in range(3):
            x = corners[t, corner, 0]
            y = corners[t, corner, 1]
            z = corners[t, corner, 2]
            along = x * direction[g, 0] + y * direction[g, 1]
            across = y * direction[g, 0] - x * direction[g, 1]
            low[g, 0] = min(low[g, 0], along)
            high[g, 0] = max(high[g, 0], along)
            low[g, 1] = min(low[g, 1], across)
            high[g, 1] = max(high[g, 1], across)
            low[g, 2] = min(low[g, 2], z)
            high[g, 2] = max(high[g, 2], z)
