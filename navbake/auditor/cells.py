"""Checks of layers and floors: free cells, weights, stored layers, jumps, cut-off islands."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.auditor.facts import (
    ABOVE_AND_BELOW,
    ERROR,
    LEFT_AND_RIGHT,
    REMARK,
    Facts,
    Finding,
    read_inflations,
)
from navbake.errors import count_of
from navbake.navgrid.grid import GridBase
from navbake.types import Bool, Float, Int

MIN_CELLS = 100  # grids and levels with fewer cells may have any share of free cells
MIN_FREE_FRACTION = 0.01  # with a smaller share of free cells, hardly any cell of a level is free
CLEARANCE_TOLERANCE = 1e-3  # largest error of a stored clearance [m]
MAX_ISLAND_NUMBER = 65_535  # stands for this island and all smaller ones: the layer is uint16
MAX_FLOOR_HEIGHT = 10_000.0  # floors farther from z = 0 must be in a wrong unit [m]
# smallest area of a floor that no step leads to, unless the settings of the bake have another [m²]
MIN_FLOOR_AREA = 1.0
# share of a patch's outline that jumps: from the first share on, a patch is reported; from the
# second on, it is an error (a corner of it may touch a wall)
MIN_JUMP_SHARE = 0.5
ERROR_JUMP_SHARE = 0.75
MAX_PATCHES = 10  # number of patches that are reported one by one
MIN_CUT_OFF_AREA = 1.0  # gaps between islands are reported if both islands are larger [m²]
MAX_GAP_CELLS = 3  # more blocked cells between two islands are a thin wall
MAX_GAPS = 10  # number of gaps that are reported, those at the largest islands first


def check_all_free(facts: Facts) -> Iterator[Finding]:
    """Find a grid whose cells are all free, without even a wall."""
    num_cells = sum(is_free.size for is_free in facts.free)
    if num_cells >= MIN_CELLS and all(is_free.all() for is_free in facts.free):
        text = f"all {num_cells} cells are free: nothing stands on the floor, and it ends nowhere"
        yield Finding(REMARK, None, None, text)


def check_empty_levels(facts: Facts) -> Iterator[Finding]:
    """Find levels without a floor, and levels or grids without a free cell.

    Missing free cells are a remark only if the grid is inflated: the inflation may have closed all.
    """
    severity = ERROR
    inflation_text = ""
    if facts.inflation_reach is not None:
        severity = REMARK
        inflation_text = f", inflated by {facts.inflation_reach:g} m"
    if not any(is_free.any() for is_free in facts.free):
        yield Finding(severity, None, None, f"no cell is free, on any level{inflation_text}")
        return
    for level_number, is_free in enumerate(facts.free):
        if is_free.any():
            continue
        num_floors = np.count_nonzero(~np.isnan(facts.floors[level_number]))
        if num_floors:
            text = f"none of its {num_floors} cells with a floor is free{inflation_text}"
            yield Finding(severity, level_number, None, text)
        else:
            yield Finding(ERROR, level_number, None, "no floor")


def check_free_share(facts: Facts) -> Iterator[Finding]:
    """Find levels where hardly any cell is free, such as a black map with a few specks."""
    for level_number, (level, is_free) in enumerate(zip(facts.levels, facts.free, strict=True)):
        is_floor = is_free | ~np.isnan(facts.floors[level_number])
        num_floor_cells = np.count_nonzero(is_floor) if level.uses_cell_floors else is_free.size
        num_free = np.count_nonzero(is_free)
        if num_floor_cells >= MIN_CELLS and 0 < num_free < MIN_FREE_FRACTION * num_floor_cells:
            text = f"only {num_free} of {num_floor_cells} cells are free"
            yield Finding(
                REMARK, level_number, facts.find_first_position(level_number, is_free), text
            )


def check_weights(facts: Facts) -> Iterator[Finding]:
    """Find cells whose weight contradicts their occupancy, or is NaN or negative."""
    inflation_reach = facts.inflation_reach
    for level_number, level in enumerate(facts.levels):
        weights = level.weights
        is_occupied = level.occupancy != 0
        is_free = facts.free[level_number]
        is_invalid_weight = np.isnan(weights) | (weights < 0)
        yield from facts.report_wrong_cells(
            level_number, is_invalid_weight, "a weight that is no cost"
        )
        if "occupancy" not in level.attributes:
            continue
        may_be_freed = (inflation_reach is not None) & (level.solid == 0)
        is_free_but_occupied = is_free & is_occupied & ~may_be_freed
        yield from facts.report_wrong_cells(
            level_number, is_free_but_occupied, "free by weight, but occupied"
        )
        is_blocked = ~is_free & ~is_invalid_weight & ~is_occupied
        text = "blocked by weight, but not occupied"
        if inflation_reach is not None and is_blocked.any():
            is_blocked &= ~mark_cells_inflation_may_block(facts.grid, level_number, inflation_reach)
            text += f", and nothing that an inflation avoids is within {inflation_reach:g} m"
        yield from facts.report_wrong_cells(level_number, is_blocked, text)


def mark_cells_inflation_may_block(grid: GridBase, level_number: int, max_distance: float) -> Bool:
    """Mark the cells of a level that an inflation may have blocked.

    A cell is marked if a square around it contains one of these:

    - an occupied cell, a cell without a floor, or the edge of the level;
    - a floor that is more than a step higher or lower;
    - a floor of another level that is higher than this level's lowest floor less the agent's
      height, and lower than its highest floor plus the agent's height.

    The square reaches slightly farther than `max_distance`, so that no cause is missed.

    Args:
        grid: the grid.
        level_number: the level's index.
        max_distance: how far from a cell's centre an inflation looks for such causes [m].

    Returns:
        A mask of the cells, shape (height, width).
    """
    level = grid.levels[level_number]
    floor = level.floor
    has_floor = ~np.isnan(floor)
    is_avoided = (level.occupancy != 0) | ~has_floor
    if has_floor.any():
        lowest_z = floor[has_floor].min() - grid.agent_height
        highest_z = floor[has_floor].max() + grid.agent_height
        for other_level in grid.levels:
            if other_level is level:
                continue
            is_near = (other_level.floor > lowest_z) & (other_level.floor < highest_z)
            positions = other_level.lattice.positions(*np.nonzero(is_near))
            rows, cols = level.lattice.rows_cols(positions)
            is_inside = level.lattice.holds(rows, cols)
            is_avoided[rows[is_inside], cols[is_inside]] = True
    reach_in_cells = min(math.ceil(max_distance / level.lattice.cell_size) + 1, max(level.shape))
    window_size = 2 * reach_in_cells + 1
    has_reason: Bool = maximum_filter(is_avoided, window_size, mode="constant", cval=True)
    highest_floor_near = maximum_filter(np.where(has_floor, floor, -np.inf), window_size)
    lowest_floor_near = minimum_filter(np.where(has_floor, floor, np.inf), window_size)
    with np.errstate(invalid="ignore"):  # where there is no floor
        has_reason |= highest_floor_near - floor > grid.max_step
        has_reason |= floor - lowest_floor_near > grid.max_step
    return has_reason


def check_inflation(facts: Facts) -> Iterator[Finding]:
    """Find metadata that state the radius or the mode of an inflation wrongly, or not at all."""
    _, problem = read_inflations(facts.grid)
    if problem is not None:
        # in files of other programs, `inflation` may mean anything
        yield Finding(ERROR if facts.grid.navbake else REMARK, None, None, problem)


def check_layers(facts: Facts) -> Iterator[Finding]:
    """Find stored `island` and `clearance` layers that differ from the computed ones."""
    if not facts.grid.navbake:
        return  # in files of other programs, these layers may mean anything
    for level_number, level in enumerate(facts.levels):
        stored_islands = level.attributes.get("island")
        if stored_islands is not None:
            is_wrong = stored_islands != np.minimum(facts.islands[level_number], MAX_ISLAND_NUMBER)
            text = "a number in the layer `island` that isn't what is connected"
            yield from facts.report_wrong_cells(level_number, is_wrong, text)
        stored_clearance = level.attributes.get("clearance")
        if stored_clearance is not None:
            # between the centres of cells, less half a cell; nothing outside the grid is free
            padded_mask = np.pad(level.free_for_point, 1)
            distance_in_cells = distance_transform_edt(padded_mask)[1:-1, 1:-1] - 0.5
            clearance = np.where(level.free, distance_in_cells * level.lattice.cell_size, 0.0)
            is_wrong = np.abs(stored_clearance * level.unit - clearance) > CLEARANCE_TOLERANCE
            yield from facts.report_wrong_cells(level_number, is_wrong, "a wrong `clearance`")


def check_floors(facts: Facts) -> Iterator[Finding]:
    """Find free cells without a floor, or with one that is absurdly high or low."""
    for level_number, level in enumerate(facts.levels):
        if level.uses_cell_floors:
            floor = facts.floors[level_number]
            is_without_floor = facts.free[level_number] & np.isnan(floor)
            yield from facts.report_wrong_cells(
                level_number, is_without_floor, "free without a floor"
            )
            is_far = np.abs(floor) > MAX_FLOOR_HEIGHT  # False for NaN
            text = f"farther than {MAX_FLOOR_HEIGHT:g} m from 0"
            yield from facts.report_wrong_cells(level_number, is_far, text)


class _Patch(NamedTuple):
    """An island above or below its surroundings; sorted, errors come first, then larger islands."""

    is_remark: bool
    negative_area: float  # minus the area [m²]
    island: int
    text: str  # of the finding


def check_jumps(facts: Facts) -> Iterator[Finding]:
    """Find patches of floor more than a step above or below the floor around them.

    Such a patch is a spike, a pit, or the top of an object. It is an error if it is too small for a
    floor, and nearly all of its outline jumps. If the grid is for lower steps than it was baked
    for, it may as well be the tread of a stair, and is no error.
    """
    patches = sorted(_find_jumping_patches(facts))
    for patch in patches[:MAX_PATCHES]:
        # the level that has most of it, and a cell in its middle
        cells_of_levels = [np.flatnonzero(island == patch.island) for island in facts.islands]
        level_number = max(
            range(len(cells_of_levels)), key=lambda level: len(cells_of_levels[level])
        )
        cells = cells_of_levels[level_number]
        row, col = divmod(int(cells[len(cells) // 2]), facts.levels[level_number].width)
        severity = REMARK if patch.is_remark else ERROR
        yield Finding(
            severity, level_number, facts.find_position(level_number, row, col), patch.text
        )
    unreported_patches = patches[MAX_PATCHES:]
    if unreported_patches:
        severity = REMARK if unreported_patches[0].is_remark else ERROR
        text = f"{len(unreported_patches)} more patches of floor jump"
        yield Finding(severity, None, None, text)


def _find_jumping_patches(facts: Facts) -> Iterator[_Patch]:
    """Yield the islands that lie above or below most of the floor around them."""
    floor_settings = facts.settings.get("floors")
    min_area = floor_settings.get("min_area") if isinstance(floor_settings, dict) else None
    if not isinstance(min_area, int | float):
        min_area = MIN_FLOOR_AREA
    islands = facts.islands
    num_islands = (
        max((int(level_islands.max(initial=0)) for level_islands in islands), default=0) + 1
    )
    num_cells = np.zeros(num_islands, dtype=np.int64)
    num_edges = np.zeros(num_islands, dtype=np.int64)  # cells' edges in each outline
    jumps_by_direction = {
        "above": _Jumps.make_zero(num_islands),
        "below": _Jumps.make_zero(num_islands),
    }
    for level_number, level_islands in enumerate(islands):
        num_cells += np.bincount(level_islands.ravel(), minlength=num_islands)
        padded_islands = np.pad(level_islands, 1)  # beyond the edge is no island
        for first_slices, second_slices in (ABOVE_AND_BELOW, LEFT_AND_RIGHT):
            is_different = padded_islands[first_slices] != padded_islands[second_slices]
            num_edges += np.bincount(
                padded_islands[first_slices][is_different], minlength=num_islands
            )
            num_edges += np.bincount(
                padded_islands[second_slices][is_different], minlength=num_islands
            )
        # free neighbours are on two islands only where they lie more than a step apart
        flat_island = level_islands.ravel()
        floor = facts.floors[level_number].ravel()
        for cells, id_offset in find_differing_pairs(level_islands, 1):
            cells = cells[(flat_island[cells] > 0) & (flat_island[cells + id_offset] > 0)]
            height_drops = floor[cells] - floor[cells + id_offset]
            jumps_by_direction["above"].add(flat_island[cells + id_offset], -height_drops)
            jumps_by_direction["below"].add(flat_island[cells + id_offset], height_drops)
            jumps_by_direction["above"].add(flat_island[cells], height_drops)
            jumps_by_direction["below"].add(flat_island[cells], -height_drops)
    num_cells[0] = 0
    island_areas = num_cells * facts.levels[0].lattice.cell_size ** 2
    for direction, island_jumps in jumps_by_direction.items():
        jump_fraction = island_jumps.num_edges / np.maximum(num_edges, 1)
        jump_fraction[0] = 0.0
        for island_number in np.flatnonzero(jump_fraction >= MIN_JUMP_SHARE).tolist():
            is_nearly_all = jump_fraction[island_number] >= ERROR_JUMP_SHARE
            mean_jump_height = (
                island_jumps.total_height[island_number] / island_jumps.num_edges[island_number]
            )
            surroundings_text = "all" if is_nearly_all else "most of what is"
            count_text = count_of(int(num_cells[island_number]), "cell")
            size_text = f"{island_areas[island_number]:.3g} m² of floor ({count_text})"
            text = (
                f"{size_text} lies {mean_jump_height:.2f} m {direction} {surroundings_text} round "
                "it, and no step leads there"
            )
            is_error = (
                is_nearly_all
                and island_areas[island_number] < min_area
                and not facts.has_lower_step
            )
            yield _Patch(not is_error, -island_areas[island_number], island_number, text)


class _Jumps(NamedTuple):
    """Jumps at the outlines of all islands, up or down; arrays are indexed by the island."""

    num_edges: Float  # number of cells' edges in the outline with a jump
    total_height: Float  # sum of the heights of these jumps [m]

    @classmethod
    def make_zero(cls, num_islands: int) -> _Jumps:
        """Make the sums for islands before any edge is added: all are 0."""
        return cls(np.zeros(num_islands), np.zeros(num_islands))

    def add(self, islands: NDArray[np.int32], heights: Float) -> None:
        """Add edges to the outlines of islands.

        Args:
            islands: the island of each edge, shape (n,).
            heights: the height of each edge's jump, shape (n,) [m]; edges with heights <= 0 are
                ignored.
        """
        is_jump = heights > 0
        jumping_islands = islands[is_jump]
        self.num_edges[:] += np.bincount(jumping_islands, minlength=len(self.num_edges))
        self.total_height[:] += np.bincount(
            jumping_islands, heights[is_jump], minlength=len(self.total_height)
        )


def find_differing_pairs(values: NDArray[Any], distance: int) -> Iterator[tuple[Int, int]]:
    """Find the pairs of cells of a level, a distance apart, whose values differ.

    Args:
        values: the value of each cell, shape (height, width).
        distance: the distance between both cells of a pair [columns or rows].

    Yields:
        For the pairs in the same row: the ids (``row * width + col``) of their left cells, shape
        (n,), and what to add to an id for the id of the right cell. Then the same for the pairs in
        the same column, with their upper and lower cells.
    """
    width = values.shape[1]
    is_right_different = values[:, :-distance] != values[:, distance:]
    is_below_different = values[:-distance] != values[distance:]
    for is_different, id_offset in (
        (is_right_different, distance),
        (is_below_different, distance * width),
    ):
        rows, cols = np.nonzero(is_different)  # few differ, so the caller's work on them is short
        yield rows * width + cols, id_offset


class _Gap(NamedTuple):
    """Blocked cells between two islands."""

    area: float  # area of the smaller island [m²]
    level: int
    cells: list[int]  # ids of the cells on the level, ascending


def check_cut_off(facts: Facts) -> Iterator[Finding]:
    """Find pairs of islands with a wall between them that is one cell thick and up to three long.

    The wall consists of the blocked cells with one island on each side, and floors on both sides
    that are at most a step apart. All doors are open. Longer walls are not reported. Where only an
    inflation blocks some of the wall's cells, nothing else is counted: these cells are a gap.
    """
    gaps = sorted(_find_gaps(facts), key=lambda gap: -gap.area)
    for gap in gaps[:MAX_GAPS]:
        level = facts.levels[gap.level]
        row, col = divmod(gap.cells[len(gap.cells) // 2], level.width)
        gap_width = len(gap.cells) * level.lattice.cell_size
        text = (
            f"a gap {gap_width:.2f} m wide is blocked by one cell, and cuts off {gap.area:.1f} m²"
        )
        yield Finding(REMARK, gap.level, facts.find_position(gap.level, row, col), text)


def _find_gaps(facts: Facts) -> Iterator[_Gap]:
    """Yield the gaps of at most `MAX_GAP_CELLS` blocked cells between two large islands."""
    islands = facts.open_islands
    num_islands = (
        max((int(island_of_cell.max(initial=0)) for island_of_cell in islands), default=0) + 1
    )
    if num_islands < 3:
        return
    num_cells_of_levels = [
        np.bincount(island_of_cell.ravel(), minlength=num_islands) for island_of_cell in islands
    ]
    island_areas = np.sum(num_cells_of_levels, axis=0) * facts.levels[0].lattice.cell_size ** 2
    for level_number, level_islands in enumerate(islands):
        is_occupied = facts.levels[level_number].occupancy.ravel() != 0
        floor_heights = facts.floors[level_number].ravel()
        island_of_cell = level_islands.ravel()
        cells_between: dict[tuple[int, ...], set[int]] = {}  # both islands -> cells
        for cells, id_offset in find_differing_pairs(level_islands, 2):
            middle_cells = cells + id_offset // 2
            cells_beyond = cells + id_offset
            is_gap = (
                (island_of_cell[cells] > 0)
                & (island_of_cell[middle_cells] == 0)
                & (island_of_cell[cells_beyond] > 0)
            )
            is_gap &= ~np.isnan(floor_heights[middle_cells])
            with np.errstate(invalid="ignore"):
                is_gap &= ~(
                    np.abs(floor_heights[cells] - floor_heights[cells_beyond]) > facts.step_limit
                )
            island_pairs = np.sort(
                np.stack([island_of_cell[cells], island_of_cell[cells_beyond]], axis=1)[is_gap],
                axis=1,
            )
            for island_pair, cell in zip(
                island_pairs.tolist(), middle_cells[is_gap].tolist(), strict=True
            ):
                cells_between.setdefault(tuple(island_pair), set()).add(cell)
        for island_pair, blocked_cells in cells_between.items():
            gap_cells = {cell for cell in blocked_cells if not is_occupied[cell]} or blocked_cells
            smaller_area = min(island_areas[list(island_pair)])
            if len(gap_cells) <= MAX_GAP_CELLS and smaller_area >= MIN_CUT_OFF_AREA:
                yield _Gap(smaller_area, level_number, sorted(gap_cells))


def check_unreached_levels(facts: Facts) -> Iterator[Finding]:
    """Find levels that no steps connect with the level that has the most free cells."""
    num_levels = len(facts.levels)
    num_free = [int(is_free.sum()) for is_free in facts.free]
    level_pairs = tuple(facts.steps[:, ::2].T)
    edge_values = np.ones(len(facts.steps))
    graph = coo_array((edge_values, level_pairs), (num_levels, num_levels))
    _, group_of_level = connected_components(graph, directed=False)
    for level_number in np.flatnonzero(
        group_of_level != group_of_level[np.argmax(num_free)]
    ).tolist():
        if num_free[level_number]:  # else `check_empty_levels` reports it
            area = num_free[level_number] * facts.levels[level_number].lattice.cell_size ** 2
            place = facts.find_first_position(level_number, facts.free[level_number])
            yield Finding(REMARK, level_number, place, f"no link leads to its {area:.1f} m²")
