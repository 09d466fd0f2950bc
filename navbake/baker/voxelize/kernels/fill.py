"""Filling voxels column by column, from the heights that each geom has over a column's square.

What a solid, a half-space or a triangle has over a square is one span of heights, so a column
costs one calculation, not one a voxel. Insides of closed surfaces follow from a line through
the column. Voxels are narrowed by `touch` on all sides: what reaches in by less only touches.

A grid is passed as its lower corner `origin`, the edge `res` of a voxel and `values`
(nx, ny, nz), unsigned integers, 0 for empty. Where several geoms meet a voxel the least label
stays, in whatever order they come.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from navbake.baker.voxelize.kernels.spans import clip, plane_span, polygon_span, solid_span
from navbake.baker.voxelize.kernels.tiles import CLOSED, CONVEX, TILE, touched

# A triangle this little beside a column is looked at, because rounding may have put it there
SLACK = 1e-3  # [voxels]
# Where a line is moved to when it ran through an edge and rounding lost a crossing [voxels]
ASIDE = np.array([[0, 0], [0.137, 0.071], [-0.093, 0.119], [0.061, -0.143], [-0.127, -0.083]])


@njit(cache=True)
def _fill(values, i, j, low, high, label, origin, res, touch):
    """Label the voxels of a column that a span of heights meets."""
    num = values.shape[2]
    start, end = (low + touch - origin[2]) / res, (high - touch - origin[2]) / res
    if not (start < num and end > 0.0):
        return
    first = math.floor(start) if start > 0.0 else 0
    last = math.ceil(end) if end < num else num
    for k in range(first, last):
        if values[i, j, k] == 0 or values[i, j, k] > label:
            values[i, j, k] = label


@njit(cache=True)
def _square(i, j, origin, res, touch):
    x, y = origin[0] + i * res, origin[1] + j * res
    return x + touch, x + res - touch, y + touch, y + res - touch


@njit(cache=True)
def _columns(low_x, high_x, low_y, high_y, tile, origin, res):
    """The columns of a tile under a rectangle: i0, i1, j0, j1, without the ends i1 and j1."""
    i0, i1 = touched(low_x, high_x, origin[0] + tile[0] * res, res, tile[1] - tile[0])
    j0, j1 = touched(low_y, high_y, origin[1] + tile[2] * res, res, tile[3] - tile[2])
    return tile[0] + i0, tile[0] + i1 + 1, tile[2] + j0, tile[2] + j1 + 1


@njit(cache=True)
def _fill_solid(s, solids, label, tile, values, origin, res, touch, one, other):
    kind, pos, mat, size, bounds = solids
    i0, i1, j0, j1 = _columns(
        bounds[s, 0], bounds[s, 3], bounds[s, 1], bounds[s, 4], tile, origin, res
    )
    for i in range(i0, i1):
        for j in range(j0, j1):
            x0, x1, y0, y1 = _square(i, j, origin, res, touch)
            low, high = solid_span(kind[s], pos[s], mat[s], size[s], x0, x1, y0, y1, one, other)
            _fill(values, i, j, low, high, label, origin, res, touch)


@njit(cache=True)
def _side(ax, ay, bx, by, px, py):
    """On which side of the line from a to b a point is: 1 left, -1 right, 0 where a is b.

    The same but for the sign, to the bit, for the line from b to a; a point on the line counts
    as moved by a hair along x, and by a hair of that along y.
    """
    swap = ax > bx or (ax == bx and ay > by)
    if swap:
        ax, ay, bx, by = bx, by, ax, ay
    cross = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
    if cross == 0.0:
        cross = ay - by
    if cross == 0.0:
        cross = bx - ax
    if cross == 0.0:
        return 0
    return -1 if (cross > 0.0) == swap else 1


@njit(cache=True)
def _crossing(c, x, y):
    """How the upright line at (x, y) crosses a triangle: 1 if it faces up there, -1, or 0."""
    side = _side(c[0, 0], c[0, 1], c[1, 0], c[1, 1], x, y)
    if side == 0 or side != _side(c[1, 0], c[1, 1], c[2, 0], c[2, 1], x, y):
        return 0
    return side if side == _side(c[2, 0], c[2, 1], c[0, 0], c[0, 1], x, y) else 0


@njit(cache=True)
def _height_at(c, x, y):
    """The height of a triangle at (x, y) inside of it."""
    ax, ay = c[0, 0] - x, c[0, 1] - y
    bx, by = c[1, 0] - x, c[1, 1] - y
    cx, cy = c[2, 0] - x, c[2, 1] - y
    u, v, w = bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay
    low, high = polygon_span(c, 3)
    total = u + v + w
    if total == 0.0:
        return low
    return min(max((u * c[0, 2] + v * c[1, 2] + w * c[2, 2]) / total, low), high)


@njit(cache=True)
def _note_crossing(c, x, y, winding, reach, origin, res):
    """Add a triangle's crossing of a column's line at the first voxel with its middle above.

    `reach` is the first and the last entry of `winding` that may not be 0.
    """
    side = _crossing(c, x, y)
    if side != 0:
        above = (_height_at(c, x, y) - origin[2]) / res + 0.5
        last = winding.shape[0] - 1
        k = 0 if above < 0.0 else (last if above >= last else int(above))
        winding[k] -= side
        reach[0], reach[1] = min(reach[0], k), max(reach[1], k)


@njit(cache=True)
def _add_triangle(
    c, mode, label, tile, values, origin, res, touch, spans, winding, reaches, one, other, strip
):
    """Fill what one triangle meets, and note what its geom needs to be filled."""
    x_low, x_high = min(c[0, 0], c[1, 0], c[2, 0]), max(c[0, 0], c[1, 0], c[2, 0])
    y_low, y_high = min(c[0, 1], c[1, 1], c[2, 1]), max(c[0, 1], c[1, 1], c[2, 1])
    i0, i1, _, _ = _columns(x_low, x_high, y_low, y_high, tile, origin, res)
    for i in range(i0, i1):
        x0, x1, _, _ = _square(i, 0, origin, res, touch)
        num = clip(c, 3, other, 0, x0, x1, strip)
        if num == 0:
            continue
        low_y, high_y = strip[0, 1], strip[0, 1]
        for n in range(1, num):
            low_y, high_y = min(low_y, strip[n, 1]), max(high_y, strip[n, 1])
        _, _, j0, j1 = _columns(
            x0, x1, low_y - SLACK * res, high_y + SLACK * res, tile, origin, res
        )
        for j in range(j0, j1):
            _, _, y0, y1 = _square(0, j, origin, res, touch)
            left = clip(strip, num, other, 1, y0, y1, one)
            if left > 0:
                low, high = polygon_span(one, left)
                if mode == CONVEX:
                    span = spans[i - tile[0], j - tile[2]]
                    span[0], span[1] = min(span[0], low), max(span[1], high)
                else:
                    _fill(values, i, j, low, high, label, origin, res, touch)
            x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
            if mode == CLOSED and x_low <= x <= x_high and y_low <= y <= y_high:
                a, b = i - tile[0], j - tile[2]
                _note_crossing(c, x, y, winding[a, b], reaches[a, b], origin, res)


@njit(cache=True)
def _close_column(items, corners, x, y, column, reach, origin, res):
    """See to it that a column's crossings add up to 0, on another line if one was lost."""
    for attempt in range(1, ASIDE.shape[0]):
        left = 0
        for k in range(reach[0], reach[1] + 1):
            left += column[k]
        if left == 0:
            break
        for k in range(reach[0], reach[1] + 1):
            column[k] = 0
        aside_x, aside_y = x + ASIDE[attempt, 0] * res, y + ASIDE[attempt, 1] * res
        for t in items:
            _note_crossing(corners[t], aside_x, aside_y, column, reach, origin, res)


