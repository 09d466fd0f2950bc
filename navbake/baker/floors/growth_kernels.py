"""Extend floors under things, ring by ring, and list the links between levels.

Growth is a breadth-first search from all cells in which an agent can stand. The cells that the
search reaches at the same time are a ring. The floor that grows into a cell depends on the cell's
surfaces, and on the floors that its neighbors got in earlier rings.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.tiles import block_window
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.baker.floors.region_kernels import region_of_surface
from navbake.baker.floors.surface_kernels import Surfaces, slopes_join
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int, Int32

# Values of `GrowthState.option`
NO_OPTION = 0  # the floor can't grow at the surface
OPTION = 1  # the floor can grow at the surface
LAST_OPTION = 2  # the floor can grow at the surface, but at no higher one of the cell
# Values of `GrowthState.ring`
NO_FLOOR = -1  # the cell has no floor
# The floor may still grow into the cell: the value is OPEN_CELL - j, where surface j is the lowest
# surface of the cell at which the floor can grow
OPEN_CELL = -2


class GrowthState(NamedTuple):
    """The growing floor of a level, and what it depends on.

    Attributes:
        surfaces: all surfaces that floors may consist of.
        level: the preliminary number of each surface's level, negative for none, int32.
        final_level: for each preliminary number, the level's number when levels without surfaces
            are left out, int64.
        grown_level: the final number of the level whose floor grows.
        height: the agent's height [m].
        step: the highest step [m].
        floor: the height of the floor in each cell, float64 [m]; NaN where there is none.
        ring: for each cell, the number of the ring in which its floor grew (0 where an agent can
            stand), NO_FLOOR or OPEN_CELL - j, int32.
        option: whether the floor can grow at each surface: NO_OPTION, OPTION or LAST_OPTION, uint8.
            `start_growth` writes it, for the surfaces of cells in which no agent can stand.
    """

    surfaces: Surfaces
    level: Int32
    final_level: Int
    grown_level: int
    height: float
    step: float
    floor: Float
    ring: Int32
    option: NDArray[np.uint8]


@subkernel(inline="always")
def _is_option(labelled, state, last, j, lowest, highest):
    """Return whether the floor may grow at surface j of a cell, see `start_growth`.

    `last` is the id past the cell's highest surface. The floor has to lie between the heights
    `lowest` and `highest` [m].
    """
    z = state.surfaces.z
    if state.level[j] >= 0 or not lowest <= z[j] <= highest:
        return False
    if region_of_surface(labelled, j) >= 0:
        return False
    for i in range(j + 1, last):
        if z[i] - z[j] > state.step + LIMIT_SLACK:
            break
        # an agent would walk on the surface above, as on a roof in which a wall's top is hidden
        if state.level[i] < 0 and region_of_surface(labelled, i) >= 0:
            return False
    return True


@kernel(nogil=True, **NO_REFCOUNT)
def start_growth(labelled, state, blocks, counts, columns, begin, end):
    """Write a level's floor where an agent can stand, and list the cells into which it may grow.

    This is done for the cells of ``blocks[begin:end]``. A labelled region is one that the floor
    doesn't grow onto, such as a roof or the top of furniture. A floor can grow at a surface if

    - the surface is on no level and belongs to no labelled region;
    - no surface of a labelled region lies above it by a step or less (one on a level may);
    - it lies at least the agent's height above the surfaces of lower levels in its cell, and below
      those of higher levels.

    A kernel for `navbake.baker.core.blocks.list_rows`; each row of its list is a cell.

    Args:
        labelled: a `LabelledSurfaces` with the regions that the floor doesn't grow onto.
        state: a `GrowthState`, whose `floor`, `ring` and `option` are written.
        blocks: ids of blocks of cells.
        counts: receives how many cells are listed for each block.
        columns: one array that receives ids of cells, (n,) int64.
        begin: index in `blocks` of the first block.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose cells didn't fit in `columns`; `end` if all
        did.
    """
    (cells,) = columns
    num = 0
    surfaces = state.surfaces
    floor = state.floor
    ring = state.ring
    lattice = surfaces.lattice
    option = state.option
    for k in range(begin, end):
        num_before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                first = surfaces.first[cell]
                last = surfaces.end[cell]
                floor[cell] = math.nan
                ring[cell] = NO_FLOOR
                lowest = -math.inf
                highest = math.inf
                for j in range(first, last):
                    if state.level[j] < 0:
                        continue
                    level = state.final_level[state.level[j]]
                    z = surfaces.z[j]
                    # the floor may grow between the levels below and above, with room for an agent
                    if level == state.grown_level:
                        floor[cell] = z
                        ring[cell] = 0
                    elif level < state.grown_level:
                        lowest = z + state.height - LIMIT_SLACK
                    elif highest == math.inf:
                        highest = z - state.height + LIMIT_SLACK
                if ring[cell] == 0:
                    continue
                last_option = np.int64(-1)
                for j in range(first, last):
                    option[j] = NO_OPTION
                    if _is_option(labelled, state, last, j, lowest, highest):
                        option[j] = OPTION
                        if last_option < 0:
                            ring[cell] = OPEN_CELL - j
                        last_option = np.int64(j)
                if last_option >= 0:
                    if num == cells.shape[0]:
                        return k
                    option[last_option] = LAST_OPTION
                    cells[num] = cell
                    num += 1
        counts[k] = num - num_before
    return end


@subkernel(inline="always")
def _neighbors_of(lattice, cell):
    """Return the ids of a cell's neighbors in the east, south, west and north, negative for none.

    `lattice` is the `Lattice` of the cells.
    """
    width = lattice.width
    col = cell % lattice.width
    east = cell + 1 if col + 1 < width else np.int64(-1)
    south = cell + width if cell + width < width * lattice.height else np.int64(-1)
    west = cell - 1 if col > 0 else np.int64(-1)
    return east, south, west, cell - width


@subkernel(**NO_REFCOUNT)
def _grow_into(state, cell, ring_number):
    """Let the floor grow into a cell, if it can; return whether it did.

    Of the cell's surfaces at which the floor can grow, see `GrowthState.option`, it grows at the
    one nearest in height to a neighbor's floor; of two equally near, at the lower one. The
    neighbor must have got its floor in a ring before `ring_number`, and the heights may differ by
    at most a step. Nothing grows into a cell that has a floor already.
    """
    z = state.surfaces.z
    floor = state.floor
    ring = state.ring
    option = state.option
    # read once, as other threads may grow the same floor into the cell
    first = OPEN_CELL - ring[cell]
    nearest_z = math.nan
    least_gap = state.step + LIMIT_SLACK
    if first < 0:
        return False
    for neighbor in _neighbors_of(state.surfaces.lattice, cell):
        if neighbor < 0 or not 0 <= ring[neighbor] < ring_number:
            continue
        j = first
        while True:
            gap = abs(z[j] - floor[neighbor]) if option[j] != NO_OPTION else math.inf
            # gaps within SAME_HEIGHT are equal; then the lower surface counts
            is_nearer = gap < least_gap - SAME_HEIGHT
            if is_nearer or (gap <= least_gap + SAME_HEIGHT and z[j] < nearest_z):
                nearest_z = z[j]
                least_gap = min(gap, least_gap)
            elif math.isnan(nearest_z) and gap <= least_gap:
                nearest_z = z[j]
                least_gap = gap
            # the floor can't grow at the cell's higher surfaces
            if option[j] == LAST_OPTION:
                break
            j += 1
    if math.isnan(nearest_z):
        return False
    floor[cell] = nearest_z
    ring[cell] = ring_number
    return True


@subkernel(**NO_REFCOUNT)
def _list_open_neighbors(state, cell, cells, num):
    """Append a cell's neighbors into which a floor may still grow; return the new number of cells.

    `cells` receives them from index `num` on.
    """
    for neighbor in _neighbors_of(state.surfaces.lattice, cell):
        if neighbor >= 0 and state.ring[neighbor] < NO_FLOOR:
            cells[num] = neighbor
            num += 1
    return num


@kernel(nogil=True, **NO_REFCOUNT)
def grow_ring(state, ring_number, front, counts, columns, begin, end):
    """Let the floor grow into the cells ``front[begin:end]``, and list cells for the next ring.

    These are the neighbors of the cells into which the floor grew; a neighbor may be listed several
    times. The result depends neither on the order of cells nor on threads, as a ring reads only the
    floors of earlier rings. This is a kernel for `navbake.baker.core.blocks.list_rows`.

    Args:
        state: a `GrowthState`: the growing floor, which is changed.
        ring_number: the number of the ring, from 1.
        front: ids of the cells into which the floor may grow in this ring, int64.
        counts: receives, for each cell of `front`, how many of its neighbors are listed.
        columns: one array that receives ids of cells, (n,) int64.
        begin: index in `front` of the first cell.
        end: index past the last one.

    Returns:
        The index in `front` of the first cell whose rows had no room; `end` if all had room.
    """
    (cells,) = columns
    num = 0
    for k in range(begin, end):
        num_before = num
        # a cell has up to four neighbors to list
        if num + 4 > cells.shape[0]:
            return k
        if _grow_into(state, front[k], ring_number):
            num = _list_open_neighbors(state, front[k], cells, num)
        counts[k] = num - num_before
    return end


@kernel(nogil=True)
def grow_remaining_rings(state, ring_number, front):
    """Let the floor grow ring by ring, until it can't grow any more.

    Args:
        state: a `GrowthState`: the growing floor, which is changed.
        ring_number: the number of the first of these rings.
        front: ids of the cells into which the floor may grow in that ring, int64.
    """
    while front.shape[0] > 0:
        next_front = np.empty(4 * front.shape[0], np.int64)
        num = 0
        for cell in front:
            if _grow_into(state, cell, ring_number):
                num = _list_open_neighbors(state, cell, next_front, num)
        front = next_front[:num]
        ring_number += 1


@kernel(nogil=True, **NO_REFCOUNT)
def list_links(surfaces, level, final_level, step, by_slopes, blocks, counts, columns, begin, end):
    """List where an agent steps from one level to another, and where only slopes join two cells.

    Each cell of ``blocks[begin:end]`` is paired with its eastern and its southern neighbor. This is
    a kernel for `navbake.baker.core.blocks.list_rows`.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        level: the preliminary number of each surface's level, negative for none, int32.
        final_level: the final number of the level for each preliminary number, int64.
        step: the highest step that the agent takes [m].
        by_slopes: whether surfaces that no step joins are also linked where `slopes_join` says so.
        blocks: ids of blocks of cells.
        counts: receives how many links each block has.
        columns: one array that receives the links, (n, 4) int64: the lower level and its cell, then
            the upper level and its cell. The levels may be equal where a slope joins two surfaces
            that no step joins.
        begin: index in `blocks` of the first block.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose rows had no room; `end` if all had room.
    """
    (rows,) = columns
    num = 0
    first = surfaces.first
    ends = surfaces.end
    z = surfaces.z
    lattice = surfaces.lattice
    max_rise = math.inf if by_slopes else step + LIMIT_SLACK
    for k in range(begin, end):
        num_before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell = row * lattice.width + col
                for direction, neighbor in enumerate(_neighbors_of(lattice, cell)[:2]):
                    if neighbor < 0:
                        continue
                    low = first[neighbor]
                    last = ends[neighbor]
                    for a in range(first[cell], ends[cell]):
                        # heights ascend in both cells, so `low` only moves up
                        while low < last and z[low] < z[a] - max_rise:
                            low += 1
                        for b in range(low, last):
                            if z[b] > z[a] + max_rise:
                                break
                            if level[a] < 0 or level[b] < 0:
                                continue
                            level_a = final_level[level[a]]
                            level_b = final_level[level[b]]
                            is_step = abs(z[a] - z[b]) <= step + LIMIT_SLACK
                            is_link = level_a != level_b and is_step
                            if by_slopes and not is_link:
                                is_link = slopes_join(surfaces, a, b, direction, step)
                            if not is_link:
                                continue
                            if num == rows.shape[0]:
                                return k
                            is_b_lower = level_b < level_a
                            rows[num, 0] = min(level_a, level_b)
                            rows[num, 1] = neighbor if is_b_lower else cell
                            rows[num, 2] = max(level_a, level_b)
                            rows[num, 3] = cell if is_b_lower else neighbor
                            num += 1
        counts[k] = num - num_before
    return end
