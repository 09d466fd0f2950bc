"""Gathers the inputs of the search for rooms: flags of each cell, and the rooms that are marked.

`gather_flags` combines the results of earlier stages: the floors, flags of each cell's vertical
line, and the structure in each cell. `mark_rooms` finds the rooms that geoms, sites and polygons
mark. Rooms depend only on what is gathered here, on settings and on closed door leaves.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from fnmatch import translate
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import ColumnSource, cast_columns, tile_shapes
from navbake.baker.core.arrays import Solids
from navbake.baker.core.components import find_row_runs, label_runs
from navbake.baker.core.constants import BUILDING, WALL
from navbake.baker.core.tolerances import SAME_HEIGHT
from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.geometry.shapes import Shapes, solid_bounds
from navbake.baker.occupants.column_flag_kernels import EMPTY, HOLE, SKY, STEEP_GROUND, TALL
from navbake.baker.occupants.standing import StandingOccupants
from navbake.baker.rooms.gap_limits import MAX_GAP_WIDTH
from navbake.baker.rooms.walls import find_windows
from navbake.baker.scene.collect import GeomSelection, collect_shapes
from navbake.baker.scene.names import all_names, warn_unmatched
from navbake.baker.scene.scene import Scene
from navbake.config.settings import DEFAULT_GEOMS, DEFAULT_SITES, AgentSettings, RoomSettings
from navbake.errors import ConfigError
from navbake.navgrid.lattice import Lattice, cover_cells
from navbake.types import Bool, Float, Int, Int32

if TYPE_CHECKING:  # a caller that has a model has imported it
    import mujoco

# The scene ends at a side of the lattice if it exceeds that side by at most this [cells]
MAX_SCENE_EXCESS = 0.5
# An outdoor area touches the grid's edge over a connected length greater than this: no opening in a
# wall is that wide [m]
MIN_OUTDOOR_EDGE = MAX_GAP_WIDTH
# A mask of all sides of a lattice, [[upper, lower], [left, right]]
ALL_SIDES = np.ones((2, 2), dtype=np.bool_)

# A geom that marks a room is at most this far below the walkable floor (it may be under a rug) …
MAX_MARKER_DEPTH = 0.05  # [m]
# … or this far above it (it may be a drawn floor above the one that collides)
MAX_MARKER_HEIGHT = 0.005  # [m]
# A geom marks a room if at least this share of its upper side is floor
MIN_FLOOR_SHARE = 0.5
# These prefixes of a floor geom's name are removed to make the room's name
FLOOR_PREFIXES = ("floor|", "floor_")
# A site's volume is cut off this far below the floor [m]
MAX_SITE_GAP = 0.05
# An agent stands in a site's volume if this share of the volume's height, or of the agent's if that
# is less, is between the floor and the agent's head
MIN_STANDING_SHARE = 0.5
# Setting -> its default patterns; no warning is given if they match nothing
DEFAULT_PATTERNS = {"geoms": DEFAULT_GEOMS, "sites": DEFAULT_SITES}
# The most names that a warning lists
MAX_LISTED_SITES = 5


class MarkedRooms(NamedTuple):
    """The rooms that one source finds: geoms, sites, polygons, or the automatic search for gaps.

    The setting `rooms.sources` lists the sources.

    Attributes:
        names: the rooms' names, None for a room without a name. Room number k + 1 has ``names[k]``.
        labels: for each level, the number of each cell's room, 0 for none, shape (height, width).
            Empty if there are no rooms.
        warnings: warnings for the user, one line each.
        covered_labels: like `labels`, but a room also has the cells over its floor whose own floor
            is up to a step higher (on a podium, for example). Empty if it equals `labels`.
        outdoor_rooms: the numbers of the rooms that are outdoors.
    """

    names: Sequence[str | None]
    labels: Sequence[Int32]
    warnings: Sequence[str] = ()
    covered_labels: Sequence[Int32] = ()
    outdoor_rooms: Set[int] = frozenset()


class LevelFlags(NamedTuple):
    """Flags of a level's cells, shape (height, width) of the whole lattice.

    Attributes:
        floor: z of the cell's floor, NaN if it has none [m].
        is_open: whether the cell has a floor, and is in no wall or window.
        is_hole: whether the cell has no floor, and nothing is at the heights of an agent's body
            above the level's ground.
        is_at_edge: whether the cell is open, nothing taller than 1.5 m stands on its floor, and it
            is at the outer boundary of the scene. That is the grid's edge, or the rim of an area
            that is connected to the grid's edge, and that is empty or too steep to stand on.
        is_under_sky: whether the cell has a floor and nothing is above an agent's head. All False
            on levels with too few cells at the edge for anything to be outdoors.
        is_bank: whether the cell has no floor because its highest surface is ground that is too
            steep to stand on.
        is_occupied: whether the cell has no floor, or structure is over the cell's square between
            the agent's highest step and its height.
    """

    floor: Float
    is_open: Bool
    is_hole: Bool
    is_at_edge: Bool
    is_under_sky: Bool
    is_bank: Bool
    is_occupied: Bool


class RoomFlags(NamedTuple):
    """All inputs from which rooms are found, except settings and closed door leaves.

    Attributes:
        lattice: the whole lattice.
        levels: the flags of each level, lowest first.
        is_at_scene_end: a mask of the cells where the scene ends, shape (height, width): those at
            the sides of the lattice that don't crop the scene, and at the rim of areas without any
            structure that are connected to such a side.
        wall_shapes: the geometry of walls, and of meshes that contain a whole building.
        has_ground: whether an endless ground continues beyond the lattice.
        steps: pairs of cells that a step to another level, or a slope, joins, see `Floors.steps`,
            shape (n, 4).
        marked_rooms: the rooms that the scene or the settings state, by what states them:
            ``geoms``, ``sites`` or ``polygons``, as in `rooms.sources`.
    """

    lattice: Lattice
    levels: list[LevelFlags]
    is_at_scene_end: Bool
    wall_shapes: Shapes
    has_ground: bool
    steps: Int
    marked_rooms: Mapping[str, MarkedRooms]


def gather_flags(
    scene: Scene,
    columns: ColumnSource,
    floors: Floors,
    column_flags: Sequence[NDArray[np.uint8]],
    standing_occupants: StandingOccupants | None,
    occupied_masks: Sequence[Bool],
    settings: RoomSettings,
    agent: AgentSettings,
) -> RoomFlags:
    """Gather all inputs from which rooms are found, except settings and closed door leaves.

    Args:
        scene: the scene, whose geoms and sites may mark rooms.
        columns: hits of structure on the vertical line through each cell's centre.
        floors: the floors of all levels, at least one.
        column_flags: for each level, bits of its cells that the hits on their vertical lines
            decide, see `flag_columns`, shape (cells,), uint8.
        standing_occupants: the structure that stands in the cells, of which walls are read; None if
            rooms are found without walls.
        occupied_masks: for each level, a mask of the cells without a floor or with structure at an
            agent's height, see `LevelFlags.is_occupied`.
        settings: how rooms are marked.
        agent: the agent that stands in the volumes of sites.

    Returns:
        The flags of the cells of all levels, the geometry of walls, and the rooms that geoms, sites
        and polygons mark.
    """
    lattice = columns.lattice
    levels = list[LevelFlags]()
    # the same on all levels
    is_empty = (column_flags[0].reshape(lattice.shape) & EMPTY) > 0
    is_at_outside = mark_edge(is_empty, ALL_SIDES)
    is_scene_end = _find_scene_ends(scene, lattice)
    is_at_scene_end = is_at_outside if is_scene_end.all() else mark_edge(is_empty, is_scene_end)
    is_wall = np.zeros(lattice.shape, dtype=np.bool_)
    is_low = np.zeros(lattice.shape, dtype=np.bool_)
    for level_number, level in enumerate(floors.levels):
        if standing_occupants is not None:
            is_wall, is_low = standing_occupants.mark_walls(level_number)
        flag_bits = column_flags[level_number].reshape(lattice.shape)
        is_bank = (flag_bits & STEEP_GROUND) > 0
        is_under_sky = (flag_bits & SKY) > 0
        is_window = find_windows(is_low, is_wall, lattice.cell_size)
        is_closed = np.isnan(level.floor)
        is_closed |= is_wall
        is_closed |= is_window
        is_open = ~is_closed
        is_at_edge = is_open & ((flag_bits & TALL) == 0)
        is_at_edge &= mark_edge(is_empty | is_bank, ALL_SIDES) if is_bank.any() else is_at_outside
        # The extent if all cells at the edge are in one diagonal line: the largest that is possible
        max_extent = np.sqrt(2) * np.count_nonzero(is_at_edge) * lattice.cell_size
        if max_extent <= MIN_OUTDOOR_EDGE:
            is_under_sky[:] = False
        levels.append(
            LevelFlags(
                floor=level.floor,
                is_open=is_open,
                is_hole=(flag_bits & HOLE) > 0,
                is_at_edge=is_at_edge,
                is_under_sky=is_under_sky,
                is_bank=is_bank,
                is_occupied=occupied_masks[level_number],
            )
        )
    is_wall_geom = np.zeros(len(scene.geoms), dtype=np.bool_)
    if standing_occupants is not None:
        is_wall_geom = np.isin(standing_occupants.room_kinds, (WALL, BUILDING))
    return RoomFlags(
        lattice=lattice,
        levels=levels,
        is_at_scene_end=is_at_scene_end,
        wall_shapes=scene.structure.only(is_wall_geom),
        has_ground=len(scene.structure.planes.geom) > 0,
        steps=floors.steps,
        marked_rooms=mark_rooms(scene, columns, floors.levels, settings, agent),
    )


def _find_scene_ends(scene: Scene, lattice: Lattice) -> Bool:
    """Mark the sides of the lattice at which the scene ends.

    There, the scene's box exceeds the lattice by at most half a cell.

    Returns:
        A mask of the sides, [[upper, lower], [left, right]]; all False without a box.
    """
    if scene.bounds is None:
        return ~ALL_SIDES
    x_min, y_min, x_max, y_max = lattice.bounds
    (scene_x_min, scene_y_min), (scene_x_max, scene_y_max) = scene.bounds[:, :2]
    scene_excess = np.array(
        [[scene_y_max - y_max, y_min - scene_y_min], [x_min - scene_x_min, scene_x_max - x_max]]
    )
    is_scene_end: Bool = scene_excess <= MAX_SCENE_EXCESS * lattice.cell_size
    return is_scene_end


def mark_edge(is_empty: Bool, is_outer_side: Bool) -> Bool:
    """Mark the cells at the outer boundary of a scene.

    Args:
        is_empty: the empty cells, shape (height, width).
        is_outer_side: a mask of the sides of the lattice beyond which there is nothing, [[upper,
            lower], [left, right]].

    Returns:
        A mask of the cells that are not empty, and are at such a side or next to empty cells that
        are connected to such a side, shape (height, width).
    """
    height, width = is_empty.shape
    runs = find_row_runs(is_empty)
    component_of_run, num_cells = label_runs(runs)
    (is_upper_outer, is_lower_outer), (is_left_outer, is_right_outer) = is_outer_side.tolist()
    is_run_outer = (runs.row == 0) & is_upper_outer
    is_run_outer |= (runs.row == height - 1) & is_lower_outer
    is_run_outer |= (runs.first_col == 0) & is_left_outer
    is_run_outer |= (runs.end_col == width) & is_right_outer
    is_component_outer = np.zeros(len(num_cells), dtype=np.bool_)
    is_component_outer[component_of_run[is_run_outer]] = True
    # with a border of one cell, for what lies beyond the sides
    is_outside = np.zeros((height + 2, width + 2), dtype=np.bool_)
    is_outside[[0, -1]] = is_outer_side[0][:, None]
    is_outside[:, [0, -1]] = is_outer_side[1]
    is_outside[1:-1, 1:-1] = runs.paint(is_component_outer[component_of_run], is_empty.shape)
    is_edge: Bool = is_outside[:-2, 1:-1] | is_outside[2:, 1:-1]
    is_edge |= is_outside[1:-1, :-2]
    is_edge |= is_outside[1:-1, 2:]
    is_edge &= ~is_outside[1:-1, 1:-1]
    return is_edge


# ---------------------------------------------------------------- rooms that are marked


def mark_rooms(
    scene: Scene,
    columns: ColumnSource,
    levels: Sequence[LevelFloor],
    settings: RoomSettings,
    agent: AgentSettings,
) -> dict[str, MarkedRooms]:
    """Find the rooms that geoms, sites and polygons mark in a scene.

    Args:
        scene: the scene, whose geoms and sites may mark rooms.
        columns: hits of structure on the vertical line through each cell's centre.
        levels: the floors of all levels.
        settings: `rooms`: its `sources` say which of geoms, sites and polygons mark rooms; patterns
            and polygons say which of them.
        agent: the agent that stands in the volumes of sites.

    Returns:
        Source (``geoms``, ``sites`` or ``polygons``) -> the rooms that it marks.
    """
    marked_rooms = {}
    if "geoms" in settings.sources:
        marked_rooms["geoms"] = _mark_by_geoms(scene, columns, levels, settings, agent)
    if "sites" in settings.sources:
        marked_rooms["sites"] = _mark_by_sites(scene, columns.lattice, levels, settings, agent)
    if "polygons" in settings.sources:
        marked_rooms["polygons"] = _mark_by_polygons(columns.lattice, levels, settings)
    return marked_rooms


def find_markers(model: mujoco.MjModel, settings: RoomSettings) -> tuple[list[int], list[int]]:
    """Find the geoms and sites whose names match the patterns of the settings' rooms.

    Args:
        model: MuJoCo's model of the scene.
        settings: `rooms`: its `sources` say whether geoms and sites mark rooms, its patterns say
            which.

    Returns:
        Ids of geoms, and ids of sites, ascending.
    """
    geom_ids = list[int]()
    if "geoms" in settings.sources:
        geom_ids, _ = _match_names(
            all_names(model).stated_geom_names, tuple(settings.geoms), "geoms"
        )
    site_ids = list[int]()
    if "sites" in settings.sources:
        site_ids, _ = _match_names(all_names(model).sites, tuple(settings.sites), "sites")
    return geom_ids, site_ids


def _mark_by_geoms(
    scene: Scene,
    columns: ColumnSource,
    levels: Sequence[LevelFloor],
    settings: RoomSettings,
    agent: AgentSettings,
) -> MarkedRooms:
    """Give each cell the room of the geom that is its floor, if the geom's name matches a pattern.

    The geom's surface lies between 5 cm below the cell's floor (it may be under a rug) and 5 mm
    above it; of several such geoms, the highest counts. Furniture may have a matching name, too. So
    a geom only marks a room if at least half of its upper side is floor, or lies up to a step below
    a floor (of a carpet or a podium, see `MarkedRooms.covered_labels`).
    """
    lattice = columns.lattice
    num_geoms = scene.model.ngeom
    names = all_names(scene.model).stated_geom_names
    matching_geoms, warnings = _match_names(names, tuple(settings.geoms), "geoms")
    is_on_structure = scene.is_structure_body[scene.model.geom_bodyid]  # movables mark no rooms
    marking_geoms = [geom for geom in matching_geoms if is_on_structure[geom]]
    if not marking_geoms:
        return MarkedRooms([], [], warnings)
    room_of_geom = np.zeros(num_geoms + 1, dtype=np.int32)  # the last entry is for no geom
    room_of_geom[marking_geoms] = np.arange(1, len(marking_geoms) + 1)
    surfaces = _find_upward_surfaces(scene, columns, set(marking_geoms))
    min_height_above_floor = -agent.traversable_floor_height - SAME_HEIGHT
    max_height_above_floor = MAX_MARKER_HEIGHT + SAME_HEIGHT
    # The heights of surfaces above each level's floor; NaN, which compares as False, without one
    heights_above_floors = [surfaces.z - level.floor.ravel()[surfaces.cell] for level in levels]
    is_at_floor = np.any(
        [
            (height_above_floor >= min_height_above_floor)
            & (height_above_floor <= max_height_above_floor)
            for height_above_floor in heights_above_floors
        ],
        axis=0,
    )
    num_surfaces = np.bincount(surfaces.geom, minlength=num_geoms)
    num_at_floor = np.bincount(surfaces.geom[is_at_floor], minlength=num_geoms)
    is_floor_geom = num_at_floor >= MIN_FLOOR_SHARE * num_surfaces
    num_cells = lattice.height * lattice.width
    labels = list[Int32]()
    covered_labels = list[Int32]()
    for height_above_floor in heights_above_floors:
        is_floor_surface = is_floor_geom[surfaces.geom] & (
            height_above_floor <= max_height_above_floor
        )
        is_marked = is_floor_surface & (height_above_floor >= -MAX_MARKER_DEPTH - SAME_HEIGHT)
        is_covered = is_floor_surface & (height_above_floor >= min_height_above_floor)
        highest_geom = _find_highest_geom(surfaces, is_marked, num_cells, num_geoms)
        label = room_of_geom[highest_geom].reshape(lattice.shape)
        covered_label = label
        if not np.array_equal(is_covered, is_marked):
            highest_geom = _find_highest_geom(surfaces, is_covered, num_cells, num_geoms)
            covered_label = room_of_geom[highest_geom].reshape(lattice.shape)
        labels.append(label)
        covered_labels.append(covered_label)
    room_names = [_remove_prefix(names[geom]) for geom in marking_geoms]
    return MarkedRooms(room_names, labels, warnings, covered_labels)


def _remove_prefix(name: str) -> str:
    """Return a geom's name without a prefix of `FLOOR_PREFIXES`, unless it is only the prefix."""
    for prefix in FLOOR_PREFIXES:
        if name.startswith(prefix) and name != prefix:
            return name[len(prefix) :]
    return name


