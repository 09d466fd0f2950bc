"""Snapping goes to the nearest free place, on the right storey and not through walls."""

from __future__ import annotations

import math

import numpy as np
import pytest

import navbake.runtime.places
from grid_maps import house_from, level_from, random_house, room
from navbake.errors import QueryError
from navbake.runtime.path_finder import PathFinder


def random_finder(seed, **options):
    rng = np.random.default_rng(seed)
    return rng, PathFinder(random_house(rng, **options))


@pytest.mark.parametrize("seed", range(12))
def test_the_nearest_of_all_free_cells(seed):
    rng, finder = random_finder(seed, num_levels=1 + seed % 3, share=rng_share(seed))
    flat = finder.search.flat
    free = np.flatnonzero(flat.free)
    centers = flat.positions(free)
    levels = flat.level_of(free)
    for position in rng.uniform((-1.5, -2, -1), (4, 4, 6), size=(150, 3)):
        home = finder.cell_at(position)
        snapped = finder.snap(position)
        anywhere = finder.snap(position, same_level=False)
        if home is not None and finder.is_navigable(position):
            for found in (snapped, anywhere):
                np.testing.assert_array_equal(found[:2], position[:2])
                assert finder.is_navigable(found)
            continue
        in_space = np.linalg.norm(centers - position, axis=1)
        assert math.dist(anywhere, position) == pytest.approx(in_space.min())
        if home is None:
            np.testing.assert_array_equal(snapped, anywhere)
            continue
        on_map = np.linalg.norm((centers - position)[levels == home.level, :2], axis=1)
        if len(on_map):
            assert finder.cell_at(snapped).level == home.level
            assert math.dist(snapped[:2], position[:2]) == pytest.approx(on_map.min())
        else:
            assert snapped is None
        reach = rng.uniform(0, 0.3)
        found = finder.snap(position, max_distance=reach)
        assert (found is None) == (not len(on_map) or on_map.min() > reach)


def rng_share(seed):
    return [0.02, 0.2, 0.7][seed % 3]


@pytest.mark.parametrize("distance", [10.0, 1e4, 1e9])
def test_from_far_away(distance):
    finder = PathFinder(level_from("#....#\n######\n..####"))
    assert finder.snap((distance, 0.05, 0.0))[0] == pytest.approx(0.45)
    assert finder.snap((-distance, -0.25, 0.0))[0] == pytest.approx(0.05)


def test_from_farther_than_squares_can_hold():
    finder = PathFinder(level_from("...."))
    assert finder.is_navigable(finder.snap((1e200, 0.05, 0.0)))


def test_not_onto_furniture():
    finder = PathFinder(level_from("......\n.###..\n.###..\n......"))
    snapped = finder.snap((0.2, -0.17, 0.74))  # on the table
    assert finder.is_navigable(snapped)
    assert snapped[2] == 0.0


def two_storeys():
    """A void in the lower storey, right under free floor of the upper one."""
    lower = level_from("#######\n#####..\n#######")
    upper = level_from(".......\n.......\n.......", ground=0.6)
    return PathFinder(house_from([lower, upper]))


def test_not_onto_the_wrong_storey():
    finder = two_storeys()
    position = (0.05, -0.15, 0.3)  # nearer to the floor above than to the free cell beside
    np.testing.assert_allclose(finder.snap(position), (0.55, -0.15, 0.0))
    np.testing.assert_allclose(finder.snap(position, same_level=False), (0.05, -0.15, 0.6))
    np.testing.assert_allclose(finder.snap((0.05, -0.15), level=1), (0.05, -0.15, 0.6))
    np.testing.assert_allclose(finder.snap((0.05, -0.15, 0.9), level=0), (0.55, -0.15, 0.0))


def two_rooms(text):
    """Rooms left and right of column 5, the wall."""
    level = level_from(text)
    index = np.zeros(level.shape, dtype=np.uint16)
    index[1:-1, 1:5], index[1:-1, 6:-1] = 1, 2
    level.attributes["roomIndex"] = index
    return PathFinder(house_from([level], rooms=[room(0, 1, "left"), room(0, 2, "right")]))


def test_not_through_a_wall():
    """A table against the wall: the other room is nearer."""
    text = "\n".join(["###########", "#..###....#", "#..###....#", "#..###....#", "###########"])
    finder = two_rooms(text)
    position = (0.47, -0.25, 0.7)  # in column 4, which is table; the wall is column 5
    assert finder.snap(position)[0] == pytest.approx(0.65)
    assert finder.room_at(position) == "left"
    for options in ({"in_sight": True}, {"same_room": True}, {"room": "left"}):
        np.testing.assert_allclose(finder.snap(position, **options), (0.25, -0.25, 0.0))
    assert finder.snap(position, in_sight=True, max_distance=0.15) is None
    assert finder.snap(position, same_room=True, room="right") is None
    assert finder.snap((0.55, -0.25, 0.0), same_room=True) is None  # walls are in no room


