"""Finds the moves between cells, the cheapest route to a goal, and the cost from all cells.

`find_route` is A* (Hart, Nilsson and Raphael 1968), and without a goal Dijkstra's algorithm (1959).
A step costs its length [m] times the weight of the cell that it leads to. The cost that remains to
the goals is estimated by the octile distance to the box round them, times the smallest weight. The
estimate is never too high, so the route found is the cheapest. It also holds on other levels: a
step between levels costs at least its length on the map times the smallest weight. Only a passage
over a link may cost less. So once a goal is reached, the search goes on until costs are higher by
as much as links may save: an estimate that is too high by at most that leaves the answer exact
(Harris 1974, the bandwidth condition).

The queue has buckets (Dial 1969). Each holds the cells of a range of costs, less than the cheapest
step wide, and cells come out of it in any order: the "untidy" priority queue of Yatziv, Bartesaghi
and Sapiro (2006). Unlike there, the answer stays exact, because a cell that gets cheaper after it
was taken out is put in again (label correcting). The buckets are used in a circle, which is long
enough for the most expensive step. Each is a linked stack; freed entries are reused, so the queue
stays in the processor's cache.
"""

import math

import numpy as np

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import (
    COL_STEP,
    DIAGONAL,
    EAST,
    NORTH,
    ROW_STEP,
    SOUTH,
    WEST,
    cell_center,
    find_link_cell_index,
    level_of,
    to_cell_units,
)

# for each direction: the bits of the two straight moves on both sides of a diagonal move
STRAIGHT_MOVES_BESIDE = np.array(
    [0, 0, 0, 0, EAST | NORTH, NORTH | WEST, WEST | SOUTH, SOUTH | EAST]
)
# width of a bucket as a share of the cheapest step's cost; few cells are expanded twice up to 1
BUCKET_SHARE = 0.5
MAX_BUCKETS = 1 << 16
# Indices in the array `counters` of the queue. It holds the first entry to reuse, -1 for none; the
# number of entries ever used; and the number of entries in the queue.
SPARE_ENTRY = 0
NUM_USED = 1
NUM_OPEN = 2

# The bits of a cell's `mark`:
#   0 to 3   how the cell was reached: a direction, FROM_SOURCE, BY_LINK or NOT_REACHED
#   4        whether it is a goal
#   5        whether it was expanded
#   6 on     the number of the search that wrote it, so that nothing is cleared between searches
MOVE_BITS = 15
GOAL_BIT = 16
EXPANDED_BIT = 32
SEARCH_UNIT = 64
FROM_SOURCE = 8
BY_LINK = 9
NOT_REACHED = 15
# how a search ended
SEARCH_DONE = 0
QUEUE_FULL = 1


