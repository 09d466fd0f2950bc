"""Finds free cells that a map must show as occupied, and describes the losses of writing a map.

A map without heights shows a stair as flat floor, and a planner of wheeled robots would plan up the
stair. So navbake writes the stair's cells as occupied, unless its user wants them free. A map
without areas would let robots into areas that bar them, so their cells are written as occupied,
too.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from navbake.errors import FormatError
from navbake.known_names import check_choice
from navbake.lazy import lazy
from navbake.lengths import format_length
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import STEP_SLACK, label_islands, step_limit, values_by_area
from navbake.navgrid.links import Agent
from navbake.types import Bool, Float, Int, JsonValue

ndimage = lazy("scipy.ndimage")

STAIRS_CHOICES = ("occupied", "free")
DEFAULT_MAX_SLOPE = 45.0  # of a grid whose file doesn't state it [degrees]
# A rise from a cell to the next one up to the first value is no step for any wheel; from the second
# one on it is the riser of a stair (the least of the International Building Code, 1011.5.2: 4 in)
LEAST_RISE_LIMIT = 0.05  # [m]
LEAST_RISER = 0.1  # [m]
# A stair whose treads are deeper than a cell has level ground between its rises, a ramp has none:
# equal rises in more cells in a row than treads allow are a ramp. Treads are at least this deep
# (the same code, 1011.5.2, asks for 11 in, in dwellings for 10 in)
LEAST_TREAD = 0.25  # [m]
RISE_TOLERANCE = 0.05  # by which the equal rises of a ramp differ at most [m]
# How many times as large as the largest floor of the rooms a floor outdoors is, to be the ground
OUTDOORS_FACTOR = 4
HEIGHT_BIN = 0.01  # floors that differ by less than that have the same height [m]
MAX_LISTED_NAMES = 5  # of links, areas and agents in the line that tells what is lost


class ClosedCells(NamedTuple):
    """The free cells of a grid that a file shows as occupied, so that no robot drives there.

    The file's format can't say that a cell is on a stair, or in an area that bars the robot.

    Attributes:
        stair_masks: for each level, the cells of stairs, and of floors that can be reached only
            over stairs or other rises between cells, see `find_stair_cells`; shape (height, width),
            bool.
        barred_masks: for each level, the cells of areas that bar the agent, of the same shape.
    """

    stair_masks: list[Bool]
    barred_masks: list[Bool]

    def join_masks(self) -> list[Bool]:
        """Return for each level the mask of all closed cells, shape (height, width), bool."""
        return [
            stair_mask | barred_mask
            for stair_mask, barred_mask in zip(self.stair_masks, self.barred_masks, strict=True)
        ]


def find_closed_cells(
    grid: NavGrid,
    *,
    stairs: str | None = "occupied",
    agent: str | Agent | None = None,
    closes_areas: bool = True,
) -> ClosedCells:
    """Find the free cells that a map without heights and areas must show as occupied.

    Args:
        grid: the grid, not inflated for the map.
        stairs: ``occupied`` to close stairs and the floors beyond them, see `find_stair_cells`;
            ``free`` to close none. None means ``occupied``.
        agent: the agent that the map is for: its name in the grid, or the agent itself. None means
            any: only areas that bar all agents are closed.
        closes_areas: whether to close the cells of areas that bar the agent, too.

    Returns:
        The cells.

    Raises:
        FormatError: `stairs` is another word.
        QueryError: the grid has no such agent.
    """
    from navbake.runtime.agents import find_agent  # loads the run time

    if stairs is not None:
        check_choice(stairs, STAIRS_CHOICES, "stairs", FormatError)
    map_agent = find_agent(grid, agent)
    empty_masks = [np.zeros(level.shape, dtype=bool) for level in grid.levels]
    stair_masks = empty_masks
    if stairs != "free":
        stair_masks = [find_stair_cells(grid, number) for number in range(len(grid.levels))]
    barred_masks = empty_masks
    is_barred_area = [area.bars(map_agent) for area in grid.areas]
    if closes_areas and any(is_barred_area):
        is_barred_cell = values_by_area(grid, is_barred_area, False)
        level_stops = np.cumsum([level.width * level.height for level in grid.levels])
        barred_masks = [
            is_barred_on_level.reshape(level.shape) & level.free
            for is_barred_on_level, level in zip(
                np.split(is_barred_cell, level_stops[:-1]), grid.levels, strict=True
            )
        ]
    return ClosedCells(stair_masks, barred_masks)


def find_stair_cells(grid: NavGrid, level_number: int) -> Bool:
    """Find the stairs of a level, and the floors that a wheeled robot reaches only over stairs.

    A floor is smooth where it rises from cell to cell by no more than the grid's largest slope
    allows, and by less than the riser of a stair. A rise by more is smooth, too, if it is as even
    as that of a ramp (see `_find_ramp_steps`).

    The ground height of the level is the commonest height of its largest smooth floor. A floor
    outdoors counts for a quarter of its size, so that the floor of the rooms is taken except in
    small buildings. A cell is ground if its floor is within a step (the grid's
    `traversableFloorHeight`) of the ground height. A robot reaches the ground, and all that smooth
    floor joins to it, such as a ramp and the floor at its top. All other free cells are returned:
    stairs, landings, platforms, and floors below a ledge.

    A part of the level that no free cells connect with the ground gets a ground height of its own,
    unless a step from another level leads to it.

    Args:
        grid: the grid.
        level_number: the level's number.

    Returns:
        Mask of these cells, shape (height, width), bool; all False if the grid has no floor
        heights.
    """
    level = grid.levels[level_number]
    is_free = level.free
    is_closed = np.zeros(level.shape, dtype=bool)
    floor = level.floor
    has_floor = is_free & ~np.isnan(floor)
    if not level.uses_cell_floors or not has_floor.any():
        return is_closed
    max_step = step_limit(grid) * grid.unit
    num_cells = level.width * level.height
    smooth_part_of_cell = label_islands(  # the largest is number 1
        first_cells=np.array([0, num_cells]),
        widths=np.array([level.width]),
        is_free=has_floor.ravel(),
        floor=floor.ravel(),
        max_rise=_find_rise_limit(grid, level),
        steps=_find_ramp_steps(
            np.where(has_floor, floor, np.nan),
            _find_slope_rise(grid, level),
            level.lattice.cell_size,
        ),
    ).reshape(level.shape)
    outdoor_rooms = [
        room.index for room in grid.rooms if room.level == level_number and room.outdoors
    ]
    is_outdoors = np.isin(level.room_index, outdoor_rooms)
    part_sizes = np.bincount(smooth_part_of_cell[has_floor])
    indoor_part_sizes = np.bincount(
        smooth_part_of_cell[has_floor & ~is_outdoors], minlength=len(part_sizes)
    )
    is_in_ground_part = has_floor & (smooth_part_of_cell == 1)
    if indoor_part_sizes.max() * OUTDOORS_FACTOR >= part_sizes.max():
        is_in_ground_part = (
            has_floor & ~is_outdoors & (smooth_part_of_cell == indoor_part_sizes.argmax())
        )
    ground_height = find_commonest_height(floor[is_in_ground_part])
    # a free cell without a floor counts as ground: its NaN is not more than a step away
    is_ground = is_free & ~(np.abs(floor - ground_height) > max_step)
    if not (is_free & ~is_ground).any():
        return is_closed

    region_of_cell, num_regions = ndimage.label(is_free, structure=np.ones((3, 3)))
    has_step_from_other_level = np.zeros(num_regions + 1, dtype=bool)
    flat_region_of_cell = region_of_cell.ravel()
    for first_level, first_cell, second_level, second_cell in grid.step_array:
        if first_level != second_level:
            if first_level == level_number:
                has_step_from_other_level[flat_region_of_cell[first_cell]] = True
            if second_level == level_number:
                has_step_from_other_level[flat_region_of_cell[second_cell]] = True
    has_ground = np.zeros(num_regions + 1, dtype=bool)
    has_ground[region_of_cell[is_ground]] = True
    has_own_ground = ~has_ground & ~has_step_from_other_level
    has_own_ground[0] = False  # the cells that are not free
    for region in np.flatnonzero(has_own_ground).tolist():
        is_in_region = region_of_cell == region
        largest_part = smooth_part_of_cell[is_in_region].min()
        region_height = find_commonest_height(
            floor[is_in_region & (smooth_part_of_cell == largest_part)]
        )
        is_ground |= is_in_region & ~(np.abs(floor - region_height) > max_step)
    is_reached_part = np.zeros(int(smooth_part_of_cell.max()) + 1, dtype=bool)
    is_reached_part[smooth_part_of_cell[is_ground]] = True
    is_closed[is_free] = ~is_reached_part[smooth_part_of_cell[is_free]]
    return is_closed


def find_commonest_height(floor: Float) -> float:
    """Find the commonest height of some floors, with heights rounded to a centimetre.

    If several heights are equally common, the lowest one counts.

    Args:
        floor: the heights [m], not NaN, shape (n,), n > 0.

    Returns:
        The mean of the heights that round to the commonest one [m].
    """
    height_bins = np.round(floor / HEIGHT_BIN)
    unique_bins, bin_counts = np.unique(height_bins, return_counts=True)
    return float(floor[height_bins == unique_bins[bin_counts.argmax()]].mean())


def _find_slope_rise(grid: NavGrid, level: SceneGrid2D) -> float:
    """Return by how much the grid's largest slope rises from a cell to the next one [m]."""
    max_slope: JsonValue = grid.navbake.get("maxSlope")
    if type(max_slope) not in (int, float) or not 0 <= max_slope < 90:
        max_slope = DEFAULT_MAX_SLOPE
    return level.lattice.cell_size * math.tan(math.radians(max_slope)) + STEP_SLACK


