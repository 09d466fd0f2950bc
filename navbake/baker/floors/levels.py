"""Levels and floors: from the surfaces of all columns to the floors of each storey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from navbake.baker.columns.columns import ColumnSource
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.windows import Window, crop_cells
from navbake.baker.floors.growth import GrownFloor, find_links, grow_floors
from navbake.baker.floors.outline import OccupancyTest, Site, find_cropped, look_at_site
from navbake.baker.floors.reach import (
    Reached,
    Unreached,
    find_enclosed,
    find_starts,
    find_unreached,
    find_voids,
    largest_of_lowest,
)
from navbake.baker.floors.regions import Patch, describe_regions, find_large_regions, find_regions
from navbake.baker.floors.rejected import are_told, find_rejected
from navbake.baker.floors.storeys import Placed, given_spans, place_on_levels
from navbake.baker.floors.surface_kernels import Surfaces
from navbake.baker.floors.surfaces import find_surfaces
from navbake.baker.geometry.shapes import Shapes
from navbake.config.settings import AgentSettings, FloorSettings, LevelSettings
from navbake.errors import SceneError
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int


@dataclass(frozen=True)
class LevelFloor:
    """One storey on the whole lattice.

    Attributes:
        name: as given, or ``level <number>``, lowest first.
        ground: ground height [m].
        floor: floor heights, shape (height, width), float64, NaN for none [m].
        standable: where the floor is a standable surface, shape (height, width), bool.
        unseen: the part of it that closes a hole, shape (height, width), bool; None where holes
            stay.
    """

    name: str
    ground: float
    floor: Float
    standable: Bool
    unseen: Bool | None = None


@dataclass(frozen=True)
class Floors:
    """All storeys, lowest first, and where they meet.

    Attributes:
        levels: the storeys.
        links: level a, cell a, level b, cell b, shape (n, 4), int64, cells on the whole lattice:
            steps between two levels, and neighbours that slopes join but no step does.
        tops: large tops and shelves that are no floors, the largest first.
        roofs: roofs that a user may miss, the largest first.
        small_starts: floors only because `floors.from` names them.
        unreached: what no step leads to, by level, lowest first.
        left_out: floors that `floors.reach: steps` leaves out, the largest first.
        enclosed, in_planes: floors inside of closed meshes and of infinite planes, whose geoms the
            patches have.
        voids: levels left out as no step reaches them and nobody can stand upright there.
        spare: surfaces left out because all levels of their columns are taken.
    """

    levels: list[LevelFloor]
    links: Int
    tops: list[Patch]
    roofs: list[Patch]
    small_starts: list[Patch]
    unreached: list[Unreached]
    left_out: list[Patch]
    enclosed: list[Patch]
    in_planes: list[Patch]
    voids: list[Patch]
    spare: list[Patch]


def find_floors(
    columns: ColumnSource,
    shapes: Shapes,
    agent: AgentSettings,
    settings: FloorSettings,
    given: Sequence[LevelSettings] | None,
    is_occupied: OccupancyTest,
) -> Floors:
    """Find the storeys in columns, the floor of each, and the steps between them.

    Standable surfaces → regions → large ones → without tops, shelves and roofs → levels → those
    that are reached → floors that grow under things → links.

    Args:
        shapes: what the columns were cast at.
        given: the levels of the configuration; None if they are to be found.

    Raises:
        SceneError: there is no floor at all, none on a given level, or none at a place that one
            starts from.
    """
    lattice = columns.lattice
    surfaces = find_surfaces(columns, shapes.planes, agent)
    regions = find_regions(surfaces, agent)
    if not regions.num:
        raise SceneError(_no_floor(columns, surfaces, agent))
    is_large = find_large_regions(regions, np.ones(regions.num, dtype=np.bool_), settings)
    site = look_at_site(
        regions=regions,
        is_large=is_large,
        columns=columns,
        cropped=find_cropped(lattice, shapes.bounds),
        agent=agent,
        settings=settings,
        is_occupied=is_occupied,
    )
    rejected = find_rejected(site, given_spans(given or ()))
    starts = find_starts(site, rejected, settings.starts)
    is_floor = is_large & ~(rejected.tops | rejected.shelves | rejected.roofs) | starts
    if not is_floor.any():
        raise SceneError(
            f"no floor: the largest standable region keeps less than {settings.min_area:g} m² "
            f"after shrinking by {settings.shrink:g} m; lower `floors.min_area` or "
            f"`floors.shrink` if it is a floor"
        )
    reached = find_reached_levels(site, is_floor, starts, given)
    grown = grow_floors(regions, reached.placed, is_large | starts, agent)
    enclosed = find_enclosed(surfaces, agent, settings)
    return Floors(
        levels=_name_levels(reached.placed, grown, lattice, settings, is_occupied),
        links=find_links(regions, reached.placed, agent),
        tops=describe_regions(regions, (rejected.tops | rejected.shelves) & ~starts),
        roofs=describe_regions(regions, are_told(site, rejected.roofs & ~starts, is_floor)),
        small_starts=describe_regions(regions, starts & ~is_large),
        unreached=find_unreached(regions, reached.placed, reached.regions),
        left_out=reached.left_out,
        enclosed=[patch for patch in enclosed if patch.geom not in shapes.planes.geom],
        in_planes=[patch for patch in enclosed if patch.geom in shapes.planes.geom],
        voids=reached.voids,
        spare=reached.placed.spare,
    )


class ReachedLevels(NamedTuple):
    """The regions on their levels, as far as they are reached or stay without that.

    Attributes:
        placed: their surfaces on levels.
        regions: which regions are reached, shape (regions,), bool.
        left_out, voids: see `Floors`.
    """

    placed: Placed
    regions: Bool
    left_out: list[Patch]
    voids: list[Patch]


def find_reached_levels(
    site: Site, is_floor: Bool, starts: Bool, given: Sequence[LevelSettings] | None
) -> ReachedLevels:
    """Place the regions that are floors on levels, but for voids; or those that steps lead to.

    Args:
        is_floor: which regions are floors, shape (regions,), bool.
        starts: those on which agents start, where `floors.from` names any.
        given: see `find_floors`.

    Raises:
        SceneError: there is no floor on a given level.
    """
    regions = site.regions
    settings = site.settings
    by_steps = settings.reach == "steps"
    is_given = bool(starts.any())
    reached = Reached(starts, np.zeros_like(is_floor))
    placed = None
    if not is_given or (given is None and not by_steps):
        placed = place_on_levels(regions, is_floor, (), site.agent, settings)
        if not is_given:
            reached = reached._replace(reached=largest_of_lowest(placed.counts, regions.num))
        if given is None and not settings.voids:
            reached = find_voids(site, placed.counts, reached.reached, is_given)
    spans = given_spans(given or ())
    for number, (low, high) in enumerate(spans):
        if not regions.between(is_floor, low, high).any():
            raise SceneError(_no_floor_on(given or (), number, site.columns))
    stays = is_floor & (reached.reached if by_steps else ~reached.voids)
    if placed is None or given is not None or not np.array_equal(stays, is_floor):
        placed = place_on_levels(regions, stays, given or (), site.agent, settings)
        if not len(placed.counts):
            start = "what `floors.from` names"
            if not is_given:
                start = "the largest floor of the lowest level"
            raise SceneError(f"no floor: {start} lies outside of the `levels`")
    left_out: list[Patch] = []
    voids: list[Patch] = []
    if by_steps:
        left_out = describe_regions(regions, is_floor & ~reached.reached, spans)
    else:
        voids = describe_regions(regions, reached.voids)
    return ReachedLevels(placed, reached.reached, left_out, voids)


def _name_levels(
    placed: Placed,
    grown: list[GrownFloor],
    lattice: Lattice,
    settings: FloorSettings,
    is_occupied: OccupancyTest,
) -> list[LevelFloor]:
    """The levels, whose holes are closed if `floors.fill` says so."""
    levels = []
    for name, ground, floor in zip(placed.labels, placed.grounds, grown, strict=True):
        height = floor.height.reshape(lattice.shape)
        level = LevelFloor(name, ground, height, (floor.ring == 0).reshape(lattice.shape))
        if settings.fill:
            level = fill_holes(level, settings.fill / lattice.cell_size**2, is_occupied)
        levels.append(level)
    return levels


def fill_holes(level: LevelFloor, largest: float, is_occupied: OccupancyTest) -> LevelFloor:
    """Close the holes of a floor that floor surrounds, up to `largest` cells each.

    Heights there are interpolated from those round the hole (linearly, over Delaunay's triangles).
    Holes that nobody gets to from the floor, such as the inside of a pillar, stay.
    """
    from scipy.interpolate import griddata  # scipy loads slowly, and few ask for this
    from scipy.ndimage import binary_dilation, label  # likewise

    holes, _ = label(np.isnan(level.floor))  # by their edges
    size = np.bincount(holes.ravel())
    for edge in (holes[0], holes[-1], holes[:, 0], holes[:, -1]):
        size[edge] = holes.size + 1
    size[0] = holes.size + 1
    unseen: Bool = (size <= largest + LIMIT_SLACK)[holes]
    if not unseen.any():
        return replace(level, unseen=unseen)
    near = binary_dilation(unseen, np.ones((3, 3)))
    rim = near & ~unseen & ~np.isnan(level.floor)
    floor = level.floor.copy()
    floor[unseen] = griddata(np.argwhere(rim), floor[rim], np.argwhere(unseen))
    near &= ~np.isnan(floor)
    free = near.copy()
    free[near] = ~is_occupied(np.flatnonzero(near), floor[near], None)
    # free cells connected to floor that was seen, and things that stand in such a hole
    open_part, _ = label(free)
    reached = free & np.isin(open_part, open_part[free & rim])
    unseen &= reached | (np.isin(holes, holes[reached & unseen]) & ~free)
    floor[~unseen & (holes > 0)] = np.nan
    return replace(level, floor=floor, standable=level.standable | unseen, unseen=unseen)


def crop_floors(floors: Floors, window: Window) -> Floors:
    """Cut a window out of the floors of a whole scene; patches and parts beside it are left out.

    Levels without a standable surface in the window are left out.

    Raises:
        SceneError: no floor lies in the window.
    """
    shown = [k for k, level in enumerate(floors.levels) if level.standable[window].any()]
    if not shown:
        raise SceneError("no floor lies inside of `grid.bounds`")
    number = np.full(len(floors.levels), -1, dtype=np.int64)
    number[shown] = np.arange(len(shown))
    levels = []
    for new, old in enumerate(shown):
        level = floors.levels[old]
        name = f"level {new}" if level.name == f"level {old}" else level.name
        floor = level.floor[window].copy()
        standable = level.standable[window].copy()
        unseen = None if level.unseen is None else level.unseen[window].copy()
        levels.append(LevelFloor(name, level.ground, floor, standable, unseen))
    width = floors.levels[0].floor.shape[1]

    def is_shown(patch: Patch) -> bool:
        return bool(crop_cells(patch.cells.astype(np.int64), window, width)[1].any())

    links = floors.links
    kept = (number[links[:, 0]] >= 0) & (number[links[:, 2]] >= 0)
    for cell in (1, 3):
        kept &= crop_cells(links[:, cell], window, width)[1]
    links = links[kept]
    for on, cell in ((0, 1), (2, 3)):
        links[:, on] = number[links[:, on]]
        links[:, cell] = crop_cells(links[:, cell], window, width)[0]
    unreached = [
        replace(part, level=int(number[part.level]))
        for part in floors.unreached
        if number[part.level] >= 0 and is_shown(part.patch)
    ]
    told = "tops", "roofs", "small_starts", "left_out", "enclosed", "in_planes", "voids", "spare"
    patches = {name: list(filter(is_shown, getattr(floors, name))) for name in told}
    return Floors(levels=levels, links=links, unreached=unreached, **patches)


def _no_floor_on(given: Sequence[LevelSettings], number: int, columns: ColumnSource) -> str:
    level = given[number]
    name = f"level {level.name!r}" if level.name else f"level {number}"
    above = given[number + 1].ground if given[number + 1 :] else np.inf
    top = above if level.top is None else min(above, level.top)
    spans = [(block.z.min(), block.z.max()) for block in columns.row_chunks() if len(block.z)]
    low = float(np.min(spans))
    high = float(np.max(spans))
    return (
        f"no floor on {name} (ground {level.ground:g} m, top {top:g} m) of `levels`: "
        f"the scene's surfaces span {low:g} to {high:g} m"
    )


def _no_floor(columns: ColumnSource, surfaces: Surfaces, agent: AgentSettings) -> str:
    num_surfaces = sum(len(block.z) for block in columns.row_chunks())
    if not num_surfaces:
        return "no floor at all: no vertical line through a cell's centre meets a geom"
    if not len(surfaces.z):
        return (
            f"no floor at all: none of {num_surfaces} surfaces faces up within "
            f"{agent.max_slope:g}° (a mesh may be inside out, or `scene.up` wrong)"
        )
    return (
        f"no floor at all: none of {len(surfaces.z)} surfaces that face up has "
        f"{agent.height:g} m of headroom (a wrong unit, or everything lies inside of a solid: "
        f"`scene.meshes: shell` makes closed meshes hollow)"
    )
