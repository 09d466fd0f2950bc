"""Finds the closed door leaves that separate the spaces on their two sides.

A space is a connected part of a level's open floor without the cells of closed leaves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navbake.baker.core.components import label_components_2d
from navbake.baker.core.windows import Window, grow_window, window_of_cells
from navbake.baker.rooms.flags import LevelFlags
from navbake.types import Bool, Float, Int, Int32

# A space beside a leaf counts if at least this area of it is free of structure; so a niche that a
# fridge fills does not. Smaller spaces between two leaves become part of the leaves [m²]
MIN_FREE_AREA = 0.1
# A leaf separates nothing if open cells lead around it within this distance [m]
DETOUR_REACH = 1.0


class LeafLines(NamedTuple):
    """The cells along lines that start at a closed door leaf: their ids, -1 outside the lattice.

    These lines show which spaces the leaf separates.

    Attributes:
        sight_cells: the cells along lines at a right angle to the leaf, from each of its two sides,
            shape (2, lines, steps).
        end_cells: the cells along the lines that continue the leaf at its two ends, shape (2,
            steps).
    """

    sight_cells: Int
    end_cells: Int


@dataclass(frozen=True, eq=False)
class ClosedLeaf:
    """The cells that a closed door leaf blocks, and the cells beside it.

    Attributes:
        cells: for each level, the ids of the cells that the leaf blocks, ascending.
        lines: the cells along lines from the leaf's sides and ends; None if the leaf has no finite
            geometry.
    """

    cells: Sequence[Int]
    lines: LeafLines | None


class LeafMarks(NamedTuple):
    """The cells of a level's closed leaves.

    Attributes:
        is_separating: a mask of the open cells of leaves that separate two spaces, of these leaves'
            frames, and of small pockets between leaves, shape (height, width).
        is_not_separating: a mask of the open cells of all other leaves.
        cells_beyond: ids of cells in the spaces on both sides of separating leaves: the first cell
            beyond the leaf, on each line at a right angle to it.
    """

    is_separating: Bool
    is_not_separating: Bool
    cells_beyond: Int


def mark_leaves(
    level: LevelFlags, level_number: int, closed_leaves: Sequence[ClosedLeaf], cell_size: float
) -> LeafMarks | None:
    """Find which closed leaves separate two spaces of a level, and mark the cells of all leaves.

    At first, all leaves are closed: the two leaves of a double door only separate spaces together.
    Leaves that separate nothing are removed, and the remaining ones are tested again, until each of
    them separates two spaces.

    Args:
        level: the flags of the level's cells.
        level_number: the level's number.
        closed_leaves: all door leaves of the scene, in their closed state.
        cell_size: the side of a cell, > 0 [m].

    Returns:
        The cells of leaves; None if there are no leaves on the level.
    """
    leaves_on_level = [leaf for leaf in closed_leaves if len(leaf.cells[level_number])]
    if not leaves_on_level:
        return None
    leaf_cells = _mark_cells(level, level_number, leaves_on_level)
    if not leaf_cells.any():
        return None
    leaves = [leaf for leaf in leaves_on_level if leaf.lines is not None]
    while leaves:
        leaf_lines = [leaf.lines for leaf in leaves if leaf.lines is not None]
        is_barrier = _mark_cells(level, level_number, leaves)
        is_barrier |= _mark_frames(
            level, is_barrier, np.stack([lines_of_leaf.end_cells for lines_of_leaf in leaf_lines])
        )
        spaces = _SpacesBetweenLeaves(level, is_barrier, cell_size)
        cells_beyond = spaces.find_cells_beyond(
            np.stack([lines_of_leaf.sight_cells for lines_of_leaf in leaf_lines])
        )
        windows_near_leaves = [
            _window_near(leaf.cells[level_number], leaf_cells.shape, cell_size) for leaf in leaves
        ]
        is_separating = spaces.mark_separating_leaves(cells_beyond, windows_near_leaves)
        if is_separating.all():
            return LeafMarks(
                is_separating=spaces.is_barrier,
                is_not_separating=leaf_cells & ~spaces.is_barrier,
                cells_beyond=np.unique(cells_beyond[cells_beyond >= 0]),
            )
        leaves = [leaf for leaf, separates in zip(leaves, is_separating, strict=True) if separates]
    return LeafMarks(np.zeros_like(leaf_cells), leaf_cells, np.empty(0, dtype=np.int64))


def _mark_cells(level: LevelFlags, level_number: int, leaves: Sequence[ClosedLeaf]) -> Bool:
    """Mark the open cells that leaves block on level `level_number`, shape (height, width)."""
    is_leaf_cell = np.zeros(level.is_open.shape, dtype=np.bool_)
    for leaf in leaves:
        is_leaf_cell.ravel()[leaf.cells[level_number]] = True
    is_leaf_cell &= level.is_open
    return is_leaf_cell


def _mark_frames(level: LevelFlags, leaf_cells: Bool, end_cells: Int) -> Bool:
    """Mark the frames and sidelights that continue leaves at their ends.

    From each end of a leaf, its line is followed as long as its cells are open but occupied by
    structure. (Structure that is too short to be a wall leaves its cells open.)

    Args:
        level: the flags of the level's cells.
        leaf_cells: a mask of the open cells of leaves.
        end_cells: `LeafLines.end_cells` of each leaf, shape (leaves, 2, steps).
    """
    clipped_cells = np.maximum(end_cells, 0)
    is_occupied = leaf_cells | level.is_open & level.is_occupied
    continues_leaf = np.logical_and.accumulate(
        (end_cells >= 0) & is_occupied.ravel()[clipped_cells], axis=-1
    )
    is_frame = np.zeros(level.is_open.shape, dtype=np.bool_)
    is_frame.ravel()[clipped_cells[continues_leaf]] = True
    return is_frame


def _window_near(cells: Int, shape: tuple[int, ...], cell_size: float) -> Window:
    """Return the rows and columns within `DETOUR_REACH` of a leaf's cells, cropped to the lattice.

    Args:
        cells: ids of the leaf's cells, shape (n,), at least one.
        shape: the shape of the lattice, (height, width).
        cell_size: the side of a cell, > 0 [m].
    """
    margin = math.ceil(DETOUR_REACH / cell_size)
    rows, cols = np.divmod(cells, shape[1])
    return grow_window(window_of_cells(rows, cols), margin, margin, shape)


class _SpacesBetweenLeaves:
    """The spaces of a level: its connected open cells without the cells of closed leaves.

    Attributes:
        is_barrier: the open cells of leaves and their frames, shape (height, width); small pockets
            between leaves are added to it.
    """

    def __init__(self, level: LevelFlags, is_barrier: Bool, cell_size: float) -> None:
        """Label the spaces, and find which of them are large enough to count.

        Args:
            level: the flags of the level's cells.
            is_barrier: a mask of the open cells of leaves and their frames; the cells of small
                pockets between leaves are added to it.
            cell_size: the side of a cell, > 0 [m].
        """
        self.is_barrier = is_barrier
        self._level = level
        self._label, num_cells = label_components_2d(level.is_open & ~is_barrier)
        num_labels = len(num_cells)
        min_cells = MIN_FREE_AREA / cell_size**2
        num_free = np.bincount(self._label[~level.is_occupied], minlength=num_labels)
        is_at_edge = np.zeros(num_labels, dtype=np.bool_)
        is_at_edge[self._label[level.is_at_edge]] = True
        self._is_space = num_free >= min_cells
        self._is_space |= is_at_edge & (num_free > 0)  # a threshold before the outside
        self._is_space[0] = False
        self._is_pocket = (num_cells < min_cells) & ~is_at_edge
        self._is_pocket[0] = False

    def find_cells_beyond(self, sight_cells: Int) -> Int:
        """Find the first open cell beyond the barrier on each line of sight, before any wall.

        A pocket (an area that is too small for a space) on a line is added to the barrier, and the
        line continues behind it.

        Args:
            sight_cells: `LeafLines.sight_cells` of each leaf, shape (leaves, 2, lines, steps).

        Returns:
            The ids of the cells, -1 if a line has none, shape (leaves, 2, lines).
        """
        clipped_cells = np.maximum(sight_cells, 0)
        is_visible = mark_visible(sight_cells, self._level.is_open, self._level.floor)
        is_visible &= (sight_cells >= 0) & self._level.is_open.ravel()[clipped_cells]
        while True:
            is_beyond = is_visible & ~self.is_barrier.ravel()[clipped_cells]
            first_step = is_beyond.argmax(axis=-1)
            first_cells = np.take_along_axis(clipped_cells, first_step[..., None], axis=-1)[..., 0]
            first_cells = np.where(is_beyond.any(axis=-1), first_cells, -1)
            first_labels = np.unique(self._label.ravel()[first_cells[first_cells >= 0]])
            pocket_labels = first_labels[self._is_pocket[first_labels]]
            if not len(pocket_labels):
                return np.asarray(first_cells)
            is_in_pocket = np.isin(self._label, pocket_labels)
            self.is_barrier |= is_in_pocket
            self._label[is_in_pocket] = 0

    def mark_separating_leaves(self, cells_beyond: Int, windows: Sequence[Window]) -> Bool:
        """Mark the leaves that have different spaces on their two sides.

        The space of a side is the one that most lines of sight from this side reach. If both sides
        have the same space, the leaf still counts as separating if the two sides are not connected
        within the rows and columns near the leaf.

        Args:
            cells_beyond: the first cell beyond the barrier on each line of sight, see
                `find_cells_beyond`, shape (leaves, 2, lines).
            windows: the rows and columns near each leaf.

        Returns:
            Whether each leaf separates two spaces, shape (leaves,).
        """
        is_seen = cells_beyond >= 0
        label_beyond = self._label.ravel()[np.maximum(cells_beyond, 0)]
        side_labels = _find_majority_label(
            np.where(is_seen & self._is_space[label_beyond], label_beyond, 0)
        )
        has_both_sides = (side_labels > 0).all(axis=-1)
        is_separating = has_both_sides & (side_labels[:, 0] != side_labels[:, 1])
        # one space on both sides may still be two spaces near the leaf
        num_cols = self._label.shape[1]
        for leaf_index in np.flatnonzero(has_both_sides & ~is_separating).tolist():
            row_slice, col_slice = windows[leaf_index]
            row, col = np.divmod(cells_beyond[leaf_index], num_cols)
            is_near_leaf = (row >= row_slice.start) & (row < row_slice.stop)
            is_near_leaf &= (col >= col_slice.start) & (col < col_slice.stop) & is_seen[leaf_index]
            component, _ = label_components_2d(self._label[row_slice, col_slice] > 0)
            row = np.where(is_near_leaf, row - row_slice.start, 0)
            col = np.where(is_near_leaf, col - col_slice.start, 0)
            near_label = np.where(is_near_leaf, component[row, col], 0)
            near_side_labels = _find_majority_label(near_label[None])[0]
            is_separating[leaf_index] = (near_side_labels > 0).all() and near_side_labels[
                0
            ] != near_side_labels[1]
        return np.asarray(is_separating)


def mark_visible(sight_cells: Int, is_open: Bool, floor: Float) -> Bool:
    """Mark the cells on lines of sight that are before the first wall on their line.

    A wall is a cell that has a floor and is not open.

    Args:
        sight_cells: ids of cells along lines, -1 outside the lattice, shape (…, steps), see
            `LeafLines`.
        is_open: the level's cells that have a floor and are in no wall or window, shape (height,
            width).
        floor: z of the level's floors, NaN for none, shape (height, width) [m].

    Returns:
        A mask of the cells before the first wall, of the shape of `sight_cells`.
    """
    clipped_cells = np.maximum(sight_cells, 0)
    is_wall = (
        (sight_cells >= 0)
        & ~is_open.ravel()[clipped_cells]
        & ~np.isnan(floor.ravel()[clipped_cells])
    )
    return ~np.logical_or.accumulate(is_wall, axis=-1)


def _find_majority_label(label: Int32) -> Int32:
    """Find the most common label among the lines of each side; on a tie, the first line's.

    Args:
        label: the label of the space that each line of sight reaches, 0 for none, shape (leaves, 2,
            lines).

    Returns:
        The label, 0 where no line has one, shape (leaves, 2).
    """
    num_equal_lines = (label[..., :, None] == label[..., None, :]).sum(axis=-1) * (label > 0)
    best_line = num_equal_lines.argmax(axis=-1)
    majority_label: Int32 = np.take_along_axis(label, best_line[..., None], axis=-1)[..., 0]
    return majority_label
