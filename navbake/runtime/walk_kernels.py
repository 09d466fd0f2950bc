"""Walks along straight lines from cell to cell and from level to level, and slides at their ends.

A line goes from cell to cell as in Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray
Tracing" (1987). Unlike there, each crossing is computed from the cell's own edge, not summed up,
because a link may lead to a level whose cells lie elsewhere.

A slide searches the free cells near where the line is blocked, by shortest walks (Bellman and Ford
with a queue). In each cell, the point nearest to the line's end is a candidate for where it ends.
"""

import math

import numpy as np

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import (
    DIAGONAL,
    cell_center,
    clamp_to_cell,
    find_link_slot,
    floor_at,
    level_of,
    to_cell_units,
)
from navbake.runtime.place_kernels import locate

MAX_STEP_LENGTH = 1e6  # [m]: a longer step is cut, so that column numbers stay in range
# a walk in eight directions is at most this many times as long as the straight line
DETOUR_RATIO = 1.09
LENGTH_SLACK = 1e-9  # share of a length, or of a cell, by which rounding may change a length


@kernel
def step_each(layout, links, floors, passable, level, starts, ends, sliding):
    """Move from each start straight towards its end, and slide on; see `PathFinder.try_step`.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        links: steps to other levels, `navbake.runtime.grid_arrays.Links`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        passable: by cell, bool.
        level: the level of all starts; -1 to find each one's level.
        starts: world x, y, z [m], shape (n, 3), or (n, 2) with a level.
        ends: world x, y [m], shape (n, 2).
        sliding: whether to slide on from where the straight walk stops.

    Returns:
        World x, y and floor z of where the walks end [m], shape (n, 3); and the index of the first
        start whose cell is not passable, -1 for none.
    """
    no_rooms = np.empty(0, dtype=np.int32)
    cells = locate(layout, floors, level, starts)
    places = np.empty((len(starts), 3))
    for i in range(len(starts)):
        cell = cells[i]
        if cell < 0 or not passable[cell]:
            return places, i
        x0 = starts[i, 0]
        y0 = starts[i, 1]
        x1 = ends[i, 0]
        y1 = ends[i, 1]
        farthest = max(abs(x1 - x0), abs(y1 - y0))
        if farthest > MAX_STEP_LENGTH:
            x1 = x0 + (x1 - x0) * (MAX_STEP_LENGTH / farthest)
            y1 = y0 + (y1 - y0) * (MAX_STEP_LENGTH / farthest)
        cell, share = walk_line(layout, links, floors, passable, no_rooms, cell, x0, y0, x1, y1)
        x, y = clamp_to_cell(layout, cell, x0 + share * (x1 - x0), y0 + share * (y1 - y0))
        if share < 1.0 and sliding:
            cell, x, y = _slide(layout, links, floors, passable, cell, x, y, x1, y1)
        places[i, 0] = x
        places[i, 1] = y
        places[i, 2] = floor_at(floors, level_of(layout.start, cell), cell)
    return places, -1


@kernel
def first_in_sight(layout, links, floors, passable, room, cell, point, cells, points):
    """Find the first of several points that is in sight of a point.

    A straight line between them must cross passable cells only. The floors of neighbouring cells
    on it must differ by at most ``floors.max_step``, which is inf if heights don't count.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        links: steps to other levels, `navbake.runtime.grid_arrays.Links`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        passable: by cell, bool.
        room: by cell, int32; if it isn't empty, the line may start in cells that are not passable,
            see `walk_line`.
        cell: flat id of the point's cell.
        point: world x, y [m].
        cells: flat ids of the cells of `points`, shape (n,).
        points: world x, y [m], shape (n, 2 or more).

    Returns:
        The point's index in `points`, -1 for none.
    """
    if len(room) == 0 and not passable[cell]:
        return -1
    x0, y0 = clamp_to_cell(layout, cell, point[0], point[1])
    for i in range(len(cells)):
        target = cells[i]
        if passable[target]:
            x1, y1 = clamp_to_cell(layout, target, points[i, 0], points[i, 1])
            end, _ = walk_line(layout, links, floors, passable, room, cell, x0, y0, x1, y1)
            if end == target:
                return i
    return -1


