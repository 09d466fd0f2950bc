"""Rooms: which one each cell belongs to, where they open to each other, and the table of them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.components import (
    adjacent_pairs,
    count_cells_by_label,
    find_row_runs,
    label_components,
)
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.windows import differing_pairs
from navbake.baker.rooms.flags import MarkedRooms, RoomFlags
from navbake.baker.rooms.gaps import CloseCall
from navbake.baker.rooms.leaves import ClosedLeaf, LeafMarks, mark_leaves
from navbake.baker.rooms.segmentation import (
    find_cavities,
    find_outdoors,
    give_covered,
    renumber,
    segment_by_gaps,
    share_leaves,
    share_rest,
)
from navbake.config.settings import RoomSettings
from navbake.errors import SceneError
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import DOOR_REACH, Neighbour, Room
from navbake.threads import run_beside
from navbake.types import Bool, Float, Int, Int32

RoomIndex = NDArray[np.uint16]
"""The room of each cell of a level, shape (height, width) of the whole lattice, 0 for none."""
RoomKey = tuple[int, int]
"""A room's level and index."""
RoomIds = tuple[str | None, str | None]
"""The rooms on the two sides of a door, None for the outside."""

# Close calls that a warning names
LISTED = 5
MAX_ROOMS = np.iinfo(np.uint16).max  # of a level
# The ids of rooms without a unique name look like this, so that no name may
ID_LIKE = re.compile(r"\d+:\d+")
MICRO = 1e6  # micrometres in a metre
# Two indices of rooms make one number, to sort by: the first times this, and the second
PAIR = 1 << 16


@dataclass(frozen=True)
class Opening:
    """Where a step leads from one room to another, the lower index first, on a level."""

    level: int
    rooms: tuple[int, int]
    cells: Int  # on both sides, ids on the whole lattice, ascending


@dataclass(frozen=True)
class Rooms:
    """The rooms of a scene."""

    index: list[RoomIndex]  # by level
    table: list[Room]  # by level and index; their neighbours: see `with_neighbours`
    openings: list[Opening]  # where rooms of a level meet
    links: list[tuple[RoomKey, RoomKey]]  # rooms between which a step leads to another level
    lattice: Lattice
    open_cells: list[Bool]  # by level, those that may be in a room: see `LevelFlags`
    warnings: list[str]  # what the user should know, one line each

    def id_of(self, level: int, index: int) -> str | None:
        """The id of a level's room by its index; None for none."""
        return self._ids.get((level, index))

    @cached_property
    def _ids(self) -> dict[RoomKey, str]:
        return {(room.level, room.index): room.id for room in self.table}

    def with_neighbours(self, doors: Mapping[str, tuple[RoomIds, Sequence[Int]]]) -> Rooms:
        """Name in the table what each room opens to: freely, by a link, or by a door.

        `doors` has by id the rooms that a door joins, and by level the cells that it blocks when it
        is closed; see `match_doors`.
        """
        named = match_doors(self.openings, doors, self._ids, self.lattice)
        ways = [(a, b, "link", "") for a, b in self.links]
        for number, opening in enumerate(self.openings):
            a, b = ((opening.level, room) for room in opening.rooms)
            ways += [(a, b, "door" if door else "open", door) for door in named.get(number, [""])]
        found: dict[RoomKey, set[tuple[RoomKey, str, str]]] = {room: set() for room in self._ids}
        for a, b, kind, door in ways:
            found[a].add((b, kind, door))
            found[b].add((a, kind, door))
        neighbours = {
            room: tuple(
                Neighbour(self._ids[to], way, door or None) for to, way, door in sorted(own)
            )
            for room, own in found.items()
        }
        table = [
            replace(room, neighbours=neighbours[room.level, room.index]) for room in self.table
        ]
        return replace(self, table=table)


class NamedRoom(NamedTuple):
    """A room's name, or None, the source that it is from, and whether it is outdoors."""

    name: str | None
    source: str
    outdoors: bool = False


