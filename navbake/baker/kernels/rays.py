"""Vertical lines through cells' centres against all geometry: every crossing, both ways.

Solids and infinite planes are crossed by MuJoCo's own rays (`mju_rayGeom`), one down from above
and one up from below: a convex solid's line has two ends. Triangles are crossed here by edge
functions (Pineda, A parallel algorithm for polygon rasterization, 1988), because `mj_rayMesh`
loses lines that run through a shared edge, and stops at the first crossing.

A line through a rim or an edge that two geoms or triangles share is the hard case. It crosses
whatever it passes within RIM, so that no seam leaks; where that makes two crossings of neighbouring
triangles of one part, one is dropped. A line that runs within an upright side of a closed part
crosses triangles there that rounding has tilted a little, up or down: then the steepest of them are
dropped, until the part is left as often as it was entered. Else all that lies below would count as
inside of it.
"""

import math
from typing import NamedTuple

import numpy as np
from llvmlite import binding
from numba import njit, prange, types

from navbake.baker.kernels.constants import CONVEX_SOLID, OPEN_SURFACE, PLANE, SAME
from navbake.baker.kernels.tiles import cell_center, count_tiles, tile_window
from navbake.types import Bool, Float, Int32

# Lines this close to a rim cross it, so that seams between geoms never leak [m]
RIM = 1e-7
# An eighth of a turn [rad]
EIGHTH = 0.7853981633974483
# What is no crossing at an edge, and a plane's type; a plain False or int would be a type of its
# own, and compile what takes it once more
INSIDE, PLANE_KIND = np.bool_(False), np.int32(PLANE)
# In place of a triangle, what crosses a line that is none
OF_SOLID, OF_PLANE = np.int32(-1), np.int32(-2)

_ray_geom = types.ExternalFunction(
    "mju_rayGeom",
    types.float64(
        types.uintp, types.uintp, types.uintp, types.uintp, types.uintp, types.intc, types.uintp
    ),
)


class Column(NamedTuple):
    """Room for one column's crossings, in float64 until they are written.

    Attributes:
        z, normal, geom: as in `Crossings`.
        facet: the triangle that was crossed, OF_SOLID or OF_PLANE.
        is_edge: whether a triangle was crossed within RIM of its edge.
    """

    z: Float
    normal: Float
    geom: Int32
    facet: Int32
    is_edge: Bool


class Ray(NamedTuple):
    """A ray's point and direction, the normal where it hits, and room to nudge it; (3,) each."""

    point: Float
    direction: Float
    normal: Float
    nudged: Float
    grown: Float


def load_mujoco_library(path: str) -> None:
    """Make MuJoCo's ray functions known to compiled code; once a process."""
    binding.load_library_permanently(path)


@njit(cache=True)
def _cast(pos, mat, size, kind, point, ray):
    """The distance to a geom along a ray from a point, or -1; its normal there into the ray."""
    return _ray_geom(
        pos.ctypes.data,
        mat.ctypes.data,
        size.ctypes.data,
        point.ctypes.data,
        ray.direction.ctypes.data,
        kind,
        ray.normal.ctypes.data,
    )


@njit(inline="always")
def _cast_at_rim(solids, s, ray):
    """A ray that, where it misses a rim by at most RIM, is moved onto the geom."""
    pos, mat, size, kind = solids.pos[s], solids.mat[s], solids.size[s], solids.kind[s]
    distance = _cast(pos, mat, size, kind, ray.point, ray)
    if distance >= 0.0:
        return distance
    for i in range(3):
        ray.grown[i] = size[i] + 2.0 * RIM
    if _cast(pos, mat, ray.grown, kind, ray.point, ray) < 0.0:
        return -1.0
    ray.nudged[2] = ray.point[2]
    for way in range(8):  # the inward cone of a square corner holds one of eight ways
        ray.nudged[0] = ray.point[0] + RIM * math.cos(way * EIGHTH)
        ray.nudged[1] = ray.point[1] + RIM * math.sin(way * EIGHTH)
        distance = _cast(pos, mat, size, kind, ray.nudged, ray)
        if distance >= 0.0:
            return distance
    return -1.0


