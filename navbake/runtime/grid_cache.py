"""What a `PathFinder` works out of its grid once and keeps for all of its parts."""

from functools import cached_property

import numpy as np

from navbake.navgrid.cells import check_level
from navbake.navgrid.grid import NavGrid
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.paths.door_map import DoorMap, map_doors
from navbake.runtime.paths.search import Search
from navbake.runtime.places.island_map import IslandMap, map_islands
from navbake.runtime.places.room_map import RoomMap, map_rooms
from navbake.types import Bool


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
            corners = search.graph.moves if search.cut_corners else None
            self._islands = (search.version, map_islands(search.flat, corners))
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
