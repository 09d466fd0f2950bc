"""Tiles of a lattice, and the lists of boxes over each of them, for kernels.

Tiles are squares of TILE x TILE cells, a uniform grid as in the broad phase of collision detection
(Ericson, Real-Time Collision Detection, 2005, 7.1): a cell is tested only against the shapes whose
boxes lie over its tile. The lists are made by a counting sort over chunks of the boxes, each chunk
with its own counts, so that any number of threads makes the same lists.

Blocks are larger squares, of BLOCK x BLOCK cells; stages list their results block by block, see
`navbake.baker.core.blocks`.

A window, in these kernels, is a tuple of four numbers: the first row, the end of the rows, the
first column, the end of the columns. Ends are exclusive.
"""

import math

import numpy as np

from navbake.compiled import NO_REFCOUNT, kernel, subkernel

TILE = 8  # cells along a tile's edge; a tile's cells are the bits of an int64
BLOCK = 32  # cells along a block's edge
# Windows are widened by this much, so that rounding loses no cell's centre [cells]
CENTER_MARGIN = 1e-3
# The bits of all cells in a tile's first column
FIRST_COLUMN_BITS = np.int64(sum(1 << (row * TILE) for row in range(TILE)))


@subkernel(inline="always")
def tile_window(lattice, tile):
    """Return the window of a tile's cells: first row, end of rows, first column, end of columns.

    `tile` is the tile's number; tiles are numbered row by row from the north-west.
    """
    tiles_per_row = (lattice.width + TILE - 1) // TILE
    row = tile // tiles_per_row * TILE
    col = tile % tiles_per_row * TILE
    return row, min(row + TILE, lattice.height), col, min(col + TILE, lattice.width)


@subkernel(inline="always")
def block_window(lattice, block):
    """Return the window of a block's cells: first row, end of rows, first column, end of columns.

    `block` is the block's number; blocks are numbered row by row from the north-west.
    """
    blocks_per_row = (lattice.width + BLOCK - 1) // BLOCK
    row = block // blocks_per_row * BLOCK
    col = block % blocks_per_row * BLOCK
    return row, min(row + BLOCK, lattice.height), col, min(col + BLOCK, lattice.width)


@subkernel(inline="always")
def block_of(lattice, row, col):
    """Return the number of the block that holds a cell."""
    return row // BLOCK * ((lattice.width + BLOCK - 1) // BLOCK) + col // BLOCK


@subkernel(inline="always")
def cell_bit(row, col):
    """Return an int64 with the one bit that stands for the cell at a row and column of a tile."""
    return np.int64(1) << (row * TILE + col)


@subkernel(inline="always")
def window_bits(tile_bounds, inner_window):
    """Return a bit mask of the cells of a window inside of a tile.

    Args:
        tile_bounds: window of the tile, see `tile_window`.
        inner_window: window inside of it; may be empty.

    Returns:
        An int64 with the `cell_bit` of each cell of `inner_window`.
    """
    row_first, row_end, col_first, col_end = inner_window
    if row_first >= row_end or col_first >= col_end:
        return np.int64(0)
    first_row_bits = ((np.int64(1) << (col_end - col_first)) - 1) << (col_first - tile_bounds[2])
    bits_of_all_rows = first_row_bits * FIRST_COLUMN_BITS
    # without the rows before the first, and those from the end on
    bits = bits_of_all_rows & (np.int64(-1) << ((row_first - tile_bounds[0]) * TILE))
    if row_end - tile_bounds[0] < TILE:
        bits &= cell_bit(row_end - tile_bounds[0], 0) - 1
    return bits


@subkernel(inline="always")
def cell_center_at(lattice, row, col):
    """Return world x and y of a cell's centre, given its row and column [m]."""
    x = lattice.x_min + (col + 0.5) * lattice.cell_size
    return x, lattice.y_max - (row + 0.5) * lattice.cell_size


