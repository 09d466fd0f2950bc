"""Tasks of episodes, their goals in a scene, and the cells where goals are reached."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Annotated, Literal, NamedTuple, TypedDict

import msgspec
import numpy as np

from navbake.episodes.episode import (
    GRID_TASKS,
    Goal,
    Length,
    Record,
    Stance,
    ViewPoint,
    check_word,
    scene_of,
)
from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lazy import lazy
from navbake.navgrid.cells import check_positions
from navbake.navgrid.user_data import UserData, find_category, names_in
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.places import snap_to_cells
from navbake.runtime.stand import ReachTest, stand_poses
from navbake.runtime.stand_cells import StandRules
from navbake.types import Float, Int, Vector3

spatial = lazy("scipy.spatial")  # saves scipy at start-up

MAX_SNAP_DISTANCE = 0.5  # largest distance from a position to the free cell that counts for it [m]
VIEW_POINT_SPACING = 0.25  # between view points, and between points of a path [m]
MAX_REACH_POSES = 16  # poses of a goal that is to be reached
MAX_REACH_TESTS = 256  # tests that a path finder keeps


class Task(Record, frozen=True, kw_only=True):
    """The task of a set's episodes: the kind of their goals, and when a goal is reached."""

    name: str = "point"  #: One of `GRID_TASKS`.
    objects: tuple[str, ...] | dict[str, tuple[str, ...]] = ()
    """Patterns of names; or category -> patterns of names. By default all objects, each in the
    category that its name tells."""
    rooms: tuple[str, ...] | dict[str, tuple[str, ...]] = ()
    """Patterns of ids or names; or type -> patterns, such as ``{bath: [bath*, wc]}``. By default
    all rooms that aren't outdoors."""
    radius: Length | None = None  #: Radius of each `Goal` [m]; None for a default, see `reach`.
    view_distance: Length = 1.0  #: Largest distance of a view point from its object [m].
    length: Annotated[int, msgspec.Meta(ge=2)] = 3  #: Number of goals of a sequence.
    of: Literal["point", "object", "room"] = "point"  #: Kind of the goals of a sequence.
    share: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.9
    """Share of the free area of the start's island that has to be explored."""
    stance: Stance = Stance()
    """How an agent has to stand to reach an object, for the task ``reach``."""

    def __post_init__(self) -> None:
        check_word(self.name, GRID_TASKS, "task")
        if self.name == "reach" and self.radius is not None:
            raise ValueError("expected no radius of a task reach: its stance says what is in reach")
        if self.objects and self.kind not in ("object", "reach"):
            raise ValueError(f"expected no objects of a task {self.name}: no goal of it is one")
        if self.rooms and self.kind != "room":
            raise ValueError(f"expected no rooms of a task {self.name}: no goal of it is one")

    @property
    def kind(self) -> str:
        """The kind of each goal: ``point``, ``object``, ``room``, ``explore`` or ``reach``."""
        return self.of if self.name == "sequence" else self.name

    @property
    def noun(self) -> str:
        """What each goal is, in a word: ``point``, ``object`` or ``room``."""
        return "object" if self.kind == "reach" else self.kind

    @property
    def reach(self) -> float:
        """The radius of each goal [m]: `radius`, or a default for the kind of the goals."""
        if self.radius is not None:
            return self.radius
        default_radii = {"point": 0.2, "object": 0.1, "room": 0.0, "explore": 3.0, "reach": 0.0}
        return default_radii[self.kind]


class Stops(NamedTuple):
    """The stops of an episode: the places where its goals are reached, and the distances to them.

    In a sequence, each goal has a stop of its own. In other tasks, all goals share one stop, as any
    one of them has to be reached. Exploring has no stops.

    Attributes:
        goals: the goals of the episode.
        places: for each stop an array of the places that belong to it, world x, y, z [m], shape
            (n, 3).
        distance_fields: for each stop an array with the distance from each cell of the grid to the
            stop [m], inf where there is no path; indexed by flat id.
        remaining_lengths: for each stop the length of the path from there through all later stops
            [m]. If a stop has several places, this is a lower bound: each leg begins at the place
            that is nearest to the next stop.
    """

    goals: tuple[Goal, ...]
    places: Sequence[Float] = ()
    distance_fields: Sequence[Float] = ()
    remaining_lengths: Sequence[float] = (0.0,)


