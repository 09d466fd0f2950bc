"""Straight lines over a level: what they touch, what a disc meets along them, what they cost.

Ends of lines are pairs u, v in the level's own units, columns and rows: cell (row, col) is the
square from (col, row) to (col + 1, row + 1).

`is_walkable` is a supercover line, row by row: all cells that meet the line count, also those that
it only touches.

`disc_passes` sweeps a disc over squares, exactly, with one look at each row of cells. What the disc
covers on its way (a capsule) is convex. So it meets the cells of one row in a single interval of
columns, whose ends have a closed form, and running sums say whether any of these cells is solid.

`lay_route` pulls a route straight by line of sight: from each point, the farthest point that a
straight line can reach is kept, found by doubling the distance and then halving it (exponential
search, Bentley and Yao 1976). A funnel could not say what a line costs where weights differ.
"""

import math

import numpy as np

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import EAST, SOUTH, center, floor_at, in_cells, level_of

TOUCH = 1e-9  # of a cell: what is this near a line is touched; of a radius: what a disc is over
STEEP = 1.001  # rise, in cells, over which neighbours are a step, not a slope
IN_LINE = 1e-9  # metres that a point of a straight line may be off it
SAME = 1e-9  # metres between two points that are one
BEND = 1e-3  # metres that a line may be off the height of the floor in the middle of a cell
GAIN = 1e-9  # share of its cost by which rounding may make a straight line dearer


@subkernel
def is_walkable(a, b, layout, level, moves, anywhere):
    """Whether an agent may be anywhere in all cells that a line touches, and step between them.

    A line touches a cell where it meets the cell's closed square: over a corner, all four.
    """
    u0, v0 = a
    u1, v1 = b
    first = layout.start[level]
    width = layout.width[level]
    top = math.floor(min(v0, v1) - TOUCH)
    bottom = math.floor(max(v0, v1) + TOUCH)
    if top < 0 or bottom >= layout.height[level]:
        return False
    # columns touched in the row before
    above0 = 0
    above1 = -1
    for row in range(top, bottom + 1):
        low = min(u0, u1)
        high = max(u0, u1)
        if v0 != v1:  # the part of the line in the row
            one = (row - TOUCH - v0) / (v1 - v0)
            other = (row + 1 + TOUCH - v0) / (v1 - v0)
            enter = min(max(min(one, other), 0.0), 1.0)
            leave = max(min(max(one, other), 1.0), 0.0)
            ua = u0 + enter * (u1 - u0)
            ub = u0 + leave * (u1 - u0)
            low = min(ua, ub)
            high = max(ua, ub)
        col0 = math.floor(low - TOUCH)
        col1 = math.floor(high + TOUCH)
        if col0 < 0 or col1 >= width:
            return False
        for col in range(col0, col1 + 1):
            cell = first + row * width + col
            if not anywhere[cell]:
                return False
            # each edge between two touched cells is one that the line may run along or cross
            if col < col1 and not moves[cell] & EAST:
                return False
            if above0 <= col <= above1 and not moves[cell - width] & SOUTH:
                return False
        above0 = col0
        above1 = col1
    return True


@subkernel
def crossed_cells(a, b, layout, level):
    """The cells that a line runs through, in order, and the share of it before each and the end.

    Cells that the line only touches at a corner are left out.
    """
    u0, v0 = a
    u1, v1 = b
    du = u1 - u0
    dv = v1 - v0
    row = math.floor(v0)
    col = math.floor(u0)
    most = abs(math.floor(u1) - col) + abs(math.floor(v1) - row) + 2
    cells = np.empty(most, np.int64)
    enter = np.zeros(most + 1)
    count = 0
    leave = 0.0
    while leave < 1.0:
        # where the line leaves the cell, over an edge or at its end
        to_u = (col + (du > 0.0) - u0) / du if du != 0.0 else np.inf
        to_v = (row + (dv > 0.0) - v0) / dv if dv != 0.0 else np.inf
        leave = min(to_u, to_v, 1.0)
        if leave - enter[count] > 1e-12 or (leave >= 1.0 and count == 0):
            r = min(max(row, 0), layout.height[level] - 1)
            c = min(max(col, 0), layout.width[level] - 1)
            cells[count] = layout.start[level] + r * layout.width[level] + c
            count += 1
            enter[count] = leave
        if to_u <= to_v:
            col += 1 if du > 0.0 else -1
        else:
            row += 1 if dv > 0.0 else -1
    enter[count] = 1.0
    return cells[:count], enter[: count + 1]


