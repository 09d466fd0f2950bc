"""The agents that a grid names, and what they use: areas, steps as a bake finds them, named links.

Areas say what cells cost, how fast and for whom they are. Steps and named links are ways that
aren't the floor of one level; ``metadata.navbake.links`` lists both: a step is a row of four
integers, a link an object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias, get_args

import msgspec
import numpy as np

from navbake.errors import FormatError
from navbake.navgrid.metadata import (
    Name,
    NonNegative,
    Positive,
    read_table,
    to_entry,
    unflatten,
)
from navbake.types import Bool, Float, Int, Json, Vector3

AGENTS = "metadata.navbake.agents"
AREAS = "metadata.navbake.areas"
MAX_AREAS = 255
SPEED = 1.0  # [m/s] of an agent that states none
LINKS = "metadata.navbake.links"
LinkState: TypeAlias = Literal["open", "closed"]
LINK_STATES: tuple[str, ...] = get_args(LinkState)

SLACK = 1e-9  # share by which an agent may be wider than a link

Id = Annotated[int, msgspec.Meta(ge=-(2**62), le=2**62)]
Row = tuple[Id, Id, Id, Id]


@dataclass(frozen=True)
class Agent:
    """An agent that plans on a grid; links and areas name those that may use them."""

    name: str
    radius: NonNegative | None = None  #: [m]; None for the grid's.
    height: Positive | None = None  #: [m]; None for the grid's.
    step: NonNegative | None = None  #: The highest that it takes [m]; None for the grid's.
    speed: Positive = SPEED  #: [m/s]

    def of_any_size(self) -> Agent:
        """The agent with the grid's size: its rights and its speed stay."""
        return replace(self, radius=None, height=None, step=None)

    def to_json(self) -> Json:
        """The agent's entry in the file's table, without its name."""
        return to_entry(self, "name")


def parse_agents(stated: Any) -> dict[str, Agent]:
    """Read and check ``metadata.navbake.agents``, by name; None is no agent."""
    entries: dict[str, Json] = read_table(stated or {}, dict[Name, Json], AGENTS)
    named = {name: {**entry, "name": name} for name, entry in entries.items()}
    agents: dict[str, Agent] = read_table(named, dict[str, Agent], AGENTS)
    return agents


@dataclass(frozen=True)
class Area:
    """An area; the layer ``area`` has its place in the table, from 1, in each of its cells."""

    name: str  #: Unique in the grid.
    cost: float = 1.0  #: By which the weights of its cells are multiplied; inf bars all agents.
    speed: float | None = None  #: The highest in it [m/s]; None for the agent's.
    agents: tuple[str, ...] | None = None  #: Names of those that may enter it; None for all.

    def bars(self, agent: Agent | None) -> bool:
        """Whether an agent may not enter it; without one, whether nobody may."""
        is_named = agent is None or self.agents is None or agent.name in self.agents
        return math.isinf(self.cost) or not is_named

    def to_json(self) -> Json:
        """The area's entry in the file's table."""
        return {**to_entry(self), "cost": "inf" if math.isinf(self.cost) else self.cost}


class _AreaEntry(msgspec.Struct):
    """An area in a file."""

    name: Name
    cost: NonNegative | Literal["inf"] = 1.0  # JSON has no infinite numbers
    speed: Positive | None = None
    agents: tuple[str, ...] | None = None


def parse_areas(stated: Any) -> tuple[Area, ...]:
    """Read and check ``metadata.navbake.areas``; None is no area."""
    areas: dict[str, Area] = {}
    entries: list[_AreaEntry] = read_table(stated or [], list[_AreaEntry], AREAS)
    if len(entries) > MAX_AREAS:
        raise FormatError(f"expected at most {MAX_AREAS} areas, got {len(entries)} at `{AREAS}`")
    for number, entry in enumerate(entries):
        if entry.name in areas:
            raise FormatError(
                f"expected unique names, got {entry.name!r} twice at `{AREAS}[{number}].name`"
            )
        areas[entry.name] = Area(entry.name, float(entry.cost), entry.speed, entry.agents)
    return tuple(areas.values())


# ---------------------------------------------------------------- links


@dataclass(frozen=True)
class Step:
    """A step between two cells, in both directions, that their heights alone don't show.

    It joins two levels, or two neighbours on a ramp that rises more than a step over a cell.
    """

    level: int  #: One end's level.
    cell: int  #: The id of its cell on it (col + row * width).
    other_level: int  #: The other end's level.
    other_cell: int  #: The id of its cell.


@dataclass(frozen=True)
class Stop:
    """A place where agents enter and leave a link."""

    level: int
    cell: int  #: The id of its cell (col + row * width).
    position: Vector3  #: As it was given or found, world x, y, z [m].


