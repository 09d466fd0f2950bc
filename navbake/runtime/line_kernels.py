"""Straight lines over a level: the cells that they touch, whether a disc fits, and their costs.

The ends of lines are points (u, v) in the level's own units, u in columns and v in rows: cell
(row, col) is the square from (col, row) to (col + 1, row + 1).

`is_walkable` is a supercover line, row by row: all cells that meet the line count, also those that
it only touches.

`disc_passes` sweeps a disc over squares, exactly, with one test for each row of cells. The area
that the disc covers along the line (a capsule) is convex. So it meets the cells of one row in a
single interval of columns, whose ends have a closed form, and running sums say whether any of these
cells is solid.

`lay_route` pulls a route straight by line of sight (string pulling): from each point, the line goes
on to the farthest point that it can reach straight, which is searched by doubling the distance and
then halving it (exponential search, Bentley and Yao 1976). A funnel could not tell the cost of a
line where weights differ.
"""

import math

import numpy as np

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import (
    EAST,
    SOUTH,
    cell_center,
    floor_at,
    level_of,
    to_cell_units,
)

TOUCH_DISTANCE = 1e-9  # share of a cell: what is this near a line is touched, for rounding
RADIUS_SLACK = 1e-9  # share of a radius by which a disc may overlap a square, for rounding
STEEP_RISE = 1.001  # in cells: if the floors of neighbours differ by more, it is no slope
COLLINEAR_DISTANCE = 1e-9  # [m]: a point this near to a straight line is on it
SAME_POINT_DISTANCE = 1e-9  # [m]: points this near to each other are the same
FLOOR_TOLERANCE = 1e-3  # [m]: how far a path may be above or below the floor in a cell's middle
COST_SLACK = 1e-9  # share of a cost by which a straight line may cost more, for rounding
LEAST_SHARE = (
    1e-12  # share of a line: if less of it is in a cell, it only touches the cell's corner
)


@subkernel
def is_walkable(start, end, layout, level, moves, is_allowed):
    """Whether an agent can walk along a line.

    All cells that the line touches must be allowed, also those of which it touches only an edge or
    a corner, and moves must lead from each of these cells to the next.

    Args:
        start: u, v of the line's start.
        end: u, v of its end.
        layout: `navbake.runtime.grid_arrays.Layout`.
        level: number of the level.
        moves: by cell, see `navbake.runtime.grid_arrays.Graph`.
        is_allowed: by cell, bool.
    """
    u0, v0 = start
    u1, v1 = end
    first_cell = layout.start[level]
    width = layout.width[level]
    first_row = math.floor(min(v0, v1) - TOUCH_DISTANCE)
    last_row = math.floor(max(v0, v1) + TOUCH_DISTANCE)
    if first_row < 0 or last_row >= layout.height[level]:
        return False
    # columns touched in the row before
    previous_first_col = 0
    previous_last_col = -1
    for row in range(first_row, last_row + 1):
        u_low = min(u0, u1)
        u_high = max(u0, u1)
        if v0 != v1:  # the part of the line in the row
            fraction_at_top = (row - TOUCH_DISTANCE - v0) / (v1 - v0)
            fraction_at_bottom = (row + 1 + TOUCH_DISTANCE - v0) / (v1 - v0)
            entry_fraction = min(max(min(fraction_at_top, fraction_at_bottom), 0.0), 1.0)
            exit_fraction = max(min(max(fraction_at_top, fraction_at_bottom), 1.0), 0.0)
            u_enter = u0 + entry_fraction * (u1 - u0)
            u_leave = u0 + exit_fraction * (u1 - u0)
            u_low = min(u_enter, u_leave)
            u_high = max(u_enter, u_leave)
        first_col = math.floor(u_low - TOUCH_DISTANCE)
        last_col = math.floor(u_high + TOUCH_DISTANCE)
        if first_col < 0 or last_col >= width:
            return False
        for col in range(first_col, last_col + 1):
            cell = first_cell + row * width + col
            if not is_allowed[cell]:
                return False
            # each edge between two touched cells is one that the line may run along or cross
            if col < last_col and not moves[cell] & EAST:
                return False
            if previous_first_col <= col <= previous_last_col and not moves[cell - width] & SOUTH:
                return False
        previous_first_col = first_col
        previous_last_col = last_col
    return True


