"""Drives a mobile base along a path by pure pursuit, and replans when cells are blocked or freed.

Source: Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm" (1992). Different: the
lookahead shrinks where the straight line isn't free; the base turns on the spot if the point is far
to its side; and it brakes for its goal and for blocked cells.
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

DRIVING = "driving"
WAITING = "waiting"
RIDING = "riding"
ARRIVED = "arrived"
TURN_FIRST = math.radians(20.0)  # bearing of the point ahead over which a base turns on the spot
TURN_GAIN = 4.0  # [1/s] how fast it turns there, by the bearing
CLOSER = (1.0, 0.5, 0.25)  # shares of the lookahead that are tried
WORTH = 0.1  # a new path is taken where it is shorter than the rest of the old one by this share
STANDSTILL = 0.01  # [m] of free path; less counts as blocked
LEAST = 1e-9  # [m] that a leg's length is divided by at least
INSIDE = 1e-3  # share of a line by which its ends are moved in, off the edges of cells
HALVINGS = 10  # of a blocked line, to find how far it is free


@dataclass(frozen=True, eq=False)
class Command:
    """Velocities and target of a mobile base."""

    forward: float  #: Speed along its heading [m/s], >= 0.
    turn: float  #: Rate of its heading, counter-clockwise [rad/s].
    waypoint: Float  #: Where it heads for, world x, y, z [m], shape (3,), as `Follower.waypoint`.


class Follower:
    """Follows a path; made by `PathFinder.follow`.

    When cells of its grid are blocked or freed, it replans, and switches to the new path if the
    rest of the current one is blocked or a tenth longer. Without a path, it drives up to the
    blocked part and waits.

    It drives up to the stop of a link, and stands there until the base is at the link's next stop:
    to call a lift, to jump or to climb is up to the caller. Meanwhile the next stop is the
    waypoint, and nothing is planned again. A base is there where it is nearer to the next stop than
    to this one, within the lookahead of it on the map and a step of it in height.

    `path` is the current path, `link` the name of the link that it stands at, else None, `state` is
    ``driving``, ``waiting``, ``riding`` or ``arrived``, and `num_replans` counts the switches.
    """

    def __init__(self, search: Search, path: Path, limits: dict[str, float]) -> None:
        for name, value in limits.items():
            if not isinstance(value, REAL) or isinstance(value, bool) or not 0 < value < math.inf:
                raise QueryError(f"expected a {name} > 0, got {value!r}")
        self._search = search
        self._goal = path.positions[-1]
        self._speed, self._acceleration, self._turn_rate = list(limits.values())[:3]
        self._lookahead = limits["lookahead"]
        self._tolerance = limits["tolerance"]
        self.state = DRIVING
        self.num_replans = 0
        self._version = -1
        self._length = 0.0
        self._distance = 0.0
        self._taken = 0
        self._take(path)

    @property
    def left(self) -> float:
        """Length of the rest of the path, seen from above [m]."""
        return self._length - self._distance

    @property
    def link(self) -> str | None:
        """Name of the link at whose stop the base stands, None for none."""
        return self.path.links[self._taken] if self.state == RIDING else None

    def command(self, position: ArrayLike, heading: float) -> Command:
        """Compute the velocities of a differential-drive base; call it once per control step.

        Args:
            position: the base's, world x, y, z [m].
            heading: the base's, 0 along x, counted towards y [rad].
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
        if (stop := self._next_stop) is not None:
            free_ahead = min(free_ahead, float(np.hypot(*(self._points[stop] - p[:2]))))
        forward = min(self._speed, math.sqrt(2.0 * self._acceleration * free_ahead))
        if forward * abs(curvature) > self._turn_rate:
            forward = self._turn_rate / abs(curvature)
        return Command(forward, forward * curvature, target)

    def waypoint(self, position: ArrayLike) -> Float:
        """Compute the point for a position-controlled base to head for: world [m], shape (3,).

        It lies on the path within the lookahead; while the base waits, it is its own position, and
        at the stop of a link the next stop.
        """
        p = self._advance(position)
        return p if self.state == WAITING else self._point_ahead(p)

    def replan(self, position: ArrayLike) -> bool:
        """Plan from a position and switch to that path; False if there is none."""
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
        """Update the progress along the path, changes of the grid, and the state."""
        p = self._check(position)
        search = self._search
        if self.state == RIDING:  # drive on where the base is at the link's next stop
            here, there = self.path.positions[self.path.stops[self._taken]]
            off = float(np.hypot(*(p - there)[:2]))
            rise = abs(p[2] - there[2])
            is_nearer = np.linalg.norm(p - there) < np.linalg.norm(p - here)
            if not is_nearer or off > self._lookahead or rise > search.flat.floors.max_step:
                return p
            self._distance = float(self._run[self.path.stops[self._taken, 1]])
            self.state = DRIVING
            self._taken = self._taken + 1
        self._distance = self._nearest(p)
        if search.version != self._version:  # look at the path again
            self._version = search.version
            self._free_until = self._find_free(self._distance)
            is_blocked = self._free_until < self._length
            path = self._plan(p)
            if path is not None and (is_blocked or path.length < (1.0 - WORTH) * self.left):
                self._take(path)
                self.num_replans += 1
        stop = self._next_stop
        off = np.hypot(*p[:2] - (self._goal[:2] if stop is None else self._points[stop]))
        end = self._length if stop is None else self._run[stop]
        if off <= self._tolerance and end - self._distance <= 2 * self._lookahead:
            self.state = ARRIVED if stop is None else RIDING
        else:
            left = self._free_until - self._distance
            is_stopped = self._free_until < self._length and left <= STANDSTILL
            self.state = WAITING if is_stopped else DRIVING
        return p

    def _plan(self, p: Float) -> Path | None:
        """Plan from the base, or from the nearest free place if its own cell isn't free."""
        flat = self._search.flat
        start, cell = snap(flat, flat.free, p, max_distance=self._lookahead)
        if cell < 0:
            return None
        return find_path(self._search, start, self._goal, None, by=self.path.by, smooth=True)

    def _take(self, path: Path) -> None:
        """Set the path, and split it into legs; the level of a leg over a link is -1."""
        self._search.update()
        self.path = path
        self._version = self._search.version
        self._points = p = path.positions[:, :2]
        self._run = run_of(path.positions)  # of the points along the path [m]
        self._length = float(self._run[-1])
        self._distance = 0.0
        one = path.levels[:-1]
        other = path.levels[1:]
        self._leg_level = np.where(one == other, one, -1)
        for begin, end in path.stops.tolist():
            self._leg_level[begin:end] = -1
        self._taken = 0  # of the path's links
        self._is_swept = [
            level >= 0 and self._search.can_pass(p[k], p[k + 1], level)
            for k, level in enumerate(self._leg_level.tolist())
        ]
        self._free_until = self._find_free(0.0)

    def _nearest(self, position: Float) -> float:
        """The distance along the path of its point nearest to a position, within two lookaheads."""
        if self._length == 0.0:
            return 0.0
        stop = self._next_stop
        end = self._length if stop is None else float(self._run[stop])
        low = self._distance
        high = min(self._distance + 2.0 * self._lookahead, end)
        start = self._points[:-1]
        run = self._run
        ways = np.diff(self._points, axis=0)
        lengths = np.diff(run)
        along = ((position[:2] - start) * ways).sum(axis=1) / np.maximum(lengths, LEAST)
        distance = np.clip(run[:-1] + np.clip(along, 0.0, lengths), low, high)
        share = (distance - run[:-1]) / np.maximum(lengths, LEAST)
        off = np.hypot(*(start + share[:, None] * ways - position[:2]).T)
        off[(run[1:] < low) | (run[:-1] > high)] = np.inf
        return float(distance[int(np.argmin(off))])

    def _find_free(self, begin: float) -> float:
        """The distance along the path up to which it is free, from `begin` [m]."""
        run = self._run
        first = max(int(np.searchsorted(run, begin, side="right")) - 1, 0)
        for k in range(first, len(self._leg_level)):
            length = float(run[k + 1] - run[k])
            skipped = low = max(begin - float(run[k]), 0.0) / max(length, LEAST)
            high = 1.0
            if not self._is_free(k, low, high):
                for _ in range(HALVINGS):
                    middle = (low + high) / 2
                    is_free = self._is_free(k, skipped, middle)
                    low, high = (middle, high) if is_free else (low, middle)
                return float(run[k]) + length * low
        return self._length

    def _is_free(self, leg: int, begin: float, end: float) -> bool:
        """Whether a leg is free between two shares of its length."""
        search = self._search
        flat = self._search.flat
        level = int(self._leg_level[leg])
        start = self._points[leg]
        way = self._points[leg + 1] - self._points[leg]
        if level < 0:
            return True  # the legs beside it end in the link's cells
        if self._is_swept[leg]:
            return search.can_pass(start + begin * way, start + end * way, level)
        cell = float(flat.layout.cell_size[level])
        count = max(round(float(np.abs(way).max()) / cell), 1)
        shares = np.clip(np.arange(count + 1) / count, INSIDE, 1.0 - INSIDE)
        # with the last centre before the part
        shares = shares[(shares > begin - 1.0 / count) & (shares <= end + LEAST)]
        cells = flat.cells_at(start + shares[:, None] * way, level)
        is_diagonal = bool((np.abs(way) > cell / 4).all())
        free = search.free_diagonally if is_diagonal else flat.free
        return bool(free[cells[cells >= 0]].all())

    @property
    def _next_stop(self) -> int | None:
        """The point of the path where the next link begins, None for none."""
        left = self.path.stops[self._taken :]
        return int(left[0, 0]) if len(left) else None

    def _level_at(self, distance: float) -> int:
        stop = self._next_stop
        if stop is not None and distance >= self._run[stop]:
            return int(self.path.levels[stop])
        after = int(np.searchsorted(self._run, distance, "right"))
        return int(self.path.levels[min(after, len(self._run) - 1)])

    def _point_ahead(self, p: Float) -> Float:
        """The farthest lookahead point that a free straight line leads to."""
        stop = self._next_stop
        if self.state == RIDING:
            return np.asarray(self.path.positions[self.path.stops[self._taken, 1]])
        level = self._level_at(self._distance)
        target = p
        for share in CLOSER:
            distance = self._distance + share * self._lookahead
            target = self.path.at(distance)
            is_same = self._level_at(distance) == level
            if stop is not None and distance >= self._run[stop]:
                target = self.path.positions[stop]
            if is_same and self._search.can_pass(p[:2], target[:2], level):
                break
        return target
