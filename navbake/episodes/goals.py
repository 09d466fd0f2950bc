"""What episodes ask for: tasks, their goals in a scene, and the cells where these are reached."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
import numpy as np

from navbake.episodes.episode import TASKS, Goal, Length, Record, ViewPoint, check_word, scene_of
from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lazy import lazy
from navbake.navgrid.cells import check_positions
from navbake.navgrid.user_data import UserData, names_in
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.places import snap_to_cells
from navbake.types import Float, Int

spatial = lazy("scipy.spatial")  # saves scipy at start-up

SNAP = 0.5  # from a position in no free cell to the nearest one, at most [m]
SPACING = 0.25  # between view points, and between points of a path [m]
COUNTER = re.compile(r"[\W_]*\d[\d\W_]*$")  # the number that ends a name as chair_1


class Task(Record, frozen=True, kw_only=True):
    """What the episodes of a set ask for."""

    name: str = "point"  #: One of `TASKS`.
    objects: tuple[str, ...] | dict[str, tuple[str, ...]] = ()
    """Patterns of names, or patterns by category; all objects by the categories of their names
    unless given."""
    rooms: tuple[str, ...] | dict[str, tuple[str, ...]] = ()
    """Patterns of ids or names, or patterns by type, as ``{bath: [bath*, wc]}``; each room that
    isn't outdoors unless given."""
    radius: Length | None = None  #: Of each `Goal` [m]; as `reach` has it unless given.
    view_distance: Length = 1.0  #: Of view points from an object, at most [m].
    length: Annotated[int, msgspec.Meta(ge=2)] = 3  #: Number of goals of a sequence.
    of: Literal["point", "object", "room"] = "point"  #: What the goals of a sequence are.
    share: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.9
    """Of the free area of the start's island that is to be explored."""

    def __post_init__(self) -> None:
        check_word(self.name, TASKS, "task")

    @property
    def kind(self) -> str:
        """What each goal is: ``point``, ``object``, ``room`` or ``explore``."""
        return self.of if self.name == "sequence" else self.name

    @property
    def reach(self) -> float:
        """The radius, or its default for what each goal is [m]."""
        known = {"point": 0.2, "object": 0.1, "room": 0.0, "explore": 3.0}
        return known[self.kind] if self.radius is None else self.radius


class Stops(NamedTuple):
    """Where the goals of an episode are reached, and how far that is."""

    goals: tuple[Goal, ...]
    places: Sequence[Float] = ()
    """Of each stop, world [m], shape (n, 3): a stop for each goal of a sequence, else one for all;
    none to explore."""
    fields: Sequence[Float] = ()
    """Distance from each cell to each stop, by flat id, inf for no path [m]."""
    rest: Sequence[float] = (0.0,)
    """Length of the path after each stop [m]; a lower bound where stops have several places, as
    each leg begins at the place that is nearest to the next stop."""


def find_stops(
    finder: PathFinder, goals: Sequence[Goal], *, in_order: bool = False
) -> Stops | None:
    """Find where one of several goals is reached, or all in order; None where no agent can be."""
    if goals[0].share is not None:
        return Stops(tuple(goals))
    search = finder.search
    each = [cells_of(finder, goal) for goal in goals]
    cells = each if in_order else [np.unique(np.concatenate(each))]
    if not all(map(len, cells)):
        return None
    fields = [search.field(each, by="length") for each in cells]
    legs = [f[c].min() for f, c in zip(fields[1:], cells, strict=False)]
    rest = [*np.cumsum(legs[::-1])[::-1].tolist(), 0.0]
    return Stops(tuple(goals), [search.flat.positions(each) for each in cells], fields, rest)


def cells_of(finder: PathFinder, goal: Goal) -> Int:
    """The free cells where a goal is reached, by flat id, each once; maybe none.

    They are those of the room, of the view points, or of the position: the nearest free cell within
    0.5 m or the goal's radius.
    """
    flat = finder.search.flat
    if goal.room is not None:
        return np.flatnonzero(finder.search.allowed(room=goal.room))
    points = [view.position for view in goal.view_points] or [p for p in [goal.position] if p]
    if not points:
        return np.empty(0, dtype=np.int64)
    p = check_positions(points, flat.num_levels)
    reach = max(SNAP, goal.radius)
    _, cells = snap_to_cells(flat, flat.free, p, same_level=False, max_distance=reach)
    return np.unique(cells[cells >= 0])


def path_through(
    finder: PathFinder, start: Sequence[float], stops: Sequence[Float]
) -> dict[str, tuple[Any, ...]]:
    """The ``path`` from a start through stops, and the ``rooms`` and ``doors`` along it.

    It goes to the nearest place of each stop, by points at most `SPACING` apart; empty for none.
    """
    here = np.array(start)
    points = list[list[float]]()
    rooms = list[str]()
    doors = list[str]()
    for places in stops:
        path = finder.find_path(here, places)
        if path is None:
            return {}
        steps = np.linspace(0.0, path.length, math.ceil(path.length / SPACING) + 1)
        points += path.at(steps).tolist()
        rooms += path.rooms[rooms[-1:] == path.rooms[:1] :]
        doors += path.doors
        here = path.positions[-1]
    return {"path": tuple(map(tuple, points)), "rooms": tuple(rooms), "doors": tuple(doors)}


