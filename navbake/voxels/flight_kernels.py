"""Flight of a ball through voxels: where it fits, what it sees, and its cheapest route.

A ball meets an occupied voxel where a point of the cube is nearer to its centre than its radius.

`find_flight` is A* (Hart, Nilsson and Raphael 1968) over the 26 neighbours of each voxel, and
without a goal Dijkstra's algorithm (1959). The cost that remains is estimated by the length of the
shortest way over 26 neighbours to the box round the goals, times the least cost of a metre, which
is never too much.

Both take voxels from buckets (Dial 1969): all whose cost plus estimate is nearly the same wait in
one bucket, in no order, which is several times as fast as a heap. A voxel that gets cheaper after
it was taken waits again, so costs are least all the same. In the open, very many routes cost the
same, but for rounding. The last voxel to come into a bucket is the first to be taken, which makes
the search go ahead along one of these routes; and once a goal is reached, voxels are left out whose
routes would be cheaper by less than `GREED`, a part in 10¹². The cost that is found is at most that
part too high.

`sees` marches along a straight line like sphere tracing (Hart 1996): where the distance field says
that nothing is near, it steps as far as is safe. Elsewhere it compares a short piece of the line
with each occupied voxel near it, exactly: the squared distance of a point that moves along a line
from a box is convex, and between the six places where the line crosses a face's plane it is a
parabola.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.compiled import kernel, subkernel
from navbake.types import Float, Int

FREE = 1 << 26  # bit of a voxel at whose centre the ball fits, after the bits of its 26 moves
CONTACT_TOLERANCE = 1e-9  # a voxel that reaches into the ball by less does not meet it [m]
GREED = 1e-12  # the part by which a route must be cheaper for the search to go on
BUCKET_SHARE = 0.05  # width of a bucket, relative to the least cost of a move
NOT_REACHED = -1
FROM_SOURCE = -2
SQRT_2 = math.sqrt(2.0)
SQRT_3 = math.sqrt(3.0)


class Air(NamedTuple):
    """The voxels that a ball flies through. Lengths are in metres.

    Attributes:
        distances: distance of each voxel's centre from the nearest occupied voxel, (nx, ny, nz); 0
            in occupied voxels.
        state: by voxel, (nx, ny, nz): bit m is set where the ball can move in direction m, and
            `FREE` where it fits.
        origin: world x, y, z of the lower corner of voxel (0, 0, 0), (3,).
        res: edge of a voxel.
        radius: radius of the ball.
        lower: lowest x, y and z that the ball's centre may have, (3,).
        upper: highest x, y and z that the ball's centre may have, (3,).
        cost_of_clearance: a metre at distance d from the nearest occupied voxel costs
            ``1 + cost_of_clearance / d``.
        least_weight: the least cost of a metre.
    """

    distances: Float
    state: NDArray[np.uint32]
    origin: Float
    res: float
    radius: float
    lower: Float
    upper: Float
    cost_of_clearance: float
    least_weight: float


class Moves(NamedTuple):
    """The straight moves from a voxel to its neighbours.

    Attributes:
        steps: voxels along x, y and z, (26, 3).
        lengths: lengths, (26,) [m].
        start: where each move's list in `between` begins, (27,).
        between: voxels, relative to the one that the move begins in, that the ball meets on its way
            if they are occupied, and at neither end: (n, 3).
    """

    steps: Int
    lengths: Float
    start: Int
    between: Int


@subkernel
def _squared_distance_of_line(begin, step, lower_corner, res):
    """Compute the least squared distance of a piece of a line from a voxel, exactly.

    Args:
        begin: beginning of the piece, (3,).
        step: from its beginning to its end, (3,).
        lower_corner: lower corner of the voxel, (3,).
        res: edge of the voxel.
    """
    # the derivative never falls: look for its zero between the crossings of faces next to it
    low = 0.0
    high = 1.0
    for axis in range(3):
        if step[axis] == 0.0:
            continue
        for side in range(2):
            crossing = (lower_corner[axis] + side * res - begin[axis]) / step[axis]
            if low < crossing < high:
                if _slope_of_distance(begin, step, lower_corner, res, crossing) < 0.0:
                    low = crossing
                else:
                    high = crossing
    slope_low = _slope_of_distance(begin, step, lower_corner, res, low)
    slope_high = _slope_of_distance(begin, step, lower_corner, res, high)
    if slope_low >= 0.0:
        nearest = low
    elif slope_high <= 0.0:
        nearest = high
    else:
        nearest = low - slope_low * (high - low) / (slope_high - slope_low)
    squared = 0.0
    for axis in range(3):
        place = begin[axis] + nearest * step[axis] - lower_corner[axis]
        excess = max(-place, place - res, 0.0)
        squared += excess * excess
    return squared


@subkernel
def _slope_of_distance(begin, step, lower_corner, res, share):
    """Compute half the derivative of the squared distance from a voxel along a piece of a line."""
    slope = 0.0
    for axis in range(3):
        place = begin[axis] + share * step[axis] - lower_corner[axis]
        if place < 0.0:
            slope += place * step[axis]
        elif place > res:
            slope += (place - res) * step[axis]
    return slope


@kernel
def list_between(step, radius, res):
    """List the voxels that a ball meets on its way to a neighbour, and neither before nor after it.

    Args:
        step: voxels along x, y and z that the neighbour is away, (3,), float64.
        radius: radius of the ball [m].
        res: edge of a voxel [m].

    Returns:
        Voxels relative to the one in which the ball begins, (n, 3), int64.
    """
    reach = math.ceil(radius / res) + 2
    squared_reach = (radius - CONTACT_TOLERANCE) ** 2
    begin = np.zeros(3)
    end = step * res
    no_step = np.zeros(3)
    corner = np.empty(3)
    between = np.empty((16, 3), np.int64)
    count = 0
    for x in range(-reach, reach + 1):
        for y in range(-reach, reach + 1):
            for z in range(-reach, reach + 1):
                corner[0] = (x - 0.5) * res
                corner[1] = (y - 0.5) * res
                corner[2] = (z - 0.5) * res
                if (
                    _squared_distance_of_line(begin, end, corner, res) < squared_reach
                    and _squared_distance_of_line(begin, no_step, corner, res) >= squared_reach
                    and _squared_distance_of_line(end, no_step, corner, res) >= squared_reach
                ):
                    if count == between.shape[0]:
                        between = np.concatenate((between, np.empty_like(between)))
                    between[count, 0] = x
                    between[count, 1] = y
                    between[count, 2] = z
                    count += 1
    return between[:count].copy()


@subkernel
def _voxel_of(air, axis, coordinate):
    """Return the index along an axis of the voxel at a coordinate, clamped to the grid."""
    index = math.floor((coordinate - air.origin[axis]) / air.res)
    return min(max(index, 0), air.distances.shape[axis] - 1)


@subkernel
def _clearance_of_piece(air, begin, step, corner, reach, enough):
    """Compute how near a short piece of a line comes to occupied voxels.

    Args:
        air: `Air`.
        begin: beginning of the piece, (3,).
        step: from its beginning to its end, (3,).
        corner: room for the corner of a voxel, (3,), written.
        reach: voxels that are farther away than this need not be looked at [m].
        enough: the search ends at a voxel that is nearer than this [m].

    Returns:
        The distance of the nearest voxel [m], or of one that is nearer than `enough`; `reach` if
        none is nearer.
    """
    first_x = _voxel_of(air, 0, min(begin[0], begin[0] + step[0]) - reach)
    first_y = _voxel_of(air, 1, min(begin[1], begin[1] + step[1]) - reach)
    first_z = _voxel_of(air, 2, min(begin[2], begin[2] + step[2]) - reach)
    last_x = _voxel_of(air, 0, max(begin[0], begin[0] + step[0]) + reach)
    last_y = _voxel_of(air, 1, max(begin[1], begin[1] + step[1]) + reach)
    last_z = _voxel_of(air, 2, max(begin[2], begin[2] + step[2]) + reach)
    least = reach * reach
    for x in range(first_x, last_x + 1):
        for y in range(first_y, last_y + 1):
            z = first_z
            while z <= last_z:
                distance = air.distances[x, y, z]
                if distance > 0.0:
                    # no voxel of this column is occupied before the distance is used up
                    z += max(int(min(distance / air.res, 1e6) + 0.5 - 1e-9), 1)
                    continue
                corner[0] = air.origin[0] + x * air.res
                corner[1] = air.origin[1] + y * air.res
                corner[2] = air.origin[2] + z * air.res
                squared = _squared_distance_of_line(begin, step, corner, air.res)
                if squared < least:
                    least = squared
                    if least < enough * enough:
                        return math.sqrt(least)
                z += 1
    return math.sqrt(least)


@subkernel
def _sees(air, begin, end, point, step, corner):
    """Whether the ball meets no occupied voxel on its straight way between two points.

    `point`, `step` and `corner` are room for three numbers each, written.
    """
    length = 0.0
    for axis in range(3):
        length += (end[axis] - begin[axis]) ** 2
        if min(begin[axis], end[axis]) < air.lower[axis] - CONTACT_TOLERANCE:
            return False
        if max(begin[axis], end[axis]) > air.upper[axis] + CONTACT_TOLERANCE:
            return False
    length = math.sqrt(length)
    least_clearance = air.radius - CONTACT_TOLERANCE
    done = 0.0
    while True:
        offset = 0.0  # of the point from the centre of its voxel
        for axis in range(3):
            point[axis] = begin[axis]
            if length > 0.0:
                point[axis] += (end[axis] - begin[axis]) * (done / length)
        x = _voxel_of(air, 0, point[0])
        y = _voxel_of(air, 1, point[1])
        z = _voxel_of(air, 2, point[2])
        offset = (point[0] - air.origin[0] - (x + 0.5) * air.res) ** 2
        offset += (point[1] - air.origin[1] - (y + 0.5) * air.res) ** 2
        offset += (point[2] - air.origin[2] - (z + 0.5) * air.res) ** 2
        safe_length = air.distances[x, y, z] - math.sqrt(offset) - air.radius
        if safe_length < 0.5 * air.res:
            safe_length = min(air.res, length - done)
            for axis in range(3):
                step[axis] = 0.0
                if length > 0.0:
                    step[axis] = (end[axis] - begin[axis]) * (safe_length / length)
            clearance = _clearance_of_piece(
                air, point, step, corner, least_clearance, least_clearance
            )
            if clearance < least_clearance:
                return False
        done += safe_length
        if done >= length:
            return True


@kernel(nogil=True)
def sees(air, begins, ends, is_clear, begin, end):
    """Find out between which points the ball can fly straight.

    Args:
        air: `Air`.
        begins: world x, y, z [m], (n, 3).
        ends: world x, y, z [m], (n, 3).
        is_clear: (n,), bool, written.
        begin: first pair to work on.
        end: the pair after the last.
    """
    point = np.empty(3)
    step = np.empty(3)
    corner = np.empty(3)
    for pair in range(begin, end):
        is_clear[pair] = _sees(air, begins[pair], ends[pair], point, step, corner)


@kernel(nogil=True)
def measure_clearances(air, points, reach, clearances, begin, end):
    """Compute how far points are from the nearest occupied voxel, exactly.

    Args:
        air: `Air`.
        points: world x, y, z [m], (n, 3).
        reach: the longest distance that is of interest [m].
        clearances: the distances, at most `reach` [m], (n,), written.
        begin: first point to work on.
        end: the point after the last.
    """
    step = np.zeros(3)
    corner = np.empty(3)
    for point in range(begin, end):
        clearances[point] = _clearance_of_piece(air, points[point], step, corner, reach, 0.0)


@kernel(nogil=True)
def mark_free_voxels(air, begin, end):
    """Set `FREE` in ``air.state`` where the ball fits, for a range of voxels along x.

    Args:
        air: `Air`; its state is written.
        begin: first index along x.
        end: the index after the last.
    """
    _, ny, nz = air.distances.shape
    least_clearance = air.radius - CONTACT_TOLERANCE
    for x in range(begin, end):
        if not _is_between_limits(air, 0, x):
            continue
        for y in range(ny):
            if not _is_between_limits(air, 1, y):
                continue
            for z in range(nz):
                if _is_between_limits(air, 2, z) and air.distances[x, y, z] >= least_clearance:
                    air.state[x, y, z] = FREE


@subkernel
def _is_between_limits(air, axis, index):
    """Whether the centre of a voxel lies, along an axis, where the ball's centre may be."""
    center = air.origin[axis] + (index + 0.5) * air.res
    is_above = center >= air.lower[axis] - CONTACT_TOLERANCE
    return is_above and center <= air.upper[axis] + CONTACT_TOLERANCE


