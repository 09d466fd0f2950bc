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
from navbake.baker.kernels.tiles import SIZE, block_window
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

    The rows, see `navbake.baker.blocks.list_rows`: the cell's place in its block, int16, and a
    height [m].
    """
    (places, heights), num, lattice = columns, 0, labelled.lattice
    surfaces, floor, ring = growing.surfaces, growing.floor, growing.ring
    for k in range(begin, end):
        before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell = row * lattice.width + col
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
                        if num == places.shape[0]:
                            return k
                        places[num], heights[num] = (row - row0) * SIZE + col - col0, surfaces.z[j]
                        num += 1
        counts[k] = num - before
    return end


@part(inline="always")
def _around(lattice, row, col):
    """The next cells east, south, west and north, less than 0 for none."""
    width, cell = lattice.width, row * lattice.width + col
    east = cell + 1 if col + 1 < width else np.int64(-1)
    south = cell + width if row + 1 < lattice.height else np.int64(-1)
    west = cell - 1 if col > 0 else np.int64(-1)
    return east, south, west, cell - width


@part(**UNCOUNTED)
def _nearest_height(floor, ring, around, now, heights, step):
    """The one of a cell's heights at which a floor grows into it, or NaN."""
    best, best_gap = math.nan, step + SLACK
    for other in around:
        if other < 0 or not 0 <= ring[other] < now:
            continue
        for z in heights:
            gap = abs(z - floor[other])
            # gaps within SAME are equally near; then the lower height counts
            if gap < best_gap - SAME or (gap <= best_gap + SAME and z < best):
                best, best_gap = z, min(gap, best_gap)
            elif math.isnan(best) and gap <= best_gap:
                best, best_gap = z, gap
    return best


@kernel(nogil=True, **UNCOUNTED)
def grow(lattice, floors, now, step, options, left, blocks, changed, begin, end):
    """Grow the floor by a ring into the cells of ``blocks[begin:end]``, in place.

    A cell takes that of its heights that is nearest to the floor of a neighbour, and at most a step
    from it; the lower one if two are equally near. The floors of a ring count for the next one
    only. So the order of cells and blocks does not matter, nor whether others are at work.

    Args:
        floors: `floor` and `ring`, see `Growing`.
        now: the ring, from 1 on.
        options: where each block's begin, int64; and of all, see `list_options`.
        left: how many cells are left in each block, int64; and the first option of each of these,
            int32, in place of the block's options; both are written in ring 1.
        changed: by block, bool: set where the ring has a cell.
    """
    (floor, ring), (start, place, height), (count, option) = floors, options, left
    for k in range(begin, end):
        block, num = blocks[k], 0
        first, last = start[block], start[block + 1]
        row0, _, col0, _ = block_window(lattice, block)
        if now == 1:
            for n in range(first, last):
                if n == first or place[n] != place[n - 1]:
                    option[first + num] = n
                    num += 1
            count[block], num = num, 0
        for i in range(first, first + count[block]):
            n = option[i]
            row, col = row0 + place[n] // SIZE, col0 + place[n] % SIZE
            around, is_new, z = _around(lattice, row, col), False, math.nan
            for other in around:
                is_new |= other >= 0 and ring[other] == now - 1
            if is_new:
                past = n + 1
                while past < last and place[past] == place[n]:
                    past += 1
                z = _nearest_height(floor, ring, around, now, height[n:past], step)
            if math.isnan(z):
                option[first + num] = n
                num += 1
            else:
                cell = row * lattice.width + col
                floor[cell], ring[cell] = z, now
        changed[block], count[block] = num < count[block], num


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
            for col in range(col0, col1):
                cell = row * lattice.width + col
                for way, other in enumerate(_around(lattice, row, col)[:2]):
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
