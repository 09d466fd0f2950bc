"""Finds the cells where a robot's base can stand to reach a thing.

A grid knows an object by the cells over whose squares it stands, and by its upright box. In this
module, a *square* of the object is the part of such a cell's square that the box covers; a point is
a square without an extent. The object lies within its squares, and a part of it is in each of them.
So it is nowhere nearer to a base than its nearest square, and some of it is nearer than the
farthest corner of any square. A base is in reach if the nearest square is not nearer than the least
distance, and one square lies wholly within the greatest.

Sight is a line from the eye, over the middle of the base's cell, to the middle of a cell of the
target. It ends at the height of the target that is nearest to the eye's. A thing hides the target
if the line runs over one of the thing's cells, between the lower and the upper end of its box. What
is in the agent's way is endlessly high if the grid has no box of it. There are two exceptions:

- In the target's own cells, nothing hides it. Cells that also have a wall or a door are not its
  own, unless it has no others.
- In the cells beside these, things that share a cell with the target don't hide it. It stands on
  them or in them.

The base faces the nearest square that is in reach and in sight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.known_names import check_choice, list_first
from navbake.runtime.flat_grid import FlatGrid, RealNumber, check_distance
from navbake.runtime.inflation import check_polygon, find_free_headings, ledges_setting
from navbake.runtime.name_map import NO_ENTRY
from navbake.runtime.places import snap_to_cells
from navbake.runtime.search import NO_CELLS, Search
from navbake.runtime.sight_lines import Obstructions, SightLines, trace_sight_lines
from navbake.types import Bool, Float, Int, ScalarT

NUM_HEADINGS = 64  # headings at which a footprint is tested
HEADING_STEP = 2.0 * math.pi / NUM_HEADINGS  # [rad]
REACH_SLACK = 1e-9  # share of a reach by which rounding may change a distance
MAX_PAIRS = 2_000_000  # pairs of bases and squares that are measured at once, to limit memory
MAX_SIGHT_CELLS = 200  # cells over which a line of sight may lead: 300 MB for the table of lines
MAX_NAMES = 3  # how many names of things in between a sentence lists
DISTANCE_DIGITS = 9  # decimal digits of distances that are compared
MIDDLE_SLACK = 1e-9  # how near to the middle of a square a base stands in it [m]
NO_NUMBERS = np.empty(0)


class StandRules(NamedTuple):
    """Where a base may stand; see the arguments of `PathFinder.stand_poses`.

    Attributes:
        reach: least and greatest distance to the target [m].
        footprint: the outline of the base, shape (k, 2) [m]; None for a disc of the grid's radius.
        facing: ``target``, or None for any heading.
        height: height of the shoulder over the floor [m]; None to measure on the map.
        sight: height of the eye over the floor, which must see the target [m]; True for the agent's
            height, False for no such condition.
        start: a free position, world x, y, z [m], from which a path must lead to the base; None for
            no such condition.
    """

    reach: tuple[float, float]
    footprint: ArrayLike | None
    facing: str | None
    height: float | None
    sight: bool | float
    start: ArrayLike | None


class StandTarget(NamedTuple):
    """A thing to be reached.

    Attributes:
        name: the object's name, or the point's numbers.
        cells: flat ids of its cells; of a point, its cell, if it is in one.
        box: x, y, z of the lower, then of the upper corner of its box, world [m], shape (6,); for a
            point, both are the point. None if the grid has no box of the object.
    """

    name: str
    cells: Int
    box: Float | None


class Window(NamedTuple):
    """The cells of a level round a target. Places are rows and columns in it, shape (n, 2).

    Attributes:
        level_cells: the flat ids of the level's cells.
        width: number of columns of the level.
        rows: the window's rows on the level.
        cols: the window's columns on the level.
        row_y: world y of the middles of its rows [m].
        col_x: world x of the middles of its columns [m].
    """

    level_cells: slice
    width: int
    rows: slice
    cols: slice
    row_y: Float
    col_x: Float

    def cut(self, layer: NDArray[ScalarT]) -> NDArray[ScalarT]:
        """Return the window's part of an array by flat id, shape (rows, cols)."""
        return layer[self.level_cells].reshape(-1, self.width)[self.rows, self.cols]

    def to_points(self, places: Int) -> Float:
        """Return the middles of places, world x, y [m], shape (n, 2)."""
        points = np.empty(places.shape)
        points[:, 0] = self.col_x[places[:, 1]]
        points[:, 1] = self.row_y[places[:, 0]]
        return points

    def to_cells(self, places: Int) -> Int:
        """Convert places to flat ids, shape (n,)."""
        rows = places[:, 0] + self.rows.start
        cols = places[:, 1] + self.cols.start
        return np.asarray(self.level_cells.start + rows * self.width + cols)

    def to_places(self, cells: Int) -> Int:
        """Convert flat ids, shape (n,), to places."""
        rows, cols = np.divmod(cells - self.level_cells.start, self.width)
        return np.stack([rows - self.rows.start, cols - self.cols.start], axis=1)


