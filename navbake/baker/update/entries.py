"""What stands in the cells of a level, of which some can be replaced.

What was there before is never written over. So a grid that was handed out can still read the names
of what stood in its cells then: it keeps, for bands of rows, where the entries of each cell were.
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
from navbake.baker.update.kernels import contents as kernels
from navbake.baker.update.kernels.contents import Entries, EntryPool
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.user_data import Shared, UserData
from navbake.types import Bool, Float, Int, Int32

ROWS = 8  # of cells in a band
# A pool has so many times the room that it needs at first: what is replaced stays in it
ROOM = 2


class Places(NamedTuple):
    """Where in a pool the entries of a band of cells are; never written to."""

    first: Int
    length: Int32


class Snapshot(NamedTuple):
    """The entries of all cells as they are at a time.

    Attributes:
        bands: of the cells, in their order.
        geom, flags: of the pool; what the bands point at is never written again.
    """

    bands: list[Places]
    geom: Int32
    flags: NDArray[np.uint8]

    def all(self) -> Entries:
        """The entries of all cells."""
        first, length = map(np.concatenate, zip(*self.bands, strict=True))
        pool = EntryPool(first, length, self.geom, self.flags)
        entries: Entries = kernels.take_entries(pool, np.arange(len(first)))
        return entries


class LiveEntries:
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
        self._free_body, self._counts = free_body, bool((free_body >= 0).any())
        self.taken = np.zeros(bodies, dtype=np.int64)
        self._fill(_from_level(listed), 0)
        self._count(np.arange(len(listed.start) - 1), 1)

    def _fill(self, entries: Entries, more: int) -> None:
        """Make the pool, with room for `more` entries at least."""
        start, used = entries.start, len(entries.geom)
        room = ROOM * (used + more) + 10_000
        geom, flags = np.empty(room, dtype=np.int32), np.empty(room, dtype=np.uint8)
        geom[:used], flags[:used] = entries.geom, entries.flags
        self._pool = EntryPool(start[:-1].copy(), np.diff(start).astype(np.int32), geom, flags)
        self._used = used
        firsts = range(0, len(start) - 1, self._per_band)
        self._bands = [self._places_of(number) for number in range(len(firsts))]

    def _places_of(self, band: int) -> Places:
        own = slice(band * self._per_band, (band + 1) * self._per_band)
        return Places(self._pool.first[own].copy(), self._pool.length[own].copy())

    def _count(self, cells: Int, by: int) -> None:
        if self._counts:
            kernels.count_taken(self._pool, cells, self._free_body, self.taken, by)

    def replace(self, cells: Int, entries: Entries, marked: Bool) -> Int:
        """Put new entries of cells in place; marks their geoms, returns the cells that changed."""
        if self._used + len(entries.geom) > len(self._pool.geom):
            self._fill(self._take_all(), len(entries.geom))
        is_other = np.empty(len(cells), dtype=np.bool_)
        kernels.compare_entries(self._pool, cells, entries, is_other, marked)
        changed = cells[is_other]
        self._count(changed, -1)
        self._used = kernels.put_entries(self._pool, cells, entries, is_other, self._used)
        self._count(changed, 1)
        self._bands = list(self._bands)  # a snapshot has the last ones
        bands = changed // self._per_band
        for band in bands[np.flatnonzero(np.diff(bands, prepend=-1))].tolist():
            self._bands[band] = self._places_of(band)
        return changed

    def mark_geoms(self, cells: Int, marked: Bool) -> None:
        """Mark the geoms in some cells."""
        kernels.mark_geoms(self._pool, cells, marked)

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
        kernels.measure_entries(self._pool, cells, floor, *sizes, marked, measured)

    def of(self, cells: Int, support: FloorSupport) -> LevelContents:
        """The contents of some cells, as those of a level with one row of cells."""
        line = self._lattice._replace(width=len(cells), height=1)
        return _to_level(kernels.take_entries(self._pool, cells), line, support)

    def all(self, support: FloorSupport) -> LevelContents:
        """The contents of all cells."""
        return _to_level(self._take_all(), self._lattice, support)

    def _take_all(self) -> Entries:
        entries: Entries = kernels.take_entries(self._pool, np.arange(len(self._pool.first)))
        return entries

    def user_data(
        self,
        support: FloorSupport,
        kinds: NDArray[np.uint8],
        names: Sequence[str],
        window: Window,
    ) -> UserData:
        """See `Contents.user_data`: made when someone looks at it, of what there is now."""
        now = Snapshot(self._bands, self._pool.geom, self._pool.flags)
        return UserData(partial(_name_entries, now, self._lattice, support, kinds, names, window))


def _from_level(listed: LevelContents) -> Entries:
    flags = np.where(listed.stands, STANDS, 0) | np.where(listed.blocks, BLOCKS, 0)
    flags = flags | np.where(listed.upper, PROBED, 0)
    return Entries(listed.start, listed.geom, flags.astype(np.uint8))


def _to_level(entries: Entries, lattice: Lattice, support: FloorSupport) -> LevelContents:
    stands, blocks, upper = ((entries.flags & flag) > 0 for flag in (STANDS, BLOCKS, PROBED))
    return LevelContents(lattice, entries.start, entries.geom, stands, blocks, upper, support.geom)


def _name_entries(
    now: Snapshot,
    lattice: Lattice,
    support: FloorSupport,
    kinds: NDArray[np.uint8],
    names: Sequence[str],
    window: Window,
) -> Shared:
    return name_contents(_to_level(now.all(), lattice, support), kinds, names, window)
