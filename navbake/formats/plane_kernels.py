"""Covers cells by rectangles on each of which the floor is a plane, greedily, row by row.

In reading order, each cell that isn't covered yet becomes the upper left cell of a rectangle. There
are four planes through the cell: horizontal, or sloped along its row, its column or both. The
kernel takes the plane whose rectangle has the most cells; of several, the first in this order. That
does not find the smallest possible number of rectangles, but comes near it on floor plans.
"""

import numpy as np

from navbake.compiled import kernel, subkernel

FIRST_CAPACITY = 1024


@kernel
def cover_planes(labels, heights, tolerance, max_rise):
    """Cover all cells whose label isn't 0 by rectangles of one label and one plane each.

    A rectangle's plane has the height of its first cell there. It is horizontal, or has the slope
    of the next two cells to the right, below, or both, if these rise evenly.

    Args:
        labels: the label of each cell, shape (height, width), int32.
        heights: the height at each cell's centre, of the same shape, float64 [m].
        tolerance: by how much a cell's height may be off its plane [m].
        max_rise: the largest rise of a plane from one cell to the next [m].

    Returns:
        Two arrays with a row for each rectangle. The first, shape (n, 4), int64, has the first row,
        the first column, the row after the last, and the column after the last. The second, shape
        (n, 3), float64, has the height at the first cell's centre, the rise from column to column,
        and the rise from row to row [m].
    """
    height, width = labels.shape
    is_uncovered = labels != 0
    bounds = np.empty((FIRST_CAPACITY, 4), np.int64)
    planes = np.empty((FIRST_CAPACITY, 3))
    num_planes = 0
    for row in range(height):
        for col in range(width):
            if not is_uncovered[row, col]:
                continue
            right = _find_even_rise(labels, heights, is_uncovered, row, col, 0, 1, tolerance)
            down = _find_even_rise(labels, heights, is_uncovered, row, col, 1, 0, tolerance)
            best_rows = 0
            best_cols = 0
            best_x = 0.0
            best_y = 0.0
            # level, sloped along the row, along the column, along both
            for slope in range(4):
                x = right * (slope % 2)
                y = down * (slope // 2)
                # without a rise, the plane is one of the others
                is_same = (slope % 2 > 0 and right == 0.0) or (slope // 2 > 0 and down == 0.0)
                if is_same or x * x + y * y > max_rise * max_rise:
                    continue
                rows, cols = _find_largest_rectangle(
                    labels, heights, is_uncovered, row, col, x, y, tolerance
                )
                # a slope takes three cells: any two heights lie on a line
                is_short = (x != 0.0 and cols < 3) or (y != 0.0 and rows < 3)
                if rows * cols > best_rows * best_cols and not is_short:
                    best_rows = rows
                    best_cols = cols
                    best_x = x
                    best_y = y
            is_uncovered[row : row + best_rows, col : col + best_cols] = False
            if num_planes == bounds.shape[0]:
                bounds = np.concatenate((bounds, np.empty_like(bounds)))
                planes = np.concatenate((planes, np.empty_like(planes)))
            bounds[num_planes] = row, col, row + best_rows, col + best_cols
            planes[num_planes] = heights[row, col], best_x, best_y
            num_planes += 1
    return bounds[:num_planes].copy(), planes[:num_planes].copy()


@subkernel
def _find_even_rise(labels, heights, is_uncovered, row, col, down, right, tolerance):
    """Return the rise from cell to cell of three cells of one label in a line [m].

    It is 0 if they don't rise evenly. The line leads `down` rows and `right` columns on each time.
    """
    last_row = row + 2 * down
    last_col = col + 2 * right
    if last_row >= labels.shape[0] or last_col >= labels.shape[1]:
        return 0.0
    label = labels[row, col]
    for n in range(1, 3):
        r = row + n * down
        c = col + n * right
        if not is_uncovered[r, c] or labels[r, c] != label:
            return 0.0
    rise = (heights[last_row, last_col] - heights[row, col]) / 2
    middle_rise = heights[row + down, col + right] - heights[row, col]
    return rise if abs(middle_rise - rise) <= tolerance else 0.0


@subkernel
def _find_largest_rectangle(labels, heights, is_uncovered, row, col, x, y, tolerance):
    """Return the numbers of rows and columns of the largest rectangle with a given upper left cell.

    All of its cells have one label and lie on a plane, which rises by `x` from column to column and
    by `y` from row to row. Of several rectangles, the one with the fewest rows is taken. Row by
    row, the width is the number of cells, from the first column on, that fit in all rows so far.
    """
    label = labels[row, col]
    first_height = heights[row, col]
    width = labels.shape[1] - col
    best_rows = 0
    best_cols = 0
    for r in range(row, labels.shape[0]):
        row_height = first_height + (r - row) * y
        num_fitting = 0
        while num_fitting < width:
            c = col + num_fitting
            if not is_uncovered[r, c] or labels[r, c] != label:
                break
            if abs(heights[r, c] - row_height - num_fitting * x) > tolerance:
                break
            num_fitting += 1
        width = num_fitting
        if width * (labels.shape[0] - row) <= best_rows * best_cols:
            break  # the width never grows, so no number of rows makes it larger
        if width * (r - row + 1) > best_rows * best_cols:
            best_rows = r - row + 1
            best_cols = width
    return best_rows, best_cols
