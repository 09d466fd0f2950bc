"""Lattice: where cells lie, in the world and in files."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.lattice import Lattice, count_cells

CELL_SIZES = st.sampled_from([0.05, 0.1, 0.25, 0.3, 1.0])
EDGES = st.floats(-50, 50).map(lambda x: round(x, 3))
EXTENTS = st.floats(0.01, 8).map(lambda x: round(x, 3))


@st.composite
def lattices(draw) -> Lattice:
    x, y = draw(EDGES), draw(EDGES)
    return Lattice.cover((x, y, x + draw(EXTENTS), y + draw(EXTENTS)), draw(CELL_SIZES))


def test_the_formats_own_example_comes_out_of_its_box():
    # of the file's box x, y, z, lower and upper corner; z is -y of the world
    low, high = (-42.658744811854994, -44.06613540649414), (-35.95526123046875, -36.685002136230466)
    lattice = Lattice.cover((low[0], -high[1], high[0], -low[1]), 0.1)
    assert (lattice.width, lattice.height) == (68, 74)
    assert lattice.x_min == pytest.approx(-42.707003021161874, abs=1e-12)
    assert -lattice.y_max == pytest.approx(-44.075568771362306, abs=1e-12)


def test_file_frame_is_y_up():
    grid = SceneGrid2D(
        width=1, height=1, cell_size=2.0, unit=0.5, min_yup=(1.0, 2.0, 3.0), weights=np.ones((1, 1))
    )
    assert (grid.lattice.x_min, grid.lattice.y_max, grid.ground) == (0.5, -1.5, 1.0)
    assert grid.lattice.cell_size == 1.0
    grid.min_yup = (0.0, 0.0, 0.0)
    assert math.copysign(1, grid.lattice.y_max) == 1


@given(lattices())
def test_every_centre_lies_in_its_own_cell(lattice):
    rows, cols = np.indices(lattice.shape)
    found = lattice.rows_cols(lattice.positions(rows, cols))
    np.testing.assert_array_equal(found, (rows, cols))


@given(lattices())
def test_positions_agree_with_centres_of_columns_and_rows(lattice):
    rows, cols = np.indices(lattice.shape)
    expected = np.stack(np.meshgrid(lattice.center_x(), lattice.center_y()), axis=-1)
    np.testing.assert_array_equal(lattice.positions(rows, cols), expected)


@given(lattices())
def test_row_0_is_at_large_y_and_column_0_at_small_x(lattice):
    assert (np.diff(lattice.center_y()) < 0).all()
    assert (np.diff(lattice.center_x()) > 0).all()
    x0, y0, x1, y1 = lattice.bounds
    half = lattice.cell_size / 2
    assert lattice.positions(0, 0) == pytest.approx([x0 + half, y1 - half])
    corner = lattice.positions(lattice.height - 1, lattice.width - 1)
    assert corner == pytest.approx([x1 - half, y0 + half])


@given(EDGES, EDGES, EXTENTS, EXTENTS, CELL_SIZES, st.sampled_from([0.0, 0.5]))
def test_cover_holds_its_bounds_centred_in_the_fewest_cells(x, y, dx, dy, cell_size, margin):
    lattice = Lattice.cover((x, y, x + dx, y + dy), cell_size, margin)
    x0, y0, x1, y1 = lattice.bounds
    assert ((x0 + x1) / 2, (y0 + y1) / 2) == pytest.approx((x + dx / 2, y + dy / 2), abs=1e-9)
    for covered, extent in ((x1 - x0, dx + 2 * margin), (y1 - y0, dy + 2 * margin)):
        assert -2e-6 * cell_size <= covered - extent < cell_size


@pytest.mark.parametrize(
    ("extent", "cell_size", "expected"),
    [
        (1.0, 0.1, 10),
        (0.1 * 3, 0.1, 3),  # 0.30000000000000004
        (1.0 + 0.9e-7, 0.1, 10),  # within the slack of 1e-6 cells
        (1.0 + 2e-7, 0.1, 11),
        (1.01, 0.1, 11),
        (0.0, 0.1, 1),
        (1e-9, 0.1, 1),
    ],
)
def test_num_cells_rounds_up_but_for_rounding_errors(extent, cell_size, expected):
    assert count_cells(extent, cell_size) == expected


@given(lattices(), st.data())
def test_a_cut_has_its_cells_in_the_same_places(lattice, data):
    row0 = data.draw(st.integers(0, lattice.height - 1))
    row1 = data.draw(st.integers(row0 + 1, lattice.height))
    col0 = data.draw(st.integers(0, lattice.width - 1))
    col1 = data.draw(st.integers(col0 + 1, lattice.width))
    part = lattice.cut(slice(row0, row1), slice(col0, col1))
    assert part.shape == (row1 - row0, col1 - col0)
    np.testing.assert_allclose(part.center_x(), lattice.center_x()[col0:col1], atol=1e-9)
    np.testing.assert_allclose(part.center_y(), lattice.center_y()[row0:row1], atol=1e-9)


@given(lattices(), st.integers(-40, 40), st.integers(-40, 40))
def test_shifted_by_whole_cells_the_same_cells(lattice, east, north):
    x0, y0, x1, y1 = lattice.bounds
    dx, dy = east * lattice.cell_size, north * lattice.cell_size
    shifted = Lattice.cover((x0 + dx, y0 + dy, x1 + dx, y1 + dy), lattice.cell_size)
    assert shifted.shape == lattice.shape
    np.testing.assert_allclose(shifted.center_x(), lattice.center_x() + dx, atol=1e-9)
    np.testing.assert_allclose(shifted.center_y(), lattice.center_y() + dy, atol=1e-9)


@given(EDGES, EDGES, EXTENTS, EXTENTS, CELL_SIZES)
def test_turned_by_90_degrees_the_arrays_turn_as_rot90_does(x, y, dx, dy, cell_size):
    lattice = Lattice.cover((x, y, x + dx, y + dy), cell_size)
    turned = Lattice.cover((-(y + dy), x, -y, x + dx), cell_size)  # (x, y) -> (-y, x)
    assert turned.shape == (lattice.width, lattice.height)
    rows, cols = np.indices(lattice.shape)
    before = lattice.positions(rows, cols)
    after = np.stack([-before[..., 1], before[..., 0]], axis=-1)
    rows, cols = np.indices(turned.shape)
    np.testing.assert_allclose(turned.positions(rows, cols), np.rot90(after), atol=1e-9)


def test_positions_outside_run_on():
    lattice = Lattice(x_min=0.0, y_max=0.0, cell_size=1.0, width=2, height=2)
    rows, cols = lattice.rows_cols([[-0.5, 0.5], [2.5, -2.5]])
    assert (rows.tolist(), cols.tolist()) == ([-1, 2], [-1, 2])


@given(lattices(), EDGES, EDGES, EXTENTS, EXTENTS, st.sampled_from([0.0, 0.1, 0.7]))
def test_a_window_holds_all_cells_that_a_box_is_near_to(lattice, x, y, width, height, reach):
    window = lattice.window(np.array([[x, y, 0.0], [x + width, y + height, 1.0]]), reach)
    cell_x, cell_y = np.meshgrid(lattice.center_x(), lattice.center_y())
    near = lattice.cell_size / 2 + reach
    meets = (cell_x + near >= x) & (cell_x - near <= x + width)
    meets &= (cell_y + near >= y) & (cell_y - near <= y + height)
    inside = np.zeros(lattice.shape, dtype=bool)
    if window is not None:
        inside[window] = True
        assert inside.any()
    assert not (meets & ~inside).any()
    far = near + 2.5 * lattice.cell_size
    apart = (cell_x + far < x) | (cell_x - far > x + width)
    apart |= (cell_y + far < y) | (cell_y - far > y + height)
    assert not (apart & inside).any()