class Tally(NamedTuple):
    """How many cells pass each test for a target, and what hides it from the others.

    Attributes:
        num_in_reach: number of free cells in reach.
        num_with_path: number of these that a path from the start leads to.
        num_in_sight: number of these from which the target is in sight.
        names_between: names of the things that hide the target, if it is in sight of no cell.
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


class TargetView(NamedTuple):
    """A target on a level, and what may hide it.

    Attributes:
        window: the cells round it.
        target: the target.
        aim_places: the cells that bases see and face, shape (k, 2).
        squares: their squares, cut to the target's box, shape (k, 4) [m].
        obstructions: the things in the window's cells, without the target and its cells.
    """

    window: Window
    target: StandTarget
    aim_places: Int
    squares: Float
    obstructions: Obstructions


# ---------------------------------------------------------------- cells of bases


class StandSite:
    """A grid on which bases look for cells to stand in, by the same rules for each target.

    Args:
        search: the search on the grid, up to date with added obstacles.
        rules: where a base may stand.
        targets: the targets that will be asked for. A footprint is tested round them.

    Attributes:
        path_lengths: the lengths of the shortest paths from the start to all cells [m], by flat id,
            inf for no path; None without a start.

    Raises:
        QueryError: a rule is not valid.
    """

    path_lengths: Float | None

    def __init__(self, search: Search, rules: StandRules, targets: Sequence[StandTarget]) -> None:
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
            self._fits = self._test_footprint(check_polygon(rules.footprint), targets)
        max_cells = 0
        if rules.sight is not False:
            max_cells = _count_cells_in_reach(self._flat, rules.reach[1])
        self._lines: SightLines = trace_sight_lines(max_cells)

    def find_stands(self, target: StandTarget) -> Stands:
        """Find the cells where a base can stand to reach a target, on the levels of its cells.

        Args:
            target: the thing to be reached.
        """
        level_of_cell = self._flat.level_of(target.cells)
        squares = self._squares_of(target)
        stands_of_levels = [
            self._find_on_level(target, squares, level, level_of_cell == level)
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

    def _test_footprint(self, outline: Float, targets: Sequence[StandTarget]) -> Bool:
        """Mark the cells in reach of targets where a footprint fits.

        Args:
            outline: the footprint, from `check_polygon`, shape (n, 2) [m].
            targets: the things to be reached.

        Returns:
            By heading and flat id, shape (`NUM_HEADINGS`, cells); False far from all targets.
        """
        fits = np.zeros((NUM_HEADINGS, self._flat.num_cells), dtype=np.bool_)
        cells = np.concatenate([NO_CELLS, *(target.cells for target in targets)])
        level_of_cell = self._flat.level_of(cells)
        for level in np.unique(level_of_cell).tolist():
            window = self._cut_window(level, cells[level_of_cell == level], self._rules.reach[1])
            free_headings = find_free_headings(
                self._search.grid,
                level,
                (window.rows, window.cols),
                outline,
                NUM_HEADINGS,
                ledges_setting(self._search.grid),
            )
            window_cells = window.cut(np.arange(self._flat.num_cells)).ravel()
            fits[:, window_cells] = free_headings.reshape(NUM_HEADINGS, -1)
        return fits

    def _find_on_level(
        self, target: StandTarget, target_squares: Float, level: int, on_level: Bool
    ) -> Stands:
        """Find the cells of a level where a base can stand to reach a target.

        Args:
            target: the thing to be reached.
            target_squares: the squares of its cells on all levels, shape (k, 4) [m].
            level: number of the level.
            on_level: which of these cells are on the level, at least one, shape (k,).
        """
        target_cells = target.cells[on_level]
        window = self._cut_window(level, target_cells, self._rules.reach[1])
        is_aim = self._find_aims(target, target_cells)
        aim_places = window.to_places(target_cells[is_aim])
        squares = target_squares[on_level][is_aim]
        min_reach, max_reach = self._rules.reach
        bases = np.argwhere(window.cut(self._flat.free))
        points = window.to_points(bases)
        # what is too far from the rectangle round all squares is too far from each
        bounds = np.append(target_squares[:, :2].min(axis=0), target_squares[:, 2:].max(axis=0))
        is_near = measure_to_nearest(points, bounds[None]) <= max_reach * (1.0 + REACH_SLACK)
        bases = bases[is_near]
        points = points[is_near]
        cells = window.to_cells(bases)
        height_gaps = self._measure_height_gaps(cells, target.box)
        # how far the farthest corner of a square may be on the map
        squared_limits = (max_reach * (1.0 + REACH_SLACK)) ** 2 - height_gaps**2
        limits = np.where(squared_limits >= 0.0, np.sqrt(np.maximum(squared_limits, 0.0)), -1.0)
        aim_index = find_nearest_square(points, squares, limits)
        distances = np.hypot(measure_to_nearest(points, target_squares), height_gaps)
        is_far_enough = distances >= min_reach * (1.0 - REACH_SLACK)
        in_reach = np.flatnonzero(is_far_enough & (aim_index >= 0))
        aim_index = aim_index[in_reach]
        num_in_reach = len(in_reach)
        if self.path_lengths is not None:
            has_path = np.isfinite(self.path_lengths[cells[in_reach]])
            in_reach = in_reach[has_path]
            aim_index = aim_index[has_path]
        num_with_path = len(in_reach)
        names_between: list[str] = []
        if self._rules.sight is not False:
            view = self._look_at(window, target, aim_places, squares)
            seen_index = self._find_seen_squares(
                view, bases[in_reach], points[in_reach], limits[in_reach], aim_index
            )
            is_seen = seen_index >= 0
            if not is_seen.any() and num_with_path:
                names_between = self._name_between(view, bases[in_reach], aim_index)
            in_reach = in_reach[is_seen]
            aim_index = seen_index[is_seen]
        cells = cells[in_reach]
        headings = find_headings(points[in_reach], squares[aim_index], squares)
        distances = distances[in_reach]
        tally = Tally(num_in_reach, num_with_path, len(cells), names_between)
        if self._fits is None:
            return Stands(cells, distances, headings, tally)
        if self._rules.facing is None:
            is_fitting = self._fits[:, cells].any(axis=0)
        else:
            heading_index = np.rint(headings / HEADING_STEP).astype(np.int64)
            headings = wrap_angle(heading_index * HEADING_STEP)
            is_fitting = self._fits[heading_index % NUM_HEADINGS, cells]
        return Stands(cells[is_fitting], distances[is_fitting], headings[is_fitting], tally)

    def _cut_window(self, level: int, target_cells: Int, distance: float) -> Window:
        """Return the window of a level that has all cells within a distance of some cells [m]."""
        layout = self._flat.layout
        width = int(layout.width[level])
        height = int(layout.height[level])
        cell_size = float(layout.cell_size[level])
        margin = math.ceil(distance / cell_size) + 1
        level_cells = self._flat.cells_of(level)
        rows, cols = np.divmod(target_cells - level_cells.start, width)
        first_row = max(int(rows.min()) - margin, 0)
        first_col = max(int(cols.min()) - margin, 0)
        window_rows = slice(first_row, min(int(rows.max()) + margin + 1, height))
        window_cols = slice(first_col, min(int(cols.max()) + margin + 1, width))
        row_numbers = np.arange(window_rows.start, window_rows.stop)
        col_numbers = np.arange(window_cols.start, window_cols.stop)
        return Window(
            level_cells=level_cells,
            width=width,
            rows=window_rows,
            cols=window_cols,
            row_y=layout.y_max[level] - (row_numbers + 0.5) * cell_size,
            col_x=layout.x_min[level] + (col_numbers + 0.5) * cell_size,
        )

    def _measure_height_gaps(self, cells: Int, box: Float | None) -> Float:
        """Measure from shoulders to the heights of a target [m]; 0 where the map alone counts.

        Args:
            cells: flat ids of the bases' cells.
            box: the target's box; not None where the rules have a height.
        """
        if self._rules.height is None or box is None:
            return np.zeros(len(cells))
        shoulders = self._flat.floor_heights(cells) + self._rules.height
        return np.asarray(np.maximum(np.maximum(box[2] - shoulders, shoulders - box[5]), 0.0))

    def _find_aims(self, target: StandTarget, target_cells: Int) -> Bool:
        """Mark the cells of a target that bases see and face: those without a wall or a door.

        Args:
            target: the thing to be reached.
            target_cells: flat ids of its cells on a level, shape (k,).

        Returns:
            Shape (k,); all are marked if each has a wall or a door, or if sight doesn't count.
        """
        all_cells = np.ones(len(target_cells), dtype=np.bool_)
        if self._rules.sight is False:
            return all_cells
        names = self._search.names
        entry_of_cell = names.entry_of_cell[target_cells]
        has_wall = np.zeros(len(names.entries) + 1, dtype=np.bool_)  # NO_ENTRY: the last
        for entry_number in np.unique(entry_of_cell).tolist():
            if entry_number != NO_ENTRY:
                entry = names.entries[entry_number]
                has_wall[entry_number] = bool((entry.walls | entry.doors) - {target.name})
        is_without_wall = ~has_wall[entry_of_cell]
        return is_without_wall if is_without_wall.any() else all_cells

    def _look_at(
        self, window: Window, target: StandTarget, aim_places: Int, squares: Float
    ) -> TargetView:
        """Gather what hides a target, and from where it is seen."""
        names = self._search.names
        entry_of_cell = window.cut(names.entry_of_cell)
        bottoms = names.bottoms[entry_of_cell]
        tops = names.tops[entry_of_cell]
        # nameless things, and those that were added, are endlessly high
        is_nameless = window.cut(self._search.occupied) & ~names.has_blocking[entry_of_cell]
        bottoms[is_nameless, -1] = -np.inf
        tops[is_nameless, -1] = np.inf
        things = names.names_of_entry[entry_of_cell]
        is_aim = np.zeros(entry_of_cell.shape, dtype=np.bool_)
        is_aim[tuple(aim_places.T)] = True
        hides_nothing = np.zeros(things.shape, dtype=np.bool_)
        companions: set[str] = set()
        for entry_number in np.unique(entry_of_cell[is_aim]).tolist():
            if entry_number != NO_ENTRY:
                entry = names.entries[entry_number]
                companions |= entry.objects - entry.walls - entry.doors
        if companions:
            # what it stands on or in may end in a cell beside its own: the worktop over a drawer
            companion_numbers = [names.number_of_name[name] for name in companions]
            hides_nothing = mark_near(is_aim)[..., None] & np.isin(things, companion_numbers)
        if target.name in names.number_of_name:
            hides_nothing |= things == names.number_of_name[target.name]
        hides_nothing[is_aim] = True
        bottoms[hides_nothing] = np.inf
        tops[hides_nothing] = -np.inf
        has_thing = np.asarray((tops > bottoms).any(axis=-1))
        obstructions = Obstructions(bottoms, tops, has_thing)
        return TargetView(window, target, aim_places, squares, obstructions)

    def _find_hidden(self, view: TargetView, bases: Int, aim_index: Int) -> Bool:
        """Mark the steps of lines of sight at which something is in between, shape (n, steps).

        Args:
            view: the things that may hide the target.
            bases: places of the bases, shape (n, 2).
            aim_index: for each base, the index of the square that its line leads to, shape (n,).
        """
        floors = self._flat.floor_heights(view.window.to_cells(bases))
        eye_height = self._search.grid.agent_height
        if self._rules.sight is not True:
            eye_height = float(self._rules.sight)
        eyes = floors + eye_height
        heights = eyes
        if view.target.box is not None:
            heights = np.clip(eyes, view.target.box[2], view.target.box[5])
        return self._lines.find_hidden(
            view.obstructions, bases, view.aim_places[aim_index], eyes, heights
        )

    def _find_seen_squares(
        self, view: TargetView, bases: Int, points: Float, limits: Float, nearest_index: Int
    ) -> Int:
        """Find the nearest square in sight of each base, and in reach.

        Args:
            view: the things that may hide the target.
            bases: places of the bases, shape (n, 2).
            points: their middles, world x, y [m], shape (n, 2).
            limits: how far the farthest corner of a square may be from each [m], shape (n,).
            nearest_index: index of the square that is nearest to each, shape (n,).

        Returns:
            Index of each base's square, shape (n,); -1 for none.
        """
        is_hidden = self._find_hidden(view, bases, nearest_index).any(axis=1)
        seen_index = np.where(is_hidden, -1, nearest_index)
        hidden = np.flatnonzero(is_hidden)
        chunk_size = max(MAX_PAIRS // len(view.squares), 1)
        for first in range(0, len(hidden), chunk_size):
            chunk = hidden[first : first + chunk_size]
            corner_distances = measure_to_farthest(points[chunk], view.squares)
            base_index, aim_index = np.nonzero(corner_distances <= limits[chunk, None])
            is_seen = ~self._find_hidden(view, bases[chunk[base_index]], aim_index).any(axis=1)
            base_index = base_index[is_seen]
            aim_index = aim_index[is_seen]
            # the nearest of each base first
            order = np.lexsort([corner_distances[base_index, aim_index], base_index])
            seen_bases, first_indices = np.unique(base_index[order], return_index=True)
            seen_index[chunk[seen_bases]] = aim_index[order[first_indices]]
        return seen_index

    def _name_between(self, view: TargetView, bases: Int, aim_index: Int) -> list[str]:
        """List the names of what is on lines of sight, sorted.

        Args:
            view: the things that may hide the target.
            bases: places of the bases, shape (n, 2).
            aim_index: index of the square that each line leads to, shape (n,).
        """
        names = self._search.names
        entry_of_cell = view.window.cut(names.entry_of_cell)
        is_hidden = self._find_hidden(view, bases, aim_index)
        names_between: set[str] = set()
        for base, aim_place, is_hidden_at_step in zip(
            bases, view.aim_places[aim_index], is_hidden, strict=True
        ):
            line_places = self._lines.list_cells(base, aim_place)
            hiding_places = line_places[is_hidden_at_step[: len(line_places)]]
            for entry_number in entry_of_cell[tuple(hiding_places.T)].tolist():
                if entry_number != NO_ENTRY:
                    names_between |= names.entries[entry_number].blocking
        return sorted(names_between - {view.target.name})

    def fits(self, cells: Int, headings: Float) -> Bool:
        """Mark the poses at which the footprint fits, at the nearest tested heading.

        Args:
            cells: flat ids of free cells, shape (n,).
            headings: a heading for each [rad], shape (n,).

        Returns:
            Shape (n,); all are marked if the rules have no footprint.
        """
        if self._fits is None:
            return np.ones(len(cells), dtype=np.bool_)
        heading_index = np.rint(headings / HEADING_STEP).astype(np.int64) % NUM_HEADINGS
        return self._fits[heading_index, cells]

    def draw_headings(self, cells: Int, rng: Generator) -> Float:
        """Draw a heading for each cell; of a footprint, one at which it fits [rad].

        Args:
            cells: flat ids, shape (n,).
            rng: the generator.
        """
        if self._fits is None:
            return rng.uniform(-math.pi, math.pi, len(cells))
        ranks = rng.random((NUM_HEADINGS, len(cells)))
        heading_index = np.where(self._fits[:, cells], ranks, -1.0).argmax(axis=0)
        return wrap_angle(heading_index * HEADING_STEP)

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
            distances = f"{min_reach:g} to {max_reach:g} m from {target.name}"
            if self._rules.height is not None:
                distances += f", measured from a shoulder {self._rules.height:g} m above the floor,"
            radius = self._search.grid.radius
            reason = f"no cell at {distances} is free for a radius of {radius:g} m"
            nearest_distance = self._measure_to_free_cells(target)
            if math.isfinite(nearest_distance):
                reason += f": the nearest free cell is at {nearest_distance:.2f} m"
            return reason
        if not tally.num_with_path:
            cells_text = f"the {tally.num_in_reach} free cells in reach of {target.name}"
            return f"no path leads from the start to {cells_text}"
        if not tally.num_in_sight:
            names = list_first(tally.names_between, MAX_NAMES)
            reason = f": {names} in between" if names else ""
            cells_text = f"none of the {tally.num_with_path} free cells in reach"
            return f"{target.name} is in sight of {cells_text}{reason}"
        cells_text = (
            f"none of the {tally.num_in_sight} cells in reach and in sight of {target.name}"
        )
        return f"the footprint fits in {cells_text}"

    def _measure_to_free_cells(self, target: StandTarget) -> float:
        """Measure the distance of the nearest free cell to a target, on the levels of its cells.

        Args:
            target: the thing to be reached, in at least one cell.

        Returns:
            The distance as bases measure it [m]; inf where no cell is free.
        """
        level_of_cell = self._flat.level_of(target.cells)
        squares = self._squares_of(target)
        nearest_distance = math.inf
        for level in np.unique(level_of_cell).tolist():
            target_cells = target.cells[level_of_cell == level]
            middles = self._flat.positions(target_cells)[:, :2]
            _, snapped_cells = snap_to_cells(self._flat, self._flat.free, middles, level)
            snapped_cells = snapped_cells[snapped_cells >= 0]
            if not len(snapped_cells):
                continue
            # near the cells that are the nearest to middles, one may be nearer to a square
            distance = self._measure_distances(snapped_cells, target, squares).min()
            window = self._cut_window(level, target_cells, distance)
            free_cells = window.to_cells(np.argwhere(window.cut(self._flat.free)))
            distance = self._measure_distances(free_cells, target, squares).min()
            nearest_distance = min(nearest_distance, float(distance))
        return nearest_distance

    def _measure_distances(self, cells: Int, target: StandTarget, squares: Float) -> Float:
        """Measure from the middles of bases' cells to the nearest of a target's squares [m]."""
        points = self._flat.positions(cells)[:, :2]
        height_gaps = self._measure_height_gaps(cells, target.box)
        return np.hypot(measure_to_nearest(points, squares), height_gaps)

    def _squares_of(self, target: StandTarget) -> Float:
        """Return the squares of a target's cells, cut to its box, shape (k, 4) [m]."""
        edges = self._flat.layout.cell_size[self._flat.level_of(target.cells)]
        middles = self._flat.positions(target.cells)[:, :2]
        return cut_squares(middles, edges[:, None], target.box)


