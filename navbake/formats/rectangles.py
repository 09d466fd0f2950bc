"""Cells as few rectangles, for boxes and quads in place of one for each cell."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.types import Int


class Rectangles(NamedTuple):
    """Rectangles of whole cells that don't overlap.

    Attributes:
        bounds: first row, first column, row and column after the last, shape (n, 4), int64.
        labels: the label that all cells of each have, shape (n,), of the labels' dtype.
    """

    bounds: Int
    labels: NDArray[Any]


def cover_by_rectangles(labels: NDArray[Any]) -> Rectangles:
    """Cover all cells whose label isn't 0 (or False) by rectangles, each of one label.

    Each such cell lies in exactly one rectangle, no other cell in any. Cells are visited row by
    row, and from each that isn't covered yet the rectangle with the most cells is taken. That is
    not the least number possible, but near it on floor plans, and the same cells give the same
    rectangles.

    Args:
        labels: shape (height, width), bool or integers.
    """
    from navbake.formats.kernels.rectangles import cover  # numba loads slowly

    bounds: Int = cover(np.ascontiguousarray(labels).astype(np.int64))
    return Rectangles(bounds, labels[bounds[:, 0], bounds[:, 1]])
