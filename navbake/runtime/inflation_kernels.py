"""Finds cells where an agent can't stand because of what is near. All distances in cells.

`dilate` has two passes, as the exact distance transform of Meijster, Roerdink and Hesselink (2000):
along the columns first, then along the rows, where it unites intervals instead of parabolas.

Floors of several levels are compared cell by cell, but only where ranges of heights in patches of
cells make a conflict possible: one step of a min-max pyramid.

Arrays have the shape (rows, cols), those of `LevelStack` (levels, rows, cols); `offsets` are the
steps from an agent's cell to the cells that it meets, (n, 2) int64. `blocked` is bool and written.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import EAST, NORTH, SOUTH, WEST

PATCH_SIZE = 4  # edge of the squares of cells by which floors are compared first
SLAB_THICKNESS = 0.3  # [m] how thick the floor of a level above may be


class LevelStack(NamedTuple):
    """The cells of one level and of those around it, in a window of the scene's lattice.

    Attributes:
        floor: world z of the floor [m], NaN for none, shape (levels, rows, cols), float32.
        occupied: `SceneGrid2D.solid`, and 1 beyond a level's rectangle, shape as `floor`, uint8.
        slopes: which neighbours, on any level, links join that are more than a step apart: bits
            EAST, NORTH, WEST and SOUTH, uint8; shape as `floor`, or (0, 0, 0) where there are none.
        level: index in the arrays of the level that the agent is on.
        step: largest difference of neighbours' floors that an agent can step over [m].
        height: of the agent [m].
    """

    floor: NDArray[np.float32]
    occupied: NDArray[np.uint8]
    slopes: NDArray[np.uint8]
    level: int
    step: float
    height: float


@kernel
def dilate(occupied, half_width):
    """Mark the cells that a shape covers when it is centred on any occupied cell.

    Exact for any shape that is symmetric and narrows with the distance from its middle.

    Args:
        occupied: uint8, shape (rows, cols).
        half_width: the shape, int32: entry i is how many columns to each side the shape covers i
            rows from its middle. -1 where it covers none, as in the last entry.

    Returns:
        bool, shape (rows, cols).
    """
    rows, cols = occupied.shape
    farthest = half_width.shape[0] - 1
    # rows to the nearest occupied cell of the same column, at most `farthest`
    row_distance = np.empty((rows, cols), dtype=np.int32)
    for row in range(rows):
        for col in range(cols):
            above = row_distance[row - 1, col] if row > 0 else farthest
            row_distance[row, col] = 0 if occupied[row, col] else min(above + 1, farthest)
    for row in range(rows - 2, -1, -1):
        for col in range(cols):
            row_distance[row, col] = min(row_distance[row, col], row_distance[row + 1, col] + 1)
    near = np.empty((rows, cols), dtype=np.bool_)
    width = np.empty(cols, dtype=np.int32)
    for row in range(rows):
        for col in range(cols):
            width[col] = half_width[row_distance[row, col]]
        # The union of all intervals [col - width, col + width], swept once from each side: the
        # farthest end so far decides, whichever interval it is of.
        end = -1
        for col in range(cols):
            if width[col] >= 0 and col + width[col] > end:
                end = col + width[col]
            near[row, col] = col <= end
        end = cols
        for col in range(cols - 1, -1, -1):
            if width[col] >= 0 and col - width[col] < end:
                end = col - width[col]
            near[row, col] |= col >= end
    return near


@kernel
def block_near_holes(has_floor, near, offsets, squares, least_share, blocked):
    """Block the cells that have too few cells with a floor around them.

    A cell is blocked if the share is too small within any distance up to the radius.

    Args:
        has_floor: bool, shape (rows, cols).
        near: the cells that are checked, bool, shape (rows, cols).
        offsets: rows and columns from a cell to the cells within the radius, the nearest first,
            int64, shape (n, 2).
        squares: squared lengths of `offsets`, shape (n,).
        least_share: the share of the cells within a distance that must have a floor.
        blocked: bool, shape (rows, cols), written.
    """
    rows, cols = has_floor.shape
    for row in range(rows):
        for col in range(cols):
            num_within = 0
            num_with_floor = 0
            for k in range(offsets.shape[0] if near[row, col] else 0):
                to_row = row + offsets[k, 0]
                to_col = col + offsets[k, 1]
                if 0 <= to_row < rows and 0 <= to_col < cols:
                    num_within += 1
                    num_with_floor += has_floor[to_row, to_col]
                # a ring of equally far cells completes a disc; if that fails, larger ones do
                is_disc = k + 1 == offsets.shape[0] or squares[k + 1] > squares[k]
                if is_disc and num_with_floor < least_share * num_within:
                    blocked[row, col] = True
                    break


@kernel
def block_by_floors(stack, lowest, highest, offsets, counts_higher, counts_lower, blocked):
    """Update `blocked` for the floors around each cell.

    First, cells near another level's floor of about the same height are recomputed: there, an
    occupied cell of the agent's level doesn't count where another level covers its column. So cells
    may become free.
    Then cells are blocked near a floor that is more than a step higher (of another level only up to
    an agent and a slab above) or a drop, unless a slope leads there. Offsets are tried only where
    the floors of patches make a conflict possible.

    Args:
        stack: `LevelStack`.
        lowest: the lowest floor of each level in the patches that offsets lead to from each patch,
            shape (levels, patch rows, patch columns).
        highest: the highest floor, of the same shape.
        offsets: steps from an agent's cell to the cells that it meets, int64, shape (n, 2).
        counts_higher: whether higher floors block.
        counts_lower: whether drops block.
        blocked: the level's cells, bool, shape (rows, cols), written.
    """
    floor, occupied, slopes, level, step, height = stack
    levels, rows, cols = floor.shape
    overlap = height - step
    highest_rise = height + SLAB_THICKNESS
    for row in range(rows if levels > 1 else 0):
        for col in range(cols):
            z = floor[level, row, col]
            meets_level = False
            for k in range(levels):
                is_low = lowest[k, row // PATCH_SIZE, col // PATCH_SIZE] - z < overlap
                is_high = z - highest[k, row // PATCH_SIZE, col // PATCH_SIZE] < overlap
                meets_level |= k != level and is_low and is_high
            if meets_level and not occupied[level, row, col]:
                blocked[row, col] = _meets_occupied(
                    floor, occupied, level, row, col, offsets, overlap
                )
    for patch_row in range(lowest.shape[1]):
        for patch_col in range(lowest.shape[2]):
            least = lowest[level, patch_row, patch_col]
            greatest = highest[level, patch_row, patch_col]
            differs = False
            for k in range(levels):
                differs |= highest[k, patch_row, patch_col] - least > step
                differs |= greatest - lowest[k, patch_row, patch_col] > step
            for index in range(PATCH_SIZE * PATCH_SIZE if differs else 0):
                row = patch_row * PATCH_SIZE + index // PATCH_SIZE
                col = patch_col * PATCH_SIZE + index % PATCH_SIZE
                if row >= rows or col >= cols:
                    continue
                # what this column is to the cells of the level round it
                is_wall = False
                is_low = False
                has_floor_in_step = False
                bottom = np.inf
                top = -np.inf
                for k in range(levels):
                    z = floor[k, row, col]
                    bottom = z if z < bottom else bottom
                    top = z if z > top else top
                    is_above = z - least > step
                    is_below = greatest - z > step
                    is_wall |= is_above and (k == level or z - greatest < highest_rise)
                    is_low |= is_below
                    # no drop for an agent of any of these heights
                    has_floor_in_step |= not (is_above or is_below or np.isnan(z))
                is_wall &= counts_higher
                is_low &= counts_lower and not has_floor_in_step and levels > 1
                for i in range(offsets.shape[0] if is_wall or is_low else 0):
                    agent_row = row - offsets[i, 0]
                    agent_col = col - offsets[i, 1]
                    is_inside = 0 <= agent_row < rows and 0 <= agent_col < cols
                    if not is_inside or blocked[agent_row, agent_col]:
                        continue
                    z = floor[level, agent_row, agent_col]
                    for k in range(levels if is_wall and top - z > step else 0):
                        rise = floor[k, row, col] - z
                        if step < rise and (k == level or rise < highest_rise):
                            blocked[agent_row, agent_col] |= slopes.shape[0] == 0 or not _is_slope(
                                floor, slopes, step, level, agent_row, agent_col, k, row, col
                            )
                    if is_low and z - bottom > step and not blocked[agent_row, agent_col]:
                        blocked[agent_row, agent_col] = _is_drop(
                            floor, slopes, step, level, agent_row, agent_col, row, col
                        )
                # of a single level, the high cells beside drops are fewer than the low columns
                may_fall = levels == 1 and floor[level, row, col] - least > step
                for i in range(offsets.shape[0] if may_fall and counts_lower else 0):
                    to_row = row + offsets[i, 0]
                    to_col = col + offsets[i, 1]
                    if blocked[row, col]:
                        break
                    if 0 <= to_row < rows and 0 <= to_col < cols:
                        blocked[row, col] = _is_drop(
                            floor, slopes, step, level, row, col, to_row, to_col
                        )


@subkernel
def _meets_occupied(floor, occupied, level, row, col, offsets, overlap):
    """Whether an agent in a cell meets an occupied cell, another level's floors included."""
    # What counts in a column that an agent meets, by whose floors are as high as the agent's:
    #   own level's only, or none     the own level
    #   own and other levels'         the own level and these other levels
    #   only other levels'            these other levels
    levels, rows, cols = floor.shape
    height = floor[level, row, col]
    for i in range(offsets.shape[0]):
        to_row = row + offsets[i, 0]
        to_col = col + offsets[i, 1]
        if to_row < 0 or to_row >= rows or to_col < 0 or to_col >= cols:
            continue
        is_covered = False
        for k in range(levels):
            if k != level and abs(floor[k, to_row, to_col] - height) < overlap:
                is_covered = True
                if occupied[k, to_row, to_col]:
                    return True
        own_counts = not is_covered or abs(floor[level, to_row, to_col] - height) < overlap
        if own_counts and occupied[level, to_row, to_col]:
            return True
    return False


