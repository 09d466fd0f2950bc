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
    find_link_cell_index,
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
def step_each(layout, links, floors, is_passable, level, starts, ends, can_slide):
    """Move from each start straight towards its end, and slide on; see `PathFinder.try_step`.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        links: steps to other levels, `navbake.runtime.grid_arrays.Links`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        is_passable: by cell, bool.
        level: the level of all starts; -1 to find each one's level.
        starts: world x, y, z [m], shape (n, 3), or (n, 2) with a level.
        ends: world x, y [m], shape (n, 2).
        can_slide: whether to slide on from where the straight walk stops.

    Returns:
        World x, y and floor z of where the walks end [m], shape (n, 3); and the index of the first
        start whose cell is not passable, -1 for none.
    """
    no_rooms = np.empty(0, dtype=np.int32)
    cells = locate(layout, floors, level, starts)
    places = np.empty((len(starts), 3))
    for i in range(len(starts)):
        cell = cells[i]
        if cell < 0 or not is_passable[cell]:
            return places, i
        x0 = starts[i, 0]
        y0 = starts[i, 1]
        x1 = ends[i, 0]
        y1 = ends[i, 1]
        axis_distance = max(abs(x1 - x0), abs(y1 - y0))
        if axis_distance > MAX_STEP_LENGTH:
            x1 = x0 + (x1 - x0) * (MAX_STEP_LENGTH / axis_distance)
            y1 = y0 + (y1 - y0) * (MAX_STEP_LENGTH / axis_distance)
        cell, fraction = walk_line(
            layout, links, floors, is_passable, no_rooms, cell, x0, y0, x1, y1
        )
        x, y = clamp_to_cell(layout, cell, x0 + fraction * (x1 - x0), y0 + fraction * (y1 - y0))
        if fraction < 1.0 and can_slide:
            cell, x, y = _slide(layout, links, floors, is_passable, cell, x, y, x1, y1)
        places[i, 0] = x
        places[i, 1] = y
        places[i, 2] = floor_at(floors, level_of(layout.start, cell), cell)
    return places, -1


@kernel
def first_in_sight(layout, links, floors, is_passable, room_numbers, cell, point, cells, points):
    """Find the first of several points that is in sight of a point.

    A straight line between them must cross passable cells only. The floors of neighbouring cells
    on it must differ by at most ``floors.max_step``, which is inf if heights don't count.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        links: steps to other levels, `navbake.runtime.grid_arrays.Links`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        is_passable: by cell, bool.
        room_numbers: empty if lines must start in a passable cell. Else the number of each cell's
            room, int32: lines may then start inside an object, see `walk_line`.
        cell: flat id of the point's cell.
        point: world x, y [m].
        cells: flat ids of the cells of `points`, shape (n,).
        points: world x, y [m], shape (n, 2 or more).

    Returns:
        The point's index in `points`, -1 for none.
    """
    if len(room_numbers) == 0 and not is_passable[cell]:
        return -1
    x0, y0 = clamp_to_cell(layout, cell, point[0], point[1])
    for i in range(len(cells)):
        target = cells[i]
        if is_passable[target]:
            x1, y1 = clamp_to_cell(layout, target, points[i, 0], points[i, 1])
            last_cell, _ = walk_line(
                layout, links, floors, is_passable, room_numbers, cell, x0, y0, x1, y1
            )
            if last_cell == target:
                return i
    return -1


