"""The doors of a grid: for each door and state, the cells that only this door blocks, by level."""

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
    """A door of a grid."""

    id: str  #: Unique in the grid.
    joint: str | None  #: The joint that moves it, None for none.
    #: Ids of the two rooms that it joins, None for the outside; () if unknown.
    rooms: tuple[str | None, ...]
    state: str  #: The current one of `STATES`.
    #: Blocked cells by state and level, as runs of cell ids.
    cells: Mapping[str, Mapping[int, Runs]]
    #: Likewise the cells whose squares it overlaps, with a layer ``solid``.
    solid: Mapping[str, Mapping[int, Runs]] = field(default_factory=dict)

    @property
    def levels(self) -> list[int]:
        """The levels where it blocks cells in any state, ascending."""
        return sorted({level for per_level in self.cells.values() for level in per_level})

    @property
    def states(self) -> list[str]:
        return [state for state in STATES if state in self.cells or state == "removed"]

    @property
    def like(self) -> str | None:
        """Which of ``closed`` and ``open`` equals ``modelled``, if that is the current state."""
        as_modelled = self.cells.get("modelled")
        if self.state != "modelled" or as_modelled is None:
            return None
        return next((s for s in ("closed", "open") if self.cells.get(s) == as_modelled), None)

    def cells_in(self, state: str, num_levels: int) -> list[Int]:
        """Ascending ids by level of the cells that only this door blocks in a state."""
        return [from_runs(self.cells.get(state, {}).get(k, ())) for k in range(num_levels)]

    def solid_in(self, state: str, num_levels: int) -> list[Int]:
        """Ascending ids by level of the cells whose squares only this door overlaps in a state."""
        return [from_runs(self.solid.get(state, {}).get(k, ())) for k in range(num_levels)]

    def to_json(self) -> Json:
        """JSON of the door without its cells."""
        names = ("id", "joint", "rooms", "levels", "state", "like", "states")
        return {name: getattr(self, name) for name in names} | {"rooms": list(self.rooms)}


class _Entry(msgspec.Struct):
    """A door in a file; per state, pairs of a level and the runs of its cells."""

    id: str
    state: State
    cells: dict[State, list[tuple[int, list[int]]]]
    joint: str | None = None
    rooms: tuple[str | None, ...] = ()
    solid: dict[State, list[tuple[int, list[int]]]] = {}


def parse_doors(stated: Any, num_cells: Sequence[int]) -> tuple[Door, ...]:
    """Read and check ``metadata.navbake.doors``, on levels of `num_cells` cells each."""
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
    """Whether runs ascend, don't overlap, and stay within the cells."""
    if len(runs) % 2:
        return False
    end = 0
    for first, count in zip(runs[::2], runs[1::2], strict=True):
        if first < end or not 0 < count <= num_cells - first:
            return False
        end = first + count
    return True
