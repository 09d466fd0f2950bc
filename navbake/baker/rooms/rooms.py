"""Rooms: which one each cell belongs to, and the table of all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.rooms import openings
from navbake.baker.rooms.kernels import labels as kernels
from navbake.baker.rooms.openings import ClosedDoor, Opening, RoomIndex, RoomKey
from navbake.baker.rooms.outdoors import find_edge, find_outdoors
from navbake.baker.rooms.overhead import Overhead
from navbake.baker.rooms.segmentation import (
    SpaceFinder,
    give_covered,
    labels_in_order,
    segment_by_gaps,
    segment_rooms,
    share_rest,
)
from navbake.baker.rooms.sources import MarkedRooms, RoomMarkers
from navbake.baker.rooms.spaces import CloseCall
from navbake.baker.rooms.table import NamedRoom, describe_rooms, name_neighbours
from navbake.baker.rooms.windows import find_windows
from navbake.baker.scene.scene import Scene
from navbake.config.rooms import RoomSettings
from navbake.config.settings import AgentSettings
from navbake.errors import SceneError
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import Room
from navbake.types import Bool, Int, Int32

RoomIds = tuple[str | None, str | None]
"""The rooms on the two sides of a door, None for the outside."""

# Close calls that a warning names
LISTED = 5
MAX_ROOMS = np.iinfo(np.uint16).max  # of a level


@dataclass(frozen=True)
class Rooms:
    """The rooms of a scene.

    Attributes:
        index: the room of each cell by level, shape (height, width) of the whole lattice,
            uint16, 0 for none.
        table: the rooms by level and index; doors between neighbours are not named until
            `with_doors`.
        openings: where rooms of a level meet.
        links: pairs of rooms of two levels between which a step leads.
        lattice: the cells.
        open_cells: the cells by level that may be in a room: with a floor, and no wall or window.
        warnings: what the user should know, one line each.
        asked_sky: whether they depend on which cells are under the sky, see `Outdoors`.
    """

    index: list[RoomIndex]
    table: list[Room]
    openings: list[Opening]
    links: list[tuple[RoomKey, RoomKey]]
    lattice: Lattice
    open_cells: list[Bool]
    warnings: list[str]
    asked_sky: bool = False

    def room_at(self, level: int, cell: int) -> str | None:
        """The id of the room of a level's cell, counted on the whole lattice; None for none."""
        return self._ids.get((level, int(self.index[level].flat[cell])))

    @cached_property
    def _ids(self) -> dict[RoomKey, str]:
        return {(room.level, room.index): room.id for room in self.table}

    def with_doors(self, doors: Mapping[str, tuple[RoomIds, Sequence[Int]]]) -> Rooms:
        """The same rooms, with the doors between neighbours in the table; see `match_doors`.

        `doors` has the ids of the rooms that each door joins, and for each level the cells that it
        blocks when it is closed.
        """
        keys = {room: key for key, room in self._ids.items()}
        closed = {
            door: ClosedDoor(frozenset(keys[room] for room in rooms if room is not None), cells)
            for door, (rooms, cells) in doors.items()
        }
        named = openings.match_doors(self.openings, closed, self.lattice)
        return replace(self, table=name_neighbours(self.table, self.openings, self.links, named))


class Blocked(NamedTuple):
    """What keeps cells of a level out of all rooms, shape (height, width), bool.

    Attributes:
        wall: cells that a wall stands in.
        low: cells that a mesh of a whole building blocks, but not above heads; see `find_windows`.
    """

    wall: Bool
    low: Bool


def find_rooms(
    scene: Scene,
    overhead: Overhead,
    floors: Floors,
    blocked: Sequence[Blocked],
    settings: RoomSettings,
    agent: AgentSettings,
    spaces: SpaceFinder | None = None,
) -> Rooms:
    """Find the room that each cell belongs to.

    A cell's room is that of the first source that has one for it; what is left is segmented by
    itself, see `share_rest`. Cells without a floor, and cells that a wall or a window stands in,
    belong to none. On each level, rooms are numbered by
    their first cells in reading order: from large y to small, from small x to large. A room that
    reaches over several levels is one room on each. `spaces` may know those of the one level.

    Raises:
        ConfigError: a polygon names a level that does not exist.
        SceneError: a level has more than 65,535 rooms.
    """
    levels, lattice = floors.levels, overhead.columns.lattice
    open_cells = []
    for level, (wall, low) in zip(levels, blocked, strict=True):
        window = find_windows(low, wall, lattice.cell_size)
        open_cells.append(~np.isnan(level.floor) & ~wall & ~window)
    assignment = _Assignment(open_cells, spaces)
    markers = RoomMarkers(scene, overhead.columns, levels, settings, agent)
    for source in settings.sources:
        if source == "auto":
            assignment.segment(levels, settings, overhead, agent, scene)
        else:
            assignment.add(markers.mark(source), source)
    index, named = assignment.number()
    found = openings.find_openings(index, floors, agent.traversable_floor_height)
    links = openings.find_room_links(index, floors)
    table = name_neighbours(describe_rooms(index, named, floors, lattice), found, links, {})
    notes = assignment.warnings, assignment.asked_sky
    return Rooms(index, table, found, links, lattice, open_cells, *notes)