def _check_rules(rules: StandRules) -> None:
    """Check the rules that are numbers and names; raises QueryError."""
    expected = "a reach (least, greatest), 0 <= least <= greatest [m]"
    is_pair = isinstance(rules.reach, Sequence) and len(rules.reach) == 2
    has_numbers = is_pair and all(isinstance(length, RealNumber) for length in rules.reach)
    if not has_numbers or not 0.0 <= rules.reach[0] <= rules.reach[1] < math.inf:
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
        if math.isinf(rules.height):
            expected = "a finite height of the shoulder [m]"
            raise QueryError(
                f"expected {expected}, got {rules.height}",
                key="height",
                value=rules.height,
                expected=expected,
            )
    check_distance(rules.sight, "sight")


def _count_cells_in_reach(flat: FlatGrid, max_reach: float) -> int:
    """Count the cells, along a row or a column, over which a line of sight may lead.

    Args:
        flat: the grid.
        max_reach: greatest distance of a base to a target [m].

    Raises:
        QueryError: it is so large that the lines would not fit into memory.
    """
    cell_size = float(flat.layout.cell_size.min())
    largest_side = int(max(flat.layout.width.max(), flat.layout.height.max()))
    num_cells = min(math.ceil(max_reach / cell_size) + 1, largest_side)
    if num_cells > MAX_SIGHT_CELLS:
        expected = f"a reach up to {(MAX_SIGHT_CELLS - 1) * cell_size:g} m where sight counts"
        hint = "sight=False has no such limit"
        raise QueryError(
            f"expected {expected}, got {max_reach:g} m: {hint}",
            key="reach",
            value=max_reach,
            expected=expected,
            hint=hint,
        )
    return num_cells


