"""Finds cells where an agent can't stand because of what is near. All distances in cells.

`dilate` has two passes, as the exact distance transform of Meijster, Roerdink and Hesselink (2000):
along the columns first, then along the rows, where it unites intervals instead of parabolas.

Floors of several levels are compared cell by cell, but only where ranges of heights in tiles make a
conflict possible: one step of a min-max pyramid.

Arrays have the shape (rows, cols), those of `LevelStack` (levels, rows, cols); `offsets` are the
steps from an agent's cell to the cells that it meets, (n, 2) int64. `blocked` is bool and written.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.compiled import kernel, subkernel
from navbake.runtime.grid_arrays import EAST, NORTH, SOUTH, WEST

TILE = 4  # edge of the squares of cells by which floors are compared first
SLAB = 0.3  # [m] how thick the floor of a level above may be


class LevelStack(NamedTuple):
    """The cells of one level and of those around it, in a window of the scene's lattice."""

    floor: NDArray[np.float32]  # world z of the floor [m], NaN for none, (levels, rows, cols)
    occupied: NDArray[np.uint8]  # `SceneGrid2D.solid`, and 1 beyond a level's rectangle; as `floor`
    # which neighbours, on any level, links join that are more than a step apart: bits EAST, NORTH,
    # WEST and SOUTH; as `floor`, or (0, 0, 0) where there are none
    slopes: NDArray[np.uint8]
    level: int  # the one level's index in the arrays
    step: float  # by how much floors of neighbours may differ [m]
    height: float  # of the agent [m]


@kernel
def dilate(occupied, half_width):
    """Find the cells near an occupied one, by a shape that is as wide as a table says.

    Exact for any shape that is symmetric and narrows with the distance from its middle.
    `half_width` says how many columns to each side of itself an occupied cell makes near, by the
    number of rows between, int32; -1 for none, as in its last entry.
    """
    rows, cols = occupied.shape
    far = half_width.shape[0] - 1
    column = np.empty((rows, cols), dtype=np.int32)
    for row in range(rows):
        for col in range(cols):
            before = column[row - 1, col] if row > 0 else far
            column[row, col] = 0 if occupied[row, col] else min(before + 1, far)
    for row in range(rows - 2, -1, -1):
        for col in range(cols):
            column[row, col] = min(column[row, col], column[row + 1, col] + 1)
    near = np.empty((rows, cols), dtype=np.bool_)
    width = np.empty(cols, dtype=np.int32)
    for row in range(rows):
        for col in range(cols):
            width[col] = half_width[column[row, col]]
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
def block_near_holes(has_floor, near, offsets, squares, least, blocked):
    """Block cells of `near` with a share under `least` of cells with a floor, within any distance.

    The offsets come with their squared lengths, the nearest first.
    """
    rows, cols = has_floor.shape
    for row in range(rows):
        for col in range(cols):
            within = 0
            with_floor = 0
            for k in range(offsets.shape[0] if near[row, col] else 0):
                r = row + offsets[k, 0]
                c = col + offsets[k, 1]
                if 0 <= r < rows and 0 <= c < cols:
                    within += 1
                    with_floor += has_floor[r, c]
                # a ring of equally far cells completes a disc; if that fails, larger ones do
                is_whole = k + 1 == offsets.shape[0] or squares[k + 1] > squares[k]
                if is_whole and with_floor < least * within:
                    blocked[row, col] = True
                    break


