"""The steps of a grid, the cheapest route over them, and what the routes from all cells cost.

`find_route` is A* (Hart, Nilsson and Raphael 1968), and without a goal Dijkstra's algorithm (1959).
A step costs its length [m] times the weight of the cell that it leads to. What is left to the goals
is estimated by the octile distance to the box round them times the smallest weight, which is never
too much, so the answer is the cheapest route. On another level the same estimate holds along x and
y, since a step to it costs at least what it covers there. A passage over a link may cost less. So
the search goes on, once a goal is reached, by as much as links may save on the way to it: an
estimate that is too high by at most that leaves the answer exact (Harris 1974, the bandwidth
condition).

The queue has buckets (Dial 1969), each as wide as a share of the cheapest step, whose cells come
out in any order: the "untidy" priority queue of Yatziv, Bartesaghi and Sapiro (2006). Unlike there,
the answer stays exact, because a cell that gets cheaper after it was taken out is put in again
(label correcting). The buckets are used in a circle, which is long enough for the dearest step.
Each is a linked stack; freed entries are reused, so the queue stays in the processor's cache.
"""

import math

import numpy as np

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import (
    COL_STEP,
    DIAGONAL,
    EAST,
    NORTH,
    ROW_STEP,
    SOUTH,
    WEST,
    center,
    find_slot,
    in_cells,
    level_of,
)

BESIDE = np.array([0, 0, 0, 0, EAST | NORTH, NORTH | WEST, WEST | SOUTH, SOUTH | EAST])  # a corner
SHARE = 0.5  # of the cheapest step that a bucket is wide: up to 1, few cells are expanded twice
MAX_BUCKETS = 1 << 16
# first entry to use again, entries ever used, entries in the queue
SPARE = 0
USED = 1
OPEN = 2

# The bits of a cell's `mark`:
#   0 to 3   the way it was reached: a direction, START, LINK or NONE
#   4        whether it is a goal
#   5        whether it was expanded
#   6 on     the number of the search that wrote it, so that nothing is cleared between searches
WAY = 15
GOAL = 16
CLOSED = 32
SEARCH = 64
START = 8
LINK = 9
NONE = 15
# what comes of a search
DONE = 0
NO_ROOM = 1


@kernel
def find_moves(free, diagonal, floors, slopes, cut, layout, level, window, moves):
    """Write the moves of a window of a level: rows and columns, the last ones excluded.

    A move leads to a free neighbour whose floor differs by at most `max_step`, or more on a slope,
    see `navbake.runtime.flat_grid.FlatGrid`. A diagonal one also needs both cells beside it, and
    steps over either of them, and clearance (`diagonal`, by cell) at both its ends, unless corners
    may be `cut`.
    """
    floor = floors.z
    max_step = floors.max_step
    first = layout.start[level]
    width = layout.width[level]
    height = layout.height[level]
    row0, row1, col0, col1 = window
    for row in range(max(row0, 0), min(row1, height)):
        for col in range(max(col0, 0), min(col1, width)):
            cell = first + row * width + col
            found = 0
            for way in range(8 if free[cell] else 0):
                down = ROW_STEP[way] * width
                across = COL_STEP[way]
                if not (0 <= row + ROW_STEP[way] < height and 0 <= col + across < width):
                    continue
                one = cell + across
                other = cell + down
                target = cell + down + across
                is_steep = False
                if way >= 4:
                    if not free[target]:
                        continue
                    is_steep = abs(floor[cell] - floor[target]) > max_step
                    # A diagonal on a slope is as good as the steps over its corners: some edge of
                    # these must be more than a step.
                    if is_steep and not (
                        slopes.shape[0] > 0
                        and (
                            abs(floor[cell] - floor[one]) > max_step
                            or abs(floor[cell] - floor[other]) > max_step
                            or abs(floor[one] - floor[target]) > max_step
                            or abs(floor[other] - floor[target]) > max_step
                        )
                    ):
                        continue
                elif not _joined(cell, target, free, floor, max_step, slopes):
                    continue
                # the four cells of a corner must be connected: `found` has the two edges of this
                # cell already, the last two tests are about those of the target
                if (way < 4 or (cut and not is_steep)) or (
                    found & BESIDE[way] == BESIDE[way]
                    and (cut or (diagonal[cell] and diagonal[target]))
                    and _joined(one, target, free, floor, max_step, slopes)
                    and _joined(other, target, free, floor, max_step, slopes)
                ):
                    found |= 1 << way
            moves[cell] = found


