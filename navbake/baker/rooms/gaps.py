"""Divides the floor of a level into spaces at gaps, for example at doorways.

A *gap* is a narrow place between two *spaces*: the open floor is much wider beside it. The steps:

1. `find_directions` (in `walls.py`) finds the directions in which walls run. For each direction,
   the lattice is scanned along parallel lines of cells, see `gap_kernels.py`; steps 2 and 4 are
   done for each direction.
2. `_mark_gap_lines` marks the cells of gaps: open cells in a line from wall to wall that is much
   shorter than the line next to it.
3. `label_spaces` labels the spaces: connected open cells that are not marked.
4. `_list_gaps` combines marked cells in neighbouring columns between the same two spaces to a gap.
5. `SpaceMerger.measure` measures a gap's two *shares*: the gap's width, divided by the width of the
   space on either side.
6. `SpaceMerger.join_spaces` joins the two spaces of a gap if its share is too large, or if it is
   too wide for a door.

The limits of all steps are in `gap_limits.py`.
"""

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.components import (
    RowRuns,
    expand_ranges,
    find_row_runs,
    label_components,
    label_runs,
)
from navbake.baker.core.windows import Window, grow_window
from navbake.baker.rooms import gap_kernels as kernels
from navbake.baker.rooms.gap_kernels import DOORWAY, GapLimits, Gaps, GapWalls, Marks, Scan
from navbake.baker.rooms.gap_limits import (
    CLOSE_SHARE,
    JOIN_SHARE_OF_NARROWER,
    JOIN_SHARE_OF_WIDER,
    MAX_GAP_WIDTH,
    MAX_JAMB_DISTANCE,
    MAX_MIDDLE_SHIFT,
    MAX_OPENING_WIDTH,
    MAX_PASSAGE_WIDTH,
    MAX_WALL_DISTANCE,
    MAX_WALL_THICKNESS,
    MEASURING_DEPTHS,
    MIN_CLOSE_AREA,
    MIN_CLOSE_WIDTH,
    MIN_PASSAGE_LENGTH,
    MIN_SPACE_AREA,
    MIN_WIDENING,
    PASSAGE_WIDENING,
    WIDENING_FACTOR,
    WIDTH_ROUNDING,
)
from navbake.baker.rooms.walls import (
    WallDirection,
    WallRays,
    both_scan_orders,
    find_directions,
    from_scan_order,
)
from navbake.threads import run_beside
from navbake.types import Bool, Int, Int32, ScalarT


class CloseCall(NamedTuple):
    """A gap, such as a doorway, for which it was a close decision whether it separates two rooms.

    The gap's width, divided by that of the narrower space beside it, is close to the limit.

    Attributes:
        row_col: row and column of the gap's middle, with fractions.
        width: the gap's width [m].
        separates: whether the gap separates the two spaces.
    """

    row_col: tuple[float, float]
    width: float
    separates: bool


class DirectionGaps(NamedTuple):
    """The gaps that lie along one direction of walls.

    Attributes:
        direction: the direction of the walls.
        scan: the lattice as it is scanned in this direction.
        gaps: the gaps that the scan finds.
    """

    direction: WallDirection
    scan: Scan
    gaps: Gaps


class SeparatedSpaces(NamedTuple):
    """The spaces (connected parts of the floor) between all gaps, before any of them are joined.

    Attributes:
        direction_gaps: the gaps of each direction.
        label: the number of each cell's space, from 1, or 0 for none; shape (height, width), int32.
        runs: runs of cells in the rows of `label`, with their labels; some have label 0.
        num_cells: the number of cells with each label, int64; 0 for label 0.
    """

    direction_gaps: list[DirectionGaps]
    label: Int32
    runs: RowRuns
    num_cells: Int


# ---------------------------------------------------------------- finding gaps