# ---------------------------------------------------------------- distances and headings


def mark_near(mask: Bool) -> Bool:
    """Mark the cells of a mask, and their eight neighbours."""
    rows, cols = mask.shape
    padded = np.pad(mask, 1)
    shifted = [padded[i : i + rows, j : j + cols] for i in range(3) for j in range(3)]
    return np.asarray(np.logical_or.reduce(shifted))


def cut_squares(middles: Float, edges: Float, box: Float | None) -> Float:
    """Cut squares to a box; a square that the box misses stays whole.

    Args:
        middles: world x, y of the squares' middles [m], shape (k, 2).
        edges: their edges [m], shape (k, 1).
        box: x, y, z of the box's lower, then of its upper corner [m]; None to cut nothing.

    Returns:
        x, y of each lower corner, then of each upper corner [m], shape (k, 4).
    """
    squares = np.concatenate([middles - edges / 2, middles + edges / 2], axis=1)
    if box is None:
        return squares
    lower_corners = np.maximum(squares[:, :2], box[:2])
    upper_corners = np.minimum(squares[:, 2:], box[3:5])
    is_in_box = (lower_corners <= upper_corners).all(axis=1)
    squares[is_in_box] = np.concatenate([lower_corners, upper_corners], axis=1)[is_in_box]
    return squares