def find_rooms(
    flags: RoomFlags,
    settings: RoomSettings,
    max_step: float,
    closed_leaves: Sequence[ClosedLeaf],
) -> Rooms:
    """Find the room that each cell belongs to.

    The source ``auto`` lets no room continue through a closed leaf that parts two spaces; two rooms
    meet in its cells. What such a leaf leads into is a room whatever its size.

    A cell's room is that of the first source that has one for it; for ``auto`` see `share_rest`.
    Cells without a floor, or in a wall or a window, belong to none. On each level, rooms are
    numbered by their first cells in reading order: from large y to small, from small x to large. A
    room over several levels is one room on each. Rooms of a level meet where steps of at most
    `max_step` [m] lead from one to another.
    """
    assignment = _Assignment(flags, settings, closed_leaves)
    for source in settings.sources:
        if source == "auto":
            assignment.segment()
        else:
            assignment.add(flags.marks[source], source)
    index = list[RoomIndex]()
    named = list[list[NamedRoom]]()
    for level, owner in enumerate(assignment.owner):
        number, order = renumber(owner)
        if len(order) > MAX_ROOMS:
            raise SceneError(
                f"expected at most {MAX_ROOMS} rooms on a level, got {len(order)} on level "
                f"{level}: raise `rooms.min_area`"
            )
        index.append(number.astype(np.uint16))
        named.append([assignment.rooms[k - 1] for k in order])
    floors = [level.floor for level in flags.levels]
    open_cells = [level.open for level in flags.levels]
    occupied = [level.occupied for level in flags.levels]
    table = run_beside(describe_rooms, index, named, floors, flags.lattice)
    openings = find_openings(index, floors, occupied, flags.links, max_step)
    ends = (
        sorted((k, int(index[k].flat[cell])) for k, cell in ((level_a, a), (level_b, b)))
        for level_a, a, level_b, b in flags.links[flags.links[:, 0] != flags.links[:, 2]].tolist()
    )
    links = sorted({(a, b) for a, b in ends if a[1] and b[1]})
    return Rooms(
        index,
        table(),
        openings,
        links,
        lattice=flags.lattice,
        open_cells=open_cells,
        warnings=assignment.warnings,
    )


