"""Roofs and shelves: sheets over a floor that no step reaches, and that are no storeys."""

from typing import NamedTuple

import numpy as np

from navbake.baker.floors.kernels.roofs import count_open_and_over
from navbake.baker.floors.outline import (
    DROP,
    WALL,
    Edges,
    OccupancyTest,
    Site,
    find_edges,
    find_endings,
    find_rims,
    is_known,
    probe_bands,
    share_of_known,
)
from navbake.baker.floors.sheets import AreaTest, Standable
from navbake.baker.kernels.constants import SAME
from navbake.config.settings import AgentSettings
from navbake.types import Bool, Float, Int

# The share of a roof that lies open to the sky: a higher one's eaves may cover a lower one's side,
# and a carport's roof goes on over the tops of walls that are under the roof of the house
SKY_SHARE = 0.5
# The share of a roof or a shelf that lies over a floor; and the share of its outline that has
# walls if it is a storey, or that drops if it is a shelf
HALF = 0.5
# Where thick walls and eaves leave less of a roof over a floor: the least share that does, and the
# share that lies over a floor or a wall. The rest are eaves.
FLOOR_SHARE, WALLED_SHARE = 0.25, 2 / 3
# Parapets are at most 1.2 m high; a storey's walls are higher than this, and than the agent [m]
MIN_WALL = 1.5
# Steps by row and column against the ways of edges: east, south, west, north
INWARD = np.array([[0, -1], [-1, 0], [0, 1], [1, 0]])
# No shelf is deeper: pallet racks are 1.1 m, or 2.2 m back to back [m]
SHELF_DEPTH = 2.5


class Shares(NamedTuple):
    """What lies above and below of each large sheet, as shares of its surfaces, shape (sheets,).

    Attributes:
        sky: has nothing above it.
        over: lies over another sheet. That may be furniture: what stands in a hall does not take
            the floor away below its roof.
    """

    sky: Float
    over: Float


def measure_shares(site: Site) -> Shares:
    """Measure which share of each large sheet is open to the sky, and lies over another one."""
    size = site.large.sheet_size
    counts = count_open_and_over(site.every, size > 0)
    return Shares(*(count / np.maximum(size, 1) for count in counts))


def find_roofs(site: Site, shares: Shares) -> Bool:
    """Find the sheets that are roofs: open to the sky, over a floor, and without walls.

    A storey that was drawn without its ceiling has walls as high as an agent, and at least 1.5 m,
    along more than half of its outline, and is none. Its walls may stand a little inside of its
    slab's rim, even where they are too thin to part its floor. Parapets are too low, and a lower
    roof beside a higher part of the house has a wall on one side only. What is closed below, or
    open, does not matter: a carport's roof is one, and so are a tree's crown, a parasol and the
    upper shelf of a rack outdoors. A floor below counts even if it is only the top of what stands
    there. Most of a roof lies over a floor; or two thirds over a floor and thick walls around it,
    and a quarter over the floor at least. No step reaches a roof: the sheet of one that stairs
    lead to includes the floors below, which are not open to the sky.

    Only the uppermost slab of a tower of slabs on columns is a roof, as the others are covered.
    Where the lattice crops the scene all around, nothing is known of walls, and a sheet is none.

    Returns:
        Which sheets they are, shape (sheets,), bool.
    """
    sky, over = shares
    candidates = (sky >= SKY_SHARE) & (over >= FLOOR_SHARE)
    asked = candidates & (over < HALF)
    candidates[asked] = _share_over_walls(site, asked) >= WALLED_SHARE
    if not candidates.any():
        return candidates
    agent = site.agent.model_copy(update={"height": max(site.agent.height, MIN_WALL)})
    edges = _outer_edges(site, candidates, reach=1)
    kind = find_endings(edges, site.large, site.columns, agent, site.is_occupied).kind
    is_wall, known = kind == WALL, is_known(edges, kind, site.cropped)
    reach = int(np.ceil(site.settings.shrink / site.large.lattice.cell_size))
    ends = known & ~is_wall
    is_wall[ends] = _find_inner_walls(edges.only(ends), site.large, agent, reach, site.is_occupied)
    return candidates & (share_of_known(site.large, edges, is_wall, known) <= HALF)