@subkernel
def line_cost(a, b, level, graph):
    """The length in cells of a line between points x, y, each part times its cell's weight."""
    start = in_cells(graph.layout, level, a[0], a[1])
    end = in_cells(graph.layout, level, b[0], b[1])
    cells, enter = crossed_cells(start, end, graph.layout, level)
    total = 0.0
    for k in range(cells.shape[0]):
        total += (enter[k + 1] - enter[k]) * graph.weight[cells[k]]
    return total * math.hypot(end[0] - start[0], end[1] - start[1])


@subkernel
def disc_passes(a, b, layout, level, solid_before, radius, is_closed):
    """Whether an open disc, radius in cells, meets no solid square on its way along a line.

    `solid_before` and `is_closed`: see `navbake.runtime.grid_arrays.OffCenter`.
    """
    u0, v0 = a
    u1, v1 = b
    rows = layout.height[level]
    cols = layout.width[level]
    reach = radius * (1.0 - TOUCH)
    first_v = min(v0, v1) - reach
    last_v = max(v0, v1) + reach
    for row in range(math.floor(first_v), math.ceil(last_v)):
        low = max(float(row), first_v)
        high = min(row + 1.0, last_v)
        left = -_farthest(-u0, v0, -u1, v1, low, high, reach)
        right = _farthest(u0, v0, u1, v1, low, high, reach)
        col0 = math.floor(left)
        col1 = math.ceil(right)
        is_beside = row < 0 or row >= rows
        if is_closed and (is_beside or col0 < 0 or col1 > cols):
            return False
        col0 = max(col0, 0)
        col1 = min(col1, cols)
        if is_beside or col0 >= col1:
            continue
        here = layout.start[level] + row * cols
        if solid_before[here + col1] > solid_before[here + col0]:
            return False
    return True


@subkernel
def _farthest(u0, v0, u1, v1, low, high, reach):
    """The largest u of a swept disc between two v that it reaches."""
    # Towards larger v the edge first moves out, up to the middle of the disc at the line's
    # farther end, and then back in. So the v nearest to that one has the largest u.
    peak = v1 if u1 > u0 else v0
    if u0 == u1:  # all along the line it is as far
        peak = min(max(low, min(v0, v1)), max(v0, v1))
    v = min(max(peak, low), high)
    du = u1 - u0
    dv = v1 - v0
    t = 1.0 if u1 > u0 else 0.0
    if dv != 0.0:
        # the disc that reaches the farthest at v touches the edge where its radius is upright on
        # the line, or else is the one at an end
        along = -math.copysign(du, du * dv) if du != 0.0 else 0.0
        t = (v - reach * along / math.hypot(du, dv) - v0) / dv
        t = min(max(t, 0.0), 1.0)
    off = v - v0 - t * dv
    return u0 + t * du + math.sqrt(max(reach * reach - off * off, 0.0))


@kernel
def can_pass(a, b, level, graph, off_center):
    """Whether an agent can move along a line between two points x, y of a level [m].

    It may be anywhere in all cells that the line touches; or nothing but squares is near these, and
    its disc meets none.
    """
    layout = graph.layout
    moves = graph.moves
    start = in_cells(layout, level, a[0], a[1])
    end = in_cells(layout, level, b[0], b[1])
    if is_walkable(start, end, layout, level, moves, off_center.anywhere):
        return True
    if off_center.radius == 0.0:
        return False
    if not is_walkable(start, end, layout, level, moves, off_center.by_squares):
        return False
    radius = off_center.radius / layout.cell_size[level]
    before = off_center.solid_before
    is_closed = off_center.is_closed
    return disc_passes(start, end, layout, level, before, radius, is_closed)


