"""Which items lie over which tile of a lattice, so that a cell looks at few of them.

A uniform grid as in collision detection's broad phase (Ericson, Real-Time Collision Detection,
2005, 7.1), of tiles of TILE x TILE cells. The lists are one counting sort: count, sum up, write.
Bands of BAND rows are what one thread works on where items visit the cells under them.
"""

import math
from typing import Any

import numpy as np
from numba import njit

TILE = 8  # cells along a tile's edge
BAND = 8  # rows of cells in a band
# How far beyond the centres of cells one looks, in cells, so that rounding loses none
HAIR = 1e-3


def count_tiles(lattice: Any) -> int:
    """How many tiles a lattice has, in plain Python."""
    return int(-(-lattice.width // TILE) * -(-lattice.height // TILE))


@njit(cache=True)
def tile_of(lattice, cell):
    """The tile that holds a cell; tiles are numbered row by row."""
    row, col = cell // lattice.width, cell % lattice.width
    return row // TILE * ((lattice.width + TILE - 1) // TILE) + col // TILE


@njit(inline="always")
def tile_window(lattice, tile):
    """The rows and columns of a tile: the first row, past the last, and so with the columns."""
    tiles_x = (lattice.width + TILE - 1) // TILE
    row, col = tile // tiles_x * TILE, tile % tiles_x * TILE
    return row, min(row + TILE, lattice.height), col, min(col + TILE, lattice.width)


@njit(inline="always")
def center_of(lattice, row, col):
    """World x and y of a cell's centre by its row and column [m]."""
    x = lattice.x_min + (col + 0.5) * lattice.cell_size
    return x, lattice.y_max - (row + 0.5) * lattice.cell_size


@njit(inline="always")
def cell_center(lattice, cell):
    """World x and y of a cell's centre [m]."""
    return center_of(lattice, cell // lattice.width, cell % lattice.width)


@njit(inline="always")
def cells_near(lattice, window, boxes, i, reach):
    """The cells of a window whose centres are within `reach` of a box along both axes [m].

    Rounding may add a cell, and never loses one. Takes and returns what `tile_window` does.
    """
    row0, row1, col0, col1 = window
    per_cell = 1.0 / lattice.cell_size
    # centre number c is at c + 0.5 cells
    left = (boxes[i, 0] - reach - lattice.x_min) * per_cell - (0.5 + HAIR)
    right = (boxes[i, 3] + reach - lattice.x_min) * per_cell - (0.5 - HAIR)
    top = (lattice.y_max - boxes[i, 4] - reach) * per_cell - (0.5 + HAIR)
    bottom = (lattice.y_max - boxes[i, 1] + reach) * per_cell - (0.5 - HAIR)
    # clipped before they are whole numbers, which a far box would exceed
    col0 = math.ceil(min(max(left, col0), col1))
    row0 = math.ceil(min(max(top, row0), row1))
    col1 = math.floor(max(min(right, col1 - 1.0), -1.0)) + 1
    row1 = math.floor(max(min(bottom, row1 - 1.0), -1.0)) + 1
    return row0, row1, col0, col1


@njit(inline="always")
def centers_between(low, high, cell_size, count):
    """The first and the last of some cells in a row whose centre is between two coordinates.

    Both count from the edge of the first cell [m]; last < first for none. One too many is possible.
    """
    first = np.ceil(max(low / cell_size - 0.5 - HAIR, 0.0))
    last = np.floor(min(high / cell_size - 0.5 + HAIR, count - 1.0))
    return np.int64(min(first, float(count))), np.int64(max(last, -1.0))


@njit(inline="always")
def count_bands(lattice):
    """How many bands a lattice has."""
    return (lattice.height + BAND - 1) // BAND


@njit(cache=True)
def list_by_band(boxes, grow, lattice):
    """List, for each band, the (n, 6) boxes that hold a cell's centre, grown by `grow` [m].

    Returns what `list_by_tile` does.
    """
    cell, width, height = lattice.cell_size, lattice.width, lattice.height
    x_min, y_max = lattice.x_min, lattice.y_max
    start = np.zeros(count_bands(lattice) + 1, np.int64)
    cursor, item = start[:-1].copy(), np.empty(0, np.int32)
    for writing in (False, True):
        if writing:
            for band in range(cursor.shape[0]):
                start[band + 1] += start[band]
                cursor[band] = start[band]
            item = np.empty(start[-1], np.int32)
        for n in range(boxes.shape[0]):
            x0, x1 = boxes[n, 0] - grow - x_min, boxes[n, 3] + grow - x_min
            left, right = centers_between(x0, x1, cell, width)
            if right < left:
                continue
            y0, y1 = y_max - boxes[n, 4] - grow, y_max - boxes[n, 1] + grow
            first, last = centers_between(y0, y1, cell, height)
            if last < first:
                continue
            for band in range(first // BAND, last // BAND + 1):
                if writing:
                    item[cursor[band]] = n
                    cursor[band] += 1
                else:
                    start[band + 1] += 1
    return start, item


@njit(inline="always")
def _tile_range(low, high, num_tiles, tile_size):
    first = int(np.floor(max(low, 0.0) / tile_size))
    last = int(np.floor(min(high, num_tiles * tile_size) / tile_size))
    return first, min(last, num_tiles - 1)


@njit(cache=True)
def bin_boxes(bounds, grow, lattice):
    """List, for each tile, the (n, 6) boxes that reach into it, grown in the plane by `grow` [m].

    Returns what `list_by_tile` does.
    """
    width, height, cell_size = lattice.width, lattice.height, lattice.cell_size
    tiles_x, tiles_y = (width + TILE - 1) // TILE, (height + TILE - 1) // TILE
    size = TILE * cell_size
    ranges = np.zeros((bounds.shape[0], 4), np.int64)
    for n in range(bounds.shape[0]):
        x0 = bounds[n, 0] - grow - lattice.x_min
        x1 = bounds[n, 3] + grow - lattice.x_min
        y0 = lattice.y_max - bounds[n, 4] - grow
        y1 = lattice.y_max - bounds[n, 1] + grow
        if x1 < 0.0 or y1 < 0.0 or x0 > width * cell_size or y0 > height * cell_size:
            ranges[n, 1] = -1  # not a tuple at once: numba compiles its broadcasting for seconds
            continue
        ranges[n, 0], ranges[n, 1] = _tile_range(y0, y1, tiles_y, size)
        ranges[n, 2], ranges[n, 3] = _tile_range(x0, x1, tiles_x, size)
    return list_by_tile(ranges, tiles_y * tiles_x, tiles_x)


@njit(cache=True)
def list_by_tile(ranges, num_tiles, stride):
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
