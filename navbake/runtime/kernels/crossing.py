"""Traverses cells along a straight line, edge by edge, from level to level where links lead.

The line goes from cell to cell as in Amanatides and Woo, "A Fast Voxel Traversal Algorithm for
Ray Tracing" (1987): of the cell's next vertical and next horizontal edge, the one that the line
meets first is crossed. Unlike there, each crossing is computed from the cell's own edge,
not summed up, because a link may lead to a level whose cells lie elsewhere.
"""

import numpy as np

from navbake.compiled import kernel, part
from navbake.runtime.kernels.arrays import center, find_slot, level_of, put_into


@part
def cross(layout, links, passable, floor, max_step, cell, down, across):
    """The passable cell over one edge of a cell, -1 for none; of `down`, `across` one is 0, one ±1.

    That is the neighbour on the same level, whose floor may differ by `max_step`, or the cell on
    another level that a link leads to at the neighbour's position.
    """
    other = _beside(layout, cell, down, across)
    # written so that NaN, no floor, is no step
    if other >= 0 and passable[other] and not abs(floor[cell] - floor[other]) > max_step:
        return other
    slot = find_slot(links.cell, cell)
    if slot < 0:
        return np.int64(-1)
    size = layout.cell_size[level_of(layout.start, cell)]
    x, y = center(layout, cell)
    x, y, near = x + across * size, y - down * size, 0.25 * size
    for i in range(links.start[slot], links.start[slot + 1]):
        other = links.target[i]
        if passable[other]:
            other_x, other_y = center(layout, other)
            if abs(other_x - x) < near and abs(other_y - y) < near:
                return other
    return np.int64(-1)


@kernel
def walk_line(space, room, cell, x0, y0, x1, y1):
    """Walk from a point in a cell straight to another: to which cell, and what share of the way.

    Through a corner of four cells, one of the two beside the line has to be passable. If `room`,
    by cell, is not empty, the line may start in cells that are not passable, and continue in them
    as long as they are of the first one's room, until it leaves them.
    """
    layout, links, floors, passable = space
    floor, max_step = floors.z, floors.max_step
    dx, dy = x1 - x0, y1 - y0
    across, down = 1 if dx > 0 else -1, 1 if dy < 0 else -1
    home, leaving = cell, len(room) > 0 and not passable[cell]
    share = 0.0
    while True:
        level = level_of(layout.start, cell)
        size = layout.cell_size[level]
        row, col = divmod(cell - layout.start[level], layout.width[level])
        edge_x = layout.x_min[level] + (col + (dx > 0)) * size
        edge_y = layout.y_max[level] - (row + (dy < 0)) * size
        to_x = (edge_x - x0) / dx if dx != 0.0 else np.inf
        to_y = (edge_y - y0) / dy if dy != 0.0 else np.inf
        # rounding may put an edge of the new cell before the one just crossed: never go back
        share = max(share, min(to_x, to_y))
        if share >= 1.0:
            return cell, 1.0
        following = np.int64(-1)
        # At a corner the line meets both edges at once. Then the cell over either edge is
        # enough: the second turn tries the other one, and the next round crosses from there.
        for turn in range(2):
            over_x = (to_x <= to_y) == (turn == 0)
            if following >= 0 or (turn == 1 and to_x != to_y):
                break
            dr, dc = (0, across) if over_x else (down, 0)
            following = cross(layout, links, passable, floor, max_step, cell, dr, dc)
            if following < 0 and leaving:
                beside = _beside(layout, cell, dr, dc)
                following = beside if beside >= 0 and room[beside] == room[home] else following
        if following < 0:
            return cell, share
        cell = following
        leaving = leaving and not passable[cell]


@part
def _beside(layout, cell, down, across):
    """The neighbour on the same level, -1 beyond its rim."""
    level = level_of(layout.start, cell)
    columns = layout.width[level]
    row, col = divmod(cell - layout.start[level], columns)
    if 0 <= row + down < layout.height[level] and 0 <= col + across < columns:
        return cell + down * columns + across
    return np.int64(-1)


@kernel
def is_in_sight(space, room, cell, x0, y0, target, x1, y1):
    """Whether a straight line between points in two cells meets passable cells only.

    Where `room` is not empty, the line may start in something; see `walk_line`.
    """
    x0, y0 = put_into(space.layout, cell, x0, y0)
    x1, y1 = put_into(space.layout, target, x1, y1)
    last, _ = walk_line(space, room, cell, x0, y0, x1, y1)
    clear = space.passable
    return last == target and clear[target] and (len(room) > 0 or clear[cell])
