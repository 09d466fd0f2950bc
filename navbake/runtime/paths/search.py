"""A grid made ready to be searched: its walk, the moves of each cell, and room to work in."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.block_state import NARROW, TIGHT, BlockState, Window
from navbake.runtime.flat_grid import Walk, make_walk
from navbake.runtime.inflation.margins import find_room
from navbake.runtime.places.locate import split_cells

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid, SceneGrid2D

LAST_SEARCH = 2**31 // 64 - 2  # `mark` is int32 and holds the number of a search times 64
FIRST_ROOM = 1 << 15  # entries for open cells at first


class Search:
    """Searches the cells of all levels of a grid. Not to be shared by threads.

    What is written into the grid's arrays later is not seen; what `grid.block` blocks is, at each
    `update`.

    Attributes:
        grid: the grid.
        walk: the cells; those that are blocked are not free.
        moves: by flat id, uint8: a bit for each way that a step leads, see
            `navbake.runtime.kernels.moves`.
        cut_corners: whether a diagonal step needs nothing but its target.
        same_weight: the weight of all free cells, 0 where they differ.
        wide: by flat id, bool: cells with room for a diagonal step, see
            `navbake.runtime.inflation.margins`.
        roomy: by flat id, bool: free cells with room all over.
        version: grows with each change that `update` finds.
    """

    def __init__(self, grid: NavGrid, *, cut_corners: bool = False) -> None:
        self.grid = grid
        clean = grid.without_blocks()
        self.walk: Walk = make_walk(clean)
        self.cut_corners = cut_corners
        self._room = find_room(clean)
        self.wide, self.roomy = (v.copy() for v in self._room or (self.walk.free,) * 2)
        self.roomy &= self.walk.free
        self.moves = np.zeros(self.walk.num_cells, dtype=np.uint8)
        self._link_length = link_lengths(self.walk)
        self._link_from = np.zeros(len(self.walk.link_cell), dtype=np.int64)
        self._weigh(self.walk.weight[self.walk.free])
        self._mark = np.zeros(self.walk.num_cells, dtype=np.int32)
        self._cost = np.zeros(self.walk.num_cells, dtype=np.float64)
        self._number = 0
        self._make_room(FIRST_ROOM)
        self.version = 0
        self._seen = [0] * self.walk.num_levels
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
        """Copy a window of a level that changed, and find the moves in and round it anew."""
        row0, row1, col0, col1 = window
        inside, walk = np.s_[row0:row1, col0:col1], self.walk
        of_level = slice(int(walk.start[number]), int(walk.start[number + 1]))

        def cut(array: NDArray[Any]) -> NDArray[Any]:
            return array[of_level].reshape(level.shape)[inside]

        weight = level.weights[inside].astype(np.float64)
        free = np.isfinite(weight)
        cut(walk.free)[:] = free
        cut(walk.weight)[:] = np.where(free, weight, np.inf)
        if self._room is None:
            cut(self.wide)[:] = cut(self.roomy)[:] = free
        else:
            masks = zip((self.wide, self.roomy), self._room, (NARROW, TIGHT), strict=True)
            for mask, of_bake, layer in masks:
                held = changes.count[layer].reshape(level.shape)[inside]
                cut(mask)[:] = cut(of_bake) & (held == 0) & free
        self._find_moves(number, (row0 - 1, row1 + 1, col0 - 1, col1 + 1))

    def _find_moves(self, number: int, window: Window) -> None:
        from navbake.runtime.kernels.moves import find_moves

        walk = self.walk
        height, width = int(walk.height[number]), int(walk.width[number])
        rows = max(window[0], 0), min(window[1], height)
        cols = max(window[2], 0), min(window[3], width)
        find_moves(
            self.moves, int(walk.start[number]), width, height, *rows, *cols, walk.free, self.wide,
            walk.floor, walk.max_step, self.cut_corners,
        )  # fmt: skip

    def route(self, origin: int, goals: NDArray[np.int64]) -> NDArray[np.int64] | None:
        """Find the cheapest route to the cheapest of several goals.

        Args:
            origin: flat id of a free cell.
            goals: flat ids of free cells, shape (n,), n >= 1.

        Returns:
            Flat ids of the cells from the origin to the goal, shape (m,); None for no route.
        """
        from navbake.runtime.kernels.route import NO_ROOM, find_route, goal_box, trace_route

        walk = self.walk
        box = goal_box(goals, walk.start, walk.width, walk.x_min, walk.y_max, walk.cell_size)
        links = (walk.link_cell, walk.link_start, walk.link_target, self._link_length)
        while True:
            self._next_number()
            reached, _ = find_route(
                origin, goals, box, self.moves, walk.weight, self.same_weight, self._least,
                walk.start, walk.width, walk.cell_size, *links, *self._buckets, self._number,
                self._mark, self._cost, self._link_from, self._entry_cell, self._entry_next,
            )  # fmt: skip
            if reached != NO_ROOM:
                break
            self._make_room(4 * len(self._entry_cell))
        if reached < 0:
            return None
        cells: NDArray[np.int64] = trace_route(
            reached, self._mark, walk.start, walk.width, walk.link_cell, self._link_from
        )
        return cells

    def field(self, goals: NDArray[np.int64], *, weighted: bool = True) -> NDArray[np.float64]:
        """Find the cost of the cheapest route from every cell to the nearest of several goals.

        Args:
            goals: flat ids of free cells, shape (n,).
            weighted: count each step times the weight of the cell that it leads to; else its
                length alone.

        Returns:
            By flat id, shape (num_cells,), float64; inf where no route leads to a goal.
        """
        from navbake.runtime.kernels.field import find_field

        walk = self.walk
        same, buckets = (
            (self.same_weight, self._buckets) if weighted else (1.0, self._length_buckets)
        )
        while True:
            field = np.full(walk.num_cells, np.inf)
            if find_field(
                goals, self.moves, walk.weight, same, walk.start, walk.width, walk.cell_size,
                walk.link_cell, walk.link_start, walk.link_target, self._link_length, *buckets,
                field, self._entry_cell, self._entry_next,
            ):  # fmt: skip
                return field
            self._make_room(4 * len(self._entry_cell))

    def lengths(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        """The lengths of the steps of a route [m], shape (len(cells) - 1,)."""
        walk = self.walk
        level, row, col = split_cells(walk, cells)
        is_diagonal = (np.diff(row) != 0) & (np.diff(col) != 0)
        length = walk.cell_size[level[1:]] * np.where(is_diagonal, math.sqrt(2.0), 1.0)
        for i in np.flatnonzero(self.are_links(cells)):
            length[i] = self._length_of_link(cells[i], cells[i + 1])
        return np.asarray(length)

    def are_links(self, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which steps of a route lead to another level, or far, shape (len(cells) - 1,), bool."""
        if not len(self.walk.link_cell):
            return np.zeros(len(cells) - 1, dtype=np.bool_)
        level, row, col = (np.diff(v) for v in split_cells(self.walk, cells))
        far = (np.abs(row) > 1) | (np.abs(col) > 1)
        return np.asarray((level != 0) | far)

    def _length_of_link(self, cell: int, target: int) -> float:
        walk = self.walk
        slot = int(np.searchsorted(walk.link_cell, cell))
        first, last = walk.link_start[slot : slot + 2]
        return float(self._link_length[first:last][walk.link_target[first:last] == target][0])

    def _weigh(self, weights: NDArray[np.float64]) -> None:
        """Look at the weights of free cells; what is blocked later takes none of this away."""
        from navbake.runtime.kernels.buckets import bucket_width

        least, most = (float(weights.min()), float(weights.max())) if weights.size else (1.0, 1.0)
        if least < 0:
            raise QueryError(f"expected weights >= 0, got {least:g}: no path is the cheapest then")
        self._least = least
        self.same_weight = least if least == most else 0.0
        size = float(self.walk.cell_size.min())
        longest = float(self._link_length.max(initial=0.0))
        self._buckets: tuple[float, int] = bucket_width(size, least, most, longest)
        self._length_buckets: tuple[float, int] = bucket_width(size, 1.0, 1.0, longest)

    def _next_number(self) -> None:
        self._number += 1
        if self._number > LAST_SEARCH:
            self._mark[:] = 0
            self._number = 1

    def _make_room(self, size: int) -> None:
        self._entry_cell = np.empty(size, dtype=np.int32)
        self._entry_next = np.empty(size, dtype=np.int32)


def link_lengths(walk: Walk) -> NDArray[np.float64]:
    """How long each link is [m], shape (len(link_target),).

    It is the octile distance between the centres of its cells, seen from above, and at least a
    cell: between neighbours on one lattice, as navbake links them, exactly a cell.
    """
    source = np.repeat(walk.link_cell, np.diff(walk.link_start))
    one, other = walk.positions(source), walk.positions(walk.link_target)
    across, along = np.sort(np.abs(one - other)[:, :2], axis=1).T
    size = np.minimum(
        walk.cell_size[walk.level_of(source)], walk.cell_size[walk.level_of(walk.link_target)]
    )
    return np.asarray(np.maximum(along + (math.sqrt(2.0) - 1.0) * across, size))
