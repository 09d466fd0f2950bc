"""Whether each floor is a surface, and whether a place to stand, or a whole floor, is missing."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from navbake.navgrid.grid_base import GridBase
from navbake.types import Vector3
from navbake.verifier.lines import AROUND, CRACK, FACES_UP, RIM, Line, Lines, Surface
from navbake.verifier.report import FLOOR_OFF, Finding, LevelCounts
from navbake.verifier.sample import Agent, LevelSample

OFF = 1e-4  # metres that a floor may be off a surface, and
SHARE = 1e-6  # a share of its distance from the origin, which float32 rounds off
SIDES = ((-1, 0), (1, 0), (0, -1), (0, 1))


class Unknown(NamedTuple):
    """A place to stand that no level has."""

    cell: tuple[int, int]  # on the lowest level's lattice
    place: Vector3
    is_step: bool  # whether a step joins it to the floor of a free cell


def rounding(*coordinates: float) -> float:
    """How far a floor may be off a surface at some coordinates [m]."""
    return OFF + SHARE * max(map(abs, coordinates))


class FloorCheck:
    """Checks floors by MuJoCo's rays, and finds places that no level has.

    Cells are given by row and column on the lowest level's lattice, also beside it.
    """

    def __init__(self, grid: GridBase, lines: Lines, agent: Agent, crack: float = CRACK) -> None:
        self.agent, self._lines, self._crack = agent, lines, crack
        self._floors = [(level.floor, level.free) for level in grid.levels]
        self._lattices = [level.lattice for level in grid.levels]

        @lru_cache(maxsize=200_000)
        def line_at(row: int, col: int) -> Line:
            """What the vertical line through a cell's centre meets."""
            return lines.at(*self.center(row, col))

        @lru_cache(maxsize=200_000)
        def standable_at(row: int, col: int) -> list[Surface]:
            """The surfaces in a column that an agent can stand on, lowest first."""
            return line_at(row, col).standable(agent.height, agent.min_up)

        self.line_at, self.standable_at = line_at, standable_at

    def run(
        self, sample: LevelSample, counts: LevelCounts
    ) -> tuple[list[Finding], list[tuple[int, Unknown]]]:
        """Check the floors of a level, and find the places to stand that no level has, by cell.

        A floor may lie inside of a solid: floors go on under things, of which those that are lower
        than a step block nothing. Where an agent can stand on one of these, that place is lost.
        Columns whose floor is off, or beside the centre, are not asked for more.
        """
        findings, unknown = list[Finding](), list[tuple[int, Unknown]]()
        for k, has_none in enumerate(np.isnan(sample.floor).tolist()):
            x, y, z = place = sample.place(k)
            line, off = self._lines.at(x, y), rounding(x, y, z)
            standable = line.standable(self.agent.height, self.agent.min_up)
            # at the edge of a crack, floors that slope have any height
            is_gap = all(abs(s.z - z) > self.agent.step for s in standable)
            min_up = self.agent.min_up if is_gap else np.inf
            counts.floors += not has_none
            if has_none or line.faces_up(z - off, z + off):
                cell = self._shifted(sample.number, 0, *sample.cell(k))
                for s in standable:
                    if not self.is_known(*cell, s.z):
                        is_step = self._is_a_step_from_free(*cell, s.z) and self.is_sure(x, y, s.z)
                        unknown.append((k, Unknown(cell, (x, y, s.z), is_step)))
            elif self._lines.faces_up_beside(place, off, self._crack, min_up=min_up):
                counts.in_cracks += 1
            else:
                counts.floors_off += 1
                nearest = min(
                    (abs(s.z - z) for s in line.surfaces if s.up >= FACES_UP), default=None
                )
                off_by = "over no surface"
                if nearest is not None:
                    off_by = f"{nearest:.4f} m off the nearest surface"
                text = f"has its floor at {z:.4f} m, {off_by}"
                findings.append(sample.finding(FLOOR_OFF, k, text, None, nearest))
        return findings, unknown

    def name(self, number: int) -> str:
        """The name of the geom that an obstacle belongs to."""
        return self._lines.obstacles.name(number)

    def is_known(self, row: int, col: int, z: float) -> bool:
        """Whether any level has a floor at a height in a column [m]."""
        return any(abs(z - floor) <= rounding(floor) for floor, _ in self._levels_at(row, col))

    def _levels_at(self, row: int, col: int) -> list[tuple[float, bool]]:
        """The floor [m], NaN for none, and whether it is free, of each level that has a cell."""
        found = []
        for number, (floor, free) in enumerate(self._floors):
            r, c = self._shifted(0, number, row, col)
            if 0 <= r < len(floor) and 0 <= c < floor.shape[1]:
                found.append((float(floor[r, c]), bool(free[r, c])))
        return found

    def _shifted(self, number: int, other: int, row: int, col: int) -> tuple[int, int]:
        """A cell of one level, by row and column of another, also beside it."""
        one, two = self._lattices[number], self._lattices[other]
        row += round((two.y_max - one.y_max) / one.cell_size)
        return row, col + round((one.x_min - two.x_min) / one.cell_size)

    def is_within(self, row: int, col: int) -> bool:
        """Whether a cell is one of any level."""
        return bool(self._levels_at(row, col))

    def center(self, row: int, col: int) -> tuple[float, float]:
        """World x and y of a cell [m]."""
        x_min, y_max, cell_size, *_ = self._lattices[0]
        return x_min + (col + 0.5) * cell_size, y_max - (row + 0.5) * cell_size

    def is_sure(self, x: float, y: float, z: float) -> bool:
        """Whether a place is there beside its centre, too, and is no rim or touching limit."""
        for a, b in AROUND[1::4]:
            found = self._lines.at(x + RIM * a, y + RIM * b)
            places = found.standable(self.agent.height + OFF, self.agent.min_up + 1e-5)
            if not any(abs(s.z - z) <= OFF for s in places):
                return False
        return True

    def _is_a_step_from_free(self, row: int, col: int, z: float) -> bool:
        for dr, dc in SIDES:
            for floor, is_free in self._levels_at(row + dr, col + dc):
                if is_free and abs(floor - z) <= self.agent.step - OFF:
                    beside = self.standable_at(row + dr, col + dc)
                    if any(abs(s.z - floor) <= rounding(floor) for s in beside):
                        return True
        return False


