"""The doors of a grid, as a file states them: the cells that each blocks, by state and level.

The file carries, for each door and state, the cells that only this door blocks. So another state
needs no scene and no new bake, see `navbake.navgrid.door_states`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from navbake.errors import FormatError
from navbake.types import Int, Json

STATES = ("modelled", "open", "closed", "removed")
WHERE = "metadata.navbake.doors"

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


def _unpack(per_level: Mapping[int, Runs], num_levels: int) -> list[Int]:
    return [from_runs(per_level.get(level, ())) for level in range(num_levels)]


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
        return _unpack(self.cells.get(state, {}), num_levels)

    def solid_in(self, state: str, num_levels: int) -> list[Int]:
        """The cells whose squares only this door meets in a state: ascending ids by level."""
        return _unpack(self.solid.get(state, {}), num_levels)

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


def parse_doors(stated: Any, num_cells: Sequence[int]) -> tuple[Door, ...]:
    """Read and check the doors at ``metadata.navbake.doors``.

    `num_cells` counts the cells of each level; the doors' cells have to be among them.
    """
    if not isinstance(stated, list | tuple):
        raise FormatError(f"expected a list at `{WHERE}`, got {type(stated).__name__}")
    doors: dict[str, Door] = {}
    for number, entry in enumerate(stated):
        here = f"{WHERE}[{number}]"
        door = _parse(entry, num_cells, here)
        if door.id in doors:
            raise FormatError(f"expected unique ids, got {door.id!r} twice at `{here}.id`")
        doors[door.id] = door
    return tuple(doors.values())


def _parse(entry: Any, num_cells: Sequence[int], here: str) -> Door:
    if not isinstance(entry, dict) or not isinstance(entry.get("cells"), dict):
        raise FormatError(f"expected a door with `cells` at `{here}`")
    if not isinstance(entry.get("id"), str) or entry.get("state") not in STATES:
        raise FormatError(f"expected a door with an `id` and a `state` at `{here}`")
    joint, rooms = entry.get("joint"), entry.get("rooms", [])
    are_rooms = isinstance(rooms, list | tuple) and all(isinstance(r, str | None) for r in rooms)
    if not isinstance(joint, str | None) or not are_rooms:
        raise FormatError(f"expected `joint` to be a name and `rooms` to be ids at `{here}`")
    cells = _parse_states(entry["cells"], num_cells, f"{here}.cells")
    solid = _parse_states(entry.get("solid", {}), num_cells, f"{here}.solid")
    return Door(entry["id"], joint, tuple(rooms), entry["state"], cells, solid)


def _parse_states(stated: Any, num_cells: Sequence[int], where: str) -> dict[str, dict[int, Runs]]:
    if not isinstance(stated, dict):
        raise FormatError(f"expected an object by state at `{where}`")
    cells = {}
    for state, entries in stated.items():
        if state not in STATES or not isinstance(entries, list):
            raise FormatError(f"expected a list for a known state at `{where}`")
        cells[state] = _parse_cells(entries, num_cells, f"`{where}.{state}`")
    return cells


def _parse_cells(entries: list[Any], num_cells: Sequence[int], where: str) -> dict[int, Runs]:
    per_level: dict[int, Runs] = {}
    for entry in entries:
        level, runs = entry if isinstance(entry, list) and len(entry) == 2 else (-1, [])
        is_level = type(level) is int and 0 <= level < len(num_cells)
        if not is_level or not _are_runs(runs, num_cells[level]):
            raise FormatError(
                f"expected [level, [first cell, count, …]] within the grid at {where}"
            )
        if level in per_level:
            raise FormatError(f"expected one entry a level, got level {level} twice at {where}")
        per_level[level] = runs
    return per_level


def _are_runs(runs: Any, num_cells: int) -> bool:
    if not isinstance(runs, list) or len(runs) % 2 or any(type(v) is not int for v in runs):
        return False
    end = 0  # runs ascend and don't overlap
    for first, count in zip(runs[::2], runs[1::2], strict=True):
        if first < end or not 0 < count <= num_cells - first:
            return False
        end = first + count
    return True
