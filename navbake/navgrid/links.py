"""The agents that a grid names, and the areas, steps and named links that they use.

Areas say what cells cost, how fast agents may go there, and which agents may enter. Steps and named
links lead from cell to cell where the floor of one level does not. ``metadata.navbake.links`` lists
both: a step as a row of four integers, a link as an object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Literal, NamedTuple, TypeAlias, get_args

import msgspec
import numpy as np

from navbake.errors import FormatError, QueryError
from navbake.navgrid.metadata import (
    Name,
    NonNegative,
    Positive,
    read_table,
    to_entry,
    unflatten,
)
from navbake.types import Bool, Float, Int, Json, JsonValue, Vector3

AGENTS = "metadata.navbake.agents"
AREAS = "metadata.navbake.areas"
LINKS = "metadata.navbake.links"
MAX_AREAS = 255  # the layer `area` is uint8
DEFAULT_SPEED = 1.0  # speed of an agent, if the file states none [m/s]
LinkState: TypeAlias = Literal["open", "closed"]
LINK_STATES: tuple[str, ...] = get_args(LinkState)

WIDTH_SLACK = 1e-9  # share by which an agent may be wider than a link, for rounding

Id = Annotated[int, msgspec.Meta(ge=-(2**62), le=2**62)]
"""A level's number or a cell's id in a file, not checked yet."""

StepEntry = tuple[Id, Id, Id, Id]
"""A step in a file: level and cell, other level and other cell."""


@dataclass(frozen=True)
class Agent:
    """An agent that plans on a grid. Links and areas name the agents that may use them.

    Attributes:
        name: Its name, as links and areas use it.
        radius: Radius of its footprint [m]; None for the grid's.
        height: Its height [m]; None for the grid's.
        step: The highest step that it takes [m]; None for the grid's. Where it is lower, it counts
            for floors alone: things lower than the grid's step are no obstacles.
        speed: Its speed [m/s].

    Raises:
        QueryError: The name is no text.

    Example:
        >>> finder = navbake.PathFinder(grid, agent=navbake.Agent("cart", radius=0.3, speed=0.8))
    """

    name: str
    radius: NonNegative | None = None
    height: Positive | None = None
    step: NonNegative | None = None
    speed: Positive = DEFAULT_SPEED

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            expected = "text as the name of an agent"
            hint = 'write Agent("robot", radius=0.2)'
            raise QueryError(
                f"expected {expected}, got {self.name!r}: {hint}",
                key="name",
                value=self.name,
                expected=expected,
                hint=hint,
            )

    def without_sizes(self) -> Agent:
        """Return the agent without radius, height and step, so that the grid's values count."""
        return replace(self, radius=None, height=None, step=None)

    def to_json(self) -> Json:
        """Return the agent's entry in the file's table, without its name."""
        return to_entry(self, "name")


def parse_agents(entries: JsonValue) -> dict[str, Agent]:
    """Check and convert ``metadata.navbake.agents``.

    Args:
        entries: The table; None for no agents.

    Returns:
        Name -> agent.

    Raises:
        FormatError: The table is broken.
    """
    entries_by_name: dict[str, Json] = read_table(entries or {}, dict[Name, Json], AGENTS)
    named_entries = {name: {**entry, "name": name} for name, entry in entries_by_name.items()}
    return read_table(named_entries, dict[str, Agent], AGENTS)


@dataclass(frozen=True)
class Area:
    """An area of the grid, where cells cost more, speed is limited, or agents may not enter.

    The layer ``area`` holds the number of each cell's area: 1 for the first of `grid.areas`.

    Attributes:
        name: Its name, unique in the grid.
        cost: Factor by which the weights of its cells are multiplied; inf bars all agents.
        speed: The highest speed in it [m/s]; None for no limit.
        agents: Names of the agents that may enter it; None for all.
    """

    name: str
    cost: float = 1.0
    speed: float | None = None
    agents: tuple[str, ...] | None = None

    def bars(self, agent: Agent | None) -> bool:
        """Return whether the area bars an agent; for None, whether it bars all agents."""
        may_enter = agent is None or self.agents is None or agent.name in self.agents
        return math.isinf(self.cost) or not may_enter

    def to_json(self) -> Json:
        """Return the area's entry in the file's table."""
        return {**to_entry(self), "cost": "inf" if math.isinf(self.cost) else self.cost}


class _AreaEntry(msgspec.Struct):
    """The entry of an area in a file."""

    name: Name
    cost: NonNegative | Literal["inf"] = 1.0  # JSON has no infinite numbers
    speed: Positive | None = None
    agents: tuple[str, ...] | None = None


def parse_areas(entries: JsonValue) -> tuple[Area, ...]:
    """Check and convert ``metadata.navbake.areas``.

    Args:
        entries: The table; None for no areas.

    Raises:
        FormatError: The table is broken, has more than 255 areas, or a name twice.
    """
    areas: dict[str, Area] = {}
    area_entries: list[_AreaEntry] = read_table(entries or [], list[_AreaEntry], AREAS)
    if len(area_entries) > MAX_AREAS:
        raise FormatError(
            f"expected at most {MAX_AREAS} areas, got {len(area_entries)} at `{AREAS}`",
            value=len(area_entries),
            expected=f"at most {MAX_AREAS} areas",
            place=AREAS,
        )
    for entry_number, entry in enumerate(area_entries):
        if entry.name in areas:
            raise _make_duplicate_error(entry.name, f"{AREAS}[{entry_number}].name")
        areas[entry.name] = Area(entry.name, float(entry.cost), entry.speed, entry.agents)
    return tuple(areas.values())


