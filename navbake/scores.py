"""Measures how well agents did: compares their trajectories with the episodes of a set.

`Measures` and `FlightMeasures` follow one episode step by step, and `score_set` scores the
trajectories of a set. The functions on arrays also take arrays of ``jax.numpy`` or ``torch``, if
that module is given as `xp`; they have no branches on values.

Distances [m] are those of `PathFinder` over cells, from the cell of a position to the nearest place
of the goal. If no agent can stand in that cell, the distance from the nearest free cell counts,
plus the distance to that cell. A position counts as on the floor that it is over, and lengths are
measured on the map, as these distances are. For flights, the distances are those of `VoxelFinder`
over voxels. Success and SPL use the same distances. An object that has to be reached (task
``reach``) also has to be faced, so there each position needs a heading.
"""

from __future__ import annotations

import functools
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from statistics import NormalDist
from types import ModuleType
from typing import Any, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from navbake.episodes.episode import (
    CLASS_EDGES,
    FLY_TASK,
    Episode,
    EpisodeSet,
    choose_agent,
    digest_of,
    scene_of,
)
from navbake.episodes.flights import digest_of_voxels, list_flight_points, make_flight_finder
from navbake.episodes.formats import decode
from navbake.episodes.goals import (
    MAX_SNAP_DISTANCE,
    Stops,
    find_stops,
    make_reach_test,
    plan_path_through,
)
from navbake.errors import FormatError, QueryError
from navbake.formats.npz import open_archive
from navbake.formats.source import read_bytes, unpack
from navbake.lengths import format_position
from navbake.navgrid.cells import describe_outside
from navbake.navgrid.grid import NavGrid
from navbake.runtime.agents import fit_grid
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.places import snap_to_cells
from navbake.types import Bool, Float, Json, Vector3
from navbake.voxels.finder import VoxelFinder
from navbake.voxels.grid import VoxelGrid

NDTW_THRESHOLD = 3.0  # the value of VLN-CE [m]
NUM_RESAMPLES = 1000  # of a bootstrap
ARRIVAL_TOLERANCE = 1e-6  # a straight move that ends this near to its end has arrived [m]
MEAN_FIELDS = (
    "success", "spl", "soft_spl", "distance", "oracle_success", "ndtw", "length", "collisions",
    "time", "coverage",
)  # fmt: skip
"""The measures of an episode that `summarize` averages."""
YES_NO_FIELDS = ("success", "oracle_success")
"""Those of `MEAN_FIELDS` that are 0 or 1."""
GROUP_KINDS = ("all", "distance", "ratio", "room", "scene", "split")

Array: TypeAlias = Any
"""An array of numpy, jax.numpy or torch."""


def success(distance: Array, radius: Array, stopped: Array, *, xp: ModuleType = np) -> Array:
    """Return 1.0 where an agent stopped within the radius of its goal, else 0.0.

    Args:
        distance: the agent's distance to the goal at the end [m], shape (...); NaN is no success.
        radius: largest distance at which the goal counts as reached [m], a number or shape (...).
        stopped: whether the agent called stop, bool or shape (...).
        xp: the arrays' module: numpy, ``jax.numpy`` or ``torch``.

    Returns:
        Floats, shape (...).
    """
    is_success = (distance <= radius) & stopped
    return xp.where(is_success, xp.ones_like(distance), xp.zeros_like(distance))


def spl(succeeded: Array, shortest: Array, length: Array, *, xp: ModuleType = np) -> Array:
    """Compute success weighted by path length (SPL): S l / max(l, p).

    Args:
        succeeded: S, 1.0 or 0.0, shape (...).
        shortest: l, the length of the shortest path [m], shape (...).
        length: p, the length of the agent's path [m], shape (...).
        xp: the arrays' module: numpy, ``jax.numpy`` or ``torch``.

    Returns:
        The SPL, 0 to 1, shape (...): 0 where S is 0; S where l is 0; NaN where S is 1 and l is not
        finite.

    Source: Anderson et al., "On Evaluation of Embodied Navigation Agents" (2018).
    """
    efficiency = _efficiency(shortest, length, xp)
    return xp.where(succeeded > 0, succeeded * efficiency, succeeded * 0.0)


def soft_spl(distance: Array, shortest: Array, length: Array, *, xp: ModuleType = np) -> Array:
    """Compute progress weighted by path length (SoftSPL): max(0, 1 - d / l) l / max(l, p).

    Args:
        distance: d, the agent's distance to the goal at the end [m], shape (...).
        shortest: l, the length of the shortest path [m], shape (...).
        length: p, the length of the agent's path [m], shape (...).
        xp: the arrays' module: numpy, ``jax.numpy`` or ``torch``.

    Returns:
        The SoftSPL, 0 to 1, shape (...). Where l is 0, it is 1 if d is 0, else 0. NaN where l is
        not finite, or d is NaN.

    Source: Datta et al., "Integrating Egocentric Localization" (2020).
    """
    is_positive = xp.isfinite(shortest) & (shortest > 0)
    positive_shortest = xp.where(is_positive, shortest, xp.ones_like(shortest))
    share_without_path = xp.where(distance > 0, 1.0, distance)
    remaining_share = xp.where(shortest > 0, distance / positive_shortest, share_without_path)
    progress = xp.where(remaining_share > 1, xp.zeros_like(remaining_share), 1.0 - remaining_share)
    return progress * _efficiency(shortest, length, xp)


