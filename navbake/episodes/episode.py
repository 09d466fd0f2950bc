"""What an episode is: where an agent starts, what it has to reach, and what both were drawn on.

World x, y, z [m], z up; headings 0 along x, counted towards y [rad].
"""

from __future__ import annotations

from hashlib import sha256
from typing import Annotated, Any

import msgspec
import numpy as np

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.grid import NavGrid
from navbake.runtime.inflation import agent_radius
from navbake.types import Vector3

TASKS = ("point", "object", "room", "sequence", "explore")
FORMAT, VERSION = "navbake-episodes", 1

Length = Annotated[float, msgspec.Meta(ge=0)]
"""A length [m]."""


class ViewPoint(msgspec.Struct, frozen=True, omit_defaults=True, forbid_unknown_fields=True):
    """A place on the floor from which an object is in sight, and the heading towards it [rad]."""

    position: Vector3
    heading: float
    iou: float | None = None  #: Share of the picture that the object fills, if it was measured.


class Goal(
    msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True
):
    """What is to be reached: a point, an object, a room, or a share of the free area.

    Attributes:
        position: world x, y, z [m]; of an object its middle, of a room its centroid.
        radius: how near counts as reached [m]: along the floor, to the point or to the nearest view
            point of the object; how far the agent sees of what it explores.
        name, category: of the object, or of the room.
        room: the room's id; its cells are the goal.
        view_points: of the object.
        share: of the free area that is to be seen.
    """

    position: Vector3 | None = None
    radius: Length = 0.0
    name: str | None = None
    category: str | None = None
    room: str | None = None
    view_points: tuple[ViewPoint, ...] = ()
    share: Annotated[float, msgspec.Meta(gt=0, le=1)] | None = None


class Episode(
    msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True
):
    """One task.

    Attributes:
        id: unique in its set.
        scene: id of the scene, as a grid of the header has it.
        task: one of `TASKS`.
        start, heading: world x, y and floor z [m], and [rad].
        goals: any one of them is to be reached; of a ``sequence`` all, in order.
        distance: of the shortest path over cells, seen from above, to the nearest place of a goal,
            or through all goals of a ``sequence`` [m]; None where it is unknown or has no meaning.
        straight: the same through the air [m].
        split: ``train`` or another part of the set.
        room: id of the room of the start.
        levels: of start and goal.
        doors, rooms: ids along the path, None where no path was planned.
        path: a path to follow, world x, y, z [m].
        instruction: in words.
        extra: fields of other formats.
    """

    id: str
    scene: str
    task: str
    start: Vector3
    heading: float
    goals: tuple[Goal, ...]
    distance: Length | None = None
    straight: Length | None = None
    split: str | None = None
    room: str | None = None
    levels: tuple[int, ...] = ()
    doors: tuple[str, ...] | None = None
    rooms: tuple[str, ...] | None = None
    path: tuple[Vector3, ...] = ()
    instruction: str | None = None
    extra: dict[str, Any] = {}

    def __post_init__(self) -> None:
        if self.task not in TASKS:
            raise ValueError(f"expected one of {', '.join(TASKS)} as task, got {self.task!r}")
        if not self.goals:
            raise ValueError(f"episode {self.id!r} has no goal")

    @property
    def ratio(self) -> float | None:
        """`distance` over `straight`, >= 1; None where one is unknown or nothing."""
        return self.distance / self.straight if self.distance and self.straight else None


class Agent(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """For whom the episodes are: radius and height [m], and the highest speed [m/s]."""

    radius: Length
    height: Length
    speed: float | None = None


class GridEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A grid that episodes were drawn on: its scene's id, and the name of its file, if any."""

    scene: str
    digest: str  #: `digest_of` the grid, inflated for the agent if need be.
    file: str | None = None


class Header(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What made a set: the agent, the grids, the sampler's rules and its seed.

    Sets of other programs don't say it. `rejected` counts the draws that each rule refused.
    """

    format: str = FORMAT
    version: int = VERSION
    agent: Agent | None = None
    grids: tuple[GridEntry, ...] = ()
    sampler: dict[str, Any] = {}
    seed: int | None = None
    rejected: dict[str, int] = {}


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
        scene, agent, radius = scene_of(grid), self.header.agent, agent_radius(grid)
        digests = {entry.scene: entry.digest for entry in self.header.grids}
        if not digests:
            raise QueryError(
                "the set doesn't say which grid it was made on, as sets of other programs: "
                "--force takes its distances from the grid given"
            )
        if scene not in digests:
            raise QueryError(f"the set has no episodes of {scene!r}: {suggest(scene, digests)}")
        if agent is not None and not np.isclose(agent.radius, radius):
            raise QueryError(
                f"the set is for an agent of radius {agent.radius:g} m, the grid of {scene!r} for "
                f"{radius:g} m: inflate the grid it was made on, or force it"
            )
        if digests[scene] != (given := digest_of(grid)):
            raise QueryError(
                f"the set was made on another grid of {scene!r} (digest {digests[scene][:12]}, "
                f"this one has {given[:12]}): bake it with the settings of then, or force it"
            )


def scene_of(grid: NavGrid) -> str:
    """The id of a grid's scene; ``scene`` where it has none."""
    return grid.scene_id or "scene"


def digest_of(grid: NavGrid) -> str:
    """SHA-256 of all that distances on a grid depend on, and of its rooms, in hexadecimal.

    Where it is, what is free, the floors, steps and links, the agent's radius and height: not of
    names, doors' states as far as they block nothing, timings or blocks.
    """
    clean = grid.without_blocks()
    facts = (agent_radius(clean), clean.agent_height, clean.max_step, clean.link_array.tolist())
    digest = sha256(repr(facts).encode())
    for level in clean.levels:
        digest.update(repr(tuple(map(float, level.lattice))).encode())
        digest.update(np.packbits(level.free).tobytes())
        digest.update(np.ascontiguousarray(level.floor_height).data)
        digest.update(np.ascontiguousarray(level.room_index).data)
    return digest.hexdigest()
