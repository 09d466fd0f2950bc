"""Find the floors of a scene: from the surfaces of all columns to the floor of each level.

A column holds all surfaces on the vertical line through a cell's centre. `find_floors` calls the
other modules of this folder in their order; `crop_floors` cuts a window out of the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from navbake.baker.columns.columns import ColumnSource
from navbake.baker.core.components import label_components_2d
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.windows import Window, crop_cells
from navbake.baker.floors.below_grounds import FloorBelowGround, find_floors_below_grounds
from navbake.baker.floors.growth import (
    find_listed_steps,
    grow_levels,
    select_growing_surfaces,
)
from navbake.baker.floors.level_assignment import (
    LevelAssignment,
    assign_levels,
    list_level_height_ranges,
)
from navbake.baker.floors.outline import (
    OccupancyTest,
    RegionContext,
    mark_cropped_sides,
)
from navbake.baker.floors.reach import (
    ReachedRegions,
    UnreachedFloors,
    find_enclosed_floors,
    find_start_regions,
    find_unreached_floors,
    find_voids,
    mark_largest_on_lowest_level,
)
from navbake.baker.floors.regions import (
    Patch,
    Regions,
    describe_regions,
    find_large_regions,
    find_large_remaining_regions,
    find_regions,
    remove_from_regions,
)
from navbake.baker.floors.rejected import find_rejected_regions, mark_reported_roofs
from navbake.baker.floors.ridges import RIDGE_WIDTH, find_ridges
from navbake.baker.floors.surface_kernels import Surfaces
from navbake.baker.floors.surfaces import find_surfaces
from navbake.baker.geometry.shapes import Shapes
from navbake.config.settings import AgentSettings, FloorSettings, LevelSettings
from navbake.errors import SceneError
from navbake.lengths import format_coordinate
from navbake.types import Bool, Float, Int, Int32


@dataclass(frozen=True)
class LevelFloor:
    """The floor of one level, on the whole lattice.

    Attributes:
        name: the configured name, or ``level <number>``, the lowest level being 0.
        ground: the level's ground height [m].
        floor: floor heights, NaN for none, shape (height, width), float64 [m].
        standable: where an agent can stand on the floor, or the floor closes a hole, shape (height,
            width), bool. Elsewhere the floor only goes on under things.
        unseen: where the floor closes a hole, shape (height, width), bool; None if holes stay open.
    """

    name: str
    ground: float
    floor: Float
    standable: Bool
    unseen: Bool | None = None


@dataclass(frozen=True)
class Floors:
    """The floors of all levels, the steps between them, and the surfaces that warnings report.

    Attributes:
        levels: the floor of each level, lowest first.
        steps: pairs of neighboring cells that an agent can walk between though they are on
            different levels, or though only a slope joins them, shape (n, 4), int64. Columns: the
            lower level, its cell, the upper level, its cell; cells are ids on the whole lattice.
        tops: large surfaces of furniture and other things, which are no floors, the largest first.
        roofs: roofs to report, which are no floors, the largest first.
        small_starts: small surfaces that are floors only because a position of `floors.from` lies
            on them, the largest first.
        unreached_floors: floors that no path from a start leads to, an entry for each level, lowest
            first.
        removed_floors: floors that `floors.reach: steps` leaves out, the largest first.
        enclosed_by_meshes: floors inside of closed meshes; `Patch.geom` is the mesh.
        enclosed_by_planes: floors inside of infinite planes; `Patch.geom` is the plane.
        voids: floors of levels that are left out because no path leads to them and nobody can stand
            upright there, the largest first.
        surfaces_without_level: surfaces that are on no level, because their columns have more
            surfaces than there are levels.
        floors_below_grounds: floors that are on no level, because they lie a little below the
            ground of a level of the configuration.
    """

    levels: list[LevelFloor]
    steps: Int
    tops: list[Patch]
    roofs: list[Patch]
    small_starts: list[Patch]
    unreached_floors: list[UnreachedFloors]
    removed_floors: list[Patch]
    enclosed_by_meshes: list[Patch]
    enclosed_by_planes: list[Patch]
    voids: list[Patch]
    surfaces_without_level: list[Patch]
    floors_below_grounds: list[FloorBelowGround]


def find_floors(
    columns: ColumnSource,
    shapes: Shapes,
    agent: AgentSettings,
    settings: FloorSettings,
    level_settings: Sequence[LevelSettings] | None,
    is_occupied: OccupancyTest,
) -> Floors:
    """Find the levels of a scene, the floor of each, and the steps between them.

    The stages: find regions, and which of them are floors; assign the floors to levels; let floors
    grow under things.

    Args:
        columns: the hits of all columns.
        shapes: the geometry that the columns cross.
        agent: the agent that stands and steps on floors.
        settings: the settings of `floors`.
        level_settings: the levels of the configuration, lowest first; None to find the levels.
        is_occupied: tests whether something stands on a floor in some cells.

    Returns:
        The floors on the whole lattice, their steps, and what warnings report.

    Raises:
        SceneError: there is no floor at all, none on a level of the configuration, or none at a
            position of `floors.from`; or there are too many levels.
    """
    classified_regions = _classify_regions(
        columns, shapes, agent, settings, level_settings or (), is_occupied
    )
    columns.release_memory()  # from here on, only a level that may be a void needs columns
    assigned_floors = _assign_floors(
        classified_regions, columns, shapes.planes.geom, agent, settings, level_settings
    )
    assignment = assigned_floors.assignment
    floors = assigned_floors.floors
    growing_surfaces = select_growing_surfaces(
        classified_regions.regions, assignment, classified_regions.is_growth_barrier
    )
    names = assignment.names
    grounds = assignment.grounds
    # growth needs neither regions nor geoms: their memory is free for it
    del classified_regions, assigned_floors, assignment
    columns.release_memory()
    grown_floors = grow_levels(growing_surfaces, len(grounds), agent)
    levels = []
    for name, ground, grown_floor in zip(names, grounds, grown_floors, strict=True):
        floor_height = grown_floor.height.reshape(columns.lattice.shape)
        is_standable = (grown_floor.ring_of_cell == 0).reshape(columns.lattice.shape)
        level = LevelFloor(name, ground, floor_height, is_standable)
        if settings.fill:
            level = fill_holes(level, settings.fill / columns.lattice.cell_size**2, is_occupied)
        levels.append(level)
    return replace(floors, levels=levels)


class ClassifiedRegions(NamedTuple):
    """All regions, and what they are; masks of shape (regions,), bool.

    Attributes:
        regions: all regions.
        is_large: marks the regions that are large enough for floors.
        is_start: marks the regions on which `floors.from` has agents start.
        is_floor: marks the regions that are floors.
        is_furniture: marks the large regions that are tops of things or shelves.
        is_reported_roof: marks the roofs to report.
    """

    regions: Regions
    is_large: Bool
    is_start: Bool
    is_floor: Bool
    is_furniture: Bool
    is_reported_roof: Bool

    @property
    def is_growth_barrier(self) -> Bool:
        """Return which regions floors don't grow onto, such as roofs and tops of furniture."""
        return self.is_large | self.is_start


