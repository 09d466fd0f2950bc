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
    find_row_runs,
    label_components,
    list_adjacent_pairs,
)
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.windows import list_differing_pairs
from navbake.baker.rooms.flags import LevelFlags, MarkedRooms, RoomFlags
from navbake.baker.rooms.gaps import CloseCall
from navbake.baker.rooms.leaves import ClosedLeaf, LeafMarks, mark_leaves
from navbake.baker.rooms.outdoors import find_room_segments
from navbake.baker.rooms.segmentation import (
    assign_covered,
    assign_leaf_cells,
    assign_unmarked,
    label_undivided_floors,
    number_in_order,
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
# The key of a pair of rooms is the first room's index times this, plus the second room's index
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
    """The rooms of a scene, and the openings and steps that connect them.

    Attributes:
        index: for each level, the index of each cell's room, shape (height, width).
        table: the rooms, ordered by level and index; `with_neighbours` adds their neighbours.
        openings: the openings between rooms of a level.
        room_pairs_across_levels: pairs of rooms on different levels between which an agent can
            step.
        lattice: the whole lattice.
        is_open_by_level: for each level, a mask of the cells that may be in a room, shape (height,
            width), see `LevelFlags.is_open`.
        warnings: warnings for the user, one line each.
    """

    index: list[RoomIndex]
    table: list[Room]
    openings: list[Opening]
    room_pairs_across_levels: list[tuple[RoomKey, RoomKey]]
    lattice: Lattice
    is_open_by_level: list[Bool]
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
        doors_of_opening = match_doors(self.openings, doors, self._ids, self.lattice)
        # Sets of (room, kind, door), see `Neighbour`; "" for no door, because None doesn't sort
        neighbours: dict[RoomKey, set[tuple[RoomKey, str, str]]] = {
            room: set() for room in self._ids
        }
        for first_room, second_room in self.room_pairs_across_levels:
            neighbours[first_room].add((second_room, "link", ""))
            neighbours[second_room].add((first_room, "link", ""))
        for opening_number, opening in enumerate(self.openings):
            first_room = (opening.level, opening.rooms[0])
            second_room = (opening.level, opening.rooms[1])
            for door in doors_of_opening.get(opening_number, [""]):
                kind = "door" if door else "open"
                neighbours[first_room].add((second_room, kind, door))
                neighbours[second_room].add((first_room, kind, door))
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


class RoomDescription(NamedTuple):
    """The facts of a room without its cells: its name, where it comes from, whether it is outdoors.

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
    decides. The source ``auto`` divides the cells that no other source has a room for, see
    `assign_unmarked`. Cells without a floor, or in a wall or a window, belong to no room. On each
    level, rooms are numbered by their first cells in reading order: from large y to small, from
    small x to large. A room that a geom, site or polygon marks on several levels is a separate room
    on each of them.

    A closed door leaf that parts the floor separates rooms of the source ``auto``: they meet in the
    leaf's cells. The floor behind such a leaf is a room whatever its size.

    Args:
        flags: the flags of the cells of all levels, and the rooms that the scene marks.
        settings: sources and limits.
        max_step: the agent's highest step [m]; where floors of two rooms differ by more, there is
            no opening between them.
        closed_leaves: all door leaves of the scene, in their closed state.

    Returns:
        The rooms, without neighbours in their table.

    Raises:
        SceneError: there are more rooms on a level than a file can number.
    """
    room_assignment = _RoomAssignment(flags, settings, closed_leaves)
    for source in settings.sources:
        if source == "auto":
            room_assignment.add_segments()
        else:
            room_assignment.add_source(flags.marked_rooms[source], source)
    room_index = list[RoomIndex]()
    room_descriptions = list[list[RoomDescription]]()
    for level_number, room_of_cell in enumerate(room_assignment.room_numbers):
        runs = find_row_runs(room_of_cell)
        room_of_run, used_rooms = number_in_order(runs.value)
        if len(used_rooms) > MAX_ROOMS:
            raise SceneError(
                f"expected at most {MAX_ROOMS} rooms on a level, got {len(used_rooms)} on level "
                f"{level_number}: raise `rooms.min_area`"
            )
        room_index.append(runs.paint(room_of_run.astype(np.uint16), room_of_cell.shape))
        room_descriptions.append([room_assignment.rooms[room - 1] for room in used_rooms])
    floors = [level.floor for level in flags.levels]
    occupied_masks = [level.is_occupied for level in flags.levels]
    wait_for_table = run_beside(
        make_room_table, room_index, room_descriptions, floors, flags.lattice
    )
    openings = find_openings(room_index, floors, occupied_masks, flags.steps, max_step)
    room_pairs_across_levels = _find_room_pairs_across_levels(room_index, flags.steps)
    return Rooms(
        index=room_index,
        table=wait_for_table(),
        openings=openings,
        room_pairs_across_levels=room_pairs_across_levels,
        lattice=flags.lattice,
        is_open_by_level=[level.is_open for level in flags.levels],
        warnings=room_assignment.warnings,
    )


def _find_room_pairs_across_levels(
    room_index: Sequence[RoomIndex], steps: Int
) -> list[tuple[RoomKey, RoomKey]]:
    """Return the pairs of rooms on different levels that a step joins, each pair once, sorted.

    Args:
        room_index: for each level, the index of each cell's room.
        steps: pairs of cells that a step or a slope joins, see `Floors.steps`, shape (n, 4).
    """
    room_pairs = set[tuple[RoomKey, RoomKey]]()
    steps_between_levels = steps[steps[:, 0] != steps[:, 2]]
    for first_level, first_cell, second_level, second_cell in steps_between_levels.tolist():
        first_room = (first_level, int(room_index[first_level].flat[first_cell]))
        second_room = (second_level, int(room_index[second_level].flat[second_cell]))
        if first_room[1] and second_room[1]:
            room_pairs.add((min(first_room, second_room), max(first_room, second_room)))
    return sorted(room_pairs)


class _RoomAssignment:
    """Assigns cells to rooms, source by source; the first source with a room for a cell decides.

    Attributes:
        room_numbers: for each level, the number of each cell's room, shape (height, width); 0 for
            none, room number k + 1 is ``rooms[k]``.
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
        self.room_numbers = [np.zeros(shape, dtype=np.int32) for _ in flags.levels]
        # For cells without a room: the room whose floor is under the cell's own floor
        self._room_under = [np.zeros(shape, dtype=np.int32) for _ in flags.levels]
        self.rooms: list[RoomDescription] = []
        self.warnings: list[str] = []

    def add_source(self, marked_rooms: MarkedRooms, source: str) -> None:
        """Add the rooms that a source finds. A room gets those of its cells that have no room yet.

        Args:
            marked_rooms: the rooms that the source finds.
            source: the name of the source, see `RoomDescription.source`.
        """
        self.warnings += marked_rooms.warnings
        if not marked_rooms.names:
            return
        for level_number, flags in enumerate(self._flags.levels):
            room_number = self.room_numbers[level_number]
            may_be_assigned = room_number == 0
            may_be_assigned &= flags.is_open
            runs = find_row_runs(marked_rooms.labels[level_number] * may_be_assigned)
            new_room_number = np.zeros(len(marked_rooms.names) + 1, dtype=np.int32)  # by label
            num_cells = runs.count_cells(runs.value, len(new_room_number))
            for room_index in np.flatnonzero(num_cells[1:]).tolist():
                self.rooms.append(
                    RoomDescription(
                        marked_rooms.names[room_index],
                        source,
                        room_index + 1 in marked_rooms.outdoor_rooms,
                    )
                )
                new_room_number[room_index + 1] = len(self.rooms)
            room_number += runs.paint(new_room_number[runs.value], room_number.shape)
            if source != "auto":
                covered_labels = marked_rooms.covered_labels or marked_rooms.labels
                room_under = self._room_under[level_number]
                np.copyto(
                    room_under, new_room_number[covered_labels[level_number]], where=room_under == 0
                )

    def add_segments(self) -> None:
        """Divide the cells that have no room yet into rooms: the source ``auto``.

        The floor is divided at narrow places, such as doorways, see `segment_by_gaps`.
        """
        segments = list[Int32]()
        cells_beyond = list[Int]()
        separating_masks: list[Bool | None] = []
        undivided_floors = label_undivided_floors(
            self._flags.levels, self._flags.lattice.cell_size, self._settings.min_area
        )
        for level_number, level in enumerate(self._flags.levels):
            leaf_marks = mark_leaves(
                level, level_number, self._closed_leaves, self._flags.lattice.cell_size
            )
            segment = undivided_floors[level_number]
            if segment is None or leaf_marks is not None:
                segment = self._divide_at_gaps(level_number, level, leaf_marks)
            if self.room_numbers[level_number].any():
                segment = self._divide_segments(level_number, segment, leaf_marks)
            segments.append(segment)
            if leaf_marks is None:
                cells_beyond.append(np.empty(0, dtype=np.int64))
                separating_masks.append(None)
            else:
                cells_beyond.append(leaf_marks.cells_beyond)
                separating_masks.append(leaf_marks.is_separating & level.is_open)
        labels, outdoor_rooms = find_room_segments(
            segments, self.room_numbers, self._flags, cells_beyond
        )
        num_new_rooms = max(int(label.max(initial=0)) for label in labels)
        self.add_source(
            MarkedRooms([None] * num_new_rooms, labels, outdoor_rooms=outdoor_rooms), "auto"
        )
        for room_number, leaf_cells in zip(self.room_numbers, separating_masks, strict=True):
            if leaf_cells is not None:
                assign_leaf_cells(room_number, leaf_cells)

    def _divide_at_gaps(
        self, level_number: int, level: LevelFlags, leaf_marks: LeafMarks | None
    ) -> Int32:
        """Divide the floor of a level at gaps, and warn of gaps that were a close call.

        Args:
            level_number: the number of the level.
            level: the flags of the level's cells.
            leaf_marks: the cells of the level's closed door leaves; None if there are none.

        Returns:
            The number of each cell's segment, from 1, 0 for none, shape (height, width).
        """
        lattice = self._flags.lattice
        door_width = self._settings.door_width
        segment, close_calls = segment_by_gaps(
            level,
            lattice.cell_size,
            self._settings.min_area,
            None if door_width == "auto" else door_width,
            walls=self._flags.wall_shapes,
            lattice=lattice,
            leaf_marks=leaf_marks,
        )
        if close_calls and door_width == "auto":
            self.warnings.append(_describe_close_calls(close_calls, level_number, lattice))
        return segment

    def _divide_segments(
        self, level_number: int, segment: Int32, leaf_marks: LeafMarks | None
    ) -> Int32:
        """Divide the cells of a level between marked rooms and new rooms; changes `room_number`.

        Args:
            level_number: the number of the level.
            segment: the part of the floor, between narrow places, that each cell belongs to, from
                1, 0 for none; see `segment_by_gaps`.
            leaf_marks: the cells of the level's closed door leaves; None if there are none.

        Returns:
            The number of each cell's new room, from 1, 0 for none, shape (height, width).
        """
        level = self._flags.levels[level_number]
        marked_room_number = self.room_numbers[level_number]
        room_number = (
            marked_room_number
            if leaf_marks is None
            else np.where(leaf_marks.is_separating, np.int32(0), marked_room_number)
        )
        room_number = assign_covered(
            room_number, self._room_under[level_number] * level.is_open, segment
        )
        room_number, new_room_number = assign_unmarked(
            room_number,
            segment,
            self._flags.lattice.cell_size,
            self._settings.min_area,
            None if leaf_marks is None else leaf_marks.cells_beyond,
        )
        self.room_numbers[level_number] = np.where(
            marked_room_number > 0, marked_room_number, room_number
        )
        return new_room_number


def _describe_close_calls(close_calls: Sequence[CloseCall], level: int, lattice: Lattice) -> str:
    """Make the warning that lists the openings that nearly joined, or nearly parted, two rooms."""
    descriptions = []
    for row_col, width, separates in close_calls[:MAX_LISTED_CLOSE_CALLS]:
        x, y = lattice.positions(*row_col).tolist()
        descriptions.append(
            f"{width:.1f} m at ({x:.1f}, {y:.1f}) {'parts' if separates else 'joins'}"
        )
    num_more = len(close_calls) - MAX_LISTED_CLOSE_CALLS
    more_text = f", and {num_more} more" if num_more > 0 else ""
    return (
        f"openings of rooms on level {level} that were a close call: "
        f"{', '.join(descriptions)}{more_text}; "
        "`rooms.door_width` in metres joins rooms at wider ones, `rooms.polygons` draws rooms"
    )


def make_room_table(
    room_index: Sequence[RoomIndex],
    room_descriptions: Sequence[Sequence[RoomDescription]],
    floors: Sequence[Float],
    lattice: Lattice,
) -> list[Room]:
    """Make the table of rooms, without neighbours.

    A room's id is its name if no other room has that name, else ``<level>:<index>``.

    Args:
        room_index: for each level, the index of each cell's room.
        room_descriptions: for each level, its rooms, in the order of indices.
        floors: for each level, z of the floors, shape (height, width) [m].
        lattice: the whole lattice.
    """
    name_counts = Counter(room.name for level_rooms in room_descriptions for room in level_rooms)
    table = []
    for level_number, (room_of_cell, floor) in enumerate(zip(room_index, floors, strict=True)):
        runs = find_row_runs(room_of_cell)
        run_lengths = runs.end_col - runs.first_col
        heights_in_micrometres = floor[room_of_cell > 0]
        heights_in_micrometres *= MICROMETRES
        np.rint(heights_in_micrometres, out=heights_in_micrometres)
        height_sums = np.add.reduceat(heights_in_micrometres, np.cumsum(run_lengths) - run_lengths)
        # Sums of whole numbers don't depend on their order. The mean column of a run of cells may
        # end in .5, so twice its sum is used.
        num_cells = np.bincount(runs.value, run_lengths, minlength=1)
        row_sum = np.bincount(runs.value, runs.row * run_lengths, minlength=1)
        twice_col_sum = np.bincount(
            runs.value, (runs.first_col + runs.end_col - 1) * run_lengths, minlength=1
        )
        z_sum = np.bincount(runs.value, height_sums, minlength=1)
        x = lattice.x_min + (twice_col_sum / 2 / np.maximum(num_cells, 1) + 0.5) * lattice.cell_size
        y = lattice.y_max - (row_sum / np.maximum(num_cells, 1) + 0.5) * lattice.cell_size
        z = z_sum / np.maximum(num_cells, 1) / MICROMETRES
        centroids = (np.round(np.stack([x, y, z], axis=1), 6) + 0.0).tolist()  # no -0.0
        for index_on_level, (name, source, outdoors) in enumerate(
            room_descriptions[level_number], 1
        ):
            room_id = f"{level_number}:{index_on_level}"
            # a name is an id if no other room has it, as a name or as a numbered id
            if name is not None and name_counts[name] == 1 and not ID_LIKE.fullmatch(name):
                room_id = name
            table.append(
                Room(
                    index=index_on_level,
                    id=room_id,
                    name=name,
                    level=level_number,
                    area=round(float(num_cells[index_on_level]) * lattice.cell_size**2, 6),
                    centroid=(*centroids[index_on_level],),
                    source=source,
                    outdoors=outdoors,
                )
            )
    return table


def find_openings(
    room_index: Sequence[RoomIndex],
    floors: Sequence[Float],
    occupied_masks: Sequence[Bool],
    steps: Int,
    max_step: float,
) -> list[Opening]:
    """Find the openings between rooms: places where an agent can walk from one room to another.

    Two neighbouring cells of different rooms are part of an opening if their floors differ by at
    most a step, or if a slope joins them. Such cells of the same two rooms that touch, also at
    corners, form one opening. An opening in which no two neighbouring cells are both unoccupied is
    left out: a curtain or a piece of wall closes it.

    Args:
        room_index: for each level, the index of each cell's room.
        floors: for each level, z of the floors, NaN for none, shape (height, width) [m].
        occupied_masks: for each level, a mask of the cells without a floor or with structure at an
            agent's height, see `LevelFlags.is_occupied`.
        steps: pairs of cells that a step between levels, or only a slope, joins, see
            `Floors.steps`, shape (n, 4). Only the slopes are used, which join cells of one level.
        max_step: the highest step [m].

    Returns:
        The openings, ordered by level and rooms.
    """
    openings = []
    for level_number, (room_of_cell, floor, is_occupied) in enumerate(
        zip(room_index, floors, occupied_masks, strict=True)
    ):
        is_step_on_level = (steps[:, [0, 2]] == level_number).all(axis=1)
        neighbor_pairs = list_differing_pairs(room_of_cell)
        are_in_rooms = (room_of_cell.ravel()[neighbor_pairs] > 0).all(axis=0)
        neighbor_pairs = neighbor_pairs[:, are_in_rooms]
        height_difference = np.subtract(*floor.ravel()[neighbor_pairs])
        is_step = np.abs(height_difference) <= max_step + LIMIT_SLACK
        cell_pairs = np.concatenate(
            [steps[is_step_on_level][:, [1, 3]], neighbor_pairs[:, is_step].T]
        )
        rooms_of_cells = np.sort(room_of_cell.ravel()[cell_pairs].astype(np.int64), axis=1)
        is_between_rooms = (rooms_of_cells[:, 0] > 0) & (
            rooms_of_cells[:, 0] != rooms_of_cells[:, 1]
        )
        if not is_between_rooms.any():
            continue
        cell_pairs = cell_pairs[is_between_rooms]
        pair_keys, pair_of_cells = np.unique(
            rooms_of_cells[is_between_rooms] @ (PAIR_BASE, 1), return_inverse=True
        )
        # Cells get a separate range of keys for each pair of rooms, so that pairs don't touch.
        lattice_size = (room_of_cell.shape[0] + 1) * room_of_cell.shape[1]
        cell_keys, key_index = np.unique(
            pair_of_cells[:, None] * lattice_size + cell_pairs, return_inverse=True
        )
        opening_of_key = label_components(
            list_adjacent_pairs(cell_keys, room_of_cell.shape[1]), len(cell_keys)
        )
        is_free = ~is_occupied.ravel()[cell_pairs].any(axis=1)
        is_passable = np.zeros(int(opening_of_key.max()) + 1, dtype=np.bool_)
        is_passable[opening_of_key[key_index.reshape(-1, 2)[is_free]]] = True
        sort_indices = np.argsort(opening_of_key, kind="stable")
        sort_indices = sort_indices[is_passable[opening_of_key[sort_indices]]]
        if not len(sort_indices):
            continue
        for opening_keys in np.split(
            cell_keys[sort_indices], np.flatnonzero(np.diff(opening_of_key[sort_indices])) + 1
        ):
            room_pair = divmod(int(pair_keys[opening_keys[0] // lattice_size]), PAIR_BASE)
            openings.append(Opening(level_number, room_pair, opening_keys % lattice_size))
    return openings


def match_doors(
    openings: Sequence[Opening],
    doors: Mapping[str, tuple[RoomIds, Sequence[Int]]],
    id_of_room: Mapping[RoomKey, str],
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
        id_of_room: level and index of a room -> the room's id.
        lattice: the whole lattice.

    Returns:
        Index of an opening in `openings` -> the sorted ids of its doors; openings without doors are
        left out.
    """
    max_distance = MAX_DOOR_DISTANCE / lattice.cell_size + LIMIT_SLACK  # [cells]
    doors_of_opening: dict[int, list[str]] = {}
    for door, (joined_rooms, closed_cells) in sorted(doors.items()):
        # number of near cells, negative distance, negative number of the opening: best is greatest
        opening_candidates: list[tuple[int, float, int]] = []
        for opening_number, opening in enumerate(openings):
            cells_of_door = closed_cells[opening.level]
            opening_rooms = {id_of_room[opening.level, room] for room in opening.rooms}
            if len(cells_of_door) and opening_rooms == set(joined_rooms):
                row, col = np.divmod(opening.cells[:, None], lattice.width)
                closed_row, closed_col = np.divmod(cells_of_door, lattice.width)
                distance = np.hypot(row - closed_row, col - closed_col).min(axis=1)
                num_near_cells = int(np.count_nonzero(distance <= max_distance))
                opening_candidates.append(
                    (num_near_cells, -float(distance.mean()), -opening_number)
                )
        if not opening_candidates:
            continue
        num_near_cells, _, negative_opening_number = max(opening_candidates)
        if num_near_cells:
            doors_of_opening.setdefault(-negative_opening_number, []).append(door)
    return doors_of_opening
