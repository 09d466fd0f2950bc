"""Sheets: the standable surfaces that steps join, and which of them are large enough for floors."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.blocks import Blocks, Rows, gather_rows
from navbake.baker.floors.kernels.labels import list_stacks, measure_parts
from navbake.baker.floors.kernels.members import (
    Labelled,
    Shrinking,
    collect_members,
    count_left,
    find_nearest,
    mark_between,
    mark_members,
)
from navbake.baker.floors.kernels.shrink import east_rim, mark_inner, near_offsets
from navbake.baker.floors.kernels.surfaces import Surfaces
from navbake.baker.floors.labels import Joining, Labels
from navbake.baker.floors.surfaces import SurfaceStore, slopes_may_join
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int, Int32


class Members(NamedTuple):
    """Surfaces of sheets, in the order of their cells.

    Attributes:
        cell: ids, shape (n,), int64.
        z: heights [m].
        geom: MuJoCo's geom ids.
        place: where each is among the `Surfaces`.
    """

    cell: Int
    z: Float
    geom: Int32
    place: Int

    def only(self, kept: Bool) -> Members:
        """Those that are kept, shape (n,)."""
        return Members._make(array[kept] for array in self)


class Parts(NamedTuple):
    """What is known of the parts of sheets in blocks; arrays of one length.

    Attributes:
        size: how many surfaces each has.
        tops: over how many of them nothing lies.
        first_key: its first member: its cell and its place there.
        box: its first row and column, and past its last ones, shape (n, 4).
        digest: a number that tells its surfaces from others, uint64.
    """

    size: Int
    tops: Int
    first_key: Int
    box: Int32
    digest: NDArray[np.uint64]


class Sheets:
    """All sheets of a scene, kept up to date; numbered by their first surfaces.

    Attributes:
        of_part: the sheet of each part, shape (parts,), int32.
        key: tells each sheet from all others, also after others came and went, int64, ascending.
        size: how many surfaces each has, int64.
        tops: over how many of these nothing lies.
        over: how many of these lie over one of another sheet, see `measure_over`.
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
        nothing, ids = np.empty(0, dtype=np.int64), np.empty((0, 4), dtype=np.int32)
        digests = np.empty(0, dtype=np.uint64)
        self._parts = Rows(blocks.num, nothing, nothing, nothing, ids, digests)
        self._stacks = Rows(blocks.num, np.empty((0, 3), dtype=np.int32))
        self._keys = Rows(blocks.num, nothing)

    @property
    def surfaces(self) -> Surfaces:
        """The surfaces, as kernels take them."""
        return self.store.surfaces

    def update(self, stale: Bool) -> Bool:
        """Find the sheets again, of which the surfaces in stale blocks are others.

        Returns:
            The blocks with surfaces of other sheets than before, among them those that are stale.
        """
        lattice, surfaces, labels = self.lattice, self.surfaces, self.labels
        labels.update(surfaces, stale)
        chosen = np.flatnonzero(stale)
        counts = labels.count[chosen]
        offset = np.cumsum(counts) - counts
        num = int(counts.sum())
        size, tops, first_key = np.zeros((3, num), dtype=np.int64)
        box, digest = np.zeros((num, 4), dtype=np.int32), np.zeros(num, dtype=np.uint64)
        measured = size, tops, first_key, box, digest
        asked = lattice, surfaces, surfaces.z.view(np.int64), labels.part, chosen, offset, measured
        run_in_bands(measure_parts, len(chosen), *asked)
        self._parts.put(chosen, counts, *measured)
        known = lattice, surfaces, labels.part, chosen, labels.count
        self._stacks.put(chosen, *gather_rows(list_stacks, len(chosen), *known))
        self._merge()
        changed = self._keys.put_all(labels.count, self.key[self.of_part])
        return changed | stale

    def _merge(self) -> None:
        parts = Parts(*self._parts.take())
        whole, _ = self.labels.merge()
        num = int(whole.max(initial=-1)) + 1
        key = np.full(num, np.iinfo(np.int64).max)
        np.minimum.at(key, whole, parts.first_key)
        order = np.argsort(key)
        number = np.empty(num, dtype=np.int32)
        number[order] = np.arange(num, dtype=np.int32)
        self.of_part, self.key = number[whole], key[order]
        self.size, self.tops = (self.sum(values) for values in (parts.size, parts.tops))
        self.box = np.zeros((num, 4), dtype=np.int64)
        self.box[:, :2] = np.iinfo(np.int32).max
        np.minimum.at(self.box[:, :2], self.of_part, parts.box[:, :2])
        np.maximum.at(self.box[:, 2:], self.of_part, parts.box[:, 2:])
        self.digest = np.zeros(num, dtype=np.uint64)
        np.add.at(self.digest, self.of_part, parts.digest)

    def sum(self, values: Int) -> Int:
        """Sums by sheet of numbers that each part has, shape (sheets,)."""
        return np.bincount(self.of_part, values, len(self.key)).astype(np.int64)

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
        (rows,) = self._stacks.take()
        offset = np.repeat(self.labels.offset[:-1], self._stacks.counts())
        above, below = (self.of_part[offset + rows[:, k]] for k in (0, 1))
        return above, below, rows[:, 2].astype(np.int64)

    def blocks_of(self, chosen: Bool) -> Bool:
        """The blocks that hold surfaces of chosen sheets."""
        mask = np.zeros(self.blocks.num, dtype=np.bool_)
        mask[self.labels.block[chosen[self.of_part]]] = True
        return mask

    def members(self, sheet: int) -> Members:
        """The surfaces of a sheet."""
        chosen = np.zeros(len(self.key), dtype=np.bool_)
        chosen[sheet] = True
        window = tuple(self.box[sheet].tolist())
        return Members(*collect_members(self.labelled(chosen), window))

    def mask(self, sheet: int, margin: int) -> tuple[Bool, int, int]:
        """A sheet's cells in their own rectangle, with a margin; and its first row and column."""
        chosen = np.zeros(len(self.key), dtype=np.bool_)
        chosen[sheet] = True
        row0, col0, row1, col1 = window = tuple(self.box[sheet].tolist())
        mask = np.zeros((row1 - row0 + 2 * margin, col1 - col0 + 2 * margin), dtype=np.bool_)
        mark_members(self.labelled(chosen), window, margin, mask)
        return mask, row0 - margin, col0 - margin

    def between(self, low: float, high: float) -> Bool:
        """Which sheets have a surface from a height up to below another one [m]."""
        found = np.zeros(len(self.key), dtype=np.bool_)
        mark_between(self.labelled(np.ones_like(found)), low, high, found)
        return found

    def left(self, chosen: Bool, settings: FloorSettings) -> Bool:
        """Which of the chosen sheets are large enough for floors, see `AreaTest`; shape (sheets,).

        A sheet's cells are taken together over all heights. Each is looked at block by block, until
        enough cells are found.
        """
        result, test = np.zeros(len(self.key), dtype=np.bool_), AreaTest(self.lattice, settings)
        asked = np.flatnonzero(chosen & (self.size >= test.needed))
        if not len(asked):
            return result
        taken = np.isin(self.of_part, asked)
        sheet, block = self.of_part[taken], self.labels.block[taken]
        pairs = np.unique(sheet.astype(np.int64) * self.blocks.num + block)
        sheet, block = np.divmod(pairs, self.blocks.num)
        start = np.searchsorted(sheet, [*asked, len(self.key)])
        labelled = self.labelled(chosen)
        work = count_left, len(asked), labelled, self.box, asked, start, block, test.shrinking
        run_in_bands(*work, test.whole_needed, result)
        return result