def _classify_regions(
    columns: ColumnSource,
    shapes: Shapes,
    agent: AgentSettings,
    settings: FloorSettings,
    level_settings: Sequence[LevelSettings],
    is_occupied: OccupancyTest,
) -> ClassifiedRegions:
    """Find all regions, and which of them are floors.

    The stages: find the standable surfaces; connect them to regions; drop ridges, and connect the
    rest again; keep the large regions; drop tops, shelves and roofs. The arguments are those of
    `find_floors`; `level_settings` is empty where the levels are to be found.

    Raises:
        SceneError: there is no floor at all, or none at a position of `floors.from`.
    """
    surfaces = find_surfaces(columns, shapes.planes, agent)
    columns.release_memory()
    regions = find_regions(surfaces, agent)
    if not regions.num_regions:
        raise SceneError(_explain_no_floor(columns, regions.surfaces, agent))
    region_context = RegionContext(
        regions=regions,
        is_large=find_large_regions(
            regions, np.ones(regions.num_regions, dtype=np.bool_), settings
        ),
        columns=columns,
        is_cropped=mark_cropped_sides(columns.lattice, shapes.bounds),
        agent=agent,
        settings=settings,
        is_occupied=is_occupied,
    )
    del surfaces, regions  # without ridges there will be others, and these take much memory
    if not settings.tops:
        region_context = _remove_ridges(region_context, settings.starts)
    is_large = region_context.is_large
    rejected_regions = find_rejected_regions(
        region_context, list_level_height_ranges(level_settings), shapes.height_fields
    )
    is_start = find_start_regions(region_context, rejected_regions, settings.starts)
    is_furniture = rejected_regions.is_top | rejected_regions.is_shelf
    # where agents start is a floor, whatever the rules say
    is_floor = is_large & ~(is_furniture | rejected_regions.is_roof) | is_start
    if not is_floor.any():
        raise SceneError(
            f"no floor: the largest standable region keeps less than {settings.min_area:g} m² "
            f"after shrinking by {settings.shrink:g} m; lower `floors.min_area` or "
            f"`floors.shrink` if it is a floor"
        )
    is_reported_roof = mark_reported_roofs(
        region_context, rejected_regions.is_roof & ~is_start, is_floor
    )
    return ClassifiedRegions(
        region_context.regions,
        is_large=is_large,
        is_start=is_start,
        is_floor=is_floor,
        is_furniture=is_furniture,
        is_reported_roof=is_reported_roof,
    )


