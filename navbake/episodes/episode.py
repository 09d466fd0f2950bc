"""What an episode is: where an agent starts, what it has to reach, and what both were drawn on.

World x, y, z [m], z up; headings 0 along x, counted towards y [rad].
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from hashlib import sha256
from typing import Annotated, Any

import msgspec
import numpy as np

from navbake.errors import QueryError
from navbake.known_names import find_near, suggest
from navbake.navgrid import links
from navbake.navgrid.grid import NavGrid
from navbake.runtime.blocking import find_agent
from navbake.types import Vector3

TASKS = ("point", "object", "room", "sequence", "explore")
FORMAT = "navbake-episodes"
VERSION = 1
EDGES: dict[str, tuple[float, ...]] = {
    "distance": (1.0, 3.0, 6.0, 10.0, 20.0, 40.0),
    "ratio": (1.0, 1.1, 1.25, 1.5, 2.0),
    "doors": (0.0, 1.0, 2.0, 3.0, 5.0),
    "rooms": (1.0, 2.0, 3.0, 4.0, 6.0),
    "levels": (0.0, 1.0, 2.0),
}
"""Measures of episodes, and the lower edges of their classes."""

Length = Annotated[float, msgspec.Meta(ge=0)]
"""A length [m]."""


def check_word(value: str, known: Collection[str], name: str) -> None:
    """Raise a ValueError for anything but the known words."""
    if value not in known:
        near = find_near(value, known) or [one for one in known if str(value).startswith(one)]
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"expected one of {', '.join(known)} as {name}, got {value!r}{hint}")


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Part of a set, as its file has it."""


class ViewPoint(Record, frozen=True, omit_defaults=True):
    """A place from which an object is in sight."""

    position: Vector3  #: World x, y and floor z [m].
    heading: float  #: Towards the object [rad].
    iou: float | None = None  #: Share of the picture that the object fills, if it was measured.


class Goal(Record, frozen=True, kw_only=True, omit_defaults=True):
    """What is to be reached: a point, an object, a room, or a share of the free area."""

    position: Vector3 | None = None
    """World x, y, z [m]; of an object its middle, of a room its centroid."""
    radius: Length = 0.0
    """How near counts as reached [m], along the floor to the point or to the nearest view point;
    how far the agent sees of what it explores. Of a room its own cells count."""
    name: str | None = None  #: Of the object, or of the room.
    category: str | None = None  #: Of the object, or type of the room.
    room: str | None = None  #: Id of the room.
    view_points: tuple[ViewPoint, ...] = ()  #: Of the object.
    share: Annotated[float, msgspec.Meta(gt=0, le=1)] | None = None  #: Of the area to explore.


class Episode(Record, frozen=True, kw_only=True, omit_defaults=True):
    """One task."""

    id: str  #: Unique in its set.
    scene: str  #: Id of the scene, as a grid of the header has it.
    task: str  #: One of `TASKS`.
    start: Vector3  #: World x, y and floor z [m].
    heading: float  #: At the start [rad].
    goals: tuple[Goal, ...]  #: Any one is to be reached; of a ``sequence`` all, in order.
    distance: Length | None = None
    """Of the shortest path over cells, seen from above, to the nearest place of a goal, or through
    all goals of a ``sequence`` [m]; None where it is unknown or has no meaning."""
    straight: Length | None = None  #: The same through the air [m].
    split: str | None = None  #: ``train`` or another part of the set.
    room: str | None = None  #: Id of the room of the start.
    levels: tuple[int, ...] = ()  #: Of start and goal.
    doors: tuple[str, ...] | None = None  #: Ids along the path; None where none was planned.
    rooms: tuple[str, ...] | None = None  #: The same.
    path: tuple[Vector3, ...] = ()  #: A path to follow, world x, y, z [m].
    instruction: str | None = None  #: In words.
    extra: dict[str, Any] = {}  #: Fields of other formats.

    def __post_init__(self) -> None:
        check_word(self.task, TASKS, "task")
        if not self.goals:
            raise ValueError(f"episode {self.id!r} has no goal")

    @property
    def ratio(self) -> float | None:
        """`distance` over `straight`, >= 1; None where one is unknown or nothing."""
        return self.distance / self.straight if self.distance and self.straight else None

    @property
    def measures(self) -> dict[str, float | None]:
        """What strata and counts of episodes may be of, see `EDGES`."""
        return {
            "distance": self.distance,
            "ratio": self.ratio,
            "doors": len(self.doors or ()),
            "rooms": len(self.rooms or ()),
            "levels": abs(self.levels[0] - self.levels[-1]) if self.levels else 0,
        }


