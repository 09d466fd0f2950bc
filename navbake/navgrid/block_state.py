"""The blocks of a level: counts by cell, as blocks may overlap, and a log of changed windows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from navbake.types import Bool, Int

# The layers of a block: the obstacle's own cells; cells where an agent can't stand; can't step
# diagonally; can't be off the cell's centre. Each of the last three includes the one before.
OCCUPIED, BLOCKED, NO_DIAGONAL, NO_OFF_CENTER = range(4)
NUM_LAYERS = 4

Layers = list[Int]
"""Ascending cell ids for each of the four."""

Window = tuple[int, int, int, int]
"""First and last row, first and last column, the last ones excluded."""

CHANGING = {"occupancy", "solid", "clearance"}  # attributes that are changed in place
OCCUPIED_LAYERS = ("occupancy", "solid")  # attributes that are 1 in the obstacle's own cells
MAX_JOURNAL = 1024  # length of the log


class BlockState:
    """The blocks of one level.

    Attributes:
        count: number of blocks on a cell, by layer, shape (4, height, width), uint16.
        weights: without blocks, shape (height, width).
        occupied: the level's `OCCUPIED_LAYERS` without blocks.
        farthest: the largest clearance without blocks, in cells; None without that layer.
        revision: number of changes.
    """

    def __init__(
        self,
        weights: NDArray[np.floating],
        occupied: Mapping[str, NDArray[np.generic]],
        farthest: float | None,
    ) -> None:
        self.count = np.zeros((NUM_LAYERS, *weights.shape), dtype=np.uint16)
        self.weights = weights
        self.occupied = occupied
        self.farthest = farthest
        self.revision = 0
        self._journal: list[Window] = []

    @property
    def is_blocked(self) -> bool:
        return bool(self.count.any())

    def held(self, layer: int) -> Bool:
        """The cells that are blocked in a layer, shape (height, width)."""
        return np.asarray(self.count[layer] > 0)

    def note(self, window: Window) -> None:
        """Log a window as changed."""
        self.revision += 1
        self._journal.append(window)
        del self._journal[:-MAX_JOURNAL]

    def windows_since(self, revision: int) -> list[Window] | None:
        """The windows changed after a revision; None if the log doesn't go back so far."""
        missed = self.revision - revision
        if missed > len(self._journal):
            return None
        return self._journal[len(self._journal) - missed :]