def _remove_ridges(region_context: RegionContext, starts: list[list[float]]) -> RegionContext:
    """Return the regions without ridges, and which of them are large.

    Args:
        region_context: all regions.
        starts: the positions of `floors.from`, whose ridges are kept.

    Raises:
        SceneError: no large region is left.
    """
    regions = region_context.regions
    ridge_surfaces = find_ridges(region_context, starts)
    if not len(ridge_surfaces):
        return region_context
    changed_blocks = regions.list_blocks_of(ridge_surfaces)
    remaining_regions = remove_from_regions(
        regions, ridge_surfaces, changed_blocks, region_context.agent
    )
    is_large = find_large_remaining_regions(
        remaining_regions,
        regions,
        region_context.is_large,
        changed_blocks,
        region_context.settings,
    )
    if not is_large.any():
        raise SceneError(
            f"no floor: what is large enough is narrower than {RIDGE_WIDTH:g} m between "
            f"drops, as tops of walls and beams are; `floors.tops: true` keeps it"
        )
    return replace(region_context, regions=remaining_regions, is_large=is_large)


class AssignedFloors(NamedTuple):
    """The levels of the floors.

    Attributes:
        assignment: the levels, and the level of each surface.
        floors: all else that `find_floors` finds; its `levels` are empty.
    """

    assignment: LevelAssignment
    floors: Floors


def _assign_floors(
    classified_regions: ClassifiedRegions,
    columns: ColumnSource,
    plane_geoms: Int32,
    agent: AgentSettings,
    settings: FloorSettings,
    level_settings: Sequence[LevelSettings] | None,
) -> AssignedFloors:
    """Assign the floors to levels, drop what is not reached or is a void, and list the steps.

    Args:
        classified_regions: all regions, and which of them are floors.
        columns: the hits of all columns.
        plane_geoms: the ids of the geoms that are infinite planes, shape (n,).
        agent: the agent that stands and steps on floors.
        settings: the settings of `floors`.
        level_settings: the levels of the configuration, lowest first; None to find the levels.

    Raises:
        SceneError: there is no floor on a level of the configuration, or what the starts reach is
            on none.
    """
    regions = classified_regions.regions
    is_start = classified_regions.is_start
    reached_levels = find_reached_levels(
        regions,
        columns,
        is_floor=classified_regions.is_floor,
        is_start=is_start,
        level_settings=level_settings,
        agent=agent,
        settings=settings,
    )
    assignment = reached_levels.assignment
    enclosed_floors = find_enclosed_floors(regions.surfaces, agent, settings)
    floors = Floors(
        levels=[],
        steps=find_listed_steps(regions, assignment, agent),
        tops=describe_regions(regions, classified_regions.is_furniture & ~is_start),
        roofs=describe_regions(regions, classified_regions.is_reported_roof),
        small_starts=describe_regions(regions, is_start & ~classified_regions.is_large),
        unreached_floors=find_unreached_floors(regions, assignment, reached_levels.is_reached),
        removed_floors=reached_levels.removed_floors,
        enclosed_by_meshes=[patch for patch in enclosed_floors if patch.geom not in plane_geoms],
        enclosed_by_planes=[patch for patch in enclosed_floors if patch.geom in plane_geoms],
        voids=reached_levels.voids,
        surfaces_without_level=assignment.surfaces_without_level,
        floors_below_grounds=reached_levels.floors_below_grounds,
    )
    return AssignedFloors(assignment, floors)


