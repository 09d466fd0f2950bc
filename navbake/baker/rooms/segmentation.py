"""Rooms that are found automatically: how the floor of a level is divided into segments.

A *gap* is a narrow place of the floor, such as a doorway, see `gaps.py`. A *space* is a connected
part of the floor between gaps, while the floor is being divided. A *segment* is a space at the end,
which becomes a room unless geoms, sites or polygons mark rooms in it. The steps:

1. `segment_by_gaps` separates spaces at gaps, joins spaces again whose gap is too wide to be a
   door, gives the cells of gaps to the nearest space, and joins stairs and small spaces to a
   neighbour (`_SpaceGraph`).
2. `assign_covered` and `assign_unmarked` divide the cells of segments between marked and new rooms.
3. `find_room_segments` in `outdoors.py` leaves out segments that are hollows of the building, and
   finds those that are outdoors.
4. `assign_leaf_cells` gives the cells of closed door leaves to the rooms beside them.

`rooms.py` calls these functions.
"""

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navbake.baker.core.components import (
    RowRuns,
    count_cells_by_label,
    find_row_runs,
    label_components_2d,
)
from navbake.baker.core.level_stacks import make_level_stacks
from navbake.baker.core.windows import bounding_window, grow_window, list_differing_pairs
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.rooms.flags import LevelFlags
from navbake.baker.rooms.gap_limits import MAX_GAP_WIDTH, MIN_SPACE_AREA
from navbake.baker.rooms.gaps import CloseCall, SpaceMerger, find_gaps, label_spaces
from navbake.baker.rooms.leaves import LeafMarks
from navbake.baker.rooms.walls import (
    WallRays,
    mark_wall_nodes,
    measure_squared_distances,
    measure_squared_distances_at,
)
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# A tolerance for rounding errors when areas and widths are compared with limits [cells, half cells]
CELL_ROUNDING = 1e-6

# A part of a segment that belongs to no marked room is no room if it is nowhere as wide as this [m]
MIN_REMAINDER_WIDTH = 0.5

# A cell is steep, like a stair, where the floor rises by this share of the distance …
MIN_STEEPNESS = 0.3
# … over this distance on both sides of it [m]
STEEPNESS_REACH = 0.3
# A space is a stair where this share of its cells is steep
MIN_STAIR_SHARE = 0.5
# In cells, the distance from a corridor's middle to its walls varies by at most this, depending on
# its angle. An opening that is narrower than a stair by this counts as equally wide [half cells]
WIDTH_ROUGHNESS = 1.0


# ---------------------------------------------------------------- segments between gaps


