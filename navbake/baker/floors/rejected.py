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
    neighbor_cells,
    probe_ranges,
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
    context: RegionContext, height_ranges: Sequence[HeightRange], height_fields: Int32
) -> RejectedRegions:
    """Find the large regions that are no floors.

    If no other floor is left in the scene, or on a level of the configuration, the roofs there
    count as floors.

    Args:
        context: all regions with their edges.
        height_ranges: the heights [low, high) of the levels of the configuration [m]; empty if
            it has none.
        height_fields: the ids of the geoms that are height fields, shape (n,).
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
    # `over_share` is the fraction of a region's area that lies over others. Furniture counts, too:
    # a hall's roof lies over its floor whatever stands there
    num_cells_over = stacks.num_cells * (stacks.upper != stacks.lower)
    over_share = np.bincount(stacks.upper, num_cells_over, regions.num) / size
    if not context.settings.tops:
        is_top = _find_tops(context, height_fields)
        is_shelf = _find_shelves(
            context, is_large & (sky_share < MIN_SKY_SHARE) & (over_share >= MIN_SHARE_OVER_FLOOR)
        )
    if not context.settings.roofs:
        may_be_roof = (
            is_large
            & (sky_share >= MIN_SKY_SHARE)
            & (over_share >= MIN_SHARE_OVER_FLOOR_WITH_WALLS)
        )
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
        drops_to: id of the region below -> how many edges drop to it. Empty if the region can't be
            a top because it has too few drops, or room for an agent under it, see `_find_tops`.
        drops_in_holes: like `drops_to`, but only for edges at the rims of holes.
        outline: how many edges the region's outer rim has.
    """

    drops_to: Counter[int]
    drops_in_holes: Counter[int]
    outline: int


