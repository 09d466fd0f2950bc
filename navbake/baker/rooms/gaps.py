"""Gaps between walls, and the spaces that they part, see `segment_by_gaps`."""

import heapq
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.components import (
    count_cells_by_label,
    find_row_runs,
    label_components,
    label_components_2d,
)
from navbake.baker.rooms import gap_kernels as kernels
from navbake.baker.rooms.gap_kernels import BOTH, FAR, NARROWER, WIDER, Gaps, Scan
from navbake.baker.rooms.walls import FAR_OF_DOORWAY, Direction, WallRays, find_directions, turned
from navbake.threads import run_beside
from navbake.types import Bool, Float, Int, Int32

Marks = NDArray[np.uint8]

# Unless a door's width is given: the widest opening that parts two rooms, the widest mouth of a
# passage that is a room of its own, and the widest opening in whose line another wall can end [m]
WIDEST = 2.5
PASSAGE = 3.2
WIDE = 4.0
# A gap is looked for where the space widens by this factor, and by this much [m]
GROWTH = 1.15
RISE = 0.2
# Walls are at most this thick at a doorway [m]
THICKNESS = 0.6
# Where a gap goes on in the next column, its middle is on a line at most so far apart [lines]
DRIFT = 2
# A smaller space belongs to the gaps round it, whose neighbouring lines leave single cells between
# them where walls are at an angle to the lattice [m²]
ISLAND = 0.1
# How wide the spaces are is measured so far behind the gap; the widest counts [m]
DEPTHS = (0.1, 0.25, 0.45)
# A passage is a space of its own from this length on [widths]
LONG = 3.0
# A gap was a close call within this of the share that decides, if it is so wide [m] and both spaces
# are so large [m²]
CLOSE = 0.04
CLOSE_WIDTH = 0.8
CLOSE_AREA = 4.0
# Of the widest gap [m]
ROUNDING = 1e-9


class CloseCall(NamedTuple):
    """A gap that just parts two spaces, or just not: row and column of its middle, width [m]."""

    cell: tuple[float, float]
    width: float
    parts: bool


Found = tuple[Direction, Scan, Gaps]
"""The gaps of a direction, and the lattice as they are measured in it."""


def find_gaps(
    open_cells: Bool,
    holes: Bool,
    cell_size: float,
    door_width: float | None,
    rays: WallRays | None = None,
    closed: Bool | None = None,
) -> tuple[list[Found], Int32, Int]:
    """The gaps of each direction, the spaces that all of them part, and how many cells each has.

    Space includes `holes`, without floor or wall. A gap wider than `door_width` [m] parts none.
    Cells in a `closed` leaf are in no space and no gap, and lines end at them.
    """
    space = open_cells | holes
    if closed is None:
        closed = np.zeros_like(space)
    directions = find_directions(space, cell_size, rays)
    thickness = [int(THICKNESS * d.stretch / cell_size) + 2 for d in directions]
    # marks of each direction, as it is scanned; and of all. Gaps with steps on both sides, such as
    # doorways, come first, and close the way for others: so a line across a corridor does not go
    # through a door, and a wall's end at a wide opening is continued up to the opening's line
    marks = [np.zeros_like(turned(space, d), dtype=np.uint8) for d in directions]
    marked = closed.copy()
    least = door_width or 0.0
    for widest, both in ((max(WIDE, least), True), (max(PASSAGE, least), False)):
        waiting = []
        left = space & ~marked
        for direction, thick, own in zip(directions, thickness, marks, strict=True):
            step = direction.stretch * cell_size
            limits = int(widest / step), GROWTH, RISE / step, thick, both, own
            is_open = turned(left, direction)
            lines = is_open, direction.shift, turned(direction.near, direction).copy("K")
            waiting.append(run_beside(kernels.mark_gaps, *lines, *limits))
        for wait in waiting:
            wait()
        for direction, own in zip(directions, marks, strict=True):
            marked |= (own.T if direction.swapped else own) > 0
    label, count = label_components_2d(open_cells & ~marked)
    cells = count_cells_by_label(label, count + 1)
    keeps = cells * cell_size**2 >= ISLAND
    keeps[0] = True
    if not keeps.all():  # those that are left keep their order
        marked |= open_cells & ~keeps[label]
        number = np.where(keeps, np.cumsum(keeps) - 1, 0).astype(np.int32)
        label = number[label]
        cells = np.bincount(number, cells).astype(np.int64)
    found = []
    for direction, own in zip(directions, marks, strict=True):
        depths = np.array([max(1, round(d * direction.stretch / cell_size)) for d in DEPTHS])
        leans = np.rint(depths * direction.slope / direction.stretch**2).astype(np.int64)
        is_open = turned(space & ~closed, direction)
        scan = Scan(turned(label, direction), is_open, direction.shift, depths, leans)
        gaps = _list_gaps(scan, turned(marked, direction), own)
        found.append((direction, scan, gaps))
    return found, label, cells


