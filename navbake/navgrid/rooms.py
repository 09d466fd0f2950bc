"""The rooms of a grid: read from a file's table, or measured where there is none."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.metadata import read_table
from navbake.types import Float, Json, Vector3

WHERE = "metadata.navbake.rooms"


@dataclass(frozen=True)
class Neighbour:
    """A room that another one opens to.

    Attributes:
        room: its id.
        kind: ``open`` (no door between), ``door`` or ``link`` (a step to another level).
        door: the door's id, None unless the kind is ``door``.
    """

    room: str
    kind: str = "open"
    door: str | None = None

    def to_json(self) -> Json:
        """The neighbour as a file has it."""
        return {"room": self.room, "door": self.door, "kind": self.kind}


@dataclass(frozen=True)
class Room:
    """A room of a grid.

    Attributes:
        index: its number on its level, from 1, as in `SceneGrid2D.room_index`.
        id: unique in the grid.
        name: as the scene or the settings name it, None for none.
        level: its level, 0 is the lowest.
        area: [m²].
        centroid: mean of its cells' centres on their floors, world x, y, z [m].
        source: what it was found from: ``geoms``, ``sites``, ``polygons``, ``auto``, …; None
            where nothing says so.
        neighbours: the rooms that it opens to.
        outdoors: whether it is what lies under the open sky outside of all walls.
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
        """The room as a file has it; `outdoors` is only stated where it is true."""
        neighbours = [neighbour.to_json() for neighbour in self.neighbours]
        entry = {field.name: getattr(self, field.name) for field in fields(self)}
        entry |= {"centroid": list(self.centroid), "neighbours": neighbours}
        if not self.outdoors:
            del entry["outdoors"]
        return entry


def parse_rooms(stated: Any, num_levels: int) -> tuple[Room, ...]:
    """Read and check the table at ``metadata.navbake.rooms``; the rooms by level and index."""
    if isinstance(stated, list | tuple):
        stated = [{"name": None, **room} if isinstance(room, dict) else room for room in stated]
    rooms: list[Room] = read_table(stated, list[Room], WHERE)
    for number, room in enumerate(rooms):
        if not 0 <= room.level < num_levels or room.index < 1:
            where = f"`{WHERE}[{number}]`"
            raise FormatError(f"expected a level of the grid and an index >= 1 at {where}")
    return tuple(sorted(rooms, key=lambda room: (room.level, room.index)))


def measure_rooms(index: NDArray[Any], floor: Float, lattice: Lattice, number: int) -> list[Room]:
    """Describe the rooms of a level, the `number`-th of its grid, from its cells alone.

    They are sorted by index, have the id ``level:index``, and neither name nor neighbours.

    Args:
        index: the room of each cell, 0 for none, shape (height, width).
        floor: world z of each cell [m], shape (height, width).
        lattice: where the cells lie.
    """
    x, y = np.meshgrid(lattice.center_x(), lattice.center_y())
    index = index.ravel()
    # bincount with weights sums the coordinates of all rooms' cells in one pass
    count = np.bincount(index)
    sums = [np.bincount(index, values.ravel()) for values in (x, y, floor)]
    return [
        Room(
            index=int(room),
            id=f"{number}:{room}",
            name=None,
            level=number,
            area=round(float(count[room]) * lattice.cell_size**2, 6),
            centroid=_rounded(*(float(total[room] / count[room]) for total in sums)),
        )
        for room in np.flatnonzero(count)
        if room
    ]


def _rounded(x: float, y: float, z: float) -> Vector3:
    """To a micrometre, and without -0.0."""
    return round(x, 6) + 0.0, round(y, 6) + 0.0, round(z, 6) + 0.0