@kernel(nogil=True)
def mark_moves(air, moves, begin, end):
    """Set the bits of the moves in ``air.state`` for a range of voxels along x.

    A move leads to a free voxel, and the ball meets no occupied voxel in between.

    Args:
        air: `Air`; its state is written, but for `FREE`, which must be set.
        moves: `Moves`.
        begin: first index along x.
        end: the index after the last.
    """
    nx, ny, nz = air.state.shape
    # at this distance from what is occupied, nothing is met on any move
    roomy_distance = air.radius + SQRT_3 * air.res
    for x in range(begin, end):
        for y in range(ny):
            for z in range(nz):
                if not air.state[x, y, z] & FREE:
                    continue
                is_roomy = air.distances[x, y, z] >= roomy_distance
                bits = FREE
                for move in range(26):
                    end_x = x + moves.steps[move, 0]
                    end_y = y + moves.steps[move, 1]
                    end_z = z + moves.steps[move, 2]
                    if not (0 <= end_x < nx and 0 <= end_y < ny and 0 <= end_z < nz):
                        continue
                    # another thread may be setting other bits of that voxel
                    if not air.state[end_x, end_y, end_z] & FREE:
                        continue
                    is_clear = True
                    # the ball is in the grid at both ends, and so is all that it may meet between
                    for entry in range(moves.start[move], moves.start[move + 1]):
                        if is_roomy:
                            break
                        between_x = x + moves.between[entry, 0]
                        between_y = y + moves.between[entry, 1]
                        between_z = z + moves.between[entry, 2]
                        if air.distances[between_x, between_y, between_z] == 0.0:
                            is_clear = False
                            break
                    if is_clear:
                        bits |= 1 << move
                air.state[x, y, z] = bits


