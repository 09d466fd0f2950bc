"""What rooms need of the columns: what lies highest over each cell, and holes in floors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import Columns, ColumnSource
from navbake.baker.floors.levels import LevelFloor
from navbake.config.settings import AgentSettings
from navbake.types import Bool, Float


class Overhead(NamedTuple):
    """What lies highest over each cell, and holes in the floors of each level.

    Attributes:
        columns: all surfaces.
        top: height of the highest surface of each cell, NaN for none, shape (cells,), float64 [m].
        up: the z of that surface's unit normal, shape (cells,), float32.
        holes: of each level, the cells without a floor in which nothing stands at the height of
            an agent's body, shape (height, width), bool.
    """

    columns: ColumnSource
    top: Float
    up: NDArray[np.float32]
    holes: list[Bool]


class OverheadFinder:
    """Finds what lies highest over each cell, and holes in floors, block by block."""

    def __init__(
        self, columns: ColumnSource, levels: Sequence[LevelFloor], agent: AgentSettings
    ) -> None:
        num_cells = columns.lattice.width * columns.lattice.height
        self._levels, self._agent = levels, agent
        self._found = Overhead(
            columns,
            np.full(num_cells, np.nan),
            np.zeros(num_cells, dtype=np.float32),
            [np.isnan(level.floor) for level in levels],
        )

    def add(self, columns: Columns) -> None:
        """Look at the columns of a block."""
        first, end = columns.known_rows.cells(columns.lattice)
        start = columns.start[first : end + 1]
        filled = np.flatnonzero(np.diff(start))
        last = start[filled + 1] - 1
        self._found.top[first + filled] = columns.z[last]
        self._found.up[first + filled] = columns.normal[last, 2]
        for level, holes in zip(self._levels, self._found.holes, strict=True):
            keep_holes(holes.ravel()[first:end], start, level.ground, columns, self._agent)

    def found(self) -> Overhead:
        """What was found in all blocks."""
        return self._found


def keep_holes(
    holes: Bool, start: NDArray[np.int64], ground: float, columns: Columns, agent: AgentSettings
) -> None:
    """Keep the marks of cells in which nothing stands at the height of an agent's body.

    That is so where the next surface over the level's ground and a step is higher than the agent,
    unless it is the top of something.
    """
    cell = np.flatnonzero(holes)
    if not len(cell):
        return
    below = columns.z <= ground + agent.traversable_floor_height
    count = np.concatenate([[0], np.cumsum(below)])
    begin, end = start[cell], start[cell + 1]
    following = begin + count[end] - count[begin]
    has_next = np.flatnonzero(following < end)
    entry = following[has_next]
    is_low = columns.z[entry] <= ground + agent.height
    is_top = columns.normal[entry, 2] > 0
    holes[cell[has_next[is_low | is_top]]] = False
