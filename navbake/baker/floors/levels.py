"""Levels and floors: from the surfaces of all columns to the floors of each storey."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navbake.baker.columns import ColumnSource
from navbake.baker.floors.enclosed import EnclosedFinder
from navbake.baker.floors.grounds import assign_levels, find_grounds, lower_grounds
from navbake.baker.floors.kernels.sheets import (
    count_options,
    find_links,
    grow_floor,
    list_options,
)
from navbake.baker.floors.outline import OccupancyTest, Site, find_cropped
from navbake.baker.floors.patch import Patch, describe_sheets
from navbake.baker.floors.reach import (
    Unreached,
    find_starts,
    find_unreached,
    largest_of_lowest,
)
from navbake.baker.floors.rejected import GIVEN_TOLERANCE, find_rejected, given_levels
from navbake.baker.floors.sheets import Footing, Standable, StandableFinder, drop_furniture
from navbake.baker.floors.stairs import find_stairs
from navbake.baker.kernels.constants import SLACK
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings, FloorSettings, LevelSettings
from navbake.errors import SceneError
from navbake.threads import run_beside, run_in_bands
from navbake.types import Bool, Float, Int, Int32

# A dropped roof is told of when it is this many times as large as the largest floor that is left:
# walls and eaves alone make it larger than the floor under it, but not by a third
LARGE_ROOF = 4 / 3


@dataclass(frozen=True)
class LevelFloor:
    """One storey on the whole lattice.

    Attributes:
        name: as given, or ``level <number>``, lowest first.
        ground: ground height [m].
        floor: floor heights, shape (height, width), float64, NaN for none [m].
        standable: where the floor is a standable surface, shape (height, width), bool.
    """

    name: str
    ground: float
    floor: Float
    standable: Bool


@dataclass(frozen=True)
class Floors:
    """All storeys, lowest first, and where they meet.

    Attributes:
        levels: the storeys.
        links: level a, cell a, level b, cell b, shape (n, 4), int64, cells on the whole lattice:
            each step between two levels, and each pair of neighbours, on one level or two, that
            their slopes join but no step does.
        tops: large tops and shelves that are no floors, the largest first.
        roofs: roofs that are clearly larger than every floor that is left, the largest first.
        small_starts: what `floors.from` names, though it is too small for a floor.
        unreached: what no step leads to, by level, lowest first.
        left_out: floors that `floors.reach: steps` leaves out, the largest first.
        enclosed: floors inside of closed meshes; the geom of each is the mesh's.
    """

    levels: list[LevelFloor]
    links: Int
    tops: list[Patch]
    roofs: list[Patch]
    small_starts: list[Patch]
    unreached: list[Unreached]
    left_out: list[Patch]
    enclosed: list[Patch]


class Judged(NamedTuple):
    """What was decided about the sheets on the way to the floors.

    Attributes:
        every: all standable surfaces.
        large: those of the sheets that are large enough for floors.
        counted: those that are floors.
        candidate: of each footing, whether a floor may go on there, bool.
        holds_floor: whether a closed mesh holds anything as large as a floor.
    """

    every: Standable
    large: Standable
    counted: Standable
    candidate: Bool
    holds_floor: bool


def find_floors(
    columns: ColumnSource,
    shapes: Shapes,
    agent: AgentSettings,
    settings: FloorSettings,
    given: list[LevelSettings] | None,
    is_occupied: OccupancyTest,
    notes: list[Judged] | None = None,
) -> Floors:
    """Find the storeys, the floor of each, and the steps between them.

    All standable surfaces → the sheets that are large enough → those of them that count, without
    tops, shelves and roofs → their levels → those that are reached → floors, level by level.

    Args:
        shapes: the geometry that the columns were cast at.
        given: the levels of the configuration, or None to find them.
        notes: receives what was decided on the way, which takes memory.

    Raises:
        SceneError: there is no floor at all, none on a given level, or none at a place that one
            starts from.
    """
    lattice = columns.lattice
    finder = StandableFinder(lattice, shapes, agent)
    enclosing = EnclosedFinder(lattice, shapes, agent)
    for block in columns.blocks():
        finder.add(block)
        enclosing.add(block)
    every, footing = finder.found()
    enclosed = enclosing.found(footing, settings)
    holds_floor = enclosing.holds_floor
    if not len(every.z):
        raise SceneError(_no_floor(finder.num_surfaces, len(footing.z), agent))
    del finder, enclosing  # they hold the arrays of `every`, too
    large = drop_furniture(every, settings)
    cropped = find_cropped(columns.lattice, shapes.bounds())
    site = Site(every, large, columns, agent, settings, is_occupied, cropped)
    rejected = find_rejected(site, given)
    starts = find_starts(site, rejected, settings.starts)
    is_large = large.sheet_size > 0
    counts = is_large & ~rejected.any | starts
    # mostly they are all: one copy of them is enough
    counted = large if (counts == is_large).all() else every.only_sheets(counts)
    if not len(counted.z):
        raise SceneError(_no_large_floor(settings))
    large_or_start = every.surface[(is_large | starts)[every.sheet]]
    is_told = large.sheet_size > LARGE_ROOF * counted.sheet_size.max()
    tops = describe_sheets(large, (rejected.tops | rejected.shelves) & ~starts)
    roofs = describe_sheets(large, rejected.roofs & ~starts & is_told)
    small_starts = describe_sheets(every, starts & ~is_large)
    judged = None if notes is None else (every, large)
    del every, large, site  # as many as cells: the rest is about those that count
    placed, left_out, unreached = _place_reached(counted, starts, columns, agent, settings, given)
    candidate = _mark_candidates(placed.standable, large_or_start, footing, agent)
    if notes is not None and judged is not None:
        notes.append(Judged(*judged, placed.standable, candidate, holds_floor))
    links = run_beside(_cell_links, placed, agent)
    levels = [
        LevelFloor(label, ground, *_level_floor(k, placed, footing, candidate, agent))
        for k, (label, ground) in enumerate(zip(placed.labels, placed.grounds, strict=True))
    ]
    return Floors(
        levels,
        links(),
        tops=tops,
        roofs=roofs,
        small_starts=small_starts,
        unreached=unreached,
        left_out=left_out,
        enclosed=enclosed,
    )


class _Placed(NamedTuple):
    """The surfaces that count, the level of each, the grounds and the names of the levels."""

    standable: Standable
    level: Int
    grounds: list[float]
    labels: list[str]


def _place_reached(
    counted: Standable,
    starts: Bool,
    columns: ColumnSource,
    agent: AgentSettings,
    settings: FloorSettings,
    given: list[LevelSettings] | None,
) -> tuple[_Placed, list[Patch], list[Unreached]]:
    """Place the surfaces that count on levels; of all, or of those that steps lead to.

    What is reached is decided before levels are given, from the lowest level that there is.

    Returns:
        The surfaces on their levels, the sheets that are left out because no step leads to them,
        and what no step leads to of those that are not.
    """
    placed = _place_on_levels(counted, agent, settings, None)
    reached = starts if starts.any() else largest_of_lowest(placed.standable, placed.level)
    kept = counted if given is None else _within_given(counted, given, columns)
    left_out = []
    if settings.reach == "steps":
        left_out = describe_sheets(kept, (kept.sheet_size > 0) & ~reached)
        kept = kept.only_sheets(reached)
        if not len(kept.z):
            what = "the largest floor of the lowest level"
            if starts.any():
                what = "what `floors.from` names"
            raise SceneError(f"no floor: {what} lies outside of the `levels`")
    if given is not None or kept is not counted:
        placed = _place_on_levels(kept, agent, settings, given)
    return placed, left_out, find_unreached(placed.standable, placed.level, reached)


def _place_on_levels(
    standable: Standable,
    agent: AgentSettings,
    settings: FloorSettings,
    given: list[LevelSettings] | None,
) -> _Placed:
    """Place the surfaces on the levels that are given, or found."""
    is_stair = find_stairs(standable, agent)
    if given is None:
        grounds = find_grounds(standable, is_stair, agent, settings)
        grounds = lower_grounds(standable, is_stair, grounds, agent)
        return _Placed(standable, *assign_levels(standable, is_stair, grounds, [], SLACK))
    grounds, names = [level.ground for level in given], [level.name for level in given]
    placed = assign_levels(standable, is_stair, grounds, names, GIVEN_TOLERANCE)
    return _Placed(standable, *placed)


def _within_given(
    standable: Standable, given: list[LevelSettings], columns: ColumnSource
) -> Standable:
    """Keep the surfaces between the grounds and the tops of the given levels."""
    kept = np.zeros(len(standable.z), dtype=np.bool_)
    on_levels = given_levels(standable, given)
    for number, (level, on_level) in enumerate(zip(given, on_levels, strict=True)):
        if not on_level.any():
            name = f"level {level.name!r}" if level.name else f"level {number}"
            above = given[number + 1].ground if given[number + 1 :] else np.inf
            top = above if level.top is None else min(above, level.top)
            spans = [(block.z.min(), block.z.max()) for block in columns.blocks() if len(block.z)]
            low, high = float(np.min(spans)), float(np.max(spans))
            raise SceneError(
                f"no floor on {name} (ground {level.ground:g} m, top {top:g} m) of `levels`: "
                f"the scene's surfaces span {low:g} to {high:g} m"
            )
        kept |= on_level
    return standable.only(kept)


def _mark_candidates(
    counted: Standable, large: Int32, footing: Footing, agent: AgentSettings
) -> Bool:
    """Mark the footings at which a floor may go on under things, shape (n,).

    It goes on only where no other floor is, nor a roof, nor the top of furniture: nor at any of
    the `large` surfaces, those that count among them.
    """
    candidate = np.ones(len(footing.z), dtype=np.bool_)
    candidate[counted.surface] = False
    dropped = large[candidate[large]]
    candidate[large] = False
    candidate[_just_below(footing, dropped, agent.traversable_floor_height)] = False
    return candidate


def _just_below(footing: Footing, surface: Int32, step: float) -> Int32:
    """The footings a step at most below some others, in their columns.

    An agent there would walk on those above, as on a roof in which a wall's top is hidden.
    """
    cell = np.searchsorted(footing.start, surface, side="right") - 1
    found, k = [surface[:0]], 1
    while len(surface):
        near = surface - k >= footing.start[cell]
        near[near] = (footing.z[surface] - footing.z[surface - k])[near] <= step + SLACK
        surface, cell = surface[near], cell[near]
        found.append(surface - k)
        k += 1
    return np.concatenate(found)


def _level_floor(
    k: int, placed: _Placed, footing: Footing, goes_on: Bool, agent: AgentSettings
) -> tuple[Float, Bool]:
    """The floor of level `k`, continued where `goes_on`; and where it is standable."""
    standable, level = placed.standable, placed.level
    lattice, cells, z = standable.lattice, standable.cell, standable.z
    floor = np.full(lattice.width * lattice.height, np.nan)
    here = level == k
    floor[cells[here]] = z[here]
    is_standable = ~np.isnan(floor)
    lowest, highest = np.full(floor.shape, -np.inf), np.full(floor.shape, np.inf)
    below, above = np.flatnonzero(level < k), np.flatnonzero(level > k)[::-1]
    # of several in a column, the last one written stays: here the highest, there the lowest
    lowest[cells[below]] = z[below] + agent.height - SLACK
    highest[cells[above]] = z[above] - agent.height + SLACK
    start = np.zeros_like(footing.start)
    run_in_bands(count_options, len(floor), footing, goes_on, floor, lowest, highest, start[1:])
    np.cumsum(start, out=start)
    height = np.empty(start[-1])
    run_in_bands(list_options, len(floor), footing, goes_on, lowest, highest, start, height)
    grow_floor(lattice, start, height, floor, agent.traversable_floor_height)
    return floor.reshape(lattice.shape), is_standable.reshape(lattice.shape)


def _cell_links(placed: _Placed, agent: AgentSettings) -> Int:
    standable, level = placed.standable, placed.level
    step = agent.traversable_floor_height
    steps = find_links(standable.lattice, standable.start, standable.z, level, step)
    slopes = standable.slopes
    upside_down = level[slopes[:, 0]] > level[slopes[:, 1]]
    slopes = np.where(upside_down[:, None], slopes[:, ::-1], slopes)
    a, b = np.concatenate([steps, slopes]).T
    links = np.stack([level[a], standable.cell[a], level[b], standable.cell[b]], axis=1)
    return links[np.lexsort(links.T[::-1])]


def _no_large_floor(settings: FloorSettings) -> str:
    return (
        f"no floor: the largest standable sheet keeps less than {settings.min_area:g} m² "
        f"after shrinking by {settings.shrink:g} m; lower `floors.min_area` or "
        f"`floors.shrink` if it is a floor"
    )


def _no_floor(num_surfaces: int, num_footings: int, agent: AgentSettings) -> str:
    if not num_surfaces:
        return "no floor at all: no vertical line through a cell's centre meets a geom"
    if not num_footings:
        return (
            f"no floor at all: none of {num_surfaces} surfaces faces up within "
            f"{agent.max_slope:g}° (a mesh may be inside out, or `scene.up` wrong)"
        )
    return (
        f"no floor at all: none of {num_footings} surfaces that face up has "
        f"{agent.height:g} m of headroom (a wrong unit, or everything lies inside of a solid: "
        f"`scene.meshes: shell` makes closed meshes hollow)"
    )
