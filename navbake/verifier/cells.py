"""Checks of cells: whether they are free or blocked as the grid says, and what floors they have.

Floors have to be surfaces, and no place to stand, nor a whole floor, may be missing.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import product

import numpy as np

from navbake.config.settings import BakeConfig, FloorSettings
from navbake.navgrid.grid import GridBase
from navbake.types import Bool, Int, Vector3
from navbake.verifier import report
from navbake.verifier.obstacles import ENCLOSING, UNCLEAR, PlacedPiece
from navbake.verifier.probes import AROUND, DISPUTED, FACES_UP, REACH, RIM, TOUCHES, Probes
from navbake.verifier.report import Finding, LevelCounts
from navbake.verifier.sample import AgentSizes, LevelSample, Part, shift_between

MEASURED = 100  # findings of a kind whose depth or gap is measured
OFF = 1e-4  # metres that a floor may be off a surface, and
SHARE = 1e-6  # a share of its distance from the origin, which float32 rounds off
SIDES = ((-1, 0), (1, 0), (0, -1), (0, 1))
STRIDE = 0.15  # distance of the places that are looked at [m]
MOST_PLACES = 20_000  # of one search
# A search calls a sheet a storey where it is clearly as large as a floor, where more than half of
# its outline has walls, and where clearly less than a quarter of it drops, as a top's would. A
# ground may be over a cellar or a pipe, up to the same share
CLEARLY_LARGE = 1.25
WALLED = 0.5
DROPS = 0.2
COVERS = 0.2
MIN_WALL = 1.5  # parapets are lower than walls [m]
REACHED = 3.0  # area of the floors that steps lead to, if it is to count as reached [m²]

Node = tuple[int, int, int]
"""Row and column on the lowest level's lattice, and the number of the surface in its column."""


def rounding(*coordinates: float) -> float:
    """How far a floor may be off a surface at some coordinates [m]."""
    return OFF + SHARE * max(map(abs, coordinates))


