"""The spaces between gaps: which of them are joined to one, and by which gap."""

import heapq
from typing import NamedTuple

import numpy as np

from navbake.baker.rooms.directions import Direction
from navbake.baker.rooms.kernels import gaps as kernels
from navbake.baker.rooms.kernels.gaps import Gaps, Scan
from navbake.types import Int, Int32

# The widest opening that can part two rooms [m]
WIDEST = 2.5
# Two spaces are one where the gap between them is at least this share of both, or of the narrower
BOTH, NARROWER = 0.8, 0.78
# A passage opens into a space as wide as it is, but is its own from this length on, measured in
# its widths, where the space is wider by this factor
LONG, WIDER = 3.0, 1.5
# A gap was a close call within this of the share that decides, if it is so wide [m] and both spaces
# are so large [m²]
CLOSE, CLOSE_WIDTH, CLOSE_AREA = 0.04, 0.8, 4.0


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


class GapsOfDirection(NamedTuple):
    """The gaps of a direction, and the lattice as they are measured in it."""

    direction: Direction
    scan: Scan
    gaps: Gaps


class Spaces:
    """The spaces between gaps, and which of them have been joined.

    Spaces are joined one pair at a time, at the widest gap of all. What a gap's shares depend on
    is near it: they are measured again only where one of the two spaces is joined to one that the
    gap's lines met.

    Args:
        found: the gaps of each direction.
        cells: how many each space has, from 0 for none.
    """

    def __init__(self, found: list[GapsOfDirection], cells: Int, cell_size: float) -> None:
        self._found = found
        self._cells = cells.astype(np.int64)
        self._first = self._cells.copy()  # before any was joined
        self._cell_size = cell_size
        self._parent = np.arange(len(cells), dtype=np.int32)
        # of each gap, those of all directions together
        self._start = np.cumsum([0, *(len(g.gaps.first) for g in found)])
        widths = [(g.gaps.last - g.gaps.first + 1) * g.direction.stretch for g in found]
        self._width = np.concatenate([np.empty(0), *widths])  # [cells]
        self._is_doorway = np.concatenate([np.empty(0), *(g.gaps.is_doorway for g in found)]) > 0
        pairs = [np.stack([g.gaps.above, g.gaps.below], axis=1) for g in found]
        self._pairs = np.concatenate([np.empty((0, 2), dtype=np.int64), *pairs])
        self._shares = np.ones((len(self._width), 2))
        # the share that decided about each gap, NaN for none
        self._decided = np.full(len(self._width), np.nan)
        # by space, the gaps at it, and those whose lines met it though they aren't
        self._at: list[set[int]] = [set() for _ in cells]
        self._met_by: list[set[int]] = [set() for _ in cells]
        for k, pair in enumerate(self._pairs.tolist()):
            for space in pair:
                self._at[space].add(k)
        self.measure(np.arange(len(self._width)))

    def join_continued(self) -> None:
        """Join spaces that a gap leaves as wide as both of them are.

        A line across a room that is drawn at a doorway's edge goes before the doorway.
        """
        shares = self._shares.min(axis=1)
        queue = [(bool(self._is_doorway[k]), -float(shares[k]), int(k)) for k in self._all()]
        queue = [entry for entry in queue if -entry[1] >= BOTH]
        heapq.heapify(queue)
        while queue:
            _, negative, gap = heapq.heappop(queue)
            # what was measured again is in the queue again
            if not self._is_apart(gap) or -negative != self._shares[gap].min():
                continue
            for k in self.join(gap):
                share = float(self._shares[k].min())
                if share >= BOTH:
                    heapq.heappush(queue, (bool(self._is_doorway[k]), -share, k))

    def join_narrower(self) -> None:
        """Join spaces that a gap leaves as wide as the narrower is, but for long passages."""
        queue = [(-share, k) for k in self._all() if (share := self._decide(k)) >= NARROWER]
        heapq.heapify(queue)
        while queue:
            negative, gap = heapq.heappop(queue)
            # a passage may have grown long meanwhile
            if not self._is_apart(gap) or -negative != self._decide(gap):
                continue
            for k in self.join(gap):
                if (share := self._decide(k)) >= NARROWER:
                    heapq.heappush(queue, (-share, k))

    def _decide(self, gap: int) -> float:
        """The share by which a gap is decided, 0 for one that parts a long passage."""
        above, below = self._shares[gap].tolist()
        narrow = self._root(int(self._pairs[gap, 0 if above >= below else 1]))
        is_long = self._cells[narrow] >= LONG * self._width[gap] ** 2
        if is_long and min(above, below) <= 1 / WIDER:
            return 0.0
        self._decided[gap] = max(above, below)
        return 1.0 if self._width[gap] * self._cell_size > WIDEST else max(above, below)

    def close_calls(self) -> list[CloseCall]:
        """The gaps between two spaces of some size that were decided by little."""
        close = np.abs(self._decided - NARROWER) <= CLOSE
        close &= self._width * self._cell_size >= CLOSE_WIDTH
        least = CLOSE_AREA / self._cell_size**2
        whole = self.wholes()
        calls = []
        for k in np.flatnonzero(close).tolist():
            parts = self._is_apart(k)
            pair = self._pairs[k]
            sizes = self._cells[whole[pair]] if parts else self._first[pair]
            if (sizes < least).any():
                continue
            number = int(np.searchsorted(self._start, k, side="right")) - 1
            direction, _, gaps = self._found[number]
            i = k - int(self._start[number])
            col = float(gaps.first[i] + gaps.last[i]) / 2
            row = float(gaps.top[i].mean() + gaps.bottom[i].mean()) / 2
            cell = (col, row) if direction.swapped else (row, col)
            calls.append(CloseCall(cell, float(self._width[k]) * self._cell_size, parts))
        return calls

    def wholes(self) -> Int32:
        """The space that each one is part of now."""
        return np.array([self._root(k) for k in range(len(self._parent))], dtype=np.int32)

    def _all(self) -> list[int]:
        """The gaps whose sides are two spaces still."""
        whole = self.wholes()[self._pairs]
        apart: list[int] = np.flatnonzero(whole[:, 0] != whole[:, 1]).tolist()
        return apart

    def _is_apart(self, gap: int) -> bool:
        one, other = self._pairs[gap].tolist()
        return self._root(one) != self._root(other)

    def _root(self, space: int) -> int:
        parent = self._parent
        while parent[space] != space:
            parent[space] = parent[parent[space]]
            space = int(parent[space])
        return space

    def measure(self, gaps: Int) -> None:
        """Measure the share that gaps have of the spaces on both sides."""
        place = np.searchsorted(self._start, gaps, side="right") - 1
        for number in np.unique(place).tolist():
            _, scan, listed = self._found[number]
            chosen = gaps[place == number]
            shares, start, met = kernels.measure_gaps(
                scan, listed, chosen - self._start[number], self._parent
            )
            self._shares[chosen] = shares
            for k, space in zip(
                np.repeat(chosen, np.diff(start)).tolist(), met.tolist(), strict=True
            ):
                self._met_by[space].add(k)

    def join(self, gap: int) -> list[int]:
        """Join the spaces on both sides of a gap; returns the gaps that were measured again."""
        one, other = (self._root(int(space)) for space in self._pairs[gap])
        changed = (self._at[one] & self._met_by[other]) | (self._at[other] & self._met_by[one])
        to, gone = min(one, other), max(one, other)
        self._parent[gone] = to
        self._cells[to] += self._cells[gone]
        for gaps in (self._at, self._met_by):
            small, large = sorted((gaps[to], gaps[gone]), key=len)
            large |= small
            gaps[to], gaps[gone] = large, set()
        apart = [k for k in sorted(changed) if self._is_apart(k)]
        if apart:
            self.measure(np.array(apart, dtype=np.int64))
        return apart
