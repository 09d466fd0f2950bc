"""GRScenes' occupancy.npy: as its authors say how to decode it."""

import numpy as np
import pytest

import navbake
from map_grids import SAMPLES, random_level, sample, small
from navbake.errors import FormatError

# the example of the authors' answer, in which steps of x and y differ
THEIRS = np.array(
    [
        [0.0, -0.6124152, -0.5985299, -0.58464456],
        [9.95767, 1.0, 1.0, 1.0],
        [9.943815, 1.0, 1.0, 1.0],
        [9.929959, 0.0, 0.0, 0.0],
    ]
)


def decode(path):
    """Positions and values: ``array[1:, 1:]`` at ``array[0, i]``, ``array[j, 0]``."""
    array = np.load(path)
    x, y = np.meshgrid(array[0, 1:], array[1:, 0])
    return np.stack([x, y], axis=-1).reshape(-1, 2), array[1:, 1:].ravel()


@pytest.mark.parametrize("name", SAMPLES)
def test_its_authors_rules_find_the_cells(tmp_path, name):
    grid = sample(name)
    written = grid.convert(tmp_path / "occupancy.npy", stairs="free")
    assert len(written) == len(grid.levels)
    for path, level in zip(written, grid.levels, strict=True):
        points, values = decode(path)
        rows, cols = level.lattice.rows_cols(points)
        assert {*zip(rows.tolist(), cols.tolist(), strict=True)} == {*np.ndindex(level.shape)}
        expected = np.where(level.free, 0, np.where(np.isnan(level.floor_height), -1, 1))
        np.testing.assert_array_equal(values, expected[rows, cols])


@pytest.mark.parametrize("flip", [(1, 1), (-1, 1), (1, -1)])
def test_grids_come_back_in_either_order(tmp_path, flip):
    level = random_level(3)
    (path,) = level.convert(tmp_path / "occupancy.npy")
    array = np.load(path)
    turned = array[np.r_[0, np.arange(1, len(array))[:: flip[0]]]]
    turned = turned[:, np.r_[0, np.arange(1, turned.shape[1])[:: flip[1]]]]
    np.save(path, turned)
    back = navbake.from_grscenes(path)
    np.testing.assert_array_equal(back.free, level.free)
    np.testing.assert_array_equal(np.isnan(back.floor_height), np.isnan(level.floor_height))
    assert back.lattice == pytest.approx(level.lattice, abs=1e-9)


def test_float32_and_inflated(tmp_path):
    level = small()
    (path,) = level.convert(tmp_path / "occupancy.npy", radius=0.06)
    np.save(path, np.load(path).astype(np.float32))
    back = navbake.from_grscenes(path)
    np.testing.assert_array_equal(back.free, level.inflate(0.06).free)
    assert back.lattice == pytest.approx(level.lattice, abs=1e-5)


def test_the_authors_example(tmp_path):
    np.save(tmp_path / "occupancy.npy", THEIRS)
    level = navbake.from_grscenes(tmp_path / "occupancy.npy")
    for x in THEIRS[0, 1:]:
        for y, value in zip(THEIRS[1:, 0], THEIRS[1:, 1], strict=True):
            cell = level.cell_at((x, y, 0.0))
            assert level.free[cell.row, cell.col] == (value == 0)


@pytest.mark.parametrize(("dx", "dy"), [(0.02, 0.0199), (0.0199, 0.02), (0.05, 0.02)])
def test_steps_that_differ_leave_no_gap_and_no_shift(tmp_path, dx, dy):
    """Each sample's position has its value, and a wall of one sample has no gap."""
    rng = np.random.default_rng(1)
    array = np.zeros((301, 201))
    array[0, 1:], array[1:, 0] = 3.0 + dx * np.arange(200), -1.0 - dy * np.arange(300)
    array[1:, 1:] = rng.choice([-1, 0, 0, 1], (300, 200))
    array[151, 1:] = array[1:, 77] = 1
    np.save(tmp_path / "occupancy.npy", array)
    level = navbake.from_grscenes(tmp_path / "occupancy.npy")
    assert level.cell_size == pytest.approx(min(dx, dy))
    points, values = decode(tmp_path / "occupancy.npy")
    rows, cols = level.lattice.rows_cols(points)
    np.testing.assert_array_equal(level.free[rows, cols], values == 0)
    row, col = level.lattice.rows_cols([[3.0 + 76 * dx, -1.0 - 150 * dy]])
    near = slice(int(row[0]) - 1, int(row[0]) + 2), slice(int(col[0]) - 1, int(col[0]) + 2)
    assert (~level.free[near[0]]).all(axis=1).any() and (~level.free[:, near[1]]).all(axis=0).any()
    x0, y0, x1, y1 = level.lattice.bounds
    assert abs(x1 - x0 - 200 * dx) < max(dx, dy) and abs(y1 - y0 - 300 * dy) < max(dx, dy)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((3, 3, 3)), r"numbers with coordinates .* got float64 of \(3, 3, 3\)"),
        (np.array([["a", "b"], ["c", "d"]]), r"numbers with coordinates .*occupancy\.npy"),
        (np.zeros((2, 2)), r"expected two samples at least.*occupancy\.npy"),
        (np.where(THEIRS == 0, 0.5, THEIRS), r"expected 0 \(free\), 1 .*, got others in"),
        (np.where(THEIRS > 9.95, 12.0, THEIRS), r"expected y of samples in even steps"),
        (np.where(THEIRS < -0.6, np.nan, THEIRS), r"expected x of samples within"),
        (np.where(THEIRS < 0, -0.5, THEIRS), r"expected x of samples in even steps"),
    ],
)
def test_broken_maps_are_named(tmp_path, array, message):
    np.save(tmp_path / "occupancy.npy", array)
    with pytest.raises(FormatError, match=message):
        navbake.from_grscenes(tmp_path / "occupancy.npy")


def test_steps_of_very_different_lengths_take_no_more_memory_than_a_file_may(tmp_path):
    array = np.zeros((3, 1001))
    array[0, 1:], array[1:, 0] = 1e-6 * np.arange(1000), [0.0, -1e6]
    np.save(tmp_path / "occupancy.npy", array)
    with pytest.raises(FormatError, match=r"too many cells .*occupancy\.npy"):
        navbake.from_grscenes(tmp_path / "occupancy.npy")


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.longdouble, np.int64])
def test_numbers_of_any_size_are_no_warning(tmp_path, dtype):
    huge = np.finfo(dtype).max if np.issubdtype(dtype, np.floating) else np.iinfo(dtype).min
    array = np.zeros((4, 4), dtype)
    array[0, 1:] = array[1:, 0] = range(3)
    np.save(tmp_path / "a.npy", array)
    assert navbake.from_grscenes(tmp_path / "a.npy").cell_size == 1.0
    if dtype is not np.float16:  # its largest number is 65504 m
        array[0, 1] = huge
        np.save(tmp_path / "a.npy", array)
        with pytest.raises(FormatError, match="expected x of samples within"):
            navbake.from_grscenes(tmp_path / "a.npy")
