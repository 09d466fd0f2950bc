"""Vertical lines through cells' centres against all geometry: every crossing, both ways.

Solids and infinite planes are crossed by MuJoCo's own rays (`mju_rayGeom`), one down from above
and one up from below: a solid's line has two ends. Triangles are crossed here, because
`mj_rayMesh` loses lines that run through a shared edge, and stops at the first crossing.
"""

from __future__ import annotations

import math

import numpy as np
from llvmlite import binding
from numba import njit, prange, types

from navbake.baker.kernels.tiles import TILE

# Lines this close to a rim cross it, so that seams between geoms never leak [m]
RIM = 1e-7
# Crossings of one geom's neighbouring triangles this close together are one [m]
SAME = 1e-5

_ray_geom = types.ExternalFunction(
    "mju_rayGeom",
    types.float64(
        types.uintp, types.uintp, types.uintp, types.uintp, types.uintp, types.intc, types.uintp
    ),
)


def load_mujoco_library(path: str) -> None:
    """Make MuJoCo's ray functions known to compiled code; once a process."""
    binding.load_library_permanently(path)


@njit(cache=True)
def _ray(solid, pos, mat, size, kind, point, direction, normal):
    return _ray_geom(
        pos[solid].ctypes.data,
        mat[solid].ctypes.data,
        size.ctypes.data,
        point.ctypes.data,
        direction.ctypes.data,
        kind,
        normal.ctypes.data,
    )


@njit(cache=True)
def _ray_at_rim(solid, pos, mat, size, kind, point, direction, normal, nudged, grown):
    """A ray that, where it misses a rim by at most RIM, is moved onto the geom."""
    distance = _ray(solid, pos, mat, size, kind, point, direction, normal)
    if distance >= 0.0:
        return distance
    for i in range(3):
        grown[i] = size[i] + 2.0 * RIM
    if _ray(solid, pos, mat, grown, kind, point, direction, normal) < 0.0:
        return -1.0
    nudged[2] = point[2]
    for way in range(8):  # the inward cone of a square corner holds one of eight ways
        nudged[0] = point[0] + RIM * math.cos(way * 0.7853981633974483)
        nudged[1] = point[1] + RIM * math.sin(way * 0.7853981633974483)
        distance = _ray(solid, pos, mat, size, kind, nudged, direction, normal)
        if distance >= 0.0:
            return distance
    return -1.0


@njit(cache=True)
def _cross_triangle(corners, x, y):
    """Where the line at (x, y) crosses a triangle.

    Returns:
        0 for no crossing, 1 for one inside, 2 for one within RIM of an edge; and its height.
    """
    ax, ay = corners[0, 0] - x, corners[0, 1] - y
    bx, by = corners[1, 0] - x, corners[1, 1] - y
    cx, cy = corners[2, 0] - x, corners[2, 1] - y
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if abs(area) < 1e-14:
        return 0, 0.0
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


@njit(cache=True)
def _less(z, geom, up, z2, geom2, up2):
    if z != z2:
        return z < z2
    if geom != geom2:
        return geom < geom2
    return up < up2


@njit(cache=True)
def _insert(count, z, nx, ny, nz, geom, edge, out_z, out_n, out_geom, out_edge):
    """Insert a crossing into a column that is sorted by height, then geom."""
    i = count
    while i > 0 and _less(z, geom, nz > 0.0, out_z[i - 1], out_geom[i - 1], out_n[i - 1, 2] > 0.0):
        out_z[i] = out_z[i - 1]
        out_n[i, 0] = out_n[i - 1, 0]
        out_n[i, 1] = out_n[i - 1, 1]
        out_n[i, 2] = out_n[i - 1, 2]
        out_geom[i] = out_geom[i - 1]
        out_edge[i] = out_edge[i - 1]
        i -= 1
    out_z[i] = z
    out_n[i, 0] = nx
    out_n[i, 1] = ny
    out_n[i, 2] = nz
    out_geom[i] = geom
    out_edge[i] = edge
    return count + 1


@njit(cache=True)
def _drop_twins(count, out_z, out_n, out_geom, out_edge):
    """Drop crossings that two neighbouring triangles of a geom report at their shared edge."""
    kept = 0
    for i in range(count):
        twin = False
        if out_edge[i]:
            j = kept - 1
            while j >= 0 and out_z[i] - out_z[j] <= SAME:
                same_side = (out_n[i, 2] > 0.0) == (out_n[j, 2] > 0.0)
                if out_edge[j] and out_geom[i] == out_geom[j] and same_side:
                    twin = True
                    break
                j -= 1
        if not twin:
            out_z[kept] = out_z[i]
            out_n[kept, 0] = out_n[i, 0]
            out_n[kept, 1] = out_n[i, 1]
            out_n[kept, 2] = out_n[i, 2]
            out_geom[kept] = out_geom[i]
            kept += 1
    return kept