def find_gaps(
    is_open: Bool,
    is_hole: Bool,
    cell_size: float,
    door_width: float | None,
    rays: WallRays | None = None,
    is_closed: Bool | None = None,
) -> SeparatedSpaces:
    """Find the gaps along each direction of walls, and the spaces between all of them.

    Args:
        is_open: cells with a floor and without a wall, shape (height, width).
        is_hole: cells with neither floor nor wall. Gaps may go across them, but they are in no
            space.
        cell_size: the side of a cell, > 0 [m].
        door_width: the widest gap that separates two spaces [m]; None for the limits of
            `gap_limits.py`.
        rays: rays to the geometry of walls; None to find the walls' directions from cells.
        is_closed: cells of closed door leaves. They are in no space and no gap, and gaps end at
            them as at walls. None for no leaves.

    Returns:
        The gaps and the spaces.
    """
    is_passable = is_open | is_hole
    if is_closed is None:
        is_closed = np.zeros_like(is_passable)
    directions = find_directions(is_passable, cell_size, rays)
    marks, is_marked = _mark_gap_lines(is_passable, is_closed, directions, cell_size, door_width)
    label, runs, num_cells = label_spaces(is_open, is_marked, cell_size)
    scanned_label = both_scan_orders(label)
    scanned_is_open = both_scan_orders(is_passable & ~is_closed)
    scanned_is_marked = both_scan_orders(is_marked)
    wait_functions = [
        run_beside(
            _list_crossings, scanned_label[order], scanned_is_open[order], scanned_is_marked[order]
        )
        for order in (False, True)
    ]
    crossings_by_order = [wait_for_crossings() for wait_for_crossings in wait_functions]
    direction_gaps = []
    for direction, direction_marks in zip(directions, marks, strict=True):
        depths_in_rows = np.array(
            [
                max(1, round(depth * direction.length_per_column / cell_size))
                for depth in MEASURING_DEPTHS
            ]
        )
        scan = Scan(
            label=scanned_label[direction.is_swapped],
            is_open=scanned_is_open[direction.is_swapped],
            shift=direction.shift,
            depths=depths_in_rows,
            leans=np.rint(depths_in_rows * direction.slope / direction.length_per_column**2).astype(
                np.int64
            ),
        )
        gaps = _list_gaps(scan, crossings_by_order[direction.is_swapped], direction_marks)
        direction_gaps.append(DirectionGaps(direction, scan, gaps))
    return SeparatedSpaces(direction_gaps, label, runs, num_cells)


def _mark_gap_lines(
    is_passable: Bool,
    is_closed: Bool,
    directions: list[WallDirection],
    cell_size: float,
    door_width: float | None,
) -> tuple[list[Marks], Bool]:
    """Mark the cells of gaps: lines of open cells between walls, beside which the floor is wider.

    The lines of doorways, beside which the floor is wider on both sides, are marked first. From
    then on their cells count as closed, so that other lines end there: a line across a corridor
    does not go on through a door, and a line that continues a wall ends at a wide opening beside
    it.

    Args:
        is_passable: cells that a gap may go across: open cells, and holes in the floor, shape
            (height, width).
        is_closed: cells of closed door leaves, at which lines end.
        directions: the directions of walls, in which lines run.
        cell_size: the side of a cell, > 0 [m].
        door_width: the widest gap that separates two spaces [m]; None for the limits of
            `gap_limits.py`.

    Returns:
        The `Marks` of each direction, in its scan order; and a mask of the cells that are closed,
        or marked in any direction, shape (height, width).
    """
    marks = [
        np.zeros(
            is_passable.shape[::-1] if direction.is_swapped else is_passable.shape,
            dtype=np.uint8,
            order="F",
        )
        for direction in directions
    ]
    is_marked = is_closed.copy()
    configured_width = door_width or 0.0
    for max_width, marks_only_doorways in (
        (max(MAX_OPENING_WIDTH, configured_width), True),
        (max(MAX_PASSAGE_WIDTH, configured_width), False),
    ):
        scanned_is_unmarked = both_scan_orders(is_passable & ~is_marked)
        wait_functions = []
        for direction, direction_marks in zip(directions, marks, strict=True):
            column_length = direction.length_per_column * cell_size  # along the lines [m]
            limits = GapLimits(
                max_width=int(max_width / column_length),
                widening_factor=WIDENING_FACTOR,
                min_widening=MIN_WIDENING / column_length,
                max_thickness=int(MAX_WALL_THICKNESS * direction.length_per_column / cell_size) + 2,
                marks_only_doorways=marks_only_doorways,
            )
            wait_functions.append(
                run_beside(
                    mark_lines_along,
                    direction,
                    scanned_is_unmarked[direction.is_swapped],
                    limits,
                    direction_marks,
                )
            )
        for wait_for_marks in wait_functions:
            window, is_marked_in_window = wait_for_marks()
            is_marked[window] |= is_marked_in_window
    return marks, is_marked


