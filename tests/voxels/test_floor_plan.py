"""Voxels cut at a band of heights, and levels as voxels: the two agree on the samples."""

import numpy as np
import pytest

from navbake.baker.bake.pipeline import run_bake
from navbake.baker.voxels.voxelize import Voxelizer
from navbake.config.settings import load_config
from navbake.errors import QueryError
from navbake.navgrid.grid import SceneGrid2D
from navbake.voxels.floor_plan import cut_band, lattice_of, plan_of, voxels_of
from navbake.voxels.grid import Placement, VoxelGrid
from project_paths import CONFIGS

SAMPLES = ("apartment", "clutter", "house", "terrain", "warehouse")
STEP = 0.25  # [m]


def bake_for_voxels(name):
    """A sample for an agent no wider than a cell, whose band is a whole number of cells high."""
    path = CONFIGS / f"{name}.yaml"
    cell = load_config(path).grid.cell_size
    count = 9 if cell < 0.15 else 5
    changes = [
        "agent.radius=0.0",
        f"agent.traversable_floor_height={STEP}",
        f"agent.height={STEP + count * cell!r}",
        "names.enabled=false",
        "rooms.from=[]",
        "doors.find=false",
    ]
    config = load_config(path, changes)
    return config, run_bake(config).grid, count * cell


@pytest.mark.parametrize("name", SAMPLES)
def test_voxels_cut_over_the_floor_are_the_baked_occupancy(name):
    """Equal where the floor lies at the level's ground, so that the band is whole voxels.

    Elsewhere the bake lies between the voxels that are whole in the band and those that reach
    into it.
    """
    config, grid, band = bake_for_voxels(name)
    voxelizer = Voxelizer(config)
    equal = 0
    for level in grid.levels:
        floor = level.floor_height.astype(float)
        low, high = np.nanmin(floor), np.nanmax(floor) + STEP + band
        res = level.cell_size
        below = int(np.ceil((level.ground + STEP - low) / res)) + 1
        bottom = level.ground + STEP - below * res
        x, y, _, _ = level.lattice.bounds
        shape = (level.width, level.height, int(np.ceil((high - bottom) / res)) + 1)
        voxels = voxelizer.fill(Placement(np.array([x, y, bottom]), res, shape))
        reaching = cut_band(voxels, STEP, STEP + band, floor)
        whole = cut_band(voxels, STEP, STEP + band, floor, whole=True)
        baked = level.occupancy
        assert (whole <= baked).all() and (baked <= reaching).all()
        flat = np.abs(floor - level.ground) < 1e-9
        np.testing.assert_array_equal(reaching[flat], baked[flat])
        np.testing.assert_array_equal(whole[flat], baked[flat])
        equal += np.count_nonzero(flat)
    assert equal > 1000 or name == "terrain"


@pytest.mark.parametrize("name", ["apartment", "house"])
def test_a_level_as_voxels_is_cut_into_itself(name):
    _, grid, band = bake_for_voxels(name)
    for level in grid.levels:
        voxels = voxels_of(level, step=STEP, height=STEP + band)
        assert lattice_of(voxels).shape == level.shape
        np.testing.assert_allclose(lattice_of(voxels).bounds, level.lattice.bounds)
        floor = level.floor_height.astype(float)
        has_floor = ~np.isnan(floor)
        cut = cut_band(voxels, STEP, STEP + band, floor)
        np.testing.assert_array_equal(cut[has_floor], level.occupancy[has_floor])
        plain = np.where(has_floor, floor, level.ground)
        np.testing.assert_array_equal(cut_band(voxels, STEP, STEP + band, plain), level.occupancy)


def pillar():
    values = np.zeros((3, 2, 5), dtype=bool)
    values[2, 0, 2] = True  # x 1.0 to 1.5, y -1 to -0.5, z 1.0 to 1.5
    return VoxelGrid(values=values, origin=(0.0, -1.0, 0.0), res=0.5)


def test_a_plan_is_a_grid_of_the_world():
    grid = plan_of(pillar(), 0.5, step=0.25, height=1.2)
    assert isinstance(grid, SceneGrid2D) and grid.shape == (2, 3)
    rows, cols = grid.lattice.rows_cols([[1.2, -0.7], [1.2, -0.2], [0.2, -0.7]])
    assert grid.occupancy[rows, cols].tolist() == [1, 0, 0]
    assert grid.free.sum() == 5 and grid.ground == 0.5
    assert plan_of(pillar(), 1.2, step=0.3, height=1.0).free.all()


def test_a_band_ends_at_voxels_faces_or_reaches_into_them():
    for low, high, reaching, whole in (
        (1.0, 1.5, 1, 1),
        (0.5, 1.0, 0, 0),
        (1.5, 2.0, 0, 0),
        (1.1, 1.4, 1, 0),
        (0.0, 1.01, 1, 0),
        (-9.0, 9.0, 1, 1),
        (7.0, 9.0, 0, 0),
    ):
        assert cut_band(pillar(), low, high)[1, 2] == reaching
        assert cut_band(pillar(), low, high, whole=True)[1, 2] == whole


def test_no_floor_is_occupied():
    floor = np.full((2, 3), 0.5)
    floor[0, 0] = np.nan
    assert cut_band(pillar(), 0.5, 1.0, floor).tolist() == [[1, 0, 0], [0, 0, 1]]


def test_bands_and_floors_that_cannot_be():
    with pytest.raises(QueryError, match="low < high, got 1 and 1"):
        cut_band(pillar(), 1, 1)
    with pytest.raises(QueryError, match=r"shape \(ny, nx\) = \(2, 3\), got \(3, 2\)"):
        cut_band(pillar(), 0, 1, np.zeros((3, 2)))
    with pytest.raises(QueryError, match="step < height, got 2 and 1"):
        voxels_of(plan_of(pillar(), 0), step=2, height=1)


@pytest.mark.parametrize("ground", [2.7, 30.1, -0.3, 1234.7])
def test_float32_floors_add_no_layer(ground):
    """A band of 9 cells over a floor that float32 moves is 9 layers, wherever the floor is."""
    values = np.zeros((3, 2, 30), dtype=bool)
    values[1] = True
    low = VoxelGrid(values=values, origin=(0.0, 0.0, ground), res=0.1)
    plan = plan_of(low, ground, step=0.25, height=1.15)
    voxels = voxels_of(plan, step=0.25, height=1.15)
    assert voxels.shape == (3, 2, 9) and voxels.values[1].all() and not voxels.values[0].any()
    assert voxels.origin[2] == pytest.approx(ground + 0.25)


def test_box_of_a_plan_is_that_of_the_voxels_and_holds_the_floor():
    assert plan_of(pillar(), 0.5).bbox_yup == ((0.0, 0.0, 0.0), (1.5, 2.5, 1.0))
    low, high = plan_of(pillar(), -0.3, height=1.5).bbox_yup
    assert low[1] == float(np.float32(-0.3)) and high[1] == 2.5
