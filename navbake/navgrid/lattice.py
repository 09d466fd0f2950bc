"""Converts between world positions and grid cells, and finds the cells that polygons cover.

World: right-handed, z up, metres. Files: y up, ``(X, Y, Z) = (x, z, -y)``. Arrays are
``[row, col]``: col along x, row along file Z, which is against y. Cell id = col + row * width.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.types import Bool, Float, Int

MAX_COORDINATE = 1e10  # greatest distance from the origin, MuJoCo's mjMAXVAL [m]
LEAST_EDGE = 1e-9  # smallest edge of a cell [m]
CELL_SLACK = 1e-6  # share of a cell; an extent that exceeds n cells by less counts as n cells
MAX_CORNERS = 10_000  # largest number of corners of one outline
MAX_PAIRS = 1 << 18  # pairs of sides that are compared at once, to limit memory


class Cell(NamedTuple):
    """One cell of a grid."""

    level: int  #: Number of its level, 0 is the lowest.
    row: int  #: Its row; row 0 has the largest y.
    col: int  #: Its column; column 0 has the smallest x.


class Cells(NamedTuple):
    """Cells of a grid, as three arrays of one shape, int64; -1 in all three for no cell."""

    level: Int  #: Number of each cell's level, 0 is the lowest.
    row: Int  #: Row of each cell.
    col: Int  #: Column of each cell.


def rounded(value: float, digits: int = 6) -> float:
    """Round a length; a result of -0.0 becomes 0.0.

    Args:
        value: The length [m].
        digits: Decimal digits; 6 for micrometres.
    """
    return round(float(value), digits) + 0.0


def count_cells(extent: float, cell_size: float, rounding: float = 0.0) -> int:
    """Count the cells that cover a length: ``ceil(extent / cell_size)``, at least 1.

    Args:
        extent: Length to cover [m].
        cell_size: Edge of a cell [m], > 0.
        rounding: By how much the extent may be too large because of rounding [m]. If the extent is
            longer than a whole number of cells by less than `rounding` plus 1e-6 of a cell, no cell
            is added for the rest.
    """
    return max(1, math.ceil((extent - rounding) / cell_size - CELL_SLACK))


class Lattice(NamedTuple):
    """A rectangle of square cells in the world's horizontal plane, without their contents."""

    x_min: float  #: World x of the outer edge of column 0 [m].
    y_max: float  #: World y of the outer edge of row 0 [m]; rows run towards smaller y.
    cell_size: float  #: Edge of a cell [m], > 0.
    width: int  #: Number of columns, >= 1.
    height: int  #: Number of rows, >= 1.

    @classmethod
    def cover(
        cls, bounds: Sequence[float], cell_size: float, margin: float = 0.0, rounding: float = 0.0
    ) -> Lattice:
        """Make the lattice of a scene: ``ceil(extent / cell_size)`` cells along each axis.

        The cells are centred on the extent.

        Args:
            bounds: x_min, y_min, x_max and y_max of the scene, world frame [m].
            cell_size: Edge of a cell [m], > 0.
            margin: Length that is added on each side [m].
            rounding: By how much the extent may be too large because of rounding [m].
        """
        x_low, y_low, x_high, y_high = bounds
        width = count_cells(x_high - x_low + 2 * margin, cell_size, rounding)
        height = count_cells(y_high - y_low + 2 * margin, cell_size, rounding)
        x_mid = (x_low + x_high) / 2
        y_mid = (y_low + y_high) / 2
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
        """Return row and column of the cell that each position is in; outside the lattice, too.

        Args:
            xy: Finite positions, world x, y and maybe z [m], shape (..., 2) or (..., 3).

        Returns:
            Rows and columns, each of shape (...), int64.
        """
        positions = np.asarray(xy, dtype=np.float64)
        rows = np.floor((self.y_max - positions[..., 1]) / self.cell_size).astype(np.int64)
        cols = np.floor((positions[..., 0] - self.x_min) / self.cell_size).astype(np.int64)
        return rows, cols

    def position(self, row: int, col: int) -> tuple[float, float]:
        """Return the centre of one cell, world x, y [m]: `positions`, but faster."""
        x = self.x_min + (col + 0.5) * self.cell_size
        y = self.y_max - (row + 0.5) * self.cell_size
        return x, y

    def positions(self, rows: ArrayLike, cols: ArrayLike) -> Float:
        """Return the centres of cells.

        Args:
            rows: Rows of the cells, of any shape.
            cols: Their columns, of a shape that broadcasts with that of the rows.

        Returns:
            World x, y [m], shape (..., 2), float64.
        """
        x = self.x_min + (np.asarray(cols) + 0.5) * self.cell_size
        y = self.y_max - (np.asarray(rows) + 0.5) * self.cell_size
        positions = np.empty((*np.broadcast(x, y).shape, 2))
        positions[..., 0] = x
        positions[..., 1] = y
        return positions

    @overload
    def holds(self, rows: int, cols: int) -> bool: ...

    @overload
    def holds(self, rows: Int, cols: Int) -> Bool: ...

    def holds(self, rows: int | Int, cols: int | Int) -> bool | Bool:
        """Return whether cells lie on the lattice.

        Args:
            rows: Rows of the cells, as an integer or an array.
            cols: Their columns, of the same shape.

        Returns:
            A bool, or an array of bools of that shape.
        """
        return (rows >= 0) & (cols >= 0) & (rows < self.height) & (cols < self.width)

    def window(self, bounds: Float, margin: float = 0.0) -> tuple[slice, slice] | None:
        """Find the window of cells that a box covers, with one more row and column on each side.

        Args:
            bounds: Lower and upper corner of the box, shape (2, 2) or (2, 3), world frame [m].
            margin: Length by which the box is enlarged on each side [m].

        Returns:
            The rows and the columns, cut to the lattice; None if the window misses the lattice.
        """
        x_low, y_low = bounds[0, :2] - margin
        x_high, y_high = bounds[1, :2] + margin
        corner_rows, corner_cols = self.rows_cols([[x_low, y_high], [x_high, y_low]])
        rows = slice(max(int(corner_rows[0]) - 1, 0), min(int(corner_rows[1]) + 2, self.height))
        cols = slice(max(int(corner_cols[0]) - 1, 0), min(int(corner_cols[1]) + 2, self.width))
        if rows.start >= rows.stop or cols.start >= cols.stop:
            return None
        return rows, cols

    def cut(self, rows: slice, cols: slice) -> Lattice:
        """Return the lattice of some of the rows and columns alone.

        Args:
            rows: The range of rows, with a start and an end.
            cols: The range of columns, with a start and an end.
        """
        return self._replace(
            x_min=self.x_min + cols.start * self.cell_size,
            y_max=self.y_max - rows.start * self.cell_size,
            width=cols.stop - cols.start,
            height=rows.stop - rows.start,
        )