def mark_lines_along(
    direction: WallDirection, is_unmarked: Bool, limits: GapLimits, marks: Marks
) -> tuple[Window, Bool]:
    """Mark the cells of gaps that lie along a direction of walls.

    Only lines near these walls count, and only the cells around them are scanned: an oblique wall
    is often a single one, somewhere in a building.

    Args:
        direction: the direction.
        is_unmarked: cells that a gap may go across, and that no gap has so far, in the direction's
            scan order.
        limits: the limits by which gaps are marked.
        marks: the marks of this direction, in its scan order; are changed.

    Returns:
        The window of the lattice that was scanned, and a mask of its marked cells; not swapped.
    """
    # A gap has a cell near a wall, and the other lines of its doorway are at most `max_thickness`
    # rows away. Beyond their ends, longer lines count up to the length that makes the floor wider
    max_reach = limits.max_width + math.ceil(
        max(limits.widening_factor * limits.max_width, limits.max_width + limits.min_widening)
    )
    near_rows, near_cols = direction.window
    is_near_wall = direction.is_near_wall
    if direction.is_swapped:
        near_rows, near_cols = near_cols, near_rows
        is_near_wall = is_near_wall.T
    rows, cols = grow_window(
        (near_rows, near_cols),
        row_margin=math.ceil(max_reach * abs(direction.slope)) + limits.max_thickness + 2,
        col_margin=max_reach + 1,
        shape=is_unmarked.shape,
    )
    window_marks = np.asfortranarray(marks[rows, cols])
    is_near_wall_in_window = np.zeros_like(window_marks, dtype=np.bool_)  # the kernel changes it
    is_near_wall_in_window[
        near_rows.start - rows.start : near_rows.stop - rows.start,
        near_cols.start - cols.start : near_cols.stop - cols.start,
    ] = is_near_wall
    kernels.mark_gaps(
        np.asfortranarray(is_unmarked[rows, cols]),
        direction.shift[cols] - direction.shift[cols.start],
        is_near_wall_in_window,
        limits,
        window_marks,
    )
    marks[rows, cols] = window_marks
    window = (cols, rows) if direction.is_swapped else (rows, cols)
    return window, from_scan_order(window_marks, direction) > 0


class _Crossings(NamedTuple):
    """Where columns of a scan cross marked cells between two spaces, as n parallel crossings.

    At a crossing, consecutive cells of the column are marked in any direction, none of them is
    closed, and the spaces above and below these cells differ.

    Attributes:
        col: the column, shape (n,).
        top: the row of the first marked cell, shape (n,).
        bottom: the row of the last marked cell, shape (n,).
        label_above: the label of the space above, in the row before `top`, shape (n,).
        label_below: the label of the space below, in the row after `bottom`, shape (n,).
    """

    col: Int
    top: Int
    bottom: Int
    label_above: Int
    label_below: Int

    def select(self, is_selected: Bool) -> _Crossings:
        """Return some of the crossings.

        Args:
            is_selected: which ones, shape (n,).
        """
        return _Crossings(
            col=self.col[is_selected],
            top=self.top[is_selected],
            bottom=self.bottom[is_selected],
            label_above=self.label_above[is_selected],
            label_below=self.label_below[is_selected],
        )

    def read_cells(self, values: NDArray[ScalarT]) -> tuple[NDArray[ScalarT], Int]:
        """Read the values of the marked cells of all crossings.

        Args:
            values: a value for each cell of the scan, in Fortran order.

        Returns:
            The values of all cells, crossing by crossing; and the index of each crossing's first
            one, shape (n,).
        """
        first_cell = self.col * len(values) + self.top
        num_cells = self.bottom - self.top + 1
        _, cells = expand_ranges(first_cell, first_cell + num_cells)
        return values.T.ravel()[cells], np.cumsum(num_cells) - num_cells


