"""Generated buildings: each storey, floor and connection as a person would say."""

from __future__ import annotations

import os
import re
from itertools import pairwise

import numpy as np
import pytest

from buildings.kinds import KINDS, POSES, make_any
from buildings.make import make_building
from buildings.truth import check
from navbake.baker.bake.pipeline import BakeResult, run_bake
from navbake.config.settings import parse_config
from original_client import look_up

SEEDS = range(int(os.environ.get("NAVBAKE_EXAMPLES", "30")))


@pytest.mark.parametrize("seed", SEEDS)
def test_building_is_as_a_person_would_say(tmp_path, seed):
    building = make_building(seed)
    path = tmp_path / "building.xml"
    path.write_text(building.mjcf(), encoding="utf-8")
    settings = {"scene": {"path": str(path)}, **building.settings(0.15)}
    result = run_bake(parse_config(settings))
    assert check(result.grid, building) == []
    check_client(result)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("kind", KINDS)
def test_building_of_another_kind(tmp_path, kind, pose):
    building = make_any(7, kind=kind, pose=pose)
    path = tmp_path / "building.xml"
    path.write_text(building.mjcf(), encoding="utf-8")
    result = run_bake(parse_config({"scene": {"path": str(path)}, **building.settings(0.1)}))
    assert check(result.grid, building) == []


@pytest.mark.parametrize("seed", range(100, 112))
def test_building_on_round_coordinates(tmp_path, seed):
    """Centres of cells lie on the faces of walls, treads and slabs."""
    building = make_building(seed, coordinates="round", storeys="3")
    path = tmp_path / "building.xml"
    path.write_text(building.mjcf(), encoding="utf-8")
    result = run_bake(parse_config({"scene": {"path": str(path)}, **building.settings(0.1)}))
    assert check(result.grid, building) == []


def check_client(result: BakeResult) -> None:
    """The original client finds each free cell's own level, or a warning says of how many not."""
    found = look_up(result.grid)
    assert look_up(result.grid, by_cells=True) == found
    told = [int(n) for n in re.findall(r"misses (\d+) of", "\n".join(result.warnings))]
    assert told == ([found.lost] if found.lost else [])
    heights = [level.floor_height[level.free] for level in result.grid.levels]
    ends = [(floor.min(), floor.max()) for floor in heights]
    parted = all(low[1] < high[0] for low, high in pairwise(ends))
    assert not (parted and found.lost)
    assert found.free == sum(np.count_nonzero(level.free) for level in result.grid.levels)