@kernel
def label_islands(air, moves, labels):
    """Number the islands: free voxels that clear moves connect.

    Args:
        air: `Air`.
        moves: `Moves`.
        labels: (nx, ny, nz), int32, zeros; written: numbers from 1, 0 where no voxel is free.

    Returns:
        The number of islands.
    """
    _, ny, nz = air.state.shape
    stack = np.empty(1024, np.int64)
    num_islands = 0
    for seed_x, seed_y, seed_z in np.ndindex(air.state.shape):
        if not air.state[seed_x, seed_y, seed_z] & FREE or labels[seed_x, seed_y, seed_z]:
            continue
        num_islands += 1
        labels[seed_x, seed_y, seed_z] = num_islands
        stack[0] = (seed_x * ny + seed_y) * nz + seed_z
        height = 1
        while height:
            height -= 1
            x, rest = divmod(stack[height], ny * nz)
            y, z = divmod(rest, nz)
            if height + 26 > stack.shape[0]:
                stack = np.append(stack, np.empty_like(stack))
            move_bits = air.state[x, y, z]
            for move in range(26):
                if not (move_bits >> move) & 1:
                    continue
                end_x = x + moves.steps[move, 0]
                end_y = y + moves.steps[move, 1]
                end_z = z + moves.steps[move, 2]
                if labels[end_x, end_y, end_z] == 0:
                    labels[end_x, end_y, end_z] = num_islands
                    stack[height] = (end_x * ny + end_y) * nz + end_z
                    height += 1
    return num_islands


