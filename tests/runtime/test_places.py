"""Places, one and many: can an agent stand there, what is in sight, how far is what stands."""

from __future__ import annotations

import math

import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from, random_house
from navbake.errors import QueryError
from navbake.navgrid.cells import Cell, cell_at
from navbake.runtime.path_finder import PathFinder
from project_paths import GOLDEN


@pytest.mark.parametrize("seed", range(6))
def test_many_as_one_by_one_by_the_rule(seed):
    rng = np.random.default_rng(seed)
    house = random_house(rng, num_levels=1 + seed % 3, share=0.7)
    finder = PathFinder(house)
    positions = rng.uniform((-1.5, -2, -1), (3, 3, 6), size=(1500, 3))
    found = finder.is_navigable(positions)
    assert found.dtype == np.bool_ and found.any() and not found.all()
    for position, answer in zip(positions, found, strict=True):
        cell = cell_at(house, position)
        expected = False
        if cell is not None:
            level = house.levels[cell.level]
            floor = float(level.floor_height[cell.row, cell.col])
            expected = bool(level.free[cell.row, cell.col]) and position[2] - floor <= 0.5
        assert answer == expected == finder.is_navigable(position)
    on_level = finder.is_navigable(positions, level=0)
    rows, cols = house.levels[0].lattice.rows_cols(positions)
    inside = (rows >= 0) & (rows < house.levels[0].height) & (cols >= 0)
    inside &= cols < house.levels[0].width
    np.testing.assert_array_equal(on_level[~inside], False)
    np.testing.assert_array_equal(
        on_level[inside], house.levels[0].free[rows[inside], cols[inside]]
    )


def test_more_than_a_block_and_any_shape_and_dtype():
    finder = PathFinder(level_from(".#" * 10))
    x = np.tile(np.arange(20) * 0.1 + 0.05, 100)
    positions = np.stack([x, np.full(2000, -0.05), np.zeros(2000)], axis=1)
    expected = np.tile([True, False], 1000)
    np.testing.assert_array_equal(finder.is_navigable(positions), expected)
    shaped = finder.is_navigable(positions.reshape(4, 500, 3))
    np.testing.assert_array_equal(shaped, expected.reshape(4, 500))
    np.testing.assert_array_equal(finder.is_navigable(positions.astype(np.float32)), expected)
    np.testing.assert_array_equal(finder.is_navigable(positions[:, :2]), expected)
    np.testing.assert_array_equal(finder.is_navigable(positions[::-1]), expected[::-1])
    assert finder.is_navigable(np.empty((0, 3))).shape == (0,)


def test_free_cells_without_floor_stand_on_the_ground():
    level = level_from("..", ground=1.0)
    level.floor_height[0, 1] = np.nan
    finder = PathFinder(level)
    assert finder.is_navigable((0.15, -0.05, 1.0))
    assert finder.is_navigable((0.15, -0.05, 1.45))
    assert not finder.is_navigable((0.15, -0.05, 1.6))
    assert finder.is_navigable((0.15, -0.05, 1.6), max_drop=1.0)
    assert not finder.is_navigable((0.15, -0.05, 0.5))


@pytest.mark.parametrize("at", [0, 700, 1499])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_position_that_is_none_is_named(at, value):
    positions = np.zeros((1500, 3))
    positions[at] = 1.0, value, 2.0
    with pytest.raises(QueryError, match=rf"finite numbers, got 1, {value}, 2"):
        PathFinder(level_from("..")).is_navigable(positions)


@pytest.mark.parametrize("seed", range(8))
def test_as_all_squares_say(seed):
    rng = np.random.default_rng(seed)
    house = random_house(rng, num_levels=1 + seed % 2, share=[0.5, 0.95, 0.995][seed % 3])
    finder = PathFinder(house)
    for number, level in enumerate(house.levels):
        x0, y0, x1, y1 = level.lattice.bounds
        rows, cols = np.nonzero(level.occupancy)
        centers = level.lattice.positions(rows, cols)
        for point in rng.uniform((x0, y0), (x1, y1), size=(60, 2)):
            found = finder.nearest_obstacle(point, level=number)
            if not len(centers):
                assert found is None
                continue
            beside = np.maximum(np.abs(centers - point) - 0.05, 0.0)
            distance = np.hypot(*beside.T).min()
            assert found.distance == pytest.approx(distance, abs=1e-12)
            assert math.dist(found.position[:2], point) == pytest.approx(distance, abs=1e-9)
            assert finder.clearance(point, level=number) == found.distance
            reach = rng.uniform(0, 0.3)
            limited = finder.nearest_obstacle(point, level=number, max_distance=reach)
            assert (limited is None) == (distance > reach)
            found = finder.clearance(point, level=number, max_distance=reach)
            assert found == pytest.approx(min(distance, reach), abs=1e-12)


