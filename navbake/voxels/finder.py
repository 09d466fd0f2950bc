"""Plans flights through voxels: where a ball fits, what it sees, and its shortest path."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias, overload

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.generators import as_generator
from navbake.known_names import check_choice
from navbake.lazy import lazy, resolve
from navbake.lengths import format_position
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32
from navbake.voxels.distances import DistanceField
from navbake.voxels.grid import VoxelGrid
from navbake.voxels.positions import check_xyz

if TYPE_CHECKING:
    from navbake.voxels.flight_kernels import Air, Moves

flight_kernels = lazy("navbake.voxels.flight_kernels")  # numba loads slowly

UNKNOWN_SPACE = ("occupied", "free")  # what voxels count as whose occupancy is unknown
OnePosition: TypeAlias = Sequence[float]
"""x, y, z of one position, as a tuple or a list."""

ManyPositions: TypeAlias = Sequence[Sequence[float]]
"""x, y, z of several positions, as a list of tuples."""

STEPS = np.array([step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)])
AROUND = np.array([*itertools.product((-1, 0, 1), repeat=3)])  # a voxel and its 26 neighbours
LEAST_PAIRS = 64  # fewest lines that are worth a thread
MAX_DRAWS = 100  # rounds of random points in free voxels, before their centres are taken
WIDTH_STEPS = 8  # halvings of the radius in the search for a ball that gets through


class Ends(NamedTuple):
    """The free voxels that positions are joined to, and what that costs.

    Attributes:
        voxels: indices of free voxels whose centres the positions see, shape (n, 3), int64.
        costs: cost of the straight lines, shape (n,) [m].
        positions: the position that each voxel is joined to, shape (n, 3) [m].
        rows: the row of that position among all, shape (n,), int64.
    """

    voxels: Int
    costs: Float
    positions: Float
    rows: Int


@dataclass(frozen=True, eq=False, repr=False)
class FlightPath:
    """A path of a ball through voxels.

    Attributes:
        positions: World x, y, z of the ball's centre [m], shape (n, 3), n >= 1. Straight in
            between; the ball meets no occupied voxel on its way.
        voxels: Indices (i, j, k) of the voxels of the route, shape (m, 3), int64. The path may
            leave these voxels where that is shorter and costs no more.
        length: Length of the path [m].
        cost: Cost of the route [m], see `VoxelFinder`; the path costs no more, and mostly less.
        radius: Radius of the ball [m].

    Example:
        >>> path = finder.find_path((0.0, -4.0, 1.5), (2.0, 3.0, 4.2))
        >>> path.length, path.positions
    """

    positions: Float
    voxels: Int
    length: float
    cost: float
    radius: float

    def __repr__(self) -> str:
        count = len(self.positions)
        return f"FlightPath({self.length:.2f} m, cost {self.cost:.2f}, {count} points)"

    def at(self, distance: ArrayLike) -> Float:
        """Compute positions at distances along the path.

        Args:
            distance: Distance from the start along the path [m], shape (...); less than 0 stands
                for the start, more than `length` for the end.

        Returns:
            World x, y, z [m], shape (..., 3).
        """
        lengths = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        point_distances = np.append(0.0, np.cumsum(lengths))
        distances = np.asarray(distance, dtype=np.float64)
        coordinates = [np.interp(distances, point_distances, axis) for axis in self.positions.T]
        return np.stack(coordinates, axis=-1)

    def save(self, path: str | os.PathLike[str], *, voxels: VoxelGrid | None = None) -> None:
        """Write the path as JSON, or as MCAP, in which Foxglove shows it as ``nav_msgs/Path``.

        A JSON file holds ``positions``, ``length``, ``cost`` and ``radius``.

        Args:
            path: Name of the file, which ends in ``.json`` or ``.mcap``.
            voxels: Voxels that an MCAP file shows beside the path, too; None for none.

        Raises:
            FormatError: The name has another ending, or the file cannot be written.
            MissingDependencyError: The extra ``navbake[mcap]`` is missing.
        """
        # the formats import this folder
        resolve("navbake.formats.flights:write_flight")(self, path, voxels)


class VoxelFinder:
    """Plans flights of a ball through voxels, and answers queries about places in the air.

    The ball fits where no point of an occupied voxel is nearer to its centre than `radius`, and
    where it is wholly in the grid: what lies outside is unknown. A route leads from voxel to voxel,
    over faces, edges and corners (26 neighbours), through voxels at whose centre the ball fits, and
    the ball meets no occupied voxel between two centres. A step costs its length times the mean of
    the costs of a metre at both ends. At a distance d [m] from the nearest occupied voxel, a metre
    costs ``1 + cost_of_clearance / d``.

    In all methods, a position is world x, y, z of the ball's centre [m], shape (3,), or (n, 3) for
    several.

    Attributes:
        voxels: The grid.
        radius: Radius of the ball [m].
        min_height: Least world z of the ball's centre [m]; None for any.
        max_height: Greatest world z of the ball's centre [m]; None for any.
        cost_of_clearance: What a metre costs more at 1 m from the nearest occupied voxel [m].
        unknown: What voxels count as whose occupancy is unknown: ``occupied`` or ``free``.
        distances: Distance of each voxel from what is occupied, see `VoxelGrid.distances`.

    Args:
        voxels: The voxels. Later writes into them have no effect.
        radius: Radius of the ball [m], > 0: of the robot with all that sticks out.
        min_height: Least world z of the ball's centre [m]; None for any.
        max_height: Greatest world z of the ball's centre [m]; None for any.
        cost_of_clearance: What a metre costs more at 1 m from the nearest occupied voxel [m], >= 0.
            0 for the shortest paths; the larger, the more paths keep away from things.
        unknown: Whether voxels whose occupancy is unknown count as ``occupied`` or as ``free``.

    Raises:
        QueryError: A number is out of range, or `voxels` is no `VoxelGrid`.

    Example:
        >>> import navbake
        >>> voxels = navbake.create_voxel_grid(navbake.samples.path("house"), res=0.1)
        >>> finder = navbake.VoxelFinder(voxels, radius=0.25)
        >>> path = finder.find_path((0.0, -4.0, 1.5), (-3.0, 3.0, 4.2))
    """

    def __init__(
        self,
        voxels: VoxelGrid,
        radius: float,
        min_height: float | None = None,
        max_height: float | None = None,
        cost_of_clearance: float = 0.0,
        *,
        unknown: Literal["occupied", "free"] = "occupied",
    ) -> None:
        check_choice(unknown, UNKNOWN_SPACE, "unknown", QueryError)
        _check_voxels(voxels)
        self.radius = _check_number("radius", radius, "> 0 m", positive=True)
        self.cost_of_clearance = _check_number(
            "cost_of_clearance", cost_of_clearance, ">= 0 m", positive=False
        )
        if min_height is not None:
            min_height = _check_number("min_height", min_height, "as a height [m]")
        if max_height is not None:
            max_height = _check_number("max_height", max_height, "as a height [m]")
        self.min_height = min_height
        self.max_height = max_height
        self.unknown = unknown
        self._moves = _list_moves(self.radius, voxels.res)
        self.use(voxels)

    def use(self, voxels: VoxelGrid) -> None:
        """Switch to other voxels of the same size, for example after something moved.

        Args:
            voxels: The voxels, at any place. Later writes into them have no effect.

        Raises:
            QueryError: Their edge is another one, or they are no `VoxelGrid`.
        """
        _check_voxels(voxels)
        move_length = float(self._moves.lengths.min())
        if not math.isclose(voxels.res, move_length):
            expected = f"voxels of {move_length:g} m"
            raise QueryError(
                f"expected {expected}, got {voxels.res:g} m", key="res", value=voxels.res
            )
        self.voxels = voxels
        self.distances: DistanceField = voxels.distances(
            unknown_occupied=self.unknown == "occupied"
        )
        self._air = self._make_air()
        self._islands: AirIslands | None = None

    def _make_air(self) -> Air:
        """Mark where the ball fits, for the kernels."""
        lower, upper = self.voxels.bounds
        lower = lower + self.radius
        upper = upper - self.radius
        if self.min_height is not None:
            lower[2] = max(lower[2], self.min_height)
        if self.max_height is not None:
            upper[2] = min(upper[2], self.max_height)
        distances = self.distances.values
        greatest_distance = float(distances.max())
        least_weight = 1.0
        if greatest_distance > 0.0:
            least_weight += self.cost_of_clearance / greatest_distance
        air: Air = flight_kernels.Air(
            distances=distances,
            state=np.zeros(distances.shape, dtype=np.uint32),
            origin=np.array(self.voxels.origin),
            res=self.voxels.res,
            radius=self.radius,
            lower=lower,
            upper=upper,
            cost_of_clearance=self.cost_of_clearance,
            least_weight=least_weight,
        )
        run_in_chunks(flight_kernels.mark_free_voxels, len(distances), air)
        run_in_chunks(flight_kernels.mark_moves, len(distances), air, self._moves)
        return air

    def __repr__(self) -> str:
        volume = float(self.islands.volumes.sum())
        return (
            f"VoxelFinder(radius {self.radius:g} m, {volume:.1f} m³ free, "
            f"islands: {self.islands.count})"
        )

    # ---------------------------------------------------------------- places

    @property
    def free(self) -> Bool:
        """Mask of the voxels at whose centre the ball fits, shape (nx, ny, nz), bool."""
        mask: Bool = (self._air.state & flight_kernels.FREE) != 0
        return mask

    @property
    def islands(self) -> AirIslands:
        """The connected parts of the free voxels: ``count``, ``labels``, ``volumes`` [m³]."""
        if self._islands is not None:
            return self._islands
        labels = np.zeros(self.voxels.shape, dtype=np.int32)
        count = flight_kernels.label_islands(self._air, self._moves, labels)
        sizes: Int = np.bincount(labels.ravel(), minlength=count + 1)[1:]
        volumes = np.sort(sizes)[::-1].astype(np.float64) * self.voxels.res**3
        order = np.argsort(-sizes, kind="stable")
        number_of_label = np.zeros(count + 1, dtype=np.int32)
        number_of_label[1 + order] = np.arange(1, count + 1)
        self._islands = AirIslands(
            labels=number_of_label[labels],
            volumes=volumes,
        )
        return self._islands

    def island_at(self, position: ArrayLike) -> int | None:
        """Return the number of the island that a position is joined to; None if there is none.

        Args:
            position: World x, y, z [m], shape (3,).

        Returns:
            The number of the largest island of which the ball sees a voxel's centre nearby; 1 is
            the largest.

        Raises:
            QueryError: The position is not three finite numbers.
        """
        ends = self._join(_check_one(position))
        if not len(ends.voxels):
            return None
        return int(self.islands.labels[tuple(ends.voxels.T)].min())

    @overload
    def is_free(self, position: OnePosition) -> bool: ...
    @overload
    def is_free(self, position: ManyPositions) -> Bool: ...
    @overload
    def is_free(self, position: ArrayLike) -> bool | Bool: ...
    def is_free(self, position: ArrayLike) -> bool | Bool:
        """Return whether the ball fits at positions: in the grid, and in no occupied voxel.

        Args:
            position: World x, y, z of the ball's centre [m], shape (3,) or (..., 3).

        Returns:
            A bool; for several positions a mask of shape (...).

        Raises:
            QueryError: A position is not three finite numbers.
        """
        return self.sees(position, position)

    @overload
    def sees(self, start: OnePosition, goal: OnePosition) -> bool: ...
    @overload
    def sees(self, start: ArrayLike, goal: ArrayLike) -> bool | Bool: ...
    def sees(self, start: ArrayLike, goal: ArrayLike) -> bool | Bool:
        """Return whether the ball can fly straight from one position to another.

        This is exact: on its way, the ball meets no occupied voxel, and stays in the grid and
        between the heights.

        Args:
            start: World x, y, z [m], shape (3,) or (..., 3).
            goal: World x, y, z [m], shape (3,) or (..., 3).

        Returns:
            A bool; for several lines a mask of shape (...).

        Raises:
            QueryError: A position is not three finite numbers.
        """
        starts = check_xyz(start, "start")
        goals = check_xyz(goal, "goal")
        shape = np.broadcast_shapes(starts.shape, goals.shape)
        begins = np.broadcast_to(starts, shape).reshape(-1, 3).copy()
        ends = np.broadcast_to(goals, shape).reshape(-1, 3).copy()
        is_clear = np.zeros(len(begins), dtype=np.bool_)
        run_in_chunks(
            flight_kernels.sees,
            len(begins),
            self._air,
            begins,
            ends,
            is_clear,
            min_chunk_size=LEAST_PAIRS,
        )
        return bool(is_clear[0]) if len(shape) == 1 else is_clear.reshape(shape[:-1])

    @overload
    def snap(
        self,
        position: ManyPositions,
        *,
        island: int | None = None,
        max_distance: float = math.inf,
    ) -> Float: ...
    @overload
    def snap(
        self, position: ArrayLike, *, island: int | None = None, max_distance: float = math.inf
    ) -> Float | None: ...
    def snap(
        self, position: ArrayLike, *, island: int | None = None, max_distance: float = math.inf
    ) -> Float | None:
        """Find the nearest place where the ball fits, for one position or each of many.

        That is the position itself if the ball fits there; else, or if an island is asked for, the
        centre of the nearest free voxel.

        Args:
            position: World x, y, z [m], shape (3,) or (..., 3); it may lie outside the grid.
            island: Take a voxel of this island only; 1 is the largest.
            max_distance: The largest distance of the place [m], >= 0.

        Returns:
            World x, y, z [m], shape (3,), None for no such place; for many positions shape
            (..., 3), a row of NaN for no such place.

        Raises:
            QueryError: A position is not three finite numbers, or there is no such island.
        """
        positions = check_xyz(position, "position")
        points = positions.reshape(-1, 3).copy()
        places = np.full(points.shape, np.nan)
        if island is not None:
            self._check_island(island)
        labels = np.zeros((1, 1, 1), dtype=np.int32) if island is None else self.islands.labels
        run_in_chunks(
            flight_kernels.snap,
            len(points),
            self._air,
            labels,
            island or 0,
            points,
            float(max_distance),
            places,
            min_chunk_size=LEAST_PAIRS,
        )
        if island is None:
            is_clear = np.atleast_1d(self.sees(points, points))
            places[is_clear] = points[is_clear]
        if positions.ndim > 1:
            return places.reshape(positions.shape)
        return None if np.isnan(places[0, 0]) else places[0]

    def random_point(
        self,
        rng: Generator | None = None,
        count: int | None = None,
        *,
        island: int | None = None,
    ) -> Float:
        """Draw places where the ball fits, uniformly by volume, in voxels that are free.

        Args:
            rng: A numpy Generator; None makes a new one.
            count: How many places; None for one place.
            island: Draw places on this island only; 1 is the largest.

        Returns:
            World x, y, z [m], float64: shape (3,), or (count, 3).

        Raises:
            QueryError: There is no such place or island, or `rng` is no Generator.

        Example:
            >>> rng = np.random.default_rng(0)
            >>> start, goal = finder.random_point(rng, 2, island=1)
        """
        generator = as_generator(rng)
        if island is not None:
            self._check_island(island)
        mask = self.free if island is None else self.islands.labels == island
        free_voxels = np.flatnonzero(mask)
        if not len(free_voxels):
            raise QueryError(self._say_nothing_is_free())
        num_points = 1 if count is None else count
        points = np.empty((0, 3))
        for draw in range(MAX_DRAWS):
            drawn = generator.choice(free_voxels, num_points)
            voxels = np.stack(np.unravel_index(drawn, mask.shape), axis=-1)
            is_last_draw = draw == MAX_DRAWS - 1
            # only the centre is sure to be free: where the ball just fits, nothing else may be
            offsets = generator.random(voxels.shape) - 0.5
            if is_last_draw:
                offsets[:] = 0.0
            candidates = self._to_world(voxels + offsets)
            points = np.concatenate([points, candidates[self.sees(candidates, candidates)]])
            if len(points) >= num_points:
                break
        return points[0] if count is None else points[:num_points]

    # ---------------------------------------------------------------- paths

    def find_path(self, start: ArrayLike, goal: ArrayLike) -> FlightPath | None:
        """Find the cheapest path.

        Start and goal are joined by straight lines to the centres of the voxels around them that
        they see; the route between is the cheapest there is. Then the path is shortened: it is the
        cheapest line through some of the route's points that the ball can fly without meeting an
        occupied voxel, exactly.

        Args:
            start: World x, y, z [m], shape (3,).
            goal: World x, y, z [m], shape (3,), or (n, 3) for several: the cheapest to reach
                counts.

        Returns:
            The path; None if there is none, for the reason that `why_not` returns.

        Raises:
            QueryError: A position is not three finite numbers.

        Example:
            >>> path = finder.find_path((0.0, -4.0, 1.5), (2.0, 3.0, 4.2))
            >>> if path is not None:
            ...     print(path.length, path.positions)
        """
        start_ends = self._join(_check_one(start))
        goal_ends = self._join(_check_goals(goal))
        if not len(start_ends.voxels) or not len(goal_ends.voxels):
            return None
        cost, route = flight_kernels.find_flight(
            self._air,
            self._moves,
            start_ends.voxels,
            start_ends.costs,
            goal_ends.voxels,
            goal_ends.costs,
            np.full(self.voxels.shape, np.inf),
            np.full(self.voxels.shape, flight_kernels.NOT_REACHED, dtype=np.int8),
        )
        if not len(route):
            return None
        # of the goals that the last voxel is joined to, the cheapest
        is_last = (goal_ends.voxels == route[-1]).all(axis=1)
        end = goal_ends.positions[np.argmin(np.where(is_last, goal_ends.costs, np.inf))]
        points = np.concatenate([start_ends.positions[:1], self._to_world(route), end[None]])
        positions = points[flight_kernels.shorten(self._air, points)]
        length = float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())
        return FlightPath(positions, route, length, float(cost), self.radius)

    def distance_field(self, goal: ArrayLike) -> Float:
        """Compute the cost of the cheapest route from every voxel's centre to a goal.

        Args:
            goal: World x, y, z [m], shape (3,), or (n, 3) for several: the cheapest to reach
                counts.

        Returns:
            Costs [m], shape (nx, ny, nz), float64; inf where no route leads to the goal. Of other
            places than centres, see `costs_at`.

        Raises:
            QueryError: A position is not three finite numbers.
        """
        ends = self._join(_check_goals(goal))
        costs = np.full(self.voxels.shape, np.inf)
        flight_kernels.find_flight(
            self._air,
            self._moves,
            ends.voxels,
            ends.costs,
            np.empty((0, 3), dtype=np.int64),
            np.empty(0),
            costs,
            np.full(self.voxels.shape, flight_kernels.NOT_REACHED, dtype=np.int8),
        )
        return costs

    def costs_at(self, field: ArrayLike, position: ArrayLike) -> Float:
        """Compute the cost of the cheapest route from positions, by a field of costs.

        A position is joined to the centres of the voxels around it that it sees, as in
        `find_path`.

        Args:
            field: What `distance_field` returned [m], shape (nx, ny, nz).
            position: World x, y, z [m], shape (3,) or (..., 3).

        Returns:
            The costs that `find_path` finds from there to the field's goal [m], shape (...); inf
            where there is no path.

        Raises:
            QueryError: A position is not three finite numbers, or the field is of other voxels.

        Example:
            >>> field = finder.distance_field((2.0, 3.0, 4.2))
            >>> finder.costs_at(field, [(0.0, -4.0, 1.5), (0.0, -3.5, 1.5)])
        """
        positions = check_xyz(position, "position")
        voxel_costs = np.asarray(field)
        if voxel_costs.shape != self.voxels.shape:
            expected = f"a field of shape {self.voxels.shape}"
            message = f"expected {expected}, got {voxel_costs.shape}"
            raise QueryError(message, key="field", value=voxel_costs.shape, expected=expected)
        points = positions.reshape(-1, 3)
        ends = self._join(points)
        costs = np.full(len(points), np.inf)
        route_costs = ends.costs + voxel_costs[tuple(ends.voxels.T)]
        np.minimum.at(costs, ends.rows, route_costs)
        return costs.reshape(positions.shape[:-1])

    def why_not(self, start: ArrayLike, goal: ArrayLike) -> str | None:
        """Say in one sentence why there is no path.

        Args:
            start: World x, y, z [m], shape (3,).
            goal: World x, y, z [m], shape (3,), or (n, 3) for several.

        Returns:
            The sentence; None if there is a path. It says where the ball does not fit and by how
            much; or that nothing connects start and goal, and which smaller ball would get through.

        Raises:
            QueryError: A position is not three finite numbers.
        """
        start_position = _check_one(start)
        goals = _check_goals(goal)
        if not self.free.any():
            return self._say_nothing_is_free()
        start_ends = self._join(start_position)
        goal_ends = self._join(goals)
        if not len(start_ends.voxels):
            return self._say_why_it_does_not_fit("start", start_position[0])
        if not len(goal_ends.voxels):
            return self._say_why_it_does_not_fit("goal", goals[0])
        labels = self.islands.labels
        start_islands = set(labels[tuple(start_ends.voxels.T)].tolist())
        goal_islands = set(labels[tuple(goal_ends.voxels.T)].tolist())
        if start_islands & goal_islands:
            return None
        volumes = self.islands.volumes
        start_island = min(start_islands)
        goal_island = min(goal_islands)
        sentence = (
            f"no way for a radius of {self.radius:g} m from island {start_island} "
            f"({volumes[start_island - 1]:.1f} m³) to island {goal_island} "
            f"({volumes[goal_island - 1]:.1f} m³)"
        )
        least_radius = self.voxels.res / 2.0
        if self.radius <= least_radius:
            return sentence
        widest = self._find_smaller_radius(start_position, goals)
        if widest is None:
            return f"{sentence}; not even a ball of {least_radius:g} m gets through"
        return f"{sentence}; a ball of {widest:.3g} m gets through"

    def _find_smaller_radius(self, start: Float, goals: Float) -> float | None:
        """Find about the largest smaller radius with a path; None if half a voxel is too large."""
        passing = None
        blocked = self.radius
        radius = self.voxels.res / 2.0
        for _ in range(WIDTH_STEPS):
            if radius >= blocked:
                break
            smaller = VoxelFinder(
                self.voxels, radius, self.min_height, self.max_height, unknown=self.unknown
            )
            if smaller.find_path(start[0], goals) is None:
                if passing is None:
                    return None
                blocked = radius
            else:
                passing = radius
            radius = (passing + blocked) / 2.0
        return passing

    def _say_nothing_is_free(self) -> str:
        """Say that the ball fits nowhere, and what may help."""
        sentence = f"a ball of {self.radius:g} m fits nowhere in the grid"
        if self.min_height is not None or self.max_height is not None:
            sentence += " between the heights"
        is_known = self.voxels.known
        if is_known is not None and not is_known.all() and self.unknown == "occupied":
            share = 1.0 - float(np.mean(is_known))
            sentence += (
                f"; {share:.0%} of the voxels are unknown: `--unknown free` (unknown='free') takes "
                "them for free"
            )
        return sentence

    def _say_why_it_does_not_fit(self, noun: str, position: Float) -> str:
        """Say why the ball does not fit at a start or goal, and where it fits next."""
        place = f"the {noun} ({format_position(position)})"
        air = self._air
        if (position < air.lower).any() or (position > air.upper).any():
            lower = format_position(air.lower)
            upper = format_position(air.upper)
            reason = f"{place} is outside of where the ball fits: from ({lower}) to ({upper})"
        else:
            clearances = np.empty(1)
            flight_kernels.measure_clearances(air, position[None], self.radius, clearances, 0, 1)
            reason = (
                f"{place} is {clearances[0]:.3g} m from the nearest occupied voxel, "
                f"nearer than the radius of {self.radius:g} m"
            )
            if self.is_free(position):
                reason = f"from {place} the ball gets to no voxel's centre: use smaller voxels"
        nearest = self.snap(position, island=1)
        if nearest is None:
            return reason
        return f"{reason}; the nearest free place is ({format_position(nearest)})"

    def _join(self, positions: Float) -> Ends:
        """Join positions to the centres of the voxels around them that they see.

        Args:
            positions: World x, y, z [m], shape (n, 3).
        """
        own_voxels = self.voxels.indices(positions)
        voxels = (own_voxels[:, None] + AROUND).reshape(-1, 3)
        rows = np.repeat(np.arange(len(positions)), len(AROUND))
        is_inside = ((voxels >= 0) & (voxels < self.voxels.shape)).all(axis=1)
        is_in_grid = ((own_voxels >= 0) & (own_voxels < self.voxels.shape)).all(axis=1)
        is_inside &= np.repeat(is_in_grid, len(AROUND))
        voxels = voxels[is_inside]
        rows = rows[is_inside]
        ends = positions[rows]
        centers = self._to_world(voxels)
        is_clear = (self._air.state[tuple(voxels.T)] & flight_kernels.FREE) != 0
        is_clear &= np.atleast_1d(self.sees(centers, ends))
        voxels = voxels[is_clear]
        ends = ends[is_clear]
        rows = rows[is_clear]
        lengths = np.linalg.norm(centers[is_clear] - ends, axis=1)
        if self.cost_of_clearance:
            values = self.distances.values
            own_distances = values[tuple(self.voxels.indices(ends).T)]
            inverse = (1.0 / own_distances + 1.0 / values[tuple(voxels.T)]) / 2.0
            lengths *= 1.0 + self.cost_of_clearance * inverse
        return Ends(voxels, lengths, ends, rows)

    def _to_world(self, voxels: Int | Float) -> Float:
        """Return world x, y, z of places in voxels, of which whole numbers are the centres [m]."""
        centers: Float = (voxels + 0.5) * self.voxels.res + np.array(self.voxels.origin)
        return centers

    def _check_island(self, island: int) -> None:
        """Raise a QueryError if there is no island of this number."""
        count = self.islands.count
        if not 1 <= island <= count:
            expected = f"an island from 1 to {count}" if count else "no island: there is none"
            raise QueryError(
                f"expected {expected}, got {island}", key="island", value=island, expected=expected
            )


@dataclass(frozen=True, eq=False)
class AirIslands:
    """The connected parts of the free voxels, the largest first.

    Attributes:
        labels: Number of each voxel's island, shape (nx, ny, nz), int32: 1 for the largest, 0 where
            the ball does not fit.
        volumes: Volume of the voxels of each island [m³], shape (count,).
    """

    labels: Int32
    volumes: Float

    @property
    def count(self) -> int:
        """Number of islands."""
        return len(self.volumes)


def _check_voxels(voxels: object) -> None:
    """Raise a QueryError for what is no grid of voxels, such as a navigation grid."""
    if not isinstance(voxels, VoxelGrid):
        expected = "voxels, as `navbake.create_voxel_grid` makes them"
        raise QueryError(
            f"expected {expected}, got a {type(voxels).__name__}",
            key="voxels",
            value=voxels,
            expected=expected,
        )


def _list_moves(radius: float, res: float) -> Moves:
    """List the moves to the 26 neighbours, with what the ball may meet between them."""
    lists = [flight_kernels.list_between(step, radius, res) for step in STEPS.astype(np.float64)]
    start = np.append(0, np.cumsum([len(between) for between in lists]))
    moves: Moves = flight_kernels.Moves(
        steps=STEPS,
        lengths=np.linalg.norm(STEPS, axis=1) * res,
        start=start,
        between=np.concatenate(lists),
    )
    return moves


def _check_number(key: str, value: object, expected: str, *, positive: bool | None = None) -> float:
    """Return a number, if it is finite and, for `positive` True or False, > 0 or >= 0.

    Raises:
        QueryError: It is not.
    """
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    is_valid = math.isfinite(number)
    if positive is not None:
        is_valid = is_valid and (number > 0.0 if positive else number >= 0.0)
    if not is_valid:
        message = f"expected `{key}` {expected}, got {value!r}"
        raise QueryError(message, key=key, value=value, expected=expected)
    return number


def _check_one(start: ArrayLike) -> Float:
    """Return a start as an array of shape (1, 3); raise a QueryError if it is not one position."""
    position = check_xyz(start, "start")
    if position.ndim != 1:
        expected = "one start of shape (3,)"
        message = f"expected {expected}, got {position.shape}"
        raise QueryError(message, key="start", value=start, expected=expected)
    return position[None]


def _check_goals(goal: ArrayLike) -> Float:
    """Return goals as an array of shape (n, 3); raise a QueryError if there are none."""
    positions = np.atleast_2d(check_xyz(goal, "goal"))
    if positions.ndim != 2 or not len(positions):
        expected = "positions of shape (3,) or (n, 3), n >= 1"
        message = f"expected {expected}, got {positions.shape}"
        raise QueryError(message, key="goal", value=goal, expected=expected)
    return positions
