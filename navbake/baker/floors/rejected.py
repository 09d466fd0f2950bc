"""Which sheets are no floors, though they are large enough: tops, shelves and roofs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navbake.baker.floors.kernels.members import Edges, Members
from navbake.baker.floors.outline import (
    DROP,
    WALL,
    Site,
    beside,
    find_below,
    find_holes,
    probe_bands,
)
from navbake.baker.kernels.constants import SAME, SLACK, TOUCH
from navbake.baker.kernels.overlap import lines_blocked
from navbake.threads import run_in_bands
from navbake.types import Bool, Float

# A top drops to a floor along at least this share of its outline
DROP_SHARE = 0.25
# With room for an agent under more than this share of it, a sheet is a mezzanine, no top
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
FLOOR_SHARE, WALLED_SHARE, EAVES = 0.1, 2 / 3, 1.5
# Parapets are at most 1.2 m high; a storey's walls are higher than this, and than the agent [m]
MIN_WALL = 1.5
# A roof is reported if it is this many times as large as the largest floor that is left (walls and
# eaves alone add less than a third); or if it has this area and no walls under it [m²]
LARGE_ROOF, TOLD_ROOF = 4 / 3, 50.0
# No shelf is deeper: pallet racks are 1.1 m, or 2.2 m back to back [m]
SHELF_DEPTH = 2.5


def find_rejected(site: Site, spans: Sequence[tuple[float, float]]) -> tuple[Bool, Bool, Bool]:
    """Find the large sheets that are no floors.

    A roof that is the only sheet of the scene, or of a given level, is a floor nevertheless.

    Args:
        spans: see `given_spans` [m].

    Returns:
        Tops, shelves and roofs: masks, shape (sheets,); roofs are neither of the others.
    """
    sheets, is_large = site.sheets, site.is_large
    tops = shelves = roofs = none = np.zeros(len(is_large), dtype=np.bool_)
    above, below, count = sheets.stacks()
    size = np.maximum(sheets.size, 1)
    sky = sheets.tops / size
    # also over furniture: a hall's roof stays over its floor whatever stands there
    over = np.bincount(above, count * (above != below), len(is_large)) / size
    if not site.settings.tops:
        tops = _find_tops(site)
        shelves = _find_shelves(site, is_large & (sky < SKY_SHARE) & (over >= HALF))
    if not site.settings.roofs:
        roofs = _find_roofs(site, is_large & (sky >= SKY_SHARE) & (over >= FLOOR_SHARE), over)
    is_floor = is_large & ~(tops | shelves | roofs)
    if not is_floor.any():
        roofs = none
    for low, high in spans:
        on_level = sheets.between(is_large, low, high)
        if not (on_level & is_floor).any():
            roofs = roofs & ~on_level
    return tops & ~roofs, shelves & ~roofs, roofs


def _find_tops(site: Site) -> Bool:
    """Find the tops of what stands on a floor: beds, blocks, counters, walls that are metres thick.

    A sheet is a top if

    - at least a quarter of its outline drops to floors, see `Site.endings`; of the rims of holes
      only what drops counts;
    - it has at most 6 m², is nowhere wider than 3 m, or drops to a floor larger than 0.9 of its
      size: else it is the ground beside a pool, a ditch or a track bed. Or a floor winds through
      it: the drops to that floor, from the rims of its holes and of the things in these, are longer
      than its outline;
    - under at most half of it, from the height of that floor up, is room for an agent, as under a
      mezzanine.
    """
    sheets, result = site.sheets, np.zeros_like(site.is_large)
    block, rows = site.edges
    drops = np.bincount(sheets.sheet_at(block, rows[:, 0]), rows[:, 4], len(result))
    may_drop = site.is_large & (drops > 0)
    if not site.cropped.any():
        # an outline is at least as long as the box around it: most sheets drop along less of it
        height, width = (sheets.box[:, k + 2] - sheets.box[:, k] for k in (0, 1))
        may_drop &= drops >= DROP_SHARE * 2 * (height + width)
    found = site.facts.of("top", may_drop, lambda asked: _judge_tops(site, asked), site.near)
    area = sheets.lattice.cell_size**2
    large, into = np.zeros_like(result), Counter[int]()
    for _, drops_to, _ in found:
        into.update(drops_to)
    asked = np.flatnonzero(may_drop).tolist()
    for sheet, (in_holes, drops_to, outline) in zip(asked, found, strict=True):
        if drops_to:
            size, others = sheets.size[sheet], np.searchsorted(sheets.key, list(drops_to))
            lies = size * area <= LARGE_TOP or sheets.size[others].max() > EQUAL * size
            around = (num + into[to] - drops_to[to] for to, num in in_holes.items())
            winds = max(around, default=0) > outline
            result[sheet], large[sheet] = lies or winds, not lies and not winds
    return result | (large & ~_are_wide(site, large, WIDE_TOP))


def _are_wide(site: Site, asked: Bool, width: float) -> Bool:
    """Which sheets are somewhere wider than a width [m]."""
    if not asked.any():
        return asked
    wide = {"min_area": site.sheets.lattice.cell_size**2, "shrink": width / 2}
    settings = site.settings.model_copy(update=wide)
    return site.facts.mask(f"wider than {width}", asked, lambda s: site.sheets.left(s, settings))


def _judge_tops(site: Site, asked: Bool) -> list[tuple[Counter[int], Counter[int], int]]:
    """By sheet, how many edges drop to each other sheet, in holes and in all; and how many it has.

    There are no drops where `_find_tops` rules out a top by its outline or by the room under it.
    """
    sheets = site.sheets
    edges = site.edges_of(asked, site.reach)
    has_floor = np.asarray((~np.isnan(edges.floors)).any(axis=1))
    in_hole = find_holes(edges, sheets.lattice)
    certain = ((edges.cells[:, 0] >= 0) | ~site.cropped[edges.way]) & ~in_hole
    chosen = ~(site.share(edges, has_floor, certain | has_floor) < DROP_SHARE)[edges.sheet]
    edges, in_hole = edges.only(chosen), in_hole[chosen]
    endings = site.endings(edges)
    drops = endings.kind == DROP
    # other holes are where things stand on the sheet, such as pillows
    known = endings.is_known & (~in_hole | drops)
    is_top = site.share(edges, drops, known) >= DROP_SHARE
    found = []
    for sheet in np.flatnonzero(asked).tolist():
        own = edges.sheet == sheet
        landing = np.sort(endings.landing[own & drops])
        in_holes, drops_to = Counter[int](), Counter[int]()
        if is_top[sheet] and len(landing):
            # the lower one of two in the middle
            beside = float(landing[(len(landing) - 1) // 2])
            if _count_over_room(site, sheet, beside) <= ROOM_SHARE * sheets.size[sheet]:
                drops_to.update(sheets.key[endings.floor[own & drops]].tolist())
                in_holes.update(sheets.key[endings.floor[own & drops & in_hole]].tolist())
        found.append((in_holes, drops_to, int((~in_hole[own]).sum())))
    return found


def _count_over_room(site: Site, sheet: int, floor: float) -> int:
    """Count a sheet's cells with room for an agent below, on the `floor` beside [m] or higher."""
    agent, members = site.agent, site.sheets.members(sheet)
    step, cells = agent.traversable_floor_height, members.cell
    labelled = site.sheets.labelled(site.is_large)
    place, _ = find_below(labelled, cells, members.z)
    has_floor = (place >= 0) & (labelled.z[place] >= floor - step - SLACK)
    blocked = np.zeros(len(cells), dtype=np.bool_)
    low, high = (
        np.full(len(cells), z) for z in (floor + step + TOUCH, floor + agent.height - TOUCH)
    )
    lines = cells, low, high, site.columns.at(cells).crossings, blocked
    run_in_bands(lines_blocked, len(cells), *lines, least=1000)
    return int(np.count_nonzero(has_floor | ~blocked))


