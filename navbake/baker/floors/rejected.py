"""Which regions are no floors, though they are large enough: tops, shelves and roofs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT, TOUCH_DEPTH
from navbake.baker.floors.member_kernels import Edges, Members
from navbake.baker.floors.outline import (
    DROP,
    WALL,
    Site,
    beside,
    find_below,
    find_holes,
    probe_bands,
)
from navbake.baker.floors.regions import find_large_regions
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float

# A top drops to a floor along at least this share of its outline
DROP_SHARE = 0.25
# With room for an agent under more than this share of it, a region is a mezzanine, no top
ROOM_SHARE = 0.5
# Beds, counters and desks are smaller. A larger top has to lie on a floor that is larger [m²]
LARGE_TOP = 6.0
# Of a top and a floor beside it that has more than this share of its size, the top is none
EQUAL = 0.9
# What is nowhere wider is the top of a wall, however large it is [m]
WIDE_TOP = 3.0
# The share of a roof that lies open to the sky: a higher one's eaves may cover a lower one's side,
# and a carport's roof goes on over the tops of walls that are under the roof of the house
SKY_SHARE = 0.5
# The share of a roof or a shelf that lies over a floor; and the share of its outline that has
# walls if it is a storey, or that drops if it is a shelf
HALF = 0.5
# Where thick walls and eaves leave less of a roof over a floor: the least share that does, and the
# share that lies over a floor or a wall, or at most so far from one [m]
FLOOR_SHARE = 0.1
WALLED_SHARE = 2 / 3
EAVES = 1.5
# Parapets are at most 1.2 m high; a storey's walls are higher than this, and than the agent [m]
MIN_WALL = 1.5
# A roof is reported if it is this many times as large as the largest floor that is left (walls and
# eaves alone add less than a third); or if it has this area and no walls under it [m²]
LARGE_ROOF = 4 / 3
TOLD_ROOF = 50.0
# No shelf is deeper: pallet racks are 1.1 m, or 2.2 m back to back [m]
SHELF_DEPTH = 2.5


class Rejected(NamedTuple):
    """The large regions that are no floors: masks, shape (regions,); roofs are neither of the
    others.

    Attributes:
        tops, shelves, roofs: which regions are such.
    """

    tops: Bool
    shelves: Bool
    roofs: Bool


def find_rejected(site: Site, spans: Sequence[tuple[float, float]]) -> Rejected:
    """Find the large regions that are no floors.

    A roof that is the only region of the scene, or of a given level, is a floor nevertheless.

    Args:
        spans: see `given_spans` [m].
    """
    regions = site.regions
    is_large = site.is_large
    tops = shelves = roofs = none = np.zeros(regions.num, dtype=np.bool_)
    above, below, count = regions.stacks()
    size = np.maximum(regions.size, 1)
    sky = regions.tops / size
    # also over furniture: a hall's roof stays over its floor whatever stands there
    over = np.bincount(above, count * (above != below), regions.num) / size
    if not site.settings.tops:
        tops = _find_tops(site)
        shelves = _find_shelves(site, is_large & (sky < SKY_SHARE) & (over >= HALF))
    if not site.settings.roofs:
        roofs = _find_roofs(site, is_large & (sky >= SKY_SHARE) & (over >= FLOOR_SHARE), over)
    is_floor = is_large & ~(tops | shelves | roofs)
    if not is_floor.any():
        roofs = none
    for low, high in spans:
        on_level = regions.between(is_large, low, high)
        if not (on_level & is_floor).any():
            roofs = roofs & ~on_level
    return Rejected(tops & ~roofs, shelves & ~roofs, roofs)


class TopDrops(NamedTuple):
    """How a region that may be a top drops to others.

    Attributes:
        drops_to: how many of its edges drop to each other region; nothing where `_find_tops` rules
            out a top by its outline or by the room under it.
        in_holes: the same of edges at the rims of holes alone.
        outline: how many edges it has elsewhere.
    """

    drops_to: Counter[int]
    in_holes: Counter[int]
    outline: int


def _find_tops(site: Site) -> Bool:
    """Find the tops of what stands on a floor: beds, blocks, counters, walls that are metres thick.

    A region is a top if

    - at least a quarter of its outline drops to floors, see `Site.endings`; of the rims of holes
      only what drops counts;
    - it has at most 6 m², is nowhere wider than 3 m, or drops to a floor larger than 0.9 of its
      size: else it is the ground beside a pool, a ditch or a track bed. Or a floor winds through
      it: the drops to that floor, from the rims of its holes and of the things in these, are longer
      than its outline;
    - under at most half of it, from the height of that floor up, is room for an agent, as under a
      mezzanine.
    """
    regions = site.regions
    drops = np.bincount(site.edges.region, site.edges.rows[:, 4], regions.num)
    may_drop = site.is_large & (drops > 0)
    if not site.cropped.any():
        # an outline is at least as long as the box around it: most regions drop along less of it
        height = regions.box[:, 2] - regions.box[:, 0]
        width = regions.box[:, 3] - regions.box[:, 1]
        may_drop &= drops >= DROP_SHARE * 2 * (height + width)
    drops_of = _list_drops(site, may_drop)
    into_holes = Counter[int]()  # drops to each region from all those that drop to it
    for top in drops_of.values():
        into_holes.update(top.drops_to)
    is_top = np.zeros(regions.num, dtype=np.bool_)
    is_too_large = np.zeros(regions.num, dtype=np.bool_)
    for region, top in drops_of.items():
        if not top.drops_to:
            continue
        size = regions.size[region]
        is_small = size * regions.lattice.cell_size**2 <= LARGE_TOP
        is_small |= regions.size[list(top.drops_to)].max() > EQUAL * size
        drops_around = [
            num + into_holes[floor] - top.drops_to[floor] for floor, num in top.in_holes.items()
        ]
        winds = max(drops_around, default=0) > top.outline
        is_top[region] = is_small or winds
        is_too_large[region] = not is_top[region]
    return is_top | (is_too_large & ~_are_wide(site, is_too_large, WIDE_TOP))


def _are_wide(site: Site, candidates: Bool, width: float) -> Bool:
    """Which of some regions are somewhere wider than a width [m]."""
    if not candidates.any():
        return candidates
    wide = {"min_area": site.regions.lattice.cell_size**2, "shrink": width / 2}
    return find_large_regions(site.regions, candidates, site.settings.model_copy(update=wide))


def _list_drops(site: Site, candidates: Bool) -> dict[int, TopDrops]:
    """How some regions drop to others, by region."""
    if not candidates.any():
        return {}
    regions = site.regions
    edges = site.edges_of(candidates, site.reach)
    has_floor = np.asarray((~np.isnan(edges.floors)).any(axis=1))
    in_hole = find_holes(edges, regions.lattice)
    certain = ((edges.cells[:, 0] >= 0) | ~site.cropped[edges.way]) & ~in_hole
    drops_enough = ~(site.share(edges, has_floor, certain | has_floor) < DROP_SHARE)
    is_possible = drops_enough[edges.region]
    edges = edges.only(is_possible)
    in_hole = in_hole[is_possible]
    endings = site.endings(edges)
    drops = endings.kind == DROP
    # other holes are where things stand on the region, such as pillows
    is_known = endings.is_known & (~in_hole | drops)
    may_be_top = site.share(edges, drops, is_known) >= DROP_SHARE
    drops_of = {}
    for region in np.flatnonzero(candidates).tolist():
        of_region = edges.region == region
        landing = np.sort(endings.landing[of_region & drops])
        drops_to = Counter[int]()
        in_holes = Counter[int]()
        if may_be_top[region] and len(landing):
            # the lower one of two in the middle
            floor = float(landing[(len(landing) - 1) // 2])
            if _count_over_room(site, region, floor) <= ROOM_SHARE * regions.size[region]:
                drops_to.update(endings.floor[of_region & drops].tolist())
                in_holes.update(endings.floor[of_region & drops & in_hole].tolist())
        outline = int(np.count_nonzero(~in_hole[of_region]))
        drops_of[region] = TopDrops(drops_to, in_holes, outline)
    return drops_of


def _count_over_room(site: Site, region: int, floor: float) -> int:
    """Count a region's cells with room for an agent below, on the `floor` beside [m] or higher."""
    members = site.regions.members(region)
    cells = members.cell
    step = site.agent.traversable_floor_height
    labelled = site.regions.labelled(site.is_large)
    place, _ = find_below(labelled, cells, members.z)
    has_floor = (place >= 0) & (labelled.surfaces.z[place] >= floor - step - LIMIT_SLACK)
    blocked = np.zeros(len(cells), dtype=np.bool_)
    run_in_chunks(
        find_blocked_lines,
        len(cells),
        cells,
        np.full(len(cells), floor + step + TOUCH_DEPTH),
        np.full(len(cells), floor + site.agent.height - TOUCH_DEPTH),
        site.columns.covering(cells).hits,
        blocked,
        least=1000,
    )
    return int(np.count_nonzero(has_floor | ~blocked))


