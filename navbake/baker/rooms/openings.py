"""Where rooms open to each other, and which of these openings have a door."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from navbake.baker.floors.levels import Floors
from navbake.baker.kernels.constants import SLACK
from navbake.navgrid.lattice import Lattice
from navbake.types import Float, Int

Index = NDArray[np.uint16]
RoomKey = tuple[int, int]
"""A room's level and index."""

# Where the two cells of each edge are in an array: left and right, upper and lower
EDGES = ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:]))

# A door is in an opening if they are at most this far apart [m]
DOOR_REACH = 0.4


@dataclass(frozen=True)
class Opening:
    """Where a step leads from one room to another on a level.

    Attributes:
        level: its number.
        rooms: the indices of the two rooms, the lower one first.
        cells: the cells on both sides, ids on the whole lattice, ascending, shape (n,), int64.
    """

    level: int
    rooms: tuple[int, int]
    cells: Int


def find_openings(index: Sequence[Index], floors: Floors, max_step: float) -> list[Opening]:
    """Find where neighbouring cells belong to two rooms and are no more than a step apart.

    8-connected cells form one opening. Furniture is ignored.

    Args:
        index: the room of each cell by level, shape (height, width), 0 for none.
        floors: the storeys.
        max_step: the highest step [m].
    """
    openings = []
    for number, (rooms, level) in enumerate(zip(index, floors.levels, strict=True)):
        low, high, cells = _find_steps(rooms, level.floor, max_step)
        key = low.astype(np.int64) << 16 | high
        order = np.argsort(key, kind="stable")
        bounds = np.flatnonzero(np.diff(key[order], prepend=-1, append=-1))
        for first, last in pairwise(bounds):
            group = order[first:last]
            pair = int(low[group[0]]), int(high[group[0]])
            members = np.unique(cells[group])
            openings += [
                Opening(number, pair, part) for part in _connected(members, rooms.shape[1])
            ]
    return openings


def find_room_links(index: Sequence[Index], floors: Floors) -> list[tuple[RoomKey, RoomKey]]:
    """Find the pairs of rooms on two levels between which a step leads, each once."""
    flat = [rooms.ravel() for rooms in index]
    pairs: set[tuple[RoomKey, RoomKey]] = set()
    for level_a, cell_a, level_b, cell_b in floors.links.tolist():
        a = level_a, int(flat[level_a][cell_a])
        b = level_b, int(flat[level_b][cell_b])
        if a[1] and b[1]:
            pairs.add((min(a, b), max(a, b)))
    return sorted(pairs)


def match_doors(
    openings: Sequence[Opening], doors: Mapping[str, Sequence[Int]], lattice: Lattice
) -> dict[int, list[str]]:
    """Find the opening that each door is in.

    That is the one of whose cells most are within 0.4 m of cells that the door blocks when it
    is closed; of two as good, the nearer. A door in no opening is left out; an opening may have
    several.

    Args:
        openings: all openings.
        doors: by a door's id, the cells it blocks by level, ids on the whole lattice.
        lattice: the cells.

    Returns:
        The sorted ids of each opening's doors, by its number.
    """
    reach = DOOR_REACH / lattice.cell_size + SLACK
    boxes = np.array([_box(opening.cells, lattice.width) for opening in openings]).reshape(-1, 4)
    on_level = np.array([opening.level for opening in openings], dtype=np.int64)
    found: dict[int, list[str]] = {}
    for door, levels in sorted(doors.items()):
        scores: list[tuple[int, float, int]] = []
        for level, cells in enumerate(levels):
            if not len(cells):
                continue
            row0, col0, row1, col1 = _box(cells, lattice.width)
            near = (on_level == level) & (boxes[:, 0] <= row1 + reach)
            near &= (boxes[:, 2] >= row0 - reach) & (boxes[:, 1] <= col1 + reach)
            near &= boxes[:, 3] >= col0 - reach
            for number in np.flatnonzero(near).tolist():
                distance = _distances(openings[number].cells, cells, lattice.width)
                within = int(np.count_nonzero(distance <= reach))
                scores.append((within, -float(distance.mean()), -number))
        if scores and max(scores)[0]:
            found.setdefault(-max(scores)[2], []).append(door)
    return found


def _box(cells: Int, width: int) -> tuple[int, int, int, int]:
    """First row and column, last row and column."""
    row, col = np.divmod(cells, width)
    return int(row.min()), int(col.min()), int(row.max()), int(col.max())


def _find_steps(rooms: Index, floor: Float, max_step: float) -> tuple[Index, Index, Int]:
    """The two rooms of neighbouring cells, the lower first, and both cells, shape (n, 2)."""
    cell = np.arange(rooms.size).reshape(rooms.shape)
    lows, highs, cells = [], [], []
    for one, other in EDGES:
        a, b = rooms[one], rooms[other]
        meet = (a != b) & (a > 0) & (b > 0)
        meet &= np.abs(floor[one] - floor[other]) <= max_step + SLACK
        lows.append(np.minimum(a, b)[meet])
        highs.append(np.maximum(a, b)[meet])
        cells.append(np.stack([cell[one][meet], cell[other][meet]], axis=1))
    return np.concatenate(lows), np.concatenate(highs), np.concatenate(cells)


def _connected(cells: Int, width: int) -> list[Int]:
    """Split ascending cell ids into connected parts."""
    row, col = np.divmod(cells, width)
    row, col = row - row.min(), col - col.min()
    mask = np.zeros((row.max() + 1, col.max() + 1), dtype=np.bool_)
    mask[row, col] = True
    part, count = ndimage.label(mask, structure=np.ones((3, 3)))
    number = part[row, col]
    return [cells[number == k] for k in range(1, count + 1)]


def _distances(cells: Int, targets: Int, width: int) -> Float:
    """How far each cell is from the nearest target [cells]."""
    row, col = np.divmod(cells, width)
    to_row, to_col = np.divmod(targets, width)
    nearest: Float = np.hypot(row[:, None] - to_row, col[:, None] - to_col).min(axis=1)
    return nearest
