"""Regions: ascending lists of cells that something is asked about."""

import math

import numpy as np

from navbake.compiled import kernel, part


@part(inline="always")
def _mark_row(row, first, last, width, left, right, flag):
    """Mark the cells ``[first, last)`` of a row, and note how far its marks reach."""
    flag[row * width + first : row * width + last] = True
    left[row], right[row] = min(left[row], first), max(right[row], last)


@part
def _take_marked(width, left, right, flag):
    """The marked cells, ascending; row by row, which costs less than to sort them.

    `left` and `right` tell where in each row marks begin, and past their end. Takes the marks off.
    """
    total, k = 0, 0
    for row in range(left.shape[0]):
        total += max(right[row] - left[row], 0)
    cells = np.empty(total, np.int64)
    for row in range(left.shape[0]):
        for cell in range(row * width + left[row], row * width + right[row]):
            if flag[cell]:
                flag[cell] = False
                cells[k] = cell
                k += 1
    return cells[:k].copy()


@kernel(nogil=True)
def cells_of_boxes(lattice, boxes, grow, spare, flag):
    """The cells whose centres lie in boxes, (n, 6) [m], grown by `grow` [m] and `spare` [cells].

    Ascending. `spare` is more than rounding can make. `flag`, (cells,) bool, is all False, and so
    again afterwards.
    """
    size, width = lattice.cell_size, lattice.width
    left_end, right_end = np.full(lattice.height, width), np.zeros(lattice.height, np.int64)
    for n in range(boxes.shape[0]):
        # clipped before they are whole numbers, which a far box would exceed
        left = (boxes[n, 0] - grow - lattice.x_min) / size - 0.5 - spare
        right = (boxes[n, 3] + grow - lattice.x_min) / size - 0.5 + spare
        top = (lattice.y_max - boxes[n, 4] - grow) / size - 0.5 - spare
        bottom = (lattice.y_max - boxes[n, 1] + grow) / size - 0.5 + spare
        first_row = math.ceil(min(max(top, 0.0), lattice.height))
        end_row = math.floor(min(max(bottom + 1.0, 0.0), lattice.height))
        first = math.ceil(min(max(left, 0.0), width))
        last = math.floor(min(max(right + 1.0, 0.0), width))
        if last > first:
            for row in range(first_row, end_row):
                _mark_row(row, first, last, width, left_end, right_end, flag)
    return _take_marked(width, left_end, right_end, flag)


@kernel(nogil=True)
def are_in(cells, some):
    """Which cells of a region are in another one, (n,) bool; both ascending: a merge."""
    result, k = np.zeros(cells.shape[0], np.bool_), 0
    for n in range(cells.shape[0]):
        while k < some.shape[0] and some[k] < cells[n]:
            k += 1
        result[n] = k < some.shape[0] and some[k] == cells[n]
    return result


@kernel(nogil=True)
def join_cells(one, other):
    """The cells of two regions, each once, ascending: a merge."""
    cells, i, j, count = np.empty(one.shape[0] + other.shape[0], np.int64), 0, 0, 0
    while i < one.shape[0] or j < other.shape[0]:
        if j == other.shape[0] or (i < one.shape[0] and one[i] <= other[j]):
            cell = one[i]
            i += 1
            if j < other.shape[0] and other[j] == cell:
                j += 1
        else:
            cell = other[j]
            j += 1
        cells[count] = cell
        count += 1
    return cells[:count].copy()


@kernel(nogil=True)
def near_tiles(boxes, reach, lattice, tile, summed, result):
    """Tell which boxes, (n, 6) [m], grown by `reach` [m], may lie over marked tiles; (n,) bool.

    Args:
        tile: edge of a tile [cells].
        summed: by tile, how many marked ones there are above and left of it, (rows + 1,
            columns + 1), a summed-area table (Crow, 1984).
    """
    edge = tile * lattice.cell_size
    num_rows, num_cols = summed.shape[0] - 1, summed.shape[1] - 1
    for n in range(boxes.shape[0]):
        # rounding may add a tile, and never loses one
        left = (boxes[n, 0] - reach - lattice.x_min) / edge - 1e-6
        right = (boxes[n, 3] + reach - lattice.x_min) / edge + 1e-6
        top = (lattice.y_max - boxes[n, 4] - reach) / edge - 1e-6
        bottom = (lattice.y_max - boxes[n, 1] + reach) / edge + 1e-6
        col0 = math.floor(min(max(left, 0.0), num_cols))
        row0 = math.floor(min(max(top, 0.0), num_rows))
        col1 = math.floor(min(max(right + 1.0, 0.0), num_cols))
        row1 = math.floor(min(max(bottom + 1.0, 0.0), num_rows))
        count = 0
        if row1 > row0 and col1 > col0:
            count = summed[row1, col1] - summed[row0, col1] - summed[row1, col0]
            count += summed[row0, col0]
        result[n] = count > 0
