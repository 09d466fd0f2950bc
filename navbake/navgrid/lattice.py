"""Converts between world positions and grid cells.

World: right-handed, z up, metres. Files: y up, ``(X, Y, Z) = (x, z, -y)``. Arrays are
``[row, col]``: col along x, row along file Z, which is against y. Cell id = col + row * width.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.types import Float, Int

FARTHEST = 1e10  # [m] from the origin, MuJoCo's mjMAXVAL
LEAST_EDGE = 1e-9  # of a cell [m]
CELL_SLACK = 1e-6  # of a cell: an extent this little over n cells still makes n cells


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
        x_mid, y_mid = (x0 + x1) / 2, (y0 + y1) / 2
        x_min, y_max = x_mid - width * cell_size / 2, y_mid + height * cell_size / 2
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

    def window(self, bounds: Float, reach: float = 0.0) -> tuple[slice, slice] | None:
        """Find the rows and columns of the cells near a box, one more on each side.

        `bounds` are its corners, shape (2, 2) or (2, 3), world frame [m], each moved out by
        `reach` [m]. None for a box outside the lattice.
        """
        (x0, y0), (x1, y1) = bounds[0, :2] - reach, bounds[1, :2] + reach
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
