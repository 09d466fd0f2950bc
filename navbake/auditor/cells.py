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
FEW_FREE = 0.01  # with a smaller share of free cells, hardly any cell of a level is free
CLEARANCE_TOLERANCE = 1e-3  # largest error of a stored clearance [m]
MAX_ISLAND_NUMBER = 65_535  # stands for this island and all smaller ones: the layer is uint16
MAX_FLOOR_HEIGHT = 10_000.0  # floors farther from z = 0 must be in a wrong unit [m]
# smallest area of a floor that no step leads to, unless the settings of the bake have another [m²]
MIN_FLOOR_AREA = 1.0
# share of a patch's outline that jumps: from the first share on, a patch is reported; from the
# second on, it is an error (a corner of it may touch a wall)
MIN_JUMP_SHARE = 0.5
NEARLY_ALL = 0.75
MAX_PATCHES = 10  # number of patches that are reported one by one
MIN_CUT_OFF_AREA = 1.0  # gaps between islands are reported if both islands are larger [m²]
MAX_GAP_CELLS = 3  # more blocked cells between two islands are a thin wall
MAX_GAPS = 10  # number of gaps that are reported, those at the largest islands first


def check_all_free(facts: Facts) -> Iterator[Finding]:
    """Finds: a grid whose cells are all free, without even a wall."""
    total = sum(free.size for free in facts.free)
    if total >= MIN_CELLS and all(free.all() for free in facts.free):
        text = f"all {total} cells are free: nothing stands on the floor, and it ends nowhere"
        yield Finding(REMARK, None, None, text)


def check_empty_levels(facts: Facts) -> Iterator[Finding]:
    """Finds: levels without a floor, and levels or grids without a free cell.

    Missing free cells are a remark only if the grid is inflated: the inflation may have closed all.
    """
    severity = ERROR
    inflated = ""
    if facts.inflation_reach is not None:
        severity = REMARK
        inflated = f", inflated by {facts.inflation_reach:g} m"
    if not any(free.any() for free in facts.free):
        yield Finding(severity, None, None, f"no cell is free, on any level{inflated}")
        return
    for number, free in enumerate(facts.free):
        if free.any():
            continue
        num_floors = np.count_nonzero(~np.isnan(facts.floors[number]))
        if num_floors:
            text = f"none of its {num_floors} cells with a floor is free{inflated}"
            yield Finding(severity, number, None, text)
        else:
            yield Finding(ERROR, number, None, "no floor")


def check_free_share(facts: Facts) -> Iterator[Finding]:
    """Finds: levels where hardly any cell is free, such as a black map with a few specks."""
    for number, (level, free) in enumerate(zip(facts.levels, facts.free, strict=True)):
        is_floor = free | ~np.isnan(facts.floors[number])
        total = np.count_nonzero(is_floor) if level.uses_cell_floors else free.size
        num_free = np.count_nonzero(free)
        if total >= MIN_CELLS and 0 < num_free < FEW_FREE * total:
            text = f"only {num_free} of {total} cells are free"
            yield Finding(REMARK, number, facts.first_place(number, free), text)


def check_weights(facts: Facts) -> Iterator[Finding]:
    """Finds: cells whose weight contradicts their occupancy, or is NaN or negative."""
    reach = facts.inflation_reach
    for number, level in enumerate(facts.levels):
        weights = level.weights
        occupied = level.occupancy != 0
        free = facts.free[number]
        is_no_cost = np.isnan(weights) | (weights < 0)
        yield from facts.error_on_cells(number, is_no_cost, "a weight that is no cost")
        if "occupancy" not in level.attributes:
            continue
        opened_by_inflation = (reach is not None) & (level.solid == 0)
        free_but_occupied = free & occupied & ~opened_by_inflation
        yield from facts.error_on_cells(number, free_but_occupied, "free by weight, but occupied")
        blocked = ~free & ~is_no_cost & ~occupied
        text = "blocked by weight, but not occupied"
        if reach is not None and blocked.any():
            blocked &= ~mark_cells_inflation_may_block(facts.grid, number, reach)
            text += f", and nothing that an inflation avoids is within {reach:g} m"
        yield from facts.error_on_cells(number, blocked, text)


