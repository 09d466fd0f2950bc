"""Which surfaces are on which level, block by block: counts of heights, and places.

Surfaces are placed by aligning two ordered lists, a column's surfaces and the levels, with dynamic
programming (Needleman and Wunsch, 1970). `climb` relaxes the edges of an acyclic graph in
topological order, which is that of height.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.tiles import BLOCK, block_window
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.label_kernels import bin_of, note_row
from navbake.baker.floors.member_kernels import region_of, shrink
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Bool, Int32

# What it costs to move a stair's tread, or a floor, by one level, and to take it out of the order:
# a tread moves rather than a floor, and leaves the order rather than a floor moves
MOVE_STAIR = 1
MOVE_FLOOR = 10_000
SKIP_STAIR = 100
SKIP_FLOOR = 10_000_000
# In place of a window's number: none; all windows; the lowest of each column, stairs included
NO_WINDOW = -(1 << 62)
EVERY = -(1 << 61)
LOWEST = -(1 << 60)
# In place of the level of a surface that found all levels taken, and the same at a ground's height
LOST = -2
LOST_GROUND = -3


class Candidates(NamedTuple):
    """The surfaces that levels are made of.

    Attributes:
        key: of each surface, 0 if it is a candidate, else -1, int8.
        plateau: of each, the number of its plateau, int32; empty if no column has two.
        is_stair: which plateaus are parts of stairs, bool.
    """

    key: NDArray[np.int8]
    plateau: Int32
    is_stair: Bool


class HeightWindow(NamedTuple):
    """Which heights `list_heights` counts.

    Attributes:
        ground: floors over others count from here on; the lowest of each column if it is -inf [m].
        number: of the window, EVERY or LOWEST.
        half_step: half of a window's height [m].
        top: from here on nothing counts [m].
    """

    ground: float
    number: int
    half_step: float
    top: float = math.inf


@subkernel(inline="always")
def _is_stair(candidates, j):
    if candidates.plateau.shape[0] == 0:
        return False
    return candidates.is_stair[candidates.plateau[j]]


@kernel(nogil=True, **NO_REFCOUNT)
def mark_candidates(labelled, spans, key, stacked, begin, end):
    """Mark the labelled surfaces in the blocks from `begin` to `end` that lie in a span of heights.

    Args:
        spans: (n, 2) float64, see `given_spans`; if there are none, all are marked.
        key: of each surface, receives 0 if it is marked, -1 if it isn't.
        stacked: of each block, receives whether two lie in one cell.
    """
    surfaces = labelled.surfaces
    lattice = labelled.surfaces.lattice
    for block in range(begin, end):
        row0, row1, col0, col1 = block_window(lattice, block)
        stacked[block] = False
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                count = 0
                for j in range(surfaces.first[cell], surfaces.end[cell]):
                    key[j] = -1
                    if region_of(labelled, j) < 0:
                        continue
                    is_in_span = spans.shape[0] == 0
                    for s in range(spans.shape[0]):
                        if spans[s, 0] <= surfaces.z[j] < spans[s, 1]:
                            is_in_span = True
                    if is_in_span:
                        key[j] = 0
                        count += 1
                if count > 1:
                    stacked[block] = True


@subkernel(inline="always")
def _window_of(surfaces, candidates, j, window, is_lowest):
    """The window in which `list_heights` counts a candidate, or NO_WINDOW."""
    if is_lowest != (window.ground == -math.inf):
        return NO_WINDOW
    if window.number == LOWEST:
        return LOWEST
    number = np.int64(math.floor(surfaces.z[j] / window.half_step))
    is_in = window.number == EVERY or window.number <= number <= window.number + 1
    return number if is_in and not _is_stair(candidates, j) else NO_WINDOW


@subkernel(**NO_REFCOUNT)
def _list_block(surfaces, candidates, window, test, block, masks, columns, num):
    """`list_heights` of one block; returns how many rows there are then, -1 for no room."""
    rows, low = columns
    reach = test.radius
    before = num
    lattice = surfaces.lattice
    row0, row1, col0, col1 = block_window(lattice, block)
    mask, left = masks
    # the window's cells are marked, with a margin, before those that shrinking leaves are counted
    for marks in (True, False):
        if marks and reach == 0:
            continue
        if not marks and reach > 0:
            shrink(mask, test, left)
        margin = reach if marks else 0
        for row in range(max(row0 - margin, 0), min(row1 + margin, lattice.height)):
            for col in range(max(col0 - margin, 0), min(col1 + margin, lattice.width)):
                if not marks and reach > 0 and not left[row - row0, col - col0]:
                    continue
                is_lowest = True
                cell = row * lattice.width + col
                for j in range(surfaces.first[cell], surfaces.end[cell]):
                    if candidates.key[j] < 0:
                        continue
                    z = surfaces.z[j]
                    if z >= window.top or (window.ground == -math.inf and not is_lowest):
                        break
                    if z < window.ground - LIMIT_SLACK:
                        continue
                    number = _window_of(surfaces, candidates, j, window, is_lowest)
                    is_lowest = False
                    if number == NO_WINDOW:
                        continue
                    if marks:
                        mask[row - row0 + reach, col - col0 + reach] = 1
                        continue
                    at = note_row(rows, before, num, number, bin_of(z), 0)
                    if at < 0:
                        return at
                    low[at] = min(low[at], z) if at < num else z
                    num = max(num, at + 1)
    return num


@kernel(nogil=True)
def list_heights(surfaces, candidates, window, test, blocks, counts, columns, begin, end):
    """Count floors by their heights, in ``blocks[begin:end]``, as far as shrinking leaves them.

    Floors are the candidates, without stairs, that lie over another one at or above the ground
    in their column; over a ground of -inf, the lowest of their columns. Window n reaches from
    ``n * half_step`` to ``(n + 1) * half_step``; one window counts together with the one above it,
    and their cells are shrunk together, by the disc of `test`.

    The rows, see `list_rows`: the number of a window, the multiple of PLATEAU,
    0, and how many; with the lowest of these heights [m].
    """
    num = np.int64(0)
    size = BLOCK + 2 * test.radius
    for k in range(begin, end):
        masks = np.zeros((size, size), np.int32), np.empty((BLOCK, BLOCK), np.bool_)
        after = _list_block(surfaces, candidates, window, test, blocks[k], masks, columns, num)
        if after < 0:
            return k
        counts[k] = after - num
        num = after
    return end


@subkernel(**NO_REFCOUNT)
def _place_bases(surfaces, candidates, grounds, tolerance, cell, level):
    """Give a cell's candidates their bases; returns their number if two share one, else 0."""
    count = 0
    base = 0
    is_shared = False
    for j in range(surfaces.first[cell], surfaces.end[cell]):
        level[j] = -1
        if candidates.key[j] < 0:
            continue
        before = base if count > 0 else -1
        z = surfaces.z[j]
        while base + 1 < grounds.shape[0] and grounds[base + 1] - tolerance <= z:
            base += 1
        level[j] = base
        count = count + 1
        is_shared = is_shared or base == before
    return count if is_shared else 0