@njit(cache=True)
def _fill_inside(items, corners, label, tile, values, origin, res, touch, winding, reaches):
    """Fill the inside of a closed surface from its crossings, column by column; clear them."""
    num = values.shape[2]
    for i in range(tile[0], tile[1]):
        for j in range(tile[2], tile[3]):
            column, reach = winding[i - tile[0], j - tile[2]], reaches[i - tile[0], j - tile[2]]
            x0, x1, y0, y1 = _square(i, j, origin, res, touch)
            x, y = (x0 + x1) / 2.0, (y0 + y1) / 2.0
            _close_column(items, corners, x, y, column, reach, origin, res)
            inside = 0
            for k in range(reach[0], reach[1] + 1):
                inside += column[k]
                column[k] = 0
                if inside > 0 and k < num and (values[i, j, k] == 0 or values[i, j, k] > label):
                    values[i, j, k] = label
            reach[0], reach[1] = num, -1


@njit(cache=True)
def _fill_triangles(items, mode, label, corners, tile, values, origin, res, touch, scratch):
    """Fill what the triangles of one geom meet and enclose within a tile."""
    spans, winding, reaches, one, other, strip = scratch
    for i in range(TILE):
        for j in range(TILE):
            spans[i, j, 0], spans[i, j, 1] = math.inf, -math.inf
    for t in items:
        _add_triangle(
            corners[t], mode, label, tile, values, origin, res, touch,
            spans, winding, reaches, one, other, strip,
        )  # fmt: skip
    if mode == CONVEX:
        for i in range(tile[0], tile[1]):
            for j in range(tile[2], tile[3]):
                low, high = spans[i - tile[0], j - tile[2]]
                if low <= high:
                    _fill(values, i, j, low, high, label, origin, res, touch)
    if mode == CLOSED:
        _fill_inside(items, corners, label, tile, values, origin, res, touch, winding, reaches)


