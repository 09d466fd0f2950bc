"""Questions about many positions at once; `PathFinder.many` answers them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.cells import check_positions
from navbake.runtime.grid_cache import GridCache
from navbake.runtime.paths.goals import Goal
from navbake.runtime.paths.path import Path
from navbake.runtime.paths.planner import Planner
from navbake.runtime.places.checks import check_distance
from navbake.runtime.places.navigable import MAX_DROP
from navbake.runtime.places.obstacle import overlap_height
from navbake.runtime.places.sight import NO_ROOMS
from navbake.runtime.places.step import within_reach
from navbake.types import Bool, Float, Int

# Functions import kernels when they run: numba takes long to load.


class ManyPlaces:
    """Asks of many positions what `PathFinder` asks of one; each answer is the same, bit for bit.

    Positions are world x, y, z [m], shape (..., 3), or (..., 2) as in `PathFinder`. With `level`,
    all of them are on that level. QueryError names the first position that has no answer.

    Args:
        cache: the grid, and what follows from it.
        planner: plans the paths.
    """

    def __init__(self, cache: GridCache, planner: Planner) -> None:
        self._cache = cache
        self._planner = planner

    def snap(
        self,
        positions: ArrayLike,
        *,
        level: int | None = None,
        same_level: bool = True,
        room: str | None = None,
        island: int | None = None,
        max_distance: float = math.inf,
    ) -> Float:
        """Find the nearest place where an agent can stand, of each position.

        The arguments are those of `PathFinder.snap`.

        Returns:
            World x, y and floor z [m], shape (..., 3), float64; NaN where there is no such place.
        """
        check_distance(max_distance)
        flat, allowed = self._cache.flat, self._cache.allowed(room=room, island=island)
        p = check_positions(positions, flat.num_levels, level)
        shape, p = p.shape[:-1], p.reshape(-1, p.shape[-1])
        is_flat, homes = p.shape[1] == 2, flat.cells_at(p, level)
        levels = np.where(homes >= 0, flat.level_of(homes), -1 if level is None else level)
        if is_flat:
            p = np.column_stack([p, np.full(len(p), flat.floors.ground[level or 0])])
        found = np.full((len(p), 3), np.nan)
        stands = (homes >= 0) & allowed[homes]
        floors = flat.positions(homes[stands])[:, 2]
        if level is None and not is_flat:
            is_near = p[stands, 2] - floors <= MAX_DROP
            stands[stands], floors = is_near, floors[is_near]
        found[stands, :2], found[stands, 2] = p[stands, :2], floors
        on_map = ~stands & (levels >= 0) & (same_level or is_flat)
        cells = np.full(len(p), -1, dtype=np.int64)
        cells[on_map] = self._nearest_on(p[on_map], levels[on_map], allowed, max_distance)
        in_space = ~stands & ~on_map
        cells[in_space] = self._nearest_in_space(p[in_space], allowed, max_distance)
        found[cells >= 0] = flat.positions(cells[cells >= 0])
        return found.reshape(*shape, 3)

    def clearance(
        self, positions: ArrayLike, *, level: int | None = None, max_distance: float = math.inf
    ) -> Float:
        """Find the distance to the nearest obstacle of each position, see `PathFinder.clearance`.

        Returns:
            Distances [m], shape (...), float64, at most `max_distance`.

        Raises:
            QueryError: a position is beside the grid.
        """
        from navbake.runtime.kernels.nearest import TO_OBSTACLE, Wanted

        check_distance(max_distance)
        flat = self._cache.flat
        p = check_positions(positions, flat.num_levels, level)
        shape, p = p.shape[:-1], p.reshape(-1, p.shape[-1])
        homes = flat.cells_at(p, level)
        if (homes < 0).any():
            first = ", ".join(f"{v:g}" for v in p[int(np.argmax(homes < 0))])
            raise QueryError(f"{first} lies beside the grid: no obstacles")
        overlap = overlap_height(flat, self._cache.grid.agent_height)
        wanted = Wanted(flat.layout, self._cache.occupied, flat.floors.z, TO_OBSTACLE, overlap)
        points = np.column_stack([p[:, :2], flat.positions(homes)[:, 2]])
        limits = np.full(len(p), float(max_distance))
        cells, distances = self._ask(wanted, flat.level_of(homes), points, limits)
        return np.where(cells < 0, max_distance, distances).reshape(shape)

    def try_step(
        self, starts: ArrayLike, ends: ArrayLike, *, slide: bool = True, level: int | None = None
    ) -> Float:
        """Move straight from each start towards its end, see `PathFinder.try_step`.

        Args:
            starts: where agents can stand.
            ends: one for each start, or one for all; z is ignored.
            slide: whether to slide along what is in the way.

        Returns:
            World x, y and floor z [m] of where each way ends, shape (..., 3), float64.

        Raises:
            QueryError: no agent can stand at a start, or starts and ends don't fit together.
        """
        from navbake.runtime.kernels.arrays import Space
        from navbake.runtime.kernels.many import step_each

        flat = self._cache.flat
        p = check_positions(starts, flat.num_levels, level)
        q = check_positions(ends, flat.num_levels, 0)[..., :2]
        shape = p.shape[:-1]
        if q.shape[:-1] not in (shape, ()):
            raise QueryError(f"expected an end for each start, {shape} of them, got {q.shape[:-1]}")
        p = p.reshape(-1, p.shape[-1])
        q = np.broadcast_to(q, (*shape, 2)).reshape(-1, 2)
        cells = flat.cells_at(p, level)
        is_free = (cells >= 0) & flat.free[cells]
        if not is_free.all():
            flat.free_cell_at(p[int(np.argmin(is_free))], level)  # says which one, and what to do
        points = np.ascontiguousarray(p[:, :2])
        space = Space(flat.layout, flat.links, flat.floors, flat.free)
        step_each(space, NO_ROOMS, cells, within_reach(points, q), slide, points)
        return np.column_stack([points, flat.positions(cells)[:, 2]]).reshape(*shape, 3)

    def find_path(
        self, starts: ArrayLike, goals: Goal, *, level: int | None = None, smooth: bool = True
    ) -> list[Path | None]:
        """Find the cheapest path from each start to its goal, see `PathFinder.find_path`.

        Args:
            starts: shape (n, 3).
            goals: a position for each start, shape (n, 3); or one for all: a position,
                ``room:NAME`` or ``object:NAME``.

        Returns:
            n paths; None where there is none.

        Raises:
            QueryError: starts and goals don't fit together; or as `PathFinder.find_path`.
        """
        num_levels = self._cache.flat.num_levels
        p = check_positions(starts, num_levels, level)
        if p.ndim != 2:
            raise QueryError(f"expected starts of shape (n, 3) [m], got {p.shape}")
        targets: list[Goal] = [goals] * len(p)
        if not isinstance(goals, str):
            q = check_positions(goals, num_levels, level)
            if q.ndim > 2 or (q.ndim == 2 and len(q) != len(p)):
                raise QueryError(
                    f"expected one goal, or goals of shape ({len(p)}, 3) as there are starts, got "
                    f"shape {q.shape}"
                )
            targets = list(np.broadcast_to(q, (len(p), q.shape[-1])))
        return [
            self._planner.find_path(start, goal, level, smooth=smooth)
            for start, goal in zip(p, targets, strict=True)
        ]

    def _nearest_on(self, p: Float, levels: Int, allowed: Bool, farthest: float) -> Int:
        """The allowed cells with the nearest centres on the map of each position's level."""
        from navbake.runtime.kernels.nearest import TO_CENTER, Wanted

        flat = self._cache.flat
        wanted = Wanted(flat.layout, allowed, flat.floors.z, TO_CENTER, 0.0)
        return self._ask(wanted, levels, p, np.full(len(p), float(farthest)))[0]

    def _nearest_in_space(self, p: Float, allowed: Bool, farthest: float) -> Int:
        """The allowed cells with the nearest centres in space, of the first level among equals."""
        from navbake.runtime.kernels.nearest import IN_SPACE, Wanted

        flat = self._cache.flat
        best, found = np.full(len(p), float(farthest)), np.full(len(p), -1, dtype=np.int64)
        for level in range(flat.num_levels):
            ground = flat.floors.ground[level]
            wanted = Wanted(flat.layout, allowed, flat.floors.z, IN_SPACE, ground)
            cells, distances = self._ask(wanted, np.full(len(p), level), p, best)
            nearer = (cells >= 0) & ((found < 0) | (distances < best))
            best, found = np.where(nearer, distances, best), np.where(nearer, cells, found)
        return found

    def _ask(self, wanted: object, levels: Int, p: Float, farthest: Float) -> tuple[Int, Float]:
        from navbake.runtime.kernels.many import nearest_each

        cells, distances = np.empty(len(p), dtype=np.int64), np.empty(len(p))
        nearest_each(wanted, levels, np.ascontiguousarray(p), farthest, cells, distances)
        return cells, distances
