"""Finds the cells that positions are in, and the nearest cells of a mask; of many positions a call.

Positions are located in blocks, level by level: a look-up at a random address waits for the memory,
and in a block many such waits overlap.

The nearest cell is searched in square rings round the point's cell, until no cell of the next ring
can be nearer than the best so far. Where the mask is dense near the point, as free and occupied
cells are, that is quicker than any index, and a block outdates nothing.
"""

import math

import numpy as np

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import center, floor_at, in_cells, level_of

BLOCK = 512  # positions; what a block needs stays in the processor's first cache
MAX_DROP = 0.5  # metres that a position may be above the floor of an agent that stands there
# What is measured: on the map to a cell's centre; in space to the centre, on the floor; on the map
# to the square, except of cells over or under which another level goes on at the point's height.
TO_CENTER = 0
IN_SPACE = 1
TO_OBSTACLE = 2


@kernel
def locate(layout, floors, level, positions):
    """Find the cells whose floors are the nearest at or below positions, shape (n, 3) [m].

    A floor may be `max_step` above its position. Where no level has such a floor in a position's
    column, the level counts whose ground is. With a `level` that isn't -1, all positions are on
    it and x, y are enough. Returns flat ids, -1 for none.
    """
    cells = np.empty(len(positions), dtype=np.int64)
    if level >= 0:
        _locate_on(layout, level, positions, cells)
        return cells
    z = np.empty(BLOCK)
    for begin in range(0, len(positions), BLOCK):
        end = min(begin + BLOCK, len(positions))
        _locate_block(layout, floors, positions[begin:end], cells[begin:end], z)
    return cells


@kernel
def stand_on(layout, floors, free, max_drop, positions):
    """Mark the positions, shape (n, 3), that are at most `max_drop` above a free floor [m]."""
    answers = np.zeros(len(positions), dtype=np.bool_)
    cells = np.empty(BLOCK, dtype=np.int64)
    z = np.empty(BLOCK)
    for begin in range(0, len(positions), BLOCK):
        end = min(begin + BLOCK, len(positions))
        _locate_block(layout, floors, positions[begin:end], cells, z)
        above = positions[begin:end, 2]
        for i in range(end - begin):
            is_near = above[i] - z[i] <= max_drop
            answers[begin + i] = (cells[i] >= 0) & free[max(cells[i], 0)] & is_near
    return answers


@subkernel
def _locate_block(layout, floors, positions, cells, z):
    """Locate at most BLOCK positions: writes their cells and floors."""
    at = np.empty(BLOCK, dtype=np.int64)
    on_ground = np.full(BLOCK, -1, dtype=np.int64)
    highest_ground = np.full(BLOCK, -np.inf)
    floor = floors.z
    ground = floors.ground
    slack = floors.max_step
    count = len(positions)
    cells[:count] = -1
    z[:count] = -np.inf
    for level in range(len(layout.width)):
        _locate_on(layout, level, positions, at)
        for i in range(count):  # few branches: where positions are can't be predicted
            height = floor[max(at[i], 0)]
            limit = positions[i, 2] + slack
            is_nearer = (at[i] >= 0) & (height > z[i]) & (height <= limit)
            cells[i] = at[i] if is_nearer else cells[i]
            z[i] = height if is_nearer else z[i]
            if at[i] >= 0 and math.isnan(height) and highest_ground[i] < ground[level] <= limit:
                on_ground[i] = at[i]
                highest_ground[i] = ground[level]
    for i in range(count):
        if cells[i] < 0:
            cells[i] = on_ground[i]
            z[i] = highest_ground[i]


@subkernel
def _locate_on(layout, level, positions, cells):
    """Write the flat ids of a level's cells that finite positions are in, -1 beside the level."""
    first = layout.start[level]
    rows = layout.height[level]
    cols = layout.width[level]
    x0 = layout.x_min[level]
    y1 = layout.y_max[level]
    size = layout.cell_size[level]
    for i in range(len(positions)):
        col = np.floor((positions[i, 0] - x0) / size)
        row = np.floor((y1 - positions[i, 1]) / size)
        is_inside = 0 <= row < rows and 0 <= col < cols
        cells[i] = first + np.int64(row) * cols + np.int64(col) if is_inside else -1


@kernel
def snap_each(layout, floors, allowed, level, same_level, farthest, positions):
    """Find the places in allowed cells (by cell) nearest to positions, see `PathFinder.snap`.

    All positions, shape (n, 3), are on a `level`; for -1, each on that of the floor below it.
    Returns world x, y, z [m], shape (n, 3), NaN for none; and flat ids, -1 for none.
    """
    cells = locate(layout, floors, level, positions)
    found = np.full((len(positions), 3), np.nan)
    for i in range(len(positions)):
        home = cells[i]
        point = (positions[i, 0], positions[i, 1], positions[i, 2])
        on = level_of(layout.start, home) if home >= 0 else level
        if home >= 0 and allowed[home]:
            z = floor_at(floors, on, home)
            if level >= 0 or point[2] - z <= MAX_DROP:
                found[i, 0] = point[0]
                found[i, 1] = point[1]
                found[i, 2] = z
                continue
        best = farthest
        nearest = np.int64(-1)
        is_here = same_level and on >= 0
        for other in range(on, on + 1) if is_here else range(len(layout.width)):
            measure, ground = (TO_CENTER, 0.0) if is_here else (IN_SPACE, floors.ground[other])
            cell, distance = nearest_cell(
                layout, allowed, floors.z, measure, ground, other, point, best
            )
            if cell >= 0 and (nearest < 0 or distance < best):
                nearest = cell
                best = distance
        cells[i] = nearest
        if nearest >= 0:
            found[i, 0], found[i, 1] = center(layout, nearest)
            found[i, 2] = floor_at(floors, level_of(layout.start, nearest), nearest)
    return found, cells


