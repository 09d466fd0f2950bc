"""Paints the areas of the settings on the floors: keep-out, slow and expensive zones."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import cast_columns, tile_shapes
from navbake.baker.core.tolerances import LIMIT_SLACK, TOUCH_DEPTH
from navbake.baker.core.windows import Window
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.geometry.extents import measure_extents
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy import check_occupancy
from navbake.baker.rooms.rooms import Rooms
from navbake.baker.scene.collect import GeomSelection, collect_shapes
from navbake.baker.scene.names import all_names, warn_unmatched
from navbake.baker.scene.scene import Scene
from navbake.config.links import AreaSettings
from navbake.config.settings import BakeConfig
from navbake.errors import ConfigError
from navbake.known_names import suggest
from navbake.navgrid.lattice import Lattice, cover_cells, touch_cells
from navbake.navgrid.links import Area
from navbake.types import Bool, Json

# A geom also marks floors up to this far above it, such as that of a rug on the geom [m]
MAX_FLOOR_ABOVE_GEOM = 0.05


class PaintedAreas(NamedTuple):
    """The areas of the settings on the whole lattice.

    Attributes:
        layers: for each level, the number of each cell's area, counted from 1; 0 for none; (height,
            width), uint8.
        table: the areas as they are written to a file.
        warnings: warnings about the areas, one line each.
    """

    layers: list[NDArray[np.uint8]]
    table: list[Json]
    warnings: list[str]


class MarkedArea(NamedTuple):
    """The cells of an area, also those without a floor.

    Attributes:
        masks: for each level, a mask of the area's cells, (height, width), bool.
        width: the width of the area where it is narrowest [m], NaN if unknown.
        warnings: warnings about the area, one line each.
    """

    masks: list[Bool]
    width: float
    warnings: list[str]


def paint_areas(
    scene: Scene, lattice: Lattice, levels: Sequence[LevelFloor], rooms: Rooms, config: BakeConfig
) -> PaintedAreas:
    """Paint the areas of the settings in their order; a later area overwrites an earlier one.

    A keep-out area (no agent may enter it) takes each cell with a floor whose interior it overlaps.
    All other areas take the cells with a floor whose centres lie in them.

    Args:
        scene: the scene, whose geoms may mark areas.
        lattice: the whole lattice.
        levels: the floors of each level.
        rooms: the rooms; an area may be defined as a room.
        config: all settings; the areas and the agent's height are read.

    Returns:
        The painted layers, the table of areas, and warnings.

    Raises:
        ConfigError: an area's level doesn't exist.
    """
    layers = [np.zeros(lattice.shape, dtype=np.uint8) for _ in levels]
    table = list[Json]()
    warnings = list[str]()
    for area_number, area in enumerate(config.areas, 1):
        if area.room is not None:
            marked_area = _mark_room(area, rooms)
        elif area.geoms:
            marked_area = _mark_geoms(area, scene, lattice, levels, config.agent.height)
        elif area.box is not None:
            marked_area = _mark_box(area, area.box, lattice, levels)
        else:
            marked_area = _mark_polygon(area, lattice, levels)
        num_cells = 0
        for layer, level, is_in_area in zip(layers, levels, marked_area.masks, strict=True):
            is_in_area &= ~np.isnan(level.floor)
            layer[is_in_area] = area_number
            num_cells += int(np.count_nonzero(is_in_area))
        warnings += marked_area.warnings
        if not num_cells and not marked_area.warnings:
            warnings.append(f"area {area.name!r} covers no cell with a floor")
        elif num_cells and marked_area.width < lattice.cell_size * (1 - LIMIT_SLACK):
            warnings.append(_warn_narrow(area, marked_area.width, lattice.cell_size))
        agents = None if area.agents is None else tuple(area.agents)
        table.append(Area(area.name, float(area.cost), area.speed, agents).to_json())
    return PaintedAreas(layers, table, warnings)


def _warn_narrow(area: AreaSettings, width: float, cell_size: float) -> str:
    """Return the warning that an area, `width` metres wide, is narrower than a cell."""
    consequence = "it takes cells by their centres, so it has gaps"
    if area.keeps_out:
        consequence = "it takes each cell that it touches, so it is wider in the grid"
    return (
        f"area {area.name!r} is only {width:.3g} m wide, thinner than a cell of {cell_size:g} m: "
        f"{consequence}"
    )


def _mark_room(area: AreaSettings, rooms: Rooms) -> MarkedArea:
    """Mark the cells of all rooms whose id or name the area states."""
    masks = [np.zeros_like(layer, dtype=np.bool_) for layer in rooms.index]
    area_rooms = [room for room in rooms.table if area.room in (room.id, room.name)]
    for room in area_rooms:
        masks[room.level] |= rooms.index[room.level] == room.index
    warnings = []
    if not area_rooms:
        room_names = [room.name or room.id for room in rooms.table]
        hint = suggest(area.room, room_names)
        warnings.append(f"no room {area.room!r} for area {area.name!r}: {hint}")
    return MarkedArea(masks, np.nan, warnings)


def _mark_box(
    area: AreaSettings,
    box: Sequence[Sequence[float]],
    lattice: Lattice,
    levels: Sequence[LevelFloor],
) -> MarkedArea:
    """Mark the cells on all levels whose floor lies in a box.

    Args:
        area: the area's settings.
        box: the lower and the upper corner, [[x, y, z], [x, y, z]] [m].
        lattice: the whole lattice.
        levels: the floors of each level.
    """
    (x_min, y_min, z_min), (x_max, y_max, z_max) = box
    outline = [[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]]
    is_in_outline = _mark_outlines(area, [outline], lattice)
    masks = []
    for level in levels:
        is_at_box_height = z_min - LIMIT_SLACK <= level.floor
        is_at_box_height &= level.floor <= z_max + LIMIT_SLACK
        masks.append(is_in_outline & is_at_box_height)
    return MarkedArea(masks, min(x_max - x_min, y_max - y_min), [])


def _mark_polygon(area: AreaSettings, lattice: Lattice, levels: Sequence[LevelFloor]) -> MarkedArea:
    """Mark the cells of the area's polygon on the level that the area states.

    Raises:
        ConfigError: the level doesn't exist.
    """
    level_numbers = [
        level_number
        for level_number, level in enumerate(levels)
        if area.level in (level_number, level.name)
    ]
    if not level_numbers:
        level_names = ", ".join(
            f"{level_number} ({level.name})" for level_number, level in enumerate(levels)
        )
        raise ConfigError(
            f"no level {area.level!r} for area {area.name!r}: there are {level_names}"
        )
    masks = [np.zeros(lattice.shape, np.bool_) for _ in levels]
    outline = area.polygon or []
    masks[level_numbers[0]] = _mark_outlines(area, [outline, *area.rings], lattice)
    # the polygon is as wide as its extent in the direction that is normal to one of its sides
    corners = np.array(outline)
    side_vectors = np.roll(corners, -1, axis=0) - corners
    side_lengths = np.hypot(*side_vectors.T)
    normals = (
        np.stack([-side_vectors[:, 1], side_vectors[:, 0]])[:, side_lengths > 0]
        / side_lengths[side_lengths > 0]
    )
    width = float(np.ptp(corners @ normals, axis=0).min())
    return MarkedArea(masks, width, [])


def _mark_outlines(
    area: AreaSettings, outlines: Sequence[Sequence[Sequence[float]]], lattice: Lattice
) -> Bool:
    """Mark the cells that belong to an area that is drawn as a polygon.

    All cells that the polygon overlaps belong to a keep-out area; only cells whose centres lie in
    the polygon belong to other areas.

    Args:
        area: the area's settings.
        outlines: the polygon's outline, then its holes and further parts, as corners [x, y] [m].
        lattice: the whole lattice.
    """
    mark_polygon_cells = touch_cells if area.keeps_out else cover_cells
    return mark_polygon_cells(outlines, lattice)


def _mark_geoms(
    area: AreaSettings,
    scene: Scene,
    lattice: Lattice,
    levels: Sequence[LevelFloor],
    agent_height: float,
) -> MarkedArea:
    """Mark the cells where the area's geoms are over the floor, up to the agent's height.

    Geoms up to `MAX_FLOOR_ABOVE_GEOM` below the floor count, too, and so do geoms that the bake
    leaves out.
    """
    names = [geom.geom for geom in all_names(scene.model).geoms]
    masks = [np.zeros(lattice.shape, np.bool_) for _ in levels]
    warnings = list[str]()
    is_area_geom = np.zeros(len(names), dtype=np.bool_)
    for pattern in area.geoms:
        is_match = [fnmatchcase(name, pattern) for name in names]
        is_area_geom |= is_match
        if not any(is_match):
            pattern_warning = warn_unmatched("geoms", pattern, names)
            warnings.append(f"of area {area.name!r}, {pattern_warning}")
    if not is_area_geom.any():
        return MarkedArea(masks, np.nan, warnings)
    geoms = np.flatnonzero(is_area_geom).tolist()
    shapes = _collect_geoms(scene, geoms)
    window: Window | None = np.s_[0 : lattice.height], np.s_[0 : lattice.width]
    is_endless = len(shapes.planes.geom) > 0 or shapes.is_endless.any()
    if not is_endless:
        window = None if shapes.bounds is None else lattice.window(shapes.bounds)
    if window is None:
        return MarkedArea(masks, np.nan, warnings)
    tiled_shapes = tile_shapes(shapes, lattice.cut(*window), lattice.cell_size)
    columns = cast_columns(tiled_shapes)
    # surfaces that enclose nothing are tested against squares that are wider by 2 * TOUCH_DEPTH
    area_footprint = Footprint(
        half_square=lattice.cell_size / 2 - 3 * TOUCH_DEPTH,
        radius=0.0,
        low=-MAX_FLOOR_ABOVE_GEOM,
        high=agent_height - TOUCH_DEPTH,
    )
    for level_mask, level in zip(masks, levels, strict=True):
        window_floor_heights = level.floor[window].ravel()
        cells = np.flatnonzero(~np.isnan(window_floor_heights))
        floor_heights = window_floor_heights[cells]
        is_in_area = np.zeros(len(cells), dtype=np.bool_)
        if area.keeps_out:
            is_in_area = check_occupancy(
                columns, tiled_shapes, area_footprint, cells, floor_heights
            ).occupied
        else:
            find_blocked_lines(
                cells,
                floor_heights - MAX_FLOOR_ABOVE_GEOM,
                floor_heights + agent_height,
                columns.hits,
                is_in_area,
                0,
                len(cells),
            )
        window_mask = np.zeros(len(window_floor_heights), dtype=np.bool_)
        window_mask[cells[is_in_area]] = True
        level_mask[window] = window_mask.reshape(level_mask[window].shape)
    geom_widths = measure_extents(shapes, len(names)).short_side[geoms]
    return MarkedArea(masks, float(np.nanmin(geom_widths, initial=np.inf)), warnings)


def _collect_geoms(scene: Scene, geoms: Sequence[int]) -> Shapes:
    """Collect the geometry of some geoms, whether or not they count in the bake."""
    selections = {}
    for geom in geoms:
        selection = scene.selections[geom]
        mesh_mode = selection.mesh_mode if selection.is_counted else "surface"
        selections[geom] = GeomSelection(
            is_counted=True, reason="marks an area", mesh_mode=mesh_mode
        )
    shapes, *_ = collect_shapes(scene.model, scene.data, selections, scene.exact_meshes, geoms)
    return shapes