def _find_roofs(site: Site, candidates: Bool, over: Float) -> Bool:
    """Find the sheets that are roofs: open to the sky, over a floor, and without walls.

    A storey drawn without its ceiling has walls as high as an agent, and at least 1.5 m, along more
    than half of its outline; parapets are lower. Half of a roof lies over a floor or furniture; or
    two thirds lie over a floor, a wall, or within 1.5 m of one (eaves), and a tenth over a floor.
    Where the lattice crops the scene all around, walls are unknown, and a sheet is no roof.
    """
    half_over, facts = candidates & (over < HALF), site.facts
    over_walls = facts.mask("over walls", half_over, lambda s: _lie_over_walls(site, s), site.near)
    candidates = candidates & (~half_over | over_walls)
    return facts.mask("no walls", candidates, lambda s: _have_no_walls(site, s), site.at_edges)


def _have_no_walls(site: Site, asked: Bool) -> Bool:
    """Which sheets have walls along at most half of their outline, within `floors.shrink` of it."""
    agent = site.agent.model_copy(update={"height": max(site.agent.height, MIN_WALL)})
    lattice, edges = site.sheets.lattice, _outer_edges(site, asked, reach=0)

    def look(some: Bool) -> NDArray[np.uint8]:
        stale = edges.only(some)
        steps = range(-int(np.ceil(site.settings.shrink / lattice.cell_size)), 2)
        beyond = [beside(lattice, stale.cell, stale.way, k) for k in steps]
        cells = np.concatenate(beyond)
        site.columns.at(cells[cells >= 0])  # of all at once, as parts of these are asked for below
        kind = site.barriers(stale, agent)
        known = site.is_known(kind, stale.way)
        for inner in beyond[-3::-1]:
            near = np.flatnonzero(known & (kind != WALL) & (inner >= 0))
            for band in probe_bands(agent):
                near = near[site.is_occupied(inner[near], stale.z[near], band)]
            kind[near] = WALL
        return kind

    block = site.sheets.blocks.of(edges.cell)
    places = np.stack([edges.cell * 4 + edges.way, edges.z.view(np.int64)], axis=1)
    kind = site.walls.find(block, places, site.last, site.sheets.now, look)
    is_known = site.is_known(kind, edges.way)
    return asked & (site.share(edges, kind == WALL, is_known) <= HALF)