def label_spaces(is_open: Bool, is_marked: Bool, cell_size: float) -> tuple[Int32, RowRuns, Int]:
    """Label the spaces: connected open cells that are not marked as cells of gaps.

    Areas smaller than `MIN_SPACE_AREA` are no spaces.

    Args:
        is_open: cells with a floor and without a wall, shape (height, width).
        is_marked: cells of gaps and of closed door leaves; the cells of areas that are too small
            are added.
        cell_size: the side of a cell, > 0 [m].

    Returns:
        The label of each cell's space, from 1, 0 for none, shape (height, width); runs of cells
        with one label, some with label 0; and the number of cells of each label, 0 for label 0.
    """
    runs = find_row_runs(is_open & ~is_marked)
    component_of_run, num_cells = label_runs(runs)
    is_space = num_cells * cell_size**2 >= MIN_SPACE_AREA
    is_space[0] = True
    # Spaces keep the order of their components.
    space_of_component = np.where(is_space, np.cumsum(is_space) - 1, 0).astype(np.int32)
    runs = runs._replace(value=space_of_component[component_of_run])
    label = runs.paint(runs.value, is_open.shape)
    is_marked |= is_open & (label == 0)
    return label, runs, num_cells[is_space]


def _list_gaps(scan: Scan, crossings: _Crossings, marks: Marks) -> Gaps:
    """List the gaps of a scan: marked cells in neighbouring columns between the same two spaces.

    Spaces are connected parts of the floor; cells of narrow places between them were marked.

    Args:
        scan: the lattice as it is scanned in one direction.
        crossings: where columns of the scan cross cells that are marked in any direction.
        marks: the marks of this direction.
    """
    crossings, greatest_mark = _select_crossings(crossings, marks)
    previous_crossing = _find_previous_crossings(crossings, scan)
    continuing_crossings = np.flatnonzero(previous_crossing >= 0)
    gap_of_crossing = label_components(
        np.stack([previous_crossing[continuing_crossings], continuing_crossings]),
        len(previous_crossing),
    )
    # Sort by gap, and within a gap by column.
    sort_indices = np.argsort(gap_of_crossing, kind="stable")
    first_index_of_gap = np.flatnonzero(np.diff(gap_of_crossing[sort_indices], prepend=-1))
    first_crossing = sort_indices[first_index_of_gap]
    last_crossing = sort_indices[
        np.append(first_index_of_gap[1:], len(sort_indices))[: len(first_index_of_gap)] - 1
    ]
    return Gaps(
        first_col=crossings.col[first_crossing],
        last_col=crossings.col[last_crossing],
        top_row=np.stack([crossings.top[first_crossing], crossings.top[last_crossing]], axis=1),
        bottom_row=np.stack(
            [crossings.bottom[first_crossing], crossings.bottom[last_crossing]], axis=1
        ),
        label_above=crossings.label_above[first_crossing],
        label_below=crossings.label_below[first_crossing],
        is_doorway=np.maximum.reduceat(greatest_mark[sort_indices], first_index_of_gap) == DOORWAY,
    )


def _list_crossings(label: Int32, is_open: Bool, is_marked: Bool) -> _Crossings:
    """List where columns have marked cells, none of them closed, between two different spaces.

    Args:
        label: the space of each cell, 0 for none, in a scan's order.
        is_open: a mask of the cells that a line can pass through, in this order.
        is_marked: a mask of the cells that are closed, or marked in any direction, in this order.
    """
    runs = find_row_runs(is_marked.T)  # along columns
    # At the lattice's edge, the cell above or below is the marked cell itself, without a label.
    label_above = label[np.maximum(runs.first_col - 1, 0), runs.row]
    label_below = label[np.minimum(runs.end_col, len(label) - 1), runs.row]
    is_crossing = (label_above > 0) & (label_below > 0) & (label_above != label_below)
    crossings = _Crossings(
        col=runs.row,
        top=runs.first_col,
        bottom=runs.end_col - 1,
        label_above=label_above.astype(np.int64),
        label_below=label_below.astype(np.int64),
    ).select(is_crossing)
    is_cell_open, first_indices = crossings.read_cells(is_open)
    return crossings.select(np.logical_and.reduceat(is_cell_open, first_indices))


