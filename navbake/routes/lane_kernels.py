"""Straight lanes over a level: whether an agent may take them, and what they cost.

The cost of a line is its length times the mean weight of the cells under points on it, which are
about a quarter of a cell apart.
"""

import math

import numpy as np

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import (
    COL_STEP,
    ROW_STEP,
    cell_center,
    level_of,
    to_cell_units,
)
from navbake.runtime.line_kernels import can_pass, cell_at

CENTER_DISTANCE = 1e-6  # [m]: a point this near to a cell's centre is there
MICROMETRES = 1e6  # in a metre; positions of nodes are rounded to whole ones


@kernel
def sees(cell, target_cell, graph, off_center):
    """Whether an agent may move straight from one cell's centre to another's on the same level.

    It may if `navbake.runtime.line_kernels.can_pass` allows it, or over steps along a row, column
    or diagonal.

    Args:
        cell: flat id.
        target_cell: flat id, on the same level.
        graph: `navbake.runtime.grid_arrays.Graph`.
        off_center: `navbake.runtime.grid_arrays.OffCenter`.
    """
    layout = graph.layout
    level = level_of(layout.start, cell)
    start = _node_point(layout, cell)
    end = _node_point(layout, target_cell)
    if can_pass(start, end, level, graph, off_center):
        return True
    width = layout.width[level]
    row, col = divmod(cell - layout.start[level], width)
    target_row, target_col = divmod(target_cell - layout.start[level], width)
    row_offset = target_row - row
    col_offset = target_col - col
    num_steps = max(abs(row_offset), abs(col_offset))
    is_straight = row_offset == 0 or col_offset == 0 or abs(row_offset) == abs(col_offset)
    if num_steps == 0 or not is_straight:
        return False
    for direction in range(8):
        leads_to_row = ROW_STEP[direction] * num_steps == row_offset
        leads_to_col = COL_STEP[direction] * num_steps == col_offset
        if leads_to_row and leads_to_col:
            cell_step = ROW_STEP[direction] * width + COL_STEP[direction]
            for step in range(num_steps):
                if not (graph.moves[cell + step * cell_step] >> direction) & 1:
                    return False
    return True


@subkernel
def _node_point(layout, cell):
    """Compute x, y of a node in a cell [m]: the cell's centre, rounded."""
    x, y = cell_center(layout, cell)
    return np.rint(x * MICROMETRES) / MICROMETRES, np.rint(y * MICROMETRES) / MICROMETRES


@kernel
def sample_line(start, end, level, layout):
    """List the cells of points on a line between two points x, y of a level [m].

    Args:
        start: world x, y of the line's start [m].
        end: world x, y of its end [m].
        level: number of the level.
        layout: `navbake.runtime.grid_arrays.Layout`.

    Returns:
        Flat ids, in the line's order, int64.
    """
    x_offset = end[0] - start[0]
    y_offset = end[1] - start[1]
    cell_size = layout.cell_size[level]
    num_points = math.ceil(math.hypot(x_offset, y_offset) / cell_size * 4.0) + 1
    cells = np.empty(num_points, np.int64)
    for i in range(num_points):
        fraction = (i + 0.5) / num_points
        x = start[0] + fraction * x_offset
        y = start[1] + fraction * y_offset
        cells[i] = cell_at(layout, level, to_cell_units(layout, level, x, y))
    return cells


@kernel
def measure_mean_weight(start, end, level, graph):
    """Compute the mean weight of the cells on a line between two points x, y of a level [m].

    Args:
        start: world x, y of the line's start [m].
        end: world x, y of its end [m].
        level: number of the level.
        graph: `navbake.runtime.grid_arrays.Graph`.
    """
    cells = sample_line(start, end, level, graph.layout)
    weight_sum = 0.0
    for cell in cells:
        weight_sum += graph.weight[cell]
    return weight_sum / cells.shape[0]


@subkernel
def _line_cost(start, end, level, graph):
    """Compute the cost of a line between two points x, y of a level [m]."""
    length = math.hypot(end[0] - start[0], end[1] - start[1])
    return length * measure_mean_weight(start, end, level, graph)


@kernel
def measure_polyline(points, level, graph):
    """Compute the cost of a polyline on a level [m].

    Args:
        points: world x, y of its points [m], shape (n, 2 or more).
        level: number of the level.
        graph: `navbake.runtime.grid_arrays.Graph`.
    """
    cost = 0.0
    for i in range(points.shape[0] - 1):
        start = (points[i, 0], points[i, 1])
        end = (points[i + 1, 0], points[i + 1, 1])
        cost += _line_cost(start, end, level, graph)
    return cost


@kernel
def find_corner_cells(points, level, layout):
    """Find the cells of the points of a path that are at cells' centres.

    Corners are there; at other points, only the height of the floor bends.

    Args:
        points: world x, y of points of a level [m], shape (n, 2 or more).
        level: number of the level.
        layout: `navbake.runtime.grid_arrays.Layout`.

    Returns:
        Flat ids, in the order of the points, int64.
    """
    corner_cells = np.empty(points.shape[0], np.int64)
    num_corners = 0
    for i in range(points.shape[0]):
        point_in_cells = to_cell_units(layout, level, points[i, 0], points[i, 1])
        cell = cell_at(layout, level, point_in_cells)
        x, y = cell_center(layout, cell)
        if max(abs(x - points[i, 0]), abs(y - points[i, 1])) < CENTER_DISTANCE:
            corner_cells[num_corners] = cell
            num_corners += 1
    return corner_cells[:num_corners].copy()


@kernel
def find_farthest_corner(node_cell, corner_cells, max_factor, graph, off_center):
    """Find the farthest corner of a path to which a straight lane from a node may lead.

    The node must see the corner, and the line must cost at most `max_factor` times as much as the
    path over the corners before. The first corner needs no such line.

    Args:
        node_cell: flat id of the node's cell.
        corner_cells: flat ids of the corners after the node, all on its level, shape (n,), n >= 1.
        max_factor: the largest cost of the line, as a multiple of the path's.
        graph: `navbake.runtime.grid_arrays.Graph`.
        off_center: `navbake.runtime.grid_arrays.OffCenter`.

    Returns:
        The corner's index in `corner_cells`, and the mean weight of the cells on the line to it.
    """
    layout = graph.layout
    level = level_of(layout.start, node_cell)
    start = _node_point(layout, node_cell)
    num_corners = corner_cells.shape[0]
    path_costs = np.empty(num_corners)  # from the node over the corners before
    path_cost = 0.0
    point = start
    for index in range(num_corners):
        corner = cell_center(layout, corner_cells[index])
        path_cost += _line_cost(point, corner, level, graph)
        path_costs[index] = path_cost
        point = corner
    for index in range(num_corners - 1, 0, -1):
        if not sees(node_cell, corner_cells[index], graph, off_center):
            continue
        corner = cell_center(layout, corner_cells[index])
        if _line_cost(start, corner, level, graph) <= max_factor * path_costs[index]:
            return index, measure_mean_weight(start, corner, level, graph)
    first_corner = cell_center(layout, corner_cells[0])
    return 0, measure_mean_weight(start, first_corner, level, graph)
