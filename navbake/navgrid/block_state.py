"""The blocks of a level: how many hold each cell, and what the cells hold without them.

Blocks may overlap, so they are counted. The level's own weights and occupancy change with the
blocks, and its clearance if it has that layer, in the touched window only. A reader that keeps
what follows from them, like a `PathFinder`, asks for the windows that changed since it last asked.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.islands import clearance
from navbake.types import Bool, Int

if TYPE_CHECKING:
    from typing_extensions import Self

    from navbake.navgrid.grid import NavGrid, SceneGrid2D

# The layers of a block: cells that the thing is in; where an agent can't stand; where it can't
# step diagonally; where it can't be beside the cell's centre. From the second on, each includes
# the one before.
OCCUPIED, BLOCKED, NO_DIAGONAL, NO_OFF_CENTER = range(4)
NUM_LAYERS = 4

Layers = list[Int]
"""Ascending cell ids for each of the four."""

Window = tuple[int, int, int, int]
"""First and last row, first and last column, the last ones excluded."""

CHANGING = {"occupancy", "solid", "clearance"}  # attributes that are changed in place
OCCUPIED_LAYERS = ("occupancy", "solid")  # attributes that are 1 where the thing is
MAX_JOURNAL = 1024  # changes that a level remembers; a reader that missed more reads all of it


class BlockState:
    """The blocks of one level.

    Making one gives the level arrays of its own, because blocks write to them in place.

    Attributes:
        count: how many blocks hold a cell, by layer and cell id, uint16.
        weights: what the cells weigh without blocks, by cell id.
        occupied: the layers `OCCUPIED_LAYERS` that the level has, without blocks, by cell id.
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
        self.occupied = {
            name: level.attributes[name].ravel().copy()
            for name in OCCUPIED_LAYERS
            if name in level.attributes
        }
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

    def _changed(self, level: SceneGrid2D) -> list[tuple[int, NDArray[Any], NDArray[Any], float]]:
        """Layer, the level's array, its values without blocks and that of a cell of the layer."""
        of_layers = [
            (OCCUPIED, level.attributes[name], clean, 1.0) for name, clean in self.occupied.items()
        ]
        return [(BLOCKED, level.weights, self.weights, np.inf), *of_layers]

    def hold(self, level: SceneGrid2D, cells: Layers) -> None:
        """Block cells."""
        for layer, ids in enumerate(cells):
            self.count[layer, ids] += 1
        for layer, array, clean, value in self._changed(level):
            # what was there is read again with the first block: others may have written to it
            first = cells[layer][self.count[layer, cells[layer]] == 1]
            clean[first] = array.reshape(-1)[first]
            array.reshape(-1)[first] = value
        self._note(level, cells)

    def release(self, level: SceneGrid2D, cells: Layers) -> None:
        """Take back what `hold` did."""
        for layer, ids in enumerate(cells):
            self.count[layer, ids] -= 1
        for layer, array, clean, _ in self._changed(level):
            left = cells[layer][self.count[layer, cells[layer]] == 0]
            array.reshape(-1)[left] = clean[left]
        self._note(level, cells)

    def without_blocks(self, level: SceneGrid2D) -> SceneGrid2D:
        """The level as it is when nothing blocks it; itself if nothing does."""
        if not self.is_blocked:
            return level
        weights, *occupied = (
            np.where(self.held(level, layer), clean.reshape(level.shape), array)
            for layer, array, clean, _ in self._changed(level)
        )
        attributes = dict(zip(self.occupied, occupied, strict=True))
        return level.with_layers(weights=weights, attributes=attributes)

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
    """The largest clearance of a level, in cells; None if it has no such layer."""
    stored = level.attributes.get("clearance")
    if stored is None:
        return None
    measured = clearance(level)
    # in files of other programs, a layer of this name may mean anything
    if stored.dtype != measured.dtype or not np.allclose(stored, measured, atol=1e-5):
        return None
    return float(measured.max(initial=0)) / level.lattice.cell_size


def _measure_again(level: SceneGrid2D, window: Window, farthest: float) -> None:
    """Measure the clearance again around a window of cells that changed.

    No cell is farther from what blocks than without blocks, at most `farthest` cells. So cells
    farther from the window than that keep their clearance.
    """
    reach = math.ceil(farthest) + 2
    # the nearest blocked cell of one at the rim of `inner` may be a whole reach further out
    outer, inner = (_grown(window, k * reach, level) for k in (2, 1))
    row0, row1, col0, col1 = inner
    here = np.s_[row0 - outer[0] : row1 - outer[0], col0 - outer[2] : col1 - outer[2]]
    level.attributes["clearance"][row0:row1, col0:col1] = clearance(level, outer)[here]


def _grown(window: Window, by: int, level: SceneGrid2D) -> Window:
    row0, row1, col0, col1 = window
    rows = max(row0 - by, 0), min(row1 + by, level.height)
    return *rows, max(col0 - by, 0), min(col1 + by, level.width)


class Block:
    """Cells that are blocked until `free` is called, or as a context manager, until its end.

    Attributes:
        cells: flat ids of the cells where an agent can't stand because of the block, by level,
            each ascending, int64; including cells that were not free before.
    """

    def __init__(self, grid: NavGrid, layers: list[Layers]) -> None:
        self.cells = [of_level[BLOCKED] for of_level in layers]
        self._held: list[tuple[SceneGrid2D, BlockState, Layers]] = []
        for level, of_level in zip(grid.levels, layers, strict=True):
            if any(len(ids) for ids in of_level):
                if level.block_state is None:
                    level.block_state = BlockState(level)
                level.block_state.hold(level, of_level)
                self._held.append((level, level.block_state, of_level))

    def free(self) -> None:
        """Free the cells, except those that other blocks hold. Further calls do nothing."""
        for level, state, of_level in self._held:
            state.release(level, of_level)
        self._held.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.free()