def _list_gaps(scan: Scan, marked: Bool, own: Marks) -> Gaps:
    """The gaps of a direction: neighbouring columns of marked cells.

    They lie between the same two spaces, one cell of each is marked in `own`, and all are open.
    """
    label = scan.label
    shift = scan.shift
    col, top, end, _ = find_row_runs(marked.T)
    bottom = end - 1
    starts = np.cumsum(end - top) - (end - top)
    mark = np.maximum.reduceat(own.T[marked.T], starts)
    above = label[np.maximum(top - 1, 0), col]
    below = label[np.minimum(bottom + 1, len(label) - 1), col]
    # at the lattice's edge that is a marked cell, which has no label
    crosses = (above > 0) & (below > 0) & (above != below) & (mark > 0)
    crosses &= np.logical_and.reduceat(scan.is_open.T[marked.T], starts)
    col = col[crosses].astype(np.int64)
    top = top[crosses].astype(np.int64)
    bottom = bottom[crosses].astype(np.int64)
    above = above[crosses].astype(np.int64)
    below = below[crosses].astype(np.int64)
    mark = mark[crosses].astype(np.int64)
    # the first hit of the column before, between the same spaces, whose line is near
    key = (above * (label.max(initial=0) + 1) + below) * (label.shape[1] + 1) + col
    order = np.argsort(key, kind="stable")
    begin = np.searchsorted(key[order], key - 1, "left")
    end = np.searchsorted(key[order], key - 1, "right")
    line = (top + bottom) / 2 - shift[col]
    before = np.full(len(col), -1)
    for k in range(int((end - begin).max(initial=0))):
        other = order[np.minimum(begin + k, len(order) - 1)]
        near = (begin + k < end) & (np.abs(line[other] - line) <= DRIFT)
        before = np.where((before < 0) & near, other, before)
    goes_on = np.flatnonzero(before >= 0)
    number = label_components(np.stack([before[goes_on], goes_on]), len(col))
    order = np.argsort(number, kind="stable")
    first = np.flatnonzero(np.diff(number[order], prepend=-1))
    a = order[first]
    b = order[np.append(first[1:], len(order))[: len(first)] - 1]
    is_doorway = np.maximum.reduceat(mark[order], first) == 2
    tops = np.stack([top[a], top[b]], axis=1)
    bottoms = np.stack([bottom[a], bottom[b]], axis=1)
    return Gaps(col[a], col[b], tops, bottoms, above[a], below[a], is_doorway)