STRIDE = 0.15  # distance of the places that are looked at [m]
MOST_PLACES = 20_000  # of one search
# A search calls a sheet a storey where it is clearly as large as a floor, where more than half of
# its outline has walls, and where clearly less than a quarter of it drops, as a top's would. A
# ground may be over a cellar or a pipe, up to the same share
CLEARLY_LARGE = 1.25
WALLED, DROPS, COVERS = 0.5, 0.2, 0.2
MIN_WALL = 1.5  # parapets are lower than walls [m]
REACHED = 3.0  # area of the floors that steps lead to, if it is to count as reached [m²]

Node = tuple[int, int, int]
"""Row and column on the lowest level's lattice, and the number of the surface in its column."""


@dataclass
class Sheet:
    """What a search from one place found.

    What drops to the sheet itself, as beside its own stairs, makes it no top.
    """

    place: Vector3
    geom: str
    reached: bool = False  # whether steps lead to a floor of the grid
    area: float = 0.0
    inner: float = 0.0  # of the area, what is farther from the outline than floors are shrunk by
    over: float = 0.0  # of the area, what lies over a place to stand that isn't its own
    walls: int = 0  # edges of its outline with a wall,
    drops: int = 0  # that drop to another floor,
    edges: int = 0  # and all

    def why_floor(self, min_area: float) -> str | None:
        """Why it is a floor by itself, in words; None if it isn't."""
        is_large = self.inner >= CLEARLY_LARGE * min_area
        if not is_large or self.drops > DROPS * self.edges:
            return None
        if self.walls > WALLED * self.edges:
            return "it has walls all round"
        return "there is nothing to stand on under it" if self.over <= COVERS * self.area else None


