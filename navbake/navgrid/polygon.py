"""Polygons in the horizontal plane: what is wrong with one, and which cells it covers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float


def find_fault(points: ArrayLike) -> str | None:
    """Find what is wrong with an outline: no area, or two sides that cross each other.

    Sides may touch; a repeated corner is no fault.

    Args:
        points: the corners in order, shape (n, 2), the first not repeated at the end.

    Returns:
        The fault in words, or None.
    """
    corners = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    spread = corners - corners[0]
    if np.linalg.matrix_rank(spread) < 2:
        return "corners that all lie in a line"
    ends = np.roll(corners, -1, axis=0)
    for side in range(len(corners) - 2):
        crossed = _crosses(corners[side], ends[side], corners[side + 2 :], ends[side + 2 :])
        if crossed.any():
            other = side + 2 + int(np.argmax(crossed))
            named = (_name_side(corners[k], ends[k]) for k in (side, other))
            return "sides that cross: {} and {}".format(*named)
    return None


def cover_cells(rings: Sequence[ArrayLike], lattice: Lattice) -> Bool:
    """Mark the cells whose centres lie in a polygon, by the even-odd rule.

    A centre on a lower or left side is inside, one on an upper or right side isn't; so of two
    polygons with a side in common, each centre on it is in one.

    Args:
        rings: outlines, holes and further parts, each of shape (n, 2), world x, y [m].
        lattice: the cells.

    Returns:
        Shape (height, width), bool.
    """
    # Each side toggles all cells of its rows right of it: marks where the toggles are, then a
    # running sum along each row; odd sums are inside (scan conversion by edge flags, Ackland and
    # Weste 1981).
    turns = np.zeros((lattice.height, lattice.width + 1), dtype=np.int32)
    x, y = lattice.center_x(), lattice.center_y()
    for ring in rings:
        corners = np.asarray(ring, dtype=np.float64).reshape(-1, 2)
        for one, other in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            # always upwards, so that two polygons get the same crossings from a shared side
            low, high = (one, other) if one[1] <= other[1] else (other, one)
            # y descends: rows with low <= y < high
            rows = slice(*(len(y) - np.searchsorted(y[::-1], [high[1], low[1]])))
            slope = (high[0] - low[0]) / (high[1] - low[1]) if high[1] > low[1] else 0.0
            cols = np.searchsorted(x, low[0] + (y[rows] - low[1]) * slope)
            np.add.at(turns, (np.arange(rows.start, rows.stop), cols), 1)
    inside: Bool = np.cumsum(turns[:, :-1], axis=1) % 2 == 1
    return inside


def _crosses(start: Float, end: Float, starts: Float, ends: Float) -> Bool:
    """Which segments a segment crosses: each has the other's end points on different sides."""

    def side(a: Float, b: Float, p: Float) -> Float:
        turned: Float = (b[..., 0] - a[..., 0]) * (p[..., 1] - a[..., 1]) - (
            b[..., 1] - a[..., 1]
        ) * (p[..., 0] - a[..., 0])
        return np.sign(turned)

    apart = side(start, end, starts) * side(start, end, ends) < 0
    crossed: Bool = apart & (side(starts, ends, start) * side(starts, ends, end) < 0)
    return crossed


def _name_side(start: Float, end: Float) -> str:
    return f"[{start[0]:g}, {start[1]:g}] to [{end[0]:g}, {end[1]:g}]"