@njit(cache=True)
def _fill_tile(
    solids, solid_label, solid_items, planes, plane_label,
    corners, triangle_geom, triangle_items, mode, geom_label, tile, values, origin, res, touch,
):  # fmt: skip
    """Label the voxels of one tile."""
    one, other, strip = np.empty((12, 3)), np.empty((12, 3)), np.empty((12, 3))
    for s in solid_items:
        _fill_solid(s, solids, solid_label[s], tile, values, origin, res, touch, one, other)
    for p in range(plane_label.shape[0]):
        for i in range(tile[0], tile[1]):
            for j in range(tile[2], tile[3]):
                x0, x1, y0, y1 = _square(i, j, origin, res, touch)
                low, high = plane_span(planes[0][p], planes[1][p], x0, x1, y0, y1)
                _fill(values, i, j, low, high, plane_label[p], origin, res, touch)
    first, end = 0, triangle_items.shape[0]
    if end == 0:
        return
    reaches = np.empty((TILE, TILE, 2), np.int64)
    reaches[:, :, 0], reaches[:, :, 1] = values.shape[2], -1
    scratch = (
        np.empty((TILE, TILE, 2)), np.zeros((TILE, TILE, values.shape[2] + 1), np.int32), reaches,
        one, other, strip,
    )  # fmt: skip
    while first < end:
        geom = triangle_geom[triangle_items[first]]
        last = first + 1
        while last < end and triangle_geom[triangle_items[last]] == geom:
            last += 1
        _fill_triangles(
            triangle_items[first:last], mode[geom], geom_label[geom], corners, tile,
            values, origin, res, touch, scratch,
        )  # fmt: skip
        first = last


@njit(cache=True, parallel=True)
def fill_voxels(
    solids, solid_label, solid_start, solid_item,
    planes, plane_label,
    corners, triangle_geom, triangle_start, triangle_item, mode, geom_label,
    values, origin, res, touch,
):  # fmt: skip
    """Label all voxels that geoms meet.

    Args:
        solids: kind, pos, mat, size and bounds of the primitive solids.
        planes: pos and mat of the infinite planes.
        corners, triangle_geom: the triangles, (m, 3, 3) float64 [m], and their geoms,
            ascending.
        mode: by geom id, what its triangles enclose: SURFACE, CLOSED or CONVEX, uint8.
        solid_label, plane_label, geom_label: labels > 0, the last by geom id; in the dtype of
            `values`.
        solid_start, solid_item, triangle_start, triangle_item: the tiles' lists.
        values, origin, res, touch: the grid; labels are added to what it holds.
    """
    num_x, num_y, _ = values.shape
    tiles_y = (num_y + TILE - 1) // TILE
    num_tiles = (num_x + TILE - 1) // TILE * tiles_y
    # neighbours are alike: with every second tile in each half, threads have as much to do
    half = (num_tiles + 1) // 2
    for turn in prange(num_tiles):
        number = 2 * turn if turn < half else 2 * (turn - half) + 1
        x, y = number // tiles_y * TILE, number % tiles_y * TILE
        tile = (x, min(x + TILE, num_x), y, min(y + TILE, num_y))
        _fill_tile(
            solids, solid_label, solid_item[solid_start[number] : solid_start[number + 1]],
            planes, plane_label,
            corners, triangle_geom,
            triangle_item[triangle_start[number] : triangle_start[number + 1]],
            mode, geom_label, tile, values, origin, res, touch,
        )  # fmt: skip