@subkernel
def _joined(a, b, free, floor, max_step, slopes):
    if not free[b]:
        return False
    if not abs(floor[a] - floor[b]) > max_step:  # so that NaN, no floor, is no step
        return True
    if slopes.shape[0] == 0:
        return False
    bit = EAST if abs(a - b) == 1 else SOUTH
    return slopes[min(a, b)] & bit != 0


def bucket_width(
    size: float, least: float, most: float, longest_link: float, dearest: float = 0.0
) -> tuple[float, int]:
    """Return the width of a bucket, a cost [m], and the number of buckets, a power of two.

    A bucket is `SHARE` of the cheapest step wide, wider where that would take over `MAX_BUCKETS`.
    `size` is the smallest cell's edge [m], `least` and `most` bound the weights of cells, `dearest`
    is the cost of the dearest passage, with what the estimate may rise over it.
    """
    # from a bucket to a new entry
    farthest = max(2.0 * most * max(DIAGONAL * size, longest_link), dearest)
    width = max(SHARE * size * least, farthest / (MAX_BUCKETS - 4))
    if not width > 0.0:  # all steps are free of cost: one bucket holds everything
        return 1.0, 4
    count = 4
    while count < farthest / width + 3:
        count *= 2
    return width, count


@subkernel
def _push(head, state, entry_cell, entry_next, bucket, cell):
    """Put a cell into a bucket; the caller has checked that an entry is left."""
    slot = bucket & (head.shape[0] - 1)  # the remainder, as the number is a power of two
    entry = state[SPARE]
    if entry >= 0:
        state[SPARE] = entry_next[entry]
    else:
        entry = state[USED]
        state[USED] += 1
    entry_cell[entry] = cell
    entry_next[entry] = head[slot]
    head[slot] = entry
    state[OPEN] += 1


@subkernel
def _lower_bound(row, col, box, scale):
    """What a route from a cell to the goals' box costs at least: the octile distance."""
    a = max(box[0] - row, row - box[1], 0.0)
    b = max(box[2] - col, col - box[3], 0.0)
    return scale * (max(a, b) + (DIAGONAL - 1.0) * min(a, b))


