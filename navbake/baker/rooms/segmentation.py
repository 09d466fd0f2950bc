"""Rooms from the walls alone: a watershed on the distance to them, cut at door-wide gaps.

`segment_rooms` seeds the watershed, floods it and merges its regions; `share_rest` fits its
segments to rooms that are marked.
"""

from typing import NamedTuple

import numpy as np

from navbake.baker.connect import connect
from navbake.baker.lattice import EDGES, Window, bounding_window
from navbake.baker.rooms.distances import squared_distances
from navbake.baker.rooms.gaps import part_at_gaps
from navbake.baker.rooms.kernels import labels
from navbake.baker.rooms.kernels.labels import label_parts, measure_regions
from navbake.baker.rooms.kernels.watershed import flood
from navbake.baker.rooms.regions import ROUGHNESS, ROUNDING, STAIR_SHARE, Regions
from navbake.baker.rooms.spaces import WIDEST, CloseCall
from navbake.types import Bool, Float, Int, Int32

# A narrow region begins at this distance from where a disc wider than the door fits [door widths]
NARROW_GAP = 0.1
# A narrow region of less width is a crack, and no room [door widths]
CRACK_WIDTH = 0.5
# What marked rooms leave is no room of its own if it is nowhere as wide as this [m]
SLIVER = 0.5
# A cell is steep, like a stair, where the floor rises by this share of the distance
STEEPNESS = 0.3
# That is measured over this distance on both sides of the cell [m]
SLOPE_REACH = 0.3


def segment_rooms(
    open_cells: Bool,
    cell_size: float,
    door_width: float,
    min_area: float,
    floor: Float | None = None,
    edge: Bool | None = None,
) -> Int32:
    """Divide the open cells of a level into rooms, at gaps no wider than a door.

    A gap is as wide as the largest disc that passes it. Rooms grow from where a disc wider than
    `door_width` fits (the level, opened morphologically by that disc). What is narrower all along,
    such as a corridor, is a room of its own where it continues behind the discs. From these seeds
    a watershed fills everything in the order of the distance to the walls, so that two rooms meet
    where their doorway is narrowest, or in the middle of that part. A cell as near to two rooms
    goes to the one with more space for discs. A region smaller than `min_area` joins the room
    that it opens to the widest; if it opens to none, it is no room.

    Widths are exact for walls along the lattice. Other walls make them vary by a cell. So a gap
    does not separate rooms where its sides come only half a cell nearer to its middle than the
    walls of a room that it leads to: a corridor at an angle is not cut where the lattice makes it
    look narrow. Stairs that open to a room over their full width belong to it, at their foot
    rather than their head. What is too small for a room and lies along the edge of the grid over
    more than a doorway's width is outside of the walls, and joins none through a door.

    Args:
        open_cells: shape (height, width): cells with a floor that no wall stands in.
        cell_size: edge of a cell [m].
        door_width: the widest gap that separates rooms [m], > 0.
        min_area: what a room has at least [m²], >= 0.
        floor: heights of the floor, shape (height, width) [m]; None for one without stairs.
        edge: cells at the edge of the grid, see `find_edge`; None for none.

    Returns:
        The room of each cell from 1, by the first cell of each in reading order; 0 for none.

    Source:
        Morphological and distance-transform segmentation as in Bormann et al., "Room
        segmentation: survey, implementation, and analysis" (ICRA 2016); with one threshold, the
        door's width, for all rooms, and the watershed for what it leaves.
    """
    rooms = np.zeros(open_cells.shape, dtype=np.int32)
    if not open_cells.any():
        return rooms
    window = bounding_window(open_cells)
    open_cells = np.ascontiguousarray(open_cells[window])
    # the door's half width, in half cells; nothing fits beside one that is as wide as the map
    width = min(door_width / cell_size, float(min(open_cells.shape) + 2))
    least = min_area / cell_size**2 - ROUNDING
    reach = int(width + ROUGHNESS) + 2
    distance = squared_distances(wall_nodes(open_cells), reach, 0, 1)
    label, num_wide = _find_seeds(open_cells, distance, width, least)
    flood(label, open_cells, np.ascontiguousarray(distance[1::2, 1::2]), (reach + 1) ** 2)
    regions = Regions(label, distance, num_wide)
    regions.join_rough_passes()
    regions.join_junctions()
    if floor is not None:
        regions.join_stairs(*_measure_slopes(label, floor[window], cell_size))
    _join_small(regions, label, least, cell_size, None if edge is None else edge[window])
    rooms[window] = renumber(regions.wholes(least)[label])
    return rooms


