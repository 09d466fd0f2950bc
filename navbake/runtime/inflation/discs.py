"""Discs on cells: how far the square of a cell is from the centre of another, and what that is.

Lengths are compared as whole numbers: squares of distances in half cells.
"""

from __future__ import annotations

import math

import numpy as np

from navbake.types import Int, Int32

TOUCH = 1e-9  # share of a radius by which a disc may be over what it touches


def square_limit(radius: float) -> float:
    """Up to which squared distance in half cells an open disc of a radius in cells reaches."""
    return (2 * radius) ** 2 * (1 - TOUCH)


def to_square(steps: Int) -> Int:
    """Half cells along an axis from a centre to the nearest side of a square so many cells on."""
    half_cells: Int = np.maximum(2 * np.abs(steps) - 1, 0)
    return half_cells


def to_centre(steps: Int) -> Int:
    """Half cells along an axis from a centre to the centre so many cells on."""
    return 2 * np.abs(steps)


def half_widths(radius: float, shape: tuple[int, int], *, of_squares: bool = True) -> Int32:
    """How wide a disc is, row by row, as `navbake.runtime.kernels.inflation.dilate` takes it.

    Args:
        radius: [cells].
        shape: (rows, cols) of the cells that it is for; it need not be wider.
        of_squares: whether it reaches a cell when it meets its square, or covers its centre.

    Returns:
        Number of columns to each side, (n,) int32, by the distance in rows; -1 for none.
    """
    measure = to_square if of_squares else to_centre
    limit = square_limit(radius)
    rows = measure(np.arange(min(math.ceil(radius) + 1, shape[0]) + 1)) ** 2
    cols = measure(np.arange(min(math.ceil(radius) + 1, shape[1]) + 1)) ** 2
    widths = np.searchsorted(cols, limit - rows, side="left") - 1
    return np.append(widths[widths >= 0], -1).astype(np.int32)


def disc_offsets(
    radius: float, shape: tuple[int, int], *, of_squares: bool = True
) -> tuple[Int, Int]:
    """Steps from a cell to those that a disc round its centre reaches, the nearest first.

    Args:
        radius, shape, of_squares: as of `half_widths`.

    Returns:
        Rows and columns, (n, 2) int64; and their squared distances in half cells, (n,) int64.
    """
    measure = to_square if of_squares else to_centre
    rows, cols = (np.arange(-n, n + 1) for n in (min(math.ceil(radius) + 1, s) for s in shape))
    squares = measure(rows)[:, None] ** 2 + measure(cols)[None] ** 2
    row, col = np.nonzero(squares < square_limit(radius))
    found = squares[row, col]
    order = np.argsort(found, kind="stable")
    return np.stack([rows[row], cols[col]], axis=1)[order], found[order]
