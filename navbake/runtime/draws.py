"""Random places and poses."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.runtime.flat_grid import REAL, FlatGrid
from navbake.runtime.places import SLACK, PlaceQuestions, cells_in_annulus
from navbake.types import Float, Int

# Functions import kernels when they run: numba takes long to load.

INSIDE = 1e-6  # of a cell: how far from its edges a point stays


class Pose(NamedTuple):
    """Where an agent stands and looks.

    Attributes:
        position: world x, y and floor z [m], shape (3,), float64.
        heading: 0 along x, counted towards y, -pi to pi [rad].
    """

    position: Float
    heading: float


class DrawQuestions(PlaceQuestions):
    """Random places and poses."""

    def random_point(
        self,
        rng: np.random.Generator | None = None,
        count: int | None = None,
        *,
        level: int | None = None,
        room: str | None = None,
        island: int | None = None,
        reachable_from: ArrayLike | None = None,
        anywhere: bool = False,
    ) -> Float:
        """Draw places where an agent can stand, each as likely as its area has it.

        Args:
            rng: draws them; another one each time if None. One with a seed repeats itself.
            count: how many, with repetition; one unless given.
            level: on this level.
            room: in this room, by id or name.
            island: on this island; 1 is the largest. On all of them unless given.
            reachable_from: where a path leads to from this world position [m].
            anywhere: draw points all over the cells, so up to half a cell nearer to obstacles;
                else the cells' centres, where the agent's radius fits.

        Returns:
            World x, y and floor z [m], shape (3,) or (count, 3), float64.

        Raises:
            QueryError: there is no such place, no agent can stand at the position, or `rng` is
                not a generator.
        """
        if reachable_from is not None:
            island = self._cache.home_island(reachable_from, island)
        cells = np.flatnonzero(self._cache.allowed(level=level, room=room, island=island))
        limits = {"level": level, "room": room, "island": island}
        return self._draw(cells, rng, count, anywhere, limits)

    def random_point_near(
        self,
        rng: np.random.Generator | None,
        position: ArrayLike,
        max_distance: float,
        count: int | None = None,
        *,
        min_distance: float = 0.0,
        straight: bool = False,
        room: str | None = None,
        level: int | None = None,
        anywhere: bool = False,
    ) -> Float:
        """Draw places near a position.

        Distances are those of the shortest path from it; or straight on the map of its level,
        through walls as well. They are measured to the cells' centres.

        Args:
            rng: see `random_point`.
            position: world position [m]; with paths, one where an agent can stand.
            max_distance: [m].
            count: how many, with repetition; one unless given.
            min_distance: [m]; the places are in an annulus then.
            straight: measure straight.
            room: only in this room, by id or name.
            anywhere: see `random_point`.

        Returns:
            World x, y and floor z [m], shape (3,) or (count, 3), float64.

        Raises:
            QueryError: as `random_point`; or the distances are not 0 <= minimum <= maximum.
        """
        distances = (min_distance, max_distance)
        cells = self._cells_near(position, distances, straight, level)
        if room is not None:
            cells = cells[self.rooms.number[cells] == self.rooms.find(room)]
        limits = {"room": room, "distance [m]": f"{min_distance:g} to {max_distance:g}"}
        return self._draw(cells, rng, count, anywhere, limits)

    def any_free_in_annulus(
        self,
        position: ArrayLike,
        min_distance: float,
        max_distance: float,
        *,
        level: int | None = None,
    ) -> bool:
        """Whether a free cell's centre is so far from a position, on the map of its level [m]."""
        distances = (min_distance, max_distance)
        return len(self._cells_near(position, distances, True, level)) > 0

    def random_pose(
        self,
        rng: np.random.Generator | None = None,
        target: ArrayLike | None = None,
        max_distance: float = 1.0,
        *,
        min_distance: float = 0.0,
        in_sight: bool = True,
        same_room: bool = False,
        level: int | None = None,
    ) -> Pose:
        """Draw where an agent stands and looks: at a target, if there is one.

        Args:
            rng: see `random_point`.
            target: world position [m], which may be in something; the agent stands on its level.
            max_distance, min_distance: from the target, straight on the map [m].
            in_sight: nothing stands between, but for what the target is in, as with `snap`.
            same_room: stand in the target's room.
            level: which level the target is on; without one, where to stand.

        Raises:
            QueryError: see `random_point_near`.
        """
        from navbake.runtime.kernels.walks import first_in_sight

        rng, cache = as_generator(rng), self._cache
        if target is None:
            cells = np.flatnonzero(cache.allowed(level=level))
            place = self._draw(cells, rng, None, False, {"level": level})
            return Pose(place, float(rng.uniform(-math.pi, math.pi)))
        cells = self._cells_near(target, (min_distance, max_distance), True, level)
        flat, number = cache.flat, self.rooms.number
        p, home = flat.locate(target, level)
        assert home is not None  # or there were no cells near it
        if same_room:
            cells = cells[(number[cells] == number[home]) & (number[home] > 0)]
        if in_sight:
            # the first that sees the target, in a random order: as if drawn from all that do
            space, cells = flat.sight_through(~self.occupied), rng.permutation(cells)
            points = np.ascontiguousarray(flat.positions(cells)[:, :2])
            found = first_in_sight(space, number, home, p, cells, points)
            cells = cells[found : found + 1] if found >= 0 else cells[:0]
        limits = {"distance [m]": f"{min_distance:g} to {max_distance:g}", "in sight": in_sight}
        place = self._draw(cells, rng, None, False, limits)
        return Pose(place, math.atan2(p[1] - place[1], p[0] - place[0]))

    def _draw(
        self,
        cells: Int,
        rng: np.random.Generator | None,
        count: int | None,
        anywhere: bool,
        limits: Mapping[str, object],
    ) -> Float:
        """Draw places in some cells; `limits` say which, for the message where there are none."""
        rng = as_generator(rng)
        if count is not None and (not isinstance(count, int | np.integer) or count < 0):
            raise QueryError(f"expected a count >= 0, got {count!r}")
        if not len(cells):
            given = [f"{name} {v}" for name, v in limits.items() if v not in (None, False)]
            asked = f" with {', '.join(given)}" if given else ""
            raise QueryError(f"no free cell in {self.grid.scene_id!r}{asked}")
        flat, num = self._cache.flat, 1 if count is None else int(count)
        chosen = cells[draw_cells(flat, cells, rng, num)]
        positions = flat.positions(chosen)
        if anywhere:
            size = flat.layout.cell_size[flat.level_of(chosen)]
            half = 0.5 - INSIDE
            positions[:, :2] += rng.uniform(-half, half, size=(num, 2)) * size[:, None]
        return positions.reshape(3) if count is None else positions

    def _cells_near(
        self,
        position: ArrayLike,
        distances: tuple[float, float],
        straight: bool,
        level: int | None,
    ) -> Int:
        """The free cells so far from a position, straight or by the shortest path: flat ids."""
        low, high = distances
        if not (isinstance(low, REAL) and isinstance(high, REAL) and 0 <= low <= high):
            raise QueryError(
                f"expected 0 <= min_distance <= max_distance [m], got {low} and {high}"
            )
        flat = self._cache.flat
        p, home = flat.locate(position, level)
        if home is None:
            where = ", ".join(f"{v:g}" for v in p)
            raise QueryError(f"{where} is in no cell of {self.grid.scene_id!r}: nothing is near")
        if straight:
            return cells_in_annulus(flat, int(flat.level_of(home)), p, distances, flat.free)
        flat.free_cell_at(p, level)
        field = self._cache.search.field(np.array([home]), weighted=False)
        near = (field >= low) & (field <= high + SLACK)
        return np.flatnonzero(near & np.isfinite(field))  # inf <= inf: not what no path leads to


def as_generator(rng: object) -> np.random.Generator:
    """The generator given, or a new one for None; raises QueryError for anything else."""
    if rng is None:
        return np.random.default_rng()
    if isinstance(rng, np.random.Generator):
        return rng
    raise QueryError(
        f"expected a numpy.random.Generator, or None, got {rng!r}: make one with "
        "numpy.random.default_rng"
    )


def draw_cells(flat: FlatGrid, cells: Int, rng: np.random.Generator, count: int) -> Int:
    """Draw indices into some cells, each cell as likely as its area has it."""
    sizes = flat.layout.cell_size
    if len(set(sizes)) == 1:
        return rng.integers(len(cells), size=count)
    # cells of different areas: a point on their areas in a row falls into one of them
    edges = np.cumsum(sizes[flat.level_of(cells)] ** 2)
    found = np.searchsorted(edges, rng.uniform(0.0, edges[-1], size=count), side="right")
    return np.minimum(found, len(cells) - 1)
