"""Storeys: at which heights they begin, what is a stair between them, and what is on which."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.blocks import Rows, gather_rows
from navbake.baker.floors.kernels import levels as kernels
from navbake.baker.floors.kernels.levels import ANY_WINDOW, PLATEAU, HeightWindow, Kept
from navbake.baker.floors.kernels.members import Shrinking
from navbake.baker.floors.labels import Joining, Labels, fit
from navbake.baker.floors.rejected import GIVEN_TOLERANCE, given_spans
from navbake.baker.floors.sheets import AreaTest, Sheets
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import AgentSettings, FloorSettings, LevelSettings
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int, Int32

# How many times larger the floors are that a stair joins than any of its treads and landings
TIMES_LARGER = 4
# Decimals of the grounds that are found: what a float adds to 3.0 is no height
DECIMALS = 9


class Placed(NamedTuple):
    """The surfaces that count on their levels.

    Attributes:
        grounds, labels: heights and names of the levels that have surfaces, lowest first.
        key: 0 for the surfaces that count, -1 for the others, by place.
        level: the level of each by place, -1 for none, int32.
        number: what becomes of these numbers, as levels without surfaces are left out.
        counts: rows of sheet, level and how many surfaces it has there; they may repeat.
        changed: the blocks where any of that may be other than before.
    """

    grounds: list[float]
    labels: list[str]
    key: Int32
    level: Int32
    number: Int
    counts: Int
    changed: Bool


class Storeys:
    """Places surfaces on levels, block by block."""

    def __init__(self, sheets: Sheets, agent: AgentSettings, settings: FloorSettings) -> None:
        self._sheets, self._agent, self._settings = sheets, agent, settings
        self._step = agent.traversable_floor_height
        num = sheets.blocks.num
        self._key = np.empty(0, dtype=np.int32)
        self._seen = Rows(num, np.empty(0, dtype=np.bool_))
        self._stacked = np.zeros(num, dtype=np.bool_)
        self._stairs: _Stairs | None = None
        self._half = max(self._step, PLATEAU) / 2
        self._missed, self._is_flat = np.zeros(num, dtype=np.bool_), False
        self._kept_rows: dict[Any, Rows] = {}
        self._states: dict[Any, _State] = {}

    def miss(self, changed: Bool) -> None:
        """Note blocks with other surfaces, in an update in which nothing is to be placed."""
        self._missed |= changed

    def update(
        self, counts: Bool, changed: Bool, given: Sequence[LevelSettings], spans: bool
    ) -> Placed:
        """Place the surfaces of the sheets that count.

        Args:
            counts: shape (sheets,), bool.
            changed: the blocks with other surfaces than in the last update.
            given: the levels of the configuration; they are found if there are none.
            spans: whether only surfaces that lie between the given levels' grounds and tops count.
        """
        sheets, surfaces = self._sheets, self._sheets.surfaces
        labels = sheets.labels
        stale = changed | self._missed
        stale |= self._seen.put_all(labels.count, counts[sheets.of_part])
        self._missed[:] = False
        self._key = fit(self._key, len(surfaces.z))
        bounds = np.array(given_spans(given) if spans else [], dtype=np.float64).reshape(-1, 2)
        chosen = np.flatnonzero(stale)
        asked = sheets.labelled(counts), bounds, self._key, chosen, self._stacked
        run_in_bands(kernels.mark_kept, len(chosen), *asked)
        kept, stale = self._find_stairs(stale)
        if given:
            grounds, names = [level.ground for level in given], [level.name for level in given]
            tolerance = GIVEN_TOLERANCE
        else:
            grounds = self._lower_grounds(kept, self._find_grounds(kept, stale), stale)
            names, tolerance = [], SLACK
        placed = self._assign(kept, grounds, names, tolerance, stale, counts)
        self._forget()
        return placed

    def _rows(self, name: Any, stale: Bool, *empty: Any) -> tuple[Rows, Int]:
        """The rows that are kept under a name, and the blocks whose rows are to be found."""
        rows, chosen = self._kept_rows.get(name), stale
        if rows is None:
            rows, chosen = Rows(len(stale), *empty), np.ones_like(stale)
        self._kept_rows[name] = rows
        self._asked.add(name)
        return rows, np.flatnonzero(chosen)

    def _forget(self) -> None:
        """Forget what was not asked for, as it is not brought up to date."""
        self._kept_rows = {name: self._kept_rows[name] for name in self._asked}
        self._states = {name: self._states[name] for name in self._asked_states}

    def _find_stairs(self, stale: Bool) -> tuple[Kept, Bool]:
        """The surfaces that are kept, and whether they are stairs; and the blocks that changed.

        None is a stair where no two surfaces lie over each other, because there it makes no
        difference.
        """
        self._asked, self._asked_states = set[Any](), set[Any]()
        nothing = np.empty(0, dtype=np.int64)
        if not self._stacked.any():
            was, self._stairs = self._stairs, None
            kept = Kept(self._key, nothing.astype(np.int32), nothing, nothing.astype(np.bool_))
            return kept, stale if was is None else np.ones_like(stale)
        if self._stairs is None:
            self._stairs, stale = _Stairs(self._sheets, self._step), np.ones_like(stale)
        stairs = self._stairs
        stale = stale | stairs.update(self._key, stale)
        return Kept(self._key, stairs.labels.part, stairs.labels.offset, stairs.is_stair), stale

    def _find_grounds(self, kept: Kept, stale: Bool) -> list[float]:
        """Find the ground heights of the storeys, lowest first.

        The lowest storey's ground is the lowest floor that is large enough (as sheets are, after
        shrinking). A new storey begins where floors that are large enough lie over floors of the
        storey below; so a hill, a half-storey beside another, or a platform with nothing under it
        opens none, nor do stairs with their landings. What is too small for that gets its place in
        `_assign`.
        """
        ground = self._lowest_plateau(kept, -np.inf, stale)
        if ground is None:
            bins = self._measure(kept, -np.inf, int(ANY_WINDOW), stale, shrink=False)
            ground = _common_height(*bins[1:])
        grounds = [ground]
        while self._stacked.any():
            ground = self._lowest_plateau(kept, grounds[-1], stale)
            if ground is None:
                break
            grounds.append(ground)
        return [round(ground, DECIMALS) for ground in grounds]

    def _lowest_plateau(self, kept: Kept, ground: float, stale: Bool) -> float | None:
        """The ground of the lowest large floor over another ground, or None.

        Looks through windows of heights one step high, half a step apart, from the lowest up.
        """
        sheets, none = self._sheets, np.empty((0, 2), dtype=np.int64)
        rows, chosen = self._rows(("windows", ground), stale, none)
        asked = sheets.lattice, sheets.surfaces, kept, ground, self._half, chosen
        rows.put(chosen, *gather_rows(kernels.count_windows, len(chosen), *asked))
        (found,) = rows.take()
        if not len(found):
            return None
        windows, where = np.unique(found[:, 0], return_inverse=True)
        counts = dict(
            zip(windows.tolist(), np.bincount(where.ravel(), found[:, 1]).tolist(), strict=True)
        )
        test = AreaTest(sheets.lattice, self._settings)
        for window in sorted({k for n in counts for k in (n - 1, n) if k >= windows[0]}):
            if counts.get(window, 0) + counts.get(window + 1, 0) < test.needed:
                continue
            left, bins, count, low = self._measure(kept, ground, window, stale)
            if left >= test.whole_needed:
                if not len(bins):
                    _, bins, count, low = self._measure(kept, ground, window, stale, shrink=False)
                # the cells that shrinking leaves decide, not stairs or thresholds at the edge
                return _common_height(bins, count, low)
        return None

    def _measure(
        self, kept: Kept, ground: float, window: int, stale: Bool, *, shrink: bool = True
    ) -> tuple[int, Int, Int, Float]:
        """How many cells of a window are left, and rows of their heights: `measure_window`."""
        sheets, none = self._sheets, np.empty((0, 2), dtype=np.int64)
        shrinking = AreaTest(sheets.lattice, self._settings).shrinking
        if not shrink:
            shrinking = Shrinking(0, shrinking.disc[:0], shrinking.disc[:0])
        near = sheets.blocks.around(stale, shrinking.reach) if shrink else stale
        name = "window", ground, window, shrink
        rows, chosen = self._rows(name, near, none, np.empty(0))
        heights = HeightWindow(ground, window, self._half)
        asked = sheets.lattice, sheets.surfaces, kept, heights, shrinking, chosen
        rows.put(chosen, *gather_rows(kernels.measure_window, len(chosen), *asked))
        found, low = rows.take()
        is_total = found[:, 0] == ANY_WINDOW
        bins, count = found[~is_total].T
        return int(found[is_total, 1].sum()), bins, count, low[~is_total]

    def _lower_grounds(self, kept: Kept, grounds: list[float], stale: Bool) -> list[float]:
        """Lower each ground to what lies a little below it and is connected to nothing else.

        A part of the level below that lies within a step under a ground, and that steps join to
        nothing but the level of that ground, belongs up there: few floors are quite flat. A stair's
        upper treads are no such part.
        """
        for _ in grounds[1:]:
            parts = self._state(kept, grounds, SLACK, stale).parts(kept, stale)
            here, there = np.concatenate([parts.links, parts.links[::-1]], axis=1)
            lowered, num = list(grounds), len(parts.low)
            for k in range(1, len(grounds)):
                on_below, is_above = parts.level[here] == k - 1, parts.level[there] == k
                to_above, to_others = (
                    np.bincount(here[on_below & on_other], minlength=num) > 0
                    for on_other in (is_above, ~is_above)
                )
                joins = parts.has_floor & to_above & ~to_others
                joins &= parts.low >= grounds[k] - self._step - SLACK
                if joins.any():
                    lowered[k] = min(grounds[k], round(float(parts.low[joins].min()), DECIMALS))
            if lowered == grounds:
                break
            grounds = lowered
        return grounds

    def _state(self, kept: Kept, grounds: Sequence[float], tolerance: float, stale: Bool) -> _State:
        """The surfaces on the levels of some grounds, up to date."""
        name = tuple(grounds), tolerance
        state, fresh = self._states.get(name), False
        if state is None:
            state, fresh = _State(self._sheets, self._step, *name), True
            self._states[name] = state
        if name not in self._asked_states:
            self._asked_states.add(name)
            state.update(kept, np.ones_like(stale) if fresh else stale)
        return state

    def _assign(
        self,
        kept: Kept,
        grounds: list[float],
        names: list[str | None],
        tolerance: float,
        stale: Bool,
        counts: Bool,
    ) -> Placed:
        """Give each surface its level; none shares a column's level with another.

        A surface belongs to the highest ground at or below it (the lowest ones to the first). Where
        two of a column would be on one level, its surfaces are placed on the levels in their order,
        treads and landings of stairs moved rather than floors (see `place_blocks`). Only where a
        column has more surfaces than there are levels, a level of its own is opened at the lowest
        surface that found no place.

        Args:
            names: the levels' names, None for those without; empty if none has one.
            tolerance: how far below a ground its floors may lie [m].
            counts: the sheets that are placed, shape (sheets,).
        """
        if not names and len(grounds) == 1 and not self._stacked.any():
            # one surface a column, and one level
            where = stale if self._is_flat else np.ones_like(stale)
            self._is_flat, counted = True, np.flatnonzero(counts)
            rows = np.stack([counted, 0 * counted, self._sheets.size[counted]], axis=1)
            only = np.zeros(1, dtype=np.int64)
            return Placed(grounds, _label([None]), self._key, self._key, only, rows, where)
        was_flat, self._is_flat = self._is_flat, False
        named = dict(zip(grounds, names, strict=False))
        grounds = sorted(grounds)
        state = self._state(kept, grounds, tolerance, stale)
        while state.lost[:, 0].any():
            own = float(state.lost[:, 1].min())
            # where all are grounds, their columns are taken on every level: open one above all
            ground = max(grounds) + 1.0 if own == np.inf else round(own, DECIMALS)
            grounds = sorted([*grounds, ground])
            state = self._state(kept, grounds, tolerance, stale)
        used = np.asarray(state.used.any(axis=0))
        number = np.cumsum(used, dtype=np.int64) - 1
        grounds = [ground for ground, is_used in zip(grounds, used, strict=True) if is_used]
        labels = _label([named.get(ground) for ground in grounds])
        on_levels = state.counts()
        on_levels[:, 1] = number[on_levels[:, 1]]
        changed = np.ones_like(stale) if state.is_new or was_flat else stale
        return Placed(grounds, labels, self._key, state.level, number, on_levels, changed)


class _Parts(NamedTuple):
    """The connected parts of levels.

    Attributes:
        low: the lowest height of each [m].
        has_floor: whether any of it is no stair.
        level: of each.
        links: pairs of parts on different levels that are a step apart, shape (2, n).
    """

    low: Float
    has_floor: Bool
    level: Int
    links: Int


class _State:
    """The surfaces on the levels of some grounds.

    Attributes:
        level: of each surface by place, see `place_blocks`.
        used, lost: see there.
        is_new: whether it was not there in the last update.
    """

    def __init__(
        self, sheets: Sheets, step: float, grounds: tuple[float, ...], tolerance: float
    ) -> None:
        self._sheets, self._step = sheets, step
        self._grounds, self._tolerance = np.array(grounds), tolerance
        num = sheets.blocks.num
        self.level, self.is_new = np.empty(0, dtype=np.int32), True
        self.used, self.lost = np.zeros((num, len(grounds)), np.bool_), np.zeros((num, 2))
        self._counts = Rows(num, np.empty((0, 3), dtype=np.int64))
        self._labels = Labels(sheets.blocks, Joining(step, step))
        self._updates, self._labelled = 0, 0  # how often it was updated, and when parts were

    def update(self, kept: Kept, stale: Bool) -> None:
        """Place the surfaces of stale blocks again."""
        sheets, surfaces = self._sheets, self._sheets.surfaces
        self._updates += 1
        self.is_new = self._updates == 1
        self.level, chosen = fit(self.level, len(surfaces.z)), np.flatnonzero(stale)
        asked = sheets.lattice, surfaces, kept, self._grounds, self._tolerance, self.level
        run_in_bands(kernels.place_blocks, len(chosen), *asked, chosen, (self.used, self.lost))
        labels = sheets.labels
        known = sheets.lattice, surfaces, self.level, labels.part, labels.count, chosen
        self._counts.put(chosen, *gather_rows(kernels.count_on_levels, len(chosen), *known))

    def counts(self) -> Int:
        """Rows of sheet, level and number of surfaces."""
        sheets, (rows,) = self._sheets, self._counts.take()
        offset = np.repeat(sheets.labels.offset[:-1], self._counts.counts())
        rows[:, 0] = sheets.of_part[offset + rows[:, 0]]
        return rows

    def parts(self, kept: Kept, stale: Bool | None) -> _Parts:
        """The connected parts of the levels."""
        sheets, surfaces = self._sheets, self._sheets.surfaces
        if self._labelled != self._updates - 1 or self.is_new:
            self._labels, stale = Labels(sheets.blocks, Joining(self._step, self._step)), None
            self._measured = Rows(
                sheets.blocks.num, np.empty(0), np.empty(0, np.bool_), np.empty(0, np.int64)
            )
        self._labelled = self._updates
        stale = sheets.blocks.all() if stale is None else stale
        labels, chosen = self._labels, np.flatnonzero(stale)
        labels.update(surfaces, stale, self.level)
        counts = labels.count[chosen]
        num = int(counts.sum())
        low, has_floor = np.full(num, np.inf), np.zeros(num, dtype=np.bool_)
        of_level, offset = np.zeros(num, dtype=np.int64), np.cumsum(counts) - counts
        asked = sheets.lattice, surfaces, kept, self.level, labels.part, chosen, offset
        measured = low, has_floor, of_level
        run_in_bands(kernels.measure_levels, len(chosen), *asked, measured)
        self._measured.put(chosen, counts, low, has_floor, of_level)
        whole, links = labels.merge()
        found = int(whole.max(initial=-1)) + 1
        low, has_floor = np.full(found, np.inf), np.zeros(found, dtype=np.bool_)
        of_level, parts = np.zeros(found, dtype=np.int64), self._measured.take()
        np.minimum.at(low, whole, parts[0])
        np.logical_or.at(has_floor, whole, parts[1])
        of_level[whole] = parts[2]
        return _Parts(low, has_floor, of_level, links)


class _Stairs:
    """Stairs and ramps, told from the floors that they join.

    A tread, a landing or a piece of a ramp is a part of a stair when by going only up from it one
    gets to a floor more than four times as large, and so by going only down. So a mezzanine is
    none, because its stair only leads down; nor is a cellar, nor the floor of a tower on its way
    up, which is as large as the others. How large a floor is counts everything of its sheet at
    about its height, within half a step, since walls and thresholds divide floors.

    Attributes:
        labels: of plateaus: neighbours at about one height.
        is_stair: which plateaus are parts of stairs.
    """

    def __init__(self, sheets: Sheets, step: float) -> None:
        self._sheets, self._step = sheets, step
        self.labels = Labels(sheets.blocks, Joining(min(step, PLATEAU), step))
        num, ids = sheets.blocks.num, np.empty(0, dtype=np.int32)
        self._plateaus = Rows(num, np.empty(0), ids)
        self._bins, self._seen = Rows(num, np.empty((0, 3), np.int64)), Rows(num, ids)
        self.is_stair = np.empty(0, dtype=np.bool_)

    def update(self, key: Int32, stale: Bool) -> Bool:
        """Find stairs again; returns the blocks where other plateaus are stairs than before."""
        sheets, surfaces, labels = self._sheets, self._sheets.surfaces, self.labels
        labels.update(surfaces, stale, key)
        chosen = np.flatnonzero(stale)
        counts = labels.count[chosen]
        offset = np.concatenate([[0], np.cumsum(counts)])
        low, part = np.zeros(offset[-1]), np.zeros(offset[-1], dtype=np.int32)
        asked = sheets.lattice, surfaces, labels.part, sheets.labels.part, chosen, offset, low, part
        self._bins.put(chosen, *gather_rows(kernels.measure_plateaus, len(chosen), *asked))
        self._plateaus.put(chosen, counts, low, part)
        self.is_stair = self._merge()
        return self._seen.put_all(labels.count, self.is_stair)

    def _merge(self) -> Bool:
        sheets, labels = self._sheets, self.labels
        low_of_part, part = self._plateaus.take()
        sheet = sheets.of_part[sheets.labels.offset[labels.block] + part].astype(np.int64)
        whole, links = labels.merge()
        num = int(whole.max(initial=-1)) + 1
        low = np.full(num, np.inf)
        np.minimum.at(low, whole, low_of_part)
        (rows,) = self._bins.take()
        plateau = np.repeat(labels.offset[:-1], self._bins.counts()) + rows[:, 0]
        half_step = max(self._step, PLATEAU) / 2
        area = _areas_about(sheet[plateau], rows[:, 1], rows[:, 2], half_step)
        floor_area = np.zeros(num, dtype=np.int64)
        np.maximum.at(floor_area, whole[plateau], area)
        a, b = links
        lower, upper = np.where(low[a] < low[b], (a, b), (b, a))
        rises = low[lower] < low[upper]
        lower, upper = lower[rises], upper[rises]
        orders = np.argsort(low[lower], kind="stable"), np.argsort(low[upper], kind="stable")
        above, below = kernels.climb(lower, upper, floor_area, *orders)
        is_stair: Bool = (TIMES_LARGER * floor_area < np.minimum(above, below))[whole]
        return is_stair


def _areas_about(sheet: Int, number: Int, count: Int, half_step: float) -> Int:
    """How many surfaces of a sheet are at about each height, within half a step.

    Args:
        sheet, number, count: rows: the sheet, its height in multiples of PLATEAU, and how many
            surfaces it has there; they may repeat.
    """
    if not len(sheet):
        return np.empty(0, dtype=np.int64)
    near = int(half_step / PLATEAU + SLACK)
    # one sheet after the other on one axis, so far apart that no window reaches the next
    place = sheet * (int(number.max() - number.min()) + 2 * near + 1) + number - number.min()
    places, where = np.unique(place, return_inverse=True)
    total = np.zeros(len(places) + 1, dtype=np.int64)
    np.add.at(total, where.ravel() + 1, count)
    np.cumsum(total, out=total)
    first = np.searchsorted(places, places - near, side="left")
    end = np.searchsorted(places, places + near, side="right")
    area: Int = (total[end] - total[first])[where.ravel()]
    return area


def _common_height(bins: Int, count: Int, low: Float) -> float:
    """The lowest member of the most common height, rounded to plateaus [m]."""
    numbers, where = np.unique(bins, return_inverse=True)
    most = int(np.bincount(where.ravel(), count).argmax())
    return float(low[bins == numbers[most]].min())


def _label(names: list[str | None]) -> list[str]:
    """Name the levels that have no name by their number; no two are called the same."""
    labels: list[str] = []
    for number, name in enumerate(names):
        label = name or f"level {number}"
        while label in labels or (not name and label in names):
            label += "'"
        labels.append(label)
    return labels