def _make_duplicate_error(name: str, place: str) -> FormatError:
    """Make the error for a name that stands twice in a table."""
    expected = "unique names"
    return FormatError(
        f"expected {expected}, got {name!r} twice at `{place}`",
        value=name,
        expected=expected,
        place=place,
    )


# ---------------------------------------------------------------- links


@dataclass(frozen=True)
class Step:
    """A step between two cells that a grid lists because it can't be told from floor heights.

    It joins two cells of different levels, or two neighbouring cells of one level on a ramp so
    steep that their floors differ by more than the agent's highest step. Agents take it in both
    directions.

    Attributes:
        level: Level of the first cell.
        cell: Id of the first cell on it (col + row * width).
        other_level: Level of the second cell.
        other_cell: Id of the second cell on it.
    """

    level: int
    cell: int
    other_level: int
    other_cell: int


@dataclass(frozen=True)
class Stop:
    """A place where agents enter and leave a link.

    Attributes:
        level: Its level, 0 is the lowest.
        cell: Id of its cell (col + row * width).
        position: World x, y, z [m], as the settings have it or the bake found it.
    """

    level: int
    cell: int
    position: Vector3


@dataclass(frozen=True)
class Link:
    """A named connection of two or more places: a lift, a drop, a ladder, a flight of stairs.

    It leads from each stop to all others, or only to later stops if it is one-way.

    Attributes:
        name: Its name, unique in the grid.
        kind: ``lift``, ``drop``, ``jump``, ``ladder``, ``stair`` or any other word.
        stops: Its stops, two or more.
        one_way: Whether it leads to later stops only.
        width: Diameter of the widest agent that fits [m]; None for any.
        cost: Cost of a passage [m]; None for its length, via the stops in between.
        seconds: Duration of a passage [s]; None for its cost divided by the agent's speed.
        agents: Names of the agents that may use it; None for all.
        state: ``open`` or ``closed``.
        auto: Whether the bake found it.
        car: Of a lift: world x, y of the middle of its car [m], its yaw [rad], its width along that
            axis and its depth [m]; else None.
    """

    name: Name
    kind: Name
    stops: tuple[Stop, ...]
    one_way: bool = False
    width: Positive | None = None
    cost: NonNegative | None = None
    seconds: NonNegative | None = None
    agents: tuple[str, ...] | None = None
    state: LinkState = "open"
    auto: bool = False
    car: tuple[float, float, float, float, float] | None = None

    def refuses(self, agent: Agent | None) -> str | None:
        """Return why an agent may not use the link, such as "is closed"; None if it may.

        The agent's size is not considered.
        """
        if self.state == "closed":
            return "is closed"
        if agent is not None and self.agents is not None and agent.name not in self.agents:
            return f"bars {agent.name!r}"
        return None

    def fits(self, radius: float) -> bool:
        """Return whether an agent of a radius [m] fits through the link."""
        return self.width is None or self.width >= 2.0 * radius * (1.0 - WIDTH_SLACK)

    def length(self, begin: int, end: int) -> float:
        """Return the length from one stop to another, via the stops in between [m].

        Args:
            begin: Index of the first stop.
            end: Index of the last stop.
        """
        lower_index, upper_index = sorted((begin, end))
        stop_positions = [stop.position for stop in self.stops[lower_index : upper_index + 1]]
        return sum(
            math.dist(position, next_position)
            for position, next_position in pairwise(stop_positions)
        )

    def to_json(self) -> Json:
        """Return the link's entry in the file's table."""
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
    """The arcs over links: n ways from one stop of a link to another, each in one direction."""

    ends: Int  #: Flat ids of the cells that each leads from and to, shape (n, 2), int64.
    link: Int  #: Index of each arc's link in the grid's `links`, shape (n,), int64.
    width: Float  #: Diameter of the widest agent that fits [m], inf for any, shape (n,).
    cost: Float  #: Cost of each arc [m], shape (n,).
    seconds: Float  #: Duration of each arc [s], shape (n,).

    def fits_radius(self, radius: float) -> Bool:
        """Mark the arcs over links that are wide enough for a radius [m], shape (n,)."""
        return np.asarray(self.width >= 2.0 * radius * (1.0 - WIDTH_SLACK))