class FloorCheck:
    """Checks floors by MuJoCo's rays, and searches for places to stand that no level has.

    All that hangs together by steps with such a place is a fault where steps lead to it, or where
    it is as large as a floor, without drops, and has walls round most of it (a storey) or nothing
    to stand on under it (a ground). Else it may be the top of furniture, a shelf or a roof:
    `num_left` and `area_left` [m²] count these. A floor that no steps lead to is a fault only where
    the settings leave out none, or the grid has no floor at all.

    Cells are given by row and column on the lowest level's lattice, also beside it.
    """

    def __init__(
        self, grid: GridBase, probes: Probes, body: AgentSizes, config: BakeConfig | None
    ) -> None:
        self._body = body
        self._probes = probes
        self._settings = FloorSettings() if config is None else config.floors
        self._lattice = grid.levels[0].lattice
        shifts = [shift_between(self._lattice, level.lattice) for level in grid.levels]
        self._levels = [(v.floor, v.free, by) for v, by in zip(grid.levels, shifts, strict=True)]
        leaves_out = config is None or config.levels != "auto" or config.floors.reach != "all"
        self._are_asked = not leaves_out or all(np.isnan(floor).all() for floor, *_ in self._levels)
        self._stride = max(1, round(STRIDE / self._lattice.cell_size))
        self._edge = self._stride * self._lattice.cell_size
        self._seen = set[Node]()
        self._lost = set[Node]()
        self.num_left = 0
        self.area_left = 0.0
        self._line_at = lru_cache(200_000)(lambda row, col: probes.line(*self._center(row, col)))
        self._standable_at = lru_cache(200_000)(
            lambda row, col: self._line_at(row, col).standable(body.height, body.min_up)
        )

    def run(self, sample: LevelSample, counts: LevelCounts) -> list[Finding]:
        """Check the floors of a level, and look for places to stand that no level has.

        A floor may lie inside of a solid, as under things lower than a step, which block nothing.
        Columns whose floor is off, or beside the centre, aren't searched.
        """
        findings = list[Finding]()
        shift = shift_between(sample.level.lattice, self._lattice)
        unknown: list[tuple[int, int, float]] = []  # places that no level has
        # floors over holes of a scan are no surfaces
        unseen = sample.level.attributes.get("unseen", np.zeros(sample.level.shape))
        for k, has_none in enumerate(np.isnan(sample.floor).tolist()):
            x, y, z = place = sample.place(k)
            line = self._probes.line(x, y)
            off = rounding(x, y, z)
            standable = line.standable(self._body.height, self._body.min_up)
            # at the edge of a crack, floors that slope have any height
            is_gap = all(abs(s.z - z) > self._body.step for s in standable)
            min_up = self._body.min_up if is_gap else np.inf
            counts.floors += not has_none
            has_none |= bool(unseen[sample.rows[k], sample.cols[k]])
            if has_none or line.faces_up(z - off, z + off):
                row = int(sample.rows[k]) + shift[0]
                col = int(sample.cols[k]) + shift[1]
                for s in standable:
                    if not self._is_known(row, col, s.z):
                        unknown.append((row, col, s.z))
                        findings += self._look_from(row, col, (x, y, s.z), sample, k)
            elif self._probes.faces_up_beside(place, off, self._settings.crack, min_up=min_up):
                counts.in_cracks += 1
            else:
                counts.floors_off += 1
                gaps = [abs(s.z - z) for s in line.surfaces if s.up >= FACES_UP]
                nearest = min(gaps, default=None)
                off_by = f"{nearest:.4f} m off the nearest surface" if gaps else "over no surface"
                text = f"has its floor at {z:.4f} m, {off_by}"
                findings.append(sample.finding(report.FLOOR_OFF, k, text, None, nearest))
        for row, col, z in unknown:  # lost itself, or where a search looked beside it
            looked_at = (row, col), (row - row % self._stride, col - col % self._stride)
            counts.lost += any((*cell, self._near(*cell, z)) in self._lost for cell in looked_at)
        return findings

    def _look_from(
        self, row: int, col: int, place: Vector3, sample: LevelSample, k: int
    ) -> list[Finding]:
        """The finding about a place that no level has, seen from a cell of a sample.

        None where it was found before, or is narrower than furniture, unless it is a step from a
        free cell: places are looked at every `STRIDE`.
        """
        step = self._body.step - OFF
        is_step = any(
            is_free
            and abs(floor - place[2]) <= step
            and any(abs(s.z - floor) <= rounding(floor) for s in self._standable_at(r, c))
            for r, c in ((row + dr, col + dc) for dr, dc in SIDES)
            for floor, is_free in self._levels_at(r, c)
        )
        is_step = is_step and self._is_sure(*place)
        if not is_step:
            row = row - row % self._stride
            col = col - col % self._stride
        start = self._near(row, col, place[2])
        if start is None:
            return []
        first = self._standable_at(row, col)[start]
        place = (*self._center(row, col), first.z)
        if not is_step:
            if (row, col, start) in self._seen or self._is_known(row, col, first.z):
                return []
            far = [(row + 2 * self._stride * dr, col + 2 * self._stride * dc) for dr, dc in SIDES]
            if sum(self._near(*there, first.z) is None for there in far) >= 2:
                return []
            if not self._is_sure(*place):
                return []
        own, is_reached, ends = self._search((row, col, start))
        self._seen |= own
        places = {(r, c) for r, c, _ in own}
        reach = int(self._settings.shrink / self._edge) + 1
        span = [n * self._stride for n in range(-reach, reach + 1)]
        # farther from the outline than floors are shrunk by
        around = [*product(span, span)]
        num_inner = sum(all((r + i, c + j) in places for i, j in around) for r, c in places)
        over = {(r, c) for r, c, n in own if any((r, c, below) not in own for below in range(n))}
        area = len(places) * self._edge**2
        walls = ends.count(None)
        # what drops to the sheet itself, as beside its own stairs, makes it no top
        drops = sum(end is not None and end[2] >= 0 and end not in own for end in ends)
        is_floor = num_inner * self._edge**2 >= CLEARLY_LARGE * self._settings.min_area
        is_floor &= self._are_asked and drops <= DROPS * len(ends)
        if is_reached:
            how = "steps lead there"
        elif is_floor and walls > WALLED * len(ends):
            how = "it has walls all round"
        elif is_floor and len(over) <= COVERS * len(places):
            how = "there is nothing to stand on under it"
        else:
            self.num_left = self.num_left + 1
            self.area_left = self.area_left + area
            return []
        self._lost |= own
        geom = self._probes.obstacles.name(first.number)
        text = f"on {geom!r}, {area:.2f} m² or more are on no level, and {how}"
        found = sample.finding(report.PLACE_LOST, k, text, geom, round(area, 6))
        return [replace(found, position=place)]

    def _search(self, start: Node) -> tuple[set[Node], bool, list[Node | None]]:
        """Search breadth first over places a step apart.

        Returns the places that no level has; whether the search reached as much of the grid's
        floors as makes steps that lead there; and how the outline ends at each edge, see `_end_at`.
        """
        own = {start}
        known = set[Node]()
        queue = deque([start])
        ends = list[Node | None]()
        is_reached = False
        while queue and len(own) < MOST_PLACES and not is_reached:
            row, col, number = here = queue.popleft()
            z = self._standable_at(row, col)[number].z
            for dr, dc in SIDES:
                r = row + dr * self._stride
                c = col + dc * self._stride
                # of what lies beside the grid, no floors are known
                beside = self._near(r, c, z) if self._levels_at(r, c) else None
                if beside is None:
                    ends += [self._end_at(row, col, dr, dc, z)] if here in own else []
                    continue
                node = (r, c, beside)
                if node in own or node in known:
                    continue
                if not self._is_known(r, c, self._standable_at(r, c)[beside].z):
                    own.add(node)
                elif here in own and not self._walks(row, col, dr, dc, z):
                    ends.append(self._end_at(row, col, dr, dc, z))
                    continue
                else:
                    known.add(node)
                    is_reached = len(known) * self._edge**2 >= REACHED
                queue.append(node)
        return own, is_reached, ends

    def _walks(self, row: int, col: int, dr: int, dc: int, z: float) -> bool:
        """Whether steps from cell to cell lead over a stride."""
        for n in range(1, self._stride + 1):
            beside = self._near(row + n * dr, col + n * dc, z)
            if beside is None:
                return False
            z = self._standable_at(row + n * dr, col + n * dc)[beside].z
        return True

    def _end_at(self, row: int, col: int, dr: int, dc: int, z: float) -> Node | None:
        """The place that a sheet drops to, of number -1 if there is none; None at a wall."""
        low = z + self._body.step
        high = z + max(self._body.height, MIN_WALL)
        for _ in range(self._stride):
            row = row + dr
            col = col + dc
            if any(begin < low and end > high for begin, end in self._line_at(row, col).solid):
                return None
        return row, col, sum(s.z < z for s in self._standable_at(row, col)) - 1

    def _near(self, row: int, col: int, z: float) -> int | None:
        """The surface of a column that is a step at most from a height; None for none."""
        gaps = [abs(surface.z - z) for surface in self._standable_at(row, col)]
        best = min(gaps, default=np.inf)
        return gaps.index(best) if best <= self._body.step - OFF else None

    def _is_known(self, row: int, col: int, z: float) -> bool:
        """Whether any level has a floor at a height in a column [m]."""
        return any(abs(z - floor) <= rounding(floor) for floor, _ in self._levels_at(row, col))

    def _levels_at(self, row: int, col: int) -> list[tuple[float, bool]]:
        """The floor [m], NaN for none, and whether it is free, of each level that has a cell."""
        found = []
        for floor, free, (down, right) in self._levels:
            r = row + down
            c = col + right
            if 0 <= r < len(floor) and 0 <= c < floor.shape[1]:
                found.append((float(floor[r, c]), bool(free[r, c])))
        return found

    def _center(self, row: int, col: int) -> tuple[float, float]:
        """World x and y of a cell [m]."""
        x_min, y_max, cell_size, *_ = self._lattice
        return x_min + (col + 0.5) * cell_size, y_max - (row + 0.5) * cell_size

    def _is_sure(self, x: float, y: float, z: float) -> bool:
        """Whether a place is there beside its centre, too, and is no rim or touching limit."""
        for a, b in AROUND[1::4]:
            found = self._probes.line(x + RIM * a, y + RIM * b)
            places = found.standable(self._body.height + OFF, self._body.min_up + 1e-5)
            if not any(abs(s.z - z) <= OFF for s in places):
                return False
        return True


