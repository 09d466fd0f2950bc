"""Sheets: the standable surfaces that steps join, and which of them are large enough for floors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from navbake.baker.blocks import Blocks, BlockTable, fit
from navbake.baker.connect import connect, ranges
from navbake.baker.floors.kernels import labels as kernels
from navbake.baker.floors.kernels.labels import JOINS, LIES, LINKS, Joining
from navbake.baker.floors.kernels.members import (
    AreaTest,
    Labelled,
    Members,
    disc_rows,
    find_large,
)
from navbake.baker.floors.kernels.surfaces import Surfaces
from navbake.baker.floors.surfaces import SurfaceStore, slopes_may_join
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int, Int32

NO_KEY = np.empty(0, dtype=np.int32)
# An empty array of rows that count, see `navbake.baker.floors.kernels.labels`
NO_ROWS, NO_HEIGHTS = np.empty((0, 4), dtype=np.int64), np.empty(0)
# Empty columns of `label_blocks`
NO_PARTS = np.empty((0, 8), dtype=np.int64), NO_HEIGHTS


class Labels:
    """The connected parts of surfaces in each block, numbered one block after the other.

    Attributes:
        part: the number of each surface's part in its block, -1 for none, int32.
        count, offset: how many parts each block has, and the number of its first, int64.
        measures, pairs: of the parts, see `label_blocks` and `list_pairs`.
    """

    def __init__(self, blocks: Blocks, joining: Joining) -> None:
        self.blocks, self._joining = blocks, joining
        self.part, self.count = NO_KEY, np.zeros(blocks.num, dtype=np.int64)
        self.measures = BlockTable(blocks.num, *NO_PARTS)
        self.pairs = BlockTable(blocks.num, NO_ROWS)

    def update(self, surfaces: Surfaces, stale: Bool, key: Int32 = NO_KEY) -> None:
        """Find the parts of stale blocks again; see `label_blocks` for the key."""
        self.part = fit(self.part, len(surfaces.z))
        chosen, near = np.flatnonzero(stale), np.flatnonzero(self.blocks.before(stale))
        asked = self.blocks.lattice, surfaces, key, self._joining, self.part
        self.count[chosen] = self.measures.fill(kernels.label_blocks, chosen, *asked)
        self.pairs.fill(kernels.list_pairs, near, *asked)
        self.offset = np.concatenate([[0], np.cumsum(self.count)])

    @property
    def block(self) -> Int:
        """The block of each part."""
        return np.repeat(np.arange(self.blocks.num), self.count)

    def merge(self) -> tuple[Int32, Int]:
        """The whole of each part, numbered by first parts; and the pairs of linked wholes.

        Each pair is there once, the lower number first, shape (2, m).
        """
        block, (rows,) = self.pairs.take()
        one, other, what, _ = rows.T
        step = np.array([0, 1, self.blocks.cols])[what % 3]
        pairs = np.stack([self.offset[block] + one, self.offset[block + step] + other])
        whole = connect(pairs[:, what // 3 == JOINS], int(self.offset[-1]))
        links = np.sort(whole[pairs[:, what // 3 == LINKS]], axis=0)
        links = links[:, links[0] != links[1]].astype(np.int64)
        if links.size:
            links = np.stack(np.divmod(np.unique(links[0] * len(whole) + links[1]), len(whole)))
        return whole, links


class Sheets:
    """All sheets of a scene, kept up to date; numbered by their first surfaces.

    Attributes:
        joining: what joins surfaces to sheets.
        now: the number of the update.
        last, last_near: in which update each block last had other surfaces, and when columns near
            it were last cast again, as far away as shrinking and edges look.
        of_part: the sheet of each part, shape (parts,), int32.
        key: an id of each sheet that stays while others come and go, int64, ascending.
        size: how many surfaces each has, int64.
        tops: over how many of these nothing lies.
        box: its first row and column, and past its last ones, shape (sheets, 4).
        low: its lowest height [m].
        digest: a hash of the sheet's surfaces, shape (sheets,), int64.
    """

    of_part: Int32
    key: Int
    size: Int
    tops: Int
    box: Int
    low: Float
    digest: Int

    def __init__(self, store: SurfaceStore, agent: AgentSettings) -> None:
        self.lattice, self.blocks, self.store = store.lattice, store.blocks, store
        by_slopes = slopes_may_join(store.lattice, agent)
        self.joining = Joining(agent.traversable_floor_height, by_slopes=by_slopes)
        self.labels = Labels(self.blocks, self.joining)
        self.now = 0
        self.last, self.last_near = np.zeros((2, self.blocks.num), dtype=np.int64)

    @property
    def surfaces(self) -> Surfaces:
        """The surfaces, as kernels take them."""
        return self.store.surfaces

    @property
    def stale(self) -> Bool:
        """The blocks with other surfaces than before this update."""
        stale: Bool = self.last == self.now
        return stale

    def update(self, stale: Bool, near: Bool, key: Int32 = NO_KEY) -> None:
        """Find the sheets again after surfaces in `stale` blocks changed.

        Args:
            near: the blocks near columns that were cast again, see `last_near`.
            key: see `label_blocks`.
        """
        surfaces, labels = self.surfaces, self.labels
        self.now += 1
        self.last[stale] = self.last_near[near] = self.now
        labels.update(surfaces, stale, key)
        _, (measures, low) = labels.measures.take()
        whole, _ = labels.merge()
        num = int(whole.max(initial=-1)) + 1
        together = np.argsort(whole, kind="stable")
        start, measures = np.searchsorted(whole[together], np.arange(num)), measures[together]
        sums, least, most = (
            op.reduceat(measures, start) for op in (np.add, np.minimum, np.maximum)
        )
        order = np.argsort(least[:, 2])
        self.of_part, self.key = np.argsort(order).astype(np.int32)[whole], least[order, 2]
        self.size, self.tops, _, self.digest = sums[order, :4].T
        self.box = np.hstack([least[order, 4:6], most[order, 6:]])
        self.low = np.minimum.reduceat(low[together], start)[order]

    def labelled(self, chosen: Bool) -> Labelled:
        """The surfaces with the numbers of their sheets, -1 for those that are not chosen."""
        sheet = np.where(chosen[self.of_part], self.of_part, np.int32(-1)).astype(np.int32)
        first, length, _, z, geom, *_ = self.surfaces
        return Labelled(self.lattice, first, length, z, geom, self.labels.part,
                        self.labels.offset, sheet)  # fmt: skip

    def sheet_at(self, block: Int, part: Int | Int32) -> Int32:
        sheet: Int32 = self.of_part[self.labels.offset[block] + part]
        return sheet

    def stacks(self) -> tuple[Int32, Int32, Int]:
        """Upper sheets, the ones next below, and in how many cells; pairs may repeat."""
        block, (rows,) = self.labels.pairs.take()
        lies = rows[:, 2] // 3 == LIES
        block, rows = block[lies], rows[lies]
        return self.sheet_at(block, rows[:, 0]), self.sheet_at(block, rows[:, 1]), rows[:, 3]

    def blocks_of(self, chosen: Bool) -> Bool:
        """The blocks that hold surfaces of chosen sheets."""
        mask = np.zeros(self.blocks.num, dtype=np.bool_)
        mask[self.labels.block[chosen[self.of_part]]] = True
        return mask

    def members(self, sheet: int, window: Sequence[int] | None = None) -> Members:
        """The surfaces of a sheet, all or those in a window: rows and columns as of `box`."""
        surfaces, width = self.surfaces, self.lattice.width
        row0, col0, row1, col1 = self.box[sheet].tolist() if window is None else window
        cells = np.add.outer(np.arange(row0, row1) * width, np.arange(col0, col1)).ravel()
        which, place = ranges(surfaces.first[cells], surfaces.first[cells] + surfaces.length[cells])
        some = np.flatnonzero(self.labels.part[place] >= 0)
        cell, place = cells[which[some]], place[some]
        own = self.sheet_at(self.blocks.of(cell), self.labels.part[place]) == sheet
        cell, place = cell[own], place[own]
        return Members(cell, surfaces.z[place], surfaces.geom[place], place)

    def between(self, chosen: Bool, low: float, high: float) -> Bool:
        """Which of the chosen sheets have a surface from a height up to below another one [m]."""
        found = np.zeros_like(chosen)
        for sheet in np.flatnonzero(chosen).tolist():
            z = self.members(sheet).z
            found[sheet] = ((low <= z) & (z < high)).any()
        return found

    def left(self, chosen: Bool, settings: FloorSettings) -> Bool:
        """Which of the chosen sheets are large enough for floors, see `area_test`; (sheets,).

        A sheet's cells are taken together over all heights.
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
    """The test of `min_area` after shrinking, which leaves centres `shrink` from the set's edge."""
    needed = int(np.ceil(max((settings.min_area - SLACK) / lattice.cell_size**2, 0.0)))
    limit = (settings.shrink - SLACK) / lattice.cell_size + 0.5
    half = disc_rows(limit, min(lattice.width, lattice.height))
    return AreaTest(needed, len(half) // 2, half)


def is_large(lattice: Lattice, settings: FloorSettings, marked: Bool) -> bool:
    """Whether the marked cells of a lattice are enough for a floor, see `area_test`."""
    test = area_test(lattice, settings)
    mask = np.pad(marked.reshape(lattice.shape), test.reach)
    left = np.flatnonzero(mask)
    for row, half in enumerate(test.half.tolist(), start=-test.reach):
        for col in range(-half, half + 1):
            left = left[mask.ravel()[left + row * mask.shape[1] + col]]
    return len(left) >= test.needed


@dataclass(frozen=True)
class Patch:
    """Surfaces that lie side by side, such as a sheet that is no floor.

    Attributes:
        geom: the geom that most of it belongs to.
        area: [m²].
        place: x, y, z of a place near its middle, in world coordinates [m].
        list_cells: lists `cells`, before the next update.
    """

    geom: int
    area: float
    place: tuple[float, float, float]
    list_cells: Callable[[], Int | Int32] = field(repr=False, compare=False)

    @property
    def cells(self) -> Int | Int32:
        """Its cells, shape (n,)."""
        return self.list_cells()


def describe_members(lattice: Lattice, members: Members) -> Patch:
    """Describe some surfaces, one at least."""
    row, col = np.divmod(members.cell, lattice.width)
    cells, area = members.cell.astype(np.int32), len(members.cell) * lattice.cell_size**2
    place = place_near(lattice, members, row.mean(), col.mean())
    return Patch(int(np.bincount(members.geom).argmax()), area, place, lambda: cells)


def place_near(
    lattice: Lattice, members: Members, row: float, col: float
) -> tuple[float, float, float]:
    """x, y, z of the surface nearest to a row and a column [m]."""
    rows, cols = np.divmod(members.cell, lattice.width)
    nearest = int(((rows - row) ** 2 + (cols - col) ** 2).argmin())
    x, y = lattice.center_x()[cols[nearest]], lattice.center_y()[rows[nearest]]
    return float(x), float(y), float(members.z[nearest])


class SheetFacts:
    """A cache of facts about single sheets, by their digests; what an update does not use goes."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, int], tuple[int, Any]] = {}
        self._kept: dict[tuple[str, int], tuple[int, Any]] = {}

    def begin(self, sheets: Sheets) -> None:
        """Begin an update."""
        self._kept, self._known, self._sheets = self._known, {}, sheets
        self._digests = sheets.digest.tolist()

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
            changed: for each sheet, the last update that changed anything else the fact depends
                on, shape (sheets,); None if it depends on the sheet alone.
        """
        if not chosen.any():
            return []
        asked, names = np.zeros_like(chosen), list[tuple[str, int]]()
        for sheet in np.flatnonzero(chosen).tolist():
            names.append((name, self._digests[sheet]))
            known = self._kept.get(names[-1])
            if known is None or (changed is not None and known[0] < changed[sheet]):
                asked[sheet] = True
            else:
                self._known[names[-1]] = known
        if asked.any():
            for sheet, fact in zip(np.flatnonzero(asked).tolist(), find(asked), strict=True):
                self._known[name, self._digests[sheet]] = self._sheets.now, fact
        return [self._known[one][1] for one in names]

    def mask(
        self, name: str, chosen: Bool, find: Callable[[Bool], Bool], changed: Int | None = None
    ) -> Bool:
        """The chosen sheets that a fact holds for; `find` returns a mask, shape (sheets,)."""
        result = np.zeros_like(chosen)
        result[chosen] = self.of(name, chosen, lambda asked: find(asked)[asked].tolist(), changed)
        return result

    def describe(self, chosen: Bool, spans: Sequence[tuple[float, float]] = ()) -> list[Patch]:
        """Describe chosen sheets, the largest first.

        Args:
            spans: of heights; if there are any, only surfaces in these are described [m].
        """

        def find(asked: Bool) -> list[Patch | None]:
            found: list[Patch | None] = []
            for members in map(self._sheets.members, np.flatnonzero(asked).tolist()):
                z = members.z
                if spans:
                    members = members.only(np.any([(z >= a) & (z < b) for a, b in spans], axis=0))
                is_some = len(members.z) > 0
                found.append(describe_members(self._sheets.lattice, members) if is_some else None)
            return found

        patches = self.of("patch of levels" if spans else "patch", chosen, find)
        return sorted(filter(None, patches), key=lambda patch: -patch.area)
