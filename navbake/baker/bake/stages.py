"""The stages of a bake, each a named value that one can stop at and look at.

    scene ─ divide ─┬─ structure ─ columns ─ floors ─ walls ─ rooms ─┐
                    ├─ movables ──────────────── occupants ──────────┼─ grid
                    └─ leaves ───────────────── doors ───────────────┘

What stands alone makes floors, walls and rooms; leaves are doors or not once rooms are known; what
can move, and leaves that are no doors, are only ever in the way. `build_grid` makes a grid of the
`Standing` and the `Moving` that come of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from navbake.baker.bake.arguments import parse_arguments
from navbake.baker.bake.baked import (
    BakedPose,
    BakedStructure,
    FloorLattice,
    GridDoor,
    StructureLayers,
)
from navbake.baker.bake.boxes import LevelBoxes, find_level_boxes
from navbake.baker.bake.lattice import extend_lattice, fit_lattice
from navbake.baker.bake.warnings import warn_of_structure
from navbake.baker.columns.column_sources import (
    ColumnCaster,
    WindowColumns,
    join_columns,
    make_shape_source,
)
from navbake.baker.columns.columns import Columns, ColumnSource, ShapeSource
from navbake.baker.core.arrays import HeightRange
from navbake.baker.core.clock import Progress, StageClock
from navbake.baker.core.components import label_components_2d
from navbake.baker.core.windows import Window, crop_cells
from navbake.baker.doors.doors import (
    ClassifiedLeaf,
    DoorContext,
    classify_leaves,
    find_door_cells,
    is_stuck,
    make_door,
    select_doors,
)
from navbake.baker.doors.posed_leaves import LeafCells, find_blocked_cells, pose_leaves
from navbake.baker.floors.levels import Floors, LevelFloor, crop_floors, fill_holes, find_floors
from navbake.baker.floors.outline import OccupancyTest
from navbake.baker.geometry.extents import Extents, measure_extents
from navbake.baker.links.areas import PaintedAreas, paint_areas
from navbake.baker.links.links import BakedLinks, find_links
from navbake.baker.links.search import CollisionGeometry, CollisionShapes, LinkSearch
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy import Occupancy, check_occupancy
from navbake.baker.occupants.kinds import mark_wall_candidates
from navbake.baker.occupants.lost_floors import find_lost_floors
from navbake.baker.occupants.movable import MovableContext, MovableOccupants, find_movable_occupants
from navbake.baker.occupants.standing import (
    StandingCells,
    StandingOccupants,
    classify_occupants,
    find_standing_cells,
)
from navbake.baker.rooms.flags import RoomFlags, gather_flags
from navbake.baker.rooms.rooms import Rooms, find_rooms
from navbake.baker.scene.leaves import mark_candidate_geoms
from navbake.baker.scene.model import CompileLimits, SceneModel
from navbake.baker.scene.roles import MOVABLE
from navbake.baker.scene.scene import Scene, load_scene
from navbake.compiled import ensure_compiled
from navbake.config.keywords import SettingKeywords
from navbake.config.settings import (
    SCAN_HOLES,
    BakeConfig,
    settings_digest,
    settings_to_state,
)
from navbake.errors import SceneError
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import Door
from navbake.threads import run_beside
from navbake.types import Bool, Float, Int, Json

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    from typing_extensions import Unpack


def bake_stages(
    scene: Any,
    data: Any = None,
    /,
    *,
    progress: Progress | None = None,
    **settings: Unpack[SettingKeywords],
) -> Stages:
    """Load a scene, and give the stages of its bake.

    A stage runs when it is first asked for, so that one can look at the columns of a scene
    whose floors cannot be found. For the arguments, see `navbake.bake`, for `progress`,
    `baker.clock`.
    """
    config, opened = parse_arguments(scene, data, settings)
    return open_stages(config, StageClock(progress), opened=opened)


def open_stages(
    config: BakeConfig,
    clock: StageClock,
    limits: CompileLimits | None = None,
    opened: SceneModel | None = None,
) -> Stages:
    """Load a scene, if it isn't `opened`, and give the stages of its bake."""
    ensure_compiled()
    with clock.stage("scene"):
        scene = load_scene(config, limits=limits, opened=opened)
        lattice = fit_lattice(scene, config)
    return Stages(config, scene, lattice, clock)