def _select_crossings(crossings: _Crossings, marks: Marks) -> tuple[_Crossings, Marks]:
    """Select the crossings with a cell that is marked in a direction.

    Args:
        crossings: crossings in the scan order of the direction.
        marks: the marks of the direction.

    Returns:
        The crossings, and the greatest mark of each.
    """
    mark_of_cell, first_indices = crossings.read_cells(marks)
    greatest_mark = np.maximum.reduceat(mark_of_cell, first_indices)
    return crossings.select(greatest_mark > 0), greatest_mark[greatest_mark > 0]


def _find_previous_crossings(crossings: _Crossings, scan: Scan) -> Int:
    """Find for each crossing the crossing in the previous column that belongs to the same gap.

    Both lie between the same two spaces, and their middles are on lines of cells that are at most
    `MAX_MIDDLE_SHIFT` rows apart. Of several such crossings in the previous column, the first
    counts.

    Returns:
        The index of the crossing in the previous column, -1 if there is none, shape (n,).
    """
    num_labels = crossings.label_below.max(initial=0) + 1
    num_cols = scan.label.shape[1]
    # A key of the two spaces and the column; the previous column has the key minus 1.
    pair_key = crossings.label_above * num_labels + crossings.label_below
    sort_key = pair_key * (num_cols + 1) + crossings.col
    sort_indices = np.argsort(sort_key, kind="stable")
    match_begin = np.searchsorted(sort_key[sort_indices], sort_key - 1, "left")
    match_end = np.searchsorted(sort_key[sort_indices], sort_key - 1, "right")
    middle_line = (crossings.top + crossings.bottom) / 2 - scan.shift[crossings.col]
    previous_crossing = np.full(len(sort_key), -1)
    for match_number in range(int((match_end - match_begin).max(initial=0))):
        candidate_crossing = sort_indices[
            np.minimum(match_begin + match_number, len(sort_indices) - 1)
        ]
        is_near_line = np.abs(middle_line[candidate_crossing] - middle_line) <= MAX_MIDDLE_SHIFT
        is_near_line &= match_begin + match_number < match_end
        previous_crossing = np.where(
            (previous_crossing < 0) & is_near_line, candidate_crossing, previous_crossing
        )
    return previous_crossing


# ---------------------------------------------------------------- joining spaces