class SpaceFinder:
    """Finds spaces between gaps, and knows the last ones: most changes of a scene leave them.

    Attributes:
        window: the part of the level in which they were found last; None before that.
    """

    def __init__(self) -> None:
        self.window: Window | None = None
        self._asked: tuple[Bool, Bool, float] | None = None
        self._found: tuple[Int32, list[CloseCall]] = np.zeros((0, 0), dtype=np.int32), []

    def find(
        self, open_cells: Bool, holes: Bool, cell_size: float
    ) -> tuple[Int32, list[CloseCall]]:
        """See `part_at_gaps`; cells of gaps get the label of the space that is nearest."""
        if not self._knows(open_cells, holes, cell_size):
            label, close = part_at_gaps(open_cells, holes, cell_size)
            flood(label, open_cells, np.zeros(label.shape, dtype=np.int32), 0)
            self._asked, self._found = (open_cells.copy(), holes.copy(), cell_size), (label, close)
        return self._found

    def have_stairs(self, floor: Float, cell_size: float) -> bool:
        """Whether a space that was found last is a stair on a floor, of the whole level [m]."""
        assert self.window is not None
        label = self._found[0]
        return _have_stairs(_measure_slopes(label, floor[self.window], cell_size), label)

    def _knows(self, open_cells: Bool, holes: Bool, cell_size: float) -> bool:
        if self._asked is None or self._asked[2] != cell_size:
            return False
        asked = zip(self._asked[:2], (open_cells, holes), strict=True)
        return all(np.array_equal(known, new) for known, new in asked)


class Segments(NamedTuple):
    """The rooms of a level, and the gaps between them that were close calls.

    Attributes:
        rooms: the room of each cell from 1, by the first cell of each in reading order; 0 for none.
        close: the gaps.
    """

    rooms: Int32
    close: list[CloseCall]


def segment_by_gaps(
    open_cells: Bool,
    cell_size: float,
    min_area: float,
    floor: Float | None = None,
    holes: Bool | None = None,
    spaces: SpaceFinder | None = None,
    edge: Bool | None = None,
) -> Segments:
    """Divide the open cells of a level into rooms, at gaps much narrower than the rooms are.

    A gap is where walls come near to each other at once: a line in the direction of a wall that is
    closed at both ends after at most 2.5 m, and beside which the space is wider at once. All gaps
    part spaces at first. Then spaces are joined, the widest gaps first, as in region merging:

    - where a gap is as wide as both spaces are along its line: parts of one corridor, of an
      L-shaped room;
    - then where it is as wide as the narrower one: niches, bays, the depth of a doorway. A long
      passage that opens into a wider space stays a room of its own.

    How wide a space is along a gap is measured close behind it. Other gaps in the same line
    between the same spaces count as one with it, so that a row of pillars parts nothing. Stairs
    and small regions join others as in `segment_rooms`, whose arguments these are; `holes` are
    cells without a floor that one sees through, as in a stairwell, which narrow no space. `spaces`
    may know what is parted already.

    Source:
        Region merging as in Bormann et al. (ICRA 2016), on regions between the "virtual walls"
        that continue walls, in place of those of a Voronoi graph.
    """
    rooms = np.zeros(open_cells.shape, dtype=np.int32)
    if not open_cells.any():
        return Segments(rooms, [])
    # with the walls round it: their directions count, the edge of the grid is none
    window = _grow_window(bounding_window(open_cells), open_cells.shape)
    open_cells = np.ascontiguousarray(open_cells[window])
    seen = np.zeros_like(open_cells) if holes is None else holes[window]
    spaces = spaces or SpaceFinder()
    label, close = spaces.find(open_cells, seen, cell_size)
    spaces.window = window
    given = cell_size, min_area, floor, edge
    rooms[window] = renumber(_join_stairs_and_small(label, open_cells, window, *given))
    first_row, first_col = window[0].start, window[1].start
    return Segments(
        rooms,
        [c._replace(cell=(c.cell[0] + first_row, c.cell[1] + first_col)) for c in close],
    )


def _grow_window(window: Window, shape: tuple[int, ...]) -> Window:
    """A window with the cells of an array that are next to it."""
    rows, cols = (
        slice(max(part.start - 1, 0), min(part.stop + 1, length))
        for part, length in zip(window, shape, strict=True)
    )
    return rows, cols


def _join_stairs_and_small(
    label: Int32,
    open_cells: Bool,
    window: Window,
    cell_size: float,
    min_area: float,
    floor: Float | None,
    edge: Bool | None,
) -> Int32:
    least = min_area / cell_size**2 - ROUNDING
    num = int(label.max(initial=0))
    cells = labels.count_cells(label, num + 1)
    is_stair = False
    if floor is not None:
        slopes = _measure_slopes(label, floor[window], cell_size)
        is_stair = _have_stairs(slopes, label)
    if not is_stair and not ((cells[1:] > 0) & (cells[1:] < least)).any():
        return label
    # distances matter up to half the widest gap [half cells]
    reach = int(WIDEST / cell_size) + 2
    regions = Regions(label, squared_distances(wall_nodes(open_cells), reach, 0, 1), num)
    if is_stair:
        regions.join_stairs(*slopes)
    _join_small(regions, label, least, cell_size, None if edge is None else edge[window])
    return regions.wholes(least)[label]


