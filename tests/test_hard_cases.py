"""Small scenes on which heuristics for floors and levels go wrong easily, and random variants.

Scenes that stand here are built from boxes; those of `SHARED_DATA` are baked where they are.
"""

from __future__ import annotations

import os
from random import Random

import numpy as np
import pytest

from box_worlds import box, world
from buildings.make import make_building
from buildings.truth import check
from navbake.baker.pipeline import run_bake
from navbake.config.settings import parse_config
from navbake.navgrid.islands import find_islands
from project_paths import SHARED_DATA

SEEDS = range(int(os.environ.get("NAVBAKE_EXAMPLES", "12")))
CASES = SHARED_DATA / "hard_cases"
SLAB = box("", -2, -2, -0.2, 2, 2, 0)
ONE_LEVEL = ("4_garage", "4b_rack", "11_closet_with_beam", "14_panel_and_barn")


def baked(folder, xml, cell=0.1):
    path = folder / "scene.xml"
    path.write_text(xml, encoding="utf-8")
    return run_bake(parse_config({"scene": {"path": str(path)}, "grid": {"cell_size": cell}})).grid


@pytest.mark.parametrize("seed", SEEDS)
def test_building_is_as_a_person_would_say(tmp_path, seed):
    building = make_building(seed)
    path = tmp_path / "building.xml"
    path.write_text(building.mjcf(), encoding="utf-8")
    settings = {"scene": {"path": str(path)}, **building.settings(0.15)}
    assert check(run_bake(parse_config(settings)).grid, building) == []


@pytest.mark.parametrize("millimetres", Random(0).sample(range(-1500, 1500, 10), 4))
@pytest.mark.parametrize("past", [0, 1])
def test_wall_without_thickness_parts_the_floor(tmp_path, millimetres, past):
    x = (millimetres + past) / 1000
    wall = f'<geom type="plane" size="2.5 2.5 .1" pos="{x} 0 1" zaxis="1 0 0"/>'
    level = baked(tmp_path, world(SLAB + wall)).levels[0]
    island = find_islands(level)[0]
    row, (left, right) = level.height // 2, (2, level.width - 3)
    assert island[row, left] > 0 and island[row, right] > 0
    assert island[row, left] != island[row, right]


@pytest.mark.parametrize("end", [-0.002, -0.001, 0.0, 0.001, 0.002])
@pytest.mark.parametrize("slab", [0.02, 0.1, 0.3])
def test_house_on_its_slab_is_a_floor(tmp_path, slab, end):
    top = 2.6 + end
    parts = [
        box("", -3, -3, -0.1, 9, 9, 0),
        box("", 0, 0, 0, 6, 6, slab),
        *(box("", *a, slab, *b, top) for a, b in (
            ((0, 0), (2.5, 0.15)), ((3.5, 0), (6, 0.15)), ((0, 5.85), (6, 6)),
            ((0, 0.15), (0.15, 5.85)), ((5.85, 0.15), (6, 5.85)),
        )),
        box("", 0, 0, 2.6, 6, 6, 2.8),
    ]  # fmt: skip
    grid = baked(tmp_path, world("".join(parts)))
    assert len(grid.levels) == 1
    floor = grid.levels[0].floor_height
    inside = grid.levels[0].free & (np.abs(floor - slab) < 1e-4)
    assert inside.sum() * 0.01 == pytest.approx(5.7**2, rel=0.04)


@pytest.mark.skipif(not CASES.is_dir(), reason="needs the scenes of hard_cases")
@pytest.mark.parametrize("name", ONE_LEVEL)
def test_shared_scene_has_one_level(name):
    config = parse_config({"scene": {"path": str(CASES / f"{name}.xml")}})
    assert len(run_bake(config).grid.levels) == 1