def mark_cells_inflation_may_block(grid: GridBase, number: int, max_distance: float) -> Bool:
    """Mark the cells of a level that an inflation may have blocked.

    A cell is marked if there is a reason in a square around it: an occupied cell, a cell without a
    floor, a floor more than a step higher or lower, a floor of another level that is less than the
    agent's height from the heights of this level, or the edge of the level. The square is slightly
    larger than `max_distance`, so that no reason is missed.

    Args:
        grid: the grid.
        number: the level's index.
        max_distance: how far from a cell's centre an inflation looks for reasons [m].

    Returns:
        A mask of the cells, shape (height, width).
    """
    level = grid.levels[number]
    floor = level.floor
    has_floor = ~np.isnan(floor)
    is_avoided = (level.occupancy != 0) | ~has_floor
    if has_floor.any():
        lowest = floor[has_floor].min() - grid.agent_height
        highest = floor[has_floor].max() + grid.agent_height
        for neighbor in grid.levels:
            if neighbor is level:
                continue
            is_near = (neighbor.floor > lowest) & (neighbor.floor < highest)
            positions = neighbor.lattice.positions(*np.nonzero(is_near))
            rows, cols = level.lattice.rows_cols(positions)
            inside = level.lattice.holds(rows, cols)
            is_avoided[rows[inside], cols[inside]] = True
    num_cells = min(math.ceil(max_distance / level.lattice.cell_size) + 1, max(level.shape))
    size = 2 * num_cells + 1
    has_reason: Bool = maximum_filter(is_avoided, size, mode="constant", cval=True)
    highest_near = maximum_filter(np.where(has_floor, floor, -np.inf), size)
    lowest_near = minimum_filter(np.where(has_floor, floor, np.inf), size)
    with np.errstate(invalid="ignore"):  # where there is no floor
        has_reason |= highest_near - floor > grid.max_step
        has_reason |= floor - lowest_near > grid.max_step
    return has_reason


def check_inflation(facts: Facts) -> Iterator[Finding]:
    """Finds: metadata that don't state properly for which radius the grid was inflated."""
    _, problem = read_inflations(facts.grid)
    if problem is not None:
        # in files of other programs, `inflation` may mean anything
        yield Finding(ERROR if facts.grid.navbake else REMARK, None, None, problem)


def check_layers(facts: Facts) -> Iterator[Finding]:
    """Finds: stored `island` and `clearance` layers that differ from the computed ones."""
    if not facts.grid.navbake:
        return  # in files of other programs, these layers may mean anything
    for number, level in enumerate(facts.levels):
        stored_island = level.attributes.get("island")
        if stored_island is not None:
            wrong = stored_island != np.minimum(facts.islands[number], MAX_ISLAND_NUMBER)
            text = "a number in the layer `island` that isn't what is connected"
            yield from facts.error_on_cells(number, wrong, text)
        stored_clearance = level.attributes.get("clearance")
        if stored_clearance is not None:
            # between the centres of cells, less half a cell; nothing outside the grid is free
            padded = np.pad(level.free_for_point, 1)
            num_cells = distance_transform_edt(padded)[1:-1, 1:-1] - 0.5
            clearance = np.where(level.free, num_cells * level.lattice.cell_size, 0.0)
            wrong = np.abs(stored_clearance * level.unit - clearance) > CLEARANCE_TOLERANCE
            yield from facts.error_on_cells(number, wrong, "a wrong `clearance`")


def check_floors(facts: Facts) -> Iterator[Finding]:
    """Finds: free cells without a floor, or with one that is absurdly high or low."""
    for number, level in enumerate(facts.levels):
        if level.uses_cell_floors:
            floor = facts.floors[number]
            without_floor = facts.free[number] & np.isnan(floor)
            yield from facts.error_on_cells(number, without_floor, "free without a floor")
            is_far = np.abs(floor) > MAX_FLOOR_HEIGHT  # False for NaN
            text = f"farther than {MAX_FLOOR_HEIGHT:g} m from 0"
            yield from facts.error_on_cells(number, is_far, text)


class _Patch(NamedTuple):
    """An island above or below its surroundings; sorted, errors come first, then larger islands."""

    is_remark: bool
    negative_area: float  # minus the area [m²]
    island: int
    text: str  # of the finding