@lru_cache(maxsize=4)  # several tests of a scene ask for the same, and so do scenes of a batch
def _list_near(limit: float, shorter: int) -> tuple[Int, Int]:
    """See `near_offsets` and `east_rim`; nobody changes them."""
    disc = near_offsets(limit, shorter)
    return disc, east_rim(disc)


class AreaTest:
    """Whether cells are enough for a floor: `min_area` after shrinking.

    Shrinking leaves the cells whose centres are at least `shrink` from the edge of the set.

    Attributes:
        needed: cells that have to be left after shrinking; smaller sets need no test.
        offsets: steps to the cells that have to be in the set around one that is left, and those
            that one further west does not know of, see `near_offsets` and `east_rim`.
    """

    def __init__(self, lattice: Lattice, settings: FloorSettings) -> None:
        self.needed = (settings.min_area - SLACK) / lattice.cell_size**2
        self._shape = lattice.width, lattice.height
        limit = (settings.shrink - SLACK) / lattice.cell_size + 0.5
        self.offsets = _list_near(limit, min(self._shape))

    @property
    def whole_needed(self) -> int:
        """`needed` as a whole number of cells."""
        return int(np.ceil(max(self.needed, 0.0)))

    @property
    def shrinking(self) -> Shrinking:
        """How sheets are shrunk, as kernels take it."""
        return Shrinking(int(np.abs(self.offsets[0]).max(initial=0)), *self.offsets)

    def passes(self, cells: Int | Int32) -> bool:
        """Whether a set of cells is large enough; ids may repeat, shape (n,)."""
        masks = np.zeros((2, self._shape[0] * self._shape[1]), dtype=np.bool_)
        inner, cells = np.zeros(len(cells), dtype=np.bool_), cells.astype(np.int32, copy=False)
        asked = *self._shape, self.whole_needed, *masks, inner
        return bool(mark_inner(cells, *self.offsets, *asked) >= self.whole_needed)


def middle_of(lattice: Lattice, cells: Int | Int32, z: Float) -> tuple[float, float, float]:
    """A place on a floor, of its cells the one nearest to its middle: world x, y, z [m].

    Args:
        cells, z: the floor's cells, and its height in each, shape (n,) [m].
    """
    row, col = np.divmod(cells, lattice.width)
    nearest = find_nearest(row, col, row.mean(), col.mean())
    x, y = lattice.center_x()[col[nearest]], lattice.center_y()[row[nearest]]
    return float(x), float(y), float(z[nearest])
