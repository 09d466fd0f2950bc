"""Draws random places and poses from a grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import check_positions
from navbake.runtime.place_finder import PlaceFinder
from navbake.runtime.places.locate import flat_cell, links_of, place_of
from navbake.runtime.places.sample import (
    cells_in_annulus,
    check_distances,
    check_generator,
    draw_positions,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Pose(NamedTuple):
    """Where an agent stands and looks.

    Attributes:
        position: world x, y and floor z [m], shape (3,), float64.
        heading: 0 along x, counted towards y, -pi to pi [rad].
    """

    position: Floats
    heading: float


class PlaceSampler(PlaceFinder):
    """Draws places where an agent can stand, all as likely as their areas have it.

    Places are centres of cells, where the agent's radius fits; with `anywhere`, points all over
    the cells, so up to half a cell nearer to obstacles. Where there is no place to draw,
    QueryError tells so.
    """

    def random_point(
        self,
        rng: np.random.Generator,
        count: int | None = None,
        *,
        level: int | None = None,
        room: str | None = None,
        island: int | None = None,
        reachable_from: ArrayLike | None = None,
        anywhere: bool = False,
    ) -> Floats:
        """Draw places, of all islands unless told otherwise.

        Args:
            rng: draws.
            count: how many, with repetition; one unless given.
            level: on this level.
            room: in this room, by id or name.
            island: on this island; 1 is the largest.
            reachable_from: where a path leads to from this world position [m].
            anywhere: see `PlaceSampler`.

        Returns:
            World x, y and floor z [m], shape (3,) or (count, 3), float64.

        Raises:
            QueryError: there is no such place, room, island or level; nobody can stand at the
                position; or the generator is none.
        """
        if reachable_from is not None:
            home = self._island_of(reachable_from, level=None)
            if island not in (None, home):
                raise QueryError(f"island {island} can't be reached: the position is on {home}")
            island = home
        cells = np.flatnonzero(self._allowed(level=level, room=room, island=island))
        limits = {"level": level, "room": room, "island": island}
        return self._draw(cells, rng, count, anywhere, limits)

    def random_point_near(
        self,
        rng: np.random.Generator,
        position: ArrayLike,
        max_distance: float,
        count: int | None = None,
        *,
        min_distance: float = 0.0,
        straight: bool = False,
        room: str | None = None,
        level: int | None = None,
        anywhere: bool = False,
    ) -> Floats:
        """Draw places near a position.

        Distances are those of the shortest path from it; or straight on the map of its level,
        through walls as well. They are measured to the cells' centres.

        Args:
            rng: draws.
            position: world position [m]; with paths, one where an agent can stand.
            max_distance: [m].
            count: how many, with repetition; one unless given.
            min_distance: [m]; the places are in an annulus then.
            straight: measure straight.
            room: only in this room, by id or name.
            level: which level the position is on.
            anywhere: see `PlaceSampler`.

        Returns:
            World x, y and floor z [m], shape (3,) or (count, 3), float64.

        Raises:
            QueryError: see `random_point`; and if the distances are none.
        """
        cells = self._cells_near(position, min_distance, max_distance, straight, level)
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
        return len(self._cells_near(position, min_distance, max_distance, True, level)) > 0

    def random_pose(
        self,
        rng: np.random.Generator,
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
            rng: draws.
            target: world position [m], which may be in something; the agent stands on its level.
            max_distance, min_distance: from the target, straight on the map [m].
            in_sight: nothing stands between, but for what the target is in, see
                `navbake.runtime.kernels.crossing.walk_line`.
            same_room: stand in the target's room.
            level: which level the target is on; without one, where to stand.

        Raises:
            QueryError: see `random_point_near`.
        """
        check_generator(rng)
        if target is None:
            place = self.random_point(rng, level=level)
            return Pose(place, float(rng.uniform(-math.pi, math.pi)))
        cells = self._cells_near(target, min_distance, max_distance, True, level)
        walk = self.search.walk
        p = check_positions(target, walk.num_levels, level)
        home = flat_cell(walk, p, level)
        assert home is not None  # or there were no cells near it
        number = self.rooms.number
        if same_room:
            cells = cells[(number[cells] == number[home]) & (number[home] > 0)]
        if in_sight:
            cells = self._first_seen(rng, cells, home, p)
        limits = {"distance [m]": f"{min_distance:g} to {max_distance:g}", "in sight": in_sight}
        place = self._draw(cells, rng, None, False, limits)
        return Pose(place, math.atan2(p[1] - place[1], p[0] - place[0]))

    def _first_seen(self, rng: np.random.Generator, cells: Ints, home: int, p: Floats) -> Ints:
        """One of some cells that sees a point, drawn evenly from all that do; or none."""
        from navbake.runtime.kernels.nearest import first_in_sight

        walk = self.search.walk
        found = first_in_sight(
            place_of(walk), links_of(walk), ~self.occupied, walk.floor, self.rooms.number,
            home, p[0], p[1], rng.permutation(cells),
        )  # fmt: skip
        return np.array([found] if found >= 0 else [], dtype=np.int64)

    def _cells_near(
        self,
        position: ArrayLike,
        min_distance: float,
        max_distance: float,
        straight: bool,
        level: int | None,
    ) -> Ints:
        check_distances(min_distance, max_distance)
        walk = self.search.walk
        p = check_positions(position, walk.num_levels, level)
        home = flat_cell(walk, p, level)
        if home is None:
            where = ", ".join(f"{v:g}" for v in p)
            raise QueryError(f"{where} is in no cell of {self.grid.scene_id!r}: nothing is near")
        if straight:
            on_level = int(walk.level_of(np.array(home)))
            limits = min_distance, max_distance
            return cells_in_annulus(walk, on_level, p[0], p[1], *limits, walk.free)
        self._island_of(position, level)
        field = self.search.field(np.array([home]), weighted=False)
        near = (field >= min_distance) & (field <= max_distance + 1e-9)
        return np.flatnonzero(near & np.isfinite(field))  # none, where any distance will do

    def _island_of(self, position: ArrayLike, level: int | None) -> int:
        island = self.island_at(position, level=level)
        if island is None:
            where = ", ".join(f"{v:g}" for v in np.asarray(position, dtype=np.float64))
            raise QueryError(f"no agent can stand at {where}: snap it to the nearest place first")
        return island

    def _draw(
        self,
        cells: Ints,
        rng: np.random.Generator,
        count: int | None,
        anywhere: bool,
        limits: Mapping[str, object],
    ) -> Floats:
        check_generator(rng)
        if count is not None and (not isinstance(count, int | np.integer) or count < 0):
            raise QueryError(f"expected a count >= 0, got {count!r}")
        if not len(cells):
            given = [f"{name} {v}" for name, v in limits.items() if v not in (None, False)]
            asked = f" with {', '.join(given)}" if given else ""
            raise QueryError(f"no free cell in {self.grid.scene_id!r}{asked}")
        num = 1 if count is None else int(count)
        drawn = draw_positions(self.search.walk, cells, rng, num, anywhere=anywhere)
        return drawn.reshape(3) if count is None else drawn
