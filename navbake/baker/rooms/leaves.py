"""Closed leaves among the cells of a level: which of them part what is round them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navbake.baker.core.components import count_cells_by_label, label_components_2d
from navbake.baker.rooms.flags import LevelFlags
from navbake.types import Bool, Float, Int, Int32

# A space behind a leaf counts from so much of it on that is free of structure: a niche that a
# fridge fills is none; smaller ones between two leaves belong to the leaves [m²]
LEAST_SPACE = 0.1
# A leaf parts nothing where one gets round it over open cells within so much of it [m]
WAY_ROUND = 1.0


class LeafLines(NamedTuple):
    """The cells along lines from a closed leaf, -1 beside the lattice.

    Attributes:
        sight: away from its two sides, shape (2, lines, steps).
        ends: on from its two ends, shape (2, steps).
    """

    sight: Int
    ends: Int


@dataclass(frozen=True, eq=False)
class ClosedLeaf:
    """What a candidate for a door blocks when it is closed, and what lies round it.

    Attributes:
        cells: by level, the ids of the cells that it blocks, ascending.
        lines: from its sides and ends; None where its geometry has none.
    """

    cells: Sequence[Int]
    lines: LeafLines | None


class LeafMarks(NamedTuple):
    """The closed leaves of a level.

    Attributes:
        parting: the open cells of leaves that part two spaces, shape (height, width), with their
            frames and what little lies between two of them.
        others: the open cells of all other leaves.
        beyond: the ids of cells in the spaces that parting leaves lead into.
    """

    parting: Bool
    others: Bool
    beyond: Int


def mark_leaves(
    level: LevelFlags, number: int, closed_leaves: Sequence[ClosedLeaf], cell_size: float
) -> LeafMarks | None:
    """Find which leaves part two spaces of a level, by its number; None without any leaf on it.

    All leaves that part something are taken out together, as the two of a double door part only
    together. A leaf that parts nothing then hinders none of the others.
    """
    on_level = [leaf for leaf in closed_leaves if len(leaf.cells[number])]
    every = _mark_cells(level, number, on_level)
    if not every.any():
        return None
    leaves = [leaf for leaf in on_level if leaf.lines is not None]
    while leaves:
        lines = [leaf.lines for leaf in leaves if leaf.lines is not None]
        barrier = _mark_cells(level, number, leaves)
        barrier |= _mark_frames(level, barrier, np.stack([line.ends for line in lines]))
        spaces = _Spaces(level, barrier, cell_size)
        beyond = spaces.look_beyond(np.stack([line.sight for line in lines]))
        windows = [_window_round(leaf.cells[number], every.shape, cell_size) for leaf in leaves]
        is_parting = spaces.are_parted(beyond, windows)
        if is_parting.all():
            parting = spaces.barrier
            return LeafMarks(parting, every & ~parting, np.unique(beyond[beyond >= 0]))
        leaves = [leaf for leaf, parts in zip(leaves, is_parting, strict=True) if parts]
    return LeafMarks(np.zeros_like(every), every, np.empty(0, dtype=np.int64))


def _mark_cells(level: LevelFlags, number: int, leaves: Sequence[ClosedLeaf]) -> Bool:
    """Mark the open cells of some leaves on a level."""
    mask = np.zeros(level.open.shape, dtype=np.bool_)
    for leaf in leaves:
        mask.ravel()[leaf.cells[number]] = True
    mask &= level.open
    return mask


def _mark_frames(level: LevelFlags, leaf_cells: Bool, ends: Int) -> Bool:
    """Mark what stands in the line of leaves from their ends on: frames, stubs, sidelights.

    What is too short for a wall is an open cell, though a leaf ends at it. `ends`: those of
    `LeafLines`, shape (leaves, 2, steps).
    """
    cell = np.maximum(ends, 0)
    stands = leaf_cells | level.open & level.occupied
    goes_on = np.logical_and.accumulate((ends >= 0) & stands.ravel()[cell], axis=-1)
    mask = np.zeros(level.open.shape, dtype=np.bool_)
    mask.ravel()[cell[goes_on]] = True
    return mask


def _window_round(cells: Int, shape: tuple[int, ...], cell_size: float) -> tuple[slice, slice]:
    """The rows and columns within `WAY_ROUND` of a leaf's cells."""
    margin = math.ceil(WAY_ROUND / cell_size)
    rows, cols = np.divmod(cells, shape[1])
    return (
        slice(max(int(rows.min()) - margin, 0), int(rows.max()) + margin + 1),
        slice(max(int(cols.min()) - margin, 0), int(cols.max()) + margin + 1),
    )


