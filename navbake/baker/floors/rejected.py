"""Which regions are no floors, though they are large enough: tops, shelves and roofs.

A top is the upper side of something that stands on a floor, such as a bed or a block; a shelf hangs
over a floor; a roof lies open to the sky and has no walls around it.
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
    neighbor_cells,
    probe_ranges,
)
from navbake.baker.floors.region_kernels import RegionEdges, RegionSurfaces
from navbake.baker.floors.regions import find_large_regions
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float

# A top drops to a floor along at least this share of its outline
MIN_DROP_SHARE = 0.25
# With room for an agent under more than this share of it, a region is a mezzanine, no top
MEZZANINE_SHARE = 0.5
# Beds, counters and desks are smaller. A larger top has to lie on a floor that is larger [m²]
LARGE_TOP = 6.0
# With a floor beside it that is at most so many times as large as itself, a large region is no top
EQUAL_SIZE = 0.9
# What is nowhere wider is the top of a wall, however large it is [m]
WALL_TOP_WIDTH = 3.0
# At least this share of a roof lies open to the sky: a higher roof's eaves may cover a lower one's
# side, and a carport's roof continues over the tops of walls that are under the roof of the house
SKY_SHARE = 0.5
# At least this share of a roof or of a shelf lies over a floor
OVER_SHARE = 0.5
# Where thick walls and eaves leave less of a roof over a floor: the least share that is over a
# floor, the least share that is over a floor or a wall or near one, and how near that is [m]
MIN_OVER_SHARE = 0.1
WALLED_SHARE = 2 / 3
EAVES_DEPTH = 1.5
# A region is no roof, but a storey without its ceiling, if more than this share of its outline has
# walls; they are higher than the agent, and than parapets, which are at most 1.2 m high [m]
WALL_SHARE = 0.5
MIN_WALL_HEIGHT = 1.5
# A roof is reported if it is this many times as large as the largest floor that remains (walls and
# eaves alone add less than a third); or if it has this area [m²] and no walls under it
REPORTED_ROOF_RATIO = 4 / 3
REPORTED_ROOF_AREA = 50.0
# No shelf is deeper: pallet racks are 1.1 m, or 2.2 m back to back [m]
SHELF_DEPTH = 2.5
# A shelf drops along more than this share of its outline
SHELF_DROP_SHARE = 0.5
# So many cells are worth a call on another thread
MIN_LINES_PER_THREAD = 1000


class RejectedRegions(NamedTuple):
    """The large regions that are no floors; masks of shape (regions,).

    Attributes:
        is_top: whether the region is a top, and no roof.
        is_shelf: whether it is a shelf, and no roof.
        is_roof: whether it is a roof.
    """

    is_top: Bool
    is_shelf: Bool
    is_roof: Bool


def find_rejected_regions(
    context: RegionContext, height_ranges: Sequence[HeightRange]
) -> RejectedRegions:
    """Find the large regions that are no floors.

    A roof that is the only region of the scene, or of a level of the configuration, is a floor
    nevertheless.

    Args:
        context: all regions, and how they end.
        height_ranges: the heights [low, high) of the levels of the configuration [m]; empty if
            levels are to be found.
    """
    regions = context.regions
    is_large = context.is_large
    no_regions = np.zeros(regions.num, dtype=np.bool_)
    is_top = no_regions
    is_shelf = no_regions
    is_roof = no_regions
    stacks = regions.find_stacks()
    size = np.maximum(regions.size, 1)
    sky_share = regions.num_uncovered / size
    # also over furniture: a hall's roof stays over its floor whatever stands there
    num_cells_over = stacks.num_cells * (stacks.upper != stacks.lower)
    over_share = np.bincount(stacks.upper, num_cells_over, regions.num) / size
    if not context.settings.tops:
        is_top = _find_tops(context)
        is_shelf = _find_shelves(
            context, is_large & (sky_share < SKY_SHARE) & (over_share >= OVER_SHARE)
        )
    if not context.settings.roofs:
        may_be_roof = is_large & (sky_share >= SKY_SHARE) & (over_share >= MIN_OVER_SHARE)
        is_roof = _find_roofs(context, may_be_roof, over_share)
    is_floor = is_large & ~(is_top | is_shelf | is_roof)
    if not is_floor.any():
        is_roof = no_regions
    # a level of the configuration keeps its roof if it has no other floor
    for heights in height_ranges:
        on_level = regions.mark_in_range(is_large, heights)
        if not (on_level & is_floor).any():
            is_roof = is_roof & ~on_level
    return RejectedRegions(is_top & ~is_roof, is_shelf & ~is_roof, is_roof)


class TopDrops(NamedTuple):
    """How many edges of a region drop to each of the regions below it.

    Attributes:
        drops_to: by region below, how many edges drop to it; empty where `_find_tops` rules out a
            top by its outline, or by the free space under it.
        drops_in_holes: like `drops_to`, but only for edges at the rims of holes.
        outline: how many edges are at the outer rim.
    """

    drops_to: Counter[int]
    drops_in_holes: Counter[int]
    outline: int


def _find_tops(context: RegionContext) -> Bool:
    """Find the tops of what stands on a floor: beds, blocks, counters, walls that are metres thick.

    A region is a top if

    - at least a quarter of its outline drops to floors, see `RegionContext.classify_edges`; edges
      at the rims of holes are a part of the outline only if they drop;
    - it has at most 6 m², is nowhere wider than 3 m, or drops to a floor larger than 0.9 of its
      size: otherwise it is the ground beside a pool, a ditch or a track bed. It can also be a top
      if a floor winds through it: the drops to that floor, from the rims of its holes and of the
      objects in these, are longer than its outline;
    - under at most half of it there is room for an agent, measured from the height of that floor
      up; under a mezzanine there is more.
    """
    regions = context.regions
    num_drops = np.bincount(context.edges.region, context.edges.rows[:, 4], regions.num)
    may_be_top = context.is_large & (num_drops > 0)
    if not context.is_cropped.any():
        # an outline is at least as long as the box around it: most regions drop along less of it
        height = regions.box[:, 2] - regions.box[:, 0]
        width = regions.box[:, 3] - regions.box[:, 1]
        may_be_top &= num_drops >= MIN_DROP_SHARE * 2 * (height + width)
    drops_by_region = _count_drops(context, may_be_top)
    drops_from_all = Counter[int]()  # to each region
    for drops in drops_by_region.values():
        drops_from_all.update(drops.drops_to)
    is_top = np.zeros(regions.num, dtype=np.bool_)
    is_too_large = np.zeros(regions.num, dtype=np.bool_)
    for region, drops in drops_by_region.items():
        if not drops.drops_to:
            continue
        size = regions.size[region]
        is_small = size * regions.lattice.cell_size**2 <= LARGE_TOP
        # or the largest floor that it drops to is larger
        is_small |= regions.size[list(drops.drops_to)].max() > EQUAL_SIZE * size
        # the drops to a floor in its holes, and those of things on that floor
        drops_around_floor = [
            num + drops_from_all[floor] - drops.drops_to[floor]
            for floor, num in drops.drops_in_holes.items()
        ]
        is_wound_through = max(drops_around_floor, default=0) > drops.outline
        is_top[region] = is_small or is_wound_through
        is_too_large[region] = not is_top[region]
    return is_top | (is_too_large & ~_mark_wider_than(context, is_too_large, WALL_TOP_WIDTH))


def _mark_wider_than(context: RegionContext, candidates: Bool, width: float) -> Bool:
    """Mark those of some regions that are somewhere wider than a width [m]."""
    if not candidates.any():
        return candidates
    one_cell = {"min_area": context.regions.lattice.cell_size**2, "shrink": width / 2}
    settings = context.settings.model_copy(update=one_cell)
    return find_large_regions(context.regions, candidates, settings)


def _count_drops(context: RegionContext, candidates: Bool) -> dict[int, TopDrops]:
    """Count the drops of some regions to others, by region."""
    if not candidates.any():
        return {}
    regions = context.regions
    edges = context.select_edges(candidates, context.reach)
    has_floor = np.asarray((~np.isnan(edges.floors_below)).any(axis=1))
    in_hole = find_hole_edges(edges, regions.lattice)
    # without the regions that have too few floors below their outline, to classify fewer edges
    may_continue = (edges.cells_beyond[:, 0] < 0) & context.is_cropped[edges.direction]
    is_certain = ~may_continue & ~in_hole
    share = context.share_of_edges(edges, has_floor, is_certain | has_floor)
    drops_enough = ~(share < MIN_DROP_SHARE)
    is_possible = drops_enough[edges.region]
    edges = edges.select(is_possible)
    in_hole = in_hole[is_possible]
    endings = context.classify_edges(edges)
    drops = endings.kind == DROP
    # other holes are where things stand on the region, such as pillows
    is_known = endings.is_known & (~in_hole | drops)
    may_be_top = context.share_of_edges(edges, drops, is_known) >= MIN_DROP_SHARE
    drops_by_region = {}
    for region in np.flatnonzero(candidates).tolist():
        is_of_region = edges.region == region
        floor_heights = np.sort(endings.floor_height[is_of_region & drops])
        drops_to = Counter[int]()
        drops_in_holes = Counter[int]()
        if may_be_top[region] and len(floor_heights):
            # the median, the lower one of two
            floor = float(floor_heights[(len(floor_heights) - 1) // 2])
            if (
                _count_cells_over_room(context, region, floor)
                <= MEZZANINE_SHARE * regions.size[region]
            ):
                drops_to.update(endings.floor_region[is_of_region & drops].tolist())
                drops_in_holes.update(endings.floor_region[is_of_region & drops & in_hole].tolist())
        outline = int(np.count_nonzero(~in_hole[is_of_region]))
        drops_by_region[region] = TopDrops(drops_to, drops_in_holes, outline)
    return drops_by_region


def _count_cells_over_room(context: RegionContext, region: int, floor: float) -> int:
    """Count a region's cells with room for an agent below them.

    The room is at the height of the floor beside the region [m], or higher.
    """
    members = context.regions.surfaces_of(region)
    cells = members.cell
    step = context.agent.traversable_floor_height
    labelled = context.regions.label_surfaces(context.is_large)
    below, _ = find_highest_below(labelled, cells, members.z)
    has_floor = (below >= 0) & (labelled.surfaces.z[below] >= floor - step - LIMIT_SLACK)
    is_blocked = np.zeros(len(cells), dtype=np.bool_)
    run_in_chunks(
        find_blocked_lines,
        len(cells),
        cells,
        np.full(len(cells), floor + step + TOUCH_DEPTH),
        np.full(len(cells), floor + context.agent.height - TOUCH_DEPTH),
        context.columns.covering(cells).hits,
        is_blocked,
        least=MIN_LINES_PER_THREAD,
    )
    return int(np.count_nonzero(has_floor | ~is_blocked))


def _find_roofs(context: RegionContext, candidates: Bool, over_share: Float) -> Bool:
    """Find the regions that are roofs: open to the sky, over a floor, and without walls.

    A storey drawn without its ceiling has walls as high as an agent, and at least 1.5 m, along more
    than half of its outline; parapets are lower. Half of a roof lies over a floor or furniture; or
    two thirds lie over a floor, a wall, or within 1.5 m of one (eaves), and a tenth over a floor.
    Where the lattice crops the scene all around, walls are unknown, and a region is no roof.
    """
    is_half_over = candidates & (over_share < OVER_SHARE)
    is_over_walls = _mark_over_walls(context, is_half_over)
    return _mark_without_walls(context, candidates & (~is_half_over | is_over_walls))


def _mark_without_walls(context: RegionContext, candidates: Bool) -> Bool:
    """Mark the regions with walls along at most half of their outline.

    Walls up to `floors.shrink` inside of the outline are counted, too.
    """
    if not candidates.any():
        return candidates
    height = max(context.agent.height, MIN_WALL_HEIGHT)
    agent = context.agent.model_copy(update={"height": height})
    lattice = context.regions.lattice
    edges = _select_outer_edges(context, candidates, reach=0)
    farthest_in = -int(np.ceil(context.settings.shrink / lattice.cell_size))
    # from the innermost cells near an edge to those just beyond it
    cells_near = [
        neighbor_cells(lattice, edges.cell, edges.direction, steps)
        for steps in range(farthest_in, 2)
    ]
    all_cells_near = np.concatenate(cells_near)
    context.cast_ahead(all_cells_near[all_cells_near >= 0])
    kind = context.classify_barriers(edges, agent)
    is_known = context.mark_known(kind, edges.direction)
    # `classify_barriers` has tested the cells at the edge and beyond it
    for cells in cells_near[-3::-1]:
        edges_near = np.flatnonzero(is_known & (kind != WALL) & (cells >= 0))
        for heights in probe_ranges(agent):
            is_met = context.is_occupied(cells[edges_near], edges.z[edges_near], heights)
            edges_near = edges_near[is_met]
        kind[edges_near] = WALL
    return candidates & (context.share_of_edges(edges, kind == WALL, is_known) <= WALL_SHARE)


def _select_outer_edges(context: RegionContext, candidates: Bool, reach: int) -> RegionEdges:
    """Return the edges of some regions without those of their holes."""
    edges = context.select_edges(candidates, reach)
    return edges.select(~find_hole_edges(edges, context.regions.lattice))


def _find_shelves(context: RegionContext, candidates: Bool) -> Bool:
    """Find the regions that are shelves.

    A shelf is nowhere deeper than 2.5 m (a mezzanine is deeper), and more than half of its outline
    drops to a floor (less does for a gallery from wall to wall).
    """
    candidates = candidates & ~_mark_wider_than(context, candidates, SHELF_DEPTH)
    if not candidates.any():
        return candidates
    edges = _select_outer_edges(context, candidates, context.reach)
    endings = context.classify_edges(edges)
    drop_share = context.share_of_edges(edges, endings.kind == DROP, endings.is_known)
    return candidates & (drop_share > SHELF_DROP_SHARE)


def _mark_over_walls(context: RegionContext, candidates: Bool) -> Bool:
    """Mark the regions that lie over others, over walls, or within `EAVES_DEPTH` of walls."""
    is_over_walls = np.zeros_like(candidates)
    if not candidates.any():
        return is_over_walls
    regions = context.regions
    lattice = regions.lattice
    reach = int(EAVES_DEPTH / lattice.cell_size + LIMIT_SLACK)
    # all regions count, also furniture
    labelled = regions.label_surfaces(np.ones_like(candidates))
    for region in np.flatnonzero(candidates).tolist():
        members = regions.surfaces_of(region)
        _, region_below = find_highest_below(labelled, members.cell, members.z)
        is_over_region = (region_below >= 0) & (region_below != region)
        is_over = np.zeros(lattice.shape, dtype=np.bool_)
        is_over.flat[members.cell] = mark_over_wall_tops(context, members) | is_over_region
        # dilate by a square, first along one axis, then along the other
        for grid in (is_over, is_over.T):
            before = grid.copy()
            for k in range(1, min(reach, len(grid) - 1) + 1):
                grid[k:] |= before[:-k]
                grid[:-k] |= before[k:]
        is_over_walls[region] = is_over.flat[members.cell].mean() >= WALLED_SHARE
    return is_over_walls


def mark_over_wall_tops(context: RegionContext, members: RegionSurfaces) -> Bool:
    """Mark the surfaces of a roof that lie over a wall which carries the roof or ends within it.

    Args:
        context: the hits of all columns, and the agent.
        members: surfaces of a region.

    Returns:
        A mask, shape (surfaces,), bool.
    """
    cell = members.cell
    columns = context.columns.covering(cell)
    first = columns.start[cell]
    end = columns.start[cell + 1]
    is_over = np.zeros(len(cell), dtype=np.bool_)
    # pairs of hits next above each other
    for k in range(int((end - first).max(initial=0)) - 1):
        cell_with_pair = np.flatnonzero(first + k + 1 < end)
        lower = first[cell_with_pair] + k
        lower_z = columns.z[lower]
        gap = columns.z[lower + 1] - lower_z
        lower_faces_up = columns.normal[lower, 2] > 0
        upper_faces_up = columns.normal[lower + 1, 2] > 0
        # at one height, the roof's lower side may stand before the wall's top
        limit = np.where(lower_faces_up, context.agent.traversable_floor_height, SAME_HEIGHT)
        is_wall_top = (gap < limit) & (lower_faces_up | upper_faces_up)
        is_over[cell_with_pair] |= is_wall_top & (lower_z < members.z[cell_with_pair] - SAME_HEIGHT)
    return is_over


def mark_reported_roofs(context: RegionContext, is_roof: Bool, is_floor: Bool) -> Bool:
    """Mark the roofs to report: roofs clearly larger than any floor, and large roofs without walls.

    Args:
        context: all regions.
        is_roof: the roofs, shape (regions,).
        is_floor: the floors, shape (regions,), one at least.
    """
    size = context.regions.size
    is_reported: Bool = is_roof & (size > REPORTED_ROOF_RATIO * size[is_floor].max())
    area = size * context.regions.lattice.cell_size**2
    is_large = is_roof & (area >= REPORTED_ROOF_AREA - LIMIT_SLACK)
    # a large roof without walls under it may be a deck, which was meant as a floor
    for region in np.flatnonzero(is_large & ~is_reported).tolist():
        members = context.regions.surfaces_of(region)
        is_reported[region] = not mark_over_wall_tops(context, members).any()
    return is_reported
