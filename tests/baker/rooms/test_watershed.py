"""The kernels behind the rooms, against plain oracles."""

import numpy as np
import pytest
from scipy import ndimage

from navbake.baker.rooms.distances import squared_distances
from navbake.baker.rooms.kernels.watershed import flood


@pytest.mark.parametrize("reach", [0, 1, 7, 40])
@pytest.mark.parametrize("shape", [(1, 1), (3, 300), (70, 41)])
def test_distances_are_those_of_scipy(reach, shape):
    rng = np.random.default_rng(reach)
    for share in (0.0, 0.001, 0.02, 0.5):
        target = rng.random(shape) < share
        expected = np.full(shape, (reach + 1) ** 2)
        if target.any():
            exact = np.rint(ndimage.distance_transform_edt(~target) ** 2)
            expected = np.minimum(exact, expected)
        np.testing.assert_array_equal(squared_distances(target, reach, 0, 1), expected)
        np.testing.assert_array_equal(squared_distances(target, reach, 1, 2), expected[1::2])


def fill(labels, heights):
    label = np.array(labels, dtype=np.int32)
    height = np.array(heights, dtype=np.int32)
    fillable = label >= 0
    label[~fillable] = 0
    flood(label, fillable, height, int(height.max()))
    return label.tolist()


def test_the_highest_is_filled_first():
    # from the right over the high cells, before the left one gets down to the low cell
    assert fill([[1, 0, 0, 0, 2]], [[9, 1, 5, 5, 9]]) == [[1, 1, 2, 2, 2]]
    assert fill([[1, 0, 0, 0, 2]], [[9, 5, 5, 1, 9]]) == [[1, 1, 1, 2, 2]]


def test_on_a_level_the_nearer_seed_fills():
    assert fill([[1, 0, 0, 0, 0, 2]], [[9, 3, 3, 3, 3, 9]]) == [[1, 1, 1, 2, 2, 2]]


def test_a_tie_goes_to_the_lower_label():
    assert fill([[2, 0, 1]], [[9, 3, 9]]) == [[2, 1, 1]]
    assert fill([[1, 0, 2]], [[9, 3, 9]]) == [[1, 1, 2]]


def test_what_is_climbed_to_is_filled_at_once():
    assert fill([[1, 0, 0, 0, 0]], [[9, 2, 7, 1, 1]]) == [[1, 1, 1, 1, 1]]


def test_nothing_is_filled_beyond_walls_or_over_corners():
    assert fill([[1, 0, -1, 0], [0, -1, 0, 0]], np.full((2, 4), 3)) == [[1, 1, 0, 0], [1, 0, 0, 0]]
