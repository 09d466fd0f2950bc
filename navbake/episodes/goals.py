"""What episodes of a scene may lead to: points, objects and where they are seen from, rooms."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property, partial
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from navbake.episodes.episode import TASKS, Goal, Length, ViewPoint, scene_of
from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lazy import lazy
from navbake.navgrid.cells import check_positions
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.user_data import Shared, UserData, names_in
from navbake.runtime.inflation import agent_radius
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.paths import Path
from navbake.runtime.places import snap
from navbake.types import Float, Int

spatial = lazy("scipy.spatial")  # saves scipy at start-up
walks = lazy("navbake.runtime.kernels.walks")  # numba loads slowly

SNAP = 0.5  # how far a goal of another program may be from where an agent can stand [m]
SPACING = 0.25  # between view points, and between points of a path [m]
COUNTER = re.compile(r"[\W_]*\d[\d\W_]*$")  # what tells chair_1 from chair_2
HEADROOM = 1e-9  # metres by which an agent may be higher than the grid's


class Task(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the episodes of a set ask for.

    Attributes:
        name: one of `TASKS`.
        objects: patterns of the objects' names, or patterns by category; all by the categories
            that their names say unless given.
        rooms: patterns of rooms' ids or names, or patterns by type, as ``{bath: [bath*, wc]}``; all
            but the outdoors, each by itself, unless given.
        radius: how near counts as reached, or how far the agent sees of what it explores [m]:
            0.2 of a point, 0.1 of a view point, 3.0 to explore unless given.
        view_distance: how far from an object it may be seen from [m].
        length: number of goals of a sequence, >= 2.
        of: what the goals of a sequence are: ``point``, ``object`` or ``room``.
        share: of the free area of the start's island that is to be explored.
    """

    name: str = "point"
    objects: tuple[str, ...] | dict[str, tuple[str, ...]] = ()
    rooms: tuple[str, ...] | dict[str, tuple[str, ...]] = ()
    radius: Length | None = None
    view_distance: Length = 1.0
    length: Annotated[int, msgspec.Meta(ge=2)] = 3
    of: Literal["point", "object", "room"] = "point"
    share: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.9

    def __post_init__(self) -> None:
        if self.name not in TASKS:
            raise ValueError(f"expected one of {', '.join(TASKS)} as task, got {self.name!r}")

    @property
    def kind(self) -> str:
        """What each goal is: ``point``, ``object``, ``room`` or ``explore``."""
        return self.of if self.name == "sequence" else self.name

    @property
    def reach(self) -> float:
        """The radius, or its default [m]."""
        known = {"point": 0.2, "object": 0.1, "room": 0.0, "explore": 3.0}
        return known[self.kind] if self.radius is None else self.radius


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


# ---------------------------------------------------------------- where goals are reached


@dataclass(frozen=True, eq=False)
class Target:
    """Where goals are reached, and how far that is.

    Attributes:
        goals: as the episode has them.
        stops: where they are reached, world [m], an array of shape (n, 3) for each goal of a
            sequence, or one for all goals; none for exploring.
        fields: distance to each of the stops from each cell, by flat id, inf for no path [m].
        rest: length of the way after each of the stops [m]; between stops of several places, as
            objects and rooms have, at least: a leg counts from the places nearest to the next stop.
    """

    goals: tuple[Goal, ...]
    stops: Sequence[Float] = ()
    fields: Sequence[Float] = ()
    rest: Sequence[float] = (0.0,)


def find_target(
    finder: PathFinder, goals: Sequence[Goal], *, in_order: bool = False
) -> Target | None:
    """Find where one of several goals is reached, or all in order; None: nobody can stand there."""
    if goals[0].share is not None:
        return Target(tuple(goals))
    stages = [[goal] for goal in goals] if in_order else [goals]
    search = finder.search
    cells = [np.unique(np.concatenate([cells_of(finder, g) for g in stage])) for stage in stages]
    if not all(map(len, cells)):
        return None
    fields = [search.field(each, weighted=False) for each in cells]
    legs = [f[c].min() for f, c in zip(fields[1:], cells, strict=False)]
    rest = [*np.cumsum(legs[::-1])[::-1].tolist(), 0.0]
    return Target(tuple(goals), [search.flat.positions(each) for each in cells], fields, rest)