class ReachedLevels(NamedTuple):
    """The levels of the grid, the regions that agents reach, and the floors that are left out.

    Attributes:
        assignment: the levels, and the level of each surface.
        is_reached: which regions are reached from a start, shape (regions,), bool.
        removed_floors: floors that `floors.reach: steps` leaves out, the largest first.
        voids: floors of levels that are left out because no path leads to them and nobody can stand
            upright there, the largest first.
        floors_below_grounds: floors that are on no level, because they lie a little below the
            ground of a level of the configuration.
    """

    assignment: LevelAssignment
    is_reached: Bool
    removed_floors: list[Patch]
    voids: list[Patch]
    floors_below_grounds: list[FloorBelowGround]


def find_reached_levels(
    regions: Regions,
    columns: ColumnSource,
    is_floor: Bool,
    is_start: Bool,
    level_settings: Sequence[LevelSettings] | None,
    agent: AgentSettings,
    settings: FloorSettings,
) -> ReachedLevels:
    """Assign floors to levels, and leave out the floors that no agent reaches.

    With `floors.reach: steps`, the floors that no path from a start leads to are left out.
    Otherwise only voids are left out: levels that no path leads to and in which nobody can stand
    upright. They are kept if `floors.voids` is set, or if the configuration has levels.

    Args:
        regions: all regions.
        columns: the hits of all columns.
        is_floor: which regions are floors, shape (regions,), bool.
        is_start: the regions on which `floors.from` has agents start, shape (regions,); if none,
            agents start on the largest floor of the lowest level.
        level_settings: the levels of the configuration, lowest first; None to find the levels.
        agent: the agent, of which the height, step and slope are used.
        settings: the settings of `floors`.

    Raises:
        SceneError: there is no floor on a level of the configuration, or what the starts reach is
            on none.
    """
    is_reach_required = settings.reach == "steps"
    has_starts = bool(is_start.any())
    reached_regions = ReachedRegions(is_start, np.zeros_like(is_floor))
    assignment = None
    if not has_starts or (level_settings is None and not is_reach_required):
        # starts and voids depend on the levels of all floors, whatever the configuration has
        assignment = assign_levels(regions, is_floor, (), agent, settings)
        if not has_starts:
            is_reached = mark_largest_on_lowest_level(
                assignment.surface_counts, regions.num_regions
            )
            reached_regions = reached_regions._replace(is_reached=is_reached)
        if level_settings is None and not settings.voids:
            reached_regions = find_voids(
                regions,
                columns,
                surface_counts=assignment.surface_counts,
                is_reached=reached_regions.is_reached,
                has_starts=has_starts,
                agent=agent,
            )
    height_ranges = list_level_height_ranges(level_settings or ())
    for level_number, height_range in enumerate(height_ranges):
        if not regions.mark_regions_in_range(is_floor, height_range).any():
            lower_floors = find_floors_below_grounds(
                regions, is_floor, level_settings or (), settings
            )
            raise SceneError(
                _explain_no_floor_on(level_settings or (), level_number, columns, lower_floors)
            )
    is_included = is_floor & (
        reached_regions.is_reached if is_reach_required else ~reached_regions.is_void
    )
    if (
        assignment is None
        or level_settings is not None
        or not np.array_equal(is_included, is_floor)
    ):
        assignment = assign_levels(regions, is_included, level_settings or (), agent, settings)
        if not len(assignment.surface_counts.level):
            start_text = "what `floors.from` names"
            if not has_starts:
                start_text = "the largest floor of the lowest level"
            raise SceneError(f"no floor: {start_text} lies outside of the `levels`")
    removed_floors: list[Patch] = []
    voids: list[Patch] = []
    if is_reach_required:
        is_removed = is_floor & ~reached_regions.is_reached
        removed_floors = describe_regions(regions, is_removed, height_ranges)
    else:
        voids = describe_regions(regions, reached_regions.is_void)
    return ReachedLevels(
        assignment,
        is_reached=reached_regions.is_reached,
        removed_floors=removed_floors,
        voids=voids,
        floors_below_grounds=find_floors_below_grounds(
            regions, is_included, level_settings or (), settings
        ),
    )


