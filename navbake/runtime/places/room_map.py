"""The rooms of a grid by name, and the room of each cell."""

from dataclasses import dataclass

import numpy as np

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.rooms import Room, measure_rooms
from navbake.types import Int, Int32


@dataclass(frozen=True, eq=False)
class RoomMap:
    """Rooms by number, from 1 in the order of `rooms`; 0 is no room.

    Attributes:
        scene_id: the grid's, for messages.
        rooms: those of the grid, then those that only its cells name.
        number: of each cell, by flat id, shape (n,), int32.
    """

    scene_id: str | None
    rooms: list[Room]
    number: Int32

    def find(self, name: str) -> int:
        """The number of a room by its id, or by its name where only one room has it.

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
        names = [*by_id, *(room.name for room in self.rooms if room.name)]
        raise QueryError(f"no room {name!r} in {self.scene_id!r}: {suggest(name, names)}")

    def id_of(self, number: int) -> str | None:
        """The id of a room by its number; None for 0."""
        return self.rooms[number - 1].id if number else None

    def cells(self, name: str) -> Int:
        """Flat ids of the cells of a room, see `find`, free or not; ascending, int64."""
        return np.flatnonzero(self.number == self.find(name))


def map_rooms(grid: NavGrid) -> RoomMap:
    """Number the rooms of a grid; those that its table leaves out get the id ``level:index``."""
    rooms = list(grid.rooms)
    parts = []
    for number, level in enumerate(grid.levels):
        index = level.room_index
        numbers = np.zeros(int(index.max(initial=0)) + 1, dtype=np.int32)  # by index on the level
        for position, room in enumerate(rooms, start=1):
            if room.level == number and room.index < len(numbers):
                numbers[room.index] = position
        # measuring rooms is slow: only where cells name a room that the table lacks
        if ((numbers[index] == 0) & (index > 0)).any():
            for room in measure_rooms(level, number):
                if not numbers[room.index]:
                    rooms.append(room)
                    numbers[room.index] = len(rooms)
        parts.append(numbers[index].ravel())
    return RoomMap(grid.scene_id, rooms, np.concatenate(parts))
