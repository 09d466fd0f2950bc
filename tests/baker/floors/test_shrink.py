"""Shrinking by asking neighbours, against the distance transform."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from navbake.baker.floors.kernels.shrink import east_rim, mark_inner, near_offsets


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("limit", [0.5, 1.0, 1.5, 3.2, 6.5, 20.0, 21.0])
def test_counts_what_a_distance_transform_leaves(seed, limit):
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, 40, 2)
    mask = ndimage.binary_opening(rng.random((height, width)) < 0.9, iterations=int(limit > 2))
    distance = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    expected = np.count_nonzero(mask & (distance >= limit))
    cells = np.flatnonzero(mask)
    cells = np.concatenate([cells, cells[::3]])  # some of them twice
    work, counted = (np.zeros(mask.size, dtype=bool) for _ in range(2))
    disc, inner = near_offsets(limit, int(min(height, width))), np.zeros(len(cells), dtype=bool)
    known = cells, disc, east_rim(disc), width, height
    found = mark_inner(*known, mask.size + 1, work, counted, inner)
    assert found == expected
    np.testing.assert_array_equal(inner, (distance >= limit).ravel()[cells])
    assert not work.any() and not counted.any()
    half, again = (expected + 1) // 2, np.zeros_like(inner)
    assert mark_inner(*known, half, work, counted, again) == half


def test_asks_far_neighbours_first():
    squares = (near_offsets(3.0, 10) ** 2).sum(axis=1)
    assert list(squares) == sorted(squares, reverse=True)
    assert squares.max() < 9 and squares.min() == 1


def test_a_limit_beyond_the_lattice_needs_few_steps():
    """`floors.shrink` in centimetres is a slip, and no reason to take all memory."""
    mask = np.ones(12 * 7, dtype=bool)
    for limit in (3.9, 4.0, 4.1, 1e7):
        offsets = near_offsets(limit, 7)
        assert len(offsets) < 100
        work, counted, inner = (np.zeros_like(mask) for _ in range(3))
        known = np.flatnonzero(mask), offsets, east_rim(offsets), 12, 7
        found = mark_inner(*known, 99, work, counted, inner)
        assert found == (6 if limit <= 4.0 else 0)  # the middle of the middle row