@subkernel(inline="always")
def cell_center(lattice, cell):
    """Return world x and y of a cell's centre, given its id [m]."""
    return cell_center_at(lattice, cell // lattice.width, cell % lattice.width)


@subkernel(inline="always")
def window_near_box(lattice, window, boxes, box, distance):
    """Return the part of a window with the cells whose centres are near a box.

    Rounding may add a row or a column, and never loses one.

    Args:
        lattice: the cells, as `Lattice`.
        window: window of cells, as `tile_window` returns it.
        boxes: (n, 6) float64, lower corner, upper corner [m].
        box: index of the box.
        distance: how far centres may be from the box along x and along y [m].

    Returns:
        A window inside of `window`; empty if no centre is near.
    """
    row_first, row_end, col_first, col_end = window
    cells_per_meter = 1.0 / lattice.cell_size
    # the centre of column c is at c + 0.5 cells
    col_low = (boxes[box, 0] - distance - lattice.x_min) * cells_per_meter - (0.5 + CENTER_MARGIN)
    col_high = (boxes[box, 3] + distance - lattice.x_min) * cells_per_meter - (0.5 - CENTER_MARGIN)
    row_low = (lattice.y_max - boxes[box, 4] - distance) * cells_per_meter - (0.5 + CENTER_MARGIN)
    row_high = (lattice.y_max - boxes[box, 1] + distance) * cells_per_meter - (0.5 - CENTER_MARGIN)
    # clipped before they become integers, whose range a far box would exceed
    col_first = math.ceil(min(max(col_low, col_first), col_end))
    row_first = math.ceil(min(max(row_low, row_first), row_end))
    col_end = math.floor(max(min(col_high, col_end - 1.0), -1.0)) + 1
    row_end = math.floor(max(min(row_high, row_end - 1.0), -1.0)) + 1
    return row_first, row_end, col_first, col_end


@subkernel(inline="always")
def find_centers_between(low, high, cell_size, num_cells):
    """Find the cells of a row, or of a column, whose centres lie between two coordinates.

    Rounding may add a cell at either end, and never loses one.

    Args:
        low, high: coordinates, measured from the outer edge of the first cell [m].
        cell_size: edge of a cell [m].
        num_cells: number of cells in the row.

    Returns:
        The index of the first and of the last such cell, int64; last < first if there is none.
    """
    first_cell = np.ceil(max(low / cell_size - 0.5 - CENTER_MARGIN, 0.0))
    last_cell = np.floor(min(high / cell_size - 0.5 + CENTER_MARGIN, num_cells - 1.0))
    return np.int64(min(first_cell, float(num_cells))), np.int64(max(last_cell, -1.0))


@subkernel(inline="always")
def _tile_range(low, high, num_tiles, tile_size):
    """Return the first and the last tile of a row of tiles that a stretch overlaps.

    The stretch is from `low` to `high`, measured from the outer edge of the first tile [m]. The
    last tile is before the first one if it overlaps none.
    """
    first = int(np.floor(max(low, 0.0) / tile_size))
    last = int(np.floor(min(high, num_tiles * tile_size) / tile_size))
    return first, min(last, num_tiles - 1)


@subkernel(inline="always")
def _find_tiles_under(boxes, box, margin, lattice):
    """Find the tiles that a box overlaps, widened by a margin, seen from above.

    Args:
        boxes: (n, 6) float64, lower corner, upper corner [m].
        box: index of the box.
        margin: how much the box is widened on each side [m].
        lattice: the cells, as `Lattice`.

    Returns:
        The first and the last row, and the first and the last column of these tiles. The last row
        is before the first row if there is no such tile.
    """
    width = lattice.width
    height = lattice.height
    cell_size = lattice.cell_size
    x_low = boxes[box, 0] - margin - lattice.x_min
    x_high = boxes[box, 3] + margin - lattice.x_min
    y_low = lattice.y_max - boxes[box, 4] - margin
    y_high = lattice.y_max - boxes[box, 1] + margin
    if x_high < 0.0 or y_high < 0.0 or x_low > width * cell_size or y_low > height * cell_size:
        return 0, -1, 0, -1
    tile_size = TILE * cell_size
    first_row, last_row = _tile_range(y_low, y_high, (height + TILE - 1) // TILE, tile_size)
    first_col, last_col = _tile_range(x_low, x_high, (width + TILE - 1) // TILE, tile_size)
    return first_row, last_row, first_col, last_col


@subkernel(inline="always")
def _find_tile_rows_under(boxes, box, margin, lattice):
    """Find the rows of tiles in which a box, widened by a margin, covers a cell's centre.

    The arguments are as in `_find_tiles_under`.

    Returns:
        The first and the last row of tiles; then two zeros, where `_find_tiles_under` returns
        columns. The last row is before the first row if the box covers no centre.
    """
    x_low = boxes[box, 0] - margin - lattice.x_min
    x_high = boxes[box, 3] + margin - lattice.x_min
    first_col, last_col = find_centers_between(x_low, x_high, lattice.cell_size, lattice.width)
    y_low = lattice.y_max - boxes[box, 4] - margin
    y_high = lattice.y_max - boxes[box, 1] + margin
    first_row, last_row = find_centers_between(y_low, y_high, lattice.cell_size, lattice.height)
    if last_col < first_col or last_row < first_row:
        return 0, -1, 0, -1
    return first_row // TILE, last_row // TILE, 0, 0


@kernel(nogil=True, **NO_REFCOUNT)
def list_boxes_by_tile(
    boxes,
    margin,
    lattice,
    by_tile_row,
    tile_range_of_box,
    next_index_of_tile,
    first_box,
    box_of_item,
):
    """List the boxes over each tile, or count them.

    It is called twice: first with an empty `box_of_item`, to count; then with room for the lists,
    when the boxes themselves aren't read any more.

    Args:
        boxes: (n, 6) float64, lower corner, upper corner [m].
        margin: how much the boxes are widened on each side [m].
        lattice: the cells, as `Lattice`.
        by_tile_row: if True, list by row of tiles instead of by tile, and only boxes that cover a
            cell's centre there.
        tile_range_of_box: receives, for each box, the first row, last row, first and last column of
            the tiles under it, (n, 4) int32, while counting; read while listing.
        next_index_of_tile: for each tile, the index in `box_of_item` for the next box over the
            tile, (tiles,) int64; advanced by 1 for each box.
        first_box: the number of the first box; the others follow it.
        box_of_item: receives numbers of boxes, tile by tile, int32; empty while counting.
    """
    is_listing = box_of_item.shape[0] > 0
    tiles_per_row = 1 if by_tile_row else (lattice.width + TILE - 1) // TILE
    for box in range(tile_range_of_box.shape[0]):
        if not is_listing:
            if by_tile_row:
                tile_range = _find_tile_rows_under(boxes, box, margin, lattice)
            else:
                tile_range = _find_tiles_under(boxes, box, margin, lattice)
            tile_range_of_box[box, 0] = tile_range[0]
            tile_range_of_box[box, 1] = tile_range[1]
            tile_range_of_box[box, 2] = tile_range[2]
            tile_range_of_box[box, 3] = tile_range[3]
        for row in range(tile_range_of_box[box, 0], tile_range_of_box[box, 1] + 1):
            first_tile = row * tiles_per_row + tile_range_of_box[box, 2]
            last_tile = row * tiles_per_row + tile_range_of_box[box, 3]
            for tile in range(first_tile, last_tile + 1):
                if is_listing:
                    box_of_item[next_index_of_tile[tile]] = first_box + box
                next_index_of_tile[tile] += 1
