"""Straight lines over a level: what they touch, what they run through, what they cost.

Lines are in the level's own units: u in columns, v in rows, so that cell (row, col) is the square
from (col, row) to (col + 1, row + 1).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from navbake.runtime.kernels.moves import EAST, SOUTH

TOUCH = 1e-9  # of a cell: what is this near a line is touched


@njit(cache=True, error_model="numpy")
def _clip(u0, v0, u1, v1, low, high):
    """The part of a line with v from `low` to `high`: its smallest and largest u."""
    if v0 == v1:
        return min(u0, u1), max(u0, u1)
    a, b = (low - v0) / (v1 - v0), (high - v0) / (v1 - v0)
    a, b = min(max(min(a, b), 0.0), 1.0), max(min(max(a, b), 1.0), 0.0)
    ua, ub = u0 + a * (u1 - u0), u0 + b * (u1 - u0)
    return min(ua, ub), max(ua, ub)


@njit(cache=True, error_model="numpy")
def is_walkable(u0, v0, u1, v1, moves, roomy, first, width, height):
    """Whether all cells that a line touches are roomy, and all steps between them small enough.

    A line touches a cell where it meets the cell's closed square: over a corner, all four.

    Args:
        u0, v0, u1, v1: the line's ends.
        moves: by flat id, see `navbake.runtime.kernels.moves`.
        roomy: by flat id, bool: free cells in which an agent may be anywhere.
        first: flat id of the level's first cell.
        width, height: of the level.
    """
    top, bottom = math.floor(min(v0, v1) - TOUCH), math.floor(max(v0, v1) + TOUCH)
    if top < 0 or bottom >= height:
        return False
    above0, above1 = 0, -1  # columns touched in the row before
    for row in range(top, bottom + 1):
        low, high = _clip(u0, v0, u1, v1, row - TOUCH, row + 1 + TOUCH)
        col0, col1 = math.floor(low - TOUCH), math.floor(high + TOUCH)
        if col0 < 0 or col1 >= width:
            return False
        for col in range(col0, col1 + 1):
            cell = first + row * width + col
            if not roomy[cell]:
                return False
            if col < col1 and not moves[cell] & EAST:
                return False
            if above0 <= col <= above1 and not moves[cell - width] & SOUTH:
                return False
        above0, above1 = col0, col1
    return True


@njit(cache=True, error_model="numpy")
def crossed_cells(u0, v0, u1, v1, width, height):
    """The cells that a line runs through, in order, and where it enters each.

    Returns:
        Cells (row * width + col), int64, and the share of the line before each, float64, with 1
        at the end, so one longer. Cells that it only touches at a corner are left out.
    """
    du, dv = u1 - u0, v1 - v0
    size = abs(math.floor(u1) - math.floor(u0)) + abs(math.floor(v1) - math.floor(v0)) + 2
    cuts = np.empty(size, np.float64)
    num = 0
    cuts[num] = 0.0
    num += 1
    for a, b, d in ((u0, u1, du), (v0, v1, dv)):
        for line in range(math.floor(min(a, b)) + 1, math.ceil(max(a, b))):
            cuts[num] = (line - a) / d
            num += 1
    cuts[num] = 1.0
    num += 1
    cuts = np.sort(cuts[:num])
    cells, enter = np.empty(num, np.int64), np.empty(num + 1, np.float64)
    count = 0
    for i in range(num - 1):
        if cuts[i + 1] - cuts[i] <= 1e-12 and num != 2:
            continue
        middle = (cuts[i] + cuts[i + 1]) / 2.0
        row = min(max(math.floor(v0 + middle * dv), 0), height - 1)
        col = min(max(math.floor(u0 + middle * du), 0), width - 1)
        cells[count], enter[count] = row * width + col, cuts[i]
        count += 1
    enter[count] = 1.0
    return cells[:count], enter[: count + 1]


@njit(cache=True, error_model="numpy")
def line_cost(u0, v0, u1, v1, weight, first, width, height):
    """The length of a line in cells, each part times the weight of the cell that it is in."""
    cells, enter = crossed_cells(u0, v0, u1, v1, width, height)
    total = 0.0
    for i in range(cells.shape[0]):
        total += (enter[i + 1] - enter[i]) * weight[first + cells[i]]
    return total * math.hypot(u1 - u0, v1 - v0)
