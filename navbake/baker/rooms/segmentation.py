"""Rooms that are found automatically: how the floor of a level is divided into segments.

A *gap* is a narrow place of the floor, such as a doorway, see `gaps.py`. A *space* is a connected
part of the floor between gaps, while the floor is being divided. A *segment* is a space at the end,
which becomes a room unless geoms, sites or polygons mark rooms in it. The steps:

1. `segment_by_gaps` separates spaces at gaps, joins spaces again whose gap is too wide to be a
   door, gives the cells of gaps to the nearest space, and joins stairs and small spaces to a
   neighbour (`_SpaceGraph`).
2. `assign_covered` and `assign_unmarked` divide the cells of segments between marked and new rooms.
3. `mark_cavities` finds segments that are hollows of the building, and no rooms.
4. `find_outdoors` finds segments that are outdoors.
5. `assign_leaf_cells` gives the cells of closed door leaves to the rooms beside them.

`rooms.py` calls these functions.
"""

import heapq
from typing import NamedTuple

import numpy as np

from navbake.baker.core.components import (
    adjacent_pairs,
    count_cells_by_label,
    find_row_runs,
    label_components,
    label_components_2d,
)
from navbake.baker.core.windows import bounding_window, differing_pairs
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.rooms.flags import MIN_OUTDOOR_EDGE, LevelFlags, RoomFlags, mark_edge
from navbake.baker.rooms.gap_limits import MAX_GAP_WIDTH
from navbake.baker.rooms.gaps import CloseCall, SpaceMerger, find_gaps
from navbake.baker.rooms.leaves import LeafMarks
from navbake.baker.rooms.walls import (
    WallRays,
    mark_wall_nodes,
    squared_distances,
    squared_distances_at,
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

# A space that nothing leads into is a room if it has at least this area [m²] and greatest width [m]
MIN_CLOSED_ROOM_AREA = 2.0
MIN_CLOSED_ROOM_WIDTH = 1.0

# A cell that is not under the sky is under eaves if it is at most this far from the edge [m]
MAX_EAVES_DEPTH = 1.2
# Outdoors, at least this share of the floor is under the sky or under eaves
MIN_OPEN_SHARE = 0.5


# ---------------------------------------------------------------- segments between gaps


def segment_by_gaps(
    level: LevelFlags,
    cell_size: float,
    min_area: float,
    door_width: float | None = None,
    walls: Shapes | None = None,
    lattice: Lattice | None = None,
    leaves: LeafMarks | None = None,
) -> tuple[Int32, list[CloseCall]]:
    """Divide the open floor of a level into segments, the candidates for rooms, at narrow places.

    A gap is a narrow place, such as a doorway: a straight line of open cells from wall to wall, in
    the direction of a wall, beside which the floor is abruptly wider. At first, each gap separates
    two spaces. Then the spaces on both sides of a gap are joined in these cases:

    - first, if the gap is about as wide as both spaces: parts of one corridor, or of an L-shaped
      room;
    - then, if the gap is about as wide as the narrower of both spaces (niches, bays, the depth of a
      doorway), or wider than 2.5 m. But a long passage that opens into a wider space stays a room
      of its own, at a mouth of up to 3.2 m. With a `door_width`, this width replaces both limits.

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
        leaves: the closed door leaves; None if there are none. A leaf that separates two spaces
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
    segment = np.zeros(level.is_open.shape, dtype=np.int32)
    if not level.is_open.any():
        return segment, []
    # with the cells around it: walls there have directions that count; the grid's edge is no wall
    open_rows, open_cols = bounding_window(level.is_open)
    window = (
        slice(max(open_rows.start - 1, 0), open_rows.stop + 1),
        slice(max(open_cols.start - 1, 0), open_cols.stop + 1),
    )
    rows, cols = window
    floor = level.floor[window]
    at_edge = level.at_edge[window]
    open_cells = np.ascontiguousarray(level.is_open[window])
    holes = np.ascontiguousarray(level.is_hole[window])
    rays = None
    if walls is not None and lattice is not None:
        rays = WallRays(walls, lattice.cut(rows, cols), floor)
    closed = np.zeros_like(open_cells) if leaves is None else leaves.separating[window]
    label, close_calls = _label_at_gaps(open_cells, holes, cell_size, door_width, rays, closed)
    del rays  # which hold the walls in all directions
    open_cells = open_cells & ~closed
    beyond = np.empty((2, 0), dtype=np.int64)  # rows and columns in the window
    if leaves is not None:
        # rooms meet in the cells of a leaf, not beside it
        if leaves.not_separating.any():
            spread_labels(label, open_cells & ~leaves.not_separating[window])
        beyond_row, beyond_col = np.divmod(leaves.cells_beyond, level.is_open.shape[1])
        beyond = np.stack([beyond_row - rows.start, beyond_col - cols.start])
    spread_labels(label, open_cells)
    _label_spaces_behind(beyond, label, open_cells)
    label = _join_spaces(label, open_cells, floor, at_edge, beyond, cell_size, min_area)
    segment[window], _ = renumber(label)
    close_calls = [
        call._replace(cell=(call.cell[0] + rows.start, call.cell[1] + cols.start))
        for call in close_calls
    ]
    return segment, close_calls


def _label_at_gaps(
    open_cells: Bool,
    holes: Bool,
    cell_size: float,
    door_width: float | None,
    rays: WallRays | None,
    closed: Bool,
) -> tuple[Int32, list[CloseCall]]:
    """Label the spaces between gaps, after the spaces on both sides of wide gaps were joined.

    Args:
        open_cells: cells with a floor and without a wall, shape (height, width).
        holes: cells with neither floor nor wall.
        cell_size: the side of a cell, > 0 [m].
        door_width: the widest gap that separates two rooms [m]; None for the limits of
            `segment_by_gaps`.
        rays: rays to the geometry of walls; None to measure widths in cells.
        closed: cells of the closed leaves that separate two spaces.

    Returns:
        The label of each cell's space, 0 for none, shape (height, width); and the gaps that nearly
        joined, or nearly separated, two spaces.
    """
    separated = find_gaps(open_cells, holes, cell_size, door_width, rays, closed)
    merger = SpaceMerger(separated, cell_size, door_width, rays)
    merger.join_spaces()
    return merger.space_of[separated.label], merger.list_close_calls()


def _label_spaces_behind(beyond: Int, label: Int32, open_cells: Bool) -> None:
    """Label the spaces behind closed leaves that have no label yet, as all of their cells are gaps.

    Args:
        beyond: rows and columns of cells in the spaces that leaves lead into, shape (2, n).
        label: the space of each cell, 0 for none, shape (height, width); is changed.
        open_cells: cells of spaces and of gaps between them.
    """
    row, col = beyond[:, label[tuple(beyond)] == 0]
    if not len(row):
        return
    component, num_components = label_components_2d(open_cells & (label == 0))
    new_label = np.zeros(num_components + 1, dtype=np.int32)
    unlabelled = np.unique(component[row, col])
    new_label[unlabelled] = label.max() + 1 + np.arange(len(unlabelled))
    label += new_label[component]


def _join_spaces(
    label: Int32,
    open_cells: Bool,
    floor: Float,
    at_edge: Bool,
    beyond: Int,
    cell_size: float,
    min_area: float,
) -> Int32:
    """Join stairs and small spaces to a neighbour.

    Args:
        label: the space of each cell, 0 for none, shape (height, width).
        open_cells: cells of spaces and of gaps between them.
        floor: heights of the floor [m].
        at_edge: cells at the outer boundary of the scene, see `LevelFlags.at_edge`.
        beyond: rows and columns of cells in spaces that closed leaves lead into, shape (2, n).
        cell_size: the side of a cell, > 0 [m].
        min_area: the least area of a room [m²].

    Returns:
        The space of each cell after the joins, 0 where it is still too small for a room.
    """
    min_cells = min_area / cell_size**2 - CELL_ROUNDING
    count = int(label.max(initial=0)) + 1
    num_cells = count_cells_by_label(label, count)
    num_steep = np.bincount(label[mark_steep(label, floor, cell_size)], minlength=count)
    is_stair = num_steep >= MIN_STAIR_SHARE * np.maximum(num_cells, 1)
    joins = is_stair | (num_cells > 0) & (num_cells < min_cells)
    if not joins[1:].any():
        return label
    num_at_edge = np.bincount(label[at_edge], minlength=count)
    is_room = np.bincount(label[tuple(beyond)], minlength=count) > 0
    is_room &= num_at_edge == 0
    # distances matter up to half the widest gap [half cells]
    reach = int(MAX_GAP_WIDTH / cell_size) + 2
    graph = _SpaceGraph(label, num_cells, joins, open_cells, reach)
    if is_stair.any():
        sums = np.bincount(label.ravel(), np.where(label > 0, floor, 0.0).ravel(), count)
        heights = sums / np.maximum(num_cells, 1)
        peaks = find_widest_distances(
            label, squared_distances(mark_wall_nodes(open_cells), reach), count
        )
        graph.join_stairs(is_stair, heights, np.sqrt(peaks))
    graph.join_small_spaces(min_cells, num_at_edge, MAX_GAP_WIDTH / cell_size)
    return graph.select_rooms(min_cells, is_room)[label]


def spread_labels(label: Int32, open_cells: Bool) -> None:
    """Spread labels to the open cells without a label, each wave by one cell across cells' edges.

    If several labels reach a cell in one wave, the label of the nearest labelled cell wins. On a
    tie, the lower label wins; of equal labels, the one whose cell lies further clockwise. This rule
    does not depend on the map's orientation.

    Args:
        label: the label of each cell, from 1, 0 for none, shape (height, width); is changed.
        open_cells: cells that may receive a label.
    """
    width = label.shape[1] + 2
    labels = np.pad(label, 1).ravel()
    waiting = np.flatnonzero(np.pad(open_cells, 1).ravel() & (labels == 0))
    # from each cell to the cell that its label is from
    downs = np.zeros(len(labels), dtype=np.int32)
    rights = np.zeros(len(labels), dtype=np.int32)
    # to the four neighbours: rows, columns, and both in the padded array
    steps = (0, 1, 1), (1, 0, width), (0, -1, -1), (-1, 0, -width)
    while len(waiting):
        is_reached = np.logical_or.reduce([labels[waiting + step] > 0 for _, _, step in steps])
        if not is_reached.any():
            break
        wave = waiting[is_reached]
        waiting = waiting[~is_reached]
        best_square = np.zeros(len(wave), dtype=np.int32)
        best_label = np.zeros(len(wave), dtype=np.int32)
        best_down = np.zeros(len(wave), dtype=np.int32)
        best_right = np.zeros(len(wave), dtype=np.int32)
        for row_step, col_step, step in steps:
            neighbor = wave + step
            new_label = labels[neighbor]
            down = downs[neighbor] + row_step
            right = rights[neighbor] + col_step
            square = down**2 + right**2
            is_clockwise = best_right * down - best_down * right > 0
            wins_tie = (new_label < best_label) | (new_label == best_label) & is_clockwise
            is_nearer = (square < best_square) | (square == best_square) & wins_tie
            is_better = (new_label > 0) & ((best_label == 0) | is_nearer)
            np.copyto(best_square, square, where=is_better)
            np.copyto(best_label, new_label, where=is_better)
            np.copyto(best_down, down, where=is_better)
            np.copyto(best_right, right, where=is_better)
        labels[wave] = best_label
        downs[wave] = best_down
        rights[wave] = best_right
    label[:] = labels.reshape(-1, width)[1:-1, 1:-1]


def mark_steep(label: Int32, floor: Float, cell_size: float) -> Bool:
    """Mark the labelled cells where the floor rises like a stair.

    Args:
        label: the label of each cell, shape (height, width). To cells with 0 no rise is measured.
        floor: heights of the floor [m].
        cell_size: the side of a cell, > 0 [m].
    """
    reach = max(1, round(STEEPNESS_REACH / cell_size))  # [cells]
    min_rise = MIN_STEEPNESS * 2 * reach * cell_size
    is_steep = np.zeros(label.shape, dtype=np.bool_)
    if not np.fmax.reduce(floor, axis=None) - np.fmin.reduce(floor, axis=None) >= min_rise / 2:
        return is_steep

    def mark_rows(first: int, end: int) -> None:
        window = slice(max(first - reach, 0), end + reach)
        height = np.where(label[window] > 0, floor[window], np.nan)
        squared_rise = np.zeros(height.shape)  # over rows and columns together
        for along, squared in ((height, squared_rise), (height.T, squared_rise.T)):
            rise = along[2 * reach :] - along[: -2 * reach]
            rise *= rise
            squared[reach:-reach] += np.fmax(rise, 0.0, out=rise)  # NaN becomes 0
        inner = slice(first - window.start, end - window.start)
        is_steep[first:end] = (squared_rise[inner] >= min_rise**2) & (label[first:end] > 0)

    run_in_chunks(mark_rows, len(label), least=2 * reach)
    return is_steep


class SpaceContact(NamedTuple):
    """The boundary along which two spaces touch.

    Attributes:
        distance: how far the place on the boundary that is farthest from walls is from them, half
            of the opening's width [half cells].
        length: the number of edges between a cell of one space and a cell of the other.
    """

    distance: float
    length: int


class _SpaceGraph:
    """Spaces, where they touch, and which of them were joined.

    This is a region adjacency graph whose nodes are contracted (Haris, 1998).
    """

    def __init__(
        self, label: Int32, num_cells: Int, joins: Bool, open_cells: Bool, reach: int
    ) -> None:
        """Find where spaces touch, and how wide the openings between them are.

        Args:
            label: the space of each cell, 0 for none.
            num_cells: the number of cells of each space, by label.
            joins: by label, whether a space may be joined to a neighbour. Between two spaces that
                may not, no contact is recorded.
            open_cells: cells of spaces and gaps.
            reach: up to which distances to walls are measured [half cells].
        """
        count = len(num_cells)
        self._num_cells = num_cells.copy()
        # label -> the space that it belongs to after the joins so far
        self._space_of = np.arange(count, dtype=np.int32)
        # the edges between cells of two spaces
        edge_cells = differing_pairs(label)
        spaces = np.sort(label.ravel()[edge_cells].astype(np.int64), axis=0)
        meet = (spaces[0] > 0) & joins[spaces].any(axis=0)
        spaces = spaces[:, meet]
        row, col = _edge_nodes(edge_cells[:, meet], label.shape[1])
        squared = squared_distances_at(open_cells, reach, row, col)
        widest = squared.reshape(3, -1).max(axis=0)
        keys, key_of_edge, lengths = np.unique(
            spaces[0] * count + spaces[1], return_inverse=True, return_counts=True
        )
        distances = np.zeros(len(keys))
        np.maximum.at(distances, key_of_edge, np.sqrt(widest))
        # by space and neighbour
        self._passages: list[dict[int, SpaceContact]] = [{} for _ in num_cells]
        for key, distance, length in zip(
            keys.tolist(), distances.tolist(), lengths.tolist(), strict=True
        ):
            first, second = divmod(key, count)
            passage = SpaceContact(distance, length)
            self._passages[first][second] = passage
            self._passages[second][first] = passage

    def join_stairs(self, is_stair: Bool, height: Float, peak: Float) -> None:
        """Join each stair to the lowest of the spaces that it opens to over its full width.

        Args:
            is_stair: by label, whether the space is a stair.
            height: by label, the mean height of the space's floor [m].
            peak: by label, the distance to walls at the space's widest place [half cells]; is
                changed.
        """
        for stair in np.flatnonzero(is_stair).tolist():
            if self._space_of[stair] != stair:
                continue
            min_distance = peak[stair] - WIDTH_ROUGHNESS - CELL_ROUNDING
            neighbors = [
                neighbor
                for neighbor, passage in self._passages[stair].items()
                if passage.distance >= min_distance
            ]
            if neighbors:
                lowest = min(neighbors, key=lambda neighbor: (height[neighbor], neighbor))
                self._join(lowest, stair)
                peak[lowest] = max(peak[lowest], peak[stair])

    def join_small_spaces(self, min_cells: float, num_at_edge: Int, max_counted: float) -> None:
        """Join each small space, the smallest first, to the neighbour that it opens to the widest.

        If the small space has cells at the edge of the grid, as a ledge round a house has, it is
        joined to the neighbour with the most cells there instead. If it has more than `max_counted`
        of them, it is only joined to a neighbour that has more than that, too.

        Args:
            min_cells: spaces with fewer cells are small.
            num_at_edge: by label, how many cells of the space are at the edge of the grid; is
                changed.
            max_counted: neighbours with this many cells at the edge, or more, count as equal.
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
            num_cells, small = heapq.heappop(queue)
            # a space that has grown since it was queued is in the queue a second time
            if self._space_of[small] != small or self._num_cells[small] != num_cells:
                continue
            ranks = []
            for neighbor, passage in self._passages[small].items():
                edge_rank = min(num_at_edge[neighbor], max_counted) if num_at_edge[small] else 0
                ranks.append((edge_rank, *passage, self._num_cells[neighbor], -neighbor))
            if not ranks:
                continue
            best = -max(ranks)[-1]
            if num_at_edge[small] > max_counted >= num_at_edge[best]:
                continue
            self._join(best, small)
            num_at_edge[best] += num_at_edge[small]
            if self._num_cells[best] < min_cells:
                heapq.heappush(queue, (int(self._num_cells[best]), best))

    def select_rooms(self, min_cells: float, is_room: Bool) -> Int32:
        """Return by label the space that the label belongs to now, 0 if that space is too small.

        Args:
            min_cells: the least number of cells of a space that isn't too small.
            is_room: by label, whether the space that it belongs to is a room whatever its size.
        """
        is_large = self._num_cells >= min_cells
        is_large[self._space_of[is_room]] = True
        return np.where(is_large[self._space_of], self._space_of, np.int32(0))

    def _join(self, joined: int, removed: int) -> None:
        """Make the space `removed` a part of the space `joined`."""
        self._space_of[self._space_of == removed] = joined
        for neighbor, passage in self._passages[removed].items():
            del self._passages[neighbor][removed]
            if neighbor == joined:
                continue
            former = self._passages[joined].get(neighbor, SpaceContact(0.0, 0))
            combined = SpaceContact(
                max(former.distance, passage.distance), former.length + passage.length
            )
            self._passages[joined][neighbor] = combined
            self._passages[neighbor][joined] = combined
        self._passages[removed] = {}
        self._num_cells[joined] += self._num_cells[removed]


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
    is_fixed = centers[:, 0] == centers[:, 1]
    offset = is_fixed * np.array([-1, 0, 1])[:, None, None]
    nodes = (centers[:, :1] + centers[:, 1:]) // 2 + offset.swapaxes(0, 1)
    rows, cols = nodes.reshape(2, -1)
    return rows, cols


def find_widest_distances(label: Int32, distance: Int32, count: int) -> Int32:
    """Find how far the widest place of each labelled area is from walls.

    Args:
        label: the label of each cell, 0 for none, shape (height, width).
        distance: the squared distance of each node from the nearest wall, shape (2 height + 1,
            2 width + 1) [half cells squared]; nodes are the cells' centres, corners and middles of
            edges, see `mark_wall_nodes`.
        count: number of labels, including label 0.

    Returns:
        By label, the largest squared distance of all nodes on its cells, shape (count,).
    """
    rows = np.maximum(distance[1::2], np.maximum(distance[:-2:2], distance[2::2]))
    nodes = np.maximum(rows[:, 1::2], np.maximum(rows[:, :-2:2], rows[:, 2::2]))
    peaks = np.zeros(count, dtype=np.int32)
    np.maximum.at(peaks, label[label > 0], nodes[label > 0])
    return peaks


# ---------------------------------------------------------------- segments and marked rooms


def assign_covered(owner: Int32, under: Int32, segment: Int32) -> Int32:
    """Give cells without a room (of a podium, for example) to the room below their floor.

    This is only done if that room has cells in the same segment: so a house does not become part of
    the ground that it stands on.

    Args:
        owner: the marked room of each cell, 0 for none, shape (height, width).
        under: the marked room whose floor lies under each cell's floor, 0 for none.
        segment: the part of the floor between gaps that each cell belongs to, 0 for none.

    Returns:
        The room of each cell, shape (height, width).
    """
    base = int(max(owner.max(initial=0), under.max(initial=0))) + 1
    owned = owner > 0
    rooms_in_segments = np.unique(segment[owned].astype(np.int64) * base + owner[owned])
    is_covered = (owner == 0) & (under > 0) & (segment > 0)
    keys = segment[is_covered].astype(np.int64) * base + under[is_covered]
    is_covered[is_covered] = np.isin(keys, rooms_in_segments)
    return np.where(is_covered, under, owner)


def assign_unmarked(
    owner: Int32, segment: Int32, cell_size: float, min_area: float, beyond: Int | None = None
) -> tuple[Int32, Int32]:
    """Divide the cells that belong to no marked room between marked rooms and new rooms.

    Marked rooms are those that geoms, sites or polygons mark. A segment (a part of the floor
    between gaps) without a marked room becomes a new room. In a segment with marked rooms, each
    connected area that belongs to none of them becomes a new room, unless it is smaller than
    `min_area`, or nowhere half a metre wide though its segment is. Such an area is added to the
    marked room that it touches most. If it touches none, it becomes a room only if a closed door
    leaf leads into it.

    Args:
        owner: the marked room of each cell, 0 for none, shape (height, width).
        segment: the segment of each cell, 0 for none.
        cell_size: the side of a cell, > 0 [m].
        min_area: the least area of a new room [m²].
        beyond: ids of cells in the spaces that closed leaves lead into, None for none.

    Returns:
        The marked room of each cell, with the added areas, 0 for none; and the new room of each
        cell, from 1, 0 for none.
    """
    min_cells = min_area / cell_size**2 - CELL_ROUNDING
    has_marks = np.zeros(int(segment.max(initial=0)) + 1, dtype=np.bool_)
    has_marks[segment[owner > 0]] = True
    unmarked = np.where(owner == 0, segment, 0)
    component, _ = label_components_2d(np.where(has_marks[unmarked], unmarked, 0))
    num_cells, is_wide = _measure_components(component, cell_size)
    is_room = (num_cells >= min_cells) & is_wide
    if not (is_room | (num_cells < min_cells)).all():
        # the rest of a ledge is as narrow as the ledge: that is no reason to give it away
        segment_of = np.zeros(len(num_cells), dtype=np.int32)
        segment_of[component] = segment
        _, is_segment_wide = _measure_components(segment, cell_size)
        is_room |= (num_cells >= min_cells) & ~is_segment_wide[segment_of]
    touched = _find_most_touched(component, owner, len(num_cells))
    if beyond is not None:
        is_beyond = np.zeros(len(num_cells), dtype=np.bool_)
        is_beyond[component.ravel()[beyond]] = True
        is_room |= is_beyond & (touched == 0)
    is_room[0] = False
    touched_owner = np.where(is_room[component], 0, touched[component])
    new_owner = np.where(owner > 0, owner, touched_owner).astype(np.int32)
    # segments without marks are numbered behind the components of others
    unmarked_segment = np.where(
        has_marks[unmarked], 0, unmarked + np.int32(len(num_cells)) * (unmarked > 0)
    )
    new_room, _ = renumber(
        np.where(is_room[component], component, unmarked_segment).astype(np.int32)
    )
    return new_owner, new_room


def assign_leaf_cells(owner: Int32, leaf_cells: Bool) -> None:
    """Give leaf cells without a room to the nearest room beside them; on a tie, to the smaller one.

    Sizes decide, and not the rooms' numbers, because those change when the map is turned.

    Args:
        owner: the room of each cell, 0 for none, shape (height, width); is changed.
        leaf_cells: a mask of the cells of closed door leaves.
    """
    without_room = leaf_cells & (owner == 0)
    num_cells = count_cells_by_label(owner, int(owner.max(initial=0)) + 1)
    by_size = np.append(0, np.argsort(num_cells[1:], kind="stable") + 1).astype(np.int32)
    rank_of = np.empty_like(by_size)
    rank_of[by_size] = np.arange(len(by_size))
    rank = rank_of[owner]
    spread_labels(rank, without_room)
    owner[without_room] = by_size[rank[without_room]]


def _measure_components(label: Int32, cell_size: float) -> tuple[Int, Bool]:
    """Count the cells of each label, and find whether their area is half a metre wide anywhere.

    Returns:
        By label, the number of its cells (0 for label 0); and whether they are wide enough.
    """
    reach = int(MIN_REMAINDER_WIDTH / cell_size) + 2
    at_boundary = mark_wall_nodes(label > 0)
    height, width = label.shape
    for k in range(3):  # the nodes on each edge between two labels
        at_boundary[k : k + 2 * height - 1 : 2, 2:-1:2] |= label[:, :-1] != label[:, 1:]
        at_boundary[2:-1:2, k : k + 2 * width - 1 : 2] |= label[:-1] != label[1:]
    num_cells = count_cells_by_label(label, int(label.max(initial=0)) + 1)
    peaks = find_widest_distances(label, squared_distances(at_boundary, reach), len(num_cells))
    # twice the distance to the boundary, in half cells: the widest disc that fits
    return num_cells, peaks >= (MIN_REMAINDER_WIDTH / cell_size) ** 2 - CELL_ROUNDING


def _find_most_touched(component: Int32, owner: Int32, count: int) -> Int32:
    """Find for each area the marked room that it shares the most edges of cells with.

    Args:
        component: the area of each cell, 0 for none, shape (height, width).
        owner: the marked room of each cell, 0 for none; areas have cells without a room only.
        count: number of areas, plus 1.

    Returns:
        By area, the number of the room, 0 if it touches none, shape (count,). Of equals, the room
        with the lowest number counts.
    """
    node = np.where(owner > 0, owner + np.int32(count), component)  # components have no owner
    low, high = np.sort(node.ravel()[differing_pairs(node)], axis=0)
    base = int(node.max(initial=0)) + 1
    is_shared = (low > 0) & (low < count) & (high >= count)
    keys = low[is_shared].astype(np.int64) * base + high[is_shared]
    key, num_edges = np.unique(keys, return_counts=True)
    order = np.lexsort((-key, num_edges))  # the last one written stays
    touched = np.zeros(count, dtype=np.int32)
    touched[key[order] // base] = key[order] % base - count
    return touched


def renumber(label: Int32) -> tuple[Int32, Int]:
    """Renumber labels from 1, in the order in which their first cells are read, row by row.

    Args:
        label: the label of each cell, 0 for none, shape (height, width).

    Returns:
        The new label of each cell; and the old labels in the order of the new ones.
    """
    *_, value = find_row_runs(label)
    used, first = np.unique(value, return_index=True)
    order = used[np.argsort(first)]
    new_label = np.zeros(int(order.max(initial=0)) + 1, dtype=np.int32)
    new_label[order] = np.arange(1, len(order) + 1)
    return new_label[label], order


# ---------------------------------------------------------------- cavities and outdoors


def mark_cavities(
    segment: Int32, owner: Int32, flags: RoomFlags, level: int, beyond: Int | None = None
) -> Bool:
    """Mark the segments of a level that are cavities: hollow walls, shafts, chases.

    Nothing leads into a cavity: it touches no other segment or room and not the grid's edge, no
    link (a step to another level, or a slope) ends in it, and no closed door leaf leads into it.
    And it is smaller than `MIN_CLOSED_ROOM_AREA`, or narrower than `MIN_CLOSED_ROOM_WIDTH`. The
    largest segment is never a cavity.

    Args:
        segment: the part of the floor between gaps that each cell belongs to, 0 for none, shape
            (height, width).
        owner: the marked room of each cell, 0 for none.
        flags: the flags of the cells of all levels, and the links between cells.
        level: the number of the level.
        beyond: ids of cells in the spaces that closed leaves lead into, None for none.

    Returns:
        For each segment number, from 0: whether it is a cavity.
    """
    level_flags = flags.levels[level]
    cell_size = flags.lattice.cell_size
    count = int(segment.max(initial=0)) + 1
    area = count_cells_by_label(segment, count) * cell_size**2
    space = np.where(owner > 0, owner + count, segment)
    pairs = space.ravel()[differing_pairs(space)]
    is_open = np.zeros(count, dtype=np.bool_)
    is_open[0] = True
    is_open[pairs[(pairs > 0).all(axis=0) & (pairs < count)]] = True
    is_open[segment[level_flags.at_edge]] = True
    if beyond is not None:
        is_open[segment.ravel()[beyond]] = True
    for level_column, cell_column in ((0, 1), (2, 3)):  # of both ends of links
        on_level = flags.links[flags.links[:, level_column] == level]
        is_open[segment.ravel()[on_level[:, cell_column]]] = True
    is_open |= area >= area[1:].max(initial=0.0)
    is_cavity: Bool = ~is_open & (area < MIN_CLOSED_ROOM_AREA)
    if (is_open | is_cavity).all():
        return is_cavity
    reach = int(MIN_CLOSED_ROOM_WIDTH / cell_size) + 2
    peaks = find_widest_distances(
        segment, squared_distances(mark_wall_nodes(segment > 0), reach), count
    )
    is_wide = peaks >= (MIN_CLOSED_ROOM_WIDTH / cell_size) ** 2 - CELL_ROUNDING
    return is_cavity | ~is_open & ~is_wide


def find_outdoors(segment: Int32, flags: RoomFlags, level: int) -> tuple[Int32, set[int]]:
    """Find the segments of a level that are outdoors, and unite those that touch.

    A segment is outdoors if it touches the edge of the grid over a connected length that is wider
    than any door, and if at least half of its cells have nothing above an agent's head or lie under
    eaves. Outdoor segments that a wall separates stay apart, unless the ground is endless. Segments
    on both sides of a ditch are united.

    Args:
        segment: the part of the floor between gaps that each cell belongs to, 0 for none, shape
            (height, width).
        flags: the flags of the cells of all levels.
        level: the number of the level.

    Returns:
        The segment of each cell, with touching outdoor segments united; and the numbers of the
        outdoor segments.
    """
    level_flags = flags.levels[level]
    cell_size = flags.lattice.cell_size
    count = int(segment.max(initial=0)) + 1
    extents = _measure_edge_extents(segment, level_flags.at_edge & (segment > 0), count)
    is_candidate = extents * cell_size > MIN_OUTDOOR_EDGE
    if not is_candidate.any():
        return segment, set()
    in_candidate = is_candidate[segment]
    is_open = level_flags.under_sky[in_candidate]
    if not is_open.all() and flags.scene_ends.any():
        # where the lattice crops the scene, rooms go on beyond it
        at_end = in_candidate & mark_edge(flags.is_empty, flags.scene_ends)
        if at_end.any():
            reach = int(MAX_EAVES_DEPTH / cell_size) + 1
            squared = squared_distances(at_end, reach)[in_candidate]
            is_open |= np.sqrt(squared) * cell_size <= MAX_EAVES_DEPTH
    cell_segments = segment[in_candidate]
    num_open = np.bincount(cell_segments[is_open], minlength=count)
    num_cells = np.bincount(cell_segments, minlength=count)
    is_outdoors = is_candidate & (num_open >= MIN_OPEN_SHARE * num_cells)
    united = _unite_touching(segment, is_outdoors, level_flags.is_bank)
    if is_outdoors.any() and flags.has_ground:
        united[is_outdoors] = united[is_outdoors].min()
    return united[segment], set(np.unique(united[is_outdoors]).tolist())


def _unite_touching(segment: Int32, is_outdoors: Bool, is_bank: Bool) -> Int32:
    """Unite outdoor segments that touch each other, or the same bank (ground that is too steep).

    Args:
        segment: the segment of each cell, 0 for none, shape (height, width).
        is_outdoors: by segment, whether it is outdoors.
        is_bank: cells without a floor whose ground is too steep, see `LevelFlags.is_bank`.

    Returns:
        By segment, the lowest number of the segments that it is united with, itself included.
    """
    bank, num_banks = label_components_2d(is_bank)
    # nodes are the segments, and behind them the banks
    node = np.where(is_bank, bank + len(is_outdoors) - 1, segment)
    joins = np.concatenate([is_outdoors, np.ones(num_banks, dtype=np.bool_)])
    pairs = node.ravel()[differing_pairs(node)]
    # the first node of a component is its least
    component = label_components(pairs[:, joins[pairs].all(axis=0)], len(joins))
    least = np.unique(component, return_index=True)[1].astype(np.int32)
    return least[component][: len(is_outdoors)]


def _measure_edge_extents(segment: Int32, at_edge: Bool, count: int) -> Float:
    """Measure over which connected length each segment touches the edge of the grid [cells].

    Of several connected pieces of a segment's cells at the edge, the longest counts. The length of
    a piece is the diagonal of the rectangle round it.

    Args:
        segment: the segment of each cell, shape (height, width).
        at_edge: a mask of the cells at the edge that are in a segment.
        count: the number of segments, plus 1.

    Returns:
        The lengths by segment, 0 for segments that don't touch the edge, shape (count,).
    """
    cell = np.flatnonzero(at_edge)
    rows, cols = np.divmod(cell, segment.shape[1])
    segment_of = segment[rows, cols]
    pairs = adjacent_pairs(cell, segment.shape[1])
    piece = label_components(pairs[:, segment_of[pairs[0]] == segment_of[pairs[1]]], len(cell))
    extent = np.zeros(len(cell))
    for position in (rows, cols):
        low = np.full(len(cell), np.inf)
        high = np.full(len(cell), -np.inf)
        np.minimum.at(low, piece, position)
        np.maximum.at(high, piece, position)
        extent = np.hypot(extent, (high - low)[piece])
    longest = np.zeros(count)
    np.maximum.at(longest, segment_of, extent + 1)
    return longest
