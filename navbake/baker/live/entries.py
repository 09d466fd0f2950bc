"""What stands in the cells of a level, by bands of rows.

A band is never written to: one with a changed cell is replaced. So a grid that was handed out can
still read the names of what stood in its cells then.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.contents.contents import LevelContents, name_contents
from navbake.baker.contents.structure import FloorSupport
from navbake.baker.kernels.flags import BLOCKS, PROBED, STANDS
from navbake.baker.lattice import Window
from navbake.baker.live.kernels.contents import count_taken, measure_entries, replace_entries
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.user_data import Shared, UserData
from navbake.types import Bool, Float, Int, Int32

ROWS = 8  # of cells in a band


class Entries(NamedTuple):
    """The geoms of some cells, ragged as in `LevelContents`.

    Attributes:
        start: shape (cells + 1,), int64.
        geom: MuJoCo's geom ids, ascending in a cell, shape (n,), int32.
        flags: STANDS, BLOCKS and PROBED, shape (n,), uint8.
    """

    start: Int
    geom: Int32
    flags: NDArray[np.uint8]


class EntryBands:
    """The entries of all cells of a level.

    Attributes:
        taken: how many cells each body with a free joint takes, see `count_taken_cells`.
    """

    def __init__(
        self, listed: LevelContents, lattice: Lattice, free_body: Int, bodies: int
    ) -> None:
        """Take over the contents of a level.

        Args:
            free_body: the body with a free joint that each geom hangs on, -1 for none.
            bodies: how many bodies there are.
        """
        self._lattice, self._per_band = lattice, ROWS * lattice.width
        self._bands = _split(listed, self._per_band)
        self._free_body = free_body
        self.taken = np.zeros(bodies, dtype=np.int64)
        if (free_body >= 0).any():
            for band in self._bands:
                count_taken(band, np.arange(len(band.start) - 1), free_body, self.taken, 1)

    def replace(self, cells: Int, entries: Entries, marked: Bool) -> Int:
        """Put new entries of cells in place; marks their geoms, returns the cells that changed."""
        counted = (self._free_body >= 0).any()
        bands, changed = list(self._bands), []
        for number, own in self._by_band(cells):
            start = entries.start[own.start : own.stop + 1]
            here = slice(int(start[0]), int(start[-1]))
            new = start - start[0], entries.geom[here], entries.flags[here]
            local = cells[own] - number * self._per_band
            start, geom, flags, differs = replace_entries(bands[number], local, *new, marked)
            if not differs.any():
                continue
            changed.append(cells[own][differs])
            if counted:
                count_taken(bands[number], local[differs], self._free_body, self.taken, -1)
            bands[number] = Entries(start, geom, flags)
            if counted:
                count_taken(bands[number], local[differs], self._free_body, self.taken, 1)
        self._bands = bands
        return np.concatenate([np.empty(0, dtype=np.int64), *changed])

    def mark_geoms(self, cells: Int, marked: Bool) -> None:
        """Mark the geoms in some cells."""
        for number, own in self._by_band(cells):
            _, geom, _ = _take(self._bands[number], cells[own] - number * self._per_band)
            marked[geom] = True

    def measure(
        self,
        cells: Int,
        floor: Float,
        sizes: tuple[Float, Float],
        marked: Bool,
        measured: tuple[Float, Float, Int, Int],
    ) -> None:
        """Add what some cells tell of marked geoms; see `measure_entries`.

        Args:
            floor: of all cells [m].
            sizes: bottom and top of each geom [m].
        """
        for number, own in self._by_band(cells):
            first = number * self._per_band
            asked = self._bands[number], first, cells[own] - first
            measure_entries(*asked, floor, *sizes, marked, measured)

    def of(self, cells: Int, support: FloorSupport) -> LevelContents:
        """The contents of some cells, as those of a level with one row of cells."""
        taken = [
            _take(self._bands[number], cells[own] - number * self._per_band)
            for number, own in self._by_band(cells)
        ]
        line = self._lattice._replace(width=len(cells), height=1)
        return _to_level(_join(taken), line, support)

    def all(self, support: FloorSupport) -> LevelContents:
        """The contents of all cells."""
        return _to_level(_join(self._bands), self._lattice, support)

    def user_data(
        self,
        support: FloorSupport,
        kinds: NDArray[np.uint8],
        names: Sequence[str],
        window: Window,
    ) -> UserData:
        """See `Contents.user_data`: made when someone looks at it, of what there is now."""
        known = self._bands, self._lattice, support, kinds, names
        return UserData(partial(_name_bands, *known, window))

    def _by_band(self, cells: Int) -> list[tuple[int, slice]]:
        """Of ascending cells, each band's number and which of them are in it."""
        number = cells // self._per_band
        first = np.flatnonzero(np.diff(number, prepend=-1))
        ends = np.append(first[1:], len(cells))[: len(first)]
        pairs = zip(number[first].tolist(), first.tolist(), ends.tolist(), strict=True)
        return [(band, slice(begin, end)) for band, begin, end in pairs]


def _split(listed: LevelContents, per_band: int) -> list[Entries]:
    flags = np.where(listed.stands, STANDS, 0) | np.where(listed.blocks, BLOCKS, 0)
    flags = flags | np.where(listed.upper, PROBED, 0)
    bits: NDArray[np.uint8] = flags.astype(np.uint8)
    bands = []
    for first in range(0, len(listed.start) - 1, per_band):
        start = listed.start[first : first + per_band + 1]
        here = slice(int(start[0]), int(start[-1]))
        bands.append(Entries(start - start[0], listed.geom[here], bits[here]))
    return bands


def _take(band: Entries, cells: Int) -> Entries:
    counts = np.diff(band.start)[cells]
    start = np.concatenate([[0], np.cumsum(counts)])
    taken = np.repeat(band.start[cells] - start[:-1], counts) + np.arange(start[-1])
    return Entries(start, band.geom[taken], band.flags[taken])


def _join(bands: Sequence[Entries]) -> Entries:
    ends = np.cumsum([0, *(len(band.geom) for band in bands)])
    starts = [band.start[:-1] + end for band, end in zip(bands, ends, strict=False)]
    geom = np.concatenate([np.empty(0, dtype=np.int32), *(band.geom for band in bands)])
    flags = np.concatenate([np.empty(0, dtype=np.uint8), *(band.flags for band in bands)])
    return Entries(np.concatenate([*starts, ends[-1:]]), geom, flags)


def _to_level(entries: Entries, lattice: Lattice, support: FloorSupport) -> LevelContents:
    stands, blocks, upper = ((entries.flags & flag) > 0 for flag in (STANDS, BLOCKS, PROBED))
    return LevelContents(lattice, entries.start, entries.geom, stands, blocks, upper, support.geom)


def _name_bands(
    bands: Sequence[Entries],
    lattice: Lattice,
    support: FloorSupport,
    kinds: NDArray[np.uint8],
    names: Sequence[str],
    window: Window,
) -> Shared:
    return name_contents(_to_level(_join(bands), lattice, support), kinds, names, window)