def _find_roofs(site: Site, candidates: Bool, over: Float) -> Bool:
    """Find the regions that are roofs: open to the sky, over a floor, and without walls.

    A storey drawn without its ceiling has walls as high as an agent, and at least 1.5 m, along more
    than half of its outline; parapets are lower. Half of a roof lies over a floor or furniture; or
    two thirds lie over a floor, a wall, or within 1.5 m of one (eaves), and a tenth over a floor.
    Where the lattice crops the scene all around, walls are unknown, and a region is no roof.
    """
    half_over = candidates & (over < HALF)
    over_walls = _lie_over_walls(site, half_over)
    return _have_no_walls(site, candidates & (~half_over | over_walls))


def _have_no_walls(site: Site, candidates: Bool) -> Bool:
    """Which regions have walls along at most half of their outline, `floors.shrink` from it."""
    if not candidates.any():
        return candidates
    agent = site.agent.model_copy(update={"height": max(site.agent.height, MIN_WALL)})
    lattice = site.regions.lattice
    edges = _outer_edges(site, candidates, reach=0)
    farthest_in = -int(np.ceil(site.settings.shrink / lattice.cell_size))
    # from the innermost cells near an edge to those just beyond it
    cells_near = [beside(lattice, edges.cell, edges.way, k) for k in range(farthest_in, 2)]
    all_near = np.concatenate(cells_near)
    # of all cells at once, as parts of them are asked for below
    site.columns.covering(all_near[all_near >= 0])
    kind = site.barriers(edges, agent)
    is_known = site.is_known(kind, edges.way)
    for cells in cells_near[-3::-1]:
        near = np.flatnonzero(is_known & (kind != WALL) & (cells >= 0))
        for band in probe_bands(agent):
            near = near[site.is_occupied(cells[near], edges.z[near], band)]
        kind[near] = WALL
    return candidates & (site.share(edges, kind == WALL, is_known) <= HALF)


