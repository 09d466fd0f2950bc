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
from navbake.runtime.flat_grid import flatten
from navbake.runtime.inflation import exact_radius, find_room
from navbake.runtime.regions import DoorMap, IslandMap, RoomMap, map_doors, map_islands, map_rooms
from navbake.types import Bool, Float, Int

arrays = lazy("navbake.runtime.kernels.arrays")  # numba loads slowly
lines = lazy("navbake.runtime.kernels.lines")
routes = lazy("navbake.runtime.kernels.routes")

LAST_SEARCH = 2**31 // 64 - 2  # `mark` is int32 and holds the number of a search times 64
FIRST_ROOM = 1 << 15  # entries for open cells at first
MAX_KEPT = 8  # answers of each kind that are kept
NOWHERE = np.full(2, np.nan)
NO_CELLS = np.empty(0, dtype=np.int64)
Kept = TypeVar("Kept")


class Search:
    """The cells of all levels of a grid, searches over them, and what follows from them.

    What is written into the grid's arrays later is not seen; what `grid.block` blocks is, at each
    `update`. Not to be shared by threads.

    Attributes:
        grid: what is searched.
        flat: the cells; those that are blocked are not free.
        graph: the steps between them and what they cost, a
            `navbake.runtime.kernels.arrays.Graph`.
        cut_corners: whether a diagonal step needs nothing but its target.
        free_diagonally: by flat id, bool: free cells with room for a diagonal step, see
            `navbake.runtime.inflation.find_room`.
        off_center: where else an agent may be, and a line may run, beside the centres, a
            `navbake.runtime.kernels.arrays.OffCenter`.
        version: grows with each change that `update` finds.
    """

    def __init__(self, grid: NavGrid, *, cut_corners: bool = False) -> None:
        clean = grid.without_blocks()
        self.grid, self.cut_corners, self.version = grid, cut_corners, 0
        self.flat = flat = flatten(clean)
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
        """Something that follows from the cells as they are now; the last few of a kind are kept.

        `key` says which of its kind it is.
        """
        kept, key = self._kept.setdefault(kind, {}), (self.version, key)
        value: Kept = kept.pop(key) if key in kept else make()
        kept[key] = value  # last in the row, so the first is the one unused for longest
        for old in list(kept)[:-most]:
            del kept[old]
        return value

    @cached_property
    def rooms(self) -> RoomMap:
        """The rooms of the grid and of each cell."""
        return map_rooms(self.grid)

    @cached_property
    def doors(self) -> DoorMap:
        """The doors that each cell is in."""
        return map_doors(self.grid, self.flat)

    @property
    def islands(self) -> IslandMap:
        """The connected parts of the cells that are free now."""
        moves = self.graph.moves if self.cut_corners else None
        return self.keep("islands", None, lambda: map_islands(self.flat, moves), 1)

    @property
    def occupied(self) -> Bool:
        """Where something stands now or there is no floor, by flat id, shape (n,), bool.

        Something stands in a cell where it meets the cell's square, see `SceneGrid2D.solid`.
        In a file without ``occupancy``, where weights are infinite. What a larger radius takes
        from an agent is not occupied.
        """

        def find() -> Bool:
            return np.concatenate([level.solid.ravel() != 0 for level in self.grid.levels])

        return self.keep("occupied", None, find, 1)

    @property
    def sight(self) -> tuple[Any, ...]:
        """What a line of sight runs through, as kernels take it: layout, links, floors whose
        heights don't count, and by cell whether nothing stands there.
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
            on_level = np.zeros_like(allowed)
            on_level[self.flat.cells_of(level)] = True
            allowed = allowed & on_level
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

    def route(self, origin: int, goals: Int) -> Int | None:
        """Find the cheapest route from a free cell to the cheapest of several, by flat ids.

        Returns:
            Flat ids of the cells from the origin to the goal, shape (m,); None for no route.
        """
        source = np.array([origin])
        if (goals == origin).any():
            return source
        while True:
            # marks of earlier searches stay, as each search has its own number
            self._number += 1
            if self._number > LAST_SEARCH:
                self._visits.mark[:] = 0
                self._number = 1
            result, route = routes.find_route(self.graph, source, goals, self._number, self._visits)
            if result == routes.DONE:
                return route if len(route) else None
            self._make_room()

    def field(self, goals: Int, *, weighted: bool = True) -> Float:
        """Find the cost of the cheapest route from every cell to any of several free cells.

        By flat id, float64, inf for no route. Unless weighted, steps count by their length [m].
        """
        flat, graph = self.flat, self.graph
        if not weighted:
            size, longest = flat.layout.cell_size.min(), flat.links.length.max(initial=0)
            bucket, num = routes.bucket_width(float(size), 1.0, 1.0, float(longest))
            graph = graph._replace(
                same_weight=1.0, least_weight=1.0, bucket=bucket, num_buckets=num
            )
        while True:
            mark, cost = np.zeros(flat.num_cells, dtype=np.int32), np.full(flat.num_cells, np.inf)
            visits = self._visits._replace(mark=mark, cost=cost)
            if routes.find_route(graph, goals, NO_CELLS, 1, visits)[0] == routes.DONE:
                return cost
            self._make_room()

    def _make_room(self) -> None:
        cell, following = np.empty((2, 4 * len(self._visits.entry_cell)), dtype=np.int32)
        self._visits = self._visits._replace(entry_cell=cell, entry_next=following)

    def lay(
        self, route: Int, *, smooth: bool, start: Float | None, end: Float | None
    ) -> tuple[Float, Int]:
        """Make a line along a route: world x, y, floor z [m], shape (m, 3), and the level of each.

        It is pulled straight if `smooth`, and begins and ends at `start` and `end`, world x, y [m],
        where these are given; see `navbake.runtime.kernels.lines.lay_route`.
        """
        start, end = (NOWHERE if p is None else p for p in (start, end))
        positions, levels = lines.lay_route(
            route, start, end, smooth, self.graph, self.flat.floors, self.off_center
        )
        return positions, levels

    def can_pass(self, a: Float, b: Float, level: int) -> bool:
        """Whether an agent can move now along a line between two points x, y of a level [m]."""
        return bool(lines.can_pass(a, b, level, self.graph, self.off_center))

    def lengths(self, cells: Int) -> Float:
        """The lengths of the steps of a route [m], shape (len(cells) - 1,)."""
        level, row, col = self.flat.split(cells)
        down, across = np.abs(np.diff(row)), np.abs(np.diff(col))
        is_diagonal = (down != 0) & (across != 0)
        size = self.flat.layout.cell_size[level[1:]]
        length: Float = size * np.where(is_diagonal, math.sqrt(2.0), 1.0)
        links = self.flat.links
        if len(links.cell):
            is_link = (np.diff(level) != 0) | (down > 1) | (across > 1)
            for i in np.flatnonzero(is_link):
                slot = np.searchsorted(links.cell, cells[i])
                of_cell = slice(*links.start[slot : slot + 2])
                length[i] = links.length[of_cell][links.target[of_cell] == cells[i + 1]][0]
        return length

    def onward(self, field: Float) -> Int:
        """Find where the cheapest path to a goal goes on from each cell.

        Of the steps that a cell has, to its neighbours and over links, the one that is the cheapest
        together with the rest of the way (a weighted `field`); of equal ones the first in the order
        of moves, then links. Flat ids, shape (n,), int64: the cell itself where the goal is, -1
        where no path is.
        """
        flat, moves = self.flat, self.graph.moves
        onward = np.where(np.isfinite(field), np.arange(len(field)), -1)
        best = np.full(len(field), np.inf)

        def take_cheaper(cells: Int, targets: Int, length: Float) -> None:
            cost = length * flat.weight[targets] + field[targets]
            cheaper = cost < best[cells]  # each cell is there once
            best[cells[cheaper]], onward[cells[cheaper]] = cost[cheaper], targets[cheaper]

        walks = np.flatnonzero(np.isfinite(field) & (field > 0))
        level = flat.level_of(walks)
        width, size = flat.layout.width[level], flat.layout.cell_size[level]
        steps = zip(arrays.ROW_STEP, arrays.COL_STEP, strict=True)
        for way, (down, across) in enumerate(steps):
            leads = (moves[walks] >> way) & 1 != 0
            targets = walks[leads] + down * width[leads] + across
            take_cheaper(walks[leads], targets, size[leads] * (1.0 if way < 4 else math.sqrt(2.0)))
        sources, targets = flat.link_ends()
        leads = np.isfinite(field[sources]) & (field[sources] > 0) & np.isfinite(field[targets])
        sources, targets, length = sources[leads], targets[leads], flat.links.length[leads]
        # of the links of one cell the cheapest
        order = np.lexsort((length * flat.weight[targets] + field[targets], sources))
        chosen = order[np.diff(sources[order], prepend=-1) != 0]
        take_cheaper(sources[chosen], targets[chosen], length[chosen])
        return onward
