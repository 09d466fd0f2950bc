"""The columns of a whole scene, which may be too many to keep: found block by block, again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from navbake.baker.clock import StageClock
from navbake.baker.columns import (
    Columns,
    ColumnSource,
    GatheredColumns,
    Rows,
    TiledShapes,
    cast_columns,
    cast_points,
    split_rows,
    take_columns,
)
from navbake.baker.cracks import close_cracks
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.tiles import BAND
from navbake.baker.lattice import Window
from navbake.baker.seams import settle_seams
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

    It is all the same to who asks.

    Args:
        clock: times the casting.
    """

    def __init__(
        self, tiled: TiledShapes, agent: AgentSettings, crack: float, clock: StageClock
    ) -> None:
        self.lattice = tiled.lattice
        self._tiled, self._agent, self._crack, self._clock = tiled, agent, crack, clock
        self._kept: Columns | None = None
        self._some: tuple[Int, Columns] | None = None  # the cells that were asked for last
        with clock.stage("columns"):
            if self.lattice.width * self.lattice.height <= KEPT_CELLS:
                self._kept = self._find_all()

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
            asked = list_once(self.lattice, cells)
            with self._clock.part("columns"):
                self._some = asked, cast_at(self._tiled, self._agent, self._crack, asked)
        return self._some[1]

    def _find(self, rows: Rows) -> Columns:
        return self._close(cast_columns(self._tiled, rows).only_rows(rows))

    def _find_all(self) -> Columns:
        """The columns of all cells, found band by band for the memory that it takes."""
        bands = split_rows(self.lattice)
        if len(bands) == 1:
            return self._close(cast_columns(self._tiled))
        gathered = GatheredColumns(self.lattice)
        for rows in bands:
            gathered.add(self._find(rows), rows)
        return gathered.join()

    def _close(self, columns: Columns) -> Columns:
        columns = settle_seams(columns, self._tiled)
        return close_cracks(columns, self._tiled, self._agent, self._crack)


def join_columns(source: ColumnSource, window: Window, lattice: Lattice) -> Columns:
    """The columns of a window of a lattice together, whose own lattice is given."""
    gathered, is_whole = GatheredColumns(lattice), lattice == source.lattice
    for columns in source.blocks():
        if is_whole and columns.rows is None:
            return columns
        part = columns if is_whole else columns.cut(*window, lattice)
        gathered.add(part, part.known_rows)
    return gathered.join()


class WindowColumns(NamedTuple):
    """The columns of a window of another lattice, with a lattice of its own; a `ColumnSource`."""

    source: ColumnSource
    window: Window
    lattice: Lattice

    def blocks(self) -> Iterator[Columns]:
        """All columns, in one block."""
        yield join_columns(self.source, self.window, self.lattice)

    def at(self, cells: Int | Int32) -> Columns:
        """Columns in which those of some cells are known, whatever the order of their ids."""
        asked = list_once(self.lattice, cells)
        whole = self.outer(asked)
        return place_columns(
            self.lattice, asked, take_columns(self.source.at(whole).crossings, whole)
        )

    def outer(self, cells: Int) -> Int:
        """The ids that cells of the window have on the lattice that it is cut from."""
        row, col = np.divmod(cells, self.lattice.width)
        rows, cols = self.window
        found: Int = (row + rows.start) * self.source.lattice.width + col + cols.start
        return found


def list_once(lattice: Lattice, cells: Int | Int32) -> Int:
    """The ids of some cells, ascending, each once."""
    mask = np.zeros(lattice.width * lattice.height, dtype=np.bool_)
    mask[cells] = True
    return np.flatnonzero(mask)


def cast_at(tiled: TiledShapes, agent: AgentSettings, crack: float, cells: Int) -> Columns:
    """Cast the columns of some cells, ascending; others mean nothing."""
    lattice = tiled.lattice
    found = cast_points(tiled, cells, lattice.positions(*np.divmod(cells, lattice.width)))
    columns = place_columns(lattice, cells, found)
    columns = settle_seams(columns, tiled, cells)
    is_asked = np.zeros(len(columns.start) - 1, dtype=np.bool_)
    is_asked[cells] = True
    return close_cracks(columns, tiled, agent, crack, is_asked)


def place_columns(lattice: Lattice, cells: Int, crossings: Crossings) -> Columns:
    """Turn crossings listed per cell in `cells` (ascending ids) into columns indexed by cell id."""
    start = np.zeros(lattice.width * lattice.height + 1, dtype=np.int64)
    start[cells], start[cells + 1] = crossings.start[:-1], crossings.start[1:]
    rows = (0, 0) if not len(cells) else (cells[[0, -1]] // lattice.width).tolist()
    asked = Rows(rows[0] // BAND * BAND, min(rows[1] // BAND * BAND + BAND, lattice.height))
    return Columns(lattice, crossings._replace(start=start), asked)
