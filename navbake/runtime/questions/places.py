"""Questions about single places: can an agent stand there, what is near, what is in sight."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import Cell
from navbake.runtime.places.navigable import MAX_DROP, is_navigable
from navbake.runtime.places.obstacle import Obstacle, nearest_obstacle
from navbake.runtime.places.sight import Sight, line_of_sight
from navbake.runtime.places.snap import snap_to
from navbake.runtime.places.step import try_step
from navbake.runtime.places.top_down import draw_top_down
from navbake.runtime.questions.regions import RegionQuestions
from navbake.types import Bool, Float


class PlaceQuestions(RegionQuestions):
    """Places where an agent can stand, and what is round them."""

    def is_navigable(
        self, position: ArrayLike, *, level: int | None = None, max_drop: float = MAX_DROP
    ) -> bool:
        """Whether an agent can stand at a position.

        It can where the cell is free and its floor is at most `max_drop` below the position [m].
        """
        found = is_navigable(self._cache.flat, position, level, max_drop)
        if found.ndim:
            raise QueryError("expected one position: ask are_navigable for many")
        return bool(found)

    def are_navigable(
        self, positions: ArrayLike, *, level: int | None = None, max_drop: float = MAX_DROP
    ) -> Bool:
        """`is_navigable` of each of many positions, shape (..., 3); shape (...), bool."""
        return is_navigable(self._cache.flat, positions, level, max_drop)

    def cell_at(self, position: ArrayLike, *, level: int | None = None) -> Cell | None:
        """The cell that a position is in; see `navbake.navgrid.cells.cell_at`."""
        cell = self._cache.flat.cell_at(position, level)
        return None if cell is None else self._cache.flat.cell(cell)

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
    ) -> Float | None:
        """Find the nearest place where an agent can stand.

        Where the position's own cell is allowed, and its floor is at most 0.5 m below, that is
        the position itself, put on the floor. Else it is the centre of a cell: of the one whose
        centre is the nearest on the map on the position's level, or in space on any level.

        Args:
            position: world position [m].
            same_level: stay on its level. A position that is on none is snapped to the nearest
                floor in space.
            same_room: stay in its room; None where it is in none.
            room: go to this room, by id or name.
            island: go to this island, by its number.
            in_sight: nothing may stand between, such as a wall. The position may be in something:
                then the line has to come out of it without leaving its room.
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
            self._cache.flat,
            position,
            self._cache.allowed(room=room, island=island),
            level=level,
            same_level=same_level,
            sight=Sight(~self.occupied, self.rooms.number) if in_sight else None,
            max_distance=max_distance,
        )

    def try_step(
        self, start: ArrayLike, end: ArrayLike, *, slide: bool = True, level: int | None = None
    ) -> Float:
        """Move straight from a position towards another, and stop where cells are not free.

        The way runs over the map from cell to cell, over the edge that it meets, so no wall is
        too thin for it. Steps are at most `traversable_floor_height` high; links lead to other
        levels.

        Sliding goes on from where the straight way ends, to the point that is the nearest to the
        end among those that a walk leads to which is no longer than what is left of the way. So
        it also gets along walls that are not parallel to the cells.

        A way may end anywhere in a free cell, so up to half a cell nearer to obstacles than at
        its centre.

        Args:
            start: world x, y, z [m], where an agent can stand.
            end: world x, y, z [m]; its z is ignored.
            slide: whether to slide.

        Returns:
            World x, y and floor z [m] of where the way ends, shape (3,), float64.

        Raises:
            QueryError: no agent can stand at the start.
        """
        return try_step(self._cache.flat, start, end, slide, level)

    def line_of_sight(self, a: ArrayLike, b: ArrayLike, *, level: int | None = None) -> bool:
        """Whether the straight line between two positions meets nothing that is occupied.

        The line runs over the map, from cell to cell, and through a corner of four where one of
        the two beside it is clear. It changes levels where links lead; heights are not compared.
        False also where one of the two is beside the grid, or in something itself.
        """
        return line_of_sight(self._cache.flat, ~self.occupied, a, b, level)

    def nearest_obstacle(
        self, position: ArrayLike, *, level: int | None = None, max_distance: float = math.inf
    ) -> Obstacle | None:
        """Find the nearest point of an occupied cell's square on the position's level.

        Beyond the edge of the grid nothing is known, and nothing counts. Where the level ends and
        another goes on, as at the top of stairs, that is no obstacle: the other one counts where
        its floor is less than the agent's height, less a step, above or below, and its own isn't.

        Args:
            position: world position [m], in a cell of the grid.
            max_distance: farther obstacles are ignored [m], >= 0.

        Returns:
            None where there is none so near; distance 0 within an occupied cell.
        """
        flat, height = self._cache.flat, self.grid.agent_height
        return nearest_obstacle(
            flat, self.occupied, position, height, level=level, max_distance=max_distance
        )

    def clearance(
        self, position: ArrayLike, *, level: int | None = None, max_distance: float = math.inf
    ) -> float:
        """Distance to the nearest obstacle [m], at most `max_distance`."""
        found = self.nearest_obstacle(position, level=level, max_distance=max_distance)
        return max_distance if found is None else found.distance

    def top_down(self, level: int, metres_per_pixel: float | None = None) -> NDArray[np.uint8]:
        """Draw where on a level an agent can stand, as an array.

        The first row is the largest y, the first column the smallest x, as in the grid's arrays.

        Args:
            level: which level, 0 is the lowest.
            metres_per_pixel: [m], > 0; a pixel a cell unless given. A pixel shows the cell that
                its middle is in.

        Returns:
            Red, green and blue, shape (rows, cols, 3), uint8, in the colours of ``navbake plot``:
            free, blocked, no floor.

        Raises:
            QueryError: `metres_per_pixel` is not a number > 0, or the picture would be too large.
        """
        return draw_top_down(self._cache.flat, level, metres_per_pixel)
