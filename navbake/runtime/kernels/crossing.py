"""Walking over the cells of a walk in a straight line, edge by edge.

`place` is (start, width, height, x_min, y_max, cell_size) and `links` is (link_cell, link_start,
link_target), each as in `navbake.runtime.flat_grid.Walk`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

EDGE = 1e-6  # of a cell: how far inside of its edges a point is put


@njit(cache=True)
def level_of(cell, start):
    """The level of a flat id."""
    level = 0
    while cell >= start[level + 1]:
        level += 1
    return level


@njit(cache=True)
def center(place, cell):
    """World x, y of a cell's centre [m]."""
    start, width, _, x_min, y_max, size = place
    level = level_of(cell, start)
    row, col = divmod(cell - start[level], width[level])
    return x_min[level] + (col + 0.5) * size[level], y_max[level] - (row + 0.5) * size[level]


@njit(cache=True)
def put_into(place, cell, x, y):
    """The point of a cell's square that is the nearest to x, y; a little inside of its edges."""
    middle_x, middle_y = center(place, cell)
    half = (0.5 - EDGE) * place[5][level_of(cell, place[0])]
    x = min(max(x, middle_x - half), middle_x + half)
    y = min(max(y, middle_y - half), middle_y + half)
    return x, y


@njit(cache=True)
def cross(place, links, passable, floor, max_step, cell, down, across):
    """The cell over one edge of a cell.

    That is the neighbour on the same level, or the cell on another level that a link leads to at
    the same place. It must be passable; on the same level, floors may differ by `max_step`.

    Args:
        place, links: see the module.
        passable: by flat id, bool.
        floor: by flat id [m]; NaN differs from nothing.
        max_step: [m].
        cell: flat id.
        down, across: one of them 0, the other 1 or -1: by how many rows and columns.

    Returns:
        Flat id, -1 where nothing leads over the edge.
    """
    start, width, height, _, _, size = place
    level = level_of(cell, start)
    row, col = divmod(cell - start[level], width[level])
    if 0 <= row + down < height[level] and 0 <= col + across < width[level]:
        other = cell + down * width[level] + across
        if passable[other] and not abs(floor[cell] - floor[other]) > max_step:
            return other
    link_cell, link_start, link_target = links
    slot = np.searchsorted(link_cell, cell)
    if slot == len(link_cell) or link_cell[slot] != cell:
        return np.int64(-1)
    x, y = center(place, cell)
    x, y, near = x + across * size[level], y - down * size[level], 0.25 * size[level]
    for i in range(link_start[slot], link_start[slot + 1]):
        other = link_target[i]
        if passable[other]:
            other_x, other_y = center(place, other)
            if abs(other_x - x) < near and abs(other_y - y) < near:
                return other
    return np.int64(-1)


@njit(cache=True)
def walk_line(place, links, passable, floor, max_step, room, cell, x0, y0, x1, y1):
    """Walk from a point straight to another, as far as cells let one pass.

    Through a corner of four cells, one of the two beside the line has to be passable.

    Args:
        place, links, passable, floor, max_step: see `cross`.
        room: by flat id, or empty. If not empty, the line may start in cells that are not
            passable, and go on in them as long as they are of the first one's room, until it
            comes out of them.
        cell: flat id of the cell that holds x0, y0.
        x0, y0, x1, y1: the two points, world [m].

    Returns:
        Flat id of the last cell, and the share of the way walked: 1 for all of it.
    """
    start, width, _, x_min, y_max, size = place
    dx, dy = x1 - x0, y1 - y0
    across, down = 1 if dx > 0 else -1, 1 if dy < 0 else -1
    home, leaving = cell, len(room) > 0 and not passable[cell]
    share = 0.0
    while True:
        level = level_of(cell, start)
        row, col = divmod(cell - start[level], width[level])
        edge_x = x_min[level] + (col + (dx > 0)) * size[level]
        edge_y = y_max[level] - (row + (dy < 0)) * size[level]
        to_x = (edge_x - x0) / dx if dx != 0.0 else np.inf
        to_y = (edge_y - y0) / dy if dy != 0.0 else np.inf
        share = max(share, min(to_x, to_y))
        if share >= 1.0:
            return cell, 1.0
        following = np.int64(-1)
        for turn in range(2):
            over_x = (to_x <= to_y) == (turn == 0)
            if following >= 0 or (turn == 1 and to_x != to_y):
                break
            step_down, step_across = (0, across) if over_x else (down, 0)
            following = cross(place, links, passable, floor, max_step, cell, step_down, step_across)
            if following < 0 and leaving:
                following = _stay(place, room, home, cell, step_down, step_across)
        if following < 0:
            return cell, share
        cell = following
        leaving = leaving and not passable[cell]


@njit(cache=True)
def _stay(place, room, home, cell, down, across):
    """The neighbour on the same level, if it is of a cell's room; else -1."""
    start, width, height, _, _, _ = place
    level = level_of(cell, start)
    row, col = divmod(cell - start[level], width[level])
    if 0 <= row + down < height[level] and 0 <= col + across < width[level]:
        other = cell + down * width[level] + across
        if room[other] == room[home]:
            return other
    return np.int64(-1)


@njit(cache=True)
def is_in_sight(place, links, clear, floor, room, cell, x0, y0, target, x1, y1):
    """Whether a straight line between points in two cells meets clear cells only.

    Heights don't count. Where `room` is not empty, the line may start in something; see
    `walk_line`.
    """
    x0, y0 = put_into(place, cell, x0, y0)
    x1, y1 = put_into(place, target, x1, y1)
    last, _ = walk_line(place, links, clear, floor, np.inf, room, cell, x0, y0, x1, y1)
    return last == target and clear[target] and (len(room) > 0 or clear[cell])
