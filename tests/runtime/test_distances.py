"""Distances from many starts to many goals: those of scipy's Dijkstra on the same graph."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from grid_maps import level_from, random_house
from navbake import PathFinder, tensors
from navbake.errors import QueryError


@pytest.mark.parametrize("seed", range(4))
def test_distances_are_those_of_dijkstra(seed):
    """Over two or three levels, steps and links."""
    rng = np.random.default_rng(seed)
    house = random_house(rng, num_levels=2 + seed % 2)
    graph, finder = house.to_graph(), PathFinder(house)
    starts, goals = (rng.choice(len(graph.cell), size) for size in (60, 12))
    expected = dijkstra(graph.matrix, indices=starts)[:, goals]
    p, q = graph.position[starts], graph.position[goals]
    for weighted in (False, True):  # all weights are 1
        found = finder.distances(p, goals=list(q), weighted=weighted)
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert np.isinf(expected).any() and (graph.level[starts[:, None]] != graph.level[goals]).any()
    one_by_one = np.stack([finder.distances(p, goal) for goal in q], axis=-1)
    np.testing.assert_array_equal(found, one_by_one)
    t = house.tensors(goals=list(q), dtype="float64")
    np.testing.assert_allclose(tensors.distances(t, p), expected, rtol=1e-6)
    some = tensors.distances(t, p.reshape(3, 20, 3), [7, 0, 99])
    np.testing.assert_array_equal(some[..., :2], found.reshape(3, 20, -1)[..., [7, 0]])
    assert some.shape == (3, 20, 3) and np.isnan(some[..., 2]).all()
    beside = tensors.distances(t, np.array([99.0, 99.0, 0.0]))
    assert beside.shape == (12,) and np.isnan(beside).all()


def test_shapes_and_what_a_goal_may_be():
    finder = PathFinder(level_from("....\n.##.\n...."))
    starts = np.array([[[0.05, -0.05], [0.35, -0.25]], [[9.0, 9.0], [0.15, -0.15]]])
    goals = [(0.05, -0.05), [(0.05, -0.25), (0.35, -0.05)]]
    found = finder.distances(starts, goals=goals)
    assert found.shape == (2, 2, 2)
    np.testing.assert_allclose(found[0], [[0.0, 0.2], [0.5, 0.2]])
    assert np.isinf(found[1, 0]).all()  # beside the grid
    assert finder.distances(starts, goals=[]).shape == (2, 2, 0)
    with pytest.raises(QueryError, match="no room 'hall'"):
        finder.distances(starts, goals=["room:hall"])
    for given in ({}, {"goal": goals[0], "goals": goals}):
        with pytest.raises(QueryError, match="a goal, or goals="):
            finder.distances(starts, **given)
