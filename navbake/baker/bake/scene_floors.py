"""Finds the floors of a whole scene, and measures the holes in the floor of a mesh."""

from __future__ import annotations

import numpy as np

from navbake.baker.bake.baked import FloorLattice
from navbake.baker.columns.column_sources import split_cells
from navbake.baker.columns.columns import ColumnSource, ShapeSource
from navbake.baker.core.arrays import HeightRange
from navbake.baker.core.components import label_components_2d
from navbake.baker.floors.levels import Floors, LevelFloor, crop_floors, fill_holes, find_floors
from navbake.baker.floors.outline import OccupancyTest
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy import check_occupancy
from navbake.baker.scene.scene import Scene
from navbake.config.settings import MAX_SCAN_HOLE_AREA, BakeConfig, is_memory_path
from navbake.errors import SceneError
from navbake.formats.scene_files import MESH_SUFFIXES, scene_suffix
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int

NO_FLOOR_PREFIX = "no floor: "  # how errors of scenes without a floor begin
# The `grid.margin` that an error advises where things stand on endless ground [m]
GROUND_MARGIN = 5.0
# A scene narrower than this is no building that lacks its ground, and no ground is advised [m]
MIN_GROUND_SIDE = 1.0


def find_scene_floors(
    columns: ColumnSource,
    shape_source: ShapeSource,
    scene: Scene,
    lattice: Lattice,
    floor_lattice: FloorLattice,
    config: BakeConfig,
) -> Floors:
    """Find the floors of the whole scene, and crop them to the lattice that is baked.

    Args:
        columns: the hits of structure on the vertical line through each cell's centre, on the
            extended lattice.
        shape_source: the structure's geometry, by tiles of the extended lattice.
        scene: the posed scene.
        lattice: the cells that are baked.
        floor_lattice: the extended lattice, that of the whole scene, and its window that is baked.
        config: all settings.

    Returns:
        The levels with their floors, cells counted on `lattice`.

    Raises:
        SceneError: there is no floor; the text says where the scene lies.
    """
    try:
        floors = find_floors(
            columns,
            scene.structure,
            agent=config.agent,
            settings=config.floors,
            level_settings=None if config.levels == "auto" else list(config.levels),
            is_occupied=make_occupancy_test(columns, shape_source, config),
        )
        if floor_lattice.lattice != lattice:
            floors = crop_floors(floors, floor_lattice.window)
    except SceneError as error:
        text = str(error)
        # a wrong unit or axis is the first thing to mend
        advice = "; ".join(scene.hints) or _advise_ground(scene, config)
        if advice and text.startswith(NO_FLOOR_PREFIX):
            text = f"{NO_FLOOR_PREFIX}{advice}; {text.removeprefix(NO_FLOOR_PREFIX)}"
        raise SceneError(f"{config.scene.path}: {text}{_describe_extent(scene, config)}") from error
    return floors


def make_occupancy_test(
    columns: ColumnSource, shape_source: ShapeSource, config: BakeConfig
) -> OccupancyTest:
    """Return a function that tests cells for occupancy with an agent of radius 0.

    The radius is 0 so that a region of floor ends at a wall, not an agent's radius before it.

    Args:
        columns: the vertical columns of the structure.
        shape_source: the structure's geometry, by tiles of the same lattice.
        config: all settings.

    Returns:
        A function that takes cell ids, the heights of their floors [m], and a range of heights
        over the floors [m], or None for the agent's own. It returns a mask of the cell ids whose
        cells are occupied.
    """
    point_agent = config.agent.model_copy(update={"radius": 0.0})
    footprint = Footprint.for_agent(point_agent, columns.lattice.cell_size)

    def is_occupied(
        cells: Int, floor_heights: Float, height_range: HeightRange | None = None, /
    ) -> Bool:
        volume = footprint if height_range is None else footprint.with_heights(height_range)
        is_cell_occupied = np.zeros(len(cells), dtype=np.bool_)
        for chunk_indices in split_cells(shape_source, cells):
            chunk_cells = cells[chunk_indices]
            is_cell_occupied[chunk_indices] = check_occupancy(
                columns.columns_at(chunk_cells),
                shape_source.shapes_near_cells(chunk_cells),
                volume,
                chunk_cells,
                floor_heights[chunk_indices],
            ).occupied
        return is_cell_occupied

    return is_occupied


