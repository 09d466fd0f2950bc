"""The added obstacles of one level: how many block each cell, and a log of what changed.

`grid.block` adds obstacles (`navbake.runtime.blocking`). They may overlap, so cells have counts.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from navbake.types import Bool, Int

# The layers of an obstacle: the cells that it covers itself; cells where an agent can't stand;
# where it can't step diagonally; where it can't be off the cell's centre. Each of the last three
# includes the one before.
OCCUPIED = 0
BLOCKED = 1
NO_DIAGONAL = 2
NO_OFF_CENTER = 3
NUM_LAYERS = 4

Layers = list[Int]
"""Ascending cell ids for each of the four layers."""

Window = tuple[int, int, int, int]
"""First and last row, first and last column, the last ones excluded."""

# Attributes that obstacles change in place
CHANGING_ATTRIBUTES = {"occupancy", "solid", "clearance"}
OCCUPIED_LAYERS = ("occupancy", "solid")  # attributes that are 1 in the cells of an obstacle
MAX_LOG = 1024  # windows in the log


class ObstacleState:
    """The added obstacles of one level.

    Attributes:
        count: Number of obstacles on each cell, by layer, shape (4, height, width), uint16.
        weights: Weights of the level without obstacles, shape (height, width).
        occupied: The level's `OCCUPIED_LAYERS` without obstacles, by name.
        farthest: Largest clearance without obstacles, in cells; None without the layer
            ``clearance``.
        revision: Number of changes so far.
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
        self._log: list[Window] = []

    @property
    def is_blocked(self) -> bool:
        """Whether there is an obstacle."""
        return bool(self.count.any())

    def mask_of(self, layer: int) -> Bool:
        """Mark the cells that obstacles block in a layer, shape (height, width)."""
        return np.asarray(self.count[layer] > 0)

    def log_change(self, window: Window) -> None:
        """Log that the cells of a window have changed."""
        self.revision += 1
        self._log.append(window)
        del self._log[:-MAX_LOG]

    def windows_since(self, revision: int) -> list[Window] | None:
        """Return the windows that changed after a revision; None if the log is too short."""
        num_missed = self.revision - revision
        if num_missed > len(self._log):
            return None
        return self._log[len(self._log) - num_missed :]