def _find_rise_limit(grid: NavGrid, level: SceneGrid2D) -> float:
    """Return by how much any smooth floor may rise from a cell to the next one [m]."""
    rise = _find_slope_rise(grid, level)
    return min(max(rise, LEAST_RISE_LIMIT), LEAST_RISER - STEP_SLACK)


def _find_ramp_steps(floor: Float, slope_rise: float, cell_size: float) -> Int:
    """Find the pairs of cells side by side in which a floor rises by a riser or more, as a ramp.

    A ramp rises equally in so many cells in a row that the treads of a stair would be seen between
    the rises. Its first and last rise may be smaller. Where a tread can be as deep as a cell,
    ramps and stairs look alike, and there are no such pairs.

    Args:
        floor: the level's floor, NaN for none, shape (height, width) [m].
        slope_rise: by how much the largest slope rises from a cell to the next one [m].
        cell_size: the edge of a cell [m].

    Returns:
        The flat ids of the two cells of each pair, shape (n, 2), int64.
    """
    no_steps = np.empty((0, 2), dtype=np.int64)
    if cell_size >= LEAST_TREAD or slope_rise < LEAST_RISER:
        return no_steps
    # of m rises of a stair in a row, all have a riser only if m - 1 treads fit into m cells
    num_rises = math.floor(LEAST_TREAD / (LEAST_TREAD - cell_size)) + 1
    cells = np.arange(floor.size).reshape(floor.shape)
    step_lists = [no_steps]
    for heights, cell_ids in ((floor, cells), (floor.T, cells.T)):
        rises = np.diff(heights, axis=1)
        if rises.shape[1] < num_rises:
            continue
        rise_windows = sliding_window_view(rises, num_rises, axis=1)
        lowest_rise = rise_windows.min(axis=2)  # NaN where a cell has no floor
        highest_rise = rise_windows.max(axis=2)
        for sign, least_rise, most_rise in (
            (1.0, lowest_rise, highest_rise),
            (-1.0, -highest_rise, -lowest_rise),
        ):
            is_even = (
                (least_rise > 0.0)
                & (most_rise <= slope_rise)
                & (most_rise - least_rise <= RISE_TOLERANCE)
            )
            # the largest rise of the windows that a rise is in or beside
            window_rise = np.pad(
                np.where(is_even, most_rise, 0.0), ((0, 0), (num_rises, num_rises))
            )
            largest_rise = sliding_window_view(window_rise, num_rises + 2, axis=1).max(axis=2)
            is_ramp = (sign * rises > 0.0) & (sign * rises <= largest_rise)
            step_lists.append(
                np.stack([cell_ids[:, :-1][is_ramp], cell_ids[:, 1:][is_ramp]], axis=1)
            )
    return np.concatenate(step_lists)


