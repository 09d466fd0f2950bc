"""Kernels of rooms: gaps between walls, sills between walls, and distances to walls.

A direction is scanned along digital lines, which shear the lattice: cell (row, col) lies on line
``row - shift[col]``, so that the cells of a line are connected over edges and corners. Directions
are at most 45° from the rows; steeper ones scan the lattice with its axes swapped.

Squared Euclidean distances are found in two passes, as they separate by axis (Saito and Toriwaki,
1994). Only those up to a reach matter: the lowest of all parabolas within it, which vectorizes.
"""

from typing import NamedTuple

import numpy as np

from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Bool, Int, Int32

# Walls farther from the centres of lines' end cells are ignored [columns]
FAR = 4.0
# How far on either side of a gap the spaces behind it are measured [widths of the gap]
REACH = 2
# Two spaces are one where the gap between them is at least this share of both, or of the narrower;
# but a passage is a space of its own where the other one is wider by this factor
BOTH = 0.8
NARROWER = 0.78
WIDER = 1.5
# Widths are measured on the walls' geometry where so many cells could decide about these shares
WAVERING = 2.0
DECIDING = (BOTH, NARROWER, 1 / WIDER)
# A doorway's lines differ by so many columns, as its jambs waver in the lattice
JITTER = 2.0
# The bit of a way that follows its line exactly, see `_hold`
EXACT = 8
# The bits of the cells that are at most one line from the one above, on and below the line
BESIDE = 0b011, 0b111, 0b110


class Gaps(NamedTuple):
    """All gaps found in one scan direction, as parallel arrays."""

    first: Int  # column
    last: Int
    top: Int  # the first marked row in these two columns, (n, 2)
    bottom: Int  # the last one
    above: Int  # the labels of the regions on both sides
    below: Int
    is_doorway: Bool  # the space widens on both sides


class Scan(NamedTuple):
    """A lattice as it is scanned in a direction, shape (rows, cols)."""

    label: Int32  # the region of each cell, 0 for none
    is_open: Bool
    shift: Int  # the line's row in each column less that in the first, (cols,)
    depths: Int  # how far behind gaps to measure [rows]
    leans: Int  # how many columns a line at right angles goes along on the way up so far


@subkernel
def measure_runs(is_open, shift, marked):
    """The length of the run of open cells along a line through each cell, 0 for closed ones.

    Where one cell of a run is `marked`, all of the run is marked.
    """
    rows, cols = is_open.shape
    run = np.zeros((cols, rows), dtype=np.int32).T
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
                # two lines of cells that touch at corners only don't cross
                goes_on = goes_on and (is_open[before, col] or is_open[row, col - 1])
                length[line] = length[line] + 1 if goes_on else 1
                marked[row, col] |= goes_on and marked[before, col - 1]
                run[row, col] = length[line]
    for col in range(cols - 2, -1, -1):
        for row in range(rows):
            after = row - shift[col] + shift[col + 1]
            if run[row, col] == 0 or not 0 <= after < rows or run[after, col + 1] == 0:
                continue
            if is_open[after, col] or is_open[row, col + 1]:
                run[row, col] = run[after, col + 1]
                marked[row, col] |= marked[after, col + 1]
    return run


@kernel(nogil=True)
def mark_gaps(is_open, shift, near, widest, growth, rise, thickness, both, gap):
    """Mark the cells of gaps: runs along lines of at most `widest` cells next to much longer ones.

    A run counts if a cell of it is `near` a wall along the line, which is spread to all its cells.
    Much longer is by the factor `growth` and by `rise` cells. Between two such steps at most
    `thickness` lines apart, as in a doorway, all lines are marked 2 in `gap`, uint8, from end to
    end; else the last one is marked 1, unless only gaps with steps on `both` sides are wanted.
    """
    run = measure_runs(is_open, shift, near)
    rows, cols = run.shape
    for col in range(cols):
        for row in range(rows):
            here = run[row, col]
            if here == 0 or here > widest or not near[row, col]:
                continue
            least = max(growth * here, here + rise)
            if row > 0 and run[row - 1, col] >= least:
                gap[row, col] = max(gap[row, col], 0 if both else 1)
                # does it widen again on the other side, a wall's thickness from here?
                for other in range(row, min(row + thickness, rows)):
                    there = run[other, col]
                    # a step to a narrower one ends it, too: the doorway begins there
                    narrower = max(growth * there, there + rise + JITTER) < here
                    if there == 0 or there > widest or narrower:
                        break
                    if other + 1 < rows and run[other + 1, col] >= max(
                        growth * there, there + rise
                    ):
                        for between in range(row, other + 1):
                            if gap[between, col] < 2:
                                _mark_doorway(run, shift, between, col, gap)
                        break
            if not both and row + 1 < rows and run[row + 1, col] >= least:
                gap[row, col] = max(gap[row, col], 1)