@kernel
def find_moves(
    is_free, fits_diagonally, floors, slope_bits, cut_corners, layout, level, window, moves
):
    """Compute in which directions an agent can move from each cell of a window, into `moves`.

    A move leads to a free neighbour whose floor differs by at most `max_step`, or by more on a
    slope. A diagonal move needs more, unless the agent may cut corners: both cells beside it are
    free, straight moves lead to its end over each of them, and the agent has room at both ends.

    Args:
        is_free: by cell, bool.
        fits_diagonally: by cell, whether the agent has room for a diagonal step.
        floors: `navbake.runtime.grid_arrays.FloorHeights`.
        slope_bits: `navbake.runtime.flat_grid.FlatGrid.slope_bits`.
        cut_corners: whether diagonal moves past blocked corners are allowed.
        layout: `navbake.runtime.grid_arrays.Layout`.
        level: the window's level.
        window: first row, stop row, first column, stop column; the stops are not in it.
        moves: by cell, uint8, written: bit d is set where a move leads in direction d.
    """
    floor = floors.z
    max_step = floors.max_step
    first_cell = layout.start[level]
    width = layout.width[level]
    height = layout.height[level]
    first_row, stop_row, first_col, stop_col = window
    for row in range(max(first_row, 0), min(stop_row, height)):
        for col in range(max(first_col, 0), min(stop_col, width)):
            cell = first_cell + row * width + col
            move_bits = 0
            for direction in range(8 if is_free[cell] else 0):
                row_step = ROW_STEP[direction]
                col_step = COL_STEP[direction]
                if not (0 <= row + row_step < height and 0 <= col + col_step < width):
                    continue
                row_neighbor = cell + col_step  # in the same row
                col_neighbor = cell + row_step * width
                target = col_neighbor + col_step
                is_steep = False
                if direction >= 4:
                    if not is_free[target]:
                        continue
                    is_steep = abs(floor[cell] - floor[target]) > max_step
                    # A diagonal move on a slope counts if the straight moves over its corners use
                    # the slope: at one of their edges, floors must differ by more than a step.
                    if is_steep and not (
                        slope_bits.shape[0] > 0
                        and (
                            abs(floor[cell] - floor[row_neighbor]) > max_step
                            or abs(floor[cell] - floor[col_neighbor]) > max_step
                            or abs(floor[row_neighbor] - floor[target]) > max_step
                            or abs(floor[col_neighbor] - floor[target]) > max_step
                        )
                    ):
                        continue
                elif not _is_step(cell, target, is_free, floor, max_step, slope_bits):
                    continue
                # Straight moves must connect the four cells round the corner: `move_bits` has those
                # from this cell; the last two tests are for those to the target.
                if (direction < 4 or (cut_corners and not is_steep)) or (
                    move_bits & STRAIGHT_MOVES_BESIDE[direction] == STRAIGHT_MOVES_BESIDE[direction]
                    and (cut_corners or (fits_diagonally[cell] and fits_diagonally[target]))
                    and _is_step(row_neighbor, target, is_free, floor, max_step, slope_bits)
                    and _is_step(col_neighbor, target, is_free, floor, max_step, slope_bits)
                ):
                    move_bits |= 1 << direction
            moves[cell] = move_bits


@subkernel
def _is_step(cell, neighbor, is_free, floor, max_step, slope_bits):
    """Whether an agent may step from a cell over an edge to a neighbour.

    It may if the neighbour is free, and its floor at most a step higher or lower or on a slope.
    """
    if not is_free[neighbor]:
        return False
    if not abs(floor[cell] - floor[neighbor]) > max_step:  # so that NaN, no floor, is no step
        return True
    if slope_bits.shape[0] == 0:
        return False
    bit = EAST if abs(cell - neighbor) == 1 else SOUTH
    return slope_bits[min(cell, neighbor)] & bit != 0


def plan_buckets(
    cell_size: float,
    least_weight: float,
    greatest_weight: float,
    longest_step: float,
    highest_passage_cost: float = 0.0,
) -> tuple[float, int]:
    """Compute the width of the buckets of a search's queue, and how many buckets it needs.

    The width is `BUCKET_SHARE` of the cost of the cheapest step. It is larger if more than
    `MAX_BUCKETS` buckets were needed otherwise.

    Args:
        cell_size: edge of the smallest cell [m].
        least_weight: the smallest weight of a free cell, >= 0.
        greatest_weight: the largest weight of a free cell.
        longest_step: length of the longest step between levels [m].
        highest_passage_cost: over all links, the largest sum of the passage's cost and the search's
            cost estimate between the link's ends; 0 without links.

    Returns:
        The buckets' width, in units of cost; and their number, a power of two.
    """
    # how much higher than the present bucket's the cost of a new entry can be
    max_cost_range = max(
        2.0 * greatest_weight * max(DIAGONAL * cell_size, longest_step), highest_passage_cost
    )
    bucket_width = max(BUCKET_SHARE * cell_size * least_weight, max_cost_range / (MAX_BUCKETS - 4))
    if not bucket_width > 0.0:  # all steps are free of cost: one bucket holds everything
        return 1.0, 4
    num_buckets = 4
    while num_buckets < max_cost_range / bucket_width + 3:
        num_buckets *= 2
    return bucket_width, num_buckets


