"""Arrays of a report are what they were before they were packed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from navbake.views.report.packing import number_distinct, pack, to_steps
from report_pages import unpack


@pytest.mark.parametrize("smooth", [False, True])
@given(
    values=arrays.arrays(
        np.int64,
        arrays.array_shapes(min_dims=2, max_dims=2, max_side=6),
        elements=st.one_of(st.integers(-1, 300), st.integers(-1, 2**32 - 2)),
    )
)
def test_whole_numbers_come_back(values, smooth):
    np.testing.assert_array_equal(unpack(pack(values, smooth=smooth), values.shape), values)


@pytest.mark.parametrize(
    ("highest", "size"), [(0, 1), (254, 1), (255, 2), (65534, 2), (65535, 4), (2**32 - 2, 4)]
)
def test_numbers_take_as_few_bytes_as_hold_them(highest, size):
    assert pack(np.array([[-1, highest]]))["bytes"] == size


def test_metres_become_steps_above_the_lowest():
    steps, lowest = to_steps(np.array([[0.25, np.nan, -0.5, np.inf]]), 1e-3)
    assert (steps.tolist(), lowest) == ([[750, -1, 0, -1]], -0.5)
    steps, lowest = to_steps(np.array([[np.nan]]), 1e-3)
    assert (steps.tolist(), lowest) == ([[-1]], 0.0)


def test_distinct_values_are_numbered():
    number, values = number_distinct(np.array([[np.inf, 1.0], [10.0, 1.0]]))
    assert (number.tolist(), values) == ([[2, 0], [1, 0]], [1.0, 10.0, np.inf])