@njit(inline="always")
def _cross_triangle(corners, x, y):
    """Where the line at (x, y) crosses a triangle.

    Returns 0 for nowhere, 1 for inside, 2 for within RIM of an edge; and the height.
    """
    ax, ay = corners[0, 0] - x, corners[0, 1] - y
    bx, by = corners[1, 0] - x, corners[1, 1] - y
    cx, cy = corners[2, 0] - x, corners[2, 1] - y
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if abs(area) < 1e-14:
        return 0, 0.0
    # edge functions: twice the areas that (x, y) spans with the edges, all of one sign inside
    turn = 1.0 if area > 0.0 else -1.0
    u = turn * (bx * cy - cx * by)
    v = turn * (cx * ay - ax * cy)
    w = turn * (ax * by - bx * ay)
    # distance to an edge = edge function / edge length
    du = u / math.hypot(cx - bx, cy - by)
    dv = v / math.hypot(ax - cx, ay - cy)
    dw = w / math.hypot(bx - ax, by - ay)
    nearest = min(du, dv, dw)
    if nearest < -RIM:
        return 0, 0.0
    z0, z1, z2 = corners[0, 2], corners[1, 2], corners[2, 2]
    z = (u * z0 + v * z1 + w * z2) / (u + v + w)
    z = min(max(z, min(z0, z1, z2)), max(z0, z1, z2))
    return (2 if nearest <= RIM else 1), z


@njit(inline="always")
def _is_less(column, i, z, geom, faces_up):
    """Whether a crossing comes before the i-th: by height, then geom, undersides first."""
    if z != column.z[i]:
        return z < column.z[i]
    if geom != column.geom[i]:
        return geom < column.geom[i]
    return faces_up < (column.normal[i, 2] > 0.0)


@njit(inline="always")
def _copy(column, source, target):
    column.z[target] = column.z[source]
    for axis in range(3):
        column.normal[target, axis] = column.normal[source, axis]
    column.geom[target] = column.geom[source]
    column.facet[target] = column.facet[source]
    column.is_edge[target] = column.is_edge[source]


@njit(cache=True)
def _insert(column, count, z, normal, geom, facet, is_edge):
    """Insert a crossing into a column of a number of them; normal is (x, y, z)."""
    i = count
    while i > 0 and _is_less(column, i - 1, z, geom, normal[2] > 0.0):
        _copy(column, i - 1, i)
        i -= 1
    column.z[i] = z
    column.normal[i, 0], column.normal[i, 1], column.normal[i, 2] = normal
    column.geom[i] = geom
    column.facet[i] = facet
    column.is_edge[i] = is_edge
    return count + 1


@njit(inline="always")
def _is_same_part(column, i, j, facets):
    """Whether two crossings at edges, so of triangles, are of one part of one geom."""
    is_same_geom = column.geom[i] == column.geom[j]
    return is_same_geom and facets.part[column.facet[i]] == facets.part[column.facet[j]]


@njit(inline="always")
def _drop_doubles(column, count, facets):
    """Drop crossings that two neighbouring triangles of a part report at their shared edge."""
    kept = 0
    for i in range(count):
        is_double = False
        if column.is_edge[i]:
            j = kept - 1
            while j >= 0 and column.z[i] - column.z[j] <= SAME:
                same_side = (column.normal[i, 2] > 0.0) == (column.normal[j, 2] > 0.0)
                if column.is_edge[j] and same_side and _is_same_part(column, i, j, facets):
                    is_double = True
                    break
                j -= 1
        if not is_double:
            _copy(column, i, kept)
            kept += 1
    return kept


