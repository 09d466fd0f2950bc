"""Each sample's grid is true of its scene, and so are random houses and paths through them."""

from __future__ import annotations

import os

import mujoco
import pytest

import navbake
from buildings.make import make_building
from navbake.config.settings import load_config, parse_config
from navbake.testing import assert_true
from project_paths import CONFIGS, GOLDEN

SAMPLES = sorted(path.stem for path in CONFIGS.glob("*.yaml"))
MORE = int(os.environ.get("NAVBAKE_EXAMPLES", "0"))


def is_old(grid) -> bool:
    """Whether another MuJoCo baked a grid: it rounds poses otherwise, so the digests differ."""
    return bool(grid.navbake["mujoco"] != mujoco.__version__)


@pytest.mark.parametrize("name", SAMPLES)
def test_sample_is_true(name):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    report = assert_true(grid, load_config(CONFIGS / f"{name}.yaml"), paths=10, force=is_old(grid))
    assert report.checked == report.num_cells and report.total.disputed == 0
    assert report.sweeps is not None and report.sweeps.paths == 10


@pytest.mark.parametrize("radius", [0.1, 0.3])
def test_sample_is_true_for_larger_agents(radius):
    grid = navbake.load(GOLDEN / "apartment.grid.json.gz")
    report = assert_true(
        grid, CONFIGS / "apartment.yaml", radius=radius, paths=10, force=is_old(grid)
    )
    assert report.radius == radius


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
@pytest.mark.parametrize("seed", range(MORE or 2))
def test_random_house_is_true(tmp_path, seed):
    building = make_building(seed)
    path = tmp_path / "building.xml"
    path.write_text(building.mjcf(), encoding="utf-8")
    config = parse_config({"scene": {"path": str(path)}, **building.settings(0.2)})
    report = assert_true(navbake.bake(config), config, paths=5)
    assert report.total.disputed == 0