def _mark_by_sites(
    scene: Scene,
    lattice: Lattice,
    levels: Sequence[LevelFloor],
    settings: RoomSettings,
    agent: AgentSettings,
) -> MarkedRooms:
    """Give each cell the room of the first site in whose volume an agent would stand there.

    Only sites count whose names match a pattern of the settings.

    A site that contains less than `rooms.min_area` of floor, on all levels together, is no room.
    """
    names = all_names(scene.model).sites
    matching_sites, warnings = _match_names(names, tuple(settings.sites), "sites")
    if not matching_sites:
        return MarkedRooms([], [], warnings)
    labels = [np.zeros(lattice.shape, dtype=np.int32) for _ in levels]
    room_names = list[str | None]()
    small_sites = list[str]()
    for site in matching_sites:
        if not scene.is_structure_body[scene.model.site_bodyid[site]]:
            continue
        standing_masks = _mark_standing_in_site(site, scene, lattice, levels, agent)
        num_cells = sum(int(mask.sum()) for mask in standing_masks)
        if num_cells * lattice.cell_size**2 < settings.min_area:
            small_sites.append(names[site])
            continue
        room_names.append(names[site])
        for label, is_standing_place in zip(labels, standing_masks, strict=True):
            label[is_standing_place & (label == 0)] = len(room_names)
    if small_sites:
        names_text = ", ".join(small_sites[:MAX_LISTED_SITES])
        ellipsis = ", …" if len(small_sites) > MAX_LISTED_SITES else ""
        warnings = [
            *warnings,
            f"sites that hold less than {settings.min_area:g} m² of floor (`rooms.min_area`) are "
            f"no rooms: {names_text}{ellipsis}; make each site as large as its room, or draw the "
            "room in `rooms.polygons`",
        ]
    return MarkedRooms(room_names, labels, warnings)


