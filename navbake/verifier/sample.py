"""The cells that are looked at, and what the grid says of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.grid_base import GridBase
from navbake.types import Bool, Float, Int
from navbake.verifier.agent import Agent
from navbake.verifier.probes import Column
from navbake.verifier.surroundings import Surroundings


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
        occupied: whether the layer of the occupancy says so; an inflation leaves it as baked.
        states_floors: whether the grid states floors of cells; else all are at the ground.
    """

    number: int
    level: SceneGrid2D
    rows: Int
    cols: Int
    xy: Float
    floor: Float
    free: Bool
    occupied: Bool
    states_floors: bool

    def __len__(self) -> int:
        return len(self.rows)


def states_floors(level: SceneGrid2D) -> bool:
    """Whether the cells of a level have floors of their own.

    An inflation writes floors into a map of another program that has none: its ground, where it
    was free. These say no more than the map did.
    """
    if not level.uses_cell_floors or level.navbake or "inflation" not in level.metadata:
        return level.uses_cell_floors
    floors = level.floor_height[~np.isnan(level.floor_height)]
    return bool((floors != np.float32(level.min_yup[1])).any())


def take_sample(
    grid: GridBase, number: int | None, seed: int, with_floors: Sequence[bool]
) -> list[LevelSample]:
    """Draw cells of all levels, each as likely as any other; all of them if None.

    Args:
        with_floors: of each level, what `states_floors` said before the grid was inflated.
    """
    sizes = [level.width * level.height for level in grid.levels]
    total, start = sum(sizes), np.cumsum([0, *sizes])
    if number is None or number >= total:
        chosen = np.arange(total)
    else:
        chosen = np.sort(np.random.default_rng(seed).choice(total, number, replace=False))
    samples = []
    for k, (level, has_own) in enumerate(zip(grid.levels, with_floors, strict=True)):
        cells = chosen[(chosen >= start[k]) & (chosen < start[k + 1])] - start[k]
        samples.append(_sample_level(k, level, cells, has_own))
    return samples


def _sample_level(number: int, level: SceneGrid2D, cells: Int, has_own: bool) -> LevelSample:
    rows, cols = np.divmod(cells, level.width)
    floor = level.floor_of(rows, cols) if has_own else np.full(len(cells), level.ground)
    xy = level.lattice.positions(rows, cols).reshape(-1, 2)
    free, occupied = level.free[rows, cols], level.occupancy[rows, cols] != 0
    return LevelSample(number, level, rows, cols, xy, floor, free, occupied, has_own)


class Bands(NamedTuple):
    """The heights between which nothing may touch, of each cell [m]."""

    low: Float
    high: Float


class Part(NamedTuple):
    """One part of the volume over each cell: a square's or a disc's.

    Attributes:
        half: half of its edge, or its radius [m].
        is_round: whether it is a disc's.
        bands: from where to where it is.
    """

    half: float
    is_round: bool
    bands: Bands


def baked_volume(sample: LevelSample, agent: Agent) -> list[Part]:
    """The volume of the bake: from a step above the floor to the agent's height."""
    bands = Bands(sample.floor + agent.step, sample.floor + agent.height)
    return [Part(*part, bands) for part in agent.footprint(sample.level.lattice.cell_size)]


def volume_for(
    sample: LevelSample, agent: Agent, around: Surroundings, radius: float
) -> list[Part]:
    """The volume for a larger agent: the cell's square as baked, and the disc of its radius.

    The disc's is between the heights that all floors under it leave free.
    """
    square = baked_volume(sample, agent._replace(radius=0.0))
    if radius <= square[0].half:
        return square
    cells = sample.rows, sample.cols
    low, high = around.floors_under(sample.number, *cells, sample.floor, radius)
    return [*square, Part(radius, True, Bands(high + agent.step, low + agent.height))]


class CellIndex:
    """Finds the sampled cells under a box quickly."""

    def __init__(self, sample: LevelSample) -> None:
        self.sample = sample
        self._at = np.full(sample.level.shape, -1, dtype=np.int64)
        self._at[sample.rows, sample.cols] = np.arange(len(sample))

    def under(self, low: Float, high: Float, reach: float, bands: Bands) -> Int:
        """The cells whose columns, from their low to their high, meet a box widened sideways."""
        lattice, sample = self.sample.level.lattice, self.sample
        if np.isfinite(low[:2]).all() and np.isfinite(high[:2]).all():
            window = lattice.window(np.array([low[:2], high[:2]]), reach)
            if window is None:
                return np.empty(0, dtype=np.int64)
            found = self._at[window].ravel()
            found = found[found >= 0]
        else:
            found = np.arange(len(sample))
        kept = (bands.low[found] < high[2]) & (bands.high[found] > low[2])
        for axis in (0, 1):
            at = sample.xy[found, axis]
            kept &= (at + reach > low[axis]) & (at - reach < high[axis])
        return np.asarray(found[kept])


def column_of(part: Part, cell: int) -> Column:
    """A part's column over a cell, its height to the micrometre, so that few differ."""
    half_z = round(float(part.bands.high[cell] - part.bands.low[cell]) / 2, 6)
    return Column(part.half, part.half, half_z, part.is_round)
