"""Outlines of parts of cells, along the cells' edges: contour following with crack codes.

Each side between a cell and a neighbour of another part is a step that has its cell on the left.
A walk over these steps turns right wherever a cell of its part lies ahead on the right, also where
it touches its own by a corner alone, goes on where one lies ahead, and turns left else (Freeman
1961; crack codes: Rosenfeld and Kak, Digital Picture Processing, 1982). The cells of a part are
connected by their sides, so what lies on both sides of such a corner isn't, and no ring of corners
has a corner twice.
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
    corners, of_part = np.empty((num_sides, 2), np.int32), np.empty(num_sides // 4, np.int32)
    starts = np.zeros(num_sides // 4 + 1, np.int64)
    walked = np.zeros(parts.shape, np.bool_)  # along the north side
    num_corners, num_rings = 0, 0
    for row0 in range(1, parts.shape[0] - 1):
        for col0 in range(1, parts.shape[1] - 1):
            part = parts[row0, col0]
            # each ring has a north side
            if part == 0 or walked[row0, col0] or parts[row0 - 1, col0] == part:
                continue
            row, col, way = row0, col0, WEST
            while True:
                if way == WEST:
                    walked[row, col] = True
                end_row, end_col = row + ROW_END[way] - 1, col + COL_END[way] - 1
                right, last = (way + 3) % 4, way
                row_ahead, col_ahead = row + ROW_STEP[way], col + COL_STEP[way]
                row_right, col_right = row_ahead + ROW_STEP[right], col_ahead + COL_STEP[right]
                if parts[row_right, col_right] == part:
                    row, col, way = row_right, col_right, right
                elif parts[row_ahead, col_ahead] == part:
                    row, col = row_ahead, col_ahead
                else:
                    way = (way + 1) % 4
                if way != last:
                    corners[num_corners] = end_row, end_col
                    num_corners += 1
                if row == row0 and col == col0 and way == WEST:
                    break
            of_part[num_rings] = part
            num_rings += 1
            starts[num_rings] = num_corners
    return corners[:num_corners], starts[: num_rings + 1], of_part[:num_rings]