@subkernel
def _push_cell(bucket_head, counters, entry_cell, entry_next, bucket_number, cell):
    """Put a cell into a bucket of the queue; the caller has checked that the queue isn't full.

    `counters` are the queue's counters; `entry_cell` and `entry_next` are described in `Visits` of
    `navbake.runtime.grid_arrays`.
    """
    # the remainder, as the number of buckets is a power of two
    bucket_index = bucket_number & (bucket_head.shape[0] - 1)
    entry = counters[SPARE_ENTRY]
    if entry >= 0:
        counters[SPARE_ENTRY] = entry_next[entry]
    else:
        entry = counters[NUM_USED]
        counters[NUM_USED] += 1
    entry_cell[entry] = cell
    entry_next[entry] = bucket_head[bucket_index]
    bucket_head[bucket_index] = entry
    counters[NUM_OPEN] += 1


@subkernel
def _pop_cell(bucket_head, counters, entry_cell, entry_next, bucket_number):
    """Take a cell out of a bucket of the queue, and return it; -1 if the bucket is empty.

    The arguments are those of `_push_cell`.
    """
    bucket_index = bucket_number & (bucket_head.shape[0] - 1)
    entry = bucket_head[bucket_index]
    if entry < 0:
        return np.int64(-1)
    bucket_head[bucket_index] = entry_next[entry]
    entry_next[entry] = counters[SPARE_ENTRY]
    counters[SPARE_ENTRY] = entry
    counters[NUM_OPEN] -= 1
    return np.int64(entry_cell[entry])


@subkernel
def _lower_bound(row, col, box, cost_per_cell):
    """Compute a lower bound of the cost of a route from a cell to the box round the goals.

    Args:
        row: the cell's row.
        col: the cell's column.
        box: first and last row, first and last column of the box.
        cost_per_cell: least cost of a step to a neighbour in the same row or column.
    """
    row_distance = max(box[0] - row, row - box[1], 0.0)
    col_distance = max(box[2] - col, col - box[3], 0.0)
    longer_distance = max(row_distance, col_distance)
    return cost_per_cell * (longer_distance + (DIAGONAL - 1.0) * min(row_distance, col_distance))


@subkernel
def _mark_goals(layout, goal_cells, search_mark, visits):
    """Mark the goals of a search, and return the box round them on each level.

    Args:
        layout: `navbake.runtime.grid_arrays.Layout`.
        goal_cells: flat ids of the goals, int64; empty for no goal.
        search_mark: the search's number, as bits of `visits.mark`.
        visits: `navbake.runtime.grid_arrays.Visits`, whose `mark` and `cost` are written.

    Returns:
        By level: first and last row, first and last column, with fractions, (levels, 4) float64.
    """
    x_min = np.inf
    x_max = -np.inf
    y_min = np.inf
    y_max = -np.inf
    for goal_cell in goal_cells:
        visits.mark[goal_cell] = search_mark | GOAL_BIT | NOT_REACHED
        visits.cost[goal_cell] = np.inf
        x, y = cell_center(layout, goal_cell)
        x_min = min(x_min, x)
        x_max = max(x_max, x)
        y_min = min(y_min, y)
        y_max = max(y_max, y)
    num_levels = layout.width.shape[0]
    goal_boxes = np.empty((num_levels, 4))
    for level in range(num_levels):
        first_col, first_row = to_cell_units(layout, level, x_min, y_max)
        last_col, last_row = to_cell_units(layout, level, x_max, y_min)
        goal_boxes[level, 0] = first_row - 0.5
        goal_boxes[level, 1] = last_row - 0.5
        goal_boxes[level, 2] = first_col - 0.5
        goal_boxes[level, 3] = last_col - 0.5
    return goal_boxes


