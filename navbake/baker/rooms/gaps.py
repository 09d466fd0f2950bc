"""Rooms from gaps that part spaces by their width against the width of both."""

from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from navbake.baker.rooms.distances import squared_distances
from navbake.baker.rooms.kernels import gaps as kernels
from navbake.baker.rooms.kernels.labels import label_parts
from navbake.types import Bool, Float, Int, Int32

T = TypeVar("T", bound=np.generic)
Marks = NDArray[np.uint8]

# The widest opening that can part two rooms [m]
WIDEST = 2.5
# The widest mouth of a passage that is a room of its own, and the widest opening in whose line
# another wall can end [m]
PASSAGE, WIDE = 3.2, 4.0
# Two spaces are one where the gap between them is at least this share of both, or of the narrower
BOTH, NARROWER = 0.8, 0.78
# A gap is looked for where the space widens by this factor, and by this much [m]
GROWTH, RISE = 1.15, 0.2
# Walls are at most this thick at a doorway [m]
THICKNESS = 0.6
# How wide the spaces are is measured so far behind the gap; the widest counts [m]
DEPTHS = (0.1, 0.25, 0.45)
# A passage opens into a space as wide as it is, but is its own from this length on, measured in
# its widths, where the space is wider by this factor
LONG, WIDER = 3.0, 1.5
# A gap was a close call within this of the share that decides, if it is so wide [m] and both spaces
# are so large [m²]
CLOSE, CLOSE_WIDTH, CLOSE_AREA = 0.04, 0.8, 4.0
# The directions of walls are taken at this distance from them, in bins of so many degrees; those
# count that belong to this length of wall, and to this share of all
OFF_WALL, BIN, LEAST_WALL, LEAST_SHARE = 0.3, 5, 2.0, 0.01
# Nearer to it [cells] the lattice's steps disturb it; and walls this near to an axis of the
# lattice run along it [degrees]
OFF_STEPS, ALONG_AXIS = 5, 1.0
# Cells round the lattice in which slopes at its edge are measured
PADDING = 2


class Direction(NamedTuple):
    """A direction that walls run in.

    Attributes:
        swapped: whether it is scanned with rows and columns swapped.
        shift: the row of a line in each column less that in the first, (cols,) int64.
        stretch: length of a step along the line [cells].
    """

    swapped: bool
    shift: Int
    stretch: float


class CloseCall(NamedTuple):
    """A gap that hardly parts two spaces, or nearly does.

    Attributes:
        cell: row and column of its middle.
        width: [m].
        parts: whether it does.
    """

    cell: tuple[float, float]
    width: float
    parts: bool


@dataclass(frozen=True)
class GapsOfDirection:
    """The gaps of a direction, with what `measure_gaps` wants to know.

    Attributes:
        label, is_open: of the cells, as the direction is scanned.
        gaps: see `measure_gap`, shape (n, 9), int64.
        depths: how far behind them to measure, int64 [rows].
    """

    direction: Direction
    label: Int32
    is_open: Bool
    gaps: Int
    depths: Int


def find_directions(open_cells: Bool, cell_size: float) -> list[Direction]:
    """Find the directions that walls run in, from the slope of the distance to them."""
    reach = max(OFF_STEPS, round(OFF_WALL / cell_size))
    # the edge of the lattice is no wall: what is there goes on beyond it
    closed = np.pad(~open_cells, PADDING, mode="edge")
    squared = squared_distances(closed, reach + 2, 0, 1)
    distance = np.sqrt(squared, dtype=np.float32)
    at = (squared[2:-2, 2:-2] >= (reach - 1) ** 2) & (squared[2:-2, 2:-2] < reach**2)
    rows, cols = np.nonzero(at)
    rows, cols = rows + 2, cols + 2
    down = distance[rows + 2, cols] - distance[rows - 2, cols]
    right = distance[rows, cols + 2] - distance[rows, cols - 2]
    # a wall runs across the slope; where two walls are as near, there is less of one
    clear = np.hypot(down, right) > 3.2
    angle = np.mod(np.rad2deg(np.arctan2(down[clear], right[clear])) + 90.0, 180.0)
    num = 180 // BIN
    count = np.bincount(np.rint(angle / BIN).astype(np.int64) % num, minlength=num).astype(float)
    smooth = count + np.roll(count, 1) + np.roll(count, -1)
    # round the corners of walls the slope has all directions alike
    around = 2.0 * float(np.median(smooth))
    least = around + max(LEAST_WALL / cell_size, LEAST_SHARE * count.sum())
    is_peak = np.all([smooth >= np.roll(smooth, k) for k in (-2, -1, 1, 2)], axis=0)
    smooth[~is_peak] = 0.0
    directions = []
    while smooth.max() >= least:
        best = int(smooth.argmax())
        off = (angle - best * BIN + 90.0) % 180.0 - 90.0
        mean = best * BIN + float(off[np.abs(off) <= 1.5 * BIN].mean())
        axis = 90.0 * round(mean / 90.0)
        if abs(mean - axis) <= ALONG_AXIS:
            directions.append(_direction(axis, open_cells.shape))
        else:
            directions.append(_direction(mean, open_cells.shape))
        smooth[np.arange(best - 2, best + 3) % num] = 0.0
    return directions


