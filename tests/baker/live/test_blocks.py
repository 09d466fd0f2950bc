"""What hangs together block by block hangs together as a whole."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from navbake.baker.connect import connect
from navbake.baker.kernels.constants import SLACK
from navbake.baker.lattice import EDGES
from navbake.baker.live.kernels import blocks as kernels
from navbake.baker.live.kernels.blocks import EDGE, Blocks
from navbake.baker.live.kernels.pool import Pool
from navbake.navgrid.lattice import Lattice

LATTICE = Lattice(0.0, 4.0, 0.1, 2 * EDGE + 9, EDGE + 5)
SHAPE = LATTICE.height, LATTICE.width
STEP = 0.2


def make_pool(height):
    """Columns with a surface of sheet 7 where there is a height, and one of sheet 3 below it."""
    cells, (num,) = np.arange(height.size), height.ravel().shape
    z = np.stack([height.ravel() - 1.0, height.ravel()], axis=1).ravel()
    sheet = np.tile(np.array([3, 7], dtype=np.int32), num)
    sheet[1::2][np.isnan(height.ravel())] = -1
    length = np.full(num, 2, dtype=np.int32)
    zeros = np.zeros(2 * num, dtype=np.uint8)
    normal, geom = np.zeros((2 * num, 3), dtype=np.float32), np.zeros(2 * num, dtype=np.int32)
    return Pool(2 * cells, length, length, z, normal, geom, zeros, zeros, sheet)


def find_wholes(height):
    """The connected part of each cell, by all pairs of neighbours; -1 where there is no height."""
    cell = np.arange(height.size).reshape(SHAPE)
    pairs = []
    for one, other in EDGES:
        meet = np.abs(height[one] - height[other]) <= STEP + SLACK
        pairs.append(np.stack([cell[one][meet], cell[other][meet]]))
    part = connect(np.concatenate(pairs, axis=1), height.size)
    return np.where(np.isnan(height.ravel()), -1, part)


def label(pool, blocks, cells):
    own, around = kernels.list_blocks(LATTICE, cells)
    kernels.label_blocks(LATTICE, pool, 7, STEP, blocks, own, 0, len(own))
    kernels.meet_at_borders(LATTICE, STEP, blocks, around)


@settings(deadline=None)  # its kernels may be compiled first
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.6))
def test_parts_of_blocks_join_to_wholes(seed, holes):
    rng = np.random.default_rng(seed)
    height = np.where(rng.random(SHAPE) < holes, np.nan, 0.0)
    height[rng.random(SHAPE) < 0.2] = rng.choice([0.1, 0.3, 0.5])
    blocks = Blocks.empty(LATTICE.width, LATTICE.height)
    label(make_pool(height), blocks, np.arange(height.size))
    for changed in (0, 1, 40):  # then some cells are others, and only their blocks are looked at
        cells = np.unique(rng.integers(0, height.size, changed))
        height.ravel()[cells] = rng.choice([0.0, 0.15, np.nan], len(cells))
        label(make_pool(height), blocks, cells)
        first, whole, size = kernels.join_parts(LATTICE, blocks)
        expected = find_wholes(height)
        names = np.unique(expected[expected >= 0])
        assert len(size) == len(names)
        found = [kernels.cells_of_whole(LATTICE, blocks, first, whole, k) for k in range(len(size))]
        assert [len(part) for part in found] == size.tolist()
        parts = {tuple(np.sort(part).tolist()) for part in found}
        assert parts == {tuple(np.flatnonzero(expected == name).tolist()) for name in names}
