"""Walks along straight lines from cell to cell and from level to level, and slides at their ends.

A line goes from cell to cell as in Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray
Tracing" (1987). Unlike there, each crossing is computed from the cell's own edge, not summed up,
because a link may lead to a level whose cells lie elsewhere.

A slide is a flood over the free cells within reach, with lengths that are corrected until none
gets shorter (Bellman and Ford with a queue). Of every cell that is reached, the point that is the
nearest to the end is a candidate.
"""

import math

import numpy as np

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import (
    DIAGONAL,
    center,
    find_slot,
    floor_at,
    in_cells,
    level_of,
    put_into,
)
from navbake.runtime.place_kernels import locate

FARTHEST = 1e6  # metres that a step may be long: no cells are counted up to beyond all grids
ROUNDING = 1.09  # a walk over eight neighbours is at most so much longer than a straight line


@kernel
def step_each(layout, links, floors, passable, level, starts, ends, sliding):
    """Walk from starts straight to ends, x, y [m], and slide on; see `PathFinder.try_step`.

    Returns world x, y and floor z of where the ways end, shape (n, 3); and the index of the first
    start whose cell is not passable, -1 for none.
    """
    no_rooms = np.empty(0, dtype=np.int32)
    cells = locate(layout, floors, level, starts)
    found = np.empty((len(starts), 3))
    for i in range(len(starts)):
        cell = cells[i]
        if cell < 0 or not passable[cell]:
            return found, i
        x0 = starts[i, 0]
        y0 = starts[i, 1]
        x1 = ends[i, 0]
        y1 = ends[i, 1]
        farthest = max(abs(x1 - x0), abs(y1 - y0))
        if farthest > FARTHEST:
            x1 = x0 + (x1 - x0) * (FARTHEST / farthest)
            y1 = y0 + (y1 - y0) * (FARTHEST / farthest)
        cell, share = walk_line(layout, links, floors, passable, no_rooms, cell, x0, y0, x1, y1)
        x, y = put_into(layout, cell, x0 + share * (x1 - x0), y0 + share * (y1 - y0))
        if share < 1.0 and sliding:
            cell, x, y = _slide(layout, links, floors, passable, cell, x, y, x1, y1)
        found[i, 0] = x
        found[i, 1] = y
        found[i, 2] = floor_at(floors, level_of(layout.start, cell), cell)
    return found, -1


@kernel
def first_in_sight(layout, links, floors, passable, room, cell, point, cells, points):
    """The index of the first of some points in cells that is in sight of a point, -1 for none.

    A straight line between them must meet passable cells only; heights count as far as `floors`
    have a finite `max_step`. Where `room` is not empty, the line may start in something; see
    `walk_line`.
    """
    if len(room) == 0 and not passable[cell]:
        return -1
    x0, y0 = put_into(layout, cell, point[0], point[1])
    for i in range(len(cells)):
        target = cells[i]
        if passable[target]:
            x1, y1 = put_into(layout, target, points[i, 0], points[i, 1])
            end, _ = walk_line(layout, links, floors, passable, room, cell, x0, y0, x1, y1)
            if end == target:
                return i
    return -1


@subkernel
def walk_line(layout, links, floors, passable, room, cell, x0, y0, x1, y1):
    """Walk from a point in a cell straight to another: to which cell, and what share of the way.

    Through a corner of four cells, one of the two beside the line has to be passable. If `room`,
    by cell, is not empty, the line may start in cells that are not passable, and continue in them
    as long as they are of the first one's room, until it leaves them.
    """
    dx = x1 - x0
    dy = y1 - y0
    across = 1 if dx > 0 else -1
    down = 1 if dy < 0 else -1
    home = cell
    leaving = len(room) > 0 and not passable[cell]
    share = 0.0
    while True:
        level = level_of(layout.start, cell)
        size = layout.cell_size[level]
        row, col = divmod(cell - layout.start[level], layout.width[level])
        edge_x = layout.x_min[level] + (col + (dx > 0)) * size
        edge_y = layout.y_max[level] - (row + (dy < 0)) * size
        to_x = (edge_x - x0) / dx if dx != 0.0 else np.inf
        to_y = (edge_y - y0) / dy if dy != 0.0 else np.inf
        # rounding may put an edge of the new cell before the one just crossed: never go back
        share = max(share, min(to_x, to_y))
        if share >= 1.0:
            return cell, 1.0
        following = np.int64(-1)
        # At a corner the line meets both edges at once. Then the cell over either edge is
        # enough: the second turn tries the other one, and the next round crosses from there.
        for turn in range(2):
            over_x = (to_x <= to_y) == (turn == 0)
            if following >= 0 or (turn == 1 and to_x != to_y):
                break
            dr, dc = (0, across) if over_x else (down, 0)
            following = _cross(layout, links, passable, floors, cell, dr, dc)
            if following < 0 and leaving:
                beside = _beside(layout, cell, dr, dc)
                following = beside if beside >= 0 and room[beside] == room[home] else following
        if following < 0:
            return cell, share
        cell = following
        leaving = leaving and not passable[cell]


