"""Finds places on a grid: where an agent can stand, how far from obstacles, in which room."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import Cell, check_level
from navbake.runtime.paths.search import Search
from navbake.runtime.places.island_map import IslandMap, map_islands
from navbake.runtime.places.locate import flat_cell, split_cell
from navbake.runtime.places.navigable import MAX_DROP, is_navigable
from navbake.runtime.places.obstacle import Obstacle, nearest_obstacle
from navbake.runtime.places.room_map import RoomMap, map_rooms
from navbake.runtime.places.sight import Sight, find_occupied, line_of_sight
from navbake.runtime.places.snap import nearest_on_level, snap_to
from navbake.runtime.places.step import try_step
from navbake.runtime.places.top_down import draw_top_down

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid

Floats = NDArray[np.float64]


class PlaceFinder:
    """Answers an agent's questions about places.

    Positions are world x, y, z [m], on the level of the nearest floor below; x, y will do on one
    level or with `level`. Every method raises QueryError where a position is none, or where there
    is no such level, room or island.

    Args:
        grid: a grid of one or several levels.
        cut_corners: let diagonal steps pass blocked corners.
    """

    def __init__(self, grid: NavGrid, *, cut_corners: bool = False) -> None:
        self.grid = grid
        self._search = Search(grid, cut_corners=cut_corners)
        self._rooms: RoomMap | None = None
        self._occupied: tuple[int, NDArray[np.bool_]] | None = None
        self._islands: tuple[int, IslandMap] | None = None

    @property
    def search(self) -> Search:
        """The cells, with what is blocked now."""
        self._search.update()
        return self._search

    @property
    def rooms(self) -> RoomMap:
        """The rooms of the grid and of each cell."""
        if self._rooms is None:
            self._rooms = map_rooms(self.grid)
        return self._rooms

    @property
    def islands(self) -> IslandMap:
        """The connected parts of the cells that are free now: ``count``, ``areas`` [m²]."""
        if self._islands is None or self._islands[0] != self.search.version:
            search = self.search
            corners = search.moves if search.cut_corners else None
            self._islands = (search.version, map_islands(search.walk, corners))
        return self._islands[1]

    @property
    def occupied(self) -> NDArray[np.bool_]:
        """Where something stands now or there is no floor, by flat id, shape (n,), bool."""
        version = self.search.version
        if self._occupied is None or self._occupied[0] != version:
            self._occupied = (version, find_occupied(self.grid))
        return self._occupied[1]

    @property
    def navigable_area(self) -> float:
        """Area of all free cells [m²]."""
        return float(self.islands.areas.sum())

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper corner of the box round all free cells and their floors, world [m]."""
        walk = self.search.walk
        cells = np.flatnonzero(walk.free)
        if not len(cells):
            raise QueryError(f"no cell of {self.grid.scene_id!r} is free: it has no bounds")
        centers = walk.positions(cells)
        half = (walk.cell_size[walk.level_of(cells)] / 2)[:, None] * [1.0, 1.0, 0.0]
        return (centers - half).min(axis=0), (centers + half).max(axis=0)

    def is_navigable(
        self, position: ArrayLike, *, level: int | None = None, max_drop: float = MAX_DROP
    ) -> bool:
        """Whether an agent can stand at a position; its floor is at most `max_drop` below [m]."""
        found = is_navigable(self.search.walk, position, level, max_drop)
        if found.ndim:
            raise QueryError("expected one position: ask are_navigable for many")
        return bool(found)

    def are_navigable(
        self, positions: ArrayLike, *, level: int | None = None, max_drop: float = MAX_DROP
    ) -> NDArray[np.bool_]:
        """`is_navigable` of each of many positions, shape (..., 3); shape (...), bool."""
        return is_navigable(self.search.walk, positions, level, max_drop)

    def cell_at(self, position: ArrayLike, *, level: int | None = None) -> Cell | None:
        """The cell that a position is in; see `navbake.runtime.places.locate.cell_at`."""
        cell = flat_cell(self.search.walk, position, level)
        return None if cell is None else split_cell(self.search.walk, cell)

    def snap(
        self,
        position: ArrayLike,
        *,
        level: int | None = None,
        same_level: bool = True,
        same_room: bool = False,
        room: str | None = None,
        island: int | None = None,
        in_sight: bool = False,
        max_distance: float = math.inf,
    ) -> Floats | None:
        """The nearest place where an agent can stand; see `navbake.runtime.places.snap.snap_to`.

        Args:
            position: world position [m].
            level: which level it is on.
            same_level: stay on its level.
            same_room: stay in its room; None where it is in none.
            room: go to this room, by id or name.
            island: go to this island, by its number.
            in_sight: nothing may stand between, such as a wall.
            max_distance: go no farther [m].

        Returns:
            World x, y and floor z [m], shape (3,); None where there is no such place.
        """
        if same_room:
            here = self.room_at(position, level=level)
            if here is None or (
                room is not None and self.rooms.find(room) != self.rooms.find(here)
            ):
                return None
            room = here
        return snap_to(
            self.search.walk,
            position,
            self._allowed(room=room, island=island),
            level=level,
            same_level=same_level,
            sight=Sight(~self.occupied, self.rooms.number) if in_sight else None,
            max_distance=max_distance,
        )

    def try_step(
        self, start: ArrayLike, end: ArrayLike, *, slide: bool = True, level: int | None = None
    ) -> Floats:
        """Where a straight move ends; see `navbake.runtime.places.step.try_step`."""
        return try_step(self.search.walk, start, end, slide=slide, level=level)

    def line_of_sight(self, a: ArrayLike, b: ArrayLike, *, level: int | None = None) -> bool:
        """Whether nothing stands between; see `navbake.runtime.places.sight.line_of_sight`."""
        return line_of_sight(self.search.walk, ~self.occupied, a, b, level)

    def nearest_obstacle(
        self, position: ArrayLike, *, level: int | None = None, max_distance: float = math.inf
    ) -> Obstacle | None:
        """The nearest obstacle, its distance and point; None for none within `max_distance` [m].

        See `navbake.runtime.places.obstacle.nearest_obstacle`.
        """
        return nearest_obstacle(
            self.search.walk,
            self.occupied,
            position,
            self.grid.agent_height,
            level=level,
            max_distance=max_distance,
        )

    def clearance(
        self, position: ArrayLike, *, level: int | None = None, max_distance: float = math.inf
    ) -> float:
        """Distance to the nearest obstacle [m], at most `max_distance`."""
        found = self.nearest_obstacle(position, level=level, max_distance=max_distance)
        return max_distance if found is None else found.distance

    def island_at(self, position: ArrayLike, *, level: int | None = None) -> int | None:
        """Number of the island of a position, from 1, the largest; None where it isn't free."""
        cell = flat_cell(self.search.walk, position, level)
        return None if cell is None else int(self.islands.number[cell]) or None

    def same_island(self, a: ArrayLike, b: ArrayLike, *, level: int | None = None) -> bool:
        """Whether both positions are on one island, so that a path joins them."""
        one, other = (self.island_at(p, level=level) for p in (a, b))
        return one is not None and one == other

    def island_area(self, island: int) -> float:
        """Area of an island [m²]."""
        return float(self.islands.areas[self.islands.check(island)])

    def room_at(self, position: ArrayLike, *, level: int | None = None) -> str | None:
        """The id of the room that a position is in, None for none."""
        cell = flat_cell(self.search.walk, position, level)
        return None if cell is None else self.rooms.id_of(int(self.rooms.number[cell]))

    def same_room(self, a: ArrayLike, b: ArrayLike, *, level: int | None = None) -> bool:
        """Whether both positions are in one room."""
        one, other = (self.room_at(p, level=level) for p in (a, b))
        return one is not None and one == other

    def room_near(
        self, position: ArrayLike, max_distance: float = math.inf, *, level: int | None = None
    ) -> str | None:
        """The id of the room whose cell is the nearest on the level, None for none so near [m]."""
        here = self.room_at(position, level=level)
        if here is not None:
            return here
        number = self.rooms.number
        cell = nearest_on_level(
            self.search.walk, position, number > 0, level=level, max_distance=max_distance
        )
        return None if cell is None else self.rooms.id_of(int(number[cell]))

    def room_of(self, name: str) -> str | None:
        """The id of the room that most cells of an object are in, by its name; None for none."""
        from navbake.runtime.paths.goals import cells_named

        start = self.search.walk.start
        cells = [start[k] + c for k, c in enumerate(cells_named(self.grid, name))]
        numbers = self.rooms.number[np.concatenate(cells)]
        counts = np.bincount(numbers[numbers > 0], minlength=1)
        return self.rooms.id_of(int(np.argmax(counts)))

    def top_down(self, level: int, metres_per_pixel: float | None = None) -> NDArray[np.uint8]:
        """A picture of a level, (rows, cols, 3); see `.places.top_down.draw_top_down`."""
        return draw_top_down(self.search.walk, level, metres_per_pixel)

    def _allowed(
        self, *, level: int | None = None, room: str | None = None, island: int | None = None
    ) -> NDArray[np.bool_]:
        """The free cells that are on a level, in a room and on an island, by flat id."""
        walk = self.search.walk
        allowed = walk.free
        if level is not None:
            check_level(level, walk.num_levels)
            on_level = np.zeros_like(allowed)
            on_level[walk.start[level] : walk.start[level + 1]] = True
            allowed = allowed & on_level
        if room is not None:
            allowed = allowed & (self.rooms.number == self.rooms.find(room))
        if island is not None:
            allowed = allowed & (self.islands.number == self.islands.check(island))
        return allowed