def find_shelves(site: Site, shares: Shares) -> Bool:
    """Find the sheets that are shelves, under whatever ceiling: narrow, and open at their sides.

    A shelf lies over a floor, is nowhere deeper than 2.5 m, and more than half of its outline
    drops to a floor beside it. So a mezzanine that no stair leads to is none, because it is
    deeper, nor a gallery from wall to wall, because one of its two sides is a wall, nor what is
    left to stand in of an attic. What is open to the sky is left to `find_roofs`.

    Returns:
        Which sheets they are, shape (sheets,), bool.
    """
    sky, over = shares
    candidates = (sky < SKY_SHARE) & (over >= HALF)
    standable, lattice = site.large, site.large.lattice
    deep = {"min_area": lattice.cell_size**2, "shrink": SHELF_DEPTH / 2}
    test = AreaTest(lattice, site.settings.model_copy(update=deep))
    for sheet, members in standable.members(np.flatnonzero(candidates)):
        candidates[sheet] = not test.passes(standable.cell[members])
    if not candidates.any():
        return candidates
    edges = _outer_edges(site, candidates, site.reach)
    kind = find_endings(edges, standable, site.columns, site.agent, site.is_occupied).kind
    known = is_known(edges, kind, site.cropped)
    return candidates & (share_of_known(standable, edges, kind == DROP, known) > HALF)


def _share_over_walls(site: Site, chosen: Bool) -> Float:
    """The share of some sheets that lies over another sheet, or over a wall.

    A wall's top is a surface that faces up, with less than a step of room above: a roof that lies
    on it, or that it ends within. Returns shape (chosen sheets,).
    """
    standable, step = site.large, site.agent.traversable_floor_height
    members = np.flatnonzero(chosen[standable.sheet])
    cell, z = standable.cell[members], standable.z[members]
    columns, is_over = site.columns.at(cell), _is_over_sheet(site, members)
    first, end = columns.start[cell], columns.start[cell + 1]
    for k in range(int((end - first).max(initial=0)) - 1):
        deep = np.flatnonzero(first + k + 1 < end)
        below, above = columns.z[first[deep] + k], columns.z[first[deep] + k + 1]
        is_top = (columns.normal[first[deep] + k, 2] > 0) & (above - below < step)
        is_over[deep] |= is_top & (below < z[deep] - SAME)
    over = np.bincount(standable.sheet[members], is_over, len(chosen))[chosen]
    share: Float = over / standable.sheet_size[chosen]
    return share


def _is_over_sheet(site: Site, members: Int) -> Bool:
    """Whether large surfaces, given by their indices, lie over a surface of another sheet."""
    standable, every = site.large, site.every
    itself = np.searchsorted(every.surface, standable.surface[members])
    below = np.maximum(itself - 1, 0)
    is_over: Bool = every.sheet[below] != standable.sheet[members]
    is_over &= every.cell[below] == standable.cell[members]
    return is_over


def _outer_edges(site: Site, chosen: Bool, reach: int) -> Edges:
    """The edges of some sheets along their outlines, without those of the holes in them."""
    edges = find_edges(site.large, chosen, site.agent.traversable_floor_height, reach)
    return edges.only(find_rims(edges, site.large) == 0)


def _find_inner_walls(
    edges: Edges, standable: Standable, agent: AgentSettings, reach: int, is_occupied: OccupancyTest
) -> Bool:
    """Whether a wall stands on a sheet near each of some edges, at most `reach` cells inside."""
    lattice, z = standable.lattice, standable.z[edges.surface]
    bands = probe_bands(agent)
    row, col = np.divmod(standable.cell[edges.surface], lattice.width)
    inward_row, inward_col = INWARD[edges.way].T
    has_wall = np.zeros(len(z), dtype=np.bool_)
    for k in range(1, reach + 1):
        beside_row, beside_col = row + k * inward_row, col + k * inward_col
        inside = (beside_row >= 0) & (beside_row < lattice.height)
        inside &= (beside_col >= 0) & (beside_col < lattice.width)
        asked = np.flatnonzero(inside & ~has_wall)
        cells = beside_row[asked] * lattice.width + beside_col[asked]
        for band in bands:
            stands = is_occupied(cells, z[asked], band)
            asked, cells = asked[stands], cells[stands]
        has_wall[asked] = True
    return has_wall