class _Assignment:
    """The room of each cell as the sources add rooms; the first source that has one keeps it."""

    def __init__(
        self, flags: RoomFlags, settings: RoomSettings, closed_leaves: Sequence[ClosedLeaf]
    ) -> None:
        self._flags = flags
        self._settings = settings
        self._closed_leaves = closed_leaves
        shape = flags.lattice.shape
        self.owner = [np.zeros(shape, dtype=np.int32) for _ in flags.levels]
        # whose floor lies under the cell's own, for cells without an owner
        self._under = [np.zeros(shape, dtype=np.int32) for _ in flags.levels]
        self.rooms: list[NamedRoom] = []  # owners count from 1
        self.warnings: list[str] = []

    def add(self, marked: MarkedRooms, source: str) -> None:
        """Give the cells that have no room yet to the rooms of a source."""
        self.warnings += marked.warnings
        if not marked.names:
            return
        covered = marked.covered or marked.labels
        of_levels = self._flags.levels, self.owner, self._under, marked.labels, covered
        for flags, owner, under, label, cover in zip(*of_levels, strict=True):
            fresh = np.where(flags.open & (owner == 0), label, 0)
            number = np.zeros(len(marked.names) + 1, dtype=np.int32)
            used = count_cells_by_label(fresh, len(number))
            for k in np.flatnonzero(used[1:]).tolist():
                self.rooms.append(NamedRoom(marked.names[k], source, k + 1 in marked.outdoors))
                number[k + 1] = len(self.rooms)
            owner += number[fresh]
            if source != "auto":
                np.copyto(under, number[cover], where=under == 0)

    def segment(self) -> None:
        """Divide the remaining cells, see `segment_by_gaps`, `share_rest` and `find_outdoors`."""
        lattice = self._flags.lattice
        least = self._settings.min_area
        given = self._settings.door_width
        door_width = None if given == "auto" else given
        labels = list[Int32]()
        count = 0
        outdoors = set[int]()
        leaf_cells: list[Bool | None] = []
        for number, level in enumerate(self._flags.levels):
            leaves = mark_leaves(level, number, self._closed_leaves, lattice.cell_size)
            leaf_cells.append(None if leaves is None else leaves.parting & level.open)
            segment, close = segment_by_gaps(
                level,
                lattice.cell_size,
                least,
                door_width,
                walls=self._flags.walls,
                lattice=lattice,
                leaves=leaves,
            )
            if close and door_width is None:
                self.warnings.append(_describe_close(close, number, lattice))
            if self.owner[number].any():
                segment = self._share(number, segment, leaves)
            beyond = None if leaves is None else leaves.beyond
            cavities = find_cavities(segment, self.owner[number], self._flags, number, beyond)
            if cavities.any():
                segment, _ = renumber(np.where(cavities[segment], 0, segment))
            segment, outside = find_outdoors(segment, self._flags, number)
            outdoors.update(room + count for room in outside)
            labels.append(np.where(segment > 0, segment + count, 0) if count else segment)
            count += int(segment.max(initial=0))
        self.add(MarkedRooms([None] * count, labels, outdoors=outdoors), "auto")
        for owner, cells in zip(self.owner, leaf_cells, strict=True):
            if cells is not None:
                share_leaves(owner, cells)

    def _share(self, number: int, segment: Int32, leaves: LeafMarks | None) -> Int32:
        """Share a level's segments between marked rooms and new ones; returns the new ones."""
        level = self._flags.levels[number]
        cell_size = self._flags.lattice.cell_size
        least = self._settings.min_area
        marked = self.owner[number]
        owner = marked if leaves is None else np.where(leaves.parting, np.int32(0), marked)
        owner = give_covered(owner, self._under[number] * level.open, segment)
        beyond = None if leaves is None else leaves.beyond
        owner, rest = share_rest(owner, segment, cell_size, least, beyond)
        self.owner[number] = np.where(marked > 0, marked, owner)
        return rest


def _describe_close(close: Sequence[CloseCall], level: int, lattice: Lattice) -> str:
    """The warning of openings that were a close call."""
    listed = []
    for cell, width, parts in close[:LISTED]:
        x, y = lattice.positions(*cell).tolist()
        listed.append(f"{width:.1f} m at ({x:.1f}, {y:.1f}) {'parts' if parts else 'joins'}")
    more = f", and {len(close) - LISTED} more" if close[LISTED:] else ""
    return (
        f"openings of rooms on level {level} that were a close call: {', '.join(listed)}{more}; "
        "`rooms.door_width` in metres joins rooms at wider ones, `rooms.polygons` draws rooms"
    )


def describe_rooms(
    index: Sequence[RoomIndex],
    rooms: Sequence[Sequence[NamedRoom]],
    floors: Sequence[Float],
    lattice: Lattice,
) -> list[Room]:
    """Describe each room but for its neighbours; its id is its name, or ``<level>:<index>``."""
    names = Counter(room.name for level in rooms for room in level)
    table = []
    for level, (label, floor) in enumerate(zip(index, floors, strict=True)):
        row, first, end, room = find_row_runs(label)
        cells = end - first
        height = np.rint(floor[label > 0] * MICRO)
        heights = np.add.reduceat(height, np.cumsum(cells) - cells)
        # sums of whole numbers don't depend on the order; twice that of a run's columns is one
        sums = cells, row * cells, (first + end - 1) * cells, heights
        count, row_sum, col_sum, z_sum = (np.bincount(room, s, minlength=1) for s in sums)
        x = lattice.x_min + (col_sum / 2 / np.maximum(count, 1) + 0.5) * lattice.cell_size
        y = lattice.y_max - (row_sum / np.maximum(count, 1) + 0.5) * lattice.cell_size
        z = z_sum / np.maximum(count, 1) / MICRO
        center = (np.round(np.stack([x, y, z], axis=1), 6) + 0.0).tolist()  # no -0.0
        for k, (name, source, outdoors) in enumerate(rooms[level], 1):
            is_unique = names[name] == 1 and not ID_LIKE.fullmatch(name or "")
            area = round(float(count[k]) * lattice.cell_size**2, 6)
            room_id = name if name is not None and is_unique else f"{level}:{k}"
            table.append(Room(k, room_id, name, level, area, (*center[k],), source, (), outdoors))
    return table


