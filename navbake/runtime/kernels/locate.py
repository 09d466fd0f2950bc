"""Finds the cells that positions are in, and whether an agent can stand there.

Plain search: of the levels' floors in a position's column, the highest at or below it. Positions
are taken in blocks, level by level: a look-up at a random address waits for the memory, and in a
block many such waits overlap.
"""

import math

import numpy as np

from navbake.compiled import kernel, part

BLOCK = 512  # positions; what a block needs stays in the processor's first cache


@kernel
def locate(layout, floors, positions):
    """Find the cells whose floors are the nearest at or below positions, shape (n, 3) [m].

    A floor may be `max_step` above its position. Where no level has such a floor in a position's
    column, the level counts whose ground is. Returns flat ids, -1 for none, and the index of the
    first position that is not finite, or -1.
    """
    cells = np.empty(len(positions), dtype=np.int64)
    z = np.empty(BLOCK)
    for begin in range(0, len(positions), BLOCK):
        end = min(begin + BLOCK, len(positions))
        bad = _locate_block(layout, floors, positions[begin:end], cells[begin:end], z)
        if bad >= 0:
            return cells, begin + bad
    return cells, -1


@kernel
def stand_on(layout, floors, free, max_drop, positions):
    """Mark the positions at most `max_drop` above a free floor [m]; then as `locate`."""
    answers = np.zeros(len(positions), dtype=np.bool_)
    cells, z = np.empty(BLOCK, dtype=np.int64), np.empty(BLOCK)
    for begin in range(0, len(positions), BLOCK):
        end = min(begin + BLOCK, len(positions))
        bad = _locate_block(layout, floors, positions[begin:end], cells, z)
        if bad >= 0:
            return answers, begin + bad
        above = positions[begin:end, 2]
        for i in range(end - begin):
            is_near = above[i] - z[i] <= max_drop
            answers[begin + i] = (cells[i] >= 0) & free[max(cells[i], 0)] & is_near
    return answers, -1


@part
def _locate_block(layout, floors, positions, cells, z):
    """`locate` for at most BLOCK positions; cells and their heights are written."""
    at = np.empty(BLOCK, dtype=np.int64)
    on_ground, highest_ground = np.full(BLOCK, -1, dtype=np.int64), np.full(BLOCK, -np.inf)
    floor, ground, slack = floors.z, floors.ground, floors.max_step
    count = len(positions)
    for i in range(count):
        x, y, height = positions[i, 0], positions[i, 1], positions[i, 2]
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(height)):
            return i
        cells[i], z[i] = -1, -np.inf
    for level in range(len(layout.width)):
        locate_on(layout, level, positions, at)
        for i in range(count):  # few branches: where positions are can't be predicted
            height, limit = floor[max(at[i], 0)], positions[i, 2] + slack
            is_nearer = (at[i] >= 0) & (height > z[i]) & (height <= limit)
            cells[i] = at[i] if is_nearer else cells[i]
            z[i] = height if is_nearer else z[i]
            if at[i] >= 0 and math.isnan(height) and highest_ground[i] < ground[level] <= limit:
                on_ground[i], highest_ground[i] = at[i], ground[level]
    for i in range(count):
        if cells[i] < 0:
            cells[i], z[i] = on_ground[i], highest_ground[i]
    return -1


@kernel
def locate_on(layout, level, positions, cells):
    """Write the flat ids of a level's cells that finite positions are in, -1 beside the level."""
    first, rows, cols = layout.start[level], layout.height[level], layout.width[level]
    x0, y1, size = layout.x_min[level], layout.y_max[level], layout.cell_size[level]
    for i in range(len(positions)):
        col = np.floor((positions[i, 0] - x0) / size)
        row = np.floor((y1 - positions[i, 1]) / size)
        is_inside = 0 <= row < rows and 0 <= col < cols
        cells[i] = first + np.int64(row) * cols + np.int64(col) if is_inside else -1