def check_jumps(facts: Facts) -> Iterator[Finding]:
    """Finds: patches of floor more than a step above or below the floor around them.

    Such a patch is a spike, a pit, or the top of an object. It is an error if it is too small for a
    floor, and nearly all of its outline jumps.
    """
    patches = sorted(_find_jumping_patches(facts))
    for patch in patches[:MAX_PATCHES]:
        # the level that has most of it, and a cell in its middle
        cells_of_levels = [np.flatnonzero(island == patch.island) for island in facts.islands]
        number = max(range(len(cells_of_levels)), key=lambda level: len(cells_of_levels[level]))
        cells = cells_of_levels[number]
        row, col = divmod(int(cells[len(cells) // 2]), facts.levels[number].width)
        severity = REMARK if patch.is_remark else ERROR
        yield Finding(severity, number, facts.place(number, row, col), patch.text)
    remaining = patches[MAX_PATCHES:]
    if remaining:
        severity = REMARK if remaining[0].is_remark else ERROR
        text = f"{len(remaining)} more patches of floor jump"
        yield Finding(severity, None, None, text)


def _find_jumping_patches(facts: Facts) -> Iterator[_Patch]:
    """Yield the islands that lie above or below most of the floor around them."""
    floor_settings = facts.settings.get("floors")
    min_area = floor_settings.get("min_area") if isinstance(floor_settings, dict) else None
    if not isinstance(min_area, int | float):
        min_area = MIN_FLOOR_AREA
    islands = facts.islands
    num_islands = max((int(island.max(initial=0)) for island in islands), default=0) + 1
    num_cells = np.zeros(num_islands, dtype=np.int64)
    num_edges = np.zeros(num_islands, dtype=np.int64)  # cells' edges in each outline
    jumps = {"above": _Jumps.none(num_islands), "below": _Jumps.none(num_islands)}
    for number, island in enumerate(islands):
        num_cells += np.bincount(island.ravel(), minlength=num_islands)
        padded = np.pad(island, 1)  # beyond the edge is no island
        for first, second in (ABOVE_AND_BELOW, LEFT_AND_RIGHT):
            differs = padded[first] != padded[second]
            num_edges += np.bincount(padded[first][differs], minlength=num_islands)
            num_edges += np.bincount(padded[second][differs], minlength=num_islands)
        # free neighbours are on two islands only where they lie more than a step apart
        flat_island = island.ravel()
        floor = facts.floors[number].ravel()
        for cells, offset in pairs_across(island, 1):
            cells = cells[(flat_island[cells] > 0) & (flat_island[cells + offset] > 0)]
            drop = floor[cells] - floor[cells + offset]
            jumps["above"].add(flat_island[cells + offset], -drop)
            jumps["below"].add(flat_island[cells + offset], drop)
            jumps["above"].add(flat_island[cells], drop)
            jumps["below"].add(flat_island[cells], -drop)
    num_cells[0] = 0
    area = num_cells * facts.levels[0].lattice.cell_size ** 2
    for direction, jump in jumps.items():
        share = jump.num_edges / np.maximum(num_edges, 1)
        share[0] = 0.0
        for patch in np.flatnonzero(share >= MIN_JUMP_SHARE).tolist():
            is_nearly_all = share[patch] >= NEARLY_ALL
            height = jump.total[patch] / jump.num_edges[patch]
            surroundings = "all" if is_nearly_all else "most of what is"
            size = f"{area[patch]:.3g} m² of floor ({count_of(int(num_cells[patch]), 'cell')})"
            text = f"{size} lies {height:.2f} m {direction} {surroundings} round it, and no step "
            text += "leads there"
            is_error = is_nearly_all and area[patch] < min_area
            yield _Patch(not is_error, -area[patch], patch, text)


class _Jumps(NamedTuple):
    """Jumps at the outlines of all islands, up or down; arrays are indexed by the island."""

    num_edges: Float  # number of cells' edges in the outline with a jump
    total: Float  # sum of the heights of these jumps [m]

    @classmethod
    def none(cls, num_islands: int) -> _Jumps:
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
        jumping = islands[is_jump]
        self.num_edges[:] += np.bincount(jumping, minlength=len(self.num_edges))
        self.total[:] += np.bincount(jumping, heights[is_jump], minlength=len(self.total))


def pairs_across(values: NDArray[Any], gap: int) -> Iterator[tuple[Int, int]]:
    """Yield pairs of cells side by side, then pairs above each other, whose values differ.

    Args:
        values: the value of each cell, shape (height, width).
        gap: the distance between both cells of a pair, in columns or rows.

    Yields:
        The flat ids of the left or upper cells of the pairs, shape (n,), and the offset to add to
        an id to get the pair's second cell.
    """
    width = values.shape[1]
    differs_right = values[:, :-gap] != values[:, gap:]
    differs_below = values[:-gap] != values[gap:]
    for differs, offset in ((differs_right, gap), (differs_below, gap * width)):
        rows, cols = np.nonzero(differs)  # few differ, so the caller's work on them is short
        yield rows * width + cols, offset


class _Gap(NamedTuple):
    """Blocked cells between two islands."""

    area: float  # area of the smaller island [m²]
    level: int
    cells: list[int]  # ids of the cells on the level, ascending


def check_cut_off(facts: Facts) -> Iterator[Finding]:
    """Finds: islands that only one to three blocked cells separate, with all doors open.

    The blocked cells form a line one cell thick. More such cells between the same two islands are
    taken for a thin wall. But if some of them are not occupied, only these count: they are a gap in
    the wall that an inflation blocked. The floors on both sides must be at most a step apart.
    """
    gaps = sorted(_find_gaps(facts), key=lambda gap: -gap.area)
    for gap in gaps[:MAX_GAPS]:
        level = facts.levels[gap.level]
        row, col = divmod(gap.cells[len(gap.cells) // 2], level.width)
        width = len(gap.cells) * level.lattice.cell_size
        text = f"a gap {width:.2f} m wide is blocked by one cell, and cuts off {gap.area:.1f} m²"
        yield Finding(REMARK, gap.level, facts.place(gap.level, row, col), text)


def _find_gaps(facts: Facts) -> Iterator[_Gap]:
    """Yield the gaps of at most `MAX_GAP_CELLS` blocked cells between two large islands."""
    islands = facts.open_islands
    num_islands = max((int(island.max(initial=0)) for island in islands), default=0) + 1
    if num_islands < 3:
        return
    counts = [np.bincount(island.ravel(), minlength=num_islands) for island in islands]
    area = np.sum(counts, axis=0) * facts.levels[0].lattice.cell_size ** 2
    for number, level_islands in enumerate(islands):
        occupied = facts.levels[number].occupancy.ravel() != 0
        floor = facts.floors[number].ravel()
        island = level_islands.ravel()
        cells_between: dict[tuple[int, ...], set[int]] = {}  # both islands -> cells
        for cells, offset in pairs_across(level_islands, 2):
            middle = cells + offset // 2
            beyond = cells + offset
            is_gap = (island[cells] > 0) & (island[middle] == 0) & (island[beyond] > 0)
            is_gap &= ~np.isnan(floor[middle])
            with np.errstate(invalid="ignore"):
                is_gap &= ~(np.abs(floor[cells] - floor[beyond]) > facts.step_limit)
            pairs = np.sort(np.stack([island[cells], island[beyond]], axis=1)[is_gap], axis=1)
            for pair, cell in zip(pairs.tolist(), middle[is_gap].tolist(), strict=True):
                cells_between.setdefault(tuple(pair), set()).add(cell)
        for pair, between in cells_between.items():
            gap_cells = {cell for cell in between if not occupied[cell]} or between
            smaller_area = min(area[list(pair)])
            if len(gap_cells) <= MAX_GAP_CELLS and smaller_area >= MIN_CUT_OFF_AREA:
                yield _Gap(smaller_area, number, sorted(gap_cells))


def check_unreached_levels(facts: Facts) -> Iterator[Finding]:
    """Finds: levels that no steps connect with the level that has the most free cells."""
    num_levels = len(facts.levels)
    num_free = [int(free.sum()) for free in facts.free]
    linked_levels = tuple(facts.links[:, ::2].T)
    ones = np.ones(len(facts.links))
    graph = coo_array((ones, linked_levels), (num_levels, num_levels))
    _, group = connected_components(graph, directed=False)
    for number in np.flatnonzero(group != group[np.argmax(num_free)]).tolist():
        if num_free[number]:  # else `check_empty_levels` reports it
            area = num_free[number] * facts.levels[number].lattice.cell_size ** 2
            place = facts.first_place(number, facts.free[number])
            yield Finding(REMARK, number, place, f"no link leads to its {area:.1f} m²")
