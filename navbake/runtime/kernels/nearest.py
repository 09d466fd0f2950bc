"""The nearest cell of a mask to a point, ring by ring; and the first of some cells in sight.

Cells are tested in squares round the point's cell, each a cell farther out, until no cell of the
next ring can be nearer than the best so far. Where the mask is dense near the point, as free and
occupied cells are, that is quicker than any index, and a block outdates nothing.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.compiled import kernel, part
from navbake.runtime.kernels.arrays import Layout, center, in_cells
from navbake.runtime.kernels.crossing import is_in_sight
from navbake.types import Bool, Float

TO_CENTER, IN_SPACE, TO_OBSTACLE = 0, 1, 2  # what is measured
FAR_OFF = 64.0  # cells: farther from a level than this, all its rows are scanned, not rings


class Wanted(NamedTuple):
    """Cells that are looked for, and how their distance is measured.

    Attributes:
        mask: by cell: the cells that count.
        floor: by cell [m], NaN where there is none.
        measure: TO_CENTER on the map; IN_SPACE to the centre, on the floor; TO_OBSTACLE to the
            square on the map, except of cells over or under which another level continues at the
            point's height.
        height: for TO_OBSTACLE, floors less than this apart are at one height; for IN_SPACE,
            where cells without floor are taken to be [m].
    """

    layout: Layout
    mask: Bool
    floor: Float
    measure: int
    height: float


@kernel
def nearest_cell(wanted, level, point, farthest):
    """The cell of a level nearest to x, y, z within `farthest`, -1 for none, and its distance [m].

    Of equally near ones, the lowest id. For TO_OBSTACLE, z is the floor's at the point.
    """
    layout = wanted.layout
    rows, cols, size = layout.height[level], layout.width[level], layout.cell_size[level]
    u, v = in_cells(layout, level, point[0], point[1])
    u, v = np.floor(u), np.floor(v)
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
        first, step = max(0, row0 - ring), 1
        if col0 - ring < 0 and col0 + ring >= cols:  # only its top and bottom rows are left
            first, step = row0 - ring if row0 >= ring else row0 + ring, max(1, 2 * ring)
        for row in range(first, min(rows - 1, row0 + ring) + 1, step):
            left, right, stride = col0 - ring, col0 + ring, 2 * ring
            if abs(row - row0) == ring:  # the top or the bottom row of the ring: all of it
                left, stride = max(0, left), 1
            elif left < 0:
                left = right
            best = _look(wanted, level, point, (row, left, min(cols - 1, right), stride), best)
        ring += 1
    return best[1], math.sqrt(best[0])


@part
def _look(wanted, level, point, span, best):
    """The better of the best so far and every `stride`-th cell of a row: squared distance, id."""
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


@part
def _is_elsewhere(wanted, level, cell, z):
    """Whether another level, but not this one, has a clear floor near a height in the column."""
    layout, floor = wanted.layout, wanted.floor
    if abs(floor[cell] - z) < wanted.height:  # False for NaN
        return False
    x, y = center(layout, cell)
    for other in range(len(layout.width)):
        width = layout.width[other]
        col, row = in_cells(layout, other, x, y)
        if other != level and 0 <= row < layout.height[other] and 0 <= col < width:
            there = layout.start[other] + np.int64(row) * width + np.int64(col)
            if not wanted.mask[there] and abs(floor[there] - z) < wanted.height:
                return True
    return False


@kernel
def first_in_sight(space, room, cell, x, y, candidates):
    """The first of some cells whose centre is in sight of x, y in a cell, -1 for none.

    See `navbake.runtime.kernels.crossing.walk_line` for `room`.
    """
    for candidate in candidates:
        to_x, to_y = center(space.layout, candidate)
        if is_in_sight(space, room, cell, x, y, candidate, to_x, to_y):
            return candidate
    return np.int64(-1)
