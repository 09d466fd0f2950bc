"""Plans paths on a grid, and answers queries about places on it.

`PathFinder` holds the interface and its documentation. Its methods call functions of other modules,
which hold the code and take a `navbake.runtime.search.Search`.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn, TypeAlias, overload

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.lazy import resolve
from navbake.navgrid.cells import Cell
from navbake.navgrid.door_states import DoorStateWarning, describe_lost_states
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.links import Agent
from navbake.runtime import draws, no_path, passage, paths, places, stand
from navbake.runtime.draws import Pose, SpawnRules, Spawns
from navbake.runtime.flat_grid import IslandMap, RoomMap
from navbake.runtime.inflation import InflationWarning
from navbake.runtime.passage import Passage
from navbake.runtime.path_following import DriveLimits, Follower
from navbake.runtime.paths import Goal, Path
from navbake.runtime.places import MAX_DROP, NearestObstacle
from navbake.runtime.search import Search
from navbake.runtime.stand import StandPoses, StandTargets
from navbake.runtime.stand_cells import StandRules
from navbake.types import Bool, Float, Int

OnePosition: TypeAlias = Sequence[float]
"""x, y, z of one position, as a tuple or a list."""

ManyPositions: TypeAlias = Sequence[Sequence[float]]
"""x, y, z of several positions, as a list of tuples."""

# name that users may expect -> the method that does this
_SUGGESTIONS = {
    "closest_obstacle_surface_point": "nearest_obstacle(position)",
    "distance": "distances(starts, goal)",
    "distance_to_closest_obstacle": "clearance(position)",
    "geodesic_distance": "distances(starts, goal)",
    "get_bounds": "bounds",
    "get_island": "island_at(position)",
    "get_random_navigable_point": "random_point(rng)",
    "get_random_navigable_point_near": "random_point_near(rng, position, radius)",
    "get_topdown_view": "top_down(level, metres_per_pixel)",
    "island_radius": "island_area(island)",
    "num_islands": "islands.count",
    "random_navigable_point": "random_point(rng)",
    "random_points": "random_point(rng, count)",
    "is_free": "is_navigable(position)",
    "shortest_path": "find_path(start, goal)",
    "snap_point": "snap(position)",
    "try_step_no_sliding": "try_step(start, end, slide=False)",
}


class PathFinder:
    """Plans paths on a grid, and answers queries about places on it.

    A path leads from free cell to free cell, over their edges and corners, if their floors differ
    by at most the grid's `traversableFloorHeight`. It leads to other levels over the grid's `steps`
    and open `links`. A step costs its length [m] times the weight of the cell that it leads to,
    times the cost of that cell's area. A passage over a link costs as much as the grid states, else
    the link's length. It takes as long as the grid states, else its cost divided by the agent's
    speed.

    With an agent, the grid is inflated to its radius. The agent takes no step that is too high for
    it, no link that bars it or is narrower than twice its radius, and enters no area that bars it.
    Without an agent, the grid is used as it is, at a speed of 1 m/s. All open links that are wide
    enough for the grid's radius are used, and only areas of infinite cost are closed.

    In all methods

    - a position is world x, y, z [m], on the level of the nearest floor below. With `level`,
      positions are on that level (0 is the lowest) and z is ignored. x, y are enough with `level`,
      or on a grid of one level;
    - a goal is a position, several of them (the cheapest to reach counts), ``room:NAME``, or
      ``object:NAME`` with a name of the user data (the nearest free cells of each island within
      1 m of it);
    - a room is given by its id or name, an island by its number; 1 is the largest;
    - a place is world x, y and floor z [m], shape (3,), or (n, 3) for several, float64;
    - `rng` is a numpy Generator; None makes a new one for each call;
    - QueryError is raised for a position that is not valid, and for an unknown level, room,
      object or island.

    Not thread-safe: use one object per thread.

    Attributes:
        grid: the grid inflated for the agent; the given grid itself if there is nothing to change.

    Args:
        grid: a grid of one or several levels, or its file. Later writes into its arrays have no
            effect; `grid.block` has.
        cut_corners: allow diagonal steps past blocked corners.
        agent: the name of one of the grid's `agents`, or a `navbake.Agent`.

    Raises:
        QueryError: a weight is negative, or the agent is unknown, higher than the grid's or takes
            higher steps.
        FormatError: the file can't be read, or is no NavGrid.

    Example:
        >>> grid = navbake.load("apartment.grid.json")
        >>> finder = navbake.PathFinder(grid.inflate(0.2))
        >>> path = finder.find_path((1.0, 0.5, 0.0), "room:kitchen")
    """

    grid: NavGrid

    def __init__(
        self,
        grid: NavGrid | str | os.PathLike[str],
        *,
        cut_corners: bool = False,
        agent: str | Agent | None = None,
    ) -> None:
        self._cut_corners = cut_corners
        self._agent = agent
        self._search = self._make_search(grid)
        self.grid = self._search.grid

    def use(self, grid: NavGrid | str | os.PathLike[str]) -> None:
        """Switch to another grid, for example after `Baker.update`.

        A finder with an agent inflates the new grid for it. A finder without one takes the grid as
        it is. A `navbake.InflationWarning` says so if the new grid isn't inflated, and the grid
        before was inflated for a larger radius than the new grid's. Doors are as in the new grid; a
        `navbake.DoorStateWarning` names those that are as modelled there, and had another state in
        the grid before. The followers of the finder go on by the new grid.

        Args:
            grid: a grid of one or several levels, or its file.

        Raises:
            QueryError: for the same reasons as in `PathFinder`.
            FormatError: the file can't be read, or is no NavGrid.

        Example:
            >>> changes = baker.update(data)
            >>> finder.use(changes.grid)
            >>> finder.use(changes.grid.with_doors("open"))  # for a robot that opens doors
        """
        search = self._make_search(grid)
        last_radius = self.grid.inflated_radius
        radius = search.grid.radius
        if last_radius > radius and not search.grid.exact_inflations:
            warnings.warn(
                f"the grid of {search.grid.scene_id!r} isn't inflated: the finder's radius was "
                f"{last_radius:g} m and is now {radius:g} m. Inflate the new grid, or make the "
                f'finder with agent=navbake.Agent("robot", radius={last_radius:g})',
                InflationWarning,
                stacklevel=2,
            )
        lost_states_text = describe_lost_states(self.grid, search.grid)
        if lost_states_text:
            warnings.warn(lost_states_text, DoorStateWarning, stacklevel=2)
        self._search = search
        self.grid = search.grid

    def _make_search(self, grid: NavGrid | str | os.PathLike[str]) -> Search:
        """Make the search on a grid for the finder's agent, see `use` for the errors."""
        new_grid: NavGrid
        if isinstance(grid, str | os.PathLike):
            new_grid = resolve("navbake.formats.navgrid:read_navgrid")(grid)
        else:
            new_grid = grid
        if not hasattr(new_grid, "levels"):
            expected = "a navigation grid, as `navbake.bake` makes it, or its file"
            raise QueryError(
                f"expected {expected}, got a {type(new_grid).__name__}",
                key="grid",
                value=new_grid,
                expected=expected,
            )
        return Search(new_grid, cut_corners=self._cut_corners, agent=self._agent)

    if not TYPE_CHECKING:  # so that type checkers report names that don't exist

        def __getattr__(self, name: str) -> NoReturn:
            hint = f": write `{_SUGGESTIONS[name]}`" if name in _SUGGESTIONS else ""
            raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}{hint}")

    def __repr__(self) -> str:
        count = self.islands.count
        area = self.navigable_area
        return f"PathFinder({self.grid.scene_id!r}, {area:.1f} m² free, islands: {count})"

    def _repr_html_(self) -> str:
        return self.grid._repr_html_()

    def _repr_png_(self) -> bytes:
        return self.grid._repr_png_()

    # ---------------------------------------------------------------- the grid as it is now

    @property
    def agent(self) -> Agent | None:
        """The agent that plans; None for the grid's own agent."""
        return self._search.agent

    @property
    def search(self) -> Search:
        """The search over the cells, up to date with the grid's obstacles."""
        self._search.update()
        return self._search

    @property
    def rooms(self) -> RoomMap:
        """The rooms of the grid; its ``rooms`` lists them in the order of their numbers."""
        return self._search.rooms

    @property
    def islands(self) -> IslandMap:
        """The connected parts of the free cells now; it has their ``count`` and ``areas`` [m²]."""
        return self.search.islands

    @property
    def navigable_area(self) -> float:
        """Area of all free cells [m²]."""
        return float(self.islands.areas.sum())

    @property
    def bounds(self) -> tuple[Float, Float]:
        """Lower and upper corner of the bounding box of all free cells' floors.

        Each is world x, y, z [m], shape (3,).

        Raises:
            QueryError: no cell is free.
        """
        return places.find_bounds(self.search)

    # ---------------------------------------------------------------- paths

    def find_path(
        self,
        start: ArrayLike,
        goal: Goal,
        *,
        level: int | None = None,
        by: str = "cost",
        smooth: bool = True,
    ) -> Path | None:
        """Find the cheapest path, or the quickest.

        The path begins and ends at the given positions, unless they are nearer to obstacles than
        the agent may be: then it begins and ends at the centres of their cells.

        Args:
            start: world x, y, z [m], shape (3,).
            goal: a position, several of them (the cheapest to reach counts), ``room:NAME`` or
                ``object:NAME``.
            level: the level of positions, for which x, y are then enough; None finds it by z.
            by: ``cost`` for the cheapest path. ``time`` for the quickest: steps last their length
                over the agent's speed or their area's, whatever they cost.
            smooth: whether the path is pulled straight where that stays free; else it runs
                through the cells' centres.

        Returns:
            The path; None if there is none, for the reason that `why_not` returns.

        Raises:
            QueryError: a position is not valid, or there is no such level, room or object.

        Example:
            >>> path = finder.find_path((1.0, 0.5, 0.0), (4.0, 2.0, 0.0))
            >>> if path is not None:
            ...     print(path.length, path.positions)
        """
        return paths.find_path(self.search, start, goal, level, by=by, smooth=smooth)

    def why_not(self, start: ArrayLike, goal: Goal, *, level: int | None = None) -> str | None:
        """Say in one sentence why there is no path.

        If the start or the goal isn't free, the sentence says so, and where the nearest free cell
        is. Else it names the islands of both, and the first reason that applies: cells that
        `grid.block` blocks, doors, a link or area that the agent may not use, a gap that is too
        narrow, steps that are too high for the agent, blocked steps between levels, or the names of
        obstacles in between.

        Args:
            start: world x, y, z [m], shape (3,).
            goal: a position, several of them, ``room:NAME`` or ``object:NAME``.
            level: the level of positions, for which x, y are then enough; None finds it by z.

        Returns:
            The sentence; None if there is a path.

        Raises:
            QueryError: a position is not valid, or there is no such level, room or object.

        Example:
            >>> if finder.find_path(start, goal) is None:
            ...     print(finder.why_not(start, goal))
        """
        return no_path.why_not(self.search, start, goal, level)

    def distance_field(
        self, goal: Goal, *, level: int | None = None, weighted: bool = True, by: str = "cost"
    ) -> list[Float]:
        """Compute the cost of the cheapest path from every cell to a goal.

        Args:
            goal: a position, several of them (the cheapest to reach counts), ``room:NAME`` or
                ``object:NAME``.
            level: the level of positions, for which x, y are then enough; None finds it by z.
            weighted: whether to return the costs of `find_path`. If False, returns the lengths of
                the shortest paths [m], to which links add their costs.
            by: ``cost``; or ``time`` for the seconds of the quickest path.

        Returns:
            One array for each level, shape (height, width), float64, inf where no path leads to
            the goal; read-only.

        Raises:
            QueryError: a position is not valid, there is no such level, room or object, or
                `weighted=False` is combined with ``by="time"``.

        Example:
            >>> (field,) = finder.distance_field("room:kitchen")  # of a grid of one level
        """
        cost_field = paths.find_field(self.search, goal, level, weighted=weighted, by=by)
        flat = self._search.flat
        return [
            cost_field[flat.cells_of(level_number)].reshape(level_grid.shape)
            for level_number, level_grid in enumerate(self.grid.levels)
        ]

    def distances(
        self,
        starts: ArrayLike,
        goal: Goal | None = None,
        *,
        goals: Sequence[Goal] | None = None,
        level: int | None = None,
        weighted: bool = True,
        by: str = "cost",
    ) -> Float:
        """Compute the costs of the cheapest paths from many starts to one goal or to several goals.

        The costs are looked up in the `distance_field` of each goal. The fields
        of the last few goals are cached. Pass either `goal` or `goals`.

        Args:
            starts: world x, y, z [m], shape (..., 3).
            goal: a position, several of them (the cheapest to reach counts), ``room:NAME`` or
                ``object:NAME``.
            goals: m goals, each like `goal`.
            level: the level of positions, for which x, y are then enough; None finds it by z.
            weighted: whether to return the costs of `find_path`. If False, returns the lengths of
                the shortest paths [m], to which links add their costs.
            by: ``cost``; or ``time`` for the seconds of the quickest path.

        Returns:
            float64, inf for no path: shape (...) for a `goal`; (..., m) for `goals`.

        Raises:
            QueryError: a position is not valid, there is no such level, room or object,
                `weighted=False` is combined with ``by="time"``, or both or neither of `goal` and
                `goals` are given.

        Example:
            >>> starts = finder.random_point(rng, 100)
            >>> finder.distances(starts, goals=["room:kitchen", "room:bath"]).shape
            (100, 2)
        """
        if goals is not None and goal is None:
            goal_list = list(goals)
        elif goal is not None and goals is None:
            goal_list = [goal]
        else:
            raise QueryError("expected a goal, or goals=[…], one of them")
        cells = self.search.flat.cells_at(starts, level)
        distances = np.full((*cells.shape, len(goal_list)), np.inf)
        for goal_index, single_goal in enumerate(goal_list):
            cost_field = paths.find_field(
                self._search, single_goal, level, weighted=weighted, by=by
            )
            distances[..., goal_index] = np.where(cells >= 0, cost_field[cells], np.inf)
        return distances[..., 0] if goals is None else distances

    def max_radius(
        self, start: ArrayLike, goal: Goal, *, level: int | None = None, ledges: str = "avoid"
    ) -> Passage | None:
        """Find the widest agent that can get from a place to a goal, and its bottleneck.

        ``find_path`` finds a path on ``grid.inflate(radius)`` for every radius up to this one, and
        for no larger one. Obstacles that `grid.block` added block the way, and so do areas and
        links that the finder's agent may not use. The size of that agent plays no part, and neither
        does an inflation of the grid, if the file still has the layers from before it.

        Args:
            start: world x, y, z [m], shape (3,).
            goal: a position, several of them, or ``room:NAME``.
            level: the level of positions, for which x, y are then enough; None finds it by z.
            ledges: ``avoid`` to keep agents away from drops, or ``ignore`` to let them stand at
                drops; see `grid.inflate`.

        Returns:
            The radius and the bottleneck; None if not even a point gets there.

        Raises:
            QueryError: start or goal is outside the grid or occupied, or the goal is an object.

        Example:
            >>> passage = finder.max_radius(start, "room:kitchen")
            >>> passage.radius, passage.position
        """
        return passage.find_passage(self.search, start, goal, level, ledges)

    def follow(
        self,
        path: Path,
        *,
        speed: float = 0.5,
        acceleration: float = 1.0,
        turn_rate: float = 1.5,
        lookahead: float = 0.4,
        tolerance: float = 0.05,
    ) -> Follower:
        """Follow a path with a mobile base: velocities or waypoints, step by step.

        The base stays within some centimetres of the path, so plan it on a grid that is inflated
        for a radius larger by that much.

        The follower uses the finder's present grid, also after `use`. A path that was found on
        another grid, as for a smaller agent or before `use`, is checked when the base starts, and
        replaced by a new one if this grid or the finder's agent doesn't allow it.

        Args:
            path: a path found by `find_path`.
            speed: the highest speed [m/s].
            acceleration: the deceleration with which the base brakes [m/s²].
            turn_rate: the highest turn rate [rad/s].
            lookahead: distance along the path to the point that the base heads for [m].
            tolerance: distance to the goal at which the base has arrived [m].

        Returns:
            The follower, which holds the progress along the path.

        Raises:
            QueryError: a limit is no number > 0, or `path` is no path.

        Example:
            >>> follower = finder.follow(path, speed=0.5)
            >>> command = follower.command(position, heading)  # in each control step
        """
        if not isinstance(path, Path):
            raise QueryError(f"expected a path that find_path has found, got {path!r}")
        limits = DriveLimits(
            speed=speed,
            acceleration=acceleration,
            turn_rate=turn_rate,
            lookahead=lookahead,
            tolerance=tolerance,
        )
        return Follower(self, path, limits)

    # ---------------------------------------------------------------- islands and rooms

    @overload
    def island_at(self, position: OnePosition, *, level: int | None = None) -> int | None: ...
    @overload
    def island_at(self, position: ManyPositions, *, level: int | None = None) -> Int: ...
    @overload
    def island_at(self, position: ArrayLike, *, level: int | None = None) -> int | Int | None: ...
    def island_at(self, position: ArrayLike, *, level: int | None = None) -> int | Int | None:
        """Find the number of the island that a position is on; 1 is the largest island.

        Args:
            position: world x, y, z [m], shape (3,), or (..., 3) for many.
            level: the level of all positions, for which x, y are then enough; None finds each one's
                level by its z.

        Returns:
            The number, None where the position's cell isn't free; for many, an int64 array of
            shape (...) with 0 there.

        Raises:
            QueryError: a position is not valid, or there is no such level.
        """
        if np.ndim(position) == 1:
            return places.island_at(self.search, position, level)
        return places.islands_at(self.search, position, level)

    def same_island(self, a: ArrayLike, b: ArrayLike, *, level: int | None = None) -> bool:
        """Whether both positions are on one island, so that paths lead from each to the other.

        Args:
            a: world x, y, z [m], shape (3,).
            b: world x, y, z [m], shape (3,).
            level: the level of both, for which x, y are then enough; None finds it by z.

        Raises:
            QueryError: a position is not valid, or there is no such level.
        """
        search = self.search
        island_a = places.island_at(search, a, level)
        island_b = places.island_at(search, b, level)
        return island_a is not None and island_a == island_b

    def island_area(self, island: int) -> float:
        """Look up the area of an island [m²].

        Args:
            island: its number, from 1, the largest.

        Raises:
            QueryError: there is no such island.
        """
        islands = self.islands
        return float(islands.areas[islands.check(island)])

    @overload
    def room_at(self, position: OnePosition, *, level: int | None = None) -> str | None: ...
    @overload
    def room_at(
        self, position: ManyPositions, *, level: int | None = None
    ) -> NDArray[np.object_]: ...
    @overload
    def room_at(
        self, position: ArrayLike, *, level: int | None = None
    ) -> str | NDArray[np.object_] | None: ...
    def room_at(
        self, position: ArrayLike, *, level: int | None = None
    ) -> str | NDArray[np.object_] | None:
        """Find the id of a position's room.

        Args:
            position: world x, y, z [m], shape (3,), or (..., 3) for many.
            level: the level of all positions, for which x, y are then enough; None finds each one's
                level by its z.

        Returns:
            The id, None where the position is in no room; for many, an array of shape (...) of
            these.

        Raises:
            QueryError: a position is not valid, or there is no such level.

        Example:
            >>> rooms = finder.room_at(positions)  # shape (n, 3)
        """
        if np.ndim(position) == 1:
            return places.room_at(self.search, position, level)
        return places.rooms_at(self.search, position, level)

    def same_room(self, a: ArrayLike, b: ArrayLike, *, level: int | None = None) -> bool:
        """Whether both positions are in the same room; False if either is in no room.

        Args:
            a: world x, y, z [m], shape (3,).
            b: world x, y, z [m], shape (3,).
            level: the level of both, for which x, y are then enough; None finds it by z.

        Raises:
            QueryError: a position is not valid, or there is no such level.
        """
        search = self.search
        room_a = places.room_at(search, a, level)
        room_b = places.room_at(search, b, level)
        return room_a is not None and room_a == room_b

    def room_near(
        self, position: ArrayLike, max_distance: float = math.inf, *, level: int | None = None
    ) -> str | None:
        """Find the id of the room nearest to a position, on the position's level.

        Args:
            position: world x, y, z [m], shape (3,).
            max_distance: largest distance to a cell's centre, on the map [m], >= 0.
            level: the position's level, for which x, y are then enough; None finds it by z.

        Returns:
            The id; None if no room is within the distance.

        Raises:
            QueryError: the position is not valid, or there is no such level.
        """
        return places.room_near(self.search, position, max_distance, level)

    def room_of(self, name: str) -> str | None:
        """Find the id of the room that holds most cells of an object.

        Args:
            name: name of the object, door or wall in the grid's user data.

        Returns:
            The room's id; None if no cell of the object is in a room.

        Raises:
            QueryError: the grid has no such name.

        Example:
            >>> finder.room_of("fridge")
            'kitchen'
        """
        return places.room_of_object(self.search, name)

    # ---------------------------------------------------------------- free space

    @overload
    def is_navigable(
        self, position: OnePosition, *, level: int | None = None, max_drop: float = MAX_DROP
    ) -> bool: ...
    @overload
    def is_navigable(
        self, position: ManyPositions, *, level: int | None = None, max_drop: float = MAX_DROP
    ) -> Bool: ...
    @overload
    def is_navigable(
        self, position: ArrayLike, *, level: int | None = None, max_drop: float = MAX_DROP
    ) -> bool | Bool: ...
    def is_navigable(
        self, position: ArrayLike, *, level: int | None = None, max_drop: float = MAX_DROP
    ) -> bool | Bool:
        """Whether an agent can stand at a position, or at each of many.

        It can where the position's cell is free, and the cell's floor at most `max_drop` below the
        position.

        Args:
            position: world x, y, z [m], shape (3,), or (..., 3) for many.
            level: the level of all positions, for which x, y are then enough; None finds each one's
                level by its z.
            max_drop: largest height above the floor [m], >= 0; it doesn't count with `level`.

        Returns:
            bool for one position; an array of shape (...) for many.

        Raises:
            QueryError: a position is not valid, or there is no such level.

        Example:
            >>> free = finder.is_navigable(positions)  # shape (n, 3)
        """
        return places.is_navigable(self.search, position, level, max_drop)

    def cell_at(self, position: ArrayLike, *, level: int | None = None) -> Cell | None:
        """Find level, row and column of a position's cell, free or not.

        Args:
            position: world x, y, z [m], shape (3,).
            level: the position's level, for which x, y are then enough; None finds it by z, see
                `navbake.navgrid.cells.cell_at`.

        Returns:
            The cell; None outside the grid, and below all of its floors.

        Raises:
            QueryError: the position is not valid, or there is no such level.
        """
        flat = self.search.flat
        _, cell = flat.locate(position, level)
        return flat.to_cell(cell) if cell >= 0 else None

    @overload
    def snap(
        self,
        position: ManyPositions,
        *,
        level: int | None = None,
        same_level: bool = True,
        same_room: bool = False,
        room: str | None = None,
        island: int | None = None,
        in_sight: bool = False,
        max_distance: float = math.inf,
    ) -> Float: ...
    @overload
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
    ) -> Float | None: ...
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
        """Find the nearest place where an agent can stand, for one position or each of many.

        If the position's own cell is allowed and its floor at most 0.5 m below, that is the
        position itself, put on the floor. Else it is the centre of the nearest allowed cell.
        Nearest means on the map, on the position's level; without `same_level`, in 3D, on any
        level.

        Args:
            position: world x, y, z [m], shape (3,), or (..., 3) for many. `same_room` and
                `in_sight` take one position.
            level: the level of all positions, for which x, y are then enough; None finds each one's
                level by its z.
            same_level: the place must be on the position's level. A position on no level snaps to
                the nearest floor in space.
            same_room: the place must be in the position's room. For a position in no room, no place
                is found.
            room: take a cell of this room only.
            island: take a cell of this island only.
            in_sight: no obstacle may be between position and place. A position inside an object,
                such as a cup on a table, sees out of the object, but only within the position's
                room: not through a wall at its back.
            max_distance: the largest distance of the place [m], >= 0.

        Returns:
            World x, y and floor z [m], float64: shape (3,), None for no such place; for many
            positions shape (..., 3), a row of NaN for no such place.

        Raises:
            QueryError: a position is not valid, or there is no such level, room or island.

        Example:
            >>> start = finder.snap((1.0, 0.5, 0.0), max_distance=0.5)
        """
        return places.snap(
            self.search,
            position,
            level=level,
            same_level=same_level,
            same_room=same_room,
            room=room,
            island=island,
            in_sight=in_sight,
            max_distance=max_distance,
        )

    def try_step(
        self, start: ArrayLike, end: ArrayLike, *, slide: bool = True, level: int | None = None
    ) -> Float:
        """Move straight from a position towards another, and stop at cells that are not free.

        The walk goes from cell to neighbouring cell, so it never jumps over a thin wall. It takes
        steps to other levels, but no links. It may end anywhere in a free cell, up to half a cell
        nearer to obstacles than the cell's centre.

        Where the straight walk stops, the agent may slide along what stops it. A slide is at most
        as long as the rest of the straight walk, and ends at the point nearest to `end` that it can
        reach.

        Args:
            start: world x, y, z [m], shape (3,), or (..., 3) for many.
            end: world x, y, z [m]: one for each start, or shape (3,) for all; z is ignored.
            slide: whether to slide on.
            level: the level of all starts, for which x, y are then enough; None finds each one's
                level by its z.

        Returns:
            World x, y and floor z of where the walks end [m], shape (..., 3), float64.

        Raises:
            QueryError: a start isn't free, a position is not valid, or there is no such level.

        Example:
            >>> position = finder.try_step(position, position + velocity * 0.1)
        """
        return places.try_step(self.search, start, end, slide=slide, level=level)

    def line_of_sight(self, a: ArrayLike, b: ArrayLike, *, level: int | None = None) -> bool:
        """Whether the straight line between two positions crosses no occupied cell.

        The line is seen from above; heights are not compared. It continues on other levels over
        steps. It may run exactly through a corner between four cells if one of the two cells beside
        it is not occupied.

        Args:
            a: world x, y, z [m], shape (3,).
            b: world x, y, z [m], shape (3,).
            level: the level of both, for which x, y are then enough; None finds it by z.

        Returns:
            False also if one of the positions is outside the grid or occupied.

        Raises:
            QueryError: a position is not valid, or there is no such level.
        """
        return places.line_of_sight(self.search, a, b, level)

    def nearest_obstacle(
        self, position: ArrayLike, *, level: int | None = None, max_distance: float = math.inf
    ) -> NearestObstacle | None:
        """Find the nearest point of an occupied cell's square on the position's level.

        The area outside the grid has no obstacles. The level's hole at the top of stairs is no
        obstacle, either: there, the level has no floor at about the position's height, but another
        level has one that isn't occupied. Floors are at about the same height if they differ by
        less than the agent's height minus a step.

        Args:
            position: world x, y, z [m], shape (3,).
            level: the position's level, for which x, y are then enough; None finds it by z.
            max_distance: largest distance on the map [m], >= 0.

        Returns:
            ``distance`` on the map [m], 0 inside an occupied cell, and ``position``, world x, y and
            floor z at the given position [m]; None if there is no obstacle within the distance.

        Raises:
            QueryError: the position is in no cell or not valid, or there is no such level.
        """
        return places.nearest_obstacle(self.search, position, level, max_distance)

    @overload
    def clearance(
        self, position: OnePosition, *, level: int | None = None, max_distance: float = math.inf
    ) -> float: ...
    @overload
    def clearance(
        self, position: ManyPositions, *, level: int | None = None, max_distance: float = math.inf
    ) -> Float: ...
    @overload
    def clearance(
        self, position: ArrayLike, *, level: int | None = None, max_distance: float = math.inf
    ) -> float | Float: ...
    def clearance(
        self, position: ArrayLike, *, level: int | None = None, max_distance: float = math.inf
    ) -> float | Float:
        """Compute the distance to the nearest obstacle; see `nearest_obstacle`.

        Args:
            position: world x, y, z [m], shape (3,), or (..., 3) for many.
            level: the level of all positions, for which x, y are then enough; None finds each one's
                level by its z.
            max_distance: the largest distance that is returned [m], >= 0.

        Returns:
            Distances [m]: float for one position; float64 of shape (...) for many.

        Raises:
            QueryError: a position is in no cell or not valid, or there is no such level.

        Example:
            >>> reward -= 0.1 * (finder.clearance(position, max_distance=1.0) < 0.2)
        """
        return places.clearance(self.search, position, level, max_distance)

    def top_down(self, level: int, metres_per_pixel: float | None = None) -> NDArray[np.uint8]:
        """Draw a level's free cells as an image.

        Args:
            level: number of the level, 0 is the lowest.
            metres_per_pixel: edge of a pixel [m], > 0; each pixel shows the cell at its middle.
                None for one pixel for each cell.

        Returns:
            RGB, shape (rows, cols, 3), uint8, in the colours of ``navbake plot``: free, blocked, no
            floor; rows and columns as in the grid's arrays.

        Raises:
            QueryError: there is no such level, or `metres_per_pixel` is no number > 0.

        Example:
            >>> pyplot.imshow(finder.top_down(0, metres_per_pixel=0.05))
        """
        return places.draw_top_down(self.search, level, metres_per_pixel)

    # ---------------------------------------------------------------- where to stand

    def stand_poses(
        self,
        target: StandTargets,
        *,
        reach: tuple[float, float] = (0.3, 0.8),
        count: int | None = 16,
        footprint: ArrayLike | None = None,
        facing: str | None = "target",
        height: float | None = None,
        sight: bool | float = True,
        spread: float = 0.25,
        seed: int = 0,
        start: ArrayLike | None = None,
    ) -> StandPoses:
        """Find poses of a robot's base from which it reaches things, and touches nothing.

        The base's axis stands on the middle of a cell that is free for the finder's agent. A grid
        knows an object by the cells over whose squares it stands, and by its upright box. Distances
        are measured to the part of these squares that the box covers. A base is in reach if no
        square is nearer than the least distance, and one square lies wholly within the greatest. So
        the object's nearest point is within reach, whatever its shape. The distance to a point is
        exact.

        Sight runs from the eye, over the base's axis, to the middle of a cell of the target. Things
        hide it with their boxes. So a cup is seen over the edge of its table; what is in a closed
        cupboard or far back on a shelf is not, unless its cells reach to the front. In the
        target's own cells, only walls and doors hide it. A grid without boxes, as older bakes and
        other programs write it, takes all that is in the agent's way as endlessly high.

        Args:
            target: a position, ``object:NAME``, ``category:NAME`` for all objects whose names
                without their numbers are this, or a list of these. An object, door or wall is
                reached on the levels of its cells, a position on the level of the floor below it.
            reach: least and greatest distance from the base's axis to the target [m], on the map.
            count: most poses for each target, >= 1; None for the poses in all cells from which it
                is reached, in the order of the cells.
            footprint: outline of the base from above, shape (k, 2), as in `grid.inflate_footprint`
                [m]: it overlaps no occupied square at the pose's heading, which is then a multiple
                of 1/64 turn. None for a disc of the grid's radius, and exact headings.
            facing: ``target`` to face the nearest part of the target that is in reach and in
                sight; None for random headings.
            height: height of the shoulder over the floor [m]. Distances are then those in space
                from it, to the heights of the object's box. None for distances on the map.
            sight: True if the target must be in sight of an eye at the agent's height, the eye's
                height over the floor [m], or False.
            spread: least distance between two poses of a target [m]; 0 for any.
            seed: seed of first poses and of random headings; equal seeds give equal poses.
            start: where the robot is, world x, y, z [m]; an agent must be able to stand there. Only
                poses to which a path leads from it are returned, those with the shortest path
                first. None for poses anywhere, each as far as can be from those before.

        Returns:
            The poses, sorted by target: ``positions``, ``headings``, ``distances``,
            ``path_lengths``, ``target_index`` and ``targets``; and ``why_not``, which says for each
            target without a pose in one sentence why it has none.

        Raises:
            QueryError: an argument is not valid, or there is no such object or category.

        Example:
            >>> poses = finder.stand_poses("object:sofa", reach=(0.3, 0.6), start=robot)
            >>> if len(poses):
            ...     path = finder.find_path(robot, poses.positions[0])
        """
        rules = StandRules(reach, footprint, facing, height, sight, start)
        return stand.stand_poses(self.search, target, rules, count=count, spread=spread, seed=seed)

    def stand_region(
        self,
        target: StandTargets,
        *,
        reach: tuple[float, float] = (0.3, 0.8),
        footprint: ArrayLike | None = None,
        facing: str | None = "target",
        height: float | None = None,
        sight: bool | float = True,
        start: ArrayLike | None = None,
    ) -> list[Bool]:
        """Mark the cells where a robot's base can stand to reach a target, or any of several.

        These are the cells from which `stand_poses` picks; it has the rules and the arguments.

        Args:
            target: a position, ``object:NAME``, ``category:NAME``, or a list of these.
            reach: least and greatest distance to the target [m].
            footprint: outline of the base, shape (k, 2) [m]; None for a disc of the grid's radius.
            facing: ``target``, or None for a footprint that may have any heading.
            height: height of the shoulder over the floor [m], for distances in space.
            sight: True, False, or the height of the eye over the floor [m].
            start: a free position from which a path must lead to the cells, world x, y, z [m].

        Returns:
            One array for each level, bool, shape (height, width).

        Raises:
            QueryError: an argument is not valid, or there is no such object or category.

        Example:
            >>> (region,) = finder.stand_region("object:sofa")  # of a grid of one level
            >>> region.sum() * grid.cell_size**2  # m²
        """
        rules = StandRules(reach, footprint, facing, height, sight, start)
        return stand.stand_region(self.search, target, rules)

    def can_reach(
        self,
        target: StandTargets,
        positions: ArrayLike,
        headings: ArrayLike,
        *,
        reach: tuple[float, float] = (0.3, 0.8),
        footprint: ArrayLike | None = None,
        tolerance: float | None = math.pi / 8,
        height: float | None = None,
        sight: bool | float = True,
    ) -> Bool:
        """Whether a robot's base reaches a target, or any of several, from each of many poses.

        It does in the cells of `stand_region`, if it faces the target there. What is true of the
        middle of a cell counts in the whole cell.

        Args:
            target: a position, ``object:NAME``, ``category:NAME``, or a list of these.
            positions: world x, y, z of the base's axis [m], shape (..., 3).
            headings: where the base faces, 0 along x, counted towards y [rad], shape (...).
            reach: least and greatest distance to the target [m].
            footprint: outline of the base, shape (k, 2) [m]: it has to fit at the heading, too, to
                1/64 turn. None for a disc of the grid's radius.
            tolerance: largest angle between a heading and that of `stand_poses` in the same cell
                [rad], >= 0; None for any heading.
            height: height of the shoulder over the floor [m], for distances in space.
            sight: True, False, or the height of the eye over the floor [m].

        Returns:
            bool, shape (...); False beside the grid.

        Raises:
            QueryError: an argument is not valid, or there is no such object or category.

        Example:
            >>> finder.can_reach("object:sofa", robot_positions, robot_headings).mean()
        """
        rules = StandRules(reach, footprint, "target", height, sight, start=None)
        return stand.ReachTest(self.search, target, rules, tolerance).mark(positions, headings)

    # ---------------------------------------------------------------- random places and poses

    def random_point(
        self,
        rng: Generator | None = None,
        count: int | None = None,
        *,
        level: int | None = None,
        room: str | None = None,
        island: int | None = None,
        reachable_from: ArrayLike | None = None,
        anywhere: bool = False,
        outdoors: bool = True,
    ) -> Float:
        """Draw places where an agent can stand, uniformly by area.

        Args:
            rng: a numpy Generator; None makes a new one.
            count: how many places, which may coincide; None for one place.
            level: draw places on this level only.
            room: draw places in this room only.
            island: draw places on this island only.
            reachable_from: draw only places to which a path leads from this free position, world
                x, y, z [m].
            anywhere: draw points anywhere in the cells, up to half a cell nearer to obstacles;
                else the cells' centres, where the agent's radius fits.
            outdoors: whether places in rooms that are outdoors are drawn, too.

        Returns:
            World x, y and floor z [m], float64: shape (3,), or (count, 3).

        Raises:
            QueryError: there is no such place, level, room or island, or `rng` is no numpy
                Generator.

        Example:
            >>> rng = np.random.default_rng(0)
            >>> goals = finder.random_point(rng, 10, room="kitchen")
        """
        return draws.random_point(
            self.search,
            rng,
            count,
            level=level,
            room=room,
            island=island,
            reachable_from=reachable_from,
            anywhere=anywhere,
            outdoors=outdoors,
        )

    def random_point_near(
        self,
        rng: Generator | None,
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
        """Draw places near a position, uniformly by area.

        Distances to cells' centres are lengths of shortest paths from the position. If `straight`,
        they are straight lines on the map of the position's level instead, also through walls.

        Args:
            rng: a numpy Generator; None makes a new one.
            position: world x, y, z [m], shape (3,); free, unless `straight`.
            max_distance: the largest distance [m].
            count: how many places, which may coincide; None for one place.
            min_distance: the smallest distance [m], >= 0.
            straight: whether distances are straight lines.
            room: draw places in this room only.
            level: the position's level, for which x, y are then enough; None finds it by z.
            anywhere: draw points anywhere in the cells, up to half a cell nearer to obstacles; else
                the cells' centres.

        Returns:
            World x, y and floor z [m], float64: shape (3,), or (count, 3).

        Raises:
            QueryError: there is no such place, level or room, the position is not valid or not
                free, or `rng` is no numpy Generator.

        Example:
            >>> start = finder.random_point_near(rng, goal, 5.0, min_distance=1.0)
        """
        return draws.random_point_near(
            self.search,
            rng,
            position,
            max_distance,
            count,
            min_distance=min_distance,
            straight=straight,
            room=room,
            level=level,
            anywhere=anywhere,
        )

    def any_free_in_annulus(
        self,
        position: ArrayLike,
        min_distance: float,
        max_distance: float,
        *,
        level: int | None = None,
    ) -> bool:
        """Whether a free cell's centre lies in an annulus round a position, on its level.

        Args:
            position: world x, y, z [m], shape (3,).
            min_distance: inner radius [m], >= 0.
            max_distance: outer radius [m].
            level: the position's level, for which x, y are then enough; None finds it by z.

        Raises:
            QueryError: the position is in no cell or not valid, or there is no such level.
        """
        return draws.any_free_in_annulus(self.search, position, min_distance, max_distance, level)

    def random_pose(
        self,
        rng: Generator | None = None,
        target: ArrayLike | None = None,
        max_distance: float = 1.0,
        *,
        min_distance: float = 0.0,
        in_sight: bool = True,
        same_room: bool = False,
        level: int | None = None,
        outdoors: bool = True,
    ) -> Pose:
        """Draw a pose, facing a target if there is one.

        Args:
            rng: a numpy Generator; None makes a new one.
            target: a position, world x, y, z [m], which may be inside an object; the agent stands
                on its level. None for a random heading anywhere.
            max_distance: largest distance from the target, in a straight line on the map [m].
            min_distance: smallest distance from the target [m], >= 0.
            in_sight: no obstacle may be between agent and target. The object that the target is in
                doesn't hide it, see `snap`.
            same_room: the agent stands in the target's room.
            level: the target's level; without a target, the agent's.
            outdoors: whether the agent may stand in rooms that are outdoors.

        Returns:
            ``position``, world x, y and floor z [m], shape (3,), and ``heading``, 0 along x,
            counted towards y, -pi to pi [rad].

        Raises:
            QueryError: there is no such place or level, the target is not valid, or `rng` is no
                numpy Generator.

        Example:
            >>> position, heading = finder.random_pose(rng, target=(1.0, 2.0, 0.8))
        """
        return draws.random_pose(
            self.search,
            rng,
            target,
            min_distance=min_distance,
            max_distance=max_distance,
            in_sight=in_sight,
            same_room=same_room,
            level=level,
            outdoors=outdoors,
        )

    def spawn(
        self,
        rng: Generator | None,
        n: int,
        *,
        rooms: str | Sequence[str] | None = None,
        level: int | None = None,
        island: int | None = None,
        reachable_from: ArrayLike | None = None,
        clearance: float | None = None,
        min_distance: float | None = None,
        facing: ArrayLike | None = None,
        stratify: str | None = None,
    ) -> Spawns:
        """Draw collision-free start poses for many agents.

        Positions are centres of cells, drawn one after the other, uniformly by area, from the
        cells far enough from all earlier ones on the map (Poisson-disc sampling). Agents whose
        floors are the agent's height or more apart are always far enough.

        Args:
            rng: a numpy Generator; None makes a new one.
            n: how many agents, >= 1.
            rooms: a room or several rooms: agents start in these only.
            level: agents start on this level only.
            island: agents start on this island only.
            reachable_from: agents start only where a path leads to from this free position, world
                x, y, z [m].
            clearance: radius of a disc round each agent that overlaps no obstacle and no drop, as
                with `grid.inflate` [m]. The discs of two agents don't overlap either, unless
                `min_distance` is given.
            min_distance: least distance between the centres of any two agents [m]. It is always
                more than twice the agent's radius: the grid's inflated radius, or else its baked
                one.
            facing: a position or a heading [rad] that all face; random headings if None.
            stratify: ``area`` draws one agent in each of n parts of equal area. ``room`` and
                ``island`` draw about equally many agents in each room or island; with ``room``, no
                agent stands in a cell without a room. Agents that don't fit into a part are drawn
                in other parts.

        Returns:
            ``positions``, world x, y and floor z [m], shape (n, 3), and ``headings`` [rad],
            shape (n,).

        Raises:
            QueryError: the agents don't fit; the message has an upper bound if one is known. Or
                there is no such level, room or island, or an argument is not valid.

        Example:
            >>> positions, headings = finder.spawn(rng, 8, rooms="living_room", min_distance=0.6)
        """
        rules = SpawnRules(
            rooms=rooms,
            level=level,
            island=island,
            reachable_from=reachable_from,
            clearance=clearance,
            min_distance=min_distance,
            facing=facing,
            stratify=stratify,
        )
        return draws.spawn(self.search, rng, n, rules)

    def reachable_positions(
        self, start: ArrayLike, spacing: float = 0.25, *, level: int | None = None
    ) -> Float:
        """List the points of a square lattice that an agent can reach, as AI2-THOR does.

        The lattice lies along x and y and goes through the start. The agent moves from point to
        neighbouring point, where `try_step` gets there without sliding and the agent's disc
        overlaps no obstacle at the end.

        Args:
            start: world x, y, z [m], shape (3,); free.
            spacing: distance between neighbours in the lattice [m], at least a cell's size.
            level: the start's level, for which x, y are then enough; None finds it by z.

        Returns:
            World x, y and floor z [m], shape (n, 3): the start, then the other points, sorted by
            the number of moves that lead to them.

        Raises:
            QueryError: the start isn't free or not valid, the spacing is too small, or there is no
                such level.
        """
        return draws.reachable_positions(self.search, start, spacing, level)