@subkernel(inline="always")  # calls would count references to the box, which takes half the time
def _steps_to_box(x, y, z, box):
    """Compute the length of the shortest way over 26 neighbours from a voxel to a box.

    Args:
        x: the voxel's index along x.
        y: its index along y.
        z: its index along z.
        box: the first and the last index along x, along y and along z, (6,).

    Returns:
        The length, in edges of a voxel.
    """
    along_x = max(box[0] - x, x - box[1], 0)
    along_y = max(box[2] - y, y - box[3], 0)
    along_z = max(box[4] - z, z - box[5], 0)
    least = min(along_x, along_y, along_z)
    most = max(along_x, along_y, along_z)
    middle = along_x + along_y + along_z - least - most
    return SQRT_3 * least + SQRT_2 * (middle - least) + (most - middle)


@kernel
def find_flight(air, moves, sources, source_costs, goals, goal_costs, costs, reached_by):
    """Find the cheapest route of voxels from one of several sources to one of several goals.

    A move costs its length times the mean of the costs of a metre at both of its ends. Without
    goals, the search reaches all voxels that it can.

    Args:
        air: `Air`.
        moves: `Moves`.
        sources: indices of free voxels, (m, 3), int64.
        source_costs: what it costs to begin at each source, (m,).
        goals: indices of free voxels, (n, 3), int64; none for no goal.
        goal_costs: what it costs to end at each goal, (n,).
        costs: cost of the route to each voxel, (nx, ny, nz), inf; written.
        reached_by: move that leads into each voxel, (nx, ny, nz), int8, `NOT_REACHED`; written.

    Returns:
        The cost with the costs of source and goal, inf if there is no route; and the indices of the
        route's voxels from source to goal, (k, 3).
    """
    _, ny, nz = air.state.shape
    # by flat index of a voxel
    flat_state = air.state.ravel()
    flat_distances = air.distances.ravel()
    flat_costs = costs.ravel()
    flat_moves = reached_by.ravel()
    is_waiting = np.zeros(air.state.size, np.bool_)
    index_steps = np.empty(26, np.int64)
    cheaper_moves = np.empty(26, np.int64)  # the moves that make a neighbour cheaper
    for move in range(26):
        step_x, step_y, step_z = moves.steps[move]
        index_steps[move] = (step_x * ny + step_y) * nz + step_z
    box = np.zeros(6, np.int64)
    for axis in range(3 if len(goals) else 0):
        box[2 * axis] = goals[:, axis].min()
        box[2 * axis + 1] = goals[:, axis].max()
    least_edge_cost = air.res * air.least_weight
    bucket_width = BUCKET_SHARE * least_edge_cost
    # the least cost that remains, for each edge of a voxel: nothing without goals
    cost_ahead = least_edge_cost if len(goals) else 0.0
    # each bucket is a stack of entries: its top entry, and the entry below each entry
    top_entries = np.full(1024, -1, np.int64)
    entries_below = np.empty(1024 + len(sources), np.int64)
    entry_voxels = np.empty(1024 + len(sources), np.int64)
    num_entries = 0
    unused_entry = -1  # top of the stack of entries that may be used again
    num_waiting = 0
    least_key = np.inf
    for source in range(len(sources)):
        x, y, z = sources[source]
        key = source_costs[source] + cost_ahead * _steps_to_box(x, y, z, box)
        least_key = min(least_key, key)
    for source in range(len(sources)):
        x, y, z = sources[source]
        voxel = (x * ny + y) * nz + z
        if source_costs[source] >= flat_costs[voxel]:
            continue
        flat_costs[voxel] = source_costs[source]
        flat_moves[voxel] = FROM_SOURCE
        is_waiting[voxel] = True
        key = source_costs[source] + cost_ahead * _steps_to_box(x, y, z, box)
        bucket = int((key - least_key) / bucket_width)
        while bucket >= len(top_entries):
            top_entries = np.append(top_entries, np.full_like(top_entries, -1))
        entry_voxels[num_entries] = voxel
        entries_below[num_entries] = top_entries[bucket]
        top_entries[bucket] = num_entries
        num_entries += 1
        num_waiting += 1
    best_cost = np.inf
    best_goal = -1
    bucket = 0
    while num_waiting > 0:
        while top_entries[bucket] < 0:
            bucket += 1
        if least_key + bucket * bucket_width >= best_cost:
            break
        entry = top_entries[bucket]
        top_entries[bucket] = entries_below[entry]
        entries_below[entry] = unused_entry
        unused_entry = entry
        num_waiting -= 1
        voxel = entry_voxels[entry]
        if not is_waiting[voxel]:  # an entry from before it got cheaper
            continue
        is_waiting[voxel] = False
        cost = flat_costs[voxel]
        x, rest = divmod(voxel, ny * nz)
        y, z = divmod(rest, nz)
        least_cost = cost + cost_ahead * _steps_to_box(x, y, z, box)
        if least_cost * (1.0 + GREED) >= best_cost:
            continue
        is_in_box = box[0] <= x <= box[1] and box[2] <= y <= box[3] and box[4] <= z <= box[5]
        for goal in range(len(goals) if is_in_box else 0):
            is_here = goals[goal, 0] == x and goals[goal, 1] == y and goals[goal, 2] == z
            if is_here and cost + goal_costs[goal] < best_cost:
                best_cost = cost + goal_costs[goal]
                best_goal = goal
        if num_entries + 26 > len(entry_voxels):
            entries_below = np.append(entries_below, np.empty_like(entries_below))
            entry_voxels = np.append(entry_voxels, np.empty_like(entry_voxels))
        weight = 1.0 + air.cost_of_clearance / flat_distances[voxel]
        move_bits = flat_state[voxel]
        num_cheaper = 0
        for move in range(26):
            if not (move_bits >> move) & 1:
                continue
            end = voxel + index_steps[move]
            end_weight = 1.0 + air.cost_of_clearance / flat_distances[end]
            end_cost = cost + moves.lengths[move] * 0.5 * (weight + end_weight)
            if end_cost >= flat_costs[end]:
                continue
            flat_costs[end] = end_cost
            flat_moves[end] = move
            is_waiting[end] = True
            cheaper_moves[num_cheaper] = move
            num_cheaper += 1
        # in a loop of its own, since compilers would compute a key for each of the 26 moves
        for place in range(num_cheaper):
            move = cheaper_moves[place]
            end = voxel + index_steps[move]
            end_x = x + moves.steps[move, 0]
            end_y = y + moves.steps[move, 1]
            end_z = z + moves.steps[move, 2]
            key = flat_costs[end] + cost_ahead * _steps_to_box(end_x, end_y, end_z, box)
            # by rounding, a key may be a little less than those of its bucket
            end_bucket = max(int((key - least_key) / bucket_width), bucket)
            while end_bucket >= len(top_entries):
                top_entries = np.append(top_entries, np.full_like(top_entries, -1))
            if unused_entry >= 0:
                entry = unused_entry
                unused_entry = entries_below[entry]
            else:
                entry = num_entries
                num_entries += 1
            entry_voxels[entry] = end
            entries_below[entry] = top_entries[end_bucket]
            top_entries[end_bucket] = entry
            num_waiting += 1

    route = np.empty((64, 3), np.int64)
    if best_goal < 0:
        return best_cost, route[:0]
    # from the goal back along the moves that the voxels were reached by
    x, y, z = goals[best_goal]
    length = 0
    while True:
        if length == route.shape[0]:
            route = np.concatenate((route, np.empty_like(route)))
        route[length, 0] = x
        route[length, 1] = y
        route[length, 2] = z
        length += 1
        move = reached_by[x, y, z]
        if move == FROM_SOURCE:
            break
        x -= moves.steps[move, 0]
        y -= moves.steps[move, 1]
        z -= moves.steps[move, 2]
    return best_cost, route[:length][::-1].copy()


