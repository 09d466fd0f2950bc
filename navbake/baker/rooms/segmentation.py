"""The spaces of a level as rooms: gaps part them, stairs and small ones join another; outdoors."""

import heapq

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
from navbake.baker.rooms.flags import EDGE_LENGTH, LevelFlags, RoomFlags, edge_cells
from navbake.baker.rooms.gaps import WIDEST, CloseCall, Spaces, find_gaps
from navbake.baker.rooms.leaves import LeafMarks
from navbake.baker.rooms.walls import WallRays, distances_at, squared_distances, wall_nodes
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# The rest of a segment with marked rooms is no room if it is nowhere as wide as this [m]
SLIVER = 0.5
# A cell is steep, like a stair, where the floor rises by this share of the distance, over so far
# on both sides of it [m]; a region is a stair where this share of its cells is as steep as one
STEEPNESS = 0.3
SLOPE_REACH = 0.3
STAIR_SHARE = 0.5
# By how much the distance from a corridor's middle to its walls varies at most, over all angles and
# offsets to the lattice [half cells]
ROUGHNESS = 1.0
ROUNDING = 1e-6  # of a cell, or of half a cell
# What is no further from the edge lies under eaves, if it isn't under the sky [m]
EAVES = 1.2
# A space that nothing leads into is a room from this area and greatest width on [m², m]
CAVITY = 2.0, 1.0
# Outdoors, at least this share of the floor is under the sky or under eaves
OPEN_SHARE = 0.5


def segment_by_gaps(
    level: LevelFlags,
    cell_size: float,
    min_area: float,
    door_width: float | None = None,
    walls: Shapes | None = None,
    lattice: Lattice | None = None,
    leaves: LeafMarks | None = None,
) -> tuple[Int32, list[CloseCall]]:
    """Divide the open cells of a level into rooms, at gaps much narrower than the rooms are.

    A gap is a line in the direction of a wall, closed at both ends after at most 2.5 m, beside
    which the space is abruptly wider. All gaps part spaces at first. Then spaces are joined, the
    widest gaps first:

    - where a gap is as wide as both spaces along its line: parts of one corridor, of an L-shaped
      room;
    - then where it is as wide as the narrower one: niches, bays, the depth of a doorway. A long
      passage that opens into a wider space stays a room of its own, at a mouth of up to 3.2 m;
    - with a `door_width` [m], where it is wider than that, in place of the two widths above.

    The width of a space is measured close behind the gap: up to the geometry of `walls` on the
    `lattice`, where both are given, else in cells. Gaps in one line between the same spaces count
    as one, so that a row of pillars parts nothing. Stairs that open to a room over their full width
    belong to it, at their foot rather than their head. A room smaller than `min_area` [m²] joins
    the one that it opens to the widest, or is none.

    Closed `leaves` that part two spaces do so here: no gap, no line and no join leads through them,
    and what they lead into is a room however small it is, unless it opens to another one or lies at
    the edge of the grid (a threshold). Their own cells are in no room yet.

    Returns the room of each cell from 1, in reading order, 0 for none; and close calls.

    Source:
        Region merging as in Bormann et al., "Room segmentation: survey, implementation, and
        analysis" (ICRA 2016), on regions between the "virtual walls" that continue walls, in
        place of those of a Voronoi graph.
    """
    rooms = np.zeros(level.open.shape, dtype=np.int32)
    if not level.open.any():
        return rooms, []
    # with the walls round it: their directions count, the edge of the grid is none
    window = bounding_window(level.open)
    row, col = (max(part.start - 1, 0) for part in window)
    around = slice(row, window[0].stop + 1), slice(col, window[1].stop + 1)
    floor = level.floor[around]
    edge = level.edge[around]
    open_cells = np.ascontiguousarray(level.open[around])
    hole = np.ascontiguousarray(level.hole[around])
    rays = None
    if walls is not None and lattice is not None:
        rays = WallRays(walls, lattice.cut(*around), floor)
    closed = np.zeros_like(open_cells) if leaves is None else leaves.parting[around]
    found, label, cells = find_gaps(open_cells, hole, cell_size, door_width, rays, closed)
    spaces = Spaces(found, cells, cell_size, door_width, rays)
    spaces.join_all()
    close = [c._replace(cell=(c.cell[0] + row, c.cell[1] + col)) for c in spaces.close_calls()]
    label = spaces.whole[label]
    del found, spaces, rays  # which hold the lattice in all directions
    open_cells = open_cells & ~closed
    beyond = np.empty((2, 0), dtype=np.int64)  # rows and columns
    if leaves is not None:
        # rooms meet in the cells of a leaf, not beside it
        if leaves.others.any():
            spread(label, open_cells & ~leaves.others[around])
        rows, cols = np.divmod(leaves.beyond, level.open.shape[1])
        beyond = np.stack([rows - around[0].start, cols - around[1].start])
    spread(label, open_cells)
    _label_cavities(label, open_cells, beyond)
    least = min_area / cell_size**2 - ROUNDING
    count = int(label.max(initial=0)) + 1
    cells = count_cells_by_label(label, count)
    steep = np.bincount(label[mark_steep(label, floor, cell_size)], minlength=count)
    is_stair = steep >= STAIR_SHARE * np.maximum(cells, 1)
    joins = is_stair | (cells > 0) & (cells < least)
    at_edge = np.bincount(label[edge], minlength=count)
    is_kept = np.bincount(label[tuple(beyond)], minlength=count) > 0
    is_kept &= at_edge == 0
    if joins[1:].any():
        # distances matter up to half the widest gap [half cells]
        reach = int(WIDEST / cell_size) + 2
        regions = _Regions(label, cells, joins, open_cells, reach)
        if is_stair.any():
            heights = np.bincount(label.ravel(), np.where(label > 0, floor, 0.0).ravel(), count)
            peaks = widest_nodes(label, squared_distances(wall_nodes(open_cells), reach), count)
            regions.join_stairs(is_stair, heights / np.maximum(cells, 1), np.sqrt(peaks))
        regions.join_small(least, at_edge, WIDEST / cell_size)
        label = regions.wholes(least, is_kept)[label]
    rooms[around] = renumber(label)[0]
    return rooms, close


