"""Regions: standable surfaces that steps join, and which of them are large enough for floors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from navbake.baker.core.area_test import area_test
from navbake.baker.core.blocks import Blocks
from navbake.baker.core.components import expand_ranges, label_components
from navbake.baker.floors import label_kernels as kernels
from navbake.baker.floors.label_kernels import JOINS, LIES, LINKS, Joining, Numbering
from navbake.baker.floors.member_kernels import Labelled, Members, find_large
from navbake.baker.floors.surface_kernels import Surfaces
from navbake.baker.floors.surfaces import slopes_may_join
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# In place of a key of each surface: there is none
NO_KEY = np.empty(0, dtype=np.int32)
# Empty columns of rows that count, and of heights, see `navbake.baker.floors.label_kernels`
NO_ROWS = np.empty((0, 4), dtype=np.int64)
NO_HEIGHTS = np.empty(0)
# An empty column of the measures of `label_blocks`
NO_MEASURES = np.empty((0, 7), dtype=np.int64)


class Labels(NamedTuple):
    """The connected parts of surfaces inside of blocks, numbered one block after the other.

    Attributes:
        part: the number of each surface's part, -1 for none, int32.
        block: of each part.
        measures, low: of each part, see `label_blocks`.
        pairs: of parts that meet, rows of `list_pairs`.
    """

    part: Int32
    block: Int
    measures: Int
    low: Float
    pairs: Int

    @property
    def num(self) -> int:
        """How many parts there are."""
        return len(self.measures)

    def pairs_of(self, kind: int) -> Int:
        """The rows of pairs that meet in one way: JOINS, LINKS or LIES."""
        rows: Int = self.pairs[self.pairs[:, 2] == kind]
        return rows

    def wholes(self) -> Int32:
        """The whole that each part belongs to, across blocks, numbered by their first parts."""
        return label_components(self.pairs_of(JOINS)[:, :2].T, self.num)

    def links(self, whole_of_part: Int32) -> tuple[Int, Int]:
        """The pairs of linked wholes, each once, and the lower number first."""
        linked = whole_of_part[self.pairs_of(LINKS)[:, :2]].astype(np.int64)
        lower = linked.min(axis=1)
        upper = linked.max(axis=1)
        differs = lower != upper
        pair_ids = np.unique(lower[differs] * self.num + upper[differs])
        return np.divmod(pair_ids, max(self.num, 1))


def label_surfaces(surfaces: Surfaces, joining: Joining, key: Int32 = NO_KEY) -> Labels:
    """Find the connected parts of surfaces in each block; for the key, see `label_blocks`."""
    blocks = Blocks(surfaces.lattice)
    part = np.empty(len(surfaces.z), dtype=np.int32)
    block, (measures, low) = blocks.list_rows(
        kernels.label_blocks, (NO_MEASURES, NO_HEIGHTS), surfaces, key, joining, part
    )
    numbering = Numbering(
        part=part,
        offset=np.searchsorted(block, np.arange(blocks.num)),
        number=np.empty(len(surfaces.z), dtype=np.int32),
    )
    _, (pairs,) = blocks.list_rows(
        kernels.list_pairs, (NO_ROWS,), surfaces, key, joining, numbering
    )
    return Labels(numbering.number, block, measures, low, pairs)


@dataclass(frozen=True, eq=False)
class Regions:
    """All regions of a scene, numbered by their first surfaces.

    Attributes:
        surfaces: the surfaces that they are made of.
        labels: the parts of regions in each block.
        of_part: the region of each part, shape (parts,), int32.
        size: how many surfaces each has, int64.
        tops: over how many of these nothing lies.
        box: its first row and column, and past its last ones, shape (regions, 4).
        low: its lowest height [m].
    """

    surfaces: Surfaces
    labels: Labels
    of_part: Int32
    size: Int
    tops: Int
    box: Int
    low: Float

    @property
    def num(self) -> int:
        """How many regions there are."""
        return len(self.size)

    @property
    def blocks(self) -> Blocks:
        """The blocks of the lattice."""
        return Blocks(self.lattice)

    @property
    def lattice(self) -> Lattice:
        """The lattice that the surfaces lie on."""
        lattice: Lattice = self.surfaces.lattice
        return lattice

    def labelled(self, mask: Bool) -> Labelled:
        """The surfaces with the numbers of their regions, -1 for those that are not in the mask."""
        region = np.where(mask[self.of_part], self.of_part, np.int32(-1)).astype(np.int32)
        return Labelled(self.surfaces, self.labels.part, region)

    def region_of(self, place: Int) -> Int32:
        """The regions of some surfaces, by their places; -1 for those that belong to none."""
        part = self.labels.part[place]
        return np.where(part >= 0, self.of_part[part], np.int32(-1))

    def stacks(self) -> tuple[Int32, Int32, Int]:
        """Upper regions, the ones next below, and in how many cells; pairs may repeat."""
        upper, lower, _, num_cells = self.labels.pairs_of(LIES).T
        return self.of_part[upper], self.of_part[lower], num_cells

    def members(self, region: int) -> Members:
        """The surfaces of a region."""
        surfaces = self.surfaces
        row0, col0, row1, col1 = self.box[region].tolist()
        in_box = np.add.outer(np.arange(row0, row1) * self.lattice.width, np.arange(col0, col1))
        cells = in_box.ravel()
        which, place = expand_ranges(surfaces.first[cells], surfaces.end[cells])
        is_member = self.region_of(place) == region
        place = place[is_member]
        return Members(cells[which[is_member]], surfaces.z[place], surfaces.geom[place], place)

    def between(self, mask: Bool, low: float, high: float) -> Bool:
        """Which of some regions have a surface from a height up to below another one [m]."""
        result = np.zeros_like(mask)
        for region in np.flatnonzero(mask).tolist():
            z = self.members(region).z
            result[region] = ((low <= z) & (z < high)).any()
        return result


def region_joining(lattice: Lattice, agent: AgentSettings) -> Joining:
    """What joins surfaces to regions."""
    return Joining(agent.traversable_floor_height, by_slopes=slopes_may_join(lattice, agent))


def find_regions(surfaces: Surfaces, agent: AgentSettings, key: Int32 = NO_KEY) -> Regions:
    """Join surfaces to regions; for the key, see `label_blocks`."""
    labels = label_surfaces(surfaces, region_joining(surfaces.lattice, agent), key)
    whole_of_part = labels.wholes()
    num = int(whole_of_part.max(initial=-1)) + 1
    # the parts of each whole side by side
    together = np.argsort(whole_of_part, kind="stable")
    start = np.searchsorted(whole_of_part[together], np.arange(num))
    measures = labels.measures[together]
    sums = np.add.reduceat(measures[:, :2], start)
    least = np.minimum.reduceat(measures[:, 2:5], start)
    most = np.maximum.reduceat(measures[:, 5:], start)
    by_first = np.argsort(least[:, 0])
    number = np.argsort(by_first).astype(np.int32)
    return Regions(
        surfaces=surfaces,
        labels=labels,
        of_part=number[whole_of_part],
        size=sums[by_first, 0],
        tops=sums[by_first, 1],
        box=np.hstack([least[by_first, 1:], most[by_first]]),
        low=np.minimum.reduceat(labels.low[together], start)[by_first],
    )


def find_large_regions(regions: Regions, mask: Bool, settings: FloorSettings) -> Bool:
    """Which of some regions are large enough for floors, see `area_test`; shape (regions,).

    A region's cells are taken together over all heights.
    """
    test = area_test(regions.lattice, settings)
    result = np.zeros(regions.num, dtype=np.bool_)
    candidates = np.flatnonzero(mask & (regions.size >= test.min_cells))
    # the blocks of each candidate, one candidate after the other
    is_candidate = np.isin(regions.of_part, candidates)
    region_of_part = regions.of_part[is_candidate].astype(np.int64)
    pair_ids = np.unique(region_of_part * regions.blocks.num + regions.labels.block[is_candidate])
    region, block = np.divmod(pair_ids, regions.blocks.num)
    start = np.searchsorted(region, [*candidates, regions.num])
    run_in_chunks(
        find_large,
        len(candidates),
        regions.labelled(mask),
        regions.box,
        candidates,
        start,
        block,
        test,
        result,
    )
    return result


@dataclass(frozen=True)
class Patch:
    """Surfaces that lie side by side, such as a region that is no floor.

    Attributes:
        geom: the geom that most of it belongs to.
        area: [m²].
        place: x, y, z of a place near its middle, in world coordinates [m].
        cells: the cells of its surfaces, shape (n,), int32.
    """

    geom: int
    area: float
    place: tuple[float, float, float]
    cells: Int32 = field(repr=False, compare=False)


def describe_members(lattice: Lattice, members: Members) -> Patch:
    """Describe some surfaces, one at least."""
    row, col = np.divmod(members.cell, lattice.width)
    return Patch(
        geom=int(np.bincount(members.geom).argmax()),
        area=len(members.cell) * lattice.cell_size**2,
        place=place_near(lattice, members, row.mean(), col.mean()),
        cells=members.cell.astype(np.int32),
    )


def place_near(
    lattice: Lattice, members: Members, row: float, col: float
) -> tuple[float, float, float]:
    """x, y, z of the surface nearest to a row and a column [m]."""
    rows, cols = np.divmod(members.cell, lattice.width)
    nearest = int(((rows - row) ** 2 + (cols - col) ** 2).argmin())
    x = lattice.center_x()[cols[nearest]]
    y = lattice.center_y()[rows[nearest]]
    return float(x), float(y), float(members.z[nearest])


def describe_regions(
    regions: Regions, mask: Bool, spans: Sequence[tuple[float, float]] = ()
) -> list[Patch]:
    """Describe some regions, the largest first.

    Args:
        spans: of heights; if there are any, only surfaces in these are described [m].
    """
    patches = []
    for region in np.flatnonzero(mask).tolist():
        members = regions.members(region)
        if spans:
            z = members.z
            in_spans = np.any([(z >= low) & (z < high) for low, high in spans], axis=0)
            members = members.only(in_spans)
        if len(members.z):
            patches.append(describe_members(regions.lattice, members))
    return sorted(patches, key=lambda patch: -patch.area)
