"""Random places and poses."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.runtime.many import ManyPlaces
from navbake.runtime.places.sample import Pose, cells_near, draw_places, draw_pose
from navbake.runtime.questions.regions import RegionQuestions
from navbake.runtime.spawns.reachable import find_reachable
from navbake.runtime.spawns.spawn import Spawner, Spawns
from navbake.types import Float


class DrawQuestions(RegionQuestions):
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
            home = int(self.islands.number[self._cache.flat.free_cell_at(reachable_from)[1]])
            if island not in (None, home):
                raise QueryError(f"island {island} can't be reached: the position is on {home}")
            island = home
        cells = np.flatnonzero(self._cache.allowed(level=level, room=room, island=island))
        limits = {"level": level, "room": room, "island": island}
        return draw_places(self._cache, cells, rng, count, anywhere, limits)

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
        cells = cells_near(self._cache, position, distances, straight, level)
        if room is not None:
            cells = cells[self.rooms.number[cells] == self.rooms.find(room)]
        limits = {"room": room, "distance [m]": f"{min_distance:g} to {max_distance:g}"}
        return draw_places(self._cache, cells, rng, count, anywhere, limits)

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
        return len(cells_near(self._cache, position, distances, True, level)) > 0

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
        distances = (min_distance, max_distance)
        return draw_pose(
            self._cache, rng, target, distances,
            in_sight=in_sight, same_room=same_room, level=level,
        )  # fmt: skip

    # --- many agents -----------------------------------------------------------------------

    def spawn(
        self,
        rng: np.random.Generator | None,
        n: int,
        *,
        rooms: str | Sequence[str] | None = None,
        level: int | None = None,
        island: int | None = None,
        reachable_from: ArrayLike | None = None,
        clearance: float | None = None,
        min_distance: float | None = None,
        facing: ArrayLike | None = None,
        stratify: str | None = None,
    ) -> Spawns:
        """Draw where many agents start: none meets anything, or another one.

        Places are centres of cells where the agent's radius fits, that of the grid's inflation, or
        else of its bake. One after the other is drawn, evenly by area, from those that are far
        enough from all before it (Poisson-disc sampling). Distances between agents are measured
        on the map; agents on floors that are the agent's height or more apart don't count.

        Args:
            rng: see `random_point`.
            n: how many agents, >= 1.
            rooms: in these rooms, by id or name; one or several.
            level: on this level.
            island: on this island; 1 is the largest.
            reachable_from: where a path leads to from this world position [m].
            clearance: a disc of this radius round each agent meets no obstacle and no drop, as
                with `grid.inflate` [m]; unless `min_distance` is given, nor another agent's.
            min_distance: between the centres of any two agents [m]; in any case more than twice
                the agent's radius.
            facing: where all look: a world position [m], or a heading [rad]; everywhere, if None.
            stratify: ``area`` cuts the cells into n parts of one area and draws one agent in
                each; ``room`` and ``island`` draw as many agents in each, give or take one, and
                leave out cells in no room. Agents that don't fit into a part go to others.

        Returns:
            Positions and headings, in random order.

        Raises:
            QueryError: they don't fit, with how many do at most where that can be proved at once;
                there is no such room, level or island; a number makes no sense.
        """
        selection = self._spawner.select(rooms, level, island, reachable_from, clearance)
        return self._spawner.draw(
            rng, n, selection, min_distance=min_distance, facing=facing, stratify=stratify
        )

    def reachable_positions(
        self, start: ArrayLike, spacing: float = 0.25, *, level: int | None = None
    ) -> Float:
        """List the positions that steps of one length along x and y lead to.

        The positions are those of a square lattice through the start. A step is taken where
        `try_step` gets to its end without sliding, over links to other levels as well, and where
        the agent's disc meets no obstacle at its end. AI2-THOR calls these positions so.

        Args:
            start: world position [m] where an agent can stand; the first in the list. From a
                cell's centre, steps of whole cells lead to centres.
            spacing: of the lattice [m], a cell's size or more.

        Returns:
            World x, y and floor z [m], shape (n, 3), float64, those of the fewest steps first.

        Raises:
            QueryError: no agent can stand at the start, or the spacing is less than a cell.
        """
        many = ManyPlaces(self._cache, self._planner)
        return find_reachable(self._cache, many, start, spacing, level)

    @cached_property
    def _spawner(self) -> Spawner:
        return Spawner(self._cache)
