"""Gaps between walls: where the space that runs along a line widens at once.

A direction is scanned along digital lines, which shear the lattice: cell (row, col) lies on line
``row - shift[col]``, so that the cells of a line are connected over edges and corners, every cell
is on one line, and the cell above or below is on the next one. Directions are at most 45° from
the rows; steeper ones scan the lattice with its axes swapped.
"""

import numpy as np
from numba import njit

# The nearest cells of a wall's ends may lie on lines this far apart where a gap goes on [lines]
DRIFT = 2
# How far on either side of a gap the spaces behind it are measured [widths of the gap]
REACH = 2
# The bit of a way that follows its line exactly, see `_hold`
EXACT = 8


@njit(cache=True)
def measure_runs(is_open, shift):
    """The number of open cells in a row along a line through each cell, 0 for closed ones.

    `is_open` is (rows, cols) bool, `shift` (cols,) int64; returns int32 of the cells' shape.
    """
    rows, cols = is_open.shape
    run = np.zeros((rows, cols), dtype=np.int32)
    length = np.zeros(rows + 2 * cols, dtype=np.int32)  # of the run on each line so far
    base = cols
    for col in range(cols):
        offset = base - shift[col]
        for row in range(rows):
            line = row + offset
            # a line that leaves the lattice at its upper or lower edge ends there
            if is_open[row, col]:
                before = row if col == 0 else row - shift[col] + shift[col - 1]
                goes_on = col > 0 and 0 <= before < rows and is_open[before, col - 1]
                length[line] = length[line] + 1 if goes_on else 1
                run[row, col] = length[line]
    for col in range(cols - 2, -1, -1):
        for row in range(rows):
            after = row - shift[col] + shift[col + 1]
            if run[row, col] > 0 and 0 <= after < rows and run[after, col + 1] > 0:
                run[row, col] = run[after, col + 1]
    return run


@njit(cache=True)
def mark_bridges(low, wall, shift, bridge):
    """Mark the `low` cells of ways along a line, which begin and end at a wall.

    A way follows its line exactly; or it keeps within a cell of it where no wall is beside it.
    So thin sills are followed that meet now the one line of cells and now the next, and furniture
    along a wall is not. All are (rows, cols) bool; marks are added to `bridge`.
    """
    rows, cols = low.shape
    held = np.zeros((rows, cols), dtype=np.uint8)  # by a wall at the way's first end
    for col in range(1, cols):
        for row in range(rows):
            before = row + shift[col - 1] - shift[col]
            held[row, col] = _hold(low, wall, row, col, before, col - 1, held)
    ends = np.zeros((rows, cols), dtype=np.uint8)
    for col in range(cols - 2, -1, -1):
        for row in range(rows):
            after = row + shift[col + 1] - shift[col]
            ends[row, col] = _hold(low, wall, row, col, after, col + 1, ends)
            both = held[row, col] & ends[row, col]
            for side in range(3):
                if both & (1 << side):
                    bridge[row + side - 1, col] = True
            if both & EXACT:
                bridge[row, col] = True


@njit(inline="always")
def _hold(low, wall, row, col, next_row, next_col, held):
    """Which cells round a line's cell are low and held by a wall, over the next cell of the line.

    Bits 0 to 2 are for the cells above, on and below the line, bit 3 (`EXACT`) is for the line
    alone. `held` has them for the next cell.
    """
    rows = low.shape[0]
    if next_row < 0 or next_row >= rows:
        return np.uint8(0)
    found = 0
    there = held[next_row, next_col]
    if low[row, col] and (wall[next_row, next_col] or there & EXACT):
        found = EXACT
    first, last = max(row - 1, 0), min(row + 1, rows - 1)
    for other in range(first, last + 1):
        if wall[other, col]:
            return np.uint8(found)
    for other in range(first, last + 1):
        if not low[other, col]:
            continue
        side = other - row + 1
        for beside in range(max(side - 1, 0), min(side + 1, 2) + 1):
            k = next_row + beside - 1
            if 0 <= k < rows and (wall[k, next_col] or there & (1 << beside)):
                found |= 1 << side
    return np.uint8(found)


@njit(cache=True)
def drop_thick(mark, most):
    """Unmark the cells of columns of more than `most` marked cells; `mark` is (rows, cols) bool."""
    rows, cols = mark.shape
    for col in range(cols):
        row = 0
        while row < rows:
            first = row
            while row < rows and mark[row, col]:
                row += 1
            if row - first > most:
                mark[first:row, col] = False
            row += 1


@njit(cache=True)
def mark_gaps(run, widest, growth, rise, thickness, both, gap):
    """Mark the cells of gaps: runs of at most `widest` cells next to much longer ones.

    A run is much longer by the factor `growth` and by `rise` cells. Between two such steps that are
    at most `thickness` lines apart, as in a doorway, all lines are marked; else the last one,
    unless only gaps with steps on `both` sides are wanted. Marks go into `gap`, uint8, of the shape
    of `run`: 2 for a gap with steps on both sides, 1 for others, 0 for none.
    """
    rows, cols = run.shape
    for row in range(rows):
        for col in range(cols):
            here = run[row, col]
            if here == 0 or here > widest:
                continue
            least = max(growth * here, here + rise)
            if row > 0 and run[row - 1, col] >= least:
                gap[row, col] = max(gap[row, col], 0 if both else 1)
                # does it widen again on the other side, a wall's thickness from here?
                for other in range(row, min(row + thickness, rows)):
                    there = run[other, col]
                    # a step to a narrower one ends it, too: the doorway begins there
                    if there == 0 or there > widest or max(growth * there, there + rise) <= here:
                        break
                    if other + 1 < rows and run[other + 1, col] >= max(
                        growth * there, there + rise
                    ):
                        for between in range(row, other + 1):
                            gap[between, col] = 2
                        break
            if not both and row + 1 < rows and run[row + 1, col] >= least:
                gap[row, col] = max(gap[row, col], 1)


