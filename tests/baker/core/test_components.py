"""Connected parts against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.baker.core.components import (
    find_row_runs,
    label_components,
    label_components_2d,
    list_adjacent_pairs,
)


@pytest.mark.parametrize("seed", range(40))
def test_parts_of_graphs_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    count, pairs = rng.integers(1, 40), rng.integers(0, 50)
    ends = rng.integers(0, count, (2, pairs))
    graph = coo_array((np.ones(pairs, dtype=bool), tuple(ends)), shape=(count, count))
    expected = connected_components(graph, directed=False)[1]
    np.testing.assert_array_equal(label_components(ends, count), expected)
    np.testing.assert_array_equal(label_components(ends.T.copy().T, count), expected)


@pytest.mark.parametrize("seed", range(40))
def test_parts_of_cells_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    mask = rng.random(rng.integers(1, 15, 2)) < rng.random()
    cells = np.flatnonzero(mask)
    label, _ = ndimage.label(mask, np.ones((3, 3)))
    part = label_components(list_adjacent_pairs(cells, mask.shape[1]), len(cells))
    np.testing.assert_array_equal(part, label.ravel()[cells] - 1)


def test_what_hangs_together_by_nothing_is_by_itself():
    assert label_components(np.empty((2, 0)), 3).tolist() == [0, 1, 2]
    # the last cell of a row and the first of the next don't touch
    assert list_adjacent_pairs(np.array([2, 3]), 3).size == 0


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (40, 63)])
def test_parts_over_edges_are_those_of_scipy(shape):
    rng = np.random.default_rng(4)
    for share in (0.0, 0.4, 0.6, 0.8, 1.0):
        mask = rng.random(shape) < share
        expected, count = ndimage.label(mask)
        found, num_cells = label_components_2d(mask)
        np.testing.assert_array_equal(num_cells[1:], np.bincount(expected.ravel())[1:])
        assert (len(num_cells), num_cells[0]) == (count + 1, 0)
        np.testing.assert_array_equal(found, expected)


def test_parts_of_one_value_are_apart_from_others():
    values = np.array([[1, 1, 2, 0], [1, 2, 2, 1], [0, 0, 1, 1]], dtype=np.int32)
    found, num_cells = label_components_2d(values)
    assert found.tolist() == [[1, 1, 2, 0], [1, 2, 2, 3], [0, 0, 3, 3]]
    assert num_cells.tolist() == [0, 3, 3, 3]


@pytest.mark.parametrize("seed", range(20))
def test_runs_stand_for_the_cells_of_an_array(seed):
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 3, rng.integers(1, 12, 2), dtype=np.int32)
    runs = find_row_runs(values)
    np.testing.assert_array_equal(runs.paint(runs.value, values.shape), values)
    counts = np.bincount(values.ravel(), minlength=3)
    assert runs.count_cells(runs.value, 3).tolist() == [0, *counts[1:]]
    ones = find_row_runs(np.where(values == 1, values, 0))
    twos = find_row_runs(np.where(values == 2, values, 0))
    for merged, expected in zip(twos.merged_with(ones), runs, strict=True):
        np.testing.assert_array_equal(merged, expected)


@pytest.mark.parametrize("seed", range(20))
def test_runs_touch_where_their_cells_do(seed):
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 3, rng.integers(1, 12, 2), dtype=np.int32)
    runs = find_row_runs(values)
    run_of_cell = runs.paint(np.arange(1, len(runs.row) + 1), values.shape)
    expected = set()
    for first, second in (
        (run_of_cell[:, :-1], run_of_cell[:, 1:]),
        (run_of_cell[:-1], run_of_cell[1:]),
    ):
        is_touching = (first > 0) & (second > 0) & (first != second)
        expected |= set(zip(first[is_touching] - 1, second[is_touching] - 1, strict=True))
    first_run, second_run = runs.list_touching()
    assert set(zip(first_run, second_run, strict=True)) == expected
    assert len(first_run) == len(expected)
