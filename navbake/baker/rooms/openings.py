"""Where rooms open to each other, and which of these openings have a door."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.connect import connect, touching
from navbake.baker.kernels.constants import SLACK
from navbake.baker.lattice import list_differing
from navbake.navgrid.lattice import Lattice
from navbake.types import Float, Int

RoomIndex = NDArray[np.uint16]
"""The room of each cell of a level, shape (height, width) of the whole lattice, 0 for none."""
RoomKey = tuple[int, int]
"""A room's level and index."""

# Two indices of rooms make one number, to sort by: the first times this, and the second
PAIR = 1 << 16
# A door is in an opening if they are at most this far apart [m]
DOOR_REACH = 0.4


@dataclass(frozen=True)
class Opening:
    """Where a step leads from one room to another, the lower index first, on a level.

    `cells` are those on both sides, ids on the whole lattice, ascending, shape (n,), int64.
    """

    level: int
    rooms: tuple[int, int]
    cells: Int


class ClosedDoor(NamedTuple):
    """A closed door: the rooms that it joins, and the cells that it blocks on each level.

    `rooms` are two, or fewer for a door that leads out of all of them, or joins none.
    """

    rooms: frozenset[RoomKey]
    cells: Sequence[Int]


def find_openings(
    index: Sequence[RoomIndex], floors: Sequence[Float], links: Int, max_step: float
) -> list[Opening]:
    """Find where neighbouring cells belong to two rooms and are a step or a slope apart.

    Floors are heights by level, steps at most `max_step` high [m]; a slope is a link between two
    cells of one level. 8-connected cells form one opening. Furniture is ignored.
    """
    openings = []
    for number, (rooms, floor) in enumerate(zip(index, floors, strict=True)):
        on_level = (links[:, [0, 2]] == number).all(axis=1)
        joined, height = [links[on_level][:, [1, 3]]], floor.ravel()
        for one, other in list_differing(rooms):  # few: only their heights are compared
            is_step = np.abs(height[one] - height[other]) <= max_step + SLACK
            joined.append(np.stack([one[is_step], other[is_step]], axis=1))
        cells = np.concatenate(joined)
        ends = np.sort(rooms.ravel()[cells].astype(np.int64), axis=1)
        meet = (ends[:, 0] > 0) & (ends[:, 0] != ends[:, 1])
        key = ends[meet] @ (PAIR, 1)
        order = np.argsort(key, kind="stable")
        pairs, first = np.unique(key[order], return_index=True)
        of_pairs = np.split(cells[meet][order], first[1:])
        for pair, both in zip(pairs.tolist(), map(np.unique, of_pairs), strict=False):
            part = connect(touching(both, rooms.shape[1]), len(both))
            for k in range(int(part.max()) + 1):
                openings.append(Opening(number, divmod(pair, PAIR), both[part == k]))
    return openings


def find_room_links(index: Sequence[RoomIndex], links: Int) -> list[tuple[RoomKey, RoomKey]]:
    """Find the pairs of rooms on two levels between which a step leads, each once."""
    flat = [rooms.ravel() for rooms in index]
    pairs: set[tuple[RoomKey, RoomKey]] = set()
    for level_a, cell_a, level_b, cell_b in links.tolist():
        a = level_a, int(flat[level_a][cell_a])
        b = level_b, int(flat[level_b][cell_b])
        if a[1] and b[1] and level_a != level_b:
            pairs.add((min(a, b), max(a, b)))
    return sorted(pairs)


def match_doors(
    openings: Sequence[Opening], doors: Mapping[str, ClosedDoor], lattice: Lattice
) -> dict[int, list[str]]:
    """Find the opening that each door is in; `doors` are by id.

    That is, of the openings between the two rooms that the door joins, the one of whose cells most
    are within 0.4 m of cells that the closed door blocks; of two as good, the nearer. A door in no
    opening is left out; an opening may have several. The result has the sorted ids of each
    opening's doors, by its number.
    """
    if not doors:
        return {}
    reach = DOOR_REACH / lattice.cell_size + SLACK
    boxes = np.array([_box(opening.cells, lattice.width) for opening in openings])
    firsts, lasts = np.moveaxis(boxes.reshape(-1, 2, 2), 1, 0)
    on_level = np.array([opening.level for opening in openings], dtype=np.int64)
    found: dict[int, list[str]] = {}
    for door, (rooms, levels) in sorted(doors.items()):
        scores: list[tuple[int, float, int]] = []
        for level, cells in enumerate(levels):
            if not len(cells):
                continue
            first, last = _box(cells, lattice.width)
            # boxes are compared first, because distances between all cells take long
            near = ((firsts <= last + reach) & (lasts >= first - reach)).all(axis=1)
            for number in np.flatnonzero(near & (on_level == level)).tolist():
                if {(level, room) for room in openings[number].rooms} != rooms:
                    continue
                distance = _distances(openings[number].cells, cells, lattice.width)
                within = int(np.count_nonzero(distance <= reach))
                scores.append((within, -float(distance.mean()), -number))
        if scores and max(scores)[0]:
            found.setdefault(-max(scores)[2], []).append(door)
    return found


def _box(cells: Int, width: int) -> Int:
    """First row and column, last row and column, shape (2, 2)."""
    places = np.divmod(cells, width)
    return np.array([np.min(places, axis=1), np.max(places, axis=1)])


def _distances(cells: Int, targets: Int, width: int) -> Float:
    """How far each cell is from the nearest target, shape (n,) [cells]."""
    row, col = np.divmod(cells, width)
    to_row, to_col = np.divmod(targets, width)
    nearest: Float = np.hypot(row[:, None] - to_row, col[:, None] - to_col).min(axis=1)
    return nearest
