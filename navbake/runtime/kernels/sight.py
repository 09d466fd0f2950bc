"""Straight lines over a level: what they touch, what they run through, what they cost.

The ends of lines are pairs u, v in the level's own units, columns and rows: cell (row, col) is the
square from (col, row) to (col + 1, row + 1). `is_walkable` is a supercover line, row by row: all
cells that meet the line count, where Bresenham's line and the traversal of Amanatides and Woo
leave out those that it only touches.
"""

import math

import numpy as np

from navbake.compiled import part
from navbake.runtime.kernels.moves import EAST, SOUTH

TOUCH = 1e-9  # of a cell: what is this near a line is touched


@part
def _cut_to_band(a, b, low, high):
    """The part of a line with v from `low` to `high`: its smallest and largest u."""
    (u0, v0), (u1, v1) = a, b
    if v0 == v1:
        return min(u0, u1), max(u0, u1)
    enter, leave = (low - v0) / (v1 - v0), (high - v0) / (v1 - v0)
    enter, leave = min(max(min(enter, leave), 0.0), 1.0), max(min(max(enter, leave), 1.0), 0.0)
    ua, ub = u0 + enter * (u1 - u0), u0 + leave * (u1 - u0)
    return min(ua, ub), max(ua, ub)


@part
def is_walkable(a, b, rect, moves, anywhere):
    """Whether an agent may be anywhere in all cells that a line touches, and step between them.

    A line touches a cell where it meets the cell's closed square: over a corner, all four.
    `anywhere` marks the free cells in which an agent may also be off the centre.
    """
    (_, v0), (_, v1) = a, b
    top, bottom = math.floor(min(v0, v1) - TOUCH), math.floor(max(v0, v1) + TOUCH)
    if top < 0 or bottom >= rect.height:
        return False
    above0, above1 = 0, -1  # columns touched in the row before
    for row in range(top, bottom + 1):
        low, high = _cut_to_band(a, b, row - TOUCH, row + 1 + TOUCH)
        col0, col1 = math.floor(low - TOUCH), math.floor(high + TOUCH)
        if col0 < 0 or col1 >= rect.width:
            return False
        for col in range(col0, col1 + 1):
            cell = rect.first + row * rect.width + col
            if not anywhere[cell]:
                return False
            # each edge between two touched cells is one that the line may run along or cross
            if col < col1 and not moves[cell] & EAST:
                return False
            if above0 <= col <= above1 and not moves[cell - rect.width] & SOUTH:
                return False
        above0, above1 = col0, col1
    return True


@part
def crossed_cells(a, b, rect):
    """The cells that a line runs through, in order, and the share of it before each, 1 at the end.

    So there is one share more. Cells that the line only touches at a corner are left out.
    """
    (u0, v0), (u1, v1) = a, b
    du, dv = u1 - u0, v1 - v0
    size = abs(math.floor(u1) - math.floor(u0)) + abs(math.floor(v1) - math.floor(v0)) + 2
    cuts = np.empty(size, np.float64)  # where the line crosses an edge of the lattice
    cuts[0], num = 0.0, 1
    for start, end, d in ((u0, u1, du), (v0, v1, dv)):
        for line in range(math.floor(min(start, end)) + 1, math.ceil(max(start, end))):
            cuts[num] = (line - start) / d
            num += 1
    cuts[num] = 1.0
    cuts = np.sort(cuts[: num + 1])
    cells, enter = np.empty(num, np.int64), np.empty(num + 1, np.float64)
    count = 0
    for i in range(num):
        if cuts[i + 1] - cuts[i] <= 1e-12 and num > 1:  # two edges at once: a corner
            continue
        middle = (cuts[i] + cuts[i + 1]) / 2.0  # inside of the cell, so rounding does no harm
        row = min(max(math.floor(v0 + middle * dv), 0), rect.height - 1)
        col = min(max(math.floor(u0 + middle * du), 0), rect.width - 1)
        cells[count], enter[count] = rect.first + row * rect.width + col, cuts[i]
        count += 1
    enter[count] = 1.0
    return cells[:count], enter[: count + 1]


@part
def line_cost(a, b, rect, weight):
    """The length of a line in cells, each part times the weight of the cell that it is in."""
    cells, enter = crossed_cells(a, b, rect)
    total = 0.0
    for i in range(cells.shape[0]):
        total += (enter[i + 1] - enter[i]) * weight[cells[i]]
    return total * math.hypot(b[0] - a[0], b[1] - a[1])
