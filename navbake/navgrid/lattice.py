"""Converts between world positions and grid cells, and finds the cells that polygons cover.

World: right-handed, z up, metres. Files: y up, ``(X, Y, Z) = (x, z, -y)``. Arrays are
``[row, col]``: col along x, row along file Z, which is against y. Cell id = col + row * width.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.types import Bool, Float, Int

FARTHEST = 1e10  # [m] from the origin, MuJoCo's mjMAXVAL
LEAST_EDGE = 1e-9  # of a cell [m]
CELL_SLACK = 1e-6  # of a cell: an extent this little over n cells still makes n cells
MAX_CORNERS = 10_000  # of one outline
PAIRS = 1 << 18  # of an outline's sides compared at once, to limit memory


class Cell(NamedTuple):
    """One cell of a grid: its level (0 is the lowest), row and column."""

    level: int
    row: int
    col: int


class Cells(NamedTuple):
    """Cells of a grid: level, row and column of each, int64, of one shape; -1 for none."""

    level: Int
    row: Int
    col: Int


def rounded(value: float, digits: int = 6) -> float:
    """Round a length [m], by default to a micrometre, without -0.0."""
    return round(float(value), digits) + 0.0


def num_cells(extent: float, cell_size: float, rounding: float = 0.0) -> int:
    """Count the cells that cover an extent: ``ceil(extent / cell_size)``, at least 1.

    An excess below 1e-6 of a cell and `rounding` [m] adds no cell.
    """
    return max(1, math.ceil((extent - rounding) / cell_size - CELL_SLACK))


class Lattice(NamedTuple):
    """A rectangle of square cells in the world's horizontal plane."""

    x_min: float  #: World x of the outer edge of column 0 [m].
    y_max: float  #: World y of the outer edge of row 0 [m]; rows run towards smaller y.
    cell_size: float  #: Edge of a cell [m], > 0.
    width: int  #: Number of columns, >= 1.
    height: int  #: Number of rows, >= 1.

    @classmethod
    def cover(
        cls, bounds: Sequence[float], cell_size: float, margin: float = 0.0, rounding: float = 0.0
    ) -> Lattice:
        """Make the lattice of a scene: ``ceil(extent / cell_size)`` cells an axis, centred.

        `bounds` are (x_min, y_min, x_max, y_max), world frame [m], extended by `margin` [m] on each
        side, and too large by at most `rounding` [m].
        """
        x0, y0, x1, y1 = bounds
        width = num_cells(x1 - x0 + 2 * margin, cell_size, rounding)
        height = num_cells(y1 - y0 + 2 * margin, cell_size, rounding)
        # centre the whole cells on the extent
        x_mid = (x0 + x1) / 2
        y_mid = (y0 + y1) / 2
        x_min = x_mid - width * cell_size / 2
        y_max = y_mid + height * cell_size / 2
        return cls(x_min, y_max, cell_size, width, height)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width), the shape of every array on this lattice."""
        return self.height, self.width

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) of the outer edges, world frame [m]."""
        return (
            self.x_min,
            self.y_max - self.height * self.cell_size,
            self.x_min + self.width * self.cell_size,
            self.y_max,
        )

    def center_x(self) -> Float:
        """World x of the centre of each column [m], shape (width,), float64."""
        return self.x_min + (np.arange(self.width, dtype=np.float64) + 0.5) * self.cell_size

    def center_y(self) -> Float:
        """World y of the centre of each row [m], shape (height,), float64, descending."""
        return self.y_max - (np.arange(self.height, dtype=np.float64) + 0.5) * self.cell_size

    def rows_cols(self, xy: ArrayLike) -> tuple[Int, Int]:
        """Row and column of finite positions, shape (..., 2) or (..., 3), world frame [m].

        Each has shape (...), int64; outside the lattice, indices are extrapolated.
        """
        p = np.asarray(xy, dtype=np.float64)
        rows = np.floor((self.y_max - p[..., 1]) / self.cell_size).astype(np.int64)
        cols = np.floor((p[..., 0] - self.x_min) / self.cell_size).astype(np.int64)
        return rows, cols

    def positions(self, rows: ArrayLike, cols: ArrayLike) -> Float:
        """World x, y of cells' centres [m], shape (..., 2), float64."""
        x = self.x_min + (np.asarray(cols) + 0.5) * self.cell_size
        y = self.y_max - (np.asarray(rows) + 0.5) * self.cell_size
        return np.stack(np.broadcast_arrays(x, y), axis=-1)

    def holds(self, rows: Any, cols: Any) -> Any:
        """Whether cells lie on the lattice, by their rows and columns; bool, of their shape."""
        return (rows >= 0) & (cols >= 0) & (rows < self.height) & (cols < self.width)

    def window(self, bounds: Float, reach: float = 0.0) -> tuple[slice, slice] | None:
        """Find the rows and columns of the cells near a box, one more on each side.

        `bounds` are its corners, shape (2, 2) or (2, 3), world frame [m], each moved out by
        `reach` [m]. None for a box outside the lattice.
        """
        x0, y0 = bounds[0, :2] - reach
        x1, y1 = bounds[1, :2] + reach
        row, col = self.rows_cols([[x0, y1], [x1, y0]])
        rows = slice(max(int(row[0]) - 1, 0), min(int(row[1]) + 2, self.height))
        cols = slice(max(int(col[0]) - 1, 0), min(int(col[1]) + 2, self.width))
        return (rows, cols) if rows.start < rows.stop and cols.start < cols.stop else None

    def cut(self, rows: slice, cols: slice) -> Lattice:
        """The part of this lattice in ``[rows, cols]``."""
        return self._replace(
            x_min=self.x_min + cols.start * self.cell_size,
            y_max=self.y_max - rows.start * self.cell_size,
            width=cols.stop - cols.start,
            height=rows.stop - rows.start,
        )


# ---------------------------------------------------------------- polygons


def find_outline_fault(points: ArrayLike) -> str | None:
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
    x = lattice.center_x()
    y = lattice.center_y()
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
            first = math.floor(r0 + CELL_SLACK)
            end = math.ceil(r1 - CELL_SLACK)
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
