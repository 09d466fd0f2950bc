"""Pulls a route over cells straight."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from navbake.runtime.kernels.sight import crossed_cells, is_walkable, line_cost

STEEP = 1.001  # rise, in cells, over which neighbours are a step, not a slope
GAIN = 1e-9  # share of its cost by which rounding may make a straight line dearer


@njit(cache=True, error_model="numpy")
def _in_cells(point, level, x_min, y_max, cell_size):
    size = cell_size[level]
    return (point[0] - x_min[level]) / size, (y_max[level] - point[1]) / size


@njit(cache=True, error_model="numpy")
def can_pass(a, b, level, moves, roomy, start, width, height, x_min, y_max, cell_size):
    """Whether a straight line between two points of a level stays free.

    Args:
        a, b: world x, y [m].
        level: the level of both.
        moves, roomy: by flat id, see `navbake.runtime.kernels.sight.is_walkable`.
        start, width, height, x_min, y_max, cell_size: of the levels, see
            `navbake.runtime.flat_grid.Walk`.
    """
    u0, v0 = _in_cells(a, level, x_min, y_max, cell_size)
    u1, v1 = _in_cells(b, level, x_min, y_max, cell_size)
    place = (start[level], width[level], height[level])
    return is_walkable(u0, v0, u1, v1, moves, roomy, *place)


@njit(cache=True, error_model="numpy")
def pull_string(
    points, levels, is_link, kept, moves, roomy, weight, same_weight,
    start, width, height, x_min, y_max, cell_size,
):  # fmt: skip
    """Choose the points of a route that straight lines between them can do with.

    From each point, the line to the farthest point that it can pass to is taken, as doubling and
    then halving the distance finds it. A line never costs more than what it replaces, each part
    counted by the weight of its cell, and never runs over a link.

    Args:
        points: of the route, world x, y [m], shape (n, 2), each in a free cell.
        levels: of the points, shape (n,).
        is_link: whether a link leads from a point to the next, shape (n - 1,), bool.
        kept: (n,) bool, receives which points to keep.
        moves, roomy: as of `can_pass`.
        weight: by flat id.
        same_weight: the weight of all free cells, or 0 where they differ.
        start, width, height, x_min, y_max, cell_size: of the levels.
    """
    num = points.shape[0]
    spent = np.zeros(num)  # cost of the route up to each point
    if same_weight <= 0.0:
        for i in range(1, num):
            spent[i] = spent[i - 1]
            level = levels[i]
            if not is_link[i - 1]:
                u0, v0 = _in_cells(points[i - 1], level, x_min, y_max, cell_size)
                u1, v1 = _in_cells(points[i], level, x_min, y_max, cell_size)
                place = (start[level], width[level], height[level])
                spent[i] += line_cost(u0, v0, u1, v1, weight, *place)
    here = 0
    kept[:] = False
    kept[0] = True
    while here < num - 1:
        last = here + 1  # before the next link
        while last < num - 1 and not is_link[here] and not is_link[last]:
            last += 1
        good, bad, reach = here + 1, last + 1, 2
        while good < last and bad > last:
            there = min(here + reach, last)
            if _is_shortcut(
                here, there, points, levels[here], spent, moves, roomy, weight,
                same_weight, start, width, height, x_min, y_max, cell_size,
            ):  # fmt: skip
                good = there
            else:
                bad = there
            reach *= 2
        while bad - good > 1:
            there = (good + bad) // 2
            if _is_shortcut(
                here, there, points, levels[here], spent, moves, roomy, weight,
                same_weight, start, width, height, x_min, y_max, cell_size,
            ):  # fmt: skip
                good = there
            else:
                bad = there
        here = good
        kept[here] = True


@njit(cache=True, error_model="numpy")
def _is_shortcut(
    a, b, points, level, spent, moves, roomy, weight, same_weight,
    start, width, height, x_min, y_max, cell_size,
):  # fmt: skip
    if not can_pass(
        points[a], points[b], level, moves, roomy, start, width, height, x_min,
        y_max, cell_size,
    ):  # fmt: skip
        return False
    if same_weight > 0.0:
        return True
    u0, v0 = _in_cells(points[a], level, x_min, y_max, cell_size)
    u1, v1 = _in_cells(points[b], level, x_min, y_max, cell_size)
    place = (start[level], width[level], height[level])
    cost = line_cost(u0, v0, u1, v1, weight, *place)
    return cost <= (spent[b] - spent[a]) * (1.0 + GAIN)


@njit(cache=True, error_model="numpy")
def lay_on_floor(
    points, levels, is_link, floor, ground, start, width, height, x_min, y_max, cell_size,
    tolerance,
):  # fmt: skip
    """Lay lines between points on the floor: with points in between where its height bends.

    The line runs through the middle of its part in each cell that it crosses, at the cell's
    floor; between two that differ by more than a cell is wide, which is steeper than any slope,
    straight up or down at their edge, or halfway over a link. Points that are within `tolerance`
    of the line through those that are left go.

    Args:
        points: world x, y [m], shape (n, 2).
        levels: of the points, shape (n,).
        is_link: whether a link leads from a point to the next, shape (n - 1,), bool.
        floor: by flat id [m], NaN where there is none: there it is `ground`, by level.
        start, width, height, x_min, y_max, cell_size: of the levels.
        tolerance: [m].

    Returns:
        World x, y, z [m], shape (m, 3), float64, and the level of each, int64.
    """
    num = points.shape[0]
    out, on, count = np.empty((4 * num + 16, 3)), np.empty(4 * num + 16, np.int64), 0
    for i in range(num):
        level = levels[i]
        place = (start[level], width[level], height[level])
        u0, v0 = _in_cells(points[i], level, x_min, y_max, cell_size)
        u1, v1 = u0, v0
        way = np.zeros(2)
        if i + 1 < num and not is_link[i]:
            u1, v1 = _in_cells(points[i + 1], level, x_min, y_max, cell_size)
            way = points[i + 1] - points[i]
        line = _profile(u0, v0, u1, v1, floor, ground[level], *place, cell_size[level])
        here = 0
        while here == 0 or here < line.shape[0] - 1:
            if count + 3 > out.shape[0]:
                out, on = np.concatenate((out, out)), np.concatenate((on, on))
            out[count, :2] = points[i] + line[here, 0] * way
            out[count, 2], on[count] = line[here, 1], level
            count += 1
            here = _next_bend(line, here, tolerance)
        if i + 1 < num and is_link[i]:
            after = levels[i + 1]
            u1, v1 = _in_cells(points[i + 1], after, x_min, y_max, cell_size)
            z = _height(u1, v1, floor, ground[after], start[after], width[after])
            if abs(z - out[count - 1, 2]) > cell_size[level] * STEEP:
                out[count : count + 2, :2] = (points[i] + points[i + 1]) / 2.0
                out[count, 2], out[count + 1, 2] = out[count - 1, 2], z
                on[count], on[count + 1] = level, after
                count += 2
    return out[:count].copy(), on[:count].copy()


@njit(cache=True, error_model="numpy")
def _profile(u0, v0, u1, v1, floor, ground, first, width, height, steep):
    """The floor under a line: shares of it, and heights there, (n, 2) float64."""
    cells, enter = crossed_cells(u0, v0, u1, v1, width, height)
    cells[0] = math.floor(v0) * width + math.floor(u0)
    line = np.empty((3 * cells.shape[0] + 1, 2))
    count, before = 0, 0.0
    for k in range(cells.shape[0]):
        if k == cells.shape[0] - 1 and k > 0:
            cells[k] = math.floor(v1) * width + math.floor(u1)
        z = floor[first + cells[k]]
        if math.isnan(z):
            z = ground
        if k > 0 and abs(z - before) > steep * STEEP:
            line[count, 0], line[count, 1] = enter[k], before
            line[count + 1, 0], line[count + 1, 1] = enter[k], z
            count += 2
        share = (enter[k] + enter[k + 1]) / 2.0
        if k == 0:
            share = 0.0
        elif k == cells.shape[0] - 1:
            share = 1.0
        line[count, 0], line[count, 1] = share, z
        count += 1
        before = z
    if cells.shape[0] == 1 and (u0 != u1 or v0 != v1):
        line[count, 0], line[count, 1] = 1.0, before
        count += 1
    return line[:count]


@njit(cache=True, error_model="numpy")
def _height(u, v, floor, ground, first, width):
    z = floor[first + math.floor(v) * width + math.floor(u)]
    return ground if math.isnan(z) else z


@njit(cache=True, error_model="numpy")
def _next_bend(line, here, tolerance):
    """The last point to which all in between are within a tolerance of a straight line."""
    low, high = -np.inf, np.inf  # slopes that keep all points so far
    for there in range(here + 1, line.shape[0]):
        run, rise = line[there, 0] - line[here, 0], line[there, 1] - line[here, 1]
        if run <= 0.0 or not low <= rise / run <= high:
            return max(there - 1, here + 1)
        low = max(low, (rise - tolerance) / run)
        high = min(high, (rise + tolerance) / run)
    return max(line.shape[0] - 1, here + 1)
