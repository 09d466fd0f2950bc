"""The sheets of surfaces that an agent can stand on, kept up to date where things move.

One large sheet is the floor that things move on. Beside it there are small ones, such as the tops
of furniture, and large ones, which are other floors, roofs and tops. A change is `NotLocal` where
it touches another large sheet, or where a small one might become large.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.floors.levels import Judged
from navbake.baker.floors.sheets import AreaTest, agent_limits
from navbake.baker.live.columns import LiveColumns
from navbake.baker.live.kernels import blocks as kernels
from navbake.baker.live.kernels.blocks import Blocks
from navbake.baker.live.kernels.pool import STANDABLE, gather_standable
from navbake.baker.live.kernels.regions import are_in, grow_cells, join_cells
from navbake.baker.live.kernels.sheets import (
    explore,
    group_parts,
    label_region,
    only_sheets,
)
from navbake.baker.live.not_local import NotLocal
from navbake.config.settings import BakeConfig
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int

# What a sheet is: none that counts, the floor that things move on, or another large one
SMALL, MAIN, OTHER = 0, 1, 2
# How many surfaces are visited at most to measure a small sheet, and to give all of it to another
MEASURED, UNITED = 20_000, 2_000_000
# Sheets are numbered anew when there are so many more numbers than were in use the last time
SPARE_NUMBERS = 4096
# So many blocks are worth a call on another thread
LEAST_BLOCKS = 8


class Grown(NamedTuple):
    """A small sheet that has grown, and the cells and places of what it got."""

    sheet: int
    cells: Int
    places: Int


class LiveSheets:
    """The sheet of each surface that an agent can stand on.

    Attributes:
        main: the number of the floor's sheet.
        test: whether cells are enough for a floor.
        needed: so many cells a floor has at least when it is shrunk.
        reach: how far shrinking reaches [cells].
        other_floor: the cells of the level that belong to other sheets.
        other_sizes: how many cells the other large sheets have.
        is_other: cells of other large sheets, (cells,) bool.
        near_other: cells where rules about these look at the floor, (cells,) bool.
    """

    def __init__(
        self, config: BakeConfig, judged: Judged, columns: Columns, live: LiveColumns
    ) -> None:
        """Take over the sheets of a bake; NotLocal where the floor hangs together otherwise.

        Args:
            judged: what was decided about sheets.
            columns: what they were found in.
            live: the same; gets the sheet of each surface.
        """
        self._live, self._step = live, agent_limits(config.agent).step
        self.test = AreaTest(live.lattice, config.floors)
        self.needed = int(np.ceil(max(self.test.needed, 0.0)))
        self.reach = int(np.ceil(config.floors.shrink / live.lattice.cell_size)) + 1
        self.main = int(np.argmax(judged.counted.sheet_size))
        stands = np.flatnonzero(live.pool.marks[: len(columns.z)] & STANDABLE)
        live.pool.sheet[stands] = judged.every.sheet
        self._mark = np.zeros(0, dtype=np.bool_)
        self._joined: list[Int] = []  # the cells where old surfaces joined or left the floor
        self._grown: list[Grown] = []
        self._note_sizes(judged)
        self._note_others(judged)
        lattice = live.lattice
        self._blocks = Blocks.empty(lattice.width, lattice.height)
        self._label_blocks(np.arange(lattice.width * lattice.height))
        if len(kernels.join_parts(lattice, self._blocks)[2]) != 1:
            raise NotLocal("the floor hangs together by other rules")

    def _note_sizes(self, judged: Judged) -> None:
        every, size = judged.every, judged.every.sheet_size
        num = len(size)
        kind = np.where(judged.large.sheet_size > 0, OTHER, SMALL).astype(np.uint8)
        kind[self.main] = MAIN
        self._kind, self._size, self._num = kind, size.copy(), num
        self._in_use = num  # numbers, when they were given the last time
        # of a small sheet at most so many cells are left when it is shrunk
        self._inner = self._size.copy()
        for sheet, members in every.members(np.flatnonzero((size >= self.needed) & (kind == 0))):
            self._inner[sheet] = np.count_nonzero(self.test.inner(every.cell[members]))

    def _note_others(self, judged: Judged) -> None:
        every, kind = judged.every, self._kind
        is_other = every.cell[kind[every.sheet] == OTHER]
        self.other_floor = judged.counted.cell[judged.counted.sheet != self.main]
        self.other_sizes = every.sheet_size[kind[: self._num] == OTHER]
        cells = len(self._live.pool.first)
        self.is_other = np.zeros(cells, dtype=np.bool_)
        self.is_other[is_other] = True
        # rules about these look so far around them, and a cell or two beyond
        self.near_other = np.zeros(cells, dtype=np.bool_)
        self.near_other[self.around(np.unique(is_other), 2 * self.reach + 4)] = True

    def around(self, cells: Int, by: int) -> Int:
        """Some cells and those at most so many rows and columns away, ascending."""
        lattice = self._live.lattice
        return np.asarray(
            grow_cells(lattice.width, lattice.height, cells, by, self._live.scratch.flag)
        )

    # ------------------------------------------------------------------ updates

    def forget(self, cells: Int) -> None:
        """Take the surfaces of some cells out of their sheets, before others are there."""
        _, _, place = gather_standable(self._live.pool, cells)
        np.subtract.at(self._size, self._live.pool.sheet[place], 1)

    def follow(self, changed: Int) -> Int:
        """Find the sheets of the new surfaces in changed cells.

        Returns:
            These cells, and all others where surfaces joined or left the floor, ascending.
        """
        self._joined, self._grown = [], []
        if self._num > 2 * self._in_use + SPARE_NUMBERS:
            self._number_anew()
        self._label(changed)
        self._cut_off_parts(changed)
        moved = [np.empty(0, dtype=np.int64), *self._joined]
        return np.asarray(join_cells(changed, np.unique(np.concatenate(moved))))

    def _label(self, changed: Int) -> None:
        live, pool = self._live, self._live.pool
        cells = self.around(changed, 2)
        start, z, place = gather_standable(pool, cells)
        part, num = label_region(live.lattice, cells, start, z, self._step, live.scratch.local)
        cell = np.repeat(cells, np.diff(start))
        sheet = pool.sheet[place]
        is_new, only = sheet < 0, only_sheets(part, sheet, num)
        has_new = np.bincount(part, is_new, num) > 0
        # most joins the floor alone, or one small sheet, or nothing: all at once
        extends = has_new & (only >= 0)
        if (self._kind[only[extends]] == OTHER).any():
            raise NotLocal("another floor, a top or a roof grows")
        joins = is_new & extends[part]
        to = only[part[joins]]
        pool.sheet[place[joins]] = to
        np.add.at(self._size, to, 1)
        alone = has_new & (only == -1)
        here = alone[part]
        self._add_sheets((np.cumsum(alone) - 1)[part[here]], cell[here], place[here])
        node, bounds = group_parts(part, num)
        grown = np.flatnonzero(extends & (only != self.main))
        to, is_large = only[grown], self._size[only[grown]] >= self.needed
        # nobody looks what is left of one that is still too small: all of it may be
        self._inner[to[~is_large]] = self._size[to[~is_large]]
        for k in grown[is_large].tolist():
            members = node[bounds[k] : bounds[k + 1]]
            members = members[is_new[members]]
            self._grown.append(Grown(int(only[k]), cell[members], place[members]))
        for k in np.flatnonzero(has_new & (only < -1)).tolist():
            members = node[bounds[k] : bounds[k + 1]]
            self._join(cell[members], place[members])
        self._check_grown()

    def _add_sheets(self, number: Int, cells: Int, places: Int) -> None:
        """Make sheets of surfaces, numbered from 0 on, that are too small for floors."""
        if not len(number):
            return
        size = np.bincount(number)
        for k in np.flatnonzero(size >= self.needed).tolist():
            if self.test.passes(cells[number == k]):
                raise NotLocal("a new surface is as large as a floor")
        first = self._make_room(len(size))
        new = slice(first, first + len(size))
        self._live.pool.sheet[places] = first + number
        self._kind[new], self._size[new] = SMALL, size
        # cells of one may count for another here, so that this is the most that may be left
        self._inner[new] = np.bincount(number, self.test.inner(cells))

    def _make_room(self, count: int) -> int:
        """Make room for some more sheets; gives the number of the first."""
        first, self._num = self._num, self._num + count
        if self._num > len(self._kind):  # twice as much, as copies take time
            wide = np.zeros(self._num, dtype=np.int64)
            self._kind = np.concatenate([self._kind, wide.astype(np.uint8)])
            self._size = np.concatenate([self._size, wide])
            self._inner = np.concatenate([self._inner, wide])
        return first

    def _number_anew(self) -> None:
        """Number the sheets that are left; else their arrays would grow with each update."""
        pool = self._live.pool
        _, _, place = gather_standable(pool, np.arange(len(pool.first)))
        sheet = pool.sheet[place]
        is_left = np.zeros(self._num, dtype=np.bool_)
        is_left[sheet[sheet >= 0]] = is_left[self.main] = True
        number = np.cumsum(is_left, dtype=np.int32) - 1
        pool.sheet[place[sheet >= 0]] = number[sheet[sheet >= 0]]
        self.main, left = int(number[self.main]), np.flatnonzero(is_left)
        self._kind, self._size = self._kind[left], self._size[left]
        self._inner, self._num, self._in_use = self._inner[left], len(left), len(left)

    def _join(self, cells: Int, places: Int) -> None:
        """Give the new surfaces of a part the sheet of the others."""
        pool = self._live.pool
        sheet = pool.sheet[places]
        is_new = sheet < 0
        known = np.unique(sheet[~is_new])
        if (self._kind[known] == OTHER).any():
            raise NotLocal("another floor, a top or a roof grows")
        to = self.main if self.main in known else int(known[np.argmax(self._size[known])])
        if to != self.main:
            # of several, cells at their seam may be left together, also far from what is new
            most = self._inner if len(known) == 1 else self._size
            self._inner[to] = most[known].sum()
            self._grown.append(Grown(to, cells[is_new], places[is_new]))
        pool.sheet[places[is_new]] = to
        self._size[to] += np.count_nonzero(is_new)
        for gone in known[known != to].tolist():
            own = sheet == gone
            self._unite(gone, to, cells[own], places[own])

    def _check_grown(self) -> None:
        """Make sure that small sheets that have grown, or become one, are too small for a floor.

        What is left of one when it is shrunk is at most what was left of it before, and what is
        left near the new surfaces, if all small sheets there were one. Where several become one,
        all of them may be left, and so may all of one that has fewer cells than a floor.
        """
        for one in self._grown:
            if self._size[one.sheet] < self.needed:
                self._inner[one.sheet] = self._size[one.sheet]
        grown = [one for one in self._grown if self._size[one.sheet] >= self.needed]
        near = [self.around(one.cells, self.reach) for one in grown]
        most = self._inner.copy()
        for one, cells in zip(grown, near, strict=True):
            most[one.sheet] += len(cells)
        asked = [one.cells for one in grown if most[one.sheet] >= self.needed]
        left = self._left_of_small(np.unique(np.concatenate(asked))) if asked else None
        for one, cells in zip(grown, near, strict=True):
            if left is None or most[one.sheet] < self.needed:
                self._inner[one.sheet] += len(cells)
            else:
                self._inner[one.sheet] += np.count_nonzero(are_in(cells, left))
        for one in grown:
            # what has joined another sheet since then is not measured with this one
            own = self._live.pool.sheet[one.places] == one.sheet
            if self._inner[one.sheet] >= self.needed and own.any():
                self._measure(one.sheet, one.cells[own], one.places[own])

    def _left_of_small(self, cells: Int) -> Int:
        """The cells that are left when all small sheets are shrunk, right within reach of some."""
        region = self.around(cells, 2 * self.reach)
        start, _, place = gather_standable(self._live.pool, region)
        is_small = self._kind[self._live.pool.sheet[place]] == SMALL
        column = np.repeat(region, np.diff(start))[is_small]
        small = column[np.flatnonzero(np.diff(column, prepend=-1))]
        left: Int = small[self.test.inner(small)]
        return left

    def _measure(self, sheet: int, cells: Int, places: Int) -> None:
        """Make sure that what hangs together with some surfaces of a sheet is too small."""
        is_all, cells, places = self._explore(cells, places, sheet, MEASURED)
        if not is_all or self.test.passes(cells):
            raise NotLocal("surfaces together may be as large as a floor")
        self._part_off(sheet, cells, places)

    def _part_off(self, sheet: int, cells: Int, places: Int) -> None:
        """Make a sheet of its own of surfaces that are too few for a floor."""
        number = self._make_room(1)
        self._kind[number], self._size[number] = SMALL, 0
        self._inner[number] = np.count_nonzero(self.test.inner(cells))
        self._move(sheet, number, cells, places)

    def _unite(self, gone: int, to: int, cells: Int, places: Int) -> None:
        """Give all surfaces of a sheet that hang together with some of them to another one."""
        is_all, cells, places = self._explore(cells, places, gone, UNITED)
        if not is_all:
            raise NotLocal("too much hangs together with what changes")
        self._move(gone, to, cells, places)

    def _explore(self, cells: Int, places: Int, sheet: int, most: int) -> tuple[bool, Int, Int]:
        live = self._live
        if len(self._mark) < len(live.pool.z):
            self._mark = np.zeros(len(live.pool.z), dtype=np.bool_)
        asked = live.lattice, live.pool, self._step, cells, places, sheet
        is_all, cells, places = explore(*asked, self._mark, most)
        return is_all, cells, places

    def _move(self, gone: int, to: int, cells: Int, places: Int) -> None:
        self._live.pool.sheet[places] = to
        self._size[gone] -= len(places)
        self._size[to] += len(places)
        if self.main in (gone, to):
            if self.near_other[cells].any():
                raise NotLocal("another floor, a top or a roof is near what joins the floor")
            self._joined.append(cells)

    # ------------------------------------------------------------------ whether the floor is whole

    def _cut_off_parts(self, changed: Int) -> None:
        """Find what was cut off from the floor, and make sheets of their own of it."""
        self._label_blocks(np.concatenate([changed, *self._joined]))
        first, whole, size = kernels.join_parts(self._live.lattice, self._blocks)
        largest = int(size.argmax()) if len(size) else 0
        cut_off = []
        for number in np.flatnonzero(np.arange(len(size)) != largest).tolist():
            found = self._live.lattice, self._blocks, first, whole, number
            cells: Int = kernels.cells_of_whole(*found)
            if len(cells) >= self.needed and self.test.passes(cells):
                raise NotLocal("a part of the floor is cut off")
            start, _, place = gather_standable(self._live.pool, cells)
            own = self._live.pool.sheet[place] == self.main
            self._part_off(self.main, np.repeat(cells, np.diff(start))[own], place[own])
            cut_off.append(cells)
        if cut_off:
            self._label_blocks(np.concatenate(cut_off))

    def _label_blocks(self, cells: Int) -> None:
        lattice, step = self._live.lattice, self._step
        own, around = kernels.list_blocks(lattice, cells)
        work = kernels.label_blocks, len(own), lattice, self._live.pool, self.main, step
        run_in_bands(*work, self._blocks, own, least=LEAST_BLOCKS)
        kernels.meet_at_borders(lattice, step, self._blocks, around)

    def floor_in(self, cells: Int) -> tuple[Float, Bool]:
        """The floor's heights in some cells [m], and whether it lies over another surface there."""
        start, z, place = gather_standable(self._live.pool, cells)
        is_floor = self._live.pool.sheet[place] == self.main
        column = np.repeat(cells, np.diff(start))
        is_over = is_floor.copy()
        is_over[:1] = False
        is_over[1:] &= column[1:] == column[:-1]
        return z[is_floor], is_over[is_floor]
