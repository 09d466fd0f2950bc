"""The floor of each level: where one can stand, and how it grows under things."""

from __future__ import annotations

import numpy as np

from navbake.baker.blocks import Blocks, BlockTable, Seen, list_rows
from navbake.baker.column_blocks import list_once
from navbake.baker.floors.kernels import growth as kernels
from navbake.baker.floors.kernels.growth import Growing
from navbake.baker.floors.kernels.members import Labelled
from navbake.baker.floors.sheets import Sheets
from navbake.baker.floors.storeys import Placed
from navbake.baker.floors.surfaces import slopes_may_join
from navbake.config.settings import AgentSettings
from navbake.threads import LEAST_CELLS
from navbake.types import Bool, Float, Int, Int32

NO_CELLS = np.empty(0, dtype=np.int64)


class FloorGrowth:
    """The floors of all levels, and the links between them, kept up to date.

    Attributes:
        levels: of each, lowest first, `floor` and `ring` by cell, see `Growing`.
        links: see `Floors`.
        changed: the cells where the last update changed any floor, ascending; None where all may
            be new.
    """

    def __init__(self, sheets: Sheets, agent: AgentSettings) -> None:
        self._sheets, self._agent = sheets, agent
        self._by_slopes = slopes_may_join(sheets.lattice, agent)
        self._bars, self.links = Seen(sheets.blocks.num), np.empty((0, 4), dtype=np.int64)
        self._links = BlockTable(sheets.blocks.num, self.links)
        self._number = np.empty(0, dtype=np.int64)
        self.levels: list[tuple[Float, Int32]] = []
        self.changed: Int | None = None

    def update(self, placed: Placed, bars: Bool) -> None:
        """Find floors and links again.

        Args:
            placed: the surfaces on their levels.
            bars: the sheets at whose surfaces no floor grows, shape (sheets,), bool.
        """
        sheets, step = self._sheets, self._agent.traversable_floor_height
        stale = placed.changed | sheets.stale
        stale |= self._bars.differ(sheets.labels.count, bars[sheets.of_part])
        is_new = not np.array_equal(self._number, placed.number)
        is_new |= len(self.levels) != len(placed.grounds)
        if is_new:
            stale, self._number = sheets.blocks.all(), placed.number
            num = sheets.lattice.width * sheets.lattice.height
            self.levels = [(np.empty(num), np.empty(num, np.int32)) for _ in placed.grounds]
        found = [self._grow(k, placed, bars, stale, is_new) for k in range(len(self.levels))]
        self.changed = None if is_new else list_once(sheets.lattice, np.concatenate(found))
        self.links = self.links[:0]
        if len(self.levels) > 1 or self._by_slopes:
            near = np.flatnonzero(sheets.blocks.before(stale))
            asked = (placed.level, placed.number), step, self._by_slopes
            self._links.fill(kernels.list_links, near, sheets.lattice, sheets.surfaces, *asked)
            _, (links,) = self._links.take()
            self.links = links[np.lexsort(links.T[::-1])]

    def _grow(self, k: int, placed: Placed, bars: Bool, stale: Bool, is_new: bool) -> Int:
        """Grow the floor of a level again; returns the cells where its height changed.

        A region grows by the blocks around it until its outermost cells keep floors and rings.
        """
        sheets, agent, (floor, ring) = self._sheets, self._agent, self.levels[k]
        blocks = sheets.blocks
        growing = Growing(
            sheets.surfaces, placed.level, placed.number, k, agent.height,
            agent.traversable_floor_height, floor, ring,
            np.empty(len(sheets.surfaces.z), dtype=np.uint8),
        )  # fmt: skip
        asked, region = stale, stale.copy()
        cell = changed = np.empty(0, dtype=np.int64)
        was, was_in = np.empty(0), np.empty(0, dtype=np.int32)
        while asked.any():
            if not is_new:
                more = blocks.cells(asked)
                cell, was = np.append(cell, more), np.append(was, floor[more])
                was_in = np.append(was_in, ring[more])
            grow_in(blocks, region, growing, sheets.labelled(bars))
            is_other = was.view(np.int64) != floor[cell].view(np.int64)  # to the last bit
            changed, differs = cell[is_other], cell[is_other | (was_in != ring[cell])]
            asked = blocks.near(differs, 1) & ~region
            region |= asked
        return changed


def grow_in(blocks: Blocks, region: Bool, growing: Growing, labelled: Labelled) -> None:
    """Grow a floor in some blocks, from where one can stand and from what is around them."""
    ring, known, now = growing.ring, (blocks.lattice, growing), 1
    chosen = np.flatnonzero(region)
    _, (options,) = list_rows(kernels.stand, chosen, (NO_CELLS,), labelled, growing)
    cells = options
    while region.all() and len(cells) >= LEAST_CELLS:
        asked = cells, (NO_CELLS,), *known, now
        _, (cells,) = list_rows(kernels.grow_ring, *asked, least=LEAST_CELLS)
        now += 1
    rim = blocks.rim(region)
    rim = rim[ring[rim] > 0]
    kernels.grow(*known, now, cells, rim[np.argsort(ring[rim], kind="stable")])
    ring[options[ring[options] < -1]] = -1  # what the floor did not reach
