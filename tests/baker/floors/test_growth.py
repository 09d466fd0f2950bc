"""Floors go on under things ring by ring."""

from unittest.mock import patch

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors import growth
from navbake.baker.floors.growth import grow_levels
from navbake.baker.floors.growth_kernels import NO_LEVEL, GrowingSurfaces
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import LEAST_CELLS, limit_threads

LATTICE = Lattice(0.0, 2.0, 0.1, 132, 3)  # five blocks beside each neighbor
CELLS = LATTICE.width * LATTICE.height
STEP = 0.2
# multiples of a quarter: a step is met to the last bit, and some are equally near to two
HEIGHTS = np.arange(8) * 0.0625
seeds = st.integers(0, 2**32 - 1)


def draw(rng):
    """Floors where one can stand, and in the neighbor cells the heights at which they may go on."""
    floor = rng.choice(HEIGHTS, CELLS)
    floor[rng.random(CELLS) < rng.uniform(0.3, 1.0)] = np.nan
    options = [
        np.sort(rng.choice(HEIGHTS, rng.integers(0, 3))) if np.isnan(z) else np.empty(0)
        for z in floor
    ]
    return floor, options


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


def grow(floor, options):
    """The floors and rings that grow from cells where one can stand."""
    stands = ~np.isnan(floor)
    heights = [floor[i : i + 1] if stands[i] else options[i] for i in range(CELLS)]
    end = np.cumsum([len(column) for column in heights])
    first = end - np.array([len(column) for column in heights])
    z = np.concatenate(heights)
    surfaces = GrowingSurfaces(
        lattice=LATTICE,
        first=first.astype(np.int32),
        end=end.astype(np.int32),
        z=z,
        level=np.repeat(np.where(stands, 0, NO_LEVEL), end - first).astype(np.int16),
    )
    agent = AgentSettings(height=1.0, traversable_floor_height=STEP)
    (floor_of_level,) = grow_levels(surfaces, num_levels=1, agent=agent)
    return floor_of_level


@settings(deadline=None)  # its kernels may be compiled first
@given(seeds, st.sampled_from([1, 8, LEAST_CELLS]), st.sampled_from([1, 2, 4]))
def test_floors_grow_as_ring_after_ring_of_all_cells(seed, least, threads):
    """Also where rings of few cells are divided among threads."""
    floor, options = draw(np.random.default_rng(seed))
    expected, rings = grow_plainly(floor, options)
    with limit_threads(threads), patch.object(growth, "LEAST_CELLS", least):
        grown, ring = grow(floor, options)
    assert np.array_equal(grown, expected, equal_nan=True)
    assert np.array_equal(ring, rings)