@subkernel
def find_crossed_cells(start, end, layout, level):
    """Compute which cells a line crosses, and where along the line each of them begins.

    Cells that the line only touches at a corner are left out.

    Args:
        start: u, v of the line's start.
        end: u, v of its end.
        layout: `navbake.runtime.grid_arrays.Layout`.
        level: number of the level.

    Returns:
        The flat ids of the n cells, in the line's order; and n + 1 fractions of the line's length,
        0 to 1: the line is in cell i from fraction i to fraction i + 1.
    """
    u0, v0 = start
    u1, v1 = end
    du = u1 - u0
    dv = v1 - v0
    row = math.floor(v0)
    col = math.floor(u0)
    max_cells = abs(math.floor(u1) - col) + abs(math.floor(v1) - row) + 2
    cells = np.empty(max_cells, np.int64)
    entry_fractions = np.zeros(max_cells + 1)
    num_cells = 0
    exit_fraction = 0.0
    while exit_fraction < 1.0:
        # where the line leaves the cell, over an edge or at its end
        exit_fraction_u = (col + (du > 0.0) - u0) / du if du != 0.0 else np.inf
        exit_fraction_v = (row + (dv > 0.0) - v0) / dv if dv != 0.0 else np.inf
        exit_fraction = min(exit_fraction_u, exit_fraction_v, 1.0)
        if exit_fraction - entry_fractions[num_cells] > LEAST_SHARE or (
            exit_fraction >= 1.0 and num_cells == 0
        ):
            inside_row = min(max(row, 0), layout.height[level] - 1)
            inside_col = min(max(col, 0), layout.width[level] - 1)
            cells[num_cells] = layout.start[level] + inside_row * layout.width[level] + inside_col
            num_cells += 1
            entry_fractions[num_cells] = exit_fraction
        if exit_fraction_u <= exit_fraction_v:
            col += 1 if du > 0.0 else -1
        else:
            row += 1 if dv > 0.0 else -1
    entry_fractions[num_cells] = 1.0
    return cells[:num_cells], entry_fractions[: num_cells + 1]


@subkernel
def compute_line_cost(start, end, level, graph):
    """Compute the cost of a straight line between two points x, y [m].

    For each cell that the line crosses, the line's length within the cell is multiplied by the
    cell's weight. The cost is the sum. Lengths are in cells, not in metres.

    Args:
        start: world x, y of the line's start [m].
        end: world x, y of its end [m].
        level: number of the level.
        graph: `navbake.runtime.grid_arrays.Graph`.
    """
    start_in_cells = to_cell_units(graph.layout, level, start[0], start[1])
    end_in_cells = to_cell_units(graph.layout, level, end[0], end[1])
    cells, entry_fractions = find_crossed_cells(start_in_cells, end_in_cells, graph.layout, level)
    mean_weight = 0.0
    for k in range(cells.shape[0]):
        mean_weight += (entry_fractions[k + 1] - entry_fractions[k]) * graph.weight[cells[k]]
    return mean_weight * math.hypot(
        end_in_cells[0] - start_in_cells[0], end_in_cells[1] - start_in_cells[1]
    )


