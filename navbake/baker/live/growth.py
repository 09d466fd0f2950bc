"""How the floor goes on under things, found again around what changed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.floors.levels import Judged, LevelFloor
from navbake.baker.live.columns import LiveColumns
from navbake.baker.live.kernels.grow import compare_floors, grow_parts, list_heights, regrow
from navbake.baker.live.kernels.pool import FLOOR_LIKE
from navbake.baker.live.kernels.regions import are_in, join_cells, label_cells
from navbake.baker.live.kernels.sheets import group_parts
from navbake.baker.live.not_local import NotLocal
from navbake.baker.live.sheets import LiveSheets
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int, Int32

# How far around changed cells floors are let go on again, in cells, as long as that is too near
REACHES = (3, 8, 20, 50)


class FloorChanges(NamedTuple):
    """The cells whose floor has changed, ascending.

    Attributes:
        heights: those whose floor has another height, or has one where there was none, or none.
        before: the floor that these had, NaN for none [m].
        standable: those where the floor became standable, or is no longer.
    """

    heights: Int
    before: Float
    standable: Int

    @classmethod
    def none(cls) -> FloorChanges:
        """No cells."""
        nothing = np.empty(0, dtype=np.int64)
        return cls(nothing, np.empty(0), nothing)

    def then(self, cells: Int, before: Float, standable: Int) -> FloorChanges:
        """These, and what changed after that; a cell may have changed to what it was."""
        heights, first = np.unique(np.concatenate([self.heights, cells]), return_index=True)
        values = np.concatenate([self.before, before])[first]
        return FloorChanges(heights, values, join_cells(self.standable, standable))


class Grown(NamedTuple):
    """How floors go on in a region, by its cells.

    Attributes:
        value: the floor, NaN for none [m].
        ring: 0 where one can stand, see `regrow`.
        has_height, has_shifted, moved: where `value`, whether one can stand, and `value` or `ring`
            is another.
    """

    value: Float
    ring: Int32
    has_height: Bool
    has_shifted: Bool
    moved: Bool


class FloorGrowth:
    """The floor of the one level, where one can stand and under things.

    Args:
        level: its arrays are written to.
        judged: what was decided about sheets.
        columns: what the floor was found in.
        live: the same.
        sheets: the sheet of each surface.
        step: the highest step of the agent [m].
    """

    def __init__(
        self,
        level: LevelFloor,
        judged: Judged,
        columns: Columns,
        live: LiveColumns,
        sheets: LiveSheets,
        step: float,
    ) -> None:
        self._level, self._live, self._sheets, self._step = level, live, sheets, step
        self._rings = self._find_rings(judged, columns)

    def _find_rings(self, judged: Judged, columns: Columns) -> Int32:
        """The ring in which each cell got its floor, 0 where one can stand; see `regrow`."""
        cells = np.arange(len(columns.start) - 1)
        standable, floor = self._level.standable.ravel(), self._level.floor.ravel()
        taken = (self._live.pool.marks[: len(columns.z)] & FLOOR_LIKE) > 0
        taken[taken] = judged.candidate
        taken &= ~standable[np.repeat(cells, np.diff(columns.start))]
        value = np.where(standable, floor, np.nan)
        rings = np.where(standable, 0, -1).astype(np.int32)
        start, height = list_heights(columns.start, columns.z, taken)
        asked = self._live.lattice, cells, start, height, self._step
        regrow(*asked, value, rings, floor, rings, self._live.scratch.local)
        if not np.array_equal(value, floor, equal_nan=True):
            raise NotLocal("floors go on under things by other rules")
        return rings

    def follow(self, changed: Int) -> FloorChanges:
        """Let the floor go on under things again, around cells that may have lost or got it.

        Where it comes out as it was at the edge of a region, nothing beyond it changes; the other
        regions are made larger.
        """
        found = FloorChanges.none()
        for reach in REACHES:
            cells = self._sheets.around(changed, reach)
            if self._sheets.is_other[cells].any():
                raise NotLocal("another floor, a top or a roof is near")
            part = label_cells(self._live.lattice, cells, self._live.scratch.local)
            new = self._grow(cells, part)
            inner = are_in(cells, self._sheets.around(changed, reach - 1))
            is_open = np.bincount(part, new.moved & ~inner) > 0
            done = ~is_open[part]
            here = cells[done]
            floor, stands = self._level.floor.reshape(-1), self._level.standable.reshape(-1)
            heights = cells[new.has_height & done]
            found = found.then(heights, floor[heights], cells[new.has_shifted & done])
            floor[here], self._rings[here] = new.value[done], new.ring[done]
            stands[here] = new.ring[done] == 0
            changed = changed[is_open[part[np.searchsorted(cells, changed)]]]
            if not len(changed):
                return found
        raise NotLocal("the floor under things changes far around")

    def _grow(self, cells: Int, part: Int) -> Grown:
        """Let the floor go on again in the parts of a region, which do not touch."""
        live, num = self._live, len(cells)
        order, bounds = group_parts(part, int(part.max()) + 1)
        value, ring = np.empty(num), np.empty(num, dtype=np.int32)
        floor = self._level.floor.reshape(-1)
        work = grow_parts, len(bounds) - 1, live.lattice, live.pool, self._sheets.main, self._step
        known = (cells, order, bounds), (floor, self._rings), live.scratch.local
        run_in_bands(*work, *known, (value, ring))
        grown = Grown(value, ring, *np.empty((3, num), dtype=np.bool_))
        was = floor, self._level.standable.reshape(-1), self._rings
        compare_floors(cells, value, ring, *was, *grown[2:])
        return grown
