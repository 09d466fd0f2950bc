"""Finds the room of each cell and the openings between rooms, and makes the table of rooms."""

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
from navbake.baker.rooms.flags import LevelFlags, MarkedRooms, RoomFlags
from navbake.baker.rooms.gaps import CloseCall
from navbake.baker.rooms.leaves import ClosedLeaf, LeafMarks, mark_leaves
from navbake.baker.rooms.segmentation import (
    assign_covered,
    assign_leaf_cells,
    assign_unmarked,
    find_outdoors,
    mark_cavities,
    renumber,
    segment_by_gaps,
)
from navbake.config.settings import RoomSettings
from navbake.errors import SceneError
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import MAX_DOOR_DISTANCE, Neighbour, Room
from navbake.threads import run_beside
from navbake.types import Bool, Float, Int, Int32

RoomIndex = NDArray[np.uint16]
"""The index of each cell's room on a level, from 1, 0 for none; shape (height, width) of the whole
lattice."""
RoomKey = tuple[int, int]
"""The number of a room's level, and the room's index on that level."""
RoomIds = tuple[str | None, str | None]
"""The ids of the rooms on the two sides of a door, None for the outside."""

# The most close calls that a warning lists
MAX_LISTED_CLOSE_CALLS = 5
# The most rooms of a level: the largest number in a RoomIndex
MAX_ROOMS = np.iinfo(np.uint16).max
# Rooms without a unique name have ids like this; so a name like this is not used as an id
ID_LIKE = re.compile(r"\d+:\d+")
# Heights are summed in whole micrometres, so that the order of cells makes no difference
MICROMETRES = 1e6  # in a metre
# Two indices of rooms become one number to sort by: the first times this, plus the second
PAIR_BASE = 1 << 16


@dataclass(frozen=True)
class Opening:
    """A place where an agent can walk from one room to another on the same level.

    Attributes:
        level: the number of the level.
        rooms: the indices of both rooms, the lower one first.
        cells: ids of the cells on both sides of the opening, on the whole lattice, ascending.
    """

    level: int
    rooms: tuple[int, int]
    cells: Int


@dataclass(frozen=True)
class Rooms:
    """The rooms of a scene.

    Attributes:
        index: for each level, the index of each cell's room, shape (height, width).
        table: the rooms, ordered by level and index; `with_neighbours` adds their neighbours.
        openings: the openings between rooms of a level.
        links: pairs of rooms on different levels that a step joins.
        lattice: the whole lattice.
        open_cells: for each level, a mask of the cells that may be in a room, shape (height,
            width), see `LevelFlags.is_open`.
        warnings: warnings for the user, one line each.
    """

    index: list[RoomIndex]
    table: list[Room]
    openings: list[Opening]
    links: list[tuple[RoomKey, RoomKey]]
    lattice: Lattice
    open_cells: list[Bool]
    warnings: list[str]

    def id_of(self, level: int, index: int) -> str | None:
        """Return the id of a room.

        Args:
            level: the number of the room's level.
            index: the room's index on that level, from 1.

        Returns:
            The id, None if there is no such room.
        """
        return self._ids.get((level, index))

    @cached_property
    def _ids(self) -> dict[RoomKey, str]:
        return {(room.level, room.index): room.id for room in self.table}

    def with_neighbours(self, doors: Mapping[str, tuple[RoomIds, Sequence[Int]]]) -> Rooms:
        """Return a copy of the rooms whose table lists the neighbours of each room.

        Neighbours are joined by an opening on one level, or by a step between two levels. An
        opening that has doors makes one neighbour for each of its doors.

        Args:
            doors: id of a door -> the ids of the rooms that it joins; and, for each level, the ids
                of the cells that it blocks when it is closed.
        """
        doors_of = match_doors(self.openings, doors, self._ids, self.lattice)
        # Sets of (room, kind, door), see `Neighbour`; "" for no door, because None doesn't sort
        neighbours: dict[RoomKey, set[tuple[RoomKey, str, str]]] = {
            room: set() for room in self._ids
        }
        for first, second in self.links:
            neighbours[first].add((second, "link", ""))
            neighbours[second].add((first, "link", ""))
        for number, opening in enumerate(self.openings):
            first = (opening.level, opening.rooms[0])
            second = (opening.level, opening.rooms[1])
            for door in doors_of.get(number, [""]):
                kind = "door" if door else "open"
                neighbours[first].add((second, kind, door))
                neighbours[second].add((first, kind, door))
        table = [
            replace(
                room,
                neighbours=tuple(
                    Neighbour(self._ids[neighbour], kind, door or None)
                    for neighbour, kind, door in sorted(neighbours[room.level, room.index])
                ),
            )
            for room in self.table
        ]
        return replace(self, table=table)