def _mark_standing_in_site(
    site: int, scene: Scene, lattice: Lattice, levels: Sequence[LevelFloor], agent: AgentSettings
) -> list[Bool]:
    """Mark the cells of each level on which an agent would stand in a site's volume.

    The vertical line through the cell's centre passes through the volume between two heights. Of
    this stretch, the part from 5 cm below the floor to the agent's head counts. It has to be at
    least half as long as the whole stretch, or half as long as the agent is high, whichever is
    less.
    """
    model = scene.model
    geom_type = model.site_type[[site]].astype(np.int32)  # sites have the types of geoms
    position = scene.data.site_xpos[[site]]
    rotation = scene.data.site_xmat[[site]]
    size = model.site_size[[site]]
    bounds = solid_bounds(geom_type, position, rotation, size)
    solid = Solids(np.zeros(1, dtype=np.int32), geom_type, position, rotation, size, bounds)
    standing_masks = [np.zeros(lattice.shape, dtype=np.bool_) for _ in levels]
    window = lattice.window(solid.bounds.reshape(2, 3))
    if window is None:
        return standing_masks
    no_shapes = scene.shapes.only(np.zeros(model.ngeom, dtype=np.bool_))
    window_lattice = lattice.cut(*window)
    site_hits = cast_columns(tile_shapes(replace(no_shapes, solids=solid), window_lattice, 0.0))
    site_bottom = np.full(window_lattice.shape, np.nan)
    site_top = np.full(window_lattice.shape, np.nan)
    is_hit = np.diff(site_hits.start).reshape(window_lattice.shape) > 1
    site_bottom[is_hit] = site_hits.z[site_hits.start[:-1][is_hit.ravel()]]
    site_top[is_hit] = site_hits.z[site_hits.start[1:][is_hit.ravel()] - 1]
    for standing_mask, level in zip(standing_masks, levels, strict=True):
        floor = level.floor[window]
        standing_length = np.minimum(site_top, floor + agent.height) - np.maximum(
            site_bottom, floor - MAX_SITE_GAP
        )
        min_standing_length = MIN_STANDING_SHARE * np.minimum(site_top - site_bottom, agent.height)
        standing_mask[window] = standing_length >= min_standing_length - SAME_HEIGHT
    return standing_masks