def segment_by_gaps(
    level: LevelFlags,
    cell_size: float,
    min_area: float,
    door_width: float | None = None,
    walls: Shapes | None = None,
    lattice: Lattice | None = None,
    leaf_marks: LeafMarks | None = None,
) -> tuple[Int32, list[CloseCall]]:
    """Divide the open floor of a level into segments, the candidates for rooms, at narrow places.

    A gap is a narrow place, such as a doorway: a straight line of open cells from wall to wall, in
    the direction of a wall, beside which the floor is abruptly wider. At first, each gap separates
    two spaces. Then the spaces on both sides of a gap are joined in these cases:

    - first, if the gap is about as wide as both spaces: parts of one corridor, or of an L-shaped
      room;
    - then, if the gap is about as wide as the narrower of both spaces (niches, bays, the depth of a
      doorway), or wider than 2.5 m. But a long passage stays a room of its own where it opens into
      a wider space, if this opening is at most 3.2 m wide. With a `door_width`, this width replaces
      both limits.

    The width of a space is measured close behind the gap, parallel to it. Gaps in one line between
    the same two spaces count as one gap, so that a row of pillars separates nothing.

    At the end, stairs that open to a room over their full width are joined to it, at their foot
    rather than their head. A space smaller than `min_area` is joined to the neighbour that it opens
    to the widest; without a neighbour, its cells are in no segment.

    Args:
        level: the flags of the level's cells.
        cell_size: the side of a cell, > 0 [m].
        min_area: the least area of a room, > 0 [m²].
        door_width: the widest gap that separates two rooms, > 0 [m]; None for the limits above.
        walls: the geometry of walls, up to which widths are measured; None to measure them in
            cells.
        lattice: the lattice of the level; needed if `walls` is given.
        leaf_marks: the closed door leaves; None if there are none. A leaf that separates two spaces
            closes its cells: they are in no gap and no segment. What is behind it is a segment
            however small it is, unless it is joined to a neighbour or lies at the edge of the grid
            (a threshold).

    Returns:
        The segment of each cell, from 1 in reading order, 0 for none, shape (height, width), int32;
        and the gaps that nearly joined, or nearly separated, two spaces.

    Source:
        Region merging as in Bormann et al., "Room segmentation: survey, implementation, and
        analysis" (ICRA 2016), on spaces between the "virtual walls" that continue walls, in
        place of those of a Voronoi graph.
    """
    if not level.is_open.any():
        return np.zeros(level.is_open.shape, dtype=np.int32), []
    # with the cells around it: walls there have directions that count; the grid's edge is no wall
    open_rows, open_cols = bounding_window(level.is_open)
    window = (
        slice(max(open_rows.start - 1, 0), open_rows.stop + 1),
        slice(max(open_cols.start - 1, 0), open_cols.stop + 1),
    )
    row_slice, col_slice = window
    floor = level.floor[window]
    is_at_edge = level.is_at_edge[window]
    is_open = level.is_open[window]
    is_hole = level.is_hole[window]
    is_closed = np.zeros_like(is_open) if leaf_marks is None else leaf_marks.is_separating[window]
    if (is_open | is_hole).all():
        # gaps are between walls, and there is none
        label, _, _ = label_spaces(is_open, is_closed.copy(), cell_size)
        close_calls = list[CloseCall]()
    else:
        rays = None
        if walls is not None and lattice is not None:
            rays = WallRays(walls, lattice.cut(row_slice, col_slice), floor)
        runs, close_calls = _find_spaces_at_gaps(
            is_open, is_hole, cell_size, door_width, rays, is_closed
        )
        del rays  # which hold the walls in all directions
        label = runs.paint(runs.value, is_open.shape)
    is_open = is_open & ~is_closed
    cells_beyond = np.empty((2, 0), dtype=np.int64)  # rows and columns in the window
    if leaf_marks is not None:
        # rooms meet in the cells of a leaf, not beside it
        if leaf_marks.is_not_separating.any():
            spread_labels(label, is_open & ~leaf_marks.is_not_separating[window])
        beyond_row, beyond_col = np.divmod(leaf_marks.cells_beyond, level.is_open.shape[1])
        cells_beyond = np.stack([beyond_row - row_slice.start, beyond_col - col_slice.start])
    spread_labels(label, is_open)
    _label_spaces_behind(cells_beyond, label, is_open)
    runs = find_row_runs(label)
    space_of_label = _join_spaces(
        label=label,
        runs=runs,
        is_open=is_open,
        floor=floor,
        is_at_edge=is_at_edge,
        cells_beyond=cells_beyond,
        cell_size=cell_size,
        min_area=min_area,
    )
    del label  # there may be no memory for it beside the segments
    segment_of_run, _ = number_in_order(space_of_label[runs.value])
    runs_in_level = runs._replace(
        row=runs.row + row_slice.start,
        first_col=runs.first_col + col_slice.start,
        end_col=runs.end_col + col_slice.start,
    )
    segment = runs_in_level.paint(segment_of_run.astype(np.int32), level.is_open.shape)
    close_calls = [
        close_call._replace(
            row_col=(
                close_call.row_col[0] + row_slice.start,
                close_call.row_col[1] + col_slice.start,
            )
        )
        for close_call in close_calls
    ]
    return segment, close_calls


def label_undivided_floors(
    levels: Sequence[LevelFlags], cell_size: float, min_area: float
) -> list[Int32 | None]:
    """Label the connected parts of floors that nothing divides: these parts are their segments.

    Nothing divides a floor without a wall, if it has neither stairs nor parts that are too small
    for a room. All levels are labelled by few calls, as towers have many of them.

    Args:
        levels: the flags of each level's cells; floors on which closed leaves stand are divided by
            these, which is not considered here.
        cell_size: the side of a cell, > 0 [m].
        min_area: the least area of a room, > 0 [m²].

    Returns:
        For each level, the segment of each cell, from 1 in reading order, 0 for none, shape
        (height, width); None for a level whose floor `segment_by_gaps` has to divide.
    """
    min_cells = max(min_area, MIN_SPACE_AREA) / cell_size**2
    segments = list[Int32 | None]()
    for stack in make_level_stacks(len(levels), levels[0].is_open.shape):
        is_open = stack.stack([level.is_open for level in levels])
        is_hole = stack.stack([level.is_hole for level in levels])
        is_divided = ~stack.unstack(is_open | is_hole).all(axis=(1, 2))
        if is_divided.all():
            segments += [None] * len(stack.levels)
            continue
        floor = stack.unstack(stack.stack([level.floor for level in levels]))
        rise = np.fmax.reduce(floor, axis=(1, 2)) - np.fmin.reduce(floor, axis=(1, 2))
        is_divided |= rise >= _min_steep_rise(cell_size) / 2
        label, num_cells = label_components_2d(is_open)
        by_level = stack.unstack(label)
        # parts are numbered level by level
        last_label = np.maximum.accumulate(by_level.max(axis=(1, 2)))
        small_labels = np.flatnonzero(num_cells[1:] < min_cells) + 1
        is_divided[np.searchsorted(last_label, small_labels)] = True
        first_label = np.append(0, last_label[:-1]).astype(np.int32)
        for level_label, num_labels_below, divided in zip(
            by_level, first_label, is_divided.tolist(), strict=True
        ):
            segment = np.where(level_label > 0, level_label - num_labels_below, 0)
            segments.append(None if divided else segment.astype(np.int32, copy=False))
    return segments