@dataclass(eq=False)
class GoalFinder:
    """Lists the goals of a task on one grid."""

    finder: PathFinder
    task: Task
    _known: dict[str, list[Goal]] = field(default_factory=dict, init=False)

    @cached_property
    def choices(self) -> dict[str, list[str]]:
        """Names of objects, or ids of rooms, by what an episode may ask for.

        That is each category, with what fits its patterns; of plain patterns, each that fits.
        """
        given: tuple[str, ...] | dict[str, tuple[str, ...]]
        if self.task.kind == "object":
            given = self.task.objects
            names = {name: [name] for name in self.object_cells}
            default = sorted((category_of(name), name) for name in names)
        else:
            given = self.task.rooms
            rooms = self.finder.rooms.rooms
            names = {room.id: [name for name in (room.name, room.id) if name] for room in rooms}
            default = [(room.id, room.id) for room in rooms if not room.outdoors]
        found: dict[str, list[str]] = {}
        for label, key in () if given else default:
            found.setdefault(label, []).append(key)
        for label in given:
            patterns = given[label] if isinstance(given, dict) else (label,)
            fitting = [
                key
                for key, known in names.items()
                if any(fnmatchcase(name, pattern) for name in known for pattern in patterns)
            ]
            if not fitting:
                what = f"{self.task.kind}{' of category' * isinstance(given, dict)} {label!r}"
                hint = suggest(label, [name for known in names.values() for name in known])
                raise QueryError(f"no {what} in {scene_of(self.finder.grid)!r}: {hint}")
            by_label = {label: fitting}
            found |= by_label if isinstance(given, dict) else {key: [key] for key in fitting}
        return found

    def goals_of(self, label: str) -> list[Goal]:
        """A goal for each object or room of a choice; objects without view points are left out."""
        given = getattr(self.task, f"{self.task.kind}s")
        keys = self.choices[label]
        category = label if isinstance(given, dict) else None
        if self.task.kind == "room":
            reach = self.task.reach
            rooms = self.finder.rooms.rooms
            return [
                Goal(position=r.centroid, name=r.name, room=r.id, category=category, radius=reach)
                for r in rooms
                if r.id in keys
            ]
        if label not in self._known:
            goals = [self._look_at(name, category or category_of(name)) for name in keys]
            self._known[label] = [goal for goal in goals if goal.view_points]
        return self._known[label]

    @cached_property
    def object_cells(self) -> dict[str, Int]:
        """The cells of each object, by flat id, ascending; walls and doors are no objects."""
        found: dict[str, list[Int]] = {}
        other: set[str] = set()
        grid = self.finder.grid
        flat = self.finder.search.flat
        for start, level in zip(flat.layout.start.tolist(), grid.levels, strict=False):
            cells, number, entries = UserData.of(level.user_data).shared()
            order = np.argsort(number, kind="stable")
            ends = np.cumsum(np.bincount(number, minlength=len(entries)))
            parts = np.split(cells[order], ends[:-1])
            for entry, own in zip(entries, parts, strict=False):  # one part of no entries
                other.update(names_in(entry, "walls"), names_in(entry, "doors"))
                for name in names_in(entry, "objects"):
                    found.setdefault(name, []).append(start + own)
        return {n: np.unique(np.concatenate(found[n])) for n in sorted(found.keys() - other)}

    def _look_at(self, name: str, category: str) -> Goal:
        """An object and its view points: free cells near it, with nothing between.

        They are `SPACING` apart, or all where none lies on that lattice.
        """
        search = self.finder.search
        distance = self.task.view_distance
        flat = search.flat
        cells = self.object_cells[name]
        x, y, z = flat.positions(cells).mean(axis=0).tolist()
        is_own = np.zeros(flat.num_cells, dtype=np.int32)
        is_own[cells] = 1
        views = []
        on, row, col = flat.split(cells)
        for level in np.unique(on).tolist():
            here = on == level
            size = float(flat.layout.cell_size[level])
            own = flat.positions(cells[here])[:, :2]
            pad = math.ceil(distance / size)
            top = max(0, int(row[here].min()) - pad)
            left = max(0, int(col[here].min()) - pad)
            bottom = int(row[here].max()) + pad + 1
            right = int(col[here].max()) + pad + 1
            span = flat.cells_of(level)
            width = int(flat.layout.width[level])
            window = flat.free[span].reshape(-1, width)[top:bottom, left:right]
            rows, cols = np.nonzero(window) + np.array([[top], [left]])
            near = span.start + rows * width + cols
            points = flat.positions(near)
            apart, nearest = spatial.cKDTree(own).query(points[:, :2])
            every = max(1, round(SPACING / size))
            is_near = apart <= distance
            on_lattice = is_near & (rows % every == 0) & (cols % every == 0)
            for k in np.flatnonzero(on_lattice if on_lattice.any() else is_near):
                # the line leaves the object through its own cells, then it must meet clear ones
                place = np.ascontiguousarray(points[k : k + 1, :2])
                first_seen = search.first_in_sight(
                    cell=cells[here][nearest[k]],
                    point=own[nearest[k]],
                    cells=near[k : k + 1],
                    points=place,
                    room=is_own,
                )
                if first_seen == 0:
                    heading = math.atan2(y - points[k, 1], x - points[k, 0])
                    views.append(ViewPoint(tuple(points[k].tolist()), heading))
        return Goal(
            position=(x, y, z), radius=self.task.reach, name=name, category=category,
            view_points=tuple(views),
        )  # fmt: skip


def category_of(name: str) -> str:
    """The category that an object's name says: without its number, in lower case."""
    return COUNTER.sub("", name).lower() or name.lower()
