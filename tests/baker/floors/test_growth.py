"""Floors go on under things ring by ring, in a region as they do on the whole lattice."""

from unittest.mock import patch

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from navbake.baker.blocks import Blocks
from navbake.baker.floors import growth
from navbake.baker.floors.growth import grow_in
from navbake.baker.floors.kernels.growth import Growing
from navbake.baker.floors.kernels.members import Labelled
from navbake.baker.floors.kernels.surfaces import Surfaces
from navbake.baker.kernels.constants import SLACK
from navbake.navgrid.lattice import Lattice
from navbake.threads import LEAST_CELLS, limit_threads

LATTICE = Lattice(0.0, 2.0, 0.1, 132, 3)  # five blocks beside each other
CELLS = LATTICE.width * LATTICE.height
STEP = 0.2
# multiples of a quarter: a step is met to the last bit, and some are equally near to two
HEIGHTS = np.arange(8) * 0.0625
seeds = st.integers(0, 2**32 - 1)


def draw(rng):
    """Floors where one can stand, and in the other cells the heights at which they may go on."""
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
            beside = [floor[other] for other in neighbours(cell) if not np.isnan(floor[other])]
            gaps = [(abs(z - near), z) for near in beside for z in options[cell]]
            gaps = [pair for pair in gaps if pair[0] <= STEP + SLACK]
            if gaps:
                new[cell] = min(gaps)[1]
        if not new:
            return floor, ring.astype(np.int32)
        for cell, z in new.items():
            floor[cell], ring[cell] = z, number


def grow(region, floor, ring, options):
    """Grow in the blocks of a region, where floors and rings of cells to stand on are known."""
    stands = [ring[cell] == 0 and not np.isnan(floor[cell]) for cell in range(CELLS)]
    heights = [floor[i : i + 1] if stands[i] else options[i] for i in range(CELLS)]
    length = np.array([len(one) for one in heights], dtype=np.int32)
    first, z = np.cumsum(length, dtype=np.int64) - length, np.concatenate(heights)
    none, marks = np.full(len(z), -1, dtype=np.int32), np.zeros(len(z), np.uint8)
    level = np.repeat(np.array(stands) - 1, length).astype(np.int32)
    normal, start = np.empty((len(z), 0), np.float32), np.zeros(Blocks(LATTICE).num, np.int64)
    surfaces = Surfaces(first, length, length, z, none, marks, normal)
    labelled = Labelled(LATTICE, first, length, z, none, none, start, none[:0])
    number = np.zeros(1, dtype=np.int64)
    option = np.empty(len(z), dtype=np.uint8)
    growing = Growing(surfaces, level, number, 0, 1.0, STEP, floor, ring, option)
    grow_in(Blocks(LATTICE), region, growing, labelled)


@settings(deadline=None)  # its kernels may be compiled first
@given(seeds, st.sampled_from([1, 8, LEAST_CELLS]), st.sampled_from([1, 2, 4]))
def test_floors_grow_as_ring_after_ring_of_all_cells(seed, least, threads):
    """Also where rings of few cells are divided among threads."""
    floor, options = draw(np.random.default_rng(seed))
    expected, rings = grow_plainly(floor, options)
    ring = np.where(np.isnan(floor), -1, 0).astype(np.int32)
    with limit_threads(threads), patch.object(growth, "LEAST_CELLS", least):
        grow(Blocks(LATTICE).all(), floor, ring, options)
    assert np.array_equal(floor, expected, equal_nan=True)
    assert np.array_equal(ring, rings)


@settings(deadline=None)
@given(seeds, st.integers(0, 4))
def test_a_region_is_decided_by_the_rings_around_it(seed, block):
    """Where its outermost cells come out as they were, what is outside stays; else it may not."""
    rng = np.random.default_rng(seed)
    known, options = draw(rng)
    floor, rings = grow_plainly(known, options)
    region = np.arange(Blocks(LATTICE).num) == block
    here = np.flatnonzero(Blocks(LATTICE).of(np.arange(CELLS)) == block)
    for cell in rng.choice(here, 3).tolist():
        known[cell] = rng.choice([np.nan, *HEIGHTS])
        options[cell] = rng.choice(HEIGHTS, int(np.isnan(known[cell])))
    expected, expected_rings = grow_plainly(known, options)
    before = floor.copy(), rings.copy()
    floor[here], rings[here] = known[here], np.where(np.isnan(known[here]), -1, 0)
    grow(region, floor, rings, options)
    col = here % LATTICE.width
    outer = here[(col == col.min()) | (col == col.max())]
    is_same = np.array_equal(floor[outer], before[0][outer], equal_nan=True)
    if is_same and np.array_equal(rings[outer], before[1][outer]):
        assert np.array_equal(floor, expected, equal_nan=True)
        assert np.array_equal(rings, expected_rings)
