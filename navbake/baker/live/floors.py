"""Floors in a scene in which furniture moves: only the cells near it are decided again.

What is a floor depends on the whole scene: on the sizes of sheets, on their outlines, on what lies
over what. But most of what moves only takes cells from one large floor and gives others back, and
that changes nothing else as long as the floor stays the one that it is. `LiveFloors` notes what
that rests on. A change that might touch any of it is `NotLocal`: then all floors are found again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.floors.levels import LARGE_ROOF, Floors, Judged
from navbake.baker.floors.outline import find_edges
from navbake.baker.floors.sheets import AreaTest, agent_limits
from navbake.baker.floors.stairs import PLATEAU
from navbake.baker.kernels.constants import CLOSED_SURFACE
from navbake.baker.live.columns import LiveColumns, Region
from navbake.baker.live.kernels.grow import compare_floors, find_standing, list_heights, regrow
from navbake.baker.live.kernels.regions import are_in, grow_cells, join_cells, label_cells
from navbake.baker.live.kernels.sheets import (
    explore,
    group_parts,
    hold_region,
    label_region,
    mark_region,
)
from navbake.baker.live.not_local import NotLocal
from navbake.baker.scene.shapes import Planes, Shapes
from navbake.config.settings import BakeConfig
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int, Int32

# What a sheet is: none that counts, the floor that things move on, or another large one
SMALL, MAIN, OTHER = 0, 1, 2
# How far around changed cells floors are let go on again, in cells, as long as that is too near
REACHES = (3, 8, 20, 50)
# How many surfaces a search for a way round visits, as long as it finds none
VISITS = (2_000, 20_000, 200_000, 2_000_000)
# So many cells are worth a call on another thread
LEAST_CELLS = 4096


class FloorChanges(NamedTuple):
    """The cells whose floor has changed, ascending.

    Attributes:
        heights: those whose floor has another height, or has one where there was none, or none.
        standable: those where the floor became standable, or is no longer.
    """

    heights: Int
    standable: Int


class Budget(NamedTuple):
    """How far the floor is from being judged otherwise, or from having another ground.

    Attributes:
        lowest: the lowest of all floors [m].
        bucket: the ground's height in multiples of PLATEAU.
        bucket_low: the lowest floor of about that height [m].
        left: so many cells may change before the floor has to be measured again.
    """

    lowest: float
    bucket: int
    bucket_low: float
    left: int


class Grown(NamedTuple):
    """How floors go on in a region, by its cells.

    Attributes:
        value: the floor, NaN for none [m].
        stands: whether one can stand there.
        ring: see `regrow`.
        has_height, has_shifted, moved: where `value`, `stands`, and `value` or `ring` is another.
    """

    value: Float
    stands: Bool
    ring: Int32
    has_height: Bool
    has_shifted: Bool
    moved: Bool


class LiveFloors:
    """The one level of a scene and the sheets around its floor, kept up to date.

    Attributes:
        level: the level; its arrays are written to.
    """

    def __init__(
        self,
        config: BakeConfig,
        floors: Floors,
        judged: Judged,
        columns: Columns,
        live: LiveColumns,
        shapes: Shapes,
    ) -> None:
        """Note what the floors rest on; NotLocal where they are of another kind.

        Args:
            judged: what was decided on the way to the floors.
            columns: what they were found in.
            live: the same; gets the sheet of each surface.
            shapes: the geometry without doors.
        """
        _check_kind(config, floors, judged, columns)
        if judged.holds_floor:
            raise NotLocal("a closed mesh holds a floor")
        planes = shapes.planes
        self._live, self.level = live, floors.levels[0]
        self._limits = agent_limits(config.agent)
        self._test = AreaTest(live.lattice, config.floors)
        self._needed = int(np.ceil(max(self._test.needed, 0.0)))
        self._reach = int(np.ceil(config.floors.shrink / live.lattice.cell_size)) + 1
        self._main = int(np.argmax(judged.counted.sheet_size))
        self._mark = np.zeros(0, dtype=np.int32)
        self._joined: list[Int] = []  # the cells where surfaces joined or left the floor
        # small sheets, and the cells and places of what they got
        self._grown: list[tuple[int, Int, Int]] = []
        self._note_sheets(judged)
        self._check_outline(judged)
        self._budget = self._find_budget()
        self._rings = self._find_rings(columns, judged, planes)

    # ------------------------------------------------------------------ what floors rest on

    def _note_sheets(self, judged: Judged) -> None:
        every, size = judged.every, judged.every.sheet_size
        num = len(size)
        kind = np.where(judged.large.sheet_size > 0, OTHER, SMALL).astype(np.uint8)
        kind[self._main] = MAIN
        room = num + 1024
        self._kind, self._size = np.zeros(room, dtype=np.uint8), np.zeros(room, dtype=np.int64)
        self._kind[:num], self._size[:num], self._num = kind, size, num
        # of a small sheet at most so many cells are left when it is shrunk
        self._inner = self._size.copy()
        for sheet, members in every.members(np.flatnonzero((size >= self._needed) & (kind == 0))):
            self._inner[sheet] = np.count_nonzero(self._test.inner(every.cell[members]))
        is_other = every.cell[kind[every.sheet] == OTHER]
        self._other_floor = judged.counted.cell[judged.counted.sheet != self._main]
        self._other_sizes = size[kind == OTHER]
        cells = len(self._live.pool.first)
        self._is_other = np.zeros(cells, dtype=np.bool_)
        self._is_other[is_other] = True
        # rules about these look so far around them, and a cell or two beyond
        self._near_other = np.zeros(cells, dtype=np.bool_)
        self._near_other[self._around(np.unique(is_other), 2 * self._reach + 4)] = True

    def _check_outline(self, judged: Judged) -> None:
        """The floor lies over nothing that one can stand on, and drops to no other floor.

        So it is no top, no shelf and no roof, whatever stands on it and beside it.
        """
        every = judged.every
        is_main = np.arange(len(every.sheet_size)) == self._main
        edges = find_edges(judged.large, is_main, self._limits.step, self._reach)
        if not np.isnan(edges.floors).all():
            raise NotLocal("the floor drops to another one")
        above = np.flatnonzero(every.sheet == self._main)
        above = above[above > 0]
        if (every.cell[above - 1] == every.cell[above]).any():
            raise NotLocal("the floor lies over another surface to stand on")

    def _find_budget(self) -> Budget:
        """Measure the floor, see `Budget`.

        The ground is the most common height, to 2 cm, of what is left of the lowest floors when
        they are shrunk, see `find_grounds`; and the lowest floor of that height.
        """
        standable, floor = self.level.standable.ravel(), self.level.floor.ravel()
        main = standable.copy()
        main[self._other_floor] = False
        cells, every = np.flatnonzero(main), np.flatnonzero(standable)
        if len(cells) <= self._other_sizes.max(initial=0):
            raise NotLocal("another floor is as large")
        left = [np.count_nonzero(self._test.inner(cells)) - self._needed]
        z = floor[every]
        lowest, half_step = float(z.min()), max(self._limits.step, PLATEAU) / 2
        is_low = ((z - lowest) / half_step).astype(np.int64) <= 1
        every, z = every[is_low], z[is_low]
        inner = self._test.inner(every)
        left.append(np.count_nonzero(inner) - self._needed)
        if min(left) <= 0:
            raise NotLocal("hardly any floor is left when it is shrunk")
        number: Int = np.round(z / PLATEAU).astype(np.int64)
        first = int(number.min())
        counts = np.bincount(number[inner] - first)
        bucket = int(counts.argmax())
        in_bucket = number == bucket + first
        bucket_low = float(z[inner & in_bucket].min())
        if z[in_bucket].min() < bucket_low:
            raise NotLocal("the lowest floor of the ground's height is only at its edge")
        left.append(counts[bucket] - np.delete(counts, bucket).max(initial=0))
        left += [np.count_nonzero(inner & (z == bucket_low)), np.count_nonzero(z == lowest)]
        for size in self._other_sizes:  # larger or smaller sheets are judged by the floor's size
            left += [abs(len(cells) - size), abs(len(cells) - size / LARGE_ROOF)]
        return Budget(lowest, bucket + first, bucket_low, int(min(left)) - 1)

    def _find_rings(self, columns: Columns, judged: Judged, planes: Planes) -> Int32:
        """The ring in which each cell got its floor, 0 where one can stand; see `regrow`."""
        cells = np.arange(len(columns.start) - 1)
        region = Region(cells, columns.crossings, np.arange(len(columns.z)))
        floor_like, stands = self._marks(region, planes)
        self._live.pool.sheet[np.flatnonzero(stands)] = judged.every.sheet
        standable, floor = self.level.standable.ravel(), self.level.floor.ravel()
        taken = np.zeros(len(columns.z), dtype=np.bool_)
        taken[np.flatnonzero(floor_like)] = judged.candidate
        taken &= ~standable[np.repeat(cells, np.diff(columns.start))]
        value = np.where(standable, floor, np.nan)
        rings = np.where(standable, 0, -1).astype(np.int32)
        self._regrow(region, taken, value, rings, rings)
        if not np.array_equal(value, floor, equal_nan=True):
            raise NotLocal("floors go on under things by other rules")
        return rings

    # ------------------------------------------------------------------ updates

    def follow(self, changed: Region, touched: Int, planes: Planes) -> FloorChanges:
        """Bring columns, sheets and floors up to date.

        Args:
            changed: the cells whose columns are others now, with these, as `LiveColumns.cast`
                gives them; they are put into the columns.
            touched: all cells near what moved.
            planes: the endless planes of the scene.

        Raises:
            NotLocal: more than the floor near these cells may change. What was known of columns
                and floors is lost.
        """
        if self._near_other[touched].any() or self._near_other[changed.cells].any():
            raise NotLocal("another floor, a top or a roof is near")
        if (changed.columns.closed == CLOSED_SURFACE).any():
            self._check_enclosed(changed, planes)
        old = self._live.pool.sheet[self._live.gather(changed.cells).place]
        np.subtract.at(self._size, old[old >= 0], 1)
        self._live.put(changed, np.full(len(changed.columns.z), -1, dtype=np.int32))
        nothing = np.empty(0, dtype=np.int64)
        if not len(changed.cells):
            return FloorChanges(nothing, nothing)
        self._joined, self._grown = [changed.cells], []
        self._label(changed.cells, planes)
        cells = np.unique(np.concatenate(self._joined))
        self._check_columns(cells)
        changes = self._grow(cells, planes)
        if len(changes.standable):
            self._spend(changes.standable)
        return changes

    def _check_enclosed(self, changed: Region, planes: Planes) -> None:
        """No closed mesh holds anything that one could stand on, see `find_enclosed`."""
        holder = np.empty(len(changed.columns.z), dtype=np.int32)
        crossings = changed.by_id(self._live.scratch)
        hold_region(self._live.lattice, changed.cells, crossings, planes, self._limits, holder)
        if (holder >= 0).any():
            raise NotLocal("a closed mesh may hold a floor")

    def _spend(self, changed: Int) -> None:
        """Measure the floor again where enough has changed that it may be judged otherwise."""
        around = len(self._around(changed, self._reach))
        self._budget = self._budget._replace(left=self._budget.left - 2 * around)
        if self._budget.left < 0:
            was, self._budget = self._budget, self._find_budget()
            if was[:3] != self._budget[:3]:
                raise NotLocal("the ground has another height")

    def _around(self, cells: Int, by: int) -> Int:
        lattice = self._live.lattice
        return np.asarray(
            grow_cells(lattice.width, lattice.height, cells, by, self._live.scratch.flag)
        )

    def _marks(self, region: Region, planes: Planes) -> tuple[Bool, Bool]:
        """Which surfaces of a region are floor-like, and which standable."""
        num, scratch = len(region.columns.z), self._live.scratch
        marks = np.zeros(num, dtype=np.bool_), np.zeros(num, dtype=np.bool_)
        known = region.cells, region.by_id(scratch), planes, self._limits
        work = mark_region, len(region.cells), self._live.lattice
        run_in_bands(*work, *known, marks, scratch.count, least=LEAST_CELLS)
        return marks

    # ------------------------------------------------------------------ sheets

    def _label(self, changed: Int, planes: Planes) -> None:
        """Find the sheets of the surfaces in changed cells."""
        live, pool = self._live, self._live.pool
        cells = self._around(changed, 2)
        region = live.gather(cells)
        _, standable = self._marks(region, planes)
        start, z = region.columns.start, region.columns.z
        asked = live.lattice, cells, start, z, standable, self._limits.step
        part, num = label_region(*asked, live.scratch.local)
        number = np.repeat(np.arange(len(cells)), np.diff(start))
        cell_of = cells[number]
        node, bounds = group_parts(part, num)
        sheet = pool.sheet[region.place[node]]
        is_new, is_main = sheet < 0, sheet == self._main
        has_new, has_main, has_other = (
            np.bincount(part[node], marks, num) > 0
            for marks in (is_new, is_main, ~is_new & ~is_main)
        )
        # most joins the floor alone, all at once
        joins = is_new & (has_main & ~has_other)[part[node]]
        pool.sheet[region.place[node[joins]]] = self._main
        self._size[self._main] += np.count_nonzero(joins)
        for k in np.flatnonzero(has_new & (has_other | ~has_main)).tolist():
            members = node[bounds[k] : bounds[k + 1]]
            self._join(cell_of[members], region.place[members])
        self._check_grown()
        sheet = pool.sheet[region.place[node]]
        own = node[sheet == self._main]
        cluster = label_cells(live.lattice, cells, live.scratch.local)
        cluster, part = cluster[number[own]], part[own]
        any_part = np.zeros(len(cells), dtype=np.int64)
        any_part[cluster] = part
        is_torn = np.zeros(len(cells), dtype=np.bool_)
        is_torn[cluster[part != any_part[cluster]]] = True
        own, cluster, part = (array[is_torn[cluster]] for array in (own, cluster, part))
        for torn in np.flatnonzero(is_torn).tolist():
            here = cluster == torn
            parts = [own[here & (part == k)] for k in np.unique(part[here])]
            self._check_whole([(cell_of[one], region.place[one]) for one in parts])

    def _join(self, cells: Int, places: Int) -> None:
        """Give the new surfaces of a part the sheet of the others, or one of their own."""
        pool = self._live.pool
        sheet = pool.sheet[places]
        is_new = sheet < 0
        known, num_new = np.unique(sheet[~is_new]), int(np.count_nonzero(is_new))
        if (self._kind[known] == OTHER).any():
            raise NotLocal("another floor, a top or a roof grows")
        if not len(known):
            if len(cells) >= self._needed and self._test.passes(cells):
                raise NotLocal("a new surface is as large as a floor")
            pool.sheet[places] = self._new_sheet(cells)
            return
        to = self._main if self._main in known else int(known[np.argmax(self._size[known])])
        if to != self._main:
            self._inner[to] = self._inner[known].sum()
            self._grown.append((to, cells[is_new], places[is_new]))
        pool.sheet[places[is_new]] = to
        self._size[to] += num_new
        for gone in known[known != to].tolist():
            own = sheet == gone
            self._unite(gone, to, cells[own], places[own])

    def _new_sheet(self, cells: Int) -> int:
        """A sheet of its own, too small for a floor; its cells are given."""
        if self._num == len(self._kind):
            more = np.zeros(self._num, dtype=np.int64)
            self._kind = np.concatenate([self._kind, more.astype(np.uint8)])
            self._size = np.concatenate([self._size, more])
            self._inner = np.concatenate([self._inner, more])
        number, self._num = self._num, self._num + 1
        self._kind[number], self._size[number] = SMALL, len(cells)
        self._inner[number] = np.count_nonzero(self._test.inner(cells))
        return number

    def _check_grown(self) -> None:
        """Make sure that small sheets that have grown, or become one, are too small for a floor.

        What is left of one when it is shrunk is at most what was left of its parts, and what is
        left near the new surfaces, if all small sheets there were one.
        """
        for to, cells, places in self._grown:
            size = int(self._size[to])
            if size < self._needed:
                self._inner[to] = min(int(self._inner[to]), size)
                continue
            region = self._live.gather(self._around(cells, 2 * self._reach))
            sheet = self._live.pool.sheet[region.place]
            column = np.repeat(region.cells, np.diff(region.columns.start))
            small = np.unique(column[(sheet >= 0) & (self._kind[sheet] == SMALL)])
            left = small[self._test.inner(small)]
            near = are_in(left, self._around(cells, self._reach))
            self._inner[to] += np.count_nonzero(near)
            if self._inner[to] >= self._needed:
                self._measure_sheet(to, cells, places)

    def _measure_sheet(self, sheet: int, cells: Int, places: Int) -> None:
        """Make sure that what hangs together with some surfaces of a sheet is too small."""
        met, cells, places = self._explore(cells, places, sheet, [], VISITS[1])
        if met < 0 or self._test.passes(cells):
            raise NotLocal("surfaces together may be as large as a floor")
        number = self._new_sheet(cells)
        self._size[number] = 0  # and so many as move there
        self._move(sheet, number, cells, places)

    def _unite(self, gone: int, to: int, cells: Int, places: Int) -> None:
        """Give all surfaces of a sheet that hang together with some of them to another one."""
        met, cells, places = self._explore(cells, places, gone, [], VISITS[-1])
        if met < 0:
            raise NotLocal("too much hangs together with what changes")
        self._move(gone, to, cells, places)

    def _move(self, gone: int, to: int, cells: Int, places: Int) -> None:
        self._live.pool.sheet[places] = to
        self._size[gone] -= len(places)
        self._size[to] += len(places)
        if self._main in (gone, to):
            if self._near_other[cells].any():
                raise NotLocal("another floor, a top or a roof is near what joins the floor")
            self._joined.append(cells)

    def _explore(
        self, cells: Int, places: Int, sheet: int, others: list[tuple[Int, Int]], most: int
    ) -> tuple[int, Int, Int]:
        """See `explore`: the number of the other part that is met, from 1; 0 for none."""
        live = self._live
        if len(self._mark) < len(live.pool.z):
            self._mark = np.zeros(len(live.pool.z), dtype=np.int32)
        mark = self._mark
        for number, (_, other) in enumerate(others):
            mark[other] = number + 2
        mark[places] = 1
        asked = live.lattice, live.pool, self._limits.step, cells, places, sheet
        met, found, visited = explore(*asked, mark, most)
        mark[visited] = 0
        for _, other in others:
            mark[other] = 0
        return max(met - 1, min(met, 0)), found, visited

    def _check_whole(self, parts: list[tuple[Int, Int]]) -> None:
        """Make sure that the floor hangs together; what was cut off becomes a sheet of its own.

        From each part near changed cells one goes on until another part is met.

        Args:
            parts: the cells and places of their surfaces.
        """
        for most in VISITS:
            waiting = sorted(parts, key=lambda part: len(part[0]))
            still_open: list[tuple[Int, Int]] = []
            while waiting:
                own, others = waiting[0], [*waiting[1:], *still_open]
                waiting = waiting[1:]
                if not others:
                    return
                met, cells, places = self._explore(*own, self._main, others, most)
                if met < 0:
                    still_open.append(own)
                elif met == 0:
                    self._cut_off(cells, places)
                else:
                    (one, at), (other, there) = own, others[met - 1]
                    others[met - 1] = np.concatenate([one, other]), np.concatenate([at, there])
                    waiting, still_open = others[: len(waiting)], others[len(waiting) :]
            parts = still_open
            if len(parts) <= 1:
                return
        raise NotLocal("the floor falls apart")

    def _cut_off(self, cells: Int, places: Int) -> None:
        if len(cells) >= self._needed and self._test.passes(cells):
            raise NotLocal("a part of the floor is cut off")
        number = self._new_sheet(cells)
        self._size[number] = 0  # and so many as move there
        self._move(self._main, number, cells, places)

    def _check_columns(self, cells: Int) -> None:
        """The floor lies over nothing to stand on, and is as low as it was."""
        region = self._live.gather(cells)
        sheet = self._live.pool.sheet[region.place]
        column = np.repeat(np.arange(len(cells)), np.diff(region.columns.start))
        stands = np.flatnonzero(sheet >= 0)
        above = stands[1:][column[stands][1:] == column[stands][:-1]]
        if (sheet[above] == self._main).any():
            raise NotLocal("the floor lies over another surface to stand on")
        new, budget = region.columns.z[sheet == self._main], self._budget
        number: Int = np.round(new / PLATEAU).astype(np.int64)
        if (new < budget.lowest).any():
            raise NotLocal("a floor is lower than all others")
        if ((number == budget.bucket) & (new < budget.bucket_low)).any():
            raise NotLocal("a floor is a little lower than the ground")

    # ------------------------------------------------------------------ floors

    def _grow(self, changed: Int, planes: Planes) -> FloorChanges:
        """Let the floor go on under things again, around cells that may have lost or got it.

        Where it comes out as it was at the edge of a region, nothing beyond it changes; the other
        regions are made larger.
        """
        found = FloorChanges(changed[:0], changed[:0])
        for reach in REACHES:
            cells = self._around(changed, reach)
            if self._is_other[cells].any():
                raise NotLocal("another floor, a top or a roof is near")
            region = self._live.gather(cells)
            new = self._grow_region(region, planes)
            inner = are_in(cells, self._around(changed, reach - 1))
            cluster = label_cells(self._live.lattice, cells, self._live.scratch.local)
            is_open = np.bincount(cluster, new.moved & ~inner) > 0
            done = ~is_open[cluster]
            here = cells[done]
            # a cell may have changed twice, and so to what it was
            marks = new.has_height & done, new.has_shifted & done
            joined = (join_cells(was, cells[m]) for was, m in zip(found, marks, strict=True))
            found = FloorChanges(*joined)
            floor, stands = self.level.floor.reshape(-1), self.level.standable.reshape(-1)
            floor[here], stands[here] = new.value[done], new.stands[done]
            self._rings[here] = new.ring[done]
            changed = changed[is_open[cluster[np.searchsorted(cells, changed)]]]
            if not len(changed):
                return found
        raise NotLocal("the floor under things changes far around")

    def _grow_region(self, region: Region, planes: Planes) -> Grown:
        """Let the floor go on again in a region."""
        cells, taken = region.cells, self._marks(region, planes)[0]
        value, ring = np.empty(len(cells)), np.empty(len(cells), dtype=np.int32)
        sheets = region.place, self._live.pool.sheet, self._main
        find_standing(region.columns.start, region.columns.z, *sheets, taken, value, ring)
        self._regrow(region, taken, value, ring, self._rings)
        grown = Grown(value, ring == 0, ring, *np.empty((3, len(cells)), dtype=np.bool_))
        was = self.level.floor.reshape(-1), self.level.standable.reshape(-1), self._rings
        compare_floors(cells, value, ring, *was, *grown[3:])
        return grown

    def _regrow(self, region: Region, taken: Bool, value: Float, ring: Int32, rings: Int32) -> None:
        start, height = list_heights(region.columns.start, region.columns.z, taken)
        asked = self._live.lattice, region.cells, start, height, self._limits.step
        floor = self.level.floor.reshape(-1)
        regrow(*asked, value, ring, floor, rings, self._live.scratch.local)


def _check_kind(config: BakeConfig, floors: Floors, judged: Judged, columns: Columns) -> None:
    """NotLocal where floors depend on more than `LiveFloors` knows of."""
    step, size = config.agent.traversable_floor_height, columns.lattice.cell_size
    reasons = {
        "`levels` are given": config.levels != "auto",
        "`floors.from` is given": bool(config.floors.starts),
        "`floors.reach` is steps": config.floors.reach != "all",
        "there are several levels": len(floors.levels) > 1,
        "ramps may rise by more than a step a cell": (
            size * np.tan(np.radians(config.agent.max_slope)) > step
        ),
        "floors lie over each other": bool((np.diff(judged.counted.start) > 1).any()),
    }
    for reason, holds in reasons.items():
        if holds:
            raise NotLocal(reason)
