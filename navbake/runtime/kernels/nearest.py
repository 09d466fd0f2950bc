"""The nearest cell of a mask to a point, ring by ring; and the first of some cells in sight.

Cells are looked at in squares round the point's cell, each a cell farther out, until no cell of
the next ring can be nearer than the best so far. That is quicker than any index where the mask is
dense near the point, as free and occupied cells are, and needs none that a block would outdate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from navbake.runtime.kernels.arrays import Layout, center
from navbake.runtime.kernels.crossing import is_in_sight
from navbake.types import Bool, Float

TO_CENTER, IN_SPACE, TO_OBSTACLE = 0, 1, 2  # what is measured
FAR_OFF = 64.0  # cells beside a level from which on rings don't pay


class Wanted(NamedTuple):
    """Cells that are looked for, and how their distance is measured.

    Attributes:
        layout: of the grid, a `navbake.runtime.kernels.arrays.Layout`.
        mask: by cell, bool: the cells that count.
        floor: by cell [m], float64, NaN where there is none.
        measure: TO_CENTER on the map; IN_SPACE to the centre, on the floor; TO_OBSTACLE to the
            square on the map, but not of cells over or under which another level goes on at the
            point's height.
        height: for TO_OBSTACLE, floors less than this apart are at one height; for IN_SPACE,
            where cells without floor are taken to be [m].
    """

    layout: Layout
    mask: Bool
    floor: Float
    measure: int
    height: float


@njit(cache=True)
def nearest_cell(wanted, level, point, farthest):
    """Find the cell of a level that is the nearest to a point.

    Args:
        wanted: a `Wanted`.
        level: which level.
        point: x, y, z [m], float64; for TO_OBSTACLE, z is the floor's there.
        farthest: the largest distance that counts [m].

    Returns:
        Its flat id, -1 for none, and the distance [m]; of equally near ones, the lowest id.
    """
    layout = wanted.layout
    rows, cols, size = layout.height[level], layout.width[level], layout.cell_size[level]
    v = np.floor((layout.y_max[level] - point[1]) / size)
    u = np.floor((point[0] - layout.x_min[level]) / size)
    best = (farthest * farthest, np.int64(-1))
    beside = max(0.0, -v, v - rows + 1, -u, u - cols + 1)
    if beside > FAR_OFF:
        for row in range(rows):
            best = _look(wanted, level, point, (row, 0, cols - 1, 1), best)
        return best[1], math.sqrt(best[0])
    row0, col0, ring = int(v), int(u), int(beside)
    last = max(row0, rows - 1 - row0, col0, cols - 1 - col0)
    # the point is up to half a cell nearer to a ring's centres than its own cell's centre is, and
    # a whole cell nearer to the squares
    inside = 1.0 if wanted.measure == TO_OBSTACLE else 0.5
    while ring <= last and (max(0.0, ring - inside) * size) ** 2 <= best[0]:
        for row in range(max(0, row0 - ring), min(rows - 1, row0 + ring) + 1):
            left, right, stride = col0 - ring, col0 + ring, 2 * ring
            if abs(row - row0) == ring:  # the top or the bottom row of the ring: all of it
                left, stride = max(0, left), 1
            elif left < 0:
                left = right
            best = _look(wanted, level, point, (row, left, min(cols - 1, right), stride), best)
        ring += 1
    return best[1], math.sqrt(best[0])


@njit(cache=True)
def _look(wanted, level, point, span, best):
    """The better of the best so far and some cells of a row: squared distance, flat id."""
    row, first, last, stride = span
    d2_best, found = best
    layout, mask, floor, measure, height = wanted
    size, x_min, y_max = layout.cell_size[level], layout.x_min[level], layout.y_max[level]
    begin = layout.start[level] + row * layout.width[level]
    for col in range(first, last + 1, stride):
        cell = begin + col
        if not mask[cell]:
            continue
        dx = abs(x_min + (col + 0.5) * size - point[0])
        dy = abs(y_max - (row + 0.5) * size - point[1])
        if measure == TO_OBSTACLE:
            dx, dy = max(0.0, dx - 0.5 * size), max(0.0, dy - 0.5 * size)
        d2 = dx * dx + dy * dy
        if measure == IN_SPACE:
            z = height if math.isnan(floor[cell]) else floor[cell]
            d2 += (z - point[2]) ** 2
        if d2 < d2_best or (d2 == d2_best and (found < 0 or cell < found)):
            if measure == TO_OBSTACLE and _is_elsewhere(wanted, level, cell, point[2]):
                continue
            d2_best, found = d2, cell
    return d2_best, found


@njit(cache=True)
def _is_elsewhere(wanted, level, cell, z):
    """Whether another level, and not this one, is clear and goes on at a height in a column."""
    layout, floor = wanted.layout, wanted.floor
    if abs(floor[cell] - z) < wanted.height:  # False for NaN
        return False
    x, y = center(layout, cell)
    for other in range(len(layout.width)):
        width, size = layout.width[other], layout.cell_size[other]
        row = np.floor((layout.y_max[other] - y) / size)
        col = np.floor((x - layout.x_min[other]) / size)
        if other != level and 0 <= row < layout.height[other] and 0 <= col < width:
            there = layout.start[other] + np.int64(row) * width + np.int64(col)
            if not wanted.mask[there] and abs(floor[there] - z) < wanted.height:
                return True
    return False


@njit(cache=True)
def first_in_sight(space, room, cell, x, y, candidates):
    """The first of some cells whose centre is in sight of a point, -1 for none.

    Args:
        space: where nothing stands, a `navbake.runtime.kernels.arrays.Space`.
        room: see `navbake.runtime.kernels.crossing.walk_line`.
        cell: flat id of the cell that holds x, y.
        x, y: the point [m].
        candidates: flat ids, int64.
    """
    for candidate in candidates:
        to_x, to_y = center(space.layout, candidate)
        if is_in_sight(space, room, cell, x, y, candidate, to_x, to_y):
            return candidate
    return np.int64(-1)
