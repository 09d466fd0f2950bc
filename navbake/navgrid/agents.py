"""The agents that a grid names: their sizes and speeds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import msgspec

from navbake.navgrid.metadata import Name, NonNegative, Positive, read_table
from navbake.types import Json

WHERE = "metadata.navbake.agents"
SPEED = 1.0  # [m/s] of an agent that states none


@dataclass(frozen=True)
class Agent:
    """An agent that plans on a grid; links and areas name those that may use them."""

    name: str
    radius: float | None = None  #: [m]; None for the grid's.
    height: float | None = None  #: [m]; None for the grid's.
    step: float | None = None  #: The highest that it takes [m]; None for the grid's.
    speed: float = SPEED  #: [m/s]

    def of_any_size(self) -> Agent:
        """The agent with the grid's size: its rights and its speed stay."""
        return replace(self, radius=None, height=None, step=None)

    def to_json(self) -> Json:
        """The agent's entry in the file's table, without its name."""
        sizes = (("radius", self.radius), ("height", self.height), ("step", self.step))
        return {key: value for key, value in (*sizes, ("speed", self.speed)) if value is not None}


class _Entry(msgspec.Struct):
    """An agent in a file."""

    radius: NonNegative | None = None
    height: Positive | None = None
    step: NonNegative | None = None
    speed: Positive = SPEED


def parse_agents(stated: Any) -> dict[str, Agent]:
    """Read and check ``metadata.navbake.agents``, by name; None is no agent."""
    entries: dict[str, _Entry] = read_table(stated or {}, dict[Name, _Entry], WHERE)
    return {name: Agent(name, **msgspec.structs.asdict(entry)) for name, entry in entries.items()}