class Agent(Record, frozen=True, kw_only=True):
    """For whom the episodes are."""

    radius: Length
    height: Length
    speed: float | None = None  #: The highest [m/s].
    name: str | msgspec.UnsetType = msgspec.UNSET
    """Of the grid's agent whose rights on links and areas count; not set for none."""


class GridEntry(Record, frozen=True, kw_only=True):
    """A grid that episodes were drawn on."""

    scene: str  #: The scene's id.
    digest: str  #: `digest_of` the grid, inflated for the agent if need be.
    file: str | None = None  #: Name of the grid's file; None where it was in memory.


class Header(Record, frozen=True, kw_only=True):
    """What made a set; sets of other programs don't say it."""

    format: str = FORMAT
    version: int = VERSION
    agent: Agent | None = None
    grids: tuple[GridEntry, ...] = ()
    sampler: dict[str, Any] = {}
    seed: int | None = None
    rejected: dict[str, int] = {}  #: How many draws each rule refused.


class EpisodeSet(msgspec.Struct, frozen=True):
    """Episodes and what made them; raises a ValueError where two have one id."""

    header: Header
    episodes: tuple[Episode, ...]

    def __post_init__(self) -> None:
        seen: set[str] = set()
        for episode in self.episodes:
            if episode.id in seen:
                raise ValueError(f"expected unique ids, got {episode.id!r} twice")
            seen.add(episode.id)

    def __len__(self) -> int:
        return len(self.episodes)

    def check_grid(self, grid: NavGrid) -> None:
        """Raise a QueryError unless the set was made on this grid, for this agent."""
        scene = scene_of(grid)
        agent = self.header.agent
        radius = grid.radius
        digests = {entry.scene: entry.digest for entry in self.header.grids}
        if not digests:
            force = "--force takes its distances from the grid given"
            unknown = "the set doesn't say which grid it was made on, as sets of other programs"
            raise QueryError(f"{unknown}: {force}")
        if scene not in digests:
            raise QueryError(f"the set has no episodes of {scene!r}: {suggest(scene, digests)}")
        if agent is not None and not np.isclose(agent.radius, radius):
            sizes = f"radius {agent.radius:g} m, the grid of {scene!r} for {radius:g} m"
            inflate = "inflate the grid it was made on, or force it"
            raise QueryError(f"the set is for an agent of {sizes}: {inflate}")
        if digests[scene] != (given := digest_of(grid)):
            raise QueryError(
                f"the set was made on another grid of {scene!r} (digest {digests[scene][:12]}, "
                f"this one has {given[:12]}): bake it with the settings of then, or force it"
            )


def scene_of(grid: NavGrid) -> str:
    """The id of a grid's scene; ``scene`` where it has none."""
    return grid.scene_id or "scene"


def named_agent(
    grid: NavGrid, name: str | None, radius: float | None = None, height: float | None = None
) -> links.Agent:
    """The grid's agent of a name, else a nameless one; of a radius and a height if given [m]."""
    known = (find_agent(grid, name) if name else None) or links.Agent("")
    sizes: dict[str, Any] = {"radius": radius, "height": height}
    return replace(known, **{key: size for key, size in sizes.items() if size is not None})


def digest_of(grid: NavGrid) -> str:
    """SHA-256 of all that distances on a grid depend on, and of its rooms, in hexadecimal.

    Where it is, what is free, the floors, steps, links and areas, the agent's radius and height:
    not of names, doors' states as far as they block nothing, timings or blocks.
    """
    clean = grid.without_blocks()
    facts = (clean.radius, clean.agent_height, clean.max_step, clean.step_array.tolist())
    digest = sha256(repr(facts).encode())
    if clean.links or clean.areas:
        digest.update(repr((clean.links, clean.areas)).encode())
    for level in clean.levels:
        digest.update(np.ascontiguousarray(level.area_index).data if clean.areas else b"")
        digest.update(repr(tuple(map(float, level.lattice))).encode())
        digest.update(np.packbits(level.free).tobytes())
        digest.update(np.ascontiguousarray(level.floor_height).data)
        digest.update(np.ascontiguousarray(level.room_index).data)
    return digest.hexdigest()