def find_stops(
    finder: PathFinder, goals: Sequence[Goal], *, in_order: bool = False
) -> Stops | None:
    """Find the stops of an episode's goals.

    Args:
        finder: the path finder of the grid.
        goals: the goals of an episode.
        in_order: whether all goals have to be reached in their order; otherwise any one of them.

    Returns:
        The stops; None if there is a stop where an agent can stand at none of the places.
    """
    if goals[0].share is not None:
        return Stops(tuple(goals))
    search = finder.search
    cells_of_goals = [find_goal_cells(finder, goal) for goal in goals]
    cells_of_stops = cells_of_goals if in_order else [np.unique(np.concatenate(cells_of_goals))]
    if not all(map(len, cells_of_stops)):
        return None
    distance_fields = [search.compute_cost_field(cells, by="length") for cells in cells_of_stops]
    leg_lengths = [
        distance_field[cells].min()
        for distance_field, cells in zip(distance_fields[1:], cells_of_stops, strict=False)
    ]
    remaining_lengths = [*np.cumsum(leg_lengths[::-1])[::-1].tolist(), 0.0]
    places = [search.flat.positions(cells) for cells in cells_of_stops]
    return Stops(tuple(goals), places, distance_fields, remaining_lengths)


def find_goal_cells(finder: PathFinder, goal: Goal) -> Int:
    """Return the free cells where a goal is reached.

    For a room, these are its free cells. With a stance, they are those from which the goal's object
    is in reach. Otherwise, they are the free cells nearest to the goal's view points, or to its
    position if it has none. A cell counts only within 0.5 m, or within the goal's radius if that is
    larger.

    Args:
        finder: the path finder of the grid.
        goal: the goal.

    Returns:
        The cells' flat ids (numbers among the cells of all levels), each once; empty if there are
        none.
    """
    flat_grid = finder.search.flat
    if goal.room is not None:
        return np.flatnonzero(finder.search.mark_allowed(room=goal.room))
    if goal.stance is not None:
        return make_reach_test(finder, goal.name, goal.stance).cells
    places = [view_point.position for view_point in goal.view_points]
    if not places and goal.position:
        places = [goal.position]
    if not places:
        return np.empty(0, dtype=np.int64)
    positions = check_positions(places, flat_grid.num_levels)
    max_distance = max(MAX_SNAP_DISTANCE, goal.radius)
    _, cells = snap_to_cells(
        flat_grid, flat_grid.free, positions, same_level=False, max_distance=max_distance
    )
    return np.unique(cells[cells >= 0])


def make_reach_test(finder: PathFinder, name: str | None, stance: Stance) -> ReachTest:
    """Make the test whether an agent at a pose reaches an object.

    Args:
        finder: the path finder of the grid, which keeps the tests of the last objects.
        name: the object's name.
        stance: how the agent has to stand.

    Raises:
        QueryError: the grid has no such object.
    """

    def make_test() -> ReachTest:
        rules = stand_rules_of(stance)
        return ReachTest(finder.search, f"object:{name}", rules, stance.tolerance)

    return finder.search.cached_result("reach", (name, stance), make_test, MAX_REACH_TESTS)


def stand_rules_of(stance: Stance) -> StandRules:
    """Return the rules of a stance as `navbake.runtime.stand` takes them."""
    return StandRules(
        reach=stance.reach,
        footprint=stance.footprint or None,
        facing=None if stance.tolerance is None else "target",
        height=stance.height,
        sight=stance.sight,
        start=None,
    )


class RouteFields(TypedDict, total=False):
    """The fields of an `Episode` about a path: the path, and the rooms and doors along it."""

    path: tuple[Vector3, ...]
    rooms: tuple[str, ...]
    doors: tuple[str, ...]


def plan_path_through(
    finder: PathFinder, start: Sequence[float], stops: Sequence[Float]
) -> RouteFields:
    """Plan a path through stops; it goes through the nearest place of each stop.

    Args:
        finder: the path finder of the grid.
        start: the start, world x, y, z [m].
        stops: for each stop the array of its places, world x, y, z [m], shape (n, 3).

    Returns:
        The path, whose points are at most `VIEW_POINT_SPACING` apart, and the rooms and doors along
        it; empty if there is no path.
    """
    position = np.array(start)
    path_points = list[Vector3]()
    rooms = list[str]()
    doors = list[str]()
    for places in stops:
        path = finder.find_path(position, places)
        if path is None:
            return {}
        distances = np.linspace(0.0, path.length, math.ceil(path.length / VIEW_POINT_SPACING) + 1)
        path_points += map(tuple, path.at(distances).tolist())
        # a leg begins in the room in which the leg before ended
        rooms += path.rooms[1:] if rooms[-1:] == path.rooms[:1] else path.rooms
        doors += path.doors
        position = path.positions[-1]
    return {"path": tuple(path_points), "rooms": tuple(rooms), "doors": tuple(doors)}


