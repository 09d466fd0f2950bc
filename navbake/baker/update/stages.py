"""The stages of a bake, kept up to date: a value holds as long as what its stage reads is the same.

Columns, occupancy and contents read what is near a cell, and are found again near what moved.
Floors are found block by block, see `FloorFinder`. Rooms, doors and boxes are found again as soon
as anything that they read has changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.assemble import weigh
from navbake.baker.blocks import Blocks
from navbake.baker.columns import Columns, TiledShapes, height_range
from navbake.baker.doors.candidates import DoorCandidate
from navbake.baker.doors.doors import Surroundings
from navbake.baker.floors.growth import FloorChanges
from navbake.baker.floors.levels import FloorFinder, Floors
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import TOUCH
from navbake.baker.lattice import lay_lattice, lay_whole
from navbake.baker.occupancy.occupancy import check_footprints
from navbake.baker.rooms.flags import RoomFlags, read_flags
from navbake.baker.rooms.rooms import find_rooms
from navbake.baker.rooms.sources import find_markers
from navbake.baker.stages import Stages
from navbake.baker.update.columns import LEAST_CELLS, LiveColumns, Region, Scratch
from navbake.baker.update.contents import LiveContents
from navbake.baker.update.doors import LiveDoors
from navbake.baker.update.following import Moved
from navbake.baker.update.full_bake import FullBake
from navbake.baker.update.kernels.regions import cells_of_boxes, join_cells
from navbake.baker.update.kinds import NearMoved
from navbake.errors import SceneError
from navbake.threads import limit_threads
from navbake.types import Bool, Float, Int


class Parts(NamedTuple):
    """What is kept of the stages beside their values."""

    columns: LiveColumns
    floors: FloorFinder
    contents: LiveContents | None
    doors: LiveDoors


class Weighed(NamedTuple):
    """Which cells of a level were occupied last, and their weights; written to."""

    occupied: Bool
    weights: Float


class LiveStages:
    """The stages of a scene with the same bodies taken for doors, kept up to date.

    Attributes:
        stages: as they are now; the columns and, where `contents` has them, the contents are
            not among them.
        contents: what stands in the cells; None where the stages have it.
        reason: why nothing can be brought up to date near what moves alone; empty where it can.
    """

    def __init__(self, stages: Stages) -> None:
        self.stages, self.contents, self.reason = stages, None, ""
        floors, finder = stages.judge_floors()
        stages.__dict__["floors"] = floors
        self._parts: Parts | None = None
        self._room_flags: RoomFlags | None = None
        self._floor_layers: list[NDArray[np.float32]] | None = None
        self._weighed: dict[int, Weighed] = {}
        found = stages.contents
        doors = stages.doors
        if not doors.rejected:
            _ = stages.boxes
        try:
            if stages.judged[0] != stages.lattice:
                raise FullBake("the scene goes on beyond the grid")
            planes = stages.doorless.shapes.planes
            if len(planes.geom) and not _are_level(planes.mat):
                raise FullBake("a plane is not level")
            if not stages.whole.columns.are_kept:
                raise FullBake("the grid has too many cells for their columns to be kept")
            columns = LiveColumns(stages.config, stages.columns)
        except FullBake as why:
            self.reason = str(why)
        else:
            if found is not None:
                known_scene = stages.config, stages.doorless, found
                self.contents = LiveContents(*known_scene, floors, stages.columns, columns)
            live_doors = LiveDoors(stages.scene, stages.candidates, stages.lattice, columns.scratch)
            self._parts = Parts(columns, finder, self.contents, live_doors)
            self._blocks = Blocks(stages.lattice)
            self._markers = find_markers(stages.scene, stages.config.rooms)
            self._of_columns, self._room_flags = stages.of_columns, stages.room_flags
        shapes = stages.doorless.shapes
        self._heights = height_range(shapes, stages.lattice)
        stages.free_geometry()

    def follow(self, moved: Moved, differ: Mapping[str, DoorCandidate]) -> None:
        """Bring all up to date.

        Args:
            moved: the scene as it is now, and what moved of the geoms that count.
            differ: the candidates for doors that differ now, by their ids.

        Raises:
            FullBake: all is to be found anew. Nothing here is to be used any more.
        """
        if self._parts is None:
            raise FullBake(self.reason)
        parts, was, scene = self._parts, self.stages, moved.scene
        candidates = [differ.get(one.id, one) for one in was.candidates]
        stages = replace(was, scene=scene, candidates=candidates)
        is_door = np.zeros(scene.model.ngeom, dtype=np.bool_)
        for candidate in candidates:
            is_door[candidate.geoms] = True
        own = np.zeros(scene.model.ngeom, dtype=np.bool_)
        own[moved.geoms[~is_door[moved.geoms]]] = True
        boxes = moved.boxes[own[moved.box_geom]]
        kept = "floors", "occupancy", "rooms", "doors"
        same = {name: was.__dict__[name] for name in kept}
        stages.__dict__.update(same)
        if "boxes" in was.__dict__:
            stages.__dict__["boxes"] = was.boxes
        stages.__dict__["contents"] = None
        flags_hold = self._check_box(was, stages)
        touched: Int = np.empty(0, dtype=np.int64)
        if len(boxes):
            touched, holds = self._follow_cells(parts, stages, boxes, own)
            flags_hold &= holds
        markers = find_markers(scene, stages.config.rooms)
        flags_hold &= not (moved.every & markers[0]).any()
        flags_hold &= np.array_equal(markers[1], self._markers[1])
        planes, others = (len(one.doorless.shapes.planes.geom) for one in (stages, was))
        flags_hold &= planes == others
        self._markers = markers
        if not flags_hold:
            self._find_rooms(parts, stages)
        near = touched if stages.rooms is was.rooms else None
        around = Surroundings(
            stages.floors.levels, stages.occupancy, stages.rooms, stages.footprints
        )
        stages.__dict__["doors"] = parts.doors.follow(
            was.doors, scene, candidates, set(differ), near, around, stages.config.doors.state
        )
        if stages.rooms is was.rooms and stages.doors is was.doors:
            stages.__dict__["room_table"] = was.room_table
        stages.__dict__["stated_settings"] = was.stated_settings
        if was.doors.rejected and not stages.doors.rejected:
            raise FullBake("all that looks like a door is one now")
        stages.free_geometry()
        self.stages = stages

    @property
    def floor_layers(self) -> list[NDArray[np.float32]] | None:
        """The floor as it is written, the same array as long as it stays the same."""
        if self._parts is None:
            return None
        if self._floor_layers is None:
            levels = self.stages.floors.levels
            self._floor_layers = [level.floor.astype(np.float32) for level in levels]
        return self._floor_layers

    def weigh(self, level: int, occupied: Bool) -> Float:
        """The weights of a level's cells, an array of their own.

        To copy those of the last grid takes a quarter of the time that it takes to make them.
        """
        known = self._weighed.get(level)
        if known is None or known.occupied.shape != occupied.shape:
            self._weighed[level] = known = Weighed(occupied.copy(), weigh(occupied))
            return known.weights.copy()
        changed = np.flatnonzero(occupied != known.occupied)
        weights = known.weights.copy()
        marks = occupied.reshape(-1)[changed]
        known.occupied.reshape(-1)[changed] = marks
        for one in (known.weights, weights):
            one.reshape(-1)[changed] = weigh(marks)
        return weights

    def _check_box(self, was: Stages, now: Stages) -> bool:
        """Whether the scene has the same box; FullBake where that changes the grid."""
        old, new, config = was.scene.bounds, now.scene.bounds, now.config
        if old is None and new is None:
            return True
        if old is None or new is None:
            raise FullBake("the scene has become endless, or is no longer")
        if np.array_equal(old, new):
            return True
        lattice = lay_lattice(now.scene, config)
        if lattice != was.lattice or lay_whole(lattice, new, config.grid.max_cells) != was.judged:
            raise FullBake("the grid is another one: the box round the scene has changed")
        if old[1, 2] != new[1, 2] and self.contents is not None:
            raise FullBake("the top of the scene has another height")
        now.__dict__.pop("boxes", None)
        return False

    def _follow_cells(
        self, parts: Parts, stages: Stages, boxes: Float, own: Bool
    ) -> tuple[Int, bool]:
        """Bring columns, floors, occupancy and contents up to date near what moved.

        Returns:
            All cells near it, and whether rooms read the same flags as before.
        """
        columns, shapes = parts.columns, stages.doorless.shapes
        lattice, flag = columns.lattice, columns.scratch.flag
        if own[shapes.planes.geom].any():
            raise FullBake("a plane moves")
        heights = height_range(shapes, lattice)
        if heights != self._heights and len(shapes.planes.geom):
            columns.check_planes(shapes, self._heights, heights)
        self._heights = heights
        near_by = max(stages.footprints.whole.reach, lattice.cell_size / 2) + 2 * TOUCH
        touched = cells_of_boxes(lattice, boxes, near_by, 1.0, flag)
        asked = columns.asked(boxes)
        # of few cells, a share takes no longer than to give it to another thread
        is_little = len(touched) + len(asked) < LEAST_CELLS
        with limit_threads(1 if is_little else None):
            return self._follow_near(parts, stages, own, touched, asked)

    def _follow_near(
        self, parts: Parts, stages: Stages, own: Bool, touched: Int, asked: Int
    ) -> tuple[Int, bool]:
        """See `_follow_cells`; what moved may stand in the `touched` cells."""
        columns, finder, contents = parts[:3]
        doorless, scratch, heights = stages.doorless, columns.scratch, self._heights
        shapes = doorless.shapes
        reach = max(stages.footprints.whole.reach, stages.config.floors.crack)
        near = columns.near(shapes, join_cells(touched, asked), reach, heights)
        found = columns.cast(near, asked)
        old, was = columns.gather(found.cells), stages.floors
        columns.put(found)
        floors, changes = self._find_floors(stages, finder, columns, found, touched)
        stages.__dict__["floors"] = floors
        changed: Int = np.empty(0, dtype=np.int64)
        for change in changes:
            changed = join_cells(changed, change.heights)
        touched = join_cells(touched, join_cells(found.cells, changed))
        if len(changed):
            near = columns.near(shapes, touched, reach, heights)
        region = columns.gather(touched)
        _check_cells(stages, region, near, scratch)
        flags_hold = not self._of_columns.look(touched, region.columns, floors.levels)
        flags_hold &= np.array_equal(was.links, floors.links) and not len(changed)
        marks = self._markers[0]
        flags_hold &= _same_surfaces(old.columns, found.columns, marks)
        if contents is not None:
            moving = NearMoved(doorless, own, region, floors, changes)
            flags_hold &= not any(contents.follow(moving, near, stages.occupancy.levels))
        if len(changed):
            self._room_flags = None
        if len(changed):
            self._floor_layers = None
        if len(changed) or len(floors.levels) > 1:
            stages.__dict__.pop("boxes", None)
        return touched, flags_hold

    def _find_rooms(self, parts: Parts, stages: Stages) -> None:
        """Read what rooms depend on; find them again if it is not the same as before."""
        config, shape, contents = stages.config, stages.lattice.shape, parts.contents
        none = np.zeros(shape, dtype=np.bool_)
        blocked = [(none, none) for _ in stages.floors.levels]
        if contents is not None:
            pairs = zip(contents.wall, contents.low, strict=True)
            blocked = [(wall.reshape(shape), low.reshape(shape)) for wall, low in pairs]
        found = stages.doorless, parts.columns, stages.floors, self._of_columns.bits, blocked
        flags, known = read_flags(*found, config.rooms, config.agent), self._room_flags
        if known is None or not flags.equal(known):
            rooms = find_rooms(flags, config.rooms, config.agent.traversable_floor_height)
            stages.__dict__["rooms"] = rooms
        self._room_flags = flags

    def _find_floors(
        self,
        stages: Stages,
        finder: FloorFinder,
        columns: LiveColumns,
        found: Region,
        touched: Int,
    ) -> tuple[Floors, list[FloorChanges]]:
        """Find floors again; FullBake where there are other levels.

        Args:
            found: the cells with other columns.
            touched: those near what moved.
        """
        was, shapes = stages.floors, stages.doorless.shapes
        finder.replace(*found, shapes.planes)
        near = self._blocks.holding(join_cells(touched, found.cells))
        try:
            floors = finder.find(columns, shapes, stages.occupancy_test(columns), near)
        except SceneError as error:  # which a full bake raises, with more to say
            raise FullBake(str(error)) from error
        before, now = (
            [(level.name, level.ground) for level in one.levels] for one in (was, floors)
        )
        if finder.changed is None or before != now:
            raise FullBake("there are other levels")
        return floors, finder.changed


def _check_cells(stages: Stages, region: Region, near: TiledShapes, scratch: Scratch) -> None:
    """Check the occupancy of some cells again, in place."""
    occupancy = stages.occupancy
    columns = Columns(stages.lattice, region.by_id(scratch))
    for k, level in enumerate(stages.floors.levels):
        floor = level.floor.reshape(-1)[region.cells]
        has_floor = ~np.isnan(floor)
        asked = region.cells[has_floor], floor[has_floor]
        answers = check_footprints(columns, near, stages.footprints, *asked)
        layers = [(occupancy.levels[k], answers.occupied)]
        if occupancy.solid is not None:
            layers.append((occupancy.solid[k], answers.solid))
        for layer, taken in layers:
            flat = layer.reshape(-1)
            flat[region.cells] = True
            flat[asked[0]] = taken


def _same_surfaces(old: Crossings, new: Crossings, geoms: Bool) -> bool:
    """Whether some geoms have the same surfaces in columns of the same cells."""
    found = []
    for columns in (old, new):
        cell = np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
        own = geoms[columns.geom]
        found.append((cell[own], columns.z[own], columns.normal[own], columns.geom[own]))
    return all(np.array_equal(one, other) for one, other in zip(*found, strict=True))


def _are_level(mat: Float) -> bool:
    """Whether planes face straight up or down to the last bit."""
    return not mat[:, [2, 5, 6, 7]].any()
