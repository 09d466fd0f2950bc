"""The cells that are looked at, and what the grid says of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navbake.errors import QueryError
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.grid_base import GridBase
from navbake.types import Bool, Float, Int
from navbake.verifier.probes import Column


class Agent(NamedTuple):
    """For whom the grid is.

    Attributes:
        height, radius, step: as baked [m].
        min_up: least z of a floor's unit normal.
    """

    height: float
    radius: float
    step: float
    min_up: float

    @classmethod
    def of(cls, grid: GridBase) -> Agent:
        """The agent that a grid states, with the format's defaults."""
        slope = grid.navbake.get("maxSlope")
        degrees = float(slope) if isinstance(slope, int | float) else 45.0
        up = float(np.cos(np.radians(degrees)))
        return cls(grid.agent_height, grid.agent_radius, grid.max_step, up)

    def footprint(self, cell_size: float) -> list[tuple[float, bool]]:
        """The baked footprint: half-size and whether it is round, for square and disc [m]."""
        half = cell_size / 2
        parts = [(half, False)] if self.radius < half * np.sqrt(2.0) else []
        return parts + ([(self.radius, True)] if self.radius > half else [])


@dataclass(frozen=True)
class LevelSample:
    """Cells of one level.

    Attributes:
        number: the level.
        level: its grid.
        rows, cols: of the cells, shape (n,).
        xy: their centres, shape (n, 2), world frame [m].
        floor: their floors, NaN for none [m].
        free: whether an agent can stand there.
        occupied: the same without what an inflation closed: the baked occupancy.
    """

    number: int
    level: SceneGrid2D
    rows: Int
    cols: Int
    xy: Float
    floor: Float
    free: Bool
    occupied: Bool

    def __len__(self) -> int:
        return len(self.rows)

    def near(self, low: Float, high: Float, reach: float, wanted: Bool) -> Int:
        """The wanted cells whose centres are within a box widened by a reach, seen from above."""
        near = np.array(wanted)
        for axis in (0, 1):
            near &= self.xy[:, axis] > low[axis] - reach
            near &= self.xy[:, axis] < high[axis] + reach
        return np.flatnonzero(near)


def take_sample(grid: GridBase, number: int | None, seed: int) -> list[LevelSample]:
    """Draw cells of all levels, each as likely as any other; all of them if None.

    Raises:
        QueryError: the number isn't at least 1.
    """
    if number is not None and (not isinstance(number, int | np.integer) or number < 1):
        raise QueryError(f"expected a sample of at least 1 cell, got {number!r}")
    sizes = [level.width * level.height for level in grid.levels]
    total, start = sum(sizes), np.cumsum([0, *sizes])
    if number is None or number >= total:
        chosen = np.arange(total)
    else:
        chosen = np.sort(np.random.default_rng(seed).choice(total, number, replace=False))
    samples = []
    for k, level in enumerate(grid.levels):
        cells = chosen[(chosen >= start[k]) & (chosen < start[k + 1])] - start[k]
        samples.append(_sample_level(k, level, cells))
    return samples


def _sample_level(number: int, level: SceneGrid2D, cells: Int) -> LevelSample:
    rows, cols = np.divmod(cells, level.width)
    floor = level.floor_of(rows, cols)
    xy = level.lattice.positions(rows, cols).reshape(-1, 2)
    free, occupied = level.free[rows, cols], level.occupancy[rows, cols] != 0
    return LevelSample(number, level, rows, cols, xy, floor, free, occupied)


class CellIndex:
    """Finds the sampled cells under a box quickly."""

    def __init__(self, sample: LevelSample, low: Float, high: Float) -> None:
        self._sample, self._low, self._high = sample, low, high
        self._at = np.full(sample.level.shape, -1, dtype=np.int64)
        self._at[sample.rows, sample.cols] = np.arange(len(sample))

    def under(self, low: Float, high: Float, reach: float) -> Int:
        """The cells whose columns, from their low to their high, meet a box widened sideways."""
        lattice, sample = self._sample.level.lattice, self._sample
        if np.isfinite(low[:2]).all() and np.isfinite(high[:2]).all():
            window = lattice.window(np.array([low[:2], high[:2]]), reach)
            if window is None:
                return np.empty(0, dtype=np.int64)
            found = self._at[window].ravel()
            found = found[found >= 0]
        else:
            found = np.arange(len(sample))
        kept = (self._low[found] < high[2]) & (self._high[found] > low[2])
        for axis in (0, 1):
            at = sample.xy[found, axis]
            kept &= (at + reach > low[axis]) & (at - reach < high[axis])
        return np.asarray(found[kept])


class Bands(NamedTuple):
    """The heights between which nothing may touch, of each cell [m]."""

    low: Float
    high: Float


def baked_bands(sample: LevelSample, agent: Agent) -> Bands:
    """The band of the bake: from a step above the floor to the agent's height."""
    return Bands(sample.floor + agent.step, sample.floor + agent.height)


def column_of(half: float, is_round: bool, band: tuple[float, float]) -> Column:
    """An upright column between two heights, to the micrometre, so that few differ."""
    half_z = round((band[1] - band[0]) / 2, 6)
    return Column(half, half, half_z, is_round)
