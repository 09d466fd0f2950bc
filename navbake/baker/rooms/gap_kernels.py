"""Kernels for dividing floors into rooms at gaps.

`gaps.py` calls `mark_gaps`, which finds gaps (narrow places of the floor, such as doorways), and
`measure_gaps`, which measures the spaces beside them. `walls.py` calls `mark_sills`, which finds
sills between walls, and `sweep_distances`, which measures distances.

A scan in a direction follows parallel lines of cells: cell (row, col) is on line
``row - shift[col]``, and the cells of a line are connected by edges or corners. The direction is at
most 45° from the lattice's rows; for a steeper direction, rows and columns of the lattice are
swapped. A line has one cell in each column, so lengths along it are counted in columns. "Above"
means lower row numbers.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.rooms.gap_limits import (
    DECIDING_CELLS,
    DECIDING_SHARES,
    JAMB_JITTER,
    MAX_LINE_EXTENSION,
    MAX_WALL_DISTANCE,
)
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Bool, Float, Int, Int32

Marks = NDArray[np.uint8]
"""How each cell is marked: 0 if it is in no gap, `ONE_SIDED` or `DOORWAY` if it is in one."""

# The floor is wider on one side of the gap; or on both, as it is at a doorway
ONE_SIDED = 1
DOORWAY = 2

# The ends of a gap, and of a line of cells: at the first column, and at the last
FIRST_END = 0
LAST_END = 1
# The sides of a gap
ABOVE = 0
BELOW = 1

# For `mark_sills`: bits of a cell on a line, for chains of low cells that end in the cell's column.
# Bits 0, 1 and 2: a chain that stays within one cell of the line ends in the cell above this cell,
# in it, or in the cell below it. EXACT_CHAIN: a chain exactly on the line ends in this cell
EXACT_CHAIN = 8
# By the side of the line that a cell is on, 0 above, 1 on, 2 below it: the bits of the cell on the
# line in the next column for chains that end in a cell that touches this one
BITS_OF_TOUCHING_CHAINS = 0b011, 0b111, 0b110
# For `sweep_distances`: so many cells of a row end together
SWEPT_COLUMNS = 256


class GapLimits(NamedTuple):
    """The limits by which `mark_gaps` marks gaps.

    Attributes:
        max_width: the greatest width of a gap [columns].
        widening_factor: the least factor by which the floor beside a gap is wider, > 1.
        min_widening: the least length by which the floor beside a gap is wider [columns].
        max_thickness: the greatest depth of a doorway from one side of the wall to the other
            [rows].
        marks_only_doorways: whether gaps are only marked if the floor is wider on both sides.
    """

    max_width: int
    widening_factor: float
    min_widening: float
    max_thickness: int
    marks_only_doorways: bool


class Gaps(NamedTuple):
    """The gaps of one scan direction, as parallel arrays of n gaps.

    A gap is a strip of marked cells between two spaces (connected parts of the floor), which goes
    on from column to column. "Above" and "below" a gap mean lower and higher row numbers.

    Attributes:
        first_col: the gap's first column, shape (n,), int64.
        last_col: the gap's last column, shape (n,), int64.
        top_row: the first marked row in the first and in the last column, shape (n, 2), int64.
        bottom_row: the last marked row in these two columns, shape (n, 2), int64.
        label_above: the label of the space above the gap, shape (n,), int64.
        label_below: the label of the space below the gap, shape (n,), int64.
        is_doorway: whether a cell of the gap is marked `DOORWAY`, shape (n,).
    """

    first_col: Int
    last_col: Int
    top_row: Int
    bottom_row: Int
    label_above: Int
    label_below: Int
    is_doorway: Bool


class Scan(NamedTuple):
    """A lattice as it is scanned in a direction, along parallel lines of cells.

    Attributes:
        label: the space of each cell before spaces are joined, 0 for none, shape (rows, cols).
        is_open: a mask of the cells that a line can pass through, shape (rows, cols).
        shift: for each column, how many rows lower a line is than in the first column, shape
            (cols,).
        depths: the distances behind gaps at which spaces are measured, shape (depths,) [rows].
        leans: for each depth: a line perpendicular to the direction that goes up by that depth gets
            this many columns to the right, shape (depths,).
    """

    label: Int32
    is_open: Bool
    shift: Int
    depths: Int
    leans: Int


class GapWalls(NamedTuple):
    """Distances along a scan direction from cells beside walls to these walls [columns].

    Attributes:
        end_distance: from the centres of each gap's first and last cell to the walls, shape (gaps,
            2).
        max_distance: for each gap, how far a wall may be from the centre of the last cell and still
            count as its end, shape (gaps,). The last cell is the gap's, or that of further gaps in
            line with it between the same two spaces (openings).
        rays_of_cell: the index of each cell's two rays, 0 if none was cast from the cell, shape
            (cells,).
        coded_distance: for two rays, backward and forward along the direction: the distance to the
            wall plus 1; inf if there is no wall; 0 if the ray was not cast yet; shape (pairs of
            rays, 2). See `CastRays`.
    """

    end_distance: Float
    max_distance: Float
    rays_of_cell: Int32
    coded_distance: Float


class GapLines(NamedTuple):
    """Lines of cells along which the width of the spaces behind gaps is measured.

    Lines are parallel to their gap: one for each gap, side and depth (distance behind the gap). All
    values are -1 if the gap doesn't separate two spaces.

    Attributes:
        length: the line's length, with the gap's columns, shape (gaps, 2, depths), int64 [columns].
        opening_width: the part of the line's length, before (0) and after (1) the gap, that lies
            behind further openings between the same two spaces, shape (gaps, 2, depths, 2), int64
            [columns].
        wall_cell: the ids of the line's last cells at both ends, -1 if it ends at no wall, shape
            (gaps, 2, depths, 2), int64.
        opening_cell: the ids of the last cells of the further openings at both ends, -1 if there
            are none, or the line ends at no wall; shape (gaps, 2, depths, 2), int64.
    """

    length: Int
    opening_width: Int
    wall_cell: Int
    opening_cell: Int


class LineBehindGap(NamedTuple):
    """A line to be measured: parallel to a gap, and some rows behind it.

    Attributes:
        gap: the number of the gap.
        side: the side of the gap that the line is on, `ABOVE` or `BELOW`.
        depth: the line's distance from the gap [rows].
        lean: how far the line is shifted along the gap, because columns are not perpendicular to
            an oblique direction, see `Scan.leans` [columns].
        space: the space on the line's side of the gap.
        opposite_space: the space on the gap's other side.
    """

    gap: np.int64
    side: int
    depth: np.int64
    lean: np.int64
    space: np.int64
    opposite_space: np.int64


class LineEnd(NamedTuple):
    """How far a line of cells behind a gap runs beyond one end of the gap.

    Attributes:
        length: how far the line runs in its space [columns].
        num_opening_columns: the number of columns in which the line runs behind a further opening
            to the opposite space. They are counted as far as the line was followed, which may be
            farther than `length`.
        num_passed_opening_columns: the number of such columns within `length`.
        last_cell: the id of the line's last cell, -1 if it does not end at a wall.
        opening_cell: the id of the last cell of these openings, in the line of the gap; -1 for
            none.
    """

    length: int
    num_opening_columns: int
    num_passed_opening_columns: int
    last_cell: np.int64
    opening_cell: np.int64


# ---------------------------------------------------------------- finding gaps


@kernel(nogil=True)
def mark_gaps(is_open, shift, is_near_wall, limits, marks):
    """Mark the cells of gaps: short runs of open cells next to much longer runs.

    A run is a row of open cells along a line of the scan, from one closed cell to the next. In a
    doorway, several short runs lie side by side, with longer runs above and below them: all of
    their cells are marked `DOORWAY`. If the run on one side only is longer, the cells beside it are
    marked `ONE_SIDED`, unless `limits.marks_only_doorways`.

    Args:
        is_open: a mask of the open cells, shape (rows, cols), bool.
        shift: for each column, how many rows lower a line is than in the first column.
        is_near_wall: a mask of the cells near a wall that runs along the line, bool; a run without
            such a cell is no gap. Changed: if one cell of a run is marked, all are marked.
        limits: a `GapLimits`.
        marks: receives the `Marks`, shape (rows, cols).
    """
    run_length = measure_runs(is_open, shift, is_near_wall)
    num_rows, num_cols = run_length.shape
    for col in range(num_cols):
        for row in range(num_rows):
            width = run_length[row, col]
            if width == 0 or width > limits.max_width or not is_near_wall[row, col]:
                continue
            min_longer_length = _min_longer_run(width, limits)
            if row > 0 and run_length[row - 1, col] >= min_longer_length:
                if not limits.marks_only_doorways:
                    marks[row, col] = max(marks[row, col], ONE_SIDED)
                doorway_end = _find_doorway_end(run_length, row, col, limits)
                for doorway_row in range(row, doorway_end):
                    if marks[doorway_row, col] < DOORWAY:
                        _mark_doorway(run_length, shift, doorway_row, col, marks)
            if (
                not limits.marks_only_doorways
                and row + 1 < num_rows
                and run_length[row + 1, col] >= min_longer_length
            ):
                marks[row, col] = max(marks[row, col], ONE_SIDED)


@subkernel
def measure_runs(is_open, shift, is_marked):
    """Measure the length of the run of open cells that each cell belongs to, along the scan lines.

    A run is a row of open cells along a line of the scan, from one closed cell to the next. The
    first pass counts the cells of a run up to each column; the second pass copies the count of the
    run's last cell to all its cells.

    Args:
        is_open: a mask of the open cells, shape (rows, cols), bool.
        shift: for each column, how many rows lower a line is than in the first column.
        is_marked: any mask, bool. Changed: if one cell of a run is marked, all its cells are
            marked.

    Returns:
        The length of each cell's run, 0 for closed cells, shape (rows, cols), int32 [columns].
    """
    num_rows, num_cols = is_open.shape
    run_length = np.zeros((num_cols, num_rows), dtype=np.int32).T
    # of the run on each line, up to the column that is scanned
    length_so_far = np.zeros(num_rows + 2 * num_cols, dtype=np.int32)
    for col in range(num_cols):
        line_of_first_row = num_cols - shift[col]
        rows_to_previous = 0 if col == 0 else shift[col - 1] - shift[col]
        for row in range(num_rows):
            if not is_open[row, col]:
                continue
            line_number = row + line_of_first_row
            # a line that leaves the lattice at its upper or lower edge ends there
            previous_row = row + rows_to_previous
            is_continued = (
                col > 0 and 0 <= previous_row < num_rows and is_open[previous_row, col - 1]
            )
            # two lines of cells that touch at corners only don't cross
            is_continued = is_continued and (is_open[previous_row, col] or is_open[row, col - 1])
            length = length_so_far[line_number] + 1 if is_continued else 1
            length_so_far[line_number] = length
            is_marked[row, col] |= is_continued and is_marked[previous_row, col - 1]
            run_length[row, col] = length
    for col in range(num_cols - 2, -1, -1):
        rows_to_next = shift[col + 1] - shift[col]
        for row in range(num_rows):
            next_row = row + rows_to_next
            if (
                run_length[row, col] == 0
                or not 0 <= next_row < num_rows
                or run_length[next_row, col + 1] == 0
            ):
                continue
            if is_open[next_row, col] or is_open[row, col + 1]:
                run_length[row, col] = run_length[next_row, col + 1]
                is_marked[row, col] |= is_marked[next_row, col + 1]
    return run_length


@subkernel(**NO_REFCOUNT)
def _min_longer_run(width, limits):
    """Return the least length of a run of open cells that is much longer than `width` [columns]."""
    return max(limits.widening_factor * width, width + limits.min_widening)


@subkernel(**NO_REFCOUNT)
def _find_doorway_end(run_length, first_row, col, limits):
    """Return the row after a doorway's last row, or `first_row` if no doorway begins there.

    The doorway is followed down the column, row by row. It ends where the runs of open cells get
    much longer again, at most `limits.max_thickness` rows on.

    Args:
        run_length: the length of the run of open cells that each cell belongs to, see
            `measure_runs`.
        first_row: the row of the cell in which the doorway may begin.
        col: the column of that cell.
        limits: a `GapLimits`.
    """
    num_rows = run_length.shape[0]
    width = run_length[first_row, col]
    for row in range(first_row, min(first_row + limits.max_thickness, num_rows)):
        row_width = run_length[row, col]
        if row_width == 0 or row_width > limits.max_width:
            break
        # If a run is clearly shorter than the first run, the doorway begins only there.
        min_wider_length = row_width + limits.min_widening + JAMB_JITTER
        if max(limits.widening_factor * row_width, min_wider_length) < width:
            break
        if row + 1 < num_rows and run_length[row + 1, col] >= _min_longer_run(row_width, limits):
            return row + 1
    return first_row


@subkernel
def _mark_doorway(run_length, shift, row, col, marks):
    """Mark all cells of the run of open cells that cell (row, col) belongs to as `DOORWAY`."""
    marks[row, col] = DOORWAY
    for col_step in (-1, 1):
        current_row = row
        next_col = col + col_step
        while 0 <= next_col < len(shift):
            next_row = current_row - shift[next_col - col_step] + shift[next_col]
            if not 0 <= next_row < len(run_length) or run_length[next_row, next_col] == 0:
                break
            if marks[next_row, next_col] == DOORWAY:
                break
            if (
                run_length[next_row, next_col - col_step] == 0
                and run_length[current_row, next_col] == 0
            ):
                break  # between two closed cells that touch at their corners
            marks[next_row, next_col] = DOORWAY
            current_row = next_row
            next_col = next_col + col_step


# ---------------------------------------------------------------- measuring gaps


@kernel
def measure_gaps(scan, gaps, gap_numbers, space_of_label, gap_walls):
    """Measure the shares of gaps: a gap's width, divided by the width of the space on either side.

    A space is measured along lines of cells parallel to the gap, at each of the scan's depths (the
    distances behind the gap). A line ends where the space ends, or `MAX_LINE_EXTENSION` gap widths
    from the gap's ends. Further openings in line with the gap, between the same two spaces, are
    added to the gap's width; this way, a row of pillars separates nothing. A space that ends before
    the first depth is measured at its end.

    The width of a gap is measured up to the walls at its ends. A line's length is counted in
    columns; it is also measured up to the walls if an error of `DECIDING_CELLS` cells could bring
    the least share to the other side of one of the `DECIDING_SHARES`.

    Args:
        scan: a `Scan`.
        gaps: all `Gaps` of the scan.
        gap_numbers: the numbers of the gaps to measure, shape (n,), int64.
        space_of_label: label -> the space that it belongs to after the joins so far, int32.
        gap_walls: a `GapWalls`.

    Returns:
        Four values. The lines that were measured, a `GapLines` of n gaps.
        For each gap, its share of the space above and of the space below, each the least of all
        depths, shape (n, 2), float64; 1 for both if they are one space.
        For each gap, whether it needs rays to walls that were not cast yet, shape (n,), bool.
        A list of pairs (gap, space): third spaces that a gap's lines met. The gap has to be
        measured again only if such a space is joined to one of the gap's own two spaces.
    """
    num_gaps = len(gap_numbers)
    num_depths = len(scan.depths)
    lines = GapLines(
        length=np.full((num_gaps, 2, num_depths), np.int64(-1)),
        opening_width=np.full((num_gaps, 2, num_depths, 2), np.int64(-1)),
        wall_cell=np.full((num_gaps, 2, num_depths, 2), np.int64(-1)),
        opening_cell=np.full((num_gaps, 2, num_depths, 2), np.int64(-1)),
    )
    shares = np.ones((num_gaps, 2))
    needs_rays = np.zeros(num_gaps, np.bool_)
    widths = np.empty((2, num_depths))  # of one gap and its openings, up to walls [columns]
    third_spaces = [(np.int64(-1), np.int64(-1))]  # the entry gives the list its type
    for gap_index in range(num_gaps):
        gap = gap_numbers[gap_index]
        space_above = np.int64(space_of_label[gaps.label_above[gap]])
        space_below = np.int64(space_of_label[gaps.label_below[gap]])
        if space_above == space_below:
            continue
        needs_wall_distances = False
        for side in range(2):
            shortest_length = len(scan.shift)
            for depth_index in range(num_depths):
                depth, lean = _limit_depth(scan, gaps, gap, side, depth_index)
                line = LineBehindGap(
                    gap=gap,
                    side=side,
                    depth=depth,
                    lean=lean,
                    space=space_above if side == ABOVE else space_below,
                    opposite_space=space_below if side == ABOVE else space_above,
                )
                _measure_line(
                    scan, gaps, line, space_of_label, third_spaces, lines, gap_index, depth_index
                )
                width = 0.0
                for end in range(2):
                    # up to the wall at the gap's end, or at that of openings beyond it
                    opening_width = lines.opening_width[gap_index, side, depth_index, end]
                    cell = lines.opening_cell[gap_index, side, depth_index, end]
                    if opening_width > 0:
                        coded_distance = _coded_distance_from(gap_walls, cell, end)
                        needs_rays[gap_index] |= coded_distance == 0.0
                        width += opening_width + _distance_to_wall(
                            coded_distance, gap_walls.max_distance[gap]
                        )
                    else:
                        width += gap_walls.end_distance[gap, end]
                widths[side, depth_index] = gaps.last_col[gap] - gaps.first_col[gap] + width
                length = lines.length[gap_index, side, depth_index]
                shares[gap_index, side] = min(
                    shares[gap_index, side], widths[side, depth_index] / length
                )
                shortest_length = min(shortest_length, length)
            for share in DECIDING_SHARES:
                needs_wall_distances |= (
                    abs(shares[gap_index, side] - share) * shortest_length <= DECIDING_CELLS
                )
        if not needs_wall_distances:
            # it makes no difference where in the last cells the walls begin
            continue
        for side in range(2):
            shares[gap_index, side] = 1.0
            for depth_index in range(num_depths):
                length = 0.0
                for end in range(2):
                    cell = lines.wall_cell[gap_index, side, depth_index, end]
                    coded_distance = _coded_distance_from(gap_walls, cell, end)
                    needs_rays[gap_index] |= coded_distance == 0.0
                    length += _distance_to_wall(coded_distance, MAX_WALL_DISTANCE)
                share = widths[side, depth_index] / (
                    lines.length[gap_index, side, depth_index] - 1 + length
                )
                shares[gap_index, side] = min(shares[gap_index, side], share)
    return lines, shares, needs_rays, third_spaces[1:]


@subkernel(**NO_REFCOUNT)
def _limit_depth(scan, gaps, gap, side, depth_index):
    """Return how far behind a gap a line measures the space there, and how far it is shifted.

    The distance is the scan's depth, unless the space, seen from the middle of the gap, ends before
    the first depth: then that is reduced to the space's end.

    Args:
        scan, gaps: see `measure_gaps`.
        gap: the gap's number.
        side: the side of the gap, `ABOVE` or `BELOW`.
        depth_index: the index of the depth in `Scan.depths`.

    Returns:
        The depth [rows] and the lean [columns], see `LineBehindGap`.
    """
    depth = scan.depths[depth_index]
    lean = scan.leans[depth_index]
    if depth_index > 0:
        return depth, lean
    # the middle of the gap on this side
    if side == ABOVE:
        row_step = -1
        row = (gaps.top_row[gap, 0] + gaps.top_row[gap, 1]) // 2
    else:
        row_step = 1
        row = (gaps.bottom_row[gap, 0] + gaps.bottom_row[gap, 1]) // 2
    col = (gaps.first_col[gap] + gaps.last_col[gap]) // 2
    num_open_cells = 0
    while num_open_cells < depth and 0 <= row + row_step * (num_open_cells + 1) < len(scan.is_open):
        if not scan.is_open[row + row_step * (num_open_cells + 1), col]:
            break
        num_open_cells += 1
    if num_open_cells < depth:
        if depth > 1:
            lean = np.int64(0)
        depth = np.int64(max(num_open_cells, 1))
    return depth, lean


@subkernel(**NO_REFCOUNT)
def _coded_distance_from(gap_walls, cell, end):
    """Return the coded distance from a cell to a wall, see `GapWalls`; inf if there is no cell.

    Args:
        gap_walls: a `GapWalls`.
        cell: id of the cell, or -1.
        end: the line's end, `FIRST_END` (the ray goes backward) or `LAST_END` (forward).
    """
    if cell < 0:
        return np.inf
    return gap_walls.coded_distance[gap_walls.rays_of_cell[cell], end]


@subkernel(**NO_REFCOUNT)
def _distance_to_wall(coded_distance, max_distance):
    """Return the distance of a cell's centre from the wall at one end of a line [columns].

    It is half a column if there is no wall, or no wall within `max_distance`.

    Args:
        coded_distance: the distance as it is coded in `GapWalls`.
        max_distance: a wall that is farther away does not count [columns].
    """
    if not 1.0 <= coded_distance <= max_distance + 1.0:
        return 0.5
    return coded_distance - 1.0


@subkernel
def _measure_line(scan, gaps, line, space_of_label, third_spaces, lines, gap_index, depth_index):
    """Measure how far a line behind a gap runs in its space, in both directions.

    A line may be longer if the gap is part of a wider opening; so the openings next to the gap are
    counted first.

    Args:
        scan, gaps: see `measure_gaps`.
        line: a `LineBehindGap`.
        space_of_label: see `measure_gaps`.
        third_spaces: receives (gap, space) for each third space that the line meets.
        lines: a `GapLines` that receives the results.
        gap_index: the gap's index in `lines`.
        depth_index: the index of the line's depth.
    """
    gap_width = gaps.last_col[line.gap] - gaps.first_col[line.gap] + 1
    opening_width = gap_width
    for end in range(2):
        line_end = _walk_line(scan, gaps, line, end, 0, True, space_of_label, third_spaces)
        opening_width += line_end.num_opening_columns
    length = gap_width
    for end in range(2):
        line_end = _walk_line(
            scan, gaps, line, end, opening_width, False, space_of_label, third_spaces
        )
        length += line_end.length
        lines.opening_width[gap_index, line.side, depth_index, end] = (
            line_end.num_passed_opening_columns
        )
        lines.wall_cell[gap_index, line.side, depth_index, end] = line_end.last_cell
        if line_end.num_passed_opening_columns > 0 and line_end.last_cell >= 0:
            lines.opening_cell[gap_index, line.side, depth_index, end] = line_end.opening_cell
        else:
            lines.opening_cell[gap_index, line.side, depth_index, end] = -1
    lines.length[gap_index, line.side, depth_index] = length


@subkernel
def _walk_line(scan, gaps, line, end, opening_width, only_openings, space_of_label, third_spaces):
    """Follow a line behind a gap from one end of the gap away from it, and return a `LineEnd`.

    Args:
        scan, gaps: see `measure_gaps`.
        line: a `LineBehindGap`.
        end: the end of the gap, `FIRST_END` or `LAST_END`.
        opening_width: the width of the opening that the gap is part of, which limits the walk
            [columns].
        only_openings: whether the walk ends where the openings next to the gap end.
        space_of_label: see `measure_gaps`.
        third_spaces: receives (gap, space) for each third space that the line meets.
    """
    num_rows, num_cols = scan.label.shape
    shift = scan.shift
    gap_width = gaps.last_col[line.gap] - gaps.first_col[line.gap] + 1
    end_top_row = gaps.top_row[line.gap, end]
    end_bottom_row = gaps.bottom_row[line.gap, end]
    start_col = gaps.first_col[line.gap] if end == FIRST_END else gaps.last_col[line.gap]
    col_step = -1 if end == FIRST_END else 1
    # the rows in which the line and its mirror image on the gap's other side begin, in the column
    # of the gap's end; the line is shifted by `lean` columns from there, the image by as many back
    if line.side == ABOVE:
        line_start_row = end_top_row - line.depth
        mirror_start_row = end_bottom_row + line.depth
        lean = line.lean
    else:
        line_start_row = end_bottom_row + line.depth
        mirror_start_row = end_top_row - line.depth
        lean = -line.lean
    length = 0
    num_opening_columns = 0
    num_passed_opening_columns = 0
    last_cell = np.int64(-1)
    opening_cell = np.int64(-1)
    for num_steps in range(num_cols):
        gap_col = start_col + col_step * num_steps
        line_col = gap_col + lean
        mirror_col = gap_col - lean
        is_too_far = not only_openings and (
            num_steps > MAX_LINE_EXTENSION * max(opening_width, gap_width + num_opening_columns)
        )
        if is_too_far or not 0 <= line_col < num_cols:
            last_cell = np.int64(-1)
            break
        line_row = line_start_row + shift[line_col] - shift[start_col]
        if not 0 <= line_row < num_rows or not scan.is_open[line_row, line_col]:
            if num_steps == 0:
                continue  # there is a wall beside the gap's end
            if last_cell >= 0:
                length = num_steps - 1
                num_passed_opening_columns = num_opening_columns
            break
        space = np.int64(space_of_label[scan.label[line_row, line_col]])
        last_cell = line_row * num_cols + line_col
        if num_steps == 0:
            continue
        if space > 0 and space != line.space:
            _record_met_space(third_spaces, line.gap, space)
            last_cell = np.int64(-1)
            break
        if 0 <= gap_col < num_cols and 0 <= mirror_col < num_cols:
            row_shift = shift[gap_col] - shift[start_col]
            gap_top_row = end_top_row + row_shift
            gap_bottom_row = end_bottom_row + row_shift
            mirror_row = mirror_start_row + shift[mirror_col] - shift[start_col]
            mirror_space = np.int64(-1)
            if _is_passage(
                scan.is_open, gap_col, gap_top_row, gap_bottom_row, mirror_row, mirror_col
            ):
                mirror_space = np.int64(space_of_label[scan.label[mirror_row, mirror_col]])
            # another gap that ends here has no label: the line goes on beyond it
            if mirror_space == line.opposite_space or mirror_space == 0:
                num_opening_columns += 1
                opening_cell = (
                    (end_top_row + end_bottom_row) // 2 + row_shift
                ) * num_cols + gap_col
            elif mirror_space > 0:
                _record_met_space(third_spaces, line.gap, mirror_space)
        if space > 0:
            length = num_steps
            num_passed_opening_columns = num_opening_columns
        if only_openings and num_opening_columns < num_steps:
            break
    return LineEnd(
        length=length,
        num_opening_columns=num_opening_columns,
        num_passed_opening_columns=num_passed_opening_columns,
        last_cell=last_cell,
        opening_cell=opening_cell,
    )


@subkernel(**NO_REFCOUNT)
def _is_passage(is_open, gap_col, top_row, bottom_row, mirror_row, mirror_col):
    """Return whether a further opening, in line with a gap, is in a column.

    The column has to be open in all rows of the gap, because a thin oblique wall may be in any of
    them. The cell behind it, on the opposite side of the gap from the line, has to be open, too.

    Args:
        is_open: the open cells, shape (rows, cols).
        gap_col: the column.
        top_row: the first row of the gap, in this column.
        bottom_row: the last row of the gap, in this column.
        mirror_row, mirror_col: the cell on the opposite side.
    """
    num_rows = is_open.shape[0]
    if top_row < 0 or bottom_row >= num_rows or not 0 <= mirror_row < num_rows:
        return False
    for row in range(top_row, bottom_row + 1):
        if not is_open[row, gap_col]:
            return False
    return is_open[mirror_row, mirror_col]


@subkernel
def _record_met_space(third_spaces, gap, space):
    """Append the pair (gap, space) to `third_spaces` unless it is among the pairs of that gap.

    The pairs of a gap follow each other, so that those of the last gap are at the end.
    """
    for pair_index in range(len(third_spaces) - 1, 0, -1):
        if third_spaces[pair_index][0] != gap:
            break
        if third_spaces[pair_index][1] == space:
            return
    third_spaces.append((gap, space))


# ---------------------------------------------------------------- sills


@kernel(nogil=True)
def mark_sills(is_low, is_wall, shift, is_sill):
    """Mark sills: chains of low cells along lines, from one wall to another wall.

    A chain lies exactly on its line; or it stays within one cell of the line, if no wall is beside
    it and the line itself meets walls at both ends. So chains follow thin sills that alternate
    between two lines of cells, but not furniture along a wall. One scan finds the chains that begin
    at a wall on the left, a second scan those that begin at a wall on the right. Sills are the
    cells that both scans find.

    Args:
        is_low: cells that are blocked, but not as high as by a wall, shape (rows, cols), bool.
        is_wall: cells of walls, shape (rows, cols), bool.
        shift: for each column, how many rows lower a line is than in the first column.
        is_sill: receives a mask of the cells of sills, shape (rows, cols), bool.
    """
    num_rows, num_cols = is_low.shape
    is_low = is_low.T
    is_wall = is_wall.T
    # of chains that begin at a wall in an earlier column
    chain_bits_from_first = np.zeros((num_cols, num_rows), dtype=np.uint8)
    for col in range(1, num_cols):
        row_shift_to_previous = shift[col - 1] - shift[col]
        _extend_chains(
            is_low=is_low[col],
            is_wall=is_wall[col],
            row_shift_to_next=row_shift_to_previous,
            is_neighbor_wall=is_wall[col - 1],
            neighbor_chain_bits=chain_bits_from_first[col - 1],
            column_chain_bits=chain_bits_from_first[col],
        )
    chain_bits_from_last = np.zeros((num_cols, num_rows), dtype=np.uint8)
    for col in range(num_cols - 2, -1, -1):
        row_shift_to_next = shift[col + 1] - shift[col]
        _extend_chains(
            is_low=is_low[col],
            is_wall=is_wall[col],
            row_shift_to_next=row_shift_to_next,
            is_neighbor_wall=is_wall[col + 1],
            neighbor_chain_bits=chain_bits_from_last[col + 1],
            column_chain_bits=chain_bits_from_last[col],
        )
        for row in range(num_rows):
            chain_bits = chain_bits_from_first[col, row] & chain_bits_from_last[col, row]
            if chain_bits == 0:
                continue
            for side in range(3):
                if chain_bits & (1 << side):
                    is_sill[row + side - 1, col] = True
            if chain_bits & EXACT_CHAIN:
                is_sill[row, col] = True


@subkernel(**NO_REFCOUNT)
def _extend_chains(
    is_low, is_wall, row_shift_to_next, is_neighbor_wall, neighbor_chain_bits, column_chain_bits
):
    """Extend chains of low cells, which may be sills, from a neighbouring column into a column.

    Args:
        is_low: the column's low cells.
        is_wall: the column's cells of walls.
        row_shift_to_next: by how many rows the scan's lines shift downwards from this column to the
            neighbouring one.
        is_neighbor_wall: the neighbouring column's cells of walls.
        neighbor_chain_bits: the bits of the neighbouring column's cells. They say where chains of
            low cells end in that column: beside the cell, in it, or exactly on its line, see
            `EXACT_CHAIN`.
        column_chain_bits: receives the bits of this column's cells.
    """
    num_rows = is_low.shape[0]
    for row in range(max(0, -row_shift_to_next), min(num_rows, num_rows - row_shift_to_next)):
        is_at_wall = is_neighbor_wall[row + row_shift_to_next]
        bits_of_neighbor = neighbor_chain_bits[row + row_shift_to_next]
        row_above = max(row - 1, 0)
        row_below = min(row + 1, num_rows - 1)
        if bits_of_neighbor == 0 and not is_at_wall:  # most cells: no chain can begin or go on here
            continue
        chain_bits = (
            EXACT_CHAIN if is_low[row] and (is_at_wall or bits_of_neighbor & EXACT_CHAIN) else 0
        )
        if not (is_wall[row_above] or is_wall[row] or is_wall[row_below]):
            for chain_row in range(row_above, row_below + 1):
                side = chain_row - row + 1
                if is_low[chain_row] and (
                    is_at_wall or bits_of_neighbor & BITS_OF_TOUCHING_CHAINS[side]
                ):
                    chain_bits |= 1 << side
        column_chain_bits[row] = chain_bits


# ---------------------------------------------------------------- distances


@kernel(nogil=True)
def sweep_distances(is_target, reach, column_distance, squared_distance, begin, end):
    """Measure how far each cell is from the nearest target: first along columns, then along rows.

    It takes two calls, as a squared Euclidean distance is the sum of two squares, one per axis
    (Saito and Toriwaki, 1994). In the second call, columns are compared from the nearest on, many
    cells at a time, which the compiler vectorizes.

    Args:
        is_target: the target cells, bool.
        reach: the largest distance that is measured; larger ones become ``reach + 1`` [cells].
        column_distance: the distance of each cell to the nearest target in its column, int16. The
            first call writes the columns ``range(begin, end)``; the second call reads all.
        squared_distance: receives the squared distances of the rows ``range(begin, end)``, int32;
            empty in the first call.
        begin: the first column; in the second call, the first row.
        end: the last column or row, plus 1.
    """
    if squared_distance.shape[0] == 0:
        _sweep_columns(is_target[:, begin:end], np.int16(reach + 1), column_distance[:, begin:end])
    else:
        _sweep_rows(column_distance, reach, squared_distance, begin, end)


@subkernel
def _sweep_columns(is_target, beyond_reach, column_distance):
    """Write to `column_distance` how far each cell is from the nearest target in its column.

    Distances from `beyond_reach` on are written as `beyond_reach` [cells].
    """
    num_rows, num_cols = is_target.shape  # of some columns: loops from 0 vectorize
    for col in range(num_cols):
        column_distance[0, col] = 0 if is_target[0, col] else beyond_reach
    for row in range(1, num_rows):
        for col in range(num_cols):
            distance_from_above = min(column_distance[row - 1, col] + np.int16(1), beyond_reach)
            column_distance[row, col] = 0 if is_target[row, col] else distance_from_above
    for row in range(num_rows - 2, -1, -1):
        for col in range(num_cols):
            column_distance[row, col] = min(
                column_distance[row, col], column_distance[row + 1, col] + np.int16(1)
            )


@subkernel
def _sweep_rows(column_distance, reach, squared_distance, first_row, end_row):
    """Write to rows of `squared_distance` how far each cell is from the nearest target, squared.

    It is the least sum of two squares over all columns within `reach`: of the distance to a column,
    and of the distance to the nearest target within that column. Columns that are too far away to
    lessen the greatest distance so far are left out: most are, in corridors and far from targets.
    """
    num_cols = column_distance.shape[1]
    squared_beyond_reach = np.int32((reach + 1) ** 2)
    padded_squares = np.empty(num_cols + 2 * reach, np.int32)
    for col in range(reach):
        padded_squares[col] = padded_squares[num_cols + reach + col] = squared_beyond_reach
    for row in range(first_row, end_row):
        for col in range(num_cols):
            distance = np.int32(column_distance[row, col])
            padded_squares[col + reach] = distance * distance
        for first_col in range(0, num_cols, SWEPT_COLUMNS):
            end_col = min(first_col + SWEPT_COLUMNS, num_cols)
            distances = squared_distance[row, first_col:end_col]
            squares = padded_squares[first_col : end_col + 2 * reach]
            least = squared_beyond_reach
            for col in range(squares.shape[0]):
                least = min(least, squares[col])
            greatest = np.int32(0)
            for col in range(distances.shape[0]):
                distances[col] = squares[reach + col]
                greatest = max(greatest, distances[col])
            for col_shift in range(1, reach + 1):
                squared_shift = np.int32(col_shift * col_shift)
                if least + squared_shift >= greatest:
                    break
                left_squares = squares[reach - col_shift :]
                right_squares = squares[reach + col_shift :]
                greatest = np.int32(0)
                for col in range(distances.shape[0]):
                    nearer_square = min(left_squares[col], right_squares[col])
                    distances[col] = min(distances[col], np.int32(nearer_square + squared_shift))
                    greatest = max(greatest, distances[col])
