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

    A rectangle's plane goes through the floor of its upper left cell. It is horizontal, or follows
    the slope to the next two cells on the right, to the next two below, or both, where these rise
    evenly.

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
    cell_bounds = np.empty((FIRST_CAPACITY, 4), np.int64)
    planes = np.empty((FIRST_CAPACITY, 3))
    num_planes = 0
    for row in range(height):
        for col in range(width):
            if not is_uncovered[row, col]:
                continue
            rise_right = _find_even_rise(labels, heights, is_uncovered, row, col, 0, 1, tolerance)
            rise_down = _find_even_rise(labels, heights, is_uncovered, row, col, 1, 0, tolerance)
            best_num_rows = 0
            best_num_cols = 0
            best_x_rise = 0.0
            best_y_rise = 0.0
            # level, sloped along the row, along the column, along both
            for slope_kind in range(4):
                x_rise = rise_right * (slope_kind % 2)
                y_rise = rise_down * (slope_kind // 2)
                # without a rise, the plane is one of the others
                is_duplicate_plane = (slope_kind % 2 > 0 and rise_right == 0.0) or (
                    slope_kind // 2 > 0 and rise_down == 0.0
                )
                if is_duplicate_plane or x_rise * x_rise + y_rise * y_rise > max_rise * max_rise:
                    continue
                num_rows, num_cols = _find_largest_rectangle(
                    labels, heights, is_uncovered, row, col, x_rise, y_rise, tolerance
                )
                # a slope takes three cells: any two heights lie on a line
                is_too_short = (x_rise != 0.0 and num_cols < 3) or (y_rise != 0.0 and num_rows < 3)
                if num_rows * num_cols > best_num_rows * best_num_cols and not is_too_short:
                    best_num_rows = num_rows
                    best_num_cols = num_cols
                    best_x_rise = x_rise
                    best_y_rise = y_rise
            is_uncovered[row : row + best_num_rows, col : col + best_num_cols] = False
            if num_planes == cell_bounds.shape[0]:
                cell_bounds = np.concatenate((cell_bounds, np.empty_like(cell_bounds)))
                planes = np.concatenate((planes, np.empty_like(planes)))
            cell_bounds[num_planes] = row, col, row + best_num_rows, col + best_num_cols
            planes[num_planes] = heights[row, col], best_x_rise, best_y_rise
            num_planes += 1
    return cell_bounds[:num_planes].copy(), planes[:num_planes].copy()


@subkernel
def _find_even_rise(labels, heights, is_uncovered, row, col, row_step, col_step, tolerance):
    """Return the rise from cell to cell of three cells of one label in a line [m].

    It is 0 if they don't rise evenly. From each cell to the next are `row_step` rows and `col_step`
    columns.
    """
    last_row = row + 2 * row_step
    last_col = col + 2 * col_step
    if last_row >= labels.shape[0] or last_col >= labels.shape[1]:
        return 0.0
    label = labels[row, col]
    for step in range(1, 3):
        step_row = row + step * row_step
        step_col = col + step * col_step
        if not is_uncovered[step_row, step_col] or labels[step_row, step_col] != label:
            return 0.0
    rise = (heights[last_row, last_col] - heights[row, col]) / 2
    middle_rise = heights[row + row_step, col + col_step] - heights[row, col]
    return rise if abs(middle_rise - rise) <= tolerance else 0.0


@subkernel
def _find_largest_rectangle(labels, heights, is_uncovered, row, col, x_rise, y_rise, tolerance):
    """Return the numbers of rows and columns of the largest rectangle with a given upper left cell.

    All of its cells have one label and lie on a plane, which rises by `x_rise` from column to
    column and by `y_rise` from row to row. Of several rectangles, the one with the fewest rows is
    taken. Row by row, the width is the number of cells, from the first column on, that fit in all
    rows so far.
    """
    label = labels[row, col]
    first_height = heights[row, col]
    width = labels.shape[1] - col
    best_num_rows = 0
    best_num_cols = 0
    for rect_row in range(row, labels.shape[0]):
        row_height = first_height + (rect_row - row) * y_rise
        num_fitting_cells = 0
        while num_fitting_cells < width:
            rect_col = col + num_fitting_cells
            if not is_uncovered[rect_row, rect_col] or labels[rect_row, rect_col] != label:
                break
            if (
                abs(heights[rect_row, rect_col] - row_height - num_fitting_cells * x_rise)
                > tolerance
            ):
                break
            num_fitting_cells += 1
        width = num_fitting_cells
        if width * (labels.shape[0] - row) <= best_num_rows * best_num_cols:
            break  # the width never grows, so no number of rows makes it larger
        if width * (rect_row - row + 1) > best_num_rows * best_num_cols:
            best_num_rows = rect_row - row + 1
            best_num_cols = width
    return best_num_rows, best_num_cols
