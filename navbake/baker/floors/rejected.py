"""Decide which large regions are no floors: tops, shelves and roofs.

A top is the upper side of something that stands on a floor, such as a bed or a block. A shelf hangs
over a floor. A roof lies over a floor, open to the sky, and has no walls around it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navbake.baker.core.arrays import HeightRange
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT, TOUCH_DEPTH
from navbake.baker.floors.outline import (
    DROP,
    WALL,
    RegionContext,
    find_highest_below,
    find_hole_edges,
    find_neighbor_cells,
    make_probe_ranges,
)
from navbake.baker.floors.region_kernels import RegionEdges, RegionSurfaces
from navbake.baker.floors.regions import find_large_regions
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int32

# A top drops to a floor along at least this fraction of its outline
MIN_DROP_SHARE = 0.25
# A region is a mezzanine, not a top, if there is room for an agent under more than this fraction of
# its area
MAX_SHARE_OVER_ROOM = 0.5
# Beds, counters and desks are smaller than this; a larger region is a top only on some conditions,
# see `_find_tops` [m²]
LARGE_TOP_AREA = 6.0
# A large region may be a top if it drops to a floor more than this many times as large as itself
MIN_FLOOR_RATIO = 0.9
# A region that is nowhere wider than this is the top of a wall, however large it is [m]
MAX_WALL_TOP_WIDTH = 3.0
# At least this fraction of a roof's area lies open to the sky. Not all of it has to: a higher
# roof's eaves may cover a side, and a carport's roof may continue into the house, over the tops of
# its walls
MIN_SKY_SHARE = 0.5
# At least this fraction of the area of a roof or of a shelf lies over a floor
MIN_SHARE_OVER_FLOOR = 0.5
# Under a roof with thick walls and eaves there is less floor. Then at least the first of these
# fractions of its area is over a floor, and at least the second one is over a floor, over a wall,
# or within EAVES_DEPTH of either [m]
MIN_SHARE_OVER_FLOOR_WITH_WALLS = 0.1
MIN_SHARE_OVER_WALLS = 2 / 3
EAVES_DEPTH = 1.5
# A region with walls along more than this fraction of its outline is no roof, but a storey without
# its ceiling. Such walls are as high as the agent, and at least 1.5 m; parapets reach 1.2 m [m]
MAX_WALL_SHARE = 0.5
MIN_WALL_HEIGHT = 1.5
# A roof is reported if it is more than this many times as large as the largest floor (walls and
# eaves alone add less than a third); or if it has at least this area [m²] and no walls under it
REPORTED_ROOF_RATIO = 4 / 3
REPORTED_ROOF_AREA = 50.0
# No shelf is deeper than this: pallet racks are 1.1 m, or 2.2 m back to back [m]
MAX_SHELF_DEPTH = 2.5
# A shelf drops to a floor along more than this fraction of its outline
MIN_SHELF_DROP_SHARE = 0.5
# Fewer cells than this are not worth a call on another thread
MIN_LINES_PER_THREAD = 1000


class RejectedRegions(NamedTuple):
    """The large regions that are no floors; masks of shape (regions,).

    Attributes:
        is_top: marks the tops of what stands on a floor, such as beds, except those that are roofs.
        is_shelf: marks the shelves, which hang over a floor, except those that are roofs.
        is_roof: marks the roofs: over a floor, open to the sky, and without walls around.
    """

    is_top: Bool
    is_shelf: Bool
    is_roof: Bool


def find_rejected_regions(
    region_context: RegionContext, height_ranges: Sequence[HeightRange], height_fields: Int32
) -> RejectedRegions:
    """Find the large regions that are no floors but tops of things, shelves or roofs.

    Roofs count as floors if the scene, or a level of the configuration, would have no other floor.

    Args:
        region_context: all regions with their edges.
        height_ranges: the heights [low, high) of the levels of the configuration [m]; empty if it
            has none.
        height_fields: the ids of the geoms that are height fields, shape (n,).
    """
    regions = region_context.regions
    is_large = region_context.is_large
    is_no_region = np.zeros(regions.num_regions, dtype=np.bool_)
    is_top = is_no_region
    is_shelf = is_no_region
    is_roof = is_no_region
    stacks = regions.find_stacks()
    num_surfaces = np.maximum(regions.num_surfaces, 1)
    sky_fraction = regions.num_uncovered / num_surfaces
    # furniture counts, too: a hall's roof lies over its floor whatever stands there
    num_cells_over_others = stacks.num_cells * (stacks.upper_region != stacks.lower_region)
    fraction_over_regions = (
        np.bincount(stacks.upper_region, num_cells_over_others, regions.num_regions) / num_surfaces
    )
    if not region_context.settings.tops:
        is_top = _find_tops(region_context, height_fields)
        is_shelf = _find_shelves(
            region_context,
            is_large
            & (sky_fraction < MIN_SKY_SHARE)
            & (fraction_over_regions >= MIN_SHARE_OVER_FLOOR),
        )
    if not region_context.settings.roofs:
        may_be_roof = (
            is_large
            & (sky_fraction >= MIN_SKY_SHARE)
            & (fraction_over_regions >= MIN_SHARE_OVER_FLOOR_WITH_WALLS)
        )
        is_roof = _find_roofs(region_context, may_be_roof, fraction_over_regions)
    is_floor = is_large & ~(is_top | is_shelf | is_roof)
    if not is_floor.any():
        is_roof = is_no_region
    # a level of the configuration keeps its roof if it has no other floor
    for height_range in height_ranges:
        is_on_level = regions.mark_regions_in_range(is_large, height_range)
        if not (is_on_level & is_floor).any():
            is_roof = is_roof & ~is_on_level
    return RejectedRegions(is_top & ~is_roof, is_shelf & ~is_roof, is_roof)


class TopDrops(NamedTuple):
    """How many edges of a region drop to each of the regions below it.

    Attributes:
        num_drops_to_region: id of the region below -> how many edges drop to it. Empty if the
            region can't be a top because it has too few drops, or room for an agent under it, see
            `_find_tops`.
        num_hole_drops_to_region: like `num_drops_to_region`, but only for edges at the rims of
            holes.
        num_outline_edges: how many edges the region's outer rim has.
    """

    num_drops_to_region: Counter[int]
    num_hole_drops_to_region: Counter[int]
    num_outline_edges: int


def _find_tops(region_context: RegionContext, height_fields: Int32) -> Bool:
    """Find the tops of what stands on a floor: beds, blocks, counters, walls that are metres thick.

    A region is a top if all of these hold:

    - At least a quarter of its outline drops to floors, see `RegionContext.classify_edges`. Edges
      at the rims of holes are a part of the outline only if they drop.
    - Under at most half of it there is room for an agent, at the height of the floors that it drops
      to. (Under a mezzanine there is more.)
    - One of these holds; otherwise it is the ground beside a pool, a ditch or a track bed:

      - it has at most 6 m²;
      - it is nowhere wider than 3 m;
      - it drops to a floor larger than 0.9 of its own size;
      - it drops to a floor that winds through it: more edges drop to this floor, from the rims of
        the region's holes and from other regions, than there are edges in the region's outer rim.

    - It is no raised ground, see `_is_raised_ground`.

    Args:
        region_context: all regions with their edges.
        height_fields: the ids of the geoms that are height fields, shape (n,).

    Returns:
        A mask, shape (regions,), bool.
    """
    regions = region_context.regions
    num_drops = np.bincount(
        region_context.edges.region, region_context.edges.has_drop, regions.num_regions
    )
    may_be_top = region_context.is_large & (num_drops > 0)
    if not region_context.is_cropped.any():
        # an outline is at least as long as the box around it: most regions drop along less of it
        num_rows = regions.box[:, 2] - regions.box[:, 0]
        num_cols = regions.box[:, 3] - regions.box[:, 1]
        may_be_top &= num_drops >= MIN_DROP_SHARE * 2 * (num_rows + num_cols)
    drops_by_region = _count_drops(region_context, may_be_top)
    num_drops_to_floor = Counter[int]()  # region below -> drops to it from all regions
    for region_drops in drops_by_region.values():
        num_drops_to_floor.update(region_drops.num_drops_to_region)
    is_top = np.zeros(regions.num_regions, dtype=np.bool_)
    is_too_large = np.zeros(regions.num_regions, dtype=np.bool_)
    for region, region_drops in drops_by_region.items():
        if not region_drops.num_drops_to_region or _is_raised_ground(
            region_context, region, region_drops, height_fields
        ):
            continue
        num_surfaces = regions.num_surfaces[region]
        is_small = num_surfaces * regions.lattice.cell_size**2 <= LARGE_TOP_AREA
        # or the largest floor that it drops to is larger
        is_small |= (
            regions.num_surfaces[list(region_drops.num_drops_to_region)].max()
            > MIN_FLOOR_RATIO * num_surfaces
        )
        # for each floor in its holes: the drops to it from these holes, and from other regions
        num_drops_around_floors = [
            num_hole_drops
            + num_drops_to_floor[floor_region]
            - region_drops.num_drops_to_region[floor_region]
            for floor_region, num_hole_drops in region_drops.num_hole_drops_to_region.items()
        ]
        has_floor_winding_through = (
            max(num_drops_around_floors, default=0) > region_drops.num_outline_edges
        )
        is_top[region] = is_small or has_floor_winding_through
        is_too_large[region] = not is_top[region]
    return is_top | (
        is_too_large & ~_mark_wider_than(region_context, is_too_large, MAX_WALL_TOP_WIDTH)
    )


def _is_raised_ground(
    region_context: RegionContext, region: int, region_drops: TopDrops, height_fields: Int32
) -> bool:
    """Return whether a region is raised ground: a part of a height field with lower ground beside.

    A region is raised ground if it belongs to a height field, and more than half of its drops lead
    to other regions of that height field.

    Args:
        region_context: all regions.
        region: the region's id.
        region_drops: the drops from the region.
        height_fields: the ids of the geoms that are height fields, shape (n,).
    """
    geom = _main_geom(region_context, region)
    if geom not in height_fields:
        return False
    num_drops_on_field = sum(
        num_drops
        for floor_region, num_drops in region_drops.num_drops_to_region.items()
        if _main_geom(region_context, floor_region) == geom
    )
    return 2 * num_drops_on_field > region_drops.num_drops_to_region.total()


def _main_geom(region_context: RegionContext, region: int) -> int:
    """Return the id of the geom that most surfaces of a region belong to."""
    geoms, num_surfaces = np.unique(
        region_context.regions.surfaces_of(region).geom, return_counts=True
    )
    return int(geoms[num_surfaces.argmax()])


def _mark_wider_than(region_context: RegionContext, is_candidate: Bool, width: float) -> Bool:
    """Mark the candidates that are wider than a width [m] at some place.

    A region is that wide if a cell of it is left when it is shrunk by half of the width.
    """
    if not is_candidate.any():
        return is_candidate
    one_cell_limits = {"min_area": region_context.regions.lattice.cell_size**2, "shrink": width / 2}
    settings = region_context.settings.model_copy(update=one_cell_limits)
    return find_large_regions(region_context.regions, is_candidate, settings)


def _count_drops(region_context: RegionContext, is_candidate: Bool) -> dict[int, TopDrops]:
    """Count how many edges of each candidate drop to each of the regions below it.

    Args:
        region_context: all regions with their edges.
        is_candidate: the regions that may be tops, shape (regions,), bool.

    Returns:
        Id of the candidate -> its drops.
    """
    if not is_candidate.any():
        return {}
    regions = region_context.regions
    edges = region_context.select_edges(is_candidate, region_context.num_cells_beyond)
    has_floor_below = np.asarray((~np.isnan(edges.floors_below)).any(axis=1))
    is_in_hole = find_hole_edges(edges, regions.lattice)
    # drop the regions that have too few floors below their outline, to classify fewer edges
    may_region_continue = (edges.cells_beyond[:, 0] < 0) & region_context.is_cropped[
        edges.direction
    ]
    is_surely_outline = ~may_region_continue & ~is_in_hole
    max_drop_fraction = region_context.compute_edge_fraction(
        edges, has_floor_below, is_surely_outline | has_floor_below
    )
    can_drop_enough = ~(max_drop_fraction < MIN_DROP_SHARE)
    is_edge_of_possible_top = can_drop_enough[edges.region]
    edges = edges.select(is_edge_of_possible_top)
    is_in_hole = is_in_hole[is_edge_of_possible_top]
    endings = region_context.classify_edges(edges)
    is_drop = endings.ending == DROP
    # edges in holes without a drop are around things that stand on the region, such as pillows
    is_counted = endings.is_beyond_known & (~is_in_hole | is_drop)
    may_be_top = region_context.compute_edge_fraction(edges, is_drop, is_counted) >= MIN_DROP_SHARE
    drops_by_region = {}
    for region in np.flatnonzero(is_candidate).tolist():
        is_of_region = edges.region == region
        floor_heights = np.sort(endings.floor_height[is_of_region & is_drop])
        num_drops_to_region = Counter[int]()
        num_hole_drops_to_region = Counter[int]()
        if may_be_top[region] and len(floor_heights):
            # the median; the lower one of the two middle heights
            floor_height = float(floor_heights[(len(floor_heights) - 1) // 2])
            if (
                _count_cells_over_room(region_context, region, floor_height)
                <= MAX_SHARE_OVER_ROOM * regions.num_surfaces[region]
            ):
                num_drops_to_region.update(endings.floor_region[is_of_region & is_drop].tolist())
                num_hole_drops_to_region.update(
                    endings.floor_region[is_of_region & is_drop & is_in_hole].tolist()
                )
        num_outline_edges = int(np.count_nonzero(~is_in_hole[is_of_region]))
        drops_by_region[region] = TopDrops(
            num_drops_to_region, num_hole_drops_to_region, num_outline_edges
        )
    return drops_by_region


def _count_cells_over_room(region_context: RegionContext, region: int, floor_height: float) -> int:
    """Count a region's cells under which an agent has room.

    An agent has room if a region lies below the cell, at most a step lower than the floor beside
    the region. It also has room if nothing is in its way there: between a step and the agent's
    height over the height of that floor.

    Args:
        region_context: all regions, and the hits of all columns.
        region: the region's id.
        floor_height: the height of the floor beside it [m].
    """
    region_surfaces = region_context.regions.surfaces_of(region)
    cells = region_surfaces.cell
    max_step = region_context.agent.traversable_floor_height
    labelled_surfaces = region_context.regions.label_surfaces(region_context.is_large)
    surface_below, _ = find_highest_below(labelled_surfaces, cells, region_surfaces.z)
    has_floor = (surface_below >= 0) & (
        labelled_surfaces.surfaces.z[surface_below] >= floor_height - max_step - LIMIT_SLACK
    )
    is_blocked = np.zeros(len(cells), dtype=np.bool_)
    run_in_chunks(
        find_blocked_lines,
        len(cells),
        cells,
        np.full(len(cells), floor_height + max_step + TOUCH_DEPTH),
        np.full(len(cells), floor_height + region_context.agent.height - TOUCH_DEPTH),
        region_context.columns.columns_at(cells).hits,
        is_blocked,
        min_chunk_size=MIN_LINES_PER_THREAD,
    )
    return int(np.count_nonzero(has_floor | ~is_blocked))


def _find_roofs(
    region_context: RegionContext, is_candidate: Bool, fraction_over_regions: Float
) -> Bool:
    """Find the regions that are roofs: open to the sky, over a floor, and without walls.

    At least half of a roof lies over a floor or furniture; or a tenth does, and two thirds lie over
    a floor, over a wall, or within 1.5 m of either (eaves). A region with walls along more than
    half of its outline is no roof, but a storey drawn without its ceiling. Walls are as high as the
    agent, and at least 1.5 m; parapets are lower. A region that the lattice crops all around is no
    roof, as its walls are unknown.

    Args:
        region_context: all regions with their edges.
        is_candidate: the large regions that are open to the sky, shape (regions,).
        fraction_over_regions: the fraction of each region's area that lies over other regions, from
            0 to 1, shape (regions,).

    Returns:
        A mask, shape (regions,), bool.
    """
    is_less_than_half_over = is_candidate & (fraction_over_regions < MIN_SHARE_OVER_FLOOR)
    is_over_walls = _mark_over_walls(region_context, is_less_than_half_over)
    return _mark_without_walls(
        region_context, is_candidate & (~is_less_than_half_over | is_over_walls)
    )


def _mark_without_walls(region_context: RegionContext, is_candidate: Bool) -> Bool:
    """Mark the candidates with walls along at most half of their outline.

    Walls up to `floors.shrink` inside of the outline are counted, too.

    Args:
        region_context: all regions with their edges.
        is_candidate: the regions that may be roofs, shape (regions,), bool.

    Returns:
        A mask, shape (regions,), bool.
    """
    if not is_candidate.any():
        return is_candidate
    min_wall_height = max(region_context.agent.height, MIN_WALL_HEIGHT)
    agent = region_context.agent.model_copy(update={"height": min_wall_height})
    lattice = region_context.regions.lattice
    edges = _select_outer_edges(region_context, is_candidate, num_cells_beyond=0)
    innermost_distance = -int(np.ceil(region_context.settings.shrink / lattice.cell_size))
    # from the innermost cells near an edge to those just beyond it
    cells_by_distance = [
        find_neighbor_cells(lattice, edges.cell, edges.direction, distance)
        for distance in range(innermost_distance, 2)
    ]
    all_near_cells = np.concatenate(cells_by_distance)
    region_context.cast_ahead(all_near_cells[all_near_cells >= 0])
    ending = region_context.classify_barriers(edges, agent)
    is_beyond_known = region_context.mark_known_beyond(ending, edges.direction)
    # `classify_barriers` has tested the cells at the edge and beyond it
    for cells in cells_by_distance[-3::-1]:
        edge_indices = np.flatnonzero(is_beyond_known & (ending != WALL) & (cells >= 0))
        for height_range in make_probe_ranges(agent):
            is_blocked = region_context.is_occupied(
                cells[edge_indices], edges.z[edge_indices], height_range
            )
            edge_indices = edge_indices[is_blocked]
        ending[edge_indices] = WALL
    return is_candidate & (
        region_context.compute_edge_fraction(edges, ending == WALL, is_beyond_known)
        <= MAX_WALL_SHARE
    )


def _select_outer_edges(
    region_context: RegionContext, is_selected: Bool, num_cells_beyond: int
) -> RegionEdges:
    """Return the edges of regions at their outer rims, not those at the rims of holes.

    Args:
        region_context: all regions with their edges.
        is_selected: the regions, shape (regions,), bool.
        num_cells_beyond: how many cells beyond an edge to search for lower floors.
    """
    edges = region_context.select_edges(is_selected, num_cells_beyond)
    return edges.select(~find_hole_edges(edges, region_context.regions.lattice))


def _find_shelves(region_context: RegionContext, is_candidate: Bool) -> Bool:
    """Mark the candidates that are shelves.

    A shelf is nowhere deeper than 2.5 m (a mezzanine is deeper). More than half of its outline
    drops to a floor (of a gallery from wall to wall, less does).

    Args:
        region_context: all regions with their edges.
        is_candidate: the large regions that lie over floors and are covered, shape (regions,),
            bool.

    Returns:
        A mask, shape (regions,), bool.
    """
    is_candidate = is_candidate & ~_mark_wider_than(region_context, is_candidate, MAX_SHELF_DEPTH)
    if not is_candidate.any():
        return is_candidate
    edges = _select_outer_edges(region_context, is_candidate, region_context.num_cells_beyond)
    endings = region_context.classify_edges(edges)
    drop_fraction = region_context.compute_edge_fraction(
        edges, endings.ending == DROP, endings.is_beyond_known
    )
    return is_candidate & (drop_fraction > MIN_SHELF_DROP_SHARE)


def _mark_over_walls(region_context: RegionContext, is_candidate: Bool) -> Bool:
    """Mark the candidates that lie mostly over other regions or walls, or near these.

    At least two thirds of their cells are over another region or over the top of a wall, or within
    1.5 m (along x and along y) of such a cell.

    Args:
        region_context: all regions, and the hits of all columns.
        is_candidate: the regions that may be roofs, shape (regions,), bool.

    Returns:
        A mask, shape (regions,), bool.
    """
    is_over_walls = np.zeros_like(is_candidate)
    if not is_candidate.any():
        return is_over_walls
    regions = region_context.regions
    lattice = regions.lattice
    eaves_depth_in_cells = int(EAVES_DEPTH / lattice.cell_size + LIMIT_SLACK)
    # all regions count, also furniture
    labelled_surfaces = regions.label_surfaces(np.ones_like(is_candidate))
    region_ids = np.flatnonzero(is_candidate)
    for region, region_surfaces in zip(region_ids, regions.list_surfaces(region_ids), strict=True):
        _, region_below = find_highest_below(
            labelled_surfaces, region_surfaces.cell, region_surfaces.z
        )
        is_over_region = (region_below >= 0) & (region_below != region)
        is_over_region_or_wall = np.zeros(lattice.shape, dtype=np.bool_)
        is_over_region_or_wall.flat[region_surfaces.cell] = (
            mark_over_wall_tops(region_context, region_surfaces) | is_over_region
        )
        # dilate by a square, first along one axis, then along the other
        for mask in (is_over_region_or_wall, is_over_region_or_wall.T):
            depth = min(eaves_depth_in_cells, len(mask) - 1)
            dilated_by = 0
            while dilated_by < depth:
                # at most one cell more than so far, so that none in between is left out
                more = min(dilated_by + 1, depth - dilated_by)
                mask[more:] |= mask[:-more]
                mask[:-more] |= mask[more:]
                dilated_by += more
        is_over_walls[region] = (
            is_over_region_or_wall.flat[region_surfaces.cell].mean() >= MIN_SHARE_OVER_WALLS
        )
    return is_over_walls


def mark_over_wall_tops(region_context: RegionContext, roof_surfaces: RegionSurfaces) -> Bool:
    """Mark the surfaces of a roof that lie on a wall: its top touches the roof, or lies within it.

    Args:
        region_context: the hits of all columns, and the agent.
        roof_surfaces: the surfaces of the roof.

    Returns:
        A mask, shape (surfaces,), bool.
    """
    cell_ids = roof_surfaces.cell
    columns = region_context.columns.columns_at(cell_ids)
    first_hit = columns.start[cell_ids]
    end_hit = columns.start[cell_ids + 1]
    is_over_wall_top = np.zeros(len(cell_ids), dtype=np.bool_)
    # all pairs of a hit and the next one above it
    for k in range(int((end_hit - first_hit).max(initial=0)) - 1):
        indices_with_pair = np.flatnonzero(first_hit + k + 1 < end_hit)
        lower_hit = first_hit[indices_with_pair] + k
        lower_z = columns.z[lower_hit]
        height_difference = columns.z[lower_hit + 1] - lower_z
        lower_faces_up = columns.normal[lower_hit, 2] > 0
        upper_faces_up = columns.normal[lower_hit + 1, 2] > 0
        # at one height, the roof's lower side may stand before the wall's top
        max_height_difference = np.where(
            lower_faces_up, region_context.agent.traversable_floor_height, SAME_HEIGHT
        )
        is_wall_top = (height_difference < max_height_difference) & (
            lower_faces_up | upper_faces_up
        )
        is_over_wall_top[indices_with_pair] |= is_wall_top & (
            lower_z < roof_surfaces.z[indices_with_pair] - SAME_HEIGHT
        )
    return is_over_wall_top


def mark_reported_roofs(region_context: RegionContext, is_roof: Bool, is_floor: Bool) -> Bool:
    """Mark the roofs to report: those that may have been meant as floors.

    These have more than 4/3 of the largest floor's area; or they have at least 50 m² and no walls
    under them, as decks do.

    Args:
        region_context: all regions.
        is_roof: which regions are roofs, shape (regions,).
        is_floor: which regions are floors, shape (regions,); at least one is True.

    Returns:
        A mask, shape (regions,), bool.
    """
    num_surfaces = region_context.regions.num_surfaces
    is_reported: Bool = is_roof & (
        num_surfaces > REPORTED_ROOF_RATIO * num_surfaces[is_floor].max()
    )
    area = num_surfaces * region_context.regions.lattice.cell_size**2
    is_large = is_roof & (area >= REPORTED_ROOF_AREA - LIMIT_SLACK)
    # a large roof without walls under it may be a deck, which was meant as a floor
    region_ids = np.flatnonzero(is_large & ~is_reported)
    surfaces_by_region = region_context.regions.list_surfaces(region_ids)
    for region, region_surfaces in zip(region_ids, surfaces_by_region, strict=True):
        is_reported[region] = not mark_over_wall_tops(region_context, region_surfaces).any()
    return is_reported