def find_openings(
    index: Sequence[RoomIndex],
    floors: Sequence[Float],
    occupied: Sequence[Bool],
    links: Int,
    max_step: float,
) -> list[Opening]:
    """Find where neighbouring cells belong to two rooms and are a step or a slope apart.

    A slope is a link between cells of a level; 8-connected cells form one opening. One in which no
    two cells beside each other are free of what stands is closed (a curtain, a stub of a wall).
    """
    openings = []
    for number, (rooms, floor, taken) in enumerate(zip(index, floors, occupied, strict=True)):
        on_level = (links[:, [0, 2]] == number).all(axis=1)
        beside = differing_pairs(rooms).T  # few: only their heights are compared
        is_step = np.abs(np.subtract(*floor.ravel()[beside.T])) <= max_step + LIMIT_SLACK
        cells = np.concatenate([links[on_level][:, [1, 3]], beside[is_step]])
        ends = np.sort(rooms.ravel()[cells].astype(np.int64), axis=1)
        meet = (ends[:, 0] > 0) & (ends[:, 0] != ends[:, 1])
        if not meet.any():
            continue
        pairs, pair = np.unique(ends[meet] @ (PAIR, 1), return_inverse=True)
        # every two rooms on a lattice of their own, below that of the two before
        own = (rooms.shape[0] + 1) * rooms.shape[1]
        cell_keys = pair[:, None] * own + cells[meet]
        both, place = np.unique(cell_keys, return_inverse=True)
        part = label_components(adjacent_pairs(both, rooms.shape[1]), len(both))
        is_free = ~taken.ravel()[cells[meet]].any(axis=1)
        is_passable = np.zeros(int(part.max()) + 1, dtype=np.bool_)
        is_passable[part[place.reshape(-1, 2)[is_free]]] = True
        order = np.argsort(part, kind="stable")
        order = order[is_passable[part[order]]]
        if not len(order):
            continue
        for keys in np.split(both[order], np.flatnonzero(np.diff(part[order])) + 1):
            between = divmod(int(pairs[keys[0] // own]), PAIR)
            openings.append(Opening(number, between, keys % own))
    return openings


def match_doors(
    openings: Sequence[Opening],
    doors: Mapping[str, tuple[RoomIds, Sequence[Int]]],
    ids: Mapping[RoomKey, str],
    lattice: Lattice,
) -> dict[int, list[str]]:
    """The sorted ids of each opening's doors, by its number.

    `doors` are as for `Rooms.with_neighbours`.
    Of the openings between the two rooms that it joins, a door is in the one with most cells within
    `DOOR_REACH` of cells that it blocks when closed; of two as good, the nearer. It may be in none.
    """
    reach = DOOR_REACH / lattice.cell_size + LIMIT_SLACK
    found: dict[int, list[str]] = {}
    for door, (rooms, levels) in sorted(doors.items()):
        scores: list[tuple[int, float, int]] = []
        for number, opening in enumerate(openings):
            closed = levels[opening.level]
            if len(closed) and {ids[opening.level, room] for room in opening.rooms} == set(rooms):
                row, col = np.divmod(opening.cells[:, None], lattice.width)
                to_row, to_col = np.divmod(closed, lattice.width)
                distance = np.hypot(row - to_row, col - to_col).min(axis=1)
                within = int(np.count_nonzero(distance <= reach))
                scores.append((within, -float(distance.mean()), -number))
        if scores and max(scores)[0]:
            found.setdefault(-max(scores)[2], []).append(door)
    return found