@subkernel
def walk_line(layout, links, floors, is_passable, room_numbers, cell, x0, y0, x1, y1):
    """Walk from a point in a cell straight to another point, as far as cells are passable.

    Where the line runs through a corner of four cells, one of the two cells beside it must be
    passable.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        links: steps to other levels, `navbake.runtime.grid_arrays.Links`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        is_passable: by cell, bool.
        room_numbers: empty if the line must start in a passable cell. Else the number of each
            cell's room, int32: the line may then begin with cells that are not passable, if they
            are all in the room of the first one. From its first passable cell on, the walk ends
            at the next cell that isn't passable.
        cell: flat id of the start's cell.
        x0: world x of the start [m].
        y0: world y of the start [m].
        x1: world x of the end [m].
        y1: world y of the end [m].

    Returns:
        The flat id of the last cell that the walk reaches; and the fraction of the line's length at
        which the line leaves that cell, 1 if the line ends in it.
    """
    x_length = x1 - x0
    y_length = y1 - y0
    col_step = 1 if x_length > 0 else -1
    row_step = 1 if y_length < 0 else -1
    first_cell = cell
    is_leaving_object = len(room_numbers) > 0 and not is_passable[cell]
    fraction = 0.0
    while True:
        level = level_of(layout.start, cell)
        cell_size = layout.cell_size[level]
        row, col = divmod(cell - layout.start[level], layout.width[level])
        edge_x = layout.x_min[level] + (col + (x_length > 0)) * cell_size
        edge_y = layout.y_max[level] - (row + (y_length < 0)) * cell_size
        fraction_x = (edge_x - x0) / x_length if x_length != 0.0 else np.inf
        fraction_y = (edge_y - y0) / y_length if y_length != 0.0 else np.inf
        # rounding may place an edge of the new cell before the one just crossed: never go back
        fraction = max(fraction, min(fraction_x, fraction_y))
        if fraction >= 1.0:
            return cell, 1.0
        next_cell = np.int64(-1)
        # At a corner the line meets both edges at once. Then the cell over either edge is
        # enough: the second attempt tries the other one, and the next round crosses from there.
        for attempt in range(2):
            if next_cell >= 0 or (attempt == 1 and fraction_x != fraction_y):
                break
            is_over_x = (fraction_x <= fraction_y) == (attempt == 0)
            row_offset, col_offset = (0, col_step) if is_over_x else (row_step, 0)
            next_cell = _cell_over_edge(
                layout, links, is_passable, floors, cell, row_offset, col_offset
            )
            if next_cell < 0 and is_leaving_object:
                neighbor = _find_neighbor(layout, cell, row_offset, col_offset)
                if neighbor >= 0 and room_numbers[neighbor] == room_numbers[first_cell]:
                    next_cell = neighbor
        if next_cell < 0:
            return cell, fraction
        cell = next_cell
        is_leaving_object = is_leaving_object and not is_passable[cell]


@subkernel
def _cell_over_edge(layout, links, is_passable, floors, cell, row_offset, col_offset):
    """Find the passable cell on the other side of a cell's edge; -1 for none.

    It is the neighbour on the level, or a cell at that place on another level that a link leads to.
    One of `row_offset` and `col_offset` is 0, the other 1 or -1: they choose the edge.
    """
    neighbor = _find_neighbor(layout, cell, row_offset, col_offset)
    if neighbor >= 0 and is_passable[neighbor]:
        rise = abs(floors.z[cell] - floors.z[neighbor])
        if math.isnan(rise) or rise <= floors.max_step:  # NaN, no floor, is no step
            return neighbor
    link_cell_index = find_link_cell_index(links.cell, cell)
    if link_cell_index < 0:
        return np.int64(-1)
    cell_size = layout.cell_size[level_of(layout.start, cell)]
    x, y = cell_center(layout, cell)
    x = x + col_offset * cell_size
    y = y - row_offset * cell_size
    tolerance = 0.25 * cell_size
    for i in range(links.start[link_cell_index], links.start[link_cell_index + 1]):
        target = links.target[i]
        if is_passable[target]:
            target_x, target_y = cell_center(layout, target)
            if abs(target_x - x) < tolerance and abs(target_y - y) < tolerance:
                return target
    return np.int64(-1)


@subkernel
def _find_neighbor(layout, cell, row_offset, col_offset):
    """Find the flat id of a cell's neighbour on the same level; -1 outside the level."""
    level = level_of(layout.start, cell)
    num_cols = layout.width[level]
    row, col = divmod(cell - layout.start[level], num_cols)
    if 0 <= row + row_offset < layout.height[level] and 0 <= col + col_offset < num_cols:
        return cell + row_offset * num_cols + col_offset
    return np.int64(-1)