def measure_to_nearest(points: Float, squares: Float) -> Float:
    """Measure from points to the nearest of several squares [m]; 0 inside.

    Args:
        points: world x, y [m], shape (n, 2).
        squares: x, y of the lower corner, then of the upper corner [m], shape (k, 4).

    Returns:
        Shape (n,).
    """
    distances = np.empty(len(points))
    chunk_size = max(MAX_PAIRS // len(squares), 1)
    for first in range(0, len(points), chunk_size):
        chunk = points[first : first + chunk_size]
        x = chunk[:, :1]
        y = chunk[:, 1:]
        x_gaps = np.maximum(np.maximum(squares[:, 0] - x, x - squares[:, 2]), 0.0)
        y_gaps = np.maximum(np.maximum(squares[:, 1] - y, y - squares[:, 3]), 0.0)
        squared_distances = x_gaps**2 + y_gaps**2
        distances[first : first + chunk_size] = np.sqrt(squared_distances.min(axis=1))
    return distances


def measure_to_farthest(points: Float, squares: Float) -> Float:
    """Measure from points to the farthest corner of each of several squares, to a nanometre [m].

    So equal distances are equal, and of squares at one distance the first counts.

    Args:
        points: world x, y [m], shape (n, 2).
        squares: x, y of the lower corner, then of the upper corner [m], shape (k, 4).

    Returns:
        Shape (n, k).
    """
    x = points[:, :1]
    y = points[:, 1:]
    x_gaps = np.maximum(squares[:, 2] - x, x - squares[:, 0])
    y_gaps = np.maximum(squares[:, 3] - y, y - squares[:, 1])
    return np.asarray(np.round(np.sqrt(x_gaps**2 + y_gaps**2), DISTANCE_DIGITS))


def find_nearest_square(points: Float, squares: Float, limits: Float) -> Int:
    """Find the square of which the farthest corner is the nearest to each point.

    Args:
        points: world x, y [m], shape (n, 2).
        squares: x, y of the lower corner, then of the upper corner [m], shape (k, 4).
        limits: how far that corner may be from each point [m], shape (n,).

    Returns:
        Index of each point's square, shape (n,); -1 for none.
    """
    square_of_point = np.full(len(points), -1, dtype=np.int64)
    chunk_size = max(MAX_PAIRS // len(squares), 1)
    for first_point in range(0, len(points), chunk_size):
        chunk = np.s_[first_point : first_point + chunk_size]
        distances = measure_to_farthest(points[chunk], squares)
        nearest_square = distances.argmin(axis=1)
        is_within = distances[np.arange(len(nearest_square)), nearest_square] <= limits[chunk]
        square_of_point[chunk] = np.where(is_within, nearest_square, -1)
    return square_of_point


def find_headings(points: Float, faced_squares: Float, squares: Float) -> Float:
    """Find the headings from points to the middles of squares [rad].

    From the very middle of its square, a base faces the middle of all squares; from there, along x.

    Args:
        points: world x, y [m], shape (n, 2).
        faced_squares: the square that each faces, shape (n, 4) [m].
        squares: all squares of the target, shape (k, 4) [m].
    """
    offsets = (faced_squares[:, :2] + faced_squares[:, 2:]) / 2.0 - points
    is_in_middle = (np.abs(offsets) < MIDDLE_SLACK).all(axis=1)
    middle = (squares[:, :2] + squares[:, 2:]).mean(axis=0) / 2.0
    offsets[is_in_middle] = middle - points[is_in_middle]
    offsets[np.abs(offsets) < MIDDLE_SLACK] = 0.0
    return np.asarray(np.arctan2(offsets[:, 1], offsets[:, 0]))


def wrap_angle(angles: NDArray[np.floating]) -> Float:
    """Bring angles into the range -pi to pi by whole turns [rad]."""
    return np.asarray(np.mod(angles + math.pi, 2.0 * math.pi) - math.pi)
