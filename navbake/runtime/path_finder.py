"""Plans paths on a grid, over all its levels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import check_positions
from navbake.runtime.paths.door_map import DoorMap, doors_on, map_doors
from navbake.runtime.paths.goals import Goal, Target, find_target
from navbake.runtime.paths.path import Path, path_length
from navbake.runtime.paths.string_pulling import pull_route
from navbake.runtime.place_sampler import PlaceSampler
from navbake.runtime.places.locate import flat_cells

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid


MAX_FIELDS = 8  # distance fields that are kept


class PathFinder(PlaceSampler):
    """Answers an agent's questions about ways through a grid, and about places on it.

    A path steps over the edges and corners of free cells and over links between levels. Floors of
    neighbours differ by at most the grid's `traversableFloorHeight`. A step costs its length [m]
    times the weight of the cell that it leads to.

    Goals are a position, several of them (the one that is the cheapest to reach counts),
    ``room:NAME`` with a room's id or name, or ``object:NAME`` with a name of the user data (the
    free cells next to it). Positions are world x, y, z [m], on the level of the nearest floor
    below; x, y will do on one level or with `level`.

    One object serves one thread at a time.

    Args:
        grid: a grid of one or several levels. What is written into its arrays later is not seen;
            what `grid.block` blocks is.
        cut_corners: let diagonal steps pass blocked corners.

    Raises:
        QueryError: a weight is negative.
    """

    def __init__(self, grid: NavGrid, *, cut_corners: bool = False) -> None:
        super().__init__(grid, cut_corners=cut_corners)
        self._fields: dict[tuple[int, bool, bytes], NDArray[np.float64]] = {}
        self._doors: DoorMap | None = None

    def find_path(
        self, start: ArrayLike, goal: Goal, *, level: int | None = None, smooth: bool = True
    ) -> Path | None:
        """Find the cheapest path.

        Args:
            start: world position [m].
            goal: see `PathFinder`.
            level: which level positions are on; then z does not count.
            smooth: pull the path straight where that stays free; else it runs through the
                cells' centres. It begins and ends at the positions themselves unless they are
                nearer to obstacles than the agent may be.

        Returns:
            None where there is no path: `why_not` tells the reason.

        Raises:
            QueryError: a position is none, or there is no such room, object or level.
        """
        search = self.search
        origin, target = self._ends(start, goal, level)
        goals = target.free_cells(search.walk)
        if origin < 0 or not search.walk.free[origin] or not len(goals):
            return None
        route = search.route(origin, goals)
        if route is None:
            return None
        return self._make_path(route, np.asarray(start, dtype=np.float64), target, smooth)

    def why_not(self, start: ArrayLike, goal: Goal, *, level: int | None = None) -> str | None:
        """Say why there is no path: in one sentence, with positions and figures.

        It tells of a start or goal that isn't free and of the nearest cell that is; or of the
        islands that they are in and how near these come; then of what is between: cells that are
        blocked for now, doors, a gap that is too narrow for the agent (known of grids that were
        inflated), steps between levels that can't be taken, or the names of what stands there.

        Args:
            start: world position [m].
            goal: see `PathFinder`.
            level: which level positions are on; then z does not count.

        Returns:
            None if there is a path.

        Raises:
            QueryError: see `find_path`.
        """
        from navbake.runtime.paths.why_not import explain

        origin, target = self._ends(start, goal, level)
        return explain(self, np.asarray(start, dtype=np.float64), origin, target)

    def distance_field(
        self, goal: Goal, *, level: int | None = None, weighted: bool = True
    ) -> list[NDArray[np.float64]]:
        """Find what the cheapest path from every cell to the goal costs.

        Args:
            goal: see `PathFinder`.
            level: which level positions are on; then z does not count.
            weighted: count steps by their weights, as `find_path` does; else by their lengths
                alone, so that the shortest path counts [m].

        Returns:
            One array a level, shape (height, width), float64, inf where no path leads to the
            goal; read-only. The last few goals' fields are kept, so asking again costs nothing.

        Raises:
            QueryError: see `find_path`.
        """
        field, start = self._field(goal, level, weighted), self.search.walk.start
        return [
            field[start[k] : start[k + 1]].reshape(part.shape)
            for k, part in enumerate(self.grid.levels)
        ]

    def distances(
        self,
        starts: ArrayLike,
        goal: Goal,
        *,
        level: int | None = None,
        weighted: bool = True,
    ) -> NDArray[np.float64]:
        """Find what the cheapest paths from many starts to the goal cost.

        Args:
            starts: world positions [m], shape (..., 3).
            goal: see `PathFinder`.
            level: which level positions are on; then z does not count.
            weighted: see `distance_field`.

        Returns:
            Shape (...), float64; inf where there is no path.

        Raises:
            QueryError: see `find_path`.
        """
        cells = flat_cells(self.search.walk, starts, level)
        field = self._field(goal, level, weighted)
        return np.where(cells >= 0, field[cells], np.inf)

    def _field(self, goal: Goal, level: int | None, weighted: bool) -> NDArray[np.float64]:
        """The field of a goal by flat id; the last few are kept."""
        search = self.search
        target = find_target(self.grid, search.walk, lambda: self.rooms, goal, level)
        goals = target.free_cells(search.walk)
        key = (search.version, weighted, goals.tobytes())
        field = self._fields.pop(key, None)
        if field is None:
            field = search.field(goals, weighted=weighted)
            field.flags.writeable = False
        self._fields[key] = field  # last in the row
        for old in list(self._fields)[:-MAX_FIELDS]:
            del self._fields[old]
        return field

    def _ends(self, start: ArrayLike, goal: Goal, level: int | None) -> tuple[int, Target]:
        walk = self.search.walk
        p = check_positions(start, walk.num_levels, level)
        if p.ndim != 1:
            raise QueryError(f"expected one start, got an array of shape {p.shape}")
        target = find_target(self.grid, walk, lambda: self.rooms, goal, level)
        return int(flat_cells(walk, p, level)), target

    def _make_path(
        self, route: NDArray[np.int64], start: NDArray[np.float64], target: Target, smooth: bool
    ) -> Path:
        search, walk = self._search, self._search.walk
        positions, levels = pull_route(
            search, route, smooth=smooth, start=start[:2], end=target.position_in(route[-1])
        )
        level = walk.level_of(route)
        row, col = np.divmod(route - walk.start[level], walk.width[level])
        if self._doors is None:
            self._doors = map_doors(self.grid, walk)
        numbers = self.rooms.number[route]
        entered = numbers[np.append(True, numbers[1:] != numbers[:-1])]
        return Path(
            positions=positions,
            levels=levels,
            cells=np.stack([level, row, col], axis=1),
            length=path_length(positions),
            cost=float((search.lengths(route) * walk.weight[route[1:]]).sum()),
            rooms=[str(self.rooms.id_of(int(n))) for n in entered if n],
            doors=doors_on(self._doors, route),
        )