@dataclass(frozen=True)
class Link:
    """A named way between two or more places: a lift, a drop, a ladder, a flight of stairs.

    It leads from each stop to each other one, or only to later ones.
    """

    name: Name  #: Unique in the grid.
    kind: Name  #: ``lift``, ``drop``, ``jump``, ``ladder``, ``stair`` or any other word.
    stops: tuple[Stop, ...]  #: Two or more.
    one_way: bool = False  #: Whether it leads to later stops only.
    width: Positive | None = None  #: The widest agent's diameter [m]; None for any.
    #: Of a passage [m]; None for the length, over the stops in between.
    cost: NonNegative | None = None
    seconds: NonNegative | None = None  #: Of a passage; None for its cost over the agent's speed.
    agents: tuple[str, ...] | None = None  #: Names of those that may use it; None for all.
    state: LinkState = "open"
    auto: bool = False  #: Whether the bake found it.
    #: Of a lift: world x, y of its car's middle [m], its yaw [rad], width along it and depth [m].
    car: tuple[float, float, float, float, float] | None = None

    def refuses(self, agent: Agent | None) -> str | None:
        """Why an agent of any size can't use it, as "is closed"; None if it can."""
        if self.state == "closed":
            return "is closed"
        if agent is not None and self.agents is not None and agent.name not in self.agents:
            return f"bars {agent.name!r}"
        return None

    def fits(self, radius: float) -> bool:
        """Whether an agent of a radius [m] fits through."""
        return self.width is None or self.width >= 2.0 * radius * (1.0 - SLACK)

    def length(self, begin: int, end: int) -> float:
        """Length from a stop to another over those in between, by their numbers [m]."""
        low, high = sorted((begin, end))
        places = [stop.position for stop in self.stops[low : high + 1]]
        return sum(math.dist(a, b) for a, b in pairwise(places))

    def to_json(self) -> Json:
        """The link's entry in the file's table."""
        return {
            "name": self.name,
            "kind": self.kind,
            "stops": [[stop.level, stop.cell] for stop in self.stops],
            "positions": [list(stop.position) for stop in self.stops],
            **to_entry(self, "name", "kind", "stops", "state", "auto"),
            "state": self.state,
            **({"auto": True} if self.auto else {}),
        }


class Arcs(NamedTuple):
    """Passages over links, from stop to stop; without those that a closed or barred link has."""

    ends: Int  # flat ids of the cells that each leads from and to, shape (n, 2)
    link: Int  # the link's place in the grid's `links`
    width: Float  # of the widest agent [m], inf for any
    cost: Float  # [m]
    seconds: Float

    def fits_radius(self, radius: float) -> Bool:
        """Which of them an agent of a radius fits through."""
        return np.asarray(self.width >= 2.0 * radius * (1.0 - SLACK))


def find_arcs(
    links: Sequence[Link], start: Int, agent: Agent | None = None, penalty: float | None = None
) -> Arcs:
    """The passages over links that an agent may use, of any size; without one, over open links.

    Args:
        start: the first flat id of each level.
        agent: whose rights and speed count.
        penalty: what passages cost more that aren't allowed, also those against a link of one way
            [m] and [s]; they are left out if None.
    """
    speed = SPEED if agent is None else agent.speed
    rows = []
    for number, link in enumerate(links):
        cells = [int(start[stop.level]) + stop.cell for stop in link.stops]
        width = math.inf if link.width is None else link.width
        for one, other in np.ndindex(len(cells), len(cells)):
            is_allowed = not link.refuses(agent) and not (link.one_way and other < one)
            if cells[one] == cells[other] or not (is_allowed or penalty):
                continue
            cost = link.length(one, other) if link.cost is None else link.cost
            seconds = cost / speed if link.seconds is None else link.seconds
            more = 0.0 if is_allowed else float(penalty or 0.0)
            rows.append((cells[one], cells[other], number, width, cost + more, seconds + more))
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    ends = table[:, :2].astype(np.int64)
    numbers = table[:, 2].astype(np.int64)
    return Arcs(ends, numbers, *table[:, 3:].T.copy())


class _Stops(msgspec.Struct):
    """The stops of a link in a file."""

    stops: Annotated[list[tuple[Id, Id]], msgspec.Meta(min_length=2)]
    positions: list[Vector3]


def _read(stated: Any) -> list[tuple[int, Row | _Stops]]:
    """The steps and stops of links of a table, each after its number in it."""
    entries = unflatten(stated or [])
    is_mixed = isinstance(entries, list) and any(isinstance(entry, dict) for entry in entries)
    kind: Any = list[Row | _Stops] if is_mixed else list[Row]
    return list(enumerate(read_table(entries, kind, LINKS)))


def parse_steps(stated: Any, num_cells: Sequence[int]) -> Int:
    """Read the steps of ``metadata.navbake.links``, a list of entries or flat, or None.

    `num_cells` are the levels' numbers of cells. Each row has the fields of a `Step`, shape
    (n, 4), int64, read-only.
    """
    rows = [(number, row) for number, row in _read(stated) if isinstance(row, tuple)]
    steps = np.array([row for _, row in rows], dtype=np.int64).reshape(-1, 4)
    for at, (level, cell) in enumerate(steps.reshape(-1, 2).tolist()):
        _check_cell(level, cell, num_cells, f"link {rows[at // 2][0]}")
    steps.flags.writeable = False
    return steps


def parse_links(stated: Any, num_cells: Sequence[int]) -> tuple[Link, ...]:
    """Read and check the named links of ``metadata.navbake.links``, as `parse_steps`."""
    links: dict[str, Link] = {}
    for number, entry in _read(stated):
        if isinstance(entry, tuple):
            continue
        where = f"{LINKS}[{number}]"
        stops = [
            Stop(*cell, position)
            for cell, position in zip(entry.stops, entry.positions, strict=False)
        ]
        link: Link = read_table({**stated[number], "stops": stops}, Link, where)
        if link.name in links:
            raise FormatError(f"expected unique names, got {link.name!r} twice at `{where}.name`")
        if len(entry.positions) != len(entry.stops):
            raise FormatError(
                f"expected a position for each of {len(entry.stops)} stops, got "
                f"{len(entry.positions)}, in link {link.name!r} at `{where}.positions`"
            )
        for stop in stops:
            _check_cell(stop.level, stop.cell, num_cells, f"link {number} ({link.name!r})")
        links[link.name] = link
    return tuple(links.values())


def _check_cell(level: int, cell: int, num_cells: Sequence[int], what: str) -> None:
    if not (0 <= level < len(num_cells) and 0 <= cell < num_cells[level]):
        raise FormatError(
            f"expected an existing cell, got cell {cell} of level {level} in {what} at `{LINKS}`"
        )
