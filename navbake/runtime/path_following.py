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
from navbake.runtime.flat_grid import RealNumber
from navbake.runtime.paths import Path, distances_along, find_path
from navbake.runtime.places import snap_to_cells
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int

DRIVING = "driving"
WAITING = "waiting"
RIDING = "riding"
ARRIVED = "arrived"
# Bearing of the point ahead over which a base turns on the spot
SPOT_TURN_BEARING = math.radians(20.0)
TURN_GAIN = 4.0  # [1/s] how fast it turns there, by the bearing
LOOKAHEAD_SHARES = (1.0, 0.5, 0.25)  # of the lookahead, that are tried one after the other
# Share of the rest of the path by which a new path must be shorter to be taken
LEAST_SHORTENING = 0.1
STANDSTILL_DISTANCE = 0.01  # [m] of free path; less counts as blocked
LEAST_LENGTH = 1e-9  # [m] that a leg's length is divided by at least
EDGE_SHARE = 1e-3  # share of a line by which its ends are moved in, off the edges of cells
NUM_HALVINGS = 10  # of a blocked line, to find how far it is free


@dataclass(frozen=True)
class DriveLimits:
    """How a mobile base drives; see `PathFinder.follow`.

    Attributes:
        speed: the highest speed [m/s].
        acceleration: the deceleration with which the base brakes [m/s²].
        turn_rate: the highest turn rate [rad/s].
        lookahead: distance along the path to the point that the base heads for [m].
        tolerance: distance to the goal at which the base has arrived [m].

    Raises:
        QueryError: a limit is no number > 0.
    """

    speed: float
    acceleration: float
    turn_rate: float
    lookahead: float
    tolerance: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            is_number = isinstance(value, RealNumber) and not isinstance(value, bool)
            if not is_number or not 0 < value < math.inf:
                raise QueryError(
                    f"expected a {name} > 0, got {value!r}",
                    key=name,
                    value=value,
                    expected=f"a {name} > 0",
                )


@dataclass(frozen=True, eq=False)
class Command:
    """Velocities and target of a mobile base."""

    forward: float  #: Speed along its heading [m/s], >= 0.
    turn: float  #: Rate of its heading, counter-clockwise [rad/s].
    waypoint: Float  #: The point it heads for, world x, y, z [m], shape (3,): `Follower.waypoint`.


