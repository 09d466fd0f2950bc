"""Windows of a lattice, cells in them, neighboring cells, and cells near boxes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.tiles import CENTER_MARGIN
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int

Window = tuple[slice, slice]
"""The rows and the columns of a window, as two slices with a start and a stop each."""

CellSlices = tuple[slice, ...]
"""An index into an array of shape (height, width, ...)."""

NEIGHBOR_SLICES: tuple[tuple[CellSlices, CellSlices], ...] = (
    (np.s_[:, :-1], np.s_[:, 1:]),
    (np.s_[:-1,], np.s_[1:,]),
)
"""Indices that select the two cells of all pairs of neighbors: first of the pairs along rows (left
and right cells), then of the pairs along columns (upper and lower cells)."""


def list_differing_pairs(values: NDArray[Any]) -> Int:
    """List the pairs of neighboring cells whose values differ.

    Args:
        values: shape (height, width).

    Returns:
        Ids of the two cells of each pair, shape (2, n): first the pairs along rows, then those
        along columns.
    """
    width = values.shape[1]
    flat_values = values.ravel()
    left_cell = np.flatnonzero(flat_values[:-1] != flat_values[1:])
    left_cell = left_cell[(left_cell + 1) % width > 0]  # not across the end of a row
    upper_cell = np.flatnonzero(flat_values[:-width] != flat_values[width:])
    pairs_in_rows = [left_cell, left_cell + 1]
    pairs_in_columns = [upper_cell, upper_cell + width]
    return np.concatenate([pairs_in_rows, pairs_in_columns], axis=1)


def clip_boxes(lattice: Lattice, boxes: Float, margin: float) -> Float:
    """Cut off the parts of boxes that lie farther from the lattice than a margin, in x and y.

    Args:
        lattice: the cells.
        boxes: lower corner, upper corner, shape (n, 6) [m].
        margin: how far beyond the lattice boxes may reach [m].

    Returns:
        The boxes, shape (n, 6) [m]; their heights are unchanged.
    """
    x_min, y_min, x_max, y_max = lattice.bounds
    lower_limits = [x_min - margin, y_min - margin, -np.inf]
    upper_limits = [x_max + margin, y_max + margin, np.inf]
    clipped_boxes: Float = boxes.clip(2 * lower_limits, 2 * upper_limits)
    return clipped_boxes


def find_cells_near_boxes(lattice: Lattice, boxes: Float, distance: float) -> Int:
    """Find the cells whose centres are near boxes, seen from above.

    Rounding may add a row or a column, and never loses one.

    Args:
        lattice: the cells.
        boxes: lower corner, upper corner, shape (n, 6) [m]; may be infinite.
        distance: how far centres may be from a box along x and along y [m].

    Returns:
        Ids of the cells, ascending, shape (m,).
    """
    if not len(boxes):
        return np.empty(0, dtype=np.int64)
    # `rows_cols` takes finite positions only
    clipped_boxes = clip_boxes(lattice, boxes, distance + 4 * lattice.cell_size)
    # The first cell whose centre lies behind a position is the cell of the position half a cell
    # farther on. So these are x and y in the first cell near each box, and in that after the last.
    first_shift = (0.5 - CENTER_MARGIN) * lattice.cell_size - distance
    end_shift = (0.5 + CENTER_MARGIN) * lattice.cell_size + distance
    corners = clipped_boxes[:, [[0, 4], [3, 1]]]
    corners += [[first_shift, -first_shift], [end_shift, -end_shift]]
    rows, cols = lattice.rows_cols(corners)
    row_ranges = rows.clip(0, lattice.height)
    col_ranges = cols.clip(0, lattice.width)
    first_row = int(row_ranges[:, 0].min())
    end_row = int(row_ranges[:, 1].max())
    is_near = np.zeros((end_row - first_row, lattice.width), dtype=np.bool_)
    row_ranges -= first_row
    for (row, row_end), (col, col_end) in zip(
        row_ranges.tolist(), col_ranges.tolist(), strict=True
    ):
        is_near[row:row_end, col:col_end] = True
    cells: Int = np.flatnonzero(is_near) + first_row * lattice.width
    return cells


def bounding_window(is_marked: Bool) -> Window:
    """Return the smallest window that holds all marked cells of a mask.

    Args:
        is_marked: shape (height, width), bool; at least one cell is marked.
    """
    return window_of_cells(
        np.flatnonzero(is_marked.any(axis=1)), np.flatnonzero(is_marked.any(axis=0))
    )


def window_of_cells(rows: Int, cols: Int) -> Window:
    """Return the smallest window that holds some cells.

    Args:
        rows: the rows of the cells, in any order, at least one, shape (n,).
        cols: their columns, shape (m,).
    """
    return (
        slice(int(rows.min()), int(rows.max()) + 1),
        slice(int(cols.min()), int(cols.max()) + 1),
    )


def grow_window(window: Window, row_margin: int, col_margin: int, shape: tuple[int, ...]) -> Window:
    """Return a window with a margin around it, cropped to the lattice.

    Args:
        window: rows and columns of the lattice.
        row_margin: how many rows to add above and below, >= 0.
        col_margin: how many columns to add on the left and on the right, >= 0.
        shape: the shape of the lattice, (height, width).
    """
    row_slice, col_slice = window
    return (
        slice(max(row_slice.start - row_margin, 0), min(row_slice.stop + row_margin, shape[0])),
        slice(max(col_slice.start - col_margin, 0), min(col_slice.stop + col_margin, shape[1])),
    )


def crop_cells(cells: Int, window: Window, width: int) -> tuple[Int, Bool]:
    """Find the cells that lie in a window, and their ids on the window's own lattice.

    Args:
        cells: ids of cells on the lattice, shape (n,).
        window: rows and columns of the lattice.
        width: number of columns of the lattice.

    Returns:
        The ids that the m cells inside of the window have on the window's own lattice, shape (m,);
        and a mask of these cells among `cells`, shape (n,).
    """
    row_slice, col_slice = window
    row, col = np.divmod(cells, width)
    is_inside = (
        (row >= row_slice.start)
        & (row < row_slice.stop)
        & (col >= col_slice.start)
        & (col < col_slice.stop)
    )
    cropped_cells: Int = (
        (row - row_slice.start) * (col_slice.stop - col_slice.start) + col - col_slice.start
    )[is_inside]
    return cropped_cells, is_inside