@njit(inline="always")
def _steepest_of_part(column, count, i, facets, side):
    """The steepest crossing at an edge of the i-th one's part that faces up (1) or down (-1)."""
    steepest = -1
    for j in range(count):
        if not column.is_edge[j] or side * column.normal[j, 2] <= 0.0:
            continue
        is_steeper = steepest < 0 or abs(column.normal[j, 2]) < abs(column.normal[steepest, 2])
        if is_steeper and _is_same_part(column, i, j, facets):
            steepest = j
    return steepest


@njit(cache=True)
def _balance_parts(column, count, facets):
    """Drop crossings at edges, so that each closed part is left as often as it is entered."""
    i = 0
    while i < count:
        surplus = 0
        if column.is_edge[i] and facets.closed[column.facet[i]] != OPEN_SURFACE:
            for j in range(count):
                if column.facet[j] >= 0 and _is_same_part(column, i, j, facets):
                    surplus += 1 if column.normal[j, 2] > 0.0 else -1
        dropped = -1
        if surplus != 0:
            side = 1.0 if surplus > 0 else -1.0
            dropped = _steepest_of_part(column, count, i, facets, side)
        if dropped < 0:
            i += 1
            continue
        for j in range(dropped + 1, count):
            _copy(column, j, j - 1)
        count -= 1
        # the i-th one is looked at again, and it is the next one where an earlier one was dropped
        if dropped < i:
            i -= 1
    return count


@njit(inline="always")
def _is_beside(box, x, y):
    return x < box[0] - RIM or x > box[3] + RIM or y < box[1] - RIM or y > box[4] + RIM


@njit(inline="always")
def _cross_solids(x, y, items, solids, column, ray):
    """Write the crossings of one line with solids; returns their number."""
    count = np.int64(0)
    ray.point[0], ray.point[1] = x, y
    for s in items:
        box = solids.bounds[s]
        if _is_beside(box, x, y):
            continue
        for way in range(2):
            ray.direction[2] = -1.0 if way == 0 else 1.0
            ray.point[2] = box[5] + 1.0 if way == 0 else box[2] - 1.0
            distance = _cast_at_rim(solids, s, ray)
            if distance >= 0.0:
                z = ray.point[2] + ray.direction[2] * distance
                nx, ny, nz = ray.normal[0], ray.normal[1], ray.normal[2]
                # a grazed side has no up or down of its own: the ray's way tells
                nz = max(nz, 1e-12) if way == 0 else min(nz, -1e-12)
                count = _insert(column, count, z, (nx, ny, nz), solids.geom[s], OF_SOLID, INSIDE)
    return count


@njit(inline="always")
def _cross_planes(planes, heights, column, count, ray):
    """Add the crossings of the ray's line with infinite planes, from their front only."""
    for p in range(planes.geom.shape[0]):
        for way in range(2):
            ray.direction[2] = -1.0 if way == 0 else 1.0
            ray.point[2] = heights.high if way == 0 else heights.low
            ray.grown[:] = 0.0  # a plane of no size is infinite
            distance = _cast(planes.pos[p], planes.mat[p], ray.grown, PLANE_KIND, ray.point, ray)
            if distance >= 0.0:
                z = ray.point[2] + ray.direction[2] * distance
                normal = (ray.normal[0], ray.normal[1], ray.normal[2])
                count = _insert(column, count, z, normal, planes.geom[p], OF_PLANE, INSIDE)
    return count


@njit(inline="always")
def _cross_triangles(x, y, items, facets, column, count):
    """Add the crossings of one line with triangles."""
    for t in items:
        if _is_beside(facets.bounds[t], x, y):
            continue
        nx, ny, nz = facets.normal[t, 0], facets.normal[t, 1], facets.normal[t, 2]
        if nz == 0.0:
            continue
        crossing, z = _cross_triangle(facets.corners[t], x, y)
        if crossing:
            count = _insert(column, count, z, (nx, ny, nz), facets.geom[t], t, crossing == 2)
    return count