def _efficiency(shortest: Array, length: Array, xp: ModuleType) -> Array:
    """Compute l / max(l, p), with l the shortest path's length and p that of the agent's path.

    The result is 1 where l is 0, and NaN where l is not finite.
    """
    is_finite = xp.isfinite(shortest)
    positive_shortest = xp.where(is_finite & (shortest > 0), shortest, xp.ones_like(shortest))
    is_detour = (length > positive_shortest) & (shortest > 0)
    length_ratio = positive_shortest / xp.where(is_detour, length, positive_shortest)
    return xp.where(is_finite, length_ratio, xp.full_like(length_ratio, math.nan))


def path_length(positions: ArrayLike) -> float:
    """Compute the length of the polyline through positions.

    Args:
        positions: world x, y, z [m], shape (n, 3).

    Returns:
        The length [m]; 0 for one position or none.
    """
    points = np.asarray(positions, dtype=np.float64)
    if len(points) < 2:
        return 0.0
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def ndtw(
    path: Array, reference: Array, threshold: float = NDTW_THRESHOLD, *, xp: ModuleType = np
) -> Array:
    """Compute normalized dynamic time warping (nDTW): exp(-DTW / (n threshold)).

    DTW matches each point of the path with one point or more of the reference, and the reverse,
    without changing their order. Of all ways to match them, it takes the one with the least sum of
    distances between matched points; that sum is DTW.

    Args:
        path: the agent's positions, world x, y, z [m], shape (m, 3).
        reference: the path that the agent should have taken [m], shape (n, 3).
        threshold: the distance at which a point counts as missed [m].
        xp: the arrays' module: numpy, ``jax.numpy`` or ``torch``.

    Returns:
        The nDTW, 0 to 1; NaN if one of the paths has no points.

    Source: Ilharco et al., "General Evaluation for Instruction Conditioned Navigation using
    Dynamic Time Warping" (2019).
    """
    path = xp.asarray(path)
    reference = xp.asarray(reference)
    if not len(path) or not len(reference):
        return math.nan
    shorter, longer = (path, reference) if len(path) < len(reference) else (reference, path)
    distances = xp.sqrt(((shorter[:, None] - longer) ** 2).sum(-1))
    rows = xp.arange(len(shorter))
    num_cols = len(longer)
    # The table of least sums has a row for each point of `shorter`, and a column for each point of
    # `longer`. It is filled anti-diagonal by anti-diagonal, because each depends only on the two
    # before it. An anti-diagonal is an array with an entry for each row.
    second_last_sums = xp.full_like(distances[:, 0], math.inf)
    last_sums = second_last_sums
    for diagonal in range(len(shorter) + num_cols - 1):
        cols = diagonal - rows
        if diagonal:
            least_sum_of_previous_row = xp.minimum(last_sums[rows - 1], second_last_sums[rows - 1])
            least_sums = xp.where(
                rows > 0, xp.minimum(last_sums, least_sum_of_previous_row), last_sums
            )
        else:
            least_sums = xp.zeros_like(last_sums)
        is_inside = (cols >= 0) & (cols < num_cols)
        diagonal_distances = xp.where(
            is_inside, distances[rows, xp.clip(cols, 0, num_cols - 1)], math.inf
        )
        second_last_sums = last_sums
        last_sums = diagonal_distances + least_sums
    return xp.exp(-last_sums[-1] / (len(reference) * threshold))


class Interval(NamedTuple):
    """The mean of values and its confidence interval; mean and ends are NaN without values."""

    mean: float
    low: float  #: The interval's lower end.
    high: float  #: The interval's upper end.
    known: int  #: Number of values that are not NaN.


def bootstrap(
    values: ArrayLike,
    *,
    seed: int = 0,
    samples: int = NUM_RESAMPLES,
    certainty: float = 0.95,
) -> Interval:
    """Compute the mean of values, and its confidence interval by percentile bootstrap.

    Args:
        values: an array of any shape; NaN values are left out.
        seed: seed of the generator that draws the resamples.
        samples: number of resamples.
        certainty: the share of resamples whose means lie in the interval, 0 to 1.

    Returns:
        The mean and the interval.
    """
    valid_values = _drop_nan(values)
    num_values = len(valid_values)
    if not num_values:
        return Interval(math.nan, math.nan, math.nan, 0)
    rng = np.random.default_rng(seed)
    resample_means = [
        valid_values[rng.integers(num_values, size=num_values)].mean() for _ in range(samples)
    ]
    low, high = np.quantile(resample_means, [(1 - certainty) / 2, (1 + certainty) / 2])
    return Interval(float(valid_values.mean()), float(low), float(high), num_values)


