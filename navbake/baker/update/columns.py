"""The columns of a scene in which things move, kept so that some can be replaced."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.column_blocks import place_columns
from navbake.baker.columns import Columns, take_runs
from navbake.baker.kernels.arrays import Crossings
from navbake.types import Int, Int32

# The store has so many times the room that it needs at first
ROOM = 1.25


class KeptColumns:
    """The columns of a lattice, each a run of one store; see `ColumnSource`.

    A new column is written behind all others, and its cell points at it from then on (a
    log-structured store; Rosenblum and Ousterhout, 1992). The store is written anew when it is
    full.
    """

    def __init__(self, columns: Columns) -> None:
        self.lattice = columns.lattice
        self._cells = np.arange(self.lattice.width * self.lattice.height)
        self._fill(columns.crossings, 0)

    def _fill(self, crossings: Crossings, more: int) -> None:
        """Make the store, with room for `more` crossings at least."""
        self._first, self._counts = crossings.start[:-1].copy(), np.diff(crossings.start)
        self._used = len(crossings.z)
        room, self._arrays = int((self._used + more) * ROOM) + 100, list[NDArray[Any]]()
        for array in crossings[1:]:
            self._arrays.append(np.empty((room, *array.shape[1:]), dtype=array.dtype))
            self._arrays[-1][: self._used] = array

    def blocks(self) -> Iterator[Columns]:
        """All columns, in one block."""
        yield Columns(self.lattice, self.take(self._cells))

    def at(self, cells: Int | Int32) -> Columns:
        """Columns in which those of some cells are known, whatever the order of their ids."""
        asked = np.unique(cells).astype(np.int64)
        return place_columns(self.lattice, asked, self.take(asked))

    def take(self, cells: Int) -> Crossings:
        """The columns of some cells, ascending, numbered as these are."""
        return take_runs(self._arrays, self._first[cells], self._counts[cells])

    def put(self, cells: Int, crossings: Crossings) -> None:
        """Replace the columns of some cells, ascending; crossings are numbered as these are."""
        end = self._used + len(crossings.z)
        if end > len(self._arrays[0]):
            self._fill(self.take(self._cells), len(crossings.z))
            end = self._used + len(crossings.z)
        for array, new in zip(self._arrays, crossings[1:], strict=True):
            array[self._used : end] = new
        self._first[cells] = self._used + crossings.start[:-1]
        self._counts[cells], self._used = np.diff(crossings.start), end