@subkernel
def _cost_of_line(air, begin, end):
    """Compute the cost of a straight line: its length in each voxel times a metre's cost there.

    The line is walked from face to face (Amanatides and Woo 1987).
    """
    length = 0.0
    for axis in range(3):
        length += (end[axis] - begin[axis]) ** 2
    length = math.sqrt(length)
    if air.cost_of_clearance == 0.0 or length == 0.0:
        return length
    voxel_x = _voxel_of(air, 0, begin[0])
    voxel_y = _voxel_of(air, 1, begin[1])
    voxel_z = _voxel_of(air, 2, begin[2])
    cost = 0.0
    done = 0.0
    while done < 1.0:
        # where the line leaves the voxel, as a share of its length
        leaving = 1.0
        leaving_axis = -1
        for axis in range(3):
            run = end[axis] - begin[axis]
            if run == 0.0:
                continue
            index = voxel_x if axis == 0 else (voxel_y if axis == 1 else voxel_z)
            face = air.origin[axis] + (index + (run > 0.0)) * air.res
            share = (face - begin[axis]) / run
            if share < leaving:
                leaving = share
                leaving_axis = axis
        leaving = max(leaving, done)
        distance = max(air.distances[voxel_x, voxel_y, voxel_z], 0.5 * air.res)
        cost += (leaving - done) * length * (1.0 + air.cost_of_clearance / distance)
        done = leaving
        if leaving_axis < 0:
            break
        direction = 1 if end[leaving_axis] > begin[leaving_axis] else -1
        if leaving_axis == 0:
            voxel_x += direction
        elif leaving_axis == 1:
            voxel_y += direction
        else:
            voxel_z += direction
        nx, ny, nz = air.distances.shape
        if not (0 <= voxel_x < nx and 0 <= voxel_y < ny and 0 <= voxel_z < nz):
            break  # by rounding, at the grid's faces
    return cost