@subkernel
def _bound_cost(graph, cell, goal_boxes):
    """Compute a lower bound of the cost of a route from a cell to the goals.

    Args:
        graph: `navbake.runtime.grid_arrays.Graph`.
        cell: flat id of the cell.
        goal_boxes: see `_mark_goals`.
    """
    layout = graph.layout
    level = level_of(layout.start, cell)
    row, col = divmod(cell - layout.start[level], layout.width[level])
    cost_per_cell = layout.cell_size[level] * graph.least_weight
    return _lower_bound(row, col, goal_boxes[level], cost_per_cell)


@subkernel
def _trace_route(graph, goal_cell, visits):
    """Follow the moves that cells were reached by from a goal back to its source.

    Args:
        graph: `navbake.runtime.grid_arrays.Graph`.
        goal_cell: flat id of the goal; -1 if none was reached.
        visits: `navbake.runtime.grid_arrays.Visits`, as the search has written it.

    Returns:
        The flat ids of the route from source to goal, int64; none without a goal.
    """
    layout = graph.layout
    route = np.empty(256, np.int64)
    route_length = 0
    cell = goal_cell
    while cell >= 0:
        if route_length == route.shape[0]:
            route = np.append(route, np.empty_like(route))
        route[route_length] = cell
        route_length += 1
        move = visits.mark[cell] & MOVE_BITS
        if move == FROM_SOURCE:
            break
        if move == BY_LINK:
            cell = visits.link_from[find_link_cell_index(graph.links.cell, cell)]
        else:
            level = level_of(layout.start, cell)
            cell -= ROW_STEP[move] * layout.width[level] + COL_STEP[move]
    return route[:route_length][::-1].copy()


