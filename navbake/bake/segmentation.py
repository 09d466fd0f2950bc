"""Rooms from the walls alone: a watershed on the distance to them, cut at door-wide gaps."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from navbake.kernels.watershed import (
    find_passes,
    flood,
    measure_basins,
    squared_distances,
)

Bool = NDArray[np.bool_]
Labels = NDArray[np.int32]

# How far a narrow place begins behind the discs that fit beside it, in door widths
NARROW = 0.1
# What walls that don't follow the lattice make the width of one and the same corridor vary by,
# to each side of its middle, in half cells: measured over all angles and offsets, at most this
ROUGHNESS = 1.0
SLACK = 1e-6  # of half a cell: a gap this little over the door's width still has it


def segment_rooms(
    open_cells: Bool, cell_size: float, door_width: float, min_area: float
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
    nothing: a corridor at an angle is not cut where the lattice makes it look narrow.

    Args:
        open_cells: shape (height, width): cells with a floor that no wall stands in.
        cell_size: edge of a cell [m].
        door_width: the widest gap that parts rooms [m], > 0.
        min_area: what a room has at least [m²], >= 0.

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
    width = door_width / cell_size  # the door's half width, in half cells
    least = min_area / cell_size**2 - SLACK
    reach = int(width + ROUGHNESS) + 2
    distance = squared_distances(wall_nodes(open_cells), reach)
    label, num_wide = _find_seeds(open_cells, distance, width, least)
    flood(label, open_cells, np.ascontiguousarray(distance[1::2, 1::2]), (reach + 1) ** 2)
    basins = _Basins(label, distance, num_wide)
    basins.join_rough_passes()
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
    flat = label.ravel()
    used, first = np.unique(flat, return_index=True)
    first = first[used > 0]
    number = np.zeros(int(used[-1]) + 1, dtype=np.int32)
    number[flat[np.sort(first)]] = np.arange(1, len(first) + 1)
    return number[label]


def _find_seeds(
    open_cells: Bool, distance: Labels, width: float, least: float
) -> tuple[Labels, int]:
    """Label where discs wider than the door fit, and the narrow places that they leave.

    Returns:
        Labels of cells, those of the wide places first, the largest of each kind first; and how
        many places are wide.
    """
    limit = int((width + SLACK) ** 2)
    wide, num_wide = ndimage.label(distance > limit, output=np.int32)
    behind = (width * (1 + 2 * NARROW)) ** 2
    to_wide = squared_distances(wide > 0, int(behind**0.5) + 1)[1::2, 1::2]
    left, num_left = ndimage.label(open_cells & (to_wide > limit), output=np.int32)
    is_large = np.bincount(left.ravel(), minlength=num_left + 1) >= max(least / 2, 1)
    is_large[0] = False
    deep = is_large[left] & (to_wide > behind)
    narrow, num_narrow = ndimage.label(deep, output=np.int32)
    label = _cells_of_nodes(wide)
    sizes = np.bincount(label.ravel(), minlength=num_wide + 1)
    narrow_sizes = np.bincount(narrow.ravel(), minlength=num_narrow + 1)
    label[deep] = narrow[deep] + num_wide
    rank = np.zeros(num_wide + num_narrow + 1, dtype=np.int32)
    rank[1 + np.argsort(-sizes[1:], kind="stable")] = np.arange(1, num_wide + 1)
    rank[1 + num_wide + np.argsort(-narrow_sizes[1:], kind="stable")] = (
        np.arange(1, num_narrow + 1) + num_wide
    )
    return rank[label], num_wide


def _cells_of_nodes(label: Labels) -> Labels:
    """The label of each cell's centre, or one that touches the cell, from labels of nodes."""
    height, width = label.shape[0] // 2, label.shape[1] // 2
    touching = np.zeros((height, width), dtype=np.int32)
    for row in range(3):
        for col in range(3):
            np.maximum(
                touching, label[row:, col:][: 2 * height : 2, : 2 * width : 2], out=touching
            )
    center = label[1::2, 1::2]
    return np.where(center > 0, center, touching)


