"""The doors of a grid, and the same grid with its doors in other states.

A file carries, for each door and state, the cells that only this door blocks, by level. So another
state needs no scene and no new bake.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, get_args

import msgspec
import numpy as np

from navbake.errors import FormatError, QueryError
from navbake.known_names import suggest
from navbake.navgrid.block_state import BLOCKED, OCCUPIED
from navbake.navgrid.islands import add_layers
from navbake.navgrid.metadata import read_table
from navbake.navgrid.user_data import NAMES, UserData, names_in
from navbake.types import Bool, Int, Json

if TYPE_CHECKING:
    from navbake.navgrid.grid_base import GridBase

AnyGrid = TypeVar("AnyGrid", bound="GridBase")

State: TypeAlias = Literal["modelled", "open", "closed", "removed"]
STATES: tuple[str, ...] = get_args(State)
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


def with_doors(grid: AnyGrid, states: Mapping[str, str] | str) -> AnyGrid:
    """The same grid with doors in other states: equal to a bake with them in these states.

    Args:
        states: ``modelled``, ``open``, ``closed`` or ``removed``, by a door's id or for all.

    Raises:
        QueryError: a door or a state does not exist, or the grid was inflated.
    """
    if "inflation" in grid.metadata:
        raise QueryError(
            f"{grid.scene_id!r} was inflated: change doors on the grid as it was baked, then "
            "inflate the result"
        )
    if not isinstance(states, str | Mapping):
        raise QueryError(f"expected a state, or states by door, got {states!r}")
    before = {door.id: door for door in grid.doors}
    wanted = dict.fromkeys(before, states) if isinstance(states, str) else states
    for name, state in wanted.items():
        if name not in before:
            hint = suggest(name, sorted(before))
            raise QueryError(f"no door {name!r} in {grid.scene_id!r}: {hint}")
        if state not in STATES:
            raise QueryError(f"expected one of {', '.join(STATES)} for {name!r}, got {state!r}")
        if state not in before[name].states:
            possible = ", ".join(before[name].states)
            raise QueryError(f"door {name!r} can't be {state}: it can be {possible}")
    after = [replace(door, state=wanted.get(door.id, door.state)) for door in before.values()]
    occupied, solid = (
        [layer.astype(np.bool_).ravel() for layer in layers]
        for layers in zip(*((level.occupancy, level.solid) for level in grid.levels), strict=True)
    )
    # doors may overlap: all are taken out before any is put in
    for doors, is_there in ((before.values(), False), (after, True)):
        for door in doors:
            cells = door.cells_in(door.state, len(occupied)), door.solid_in(door.state, len(solid))
            for ids, mask in zip([*cells[0], *cells[1]], [*occupied, *solid], strict=True):
                mask[ids] = is_there
    return _rebuild(grid, after, occupied, solid)


def _rebuild(
    grid: AnyGrid, doors: Sequence[Door], occupied: list[Bool], solid: list[Bool]
) -> AnyGrid:
    levels = []
    for number, (level, mask) in enumerate(zip(grid.levels, occupied, strict=True)):
        is_occupied, was_occupied = mask.reshape(level.shape), level.occupancy.astype(np.bool_)
        is_solid = solid[number].reshape(level.shape)
        state = level.block_state
        if state is not None:
            is_occupied |= state.held(level, OCCUPIED)
            is_solid |= state.held(level, OCCUPIED)
        weights = level.weights.copy()
        # cells that no door changes keep their weight, whatever it is
        weights[is_occupied & ~was_occupied] = np.inf
        weights[~is_occupied & was_occupied] = 1.0
        if state is not None:
            weights[state.held(level, BLOCKED)] = np.inf
        named = None
        if grid.navbake.get("names", True):
            named = with_door_names(UserData.of(level.user_data), doors, number, len(occupied))
        attributes = {"occupancy": is_occupied.astype(np.uint8)}
        if "solid" in level.attributes:
            attributes["solid"] = is_solid.astype(np.uint8)
        levels.append(level.with_layers(weights=weights, attributes=attributes, user_data=named))
    stated = zip(grid.navbake.get("doors", []), doors, strict=True)
    tables = [{**entry, "state": door.state} for entry, door in stated]
    metadata = {**grid.metadata, "navbake": {**grid.navbake, "doors": tables}}
    rebuilt = grid.with_levels(levels, metadata)
    add_layers(rebuilt, {name for level in levels for name in level.attributes})
    return rebuilt


def with_door_names(
    user_data: UserData, doors: Sequence[Door], level: int, num_levels: int
) -> UserData:
    """The user data of a level with the doors of each cell, by ascending cell id.

    A cell is in a door where the door blocks it when closed, or as it stands. Where it blocks as
    it stands, the door is one of the cell's objects, too.
    """
    if not doors:
        return user_data  # without reading them
    # All cells that a door blocks in any state, most of them with no door: the user data may be
    # from that state.
    names: dict[int, set[str]] = {}
    standing: dict[int, set[str]] = {}
    for door in doors:
        for state in door.cells:
            for cell in door.cells_in(state, num_levels)[level].tolist():
                found = names.setdefault(cell, set())
                if state in ("closed", door.state):
                    found.add(door.id)
                if state == door.state:
                    standing.setdefault(cell, set()).add(door.id)
    ids = {door.id for door in doors}
    known = user_data.find(np.fromiter(names, dtype=np.int64, count=len(names)))
    changed: dict[int, Json] = {}
    for (cell, found), before in zip(names.items(), known, strict=True):
        entry = _without_doors(before, ids)
        changed[cell] = _with_doors(entry, found, standing.get(cell, set())) if found else entry
    return user_data.replaced(changed)


def _without_doors(entry: Json, ids: set[str]) -> Json:
    """A cell's user data without doors, and without blockers: they may name a door."""
    if "doors" not in entry:
        return entry
    kept = {key: value for key, value in entry.items() if key not in ("doors", "blockers")}
    if isinstance(kept.get("objects"), list):
        kept["objects"] = [name for name in names_in(kept, "objects") if name not in ids]
    return {key: value for key, value in kept.items() if key != "objects" or value != []}


def _with_doors(entry: Json, names: set[str], standing: set[str]) -> Json:
    """A cell's user data with the doors that it is in, and those of them that block it."""
    objects = sorted({*names_in(entry, "objects"), *standing})
    named = {"doors": sorted(names), **({"objects": objects} if objects else {})}
    named |= {key: value for key, value in entry.items() if key not in named}
    # blockers are stated only where they aren't all that stands in the cell
    if standing and standing != {name for key in NAMES for name in names_in(named, key)}:
        named["blockers"] = sorted(standing)
    return named
