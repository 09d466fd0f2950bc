"""Rooms from the walls alone: a watershed on the distance to them, cut at door-wide gaps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.labels import (
    cells_of_nodes,
    first_cells,
    label_parts,
    measure_basins,
    measure_slopes,
)
from navbake.baker.kernels.watershed import flood, squared_distances
from navbake.baker.rooms.basins import ROUGHNESS, SLACK, Basins

Bool = NDArray[np.bool_]
Float = NDArray[np.float64]
Int = NDArray[np.int64]
Labels = NDArray[np.int32]

# How far a narrow place begins behind the discs that fit beside it, in door widths
NARROW = 0.1
# How wide a narrow place is at least, in door widths, to be a room and not a crack
NARROWEST = 0.5
# Rise by length from which on a floor is a stair, and how far around a cell that is looked at [m]
STEEP, REACH = 0.3, 0.3


def segment_rooms(
    open_cells: Bool,
    cell_size: float,
    door_width: float,
    min_area: float,
    floor: Float | None = None,
) -> Labels:
    """Part the open cells of a level into rooms, at gaps no wider than a door.

    A gap is as wide as the largest disc that passes it. Rooms grow from where a disc wider than
    `door_width` fits (the level, opened morphologically by that disc); places that are narrower
    all along, such as corridors, are rooms of their own where they go on behind the discs. From
    there everything is filled in the order of the distance to the walls (a watershed), so that
    two rooms meet where their doorway is narrowest, in the middle of it if it is as narrow all
    the way through. A cell that is as near to two rooms goes to the one with more space for
    discs. What is smaller than `min_area` joins the room that it opens to the widest; if it opens
    to none, it is no room.

    Widths are exact for walls along the lattice. Others vary by a cell, so a gap whose sides
    come only half a cell nearer to its middle than the walls of a room that it leads to parts
    nothing: a corridor at an angle is not cut where the lattice makes it look narrow. Stairs
    that open to a room as wide as they are belong to it, at their foot rather than their head.

    Args:
        open_cells: shape (height, width): cells with a floor that no wall stands in.
        cell_size: edge of a cell [m].
        door_width: the widest gap that parts rooms [m], > 0.
        min_area: what a room has at least [m²], >= 0.
        floor: heights of the floor, shape (height, width) [m]. With it, stairs are part of the
            room that they open to.

    Returns:
        Shape (height, width), int32: the room of each cell from 1, 0 for none; numbered by the
        first cell of each in reading order.

    Source:
        Morphological and distance-transform segmentation as in Bormann et al., "Room
        segmentation: survey, implementation, and analysis" (ICRA 2016); with one threshold, the
        door's width, for all rooms, and the watershed for what it leaves.
    """
    rows, cols = (np.flatnonzero(open_cells.any(axis=axis)) for axis in (1, 0))
    rooms = np.zeros(open_cells.shape, dtype=np.int32)
    if not len(rows):
        return rooms
    window = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
    open_cells = np.ascontiguousarray(open_cells[window])
    # the door's half width, in half cells; nothing fits beside one that is as wide as the map
    width = min(door_width / cell_size, float(min(open_cells.shape) + 2))
    least = min_area / cell_size**2 - SLACK
    reach = int(width + ROUGHNESS) + 2
    distance = squared_distances(wall_nodes(open_cells), reach, 0, 1)
    label, num_wide = _find_seeds(open_cells, distance, width, least)
    flood(label, open_cells, np.ascontiguousarray(distance[1::2, 1::2]), (reach + 1) ** 2)
    basins = Basins(label, distance, num_wide)
    basins.join_rough_passes()
    basins.join_junctions()
    if floor is not None:
        steps = max(1, round(REACH / cell_size))
        rise = STEEP * 2 * steps * cell_size
        basins.join_stairs(*measure_slopes(label, floor[window], steps, rise, int(label.max())))
    basins.join_small(least)
    rooms[window] = number_by_place(basins.joined(least)[label])
    return rooms


def wall_nodes(open_cells: Bool) -> Bool:
    """Mark the nodes of a lattice half as wide that lie on a cell that isn't open.

    Node (2 r + 1, 2 c + 1) is the centre of cell (r, c); the others are edges' middles and
    corners. From a node to the nearest square of a closed cell is as far as to the nearest
    marked node, so gaps can be measured to half a cell. Beyond the lattice nothing is open.

    Returns:
        Shape (2 height + 1, 2 width + 1), bool.
    """
    height, width = open_cells.shape
    closed = np.pad(~open_cells, 1, constant_values=True)
    nodes = np.empty((2 * height + 1, 2 * width + 1), dtype=np.bool_)
    above = closed[:-1] | closed[1:]
    nodes[::2, ::2] = above[:, :-1] | above[:, 1:]
    nodes[::2, 1::2] = above[:, 1:-1]
    nodes[1::2, ::2] = closed[1:-1, :-1] | closed[1:-1, 1:]
    nodes[1::2, 1::2] = closed[1:-1, 1:-1]
    return nodes


def number_by_place(label: Labels) -> Labels:
    """Renumber labels from 1 by the first cell of each in reading order; 0 stays."""
    order = order_by_place(label)
    number = np.zeros(int(order.max(initial=0)) + 1, dtype=np.int32)
    number[order] = np.arange(1, len(order) + 1)
    return number[label]


def order_by_place(label: Labels) -> Int:
    """The labels that are used, but 0, by their first cells in reading order."""
    first = first_cells(label, int(label.max(initial=0)) + 1)[1:]
    return 1 + np.argsort(first, kind="stable")[: np.count_nonzero(first < label.size)]


def _find_seeds(
    open_cells: Bool, distance: Labels, width: float, least: float
) -> tuple[Labels, int]:
    """Label where discs wider than the door fit, and the narrow places that they leave.

    Returns:
        Labels of cells, those of the wide places first; the largest of each kind first, then
        those farther from walls; and how many places are wide.
    """
    wide, num_wide = label_parts(distance > int((width + SLACK) ** 2))
    label = cells_of_nodes(wide)
    narrow, num_narrow = _find_narrow(open_cells, distance, wide > 0, width, least)
    if num_narrow:
        label = np.where(narrow > 0, narrow + np.int32(num_wide), label)
    cells, _, space = measure_basins(label, distance, num_wide + num_narrow)
    is_narrow = np.arange(1, len(cells)) > num_wide
    rank = np.zeros(len(cells), dtype=np.int32)
    rank[1 + np.lexsort((-space[1:], -cells[1:], is_narrow))] = np.arange(1, len(cells))
    return rank[label], num_wide


def _find_narrow(
    open_cells: Bool, distance: Labels, is_wide: Bool, width: float, least: float
) -> tuple[Labels, int]:
    """Label narrow places that go on behind the discs, and are no cracks; also tell how many.

    Args:
        open_cells: shape (height, width).
        distance: of nodes to the walls, shape (2 height + 1, 2 width + 1).
        is_wide: where discs fit, nodes likewise.
        width: of a door [half cells, on both sides of its middle].
        least: cells that a room has at least.
    """
    behind = (width * (1 + 2 * NARROW)) ** 2
    to_wide = squared_distances(is_wide, int(behind**0.5) + 1, 1, 2)[:, 1::2]
    left, num_left = label_parts(open_cells & (to_wide > width**2 + SLACK))
    is_large = np.bincount(left.ravel(), minlength=num_left + 1) >= max(least / 2, 1)
    is_large[0] = False
    if not is_large.any():
        return left, 0
    narrow, num_narrow = label_parts(is_large[left] & (to_wide > behind))
    _, peaks, _ = measure_basins(narrow, distance, num_narrow)
    is_crack = peaks < (width * NARROWEST) ** 2 - SLACK
    return np.where(is_crack[narrow], np.int32(0), narrow), num_narrow
