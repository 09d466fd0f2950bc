"""The floor of each level: where one can stand, and how it goes on under things."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.blocks import BlockTable, Seen, list_rows
from navbake.baker.floors.kernels import growth as kernels
from navbake.baker.floors.kernels.growth import Growing
from navbake.baker.floors.sheets import Sheets
from navbake.baker.floors.storeys import Placed
from navbake.baker.floors.surfaces import slopes_may_join
from navbake.baker.kernels.blocks import SIZE
from navbake.baker.lattice import Window
from navbake.config.settings import AgentSettings
from navbake.types import Bool, Float, Int, Int32

NO_OPTIONS = np.empty(0, dtype=np.int64), np.empty(0)


class Grown(NamedTuple):
    """The floor of a level; written to by updates.

    Attributes:
        floor: by cell [m]; NaN for none.
        ring: by cell: 0 where one can stand, 1 and up where the floor goes on, -1 for none.
    """

    floor: Float
    ring: Int32

    def differs(self, other: Grown) -> Bool:
        """Where floors or rings differ, to the last bit."""
        bits, others = (np.ascontiguousarray(grown.floor).view(np.int64) for grown in (self, other))
        return np.asarray((bits != others) | (self.ring != other.ring))


class FloorChanges(NamedTuple):
    """The cells of a level whose floor has changed, ascending.

    Attributes:
        heights: those whose floor has another height, or has one where there was none, or none.
        before: the floor that these had, NaN for none [m].
        standable: those where the floor became standable, or is no longer.
    """

    heights: Int
    before: Float
    standable: Int


class FloorGrowth:
    """The floors of all levels, and the links between them, kept up to date.

    Attributes:
        levels: lowest first.
        links: see `Floors`.
        changed: what the last update changed on each level; None where all may be new.
    """

    def __init__(self, sheets: Sheets, agent: AgentSettings) -> None:
        self._sheets, self._agent = sheets, agent
        self._by_slopes = slopes_may_join(sheets.lattice, agent)
        self._local = np.full(sheets.lattice.width * sheets.lattice.height, -1, dtype=np.int32)
        self._bars, self.links = Seen(sheets.blocks.num), np.empty((0, 4), dtype=np.int64)
        self._links = BlockTable(sheets.blocks.num, self.links)
        self._number = np.empty(0, dtype=np.int64)
        self.levels: list[Grown] = []
        self.changed: list[FloorChanges] | None = None

    def update(self, placed: Placed, bars: Bool) -> None:
        """Find floors and links again.

        Args:
            placed: the surfaces on their levels.
            bars: the sheets at whose surfaces no floor goes on, shape (sheets,), bool.
        """
        sheets, step = self._sheets, self._agent.traversable_floor_height
        stale = placed.changed | sheets.stale
        stale |= self._bars.differ(sheets.labels.count, bars[sheets.of_part])
        is_new = not np.array_equal(self._number, placed.number)
        is_new |= len(self.levels) != len(placed.grounds)
        if is_new:
            stale, self._number = sheets.blocks.all(), placed.number
            num = len(self._local)
            self.levels = [
                Grown(np.empty(num), np.empty(num, dtype=np.int32)) for _ in placed.grounds
            ]
        found = [self._grow(k, placed, bars, stale, is_new) for k in range(len(self.levels))]
        self.changed = [one for one in found if one] if not is_new else None
        self.links = self.links[:0]
        if len(self.levels) > 1 or self._by_slopes:
            near = np.flatnonzero(sheets.blocks.before(stale))
            asked = (placed.level, placed.number), step, self._by_slopes
            self._links.fill(kernels.list_links, near, sheets.lattice, sheets.surfaces, *asked)
            _, (links,) = self._links.take()
            self.links = links[np.lexsort(links.T[::-1])]

    def _grow(
        self, k: int, placed: Placed, bars: Bool, stale: Bool, is_new: bool
    ) -> FloorChanges | None:
        """Find the floor of a level again; returns what has changed, None where all is new.

        Where it comes out as it was at the edge of a region, nothing beyond it changes; else the
        blocks beyond that edge are looked at again, too.
        """
        sheets, agent, level = self._sheets, self._agent, self.levels[k]
        lattice, blocks = sheets.lattice, sheets.blocks
        growing = Growing(
            sheets.surfaces, placed.level, placed.number, k, agent.height,
            agent.traversable_floor_height, *level,
        )  # fmt: skip
        asked, region, before = stale, stale.copy(), list[tuple[Window, Grown]]()
        while asked.any():
            if not is_new:
                before += [(window, self._cut(level, window)) for window in blocks.windows(asked)]
            known = sheets.labelled(bars), growing
            _, (cell, height) = list_rows(
                kernels.list_options, np.flatnonzero(region), NO_OPTIONS, *known
            )
            start = np.append(np.flatnonzero(np.diff(cell, prepend=-1)), len(cell))
            cells = cell[start[:-1]]
            num = len(cells)
            room = np.empty((3, num), np.int64), np.zeros(num, np.bool_), np.empty(num)
            options = region, cells, start, height, growing.step
            kernels.grow(lattice, *options, *level, self._local, room)
            if is_new:
                return None
            asked = self._beyond(level, before) & ~region
            region |= asked
        # what has changed, in the order of cells
        found = [(np.empty(0, np.int64), np.empty(0), np.empty(0, np.int32))]
        for window, was in before:
            row, col = np.nonzero(was.differs(self._cut(level, window)))
            cell = (row + window[0].start) * lattice.width + col + window[1].start
            found.append((cell, was.floor[row, col], was.ring[row, col]))
        cell, floor, ring = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
        order = np.argsort(cell)
        cell, floor, ring = cell[order], floor[order], ring[order]
        is_other = floor.view(np.int64) != level.floor[cell].view(np.int64)
        is_flipped = (ring == 0) != (level.ring[cell] == 0)
        return FloorChanges(cell[is_other], floor[is_other], cell[is_flipped])

    def _cut(self, level: Grown, window: Window) -> Grown:
        shape = self._sheets.lattice.shape
        return Grown._make(array.reshape(shape)[window].copy() for array in level)

    def _beyond(self, level: Grown, before: list[tuple[Window, Grown]]) -> Bool:
        """The blocks beside borders at which floors or rings have changed."""
        blocks = self._sheets.blocks
        mask = np.zeros((blocks.rows + 2, blocks.cols + 2), dtype=np.bool_)
        for window, was in before:
            differs = was.differs(self._cut(level, window))
            row, col = (part.start // SIZE + 1 for part in window)
            mask[row, col - 1] |= differs[:, 0].any()
            mask[row, col + 1] |= differs[:, -1].any()
            mask[row - 1, col] |= differs[0].any()
            mask[row + 1, col] |= differs[-1].any()
        return mask[1:-1, 1:-1].ravel()
