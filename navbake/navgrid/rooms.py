"""The rooms of a grid: read from a file's table, or measured where there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from navbake.errors import FormatError
from navbake.types import Json, Vector3

if TYPE_CHECKING:
    from navbake.navgrid.grid import SceneGrid2D

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
    kind: str
    door: str | None

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
    source: str | None
    neighbours: tuple[Neighbour, ...]
    outdoors: bool = False

    def to_json(self) -> Json:
        """The room as a file has it; `outdoors` is only stated where it is true."""
        neighbours = [neighbour.to_json() for neighbour in self.neighbours]
        entry = {**vars(self), "centroid": list(self.centroid), "neighbours": neighbours}
        if not self.outdoors:
            del entry["outdoors"]
        return entry


# what a field of a room's entry may be; `source` may be missing as well
FIELDS: dict[str, tuple[type, ...]] = {
    "index": (int,),
    "id": (str,),
    "name": (str, type(None)),
    "level": (int,),
    "area": (int, float),
    "centroid": (list, tuple),
    "neighbours": (list, tuple),
}


def parse_rooms(stated: Any, num_levels: int) -> tuple[Room, ...]:
    """Read and check the table at ``metadata.navbake.rooms``; the rooms by level and index."""
    if not isinstance(stated, list | tuple):
        raise FormatError(f"expected a list at `{WHERE}`, got {type(stated).__name__}")
    rooms = [_parse(entry, f"{WHERE}[{i}]", num_levels) for i, entry in enumerate(stated)]
    return tuple(sorted(rooms, key=lambda room: (room.level, room.index)))


def _parse(entry: Any, where: str, num_levels: int) -> Room:
    if not isinstance(entry, dict):
        raise FormatError(f"expected a room at `{where}`, got {type(entry).__name__}")
    for key, kinds in FIELDS.items():
        if not isinstance(entry.get(key), kinds) or isinstance(entry.get(key), bool):
            raise FormatError(f"expected {kinds[0].__name__} at `{where}.{key}`")
    if not 0 <= entry["level"] < num_levels or entry["index"] < 1:
        raise FormatError(f"expected a level of the grid and an index >= 1 at `{where}`")
    if len(entry["centroid"]) != 3 or not all(type(v) in (int, float) for v in entry["centroid"]):
        raise FormatError(f"expected [x, y, z] at `{where}.centroid`")
    x, y, z = entry["centroid"]
    source = entry.get("source")
    return Room(
        index=entry["index"],
        id=entry["id"],
        name=entry.get("name"),
        level=entry["level"],
        area=entry["area"],
        centroid=(x, y, z),
        source=source if isinstance(source, str) else None,
        neighbours=tuple(_parse_neighbour(n, where) for n in entry["neighbours"]),
        outdoors=entry.get("outdoors") is True,
    )


def _parse_neighbour(entry: Any, where: str) -> Neighbour:
    if not isinstance(entry, dict) or not isinstance(entry.get("room"), str):
        raise FormatError(f"expected neighbours with a `room` at `{where}.neighbours`")
    kind, door = entry.get("kind"), entry.get("door")
    is_named = isinstance(door, str) and door != ""
    return Neighbour(
        room=entry["room"],
        kind=kind if isinstance(kind, str) else "door" if is_named else "open",
        door=door if is_named else None,
    )


def measure_rooms(level: SceneGrid2D, number: int) -> list[Room]:
    """Describe the rooms of a level, the `number`-th of its grid, from its `room_index` alone.

    They are sorted by index, have the id ``level:index``, and neither name nor neighbours.
    """
    index = level.room_index.ravel()
    if not index.any():  # as in maps of other programs, which may be large
        return []
    x, y = np.meshgrid(level.lattice.center_x(), level.lattice.center_y())
    floor = level.floor
    z = np.where(np.isnan(floor), level.ground, floor)
    # bincount with weights sums the coordinates of all rooms' cells in one pass
    count = np.bincount(index)
    sums = [np.bincount(index, values.ravel()) for values in (x, y, z)]
    return [
        Room(
            index=int(room),
            id=f"{number}:{room}",
            name=None,
            level=number,
            area=round(float(count[room]) * level.lattice.cell_size**2, 6),
            centroid=_rounded(*(float(total[room] / count[room]) for total in sums)),
            source=None,
            neighbours=(),
        )
        for room in np.flatnonzero(count)
        if room
    ]


def _rounded(x: float, y: float, z: float) -> Vector3:
    """To a micrometre, and without -0.0."""
    return round(x, 6) + 0.0, round(y, 6) + 0.0, round(z, 6) + 0.0