def close_cells(grid: NavGrid, closed_cell_masks: Sequence[Bool]) -> NavGrid:
    """Copy a grid, with some cells made occupied.

    Args:
        grid: the grid, which stays as it is.
        closed_cell_masks: for each level, the cells to close, shape (height, width), bool.
    """
    levels = []
    for level, is_closed in zip(grid.levels, closed_cell_masks, strict=True):
        weights = np.where(is_closed, np.inf, level.weights)
        occupancy = np.where(is_closed, np.uint8(1), level.occupancy)
        attributes = {"occupancy": occupancy}
        if "floorHeight" not in level.attributes:
            attributes["floorHeight"] = level.floor_height.copy()
        if "solid" in level.attributes:  # inflation measures from it
            attributes["solid"] = np.where(is_closed, np.uint8(1), level.attributes["solid"])
        levels.append(level.with_layers(weights=weights, attributes=attributes))
    return grid.with_levels(levels)


# ---------------------------------------------------------------- losses


def describe_losses(
    grid: NavGrid,
    lost_kinds: Collection[str],
    closed_cells: ClosedCells,
    *,
    level: int | None = None,
    agent: str | Agent | None = None,
    radius: float = 0.0,
) -> list[str]:
    """Describe the content of a grid that is lost when it is written in a format.

    Args:
        grid: the grid.
        lost_kinds: the kinds of content that the format can't hold, see `FileFormat.loses`.
        closed_cells: the free cells that the file shows as occupied.
        level: the number of the only level that is written, None for all.
        agent: the agent that the file is for, None for any.
        radius: the radius for which the file blocks cells beside obstacles and drops [m].

    Returns:
        A phrase for each kind of content that is lost, such as ``steps between levels (24)``.
    """
    from navbake.runtime.agents import find_agent  # loads the run time

    level_numbers = list(range(len(grid.levels))) if level is None else [level]
    phrases = []
    if "heights" in lost_kinds:
        free_floors = [grid.levels[k].floor[grid.levels[k].free] for k in level_numbers]
        height_ranges = [
            f"{format_length(np.nanmin(floor))} to {format_length(np.nanmax(floor))} m"
            for floor in free_floors
            if not np.isnan(floor).all() and np.nanmax(floor) - np.nanmin(floor) > HEIGHT_BIN
        ]
        if height_ranges:
            phrases.append(f"floor heights ({', '.join(height_ranges)})")
        drop_phrase = _describe_drops(grid, closed_cells, level_numbers, radius)
        if drop_phrase is not None:
            phrases.append(drop_phrase)
    stairs_area = _measure_area(grid, closed_cells.stair_masks, level_numbers)
    if stairs_area:
        phrases.append(
            f"stairs and floors beyond them ({stairs_area:.2f} m² are occupied; "
            "--stairs free leaves them free)"
        )
    if "areas" in lost_kinds:
        map_agent = find_agent(grid, agent)
        barring_area_names = [area.name for area in grid.areas if area.bars(map_agent)]
        barred_area = _measure_area(grid, closed_cells.barred_masks, level_numbers)
        if barred_area:
            names_text = _list_names(barring_area_names)
            phrases.append(f"barred areas ({names_text}: {barred_area:.2f} m² are occupied)")
        # those that the line above doesn't name
        other_area_names = [
            area.name
            for area in grid.areas
            if (area.name not in barring_area_names or not barred_area)
            and (area.cost != 1.0 or area.speed is not None or area.agents is not None)
        ]
        if other_area_names:
            phrases.append(f"costs, speeds and agents of areas ({_list_names(other_area_names)})")
    if "steps" in lost_kinds:
        is_between_levels = grid.step_array[:, 0] != grid.step_array[:, 2]
        is_on_written_level = np.isin(grid.step_array[:, ::2], level_numbers).any(axis=1)
        num_steps = int(np.count_nonzero(is_between_levels & is_on_written_level))
        if num_steps:
            phrases.append(f"steps between levels ({num_steps})")
    if "links" in lost_kinds and grid.links:
        phrases.append(f"links ({_list_names([link.name for link in grid.links])})")
    if "agents" in lost_kinds and grid.agents:
        phrases.append(f"agents ({_list_names(list(grid.agents))})")
    if "doors" in lost_kinds and grid.doors:
        phrases.append(f"doors ({len(grid.doors)}, as they stand)")
    return phrases