def _label_cavities(label: Int32, open_cells: Bool, beyond: Int) -> None:
    """Label the spaces behind leaves that are all gap; `beyond` are rows and columns in them."""
    row, col = beyond[:, label[tuple(beyond)] == 0]
    if not len(row):
        return
    part, count = label_components_2d(open_cells & (label == 0))
    number = np.zeros(count + 1, dtype=np.int32)
    parts = np.unique(part[row, col])
    number[parts] = label.max() + 1 + np.arange(len(parts))
    label += number[part]


def spread(label: Int32, open_cells: Bool) -> None:
    """Spread labels to the open cells without one, wave by wave across edges.

    Of several in one wave, the nearest labelled cell wins, then the lower label, then the cell
    further clockwise, which turns with the map.
    """
    width = label.shape[1] + 2
    labels = np.pad(label, 1).ravel()
    waiting = np.flatnonzero(np.pad(open_cells, 1).ravel() & (labels == 0))
    # to the cell with a label that each one's is from
    downs, rights = np.zeros((2, len(labels)), dtype=np.int32)
    steps = (0, 1, 1), (1, 0, width), (0, -1, -1), (-1, 0, -width)
    while len(waiting):
        reached = np.logical_or.reduce([labels[waiting + step] > 0 for *_, step in steps])
        if not reached.any():
            break
        wave = waiting[reached]
        waiting = waiting[~reached]
        nearest, own, row, col = np.zeros((4, len(wave)), dtype=np.int32)
        for to_row, to_col, step in steps:
            cell = wave + step
            there = labels[cell]
            down = downs[cell] + to_row
            right = rights[cell] + to_col
            square = down**2 + right**2
            same = (there < own) | (there == own) & (col * down - row * right > 0)
            better = (own == 0) | (square < nearest) | (square == nearest) & same
            better &= there > 0
            kept = (nearest, own, row, col)
            new = (square, there, down, right)
            for old, array in zip(kept, new, strict=True):
                np.copyto(old, array, where=better)
        labels[wave] = own
        downs[wave] = row
        rights[wave] = col
    label[:] = labels.reshape(-1, width)[1:-1, 1:-1]


