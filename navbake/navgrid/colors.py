"""The colours of pictures and meshes, as ``#rrggbb``, and the choice of a colour for each room.

Colour-blind people can tell them apart: `tests/navgrid/test_colors.py` measures this. Free cells
are light and blocked cells dark, so pictures can be read in grey, too.
"""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.grid import NavGrid
from navbake.types import Int

FREE = "#f7f3e8"
OCCUPIED = "#3b4252"
NO_FLOOR = "#b9c0cc"
CLOSED = "#938fbf"  # free as baked, closed by inflation
DOOR = "#c8440a"  # where a door blocks the way
DOORWAY = "#ff9f5a"  # where a door would block the way if it were closed
ROUTE = "#1864ab"
START = "#2f9e44"  # of a path or an episode
FREE_TINT = "#a9dfc4"  # free cells in a scene, where they must stand out from grey floors
TARGET = "#d24bff"  # what a base that stands somewhere reaches
STAND = "#0f875a"  # cells where a base can stand, and which way it faces there
# the first kind of mark in a picture has the first colour, and so on
MARKS = ("#d24bff", "#0f875a", "#a5a50f", "#780f96", "#f07896", "#4b4b00")

OUTDOORS = "#e9ffc6"
ROOMS = ("#a6ceb0", "#cec4f6", "#ecec88", "#60b09c", "#b092f6", "#c0f0f8")
# a room's occupied cells have the room's colour, mixed with this share of `OCCUPIED`
OCCUPIED_SHARE = 0.55
ROOM_LEGEND = "#6b6f78"  # in the legend: occupied cells of any room

MAX_NEIGHBOR_GAP = 0.6  # rooms are neighbours if the gap between them is no wider [m]

# colours of links, visible on walls as well
LINK_UP = "#3bcb11"
LINK_DOWN = "#b870fd"
LINK_ACROSS = "#889590"  # between cells of the same level
LINK = "#ff3d78"  # a lift, a drop, …
LINK_CLOSED = "#868e96"
STAIRS = "#495057"
KEEP_OUT = "#f05f7f"  # an area that bars every agent


def rgb_of(color: str) -> tuple[int, int, int]:
    """Convert a colour like ``#f7f3e8`` to red, green and blue, 0 to 255."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue


def to_linear(color: NDArray[Any]) -> NDArray[Any]:
    """Convert sRGB colours, 0 to 1, to linear light, 0 to 1 (IEC 61966-2-1)."""
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def darken_rooms(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Darken colours of rooms, for the rooms' occupied cells.

    Args:
        rgb: Red, green and blue of free cells, 0 to 255, shape (..., 3).

    Returns:
        The darker colours, of the same shape.
    """
    mixed_rgb = rgb * (1 - OCCUPIED_SHARE) + np.array(rgb_of(OCCUPIED)) * OCCUPIED_SHARE
    return np.round(mixed_rgb).astype(np.uint8)


def color_rooms(grid: NavGrid, level_number: int) -> NDArray[np.uint8]:
    """Choose colours for the rooms of a level.

    Rooms that share a wall or an opening have different colours, if possible. All outdoor areas
    have the colour `OUTDOORS`.

    Args:
        grid: The grid.
        level_number: Number of the level, 0 is the lowest.

    Returns:
        Red, green and blue for each index of a room, shape (n + 1, 3), uint8; index 0 is no room.
    """
    level = grid.levels[level_number]
    room_index = level.room_index
    num_rooms = int(room_index.max(initial=0))
    rooms = [room for room in grid.rooms if room.level == level_number and room.index <= num_rooms]
    index_by_id = {room.id: room.index for room in rooms}
    neighbour_pairs = find_neighbours(
        room_index, math.ceil(MAX_NEIGHBOR_GAP / level.lattice.cell_size)
    )
    for room in rooms:
        for neighbour in room.neighbours:
            neighbour_index = index_by_id.get(neighbour.room, room.index)
            if neighbour_index != room.index:
                neighbour_pairs.add((room.index, neighbour_index))
    outdoor_indices = {room.index for room in rooms if room.outdoors}
    neighbour_pairs = {pair for pair in neighbour_pairs if not outdoor_indices.intersection(pair)}
    palette = np.array([rgb_of(color) for color in ROOMS], dtype=np.uint8)
    colors = palette[choose_colors(num_rooms, neighbour_pairs, len(palette))]
    for outdoor_index in outdoor_indices:
        colors[outdoor_index] = rgb_of(OUTDOORS)
    return colors


def find_neighbours(part_of_cell: NDArray[Any], max_gap: int) -> set[tuple[int, int]]:
    """Find which parts of a plan, such as rooms, are neighbours.

    Two parts are neighbours if they touch in a row or column of cells, or if only a gap of cells of
    no part, such as a wall, lies between them there.

    Args:
        part_of_cell: Number of the part of each cell, from 1; 0 for no part. Shape (height, width),
            integers.
        max_gap: Largest width of a gap between neighbours [cells].

    Returns:
        Pairs of part numbers, the smaller number first.
    """
    pair_arrays = [np.empty((0, 2), dtype=np.int64)]
    for lines in (part_of_cell, part_of_cell.T):
        line_numbers, change_indices = np.nonzero(lines[:, 1:] != lines[:, :-1])
        parts_before = lines[line_numbers, change_indices]
        parts_after = lines[line_numbers, change_indices + 1]
        # a gap opens at one change and closes at the next change of the same line
        is_gap = (
            (line_numbers[1:] == line_numbers[:-1])
            & (parts_after[:-1] == 0)
            & (np.diff(change_indices) <= max_gap)
        )
        touching_pairs = np.stack([parts_before, parts_after], axis=1)
        pairs_across_gaps = np.stack([parts_before[:-1], parts_after[1:]], axis=1)[is_gap]
        pair_arrays += [touching_pairs, pairs_across_gaps]
    pairs = np.sort(np.concatenate(pair_arrays), axis=1)
    pairs = pairs[(pairs[:, 0] > 0) & (pairs[:, 0] < pairs[:, 1])]
    return set(map(tuple, np.unique(pairs, axis=0).tolist()))


def choose_colors(num_parts: int, pairs: Iterable[tuple[int, int]], num_colors: int) -> Int:
    """Choose colours for the parts of a plan so that neighbours differ, if possible.

    Greedy colouring (Welsh and Powell 1967): the part with most neighbours comes first. It gets a
    colour that as few of its neighbours as possible have; of several such colours, the one that is
    least used so far.

    Args:
        num_parts: Number of parts, which are numbered from 1.
        pairs: Pairs of the numbers of neighbours.
        num_colors: Number of colours.

    Returns:
        For each part the number of its colour, from 0; shape (num_parts + 1,), int64. Entry 0
        belongs to no part.
    """
    neighbours_by_part: list[set[int]] = [set() for _ in range(num_parts + 1)]
    for first_part, second_part in pairs:
        neighbours_by_part[first_part].add(second_part)
        neighbours_by_part[second_part].add(first_part)
    colors = np.full(num_parts + 1, -1, dtype=np.int64)
    num_uses = [0] * num_colors
    for part_number in sorted(
        range(1, num_parts + 1),
        key=lambda part_number: (-len(neighbours_by_part[part_number]), part_number),
    ):
        num_conflicts = [0] * num_colors
        for neighbour in neighbours_by_part[part_number]:
            if colors[neighbour] >= 0:
                num_conflicts[colors[neighbour]] += 1
        best_color = min(
            range(num_colors), key=lambda color: (num_conflicts[color], num_uses[color], color)
        )
        colors[part_number] = best_color
        num_uses[best_color] += 1
    colors[0] = 0
    return colors
