"""Floors grow under things, ring by ring (breadth-first search); and the links between levels.

A cell's floor depends on its heights and on the floors and rings that its neighbours had before. So
a region can be grown again from the rings around it, and if its outermost cells keep their floors
and rings, nothing outside of it changes.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.floors.kernels.members import sheet_of
from navbake.baker.floors.kernels.surfaces import Surfaces, slope_joins
from navbake.baker.kernels.constants import SAME, SLACK
from navbake.baker.kernels.tiles import block_of, block_window
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Float, Int, Int32


class Growing(NamedTuple):
    """The level whose floor grows.

    Attributes:
        surfaces: all that floors may go on at.
        level: of each surface, less than 0 for none, int32.
        number: the final number of each level, int64.
        own: the number of the level that grows.
        height: of the agent [m].
        step: the highest step [m].
        floor: by cell, float64 [m]; NaN where there is none.
        ring: by cell, int32: the ring of its floor, 0 where one can stand, -1 for none.
    """

    surfaces: Surfaces
    level: Int32
    number: Int
    own: int
    height: float
    step: float
    floor: Float
    ring: Int32


@part(inline="always")
def _is_option(labelled, growing, block, last, j, lowest, highest):
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


@kernel(nogil=True, **UNCOUNTED)
def list_options(labelled, growing, blocks, counts, columns, begin, end):
    """Write the floors that one can stand on in ``blocks[begin:end]``; list where they may grow.

    A floor grows at surfaces that have no level and belong to no labelled sheet (a roof, the top of
    furniture), nor lie at most a step below one. Between them and the levels above and below is
    room for an agent.

    The rows, see `navbake.baker.blocks.list_rows`: the cell, and a height [m].
    """
    (cells, heights), num, lattice = columns, 0, labelled.lattice
    surfaces, floor, ring = growing.surfaces, growing.floor, growing.ring
    for k in range(begin, end):
        before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                first, last = surfaces.first[cell], surfaces.first[cell] + surfaces.length[cell]
                floor[cell], ring[cell] = math.nan, -1
                lowest, highest = -math.inf, math.inf
                for j in range(first, last):
                    if growing.level[j] < 0:
                        continue
                    number, z = growing.number[growing.level[j]], surfaces.z[j]
                    if number == growing.own:
                        floor[cell], ring[cell] = z, 0
                    elif number < growing.own:
                        lowest = z + growing.height - SLACK
                    elif highest == math.inf:
                        highest = z - growing.height + SLACK
                if ring[cell] == 0:
                    continue
                for j in range(first, last):
                    if _is_option(labelled, growing, blocks[k], last, j, lowest, highest):
                        if num == cells.shape[0]:
                            return k
                        cells[num], heights[num] = cell, surfaces.z[j]
                        num += 1
        counts[k] = num - before
    return end


@part(inline="always")
def _around(lattice, cell):
    """The next cells east, south, west and north, less than 0 for none."""
    width, col = lattice.width, cell % lattice.width
    east = cell + 1 if col + 1 < width else np.int64(-1)
    south = cell + width if cell + width < width * lattice.height else np.int64(-1)
    west = cell - 1 if col > 0 else np.int64(-1)
    return east, south, west, cell - width


@part(**UNCOUNTED)
def _nearest_height(lattice, floor, ring, now, cell, heights, step):
    """The height at which a floor grows into a cell, or NaN; a neighbour is of the last ring."""
    best, best_gap, is_new = math.nan, step + SLACK, False
    for other in _around(lattice, cell):
        if other < 0 or not 0 <= ring[other] < now:
            continue
        is_new = is_new or ring[other] == now - 1
        for z in heights:
            gap = abs(z - floor[other])
            # gaps within SAME are equally near; then the lower height counts
            if gap < best_gap - SAME or (gap <= best_gap + SAME and z < best):
                best, best_gap = z, min(gap, best_gap)
            elif math.isnan(best) and gap <= best_gap:
                best, best_gap = z, gap
    return best if is_new else math.nan


@kernel(nogil=True, **UNCOUNTED)
def grow(lattice, region, cells, start, height, step, floor, ring, local, room):
    """Grow the floor into the cells of a region, in place.

    A cell takes that of its heights that is nearest to the floor of a neighbour, and at most a step
    from it; the lower one if two are equally near. All cells of a ring are decided before any is
    written, so their order does not matter.

    Args:
        region: by block, bool; cells outside are only read.
        cells, start, height: the options of the region, ragged, see `list_options` [m].
        floor, ring: see `Growing`.
        local: (all cells,) int32, -1 before and after.
        room: scratch: (3, cells) int64; (cells,) bool, all False; (cells,) float64.
    """
    num, width, everywhere = cells.shape[0], lattice.width, region.all()
    for n in range(num):
        local[cells[n]] = n
    # cells at the region's edge, of a ring, and of the next one; which are in these; the answers
    (edge, queue, following), queued, answer = room
    num_edge, num_queue = 0, 0
    # after the last of the rings around, only new cells can have new neighbours
    last = 0
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
    now = np.int64(1)
    while num_queue > 0 or (num_edge > 0 and now <= last + 1):
        for e in range(num_edge):
            n = edge[e]
            if ring[cells[n]] < 0 and not queued[n]:
                queued[n] = True
                queue[num_queue] = n
                num_queue += 1
        for q in range(num_queue):
            n = queue[q]
            heights = height[start[n] : start[n + 1]]
            answer[q] = _nearest_height(lattice, floor, ring, now, cells[n], heights, step)
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
        queue, following, num_queue = following, queue, num_following
        now += 1
    for n in range(num):
        local[cells[n]] = -1


@kernel(nogil=True, **UNCOUNTED)
def list_links(lattice, surfaces, placed, step, by_slopes, blocks, counts, columns, begin, end):
    """List where levels meet: steps between two, and pairs that slopes join but no step does.

    Pairs each cell of ``blocks[begin:end]`` with those east and south of it. `placed` has `level`
    and `number` of `Growing`. The rows, see `navbake.baker.blocks.list_rows`: a level, its cell,
    the other level, which is not lower, and its cell.
    """
    (rows,), (level, number), num = columns, placed, 0
    first, length, z = surfaces.first, surfaces.length, surfaces.z
    far = math.inf if by_slopes else step + SLACK
    for k in range(begin, end):
        before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                for way, other in enumerate(_around(lattice, cell)[:2]):
                    if other < 0:
                        continue
                    low, last = first[other], first[other] + length[other]
                    for a in range(first[cell], first[cell] + length[cell]):
                        while low < last and z[low] < z[a] - far:
                            low += 1
                        for b in range(low, last):
                            if z[b] > z[a] + far:
                                break
                            if level[a] < 0 or level[b] < 0:
                                continue
                            one, two = number[level[a]], number[level[b]]
                            meets = one != two and abs(z[a] - z[b]) <= step + SLACK
                            if by_slopes and not meets:
                                meets = slope_joins(lattice, surfaces, a, b, way, step)
                            if not meets:
                                continue
                            if num == rows.shape[0]:
                                return k
                            swap = two < one
                            rows[num, 0], rows[num, 2] = min(one, two), max(one, two)
                            rows[num, 1] = other if swap else cell
                            rows[num, 3] = cell if swap else other
                            num += 1
        counts[k] = num - before
    return end
