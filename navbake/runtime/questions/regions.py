"""Questions about islands and rooms."""

import math

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.runtime.paths.goals import cells_named
from navbake.runtime.places.island_map import IslandMap
from navbake.runtime.places.room_map import RoomMap
from navbake.runtime.places.snap import nearest_on_level
from navbake.runtime.questions.base import Questions
from navbake.types import Bool, Float


class RegionQuestions(Questions):
    """Islands, rooms, and how far the grid goes."""

    @property
    def rooms(self) -> RoomMap:
        """The rooms of the grid and of each cell."""
        return self._cache.rooms

    @property
    def islands(self) -> IslandMap:
        """The connected parts of the cells that are free now: ``count``, ``areas`` [m²]."""
        return self._cache.islands

    @property
    def occupied(self) -> Bool:
        """Where something stands now or there is no floor, by flat id, shape (n,), bool."""
        return self._cache.occupied

    @property
    def navigable_area(self) -> float:
        """Area of all free cells [m²]."""
        return float(self.islands.areas.sum())

    @property
    def bounds(self) -> tuple[Float, Float]:
        """Lower and upper corner of the box round all free cells and their floors, world [m]."""
        flat = self._cache.flat
        cells = np.flatnonzero(flat.free)
        if not len(cells):
            raise QueryError(f"no cell of {self.grid.scene_id!r} is free: it has no bounds")
        centers = flat.positions(cells)
        half = (flat.layout.cell_size[flat.level_of(cells)] / 2)[:, None] * [1.0, 1.0, 0.0]
        return (centers - half).min(axis=0), (centers + half).max(axis=0)

    def island_at(self, position: ArrayLike, *, level: int | None = None) -> int | None:
        """Number of the island of a position, from 1, the largest; None where it isn't free."""
        cell = self._cache.flat.cell_at(position, level)
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
        cell = self._cache.flat.cell_at(position, level)
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
        flat, number = self._cache.flat, self.rooms.number
        cell = nearest_on_level(flat, position, number > 0, level=level, max_distance=max_distance)
        return None if cell is None else self.rooms.id_of(int(number[cell]))

    def room_of(self, name: str) -> str | None:
        """The id of the room that most cells of an object are in, by its name; None for none."""
        numbers = self.rooms.number[cells_named(self.grid, self._cache.flat, name)]
        counts = np.bincount(numbers[numbers > 0], minlength=1)
        return self.rooms.id_of(int(np.argmax(counts)))
