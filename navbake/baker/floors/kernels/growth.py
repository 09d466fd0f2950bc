"""Floors grow under things, ring by ring (breadth-first search); and the links between levels.

A cell's floor depends on its heights and on the floors and rings that its neighbours had before. So
a region can be grown again from the rings around it, and if its outermost cells keep their floors
and rings, nothing outside of it changes.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.floors.kernels.members import sheet_of
from navbake.baker.floors.kernels.surfaces import Surfaces, slope_joins
from navbake.baker.kernels.constants import SAME, SLACK
from navbake.baker.kernels.tiles import SIZE, block_window
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Float, Int, Int32

NO_OPTION, OPTION, LAST_OPTION = 0, 1, 2


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
        option: by surface of cells where nobody can stand, uint8: NO_OPTION, or whether the floor
            may grow there, OPTION, or LAST_OPTION for the highest of its cell.
    """

    surfaces: Surfaces
    level: Int32
    number: Int
    own: int
    height: float
    step: float
    floor: Float
    ring: Int32
    option: NDArray[np.uint8]


@part(inline="always")
def _is_option(labelled, growing, block, last, j, lowest, highest):
    """Whether the floor may go on at a surface: see `stand`."""
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
def stand(labelled, growing, blocks, begin, end):
    """Write the floors that one can stand on in ``blocks[begin:end]``; mark where they may grow.

    A floor grows at surfaces that have no level and belong to no labelled sheet (a roof, the top of
    furniture), nor lie at most a step below one. Between them and the levels above and below is
    room for an agent. Until the floor has grown, `ring` has -2 less the place of a cell's first
    such surface, -1 where there is none.
    """
    surfaces, floor, ring = growing.surfaces, growing.floor, growing.ring
    lattice, option = labelled.lattice, growing.option
    for k in range(begin, end):
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
                final = np.int64(-1)
                for j in range(first, last):
                    option[j] = NO_OPTION
                    if _is_option(labelled, growing, blocks[k], last, j, lowest, highest):
                        option[j] = OPTION
                        if final < 0:
                            ring[cell] = -2 - j
                        final = np.int64(j)
                if final >= 0:
                    option[final] = LAST_OPTION


@part(inline="always")
def _around(lattice, cell):
    """The next cells east, south, west and north, less than 0 for none."""
    width, col = lattice.width, cell % lattice.width
    east = cell + 1 if col + 1 < width else np.int64(-1)
    south = cell + width if cell + width < width * lattice.height else np.int64(-1)
    west = cell - 1 if col > 0 else np.int64(-1)
    return east, south, west, cell - width


@part(**UNCOUNTED)
def _grow_into(lattice, growing, cell, now):
    """Write the floor that grows into a cell in a ring, if any does; returns whether one does.

    It is that of the surfaces marked by `stand` that is nearest to the floor of a neighbour, and at
    most a step from it; the lower one if two are equally near.
    """
    z, floor, ring, option = growing.surfaces.z, growing.floor, growing.ring, growing.option
    best, best_gap, first = math.nan, growing.step + SLACK, -2 - ring[cell]
    for other in _around(lattice, cell):
        if other < 0 or not 0 <= ring[other] < now:
            continue
        j = first
        while True:
            gap = abs(z[j] - floor[other]) if option[j] != NO_OPTION else math.inf
            # gaps within SAME are equally near; then the lower height counts
            if gap < best_gap - SAME or (gap <= best_gap + SAME and z[j] < best):
                best, best_gap = z[j], min(gap, best_gap)
            elif math.isnan(best) and gap <= best_gap:
                best, best_gap = z[j], gap
            if option[j] == LAST_OPTION:
                break
            j += 1
    if math.isnan(best):
        return False
    floor[cell], ring[cell] = best, now
    return True


@kernel(nogil=True, **UNCOUNTED)
def grow_first(lattice, growing, blocks, counts, columns, begin, end):
    """Grow the floor by its first ring into the cells of ``blocks[begin:end]``, and list these.

    The rows, see `navbake.baker.blocks.list_rows`: a cell. Only where one can stand counts, so that
    the order of cells and blocks does not matter, nor whether others are at work.
    """
    (cells,), num, ring = columns, 0, growing.ring
    for k in range(begin, end):
        before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                if ring[cell] == 0 or ring[cell] == -1:
                    continue
                is_first = ring[cell] == 1  # when the block is looked at once more, for its room
                if not is_first:
                    for other in _around(lattice, cell):
                        if other >= 0 and ring[other] == 0:
                            is_first = _grow_into(lattice, growing, cell, 1)
                            break
                if is_first:
                    if num == cells.shape[0]:
                        return k
                    cells[num] = cell
                    num += 1
        counts[k] = num - before
    return end


@kernel(nogil=True, **UNCOUNTED)
def grow_ring(lattice, growing, now, sources, counts, columns, begin, end):
    """Grow the floor by the ring `now` beside ``sources[begin:end]``, cells of the ring before.

    The rows, see `navbake.baker.blocks.list_rows`: a cell; it may repeat where others are at work.
    """
    (cells,), num, ring = columns, 0, growing.ring
    for k in range(begin, end):
        before = num
        if num + 4 > cells.shape[0]:
            return k
        for other in _around(lattice, sources[k]):
            if other >= 0 and ring[other] < -1 and _grow_into(lattice, growing, other, now):
                cells[num] = other
                num += 1
        counts[k] = num - before
    return end


@kernel(nogil=True)
def grow(lattice, growing, now, blocks, cells, rim):
    """Grow the floor by all rings after `now` in some blocks.

    The floors of a ring count for the next one only, so that the order of its cells does not
    matter.

    Args:
        cells: those of the ring `now`, int64.
        rim: cells around the blocks with floors of later rings than where one can stand, by
            their rings, int64.
    """
    ring, width = growing.ring, lattice.width
    queue = np.empty(2 * (cells.shape[0] + rim.shape[0]) + SIZE, np.int64)
    first, end, outer = 0, cells.shape[0], 0
    queue[:end] = cells
    while first < end or outer < rim.shape[0]:
        # the queue goes on with the ring `now`, inside of the blocks and around them
        while outer < rim.shape[0] and ring[rim[outer]] == now:
            queue = _push(queue, end, rim[outer])
            end, outer = end + 1, outer + 1
        now, last = now + 1, end
        for place in range(first, last):
            for other in _around(lattice, queue[place]):
                if other >= 0 and ring[other] < -1 and _grow_into(lattice, growing, other, now):
                    queue = _push(queue, end, other)
                    end += 1
        first = last
    for block in blocks:  # what the floor did not reach
        row0, row1, col0, col1 = block_window(lattice, block)
        for row in range(row0, row1):
            for cell in range(row * width + col0, row * width + col1):
                ring[cell] = max(ring[cell], -1)


@part
def _push(queue, end, cell):
    """Write a cell behind the others of a queue; returns the queue, a longer one if it was full."""
    if end == queue.shape[0]:
        longer = np.empty(2 * end, np.int64)
        longer[:end] = queue
        queue = longer
    queue[end] = cell
    return queue


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
