"""What a `PathFinder` works out of its grid once and keeps: searches, rooms, doors, islands."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.cells import check_level
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.rooms import Room, measure_rooms
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int, Int32

# Functions import kernels when they run: numba takes long to load.


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
    from navbake.navgrid.kernels.connect import label_islands
    from navbake.runtime.kernels.arrays import SOUTH_EAST, SOUTH_WEST

    layout, floors = flat.layout, flat.floors
    links = [np.stack(flat.link_ends(), axis=1)]
    for bit, across in ((SOUTH_WEST, -1), (SOUTH_EAST, 1)):
        cells = np.flatnonzero(moves & bit) if moves is not None else np.empty(0, dtype=np.int64)
        links.append(np.stack([cells, cells + layout.width[flat.level_of(cells)] + across], axis=1))
    number, sizes = label_islands(
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


class GridCache:
    """A grid with what follows from it, each worked out when it is first asked for.

    What blocks change (the search, islands, occupied cells) is brought up to date when it is
    asked for again; rooms and doors stay.
    """

    def __init__(self, grid: NavGrid, *, cut_corners: bool = False) -> None:
        self.grid = grid
        self._search = Search(grid, cut_corners=cut_corners)
        self._occupied: tuple[int, Bool] | None = None  # each with the search's version then
        self._islands: tuple[int, IslandMap] | None = None

    @property
    def search(self) -> Search:
        """The cells and the steps between them, with what is blocked now."""
        self._search.update()
        return self._search

    @property
    def flat(self) -> FlatGrid:
        """The cells, with what is blocked now."""
        return self.search.flat

    @cached_property
    def rooms(self) -> RoomMap:
        """The rooms of the grid and of each cell."""
        return map_rooms(self.grid)

    @cached_property
    def doors(self) -> DoorMap:
        """The doors that each cell is in."""
        return map_doors(self.grid, self._search.flat)

    @property
    def islands(self) -> IslandMap:
        """The connected parts of the cells that are free now."""
        search = self.search
        if self._islands is None or self._islands[0] != search.version:
            moves = search.graph.moves if search.cut_corners else None
            self._islands = (search.version, map_islands(search.flat, moves))
        return self._islands[1]

    @property
    def occupied(self) -> Bool:
        """Where something stands now or there is no floor, by flat id, shape (n,), bool.

        Something stands in a cell where it meets the cell's square, see `SceneGrid2D.solid`.
        In a file without ``occupancy``, where weights are infinite. What a larger radius takes
        from an agent is not occupied.
        """
        version = self.search.version
        if self._occupied is None or self._occupied[0] != version:
            occupied = np.concatenate([v.solid.ravel() != 0 for v in self.grid.levels])
            self._occupied = (version, occupied)
        return self._occupied[1]

    def allowed(
        self, *, level: int | None = None, room: str | None = None, island: int | None = None
    ) -> Bool:
        """The free cells that are on a level, in a room and on an island, by flat id."""
        flat = self.flat
        allowed = flat.free
        if level is not None:
            check_level(level, flat.num_levels)
            on_level = np.zeros_like(allowed)
            on_level[flat.cells_of(level)] = True
            allowed = allowed & on_level
        if room is not None:
            allowed = allowed & (self.rooms.number == self.rooms.find(room))
        if island is not None:
            allowed = allowed & (self.islands.number == self.islands.check(island))
        return allowed

    def home_island(self, position: ArrayLike, island: int | None) -> int:
        """The island of a free position; raises QueryError where another `island` is asked for."""
        home = int(self.islands.number[self.flat.free_cell_at(position)[1]])
        if island not in (None, home):
            raise QueryError(f"island {island} can't be reached: the position is on {home}")
        return home