@kernel
def block_by_floors(stack, lowest, highest, offsets, counts_higher, counts_lower, blocked):
    """Update `blocked` for the floors around each cell.

    First, cells where another level's floor is about as high are decided again: what is occupied
    on the own level does not count in a column that another level covers, so that cells may become
    free. Then cells are blocked near a floor that is more than a step higher (`counts_higher`; one
    of another level only up to an agent and a slab above) or a drop (`counts_lower`), unless a
    slope leads there. `lowest` and `highest` are the extreme floors of each level in the tiles that
    offsets lead to, (levels, tile rows, tile columns): offsets are tried only where these make a
    conflict possible.
    """
    floor, occupied, slopes, level, step, height = stack
    levels, rows, cols = floor.shape
    overlap = height - step
    over = height + SLAB
    for row in range(rows if levels > 1 else 0):
        for col in range(cols):
            z = floor[level, row, col]
            meets = False
            for other in range(levels):
                is_low = lowest[other, row // TILE, col // TILE] - z < overlap
                is_high = z - highest[other, row // TILE, col // TILE] < overlap
                meets |= other != level and is_low and is_high
            if meets and not occupied[level, row, col]:
                blocked[row, col] = _meets_any(floor, occupied, level, row, col, offsets, overlap)
    for tile_row in range(lowest.shape[1]):
        for tile_col in range(lowest.shape[2]):
            least = lowest[level, tile_row, tile_col]
            most = highest[level, tile_row, tile_col]
            differ = False
            for other in range(levels):
                differ |= highest[other, tile_row, tile_col] - least > step
                differ |= most - lowest[other, tile_row, tile_col] > step
            for cell in range(TILE * TILE if differ else 0):
                row = tile_row * TILE + cell // TILE
                col = tile_col * TILE + cell % TILE
                if row >= rows or col >= cols:
                    continue
                # what this column is to the cells of the level round it
                is_wall = False
                is_low = False
                carries = False
                bottom = np.inf
                top = -np.inf
                for other in range(levels):
                    z = floor[other, row, col]
                    bottom = z if z < bottom else bottom
                    top = z if z > top else top
                    is_above = z - least > step
                    is_below = most - z > step
                    is_wall |= is_above and (other == level or z - most < over)
                    is_low |= is_below
                    # no drop for an agent of any of these heights
                    carries |= not (is_above or is_below or np.isnan(z))
                is_wall &= counts_higher
                is_low &= counts_lower and not carries and levels > 1
                for k in range(offsets.shape[0] if is_wall or is_low else 0):
                    r = row - offsets[k, 0]
                    c = col - offsets[k, 1]
                    if not (0 <= r < rows and 0 <= c < cols) or blocked[r, c]:
                        continue
                    z = floor[level, r, c]
                    for other in range(levels if is_wall and top - z > step else 0):
                        rise = floor[other, row, col] - z
                        if step < rise and (other == level or rise < over):
                            blocked[r, c] |= slopes.shape[0] == 0 or not _is_slope(
                                floor, slopes, step, level, r, c, other, row, col
                            )
                    if is_low and z - bottom > step and not blocked[r, c]:
                        blocked[r, c] = _is_drop(floor, slopes, step, level, r, c, row, col)
                # of a single level, the high cells beside drops are fewer than the low columns
                may_fall = levels == 1 and floor[level, row, col] - least > step
                for k in range(offsets.shape[0] if may_fall and counts_lower else 0):
                    r = row + offsets[k, 0]
                    c = col + offsets[k, 1]
                    if blocked[row, col]:
                        break
                    if 0 <= r < rows and 0 <= c < cols:
                        blocked[row, col] = _is_drop(floor, slopes, step, level, row, col, r, c)


@subkernel
def _meets_any(floor, occupied, level, row, col, offsets, overlap):
    """Whether an agent in a cell meets what is occupied, another level's floors included."""
    # What counts in a column that an agent meets, by whose floors are as high as the agent's:
    #   own level's only, or none   the own level
    #   own and others'             the own level and these others
    #   only others'                these others
    levels, rows, cols = floor.shape
    height = floor[level, row, col]
    for k in range(offsets.shape[0]):
        r = row + offsets[k, 0]
        c = col + offsets[k, 1]
        if r < 0 or r >= rows or c < 0 or c >= cols:
            continue
        is_covered = False
        for other in range(levels):
            if other != level and abs(floor[other, r, c] - height) < overlap:
                is_covered = True
                if occupied[other, r, c]:
                    return True
        own_counts = not is_covered or abs(floor[level, r, c] - height) < overlap
        if own_counts and occupied[level, r, c]:
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
    below = -1
    is_below = False
    for other in range(floor.shape[0]):
        lower = floor[other, to_row, to_col]
        if abs(lower - height) <= step:
            return False
        is_below |= lower - height < -step
        if highest < lower < height:
            highest = lower
            below = other
    return is_below and (
        slopes.shape[0] == 0
        or not _is_slope(floor, slopes, step, level, row, col, below, to_row, to_col)
    )


@subkernel
def _is_slope(floor, slopes, step, level, row, col, other, to_row, to_col):
    """Whether the straight way from a cell of a level to one of another is one walk on a slope.

    From cell to cell along the line (Bresenham 1965), it must lead over steps and slopes, and over
    one slope at least: steps alone make a stair, on which a larger agent meets the next riser.
    """
    down = to_row - row
    across = to_col - col
    count = max(abs(down), abs(across))
    num_slopes = 0
    r = row
    c = col
    for k in range(1, count + 1):
        # halves are rounded away from the start, so that turning a grid turns the lines
        next_r = row + np.sign(down) * ((2 * abs(down) * k + count) // (2 * count))
        next_c = col + np.sign(across) * ((2 * abs(across) * k + count) // (2 * count))
        reached = np.int64(-1)
        is_slope = -1
        for turn in range(2):  # over a corner, there are two ways, of which one on a slope counts
            by_r, by_c = (next_r, c) if turn == 0 else (r, next_c)
            between, one = _walk_edge(floor, slopes, step, level, r, c, by_r, by_c)
            if between >= 0:
                end, two = _walk_edge(floor, slopes, step, between, by_r, by_c, next_r, next_c)
                if end >= 0 and max(one, two) > is_slope:
                    reached = end
                    is_slope = max(one, two)
        if reached < 0:
            return False
        num_slopes += is_slope
        level = reached
        r = next_r
        c = next_c
    return level == other and num_slopes > 0


@subkernel
def _walk_edge(floor, slopes, step, level, row, col, to_row, to_col):
    """The level on which a step or a slope leads to a neighbour, -1 for none; 1 if by a slope."""
    if to_row == row and to_col == col:
        return level, 0
    if to_row == row:
        there, back = (EAST, WEST) if to_col > col else (WEST, EAST)
    else:
        there, back = (SOUTH, NORTH) if to_row > row else (NORTH, SOUTH)
    height = floor[level, row, col]
    is_steep = slopes[level, row, col] & there != 0
    levels = floor.shape[0]
    for k in range(levels):
        other = (level + k) % levels
        rise = abs(floor[other, to_row, to_col] - height)
        if rise <= step:
            return other, 0
        if is_steep and rise > step and slopes[other, to_row, to_col] & back != 0:
            return other, 1
    return -1, 0
