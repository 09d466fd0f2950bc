"""Storeys: where they begin, which surfaces are stairs between them, and the level of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.blocks import BlockTable, Seen, fit
from navbake.baker.floors.kernels import levels as kernels
from navbake.baker.floors.kernels.labels import PLATEAU, Joining, tally
from navbake.baker.floors.kernels.levels import EVERY, LOST, LOWEST, Kept
from navbake.baker.floors.kernels.members import AreaTest, Members
from navbake.baker.floors.sheets import (
    NO_HEIGHTS,
    NO_KEY,
    NO_ROWS,
    Labels,
    Patch,
    Sheets,
    area_test,
    describe_members,
    is_large,
)
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import AgentSettings, FloorSettings, LevelSettings
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int, Int32

# A given ground takes in floors down to this much below it [m]
GIVEN_TOLERANCE = 0.02
# A level opened for treads takes in what lies so little below them on their sheet: noise [m]
FLAT = 0.005
# A storey rarely begins higher over another one [m]; a scene with more storeys is a tower
HIGH_STOREY, FEW = 8.0, 4
# How many times larger the floors are that a stair joins than any of its treads and landings
TIMES_LARGER = 4
# Decimals of the grounds that are found
DECIMALS = 9
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
        spans.append((level.ground - GIVEN_TOLERANCE, top - SLACK))
    return spans


class Placed(NamedTuple):
    """The surfaces that count on their levels.

    Attributes:
        grounds, labels: heights and names of the levels that have surfaces, lowest first.
        level: of each surface, less than 0 for none, int32.
        number: the final number of each `level`, as levels without surfaces are left out.
        counts: rows of sheet, level and how many surfaces it has there; they may repeat.
        changed: the blocks where any of that may have changed.
        spare: see `Floors`.
    """

    grounds: list[float]
    labels: list[str]
    level: Int32
    number: Int
    counts: Int
    changed: Bool
    spare: list[Patch]


class Storeys:
    """Places surfaces on levels, block by block, again where something changed."""

    def __init__(self, sheets: Sheets, agent: AgentSettings, settings: FloorSettings) -> None:
        self._sheets, self._agent, self._settings = sheets, agent, settings
        self._step = agent.traversable_floor_height
        self._half = max(self._step, PLATEAU) / 2
        num = sheets.blocks.num
        self._key, self._seen = np.empty(0, dtype=np.int8), Seen(num)
        self._stacked = np.zeros(num, dtype=np.bool_)
        # the last update in which something changed in each block, or as near as shrinking looks
        self._now, (self._last, self._last_near) = 0, np.zeros((2, num), dtype=np.int64)
        self._reach = area_test(sheets.lattice, settings).reach
        self._known: dict[Any, tuple[int, Any]] = {}
        self._kept: dict[Any, tuple[int, Any]] = {}

    def update(self, counts: Bool, given: Sequence[LevelSettings]) -> Placed:
        """Place the surfaces of the sheets that count, shape (sheets,).

        Args:
            given: the levels of the configuration, whose surfaces lie in `given_spans`; levels are
                found if there are none.
        """
        sheets = self._sheets
        self._kept, self._known = self._known, {}
        stale, near = sheets.last > self._now, sheets.last_near > self._now
        self._now = sheets.now
        self._last[stale] = self._last_near[near] = self._now
        others = self._seen.differ(sheets.labels.count, counts[sheets.of_part])
        self._mark(others)
        stale |= others
        self._key = fit(self._key, len(sheets.surfaces.z))
        bounds = np.array(given_spans(given), dtype=np.float64).reshape(-1, 2)
        chosen = np.flatnonzero(stale)
        asked = sheets.labelled(counts), bounds, self._key, chosen, self._stacked
        run_in_bands(kernels.mark_kept, len(chosen), *asked)
        kept = self._find_stairs()
        if given:
            grounds, names = [level.ground for level in given], [level.name for level in given]
            return self._assign(kept, grounds, names, GIVEN_TOLERANCE)
        return self._assign(kept, self._lower_grounds(kept, self._find_grounds(kept)), [], SLACK)

    def _mark(self, blocks: Bool) -> None:
        """Mark blocks in which anything may have changed."""
        self._last[blocks] = self._now
        self._last_near[self._sheets.blocks.around(blocks, self._reach)] = self._now

    def _recall(self, name: Any, make: Callable[[], Any], reach: int = 0) -> tuple[Any, Bool]:
        """What the last update kept under a name, or `make()`, and the blocks that are stale in it.

        It depends on cells up to `reach` away, no farther than shrinking looks.
        """
        tick, known = self._known.get(name) or self._kept.get(name) or (-1, make())
        self._known[name] = self._now, known
        return known, (self._last_near if reach else self._last) > tick

    def _table(self) -> BlockTable:
        return BlockTable(self._sheets.blocks.num, NO_ROWS, NO_HEIGHTS)

    def _find_stairs(self) -> Kept:
        """The surfaces that are kept, and which are parts of stairs and ramps.

        A plateau (a tread, a landing, a piece of a ramp) is a part of a stair if going only up from
        it, and also only down, leads to a floor more than four times as large. A floor is all of a
        sheet within half a step of its height, since walls and thresholds divide it. Stairs matter
        only where surfaces lie over each other.
        """
        sheets = self._sheets
        if not self._stacked.any():
            self._recall("flat", lambda: self._mark(sheets.blocks.all()))
            return Kept(self._key, NO_KEY, NO_ROWS[:, 0], np.empty(0, dtype=np.bool_))
        blocks, joining = sheets.blocks, Joining(min(self._step, PLATEAU), self._step)
        if "stairs" not in self._kept:
            self._mark(blocks.all())
        (labels, table, seen), stale = self._recall(
            "stairs", lambda: (Labels(blocks, joining), self._table(), Seen(blocks.num))
        )
        labels.update(sheets.surfaces, stale, self._key.astype(np.int32))
        # neighbours at about one height are a plateau; each lies in one part of a sheet
        asked = sheets.lattice, sheets.surfaces, labels.part, sheets.labels.part, NO_KEY
        table.fill(tally, np.flatnonzero(stale), *asked)
        block, (rows, low) = table.take()
        whole, links = labels.merge()
        num = int(whole.max(initial=-1)) + 1
        plateau = whole[labels.offset[block] + rows[:, 0]]
        sheet = sheets.sheet_at(block, rows[:, 1]).astype(np.int64)
        height, area = np.full(num, np.inf), np.zeros(num, dtype=np.int64)
        np.minimum.at(height, plateau, low)
        np.maximum.at(area, plateau, _areas_about(sheet, rows[:, 2], rows[:, 3], self._half))
        a, b = links
        lower, upper = np.where(height[a] < height[b], (a, b), (b, a))
        rises = height[lower] < height[upper]
        lower, upper = lower[rises], upper[rises]
        orders = (np.argsort(height[ends], kind="stable") for ends in (lower, upper))
        above, below = kernels.climb(lower, upper, area, *orders)
        is_stair = (TIMES_LARGER * area < np.minimum(above, below))[whole]
        # plateaus of a stale block are numbered anew
        self._mark(stale | seen.differ(labels.count, is_stair))
        return Kept(self._key, labels.part, labels.offset, is_stair)

    def _find_grounds(self, kept: Kept) -> list[float]:
        """Find the ground heights of the storeys, lowest first.

        The first is the lowest floor that is large enough after shrinking; each further one the
        lowest such floor over floors of the storey below. So a hill, a half-storey, a stair or a
        platform with nothing under it opens none.
        """
        ground = self._lowest_plateau(kept, -np.inf)
        if ground is None:
            rows, low = self._list_heights(kept, -np.inf, LOWEST, UNSHRUNK)
            ground = _common_height(rows, low)
        grounds = [ground]
        while self._stacked.any():
            # of a tower, not all that is above is listed for each storey
            tops = (grounds[-1] + HIGH_STOREY, np.inf) if len(grounds) > FEW else (np.inf,)
            ground = self._lowest_plateau(kept, grounds[-1], tops)
            if ground is None:
                break
            grounds.append(ground)
        return [round(ground, DECIMALS) for ground in grounds]

    def _lowest_plateau(
        self, kept: Kept, ground: float, tops: Sequence[float] = (np.inf,)
    ) -> float | None:
        """The ground of the lowest large floor over another ground, or None.

        Windows of heights are one step high, half a step apart, below each of `tops` in turn.
        """
        test = area_test(self._sheets.lattice, self._settings)
        for top in tops:
            every, all_low = self._list_heights(kept, ground, EVERY, UNSHRUNK, top)
            windows, where = np.unique(every[:, 0], return_inverse=True)
            count = np.bincount(where, every[:, 3])
            counts = dict(zip(windows.tolist(), count.tolist(), strict=True))
            for window in sorted({k for n in counts for k in (n - 1, n) if k >= windows[0]}):
                end = (window + 2) * self._half
                if counts.get(window, 0) + counts.get(window + 1, 0) < test.needed or end > top:
                    continue
                rows, low = self._list_heights(kept, ground, window, test, end)
                if rows[:, 3].sum() >= test.needed:
                    if not len(rows):
                        chosen = np.isin(every[:, 0], [window, window + 1])
                        rows, low = every[chosen], all_low[chosen]
                    # of the cells that shrinking leaves, so without stairs or thresholds
                    return _common_height(rows, low)
        return None

    def _list_heights(
        self, kept: Kept, ground: float, window: int, test: AreaTest, top: float = np.inf
    ) -> tuple[Int, Float]:
        """Rows of the heights in a window, and the lowest of each row, see `list_heights`."""
        sheets, heights = self._sheets, (ground, window, self._half, top)
        name = "heights", ground, window, test.reach, top
        table, stale = self._recall(name, self._table, test.reach)
        asked = sheets.lattice, sheets.surfaces, kept, heights, test
        table.fill(kernels.list_heights, np.flatnonzero(stale), *asked)
        _, (rows, low) = table.take()
        return rows, low

    def _lower_grounds(self, kept: Kept, grounds: list[float]) -> list[float]:
        """Lower each ground to parts of the level below that belong to its floor.

        They lie within a step below it, are no stairs, and steps join them to nothing else.
        """
        sheets, joining = self._sheets, Joining(self._step, self._step)
        for _ in grounds[1:]:
            on, _ = self._place(kept, grounds, SLACK)
            (labels, table), stale = self._recall(
                ("parts", *grounds), lambda: (Labels(sheets.blocks, joining), self._table())
            )
            labels.update(sheets.surfaces, stale, on)
            asked = sheets.lattice, sheets.surfaces, labels.part, kept.plateau, on
            table.fill(tally, np.flatnonzero(stale), *asked)
            block, (rows, heights) = table.take()
            whole, links = labels.merge()
            part, num = whole[labels.offset[block] + rows[:, 0]], int(whole.max(initial=-1)) + 1
            low, level = np.full(num, np.inf), np.zeros(num, dtype=np.int64)
            np.minimum.at(low, part, heights)
            level[part] = rows[:, 2]
            is_floor = ~kept.is_stair[kept.offset[block] + rows[:, 1]]
            has_floor = np.bincount(part[is_floor], minlength=num) > 0
            here, there = np.concatenate([links, links[::-1]], axis=1)
            lowered = list(grounds)
            for k in range(1, len(grounds)):
                on_below, is_above = level[here] == k - 1, level[there] == k
                to_above, to_others = (
                    np.bincount(here[on_below & on_other], minlength=num) > 0
                    for on_other in (is_above, ~is_above)
                )
                joins = has_floor & to_above & ~to_others & (low >= grounds[k] - self._step - SLACK)
                if joins.any():
                    lowered[k] = min(grounds[k], round(float(low[joins].min()), DECIMALS))
            if lowered == grounds:
                break
            grounds = lowered
        return grounds

    def _place(
        self, kept: Kept, grounds: list[float], tolerance: float, leave_floors: bool = False
    ) -> tuple[Int32, BlockTable]:
        """Place surfaces on levels, see `place_blocks`.

        Returns the level of each surface, and a table by block: a part, 0, a level, how many of the
        part's surfaces are on it, and the lowest of their heights [m].
        """
        sheets, surfaces = self._sheets, self._sheets.surfaces
        name = "places", leave_floors, tolerance, *grounds
        (level, table), stale = self._recall(name, lambda: (NO_KEY, self._table()))
        level = fit(level, len(surfaces.z))
        self._known[name] = self._now, (level, table)
        rule, own = (np.array(grounds), tolerance, leave_floors), (sheets.labels.part, level)
        asked = sheets.lattice, surfaces, kept, rule, own
        table.fill(kernels.place_blocks, np.flatnonzero(stale), *asked)
        return level, table

    def _assign(
        self, kept: Kept, grounds: list[float], names: list[str | None], tolerance: float
    ) -> Placed:
        """Give each surface its level, see `place_blocks`; no two of a column share one.

        Where columns have more surfaces than there are levels, treads or else the floors under them
        are left out, if they are spare, see `_are_spare`. Else a level is opened at the lowest one
        without a place, or a little below it on its sheet, so that an uneven floor stays whole.

        Args:
            names: the levels' names, None for those without; empty if none has one.
            tolerance: how far below a ground its floors may lie [m].
        """
        sheets, named = self._sheets, dict(zip(grounds, names, strict=False))
        while True:
            grounds = sorted(grounds)
            for leave_floors in (False, True, False):
                name = leave_floors, tolerance, *grounds
                level, table = self._place(kept, grounds, tolerance, leave_floors)
                block, (rows, low) = table.take()
                part, _, on, count = rows.T
                lost = np.unique(sheets.sheet_at(block, part)[on <= LOST]).tolist()
                members = [sheets.members(sheet) for sheet in lost]
                if are_spare := self._are_spare(kept, level, members, leave_floors, name):
                    break
            if are_spare:
                break
            own = float(low[on == LOST].min(initial=np.inf))
            z = np.concatenate([one.z[kept.key[one.place] >= 0] for one in members])
            lowest = max([own - FLAT, *(ground + SLACK for ground in grounds if ground <= own)])
            own = float(z[(z >= lowest) & (z <= own)].min(initial=own))
            # where all are grounds, their columns are taken on every level: open one above all
            ground = max(grounds) + 1.0 if own == np.inf else round(own, DECIMALS)
            grounds = [*grounds, ground]
        block, part, on, count = (column[on >= 0] for column in (block, part, on, count))
        used = np.bincount(on, minlength=len(grounds)) > 0
        number = np.cumsum(used, dtype=np.int64) - 1
        is_new = ("places", *name) not in self._kept
        grounds = [ground for ground, is_used in zip(grounds, used, strict=True) if is_used]
        labels = _label([named.get(ground) for ground in grounds])
        counts = np.stack([sheets.sheet_at(block, part), number[on], count], axis=1)
        changed = sheets.blocks.all() if is_new else self._last == self._now
        spare = [one.only(level[one.place] <= LOST) for one in members]
        patches = [describe_members(sheets.lattice, one) for one in spare]
        return Placed(grounds, labels, level, number, counts, changed, patches)

    def _are_spare(
        self, kept: Kept, level: Int32, members: list[Members], leave_floors: bool, name: Any
    ) -> bool:
        """Whether surfaces without a place can be left out.

        They are rims, nowhere wider than floors are shrunk by, or under treads and no floor that
        would count by itself; and they cut no walk: without them, the other surfaces make no more
        connected parts that are large enough for floors.

        Args:
            level: of each surface.
            members: of the sheets with such surfaces.
            leave_floors: whether floors make way for treads.
            name: of the places, see `_recall`.
        """
        if not members:
            return True
        sheets, settings = self._sheets, self._settings
        test = area_test(sheets.lattice, settings)
        if not leave_floors:
            rim = {"min_area": sheets.lattice.cell_size**2, "shrink": settings.shrink / 2}
            settings = settings.model_copy(update=rim)
        for one in members:
            marked = np.zeros(sheets.lattice.width * sheets.lattice.height, dtype=np.bool_)
            marked[one.cell[level[one.place] <= LOST]] = True
            if is_large(sheets.lattice, settings, marked):
                return False
        num_walks, every = [0, 0], kept.key.astype(np.int32)
        for n, key in enumerate((every, np.where(level <= LOST, np.int32(-1), every))):
            labels, stale = self._recall(
                ("walks", name if n else "all"), lambda: Labels(sheets.blocks, sheets.joining)
            )
            labels.update(sheets.surfaces, stale, key)
            whole, _ = labels.merge()
            for one in members:
                one = one.only(labels.part[one.place] >= 0)
                part = labels.offset[sheets.blocks.of(one.cell)] + labels.part[one.place]
                num_walks[n] += int((np.bincount(whole[part]) >= test.needed).sum())
        return num_walks[1] <= num_walks[0]


def _areas_about(sheet: Int, number: Int, count: Int, half_step: float) -> Int:
    """By row, how many surfaces of the sheet lie within half a step of the height.

    `number` is the height in multiples of PLATEAU; rows may repeat.
    """
    near = int(half_step / PLATEAU + SLACK)
    # one sheet after the other on one axis, so far apart that no window reaches the next
    lowest = number.min(initial=0)
    place = sheet * int(number.max(initial=0) - lowest + 2 * near + 1) + number - lowest
    places, where = np.unique(place, return_inverse=True)
    total = np.append(0, np.bincount(where, count).astype(np.int64).cumsum())
    first = np.searchsorted(places, places - near, side="left")
    end = np.searchsorted(places, places + near, side="right")
    area: Int = (total[end] - total[first])[where]
    return area


def _common_height(rows: Int, low: Float) -> float:
    """The lowest member of the most common height, rounded to plateaus [m]."""
    numbers, where = np.unique(rows[:, 1], return_inverse=True)
    most = int(np.bincount(where, rows[:, 3]).argmax())
    return float(low[rows[:, 1] == numbers[most]].min())


def _label(names: list[str | None]) -> list[str]:
    """Name the levels that have no name by their number, each differently."""
    labels: list[str] = []
    for number, name in enumerate(names):
        label = name or f"level {number}"
        while label in labels or (not name and label in names):
            label += "'"
        labels.append(label)
    return labels
