"""Places of surfaces on levels, and what one gets to by going only up or only down.

Places are an alignment of two ordered lists, a column's surfaces and the levels, by dynamic
programming (Needleman and Wunsch, 1970). Climbs are longest paths of a directed graph without
circles, edge by edge in the order of height.
"""

import numpy as np

from navbake.compiled import kernel, part

# What it costs to move a stair's tread, or a floor, by one level, and to leave it out of order.
# A tread moves rather than a floor, and is out of order rather than a floor moves.
MOVE_STAIR, MOVE_FLOOR, SKIP_STAIR, SKIP_FLOOR = 1, 10_000, 100, 10_000_000


@kernel(nogil=True)
def place_on_levels(start, base, is_stair, num_levels, level):
    """Give each surface its level, so that no two of a column share one.

    Where all base levels of a column differ, they are the levels. Elsewhere the surfaces of a
    column are placed in their order, moved as little as possible, up rather than down, and
    treads rather than floors. A tread for which only a floor would have to move goes to the free
    level nearest to its base, the upper of two.

    Args:
        start: first surface of each column, (cells + 1,) int64; surfaces ascend in a column.
        base: the level of the highest ground at or below each surface, (n,) int64.
        is_stair: which surfaces are parts of stairs, (n,) bool.
        num_levels: how many levels there are.
        level: (n,) int64; receives the level of each, -1 where all levels are taken.
    """
    taken = np.zeros(num_levels, np.bool_)
    for cell in range(start.shape[0] - 1):
        first, last = start[cell], start[cell + 1]
        in_order = True
        for i in range(first, last):
            level[i] = base[i]
            if i > first and base[i] == base[i - 1]:
                in_order = False
        if in_order:
            continue
        _align(first, last, base, is_stair, num_levels, level)
        taken[:] = False
        for i in range(first, last):
            if level[i] >= 0:
                taken[level[i]] = True
        for i in range(first, last):
            if level[i] < 0:
                level[i] = _nearest_free(taken, base[i])
                if level[i] >= 0:
                    taken[level[i]] = True


@part
def _align(first, last, base, is_stair, num_levels, level):
    """Place the surfaces of a column in their order; -1 for those that are left out of it."""
    count = last - first
    # cost[i, k]: of the first i surfaces on the first k levels
    cost = np.zeros((count + 1, num_levels + 1), np.int64)
    for i in range(1, count + 1):
        surface = first + i - 1
        move = MOVE_STAIR if is_stair[surface] else MOVE_FLOOR
        skip = SKIP_STAIR if is_stair[surface] else SKIP_FLOOR
        cost[i, 0] = cost[i - 1, 0] + skip
        for k in range(1, num_levels + 1):
            placed = cost[i - 1, k - 1] + move * abs(k - 1 - base[surface])
            cost[i, k] = min(placed, cost[i, k - 1], cost[i - 1, k] + skip)
    # back from the top: of equal costs, rather the upper one is left out than the lower one, and
    # rather the upper one moves up than the lower one down
    i, k = count, num_levels
    while i > 0:
        surface = first + i - 1
        move = MOVE_STAIR if is_stair[surface] else MOVE_FLOOR
        skip = SKIP_STAIR if is_stair[surface] else SKIP_FLOOR
        if cost[i, k] == cost[i - 1, k] + skip:
            level[surface] = -1
            i -= 1
        elif cost[i, k] == cost[i - 1, k - 1] + move * abs(k - 1 - base[surface]):
            level[surface] = k - 1
            i -= 1
            k -= 1
        else:
            k -= 1


@part
def _nearest_free(taken, base):
    """The level nearest to a base that is not taken, the upper of two; -1 if there is none."""
    for away in range(1, taken.shape[0]):
        if base + away < taken.shape[0] and not taken[base + away]:
            return base + away
        if base - away >= 0 and not taken[base - away]:
            return base - away
    return -1


@kernel
def climb(lower, upper, area, by_lower, by_upper):
    """The largest floors that one gets to from each part of a walk, going only up or only down.

    Args:
        lower, upper: the parts that each step joins, (steps,) int64.
        area: of the floor that each part belongs to, (parts,) int64.
        by_lower: the steps in the order of the heights of their lower parts, (steps,) int64.
        by_upper: likewise of their upper parts.

    Returns:
        The largest area above each part, and below it, 0 for none, (parts,) int64.
    """
    above, below = np.zeros_like(area), np.zeros_like(area)
    # what is above a part is known before a step leads up to it, as those steps begin lower
    for s in by_lower[::-1]:
        a, b = lower[s], upper[s]
        above[a] = max(above[a], area[b], above[b])
    for s in by_upper:
        a, b = lower[s], upper[s]
        below[b] = max(below[b], area[a], below[a])
    return above, below