def _join_small(
    regions: Regions, label: Int32, least: float, cell_size: float, edge: Bool | None
) -> None:
    """See `Regions.join_small`."""
    at_edge = None
    if edge is not None:
        at_edge = np.bincount(label[edge], minlength=int(label.max(initial=0)) + 1)
    regions.join_small(least, at_edge, WIDEST / cell_size)


def _measure_slopes(label: Int32, floor: Float, cell_size: float) -> tuple[Int, Float]:
    """See `measure_slopes`."""
    steps = max(1, round(SLOPE_REACH / cell_size))
    rise = STEEPNESS * 2 * steps * cell_size
    num_steep, heights = labels.measure_slopes(label, floor, steps, rise, int(label.max(initial=0)))
    return num_steep, heights


def _have_stairs(slopes: tuple[Int, Float], label: Int32) -> bool:
    """Whether a label is a stair by its slopes, see `join_stairs`."""
    cells = np.bincount(label.ravel(), minlength=len(slopes[0]))
    return bool((slopes[0] >= STAIR_SHARE * np.maximum(cells, 1)).any())


def wall_nodes(open_cells: Bool) -> Bool:
    """Mark the nodes of a lattice half as wide that lie on a cell that isn't open.

    Node (2 r + 1, 2 c + 1) is the centre of cell (r, c); the others are edges' middles and
    corners. The nearest point of a closed cell is as far from a node as the nearest marked node.
    So gaps can be measured to half a cell. Beyond the lattice nothing is open. The result has
    the shape (2 height + 1, 2 width + 1).
    """
    closed = np.pad(~open_cells, 1, constant_values=True)
    rows = closed.repeat(2, axis=0)[1:-1]
    rows = rows[:-1] | rows[1:]  # each row's upper edge, its centre, …, the last one's lower edge
    cols = rows.repeat(2, axis=1)[:, 1:-1]
    return cols[:, :-1] | cols[:, 1:]


def give_covered(owner: Int32, under: Int32, segment: Int32) -> Int32:
    """Give cells to the room whose floor lies under theirs, if that room reaches their segment.

    So a podium is part of its room, and a house is none of the ground that it stands on. All are
    of the same shape, 0 for none; returns the owners.
    """
    base = int(max(owner.max(initial=0), under.max(initial=0))) + 1
    held = np.unique(segment[owner > 0].astype(np.int64) * base + owner[owner > 0])
    takes = (owner == 0) & (under > 0) & (segment > 0)
    takes[takes] = np.isin(segment[takes].astype(np.int64) * base + under[takes], held)
    return np.where(takes, under, owner)


def share_rest(
    owner: Int32, segment: Int32, cell_size: float, min_area: float
) -> tuple[Int32, Int32]:
    """Make rooms of what marked rooms leave of segments.

    A segment without a mark is a room as it is. The rest of one with marks is made of connected
    parts. Each is a room by itself, whatever share of the segment is marked: a mark says where its
    room ends. Only a part that is too small for a room goes to the marked room that it touches
    most: one smaller than `min_area`, or nowhere half a metre wide though its segment is (the gap
    between a drawn floor and its wall, the depth of a doorway).

    Args:
        owner, segment: the marked room and the segment of each cell, 0 for none.
        cell_size: edge of a cell [m].
        min_area: what a room has at least [m²].

    Returns:
        Owners with what they take over, and new rooms in what is left, each of the same shape.
    """
    least = min_area / cell_size**2 - ROUNDING
    has_marks = np.zeros(int(segment.max(initial=0)) + 1, dtype=np.bool_)
    has_marks[segment[owner > 0]] = True
    rest = np.where(owner == 0, segment, 0)
    part = _label_equal(np.where(has_marks[rest], rest, 0))
    cells, wide = _measure_parts(part, cell_size)
    is_room = (cells >= least) & wide
    if not (is_room | (cells < least)).all():  # the rest of a ledge is as narrow as the ledge was
        of_segment = np.zeros(len(cells), dtype=np.int32)
        of_segment[part] = segment
        is_room |= (cells >= least) & ~_measure_parts(segment, cell_size)[1][of_segment]
    is_room[0] = False
    touched = _most_touched(part, owner, len(cells))
    taken = np.where(is_room[part], 0, touched[part])
    kept = np.where(has_marks[rest], 0, rest + np.int32(len(cells)) * (rest > 0))
    new = renumber(np.where(is_room[part], part, kept).astype(np.int32))
    return np.where(owner > 0, owner, taken).astype(np.int32), new


