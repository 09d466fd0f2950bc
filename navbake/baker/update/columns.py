"""The columns of a scene in which things move, kept so that some can be replaced."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from navbake.baker.column_blocks import place_columns
from navbake.baker.columns import Columns, Rows, join_crossings, take_columns
from navbake.baker.kernels.arrays import Crossings
from navbake.types import Int, Int32

ROWS = 16  # of cells in a band, which is written anew when a column in it is replaced


class KeptColumns:
    """The columns of a lattice by bands of rows; see `ColumnSource`."""

    def __init__(self, columns: Columns) -> None:
        self.lattice = columns.lattice
        height, width = self.lattice.shape
        cells = np.arange(height * width)
        self._firsts = np.arange(0, height * width, ROWS * width)
        self._bands = [
            take_columns(columns.crossings, cells[first : first + ROWS * width])
            for first in self._firsts.tolist()
        ]

    def blocks(self) -> Iterator[Columns]:
        """The columns of all rows, by bands of them, in their order."""
        height, width = self.lattice.shape
        for first, band in zip(self._firsts.tolist(), self._bands, strict=True):
            start = np.zeros(height * width + 1, dtype=np.int64)
            start[first : first + len(band.start)] = band.start
            rows = Rows(first // width, min(first // width + ROWS, height))
            yield Columns(self.lattice, band._replace(start=start), rows)

    def at(self, cells: Int | Int32) -> Columns:
        """Columns in which those of some cells are known, whatever the order of their ids."""
        asked = np.unique(cells).astype(np.int64)
        return place_columns(self.lattice, asked, self.take(asked))

    def take(self, cells: Int) -> Crossings:
        """The columns of some cells, ascending, numbered as these are."""
        bounds = np.append(np.searchsorted(cells, self._firsts), len(cells))
        return join_crossings(
            [
                take_columns(self._bands[k], cells[bounds[k] : bounds[k + 1]] - self._firsts[k])
                for k in np.flatnonzero(np.diff(bounds)).tolist()
            ]
        )

    def put(self, cells: Int, crossings: Crossings) -> None:
        """Replace the columns of some cells, ascending; crossings are numbered as these are."""
        bounds = np.append(np.searchsorted(cells, self._firsts), len(cells))
        for k in np.flatnonzero(np.diff(bounds)).tolist():
            own = np.arange(bounds[k], bounds[k + 1])
            band = self._bands[k]
            both = join_crossings([band, take_columns(crossings, own)])
            place = np.arange(len(band.start) - 1)
            place[cells[own] - self._firsts[k]] = len(place) + np.arange(len(own))
            self._bands[k] = take_columns(both, place)
