"""Which items lie over which tile of a lattice, so that a cell looks at few of them.

A uniform grid as in collision detection's broad phase (Ericson, Real-Time Collision Detection,
2005, 7.1), of tiles of TILE x TILE cells. The lists are made by a counting sort over chunks of the
items, each with its own counts: several threads do it, and the order is the same for any number.
Where items visit the cells under them, a thread takes bands of TILE rows. Stages keep what they
found by blocks of BLOCK x BLOCK cells.
"""

import math

import numpy as np

from navbake.compiled import NO_REFCOUNT, kernel, subkernel

TILE = 8  # cells along a tile's edge; a tile's cells are the bits of an int64
BLOCK = 32  # cells along a block's edge
# How far beyond the centres of cells one looks, in cells, so that rounding loses none
CENTER_MARGIN = 1e-3
# The first column of a tile, all rows of it, as bits
ONE_COLUMN = np.int64(sum(1 << (row * TILE) for row in range(TILE)))


@subkernel(inline="always")
def tile_window(lattice, tile):
    """The rows and columns of a tile: the first row, past the last, and so with the columns."""
    tiles_x = (lattice.width + TILE - 1) // TILE
    row = tile // tiles_x * TILE
    col = tile % tiles_x * TILE
    return row, min(row + TILE, lattice.height), col, min(col + TILE, lattice.width)


@subkernel(inline="always")
def block_window(lattice, block):
    """The rows and columns of a block: the first row, past the last, and so with the columns."""
    cols = (lattice.width + BLOCK - 1) // BLOCK
    row = block // cols * BLOCK
    col = block % cols * BLOCK
    return row, min(row + BLOCK, lattice.height), col, min(col + BLOCK, lattice.width)


@subkernel(inline="always")
def block_of(lattice, row, col):
    """The block that holds a cell."""
    return row // BLOCK * ((lattice.width + BLOCK - 1) // BLOCK) + col // BLOCK


@subkernel(inline="always")
def cell_bit(row, col):
    """The bit of a cell by its row and column in a tile."""
    return np.int64(1) << (row * TILE + col)


@subkernel(inline="always")
def window_bits(window, near):
    """The bits, in a tile with a window, of the cells in a smaller one; see `tile_window`."""
    row0, row1, col0, col1 = near
    if row0 >= row1 or col0 >= col1:
        return np.int64(0)
    one_row = ((np.int64(1) << (col1 - col0)) - 1) << (col0 - window[2])
    all_rows = one_row * ONE_COLUMN
    # without the rows before the first, and those from past the last on
    bits = all_rows & (np.int64(-1) << ((row0 - window[0]) * TILE))
    if row1 - window[0] < TILE:
        bits &= cell_bit(row1 - window[0], 0) - 1
    return bits


@subkernel(inline="always")
def cell_center_at(lattice, row, col):
    """World x and y of a cell's centre by its row and column [m]."""
    x = lattice.x_min + (col + 0.5) * lattice.cell_size
    return x, lattice.y_max - (row + 0.5) * lattice.cell_size