@dataclass(eq=False)
class Stages:
    """What each stage of a bake finds.

    A stage runs when it is first asked for, after those that it builds on, and its value is kept.
    """

    config: BakeConfig
    scene: Scene
    lattice: Lattice
    clock: StageClock = field(default_factory=StageClock, repr=False)

    @cached_property
    def footprint(self) -> Footprint:
        """The volume over a cell's floor that has to be free."""
        return Footprint.of(self.config.agent, self.lattice.cell_size)

    @cached_property
    def extended_lattice(self) -> FloorLattice:
        """The lattice on which floors are judged, and the window of it that is baked."""
        return find_floor_lattice(self.lattice, self.scene, self.config)

    @cached_property
    def tile_index(self) -> ShapeSource:
        """What stands, by tiles of the lattice."""
        return self._list_structure(self.lattice)

    @cached_property
    def floor_tile_index(self) -> ShapeSource:
        """What stands, by tiles of the lattice on which floors are extended."""
        lattice = self.extended_lattice.lattice
        return self.tile_index if lattice == self.lattice else self._list_structure(lattice)

    @cached_property
    def floor_columns(self) -> ColumnSource:
        """All surfaces of what stands on that lattice; not all are kept where they are many."""
        return ColumnCaster(
            self.floor_tile_index, self.config.agent, self.config.floors.crack, self.clock
        )

    @cached_property
    def columns(self) -> Columns:
        """All surfaces of what stands on the line through each cell's centre, or beside a crack."""
        return join_columns(self.floor_columns, self.extended_lattice.window, self.lattice)

    @property
    def column_blocks(self) -> ColumnSource:
        """The same columns, of which not all are kept where they are many."""
        columns = self.floor_columns
        if columns.lattice == self.lattice:
            return columns
        return WindowColumns(columns, self.extended_lattice.window, self.lattice)

    @cached_property
    def _floors_and_extents(self) -> tuple[Floors, Extents | None]:
        columns = self.floor_columns
        extents: Callable[[], Extents | None] = lambda: None  # noqa: E731
        if self.config.names.enabled or self.config.rooms.sources:
            # columns took all threads, and expanded the triangles that are measured
            extents = run_beside(measure_extents, self.scene.structure, len(self.scene.geoms))
        with self.clock.stage("floors"):
            floors = find_scene_floors(
                columns,
                self.floor_tile_index,
                scene=self.scene,
                lattice=self.lattice,
                extended=self.extended_lattice,
                config=self.config,
            )
            return floors, extents()

    @property
    def floors(self) -> Floors:
        """The storeys of the whole scene, cut to the lattice: their floors, the steps between."""
        return self._floors_and_extents[0]

    @property
    def extents(self) -> Extents | None:
        """Boxes round the geoms that stand; None where neither names nor rooms need them."""
        return self._floors_and_extents[1]

    @cached_property
    def standing_cells(self) -> StandingCells:
        """What stands in the cells, and what rooms read of their columns, seen in one pass."""
        floors = self.floors
        columns = self.column_blocks
        with self.clock.stage("occupancy"):
            wall_candidates = None
            if self.extents is not None:
                wall_candidates = mark_wall_candidates(self.scene, self.extents)
            return find_standing_cells(
                columns,
                self.tile_index,
                floors=floors,
                footprint=self.footprint,
                agent=self.config.agent,
                wall_candidates=wall_candidates,
                clock=self.clock,
            )

    @property
    def occupancy(self) -> Occupancy:
        """The cells of each storey that what stands occupies."""
        return self.standing_cells.occupancy

    @cached_property
    def standing_occupants(self) -> StandingOccupants | None:
        """What stands in the cells; None where neither names nor rooms need it."""
        cells = self.standing_cells
        with self.clock.stage("contents"):
            if self.extents is None:
                return None
            return classify_occupants(
                self.scene,
                cells.occupants,
                floors=self.floors,
                extents=self.extents,
                agent=self.config.agent,
                settings=self.config.names,
            )

    @property
    def contents(self) -> StandingOccupants | None:
        """`standing_occupants` by the name that its stage has in timings."""
        return self.standing_occupants

    @cached_property
    def room_flags(self) -> RoomFlags:
        """All that rooms depend on beside settings and leaves."""
        cells = self.standing_cells
        standing_occupants = self.standing_occupants
        with self.clock.stage("rooms"):
            return gather_flags(
                self.scene,
                self.column_blocks,
                floors=self.floors,
                column_flags=cells.column_flags,
                standing_occupants=standing_occupants,
                occupied=cells.occupancy.blocked_squares or cells.occupancy.levels,
                settings=self.config.rooms,
                agent=self.config.agent,
            )

    @cached_property
    def leaf_cells(self) -> list[LeafCells]:
        """What each leaf blocks in each state, whatever else stands there."""
        levels = self.floors.levels
        with self.clock.part("doors"):
            leaves = pose_leaves(self.scene, self.scene.leaves, self.lattice, self.footprint.reach)
            return find_blocked_cells(leaves, levels, self.footprint, self.lattice)

    @cached_property
    def rooms(self) -> Rooms:
        """The room of each cell, and the table of rooms; doors are not named in it yet."""
        flags = self.room_flags
        leaf_cells = self.leaf_cells
        with self.clock.stage("rooms"):
            return find_rooms(
                flags,
                self.config.rooms,
                max_step=self.config.agent.traversable_floor_height,
                closed_leaves=[cells.closed for cells in leaf_cells],
            )

    @property
    def door_context(self) -> DoorContext:
        """What leaves are placed in."""
        return DoorContext(
            columns=self.column_blocks,
            floors=self.floors.levels,
            rooms=self.rooms,
            agent=self.config.agent,
        )

    @cached_property
    def doors(self) -> list[ClassifiedLeaf]:
        """What each leaf is, and what it blocks in each state."""
        context = self.door_context
        leaf_cells = self.leaf_cells
        with self.clock.stage("doors"):
            return classify_leaves(leaf_cells, context)

    @cached_property
    def in_the_way(self) -> Bool:
        """By geom id, whether it is only ever in the way."""
        return mark_in_the_way(self.scene, self.doors, self.config)

    @cached_property
    def occupants(self) -> MovableOccupants:
        """What can move, and leaves that are no doors; and what anything but doors occupies."""
        in_the_way = self.in_the_way
        movable_context = self.movable_context
        with self.clock.stage("occupants"):
            return find_movable_occupants(movable_context, self.scene.shapes, in_the_way)

    @property
    def movable_context(self) -> MovableContext:
        """Over which floors one looks for what can move."""
        return MovableContext(
            lattice=self.lattice,
            floors=self.floors,
            standing=self.occupancy,
            footprint=self.footprint,
            agent=self.config.agent,
            mover_of=self.scene.mover_of,
        )

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
        """The named links, those of the settings and those that are found."""
        if not self.config.links:
            return BakedLinks([], [])
        standing = self.baked_structure
        doors = self.doors
        in_the_way = self.in_the_way
        occupants = self.occupants
        with self.clock.stage("links"):
            return make_links(
                self.scene,
                standing,
                doors=doors,
                in_the_way=in_the_way,
                occupied=occupants.blocked,
                config=self.config,
            )

    @cached_property
    def holes(self) -> Float:
        """Areas of the holes in the lowest floor of an open mesh, closed or not, (n,) [m²].

        Those that `floors.fill` closes, or would close: floor surrounds them.
        """
        # a file of one mesh is few geoms
        shapes = [report.shape for report in self.scene.geoms] if self.scene.exact_meshes else []
        is_open = any(shape.startswith(("surface", "partly closed")) for shape in shapes)
        if not is_open or self.extended_lattice.lattice != self.lattice:
            return np.empty(0)
        cell_area = self.lattice.cell_size**2
        level = self.floors.levels[0]
        if level.unseen is None:
            is_occupied = make_occupancy_test(
                self.floor_columns, self.floor_tile_index, self.config
            )
            level = fill_holes(level, SCAN_HOLES / cell_area, is_occupied)
        part, _ = label_components_2d(np.asarray(level.unseen))
        areas: Float = np.bincount(part.ravel())[1:].astype(np.float64) * cell_area
        return areas

    @cached_property
    def baked_structure(self) -> BakedStructure:
        """What follows from what stands, for the grid and its updates."""
        link_geometry = None
        if self.config.links:
            link_geometry = CollisionGeometry(
                [CollisionShapes(self.column_blocks, self.tile_index)], self.footprint
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
            layers=_cut_layers(self.floors.levels, self.rooms, boxes.windows),
            occupants=self.standing_occupants,
            rooms=self.rooms,
            boxes=boxes,
            link_geometry=link_geometry,
            settings_metadata={
                "settingsDigest": settings_digest(self.config),
                "settings": settings_to_state(self.config),
            },
            steps=_cut_steps(self.floors.links, boxes, self.lattice.width),
            warnings=warn_of_structure(
                self.config,
                self.scene,
                extended=self.extended_lattice,
                floors=self.floors,
                occupancy=self.occupancy,
                standing_occupants=self.standing_occupants,
                rooms=self.rooms,
                boxes=boxes,
                holes=self.holes,
            ),
        )

    @cached_property
    def baked_pose(self) -> BakedPose:
        """What follows from the pose, too, for the grid and its updates."""
        standing = self.baked_structure
        occupants = self.occupants
        placed_doors = select_doors(self.doors)
        return BakedPose(
            scene=self.scene,
            doors=self.doors,
            in_the_way=self.in_the_way,
            occupants=occupants,
            lost_floors=find_lost_floors(
                self.scene.shapes,
                self.in_the_way,
                mover_of=self.scene.mover_of,
                levels=self.floors.levels,
                lattice=self.lattice,
                agent=self.config.agent,
            ),
            grid_doors=[
                make_grid_door(placed, standing, occupants, self.config) for placed in placed_doors
            ],
            room_table=rooms_to_json(self.rooms, placed_doors),
            areas=self.areas,
            links=self.links,
        )

    def _list_structure(self, lattice: Lattice) -> ShapeSource:
        reach = max(self.footprint.reach, self.config.floors.crack)
        return make_shape_source(self.scene.structure, lattice, reach)


