"""Plans paths on a grid, and answers questions about places on it."""

import math
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import Cell
from navbake.navgrid.grid import NavGrid
from navbake.runtime.grid_cache import GridCache
from navbake.runtime.many import ManyPlaces
from navbake.runtime.paths.goals import Goal, cells_named
from navbake.runtime.paths.path import Path
from navbake.runtime.paths.planner import Planner
from navbake.runtime.paths.search import Search
from navbake.runtime.paths.why_not import why_not
from navbake.runtime.places.island_map import IslandMap
from navbake.runtime.places.navigable import MAX_DROP, is_navigable
from navbake.runtime.places.obstacle import Obstacle, nearest_obstacle
from navbake.runtime.places.room_map import RoomMap
from navbake.runtime.places.sample import Pose, cells_near, draw_places, draw_pose
from navbake.runtime.places.sight import Sight, line_of_sight
from navbake.runtime.places.snap import nearest_on_level, snap_to
from navbake.runtime.places.step import try_step
from navbake.runtime.places.top_down import draw_top_down
from navbake.types import Bool, Float


class PathFinder:
    """Answers an agent's questions about ways through a grid, and about places on it.

    A path steps over the edges and corners of free cells and over links between levels. Floors of
    neighbours differ by at most the grid's `traversableFloorHeight`. A step costs its length [m]
    times the weight of the cell that it leads to.

    Goals are a position, several of them (the one that is the cheapest to reach counts),
    ``room:NAME`` with a room's id or name, or ``object:NAME`` with a name of the user data (the
    free cells next to it). Positions are world x, y, z [m], on the level of the nearest floor
    below. With `level`, positions are on that level (0 is the lowest) and z is ignored. x, y are
    enough with `level`, or on a grid of one level. Every method raises QueryError where a
    position is not valid, or where there is no such level, room, object or island.

    One object serves one thread at a time.

    Args:
        grid: a grid of one or several levels. What is written into its arrays later is not seen;
            what `grid.block` blocks is.
        cut_corners: let diagonal steps pass blocked corners.

    Raises:
        QueryError: a weight is negative.
    """

    def __init__(self, grid: NavGrid, *, cut_corners: bool = False) -> None:
        self._cut_corners = cut_corners
        self.use(grid)

    def use(self, grid: NavGrid) -> None:
        """Answer about another grid from now on, as after `Baker.update`.

        What was planned and kept for the last one is forgotten.

        Raises:
            QueryError: a weight is negative.
        """
        cache = GridCache(grid, cut_corners=self._cut_corners)
        self.__dict__.pop("many", None)
        self.grid, self._cache = grid, cache
        self._planner = Planner(cache)

    # --- paths -----------------------------------------------------------------------------

    def find_path(
        self, start: ArrayLike, goal: Goal, *, level: int | None = None, smooth: bool = True
    ) -> Path | None:
        """Find the cheapest path.

        Args:
            start: world position [m].
            goal: see `PathFinder`.
            smooth: pull the path straight where that stays free; else it runs through the
                cells' centres. It begins and ends at the positions themselves unless they are
                nearer to obstacles than the agent may be.

        Returns:
            None where there is no path: `why_not` tells the reason.
        """
        return self._planner.find_path(start, goal, level, smooth=smooth)

    def why_not(self, start: ArrayLike, goal: Goal, *, level: int | None = None) -> str | None:
        """Say why there is no path: in one sentence, with positions and figures.

        It names a start or goal that isn't free, and the nearest cell that is; or else the islands
        of both, how near these come, and the first of these that is between them: cells that are
        blocked for now, doors, a gap that is too narrow for the agent (known of inflated grids),
        steps between levels that can't be taken, the names of what stands there.

        Args:
            start: world position [m].
            goal: see `PathFinder`.

        Returns:
            None if there is a path.
        """
        origin, target = self._planner.find_ends(start, goal, level)
        return why_not(self._cache, np.asarray(start, dtype=np.float64), origin, target)

    def distance_field(
        self, goal: Goal, *, level: int | None = None, weighted: bool = True
    ) -> list[Float]:
        """Find what the cheapest path from every cell to the goal costs.

        Args:
            goal: see `PathFinder`.
            weighted: count steps by their weights, as `find_path` does; else by their lengths
                alone, so that the shortest path counts [m].

        Returns:
            One array a level, shape (height, width), float64, inf where no path leads to the
            goal; read-only. The last few goals' fields are kept, so asking again costs nothing.
        """
        field, flat = self._planner.field(goal, level, weighted=weighted), self._cache.flat
        return [field[flat.cells_of(k)].reshape(v.shape) for k, v in enumerate(self.grid.levels)]

    def distances(
        self, starts: ArrayLike, goal: Goal, *, level: int | None = None, weighted: bool = True
    ) -> Float:
        """Find what the cheapest paths from many starts to the goal cost.

        Args:
            starts: world positions [m], shape (..., 3).
            goal: see `PathFinder`.
            weighted: see `distance_field`.

        Returns:
            Shape (...), float64; inf where there is no path.
        """
        cells = self._cache.flat.cells_at(starts, level)
        field = self._planner.field(goal, level, weighted=weighted)
        return np.where(cells >= 0, field[cells], np.inf)

    # --- places ----------------------------------------------------------------------------

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

    # --- random places ---------------------------------------------------------------------

    def random_point(
        self,
        rng: np.random.Generator | None = None,
        count: int | None = None,
        *,
        level: int | None = None,
        room: str | None = None,
        island: int | None = None,
        reachable_from: ArrayLike | None = None,
        anywhere: bool = False,
    ) -> Float:
        """Draw places where an agent can stand, each as likely as its area has it.

        Args:
            rng: draws them; another one each time if None. One with a seed repeats itself.
            count: how many, with repetition; one unless given.
            level: on this level.
            room: in this room, by id or name.
            island: on this island; 1 is the largest. On all of them unless given.
            reachable_from: where a path leads to from this world position [m].
            anywhere: draw points all over the cells, so up to half a cell nearer to obstacles;
                else the cells' centres, where the agent's radius fits.

        Returns:
            World x, y and floor z [m], shape (3,) or (count, 3), float64.

        Raises:
            QueryError: there is no such place, no agent can stand at the position, or `rng` is
                not a generator.
        """
        if reachable_from is not None:
            home = int(self.islands.number[self._cache.flat.free_cell_at(reachable_from)[1]])
            if island not in (None, home):
                raise QueryError(f"island {island} can't be reached: the position is on {home}")
            island = home
        cells = np.flatnonzero(self._cache.allowed(level=level, room=room, island=island))
        limits = {"level": level, "room": room, "island": island}
        return draw_places(self._cache, cells, rng, count, anywhere, limits)

    def random_point_near(
        self,
        rng: np.random.Generator | None,
        position: ArrayLike,
        max_distance: float,
        count: int | None = None,
        *,
        min_distance: float = 0.0,
        straight: bool = False,
        room: str | None = None,
        level: int | None = None,
        anywhere: bool = False,
    ) -> Float:
        """Draw places near a position.

        Distances are those of the shortest path from it; or straight on the map of its level,
        through walls as well. They are measured to the cells' centres.

        Args:
            rng: see `random_point`.
            position: world position [m]; with paths, one where an agent can stand.
            max_distance: [m].
            count: how many, with repetition; one unless given.
            min_distance: [m]; the places are in an annulus then.
            straight: measure straight.
            room: only in this room, by id or name.
            anywhere: see `random_point`.

        Returns:
            World x, y and floor z [m], shape (3,) or (count, 3), float64.

        Raises:
            QueryError: as `random_point`; or the distances are not 0 <= minimum <= maximum.
        """
        distances = (min_distance, max_distance)
        cells = cells_near(self._cache, position, distances, straight, level)
        if room is not None:
            cells = cells[self.rooms.number[cells] == self.rooms.find(room)]
        limits = {"room": room, "distance [m]": f"{min_distance:g} to {max_distance:g}"}
        return draw_places(self._cache, cells, rng, count, anywhere, limits)

    def any_free_in_annulus(
        self,
        position: ArrayLike,
        min_distance: float,
        max_distance: float,
        *,
        level: int | None = None,
    ) -> bool:
        """Whether a free cell's centre is so far from a position, on the map of its level [m]."""
        distances = (min_distance, max_distance)
        return len(cells_near(self._cache, position, distances, True, level)) > 0

    def random_pose(
        self,
        rng: np.random.Generator | None = None,
        target: ArrayLike | None = None,
        max_distance: float = 1.0,
        *,
        min_distance: float = 0.0,
        in_sight: bool = True,
        same_room: bool = False,
        level: int | None = None,
    ) -> Pose:
        """Draw where an agent stands and looks: at a target, if there is one.

        Args:
            rng: see `random_point`.
            target: world position [m], which may be in something; the agent stands on its level.
            max_distance, min_distance: from the target, straight on the map [m].
            in_sight: nothing stands between, but for what the target is in, as with `snap`.
            same_room: stand in the target's room.
            level: which level the target is on; without one, where to stand.

        Raises:
            QueryError: see `random_point_near`.
        """
        distances = (min_distance, max_distance)
        return draw_pose(
            self._cache, rng, target, distances,
            in_sight=in_sight, same_room=same_room, level=level,
        )  # fmt: skip

    # --- islands and rooms -----------------------------------------------------------------

    @cached_property
    def many(self) -> ManyPlaces:
        """The same questions about many positions at once: `snap`, `clearance` and others."""
        return ManyPlaces(self._cache, self._planner)

    @property
    def search(self) -> Search:
        """The cells and the steps between them, with what is blocked now."""
        return self._cache.search

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