@kernel
def find_route(graph, sources, goals, number, visits):
    """Find the cheapest route from a source to a goal; all are free cells, no source is a goal.

    Without goals all cells are reached, and a step is taken backwards, as links must be turned
    round for: then ``visits.cost`` is what the route from a cell to the nearest source costs. The
    search's number must be larger than any that wrote into ``visits.mark``.

    Returns DONE, or NO_ROOM if there are too few entries for the open cells; and the route's flat
    ids from source to goal, none where there is no route.
    """
    layout = graph.layout
    route = np.empty(256, np.int64)
    start = layout.start
    width = layout.width
    cell_size = layout.cell_size
    link_cell, link_start, link_target, link_length, link_cost, is_end = graph.links
    moves = graph.moves
    weight = graph.weight
    same_weight = graph.same_weight
    least_weight = graph.least_weight
    bucket = graph.bucket
    mark, cost, link_from, entry_cell, entry_next = visits
    head = np.full(graph.num_buckets, -1, np.int32)
    state = np.array([-1, 0, 0])
    last_slot = head.shape[0] - 1
    # a smaller gain is rounding
    per_bucket = 1.0 / bucket
    slack = 1e-9 * bucket
    mine = number * SEARCH
    has_goals = goals.shape[0] > 0
    best = np.inf
    reached = np.int64(-1)
    x0 = np.inf
    x1 = -np.inf
    y0 = np.inf
    y1 = -np.inf
    for goal in goals:
        mark[goal] = mine | GOAL | NONE
        cost[goal] = np.inf
        x, y = center(layout, goal)
        x0 = min(x0, x)
        x1 = max(x1, x)
        y0 = min(y0, y)
        y1 = max(y1, y)
    # the box round the goals by level: first and last row, first and last column
    box = np.empty((width.shape[0], 4))
    for level in range(width.shape[0]):
        left, top = in_cells(layout, level, x0, y1)
        right, bottom = in_cells(layout, level, x1, y0)
        box[level, 0] = top - 0.5
        box[level, 1] = bottom - 0.5
        box[level, 2] = left - 0.5
        box[level, 3] = right - 0.5
    at = np.int64(0)
    for source in sources:
        if state[USED] == entry_cell.shape[0]:
            return NO_ROOM, route[:0]
        if mark[source] < mine:  # a source may be given twice
            mark[source] = mine | START
            cost[source] = 0.0
            if has_goals:
                level = level_of(start, source)
                row, col = divmod(source - start[level], width[level])
                bound = _lower_bound(row, col, box[level], cell_size[level] * least_weight)
                at = np.int64(bound * per_bucket)
            _push(head, state, entry_cell, entry_next, at, source)
    level = 0
    first = start[0]
    columns = width[0]
    size = cell_size[0]
    while state[OPEN] > 0:
        entry = head[at & last_slot]
        if entry < 0:
            at += 1
            # All that is still open costs as much as this bucket at least. A goal counts only
            # now, as a cheaper way to it may have been in the bucket that it was found in.
            if at * bucket >= best + graph.lead:
                break
            continue
        head[at & last_slot] = entry_next[entry]
        entry_next[entry] = state[SPARE]
        state[SPARE] = entry
        state[OPEN] -= 1
        cell = np.int64(entry_cell[entry])
        if mark[cell] & (CLOSED | GOAL):  # over a goal, no other is cheaper
            continue
        mark[cell] |= CLOSED
        here = cost[cell]
        ways = moves[cell]
        if cell < first or cell >= start[level + 1]:
            level = level_of(start, cell)
            first = start[level]
            columns = width[level]
            size = cell_size[level]
        slot = find_slot(link_cell, cell) if is_end.shape[0] > 0 and is_end[cell] else -1
        num_links = 0 if slot < 0 else link_start[slot + 1] - link_start[slot]
        if state[USED] + 8 + num_links > entry_cell.shape[0]:
            return NO_ROOM, route[:0]
        row, col = divmod(cell - first, columns) if has_goals else (np.int64(0), np.int64(0))
        for way in range(8 + num_links):
            r = row
            c = col
            on = level
            extra = 0.0
            if way < 8:
                if not (ways >> way) & 1:
                    continue
                r = row + ROW_STEP[way]
                c = col + COL_STEP[way]
                target = cell + ROW_STEP[way] * columns + COL_STEP[way]
                length = size if way < 4 else size * DIAGONAL
            else:
                link = link_start[slot] + way - 8
                target = link_target[link]
                length = link_length[link]
                extra = link_cost[link]
                if not math.isfinite(weight[target]):
                    continue
                if has_goals:
                    on = level_of(start, target)
                    r, c = divmod(target - start[on], width[on])
            # Backwards, the step that is added leads into this cell. Steps lead both ways, so the
            # moves out of a cell are those into it; links are given turned round.
            price = same_weight
            if same_weight <= 0.0:
                # most neighbours are known by ways that the smallest weight can't beat
                if mark[target] >= mine and here + length * least_weight >= cost[target] - slack:
                    continue
                price = weight[target if has_goals else cell]
            total = there = here + length * price + extra
            goal = 0
            if mark[target] >= mine:  # no search has a larger number
                if there >= cost[target] - slack:
                    continue
                goal = mark[target] & GOAL
            if way >= 8:
                link_from[find_slot(link_cell, target)] = cell
            # without CLOSED: a cell that got cheaper is expanded again
            mark[target] = mine | goal | (way if way < 8 else LINK)
            cost[target] = there
            if goal and there < best:
                best = there
                reached = target
            if has_goals:
                total += _lower_bound(r, c, box[on], cell_size[on] * least_weight)
            bucket_at = max(np.int64(total * per_bucket), at)
            _push(head, state, entry_cell, entry_next, bucket_at, target)
    count = 0
    cell = reached
    while cell >= 0:  # back along the ways that the cells were reached by
        if count == route.shape[0]:
            route = np.append(route, np.empty_like(route))
        route[count] = cell
        count += 1
        way = mark[cell] & WAY
        if way == START:
            break
        if way == LINK:
            cell = link_from[find_slot(link_cell, cell)]
        else:
            cell -= ROW_STEP[way] * width[level_of(start, cell)] + COL_STEP[way]
    return DONE, route[:count][::-1].copy()