def _mark_by_polygons(
    lattice: Lattice, levels: Sequence[LevelFloor], settings: RoomSettings
) -> MarkedRooms:
    """Give each cell the room whose polygon contains the cell's centre; of several, the first.

    Raises:
        ConfigError: the level of a polygon doesn't exist.
    """
    polygons = settings.polygons
    if not polygons:
        return MarkedRooms([], [])
    labels = [np.zeros(lattice.shape, dtype=np.int32) for _ in levels]
    warnings = []
    for polygon_number, polygon in enumerate(polygons):
        description = f"room {repr(polygon.name) if polygon.name else f'[{polygon_number}]'}"
        matching_levels = [k for k, level in enumerate(levels) if polygon.level in (k, level.name)]
        if not matching_levels:
            level_list_text = ", ".join(f"{k} ({level.name})" for k, level in enumerate(levels))
            raise ConfigError(
                f"no level {polygon.level!r} for {description} of `rooms.polygons`: there are "
                f"{level_list_text}"
            )
        level = levels[matching_levels[0]]
        label = labels[matching_levels[0]]
        is_in_polygon = cover_cells([polygon.points, *polygon.rings], lattice)
        has_floor = ~np.isnan(level.floor)
        if not (is_in_polygon & has_floor).any():
            rows, cols = np.nonzero(has_floor)
            x = lattice.center_x()[cols]
            y = lattice.center_y()[rows]
            warnings.append(
                f"{description} of `rooms.polygons` has no floor on {level.name}, whose floor "
                f"spans x {x.min():.2f} to {x.max():.2f}, y {y.min():.2f} to {y.max():.2f} m"
            )
        label[is_in_polygon & (label == 0)] = polygon_number + 1
    outdoor_rooms = {
        polygon_number for polygon_number, polygon in enumerate(polygons, 1) if polygon.outdoors
    }
    return MarkedRooms(
        [polygon.name for polygon in polygons], labels, warnings, outdoor_rooms=outdoor_rooms
    )