@subkernel
def walk_line(layout, links, floors, passable, room, cell, x0, y0, x1, y1):
    """Walk from a point in a cell straight to another point, as far as cells are passable.

    Where the line runs through a corner of four cells, one of the two cells beside it must be
    passable.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        links: steps to other levels, `navbake.runtime.grid_arrays.Links`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        passable: by cell, bool.
        room: number of each cell's room, int32. If it isn't empty, the line may start in cells that
            are not passable, as long as they are in the first one's room, until it leaves them.
        cell: flat id of the start's cell.
        x0: world x of the start [m].
        y0: world y of the start [m].
        x1: world x of the end [m].
        y1: world y of the end [m].

    Returns:
        The flat id of the last cell; and the fraction of the line's length at which the line leaves
        that cell, 1 if it ends there.
    """
    dx = x1 - x0
    dy = y1 - y0
    col_step = 1 if dx > 0 else -1
    row_step = 1 if dy < 0 else -1
    first_cell = cell
    is_leaving = len(room) > 0 and not passable[cell]
    share = 0.0
    while True:
        level = level_of(layout.start, cell)
        size = layout.cell_size[level]
        row, col = divmod(cell - layout.start[level], layout.width[level])
        edge_x = layout.x_min[level] + (col + (dx > 0)) * size
        edge_y = layout.y_max[level] - (row + (dy < 0)) * size
        share_x = (edge_x - x0) / dx if dx != 0.0 else np.inf
        share_y = (edge_y - y0) / dy if dy != 0.0 else np.inf
        # rounding may place an edge of the new cell before the one just crossed: never go back
        share = max(share, min(share_x, share_y))
        if share >= 1.0:
            return cell, 1.0
        next_cell = np.int64(-1)
        # At a corner the line meets both edges at once. Then the cell over either edge is
        # enough: the second attempt tries the other one, and the next round crosses from there.
        for attempt in range(2):
            if next_cell >= 0 or (attempt == 1 and share_x != share_y):
                break
            is_over_x = (share_x <= share_y) == (attempt == 0)
            row_offset, col_offset = (0, col_step) if is_over_x else (row_step, 0)
            next_cell = _cell_over_edge(
                layout, links, passable, floors, cell, row_offset, col_offset
            )
            if next_cell < 0 and is_leaving:
                neighbor = _neighbor(layout, cell, row_offset, col_offset)
                if neighbor >= 0 and room[neighbor] == room[first_cell]:
                    next_cell = neighbor
        if next_cell < 0:
            return cell, share
        cell = next_cell
        is_leaving = is_leaving and not passable[cell]


@subkernel
def _cell_over_edge(layout, links, passable, floors, cell, row_offset, col_offset):
    """Find the passable cell on the other side of a cell's edge; -1 for none.

    It is the neighbour on the level, or a cell at that place on another level that a link leads to.
    One of `row_offset` and `col_offset` is 0, the other 1 or -1: they choose the edge.
    """
    neighbor = _neighbor(layout, cell, row_offset, col_offset)
    if neighbor >= 0 and passable[neighbor]:
        rise = abs(floors.z[cell] - floors.z[neighbor])
        if math.isnan(rise) or rise <= floors.max_step:  # NaN, no floor, is no step
            return neighbor
    slot = find_link_slot(links.cell, cell)
    if slot < 0:
        return np.int64(-1)
    size = layout.cell_size[level_of(layout.start, cell)]
    x, y = cell_center(layout, cell)
    x = x + col_offset * size
    y = y - row_offset * size
    tolerance = 0.25 * size
    for i in range(links.start[slot], links.start[slot + 1]):
        target = links.target[i]
        if passable[target]:
            target_x, target_y = cell_center(layout, target)
            if abs(target_x - x) < tolerance and abs(target_y - y) < tolerance:
                return target
    return np.int64(-1)


@subkernel
def _neighbor(layout, cell, row_offset, col_offset):
    """Find the flat id of a cell's neighbour on the same level; -1 outside the level."""
    level = level_of(layout.start, cell)
    num_cols = layout.width[level]
    row, col = divmod(cell - layout.start[level], num_cols)
    if 0 <= row + row_offset < layout.height[level] and 0 <= col + col_offset < num_cols:
        return cell + row_offset * num_cols + col_offset
    return np.int64(-1)


