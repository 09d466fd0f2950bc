"""Drives a mobile base along a path by pure pursuit, and replans when the grid has changed.

Source: Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm" (1992). Three things
are different here: the lookahead shrinks where the straight line to its point isn't free; the base
turns on the spot if that point is far to its side; and it brakes for its goal and blocked cells.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.runtime.flat_grid import RealNumber, check_positive
from navbake.runtime.paths import Path, distances_of_points, find_path, positions_at
from navbake.runtime.places import snap, try_step
from navbake.runtime.search import Search
from navbake.types import Bool, Float, Int

DRIVING = "driving"
WAITING = "waiting"
RIDING = "riding"
ARRIVED = "arrived"
# if the bearing of the point ahead is larger, the base turns on the spot [rad]
SPOT_TURN_BEARING = math.radians(20.0)
TURN_GAIN = 4.0  # [1/s]: when turning on the spot, turn rate for each radian of bearing
LOOKAHEAD_SHARES = (1.0, 0.5, 0.25)  # shares of the lookahead that are tried one after the other
# share of the rest of the path by which a new path must be shorter, so that the base takes it
LEAST_SHORTENING = 0.1
STANDSTILL_DISTANCE = 0.01  # [m]: a base with less free path ahead waits
LEAST_LENGTH = 1e-9  # [m]: shorter lengths are replaced by this before dividing by them
EDGE_SHARE = 1e-3  # share of a line by which its ends are moved in, off the edges of cells
NUM_HALVINGS = 10  # how often a blocked line is halved, to find up to where it is free
WALK_TOLERANCE = 1e-6  # [m]: a walk that ends this near to its goal has got there


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
            check_positive(value, name)


@dataclass(frozen=True, eq=False)
class Command:
    """The velocities of a mobile base, and the point that it heads for."""

    forward: float  #: Speed along its heading [m/s], >= 0.
    turn: float  #: Turn rate, counter-clockwise [rad/s].
    waypoint: Float  #: The point it heads for, world x, y, z [m], shape (3,): `Follower.waypoint`.


class SearchOwner(Protocol):
    """A `PathFinder`, as a follower uses it."""

    @property
    def search(self) -> Search:
        """The search on its present grid, up to date with the grid's obstacles."""


