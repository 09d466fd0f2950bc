"""A path as something to drive along: how far one has come, and how far on it is free now."""

from typing import NamedTuple

import numpy as np

from navbake.runtime.paths.path import Path
from navbake.runtime.paths.search import Search
from navbake.types import Bool, Float, Int

# Functions import kernels when they run: numba takes long to load.

IN_LINE = 1e-9  # metres that a point of a straight line may be off it
INSIDE = 1e-3  # share of a line by which its ends are moved in, off the edges of cells
HALVINGS = 10  # of a blocked line, to find how far it is free


class _Legs(NamedTuple):
    """The straight lines of a path, seen from above.

    Attributes:
        start, end: world x, y [m], shape (n, 2).
        run: distances along the path of the starts, and of the last end [m], shape (n + 1,).
        level: of each, shape (n,); -1 for a step over a link.
        is_swept: whether the agent's disc could be swept along the line when it was planned; if
            not, it leads from one cell's centre to the next.
    """

    start: Float
    end: Float
    run: Float
    level: Int
    is_swept: Bool


class Way:
    """A path that is driven.

    Args:
        path: what was planned.
        search: what it was planned on.

    Attributes:
        path: as given.
        length: of the path, seen from above [m].
    """

    def __init__(self, path: Path, search: Search) -> None:
        self.path = path
        steps = np.hypot(*np.diff(path.positions[:, :2], axis=0).T)
        self._run = np.concatenate([[0.0], np.cumsum(steps)])
        self.length = float(self._run[-1])
        self._legs = self._make_legs(search)

    def at(self, distance: float) -> Float:
        """World x, y, z [m] at a distance along the path, limited to its ends."""
        return np.array([np.interp(distance, self._run, axis) for axis in self.path.positions.T])

    def level_at(self, distance: float) -> int:
        """The level at a distance along the path."""
        last = len(self._run) - 1
        return int(self.path.levels[min(int(np.searchsorted(self._run, distance, "right")), last)])

    def nearest(self, position: Float, low: float, high: float) -> float:
        """The distance along the path, from low to high, at which it is the nearest [m]."""
        start, end, run = self._legs.start, self._legs.end, self._legs.run
        if not len(start):
            return 0.0
        ways, lengths = end - start, np.diff(run)
        along = ((position[:2] - start) * ways).sum(axis=1) / np.maximum(lengths, IN_LINE)
        distance = np.clip(run[:-1] + np.clip(along, 0.0, lengths), low, high)
        share = (distance - run[:-1]) / np.maximum(lengths, IN_LINE)
        off = np.hypot(*(start + share[:, None] * ways - position[:2]).T)
        off[(run[1:] < low) | (run[:-1] > high)] = np.inf
        return float(distance[int(np.argmin(off))])

    def free_until(self, search: Search, begin: float) -> float:
        """The distance along the path up to which it is free now, from `begin` on [m]."""
        legs = self._legs
        first = max(int(np.searchsorted(legs.run, begin, side="right")) - 1, 0)
        for k in range(first, len(legs.level)):
            length = float(legs.run[k + 1] - legs.run[k])
            skipped = max(begin - float(legs.run[k]), 0.0) / max(length, IN_LINE)
            if not self._is_free(search, k, skipped, 1.0):
                return float(legs.run[k]) + length * self._free_share(search, k, skipped)
        return self.length

    def _free_share(self, search: Search, leg: int, begin: float) -> float:
        """Up to which share a leg is free, from a share on."""
        low, high = begin, 1.0
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (
                (middle, high) if self._is_free(search, leg, begin, middle) else (low, middle)
            )
        return low

    def _is_free(self, search: Search, leg: int, begin: float, end: float) -> bool:
        """Whether a part of a leg is free now."""
        legs, flat = self._legs, search.flat
        way, level = legs.end[leg] - legs.start[leg], int(legs.level[leg])
        a, b = (legs.start[leg] + share * way for share in (begin, end))
        if level < 0:
            return True  # the legs before and after it end in the cells that the link joins
        if legs.is_swept[leg]:
            return passes(search, a, b, level)
        cell = float(flat.layout.cell_size[level])
        count = max(round(float(np.abs(way).max()) / cell), 1)
        shares = np.clip(np.arange(count + 1) / count, INSIDE, 1.0 - INSIDE)
        # of the centres that it passes, the last before the part begins counts as well
        shares = shares[(shares > begin - 1.0 / count) & (shares <= end + IN_LINE)]
        cells = flat.cells_at(legs.start[leg] + shares[:, None] * way, level)
        cells = cells[cells >= 0]
        is_diagonal = bool((np.abs(way) > cell / 4).all())
        free = search.free_diagonally[cells] & flat.free[cells] if is_diagonal else flat.free[cells]
        return bool(free.all())

    def _make_legs(self, search: Search) -> _Legs:
        """Join what is in one line: heights of the floor bend a path where nothing else does."""
        p, levels, run = self.path.positions[:, :2], self.path.levels, self._run
        kept: list[int] = [0]
        for k in range(1, len(p) - 1):
            before, after = p[k] - p[kept[-1]], p[k + 1] - p[k]
            cross = before[0] * after[1] - before[1] * after[0]
            is_straight = abs(cross) <= IN_LINE and float(before @ after) >= 0.0
            if not is_straight or not levels[kept[-1]] == levels[k] == levels[k + 1]:
                kept.append(k)
        kept.append(len(p) - 1)
        start, end = np.array(kept[:-1]), np.array(kept[1:])
        level = np.where(levels[start] == levels[end], levels[start], -1)
        swept = [
            number >= 0 and passes(search, p[a], p[b], number)
            for a, b, number in zip(start, end, level.tolist(), strict=True)
        ]
        runs = run[np.array(kept)]
        return _Legs(p[start], p[end], runs, level, np.array(swept, dtype=np.bool_))


def passes(search: Search, a: Float, b: Float, level: int) -> bool:
    """Whether an agent can move now along a line between two points x, y of a level [m]."""
    from navbake.runtime.kernels.string import can_pass

    return bool(can_pass(a, b, level, search.graph, search.off_center))
