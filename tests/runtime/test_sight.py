"""Lines of sight, against dense samples of the line."""

from __future__ import annotations

import numpy as np
import pytest

from grid_maps import house_from, level_from, random_house
from navbake.errors import QueryError
from navbake.navgrid.cells import Cell
from navbake.runtime.path_finder import PathFinder


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


def test_live_obstacles_stand_between():
    finder = PathFinder(level_from("....."))
    with finder.grid.block(cells=Cell(0, 0, 2)):
        assert not finder.line_of_sight((0.05, -0.05), (0.45, -0.05))
    assert finder.line_of_sight((0.05, -0.05), (0.45, -0.05))


def test_no_position_is_refused():
    with pytest.raises(QueryError, match="got nan, 0"):
        PathFinder(level_from("..")).line_of_sight((0.0, 0.0), (np.nan, 0.0))