def fill_holes(level: LevelFloor, max_cells: float, is_occupied: OccupancyTest) -> LevelFloor:
    """Close the small holes in a level's floor, such as a scan has in the shadow of things.

    The heights in a hole are interpolated from the floor around it (linearly, over a Delaunay
    triangulation). Holes that agents can't get to from the floor, such as the inside of a pillar,
    stay open.

    Args:
        level: the level.
        max_cells: holes with more cells stay open.
        is_occupied: tests whether something stands on a floor in some cells.

    Returns:
        The level with a floor in the closed holes; its mask `unseen` is True there.
    """
    hole_of_cell, num_cells = label_components_2d(np.isnan(level.floor))
    num_cells_in_hole = num_cells.astype(np.float64)
    # holes at the lattice's border are not surrounded by floor
    for border_holes in (
        hole_of_cell[0],
        hole_of_cell[-1],
        hole_of_cell[:, 0],
        hole_of_cell[:, -1],
    ):
        num_cells_in_hole[border_holes] = np.inf
    num_cells_in_hole[0] = np.inf  # cells with a floor
    is_hole_filled = num_cells_in_hole <= max_cells + LIMIT_SLACK
    if not is_hole_filled.any():
        return replace(level, unseen=np.zeros(level.floor.shape, dtype=np.bool_))
    from scipy.interpolate import griddata  # scipy loads slowly, and few bakes need this
    from scipy.ndimage import binary_dilation  # likewise

    # holes to close, with their rims
    is_filled: Bool = is_hole_filled[hole_of_cell]
    is_near_hole = binary_dilation(is_filled, np.ones((3, 3)))
    is_rim = is_near_hole & ~is_filled & ~np.isnan(level.floor)
    floor = level.floor.copy()
    floor[is_filled] = griddata(np.argwhere(is_rim), floor[is_rim], np.argwhere(is_filled))
    is_near_hole &= ~np.isnan(floor)
    is_free = is_near_hole.copy()
    is_free[is_near_hole] = ~is_occupied(np.flatnonzero(is_near_hole), floor[is_near_hole], None)
    # free cells connected to floor at the rim, and things that stand in a hole with such cells
    part_of_cell, _ = label_components_2d(is_free)
    is_connected = is_free & np.isin(part_of_cell, part_of_cell[is_free & is_rim])
    is_in_reached_hole = np.isin(hole_of_cell, hole_of_cell[is_connected & is_filled])
    is_filled &= is_connected | (is_in_reached_hole & ~is_free)
    floor[~is_filled & (hole_of_cell > 0)] = np.nan
    return replace(level, floor=floor, standable=level.standable | is_filled, unseen=is_filled)


def crop_floors(floors: Floors, window: Window) -> Floors:
    """Crop the floors of a whole scene to the window that is baked.

    Levels without a place to stand in the window are left out, and so are summaries of surfaces
    (`Patch`: tops, roofs, unreached floors) that lie outside of it.

    Args:
        floors: the floors on the whole lattice.
        window: rows and columns of that lattice.

    Raises:
        SceneError: no floor lies in the window.
    """
    levels_in_window = [k for k, level in enumerate(floors.levels) if level.standable[window].any()]
    if not levels_in_window:
        raise SceneError("no floor lies inside of `grid.bounds`")
    new_number_of_level = np.full(len(floors.levels), -1, dtype=np.int64)
    new_number_of_level[levels_in_window] = np.arange(len(levels_in_window))
    width = floors.levels[0].floor.shape[1]

    def crop_patches(patches: list[Patch]) -> list[Patch]:
        return [patch for patch in patches if _is_inside(patch, window, width)]

    unreached_floors = []
    for unreached_on_level in floors.unreached_floors:
        new_number = int(new_number_of_level[unreached_on_level.level])
        if new_number >= 0 and _is_inside(unreached_on_level.patch, window, width):
            unreached_floors.append(replace(unreached_on_level, level=new_number))
    return Floors(
        levels=[
            _crop_level(floors.levels[old_number], window, old_number, new_number)
            for new_number, old_number in enumerate(levels_in_window)
        ],
        steps=_crop_steps(floors.steps, new_number_of_level, window, width),
        tops=crop_patches(floors.tops),
        roofs=crop_patches(floors.roofs),
        small_starts=crop_patches(floors.small_starts),
        unreached_floors=unreached_floors,
        removed_floors=crop_patches(floors.removed_floors),
        enclosed_by_meshes=crop_patches(floors.enclosed_by_meshes),
        enclosed_by_planes=crop_patches(floors.enclosed_by_planes),
        voids=crop_patches(floors.voids),
        surfaces_without_level=crop_patches(floors.surfaces_without_level),
        floors_below_grounds=[
            floor for floor in floors.floors_below_grounds if _is_inside(floor.patch, window, width)
        ],
    )


def _is_inside(patch: Patch, window: Window, width: int) -> bool:
    """Return whether any cell of a patch lies in a window of a lattice `width` cells wide."""
    _, is_inside = crop_cells(patch.cells.astype(np.int64), window, width)
    return bool(is_inside.any())


