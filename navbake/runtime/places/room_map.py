"""The rooms of a grid by name, and the room of each cell."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING

import numpy as np

from navbake.errors import QueryError
from navbake.navgrid.rooms import Room, measure_rooms
from navbake.types import Int, Int32

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid

MAX_LISTED = 12


@dataclass(frozen=True, eq=False)
class RoomMap:
    """Rooms and their cells.

    A room has a number, from 1 in the order of the grid's `rooms`; 0 is no room.

    Attributes:
        scene_id: the grid's, for messages.
        rooms: entries of the grid's `rooms`; number n is ``rooms[n - 1]``.
        number: of each cell, by flat id, shape (n,), int32.
    """

    scene_id: str | None
    rooms: list[Room]
    number: Int32

    def find(self, name: str) -> int:
        """The number of a room.

        Args:
            name: its id, or its name where only one room has it.

        Raises:
            QueryError: there is none, or several rooms have the name.
        """
        by_id = {room.id: number for number, room in enumerate(self.rooms, start=1)}
        if isinstance(name, str) and name in by_id:
            return by_id[name]
        named = [room.id for room in self.rooms if room.name and room.name == name]
        if len(named) == 1:
            return by_id[named[0]]
        if named:
            raise QueryError(
                f"{len(named)} rooms in {self.scene_id!r} have the name {name!r}: expected one of "
                f"the ids {', '.join(named)}"
            )
        raise QueryError(f"no room {name!r} in {self.scene_id!r}: {self._known(name)}")

    def id_of(self, number: int) -> str | None:
        """The id of a room by its number; None for 0."""
        return self.rooms[number - 1].id if number else None

    def cells(self, name: str) -> Int:
        """Flat ids of the cells of a room, those that something stands in included.

        Args:
            name: see `find`.

        Returns:
            Ascending, shape (n,), int64.

        Raises:
            QueryError: see `find`.
        """
        return np.flatnonzero(self.number == self.find(name))

    def _known(self, name: object) -> str:
        names = [room.id for room in self.rooms]
        names += [room.name for room in self.rooms if room.name]
        near = get_close_matches(str(name), names, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        listed = list(dict.fromkeys(names))
        more = f", and {len(listed) - MAX_LISTED} more" if len(listed) > MAX_LISTED else ""
        return f"{hint}it has {', '.join(listed[:MAX_LISTED]) or 'none'}{more}"


def map_rooms(grid: NavGrid) -> RoomMap:
    """Lay out the rooms of a grid.

    Args:
        grid: a grid of one or several levels. Rooms that no table tells of go by
            ``level:index``.

    Raises:
        FormatError: the file's room table is broken.
    """
    rooms = list(grid.rooms)
    parts = []
    for number, level in enumerate(grid.levels):
        index = level.room_index
        numbers = np.zeros(int(index.max(initial=0)) + 1, dtype=np.int32)
        for position, room in enumerate(rooms, start=1):
            if room.level == number and room.index < len(numbers):
                numbers[room.index] = position
        if ((numbers[index] == 0) & (index > 0)).any():
            for room in measure_rooms(level, number):
                if not numbers[room.index]:
                    rooms.append(room)
                    numbers[room.index] = len(rooms)
        parts.append(numbers[index].ravel())
    return RoomMap(grid.scene_id, rooms, np.concatenate(parts))
