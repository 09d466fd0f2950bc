"""Draws random places and poses from a grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.navgrid.cells import check_positions
from navbake.runtime.places.checks import check_distances, check_generator
from navbake.runtime.places.sample import cells_in_annulus, draw_positions
from navbake.types import Float, Int

if TYPE_CHECKING:
    from navbake.runtime.grid_cache import GridCache


class Pose(NamedTuple):
    """Where an agent stands and looks.

    Attributes:
        position: world x, y and floor z [m], shape (3,), float64.
        heading: 0 along x, counted towards y, -pi to pi [rad].
    """

    position: Float
    heading: float


class Sampler:
    """Finds the cells that `PathFinder` draws from, and draws."""

    def __init__(self, cache: GridCache) -> None:
        self._cache = cache

    def home_island(self, position: ArrayLike, level: int | None = None) -> int:
        """The island of a position where an agent can stand.

        Raises:
            QueryError: no agent can stand there.
        """
        cell = self._cache.flat.cell_at(position, level)
        island = 0 if cell is None else int(self._cache.islands.number[cell])
        if not island:
            where = ", ".join(f"{v:g}" for v in np.asarray(position, dtype=np.float64))
            raise QueryError(f"no agent can stand at {where}: snap it to the nearest place first")
        return island

    def pose(
        self,
        rng: np.random.Generator,
        target: ArrayLike | None,
        distances: tuple[float, float],
        *,
        in_sight: bool,
        same_room: bool,
        level: int | None,
    ) -> Pose:
        """`PathFinder.random_pose`."""
        check_generator(rng)
        if target is None:
            cells = np.flatnonzero(self._cache.allowed(level=level))
            place = self.draw(cells, rng, None, False, {"level": level})
            return Pose(place, float(rng.uniform(-math.pi, math.pi)))
        cells = self.cells_near(target, distances, True, level)
        flat, number, (low, high) = self._cache.flat, self._cache.rooms.number, distances
        p = check_positions(target, flat.num_levels, level)
        home = flat.cell_at(p, level)
        assert home is not None  # or there were no cells near it
        if same_room:
            cells = cells[(number[cells] == number[home]) & (number[home] > 0)]
        if in_sight:
            from navbake.runtime.kernels.nearest import first_in_sight  # saves numba at start-up

            # the first that sees the target, in a random order: as if drawn from all that do
            space = flat.sight_through(~self._cache.occupied)
            found = first_in_sight(space, number, home, p[0], p[1], rng.permutation(cells))
            cells = np.array([found] if found >= 0 else [], dtype=np.int64)
        limits = {"distance [m]": f"{low:g} to {high:g}", "in sight": in_sight}
        place = self.draw(cells, rng, None, False, limits)
        return Pose(place, math.atan2(p[1] - place[1], p[0] - place[0]))

    def cells_near(
        self,
        position: ArrayLike,
        distances: tuple[float, float],
        straight: bool,
        level: int | None,
    ) -> Int:
        """The free cells so far from a position, straight or by the shortest path: flat ids."""
        low, high = distances
        check_distances(low, high)
        flat = self._cache.flat
        p = check_positions(position, flat.num_levels, level)
        home = flat.cell_at(p, level)
        if home is None:
            where = ", ".join(f"{v:g}" for v in p)
            scene_id = self._cache.grid.scene_id
            raise QueryError(f"{where} is in no cell of {scene_id!r}: nothing is near")
        if straight:
            return cells_in_annulus(flat, int(flat.level_of(home)), p[:2], distances, flat.free)
        self.home_island(position, level)
        field = self._cache.search.field(np.array([home]), weighted=False)
        near = (field >= low) & (field <= high + 1e-9)
        return np.flatnonzero(near & np.isfinite(field))  # inf <= inf: not what no path leads to

    def draw(
        self,
        cells: Int,
        rng: np.random.Generator,
        count: int | None,
        anywhere: bool,
        limits: Mapping[str, object],
    ) -> Float:
        """Draw places in some cells; where there are none, `limits` tell what was asked for."""
        check_generator(rng)
        if count is not None and (not isinstance(count, int | np.integer) or count < 0):
            raise QueryError(f"expected a count >= 0, got {count!r}")
        if not len(cells):
            given = [f"{name} {v}" for name, v in limits.items() if v not in (None, False)]
            asked = f" with {', '.join(given)}" if given else ""
            raise QueryError(f"no free cell in {self._cache.grid.scene_id!r}{asked}")
        num = 1 if count is None else int(count)
        drawn = draw_positions(self._cache.flat, cells, rng, num, anywhere=anywhere)
        return drawn.reshape(3) if count is None else drawn
