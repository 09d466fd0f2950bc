"""Count the heights of floors, and assign the surfaces of each column to levels, block by block.

A column is the vertical line through a cell's centre. Its surfaces and the levels are two lists in
the order of heights, which dynamic programming aligns (Needleman and Wunsch, A General Method
Applicable to the Search for Similarities in the Amino Acid Sequence of Two Proteins, 1970).
`find_largest_areas` relaxes the edges of a directed acyclic graph in topological order: the order
of heights.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.tiles import BLOCK, block_window
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.component_kernels import NO_NUMBER, count_row, height_bin
from navbake.baker.floors.region_kernels import region_of_surface, shrink
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Bool, Float, Int32

# What it costs to move a surface by one level, and to skip it, when a column's surfaces are aligned
# with the levels. A skipped surface need not keep its order among the others. The costs are far
# apart, so that stairs move rather than floors, and are skipped before a floor moves.
MOVE_STAIR = 1
MOVE_FLOOR = 10_000
SKIP_STAIR = 100
SKIP_FLOOR = 10_000_000
# Values in place of the number of a band of heights
NO_BAND = -(1 << 62)  # the surface isn't counted
ALL_BANDS = -(1 << 61)  # surfaces in all bands are counted, each under its band's number
LOWEST_SURFACES = -(1 << 60)  # stairs are counted, too, and all heights under this number
# Values in place of the level of a candidate when other surfaces of its column have all levels
NO_FREE_LEVEL = -2  # the candidate lies at no ground
NO_FREE_LEVEL_AT_GROUND = -3  # the candidate lies at the ground of a level


class Candidates(NamedTuple):
    """The surfaces to assign to levels (candidates), and those of them that belong to stairs.

    Attributes:
        group_of_surface: for each surface, 0 if it is a candidate, that is to be assigned, else -1,
            int8.
        component_of_surface: for each surface, the number of its component: a tread, a landing, a
            piece of a ramp or of a floor, or the part of it in one block of cells, int32. Empty if
            no column has two candidates, as stairs then make no difference.
        is_stair: for each component, whether it belongs to a stair or a ramp, bool.
    """

    group_of_surface: NDArray[np.int8]
    component_of_surface: Int32
    is_stair: Bool


class HeightSelection(NamedTuple):
    """A selection by height of the candidates (surfaces to assign) that `count_heights` counts.

    Heights are divided into bands: band n goes from ``n * half_step`` to ``(n + 1) * half_step``.

    Attributes:
        ground: the ground of a level [m]. A candidate is counted only if another candidate of its
            column lies below it and at or above this height. If the ground is -inf, only the lowest
            candidate of each column is counted.
        band: the number of a band: candidates in it and in the band above it are counted.
            ALL_BANDS counts them at all heights; LOWEST_SURFACES does, too, stairs included.
        half_step: the height of a band, half of the agent's highest step [m].
        top: only surfaces below this height are counted [m].
    """

    ground: float
    band: int
    half_step: float
    top: float = math.inf


class LevelRule(NamedTuple):
    """The grounds of the levels, and how surfaces are assigned to them.

    Attributes:
        grounds: the heights at which levels begin, ascending, (levels,) float64 [m].
        tolerance: how far below a ground the floors of its level may lie [m].
        skips_floors: whether columns with more candidates than there are levels leave out surfaces
            of floors, the lower ones first; if not, they leave out surfaces of stairs.
    """

    grounds: Float
    tolerance: float
    skips_floors: bool


@subkernel(inline="always")
def _is_stair(candidates, surface):
    """Return whether a surface belongs to a stair, by a `Candidates`."""
    if candidates.component_of_surface.shape[0] == 0:
        return False
    return candidates.is_stair[candidates.component_of_surface[surface]]


@kernel(nogil=True, **NO_REFCOUNT)
def mark_candidates(
    labelled_surfaces, height_ranges, group_of_surface, has_stacked_candidates, begin, end
):
    """Mark the candidates: the surfaces that are to be assigned to levels.

    Args:
        labelled_surfaces: a `LabelledSurfaces` with the regions whose surfaces are candidates.
        height_ranges: only surfaces in these ranges [low, high) of heights are candidates; the
            ranges ascend, none overlaps the next, (n, 2) float64 [m]. If empty, surfaces at all
            heights.
        group_of_surface: receives, for each surface, 0 for a candidate, else -1.
        has_stacked_candidates: receives, for each block of cells, whether a cell of it has more
            than one candidate.
        begin: id of the first block to mark.
        end: id past the last block.
    """
    surfaces = labelled_surfaces.surfaces
    lattice = labelled_surfaces.surfaces.lattice
    for block in range(begin, end):
        row0, row1, col0, col1 = block_window(lattice, block)
        has_stacked_candidates[block] = False
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                num_candidates = 0
                range_index = 0  # the first range that does not end below the surface
                for j in range(surfaces.first[cell], surfaces.end[cell]):
                    group_of_surface[j] = -1
                    if region_of_surface(labelled_surfaces, j) < 0:
                        continue
                    while (
                        range_index < height_ranges.shape[0]
                        and height_ranges[range_index, 1] <= surfaces.z[j]
                    ):
                        range_index += 1
                    is_in_range = height_ranges.shape[0] == 0 or (
                        range_index < height_ranges.shape[0]
                        and height_ranges[range_index, 0] <= surfaces.z[j]
                    )
                    if is_in_range:
                        group_of_surface[j] = 0
                        num_candidates += 1
                if num_candidates > 1:
                    has_stacked_candidates[block] = True


@subkernel(inline="always")
def _band_of(surfaces, candidates, j, selection, is_lowest):
    """Return the number of the band of heights in which surface j is counted, or NO_BAND.

    `selection` is a `HeightSelection`; `is_lowest` is whether j is the lowest candidate of its
    column that lies at or above `selection.ground`.
    """
    if is_lowest != (selection.ground == -math.inf):
        return NO_BAND
    if selection.band == LOWEST_SURFACES:
        return LOWEST_SURFACES
    band = np.int64(math.floor(surfaces.z[j] / selection.half_step))
    is_selected = selection.band == ALL_BANDS or selection.band <= band <= selection.band + 1
    return band if is_selected and not _is_stair(candidates, j) else NO_BAND


@subkernel(**NO_REFCOUNT)
def _count_block(surfaces, candidates, selection, area_test, block, masks, row_arrays, num_rows):
    """Make the histogram of heights of one block of cells, see `count_heights`.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        candidates: a `Candidates`: which surfaces are to be assigned to levels.
        selection: a `HeightSelection`: which of these surfaces are counted.
        area_test: an `AreaTest`, by whose disc the cells are shrunk.
        block: the id of the block.
        masks: two masks to write: the block's cells with a counted surface, with a margin of the
            disc's radius; and the cells that remain of them after shrinking.
        row_arrays: the arrays that receive the rows, see `count_heights`.
        num_rows: how many rows earlier blocks have.

    Returns:
        How many rows all blocks have now, or -1 if there is no room for another row.
    """
    rows, lowest_z = row_arrays
    radius = area_test.radius
    num_rows_before = num_rows
    lattice = surfaces.lattice
    row0, row1, col0, col1 = block_window(lattice, block)
    counted_mask, is_remaining = masks
    first_row_of_column = num_rows  # of the last column with any count
    # the first pass marks the cells with a counted surface, also in the margin; then they are
    # shrunk; the second pass counts the surfaces of the remaining cells
    for is_marking in (True, False):
        if is_marking and radius == 0:
            continue
        if not is_marking and radius > 0:
            shrink(counted_mask, area_test, is_remaining)
        margin = radius if is_marking else 0
        for row in range(max(row0 - margin, 0), min(row1 + margin, lattice.height)):
            for col in range(max(col0 - margin, 0), min(col1 + margin, lattice.width)):
                if not is_marking and radius > 0 and not is_remaining[row - row0, col - col0]:
                    continue
                likely_row = first_row_of_column
                has_counted = False
                is_lowest = True
                cell = row * lattice.width + col
                end_in_cell = surfaces.end[cell]
                lowest_counted_z = selection.ground - LIMIT_SLACK
                for j in range(surfaces.first[cell], end_in_cell):
                    z = surfaces.z[j]
                    if z < lowest_counted_z:
                        continue
                    if z >= selection.top or (selection.ground == -math.inf and not is_lowest):
                        break
                    if candidates.group_of_surface[j] < 0:
                        continue
                    band = _band_of(surfaces, candidates, j, selection, is_lowest)
                    is_lowest = False
                    if band == NO_BAND:
                        continue
                    if is_marking:
                        counted_mask[row - row0 + radius, col - col0 + radius] = 1
                        continue
                    row_index = count_row(
                        rows, num_rows_before, num_rows, likely_row, band, height_bin(z), NO_NUMBER
                    )
                    if row_index < 0:
                        return row_index
                    if not has_counted:
                        first_row_of_column = row_index
                    has_counted = True
                    likely_row = row_index + 1
                    lowest_z[row_index] = min(lowest_z[row_index], z) if row_index < num_rows else z
                    num_rows = max(num_rows, row_index + 1)
    return num_rows


@kernel(nogil=True)
def count_heights(
    surfaces, candidates, selection, area_test, blocks, row_counts, row_arrays, begin, end
):
    """Count how many surfaces of floors lie at each height, in ``blocks[begin:end]``.

    The surfaces to assign to levels that are no stairs are floors; `selection` determines which of
    them are counted. The cells of all selected floors together are shrunk by the disc of an area
    test, and only surfaces in the remaining cells are counted.

    This is a kernel for `navbake.baker.core.blocks.list_rows`.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`; those that lie below the selection's
            ground may be left out, which saves time in towers.
        candidates: a `Candidates`: which surfaces are to be assigned, and which of them are stairs.
        selection: a `HeightSelection`: which of these surfaces are counted.
        area_test: an `AreaTest`, by whose disc the cells are shrunk; with radius 0 they are not.
        blocks: ids of blocks of cells.
        row_counts: receives how many rows each block has.
        row_arrays: two arrays that receive the rows: the number of a band, a `height_bin`, a 0
            without a meaning, and the number of surfaces, (n, 4) int64; and the lowest height of
            these surfaces, (n,) float64 [m].
        begin: index in `blocks` of the first block to count.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose rows had no room; `end` if all had room.
    """
    num_rows = np.int64(0)
    mask_width = BLOCK + 2 * area_test.radius
    for block_index in range(begin, end):
        masks = np.zeros((mask_width, mask_width), np.int32), np.empty((BLOCK, BLOCK), np.bool_)
        num_rows_after = _count_block(
            surfaces,
            candidates,
            selection,
            area_test,
            blocks[block_index],
            masks,
            row_arrays,
            num_rows,
        )
        if num_rows_after < 0:
            return block_index
        row_counts[block_index] = num_rows_after - num_rows
        num_rows = num_rows_after
    return end


@subkernel(**NO_REFCOUNT)
def _assign_base_levels(surfaces, candidates, rule, cell, level_of_surface):
    """Write the base level of each surface to assign in a cell, see `assign_surfaces_to_levels`.

    It is the level with the highest ground at or below the surface, else the lowest level. Other
    surfaces of the cell get -1.

    Returns:
        How many surfaces are to be assigned if two of them have the same base level, else 0.
    """
    grounds = rule.grounds
    num_candidates = 0
    base_level = 0
    has_shared_level = False
    for j in range(surfaces.first[cell], surfaces.end[cell]):
        level_of_surface[j] = -1
        if candidates.group_of_surface[j] < 0:
            continue
        # grounds and surfaces both ascend, so one pass finds all base levels
        base_level_below = base_level if num_candidates > 0 else -1
        z = surfaces.z[j]
        while base_level + 1 < grounds.shape[0] and grounds[base_level + 1] - rule.tolerance <= z:
            base_level += 1
        level_of_surface[j] = base_level
        num_candidates = num_candidates + 1
        has_shared_level = has_shared_level or base_level == base_level_below
    return num_candidates if has_shared_level else 0


@kernel(nogil=True)
def assign_surfaces_to_levels(
    surfaces,
    candidates,
    rule,
    component_of_surface,
    level_of_surface,
    blocks,
    row_counts,
    row_arrays,
    begin,
    end,
):
    """Assign surfaces to levels: of the surfaces in one cell's column, at most one to each level.

    The candidates in ``blocks[begin:end]`` are assigned. A surface's base level is the level with
    the highest ground at or below the surface; if there is none, the lowest level. Usually all
    candidates of a column have different base levels, and each gets its base level. Otherwise the
    column's candidates are distributed over the levels in the order of heights. They move away from
    their base levels as little as possible: up rather than down, and stairs rather than floors. A
    stair's surface for which a floor would have to move is skipped at first. It then gets the free
    level nearest to its base level, the upper one of two.

    This is a kernel for `navbake.baker.core.blocks.list_rows`.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        candidates: a `Candidates`: which surfaces to assign, and which of them belong to stairs.
        rule: a `LevelRule`: the grounds of the levels, and how surfaces get to them.
        component_of_surface: the component of each surface, see `Regions.components`, int32.
        level_of_surface: receives the level of each surface; NO_FREE_LEVEL or
            NO_FREE_LEVEL_AT_GROUND if all levels are taken; -1 for a surface that is no candidate,
            int32.
        blocks: ids of blocks of cells.
        row_counts: receives how many rows each block has.
        row_arrays: two arrays that receive the rows: a component, a 0 without a meaning, a level,
            and how many surfaces of the component are on it, (n, 4) int64; and the lowest height of
            these surfaces, (n,) float64 [m].
        begin: index in `blocks` of the first block.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose rows had no room; `end` if all had room.
    """
    rows, lowest_z = row_arrays
    num_rows = np.int64(0)
    lattice = surfaces.lattice
    for block_index in range(begin, end):
        num_rows_before = num_rows
        first_row_of_column = num_rows  # of the last column with any count
        row0, row1, col0, col1 = block_window(lattice, blocks[block_index])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                likely_row = first_row_of_column
                has_counted = False
                num_candidates_to_separate = _assign_base_levels(
                    surfaces, candidates, rule, cell, level_of_surface
                )
                if num_candidates_to_separate > 0:
                    _assign_different_levels(
                        surfaces,
                        candidates,
                        rule,
                        cell,
                        level_of_surface,
                        num_candidates_to_separate,
                    )
                for j in range(surfaces.first[cell], surfaces.end[cell]):
                    if level_of_surface[j] == -1:
                        continue
                    row_index = count_row(
                        rows,
                        num_rows_before,
                        num_rows,
                        likely_row,
                        np.int64(component_of_surface[j]),
                        NO_NUMBER,
                        np.int64(level_of_surface[j]),
                    )
                    if row_index < 0:
                        return block_index
                    if not has_counted:
                        first_row_of_column = row_index
                    has_counted = True
                    likely_row = row_index + 1
                    z = surfaces.z[j]
                    lowest_z[row_index] = min(lowest_z[row_index], z) if row_index < num_rows else z
                    num_rows = max(num_rows, row_index + 1)
        row_counts[block_index] = num_rows - num_rows_before
    return end


@subkernel
def _assign_different_levels(surfaces, candidates, rule, cell, level_of_surface, num_candidates):
    """Give different levels to a cell's surfaces that have the same base level.

    By the rule of `assign_surfaces_to_levels`: floors move as little as possible.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        candidates: a `Candidates`: which surfaces are to be assigned to levels.
        rule: a `LevelRule`: the grounds of the levels, and how surfaces get to them.
        cell: the id of the cell.
        level_of_surface: the base level of each surface, which its level replaces.
        num_candidates: how many surfaces of the cell are to be assigned.
    """
    num_levels = rule.grounds.shape[0]
    num_listed = 0
    surface_ids = np.empty(num_candidates, np.int64)
    base_level = np.empty(num_candidates, np.int64)
    aligned_level = np.empty(num_candidates, np.int64)
    move_cost = np.empty(num_candidates, np.int64)
    skip_cost = np.empty(num_candidates, np.int64)
    skips_floors = rule.skips_floors and num_candidates > num_levels
    for surface in range(surfaces.first[cell], surfaces.end[cell]):
        if candidates.group_of_surface[surface] >= 0:
            is_stair = _is_stair(candidates, surface)
            surface_ids[num_listed] = surface
            base_level[num_listed] = level_of_surface[surface]
            move_cost[num_listed] = MOVE_STAIR if is_stair or skips_floors else MOVE_FLOOR
            skip_cost[num_listed] = SKIP_STAIR if is_stair != skips_floors else SKIP_FLOOR
            # upper surfaces cost more to skip, so that lower floors are left out first
            skip_cost[num_listed] += num_listed if skips_floors else 0
            num_listed += 1
    _align_with_levels(base_level, move_cost, skip_cost, num_levels, aligned_level)
    is_level_taken = np.zeros(num_levels, np.bool_)
    for index in range(num_candidates):
        if aligned_level[index] >= 0:
            is_level_taken[aligned_level[index]] = True
    # skipped surfaces take free levels, the nearest first, above before below
    for index in range(num_candidates):
        for num_levels_away in range(1, num_levels):
            for near_level in (
                base_level[index] + num_levels_away,
                base_level[index] - num_levels_away,
            ):
                if (
                    aligned_level[index] < 0
                    and 0 <= near_level < num_levels
                    and not is_level_taken[near_level]
                ):
                    aligned_level[index] = near_level
                    is_level_taken[near_level] = True
        surface = surface_ids[index]
        level_of_surface[surface] = (
            aligned_level[index] if aligned_level[index] >= 0 else NO_FREE_LEVEL
        )
        for ground in rule.grounds:
            if aligned_level[index] < 0 and abs(surfaces.z[surface] - ground) <= LIMIT_SLACK:
                level_of_surface[surface] = NO_FREE_LEVEL_AT_GROUND


@subkernel
def _align_with_levels(base_level, move_cost, skip_cost, num_levels, aligned_level):
    """Distribute a column's surfaces over the levels at the least cost, by dynamic programming.

    The surfaces keep their order: of two, the upper one gets the higher level. Some are skipped.

    Args:
        base_level: the base level of each surface, see `assign_surfaces_to_levels`, ascending.
        move_cost: the cost of moving each surface by one level.
        skip_cost: the cost of skipping each surface.
        num_levels: how many levels there are.
        aligned_level: receives the level of each surface, -1 for a surface that is skipped.
    """
    num_surfaces = base_level.shape[0]
    # cost[i, k]: the least cost of the first i surfaces on the first k levels
    cost = np.zeros((num_surfaces + 1, num_levels + 1), np.int64)
    for i in range(1, num_surfaces + 1):
        cost_per_level = move_cost[i - 1]
        cost_to_skip = skip_cost[i - 1]
        cost[i, 0] = cost[i - 1, 0] + cost_to_skip
        for k in range(1, num_levels + 1):
            # the i-th surface is on this level, or on a lower one, or is skipped
            cost_on_level = cost[i - 1, k - 1] + cost_per_level * abs(k - 1 - base_level[i - 1])
            cost[i, k] = min(cost_on_level, cost[i, k - 1], cost[i - 1, k] + cost_to_skip)
    # trace back from the top: at equal costs the upper surface is skipped, not the lower one, and
    # the upper one moves up rather than the lower one down
    i = num_surfaces
    k = num_levels
    while i > 0:
        cost_per_level = move_cost[i - 1]
        cost_to_skip = skip_cost[i - 1]
        if cost[i, k] == cost[i - 1, k] + cost_to_skip:
            aligned_level[i - 1] = -1
            i -= 1
        elif cost[i, k] == cost[i - 1, k - 1] + cost_per_level * abs(k - 1 - base_level[i - 1]):
            aligned_level[i - 1] = k - 1
            i -= 1
            k -= 1
        else:
            k -= 1


@kernel
def find_largest_areas(
    lower_plateau_of_step,
    upper_plateau_of_step,
    floor_size,
    steps_by_lower_plateau,
    steps_by_upper_plateau,
):
    """Find the largest floors reached from each plateau by going only up, and by going only down.

    A plateau is a tread, a landing, a piece of a ramp, or a floor between thresholds.

    Args:
        lower_plateau_of_step: the lower plateau of each step between two plateaus, (steps,) int64.
        upper_plateau_of_step: the upper plateau of each step, (steps,) int64.
        floor_size: how many surfaces the floor of each plateau has, (plateaus,) int64.
        steps_by_lower_plateau: indices of the steps, ordered by the height of the lower plateau,
            (steps,) int64.
        steps_by_upper_plateau: indices of the steps, ordered by the height of the upper plateau,
            (steps,) int64.

    Returns:
        For each plateau, how many surfaces the largest floor has that is reached by going up, and
        the largest that is reached by going down, (plateaus,) int64 each; 0 for none.
    """
    largest_size_above = np.zeros_like(floor_size)
    largest_size_below = np.zeros_like(floor_size)
    # steps in the order of their lower plateaus, the highest first: so all steps up from a plateau
    # are done before the steps that lead up to it
    for step_index in steps_by_lower_plateau[::-1]:
        lower_plateau = lower_plateau_of_step[step_index]
        upper_plateau = upper_plateau_of_step[step_index]
        largest_size_above[lower_plateau] = max(
            largest_size_above[lower_plateau],
            floor_size[upper_plateau],
            largest_size_above[upper_plateau],
        )
    for step_index in steps_by_upper_plateau:
        lower_plateau = lower_plateau_of_step[step_index]
        upper_plateau = upper_plateau_of_step[step_index]
        largest_size_below[upper_plateau] = max(
            largest_size_below[upper_plateau],
            floor_size[lower_plateau],
            largest_size_below[lower_plateau],
        )
    return largest_size_above, largest_size_below
