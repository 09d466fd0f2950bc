"""A flood gets from one cell to another exactly where both are on one island."""

from __future__ import annotations

import numpy as np
import pytest

from grid_maps import random_house
from navbake.runtime.kernels.arrays import Space
from navbake.runtime.kernels.flood import floods
from navbake.runtime.path_finder import PathFinder


@pytest.mark.parametrize("seed", range(12))
def test_it_joins_what_is_on_one_island(seed):
    rng = np.random.default_rng(seed)
    finder = PathFinder(random_house(rng, 1 + seed % 3, 0.65))
    flat, number = finder.search.flat, finder.islands.number
    space = Space(flat.layout, flat.links, flat.floors, flat.free)
    free = np.flatnonzero(flat.free)
    answers = set()
    for origin in rng.choice(free, 20):
        is_goal = np.zeros(flat.num_cells, dtype=np.bool_)
        is_goal[rng.choice(free, 2)] = True
        expected = bool((number[is_goal] == number[origin]).any())
        assert floods(space, int(origin), is_goal) == expected
        answers.add(expected)
    assert answers == {True, False}
