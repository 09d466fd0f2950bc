"""The stages of a bake, each a named value that one can stop at and look at.

scene → columns → floors → occupancy → contents → rooms → doors → areas → links; `build_grid` makes
a grid of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.arguments import take_input
from navbake.baker.boxes import LevelBoxes, find_level_boxes
from navbake.baker.clock import Progress, StageClock
from navbake.baker.column_blocks import ColumnBlocks, WindowColumns, join_columns, list_shapes
from navbake.baker.columns import Columns, ColumnSource, ShapeSource
from navbake.baker.connect import label_parts
from navbake.baker.contents.contents import CellFinder, Contents
from navbake.baker.doors.candidates import DoorCandidate, find_candidates, without_doors
from navbake.baker.doors.doors import (
    DoorContext,
    LeafCells,
    PlacedLeaf,
    block_cells,
    cut_door,
    place_doors,
    pose_leaves,
)
from navbake.baker.floors.levels import FloorFinder, Floors, crop_floors, fill_holes, find_floors
from navbake.baker.floors.outline import OccupancyTest
from navbake.baker.kernels.arrays import Band
from navbake.baker.lattice import Window, lay_lattice, lay_whole
from navbake.baker.occupancy.occupancy import Footprint, Occupancy, look_at_cells
from navbake.baker.rooms.flags import ColumnFlags, RoomFlags, read_flags
from navbake.baker.rooms.rooms import Rooms, find_rooms
from navbake.baker.scene.extents import Extents, measure_geoms
from navbake.baker.scene.model import CompileLimits, OpenScene
from navbake.baker.scene.scene import Scene, load_scene
from navbake.baker.traffic.areas import PaintedAreas, paint_areas
from navbake.baker.traffic.ground import Ground, Space
from navbake.baker.traffic.links import BakedLinks, find_links
from navbake.compiled import ensure_compiled
from navbake.config.keywords import SettingKeywords
from navbake.config.settings import SCAN_HOLES, BakeConfig, settings_digest, settings_to_state
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
    whose floors cannot be found. All of them run at once where bodies look like doors, because
    only the rooms on both sides tell doors from other leaves; `doors.find: false` avoids that.
    For the arguments, see `navbake.bake`, for `progress`, `baker.clock`.
    """
    config, opened = take_input(scene, data, settings)
    stages = take_first_look(config, StageClock(progress), opened=opened)
    if all(candidate.named for candidate in stages.candidates):
        return stages
    return settle_doors(stages)


def take_first_look(
    config: BakeConfig,
    clock: StageClock,
    limits: CompileLimits | None = None,
    opened: OpenScene | None = None,
) -> Stages:
    """Load a scene, if it isn't `opened`; the stages that take every candidate for a door."""
    ensure_compiled()
    with clock.stage("scene"):
        scene = load_scene(config.scene, config.agent, config.floors, limits=limits, opened=opened)
        lattice = lay_lattice(scene, config)
        candidates, unmatched = find_candidates(scene, config.doors)
    return Stages(config, scene, lattice, candidates, unmatched, clock)


def settle_doors(stages: Stages) -> Stages:
    """Decide which candidates are doors, and give the stages of the scene without just these.

    A candidate that joins no two rooms, such as the leaf of a cupboard, is a part of the scene:
    it may carry a floor, occupy cells and be a wall. So all stages run again with it. That may
    change the rooms, and so whether another candidate joins two of them: each pass rejects one.
    """
    while stages.rejected:
        stages = replace(stages, candidates=stages.settled)
    return stages


