"""Connect standable surfaces to regions, and find the regions that are large enough for floors.

A region is a set of surfaces between which an agent can walk. Its parts inside of each block of
cells, the components, are found first and then merged. A `Patch` summarizes a region for warnings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from navbake.baker.core.area_test import keeps_min_cells, make_area_test
from navbake.baker.core.arrays import HeightRange
from navbake.baker.core.blocks import Blocks, list_rows
from navbake.baker.core.components import expand_ranges, label_components
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors import component_kernels as kernels
from navbake.baker.floors.component_kernels import (
    JOINED,
    LINKED,
    STACKED,
    ComponentNumbering,
    JoinRule,
)
from navbake.baker.floors.region_kernels import (
    LabelledSurfaces,
    RegionSurfaces,
    mark_large_regions,
)
from navbake.baker.floors.surface_kernels import RIDGE_FLAGS, Surfaces
from navbake.baker.floors.surfaces import may_slopes_join
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# Stands for the groups of surfaces where surfaces are not divided into groups
NO_GROUPS = np.empty(0, dtype=np.int32)
# Empty arrays with the dtypes and shapes of what kernels list: rows of three numbers and their
# count, heights, the lowest and highest heights of components, and other measures of these
NO_ROWS = np.empty((0, 4), dtype=np.int64)
NO_HEIGHTS = np.empty(0)
NO_HEIGHT_RANGES = np.empty((0, 2))
NO_MEASURES = np.empty((0, 7), dtype=np.int64)


class Components(NamedTuple):
    """The connected components of surfaces inside of each block, numbered block by block.

    Attributes:
        component_of_surface: the component of each surface, -1 for none, shape (surfaces,), int32.
        block_of_component: the id of the block that each component lies in, shape (components,),
            int64.
        measures: seven numbers of each component, such as how many surfaces it has, see
            `label_blocks`, shape (components, 7).
        lowest_z: the lowest height of each component, shape (components,) [m].
        highest_z: the highest height of each component, shape (components,) [m].
        pairs: pairs of components that meet, as `list_pairs` lists them, shape (n, 4).
    """

    component_of_surface: Int32
    block_of_component: Int
    measures: Int
    lowest_z: Float
    highest_z: Float
    pairs: Int

    @property
    def num_components(self) -> int:
        """Return the number of components."""
        return len(self.measures)

    def list_pairs_of_kind(self, kind: np.int64) -> Int:
        """Return those of `pairs` that have one kind (JOINED, LINKED or STACKED), shape (n, 4)."""
        _, _, kinds, _ = self.pairs.T
        pairs: Int = self.pairs[kinds == kind]
        return pairs

    def merge_across_blocks(self) -> Int32:
        """Merge components across the borders of blocks.

        Returns:
            For each component, the number of the merged component that it is a part of, shape
            (components,), int32. Merged components are numbered in the order of their first parts.
        """
        return label_components(self.list_pairs_of_kind(JOINED)[:, :2].T, self.num_components)

    def find_linked_pairs(self, merged_component: Int32) -> tuple[Int, Int]:
        """Find the pairs of different merged components that are linked, see `JoinRule`.

        Args:
            merged_component: the merged component of each component, as `merge_across_blocks`
                returns it.

        Returns:
            The lower and the higher number of each pair, without repeats, shape (n,) each.
        """
        linked_components = merged_component[self.list_pairs_of_kind(LINKED)[:, :2]].astype(
            np.int64
        )
        lower_component = linked_components.min(axis=1)
        higher_component = linked_components.max(axis=1)
        is_different = lower_component != higher_component
        # one number for each pair, so that `unique` sorts numbers rather than rows
        pair_ids = np.unique(
            lower_component[is_different] * self.num_components + higher_component[is_different]
        )
        return np.divmod(pair_ids, max(self.num_components, 1))


def find_components(
    surfaces: Surfaces, join_rule: JoinRule, group_of_surface: Int32 = NO_GROUPS
) -> Components:
    """Find the connected components of surfaces inside of each block of cells.

    Args:
        surfaces: all surfaces.
        join_rule: the limits within which surfaces are connected, or else linked.
        group_of_surface: the group of each surface, shape (surfaces,). Only surfaces of the same
            group are connected; those of a negative group are left out. If empty, all standable
            surfaces are in the same group.
    """
    blocks = Blocks(surfaces.lattice)
    number_in_block = np.empty(len(surfaces.z), dtype=np.int32)
    block_of_component, (measures, heights) = blocks.list_rows(
        kernels.label_blocks,
        (NO_MEASURES, NO_HEIGHT_RANGES),
        surfaces,
        group_of_surface,
        join_rule,
        number_in_block,
    )
    return _number_components(
        surfaces,
        join_rule,
        group_of_surface,
        number_in_block=number_in_block,
        offset_of_block=_count_components_before(blocks, block_of_component),
        block_of_component=block_of_component,
        measures=measures,
        heights=heights,
    )


def relabel_components(
    components: Components, surfaces: Surfaces, join_rule: JoinRule, changed_blocks: Int
) -> Components:
    """Find the components again after surfaces in some blocks of cells changed.

    Args:
        components: the components before the change, of surfaces without groups. Their
            `component_of_surface` is overwritten: a large scene has no memory for one array more.
        surfaces: all surfaces after the change; outside of the blocks they are as before.
        join_rule: the rule by which `components` were found.
        changed_blocks: ids of the blocks, ascending, shape (k,). Only these are labelled again.

    Returns:
        The components that `find_components` would find.
    """
    blocks = Blocks(surfaces.lattice)
    num_new_in_block, (new_measures, new_heights) = list_rows(
        kernels.label_blocks,
        changed_blocks,
        (NO_MEASURES, NO_HEIGHT_RANGES),
        surfaces,
        NO_GROUPS,
        join_rule,
        components.component_of_surface,
    )
    is_unchanged = ~np.isin(components.block_of_component, changed_blocks)
    unchanged_heights = np.stack([components.lowest_z, components.highest_z], axis=1)[is_unchanged]
    block_of_component = np.concatenate(
        [components.block_of_component[is_unchanged], np.repeat(changed_blocks, num_new_in_block)]
    )
    order_by_block = np.argsort(block_of_component, kind="stable")
    block_of_component = block_of_component[order_by_block]
    # the changed blocks count their components from 0, all others from their old first number
    first_number_of_block = _count_components_before(blocks, components.block_of_component)
    first_number_of_block[changed_blocks] = 0
    return _number_components(
        surfaces,
        join_rule,
        NO_GROUPS,
        number_in_block=components.component_of_surface,
        offset_of_block=_count_components_before(blocks, block_of_component)
        - first_number_of_block,
        block_of_component=block_of_component,
        measures=np.concatenate([components.measures[is_unchanged], new_measures])[order_by_block],
        heights=np.concatenate([unchanged_heights, new_heights])[order_by_block],
    )


def _number_components(
    surfaces: Surfaces,
    join_rule: JoinRule,
    group_of_surface: Int32,
    *,
    number_in_block: Int32,
    offset_of_block: Int,
    block_of_component: Int,
    measures: Int,
    heights: Float,
) -> Components:
    """Number components over all blocks, and list the pairs that meet.

    Args:
        surfaces: all surfaces.
        join_rule: the rule by which the components were found.
        group_of_surface: the group of each surface, see `find_components`.
        number_in_block: see `ComponentNumbering`.
        offset_of_block: see `ComponentNumbering`.
        block_of_component: the block of each component, ascending, shape (components,).
        measures: see `Components`, shape (components, 7).
        heights: the lowest and the highest height of each component, shape (components, 2) [m].
    """
    blocks = Blocks(surfaces.lattice)
    numbering = ComponentNumbering(
        number_in_block=number_in_block,
        offset_of_block=offset_of_block,
        overall_number=np.empty(len(surfaces.z), dtype=np.int32),
    )
    _, (pairs,) = blocks.list_rows(
        kernels.list_pairs, (NO_ROWS,), surfaces, group_of_surface, join_rule, numbering
    )
    return Components(
        component_of_surface=numbering.overall_number,
        block_of_component=block_of_component,
        measures=measures,
        lowest_z=heights[:, kernels.LOWEST],
        highest_z=heights[:, kernels.HIGHEST],
        pairs=pairs,
    )


def _count_components_before(blocks: Blocks, block_of_component: Int) -> Int:
    """Count, for each block, the components of all blocks before it.

    Args:
        blocks: the blocks.
        block_of_component: the block of each component, ascending, shape (components,).

    Returns:
        Counts, shape (blocks,), int64.
    """
    return np.searchsorted(block_of_component, np.arange(blocks.num_blocks))


class RegionStacks(NamedTuple):
    """Which regions lie directly above each other: a table of pairs, shape (n,) each.

    The same pair may have several entries, whose numbers of cells have to be added up.

    Attributes:
        upper_region: id of the upper region, int32.
        lower_region: id of the region of the next surface below, which may be the same region,
            int32.
        num_cells: in how many cells the two lie above each other, int64.
    """

    upper_region: Int32
    lower_region: Int32
    num_cells: Int


@dataclass(frozen=True, eq=False)
class Regions:
    """All regions of a scene: the connected surfaces between which an agent can walk.

    They are numbered in the order of their first surfaces.

    Attributes:
        surfaces: all surfaces.
        components: the parts of regions in the blocks of the lattice.
        region_of_component: the region of each component, shape (components,), int32.
        num_surfaces: how many surfaces each region has, shape (regions,), int64.
        num_uncovered: how many of these have nothing above them, shape (regions,), int64.
        box: the smallest rectangle of cells around each region: first row, first column, and the
            row and the column past the last ones, shape (regions, 4).
        lowest_z: the lowest height of each region, shape (regions,) [m].
        highest_z: the highest height of each region, shape (regions,) [m].
    """

    surfaces: Surfaces
    components: Components
    region_of_component: Int32
    num_surfaces: Int
    num_uncovered: Int
    box: Int
    lowest_z: Float
    highest_z: Float

    @property
    def num_regions(self) -> int:
        """Return the number of regions."""
        return len(self.num_surfaces)

    @property
    def blocks(self) -> Blocks:
        """Return the blocks of the lattice."""
        return Blocks(self.lattice)

    @property
    def lattice(self) -> Lattice:
        """Return the lattice that the surfaces lie on."""
        return self.surfaces.lattice

    def label_surfaces(self, is_selected: Bool) -> LabelledSurfaces:
        """Return all surfaces for kernels, labelled with the regions that are selected.

        Args:
            is_selected: the selected regions, shape (regions,), bool.
        """
        is_component_selected = is_selected[self.region_of_component]
        region_of_component = np.where(
            is_component_selected, self.region_of_component, np.int32(-1)
        ).astype(np.int32)
        return LabelledSurfaces(
            self.surfaces,
            component_of_surface=self.components.component_of_surface,
            region_of_component=region_of_component,
            lowest_z=self.lowest_z,
            highest_z=self.highest_z,
        )

    def region_of(self, surface_ids: Int) -> Int32:
        """Return the region of each surface id, -1 for surfaces without a region."""
        component = self.components.component_of_surface[surface_ids]
        return np.where(component >= 0, self.region_of_component[component], np.int32(-1))

    def list_blocks_of(self, surface_ids: Int) -> Int:
        """Return the ids of the blocks of cells that hold some surfaces of regions.

        Args:
            surface_ids: ids of surfaces, shape (n,); those without a region are left out.

        Returns:
            Ids of blocks, ascending, shape (k,).
        """
        component = self.components.component_of_surface[surface_ids]
        return np.unique(self.components.block_of_component[component[component >= 0]])

    def find_stacks(self) -> RegionStacks:
        """Find the pairs of regions that lie above each other, and in how many cells."""
        upper_component, lower_component, _, num_cells = self.components.list_pairs_of_kind(
            STACKED
        ).T
        return RegionStacks(
            self.region_of_component[upper_component],
            self.region_of_component[lower_component],
            num_cells,
        )

    def surfaces_of(self, region: int) -> RegionSurfaces:
        """Return the surfaces of a region, in the order of cell ids."""
        return self.list_surfaces(np.array([region]))[0]

    def list_surfaces(self, region_ids: Int) -> list[RegionSurfaces]:
        """Return the surfaces of each of some regions, in the order of cell ids.

        Args:
            region_ids: ids of regions, ascending, shape (n,).
        """
        if not len(region_ids):
            return []
        surfaces = self.surfaces
        is_selected = np.zeros(
            self.num_regions + 1, dtype=np.bool_
        )  # the last entry is for no region
        is_selected[region_ids] = True
        # only the cells of the blocks in which the regions have components have to be searched
        holds_region = np.zeros(self.blocks.num_blocks, dtype=np.bool_)
        is_component_selected = is_selected[self.region_of_component]
        holds_region[self.components.block_of_component[is_component_selected]] = True
        cells = self.blocks.list_cells_of_blocks(holds_region)
        cell_index, surface_ids = expand_ranges(surfaces.first[cells], surfaces.end[cells])
        region = self.region_of(surface_ids)
        indices_in_regions = np.flatnonzero(is_selected[region])
        # sorted once, so that the columns are not searched again for each region
        indices_by_region = indices_in_regions[
            np.argsort(region[indices_in_regions], kind="stable")
        ]
        surface_ids = surface_ids[indices_by_region]
        region_surfaces = RegionSurfaces(
            cell=cells[cell_index[indices_by_region]],
            z=surfaces.z[surface_ids],
            geom=surfaces.geom[surface_ids],
            surface_id=surface_ids,
        )
        first_index_of_region = np.searchsorted(region[indices_by_region], region_ids)
        end_index_of_region = np.append(first_index_of_region[1:], len(indices_by_region))
        ranges = zip(first_index_of_region.tolist(), end_index_of_region.tolist(), strict=True)
        return [region_surfaces.select(slice(first, end)) for first, end in ranges]

    def mark_regions_in_range(self, is_tested: Bool, height_range: HeightRange) -> Bool:
        """Mark the regions that have a surface in a range of heights.

        Args:
            is_tested: the regions to test, shape (regions,).
            height_range: the range [low, high) [m].

        Returns:
            A mask, shape (regions,), bool.
        """
        is_in_range = (
            is_tested & (height_range.low <= self.lowest_z) & (self.lowest_z < height_range.high)
        )
        # regions that begin below the range, and end in it or above it
        reaches_into_range = (
            is_tested & (self.lowest_z < height_range.low) & (height_range.low <= self.highest_z)
        )
        region_ids = np.flatnonzero(reaches_into_range)
        surfaces_by_region = self.list_surfaces(region_ids)
        for region, region_surfaces in zip(region_ids, surfaces_by_region, strict=True):
            z = region_surfaces.z
            is_in_range[region] = ((height_range.low <= z) & (z < height_range.high)).any()
        return is_in_range


def make_region_join_rule(lattice: Lattice, agent: AgentSettings) -> JoinRule:
    """Return the rule by which surfaces are joined into regions: by steps, and by slopes.

    Args:
        lattice: the lattice of the surfaces' cells.
        agent: the agent, of which the step and slope are used.
    """
    return JoinRule(agent.traversable_floor_height, can_slopes_join=may_slopes_join(lattice, agent))


def find_regions(
    surfaces: Surfaces, agent: AgentSettings, group_of_surface: Int32 = NO_GROUPS
) -> Regions:
    """Connect surfaces to regions by steps and slopes.

    Args:
        surfaces: all surfaces.
        agent: the agent, of which the step and slope are used.
        group_of_surface: the group of each surface, negative to leave it out, shape (surfaces,). A
            region lies in one group. If empty, all standable surfaces are in the same group.
    """
    join_rule = make_region_join_rule(surfaces.lattice, agent)
    return _merge_to_regions(surfaces, find_components(surfaces, join_rule, group_of_surface))


def remove_from_regions(
    regions: Regions, removed_surfaces: Int, changed_blocks: Int, agent: AgentSettings
) -> Regions:
    """Return the regions that are left after some surfaces are removed from them.

    No agent stands on a removed surface then, and no floor continues there: its `Surfaces.flags`
    are `RIDGE_FLAGS`.

    Args:
        regions: all regions, as `find_regions` finds them without groups. What they say of single
            surfaces is overwritten; what they say of whole regions and components stays valid.
        removed_surfaces: ids of the surfaces that are removed, shape (n,).
        changed_blocks: ids of the blocks that hold them, see `Regions.list_blocks_of`, shape (k,).
        agent: the agent, of which the step and slope are used.

    Returns:
        The regions that `find_regions` would find. Only the blocks of cells that hold removed
        surfaces are labelled again.
    """
    surfaces = regions.surfaces
    surfaces.flags[removed_surfaces] = RIDGE_FLAGS
    join_rule = make_region_join_rule(surfaces.lattice, agent)
    components = relabel_components(regions.components, surfaces, join_rule, changed_blocks)
    return _merge_to_regions(surfaces, components)


def _merge_to_regions(surfaces: Surfaces, components: Components) -> Regions:
    """Merge the components of all blocks to regions, and measure these."""
    merged_component = components.merge_across_blocks()
    num_regions = int(merged_component.max(initial=-1)) + 1
    # sort components by region: those of a region then stand side by side, and the measures of the
    # region are their sums, minima or maxima
    sort_indices = np.argsort(merged_component, kind="stable")
    first_component = np.searchsorted(merged_component[sort_indices], np.arange(num_regions))
    measures = components.measures[sort_indices]
    measure_sums = np.add.reduceat(measures, first_component)
    measure_minima = np.minimum.reduceat(measures, first_component)
    measure_maxima = np.maximum.reduceat(measures, first_component)
    # number regions by their first surfaces, so that neither threads nor blocks change the order
    order_by_first_surface = np.argsort(measure_minima[:, kernels.FIRST_SURFACE])
    region_of_merged_component = np.argsort(order_by_first_surface).astype(np.int32)
    first_cells = measure_minima[:, [kernels.FIRST_ROW, kernels.FIRST_COL]]
    end_cells = measure_maxima[:, [kernels.END_ROW, kernels.END_COL]]
    return Regions(
        surfaces=surfaces,
        components=components,
        region_of_component=region_of_merged_component[merged_component],
        num_surfaces=measure_sums[order_by_first_surface, kernels.NUM_SURFACES],
        num_uncovered=measure_sums[order_by_first_surface, kernels.NUM_UNCOVERED],
        box=np.hstack([first_cells, end_cells])[order_by_first_surface],
        lowest_z=np.minimum.reduceat(components.lowest_z[sort_indices], first_component)[
            order_by_first_surface
        ],
        highest_z=np.maximum.reduceat(components.highest_z[sort_indices], first_component)[
            order_by_first_surface
        ],
    )


def find_large_regions(regions: Regions, is_tested: Bool, settings: FloorSettings) -> Bool:
    """Mark the regions that are large enough for floors.

    A region is large enough if it keeps `floors.min_area` when it is shrunk by `floors.shrink`, all
    its cells together whatever their heights. Holes that `floors.fill` closes count as part of it.

    Args:
        regions: all regions.
        is_tested: which regions are tested, shape (regions,).
        settings: the settings of `floors`; `min_area` [m²], `shrink` [m] and `fill` [m²] are used.

    Returns:
        A mask of the regions that are large enough, shape (regions,), bool.
    """
    area_test = make_area_test(regions.lattice, settings)
    is_large = np.zeros(regions.num_regions, dtype=np.bool_)
    candidate_regions = np.flatnonzero(is_tested & (regions.num_surfaces >= area_test.min_cells))
    # the blocks of each candidate, one candidate after the other
    is_component_of_candidate = np.isin(regions.region_of_component, candidate_regions)
    region_of_component = regions.region_of_component[is_component_of_candidate].astype(np.int64)
    block_of_component = regions.components.block_of_component[is_component_of_candidate]
    # one number for each pair of a region and a block
    pair_ids = np.unique(region_of_component * regions.blocks.num_blocks + block_of_component)
    paired_region, paired_block = np.divmod(pair_ids, regions.blocks.num_blocks)
    first_block = np.searchsorted(paired_region, [*candidate_regions, regions.num_regions])
    run_in_chunks(
        mark_large_regions,
        len(candidate_regions),
        regions.label_surfaces(is_tested),
        regions.box,
        candidate_regions,
        first_block,
        paired_block,
        area_test,
        is_large,
    )
    if settings.fill:
        max_hole_cells = settings.fill / regions.lattice.cell_size**2
        for region_id in np.flatnonzero(is_tested & ~is_large).tolist():
            row0, col0, row1, col1 = regions.box[region_id].tolist()
            if (row1 - row0) * (col1 - col0) >= area_test.min_cells:
                is_in_region = _fill_region(regions, region_id, max_hole_cells)
                is_large[region_id] = keeps_min_cells(area_test, is_in_region)
    return is_large


def find_large_remaining_regions(
    remaining_regions: Regions,
    regions: Regions,
    is_large: Bool,
    changed_blocks: Int,
    settings: FloorSettings,
) -> Bool:
    """Mark the regions that are large enough for floors after surfaces were removed.

    Only regions that may have lost surfaces are tested; the others are as large as before.

    Args:
        remaining_regions: the regions that are left, see `remove_from_regions`.
        regions: the regions before the removal.
        is_large: which of these were large enough, see `find_large_regions`.
        changed_blocks: ids of the blocks that held the removed surfaces, ascending, shape (k,).
        settings: the settings of `floors`, see `find_large_regions`.

    Returns:
        A mask of the remaining regions that are large enough, shape (remaining regions,), bool.
    """
    # outside of the changed blocks, the components are the same, in the same order
    is_same_before = ~np.isin(regions.components.block_of_component, changed_blocks)
    is_same_now = ~np.isin(remaining_regions.components.block_of_component, changed_blocks)
    region_before = np.full(remaining_regions.num_regions, -1)
    region_before[remaining_regions.region_of_component[is_same_now]] = regions.region_of_component[
        is_same_before
    ]
    # each region is a part of the region before: with as many surfaces, it is all of it
    is_whole = (region_before >= 0) & (
        remaining_regions.num_surfaces == regions.num_surfaces[region_before]
    )
    is_large_now = find_large_regions(remaining_regions, ~is_whole, settings)
    is_large_now[is_whole] = is_large[region_before[is_whole]]
    return is_large_now


def _fill_region(regions: Regions, region: int, max_hole_cells: float) -> Bool:
    """Mark the cells of a region, and those of its holes with at most `max_hole_cells` cells.

    Args:
        regions: all regions.
        region: the region's id.
        max_hole_cells: holes with more cells are not marked.

    Returns:
        A mask of the cells of the region's box, see `Regions.box`, shape (rows, cols).
    """
    from scipy.ndimage import label  # scipy loads slowly, and few bakes need this

    row0, col0, row1, col1 = regions.box[region].tolist()
    row, col = np.divmod(regions.surfaces_of(region).cell, regions.lattice.width)
    # what lies beside the box is connected all round, and is no hole
    is_empty = np.ones((row1 - row0 + 2, col1 - col0 + 2), dtype=np.bool_)
    is_empty[row - row0 + 1, col - col0 + 1] = False
    hole_of_cell, _ = label(is_empty)
    num_cells_in_hole = np.bincount(hole_of_cell.ravel())  # [cells]
    is_filled_hole = num_cells_in_hole <= max_hole_cells + LIMIT_SLACK
    is_filled_hole[0] = True  # the region's cells
    is_filled_hole[hole_of_cell[0, 0]] = False
    is_in_region: Bool = is_filled_hole[hole_of_cell][1:-1, 1:-1]
    return is_in_region


@dataclass(frozen=True)
class Patch:
    """A summary of surfaces that lie side by side, such as a region that is no floor.

    Attributes:
        geom: id of the geom that most of the surfaces belong to.
        area: their area [m²].
        position: x, y, z of a surface near their middle, in world coordinates [m].
        cells: ids of their cells, shape (n,), int32.
    """

    geom: int
    area: float
    position: tuple[float, float, float]
    cells: Int32 = field(repr=False, compare=False)


def describe_surfaces(lattice: Lattice, surfaces: RegionSurfaces) -> Patch:
    """Summarize some surfaces as a patch: their main geom, area, position and cells.

    Args:
        lattice: the lattice of their cells.
        surfaces: the surfaces, at least one.
    """
    return Patch(
        geom=int(np.bincount(surfaces.geom).argmax()),
        area=len(surfaces.cell) * lattice.cell_size**2,
        position=find_middle_position(lattice, surfaces),
        cells=surfaces.cell.astype(np.int32),
    )


def find_middle_position(lattice: Lattice, surfaces: RegionSurfaces) -> tuple[float, float, float]:
    """Return the position of the surface nearest to the middle of surfaces, seen from above.

    Args:
        lattice: the lattice of the cells.
        surfaces: the surfaces, at least one.

    Returns:
        World coordinates x, y, z [m].
    """
    row, col = np.divmod(surfaces.cell, lattice.width)
    nearest_surface = int(((row - row.mean()) ** 2 + (col - col.mean()) ** 2).argmin())
    x = lattice.center_x()[col[nearest_surface]]
    y = lattice.center_y()[row[nearest_surface]]
    return float(x), float(y), float(surfaces.z[nearest_surface])


def describe_regions(
    regions: Regions, is_described: Bool, height_ranges: Sequence[HeightRange] = ()
) -> list[Patch]:
    """Summarize some regions as patches, the largest first.

    Args:
        regions: all regions.
        is_described: the regions to summarize, shape (regions,).
        height_ranges: only surfaces in these ranges of heights [low, high) [m] are summarized; if
            empty, surfaces at all heights.
    """
    patches = []
    for surfaces in regions.list_surfaces(np.flatnonzero(is_described)):
        if height_ranges:
            z = surfaces.z
            is_in_range = [
                (z >= height_range.low) & (z < height_range.high) for height_range in height_ranges
            ]
            surfaces = surfaces.select(np.any(is_in_range, axis=0))
        if len(surfaces.z):
            patches.append(describe_surfaces(regions.lattice, surfaces))
    return sorted(patches, key=lambda patch: -patch.area)
