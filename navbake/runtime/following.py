"""Drives a mobile base along a path: by pure pursuit, round what comes into its way, or not at all.

Pure pursuit heads for a point of the path a little ahead, on the circle that touches the base's
heading and runs through that point.

Source: Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm" (1992). What is
different: the point is drawn nearer where the straight line to it isn't free; the base turns on the
spot where the point is far to its side; and it slows down so as to stop at its goal, and at what
is blocked.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.runtime.flat_grid import REAL
from navbake.runtime.grid_cache import GridCache
from navbake.runtime.paths import Path, Planner, step_lengths
from navbake.runtime.places import snap
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int

DRIVING, WAITING, ARRIVED = "driving", "waiting", "arrived"
TURN_FIRST = math.radians(20.0)  # bearing of the point ahead over which a base turns on the spot
TURN_GAIN = 4.0  # [1/s] how fast it turns there, by the bearing
CLOSER = (1.0, 0.5, 0.25)  # shares of the lookahead that are tried
WORTH = 0.1  # a new path is taken where it is shorter than the rest of the old one by this share
STANDSTILL = 0.01  # [m] to what is blocked: less is no way left
IN_LINE = 1e-9  # metres that a point of a straight line may be off it
INSIDE = 1e-3  # share of a line by which its ends are moved in, off the edges of cells
HALVINGS = 10  # of a blocked line, to find how far it is free


@dataclass(frozen=True)
class Drive:
    """How a base drives.

    Attributes:
        speed: the highest [m/s].
        acceleration: with which it brakes [m/s²].
        turn_rate: the highest [rad/s].
        lookahead: how far ahead on the path it heads for [m].
        tolerance: it has arrived where its goal is as near as this [m].
    """

    speed: float
    acceleration: float
    turn_rate: float
    lookahead: float
    tolerance: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, REAL) or isinstance(value, bool) or not 0 < value < math.inf:
                raise QueryError(f"expected a {name} > 0, got {value!r}")


@dataclass(frozen=True, eq=False)
class Command:
    """What a base should do now.

    Attributes:
        forward: speed along its heading [m/s], >= 0.
        turn: rate of its heading, counter-clockwise [rad/s].
        waypoint: where it heads for, world x, y, z [m], shape (3,), float64: of use for a base
            that drives to positions.
    """

    forward: float
    turn: float
    waypoint: Float


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


class _Way:
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
        self._run = np.concatenate([[0.0], np.cumsum(step_lengths(path.positions))])
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
            return search.can_pass(a, b, level)
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
            number >= 0 and search.can_pass(p[a], p[b], number)
            for a, b, number in zip(start, end, level.tolist(), strict=True)
        ]
        runs = run[np.array(kept)]
        return _Legs(p[start], p[end], runs, level, np.array(swept, dtype=np.bool_))


class Follower:
    """Follows a path; `PathFinder.follow` makes it.

    It notices when cells of its grid were blocked or freed. Then it plans anew, and takes the new
    path where the rest of its own is blocked, or a tenth longer. Where there is no path, it drives
    on to where its own is blocked, and waits there until there is one.

    Attributes:
        path: that it follows now.
        state: ``driving``, ``waiting`` (there is no way on) or ``arrived``.
        num_replans: how often it has taken a new path.
    """

    def __init__(self, cache: GridCache, planner: Planner, path: Path, drive: Drive) -> None:
        self._cache, self._planner, self._drive = cache, planner, drive
        self.state, self.num_replans = DRIVING, 0
        self._goal = path.positions[-1]
        self._distance = self._free_until = 0.0  # along the path [m]
        self._take(path)

    @property
    def path(self) -> Path:
        """The path that is followed now."""
        return self._way.path

    @property
    def left(self) -> float:
        """How long the rest of the path is, seen from above [m]."""
        return self._way.length - self._distance

    def command(self, position: ArrayLike, heading: float) -> Command:
        """What a base with two driven wheels should do now.

        Call it as often as the base is steered, such as every 0.05 s.

        Args:
            position: of the base, world x, y, z [m].
            heading: of the base, 0 along x, counted towards y [rad].

        Raises:
            QueryError: the position or the heading is not finite.
        """
        p = self._advance(position)
        if not isinstance(heading, REAL) or not math.isfinite(heading):
            raise QueryError(f"expected a finite heading [rad], got {heading!r}")
        target = self._point_ahead(p)
        if self.state != DRIVING:
            return Command(0.0, 0.0, target)
        drive, way = self._drive, target[:2] - p[:2]
        bearing = math.remainder(math.atan2(way[1], way[0]) - heading, 2.0 * math.pi)
        if abs(bearing) > TURN_FIRST:
            rate = min(TURN_GAIN * abs(bearing), drive.turn_rate)
            return Command(0.0, math.copysign(rate, bearing), target)
        curvature = 2.0 * math.sin(bearing) / max(float(np.hypot(*way)), STANDSTILL)
        forward = min(drive.speed, math.sqrt(2.0 * drive.acceleration * self._free_ahead))
        if forward * abs(curvature) > drive.turn_rate:
            forward = drive.turn_rate / abs(curvature)
        return Command(forward, forward * curvature, target)

    def waypoint(self, position: ArrayLike) -> Float:
        """Where a base that drives to positions should head for now.

        Args:
            position: of the base, world x, y, z [m].

        Returns:
            World x, y, z [m], shape (3,), float64, at most the lookahead away along the path; the
            base's own position, while it waits.
        """
        p = self._advance(position)
        return p if self.state == WAITING else self._point_ahead(p)

    def replan(self, position: ArrayLike) -> bool:
        """Plan anew from a position, and take that path; False where there is none."""
        path = self._plan(_check(position, self._cache))
        if path is not None:
            self._take(path)
            self.num_replans += 1
        return path is not None

    @property
    def _free_ahead(self) -> float:
        """How far on the path is free [m]."""
        return max(self._free_until - self._distance, 0.0)

    def _advance(self, position: ArrayLike) -> Float:
        """Find how far the base has come, see what has changed, and set the state."""
        p = _check(position, self._cache)
        drive, way = self._drive, self._way
        ahead = self._distance + 2.0 * drive.lookahead
        self._distance = way.nearest(p, self._distance, min(ahead, way.length))
        if self._cache.search.version != self._version:
            self._catch_up(p)
        if np.hypot(*(p - self._goal)[:2]) <= drive.tolerance and self.left <= 2 * drive.lookahead:
            self.state = ARRIVED
        else:
            is_stopped = self._free_until < self._way.length and self._free_ahead <= STANDSTILL
            self.state = WAITING if is_stopped else DRIVING
        return p

    def _catch_up(self, p: Float) -> None:
        """Look at the path again after the grid has changed."""
        search = self._cache.search
        self._version = search.version
        self._free_until = self._way.free_until(search, self._distance)
        is_blocked = self._free_until < self._way.length
        path = self._plan(p)
        if path is not None and (is_blocked or path.length < (1.0 - WORTH) * self.left):
            self._take(path)
            self.num_replans += 1

    def _plan(self, p: Float) -> Path | None:
        """A path from the base to the goal; from the nearest free place if it is in no free cell.

        It may be in none where it is a little off its path, or where something has come near.
        """
        flat = self._cache.flat
        cell = flat.cell_at(p)
        if cell is None or not flat.free[cell]:
            p, _ = snap(flat, flat.free, p, max_distance=self._drive.lookahead)
            if np.isnan(p[0]):
                return None
        return self._planner.find_path(p, self._goal, None, smooth=True)

    def _take(self, path: Path) -> None:
        search = self._cache.search
        self._way, self._distance, self._version = _Way(path, search), 0.0, search.version
        self._free_until = self._way.free_until(search, 0.0)

    def _point_ahead(self, p: Float) -> Float:
        """The point of the path to head for: as far ahead as a straight line to it is free."""
        way, search = self._way, self._cache.search
        level = way.level_at(self._distance)
        target = p
        for share in CLOSER:
            distance = self._distance + share * self._drive.lookahead
            target = way.at(distance)
            if way.level_at(distance) == level and search.can_pass(p[:2], target[:2], level):
                break
        return target


def _check(position: ArrayLike, cache: GridCache) -> Float:
    p = cache.flat.check_one(position)
    return p if len(p) == 3 else np.append(p, float(cache.flat.floors.ground[0]))