@subkernel(inline="always")
def cell_center(lattice, cell):
    """World x and y of a cell's centre [m]."""
    return cell_center_at(lattice, cell // lattice.width, cell % lattice.width)


@subkernel(inline="always")
def window_near_box(lattice, window, boxes, i, reach):
    """The cells of a window whose centres are within `reach` of a box along both axes [m].

    Rounding may add a cell, and never loses one. Takes and returns what `tile_window` does.
    """
    row0, row1, col0, col1 = window
    per_cell = 1.0 / lattice.cell_size
    # centre number c is at c + 0.5 cells
    left = (boxes[i, 0] - reach - lattice.x_min) * per_cell - (0.5 + CENTER_MARGIN)
    right = (boxes[i, 3] + reach - lattice.x_min) * per_cell - (0.5 - CENTER_MARGIN)
    top = (lattice.y_max - boxes[i, 4] - reach) * per_cell - (0.5 + CENTER_MARGIN)
    bottom = (lattice.y_max - boxes[i, 1] + reach) * per_cell - (0.5 - CENTER_MARGIN)
    # clipped before they are whole numbers, which a far box would exceed
    col0 = math.ceil(min(max(left, col0), col1))
    row0 = math.ceil(min(max(top, row0), row1))
    col1 = math.floor(max(min(right, col1 - 1.0), -1.0)) + 1
    row1 = math.floor(max(min(bottom, row1 - 1.0), -1.0)) + 1
    return row0, row1, col0, col1


@subkernel(inline="always")
def centers_between(low, high, cell_size, count):
    """The first and the last of some cells in a row whose centre is between two coordinates.

    Both count from the edge of the first cell [m]; last < first for none. One too many is possible.
    """
    first = np.ceil(max(low / cell_size - 0.5 - CENTER_MARGIN, 0.0))
    last = np.floor(min(high / cell_size - 0.5 + CENTER_MARGIN, count - 1.0))
    return np.int64(min(first, float(count))), np.int64(max(last, -1.0))


@subkernel(inline="always")
def _tile_range(low, high, num_tiles, tile_size):
    first = int(np.floor(max(low, 0.0) / tile_size))
    last = int(np.floor(min(high, num_tiles * tile_size) / tile_size))
    return first, min(last, num_tiles - 1)


@subkernel(inline="always")
def _tiles_under(boxes, n, grow, lattice):
    """The first and last row of tiles that a grown box reaches into, and so with the columns."""
    width = lattice.width
    height = lattice.height
    cell_size = lattice.cell_size
    x0 = boxes[n, 0] - grow - lattice.x_min
    x1 = boxes[n, 3] + grow - lattice.x_min
    y0 = lattice.y_max - boxes[n, 4] - grow
    y1 = lattice.y_max - boxes[n, 1] + grow
    if x1 < 0.0 or y1 < 0.0 or x0 > width * cell_size or y0 > height * cell_size:
        return 0, -1, 0, -1
    size = TILE * cell_size
    first_row, last_row = _tile_range(y0, y1, (height + TILE - 1) // TILE, size)
    first_col, last_col = _tile_range(x0, x1, (width + TILE - 1) // TILE, size)
    return first_row, last_row, first_col, last_col


@subkernel(inline="always")
def _bands_under(boxes, n, grow, lattice):
    """The first and last band in which a grown box holds a cell's centre, and no columns."""
    x0 = boxes[n, 0] - grow - lattice.x_min
    x1 = boxes[n, 3] + grow - lattice.x_min
    left, right = centers_between(x0, x1, lattice.cell_size, lattice.width)
    y0 = lattice.y_max - boxes[n, 4] - grow
    y1 = lattice.y_max - boxes[n, 1] + grow
    first, last = centers_between(y0, y1, lattice.cell_size, lattice.height)
    if right < left or last < first:
        return 0, -1, 0, -1
    return first // TILE, last // TILE, 0, 0


@kernel(nogil=True, **NO_REFCOUNT)
def list_boxes_by_tile(boxes, grow, lattice, by_band, under, cursor, item, first, end):
    """Count, or list, the (n, 6) boxes of chunks ``range(first, end)`` that reach into each tile.

    Args:
        grow: by how much the boxes are widened on each side [m].
        by_band: in place of tiles, bands in which a box holds a cell's centre.
        under: by box, (n, 4) int32: the first and last row and column of the tiles under it;
            written while counting.
        cursor: by chunk and tile, (chunks, tiles) int64: where the chunk's next box over the tile
            goes; advanced.
        item: receives the boxes, int32; they are only counted where it is empty.
    """
    num = boxes.shape[0]
    num_chunks = cursor.shape[0]
    writing = item.shape[0] > 0
    stride = 1 if by_band else (lattice.width + TILE - 1) // TILE
    for chunk in range(first, end):
        place = cursor[chunk]
        for n in range(num * chunk // num_chunks, num * (chunk + 1) // num_chunks):
            if not writing:
                if by_band:
                    found = _bands_under(boxes, n, grow, lattice)
                else:
                    found = _tiles_under(boxes, n, grow, lattice)
                under[n, 0], under[n, 1], under[n, 2], under[n, 3] = found
            for row in range(under[n, 0], under[n, 1] + 1):
                for tile in range(row * stride + under[n, 2], row * stride + under[n, 3] + 1):
                    if writing:
                        item[place[tile]] = n
                    place[tile] += 1
