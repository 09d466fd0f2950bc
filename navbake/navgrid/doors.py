"""The doors of a grid, as a file's table has them.

It carries, for each door and state, the cells that only this door blocks, by level. So another
state needs no scene and no new bake, see `navbake.navgrid.door_states`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias, get_args

import msgspec
import numpy as np

from navbake.errors import FormatError
from navbake.navgrid.metadata import read_table
from navbake.types import Int, Json

State: TypeAlias = Literal["modelled", "open", "closed", "removed"]
STATES: tuple[str, ...] = get_args(State)
WHERE = "metadata.navbake.doors"
# A door is in an opening if they are at most this far apart [m]
DOOR_REACH = 0.4

Runs = list[int]
"""Cell ids as runs: first id, count, first id, count, …"""


def to_runs(cells: Int) -> Runs:
    """Pack ascending cell ids, shape (n,), into runs."""
    starts = np.flatnonzero(np.diff(cells, prepend=-2) != 1)
    counts = np.diff(starts, append=len(cells))
    runs: Runs = np.stack([cells[starts], counts], axis=1).ravel().tolist()
    return runs


def from_runs(runs: Sequence[int]) -> Int:
    """Unpack runs into ascending cell ids, shape (n,), int64."""
    pairs = np.array(runs, dtype=np.int64).reshape(-1, 2)
    parts = [np.arange(first, first + count) for first, count in pairs]
    return np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class Door:
    """A door of a grid.

    Attributes:
        id: unique in the grid.
        joint: the joint that moves it, None for none.
        rooms: ids of the two rooms that it joins, None for the outside; () where nothing says so.
        state: what it is in now, one of `STATES`.
        cells: what it blocks, by state and level, as runs of cell ids.
        solid: the same of the cells whose squares it meets, of a grid with a layer ``solid``.
    """

    id: str
    joint: str | None
    rooms: tuple[str | None, ...]
    state: str
    cells: Mapping[str, Mapping[int, Runs]]
    solid: Mapping[str, Mapping[int, Runs]] = field(default_factory=dict)

    @property
    def levels(self) -> list[int]:
        """The levels where it blocks cells in any state, ascending."""
        return sorted({level for per_level in self.cells.values() for level in per_level})

    @property
    def states(self) -> list[str]:
        """All states that it can be in."""
        return [state for state in STATES if state in self.cells or state == "removed"]

    @property
    def like(self) -> str | None:
        """Which of closed and open is the same as modelled, if one is and it is modelled now."""
        as_modelled = self.cells.get("modelled")
        if self.state != "modelled" or as_modelled is None:
            return None
        return next((s for s in ("closed", "open") if self.cells.get(s) == as_modelled), None)

    def cells_in(self, state: str, num_levels: int) -> list[Int]:
        """The cells that only this door blocks in a state: ascending ids by level."""
        by_level = self.cells.get(state, {})
        return [from_runs(by_level.get(level, ())) for level in range(num_levels)]

    def solid_in(self, state: str, num_levels: int) -> list[Int]:
        """The cells whose squares only this door meets in a state: ascending ids by level."""
        by_level = self.solid.get(state, {})
        return [from_runs(by_level.get(level, ())) for level in range(num_levels)]

    def to_json(self) -> Json:
        """Summarise the door in values that JSON can hold: all but its cells."""
        return {
            "id": self.id,
            "joint": self.joint,
            "rooms": list(self.rooms),
            "levels": self.levels,
            "state": self.state,
            "like": self.like,
            "states": self.states,
        }


class _Entry(msgspec.Struct):
    """A door as a file has it; of each state, lists of a level and runs of its cells."""

    id: str
    state: State
    cells: dict[State, list[tuple[int, list[int]]]]
    joint: str | None = None
    rooms: tuple[str | None, ...] = ()
    solid: dict[State, list[tuple[int, list[int]]]] = {}


def parse_doors(stated: Any, num_cells: Sequence[int]) -> tuple[Door, ...]:
    """Read and check the doors at ``metadata.navbake.doors``.

    `num_cells` counts the cells of each level; the doors' cells have to be among them.
    """
    doors: dict[str, Door] = {}
    entries: list[_Entry] = read_table(stated, list[_Entry], WHERE)
    for number, entry in enumerate(entries):
        if entry.id in doors:
            raise FormatError(
                f"expected unique ids, got {entry.id!r} twice at `{WHERE}[{number}].id`"
            )
        for by_state in (entry.cells, entry.solid):
            for state, by_level in by_state.items():
                levels = [level for level, _ in by_level]
                if len({*levels}) < len(levels) or not all(
                    0 <= level < len(num_cells) and _are_runs(runs, num_cells[level])
                    for level, runs in by_level
                ):
                    raise FormatError(
                        "expected each level once, with [first cell, count, …] within the grid, "
                        f"in state {state} at `{WHERE}[{number}]`"
                    )
        cells, solid = (
            {str(state): dict(by_level) for state, by_level in by_state.items()}
            for by_state in (entry.cells, entry.solid)
        )
        doors[entry.id] = Door(entry.id, entry.joint, entry.rooms, entry.state, cells, solid)
    return tuple(doors.values())


def _are_runs(runs: list[int], num_cells: int) -> bool:
    """Whether runs ascend, don't overlap, and end with the cells."""
    if len(runs) % 2:
        return False
    end = 0
    for first, count in zip(runs[::2], runs[1::2], strict=True):
        if first < end or not 0 < count <= num_cells - first:
            return False
        end = first + count
    return True
