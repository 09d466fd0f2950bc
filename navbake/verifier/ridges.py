"""Finds ridges by MuJoCo's rays: tops of walls and beams, which are no floors."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from navbake.navgrid.lattice import Lattice
from navbake.verifier.probes import (
    NO_CONTACT,
    SAME_HEIGHT_TOLERANCE,
    ObstacleProbe,
    SurfaceHit,
    UprightPrism,
    VerticalLine,
)
from navbake.verifier.sample import AgentSizes

RIDGE_WIDTH = 0.4  # what is narrower between two drops is a ridge [m]
MAX_WALK_LENGTH = 2 * RIDGE_WIDTH  # cells across a ridge are looked at over this length [m]
FEET_THICKNESS = 0.01  # height of the slice above a step; an obstacle in it bars the way [m]
AXIS_OFFSETS = ((0, 1), (1, 0))  # row and column to the next cell along x, and along y

StandableAt = Callable[[int, int], list[SurfaceHit]]
"""Returns the surfaces to stand on in a cell, given the cell's row and column."""
LineAt = Callable[[int, int], VerticalLine]
"""Returns the vertical line through the centre of a cell, given the cell's row and column."""


class WalkEnd(NamedTuple):
    """How far an agent can walk along a row or column of cells, and what ends the walk.

    Attributes:
        num_cells: The number of cells that it enters; the first cell doesn't count.
        is_drop: Whether the walk ends at a drop, and not at a wall.
    """

    num_cells: int
    is_drop: bool


class RidgeProbe:
    """Decides whether a place to stand is on a ridge: between two drops less than 0.4 m apart.

    `is_ridge` takes the row and the column of a cell, and the height of the place [m]. The cell may
    lie outside the lattice.

    Args:
        probe: The obstacles that can carry floors.
        agent: The agent that the grid was baked for.
        lattice: The lattice of the cells.
        line_at: Returns the vertical line through the centre of a cell, given its row and column.
        standable_at: Returns the surfaces to stand on in a cell, lowest first, ridges included.
    """

    def __init__(
        self,
        probe: ObstacleProbe,
        agent: AgentSizes,
        lattice: Lattice,
        line_at: LineAt,
        standable_at: StandableAt,
    ) -> None:
        self._probe = probe
        self._agent = agent
        self._lattice = lattice
        self._line_at = line_at
        # many walks enter a cell, and all walks along a row of cells end at the same edge
        self._heights_at = lru_cache(200_000)(
            lambda row, col: [hit.z for hit in standable_at(row, col)]
        )
        self._max_cells = int(MAX_WALK_LENGTH / lattice.cell_size) + 1
        self.is_ridge = lru_cache(200_000)(self._is_ridge)
        self._is_drop = lru_cache(200_000)(self._ends_at_drop)

    def _is_ridge(self, row: int, col: int, z: float) -> bool:
        """Return whether a place is narrower than 0.4 m between two drops, or might be.

        The lengths of a strip's rows of cells say how wide it is up to the size of a cell, so each
        counts as a cell shorter than it is.

        Args:
            row: The row of the cell.
            col: The column of the cell.
            z: The height of the place [m].
        """
        inverse_lengths = [0.0, 0.0]
        for axis, (row_offset, col_offset) in enumerate(AXIS_OFFSETS):
            end_ahead = self._walk(row, col, row_offset, col_offset, z)
            if not end_ahead.is_drop:
                continue
            end_behind = self._walk(row, col, -row_offset, -col_offset, z)
            # one less than the cells of the row
            num_cells = end_ahead.num_cells + end_behind.num_cells
            if not end_behind.is_drop or num_cells > self._max_cells:
                continue
            inverse_lengths[axis] = 1 / max(
                num_cells * self._lattice.cell_size, SAME_HEIGHT_TOLERANCE
            )
        return math.hypot(*inverse_lengths) * RIDGE_WIDTH > 1

    def _walk(self, row: int, col: int, row_offset: int, col_offset: int, z: float) -> WalkEnd:
        """Walk from a place over cells until no surface is within a step of the one before."""
        max_step = self._agent.step
        for num_cells in range(self._max_cells + 1):
            next_row = row + row_offset
            next_col = col + col_offset
            nearest_height = math.inf
            smallest_gap = math.inf
            for height in self._heights_at(next_row, next_col):
                gap = abs(height - z)
                if gap < smallest_gap:
                    smallest_gap = gap
                    nearest_height = height
            if smallest_gap > max_step:
                return WalkEnd(num_cells, self._is_drop((row, col), (next_row, next_col), z))
            row = next_row
            col = next_col
            z = nearest_height
        return WalkEnd(self._max_cells + 1, False)

    def _ends_at_drop(self, cell: tuple[int, int], next_cell: tuple[int, int], z: float) -> bool:
        """Return whether a surface ends at a drop between two cells, and not at a wall."""
        if any(abs(hit.z - z) <= self._agent.step for hit in self._line_at(*next_cell).hits):
            return False
        return not (self._is_barred(*next_cell, z) or self._is_barred(*cell, z))

    def _is_barred(self, row: int, col: int, z: float) -> bool:
        """Return whether something stands over a cell, just above a step from height z [m]."""
        low_z = z + self._agent.step
        middle_z = low_z + FEET_THICKNESS / 2
        if self._line_at(row, col).is_inside(middle_z):
            return True
        x = self._lattice.x_min + (col + 0.5) * self._lattice.cell_size
        y = self._lattice.y_max - (row + 0.5) * self._lattice.cell_size
        half_size = self._lattice.cell_size / 2
        center = np.array([x, y, middle_z])
        half_extent = np.array([half_size, half_size, FEET_THICKNESS / 2])
        prism = UprightPrism(half_size, half_size, FEET_THICKNESS / 2, False)
        return any(
            self._probe.find_contact(obstacle, prism, center) != NO_CONTACT
            for obstacle in self._probe.obstacles.find_overlapping(
                center - half_extent, center + half_extent
            )
        )