def _find_spaces_at_gaps(
    is_open: Bool,
    is_hole: Bool,
    cell_size: float,
    door_width: float | None,
    rays: WallRays | None,
    is_closed: Bool,
) -> tuple[RowRuns, list[CloseCall]]:
    """Find the spaces between gaps, after the spaces on both sides of wide gaps were joined.

    They are runs of cells, and painted only when all that finds them is freed: that takes most of
    a bake's memory.

    Args:
        is_open: cells with a floor and without a wall, shape (height, width).
        is_hole: cells with neither floor nor wall.
        cell_size: the side of a cell, > 0 [m].
        door_width: the widest gap that separates two rooms [m]; None for the limits of
            `segment_by_gaps`.
        rays: rays to the geometry of walls; None to measure widths in cells.
        is_closed: cells of the closed leaves that separate two spaces.

    Returns:
        Runs of cells with the label of their space, some with 0 for none; and the gaps that nearly
        joined, or nearly separated, two spaces.
    """
    separated_spaces = find_gaps(is_open, is_hole, cell_size, door_width, rays, is_closed)
    space_merger = SpaceMerger(separated_spaces, cell_size, door_width, rays)
    space_merger.join_spaces()
    runs = separated_spaces.runs
    runs = runs._replace(value=space_merger.space_of_label[runs.value])
    return runs, space_merger.list_close_calls()


def _label_spaces_behind(cells_beyond: Int, label: Int32, is_open: Bool) -> None:
    """Label the spaces behind closed leaves that have no label yet, as all of their cells are gaps.

    Args:
        cells_beyond: rows and columns of cells in the spaces that leaves lead into, shape (2, n).
        label: the space of each cell, 0 for none, shape (height, width); is changed.
        is_open: cells of spaces and of gaps between them.
    """
    row, col = cells_beyond[:, label[tuple(cells_beyond)] == 0]
    if not len(row):
        return
    component, num_cells = label_components_2d(is_open & (label == 0))
    new_label = np.zeros(len(num_cells), dtype=np.int32)
    unlabelled_components = np.unique(component[row, col])
    new_label[unlabelled_components] = label.max() + 1 + np.arange(len(unlabelled_components))
    label += new_label[component]


def _join_spaces(
    label: Int32,
    runs: RowRuns,
    is_open: Bool,
    floor: Float,
    is_at_edge: Bool,
    cells_beyond: Int,
    cell_size: float,
    min_area: float,
) -> Int32:
    """Join stairs and small spaces to a neighbour.

    Args:
        label: the space of each cell, 0 for none, shape (height, width).
        runs: the runs of cells of one space in the rows of `label`.
        is_open: cells of spaces and of gaps between them.
        floor: heights of the floor [m].
        is_at_edge: cells at the outer boundary of the scene, see `LevelFlags.is_at_edge`.
        cells_beyond: rows and columns of cells in spaces that closed leaves lead into, shape (2,
            n).
        cell_size: the side of a cell, > 0 [m].
        min_area: the least area of a room [m²].

    Returns:
        By label, the space after the joins, 0 if that is still too small for a room, shape
        (labels,).
    """
    min_cells = min_area / cell_size**2 - CELL_ROUNDING
    num_labels = int(runs.value.max(initial=0)) + 1
    num_cells = runs.count_cells(runs.value, num_labels)
    num_steep_cells = np.bincount(label[mark_steep(label, floor, cell_size)], minlength=num_labels)
    is_stair = num_steep_cells >= MIN_STAIR_SHARE * np.maximum(num_cells, 1)
    may_join = is_stair | (num_cells > 0) & (num_cells < min_cells)
    if not may_join[1:].any():
        return np.arange(num_labels, dtype=np.int32)
    num_at_edge = np.bincount(label[is_at_edge], minlength=num_labels)
    is_room = np.bincount(label[tuple(cells_beyond)], minlength=num_labels) > 0
    is_room &= num_at_edge == 0
    # distances matter up to half the widest gap [half cells]
    reach = int(MAX_GAP_WIDTH / cell_size) + 2
    space_graph = _SpaceGraph(label, num_cells, may_join, is_open, reach)
    if is_stair.any():
        is_labelled = label > 0
        height_sums = np.bincount(label[is_labelled], floor[is_labelled], num_labels)
        mean_heights = height_sums / np.maximum(num_cells, 1)
        widest_squared = measure_widest_places(label, runs, is_open, is_stair, reach)
        space_graph.join_stairs(is_stair, mean_heights, np.sqrt(widest_squared))
    space_graph.join_small_spaces(min_cells, num_at_edge, MAX_GAP_WIDTH / cell_size)
    return space_graph.select_rooms(min_cells, is_room)


