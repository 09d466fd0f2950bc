"""Which cell of a walk a position is in; see `navbake.runtime.walk.Walk` for the arrays."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def cell_on(start, width, height, x_min, y_max, cell_size, level, x, y):
    """Flat id of the cell of a level that holds x, y; -1 beside the level."""
    col = math.floor((x - x_min[level]) / cell_size[level])
    row = math.floor((y_max[level] - y) / cell_size[level])
    if not (0 <= row < height[level] and 0 <= col < width[level]):
        return np.int64(-1)
    return start[level] + np.int64(row) * width[level] + np.int64(col)


@njit(cache=True)
def cell_under(start, width, height, x_min, y_max, cell_size, ground, floor, slack, x, y, z):
    """Flat id of the cell whose floor is the nearest at or below z + slack.

    Where no level has such a floor at x, y, the level counts whose ground is; -1 where there is
    none of these either.
    """
    found, highest = np.int64(-1), -np.inf
    grounded, highest_ground = np.int64(-1), -np.inf
    for level in range(len(width)):
        cell = cell_on(start, width, height, x_min, y_max, cell_size, level, x, y)
        if cell < 0:
            continue
        if highest < floor[cell] <= z + slack:
            found, highest = cell, floor[cell]
        elif math.isnan(floor[cell]) and highest_ground < ground[level] <= z + slack:
            grounded, highest_ground = cell, ground[level]
    return found if found >= 0 else grounded


@njit(cache=True)
def locate(start, width, height, x_min, y_max, cell_size, ground, floor, slack, positions):
    """Flat ids of the cells of positions, shape (n, 3) float64 [m]; `cell_under` of each.

    Returns:
        Shape (n,), int64, -1 where there is none, -2 where the position is not finite.
    """
    cells = np.empty(len(positions), dtype=np.int64)
    for i in range(len(positions)):
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        if math.isfinite(x) and math.isfinite(y) and math.isfinite(z):
            cells[i] = cell_under(
                start, width, height, x_min, y_max, cell_size, ground, floor, slack, x, y, z
            )
        else:
            cells[i] = -2
    return cells


@njit(cache=True)
def locate_on(start, width, height, x_min, y_max, cell_size, level, positions):
    """Flat ids of the cells of one level that hold positions, shape (n, >= 2) float64 [m].

    Returns:
        Shape (n,), int64, -1 beside the level, -2 where x or y is not finite.
    """
    cells = np.empty(len(positions), dtype=np.int64)
    for i in range(len(positions)):
        x, y = positions[i, 0], positions[i, 1]
        if math.isfinite(x) and math.isfinite(y):
            cells[i] = cell_on(start, width, height, x_min, y_max, cell_size, level, x, y)
        else:
            cells[i] = -2
    return cells