def _outer_edges(site: Site, candidates: Bool, reach: int) -> Edges:
    """The edges of some regions but for those of their holes."""
    edges = site.edges_of(candidates, reach)
    return edges.only(~find_holes(edges, site.regions.lattice))


def _find_shelves(site: Site, candidates: Bool) -> Bool:
    """Find the regions that are shelves.

    A shelf is nowhere deeper than 2.5 m, as a mezzanine is, and more than half of its outline drops
    to a floor, unlike that of a gallery from wall to wall.
    """
    candidates = candidates & ~_are_wide(site, candidates, SHELF_DEPTH)
    if not candidates.any():
        return candidates
    edges = _outer_edges(site, candidates, site.reach)
    endings = site.endings(edges)
    return candidates & (site.share(edges, endings.kind == DROP, endings.is_known) > HALF)


def _lie_over_walls(site: Site, candidates: Bool) -> Bool:
    """Which regions lie over others, over walls, or within `EAVES` of these as a roof has to."""
    result = np.zeros_like(candidates)
    if not candidates.any():
        return result
    lattice = site.regions.lattice
    reach = int(EAVES / lattice.cell_size + LIMIT_SLACK)
    every_region = site.regions.labelled(np.ones_like(candidates))
    for region in np.flatnonzero(candidates).tolist():
        members = site.regions.members(region)
        _, below = find_below(every_region, members.cell, members.z)
        is_over = np.zeros(lattice.shape, dtype=np.bool_)
        is_over.flat[members.cell] = over_wall_tops(site, members) | (below >= 0) & (
            below != region
        )
        for grid in (is_over, is_over.T):
            before = grid.copy()
            for k in range(1, min(reach, len(grid) - 1) + 1):
                grid[k:] |= before[:-k]
                grid[:-k] |= before[k:]
        result[region] = is_over.flat[members.cell].mean() >= WALLED_SHARE
    return result


def over_wall_tops(site: Site, members: Members) -> Bool:
    """Which surfaces lie over the top of a wall that carries the roof, or ends within it."""
    cell = members.cell
    columns = site.columns.covering(cell)
    first = columns.start[cell]
    end = columns.start[cell + 1]
    is_over = np.zeros(len(cell), dtype=np.bool_)
    for k in range(int((end - first).max(initial=0)) - 1):
        deep = np.flatnonzero(first + k + 1 < end)
        below = columns.z[first[deep] + k]
        above = columns.z[first[deep] + k + 1]
        faces_up = columns.normal[first[deep] + k, 2] > 0
        # at one height, the roof's lower side may stand before the wall's top
        limit = np.where(faces_up, site.agent.traversable_floor_height, SAME_HEIGHT)
        is_top = (above - below < limit) & (faces_up | (columns.normal[first[deep] + k + 1, 2] > 0))
        is_over[deep] |= is_top & (below < members.z[deep] - SAME_HEIGHT)
    return is_over


def are_told(site: Site, roofs: Bool, floors: Bool) -> Bool:
    """Which roofs are reported: those clearly larger than any floor, or large and on no walls."""
    size = site.regions.size
    is_told: Bool = roofs & (size > LARGE_ROOF * size[floors].max())
    is_large = roofs & (size * site.regions.lattice.cell_size**2 >= TOLD_ROOF - LIMIT_SLACK)
    for region in np.flatnonzero(is_large & ~is_told).tolist():
        is_told[region] = not over_wall_tops(site, site.regions.members(region)).any()
    return is_told
