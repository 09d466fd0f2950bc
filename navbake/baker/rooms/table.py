"""The table of rooms: what the file states of each room."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from navbake.baker.floors.levels import Floors
from navbake.baker.rooms.kernels.labels import sum_rooms
from navbake.baker.rooms.openings import Opening, RoomIndex, RoomKey
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import Neighbour, Room

# The ids of rooms without a unique name look like this, so that no name may
ID_LIKE = re.compile(r"\d+:\d+")


class NamedRoom(NamedTuple):
    """A room's name, or None, the source that it is from, and whether it is outdoors."""

    name: str | None
    source: str
    outdoors: bool = False


def describe_rooms(
    index: Sequence[RoomIndex],
    rooms: Sequence[Sequence[NamedRoom]],
    floors: Floors,
    lattice: Lattice,
) -> list[Room]:
    """Describe each room but for its neighbours; `rooms` has those of each level, from index 1 on.

    A room's id is its name where no other room has that, else ``<level>:<index>``.
    """
    names = Counter(room.name for level in rooms for room in level)
    table = []
    for number, (label, level) in enumerate(zip(index, floors.levels, strict=True)):
        count, *center = sum_rooms(
            label, level.floor, lattice.center_x(), lattice.center_y(), len(rooms[number])
        )
        for k, (name, source, outdoors) in enumerate(rooms[number], 1):
            is_unique = names[name] == 1 and not ID_LIKE.fullmatch(name or "")
            x, y, z = (round(float(c[k] / count[k]), 6) + 0.0 for c in center)  # no -0.0
            area = round(float(count[k]) * lattice.cell_size**2, 6)
            room_id = name if name is not None and is_unique else f"{number}:{k}"
            room = Room(k, room_id, name, number, area, (x, y, z), source, (), outdoors)
            table.append(room)
    return table


def name_neighbours(
    table: Sequence[Room],
    openings: Sequence[Opening],
    links: Sequence[tuple[RoomKey, RoomKey]],
    doors: Mapping[int, Sequence[str]],
) -> list[Room]:
    """Add to each room the rooms that it opens to: freely, through a door, or by a link.

    `doors` has, by the number of an opening, the ids of the doors in it; see `match_doors`.
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
    described = []
    for room in table:
        ways = sorted(found[room.level, room.index])
        neighbours = tuple(Neighbour(ids[to], kind, door or None) for to, kind, door in ways)
        described.append(replace(room, neighbours=neighbours))
    return described
