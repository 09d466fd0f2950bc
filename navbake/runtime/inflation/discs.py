"""Which cells a disc round a cell's centre reaches: exact, in squares of whole half cells."""

import math

import numpy as np

from navbake.types import Int, Int32

TOUCH = 1e-9  # share of a radius by which a disc may be over what it touches


def half_widths(radius: float, shape: tuple[int, int], *, of_squares: bool = True) -> Int32:
    """How wide a disc is, row by row, as `navbake.runtime.kernels.inflation.dilate` takes it.

    Args:
        radius: [cells].
        shape: (rows, cols) of the cells that it is for; it need not be wider.
        of_squares: whether it reaches a cell when it meets its square, or covers its centre.
    """
    reaches = [min(math.ceil(radius) + 1, size) for size in shape]
    rows, cols = (_squares(np.arange(reach + 1), of_squares) for reach in reaches)
    widths = np.searchsorted(cols, _square_limit(radius) - rows, side="left") - 1
    return np.append(widths[widths >= 0], -1).astype(np.int32)


def disc_offsets(
    radius: float, shape: tuple[int, int], *, of_squares: bool = True
) -> tuple[Int, Int]:
    """Steps from a cell to those that a disc round its centre reaches, as in `half_widths`.

    Returns:
        Rows and columns, (n, 2) int64, the nearest first; and their squares in half cells.
    """
    rows, cols = (np.arange(-n, n + 1) for n in (min(math.ceil(radius) + 1, s) for s in shape))
    squares = _squares(rows, of_squares)[:, None] + _squares(cols, of_squares)
    row, col = np.nonzero(squares < _square_limit(radius))
    found = squares[row, col]
    order = np.argsort(found, kind="stable")
    return np.stack([rows[row], cols[col]], axis=1)[order], found[order]


def _square_limit(radius: float) -> float:
    return (2 * radius) ** 2 * (1 - TOUCH)  # the disc is open: what only touches is not reached


def _squares(steps: Int, of_squares: bool) -> Int:
    """Squared half cells along an axis to the near side, or to the centre, of squares."""
    half_cells: Int = 2 * np.abs(steps)
    return np.maximum(half_cells - 1, 0) ** 2 if of_squares else half_cells**2
