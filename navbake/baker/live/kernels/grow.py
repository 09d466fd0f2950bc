"""How floors go on under things, again for a region, with the ring in which each cell got its own.

`grow_floor` decides ring by ring, breadth first. A cell's answer depends on its own heights and on
what its neighbours had when its turn came: their floors, and the rings in which they got them. So
with the rings of the cells around a region, the region can be decided again by itself; and where
its outermost cells come out as they were, floors and rings, nothing outside of it changes.
"""

import math

import numpy as np

from navbake.baker.floors.kernels.sheets import nearest_height, neighbour
from navbake.baker.live.kernels.pool import FLOOR_LIKE
from navbake.compiled import kernel, part


@part(inline="always")
def _list_known(lattice, cell, local, value, ring, floor, rings, now, beside):
    """Write the floors that a cell's neighbours have before a ring; how many, and if one is new."""
    count, is_new = 0, False
    for way in range(4):
        other = neighbour(lattice, cell, way)
        if other < 0:
            continue
        m = local[other]
        at, height = (ring[m], value[m]) if m >= 0 else (rings[other], floor[other])
        if 0 <= at < now:
            beside[count] = height
            count += 1
            is_new = is_new or at == now - 1
    return count, is_new


@kernel(nogil=True)
def list_heights(start, z, taken):
    """The heights of the surfaces that are taken, ragged by column as `z` is: start and heights."""
    begin, height, at = np.zeros(start.shape[0], np.int64), np.empty(z.shape[0]), 0
    for n in range(start.shape[0] - 1):
        for i in range(start[n], start[n + 1]):
            if taken[i]:
                height[at] = z[i]
                at += 1
        begin[n + 1] = at
    return begin, height[:at].copy()


@kernel(nogil=True)
def compare_floors(cells, value, ring, floor, standable, rings, has_height, has_shifted, moved):
    """Tell which cells have another floor now; the results are as in `Grown`.

    `floor`, `standable` and `rings` are those of before, by cell id.
    """
    for n in range(cells.shape[0]):
        one, other = value[n], floor[cells[n]]
        same = one == other and math.copysign(1.0, one) == math.copysign(1.0, other)
        has_height[n] = not (same or (math.isnan(one) and math.isnan(other)))
        has_shifted[n] = (ring[n] == 0) != standable[cells[n]]
        moved[n] = has_height[n] or ring[n] != rings[cells[n]]


@kernel(nogil=True)
def regrow(lattice, cells, start, height, step, value, ring, floor, rings, local):
    """Let the floor go on in the cells of a region.

    Args:
        cells: of the region.
        start, height: the heights at which the floor may go on in each, ragged [m].
        value, ring: (cells of the region,) float64 and int32: floors that are known and ring 0
            there; NaN and -1 elsewhere, where they receive the answers.
        floor, rings: the same of all cells, as they are outside of the region.
        local: (all cells,) int32, -1 everywhere, and so again afterwards.
    """
    num = cells.shape[0]
    for n in range(num):
        local[cells[n]] = n
    # beyond the last of the rings around, only what is new can bring more
    last = 0
    edge, num_edge = np.empty(num, np.int64), 0
    queue, num_queue = np.empty(num, np.int64), 0
    following, num_following = np.empty(num, np.int64), 0
    queued = np.zeros(num, np.bool_)
    beside, answer = np.empty(4), np.empty(num)
    for n in range(num):
        if ring[n] >= 0 or start[n] == start[n + 1]:
            continue
        at_edge = False
        for way in range(4):
            other = neighbour(lattice, cells[n], way)
            if other >= 0 and local[other] < 0:
                at_edge = True
                last = max(last, rings[other])
        if at_edge:
            edge[num_edge] = n
            num_edge += 1
        queue[num_queue] = n
        num_queue += 1
        queued[n] = True
    now = 1
    while num_queue > 0 or now <= last + 1:
        for e in range(num_edge):
            n = edge[e]
            if ring[n] < 0 and not queued[n]:
                queued[n] = True
                queue[num_queue] = n
                num_queue += 1
        for q in range(num_queue):
            n = queue[q]
            answer[q] = math.nan
            count, is_new = _list_known(
                lattice, cells[n], local, value, ring, floor, rings, now, beside
            )
            if is_new:
                answer[q] = nearest_height(height[start[n] : start[n + 1]], beside[:count], step)
        num_following = 0
        for q in range(num_queue):
            n = queue[q]
            queued[n] = False
            if not math.isnan(answer[q]):
                value[n], ring[n] = answer[q], now
        for q in range(num_queue):
            n = queue[q]
            if math.isnan(answer[q]):
                continue
            for way in range(4):
                other = neighbour(lattice, cells[n], way)
                if other < 0:
                    continue
                m = local[other]
                if m < 0 or ring[m] >= 0 or queued[m] or start[m] == start[m + 1]:
                    continue
                queued[m] = True
                following[num_following] = m
                num_following += 1
        queue, following = following, queue
        num_queue = num_following
        now += 1
    for cell in cells:
        local[cell] = -1


@kernel(nogil=True)
def grow_parts(lattice, pool, main, step, parts, before, local, answers, begin, end):
    """Let the floor go on in parts of a region that do not touch, see `regrow`.

    Args:
        main: the sheet that is the floor.
        parts: the region's cells, ascending; and their numbers, grouped by part, as `group_parts`
            gives them.
        before: floor and rings of all cells, as they were.
        local: (all cells,) int32, -1 everywhere, and so again afterwards.
        answers: floor, NaN for none, and ring of each of the region's cells; receive the answers.
        begin, end: the range of parts.
    """
    cells, order, bounds = parts
    first, length, marks, sheet, height = pool.first, pool.length, pool.marks, pool.sheet, pool.z
    for k in range(begin, end):
        own = cells[order[bounds[k] : bounds[k + 1]]]
        most = 0
        for cell in own:
            most += length[cell]
        start, candidate, at = np.zeros(own.shape[0] + 1, np.int64), np.empty(most), 0
        value, ring = np.full(own.shape[0], math.nan), np.full(own.shape[0], np.int32(-1))
        for n in range(own.shape[0]):
            surfaces = range(first[own[n]], first[own[n]] + length[own[n]])
            for j in surfaces:
                if sheet[j] == main:
                    value[n], ring[n] = height[j], 0
            if ring[n] < 0:  # where one can stand, no other floor goes on
                for j in surfaces:
                    if marks[j] & FLOOR_LIKE:
                        candidate[at] = height[j]
                        at += 1
            start[n + 1] = at
        regrow(lattice, own, start, candidate, step, value, ring, before[0], before[1], local)
        for n in range(own.shape[0]):
            number = order[bounds[k] + n]
            answers[0][number], answers[1][number] = value[n], ring[n]