@kernel
def shorten(air, points):
    """Choose the points of the cheapest line from the first to the last that the ball can fly.

    The line is straight between the points that are chosen. It is the cheapest of all lines through
    some of the points, in their order.

    Args:
        air: `Air`.
        points: world x, y, z [m], (n, 3), n >= 1; the ball can fly from each to the next.

    Returns:
        Indices of the chosen points, ascending, with the first and the last.
    """
    count = points.shape[0]
    point = np.empty(3)
    step = np.empty(3)
    corner = np.empty(3)
    costs = np.full(count, np.inf)
    previous = np.full(count, -1)
    costs[0] = 0.0
    for first in range(count):
        # points far ahead first: once they are reached at least cost, nearer ones gain nothing
        for last in range(count - 1, first, -1):
            length = 0.0
            for axis in range(3):
                length += (points[last, axis] - points[first, axis]) ** 2
            least_cost = costs[first] + math.sqrt(length) * air.least_weight
            if least_cost >= costs[last] - CONTACT_TOLERANCE:
                continue
            cost = costs[first] + _cost_of_line(air, points[first], points[last])
            if cost >= costs[last] - CONTACT_TOLERANCE:
                continue
            is_next = last == first + 1
            if is_next or _sees(air, points[first], points[last], point, step, corner):
                costs[last] = cost
                previous[last] = first
    chosen = np.empty(count, np.int64)
    num_chosen = 0
    place = count - 1
    while place >= 0:
        chosen[num_chosen] = place
        num_chosen += 1
        place = previous[place]
    return chosen[:num_chosen][::-1].copy()


