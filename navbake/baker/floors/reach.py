"""Find the floors that agents reach from their starts, and the floors that no path leads to.

Warnings report the floors that no path leads to. Two kinds of them are found here, too: voids,
which are too low to stand upright in, and floors inside of closed meshes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from navbake.baker.columns.columns import ColumnSource
from navbake.baker.core.components import expand_ranges
from navbake.baker.core.tolerances import LIMIT_SLACK, TOUCH_DEPTH
from navbake.baker.floors.level_assignment import LevelAssignment, RegionLevelCounts
from navbake.baker.floors.outline import (
    DROP,
    RegionContext,
    find_neighbor_cells,
)
from navbake.baker.floors.region_kernels import RegionSurfaces
from navbake.baker.floors.regions import (
    Patch,
    Regions,
    describe_surfaces,
    find_large_regions,
    find_middle_position,
    find_regions,
)
from navbake.baker.floors.rejected import LARGE_TOP_AREA, MIN_LINES_PER_THREAD, RejectedRegions
from navbake.baker.floors.surface_kernels import ENCLOSED, Surfaces
from navbake.baker.floors.surfaces import find_highest_within_step
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.errors import SceneError
from navbake.lengths import format_length, format_position
from navbake.threads import run_in_chunks
from navbake.types import Bool, Int

# A position lies on a surface if it is at most this far above or below it [m]
MAX_DISTANCE_ON_SURFACE = 0.02
# On a level that agents reach in part, an unreached region is reported if it has at least this
# area: shafts and niches are smaller [m²]
REPORTED_AREA = 6.0
# A level that no path leads to is a void if at least this fraction of its area has less headroom
# than an adult needs
VOID_SHARE = 0.9
# The headroom that an adult needs [m]
ADULT_HEADROOM = 1.8
# A floor inside of a closed mesh is not reported if it continues outside along at least this
# fraction of its outline (the mesh then stands on it), unless it is as large as a building
CONTINUING_SHARE = 0.25
# Floors of buildings have at least this area [m²]
BUILDING_AREA = 50.0


@dataclass(frozen=True)
class UnreachedFloors:
    """The floors of one level that no path of steps and slopes from a start leads to.

    Attributes:
        level: the level's number.
        patch: a summary of these floors; its position is on the largest of them.
        is_whole_level: whether no floor of the level is reached at all.
    """

    level: int
    patch: Patch
    is_whole_level: bool


def find_start_regions(
    region_context: RegionContext, rejected_regions: RejectedRegions, positions: list[list[float]]
) -> Bool:
    """Find the regions on which agents start, from the positions of `floors.from`.

    A position within 2 cm above or below a region lies on that region, whatever it is. Otherwise it
    lies on the highest floor in its cell that is at most a step higher than the position; roofs,
    and tops of at least 6 m², count as floors here. If there is only furniture in the cell, the
    position lies on the floor to which most edges of the furniture drop, or on the furniture itself
    if there is no such floor.

    Args:
        region_context: all regions with their edges.
        rejected_regions: tops, shelves and roofs, which are floors only if an agent starts on them.
        positions: `floors.from`: x, y, z of each position, world frame [m].

    Returns:
        A mask of the regions on which agents start, shape (regions,), bool.

    Raises:
        SceneError: there is no floor at a position.
    """
    regions = region_context.regions
    lattice = regions.lattice
    surfaces = regions.surfaces
    max_step = region_context.agent.traversable_floor_height
    is_small = regions.num_surfaces * lattice.cell_size**2 < LARGE_TOP_AREA
    may_start = (
        region_context.is_large & ~rejected_regions.is_shelf & ~(rejected_regions.is_top & is_small)
    )
    is_start = np.zeros(regions.num_regions, dtype=np.bool_)
    for position_number, (x, y, z) in enumerate(positions):
        row, col = lattice.rows_cols([x, y])
        surface_ids = np.empty(0, dtype=np.int64)
        cell = int(row) * lattice.width + int(col)
        if 0 <= row < lattice.height and 0 <= col < lattice.width:
            surface_ids = np.arange(surfaces.first[cell], surfaces.end[cell])
            surface_ids = surface_ids[regions.region_of(surface_ids) >= 0]
        surface_heights = surfaces.z[surface_ids]
        regions_in_column = regions.region_of(surface_ids)
        regions_below = regions_in_column[surface_heights <= z + max_step + LIMIT_SLACK]
        if not len(regions_below):
            heights_text = "there is none in that cell"
            if len(surface_heights):
                heights_text = (
                    f"floors there are at {', '.join(map(format_length, surface_heights))} m"
                )
            raise SceneError(
                f"no floor at `floors.from[{position_number}]` ({format_position((x, y, z))}): "
                f"expected one that an agent can stand on, at most a step higher; {heights_text}"
            )
        # the first that exists: the region at the position, a floor below it, a floor beside it
        regions_at_position = regions_in_column[
            abs(surface_heights - z) <= MAX_DISTANCE_ON_SURFACE + LIMIT_SLACK
        ]
        floor_regions_below = regions_below[may_start[regions_below]]
        if len(regions_at_position):
            start_region = int(regions_at_position[-1])
        elif len(floor_regions_below):
            start_region = int(floor_regions_below[-1])
        else:
            start_region = _find_floor_beside(region_context, may_start, int(regions_below[-1]))
        is_start[start_region] = True
    return is_start


def _find_floor_beside(
    region_context: RegionContext, may_start: Bool, furniture_region: int
) -> int:
    """Find the floor to which most edges of a piece of furniture drop.

    Args:
        region_context: all regions with their edges.
        may_start: which regions are floors, shape (regions,), bool.
        furniture_region: the id of the region on top of the furniture.

    Returns:
        The id of the floor's region; `furniture_region` if no edge drops to a floor.
    """
    is_furniture = np.arange(len(may_start)) == furniture_region
    context_with_furniture = replace(region_context, is_large=may_start | is_furniture)
    edges = context_with_furniture.select_edges(
        is_furniture, context_with_furniture.num_cells_beyond
    )
    endings = context_with_furniture.classify_edges(edges)
    floor_regions = endings.floor_region[endings.ending == DROP]
    return int(np.bincount(floor_regions).argmax()) if len(floor_regions) else furniture_region


def mark_largest_on_lowest_level(surface_counts: RegionLevelCounts, num_regions: int) -> Bool:
    """Mark the region that has the most surfaces on the lowest level.

    Args:
        surface_counts: how many surfaces each region has on each level.
        num_regions: how many regions there are.

    Returns:
        A mask, shape (regions,), bool; True for that region alone.
    """
    is_on_lowest_level = surface_counts.level == surface_counts.level.min()
    num_surfaces = np.bincount(
        surface_counts.region[is_on_lowest_level], surface_counts.num_surfaces[is_on_lowest_level]
    )
    is_largest_region: Bool = np.arange(num_regions) == num_surfaces.argmax()
    return is_largest_region


def count_surfaces_below_headroom(
    regions: Regions, columns: ColumnSource, agent: AgentSettings
) -> Int:
    """Count in each region the surfaces with less headroom than an adult needs, `ADULT_HEADROOM`.

    Args:
        regions: all regions.
        columns: the hits of all columns.
        agent: the agent, of which the height is used.

    Returns:
        How many such surfaces each region has, shape (regions,), int64.
    """
    surfaces = regions.surfaces
    cells = regions.blocks.list_cells(0, regions.lattice.height)
    cell_index, surface_ids = expand_ranges(surfaces.first[cells], surfaces.end[cells])
    region_of_surface = regions.region_of(surface_ids)
    has_region = region_of_surface >= 0
    cell = cells[cell_index[has_region]]
    surface_ids = surface_ids[has_region]
    is_below_headroom = np.zeros(len(cell), dtype=np.bool_)
    run_in_chunks(
        find_blocked_lines,
        len(cell),
        cell,
        surfaces.z[surface_ids] + agent.height - TOUCH_DEPTH,
        surfaces.z[surface_ids] + ADULT_HEADROOM,
        columns.columns_at(cell).hits,
        is_below_headroom,
        min_chunk_size=MIN_LINES_PER_THREAD,
    )
    return np.bincount(
        region_of_surface[has_region][is_below_headroom], minlength=regions.num_regions
    )


class ReachedRegions(NamedTuple):
    """Which regions are reached from the starts; masks of shape (regions,), bool.

    Attributes:
        is_reached: whether a path of steps and slopes leads from a start to the region.
        is_void: whether all levels that the region is on are voids. A void is a level that no path
            leads to and in which nobody can stand upright.
    """

    is_reached: Bool
    is_void: Bool


def find_voids(
    regions: Regions,
    columns: ColumnSource,
    surface_counts: RegionLevelCounts,
    is_reached: Bool,
    has_starts: bool,
    agent: AgentSettings,
) -> ReachedRegions:
    """Find the voids: levels that no path leads to and in which nobody can stand upright.

    Args:
        regions: all regions.
        columns: the hits of all columns.
        surface_counts: how many surfaces each region has on each level.
        is_reached: which regions are reached so far, shape (regions,), bool.
        has_starts: whether `floors.from` says where agents start. If not, they start on the largest
            floor of the lowest level in which an adult can stand upright.
        agent: the agent, of which the height is used.

    Returns:
        The regions that agents reach from their starts, and those that are on voids.
    """
    is_void = np.zeros_like(is_reached)
    level_numbers = np.unique(surface_counts.level)
    # headroom is measured only if some level is not reached at all
    if np.isin(level_numbers, surface_counts.level[is_reached[surface_counts.region]]).all():
        return ReachedRegions(is_reached, is_void)
    num_with_low_headroom = count_surfaces_below_headroom(regions, columns, agent)
    # the regions on each level, without repeats
    num_regions = regions.num_regions
    pair_ids = np.unique(surface_counts.level * num_regions + surface_counts.region)
    level, region = np.divmod(pair_ids, num_regions)
    num_surfaces_on_level = np.bincount(level, regions.num_surfaces[region])
    num_with_low_headroom_on_level = np.bincount(level, num_with_low_headroom[region])
    share_with_low_headroom = (
        num_with_low_headroom_on_level[level_numbers] / num_surfaces_on_level[level_numbers]
    )
    levels_without_headroom = level_numbers[share_with_low_headroom >= VOID_SHARE]
    is_on_level_without_headroom = np.isin(surface_counts.level, levels_without_headroom)
    if not has_starts and len(levels_without_headroom) < len(level_numbers):
        counts_on_levels_with_headroom = RegionLevelCounts._make(
            column[~is_on_level_without_headroom] for column in surface_counts
        )
        is_reached = mark_largest_on_lowest_level(counts_on_levels_with_headroom, len(is_reached))
    is_on_reached_level = np.isin(
        surface_counts.level, surface_counts.level[is_reached[surface_counts.region]]
    )
    is_on_void_level = is_on_level_without_headroom & ~is_on_reached_level
    # a region that is also on a level that is no void stays
    is_void[surface_counts.region[is_on_void_level]] = True
    is_void[surface_counts.region[~is_on_void_level]] = False
    return ReachedRegions(is_reached, is_void)


def find_unreached_floors(
    regions: Regions, assignment: LevelAssignment, is_reached: Bool
) -> list[UnreachedFloors]:
    """Find the floors that no path leads to, with one entry for each level, lowest first.

    On a level that is reached in part, only unreached regions with at least 6 m² there are listed.

    Args:
        regions: all regions.
        assignment: the level of each surface, and how many surfaces each region has on each level.
        is_reached: which regions are reached, shape (regions,), bool.
    """
    surface_counts = assignment.surface_counts
    num_regions = regions.num_regions
    # how many surfaces each region has on each level
    pair_ids, pair_of_row = np.unique(
        surface_counts.level * num_regions + surface_counts.region, return_inverse=True
    )
    level, region = np.divmod(pair_ids, num_regions)
    num_surfaces = np.bincount(pair_of_row, surface_counts.num_surfaces)
    num_levels = len(assignment.grounds)
    is_level_partly_reached = np.bincount(level, is_reached[region], num_levels) > 0
    area = num_surfaces * regions.lattice.cell_size**2
    is_large = area >= REPORTED_AREA - LIMIT_SLACK
    is_reported = ~is_reached[region] & (is_large | ~is_level_partly_reached[level])
    patches = _describe_on_levels(regions, assignment, pair_ids[is_reported])
    return [
        UnreachedFloors(
            level_number, patch, is_whole_level=not is_level_partly_reached[level_number]
        )
        for level_number, patch in patches.items()
    ]


def _describe_on_levels(
    regions: Regions, assignment: LevelAssignment, pair_ids: Int
) -> dict[int, Patch]:
    """Summarize the surfaces that some regions have on some levels, a patch for each level.

    Args:
        regions: all regions.
        assignment: the level of each surface.
        pair_ids: pairs of a level and a region that has surfaces on it, each as the number
            ``level * regions.num_regions + region``, ascending, shape (n,).

    Returns:
        Number of a level -> its patch, whose position is on the region with the most surfaces
        there.
    """
    if not len(pair_ids):
        return {}
    region_ids = np.unique(pair_ids % regions.num_regions)
    surfaces_of_region = dict(
        zip(region_ids.tolist(), regions.list_surfaces(region_ids), strict=True)
    )
    # number of a level -> for each region of a pair, its surfaces on the level
    surfaces_on_level: dict[int, list[RegionSurfaces]] = {}
    for pair_id in pair_ids.tolist():
        level_number, region = divmod(pair_id, regions.num_regions)
        region_surfaces = surfaces_of_region[region]
        is_on_level = np.isin(
            assignment.preliminary_level[region_surfaces.surface_id],
            np.flatnonzero(assignment.final_level == level_number),
        )
        surfaces_on_level.setdefault(level_number, []).append(region_surfaces.select(is_on_level))
    lattice = regions.lattice
    patches = {}
    for level_number, level_surfaces_by_region in surfaces_on_level.items():
        largest_surfaces = max(
            level_surfaces_by_region, key=lambda region_surfaces: len(region_surfaces.cell)
        )
        level_surfaces = largest_surfaces
        if len(level_surfaces_by_region) > 1:
            level_surfaces = RegionSurfaces._make(
                map(np.concatenate, zip(*level_surfaces_by_region, strict=True))
            )
        patches[level_number] = Patch(
            geom=int(np.bincount(level_surfaces.geom).argmax()),
            area=len(level_surfaces.cell) * lattice.cell_size**2,
            position=find_middle_position(lattice, largest_surfaces),
            cells=level_surfaces.cell.astype(np.int32),
        )
    return patches


def find_enclosed_floors(
    surfaces: Surfaces, agent: AgentSettings, settings: FloorSettings
) -> list[Patch]:
    """Find floors on which no agent can stand because a closed mesh or a plane encloses them.

    Such a floor lies inside of the mesh, or below the infinite plane. A floor is not listed if it
    continues outside, at most a step higher or lower, along at least a quarter of its outline: a
    closed object, such as a crate, then stands on a floor. A floor of at least 50 m² is always
    listed, as the mesh may be a building.

    Args:
        surfaces: all surfaces.
        agent: the agent, of which the step and slope are used.
        settings: the settings of `floors`; `min_area` and `shrink` are used.

    Returns:
        The floors, the largest first; `Patch.geom` is the mesh or plane that encloses each.
    """
    is_enclosed = surfaces.flags & ENCLOSED != 0
    if not is_enclosed.any():
        return []
    # each region is of one mesh or plane
    group_of_surface = np.where(is_enclosed, surfaces.geom, np.int32(-1))
    regions = find_regions(surfaces, agent, group_of_surface)
    is_large = find_large_regions(regions, regions.num_surfaces > 0, settings)
    patches = []
    for region_surfaces in regions.list_surfaces(np.flatnonzero(is_large)):
        num_edges = 0
        num_continuing_edges = 0
        for direction in range(4):
            neighbors = find_neighbor_cells(regions.lattice, region_surfaces.cell, direction)
            # edges of the region in this direction, and how many of them continue outside
            is_edge = ~np.isin(neighbors, region_surfaces.cell)
            num_edges += int(np.count_nonzero(is_edge))
            is_inside = is_edge & (neighbors >= 0)
            neighbors = neighbors[is_inside]
            continued_z = find_highest_within_step(
                surfaces.first[neighbors],
                surfaces.end[neighbors],
                surfaces.z,
                region_surfaces.z[is_inside],
                agent.traversable_floor_height,
            )
            num_continuing_edges += int(np.count_nonzero(~np.isnan(continued_z)))
        patch = describe_surfaces(regions.lattice, region_surfaces)
        if patch.area >= BUILDING_AREA or num_continuing_edges < CONTINUING_SHARE * num_edges:
            patches.append(patch)
    return sorted(patches, key=lambda patch: -patch.area)