@kernel
def lay_route(route, by_link, start, end, is_smooth, graph, floors, off_center):
    """Make a line along a route of cells: world x, y, floor z [m], (m, 3), and the level of each.

    `by_link` says which cells a link led to. Also returned is the place in `route` of the cell
    that the link leads to which is between a point and the next, 0 where none is, (m,).

    It runs through the cells' centres or, if smooth, straight on wherever `can_pass` allows it and
    the cost is no higher. It begins and ends at `start` and `end`, x, y in the first and last cell;
    at the cell's centre where they are NaN, or where obstacles are too near.
    """
    layout = graph.layout
    num = route.shape[0]
    points = np.empty((num + 2, 2))
    levels = np.empty(num + 2, np.int64)
    # the place of the cell that a link leads to from a point to the next, 0 for none
    is_link = np.zeros(num + 1, np.int64)
    for i in range(num):
        levels[i + 1] = level_of(layout.start, route[i])
        points[i + 1, 0], points[i + 1, 1] = center(layout, route[i])
        is_link[i] = i if by_link[i] else 0
    levels[0], levels[num + 1] = levels[1], levels[num]
    kept = np.ones(num + 2, np.bool_)
    for at, beside, given in ((0, 1, start), (num + 1, num, end)):
        points[at, 0] = given[0]
        points[at, 1] = given[1]
        # False for NaN
        is_apart = max(abs(given[0] - points[beside, 0]), abs(given[1] - points[beside, 1])) > SAME
        kept[at] = is_apart and can_pass(
            points[min(at, beside)], points[max(at, beside)], levels[at], graph, off_center
        )
    first = 1 - kept[0]
    last = num + 1 + kept[num + 1]
    points = points[first:last]
    levels = levels[first:last]
    is_link = is_link[first : last - 1]
    if is_smooth:
        some = np.flatnonzero(_pull_string(points, levels, is_link, graph, off_center))
        points = points[some]
        levels = levels[some]
        is_link = is_link[some[:-1]]
    return _lay_on_floor(points, levels, is_link, layout, floors)


@subkernel
def _pull_string(points, levels, is_link, graph, off_center):
    """Mark the few points of a route whose connecting lines stay free, see `can_pass`.

    A straight line never costs more than what it replaces, and never runs over a link.
    """
    num = points.shape[0]
    spent = np.zeros(num)  # cost of the route up to each point
    if graph.same_weight <= 0.0:
        for i in range(1, num):
            spent[i] = spent[i - 1]
            if not is_link[i - 1]:
                spent[i] += line_cost(points[i - 1], points[i], levels[i], graph)
    here = 0
    kept = np.zeros(num, np.bool_)
    kept[0] = True
    while here < num - 1:
        last = here + 1  # before the next link
        while last < num - 1 and not is_link[here] and not is_link[last]:
            last += 1
        # `good` can be reached, `bad` can't. Sight is not monotonous, so the point found need not
        # be the very farthest.
        good = here + 1
        bad = last + 1
        reach = 2
        while bad - good > 1:
            there = min(here + reach, last) if bad > last else (good + bad) // 2
            a = points[here]
            b = points[there]
            level = levels[here]
            if can_pass(a, b, level, graph, off_center) and (
                graph.same_weight > 0.0
                or line_cost(a, b, level, graph) <= (spent[there] - spent[here]) * (1.0 + GAIN)
            ):
                good = there
            else:
                bad = there
            reach *= 2
        here = good
        kept[here] = True
    # points on the straight line between those before and after go, but for ends of links
    before = 0
    here = -1
    for after in range(1, num):
        if not kept[after]:
            continue
        if here >= 0:
            way = points[after] - points[before]
            part = points[here] - points[before]
            length = math.hypot(way[0], way[1])
            off = abs(way[0] * part[1] - way[1] * part[0])
            share = way[0] * part[0] + way[1] * part[1]
            is_end = is_link[here - 1] or is_link[here]
            if is_end or off > IN_LINE * length or not 0.0 <= share <= length * length:
                before = here
            else:
                kept[here] = False
        here = after
    return kept