def _find_tops(context: RegionContext, height_fields: Int32) -> Bool:
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
      - it drops to a floor that winds through it. More edges drop to this floor, from the rims of
        the region's holes and from other regions, than the region's outer rim has.

    - It is no raised ground: a part of a height field that drops to lower ground of the same height
      field has nothing under it.

    Args:
        context: all regions with their edges.
        height_fields: the ids of the geoms that are height fields, shape (n,).

    Returns:
        A mask, shape (regions,), bool.
    """
    regions = context.regions
    num_drops = np.bincount(context.edges.region, context.edges.has_drop, regions.num)
    may_be_top = context.is_large & (num_drops > 0)
    if not context.is_cropped.any():
        # an outline is at least as long as the box around it: most regions drop along less of it
        height = regions.box[:, 2] - regions.box[:, 0]
        width = regions.box[:, 3] - regions.box[:, 1]
        may_be_top &= num_drops >= MIN_DROP_SHARE * 2 * (height + width)
    drops_by_region = _count_drops(context, may_be_top)
    drops_from_all = Counter[int]()  # region below -> drops to it from all regions
    for drops in drops_by_region.values():
        drops_from_all.update(drops.drops_to)
    is_top = np.zeros(regions.num, dtype=np.bool_)
    is_too_large = np.zeros(regions.num, dtype=np.bool_)
    for region, drops in drops_by_region.items():
        if not drops.drops_to or _is_plateau(context, region, drops, height_fields):
            continue
        size = regions.size[region]
        is_small = size * regions.lattice.cell_size**2 <= LARGE_TOP_AREA
        # or the largest floor that it drops to is larger
        is_small |= regions.size[list(drops.drops_to)].max() > MIN_FLOOR_RATIO * size
        # for each floor in its holes: the drops to it from these holes, and from other regions
        drops_around_floor = [
            num + drops_from_all[floor] - drops.drops_to[floor]
            for floor, num in drops.drops_in_holes.items()
        ]
        is_wound_through = max(drops_around_floor, default=0) > drops.outline
        is_top[region] = is_small or is_wound_through
        is_too_large[region] = not is_top[region]
    return is_top | (is_too_large & ~_mark_wider_than(context, is_too_large, MAX_WALL_TOP_WIDTH))


def _is_plateau(context: RegionContext, region: int, drops: TopDrops, height_fields: Int32) -> bool:
    """Return whether a region is raised ground: a part of a height field with lower ground beside.

    It is if the region belongs to a height field, and more than half of its drops lead to regions
    of the same height field.

    Args:
        context: all regions.
        region: the region's id.
        drops: the drops from the region.
        height_fields: the ids of the geoms that are height fields, shape (n,).
    """
    geom = _main_geom(context, region)
    if geom not in height_fields:
        return False
    num_on_field = sum(
        num for floor, num in drops.drops_to.items() if _main_geom(context, floor) == geom
    )
    return 2 * num_on_field > drops.drops_to.total()


def _main_geom(context: RegionContext, region: int) -> int:
    """Return the id of the geom that most surfaces of a region belong to."""
    geoms, counts = np.unique(context.regions.surfaces_of(region).geom, return_counts=True)
    return int(geoms[counts.argmax()])


def _mark_wider_than(context: RegionContext, candidates: Bool, width: float) -> Bool:
    """Mark the candidates that are wider than a width [m] at some place.

    A region is that wide if a cell of it is left when it is shrunk by half of the width.
    """
    if not candidates.any():
        return candidates
    one_cell = {"min_area": context.regions.lattice.cell_size**2, "shrink": width / 2}
    settings = context.settings.model_copy(update=one_cell)
    return find_large_regions(context.regions, candidates, settings)


def _count_drops(context: RegionContext, candidates: Bool) -> dict[int, TopDrops]:
    """Count how many edges of each candidate drop to each of the regions below it.

    Args:
        context: all regions with their edges.
        candidates: the regions that may be tops, shape (regions,), bool.

    Returns:
        Id of the candidate -> its drops.
    """
    if not candidates.any():
        return {}
    regions = context.regions
    edges = context.select_edges(candidates, context.num_cells_beyond)
    has_floor = np.asarray((~np.isnan(edges.floors_below)).any(axis=1))
    in_hole = find_hole_edges(edges, regions.lattice)
    # drop the regions that have too few floors below their outline, to classify fewer edges
    may_continue = (edges.cells_beyond[:, 0] < 0) & context.is_cropped[edges.direction]
    is_certain = ~may_continue & ~in_hole
    share = context.share_of_edges(edges, has_floor, is_certain | has_floor)
    drops_enough = ~(share < MIN_DROP_SHARE)
    is_possible = drops_enough[edges.region]
    edges = edges.select(is_possible)
    in_hole = in_hole[is_possible]
    endings = context.classify_edges(edges)
    drops = endings.kind == DROP
    # edges in holes without a drop are around things that stand on the region, such as pillows
    is_known = endings.is_known & (~in_hole | drops)
    may_be_top = context.share_of_edges(edges, drops, is_known) >= MIN_DROP_SHARE
    drops_by_region = {}
    for region in np.flatnonzero(candidates).tolist():
        is_of_region = edges.region == region
        floor_heights = np.sort(endings.floor_height[is_of_region & drops])
        drops_to = Counter[int]()
        drops_in_holes = Counter[int]()
        if may_be_top[region] and len(floor_heights):
            # the median; the lower one of the two middle heights
            floor = float(floor_heights[(len(floor_heights) - 1) // 2])
            if (
                _count_cells_over_room(context, region, floor)
                <= MAX_SHARE_OVER_ROOM * regions.size[region]
            ):
                drops_to.update(endings.floor_region[is_of_region & drops].tolist())
                drops_in_holes.update(endings.floor_region[is_of_region & drops & in_hole].tolist())
        outline = int(np.count_nonzero(~in_hole[is_of_region]))
        drops_by_region[region] = TopDrops(drops_to, drops_in_holes, outline)
    return drops_by_region


def _count_cells_over_room(context: RegionContext, region: int, floor: float) -> int:
    """Count a region's cells under which an agent has room.

    An agent has room if a region lies below the cell, at most a step lower than the floor beside
    the region. It also has room if nothing is in its way there: between a step and the agent's
    height over the height of that floor.

    Args:
        context: all regions, and the hits of all columns.
        region: the region's id.
        floor: the height of the floor beside it [m].
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

    At least half of a roof lies over a floor or furniture; or a tenth does, and two thirds lie over
    a floor, over a wall, or within 1.5 m of either (eaves). A region with walls along more than
    half of its outline is no roof, but a storey drawn without its ceiling. Walls are as high as the
    agent, and at least 1.5 m; parapets are lower. A region that the lattice crops all around is no
    roof, as its walls are unknown.

    Args:
        context: all regions with their edges.
        candidates: the large regions that are open to the sky, shape (regions,).
        over_share: the fraction of each region's area that lies over other regions, from 0 to 1,
            shape (regions,).

    Returns:
        A mask, shape (regions,), bool.
    """
    is_half_over = candidates & (over_share < MIN_SHARE_OVER_FLOOR)
    is_over_walls = _mark_over_walls(context, is_half_over)
    return _mark_without_walls(context, candidates & (~is_half_over | is_over_walls))


def _mark_without_walls(context: RegionContext, candidates: Bool) -> Bool:
    """Mark the candidates with walls along at most half of their outline.

    Walls up to `floors.shrink` inside of the outline are counted, too.

    Args:
        context: all regions with their edges.
        candidates: the regions that may be roofs, shape (regions,), bool.

    Returns:
        A mask, shape (regions,), bool.
    """
    if not candidates.any():
        return candidates
    height = max(context.agent.height, MIN_WALL_HEIGHT)
    agent = context.agent.model_copy(update={"height": height})
    lattice = context.regions.lattice
    edges = _select_outer_edges(context, candidates, num_cells_beyond=0)
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
    return candidates & (context.share_of_edges(edges, kind == WALL, is_known) <= MAX_WALL_SHARE)


def _select_outer_edges(
    context: RegionContext, candidates: Bool, num_cells_beyond: int
) -> RegionEdges:
    """Return the edges of regions at their outer rims, not those at the rims of holes.

    Args:
        context: all regions with their edges.
        candidates: the regions, shape (regions,), bool.
        num_cells_beyond: how many cells beyond an edge to search for lower floors.
    """
    edges = context.select_edges(candidates, num_cells_beyond)
    return edges.select(~find_hole_edges(edges, context.regions.lattice))


def _find_shelves(context: RegionContext, candidates: Bool) -> Bool:
    """Mark the candidates that are shelves.

    A shelf is nowhere deeper than 2.5 m (a mezzanine is deeper). More than half of its outline
    drops to a floor (of a gallery from wall to wall, less does).

    Args:
        context: all regions with their edges.
        candidates: the large regions that lie over floors and are covered, shape (regions,), bool.

    Returns:
        A mask, shape (regions,), bool.
    """
    candidates = candidates & ~_mark_wider_than(context, candidates, MAX_SHELF_DEPTH)
    if not candidates.any():
        return candidates
    edges = _select_outer_edges(context, candidates, context.num_cells_beyond)
    endings = context.classify_edges(edges)
    drop_share = context.share_of_edges(edges, endings.kind == DROP, endings.is_known)
    return candidates & (drop_share > MIN_SHELF_DROP_SHARE)


def _mark_over_walls(context: RegionContext, candidates: Bool) -> Bool:
    """Mark the candidates that lie mostly over other regions or walls, or near these.

    At least two thirds of their cells are over another region or over the top of a wall, or within
    1.5 m (along x and along y) of such a cell.

    Args:
        context: all regions, and the hits of all columns.
        candidates: the regions that may be roofs, shape (regions,), bool.

    Returns:
        A mask, shape (regions,), bool.
    """
    is_over_walls = np.zeros_like(candidates)
    if not candidates.any():
        return is_over_walls
    regions = context.regions
    lattice = regions.lattice
    num_cells = int(EAVES_DEPTH / lattice.cell_size + LIMIT_SLACK)
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
            for k in range(1, min(num_cells, len(grid) - 1) + 1):
                grid[k:] |= before[:-k]
                grid[:-k] |= before[k:]
        is_over_walls[region] = is_over.flat[members.cell].mean() >= MIN_SHARE_OVER_WALLS
    return is_over_walls


def mark_over_wall_tops(context: RegionContext, members: RegionSurfaces) -> Bool:
    """Mark the surfaces of a roof under which the top of a wall touches the roof or lies within it.

    Args:
        context: the hits of all columns, and the agent.
        members: the surfaces of the roof.

    Returns:
        A mask, shape (surfaces,), bool.
    """
    cell = members.cell
    columns = context.columns.covering(cell)
    first = columns.start[cell]
    end = columns.start[cell + 1]
    is_over = np.zeros(len(cell), dtype=np.bool_)
    # all pairs of a hit and the next one above it
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
    """Mark the roofs to report: those that may have been meant as floors.

    These have more than 4/3 of the largest floor's area; or they have at least 50 m² and no walls
    under them, as decks do.

    Args:
        context: all regions.
        is_roof: which regions are roofs, shape (regions,).
        is_floor: which regions are floors, shape (regions,); at least one is True.

    Returns:
        A mask, shape (regions,), bool.
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