@kernel(nogil=True)
def place_blocks(surfaces, candidates, rule, own, blocks, counts, columns, begin, end):
    """Give each candidate in ``blocks[begin:end]`` its level; no two of a column share one.

    A surface's base is the highest ground at or below it. Where all bases of a column differ, they
    are the levels. Elsewhere the surfaces of a column are placed in their order, moved as little
    as possible, up rather than down, and treads rather than floors. A tread that could fit only by
    moving a floor takes the free level nearest its base; on a tie, the upper.

    The rows, see `list_rows`: a part of a region, 0, a level, and how many of
    its surfaces are there; with the lowest of their heights [m].

    Args:
        rule: the grounds' heights, ascending [m]; how far below a ground its floors may lie [m];
            and whether columns with more surfaces than levels leave out floors, the lower ones
            first, rather than treads.
        own: the part of each surface; and receives its level, LOST or LOST_GROUND where all are
            taken, -1 where it is no candidate, (n,) int32.
    """
    grounds, tolerance, leave_floors = rule
    part, level = own
    rows, low = columns
    num = np.int64(0)
    lattice = surfaces.lattice
    for k in range(begin, end):
        before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                count = _place_bases(surfaces, candidates, grounds, tolerance, cell, level)
                if count > 0:
                    _place_column(surfaces, candidates, grounds, leave_floors, cell, level, count)
                for j in range(surfaces.first[cell], surfaces.end[cell]):
                    if level[j] == -1:
                        continue
                    at = note_row(rows, before, num, part[j], 0, level[j])
                    if at < 0:
                        return k
                    z = surfaces.z[j]
                    low[at] = min(low[at], z) if at < num else z
                    num = max(num, at + 1)
        counts[k] = num - before
    return end


