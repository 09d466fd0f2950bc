"""Rooms: which one each cell belongs to, and the table of all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.floors.levels import Floors
from navbake.baker.rooms import openings
from navbake.baker.rooms.openings import Opening, RoomIndex, RoomKey
from navbake.baker.rooms.segmentation import labels_in_order, segment_rooms, share_rest
from navbake.baker.rooms.sources import MarkedRooms, RoomMarkers
from navbake.baker.rooms.table import NamedRoom, describe_rooms, name_neighbours
from navbake.baker.scene.scene import Scene
from navbake.config.rooms import RoomSettings
from navbake.config.settings import AgentSettings
from navbake.errors import SceneError
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import Room
from navbake.types import Bool, Float, Int

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
        warnings: what the user should know, one line each.
    """

    index: list[RoomIndex]
    table: list[Room]
    openings: list[Opening]
    links: list[tuple[RoomKey, RoomKey]]
    lattice: Lattice
    warnings: list[str]

    def room_at(self, level: int, cell: int) -> str | None:
        """The id of the room of a level's cell, counted on the whole lattice; None for none."""
        return self._ids.get((level, int(self.index[level].flat[cell])))

    @cached_property
    def _ids(self) -> dict[RoomKey, str]:
        return {(room.level, room.index): room.id for room in self.table}

    def with_doors(self, doors: Mapping[str, Sequence[Int]]) -> Rooms:
        """The same rooms, with the doors between neighbours in the table; see `match_doors`."""
        named = openings.match_doors(self.openings, doors, self.lattice)
        return replace(self, table=name_neighbours(self.table, self.openings, self.links, named))


def find_rooms(
    scene: Scene,
    columns: Columns,
    floors: Floors,
    walls: Sequence[Bool],
    settings: RoomSettings,
    agent: AgentSettings,
) -> Rooms:
    """Find the room that each cell belongs to.

    A cell's room is that of the first source that has one for it. Cells without a floor, and
    cells that a wall stands in, belong to none. On each level, rooms are numbered by their
    first cells in reading order: from large y to small, from small x to large. A room that
    reaches over several levels is one room on each.

    Raises:
        ConfigError: a polygon names a level that does not exist.
        SceneError: a level has more than 65,535 rooms.
    """
    levels, lattice = floors.levels, columns.lattice
    open_cells = [~np.isnan(level.floor) & ~wall for level, wall in zip(levels, walls, strict=True)]
    assignment = _Assignment(open_cells)
    markers = RoomMarkers(scene, columns, levels, settings, agent)
    for source in settings.sources:
        if source == "auto":
            assignment.segment([level.floor for level in levels], settings, lattice.cell_size)
        else:
            assignment.add(markers.mark(source), source)
    index, named = assignment.number()
    found = openings.find_openings(index, floors, agent.traversable_floor_height)
    links = openings.find_room_links(index, floors)
    table = name_neighbours(describe_rooms(index, named, floors, lattice), found, links, {})
    return Rooms(index, table, found, links, lattice, assignment.warnings)


class _Assignment:
    """The room of each cell as the sources add rooms; the first source that has one keeps it."""

    def __init__(self, open_cells: Sequence[Bool]) -> None:
        self._open = open_cells
        self._owner = [np.zeros(mask.shape, dtype=np.int32) for mask in open_cells]
        self._rooms: list[NamedRoom] = []  # owners count from 1
        self.warnings: list[str] = []

    def add(self, marked: MarkedRooms, source: str) -> None:
        """Give the cells that have no room yet to the rooms of a source."""
        self.warnings += marked.warnings
        if not marked.names:
            return
        for open_cells, owner, label in zip(self._open, self._owner, marked.labels, strict=True):
            fresh = np.where(open_cells & (owner == 0), label, 0)
            number = np.zeros(len(marked.names) + 1, dtype=np.int32)
            for k in np.flatnonzero(np.bincount(fresh.ravel())[1:]):
                self._rooms.append(NamedRoom(marked.names[k], source))
                number[k + 1] = len(self._rooms)
            owner += number[fresh]

    def segment(self, floors: Sequence[Float], settings: RoomSettings, cell_size: float) -> None:
        """Divide the remaining cells at gaps no wider than a door; see `share_rest`."""
        labels = []
        names: list[str | None] = []
        for number, open_cells in enumerate(self._open):
            widths = settings.door_width, settings.min_area
            segment = segment_rooms(open_cells, cell_size, *widths, floors[number])
            owner = self._owner[number]
            if owner.any():
                least = settings.min_area / cell_size**2
                self._owner[number], segment = share_rest(owner, segment, least)
            labels.append(np.where(segment > 0, segment + len(names), 0))
            names += [None] * int(segment.max(initial=0))
        self.add(MarkedRooms(names, labels), "auto")

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