class Follower:
    """Follows a path; made by `PathFinder.follow`.

    When cells of its grid are blocked or freed, it replans, and switches to the new path if the
    rest of the current one is blocked or a tenth longer. Without a path, it drives up to the
    blocked part and waits.

    It drives up to the stop of a link, and stands there until the base is at the link's next stop:
    to call a lift, to jump or to climb is up to the caller. Meanwhile the next stop is the
    waypoint, and nothing is planned again. A base is there where it is nearer to the next stop than
    to this one, within the lookahead of it on the map and a step of it in height.

    Attributes:
        path: the current path.
        state: ``driving``, ``waiting``, ``riding`` or ``arrived``.
        num_replans: how often it switched to a new path.

    Example:
        >>> follower = finder.follow(path, speed=0.5)
        >>> while follower.state != "arrived":
        ...     command = follower.command(position, heading)
        ...     position, heading = drive(command.forward, command.turn)
    """

    def __init__(self, search: Search, path: Path, limits: DriveLimits) -> None:
        self._search = search
        self._limits = limits
        self._goal = path.positions[-1]
        self.state = DRIVING
        self.num_replans = 0
        self._version = -1
        self._num_links_taken = 0  # of the current path
        self._start_path(path)

    @property
    def left(self) -> float:
        """Length of the rest of the path, seen from above [m]."""
        return self._length - self._distance

    @property
    def link(self) -> str | None:
        """Name of the link at whose stop the base stands, None for none."""
        return self.path.links[self._num_links_taken] if self.state == RIDING else None

    def command(self, position: ArrayLike, heading: float) -> Command:
        """Compute the velocities of a differential-drive base; call it once per control step.

        Args:
            position: the base's, world x, y, z [m], shape (3,).
            heading: the base's, 0 along x, counted towards y [rad].

        Returns:
            Velocities, 0 unless it is driving, and the point that the base heads for.

        Raises:
            QueryError: the position or the heading is not valid.
        """
        p = self._advance(position)
        if not isinstance(heading, RealNumber) or not math.isfinite(heading):
            expected = "a finite heading [rad]"
            raise QueryError(
                f"expected {expected}, got {heading!r}",
                key="heading",
                value=heading,
                expected=expected,
            )
        target = self._point_ahead(p)
        if self.state != DRIVING:
            return Command(0.0, 0.0, target)
        limits = self._limits
        offset = target[:2] - p[:2]
        bearing = math.remainder(math.atan2(offset[1], offset[0]) - heading, 2.0 * math.pi)
        if abs(bearing) > SPOT_TURN_BEARING:
            rate = min(TURN_GAIN * abs(bearing), limits.turn_rate)
            return Command(0.0, math.copysign(rate, bearing), target)
        curvature = 2.0 * math.sin(bearing) / max(float(np.hypot(*offset)), STANDSTILL_DISTANCE)
        free_ahead = max(self._free_until - self._distance, 0.0)
        stop = self._next_stop
        if stop is not None:
            free_ahead = min(free_ahead, float(np.hypot(*(self._points[stop] - p[:2]))))
        braking_speed = math.sqrt(2.0 * limits.acceleration * free_ahead)
        forward = min(limits.speed, braking_speed)
        if forward * abs(curvature) > limits.turn_rate:
            forward = limits.turn_rate / abs(curvature)
        return Command(forward, forward * curvature, target)

    def waypoint(self, position: ArrayLike) -> Float:
        """Compute the point for a position-controlled base to head for.

        Args:
            position: the base's, world x, y, z [m], shape (3,).

        Returns:
            World x, y, z [m], shape (3,): on the path within the lookahead; while the base waits,
            its own position, and at the stop of a link the next stop.

        Raises:
            QueryError: the position is not valid.
        """
        p = self._advance(position)
        return p if self.state == WAITING else self._point_ahead(p)

    def replan(self, position: ArrayLike) -> bool:
        """Plan from a position and switch to that path.

        Args:
            position: the base's, world x, y, z [m], shape (3,).

        Returns:
            Whether there is a path.

        Raises:
            QueryError: the position is not valid.
        """
        path = self._plan(self._check(position))
        if path is not None:
            self._start_path(path)
            self.num_replans += 1
        return path is not None

    def _check(self, position: ArrayLike) -> Float:
        """Check a position; returns it with z, shape (3,)."""
        self._search.update()
        flat = self._search.flat
        p = flat.check_one(position)
        return p if len(p) == 3 else np.append(p, float(flat.floors.ground[0]))

    def _advance(self, position: ArrayLike) -> Float:
        """Update the progress along the path, changes of the grid, and the state."""
        p = self._check(position)
        if self.state == RIDING:
            if not self._is_at_next_stop(p):
                return p
            stop_after_link = self.path.stops[self._num_links_taken, 1]
            self._distance = float(self._run[stop_after_link])
            self.state = DRIVING
            self._num_links_taken += 1
        self._distance = self._nearest_distance(p)
        if self._search.version != self._version:  # cells were blocked or freed
            self._version = self._search.version
            self._free_until = self._find_free(self._distance)
            is_blocked = self._free_until < self._length
            path = self._plan(p)
            if path is not None and (
                is_blocked or path.length < (1.0 - LEAST_SHORTENING) * self.left
            ):
                self._start_path(path)
                self.num_replans += 1
        self.state = self._find_state(p)
        return p

    def _is_at_next_stop(self, p: Float) -> bool:
        """Whether a base that rides on a link is at the link's next stop."""
        stop, next_stop = self.path.positions[self.path.stops[self._num_links_taken]]
        distance = float(np.hypot(*(p - next_stop)[:2]))
        rise = abs(p[2] - next_stop[2])
        is_nearer = bool(np.linalg.norm(p - next_stop) < np.linalg.norm(p - stop))
        is_on_floor = rise <= self._search.flat.floors.max_step
        return is_nearer and distance <= self._limits.lookahead and bool(is_on_floor)

    def _find_state(self, p: Float) -> str:
        """Find the state of a base that doesn't ride."""
        stop = self._next_stop
        end_point = self._goal[:2] if stop is None else self._points[stop]
        end = self._length if stop is None else self._run[stop]
        is_near_end = end - self._distance <= 2 * self._limits.lookahead
        if np.hypot(*p[:2] - end_point) <= self._limits.tolerance and is_near_end:
            return ARRIVED if stop is None else RIDING
        is_blocked = self._free_until < self._length
        if is_blocked and self._free_until - self._distance <= STANDSTILL_DISTANCE:
            return WAITING
        return DRIVING

    def _plan(self, p: Float) -> Path | None:
        """Plan from the base, or from the nearest free place if its own cell isn't free."""
        flat = self._search.flat
        start, cell = snap_to_cells(flat, flat.free, p, max_distance=self._limits.lookahead)
        if cell < 0:
            return None
        return find_path(self._search, start, self._goal, None, by=self.path.by, smooth=True)

    def _start_path(self, path: Path) -> None:
        """Set the path, and split it into legs; the level of a leg over a link is -1."""
        self._search.update()
        self.path = path
        self._version = self._search.version
        self._points: Float = path.positions[:, :2]
        self._run = distances_along(path.positions)  # of the points along the path [m]
        self._length = float(self._run[-1])
        self._distance = 0.0  # of the base along the path [m]
        self._num_links_taken = 0
        self._leg_level: Int = np.where(path.levels[:-1] == path.levels[1:], path.levels[:-1], -1)
        for begin, end in path.stops.tolist():
            self._leg_level[begin:end] = -1
        # whether the agent's disc could pass along each whole leg, off the centres of cells
        self._is_swept = [
            level >= 0 and self._search.can_pass(self._points[k], self._points[k + 1], level)
            for k, level in enumerate(self._leg_level.tolist())
        ]
        self._free_until = self._find_free(0.0)  # distance along the path [m]

    def _nearest_distance(self, position: Float) -> float:
        """Find the distance along the path of its point nearest to a position.

        Points within two lookaheads ahead count, up to the next stop of a link.
        """
        if self._length == 0.0:
            return 0.0
        stop = self._next_stop
        end = self._length if stop is None else float(self._run[stop])
        low = self._distance
        high = min(self._distance + 2.0 * self._limits.lookahead, end)
        starts = self._points[:-1]
        run = self._run
        legs = np.diff(self._points, axis=0)
        lengths = np.diff(run)
        along = ((position[:2] - starts) * legs).sum(axis=1) / np.maximum(lengths, LEAST_LENGTH)
        distances = np.clip(run[:-1] + np.clip(along, 0.0, lengths), low, high)
        shares = (distances - run[:-1]) / np.maximum(lengths, LEAST_LENGTH)
        off = np.hypot(*(starts + shares[:, None] * legs - position[:2]).T)
        off[(run[1:] < low) | (run[:-1] > high)] = np.inf
        return float(distances[int(np.argmin(off))])

    def _find_free(self, begin: float) -> float:
        """Find the distance along the path up to which it is free, from `begin` on [m]."""
        run = self._run
        first_leg = max(int(np.searchsorted(run, begin, side="right")) - 1, 0)
        for leg in range(first_leg, len(self._leg_level)):
            length = float(run[leg + 1] - run[leg])
            begin_share = max(begin - float(run[leg]), 0.0) / max(length, LEAST_LENGTH)
            if self._is_free(leg, begin_share, 1.0):
                continue
            low = begin_share
            high = 1.0
            for _ in range(NUM_HALVINGS):
                middle = (low + high) / 2
                if self._is_free(leg, begin_share, middle):
                    low = middle
                else:
                    high = middle
            return float(run[leg]) + length * low
        return self._length

    def _is_free(self, leg: int, begin: float, end: float) -> bool:
        """Whether a leg is free between two shares of its length."""
        search = self._search
        flat = search.flat
        level = int(self._leg_level[leg])
        start = self._points[leg]
        direction = self._points[leg + 1] - self._points[leg]
        if level < 0:
            return True  # the legs beside it end in the link's cells
        if self._is_swept[leg]:
            return search.can_pass(start + begin * direction, start + end * direction, level)
        # a leg from centre to centre along a row, a column or a diagonal: the cells at its centres
        cell = float(flat.layout.cell_size[level])
        count = max(round(float(np.abs(direction).max()) / cell), 1)
        shares = np.clip(np.arange(count + 1) / count, EDGE_SHARE, 1.0 - EDGE_SHARE)
        # with the last centre before the part
        shares = shares[(shares > begin - 1.0 / count) & (shares <= end + LEAST_LENGTH)]
        cells = flat.cells_at(start + shares[:, None] * direction, level)
        is_diagonal = bool((np.abs(direction) > cell / 4).all())
        free: Bool = search.free_diagonally if is_diagonal else flat.free
        return bool(free[cells[cells >= 0]].all())

    @property
    def _next_stop(self) -> int | None:
        """The index of the point of the path where the next link begins, None for none."""
        next_stops = self.path.stops[self._num_links_taken :]
        return int(next_stops[0, 0]) if len(next_stops) else None

    def _level_at(self, distance: float) -> int:
        """Find the level at a distance along the path; at a link, the level of its stop."""
        stop = self._next_stop
        if stop is not None and distance >= self._run[stop]:
            return int(self.path.levels[stop])
        after = int(np.searchsorted(self._run, distance, "right"))
        return int(self.path.levels[min(after, len(self._run) - 1)])

    def _point_ahead(self, p: Float) -> Float:
        """Find the farthest lookahead point that a free straight line leads to."""
        stop = self._next_stop
        if self.state == RIDING:
            stop_after_link = self.path.stops[self._num_links_taken, 1]
            return np.asarray(self.path.positions[stop_after_link])
        level = self._level_at(self._distance)
        target = p
        for share in LOOKAHEAD_SHARES:
            distance = self._distance + share * self._limits.lookahead
            target = self.path.at(distance)
            is_same_level = self._level_at(distance) == level
            if stop is not None and distance >= self._run[stop]:
                target = self.path.positions[stop]
            if is_same_level and self._search.can_pass(p[:2], target[:2], level):
                break
        return target
