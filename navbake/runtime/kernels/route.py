"""The cheapest route over the moves of all levels and the links between them: A*.

A* (Hart, Nilsson and Raphael 1968) with a bucket queue, see `navbake.runtime.kernels.buckets`. A
step costs its length [m] times the weight of the cell that it leads to. What is left to the goals
is estimated by the octile distance to the box round them times the smallest weight, which is
never too much, so the answer is the cheapest route. On another level the same estimate holds
along x and y, since a link costs at least what it covers there.

Cells of a bucket may get cheaper while it is being emptied, and are then expanded again, so the
width of the buckets changes the time, not the answer.
"""

import math

import numpy as np

from navbake.compiled import kernel, part
from navbake.runtime.kernels.arrays import center, find_slot, in_cells, level_of
from navbake.runtime.kernels.buckets import DIAGONAL, OPEN, USED, make_queue, pop, push
from navbake.runtime.kernels.moves import COL_STEP, ROW_STEP

# The bits of a cell's `mark`:
#   0 to 3   the way it was reached: a direction, START, LINK or NONE
#   4        whether it is a goal
#   5        whether it was expanded
#   6 on     the number of the search that wrote it, so that nothing is cleared between searches
WAY, GOAL, CLOSED, SEARCH = 15, 16, 32, 64
START, LINK, NONE = 8, 9, 15
NO_ROOM = -2


@part
def _goal_box(layout, goals):
    """The box round goals by level: first and last row, first and last column, (num_levels, 4)."""
    x0, x1, y0, y1 = np.inf, -np.inf, np.inf, -np.inf
    for goal in goals:
        x, y = center(layout, goal)
        x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
    box = np.empty((layout.width.shape[0], 4))
    for level in range(layout.width.shape[0]):
        left, top = in_cells(layout, level, x0, y1)
        right, bottom = in_cells(layout, level, x1, y0)
        box[level, 0], box[level, 1] = top - 0.5, bottom - 0.5
        box[level, 2], box[level, 3] = left - 0.5, right - 0.5
    return box


@part
def _lower_bound(row, col, box, scale):
    """What a route from a cell to the goals' box costs at least: the octile distance."""
    a = max(box[0] - row, row - box[1], 0.0)
    b = max(box[2] - col, col - box[3], 0.0)
    return scale * (max(a, b) + (DIAGONAL - 1.0) * min(a, b))


@kernel
def find_route(graph, origin, goals, number, visits, entries):
    """Find the cheapest route from a free cell to the cheapest of several free goals.

    The search's number must be larger than any that wrote into ``visits.mark``.

    Returns:
        The goal that was reached, -1 for none, NO_ROOM if there are too few entries for the open
        cells; and how many cells were expanded.
    """
    start, width, cell_size = graph.layout.start, graph.layout.width, graph.layout.cell_size
    link_cell, link_start, link_target, link_length = graph.links
    moves, weight = graph.moves, graph.weight
    same_weight, least_weight, bucket = graph.same_weight, graph.least_weight, graph.bucket
    mark, cost, link_from = visits
    box = _goal_box(graph.layout, goals)
    entry_cell, entry_next = entries
    head, state = make_queue(graph.num_buckets)
    per_bucket, slack = 1.0 / bucket, 1e-9 * bucket  # a smaller gain is rounding
    mine = number * SEARCH
    best, reached, count = np.inf, np.int64(-1), 0
    for goal in goals:
        mark[goal] = mine | GOAL | NONE
        cost[goal] = np.inf
        if goal == origin:
            return goal, count
    mark[origin], cost[origin] = mine | START, 0.0
    level = level_of(start, origin)
    first, columns, size = start[level], width[level], cell_size[level]
    row, col = divmod(origin - first, columns)
    at = np.int64(_lower_bound(row, col, box[level], size * least_weight) * per_bucket)
    push(head, state, entry_cell, entry_next, at, origin)
    while state[OPEN] > 0:
        cell = pop(head, state, entry_cell, entry_next, at)
        if cell < 0:
            at += 1
            # All that is still open costs as much as this bucket at least. A goal counts only
            # now, as a cheaper way to it may have been in the bucket that it was found in.
            if at * bucket >= best:
                break
            continue
        if mark[cell] & (CLOSED | GOAL):  # over a goal, no other is cheaper
            continue
        mark[cell] |= CLOSED
        count += 1
        here, ways = cost[cell], moves[cell]
        if cell < first or cell >= start[level + 1]:
            level = level_of(start, cell)
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
                r, c, on = row + ROW_STEP[way], col + COL_STEP[way], level
                target = cell + ROW_STEP[way] * columns + COL_STEP[way]
                length = size if way < 4 else size * DIAGONAL
            else:
                link = link_start[slot] + way - 8
                target, length = link_target[link], link_length[link]
                if not math.isfinite(weight[target]):
                    continue
                on = level_of(start, target)
                r, c = divmod(target - start[on], width[on])
            price = same_weight if same_weight > 0.0 else weight[target]
            there = here + length * price
            goal = 0
            if mark[target] >= mine:  # no search has a larger number
                if there >= cost[target] - slack:
                    continue
                goal = mark[target] & GOAL
            if way >= 8:
                link_from[find_slot(link_cell, target)] = cell
            # without CLOSED: a cell that got cheaper is expanded again
            mark[target], cost[target] = mine | goal | (way if way < 8 else LINK), there
            if goal and there < best:
                best, reached = there, target
            total = there + _lower_bound(r, c, box[on], cell_size[on] * least_weight)
            push(head, state, entry_cell, entry_next, max(np.int64(total * per_bucket), at), target)
    return reached, count


@kernel
def trace_route(layout, links, visits, reached):
    """The flat ids of the route that a search has found, from its origin to the goal."""
    route = np.empty(256, np.int64)
    count, cell = 0, np.int64(reached)
    while True:
        if count == route.shape[0]:
            route = np.append(route, np.empty_like(route))
        route[count] = cell
        count += 1
        way = visits.mark[cell] & WAY
        if way in (START, NONE):
            break
        if way == LINK:
            cell = visits.link_from[find_slot(links.cell, cell)]
        else:
            cell -= ROW_STEP[way] * layout.width[level_of(layout.start, cell)] + COL_STEP[way]
    return route[:count][::-1].copy()