@subkernel
def _cross(layout, links, passable, floors, cell, down, across):
    """The passable cell over one edge of a cell, on its level or over a link, -1 for none.

    Of `down`, `across` one is 0, one ±1.
    """
    other = _beside(layout, cell, down, across)
    if other >= 0 and passable[other]:
        rise = abs(floors.z[cell] - floors.z[other])
        if math.isnan(rise) or rise <= floors.max_step:  # NaN, no floor, is no step
            return other
    slot = find_slot(links.cell, cell)
    if slot < 0:
        return np.int64(-1)
    size = layout.cell_size[level_of(layout.start, cell)]
    x, y = center(layout, cell)
    x = x + across * size
    y = y - down * size
    near = 0.25 * size
    for i in range(links.start[slot], links.start[slot + 1]):
        other = links.target[i]
        if passable[other]:
            other_x, other_y = center(layout, other)
            if abs(other_x - x) < near and abs(other_y - y) < near:
                return other
    return np.int64(-1)


@subkernel
def _beside(layout, cell, down, across):
    """The neighbour on the same level, -1 beyond its rim."""
    level = level_of(layout.start, cell)
    columns = layout.width[level]
    row, col = divmod(cell - layout.start[level], columns)
    if 0 <= row + down < layout.height[level] and 0 <= col + across < columns:
        return cell + down * columns + across
    return np.int64(-1)


@subkernel
def _slide(layout, links, floors, passable, cell, x0, y0, x1, y1):
    """Continue from x0, y0 in a cell, where a straight walk to x1, y1 ended, to the nearest point.

    A cell counts if a walk over free neighbours to it is no longer than what is left of the way,
    and there only points at most as far away as that. Returns its flat id, and x, y in it.
    """
    left = math.hypot(x1 - x0, y1 - y0)
    size = layout.cell_size.min()
    limit = ROUNDING * left + 1.5 * size
    # the cells of each level within reach: first row and column, number of rows and of columns,
    # and the slot of the first one in the arrays of this search
    reach = np.int64(math.ceil(limit / size) + 1)
    slots = 0
    window = np.zeros((5, len(layout.width)), dtype=np.int64)
    for level in range(len(layout.width)):
        u, v = in_cells(layout, level, x0, y0)
        row = np.int64(math.floor(v))
        col = np.int64(math.floor(u))
        row0 = max(row - reach, np.int64(0))
        col0 = max(col - reach, np.int64(0))
        row1 = max(row0, min(layout.height[level], row + reach + 1))
        col1 = max(col0, min(layout.width[level], col + reach + 1))
        window[0, level] = row0
        window[1, level] = col0
        window[2, level] = row1 - row0
        window[3, level] = col1 - col0
        window[4, level] = slots
        slots += window[2, level] * window[3, level]
    length = np.full(slots, np.inf)
    queued = np.zeros(slots, dtype=np.bool_)
    queue = np.empty(slots, dtype=np.int64)  # a circle; no cell is in it twice, so all fit
    at = _slot(layout, window, cell)
    length[at] = 0.0
    queue[0] = cell
    queued[at] = True
    steps = ((0, 1), (-1, 0), (0, -1), (1, 0))
    around = np.empty(4, dtype=np.int64)
    head = 0
    count = 1
    best = (np.inf, cell, x0, y0)
    while count > 0:
        here = queue[head]
        head = (head + 1) % len(queue)
        count = count - 1
        at = _slot(layout, window, here)
        queued[at] = False
        # the better of the best point so far and the nearest one in this cell
        x, y = put_into(layout, here, x1, y1)
        d2 = (x - x1) ** 2 + (y - y1) ** 2
        if d2 < best[0] and math.hypot(x - x0, y - y0) <= left * (1.0 + 1e-9):
            best = (d2, here, x, y)
        edge = layout.cell_size[level_of(layout.start, here)]
        for way in range(8):  # over edges, then over corners past both sides
            down, across = steps[way % 4]
            if way < 4:
                other = _cross(layout, links, passable, floors, here, down, across)
                around[way] = other
                there = length[at] + edge
            else:
                one = around[way - 4]
                other = around[(way - 3) % 4]
                if one < 0 or other < 0:
                    continue
                dr, dc = steps[(way - 3) % 4]
                one = _cross(layout, links, passable, floors, one, dr, dc)
                other = _cross(layout, links, passable, floors, other, down, across)
                if one != other:  # both ways round the corner end in the same cell
                    continue
                there = length[at] + edge * DIAGONAL
            slot = _slot(layout, window, other) if other >= 0 else -1
            if slot >= 0 and there <= limit and there < length[slot] - 1e-9 * size:
                length[slot] = there
                if not queued[slot]:
                    queue[(head + count) % len(queue)] = other
                    queued[slot] = True
                    count = count + 1
    return best[1], best[2], best[3]


@subkernel
def _slot(layout, window, cell):
    """Index of a cell in the windows of all levels, -1 outside."""
    level = level_of(layout.start, cell)
    row, col = divmod(cell - layout.start[level], layout.width[level])
    row = row - window[0, level]
    col = col - window[1, level]
    if not (0 <= row < window[2, level] and 0 <= col < window[3, level]):
        return np.int64(-1)
    return window[4, level] + row * window[3, level] + col
