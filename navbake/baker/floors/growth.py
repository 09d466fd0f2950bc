"""The floor of each level: where one can stand, and how it goes on under things."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.blocks import Rows, gather_rows
from navbake.baker.floors.kernels import growth as kernels
from navbake.baker.floors.kernels.growth import Growing
from navbake.baker.floors.sheets import Sheets
from navbake.baker.floors.storeys import Placed
from navbake.baker.floors.surfaces import slopes_may_join
from navbake.baker.kernels.blocks import SIZE
from navbake.baker.lattice import Window
from navbake.config.settings import AgentSettings
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int, Int32


class Grown(NamedTuple):
    """The floor of a level; written to by updates.

    Attributes:
        floor: by cell [m]; NaN for none.
        ring: by cell: 0 where one can stand, 1 and up where the floor goes on, -1 for none.
    """

    floor: Float
    ring: Int32


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

    links: Int

    def __init__(self, sheets: Sheets, agent: AgentSettings) -> None:
        self._sheets, self._agent = sheets, agent
        self._by_slopes = slopes_may_join(sheets.lattice, agent)
        self._local = np.full(sheets.lattice.width * sheets.lattice.height, -1, dtype=np.int32)
        self._seen = Rows(sheets.blocks.num, np.empty(0, dtype=np.bool_))
        self._links = Rows(sheets.blocks.num, np.empty((0, 4), dtype=np.int64))
        self._number = np.empty(0, dtype=np.int64)
        self.levels: list[Grown] = []
        self.changed: list[FloorChanges] | None = None

    def update(self, placed: Placed, bars: Bool, changed: Bool) -> None:
        """Find floors and links again.

        Args:
            placed: the surfaces on their levels.
            bars: the sheets at whose surfaces no floor goes on, shape (sheets,), bool.
            changed: the blocks with other surfaces than in the last update.
        """
        sheets = self._sheets
        stale = changed | placed.changed
        stale |= self._seen.put_all(sheets.labels.count, bars[sheets.of_part])
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
        self._find_links(placed, stale)

    def _grow(
        self, k: int, placed: Placed, bars: Bool, stale: Bool, is_new: bool
    ) -> FloorChanges | None:
        """Find the floor of a level again; returns what has changed, None where all is new.

        Where it comes out as it was at the edge of a region, nothing beyond it changes; else the
        blocks beyond that edge are looked at again, too.
        """
        sheets, agent, level = self._sheets, self._agent, self.levels[k]
        growing = Growing(
            sheets.surfaces, placed.level, placed.number, k, agent.height,
            agent.traversable_floor_height, *level,
        )  # fmt: skip
        labelled, region = sheets.labelled(bars), stale.copy()
        asked, before = stale, list[tuple[Window, Grown]]()
        while asked.any():
            if not is_new:
                for window in sheets.blocks.windows(asked):
                    before.append((window, self._cut(level, window)))
            blocks = np.flatnonzero(region)
            run_in_bands(kernels.write_standable, len(blocks), sheets.lattice, growing, blocks)
            cells, counts, heights = gather_rows(
                kernels.list_options, len(blocks), labelled, growing, blocks
            )
            start = np.concatenate([[0], np.cumsum(counts)])
            known = region, cells, start, heights, growing.step, *level, self._local
            kernels.grow(sheets.lattice, *known)
            if is_new:
                return None
            asked = self._beyond(level, before) & ~region
            region |= asked
        return self._list_changed(level, before)

    def _cut(self, level: Grown, window: Window) -> Grown:
        shape = self._sheets.lattice.shape
        return Grown._make(array.reshape(shape)[window].copy() for array in level)

    def _beyond(self, level: Grown, before: list[tuple[Window, Grown]]) -> Bool:
        """The blocks beside borders at which floors or rings have changed."""
        blocks = self._sheets.blocks
        mask = np.zeros((blocks.rows, blocks.cols), dtype=np.bool_)
        for window, was in before:
            now = self._cut(level, window)
            row, col = (part.start // SIZE for part in window)
            for down, right, line in (
                (0, 1, np.s_[:, -1]), (1, 0, np.s_[-1]), (0, -1, np.s_[:, 0]), (-1, 0, np.s_[0])
            ):  # fmt: skip
                r, c = row + down, col + right
                inside = 0 <= r < blocks.rows and 0 <= c < blocks.cols
                if inside and _differ(was, now)[line].any():
                    mask[r, c] = True
        return mask.ravel()

    def _list_changed(self, level: Grown, before: list[tuple[Window, Grown]]) -> FloorChanges:
        width = self._sheets.lattice.width
        cells, heights, flipped = [np.empty(0, dtype=np.int64)], [np.empty(0)], [np.empty(0, bool)]
        for window, was in before:
            now = self._cut(level, window)
            row, col = np.nonzero(_differ(was, now))
            cells.append((row + window[0].start) * width + col + window[1].start)
            heights.append(was.floor[row, col])
            flipped.append((was.ring[row, col] == 0) != (now.ring[row, col] == 0))
        cell, floor = np.concatenate(cells), np.concatenate(heights)
        is_flipped = np.concatenate(flipped)
        order = np.argsort(cell)
        cell, floor, is_flipped = cell[order], floor[order], is_flipped[order]
        is_other = floor.view(np.int64) != level.floor[cell].view(np.int64)
        return FloorChanges(cell[is_other], floor[is_other], cell[is_flipped])

    def _find_links(self, placed: Placed, stale: Bool) -> None:
        sheets, step = self._sheets, self._agent.traversable_floor_height
        if len(self.levels) > 1 or self._by_slopes:
            near = np.flatnonzero(sheets.blocks.before(stale))
            asked = placed.level, placed.number, step, self._by_slopes, near
            counts, rows = gather_rows(
                kernels.list_links, len(near), sheets.lattice, sheets.surfaces, *asked
            )
            self._links.put(near, counts, rows)
            (links,) = self._links.take()
            self.links = links[np.lexsort(links.T[::-1])]
        else:
            self.links = np.empty((0, 4), dtype=np.int64)


def _differ(one: Grown, other: Grown) -> Bool:
    """Where floors or rings differ, to the last bit."""
    bits, others = (np.ascontiguousarray(grown.floor).view(np.int64) for grown in (one, other))
    return np.asarray((bits != others) | (one.ring != other.ring))
