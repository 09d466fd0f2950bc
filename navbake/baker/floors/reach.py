"""Reach: where agents start, what no step leads to, and floors inside of closed meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from navbake.baker.blocks import Blocks, BlockTable
from navbake.baker.connect import ranges
from navbake.baker.floors.kernels.members import Members, weigh
from navbake.baker.floors.outline import DROP, Site, beside
from navbake.baker.floors.rejected import LARGE_TOP
from navbake.baker.floors.sheets import Patch, Sheets, describe_members, place_near
from navbake.baker.floors.storeys import Placed
from navbake.baker.floors.surfaces import find_near
from navbake.baker.kernels.constants import SLACK, TOUCH
from navbake.baker.kernels.overlap import lines_blocked
from navbake.baker.kernels.tiles import SIZE
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.errors import SceneError
from navbake.threads import run_in_bands
from navbake.types import Bool, Int

# A position that is at most this far from a surface lies on it, furniture or not [m]
ON_SURFACE = 0.02
# The least sheet that is reported as unreached on a level that is reached: shafts and niches are
# smaller [m²]
TOLD_AREA = 6.0
# A level is a void where this share of it, or more, has less headroom than an adult needs [m]
NEARLY_ALL, UPRIGHT = 0.9, 1.8
# A floor in a closed mesh that continues outside, beyond this share of its outline, only carries it
GOES_ON = 0.25
# Unless it is as large as a building [m²]
BUILDING = 50.0


@dataclass(frozen=True)
class Unreached:
    """The floors of a level that no step leads to from the starts.

    Attributes:
        level: its number.
        patch: the floors there, all together; the place is on the largest.
        whole: whether no floor of the level is reached.
    """

    level: int
    patch: Patch
    whole: bool


def find_starts(site: Site, tops: Bool, shelves: Bool, positions: list[list[float]]) -> Bool:
    """Find the sheets on which agents start, at some positions.

    A position within 2 cm of a surface lies on it. Any other is on the highest floor of its column
    that is at most a step higher. Roofs, and tops of at least 6 m², are floors here. Above
    furniture it is on the floor to which that drops along most of its outline, or on the furniture
    if there is none.

    Args:
        tops, shelves: the sheets that are floors only where an agent starts.
        positions: `floors.from`, x, y, z of each [m].

    Returns:
        Which sheets they are, shape (sheets,), bool.

    Raises:
        SceneError: there is no floor at a position.
    """
    sheets, step = site.sheets, site.agent.traversable_floor_height
    surfaces, lattice, is_large = sheets.surfaces, sheets.lattice, site.is_large
    is_small = sheets.size * lattice.cell_size**2 < LARGE_TOP
    counts = is_large & ~shelves & ~(tops & is_small)
    starts = np.zeros(len(is_large), dtype=np.bool_)
    for number, (x, y, z) in enumerate(positions):
        row, col = (int(i) for i in lattice.rows_cols([x, y]))
        here = np.empty(0, dtype=np.int64)
        if 0 <= row < lattice.height and 0 <= col < lattice.width:
            here = sheets.store.at(row * lattice.width + col)
            here = here[sheets.labels.part[here] >= 0]
        heights, block = surfaces.z[here], sheets.blocks.of(here * 0 + row * lattice.width + col)
        found = sheets.sheet_at(block, sheets.labels.part[here])
        below = found[heights <= z + step + SLACK]
        if not len(below):
            there = ", ".join(f"{height:.2f}" for height in heights)
            raise SceneError(
                f"no floor at `floors.from[{number}]` ({x:g}, {y:g}, {z:g}): expected one that "
                f"an agent can stand on, at most a step higher; "
                + (f"floors there are at {there} m" if there else "there is none in that cell")
            )
        exactly = found[abs(heights - z) <= ON_SURFACE + SLACK]
        floors = below[counts[below]]
        if len(exactly) or len(floors):
            starts[(exactly if len(exactly) else floors)[-1]] = True
        else:
            starts[_floor_beside(site, counts, int(below[-1]))] = True
    return starts


def _floor_beside(site: Site, counts: Bool, furniture: int) -> int:
    """The floor that a sheet of furniture drops to along most of its outline, else itself."""
    is_thing = np.arange(len(counts)) == furniture
    endings = site.endings(site.edges_of(is_thing, site.reach, among=counts | is_thing))
    floors = endings.floor[endings.kind == DROP]
    return int(np.bincount(floors).argmax()) if len(floors) else furniture


def largest_of_lowest(counts: Int, num_sheets: int) -> Bool:
    """The sheet with the largest floor on the lowest level, as a mask, shape (sheets,).

    Args:
        counts: rows of sheet, level and how many surfaces it has there; they may repeat.
    """
    sheet, _, count = counts[counts[:, 1] == counts[:, 1].min()].T
    largest: Bool = np.arange(num_sheets) == np.bincount(sheet, count).argmax()
    return largest


class Upright:
    """How many surfaces of each part of a block nobody can stand upright on; kept up to date.

    Attributes:
        stale: the blocks in which columns have changed, shape (blocks,); written to.
    """

    def __init__(self, blocks: Blocks) -> None:
        self._low, self._counts = np.empty(0, dtype=np.int64), np.zeros(blocks.num, np.int64)
        self.stale = blocks.all()

    def count_low(self, site: Site) -> Int:
        """How many surfaces of each sheet something hangs over, lower than an adult needs."""
        sheets, labels, surfaces = site.sheets, site.sheets.labels, site.sheets.surfaces
        stale, self.stale = self.stale, np.zeros_like(self.stale)
        low = np.zeros(int(labels.offset[-1]), dtype=np.int64)
        low[np.repeat(~stale, labels.count)] = self._low[np.repeat(~stale, self._counts)]
        cells = sheets.blocks.cells(stale)
        which, place = ranges(surfaces.first[cells], surfaces.first[cells] + surfaces.length[cells])
        stands = labels.part[place] >= 0
        cell, place = cells[which[stands]], place[stands]
        band = surfaces.z[place] + site.agent.height - TOUCH, surfaces.z[place] + UPRIGHT
        is_low, crossings = np.zeros(len(cell), dtype=np.bool_), site.columns.at(cell).crossings
        run_in_bands(lines_blocked, len(cell), cell, *band, crossings, is_low, least=1000)
        part = labels.offset[sheets.blocks.of(cell[is_low])] + labels.part[place[is_low]]
        low += np.bincount(part, minlength=len(low))
        self._low, self._counts = low, labels.count.copy()
        return np.bincount(sheets.of_part, low, len(sheets.key)).astype(np.int64)


def find_voids(
    site: Site, upright: Upright, counts: Int, reached: Bool, is_given: bool
) -> tuple[Bool, Bool]:
    """Find the levels that no step reaches and in which nobody can stand upright.

    Args:
        upright: of the same surfaces.
        counts: rows of sheet, level and how many surfaces it has there; they may repeat.
        reached: which sheets are reached, shape (sheets,), bool.
        is_given: whether `floors.from` gives the starts; else that is the lowest level that is no
            void.

    Returns:
        Which sheets are reached, and which are those of voids.
    """
    (sheet, level, _), voids = counts.T, np.zeros_like(reached)
    levels = np.unique(level)
    if np.isin(levels, level[reached[sheet]]).all():
        return reached, voids

    low = upright.count_low(site)

    def share_of(number: int) -> float:
        own = np.unique(sheet[level == number])
        return float(low[own].sum() / site.sheets.size[own].sum())

    low_levels = [n for n in levels.tolist() if share_of(n) >= NEARLY_ALL]
    if not is_given and len(low_levels) < len(levels):
        reached = largest_of_lowest(counts[~np.isin(level, low_levels)], len(reached))
    is_void = np.isin(level, low_levels) & ~np.isin(level, level[reached[sheet]])
    voids[sheet[is_void]] = True
    voids[sheet[~is_void]] = False
    return reached, voids


class UnreachedFloors:
    """Finds the floors that no step leads to; keeps sums over the surfaces of each block."""

    def __init__(self, blocks: Blocks) -> None:
        self._sums = BlockTable(blocks.num, np.empty((0, 6), dtype=np.int64))
        self._stale = blocks.all()

    def find(self, sheets: Sheets, placed: Placed, reached: Bool) -> list[Unreached]:
        """Find the floors that no step leads to, one entry a level, lowest first.

        On levels that are reached in part, only sheets of at least 6 m² there count.

        Args:
            reached: which sheets are reached, shape (sheets,), bool.
        """
        self._stale |= sheets.stale | placed.changed
        if reached[placed.counts[:, 0]].all():
            return []
        asked = sheets.lattice, sheets.surfaces, sheets.labels.part, placed.level
        self._sums.fill(weigh, np.flatnonzero(self._stale), *asked)
        self._stale = np.zeros_like(self._stale)
        block, (rows,) = self._sums.take()
        part, on, geom, count = rows[:, :4].T
        sheet, level, unreached = sheets.sheet_at(block, part), placed.number[on], []
        is_reached = reached[sheet]
        for number in np.unique(level[~is_reached]).tolist():
            here = (level == number) & ~is_reached
            size = np.bincount(sheet[here], count[here], minlength=len(reached))
            told, whole = size > 0, not (is_reached & (level == number)).any()
            if not whole:
                told &= size * sheets.lattice.cell_size**2 >= TOLD_AREA - SLACK
            if told.any():
                here &= told[sheet]
                most = int(np.bincount(geom[here], count[here]).argmax())
                area = int(size[told].sum()) * sheets.lattice.cell_size**2
                largest = int(np.where(told, size, 0).argmax())
                middle = rows[here & (sheet == largest), 4:].sum(axis=0) / size[largest]
                place = _place_on(sheets, placed, number, largest, *middle.tolist())
                cells = partial(_list_cells, sheets, placed, number, told)
                unreached.append(Unreached(number, Patch(most, area, place, cells), whole))
        return unreached


def _members_on(
    sheets: Sheets, placed: Placed, number: int, sheet: int, window: Sequence[int] | None = None
) -> Members:
    """The surfaces of a sheet that are on a level, see `Sheets.members`."""
    members = sheets.members(sheet, window)
    on = placed.level[members.place]
    return members.only((on >= 0) & (placed.number[np.maximum(on, 0)] == number))


def _list_cells(sheets: Sheets, placed: Placed, number: int, chosen: Bool) -> Int:
    found = (_members_on(sheets, placed, number, k).cell for k in np.flatnonzero(chosen).tolist())
    return np.concatenate(list(found))


def _place_on(
    sheets: Sheets, placed: Placed, number: int, sheet: int, row: float, col: float
) -> tuple[float, float, float]:
    """The place of a sheet on a level that is nearest to a row and a column, see `place_near`."""
    lattice, reach = sheets.lattice, SIZE
    while True:
        low, high = (np.floor([row, col]).astype(np.int64) + by for by in (-reach, reach + 2))
        window = [*np.maximum(low, 0).tolist(), *np.minimum(high, lattice.shape).tolist()]
        members = _members_on(sheets, placed, number, sheet, window)
        rows, cols = np.divmod(members.cell, lattice.width)
        if (np.hypot(rows - row, cols - col) <= reach).any():  # what lies outside is farther
            return place_near(lattice, members, row, col)
        reach *= 2


def find_enclosed(sheets: Sheets, agent: AgentSettings, settings: FloorSettings) -> list[Patch]:
    """Find floors inside of closed meshes, where nobody can stand, the largest first.

    A floor that continues outside at its height only carries a closed thing, like a crate, unless
    that is as large as a building. `sheets` are those of HELD surfaces, each of one mesh.
    """
    surfaces, lattice, found = sheets.surfaces, sheets.lattice, list[Patch]()
    for sheet in np.flatnonzero(sheets.left(sheets.size > 0, settings)).tolist():
        members, edges, goes_on = sheets.members(sheet), 0, 0
        for way in range(4):
            other = beside(lattice, members.cell, way)
            at_edge = ~np.isin(other, members.cell)
            edges += int(np.count_nonzero(at_edge))
            at_edge &= other >= 0
            other, z = other[at_edge], members.z[at_edge]
            column = surfaces.first[other], surfaces.first[other] + surfaces.length[other]
            near = find_near(*column, surfaces.z, z, agent.traversable_floor_height)
            goes_on += int(np.count_nonzero(~np.isnan(near)))
        patch = describe_members(lattice, members)
        if patch.area >= BUILDING or goes_on < GOES_ON * edges:
            found.append(patch)
    return sorted(found, key=lambda patch: -patch.area)
