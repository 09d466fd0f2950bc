"""Polygons in the horizontal plane: their validity, and the cells they cover."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from navbake.navgrid.lattice import CELL_SLACK, FARTHEST, Lattice
from navbake.types import Bool, Float

MAX_CORNERS = 10_000  # of one outline
PAIRS = 1 << 18  # of sides compared at once, to limit memory


def find_fault(points: ArrayLike) -> str | None:
    """Describe the fault of an outline; None if it is valid.

    Faults are no area, crossing sides, more than 10,000 corners, and corners beyond 1e10 m.
    Corners are in order, shape (n, 2), the first not repeated at the end. Sides may touch, and
    corners may be repeated.
    """
    corners = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    if len(corners) > MAX_CORNERS:
        return f"{len(corners)} corners, more than {MAX_CORNERS}"
    if not np.abs(corners).max(initial=0.0) <= FARTHEST:
        return f"corners beyond {FARTHEST:g} m"
    if np.linalg.matrix_rank(corners - corners[0]) < 2:
        return "corners that all lie in a line"
    sides = np.hstack([corners, np.roll(corners, -1, axis=0)])

    def are_split(by: Float, sides: Float) -> Bool:
        """Whether lines through sides (n, 4) separate the ends of sides (m, 4); shape (n, m)."""
        x0, y0, x1, y1 = np.moveaxis(by, -1, 0)
        a, b, c, d = np.moveaxis(sides, -1, 0)
        turns = ((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) for x, y in ((a, b), (c, d)))
        one, other = map(np.sign, turns)
        return np.asarray(one * other < 0)

    rows = max(1, PAIRS // len(sides))
    for first in range(0, len(sides), rows):
        ones = sides[first : first + rows, None]
        crossing = np.argwhere(are_split(ones, sides[None]) & are_split(sides[None], ones))
        if len(crossing):  # by the first side, which comes before the other
            pair = first + crossing[0, 0], crossing[0, 1]
            named = [f"[{a:g}, {b:g}] to [{c:g}, {d:g}]" for a, b, c, d in sides[[*pair]]]
            return "sides that cross: " + " and ".join(named)
    return None


def cover_cells(rings: Sequence[ArrayLike], lattice: Lattice) -> Bool:
    """Mark the cells whose centres lie in a polygon, by the even-odd rule.

    A centre on a lower or left side is inside, one on an upper or right side outside; so of two
    polygons with a common side, each centre on it is in one. `rings` are outlines, holes and
    further parts, each of shape (n, 2), world x, y [m].
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


def touch_cells(rings: Sequence[ArrayLike], lattice: Lattice) -> Bool:
    """Mark the cells whose open squares a polygon meets; rings as of `cover_cells`.

    What reaches less than a millionth of a cell into a square only touches it. So a keep-out zone
    has no gaps, however thin it is.
    """
    met = np.zeros((lattice.height, lattice.width + 1), dtype=np.int32)
    corner = np.array([lattice.x_min, lattice.y_max])
    for ring in rings:
        # column and row, as fractions, of each corner
        at = (np.asarray(ring, dtype=np.float64).reshape(-1, 2) - corner) / lattice.cell_size
        at[:, 1] *= -1.0
        for one, other in zip(at, np.roll(at, -1, axis=0), strict=True):
            (c0, r0), (c1, r1) = (one, other) if one[1] <= other[1] else (other, one)
            first, end = math.floor(r0 + CELL_SLACK), math.ceil(r1 - CELL_SLACK)
            rows = np.arange(max(first, 0), min(end, lattice.height))
            # the part of the side in each row, by its ends' columns
            ends = np.clip([rows + CELL_SLACK, rows + 1 - CELL_SLACK], r0, r1)
            cols = c0 + (ends - r0) * ((c1 - c0) / (r1 - r0) if r1 > r0 else 0.0)
            cols = np.array([[c0], [c1]]) if r1 - r0 < CELL_SLACK else cols
            left = np.floor(cols.min(axis=0) + CELL_SLACK).clip(0, lattice.width)
            right = np.ceil(cols.max(axis=0) - CELL_SLACK).clip(left, lattice.width)
            np.add.at(met, (rows, left.astype(np.int64)), 1)
            np.add.at(met, (rows, right.astype(np.int64)), -1)
    touched: Bool = cover_cells(rings, lattice) | (np.cumsum(met[:, :-1], axis=1) > 0)
    return touched
