"""Floors grow under things, ring by ring (breadth-first search); and the links between levels.

A cell's floor depends on its heights, and on the floors that its neighbours had one ring before.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.tiles import block_window
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.baker.floors.member_kernels import region_of
from navbake.baker.floors.surface_kernels import Surfaces, slope_joins
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int, Int32

NO_OPTION = 0
OPTION = 1
LAST_OPTION = 2


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
        ring: by cell, int32: the ring of its floor, 0 where one can stand, -1 for none. Below -1
            while the floor may still grow there, see `stand`.
        option: by surface of cells where nobody can stand, uint8: NO_OPTION, or whether the floor
            may grow there, OPTION, or LAST_OPTION for the highest of its cell. Written by `stand`.
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


@subkernel(inline="always")
def _is_option(labelled, growing, last, j, lowest, highest):
    """Whether the floor may go on at a surface: see `stand`."""
    z = growing.surfaces.z
    if growing.level[j] >= 0 or not lowest <= z[j] <= highest or region_of(labelled, j) >= 0:
        return False
    for i in range(j + 1, last):
        if z[i] - z[j] > growing.step + LIMIT_SLACK:
            break
        # an agent would walk on those above, as on a roof in which a wall's top is hidden
        if growing.level[i] < 0 and region_of(labelled, i) >= 0:
            return False
    return True


@kernel(nogil=True, **NO_REFCOUNT)
def stand(labelled, growing, blocks, counts, columns, begin, end):
    """Write the floors that one can stand on in ``blocks[begin:end]``; list where they may grow.

    A floor grows at surfaces that have no level and belong to no labelled region (a roof, the top
    of furniture), nor lie at most a step below one. Between them and the levels above and below is
    room for an agent. Until the floor has grown, `ring` has -2 less the place of a cell's first
    such surface, -1 where there is none.

    The rows, see `navbake.baker.core.blocks.list_rows`: a cell with such a surface, int64.
    """
    (cells,) = columns
    num = 0
    surfaces = growing.surfaces
    floor = growing.floor
    ring = growing.ring
    lattice = surfaces.lattice
    option = growing.option
    for k in range(begin, end):
        before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                first = surfaces.first[cell]
                last = surfaces.end[cell]
                floor[cell] = math.nan
                ring[cell] = -1
                lowest = -math.inf
                highest = math.inf
                for j in range(first, last):
                    if growing.level[j] < 0:
                        continue
                    number = growing.number[growing.level[j]]
                    z = surfaces.z[j]
                    if number == growing.own:
                        floor[cell] = z
                        ring[cell] = 0
                    elif number < growing.own:
                        lowest = z + growing.height - LIMIT_SLACK
                    elif highest == math.inf:
                        highest = z - growing.height + LIMIT_SLACK
                if ring[cell] == 0:
                    continue
                final = np.int64(-1)
                for j in range(first, last):
                    option[j] = NO_OPTION
                    if _is_option(labelled, growing, last, j, lowest, highest):
                        option[j] = OPTION
                        if final < 0:
                            ring[cell] = -2 - j
                        final = np.int64(j)
                if final >= 0:
                    if num == cells.shape[0]:
                        return k
                    option[final] = LAST_OPTION
                    cells[num] = cell
                    num += 1
        counts[k] = num - before
    return end


@subkernel(inline="always")
def _around(lattice, cell):
    """The next cells east, south, west and north, less than 0 for none."""
    width = lattice.width
    col = cell % lattice.width
    east = cell + 1 if col + 1 < width else np.int64(-1)
    south = cell + width if cell + width < width * lattice.height else np.int64(-1)
    west = cell - 1 if col > 0 else np.int64(-1)
    return east, south, west, cell - width


@subkernel(**NO_REFCOUNT)
def _grow_into(growing, cell, now):
    """Write the floor that grows into a cell in a ring, if any does; returns whether one does.

    None does where the cell has a floor already, or no surface for one. Else it is that of the
    surfaces marked by `stand` that is nearest to the floor of a neighbour, and at most a step from
    it; the lower one if two are equally near.
    """
    z = growing.surfaces.z
    floor = growing.floor
    ring = growing.ring
    option = growing.option
    # read once, as others may grow the same floor into the cell
    best = math.nan
    best_gap = growing.step + LIMIT_SLACK
    first = -2 - ring[cell]
    if first < 0:
        return False
    for other in _around(growing.surfaces.lattice, cell):
        if other < 0 or not 0 <= ring[other] < now:
            continue
        j = first
        while True:
            gap = abs(z[j] - floor[other]) if option[j] != NO_OPTION else math.inf
            # gaps within SAME_HEIGHT are equally near; then the lower height counts
            if gap < best_gap - SAME_HEIGHT or (gap <= best_gap + SAME_HEIGHT and z[j] < best):
                best = z[j]
                best_gap = min(gap, best_gap)
            elif math.isnan(best) and gap <= best_gap:
                best = z[j]
                best_gap = gap
            if option[j] == LAST_OPTION:
                break
            j += 1
    if math.isnan(best):
        return False
    floor[cell] = best
    ring[cell] = now
    return True


@subkernel(**NO_REFCOUNT)
def _list_beside(growing, cell, cells, num):
    """List the next cells into which a floor may still grow; returns how many are listed then."""
    for other in _around(growing.surfaces.lattice, cell):
        if other >= 0 and growing.ring[other] < -1:
            cells[num] = other
            num += 1
    return num


@kernel(nogil=True, **NO_REFCOUNT)
def grow_ring(growing, now, asked, counts, columns, begin, end):
    """Grow the floor by the ring `now` into ``asked[begin:end]``, and list the cells beside these.

    The rows, see `list_rows`: a cell, int64; the same may be listed several
    times. The order of cells does not matter, nor whether others are at work: the floors of a ring
    count for the next one only.
    """
    (cells,) = columns
    num = 0
    for k in range(begin, end):
        before = num
        if num + 4 > cells.shape[0]:
            return k
        if _grow_into(growing, asked[k], now):
            num = _list_beside(growing, asked[k], cells, num)
        counts[k] = num - before
    return end


@kernel(nogil=True)
def grow(growing, now, cells):
    """Grow the floor by the ring `now` into some cells, int64, and by all later rings."""
    while cells.shape[0] > 0:
        next_cells = np.empty(4 * cells.shape[0], np.int64)
        num = 0
        for cell in cells:
            if _grow_into(growing, cell, now):
                num = _list_beside(growing, cell, next_cells, num)
        cells = next_cells[:num]
        now += 1


@kernel(nogil=True, **NO_REFCOUNT)
def list_links(surfaces, placed, step, by_slopes, blocks, counts, columns, begin, end):
    """List where levels meet: steps between two, and pairs that slopes join but no step does.

    Pairs each cell of ``blocks[begin:end]`` with those east and south of it. `placed` has `level`
    and `number` of `Growing`. The rows, see `list_rows`: a level, its cell,
    the other level, which is not lower, and its cell.
    """
    (rows,) = columns
    level, number = placed
    num = 0
    first = surfaces.first
    ends = surfaces.end
    z = surfaces.z
    lattice = surfaces.lattice
    far = math.inf if by_slopes else step + LIMIT_SLACK
    for k in range(begin, end):
        before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell = row * lattice.width + col
                for way, other in enumerate(_around(lattice, cell)[:2]):
                    if other < 0:
                        continue
                    low = first[other]
                    last = ends[other]
                    for a in range(first[cell], ends[cell]):
                        while low < last and z[low] < z[a] - far:
                            low += 1
                        for b in range(low, last):
                            if z[b] > z[a] + far:
                                break
                            if level[a] < 0 or level[b] < 0:
                                continue
                            one = number[level[a]]
                            two = number[level[b]]
                            meets = one != two and abs(z[a] - z[b]) <= step + LIMIT_SLACK
                            if by_slopes and not meets:
                                meets = slope_joins(surfaces, a, b, way, step)
                            if not meets:
                                continue
                            if num == rows.shape[0]:
                                return k
                            swap = two < one
                            rows[num, 0] = min(one, two)
                            rows[num, 2] = max(one, two)
                            rows[num, 1] = other if swap else cell
                            rows[num, 3] = cell if swap else other
                            num += 1
        counts[k] = num - before
    return end