class SpaceMerger:
    """Joins the spaces (connected parts of the floor) on both sides of gaps, pair by pair.

    Whether two spaces are joined depends on the width of the gap between them, divided by the width
    of each space. Widths of spaces are measured along lines of cells parallel to the gap. Such a
    line may end at a third space. If that is later joined to one of the two, the space has become
    wider, and the gap is measured again.

    Attributes:
        space_of_label: for each label of `SeparatedSpaces.label`, the number of the space that it
            belongs to after the joins so far, int32. A space's number is the least of its labels.
    """

    def __init__(
        self,
        separated_spaces: SeparatedSpaces,
        cell_size: float,
        door_width: float | None,
        rays: WallRays | None = None,
    ) -> None:
        """Measure all gaps.

        Args:
            separated_spaces: the gaps, and the spaces that they separate.
            cell_size: the side of a cell, > 0 [m].
            door_width: the widest gap that separates two spaces [m]; None for the limits of
                `gap_limits.py`.
            rays: rays to the geometry of walls, up to which widths are measured. If None, a wall is
                taken to begin half a column from the centre of the last open cell.
        """
        self._directions = separated_spaces.direction_gaps
        self._cell_size = cell_size
        self._door_width = door_width
        self._rays = rays
        # Of each space, after the joins so far; and before any were joined
        self._num_cells = separated_spaces.num_cells.astype(np.int64)
        self._initial_num_cells = separated_spaces.num_cells
        self.space_of_label = np.arange(len(separated_spaces.num_cells), dtype=np.int32)
        # Gaps of all directions are numbered one after another.
        num_gaps_of_direction = [
            len(direction.gaps.first_col) for direction in separated_spaces.direction_gaps
        ]
        # The number of each direction's first gap
        self._first_gap = np.cumsum([0, *num_gaps_of_direction])
        self._direction_of = np.repeat(np.arange(len(num_gaps_of_direction)), num_gaps_of_direction)
        self._walls = [
            _find_gap_walls(direction_gaps, cell_size, rays)
            for direction_gaps in separated_spaces.direction_gaps
        ]
        num_gaps = len(self._direction_of)
        self._width = np.ones(num_gaps)  # [cells]
        self._is_doorway = np.zeros(num_gaps, dtype=np.bool_)
        self._labels = np.empty((num_gaps, 2), dtype=np.int64)  # of the spaces above and below
        for direction_number, (direction, _, gaps) in enumerate(separated_spaces.direction_gaps):
            gap_range = slice(
                self._first_gap[direction_number], self._first_gap[direction_number + 1]
            )
            columns_between_ends = gaps.last_col - gaps.first_col
            distance_to_walls = self._walls[direction_number].end_distance.sum(axis=1)
            self._width[gap_range] = (
                columns_between_ends + distance_to_walls
            ) * direction.length_per_column
            self._is_doorway[gap_range] = gaps.is_doorway
            self._labels[gap_range, 0] = gaps.label_above
            self._labels[gap_range, 1] = gaps.label_below
        # Each gap's width, divided by that of the space above and below
        self._shares = np.ones((num_gaps, 2))
        # The share by which each gap was decided, see `_find_deciding_share`; NaN if by none
        self._deciding_share = np.full(num_gaps, np.nan)
        # For each space, the gaps beside it, and other gaps whose lines met it
        self._gaps_beside: list[set[int]] = [set() for _ in separated_spaces.num_cells]
        self._gaps_meeting: list[set[int]] = [set() for _ in separated_spaces.num_cells]
        for gap, labels in enumerate(self._labels.tolist()):
            for label in labels:
                self._gaps_beside[label].add(gap)
        self.measure(np.arange(num_gaps))

    def join_spaces(self) -> None:
        """Join the spaces on both sides of all gaps that are too wide to separate rooms.

        A gap is too wide if it is nearly as wide as one of its two spaces, or wider than a door.
        Gaps that are nearly as wide as both spaces come first. So a gap that spans a whole room is
        joined before a doorway next to it is decided.
        """
        for compares_with_wider in (True, False):
            queue = list[tuple[tuple[bool, float], int]]()
            for gap in range(len(self._width)):
                priority = (
                    self._find_priority(gap, compares_with_wider) if self.separates(gap) else None
                )
                if priority is not None:
                    queue.append((priority, gap))
            heapq.heapify(queue)
            while queue:
                priority, gap = heapq.heappop(queue)
                # A gap that was measured again is in the queue a second time. Also, a passage may
                # have become long enough to be a room.
                if not self.separates(gap) or priority != self._find_priority(
                    gap, compares_with_wider
                ):
                    continue
                for measured_gap in self.join(gap):
                    new_priority = self._find_priority(measured_gap, compares_with_wider)
                    if new_priority is not None:
                        heapq.heappush(queue, (new_priority, measured_gap))

    def _find_priority(self, gap: int, compares_with_wider: bool) -> tuple[bool, float] | None:
        """Return a gap's place in the order in which spaces are joined; None if it still separates.

        Gaps with the lowest tuple come first.

        Args:
            gap: the gap's number.
            compares_with_wider: True to compare the gap's width with the width of the wider space
                beside it; then gaps with a larger share of that width come first, and doorways
                last. False to compare it with the width of the narrower space; then wider gaps come
                first.
        """
        if compares_with_wider:
            share = min(self._shares[gap].tolist())
            if share < JOIN_SHARE_OF_WIDER:
                return None
            return bool(self._is_doorway[gap]), -share
        if self._find_deciding_share(gap) < JOIN_SHARE_OF_NARROWER:
            return None
        return False, -float(self._width[gap])

    def _find_deciding_share(self, gap: int) -> float:
        """Return the number from 0 to 1 that decides whether the spaces of a gap are joined.

        It is usually the gap's width, divided by the width of the narrower space beside it; then it
        is recorded for `list_close_calls`. It is 0, which joins nothing, at the mouth of a long
        passage into a wider space; and 1, which joins, for a gap that is too wide for a door.

        Args:
            gap: the gap's number.
        """
        share_above, share_below = self._shares[gap].tolist()
        narrower_space = self.space_of_label[
            self._labels[gap, 0 if share_above >= share_below else 1]
        ]
        is_long_passage = (
            self._num_cells[narrower_space] >= MIN_PASSAGE_LENGTH * self._width[gap] ** 2
        )
        width = float(self._width[gap]) * self._cell_size - WIDTH_ROUNDING
        may_separate = self._door_width is None or width <= self._door_width
        if (
            is_long_passage
            and min(share_above, share_below) <= 1 / PASSAGE_WIDENING
            and may_separate
        ):
            return 0.0
        if width > (self._door_width or MAX_GAP_WIDTH):
            return 1.0
        share: float = max(share_above, share_below)
        self._deciding_share[gap] = share
        return share

    def list_close_calls(self) -> list[CloseCall]:
        """List the gaps for which it was a close decision whether they separate two large spaces.

        At such a gap, the gap's width divided by that of the narrower space beside it differs by at
        most `CLOSE_SHARE` from the limit `JOIN_SHARE_OF_NARROWER`, from which on the spaces are
        joined. A warning names these gaps.
        """
        is_close_call = np.abs(self._deciding_share - JOIN_SHARE_OF_NARROWER) <= CLOSE_SHARE
        is_close_call &= self._width * self._cell_size >= MIN_CLOSE_WIDTH
        close_calls = []
        for gap in np.flatnonzero(is_close_call).tolist():
            separates = self.separates(gap)
            labels = self._labels[gap]
            if separates:
                num_cells = self._num_cells[self.space_of_label[labels]]
            else:
                num_cells = self._initial_num_cells[labels]
            if (num_cells < MIN_CLOSE_AREA / self._cell_size**2).any():
                continue
            width = float(self._width[gap]) * self._cell_size
            close_calls.append(CloseCall(self._middle_of(gap), width, separates))
        return close_calls

    def _middle_of(self, gap: int) -> tuple[float, float]:
        """Return the row and the column of a gap's middle, with fractions."""
        direction_number = int(self._direction_of[gap])
        direction, _, gaps = self._directions[direction_number]
        gap_index = gap - int(self._first_gap[direction_number])
        col = float(gaps.first_col[gap_index] + gaps.last_col[gap_index]) / 2
        row = float(gaps.top_row[gap_index].mean() + gaps.bottom_row[gap_index].mean()) / 2
        return (col, row) if direction.is_swapped else (row, col)

    def separates(self, gap: int) -> bool:
        """Return whether a gap still separates two spaces: those beside it have not been joined.

        Args:
            gap: the gap's number.
        """
        label_above, label_below = self._labels[gap]
        return bool(self.space_of_label[label_above] != self.space_of_label[label_below])

    def measure(self, gaps: Int) -> None:
        """Measure gaps' two shares: a gap's width, divided by the width of the space on each side.

        Args:
            gaps: the numbers of the gaps to measure, shape (n,).
        """
        direction_of_gap = self._direction_of[gaps]
        for direction_number in sorted(set(direction_of_gap.tolist())):
            direction, scan, direction_gaps = self._directions[direction_number]
            first_gap = int(self._first_gap[direction_number])
            gap_numbers = gaps[direction_of_gap == direction_number] - first_gap
            gap_walls = self._walls[direction_number]
            lines, shares, needs_rays, third_spaces = kernels.measure_gaps(
                scan, direction_gaps, gap_numbers, self.space_of_label, gap_walls
            )
            for gap, space in third_spaces:
                self._gaps_meeting[space].add(first_gap + gap)
            if self._rays is not None and needs_rays.any():
                # The first call measures all gaps, and casts most rays that later calls need.
                if len(gap_numbers) == len(direction_gaps.first_col):
                    is_cast = np.ones_like(needs_rays)
                else:
                    is_cast = needs_rays
                cells = np.stack([lines.wall_cell[is_cast], lines.opening_cell[is_cast]])
                cast_rays = self._rays.measure(direction, cells.reshape(-1, 2))
                gap_walls = gap_walls._replace(coded_distance=cast_rays.coded_distance)
                self._walls[direction_number] = gap_walls
                _, shares_to_walls, _, _ = kernels.measure_gaps(
                    scan, direction_gaps, gap_numbers[needs_rays], self.space_of_label, gap_walls
                )
                shares[needs_rays] = shares_to_walls
            self._shares[first_gap + gap_numbers] = shares

    def join(self, gap: int) -> list[int]:
        """Join the spaces on both sides of a gap.

        Args:
            gap: the gap's number.

        Returns:
            The numbers of the gaps that were measured again, because one of the two spaces is
            beside the gap, and a line that measured it had ended at the other.
        """
        space_above, space_below = self.space_of_label[self._labels[gap]].tolist()
        affected_gaps = self._gaps_beside[space_above] & self._gaps_meeting[space_below]
        affected_gaps |= self._gaps_beside[space_below] & self._gaps_meeting[space_above]
        kept_space = min(space_above, space_below)
        removed_space = max(space_above, space_below)
        self.space_of_label[self.space_of_label == removed_space] = kept_space
        self._num_cells[kept_space] += self._num_cells[removed_space]
        for gaps_of_space in (self._gaps_beside, self._gaps_meeting):
            smaller_set, larger_set = sorted(
                (gaps_of_space[kept_space], gaps_of_space[removed_space]), key=len
            )
            larger_set |= smaller_set
            gaps_of_space[kept_space] = larger_set
            gaps_of_space[removed_space] = set()
        separating_gaps = [
            affected_gap for affected_gap in sorted(affected_gaps) if self.separates(affected_gap)
        ]
        self.measure(np.array(separating_gaps, dtype=np.int64))
        return separating_gaps