class Spaces:
    """The spaces between gaps, joined pair by pair; `whole` is the current space of each.

    A gap's shares are measured again only where one of its spaces is joined to one that the gap's
    lines met.
    """

    def __init__(
        self,
        found: list[Found],
        cells: Int,
        cell_size: float,
        door_width: float | None,
        rays: WallRays | None = None,
    ) -> None:
        """Without rays, walls begin half a column beyond the last open cells."""
        self._found = found
        self._cell_size = cell_size
        self._door_width = door_width
        self._rays = rays
        # now, and before any was joined
        self._cells = cells.astype(np.int64)
        self._first = cells
        self.whole = np.arange(len(cells), dtype=np.int32)
        # of each gap, those of all directions together
        counts = [len(gaps.first) for *_, gaps in found]
        self._start = np.cumsum([0, *counts])
        self._number = np.repeat(np.arange(len(found)), counts)
        # by direction, how far walls are from the centres of gaps' end cells, and at most are
        # from those of openings beyond [columns], and what `WallRays.look` returns
        self._walls = list[tuple[Float, Float, Float]]()
        self._width = np.ones(len(self._number))  # [cells]
        for number, (direction, scan, gaps) in enumerate(found):
            own = slice(self._start[number], self._start[number + 1])
            cols = np.stack([gaps.first, gaps.last], axis=1)
            doorway = max(FAR, FAR_OF_DOORWAY / (direction.stretch * cell_size))
            far = np.where(gaps.is_doorway, doorway, FAR)
            # a gap that ends where the opening goes on between other spaces ends at no wall
            rows = (gaps.top + gaps.bottom) // 2
            last = len(scan.label) - 1
            aside = np.clip(cols + np.array([-1, 1]), 0, len(scan.shift) - 1)
            on = scan.shift[aside] - scan.shift[cols]
            top = np.clip(gaps.top - 1 + on, 0, last)
            middle = np.clip(rows + on, 0, last)
            bottom = np.clip(gaps.bottom + 1 + on, 0, last)
            above = scan.label[top, aside]
            below = scan.label[bottom, aside]
            goes_on = scan.is_open[middle, aside] & (above > 0) & (below > 0)
            goes_on &= (above != gaps.above[:, None]) | (below != gaps.below[:, None])
            ends = np.where(goes_on, -1, rows * len(scan.shift) + cols)
            known = rays.look(direction, ends) if rays else np.full((scan.label.size, 2), 1.5)
            beside = known[ends, [0, 1]] - 1.0
            beside = np.where((ends >= 0) & (beside <= far[:, None]), beside, 0.5)
            self._walls.append((beside, far, known))
            inner = gaps.last - gaps.first
            self._width[own] = (inner + beside.sum(axis=1)) * direction.stretch
        self._is_doorway = np.concatenate([np.empty(0), *(g.is_doorway for *_, g in found)]) > 0
        pairs = [np.stack([gaps.above, gaps.below], axis=1) for *_, gaps in found]
        self._pairs = np.concatenate([np.empty((0, 2), dtype=np.int64), *pairs])
        self._shares = np.ones((len(self._width), 2))
        # the share that decided about each gap, NaN for none
        self._decided = np.full_like(self._width, np.nan)
        # by space, the gaps at it, and those whose lines met it though they aren't
        self._at: list[set[int]] = [set() for _ in cells]
        self._met_by: list[set[int]] = [set() for _ in cells]
        for k, pair in enumerate(self._pairs.tolist()):
            for space in pair:
                self._at[space].add(k)
        self.measure(np.arange(len(self._width)))

    def join_all(self) -> None:
        """Join spaces at gaps as wide as both of them are, then as wide as the narrower is.

        A line across a room at a doorway's edge is decided before the doorway.
        """
        for both in (True, False):
            apart = filter(self.parts, range(len(self._width)))
            queue = [(order, k) for k in apart if (order := self._order(k, both)) is not None]
            heapq.heapify(queue)
            while queue:
                order, gap = heapq.heappop(queue)
                # gaps measured again are in the queue again; a passage may have grown long
                if not self.parts(gap) or order != self._order(gap, both):
                    continue
                for k in self.join(gap):
                    if (again := self._order(k, both)) is not None:
                        heapq.heappush(queue, (again, k))

    def _order(self, gap: int, both: bool) -> tuple[bool, float] | None:
        """The priority of joining at a gap, by the share of both or the narrower; None if never."""
        share = min(self._shares[gap].tolist()) if both else self._decide(gap)
        if share < (BOTH if both else NARROWER):
            return None
        return both and bool(self._is_doorway[gap]), -share if both else -float(self._width[gap])

    def _decide(self, gap: int) -> float:
        """The share by which a gap is decided, 0 for one that parts a long passage."""
        above, below = self._shares[gap].tolist()
        narrow = self.whole[self._pairs[gap, 0 if above >= below else 1]]
        is_long = self._cells[narrow] >= LONG * self._width[gap] ** 2
        width = float(self._width[gap]) * self._cell_size - ROUNDING
        may_part = self._door_width is None or width <= self._door_width
        if is_long and min(above, below) <= 1 / WIDER and may_part:
            return 0.0
        if width > (self._door_width or WIDEST):
            return 1.0
        self._decided[gap] = max(above, below)
        return float(self._decided[gap])

    def close_calls(self) -> list[CloseCall]:
        """The gaps between two spaces of some size whose share was close to the limit."""
        close = np.abs(self._decided - NARROWER) <= CLOSE
        close &= self._width * self._cell_size >= CLOSE_WIDTH
        calls = []
        for k in np.flatnonzero(close).tolist():
            parts = self.parts(k)
            pair = self._pairs[k]
            sizes = self._cells[self.whole[pair]] if parts else self._first[pair]
            if (sizes < CLOSE_AREA / self._cell_size**2).any():
                continue
            number = int(self._number[k])
            direction, _, gaps = self._found[number]
            i = k - int(self._start[number])
            col = float(gaps.first[i] + gaps.last[i]) / 2
            row = float(gaps.top[i].mean() + gaps.bottom[i].mean()) / 2
            cell = (col, row) if direction.swapped else (row, col)
            calls.append(CloseCall(cell, float(self._width[k]) * self._cell_size, parts))
        return calls

    def parts(self, gap: int) -> bool:
        """Whether a gap still parts two spaces."""
        above, below = self._pairs[gap]
        return bool(self.whole[above] != self.whole[below])

    def measure(self, gaps: Int) -> None:
        """Measure the share that gaps have of the spaces on both sides."""
        numbers = self._number[gaps]
        for number in sorted(set(numbers.tolist())):
            direction, scan, listed = self._found[number]
            start = int(self._start[number])
            chosen = gaps[numbers == number] - start
            asked = self.whole, self._walls[number]
            lines, shares, waits, met = kernels.measure_gaps(scan, listed, chosen, *asked)
            for k, space in met:
                self._met_by[space].add(start + k)
            if self._rays is not None and waits.any():
                # the rays of most later lines, at once
                some = slice(None) if len(chosen) == len(listed.first) else waits
                self._rays.look(direction, lines[some][..., 4:].reshape(-1, 2))
                again = kernels.measure_gaps(scan, listed, chosen[waits], *asked)
                shares[waits] = again[1]
            self._shares[start + chosen] = shares

    def join(self, gap: int) -> list[int]:
        """Join the spaces on both sides of a gap; returns the gaps that were measured again."""
        one, other = self.whole[self._pairs[gap]].tolist()
        changed = (self._at[one] & self._met_by[other]) | (self._at[other] & self._met_by[one])
        to = min(one, other)
        gone = max(one, other)
        self.whole[self.whole == gone] = to
        self._cells[to] += self._cells[gone]
        for gaps in (self._at, self._met_by):
            small, large = sorted((gaps[to], gaps[gone]), key=len)
            large |= small
            gaps[to] = large
            gaps[gone] = set()
        apart = list(filter(self.parts, sorted(changed)))
        self.measure(np.array(apart, dtype=np.int64))
        return apart