@subkernel
def _slide(layout, links, floors, passable, cell, x0, y0, x1, y1):
    """Slide on from x0, y0, where a straight walk was blocked, to the point nearest to x1, y1.

    A cell counts if a walk over passable neighbours to it is about as long as the rest of the
    straight walk at most; `DETOUR_RATIO` and 1.5 cells are allowed on top. Of it, only points count
    that are no farther from x0, y0 than that rest is long.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        links: steps to other levels, `navbake.runtime.grid_arrays.Links`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        passable: by cell, bool.
        cell: flat id of the cell of x0, y0.
        x0: world x of where the straight walk was blocked [m].
        y0: world y of it [m].
        x1: world x of where the straight walk should have ended [m].
        y1: world y of it [m].

    Returns:
        The flat id of the cell where the slide ends, and world x, y of the point [m].
    """
    remaining = math.hypot(x1 - x0, y1 - y0)
    size = layout.cell_size.min()
    limit = DETOUR_RATIO * remaining + 1.5 * size
    # for each level, the window of cells near x0, y0: first row and column, number of rows and of
    # columns, and the index of its first cell in the arrays of this search
    window_radius = np.int64(math.ceil(limit / size) + 1)
    num_slots = 0
    window = np.zeros((5, len(layout.width)), dtype=np.int64)
    for level in range(len(layout.width)):
        u, v = to_cell_units(layout, level, x0, y0)
        row = np.int64(math.floor(v))
        col = np.int64(math.floor(u))
        first_row = max(row - window_radius, np.int64(0))
        first_col = max(col - window_radius, np.int64(0))
        end_row = max(first_row, min(layout.height[level], row + window_radius + 1))
        end_col = max(first_col, min(layout.width[level], col + window_radius + 1))
        window[0, level] = first_row
        window[1, level] = first_col
        window[2, level] = end_row - first_row
        window[3, level] = end_col - first_col
        window[4, level] = num_slots
        num_slots += window[2, level] * window[3, level]
    length = np.full(num_slots, np.inf)
    is_queued = np.zeros(num_slots, dtype=np.bool_)
    queue = np.empty(num_slots, dtype=np.int64)  # a circle; no cell is in it twice, so all fit
    slot = _window_slot(layout, window, cell)
    length[slot] = 0.0
    queue[0] = cell
    is_queued[slot] = True
    steps = ((0, 1), (-1, 0), (0, -1), (1, 0))
    edge_neighbors = np.empty(4, dtype=np.int64)  # of the cell that is expanded
    head = 0
    count = 1
    squared_best = np.inf
    best_cell = cell
    best_x = x0
    best_y = y0
    while count > 0:
        current = queue[head]
        head = (head + 1) % len(queue)
        count = count - 1
        slot = _window_slot(layout, window, current)
        is_queued[slot] = False
        # the better of the best point so far and the nearest one in this cell
        x, y = clamp_to_cell(layout, current, x1, y1)
        squared = (x - x1) ** 2 + (y - y1) ** 2
        if squared < squared_best and (
            math.hypot(x - x0, y - y0) <= remaining * (1.0 + LENGTH_SLACK)
        ):
            squared_best = squared
            best_cell = current
            best_x = x
            best_y = y
        edge = layout.cell_size[level_of(layout.start, current)]
        for direction in range(8):  # over edges, then over corners past both sides
            row_offset, col_offset = steps[direction % 4]
            if direction < 4:
                target = _cell_over_edge(
                    layout, links, passable, floors, current, row_offset, col_offset
                )
                edge_neighbors[direction] = target
                target_length = length[slot] + edge
            else:
                first_side = edge_neighbors[direction - 4]
                second_side = edge_neighbors[(direction - 3) % 4]
                if first_side < 0 or second_side < 0:
                    continue
                next_row_offset, next_col_offset = steps[(direction - 3) % 4]
                over_first = _cell_over_edge(
                    layout, links, passable, floors, first_side, next_row_offset, next_col_offset
                )
                target = _cell_over_edge(
                    layout, links, passable, floors, second_side, row_offset, col_offset
                )
                if over_first != target:  # both walks round the corner end in the same cell
                    continue
                target_length = length[slot] + edge * DIAGONAL
            target_slot = _window_slot(layout, window, target) if target >= 0 else -1
            if (
                target_slot >= 0
                and target_length <= limit
                and target_length < length[target_slot] - LENGTH_SLACK * size
            ):
                length[target_slot] = target_length
                if not is_queued[target_slot]:
                    queue[(head + count) % len(queue)] = target
                    is_queued[target_slot] = True
                    count = count + 1
    return best_cell, best_x, best_y


@subkernel
def _window_slot(layout, window, cell):
    """Compute the index of a cell in the arrays of `_slide`, -1 outside its level's window."""
    level = level_of(layout.start, cell)
    row, col = divmod(cell - layout.start[level], layout.width[level])
    row = row - window[0, level]
    col = col - window[1, level]
    if not (0 <= row < window[2, level] and 0 <= col < window[3, level]):
        return np.int64(-1)
    return window[4, level] + row * window[3, level] + col