class _Surfaces(NamedTuple):
    """Points where the vertical lines of cells meet surfaces of geoms, as arrays of shape (n,).

    Attributes:
        cell: the id of the cell.
        z: z of the surface on the cell's line [m].
        geom: the geom's id.
    """

    cell: Int
    z: Float
    geom: Int32


def _find_upward_surfaces(scene: Scene, columns: ColumnSource, geoms: set[int]) -> _Surfaces:
    """Find where the vertical lines of cells meet surfaces of geoms that face up.

    Meshes count with their own triangles here, also those that the bake replaces by their convex
    hull, and those that it leaves out.

    Args:
        scene: the scene of the geoms.
        columns: hits of structure on the vertical line through each cell's centre.
        geoms: ids of the geoms whose surfaces are found.
    """
    num_geoms = len(scene.geoms)
    geoms_in_columns = {geom for geom in geoms if scene.geoms[geom].shape not in ("", "hull")}
    column_sources: list[tuple[ColumnSource, set[int]]] = [(columns, geoms_in_columns)]
    missing_geoms = geoms - geoms_in_columns
    if missing_geoms:
        selections = [
            GeomSelection(geom in missing_geoms, "marks a room", "surface")
            for geom in range(num_geoms)
        ]
        shapes, *_ = collect_shapes(scene.model, scene.data, selections, scene.exact_meshes)
        mesh_columns = cast_columns(tile_shapes(shapes, columns.lattice, 0.0))
        column_sources.append((mesh_columns, missing_geoms))
    cells = list[Int]()
    heights = list[Float]()
    geom_ids = list[Int32]()
    for source, source_geoms in column_sources:
        is_marking = np.isin(np.arange(num_geoms), list(source_geoms))
        for chunk in source.row_chunks() if source_geoms else ():
            first_cell, end_cell = chunk.valid_rows.cell_range(chunk.lattice)
            hit_indices = np.flatnonzero(is_marking[chunk.geom])
            hit_indices = hit_indices[chunk.normal[hit_indices, 2] > 0]
            num_before_cell = np.searchsorted(hit_indices, chunk.start[first_cell : end_cell + 1])
            cells.append(np.repeat(np.arange(first_cell, end_cell), np.diff(num_before_cell)))
            heights.append(chunk.z[hit_indices])
            geom_ids.append(chunk.geom[hit_indices])
    return _Surfaces(np.concatenate(cells), np.concatenate(heights), np.concatenate(geom_ids))


