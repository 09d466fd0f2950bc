"""The rooms of a grid, read from a file's table or measured."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.navgrid.lattice import Lattice, rounded
from navbake.navgrid.metadata import read_table
from navbake.types import Float, Json, Vector3

WHERE = "metadata.navbake.rooms"


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
    rooms: list[Room] = read_table(stated, list[Room], WHERE)
    for number, room in enumerate(rooms):
        if not 0 <= room.level < num_levels or room.index < 1:
            where = f"`{WHERE}[{number}]`"
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