def _measure_parts(label: Int32, cell_size: float) -> tuple[Int, Bool]:
    """How many cells each label has, and whether its part is somewhere half a metre wide.

    Other labels are as good as walls.
    """
    reach = int(SLIVER / cell_size) + 2
    around = wall_nodes(label > 0)
    height, width = label.shape
    for k in range(3):  # the nodes on each edge between two parts
        around[k : k + 2 * height - 1 : 2, 2:-1:2] |= label[:, :-1] != label[:, 1:]
        around[2:-1:2, k : k + 2 * width - 1 : 2] |= label[:-1] != label[1:]
    distance = squared_distances(around, reach, 0, 1)
    cells, peaks, _ = measure_regions(label, distance, int(label.max(initial=0)))
    # twice the distance to what is around, in half cells: the widest disc that fits
    return cells, peaks >= (SLIVER / cell_size) ** 2 - ROUNDING


def renumber(label: Int32) -> Int32:
    """Renumber labels from 1 by the first cell of each in reading order; 0 stays."""
    order = labels_in_order(label)
    number = np.zeros(int(order.max(initial=0)) + 1, dtype=np.int32)
    number[order] = np.arange(1, len(order) + 1)
    return number[label]


def labels_in_order(label: Int32) -> Int:
    """The labels that are used, but 0, by their first cells in reading order."""
    first = labels.first_cells(label, int(label.max(initial=0)) + 1)[1:]
    return 1 + np.argsort(first, kind="stable")[: np.count_nonzero(first < label.size)]


def _find_seeds(open_cells: Bool, distance: Int32, width: float, least: float) -> tuple[Int32, int]:
    """Label where discs wider than the door fit, and the narrow regions that they leave.

    Wide regions come before narrow ones, then the larger, then those with more space for discs.
    Also tells the number of wide regions.
    """
    wide, num_wide = label_parts(distance > int((width + ROUNDING) ** 2))
    label = labels.cells_of_nodes(wide)
    narrow, num_narrow = _find_narrow(open_cells, distance, wide > 0, width, least)
    if num_narrow:
        label = np.where(narrow > 0, narrow + np.int32(num_wide), label)
    cells, _, space = measure_regions(label, distance, num_wide + num_narrow)
    is_narrow = np.arange(1, len(cells)) > num_wide
    rank = np.zeros(len(cells), dtype=np.int32)
    rank[1 + np.lexsort((-space[1:], -cells[1:], is_narrow))] = np.arange(1, len(cells))
    return rank[label], num_wide


def _find_narrow(
    open_cells: Bool, distance: Int32, is_wide: Bool, width: float, least: float
) -> tuple[Int32, int]:
    """Label and count the narrow regions that continue behind the discs, except cracks.

    Nodes have a `distance` to the walls, and are wide where a disc fits that is wider than a door
    [half cells, on both sides of its middle]. A room has at least so many cells.
    """
    behind = (width * (1 + 2 * NARROW_GAP)) ** 2
    to_wide = squared_distances(is_wide, int(behind**0.5) + 1, 1, 2)[:, 1::2]
    left, num_left = label_parts(open_cells & (to_wide > width**2 + ROUNDING))
    is_large = np.bincount(left.ravel(), minlength=num_left + 1) >= max(least / 2, 1)
    is_large[0] = False
    if not is_large.any():
        return left, 0
    narrow, num_narrow = label_parts(is_large[left] & (to_wide > behind))
    _, peaks, _ = measure_regions(narrow, distance, num_narrow)
    is_crack = peaks < (width * CRACK_WIDTH) ** 2 - ROUNDING
    return np.where(is_crack[narrow], np.int32(0), narrow), num_narrow


def _label_equal(label: Int32) -> Int32:
    """Number the parts of equal labels that are connected over edges; 0 stays."""
    cell = np.arange(label.size).reshape(label.shape)
    pairs = []
    for one, other in EDGES:
        same = (label[one] == label[other]) & (label[one] > 0)
        pairs.append(np.stack([cell[one][same], cell[other][same]]))
    number = connect(np.concatenate(pairs, axis=1), label.size)
    return np.where(label > 0, number.reshape(label.shape) + 1, 0).astype(np.int32)


def _most_touched(part: Int32, owner: Int32, count: int) -> Int32:
    """The owner that each part has most edges in common with, 0 for none; of several the first."""
    keys = []
    base = int(owner.max(initial=0)) + 1
    for one, other in EDGES:
        for a, b in ((one, other), (other, one)):
            meet = (part[a] > 0) & (owner[b] > 0)
            keys.append(part[a][meet].astype(np.int64) * base + owner[b][meet])
    key, edges = np.unique(np.concatenate(keys), return_counts=True)
    order = np.lexsort((-key, edges))  # the last one written stays
    touched = np.zeros(count, dtype=np.int32)
    touched[key[order] // base] = key[order] % base
    return touched
