"""The cheapest route over the moves of all levels and the links between them: A*.

Cells are flat ids over all levels. A step costs its length [m] times the weight of the cell that
it leads to. Open cells wait in buckets by what a route over them costs at least. Cells of a
bucket may be improved while it is being worked off, and are then looked at again, so the answer
is the cheapest route whatever the width of the buckets.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from navbake.runtime.kernels.buckets import DIAGONAL, OPEN, USED, make_queue, pop, push

# What `mark` holds of a cell: the way it was reached (a direction, START, LINK or NONE) in the
# lowest four bits, whether it is a goal, whether it was worked off, and the number of the search
# that wrote it, so that nothing has to be cleared between searches.
WAY, GOAL, CLOSED, SEARCH = 15, 16, 32, 64
START, LINK, NONE = 8, 9, 15
NO_ROOM = -2


@njit(cache=True, error_model="numpy")
def level_of(cell, start):
    """The level of a flat id."""
    level = 0
    while cell >= start[level + 1]:
        level += 1
    return level


@njit(cache=True, error_model="numpy")
def find_slot(link_cell, cell):
    """Where a cell is in the list of those that links lead from, or -1."""
    low, high = 0, link_cell.shape[0]
    while low < high:
        middle = (low + high) >> 1
        if link_cell[middle] < cell:
            low = middle + 1
        else:
            high = middle
    return low if low < link_cell.shape[0] and link_cell[low] == cell else -1


@njit(cache=True, error_model="numpy")
def goal_box(goals, start, width, x_min, y_max, cell_size):
    """The box round goals, in rows and columns of each level.

    Returns:
        First and last row, first and last column, shape (num_levels, 4), float64.
    """
    x0, x1, y0, y1 = np.inf, -np.inf, np.inf, -np.inf
    for goal in goals:
        level = level_of(goal, start)
        row, col = divmod(goal - start[level], width[level])
        x = x_min[level] + (col + 0.5) * cell_size[level]
        y = y_max[level] - (row + 0.5) * cell_size[level]
        x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
    box = np.empty((width.shape[0], 4))
    for level in range(width.shape[0]):
        size = cell_size[level]
        box[level, 0] = (y_max[level] - y1) / size - 0.5
        box[level, 1] = (y_max[level] - y0) / size - 0.5
        box[level, 2] = (x0 - x_min[level]) / size - 0.5
        box[level, 3] = (x1 - x_min[level]) / size - 0.5
    return box


@njit(cache=True, error_model="numpy")
def _at_least(row, col, box, scale):
    """What a route from a cell to the goals' box costs at least: the octile distance."""
    a = max(box[0] - row, row - box[1], 0.0)
    b = max(box[2] - col, col - box[3], 0.0)
    return scale * (max(a, b) + (DIAGONAL - 1.0) * min(a, b))