def find_floor_lattice(lattice: Lattice, scene: Scene, config: BakeConfig) -> FloorLattice:
    """The lattice on which floors are judged: the whole scene's, around the one that is baked."""
    return FloorLattice(*extend_lattice(lattice, scene.bounds, config.grid.max_cells))


def find_scene_floors(
    columns: ColumnSource,
    tiles: ShapeSource,
    scene: Scene,
    lattice: Lattice,
    extended: FloorLattice,
    config: BakeConfig,
) -> Floors:
    """Find the floors of the whole scene, and cut them to the lattice that is baked.

    Args:
        columns, tiles: what stands, on the lattice on which floors are extended.
    """
    try:
        floors = find_floors(
            columns,
            scene.structure,
            agent=config.agent,
            settings=config.floors,
            level_settings=None if config.levels == "auto" else list(config.levels),
            is_occupied=make_occupancy_test(columns, tiles, config),
        )
        if extended.lattice != lattice:
            floors = crop_floors(floors, extended.window)
    except SceneError as error:
        raise SceneError(
            f"{config.scene.path}: {error}{_describe_extent(scene, config)}"
        ) from error
    return floors


def make_occupancy_test(
    columns: ColumnSource, tiles: ShapeSource, config: BakeConfig
) -> OccupancyTest:
    """Tells which cells are occupied by what is as narrow as a point, and ends a region."""
    point = config.agent.model_copy(update={"radius": 0.0})
    narrow = Footprint.of(point, columns.lattice.cell_size)

    def is_occupied(cells: Int, floors: Float, band: HeightRange | None = None, /) -> Bool:
        volume = narrow if band is None else narrow.between(band)
        return check_occupancy(
            columns.covering(cells), tiles.near_cells(cells), volume, cells, floors
        ).occupied

    return is_occupied