def wilson_interval(values: ArrayLike, *, certainty: float = 0.95) -> Interval:
    """Compute the share of values that are 1, and its confidence interval by Wilson's score.

    Of few episodes, all of which succeed or fail, every resample of a bootstrap is the same, and
    its interval has no width. This one has: 17 successes of 17 are 0.816 to 1.

    Args:
        values: an array of any shape, of 0 and 1; NaN values are left out.
        certainty: how often such an interval contains the true share, 0 to 1.

    Returns:
        The share and the interval.

    Source:
        E. B. Wilson, Probable inference, the law of succession, and statistical inference, 1927.
    """
    valid_values = _drop_nan(values)
    num_values = len(valid_values)
    if not num_values:
        return Interval(math.nan, math.nan, math.nan, 0)
    share = float(valid_values.mean())
    z = NormalDist().inv_cdf((1 + certainty) / 2)
    weight = z * z / num_values
    center = (share + weight / 2) / (1 + weight)
    half_width = math.sqrt(share * (1 - share) * weight + weight * weight / 4) / (1 + weight)
    # at 0 and 1 the ends are exact, but for rounding
    low = 0.0 if share == 0.0 else center - half_width
    high = 1.0 if share == 1.0 else center + half_width
    return Interval(share, low, high, num_values)


def _drop_nan(values: ArrayLike) -> Float:
    """Return the values that are not NaN, shape (n,)."""
    flat_values = np.asarray(values, dtype=np.float64).ravel()
    return flat_values[~np.isnan(flat_values)]


