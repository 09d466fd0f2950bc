"""Which of its eight neighbours each cell has a step to, worked out once for all searches.

Eight bits a cell make the graph that the searches run on: a step costs them one test of a bit, in
place of looking at floors and corners again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from navbake.types import Bool, Float

# Directions: east, north, west, south, then north-east, north-west, south-west, south-east. North
# is row - 1. Bit d of a cell's moves is set where a step leads that way.
EAST, NORTH, WEST, SOUTH = 1, 2, 4, 8
SOUTH_WEST, SOUTH_EAST = 64, 128
ROW_STEP = np.array([0, -1, 0, 1, -1, -1, 1, 1])
COL_STEP = np.array([1, 0, -1, 0, 1, -1, -1, 1])


class Footing(NamedTuple):
    """What steps depend on.

    Attributes:
        free: by cell, bool.
        free_diagonally: by cell, bool: with room round it for a diagonal step.
        floor: by cell [m], float64, NaN where there is none.
        max_step: by how much the floors of neighbours may differ [m], slack included.
        cut_corners: whether a diagonal step needs nothing but its target.
    """

    free: Bool
    free_diagonally: Bool
    floor: Float
    max_step: float
    cut_corners: bool


@njit(cache=True, error_model="numpy")
def find_moves(footing, rect, window, moves):
    """Find the moves of a rectangle of cells on one level.

    A move leads to a free neighbour whose floor differs by at most `max_step`; a cell without
    floor height is level with its neighbours. A diagonal one also needs both cells beside it, and
    steps over either of them, and room at both its ends, unless corners may be cut.

    Args:
        footing: a `Footing`.
        rect: the level, a `navbake.runtime.kernels.arrays.Rect`.
        window: first and last row, first and last column, the last ones excluded.
        moves: by cell, uint8; written within the window.
    """
    free, free_diagonally, floor, max_step, cut_corners = footing
    row0, row1, col0, col1 = window
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell = rect.first + row * rect.width + col
            found = 0
            if free[cell]:
                around = _edges(cell, row, col, rect, free, floor, max_step)
                found = around | _corners(
                    cell, row, col, rect, free, floor, max_step, around, free_diagonally,
                    cut_corners,
                )  # fmt: skip
            moves[cell] = found


@njit(cache=True, error_model="numpy")
def _joined(a, b, free, floor, max_step):
    return free[b] and not abs(floor[a] - floor[b]) > max_step  # so that NaN, no floor, is no step


@njit(cache=True, error_model="numpy")
def _edges(cell, row, col, rect, free, floor, max_step):
    """Moves over the edges of a cell."""
    found = 0
    if col + 1 < rect.width and _joined(cell, cell + 1, free, floor, max_step):
        found |= EAST
    if row > 0 and _joined(cell, cell - rect.width, free, floor, max_step):
        found |= NORTH
    if col > 0 and _joined(cell, cell - 1, free, floor, max_step):
        found |= WEST
    if row + 1 < rect.height and _joined(cell, cell + rect.width, free, floor, max_step):
        found |= SOUTH
    return found


@njit(cache=True, error_model="numpy")
def _corners(cell, row, col, rect, free, floor, max_step, around, free_diagonally, cut_corners):
    """Moves over the corners of a cell, given those over its edges."""
    found = 0
    for d in range(4):
        across = 1 if d == 0 or d == 3 else -1
        down = -1 if d < 2 else 1
        if not (0 <= col + across < rect.width and 0 <= row + down < rect.height):
            continue
        one, other = cell + across, cell + down * rect.width
        target = other + across
        if not _joined(cell, target, free, floor, max_step):
            continue
        if not cut_corners:
            # the four cells of the corner must hang together: `around` knows of the two edges of
            # this cell, the last test is about the two edges of the target
            both = (EAST if across > 0 else WEST) | (NORTH if down < 0 else SOUTH)
            if (
                around & both != both
                or not (free_diagonally[cell] and free_diagonally[target])
                or not (
                    _joined(one, target, free, floor, max_step)
                    and _joined(other, target, free, floor, max_step)
                )
            ):
                continue
        found |= 16 << d
    return found