def spread_labels(label: Int32, is_open: Bool) -> None:
    """Spread labels to the open cells without a label, each wave by one cell across cells' edges.

    If several labels reach a cell in one wave, that of the nearest source cell wins; a label's
    source is the cell that had it at the start. On a tie, the lower label wins. If the labels are
    equal, too, the source further clockwise is kept, because later waves measure distances from it.
    This rule does not depend on the map's orientation.

    Args:
        label: the label of each cell, from 1, 0 for none, shape (height, width), C order; is
            changed.
        is_open: cells that may receive a label.
    """
    height, width = label.shape
    flat_labels = label.reshape(-1)  # a view
    unlabelled_cells = np.flatnonzero(is_open & (label == 0))
    row, col = np.divmod(unlabelled_cells, width)
    # the four neighbours; at the lattice's edge, the cell itself in place of one beyond it
    neighbors = np.stack(
        [
            unlabelled_cells + (col < width - 1),
            unlabelled_cells + width * (row < height - 1),
            unlabelled_cells - (col > 0),
            unlabelled_cells - width * (row > 0),
        ]
    )
    neighbor_steps = (0, 1), (1, 0), (0, -1), (-1, 0)  # rows and columns to them
    # from each cell to its label's source
    rows_to_sources = np.zeros(label.size, dtype=np.int32)
    cols_to_sources = np.zeros(label.size, dtype=np.int32)
    while True:
        is_reached = (flat_labels[neighbors] > 0).any(axis=0)
        if not is_reached.any():
            return
        reached_cells = unlabelled_cells[is_reached]
        neighbors_of_reached = neighbors.compress(is_reached, axis=1)
        unlabelled_cells = unlabelled_cells[~is_reached]
        neighbors = neighbors.compress(~is_reached, axis=1)
        best_squared_distance = np.zeros(len(reached_cells), dtype=np.int32)
        best_label = np.zeros(len(reached_cells), dtype=np.int32)
        best_rows_to_source = np.zeros(len(reached_cells), dtype=np.int32)
        best_cols_to_source = np.zeros(len(reached_cells), dtype=np.int32)
        for neighbor, (row_step, col_step) in zip(
            neighbors_of_reached, neighbor_steps, strict=True
        ):
            new_label = flat_labels[neighbor]
            rows_to_source = rows_to_sources[neighbor] + row_step
            cols_to_source = cols_to_sources[neighbor] + col_step
            squared_distance = rows_to_source**2 + cols_to_source**2
            is_clockwise = (
                best_cols_to_source * rows_to_source - best_rows_to_source * cols_to_source > 0
            )
            wins_tie = (new_label < best_label) | ((new_label == best_label) & is_clockwise)
            is_nearer = squared_distance < best_squared_distance
            is_as_near = squared_distance == best_squared_distance
            is_first = best_label == 0
            is_better = (new_label > 0) & (is_first | is_nearer | (is_as_near & wins_tie))
            np.copyto(best_squared_distance, squared_distance, where=is_better)
            np.copyto(best_label, new_label, where=is_better)
            np.copyto(best_rows_to_source, rows_to_source, where=is_better)
            np.copyto(best_cols_to_source, cols_to_source, where=is_better)
        flat_labels[reached_cells] = best_label
        rows_to_sources[reached_cells] = best_rows_to_source
        cols_to_sources[reached_cells] = best_cols_to_source


def mark_steep(label: Int32, floor: Float, cell_size: float) -> Bool:
    """Mark the labelled cells where the floor rises like a stair.

    Args:
        label: the label of each cell, shape (height, width). The floor of cells with 0 is ignored.
        floor: heights of the floor [m].
        cell_size: the side of a cell, > 0 [m].
    """
    height, width = label.shape
    reach = _steepness_reach(cell_size)
    min_rise = _min_steep_rise(cell_size)
    is_steep = np.zeros(label.shape, dtype=np.bool_)

    def mark_rows(first_row: int, end_row: int) -> None:
        # a steep floor rises by more than half of it along rows or along columns, as few floors do
        is_candidate = np.zeros((end_row - first_row, width), dtype=np.bool_)
        floor_of_rows = floor[first_row:end_row]
        rise = floor_of_rows[:, 2 * reach :] - floor_of_rows[:, : -2 * reach]
        is_candidate[:, reach:-reach] = np.abs(rise, out=rise) >= min_rise / 2
        inner_begin = max(first_row, reach)
        inner_end = max(min(end_row, height - reach), inner_begin)
        floor_below = floor[inner_begin + reach : inner_end + reach]
        rise = floor_below - floor[inner_begin - reach : inner_end - reach]
        is_candidate[inner_begin - first_row : inner_end - first_row] |= (
            np.abs(rise, out=rise) >= min_rise / 2
        )
        cells = np.flatnonzero(is_candidate & (label[first_row:end_row] > 0))
        row, col = np.divmod(cells, width)
        row += first_row
        squared_rise = np.zeros(len(cells))  # over rows and columns together
        for row_step, col_step in ((reach, 0), (0, reach)):
            is_inside = (row >= row_step) & (row < height - row_step)
            is_inside &= (col >= col_step) & (col < width - col_step)
            upper_cell = (row - row_step * is_inside, col - col_step * is_inside)
            lower_cell = (row + row_step * is_inside, col + col_step * is_inside)
            are_labelled = (label[upper_cell] > 0) & (label[lower_cell] > 0)
            rise = np.where(are_labelled, floor[lower_cell] - floor[upper_cell], 0.0)
            squared_rise += rise * rise
        is_steep[row, col] = squared_rise >= min_rise**2

    run_in_chunks(mark_rows, height, min_chunk_size=2 * reach)
    return is_steep