@subkernel
def disc_passes(start, end, layout, level, num_solid_before, radius):
    """Return whether a disc can move along a line without overlapping a solid cell's square.

    What is beyond the level's own cells doesn't count.

    Args:
        start: u, v of the line's start: columns and rows from the level's first corner, in cells.
        end: u, v of its end.
        layout: `navbake.runtime.grid_arrays.Layout`.
        level: number of the level.
        num_solid_before: `OffCenter.num_solid_before` of `navbake.runtime.grid_arrays`.
        radius: the disc's radius, in cells.
    """
    u0, v0 = start
    u1, v1 = end
    num_rows = layout.height[level]
    num_cols = layout.width[level]
    effective_radius = radius * (1.0 - RADIUS_SLACK)
    v_min = min(v0, v1) - effective_radius
    v_max = max(v0, v1) + effective_radius
    for row in range(math.floor(v_min), math.ceil(v_max)):
        v_low = max(float(row), v_min)
        v_high = min(row + 1.0, v_max)
        # the smallest u of the capsule is the largest one of its mirror image
        u_min = -_largest_u(-u0, v0, -u1, v1, v_low, v_high, effective_radius)
        u_max = _largest_u(u0, v0, u1, v1, v_low, v_high, effective_radius)
        first_col = math.floor(u_min)
        stop_col = math.ceil(u_max)
        first_col = max(first_col, 0)
        stop_col = min(stop_col, num_cols)
        if row < 0 or row >= num_rows or first_col >= stop_col:
            continue
        row_start_id = layout.start[level] + row * num_cols
        if num_solid_before[row_start_id + stop_col] > num_solid_before[row_start_id + first_col]:
            return False
    return True


@subkernel
def _largest_u(u0, v0, u1, v1, v_low, v_high, radius):
    """Compute the largest u that a disc swept from (u0, v0) to (u1, v1) covers.

    Only points with v from `v_low` to `v_high` count; the disc covers some at each such v.
    """
    # The capsule's largest u as a function of v rises up to the v of the line's end of larger u,
    # and falls from there. So the largest u is at the v nearest to that one.
    v_at_peak = v1 if u1 > u0 else v0
    if u0 == u1:  # it is the same all along the line
        v_at_peak = min(max(v_low, min(v0, v1)), max(v0, v1))
    v = min(max(v_at_peak, v_low), v_high)
    du = u1 - u0
    dv = v1 - v0
    fraction = 1.0 if u1 > u0 else 0.0
    if dv != 0.0:
        # Of all discs along the line, the one that covers the largest u at v touches the capsule's
        # edge there: its radius is perpendicular to the line. Or else it is the disc at an end.
        signed_du = -math.copysign(du, du * dv) if du != 0.0 else 0.0
        fraction = (v - radius * signed_du / math.hypot(du, dv) - v0) / dv
        fraction = min(max(fraction, 0.0), 1.0)
    v_offset = v - v0 - fraction * dv
    return u0 + fraction * du + math.sqrt(max(radius * radius - v_offset * v_offset, 0.0))


@kernel
def can_pass(start, end, level, graph, off_center):
    """Whether an agent can move along a line between two points x, y of a level [m].

    It can if it fits at every point of every cell that the line touches. It also can if all of
    these cells are `sweepable`, and its disc overlaps no solid square along the line.

    Args:
        start: world x, y of the line's start [m].
        end: world x, y of its end [m].
        level: the level of both.
        graph: `navbake.runtime.grid_arrays.Graph`.
        off_center: `navbake.runtime.grid_arrays.OffCenter`.
    """
    layout = graph.layout
    moves = graph.moves
    start_in_cells = to_cell_units(layout, level, start[0], start[1])
    end_in_cells = to_cell_units(layout, level, end[0], end[1])
    if is_walkable(start_in_cells, end_in_cells, layout, level, moves, off_center.anywhere):
        return True
    if off_center.radius == 0.0:
        return False
    if not is_walkable(start_in_cells, end_in_cells, layout, level, moves, off_center.sweepable):
        return False
    radius = off_center.radius / layout.cell_size[level]
    num_solid_before = off_center.num_solid_before
    return disc_passes(start_in_cells, end_in_cells, layout, level, num_solid_before, radius)


