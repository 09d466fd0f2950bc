"""Normals, areas and spans of many triangles in one pass, without arrays between.

Each number is computed in the order in which numpy's cross product and norm do it.
"""

import math

import numpy as np

from navbake.compiled import NO_REFCOUNT, kernel, subkernel

RIGHT = math.pi / 2
UPRIGHT = 1e-9  # the z of a unit normal below which a triangle counts as upright


@subkernel(inline="always")
def _cross(a, b, c):
    """The normal of a triangle, as long as twice its area."""
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
    """The unit normal of a triangle: x, y and z; z is 0 for an upright one, or one without area."""
    x, y, z = _cross(corners[t, 0], corners[t, 1], corners[t, 2])
    length = _length(x, y, z)
    if not length > 0.0:
        return 0.0, 0.0, 0.0
    up = z / length
    return x / length, y / length, 0.0 if abs(up) < UPRIGHT else up


@kernel(nogil=True, **NO_REFCOUNT)
def expand_mesh(vertices, faces, corners, bounds, facing, first, end):
    """Write triangles ``range(first, end)``, the boxes round them, and their facing, see `Facets`.

    Those are upright for which `unit_normal` has a z of 0.
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
        if facing[t] == 0 and abs(up) >= UPRIGHT:
            facing[t] = 1 if up > 0.0 else -1


@kernel(nogil=True, **NO_REFCOUNT)
def measure_areas(vertices, faces, area, first, end):
    """Write the areas of triangles ``range(first, end)``, (m,) float64 [m²]."""
    for f in range(first, end):
        x, y, z = _cross(vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]])
        area[f] = _length(x, y, z) / 2.0


@kernel
def describe_triangles(vertices, faces):
    """The centres, (m, 3), unit normals, (m, 3), and areas of triangles, (m,) [m, m²]."""
    center = np.empty((faces.shape[0], 3))
    normal = np.empty((faces.shape[0], 3))
    area = np.empty(faces.shape[0])
    for f in range(faces.shape[0]):
        a = vertices[faces[f, 0]]
        b = vertices[faces[f, 1]]
        c = vertices[faces[f, 2]]
        across = _cross(a, b, c)
        size = _length(across[0], across[1], across[2])
        area[f] = size / 2
        for k in range(3):
            center[f, k] = (a[k] + b[k] + c[k]) / 3
            normal[f, k] = across[k] / max(size, 1e-300)
    return center, normal, area


@kernel(nogil=True, **NO_REFCOUNT)
def measure_part_volumes(vertices, faces, turned, part, volume, area, first, end):
    """Add up the volume, positive where it faces out, and the area of parts ``range(first, end)``.

    `part` and `turned` are by triangle; the sums (num,) of 0. Triangles are added in their order.
    """
    origin = vertices[faces[0, 0]]
    current = np.int64(first)
    cubes = 0.0
    squares = 0.0
    for f in range(faces.shape[0]):
        p = np.int64(part[f])
        if not first <= p < end:
            continue
        if p != current:  # most triangles follow others of their part: its sums are at hand
            volume[current] = cubes
            area[current] = squares
            current = p
            cubes = volume[p]
            squares = area[p]
        one, other = (2, 0) if turned[f] else (0, 2)
        a = vertices[faces[f, one]]
        b = vertices[faces[f, 1]]
        c = vertices[faces[f, other]]
        x, y, z = _cross(a, b, c)
        # from a corner of the mesh, so that rounding doesn't grow with the distance to the origin
        ox = a[0] - origin[0]
        oy = a[1] - origin[1]
        oz = a[2] - origin[2]
        cubes += (ox * x + oy * y + oz * z) / 6.0
        squares += _length(x, y, z) / 2.0
    volume[current] = cubes
    area[current] = squares


@kernel(nogil=True, **NO_REFCOUNT)
def bound_parts(vertices, faces, turned, part, box, best, largest):
    """Find the box and the largest triangle, the last one of several, of each part of a mesh.

    `part` and `turned` are by triangle. Writes into `box` lower and upper corner, (num, 6) of inf
    and -inf; into `best` twice the area of the largest triangle, (num,) below 0; into `largest`
    that triangle.
    """
    for f in range(faces.shape[0]):
        p = part[f]
        one, other = (2, 0) if turned[f] else (0, 2)
        a = vertices[faces[f, one]]
        b = vertices[faces[f, 1]]
        c = vertices[faces[f, other]]
        x, y, z = _cross(a, b, c)
        size = _length(x, y, z)
        if size >= best[p]:
            best[p] = size
            largest[p] = f
        for k in range(3):
            box[p, k] = min(box[p, k], a[k], b[k], c[k])
            box[p, 3 + k] = max(box[p, 3 + k], a[k], b[k], c[k])


@kernel(nogil=True, **NO_REFCOUNT)
def find_nearest_axes(normal, axes, reach, nearest, first, end):
    """Find which of some axes, of unit length and ascending z, each unit normal is nearest to.

    An axis counts both ways. No normal is farther than `reach` from the nearest one. Writes the
    axes of normals ``range(first, end)``, int64.
    """
    for n in range(first, end):
        x = normal[n, 0]
        y = normal[n, 1]
        z = normal[n, 2]
        begin = np.searchsorted(axes[:, 2], abs(z) - reach)
        best = -1.0
        for k in range(begin, axes.shape[0]):
            if axes[k, 2] > abs(z) + reach:
                break
            along = abs(x * axes[k, 0] + y * axes[k, 1] + z * axes[k, 2])
            if along > best:
                best = along
                nearest[n] = k


@kernel(nogil=True, **NO_REFCOUNT)
def find_facing_directions(corners, directions, way, weight, off, first, end):
    """Find the horizontal direction that triangles face, modulo a right angle.

    Writes the nearest of `directions`, (m,) int32; twice the area as seen from the side [m²], 0 for
    level triangles; and that times the angle to the nearest direction [rad], (m,) float64.
    """
    step = RIGHT / directions
    for t in range(first, end):
        x, y, _ = _cross(corners[t, 0], corners[t, 1], corners[t, 2])
        way[t] = 0
        weight[t] = math.sqrt(x * x + y * y)
        off[t] = 0.0
        if weight[t] > 0.0:
            angle = math.atan2(y, x) % RIGHT
            direction = np.int64(math.floor(angle / step + 0.5)) % directions
            # from the direction, also over the end of the range
            off[t] = weight[t] * ((angle - direction * step + RIGHT / 2) % RIGHT - RIGHT / 2)
            way[t] = direction


@kernel(nogil=True, **NO_REFCOUNT)
def measure_spans(corners, group, way, low, high):
    """How far groups of triangles reach along the group's `way`, left of it, and up.

    Takes unit vectors, (num, 2); writes into `low` and `high`, (num, 3) of inf and -inf [m].
    """
    for t in range(corners.shape[0]):
        g = group[t]
        for corner in range(3):
            x = corners[t, corner, 0]
            y = corners[t, corner, 1]
            z = corners[t, corner, 2]
            along = x * way[g, 0] + y * way[g, 1]
            left = y * way[g, 0] - x * way[g, 1]
            low[g, 0] = min(low[g, 0], along)
            high[g, 0] = max(high[g, 0], along)
            low[g, 1] = min(low[g, 1], left)
            high[g, 1] = max(high[g, 1], left)
            low[g, 2] = min(low[g, 2], z)
            high[g, 2] = max(high[g, 2], z)
