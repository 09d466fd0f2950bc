"""Finds cells where an agent can't stand because of occupied cells, holes and floors near them.

All distances on the map are in cells.

Distances and what lies within them are found in two passes, as in the exact distance transform of
Meijster, Roerdink and Hesselink (2000): first along the columns, then along the rows. Along rows,
`dilate_along_rows` unites intervals, and `look_up_along_rows` steps to neighbours.

To find where floors are too high or too low for an agent, patches of 4 x 4 cells are compared
first, by their lowest and highest floors (one step of a min-max pyramid). Single cells are compared
only in patches near which some floor, of any level, is more than a step away.

Arrays have the shape (rows, cols); the arrays of `LevelStack` have the shape (levels, rows, cols).
`cell_offsets` lead from an agent's cell to each cell that its disc overlaps: rows and columns,
shape (n, 2), int64.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import EAST, NORTH, SOUTH, WEST

PATCH_SIZE = 4  # edge of the squares of cells by which floors are compared first
SLAB_THICKNESS = 0.3  # [m] how thick the floor of a level above may be


class LevelStack(NamedTuple):
    """The cells of one level and of the levels around it, in a window of the scene's lattice.

    Attributes:
        floor: world z of the floor [m], NaN for none, shape (levels, rows, cols), float32.
        occupied: `SceneGrid2D.solid` of each level, and 1 outside of the level's own rectangle;
            shape of `floor`, uint8.
        slope_bits: for each cell, the directions in which a step of the grid's table leads up or
            down a steep ramp, to a neighbour on any level whose floor is higher or lower by more
            than `max_step`: bits EAST, NORTH, WEST and SOUTH, uint8. Shape of `floor`, or
            (0, 0, 0) if there are no such steps.
        level: index in the arrays of the level that the agent is on.
        max_step: largest difference of neighbours' floors that an agent can step over [m].
        height: the agent's height [m].
    """

    floor: NDArray[np.float32]
    occupied: NDArray[np.uint8]
    slope_bits: NDArray[np.uint8]
    level: int
    max_step: float
    height: float


@kernel(nogil=True)
def find_patch_extremes(floor, patch_min_z, patch_max_z, begin, end):
    """Find the lowest and the highest floor in each patch of `PATCH_SIZE` x `PATCH_SIZE` cells.

    Args:
        floor: `LevelStack.floor`, shape (levels, rows, cols) [m].
        patch_min_z: receives z of the lowest floor, inf for none, float32, shape (levels, patch
            rows, patch columns) [m]. The last patches may have fewer rows and columns of cells.
        patch_max_z: receives z of the highest floor, -inf for none, of the same shape [m].
        begin: first row of patches.
        end: the row after the last.
    """
    num_levels, num_rows, num_cols = floor.shape
    num_patch_cols = patch_min_z.shape[2]
    # of the cells of each column in a row of patches
    column_min_z = np.empty(num_patch_cols * PATCH_SIZE, dtype=np.float32)
    column_max_z = np.empty(num_patch_cols * PATCH_SIZE, dtype=np.float32)
    for level in range(num_levels):
        for patch_row in range(begin, end):
            column_min_z[:] = np.inf
            column_max_z[:] = -np.inf
            first_row = patch_row * PATCH_SIZE
            for row in range(first_row, min(first_row + PATCH_SIZE, num_rows)):
                for col in range(num_cols):
                    z = floor[level, row, col]  # NaN is neither lower nor higher
                    column_min_z[col] = z if z < column_min_z[col] else column_min_z[col]
                    column_max_z[col] = z if z > column_max_z[col] else column_max_z[col]
            for patch_col in range(num_patch_cols):
                lowest_z = column_min_z[patch_col * PATCH_SIZE]
                highest_z = column_max_z[patch_col * PATCH_SIZE]
                for i in range(1, PATCH_SIZE):
                    lowest_z = min(lowest_z, column_min_z[patch_col * PATCH_SIZE + i])
                    highest_z = max(highest_z, column_max_z[patch_col * PATCH_SIZE + i])
                patch_min_z[level, patch_row, patch_col] = lowest_z
                patch_max_z[level, patch_row, patch_col] = highest_z


@kernel(nogil=True)
def combine_weights(old_weights, is_opened, least_weights, is_blocked, weights, begin, end):
    """Compute the weights of some rows of an inflated level.

    Args:
        old_weights: the weights before, float64, shape (rows, cols).
        is_opened: where cells of infinite weight weigh 1 now, unless they are blocked, bool, shape
            (rows, cols).
        least_weights: the least weight of each cell, 0 for none, uint8, shape (rows, cols).
        is_blocked: whether each cell is blocked now, bool, shape (rows, cols).
        weights: receives the weights, inf in blocked cells, float64, shape (rows, cols).
        begin: first row.
        end: the row after the last.
    """
    for row in range(begin, end):
        for col in range(old_weights.shape[1]):
            weight = old_weights[row, col]
            if is_opened[row, col] and not np.isfinite(weight):
                weight = 1.0
            least_weight = np.float64(least_weights[row, col])
            if least_weight > 0 and weight < least_weight:
                weight = least_weight
            weights[row, col] = np.inf if is_blocked[row, col] else weight


@kernel
def measure_along_columns(is_occupied, max_distance):
    """Measure how many rows each cell is away from the nearest occupied cell of its column.

    This is the first pass of an exact Euclidean distance transform; `look_up_along_rows` is the
    second one.

    Args:
        is_occupied: uint8, shape (rows, cols).
        max_distance: the distance of cells that are farther away, or whose column has no occupied
            cell.

    Returns:
        int32, shape (rows, cols).
    """
    num_rows, num_cols = is_occupied.shape
    farthest = np.int32(max_distance)
    row_distances = np.empty((num_rows, num_cols), dtype=np.int32)
    for row in range(num_rows):
        for col in range(num_cols):
            distance_above = row_distances[row - 1, col] if row > 0 else farthest
            distance = min(np.int32(distance_above + 1), farthest)
            row_distances[row, col] = 0 if is_occupied[row, col] else distance
    for row in range(num_rows - 2, -1, -1):
        for col in range(num_cols):
            distance_from_below = np.int32(row_distances[row + 1, col] + 1)
            row_distances[row, col] = min(row_distances[row, col], distance_from_below)
    return row_distances


@kernel(nogil=True)
def dilate_along_rows(row_distances, half_width, is_covered, begin, end):
    """Mark the cells of some rows that a shape covers when it is centred on any occupied cell.

    The shape must be like a disc: symmetric, and no wider away from its middle row.

    Args:
        row_distances: the distances along columns from `measure_along_columns`, at most the index
            of the last entry of `half_width`.
        half_width: the shape, int32. Entry i is how many columns it covers to each side, i rows
            above and below its middle; -1 for none. The last entry must be -1.
        is_covered: receives the marks, bool, shape (rows, cols).
        begin: first row.
        end: the row after the last.
    """
    num_cols = row_distances.shape[1]
    interval_begins = np.empty(num_cols, dtype=np.int32)
    farthest_ends = np.empty(num_cols, dtype=np.int32)
    for row in range(begin, end):
        # The union of all intervals [col - covered, col + covered], swept once from each side: the
        # farthest end so far decides, whichever interval it is of. An interval of -1 ends before
        # its own column and begins after it, so that it covers nothing.
        farthest_end = np.int32(-1)
        for col in range(num_cols):
            interval_half_width = half_width[row_distances[row, col]]
            interval_begins[col] = col - interval_half_width
            farthest_end = max(farthest_end, np.int32(col + interval_half_width))
            farthest_ends[col] = farthest_end
        first_begin = np.int32(num_cols)
        for col in range(num_cols - 1, -1, -1):
            first_begin = min(first_begin, interval_begins[col])
            is_covered[row, col] = (col <= farthest_ends[col]) | (col >= first_begin)


@kernel(nogil=True)
def look_up_along_rows(row_distances, cost_of_square, costs, begin, end):
    """Look up the costs of the cells of some rows by their distance to the nearest occupied cell.

    The squared distance of a cell is the least sum, over the cells of its row, of the square of
    their distance along the column and the square of the offset to them. Squares are sums of odd
    numbers, so that it is found by steps to neighbours that cost 1, 3, 5, …: after k steps, cells
    up to k columns away count (Shih and Mitchell, "A Mathematical Morphology Approach to Euclidean
    Distance Transformation", 1992). A step that lowers no distance is the last one, as later steps
    cost more.

    A row takes as many steps as the largest offset that lowers a distance in it: no more than the
    reach of the costs in cells, nor than walls are apart. A step is a few instructions of a
    processor. With the usual reach of tens of cells that is faster than envelopes of parabolas
    (Felzenszwalb and Huttenlocher 2012), whose time does not depend on the reach. On open land,
    with a reach of hundreds of cells, steps are slower than envelopes, by tens of times.

    Args:
        row_distances: the distances along columns, from `measure_along_columns`, at most the root
            of n, rounded up.
        cost_of_square: the cost by squared distance in cells, uint8, shape (n,), n at most
            `navbake.runtime.inflation.MAX_SQUARED_DISTANCE`; larger distances cost 0. So do cells
            without any occupied cell within that distance.
        costs: receives the costs, uint8, shape (rows, cols).
        begin: first row.
        end: the row after the last.
    """
    num_cols = row_distances.shape[1]
    num_squares = np.int32(cost_of_square.shape[0])
    # squared distances before and after a step, with a cell that is too far at both ends
    squares = np.empty(num_cols + 2, dtype=np.int32)
    next_squares = np.empty(num_cols + 2, dtype=np.int32)
    for row in range(begin, end):
        for end_square in (squares, next_squares):
            end_square[0] = num_squares
            end_square[num_cols + 1] = num_squares
        for col in range(num_cols):
            square = np.int32(row_distances[row, col] * row_distances[row, col])
            squares[col + 1] = min(square, num_squares)
        step_cost = np.int32(1)
        num_lowered = 1
        while num_lowered > 0 and step_cost < num_squares:
            num_lowered = 0
            for col in range(num_cols):
                left = squares[col]
                right = squares[col + 2]
                stepped = np.int32((left if left < right else right) + step_cost)
                square_here = squares[col + 1]
                next_squares[col + 1] = stepped if stepped < square_here else square_here
                num_lowered += stepped < square_here
            squares, next_squares = next_squares, squares
            step_cost = np.int32(step_cost + 2)
        for col in range(num_cols):
            square_here = squares[col + 1]
            costs[row, col] = cost_of_square[square_here] if square_here < num_squares else 0


@kernel
def block_near_holes(has_floor, is_checked, cell_offsets, squared_lengths, least_share, is_blocked):
    """Block the cells that have too little floor near them.

    A cell is blocked if, for any distance up to the radius, too few of the cells within that
    distance have a floor: their fraction is less than `least_share`.

    Args:
        has_floor: bool, shape (rows, cols).
        is_checked: whether to check each cell, bool, shape (rows, cols).
        cell_offsets: rows and columns from a cell to the cells within the radius, the nearest
            first, int64, shape (n, 2).
        squared_lengths: the squared length of each of `cell_offsets`, in cells squared, shape (n,).
        least_share: the fraction of the cells within a distance that must have a floor, 0 to 1.
        is_blocked: set to True in the cells that get blocked, bool, shape (rows, cols).
    """
    num_rows, num_cols = has_floor.shape
    for row in range(num_rows):
        for col in range(num_cols):
            num_cells_within = 0
            num_with_floor = 0
            for k in range(cell_offsets.shape[0] if is_checked[row, col] else 0):
                to_row = row + cell_offsets[k, 0]
                to_col = col + cell_offsets[k, 1]
                if 0 <= to_row < num_rows and 0 <= to_col < num_cols:
                    num_cells_within += 1
                    num_with_floor += has_floor[to_row, to_col]
                # the share counts once all cells at the same distance are included
                is_last_at_distance = (
                    k + 1 == cell_offsets.shape[0] or squared_lengths[k + 1] > squared_lengths[k]
                )
                if is_last_at_distance and num_with_floor < least_share * num_cells_within:
                    is_blocked[row, col] = True
                    break


@kernel
def block_by_floors(
    stack,
    patch_min_z,
    patch_max_z,
    cell_offsets,
    higher_floors_block,
    lower_floors_block,
    is_blocked,
):
    """Update the mask of a level's blocked cells by the floors and occupied cells of all levels.

    1. Where another level's floor goes on at about the height of an agent's floor, the agent also
       overlaps what stands on that level. So each cell under the agent's disc is looked up on the
       levels whose floor there is about as high as the floor in the agent's cell; if there is no
       such level, on the agent's own. The agent's cell is blocked if one of the looked up cells is
       occupied, or it is itself; otherwise it becomes free.
    2. Cells near floors that are more than a step higher are blocked, and cells near drops, unless
       a slope leads there. A higher floor of another level blocks only if it is above the agent's
       floor by less than the agent's height and a slab's thickness. A higher floor of the agent's
       own level blocks at any height, unless another level has a floor under it within a step of
       the agent's, as where a flight goes on under the next one. Then it blocks only up to a step
       more than another level's would: the cells under it were found to be free for an agent whose
       head is up to a step lower. Patches of cells whose floors differ little are skipped.

    Args:
        stack: `LevelStack`.
        patch_min_z: z of the lowest floor near each patch of cells, on each level, shape (levels,
            patch rows, patch columns) [m]; inf for no floor. Near are the patches to which
            `cell_offsets` lead from the patch.
        patch_max_z: z of the highest floor there, -inf for none, of the same shape [m].
        cell_offsets: rows and columns from an agent's cell to the cells that the agent overlaps,
            int64, shape (n, 2).
        higher_floors_block: whether floors more than a step higher block.
        lower_floors_block: whether drops block.
        is_blocked: whether each of the level's cells is blocked, bool, shape (rows, cols), written.
    """
    floor, occupied, slope_bits, level, max_step, height = stack
    num_levels, num_rows, num_cols = floor.shape
    height_tolerance = height - max_step
    max_blocking_rise = height + SLAB_THICKNESS
    has_slopes = slope_bits.shape[0] > 0
    for row in range(num_rows if num_levels > 1 else 0):
        for col in range(num_cols):
            z = floor[level, row, col]
            is_near_level = False
            for k in range(num_levels):
                begins_below = (
                    patch_min_z[k, row // PATCH_SIZE, col // PATCH_SIZE] - z < height_tolerance
                )
                ends_above = (
                    z - patch_max_z[k, row // PATCH_SIZE, col // PATCH_SIZE] < height_tolerance
                )
                is_near_level |= k != level and begins_below and ends_above
            if is_near_level and not occupied[level, row, col]:
                is_blocked[row, col] = _overlaps_occupied(
                    floor, occupied, level, row, col, cell_offsets, height_tolerance
                )
    for patch_row in range(patch_min_z.shape[1]):
        for patch_col in range(patch_min_z.shape[2]):
            lowest_floor_z = patch_min_z[level, patch_row, patch_col]
            highest_floor_z = patch_max_z[level, patch_row, patch_col]
            is_uneven = False
            for k in range(num_levels):
                is_uneven |= patch_max_z[k, patch_row, patch_col] - lowest_floor_z > max_step
                is_uneven |= highest_floor_z - patch_min_z[k, patch_row, patch_col] > max_step
            for patch_cell_index in range(PATCH_SIZE * PATCH_SIZE if is_uneven else 0):
                row = patch_row * PATCH_SIZE + patch_cell_index // PATCH_SIZE
                col = patch_col * PATCH_SIZE + patch_cell_index % PATCH_SIZE
                if row >= num_rows or col >= num_cols:
                    continue
                # whether this cell is too high or too low for agents in the cells round it
                is_too_high = False
                is_too_low = False
                has_floor_within_step = False
                lowest_z = np.inf
                highest_z = -np.inf
                for k in range(num_levels):
                    z = floor[k, row, col]
                    lowest_z = z if z < lowest_z else lowest_z
                    highest_z = z if z > highest_z else highest_z
                    is_above = z - lowest_floor_z > max_step
                    is_below = highest_floor_z - z > max_step
                    is_too_high |= is_above and (
                        k == level or z - highest_floor_z < max_blocking_rise
                    )
                    is_too_low |= is_below
                    # no drop for an agent of any of these heights
                    has_floor_within_step |= not (is_above or is_below or np.isnan(z))
                is_too_high &= higher_floors_block
                is_too_low &= lower_floors_block and not has_floor_within_step and num_levels > 1
                for i in range(cell_offsets.shape[0] if is_too_high or is_too_low else 0):
                    agent_row = row - cell_offsets[i, 0]
                    agent_col = col - cell_offsets[i, 1]
                    is_inside = 0 <= agent_row < num_rows and 0 <= agent_col < num_cols
                    if not is_inside or is_blocked[agent_row, agent_col]:
                        continue
                    z = floor[level, agent_row, agent_col]
                    for k in range(num_levels if is_too_high and highest_z - z > max_step else 0):
                        rise = floor[k, row, col] - z
                        is_in_the_way = rise < max_blocking_rise
                        if k == level:
                            is_in_the_way = rise < max_blocking_rise + max_step
                            is_in_the_way = is_in_the_way or not _goes_on_below(
                                floor, level, z, row, col, max_step, height_tolerance
                            )
                        if max_step < rise and is_in_the_way:
                            is_blocked[agent_row, agent_col] |= not has_slopes or not _is_slope(
                                floor,
                                slope_bits,
                                max_step,
                                level,
                                agent_row,
                                agent_col,
                                k,
                                row,
                                col,
                            )
                    if (
                        is_too_low
                        and z - lowest_z > max_step
                        and not is_blocked[agent_row, agent_col]
                    ):
                        is_blocked[agent_row, agent_col] = _is_drop(
                            floor, slope_bits, max_step, level, agent_row, agent_col, row, col
                        )
                # with a single level, fewer cells are above a drop than at its bottom: start above
                may_fall = num_levels == 1 and floor[level, row, col] - lowest_floor_z > max_step
                for i in range(cell_offsets.shape[0] if may_fall and lower_floors_block else 0):
                    to_row = row + cell_offsets[i, 0]
                    to_col = col + cell_offsets[i, 1]
                    if is_blocked[row, col]:
                        break
                    if 0 <= to_row < num_rows and 0 <= to_col < num_cols:
                        is_blocked[row, col] = _is_drop(
                            floor, slope_bits, max_step, level, row, col, to_row, to_col
                        )


@subkernel
def _goes_on_below(floor, level, floor_z, row, col, max_step, height_tolerance):
    """Whether another level has a floor in a cell, within a step of the floor at a height.

    Its floor must also be near enough for its occupied cells to count for an agent at this height:
    see `_is_occupied_at_height`, by which those of the agent's own level don't count there.
    """
    for k in range(floor.shape[0]):
        difference = abs(floor[k, row, col] - floor_z)
        if k != level and difference <= max_step and difference < height_tolerance:
            return True
    return False


@subkernel
def _overlaps_occupied(floor, occupied, level, row, col, cell_offsets, height_tolerance):
    """Whether an agent overlaps an occupied cell of its own level or of one at its height."""
    num_rows, num_cols = floor.shape[1:]
    floor_z = floor[level, row, col]
    for i in range(cell_offsets.shape[0]):
        to_row = row + cell_offsets[i, 0]
        to_col = col + cell_offsets[i, 1]
        if to_row < 0 or to_row >= num_rows or to_col < 0 or to_col >= num_cols:
            continue
        if _is_occupied_at_height(
            floor, occupied, level, floor_z, to_row, to_col, height_tolerance
        ):
            return True
    return False


@subkernel
def _is_occupied_at_height(floor, occupied, level, floor_z, row, col, height_tolerance):
    """Whether a cell counts as occupied for an agent whose own floor is at a height."""
    # Which levels count depends on which have a floor at the cell that is about as high as the
    # agent's floor:
    #   its own level only, or none   its own level counts
    #   its own and other levels      its own and these other levels count
    #   only other levels             these other levels count
    is_covered = False
    for k in range(floor.shape[0]):
        if k != level and abs(floor[k, row, col] - floor_z) < height_tolerance:
            is_covered = True
            if occupied[k, row, col]:
                return True
    own_level_counts = not is_covered or abs(floor[level, row, col] - floor_z) < height_tolerance
    return own_level_counts and occupied[level, row, col] != 0


@kernel
def look_up_near_levels(
    stack, patch_min_z, patch_max_z, cell_offsets, squared_lengths, cost_of_square, costs
):
    """Look up the costs by distance to occupied cells again, in cells near another level's floor.

    The levels' occupied cells are combined as in `block_by_floors`. Cells that are occupied
    themselves, or not near another level's floor of about the same height, keep their costs.

    Args:
        stack: `LevelStack`.
        patch_min_z: z of the lowest floor near each patch of cells, as in `block_by_floors`.
        patch_max_z: z of the highest floor there.
        cell_offsets: rows and columns from a cell to the cells to search, nearest first, int64,
            shape (n, 2).
        squared_lengths: the squared length of each offset, in cells squared, int64, shape (n,).
        cost_of_square: the cost by squared distance in cells, as in `look_up_along_rows`.
        costs: written: the cost of each cell; 0 where no offset leads to an occupied cell; uint8,
            shape (rows, cols).
    """
    floor = stack.floor
    occupied = stack.occupied
    level = stack.level
    num_levels, num_rows, num_cols = floor.shape
    height_tolerance = stack.height - stack.max_step
    for row in range(num_rows):
        for col in range(num_cols):
            z = floor[level, row, col]
            is_near_level = False
            for k in range(num_levels):
                begins_below = (
                    patch_min_z[k, row // PATCH_SIZE, col // PATCH_SIZE] - z < height_tolerance
                )
                ends_above = (
                    z - patch_max_z[k, row // PATCH_SIZE, col // PATCH_SIZE] < height_tolerance
                )
                is_near_level |= k != level and begins_below and ends_above
            if not is_near_level or occupied[level, row, col]:
                continue
            costs[row, col] = 0
            for i in range(cell_offsets.shape[0]):
                to_row = row + cell_offsets[i, 0]
                to_col = col + cell_offsets[i, 1]
                if to_row < 0 or to_row >= num_rows or to_col < 0 or to_col >= num_cols:
                    continue
                if _is_occupied_at_height(
                    floor, occupied, level, z, to_row, to_col, height_tolerance
                ):
                    if squared_lengths[i] < cost_of_square.shape[0]:
                        costs[row, col] = cost_of_square[squared_lengths[i]]
                    break


@subkernel
def _is_drop(floor, slope_bits, max_step, level, row, col, to_row, to_col):
    """Whether an agent that moves from a cell of a level to another row and column drops there.

    It does if some level has a floor there more than a step below the cell's, no level has one
    within a step of it, and no slope leads to the highest of the lower floors.
    """
    floor_z = floor[level, row, col]
    highest_lower_z = -np.inf
    level_below = -1
    is_below = False
    for k in range(floor.shape[0]):
        other_z = floor[k, to_row, to_col]
        if abs(other_z - floor_z) <= max_step:
            return False
        is_below |= other_z - floor_z < -max_step
        if highest_lower_z < other_z < floor_z:
            highest_lower_z = other_z
            level_below = k
    return is_below and (
        slope_bits.shape[0] == 0
        or not _is_slope(floor, slope_bits, max_step, level, row, col, level_below, to_row, to_col)
    )


@subkernel
def _is_slope(floor, slope_bits, max_step, level, row, col, to_level, to_row, to_col):
    """Whether an agent can walk straight from a cell of a level to one of another on a slope.

    The walk leads from cell to cell along the line (Bresenham 1965), over steps and slopes, and
    over at least one slope. Steps alone make a stair: there, a larger agent hits the next riser.
    """
    row_offset = to_row - row
    col_offset = to_col - col
    num_cells = max(abs(row_offset), abs(col_offset))
    num_slopes = 0
    current_row = row
    current_col = col
    for k in range(1, num_cells + 1):
        # halves are rounded away from the start, so that turning a grid turns the lines
        next_row = row + np.sign(row_offset) * (
            (2 * abs(row_offset) * k + num_cells) // (2 * num_cells)
        )
        next_col = col + np.sign(col_offset) * (
            (2 * abs(col_offset) * k + num_cells) // (2 * num_cells)
        )
        reached_level = np.int64(-1)
        slope_flag = -1
        # round a corner, there are two walks over edges, of which one on a slope counts
        for walk_index in range(2):
            mid_row = next_row if walk_index == 0 else current_row
            mid_col = current_col if walk_index == 0 else next_col
            mid_level, first_is_slope = _walk_edge(
                floor, slope_bits, max_step, level, current_row, current_col, mid_row, mid_col
            )
            if mid_level >= 0:
                end_level, second_is_slope = _walk_edge(
                    floor, slope_bits, max_step, mid_level, mid_row, mid_col, next_row, next_col
                )
                if end_level >= 0 and max(first_is_slope, second_is_slope) > slope_flag:
                    reached_level = end_level
                    slope_flag = max(first_is_slope, second_is_slope)
        if reached_level < 0:
            return False
        num_slopes += slope_flag
        level = reached_level
        current_row = next_row
        current_col = next_col
    return level == to_level and num_slopes > 0


@subkernel
def _walk_edge(floor, slope_bits, max_step, level, row, col, to_row, to_col):
    """Find the level that a step or a slope over an edge of a cell leads to.

    Returns:
        The level's number, -1 for none; and 1 for a slope, else 0. If the neighbour is the cell
        itself, its own level and 0.
    """
    if to_row == row and to_col == col:
        return level, 0
    if to_row == row:
        direction, opposite_direction = (EAST, WEST) if to_col > col else (WEST, EAST)
    else:
        direction, opposite_direction = (SOUTH, NORTH) if to_row > row else (NORTH, SOUTH)
    floor_z = floor[level, row, col]
    is_steep = slope_bits[level, row, col] & direction != 0
    num_levels = floor.shape[0]
    for k in range(num_levels):
        to_level = (level + k) % num_levels
        rise = abs(floor[to_level, to_row, to_col] - floor_z)
        if rise <= max_step:
            return to_level, 0
        if (
            is_steep
            and rise > max_step
            and slope_bits[to_level, to_row, to_col] & opposite_direction != 0
        ):
            return to_level, 1
    return -1, 0