def find_arcs(
    links: Sequence[Link],
    first_cells: Int,
    agent: Agent | None = None,
    penalty: float | None = None,
) -> Arcs:
    """List the arcs over links that an agent may use; its size is not considered.

    Args:
        links: The links of a grid.
        first_cells: First flat id of each level.
        agent: The agent, whose permissions and speed count; None for one with 1 m/s that may use
            all open links.
        penalty: Extra cost [m] and duration [s] of arcs that the agent may not use, and of arcs
            against the direction of a one-way link. None to leave such arcs out.

    Returns:
        The arcs, in the order of the links.
    """
    speed = DEFAULT_SPEED if agent is None else agent.speed
    arc_rows = []
    for link_index, link in enumerate(links):
        cells = [int(first_cells[stop.level]) + stop.cell for stop in link.stops]
        width = math.inf if link.width is None else link.width
        for start_index, end_index in np.ndindex(len(cells), len(cells)):
            is_allowed = not link.refuses(agent) and not (link.one_way and end_index < start_index)
            if cells[start_index] == cells[end_index] or not (is_allowed or penalty):
                continue
            cost = link.length(start_index, end_index) if link.cost is None else link.cost
            seconds = cost / speed if link.seconds is None else link.seconds
            extra_cost = 0.0 if is_allowed else float(penalty or 0.0)
            arc_rows.append(
                (
                    cells[start_index],
                    cells[end_index],
                    link_index,
                    width,
                    cost + extra_cost,
                    seconds + extra_cost,
                )
            )
    arc_table = np.array(arc_rows, dtype=np.float64).reshape(-1, 6)
    return Arcs(
        ends=arc_table[:, :2].astype(np.int64),
        link=arc_table[:, 2].astype(np.int64),
        width=arc_table[:, 3].copy(),
        cost=arc_table[:, 4].copy(),
        seconds=arc_table[:, 5].copy(),
    )


class _StopsEntry(msgspec.Struct):
    """The stops of a link in a file."""

    stops: Annotated[list[tuple[Id, Id]], msgspec.Meta(min_length=2)]
    positions: list[Vector3]


def _parse_entries(entries: JsonValue) -> list[StepEntry | _StopsEntry]:
    """Convert a table of links to steps (tuples) and stops of named links, in the table's order."""
    entry_list = unflatten(entries or [])
    has_links = isinstance(entry_list, list) and any(
        isinstance(entry, dict) for entry in entry_list
    )
    if has_links:
        return read_table(entry_list, list[StepEntry | _StopsEntry], LINKS)
    return [*read_table(entry_list, list[StepEntry], LINKS)]


def parse_steps(entries: JsonValue, cell_counts: Sequence[int]) -> Int:
    """Check and convert the steps of ``metadata.navbake.links``.

    Args:
        entries: The table: a list with four integers for each step and an object for each named
            link; or, without named links, one list of all steps' integers; or None for no table.
        cell_counts: Number of cells of each level.

    Returns:
        A row for each `Step` with its fields, shape (n, 4), int64, read-only.

    Raises:
        FormatError: The table is broken, or a cell does not exist.
    """
    entry_numbers = []  # of the steps in the table
    step_rows = []
    for entry_number, entry in enumerate(_parse_entries(entries)):
        if isinstance(entry, tuple):
            entry_numbers.append(entry_number)
            step_rows.append(entry)
    steps = np.array(step_rows, dtype=np.int64).reshape(-1, 4)
    for index, (level, cell) in enumerate(steps.reshape(-1, 2).tolist()):
        _check_cell(level, cell, cell_counts, f"link {entry_numbers[index // 2]}")
    steps.flags.writeable = False
    return steps


def parse_links(entries: JsonValue, cell_counts: Sequence[int]) -> tuple[Link, ...]:
    """Check and convert the named links of ``metadata.navbake.links``.

    Args:
        entries: The table, as `parse_steps` takes it. Its steps are left out.
        cell_counts: Number of cells of each level.

    Raises:
        FormatError: The table is broken, a name stands twice, or a cell does not exist.
    """
    links: dict[str, Link] = {}
    for entry_number, entry in enumerate(_parse_entries(entries)):
        if isinstance(entry, tuple):
            continue
        place = f"{LINKS}[{entry_number}]"
        stops = [
            Stop(level, cell, position)
            for (level, cell), position in zip(entry.stops, entry.positions, strict=False)
        ]
        link: Link = read_table({**entries[entry_number], "stops": stops}, Link, place)
        if link.name in links:
            raise _make_duplicate_error(link.name, f"{place}.name")
        if len(entry.positions) != len(entry.stops):
            expected = f"a position for each of {len(entry.stops)} stops"
            raise FormatError(
                f"expected {expected}, got {len(entry.positions)}, in link {link.name!r} at "
                f"`{place}.positions`",
                value=len(entry.positions),
                expected=expected,
                place=f"{place}.positions",
            )
        for stop in stops:
            _check_cell(stop.level, stop.cell, cell_counts, f"link {entry_number} ({link.name!r})")
        links[link.name] = link
    return tuple(links.values())


def _check_cell(level: int, cell: int, cell_counts: Sequence[int], entry_name: str) -> None:
    """Raise a FormatError for a cell that does not exist; `entry_name` is the entry with it."""
    if not (0 <= level < len(cell_counts) and 0 <= cell < cell_counts[level]):
        expected = "an existing cell"
        raise FormatError(
            f"expected {expected}, got cell {cell} of level {level} in {entry_name} at `{LINKS}`",
            value=(level, cell),
            expected=expected,
            place=LINKS,
        )
