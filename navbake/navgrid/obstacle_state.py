"""The added obstacles of one level: how many block each cell, and a log of the changed cells.

`grid.block` adds obstacles (`navbake.runtime.blocking`). They may overlap, so the number of
obstacles on each cell is counted.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from navbake.types import Bool, Int

# An obstacle has four layers of cells. Each layer includes the one before.
OCCUPIED = 0  # cells that the obstacle itself overlaps
BLOCKED = 1  # cells where an agent can't stand because of it
NO_DIAGONAL = 2  # cells where an agent can't step diagonally
NO_OFF_CENTER = 3  # cells where an agent can only be on the cell's centre
NUM_LAYERS = 4

Layers = list[Int]
"""Ascending cell ids for each of the four layers."""

CellRange = tuple[int, int, int, int]
"""A rectangle of cells: first row, stop row, first column, stop column; the stops are not in it."""

# Attributes that obstacles change in place
CHANGING_ATTRIBUTES = {"occupancy", "solid", "clearance"}
OCCUPIED_ATTRIBUTES = ("occupancy", "solid")  # attributes that are 1 where an obstacle is
MAX_LOG = 1024  # largest number of changes in the log


class ObstacleState:
    """The added obstacles of one level.

    Attributes:
        count: How many obstacles affect each cell in each of four ways, shape (4, height, width),
            uint16. The ways, the first index, are `OCCUPIED`, `BLOCKED`, `NO_DIAGONAL` and
            `NO_OFF_CENTER`.
        weights_without_obstacles: Weights of the level as they are without obstacles, shape
            (height, width).
        attributes_without_obstacles: The attributes of `OCCUPIED_ATTRIBUTES` by name, as they are
            without obstacles.
        layer_of_attribute: For each of these attributes, which of the four layers of an obstacle is
            1 in it: `OCCUPIED`, or `BLOCKED` for the ``occupancy`` of a level whose ``solid``
            holds what obstacles themselves overlap.
        max_clearance: Largest clearance without obstacles [cells]; None if the level has no layer
            ``clearance``, or one that means something else.
        revision: Number of changes so far.
    """

    def __init__(
        self,
        weights_without_obstacles: NDArray[np.floating],
        attributes_without_obstacles: Mapping[str, NDArray[np.generic]],
        layer_of_attribute: Mapping[str, int],
        max_clearance: float | None,
    ) -> None:
        self.count = np.zeros((NUM_LAYERS, *weights_without_obstacles.shape), dtype=np.uint16)
        self.weights_without_obstacles = weights_without_obstacles
        self.attributes_without_obstacles = attributes_without_obstacles
        self.layer_of_attribute = layer_of_attribute
        self.max_clearance = max_clearance
        self.revision = 0
        self._log: list[CellRange] = []

    @property
    def is_blocked(self) -> bool:
        """Whether an obstacle blocks any cell of the level."""
        return bool(self.count.any())

    def mask_of(self, layer: int) -> Bool:
        """Mark the cells that any obstacle affects in one of the four ways.

        Args:
            layer: `OCCUPIED`, `BLOCKED`, `NO_DIAGONAL` or `NO_OFF_CENTER`.

        Returns:
            bool, shape (height, width).
        """
        return np.asarray(self.count[layer] > 0)

    def log_change(self, cell_range: CellRange) -> None:
        """Log that an obstacle has changed cells, so that searches update them.

        Args:
            cell_range: A range that holds all of these cells.
        """
        self.revision += 1
        self._log.append(cell_range)
        del self._log[:-MAX_LOG]

    def changes_since(self, revision: int) -> list[CellRange] | None:
        """Return the ranges of cells that changed after a revision, in order.

        None if the log no longer has all of them: then any cell may have changed.
        """
        num_missed = self.revision - revision
        if num_missed > len(self._log):
            return None
        return self._log[len(self._log) - num_missed :]