class Follower:
    """Follows a path; made by `PathFinder.follow`.

    It follows the path on the present grid of its finder. When cells of this grid are blocked or
    freed, or after `PathFinder.use`, it replans. It switches to the new path if the rest of the
    current one is blocked, or if the new one is shorter by more than a tenth. Without a new path,
    it drives up to the blocked part and waits. On a grid with other levels or cells than those of
    its path, the whole path counts as blocked.

    It also replans if the base has lost its path, as after someone has carried or pushed it: if
    the base can't drive straight to any point of the path within the lookahead. Without a new
    path, it waits.

    At a link, it drives up to the link's stop and commands no motion until the base is at the next
    stop: the caller calls the lift, jumps or climbs. Meanwhile the next stop is the waypoint, and
    the follower doesn't replan. The base counts as being at the next stop if it is nearer to that
    stop than to the first one, at most the lookahead away from it on the map, and at most a step
    above or below it.

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

    _point_distances: Float  # of the path's points, along the path [m]
    _length: float  # of the path [m]

    def __init__(self, finder: SearchOwner, path: Path, limits: DriveLimits) -> None:
        self._finder = finder
        self._search = finder.search
        self._limits = limits
        self._goal = path.positions[-1]
        self.state = DRIVING
        self.num_replans = 0
        self._num_links_taken = 0  # of the current path
        self._free_distance = 0.0  # the path is free up to this distance along it [m]
        # cell of the base that lost its path when it replanned last, -1 for none in the grid; None
        # for a base that has its path
        self._planned_cell: int | None = None
        self._set_path(path)
        if path.grid is not self._search.grid or self._free_distance < self._length:
            self._version = -1  # the first command replans

    @property
    def left(self) -> float:
        """Length of the rest of the path, seen from above [m]."""
        return self._length - self._base_distance

    @property
    def link(self) -> str | None:
        """Name of the link at whose stop the base stands; None if it isn't riding."""
        return self.path.links[self._num_links_taken] if self.state == RIDING else None

    def command(self, position: ArrayLike, heading: float) -> Command:
        """Compute the velocities of a differential-drive base; call it once per control step.

        Args:
            position: the base's position, world x, y, z [m], shape (3,).
            heading: the base's heading, 0 along x, counted towards y [rad].

        Returns:
            Velocities, 0 unless it is driving, and the point that the base heads for.

        Raises:
            QueryError: the position or the heading is not valid.
        """
        base_position, point_ahead = self._advance(position)
        if not isinstance(heading, RealNumber) or not math.isfinite(heading):
            expected = "a finite heading [rad]"
            raise QueryError(
                f"expected {expected}, got {heading!r}",
                key="heading",
                value=heading,
                expected=expected,
            )
        if self.state != DRIVING:
            return Command(0.0, 0.0, point_ahead)
        limits = self._limits
        ahead_vector = point_ahead[:2] - base_position[:2]
        bearing = math.remainder(
            math.atan2(ahead_vector[1], ahead_vector[0]) - heading, 2.0 * math.pi
        )
        if abs(bearing) > SPOT_TURN_BEARING:
            turn_rate = min(TURN_GAIN * abs(bearing), limits.turn_rate)
            return Command(0.0, math.copysign(turn_rate, bearing), point_ahead)
        curvature = (
            2.0 * math.sin(bearing) / max(float(np.hypot(*ahead_vector)), STANDSTILL_DISTANCE)
        )
        free_length_ahead = self._find_free_length_ahead(base_position)
        braking_speed = math.sqrt(2.0 * limits.acceleration * free_length_ahead)
        forward = min(limits.speed, braking_speed)
        if forward * abs(curvature) > limits.turn_rate:
            forward = limits.turn_rate / abs(curvature)
        return Command(forward, forward * curvature, point_ahead)

    def waypoint(self, position: ArrayLike) -> Float:
        """Compute the point for a position-controlled base to head for.

        Args:
            position: the base's position, world x, y, z [m], shape (3,).

        Returns:
            World x, y, z [m], shape (3,): a point on the path, within the lookahead. While the base
            waits, it is the base's own position; at the stop of a link, it is the next stop.

        Raises:
            QueryError: the position is not valid.
        """
        return self._advance(position)[1]

    def replan(self, position: ArrayLike) -> bool:
        """Plan a new path from a position to the goal, and switch to it if there is one.

        A base that rides on a link then no longer waits for the link's next stop.

        Args:
            position: the base's position, world x, y, z [m], shape (3,).

        Returns:
            Whether there is a path.

        Raises:
            QueryError: the position is not valid.
        """
        path = self._plan(self._check_position(position))
        if path is not None:
            self._set_path(path)
            self.num_replans += 1
        return path is not None

    def _check_position(self, position: ArrayLike) -> Float:
        """Check the base's position, and return it with z, shape (3,).

        Before that, the search is replaced by that on the finder's present grid.
        """
        search = self._finder.search
        if search is not self._search:
            self._search = search
            self._version = -1
            self._is_path_on_grid = _has_lattices_of(self.path, search)
        flat = search.flat
        base_position = flat.check_position(position)
        if len(base_position) == 3:
            return base_position
        cell = int(flat.cells_at(base_position, 0))
        floor_height = flat.floor_heights(cell) if cell >= 0 else flat.floors.ground[0]
        return np.append(base_position, float(floor_height))

    def _advance(self, position: ArrayLike) -> tuple[Float, Float]:
        """Update the progress along the path and the state, and replan if that is needed.

        It is if the grid has changed, or if the base has lost its path. A base that has lost its
        path and got no new one waits. It replans when it gets into another cell.

        Returns the base's checked position and the point that it heads for, shape (3,) each.
        """
        base_position = self._check_position(position)
        if self.state == RIDING:
            if not self._is_at_next_stop(base_position):
                return base_position, self._find_point_ahead(base_position, None)
            stop_after_link = self.path.stops[self._num_links_taken, 1]
            self._base_distance = float(self._point_distances[stop_after_link])
            self.state = DRIVING
            self._num_links_taken += 1
        self._base_distance = self._nearest_distance(base_position)
        base_cell = int(self._search.flat.cells_at(base_position))
        free_point = self._find_free_point_ahead(base_position)
        has_lost_path = not self._can_get_to_path(base_position, base_cell, free_point)
        has_grid_changed = self._search.version != self._version
        if has_grid_changed or (has_lost_path and base_cell != self._planned_cell):
            self._version = self._search.version
            self._planned_cell = base_cell if has_lost_path else None
            self._free_distance = self._find_free_distance(self._base_distance)
            is_blocked = self._free_distance < self._length
            path = self._plan(base_position)
            self._is_stranded = has_lost_path and path is None
            if path is not None and (
                has_lost_path or is_blocked or path.length < (1.0 - LEAST_SHORTENING) * self.left
            ):
                self._set_path(path)
                self.num_replans += 1
                free_point = self._find_free_point_ahead(base_position)
        elif not has_lost_path:
            self._is_stranded = False
            self._planned_cell = None
        self.state = self._find_state(base_position, base_cell)
        return base_position, self._find_point_ahead(base_position, free_point)

    def _can_get_to_path(
        self, base_position: Float, base_cell: int, free_point: Float | None
    ) -> bool:
        """Whether the base can drive straight to its path.

        It can if a free straight line leads to a point ahead within the lookahead. It also can if
        the nearest point of the path is within the lookahead, and a straight walk leads there from
        the base, or from the nearest free place if the base's cell isn't free. So a base may be too
        near to obstacles by up to half a cell, as where it has cut a corner.

        Args:
            base_position: world x, y, z [m], shape (3,).
            base_cell: flat id of its cell, -1 for none.
            free_point: see `_find_free_point_ahead`.
        """
        if not self._is_path_on_grid:
            return False
        nearest_point = self._point_at(self._base_distance)
        if not self._is_near_floor(base_cell, nearest_point):
            return False
        if free_point is not None:
            return True
        place = self._find_free_place(base_position)
        if place is None:
            return False
        if np.hypot(*(nearest_point - place)[:2]) > self._limits.lookahead:
            return False
        walk_end = try_step(self._search, place, nearest_point, slide=False, level=None)
        return bool(np.hypot(*(nearest_point - walk_end)[:2]) <= WALK_TOLERANCE)

    def _is_near_floor(self, base_cell: int, point: Float) -> bool:
        """Whether the floor below the base is on the storey of a point."""
        return base_cell >= 0 and self._is_same_storey(
            float(self._search.flat.floor_heights(base_cell)), point
        )

    def _is_same_storey(self, floor_height: float, point: Float) -> bool:
        """Whether a floor is less than the agent's height off a point's height.

        Floors that are farther apart belong to different storeys.
        """
        return abs(floor_height - float(point[2])) < self._search.grid.agent_height

    def _find_free_length_ahead(self, base_position: Float) -> float:
        """Find how far the base may drive before it has to stand [m].

        That is up to the goal, to the stop of the next link, or to what blocks the path. A base
        beside the end of its path still has the straight line to it ahead.
        """
        stop_index = self._next_stop
        end_index = len(self._points) - 1 if stop_index is None else stop_index
        end_distance = float(self._point_distances[end_index])
        if self._free_distance < end_distance:
            return max(self._free_distance - self._base_distance, 0.0)
        straight_distance = float(np.hypot(*(self._points[end_index] - base_position[:2])))
        return max(end_distance - self._base_distance, straight_distance)

    def _is_at_next_stop(self, base_position: Float) -> bool:
        """Whether the base, which rides on a link, is at the link's next stop."""
        stop_position, next_stop_position = self.path.positions[
            self.path.stops[self._num_links_taken]
        ]
        distance = float(np.hypot(*(base_position - next_stop_position)[:2]))
        rise = abs(base_position[2] - next_stop_position[2])
        is_nearer = bool(
            np.linalg.norm(base_position - next_stop_position)
            < np.linalg.norm(base_position - stop_position)
        )
        is_on_floor = rise <= self._search.flat.floors.max_step
        return is_nearer and distance <= self._limits.lookahead and bool(is_on_floor)

    def _find_state(self, base_position: Float, base_cell: int) -> str:
        """Find the state of the base, which doesn't ride on a link."""
        stop_index = self._next_stop
        end_position = self._goal if stop_index is None else self.path.positions[stop_index]
        end_distance = self._length if stop_index is None else self._point_distances[stop_index]
        is_near_end = end_distance - self._base_distance <= 2 * self._limits.lookahead
        is_at_end = np.hypot(*(base_position - end_position)[:2]) <= self._limits.tolerance
        if is_at_end and is_near_end and self._is_near_floor(base_cell, end_position):
            return ARRIVED if stop_index is None else RIDING
        if self._is_stranded:
            return WAITING
        is_blocked = self._free_distance < self._length
        if is_blocked and self._free_distance - self._base_distance <= STANDSTILL_DISTANCE:
            return WAITING
        return DRIVING

    def _plan(self, base_position: Float) -> Path | None:
        """Plan a path from the base to the goal; it begins at `_find_free_place`.

        Returns None if there is no path, also where the grid has no floor at the goal's height: a
        position would stand for the floor of the storey below.
        """
        start = self._find_free_place(base_position)
        if start is None:
            return None
        path = find_path(self._search, start, self._goal, None, by=self.path.by, smooth=True)
        if path is None or not self._is_same_storey(float(path.positions[-1, 2]), self._goal):
            return None
        return path

    def _find_free_place(self, base_position: Float) -> Float | None:
        """Find the base's own place, or else the nearest free one in sight within the lookahead.

        Returns world x, y and floor z [m], shape (3,); None if there is no such place.
        """
        return snap(
            self._search,
            base_position,
            level=None,
            same_level=True,
            same_room=False,
            room=None,
            island=None,
            in_sight=True,
            max_distance=self._limits.lookahead,
        )

    def _set_path(self, path: Path) -> None:
        """Follow a new path from its start.

        A leg is the line from one point of the path to the next. Its level is -1 over a link.
        """
        self.path = path
        self.state = DRIVING
        self._version = self._search.version
        self._is_path_on_grid = _has_lattices_of(path, self._search)
        self._is_stranded = False  # whether the base has lost its path, and there is no other one
        self._points: Float = path.positions[:, :2]
        self._point_distances = distances_of_points(path.positions)
        self._length = float(self._point_distances[-1])
        self._base_distance = 0.0  # how far along the path the base is [m]
        self._num_links_taken = 0
        self._leg_levels: Int = np.where(path.levels[:-1] == path.levels[1:], path.levels[:-1], -1)
        for stop_index, next_stop_index in path.stops.tolist():
            self._leg_levels[stop_index:next_stop_index] = -1
        # Whether `can_pass` allowed each whole leg; others lead from centre to centre of cells. The
        # legs of a path of another grid all have to be allowed.
        is_path_of_grid = path.grid is self._search.grid
        self._leg_is_swept = [
            level >= 0
            and (
                not is_path_of_grid
                or self._search.can_pass(self._points[k], self._points[k + 1], level)
            )
            for k, level in enumerate(self._leg_levels.tolist())
        ]
        self._free_distance = self._find_free_distance(0.0)

    def _nearest_distance(self, position: Float) -> float:
        """Find the point of the path that is nearest to a position.

        Only points ahead count: at most two lookaheads away, and none beyond the next stop of a
        link.

        Returns:
            The point's distance along the path [m].
        """
        if self._length == 0.0:
            return 0.0
        stop_index = self._next_stop
        end_distance = (
            self._length if stop_index is None else float(self._point_distances[stop_index])
        )
        least_distance = self._base_distance
        greatest_distance = min(self._base_distance + 2.0 * self._limits.lookahead, end_distance)
        leg_starts = self._points[:-1]
        point_distances = self._point_distances
        leg_vectors = np.diff(self._points, axis=0)
        leg_lengths = np.diff(point_distances)
        distance_on_leg = ((position[:2] - leg_starts) * leg_vectors).sum(axis=1) / np.maximum(
            leg_lengths, LEAST_LENGTH
        )
        distances = np.clip(
            point_distances[:-1] + np.clip(distance_on_leg, 0.0, leg_lengths),
            least_distance,
            greatest_distance,
        )
        leg_fractions = (distances - point_distances[:-1]) / np.maximum(leg_lengths, LEAST_LENGTH)
        distances_off_path = np.hypot(
            *(leg_starts + leg_fractions[:, None] * leg_vectors - position[:2]).T
        )
        distances_off_path[
            (point_distances[1:] < least_distance) | (point_distances[:-1] > greatest_distance)
        ] = np.inf
        return float(distances[int(np.argmin(distances_off_path))])

    def _find_free_distance(self, first_distance: float) -> float:
        """Find the distance along the path up to which it is free [m], from a distance on."""
        if not self._is_path_on_grid:
            return first_distance
        point_distances = self._point_distances
        first_leg = max(int(np.searchsorted(point_distances, first_distance, side="right")) - 1, 0)
        for leg in range(first_leg, len(self._leg_levels)):
            leg_length = float(point_distances[leg + 1] - point_distances[leg])
            first_fraction = max(first_distance - float(point_distances[leg]), 0.0) / max(
                leg_length, LEAST_LENGTH
            )
            if self._is_leg_free(leg, first_fraction, 1.0):
                continue
            free_fraction = first_fraction
            blocked_fraction = 1.0
            for _ in range(NUM_HALVINGS):
                middle_fraction = (free_fraction + blocked_fraction) / 2
                if self._is_leg_free(leg, first_fraction, middle_fraction):
                    free_fraction = middle_fraction
                else:
                    blocked_fraction = middle_fraction
            return float(point_distances[leg]) + leg_length * free_fraction
        return self._length

    def _is_leg_free(self, leg: int, first_fraction: float, last_fraction: float) -> bool:
        """Whether a part of a leg is free.

        Args:
            leg: the leg's index.
            first_fraction: where the part begins, as a fraction of the leg's length.
            last_fraction: where it ends.
        """
        search = self._search
        flat = search.flat
        level = int(self._leg_levels[leg])
        start = self._points[leg]
        leg_vector = self._points[leg + 1] - self._points[leg]
        if level < 0:
            return True  # the legs before and after end in the link's cells, and are checked
        if self._leg_is_swept[leg]:
            return search.can_pass(
                start + first_fraction * leg_vector, start + last_fraction * leg_vector, level
            )
        # else the leg leads from centre to centre, along a row, a column or a diagonal
        cell_size = float(flat.layout.cell_size[level])
        num_cells = max(round(float(np.abs(leg_vector).max()) / cell_size), 1)
        fractions = np.clip(np.arange(num_cells + 1) / num_cells, EDGE_SHARE, 1.0 - EDGE_SHARE)
        # check the cells in the part, and the last one before it
        fractions = fractions[
            (fractions > first_fraction - 1.0 / num_cells)
            & (fractions <= last_fraction + LEAST_LENGTH)
        ]
        cells = flat.cells_at(start + fractions[:, None] * leg_vector, level)
        is_diagonal = bool((np.abs(leg_vector) > cell_size / 4).all())
        is_free: Bool = search.free_diagonally if is_diagonal else flat.free
        return bool(is_free[cells[cells >= 0]].all())

    @property
    def _next_stop(self) -> int | None:
        """Index of the path's point from which the next link leads; None if no link follows."""
        next_stops = self.path.stops[self._num_links_taken :]
        return int(next_stops[0, 0]) if len(next_stops) else None

    def _find_level_at(self, distance: float) -> int:
        """Find the level at a distance along the path; at a link, the level of its stop."""
        stop_index = self._next_stop
        if stop_index is not None and distance >= self._point_distances[stop_index]:
            return int(self.path.levels[stop_index])
        next_index = int(np.searchsorted(self._point_distances, distance, "right"))
        return int(self.path.levels[min(next_index, len(self._point_distances) - 1)])

    def _find_point_ahead(self, base_position: Float, free_point: Float | None) -> Float:
        """Find the point that the base heads for, world x, y, z [m], shape (3,).

        It is the farthest lookahead point that a free straight line leads to; the nearest of them
        if no line is free; while waiting, the base's position; and while riding, the link's next
        stop.

        Args:
            base_position: world x, y, z [m], shape (3,).
            free_point: see `_find_free_point_ahead`.
        """
        if self.state == RIDING:
            stop_after_link = self.path.stops[self._num_links_taken, 1]
            return np.asarray(self.path.positions[stop_after_link])
        if self.state == WAITING or not self._is_path_on_grid:
            return base_position.copy()  # a caller may go on to write into its array
        return self._lookahead_point(LOOKAHEAD_SHARES[-1]) if free_point is None else free_point

    def _find_free_point_ahead(self, base_position: Float) -> Float | None:
        """Find the farthest lookahead point that a free straight line leads to; None for none."""
        if not self._is_path_on_grid:
            return None
        level = self._find_level_at(self._base_distance)
        for lookahead_share in LOOKAHEAD_SHARES:
            distance = self._base_distance + lookahead_share * self._limits.lookahead
            point_ahead = self._lookahead_point(lookahead_share)
            is_same_level = self._find_level_at(distance) == level
            if is_same_level and self._search.can_pass(base_position[:2], point_ahead[:2], level):
                return point_ahead
        return None

    def _lookahead_point(self, lookahead_share: float) -> Float:
        """Find the point of the path a share of the lookahead ahead, at most the next link's stop.

        Returns world x, y, z [m], shape (3,).
        """
        stop_index = self._next_stop
        distance = self._base_distance + lookahead_share * self._limits.lookahead
        if stop_index is not None and distance >= self._point_distances[stop_index]:
            return np.asarray(self.path.positions[stop_index])
        return self._point_at(distance)

    def _point_at(self, distance: float) -> Float:
        """Compute the position at a distance along the path, as `Path.at` does."""
        return positions_at(self.path.positions, self._point_distances, distance)


def _has_lattices_of(path: Path, search: Search) -> bool:
    """Whether a search's grid has the levels and cells of the grid that a path was found on."""
    if path.grid is None:
        return False
    path_lattices = [level.lattice for level in path.grid.levels]
    return path_lattices == [level.lattice for level in search.grid.levels]
