"""What lies over which tile of a voxel grid's columns, and where triangles are.

The same uniform grid of tiles as the lattice's (Ericson, Real-Time Collision Detection, 2005, 7.1),
listed by a counting sort as well, see `baker.kernels.tiles`.
"""

import math

import numpy as np

from navbake.baker.kernels.constants import OPEN_SURFACE
from navbake.baker.kernels.tiles import TILE
from navbake.compiled import kernel, part


@part
def touched(low, high, first, res, num):
    """The voxels along an axis that a closed interval meets: first, last (none: last < first)."""
    start, end = (low - first) / res, (high - first) / res
    if not (start <= num and end >= 0.0):
        return 0, -1
    return int(max(start, 0.0)), int(min(end, num - 1.0))


@part
def _list_items(ranges, num_tiles, stride):
    """List, for each tile, the items over it.

    Args:
        ranges: by item, its first and last tile along one axis, then along the other, (n, 4)
            int64; last < first for items beside all tiles.
        num_tiles: how many tiles there are.
        stride: the step between tile numbers along the first axis.

    Returns:
        start, (num_tiles + 1,) int64, and item, (start[-1],) int32, ascending within a tile.
    """
    start = np.zeros(num_tiles + 1, np.int64)
    item = np.empty(0, np.int32)
    cursor = start[:-1].copy()
    for writing in (False, True):
        if writing:
            for tile in range(num_tiles):
                start[tile + 1] += start[tile]
            item = np.empty(start[-1], np.int32)
            cursor = start[:-1].copy()
        for n in range(ranges.shape[0]):
            for one in range(ranges[n, 0], ranges[n, 1] + 1):
                for other in range(ranges[n, 2], ranges[n, 3] + 1):
                    tile = one * stride + other
                    if writing:
                        item[cursor[tile]] = n
                        cursor[tile] += 1
                    else:
                        start[tile + 1] += 1
    return start, item


@kernel
def bin_items(bounds, origin, res, shape):
    """List, for each tile of a grid's columns, the (n, 6) boxes that reach into it.

    Returns what `_list_items` does; tiles along y follow each other.
    """
    tiles_x, tiles_y = (shape[0] + TILE - 1) // TILE, (shape[1] + TILE - 1) // TILE
    ranges = np.empty((bounds.shape[0], 4), np.int64)
    top = origin[2] + shape[2] * res
    for n in range(bounds.shape[0]):
        i0, i1 = touched(bounds[n, 0], bounds[n, 3], origin[0], res, shape[0])
        j0, j1 = touched(bounds[n, 1], bounds[n, 4], origin[1], res, shape[1])
        is_beside = bounds[n, 2] > top or bounds[n, 5] < origin[2] or i1 < i0 or j1 < j0
        ranges[n, 0], ranges[n, 1] = (0, -1) if is_beside else (i0 // TILE, i1 // TILE)
        ranges[n, 2], ranges[n, 3] = j0 // TILE, j1 // TILE
    return _list_items(ranges, tiles_x * tiles_y, tiles_y)


@kernel
def box_triangles(triangles):
    """Boxes round triangles, (m, 6) float64; what encloses a volume is as high and low as its geom.

    So a column sees all of a volume's surface above and below the grid.
    """
    corners, geom, closed = triangles.corners, triangles.geom, triangles.closed
    boxes = np.empty((corners.shape[0], 6))
    first = 0
    for t in range(corners.shape[0]):
        c = corners[t]
        for k in range(3):
            boxes[t, k] = min(c[0, k], c[1, k], c[2, k])
            boxes[t, 3 + k] = max(c[0, k], c[1, k], c[2, k])
        if t + 1 < corners.shape[0] and geom[t + 1] == geom[t]:
            continue
        low, high = math.inf, -math.inf
        for n in range(first, t + 1):
            if closed[n] != OPEN_SURFACE:
                low, high = min(low, boxes[n, 2]), max(high, boxes[n, 5])
        for n in range(first, t + 1):
            if closed[n] != OPEN_SURFACE:
                boxes[n, 2], boxes[n, 5] = low, high
        first = t + 1
    return boxes


@kernel
def move_triangles(triangles, moved, rotation, shift, corners):
    """Move the triangles of the geoms that moved, into corners, (m, 3, 3) float64.

    By geom id, a corner p goes to ``rotation @ p + shift``.
    """
    base = triangles.corners
    for t in range(base.shape[0]):
        geom = triangles.geom[t]
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