def _steepness_reach(cell_size: float) -> int:
    """Return how many cells away, on both sides of a cell, its steepness is measured."""
    return max(1, round(STEEPNESS_REACH / cell_size))


def _min_steep_rise(cell_size: float) -> float:
    """Return the least rise between both sides of a steep cell [m]."""
    return MIN_STEEPNESS * 2 * _steepness_reach(cell_size) * cell_size


class SpaceContact(NamedTuple):
    """The boundary along which two spaces touch.

    Attributes:
        half_width: half of the opening's width: the distance to the nearest wall, from the place on
            the boundary where that is greatest [half cells].
        num_edges: the number of edges between a cell of one space and a cell of the other.
    """

    half_width: float
    num_edges: int


class _SpaceGraph:
    """Spaces, where they touch, and which of them were joined.

    This is a region adjacency graph whose nodes are contracted (Haris, 1998).
    """

    def __init__(
        self, label: Int32, num_cells: Int, may_join: Bool, is_open: Bool, reach: int
    ) -> None:
        """Find where spaces touch, and how wide the openings between them are.

        Args:
            label: the space of each cell, 0 for none.
            num_cells: the number of cells of each space, by label.
            may_join: by label, whether a space may be joined to a neighbour. The contact of two
                spaces is only recorded if at least one of them may be joined.
            is_open: cells of spaces and gaps.
            reach: up to which distances to walls are measured [half cells].
        """
        num_labels = len(num_cells)
        self._num_cells = num_cells.copy()
        # label -> the space that it belongs to after the joins so far
        self._space_of = np.arange(num_labels, dtype=np.int32)
        # the edges between cells of two spaces
        edge_cells = list_differing_pairs(label)
        space_pairs = np.sort(label.ravel()[edge_cells].astype(np.int64), axis=0)
        is_contact = (space_pairs[0] > 0) & may_join[space_pairs].any(axis=0)
        space_pairs = space_pairs[:, is_contact]
        row, col = _edge_nodes(edge_cells[:, is_contact], label.shape[1])
        squared_distance = measure_squared_distances_at(is_open, reach, row, col)
        widest_squared = squared_distance.reshape(3, -1).max(axis=0)
        pair_keys, key_of_edge, edge_counts = np.unique(
            space_pairs[0] * num_labels + space_pairs[1], return_inverse=True, return_counts=True
        )
        half_widths = np.zeros(len(pair_keys))
        np.maximum.at(half_widths, key_of_edge, np.sqrt(widest_squared))
        # by space and neighbour
        self._contacts: list[dict[int, SpaceContact]] = [{} for _ in num_cells]
        for pair_key, half_width, num_edges in zip(
            pair_keys.tolist(), half_widths.tolist(), edge_counts.tolist(), strict=True
        ):
            first_space, second_space = divmod(pair_key, num_labels)
            contact = SpaceContact(half_width, num_edges)
            self._contacts[first_space][second_space] = contact
            self._contacts[second_space][first_space] = contact

    def join_stairs(self, is_stair: Bool, mean_height: Float, widest_distance: Float) -> None:
        """Join each stair to the lowest of the spaces that it opens to over its full width.

        Args:
            is_stair: by label, whether the space is a stair.
            mean_height: by label, the mean height of the space's floor [m].
            widest_distance: by label, the distance to walls at the widest place of a stair [half
                cells]; is changed.
        """
        for stair in np.flatnonzero(is_stair).tolist():
            if self._space_of[stair] != stair:
                continue
            # of an opening as wide as the stair [half cells]
            min_half_width = widest_distance[stair] - WIDTH_ROUGHNESS - CELL_ROUNDING
            neighbors = [
                neighbor
                for neighbor, contact in self._contacts[stair].items()
                if contact.half_width >= min_half_width
            ]
            if neighbors:
                lowest_neighbor = min(
                    neighbors, key=lambda neighbor: (mean_height[neighbor], neighbor)
                )
                self._join(lowest_neighbor, stair)
                widest_distance[lowest_neighbor] = max(
                    widest_distance[lowest_neighbor], widest_distance[stair]
                )

    def join_small_spaces(
        self, min_cells: float, num_at_edge: Int, max_counted_cells: float
    ) -> None:
        """Join each small space, the smallest first, to the neighbour that it opens to the widest.

        If the small space has cells at the edge of the grid, as a ledge round a house has, it is
        joined to the neighbour with the most cells there instead. If it has more than
        `max_counted_cells` of them, it is only joined to a neighbour that has more than that, too.

        Args:
            min_cells: spaces with fewer cells are small.
            num_at_edge: by label, how many cells of the space are at the edge of the grid; is
                changed.
            max_counted_cells: neighbours with this many cells at the edge, or more, count as equal.
        """
        is_small = (self._space_of == np.arange(len(self._num_cells))) & (
            self._num_cells < min_cells
        )
        queue = [
            (int(self._num_cells[space]), space)
            for space in np.flatnonzero(is_small).tolist()
            if space
        ]
        heapq.heapify(queue)
        while queue:
            num_cells, small_space = heapq.heappop(queue)
            # a space that has grown since it was queued is in the queue a second time
            if (
                self._space_of[small_space] != small_space
                or self._num_cells[small_space] != num_cells
            ):
                continue
            neighbor_ranks = []
            for neighbor, contact in self._contacts[small_space].items():
                edge_rank = (
                    min(num_at_edge[neighbor], max_counted_cells) if num_at_edge[small_space] else 0
                )
                neighbor_ranks.append((edge_rank, *contact, self._num_cells[neighbor], -neighbor))
            if not neighbor_ranks:
                continue
            best_neighbor = -max(neighbor_ranks)[-1]
            if num_at_edge[small_space] > max_counted_cells >= num_at_edge[best_neighbor]:
                continue
            self._join(best_neighbor, small_space)
            num_at_edge[best_neighbor] += num_at_edge[small_space]
            if self._num_cells[best_neighbor] < min_cells:
                heapq.heappush(queue, (int(self._num_cells[best_neighbor]), best_neighbor))

    def select_rooms(self, min_cells: float, is_room: Bool) -> Int32:
        """Return the space of each label after the joins, 0 where that space is too small.

        Args:
            min_cells: the least number of cells of a space that isn't too small.
            is_room: by label, whether the label's space is a room whatever its size.
        """
        is_large = self._num_cells >= min_cells
        is_large[self._space_of[is_room]] = True
        return np.where(is_large[self._space_of], self._space_of, np.int32(0))

    def _join(self, kept_space: int, removed_space: int) -> None:
        """Make the space `removed_space` a part of the space `kept_space`."""
        self._space_of[self._space_of == removed_space] = kept_space
        for neighbor, contact in self._contacts[removed_space].items():
            del self._contacts[neighbor][removed_space]
            if neighbor == kept_space:
                continue
            kept_contact = self._contacts[kept_space].get(neighbor, SpaceContact(0.0, 0))
            combined_contact = SpaceContact(
                max(kept_contact.half_width, contact.half_width),
                kept_contact.num_edges + contact.num_edges,
            )
            self._contacts[kept_space][neighbor] = combined_contact
            self._contacts[neighbor][kept_space] = combined_contact
        self._contacts[removed_space] = {}
        self._num_cells[kept_space] += self._num_cells[removed_space]