def cells_of(finder: PathFinder, goal: Goal) -> Int:
    """The free cells from which a goal counts as reached, by flat id, each once; maybe none.

    Of an object those of its view points; of a room its own; of a position its cell, or where no
    agent can stand there, that of the nearest place within 0.5 m or the goal's radius.
    """
    flat = finder.search.flat
    if goal.room is not None:
        return np.flatnonzero(finder.search.allowed(room=goal.room))
    points = [view.position for view in goal.view_points]
    if not points and goal.position is not None:
        points = [goal.position]
    if not points:
        return np.empty(0, dtype=np.int64)
    p, reach = check_positions(points, flat.num_levels), max(SNAP, goal.radius)
    _, cells = snap(flat, flat.free, p, same_level=False, max_distance=reach)
    return np.unique(cells[cells >= 0])


def paths_through(finder: PathFinder, start: Sequence[float], stops: Sequence[Float]) -> list[Path]:
    """The paths from a start through stops, to the nearest place of each; up to one without."""
    here, found = np.array(start), []
    for places in stops:
        path = finder.find_path(here, places)
        if path is None:
            break
        found.append(path)
        here = path.positions[-1]
    return found


def points_along(paths: Sequence[Path]) -> Float:
    """Points on paths in a row, at most `SPACING` apart, world [m], shape (n, 3)."""
    points = [
        path.at(distance)
        for path in paths
        for distance in np.linspace(0.0, path.length, math.ceil(path.length / SPACING) + 1)
    ]
    return np.array(points).reshape(-1, 3)


# ---------------------------------------------------------------- objects and rooms


