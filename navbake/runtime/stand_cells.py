"""Finds the cells where a robot's base can stand to reach a thing.

A grid knows an object by the cells over whose squares it stands. So the distance from the base's
axis to the object is known to within a cell: the object is nowhere nearer than the nearest of these
squares, and part of it is in each of them, so not beyond the square's farthest corner. A base is in
reach if both distances are. The distance to a point is exact.

Sight runs from the middle of the base's cell to the middle of a cell of the target, and over no
cell with something in the agent's way, except for the target itself and what shares a cell with it:
the table under a cup, the counter round a drawer. Walls and doors always hide what is behind them.
The base faces the nearest cell of the target that is in reach and in sight. This cell is called the
base's aim here.

Window cells are given by row and column in a `Window`, not by flat id.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.known_names import check_choice, list_first
from navbake.runtime.cell_names import NO_ENTRY
from navbake.runtime.flat_grid import FlatGrid, RealNumber, check_distance
from navbake.runtime.inflation import inflate_footprint, ledges_setting
from navbake.runtime.search import NO_CELLS, Search
from navbake.runtime.sight_lines import SightLines, trace_sight_lines
from navbake.types import Bool, Float, Int

NUM_HEADINGS = 64  # headings at which a footprint is tested
REACH_SLACK = 1e-9  # share of a reach by which rounding may change a distance
MAX_PAIRS = 2_000_000  # pairs of cells whose distances are computed at once, to limit memory
MAX_NAMES = 3  # how many names of things in between a sentence lists
MAX_HIDDEN = 100  # from how many cells a sentence looks for what is in between
NO_NUMBERS = np.empty(0)
Value = TypeVar("Value", bound=np.generic)


class StandRules(NamedTuple):
    """Where a base may stand; see the arguments of `PathFinder.stand_poses`.

    Attributes:
        reach: least and greatest distance to the target [m].
        footprint: the outline of the base, shape (k, 2) [m]; None for a disc of the grid's radius.
        facing: ``target``, or None for any heading.
        height: height of the shoulder over the floor [m]; None to measure on the map.
        sight: whether the target must be in sight.
        start: a free position, world x, y, z [m], from which a path must lead to the base; None for
            no such condition.
    """

    reach: tuple[float, float]
    footprint: ArrayLike | None
    facing: str | None
    height: float | None
    sight: bool
    start: ArrayLike | None


class StandTarget(NamedTuple):
    """A thing to be reached.

    Attributes:
        name: the object's name, or the point's numbers.
        cells: flat ids of its cells; of a point, its cell, if it is in one.
        point: world x, y, z [m], or x, y; None for an object.
    """

    name: str
    cells: Int
    point: Float | None


class Window(NamedTuple):
    """The cells of a level round a target.

    Attributes:
        level_cells: the flat ids of the level's cells.
        width: number of columns of the level.
        rows: the window's rows on the level.
        cols: the window's columns on the level.
        cell_size: edge of a cell [m].
    """

    level_cells: slice
    width: int
    rows: slice
    cols: slice
    cell_size: float

    def cut(self, layer: NDArray[Value]) -> NDArray[Value]:
        """Cut the window out of an array by flat id; the result has the shape (rows, cols)."""
        return layer[self.level_cells].reshape(-1, self.width)[self.rows, self.cols]

    def to_cells(self, window_cells: Int) -> Int:
        """Convert rows and columns of the window, shape (n, 2), to flat ids, shape (n,)."""
        rows = window_cells[:, 0] + self.rows.start
        cols = window_cells[:, 1] + self.cols.start
        return np.asarray(self.level_cells.start + rows * self.width + cols)

    def to_window_cells(self, cells: Int) -> Int:
        """Convert flat ids, shape (n,), to rows and columns of the window, shape (n, 2)."""
        rows, cols = np.divmod(cells - self.level_cells.start, self.width)
        return np.stack([rows - self.rows.start, cols - self.cols.start], axis=1)


class Tally(NamedTuple):
    """The numbers of cells that pass each test for a target, and the names of things that hide it.

    Attributes:
        num_in_reach: number of free cells in reach.
        num_with_path: number of these that a path from the start leads to.
        num_in_sight: number of these from which the target is in sight.
        names_between: names of what hides the target, if it is in sight of no cell.
    """

    num_in_reach: int
    num_with_path: int
    num_in_sight: int
    names_between: list[str]


class Stands(NamedTuple):
    """Cells where a base can stand to reach a target.

    Attributes:
        cells: flat ids, shape (n,).
        distances: from their middles to the target [m], shape (n,).
        headings: towards the target; for a footprint, the nearest that is tested [rad], shape (n,).
        tally: how many cells passed each test.
    """

    cells: Int
    distances: Float
    headings: Float
    tally: Tally


# ---------------------------------------------------------------- cells of bases


class StandSite:
    """A grid on which bases look for cells to stand in, by the same rules for each target.

    Args:
        search: the search on the grid, up to date with added obstacles.
        rules: where a base may stand.

    Attributes:
        path_lengths: the lengths of the shortest paths from the start to all cells [m], by flat id,
            inf for no path; None without a start.

    Raises:
        QueryError: a rule is not valid.
    """

    path_lengths: Float | None

    def __init__(self, search: Search, rules: StandRules) -> None:
        _check_rules(rules)
        self._search = search
        self._rules = rules
        self._flat: FlatGrid = search.flat
        self.path_lengths = None
        if rules.start is not None:
            _, start_cell = self._flat.free_cell_at(rules.start)
            self.path_lengths = search.lengths_from(np.array([start_cell]))
        self._fits: Bool | None = None  # at each of `NUM_HEADINGS` headings, by flat id
        if rules.footprint is not None:
            free_masks = inflate_footprint(
                search.grid, rules.footprint, NUM_HEADINGS, ledges=ledges_setting(search.grid)
            )
            self._fits = np.concatenate(
                [mask.reshape(NUM_HEADINGS, -1) for mask in free_masks], axis=1
            )
        self._max_cells = math.ceil(rules.reach[1] / float(self._flat.layout.cell_size.min())) + 1
        self._lines: SightLines = trace_sight_lines(self._max_cells)

    def find_stands(self, target: StandTarget) -> Stands:
        """Find the cells where a base can stand to reach a target, on the levels of its cells.

        Args:
            target: the thing to be reached.
        """
        level_of_cell = self._flat.level_of(target.cells)
        stands_of_levels = [
            self._find_on_level(level, target.cells[level_of_cell == level], target)
            for level in np.unique(level_of_cell).tolist()
        ]
        if len(stands_of_levels) == 1:
            return stands_of_levels[0]
        cells = [stands.cells for stands in stands_of_levels]
        distances = [stands.distances for stands in stands_of_levels]
        headings = [stands.headings for stands in stands_of_levels]
        tallies = [stands.tally for stands in stands_of_levels]
        return Stands(
            cells=np.concatenate([NO_CELLS, *cells]),
            distances=np.concatenate([NO_NUMBERS, *distances]),
            headings=np.concatenate([NO_NUMBERS, *headings]),
            tally=Tally(
                num_in_reach=sum(tally.num_in_reach for tally in tallies),
                num_with_path=sum(tally.num_with_path for tally in tallies),
                num_in_sight=sum(tally.num_in_sight for tally in tallies),
                names_between=[name for tally in tallies for name in tally.names_between],
            ),
        )

    def _find_on_level(self, level: int, target_cells: Int, target: StandTarget) -> Stands:
        """Find the cells of a level where a base can stand to reach a target.

        Args:
            level: number of the level.
            target_cells: flat ids of the target's cells on the level, at least one.
            target: the thing to be reached.
        """
        window = self._cut_window(level, target_cells)
        target_window_cells = window.to_window_cells(target_cells)
        is_free = window.cut(self._flat.free)
        is_target = np.zeros(is_free.shape, dtype=np.bool_)
        is_target[tuple(target_window_cells.T)] = True
        is_aim = is_target
        is_clear = np.ones_like(is_target)
        if self._rules.sight:
            is_aim, is_clear = self._mark_clear(window, is_target, target)
        window_cells = np.argwhere(is_free)
        distances = self._measure(window, window_cells, is_target, target.point)
        min_reach, max_reach = self._rules.reach
        is_in_reach = distances >= min_reach * (1.0 - REACH_SLACK)
        max_distance = math.inf
        if target.point is None:
            max_distance = max_reach * (1.0 + REACH_SLACK) / window.cell_size
        else:
            is_in_reach &= distances <= max_reach * (1.0 + REACH_SLACK)
        window_cells = window_cells[is_in_reach]
        distances = distances[is_in_reach]
        aims = find_nearest_aims(window_cells, is_aim, max_distance)
        is_in_reach = aims[:, 0] >= 0
        num_in_reach = int(np.count_nonzero(is_in_reach))
        if self.path_lengths is not None:
            is_in_reach &= np.isfinite(self.path_lengths[window.to_cells(window_cells)])
        window_cells = window_cells[is_in_reach]
        distances = distances[is_in_reach]
        aims = aims[is_in_reach]
        num_with_path = len(window_cells)
        names_between = []
        if self._rules.sight:
            seen_aims = find_seen_aims(
                self._lines, is_clear, window_cells, aims, is_aim, max_distance
            )
            is_seen = seen_aims[:, 0] >= 0
            if not is_seen.any():
                names_between = self._name_between(window, is_clear, window_cells, aims)
            window_cells = window_cells[is_seen]
            distances = distances[is_seen]
            aims = seen_aims[is_seen]
        cells = window.to_cells(window_cells)
        headings = self._find_headings(window_cells, aims, target_window_cells, cells, target.point)
        num_in_sight = len(cells)
        if self._fits is not None:
            if self._rules.facing is None:
                is_fitting = self._fits[:, cells].any(axis=0)
            else:
                heading_indices = np.rint(headings / (2.0 * math.pi / NUM_HEADINGS)).astype(int)
                headings = wrap_angle(heading_indices * (2.0 * math.pi / NUM_HEADINGS))
                is_fitting = self._fits[heading_indices % NUM_HEADINGS, cells]
            cells = cells[is_fitting]
            distances = distances[is_fitting]
            headings = headings[is_fitting]
        tally = Tally(num_in_reach, num_with_path, num_in_sight, names_between)
        return Stands(cells, distances, headings, tally)

    def _cut_window(self, level: int, target_cells: Int) -> Window:
        """Return the window of a level in which bases may reach some cells."""
        layout = self._flat.layout
        width = int(layout.width[level])
        height = int(layout.height[level])
        cell_size = float(layout.cell_size[level])
        margin = math.ceil(self._rules.reach[1] / cell_size) + 1
        level_cells = self._flat.cells_of(level)
        rows, cols = np.divmod(target_cells - level_cells.start, width)
        return Window(
            level_cells=level_cells,
            width=width,
            rows=slice(max(int(rows.min()) - margin, 0), min(int(rows.max()) + margin + 1, height)),
            cols=slice(max(int(cols.min()) - margin, 0), min(int(cols.max()) + margin + 1, width)),
            cell_size=cell_size,
        )

    def _mark_clear(
        self, window: Window, is_target: Bool, target: StandTarget
    ) -> tuple[Bool, Bool]:
        """Mark the cells of a target that can be seen, and the cells that hide nothing of it.

        Args:
            window: the cells round the target.
            is_target: the target's cells in the window.
            target: the thing to be reached.

        Returns:
            The target's cells without a wall or door, or all if each has one; and these cells, the
            cells without anything in the agent's way, and those where nothing but the target is in
            the way, and what shares a cell with it. Both of the window's shape.
        """
        names = self._search.names
        entry_of_cell = window.cut(names.entry_of_cell)
        has_entry = entry_of_cell != NO_ENTRY
        target_entries = np.unique(entry_of_cell[is_target & has_entry]).tolist()
        companion_names = {target.name}
        for entry_index in target_entries:
            entry = names.entries[entry_index]
            companion_names |= entry.objects - entry.walls - entry.doors
        is_occupied = window.cut(self._search.occupied)
        entry_indices = np.unique(entry_of_cell[(is_occupied | is_target) & has_entry])
        has_wall = np.zeros(len(names.entries) + 1, dtype=np.bool_)
        has_companions_only = np.zeros(len(names.entries) + 1, dtype=np.bool_)
        for entry_index in entry_indices.tolist():
            entry = names.entries[entry_index]
            has_wall[entry_index] = bool(
                entry.blocking & (entry.walls | entry.doors) - {target.name}
            )
            has_companions_only[entry_index] = (
                bool(entry.blocking) and entry.blocking <= companion_names
            )
        is_aim = is_target & ~has_wall[entry_of_cell]  # NO_ENTRY is the last element, False
        if not is_aim.any():
            is_aim = is_target
        is_clear = ~is_occupied | is_aim | has_companions_only[entry_of_cell]
        return is_aim, is_clear

    def _measure(
        self, window: Window, window_cells: Int, is_target: Bool, point: Float | None
    ) -> Float:
        """Measure from the middles of cells to a point, or to the nearest square of an object [m].

        Args:
            window: the cells round the target.
            window_cells: rows and columns in the window, shape (n, 2).
            is_target: the target's cells in the window.
            point: the point; None for an object.
        """
        if point is None:
            return measure_to_squares(window_cells, is_target) * window.cell_size
        positions = self._flat.positions(window.to_cells(window_cells))
        if self._rules.height is None:
            return np.asarray(np.hypot(*(positions[:, :2] - point[:2]).T))
        positions[:, 2] += self._rules.height
        return np.asarray(np.linalg.norm(positions - point, axis=1))

    def _find_headings(
        self,
        window_cells: Int,
        aims: Int,
        target_window_cells: Int,
        cells: Int,
        point: Float | None,
    ) -> Float:
        """Find the headings from cells to the places that they face [rad].

        A base that stands in a cell of an object faces the object's middle.

        Args:
            window_cells: row and column of each cell, shape (n, 2).
            aims: row and column of the object's cell that each faces, shape (n, 2).
            target_window_cells: rows and columns of all of the object's cells, shape (m, 2).
            cells: flat ids of the cells, shape (n,).
            point: the point that they face; None for an object.
        """
        if point is not None:
            point_vectors = point[:2] - self._flat.positions(cells)[:, :2]
            return np.asarray(np.arctan2(point_vectors[:, 1], point_vectors[:, 0]))
        aim_offsets = (aims - window_cells).astype(np.float64)
        is_inside = ~aim_offsets.any(axis=1)
        aim_offsets[is_inside] = target_window_cells.mean(axis=0) - window_cells[is_inside]
        return np.asarray(np.arctan2(0.0 - aim_offsets[:, 0], aim_offsets[:, 1]))  # rows go south

    def _name_between(
        self, window: Window, is_clear: Bool, window_cells: Int, aims: Int
    ) -> list[str]:
        """List the names of what is on lines of sight, sorted.

        Args:
            window: the cells round the target.
            is_clear: the cells that hide nothing.
            window_cells: row and column of each line's start, shape (n, 2).
            aims: row and column of each line's end, shape (n, 2).
        """
        names = self._search.names
        entry_of_cell = window.cut(names.entry_of_cell)
        names_between: set[str] = set()
        for window_cell, aim in zip(window_cells[:MAX_HIDDEN], aims[:MAX_HIDDEN], strict=True):
            line_cells = self._lines.list_cells(window_cell, aim)
            is_hiding = ~is_clear[tuple(line_cells.T)]
            for entry_index in entry_of_cell[tuple(line_cells[is_hiding].T)].tolist():
                if entry_index != NO_ENTRY:
                    names_between |= names.entries[entry_index].blocking
        return sorted(names_between)

    def draw_headings(self, cells: Int, rng: Generator) -> Float:
        """Draw a heading for each cell; of a footprint, one at which it fits [rad].

        Args:
            cells: flat ids, shape (n,).
            rng: the generator.
        """
        if self._fits is None:
            return rng.uniform(-math.pi, math.pi, len(cells))
        random_values = rng.random((NUM_HEADINGS, len(cells)))
        heading_indices = np.where(self._fits[:, cells], random_values, -1.0).argmax(axis=0)
        return wrap_angle(heading_indices * (2.0 * math.pi / NUM_HEADINGS))

    def explain(self, target: StandTarget, tally: Tally) -> str:
        """Say in one sentence why a target has no pose.

        Args:
            target: the thing to be reached.
            tally: how many cells passed each test.
        """
        min_reach, max_reach = self._rules.reach
        if not len(target.cells):
            return f"{target.name} is in no cell: it lies beside the grid, or below its floors"
        if not tally.num_in_reach:
            distances_text = f"{min_reach:g} to {max_reach:g} m from {target.name}"
            radius = self._search.grid.radius
            return f"no cell at {distances_text} is free for a radius of {radius:g} m"
        if not tally.num_with_path:
            cells_text = f"the {tally.num_in_reach} free cells in reach of {target.name}"
            return f"no path leads from the start to {cells_text}"
        if not tally.num_in_sight:
            names_text = list_first(tally.names_between, MAX_NAMES)
            reason = f": {names_text} in between" if names_text else ""
            cells_text = f"none of the {tally.num_with_path} free cells in reach"
            return f"{target.name} is in sight of {cells_text}{reason}"
        cells_text = (
            f"none of the {tally.num_in_sight} cells in reach and in sight of {target.name}"
        )
        return f"the footprint fits in {cells_text}"


def _check_rules(rules: StandRules) -> None:
    """Check the rules that are numbers and names; raises QueryError."""
    expected = "a reach (least, greatest), 0 <= least <= greatest [m]"
    is_pair = isinstance(rules.reach, Sequence) and len(rules.reach) == 2
    if not is_pair or not all(isinstance(length, RealNumber) for length in rules.reach):
        raise QueryError(
            f"expected {expected}, got {rules.reach!r}",
            key="reach",
            value=rules.reach,
            expected=expected,
        )
    min_reach, max_reach = rules.reach
    if not 0.0 <= min_reach <= max_reach < math.inf:
        raise QueryError(
            f"expected {expected}, got {rules.reach!r}",
            key="reach",
            value=rules.reach,
            expected=expected,
        )
    if rules.facing is not None:
        check_choice(rules.facing, ("target",), "facing", QueryError)
    if rules.height is not None:
        check_distance(rules.height, "height")


# ---------------------------------------------------------------- distances and aims, in cells


def mark_rim(is_target: Bool) -> Bool:
    """Mark the cells of a mask that have a neighbour outside of it, over an edge."""
    padded_mask = np.pad(is_target, 1)
    is_inside = (
        padded_mask[:-2, 1:-1]
        & padded_mask[2:, 1:-1]
        & padded_mask[1:-1, :-2]
        & padded_mask[1:-1, 2:]
    )
    return np.asarray(is_target & ~is_inside)


def measure_to_squares(window_cells: Int, is_target: Bool) -> Float:
    """Measure the distance from each cell's middle to the nearest marked square, in cells.

    Args:
        window_cells: rows and columns of the cells, shape (n, 2).
        is_target: the marked cells, at least one.

    Returns:
        Distances, shape (n,); 0 in marked cells.
    """
    # from middle to middle in half cells; the square begins a half cell before its middle
    rim_cells = np.argwhere(mark_rim(is_target))
    squared_distances = np.empty(len(window_cells), dtype=np.int64)
    chunk_size = max(MAX_PAIRS // len(rim_cells), 1)
    for first_index in range(0, len(window_cells), chunk_size):
        chunk = np.s_[first_index : first_index + chunk_size]
        row_offsets = 2 * np.abs(window_cells[chunk, :1] - rim_cells[:, 0])
        col_offsets = 2 * np.abs(window_cells[chunk, 1:] - rim_cells[:, 1])
        chunk_squared_distances = (
            np.maximum(row_offsets - 1, 0) ** 2 + np.maximum(col_offsets - 1, 0) ** 2
        )
        squared_distances[chunk] = chunk_squared_distances.min(axis=1)
    squared_distances[is_target[tuple(window_cells.T)]] = 0
    return np.sqrt(squared_distances) / 2.0


def measure_to_corners(window_cells: Int, aim_cells: Int) -> Int:
    """Measure the distance from each cell's middle to the farthest corner of each of some squares.

    Args:
        window_cells: rows and columns of the cells, shape (n, 2).
        aim_cells: rows and columns of the squares, shape (k, 2).

    Returns:
        Squared distances in half cells, shape (n, k).
    """
    row_offsets = 2 * np.abs(window_cells[:, :1] - aim_cells[:, 0]) + 1
    col_offsets = 2 * np.abs(window_cells[:, 1:] - aim_cells[:, 1]) + 1
    return np.asarray(row_offsets**2 + col_offsets**2)


def find_nearest_aims(window_cells: Int, is_aim: Bool, max_distance: float) -> Int:
    """Find each cell's aim without regard to sight: the nearest cell of a target, if in reach.

    A cell of a target is in reach if all of its square is.

    Args:
        window_cells: rows and columns of the cells, shape (n, 2).
        is_aim: the cells of the target that count, at least one.
        max_distance: greatest distance to the farthest corner of a square, in cells.

    Returns:
        Rows and columns of the nearest cells, shape (n, 2); -1 where none is in reach.
    """
    rim_cells = np.argwhere(mark_rim(is_aim))
    aims = np.full((len(window_cells), 2), -1, dtype=np.int64)
    chunk_size = max(MAX_PAIRS // len(rim_cells), 1)
    for first_index in range(0, len(window_cells), chunk_size):
        chunk = np.s_[first_index : first_index + chunk_size]
        squared_distances = measure_to_corners(window_cells[chunk], rim_cells)
        nearest_indices = squared_distances.argmin(axis=1)
        is_in_reach = (
            squared_distances[np.arange(len(squared_distances)), nearest_indices]
            <= (2.0 * max_distance) ** 2
        )
        aims[chunk][is_in_reach] = rim_cells[nearest_indices[is_in_reach]]
    is_inside = is_aim[tuple(window_cells.T)]
    if max_distance >= math.sqrt(0.5):
        aims[is_inside] = window_cells[is_inside]
    return aims


def find_seen_aims(
    lines: SightLines,
    is_clear: Bool,
    window_cells: Int,
    nearest_aims: Int,
    is_aim: Bool,
    max_distance: float,
) -> Int:
    """Find each cell's aim: the nearest cell of a target that is in reach and in sight.

    Args:
        lines: lines of sight of all lengths up to the reach.
        is_clear: the cells that hide nothing.
        window_cells: rows and columns of the cells, shape (n, 2).
        nearest_aims: the result of `find_nearest_aims` for these cells, all of them in reach.
        is_aim: the cells of the target that count.
        max_distance: greatest distance to the farthest corner of a square, in cells.

    Returns:
        Rows and columns of the nearest cells in sight, shape (n, 2); -1 for none.
    """
    aims = nearest_aims.copy()
    is_seen = lines.find_clear(is_clear, window_cells, nearest_aims)
    hidden_indices = np.flatnonzero(~is_seen)
    aims[hidden_indices] = -1
    rim_cells = np.argwhere(mark_rim(is_aim))
    chunk_size = max(MAX_PAIRS // len(rim_cells), 1)
    for first_index in range(0, len(hidden_indices), chunk_size):
        chunk = hidden_indices[first_index : first_index + chunk_size]
        squared_distances = measure_to_corners(window_cells[chunk], rim_cells)
        cell_indices, aim_indices = np.nonzero(squared_distances <= (2.0 * max_distance) ** 2)
        is_seen = lines.find_clear(
            is_clear, window_cells[chunk[cell_indices]], rim_cells[aim_indices]
        )
        cell_indices = cell_indices[is_seen]
        aim_indices = aim_indices[is_seen]
        # the nearest of each place first
        sort_indices = np.lexsort([squared_distances[cell_indices, aim_indices], cell_indices])
        seen_indices, first_indices = np.unique(cell_indices[sort_indices], return_index=True)
        aims[chunk[seen_indices]] = rim_cells[aim_indices[sort_indices[first_indices]]]
    return aims


def wrap_angle(angles: Float) -> Float:
    """Bring angles into the range -pi to pi by whole turns [rad]."""
    return np.asarray(np.mod(angles + math.pi, 2.0 * math.pi) - math.pi)