@subkernel
def _place_column(surfaces, candidates, grounds, leave_floors, cell, level, count):
    """Replace the levels of a cell's candidates, which are their bases."""
    num_levels = grounds.shape[0]
    num = 0
    places = np.empty(count, np.int64)
    base = np.empty(count, np.int64)
    found = np.empty(count, np.int64)
    cost = np.empty((2, count), np.int64)
    leave_floors = leave_floors and count > num_levels
    for j in range(surfaces.first[cell], surfaces.end[cell]):
        if candidates.key[j] >= 0:
            is_stair = _is_stair(candidates, j)
            places[num] = j
            base[num] = level[j]
            cost[0, num] = MOVE_STAIR if is_stair or leave_floors else MOVE_FLOOR
            cost[1, num] = SKIP_STAIR if is_stair != leave_floors else SKIP_FLOOR
            cost[1, num] += num if leave_floors else 0
            num += 1
    _align(base, cost, num_levels, found)
    taken = np.zeros(num_levels, np.bool_)
    for n in range(count):
        if found[n] >= 0:
            taken[found[n]] = True
    for n in range(count):
        for away in range(1, num_levels):
            for near in (base[n] + away, base[n] - away):
                if found[n] < 0 and 0 <= near < num_levels and not taken[near]:
                    found[n] = near
                    taken[near] = True
        level[places[n]] = found[n] if found[n] >= 0 else LOST
        for ground in grounds:
            if found[n] < 0 and abs(surfaces.z[places[n]] - ground) <= LIMIT_SLACK:
                level[places[n]] = LOST_GROUND


@subkernel
def _align(base, costs, num_levels, level):
    """Align a column's surfaces with the levels; -1 for those out of order.

    `costs` are those of moving each by one level, and of taking it out of the order.
    """
    count = base.shape[0]
    # cost[i, k]: of the first i surfaces on the first k levels
    cost = np.zeros((count + 1, num_levels + 1), np.int64)
    for i in range(1, count + 1):
        move = costs[0, i - 1]
        skip = costs[1, i - 1]
        cost[i, 0] = cost[i - 1, 0] + skip
        for k in range(1, num_levels + 1):
            placed = cost[i - 1, k - 1] + move * abs(k - 1 - base[i - 1])
            cost[i, k] = min(placed, cost[i, k - 1], cost[i - 1, k] + skip)
    # back from the top: at equal costs the upper surface is left out, not the lower one, and the
    # upper one moves up rather than the lower one down
    i = count
    k = num_levels
    while i > 0:
        move = costs[0, i - 1]
        skip = costs[1, i - 1]
        if cost[i, k] == cost[i - 1, k] + skip:
            level[i - 1] = -1
            i -= 1
        elif cost[i, k] == cost[i - 1, k - 1] + move * abs(k - 1 - base[i - 1]):
            level[i - 1] = k - 1
            i -= 1
            k -= 1
        else:
            k -= 1


@kernel
def climb(lower, upper, area, by_lower, by_upper):
    """The largest floors that each part reaches going only up, or only down.

    Args:
        lower, upper: the parts that each step joins, (steps,) int64.
        area: of the floor that each part belongs to, (parts,) int64.
        by_lower, by_upper: the steps in the order of the heights of these parts, (steps,) int64.

    Returns:
        The largest area above each part, and below it, 0 for none, (parts,) int64.
    """
    above = np.zeros_like(area)
    below = np.zeros_like(area)
    # steps up from a part begin higher than steps to it, so they come first
    for s in by_lower[::-1]:
        a = lower[s]
        b = upper[s]
        above[a] = max(above[a], area[b], above[b])
    for s in by_upper:
        a = lower[s]
        b = upper[s]
        below[b] = max(below[b], area[a], below[a])
    return above, below