def mark_in_the_way(scene: Scene, doors: Sequence[ClassifiedLeaf], config: BakeConfig) -> Bool:
    """Mark the geoms that are only ever in the way: movables, and leaves that are no doors.

    With `exclude.movable`, such leaves that can move are left out, too.
    """
    rejected = [placed.candidate for placed in doors if not placed.is_door]
    is_rejected = mark_candidate_geoms(len(scene.roles), rejected)
    if config.scene.exclude.movable:
        is_rejected &= scene.is_structure_body[scene.model.geom_bodyid]
    in_the_way: Bool = is_rejected | (scene.roles == MOVABLE)
    return in_the_way


def make_grid_door(
    placed: ClassifiedLeaf,
    standing: BakedStructure,
    occupants: MovableOccupants,
    config: BakeConfig,
) -> GridDoor:
    """A door as the grid has it: its cells that nothing else occupies, by level."""
    cells = find_door_cells(placed, occupants.blocked, occupants.blocked_squares)
    door = make_door(
        placed,
        cells,
        windows=standing.boxes.windows,
        width=standing.lattice.width,
        wanted=config.doors.state,
    )
    return GridDoor(door, door_to_json(door), is_stuck(cells))


def door_to_json(door: Door) -> Json:
    """A door as the file states it; see `navbake.navgrid.rooms.parse_doors`."""
    rooms = list(door.rooms)
    entry: Json = {"id": door.id, "joint": door.joint, "rooms": rooms, "state": door.state}
    for name, by_state in (("cells", door.cells), ("solid", door.solid)):
        if by_state or name == "cells":
            entry[name] = {s: [[*runs] for runs in of.items()] for s, of in by_state.items()}
    return entry


