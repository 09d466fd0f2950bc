"""Drives a mobile base along a path: by pure pursuit, round what comes into its way, or not at all.

Source: Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm" (1992). What is
different: the point ahead is drawn nearer where the straight line to it isn't free; the base turns
on the spot where the point is far to its side; and it slows down so as to stop at its goal, and at
what is blocked.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.runtime.flat_grid import REAL
from navbake.runtime.paths import Path, find_path, run_of
from navbake.runtime.places import snap
from navbake.runtime.search import Search
from navbake.types import Float

DRIVING, WAITING, ARRIVED = "driving", "waiting", "arrived"
TURN_FIRST = math.radians(20.0)  # bearing of the point ahead over which a base turns on the spot
TURN_GAIN = 4.0  # [1/s] how fast it turns there, by the bearing
CLOSER = (1.0, 0.5, 0.25)  # shares of the lookahead that are tried
WORTH = 0.1  # a new path is taken where it is shorter than the rest of the old one by this share
STANDSTILL = 0.01  # [m] to what is blocked: less is no way left
LEAST = 1e-9  # [m] that a leg's length is divided by at least
INSIDE = 1e-3  # share of a line by which its ends are moved in, off the edges of cells
HALVINGS = 10  # of a blocked line, to find how far it is free


@dataclass(frozen=True, eq=False)
class Command:
    """What a base should do now."""

    forward: float  #: Speed along its heading [m/s], >= 0.
    turn: float  #: Rate of its heading, counter-clockwise [rad/s].
    waypoint: Float  #: Where it heads for, world x, y, z [m], shape (3,), as `Follower.waypoint`.


class Follower:
    """Follows a path; `PathFinder.follow` makes it.

    When cells of its grid are blocked or freed, it plans anew, and takes the new path where the
    rest of its own is blocked, or a tenth longer. Without a path, it drives on to where its own is
    blocked, and waits. Its `path` is the one that it follows now, its `state` ``driving``,
    ``waiting`` or ``arrived``; `num_replans` counts the new paths that it took.
    """

    def __init__(self, search: Search, path: Path, limits: dict[str, float]) -> None:
        for name, value in limits.items():
            if not isinstance(value, REAL) or isinstance(value, bool) or not 0 < value < math.inf:
                raise QueryError(f"expected a {name} > 0, got {value!r}")
        self._search, self._goal = search, path.positions[-1]
        self._speed, self._acceleration, self._turn_rate = list(limits.values())[:3]
        self._lookahead, self._tolerance = limits["lookahead"], limits["tolerance"]
        self.state, self.num_replans = DRIVING, 0
        self._version, self._length, self._distance = -1, 0.0, 0.0
        self._take(path)

    @property
    def left(self) -> float:
        """How long the rest of the path is, seen from above [m]."""
        return self._length - self._distance

    def command(self, position: ArrayLike, heading: float) -> Command:
        """What a base with two driven wheels should do now.

        Call it as often as the base is steered, such as every 0.05 s, with its position, world x,
        y, z [m], and its heading, 0 along x, counted towards y [rad].
        """
        p = self._advance(position)
        if not isinstance(heading, REAL) or not math.isfinite(heading):
            raise QueryError(f"expected a finite heading [rad], got {heading!r}")
        target = self._point_ahead(p)
        if self.state != DRIVING:
            return Command(0.0, 0.0, target)
        way = target[:2] - p[:2]
        bearing = math.remainder(math.atan2(way[1], way[0]) - heading, 2.0 * math.pi)
        if abs(bearing) > TURN_FIRST:
            rate = min(TURN_GAIN * abs(bearing), self._turn_rate)
            return Command(0.0, math.copysign(rate, bearing), target)
        curvature = 2.0 * math.sin(bearing) / max(float(np.hypot(*way)), STANDSTILL)
        free_ahead = max(self._free_until - self._distance, 0.0)
        forward = min(self._speed, math.sqrt(2.0 * self._acceleration * free_ahead))
        if forward * abs(curvature) > self._turn_rate:
            forward = self._turn_rate / abs(curvature)
        return Command(forward, forward * curvature, target)

    def waypoint(self, position: ArrayLike) -> Float:
        """Where a base that drives to positions should head for now: world x, y, z [m], shape (3,).

        It is at most the lookahead away along the path; the base's own position, while it waits.
        """
        p = self._advance(position)
        return p if self.state == WAITING else self._point_ahead(p)

    def replan(self, position: ArrayLike) -> bool:
        """Plan anew from a position, and take that path; False where there is none."""
        path = self._plan(self._check(position))
        if path is not None:
            self._take(path)
            self.num_replans += 1
        return path is not None

    def _check(self, position: ArrayLike) -> Float:
        self._search.update()
        flat = self._search.flat
        p = flat.check_one(position)
        return p if len(p) == 3 else np.append(p, float(flat.floors.ground[0]))

    def _advance(self, position: ArrayLike) -> Float:
        """Find how far the base has come, see what has changed, and set the state."""
        p, search = self._check(position), self._search
        self._distance = self._nearest(p)
        if search.version != self._version:  # look at the path again
            self._version = search.version
            self._free_until = self._find_free(self._distance)
            is_blocked, path = self._free_until < self._length, self._plan(p)
            if path is not None and (is_blocked or path.length < (1.0 - WORTH) * self.left):
                self._take(path)
                self.num_replans += 1
        off = np.hypot(*(p - self._goal)[:2])
        if off <= self._tolerance and self.left <= 2 * self._lookahead:
            self.state = ARRIVED
        else:
            left = self._free_until - self._distance
            is_stopped = self._free_until < self._length and left <= STANDSTILL
            self.state = WAITING if is_stopped else DRIVING
        return p

    def _plan(self, p: Float) -> Path | None:
        """A path to the goal from the base, or from the nearest free place if it is in none."""
        flat = self._search.flat
        start, cell = snap(flat, flat.free, p, max_distance=self._lookahead)
        return find_path(self._search, start, self._goal, None, smooth=True) if cell >= 0 else None

    def _take(self, path: Path) -> None:
        """Follow a path from its start on, leg by leg, seen from above.

        The level of a leg is -1 for a step over a link. `_is_swept` says whether the agent's disc
        can be swept along it; if not, it leads from centre to centre.
        """
        self._search.update()
        self.path, self._version = path, self._search.version
        self._points = p = path.positions[:, :2]
        self._run = run_of(path.positions)  # distances along the path of its points [m]
        self._length, self._distance = float(self._run[-1]), 0.0
        one, other = path.levels[:-1], path.levels[1:]
        self._leg_level = np.where(one == other, one, -1)
        self._is_swept = [
            level >= 0 and self._search.can_pass(p[k], p[k + 1], level)
            for k, level in enumerate(self._leg_level.tolist())
        ]
        self._free_until = self._find_free(0.0)

    def _nearest(self, position: Float) -> float:
        """The distance along the path, within twice the lookahead, where a position is nearest."""
        if self._length == 0.0:
            return 0.0
        low, high = self._distance, min(self._distance + 2.0 * self._lookahead, self._length)
        start, run = self._points[:-1], self._run
        ways, lengths = np.diff(self._points, axis=0), np.diff(run)
        along = ((position[:2] - start) * ways).sum(axis=1) / np.maximum(lengths, LEAST)
        distance = np.clip(run[:-1] + np.clip(along, 0.0, lengths), low, high)
        share = (distance - run[:-1]) / np.maximum(lengths, LEAST)
        off = np.hypot(*(start + share[:, None] * ways - position[:2]).T)
        off[(run[1:] < low) | (run[:-1] > high)] = np.inf
        return float(distance[int(np.argmin(off))])

    def _find_free(self, begin: float) -> float:
        """The distance along the path up to which it is free now, from `begin` on [m]."""
        run = self._run
        first = max(int(np.searchsorted(run, begin, side="right")) - 1, 0)
        for k in range(first, len(self._leg_level)):
            length = float(run[k + 1] - run[k])
            low, high = max(begin - float(run[k]), 0.0) / max(length, LEAST), 1.0
            if self._is_free(k, low, high):
                continue
            skipped = low
            for _ in range(HALVINGS):
                middle = (low + high) / 2
                is_free = self._is_free(k, skipped, middle)
                low, high = (middle, high) if is_free else (low, middle)
            return float(run[k]) + length * low
        return self._length

    def _is_free(self, leg: int, begin: float, end: float) -> bool:
        """Whether a leg is free now, from a share of it to another."""
        search, flat, level = self._search, self._search.flat, int(self._leg_level[leg])
        start, way = self._points[leg], self._points[leg + 1] - self._points[leg]
        if level < 0:
            return True  # the legs before and after it end in the cells that the link joins
        if self._is_swept[leg]:
            return search.can_pass(start + begin * way, start + end * way, level)
        cell = float(flat.layout.cell_size[level])
        count = max(round(float(np.abs(way).max()) / cell), 1)
        shares = np.clip(np.arange(count + 1) / count, INSIDE, 1.0 - INSIDE)
        # of the centres that it passes, the last before the part begins counts as well
        shares = shares[(shares > begin - 1.0 / count) & (shares <= end + LEAST)]
        cells = flat.cells_at(start + shares[:, None] * way, level)
        is_diagonal = bool((np.abs(way) > cell / 4).all())
        free = search.free_diagonally if is_diagonal else flat.free
        return bool(free[cells[cells >= 0]].all())

    def _level_at(self, distance: float) -> int:
        after = int(np.searchsorted(self._run, distance, "right"))
        return int(self.path.levels[min(after, len(self._run) - 1)])

    def _point_ahead(self, p: Float) -> Float:
        """The point of the path to head for: as far ahead as a straight line to it is free."""
        level, target = self._level_at(self._distance), p
        for share in CLOSER:
            distance = self._distance + share * self._lookahead
            target, is_same = self.path.at(distance), self._level_at(distance) == level
            if is_same and self._search.can_pass(p[:2], target[:2], level):
                break
        return target