def test_in_sight_without_rooms_comes_out_of_what_it_is_in_and_into_nothing_else():
    finder = PathFinder(level_from("##+#+..."))
    assert finder.snap((0.05, -0.05))[0] == pytest.approx(0.55)
    assert finder.snap((0.05, -0.05), in_sight=True) is None
    assert finder.snap((0.35, -0.05), in_sight=True)[0] == pytest.approx(0.55)
    assert finder.snap((0.25, -0.05), in_sight=True) is None


def test_what_a_larger_radius_takes_does_not_hide():
    finder = PathFinder(level_from(".+++++."))
    np.testing.assert_allclose(finder.snap((0.25, -0.05), in_sight=True), (0.05, -0.05, 0.0))


@pytest.mark.parametrize("seed", range(4))
def test_in_sight_is_the_nearest_of_those_that_dense_samples_see(seed, monkeypatch):
    monkeypatch.setattr(
        navbake.runtime.places, "FIRST_SIGHT_RADIUS", 0.06
    )  # so that it looks again
    rng, finder = random_finder(seed, num_levels=1, share=0.6)
    flat, occupied = finder.search.flat, finder.search.occupied
    free = np.flatnonzero(flat.free)
    for cell in rng.choice(np.flatnonzero(~flat.free & ~occupied), size=20):
        position = flat.positions(cell) + np.append(rng.uniform(-0.03, 0.03, size=2), 0)
        seen = [
            math.dist(p[:2], position[:2])
            for p in flat.positions(free)
            if finder.line_of_sight(position, p, level=0)
        ]
        found = finder.snap(position, in_sight=True)
        assert (found is None) == (not seen)
        if seen:
            assert math.dist(found[:2], position[:2]) == pytest.approx(min(seen))


def test_cells_without_floor_are_at_the_ground():
    lower, upper = level_from("#."), level_from("..", ground=2.0)
    lower.floor_height[0, 1] = np.nan
    finder = PathFinder(house_from([lower, upper]))
    np.testing.assert_allclose(
        finder.snap((0.05, -0.05, 0.1), same_level=False), (0.15, -0.05, 0.0)
    )


def test_a_place_in_something_is_not_in_sight():
    level = level_from("##")
    level.weights[0, 1] = 10.0  # as in others' files
    finder = PathFinder(level)
    assert finder.snap((0.05, -0.05), in_sight=True) is None
    assert finder.snap((0.05, -0.05)) is not None


def test_onto_an_island():
    finder = PathFinder(level_from("....#.#"))
    assert finder.snap((0.55, -0.05), island=1)[0] == pytest.approx(0.35)
    assert finder.snap((0.05, -0.05), island=2)[0] == pytest.approx(0.55)
    with pytest.raises(QueryError, match="no island 3: there are 1 to 2, 1 the largest"):
        finder.snap((0.05, -0.05), island=3)


def test_nothing_free_is_none():
    assert PathFinder(level_from("###")).snap((0.05, -0.05)) is None


@pytest.mark.parametrize(
    ("position", "options", "message"),
    [
        ((0.0, np.nan, 0.0), {}, "finite numbers, got 0, nan, 0"),
        ((0.0, 0.0, 0.0), {"max_distance": -1}, "max_distance >= 0 m, got -1"),
        ((0.0, 0.0, 0.0), {"max_distance": np.nan}, "max_distance >= 0 m, got nan"),
        ((0.0, 0.0), {}, "expected x, y, z or a level"),
        ((0.0, 0.0, 0.0), {"level": 2}, "no level 2"),
        ((0.0, 0.0, 0.0), {"room": "attic"}, "no room 'attic' in 'house': it has none"),
        (np.zeros((2, 3)), {"in_sight": True}, "expected one position"),
    ],
)
def test_wrong_questions_are_refused(position, options, message):
    with pytest.raises(QueryError, match=message):
        two_storeys().snap(position, **options)


@pytest.mark.parametrize("shape", [(40, 3), (3, 40), (1, 50), (50, 1)])
def test_on_a_level_that_is_much_longer_than_wide(shape):
    rng = np.random.default_rng(0)
    for number_free in (1, 2, 5):
        rows = np.full(shape[0] * shape[1], "#")
        rows[rng.choice(len(rows), number_free, replace=False)] = "."
        level = level_from("\n".join("".join(row) for row in rows.reshape(shape)))
        finder = PathFinder(level)
        flat = finder.search.flat
        centers = flat.positions(np.flatnonzero(flat.free))[:, :2]
        x0, y0, x1, y1 = level.lattice.bounds
        for position in rng.uniform((x0 - 1, y0 - 1), (x1 + 1, y1 + 1), size=(40, 2)):
            found = finder.snap(position)
            if not finder.is_navigable(position):
                nearest = np.linalg.norm(centers - position, axis=1).min()
                assert math.dist(found[:2], position) == pytest.approx(nearest)
