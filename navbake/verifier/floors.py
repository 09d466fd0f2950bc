"""Whether each floor is a surface, and whether no place to stand was left out."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from navbake.navgrid.grid_base import GridBase
from navbake.types import Vector3
from navbake.verifier.agent import Agent
from navbake.verifier.lines import CRACK, FACES_UP, RIM, WAYS, Line, Lines, Surface
from navbake.verifier.report import FLOOR_OFF, Finding, LevelCounts
from navbake.verifier.sample import LevelSample

OFF = 1e-4  # metres that a floor may be off a surface, and
SHARE = 1e-6  # a share of its distance from the origin, which float32 rounds off


class Unknown(NamedTuple):
    """A place to stand that no level has.

    Attributes:
        cell: row and column on the level where it was looked for.
        place: world x, y, z [m].
        geom: the name of the geom to stand on.
        is_step: whether a step joins it to the floor of a free cell.
    """

    cell: tuple[int, int]
    place: Vector3
    geom: str
    is_step: bool


def rounding(*coordinates: float) -> float:
    """How far a floor may be off a surface at some coordinates [m]."""
    return OFF + SHARE * max(map(abs, coordinates))


def is_same_height(z: float, floor: float) -> bool:
    """Whether a surface is at the height of a floor [m]."""
    return abs(z - floor) <= rounding(floor)


class FloorCheck:
    """Checks floors by MuJoCo's rays, and finds places that no level has."""

    def __init__(self, grid: GridBase, lines: Lines, agent: Agent, crack: float = CRACK) -> None:
        self._levels, self._lines, self._crack = grid.levels, lines, crack
        self.agent = agent
        self._floors = [level.floor for level in grid.levels]
        self._free = [level.free for level in grid.levels]
        self._lattices = [level.lattice for level in grid.levels]
        self.line_at = lru_cache(maxsize=200_000)(self._line_at)
        self.standable_at = lru_cache(maxsize=200_000)(self._standable_at)

    def run(self, sample: LevelSample, counts: LevelCounts) -> tuple[list[Finding], list[Unknown]]:
        """Check the floors of a level, and find the places to stand that no level has.

        A floor may lie inside of a solid: floors go on under things, of which those that are lower
        than a step block nothing. Where an agent can stand on one of these, that place is lost.
        Columns whose floor is off, or beside the centre, are not asked for more.
        """
        findings, unknown = list[Finding](), list[Unknown]()
        for cell in range(len(sample)):
            if np.isnan(sample.floor[cell]):
                unknown += self._find_unknown(sample, cell)
                continue
            counts.floors += 1
            if self._has_floor(sample, cell, beside=False):
                unknown += self._find_unknown(sample, cell)
            elif self._has_floor(sample, cell, beside=True):
                counts.in_cracks += 1
            else:
                counts.floors_off += 1
                findings.append(self._describe_off(sample, cell))
        return findings, unknown

    # ------------------------------------------------------------ floors

    def _has_floor(self, sample: LevelSample, cell: int, *, beside: bool) -> bool:
        """Whether a surface faces up at a cell's floor: at its centre, or beside it."""
        (x, y), z = sample.xy[cell].tolist(), float(sample.floor[cell])
        low, high = z - rounding(x, y, z), z + rounding(x, y, z)
        place = sample.number, int(sample.rows[cell]), int(sample.cols[cell])
        if not beside:
            return self.line_at(*place).faces_up(low, high)
        # at the edge of a crack, floors that slope have any height
        is_gap = all(abs(s.z - z) > self.agent.step for s in self.standable_at(*place))
        min_up = self.agent.min_up if is_gap else np.inf
        return self._lines.faces_up_beside(x, y, low, high, self._crack, min_up=min_up)

    def _describe_off(self, sample: LevelSample, cell: int) -> Finding:
        (x, y), z = sample.xy[cell].tolist(), float(sample.floor[cell])
        row, col = int(sample.rows[cell]), int(sample.cols[cell])
        surfaces = self.line_at(sample.number, row, col).surfaces
        off = min((abs(s.z - z) for s in surfaces if s.up >= FACES_UP), default=None)
        text = f"has its floor at {z:.4f} m, "
        text += "over no surface" if off is None else f"{off:.4f} m off the nearest surface"
        return Finding(FLOOR_OFF, sample.number, (row, col), (x, y, z), text, None, off)

    # ------------------------------------------------------------ places that are lost

    def _find_unknown(self, sample: LevelSample, cell: int) -> list[Unknown]:
        """The places to stand in a column that no level has, lowest first.

        A place is a surface that an agent can stand on. A step beside a free cell, it is a fault.
        """
        found = []
        row, col = int(sample.rows[cell]), int(sample.cols[cell])
        for surface in self.unknown_at(sample.number, row, col):
            here = sample.number, row, col, surface.z
            is_step = self._is_a_step_from_free(*here) and self.is_sure(*here)
            x, y = sample.xy[cell].tolist()
            place = x, y, surface.z
            found.append(Unknown((row, col), place, self.name(surface.number), is_step))
        return found

    def name(self, number: int) -> str:
        """The name of the geom that an obstacle belongs to."""
        return self._lines.obstacles.name(number)

    def unknown_at(self, number: int, row: int, col: int) -> list[Surface]:
        """Where one can stand in a column, though no level has its floor there."""
        known = self.floors_at(number, row, col)
        return [
            surface
            for surface in self.standable_at(number, row, col)
            if not any(is_same_height(surface.z, z) for z in known)
        ]

    def floors_at(self, number: int, row: int, col: int) -> list[float]:
        """The floors of all levels in a column of one level's lattice [m]."""
        found = []
        for other in range(len(self._levels)):
            r, c = self._on(number, other, row, col)
            floors = self._floors[other]
            if 0 <= r < floors.shape[0] and 0 <= c < floors.shape[1]:
                floor = float(floors[r, c])
                found += [floor] if floor == floor else []  # not NaN
        return found

    def _on(self, number: int, other: int, row: int, col: int) -> tuple[int, int]:
        """A cell of one level, by row and column of another, also beside it."""
        if number == other:
            return row, col
        one, two = self._lattices[number], self._lattices[other]
        row += round((two.y_max - one.y_max) / one.cell_size)
        return row, col + round((one.x_min - two.x_min) / one.cell_size)

    def _standable_at(self, number: int, row: int, col: int) -> list[Surface]:
        """The surfaces in a column that an agent can stand on, lowest first."""
        agent = self.agent
        return self.line_at(number, row, col).standable(agent.height, agent.min_up)

    def _line_at(self, number: int, row: int, col: int) -> Line:
        x, y = self.center(number, row, col)
        return self._lines.at(x, y)

    def on_lowest(self, number: int, cell: tuple[int, int]) -> tuple[int, int]:
        """A cell of a level, by row and column of the lowest one, also beside it."""
        return self._on(number, 0, *cell)

    def is_within(self, row: int, col: int) -> bool:
        """Whether a cell, by row and column of the lowest level, is one of any level."""
        for other, lattice in enumerate(self._lattices):
            r, c = self._on(0, other, row, col)
            if 0 <= r < lattice.height and 0 <= c < lattice.width:
                return True
        return False

    def center(self, number: int, row: int, col: int) -> tuple[float, float]:
        """World x and y of a cell, also beside the level [m]."""
        x_min, y_max, cell_size, *_ = self._lattices[number]
        return x_min + (col + 0.5) * cell_size, y_max - (row + 0.5) * cell_size

    def is_sure(self, number: int, row: int, col: int, z: float) -> bool:
        """Whether the place is there beside the centre, too, and is no rim or touching limit."""
        agent, (x, y) = self.agent, self.center(number, row, col)
        for a, b in WAYS[1::4]:
            found = self._lines.at(x + RIM * a, y + RIM * b)
            heights = [s.z for s in found.standable(agent.height + OFF, agent.min_up + 1e-5)]
            if not any(abs(h - z) <= OFF for h in heights):
                return False
        return True

    def _is_a_step_from_free(self, number: int, row: int, col: int, z: float) -> bool:
        for other, (floors, free) in enumerate(zip(self._floors, self._free, strict=True)):
            for dr, dc in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                r, c = self._on(number, other, row + dr, col + dc)
                if not (0 <= r < free.shape[0] and 0 <= c < free.shape[1]) or not free[r, c]:
                    continue
                floor = float(floors[r, c])
                if abs(floor - z) > self.agent.step - OFF:
                    continue
                beside = self.standable_at(number, row + dr, col + dc)
                if any(is_same_height(s.z, floor) for s in beside):
                    return True
        return False