@kernel
def find_route(graph, source_cells, goal_cells, search_number, visits):
    """Find the cheapest route from a source to one of several goals.

    The module's docstring describes the algorithm. Without goals, there may be several sources, and
    the search reaches all cells and follows steps backwards: ``visits.cost`` is then the cost of
    the route from each cell to the source that is cheapest to reach. For that, ``graph.links`` must
    be reversed.

    Args:
        graph: `navbake.runtime.grid_arrays.Graph`.
        source_cells: flat ids of free cells, int64; one if there are goals.
        goal_cells: flat ids of free cells, int64, none of them a source; empty for no goal.
        search_number: larger than the number of any search that wrote into ``visits.mark``.
        visits: `navbake.runtime.grid_arrays.Visits`, written.

    Returns:
        `SEARCH_DONE`, or `QUEUE_FULL` if the queue has too few entries; and the flat ids of the
        route from source to goal, int64, none if there is no route.
    """
    layout = graph.layout
    level_start = layout.start
    width = layout.width
    cell_size = layout.cell_size
    link_cell, link_start, link_target, link_length, link_cost, is_end = graph.links
    moves = graph.moves
    weight = graph.weight
    uniform_weight = graph.uniform_weight
    least_weight = graph.least_weight
    bucket_width = graph.bucket_width
    mark, cost, link_from, entry_cell, entry_next = visits
    bucket_head = np.full(graph.num_buckets, -1, np.int32)
    counters = np.array([-1, 0, 0])
    buckets_per_cost = 1.0 / bucket_width
    least_gain = 1e-9 * bucket_width  # a smaller gain is none
    search_mark = search_number * SEARCH_UNIT
    has_goals = goal_cells.shape[0] > 0
    best_cost = np.inf  # of a goal
    best_goal_cell = np.int64(-1)
    goal_boxes = _mark_goals(layout, goal_cells, search_mark, visits)
    bucket_number = np.int64(0)
    for source_cell in source_cells:
        if counters[NUM_USED] == entry_cell.shape[0]:
            return QUEUE_FULL, np.empty(0, np.int64)
        if mark[source_cell] < search_mark:  # a source may be listed twice
            mark[source_cell] = search_mark | FROM_SOURCE
            cost[source_cell] = 0.0
            if has_goals:
                cost_bound = _bound_cost(graph, source_cell, goal_boxes)
                bucket_number = np.int64(cost_bound * buckets_per_cost)
            _push_cell(bucket_head, counters, entry_cell, entry_next, bucket_number, source_cell)

    # the level of the cell that is expanded, and its layout
    level = 0
    first_cell = level_start[0]
    num_cols = width[0]
    cell_edge = cell_size[0]
    while counters[NUM_OPEN] > 0:
        cell = _pop_cell(bucket_head, counters, entry_cell, entry_next, bucket_number)
        if cell < 0:
            bucket_number += 1
            # All open cells cost as much as this bucket at least. A goal counts only now, as a
            # cheaper route to it may have been in the bucket that it was found in.
            if bucket_number * bucket_width >= best_cost + graph.link_saving:
                break
            continue
        if mark[cell] & (EXPANDED_BIT | GOAL_BIT):  # a route over a goal gets no goal cheaper
            continue
        mark[cell] |= EXPANDED_BIT
        cell_cost = cost[cell]
        cell_moves = moves[cell]
        if cell < first_cell or cell >= level_start[level + 1]:
            level = level_of(level_start, cell)
            first_cell = level_start[level]
            num_cols = width[level]
            cell_edge = cell_size[level]
        link_cell_index = (
            find_link_cell_index(link_cell, cell) if is_end.shape[0] > 0 and is_end[cell] else -1
        )
        num_links = (
            0
            if link_cell_index < 0
            else link_start[link_cell_index + 1] - link_start[link_cell_index]
        )
        if counters[NUM_USED] + 8 + num_links > entry_cell.shape[0]:
            return QUEUE_FULL, np.empty(0, np.int64)
        row, col = divmod(cell - first_cell, num_cols) if has_goals else (np.int64(0), np.int64(0))
        for move in range(8 + num_links):  # the eight directions, then the links
            target_row = row
            target_col = col
            target_level = level
            passage_cost = 0.0
            if move < 8:
                if not (cell_moves >> move) & 1:
                    continue
                target_row = row + ROW_STEP[move]
                target_col = col + COL_STEP[move]
                target = cell + ROW_STEP[move] * num_cols + COL_STEP[move]
                length = cell_edge if move < 4 else cell_edge * DIAGONAL
            else:
                link_index = link_start[link_cell_index] + move - 8
                target = link_target[link_index]
                length = link_length[link_index]
                passage_cost = link_cost[link_index]
                if not math.isfinite(weight[target]):
                    continue
                if has_goals:
                    target_level = level_of(level_start, target)
                    target_row, target_col = divmod(
                        target - level_start[target_level], width[target_level]
                    )
            # Backwards, the step that is added leads into this cell. Steps lead both ways, so the
            # moves out of a cell are those into it; links come reversed.
            step_weight = uniform_weight
            if uniform_weight <= 0.0:
                # most neighbours were reached at a cost that the smallest weight can't beat
                least_cost = cell_cost + length * least_weight
                if mark[target] >= search_mark and least_cost >= cost[target] - least_gain:
                    continue
                step_weight = weight[target if has_goals else cell]
            target_cost = cell_cost + length * step_weight + passage_cost
            goal_bit = 0
            if mark[target] >= search_mark:  # no search has a larger number
                if target_cost >= cost[target] - least_gain:
                    continue
                goal_bit = mark[target] & GOAL_BIT
            if move >= 8:
                link_from[find_link_cell_index(link_cell, target)] = cell
            # without EXPANDED_BIT: a cell that got cheaper is expanded again
            mark[target] = search_mark | goal_bit | (move if move < 8 else BY_LINK)
            cost[target] = target_cost
            if goal_bit and target_cost < best_cost:
                best_cost = target_cost
                best_goal_cell = target
            estimated_cost = target_cost
            if has_goals:
                cost_per_cell = cell_size[target_level] * least_weight
                estimated_cost += _lower_bound(
                    target_row, target_col, goal_boxes[target_level], cost_per_cell
                )
            target_bucket_number = max(np.int64(estimated_cost * buckets_per_cost), bucket_number)
            _push_cell(bucket_head, counters, entry_cell, entry_next, target_bucket_number, target)
    return SEARCH_DONE, _trace_route(graph, best_goal_cell, visits)