class _Assignment:
    """The room of each cell as the sources add rooms; the first source that has one keeps it."""

    def __init__(self, open_cells: Sequence[Bool], spaces: SpaceFinder | None) -> None:
        self._open, self._spaces = open_cells, spaces
        self._owner = [np.zeros(mask.shape, dtype=np.int32) for mask in open_cells]
        # whose floor lies under the cell's own, for cells without an owner
        self._under = [np.zeros(mask.shape, dtype=np.int32) for mask in open_cells]
        self._rooms: list[NamedRoom] = []  # owners count from 1
        self.warnings: list[str] = []
        self.asked_sky = False  # see `Outdoors`

    def add(self, marked: MarkedRooms, source: str) -> None:
        """Give the cells that have no room yet to the rooms of a source."""
        self.warnings += marked.warnings
        if not marked.names:
            return
        covered = marked.covered or marked.labels
        of_levels = zip(self._open, self._owner, self._under, marked.labels, covered, strict=True)
        for open_cells, owner, under, label, cover in of_levels:
            asked = open_cells, owner, label.astype(np.int32, copy=False)
            used = np.zeros(len(marked.names) + 1, dtype=np.bool_)
            kernels.mark_fresh(*asked, used)
            number = np.zeros(len(used), dtype=np.int32)
            for k in np.flatnonzero(used[1:]):
                self._rooms.append(NamedRoom(marked.names[k], source, k + 1 in marked.outdoors))
                number[k + 1] = len(self._rooms)
            kernels.give_fresh(*asked, number)
            kernels.note_under(under, cover.astype(np.int32, copy=False), number)

    def segment(
        self,
        levels: Sequence[LevelFloor],
        settings: RoomSettings,
        overhead: Overhead,
        agent: AgentSettings,
        scene: Scene,
    ) -> None:
        """Divide the remaining cells at gaps; see `segment_by_gaps` and `share_rest`.

        What is outdoors becomes one room, as far as it hangs together; see `find_outdoors`.
        """
        cell_size = overhead.columns.lattice.cell_size
        labels = []
        names: list[str | None] = []
        outdoors: set[int] = set()
        for number, level in enumerate(levels):
            edge = find_edge(self._open[number], level.floor, overhead, agent)
            segment = self._segment_level(number, level, settings, overhead, edge)
            owner = self._owner[number]
            if owner.any():
                owner = give_covered(owner, self._under[number] * self._open[number], segment)
                self._owner[number], segment = share_rest(
                    owner, segment, cell_size, settings.min_area
                )
            above = level.floor, overhead, agent, scene
            segment, outside, asked = find_outdoors(segment, edge, *above)
            self.asked_sky |= asked
            outdoors.update(room + len(names) for room in outside)
            labels.append(np.where(segment > 0, segment + len(names), 0) if names else segment)
            names += [None] * int(segment.max(initial=0))
        self.add(MarkedRooms(names, labels, outdoors=outdoors), "auto")

    def _segment_level(
        self,
        number: int,
        level: LevelFloor,
        settings: RoomSettings,
        overhead: Overhead,
        edge: Bool,
    ) -> Int32:
        lattice, least = overhead.columns.lattice, settings.min_area
        open_cells, size = self._open[number], lattice.cell_size
        if settings.door_width != "auto":
            return segment_rooms(open_cells, size, settings.door_width, least, level.floor, edge)
        known = overhead.holes[number], self._spaces, edge
        rooms, close = segment_by_gaps(open_cells, size, least, level.floor, *known)
        if close:
            self.warnings.append(_describe_close(close, number, lattice))
        return rooms

    def number(self) -> tuple[list[RoomIndex], list[list[NamedRoom]]]:
        """Number the rooms of each level from 1, by their first cells; also list them so."""
        index, rooms = [], []
        for level, owner in enumerate(self._owner):
            order = labels_in_order(owner)
            if len(order) > MAX_ROOMS:
                raise SceneError(
                    f"expected at most {MAX_ROOMS} rooms on a level, got {len(order)} on level "
                    f"{level}: raise `rooms.min_area` or `rooms.door_width`"
                )
            number = np.zeros(len(self._rooms) + 1, dtype=np.uint16)
            number[order] = np.arange(1, len(order) + 1)
            index.append(number[owner])
            rooms.append([self._rooms[k - 1] for k in order])
        return index, rooms


def _describe_close(close: Sequence[CloseCall], level: int, lattice: Lattice) -> str:
    """The warning of openings that might as well have been taken the other way."""
    x0, _, _, y1 = lattice.bounds
    size = lattice.cell_size
    listed = [
        f"{call.width:.1f} m at ({x0 + (call.cell[1] + 0.5) * size:.1f}, "
        f"{y1 - (call.cell[0] + 0.5) * size:.1f}) {'parts' if call.parts else 'joins'}"
        for call in close[:LISTED]
    ]
    more = f", and {len(close) - LISTED} more" if close[LISTED:] else ""
    return (
        f"openings of rooms on level {level} that were a close call: {', '.join(listed)}{more}; "
        "`rooms.door_width` in metres decides by the width alone, `rooms.polygons` draws rooms"
    )