class EpisodeMeasures(ABC):
    """Measures one episode while an agent acts: what `Measures` and `FlightMeasures` share.

    The episode's start is the first position. All distances are those of the grid or the voxels
    that the finder has when the measures are made.

    Args:
        episode: the episode.
        threshold: distance at which nDTW counts a point as missed [m].

    Raises:
        QueryError: no agent can get to the goal, or the start is outside of the grid.
    """

    def __init__(self, episode: Episode, threshold: float) -> None:
        self.episode = episode
        self.threshold = threshold
        self.share = episode.goals[0].share
        self.radius = episode.goals[0].radius
        self._first_map = self._current_map()
        self._stops = self._find_stops()
        self._num_reached = 0  # how many of the stops the agent has reached
        self._positions = list[Float]()
        self._headings = [episode.heading]  # fewer than positions if some are unknown
        self._times = list[float]()
        self._distances = list[float]()
        self._add_positions(np.array([episode.start]), "start")
        self.shortest = self._distances[0]

    @abstractmethod
    def _current_map(self) -> object:
        """Return the grid or the voxels that the finder has now."""

    def _check_map(self) -> None:
        """Raise a QueryError if the finder has another grid, or other voxels, than at the start."""
        if self._current_map() is not self._first_map:
            raise QueryError(
                f"the finder has changed its grid since the start of episode {self.episode.id!r}: "
                "make the measures anew after `use`"
            )

    @abstractmethod
    def _find_stops(self) -> Stops:
        """Find the stops of the episode's goals.

        Raises:
            QueryError: no agent can get there.
        """

    @abstractmethod
    def _to_ground(self, new_positions: Float) -> Float:
        """Move positions to where they are measured: an agent's to the floor that it stands on.

        Args:
            new_positions: world x, y, z [m], finite, shape (n, 3).

        Returns:
            World x, y, z [m], shape (n, 3).
        """

    @abstractmethod
    def _measure_length(self, positions: Float) -> float:
        """Compute the length of the way through positions [m], as distances are measured."""

    @abstractmethod
    def _measure_distances(self, new_positions: Float, position_label: str) -> Float:
        """Compute the distance from each position to each stop [m], shape (number of stops, n).

        Args:
            new_positions: world x, y, z [m], finite, shape (n, 3).
            position_label: what errors call a position.

        Raises:
            QueryError: a position is outside of the grid.
        """

    @abstractmethod
    def _find_reference_path(self) -> Sequence[Vector3]:
        """Return the episode's path; if it has none, plan one. Empty if there is no path."""

    @abstractmethod
    def _count_collisions(self, positions: Float) -> int:
        """Count the moves from one position to the next that collide."""

    @abstractmethod
    def _coverage(self, positions: Float) -> float:
        """Return the share of the start's island that the agent has covered, by area."""

    def _describe_place(self, positions: Float, is_inside: Bool, position_label: str) -> str:
        """Name the first position that isn't in the grid.

        Args:
            positions: world x, y, z [m], shape (n, 3).
            is_inside: whether each position is in the grid, shape (n,); at least one isn't.
            position_label: what the text calls a position.
        """
        row = int(np.argmin(is_inside))
        coordinates = format_position(positions[row])
        return f"{position_label} {row} of episode {self.episode.id!r}, {coordinates}"

    @property
    def distance(self) -> float:
        """Length of the shortest path from the last position to the goal [m].

        The path goes through all stops that are not reached yet. NaN for exploring, which has none.
        """
        return self._distances[-1]

    def step(
        self, position: ArrayLike, time: float | None = None, heading: float | None = None
    ) -> float:
        """Add a position of the agent.

        Args:
            position: world x, y, z [m].
            time: time of the position [s].
            heading: where the agent faces there [rad]; needed for the task ``reach``.

        Returns:
            `distance` from this position [m].

        Raises:
            QueryError: the position is not finite, or in no cell; or the finder has another grid
                than at the start.
        """
        times = None if time is None else [time]
        headings = None if heading is None else [heading]
        self.steps(np.asarray(position, dtype=np.float64)[None], times, headings)
        return self.distance

    def steps(
        self,
        positions: ArrayLike,
        times: Sequence[float] | None = None,
        headings: Sequence[float] | None = None,
    ) -> None:
        """Add many positions of the agent, in their order.

        Args:
            positions: world x, y, z [m], shape (n, 3).
            times: time of each position [s], shape (n,).
            headings: where the agent faces at each [rad], shape (n,); needed for the task
                ``reach``.

        Raises:
            QueryError: a position is not finite, or in no cell; or the finder has another grid than
                at the start.
        """
        new_positions = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
        self._add_positions(new_positions, "position")
        if times is not None:
            self._times += [float(time) for time in times]
        if headings is not None:
            self._headings += [float(heading) for heading in headings]

    def _add_positions(self, new_positions: Float, position_label: str) -> None:
        """Add the next positions and their distances to the goal, and count the reached stops.

        The distance of a position is the length of the path through all stops not reached yet [m].

        Args:
            new_positions: world x, y, z of the positions [m], shape (n, 3).
            position_label: what errors call a position.

        Raises:
            QueryError: a position is not finite, or in no cell; or the finder has another grid than
                at the start.
        """
        self._check_map()
        nonfinite_rows = np.flatnonzero(~np.isfinite(new_positions).all(axis=1))
        if len(nonfinite_rows):
            place_text = f"{position_label} {nonfinite_rows[0]} of episode {self.episode.id!r}"
            raise QueryError(f"expected finite numbers at {place_text}")
        ground_positions = self._to_ground(new_positions)
        self._positions += list(ground_positions)
        distances_of_stops = self._measure_distances(ground_positions, position_label)
        distances_after_stop = self._stops.remaining_lengths
        if not len(distances_of_stops):
            self._distances += [math.nan] * len(new_positions)
            return
        last_stop = len(distances_of_stops) - 1
        for stop_distances in distances_of_stops.T.tolist():
            while (
                stop_distances[self._num_reached] <= self.radius and self._num_reached < last_stop
            ):
                self._num_reached += 1
            self._distances.append(
                stop_distances[self._num_reached] + distances_after_stop[self._num_reached]
            )

    def scores(self, *, stopped: bool) -> Json:
        """Compute the measures of the episode up to the last position.

        Args:
            stopped: whether the agent called stop at its last position.

        Returns:
            The measures by name: those of `MEAN_FIELDS`, and ``shortest``, the length of the
            shortest path [m]. A measure that has no meaning for the episode is NaN.

        Raises:
            QueryError: the agent has to face an object, and positions have no headings; or the
                finder has another grid than at the start.
        """
        self._check_map()
        positions = np.array(self._positions)
        stop_positions = self._stops.places
        length = np.array(self._measure_length(positions))
        distance = np.array(self.distance)
        shortest = np.array(self.shortest)
        coverage = math.nan if self.share is None else self._coverage(positions)
        goal_distances = self._goal_distances(positions, coverage)
        success_score = success(np.array(goal_distances[-1]), self.radius, stopped)
        oracle_score = success(np.array(np.min(goal_distances)), self.radius, True)
        reference_path = self._find_reference_path() if stop_positions else ()
        times = self._times
        measures = {
            "success": success_score,
            "spl": spl(success_score, shortest, length) if stop_positions else math.nan,
            "soft_spl": soft_spl(distance, shortest, length),
            "distance": distance,
            "oracle_success": oracle_score,
            "ndtw": ndtw(positions, reference_path, self.threshold),
            "length": length,
            "collisions": self._count_collisions(positions),
            "time": times[-1] - times[0] if times else math.nan,
            "coverage": coverage,
            "shortest": shortest,
        }
        return {name: float(value) for name, value in measures.items()}

    def _goal_distances(self, positions: Float, coverage: float) -> Float:
        """Return the distances that success is decided by [m], one for each position.

        If the goal is to cover a share of the floor, there is a single one: 0 if that share is
        covered, else infinity.
        """
        if self.share is not None:
            return np.array([0.0 if coverage >= self.share else math.inf])
        if self.episode.extra.get("success") == "planar":
            goal_positions = [
                goal.position for goal in self.episode.goals if goal.position is not None
            ]
            goal_vectors = positions[:, None] - np.array(goal_positions)
            planar_distances: Float = np.linalg.norm(goal_vectors[..., :2], axis=-1).min(axis=1)
            return planar_distances
        return np.array(self._distances)


