"""The blocks of a level: how many hold each cell, and what the cells hold without them.

Blocks may overlap, so they are counted. The level's own weights and occupancy change with the
blocks, and its clearance if it has that layer, in the touched window only. A reader that keeps
what follows from them, like a `PathFinder`, asks for the windows that changed since it last asked.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from navbake.navgrid.islands import clearance, clearance_of
from navbake.types import Bool, Int

if TYPE_CHECKING:
    from navbake.navgrid.grid import SceneGrid2D

# What a block takes: cells that the thing is in; where an agent can't stand; where it can't step
# diagonally; where it can't be beside the cell's centre. Each holds the one before, but for the
# first two.
OCCUPIED, BLOCKED, NO_DIAGONAL, NO_OFF_CENTER = range(4)
NUM_LAYERS = 4

Layers = list[Int]
"""Ascending cell ids for each of the four."""

Window = tuple[int, int, int, int]
"""First and last row, first and last column, the last ones excluded."""

CHANGING = {"occupancy", "clearance"}  # attributes that are changed in place
MAX_JOURNAL = 1024  # changes that a level remembers; a reader that missed more reads all of it


class BlockState:
    """The blocks of one level: how many hold each cell, and what the cells hold without them.

    Making one gives the level arrays of its own, because blocks write to them in place.

    Attributes:
        count: how many blocks hold a cell, by layer and cell id, uint16.
        weights: what the cells weigh without blocks, by cell id.
        occupancy: of the cells without blocks, by cell id; None if the level has no such layer.
        revision: how many times something changed.
    """

    def __init__(self, level: SceneGrid2D) -> None:
        self.count = np.zeros((NUM_LAYERS, level.width * level.height), dtype=np.uint16)
        self.revision = 0
        self._journal: list[Window] = []
        # others may share the level's arrays, or they may be read-only
        level.weights = np.array(level.weights, order="C")
        level.attributes = dict(level.attributes)
        for name in CHANGING & level.attributes.keys():
            level.attributes[name] = np.array(level.attributes[name], order="C")
        self.weights = level.weights.ravel().copy()
        stored = level.attributes.get("occupancy")
        self.occupancy = None if stored is None else stored.ravel().copy()
        self._farthest = _farthest(level)

    @property
    def is_blocked(self) -> bool:
        """Whether any cell is blocked now."""
        return bool(self.count.any())

    def held(self, level: SceneGrid2D, layer: int) -> Bool:
        """The cells that a layer of some block holds, shape (height, width)."""
        return np.asarray(self.count[layer].reshape(level.shape) > 0)

    def windows_since(self, revision: int) -> list[Window] | None:
        """The windows that changed after a revision; None if that is too long ago."""
        missed = self.revision - revision
        if missed > len(self._journal):
            return None
        return self._journal[len(self._journal) - missed :]

    def hold(self, level: SceneGrid2D, cells: Layers) -> None:
        """Block cells."""
        for layer, ids in enumerate(cells):
            self.count[layer, ids] += 1
        # what was there is read again with the first block: others may have written to it since
        weights, taken = level.weights.reshape(-1), cells[BLOCKED]
        taken = taken[self.count[BLOCKED, taken] == 1]
        self.weights[taken] = weights[taken]
        weights[taken] = np.inf
        if self.occupancy is not None:
            occupancy, taken = level.attributes["occupancy"].reshape(-1), cells[OCCUPIED]
            taken = taken[self.count[OCCUPIED, taken] == 1]
            self.occupancy[taken] = occupancy[taken]
            occupancy[taken] = 1
        self._note(level, cells)

    def release(self, level: SceneGrid2D, cells: Layers) -> None:
        """Take back what `hold` did."""
        for layer, ids in enumerate(cells):
            self.count[layer, ids] -= 1
        left = cells[BLOCKED][self.count[BLOCKED, cells[BLOCKED]] == 0]
        level.weights.reshape(-1)[left] = self.weights[left]
        if self.occupancy is not None:
            left = cells[OCCUPIED][self.count[OCCUPIED, cells[OCCUPIED]] == 0]
            level.attributes["occupancy"].reshape(-1)[left] = self.occupancy[left]
        self._note(level, cells)

    def without_blocks(self, level: SceneGrid2D) -> SceneGrid2D:
        """The level as it is when nobody blocks it; itself if nobody does."""
        if not self.is_blocked:
            return level
        weights = np.where(self.count[BLOCKED] > 0, self.weights, level.weights.ravel())
        attributes = {}
        if self.occupancy is not None:
            stored = level.attributes["occupancy"].ravel()
            occupancy = np.where(self.count[OCCUPIED] > 0, self.occupancy, stored)
            attributes["occupancy"] = occupancy.reshape(level.shape)
        return level.with_layers(weights=weights.reshape(level.shape), attributes=attributes)

    def _note(self, level: SceneGrid2D, cells: Layers) -> None:
        # one window for all layers; a reader that is that far behind copies it as a whole
        rows, cols = np.divmod(np.concatenate(cells), level.width)
        window = (int(rows.min()), int(rows.max()) + 1, int(cols.min()), int(cols.max()) + 1)
        self.revision += 1
        self._journal.append(window)
        del self._journal[:-MAX_JOURNAL]
        if self._farthest is not None:
            _measure_again(level, window, self._farthest)


def _farthest(level: SceneGrid2D) -> float | None:
    """The largest clearance of a level, in cells; None if it has no such layer.

    In others' files ``clearance`` may mean anything: it has to be what it should be.
    """
    stored = level.attributes.get("clearance")
    if stored is None:
        return None
    measured = clearance(level)
    if stored.dtype != measured.dtype or not np.allclose(stored, measured, atol=1e-5):
        return None
    return float(measured.max(initial=0)) / level.lattice.cell_size


def _measure_again(level: SceneGrid2D, window: Window, farthest: float) -> None:
    """Measure the clearance where it may have changed.

    No cell is farther from what blocks than it was when nothing was blocked, so cells farther
    from the window than that keep their clearance.

    Args:
        level: its layer `clearance` is changed.
        window: where cells changed.
        farthest: the largest clearance when nothing is blocked, in cells.
    """
    reach = math.ceil(farthest) + 2
    # the nearest blocked cell of one at the rim of `inner` may be a whole reach further out
    outer, inner = (_grown(window, k * reach, level) for k in (2, 1))
    row0, row1, col0, col1 = outer
    closed = (
        (int(row0 == 0), int(row1 == level.height)),
        (int(col0 == 0), int(col1 == level.width)),
    )
    metres = clearance_of(level.free[row0:row1, col0:col1], level.lattice.cell_size, closed)
    rows, cols = slice(inner[0], inner[1]), slice(inner[2], inner[3])
    here = np.s_[inner[0] - row0 : inner[1] - row0, inner[2] - col0 : inner[3] - col0]
    level.attributes["clearance"][rows, cols] = metres[here]


def _grown(window: Window, by: int, level: SceneGrid2D) -> Window:
    row0, row1, col0, col1 = window
    return (
        max(row0 - by, 0),
        min(row1 + by, level.height),
        max(col0 - by, 0),
        min(col1 + by, level.width),
    )
