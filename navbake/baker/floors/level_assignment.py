"""Assign the surfaces of floors to levels.

The steps, in their order:

1. `_find_stairs` tells the surfaces of stairs and ramps from those of floors.
2. `_find_grounds` finds the grounds, the heights at which levels begin, from histograms of the
   heights of floors that lie over other floors. If the configuration has levels, it gives the
   grounds instead.
3. `_assign_surfaces` assigns each surface to a level by its height, and by the surfaces above and
   below it in its column. `_move_grounds_down` lowers a ground if connected floor lies just below
   it.
4. `_resolve_full_columns` treats columns with more surfaces than there are levels: it leaves out
   surfaces, or adds levels.
5. `_drop_empty_levels` numbers and names the levels that have surfaces.

A column is the vertical line through a cell's centre, with all surfaces on it. Candidates are the
surfaces that are to be assigned: those of the regions that are floors.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.area_test import AreaTest, is_large_enough, make_area_test
from navbake.baker.core.arrays import HeightRange
from navbake.baker.core.blocks import LEAST_BLOCKS, list_rows
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors import level_kernels as kernels
from navbake.baker.floors.component_kernels import HEIGHT_BIN, JoinRule, cross_tabulate
from navbake.baker.floors.level_kernels import (
    ALL_BANDS,
    LOWEST_SURFACES,
    NO_FREE_LEVEL,
    Candidates,
    HeightSelection,
    LevelRule,
)
from navbake.baker.floors.region_kernels import RegionSurfaces
from navbake.baker.floors.regions import (
    NO_GROUPS,
    NO_HEIGHTS,
    NO_ROWS,
    Components,
    Patch,
    Regions,
    describe_surfaces,
    find_components,
    make_region_join_rule,
)
from navbake.baker.floors.surface_kernels import Surfaces
from navbake.config.settings import AgentSettings, FloorSettings, LevelSettings
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# Floors up to this far below the ground of a configured level still belong to the level [m]
CONFIGURED_GROUND_TOLERANCE = 0.02
# The ground of an added level is lowered by at most this, to include surfaces of the same regions:
# a scanned floor is this uneven [m]
UNEVENNESS = 0.005
# With more than MANY_LEVELS levels, surfaces below the last ground are left out, and the next
# ground is first searched for up to this height above the last one, as levels are rarely higher;
# this saves time in towers [m]
USUAL_LEVEL_HEIGHT = 4.0
MANY_LEVELS = 2
# A tread, a landing or a piece of a ramp belongs to a stair if the floors that it leads to, up and
# down, each have more than this many times its own floor's area, see `_find_stairs`
STAIR_AREA_RATIO = 4
# Grounds that are found are rounded to this many decimals [m]
GROUND_DECIMALS = 9
# If all surfaces without a level lie at grounds, a level is added this far above the highest [m]
EXTRA_LEVEL_RISE = 1.0
# Empty arrays with the dtypes and shapes of histograms: three numbers and their count, and heights
NO_HISTOGRAM_ROWS = NO_ROWS, NO_HEIGHTS
# An area test that shrinks nothing and that even an empty set of cells passes
NO_SHRINKING = AreaTest(0, 0, np.empty(0, dtype=np.int64))


def list_level_height_ranges(level_settings: Sequence[LevelSettings]) -> list[HeightRange]:
    """Return the range of heights in which each level of the configuration may have a floor.

    A range begins `CONFIGURED_GROUND_TOLERANCE` below the level's ground. It ends at the level's
    top, or where the range of the next level begins, if that is lower; all within `LIMIT_SLACK`.

    Args:
        level_settings: the levels of the configuration, lowest first.

    Returns:
        The range [low, high) of each level [m], lowest level first.
    """
    height_ranges = []
    for level_number, level_setting in enumerate(level_settings):
        top = np.inf
        if level_number + 1 < len(level_settings):
            top = level_settings[level_number + 1].ground - CONFIGURED_GROUND_TOLERANCE
        if level_setting.top is not None:
            top = min(top, level_setting.top)
        lowest_height = level_setting.ground - CONFIGURED_GROUND_TOLERANCE
        height_ranges.append(HeightRange(lowest_height - LIMIT_SLACK, top - LIMIT_SLACK))
    return height_ranges


class RegionLevelCounts(NamedTuple):
    """How many surfaces each region has on each level: a table of three columns, shape (n,) each.

    The same region and level may have several entries, whose numbers have to be added up.

    Attributes:
        region: id of the region, int32.
        level: index of the level in `LevelAssignment.grounds`, int64.
        num_surfaces: how many surfaces of the region are on the level, int64.
    """

    region: Int32
    level: Int
    num_surfaces: Int


class LevelAssignment(NamedTuple):
    """The levels, lowest first, and which level each surface is on.

    Attributes:
        grounds: the height at which each level begins [m].
        names: the name of each level.
        preliminary_level: for each surface, the preliminary number of its level, negative for none,
            int32. Preliminary numbers also count levels that have no surface in the end.
        final_level: for each preliminary number, the index of the level in `grounds`, int64.
        surface_counts: how many surfaces each region has on each level.
        surfaces_without_level: summaries of the surfaces that are on no level, because their
            columns have more surfaces than there are levels.
    """

    grounds: list[float]
    names: list[str]
    preliminary_level: Int32
    final_level: Int
    surface_counts: RegionLevelCounts
    surfaces_without_level: list[Patch]


class ComponentLevels(NamedTuple):
    """How many surfaces each component has on each level: a table of columns, shape (n,) each.

    A component is the part of a region in one block of cells. The same component and level may have
    several entries, whose numbers have to be added up.

    Attributes:
        component: index of the component in `Regions.components`, int64.
        level: number of the level, int64; preliminary, as levels that end up without surfaces are
            still counted. Where a column has more surfaces than there are levels, those left
            without a level have NO_FREE_LEVEL or NO_FREE_LEVEL_AT_GROUND.
        num_surfaces: how many surfaces of the component are on the level, int64.
        lowest_z: the lowest height of these surfaces, float64 [m].
    """

    component: Int
    level: Int
    num_surfaces: Int
    lowest_z: Float


class SurfaceLevels(NamedTuple):
    """Which level each surface is on, for one choice of the heights at which levels begin.

    Attributes:
        grounds: the heights at which levels begin, ascending [m].
        skips_floors: whether columns with more surfaces than there are levels leave out surfaces of
            floors; if not, they leave out surfaces of stairs.
        level_of_surface: the level of each surface as an index of `grounds`, -1 for surfaces that
            are not assigned, NO_FREE_LEVEL or less where all levels are taken, int32.
        component_levels: how many surfaces each component has on each level.
    """

    grounds: list[float]
    skips_floors: bool
    level_of_surface: Int32
    component_levels: ComponentLevels


class HeightHistogram(NamedTuple):
    """How many surfaces lie at each height: a table of columns, shape (n,) each.

    Heights are divided into bands, half of the agent's highest step high, and apart from these into
    finer bins. Both are counted from z = 0, so a bin may lie in two bands, and has entries for
    both. The same band and bin may have several entries, whose numbers have to be added up.

    Attributes:
        band: number of the band: band n begins at n times half a step, int64.
        height_bin: number of the bin: bin n is HEIGHT_BIN high, and its middle is at n times
            HEIGHT_BIN, int64.
        num_surfaces: how many surfaces lie in the bin, int64.
        lowest_z: the lowest height of these surfaces, float64 [m].
        block: id of the block of cells that has these surfaces, int64.
    """

    band: Int
    height_bin: Int
    num_surfaces: Int
    lowest_z: Float
    block: Int

    def select(self, is_selected: Bool) -> HeightHistogram:
        """Return the entries that a mask of shape (n,) marks."""
        return HeightHistogram._make(column[is_selected] for column in self)

    def find_most_common_height(self) -> float:
        """Return the lowest height in the bin with the most surfaces [m]."""
        height_bins, bin_index = np.unique(self.height_bin, return_inverse=True)
        fullest_bin = int(np.bincount(bin_index, self.num_surfaces).argmax())
        return float(self.lowest_z[self.height_bin == height_bins[fullest_bin]].min())


class AssignmentInput(NamedTuple):
    """The surfaces to assign to levels, and the settings that decide how.

    Attributes:
        regions: all regions.
        candidates: the surfaces to assign (the candidates), and which of these belong to stairs.
        stacked_blocks: ids of the blocks of cells with a candidate above another one, ascending.
        tolerance: how far below the ground of a level its floors may lie [m].
        agent: the agent, of which the step and slope are used.
        settings: the settings of `floors`; `min_area` and `shrink` are used.
    """

    regions: Regions
    candidates: Candidates
    stacked_blocks: Int
    tolerance: float
    agent: AgentSettings
    settings: FloorSettings


def assign_levels(
    regions: Regions,
    is_floor: Bool,
    level_settings: Sequence[LevelSettings],
    agent: AgentSettings,
    settings: FloorSettings,
) -> LevelAssignment:
    """Find the levels (storeys) of a scene, and assign the surfaces of floors to them.

    Args:
        regions: all regions.
        is_floor: the regions whose surfaces are assigned, shape (regions,), bool.
        level_settings: the levels of the configuration; only surfaces in the ranges of heights that
            `list_level_height_ranges` has for them are assigned. If empty, the levels are found.
        agent: the agent, of which the step and slope are used.
        settings: the settings of `floors`; `min_area` and `shrink` are used.
    """
    group_of_surface = np.empty(len(regions.surfaces.z), dtype=np.int8)
    has_stacked_candidates = np.empty(regions.blocks.num_blocks, dtype=np.bool_)
    height_ranges = np.array(list_level_height_ranges(level_settings), dtype=np.float64).reshape(
        -1, 2
    )
    run_in_chunks(
        kernels.mark_candidates,
        regions.blocks.num_blocks,
        regions.label_surfaces(is_floor),
        height_ranges,
        group_of_surface,
        has_stacked_candidates,
    )
    stacked_blocks = np.flatnonzero(has_stacked_candidates)
    max_step = agent.traversable_floor_height
    max_rise = (regions.highest_z - regions.lowest_z)[is_floor].max(initial=0.0)
    if not len(stacked_blocks):
        # stairs matter only where surfaces lie above each other
        candidates = Candidates(group_of_surface, NO_GROUPS, np.empty(0, np.bool_))
    elif max_rise <= min(max_step, HEIGHT_BIN):
        # each region is one plateau, which no step leads to
        candidates = Candidates(
            group_of_surface,
            regions.components.component_of_surface,
            np.zeros(regions.components.num_components, dtype=np.bool_),
        )
    else:
        candidates = _find_stairs(regions, group_of_surface, max_step)
    assignment_input = AssignmentInput(
        regions=regions,
        candidates=candidates,
        stacked_blocks=stacked_blocks,
        tolerance=LIMIT_SLACK + (CONFIGURED_GROUND_TOLERANCE if level_settings else 0.0),
        agent=agent,
        settings=settings,
    )
    if level_settings:
        grounds = sorted(level.ground for level in level_settings)
        surface_levels = _assign_surfaces(assignment_input, grounds)
    else:
        grounds = _find_grounds(assignment_input)
        surface_levels = _move_grounds_down(assignment_input, grounds)
    surfaces_without_level: list[Patch] = []
    if (surface_levels.component_levels.level <= NO_FREE_LEVEL).any():
        surface_levels, surfaces_without_level = _resolve_full_columns(
            assignment_input, surface_levels
        )
    name_of_ground = {level.ground: level.name for level in level_settings}
    return _drop_empty_levels(regions, surface_levels, name_of_ground, surfaces_without_level)


def _find_stairs(
    regions: Regions, group_of_surface: NDArray[np.int8], max_step: float
) -> Candidates:
    """Find which of the surfaces to assign belong to stairs and ramps.

    A plateau is a set of connected surfaces at one height: a tread, a landing, a piece of a ramp,
    or a floor between thresholds. It belongs to a stair if large floors are both above and below
    it: a path that only goes up leads from it to a floor more than four times as large as its own,
    and so does a path that only goes down. All surfaces of its region within half a step of its
    height count as its own floor, since walls and thresholds divide a floor into several plateaus.

    Args:
        regions: all regions.
        group_of_surface: 0 for each surface to assign, else -1, shape (surfaces,), int8.
        max_step: the highest step [m].

    Returns:
        The surfaces to assign, their plateaus, and which plateaus belong to stairs.
    """
    join_rule = JoinRule(min(max_step, HEIGHT_BIN), max_link_step=max_step)
    components = find_components(regions.surfaces, join_rule, group_of_surface.astype(np.int32))
    plateau_of_component = components.merge_across_blocks()
    num_plateaus = int(plateau_of_component.max(initial=-1)) + 1

    # the histogram of each plateau's heights; each component of a plateau is in one region
    _, (histogram_rows, lowest_z) = regions.blocks.list_rows(
        cross_tabulate,
        NO_HISTOGRAM_ROWS,
        regions.surfaces,
        components.component_of_surface,
        regions.components.component_of_surface,
        NO_GROUPS,
    )
    plateau_of_row = plateau_of_component[histogram_rows[:, 0]]
    region_of_row = regions.region_of_component[histogram_rows[:, 1]].astype(np.int64)
    bin_of_row = histogram_rows[:, 2]
    num_surfaces = histogram_rows[:, 3]
    plateau_height = np.full(num_plateaus, np.inf)
    np.minimum.at(plateau_height, plateau_of_row, lowest_z)

    half_step = max(max_step, HEIGHT_BIN) / 2
    # sizes are counts of surfaces
    floor_size = _count_near_height(region_of_row, bin_of_row, num_surfaces, half_step)
    plateau_size = np.zeros(num_plateaus, dtype=np.int64)
    np.maximum.at(plateau_size, plateau_of_row, floor_size)

    # steps between plateaus, from the lower to the upper one
    first_plateau, second_plateau = components.find_linked_pairs(plateau_of_component)
    is_first_lower = plateau_height[first_plateau] < plateau_height[second_plateau]
    lower_plateau = np.where(is_first_lower, first_plateau, second_plateau)
    upper_plateau = np.where(is_first_lower, second_plateau, first_plateau)
    is_rising = plateau_height[lower_plateau] < plateau_height[upper_plateau]
    lower_plateau = lower_plateau[is_rising]
    upper_plateau = upper_plateau[is_rising]
    largest_size_above, largest_size_below = kernels.find_largest_areas(
        lower_plateau,
        upper_plateau,
        plateau_size,
        np.argsort(plateau_height[lower_plateau], kind="stable"),
        np.argsort(plateau_height[upper_plateau], kind="stable"),
    )
    # what leads both up and down to larger floors lies between them
    is_stair = STAIR_AREA_RATIO * plateau_size < np.minimum(largest_size_above, largest_size_below)
    return Candidates(
        group_of_surface, components.component_of_surface, is_stair[plateau_of_component]
    )


def _count_near_height(region: Int, height_bin: Int, num_surfaces: Int, half_step: float) -> Int:
    """Count, for pairs of a region and a height, the region's surfaces near that height.

    Args:
        region: the region of each entry of a histogram of heights, shape (n,).
        height_bin: the number of each entry's bin of heights, see `height_bin`, shape (n,).
        num_surfaces: how many surfaces of the region lie in the bin, shape (n,); several entries of
            one region and bin are added up.
        half_step: half of the highest step [m].

    Returns:
        For each entry, how many surfaces of its region lie within half a step of its height, shape
        (n,).
    """
    num_bins = int(half_step / HEIGHT_BIN + LIMIT_SLACK)
    # a sliding window over one axis of bins. On it each region has a range of its own, so far from
    # the next region's range that no window reaches both
    lowest_bin = height_bin.min(initial=0)
    bins_per_region = int(height_bin.max(initial=0) - lowest_bin + 2 * num_bins + 1)
    bin_on_axis = region * bins_per_region + height_bin - lowest_bin
    axis_bins, index_in_bins = np.unique(bin_on_axis, return_inverse=True)
    cumulative_count = np.append(
        0, np.bincount(index_in_bins, num_surfaces).astype(np.int64).cumsum()
    )
    first_bin = np.searchsorted(axis_bins, axis_bins - num_bins, side="left")
    end_bin = np.searchsorted(axis_bins, axis_bins + num_bins, side="right")
    num_near_height: Int = (cumulative_count[end_bin] - cumulative_count[first_bin])[index_in_bins]
    return num_near_height


def _find_grounds(assignment_input: AssignmentInput) -> list[float]:
    """Find the ground heights of the levels, lowest first [m].

    The first ground is the height of the lowest floor that is large enough. Each further ground is
    the height of the lowest large floor that lies over floors of the level below. So a hill, a
    half-storey, a stair, or a platform with nothing under it is no new level.
    """
    half_step = max(assignment_input.agent.traversable_floor_height, HEIGHT_BIN) / 2
    area_test = make_area_test(assignment_input.regions.lattice, assignment_input.settings)
    surfaces = assignment_input.regions.surfaces
    candidates = assignment_input.candidates
    blocks = np.arange(assignment_input.regions.blocks.num_blocks)
    ground = _find_next_ground(
        surfaces, candidates, area_test, blocks, ground=-np.inf, half_step=half_step
    )
    if ground is None:
        # nothing is large enough: take the most common height of the lowest surfaces
        selection = HeightSelection(-np.inf, LOWEST_SURFACES, half_step)
        histogram = _count_heights(surfaces, candidates, selection, NO_SHRINKING, blocks)
        ground = histogram.find_most_common_height()
    grounds = [ground]
    while len(assignment_input.stacked_blocks):
        height_limits = [np.inf]
        if len(grounds) > MANY_LEVELS:
            surfaces = _skip_surfaces_below(surfaces, grounds[-1] - LIMIT_SLACK)
            height_limits = [grounds[-1] + USUAL_LEVEL_HEIGHT, np.inf]
        ground = _find_next_ground(
            surfaces,
            candidates,
            area_test,
            assignment_input.stacked_blocks,
            ground=grounds[-1],
            half_step=half_step,
            height_limits=height_limits,
        )
        if ground is None:
            break
        grounds.append(ground)
    return [round(ground, GROUND_DECIMALS) for ground in grounds]


def _skip_surfaces_below(surfaces: Surfaces, height: float) -> Surfaces:
    """Return the surfaces without those at the lower end of each column that lie below a height.

    Args:
        surfaces: the surfaces of all cells.
        height: the height [m].
    """
    first = surfaces.first.copy()
    cells = np.flatnonzero(first < surfaces.end)
    while len(cells):
        cells = cells[surfaces.z[first[cells]] < height]
        first[cells] += 1
        cells = cells[first[cells] < surfaces.end[cells]]
    return surfaces._replace(first=first)


def _find_next_ground(
    surfaces: Surfaces,
    candidates: Candidates,
    area_test: AreaTest,
    blocks: Int,
    ground: float,
    half_step: float,
    height_limits: Sequence[float] = (np.inf,),
) -> float | None:
    """Find the height of the lowest large floor that lies over floors of a level.

    A floor is large if its surfaces in some range of heights keep `floors.min_area` when they are
    shrunk by `floors.shrink`. The ranges are one step high and begin half a step apart.

    Args:
        surfaces: the surfaces of all cells; those below the ground may be left out.
        candidates: which of them are to be assigned, and which belong to stairs.
        area_test: the test of large floors, by `floors.min_area` and `floors.shrink`.
        blocks: ids of the blocks of cells that may have such floors, ascending.
        ground: the ground of the level [m]; -inf to search the lowest surfaces of all columns.
        half_step: half of the highest step [m].
        height_limits: heights, ascending. Only ranges below the first height are searched; if none
            has a large floor, those below the second height are, and so on [m].

    Returns:
        The height [m]; None if there is no such floor.
    """
    for top in height_limits:
        # before shrinking, to skip bands with too few surfaces
        selection = HeightSelection(ground, ALL_BANDS, half_step, top)
        histogram = _count_heights(surfaces, candidates, selection, NO_SHRINKING, blocks)
        bands, band_index = np.unique(histogram.band, return_inverse=True)
        num_in_band = np.bincount(band_index, histogram.num_surfaces).astype(np.int64)
        num_surfaces_by_band = Counter(dict(zip(bands.tolist(), num_in_band.tolist(), strict=True)))
        # two bands of half a step each, the lower one first
        lowest_band = min(num_surfaces_by_band, default=0)
        lower_bands = {
            lower_band
            for band in num_surfaces_by_band
            for lower_band in (band - 1, band)
            if lower_band >= lowest_band
        }
        for band in sorted(lower_bands):
            end_height = (band + 2) * half_step
            num_surfaces = num_surfaces_by_band[band] + num_surfaces_by_band[band + 1]
            if num_surfaces < area_test.min_cells or end_height > top:
                continue
            # stairs and thresholds are too narrow to remain after shrinking
            selection = HeightSelection(ground, band, half_step, end_height)
            histogram_of_bands = histogram.select(np.isin(histogram.band, [band, band + 1]))
            remaining_histogram = _count_heights(
                surfaces, candidates, selection, area_test, np.unique(histogram_of_bands.block)
            )
            if remaining_histogram.num_surfaces.sum() < area_test.min_cells:
                continue
            if len(remaining_histogram.num_surfaces):
                return remaining_histogram.find_most_common_height()
            return histogram_of_bands.find_most_common_height()
    return None


def _count_heights(
    surfaces: Surfaces,
    candidates: Candidates,
    selection: HeightSelection,
    area_test: AreaTest,
    blocks: Int,
) -> HeightHistogram:
    """Count how many surfaces of floors lie at each height, see `count_heights`.

    Args:
        surfaces: the surfaces of all cells; those below the selection's ground may be left out.
        candidates: which of them are to be assigned, and which belong to stairs.
        selection: which of the floors are counted.
        area_test: the disc by which their cells are shrunk before they are counted.
        blocks: ids of the blocks of cells whose floors are counted, ascending.
    """
    rows_of_block, (histogram_rows, lowest_z) = list_rows(
        kernels.count_heights,
        blocks,
        NO_HISTOGRAM_ROWS,
        surfaces,
        candidates,
        selection,
        area_test,
        least=LEAST_BLOCKS,
    )
    return HeightHistogram(
        band=histogram_rows[:, 0],
        height_bin=histogram_rows[:, 1],
        num_surfaces=histogram_rows[:, 3],
        lowest_z=lowest_z,
        block=np.repeat(blocks, rows_of_block),
    )


def _assign_surfaces(
    assignment_input: AssignmentInput, grounds: list[float], skips_floors: bool = False
) -> SurfaceLevels:
    """Assign surfaces to levels whose grounds are given: in each column, at most one to a level.

    Args:
        assignment_input: the surfaces to assign.
        grounds: the heights at which levels begin, ascending [m].
        skips_floors: whether floors rather than stairs are left out, in columns with more surfaces
            to assign than there are levels.
    """
    regions = assignment_input.regions
    level_of_surface = np.empty(len(regions.surfaces.z), dtype=np.int32)
    _, (histogram_rows, lowest_z) = regions.blocks.list_rows(
        kernels.assign_surfaces_to_levels,
        NO_HISTOGRAM_ROWS,
        regions.surfaces,
        assignment_input.candidates,
        LevelRule(np.array(grounds), assignment_input.tolerance, skips_floors),
        regions.components.component_of_surface,
        level_of_surface,
    )
    component_levels = ComponentLevels(
        component=histogram_rows[:, 0],
        level=histogram_rows[:, 2],
        num_surfaces=histogram_rows[:, 3],
        lowest_z=lowest_z,
    )
    return SurfaceLevels(grounds, skips_floors, level_of_surface, component_levels)


def _move_grounds_down(assignment_input: AssignmentInput, grounds: list[float]) -> SurfaceLevels:
    """Lower each ground to include connected floor just below it, then assign surfaces to levels.

    A floor just below a ground is first assigned to the level below. There, it is a connected part
    of that level. The ground is lowered to the lowest surface of such a part if all of these hold:

    - The whole part lies at most a step below the ground.
    - It does not consist of stairs alone.
    - Steps link it to the ground's level, and to no other part or level.

    Args:
        assignment_input: the surfaces to assign.
        grounds: the heights at which levels begin, ascending [m].

    Returns:
        The levels of all surfaces, with the lowered grounds.
    """
    surface_levels = _assign_surfaces(assignment_input, grounds)
    if not _has_region_on_several_levels(assignment_input.regions, surface_levels):
        # steps connect surfaces of one region, so none leads to another level
        return surface_levels
    for _ in grounds[1:]:
        lowered_grounds = _move_grounds_down_once(assignment_input, surface_levels)
        if lowered_grounds == surface_levels.grounds:
            break
        # lower grounds may take further parts from the level below, so this is repeated
        surface_levels = _assign_surfaces(assignment_input, lowered_grounds)
    if surface_levels.grounds != sorted(surface_levels.grounds):
        surface_levels = _assign_surfaces(assignment_input, sorted(surface_levels.grounds))
    return surface_levels


def _has_region_on_several_levels(regions: Regions, surface_levels: SurfaceLevels) -> bool:
    """Return whether the surfaces of any region are not all on one level."""
    component_levels = surface_levels.component_levels
    region = regions.region_of_component[component_levels.component]
    level_of_region = np.zeros(regions.num_regions, dtype=np.int64)
    level_of_region[region] = component_levels.level
    return bool((level_of_region[region] != component_levels.level).any())


def _move_grounds_down_once(
    assignment_input: AssignmentInput, surface_levels: SurfaceLevels
) -> list[float]:
    """Lower each ground once, to include connected floor just below it, see `_move_grounds_down`.

    Args:
        assignment_input: the surfaces to assign.
        surface_levels: the levels that the surfaces have with the grounds as they are.

    Returns:
        The height at which each level begins [m].
    """
    regions = assignment_input.regions
    candidates = assignment_input.candidates
    max_step = assignment_input.agent.traversable_floor_height
    grounds = surface_levels.grounds

    # the connected parts of each level
    join_rule = JoinRule(max_step, max_link_step=max_step)
    components = find_components(regions.surfaces, join_rule, surface_levels.level_of_surface)
    part_of_component = components.merge_across_blocks()
    num_parts = int(part_of_component.max(initial=-1)) + 1
    _, (histogram_rows, lowest_z) = regions.blocks.list_rows(
        cross_tabulate,
        NO_HISTOGRAM_ROWS,
        regions.surfaces,
        components.component_of_surface,
        candidates.component_of_surface,
        surface_levels.level_of_surface,
    )
    part_of_row = part_of_component[histogram_rows[:, 0]]
    lowest_z_of_part = np.full(num_parts, np.inf)
    np.minimum.at(lowest_z_of_part, part_of_row, lowest_z)
    level_of_part = np.zeros(num_parts, dtype=np.int64)
    level_of_part[part_of_row] = histogram_rows[:, 2]
    is_floor_row = ~candidates.is_stair[histogram_rows[:, 1]]
    has_floor = np.bincount(part_of_row[is_floor_row], minlength=num_parts) > 0

    # steps between parts, in both directions
    first_part, second_part = components.find_linked_pairs(part_of_component)
    from_part = np.append(first_part, second_part)
    to_part = np.append(second_part, first_part)
    # parts from which all steps lead to the level above
    is_step_up = level_of_part[to_part] == level_of_part[from_part] + 1
    has_step_up = np.bincount(from_part[is_step_up], minlength=num_parts) > 0
    has_other_step = np.bincount(from_part[~is_step_up], minlength=num_parts) > 0
    ground_above = np.append(grounds, np.inf)[level_of_part + 1]
    is_just_below_ground = lowest_z_of_part >= ground_above - max_step - LIMIT_SLACK
    belongs_to_level_above = has_floor & has_step_up & ~has_other_step & is_just_below_ground
    # the lowest part that belongs to each level, infinite where none does
    lowest_z_by_level = np.full(len(grounds), np.inf)
    np.minimum.at(
        lowest_z_by_level,
        level_of_part[belongs_to_level_above] + 1,
        lowest_z_of_part[belongs_to_level_above],
    )
    return [
        min(ground, round(lowest_z, GROUND_DECIMALS)) if lowest_z < np.inf else ground
        for ground, lowest_z in zip(grounds, lowest_z_by_level.tolist(), strict=True)
    ]


def _resolve_full_columns(
    assignment_input: AssignmentInput, surface_levels: SurfaceLevels
) -> tuple[SurfaceLevels, list[Patch]]:
    """Leave out surfaces or add levels where columns have more surfaces than there are levels.

    Where `_are_dispensable` allows it, surfaces of stairs are left out; else, where it allows that,
    the floors under them. Otherwise a level is added at the lowest surface that has no level, and
    the surfaces are assigned again.

    Args:
        assignment_input: the surfaces to assign.
        surface_levels: their levels so far.

    Returns:
        The levels of all surfaces, and a summary of what is left out, region by region.
    """
    regions = assignment_input.regions
    walkable_areas = _find_walkable_areas(
        assignment_input, assignment_input.candidates.group_of_surface
    )
    while True:
        regions_without_level = _list_regions_without_level(regions, surface_levels)
        if _are_dispensable(
            assignment_input, surface_levels, regions_without_level, walkable_areas
        ):
            break
        # stairs may be needed where floors under them are not
        levels_with_stairs = _assign_surfaces(
            assignment_input, surface_levels.grounds, skips_floors=True
        )
        floors_without_level = _list_regions_without_level(regions, levels_with_stairs)
        if _are_dispensable(
            assignment_input, levels_with_stairs, floors_without_level, walkable_areas
        ):
            surface_levels = levels_with_stairs
            regions_without_level = floors_without_level
            break
        added_ground = _choose_extra_ground(
            assignment_input.candidates, surface_levels, regions_without_level
        )
        grounds = sorted([*surface_levels.grounds, added_ground])
        surface_levels = _assign_surfaces(assignment_input, grounds)
    left_out_patches = []
    for region_surfaces in regions_without_level:
        has_no_level = surface_levels.level_of_surface[region_surfaces.surface_id] <= NO_FREE_LEVEL
        left_out_patches.append(
            describe_surfaces(regions.lattice, region_surfaces.select(has_no_level))
        )
    return surface_levels, left_out_patches


def _list_regions_without_level(
    regions: Regions, surface_levels: SurfaceLevels
) -> list[RegionSurfaces]:
    """Return, for each region with a surface that got no level, all surfaces of the region.

    Args:
        regions: all regions.
        surface_levels: the levels of the surfaces.
    """
    component_levels = surface_levels.component_levels
    has_no_level = component_levels.level <= NO_FREE_LEVEL
    region_ids = np.unique(
        regions.region_of_component[component_levels.component[has_no_level]]
    ).astype(np.int64)
    return regions.list_surfaces(region_ids)


def _choose_extra_ground(
    candidates: Candidates,
    surface_levels: SurfaceLevels,
    regions_without_level: list[RegionSurfaces],
) -> float:
    """Choose the ground of an added level, for surfaces without a level.

    It is the height of the lowest of these surfaces; or up to `UNEVENNESS` lower if their regions
    have surfaces there, so that an uneven floor stays on one level.

    Args:
        candidates: the surfaces to assign.
        surface_levels: their levels.
        regions_without_level: the regions with surfaces without a level, as
            `_list_regions_without_level` lists them.

    Returns:
        The ground's height [m].
    """
    grounds = surface_levels.grounds
    component_levels = surface_levels.component_levels
    has_no_level = component_levels.level == NO_FREE_LEVEL
    lowest_z_without_level = float(component_levels.lowest_z[has_no_level].min(initial=np.inf))
    if lowest_z_without_level == np.inf:
        # all of them lie at grounds of levels, whose places are taken: add one above all levels
        return max(grounds) + EXTRA_LEVEL_RISE
    candidate_heights = []
    for region_surfaces in regions_without_level:
        is_candidate = candidates.group_of_surface[region_surfaces.surface_id] >= 0
        candidate_heights.append(region_surfaces.z[is_candidate])
    candidate_z = np.concatenate(candidate_heights)
    # above each ground below the surface
    grounds_below = [ground + LIMIT_SLACK for ground in grounds if ground <= lowest_z_without_level]
    lowest_allowed_z = max([lowest_z_without_level - UNEVENNESS, *grounds_below])
    is_near_lowest = (candidate_z >= lowest_allowed_z) & (candidate_z <= lowest_z_without_level)
    return round(
        float(candidate_z[is_near_lowest].min(initial=lowest_z_without_level)), GROUND_DECIMALS
    )


def _are_dispensable(
    assignment_input: AssignmentInput,
    surface_levels: SurfaceLevels,
    regions_without_level: list[RegionSurfaces],
    walkable_areas: Components,
) -> bool:
    """Return whether the surfaces without a level can be left out.

    They can if two rules hold. In each region, the surfaces that are left out are small:

    - Stairs are small if they are nowhere wider than `floors.shrink`.
    - Floors, which are left out if `surface_levels.skips_floors`, are small if less than
      `floors.min_area` remains of them when they are shrunk by `floors.shrink`. The floors in
      columns without stairs must be small even when they are shrunk by half of this width.

    And no floor is cut in two: the regions have no more large walkable areas without these surfaces
    than with them. In a walkable area, an agent can walk from each surface to each other one.

    Args:
        assignment_input: the surfaces to assign.
        surface_levels: their levels.
        regions_without_level: the regions with surfaces without a level, as
            `_list_regions_without_level` lists them.
        walkable_areas: the walkable areas of all surfaces to assign, in parts: one for each block
            of cells that an area lies in, see `_find_walkable_areas`.
    """
    if not regions_without_level:
        return True
    lattice = assignment_input.regions.lattice
    settings = assignment_input.settings
    narrow_limits = settings.model_copy(update={"shrink": settings.shrink / 2})
    # a stair is large if a single cell of it remains
    stair_limits = narrow_limits.model_copy(update={"min_area": lattice.cell_size**2})
    has_stairs = _mark_cells_with_stairs(assignment_input)
    for region_surfaces in regions_without_level:
        has_no_level = surface_levels.level_of_surface[region_surfaces.surface_id] <= NO_FREE_LEVEL
        is_left_out = np.zeros(lattice.width * lattice.height, dtype=np.bool_)
        is_left_out[region_surfaces.cell[has_no_level]] = True
        if surface_levels.skips_floors:
            if is_large_enough(lattice, settings, is_left_out):
                return False
            # where another floor, and no stair, took the place: a storey among walls and furniture
            # is narrow
            if is_large_enough(lattice, narrow_limits, is_left_out & ~has_stairs):
                return False
        elif is_large_enough(lattice, stair_limits, is_left_out):
            return False
    group_of_surface = assignment_input.candidates.group_of_surface
    group_of_remaining_surface = np.where(
        surface_levels.level_of_surface <= NO_FREE_LEVEL, np.int8(-1), group_of_surface
    )
    # where a walkable area is divided, several large ones take the place of one
    remaining_areas = _find_walkable_areas(assignment_input, group_of_remaining_surface)
    min_cells = make_area_test(lattice, settings).min_cells
    num_remaining_areas = _count_large_walkable_areas(
        remaining_areas, regions_without_level, min_cells
    )
    return num_remaining_areas <= _count_large_walkable_areas(
        walkable_areas, regions_without_level, min_cells
    )


def _mark_cells_with_stairs(assignment_input: AssignmentInput) -> Bool:
    """Mark the cells in whose columns are surfaces of stairs to assign, shape (cells,)."""
    surfaces = assignment_input.regions.surfaces
    candidates = assignment_input.candidates
    is_stair = candidates.is_stair[candidates.component_of_surface]
    is_assigned_stair = is_stair & (candidates.group_of_surface >= 0)
    num_stairs_before = np.append(0, np.cumsum(is_assigned_stair))
    has_stairs: Bool = num_stairs_before[surfaces.end] > num_stairs_before[surfaces.first]
    return has_stairs


def _find_walkable_areas(
    assignment_input: AssignmentInput, group_of_surface: NDArray[np.int8]
) -> Components:
    """Find walkable areas: sets of surfaces between which an agent can walk by steps and slopes.

    Args:
        assignment_input: all surfaces, and the agent.
        group_of_surface: 0 for each surface that counts, else -1, shape (surfaces,).

    Returns:
        The part of each area in each block of cells; `Components.merge_across_blocks` joins and
        numbers them.
    """
    surfaces = assignment_input.regions.surfaces
    join_rule = make_region_join_rule(surfaces.lattice, assignment_input.agent)
    return find_components(surfaces, join_rule, group_of_surface.astype(np.int32))


def _count_large_walkable_areas(
    walkable_areas: Components, surfaces_by_region: list[RegionSurfaces], min_surfaces: int
) -> int:
    """Count the walkable areas that have at least `min_surfaces` surfaces in one of some regions.

    A walkable area is a set of surfaces between which an agent can walk. One that is large enough
    in several regions counts once for each of them.
    """
    area_of_component = walkable_areas.merge_across_blocks()
    num_large_areas = 0
    for region_surfaces in surfaces_by_region:
        component_of_surface = walkable_areas.component_of_surface[region_surfaces.surface_id]
        area_of_surface = area_of_component[component_of_surface[component_of_surface >= 0]]
        num_large_areas += int(np.count_nonzero(np.bincount(area_of_surface) >= min_surfaces))
    return num_large_areas


def _drop_empty_levels(
    regions: Regions,
    surface_levels: SurfaceLevels,
    name_of_ground: dict[float, str | None],
    surfaces_without_level: list[Patch],
) -> LevelAssignment:
    """Remove the levels without surfaces, and name the remaining levels.

    Args:
        regions: all regions.
        surface_levels: the level of each surface.
        name_of_ground: ground height [m] -> configured name. A level without one is named by its
            number.
        surfaces_without_level: the surfaces that are left out, see `LevelAssignment`.
    """
    component_levels = surface_levels.component_levels
    has_level = component_levels.level >= 0
    level_of_row = component_levels.level[has_level]
    has_surfaces = np.bincount(level_of_row, minlength=len(surface_levels.grounds)) > 0
    final_level = np.cumsum(has_surfaces, dtype=np.int64) - 1
    grounds = [surface_levels.grounds[k] for k in np.flatnonzero(has_surfaces).tolist()]
    return LevelAssignment(
        grounds=grounds,
        names=_name_levels([name_of_ground.get(ground) for ground in grounds]),
        preliminary_level=surface_levels.level_of_surface,
        final_level=final_level,
        surface_counts=RegionLevelCounts(
            region=regions.region_of_component[component_levels.component[has_level]],
            level=final_level[level_of_row],
            num_surfaces=component_levels.num_surfaces[has_level],
        ),
        surfaces_without_level=surfaces_without_level,
    )


def _name_levels(configured_names: list[str | None]) -> list[str]:
    """Return a different name for each level: the configured one, or else ``level <number>``."""
    names: list[str] = []
    used_names = set[str]()
    reserved_names = set(configured_names)
    for level_number, configured_name in enumerate(configured_names):
        name = configured_name or f"level {level_number}"
        while name in used_names or (not configured_name and name in reserved_names):
            name += "'"
        names.append(name)
        used_names.add(name)
    return names