@kernel
def lay_route(route, is_by_link, start, end, is_smooth, graph, floors, off_center):
    """Turn a route of cells into a polyline.

    The polyline runs through the cells' centres. If it is pulled straight, it leaves out centres
    where `can_pass` allows a straight line that costs no more. It begins at `start` and ends at
    `end`. If one of them is NaN, or too near to obstacles, the centre of the first or last cell is
    used.

    Args:
        route: flat ids, shape (n,), int64.
        is_by_link: whether the route enters the cell over a link, bool, shape (n,).
        start: x, y in the first cell [m], or NaN.
        end: x, y in the last cell [m], or NaN.
        is_smooth: whether to pull the line straight.
        graph: `navbake.runtime.grid_arrays.Graph`.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        off_center: `navbake.runtime.grid_arrays.OffCenter`.

    Returns:
        Three arrays of m points. World x, y and floor z [m], shape (m, 3). The level of each point,
        shape (m,). For a point from which a link leads to the next point, the index in `route` of
        the cell that the link leads to, 0 for other points, shape (m,).
    """
    layout = graph.layout
    num_cells = route.shape[0]
    end_index = num_cells + 1
    # the start, the cells' centres, the end
    points = np.empty((num_cells + 2, 2))
    levels = np.empty(num_cells + 2, np.int64)
    # the index of the cell that a link leads to from a point to the next, 0 for none
    link_end_indices = np.zeros(num_cells + 1, np.int64)
    for i in range(num_cells):
        levels[i + 1] = level_of(layout.start, route[i])
        points[i + 1, 0], points[i + 1, 1] = cell_center(layout, route[i])
        link_end_indices[i] = i if is_by_link[i] else 0
    levels[0] = levels[1]
    levels[end_index] = levels[num_cells]
    is_included = np.ones(num_cells + 2, np.bool_)
    for index, neighbor_index, point in ((0, 1, start), (end_index, num_cells, end)):
        points[index, 0] = point[0]
        points[index, 1] = point[1]
        # False for NaN
        is_apart = (
            max(
                abs(point[0] - points[neighbor_index, 0]), abs(point[1] - points[neighbor_index, 1])
            )
            > SAME_POINT_DISTANCE
        )
        is_included[index] = is_apart and can_pass(
            points[min(index, neighbor_index)],
            points[max(index, neighbor_index)],
            levels[index],
            graph,
            off_center,
        )
    first_point_index = 1 - is_included[0]
    stop_point_index = end_index + is_included[end_index]
    points = points[first_point_index:stop_point_index]
    levels = levels[first_point_index:stop_point_index]
    link_end_indices = link_end_indices[first_point_index : stop_point_index - 1]
    if is_smooth:
        corner_indices = np.flatnonzero(
            _pull_string(points, levels, link_end_indices, graph, off_center)
        )
        points = points[corner_indices]
        levels = levels[corner_indices]
        link_end_indices = link_end_indices[corner_indices[:-1]]
    return _lay_on_floor(points, levels, link_end_indices, layout, floors)


