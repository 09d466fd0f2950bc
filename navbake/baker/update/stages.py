"""The stages of a bake, kept up to date by its functions: columns are cast again near what moved,
floors merged again from their blocks, occupancy and contents asked again in these cells, and rooms
and doors found again where anything that they read has changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker import column_blocks
from navbake.baker.blocks import Blocks
from navbake.baker.column_blocks import cast_at, place_columns
from navbake.baker.columns import Columns, take_columns, take_runs
from navbake.baker.doors.candidates import DoorCandidate
from navbake.baker.doors.doors import Placing, place_doors
from navbake.baker.floors.levels import FloorFinder
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import BUILDING, TOUCH, WALL
from navbake.baker.lattice import cells_near, lay_lattice
from navbake.baker.rooms.flags import RoomFlags, are_equal
from navbake.baker.rooms.sources import find_markers
from navbake.baker.stages import Stages
from navbake.baker.update.following import FullBake, Moved, boxes_of
from navbake.errors import SceneError
from navbake.threads import limit_threads
from navbake.types import Bool, Float, Int, Int32

# To bake all takes no longer than to follow what is near so large a share of the cells
MOST_CELLS = 0.5
# So many cells are worth a call on another thread
LEAST_CELLS = 4096
# The store of columns has so many times the room that it needs at first
ROOM = 1.25


class KeptColumns:
    """The columns of a lattice, each a run of one store; see `ColumnSource`.

    A new column is written behind all others, and its cell points at it from then on (as in a
    log-structured store; Rosenblum and Ousterhout, 1992), until the store is full.
    """

    def __init__(self, columns: Columns) -> None:
        self.lattice = columns.lattice
        self._cells = np.arange(self.lattice.width * self.lattice.height)
        self._hold(columns.crossings)

    def _hold(self, crossings: Crossings) -> None:
        """Make crossings of all cells the store, which has no room for others then."""
        self._first, self._counts = crossings.start[:-1].copy(), np.diff(crossings.start)
        self._used, self._arrays = len(crossings.z), list[NDArray[Any]](crossings[1:])

    def _make_room(self, more: int) -> None:
        """Make room for `more` crossings at least."""
        if self._counts.sum() < self._used:  # some are no cell's any more
            self._hold(self.take(self._cells))
        room = int((self._used + more) * ROOM) + 100
        for number, array in enumerate(self._arrays):
            self._arrays[number] = np.empty((room, *array.shape[1:]), dtype=array.dtype)
            self._arrays[number][: self._used] = array[: self._used]

    def blocks(self) -> Iterator[Columns]:
        """All columns, in one block."""
        yield Columns(self.lattice, self.take(self._cells))

    def at(self, cells: Int | Int32) -> Columns:
        """Columns in which those of some cells are known, whatever the order of their ids."""
        asked = np.unique(cells).astype(np.int64)
        return place_columns(self.lattice, asked, self.take(asked))

    def take(self, cells: Int) -> Crossings:
        """The columns of some cells, ascending, numbered as these are."""
        return take_runs(self._arrays, self._first[cells], self._counts[cells])

    def put(self, cells: Int, crossings: Crossings) -> None:
        """Replace the columns of some cells, ascending; crossings are numbered as these are."""
        end = self._used + len(crossings.z)
        if end > len(self._arrays[0]):
            self._make_room(len(crossings.z))
            end = self._used + len(crossings.z)
        for array, new in zip(self._arrays, crossings[1:], strict=True):
            array[self._used : end] = new
        self._first[cells] = self._used + crossings.start[:-1]
        self._counts[cells], self._used = np.diff(crossings.start), end


class LiveStages:
    """The `stages` of a scene with the same bodies taken for doors, kept up to date."""

    def __init__(self, stages: Stages) -> None:
        self._finder: FloorFinder
        stages.floors, self._finder = stages.judge_floors()
        lattice = stages.lattice
        self._is_whole, self._blocks = stages.judged[0] == lattice, Blocks(lattice)
        is_kept = self._is_whole and lattice.width * lattice.height <= column_blocks.KEPT_CELLS
        self._kept = KeptColumns(stages.columns) if is_kept else None
        self._take_over(stages)

    def _take_over(self, stages: Stages) -> None:
        """Find all stages after the floors, and keep what updates need of them."""
        _ = stages.contents
        self._markers = find_markers(stages.scene, stages.config.rooms)
        self._cells, self._heights = stages.cells, stages.tiled.heights
        self._room_flags: RoomFlags | None = stages.room_flags
        _ = stages.doors
        stages.free_geometry()
        self.stages = stages

    def follow(self, moved: Moved, differ: Mapping[str, DoorCandidate]) -> str:
        """Bring all up to date; `differ` has the candidates that differ now, by their ids.

        Returns why all that follows on the floors was found anew; empty where it was not. After a
        FullBake, nothing here is to be used any more.
        """
        was, scene = self.stages, moved.scene
        candidates = [differ.get(one.id, one) for one in was.candidates]
        now = replace(was, scene=scene, candidates=candidates)
        now.stated_settings = was.stated_settings
        own = moved.geoms.copy()
        for candidate in candidates:
            own[candidate.geoms] = False
        boxes = np.concatenate([boxes_of(shapes.only(own)) for shapes in moved.shapes])
        reach = max(now.footprint.reach, now.config.floors.crack) + 2 * TOUCH
        near = cells_near(now.lattice, boxes, reach)
        self._check(now, near)
        known, self._markers = self._markers, find_markers(scene, now.config.rooms)
        planes, before = (len(one.doorless.shapes.planes.geom) for one in (now, was))
        flags_hold = np.array_equal(known[1], self._markers[1]) and planes == before
        flags_hold &= not (moved.every & known[0]).any()
        flags_hold &= np.array_equal(_box(was), _box(now))
        now.floors, reason, changed = was.floors, "", near[:0]
        # of few cells, a share takes no longer than to give it to another thread
        with limit_threads(1 if len(near) < LEAST_CELLS else None):
            if len(near):
                flags_hold &= self._cast(now, near)
                reason, changed = self._find_floors(now, near)
            if was.contents is not None and _box(was)[1, 2] != _box(now)[1, 2]:
                reason = reason or "the top of the scene has another height"
            if reason:
                self._take_over(now)
                return reason
            now.occupancy, now.contents = was.occupancy, was.contents
            if len(near):
                near, holds = self._ask_cells(now, own, near, changed)
                flags_hold &= holds and np.array_equal(was.floors.links, now.floors.links)
            if not len(changed):
                now.floor_layers = was.floor_layers
            else:
                self._room_flags = None  # its floors were written to
        if not flags_hold or self._room_flags is None:
            now.cells = self._cells
            flags, self._room_flags = self._room_flags, now.room_flags
            flags_hold = flags is not None and are_equal(now.room_flags, flags)
        if flags_hold or are_equal(now.rooms, was.rooms):
            now.rooms = was.rooms
        now.doors = _follow_doors(was, now, set(differ), near)
        if was.rejected and not now.rejected:
            raise FullBake("all that looks like a door is one now")
        if now.rooms is was.rooms and now.doors is was.doors:
            now.room_table = was.room_table
        now.free_geometry()
        self.stages = now
        return ""

    def _check(self, now: Stages, near: Int) -> None:
        """FullBake where not just what is near to what moved may be others."""
        was, lattice = self.stages, lay_lattice(now.scene, now.config)
        if not self._is_whole:
            raise FullBake("the scene goes on beyond the grid")
        if lattice != was.lattice or now.judged != was.judged:
            raise FullBake("the grid is another one: the box round the scene has changed")
        if len(near) > MOST_CELLS * lattice.width * lattice.height:
            raise FullBake("what moved is near most of the cells")
        heights, self._heights = self._heights, now.tiled.heights
        if heights != self._heights and now.doorless.shapes.planes.mat[:, [2, 5, 6, 7]].any():
            raise FullBake("lines that cross a plane that is not level begin at another height")
        if self._kept:
            now.judged_columns = self._kept

    def _cast(self, now: Stages, near: Int) -> bool:
        """Cast columns again; whether the surfaces that mark rooms are known to be the same."""
        config, marks = now.config, self._markers[0]
        found = cast_at(now.tiled, config.agent, config.floors.crack, near)
        crossings = take_columns(found.crossings, near)
        self._finder.replace(near, crossings, now.doorless.shapes.planes)
        if self._kept is None:
            return not marks.any()
        known = self._kept.take(near)
        self._kept.put(near, crossings)
        return _same_surfaces(known, crossings, marks)

    def _find_floors(self, now: Stages, near: Int) -> tuple[str, Int]:
        """Find floors again; returns whether there are other levels, and why; and what changed."""
        source, finder = now.judged_columns, self._finder
        asked = source, now.doorless.shapes, now.occupancy_test(source), self._blocks.holding(near)
        before = [(one.name, one.ground) for one in now.floors.levels]
        try:
            now.floors = finder.find(*asked)
        except SceneError as error:  # which a full bake raises, with more to say
            raise FullBake(str(error)) from error
        after = [(one.name, one.ground) for one in now.floors.levels]
        if finder.changed is None or before != after:
            return "there are other levels", near
        return "", finder.changed

    def _ask_cells(self, now: Stages, own: Bool, near: Int, changed: Int) -> tuple[Int, bool]:
        """Look again at cells near what moved, and where the floor changed.

        Returns these, and whether rooms read the same there as before.
        """
        touched = np.union1d(near, changed)
        columns, (finder, of_columns) = now.judged_columns.at(touched), self._cells
        crossings, was = take_columns(columns.crossings, touched), now.contents
        holds = not of_columns.look(touched, crossings, now.floors.levels)
        finder.look_again(now.doorless, now.floors, columns, now.tiled, touched, own)
        now.occupancy, now.contents = finder.occupancy, finder.found(now.config.names)
        if was is not None and now.contents is not None:
            holds &= now.contents.have_same_walls(was, touched)
            # widths of gaps are measured up to walls
            holds &= not np.isin(now.contents.partitions[own], (WALL, BUILDING)).any()
        return touched, holds


def _box(stages: Stages) -> Float:
    """The box round the scene, infinite where it is endless."""
    bounds = stages.scene.bounds
    return np.full((2, 3), np.inf) if bounds is None else bounds


def _follow_doors(was: Stages, now: Stages, differ: set[str], touched: Int) -> list[Placing]:
    """Place again the doors that moved, and those near cells that something touched."""
    around = now.around_doors
    again = [
        new
        for new, old in zip(now.candidates, was.doors, strict=True)
        if now.rooms is not was.rooms or new.id in differ or old.depends_on(touched, around)
    ]
    if not again:
        return was.doors
    placed = {one.candidate.id: one for one in place_doors(now.scene, again, around)}
    return [placed.get(one.candidate.id, one) for one in was.doors]


def _same_surfaces(old: Crossings, new: Crossings, geoms: Bool) -> bool:
    """Whether some geoms have the same surfaces in columns of the same cells."""
    found = []
    for columns in (old, new):
        cell = np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
        own = geoms[columns.geom]
        found.append((cell[own], columns.z[own], columns.normal[own], columns.geom[own]))
    return all(np.array_equal(one, other) for one, other in zip(*found, strict=True))