@subkernel
def _mark_doorway(run, shift, row, col, gap):
    """Mark all of a cell's run as a doorway's, see `measure_runs`."""
    gap[row, col] = 2
    for way in (-1, 1):
        here = row
        end = col + way
        while 0 <= end < len(shift):
            there = here - shift[end - way] + shift[end]
            if not 0 <= there < len(run) or run[there, end] == 0 or gap[there, end] == 2:
                break
            if run[there, end - way] == 0 and run[here, end] == 0:
                break  # between two closed cells that touch at their corners
            gap[there, end] = 2
            here = there
            end = end + way


@kernel(nogil=True)
def mark_bridges(low, wall, shift, bridge):
    """Mark in `bridge` the `low` cells of ways along a line, which begin and end at a wall.

    A way follows its line exactly, or within a cell where no wall is beside it and the line itself
    meets the walls at its ends. So ways follow thin sills that alternate between two lines of
    cells, but not furniture along a wall.
    """
    rows, cols = low.shape
    low = low.T
    wall = wall.T
    held = np.zeros((cols, rows), dtype=np.uint8)  # by a wall at the way's first end
    for col in range(1, cols):
        to_before = shift[col - 1] - shift[col]
        _hold(low[col], wall[col], to_before, wall[col - 1], held[col - 1], held[col])
    ends = np.zeros((cols, rows), dtype=np.uint8)
    for col in range(cols - 2, -1, -1):
        to_after = shift[col + 1] - shift[col]
        _hold(low[col], wall[col], to_after, wall[col + 1], ends[col + 1], ends[col])
        for row in range(rows):
            both = held[col, row] & ends[col, row]
            if both == 0:
                continue
            for side in range(3):
                if both & (1 << side):
                    bridge[row + side - 1, col] = True
            if both & EXACT:
                bridge[row, col] = True


@subkernel(**NO_REFCOUNT)
def _hold(low, wall, to_next, next_wall, held, found):
    """Which cells above, on and below a line (bits 0 to 2) are low and held by a wall; or `EXACT`.

    `found` receives the bits of a column; the next column of the lines is `to_next` rows down.
    """
    rows = low.shape[0]
    for row in range(max(0, -to_next), min(rows, rows - to_next)):
        at_wall = next_wall[row + to_next]
        there = held[row + to_next]
        first = max(row - 1, 0)
        last = min(row + 1, rows - 1)
        if there == 0 and not at_wall:  # most cells: nothing there holds anything
            continue
        bits = EXACT if low[row] and (at_wall or there & EXACT) else 0
        if not (wall[first] or wall[row] or wall[last]):
            for other in range(first, last + 1):
                side = other - row + 1
                if low[other] and (at_wall or there & BESIDE[side]):
                    bits |= 1 << side
        found[row] = bits