@njit(inline="always")
def _write(column, count, facets, crossings, first):
    for i in range(count):
        facet, closed = column.facet[i], OPEN_SURFACE
        if facet != OF_PLANE:
            closed = CONVEX_SOLID if facet == OF_SOLID else facets.closed[facet]
        crossings.closed[first + i] = closed
        crossings.z[first + i] = column.z[i]
        crossings.geom[first + i] = column.geom[i]
        for axis in range(3):
            crossings.normal[first + i, axis] = column.normal[i, axis]


@njit(inline="always")
def _items_over(tile, tiles):
    """The solids and the triangles over a tile."""
    nearby = tiles.solid_item[tiles.solid_start[tile] : tiles.solid_start[tile + 1]]
    begin, end = tiles.triangle_start[tile], tiles.triangle_start[tile + 1]
    return nearby, tiles.triangle_item[begin:end]


@njit(inline="always")
def _make_room(nearby, triangles, planes):
    """Room for one column of a tile, and for its rays."""
    most = 2 * (nearby.shape[0] + planes.geom.shape[0]) + triangles.shape[0]
    geom, facet = np.empty(most, np.int32), np.empty(most, np.int32)
    column = Column(np.empty(most), np.empty((most, 3)), geom, facet, np.empty(most, np.bool_))
    return column, Ray(np.empty(3), np.zeros(3), np.zeros(3), np.empty(3), np.empty(3))


@njit(cache=True)
def _cast_tile(tile, lattice, solids, facets, planes, tiles, heights, crossings):
    """Cross the lines of one tile with what lies over it."""
    nearby, triangles = _items_over(tile, tiles)
    column, ray = _make_room(nearby, triangles, planes)
    writing = crossings.z.shape[0] > 0
    row0, row1, col0, col1 = tile_window(lattice, tile)
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell = row * lattice.width + col
            x, y = cell_center(lattice, cell)
            count = _cross_solids(x, y, nearby, solids, column, ray)
            count = _cross_planes(planes, heights, column, count, ray)
            count = _cross_triangles(x, y, triangles, facets, column, count)
            count = _drop_doubles(column, count, facets)
            count = _balance_parts(column, count, facets)
            if writing:
                _write(column, count, facets, crossings, crossings.start[cell])
            else:
                crossings.start[cell + 1] = count


@njit(cache=True, parallel=True)
def cast_lines(lattice, solids, facets, planes, tiles, heights, crossings):
    """Cross every cell's vertical line with all geometry; twice: to count, then to write.

    Args:
        heights: a `Band` below and above everything [m].
        crossings: in the first call all but `start` are empty, and ``start[cell + 1]``
            receives the number of crossings; in the second, the running sums stand there, and
            the others receive the crossings.
    """
    for tile in prange(count_tiles(lattice)):
        _cast_tile(np.int64(tile), lattice, solids, facets, planes, tiles, heights, crossings)


@njit(cache=True)
def _cast_point(tile, x, y, n, solids, facets, planes, tiles, heights, crossings):
    """Cross the n-th of some lines, which lies over a tile, as `_cast_tile` does."""
    nearby, triangles = _items_over(tile, tiles)
    column, ray = _make_room(nearby, triangles, planes)
    count = _cross_solids(x, y, nearby, solids, column, ray)
    count = _cross_planes(planes, heights, column, count, ray)
    count = _cross_triangles(x, y, triangles, facets, column, count)
    count = _drop_doubles(column, count, facets)
    count = _balance_parts(column, count, facets)
    if crossings.z.shape[0] > 0:
        _write(column, count, facets, crossings, crossings.start[n])
    else:
        crossings.start[n + 1] = count


@njit(cache=True, parallel=True)
def cast_points_at(points, tile, solids, facets, planes, tiles, heights, crossings):
    """Cross vertical lines at points, (n, 2) [m], over tiles, (n,) int64; see `cast_lines`."""
    for n in prange(points.shape[0]):
        x, y = points[n, 0], points[n, 1]
        _cast_point(tile[n], x, y, np.int64(n), solids, facets, planes, tiles, heights, crossings)
