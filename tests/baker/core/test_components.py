"""Connected parts against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.baker.core.components import label_components, label_components_2d, list_adjacent_pairs


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