class SheetSearch:
    """Searches for all that hangs together by steps with places to stand that no level has.

    It is a fault only where steps lead to it, or where it is as large as a floor, without drops,
    and either has walls round most of it (a storey), or lies over nothing that one could stand on
    (a ground). Else it may be the top of furniture, a shelf or a roof, which a note counts.
    """

    def __init__(self, check: FloorCheck, cell_size: float, shrink: float) -> None:
        self._check, self._agent, self._shrink = check, check.agent, shrink
        self._stride = max(1, round(STRIDE / cell_size))
        self._edge = self._stride * cell_size
        self._seen: set[Node] = set()

    def from_place(self, unknown: Unknown) -> Sheet | None:
        """The sheet of a place; None if it was found before, or is as narrow as furniture.

        Places are looked at every `STRIDE`, so what is narrower may be missed, but beside a step
        from a free cell.
        """
        row, col = unknown.cell
        if not unknown.is_step:
            row, col = (v - v % self._stride for v in (row, col))
        start = self._near(row, col, unknown.place[2])
        if start is None:
            return None
        first = self._check.standable_at(row, col)[start]
        if not unknown.is_step:
            far = [2 * self._stride * np.array(side) for side in SIDES]
            ends = sum(self._near(row + dr, col + dc, first.z) is None for dr, dc in far)
            if (row, col, start) in self._seen or self._check.is_known(row, col, first.z):
                return None
            if ends >= 2 or not self._check.is_sure(*self._check.center(row, col), first.z):
                return None
        place = (*self._check.center(row, col), first.z)
        sheet = Sheet(place, self._check.name(first.number))
        own = self._search((row, col, start), sheet)
        places = {(r, c) for r, c, _ in own}
        reach = int(self._shrink / self._edge) + 1
        span = [k * self._stride for k in range(-reach, reach + 1)]
        inner = [
            (r, c) for r, c in places if all((r + i, c + j) in places for i in span for j in span)
        ]
        over = {(r, c) for r, c, n in own if any((r, c, k) not in own for k in range(n))}
        areas = [len(found) * self._edge**2 for found in (places, inner, over)]
        sheet.area, sheet.inner, sheet.over = areas
        return sheet

    def _search(self, start: Node, sheet: Sheet) -> set[Node]:
        """Search from place to place; the places that no level has, as far as they were found.

        It goes on over floors of the grid, until these are large enough to be a floor: what
        stands on the floor may be one by its lower parts, without steps that lead there.
        """
        own, known, queue = {start}, set[Node](), deque([start])
        below: list[Node | None] = []
        while queue and len(own) < MOST_PLACES and not sheet.reached:
            row, col, number = here = queue.popleft()
            z = self._check.standable_at(row, col)[number].z
            for dr, dc in SIDES:
                r, c = row + dr * self._stride, col + dc * self._stride
                # of what lies beside the grid, no floors are known
                beside = self._near(r, c, z) if self._check.is_within(r, c) else None
                if beside is None:
                    if here in own:
                        below.append(self._note_edge(sheet, (row, col), (dr, dc), z))
                    continue
                node = (r, c, beside)
                if node in own or node in known:
                    continue
                if not self._check.is_known(r, c, self._check.standable_at(r, c)[beside].z):
                    own.add(node)
                elif here in own and not self._walks(row, col, dr, dc, z):
                    below.append(self._note_edge(sheet, (row, col), (dr, dc), z))
                    continue
                else:
                    known.add(node)
                    sheet.reached = len(known) * self._edge**2 >= REACHED
                queue.append(node)
        self._seen |= own
        sheet.drops = sum(node is not None and node not in own for node in below)
        return own

    def _near(self, row: int, col: int, z: float) -> int | None:
        """The surface of a column that is a step at most from a height; None for none."""
        gaps = [abs(surface.z - z) for surface in self._check.standable_at(row, col)]
        best = min(gaps, default=np.inf)
        return gaps.index(best) if best <= self._agent.step - OFF else None

    def _walks(self, row: int, col: int, dr: int, dc: int, z: float) -> bool:
        """Whether steps from cell to cell lead over a stride."""
        for _ in range(self._stride):
            row, col = row + dr, col + dc
            beside = self._near(row, col, z)
            if beside is None:
                return False
            z = self._check.standable_at(row, col)[beside].z
        return True

    def _note_edge(
        self, sheet: Sheet, here: tuple[int, int], way: tuple[int, int], z: float
    ) -> Node | None:
        """Note how a sheet ends, at a wall or not; the place that it drops to, if it drops."""
        sheet.edges += 1
        low, high = z + self._agent.step, z + max(self._agent.height, MIN_WALL)
        for k in range(1, self._stride + 1):
            row, col = here[0] + k * way[0], here[1] + k * way[1]
            line = self._check.line_at(row, col)
            if any(begin < low and end > high for begin, end in line.solid):
                sheet.walls += 1
                return None
        lower = sum(s.z < z for s in self._check.standable_at(row, col))
        return (row, col, lower - 1) if lower else None
