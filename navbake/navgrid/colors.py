"""The colours of pictures and meshes, as ``#rrggbb``, and of each room.

They are safe for colour-blind people, as `tests/navgrid/test_colors.py` measures. Free cells are
light and blocked ones dark, so that pictures work in grey, too.
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
DOOR = "#c8440a"  # where a door blocks the way
DOORWAY = "#ff9f5a"  # where a closed door would
ROUTE = "#1864ab"
MARKS = ("#d24bff", "#0f875a", "#a5a50f", "#780f96", "#f07896", "#4b4b00")  # by kind

OUTDOORS = "#e9ffc6"
ROOMS = ("#a6ceb0", "#cec4f6", "#ecec88", "#60b09c", "#b092f6", "#c0f0f8")
BLOCKED_SHARE = 0.55  # of `OCCUPIED` in the colour of a room's occupied cells
DARKER = "#6b6f78"  # stands in the legend for all rooms' darker colours

WALL = 0.6  # rooms with no more than this between them are neighbours [m]

# of links; visible on walls, too
UP = "#3bcb11"
DOWN = "#b870fd"
ACROSS = "#889590"
LINK = "#ff3d78"  # a lift, a drop, …
KEEP_OUT = "#f05f7f"  # an area that bars every agent


def rgb_of(color: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of a colour like ``#f7f3e8``."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue


def to_linear(color: NDArray[Any]) -> NDArray[Any]:
    """Linear light of colours as screens take them, 0 to 1 (sRGB, IEC 61966-2-1)."""
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def darken_rooms(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The colours of rooms, shape (…, 3), for occupied cells."""
    mixed = rgb * (1 - BLOCKED_SHARE) + np.array(rgb_of(OCCUPIED)) * BLOCKED_SHARE
    return np.round(mixed).astype(np.uint8)


def color_rooms(grid: NavGrid, number: int) -> NDArray[np.uint8]:
    """Colours of a level's rooms by index, shape (n + 1, 3), uint8; 0 is no room.

    Rooms that share a wall or an opening have different colours.
    """
    level = grid.levels[number]
    index = level.room_index
    count = int(index.max(initial=0))
    rooms = [r for r in grid.rooms if r.level == number and r.index <= count]
    index_of = {room.id: room.index for room in rooms}
    pairs = find_neighbours(index, math.ceil(WALL / level.lattice.cell_size))
    for room in rooms:
        others = [index_of.get(neighbour.room, room.index) for neighbour in room.neighbours]
        pairs.update((room.index, other) for other in others if other != room.index)
    outdoors = {room.index for room in rooms if room.outdoors}
    pairs = {pair for pair in pairs if not outdoors.intersection(pair)}
    palette = np.array([rgb_of(color) for color in ROOMS], dtype=np.uint8)
    colors = palette[choose_colors(count, pairs, len(palette))]
    for room_index in outdoors:
        colors[room_index] = rgb_of(OUTDOORS)
    return colors


def find_neighbours(index: NDArray[Any], reach: int) -> set[tuple[int, int]]:
    """Find pairs of regions, smaller number first, that are close along a row or a column.

    `index` has the region of each cell from 1, 0 for none, shape (height, width), integers; at most
    `reach` cells of no region, such as a wall's, may be in between.
    """
    found = [np.empty((0, 2), dtype=np.int64)]
    for lines in (index, index.T):
        line, place = np.nonzero(lines[:, 1:] != lines[:, :-1])
        before = lines[line, place]
        after = lines[line, place + 1]
        # a gap opens at one change and closes at the next one of the same line
        gap = (line[1:] == line[:-1]) & (after[:-1] == 0) & (np.diff(place) <= reach)
        found += [
            np.stack([before, after], axis=1),
            np.stack([before[:-1], after[1:]], axis=1)[gap],
        ]
    pairs = np.sort(np.concatenate(found), axis=1)
    pairs = pairs[(pairs[:, 0] > 0) & (pairs[:, 0] < pairs[:, 1])]
    return set(map(tuple, np.unique(pairs, axis=0).tolist()))


def choose_colors(count: int, pairs: Iterable[tuple[int, int]], num_colors: int) -> Int:
    """Choose a colour for each region that none of its neighbours has, while there are enough.

    Greedy colouring (Welsh and Powell 1967): the region with most neighbours chooses first. Of the
    colours that fewest of its neighbours have, it takes the one that is least used so far. Regions
    are numbered from 1, colours from 0; the result, shape (count + 1,), has no meaning for 0.
    """
    near: list[set[int]] = [set() for _ in range(count + 1)]
    for one, other in pairs:
        near[one].add(other)
        near[other].add(one)
    chosen = np.full(count + 1, -1, dtype=np.int64)
    used = [0] * num_colors
    for region in sorted(range(1, count + 1), key=lambda region: (-len(near[region]), region)):
        beside = [0] * num_colors
        for other in near[region]:
            if chosen[other] >= 0:
                beside[chosen[other]] += 1
        best = min(range(num_colors), key=lambda color: (beside[color], used[color], color))
        chosen[region] = best
        used[best] += 1
    chosen[0] = 0
    return chosen
