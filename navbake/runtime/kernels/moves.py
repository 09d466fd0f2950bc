"""Which of its eight neighbours each cell has a step to."""

from __future__ import annotations

from numba import njit

# Directions: east, north, west, south, then north-east, north-west, south-west, south-east. North
# is row - 1. Bit d of a cell's moves is set where a step leads that way.
EAST, NORTH, WEST, SOUTH = 1, 2, 4, 8
SOUTH_WEST, SOUTH_EAST = 64, 128
STRAIGHT = 15


@njit(cache=True, error_model="numpy")
def find_moves(
    moves, first, width, height, row0, row1, col0, col1, free, wide, floor, max_step, cut_corners
):
    """Find the moves of a rectangle of cells on one level.

    A move leads to a free neighbour whose floor differs by at most `max_step`; a cell without
    floor height is level with its neighbours. A diagonal one also needs both cells beside it, and
    steps over either of them, and room at both its ends, unless corners may be cut.

    Args:
        moves: by flat id, uint8; of the rectangle, written.
        first: flat id of the level's first cell.
        width, height: of the level.
        row0, row1, col0, col1: the rectangle, row1 and col1 excluded.
        free: by flat id, bool.
        wide: by flat id, bool: cells with room round them for a diagonal step.
        floor: by flat id [m], NaN where there is none.
        max_step: [m], slack included.
        cut_corners: whether a diagonal move needs nothing but its target.
    """
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell = first + row * width + col
            found = 0
            if free[cell]:
                around = _edges(cell, row, col, width, height, free, floor, max_step)
                found = around | _corners(
                    cell, row, col, width, height, free, wide, floor, max_step, around, cut_corners
                )
            moves[cell] = found


@njit(cache=True, error_model="numpy")
def _joined(a, b, free, floor, max_step):
    return free[b] and not abs(floor[a] - floor[b]) > max_step  # NaN is no step


@njit(cache=True, error_model="numpy")
def _edges(cell, row, col, width, height, free, floor, max_step):
    """Moves over the edges of a cell."""
    found = 0
    if col + 1 < width and _joined(cell, cell + 1, free, floor, max_step):
        found |= EAST
    if row > 0 and _joined(cell, cell - width, free, floor, max_step):
        found |= NORTH
    if col > 0 and _joined(cell, cell - 1, free, floor, max_step):
        found |= WEST
    if row + 1 < height and _joined(cell, cell + width, free, floor, max_step):
        found |= SOUTH
    return found


@njit(cache=True, error_model="numpy")
def _corners(cell, row, col, width, height, free, wide, floor, max_step, around, cut_corners):
    """Moves over the corners of a cell, given those over its edges."""
    found = 0
    for d in range(4):
        across = 1 if d == 0 or d == 3 else -1
        down = -1 if d < 2 else 1
        if not (0 <= col + across < width and 0 <= row + down < height):
            continue
        one, other = cell + across, cell + down * width
        target = other + across
        if not _joined(cell, target, free, floor, max_step):
            continue
        if not cut_corners:
            both = (EAST if across > 0 else WEST) | (NORTH if down < 0 else SOUTH)
            if (
                around & both != both
                or not (wide[cell] and wide[target])
                or not (
                    _joined(one, target, free, floor, max_step)
                    and _joined(other, target, free, floor, max_step)
                )
            ):
                continue
        found |= 16 << d
    return found