def _find_highest_geom(
    surfaces: _Surfaces, is_compared: Bool, num_cells: int, no_geom: int
) -> Int32:
    """Find the geom whose surface is the highest in each cell; of equally high ones, the lowest id.

    Args:
        surfaces: n surfaces.
        is_compared: which of the surfaces are compared, (n,).
        num_cells: the number of cells.
        no_geom: the id to return for cells without a surface.

    Returns:
        The geom of each cell, shape (num_cells,).
    """
    cells = surfaces.cell
    highest_z = np.full(num_cells, -np.inf)
    np.maximum.at(highest_z, cells[is_compared], surfaces.z[is_compared])
    is_highest = is_compared & (surfaces.z >= highest_z[cells] - SAME_HEIGHT)
    lowest_geom_id = np.full(num_cells, no_geom, dtype=np.int32)
    np.minimum.at(lowest_geom_id, cells[is_highest], surfaces.geom[is_highest])
    return lowest_geom_id


@lru_cache(maxsize=8)  # every update calls it with the same arguments
def _match_names(
    names: tuple[str, ...], patterns: tuple[str, ...], setting: str
) -> tuple[list[int], list[str]]:
    """Return the ids of the names that match a pattern, and warnings of patterns without a match.

    Args:
        names: names, in the order of ids.
        patterns: patterns with ``*``, ``?`` and ``[…]``.
        setting: the key in `rooms`, ``geoms`` or ``sites``, of the setting that has the patterns.
            Its default patterns may match nothing without a warning.
    """
    matching_ids = set[int]()
    warnings = list[str]()
    for pattern in patterns:
        matches_pattern = re.compile(translate(pattern)).match
        ids_of_pattern = [k for k, name in enumerate(names) if name and matches_pattern(name)]
        matching_ids.update(ids_of_pattern)
        if not ids_of_pattern and pattern not in DEFAULT_PATTERNS[setting]:
            warnings.append(warn_unmatched(f"rooms.{setting}", pattern, names))
    return sorted(matching_ids), warnings