class OccupancyCheck:
    """Checks the cells of levels.

    A free cell's volume, made smaller by the tolerance on all sides, must touch nothing. A blocked
    cell's, made larger by it, must touch something, or lie inside of something. `reach` is that of
    the inflation that closed cells [m], 0 for none. `num_groundless` counts blocked cells without a
    place to stand at their level's ground, of levels that state no floors.
    """

    def __init__(
        self, probes: Probes, body: AgentSizes, tolerance: float, reach: float = 0.0
    ) -> None:
        self._probes = probes
        self._body = body
        self._obstacles = probes.obstacles
        self._tolerance = tolerance
        self._reach = reach
        self._found: Counter[str] = Counter()
        self.num_groundless = 0

    def check_free(
        self, sample: LevelSample, counts: LevelCounts, volume: list[Part]
    ) -> list[Finding]:
        """Check free cells by a volume."""
        asked = sample.free & ~np.isnan(sample.floor)
        touching, part, disputed = self._touch(sample, asked, volume, -self._tolerance)
        within = self._inside(sample, asked & (touching < 0), volume[0])
        by = np.where(within >= 0, within, touching)
        text = "is free, though it has no floor"
        bare = np.flatnonzero(sample.free & ~asked).tolist()
        findings = [sample.finding(report.NO_FLOOR, cell, text) for cell in bare]
        is_apart = asked & (by < 0)
        step = self._body.step + self._tolerance
        text = f"is free, but no floor is within {self._body.step:g} m of its level's ground"
        for cell in np.flatnonzero(is_apart & (not sample.states_floors)).tolist():
            # a floor is a surface that faces up, also beside a crack or a rim
            x, y, z = at = sample.place(cell)
            on_floor = self._probes.line(x, y).faces_up(z - step, z + step)
            if not on_floor and not self._probes.faces_up_beside(at, step):
                is_apart[cell] = False
                findings.append(sample.finding(report.NO_FLOOR, cell, text))
        counts.disputed += int((is_apart & disputed).sum())
        counts.free_touches += int((by >= 0).sum())
        counts.free_free += int((is_apart & ~disputed).sum())
        for cell in np.flatnonzero(by >= 0).tolist():
            number = int(by[cell])
            depth = None
            name = self._obstacles.name(number)
            text = f"is free, but {name!r} reaches into it"
            if within[cell] >= 0:
                text = f"is free, but lies inside of {name!r}"
            elif self._is_measured(report.FREE_TOUCHES):
                place = volume[int(part[cell])].put_over(sample, cell)
                depth = self._probes.depth(*place, number)
                text = f"is free, but {name!r} reaches {depth:.4f} m into it"
            findings.append(sample.finding(report.FREE_TOUCHES, cell, text, name, depth))
        return findings

    def check_blocked(
        self, sample: LevelSample, counts: LevelCounts, volume: list[Part], excused: Bool
    ) -> list[Finding]:
        """Check blocked cells by the baked volume, but those that an inflation closed rightly."""
        asked = ~sample.free & ~np.isnan(sample.floor) & ~excused
        touching, _, disputed = self._touch(sample, asked, volume, self._tolerance)
        apart = asked & (touching < 0) & ~disputed
        apart &= self._inside(sample, apart, volume[0]) < 0
        for cell in np.flatnonzero(apart & (not sample.states_floors)).tolist():
            # where the scene has no place to stand within a step of the ground, it may be blocked
            line = self._probes.line(*sample.xy[cell])
            body = self._body
            z = sample.floor[cell]
            places = line.standable(body.height, body.min_up)
            apart[cell] = any(abs(s.z - z) <= body.step for s in places)
            self.num_groundless += not apart[cell]
        unclear = np.zeros_like(apart)
        for _, cell, leaves, enters in self._crossings(sample, apart, volume[0], (UNCLEAR,)):
            unclear[cell] |= (leaves + enters) % 2 == 1
        apart &= ~unclear
        num_unclear = int(unclear.sum())
        num_apart = int(apart.sum())
        counts.disputed += num_unclear
        counts.blocked_apart += num_apart
        counts.blocked_blocked += int((~sample.free).sum()) - num_unclear - num_apart
        findings = []
        for cell in np.flatnonzero(apart).tolist():
            name = None
            gap = None
            text = "is blocked, but touches nothing"
            if self._reach > 0 and not sample.occupied[cell]:
                text = f"is blocked for {self._reach:g} m, but nothing within that radius is "
                text += "in the way"
            elif self._is_measured(report.BLOCKED_APART):
                columns = [part.put_over(sample, cell) for part in volume]
                nearest = [found for put in columns if (found := self._probes.nearest(*put))]
                text = f"is blocked, but nothing is within {REACH:g} m"
                if nearest:
                    gap, number = min(nearest)
                    name = self._obstacles.name(number)
                    text = "is blocked, but nothing touches the volume over it: the nearest geom, "
                    text += f"{name!r}, is {gap:.4f} m off"
            findings.append(sample.finding(report.BLOCKED_APART, cell, text, name, gap))
        return findings

    def _is_measured(self, kind: str) -> bool:
        self._found[kind] += 1
        return self._found[kind] <= MEASURED

    def _touch(
        self, sample: LevelSample, asked: Bool, volume: list[Part], margin: float
    ) -> tuple[Int, Int, Bool]:
        """What touches the volumes over cells, grown by a margin [m].

        Returns the obstacle, -1 for none, the part of the volume, and where libraries disagree.
        """
        by = np.full(len(asked), -1)
        which = np.zeros(len(asked), np.int64)
        disputed = np.zeros_like(asked)
        for k, part in enumerate(volume):
            asked_here = asked & (part.high > part.low)
            for number, item in enumerate(self._obstacles.items):
                cells = _near(sample, asked_here & (by < 0), item, part, 2 * abs(margin))
                for cell in cells.tolist():
                    answer = self._probes.touches(number, *part.put_over(sample, cell), margin)
                    disputed[cell] |= answer == DISPUTED
                    if answer == TOUCHES:
                        by[cell] = number
                        which[cell] = k
        return by, which, disputed

    def _inside(self, sample: LevelSample, asked: Bool, part: Part) -> Int:
        """The enclosing obstacle that the middle of a cell's volume lies in, -1 for none."""
        found = np.full(len(asked), -1)
        depth = np.zeros(len(asked), dtype=np.int64)
        for number, cell, leaves, enters in self._crossings(sample, asked, part, ENCLOSING):
            depth[cell] += leaves - enters  # less than 0 in a cavity
            if leaves > enters:
                found[cell] = number
        found[depth <= 0] = -1
        return found

    def _crossings(
        self, sample: LevelSample, asked: Bool, part: Part, kinds: Collection[str]
    ) -> Iterator[tuple[int, int, int, int]]:
        """Obstacles of some kinds and cells in their boxes: how often the way up leaves, enters."""
        middle = (part.low + part.high) / 2
        point = Part(0.0, False, middle, middle)
        for number, item in enumerate(self._obstacles.items):
            for cell in _near(sample, asked, item, point).tolist() if item.kind in kinds else ():
                x, y = sample.xy[cell].tolist()
                yield number, cell, *self._probes.crossings(number, (x, y, float(middle[cell])))


def _near(
    sample: LevelSample, asked: Bool, item: PlacedPiece, part: Part, beyond: float = 0.0
) -> Int:
    """The asked cells over which a part, larger by `beyond` [m], meets an obstacle's box."""
    lattice = sample.level.lattice
    reach = part.half + beyond
    # rows ascend in a sample; those that may meet it
    ends = lattice.y_max - np.array([item.high[1] + reach, item.low[1] - reach])
    first, last = np.clip(ends / lattice.cell_size, 0, lattice.height).astype(np.int64)
    own = slice(*np.searchsorted(sample.rows, [first - 1, last + 1]))
    x, y = sample.xy[own].T
    low = part.low[own] - beyond
    high = part.high[own] + beyond
    kept = asked[own] & (low < item.high[2]) & (high > item.low[2])
    kept &= (x + reach > item.low[0]) & (x - reach < item.high[0])
    kept &= (y + reach > item.low[1]) & (y - reach < item.high[1])
    return np.asarray(own.start + np.flatnonzero(kept))
