"""The blocks of a level as the grid keeps them: how many hold each cell, and what changed when.

Blocks may overlap, so they are counted. A reader that keeps what follows from them, like a
`PathFinder`, asks for the windows that changed since it last asked.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from navbake.types import Bool, Int

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

    Attributes:
        count: how many blocks hold a cell, by layer, shape (4, height, width), uint16.
        weights: what the cells weigh without blocks, shape (height, width).
        occupied: the layers `OCCUPIED_LAYERS` that the level has, without blocks.
        farthest: the largest clearance of the level without blocks, in cells; None where it has
            no such layer.
        revision: how many times something changed.
    """

    def __init__(
        self,
        weights: NDArray[np.floating],
        occupied: Mapping[str, NDArray[np.generic]],
        farthest: float | None,
    ) -> None:
        self.count = np.zeros((NUM_LAYERS, *weights.shape), dtype=np.uint16)
        self.weights, self.occupied, self.farthest = weights, occupied, farthest
        self.revision = 0
        self._journal: list[Window] = []

    @property
    def is_blocked(self) -> bool:
        """Whether any cell is blocked now."""
        return bool(self.count.any())

    def held(self, layer: int) -> Bool:
        """The cells that a layer of some block holds, shape (height, width)."""
        return np.asarray(self.count[layer] > 0)

    def note(self, window: Window) -> None:
        """Remember that cells of a window changed."""
        self.revision += 1
        self._journal.append(window)
        del self._journal[:-MAX_JOURNAL]

    def windows_since(self, revision: int) -> list[Window] | None:
        """The windows that changed after a revision; None if that is too long ago."""
        missed = self.revision - revision
        if missed > len(self._journal):
            return None
        return self._journal[len(self._journal) - missed :]