@dataclass(eq=False)
class Stages:
    """What each stage of a bake finds, where some bodies are taken for doors.

    A stage runs when it is first asked for, after those that it builds on, and its value is kept.
    A value that is known already, as of a scene in which little moved, may be written instead.
    """

    config: BakeConfig
    scene: Scene  # doors included
    lattice: Lattice
    candidates: list[DoorCandidate]  # what all stages but that of doors do without
    unmatched: list[str] = field(default_factory=list)  # warnings of patterns that name no door
    clock: StageClock = field(default_factory=StageClock, repr=False)

    @cached_property
    def footprint(self) -> Footprint:
        """The volume over a cell's floor that has to be free."""
        return Footprint.of(self.config.agent, self.lattice.cell_size)

    @cached_property
    def doorless(self) -> Scene:
        """The scene without the candidates."""
        return without_doors(self.scene, self.candidates)

    @cached_property
    def tiled(self) -> ShapeSource:
        """The geometry of the scene without doors, listed by tiles of the lattice."""
        return self._tile(self.lattice)

    @cached_property
    def judged(self) -> tuple[Lattice, Window]:
        """The lattice on which floors are judged, and the window of it that is baked."""
        return lay_whole(self.lattice, self.scene.bounds, self.config.grid.max_cells)

    @cached_property
    def judged_shapes(self) -> ShapeSource:
        """The geometry without doors by tiles of the lattice on which floors are judged."""
        lattice, _ = self.judged
        return self.tiled if lattice == self.lattice else self._tile(lattice)

    @cached_property
    def judged_columns(self) -> ColumnSource:
        """All surfaces on that lattice, of which not all are kept where they are many."""
        config = self.config
        return ColumnBlocks(self.judged_shapes, config.agent, config.floors.crack, self.clock)

    @cached_property
    def columns(self) -> Columns:
        """All surfaces on the vertical line through each cell's centre, or beside a crack there."""
        return join_columns(self.judged_columns, self.judged[1], self.lattice)

    @property
    def baked_columns(self) -> ColumnSource:
        """The same columns, of which not all are kept where they are many."""
        columns, (_, window) = self.judged_columns, self.judged
        is_whole = columns.lattice == self.lattice
        return columns if is_whole else WindowColumns(columns, window, self.lattice)

    @cached_property
    def floors(self) -> Floors:
        """The storeys of the whole scene, cut to the lattice: their floors, the steps between."""
        # columns take all threads; most of what floors take then is one thread's
        _ = self.judged_columns, self._extents
        return self.judge_floors()[0]

    @cached_property
    def _extents(self) -> Callable[[], Extents | None]:
        """Boxes round the geoms, measured beside what is asked for next; none if nothing asks."""
        if not self.config.names.enabled and not self.config.rooms.sources:
            return lambda: None
        return run_beside(measure_geoms, self.doorless.shapes, len(self.doorless.geoms))

    def judge_floors(self, finder: FloorFinder | None = None) -> tuple[Floors, FloorFinder]:
        """Find `floors`, and what keeps those of the whole scene up to date.

        `finder` is the last one, in which columns may have been replaced; None if there is none.
        """
        config, columns, shapes = self.config, self.judged_columns, self.doorless.shapes
        given = None if config.levels == "auto" else list(config.levels)
        test = self.occupancy_test(columns)
        with self.clock.stage("floors"):
            try:
                if finder is not None:
                    floors = finder.find(columns, shapes, test)
                else:
                    asked = config.agent, config.floors, given, test
                    floors, finder = find_floors(columns, shapes, *asked)
                if columns.lattice != self.lattice:
                    floors = crop_floors(floors, self.judged[1])
            except SceneError as error:
                path = config.scene.path
                where = _describe_extent(self.doorless, config)
                raise SceneError(f"{path}: {error}{where}") from error
            return floors, finder

    def occupancy_test(self, columns: ColumnSource) -> OccupancyTest:
        """Tells which cells are occupied by what is as narrow as a point, and ends a sheet."""
        point = self.config.agent.model_copy(update={"radius": 0.0})
        narrow = Footprint.of(point, self.lattice.cell_size)

        def is_occupied(cells: Int, floors: Float, band: Band | None = None, /) -> Bool:
            volume = narrow if band is None else narrow.between(band)
            asked = columns.at(cells), self.judged_shapes.at(cells), volume, cells, floors
            return look_at_cells(*asked).occupied

        return is_occupied

    @cached_property
    def occupancy(self) -> Occupancy:
        """The cells of each storey that are occupied."""
        return self.cells[0].occupancy

    @cached_property
    def contents(self) -> Contents | None:
        """What stands in the cells; None where neither names nor rooms need it."""
        finder, _ = self.cells
        with self.clock.stage("contents"):
            return finder.found(self.config.names)

    @cached_property
    def room_flags(self) -> RoomFlags:
        """All that rooms depend on beside settings."""
        return read_flags(
            self.doorless,
            self.baked_columns,
            self.floors,
            of_columns=self.cells[1],
            contents=self.contents,
            occupied=self.occupancy.solid or self.occupancy.levels,
            settings=self.config.rooms,
            agent=self.config.agent,
        )

    @cached_property
    def rooms(self) -> Rooms:
        """The room of each cell, and the table of rooms; doors are not named in it yet."""
        _ = self.contents, self.leaf_cells  # which are timed by themselves
        max_step = self.config.agent.traversable_floor_height
        closed_leaves = [leaf.closed for leaf in self.leaf_cells]
        with self.clock.stage("rooms"):
            return find_rooms(self.room_flags, self.config.rooms, max_step, closed_leaves)

    @cached_property
    def cells(self) -> tuple[CellFinder, ColumnFlags]:
        """What finds occupancy and contents, and what rooms read of columns, seen in one pass."""
        floors, columns, agent = self.floors, self.baked_columns, self.config.agent
        with self.clock.stage("occupancy"):
            finder = CellFinder(self.doorless, self.lattice, floors, agent, self._extents())
            of_columns = ColumnFlags(floors, agent)
            for block in columns.blocks():
                finder.add(block, block.near or self.tiled.rows(block.known_rows))
                with self.clock.part("rooms"):
                    first, end = block.known_rows.cells(self.lattice)
                    crossings = block.crossings._replace(start=block.start[first : end + 1])
                    of_columns.look(slice(first, end), crossings, floors.levels)
            return finder, of_columns

    @property
    def door_context(self) -> DoorContext:
        """What doors stand in."""
        return DoorContext(self.baked_columns, self.floors.levels, self.rooms, self.config.agent)

    @cached_property
    def leaf_cells(self) -> list[LeafCells]:
        """What each candidate blocks in each state."""
        levels = self.floors.levels
        with self.clock.part("doors"):
            leaves = pose_leaves(self.scene, self.candidates, self.lattice, self.footprint.reach)
            return block_cells(leaves, levels, self.footprint, self.lattice)

    @cached_property
    def doors(self) -> list[PlacedLeaf]:
        """What each candidate is, and what it blocks in each state."""
        context = self.door_context
        with self.clock.stage("doors"):
            return place_doors(self.leaf_cells, context)

    @cached_property
    def cut_doors(self) -> dict[PlacedLeaf, Door]:
        """The doors as the grid has them."""
        return {one: self.cut_door(one) for one in self.placed}

    def cut_door(self, door: PlacedLeaf) -> Door:
        """A door as the grid has it."""
        return cut_door(
            door,
            occupied=self.occupancy.levels,
            solid=self.occupancy.solid,
            windows=self.boxes.windows,
            width=self.lattice.width,
            wanted=self.config.doors.state,
        )

    @cached_property
    def holes(self) -> Float:
        """Areas of the holes in the lowest floor of an open mesh, closed or not, (n,) [m²].

        Those that `floors.fill` closes, or would close: floor surrounds them.
        """
        # a file of one mesh is few geoms
        shapes = [report.shape for report in self.scene.geoms] if self.scene.parts else []
        is_open = any(shape.startswith(("surface", "partly closed")) for shape in shapes)
        if not is_open or self.judged[0] != self.lattice:
            return np.empty(0)
        level, cell_area = self.floors.levels[0], self.lattice.cell_size**2
        if level.unseen is None:
            is_occupied = self.occupancy_test(self.judged_columns)
            level = fill_holes(level, SCAN_HOLES / cell_area, is_occupied)
        part, _ = label_parts(np.asarray(level.unseen))
        areas: Float = np.bincount(part.ravel())[1:].astype(np.float64) * cell_area
        return areas

    @property
    def placed(self) -> list[PlacedLeaf]:
        """The candidates that are doors."""
        return [leaf for leaf in self.doors if leaf.is_door]

    @property
    def rejected(self) -> list[DoorCandidate]:
        """The candidates that are parts of the scene; see `settle_doors`."""
        return [leaf.candidate for leaf in self.doors if _is_part(leaf)]

    @property
    def settled(self) -> list[DoorCandidate]:
        """The candidates without those that are rejected."""
        return [leaf.candidate for leaf in self.doors if not _is_part(leaf)]

    @cached_property
    def areas(self) -> PaintedAreas:
        """The areas of the settings, painted on the levels."""
        if not self.config.areas:
            return PaintedAreas([], [], [])
        known = self.scene, self.lattice, self.floors.levels, self.rooms, self.config
        with self.clock.stage("areas"):
            return paint_areas(*known)

    @cached_property
    def links(self) -> BakedLinks:
        """The named links, those of the settings and those that are found."""
        if not self.config.links:
            return BakedLinks([], [])
        columns, taken, placed = self.baked_columns, self.occupancy.levels, self.placed
        with self.clock.stage("links"):
            floors = np.stack([level.floor for level in self.floors.levels])
            free = ~(np.stack(taken) | np.isnan(floors))
            for number, level in enumerate(free):  # as doors are, so are their links
                for door in placed:
                    for cells in door.blocked.values():
                        level.ravel()[cells[number]] = False
            space = Space(columns, self.tiled, self.footprint)
            known = self.doorless, self.lattice, floors, free, space, self.config.agent
            return find_links(Ground(*known), self.config.links)

    @cached_property
    def boxes(self) -> LevelBoxes:
        """The rectangle and the box of each level, by which the original client finds it."""
        found, height = (self.floors.levels, self.occupancy.levels), self.config.agent.height
        return find_level_boxes(*found, self.lattice, self.scene.bounds, height)

    @cached_property
    def floor_layers(self) -> list[NDArray[np.float32]]:
        """The floor of each level as it is written, of the whole lattice."""
        return [level.floor.astype(np.float32) for level in self.floors.levels]

    @cached_property
    def room_table(self) -> list[Json]:
        """The table of rooms as a file states it, with the doors between them."""
        closed = {one.candidate.id: (one.rooms, one.closed_cells) for one in self.placed}
        return [room.to_json() for room in self.rooms.with_doors(closed).table]

    @cached_property
    def stated_settings(self) -> Json:
        """The settings and their digest, as a file states them."""
        digest, state = settings_digest(self.config), settings_to_state(self.config)
        return {"settingsDigest": digest, "settings": state}

    def _tile(self, lattice: Lattice) -> ShapeSource:
        reach = max(self.footprint.reach, self.config.floors.crack)
        return list_shapes(self.doorless.shapes, lattice, reach)

    def free_geometry(self) -> None:
        """Give back the memory of columns and of listed geometry: the settled doors need none."""
        _ = self.holes, self.areas, self.links
        geometry = "tiled", "judged_shapes", "judged_columns", "columns"
        for name in (*geometry, "_extents", "cells", "room_flags"):
            self.__dict__.pop(name, None)
        self.doorless.shapes.forget_triangles()


def _is_part(leaf: PlacedLeaf) -> bool:
    """Whether a leaf that is no door is a part of the scene on the lattice."""
    return not leaf.is_door and not leaf.leaf.is_beside


def _describe_extent(scene: Scene, config: BakeConfig) -> str:
    """What is added to an error: often the scene's axes, its unit or the bounds are wrong."""
    if scene.bounds is None:
        return ""
    hint = "; ".join(scene.hints)
    if scene.parts and not hint:
        up, unit = config.scene.up, config.scene.unit
        hint = f"check which way is up (`scene.up` is {up}) and the unit (`scene.unit` is {unit:g})"
    sides = zip("xyz", *scene.bounds.tolist(), strict=True)
    spans = ", ".join(f"{axis} {low:.6g} to {high:.6g}" for axis, low, high in sides)
    endless = scene.shapes.planes.geom
    if len(endless):
        spans += f" without {scene.geoms[endless[0]].name!r}, which is endless"
        spans += ": `grid.margin` or `grid.bounds` shows more of it"
    return f"; the scene spans, in m, {spans}{'; ' if hint else ''}{hint}"