def _edge_nodes(cells: Int, width: int) -> tuple[Int, Int]:
    """Return the three nodes on each edge between two cells: its ends and its middle.

    Nodes are points half a cell apart, see `mark_wall_nodes`.

    Args:
        cells: ids of the two cells at each edge, shape (2, n).
        width: number of columns of the lattice.

    Returns:
        Rows and columns of the nodes, shape (3 n,) each: first all edges' first ends, then their
        middles, then their second ends.
    """
    centers = 2 * np.array(np.divmod(cells, width)) + 1  # rows and columns of both cells
    # an edge and its ends lie across the step from cell to cell
    is_same_coordinate = centers[:, 0] == centers[:, 1]
    node_offset = is_same_coordinate * np.array([-1, 0, 1])[:, None, None]
    nodes = (centers[:, :1] + centers[:, 1:]) // 2 + node_offset.swapaxes(0, 1)
    rows, cols = nodes.reshape(2, -1)
    return rows, cols


def measure_widest_places(
    label: Int32, runs: RowRuns, is_open: Bool, is_measured: Bool, reach: int
) -> Int32:
    """Measure how far the widest place of each of some labelled areas is from the nearest wall.

    Args:
        label: the label of each cell, 0 for none, shape (height, width).
        runs: the runs of cells with one label in the rows of `label`.
        is_open: a mask of the cells without a wall, shape (height, width); all labelled cells are.
        is_measured: by label, whether its area is measured, shape (labels,); at least one is, and
            label 0 is not.
        reach: up to which distance from walls is measured, >= 0 [half cells].

    Returns:
        For each label, see `find_widest_distances`; 0 for those that are not measured.
    """
    is_run_measured = is_measured[runs.value]
    rows = runs.row[is_run_measured]
    window_of_areas = (
        slice(int(rows[0]), int(rows[-1]) + 1),
        slice(int(runs.first_col[is_run_measured].min()), int(runs.end_col[is_run_measured].max())),
    )
    margin = reach // 2 + 1  # walls farther away are beyond the reach
    window = grow_window(window_of_areas, margin, margin, label.shape)
    label_in_window = label[window]
    return find_widest_distances(
        np.where(is_measured[label_in_window], label_in_window, np.int32(0)),
        measure_squared_distances(mark_wall_nodes(is_open[window]), reach),
        len(is_measured),
    )


