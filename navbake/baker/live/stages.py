"""The stages of a bake, kept up to date: what each reads decides whether its value still holds.

A stage's value is used again only where all that it reads is as it was. Columns, occupancy and
contents read what is near a cell, and are asked again there. Floors are brought up to date near
what moved where that is all there is to it, see `LiveFloors`. Rooms, doors and boxes are found
again as soon as anything that they read has changed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.assemble import weigh
from navbake.baker.columns import Columns, TiledShapes, height_range
from navbake.baker.cracks import crack_reach
from navbake.baker.doors.candidates import DoorCandidate
from navbake.baker.doors.doors import Surroundings
from navbake.baker.floors.levels import Judged
from navbake.baker.floors.outline import find_cropped
from navbake.baker.kernels.constants import TOUCH
from navbake.baker.lattice import lay_lattice, lay_whole
from navbake.baker.live.columns import LEAST_CELLS, Asked, LiveColumns, Region, Scratch
from navbake.baker.live.contents import LiveContents
from navbake.baker.live.doors import LiveDoors
from navbake.baker.live.floors import LiveFloors
from navbake.baker.live.following import Moved
from navbake.baker.live.kernels.regions import cells_of_boxes, join_cells
from navbake.baker.live.kinds import NearMoved
from navbake.baker.live.not_local import NotLocal
from navbake.baker.live.rooms import LiveRooms, Seen
from navbake.baker.occupancy.occupancy import check_footprints
from navbake.baker.rooms.flags import find_ends
from navbake.baker.rooms.rooms import Rooms
from navbake.baker.stages import Stages
from navbake.threads import limit_threads, run_beside
from navbake.types import Bool, Float, Int


class Parts(NamedTuple):
    """What is kept of the stages beside their values."""

    columns: LiveColumns
    floors: LiveFloors
    contents: LiveContents | None
    rooms: LiveRooms
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
        notes: list[Judged] = []
        floors = stages.judge_floors(notes)
        stages.__dict__["floors"] = floors
        self._parts: Parts | None = None
        self._floor_layer: NDArray[np.float32] | None = None
        self._weighed: Weighed | None = None
        self._copied: Callable[[], Float] | None = None  # gives a copy of those weights
        found = stages.contents
        doors = stages.doors
        if not doors.rejected:
            _ = stages.boxes
        try:
            if stages.judged[0] != stages.lattice:
                raise NotLocal("the scene goes on beyond the grid")
            planes = stages.doorless.shapes.planes
            if len(planes.geom) and not _are_level(planes.mat):
                raise NotLocal("a plane is not level")
            moved = stages.whole.columns.moved
            if moved is None:
                raise NotLocal("the grid has too many cells for their columns to be kept")
            columns = LiveColumns(stages.config, stages.columns, moved, planes)
            live_floors = LiveFloors(stages.config, floors, notes[0], stages.columns, columns)
        except NotLocal as why:
            self.reason = str(why)
        else:
            if found is not None:
                known_scene = stages.config, stages.doorless, found
                self.contents = LiveContents(*known_scene, floors, stages.columns, columns)
            rooms = LiveRooms(stages.config, stages.scene, columns, floors)
            live_doors = LiveDoors(stages.scene, stages.candidates, stages.lattice, columns.scratch)
            self._parts = Parts(columns, live_floors, self.contents, rooms, live_doors)
        shapes = stages.doorless.shapes
        self._heights = height_range(shapes, stages.lattice)
        self._cropped = find_cropped(stages.lattice, shapes.bounds())
        stages.free_geometry()

    def follow(self, moved: Moved, differ: Mapping[str, DoorCandidate]) -> None:
        """Bring all up to date.

        Args:
            moved: the scene as it is now, and what moved of the geoms that count.
            differ: the candidates for doors that differ now, by their ids.

        Raises:
            NotLocal: all is to be found anew. Nothing here is to be used any more.
        """
        if self._parts is None:
            raise NotLocal(self.reason)
        parts, was, scene = self._parts, self.stages, moved.scene
        if self._weighed is not None:
            self._copied = run_beside(self._weighed.weights.copy)
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
        self._check_box(was, stages)
        touched: Int = np.empty(0, dtype=np.int64)
        rooms: Rooms | None = was.rooms
        if len(boxes):
            touched, rooms = self._follow_cells(parts, stages, boxes, own)
        if parts.rooms.marks.have_moved(scene, moved.every):
            rooms = None
        parts.rooms.marks.keep(scene)
        rooms_same = rooms is not None
        if rooms is None:
            rooms = parts.rooms.find(stages.doorless, stages.floors, parts.contents)
        stages.__dict__["rooms"] = rooms
        around = Surroundings(
            stages.floors.levels, stages.occupancy, stages.rooms, stages.footprints
        )
        stages.__dict__["doors"] = parts.doors.follow(
            was.doors, scene, candidates, set(differ), touched if rooms_same else None, around,
            stages.config.doors.state,
        )  # fmt: skip
        if stages.rooms is was.rooms and stages.doors is was.doors:
            stages.__dict__["room_table"] = was.room_table
        stages.__dict__["stated_settings"] = was.stated_settings
        if was.doors.rejected and not stages.doors.rejected:
            raise NotLocal("all that looks like a door is one now")
        self.stages = stages

    @property
    def floor_layers(self) -> list[NDArray[np.float32]] | None:
        """The floor as it is written, the same array as long as it stays the same."""
        if self._parts is None:
            return None
        if self._floor_layer is None:
            self._floor_layer = self.stages.floors.levels[0].floor.astype(np.float32)
        return [self._floor_layer]

    def weigh(self, occupied: Bool) -> Float:
        """The weights of the one level's cells, an array of their own.

        To copy those of the last grid takes a quarter of the time that it takes to make them, and
        other work goes on beside it.
        """
        known, copied = self._weighed, self._copied
        self._copied = None
        if known is None or known.occupied.shape != occupied.shape:
            self._weighed = known = Weighed(occupied.copy(), weigh(occupied))
            return known.weights.copy()
        changed = np.flatnonzero(occupied != known.occupied)
        weights = known.weights.copy() if copied is None else copied()
        marks = occupied.reshape(-1)[changed]
        known.occupied.reshape(-1)[changed] = marks
        for one in (known.weights, weights):
            one.reshape(-1)[changed] = weigh(marks)
        return weights

    def _check_box(self, was: Stages, now: Stages) -> None:
        """NotLocal where the box round the scene changes what depends on it."""
        old, new, config = was.scene.bounds, now.scene.bounds, now.config
        bounds = now.doorless.shapes.bounds()
        cropped = find_cropped(now.lattice, bounds)
        if not np.array_equal(cropped, self._cropped):
            raise NotLocal("the scene goes on beyond the grid at another side")
        if old is None and new is None:
            return
        if old is None or new is None:
            raise NotLocal("the scene has become endless, or is no longer")
        if np.array_equal(old, new):
            return
        lattice = lay_lattice(now.scene, config)
        if lattice != was.lattice or lay_whole(lattice, new, config.grid.max_cells) != was.judged:
            raise NotLocal("the grid is another one: the box round the scene has changed")
        if old[1, 2] != new[1, 2] and self.contents is not None:
            raise NotLocal("the top of the scene has another height")
        if not np.array_equal(find_ends(lattice, old), find_ends(lattice, new)):
            raise NotLocal("the scene ends at other sides of the grid")
        now.__dict__.pop("boxes", None)

    def _follow_cells(
        self, parts: Parts, stages: Stages, boxes: Float, own: Bool
    ) -> tuple[Int, Rooms | None]:
        """Bring columns, floors, occupancy and contents up to date near what moved.

        Returns:
            All cells near it, and the rooms, None where they are to be found again.
        """
        columns, shapes = parts.columns, stages.doorless.shapes
        lattice, flag = columns.lattice, columns.scratch.flag
        if own[shapes.planes.geom].any():
            raise NotLocal("a plane moves")
        heights = height_range(shapes, lattice)
        if heights != self._heights and len(shapes.planes.geom):
            columns.check_planes(shapes, self._heights, heights)
        self._heights = heights
        near_by = max(stages.footprints.whole.reach, lattice.cell_size / 2) + 2 * TOUCH
        touched = cells_of_boxes(lattice, boxes, near_by, 1.0, flag)
        asked = columns.asked(boxes)
        # of few cells, a share takes no longer than to give it to another thread
        is_little = len(touched) + len(asked.every) < LEAST_CELLS
        with limit_threads(1 if is_little else None):
            return self._follow_near(parts, stages, own, touched, asked)

    def _follow_near(
        self, parts: Parts, stages: Stages, own: Bool, touched: Int, asked: Asked
    ) -> tuple[Int, Rooms | None]:
        """See `_follow_cells`; what moved may stand in the `touched` cells."""
        columns, floors, contents = parts[:3]
        doorless, scratch, heights = stages.doorless, columns.scratch, self._heights
        shapes = doorless.shapes
        reach = max(stages.footprints.whole.reach, crack_reach(stages.config.floors.crack))
        near = columns.near(shapes, join_cells(touched, asked.every), reach, heights)
        found = columns.cast(near, asked)
        old = columns.gather(found.cells)
        changes = floors.follow(found, touched, shapes.planes)
        touched = join_cells(touched, join_cells(found.cells, changes.heights))
        if len(changes.heights):
            near = columns.near(shapes, touched, reach, heights)
        region = columns.gather(touched)
        _check_cells(stages, region, near, scratch)
        seen = Seen(old, found, changes.heights, changes.before)

        def follow_rooms() -> Rooms | None:
            """What reads no contents; NotLocal where the floors are not what they were."""
            floors.check(changes)
            return parts.rooms.follow(stages.rooms, stages.floors, seen)

        rooms, walls = run_beside(follow_rooms), False
        try:
            if contents is not None:
                moved = NearMoved(doorless, own, region, stages.floors, changes)
                walls = any(contents.follow(moved, near, stages.occupancy.levels[0]))
        finally:  # nothing goes on after an error here
            found_rooms = rooms()
        if len(changes.heights):
            stages.__dict__.pop("boxes", None)
            self._floor_layer = None
        return touched, None if walls else found_rooms


def _check_cells(stages: Stages, region: Region, near: TiledShapes, scratch: Scratch) -> None:
    """Check the occupancy of some cells again, in place."""
    level, occupancy = stages.floors.levels[0], stages.occupancy
    floor = level.floor.reshape(-1)[region.cells]
    has_floor = ~np.isnan(floor)
    asked = region.cells[has_floor], floor[has_floor]
    columns = Columns(stages.lattice, region.by_id(scratch))
    answers = check_footprints(columns, near, stages.footprints, *asked)
    layers = [(occupancy.levels[0], answers.occupied)]
    if occupancy.solid is not None:
        layers.append((occupancy.solid[0], answers.solid))
    for layer, found in layers:
        flat = layer.reshape(-1)
        flat[region.cells] = True
        flat[asked[0]] = found


def _are_level(mat: Float) -> bool:
    """Whether planes face straight up or down to the last bit."""
    return not mat[:, [2, 5, 6, 7]].any()
