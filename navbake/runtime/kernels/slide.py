"""Slides along obstacles: finds the point nearest to the end that a short walk reaches.

A flood over the free cells within reach, with lengths that are corrected until none gets shorter
(Bellman and Ford with a queue): on a window of some dozen cells that is quicker than a heap. Of
every cell that is reached, the point that is the nearest to the end is a candidate.
"""

import math

import numpy as np

from navbake.compiled import kernel, part
from navbake.runtime.kernels.arrays import in_cells, level_of, put_into
from navbake.runtime.kernels.buckets import DIAGONAL
from navbake.runtime.kernels.crossing import cross

ROUNDING = 1.09  # a walk over eight neighbours is at most so much longer than a straight line


@kernel
def slide(space, cell, x0, y0, x1, y1):
    """Continue from x0, y0 in a cell, where a straight walk to x1, y1 ended, to the nearest point.

    A cell counts if a walk over free neighbours to it is no longer than what is left of the way,
    and there only points at most as far away as that. Returns its flat id, and x, y in it.
    """
    layout, links, floors, passable = space
    floor, max_step = floors.z, floors.max_step
    left = math.hypot(x1 - x0, y1 - y0)
    size = layout.cell_size.min()
    limit = ROUNDING * left + 1.5 * size
    window = _make_window(layout, x0, y0, np.int64(math.ceil(limit / size)) + 1)
    length = np.full(window[0, -1], np.inf)
    queued = np.zeros(window[0, -1], dtype=np.bool_)
    queue = np.empty(window[0, -1], dtype=np.int64)  # a circle; no cell is in it twice, so all fit
    at = _slot(layout, window, cell)
    length[at], queue[0], queued[at] = 0.0, cell, True
    around = np.empty(8, dtype=np.int64)
    head, count = 0, 1
    best = (np.inf, cell, x0, y0)
    while count > 0:
        here = queue[head]
        head, count = (head + 1) % len(queue), count - 1
        at = _slot(layout, window, here)
        queued[at] = False
        # the better of the best point so far and the nearest one in this cell
        x, y = put_into(layout, here, x1, y1)
        d2 = (x - x1) ** 2 + (y - y1) ** 2
        if d2 < best[0] and math.hypot(x - x0, y - y0) <= left * (1.0 + 1e-9):
            best = (d2, here, x, y)
        _find_neighbours(layout, links, passable, floor, max_step, here, around)
        for way in range(8):
            other = around[way]
            slot = _slot(layout, window, other) if other >= 0 else -1
            if slot < 0:
                continue
            step = layout.cell_size[level_of(layout.start, here)] * (1.0 if way < 4 else DIAGONAL)
            there = length[at] + step
            if there <= limit and there < length[slot] - 1e-9 * size:
                length[slot] = there
                if not queued[slot]:
                    queue[(head + count) % len(queue)] = other
                    queued[slot], count = True, count + 1
    return best[1], best[2], best[3]


@part
def _find_neighbours(layout, links, passable, floor, max_step, cell, around):
    """The cells that steps lead to, -1 for none: over edges, then over corners past both sides."""
    steps = ((0, 1), (-1, 0), (0, -1), (1, 0))
    for way in range(4):
        down, across = steps[way]
        around[way] = cross(layout, links, passable, floor, max_step, cell, down, across)
    for way in range(4):
        one, other = around[way], around[(way + 1) % 4]
        around[4 + way] = -1
        if one >= 0 and other >= 0:
            down, across = steps[(way + 1) % 4]
            one = cross(layout, links, passable, floor, max_step, one, down, across)
            down, across = steps[way]
            other = cross(layout, links, passable, floor, max_step, other, down, across)
            if one == other:  # both ways round the corner end in the same cell
                around[4 + way] = one


@part
def _make_window(layout, x, y, reach):
    """The cells of each level within `reach` rows and columns of a point.

    By level, shape (5, num_levels + 1): first row and column, number of rows and of columns, slot
    of the first cell. The number of all slots is at [0, -1].
    """
    num_levels, slots = len(layout.width), 0
    window = np.zeros((5, num_levels + 1), dtype=np.int64)
    for level in range(num_levels):
        u, v = in_cells(layout, level, x, y)
        row, col = np.int64(math.floor(v)), np.int64(math.floor(u))
        row0, row1 = max(0, row - reach), min(layout.height[level], row + reach + 1)
        col0, col1 = max(0, col - reach), min(layout.width[level], col + reach + 1)
        window[0, level], window[1, level] = row0, col0
        window[2, level], window[3, level] = max(0, row1 - row0), max(0, col1 - col0)
        window[4, level] = slots
        slots += window[2, level] * window[3, level]
    window[0, -1] = slots
    return window


@part
def _slot(layout, window, cell):
    """Index of a cell in a window, -1 outside."""
    level = level_of(layout.start, cell)
    row, col = divmod(cell - layout.start[level], layout.width[level])
    row, col = row - window[0, level], col - window[1, level]
    if not (0 <= row < window[2, level] and 0 <= col < window[3, level]):
        return np.int64(-1)
    return window[4, level] + row * window[3, level] + col