@kernel
def measure_gaps(scan, gaps, chosen, whole, walls):
    """Measure lines behind some gaps, parallel to them, in the regions above and below.

    At each depth a line runs as far as the region reaches, but beyond the gap's ends at most
    `REACH` times its width. Other openings in the gap's line to the same region count as its width.
    A region that ends before the first depth is measured where it ends. `whole` is the current
    region of each label.

    Widths are measured up to walls; lengths in cells, or up to walls where at most `WAVERING` cells
    keep the least share from one of the `DECIDING` ones. `walls`: how far they are from the centres
    of gaps' end cells, (gaps, 2), and at most from those of openings, (gaps,) [columns]; and what
    is known of them by cell and end, see `WallRays.look`.

    Returns:
        By gap, side and depth, int64: the length of the line, the width of the gap, and that of
        such openings before and after it [columns]; the cells at which it ends at a wall before
        and after, and the last cells of such openings, -1 for none; of these also where the line
        ends at no wall. Nothing is measured if both sides are one region.
        By gap and side, the least share of a line that is the gap's width and such openings.
        By gap, whether its shares wait for walls that are not known yet.
        Pairs of gaps and other regions that their lines met: only if one of these is joined, the
        lines change.
    """
    beside, far, known = walls
    lines = np.empty((len(chosen), 2, len(scan.depths), 8), np.int64)
    shares = np.empty((len(chosen), 2))
    waits = np.empty(len(chosen), np.bool_)
    openings = np.empty((2, len(scan.depths)))
    met = [(np.int64(-1), np.int64(-1))]
    for i in range(len(chosen)):
        k = chosen[i]
        above = np.int64(whole[gaps.above[k]])
        below = np.int64(whole[gaps.below[k]])
        wavers = False
        waits[i] = False
        for side in range(2):
            shares[i, side] = 1.0
            for depth in range(len(scan.depths)):
                for number in range(lines.shape[3]):
                    lines[i, side, depth, number] = -1
        for side in range(0 if above == below else 2):
            own, other = (above, below) if side == 0 else (below, above)
            # how many open rows lie behind the gap in its middle, up to the first depth
            ends, way = (gaps.top[k], -1) if side == 0 else (gaps.bottom[k], 1)
            row = (ends[0] + ends[1]) // 2
            col = (gaps.first[k] + gaps.last[k]) // 2
            deep = 0
            while deep < scan.depths[0] and 0 <= row + way * (deep + 1) < len(scan.is_open):
                if not scan.is_open[row + way * (deep + 1), col]:
                    break
                deep += 1
            shortest = len(scan.shift)
            for depth in range(len(scan.depths)):
                measured = lines[i, side, depth]
                rows = scan.depths[depth]
                lean = scan.leans[depth]
                if depth == 0 and deep < rows:
                    rows, lean = np.int64(max(deep, 1)), lean if rows == 1 else np.int64(0)
                _measure_line(scan, gaps, k, (side, rows, lean, own, other), whole, met, measured)
                width = 0.0
                for end in range(2):
                    # up to the wall at the gap's end, or at that of openings beyond it
                    passed = measured[2 + end]
                    cell = measured[6 + end]
                    if passed > 0:
                        waits[i] |= cell >= 0 and known[cell, end] == 0.0
                        width += passed + _beyond(known, cell, end, far[k])
                    else:
                        width += beside[k, end]
                openings[side, depth] = measured[1] - 1 + width
                shares[i, side] = min(shares[i, side], openings[side, depth] / measured[0])
                shortest = min(shortest, measured[0])
            for share in DECIDING:
                wavers |= abs(shares[i, side] - share) * shortest <= WAVERING
        # for others it makes no difference where in the last cells the walls begin
        for side in range(2 if wavers else 0):
            shares[i, side] = 1.0
            for depth in range(len(scan.depths)):
                measured = lines[i, side, depth]
                length = 0.0
                for end in range(2):
                    cell = measured[4 + end]
                    waits[i] |= cell >= 0 and known[cell, end] == 0.0
                    length += _beyond(known, cell, end, FAR)
                share = openings[side, depth] / (measured[0] - 1 + length)
                shares[i, side] = min(shares[i, side], share)
    return lines, shares, waits, met[1:]


@subkernel
def _beyond(known, cell, end, far):
    """How far the wall is from a cell's centre; half a column without a cell or a wall so near."""
    if cell < 0 or not 1.0 <= known[cell, end] <= far + 1.0:
        return 0.5
    return known[cell, end] - 1.0


@subkernel
def _meet(met, k, region):
    """List that lines of gap k met a region, once."""
    for n in range(len(met) - 1, 0, -1):
        if met[n][0] != k:
            break
        if met[n][1] == region:
            return
    met.append((k, region))


