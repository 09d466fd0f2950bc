"""What lies under a disc on the map: floors of all levels, obstacles and edges, cell by cell."""

from __future__ import annotations

import numpy as np

from navbake.navgrid.grid_base import GridBase
from navbake.types import Bool, Float, Int

SLACK = 1e-5  # that rounding may add to a step [m]
TINY = 1e-10  # share of a radius by which a square only touches a disc; less than inflation takes


class Surroundings:
    """The floors of all levels, each by row and column of any other's lattice."""

    def __init__(self, grid: GridBase, step: float, *, by_centres: bool = False) -> None:
        """Take the cells of a grid.

        Args:
            step: of the agent [m].
            by_centres: whether all that is occupied closes cells, or only what is solid.
        """
        self._step, self._levels = step, grid.levels
        self._floors = [level.floor for level in grid.levels]
        # what is a reason has to be blocked itself, so that it is judged in its turn
        self._occupied = [(level.occupancy != 0) & ~level.free for level in grid.levels]
        if not by_centres:
            self._occupied = [
                occupied & (level.solid != 0)
                for occupied, level in zip(self._occupied, grid.levels, strict=True)
            ]

    def floors_under(
        self, number: int, rows: Int, cols: Int, floor: Float, radius: float
    ) -> tuple[Float, Float]:
        """The lowest and the highest floor that a disc stands on, shape (n,) [m].

        Of all levels, what is within a step of the disc's own floor counts.
        """
        low, high = floor.copy(), floor.copy()
        for row, col in _offsets(radius / self._levels[number].lattice.cell_size):
            for other in range(len(self._levels)):
                there, *_ = self._look(number, other, rows + row, cols + col)
                near = np.abs(there - floor) <= self._step + SLACK
                low = np.where(near, np.fmin(low, there), low)
                high = np.where(near, np.fmax(high, there), high)
        return low, high

    def has_reason(self, number: int, rows: Int, cols: Int, floor: Float, radius: float) -> Bool:
        """Whether a disc meets what may close its cell: an occupied square, an edge, a ledge.

        Beyond each of several levels is no floor, which closes cells. Beyond a single level
        nothing was baked, and nothing closes them.
        """
        found = np.zeros(len(rows), dtype=np.bool_)
        is_single = len(self._levels) == 1
        for row, col in _offsets(radius / self._levels[number].lattice.cell_size):
            there, occupied, inside = self._look(number, number, rows + row, cols + col)
            is_ledge = ~(np.abs(there - floor) <= self._step - SLACK)
            found |= (occupied | is_ledge) & (inside | (not is_single))
            for other in range(len(self._levels)):
                if other != number:
                    there, occupied, inside = self._look(number, other, rows + row, cols + col)
                    found |= ~np.isnan(there) & (occupied | (there > floor + self._step))
        return found

    def _look(self, number: int, other: int, rows: Int, cols: Int) -> tuple[Float, Bool, Bool]:
        """Floor and occupancy of another level at cells of one, and whether it has them.

        Where it has none, the floor is NaN, and they aren't occupied.
        """
        one, two = self._levels[number].lattice, self._levels[other].lattice
        r = rows + round((two.y_max - one.y_max) / one.cell_size)
        c = cols + round((one.x_min - two.x_min) / one.cell_size)
        inside = (r >= 0) & (c >= 0) & (r < two.height) & (c < two.width)
        r, c = np.where(inside, r, 0), np.where(inside, c, 0)
        floor = np.where(inside, self._floors[other][r, c], np.nan)
        return floor, inside & self._occupied[other][r, c], inside


def _offsets(radius: float) -> list[tuple[int, int]]:
    """The cells whose squares an open disc round a cell's centre meets; radius in cells."""
    reach = int(radius + 0.5) + 1
    span = range(-reach, reach + 1)
    return [
        (row, col)
        for row in span
        for col in span
        if np.hypot(max(abs(row) - 0.5, 0), max(abs(col) - 0.5, 0)) < radius * (1 - TINY)
    ]