@njit(cache=True)
def list_crossings(label, gap, own, thickness):
    """List where one column of cells leads through marked cells from one region to another.

    `label` is (rows, cols) int32, 0 where there is no region; `gap` marks the cells of all gaps,
    `own` those of the gaps of this direction, of which there must be one; at most `thickness` rows
    are crossed. Returns (n, 6) int64: the column, the first and the last marked row, the labels
    above and below, and the highest mark of `own`.
    """
    rows, cols = label.shape
    found = np.empty((0, 6), dtype=np.int64)
    for writing in (False, True):
        count = 0
        for col in range(cols):
            row = 1
            while row < rows - 1:
                if not gap[row, col] or label[row - 1, col] == 0:
                    row += 1
                    continue
                last = row
                while last + 1 < rows and gap[last + 1, col]:
                    last += 1
                if last + 1 < rows:
                    above, below = label[row - 1, col], label[last + 1, col]
                    mark = 0
                    for k in range(row, last + 1):
                        mark = max(mark, own[k, col])
                    if below > 0 and below != above and mark > 0 and last - row < thickness:
                        if writing:
                            found[count, 0], found[count, 1], found[count, 2] = col, row, last
                            found[count, 3], found[count, 4] = above, below
                            found[count, 5] = mark
                        count += 1
                row = last + 1
        if not writing:
            found = np.empty((count, 6), dtype=np.int64)
    return found


@njit(cache=True)
def group_crossings(crossings, shift):
    """Number the gaps that crossings of neighbouring columns between the same regions make up.

    `crossings` are sorted by column. Returns the number of each one's gap, int64, from 0.
    """
    count = len(crossings)
    number = np.empty(count, dtype=np.int64)
    gaps = 0
    begin, end = 0, 0  # the crossings of the column before
    k = 0
    while k < count:
        col = crossings[k, 0]
        first = k
        if end == 0 or crossings[begin, 0] != col - 1:
            begin, end = first, first
        while k < count and crossings[k, 0] == col:
            number[k] = -1
            middle = (crossings[k, 1] + crossings[k, 2]) / 2 - shift[col]
            for before in range(begin, end):
                same = crossings[before, 3] == crossings[k, 3]
                same &= crossings[before, 4] == crossings[k, 4]
                was = (crossings[before, 1] + crossings[before, 2]) / 2 - shift[col - 1]
                if same and abs(was - middle) <= DRIFT:
                    number[k] = number[before]
                    break
            if number[k] < 0:
                number[k] = gaps
                gaps += 1
            k += 1
        begin, end = first, k
    return number


@njit(cache=True)
def measure_gap(label, is_open, whole, shift, gap, depths):
    """How open the line of a gap is, seen from the region above it and from the one below.

    Behind the gap, at each depth, a line runs along it as far as the region reaches, but on either
    side no further than the gap is wide, times `REACH`. Of that length, the gap is a share,
    together with other openings in its line to the same region, which also count as its width.

    Args:
        label: (rows, cols) int32, 0 where there is no region.
        is_open: (rows, cols) bool.
        whole: the region that each one is part of, by label.
        gap: first and last column, first and last row at both of them, labels above and below:
            (8,) int64.
        depths: (n,) int64 [rows].

    Returns:
        The least share over all depths, of either side.
    """
    first, last = gap[0], gap[1]
    above, below = whole[gap[6]], whole[gap[7]]
    width = last - first + 1
    shares = np.ones(2)
    for side in range(2):
        own, other = (above, below) if side == 0 else (below, above)
        for depth in depths:
            length, through = width, width
            for end in range(2):
                way = -1 if end == 0 else 1
                start = first if end == 0 else last
                top = gap[2] if end == 0 else gap[4]
                bottom = gap[3] if end == 0 else gap[5]
                reached, opened, met = 0, 0, 0
                for step in range(1, label.shape[1]):
                    col = start + way * step
                    if step > REACH * (width + opened) or col < 0 or col >= label.shape[1]:
                        break
                    down = shift[col] - shift[start]
                    up_row, low_row = top + down - depth, bottom + down + depth
                    row, opposite = (up_row, low_row) if side == 0 else (low_row, up_row)
                    middle = (top + bottom) // 2 + down
                    if row < 0 or row >= label.shape[0] or not is_open[row, col]:
                        break
                    here = label[row, col]
                    if here > 0 and whole[here] != own:
                        break
                    if 0 <= middle < label.shape[0] and 0 <= opposite < label.shape[0]:
                        there = label[opposite, col]
                        if is_open[middle, col] and there > 0 and whole[there] == other:
                            opened += 1
                    if here > 0:
                        reached, met = step, opened
                length += reached
                through += met
            shares[side] = min(shares[side], through / length)
    return shares[0], shares[1]


@njit(cache=True)
def measure_gaps(label, is_open, whole, shift, gaps, depths):
    """The shares of several gaps of one direction, (n, 2) float64; see `measure_gap`."""
    shares = np.ones((len(gaps), 2))
    for k in range(len(gaps)):
        if whole[gaps[k, 6]] != whole[gaps[k, 7]]:
            shares[k] = measure_gap(label, is_open, whole, shift, gaps[k], depths)
    return shares