@subkernel
def _is_drop(floor, slopes, step, level, row, col, to_row, to_col):
    """Whether a column is a drop from a cell of a level.

    It is where some level's floor lies more than a step below the cell's, no level's within a step
    of it, and no slope leads to the highest of the floors below.
    """
    height = floor[level, row, col]
    highest = -np.inf
    level_below = -1
    is_below = False
    for k in range(floor.shape[0]):
        lower = floor[k, to_row, to_col]
        if abs(lower - height) <= step:
            return False
        is_below |= lower - height < -step
        if highest < lower < height:
            highest = lower
            level_below = k
    return is_below and (
        slopes.shape[0] == 0
        or not _is_slope(floor, slopes, step, level, row, col, level_below, to_row, to_col)
    )


@subkernel
def _is_slope(floor, slopes, step, level, row, col, to_level, to_row, to_col):
    """Whether the straight line from a cell of a level to one of another is one walk on a slope.

    From cell to cell along the line (Bresenham 1965), it must lead over steps and slopes, and over
    one slope at least: steps alone make a stair, on which a larger agent meets the next riser.
    """
    down = to_row - row
    across = to_col - col
    count = max(abs(down), abs(across))
    num_slopes = 0
    current_row = row
    current_col = col
    for k in range(1, count + 1):
        # halves are rounded away from the start, so that turning a grid turns the lines
        next_row = row + np.sign(down) * ((2 * abs(down) * k + count) // (2 * count))
        next_col = col + np.sign(across) * ((2 * abs(across) * k + count) // (2 * count))
        reached_level = np.int64(-1)
        is_slope = -1
        # round a corner, there are two walks over edges, of which one on a slope counts
        for walk in range(2):
            mid_row = next_row if walk == 0 else current_row
            mid_col = current_col if walk == 0 else next_col
            mid_level, first_is_slope = _walk_edge(
                floor, slopes, step, level, current_row, current_col, mid_row, mid_col
            )
            if mid_level >= 0:
                end_level, second_is_slope = _walk_edge(
                    floor, slopes, step, mid_level, mid_row, mid_col, next_row, next_col
                )
                if end_level >= 0 and max(first_is_slope, second_is_slope) > is_slope:
                    reached_level = end_level
                    is_slope = max(first_is_slope, second_is_slope)
        if reached_level < 0:
            return False
        num_slopes += is_slope
        level = reached_level
        current_row = next_row
        current_col = next_col
    return level == to_level and num_slopes > 0


@subkernel
def _walk_edge(floor, slopes, step, level, row, col, to_row, to_col):
    """Find the level on which a step or a slope leads to a neighbour, and 1 if it is a slope.

    The level is -1 for none, and the own one if the neighbour is the cell itself.
    """
    if to_row == row and to_col == col:
        return level, 0
    if to_row == row:
        onward, back = (EAST, WEST) if to_col > col else (WEST, EAST)
    else:
        onward, back = (SOUTH, NORTH) if to_row > row else (NORTH, SOUTH)
    height = floor[level, row, col]
    is_steep = slopes[level, row, col] & onward != 0
    levels = floor.shape[0]
    for k in range(levels):
        to_level = (level + k) % levels
        rise = abs(floor[to_level, to_row, to_col] - height)
        if rise <= step:
            return to_level, 0
        if is_steep and rise > step and slopes[to_level, to_row, to_col] & back != 0:
            return to_level, 1
    return -1, 0