@dataclass(eq=False)
class GoalFinder:
    """Lists the goals of a task on one grid."""

    finder: PathFinder
    task: Task
    _objects: dict[str, list[Goal]] = field(default_factory=dict, init=False)

    @cached_property
    def choices(self) -> dict[str, list[str]]:
        """The possible goals of an episode: label -> names of its objects, or ids of its rooms.

        An episode has a label, and all objects or rooms of the label are its goals. If the task has
        patterns for categories, the labels are these categories. If it has plain patterns, each
        object or room that matches one is a label of its own. Without patterns, the labels are the
        categories of all objects, or the ids of all indoor rooms.

        Raises:
            QueryError: no object or room matches a pattern.
        """
        if self.task.noun == "object":
            patterns = self.task.objects
            names_of_key = {name: [name] for name in self.object_cells}
        else:
            patterns = self.task.rooms
            names_of_key = {
                room.id: [name for name in (room.name, room.id) if name]
                for room in self.finder.rooms.rooms
            }
        keys_of_label: dict[str, list[str]] = {}
        if not patterns:
            for label, key in self._default_choices():
                keys_of_label.setdefault(label, []).append(key)
            return keys_of_label
        if isinstance(patterns, dict):
            for category, category_patterns in patterns.items():
                label = f"of category {category!r}"
                keys_of_label[category] = self._find_fitting(
                    names_of_key, category_patterns, category, label
                )
        else:
            for pattern in patterns:
                for key in self._find_fitting(names_of_key, (pattern,), pattern, repr(pattern)):
                    keys_of_label[key] = [key]
        return keys_of_label

    def _default_choices(self) -> list[tuple[str, str]]:
        """List pairs of a label and an object's name or a room's id, for tasks without patterns."""
        if self.task.noun == "object":
            return sorted((find_category(name), name) for name in self.object_cells)
        return [(room.id, room.id) for room in self.finder.rooms.rooms if not room.outdoors]

    def _find_fitting(
        self,
        names_of_key: dict[str, list[str]],
        patterns: Sequence[str],
        hint_word: str,
        pattern_text: str,
    ) -> list[str]:
        """Return the objects or rooms with a name that fits a pattern.

        Args:
            names_of_key: name of an object or id of a room -> its names.
            patterns: patterns of names.
            hint_word: a word of the patterns; if nothing fits, the error suggests a name like it.
            pattern_text: the patterns as the error describes them.

        Raises:
            QueryError: no object or room fits.
        """
        matching_keys = [
            key
            for key, names in names_of_key.items()
            if any(fnmatchcase(name, pattern) for name in names for pattern in patterns)
        ]
        if not matching_keys:
            hint = suggest(hint_word, [name for names in names_of_key.values() for name in names])
            scene = scene_of(self.finder.grid)
            raise QueryError(f"no {self.task.noun} {pattern_text} in {scene!r}: {hint}")
        return matching_keys

    def make_goals(self, label: str) -> list[Goal]:
        """Make a goal for each object or room of a label, except objects without view points.

        Args:
            label: a key of `choices`.
        """
        patterns = self.task.rooms if self.task.kind == "room" else self.task.objects
        category = label if isinstance(patterns, dict) else None
        keys = self.choices[label]
        if self.task.kind == "room":
            return [
                Goal(
                    position=room.centroid,
                    name=room.name,
                    room=room.id,
                    category=category,
                    radius=self.task.reach,
                )
                for room in self.finder.rooms.rooms
                if room.id in keys
            ]
        if label not in self._objects:
            goals = [self._object_goal(name, category or find_category(name)) for name in keys]
            self._objects[label] = [goal for goal in goals if goal.view_points]
        return self._objects[label]

    @cached_property
    def object_cells(self) -> dict[str, Int]:
        """Name of each object -> flat ids of the cells that it stands in, ascending.

        A flat id is a cell's number among the cells of all levels. The cells are those whose user
        data list the object. Walls and doors are left out.
        """
        cells_of_name: dict[str, list[Int]] = {}
        walls_and_doors: set[str] = set()
        grid = self.finder.grid
        flat_grid = self.finder.search.flat
        for first_cell, level in zip(flat_grid.layout.start.tolist(), grid.levels, strict=False):
            cells, entry_of_cell, entries = UserData.of(level.user_data).shared_entries()
            sort_indices = np.argsort(entry_of_cell, kind="stable")
            num_cells_of_entry = np.bincount(entry_of_cell, minlength=len(entries))
            cells_of_entries = np.split(cells[sort_indices], np.cumsum(num_cells_of_entry)[:-1])
            # without entries there is one empty array of cells
            for user_data, entry_cells in zip(entries, cells_of_entries, strict=False):
                walls_and_doors.update(names_in(user_data, "walls"), names_in(user_data, "doors"))
                for name in names_in(user_data, "objects"):
                    cells_of_name.setdefault(name, []).append(first_cell + entry_cells)
        object_names = sorted(cells_of_name.keys() - walls_and_doors)
        return {name: np.unique(np.concatenate(cells_of_name[name])) for name in object_names}

    def _object_goal(self, name: str, category: str) -> Goal:
        """Make the goal for an object, with its view points."""
        flat_grid = self.finder.search.flat
        cells = self.object_cells[name]
        x, y, z = flat_grid.positions(cells).mean(axis=0).tolist()
        if self.task.kind == "reach":
            return self._reach_goal(name, category, (x, y, z))
        view_points = []
        for position in self._find_view_positions(cells):
            heading = math.atan2(y - position[1], x - position[0])
            view_points.append(ViewPoint(position, heading))
        return Goal(
            position=(x, y, z),
            radius=self.task.reach,
            name=name,
            category=category,
            view_points=tuple(view_points),
        )

    def _reach_goal(self, name: str, category: str, cells_middle: Vector3) -> Goal:
        """Make the goal for an object that is to be reached, with poses that reach it.

        Args:
            name: the object's name.
            category: its category.
            cells_middle: the middle of its cells [m], which counts if the grid has no box of it.
        """
        search = self.finder.search
        position = cells_middle
        if name in search.names.boxes:
            lower_corner, upper_corner = search.names.boxes[name].reshape(2, 3)
            x, y, z = ((lower_corner + upper_corner) / 2.0).tolist()
            position = (x, y, z)
        poses = stand_poses(
            search,
            f"object:{name}",
            stand_rules_of(self.task.stance),
            count=MAX_REACH_POSES,
            spread=VIEW_POINT_SPACING,
            seed=0,
        )
        view_points = [
            ViewPoint(tuple(pose_position), heading)
            for pose_position, heading in zip(
                poses.positions.tolist(), poses.headings.tolist(), strict=True
            )
        ]
        return Goal(
            position=position,
            radius=self.task.reach,
            name=name,
            category=category,
            view_points=tuple(view_points),
            stance=self.task.stance,
        )

    def _find_view_positions(self, object_cells: Int) -> list[Vector3]:
        """Find the places from which an object is visible: centres of free cells near the object.

        On each level, only cells on a lattice with a spacing of `VIEW_POINT_SPACING` are tried; if
        no cell near the object is on it, all near cells are.

        Args:
            object_cells: flat ids of the object's cells, shape (n,).

        Returns:
            World x, y, floor z [m] of each.
        """
        search = self.finder.search
        flat_grid = search.flat
        is_object = np.zeros(flat_grid.num_cells, dtype=np.int32)
        is_object[object_cells] = 1
        positions: list[Vector3] = []
        level_of_cell, object_row, object_col = flat_grid.to_cells(object_cells)
        for level in np.unique(level_of_cell).tolist():
            is_on_level = level_of_cell == level
            cell_size = float(flat_grid.layout.cell_size[level])
            level_cells = object_cells[is_on_level]
            object_xy = flat_grid.positions(level_cells)[:, :2]
            # a window of the level round the object
            margin = math.ceil(self.task.view_distance / cell_size)
            top_row = max(0, int(object_row[is_on_level].min()) - margin)
            left_col = max(0, int(object_col[is_on_level].min()) - margin)
            bottom_row = int(object_row[is_on_level].max()) + margin + 1
            right_col = int(object_col[is_on_level].max()) + margin + 1
            level_cell_range = flat_grid.cells_of(level)
            num_cols = int(flat_grid.layout.width[level])
            is_free_in_window = flat_grid.free[level_cell_range].reshape(-1, num_cols)[
                top_row:bottom_row, left_col:right_col
            ]
            rows, cols = np.nonzero(is_free_in_window) + np.array([[top_row], [left_col]])
            near_cells = level_cell_range.start + rows * num_cols + cols
            near_positions = flat_grid.positions(near_cells)
            object_distance, nearest_index = spatial.cKDTree(object_xy).query(near_positions[:, :2])
            lattice_stride = max(1, round(VIEW_POINT_SPACING / cell_size))
            is_near = object_distance <= self.task.view_distance
            is_on_lattice = is_near & (rows % lattice_stride == 0) & (cols % lattice_stride == 0)
            for i in np.flatnonzero(is_on_lattice if is_on_lattice.any() else is_near):
                # the line first runs over cells of the object, then it must meet only clear cells
                first_visible_index = search.first_in_sight(
                    cell=level_cells[nearest_index[i]],
                    point=object_xy[nearest_index[i]],
                    cells=near_cells[i : i + 1],
                    points=np.ascontiguousarray(near_positions[i : i + 1, :2]),
                    room_numbers=is_object,
                )
                if first_visible_index == 0:
                    x, y, z = near_positions[i].tolist()
                    positions.append((x, y, z))
        return positions
