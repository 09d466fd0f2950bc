"""Storeys: where they begin, which surfaces are stairs between them, and the level of each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.area_test import AreaTest, area_test, is_large_enough
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors import level_kernels as kernels
from navbake.baker.floors.label_kernels import PLATEAU, Joining, tally
from navbake.baker.floors.level_kernels import EVERY, LOST, LOWEST, Candidates, HeightWindow
from navbake.baker.floors.member_kernels import Members
from navbake.baker.floors.regions import (
    NO_HEIGHTS,
    NO_KEY,
    NO_ROWS,
    Labels,
    Patch,
    Regions,
    describe_members,
    label_surfaces,
    region_joining,
)
from navbake.config.settings import AgentSettings, FloorSettings, LevelSettings
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# A given ground takes in floors down to this much below it [m]
GIVEN_TOLERANCE = 0.02
# A level opened for treads takes in what lies so little below them on their region: noise [m]
FLAT = 0.005
# A storey rarely begins higher over another one [m]; a scene with more storeys is a tower
HIGH_STOREY = 8.0
FEW = 4
# How many times larger the floors are that a stair joins than any of its treads and landings
TIMES_LARGER = 4
# Decimals of the grounds that are found
DECIMALS = 9
# Empty columns of rows that count heights
ROWS_AND_HEIGHTS = NO_ROWS, NO_HEIGHTS
# Shrinks nothing
UNSHRUNK = AreaTest(0, 0, np.empty(0, dtype=np.int64))


def given_spans(given: Sequence[LevelSettings]) -> list[tuple[float, float]]:
    """For each given level, the heights ``[low, high)`` of its surfaces [m].

    They begin `GIVEN_TOLERANCE` below its ground, and end just below its top, or where those of the
    next level begin, if that is lower.
    """
    spans = []
    for number, level in enumerate(given):
        above = given[number + 1].ground - GIVEN_TOLERANCE if given[number + 1 :] else np.inf
        top = above if level.top is None else min(above, level.top)
        spans.append((level.ground - GIVEN_TOLERANCE, top - LIMIT_SLACK))
    return spans


class Placed(NamedTuple):
    """The surfaces that count on their levels.

    Attributes:
        grounds, labels: heights and names of the levels that have surfaces, lowest first.
        level: of each surface, less than 0 for none, int32.
        number: the final number of each `level`, as levels without surfaces are left out.
        counts: rows of region, level and how many surfaces it has there; they may repeat.
        spare: see `Floors`.
    """

    grounds: list[float]
    labels: list[str]
    level: Int32
    number: Int
    counts: Int
    spare: list[Patch]


class Placing(NamedTuple):
    """The surfaces on levels that begin at some grounds, see `place_blocks`.

    Attributes:
        grounds: of the levels [m].
        leave_floors: whether floors made way for treads where a column has too few levels.
        level: of each surface, int32; LOST, LOST_GROUND or -1 for none.
        part, row_level, num_surfaces, low: of each row a part of a region, a level, how many of the
            part's surfaces are on it, and the lowest of their heights [m].
    """

    grounds: list[float]
    leave_floors: bool
    level: Int32
    part: Int
    row_level: Int
    num_surfaces: Int
    low: Float


class Heights(NamedTuple):
    """Counts of heights, see `list_heights`; arrays of shape (rows,), heights may repeat.

    Attributes:
        window: the number of a window of heights, int64.
        plateau: a height, in multiples of PLATEAU, int64.
        num_surfaces: how many surfaces lie there, int64.
        low: the lowest of them [m].
    """

    window: Int
    plateau: Int
    num_surfaces: Int
    low: Float

    def only(self, mask: Bool) -> Heights:
        """Some of the rows, by a mask."""
        return Heights._make(column[mask] for column in self)

    def most_common(self) -> float:
        """The lowest member of the most common height, rounded to plateaus [m]."""
        plateaus, where = np.unique(self.plateau, return_inverse=True)
        most = int(np.bincount(where, self.num_surfaces).argmax())
        return float(self.low[self.plateau == plateaus[most]].min())


class Placeable(NamedTuple):
    """The surfaces that are placed on levels, and what decides how.

    Attributes:
        regions: all regions.
        candidates: those of their surfaces that levels are made of.
        is_stacked: whether any of them lies over another one.
        tolerance: how far below a ground its floors may lie [m].
    """

    regions: Regions
    candidates: Candidates
    is_stacked: bool
    tolerance: float
    agent: AgentSettings
    settings: FloorSettings


def place_on_levels(
    regions: Regions,
    mask: Bool,
    given: Sequence[LevelSettings],
    agent: AgentSettings,
    settings: FloorSettings,
) -> Placed:
    """Place the surfaces of some regions, shape (regions,), on levels.

    Args:
        given: the levels of the configuration, whose surfaces lie in `given_spans`; levels are
            found if there are none.
    """
    key = np.empty(len(regions.surfaces.z), dtype=np.int8)
    stacked = np.empty(regions.blocks.num, dtype=np.bool_)
    spans = np.array(given_spans(given), dtype=np.float64).reshape(-1, 2)
    run_in_chunks(
        kernels.mark_candidates, regions.blocks.num, regions.labelled(mask), spans, key, stacked
    )
    # stairs matter only where surfaces lie over each other
    candidates = Candidates(key, NO_KEY, np.empty(0, np.bool_))
    is_stacked = bool(stacked.any())
    if is_stacked:
        candidates = _find_stairs(regions, key, agent.traversable_floor_height)
    tolerance = GIVEN_TOLERANCE if given else LIMIT_SLACK
    placeable = Placeable(regions, candidates, is_stacked, tolerance, agent, settings)
    if given:
        placing = _place(placeable, sorted(level.ground for level in given))
    else:
        placing = _lower_grounds(placeable, _find_grounds(placeable))
    spare: list[Patch] = []
    if (placing.row_level <= LOST).any():
        placing, spare = _make_room(placeable, placing)
    names = {level.ground: level.name for level in given}
    return _number_levels(regions, placing, names, spare)


def _find_stairs(regions: Regions, key: NDArray[np.int8], step: float) -> Candidates:
    """Tell which candidates, by their keys, are parts of stairs and ramps.

    A plateau (a tread, a landing, a piece of a ramp) is a part of a stair if going only up from
    it, and also only down, leads to a floor more than four times as large. A floor is all of a
    region within half a step of its height, since walls and thresholds divide it.
    """
    joining = Joining(min(step, PLATEAU), step)
    labels = label_surfaces(regions.surfaces, joining, key.astype(np.int32))
    # neighbours at about one height are a plateau; each lies in one part of a region
    _, (rows, low) = regions.blocks.list_rows(
        tally, ROWS_AND_HEIGHTS, regions.surfaces, labels.part, regions.labels.part, NO_KEY
    )
    whole_of_part = labels.wholes()
    num = int(whole_of_part.max(initial=-1)) + 1
    plateau = whole_of_part[rows[:, 0]]
    region = regions.of_part[rows[:, 1]].astype(np.int64)
    half_step = max(step, PLATEAU) / 2
    height = np.full(num, np.inf)
    np.minimum.at(height, plateau, low)
    area = np.zeros(num, dtype=np.int64)
    np.maximum.at(area, plateau, _areas_about(region, rows[:, 2], rows[:, 3], half_step))
    one_end, other_end = labels.links(whole_of_part)
    is_lower = height[one_end] < height[other_end]
    lower = np.where(is_lower, one_end, other_end)
    upper = np.where(is_lower, other_end, one_end)
    rises = height[lower] < height[upper]
    lower = lower[rises]
    upper = upper[rises]
    above, below = kernels.climb(
        lower,
        upper,
        area,
        np.argsort(height[lower], kind="stable"),
        np.argsort(height[upper], kind="stable"),
    )
    is_stair = TIMES_LARGER * area < np.minimum(above, below)
    return Candidates(key, labels.part, is_stair[whole_of_part])


def _find_grounds(placeable: Placeable) -> list[float]:
    """Find the ground heights of the storeys, lowest first.

    The first is the lowest floor that is large enough after shrinking; each further one the
    lowest such floor over floors of the storey below. So a hill, a half-storey, a stair or a
    platform with nothing under it opens none.
    """
    half_step = max(placeable.agent.traversable_floor_height, PLATEAU) / 2
    ground = _lowest_plateau(placeable, -np.inf, half_step)
    if ground is None:
        window = HeightWindow(-np.inf, LOWEST, half_step)
        ground = _list_heights(placeable, window, UNSHRUNK).most_common()
    grounds = [ground]
    while placeable.is_stacked:
        # of a tower, not all that is above is listed for each storey
        tops = [np.inf] if len(grounds) <= FEW else [grounds[-1] + HIGH_STOREY, np.inf]
        ground = _lowest_plateau(placeable, grounds[-1], half_step, tops)
        if ground is None:
            break
        grounds.append(ground)
    return [round(ground, DECIMALS) for ground in grounds]


def _lowest_plateau(
    placeable: Placeable, ground: float, half_step: float, tops: Sequence[float] = (np.inf,)
) -> float | None:
    """The ground of the lowest large floor over another ground, or None.

    Windows of heights are one step high, half a step apart, below each of `tops` in turn.
    """
    test = area_test(placeable.regions.lattice, placeable.settings)
    for top in tops:
        every = _list_heights(placeable, HeightWindow(ground, EVERY, half_step, top), UNSHRUNK)
        numbers, where = np.unique(every.window, return_inverse=True)
        sums = np.bincount(where, every.num_surfaces)
        count_in = dict(zip(numbers.tolist(), sums.tolist(), strict=True))
        for number in sorted({k for n in count_in for k in (n - 1, n) if k >= numbers[0]}):
            end = (number + 2) * half_step
            if count_in.get(number, 0) + count_in.get(number + 1, 0) < test.min_cells or end > top:
                continue
            window = HeightWindow(ground, number, half_step, end)
            # of the cells that shrinking leaves, so without stairs or thresholds
            heights = _list_heights(placeable, window, test)
            if heights.num_surfaces.sum() >= test.min_cells:
                if not len(heights.num_surfaces):
                    heights = every.only(np.isin(every.window, [number, number + 1]))
                return heights.most_common()
    return None


def _list_heights(placeable: Placeable, window: HeightWindow, test: AreaTest) -> Heights:
    """Count the heights in a window, see `list_heights`."""
    regions = placeable.regions
    _, (rows, low) = regions.blocks.list_rows(
        kernels.list_heights, ROWS_AND_HEIGHTS, regions.surfaces, placeable.candidates, window, test
    )
    return Heights(window=rows[:, 0], plateau=rows[:, 1], num_surfaces=rows[:, 3], low=low)


def _lower_grounds(placeable: Placeable, grounds: list[float]) -> Placing:
    """Lower each ground to parts of the level below that belong to its floor, and place all.

    Such parts lie within a step below it, are no stairs, and steps join them to nothing else.
    """
    placing = _place(placeable, grounds)
    for _ in grounds[1:]:
        lowered = _lower_once(placeable, placing)
        if lowered == placing.grounds:
            break
        placing = _place(placeable, lowered)
    if placing.grounds != sorted(placing.grounds):
        placing = _place(placeable, sorted(placing.grounds))
    return placing


def _lower_once(placeable: Placeable, placing: Placing) -> list[float]:
    """The grounds, each lowered to parts of the level below as these are placed."""
    regions = placeable.regions
    candidates = placeable.candidates
    step = placeable.agent.traversable_floor_height
    grounds = placing.grounds
    labels = label_surfaces(regions.surfaces, Joining(step, step), placing.level)
    _, (rows, heights) = regions.blocks.list_rows(
        tally, ROWS_AND_HEIGHTS, regions.surfaces, labels.part, candidates.plateau, placing.level
    )
    whole_of_part = labels.wholes()
    num = int(whole_of_part.max(initial=-1)) + 1
    part = whole_of_part[rows[:, 0]]
    low = np.full(num, np.inf)
    np.minimum.at(low, part, heights)
    level = np.zeros(num, dtype=np.int64)
    level[part] = rows[:, 2]
    is_floor = ~candidates.is_stair[rows[:, 1]]
    has_floor = np.bincount(part[is_floor], minlength=num) > 0
    one_end, other_end = labels.links(whole_of_part)
    from_part = np.append(one_end, other_end)
    to_part = np.append(other_end, one_end)
    lowered = list(grounds)
    for k in range(1, len(grounds)):
        is_below = level[from_part] == k - 1
        is_above = level[to_part] == k
        leads_above = np.bincount(from_part[is_below & is_above], minlength=num) > 0
        leads_elsewhere = np.bincount(from_part[is_below & ~is_above], minlength=num) > 0
        is_near = low >= grounds[k] - step - LIMIT_SLACK
        belongs = has_floor & leads_above & ~leads_elsewhere & is_near
        if belongs.any():
            lowered[k] = min(grounds[k], round(float(low[belongs].min()), DECIMALS))
    return lowered


def _place(placeable: Placeable, grounds: list[float], leave_floors: bool = False) -> Placing:
    """Place the candidates on levels, see `place_blocks`.

    Args:
        grounds: of the levels, ascending [m].
        leave_floors: whether floors make way for treads where a column has too few levels.
    """
    regions = placeable.regions
    level = np.empty(len(regions.surfaces.z), dtype=np.int32)
    _, (rows, low) = regions.blocks.list_rows(
        kernels.place_blocks,
        ROWS_AND_HEIGHTS,
        regions.surfaces,
        placeable.candidates,
        (np.array(grounds), placeable.tolerance, leave_floors),
        (regions.labels.part, level),
    )
    return Placing(
        grounds=grounds,
        leave_floors=leave_floors,
        level=level,
        part=rows[:, 0],
        row_level=rows[:, 2],
        num_surfaces=rows[:, 3],
        low=low,
    )


def _make_room(placeable: Placeable, placing: Placing) -> tuple[Placing, list[Patch]]:
    """Place surfaces again where columns have more of them than there are levels.

    Treads or else the floors under them are left out, if they are spare, see `_are_spare`. Else a
    level is opened at the lowest one without a place, or a little below it on its region, so that
    an uneven floor stays whole.

    Returns:
        The surfaces on their levels, and the spare ones that are left out.
    """
    regions = placeable.regions
    walks = _label_walks(placeable, placeable.candidates.key)
    while True:
        lost_regions = _list_lost_regions(regions, placing)
        if _are_spare(placeable, placing, lost_regions, walks):
            break
        without_floors = _place(placeable, placing.grounds, leave_floors=True)
        lost_floors = _list_lost_regions(regions, without_floors)
        if _are_spare(placeable, without_floors, lost_floors, walks):
            placing = without_floors
            lost_regions = lost_floors
            break
        ground = _next_ground(placeable.candidates, placing, lost_regions)
        placing = _place(placeable, sorted([*placing.grounds, ground]))
    spare = []
    for members in lost_regions:
        is_lost = placing.level[members.place] <= LOST
        spare.append(describe_members(regions.lattice, members.only(is_lost)))
    return placing, spare


def _list_lost_regions(regions: Regions, placing: Placing) -> list[Members]:
    """All surfaces of each region of which any is without a place."""
    is_lost = placing.row_level <= LOST
    lost_regions = np.unique(regions.of_part[placing.part[is_lost]])
    return [regions.members(region) for region in lost_regions.tolist()]


def _next_ground(candidates: Candidates, placing: Placing, lost_regions: list[Members]) -> float:
    """Where a level is opened for surfaces without a place."""
    grounds = placing.grounds
    lost = float(placing.low[placing.row_level == LOST].min(initial=np.inf))
    if lost == np.inf:
        # all are grounds, so their columns are taken on every level: open one above all
        return max(grounds) + 1.0
    heights = [members.z[candidates.key[members.place] >= 0] for members in lost_regions]
    z = np.concatenate(heights)
    lowest = max([lost - FLAT, *(ground + LIMIT_SLACK for ground in grounds if ground <= lost)])
    return round(float(z[(z >= lowest) & (z <= lost)].min(initial=lost)), DECIMALS)


def _are_spare(
    placeable: Placeable, placing: Placing, lost_regions: list[Members], walks: Labels
) -> bool:
    """Whether surfaces without a place can be left out.

    They are rims, nowhere wider than floors are shrunk by, or under treads and no floor that
    would count by itself; and they cut no walk: without them, the other surfaces make no more
    connected parts that are large enough for floors.

    Args:
        lost_regions: the surfaces of the regions with such surfaces.
        walks: all candidates, see `_label_walks`.
    """
    if not lost_regions:
        return True
    lattice = placeable.regions.lattice
    settings = placeable.settings
    limits = settings
    if not placing.leave_floors:
        rim = {"min_area": lattice.cell_size**2, "shrink": settings.shrink / 2}
        limits = settings.model_copy(update=rim)
    for members in lost_regions:
        is_lost = np.zeros(lattice.width * lattice.height, dtype=np.bool_)
        is_lost[members.cell[placing.level[members.place] <= LOST]] = True
        if is_large_enough(lattice, limits, is_lost):
            return False
    remaining_key = np.where(placing.level <= LOST, np.int8(-1), placeable.candidates.key)
    remaining = _label_walks(placeable, remaining_key)
    needed = area_test(lattice, settings).min_cells
    num_remaining = _count_walks(remaining, lost_regions, needed)
    return num_remaining <= _count_walks(walks, lost_regions, needed)


def _label_walks(placeable: Placeable, key: NDArray[np.int8]) -> Labels:
    """The parts that steps join; for the key, see `label_blocks`."""
    surfaces = placeable.regions.surfaces
    joining = region_joining(surfaces.lattice, placeable.agent)
    return label_surfaces(surfaces, joining, key.astype(np.int32))


def _count_walks(walks: Labels, regions: list[Members], needed: int) -> int:
    """How many walks have so many surfaces of a region, or more."""
    whole_of_part = walks.wholes()
    num_walks = 0
    for members in regions:
        part = walks.part[members.place]
        walk = whole_of_part[part[part >= 0]]
        num_walks += int(np.count_nonzero(np.bincount(walk) >= needed))
    return num_walks


def _number_levels(
    regions: Regions, placing: Placing, names: dict[float, str | None], spare: list[Patch]
) -> Placed:
    """Leave out the levels without surfaces.

    Args:
        names: of levels, by their grounds; others are named by their numbers.
        spare: see `Floors`.
    """
    has_level = placing.row_level >= 0
    level = placing.row_level[has_level]
    used = np.bincount(level, minlength=len(placing.grounds)) > 0
    number = np.cumsum(used, dtype=np.int64) - 1
    grounds = [placing.grounds[k] for k in np.flatnonzero(used).tolist()]
    region = regions.of_part[placing.part[has_level]]
    return Placed(
        grounds=grounds,
        labels=_label([names.get(ground) for ground in grounds]),
        level=placing.level,
        number=number,
        counts=np.stack([region, number[level], placing.num_surfaces[has_level]], axis=1),
        spare=spare,
    )


def _areas_about(region: Int, number: Int, count: Int, half_step: float) -> Int:
    """By row, how many surfaces of the region lie within half a step of the height.

    `number` is the height in multiples of PLATEAU; rows may repeat.
    """
    near = int(half_step / PLATEAU + LIMIT_SLACK)
    # one region after the other on one axis, so far apart that no window reaches the next
    lowest = number.min(initial=0)
    place = region * int(number.max(initial=0) - lowest + 2 * near + 1) + number - lowest
    places, where = np.unique(place, return_inverse=True)
    total = np.append(0, np.bincount(where, count).astype(np.int64).cumsum())
    first = np.searchsorted(places, places - near, side="left")
    end = np.searchsorted(places, places + near, side="right")
    area: Int = (total[end] - total[first])[where]
    return area


def _label(names: list[str | None]) -> list[str]:
    """Name the levels that have no name by their number, each differently."""
    labels: list[str] = []
    for number, name in enumerate(names):
        label = name or f"level {number}"
        while label in labels or (not name and label in names):
            label += "'"
        labels.append(label)
    return labels
