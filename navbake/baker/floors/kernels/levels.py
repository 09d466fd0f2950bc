"""Which surfaces are on which level, block by block: what is measured of heights, and places.

Places are an alignment of two ordered lists, a column's surfaces and the levels, by dynamic
programming (Needleman and Wunsch, 1970). Climbs are longest paths of a directed graph without
circles, edge by edge in the order of height.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.floors.kernels.labels import double
from navbake.baker.floors.kernels.members import is_left, sheet_of
from navbake.baker.kernels.blocks import block_of, block_window
from navbake.baker.kernels.constants import SLACK
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Bool, Int, Int32

# What it costs to move a stair's tread, or a floor, by one level, and to leave it out of order.
# A tread moves rather than a floor, and is out of order rather than a floor moves.
MOVE_STAIR, MOVE_FLOOR, SKIP_STAIR, SKIP_FLOOR = 1, 10_000, 100, 10_000_000
# Floors whose heights round to the same multiple of this are one plateau [m]
PLATEAU = 0.02
# In place of the number of a window: any height
ANY_WINDOW = np.int64(-(1 << 62))


class Kept(NamedTuple):
    """The surfaces that levels are made of.

    Attributes:
        key: 0 for those that are kept, -1 for all others, by place, int32.
        plateau: the number of each one's plateau in its block, int32; empty if no column has two.
        offset: the number of each block's first plateau, int64.
        is_stair: which plateaus are parts of stairs, bool.
    """

    key: Int32
    plateau: Int32
    offset: Int
    is_stair: Bool


class HeightWindow(NamedTuple):
    """Which floors are measured: see `count_windows` and `measure_window`.

    Attributes:
        ground: the ground that they lie over, -inf for none [m].
        window: a number, or ANY_WINDOW.
        half: the height of a window [m].
    """

    ground: float
    window: int
    half: float


@part(inline="always")
def _is_stair(kept, block, j):
    """Whether a surface in a block is a part of a stair."""
    if kept.plateau.shape[0] == 0:
        return False
    return kept.is_stair[kept.offset[block] + kept.plateau[j]]


@part(inline="always")
def bin_of(z):
    """The multiple of PLATEAU that a height rounds to."""
    return np.int64(np.rint(z / PLATEAU))


@kernel(nogil=True, **UNCOUNTED)
def mark_kept(labelled, spans, key, blocks, stacked, begin, end):
    """Mark the labelled surfaces in ``blocks[begin:end]`` that lie in any span of heights.

    Args:
        spans: (n, 2) float64, see `given_spans`; all surfaces are kept where there are none.
        key: receives 0 for those that are kept, -1 for the others.
        stacked: by block, receives whether two lie in one cell.
    """
    lattice = labelled.lattice
    for k in range(begin, end):
        block = blocks[k]
        row0, row1, col0, col1 = block_window(lattice, block)
        stacked[block] = False
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                count = 0
                for j in range(labelled.first[cell], labelled.first[cell] + labelled.length[cell]):
                    key[j] = -1
                    if sheet_of(labelled, block, j) < 0:
                        continue
                    is_kept = spans.shape[0] == 0
                    for s in range(spans.shape[0]):
                        if spans[s, 0] <= labelled.z[j] < spans[s, 1]:
                            is_kept = True
                    if is_kept:
                        key[j] = 0
                        count += 1
                if count > 1:
                    stacked[block] = True


@part(**UNCOUNTED)
def _measure_plateaus(surfaces, plateau, part, window, width, low, of_part, rows, num, last):
    """See `measure_plateaus`; of one block. Returns how many rows there are then, -1 for no room.

    `last`, -1 at first, receives the last row of each plateau.
    """
    row0, row1, col0, col1 = window
    for row in range(row0, row1):
        for cell in range(row * width + col0, row * width + col1):
            for j in range(surfaces.first[cell], surfaces.first[cell] + surfaces.length[cell]):
                own = plateau[j]
                if own < 0:
                    continue
                z = surfaces.z[j]
                number = bin_of(z)
                if last[own] < 0:
                    low[own], of_part[own] = z, part[j]
                low[own] = min(low[own], z)
                if last[own] < 0 or rows[last[own], 1] != number:
                    if num == rows.shape[0]:
                        return np.int64(-1)
                    rows[num, 0], rows[num, 1], rows[num, 2] = own, number, 0
                    last[own] = num
                    num += 1
                rows[last[own], 2] += 1
    return num


@kernel(nogil=True)
def measure_plateaus(lattice, surfaces, plateau, part, blocks, offset, low, of_part, begin, end):
    """Measure the plateaus in ``blocks[begin:end]``; block k's begin at ``offset[k]``.

    `low` receives the lowest height of each [m], `of_part` the part of a sheet that it belongs to.
    Returns how many rows each block has, and the rows, int64: plateau, the multiple of PLATEAU, and
    how many surfaces have about that height. Rows may repeat.
    """
    counts, num = np.zeros(end - begin, np.int64), np.int64(0)
    rows = np.empty((64, 3), np.int64)
    for k in range(begin, end):
        before, num, own = num, np.int64(-1), slice(offset[k], offset[k + 1])
        while num < 0:
            last = np.full(offset[k + 1] - offset[k], np.int64(-1))
            num = _measure_plateaus(
                surfaces, plateau, part, block_window(lattice, blocks[k]), lattice.width,
                low[own], of_part[own], rows, before, last,
            )  # fmt: skip
            if num < 0:
                rows = double(rows)
        counts[k - begin] = num - before
    return counts, rows[:num].copy()


@part(inline="always")
def _takes(surfaces, kept, block, cell, j, ground):
    """Whether a kept surface is looked at for grounds above another one: see `count_windows`."""
    if kept.key[j] < 0 or surfaces.z[j] < ground - SLACK or _is_stair(kept, block, j):
        return False
    is_lowest = True
    for i in range(surfaces.first[cell], j):
        if kept.key[i] >= 0 and surfaces.z[i] >= ground - SLACK:
            is_lowest = False
    return is_lowest if ground == -math.inf else not is_lowest


@part(**UNCOUNTED)
def _count_windows(surfaces, kept, ground, half, block, window, width, rows, num):
    """See `count_windows`; of one block. Returns how many rows there are then, -1 for no room."""
    row0, row1, col0, col1 = window
    before = num
    for row in range(row0, row1):
        for cell in range(row * width + col0, row * width + col1):
            for j in range(surfaces.first[cell], surfaces.first[cell] + surfaces.length[cell]):
                if not _takes(surfaces, kept, block, cell, j, ground):
                    continue
                number = np.int64(math.floor(surfaces.z[j] / half))
                if num == before or rows[num - 1, 0] != number:
                    if num == rows.shape[0]:
                        return np.int64(-1)
                    rows[num, 0], rows[num, 1] = number, 0
                    num += 1
                rows[num - 1, 1] += 1
    return num


@kernel(nogil=True)
def count_windows(lattice, surfaces, kept, ground, half, blocks, begin, end):
    """Count the floors over a ground by windows of heights, in ``blocks[begin:end]``.

    Those are the kept surfaces, without stairs, that lie over another one at or above the ground
    in their column; over a ground of -inf, they are the lowest of their columns. Window n reaches
    from ``n * half`` to ``(n + 1) * half`` [m].

    Returns how many rows each block has, and the rows, int64: window and count; they may repeat.
    """
    counts, num = np.zeros(end - begin, np.int64), np.int64(0)
    rows = np.empty((64, 2), np.int64)
    for k in range(begin, end):
        before, num = num, np.int64(-1)
        while num < 0:
            window = block_window(lattice, blocks[k])
            num = _count_windows(
                surfaces, kept, ground, half, blocks[k], window, lattice.width, rows, before
            )
            if num < 0:
                rows = double(rows)
        counts[k - begin] = num - before
    return counts, rows[:num].copy()


@part(inline="always")
def _is_in_window(surfaces, kept, block, cell, j, heights):
    """Whether a surface is one that `count_windows` counts, in a window or the one above it."""
    if heights.window == ANY_WINDOW:
        return kept.key[j] >= 0 and _takes_lowest(surfaces, kept, cell, j)
    if not _takes(surfaces, kept, block, cell, j, heights.ground):
        return False
    number = np.int64(math.floor(surfaces.z[j] / heights.half))
    return heights.window <= number <= heights.window + 1


@part(inline="always")
def _takes_lowest(surfaces, kept, cell, j):
    """Whether a surface is the lowest that is kept in its cell."""
    for i in range(surfaces.first[cell], j):  # noqa: SIM110 (numba has no generators in `all`)
        if kept.key[i] >= 0:
            return False
    return True


@part(**UNCOUNTED)
def _mark_window(lattice, surfaces, kept, heights, reach, area, mask):
    """Mark the cells of an area, with a margin, that have floors in a window of heights."""
    row0, row1, col0, col1 = area
    for row in range(max(row0 - reach, 0), min(row1 + reach, lattice.height)):
        for col in range(max(col0 - reach, 0), min(col1 + reach, lattice.width)):
            cell, block = row * lattice.width + col, block_of(lattice, row, col)
            for j in range(surfaces.first[cell], surfaces.first[cell] + surfaces.length[cell]):
                if _is_in_window(surfaces, kept, block, cell, j, heights):
                    mask[row - row0 + reach, col - col0 + reach] = True


@part(**UNCOUNTED)
def _measure_left(lattice, surfaces, kept, heights, shrinking, block, mask, rows, low, num):
    """See `measure_window`; of one block. Returns how many rows there are then, -1 for no room."""
    row0, row1, col0, col1 = block_window(lattice, block)
    reach, disc, rim = shrinking.reach, shrinking.disc, shrinking.rim
    before, found = num, 0
    num += 1
    if num >= rows.shape[0]:
        return np.int64(-1)
    for row in range(row0, row1):
        follows = False
        for col in range(col0, col1):
            r, c = row - row0 + reach, col - col0 + reach
            follows = mask[r, c] and is_left(mask, r, c, rim if follows else disc)
            if not follows:
                continue
            found += 1
            cell = row * lattice.width + col
            for j in range(surfaces.first[cell], surfaces.first[cell] + surfaces.length[cell]):
                if not _is_in_window(surfaces, kept, block, cell, j, heights):
                    continue
                z = surfaces.z[j]
                number = bin_of(z)
                if num == before + 1 or rows[num - 1, 0] != number:
                    if num == rows.shape[0]:
                        return np.int64(-1)
                    rows[num, 0], rows[num, 1], low[num] = number, 0, z
                    num += 1
                rows[num - 1, 1] += 1
                low[num - 1] = min(low[num - 1], z)
    rows[before, 0], rows[before, 1], low[before] = ANY_WINDOW, found, math.inf
    return num


@kernel(nogil=True)
def measure_window(lattice, surfaces, kept, heights, shrinking, blocks, begin, end):
    """Measure the floors in a window and the one above it, as far as shrinking leaves them.

    Those are the floors that `count_windows` counts; with ANY_WINDOW, the lowest of all columns,
    stairs included.

    Returns how many rows each of ``blocks[begin:end]`` has; the rows, int64: the multiple of
    PLATEAU, and how many floors have about that height; and the lowest of these [m]. The cells that
    are left are the first row of each block. Rows may repeat.
    """
    reach = shrinking.reach
    counts, num = np.zeros(end - begin, np.int64), np.int64(0)
    rows, low = np.empty((64, 2), np.int64), np.empty(64)
    for k in range(begin, end):
        area = block_window(lattice, blocks[k])
        mask = np.zeros((area[1] - area[0] + 2 * reach, area[3] - area[2] + 2 * reach), np.bool_)
        _mark_window(lattice, surfaces, kept, heights, reach, area, mask)
        before, num = num, np.int64(-1)
        while num < 0:
            num = _measure_left(
                lattice, surfaces, kept, heights, shrinking, blocks[k], mask, rows, low, before
            )
            if num < 0:
                rows, low = double(rows), np.concatenate((low, low))
        counts[k - begin] = num - before
    return counts, rows[:num].copy(), low[:num].copy()


@part(inline="always")
def _base_of(grounds, tolerance, z):
    """The highest ground at or below a height, the lowest one for lower heights."""
    base = 0
    while base + 1 < grounds.shape[0] and grounds[base + 1] - tolerance <= z:
        base += 1
    return base


@part(**UNCOUNTED)
def _place_bases(surfaces, kept, grounds, tolerance, first, last, level):
    """Give the kept surfaces of a column their bases; how many they are.

    The number is less than 0 where two have the same base.
    """
    in_order, before, count = True, -1, 0
    for j in range(first, last):
        level[j] = -1
        if kept.key[j] < 0:
            continue
        base = _base_of(grounds, tolerance, surfaces.z[j])
        level[j] = base
        in_order = in_order and base != before
        before = base
        count += 1
    return count if in_order else -count


@part(**UNCOUNTED)
def _note_places(surfaces, grounds, level, first, last, used, lost):
    """Note which levels are used in a column, and which surfaces found no place; for a block."""
    for j in range(first, last):
        if level[j] >= 0:
            used[level[j]] = True
        elif level[j] == -2:
            lost[0] += 1.0
            is_ground = False
            for n in range(grounds.shape[0]):
                is_ground = is_ground or abs(surfaces.z[j] - grounds[n]) <= SLACK
            if not is_ground:
                lost[1] = min(lost[1], surfaces.z[j])


@kernel(nogil=True)
def place_blocks(lattice, surfaces, kept, grounds, tolerance, level, blocks, noted, begin, end):
    """Give each kept surface in ``blocks[begin:end]`` its level; no two of a column share one.

    A surface's base is the highest ground at or below it. Where all bases of a column differ, they
    are the levels. Elsewhere the surfaces of a column are placed in their order, moved as little
    as possible, up rather than down, and treads rather than floors. A tread for which only a floor
    would have to move goes to the free level nearest to its base, the upper of two.

    Args:
        grounds: heights, ascending [m].
        tolerance: how far below a ground its floors may lie [m].
        level: by place, int32; receives the levels, -2 where all are taken, -1 for surfaces that
            are not kept.
        noted: (blocks, levels) bool, receives which levels have surfaces; and (blocks, 2),
            receives how many surfaces found all levels taken, and the height of the lowest of
            these that is no ground, inf for none [m].
    """
    taken = np.zeros(grounds.shape[0], np.bool_)
    first, length = surfaces.first, surfaces.length
    for k in range(begin, end):
        block = blocks[k]
        own_used, own_lost = noted[0][block], noted[1][block]
        own_used[:] = False
        own_lost[0], own_lost[1] = 0.0, math.inf
        row0, row1, col0, col1 = block_window(lattice, block)
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                begin_of, end_of = first[cell], first[cell] + length[cell]
                count = _place_bases(surfaces, kept, grounds, tolerance, begin_of, end_of, level)
                if count < 0:
                    _place_column(surfaces, kept, block, begin_of, end_of, -count, level, taken)
                _note_places(surfaces, grounds, level, begin_of, end_of, own_used, own_lost)


@part
def _place_column(surfaces, kept, block, first, last, count, level, taken):
    """Place the kept surfaces of a column whose levels are their bases."""
    places, base = np.empty(count, np.int64), np.empty(count, np.int64)
    is_stair, n = np.empty(count, np.bool_), 0
    for j in range(first, last):
        if kept.key[j] >= 0:
            places[n], base[n], is_stair[n] = j, level[j], _is_stair(kept, block, j)
            n += 1
    found = np.empty(count, np.int64)
    _align(base, is_stair, taken.shape[0], found)
    taken[:] = False
    for n in range(count):
        if found[n] >= 0:
            taken[found[n]] = True
    for n in range(count):
        if found[n] < 0:
            found[n] = _nearest_free(taken, base[n])
            if found[n] >= 0:
                taken[found[n]] = True
        level[places[n]] = found[n] if found[n] >= 0 else -2


@part
def _align(base, is_stair, num_levels, level):
    """Place the surfaces of a column in their order; -1 for those that are left out of it."""
    count = base.shape[0]
    # cost[i, k]: of the first i surfaces on the first k levels
    cost = np.zeros((count + 1, num_levels + 1), np.int64)
    for i in range(1, count + 1):
        move = MOVE_STAIR if is_stair[i - 1] else MOVE_FLOOR
        skip = SKIP_STAIR if is_stair[i - 1] else SKIP_FLOOR
        cost[i, 0] = cost[i - 1, 0] + skip
        for k in range(1, num_levels + 1):
            placed = cost[i - 1, k - 1] + move * abs(k - 1 - base[i - 1])
            cost[i, k] = min(placed, cost[i, k - 1], cost[i - 1, k] + skip)
    # back from the top: of equal costs, rather the upper one is left out than the lower one, and
    # rather the upper one moves up than the lower one down
    i, k = count, num_levels
    while i > 0:
        move = MOVE_STAIR if is_stair[i - 1] else MOVE_FLOOR
        skip = SKIP_STAIR if is_stair[i - 1] else SKIP_FLOOR
        if cost[i, k] == cost[i - 1, k] + skip:
            level[i - 1] = -1
            i -= 1
        elif cost[i, k] == cost[i - 1, k - 1] + move * abs(k - 1 - base[i - 1]):
            level[i - 1] = k - 1
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


@kernel(nogil=True, **UNCOUNTED)
def measure_levels(lattice, surfaces, kept, level, own, blocks, offset, measured, begin, end):
    """Measure the parts of levels in ``blocks[begin:end]``; block k's begin at ``offset[k]``.

    Args:
        own: the number of each surface's part in its block.
        measured: receives the lowest height of each part [m], whether any of it is no stair, and
            its level.
    """
    low, has_floor, of_level = measured
    for k in range(begin, end):
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                for j in range(surfaces.first[cell], surfaces.first[cell] + surfaces.length[cell]):
                    if own[j] >= 0:
                        n = offset[k] + own[j]
                        low[n] = min(low[n], surfaces.z[j])
                        has_floor[n] = has_floor[n] or not _is_stair(kept, blocks[k], j)
                        of_level[n] = level[j]


@part(**UNCOUNTED)
def _count_on_levels(surfaces, level, part, window, width, rows, num, last):
    """See `count_on_levels`; of one block. Returns how many rows there are then, -1 for no room.

    `last`, -1 at first, receives the last row of each part.
    """
    row0, row1, col0, col1 = window
    for row in range(row0, row1):
        for cell in range(row * width + col0, row * width + col1):
            for j in range(surfaces.first[cell], surfaces.first[cell] + surfaces.length[cell]):
                if level[j] < 0:
                    continue
                at = last[part[j]]
                if at < 0 or rows[at, 1] != level[j]:
                    if num == rows.shape[0]:
                        return np.int64(-1)
                    at = num
                    rows[at, 0], rows[at, 1], rows[at, 2] = part[j], level[j], 0
                    last[part[j]] = at
                    num += 1
                rows[at, 2] += 1
    return num


@kernel(nogil=True)
def count_on_levels(lattice, surfaces, level, part, count, blocks, begin, end):
    """Count the surfaces of each part of a sheet on each level, in ``blocks[begin:end]``.

    `count` tells how many parts each block has. Returns how many rows each block has, and the rows,
    int64: part, level, count; they may repeat.
    """
    counts, num = np.zeros(end - begin, np.int64), np.int64(0)
    rows = np.empty((64, 3), np.int64)
    for k in range(begin, end):
        before, num, window = num, np.int64(-1), block_window(lattice, blocks[k])
        while num < 0:
            last = np.full(count[blocks[k]], np.int64(-1))
            num = _count_on_levels(surfaces, level, part, window, lattice.width, rows, before, last)
            if num < 0:
                rows = double(rows)
        counts[k - begin] = num - before
    return counts, rows[:num].copy()


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
