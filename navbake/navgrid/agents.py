"""The agents that a grid names, and its areas: what cells cost, how fast and for whom they are."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any

import msgspec

from navbake.errors import FormatError
from navbake.navgrid.metadata import Name, NonNegative, Positive, entry_of, read_table
from navbake.types import Json

AGENTS, AREAS = "metadata.navbake.agents", "metadata.navbake.areas"
MAX_AREAS = 255
SPEED = 1.0  # [m/s] of an agent that states none


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
        return entry_of(self, "name")


def parse_agents(stated: Any) -> dict[str, Agent]:
    """Read and check ``metadata.navbake.agents``, by name; None is no agent."""
    entries: dict[str, Json] = read_table(stated or {}, dict[Name, Json], AGENTS)
    named = {name: {**entry, "name": name} for name, entry in entries.items()}
    agents: dict[str, Agent] = read_table(named, dict[str, Agent], AGENTS)
    return agents


@dataclass(frozen=True)
class Area:
    """An area; the layer ``area`` has its place in the table, from 1, in each of its cells."""

    name: Name  #: Unique in the grid.
    #: By which the weights of its cells are multiplied; inf bars all agents.
    cost: Annotated[float, msgspec.Meta(ge=0)] = 1.0
    speed: Positive | None = None  #: The highest in it [m/s]; None for the agent's.
    agents: tuple[str, ...] | None = None  #: Names of those that may enter it; None for all.

    def bars(self, agent: Agent | None) -> bool:
        """Whether an agent may not enter it; without one, whether nobody may."""
        is_named = agent is None or self.agents is None or agent.name in self.agents
        return math.isinf(self.cost) or not is_named

    def to_json(self) -> Json:
        """The area's entry in the file's table."""
        return {**entry_of(self), "cost": "inf" if math.isinf(self.cost) else self.cost}


def parse_areas(stated: Any) -> tuple[Area, ...]:
    """Read and check ``metadata.navbake.areas``; None is no area."""
    areas: dict[str, Area] = {}
    if isinstance(stated, list):  # JSON has no infinite numbers
        bars = [isinstance(entry, dict) and entry.get("cost") == "inf" for entry in stated]
        pairs = zip(stated, bars, strict=True)
        stated = [{**entry, "cost": math.inf} if no else entry for entry, no in pairs]
    entries: list[Area] = read_table(stated or [], list[Area], AREAS)
    if len(entries) > MAX_AREAS:
        raise FormatError(f"expected at most {MAX_AREAS} areas, got {len(entries)} at `{AREAS}`")
    for number, area in enumerate(entries):
        if area.name in areas:
            raise FormatError(
                f"expected unique names, got {area.name!r} twice at `{AREAS}[{number}].name`"
            )
        areas[area.name] = area
    return tuple(entries)
