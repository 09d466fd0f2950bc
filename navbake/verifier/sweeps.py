"""Cylinders that are swept along planned paths."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from navbake.navgrid.grid import NavGrid
from navbake.navgrid.lattice import Lattice
from navbake.runtime.path_finder import PathFinder
from navbake.types import Float, Int
from navbake.verifier.probes import TOUCHES, Column, Probes
from navbake.verifier.report import PATH_TOUCHES, Finding, SweepCounts
from navbake.verifier.sample import Agent, Surroundings

MOST_TRIES = 20  # a path, to find two places that are apart
CORNER = 1e-6  # a line is no longer than this in a cell whose corner it runs through [m]
LEVEL = 1e-4  # pieces whose floors differ by less are swept as one [m]


class Piece(NamedTuple):
    """A straight part of a path on one floor, from above."""

    a: Float
    b: Float
    floor: float
    low: float  # the lowest floor under the cylinder, within a step [m]
    high: float  # and the highest
    level: int


class Sweep:
    """Sweeps a cylinder along paths on a grid that is inflated for it.

    It is as high as the agent, less a step at its lower end, and has to touch nothing between the
    heights that all floors under it leave free; what it meets beyond is counted by itself.
    """

    def __init__(
        self, grid: NavGrid, probes: Probes, agent: Agent, radius: float, tolerance: float
    ) -> None:
        self._grid, self._probes, self._agent = grid, probes, agent
        self._radius, self._tolerance = radius, tolerance
        self._around = Surroundings(grid, agent.step)

    def run(self, number: int, seed: int) -> tuple[SweepCounts, list[Finding]]:
        """Plan so many paths between random places, and sweep along each."""
        counts, findings = SweepCounts(self._radius), list[Finding]()
        finder, rng = PathFinder(self._grid), np.random.default_rng(seed)
        for _ in range(number * MOST_TRIES):
            start = finder.random_point(rng) if counts.paths < number else None
            if start is None:
                break
            goal = finder.random_point(rng, reachable_from=start)
            path = None if goal is None else finder.find_path(start, goal)
            if path is None or path.length == 0.0:
                continue
            found, beside = self._along(path.positions, path.levels)
            counts.paths += 1
            counts.length += path.length
            counts.beside += beside
            findings += found
        counts.touching, counts.length = len(findings), round(counts.length, 6)
        return counts, findings

    def _along(self, positions: Float, levels: Int) -> tuple[list[Finding], bool]:
        """The first touch along a path, and whether it meets anything within a step of its ends."""
        beside, step, height = False, self._agent.step, self._agent.height
        for piece in self._pieces(positions, levels):
            sure = piece.high + step, piece.low + height
            whole = piece.floor + step, piece.floor + height
            if touched := self._touch(piece, sure):
                name, depth = self._probes.obstacles.name(touched[0]), touched[1] + self._tolerance
                x, y = ((piece.a + piece.b) / 2).tolist()
                lattice = self._grid.levels[piece.level].lattice
                row, col = (int(v) for v in lattice.rows_cols([x, y]))
                text = f"a cylinder of {self._radius:g} m on a path runs {depth:.4f} m into "
                text += f"{name!r}, between {sure[0]:.3f} and {sure[1]:.3f} m"
                cell, place = (piece.level, (row, col)), (x, y, piece.floor)
                return [Finding(PATH_TOUCHES, *cell, place, text, name, depth)], beside
            beside = beside or (sure != whole and self._touch(piece, whole) is not None)
        return [], beside

    def _pieces(self, positions: Float, levels: Int) -> list[Piece]:
        """A path cut where it goes from cell to cell, pieces of one floor put together."""
        pieces: list[Piece] = []
        lattices = [level.lattice for level in self._grid.levels]
        for k, (a, b) in enumerate(pairwise(positions)):
            if np.hypot(*(b - a)[:2]) < CORNER:
                continue  # a step up or down between the floors on both sides
            lattice = lattices[int(levels[k])]
            times = _cuts(lattice, a, b)
            points = a[:2] + np.outer(times, b[:2] - a[:2])
            middles, between = (points[1:] + points[:-1]) / 2, (times[1:] + times[:-1]) / 2
            between = a[2] + between * (b[2] - a[2])
            on = sorted({int(levels[k]), int(levels[k + 1])})
            cells = [(number, *lattices[number].rows_cols(middles)) for number in on]
            # where it goes from one level to another, the nearer of their floors counts
            found = np.stack([self._around.look(cell[0], *cell)[0] for cell in cells])
            gaps = np.nan_to_num(np.abs(found - between), nan=np.inf)
            best = gaps.argmin(axis=0)
            floor = np.take_along_axis(found, best[None], axis=0)[0]
            floor = np.where(np.isnan(floor), between, floor)
            reach = self._radius + lattice.cell_size * np.sqrt(0.5)
            under = [self._around.floors_under(*cell, floor, reach) for cell in cells]
            for n, which in enumerate(best.tolist()):
                low, high = under[which]
                heights = float(floor[n]), float(low[n]), float(high[n])
                last = pieces[-1] if n else None
                if last and last.level == on[which] and np.allclose(last[2:5], heights, 0, LEVEL):
                    pieces[-1] = last._replace(b=points[n + 1])
                else:
                    pieces.append(Piece(points[n], points[n + 1], *heights, on[which]))
        return pieces

    def _touch(self, piece: Piece, band: tuple[float, float]) -> tuple[int, float] | None:
        """The first obstacle that the cylinder touches on a piece, and how deep [m]."""
        half_z = (band[1] - band[0]) / 2 - self._tolerance
        radius, z = self._radius - self._tolerance, (band[0] + band[1]) / 2
        if half_z <= 0:
            return None
        way, middle = piece.b - piece.a, (piece.a + piece.b) / 2
        disc, yaw = Column(radius, radius, half_z, True), float(np.arctan2(way[1], way[0]))
        between = Column(float(np.hypot(*way)) / 2, radius, half_z, False, yaw)
        low, high = np.minimum(piece.a, piece.b) - radius, np.maximum(piece.a, piece.b) + radius
        box_low, box_high = np.array([*low, z - half_z]), np.array([*high, z + half_z])
        for number in self._probes.obstacles.meeting(box_low, box_high):
            for column, at in ((disc, piece.a), (disc, piece.b), (between, middle)):
                center = np.array([*at, z])
                if self._probes.touches(number, column, center) == TOUCHES:
                    return number, self._probes.depth(column, center, number)
        return None


def _cuts(lattice: Lattice, a: Float, b: Float) -> Float:
    """Where a line goes from cell to cell, as shares of its length from 0 to 1."""
    times = np.array([0.0, 1.0])
    corner = np.array([lattice.x_min, lattice.y_max])
    for first, last in zip(*((p[:2] - corner) / lattice.cell_size for p in (a, b)), strict=True):
        edges = np.arange(np.floor(min(first, last)) + 1, np.ceil(max(first, last)))
        times = np.append(times, (edges - first) / (last - first or 1.0))
    times = np.unique(times)
    # a line through a corner of cells is in none of those beside
    return np.asarray(times[np.diff(times, append=2.0) > CORNER / np.hypot(*(b - a)[:2])])
