"""Pulls a route over cells straight, and lays it on the floor.

String pulling by line of sight: from each point, the farthest point that a straight line can
reach is kept. The farthest is found by doubling the distance and then halving it (exponential
search, Bentley and Yao 1976), so that few lines have to be looked at. A funnel (Lee and Preparata
1984) would need a corridor of portals, and could not tell what a line costs where weights differ.
"""

import math

import numpy as np

from navbake.compiled import kernel, part
from navbake.runtime.kernels.arrays import in_cells, rect_of
from navbake.runtime.kernels.sight import crossed_cells, is_walkable, line_cost
from navbake.runtime.kernels.sweep import disc_passes

STEEP = 1.001  # rise, in cells, over which neighbours are a step, not a slope
IN_LINE = 1e-9  # metres that a point of a straight line may be off it
GAIN = 1e-9  # share of its cost by which rounding may make a straight line dearer


@kernel
def can_pass(a, b, level, graph, off_center):
    """Whether an agent can move along a line between two points x, y of a level [m].

    It can where it may be anywhere in all cells that the line touches, or where these are free,
    nothing but squares is near, and its disc meets none of them; see `is_walkable`.
    """
    start = in_cells(graph.layout, level, a[0], a[1])
    end = in_cells(graph.layout, level, b[0], b[1])
    rect, moves = rect_of(graph.layout, level), graph.moves
    if is_walkable(start, end, rect, moves, off_center.anywhere):
        return True
    if off_center.radius == 0.0:
        return False
    if not is_walkable(start, end, rect, moves, off_center.by_squares):
        return False
    radius = off_center.radius / graph.layout.cell_size[level]
    before, is_closed = off_center.solid_before, off_center.is_closed
    return disc_passes(start, end, rect, before, radius, is_closed)


@kernel
def pull_string(line, graph, off_center):
    """Mark the few points of a route whose connecting lines stay free, see `can_pass`.

    A straight line never costs more than what it replaces, each part counted by the weight of its
    cell, and never runs over a link.
    """
    num = line.points.shape[0]
    spent = np.zeros(num)  # cost of the route up to each point
    if graph.same_weight <= 0.0:
        for i in range(1, num):
            spent[i] = spent[i - 1]
            if not line.is_link[i - 1]:
                spent[i] += _cost(line.points[i - 1], line.points[i], line.levels[i], graph)
    here = 0
    kept = np.zeros(num, np.bool_)
    kept[0] = True
    while here < num - 1:
        last = here + 1  # before the next link
        while last < num - 1 and not line.is_link[here] and not line.is_link[last]:
            last += 1
        # `good` can be reached, `bad` can't: doubling until a line fails moves them apart, halving
        # brings them together. Sight is not monotonous, so the point found need not be the very
        # farthest.
        good, bad, reach = here + 1, last + 1, 2
        while bad - good > 1:
            there = min(here + reach, last) if bad > last else (good + bad) // 2
            if _is_shortcut(here, there, line, spent, graph, off_center):
                good = there
            else:
                bad = there
            reach *= 2
        here = good
        kept[here] = True
    _merge_in_line(line, kept)
    return kept


@part
def _merge_in_line(line, kept):
    """Unmark points on the straight line between those before and after, but for ends of links."""
    points, num = line.points, line.points.shape[0]
    before, here = 0, -1
    for after in range(1, num):
        if not kept[after]:
            continue
        if here >= 0:
            way, part = points[after] - points[before], points[here] - points[before]
            length = math.hypot(way[0], way[1])
            off = abs(way[0] * part[1] - way[1] * part[0])
            share = way[0] * part[0] + way[1] * part[1]
            is_end = line.is_link[here - 1] or line.is_link[here]
            if is_end or off > IN_LINE * length or not 0.0 <= share <= length * length:
                before = here
            else:
                kept[here] = False
        here = after


@part
def _cost(a, b, level, graph):
    """What a straight line between two points of a level costs, its length in cells."""
    start = in_cells(graph.layout, level, a[0], a[1])
    end = in_cells(graph.layout, level, b[0], b[1])
    return line_cost(start, end, rect_of(graph.layout, level), graph.weight)


@part
def _is_shortcut(i, j, line, spent, graph, off_center):
    """Whether the straight line between two points of a route is free and no dearer."""
    a, b, level = line.points[i], line.points[j], line.levels[i]
    if not can_pass(a, b, level, graph, off_center):
        return False
    if graph.same_weight > 0.0:
        return True
    return _cost(a, b, level, graph) <= (spent[j] - spent[i]) * (1.0 + GAIN)


