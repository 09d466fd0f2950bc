"""Plans paths between positions and goals, and keeps the fields of the last few goals."""

import numpy as np
from numpy.typing import ArrayLike

from navbake.runtime.grid_cache import GridCache
from navbake.runtime.paths.door_map import doors_on
from navbake.runtime.paths.goals import Goal, Target, find_target
from navbake.runtime.paths.path import Path, path_length
from navbake.runtime.paths.string_pulling import pull_route
from navbake.types import Float, Int

MAX_FIELDS = 8  # distance fields that are kept


class Planner:
    """Plans paths for `PathFinder`."""

    def __init__(self, cache: GridCache) -> None:
        self._cache = cache
        self._fields: dict[tuple[int, bool, bytes], Float] = {}

    def find_path(
        self, start: ArrayLike, goal: Goal, level: int | None, *, smooth: bool
    ) -> Path | None:
        """`PathFinder.find_path`."""
        search = self._cache.search
        origin, target = self.find_ends(start, goal, level)
        goals = target.free_cells(search.flat)
        if origin < 0 or not search.flat.free[origin] or not len(goals):
            return None
        route = search.route(origin, goals)
        if route is None:
            return None
        return self._make_path(route, np.asarray(start, dtype=np.float64), target, smooth)

    def field(self, goal: Goal, level: int | None, *, weighted: bool) -> Float:
        """The costs of `PathFinder.distance_field`, by flat id; read-only."""
        search = self._cache.search
        goals = find_target(self._cache, goal, level).free_cells(search.flat)
        # goals in other words but of the same cells share a field; blocks make a new version
        key = (search.version, weighted, goals.tobytes())
        field = self._fields.pop(key, None)
        if field is None:
            field = search.field(goals, weighted=weighted)
            field.flags.writeable = False
        self._fields[key] = field  # last in the row, so the first is the one unused for longest
        for old in list(self._fields)[:-MAX_FIELDS]:
            del self._fields[old]
        return field

    def find_ends(self, start: ArrayLike, goal: Goal, level: int | None) -> tuple[int, Target]:
        """The flat id of a start's cell, -1 for none, and where a goal is."""
        _, cell = self._cache.flat.locate(start, level, "start")
        return (-1 if cell is None else cell), find_target(self._cache, goal, level)

    def _make_path(self, route: Int, start: Float, target: Target, smooth: bool) -> Path:
        search, rooms = self._cache.search, self._cache.rooms
        positions, levels = pull_route(
            search, route, smooth=smooth, start=start[:2], end=target.position_in(route[-1])
        )
        numbers = rooms.number[route]
        entered = numbers[np.append(True, numbers[1:] != numbers[:-1])]
        return Path(
            positions=positions,
            levels=levels,
            cells=np.stack(search.flat.split(route), axis=1),
            length=path_length(positions),
            cost=float((search.lengths(route) * search.flat.weight[route[1:]]).sum()),
            rooms=[str(rooms.id_of(int(n))) for n in entered if n],
            doors=doors_on(self._cache.doors, route),
        )
