"""Cylinders that are swept along planned paths."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from navbake.navgrid.grid import NavGrid
from navbake.navgrid.grid_base import GridBase
from navbake.navgrid.lattice import Lattice
from navbake.runtime.path_finder import PathFinder
from navbake.types import Float, Int
from navbake.verifier.agent import Agent
from navbake.verifier.probes import TOUCHES, Column, Probes, depth_of
from navbake.verifier.report import PATH_TOUCHES, Finding, SweepCounts
from navbake.verifier.sample import Surroundings

MOST_TRIES = 20  # a path, to find two places that are apart
CORNER = 1e-6  # a line is no longer than this in a cell whose corner it runs through [m]
LEVEL = 1e-4  # pieces whose floors differ by less are swept as one [m]


class Piece(NamedTuple):
    """A straight part of a path on one floor.

    Attributes:
        a, b: its ends from above, shape (2,) [m].
        floor: [m].
        low, high: the lowest and the highest floor under the cylinder, within a step [m].
        level: the level.
    """

    a: Float
    b: Float
    floor: float
    low: float
    high: float
    level: int


def sweep_paths(
    grid: NavGrid, probes: Probes, agent: Agent, radius: float, options: tuple[int, int, float]
) -> tuple[SweepCounts, list[Finding]]:
    """Plan paths between random places, and sweep a cylinder along each.

    The cylinder is as high as the agent, less a step at its lower end. It has to touch nothing
    between the heights that all floors under it leave free. What it meets lower or higher than
    that, up to a step, is counted by itself: a cell is judged from its own floor.

    Args:
        grid: already inflated for the radius.
        options: number of paths, seed, and tolerance [m].
    """
    number, seed, tolerance = options
    counts, findings = SweepCounts(radius), list[Finding]()
    finder, rng = PathFinder(grid), np.random.default_rng(seed)
    sweep = _Sweep(grid, probes, agent, radius, tolerance)
    for _ in range(number * MOST_TRIES):
        if counts.paths == number:
            break
        start = finder.random_point(rng)
        if start is None:
            break
        goal = finder.random_point(rng, reachable_from=start)
        path = None if goal is None else finder.find_path(start, goal)
        if path is None or path.length == 0.0:
            continue
        counts.paths += 1
        counts.length += path.length
        found, beside = sweep.along(path.positions, path.levels)
        counts.beside += beside
        if found is not None:
            counts.touching += 1
            findings.append(found)
    counts.length = round(counts.length, 6)
    return counts, findings


class _Sweep:
    def __init__(
        self, grid: GridBase, probes: Probes, agent: Agent, radius: float, tolerance: float
    ) -> None:
        self._grid, self._probes, self._agent = grid, probes, agent
        self._radius, self._tolerance = radius, tolerance
        self._around = Surroundings(grid, agent.step)

    def along(self, positions: Float, levels: Int) -> tuple[Finding | None, bool]:
        """The first touch along a path, and whether it meets anything within a step of its ends."""
        beside = False
        for piece in self._pieces(positions, levels):
            sure = piece.high + self._agent.step, piece.low + self._agent.height
            whole = piece.floor + self._agent.step, piece.floor + self._agent.height
            touched = self._touch(piece, sure)
            if touched is not None:
                return self._describe(piece, sure, *touched), beside
            if sure != whole and not beside:
                beside = self._touch(piece, whole) is not None
        return None, beside

    def _pieces(self, positions: Float, levels: Int) -> list[Piece]:
        """A path cut where it goes from cell to cell, pieces of one floor put together."""
        pieces: list[Piece] = []
        for k, (a, b) in enumerate(pairwise(positions)):
            if np.hypot(*(b - a)[:2]) < CORNER:
                continue  # a step up or down between the floors on both sides
            lattice = self._grid.levels[int(levels[k])].lattice
            times = _cuts(lattice, a, b)
            points = a[:2] + np.outer(times, b[:2] - a[:2])
            middles = (points[1:] + points[:-1]) / 2
            between = a[2] + (times[1:] + times[:-1]) / 2 * (b[2] - a[2])
            on = sorted({int(levels[k]), int(levels[k + 1])})
            # where it goes from one level to another, the nearer of their floors counts
            found = np.stack([self._floors(level, middles) for level in on])
            with np.errstate(invalid="ignore"):
                gaps = np.where(np.isnan(found), np.inf, np.abs(found - between))
            best = gaps.argmin(axis=0)
            floor = np.take_along_axis(found, best[None], axis=0)[0]
            floor = np.where(np.isnan(floor), between, floor)
            level = np.array(on)[best]
            reach = self._radius + lattice.cell_size * np.sqrt(0.5)
            low, high = floor.copy(), floor.copy()
            for number in on:
                rows, cols = self._grid.levels[number].lattice.rows_cols(middles)
                here = level == number
                around = self._around.floors_under(number, rows, cols, floor, reach)
                low[here], high[here] = around[0][here], around[1][here]
            for n in range(len(middles)):
                heights = float(floor[n]), float(low[n]), float(high[n])
                new = Piece(points[n], points[n + 1], *heights, int(level[n]))
                if pieces and n and _alike(pieces[-1], new):
                    pieces[-1] = pieces[-1]._replace(b=new.b)
                else:
                    pieces.append(new)
        return pieces

    def _floors(self, number: int, points: Float) -> Float:
        """The floors of a level under points, NaN for none [m]."""
        level = self._grid.levels[number]
        rows, cols = level.lattice.rows_cols(points)
        inside = (rows >= 0) & (cols >= 0) & (rows < level.height) & (cols < level.width)
        rows, cols = np.where(inside, rows, 0), np.where(inside, cols, 0)
        floors = level.floor_of(rows, cols)
        return np.where(inside, floors, np.nan)

    def _touch(
        self, piece: Piece, band: tuple[float, float]
    ) -> tuple[int, Column, Float, float] | None:
        """The first obstacle that the cylinder touches on a piece, and with which column."""
        half_z = (band[1] - band[0]) / 2 - self._tolerance
        radius = self._radius - self._tolerance
        if half_z <= 0 or radius <= 0:
            return None
        z = (band[0] + band[1]) / 2
        way = piece.b - piece.a
        length = float(np.hypot(*way))
        columns = [
            (Column(radius, radius, half_z, True), np.array([*end, z]), 0.0)
            for end in (piece.a, piece.b)
        ]
        if length > 1e-9:
            middle = np.array([*((piece.a + piece.b) / 2), z])
            turn = float(np.arctan2(way[1], way[0]))
            columns.append((Column(length / 2, radius, half_z, False), middle, turn))
        low = np.minimum(piece.a, piece.b) - radius
        high = np.maximum(piece.a, piece.b) + radius
        obstacles = self._probes.obstacles
        near = (obstacles.low[:, :2] < high).all(axis=1) & (obstacles.high[:, :2] > low).all(axis=1)
        near &= (obstacles.low[:, 2] < z + half_z) & (obstacles.high[:, 2] > z - half_z)
        for number in np.flatnonzero(near).tolist():
            for column, center, turn in columns:
                probe = self._probes.of(column)
                probe.place(center, turn)
                if probe.touches(number) == TOUCHES:
                    return number, column, center, turn
        return None

    def _describe(
        self,
        piece: Piece,
        band: tuple[float, float],
        number: int,
        column: Column,
        center: Float,
        turn: float,
    ) -> Finding:
        depth = depth_of(self._probes, column, center, number, turn) + self._tolerance
        name = self._probes.obstacles.name(number)
        x, y = ((piece.a + piece.b) / 2).tolist()
        lattice = self._grid.levels[piece.level].lattice
        row, col = (int(v) for v in lattice.rows_cols([x, y]))
        text = (
            f"a cylinder of {self._radius:g} m on a path runs {depth:.4f} m into {name!r}, "
            f"between {band[0]:.3f} and {band[1]:.3f} m"
        )
        place = (x, y, piece.floor)
        return Finding(PATH_TOUCHES, piece.level, (row, col), place, text, name, depth)


def _alike(one: Piece, other: Piece) -> bool:
    gaps = [abs(a - b) for a, b in zip(one[2:5], other[2:5], strict=True)]
    return one.level == other.level and max(gaps) < LEVEL


def _cuts(lattice: Lattice, a: Float, b: Float) -> Float:
    """Where a line goes from cell to cell, as shares of its length from 0 to 1."""
    found = [0.0, 1.0]
    ends = (
        (a[0] - lattice.x_min, b[0] - lattice.x_min),
        (lattice.y_max - a[1], lattice.y_max - b[1]),
    )
    for first, last in ends:
        low, high = sorted((first / lattice.cell_size, last / lattice.cell_size))
        if high - low > 1e-12:
            edges = np.arange(np.floor(low) + 1, np.ceil(high)) * lattice.cell_size
            found += ((edges - first) / (last - first)).tolist()
    # a line through a corner of cells is in none of those beside
    least = CORNER / max(float(np.hypot(*(b - a)[:2])), CORNER)
    times = [0.0]
    for time in sorted(found):
        if times[-1] + least < time < 1.0 - least:
            times.append(time)
    return np.array([*times, 1.0])
