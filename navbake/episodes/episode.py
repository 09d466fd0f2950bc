"""Episodes: where an agent starts, what it has to reach, and on which grid both were drawn.

Positions are world x, y, z [m], z up: on a floor, or of a flight, those of the middle of the ball
that flies. Headings [rad] are 0 along x and grow towards y.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from hashlib import sha256
from typing import Annotated, Any

import msgspec
import numpy as np

from navbake.errors import QueryError, count_of
from navbake.known_names import find_similar_names, suggest
from navbake.navgrid import links
from navbake.navgrid.grid import NavGrid
from navbake.runtime.agents import find_agent
from navbake.types import Vector3

GRID_TASKS = ("point", "object", "room", "sequence", "explore", "reach")
"""Tasks on navigation grids."""

FLY_TASK = "fly"
"""The task of flights through voxels, to a point."""

TASKS = (*GRID_TASKS, FLY_TASK)
FORMAT = "navbake-episodes"
VERSION = 1
CLASS_EDGES: dict[str, tuple[float, ...]] = {
    "distance": (1.0, 3.0, 6.0, 10.0, 20.0, 40.0),
    "ratio": (1.0, 1.1, 1.25, 1.5, 2.0),
    "doors": (0.0, 1.0, 2.0, 3.0, 5.0),
    "rooms": (1.0, 2.0, 3.0, 4.0, 6.0),
    "levels": (0.0, 1.0, 2.0),
}
"""Measure of an episode -> lower edges of the classes that its values are sorted into."""

Length = Annotated[float, msgspec.Meta(ge=0)]
"""A length [m]."""


def check_word(value: str, words: Collection[str], name: str) -> None:
    """Check that a word is one of the allowed words.

    Args:
        value: the value.
        words: the allowed words.
        name: what the value is, for the error.

    Raises:
        ValueError: the value is none of them; the message suggests a similar word.
    """
    if value not in words:
        prefix_words = [word for word in words if str(value).startswith(word)]
        similar_words = find_similar_names(value, words) or prefix_words
        hint = f"; did you mean {similar_words[0]!r}?" if similar_words else ""
        raise ValueError(f"expected one of {', '.join(words)} as {name}, got {value!r}{hint}")


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base class of what a set of episodes holds: episodes, goals, the header and so on.

    In files, fields have the same names as here.
    """


class ViewPoint(Record, frozen=True, omit_defaults=True):
    """A place from which an object is visible; for the task ``reach``, in reach."""

    position: Vector3  #: World x, y and floor z [m].
    heading: float  #: The heading that looks at the object [rad].
    iou: float | None = None  #: Share of the picture that the object fills, if it was measured.


class Stance(Record, frozen=True, kw_only=True, omit_defaults=True):
    """How an agent has to stand to reach an object, by the rules of `PathFinder.stand_poses`."""

    reach: tuple[Length, Length] = (0.3, 0.8)
    """Least and greatest distance from the agent's axis to the object [m]."""
    tolerance: Annotated[float, msgspec.Meta(ge=0)] | None = math.pi / 8
    """Largest angle between the agent's heading and that of `PathFinder.stand_poses` in the same
    cell [rad]; None for any heading."""
    sight: bool | Length = True
    """Whether the object must be in sight of the agent's height, or the eye's height [m]."""
    height: Length | None = None
    """Height of the shoulder over the floor, for distances in space [m]; None to measure on the
    map."""
    footprint: tuple[tuple[float, float], ...] = ()
    """Outline of the base, x ahead, y to the left [m]; () for a disc of the grid's radius."""

    @property
    def needs_heading(self) -> bool:
        """Whether the agent's heading decides if it reaches the object."""
        return self.tolerance is not None or bool(self.footprint)


class Goal(Record, frozen=True, kw_only=True, omit_defaults=True):
    """A goal of an agent: a point, an object, a room, or a share of the free area to explore."""

    position: Vector3 | None = None
    """World x, y, z [m]; the middle of an object, the centroid of a room."""
    radius: Length = 0.0
    """The goal is reached within this distance along the floor (of a flight, through the air) from
    the point, or from the nearest view point [m]. A room is reached in any of its cells. For
    exploring: how far the agent sees."""
    name: str | None = None  #: Name of the object or the room.
    category: str | None = None  #: Category of the object, or type of the room.
    room: str | None = None  #: Id of the room.
    view_points: tuple[ViewPoint, ...] = ()
    """Places from which the object is visible. With a stance, some of the poses that reach it."""
    stance: Stance | None = None
    """How the agent has to stand to reach the object; None for other tasks than ``reach``."""
    share: Annotated[float, msgspec.Meta(gt=0, le=1)] | None = None
    """Share of the free area that has to be explored; None for other tasks."""