@subkernel
def _measure_line(scan, gaps, k, line, whole, met, measured):
    """Measure a line behind gap k; `met` receives the regions that it meets.

    `line` is its side (0 above, 1 below), how many rows behind the gap it is and how many columns
    it leans on the way up so far, and the regions on its side and on the other one.
    """
    side, depth, rise, own, other = line
    label = scan.label
    is_open = scan.is_open
    shift = scan.shift
    rows, cols = label.shape
    # from the gap to the line behind it, and on the other side to that before it
    down = -depth if side == 0 else depth
    lean = rise if side == 0 else -rise
    width = gaps.last[k] - gaps.first[k] + 1
    length = width
    whole_width = width
    # first to find how wide the opening is that this gap is a part of
    for is_last in (False, True):
        for end in range(2):
            way = -1 if end == 0 else 1
            start = gaps.first[k] if end == 0 else gaps.last[k]
            top = gaps.top[k, end]
            bottom = gaps.bottom[k, end]
            near_row, far_row = (top, bottom) if side == 0 else (bottom, top)
            reached = 0
            opened = 0
            passed = 0
            last = np.int64(-1)
            through = np.int64(-1)
            for step in range(cols):
                col = start + way * step
                near = col + lean
                far = col - lean
                most = max(whole_width, width + opened) if is_last else np.int64(cols)
                if step > REACH * most or not 0 <= near < cols:
                    last = np.int64(-1)
                    break
                row = near_row + down + shift[near] - shift[start]
                if not 0 <= row < rows or not is_open[row, near]:
                    if step == 0:
                        continue  # there is wall beside the gap's end
                    if last >= 0:
                        reached = step - 1
                        passed = opened
                    break
                here = np.int64(whole[label[row, near]])
                last = row * cols + near
                if step == 0:
                    continue
                if here > 0 and here != own:
                    _meet(met, k, here)
                    last = np.int64(-1)
                    break
                if 0 <= col < cols and 0 <= far < cols:
                    on = shift[col] - shift[start]
                    opposite = far_row - down + shift[far] - shift[start]
                    is_through = top + on >= 0 and bottom + on < rows and 0 <= opposite < rows
                    # no wall anywhere between: one row may miss a thin wall at an angle
                    for middle in range(top + on, bottom + on + 1 if is_through else 0):
                        is_through &= is_open[middle, col]
                    if is_through and is_open[opposite, far]:
                        there = np.int64(whole[label[opposite, far]])
                        # another gap that ends here has no label: the line goes on beyond it
                        if there == other or there == 0:
                            opened += 1
                            through = ((top + bottom) // 2 + on) * cols + col
                        elif there > 0:
                            _meet(met, k, there)
                if here > 0:
                    reached = step
                    passed = opened
                if not is_last and opened < step:
                    break
            if is_last:
                length += reached
                measured[2 + end] = passed
                measured[4 + end] = last
                measured[6 + end] = through if passed > 0 and last >= 0 else np.int64(-1)
            else:
                whole_width += opened
    measured[0] = length
    measured[1] = width


@kernel(nogil=True)
def sweep(target, reach, along, squared, first, end):
    """Find distances to a target, in two calls: within columns, and then across them.

    Args:
        target: where it is, bool.
        reach: how far distances matter; beyond they are ``reach + 1``.
        along: receives distances within the columns ``range(first, end)``, int16.
        squared: receives squared distances in the rows ``range(first, end)``, from those in the
            columns, int32; empty for the first call.
    """
    if squared.shape[0] == 0:
        _sweep_columns(target[:, first:end], np.int16(reach + 1), along[:, first:end])
    else:
        _sweep_rows(along, reach, squared, first, end)


@subkernel
def _sweep_columns(target, far, along):
    rows, cols = target.shape  # of some columns: loops from 0 vectorize
    for col in range(cols):
        along[0, col] = 0 if target[0, col] else far
    for row in range(1, rows):
        for col in range(cols):
            step = min(along[row - 1, col] + np.int16(1), far)
            along[row, col] = 0 if target[row, col] else step
    for row in range(rows - 2, -1, -1):
        for col in range(cols):
            along[row, col] = min(along[row, col], along[row + 1, col] + np.int16(1))


@subkernel
def _sweep_rows(along, reach, squared, first, end):
    cols = along.shape[1]
    beyond = np.int32((reach + 1) ** 2)
    squares = np.empty(cols + 2 * reach, np.int32)
    for col in range(reach):
        squares[col] = squares[cols + reach + col] = beyond
    for row in range(first, end):
        nearest = squared[row]
        for col in range(cols):
            value = np.int32(along[row, col])
            squares[col + reach] = value * value
            nearest[col] = beyond
        for shift in range(2 * reach + 1):
            add = np.int32((shift - reach) ** 2)
            shifted = squares[shift : shift + cols]
            for col in range(cols):
                nearest[col] = min(nearest[col], np.int32(shifted[col] + add))
