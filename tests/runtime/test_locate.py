"""Which cell a position is in: on the storey under it, whatever the boxes say."""

from __future__ import annotations

import numpy as np
import pytest

from navbake.errors import QueryError
from navbake.navgrid.cells import Cell, Cells, cell_at, cells_at, position_of
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.runtime.flat_grid import flatten


def make_level(floor, x=0.0, y_max=0.0, ground=0.0, cell_size=0.5, stated=True, **fields):
    """A level of a floor per cell, NaN for none; free where there is a floor."""
    floor = np.array(floor, dtype=np.float32)
    height, width = floor.shape
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=cell_size,
        min_yup=(x, ground, -y_max),
        weights=np.where(np.isnan(floor), np.inf, 1.0),
        attributes={"floorHeight": floor} if stated else {},
        metadata={"traversableFloorHeight": 0.25},
        **fields,
    )


def make_house(**fields):
    """A stair from 0 to 2 m under an upper floor at 2.5 m with a stairwell over its high end."""
    lower = make_level([[0.0, 0.5, 1.0, 1.5, 2.0], [0.0] * 5], x=-1.0, y_max=1.0)
    nan = np.nan
    upper = make_level([[2.5, 2.5, nan, nan, nan], [2.5] * 5], x=-1.0, y_max=1.0, ground=2.5)
    metadata = {"traversableFloorHeight": 0.25, "sceneId": "house"}
    return MultiLevelGrid(grids=[lower, upper], cell_size=0.5, metadata=metadata, **fields)


@pytest.mark.parametrize(
    ("position", "expected"),
    [
        ((-0.9, 0.9, 0.0), (0, 0, 0)),
        ((-0.9, 0.9, 2.2), (0, 0, 0)),  # under the ceiling
        ((-0.9, 0.9, 2.26), (1, 0, 0)),  # less than a step below the upper floor
        ((-0.9, 0.9, 9.0), (1, 0, 0)),
        ((0.6, 0.9, 2.6), (0, 0, 3)),  # over the stairwell: the stair is what is below
        ((0.6, 0.1, 2.6), (1, 1, 3)),
        ((-0.9, 0.9, -0.2), (0, 0, 0)),
        ((-0.9, 0.9, -0.3), None),
        ((-1.1, 0.9, 0.0), None),
        ((0.0, 1e300, 0.0), None),
    ],
)
def test_the_level_is_that_of_the_nearest_floor_below(position, expected):
    house = make_house()
    assert cell_at(house, position) == expected
    flat = flatten(house)
    cell = flat.cells_at(position)
    assert (flat.to_cell(int(cell)) if cell >= 0 else None) == expected


def test_boxes_do_not_decide():
    house = make_house()
    for level in house.levels:
        level.bbox_yup = ((-1.0, -5.0, -1.0), (1.5, 50.0, 0.0))
    assert cell_at(house, (-0.9, 0.9, 3.0)) == (1, 0, 0)
    assert cell_at(house, (-0.9, 0.9, 1.0)) == (0, 0, 0)


def test_where_no_level_has_a_floor_the_ground_counts():
    house = make_house()
    house.levels[0].floor_height[0, 4] = np.nan
    assert cell_at(house, (1.4, 0.9, 0.1)) == (0, 0, 4)
    assert cell_at(house, (1.4, 0.9, 2.6)) == (1, 0, 4)
    assert cell_at(house, (1.4, 0.9, -1.0)) is None


def test_a_given_level_is_taken_whatever_the_height():
    house = make_house()
    assert cell_at(house, (-0.9, 0.9, 0.0), level=1) == (1, 0, 0)
    assert cell_at(house, (-0.9, 0.9), level=1) == (1, 0, 0)
    assert cell_at(house, (0.6, 0.9), level=1) == (1, 0, 3)  # no floor there
    assert cell_at(house, (5.0, 0.9), level=1) is None


def test_one_level_needs_no_height():
    level = make_level([[0.0, 7.0, np.nan]], x=1.0, y_max=2.0)
    assert cell_at(level, (1.6, 1.9)) == Cell(0, 0, 1)
    assert cell_at(level, (2.2, 1.9)) == Cell(0, 0, 2)
    assert level.cell_at((1.6, 1.9)) == Cell(0, 0, 1)


def test_files_without_floor_heights_stand_on_their_ground_in_walls_too():
    house = make_house()
    for level in house.levels:
        del level.attributes["floorHeight"]
    assert cell_at(house, (0.6, 0.9, 2.6)) == (1, 0, 3)  # blocked on the upper level
    flat = flatten(house)
    assert flat.to_cell(flat.cells_at((0.6, 0.9, 2.6))) == (1, 0, 3)
    np.testing.assert_allclose(position_of(house, Cell(1, 0, 3)), (0.75, 0.75, 2.5))


