"""What lies over which tile of a voxel grid's columns, and where triangles are."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TILE = 8  # columns along a tile's edge
SURFACE, CLOSED, CONVEX = 0, 1, 2  # what triangles of a geom enclose


@njit(cache=True)
def touched(low, high, first, res, num):
    """The voxels along an axis that a closed interval meets: first, last (none: last < first)."""
    start, end = (low - first) / res, (high - first) / res
    if not (start <= num and end >= 0.0):
        return 0, -1
    return int(max(start, 0.0)), int(min(end, num - 1.0))


@njit(cache=True)
def bin_items(bounds, origin, res, shape):
    """List, for each tile of columns, the boxes that reach into it.

    Args:
        bounds: (n, 6) float64: lower and upper corners [m].
        origin, res, shape: the grid.

    Returns:
        start, (num_tiles + 1,) int64, and item int32: tile t holds
        ``item[start[t]:start[t + 1]]``, ascending.
    """
    tiles_x, tiles_y = (shape[0] + TILE - 1) // TILE, (shape[1] + TILE - 1) // TILE
    start = np.zeros(tiles_x * tiles_y + 1, np.int64)
    item = np.empty(0, np.int32)
    cursor = start[:-1].copy()
    top = origin[2] + shape[2] * res
    for writing in range(2):
        if writing == 1:
            for tile in range(tiles_x * tiles_y):
                start[tile + 1] += start[tile]
            item = np.empty(start[-1], np.int32)
            cursor = start[:-1].copy()
        for n in range(bounds.shape[0]):
            if bounds[n, 2] > top or bounds[n, 5] < origin[2]:
                continue
            i0, i1 = touched(bounds[n, 0], bounds[n, 3], origin[0], res, shape[0])
            j0, j1 = touched(bounds[n, 1], bounds[n, 4], origin[1], res, shape[1])
            if i1 < i0 or j1 < j0:
                continue
            for x in range(i0 // TILE, i1 // TILE + 1):
                for y in range(j0 // TILE, j1 // TILE + 1):
                    tile = x * tiles_y + y
                    if writing == 0:
                        start[tile + 1] += 1
                    else:
                        item[cursor[tile]] = n
                        cursor[tile] += 1
    return start, item


@njit(cache=True)
def box_triangles(corners, triangle_geom, mode):
    """Boxes round triangles; what encloses a volume reaches as high and low as its geom does.

    So a column sees all of a volume's surface above and below the grid.

    Args:
        corners, triangle_geom: (m, 3, 3) float64 [m], and geoms int32, ascending.
        mode: by geom id, see `fill_voxels`.

    Returns:
        (m, 6) float64: lower and upper corners [m].
    """
    boxes = np.empty((corners.shape[0], 6))
    first = 0
    for t in range(corners.shape[0]):
        c = corners[t]
        for k in range(3):
            boxes[t, k] = min(c[0, k], c[1, k], c[2, k])
            boxes[t, 3 + k] = max(c[0, k], c[1, k], c[2, k])
        if t + 1 < corners.shape[0] and triangle_geom[t + 1] == triangle_geom[t]:
            continue
        if mode[triangle_geom[t]] != SURFACE:
            low, high = math.inf, -math.inf
            for n in range(first, t + 1):
                low, high = min(low, boxes[n, 2]), max(high, boxes[n, 5])
            for n in range(first, t + 1):
                boxes[n, 2], boxes[n, 5] = low, high
        first = t + 1
    return boxes


@njit(cache=True)
def move_triangles(base, triangle_geom, moved, rotation, shift, corners):
    """Move the triangles of some geoms from where they were first.

    Args:
        base: (m, 3, 3) float64, where they were [m].
        triangle_geom: their geoms, int32.
        moved: by geom id, whether it moved, bool.
        rotation, shift: by geom id, (n, 3, 3) and (n, 3) float64: ``rotation @ p + shift``.
        corners: (m, 3, 3) float64, receives those that moved.
    """
    for t in range(base.shape[0]):
        geom = triangle_geom[t]
        if not moved[geom]:
            continue
        for corner in range(3):
            for k in range(3):
                corners[t, corner, k] = (
                    rotation[geom, k, 0] * base[t, corner, 0]
                    + rotation[geom, k, 1] * base[t, corner, 1]
                    + rotation[geom, k, 2] * base[t, corner, 2]
                    + shift[geom, k]
                )