def rooms_to_json(rooms: Rooms, doors: Sequence[ClassifiedLeaf]) -> list[Json]:
    """The table of rooms as a file states it, with the doors between them."""
    closed = {placed.candidate.id: (placed.rooms, placed.closed_cells) for placed in doors}
    return [room.to_json() for room in rooms.with_neighbours(closed).table]


def _cut_layers(
    levels: Sequence[LevelFloor], rooms: Rooms, windows: Sequence[Window]
) -> list[StructureLayers]:
    """The layers of each level on its own rectangle."""
    layers = []
    for level, room_index, window in zip(levels, rooms.index, windows, strict=True):
        unseen = None
        if level.unseen is not None:
            unseen = level.unseen[window].astype(np.uint8)
        layers.append(
            StructureLayers(
                floor=level.floor[window].astype(np.float32),
                room_index=np.ascontiguousarray(room_index[window]),
                unseen=unseen,
            )
        )
    return layers


def _cut_steps(links: Int, boxes: LevelBoxes, width: int) -> list[list[int]]:
    """The steps with cells counted on each level's own rectangle."""
    steps = links.copy()
    for number, window in enumerate(boxes.windows):
        for level, cell in ((0, 1), (2, 3)):
            here = steps[:, level] == number
            # a linked cell has a floor, so that none drops out
            steps[here, cell] = crop_cells(steps[here, cell], window, width)[0]
    rows: list[list[int]] = steps.tolist()
    return rows


def make_links(
    scene: Scene,
    standing: BakedStructure,
    doors: Sequence[ClassifiedLeaf],
    in_the_way: Bool,
    occupied: Sequence[Bool],
    config: BakeConfig,
) -> BakedLinks:
    """Find the named links: those of the settings, and those that their rules find.

    Args:
        in_the_way: see `mark_in_the_way`.
        occupied: the cells of each level that anything but doors occupies.
    """
    if standing.link_geometry is None:
        return BakedLinks([], [])
    floors = np.stack([level.floor for level in standing.floors.levels])
    free = ~(np.stack(occupied) | np.isnan(floors))
    for placed in select_doors(doors):  # as doors are, so are their links
        for cells in placed.blocked.values():
            for level, blocked in zip(free, cells, strict=True):
                level.ravel()[blocked] = False
    search = LinkSearch(
        scene=scene,
        shapes=scene.shapes.only(scene.is_structure | in_the_way),
        lattice=standing.lattice,
        floors=floors,
        free=free,
        geometry=standing.link_geometry.with_shapes(
            scene.shapes.only(in_the_way), standing.lattice
        ),
        agent=config.agent,
    )
    return find_links(search, config.links)


def _describe_extent(scene: Scene, config: BakeConfig) -> str:
    """What is added to an error: often the scene's axes, its unit or the bounds are wrong."""
    if scene.bounds is None:
        return ""
    hint = "; ".join(scene.hints)
    if scene.exact_meshes and not hint:
        up = config.scene.up
        unit = config.scene.unit
        hint = f"check which way is up (`scene.up` is {up}) and the unit (`scene.unit` is {unit:g})"
    sides = zip("xyz", *scene.bounds.tolist(), strict=True)
    spans = ", ".join(f"{axis} {low:.6g} to {high:.6g}" for axis, low, high in sides)
    endless = scene.shapes.planes.geom
    if len(endless):
        spans += f" without {scene.geoms[endless[0]].name!r}, which is endless"
        spans += ": `grid.margin` or `grid.bounds` shows more of it"
    return f"; the scene spans, in m, {spans}{'; ' if hint else ''}{hint}"
