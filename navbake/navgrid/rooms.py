"""The rooms of a grid, read from a file's table or measured, and the doors between them.

Of a door a grid has, for each state, the cells that only this door blocks, by level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, TypeAlias, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.navgrid.lattice import Lattice, rounded
from navbake.navgrid.metadata import read_table
from navbake.types import Float, Int, Json, Vector3

ROOMS = "metadata.navbake.rooms"
DOORS = "metadata.navbake.doors"
State: TypeAlias = Literal["modelled", "open", "closed", "removed"]
STATES: tuple[str, ...] = get_args(State)
# A door is in an opening if they are at most this far apart [m]
DOOR_REACH = 0.4


@dataclass(frozen=True)
class Neighbour:
    """A room with an opening to another one."""

    room: str  #: Its id.
    #: ``open`` (no door between), ``door`` or ``link`` (a step to another level).
    kind: str = "open"
    door: str | None = None  #: The door's id, None unless the kind is ``door``.

    def to_json(self) -> Json:
        return {"room": self.room, "door": self.door, "kind": self.kind}


@dataclass(frozen=True)
class Room:
    """A room of a grid."""

    index: int  #: Its number on its level, from 1, as in `SceneGrid2D.room_index`.
    id: str  #: Unique in the grid.
    name: str | None  #: From the scene or the settings, None for none.
    level: int  #: 0 is the lowest.
    area: float  #: [m²].
    centroid: Vector3  #: Mean of its cells' centres on their floors, world x, y, z [m].
    source: str | None = None  #: ``geoms``, ``sites``, ``polygons``, ``auto``, …; None if unknown.
    neighbours: tuple[Neighbour, ...] = ()  #: The rooms with an opening to it.
    outdoors: bool = False  #: Whether it is the area under the open sky outside of all walls.

    def to_json(self) -> Json:
        """JSON of the room; `outdoors` only if true."""
        neighbours = [neighbour.to_json() for neighbour in self.neighbours]
        entry = {field.name: getattr(self, field.name) for field in fields(self)}
        entry |= {"centroid": list(self.centroid), "neighbours": neighbours}
        if not self.outdoors:
            del entry["outdoors"]
        return entry


def parse_rooms(stated: Any, num_levels: int) -> tuple[Room, ...]:
    """Read and check ``metadata.navbake.rooms``; the rooms by level and index."""
    if isinstance(stated, list | tuple):
        stated = [{"name": None, **room} if isinstance(room, dict) else room for room in stated]
    rooms: list[Room] = read_table(stated, list[Room], ROOMS)
    for number, room in enumerate(rooms):
        if not 0 <= room.level < num_levels or room.index < 1:
            where = f"`{ROOMS}[{number}]`"
            raise FormatError(f"expected a level of the grid and an index >= 1 at {where}")
    return tuple(sorted(rooms, key=lambda room: (room.level, room.index)))


def measure_rooms(index: NDArray[Any], floor: Float, lattice: Lattice, number: int) -> list[Room]:
    """Describe the rooms of level `number` from its cells alone, sorted by index.

    They have the id ``level:index``, and neither name nor neighbours. `index` is the room of each
    cell, 0 for none, `floor` its world z [m]; both of shape (height, width).
    """
    x, y = np.meshgrid(lattice.center_x(), lattice.center_y())
    index = index.ravel()
    # bincount with weights sums the coordinates of all rooms' cells in one pass
    count = np.bincount(index)
    sums = (np.bincount(index, values.ravel()) for values in (x, y, floor))
    mean_x, mean_y, mean_z = (total / np.maximum(count, 1) for total in sums)
    return [
        Room(
            index=int(room),
            id=f"{number}:{room}",
            name=None,
            level=number,
            area=round(float(count[room]) * lattice.cell_size**2, 6),
            centroid=(rounded(mean_x[room]), rounded(mean_y[room]), rounded(mean_z[room])),
        )
        for room in np.flatnonzero(count)
        if room
    ]


# ---------------------------------------------------------------- doors

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
    entries: list[_Entry] = read_table(stated, list[_Entry], DOORS)
    for number, entry in enumerate(entries):
        if entry.id in doors:
            raise FormatError(
                f"expected unique ids, got {entry.id!r} twice at `{DOORS}[{number}].id`"
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
                        f"in state {state} at `{DOORS}[{number}]`"
                    )
        cells = {str(state): dict(by_level) for state, by_level in entry.cells.items()}
        solid = {str(state): dict(by_level) for state, by_level in entry.solid.items()}
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
