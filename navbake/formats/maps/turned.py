"""Maps whose image doesn't lie along the world's axes, laid on cells that do."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.navgrid.lattice import Lattice

MAX_CELLS = 80_000_000
TOUCH = 1e-9  # of a cell: squares that overlap by less don't
PIECE = 1 << 18  # cells that are looked at together, for the memory that it takes

Corner = tuple[float, float]
Cells = NDArray[np.int8]


def turn(values: Cells, corner: Corner, resolution: float, quarters: int) -> tuple[Cells, Corner]:
    """Turn a map by quarters, counter-clockwise, about its lower left corner.

    Args:
        values: shape (height, width), row 0 at the top.
        corner: world x, y of the lower left corner of its own lower left cell [m].
        resolution: edge of a cell [m].

    Returns:
        The values in the world's directions, and the corner that is now the lower left one.
    """
    height, width = (count * resolution for count in values.shape)
    left, below = ((0, 0), (height, 0), (width, height), (0, width))[quarters % 4]
    turned = np.ascontiguousarray(np.rot90(values, quarters % 4))
    return turned, (corner[0] - left, corner[1] - below)


def resample(
    values: Cells, corner: Corner, resolution: float, yaw: float, *, occupied: int
) -> tuple[Cells, Corner]:
    """Lay a map that is turned by any angle on cells of the same size along the world's axes.

    A cell takes the value at its centre, -1 (unknown) beside the map. But it is occupied wherever
    an occupied cell of the map reaches into its square.

    Args:
        values, corner, resolution: as of `turn`.
        yaw: counter-clockwise [rad].
        occupied: the value of occupied cells.

    Returns:
        The values, and the lower left corner, which is that of the box around the turned map or up
        to half a cell further out.

    Raises:
        FormatError: it would be too many cells.
    """
    height, width = values.shape
    cos, sin = math.cos(yaw), math.sin(yaw)
    # corners of the map in cells, from its own corner, in the world's directions
    xs, ys = (0, width * cos, width * cos - height * sin, -height * sin), (
        0, width * sin, width * sin + height * cos, height * cos,
    )  # fmt: skip
    lattice = Lattice.cover((min(xs), min(ys), max(xs), max(ys)), 1.0)
    if lattice.width * lattice.height > MAX_CELLS:
        raise FormatError(f"the turned map has {lattice.width} × {lattice.height} cells, too many")
    turned: Cells = np.full(lattice.shape, -1, dtype=np.int8)
    x, y = lattice.center_x(), lattice.center_y()[:, None]
    num_rows = max(1, PIECE // lattice.width)  # of one piece
    for start in range(0, lattice.height, num_rows):
        piece = slice(start, start + num_rows)
        col, up = np.floor(cos * x + sin * y[piece]), np.floor(-sin * x + cos * y[piece])
        inside = (col >= 0) & (col < width) & (up >= 0) & (up < height)
        cols, rows = col[inside].astype(np.int64), height - 1 - up[inside].astype(np.int64)
        turned[piece][inside] = values[rows, cols]
    full_rows, full_cols = np.nonzero(values == occupied)
    for start in range(0, len(full_rows), PIECE):
        part = slice(start, start + PIECE)
        right, up = full_cols[part] + 0.5, height - full_rows[part] - 0.5
        _mark_met(turned, lattice, cos * right - sin * up, sin * right + cos * up, yaw, occupied)
    x_min, y_min, _, _ = lattice.bounds
    return turned, (corner[0] + x_min * resolution, corner[1] + y_min * resolution)


def _mark_met(
    turned: Cells,
    lattice: Lattice,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    yaw: float,
    occupied: int,
) -> None:
    """Mark the cells whose squares the turned unit squares round some centres meet.

    Separating axes of two squares: along each side's direction of both, the centres must be
    nearer than half of the extents together.
    """
    cos, sin = abs(math.cos(yaw)), abs(math.sin(yaw))
    reach = (1.0 + cos + sin) / 2 - TOUCH  # half extents along any of the four directions
    row, col = lattice.rows_cols(np.stack([x, y], axis=-1))
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            rows, cols = row + down, col + right
            dx = lattice.x_min + cols + 0.5 - x
            dy = lattice.y_max - rows - 0.5 - y
            along, across = (
                math.cos(yaw) * dx + math.sin(yaw) * dy,
                (math.cos(yaw) * dy - math.sin(yaw) * dx),
            )
            far = np.max(np.abs([dx, dy, along, across]), axis=0)
            meets = (far < reach) & (rows >= 0) & (rows < lattice.height)
            meets &= (cols >= 0) & (cols < lattice.width)
            turned[rows[meets], cols[meets]] = occupied
