"""Extend floors under things, ring by ring, and list the steps between levels.

Growth is a breadth-first search from all cells in which an agent can stand. The cells that the
search reaches at the same time are a ring. The floor that grows into a cell depends on the cell's
surfaces, and on the floors that its neighbors got in earlier rings.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.bisection_kernels import find_first_above, find_first_at_or_above
from navbake.baker.core.tiles import block_window
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.baker.floors.surface_kernels import are_joined_by_slopes, find_first_not_below
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int32

if TYPE_CHECKING:  # kernels depend on kernels alone
    from navbake.navgrid.lattice import Lattice

# Values of `GrowingSurfaces.level` for surfaces that are on no level
NO_LEVEL = -1  # floors may grow at the surface
BARRIER = -2  # floors don't grow onto the surface, as it is a roof or the top of furniture
# Value of `GrowthState.lowest_level_above`: more than all numbers of levels
NO_LEVEL_ABOVE = np.int16(2**15 - 1)
# Values of `GrowthState.can_grow`
CANNOT_GROW = 0  # the floor can't grow at the surface
CAN_GROW = 1  # the floor can grow at the surface
CAN_GROW_NO_HIGHER = 2  # the floor can grow at the surface, but at no higher one of the cell
# Values of `GrowthState.ring_of_cell`
NO_FLOOR = -1  # the cell has no floor
# The floor may still grow into the cell: the value is OPEN_CELL - j, where surface j is the lowest
# surface of the cell at which the floor can grow
OPEN_CELL = -2


class GrowingSurfaces(NamedTuple):
    """The surfaces that floors may consist of, with what their growth depends on.

    There may be many million of them, so there is nothing else here, and levels are int16.

    Attributes:
        lattice: the `Lattice` of the cells.
        first: the id of the lowest surface of each cell, shape (cells,), int32.
        end: the id past the highest surface of each cell, shape (cells,), int32.
        z: heights, ascending in a cell, shape (n,), float64 [m].
        level: the number of each surface's level; NO_LEVEL or BARRIER if it is on none, shape (n,),
            int16.
    """

    lattice: Lattice
    first: Int32
    end: Int32
    z: Float
    level: NDArray[np.int16]


class GrowthState(NamedTuple):
    """The growing floor of a level, and the data that its growth depends on.

    Attributes:
        surfaces: all surfaces that floors may consist of.
        highest_level_below: for each surface, the highest number of the levels of it and of the
            lower surfaces in its cell, -1 if these have no level, int16; see `start_floors`.
        lowest_level_above: for each surface, the lowest number of the levels of it and of the
            higher surfaces in its cell, NO_LEVEL_ABOVE if these have no level, int16.
        level_number: the number of the level whose floor grows.
        agent_height: the agent's height [m].
        max_step: the highest step [m].
        floor_height: the height of the floor in each cell, float64 [m]; NaN where there is none.
        ring_of_cell: for each cell, the number of the ring in which its floor grew (0 where an
            agent can stand); NO_FLOOR; or, where the floor may still grow, OPEN_CELL less the index
            of the cell's lowest surface at which it can, int32.
        can_grow: whether the floor can grow at each surface: CANNOT_GROW, CAN_GROW or
            CAN_GROW_NO_HIGHER, uint8. `start_growth` writes it, for the surfaces between the levels
            below and above, in cells in which no agent can stand.
    """

    surfaces: GrowingSurfaces
    highest_level_below: NDArray[np.int16]
    lowest_level_above: NDArray[np.int16]
    level_number: int
    agent_height: float
    max_step: float
    floor_height: Float
    ring_of_cell: Int32
    can_grow: NDArray[np.uint8]


@subkernel(inline="always")
def _can_grow_at(growth_state, end_in_cell, surface, lowest_z, highest_z):
    """Return whether the floor may grow at a surface of a cell, by the rule of `start_growth`.

    `end_in_cell` is the id past the cell's highest surface. The floor has to lie between the
    heights `lowest_z` and `highest_z` [m].
    """
    z = growth_state.surfaces.z
    level = growth_state.surfaces.level
    if level[surface] != NO_LEVEL or not lowest_z <= z[surface] <= highest_z:
        return False
    for i in range(surface + 1, end_in_cell):
        if z[i] - z[surface] > growth_state.max_step + LIMIT_SLACK:
            break
        # an agent would walk on the surface above, as on a roof in which a wall's top is hidden
        if level[i] == BARRIER:
            return False
    return True


@kernel(nogil=True, **NO_REFCOUNT)
def start_floors(
    surfaces,
    highest_level_below,
    lowest_level_above,
    floor_heights,
    ring_of_cells,
    begin,
    end,
):
    """Write the floors of all levels where an agent can stand, and bound the levels of surfaces.

    It is done for the cells ``[begin, end)``. The bounds are the highest level up to each surface
    and the lowest level from it on, in its cell. Both ascend in each cell, also where levels don't:
    so they can be bisected for the surfaces near a level.

    Args:
        surfaces: the `GrowingSurfaces` of all cells.
        highest_level_below: receives the bound below each surface, see `GrowthState`.
        lowest_level_above: receives the bound above each surface, see `GrowthState`.
        floor_heights: receives the height of each level's floor where an agent can stand, (levels,
            cells) float64 [m].
        ring_of_cells: receives 0 there, (levels, cells) int32.
        begin: id of the first cell.
        end: id past the last cell.
    """
    for cell in range(begin, end):
        first_in_cell = surfaces.first[cell]
        end_in_cell = surfaces.end[cell]
        highest_level = np.int16(-1)
        for j in range(first_in_cell, end_in_cell):
            level = surfaces.level[j]
            if level >= 0:
                floor_heights[level, cell] = surfaces.z[j]
                ring_of_cells[level, cell] = 0
                highest_level = max(highest_level, level)
            highest_level_below[j] = highest_level
        lowest_level = NO_LEVEL_ABOVE
        for j in range(end_in_cell - 1, first_in_cell - 1, -1):
            level = surfaces.level[j]
            if level >= 0:
                lowest_level = min(lowest_level, level)
            lowest_level_above[j] = lowest_level


@kernel(nogil=True, **NO_REFCOUNT)
def start_growth(growth_state, blocks, row_counts, row_arrays, begin, end):
    """List the cells without a floor of a level into which it may grow.

    The first ring of growth may reach the listed cells. This is done for the cells of
    ``blocks[begin:end]``. A floor can grow at a surface if

    - the surface is on no level and is no barrier;
    - no barrier lies above it by a step or less (a surface on a level may);
    - it lies at least the agent's height above the surfaces of lower levels in its cell, and below
      those of higher levels.

    A kernel for `navbake.baker.core.blocks.list_rows`; each row of its list is a cell.

    Args:
        growth_state: a `GrowthState`, whose `ring_of_cell` and `can_grow` are written.
        blocks: ids of blocks of cells.
        row_counts: receives how many cells are listed for each block.
        row_arrays: one array that receives ids of cells, (n,) int64.
        begin: index in `blocks` of the first block.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose cells didn't fit in `row_arrays`; `end` if
        all did.
    """
    (cells,) = row_arrays
    num_cells = np.int64(0)
    surfaces = growth_state.surfaces
    ring_of_cell = growth_state.ring_of_cell
    lattice = surfaces.lattice
    can_grow = growth_state.can_grow
    level_number = growth_state.level_number
    highest_level_below = growth_state.highest_level_below
    lowest_level_above = growth_state.lowest_level_above
    for block_index in range(begin, end):
        num_cells_before = num_cells
        row0, row1, col0, col1 = block_window(lattice, blocks[block_index])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                if ring_of_cell[cell] == 0:
                    continue
                first_in_cell = surfaces.first[cell]
                end_in_cell = surfaces.end[cell]
                # the floor may grow between the levels below and above, with room for an agent
                lowest_z = -math.inf
                highest_z = math.inf
                surface_below = (
                    find_first_at_or_above(
                        lowest_level_above, first_in_cell, end_in_cell, level_number
                    )
                    - 1
                )
                if surface_below >= first_in_cell:
                    lowest_z = surfaces.z[surface_below] + growth_state.agent_height - LIMIT_SLACK
                surface_above = find_first_above(
                    highest_level_below, first_in_cell, end_in_cell, level_number
                )
                if surface_above < end_in_cell:
                    highest_z = surfaces.z[surface_above] - growth_state.agent_height + LIMIT_SLACK
                highest_growable_surface = np.int64(-1)
                for j in range(
                    find_first_at_or_above(surfaces.z, first_in_cell, end_in_cell, lowest_z),
                    end_in_cell,
                ):
                    if surfaces.z[j] > highest_z:
                        break
                    can_grow[j] = CANNOT_GROW
                    if _can_grow_at(growth_state, end_in_cell, j, lowest_z, highest_z):
                        can_grow[j] = CAN_GROW
                        if highest_growable_surface < 0:
                            ring_of_cell[cell] = OPEN_CELL - j
                        highest_growable_surface = np.int64(j)
                if highest_growable_surface >= 0:
                    if num_cells == cells.shape[0]:
                        return block_index
                    can_grow[highest_growable_surface] = CAN_GROW_NO_HIGHER
                    cells[num_cells] = cell
                    num_cells += 1
        row_counts[block_index] = num_cells - num_cells_before
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
def _grow_into(growth_state, cell, ring_number):
    """Let the floor grow into a cell, if it can; return whether it did.

    Of the cell's surfaces at which the floor can grow, see `GrowthState.can_grow`, it grows at the
    one nearest in height to a neighbor's floor; of two equally near, at the lower one. The
    neighbor must have got its floor in a ring before `ring_number`, and the heights may differ by
    at most a step. Nothing grows into a cell that has a floor already.
    """
    z = growth_state.surfaces.z
    floor_height = growth_state.floor_height
    ring_of_cell = growth_state.ring_of_cell
    can_grow = growth_state.can_grow
    # read once, as other threads may grow the same floor into the cell
    lowest_growable_surface = OPEN_CELL - ring_of_cell[cell]
    nearest_z = math.nan
    least_height_difference = growth_state.max_step + LIMIT_SLACK
    if lowest_growable_surface < 0:
        return False
    for neighbor in _neighbors_of(growth_state.surfaces.lattice, cell):
        if neighbor < 0 or not 0 <= ring_of_cell[neighbor] < ring_number:
            continue
        surface = lowest_growable_surface
        while True:
            height_difference = (
                abs(z[surface] - floor_height[neighbor])
                if can_grow[surface] != CANNOT_GROW
                else math.inf
            )
            # gaps within SAME_HEIGHT are equal; then the lower surface counts
            is_nearer = height_difference < least_height_difference - SAME_HEIGHT
            if is_nearer or (
                height_difference <= least_height_difference + SAME_HEIGHT
                and z[surface] < nearest_z
            ):
                nearest_z = z[surface]
                least_height_difference = min(height_difference, least_height_difference)
            elif math.isnan(nearest_z) and height_difference <= least_height_difference:
                nearest_z = z[surface]
                least_height_difference = height_difference
            # the floor can't grow at the cell's higher surfaces
            if can_grow[surface] == CAN_GROW_NO_HIGHER:
                break
            surface += 1
    if math.isnan(nearest_z):
        return False
    floor_height[cell] = nearest_z
    ring_of_cell[cell] = ring_number
    return True


@subkernel(**NO_REFCOUNT)
def _list_open_neighbors(growth_state, cell, cells, num_cells):
    """Append a cell's neighbors into which a floor may still grow; return the new number of cells.

    `cells` receives them from index `num_cells` on.
    """
    for neighbor in _neighbors_of(growth_state.surfaces.lattice, cell):
        if neighbor >= 0 and growth_state.ring_of_cell[neighbor] < NO_FLOOR:
            cells[num_cells] = neighbor
            num_cells += 1
    return num_cells


@kernel(nogil=True, **NO_REFCOUNT)
def grow_ring(growth_state, ring_number, cells_to_grow, row_counts, row_arrays, begin, end):
    """Let the floor grow into some cells, and list the cells into which it may grow next.

    The floor grows into ``cells_to_grow[begin:end]``. Listed are the neighbors of the cells into
    which it grew; a neighbor may be listed several times. The result depends neither on the order
    of cells nor on threads, as a ring reads only the floors of earlier rings. This is a kernel for
    `navbake.baker.core.blocks.list_rows`.

    Args:
        growth_state: a `GrowthState`: the growing floor, which is changed.
        ring_number: the number of the ring, from 1.
        cells_to_grow: ids of the cells into which the floor may grow in this ring, int64.
        row_counts: receives, for each cell of `cells_to_grow`, how many of its neighbors are
            listed.
        row_arrays: one array that receives ids of cells, (n,) int64.
        begin: index in `cells_to_grow` of the first cell.
        end: index past the last one.

    Returns:
        The index in `cells_to_grow` of the first cell whose rows had no room; `end` if all had
        room.
    """
    (cells,) = row_arrays
    num_cells = np.int64(0)
    for index in range(begin, end):
        num_cells_before = num_cells
        # a cell has up to four neighbors to list
        if num_cells + 4 > cells.shape[0]:
            return index
        if _grow_into(growth_state, cells_to_grow[index], ring_number):
            num_cells = _list_open_neighbors(growth_state, cells_to_grow[index], cells, num_cells)
        row_counts[index] = num_cells - num_cells_before
    return end


@kernel(nogil=True)
def grow_remaining_rings(growth_state, ring_number, cells_to_grow):
    """Let the floor grow ring by ring, until it can't grow any more.

    Args:
        growth_state: a `GrowthState`: the growing floor, which is changed.
        ring_number: the number of the first of these rings.
        cells_to_grow: ids of the cells into which the floor may grow in that ring, int64.
    """
    while cells_to_grow.shape[0] > 0:
        next_cells = np.empty(4 * cells_to_grow.shape[0], np.int64)
        num_next_cells = np.int64(0)
        for cell in cells_to_grow:
            if _grow_into(growth_state, cell, ring_number):
                num_next_cells = _list_open_neighbors(
                    growth_state, cell, next_cells, num_next_cells
                )
        cells_to_grow = next_cells[:num_next_cells]
        ring_number += 1


@kernel(nogil=True, **NO_REFCOUNT)
def list_links(
    surfaces,
    preliminary_level,
    final_level,
    max_step,
    can_slopes_join,
    blocks,
    row_counts,
    row_arrays,
    begin,
    end,
):
    """List neighboring cells joined by a step between levels, or by a slope too steep for a step.

    Each cell of ``blocks[begin:end]`` is paired with its eastern and its southern neighbor. This is
    a kernel for `navbake.baker.core.blocks.list_rows`.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        preliminary_level: the preliminary number of each surface's level, negative for none, int32.
        final_level: the final number of the level for each preliminary number, int64.
        max_step: the highest step that the agent takes [m].
        can_slopes_join: whether surfaces that no step joins are also linked where
            `are_joined_by_slopes` says so.
        blocks: ids of blocks of cells.
        row_counts: receives how many steps each block has.
        row_arrays: one array that receives the steps, (n, 4) int64: the lower level and its cell,
            then the upper level and its cell. The two levels are the same where a slope joins two
            surfaces of one level that no step joins.
        begin: index in `blocks` of the first block.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose rows had no room; `end` if all had room.
    """
    (rows,) = row_arrays
    num_rows = 0
    first_surface = surfaces.first
    end_surface = surfaces.end
    z = surfaces.z
    lattice = surfaces.lattice
    max_rise = math.inf if can_slopes_join else max_step + LIMIT_SLACK
    for block_index in range(begin, end):
        num_rows_before = num_rows
        row0, row1, col0, col1 = block_window(lattice, blocks[block_index])
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell = row * lattice.width + col
                for direction, neighbor in enumerate(_neighbors_of(lattice, cell)[:2]):
                    if neighbor < 0:
                        continue
                    first_near_surface = first_surface[neighbor]
                    end_in_neighbor = end_surface[neighbor]
                    for surface in range(np.int64(first_surface[cell]), end_surface[cell]):
                        first_near_surface = find_first_not_below(
                            z, first_near_surface, end_in_neighbor, z[surface] - max_rise
                        )
                        for neighbor_surface in range(first_near_surface, end_in_neighbor):
                            if z[neighbor_surface] > z[surface] + max_rise:
                                break
                            if (
                                preliminary_level[surface] < 0
                                or preliminary_level[neighbor_surface] < 0
                            ):
                                continue
                            surface_level = final_level[preliminary_level[surface]]
                            neighbor_level = final_level[preliminary_level[neighbor_surface]]
                            is_step = (
                                abs(z[surface] - z[neighbor_surface]) <= max_step + LIMIT_SLACK
                            )
                            is_link = surface_level != neighbor_level and is_step
                            if can_slopes_join and not is_link:
                                is_link = are_joined_by_slopes(
                                    surfaces, surface, neighbor_surface, direction, max_step
                                )
                            if not is_link:
                                continue
                            if num_rows == rows.shape[0]:
                                return block_index
                            is_neighbor_lower = neighbor_level < surface_level
                            rows[num_rows, 0] = min(surface_level, neighbor_level)
                            rows[num_rows, 1] = neighbor if is_neighbor_lower else cell
                            rows[num_rows, 2] = max(surface_level, neighbor_level)
                            rows[num_rows, 3] = cell if is_neighbor_lower else neighbor
                            num_rows += 1
        row_counts[block_index] = num_rows - num_rows_before
    return end