class _Basins:
    """What the flood filled from each seed, and what of it is joined to one room."""

    def __init__(self, label: Labels, distance: Labels, num_wide: int) -> None:
        num_basins = int(label.max(initial=0))
        cells, peaks = measure_basins(label, distance, num_basins)
        self._cells = cells.tolist()
        self._peak = np.sqrt(peaks).tolist()  # half cells from the walls, at the widest place
        self._narrow = [basin > num_wide for basin in range(num_basins + 1)]
        self._parent = list(range(num_basins + 1))
        # what each basin meets: how far from the walls at the widest place, along how many cells
        self._passes: list[dict[int, tuple[float, int]]] = [{} for _ in range(num_basins + 1)]
        pairs, saddles = find_passes(label, distance)
        key, place = np.unique(pairs[:, 0] * (num_basins + 1) + pairs[:, 1], return_inverse=True)
        saddle = np.zeros(len(key), dtype=np.int32)
        np.maximum.at(saddle, place, saddles)
        length = np.bincount(place, minlength=len(key)).tolist()
        for k, (a, b) in enumerate(zip(*np.divmod(key, num_basins + 1), strict=True)):
            met = (float(np.sqrt(saddle[k])), length[k])
            self._passes[a][int(b)] = self._passes[b][int(a)] = met

    def join_rough_passes(self) -> None:
        """Join what is parted by no more than the roughness of walls off the lattice.

        The pass is as wide as the smaller one of two wide basins; or as wide as both, where one
        is narrow, because a corridor that opens into a hall is as wide as its mouth.
        """
        passes = [
            (-saddle, a, b)
            for a, met in enumerate(self._passes)
            for b, (saddle, _) in met.items()
            if a < b
        ]
        for negative, first, second in sorted(passes):
            a, b = self._root(first), self._root(second)
            if a == b:
                continue
            choose = max if self._narrow[a] or self._narrow[b] else min
            if choose(self._peak[a], self._peak[b]) + negative <= ROUGHNESS + SLACK:
                self._join(min(a, b), max(a, b))

    def join_small(self, least: float) -> None:
        """Join basins of fewer cells, the smallest first, to the one they open to the widest."""
        queue = [
            (cells, basin)
            for basin, cells in enumerate(self._cells)
            if basin and self._parent[basin] == basin and cells < least
        ]
        heapq.heapify(queue)
        while queue:
            cells, small = heapq.heappop(queue)
            met = self._passes[small]
            if self._parent[small] != small or self._cells[small] != cells or not met:
                continue
            to = max(met, key=lambda other: (*met[other], self._cells[other], -other))
            self._join(to, small)
            if self._cells[to] < least:
                heapq.heappush(queue, (self._cells[to], to))

    def joined(self, least: float) -> Labels:
        """The basin that each one is part of now, 0 for those of fewer cells."""
        roots = [self._root(basin) for basin in range(len(self._parent))]
        kept = [root if self._cells[root] >= least else 0 for root in roots]
        return np.array(kept, dtype=np.int32)

    def _root(self, basin: int) -> int:
        while self._parent[basin] != basin:
            basin = self._parent[basin]
        return basin

    def _join(self, to: int, gone: int) -> None:
        self._parent[gone] = to
        self._cells[to] += self._cells[gone]
        self._peak[to] = max(self._peak[to], self._peak[gone])
        self._narrow[to] = self._narrow[to] or self._narrow[gone]
        for other, (saddle, length) in self._passes[gone].items():
            del self._passes[other][gone]
            if other != to:
                known, known_length = self._passes[to].get(other, (0.0, 0))
                met = (max(saddle, known), length + known_length)
                self._passes[to][other] = self._passes[other][to] = met
        self._passes[gone] = {}
