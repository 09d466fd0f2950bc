"""A grid prepared for searches: its flat cells, the moves of each, and what was searched last."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.block_state import NO_DIAGONAL, NO_OFF_CENTER, BlockState, Window
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.runtime.flat_grid import flatten
from navbake.runtime.inflation import exact_radius, find_room
from navbake.types import Float, Int

# Functions import kernels when they run: numba takes long to load.

LAST_SEARCH = 2**31 // 64 - 2  # `mark` is int32 and holds the number of a search times 64
FIRST_ROOM = 1 << 15  # entries for open cells at first
NOWHERE = np.full(2, np.nan)


class Search:
    """Searches the cells of all levels of a grid. Not to be shared by threads.

    What is written into the grid's arrays later is not seen; what `grid.block` blocks is, at each
    `update`.

    Attributes:
        flat: the cells; those that are blocked are not free.
        graph: the steps between them and what they cost, a
            `navbake.runtime.kernels.arrays.Graph`.
        cut_corners: whether a diagonal step needs nothing but its target.
        free_diagonally: by flat id, bool: cells with room for a diagonal step, see
            `navbake.runtime.inflation.find_room`.
        free_off_center: by flat id, bool: free cells in which an agent may be anywhere.
        off_center: where else a line may run beside the centres, a
            `navbake.runtime.kernels.arrays.OffCenter`.
        version: grows with each change that `update` finds.
    """

    def __init__(self, grid: NavGrid, *, cut_corners: bool = False) -> None:
        from navbake.runtime.kernels.arrays import OffCenter, Visits

        self.grid = grid
        clean = grid.without_blocks()
        self.flat = flatten(clean)
        self.cut_corners = cut_corners
        self._room = find_room(clean)
        self.free_diagonally, self.free_off_center, by_squares = (
            mask.copy() for mask in self._room or (self.flat.free,) * 3
        )
        self.free_off_center &= self.flat.free
        by_squares &= self.flat.free
        solid = [level.solid.ravel() != 0 for level in clean.levels if self._room]
        solid_before = np.zeros(sum(len(level) for level in solid) + 1, dtype=np.int32)
        if solid:
            np.cumsum(np.concatenate(solid), out=solid_before[1:])
        self.off_center = OffCenter(
            anywhere=self.free_off_center,
            by_squares=by_squares,
            solid_before=solid_before,
            radius=exact_radius(grid),
            is_closed=len(grid.levels) > 1,
        )
        self._make_graph()
        self._visits = Visits(
            mark=np.zeros(self.flat.num_cells, dtype=np.int32),
            cost=np.zeros(self.flat.num_cells, dtype=np.float64),
            link_from=np.zeros(len(self.flat.links.cell), dtype=np.int64),
        )
        self._number = 0
        self._make_room(FIRST_ROOM)
        self.version = 0
        self._seen = [0] * self.flat.num_levels
        for number, level in enumerate(grid.levels):
            self._find_moves(number, (0, level.height, 0, level.width))
        self.update()

    def update(self) -> None:
        """Catch up with what was blocked and freed."""
        for number, level in enumerate(self.grid.levels):
            changes = level.block_state
            if changes is None or changes.revision == self._seen[number]:
                continue
            windows = changes.windows_since(self._seen[number])
            if windows is None:
                windows = [(0, level.height, 0, level.width)]
            for window in windows:
                self._copy_changes(number, level, changes, window)
            self._seen[number] = changes.revision
            self.version += 1

    def _copy_changes(
        self, number: int, level: SceneGrid2D, changes: BlockState, window: Window
    ) -> None:
        """Copy a window of a level that changed, and find the moves in and round it again."""
        row0, row1, col0, col1 = window
        inside, flat = np.s_[row0:row1, col0:col1], self.flat

        def cut(array: NDArray[Any]) -> NDArray[Any]:
            return array[flat.cells_of(number)].reshape(level.shape)[inside]

        weight = level.weights[inside].astype(np.float64)
        free = np.isfinite(weight)
        cut(flat.free)[:] = free
        cut(flat.weight)[:] = np.where(free, weight, np.inf)
        masks = (self.free_diagonally, self.free_off_center, self.off_center.by_squares)
        if self._room is None:
            for mask in masks:
                cut(mask)[:] = free
        else:
            layers = (NO_DIAGONAL, NO_OFF_CENTER, NO_OFF_CENTER)
            for mask, of_bake, layer in zip(masks, self._room, layers, strict=True):
                held = changes.count[layer].reshape(level.shape)[inside]
                cut(mask)[:] = cut(of_bake) & (held == 0) & free
        self._find_moves(number, (row0 - 1, row1 + 1, col0 - 1, col1 + 1))

    def _find_moves(self, number: int, window: Window) -> None:
        from navbake.runtime.kernels.arrays import Rect
        from navbake.runtime.kernels.routes import Footing, find_moves

        layout, floors = self.flat.layout, self.flat.floors
        rect = Rect(*(int(v[number]) for v in (layout.start, layout.width, layout.height)))
        rows = max(window[0], 0), min(window[1], rect.height)
        cols = max(window[2], 0), min(window[3], rect.width)
        footing = Footing(
            self.flat.free, self.free_diagonally, floors.z, floors.max_step, self.cut_corners,
            self.flat.slopes,
        )  # fmt: skip
        find_moves(footing, rect, (*rows, *cols), self.graph.moves)

    def route(self, origin: int, goals: Int) -> Int | None:
        """Find the cheapest route from a free cell to the cheapest of several, by flat ids.

        Returns:
            Flat ids of the cells from the origin to the goal, shape (m,); None for no route.
        """
        from navbake.runtime.kernels.routes import FOUND, NO_ROOM, find_route

        result, route = NO_ROOM, np.empty(0, dtype=np.int64)
        while result == NO_ROOM:
            # marks of earlier searches stay, as each search has its own number
            self._number += 1
            if self._number > LAST_SEARCH:
                self._visits.mark[:] = 0
                self._number = 1
            result, route = find_route(
                self.graph, origin, goals, self._number, self._visits, self._entries
            )
            if result == NO_ROOM:
                self._make_room(4 * len(self._entries.cell))
        return route if result == FOUND else None

    def field(self, goals: Int, *, weighted: bool = True) -> Float:
        """Find the cost of the cheapest route from every cell to any of several free cells.

        By flat id, float64, inf for no route. Unless weighted, steps count by their length [m].
        """
        from navbake.runtime.kernels.routes import find_field

        graph = self.graph if weighted else self._lengths_only
        while True:
            field = np.full(self.flat.num_cells, np.inf)
            if find_field(graph, goals, field, self._entries):
                return field
            self._make_room(4 * len(self._entries.cell))

    def lay(
        self, route: Int, *, smooth: bool, start: Float | None, end: Float | None
    ) -> tuple[Float, Int]:
        """Make a line along a route: world x, y, floor z [m], shape (m, 3), and the level of each.

        It is pulled straight if `smooth`, and begins and ends at `start` and `end`, world x, y [m],
        where these are given; see `navbake.runtime.kernels.lines.lay_route`.
        """
        from navbake.runtime.kernels.lines import lay_route

        start, end = (NOWHERE if p is None else p for p in (start, end))
        positions, levels = lay_route(
            route, start, end, smooth, self.graph, self.flat.floors, self.off_center
        )
        return positions, levels

    def can_pass(self, a: Float, b: Float, level: int) -> bool:
        """Whether an agent can move now along a line between two points x, y of a level [m]."""
        from navbake.runtime.kernels.lines import can_pass

        return bool(can_pass(a, b, level, self.graph, self.off_center))

    def lengths(self, cells: Int) -> Float:
        """The lengths of the steps of a route [m], shape (len(cells) - 1,)."""
        level, row, col = self.flat.split(cells)
        down, across = np.diff(row), np.diff(col)
        is_diagonal = (down != 0) & (across != 0)
        size = self.flat.layout.cell_size[level[1:]]
        length: Float = size * np.where(is_diagonal, math.sqrt(2.0), 1.0)
        links = self.flat.links
        if len(links.cell):
            is_link = (np.diff(level) != 0) | (np.abs(down) > 1) | (np.abs(across) > 1)
            for i in np.flatnonzero(is_link):
                slot = np.searchsorted(links.cell, cells[i])
                of_cell = slice(*links.start[slot : slot + 2])
                length[i] = links.length[of_cell][links.target[of_cell] == cells[i + 1]][0]
        return length

    def onward(self, field: Float) -> Int:
        """Find where the cheapest path to a goal goes on from each cell.

        Of the steps that a cell has, to its neighbours and over links, the one that is the cheapest
        together with the rest of the way; of equal ones the first in the order of moves, then
        links.

        Args:
            field: what the cheapest path from each cell costs, by flat id, inf for no path; see
                `field`, with weights.

        Returns:
            Flat ids, shape (n,), int64: the cell itself where the goal is, -1 where no path is.
        """
        from navbake.runtime.kernels.arrays import COL_STEP, ROW_STEP

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
        for way, (down, across) in enumerate(zip(ROW_STEP, COL_STEP, strict=True)):
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

    def _make_room(self, size: int) -> None:
        from navbake.runtime.kernels.arrays import Entries

        self._entries = Entries(np.empty(size, dtype=np.int32), np.empty(size, dtype=np.int32))

    def _make_graph(self) -> None:
        """Make the graph, still without moves, and twice: with weights and for lengths alone.

        Its buckets fit the weights of all cells, whatever is blocked later.
        """
        from navbake.runtime.kernels.arrays import Graph
        from navbake.runtime.kernels.routes import bucket_width

        flat = self.flat
        weights = flat.weight[flat.free]
        least, most = (float(weights.min()), float(weights.max())) if weights.size else (1.0, 1.0)
        if least < 0:
            raise QueryError(f"expected weights >= 0, got {least:g}: no path is the cheapest then")
        size, longest = float(flat.layout.cell_size.min()), float(flat.links.length.max(initial=0))
        moves = np.zeros(flat.num_cells, dtype=np.uint8)
        same = least if least == most else 0.0
        self.graph = Graph(
            flat.layout, flat.links, moves, flat.weight, same, least,
            *bucket_width(size, least, most, longest),
        )  # fmt: skip
        # the same moves, but every weight counts as 1
        bucket, num_buckets = bucket_width(size, 1.0, 1.0, longest)
        self._lengths_only = self.graph._replace(
            same_weight=1.0, least_weight=1.0, bucket=bucket, num_buckets=num_buckets
        )