class Measures(EpisodeMeasures):
    """Measures one episode while an agent acts: add its positions, then ask for the scores.

    The episode's start is the first position. Positions may be at any height over the floor that
    the agent stands on, as those of MINOS, 0.545 m above it, are: they count on the floor.

    Args:
        finder: a PathFinder on the set's grid, inflated for the set's agent.
        episode: the episode.
        threshold: distance at which nDTW counts a point as missed [m].

    Raises:
        QueryError: no agent can get to the goal on this grid, or the start is in no cell.
    """

    def __init__(
        self, finder: PathFinder, episode: Episode, *, threshold: float = NDTW_THRESHOLD
    ) -> None:
        self.finder = finder
        super().__init__(episode, threshold)

    def _current_map(self) -> NavGrid:
        return self.finder.grid

    def _find_stops(self) -> Stops:
        goals = self.episode.goals
        is_ordered = self.episode.task == "sequence"
        # successive episodes often have the same goals: the search keeps the stops of the last ones
        find_stops_of_goals = functools.partial(find_stops, self.finder, goals, in_order=is_ordered)
        stops = self.finder.search.cached_result("stops", (goals, is_ordered), find_stops_of_goals)
        if stops is None:
            raise QueryError(f"no agent can stand at the goal of episode {self.episode.id!r}")
        return stops

    def _to_ground(self, new_positions: Float) -> Float:
        flat = self.finder.search.flat
        cells = flat.cells_at(new_positions)
        is_inside = cells >= 0
        ground_positions = new_positions.copy()
        ground_positions[is_inside, 2] = flat.floor_heights(cells[is_inside])
        return ground_positions

    def _measure_length(self, positions: Float) -> float:
        # seen from above, as the distances of `PathFinder` are: with its height, the shortest path
        # over stairs would be longer than the shortest path
        return path_length(positions * (1.0, 1.0, 0.0))

    def _measure_distances(self, new_positions: Float, position_label: str) -> Float:
        flat = self.finder.search.flat
        cells = flat.cells_at(new_positions)
        outside_positions = new_positions[cells < 0]
        if len(outside_positions):
            place_text = self._describe_place(new_positions, cells >= 0, position_label)
            problem = describe_outside(self.finder.grid, outside_positions[0])
            raise QueryError(f"{place_text}, {problem}")
        if not self._stops.distance_fields:
            return np.empty((0, len(new_positions)))
        free_cell_distances = np.zeros(len(new_positions))  # to the nearest free cell [m]
        blocked_indices = np.flatnonzero(~flat.free[cells])
        if len(blocked_indices):
            snapped_positions, nearest_cells = snap_to_cells(
                flat, flat.free, new_positions[blocked_indices], max_distance=MAX_SNAP_DISTANCE
            )
            is_near = nearest_cells >= 0
            cells[blocked_indices] = np.where(is_near, nearest_cells, cells[blocked_indices])
            snap_distances = np.linalg.norm(
                snapped_positions - new_positions[blocked_indices], axis=1
            )
            free_cell_distances[blocked_indices] = np.where(is_near, snap_distances, math.inf)
        cell_distances = [field[cells] for field in self._stops.distance_fields]
        return np.stack(cell_distances) + free_cell_distances

    def _find_reference_path(self) -> Sequence[Vector3]:
        if self.episode.path:
            return self.episode.path
        return plan_path_through(self.finder, self.episode.start, self._stops.places).get(
            "path", ()
        )

    def _goal_distances(self, positions: Float, coverage: float) -> Float:
        distances = super()._goal_distances(positions, coverage)
        if any(goal.stance is not None for goal in self.episode.goals):
            return np.where(self._mark_reaching(positions), distances, math.inf)
        return distances

    def _mark_reaching(self, positions: Float) -> Bool:
        """Mark the positions where the agent reaches the object of a goal, shape (n,)."""
        stances = [goal.stance for goal in self.episode.goals if goal.stance is not None]
        headings = self._headings
        if not any(stance.needs_heading for stance in stances):
            headings = [0.0] * len(positions)
        if len(headings) < len(positions):
            expected = f"a heading for each of {len(positions) - 1} positions"
            got = f"{len(headings) - 1} in episode {self.episode.id!r}"
            hint = "its task is to face an object, so trajectories need `headings` [rad]"
            raise QueryError(f"expected {expected}, got {got}: {hint}")
        is_reaching = np.zeros(len(positions), dtype=np.bool_)
        for goal in self.episode.goals:
            if goal.stance is not None:
                reach_test = make_reach_test(self.finder, goal.name, goal.stance)
                is_reaching |= reach_test.mark(positions, headings)
        return is_reaching

    def _count_collisions(self, positions: Float) -> int:
        """Count the moves that collide.

        These start in a cell that isn't free, or an agent can't make them in a straight line.
        """
        starts = positions[:-1]
        ends = positions[1:]
        flat = self.finder.search.flat
        is_free = flat.free[flat.cells_at(starts)]
        arrival_positions = self.finder.try_step(starts[is_free], ends[is_free], slide=False)
        arrival_errors = np.abs(arrival_positions - ends[is_free])[:, :2].max(axis=1, initial=0.0)
        return int((~is_free).sum() + (arrival_errors > ARRIVAL_TOLERANCE).sum())

    def _coverage(self, positions: Float) -> float:
        """Return the share of the start's island that the agent has covered, by area.

        The agent has covered each cell whose distance from one of its positions, along the floor,
        is at most the goal's radius.
        """
        search = self.finder.search
        flat = search.flat
        island_of_cell = search.islands.number
        island = island_of_cell[flat.cells_at(positions[0])]
        cells = np.unique(flat.cells_at(positions))
        cells = cells[(island_of_cell[cells] == island) & (island > 0)]
        if not len(cells):
            return 0.0
        distance_of_cell = search.lengths_from(cells)
        covered_cells = np.flatnonzero(
            (distance_of_cell <= self.radius) & (island_of_cell == island)
        )
        cell_size = flat.layout.cell_size[flat.level_of(covered_cells)]
        return float((cell_size**2).sum() / search.islands.areas[island])


