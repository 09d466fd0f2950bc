"""Covers cells of one label by rectangles: greedily, the largest from each corner, row by row."""

import numpy as np

from navbake.compiled import kernel, part

FIRST_CAPACITY = 1024


@kernel
def cover(labels):
    """Cover all cells whose label isn't 0 by rectangles of one label that don't overlap.

    The cells are visited row by row. From the first one that isn't covered, which is then the upper
    left corner, the rectangle with the most cells is taken; of equal ones the lower in height. As
    it grows by a row, its width is the least run of such cells to the right in its rows, so that
    one pass down the column finds it.

    Args:
        labels: shape (height, width), int64.

    Returns:
        Rows and columns: first row, first column, row and column after the last, shape (n, 4),
        int64.
    """
    height, width = labels.shape
    reach = np.zeros((height, width), dtype=np.int64)
    for row in range(height):
        for col in range(width - 1, -1, -1):
            if labels[row, col] != 0:
                goes_on = col + 1 < width and labels[row, col + 1] == labels[row, col]
                reach[row, col] = 1 + (reach[row, col + 1] if goes_on else 0)
    found = np.empty((FIRST_CAPACITY, 4), dtype=np.int64)
    num = 0
    for row in range(height):
        for col in range(width):
            if reach[row, col] == 0:
                continue
            rows, cols = _largest(labels, reach, row, col)
            _take(reach, row, col, rows, cols)
            if num == found.shape[0]:
                more = np.empty((2 * num, 4), dtype=np.int64)
                more[:num] = found
                found = more
            found[num, 0], found[num, 1] = row, col
            found[num, 2], found[num, 3] = row + rows, col + cols
            num += 1
    return found[:num].copy()


@part
def _largest(labels, reach, row, col):
    """Rows and columns of the rectangle with the most cells whose upper left one is given."""
    least, most_cells = reach[row, col], 0
    best_rows, best_cols = 0, 0
    last = labels.shape[0]
    for below in range(row, last):
        if reach[below, col] == 0 or labels[below, col] != labels[row, col]:
            break
        least = min(least, reach[below, col])
        if least * (last - row) <= most_cells:
            break  # it gets no wider, so no height makes it larger
        if least * (below - row + 1) > most_cells:
            best_rows, best_cols = below - row + 1, least
            most_cells = best_rows * best_cols
    return best_rows, best_cols


@part
def _take(reach, row, col, rows, cols):
    """Mark a rectangle as covered; runs from the left now end at it."""
    for r in range(row, row + rows):
        for c in range(col, col + cols):
            reach[r, c] = 0
        c = col - 1
        while c >= 0 and reach[r, c] > col - c:
            reach[r, c] = col - c
            c -= 1