@dataclass(eq=False)
class GoalFinder:
    """Finds the goals of a task on one grid."""

    finder: PathFinder
    task: Task
    _seen: dict[str, Goal] = field(default_factory=dict, init=False)

    @cached_property
    def choices(self) -> dict[str, list[str]]:
        """Names of objects, or ids of rooms, by what an episode may ask for."""
        if self.task.kind == "object":
            names = {name: (name,) for name in self.object_cells}
            chosen = self._choose(names, self.task.objects, "object")
            by_category: dict[str, list[str]] = {}
            for name in names:
                by_category.setdefault(category_of(name), []).append(name)
            return chosen or dict(sorted(by_category.items()))
        rooms = self.finder.rooms.rooms
        known = {room.id: tuple(name for name in (room.name, room.id) if name) for room in rooms}
        indoors = {room.id: [room.id] for room in rooms if not room.outdoors}
        return self._choose(known, self.task.rooms, "room") or indoors

    def _choose(
        self,
        known: Mapping[str, Sequence[str]],
        given: Sequence[str] | Mapping[str, Sequence[str]],
        kind: str,
    ) -> dict[str, list[str]]:
        """What fits the patterns of each category; of plain patterns, each by itself."""
        asked = given if isinstance(given, Mapping) else {pattern: [pattern] for pattern in given}
        found: dict[str, list[str]] = {}
        for label, patterns in asked.items():
            fitting = [
                key
                for key, names in known.items()
                if any(fnmatchcase(name, pattern) for name in names for pattern in patterns)
            ]
            if not fitting:
                names = [name for each in known.values() for name in each]
                what = f"{kind} of category" if asked is given else kind
                where = scene_of(self.finder.grid)
                raise QueryError(f"no {what} {label!r} in {where!r}: {suggest(label, names)}")
            found |= {label: fitting} if asked is given else {key: [key] for key in fitting}
        return found

    def goals_of(self, label: str) -> list[Goal]:
        """A goal for each object or room of a choice; objects that nobody can see are left out."""
        if self.task.kind == "room":
            kind = label if isinstance(self.task.rooms, Mapping) else None
            rooms = [room for room in self.finder.rooms.rooms if room.id in self.choices[label]]
            return [
                Goal(
                    position=r.centroid, name=r.name, room=r.id, category=kind,
                    radius=self.task.reach,
                )
                for r in rooms
            ]  # fmt: skip
        by_name = bool(self.task.objects) and not isinstance(self.task.objects, Mapping)
        for name in self.choices[label]:
            if name not in self._seen:
                self._seen[name] = self._look_at(name, category_of(label) if by_name else label)
        goals = [self._seen[name] for name in self.choices[label]]
        return [goal for goal in goals if goal.view_points]

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
                # of no entries there is a part, too
                pairs = list(zip(source.entries, parts, strict=False))
            else:
                pairs = [(entry, np.array([cell])) for cell, entry in source.items()]
            for entry, cells in pairs:
                other.update(names_in(entry, "walls"), names_in(entry, "doors"))
                for name in names_in(entry, "objects"):
                    found.setdefault(name, []).append(start + cells)
        return {n: np.unique(np.concatenate(found[n])) for n in sorted(found.keys() - other)}

    def _look_at(self, name: str, category: str) -> Goal:
        """An object and where it is seen from: free cells near it, with nothing between.

        They are `SPACING` apart, or all where none lies on that lattice.
        """
        search, cells = self.finder.search, self.object_cells[name]
        flat, distance = search.flat, self.task.view_distance
        middle = flat.positions(cells).mean(axis=0)
        is_own = np.zeros(flat.num_cells, dtype=np.int32)
        is_own[cells] = 1
        views = []
        for level in np.unique(flat.level_of(cells)).tolist():
            here = cells[flat.level_of(cells) == level]
            own = flat.positions(here)[:, :2]
            start, width = flat.cells_of(level).start, int(flat.layout.width[level])
            free, places, tree = search.keep("free", level, partial(self._free_cells, level))
            low, high = own.min(axis=0), own.max(axis=0)
            reach = float(np.hypot(*(high - low))) / 2 + distance
            found = tree.query_ball_point((low + high) / 2, reach, return_sorted=True)
            near, points = free[found], places[found]
            if not len(near):
                continue
            apart, nearest = spatial.cKDTree(own).query(points[:, :2])
            every = max(1, round(SPACING / float(flat.layout.cell_size[level])))
            row, col = np.divmod(near - start, width)
            is_near = apart <= distance
            thin = is_near & (row % every == 0) & (col % every == 0)
            for k in np.flatnonzero(thin if thin.any() else is_near):
                # the line leaves the object through its own cells, then it must meet clear ones
                ends = near[k : k + 1], np.ascontiguousarray(points[k : k + 1, :2])
                place = here[nearest[k]], own[nearest[k]]
                if walks.first_in_sight(*search.sight, is_own, *place, *ends) == 0:
                    dx, dy = middle[:2] - points[k, :2]
                    views.append(ViewPoint(tuple(points[k].tolist()), math.atan2(dy, dx)))
        x, y, z = middle.tolist()
        return Goal(
            position=(x, y, z), radius=self.task.reach, name=name, category=category,
            view_points=tuple(views),
        )  # fmt: skip

    def _free_cells(self, level: int) -> tuple[Int, Float, Any]:
        """The free cells of a level, their positions, and these to look for near ones."""
        flat = self.finder.search.flat
        span = flat.cells_of(level)
        cells = span.start + np.flatnonzero(flat.free[span])
        points = flat.positions(cells)
        return cells, points, spatial.cKDTree(points[:, :2])


def category_of(name: str) -> str:
    """The category that an object's name says: without what counts it, in lower case."""
    return COUNTER.sub("", name).lower() or name.lower()