def _outer_edges(site: Site, chosen: Bool, reach: int) -> Edges:
    """The edges of some sheets but for those of their holes."""
    edges = site.edges_of(chosen, reach)
    return edges.only(~find_holes(edges, site.sheets.lattice))


def _find_shelves(site: Site, candidates: Bool) -> Bool:
    """Find the sheets that are shelves.

    A shelf is nowhere deeper than 2.5 m, as a mezzanine is, and more than half of its outline drops
    to a floor, unlike that of a gallery from wall to wall.
    """
    candidates = candidates & ~_are_wide(site, candidates, SHELF_DEPTH)

    def open_at_sides(asked: Bool) -> Bool:
        edges = _outer_edges(site, asked, site.reach)
        endings = site.endings(edges)
        return asked & (site.share(edges, endings.kind == DROP, endings.is_known) > HALF)

    return site.facts.mask("open at sides", candidates, open_at_sides, site.at_edges)


def _lie_over_walls(site: Site, asked: Bool) -> Bool:
    """Which sheets lie over others, over walls, or within `EAVES` of these as a roof has to."""
    result, (height, width) = np.zeros_like(asked), site.sheets.lattice.shape
    reach = int(EAVES / site.sheets.lattice.cell_size + SLACK)
    every = site.sheets.labelled(np.ones_like(asked))
    for sheet in np.flatnonzero(asked).tolist():
        members = site.sheets.members(sheet)
        _, below = find_below(every, members.cell, members.z)
        is_over = np.zeros((height, width), dtype=np.bool_)
        is_over.flat[members.cell] = over_wall_tops(site, members) | (below >= 0) & (below != sheet)
        for grid in (is_over, is_over.T):
            known = grid.copy()
            for k in range(1, min(reach, len(grid) - 1) + 1):
                grid[k:] |= known[:-k]
                grid[:-k] |= known[k:]
        result[sheet] = is_over.flat[members.cell].mean() >= WALLED_SHARE
    return result


def over_wall_tops(site: Site, members: Members) -> Bool:
    """Which surfaces lie over the top of a wall that carries the roof, or ends within it."""
    cell, z = members.cell, members.z
    columns, is_over = site.columns.at(cell), np.zeros(len(cell), dtype=np.bool_)
    first, end = columns.start[cell], columns.start[cell + 1]
    for k in range(int((end - first).max(initial=0)) - 1):
        deep = np.flatnonzero(first + k + 1 < end)
        below, above = columns.z[first[deep] + k], columns.z[first[deep] + k + 1]
        faces_up = columns.normal[first[deep] + k, 2] > 0
        # at one height, the roof's lower side may stand before the wall's top
        limit = np.where(faces_up, site.agent.traversable_floor_height, SAME)
        is_top = (above - below < limit) & (faces_up | (columns.normal[first[deep] + k + 1, 2] > 0))
        is_over[deep] |= is_top & (below < z[deep] - SAME)
    return is_over


def are_told(site: Site, roofs: Bool, floors: Bool) -> Bool:
    """Which roofs are reported: those clearly larger than any floor, or large and on no walls."""
    size, area = site.sheets.size, site.sheets.lattice.cell_size**2
    large = roofs & (size * area >= TOLD_ROOF - SLACK)

    def stand_free(asked: Bool) -> Bool:
        result = np.zeros_like(asked)
        for sheet in np.flatnonzero(asked).tolist():
            result[sheet] = not over_wall_tops(site, site.sheets.members(sheet)).any()
        return result

    is_larger = roofs & (size > LARGE_ROOF * size[floors].max())
    told: Bool = is_larger | site.facts.mask(
        "stands free", large & ~is_larger, stand_free, site.near
    )
    return told
