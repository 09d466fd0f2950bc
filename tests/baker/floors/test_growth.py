"""Floors go on under things ring by ring."""

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors import growth
from navbake.baker.floors.growth import grow_levels
from navbake.baker.floors.growth_kernels import BARRIER, NO_LEVEL, GrowingSurfaces
from navbake.config.settings import AgentSettings
from navbake.errors import SceneError
from navbake.navgrid.lattice import Lattice
from navbake.threads import LEAST_CELLS, limit_threads

LATTICE = Lattice(0.0, 2.0, 0.1, 132, 3)  # five blocks beside each neighbor
CELLS = LATTICE.width * LATTICE.height
STEP = 0.2
# multiples of a quarter: a step is met to the last bit, and some are equally near to two
HEIGHTS = np.arange(8) * 0.0625
seeds = st.integers(0, 2**32 - 1)


def draw(rng):
    """Floors where one can stand, and in the other cells surfaces, of which some are barriers.

    Returns:
        By cell: the height of the floor, NaN for none; heights of surfaces on no level; and whether
        each of these is a barrier.
    """
    floor = rng.choice(HEIGHTS, CELLS)
    floor[rng.random(CELLS) < rng.uniform(0.3, 1.0)] = np.nan
    options = [
        np.sort(rng.choice(HEIGHTS, rng.integers(0, 3))) if np.isnan(z) else np.empty(0)
        for z in floor
    ]
    barrier_share = rng.choice([0.0, 0.3])
    barriers = [rng.random(len(heights)) < barrier_share for heights in options]
    return floor, options, barriers


def drop_barriers(heights, is_barrier):
    """The heights of a cell at which a floor may go on: not at a barrier, nor closely below one."""
    return [
        z
        for k, z in enumerate(heights)
        if not is_barrier[k]
        and not (is_barrier[k + 1 :] & (heights[k + 1 :] - z <= STEP + LIMIT_SLACK)).any()
    ]


def neighbours(cell):
    row, col = divmod(cell, LATTICE.width)
    for r, c in ((row, col + 1), (row + 1, col), (row, col - 1), (row - 1, col)):
        if 0 <= r < LATTICE.height and 0 <= c < LATTICE.width:
            yield r * LATTICE.width + c


def grow_plainly(floor, options):
    """Each ring looks at all cells; the floors, and the ring in which each cell got its own."""
    floor, ring, number = floor.copy(), np.where(np.isnan(floor), -1, 0), 0
    while True:
        number += 1
        new = {}
        for cell in np.flatnonzero(np.isnan(floor)).tolist():
            beside = [
                floor[neighbor] for neighbor in neighbours(cell) if not np.isnan(floor[neighbor])
            ]
            gaps = [(abs(z - near), z) for near in beside for z in options[cell]]
            gaps = [pair for pair in gaps if pair[0] <= STEP + LIMIT_SLACK]
            if gaps:
                new[cell] = min(gaps)[1]
        if not new:
            return floor, ring.astype(np.int32)
        for cell, z in new.items():
            floor[cell] = z
            ring[cell] = number


def grow(floor, options, barriers):
    """The floors and rings that grow from cells where one can stand."""
    stands = ~np.isnan(floor)
    heights = [floor[i : i + 1] if stands[i] else options[i] for i in range(CELLS)]
    end = np.cumsum([len(column) for column in heights])
    first = end - np.array([len(column) for column in heights])
    levels = [[0] if stands[i] else np.where(barriers[i], BARRIER, NO_LEVEL) for i in range(CELLS)]
    surfaces = GrowingSurfaces(
        lattice=LATTICE,
        first=first.astype(np.int32),
        end=end.astype(np.int32),
        z=np.concatenate(heights),
        level=np.concatenate(levels).astype(np.int16),
    )
    agent = AgentSettings(height=1.0, traversable_floor_height=STEP)
    (floor_of_level,) = grow_levels(surfaces, num_levels=1, agent=agent)
    return floor_of_level


@settings(deadline=None)  # its kernels may be compiled first
@given(seeds, st.sampled_from([1, 8, LEAST_CELLS]), st.sampled_from([1, 2, 4]))
def test_floors_grow_as_ring_after_ring_of_all_cells(seed, least, threads):
    """Also where rings of few cells are divided among threads."""
    floor, options, barriers = draw(np.random.default_rng(seed))
    open_heights = [drop_barriers(*column) for column in zip(options, barriers, strict=True)]
    expected, rings = grow_plainly(floor, open_heights)
    with limit_threads(threads), patch.object(growth, "LEAST_CELLS", least):
        grown, ring = grow(floor, options, barriers)
    assert np.array_equal(grown, expected, equal_nan=True)
    assert np.array_equal(ring, rings)


def test_more_levels_than_their_numbers_can_tell_apart():
    surfaces = GrowingSurfaces(
        lattice=Lattice(0.0, 0.0, 0.1, 1, 1),
        first=np.zeros(1, dtype=np.int32),
        end=np.ones(1, dtype=np.int32),
        z=np.zeros(1),
        level=np.zeros(1, dtype=np.int16),
    )
    assert len(grow_levels(surfaces, growth.MAX_LEVELS, AgentSettings())) == growth.MAX_LEVELS
    with pytest.raises(SceneError, match="expected at most 32767 levels, got 32768: raise"):
        grow_levels(surfaces, growth.MAX_LEVELS + 1, AgentSettings())