class _Spaces:
    """The spaces of a level that closed leaves, the barrier, leave."""

    def __init__(self, level: LevelFlags, barrier: Bool, cell_size: float) -> None:
        self.barrier = barrier
        self._level = level
        self._label, count = label_components_2d(level.open & ~barrier)
        least = LEAST_SPACE / cell_size**2
        area = count_cells_by_label(self._label, count + 1)
        free_area = np.bincount(self._label[~level.occupied], minlength=count + 1)
        at_edge = np.zeros(count + 1, dtype=np.bool_)
        at_edge[self._label[level.edge]] = True
        self._is_space = free_area >= least
        self._is_space |= at_edge & (free_area > 0)  # a threshold before the outside
        self._is_space[0] = False
        self._is_pocket = (area < least) & ~at_edge
        self._is_pocket[0] = False

    def look_beyond(self, sight: Int) -> Int:
        """The first cells beyond leaves along their lines of sight, -1 for none.

        `sight`: those of `LeafLines`, shape (leaves, 2, lines, steps); returns (leaves, 2, lines).
        What is too small for a space becomes a part of the barrier, and lines go on behind it.
        """
        cell = np.maximum(sight, 0)
        is_seen = mark_visible(sight, self._level.open, self._level.floor)
        is_seen &= (sight >= 0) & self._level.open.ravel()[cell]
        while True:
            is_beyond = is_seen & ~self.barrier.ravel()[cell]
            first = is_beyond.argmax(axis=-1)
            cells = np.take_along_axis(cell, first[..., None], axis=-1)[..., 0]
            cells = np.where(is_beyond.any(axis=-1), cells, -1)
            seen = np.unique(self._label.ravel()[cells[cells >= 0]])
            pockets = seen[self._is_pocket[seen]]
            if not len(pockets):
                return np.asarray(cells)
            is_pocket = np.isin(self._label, pockets)
            self.barrier |= is_pocket
            self._label[is_pocket] = 0

    def are_parted(self, beyond: Int, windows: Sequence[tuple[slice, slice]]) -> Bool:
        """Which leaves part the spaces on their sides, each at least within its window.

        `beyond`: see `look_beyond`; shape (leaves,).
        """
        label = self._label.ravel()[np.maximum(beyond, 0)]
        sides = _commonest(np.where((beyond >= 0) & self._is_space[label], label, 0))
        has_both = (sides > 0).all(axis=-1)
        is_parting = has_both & (sides[:, 0] != sides[:, 1])
        width = self._label.shape[1]
        for leaf in np.flatnonzero(has_both & ~is_parting).tolist():
            rows, cols = windows[leaf]
            row, col = np.divmod(beyond[leaf], width)
            is_near = (row >= rows.start) & (row < rows.stop)
            is_near &= (col >= cols.start) & (col < cols.stop) & (beyond[leaf] >= 0)
            part, _ = label_components_2d(self._label[rows, cols] > 0)
            row = np.where(is_near, row - rows.start, 0)
            col = np.where(is_near, col - cols.start, 0)
            near_sides = _commonest(np.where(is_near, part[row, col], 0)[None])[0]
            is_parting[leaf] = (near_sides > 0).all() and near_sides[0] != near_sides[1]
        return np.asarray(is_parting)


def mark_visible(sight: Int, is_open: Bool, floor: Float) -> Bool:
    """Which steps of lines of sight, see `LeafLines`, lie before the first wall on their line.

    A wall is a cell of a level that has a floor, and is not open.
    """
    cell = np.maximum(sight, 0)
    is_wall = (sight >= 0) & ~is_open.ravel()[cell] & ~np.isnan(floor.ravel()[cell])
    return ~np.logical_or.accumulate(is_wall, axis=-1)


def _commonest(label: Int32) -> Int32:
    """The label that most lines of each side have, of several the first's; 0 without any.

    `label`: (leaves, 2, lines), 0 for none; returns (leaves, 2).
    """
    votes = (label[..., :, None] == label[..., None, :]).sum(axis=-1) * (label > 0)
    best = votes.argmax(axis=-1)
    commonest: Int32 = np.take_along_axis(label, best[..., None], axis=-1)[..., 0]
    return commonest
