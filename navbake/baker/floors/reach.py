"""Reach: where agents start, what no step leads to, and floors inside of closed meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navbake.baker.core.components import expand_ranges
from navbake.baker.core.tolerances import LIMIT_SLACK, TOUCH_DEPTH
from navbake.baker.floors.outline import DROP, Site, beside, look_at_site
from navbake.baker.floors.regions import (
    Patch,
    Regions,
    describe_members,
    find_large_regions,
    find_regions,
    place_near,
)
from navbake.baker.floors.rejected import LARGE_TOP, Rejected
from navbake.baker.floors.storeys import Placed
from navbake.baker.floors.surface_kernels import HELD, Surfaces
from navbake.baker.floors.surfaces import find_near
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.errors import SceneError
from navbake.threads import run_in_chunks
from navbake.types import Bool, Int

# A position that is at most this far from a surface lies on it, furniture or not [m]
ON_SURFACE = 0.02
# The least region that is reported as unreached on a level that is reached: shafts and niches are
# smaller [m²]
TOLD_AREA = 6.0
# A level is a void where this share of it, or more, has less headroom than an adult needs [m]
NEARLY_ALL = 0.9
UPRIGHT = 1.8
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


def find_starts(site: Site, rejected: Rejected, positions: list[list[float]]) -> Bool:
    """Find the regions on which agents start, at some positions.

    A position within 2 cm of a surface lies on it. Any other is on the highest floor of its column
    that is at most a step higher. Roofs, and tops of at least 6 m², are floors here. Above
    furniture it is on the floor to which that drops along most of its outline, or on the furniture
    if there is none.

    Args:
        rejected: the regions that are floors only where an agent starts.
        positions: `floors.from`, x, y, z of each [m].

    Returns:
        Which regions they are, shape (regions,), bool.

    Raises:
        SceneError: there is no floor at a position.
    """
    regions = site.regions
    lattice = regions.lattice
    surfaces = regions.surfaces
    step = site.agent.traversable_floor_height
    is_small = regions.size * lattice.cell_size**2 < LARGE_TOP
    may_start = site.is_large & ~rejected.shelves & ~(rejected.tops & is_small)
    starts = np.zeros(regions.num, dtype=np.bool_)
    for number, (x, y, z) in enumerate(positions):
        row, col = lattice.rows_cols([x, y])
        places = np.empty(0, dtype=np.int64)
        cell = int(row) * lattice.width + int(col)
        if 0 <= row < lattice.height and 0 <= col < lattice.width:
            places = np.arange(surfaces.first[cell], surfaces.end[cell])
            places = places[regions.region_of(places) >= 0]
        heights = surfaces.z[places]
        in_column = regions.region_of(places)
        below = in_column[heights <= z + step + LIMIT_SLACK]
        if not len(below):
            in_cell = "there is none in that cell"
            if len(heights):
                in_cell = f"floors there are at {', '.join(f'{z:.2f}' for z in heights)} m"
            raise SceneError(
                f"no floor at `floors.from[{number}]` ({x:g}, {y:g}, {z:g}): expected one that "
                f"an agent can stand on, at most a step higher; {in_cell}"
            )
        exactly = in_column[abs(heights - z) <= ON_SURFACE + LIMIT_SLACK]
        floors = below[may_start[below]]
        if len(exactly):
            starts[exactly[-1]] = True
        elif len(floors):
            starts[floors[-1]] = True
        else:
            starts[_floor_beside(site, may_start, int(below[-1]))] = True
    return starts


def _floor_beside(site: Site, may_start: Bool, furniture: int) -> int:
    """The floor that a region of furniture drops to along most of its outline, else itself."""
    is_furniture = np.arange(len(may_start)) == furniture
    site_with_furniture = look_at_site(
        regions=site.regions,
        is_large=may_start | is_furniture,
        columns=site.columns,
        cropped=site.cropped,
        agent=site.agent,
        settings=site.settings,
        is_occupied=site.is_occupied,
    )
    endings = site_with_furniture.endings(
        site_with_furniture.edges_of(is_furniture, site_with_furniture.reach)
    )
    floors = endings.floor[endings.kind == DROP]
    return int(np.bincount(floors).argmax()) if len(floors) else furniture


def largest_of_lowest(counts: Int, num_regions: int) -> Bool:
    """The region with the largest floor on the lowest level, as a mask, shape (regions,).

    Args:
        counts: rows of region, level and how many surfaces it has there; they may repeat.
    """
    region, _, count = counts[counts[:, 1] == counts[:, 1].min()].T
    largest: Bool = np.arange(num_regions) == np.bincount(region, count).argmax()
    return largest


def count_low(site: Site) -> Int:
    """How many surfaces of each region something hangs over, lower than an adult needs."""
    regions = site.regions
    surfaces = regions.surfaces
    cells = regions.blocks.cells(np.arange(regions.blocks.num))
    which, place = expand_ranges(surfaces.first[cells], surfaces.end[cells])
    region = regions.region_of(place)
    stands = region >= 0
    cell = cells[which[stands]]
    place = place[stands]
    is_low = np.zeros(len(cell), dtype=np.bool_)
    run_in_chunks(
        find_blocked_lines,
        len(cell),
        cell,
        surfaces.z[place] + site.agent.height - TOUCH_DEPTH,
        surfaces.z[place] + UPRIGHT,
        site.columns.covering(cell).hits,
        is_low,
        least=1000,
    )
    return np.bincount(region[stands][is_low], minlength=regions.num)


class Reached(NamedTuple):
    """What steps lead to: masks of regions, shape (regions,).

    Attributes:
        reached: which regions are reached.
        voids: those of levels that no step reaches and in which nobody can stand upright.
    """

    reached: Bool
    voids: Bool


def find_voids(site: Site, counts: Int, reached: Bool, is_given: bool) -> Reached:
    """Find the levels that no step reaches and in which nobody can stand upright.

    Args:
        counts: rows of region, level and how many surfaces it has there; they may repeat.
        reached: which regions are reached, shape (regions,), bool.
        is_given: whether `floors.from` gives the starts; else that is the lowest level that is no
            void.
    """
    region, level, _ = counts.T
    voids = np.zeros_like(reached)
    levels = np.unique(level)
    if np.isin(levels, level[reached[region]]).all():
        return Reached(reached, voids)
    num_low = count_low(site)
    low_levels = []
    for number in levels.tolist():
        on_level = np.unique(region[level == number])
        if num_low[on_level].sum() / site.regions.size[on_level].sum() >= NEARLY_ALL:
            low_levels.append(number)
    if not is_given and len(low_levels) < len(levels):
        reached = largest_of_lowest(counts[~np.isin(level, low_levels)], len(reached))
    is_void = np.isin(level, low_levels) & ~np.isin(level, level[reached[region]])
    voids[region[is_void]] = True
    voids[region[~is_void]] = False
    return Reached(reached, voids)


def find_unreached(regions: Regions, placed: Placed, reached: Bool) -> list[Unreached]:
    """Find the floors that no step leads to, one entry a level, lowest first.

    On levels that are reached in part, only regions of at least 6 m² there count.

    Args:
        reached: which regions are reached, shape (regions,), bool.
    """
    region, level, count = placed.counts.T
    is_reached = reached[region]
    unreached = []
    for number in np.unique(level[~is_reached]).tolist():
        on_level = level == number
        is_unreached = on_level & ~is_reached
        size = np.bincount(region[is_unreached], count[is_unreached], minlength=regions.num)
        is_told = size > 0
        whole = not (is_reached & on_level).any()
        if not whole:
            is_told &= size * regions.lattice.cell_size**2 >= TOLD_AREA - LIMIT_SLACK
        if is_told.any():
            patch = _describe_on_level(regions, placed, number, is_told, int(size.argmax()))
            unreached.append(Unreached(number, patch, whole))
    return unreached


def _describe_on_level(
    regions: Regions, placed: Placed, number: int, mask: Bool, largest: int
) -> Patch:
    """Describe the surfaces of some regions on a level, at a place on the largest region there."""
    on_level = {}
    for region in np.flatnonzero(mask).tolist():
        members = regions.members(region)
        level = placed.level[members.place]
        is_on_level = (level >= 0) & (placed.number[np.maximum(level, 0)] == number)
        on_level[region] = members.only(is_on_level)
    row, col = np.divmod(on_level[largest].cell, regions.lattice.width)
    geoms = np.concatenate([members.geom for members in on_level.values()])
    cells = np.concatenate([members.cell for members in on_level.values()])
    return Patch(
        geom=int(np.bincount(geoms).argmax()),
        area=len(cells) * regions.lattice.cell_size**2,
        place=place_near(regions.lattice, on_level[largest], row.mean(), col.mean()),
        cells=cells.astype(np.int32),
    )


def find_enclosed(surfaces: Surfaces, agent: AgentSettings, settings: FloorSettings) -> list[Patch]:
    """Find floors inside of closed meshes and planes, where nobody can stand, the largest first.

    A floor that continues outside at its height only carries a closed thing, like a crate, unless
    that is as large as a building.
    """
    is_held = surfaces.marks & HELD != 0
    if not is_held.any():
        return []
    # each region is of one mesh or plane
    regions = find_regions(surfaces, agent, np.where(is_held, surfaces.geom, np.int32(-1)))
    patches = []
    for region in np.flatnonzero(find_large_regions(regions, regions.size > 0, settings)).tolist():
        members = regions.members(region)
        num_edges = 0
        num_going_on = 0
        for way in range(4):
            cells = beside(regions.lattice, members.cell, way)
            at_edge = ~np.isin(cells, members.cell)
            num_edges += int(np.count_nonzero(at_edge))
            is_inside = at_edge & (cells >= 0)
            cells = cells[is_inside]
            near = find_near(
                surfaces.first[cells],
                surfaces.end[cells],
                surfaces.z,
                members.z[is_inside],
                agent.traversable_floor_height,
            )
            num_going_on += int(np.count_nonzero(~np.isnan(near)))
        patch = describe_members(regions.lattice, members)
        if patch.area >= BUILDING or num_going_on < GOES_ON * num_edges:
            patches.append(patch)
    return sorted(patches, key=lambda patch: -patch.area)