@kernel
def lay_on_floor(line, layout, floors, tolerance):
    """Lay lines between points on the floor: with points in between where its height bends.

    The line runs through the middle of its part in each cell that it crosses, at the cell's
    floor; between two that differ by more than a cell is wide, which is steeper than any slope,
    straight up or down at their edge, or halfway over a link. Points within `tolerance` [m] of
    the line through the remaining ones are dropped. Returns world x, y, z [m], and the levels.
    """
    points, num = line.points, line.points.shape[0]
    out, on, count = np.empty((4 * num + 16, 3)), np.empty(4 * num + 16, np.int64), 0
    for i in range(num):
        level = line.levels[i]
        start = in_cells(layout, level, points[i, 0], points[i, 1])
        end, way = start, np.zeros(2)
        if i + 1 < num and not line.is_link[i]:
            end = in_cells(layout, level, points[i + 1, 0], points[i + 1, 1])
            way = points[i + 1] - points[i]
        profile = _profile(start, end, level, layout, floors)
        here = 0
        while here == 0 or here < profile.shape[0] - 1:
            if count + 3 > out.shape[0]:
                out, on = np.concatenate((out, out)), np.concatenate((on, on))
            for axis in range(2):
                out[count, axis] = points[i, axis] + profile[here, 0] * way[axis]
            out[count, 2], on[count] = profile[here, 1], level
            count += 1
            here = _next_bend(profile, here, tolerance)
        if i + 1 < num and line.is_link[i]:
            after = line.levels[i + 1]
            u, v = in_cells(layout, after, points[i + 1, 0], points[i + 1, 1])
            z = _height(_cell_of(u, v, rect_of(layout, after)), after, floors)
            if abs(z - out[count - 1, 2]) > layout.cell_size[level] * STEEP:
                for axis in range(2):
                    middle = (points[i, axis] + points[i + 1, axis]) / 2.0
                    out[count, axis], out[count + 1, axis] = middle, middle
                out[count, 2], out[count + 1, 2] = out[count - 1, 2], z
                on[count], on[count + 1] = level, after
                count += 2
    return out[:count].copy(), on[:count].copy()


@part
def _profile(a, b, level, layout, floors):
    """The floor under a line, its ends in cells: shares of it and heights there, (n, 2)."""
    rect = rect_of(layout, level)
    cells, enter = crossed_cells(a, b, rect)
    last = cells.shape[0] - 1
    cells[last] = _cell_of(b[0], b[1], rect)  # ends on edges are in the cells they were found in
    cells[0] = _cell_of(a[0], a[1], rect)
    line = np.empty((3 * last + 4, 2))
    count, before = 0, 0.0
    for k in range(last + 1):
        z = _height(cells[k], level, floors)
        if k > 0 and abs(z - before) > layout.cell_size[level] * STEEP:
            line[count, 0], line[count, 1] = enter[k], before
            line[count + 1, 0], line[count + 1, 1] = enter[k], z
            count += 2
        share = (enter[k] + enter[k + 1]) / 2.0 if 0 < k < last else min(k, 1.0)
        line[count, 0], line[count, 1] = share, z
        count, before = count + 1, z
    if last == 0 and (a[0] != b[0] or a[1] != b[1]):
        line[count, 0], line[count, 1] = 1.0, before
        count += 1
    return line[:count]


@part
def _cell_of(u, v, rect):
    return rect.first + math.floor(v) * rect.width + math.floor(u)


@part
def _height(cell, level, floors):
    z = floors.z[cell]
    return floors.ground[level] if math.isnan(z) else z


@part
def _next_bend(profile, here, tolerance):
    """The last point to whose straight line all points before it are near enough.

    Each point allows a range of slopes from `here`; as long as the next point's slope is in the
    ranges of all before it, the line to it passes them all closely enough (cone intersection,
    Sklansky and Gonzalez 1980).
    """
    low, high = -np.inf, np.inf
    for there in range(here + 1, profile.shape[0]):
        run, rise = profile[there, 0] - profile[here, 0], profile[there, 1] - profile[here, 1]
        if run <= 0.0 or not low <= rise / run <= high:
            return max(there - 1, here + 1)
        low = max(low, (rise - tolerance) / run)
        high = min(high, (rise + tolerance) / run)
    return max(profile.shape[0] - 1, here + 1)
