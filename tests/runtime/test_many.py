"""Questions about many positions: each answer is that of `PathFinder` about one, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from grid_maps import level_from, random_house
from navbake.errors import QueryError
from navbake.runtime.path_finder import PathFinder

LEVEL = "#....#\n######\n..####"


def finder_and_positions(seed, count=60):
    rng = np.random.default_rng(seed)
    share = [0.02, 0.2, 0.7][seed % 3]
    finder = PathFinder(random_house(rng, num_levels=1 + seed % 3, share=share))
    return rng, finder, rng.uniform((-1.5, -2, -1), (4, 4, 6), size=(count, 3))


def same(found, expected):
    expected = [np.full(3, np.nan) if one is None else one for one in expected]
    np.testing.assert_array_equal(found, np.array(expected).reshape(np.shape(found)))


@pytest.mark.parametrize("seed", range(3))
def test_places_are_those_of_one_by_one(seed):
    rng, finder, positions = finder_and_positions(seed)
    more = ({}, {"same_level": False}, {"level": 0}, {"max_distance": 0.2}, {"island": 1})
    for options in more:
        found = finder.many.snap(positions, **options)
        same(found, [finder.snap(position, **options) for position in positions])
    inside = np.array([p for p in positions if finder.cell_at(p) is not None])
    for options in ({}, {"max_distance": 0.15}):
        expected = [finder.clearance(position, **options) for position in inside]
        np.testing.assert_array_equal(finder.many.clearance(inside, **options), expected)
    starts = finder.random_point(rng, 60, anywhere=True)
    ends = starts + rng.normal(size=starts.shape)
    ends[0] = (1e9, 0, 0)
    for slide in (True, False):
        expected = [finder.try_step(a, b, slide=slide) for a, b in zip(starts, ends, strict=True)]
        same(finder.many.try_step(starts, ends, slide=slide), expected)
        expected = [finder.try_step(a, ends[1], slide=slide) for a in starts]
        same(finder.many.try_step(starts, ends[1], slide=slide), expected)


def test_snap_on_one_level_takes_x_and_y():
    finder = PathFinder(level_from(LEVEL))
    places = np.random.default_rng(1).uniform(-2, 2, size=(4, 5, 2))
    found = finder.many.snap(places)
    assert found.shape == (4, 5, 3)
    same(found, [finder.snap(place) for place in places.reshape(-1, 2)])


def test_find_path():
    rng, finder, _ = finder_and_positions(1)
    starts, goals = finder.random_point(rng, 12), finder.random_point(rng, 12)
    goals[3] = (100, 0, 0)
    found = finder.many.find_path(starts, goals)
    assert found[3] is None
    for path, start, goal in zip(found, starts, goals, strict=True):
        alone = finder.find_path(start, goal)
        assert (path is None) == (alone is None)
        if path is not None:
            np.testing.assert_array_equal(path.positions, alone.positions)
    to_one = finder.many.find_path(starts, goals[0], smooth=False)
    costs = [np.inf if path is None else path.cost for path in to_one]
    np.testing.assert_allclose(costs, finder.distances(starts, goals[0]), rtol=1e-5)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda m, p: m.clearance([p, (9, 0, 0)]), "9, 0, 0 lies beside the grid"),
        (lambda m, p: m.try_step([p, (9, 0, 0)], p), "no agent can stand at 9, 0, 0"),
        (lambda m, p: m.try_step([p, p], [p] * 3), r"end for each start, \(2,\) of them, got \(3,"),
        (lambda m, p: m.find_path(p, p), r"starts of shape \(n, 3\)"),
        (lambda m, p: m.find_path([p, p], [p] * 3), r"goals of shape \(2, 3\) .* shape \(3, 3\)"),
        (lambda m, p: m.snap([p, (np.nan, 0, 0)]), "finite"),
    ],
)
def test_what_is_wrong_is_named(ask, message):
    finder = PathFinder(level_from(LEVEL))
    with pytest.raises(QueryError, match=message):
        ask(finder.many, finder.random_point())


def test_no_positions_are_no_answers():
    many, none = PathFinder(level_from(LEVEL)).many, np.empty((0, 3))
    assert many.snap(none).shape == (0, 3)
    assert many.clearance(none).shape == (0,)
    assert many.try_step(none, (0, 0, 0)).shape == (0, 3)
    assert many.find_path(none, (0, 0, 0)) == []


def test_without_a_generator_places_are_random():
    finder = PathFinder(level_from("......\n......\n......"))
    places = np.stack([finder.random_point() for _ in range(30)])
    assert len(np.unique(places, axis=0)) > 1
    assert finder.random_point(count=4).shape == (4, 3)
    assert finder.random_point_near(None, places[0], 0.3).shape == (3,)
    assert finder.random_pose().position.shape == (3,)
