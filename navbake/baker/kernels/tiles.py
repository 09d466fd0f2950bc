"""Which items lie over which tile of the lattice, so that a cell looks at few of them."""

from __future__ import annotations

import numpy as np
from numba import njit

TILE = 8  # cells along a tile's edge


@njit(cache=True)
def _tile_range(low, high, num_tiles, tile_size):
    first = int(np.floor(max(low, 0.0) / tile_size))
    last = int(np.floor(min(high, num_tiles * tile_size) / tile_size))
    return first, min(last, num_tiles - 1)


@njit(cache=True)
def bin_boxes(bounds, grow, x_min, y_max, cell_size, width, height):
    """List, for each tile, the boxes that reach into it.

    Args:
        bounds: boxes, (n, 6) float64: lower corner, upper corner, world frame [m].
        grow: what is added to every box on all sides in the plane [m].
        x_min, y_max, cell_size, width, height: the lattice.

    Returns:
        start, (num_tiles + 1,) int64, and item, (start[-1],) int32: tile t (row-major) holds
        ``item[start[t]:start[t + 1]]``, ascending.
    """
    tiles_x = (width + TILE - 1) // TILE
    tiles_y = (height + TILE - 1) // TILE
    size = TILE * cell_size
    start = np.zeros(tiles_x * tiles_y + 1, np.int64)
    item = np.empty(0, np.int32)
    cursor = start[:-1].copy()
    for pass_ in range(2):
        if pass_ == 1:
            for tile in range(tiles_x * tiles_y):
                start[tile + 1] += start[tile]
            item = np.empty(start[-1], np.int32)
            cursor = start[:-1].copy()
        for n in range(bounds.shape[0]):
            x0 = bounds[n, 0] - grow - x_min
            x1 = bounds[n, 3] + grow - x_min
            y0 = y_max - bounds[n, 4] - grow
            y1 = y_max - bounds[n, 1] + grow
            if x1 < 0.0 or y1 < 0.0 or x0 > width * cell_size or y0 > height * cell_size:
                continue
            col0, col1 = _tile_range(x0, x1, tiles_x, size)
            row0, row1 = _tile_range(y0, y1, tiles_y, size)
            for row in range(row0, row1 + 1):
                for col in range(col0, col1 + 1):
                    tile = row * tiles_x + col
                    if pass_ == 0:
                        start[tile + 1] += 1
                    else:
                        item[cursor[tile]] = n
                        cursor[tile] += 1
    return start, item
