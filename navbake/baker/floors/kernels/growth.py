"""How floors go on under things, ring by ring, breadth first; and the steps between levels.

A cell's answer depends on its own heights and on what its neighbours had when its turn came: their
floors, and the rings in which they got them. So with the rings of the cells around a region, the
region can be decided again by itself; and where its outermost cells come out as they were, floors
and rings, nothing outside of it changes.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.floors.kernels.labels import double, slope_joins
from navbake.baker.floors.kernels.members import sheet_of
from navbake.baker.floors.kernels.surfaces import Surfaces
from navbake.baker.kernels.blocks import block_of, block_window
from navbake.baker.kernels.constants import SAME, SLACK
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Bool, Float, Int, Int32


class Growing(NamedTuple):
    """The level whose floor goes on.

    Attributes:
        surfaces: all that floors may go on at.
        level: of each by place, less than 0 for none, int32.
        number: what becomes of these numbers, int64.
        own: the number of the level.
        height: of the agent [m].
        step: the highest step [m].
        floor: by cell, float64 [m]; NaN where there is none.
        ring: by cell, int32: in which ring it got its floor, 0 where one can stand, -1 for none.
    """

    surfaces: Surfaces
    level: Int32
    number: Int
    own: int
    height: float
    step: float
    floor: Float
    ring: Int32


@kernel(nogil=True, **UNCOUNTED)
def write_standable(lattice, growing, blocks, begin, end):
    """Write the floors that one can stand on in ``blocks[begin:end]``, and nothing elsewhere."""
    surfaces = growing.surfaces
    for k in range(begin, end):
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                growing.floor[cell], growing.ring[cell] = math.nan, -1
                for j in range(surfaces.first[cell], surfaces.first[cell] + surfaces.length[cell]):
                    if growing.level[j] >= 0 and growing.number[growing.level[j]] == growing.own:
                        growing.floor[cell], growing.ring[cell] = surfaces.z[j], 0


@part(inline="always")
def _is_option(labelled, growing, block, first, last, j, lowest, highest):
    """Whether the floor may go on at a surface: see `list_options`."""
    z = growing.surfaces.z
    if growing.level[j] >= 0 or not lowest <= z[j] <= highest or sheet_of(labelled, block, j) >= 0:
        return False
    for i in range(j + 1, last):
        if z[i] - z[j] > growing.step + SLACK:
            break
        # an agent would walk on those above, as on a roof in which a wall's top is hidden
        if growing.level[i] < 0 and sheet_of(labelled, block, i) >= 0:
            return False
    return True


@part(**UNCOUNTED)
def _list_options(labelled, growing, block, cells, counts, heights, num, total):
    """See `list_options`; of one block. Counts alone where there is no room."""
    lattice, surfaces = labelled.lattice, growing.surfaces
    row0, row1, col0, col1 = block_window(lattice, block)
    for row in range(row0, row1):
        for cell in range(row * lattice.width + col0, row * lattice.width + col1):
            if growing.ring[cell] == 0:
                continue
            first, last = surfaces.first[cell], surfaces.first[cell] + surfaces.length[cell]
            lowest, highest, count = -math.inf, math.inf, 0
            for j in range(first, last):
                if growing.level[j] < 0:
                    continue
                if growing.number[growing.level[j]] < growing.own:
                    lowest = surfaces.z[j] + growing.height - SLACK
                elif highest == math.inf:
                    highest = surfaces.z[j] - growing.height + SLACK
            for j in range(first, last):
                if _is_option(labelled, growing, block, first, last, j, lowest, highest):
                    if total < heights.shape[0]:
                        heights[total] = surfaces.z[j]
                    total += 1
                    count += 1
            if count:
                if num < cells.shape[0]:
                    cells[num], counts[num] = cell, count
                num += 1
    return num, total


@kernel(nogil=True)
def list_options(labelled, growing, blocks, begin, end):
    """List the cells of ``blocks[begin:end]`` where the floor may go on, and at which heights.

    It goes on only where no other floor is, nor a roof, nor the top of furniture: at no labelled
    surface, nor a step at most below one that does not count; and with room for an agent up to the
    level above, and down to the one below.

    Returns the cells, how many heights each has, and the heights [m].
    """
    cells, counts, heights = np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    num, total = 0, 0
    for k in range(begin, end):
        num, total = _list_options(labelled, growing, blocks[k], cells, counts, heights, num, total)
    cells, counts, heights = np.empty(num, np.int64), np.empty(num, np.int64), np.empty(total)
    num, total = 0, 0
    for k in range(begin, end):
        num, total = _list_options(labelled, growing, blocks[k], cells, counts, heights, num, total)
    return cells, counts, heights


@part(inline="always")
def _around(lattice, cell):
    """The next cells east, south, west and north, less than 0 for none."""
    width, col = lattice.width, cell % lattice.width
    east = cell + 1 if col + 1 < width else np.int64(-1)
    south = cell + width if cell + width < width * lattice.height else np.int64(-1)
    west = cell - 1 if col > 0 else np.int64(-1)
    return east, south, west, cell - width


@part(inline="always")
def nearest_height(heights, beside, step):
    """The height at which a floor goes on in a cell, or NaN."""
    best, best_gap = math.nan, step + SLACK
    for floor in beside:
        for z in heights:
            gap = abs(z - floor)
            # gaps within SAME are equally near; then the lower height counts
            if gap < best_gap - SAME or (gap <= best_gap + SAME and z < best):
                best, best_gap = z, min(gap, best_gap)
            elif math.isnan(best) and gap <= best_gap:
                best, best_gap = z, gap
    return best


class GrowRoom(NamedTuple):
    """Room for the rings that a floor grows by.

    Attributes:
        edge: cells at the edge of the region.
        queue, following: the cells of a ring and of the next one.
        queued: whether a cell is in one of them, all False at first.
        beside: (4,) float64, floors beside a cell [m].
        answer: the floors of a ring's cells [m].
    """

    edge: Int
    queue: Int
    following: Int
    queued: Bool
    beside: Float
    answer: Float


@kernel(nogil=True)
def grow(lattice, region, cells, start, height, step, floor, ring, local):
    """Let the floor go on in the cells of a region, in place.

    A cell without a floor takes that of its heights that is nearest to the floor of a neighbour
    (the lower one if two are equally near), when they differ by at most a step. All cells of a
    ring are decided before any is written, so their order decides nothing.

    Args:
        region: by block, bool; floors and rings of the cells outside are not written to.
        cells: those of the region where the floor may go on.
        start, height: the heights at which it may in each, ragged [m].
        floor, ring: see `Growing`.
        local: (all cells,) int32, -1 everywhere, and so again afterwards.
    """
    num = cells.shape[0]
    edge, queue, following = (
        np.empty(num, np.int64),
        np.empty(num, np.int64),
        np.empty(num, np.int64),
    )
    queued, beside, answer = np.zeros(num, np.bool_), np.empty(4), np.empty(num)
    room = GrowRoom(edge, queue, following, queued, beside, answer)
    _grow(lattice, region, cells, start, height, step, floor, ring, local, room)


@part(**UNCOUNTED)
def _grow(lattice, region, cells, start, height, step, floor, ring, local, room):
    """See `grow`."""
    num, width = cells.shape[0], lattice.width
    for n in range(num):
        local[cells[n]] = n
    everywhere = region.all()
    # beyond the last of the rings around, only what is new can bring more
    last = 0
    edge, queue, following, queued, beside, answer = room
    num_edge, num_queue, num_following = 0, 0, 0
    for n in range(num):
        at_edge, is_near = False, False
        for other in _around(lattice, cells[n]):
            if other < 0:
                continue
            is_near = is_near or ring[other] >= 0
            if not everywhere and not region[block_of(lattice, other // width, other % width)]:
                at_edge = True
                last = max(last, ring[other])
        if at_edge:
            edge[num_edge] = n
            num_edge += 1
        elif is_near:
            queue[num_queue] = n
            num_queue += 1
            queued[n] = True
    now = 1
    while num_queue > 0 or (num_edge > 0 and now <= last + 1):
        for e in range(num_edge):
            n = edge[e]
            if ring[cells[n]] < 0 and not queued[n]:
                queued[n] = True
                queue[num_queue] = n
                num_queue += 1
        for q in range(num_queue):
            n = queue[q]
            answer[q], found, is_new = math.nan, 0, False
            for other in _around(lattice, cells[n]):
                if other >= 0 and 0 <= ring[other] < now:
                    beside[found] = floor[other]
                    found += 1
                    is_new = is_new or ring[other] == now - 1
            if is_new:
                answer[q] = nearest_height(height[start[n] : start[n + 1]], beside[:found], step)
        for q in range(num_queue):
            n = queue[q]
            queued[n] = False
            if not math.isnan(answer[q]):
                floor[cells[n]], ring[cells[n]] = answer[q], now
        num_following = 0
        for q in range(num_queue):
            if math.isnan(answer[q]):
                continue
            for other in _around(lattice, cells[queue[q]]):
                if other < 0:
                    continue
                m = local[other]
                if m >= 0 and ring[other] < 0 and not queued[m]:
                    queued[m] = True
                    following[num_following] = m
                    num_following += 1
        queue, following = following, queue
        num_queue = num_following
        now += 1
    for n in range(num):
        local[cells[n]] = -1


@part(**UNCOUNTED)
def _list_links(lattice, surfaces, level, number, step, by_slopes, block, rows, num):
    """See `list_links`; of one block. Returns how many rows there are then, -1 for no room."""
    first, length, z = surfaces.first, surfaces.length, surfaces.z
    row0, row1, col0, col1 = block_window(lattice, block)
    for row in range(row0, row1):
        for cell in range(row * lattice.width + col0, row * lattice.width + col1):
            east, south, _, _ = _around(lattice, cell)
            for way in range(2):
                other = east if way == 0 else south
                if other < 0:
                    continue
                for a in range(first[cell], first[cell] + length[cell]):
                    if level[a] < 0:
                        continue
                    one = number[level[a]]
                    for b in range(first[other], first[other] + length[other]):
                        if level[b] < 0:
                            continue
                        two = number[level[b]]
                        meets = one != two and abs(z[a] - z[b]) <= step + SLACK
                        if by_slopes and not meets:
                            meets = slope_joins(lattice, surfaces, a, b, way, step)
                        if not meets:
                            continue
                        if num == rows.shape[0]:
                            return np.int64(-1)
                        swap = two < one
                        rows[num, 0], rows[num, 2] = min(one, two), max(one, two)
                        rows[num, 1] = other if swap else cell
                        rows[num, 3] = cell if swap else other
                        num += 1
    return num


@kernel(nogil=True)
def list_links(lattice, surfaces, level, number, step, by_slopes, blocks, begin, end):
    """List where levels meet: steps between two, and pairs that slopes join but no step does.

    Looks at the cells of ``blocks[begin:end]``, and from these to the east and the south. Returns
    how many rows each block has, and the rows, int64: a level, its cell, the other level, which is
    not lower, and its cell.
    """
    counts, num = np.zeros(end - begin, np.int64), np.int64(0)
    rows = np.empty((64, 4), np.int64)
    for k in range(begin, end):
        before, num = num, np.int64(-1)
        while num < 0:
            num = _list_links(
                lattice, surfaces, level, number, step, by_slopes, blocks[k], rows, before
            )
            if num < 0:
                rows = double(rows)
        counts[k - begin] = num - before
    return counts, rows[:num].copy()