def find_widest_distances(label: Int32, squared_distance: Int32, num_labels: int) -> Int32:
    """Find how far the widest place of each labelled area is from the nearest wall.

    Args:
        label: the label of each cell, 0 for none, shape (height, width).
        squared_distance: the squared distance of each node from the nearest wall, shape (2 height +
            1, 2 width + 1) [half cells squared]; nodes are the cells' centres, corners and middles
            of edges, see `mark_wall_nodes`.
        num_labels: number of labels, including label 0.

    Returns:
        For each label, the largest squared distance of all nodes on its cells, shape (num_labels,),
        int32 [half cells squared].
    """
    widest_in_rows = np.maximum(squared_distance[:-2:2], squared_distance[2::2])
    np.maximum(widest_in_rows, squared_distance[1::2], out=widest_in_rows)
    widest_in_cells = np.maximum(widest_in_rows[:, :-2:2], widest_in_rows[:, 2::2])
    np.maximum(widest_in_cells, widest_in_rows[:, 1::2], out=widest_in_cells)
    is_labelled = label > 0
    widest_squared = np.zeros(num_labels, dtype=np.int32)
    np.maximum.at(widest_squared, label[is_labelled], widest_in_cells[is_labelled])
    return widest_squared


# ---------------------------------------------------------------- segments and marked rooms


def assign_covered(room_number: Int32, room_under: Int32, segment: Int32) -> Int32:
    """Give cells without a room, such as those of a podium, to the room below their floor.

    This is only done if the room below has cells in the same segment, so that a house does not
    become part of the ground that it stands on.

    Args:
        room_number: the marked room of each cell, 0 for none, shape (height, width).
        room_under: the marked room over whose floor each cell's own floor lies, 0 for none, shape
            (height, width).
        segment: the part of the floor between gaps that each cell belongs to, 0 for none.

    Returns:
        The room of each cell, shape (height, width).
    """
    key_base = int(max(room_number.max(initial=0), room_under.max(initial=0))) + 1
    has_room = room_number > 0
    rooms_in_segments = np.unique(
        segment[has_room].astype(np.int64) * key_base + room_number[has_room]
    )
    is_covered = (room_number == 0) & (room_under > 0) & (segment > 0)
    covered_keys = segment[is_covered].astype(np.int64) * key_base + room_under[is_covered]
    is_covered[is_covered] = np.isin(covered_keys, rooms_in_segments)
    return np.where(is_covered, room_under, room_number)


def assign_unmarked(
    room_number: Int32,
    segment: Int32,
    cell_size: float,
    min_area: float,
    cells_beyond: Int | None = None,
) -> tuple[Int32, Int32]:
    """Divide the cells that belong to no marked room between marked rooms and new rooms.

    Marked rooms are those that geoms, sites or polygons mark. A segment (a part of the floor
    between gaps) without a marked room becomes a new room. In a segment with marked rooms, each
    connected area that belongs to none of them becomes a new room if it is large enough. It is too
    small if it is smaller than `min_area`; or if it is nowhere half a metre wide, while its segment
    is. Such an area is added to the marked room that it touches most. If it touches none, it
    becomes a room only if a closed door leaf leads into it.

    Args:
        room_number: the marked room of each cell, 0 for none, shape (height, width).
        segment: the segment of each cell, 0 for none.
        cell_size: the side of a cell, > 0 [m].
        min_area: the least area of a new room [m²].
        cells_beyond: ids of cells in the spaces that closed leaves lead into, None for none.

    Returns:
        The marked room of each cell, with the added areas, 0 for none; and the new room of each
        cell, from 1, 0 for none.
    """
    min_cells = min_area / cell_size**2 - CELL_ROUNDING
    has_marked_room = np.zeros(int(segment.max(initial=0)) + 1, dtype=np.bool_)
    has_marked_room[segment[room_number > 0]] = True
    unmarked_segment = np.where(room_number == 0, segment, 0)
    component, _ = label_components_2d(
        np.where(has_marked_room[unmarked_segment], unmarked_segment, 0)
    )
    num_cells, is_wide = _measure_components(component, cell_size)
    is_room = (num_cells >= min_cells) & is_wide
    if not (is_room | (num_cells < min_cells)).all():
        # the rest of a ledge is as narrow as the ledge: that is no reason to give it away
        segment_of_component = np.zeros(len(num_cells), dtype=np.int32)
        segment_of_component[component] = segment
        _, is_segment_wide = _measure_components(segment, cell_size)
        is_room |= (num_cells >= min_cells) & ~is_segment_wide[segment_of_component]
    touched_room = _find_most_touched_room(component, room_number, len(num_cells))
    if cells_beyond is not None:
        is_behind_leaf = np.zeros(len(num_cells), dtype=np.bool_)
        is_behind_leaf[component.ravel()[cells_beyond]] = True
        is_room |= is_behind_leaf & (touched_room == 0)
    is_room[0] = False
    touched_room_number = np.where(is_room[component], 0, touched_room[component])
    new_room_number = np.where(room_number > 0, room_number, touched_room_number).astype(np.int32)
    # segments without marks are numbered behind the components of others
    unmarked_segment_number = np.where(
        has_marked_room[unmarked_segment],
        0,
        unmarked_segment + np.int32(len(num_cells)) * (unmarked_segment > 0),
    )
    new_segment_room, _ = renumber(
        np.where(is_room[component], component, unmarked_segment_number).astype(np.int32)
    )
    return new_room_number, new_segment_room