@subkernel
def _slide(layout, links, floors, is_passable, cell, x0, y0, x1, y1):
    """Slide on from x0, y0, where a straight walk was blocked, to the point nearest to x1, y1.

    A cell counts if a walk over passable neighbours to it is at most about as long as the rest of
    the straight walk; `DETOUR_RATIO` and 1.5 cells are allowed on top. In such a cell, only points
    count that are no farther from x0, y0 than the rest of the straight walk is long.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        links: steps to other levels, `navbake.runtime.grid_arrays.Links`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        is_passable: by cell, bool.
        cell: flat id of the cell of x0, y0.
        x0: world x of where the straight walk was blocked [m].
        y0: world y of it [m].
        x1: world x of where the straight walk should have ended [m].
        y1: world y of it [m].

    Returns:
        The flat id of the cell where the slide ends, and world x, y of the point [m].
    """
    remaining_length = math.hypot(x1 - x0, y1 - y0)
    smallest_cell_size = layout.cell_size.min()
    max_walk_length = DETOUR_RATIO * remaining_length + 1.5 * smallest_cell_size
    # for each level, the window of cells near x0, y0: first row and column, number of rows and of
    # columns, and the index of its first cell in the arrays of this search, one level a column
    window_radius = np.int64(math.ceil(max_walk_length / smallest_cell_size) + 1)
    num_indices = 0
    windows = np.zeros((5, len(layout.width)), dtype=np.int64)
    for level in range(len(layout.width)):
        col_position, row_position = to_cell_units(layout, level, x0, y0)
        row = np.int64(math.floor(row_position))
        col = np.int64(math.floor(col_position))
        first_row = max(row - window_radius, np.int64(0))
        first_col = max(col - window_radius, np.int64(0))
        stop_row = max(first_row, min(layout.height[level], row + window_radius + 1))
        stop_col = max(first_col, min(layout.width[level], col + window_radius + 1))
        windows[0, level] = first_row
        windows[1, level] = first_col
        windows[2, level] = stop_row - first_row
        windows[3, level] = stop_col - first_col
        windows[4, level] = num_indices
        num_indices += windows[2, level] * windows[3, level]
    walk_lengths = np.full(num_indices, np.inf)
    is_queued = np.zeros(num_indices, dtype=np.bool_)
    queue = np.empty(num_indices, dtype=np.int64)  # a circle; no cell is in it twice, so all fit
    array_index = _window_index(layout, windows, cell)
    walk_lengths[array_index] = 0.0
    queue[0] = cell
    is_queued[array_index] = True
    edge_directions = ((0, 1), (-1, 0), (0, -1), (1, 0))
    edge_neighbors = np.empty(4, dtype=np.int64)  # of the cell that is expanded
    queue_head = 0
    num_queued = 1
    least_squared_distance = np.inf
    best_cell = cell
    best_x = x0
    best_y = y0
    while num_queued > 0:
        current_cell = queue[queue_head]
        queue_head = (queue_head + 1) % len(queue)
        num_queued = num_queued - 1
        array_index = _window_index(layout, windows, current_cell)
        is_queued[array_index] = False
        # the better of the best point so far and the nearest one in this cell
        x, y = clamp_to_cell(layout, current_cell, x1, y1)
        squared_distance = (x - x1) ** 2 + (y - y1) ** 2
        if squared_distance < least_squared_distance and (
            math.hypot(x - x0, y - y0) <= remaining_length * (1.0 + LENGTH_SLACK)
        ):
            least_squared_distance = squared_distance
            best_cell = current_cell
            best_x = x
            best_y = y
        cell_size = layout.cell_size[level_of(layout.start, current_cell)]
        for direction in range(8):  # over edges, then over corners past both sides
            row_offset, col_offset = edge_directions[direction % 4]
            if direction < 4:
                target = _cell_over_edge(
                    layout, links, is_passable, floors, current_cell, row_offset, col_offset
                )
                edge_neighbors[direction] = target
                target_length = walk_lengths[array_index] + cell_size
            else:
                first_side_cell = edge_neighbors[direction - 4]
                second_side_cell = edge_neighbors[(direction - 3) % 4]
                if first_side_cell < 0 or second_side_cell < 0:
                    continue
                next_row_offset, next_col_offset = edge_directions[(direction - 3) % 4]
                target_over_first = _cell_over_edge(
                    layout,
                    links,
                    is_passable,
                    floors,
                    first_side_cell,
                    next_row_offset,
                    next_col_offset,
                )
                target = _cell_over_edge(
                    layout, links, is_passable, floors, second_side_cell, row_offset, col_offset
                )
                if target_over_first != target:  # both walks round the corner end in the same cell
                    continue
                target_length = walk_lengths[array_index] + cell_size * DIAGONAL
            target_index = _window_index(layout, windows, target) if target >= 0 else -1
            if (
                target_index >= 0
                and target_length <= max_walk_length
                and target_length < walk_lengths[target_index] - LENGTH_SLACK * smallest_cell_size
            ):
                walk_lengths[target_index] = target_length
                if not is_queued[target_index]:
                    queue[(queue_head + num_queued) % len(queue)] = target
                    is_queued[target_index] = True
                    num_queued = num_queued + 1
    return best_cell, best_x, best_y


@subkernel
def _window_index(layout, windows, cell):
    """Compute the index of a cell in the arrays of `_slide`; -1 outside of its level's window."""
    level = level_of(layout.start, cell)
    row, col = divmod(cell - layout.start[level], layout.width[level])
    row = row - windows[0, level]
    col = col - windows[1, level]
    if not (0 <= row < windows[2, level] and 0 <= col < windows[3, level]):
        return np.int64(-1)
    return windows[4, level] + row * windows[3, level] + col
