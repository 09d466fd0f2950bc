"""The nearest obstacle, against all squares."""

from __future__ import annotations

import math

import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from, random_house
from navbake.errors import QueryError
from navbake.navgrid.cells import Cell
from navbake.runtime.path_finder import PathFinder
from project_paths import GOLDEN


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