class Episode(Record, frozen=True, kw_only=True, omit_defaults=True):
    """A start of an agent, and the goals that it has to reach from there."""

    id: str  #: Its id, unique in the set.
    scene: str  #: Id of the scene, which is the `scene` of a grid of the header.
    task: str  #: One of `TASKS`.
    start: Vector3  #: World x, y and floor z, or z of a flight [m].
    heading: float  #: Heading at the start [rad].
    goals: tuple[Goal, ...]  #: Any one has to be reached; in a ``sequence`` all, in order.
    distance: Length | None = None
    """Length, seen from above, of the shortest path over cells to the nearest place of a goal, or
    through all goals of a ``sequence`` [m]; of a flight, of the straight line or else the shortest
    route over voxels. None if it is unknown or has no meaning."""
    straight: Length | None = None  #: Distance to the goals straight through the air [m].
    split: str | None = None  #: The part of the set that it belongs to, such as ``train``.
    room: str | None = None  #: Id of the room of the start.
    levels: tuple[int, ...] = ()  #: Level of the start, and level of the goal.
    doors: tuple[str, ...] | None = None  #: Ids of doors along the path; None without a path.
    rooms: tuple[str, ...] | None = None  #: Ids of rooms along the path; None without a path.
    path: tuple[Vector3, ...] = ()  #: A path to follow, world x, y, z [m].
    instruction: str | None = None  #: The task in words.
    extra: dict[str, Any] = {}  #: Fields of other programs' formats.

    def __post_init__(self) -> None:
        check_word(self.task, TASKS, "task")
        if not self.goals:
            raise ValueError(f"episode {self.id!r} has no goal")

    @property
    def ratio(self) -> float | None:
        """`distance` divided by `straight`, >= 1; None if either is unknown or 0."""
        return self.distance / self.straight if self.distance and self.straight else None

    @property
    def measures(self) -> dict[str, float | None]:
        """Name of each measure in `CLASS_EDGES` -> its value for this episode; None if unknown."""
        return {
            "distance": self.distance,
            "ratio": self.ratio,
            "doors": len(self.doors or ()),
            "rooms": len(self.rooms or ()),
            "levels": abs(self.levels[0] - self.levels[-1]) if self.levels else 0,
        }


class Agent(Record, frozen=True, kw_only=True):
    """The agent that the episodes were generated for."""

    radius: Length  #: Its radius [m].
    height: Length  #: Its height [m]; of a ball that flies, twice its radius.
    speed: float | None = None  #: Its highest speed [m/s]; None if unknown.
    name: str | msgspec.UnsetType = msgspec.UNSET
    """Name of an agent of the grid; it decides which links and areas may be used. Not set if all
    may be used."""


class GridEntry(Record, frozen=True, kw_only=True):
    """A grid, or voxels, that episodes were drawn on."""

    scene: str  #: The scene's id.
    digest: str
    """`digest_of` the grid, after it was inflated for the agent if need be; `digest_of_voxels`."""
    file: str | None = None  #: Name of the grid's file; None if it was in memory.


class Header(Record, frozen=True, kw_only=True):
    """The header of a set of episodes: the grids, agent and rules by which they were drawn.

    It is empty for sets of other programs.
    """

    format: str = FORMAT
    version: int = VERSION  #: Version of the format.
    agent: Agent | None = None  #: The agent that the episodes are for.
    grids: tuple[GridEntry, ...] = ()  #: The grids that the episodes were drawn on.
    sampler: dict[str, Any] = {}
    """The task, the rules, the count and the splits, as JSON; of flights, also the heights that the
    ball keeps to, and what unknown voxels count as."""
    seed: int | None = None  #: Seed of the random numbers.
    rejected: dict[str, int] = {}  #: Reason -> number of draws that were refused for it.