@subkernel
def _lay_on_floor(points, levels, is_link, layout, floors):
    """Lay lines between points on the floor: with points in between where its height bends.

    The line runs through the middle of its part in each cell that it crosses, at the cell's
    floor; between two that are steeper than any slope, straight up or down at their edge, or
    halfway over a link. Points within BEND of the line through the remaining ones are dropped.
    """
    num = points.shape[0]
    out = np.empty((4 * num + 16, 3))
    on = np.empty(4 * num + 16, np.int64)
    count = 0
    by = np.zeros(4 * num + 16, np.int64)
    for i in range(num):
        level = levels[i]
        start = in_cells(layout, level, points[i, 0], points[i, 1])
        end = start
        way = np.zeros(2)
        if i + 1 < num and not is_link[i]:
            end = in_cells(layout, level, points[i + 1, 0], points[i + 1, 1])
            way = points[i + 1] - points[i]
        profile = _profile(start, end, level, layout, floors)
        here = 0
        while here == 0 or here < profile.shape[0] - 1:
            if count + 3 > out.shape[0]:
                out = np.concatenate((out, out))
                on = np.concatenate((on, on))
                by = np.concatenate((by, np.zeros_like(by)))
            for axis in range(2):
                out[count, axis] = points[i, axis] + profile[here, 0] * way[axis]
            out[count, 2] = profile[here, 1]
            on[count] = level
            count += 1
            here = _next_bend(profile, here)
        if i + 1 < num and is_link[i]:
            by[count - 1] = is_link[i]
            after = levels[i + 1]
            there = in_cells(layout, after, points[i + 1, 0], points[i + 1, 1])
            z = floor_at(floors, after, _cell_of(layout, after, there))
            if abs(z - out[count - 1, 2]) > layout.cell_size[level] * STEEP:
                for axis in range(2):
                    middle = (points[i, axis] + points[i + 1, axis]) / 2.0
                    out[count, axis] = middle
                    out[count + 1, axis] = middle
                out[count, 2] = out[count - 1, 2]
                out[count + 1, 2] = z
                on[count] = level
                on[count + 1] = after
                by[count] = is_link[i]
                by[count + 1] = is_link[i]
                count += 2
    return out[:count].copy(), on[:count].copy(), by[:count].copy()


@subkernel
def _profile(a, b, level, layout, floors):
    """The floor under a line, its ends in cells: shares of it and heights there, (n, 2)."""
    cells, enter = crossed_cells(a, b, layout, level)
    last = cells.shape[0] - 1
    # ends on edges are in the cells they were found in
    cells[last] = _cell_of(layout, level, b)
    cells[0] = _cell_of(layout, level, a)
    line = np.empty((3 * last + 4, 2))
    count = 0
    before = 0.0
    for k in range(last + 1):
        z = floor_at(floors, level, cells[k])
        if k > 0 and abs(z - before) > layout.cell_size[level] * STEEP:
            line[count, 0] = enter[k]
            line[count, 1] = before
            line[count + 1, 0] = enter[k]
            line[count + 1, 1] = z
            count += 2
        share = (enter[k] + enter[k + 1]) / 2.0 if 0 < k < last else min(k, 1.0)
        line[count, 0] = share
        line[count, 1] = z
        count = count + 1
        before = z
    if last == 0 and (a[0] != b[0] or a[1] != b[1]):
        line[count, 0] = 1.0
        line[count, 1] = before
        count += 1
    return line[:count]


@subkernel
def _cell_of(layout, level, point):
    return layout.start[level] + math.floor(point[1]) * layout.width[level] + math.floor(point[0])


@subkernel
def _next_bend(profile, here):
    """The last point to whose straight line all points before it are near enough.

    Its slope from `here` is in the ranges of slopes that each of these allows (cone intersection,
    Sklansky and Gonzalez 1980).
    """
    low = -np.inf
    high = np.inf
    for there in range(here + 1, profile.shape[0]):
        run = profile[there, 0] - profile[here, 0]
        rise = profile[there, 1] - profile[here, 1]
        if run <= 0.0 or not low <= rise / run <= high:
            return max(there - 1, here + 1)
        low = max(low, (rise - BEND) / run)
        high = min(high, (rise + BEND) / run)
    return max(profile.shape[0] - 1, here + 1)
