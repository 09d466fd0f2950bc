"""What labels tell, against plain oracles."""

import numpy as np
import pytest
from scipy import ndimage

from navbake.baker.rooms.kernels import labels as kernels
from navbake.baker.rooms.kernels.labels import (
    cells_of_nodes,
    find_passes,
    first_cells,
    label_parts,
    measure_regions,
    measure_slopes,
)


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (40, 63)])
def test_parts_are_those_of_scipy(shape):
    rng = np.random.default_rng(4)
    for share in (0.0, 0.4, 0.6, 0.8, 1.0):
        mask = rng.random(shape) < share
        expected, count = ndimage.label(mask)
        found, parts = label_parts(mask)
        assert parts == count
        np.testing.assert_array_equal(found, expected)


def test_cells_of_nodes():
    nodes = np.array([[0, 0, 0, 0, 0], [0, 1, 0, 0, 0], [2, 0, 0, 0, 3]], dtype=np.int32)
    assert cells_of_nodes(nodes).tolist() == [[1, 3]]


def test_regions_and_passes():
    label = np.array([[1, 1, 2], [0, 1, 2]], dtype=np.int32)
    distance = np.zeros((5, 7), dtype=np.int32)
    distance[1, 3] = 4  # the middle of cell (0, 1)
    distance[3, 3] = 7
    distance[2, 4] = 9  # the corner between the four cells at the right
    distance[3, 4] = 25  # the middle of the edge under it
    distance[4, 6] = 49  # only at cell (1, 2)
    cells, peaks, sums = measure_regions(label, distance, 2)
    assert cells.tolist() == [0, 3, 2]
    assert peaks.tolist() == [0, 25, 49]
    assert sums.tolist() == [0, 11, 0]
    pairs, saddles = find_passes(label, distance)
    assert pairs.tolist() == [[1, 2], [1, 2]]
    assert saddles.tolist() == [9, 25]


def test_slopes():
    label = np.array([[1, 1, 1, 1, 1, 2, 0, 2]], dtype=np.int32)
    floor = np.array([[0.0, 0.0, 0.5, 1.0, 1.0, 1.0, np.nan, 9.0]])
    steep, heights = measure_slopes(label, floor, 1, 0.75, 2)
    assert steep.tolist() == [0, 1, 0]  # 0.5 m on both sides of a step, and 1 m round it
    assert heights.tolist() == [0, 2.5, 10]
    steep, _ = measure_slopes(label.T.copy(), floor.T.copy(), 1, 0.5, 2)
    assert steep.tolist() == [0, 3, 0]


def test_first_cells():
    label = np.array([[0, 2, 2], [3, 0, 2]], dtype=np.int32)
    assert first_cells(label, 5).tolist() == [0, 6, 1, 3, 6]


@pytest.mark.parametrize("seed", range(20))
def test_fresh_cells_get_owners(seed):
    """Labels of open cells without an owner count; an owner that is there stays."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 12, 2))
    open_cells, label = rng.random(shape) < 0.7, rng.integers(0, 6, shape, dtype=np.int32)
    owner, under = (rng.integers(0, 2, shape, dtype=np.int32) * 9 for _ in range(2))
    fresh = np.where(open_cells & (owner == 0), label, 0)
    used = np.zeros(6, dtype=np.bool_)
    kernels.mark_fresh(open_cells, owner, label, used)
    is_used = np.bincount(fresh.ravel(), minlength=6) > 0
    np.testing.assert_array_equal(used[1:], is_used[1:])
    number = np.append(0, rng.permutation(5) + 20).astype(np.int32)
    expected = owner + number[fresh], under + np.where(under == 0, number[label], 0)
    kernels.give_fresh(open_cells, owner, label, number)
    kernels.note_under(under, label, number)
    np.testing.assert_array_equal(owner, expected[0])
    np.testing.assert_array_equal(under, expected[1])
    np.testing.assert_array_equal(
        kernels.count_cells(label, 7), np.bincount(label.ravel(), None, 7)
    )