def measure_holes(
    level: LevelFloor, columns: ColumnSource, shape_source: ShapeSource, config: BakeConfig
) -> Float:
    """Measure the holes in a level's floor that `floors.fill` closes, or would close.

    Such a hole is surrounded by floor, and no larger than the holes that a scan usually has.

    Args:
        level: the level; its holes may have been closed already, they are measured nevertheless.
        columns: the vertical columns of the structure.
        shape_source: the structure's geometry, by tiles of the same lattice.
        config: all settings.

    Returns:
        The area of each hole, (n,) [m²].
    """
    cell_area = columns.lattice.cell_size**2
    if level.unseen is None:
        is_occupied = make_occupancy_test(columns, shape_source, config)
        level = fill_holes(level, MAX_SCAN_HOLE_AREA / cell_area, is_occupied)
    _, num_cells_of_hole = label_components_2d(np.asarray(level.unseen))
    hole_areas: Float = num_cells_of_hole[1:].astype(np.float64) * cell_area
    return hole_areas


def _advise_ground(scene: Scene, config: BakeConfig) -> str:
    """Return advice for a scene without floor: to add ground, or to bake more of its ground.

    The advice is empty where neither is likely to help: for meshes without an endless plane, as
    their axes or units are wrong more often; with `grid.bounds`; and for scenes that are too small.
    For a scene in memory, it is a keyword of `navbake.bake`.
    """
    is_in_memory = is_memory_path(config.scene.path)
    endless_geoms = scene.shapes.planes.geom
    if len(endless_geoms):
        name = scene.geoms[endless_geoms[0]].name
        setting_text = f"grid.margin={GROUND_MARGIN:g}"
        if is_in_memory:
            setting_text = f'grid={{"margin": {GROUND_MARGIN:g}}}'
        return f"if agents walk on {name!r}, which is endless, `{setting_text}` takes in more of it"
    is_mesh = scene_suffix(config.scene.path) in MESH_SUFFIXES
    is_mesh |= is_in_memory and bool(scene.exact_meshes)
    if is_mesh or scene.bounds is None or config.grid.bounds is not None:
        return ""
    lowest_corner, highest_corner = scene.bounds
    if (highest_corner - lowest_corner)[:2].min() < MIN_GROUND_SIDE:
        return ""
    if is_in_memory:
        setting_text = f'`scene={{"ground": {lowest_corner[2]:.6g}}}` adds it to an MjSpec'
        return f"if the scene comes without its ground, {setting_text}"
    return f"if the scene comes without its ground, `scene.ground={lowest_corner[2]:.6g}` adds it"


def _describe_extent(scene: Scene, config: BakeConfig) -> str:
    """Describe where a scene without floor lies: its axes, unit or bounds are often wrong."""
    if scene.bounds is None:
        return ""
    hint_text = ""
    if scene.exact_meshes and not scene.hints:
        up = config.scene.up
        unit = config.scene.unit
        hint_text = (
            f"check which way is up (`scene.up` is {up}) and the unit (`scene.unit` is {unit:g})"
        )
    sides = zip("xyz", *scene.bounds.tolist(), strict=True)
    span_text = ", ".join(f"{axis} {low:.6g} to {high:.6g}" for axis, low, high in sides)
    endless_geoms = scene.shapes.planes.geom
    if len(endless_geoms):
        span_text += f" without {scene.geoms[endless_geoms[0]].name!r}"
    return f"; the scene spans, in m, {span_text}{'; ' if hint_text else ''}{hint_text}"
