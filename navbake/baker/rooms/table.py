"""The table of rooms: what the file states of each room."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.floors.levels import Floors
from navbake.baker.kernels.labels import measure_rooms
from navbake.baker.rooms.openings import Opening, RoomKey
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import Neighbour, Room

# The ids of rooms without a unique name look like this, so that no name may
ID_LIKE = re.compile(r"\d+:\d+")


class NamedRoom(NamedTuple):
    """A room's name, or None, and the source that it is from."""

    name: str | None
    source: str


def describe_rooms(
    index: Sequence[NDArray[np.uint16]],
    rooms: Sequence[Sequence[NamedRoom]],
    floors: Floors,
    lattice: Lattice,
) -> list[Room]:
    """Describe each room but for its neighbours.

    A room's id is its name where no other room has that, else ``<level>:<index>``.

    Args:
        index: the room of each cell by level, shape (height, width), 0 for none.
        rooms: by level, its rooms from index 1 on.
        floors: the storeys.
        lattice: the cells.
    """
    names = Counter(name for level in rooms for name, _ in level)
    table = []
    for number, (label, level) in enumerate(zip(index, floors.levels, strict=True)):
        count, *center = measure_rooms(
            label, level.floor, lattice.center_x(), lattice.center_y(), len(rooms[number])
        )
        for k, (name, source) in enumerate(rooms[number], 1):
            is_unique = names[name] == 1 and not ID_LIKE.fullmatch(name or "")
            x, y, z = (round(float(c[k] / count[k]), 6) + 0.0 for c in center)  # no -0.0
            room = Room(
                index=k,
                id=name if name is not None and is_unique else f"{number}:{k}",
                name=name,
                level=number,
                area=round(float(count[k]) * lattice.cell_size**2, 6),
                centroid=(x, y, z),
                source=source,
                neighbours=(),
            )
            table.append(room)
    return table


def name_neighbours(
    table: Sequence[Room],
    openings: Sequence[Opening],
    links: Sequence[tuple[RoomKey, RoomKey]],
    doors: Mapping[int, Sequence[str]],
) -> list[Room]:
    """Add to each room the rooms that it opens to: freely, through a door, or by a link.

    Args:
        table: the rooms.
        openings: where rooms of a level meet.
        links: pairs of rooms of two levels between which a step leads.
        doors: by the number of an opening, the ids of the doors in it.
    """
    ids = {(room.level, room.index): room.id for room in table}
    found: dict[RoomKey, set[tuple[RoomKey, str, str]]] = {room: set() for room in ids}
    for number, opening in enumerate(openings):
        a, b = ((opening.level, room) for room in opening.rooms)
        for door in doors.get(number, [""]):
            kind = "door" if door else "open"
            found[a].add((b, kind, door))
            found[b].add((a, kind, door))
    for a, b in links:
        found[a].add((b, "link", ""))
        found[b].add((a, "link", ""))
    return [
        replace(
            room,
            neighbours=tuple(
                Neighbour(room=ids[other], kind=kind, door=door or None)
                for other, kind, door in sorted(found[room.level, room.index])
            ),
        )
        for room in table
    ]