@njit(cache=True)
def _fill_column(
    x, y, z_low, z_high,
    solid_items, solid_geom, solid_kind, solid_pos, solid_mat, solid_size, solid_bounds,
    tri_items, tri_geom, tri_corners, tri_normal, tri_bounds,
    plane_geom, plane_pos, plane_mat,
    out_z, out_n, out_geom, out_edge,
    point, direction, normal, nudged, grown, infinite,
):  # fmt: skip
    """Write all crossings of one line into the buffers; returns their number."""
    count = 0
    point[0] = x
    point[1] = y
    for s in solid_items:
        box = solid_bounds[s]
        if x < box[0] - RIM or x > box[3] + RIM or y < box[1] - RIM or y > box[4] + RIM:
            continue
        for way in range(2):
            direction[2] = -1.0 if way == 0 else 1.0
            point[2] = box[5] + 1.0 if way == 0 else box[2] - 1.0
            distance = _ray_at_rim(
                s, solid_pos, solid_mat, solid_size[s], solid_kind[s],
                point, direction, normal, nudged, grown,
            )  # fmt: skip
            if distance >= 0.0:
                z = point[2] + direction[2] * distance
                # a grazed side has no up or down of its own: the ray's way tells
                nz = max(normal[2], 1e-12) if way == 0 else min(normal[2], -1e-12)
                count = _insert(
                    count, z, normal[0], normal[1], nz, solid_geom[s], False,
                    out_z, out_n, out_geom, out_edge,
                )  # fmt: skip
    for p in range(plane_geom.shape[0]):
        for way in range(2):
            direction[2] = -1.0 if way == 0 else 1.0
            point[2] = z_high if way == 0 else z_low
            distance = _ray(p, plane_pos, plane_mat, infinite, 0, point, direction, normal)
            if distance >= 0.0:
                count = _insert(
                    count, point[2] + direction[2] * distance, normal[0], normal[1], normal[2],
                    plane_geom[p], False, out_z, out_n, out_geom, out_edge,
                )  # fmt: skip
    for t in tri_items:
        box = tri_bounds[t]
        if x < box[0] - RIM or x > box[3] + RIM or y < box[1] - RIM or y > box[4] + RIM:
            continue
        if tri_normal[t, 2] == 0.0:
            continue
        crossing, z = _cross_triangle(tri_corners[t], x, y)
        if crossing:
            count = _insert(
                count, z, tri_normal[t, 0], tri_normal[t, 1], tri_normal[t, 2], tri_geom[t],
                crossing == 2, out_z, out_n, out_geom, out_edge,
            )  # fmt: skip
    return _drop_twins(count, out_z, out_n, out_geom, out_edge)


@njit(cache=True, parallel=True)
def cast_lines(
    x_min, y_max, cell_size, width, height, z_low, z_high,
    solid_start, solid_item, solid_geom, solid_kind, solid_pos, solid_mat, solid_size,
    solid_bounds,
    tri_start, tri_item, tri_geom, tri_corners, tri_normal, tri_bounds,
    plane_geom, plane_pos, plane_mat,
    start, z, normals, geom,
):  # fmt: skip
    """Cross every cell's vertical line with all geometry; twice: to count, then to write.

    Args:
        z_low, z_high: heights below and above everything [m].
        solid_start, solid_item, tri_start, tri_item: the tiles' lists.
        start: (cells + 1,) int64. In the first call (`z` empty) ``start[cell + 1]`` receives
            the number of crossings; in the second, the running sums stand in it.
        z, normals, geom: empty in the first call; in the second they receive heights float64
            [m], unit normals (n, 3) float32 and geom ids int32, ascending in a column.
    """
    tiles_x = (width + TILE - 1) // TILE
    tiles_y = (height + TILE - 1) // TILE
    writing = z.shape[0] > 0
    for tile in prange(tiles_x * tiles_y):
        solids = solid_item[solid_start[tile] : solid_start[tile + 1]]
        triangles = tri_item[tri_start[tile] : tri_start[tile + 1]]
        most = 2 * (solids.shape[0] + plane_geom.shape[0]) + triangles.shape[0]
        column_z = np.empty(most, np.float64)
        column_n = np.empty((most, 3), np.float64)
        column_geom = np.empty(most, np.int32)
        column_edge = np.empty(most, np.bool_)
        point, direction = np.empty(3), np.zeros(3)
        normal, nudged, grown, infinite = np.zeros(3), np.empty(3), np.empty(3), np.zeros(3)
        row0, col0 = tile // tiles_x * TILE, tile % tiles_x * TILE
        for row in range(row0, min(row0 + TILE, height)):
            y = y_max - (row + 0.5) * cell_size
            for col in range(col0, min(col0 + TILE, width)):
                x = x_min + (col + 0.5) * cell_size
                count = _fill_column(
                    x, y, z_low, z_high,
                    solids, solid_geom, solid_kind, solid_pos, solid_mat, solid_size,
                    solid_bounds,
                    triangles, tri_geom, tri_corners, tri_normal, tri_bounds,
                    plane_geom, plane_pos, plane_mat,
                    column_z, column_n, column_geom, column_edge,
                    point, direction, normal, nudged, grown, infinite,
                )  # fmt: skip
                cell = row * width + col
                if not writing:
                    start[cell + 1] = count
                    continue
                first = start[cell]
                for i in range(count):
                    z[first + i] = column_z[i]
                    geom[first + i] = column_geom[i]
                    for axis in range(3):
                        normals[first + i, axis] = column_n[i, axis]
