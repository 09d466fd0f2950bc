"""Outlines of parts of cells, along the cells' edges: contour following with crack codes.

Each side between a cell and a neighbour of another part is a step that has its cell on the left.
A walk over these steps, which turns left wherever it can stay with its cell, closes round each
connected part and each hole of it (Freeman 1961; crack codes: Rosenfeld and Kak, Digital Picture
Processing, 1982). Where a part touches itself at a corner, the walk comes there twice, and is cut
in two: so no ring of corners has a corner twice.
"""

import numpy as np

from navbake.compiled import kernel

# Ways: east, north, west, south; a walk runs along the south, east, north, west side of its cell.
# North is row - 1. A left turn is the next way.
ROW_STEP = np.array([0, -1, 0, 1])
COL_STEP = np.array([1, 0, -1, 0])
# where a step ends: the corner of its cell, from the upper left one
ROW_END = np.array([1, 0, 0, 1])
COL_END = np.array([1, 1, 0, 0])
WEST = 2


@kernel
def trace_rings(parts, num_sides):
    """Trace the rings of parts of cells, numbered from 1, in a border of zeros.

    Returns:
        The corners of all rings, row and column of corners of cells (0, 0 is the upper left one of
        the first cell without the border), shape (n, 2), int32; where each ring starts among them,
        and n, int64; and the part that each ring is of, int32. Seen with rows downwards, outer
        rings run anticlockwise and holes clockwise.
    """
    corners, stack = np.empty((num_sides, 2), np.int32), np.empty((num_sides, 2), np.int32)
    starts, of_part = np.empty(num_sides // 4 + 1, np.int64), np.empty(num_sides // 4, np.int32)
    place = np.zeros((parts.shape[0] - 1, parts.shape[1] - 1), np.int32)  # in the stack, from 1
    walked = np.zeros(parts.shape, np.bool_)  # along the north side
    num_corners, num_rings = 0, 0
    starts[0] = 0
    for row0 in range(1, parts.shape[0] - 1):
        for col0 in range(1, parts.shape[1] - 1):
            part = parts[row0, col0]
            # each ring has a north side
            if part == 0 or walked[row0, col0] or parts[row0 - 1, col0] == part:
                continue
            row, col, way, top = row0, col0, WEST, 0
            while True:
                if way == WEST:
                    walked[row, col] = True
                end_row, end_col = row + ROW_END[way] - 1, col + COL_END[way] - 1
                row_ahead, col_ahead = row + ROW_STEP[way], col + COL_STEP[way]
                right = (way + 3) % 4
                turns = True
                if parts[row_ahead, col_ahead] != part:
                    way = (way + 1) % 4
                elif parts[row_ahead + ROW_STEP[right], col_ahead + COL_STEP[right]] == part:
                    row, col, way = row_ahead + ROW_STEP[right], col_ahead + COL_STEP[right], right
                else:
                    row, col, turns = row_ahead, col_ahead, False
                if turns:
                    known = place[end_row, end_col]
                    if known == 0:
                        stack[top] = end_row, end_col
                        top += 1
                        place[end_row, end_col] = top
                    else:  # the way since then is a ring of its own
                        for k in range(known - 1, top):
                            corners[num_corners] = stack[k]
                            num_corners += 1
                            if k >= known:
                                place[stack[k, 0], stack[k, 1]] = 0
                        top = known
                        of_part[num_rings] = part
                        num_rings += 1
                        starts[num_rings] = num_corners
                if row == row0 and col == col0 and way == WEST:
                    break
            for k in range(top):
                corners[num_corners] = stack[k]
                num_corners += 1
                place[stack[k, 0], stack[k, 1]] = 0
            of_part[num_rings] = part
            num_rings += 1
            starts[num_rings] = num_corners
    return corners[:num_corners], starts[: num_rings + 1], of_part[:num_rings]