def _crop_level(level: LevelFloor, window: Window, old_number: int, new_number: int) -> LevelFloor:
    """Crop a level to a window of the lattice, and number it anew.

    Args:
        level: the level on the whole lattice.
        window: rows and columns of that lattice.
        old_number: the level's number before cropping; if it is named by it, the name changes.
        new_number: the level's number after cropping.
    """
    name = level.name
    if name == f"level {old_number}":
        name = f"level {new_number}"
    return LevelFloor(
        name=name,
        ground=level.ground,
        floor=level.floor[window].copy(),
        standable=level.standable[window].copy(),
        unseen=None if level.unseen is None else level.unseen[window].copy(),
    )


def _crop_steps(steps: Int, new_number_of_level: Int, window: Window, width: int) -> Int:
    """Crop steps between levels to a window.

    Args:
        steps: `Floors.steps`.
        new_number_of_level: the new number of each level, -1 for levels that are left out.
        window: rows and columns of the whole lattice.
        width: the number of columns of the whole lattice.

    Returns:
        The steps with both ends in the window; new level numbers, and cell ids in the window.
    """
    lower_level, lower_cell, upper_level, upper_cell = steps.T
    has_both_levels = (new_number_of_level[lower_level] >= 0) & (
        new_number_of_level[upper_level] >= 0
    )
    _, is_lower_inside = crop_cells(lower_cell, window, width)
    _, is_upper_inside = crop_cells(upper_cell, window, width)
    is_step_inside = has_both_levels & is_lower_inside & is_upper_inside
    new_lower_cell, _ = crop_cells(lower_cell[is_step_inside], window, width)
    new_upper_cell, _ = crop_cells(upper_cell[is_step_inside], window, width)
    step_columns = [
        new_number_of_level[lower_level[is_step_inside]],
        new_lower_cell,
        new_number_of_level[upper_level[is_step_inside]],
        new_upper_cell,
    ]
    return np.stack(step_columns, axis=1)


def _explain_no_floor_on(
    level_settings: Sequence[LevelSettings],
    level_number: int,
    columns: ColumnSource,
    lower_floors: Sequence[FloorBelowGround],
) -> str:
    """Word the error that a level of the configuration has no floor.

    Args:
        level_settings: the levels of the configuration, lowest first.
        level_number: index of the level in these.
        columns: the hits of all columns.
        lower_floors: the floors a little below the grounds of the levels.
    """
    level_setting = level_settings[level_number]
    name = f"level {level_setting.name!r}" if level_setting.name else f"level {level_number}"
    top = np.inf
    if level_number + 1 < len(level_settings):
        top = level_settings[level_number + 1].ground
    if level_setting.top is not None:
        top = min(top, level_setting.top)
    lowest_z = np.inf
    highest_z = -np.inf
    for chunk in columns.row_chunks():
        lowest_z = min(lowest_z, chunk.z.min(initial=np.inf))
        highest_z = max(highest_z, chunk.z.max(initial=-np.inf))
    top_text = f", top {top:g} m" if np.isfinite(top) else ""
    hints = [
        f"; `ground: {format_coordinate(floor.lower_ground)}` takes in {floor.patch.area:.1f} m²"
        for floor in lower_floors
        if floor.ground == level_setting.ground
    ]
    return (
        f"no floor on {name} (ground {level_setting.ground:g} m{top_text}) of `levels`: "
        f"the scene's surfaces span {format_coordinate(lowest_z)} to "
        f"{format_coordinate(highest_z)} m{''.join(hints)}"
    )


def _explain_no_floor(columns: ColumnSource, surfaces: Surfaces, agent: AgentSettings) -> str:
    """Word the error that no surface is standable."""
    num_hits = sum(len(chunk.z) for chunk in columns.row_chunks())
    if not num_hits:
        return "no floor at all: no vertical line through a cell's centre meets a geom"
    if not len(surfaces.z):
        return (
            f"no floor at all: none of {num_hits} surfaces faces up within "
            f"{agent.max_slope:g}° (a mesh may be inside out, or `scene.up` wrong)"
        )
    return (
        f"no floor at all: none of {len(surfaces.z)} surfaces that face up has "
        f"{agent.height:g} m of headroom (a wrong unit, or everything lies inside of a solid: "
        f"`scene.meshes: shell` makes closed meshes hollow)"
    )
