"""What episodes of a scene may lead to: points, objects and where they are seen from, rooms."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any

import numpy as np

from navbake.episodes.episode import Agent, Goal, ViewPoint, scene_of
from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lazy import lazy
from navbake.navgrid.cells import check_positions
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.rooms import Room
from navbake.navgrid.user_data import Shared, UserData, names_in
from navbake.runtime.inflation import agent_radius
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.places import snap
from navbake.types import Float, Int

spatial = lazy("scipy.spatial")  # saves scipy at start-up
walks = lazy("navbake.runtime.kernels.walks")  # numba loads slowly

SNAP = 0.5  # how far a goal of another program may be from where an agent can stand [m]
COUNTER = re.compile(r"[\W_]*\d[\d\W_]*$")  # what tells chair_1 from chair_2
HEADROOM = 1e-9  # metres by which an agent may be higher than the grid's


def fit_grid(grid: NavGrid, radius: float | None = None, height: float | None = None) -> NavGrid:
    """The grid for an agent of a radius and a height [m]: inflated if need be.

    Raises:
        QueryError: the agent is higher than the grid's.
    """
    if height is not None and height > grid.agent_height + HEADROOM:
        raise QueryError(
            f"the grid of {scene_of(grid)!r} is for agents up to {grid.agent_height:g} m, got "
            f"{height:g} m: bake it with agent.height={height:g}"
        )
    if radius is None or math.isclose(radius, agent_radius(grid), abs_tol=1e-9):
        return grid
    fitted: NavGrid = grid.inflate(radius)
    return fitted


def agent_of(grid: NavGrid, speed: float | None = None) -> Agent:
    """The agent that a grid is for."""
    return Agent(radius=agent_radius(grid), height=grid.agent_height, speed=speed)


def cells_of(finder: PathFinder, goal: Goal) -> Int:
    """The free cells from which a goal counts as reached, by flat id, each once; maybe none.

    Of an object those of its view points; of a room its own; of a position its cell, or where no
    agent can stand there, that of the nearest place within 0.5 m or the goal's radius.
    """
    search = finder.search
    flat = search.flat
    if goal.room is not None:
        return np.flatnonzero(search.allowed(room=goal.room))
    points = [view.position for view in goal.view_points]
    if not points and goal.position is not None:
        points = [goal.position]
    if not points:
        return np.empty(0, dtype=np.int64)
    p, reach = check_positions(points, flat.num_levels), max(SNAP, goal.radius)
    _, cells = snap(flat, flat.free, p, same_level=False, max_distance=reach)
    return np.unique(cells[cells >= 0])


@dataclass(frozen=True, eq=False)
class Target:
    """What starts are drawn for: one goal, several of which one is enough, or several in order.

    Attributes:
        goals: as the episode has them.
        places: where the first is reached, world [m], shape (n, 3); empty for exploring.
        field: distance to the nearest of them from each cell, by flat id, inf for no path [m].
        beyond: length of the way after the first goal, along the floor and through the air [m].
        island: number of the places' island.
    """

    goals: tuple[Goal, ...]
    places: Float
    field: Float
    island: int
    beyond: tuple[float, float] = (0.0, 0.0)

    @cached_property
    def tree(self) -> Any:
        """The places, to look for the nearest."""
        return spatial.cKDTree(self.places)


@dataclass(eq=False)
class GoalFinder:
    """Finds goals on one grid.

    Attributes:
        finder: asks the grid.
        objects: patterns of names, or patterns by category; all objects by the categories that
            their names say unless given.
        rooms: patterns of ids or names; all but the outdoors unless given.
        radius: how near to the goal counts as reached [m].
        view_distance: how far from an object's cells it counts as seen [m].
        spacing: between view points [m].
    """

    finder: PathFinder
    objects: Sequence[str] | Mapping[str, Sequence[str]] = ()
    rooms: Sequence[str] = ()
    radius: float = 0.2
    view_distance: float = 1.0
    spacing: float = 0.25
    _seen: dict[str, Goal] = field(default_factory=dict, init=False)

    def target_of(self, goals: Sequence[Goal]) -> Target | None:
        """The target of one goal, or of several of which one is enough; None: nobody can get there.

        Places on other islands than the largest that has any are there as well.
        """
        search = self.finder.search
        cells = np.unique(np.concatenate([cells_of(self.finder, goal) for goal in goals]))
        if not len(cells):
            return None
        number = int(search.islands.number[cells].min())
        places = search.flat.positions(cells)
        return Target(tuple(goals), places, search.field(cells, weighted=False), number)

    def point(self, place: Float) -> Goal:
        """A goal at a place, world x, y, z [m]."""
        x, y, z = place.tolist()
        return Goal(position=(x, y, z), radius=self.radius)

    @cached_property
    def room_goals(self) -> list[Goal]:
        """A goal for each room that is asked for."""

        def matches(room: Room, pattern: str) -> bool:
            return any(fnmatchcase(name, pattern) for name in (room.id, room.name) if name)

        known = self.finder.rooms.rooms
        chosen = [room for room in known if not self.rooms and not room.outdoors]
        for pattern in self.rooms:
            found = [room for room in known if matches(room, pattern)]
            if not found:
                names = [name for room in known for name in (room.name, room.id) if name]
                where = scene_of(self.finder.grid)
                raise QueryError(f"no room {pattern!r} in {where!r}: {suggest(pattern, names)}")
            chosen += [room for room in found if room not in chosen]
        return [Goal(position=room.centroid, name=room.name, room=room.id) for room in chosen]

    @cached_property
    def object_cells(self) -> dict[str, Int]:
        """The cells of each object, by flat id, ascending; walls and doors are none."""
        found: dict[str, list[Int]] = {}
        other: set[str] = set()
        grid, flat = self.finder.grid, self.finder.search.flat
        for start, level in zip(flat.layout.start.tolist(), grid.levels, strict=False):
            source = UserData.of(level.user_data).source
            if isinstance(source, Shared):
                order = np.argsort(source.number, kind="stable")
                counts = np.bincount(source.number, minlength=len(source.entries))
                parts = np.split(source.cells[order], np.cumsum(counts)[:-1])
                pairs = list(zip(source.entries, parts, strict=True))
            else:
                pairs = [(entry, np.array([cell])) for cell, entry in source.items()]
            for entry, cells in pairs:
                other.update(names_in(entry, "walls"), names_in(entry, "doors"))
                for name in names_in(entry, "objects"):
                    found.setdefault(name, []).append(start + cells)
        return {n: np.unique(np.concatenate(found[n])) for n in sorted(found.keys() - other)}

    @cached_property
    def categories(self) -> dict[str, list[str]]:
        """The names of the objects of each category that is asked for.

        Where only patterns of names are, each object that fits is by itself, a category of one.
        """
        names = list(self.object_cells)
        if isinstance(self.objects, Mapping):
            given = {category: list(patterns) for category, patterns in self.objects.items()}
        else:
            given = {pattern: [pattern] for pattern in self.objects}
        found: dict[str, list[str]] = {}
        for key, patterns in given.items():
            found[key] = [n for n in names if any(fnmatchcase(n, p) for p in patterns)]
            if not found[key]:
                kind = "object of category" if isinstance(self.objects, Mapping) else "object"
                where = scene_of(self.finder.grid)
                raise QueryError(f"no {kind} {key!r} in {where!r}: {suggest(key, names)}")
        if not isinstance(self.objects, Mapping):
            return {name: [name] for fitting in found.values() for name in fitting} or {
                category: [n for n in names if category_of(n) == category]
                for category in sorted({category_of(n) for n in names})
            }
        return found

    def object_goals(self, category: str) -> list[Goal]:
        """A goal for each object of a category, with its view points; objects without are none."""
        by_name = not isinstance(self.objects, Mapping) and bool(self.objects)
        label = category_of(category) if by_name else category
        for name in self.categories[category]:
            if name not in self._seen:
                self._seen[name] = self._goal_of(name, label)
        goals = [self._seen[name] for name in self.categories[category]]
        return [goal for goal in goals if goal.view_points]

    def _goal_of(self, name: str, category: str) -> Goal:
        """An object and where it is seen from: free cells near it, with nothing between."""
        search, cells = self.finder.search, self.object_cells[name]
        flat, centers = search.flat, search.flat.positions(cells)
        middle = centers.mean(axis=0)
        is_own = np.zeros(flat.num_cells, dtype=np.int32)
        is_own[cells] = 1
        views = []
        for level in np.unique(flat.level_of(cells)).tolist():
            here = cells[flat.level_of(cells) == level]
            near = self._around(level, here)
            points = flat.positions(near)
            own = flat.positions(here)[:, :2]
            _, nearest = spatial.cKDTree(own).query(points[:, :2])
            for cell, point, k in zip(near, points, nearest, strict=True):
                # the line leaves the object through its own cells, then it must meet clear ones
                ends = np.array([cell]), np.ascontiguousarray(point[None, :2])
                if walks.first_in_sight(*search.sight, is_own, here[k], own[k], *ends) == 0:
                    dx, dy = middle[:2] - point[:2]
                    views.append(ViewPoint(tuple(point.tolist()), math.atan2(dy, dx)))
        x, y, z = middle.tolist()
        return Goal(
            position=(x, y, z), radius=self.radius, name=name, category=category,
            view_points=tuple(views),
        )  # fmt: skip

    def _around(self, level: int, cells: Int) -> Int:
        """The free cells of a level within the view distance of some cells, `spacing` apart.

        All of them where none lies on the lattice of view points.
        """
        flat = self.finder.search.flat
        size, span = float(flat.layout.cell_size[level]), flat.cells_of(level)
        row, col = np.divmod(cells - span.start, flat.layout.width[level])
        reach = math.ceil(self.view_distance / size)
        rows = np.arange(max(row.min() - reach, 0), min(row.max() + reach, self._rows(level)) + 1)
        width = int(flat.layout.width[level])
        cols = np.arange(max(col.min() - reach, 0), min(col.max() + reach, width - 1) + 1)
        near = (span.start + rows[:, None] * width + cols).ravel()
        near = near[flat.free[near]]
        apart, _ = spatial.cKDTree(np.stack([row, col], axis=1)).query(
            np.stack(np.divmod(near - span.start, width), axis=1)
        )
        near = near[apart * size <= self.view_distance]
        every = max(1, round(self.spacing / size))
        row, col = np.divmod(near - span.start, width)
        thin: Int = near[(row % every == 0) & (col % every == 0)]
        return thin if len(thin) else near

    def _rows(self, level: int) -> int:
        """The last row of a level."""
        return int(self.finder.search.flat.layout.height[level]) - 1


def category_of(name: str) -> str:
    """The category that an object's name says: without what counts it, in lower case."""
    return COUNTER.sub("", name).lower() or name.lower()