def mark_steep(label: Int32, floor: Float, cell_size: float) -> Bool:
    """Mark the labelled cells where the floor rises like a stair; what has no label is level."""
    steps = max(1, round(SLOPE_REACH / cell_size))
    rise = STEEPNESS * 2 * steps * cell_size
    steep = np.zeros(label.shape, dtype=np.bool_)
    if not np.fmax.reduce(floor, axis=None) - np.fmin.reduce(floor, axis=None) >= rise / 2:
        return steep

    def mark(first: int, end: int) -> None:
        around = slice(max(first - steps, 0), end + steps)
        height = np.where(label[around] > 0, floor[around], np.nan)
        squares = np.zeros(height.shape)
        for over, squared in ((height, squares), (height.T, squares.T)):
            change = over[2 * steps :] - over[: -2 * steps]
            change *= change
            squared[steps:-steps] += np.fmax(change, 0.0, out=change)  # NaN becomes 0
        inner = slice(first - around.start, end - around.start)
        steep[first:end] = (squares[inner] >= rise**2) & (label[first:end] > 0)

    run_in_chunks(mark, len(label), least=2 * steps)
    return steep


class _Regions:
    """Regions that touch, as a region adjacency graph, whose nodes are contracted (Haris, 1998)."""

    def __init__(self, label: Int32, cells: Int, joins: Bool, open_cells: Bool, reach: int) -> None:
        """Passes of regions that may join another, `joins`, are known, and widths up to `reach`."""
        self._cells = cells.copy()  # of each region from 1
        self._whole = np.arange(len(cells), dtype=np.int32)  # what each one is part of now
        # the edges between cells of two regions: these, and the distance at the widest node of each
        beside = differing_pairs(label)
        ends = np.sort(label.ravel()[beside].astype(np.int64), axis=0)
        meet = (ends[0] > 0) & joins[ends].any(axis=0)
        ends = ends[:, meet]
        nodes = 2 * np.array(np.divmod(beside[:, meet], label.shape[1])) + 1
        # an edge and its ends lie across the way from cell to cell
        across = (nodes[:, 0] == nodes[:, 1]) * np.array([-1, 0, 1])[:, None, None]
        row, col = ((nodes[:, :1] + nodes[:, 1:]) // 2 + across.swapaxes(0, 1)).reshape(2, -1)
        widest = distances_at(open_cells, reach, row, col).reshape(3, -1).max(axis=0)
        keys, place, length = np.unique(
            ends[0] * len(cells) + ends[1], return_inverse=True, return_counts=True
        )
        saddle = np.zeros(len(keys))
        np.maximum.at(saddle, place, np.sqrt(widest))
        # by region and neighbour, the distance at the widest place of the pass, and its edges of
        # cells
        self._passes: list[dict[int, tuple[float, int]]] = [{} for _ in cells]
        for key, *met in zip(keys.tolist(), saddle.tolist(), length.tolist(), strict=True):
            one, other = divmod(key, len(cells))
            self._passes[one][other] = self._passes[other][one] = (met[0], met[1])

    def join_stairs(self, is_stair: Bool, height: Float, peak: Float) -> None:
        """Join stairs to the lowest region, by mean `height`, that they open to in full width.

        `peak` is the distance to walls at each region's widest place [half cells].
        """
        for region in np.flatnonzero(is_stair).tolist():
            if self._whole[region] != region:
                continue
            least = peak[region] - ROUGHNESS - ROUNDING
            mouths = [to for to, (saddle, _) in self._passes[region].items() if saddle >= least]
            if mouths:
                to = min(mouths, key=lambda to: (height[to], to))
                self._join(to, region)
                peak[to] = max(peak[to], peak[region])

    def join_small(self, least: float, at_edge: Int, widest: float) -> None:
        """Join regions of fewer cells, the smallest first, to the one they open to the widest.

        A region with cells `at_edge` of the grid, such as a ledge round a house, joins the one with
        most cells there, of which `widest` are enough; with more than `widest` it joins only one
        with as many.
        """
        is_small = (self._whole == np.arange(len(self._cells))) & (self._cells < least)
        queue = [(int(self._cells[k]), k) for k in np.flatnonzero(is_small).tolist() if k]
        heapq.heapify(queue)
        while queue:
            cells, small = heapq.heappop(queue)
            # what has grown since it was queued is queued again
            if self._whole[small] != small or self._cells[small] != cells:
                continue
            ranks = [
                (min(at_edge[to], widest) if at_edge[small] else 0, *met, self._cells[to], -to)
                for to, met in self._passes[small].items()
            ]
            to = -max(ranks)[-1] if ranks else small
            if to == small or at_edge[small] > widest >= at_edge[to]:
                continue
            self._join(to, small)
            at_edge[to] += at_edge[small]
            if self._cells[to] < least:
                heapq.heappush(queue, (int(self._cells[to]), to))

    def wholes(self, least: float, is_kept: Bool) -> Int32:
        """The region that each one became part of.

        It is 0 where that has fewer than `least` cells, and none of its parts is kept.
        """
        is_room = self._cells >= least
        is_room[self._whole[is_kept]] = True
        return np.where(is_room[self._whole], self._whole, np.int32(0))

    def _join(self, to: int, gone: int) -> None:
        self._whole[self._whole == gone] = to
        for other, (saddle, length) in self._passes[gone].items():
            del self._passes[other][gone]
            if other != to:
                own = self._passes[to].get(other, (0.0, 0))
                met = max(own[0], saddle), own[1] + length
                self._passes[to][other] = self._passes[other][to] = met
        self._passes[gone] = {}
        self._cells[to] += self._cells[gone]


def widest_nodes(label: Int32, distance: Int32, num: int) -> Int32:
    """The largest distance of a node on any cell of each label, see `wall_nodes`."""
    rows = np.maximum(distance[1::2], np.maximum(distance[:-2:2], distance[2::2]))
    nodes = np.maximum(rows[:, 1::2], np.maximum(rows[:, :-2:2], rows[:, 2::2]))
    peaks = np.zeros(num, dtype=np.int32)
    np.maximum.at(peaks, label[label > 0], nodes[label > 0])
    return peaks


def give_covered(owner: Int32, under: Int32, segment: Int32) -> Int32:
    """Give cells (a podium) to the room whose floor lies under theirs, if it is in their segment.

    So a house is no part of the ground that it stands on.
    """
    base = int(max(owner.max(initial=0), under.max(initial=0))) + 1
    held = np.unique(segment[owner > 0].astype(np.int64) * base + owner[owner > 0])
    takes = (owner == 0) & (under > 0) & (segment > 0)
    takes[takes] = np.isin(segment[takes].astype(np.int64) * base + under[takes], held)
    return np.where(takes, under, owner)


def share_rest(
    owner: Int32, segment: Int32, cell_size: float, min_area: float, beyond: Int | None = None
) -> tuple[Int32, Int32]:
    """Make rooms of what marked rooms, `owner`, leave of segments: owners, and new rooms.

    A segment without a mark is a room. In others each connected part of the rest is one, unless it
    is smaller than `min_area` [m²], or nowhere half a metre wide though its segment is (a doorway's
    depth): then it goes to the marked room that it touches most. What touches none, and has one of
    the cells `beyond` closed leaves, is a room, too.
    """
    least = min_area / cell_size**2 - ROUNDING
    has_marks = np.zeros(int(segment.max(initial=0)) + 1, dtype=np.bool_)
    has_marks[segment[owner > 0]] = True
    rest = np.where(owner == 0, segment, 0)
    part, _ = label_components_2d(np.where(has_marks[rest], rest, 0))
    cells, wide = _measure_parts(part, cell_size)
    is_room = (cells >= least) & wide
    if not (is_room | (cells < least)).all():  # the rest of a ledge is as narrow as the ledge was
        of_segment = np.zeros(len(cells), dtype=np.int32)
        of_segment[part] = segment
        is_room |= (cells >= least) & ~_measure_parts(segment, cell_size)[1][of_segment]
    touched = _most_touched(part, owner, len(cells))
    if beyond is not None:
        leads = np.zeros(len(cells), dtype=np.bool_)
        leads[part.ravel()[beyond]] = True
        is_room |= leads & (touched == 0)
    is_room[0] = False
    taken = np.where(is_room[part], 0, touched[part])
    kept = np.where(has_marks[rest], 0, rest + np.int32(len(cells)) * (rest > 0))
    new, _ = renumber(np.where(is_room[part], part, kept).astype(np.int32))
    return np.where(owner > 0, owner, taken).astype(np.int32), new


def share_leaves(owner: Int32, leaf_cells: Bool) -> None:
    """Give the cells of leaves without a room to those on their sides; of two as near, the smaller.

    Which of two rooms is the smaller turns with the map, unlike their numbers.
    """
    waiting = leaf_cells & (owner == 0)
    cells = count_cells_by_label(owner, int(owner.max(initial=0)) + 1)
    by_size = np.append(0, np.argsort(cells[1:], kind="stable") + 1).astype(np.int32)
    rank = np.empty_like(by_size)
    rank[by_size] = np.arange(len(by_size))
    ranks = rank[owner]
    spread(ranks, waiting)
    owner[waiting] = by_size[ranks[waiting]]


def _measure_parts(label: Int32, cell_size: float) -> tuple[Int, Bool]:
    """How many cells each label has, none for 0, and whether it is half a metre wide anywhere."""
    reach = int(SLIVER / cell_size) + 2
    around = wall_nodes(label > 0)
    height, width = label.shape
    for k in range(3):  # the nodes on each edge between two parts
        around[k : k + 2 * height - 1 : 2, 2:-1:2] |= label[:, :-1] != label[:, 1:]
        around[2:-1:2, k : k + 2 * width - 1 : 2] |= label[:-1] != label[1:]
    cells = count_cells_by_label(label, int(label.max(initial=0)) + 1)
    peaks = widest_nodes(label, squared_distances(around, reach), len(cells))
    # twice the distance to what is around, in half cells: the widest disc that fits
    return cells, peaks >= (SLIVER / cell_size) ** 2 - ROUNDING


def _most_touched(part: Int32, owner: Int32, count: int) -> Int32:
    """The owner that each part has most edges in common with, 0 for none; of several the first."""
    node = np.where(owner > 0, owner + np.int32(count), part)  # parts have no owner
    low, high = np.sort(node.ravel()[differing_pairs(node)], axis=0)
    base = int(node.max(initial=0)) + 1
    meet = (low > 0) & (low < count) & (high >= count)
    keys = low[meet].astype(np.int64) * base + high[meet]
    key, edges = np.unique(keys, return_counts=True)
    order = np.lexsort((-key, edges))  # the last one written stays
    touched = np.zeros(count, dtype=np.int32)
    touched[key[order] // base] = key[order] % base - count
    return touched


def renumber(label: Int32) -> tuple[Int32, Int]:
    """Renumber labels from 1 by the first cell of each in reading order; also those so ordered."""
    *_, value = find_row_runs(label)
    used, first = np.unique(value, return_index=True)
    order = used[np.argsort(first)]
    number = np.zeros(int(order.max(initial=0)) + 1, dtype=np.int32)
    number[order] = np.arange(1, len(order) + 1)
    return number[label], order


def find_cavities(
    segment: Int32, owner: Int32, flags: RoomFlags, level: int, beyond: Int | None = None
) -> Bool:
    """Mark the segments of a level that are cavities: hollow walls, shafts, chases.

    A cavity meets no other space or level, nor the edge of the grid; no leaf leads into it, by the
    cells `beyond` leaves; and it is smaller or narrower than `CAVITY`. The largest segment is none.
    """
    cell_size = flags.lattice.cell_size
    count = int(segment.max(initial=0)) + 1
    area = count_cells_by_label(segment, count) * cell_size**2
    space = np.where(owner > 0, owner + count, segment)
    pairs = space.ravel()[differing_pairs(space)]
    is_open = np.zeros(count, dtype=np.bool_)
    is_open[0] = True
    is_open[pairs[(pairs > 0).all(axis=0) & (pairs < count)]] = True
    is_open[segment[flags.levels[level].edge]] = True
    if beyond is not None:
        is_open[segment.ravel()[beyond]] = True
    for side in ((0, 1), (2, 3)):
        on_level = flags.links[flags.links[:, side[0]] == level]
        is_open[segment.ravel()[on_level[:, side[1]]]] = True
    is_open |= area >= area[1:].max(initial=0.0)
    least, wide = CAVITY
    cavities: Bool = ~is_open & (area < least)
    if (is_open | cavities).all():
        return cavities
    distance = squared_distances(wall_nodes(segment > 0), int(wide / cell_size) + 2)
    is_wide = widest_nodes(segment, distance, count) >= (wide / cell_size) ** 2 - ROUNDING
    return cavities | ~is_open & ~is_wide


def find_outdoors(segment: Int32, flags: RoomFlags, level: int) -> tuple[Int32, set[int]]:
    """Find the segments of a level that are outdoors, and unite those that touch.

    They reach the edge of the grid in one piece wider than any door; and at least half of their
    cells have nothing above an agent's head, or lie under eaves. Walls part two pieces of outdoors,
    unless the ground is endless; a ditch does not. Returns the segments and the numbers of those
    outdoors.
    """
    own = flags.levels[level]
    cell_size = flags.lattice.cell_size
    count = int(segment.max(initial=0)) + 1
    candidates = _longest_runs(segment, own.edge & (segment > 0), count) * cell_size > EDGE_LENGTH
    if not candidates.any():
        return segment, set()
    asked = candidates[segment]
    is_open = own.sky[asked]
    if not is_open.all() and flags.ends.any():
        # where the lattice crops the scene, rooms go on beyond it
        end = asked & edge_cells(flags.empty, flags.ends)
        if end.any():
            away = squared_distances(end, int(EAVES / cell_size) + 1)[asked]
            is_open |= np.sqrt(away) * cell_size <= EAVES
    open_cells = np.bincount(segment[asked][is_open], minlength=count)
    all_cells = np.bincount(segment[asked], minlength=count)
    outdoors = candidates & (open_cells >= OPEN_SHARE * all_cells)
    united = _unite_touching(segment, outdoors, own.bank)
    if outdoors.any() and flags.has_ground:
        united[outdoors] = united[outdoors].min()
    return united[segment], set(np.unique(united[outdoors]).tolist())


def _unite_touching(segment: Int32, chosen: Bool, steep: Bool) -> Int32:
    """By segment, the least chosen one that it touches, maybe over steep ground, or itself."""
    part, count = label_components_2d(steep)
    node = np.where(steep, part + len(chosen) - 1, segment)
    joins = np.concatenate([chosen, np.ones(count, dtype=np.bool_)])
    pairs = node.ravel()[differing_pairs(node)]
    # the first node of a part is its least
    number = label_components(pairs[:, joins[pairs].all(axis=0)], len(joins))
    least = np.unique(number, return_index=True)[1].astype(np.int32)
    return least[number][: len(chosen)]


def _longest_runs(segment: Int32, edge: Bool, count: int) -> Float:
    """The extent of each segment's longest connected piece at the edge [cells]."""
    cell = np.flatnonzero(edge)
    rows, cols = np.divmod(cell, segment.shape[1])
    number = segment[rows, cols]
    pairs = adjacent_pairs(cell, segment.shape[1])
    run = label_components(pairs[:, number[pairs[0]] == number[pairs[1]]], len(cell))
    reach = np.zeros(len(cell))
    for place in (rows, cols):
        low = np.full(len(cell), np.inf)
        high = np.full(len(cell), -np.inf)
        np.minimum.at(low, run, place)
        np.maximum.at(high, run, place)
        reach = np.hypot(reach, (high - low)[run])
    longest = np.zeros(count)
    np.maximum.at(longest, number, reach + 1)
    return longest