class EpisodeSet(msgspec.Struct, frozen=True):
    """A set of episodes with unique ids.

    Attributes:
        header: the grids, agent and rules by which the episodes were drawn.
        episodes: the episodes, in the set's order.

    Raises:
        ValueError: two episodes have the same id.
    """

    header: Header
    episodes: tuple[Episode, ...]

    def __post_init__(self) -> None:
        ids: set[str] = set()
        for episode in self.episodes:
            if episode.id in ids:
                raise ValueError(f"expected unique ids, got {episode.id!r} twice")
            ids.add(episode.id)

    def __len__(self) -> int:
        return len(self.episodes)

    def __repr__(self) -> str:
        scenes_text = count_of(len({episode.scene for episode in self.episodes}), "scene")
        tasks_text = ", ".join(sorted({episode.task for episode in self.episodes})) or "no task"
        agent = self.header.agent
        radius = "unknown radius" if agent is None else f"radius {agent.radius:g} m"
        return (
            f"EpisodeSet({count_of(len(self), 'episode')} of {scenes_text}, {tasks_text}, {radius})"
        )

    def check_grid(self, grid: NavGrid) -> None:
        """Check that the set was drawn on this grid, inflated for the set's agent.

        Raises:
            QueryError: the set was drawn on a different grid or for a different agent, or its
                header doesn't state its grids.
        """
        scene = scene_of(grid)
        agent = self.header.agent
        radius = grid.radius
        digest_of_scene = {grid_entry.scene: grid_entry.digest for grid_entry in self.header.grids}
        if not digest_of_scene:
            force_hint = "--force takes its distances from the grid given"
            problem = "the set doesn't say which grid it was made on, as sets of other programs"
            raise QueryError(f"{problem}: {force_hint}")
        if scene not in digest_of_scene:
            raise QueryError(
                f"the set has no episodes of {scene!r}: {suggest(scene, digest_of_scene)}"
            )
        if agent is not None and not np.isclose(agent.radius, radius):
            radius_text = f"radius {agent.radius:g} m, the grid of {scene!r} for {radius:g} m"
            inflation_hint = "inflate the grid it was made on, or force it"
            raise QueryError(f"the set is for an agent of {radius_text}: {inflation_hint}")
        digest = digest_of(grid)
        if digest_of_scene[scene] != digest:
            raise QueryError(
                f"the set was made on another grid of {scene!r} "
                f"(digest {digest_of_scene[scene][:12]}, "
                f"this one has {digest[:12]}): bake it with the settings of then, or force it"
            )


def find_goal_position(goal: Goal) -> Vector3 | None:
    """Return the position of a goal, or else of its first view point: world x, y, z [m].

    It is None if the goal has neither.
    """
    if goal.position:
        return goal.position
    return goal.view_points[0].position if goal.view_points else None


def list_goal_positions(episode: Episode) -> list[Vector3]:
    """List the positions of an episode's goals, world x, y, z [m]; see `find_goal_position`.

    Goals without a position are left out.
    """
    positions = [find_goal_position(goal) for goal in episode.goals]
    return [position for position in positions if position is not None]


def scene_of(grid: NavGrid) -> str:
    """Return the id of a grid's scene, ``scene`` if it has none."""
    return grid.scene_id or "scene"


def choose_agent(
    grid: NavGrid, name: str | None, radius: float | None = None, height: float | None = None
) -> links.Agent:
    """Return an agent of a grid by its name, with its radius or height replaced if wanted.

    Args:
        grid: the grid.
        name: the name of an agent of the grid; None for an agent without a name that may enter all
            areas and use all links.
        radius: the radius to use [m]; None for the agent's own.
        height: the height to use [m]; None for the agent's own.

    Returns:
        The agent.

    Raises:
        QueryError: the grid has no such agent.
    """
    agent = (find_agent(grid, name) if name else None) or links.Agent("")
    if radius is not None:
        agent = replace(agent, radius=radius)
    if height is not None:
        agent = replace(agent, height=height)
    return agent


def digest_of(grid: NavGrid) -> str:
    """Compute a SHA-256, in hexadecimal, of the parts of a grid that its episodes depend on.

    These are the rooms, the lattices of the levels, free cells, floors, steps, links and areas, and
    the agent's radius, height and highest step. Names, timings, added obstacles, and the states of
    doors that block nothing do not change the digest.
    """
    grid = grid.without_obstacles()
    sizes_and_steps = (grid.radius, grid.agent_height, grid.max_step, grid.step_array.tolist())
    digest = sha256(repr(sizes_and_steps).encode())
    if grid.links or grid.areas:
        digest.update(repr((grid.links, grid.areas)).encode())
    for level in grid.levels:
        digest.update(np.ascontiguousarray(level.area_index).data if grid.areas else b"")
        digest.update(repr(tuple(map(float, level.lattice))).encode())
        digest.update(np.packbits(level.free).tobytes())
        digest.update(np.ascontiguousarray(level.floor_height).data)
        digest.update(np.ascontiguousarray(level.room_index).data)
    return digest.hexdigest()
