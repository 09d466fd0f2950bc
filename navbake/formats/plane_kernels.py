"""Covers cells by rectangles on each of which the floor is a plane, greedily, row by row.

From each cell that isn't covered yet, the largest rectangle is taken whose upper left cell it is:
the one with the most cells of all planes that it may begin with, level or sloped along its columns
and rows; of equal ones the lower in height. That is not the least number possible, but near it on
floor plans. Where all heights are the same, these are rectangles of one label.
"""

import numpy as np

from navbake.compiled import kernel, subkernel

FIRST_CAPACITY = 1024


@kernel
def cover_planes(labels, z, tolerance, steepest):
    """Cover all cells whose label isn't 0 by rectangles of one label and one plane each.

    The cells are visited row by row; each that isn't covered is the upper left corner of the next
    rectangle. Its plane runs through the cell's height and is level, or has the slope of the two
    cells to the right (and below), if these rise evenly and no more than `steepest` over a cell.
    `labels` and `z`, the heights of cells' centres, have shape (height, width); a height may be off
    its plane by `tolerance`.

    Returns:
        First row, first column, row and column after the last, shape (n, 4), int64; and of each
        the height at its first cell's centre, its rise from column to column, and from row to row,
        shape (n, 3), float64.
    """
    height, width = labels.shape
    is_open = labels != 0
    bounds = np.empty((FIRST_CAPACITY, 4), np.int64)
    planes = np.empty((FIRST_CAPACITY, 3))
    num = 0
    for row in range(height):
        for col in range(width):
            if not is_open[row, col]:
                continue
            right = _slope(labels, z, is_open, row, col, 0, 1, tolerance)
            down = _slope(labels, z, is_open, row, col, 1, 0, tolerance)
            best_rows = 0
            best_cols = 0
            best_x = 0.0
            best_y = 0.0
            for way in range(4):
                x = right * (way % 2)
                y = down * (way // 2)
                is_same = (way % 2 > 0 and right == 0.0) or (way // 2 > 0 and down == 0.0)
                if is_same or x * x + y * y > steepest * steepest:
                    continue
                rows, cols = _largest(labels, z, is_open, row, col, x, y, tolerance)
                # a slope takes three cells: two are on one whatever their heights
                is_short = (x != 0.0 and cols < 3) or (y != 0.0 and rows < 3)
                if rows * cols > best_rows * best_cols and not is_short:
                    best_rows = rows
                    best_cols = cols
                    best_x = x
                    best_y = y
            is_open[row : row + best_rows, col : col + best_cols] = False
            if num == bounds.shape[0]:
                bounds = np.concatenate((bounds, np.empty_like(bounds)))
                planes = np.concatenate((planes, np.empty_like(planes)))
            bounds[num] = row, col, row + best_rows, col + best_cols
            planes[num] = z[row, col], best_x, best_y
            num += 1
    return bounds[:num].copy(), planes[:num].copy()


@subkernel
def _slope(labels, z, is_open, row, col, down, right, tolerance):
    """The rise over a cell along three cells of one label; 0 where they don't rise evenly."""
    last_row = row + 2 * down
    last_col = col + 2 * right
    if last_row >= labels.shape[0] or last_col >= labels.shape[1]:
        return 0.0
    label = labels[row, col]
    for n in range(1, 3):
        r = row + n * down
        c = col + n * right
        if not is_open[r, c] or labels[r, c] != label:
            return 0.0
    rise = (z[last_row, last_col] - z[row, col]) / 2
    return rise if abs(z[row + down, col + right] - z[row, col] - rise) <= tolerance else 0.0


@subkernel
def _largest(labels, z, is_open, row, col, x, y, tolerance):
    """Rows and columns of the largest rectangle on a plane, from its upper left cell."""
    label = labels[row, col]
    here = z[row, col]
    least = labels.shape[1] - col
    best_rows = 0
    best_cols = 0
    for r in range(row, labels.shape[0]):
        level = here + (r - row) * y
        run = 0
        while run < least:
            c = col + run
            if not is_open[r, c] or labels[r, c] != label:
                break
            if abs(z[r, c] - level - run * x) > tolerance:
                break
            run += 1
        least = run
        if least * (labels.shape[0] - row) <= best_rows * best_cols:
            break  # it gets no wider, so no height makes it larger
        if least * (r - row + 1) > best_rows * best_cols:
            best_rows = r - row + 1
            best_cols = least
    return best_rows, best_cols