@kernel
def find_obstacles(layout, floors, occupied, overlap, level, farthest, positions):
    """Find the squares of occupied cells nearest to positions, see `PathFinder.nearest_obstacle`.

    Floors less than `overlap` [m] apart are at one height. Returns the positions' own cells, and
    the obstacles', by flat id, -1 for none; and distances [m].
    """
    homes = locate(layout, floors, level, positions)
    cells = np.full(len(homes), -1, dtype=np.int64)
    distances = np.empty(len(homes))
    for i in range(len(homes)):
        if homes[i] >= 0:
            on = level_of(layout.start, homes[i])
            point = (positions[i, 0], positions[i, 1], floor_at(floors, on, homes[i]))
            cells[i], distances[i] = nearest_cell(
                layout, occupied, floors.z, TO_OBSTACLE, overlap, on, point, farthest
            )
    return homes, cells, distances


@subkernel
def nearest_cell(layout, mask, floor, measure, height, level, point, farthest):
    """The cell of a level in a mask nearest to x, y, z within `farthest`, and its distance [m].

    -1 for none; of equally near ones, the lowest id. For TO_OBSTACLE, z is the floor's at the
    point, and floors less than `height` apart are at one height; for IN_SPACE, cells without floor
    are taken to be at `height`.
    """
    rows = layout.height[level]
    cols = layout.width[level]
    size = layout.cell_size[level]
    u, v = in_cells(layout, level, point[0], point[1])
    # in rings round the level's cell that is nearest to the point
    row0 = int(min(max(v, 0.0), rows - 1.0))
    col0 = int(min(max(u, 0.0), cols - 1.0))
    beside = max(0.0, -u, u - cols) ** 2 + max(0.0, -v, v - rows) ** 2
    best = (farthest * farthest, np.int64(-1))
    ring = 0
    last = max(row0, rows - 1 - row0, col0, cols - 1 - col0)
    # the point is up to half a cell nearer to a ring's centres than its own cell's centre is, and
    # a whole cell nearer to the squares
    inside = 1.0 if measure == TO_OBSTACLE else 0.5
    while ring <= last and (max(0.0, ring - inside) ** 2 + beside) * size * size <= best[0]:
        for row in range(max(0, row0 - ring), min(rows - 1, row0 + ring) + 1):
            left = col0 - ring
            right = col0 + ring
            stride = 2 * ring
            if abs(row - row0) == ring:  # the top or the bottom row of the ring: all of it
                left = max(0, left)
                stride = 1
            elif left < 0:
                left = right
            span = (row, left, min(cols - 1, right), stride)
            best = _look(layout, mask, floor, measure, height, level, point, span, best)
        ring += 1
    return best[1], math.sqrt(best[0])


@subkernel
def _look(layout, mask, floor, measure, height, level, point, span, best):
    """The better of the best so far and every `stride`-th cell of a row: squared distance, id."""
    row, first, last, stride = span
    d2_best, found = best
    size = layout.cell_size[level]
    x_min = layout.x_min[level]
    y_max = layout.y_max[level]
    begin = layout.start[level] + row * layout.width[level]
    for col in range(first, last + 1, stride):
        cell = begin + col
        if not mask[cell]:
            continue
        dx = abs(x_min + (col + 0.5) * size - point[0])
        dy = abs(y_max - (row + 0.5) * size - point[1])
        if measure == TO_OBSTACLE:
            dx = max(0.0, dx - 0.5 * size)
            dy = max(0.0, dy - 0.5 * size)
        d2 = dx * dx + dy * dy
        if measure == IN_SPACE:
            z = height if math.isnan(floor[cell]) else floor[cell]
            d2 += (z - point[2]) ** 2
        if d2 < d2_best or (d2 == d2_best and (found < 0 or cell < found)):
            if measure == TO_OBSTACLE and _is_elsewhere(
                layout, mask, floor, height, level, cell, point[2]
            ):
                continue
            d2_best = d2
            found = cell
    return d2_best, found


@subkernel
def _is_elsewhere(layout, mask, floor, height, level, cell, z):
    """Whether another level, but not this one, has a clear floor near a height in the column."""
    if abs(floor[cell] - z) < height:  # False for NaN
        return False
    x, y = center(layout, cell)
    for other in range(len(layout.width)):
        width = layout.width[other]
        col, row = in_cells(layout, other, x, y)
        if other != level and 0 <= row < layout.height[other] and 0 <= col < width:
            there = layout.start[other] + np.int64(row) * width + np.int64(col)
            if not mask[there] and abs(floor[there] - z) < height:
                return True
    return False
