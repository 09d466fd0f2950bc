"""A grid prepared for questions: its flat cells, the moves of each, and what follows from them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.lazy import lazy
from navbake.navgrid.block_state import NO_DIAGONAL, NO_OFF_CENTER, BlockState, Window
from navbake.navgrid.cells import check_level
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.runtime import flat_grid
from navbake.runtime.inflation import exact_radius, find_room
from navbake.types import Bool, Float, Int, Int32

arrays = lazy("navbake.runtime.kernels.arrays")  # numba loads slowly
lines = lazy("navbake.runtime.kernels.lines")
routes = lazy("navbake.runtime.kernels.routes")

LAST_SEARCH = 2**31 // 64 - 2  # `mark` is int32 and holds the number of a search times 64
FIRST_ROOM = 1 << 15  # entries for open cells at first
MAX_KEPT = 8  # answers of each kind that are kept
NO_CELLS = np.empty(0, dtype=np.int64)
Kept = TypeVar("Kept")


class Search:
    """The cells of all levels of a grid, searches over them, and what follows from them.

    `update` takes over what `grid.block` blocks, by which `version` grows. Not to be shared by
    threads. `flat` are the cells, `graph` the steps between them; `free_diagonally`, by flat id,
    the free cells with room for a diagonal step; `off_center` where a line may be off the centres.
    """

    def __init__(self, grid: NavGrid, *, cut_corners: bool = False) -> None:
        clean = grid.without_blocks()
        self.grid, self.cut_corners, self.version = grid, cut_corners, 0
        self.flat = flat = flat_grid.flatten(clean)
        self._kept: dict[str, dict[Any, Any]] = {}
        self._room = find_room(clean)
        self._masks = [mask & flat.free for mask in self._room or (flat.free,) * 3]
        self.free_diagonally, anywhere, by_squares = self._masks
        solid = [v.solid.ravel() != 0 for v in clean.levels] if self._room else [NO_CELLS]
        before = np.append(np.int32(0), np.cumsum(np.concatenate(solid), dtype=np.int32))
        radius, is_closed = exact_radius(grid), len(grid.levels) > 1
        self.off_center = arrays.OffCenter(anywhere, by_squares, before, radius, is_closed)
        weights = flat.weight[flat.free]
        least, most = (float(weights.min()), float(weights.max())) if weights.size else (1.0, 1.0)
        if least < 0:
            raise QueryError(f"expected weights >= 0, got {least:g}: no path is the cheapest then")
        # the buckets fit the weights of all cells, whatever is blocked later
        size, longest = float(flat.layout.cell_size.min()), float(flat.links.length.max(initial=0))
        moves = np.zeros(flat.num_cells, dtype=np.uint8)
        buckets = routes.bucket_width(size, least, most, longest)
        same = least if least == most else 0.0
        self.graph = arrays.Graph(
            flat.layout, flat.links, moves, flat.weight, same, least, *buckets
        )
        self._visits = arrays.Visits(
            mark=np.zeros(flat.num_cells, dtype=np.int32),
            cost=np.zeros(flat.num_cells, dtype=np.float64),
            link_from=np.zeros(len(flat.links.cell), dtype=np.int64),
            entry_cell=np.empty(FIRST_ROOM, dtype=np.int32),
            entry_next=np.empty(FIRST_ROOM, dtype=np.int32),
        )
        self._number = 0
        self._seen = [0] * flat.num_levels
        for number, level in enumerate(grid.levels):
            self._find_moves(number, (0, level.height, 0, level.width))
        self.update()

    def update(self) -> None:
        """Catch up with what was blocked and freed."""
        for number, level in enumerate(self.grid.levels):
            state = level.block_state
            if state is None or state.revision == self._seen[number]:
                continue
            whole = [(0, level.height, 0, level.width)]
            for window in state.windows_since(self._seen[number]) or whole:
                self._copy_changes(number, level, state, window)
            self._seen[number] = state.revision
            self.version += 1

    def _copy_changes(
        self, number: int, level: SceneGrid2D, state: BlockState, window: Window
    ) -> None:
        """Copy a window of a level that changed, and find the moves in and round it again."""
        row0, row1, col0, col1 = window
        inside, cells = np.s_[row0:row1, col0:col1], self.flat.cells_of(number)

        def cut(array: NDArray[Any]) -> NDArray[Any]:
            return array[cells].reshape(level.shape)[inside]

        weight = level.weights[inside].astype(np.float64)
        free = np.isfinite(weight)
        cut(self.flat.free)[:] = free
        cut(self.flat.weight)[:] = np.where(free, weight, np.inf)
        for k, layer in enumerate((NO_DIAGONAL, NO_OFF_CENTER, NO_OFF_CENTER)):
            cut(self._masks[k])[:] = free
            if self._room is not None:
                held = state.count[layer].reshape(level.shape)[inside]
                cut(self._masks[k])[:] &= cut(self._room[k]) & (held == 0)
        self._find_moves(number, (row0 - 1, row1 + 1, col0 - 1, col1 + 1))

    def _find_moves(self, level: int, window: Window) -> None:
        flat, layout = self.flat, self.flat.layout
        routes.find_moves(
            flat.free, self.free_diagonally, flat.floors, flat.slopes, self.cut_corners, layout,
            level, window, self.graph.moves,
        )  # fmt: skip

    def keep(self, kind: str, key: Any, make: Callable[[], Kept], most: int = MAX_KEPT) -> Kept:
        """Return `make()`, cached per kind, key and grid version; keeps the `most` last used."""
        kept, key = self._kept.setdefault(kind, {}), (self.version, key)
        value: Kept = kept.pop(key) if key in kept else make()
        kept[key] = value  # last in the row, so the first is the one unused for longest
        for old in list(kept)[:-most]:
            del kept[old]
        return value

    @cached_property
    def rooms(self) -> flat_grid.RoomMap:
        """The rooms of the grid and of each cell."""
        return flat_grid.map_rooms(self.grid)

    @cached_property
    def doors(self) -> flat_grid.DoorMap:
        """The doors that each cell is in."""
        return flat_grid.map_doors(self.grid, self.flat)

    @property
    def islands(self) -> flat_grid.IslandMap:
        """The connected parts of the cells that are free now."""
        moves = self.graph.moves if self.cut_corners else None
        return self.keep("islands", None, lambda: flat_grid.map_islands(self.flat, moves), 1)

    @property
    def occupied(self) -> Bool:
        """Where something stands now or there is no floor, by flat id; see `SceneGrid2D.solid`."""
        solid = (level.solid.ravel() != 0 for level in self.grid.levels)
        return self.keep("occupied", None, lambda: np.concatenate(list(solid)), 1)

    @property
    def sight(self) -> tuple[Any, ...]:
        """Layout, links, floors without a limit of steps, and by cell whether nothing stands there.

        A line of sight is walked over these.
        """
        clear = self.keep("clear", None, lambda: ~self.occupied, 1)
        floors = self.flat.floors._replace(max_step=math.inf)
        return self.flat.layout, self.flat.links, floors, clear

    def allowed(
        self, *, level: int | None = None, room: str | None = None, island: int | None = None
    ) -> Bool:
        """The free cells that are on a level, in a room and on an island, by flat id."""
        allowed = self.flat.free
        if level is not None:
            check_level(level, self.flat.num_levels)
            inside, allowed = self.flat.cells_of(level), np.zeros_like(allowed)
            allowed[inside] = self.flat.free[inside]
        if room is not None:
            allowed = allowed & (self.rooms.number == self.rooms.find(room))
        if island is not None:
            allowed = allowed & (self.islands.number == self.islands.check(island))
        return allowed

    def home_island(self, position: ArrayLike, island: int | None) -> int:
        """The island of a free position; raises QueryError where another `island` is asked for."""
        home = int(self.islands.number[self.flat.free_cell_at(position)[1]])
        if island not in (None, home):
            raise QueryError(f"island {island} can't be reached: the position is on {home}")
        return home

    def route(self, origin: int, goals: Int) -> tuple[Int, float] | None:
        """The cheapest route to the cheapest of several free cells, by flat ids, and its cost."""
        if (goals == origin).any():
            return np.array([origin]), 0.0
        route = self._find(self.graph, np.array([origin]), goals)
        return (route, float(self._visits.cost[route[-1]])) if len(route) else None

    def field(self, goals: Int, *, weighted: bool = True) -> Float:
        """What the cheapest route from each cell to any of several costs, inf for none."""
        return self._flood(goals, weighted)[0]

    def onward(self, goals: Int) -> tuple[Float, Int]:
        """The weighted `field`, and where routes go on: at a goal the cell itself, -1 for none."""
        flat, links = self.flat, self.flat.links
        cost, way = self._flood(goals, True)
        cells = np.arange(flat.num_cells)
        # the field grew from the goals, so the way on is that by which it came, backwards
        steps = np.zeros((2, routes.WAY + 1), dtype=np.int64)
        steps[:, : len(arrays.ROW_STEP)] = arrays.ROW_STEP, arrays.COL_STEP
        down, across = steps[:, way]
        width = flat.layout.width[flat.level_of(cells)]
        onward = np.where(np.isfinite(cost), cells - down * width - across, -1)
        by_link = (way[links.cell] == routes.LINK) & (onward[links.cell] >= 0)
        onward[links.cell[by_link]] = self._visits.link_from[by_link]
        return cost, onward

    def _flood(self, goals: Int, weighted: bool) -> tuple[Float, Int32]:
        """Search backwards from goals: what each cell costs, and the way that it was reached by."""
        flat, graph = self.flat, self.graph
        if not weighted:
            size, longest = flat.layout.cell_size.min(), flat.links.length.max(initial=0)
            bucket, num = routes.bucket_width(float(size), 1.0, 1.0, float(longest))
            graph = graph._replace(
                same_weight=1.0, least_weight=1.0, bucket=bucket, num_buckets=num
            )
        self._find(graph, goals, NO_CELLS)
        mark, cost = self._visits.mark, self._visits.cost
        return np.where(mark >= self._number * routes.SEARCH, cost, np.inf), mark & routes.WAY

    def _find(self, graph: Any, sources: Int, goals: Int) -> Int:
        """`navbake.runtime.kernels.routes.find_route`, with as much room as it needs."""
        while True:
            # marks of earlier searches stay, as each search has its own number
            self._number += 1
            if self._number > LAST_SEARCH:
                self._visits.mark[:] = 0
                self._number = 1
            result, route = routes.find_route(graph, sources, goals, self._number, self._visits)
            if result == routes.DONE:
                return np.asarray(route)
            cell, following = np.empty((2, 4 * len(self._visits.entry_cell)), dtype=np.int32)
            self._visits = self._visits._replace(entry_cell=cell, entry_next=following)

    def can_pass(self, a: Float, b: Float, level: int) -> bool:
        """Whether an agent can move now along a line between two points x, y of a level [m]."""
        return bool(lines.can_pass(a, b, level, self.graph, self.off_center))