def _direction(angle: float, shape: tuple[int, ...]) -> Direction:
    """A direction from its angle from the columns' axis towards the rows' [degrees]."""
    swapped = 45.0 < angle < 135.0
    slope = np.tan(np.deg2rad(90.0 - angle if swapped else angle))
    count = shape[0] if swapped else shape[1]
    shift = np.rint(np.arange(count) * slope).astype(np.int64)
    return Direction(swapped, shift, float(np.hypot(1.0, slope)))


def _find_gap_cells(open_cells: Bool, directions: list[Direction], cell_size: float) -> list[Marks]:
    """Mark the cells of the gaps of each direction, as it is scanned.

    Gaps with steps on both sides, such as doorways, come first. They are walls to what is found
    then: so a line across a corridor does not lead through a door into a room, and a wall that
    ends in the middle of a wide opening goes on up to the line of that opening.
    """
    marks = [np.zeros(turned(open_cells, d).shape, dtype=np.uint8) for d in directions]
    for widest, both in ((WIDE, True), (PASSAGE, False)):
        is_open = open_cells & ~_join_marks(marks, directions, open_cells)
        for direction, mark in zip(directions, marks, strict=True):
            run = kernels.measure_runs(turned(is_open, direction), direction.shift)
            step = direction.stretch * cell_size
            thickness = int(THICKNESS * direction.stretch / cell_size) + 2
            kernels.mark_gaps(run, int(widest / step), GROWTH, RISE / step, thickness, both, mark)
    return marks


def _join_marks(marks: list[Marks], directions: list[Direction], like: Bool) -> Bool:
    """The cells that are marked in any direction."""
    marked = np.zeros(like.shape, dtype=np.bool_)
    for mark, direction in zip(marks, directions, strict=True):
        marked |= (mark.T if direction.swapped else mark) > 0
    return marked


def part_at_gaps(open_cells: Bool, holes: Bool, cell_size: float) -> tuple[Int32, list[CloseCall]]:
    """Label the spaces that gaps part; the cells of gaps have none yet.

    Holes have no floor, but no wall either. Also lists the gaps that hardly part two spaces, and
    those that nearly do.
    """
    space = open_cells | holes
    directions = find_directions(space, cell_size)
    marks = _find_gap_cells(space, directions, cell_size)
    marked = _join_marks(marks, directions, open_cells)
    label, count = label_parts(open_cells & ~marked)
    found = []
    for direction, own in zip(directions, marks, strict=True):
        label_there, gap_there = turned(label, direction), turned(marked, direction)
        thickness = int(THICKNESS * direction.stretch / cell_size) + 2
        crossings = kernels.list_crossings(label_there, gap_there, own, thickness)
        number = kernels.group_crossings(crossings, direction.shift)
        depths = [max(1, round(depth * direction.stretch / cell_size)) for depth in DEPTHS]
        open_there = turned(space, direction)
        gaps, depth = _describe(crossings, number), np.array(depths, dtype=np.int64)
        found.append(GapsOfDirection(direction, label_there, open_there, gaps, depth))
    spaces = _Spaces(found, np.bincount(label.ravel(), minlength=count + 1), cell_size)
    spaces.join_continued()
    spaces.join_narrower()
    return spaces.whole.astype(np.int32)[label], spaces.close_calls()


def _describe(crossings: Int, number: Int) -> Int:
    """First and last column of each gap, its rows there, its regions, its mark, shape (n, 9)."""
    if not len(crossings):
        return np.empty((0, 9), dtype=np.int64)
    order = np.argsort(number, kind="stable")
    start = np.flatnonzero(np.diff(number[order], prepend=-1))
    end = np.append(start[1:], len(order)) - 1
    a, b = crossings[order[start]], crossings[order[end]]
    mark = np.maximum.reduceat(crossings[order, 5], start)
    ends = a[:, 0], b[:, 0], a[:, 1], a[:, 2], b[:, 1], b[:, 2]
    return np.stack([*ends, a[:, 3], a[:, 4], mark], axis=1)