@njit(cache=True, error_model="numpy")
def find_route(
    origin, goals, box, moves, weight, same_weight, least_weight,
    start, width, cell_size, link_cell, link_start, link_target, link_length,
    bucket, num_buckets, search, mark, cost, link_from, entry_cell, entry_next,
):  # fmt: skip
    """Find the cheapest route from a cell to the cheapest of several goals.

    Args:
        origin: a free cell.
        goals: free cells, at least one.
        box: of the goals, see `goal_box`.
        moves: by cell, see `navbake.runtime.kernels.moves`.
        weight: by cell, float64, inf where it isn't free.
        same_weight: the weight of all free cells, or 0 where they differ.
        least_weight: the smallest weight of a free cell, >= 0.
        start, width, cell_size: of the levels, see `navbake.runtime.flat_grid.Walk`.
        link_cell, link_start, link_target, link_length: likewise.
        bucket, num_buckets: see `navbake.runtime.kernels.buckets.bucket_width`.
        search: number of this search, larger than any that wrote into `mark`.
        mark: by cell, int32, receives how cells were reached.
        cost: by cell, float64, receives their costs where `mark` is of this search.
        link_from: by place in `link_cell`, int64, receives where a link that was taken leads from.
        entry_cell, entry_next: int32, of one length: room for open cells.

    Returns:
        The goal that was reached, -1 for none, NO_ROOM if the room for open cells is too small;
        and how many cells were worked off.
    """
    head, state = make_queue(num_buckets)
    row_step = np.array([0, -1, 0, 1, -1, -1, 1, 1])
    col_step = np.array([1, 0, -1, 0, 1, -1, -1, 1])
    per_bucket, slack = 1.0 / bucket, 1e-9 * bucket  # a smaller gain is rounding
    mine = search * SEARCH
    best, reached, count = np.inf, np.int64(-1), 0
    for goal in goals:
        mark[goal] = mine | GOAL | NONE
        cost[goal] = np.inf
        if goal == origin:
            return goal, count
    mark[origin], cost[origin] = mine | START, 0.0
    level = level_of(origin, start)
    first, columns, size = start[level], width[level], cell_size[level]
    row, col = divmod(origin - first, columns)
    at = np.int64(_at_least(row, col, box[level], size * least_weight) * per_bucket)
    push(head, state, entry_cell, entry_next, at, origin)
    while state[OPEN] > 0:
        cell = pop(head, state, entry_cell, entry_next, at)
        if cell < 0:
            at += 1
            if at * bucket >= best:
                break
            continue
        if mark[cell] & (CLOSED | GOAL):  # over a goal, no other is cheaper
            continue
        mark[cell] |= CLOSED
        count += 1
        here, ways = cost[cell], moves[cell]
        if cell < first or cell >= start[level + 1]:
            level = level_of(cell, start)
            first, columns, size = start[level], width[level], cell_size[level]
        row, col = divmod(cell - first, columns)
        slot = find_slot(link_cell, cell)
        num_links = 0 if slot < 0 else link_start[slot + 1] - link_start[slot]
        if state[USED] + 8 + num_links > entry_cell.shape[0]:
            return NO_ROOM, count
        for way in range(8 + num_links):
            if way < 8:
                if not (ways >> way) & 1:
                    continue
                r, c, on = row + row_step[way], col + col_step[way], level
                target = cell + row_step[way] * columns + col_step[way]
                length = size if way < 4 else size * DIAGONAL
            else:
                target = link_target[link_start[slot] + way - 8]
                length = link_length[link_start[slot] + way - 8]
                if not math.isfinite(weight[target]):
                    continue
                on = level_of(target, start)
                r, c = divmod(target - start[on], width[on])
            there = here + length * (same_weight if same_weight > 0.0 else weight[target])
            goal = 0
            if mark[target] >= mine:  # no search has a larger number
                if there >= cost[target] - slack:
                    continue
                goal = mark[target] & GOAL
            if way >= 8:
                link_from[find_slot(link_cell, target)] = cell
            mark[target], cost[target] = mine | goal | (way if way < 8 else LINK), there
            if goal and there < best:
                best, reached = there, target
            total = there + _at_least(r, c, box[on], cell_size[on] * least_weight)
            place = max(np.int64(total * per_bucket), at)
            push(head, state, entry_cell, entry_next, place, target)
    return reached, count


@njit(cache=True, error_model="numpy")
def trace_route(reached, mark, start, width, link_cell, link_from):
    """The cells of the route that a search has found, from its origin to the goal.

    Args:
        reached: the goal.
        mark, link_from: as the search left them.
        start, width, link_cell: as it had them.

    Returns:
        Flat ids, shape (n,), int64.
    """
    row_step = np.array([0, -1, 0, 1, -1, -1, 1, 1])
    col_step = np.array([1, 0, -1, 0, 1, -1, -1, 1])
    route = np.empty(256, np.int64)
    count, cell = 0, np.int64(reached)
    while True:
        if count == route.shape[0]:
            route = np.append(route, np.empty_like(route))
        route[count] = cell
        count += 1
        way = mark[cell] & WAY
        if way in (START, NONE):
            break
        if way == LINK:
            cell = link_from[find_slot(link_cell, cell)]
        else:
            cell -= row_step[way] * width[level_of(cell, start)] + col_step[way]
    return route[:count][::-1].copy()