class NamedRoom(NamedTuple):
    """The name of a room, where the room comes from, and whether it is outdoors.

    Attributes:
        name: the name, None for a room without a name.
        source: what marks the room: ``geoms``, ``sites`` or ``polygons``; or ``auto`` if it was
            found automatically.
        outdoors: whether it is outdoors.
    """

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

    The sources of the settings are tried in their order, and the first that has a room for a cell
    decides. The source ``auto`` divides what the others leave over, see `assign_unmarked`. Cells
    without a floor, or in a wall or a window, belong to no room. On each level, rooms are numbered
    by their first cells in reading order: from large y to small, from small x to large. A room
    that a geom, site or polygon marks on several levels is a separate room on each of them.

    A closed door leaf that parts the floor separates rooms of the source ``auto``: they meet in the
    leaf's cells. The floor behind such a leaf is a room whatever its size.

    Args:
        flags: all that rooms depend on besides the other arguments.
        settings: sources and limits.
        max_step: the agent's highest step [m]; where floors of two rooms differ by more, there is
            no opening between them.
        closed_leaves: all door leaves of the scene, in their closed state.

    Returns:
        The rooms, without neighbours in their table.

    Raises:
        SceneError: there are more rooms on a level than a file can number.
    """
    assignment = _RoomAssignment(flags, settings, closed_leaves)
    for source in settings.sources:
        if source == "auto":
            assignment.add_segments()
        else:
            assignment.add_source(flags.marks[source], source)
    index = list[RoomIndex]()
    named_rooms = list[list[NamedRoom]]()
    for level, owner in enumerate(assignment.owner):
        number, owners = renumber(owner)
        if len(owners) > MAX_ROOMS:
            raise SceneError(
                f"expected at most {MAX_ROOMS} rooms on a level, got {len(owners)} on level "
                f"{level}: raise `rooms.min_area`"
            )
        index.append(number.astype(np.uint16))
        named_rooms.append([assignment.rooms[k - 1] for k in owners])
    floors = [level.floor for level in flags.levels]
    occupied = [level.occupied for level in flags.levels]
    wait_for_table = run_beside(describe_rooms, index, named_rooms, floors, flags.lattice)
    openings = find_openings(index, floors, occupied, flags.links, max_step)
    links = _find_links(index, flags.links)
    return Rooms(
        index=index,
        table=wait_for_table(),
        openings=openings,
        links=links,
        lattice=flags.lattice,
        open_cells=[level.is_open for level in flags.levels],
        warnings=assignment.warnings,
    )


def _find_links(index: Sequence[RoomIndex], links: Int) -> list[tuple[RoomKey, RoomKey]]:
    """Return the pairs of rooms on different levels that a step joins, each pair once, sorted.

    Args:
        index: for each level, the index of each cell's room.
        links: pairs of cells that a step or a slope joins, see `Floors.links`, shape (n, 4).
    """
    pairs = set[tuple[RoomKey, RoomKey]]()
    to_another_level = links[links[:, 0] != links[:, 2]]
    for first_level, first_cell, second_level, second_cell in to_another_level.tolist():
        first = (first_level, int(index[first_level].flat[first_cell]))
        second = (second_level, int(index[second_level].flat[second_cell]))
        if first[1] and second[1]:
            pairs.add((min(first, second), max(first, second)))
    return sorted(pairs)


class _RoomAssignment:
    """Assigns cells to rooms, source by source; the first source with a room for a cell decides.

    Attributes:
        owner: for each level, the number of each cell's room, shape (height, width); 0 for none,
            room number k + 1 is ``rooms[k]``.
        rooms: the rooms of all levels so far.
        warnings: warnings for the user, one line each.
    """

    def __init__(
        self, flags: RoomFlags, settings: RoomSettings, closed_leaves: Sequence[ClosedLeaf]
    ) -> None:
        self._flags = flags
        self._settings = settings
        self._closed_leaves = closed_leaves
        shape = flags.lattice.shape
        self.owner = [np.zeros(shape, dtype=np.int32) for _ in flags.levels]
        # For cells without an owner: the room whose floor is under the cell's own floor
        self._under = [np.zeros(shape, dtype=np.int32) for _ in flags.levels]
        self.rooms: list[NamedRoom] = []
        self.warnings: list[str] = []

    def add_source(self, marked: MarkedRooms, source: str) -> None:
        """Add the rooms that a source marks; each takes those of its cells that have no room yet.

        Args:
            marked: the rooms of the source.
            source: the name of the source, see `NamedRoom.source`.
        """
        self.warnings += marked.warnings
        if not marked.names:
            return
        for level, flags in enumerate(self._flags.levels):
            owner = self.owner[level]
            label = np.where(flags.is_open & (owner == 0), marked.labels[level], 0)
            new_owner = np.zeros(len(marked.names) + 1, dtype=np.int32)  # by label
            num_cells = count_cells_by_label(label, len(new_owner))
            for k in np.flatnonzero(num_cells[1:]).tolist():
                self.rooms.append(NamedRoom(marked.names[k], source, k + 1 in marked.outdoors))
                new_owner[k + 1] = len(self.rooms)
            owner += new_owner[label]
            if source != "auto":
                covered = marked.covered or marked.labels
                under = self._under[level]
                np.copyto(under, new_owner[covered[level]], where=under == 0)

    def add_segments(self) -> None:
        """Divide the cells that have no room yet into rooms: the source ``auto``.

        The floor is divided at narrow places, such as doorways, see `segment_by_gaps`.
        """
        labels = list[Int32]()
        outdoors = set[int]()
        separating_cells: list[Bool | None] = []
        count = 0  # of new rooms on the levels so far
        for number, level in enumerate(self._flags.levels):
            leaves = mark_leaves(level, number, self._closed_leaves, self._flags.lattice.cell_size)
            separating_cells.append(None if leaves is None else leaves.separating & level.is_open)
            segment, outdoor_segments = self._segment_level(number, level, leaves)
            outdoors.update(room + count for room in outdoor_segments)
            labels.append(np.where(segment > 0, segment + count, 0) if count else segment)
            count += int(segment.max(initial=0))
        self.add_source(MarkedRooms([None] * count, labels, outdoors=outdoors), "auto")
        for owner, cells in zip(self.owner, separating_cells, strict=True):
            if cells is not None:
                assign_leaf_cells(owner, cells)

    def _segment_level(
        self, number: int, level: LevelFlags, leaves: LeafMarks | None
    ) -> tuple[Int32, set[int]]:
        """Find the rooms of a level that no other source marks.

        Marked rooms may get more cells: `owner` is changed.

        Args:
            number: the number of the level.
            level: the flags of the level's cells.
            leaves: the cells of the level's closed door leaves; None if there are none.

        Returns:
            The number of each cell's new room, from 1, 0 for none, shape (height, width); and the
            numbers of the new rooms that are outdoors.
        """
        lattice = self._flags.lattice
        door_width = self._settings.door_width
        segment, close_calls = segment_by_gaps(
            level,
            lattice.cell_size,
            self._settings.min_area,
            None if door_width == "auto" else door_width,
            walls=self._flags.walls,
            lattice=lattice,
            leaves=leaves,
        )
        if close_calls and door_width == "auto":
            self.warnings.append(_describe_close_calls(close_calls, number, lattice))
        beyond = None if leaves is None else leaves.cells_beyond
        if self.owner[number].any():
            segment = self._share_segments(number, segment, leaves)
        is_cavity = mark_cavities(segment, self.owner[number], self._flags, number, beyond)
        if is_cavity.any():
            segment, _ = renumber(np.where(is_cavity[segment], 0, segment))
        return find_outdoors(segment, self._flags, number)

    def _share_segments(self, number: int, segment: Int32, leaves: LeafMarks | None) -> Int32:
        """Divide the cells of a level between marked rooms and new rooms; changes `owner`.

        Args:
            number: the number of the level.
            segment: the part of the floor, between narrow places, that each cell belongs to, from
                1, 0 for none; see `segment_by_gaps`.
            leaves: the cells of the level's closed door leaves; None if there are none.

        Returns:
            The number of each cell's new room, from 1, 0 for none, shape (height, width).
        """
        level = self._flags.levels[number]
        marked = self.owner[number]
        owner = marked if leaves is None else np.where(leaves.separating, np.int32(0), marked)
        owner = assign_covered(owner, self._under[number] * level.is_open, segment)
        owner, new_room = assign_unmarked(
            owner,
            segment,
            self._flags.lattice.cell_size,
            self._settings.min_area,
            None if leaves is None else leaves.cells_beyond,
        )
        self.owner[number] = np.where(marked > 0, marked, owner)
        return new_room


def _describe_close_calls(calls: Sequence[CloseCall], level: int, lattice: Lattice) -> str:
    """Make the warning that lists the openings that nearly joined, or nearly parted, two rooms."""
    listed = []
    for cell, width, separates in calls[:MAX_LISTED_CLOSE_CALLS]:
        x, y = lattice.positions(*cell).tolist()
        listed.append(f"{width:.1f} m at ({x:.1f}, {y:.1f}) {'parts' if separates else 'joins'}")
    num_more = len(calls) - MAX_LISTED_CLOSE_CALLS
    more = f", and {num_more} more" if num_more > 0 else ""
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
    """Make the table of rooms, without neighbours.

    A room's id is its name if no other room has that name, else ``<level>:<index>``.

    Args:
        index: for each level, the index of each cell's room.
        rooms: for each level, its rooms, in the order of indices.
        floors: for each level, z of the floors, shape (height, width) [m].
        lattice: the whole lattice.
    """
    name_counts = Counter(room.name for level in rooms for room in level)
    table = []
    for level, (label, floor) in enumerate(zip(index, floors, strict=True)):
        row, first, end, room = find_row_runs(label)
        num_cells = end - first
        micrometres = np.rint(floor[label > 0] * MICROMETRES)
        height_sums = np.add.reduceat(micrometres, np.cumsum(num_cells) - num_cells)
        # Sums of whole numbers don't depend on their order. The mean column of a run of cells may
        # end in .5, so twice its sum is used.
        count = np.bincount(room, num_cells, minlength=1)
        row_sum = np.bincount(room, row * num_cells, minlength=1)
        twice_col_sum = np.bincount(room, (first + end - 1) * num_cells, minlength=1)
        z_sum = np.bincount(room, height_sums, minlength=1)
        x = lattice.x_min + (twice_col_sum / 2 / np.maximum(count, 1) + 0.5) * lattice.cell_size
        y = lattice.y_max - (row_sum / np.maximum(count, 1) + 0.5) * lattice.cell_size
        z = z_sum / np.maximum(count, 1) / MICROMETRES
        center = (np.round(np.stack([x, y, z], axis=1), 6) + 0.0).tolist()  # no -0.0
        for k, (name, source, outdoors) in enumerate(rooms[level], 1):
            is_unique = name_counts[name] == 1 and not ID_LIKE.fullmatch(name or "")
            table.append(
                Room(
                    index=k,
                    id=name if name is not None and is_unique else f"{level}:{k}",
                    name=name,
                    level=level,
                    area=round(float(count[k]) * lattice.cell_size**2, 6),
                    centroid=(*center[k],),
                    source=source,
                    outdoors=outdoors,
                )
            )
    return table


def find_openings(
    index: Sequence[RoomIndex],
    floors: Sequence[Float],
    occupied: Sequence[Bool],
    links: Int,
    max_step: float,
) -> list[Opening]:
    """Find the openings between rooms: places where an agent can walk from one room to the next.

    Two neighbouring cells of different rooms are part of an opening if their floors differ by at
    most a step, or if a slope links them. Such cells of the same two rooms that touch, also at
    corners, form one opening. An opening in which no two neighbouring cells are both unoccupied is
    left out: a curtain or a piece of wall closes it.

    Args:
        index: for each level, the index of each cell's room.
        floors: for each level, z of the floors, NaN for none, shape (height, width) [m].
        occupied: for each level, a mask of the cells without a floor or with structure at an
            agent's height, see `LevelFlags.occupied`.
        links: links between cells, see `Floors`, shape (n, 4); those within a level are slopes,
            all others are ignored.
        max_step: the highest step [m].

    Returns:
        The openings, ordered by level and rooms.
    """
    openings = []
    for number, (rooms, floor, level_occupied) in enumerate(
        zip(index, floors, occupied, strict=True)
    ):
        on_level = (links[:, [0, 2]] == number).all(axis=1)
        neighbors = differing_pairs(rooms).T  # few: only their heights are compared
        rise = np.subtract(*floor.ravel()[neighbors.T])
        is_step = np.abs(rise) <= max_step + LIMIT_SLACK
        cells = np.concatenate([links[on_level][:, [1, 3]], neighbors[is_step]])
        rooms_of_cells = np.sort(rooms.ravel()[cells].astype(np.int64), axis=1)
        meet = (rooms_of_cells[:, 0] > 0) & (rooms_of_cells[:, 0] != rooms_of_cells[:, 1])
        if not meet.any():
            continue
        cells = cells[meet]
        pairs, pair = np.unique(rooms_of_cells[meet] @ (PAIR_BASE, 1), return_inverse=True)
        # Cells get a separate range of keys for each pair of rooms, so that pairs don't touch.
        lattice_size = (rooms.shape[0] + 1) * rooms.shape[1]
        keys, key_of_cell = np.unique(pair[:, None] * lattice_size + cells, return_inverse=True)
        opening_of = label_components(adjacent_pairs(keys, rooms.shape[1]), len(keys))
        is_free = ~level_occupied.ravel()[cells].any(axis=1)
        is_passable = np.zeros(int(opening_of.max()) + 1, dtype=np.bool_)
        is_passable[opening_of[key_of_cell.reshape(-1, 2)[is_free]]] = True
        order = np.argsort(opening_of, kind="stable")
        order = order[is_passable[opening_of[order]]]
        if not len(order):
            continue
        for opening_keys in np.split(keys[order], np.flatnonzero(np.diff(opening_of[order])) + 1):
            room_pair = divmod(int(pairs[opening_keys[0] // lattice_size]), PAIR_BASE)
            openings.append(Opening(number, room_pair, opening_keys % lattice_size))
    return openings


def match_doors(
    openings: Sequence[Opening],
    doors: Mapping[str, tuple[RoomIds, Sequence[Int]]],
    ids: Mapping[RoomKey, str],
    lattice: Lattice,
) -> dict[int, list[str]]:
    """Find the opening that each door is in.

    A door belongs to one of the openings between the two rooms that it joins: the opening with the
    most cells within `MAX_DOOR_DISTANCE` of the cells that the closed door blocks; on a tie, the
    nearest of them. If no opening has such a cell, the door belongs to none.

    Args:
        openings: the openings of all levels.
        doors: id of a door -> the ids of the rooms that it joins; and, for each level, the ids of
            the cells that it blocks when it is closed.
        ids: level and index of a room -> the room's id.
        lattice: the whole lattice.

    Returns:
        Index of an opening in `openings` -> the sorted ids of its doors; openings without doors are
        left out.
    """
    reach = MAX_DOOR_DISTANCE / lattice.cell_size + LIMIT_SLACK  # [cells]
    doors_of: dict[int, list[str]] = {}
    for door, (rooms, closed_cells) in sorted(doors.items()):
        scores: list[tuple[int, float, int]] = []  # near cells, distance, opening: best is greatest
        for number, opening in enumerate(openings):
            closed = closed_cells[opening.level]
            opening_rooms = {ids[opening.level, room] for room in opening.rooms}
            if len(closed) and opening_rooms == set(rooms):
                row, col = np.divmod(opening.cells[:, None], lattice.width)
                closed_row, closed_col = np.divmod(closed, lattice.width)
                distance = np.hypot(row - closed_row, col - closed_col).min(axis=1)
                num_near = int(np.count_nonzero(distance <= reach))
                scores.append((num_near, -float(distance.mean()), -number))
        if not scores:
            continue
        num_near, _, negative_number = max(scores)
        if num_near:
            doors_of.setdefault(-negative_number, []).append(door)
    return doors_of
