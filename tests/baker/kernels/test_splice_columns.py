"""Columns of which some are replaced, against lists of lists."""

import numpy as np
import pytest

from navbake.baker.columns import empty_crossings
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.cracks import splice_columns
from navbake.threads import run_in_bands


def random_columns(rng, count):
    """Columns of 0 to 3 crossings each, some of them empty."""
    start = np.concatenate([[0], np.cumsum(rng.integers(0, 4, count))])
    num = start[-1]
    normal = rng.normal(size=(num, 3)).astype(np.float32)
    geom, closed = rng.integers(0, 9, num), rng.integers(0, 4, num)
    return Crossings(
        start, rng.normal(size=num), normal, geom.astype(np.int32), closed.astype(np.uint8)
    )


def column(crossings, i):
    return [part[crossings.start[i] : crossings.start[i + 1]].tolist() for part in crossings[1:]]


@pytest.mark.parametrize("seed", range(40))
def test_some_columns_are_replaced(seed):
    """The first and the last cell, neighbours, all or none may be replaced."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 60))
    cells = np.flatnonzero(rng.random(count) < rng.choice([0.0, 0.1, 0.5, 1.0]))
    old, new = random_columns(rng, count), random_columns(rng, len(cells))
    counts = np.diff(old.start)
    counts[cells] = np.diff(new.start)
    start = np.concatenate([[0], np.cumsum(counts)])
    found = empty_crossings(start, int(start[-1]))
    run_in_bands(splice_columns, count, old, new, cells, found)
    number = {int(cell): k for k, cell in enumerate(cells)}
    for cell in range(count):
        expected = column(new, number[cell]) if cell in number else column(old, cell)
        assert column(found, cell) == expected