@subkernel
def _pull_string(points, levels, link_end_indices, graph, off_center):
    """Mark the corners of a route that remain when it is pulled straight.

    Straight lines between the corners are free, see `can_pass`. None costs more than the part of
    the route that it replaces, and none replaces a link.

    Args:
        points: x, y of the route's points [m], shape (n, 2).
        levels: the level of each point, shape (n,).
        link_end_indices: not 0 where a link leads from a point to the next one, shape (n - 1,).
        graph: `navbake.runtime.grid_arrays.Graph`.
        off_center: `navbake.runtime.grid_arrays.OffCenter`.

    Returns:
        bool, shape (n,).
    """
    num_points = points.shape[0]
    costs = np.zeros(num_points)  # of the route up to each point
    if graph.uniform_weight <= 0.0:
        for i in range(1, num_points):
            costs[i] = costs[i - 1]
            if not link_end_indices[i - 1]:
                costs[i] += compute_line_cost(points[i - 1], points[i], levels[i], graph)
    current_corner = 0
    is_corner = np.zeros(num_points, np.bool_)
    is_corner[0] = True
    while current_corner < num_points - 1:
        last_index = current_corner + 1  # before the next link
        while (
            last_index < num_points - 1
            and not link_end_indices[current_corner]
            and not link_end_indices[last_index]
        ):
            last_index += 1
        # the indices of a point that can be reached straight, and of one that can't. Sight is not
        # monotonous, so the point that the search ends at need not be the very farthest.
        reachable_index = current_corner + 1
        unreachable_index = last_index + 1
        stride = 2
        while unreachable_index - reachable_index > 1:
            candidate_index = (
                min(current_corner + stride, last_index)
                if unreachable_index > last_index
                else (reachable_index + unreachable_index) // 2
            )
            start = points[current_corner]
            end = points[candidate_index]
            level = levels[current_corner]
            if can_pass(start, end, level, graph, off_center) and (
                graph.uniform_weight > 0.0
                or compute_line_cost(start, end, level, graph)
                <= (costs[candidate_index] - costs[current_corner]) * (1.0 + COST_SLACK)
            ):
                reachable_index = candidate_index
            else:
                unreachable_index = candidate_index
            stride *= 2
        current_corner = reachable_index
        is_corner[current_corner] = True
    # drop points on the straight line between the points before and after, but no ends of links
    previous_corner = 0
    current_corner = -1
    for next_corner in range(1, num_points):
        if not is_corner[next_corner]:
            continue
        if current_corner >= 0:
            chord = points[next_corner] - points[previous_corner]
            corner_vector = points[current_corner] - points[previous_corner]
            chord_length = math.hypot(chord[0], chord[1])
            cross_product = abs(chord[0] * corner_vector[1] - chord[1] * corner_vector[0])
            dot_product = chord[0] * corner_vector[0] + chord[1] * corner_vector[1]
            is_link_end = link_end_indices[current_corner - 1] or link_end_indices[current_corner]
            is_bent = (
                cross_product > COLLINEAR_DISTANCE * chord_length
                or not 0.0 <= dot_product <= chord_length * chord_length
            )
            if is_link_end or is_bent:
                previous_corner = current_corner
            else:
                is_corner[current_corner] = False
        current_corner = next_corner
    return is_corner


@subkernel
def _lay_on_floor(points, levels, link_end_indices, layout, floors):
    """Lay the lines between points on the floor, with more points where the floor's height bends.

    In the middle of each cell that a line crosses, it is at the height of the cell's floor. Between
    cells whose floors differ by more than any slope, it rises vertically: at the cells' common
    edge, or at the middle of a link. Points within `FLOOR_TOLERANCE` of the line through the
    remaining ones are dropped. Arguments and results are described in `lay_route`.
    """
    num_points = points.shape[0]
    line_points = np.empty((4 * num_points + 16, 3))
    line_levels = np.empty(4 * num_points + 16, np.int64)
    line_link_end_indices = np.zeros(4 * num_points + 16, np.int64)
    num_line_points = 0
    for i in range(num_points):
        level = levels[i]
        start_in_cells = to_cell_units(layout, level, points[i, 0], points[i, 1])
        end_in_cells = start_in_cells
        leg_vector = np.zeros(2)
        if i + 1 < num_points and not link_end_indices[i]:
            end_in_cells = to_cell_units(layout, level, points[i + 1, 0], points[i + 1, 1])
            leg_vector = points[i + 1] - points[i]
        profile = _floor_profile(start_in_cells, end_in_cells, level, layout, floors)
        profile_index = 0
        while profile_index == 0 or profile_index < profile.shape[0] - 1:
            if num_line_points + 3 > line_points.shape[0]:
                line_points = np.concatenate((line_points, line_points))
                line_levels = np.concatenate((line_levels, line_levels))
                line_link_end_indices = np.concatenate(
                    (line_link_end_indices, np.zeros_like(line_link_end_indices))
                )
            for axis in range(2):
                line_points[num_line_points, axis] = (
                    points[i, axis] + profile[profile_index, 0] * leg_vector[axis]
                )
            line_points[num_line_points, 2] = profile[profile_index, 1]
            line_levels[num_line_points] = level
            num_line_points += 1
            profile_index = _next_bend(profile, profile_index)
        if i + 1 < num_points and link_end_indices[i]:
            line_link_end_indices[num_line_points - 1] = link_end_indices[i]
            next_level = levels[i + 1]
            next_in_cells = to_cell_units(layout, next_level, points[i + 1, 0], points[i + 1, 1])
            z = floor_at(floors, next_level, cell_at(layout, next_level, next_in_cells))
            if abs(z - line_points[num_line_points - 1, 2]) > layout.cell_size[level] * STEEP_RISE:
                for axis in range(2):
                    middle_coordinate = (points[i, axis] + points[i + 1, axis]) / 2.0
                    line_points[num_line_points, axis] = middle_coordinate
                    line_points[num_line_points + 1, axis] = middle_coordinate
                line_points[num_line_points, 2] = line_points[num_line_points - 1, 2]
                line_points[num_line_points + 1, 2] = z
                line_levels[num_line_points] = level
                line_levels[num_line_points + 1] = next_level
                line_link_end_indices[num_line_points] = link_end_indices[i]
                line_link_end_indices[num_line_points + 1] = link_end_indices[i]
                num_line_points += 2
    return (
        line_points[:num_line_points].copy(),
        line_levels[:num_line_points].copy(),
        line_link_end_indices[:num_line_points].copy(),
    )