def test_point_and_distance():
    finder = PathFinder(level_from("......\n....#.\n......"))
    found = finder.nearest_obstacle((0.05, -0.12, 0.0))
    assert found.distance == pytest.approx(0.35)
    np.testing.assert_allclose(found.position, (0.4, -0.12, 0.0))
    assert finder.clearance((0.45, -0.15)) == 0.0


def test_a_larger_radius_moves_no_obstacle_and_live_ones_count():
    finder = PathFinder(level_from(".+++#..."))
    assert finder.clearance((0.05, -0.05)) == pytest.approx(0.35)
    with finder.grid.block(cells=Cell(0, 0, 7)):
        assert finder.clearance((0.65, -0.05)) == pytest.approx(0.05)
    assert finder.clearance((0.65, -0.05)) == pytest.approx(0.15)


def test_where_another_level_goes_on_there_is_no_obstacle():
    lower = level_from("....##")
    lower.floor_height[0, :4] = (0.0, 0.25, 0.5, 0.75)
    lower.floor_height[0, 4:] = np.nan
    upper = level_from("    ....#", ground=1.0)
    finder = PathFinder(house_from([lower, upper], [((0, 0, 3), (1, 0, 4))]))
    assert finder.clearance((0.35, -0.05, 0.75), max_distance=5.0) == 5.0
    assert finder.clearance((0.45, -0.05, 1.0)) == pytest.approx(0.35)
    lower.floor_height[0, 4] = 1.0  # a wall on the floor that one stands on stays one
    finder = PathFinder(house_from([lower, upper]))
    assert finder.clearance((0.35, -0.05, 0.75)) == pytest.approx(0.05)
    lower.floor_height[0, 4] = np.nan
    upper.occupancy[0, 4] = 1  # now the wall of the upper level is in the way
    upper.weights[0, 4] = np.inf
    finder = PathFinder(house_from([lower, upper]))
    assert finder.clearance((0.35, -0.05, 0.75)) == pytest.approx(0.05)


@pytest.mark.parametrize("name", ["apartment", "clutter", "house"])
def test_no_obstacle_is_nearer_to_a_free_center_than_the_radius(name):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    for radius in (0.12, 0.3):
        finder = PathFinder(grid.inflate(radius))
        flat = finder.search.flat
        for position in flat.positions(np.flatnonzero(flat.free)[::5]):
            assert finder.clearance(position) >= radius - 1e-9


def test_beside_the_grid_there_is_no_answer():
    finder = PathFinder(level_from("..#"))
    with pytest.raises(QueryError, match="9, 0, 0 lies beside the grid"):
        finder.clearance((9.0, 0.0, 0.0))
    with pytest.raises(QueryError, match="max_distance >= 0"):
        finder.nearest_obstacle((0.05, -0.05), max_distance=-1)


@pytest.mark.parametrize("seed", range(10))
def test_as_dense_samples_say(seed):
    rng = np.random.default_rng(seed)
    house = random_house(rng, num_levels=1, share=0.9, size=(20, 40))
    finder = PathFinder(house)
    level = house.levels[0]
    x0, y0, x1, y1 = level.lattice.bounds
    ends = rng.uniform((x0, y0), (x1, y1), size=(300, 2, 2))
    seen = 0
    for a, b in ends:
        points = a + np.linspace(0, 1, 4000)[:, None] * (b - a)
        rows, cols = level.lattice.rows_cols(points)
        expected = not level.occupancy[rows, cols].any()
        assert finder.line_of_sight(a, b) == expected == finder.line_of_sight(b, a)
        seen += expected
    assert 20 < seen < 280


def test_a_corner_is_passed_where_one_side_is_clear():
    finder = PathFinder(level_from(".#\n.."))
    assert finder.line_of_sight((0.05, -0.05), (0.15, -0.15))
    finder = PathFinder(level_from(".#\n#."))
    assert not finder.line_of_sight((0.05, -0.05), (0.15, -0.15))


def test_what_a_larger_radius_blocks_is_seen_through_and_the_ends_count():
    finder = PathFinder(level_from(".++.#"))
    assert finder.line_of_sight((0.05, -0.05), (0.35, -0.05))
    assert not finder.line_of_sight((0.05, -0.05), (0.45, -0.05))
    assert not finder.line_of_sight((0.45, -0.05), (0.05, -0.05))
    assert not finder.line_of_sight((0.05, -0.05), (0.95, -0.05))


def test_levels_are_apart_but_for_links():
    lower, upper = level_from("..."), level_from("  ...", ground=2.0)
    house = house_from([lower, upper])
    assert not PathFinder(house).line_of_sight((0.05, -0.05, 0), (0.35, -0.05, 2.0))
    house = house_from([lower, upper], [((0, 0, 2), (1, 0, 3))])
    assert PathFinder(house).line_of_sight((0.05, -0.05, 0), (0.35, -0.05, 2.0))