def assign_leaf_cells(room_number: Int32, leaf_cells: Bool) -> None:
    """Give leaf cells without a room to the nearest room beside them; on a tie, to the smaller one.

    Sizes decide, and not the rooms' numbers, because numbers change when the map is turned.

    Args:
        room_number: the room of each cell, 0 for none, shape (height, width); is changed.
        leaf_cells: a mask of the cells of closed door leaves.
    """
    is_without_room = leaf_cells & (room_number == 0)
    num_cells = count_cells_by_label(room_number, int(room_number.max(initial=0)) + 1)
    rooms_by_size = np.append(0, np.argsort(num_cells[1:], kind="stable") + 1).astype(np.int32)
    rank_of_room = np.empty_like(rooms_by_size)
    rank_of_room[rooms_by_size] = np.arange(len(rooms_by_size))
    rank_of_cell = rank_of_room[room_number]
    spread_labels(rank_of_cell, is_without_room)
    room_number[is_without_room] = rooms_by_size[rank_of_cell[is_without_room]]


def _measure_components(label: Int32, cell_size: float) -> tuple[Int, Bool]:
    """Count the cells of each label, and find whether their area is half a metre wide anywhere.

    Returns:
        By label, the number of its cells (0 for label 0); and whether they are wide enough.
    """
    reach = int(MIN_REMAINDER_WIDTH / cell_size) + 2
    is_boundary_node = mark_wall_nodes(label > 0)
    height, width = label.shape
    for node_offset in range(3):  # the nodes on each edge between two labels
        is_boundary_node[node_offset : node_offset + 2 * height - 1 : 2, 2:-1:2] |= (
            label[:, :-1] != label[:, 1:]
        )
        is_boundary_node[2:-1:2, node_offset : node_offset + 2 * width - 1 : 2] |= (
            label[:-1] != label[1:]
        )
    num_cells = count_cells_by_label(label, int(label.max(initial=0)) + 1)
    widest_squared = find_widest_distances(
        label, measure_squared_distances(is_boundary_node, reach), len(num_cells)
    )
    # twice the distance to the boundary, in half cells: the widest disc that fits
    return num_cells, widest_squared >= (MIN_REMAINDER_WIDTH / cell_size) ** 2 - CELL_ROUNDING


def _find_most_touched_room(component: Int32, room_number: Int32, num_labels: int) -> Int32:
    """Find for each area the marked room that it shares the most edges of cells with.

    Args:
        component: the area of each cell, 0 for none, shape (height, width).
        room_number: the marked room of each cell, 0 for none; areas have cells without a room only.
        num_labels: number of areas, plus 1.

    Returns:
        By area, the number of the room, 0 if it touches none, shape (num_labels,). Of equals, the
        room with the lowest number counts.
    """
    # the cells of areas have no room
    node_of_cell = np.where(room_number > 0, room_number + np.int32(num_labels), component)
    lower_node, higher_node = np.sort(
        node_of_cell.ravel()[list_differing_pairs(node_of_cell)], axis=0
    )
    key_base = int(node_of_cell.max(initial=0)) + 1
    is_shared = (lower_node > 0) & (lower_node < num_labels) & (higher_node >= num_labels)
    edge_keys = lower_node[is_shared].astype(np.int64) * key_base + higher_node[is_shared]
    shared_key, num_edges = np.unique(edge_keys, return_counts=True)
    sort_indices = np.lexsort((-shared_key, num_edges))  # the last one written stays
    touched_room = np.zeros(num_labels, dtype=np.int32)
    touched_room[shared_key[sort_indices] // key_base] = (
        shared_key[sort_indices] % key_base - num_labels
    )
    return touched_room


def renumber(label: Int32) -> tuple[Int32, Int32]:
    """Renumber labels from 1, in the order in which their first cells are read, row by row.

    Args:
        label: the label of each cell, 0 for none, shape (height, width).

    Returns:
        The new label of each cell; and the old labels in the order of the new ones.
    """
    runs = find_row_runs(label)
    new_label_of_run, labels_in_order = number_in_order(runs.value)
    return runs.paint(new_label_of_run, label.shape), labels_in_order


def number_in_order(label: Int32) -> tuple[Int32, Int32]:
    """Renumber labels from 1, in the order in which they come first.

    Args:
        label: labels of cells or of runs, in the order in which they are read, 0 for none, shape
            (n,).

    Returns:
        The new labels, shape (n,); and the old labels in the order of the new ones.
    """
    used_labels, first_indices = np.unique(label, return_index=True)
    labels_in_order = used_labels[np.argsort(first_indices)]
    labels_in_order = labels_in_order[labels_in_order > 0]
    new_label = np.zeros(int(labels_in_order.max(initial=0)) + 1, dtype=np.int32)
    new_label[labels_in_order] = np.arange(1, len(labels_in_order) + 1)
    return new_label[label], labels_in_order
