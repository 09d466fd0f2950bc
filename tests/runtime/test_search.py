"""Cheapest routes and fields of costs, against scipy on a graph made by plain loops."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from navbake.errors import QueryError
from navbake.runtime.search import FIRST_QUEUE_SIZE, Search
from oracles.ways import make_level, random_grid, stack, step_graph


def assert_is_route(found, origin, goals, graph):
    route, _, cost = found
    assert route[0] == origin
    assert route[-1] in goals
    steps = [graph[a, b] for a, b in pairwise(route)]
    assert 0 not in steps
    assert cost == pytest.approx(sum(steps), rel=1e-8)


@pytest.mark.parametrize("cut_corners", [False, True])
@pytest.mark.parametrize("seed", range(40))
def test_routes_and_fields_equal_scipy(seed, cut_corners):
    rng = np.random.default_rng(seed)
    grid = random_grid(rng, weighted=seed % 4 > 0)
    search = Search(grid, cut_corners=cut_corners)
    free = np.flatnonzero(search.flat.free)
    if not len(free):
        return
    graph = step_graph(grid, cut_corners=cut_corners)
    goals = np.unique(rng.choice(free, rng.integers(1, 4)))
    exact = dijkstra(graph, indices=free)
    for origin in rng.choice(free, 4):
        expected = exact[np.searchsorted(free, origin), goals].min()
        found = search.find_route(origin, goals)
        if np.isinf(expected):
            assert found is None
        else:
            assert_is_route(found, origin, goals, graph)
            assert found.cost == pytest.approx(expected, rel=1e-8, abs=1e-12)
    field, onward = search.find_next_cells(goals)
    np.testing.assert_array_equal(field, search.compute_cost_field(goals))
    assert np.isinf(field[~search.flat.free]).all()
    np.testing.assert_allclose(field[free], exact[:, goals].min(axis=1), rtol=1e-8, atol=1e-12)
    assert (onward[goals] == goals).all() and (onward[np.isinf(field)] == -1).all()
    for cell in np.flatnonzero(np.isfinite(field) & (field > 0)):
        rest = graph[cell, onward[cell]] + field[onward[cell]]
        assert field[cell] == pytest.approx(rest, rel=1e-8)


@pytest.mark.parametrize("seed", range(20))
def test_fields_of_lengths_leave_weights_out(seed):
    rng = np.random.default_rng(seed)
    grid = random_grid(rng)
    search = Search(grid)
    free = np.flatnonzero(search.flat.free)
    for level in grid.levels:
        level.weights[level.free] = 1.0
    goals = rng.choice(free, 1)
    exact = dijkstra(step_graph(grid), indices=free)[:, goals[0]]
    np.testing.assert_allclose(
        search.compute_cost_field(goals, by="length")[free], exact, rtol=1e-8, atol=1e-12
    )


def test_weights_far_apart_stay_exact():
    rng = np.random.default_rng(0)
    weights = 10.0 ** rng.integers(-3, 8, (12, 12))
    grid = make_level(np.ones((12, 12)), np.zeros((12, 12)), weights)
    search = Search(grid)
    exact = dijkstra(step_graph(grid), indices=np.arange(144))
    np.testing.assert_allclose(search.compute_cost_field(np.array([77])), exact[:, 77], rtol=1e-8)
    for origin in range(0, 144, 13):
        cost = search.find_route(origin, np.array([77])).cost
        assert cost == pytest.approx(exact[origin, 77], rel=1e-8)


def test_a_field_of_more_goals_than_there_is_room_for_at_first():
    free = np.ones((300, 300), dtype=bool)
    free[::2, 1::2] = False
    search = Search(make_level(free, np.zeros(free.shape)))
    goals = np.flatnonzero(free)
    assert len(goals) > FIRST_QUEUE_SIZE
    field = search.compute_cost_field(goals)
    assert not field[goals].any()
    assert np.isinf(field[np.flatnonzero(~free)]).all()


def test_a_route_that_opens_more_cells_than_there_is_room_for_at_first():
    """Weights as far apart as these open most of the grid before the goal is reached."""
    rng = np.random.default_rng(0)
    shape = (700, 700)
    weights = 10.0 ** rng.uniform(0, 4, shape)
    search = Search(make_level(np.ones(shape), np.zeros(shape), weights))
    goal = np.array([weights.size - 1])
    assert search.find_route(0, goal).cost == pytest.approx(
        search.compute_cost_field(goal)[0], rel=1e-8
    )


def test_searches_may_be_counted_from_one_again(monkeypatch):
    grid = make_level([[1, 1, 1]], [[0, 0, 0]])
    search = Search(grid)
    monkeypatch.setattr("navbake.runtime.search.LAST_SEARCH", 2)
    for _ in range(6):
        assert search.find_route(0, np.array([2]))[0].tolist() == [0, 1, 2]
        assert search.find_route(2, np.array([0]))[0].tolist() == [2, 1, 0]


def test_a_link_may_be_the_only_way():
    lower, upper = make_level([[1, 1, 0, 1]], np.zeros((1, 4))), make_level([[1]], [[0.0]], col0=2)
    grid = stack([lower, upper], [[0, 1, 1, 0], [0, 3, 1, 0]])
    search = Search(grid)
    route, _, cost = search.find_route(0, np.array([3]))
    assert route.tolist() == [0, 1, 4, 3]
    assert cost == pytest.approx(0.3)


def test_negative_weights_are_refused():
    grid = make_level([[1, 1]], [[0, 0]], np.array([[1.0, -2.0]]))
    with pytest.raises(QueryError, match="weights >= 0, got -2"):
        Search(grid)
