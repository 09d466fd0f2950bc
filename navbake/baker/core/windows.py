"""Windows of a lattice, cells in them, and cells beside each other or near boxes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int

Window = tuple[slice, slice]
"""Rows and columns of the whole lattice, with a start and a stop each."""


NEIGHBOR_SLICES: tuple[tuple[Any, Any], ...] = (
    (np.s_[:, :-1], np.s_[:, 1:]),
    (np.s_[:-1], np.s_[1:]),
)


def differing_pairs(values: NDArray[Any]) -> Int:
    """The ids of cells beside each other whose values differ, (height, width); shape (2, n)."""
    width = values.shape[1]
    flat = values.ravel()
    right = np.flatnonzero(flat[:-1] != flat[1:])
    right = right[(right + 1) % width > 0]
    down = np.flatnonzero(flat[:-width] != flat[width:])
    pairs = [right, right + 1], [down, down + width]
    return np.concatenate(pairs, axis=1)


def clip_boxes(lattice: Lattice, boxes: Float, margin: float) -> Float:
    """Boxes, (n, 6) [m], that reach beyond the lattice by at most `margin` [m], at any height."""
    x_min, y_min, x_max, y_max = lattice.bounds
    low = np.array([x_min - margin, y_min - margin, -np.inf])
    high = np.array([x_max + margin, y_max + margin, np.inf])
    clipped: Float = boxes.clip(np.tile(low, 2), np.tile(high, 2))
    return clipped


def cells_near_boxes(lattice: Lattice, boxes: Float, reach: float) -> Int:
    """The cells within `reach` [m] and one cell of boxes, (n, 6) [m]; ascending."""
    # boxes may be endless
    near_boxes = clip_boxes(lattice, boxes, reach + 4 * lattice.cell_size)
    west, south = (near_boxes[:, :2] - reach).T
    east, north = (near_boxes[:, 3:5] + reach).T
    first_row, first_col = lattice.rows_cols(np.stack([west, north], axis=1))
    last_row, last_col = lattice.rows_cols(np.stack([east, south], axis=1))
    mask = np.zeros(lattice.shape, dtype=np.bool_)
    rows = np.stack([first_row - 1, last_row + 2]).clip(0, lattice.height).T.tolist()
    cols = np.stack([first_col - 1, last_col + 2]).clip(0, lattice.width).T.tolist()
    for (row, past_row), (col, past_col) in zip(rows, cols, strict=True):
        mask[row:past_row, col:past_col] = True
    first = min((row for row, _ in rows), default=0)
    last = max((past_row for _, past_row in rows), default=0)
    near: Int = np.flatnonzero(mask[first:last]) + first * lattice.width
    return near


def bounding_window(mask: Bool) -> Window:
    """The smallest window that holds all marked cells, one at least."""
    rows = np.flatnonzero(mask.any(axis=1))
    cols = np.flatnonzero(mask.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


def crop_cells(cells: Int, window: Window, width: int) -> tuple[Int, Bool]:
    """Turn cells of a lattice of a width into cells of a window; also which of them are in it."""
    rows, cols = window
    row, col = np.divmod(cells, width)
    inside = (row >= rows.start) & (row < rows.stop) & (col >= cols.start) & (col < cols.stop)
    cut: Int = ((row - rows.start) * (cols.stop - cols.start) + col - cols.start)[inside]
    return cut, inside