def test_positions_and_cells_are_each_others_inverse():
    house = make_house()
    flat = flatten(house)
    ids = np.flatnonzero(flat.free)
    cells = flat.to_cells(ids)
    positions = house.position_of(cells)
    np.testing.assert_array_equal(positions, flat.positions(ids))
    for found, expected in zip(house.cells_at(positions), cells, strict=True):
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(flat.cells_at(positions), ids)
    one = Cell(*(int(v[3]) for v in cells))
    np.testing.assert_array_equal(house.position_of(one), positions[3])


@pytest.mark.parametrize("seed", range(5))
def test_many_equal_one_by_one_on_random_grids_that_are_not_square(seed):
    rng = np.random.default_rng(seed)
    levels = []
    for number in range(4):
        shape = tuple(rng.integers(3, 12, size=2))
        floor = rng.uniform(0, 1.0, size=shape) + 2.0 * number
        floor[rng.random(shape) < 0.3] = np.nan
        x, y = rng.uniform(-2, 2, size=2).round(2)
        levels.append(make_level(floor, x, y, ground=2.0 * number, cell_size=0.25))
    metadata = {"traversableFloorHeight": 0.25}
    grid = MultiLevelGrid(grids=levels, cell_size=0.25, metadata=metadata)
    positions = rng.uniform((-3, -5, -1), (5, 3, 9), size=(2000, 3))
    many = cells_at(grid, positions)
    flat = flatten(grid)
    for fast, slow in zip(flat.to_cells(flat.cells_at(positions)), many, strict=True):
        np.testing.assert_array_equal(fast, slow)
    for i in range(0, 2000, 10):
        one = cell_at(grid, positions[i])
        assert (one or (-1, -1, -1)) == tuple(int(v[i]) for v in many)
        assert one == plain_cell_at(grid, positions[i])


def plain_cell_at(grid, position):
    """The rule, word by word."""
    x, y, z = position
    floors, grounds = [], []
    for number, level in enumerate(grid.levels):
        x0, y0, x1, y1 = level.lattice.bounds
        if x0 <= x < x1 and y0 < y <= y1:
            row, col = (int(v) for v in level.lattice.rows_cols((x, y)))
            floor = float(level.floor_height[row, col])
            stands = floors if floor == floor else grounds
            stands.append((floor if floor == floor else level.ground, number, row, col))
    for stands in (floors, grounds):
        below = [entry for entry in stands if entry[0] <= z + 0.25]
        if below:
            return max(below)[1:]
    return None


def test_shapes_are_kept():
    house = make_house()
    assert cells_at(house, np.zeros((2, 3, 3))).level.shape == (2, 3)
    assert cells_at(house, np.zeros((0, 3))).row.shape == (0,)
    assert flatten(house).cells_at(np.zeros((2, 3, 3))).shape == (2, 3)


def test_two_numbers_are_no_position():
    message = r"expected a position in one argument, as in \(1\.5, -2\.0\), got 1, 3"
    with pytest.raises(QueryError, match=message):
        make_house().at(1, 3)


@pytest.mark.parametrize("ask", [cell_at, lambda g, *a: flatten(g).locate(*a)])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((0.0, np.nan, 0.0),), "finite numbers, got 0, nan, 0"),
        (((0.0, np.inf, 0.0),), "finite numbers, got 0, inf, 0"),
        (((0.0, 0.0),), "expected x, y, z or a level, got x, y: the grid has 2 levels, 0 to 1"),
        (((0.0, 0.0), 2), "no level 2: expected 0 to 1"),
        (((0.0, 0.0), -1), "no level -1: expected 0 to 1"),
        (((0.0, 0.0), "attic"), "no level 'attic'"),
        (((0.0, 0.0, 0.0, 0.0),), r"shape \(..., 3\) \[m\], got \(4,\)"),
        ((0.0,), r"got \(\)"),
        (("here",), "expected world positions"),
        ((np.zeros((2, 3)),), r"expected one position, got an array of shape \(2, 3\)"),
    ],
)
def test_what_is_no_position_is_refused(ask, arguments, message):
    with pytest.raises(QueryError, match=message):
        ask(make_house(), *arguments)


def test_the_one_bad_position_of_many_is_named():
    positions = np.zeros((5, 3))
    positions[3] = 1.0, np.nan, 2.0
    with pytest.raises(QueryError, match="got 1, nan, 2"):
        cells_at(make_house(), positions)


@pytest.mark.parametrize("cell", [(2, 0, 0), (0, 2, 0), (0, 0, -1), (-1, -1, -1)])
def test_a_cell_that_there_is_not_is_named(cell):
    with pytest.raises(QueryError, match=rf"no cell .* \({cell[0]}, {cell[1]}, {cell[2]}\)"):
        position_of(make_house(), Cell(*cell))
    with pytest.raises(QueryError, match="no cell"):
        position_of(make_house(), Cells(*(np.array([0, v]) for v in cell)))