def _find_gap_walls(
    direction_gaps: DirectionGaps, cell_size: float, rays: WallRays | None
) -> GapWalls:
    """Find how far walls are from the first and last cells of a direction's gaps.

    A gap has no wall at an end where the opening continues between two other spaces. There, or if
    the wall is too far away, or without rays, the gap ends half a column from the centre of its
    last cell.

    Args:
        direction_gaps: the gaps of a direction.
        cell_size: the side of a cell, > 0 [m].
        rays: rays to the geometry of walls; None to measure nothing.
    """
    direction, scan, gaps = direction_gaps
    shift = scan.shift
    end_cols = np.stack([gaps.first_col, gaps.last_col], axis=1)
    middle_rows = (gaps.top_row + gaps.bottom_row) // 2
    max_jamb_distance = max(
        MAX_WALL_DISTANCE, MAX_JAMB_DISTANCE / (direction.length_per_column * cell_size)
    )
    max_distance = np.where(gaps.is_doorway, max_jamb_distance, MAX_WALL_DISTANCE)
    # The cells in the next column after each end
    next_cols = np.clip(end_cols + np.array([-1, 1]), 0, len(shift) - 1)
    row_shift_to_next = shift[next_cols] - shift[end_cols]
    last_row = len(scan.label) - 1
    rows_above = np.clip(gaps.top_row - 1 + row_shift_to_next, 0, last_row)
    rows_between = np.clip(middle_rows + row_shift_to_next, 0, last_row)
    rows_below = np.clip(gaps.bottom_row + 1 + row_shift_to_next, 0, last_row)
    label_above = scan.label[rows_above, next_cols]
    label_below = scan.label[rows_below, next_cols]
    is_opening_continued = (
        scan.is_open[rows_between, next_cols] & (label_above > 0) & (label_below > 0)
    )
    is_opening_continued &= (label_above != gaps.label_above[:, None]) | (
        label_below != gaps.label_below[:, None]
    )
    end_cells = np.where(is_opening_continued, -1, middle_rows * len(shift) + end_cols)
    if rays is None:
        rays_of_cell = np.zeros(scan.label.size, dtype=np.int32)
        coded_distance = np.full((1, 2), 1.5)
    else:
        cast_rays = rays.measure(direction, end_cells)
        rays_of_cell = cast_rays.rays_of_cell
        coded_distance = cast_rays.coded_distance
    wall_distance = coded_distance[rays_of_cell[end_cells], [0, 1]] - 1.0
    has_wall = (end_cells >= 0) & (wall_distance <= max_distance[:, None])
    return GapWalls(
        end_distance=np.where(has_wall, wall_distance, 0.5),
        max_distance=max_distance,
        rays_of_cell=rays_of_cell,
        coded_distance=coded_distance,
    )