def _describe_drops(
    grid: NavGrid, closed_cells: ClosedCells, level_numbers: Collection[int], radius: float
) -> str | None:
    """Describe the edges of drops that are beside two free cells of a file.

    A file without heights shows one floor there, and a robot that plans on it would drive over the
    edge. A radius of more than half a cell reaches from the centre of the higher cell to the lower
    one's square, so that no free cell is beside a drop.

    Args:
        grid: the grid, not inflated for the file.
        closed_cells: the free cells that the file shows as occupied.
        level_numbers: the levels that are written.
        radius: the radius for which the file blocks cells [m].

    Returns:
        The phrase; None where there are no such edges.
    """
    length = 0.0
    least_radius = 0.0
    closed_masks = closed_cells.join_masks()
    for level_number in level_numbers:
        half_cell = grid.levels[level_number].lattice.cell_size / 2
        if radius > half_cell:
            continue
        num_edges = _count_drop_edges(grid, level_number, closed_masks[level_number])
        length += num_edges * 2 * half_cell
        if num_edges:
            least_radius = max(least_radius, half_cell)
    if not length:
        return None
    return (
        f"drops between free cells ({format_length(length)} m of edges; --radius of more than "
        f"{least_radius:g} m closes the cells beside them)"
    )


def _count_drop_edges(grid: NavGrid, level_number: int, is_closed: Bool) -> int:
    """Count the pairs of free cells side by side whose floors are more than a step apart.

    Pairs that the grid's steps join, on steep ramps, are left out.

    Args:
        grid: the grid.
        level_number: the level's number.
        is_closed: the free cells that count as occupied, shape (height, width).
    """
    level = grid.levels[level_number]
    if not level.uses_cell_floors:
        return 0
    max_step = step_limit(grid) * grid.unit
    floor = np.where(level.free & ~is_closed, level.floor, np.nan)
    cells = np.arange(floor.size).reshape(floor.shape)
    steps = grid.step_array
    level_steps = steps[(steps[:, 0] == level_number) & (steps[:, 2] == level_number)][:, 1::2]
    step_keys = np.sort(level_steps, axis=1) @ [floor.size, 1]
    num_edges = 0
    for heights, cell_ids in ((floor, cells), (floor.T, cells.T)):
        is_drop = np.abs(np.diff(heights, axis=1)) > max_step  # False for NaN
        first_cells = cell_ids[:, :-1][is_drop]
        second_cells = cell_ids[:, 1:][is_drop]
        is_ramp = np.isin(first_cells * floor.size + second_cells, step_keys)
        num_edges += int(np.count_nonzero(~is_ramp))
    return num_edges


def _measure_area(grid: NavGrid, masks: Sequence[Bool], level_numbers: Collection[int]) -> float:
    """Return the area of the masked cells of some levels [m²]."""
    return sum(
        int(np.count_nonzero(masks[k])) * grid.levels[k].lattice.cell_size ** 2
        for k in level_numbers
    )


def _list_names(names: Sequence[str]) -> str:
    """List some names, and how many more there are."""
    listed_names = ", ".join(names[:MAX_LISTED_NAMES])
    num_unlisted = len(names) - MAX_LISTED_NAMES
    return f"{listed_names} and {num_unlisted} more" if num_unlisted > 0 else listed_names
