"""Shrinking by a disc, against the distance transform."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from kernel_parts import callable_part
from navbake.baker.core.area_test import AreaTest, disc_half_widths, is_large_enough
from navbake.baker.floors import region_kernels
from navbake.config.settings import FloorSettings
from navbake.navgrid.lattice import Lattice

shrink = callable_part(region_kernels.shrink)


def count(mask, limit):
    half_widths = disc_half_widths(limit, int(min(mask.shape)))
    remaining = np.empty_like(mask)
    radius = len(half_widths) // 2
    shrink(np.pad(mask, radius).astype(np.int32), AreaTest(0, radius, half_widths), remaining)
    return remaining.sum()


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("limit", [0.5, 1.0, 1.5, 3.2, 6.5, 20.0, 21.0])
def test_counts_what_a_distance_transform_leaves(seed, limit):
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, 40, 2)
    mask = ndimage.binary_opening(rng.random((height, width)) < 0.9, iterations=int(limit > 2))
    distance = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    expected = np.count_nonzero(mask & (distance >= limit))
    assert count(mask, limit) == expected
    lattice = Lattice.cover((0.0, 0.0, width, height), 1.0)
    for needed in (expected, expected + 1):
        settings = FloorSettings(min_area=needed, shrink=limit - 0.5)
        assert is_large_enough(lattice, settings, mask) == (needed <= expected)


def test_a_disc_is_as_wide_as_its_limit():
    assert disc_half_widths(3.0, 10).tolist() == [2, 2, 2, 2, 2]
    assert disc_half_widths(3.2, 10).tolist() == [1, 2, 3, 3, 3, 2, 1]
    assert disc_half_widths(1.0, 10).tolist() == [0]


def test_a_limit_beyond_the_lattice_needs_few_steps():
    """`floors.shrink` in centimetres is a slip, and no reason to take all memory."""
    mask = np.ones((12, 7), dtype=bool)
    for limit in (3.9, 4.0, 4.1, 1e7):
        assert len(disc_half_widths(limit, 7)) < 100
        # the middle of the middle row
        assert count(mask, limit) == (6 if limit <= 4.0 else 0)