class _Spaces:
    """The spaces between gaps, and which of them have been joined.

    Args:
        found: the gaps of each direction.
        cells: how many each space has, from 0 for none.
    """

    def __init__(self, found: list[GapsOfDirection], cells: Int, cell_size: float) -> None:
        self.whole = np.arange(len(cells), dtype=np.int64)
        self._found = found
        self._cells = cells.astype(np.int64)
        self._first = self._cells.copy()  # before any was joined
        self._cell_size = cell_size
        stretched = [(g.gaps[:, 1] - g.gaps[:, 0] + 1) * g.direction.stretch for g in found]
        self._width = np.concatenate([np.empty(0), *stretched])  # of each gap [cells]
        pairs = [g.gaps[:, 6:8] for g in found]
        self._pairs = np.concatenate([np.empty((0, 2), dtype=np.int64), *pairs])
        self._is_doorway = np.concatenate([np.empty(0), *(g.gaps[:, 8] for g in found)]) == 2
        # the share that decided about each gap, NaN for none
        self._decided = np.full(len(self._width), np.nan)

    def join_continued(self) -> None:
        """Join spaces that a gap leaves as wide as both of them are."""
        while True:
            shares = self._measure().min(axis=1)
            joins = self._apart() & (shares >= BOTH)
            if not joins.any():
                return
            # a line across a room that is drawn at a doorway's edge goes before the doorway
            others = joins & ~self._is_doorway
            self._join_widest(np.flatnonzero(others if others.any() else joins), shares)

    def join_narrower(self) -> None:
        """Join spaces that a gap leaves as wide as the narrower is, but for long passages."""
        while True:
            shares = self._measure()
            most = shares.max(axis=1)
            narrow = np.where(shares[:, 0] >= shares[:, 1], *self._pairs.T)
            long = self._cells[self.whole[narrow]] >= LONG * self._width**2
            own = long & (shares.min(axis=1) <= 1 / WIDER)
            self._decided = np.where(self._apart() & ~own, most, self._decided)
            most[self._width * self._cell_size > WIDEST] = 1.0
            joins = np.flatnonzero(self._apart() & (most >= NARROWER) & ~own)
            if not len(joins):
                return
            self._join_widest(joins, most)

    def _join_widest(self, gaps: Int, shares: Float) -> None:
        """Join the spaces on both sides of gaps, those with the largest shares first.

        What has grown is measured again before it grows more.
        """
        changed: set[int] = set()
        for k in gaps[np.argsort(-shares[gaps], kind="stable")]:
            both = self.whole[self._pairs[k]].tolist()
            if both[0] != both[1] and changed.isdisjoint(both):
                changed.update(both)
                self._join(*both)

    def close_calls(self) -> list[CloseCall]:
        """The gaps between two spaces of some size that were decided by little."""
        close = np.abs(self._decided - NARROWER) <= CLOSE
        close &= self._width * self._cell_size >= CLOSE_WIDTH
        least = CLOSE_AREA / self._cell_size**2
        parted = self._apart()
        calls = []
        number = 0
        for g in self._found:
            for gap in g.gaps:
                k, number = number, number + 1
                sizes = self._cells[self.whole[gap[6:8]]] if parted[k] else self._first[gap[6:8]]
                if close[k] and (sizes >= least).all():
                    col, row = (gap[0] + gap[1]) / 2, float(gap[2:6].mean())
                    cell = (col, row) if g.direction.swapped else (row, col)
                    width = float(self._width[k]) * self._cell_size
                    calls.append(CloseCall(cell, width, bool(parted[k])))
        return calls

    def _apart(self) -> Bool:
        apart: Bool = self.whole[self._pairs[:, 0]] != self.whole[self._pairs[:, 1]]
        return apart

    def _measure(self) -> Float:
        """The share that each gap has of the spaces on both sides, shape (n, 2)."""
        shares = [
            kernels.measure_gaps(
                g.label, g.is_open, self.whole, g.direction.shift, g.gaps, g.depths
            )
            for g in self._found
        ]
        return np.concatenate([np.empty((0, 2)), *shares])

    def _join(self, one: int, other: int) -> None:
        if one != other:
            to, gone = min(one, other), max(one, other)
            self.whole[self.whole == gone] = to
            self._cells[to] += self._cells[gone]


def turned(array: NDArray[T], direction: Direction) -> NDArray[T]:
    """An array as the kernels scan it in a direction."""
    return np.ascontiguousarray(array.T) if direction.swapped else array
