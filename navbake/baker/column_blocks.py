"""The columns of a whole scene, which may be too many to keep: found block by block, again."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from navbake.baker.clock import StageClock
from navbake.baker.columns import (
    Columns,
    GatheredColumns,
    Rows,
    TiledShapes,
    cast_columns,
    split_rows,
)
from navbake.baker.cracks import (
    Moved,
    find_columns,
    find_columns_at,
    find_columns_of_rows,
    move_lines,
)
from navbake.baker.lattice import Window
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_beside
from navbake.types import Int, Int32

# Columns of at most so many cells are kept: they take about 100 bytes each
KEPT_CELLS = 1 << 22
# Blocks that there are at a time: the one that is looked at, and the next one
ALIVE = 2


class ColumnBlocks:
    """The columns of a lattice: kept where they are few, else cast again for whoever asks.

    Of a large lattice, only the lines that were moved out of cracks are remembered, so that they
    are looked for once. It is all the same to who asks.

    Args:
        clock: times the casting.
    """

    def __init__(
        self, tiled: TiledShapes, agent: AgentSettings, crack: float, clock: StageClock
    ) -> None:
        self.lattice = tiled.lattice
        self._tiled, self._agent, self._crack, self._clock = tiled, agent, crack, clock
        self._moved: dict[Rows, Moved] = {}
        self._kept: Columns | None = None
        # the lines that were moved, where all columns are kept
        self.moved: Moved | None = None
        self._some: tuple[Int, Columns] | None = None  # the cells that were asked for last
        with clock.stage("columns"):
            if self.lattice.width * self.lattice.height <= KEPT_CELLS:
                self._kept, self.moved = find_columns(tiled, agent, crack)

    def blocks(self) -> Iterator[Columns]:
        """The columns of all rows, by bands of them, in their order.

        The next ones are found on another thread while the caller looks at those before them.
        The clock has only the time that the caller waits.
        """
        if self._kept is not None:
            yield self._kept
            return
        bands = self._bands()
        coming = run_beside(self._find, bands[0])
        for rows in [*bands[1:], None]:
            found = [self._wait(coming)]
            if rows is not None:
                coming = run_beside(self._find, rows)
            yield found.pop()  # nothing here holds it while the caller waits for the next one

    def _bands(self) -> list[Rows]:
        return split_rows(self.lattice, ALIVE)

    def _wait(self, found: Callable[[], Columns]) -> Columns:
        with self._clock.part("columns"):
            return found()

    def at(self, cells: Int | Int32) -> Columns:
        """Columns in which those of some cells are known, whatever the order of their ids."""
        if self._kept is not None:
            return self._kept
        if self._some is None or not np.isin(cells, self._some[0]).all():
            asked = np.unique(cells).astype(np.int64)
            with self._clock.part("columns"):
                self._some = asked, find_columns_at(self._tiled, self._all_moved(), asked)
        return self._some[1]

    def join(self, window: Window | None = None, lattice: Lattice | None = None) -> Columns:
        """All columns together, or those of a window, whose own lattice is given."""
        if window is None or lattice is None:
            window, lattice = self._whole_window(), self.lattice
        if self._kept is not None:
            return self._kept if lattice == self.lattice else self._kept.cut(*window, lattice)
        gathered = GatheredColumns(lattice)
        for columns in self.blocks():
            part = columns.cut(*window, lattice)
            gathered.add(part, part.known_rows)
        return gathered.join()

    def _whole_window(self) -> Window:
        return slice(0, self.lattice.height), slice(0, self.lattice.width)

    def _find(self, rows: Rows) -> Columns:
        if rows in self._moved:
            columns = cast_columns(self._tiled, rows).only_rows(rows)
            return move_lines(columns, self._tiled, self._moved[rows])
        columns, self._moved[rows] = find_columns_of_rows(
            self._tiled, self._agent, self._crack, rows
        )
        return columns

    def _all_moved(self) -> Moved:
        """All lines that were moved."""
        for rows in self._bands():
            if rows not in self._moved:
                self._find(rows)
        cells, offsets = zip(*(self._moved[rows] for rows in sorted(self._moved)), strict=True)
        return Moved(np.concatenate(cells), np.concatenate(offsets))
