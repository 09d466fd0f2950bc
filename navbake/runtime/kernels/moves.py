"""Which of its eight neighbours each cell has a step to, computed once for all searches.

Eight bits a cell make the graph that the searches run on: a step costs them one test of a bit, in
place of looking at floors and corners again.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.compiled import kernel, part
from navbake.types import Bool, Float

# Directions: east, north, west, south, then north-east, north-west, south-west, south-east. North
# is row - 1. Bit d of a cell's moves is set where a step leads that way.
EAST, NORTH, WEST, SOUTH = 1, 2, 4, 8
SOUTH_WEST, SOUTH_EAST = 64, 128
ROW_STEP = np.array([0, -1, 0, 1, -1, -1, 1, 1])
COL_STEP = np.array([1, 0, -1, 0, 1, -1, -1, 1])
BESIDE = np.array([0, 0, 0, 0, EAST | NORTH, NORTH | WEST, WEST | SOUTH, SOUTH | EAST])  # a corner


class Footing(NamedTuple):
    """What steps depend on.

    Attributes:
        free: by cell.
        free_diagonally: by cell: with enough clearance for a diagonal step.
        floor, max_step: see `navbake.runtime.kernels.arrays.Floors`.
        cut_corners: whether a diagonal step needs nothing but its target.
        slopes: see `navbake.runtime.flat_grid.FlatGrid`.
    """

    free: Bool
    free_diagonally: Bool
    floor: Float
    max_step: float
    cut_corners: bool
    slopes: NDArray[np.uint8]


@kernel
def find_moves(footing, rect, window, moves):
    """Write the moves of a window of a level: rows and columns, the last ones excluded.

    A move leads to a free neighbour whose floor differs by at most `max_step`, or more on a slope.
    A diagonal one also needs both cells beside it, and steps over either of them, and clearance
    at both its ends, unless corners may be cut.
    """
    free, diagonal, floor, max_step, cut, slopes = footing
    row0, row1, col0, col1 = window
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell = rect.first + row * rect.width + col
            found = 0
            for way in range(8 if free[cell] else 0):
                down, across = ROW_STEP[way] * rect.width, COL_STEP[way]
                if not (0 <= row + ROW_STEP[way] < rect.height and 0 <= col + across < rect.width):
                    continue
                target = cell + down + across
                is_steep = False
                if way >= 4:
                    # a diagonal on a slope is as good as the steps over its corners
                    is_steep = abs(floor[cell] - floor[target]) > max_step
                    if not free[target]:
                        continue
                    if is_steep and not _on_slope(cell, down, across, floor, max_step, slopes):
                        continue
                elif not _joined(cell, target, free, floor, max_step, slopes):
                    continue
                # the four cells of a corner must be connected: `found` has the two edges of this
                # cell already, the last two tests are about those of the target
                if (way < 4 or (cut and not is_steep)) or (
                    found & BESIDE[way] == BESIDE[way]
                    and (cut or (diagonal[cell] and diagonal[target]))
                    and _joined(cell + across, target, free, floor, max_step, slopes)
                    and _joined(cell + down, target, free, floor, max_step, slopes)
                ):
                    found |= 1 << way
            moves[cell] = found


@part
def _on_slope(cell, down, across, floor, max_step, slopes):
    """Whether some edge of a corner is more than a step, so that only a slope can join it."""
    if slopes.shape[0] == 0:
        return False
    one, other, target = cell + across, cell + down, cell + down + across
    return (
        abs(floor[cell] - floor[one]) > max_step
        or abs(floor[cell] - floor[other]) > max_step
        or abs(floor[one] - floor[target]) > max_step
        or abs(floor[other] - floor[target]) > max_step
    )


@part
def _joined(a, b, free, floor, max_step, slopes):
    if not free[b]:
        return False
    if not abs(floor[a] - floor[b]) > max_step:  # so that NaN, no floor, is no step
        return True
    if slopes.shape[0] == 0:
        return False
    bit = EAST if abs(a - b) == 1 else SOUTH
    return slopes[min(a, b)] & bit != 0