def test_no_position_is_refused():
    with pytest.raises(QueryError, match="got nan, 0"):
        PathFinder(level_from("..")).line_of_sight((0.0, 0.0), (np.nan, 0.0))


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
        found = finder.snap(positions, **options)
        same(found, [finder.snap(position, **options) for position in positions])
    inside = np.array([p for p in positions if finder.cell_at(p) is not None])
    for options in ({}, {"max_distance": 0.15}):
        expected = [finder.clearance(position, **options) for position in inside]
        np.testing.assert_array_equal(finder.clearance(inside, **options), expected)
    starts = finder.random_point(rng, 60, anywhere=True)
    ends = starts + rng.normal(size=starts.shape)
    ends[0] = (1e9, 0, 0)
    for slide in (True, False):
        expected = [finder.try_step(a, b, slide=slide) for a, b in zip(starts, ends, strict=True)]
        same(finder.try_step(starts, ends, slide=slide), expected)
        expected = [finder.try_step(a, ends[1], slide=slide) for a in starts]
        same(finder.try_step(starts, ends[1], slide=slide), expected)


def test_snap_on_one_level_takes_x_and_y():
    finder = PathFinder(level_from(LEVEL))
    places = np.random.default_rng(1).uniform(-2, 2, size=(4, 5, 2))
    found = finder.snap(places)
    assert found.shape == (4, 5, 3)
    same(found, [finder.snap(place) for place in places.reshape(-1, 2)])


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda m, p: m.clearance([p, (9, 0, 0)]), "9, 0, 0 lies beside the grid"),
        (lambda m, p: m.try_step([p, (9, 0, 0)], p), "no agent can stand at 9, 0, 0"),
        (lambda m, p: m.try_step([p, p], [p] * 3), r"end for each start, \(2,\) of them, got \(3,"),
        (lambda m, p: m.snap([p, (np.nan, 0, 0)]), "finite"),
    ],
)
def test_what_is_wrong_is_named(ask, message):
    finder = PathFinder(level_from(LEVEL))
    with pytest.raises(QueryError, match=message):
        ask(finder, finder.random_point())


def test_no_positions_are_no_answers():
    finder, none = PathFinder(level_from(LEVEL)), np.empty((0, 3))
    assert finder.snap(none).shape == (0, 3)
    assert finder.clearance(none).shape == (0,)
    assert finder.try_step(none, (0, 0, 0)).shape == (0, 3)


def test_without_a_generator_places_are_random():
    finder = PathFinder(level_from("......\n......\n......"))
    places = np.stack([finder.random_point() for _ in range(30)])
    assert len(np.unique(places, axis=0)) > 1
    assert finder.random_point(count=4).shape == (4, 3)
    assert finder.random_point_near(None, places[0], 0.3).shape == (3,)
    assert finder.random_pose().position.shape == (3,)


@pytest.mark.parametrize(
    ("ask", "before", "blocked"),
    [
        (lambda f, a, b, c: f.is_navigable([a, b]).tolist(), [True, True], [True, False]),
        (lambda f, a, b, c: f.snap(b)[0], 0.25, 0.15),
        (lambda f, a, b, c: f.snap(b, in_sight=True)[0], 0.25, 0.15),
        (lambda f, a, b, c: f.try_step(a, c)[0], 0.45, 0.2),
        (lambda f, a, b, c: f.clearance(a), np.inf, 0.15),
        (lambda f, a, b, c: f.line_of_sight(a, c), True, False),
    ],
)
def test_live_obstacles_count(ask, before, blocked):
    finder, places = PathFinder(level_from(".....")), [(x, -0.05) for x in (0.05, 0.25, 0.45)]
    assert ask(finder, *places) == pytest.approx(before)
    with finder.grid.block(cells=Cell(0, 0, 2)):
        assert ask(finder, *places) == pytest.approx(blocked)
    assert ask(finder, *places) == pytest.approx(before)


def test_files_without_floors_and_occupancy():
    house = house_from([level_from(".#", floors=False), level_from("#.", ground=2.0, floors=False)])
    for level in house.levels:
        del level.attributes["occupancy"]
    finder, left, right = PathFinder(house), (0.05, -0.05), (0.15, -0.05)
    for z, expected in ((0.0, [True, False]), (2.0, [False, True])):
        assert finder.is_navigable([[*left, z], [*right, z]]).tolist() == expected
    np.testing.assert_allclose(finder.snap((*right, 0.3)), (*left, 0.0))
    np.testing.assert_allclose(finder.snap((*right, 0.3), in_sight=True), (*left, 0.0))
    assert finder.try_step((*left, 0.0), right)[0] == pytest.approx(0.1, abs=1e-6)