@kernel(nogil=True)
def snap(air, labels, island, points, max_distance, places, begin, end):
    """Find the centre of the nearest free voxel of each point.

    Cubes of voxels round the point's voxel are searched, each one larger than the one before.

    Args:
        air: `Air`.
        labels: number of each voxel's island, (nx, ny, nz), int32; not read for island 0.
        island: the island that the voxel must be on; 0 for any.
        points: world x, y, z [m], (n, 3).
        max_distance: the longest distance [m].
        places: world x, y, z [m], (n, 3), NaN; written where there is such a voxel.
        begin: first point to work on.
        end: the point after the last.
    """
    nx, ny, nz = air.state.shape
    for point in range(begin, end):
        point_x, point_y, point_z = points[point]
        voxel_x = _voxel_of(air, 0, point_x)
        voxel_y = _voxel_of(air, 1, point_y)
        voxel_z = _voxel_of(air, 2, point_z)
        best = max_distance * max_distance
        for ring in range(max(nx, ny, nz)):
            # centres of this ring are at least so far away, also from points outside the grid
            if ring > 0 and best <= ((ring - 0.5) * air.res) ** 2:
                break
            for x in range(max(voxel_x - ring, 0), min(voxel_x + ring, nx - 1) + 1):
                for y in range(max(voxel_y - ring, 0), min(voxel_y + ring, ny - 1) + 1):
                    is_side = abs(x - voxel_x) == ring or abs(y - voxel_y) == ring
                    stride = 1 if is_side or ring == 0 else 2 * ring
                    z = voxel_z - ring
                    while z <= voxel_z + ring:
                        if 0 <= z < nz and air.state[x, y, z] & FREE:
                            center_x = air.origin[0] + (x + 0.5) * air.res
                            center_y = air.origin[1] + (y + 0.5) * air.res
                            center_z = air.origin[2] + (z + 0.5) * air.res
                            squared = (center_x - point_x) ** 2
                            squared += (center_y - point_y) ** 2 + (center_z - point_z) ** 2
                            # of equally near voxels, the first one
                            is_nearer = squared < best or (
                                squared == best and math.isnan(places[point, 0])
                            )
                            if is_nearer and (island == 0 or labels[x, y, z] == island):
                                best = squared
                                places[point, 0] = center_x
                                places[point, 1] = center_y
                                places[point, 2] = center_z
                        z += stride
