"""Whether an agent can stand at positions: one, and very many."""

from __future__ import annotations

import numpy as np
import pytest

from grid_maps import house_from, level_from, random_house
from navbake.errors import QueryError
from navbake.navgrid.cells import Cell, cell_at
from navbake.runtime.path_finder import PathFinder


@pytest.mark.parametrize("seed", range(6))
def test_many_as_one_by_one_by_the_rule(seed):
    rng = np.random.default_rng(seed)
    house = random_house(rng, num_levels=1 + seed % 3, share=0.7)
    finder = PathFinder(house)
    positions = rng.uniform((-1.5, -2, -1), (3, 3, 6), size=(1500, 3))
    found = finder.are_navigable(positions)
    assert found.dtype == np.bool_ and found.any() and not found.all()
    for position, answer in zip(positions, found, strict=True):
        cell = cell_at(house, position)
        expected = False
        if cell is not None:
            level = house.levels[cell.level]
            floor = float(level.floor_height[cell.row, cell.col])
            expected = bool(level.free[cell.row, cell.col]) and position[2] - floor <= 0.5
        assert answer == expected == finder.is_navigable(position)
    on_level = finder.are_navigable(positions, level=0)
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
    np.testing.assert_array_equal(finder.are_navigable(positions), expected)
    shaped = finder.are_navigable(positions.reshape(4, 500, 3))
    np.testing.assert_array_equal(shaped, expected.reshape(4, 500))
    np.testing.assert_array_equal(finder.are_navigable(positions.astype(np.float32)), expected)
    np.testing.assert_array_equal(finder.are_navigable(positions[:, :2]), expected)
    np.testing.assert_array_equal(finder.are_navigable(positions[::-1]), expected[::-1])
    assert finder.are_navigable(np.empty((0, 3))).shape == (0,)


def test_free_cells_without_floor_stand_on_the_ground():
    level = level_from("..", ground=1.0)
    level.floor_height[0, 1] = np.nan
    finder = PathFinder(level)
    assert finder.is_navigable((0.15, -0.05, 1.0))
    assert finder.is_navigable((0.15, -0.05, 1.45))
    assert not finder.is_navigable((0.15, -0.05, 1.6))
    assert finder.is_navigable((0.15, -0.05, 1.6), max_drop=1.0)
    assert not finder.is_navigable((0.15, -0.05, 0.5))


def test_live_obstacles_count():
    finder = PathFinder(level_from("..."))
    finder.grid.block(cells=Cell(0, 0, 1))
    assert finder.are_navigable([[0.05, -0.05], [0.15, -0.05]]).tolist() == [True, False]


def test_files_without_floors_and_occupancy():
    house = house_from([level_from(".#", floors=False), level_from("#.", ground=2.0, floors=False)])
    for level in house.levels:
        del level.attributes["occupancy"]
    finder = PathFinder(house)
    below = finder.are_navigable([[0.05, -0.05, 0.0], [0.15, -0.05, 0.0]])
    above = finder.are_navigable([[0.05, -0.05, 2.0], [0.15, -0.05, 2.0]])
    assert (below.tolist(), above.tolist()) == ([True, False], [False, True])


@pytest.mark.parametrize("at", [0, 700, 1499])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_position_that_is_none_is_named(at, value):
    positions = np.zeros((1500, 3))
    positions[at] = 1.0, value, 2.0
    with pytest.raises(QueryError, match=rf"finite numbers, got 1, {value}, 2"):
        PathFinder(level_from("..")).are_navigable(positions)


def test_many_for_one_are_refused():
    with pytest.raises(QueryError, match="expected one position"):
        PathFinder(level_from("..")).is_navigable(np.zeros((2, 3)))