class FlightMeasures(EpisodeMeasures):
    """Measures one episode of a flight: add the positions of the ball, then ask for the scores.

    Distances are straight where the ball can fly straight to the goal, else those of
    `VoxelFinder.costs_at`, over voxels. Where the ball meets an occupied voxel, the distance from
    the nearest place where it fits counts, plus the distance to that place. Collisions are moves on
    which it meets one.

    Args:
        finder: a finder in the set's voxels for its ball, see
            `navbake.episodes.make_flight_finder`.
        episode: the episode, whose task is ``fly``.
        threshold: distance at which nDTW counts a point as missed [m].

    Raises:
        QueryError: the ball can't get to the goal, or the start is outside of the voxels.

    Example:
        >>> measures = FlightMeasures(finder, episode)
        >>> for position in finder.find_path(episode.start, episode.goals[0].position).positions:
        ...     measures.step(position)
        >>> measures.scores(stopped=True)["spl"]
    """

    def __init__(
        self, finder: VoxelFinder, episode: Episode, *, threshold: float = NDTW_THRESHOLD
    ) -> None:
        self.finder = finder
        super().__init__(episode, threshold)

    def _current_map(self) -> VoxelGrid:
        return self.finder.voxels

    def _find_stops(self) -> Stops:
        positions = [goal.position for goal in self.episode.goals if goal.position is not None]
        costs = self.finder.distance_field(positions) if positions else np.array(math.inf)
        if not np.isfinite(costs).any():
            raise QueryError(f"the ball doesn't get to the goal of episode {self.episode.id!r}")
        return Stops(self.episode.goals, [np.array(positions)], [costs])

    def _to_ground(self, new_positions: Float) -> Float:
        return new_positions

    def _measure_length(self, positions: Float) -> float:
        return path_length(positions)

    def _measure_distances(self, new_positions: Float, position_label: str) -> Float:
        lower, upper = self.finder.voxels.bounds
        is_inside = ((new_positions >= lower) & (new_positions < upper)).all(axis=1)
        if not is_inside.all():
            place_text = self._describe_place(new_positions, is_inside, position_label)
            raise QueryError(f"{place_text}, lies beside the voxels")
        distances = self._measure_free_distances(new_positions)
        blocked_indices = np.flatnonzero(~self.finder.is_free(new_positions))
        if len(blocked_indices):
            blocked_positions = new_positions[blocked_indices]
            places = self.finder.snap(blocked_positions.tolist(), max_distance=MAX_SNAP_DISTANCE)
            is_near = ~np.isnan(places[:, 0])
            snap_distances = np.linalg.norm(places - blocked_positions, axis=1)[is_near]
            free_distances = self._measure_free_distances(places[is_near])
            distances[blocked_indices[is_near]] = free_distances + snap_distances
        return distances[None]

    def _measure_free_distances(self, positions: Float) -> Float:
        """Compute the distance to the goal [m] from positions; inf where the ball doesn't fit."""
        [field] = self._stops.distance_fields
        [goals] = self._stops.places
        distances = self.finder.costs_at(field, positions)
        for goal in goals:
            is_clear = self.finder.sees(positions, goal)
            straight_distances = np.linalg.norm(positions - goal, axis=1)
            distances = np.where(is_clear, np.minimum(distances, straight_distances), distances)
        return distances

    def _find_reference_path(self) -> Sequence[Vector3]:
        if self.episode.path:
            return self.episode.path
        flight = self.finder.find_path(self.episode.start, self._stops.places[0])
        return () if flight is None else list_flight_points(flight)

    def _count_collisions(self, positions: Float) -> int:
        if len(positions) < 2:
            return 0
        is_clear = self.finder.sees(positions[:-1], positions[1:])
        return int(np.count_nonzero(np.logical_not(is_clear)))

    def _coverage(self, positions: Float) -> float:
        return math.nan  # no flight explores