# ---------------------------------------------------------------- polygons


def find_outline_fault(points: ArrayLike) -> str | None:
    """Describe what is wrong with an outline; None if it is valid.

    An outline is wrong if all corners lie in a line, if sides cross, or if it has more than 10,000
    corners or a coordinate beyond 1e10 m. Sides may touch, and corners may be repeated.

    Args:
        points: x, y of the corners [m], in order, shape (n, 2); the first is not repeated at the
            end.

    Returns:
        A phrase for an error message; None for a valid outline.
    """
    corners = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    if len(corners) > MAX_CORNERS:
        return f"{len(corners)} corners, more than {MAX_CORNERS}"
    if not np.abs(corners).max(initial=0.0) <= MAX_COORDINATE:
        return f"corners beyond {MAX_COORDINATE:g} m"
    if np.linalg.matrix_rank(corners - corners[0]) < 2:
        return "corners that all lie in a line"
    ends = np.roll(corners, -1, axis=0)
    num_at_once = max(1, MAX_PAIRS // len(corners))
    for first_line in range(0, len(corners), num_at_once):
        lines = slice(first_line, first_line + num_at_once)
        # each line with the sides from it on: those before have been compared with it
        later_corners = np.vstack([corners[first_line:], corners[:1]])
        turns = _turns(corners[lines, None], ends[lines, None], later_corners)
        # a side ends where the next one starts
        line_indices, side_indices = np.nonzero(turns[:, :-1] * turns[:, 1:] < 0)
        line_indices += first_line
        side_indices += first_line
        starts_of_sides = corners[side_indices]
        ends_of_sides = ends[side_indices]
        turns_back = _turns(starts_of_sides, ends_of_sides, corners[line_indices])
        turns_back *= _turns(starts_of_sides, ends_of_sides, ends[line_indices])
        is_crossing = turns_back < 0
        if is_crossing.any():
            # the first side that crosses another, and the first that it crosses
            first_crossing = np.argmax(is_crossing)
            crossing_pair = [line_indices[first_crossing], side_indices[first_crossing]]
            side_texts = [
                f"[{x0:g}, {y0:g}] to [{x1:g}, {y1:g}]"
                for (x0, y0), (x1, y1) in zip(
                    corners[crossing_pair], ends[crossing_pair], strict=True
                )
            ]
            return "sides that cross: " + " and ".join(side_texts)
    return None


def _turns(starts: Float, ends: Float, points: Float) -> NDArray[np.int8]:
    """Return on which side of lines points are: 1 to the left, -1 to the right, 0 on the line.

    Args:
        starts: x, y of a point of each line, shape (..., 2).
        ends: x, y of another point of each line, of the same shape.
        points: x, y of the points, a shape that broadcasts with that of the lines.
    """
    along_x, along_y = np.moveaxis(ends - starts, -1, 0)
    signed_areas = along_x * (points[..., 1] - starts[..., 1])
    signed_areas -= along_y * (points[..., 0] - starts[..., 0])
    turns: NDArray[np.int8] = (signed_areas > 0).view(np.int8)
    turns -= (signed_areas < 0).view(np.int8)
    return turns


def cover_cells(rings: Sequence[ArrayLike], lattice: Lattice) -> Bool:
    """Mark the cells whose centres lie in a polygon, by the even-odd rule.

    A centre on a lower or left side is inside; a centre on an upper or right side is outside. So a
    centre on the common side of two polygons is in exactly one of them.

    Args:
        rings: The polygon's outlines and the outlines of its holes, each of shape (n, 2), world
            x, y [m].
        lattice: The cells.

    Returns:
        The mask, shape (height, width), bool.
    """
    # Each side toggles all cells of its rows right of it: marks where the toggles are, then a
    # running sum along each row; odd sums are inside (scan conversion by edge flags, Ackland and
    # Weste 1981).
    num_toggles = np.zeros((lattice.height, lattice.width + 1), dtype=np.int32)
    x = lattice.center_x()
    y = lattice.center_y()
    for ring in rings:
        corners = np.asarray(ring, dtype=np.float64).reshape(-1, 2)
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            # always upwards, so that two polygons get the same crossings from a shared side
            lower_end, upper_end = (start, end) if start[1] <= end[1] else (end, start)
            # y descends: rows whose y is from that of the lower end to below that of the upper end
            first_row, end_row = len(y) - np.searchsorted(y[::-1], [upper_end[1], lower_end[1]])
            rows = slice(first_row, end_row)
            slope = 0.0
            if upper_end[1] > lower_end[1]:
                slope = (upper_end[0] - lower_end[0]) / (upper_end[1] - lower_end[1])
            cols = np.searchsorted(x, lower_end[0] + (y[rows] - lower_end[1]) * slope)
            np.add.at(num_toggles, (np.arange(rows.start, rows.stop), cols), 1)
    is_inside: Bool = np.cumsum(num_toggles[:, :-1], axis=1) % 2 == 1
    return is_inside


def touch_cells(rings: Sequence[ArrayLike], lattice: Lattice) -> Bool:
    """Mark the cells whose squares a polygon overlaps, even slightly.

    A polygon that gets less than a millionth of a cell into a square does not overlap it. Keep-out
    zones use this rule, so even a thin zone has no gaps.

    Args:
        rings: The polygon's outlines and the outlines of its holes, each of shape (n, 2), world
            x, y [m].
        lattice: The cells.

    Returns:
        The mask, shape (height, width), bool.
    """
    # in each row, +1 at the first column that a side runs through, -1 after the last
    coverage_changes = np.zeros((lattice.height, lattice.width + 1), dtype=np.int32)
    origin = np.array([lattice.x_min, lattice.y_max])
    for ring in rings:
        # column and row of each corner, with fractions
        corners = (np.asarray(ring, dtype=np.float64).reshape(-1, 2) - origin) / lattice.cell_size
        corners[:, 1] *= -1.0
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            upper_end, lower_end = (start, end) if start[1] <= end[1] else (end, start)
            upper_col, upper_row = upper_end
            lower_col, lower_row = lower_end
            first_row = math.floor(upper_row + CELL_SLACK)
            stop_row = math.ceil(lower_row - CELL_SLACK)
            rows = np.arange(max(first_row, 0), min(stop_row, lattice.height))
            # the part of the side in each row, by the columns of its ends
            row_borders = np.clip([rows + CELL_SLACK, rows + 1 - CELL_SLACK], upper_row, lower_row)
            slope = (
                (lower_col - upper_col) / (lower_row - upper_row) if lower_row > upper_row else 0.0
            )
            cols = upper_col + (row_borders - upper_row) * slope
            if lower_row - upper_row < CELL_SLACK:
                cols = np.array([[upper_col], [lower_col]])
            first_col = np.floor(cols.min(axis=0) + CELL_SLACK).clip(0, lattice.width)
            stop_col = np.ceil(cols.max(axis=0) - CELL_SLACK).clip(first_col, lattice.width)
            np.add.at(coverage_changes, (rows, first_col.astype(np.int64)), 1)
            np.add.at(coverage_changes, (rows, stop_col.astype(np.int64)), -1)
    is_on_side = np.cumsum(coverage_changes[:, :-1], axis=1) > 0
    is_touched: Bool = cover_cells(rings, lattice) | is_on_side
    return is_touched