@subkernel
def _floor_profile(start, end, level, layout, floors):
    """Compute the height of the floor along a line.

    `start` and `end` are u, v. Returns fractions of the line's length, ascending, and floor z there
    [m], shape (n, 2).
    """
    cells, entry_fractions = find_crossed_cells(start, end, layout, level)
    last_index = cells.shape[0] - 1
    # an end that lies on an edge may be crossed in the neighbour of its cell
    cells[last_index] = cell_at(layout, level, end)
    cells[0] = cell_at(layout, level, start)
    profile = np.empty((3 * last_index + 4, 2))
    num_points = 0
    z_before = 0.0
    for k in range(last_index + 1):
        z = floor_at(floors, level, cells[k])
        if k > 0 and abs(z - z_before) > layout.cell_size[level] * STEEP_RISE:
            profile[num_points, 0] = entry_fractions[k]
            profile[num_points, 1] = z_before
            profile[num_points + 1, 0] = entry_fractions[k]
            profile[num_points + 1, 1] = z
            num_points += 2
        fraction = (
            (entry_fractions[k] + entry_fractions[k + 1]) / 2.0
            if 0 < k < last_index
            else min(k, 1.0)
        )
        profile[num_points, 0] = fraction
        profile[num_points, 1] = z
        num_points = num_points + 1
        z_before = z
    if last_index == 0 and (start[0] != end[0] or start[1] != end[1]):
        profile[num_points, 0] = 1.0
        profile[num_points, 1] = z_before
        num_points += 1
    return profile[:num_points]


@subkernel
def cell_at(layout, level, point):
    """Compute the flat id of the cell that a point (u, v) is in."""
    return layout.start[level] + math.floor(point[1]) * layout.width[level] + math.floor(point[0])


@subkernel
def _next_bend(profile, current_index):
    """Find how far a straight line from point `current_index` of a profile can follow the profile.

    The line is within `FLOOR_TOLERANCE` of all points that it skips: its slope is in the range that
    each of them allows (cone intersection, Sklansky and Gonzalez 1980).

    Returns:
        The index of the line's end in `profile`; the next point if the line can skip none.
    """
    min_slope = -np.inf
    max_slope = np.inf
    for candidate_index in range(current_index + 1, profile.shape[0]):
        advance = profile[candidate_index, 0] - profile[current_index, 0]
        rise = profile[candidate_index, 1] - profile[current_index, 1]
        if advance <= 0.0 or not min_slope <= rise / advance <= max_slope:
            return max(candidate_index - 1, current_index + 1)
        min_slope = max(min_slope, (rise - FLOOR_TOLERANCE) / advance)
        max_slope = min(max_slope, (rise + FLOOR_TOLERANCE) / advance)
    return max(profile.shape[0] - 1, current_index + 1)