class Trajectory(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The positions of an agent in one episode; `score_set` scores it."""

    episode: str  #: The episode's id.
    positions: Sequence[tuple[float, float, float]]  #: World x, y, z [m]; may be empty.
    stop: bool = True  #: Whether the agent called stop.
    times: Sequence[float] | None = None  #: The time of each position [s].
    headings: Sequence[float] | None = None  #: Where the agent faces at each position [rad].


def read_trajectories(path: str | os.PathLike[str]) -> list[Trajectory]:
    """Read trajectories from a file of JSON lines or from an ``.npz`` archive.

    A JSON line holds one trajectory, with the fields of `Trajectory`.

    The archive has the arrays ``episode`` (ids, shape (k,)), ``start`` (int, shape (k + 1,)),
    ``positions`` (shape (n, 3); trajectory i has the rows ``start[i]:start[i + 1]``). It may also
    have ``stop`` (bool, shape (k,)), ``times`` and ``headings`` (shape (n,)).

    Args:
        path: path of the file.

    Returns:
        The trajectories, in the order of the file.

    Raises:
        FormatError: the file is neither of the two, or it holds no trajectory.
    """
    if not os.fspath(path).lower().endswith(".npz"):
        content, name = read_bytes(path)
        lines = [line for line in unpack(content, name).splitlines() if line.strip()]
        if not lines:
            raise FormatError(f"expected trajectories in {name}, got none")
        return [
            decode(line, Trajectory, f"{name}, line {index}") for index, line in enumerate(lines, 1)
        ]
    expected = "arrays episode (k), start (k + 1) and positions (n, 3)"
    with open_archive(os.fspath(path), expected) as archive:
        episode_ids = archive.read("episode", archive.root_place)
        start_rows = archive.read("start", archive.root_place)
        positions = archive.read("positions", archive.root_place)
        stop_flags = archive.read("stop", archive.root_place) if "stop" in archive else None
        numbers_by_name = {
            name: archive.read(name, archive.root_place)
            for name in ("times", "headings")
            if name in archive
        }
        have_matching_shapes = (
            start_rows.shape == (len(episode_ids) + 1,)
            and positions.ndim == 2
            and positions.shape[1] == 3
            and (stop_flags is None or stop_flags.shape == episode_ids.shape)
            and all(numbers.shape == positions.shape[:1] for numbers in numbers_by_name.values())
        )
        if not len(episode_ids):
            raise ValueError("no trajectories")
        if not have_matching_shapes or start_rows[0] != 0 or start_rows[-1] != len(positions):
            raise ValueError("arrays of other shapes")
        if (np.diff(start_rows) < 0).any():
            raise ValueError("arrays of other shapes")
        trajectories = []
        for index, (first_row, stop_row) in enumerate(pairwise(start_rows.tolist())):
            trajectory_numbers = {
                name: numbers[first_row:stop_row].astype(np.float64).tolist()
                for name, numbers in numbers_by_name.items()
            }
            trajectories.append(
                Trajectory(
                    episode=str(episode_ids[index]),
                    positions=positions[first_row:stop_row].astype(np.float64).tolist(),
                    stop=stop_flags is None or bool(stop_flags[index]),
                    **trajectory_numbers,
                )
            )
        return trajectories


def score_set(
    content: EpisodeSet,
    trajectories: Iterable[Trajectory],
    grids: NavGrid | VoxelGrid | Sequence[NavGrid | VoxelGrid],
    *,
    threshold: float = NDTW_THRESHOLD,
    force: bool = False,
    partial: bool = False,
) -> list[Json]:
    """Compute the measures of a set's episodes from their trajectories.

    Args:
        content: the set of episodes.
        trajectories: one for each episode.
        grids: the grids that the set was made on, or of a set of flights, the voxels. Grids are
            inflated for the set's agent if they aren't yet.
        threshold: distance at which nDTW counts a point as missed [m].
        force: take the grids as they are: don't inflate them, and don't check that the set was made
            on them.
        partial: leave out episodes without a trajectory, instead of raising an error.

    Returns:
        A row for each episode, in the set's order, with ``episode``, ``scene``, ``room``,
        ``split``, ``ratio`` and `Measures.scores`.

    Raises:
        QueryError: a grid isn't the set's, an episode has no trajectory, or a trajectory has no
            episode or leaves the map.
    """
    trajectory_by_id: dict[str, Trajectory] = {}
    for trajectory in trajectories:
        if trajectory.episode in trajectory_by_id:
            raise QueryError(f"expected one trajectory of episode {trajectory.episode!r}, got two")
        trajectory_by_id[trajectory.episode] = trajectory
    episodes = [episode for episode in content.episodes if episode.id in trajectory_by_id]
    if unknown_ids := trajectory_by_id.keys() - {episode.id for episode in episodes}:
        raise QueryError(f"the set has no episode {min(unknown_ids)!r} as a trajectory has")
    num_missing = len(content) - len(episodes)
    if num_missing and not partial:
        first_missing_id = next(
            episode.id for episode in content.episodes if episode.id not in trajectory_by_id
        )
        missing_text = f"{num_missing} of {len(content)} episodes have no trajectory"
        hint = (
            "a run that failed counts as an empty one, or score a part of the set (--partial, "
            "partial=True)"
        )
        raise QueryError(f"{missing_text}, as {first_missing_id!r}: {hint}")
    if not isinstance(grids, Sequence):
        grids = [grids]
    finder_by_scene = dict(_make_finder(grid, content, force=force) for grid in grids)
    rows = []
    for episode in episodes:
        if episode.scene not in finder_by_scene:
            scenes_text = ", ".join(map(repr, sorted(finder_by_scene)))
            scene = min(finder_by_scene, default="NAME")
            raise QueryError(
                f"no grid of {episode.scene!r}, the scene of episode {episode.id!r}, among those "
                f"of {scenes_text}: a set of another program needs "
                f"`--scene {scene}={episode.scene}` (`scenes` of read_episodes)"
            )
        trajectory = trajectory_by_id[episode.id]
        times = trajectory.times
        if times is not None and len(times) != len(trajectory.positions):
            raise QueryError(f"expected a time for each position of episode {episode.id!r}")
        headings = trajectory.headings
        if headings is not None and len(headings) != len(trajectory.positions):
            raise QueryError(f"expected a heading for each position of episode {episode.id!r}")
        measures = _make_measures(finder_by_scene[episode.scene], episode, threshold)
        measures.steps(np.array(trajectory.positions, dtype=np.float64), times, headings)
        rows.append(
            {
                "episode": episode.id,
                "scene": episode.scene,
                "room": episode.room,
                "split": episode.split,
                "ratio": episode.ratio,
                **measures.scores(stopped=trajectory.stop),
            }
        )
    return rows


def _make_finder(
    grid: NavGrid | VoxelGrid, episode_set: EpisodeSet, *, force: bool
) -> tuple[str, PathFinder | VoxelFinder]:
    """Return a grid's scene, and a finder on the grid for the set's agent."""
    if isinstance(grid, VoxelGrid):
        finder = make_flight_finder(episode_set, grid, force=force)
        # voxels don't say of which scene they are: their digest does
        digest = digest_of_voxels(grid)
        grid_entries = episode_set.header.grids
        scenes = [grid_entry.scene for grid_entry in grid_entries if grid_entry.digest == digest]
        scenes += [episode.scene for episode in episode_set.episodes[:1]]
        return scenes[0] if scenes else "", finder
    header_agent = episode_set.header.agent
    agent_name = None if header_agent is None else header_agent.name or None
    radius = None if header_agent is None else header_agent.radius
    agent = choose_agent(grid, agent_name, radius)
    if not force:
        drawn_digests = {grid_entry.digest for grid_entry in episode_set.header.grids}
        if digest_of(grid) not in drawn_digests:
            grid = fit_grid(grid, agent)
        episode_set.check_grid(grid)
    return scene_of(grid), PathFinder(grid, agent=agent.without_sizes() if agent_name else None)


def _make_measures(
    finder: PathFinder | VoxelFinder, episode: Episode, threshold: float
) -> EpisodeMeasures:
    """Return measures of an episode, by a finder of its kind.

    Raises:
        QueryError: a flight has no voxels, or another task has no grid.
    """
    is_flight = episode.task == FLY_TASK
    if isinstance(finder, VoxelFinder) and is_flight:
        return FlightMeasures(finder, episode, threshold=threshold)
    if isinstance(finder, PathFinder) and not is_flight:
        return Measures(finder, episode, threshold=threshold)
    expected = "voxels" if is_flight else "a navigation grid"
    raise QueryError(
        f"expected {expected} for episode {episode.id!r}, whose task is {episode.task!r}"
    )


def summarize(
    rows: Sequence[Mapping[str, object]], by: str = "all", *, seed: int = 0
) -> list[Json]:
    """Compute the means of the measures over groups of episodes.

    Args:
        rows: rows that `score_set` returned.
        by: one of `GROUP_KINDS`. ``distance`` groups by classes of the shortest path's length;
            ``ratio`` by classes of this length divided by the straight distance.
        seed: seed of `bootstrap`, which computes the intervals of all measures but those that are
            yes or no, `YES_NO_FIELDS`: these have Wilson's.

    Returns:
        For each group its name (``group``), its number of ``episodes``, and an `Interval` for each
        of `MEAN_FIELDS`; infinite values are left out.

    Raises:
        QueryError: there is no such grouping.
    """
    if by not in GROUP_KINDS:
        raise QueryError(f"expected one of {', '.join(GROUP_KINDS)} to group by, got {by!r}")
    if by in ("distance", "ratio"):
        groups = _group_by_class(rows, by)
    else:
        groups = {}
        for row in rows:
            groups.setdefault("all" if by == "all" else str(row[by]), []).append(row)
    summaries = []
    for name, group_rows in groups.items():
        interval_by_measure = {}
        for measure in MEAN_FIELDS:
            measured_values = np.array([row[measure] for row in group_rows], dtype=float)
            if measure in YES_NO_FIELDS:
                interval_by_measure[measure] = wilson_interval(measured_values)
                continue
            interval_by_measure[measure] = bootstrap(
                np.where(np.isinf(measured_values), np.nan, measured_values), seed=seed
            )
        summaries.append({"group": name, "episodes": len(group_rows), **interval_by_measure})
    return summaries


def _group_by_class(
    rows: Sequence[Mapping[str, object]], by: str
) -> dict[str, list[Mapping[str, object]]]:
    """Group rows by the class of their distance or ratio; rows without one are in ``-``."""
    class_edges = (0.0, *CLASS_EDGES["distance"]) if by == "distance" else CLASS_EDGES["ratio"]
    unit = " m" if by == "distance" else ""
    class_ranges = [f"{low:g} to {high:g}{unit}" for low, high in pairwise(class_edges)]
    class_names = ["-", *class_ranges, f"{class_edges[-1]:g} and more{unit}"]
    measure = "shortest" if by == "distance" else by
    class_values = np.array(
        [math.nan if row[measure] is None else row[measure] for row in rows], float
    )
    class_of_row = np.searchsorted(class_edges, class_values, side="right") * ~np.isnan(
        class_values
    )
    groups: dict[str, list[Mapping[str, object]]] = {}
    for class_index in np.unique(class_of_row).tolist():
        groups[class_names[class_index]] = [
            row
            for row, row_class in zip(rows, class_of_row, strict=True)
            if row_class == class_index
        ]
    return groups
