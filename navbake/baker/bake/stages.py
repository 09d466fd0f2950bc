"""The stages of a bake: each is a named value that a user can stop at and inspect.

    scene ─ roles ─┬─ structure ─ columns ─ floors ─ walls ─ rooms ─┐
                   ├─ movables ──────────────── occupants ──────────┼─ grid
                   └─ leaves ───────────────── doors ───────────────┘

A bake loads the scene and gives each geom a role. Structure makes columns, floors, walls and rooms.
Leaves are classified as doors or not once the rooms are known. Movables, and leaves that are no
doors, only block cells. All that follows from structure and from closed leaves is a
`BakedStructure`; all that depends on the pose is a `BakedPose`. `build_grid` in ``pipeline.py``
makes the grid from these two.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from navbake.baker.bake.arguments import parse_arguments
from navbake.baker.bake.baked import BakedPose, BakedStructure, FloorLattice
from navbake.baker.bake.boxes import find_level_boxes
from navbake.baker.bake.lattice import box_rounding, extend_lattice, fit_lattice
from navbake.baker.bake.level_crops import crop_layers, crop_steps, make_grid_door, rooms_to_json
from navbake.baker.bake.memory import warn_of_memory
from navbake.baker.bake.scene_floors import find_scene_floors, measure_holes
from navbake.baker.bake.uncounted import warn_uncounted
from navbake.baker.bake.warnings import warn_of_structure
from navbake.baker.columns.column_sources import (
    ColumnCaster,
    WindowColumns,
    join_columns,
    make_shape_source,
)
from navbake.baker.columns.columns import Columns, ColumnSource, ShapeSource
from navbake.baker.core.clock import Progress, StageClock
from navbake.baker.doors.doors import (
    ClassifiedLeaf,
    DoorInputs,
    classify_leaves,
    mark_obstacle_geoms,
    select_doors,
)
from navbake.baker.doors.posed_leaves import LeafCells, find_blocked_cells, pose_leaves
from navbake.baker.floors.levels import Floors
from navbake.baker.geometry.extents import Extents, measure_extents
from navbake.baker.links.areas import PaintedAreas, paint_areas
from navbake.baker.links.links import BakedLinks, bake_links
from navbake.baker.links.search import CollisionGeometry, CollisionShapes
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy import StructureOccupancy
from navbake.baker.occupants.cell_names import measure_names
from navbake.baker.occupants.kinds import mark_wall_candidates
from navbake.baker.occupants.lost_floors import find_lost_floors
from navbake.baker.occupants.movable import (
    MovableOccupants,
    MovableSearchInputs,
    find_movable_occupants,
)
from navbake.baker.occupants.standing import (
    OccupantGeoms,
    StandingCells,
    StandingOccupants,
    classify_occupants,
    find_standing_cells,
)
from navbake.baker.rooms.flags import RoomFlags, gather_flags
from navbake.baker.rooms.rooms import Rooms, find_rooms
from navbake.baker.scene.model import CompileLimits, SceneInput, SceneModel
from navbake.baker.scene.scene import Scene, load_scene, load_scene_file
from navbake.compiled import ensure_compiled
from navbake.config.keywords import SettingKeywords
from navbake.config.settings import BakeConfig, select_settings_to_store, settings_digest
from navbake.mujoco_types import MjDataLike
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_beside
from navbake.types import Bool, Float

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    from typing_extensions import Unpack


def bake_stages(
    scene: SceneInput,
    data: MjDataLike | None = None,
    /,
    *,
    progress: Progress | None = None,
    **settings: Unpack[SettingKeywords],
) -> Stages:
    """Load a scene, and return the stages of its bake.

    A stage is computed when its attribute is first read. So a user can inspect the columns of a
    scene in which no floor can be found.

    Args:
        scene: a path, settings, or a scene in memory, see `navbake.bake`.
        data: the pose of a model in memory, see `navbake.bake`.
        progress: called with a stage's name and 0 when the stage begins, 1 when it ends.
        settings: sections of settings by name, see `navbake.bake`.

    Returns:
        The stages; so far, only the scene is loaded.

    Raises:
        ConfigError: a setting is wrong.
        SceneError: the scene cannot be read, or has nothing to bake.

    Example:
        >>> stages = bake_stages(navbake.samples.path("apartment"))
        >>> stages.columns.z[: stages.columns.start[1]]  # heights of all hits in cell 0 [m]
    """
    config, scene_model = parse_arguments(scene, data, settings)
    return open_stages(config, StageClock(progress), scene_model=scene_model)


def open_stages(
    config: BakeConfig,
    clock: StageClock,
    limits: CompileLimits | None = None,
    scene_model: SceneModel | None = None,
) -> Stages:
    """Load a scene, fit a lattice to it, and return the stages of its bake.

    Args:
        config: all settings.
        clock: measures how long each stage takes.
        limits: limits for MuJoCo's compiler, which then runs in a child process.
        scene_model: the compiled model; None to load the file that `config` names.

    Returns:
        The stages; so far, only the scene is loaded.

    Raises:
        ConfigError: the lattice would have too many cells, or would be endless.
        SceneError: the scene cannot be read, or has nothing to bake.
    """
    with clock.add_to_stage("scene"):
        # before the kernels are compiled, which may take minutes: a file may be wrong
        if scene_model is None:
            scene_model = load_scene_file(config, limits)
    ensure_compiled()
    with clock.stage("scene"):
        scene = load_scene(config, scene_model=scene_model)
        lattice = fit_lattice(scene, config)
    stages = Stages(config, scene, lattice, clock)
    warn_of_memory(scene.structure, stages.extended_lattice.lattice, stages.shape_margin)
    return stages


@dataclass(eq=False)
class Stages:
    """The values of all stages of a bake.

    Each stage is an attribute. It is computed when it is first read, after the stages that it
    depends on, and is kept.

    Attributes:
        config: all settings.
        scene: the posed scene.
        lattice: the cells that are baked.
        clock: measures how long each stage takes.
    """

    config: BakeConfig
    scene: Scene
    lattice: Lattice
    clock: StageClock = field(default_factory=StageClock, repr=False)

    # ------------------------------------------------------------ columns

    @cached_property
    def footprint(self) -> Footprint:
        """The volume over a cell's floor that has to be free for an agent."""
        return Footprint.for_agent(self.config.agent, self.lattice.cell_size)

    @cached_property
    def extended_lattice(self) -> FloorLattice:
        """The lattice of the whole scene, on which floors are found, and its window to bake."""
        return find_floor_lattice(self.lattice, self.scene, self.config)

    @cached_property
    def shape_source(self) -> ShapeSource:
        """The structure's shapes, listed by the tiles of the lattice that they lie over."""
        return self._index_structure(self.lattice)

    @cached_property
    def floor_shape_source(self) -> ShapeSource:
        """The structure's shapes, listed by the tiles of the extended lattice."""
        lattice = self.extended_lattice.lattice
        return self.shape_source if lattice == self.lattice else self._index_structure(lattice)

    @cached_property
    def floor_columns(self) -> ColumnSource:
        """The columns of the extended lattice, in which floors are found.

        They are read in chunks of rows. In a large lattice, the chunks are not kept: each reading
        intersects the lines with the geometry again. `column_chunks` and `columns` have the hits on
        the baked lattice.
        """
        return ColumnCaster(
            self.floor_shape_source, self.config.agent, self.config.floors.crack, self.clock
        )

    @cached_property
    def columns(self) -> Columns:
        """The hits of structure on the vertical line through each baked cell's centre.

        All are in memory, for users to inspect. If the line goes through a crack in a floor, the
        floor beside the crack is also a hit.
        """
        return join_columns(self.floor_columns, self.extended_lattice.window, self.lattice)

    @property
    def column_chunks(self) -> ColumnSource:
        """The hits of `columns`, in chunks of rows, so that they need not all be in memory.

        All stages after the floors read these. They come from `floor_columns`, cropped to the
        lattice.
        """
        columns = self.floor_columns
        if columns.lattice == self.lattice:
            return columns
        return WindowColumns(columns, self.extended_lattice.window, self.lattice)

    # ------------------------------------------------------------ floors

    @cached_property
    def _floors_and_extents(self) -> tuple[Floors, Extents | None]:
        """The floors, and the boxes of the structure's geoms, which another thread measures."""
        columns = self.floor_columns
        wait_for_extents = None
        if self.config.names.enabled or self.config.rooms.sources:
            # Casting took all threads and expanded the triangles; finding floors leaves one free.
            wait_for_extents = run_beside(
                measure_extents, self.scene.structure, len(self.scene.geoms)
            )
        with self.clock.stage("floors"):
            floors = find_scene_floors(
                columns,
                self.floor_shape_source,
                scene=self.scene,
                lattice=self.lattice,
                floor_lattice=self.extended_lattice,
                config=self.config,
            )
            extents = None if wait_for_extents is None else wait_for_extents()
        return floors, extents

    @property
    def floors(self) -> Floors:
        """The levels, with their floors, cropped to the lattice; and the steps between levels."""
        return self._floors_and_extents[0]

    @property
    def extents(self) -> Extents | None:
        """Upright boxes around the structure's geoms; None if neither names nor rooms need them."""
        return self._floors_and_extents[1]

    @cached_property
    def hole_areas(self) -> Float:
        """The area of each hole in the lowest floor of an open mesh [m²], shape (n,).

        Holes that the bake closes are included.
        """
        if not self.scene.has_open_mesh or self.extended_lattice.lattice != self.lattice:
            return np.empty(0)
        return measure_holes(
            self.floors.levels[0],
            columns=self.floor_columns,
            shape_source=self.floor_shape_source,
            config=self.config,
        )

    # ------------------------------------------------------------ occupancy of structure

    @cached_property
    def standing_cells(self) -> StandingCells:
        """The structure in each cell, and the flags of each cell's column that rooms depend on."""
        floors = self.floors
        columns = self.column_chunks
        with self.clock.stage("occupancy"):
            occupant_geoms = None
            if self.extents is not None:
                is_wall_candidate = mark_wall_candidates(self.scene, self.extents)
                occupant_geoms = OccupantGeoms(self.extents, is_wall_candidate)
            return find_standing_cells(
                columns,
                self.shape_source,
                floors=floors,
                footprint=self.footprint,
                agent=self.config.agent,
                occupant_geoms=occupant_geoms,
                clock=self.clock,
            )

    @property
    def occupancy(self) -> StructureOccupancy:
        """The cells of each level that structure occupies; `occupants` adds what can move."""
        return self.standing_cells.occupancy

    @cached_property
    def standing_occupants(self) -> StandingOccupants | None:
        """The structure in each cell, classified; None where neither names nor rooms need it.

        In the timings, this stage is called ``contents``.
        """
        standing_cells = self.standing_cells
        with self.clock.stage("contents"):
            if self.extents is None:
                return None
            return classify_occupants(
                self.scene,
                standing_cells.occupants,
                floors=self.floors,
                extents=self.extents,
                agent=self.config.agent,
                settings=self.config.names,
            )

    # ------------------------------------------------------------ rooms and doors

    @cached_property
    def room_flags(self) -> RoomFlags:
        """The flags of each cell: whether it is open, a hole, under the sky, and so on.

        Rooms are found by these flags, by settings, and by closed leaves.
        """
        standing_cells = self.standing_cells
        standing_occupants = self.standing_occupants
        with self.clock.stage("rooms"):
            columns = self.column_chunks
            room_flags = gather_flags(
                self.scene,
                columns,
                floors=self.floors,
                column_flags=standing_cells.column_flags,
                standing_occupants=standing_occupants,
                occupied_masks=standing_cells.occupancy.blocked_squares
                or standing_cells.occupancy.levels,
                settings=self.config.rooms,
                agent=self.config.agent,
            )
            columns.release_memory()
            return room_flags

    @cached_property
    def leaf_cells(self) -> list[LeafCells]:
        """For each leaf, the cells that its own geometry blocks in each state."""
        levels = self.floors.levels
        with self.clock.add_to_stage("doors"):
            leaves = pose_leaves(
                self.scene, self.scene.leaves, self.lattice, self.footprint.half_width
            )
            return find_blocked_cells(leaves, levels, self.footprint, self.lattice)

    @cached_property
    def rooms(self) -> Rooms:
        """The room of each cell, and the table of rooms, in which doors are not listed yet."""
        room_flags = self.room_flags
        leaf_cells = self.leaf_cells
        with self.clock.stage("rooms"):
            return find_rooms(
                room_flags,
                self.config.rooms,
                max_step=self.config.agent.traversable_floor_height,
                closed_leaves=[cells.closed_leaf for cells in leaf_cells],
            )

    @property
    def door_inputs(self) -> DoorInputs:
        """The columns, floors and rooms on which the classification of leaves depends."""
        return DoorInputs(
            columns=self.column_chunks,
            floors=self.floors.levels,
            rooms=self.rooms,
            agent=self.config.agent,
        )

    @cached_property
    def doors(self) -> list[ClassifiedLeaf]:
        """All leaves, also those that are no doors.

        Each has the mark `is_door`, the rooms that it connects, and the cells that it blocks in
        each state.
        """
        inputs = self.door_inputs
        leaf_cells = self.leaf_cells
        with self.clock.stage("doors"):
            return classify_leaves(leaf_cells, inputs)

    # ------------------------------------------------------------ occupants that can move

    @cached_property
    def is_obstacle_geom(self) -> Bool:
        """For each geom, whether it is of a movable, or of a leaf that is no door, (ngeom,)."""
        return mark_obstacle_geoms(self.scene, self.doors, self.config)

    @cached_property
    def occupants(self) -> MovableOccupants:
        """Movables, and leaves that are no doors, in each cell; and all occupied cells.

        The cells that only doors block are not among the occupied cells: the grid adds them,
        depending on each door's state.
        """
        is_obstacle_geom = self.is_obstacle_geom
        movable_inputs = self.movable_inputs
        with self.clock.stage("occupants"):
            return find_movable_occupants(movable_inputs, self.scene.shapes, is_obstacle_geom)

    @property
    def movable_inputs(self) -> MovableSearchInputs:
        """The inputs of the search for movables: floors, and the cells that structure occupies."""
        return MovableSearchInputs(
            lattice=self.lattice,
            floors=self.floors,
            structure_occupancy=self.occupancy,
            footprint=self.footprint,
            agent=self.config.agent,
            mover_of_geom=self.scene.mover_of_geom,
        )

    # ------------------------------------------------------------ areas and links

    @cached_property
    def areas(self) -> PaintedAreas:
        """The areas of the settings, painted on the levels."""
        if not self.config.areas:
            return PaintedAreas([], [], [])
        rooms = self.rooms
        with self.clock.stage("areas"):
            return paint_areas(self.scene, self.lattice, self.floors.levels, rooms, self.config)

    @cached_property
    def links(self) -> BakedLinks:
        """The named links: those that the settings list, and those that rules find."""
        if not self.config.links:
            return BakedLinks([], [])
        baked_structure = self.baked_structure
        leaves = self.doors
        is_obstacle_geom = self.is_obstacle_geom
        occupants = self.occupants
        with self.clock.stage("links"):
            return bake_links(
                self.scene,
                baked_structure.lattice,
                floors=baked_structure.floors,
                geometry=baked_structure.link_geometry,
                leaves=leaves,
                is_obstacle_geom=is_obstacle_geom,
                occupied=occupants.blocked,
                config=self.config,
            )

    # ------------------------------------------------------------ what the grid is made of

    @cached_property
    def baked_structure(self) -> BakedStructure:
        """All that follows from structure and closed leaves; `Baker` reuses it in updates."""
        link_geometry = None
        if self.config.links:
            link_geometry = CollisionGeometry(
                [CollisionShapes(self.column_chunks, self.shape_source)], self.footprint
            )
        boxes = find_level_boxes(
            self.floors.levels,
            self.occupancy.levels,
            lattice=self.lattice,
            scene_box=self.scene.bounds,
            agent_height=self.config.agent.height,
        )
        return BakedStructure(
            lattice=self.lattice,
            floors=self.floors,
            layers=crop_layers(self.floors.levels, self.rooms, boxes.windows),
            named_occupants=self.standing_occupants if self.config.names.enabled else None,
            rooms=self.rooms,
            boxes=boxes,
            link_geometry=link_geometry,
            settings_metadata={
                "settingsDigest": settings_digest(self.config),
                "settings": select_settings_to_store(self.config),
            },
            steps=crop_steps(self.floors.steps, boxes, self.lattice.width),
            warnings=warn_of_structure(
                self.config,
                self.scene,
                floor_lattice=self.extended_lattice,
                floors=self.floors,
                occupancy=self.occupancy,
                standing_occupants=self.standing_occupants,
                rooms=self.rooms,
                boxes=boxes,
                hole_areas=self.hole_areas,
            ),
        )

    @cached_property
    def baked_pose(self) -> BakedPose:
        """All that depends on the scene's pose; `Baker` recomputes it in updates."""
        baked_structure = self.baked_structure
        occupants = self.occupants
        doors = select_doors(self.doors)
        name_boxes: dict[str, list[float]] = {}
        if baked_structure.named_occupants is not None:
            names = baked_structure.named_occupants.names
            name_boxes = measure_names(self.scene.shapes, np.arange(len(names)), names)
        return BakedPose(
            scene=self.scene,
            leaves=self.doors,
            is_obstacle_geom=self.is_obstacle_geom,
            occupants=occupants,
            lost_floor_areas=find_lost_floors(
                self.scene.shapes,
                self.is_obstacle_geom,
                mover_of_geom=self.scene.mover_of_geom,
                levels=self.floors.levels,
                lattice=self.lattice,
                agent=self.config.agent,
            ),
            grid_doors=[
                make_grid_door(door, baked_structure, occupants, self.config) for door in doors
            ],
            room_table=rooms_to_json(self.rooms, doors),
            areas=self.areas,
            links=self.links,
            name_boxes=name_boxes,
            uncounted_warnings=warn_uncounted(self.scene, self.movable_inputs),
        )

    @property
    def shape_margin(self) -> float:
        """The distance within which a shape is listed for a tile of cells [m]."""
        return max(self.footprint.half_width, self.config.floors.crack)

    def _index_structure(self, lattice: Lattice) -> ShapeSource:
        """List the structure's geometry by tiles of a lattice."""
        return make_shape_source(self.scene.structure, lattice, self.shape_margin)


def find_floor_lattice(lattice: Lattice, scene: Scene, config: BakeConfig) -> FloorLattice:
    """Extend a lattice to the whole scene, so that floors do not depend on which part is baked.

    Args:
        lattice: the cells that are baked.
        scene: the posed scene.
        config: all settings; `grid.max_cells` limits the extended lattice.

    Returns:
        The extended lattice, and its window that is baked.
    """
    rounding = 0.0
    if scene.bounds is not None:
        rounding = box_rounding(scene, scene.bounds[:, :2].ravel(), lattice.cell_size)
    extended_lattice, window = extend_lattice(
        lattice, scene.bounds, config.grid.max_cells, rounding
    )
    return FloorLattice(extended_lattice, window)
