"""The rooms of a grid, parsed from a file's table or measured, and the doors between them.

For each state of a door, a grid holds the cells of each level that only this door blocks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal, TypeAlias, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.navgrid.lattice import Lattice, rounded
from navbake.navgrid.metadata import read_table
from navbake.types import Float, Int, Json, Vector3

ROOMS = "metadata.navbake.rooms"
DOORS = "metadata.navbake.doors"
DoorState: TypeAlias = Literal["modelled", "open", "closed", "removed"]
DOOR_STATES: tuple[str, ...] = get_args(DoorState)
# Rooms beside a yard are a building from this area on; a hut or a shelter in the open is none [m²]
MIN_BUILDING_AREA = 10.0
MAX_DOOR_DISTANCE = 0.4  # a door this close to an opening between rooms is in the opening [m]


@dataclass(frozen=True)
class Neighbour:
    """A room that another room has an opening to.

    Attributes:
        room: Id of the room.
        kind: ``open`` (no door between), ``door`` or ``link`` (a step to another level).
        door: Id of the door; None unless the kind is ``door``.
    """

    room: str
    kind: str = "open"
    door: str | None = None

    def to_json(self) -> Json:
        """Return the neighbour's entry in the file's table."""
        return {"room": self.room, "door": self.door, "kind": self.kind}


@dataclass(frozen=True)
class Room:
    """A room of a grid.

    Attributes:
        index: Its number on its level, from 1, as in `SceneGrid2D.room_index`.
        id: Its id, unique in the grid.
        name: Its name, from the scene or the settings; None for no name.
        level: Its level, 0 is the lowest.
        area: Its area [m²].
        centroid: Mean of the centres of its cells on their floors, world x, y, z [m].
        source: What defines it: ``geoms``, ``sites``, ``polygons``, ``auto``, …; None if unknown.
        neighbours: The rooms that it has an opening to.
        outdoors: Whether it is the area under the open sky outside of all walls.
    """

    index: int
    id: str
    name: str | None
    level: int
    area: float
    centroid: Vector3
    source: str | None = None
    neighbours: tuple[Neighbour, ...] = ()
    outdoors: bool = False

    def to_json(self) -> Json:
        """Return the room's entry in the file's table; `outdoors` only if true."""
        neighbours = [neighbour.to_json() for neighbour in self.neighbours]
        entry = {field.name: getattr(self, field.name) for field in fields(self)}
        entry |= {"centroid": list(self.centroid), "neighbours": neighbours}
        if not self.outdoors:
            del entry["outdoors"]
        return entry


def has_building(rooms: Sequence[Room]) -> bool:
    """Return whether the rooms are a building with an area outdoors round it.

    They are if some level has a room that is outdoors, and other rooms of at least
    `MIN_BUILDING_AREA` together.
    """
    for yard_level in {room.level for room in rooms if room.outdoors}:
        indoor_areas = [
            room.area for room in rooms if room.level == yard_level and not room.outdoors
        ]
        if sum(indoor_areas) >= MIN_BUILDING_AREA:
            return True
    return False


def parse_rooms(entries: object, num_levels: int) -> tuple[Room, ...]:
    """Check and convert ``metadata.navbake.rooms``.

    Args:
        entries: The table.
        num_levels: Number of levels of the grid.

    Returns:
        The rooms, sorted by level and index.

    Raises:
        FormatError: The table is broken, or a level does not exist.
    """
    if isinstance(entries, list | tuple):
        entries = [{"name": None, **room} if isinstance(room, dict) else room for room in entries]
    rooms: list[Room] = read_table(entries, list[Room], ROOMS)
    for entry_number, room in enumerate(rooms):
        if not 0 <= room.level < num_levels or room.index < 1:
            place = f"{ROOMS}[{entry_number}]"
            expected = "a level of the grid and an index >= 1"
            raise FormatError(
                f"expected {expected} at `{place}`",
                value=(room.level, room.index),
                expected=expected,
                place=place,
            )
    return tuple(sorted(rooms, key=lambda room: (room.level, room.index)))


def measure_rooms(
    room_index: NDArray[Any], floor_z: Float, lattice: Lattice, level_number: int
) -> list[Room]:
    """Describe the rooms of a level from its cells alone.

    The rooms have the id ``level:index``, and neither names nor neighbours.

    Args:
        room_index: Index of each cell's room, 0 for no room, shape (height, width), integers.
        floor_z: World z of each cell's floor [m], shape (height, width).
        lattice: The cells of the level.
        level_number: Number of the level, 0 is the lowest.

    Returns:
        The rooms, sorted by index.
    """
    x, y = np.meshgrid(lattice.center_x(), lattice.center_y())
    room_index = room_index.ravel()
    # bincount with weights sums the coordinates of all rooms' cells in one pass
    num_cells = np.bincount(room_index)
    num_cells_or_one = np.maximum(num_cells, 1)
    mean_x = np.bincount(room_index, x.ravel()) / num_cells_or_one
    mean_y = np.bincount(room_index, y.ravel()) / num_cells_or_one
    mean_z = np.bincount(room_index, floor_z.ravel()) / num_cells_or_one
    return [
        Room(
            index=int(index),
            id=f"{level_number}:{index}",
            name=None,
            level=level_number,
            area=round(float(num_cells[index]) * lattice.cell_size**2, 6),
            centroid=(rounded(mean_x[index]), rounded(mean_y[index]), rounded(mean_z[index])),
        )
        for index in np.flatnonzero(num_cells)
        if index
    ]


# ---------------------------------------------------------------- doors

Runs = list[int]
"""Ascending cell ids, packed as runs of consecutive ids: first id, count, first id, count, …"""


def to_runs(cells: Int) -> Runs:
    """Pack ascending cell ids, shape (n,), into runs: first id, number of ids, and so on."""
    run_starts = np.flatnonzero(np.diff(cells, prepend=-2) != 1)
    run_lengths = np.diff(run_starts, append=len(cells))
    runs: Runs = np.stack([cells[run_starts], run_lengths], axis=1).ravel().tolist()
    return runs


def from_runs(runs: Sequence[int]) -> Int:
    """Unpack the runs that `to_runs` made into ascending cell ids, shape (n,), int64."""
    run_pairs = np.array(runs, dtype=np.int64).reshape(-1, 2)
    if not len(run_pairs):
        return np.empty(0, dtype=np.int64)
    return np.concatenate([np.arange(first, first + count) for first, count in run_pairs])


@dataclass(frozen=True)
class Door:
    """A door of a grid.

    Attributes:
        id: Its id, unique in the grid.
        joint: Name of the joint that moves it; None for no joint.
        rooms: Ids of the two rooms that it joins, None for the outside; () if unknown.
        state: Its current state: ``modelled``, ``open``, ``closed`` or ``removed``.
        cells: State -> level -> the cells that only this door blocks, as runs of cell ids.
        solid: State -> level -> the cells whose squares only this door overlaps, as runs of cell
            ids; {} unless the grid has a layer ``solid``.
        width: Width of its leaf [m], as the bake measured it on the geometry; None if unknown.
    """

    id: str
    joint: str | None
    rooms: tuple[str | None, ...]
    state: str
    cells: Mapping[str, Mapping[int, Runs]] = field(repr=False)
    solid: Mapping[str, Mapping[int, Runs]] = field(default_factory=dict, repr=False)
    width: float | None = None

    @property
    def levels(self) -> list[int]:
        """The levels where it blocks cells in any state, ascending."""
        return sorted({level for by_level in self.cells.values() for level in by_level})

    @property
    def states(self) -> list[str]:
        """The states that it can have: ``removed``, and those for which the grid has its cells."""
        return [state for state in DOOR_STATES if state in self.cells or state == "removed"]

    @property
    def like(self) -> str | None:
        """The state that the modelled state equals: ``closed`` or ``open``, by the blocked cells.

        None if the door's current state isn't ``modelled``, or if it now blocks other cells than
        when it is closed or open.
        """
        modelled_cells = self.cells.get("modelled")
        if self.state != "modelled" or modelled_cells is None:
            return None
        for state in ("closed", "open"):
            if self.cells.get(state) == modelled_cells:
                return state
        return None

    def cells_in(self, state: str, num_levels: int) -> list[Int]:
        """Return the cells that only this door blocks in a state.

        Args:
            state: One of `DOOR_STATES`.
            num_levels: Number of levels of the grid.

        Returns:
            Ascending cell ids for each level, int64.
        """
        runs_by_level = self.cells.get(state, {})
        return [from_runs(runs_by_level.get(level, ())) for level in range(num_levels)]

    def solid_in(self, state: str, num_levels: int) -> list[Int]:
        """Return the cells whose own squares this door overlaps in a state, and nothing else does.

        Unlike in `cells_in`, the agent's radius doesn't count. Empty unless the grid has a layer
        ``solid``.

        Args:
            state: One of `DOOR_STATES`.
            num_levels: Number of levels of the grid.

        Returns:
            Ascending cell ids for each level, int64.
        """
        runs_by_level = self.solid.get(state, {})
        return [from_runs(runs_by_level.get(level, ())) for level in range(num_levels)]

    def to_json(self) -> Json:
        """Return the door as JSON, without its cells."""
        names = ("id", "joint", "rooms", "levels", "state", "like", "states", "width")
        return {name: getattr(self, name) for name in names} | {"rooms": list(self.rooms)}


class _DoorEntry(msgspec.Struct):
    """The entry of a door in a file; for each state, pairs of a level and the runs of cells."""

    id: str
    state: DoorState
    cells: dict[DoorState, list[tuple[int, list[int]]]]
    joint: str | None = None
    rooms: tuple[str | None, ...] = ()
    solid: dict[DoorState, list[tuple[int, list[int]]]] = {}
    width: Annotated[float, msgspec.Meta(ge=0, le=1e10)] | None = None


def parse_doors(entries: object, cell_counts: Sequence[int]) -> tuple[Door, ...]:
    """Check and convert ``metadata.navbake.doors``.

    Args:
        entries: The table.
        cell_counts: Number of cells of each level.

    Raises:
        FormatError: The table is broken, an id stands twice, or a cell does not exist.
    """
    doors: dict[str, Door] = {}
    door_entries: list[_DoorEntry] = read_table(entries, list[_DoorEntry], DOORS)
    for entry_number, entry in enumerate(door_entries):
        place = f"{DOORS}[{entry_number}]"
        if entry.id in doors:
            raise FormatError(
                f"expected unique ids, got {entry.id!r} twice at `{place}.id`",
                value=entry.id,
                expected="unique ids",
                place=f"{place}.id",
            )
        for runs_by_state in (entry.cells, entry.solid):
            for state, level_runs in runs_by_state.items():
                levels = [level for level, _ in level_runs]
                is_valid = len(set(levels)) == len(levels) and all(
                    0 <= level < len(cell_counts) and _are_runs(runs, cell_counts[level])
                    for level, runs in level_runs
                )
                if not is_valid:
                    expected = "each level once, with [first cell, count, …] within the grid"
                    raise FormatError(
                        f"expected {expected}, in state {state} at `{place}`",
                        expected=expected,
                        place=place,
                    )
        cells = {str(state): dict(level_runs) for state, level_runs in entry.cells.items()}
        solid = {str(state): dict(level_runs) for state, level_runs in entry.solid.items()}
        doors[entry.id] = Door(
            entry.id, entry.joint, entry.rooms, entry.state, cells, solid, width=entry.width
        )
    return tuple(doors.values())


def _are_runs(runs: list[int], num_cells: int) -> bool:
    """Return whether runs ascend, don't overlap, and hold only ids below `num_cells`."""
    if len(runs) % 2:
        return False
    previous_stop = 0
    for first, count in zip(runs[::2], runs[1::2], strict=True):
        if first < previous_stop or not 0 < count <= num_cells - first:
            return False
        previous_stop = first + count
    return True
