"""Rooms, doors and islands of a grid by flat id."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.rooms import Room, measure_rooms
from navbake.runtime.flat_grid import FlatGrid
from navbake.types import Float, Int, Int32

arrays = lazy("navbake.runtime.kernels.arrays")  # numba loads slowly
connect = lazy("navbake.navgrid.kernels.connect")


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


DoorMap = dict[int, list[str]]
"""The ids of the doors of each cell that is in one, by flat id."""


def map_doors(grid: NavGrid, flat: FlatGrid) -> DoorMap:
    """Find the cells that each door blocks when closed or as it stands.

    In files of other programs, the user data of the cells name the doors.
    """
    found: DoorMap = {}
    start = flat.layout.start.tolist()
    for door in grid.doors:
        states = (door.cells_in(state, flat.num_levels) for state in ("closed", door.state))
        cells = [start[k] + ids for by_level in states for k, ids in enumerate(by_level)]
        for cell in np.unique(np.concatenate(cells)).tolist():
            found.setdefault(cell, []).append(door.id)
    if not grid.doors and not grid.navbake:
        for level, part in enumerate(grid.levels):
            for cell, entry in part.user_data.items():
                if isinstance(stored := entry.get("doors"), list):
                    names = [name for name in stored if isinstance(name, str)]
                    found[start[level] + cell] = names
    return found


def doors_on(doors: DoorMap, cells: Int) -> list[str]:
    """The doors that a route goes through, in order; a door that is entered again is repeated."""
    passed: list[str] = []
    current: Iterable[str] = ()
    for cell in cells.tolist():
        here = doors.get(cell, ())
        passed += [name for name in here if name not in current]
        current = here
    return passed


@dataclass(frozen=True, eq=False)
class IslandMap:
    """The connected parts of a grid as it is now, by number from 1, the one of the most cells.

    Attributes:
        number: of each cell, by flat id, shape (n,), int32; 0 where it isn't free.
        areas: of each island [m²], shape (count + 1,), float64; 0 for number 0.
    """

    number: Int32
    areas: Float

    @property
    def count(self) -> int:
        """Number of islands."""
        return len(self.areas) - 1

    def check(self, island: int) -> int:
        """Raise QueryError for the number of an unknown island."""
        if isinstance(island, int | np.integer) and 1 <= island <= self.count:
            return int(island)
        there_are = f"1 to {self.count}, 1 the largest" if self.count else "none"
        raise QueryError(f"no island {island!r}: there are {there_are}")


def map_islands(flat: FlatGrid, moves: NDArray[np.uint8] | None = None) -> IslandMap:
    """Find the islands of a grid, by the rule of `navbake.navgrid.islands.find_islands`.

    Where corners may be cut, the diagonal ones among the `moves` of each cell, see
    `navbake.runtime.kernels.routes`, join cells that nothing else does.
    """
    layout, floors = flat.layout, flat.floors
    links = [np.stack(flat.link_ends(), axis=1)]
    if moves is not None:
        for bit, across in ((arrays.SOUTH_WEST, -1), (arrays.SOUTH_EAST, 1)):
            cells = np.flatnonzero(moves & bit)
            others = cells + layout.width[flat.level_of(cells)] + across
            links.append(np.stack([cells, others], axis=1))
    number, sizes = connect.label_islands(
        layout.start, layout.width, flat.free, floors.z, floors.max_step, np.concatenate(links)
    )
    # one size of cells on all levels is the rule; else each level's cells count by their own area
    areas = sizes * layout.cell_size[0] ** 2
    if len(set(layout.cell_size)) > 1:
        areas = np.zeros(len(sizes))
        for level, size in enumerate(layout.cell_size):
            of_level = number[flat.cells_of(level)]
            areas += np.bincount(of_level, minlength=len(sizes)) * size**2
        areas[0] = 0.0
    return IslandMap(number, areas)
