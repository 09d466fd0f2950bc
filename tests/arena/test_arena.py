"""A level's obstacles in an arena's squares."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navbake.arena.map_descriptor import find_obstacles, place_squares
from navbake.errors import QueryError
from navbake.navgrid.grid import SceneGrid2D


def level_of(occupancy, cell=0.1, corner=(0.0, 0.0)):
    occupancy = np.asarray(occupancy, dtype=np.uint8)
    rows, cols = occupancy.shape
    return SceneGrid2D(
        width=cols,
        height=rows,
        cell_size=cell,
        min_yup=(corner[0], 0.0, -(corner[1] + rows * cell)),
        weights=np.where(occupancy, np.inf, 1.0).astype(np.float32),
        attributes={"occupancy": occupancy},
    )


def find_plainly(level, squares):
    """Square by square, cell by cell: rectangles that overlap by more than a hair."""
    lattice = level.lattice
    out = np.zeros(squares.shape, dtype=bool)
    x0, y0, x1, y1 = lattice.bounds
    for row, col in np.ndindex(squares.shape):
        x, y = squares.positions(row, col)
        half = squares.cell_size / 2
        out[row, col] = min(x - half - x0, x1 - x - half, y - half - y0, y1 - y - half) < -1e-6
        for i, j in np.argwhere(level.occupancy):
            cx, cy = lattice.positions(i, j)
            reach = half + lattice.cell_size / 2 - 1e-6
            out[row, col] |= abs(cx - x) < reach and abs(cy - y) < reach
    return out


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.05, 0.07, 0.1, 0.13, 0.25]),
    st.integers(-7, 7),
    st.integers(-7, 7),
)
def test_an_obstacle_anywhere_in_a_square_fills_it(seed, cell, dx, dy):
    rng = np.random.default_rng(seed)
    level = level_of(rng.random((6, 9)) < 0.1, cell, (-0.4, 0.2))
    squares = place_squares(level, corner=(-0.4 + dx * 0.03, 0.2 + dy * 0.03), shape=(7, 6))
    np.testing.assert_array_equal(find_obstacles(level, squares), find_plainly(level, squares))


def test_the_arenas_own_cells_are_its_squares():
    rng = np.random.default_rng(0)
    occupancy = rng.random((20, 15)) < 0.3
    level = level_of(occupancy, 0.1, (-0.75, -1.0))
    squares = place_squares(level)
    assert squares.shape == (20, 15)
    np.testing.assert_array_equal(find_obstacles(level, squares), occupancy)


def test_what_lies_beside_the_level_is_an_obstacle():
    level = level_of(np.zeros((2, 2)))
    squares = place_squares(level, corner=(-0.1, 0.0), shape=(2, 4))
    assert find_obstacles(level, squares).tolist() == [[True, False, False, True]] * 2


def test_says_what_is_wrong():
    level = level_of(np.zeros((2, 2)))
    with pytest.raises(QueryError, match="edge > 0 m, got 0"):
        place_squares(level, square=0)
    with pytest.raises(QueryError, match="lower left corner as x, y"):
        place_squares(level, corner=(1, 2, 3))
    with pytest.raises(QueryError, match="leaves nothing of the level"):
        place_squares(level, corner=(1, 0))
    with pytest.raises(QueryError, match=r"lies beside the level: it spans x 0 to 0\.2"):
        place_squares(level, corner=(5, 0), shape=(2, 2))
    for square in (1e-7, 1e-310):
        with pytest.raises(QueryError, match="larger squares"):
            place_squares(level, square=square)
    with pytest.raises(QueryError, match="at most 100000000 squares, got 1000000 × 1000000"):
        place_squares(level, shape=(10**6, 10**6))
    with pytest.raises(QueryError, match="rows and columns >= 1, got 0 and 5"):
        place_squares(level, shape=(0, 5))
