"""Sheets: the standable surfaces that steps join, and which of them are large enough for floors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.blocks import Blocks, BlockTable
from navbake.baker.floors.kernels.labels import list_stacks, measure_parts
from navbake.baker.floors.kernels.members import (
    Labelled,
    Members,
    fill_members,
    find_large,
    mark_between,
)
from navbake.baker.floors.kernels.shrink import AreaTest, count_left, east_rim, near_offsets
from navbake.baker.floors.kernels.surfaces import Surfaces
from navbake.baker.floors.labels import NO_ROWS, Joining, Labels
from navbake.baker.floors.surfaces import SurfaceStore, slopes_may_join
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Bool, Int, Int32


class Sheets:
    """All sheets of a scene, kept up to date; numbered by their first surfaces.

    Attributes:
        now: the number of the update.
        last: in which update each block last had other surfaces.
        of_part: the sheet of each part, shape (parts,), int32.
        key: tells each sheet from all others, also after others came and went, int64, ascending.
        size: how many surfaces each has, int64.
        tops: over how many of these nothing lies.
        box: its rows and columns, shape (sheets, 4).
        digest: changes with the sheet's surfaces, shape (sheets,), uint64.
    """

    of_part: Int32
    key: Int
    size: Int
    tops: Int
    box: Int
    digest: NDArray[np.uint64]

    def __init__(self, store: SurfaceStore, blocks: Blocks, agent: AgentSettings) -> None:
        self.lattice, self.blocks, self.store = store.lattice, blocks, store
        by_slopes = slopes_may_join(store.lattice, agent)
        self.labels = Labels(blocks, Joining(agent.traversable_floor_height, by_slopes=by_slopes))
        nothing, boxes = np.empty(0, dtype=np.int64), np.empty((0, 4), dtype=np.int64)
        digests = np.empty(0, dtype=np.uint64)
        self._parts = BlockTable(blocks.num, nothing, nothing, nothing, boxes, digests)
        self._stacks = BlockTable(blocks.num, NO_ROWS)
        self.now, self.last = 0, np.zeros(blocks.num, dtype=np.int64)

    @property
    def surfaces(self) -> Surfaces:
        """The surfaces, as kernels take them."""
        return self.store.surfaces

    @property
    def stale(self) -> Bool:
        """The blocks with other surfaces than before this update."""
        stale: Bool = self.last == self.now
        return stale

    def update(self, stale: Bool) -> None:
        """Find the sheets again, of which the surfaces in stale blocks are others."""
        lattice, surfaces, labels = self.lattice, self.surfaces, self.labels
        self.now += 1
        self.last[stale] = self.now
        labels.update(surfaces, stale)
        chosen, bits = np.flatnonzero(stale), surfaces.z.view(np.int64)
        asked = lattice, surfaces, bits, labels.part, labels.count
        self._parts.fill(measure_parts, chosen, *asked)
        self._stacks.fill(list_stacks, chosen, lattice, surfaces, labels.part)
        _, (size, tops, first_key, box, digest) = self._parts.take()
        whole, _ = labels.merge()
        num = int(whole.max(initial=-1)) + 1
        key = np.full(num, np.iinfo(np.int64).max)
        np.minimum.at(key, whole, first_key)
        order = np.argsort(key)
        number = np.empty(num, dtype=np.int32)
        number[order] = np.arange(num, dtype=np.int32)
        self.of_part, self.key = number[whole], key[order]
        self.size, self.tops = (
            np.bincount(self.of_part, values, num).astype(np.int64) for values in (size, tops)
        )
        self.box = np.zeros((num, 4), dtype=np.int64)
        self.box[:, :2] = np.iinfo(np.int64).max
        np.minimum.at(self.box[:, :2], self.of_part, box[:, :2])
        np.maximum.at(self.box[:, 2:], self.of_part, box[:, 2:])
        self.digest = np.zeros(num, dtype=np.uint64)
        np.add.at(self.digest, self.of_part, digest)

    def labelled(self, chosen: Bool) -> Labelled:
        """The surfaces with the numbers of their sheets, -1 for those that are not chosen."""
        sheet = np.where(chosen[self.of_part], self.of_part, np.int32(-1)).astype(np.int32)
        first, length, _, z, geom, *_ = self.surfaces
        return Labelled(self.lattice, first, length, z, geom, self.labels.part,
                        self.labels.offset, sheet)  # fmt: skip

    def stacks(self) -> tuple[Int32, Int32, Int]:
        """Which sheets lie over which: the upper one, the lower one, and in how many cells.

        Those cells are counted in which nothing that one can stand on lies in between; a pair may
        be listed several times.
        """
        block, (rows,) = self._stacks.take()
        above, below = (self.of_part[self.labels.offset[block] + rows[:, k]] for k in (0, 1))
        return above, below, rows[:, 3]

    def blocks_of(self, chosen: Bool) -> Bool:
        """The blocks that hold surfaces of chosen sheets."""
        mask = np.zeros(self.blocks.num, dtype=np.bool_)
        mask[self.labels.block[chosen[self.of_part]]] = True
        return mask

    def members(self, sheet: int) -> Members:
        """The surfaces of a sheet."""
        chosen, num = np.arange(len(self.key)) == sheet, int(self.size[sheet])
        ids, heights = (np.empty((2, num), dtype) for dtype in (np.int64, np.float64))
        members = Members(ids[0], heights[0], np.empty(num, dtype=np.int32), ids[1])
        fill_members(self.labelled(chosen), tuple(self.box[sheet].tolist()), members)
        return members

    def between(self, low: float, high: float) -> Bool:
        """Which sheets have a surface from a height up to below another one [m]."""
        found = np.zeros(len(self.key), dtype=np.bool_)
        mark_between(self.labelled(np.ones_like(found)), low, high, found)
        return found

    def left(self, chosen: Bool, settings: FloorSettings) -> Bool:
        """Which of the chosen sheets are large enough for floors, see `area_test`; (sheets,).

        A sheet's cells are taken together over all heights. Each is looked at block by block, until
        enough cells are found.
        """
        result, test = np.zeros(len(self.key), dtype=np.bool_), area_test(self.lattice, settings)
        asked = np.flatnonzero(chosen & (self.size >= test.needed))
        taken = np.isin(self.of_part, asked)
        pairs = self.of_part[taken].astype(np.int64) * self.blocks.num + self.labels.block[taken]
        sheet, block = np.divmod(np.unique(pairs), self.blocks.num)
        start = np.searchsorted(sheet, [*asked, len(self.key)])
        work = self.labelled(chosen), self.box, asked, start, block, test, result
        run_in_bands(find_large, len(asked), *work)
        return result


def area_test(lattice: Lattice, settings: FloorSettings) -> AreaTest:
    """Whether cells are enough for a floor: `min_area` after shrinking.

    Shrinking leaves the cells whose centres are at least `shrink` from the edge of the set.
    """
    needed = int(np.ceil(max((settings.min_area - SLACK) / lattice.cell_size**2, 0.0)))
    limit = (settings.shrink - SLACK) / lattice.cell_size + 0.5
    disc = near_offsets(limit, min(lattice.width, lattice.height))
    return AreaTest(needed, int(np.abs(disc).max(initial=0)), disc, east_rim(disc))


def is_large(lattice: Lattice, settings: FloorSettings, cells: Int | Int32) -> bool:
    """Whether a set of cells is large enough for a floor, see `area_test`; ids may repeat."""
    test = area_test(lattice, settings)
    if not len(cells):
        return test.needed == 0
    row, col = np.divmod(cells, lattice.width)
    low = row.min(), col.min()
    shape = row.max() - low[0] + 1 + 2 * test.reach, col.max() - low[1] + 1 + 2 * test.reach
    mask = np.zeros(shape, dtype=np.bool_)
    mask[row - low[0] + test.reach, col - low[1] + test.reach] = True
    return bool(count_left(mask, test, test.needed) >= test.needed)


class SheetFacts:
    """Facts about single sheets that are dear to find.

    A fact holds as long as its sheet has the same surfaces, and nothing that it rests on changed.
    Those that were not asked for in an update are forgotten.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[str, int], tuple[int, Any]] = {}
        self._kept: dict[tuple[str, int], tuple[int, Any]] = {}

    def begin(self, sheets: Sheets) -> None:
        """Begin an update."""
        self._kept, self._known = self._known, {}
        self._digests, self._now = sheets.digest.tolist(), sheets.now

    def of(
        self,
        name: str,
        chosen: Bool,
        find: Callable[[Bool], list[Any]],
        changed: Int | None = None,
    ) -> list[Any]:
        """A fact about each chosen sheet, in their order.

        Args:
            name: of the fact.
            chosen: the sheets, shape (sheets,), bool.
            find: finds the fact about some sheets, in their order.
            changed: the update in which what the fact rests on beside the sheet last changed, by
                sheet; None where that is nothing.
        """
        asked, sheets = np.zeros_like(chosen), np.flatnonzero(chosen).tolist()
        for sheet in sheets:
            known = self._kept.get((name, self._digests[sheet]))
            if known is None or (changed is not None and known[0] < changed[sheet]):
                asked[sheet] = True
            else:
                self._known[name, self._digests[sheet]] = known
        if asked.any():
            for sheet, fact in zip(np.flatnonzero(asked).tolist(), find(asked), strict=True):
                self._known[name, self._digests[sheet]] = self._now, fact
        return [self._known[name, self._digests[sheet]][1] for sheet in sheets]

    def mask(
        self, name: str, chosen: Bool, find: Callable[[Bool], Bool], changed: Int | None = None
    ) -> Bool:
        """Which of the chosen sheets a fact is true of, as `find` returns it, shape (sheets,)."""
        result = np.zeros_like(chosen)
        result[chosen] = self.of(name, chosen, lambda asked: find(asked)[asked].tolist(), changed)
        return result
