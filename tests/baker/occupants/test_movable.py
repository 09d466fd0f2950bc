"""What can move, over the floors of what stands: which cells it occupies, and which it takes."""

from __future__ import annotations

import random
from pathlib import Path

import mujoco
import numpy as np
import pytest

import navbake
from box_worlds import FLOOR, body, box, stages_of_xml, world
from navbake.baker.bake.stages import Stages, bake_stages
from navbake.baker.doors.doors import mark_obstacle_geoms
from navbake.baker.occupancy.volume_kernels import BLOCKING
from navbake.baker.occupants.movable import ROWS_PER_CHUNK, find_movable_occupants
from random_scenes import make_scene

pytestmark = pytest.mark.filterwarnings("ignore::navbake.BakeWarning")


def free(name: str, content: str) -> str:
    return body(name, "<freejoint/>" + content)


def random_stages(seed: int) -> Stages:
    """The stages of a random scene that has a floor."""
    rng = random.Random(f"occupants {seed}")
    while True:
        xml, settings = make_scene(rng)
        try:
            stages = bake_stages(mujoco.MjModel.from_xml_string(xml), **settings)
            assert stages.occupants
        except (ValueError, navbake.SceneError):
            continue
        return stages


def listed(stages: Stages, level: int) -> list[tuple[int, int, int]]:
    """The cell, geom and flags of each entry of a level."""
    rows = []
    for band in stages.occupants.entries[level]:
        rows += zip(band.cell.tolist(), band.geom.tolist(), band.flags.tolist(), strict=True)
    return rows


@pytest.mark.parametrize("seed", range(12))
def test_entries_are_sorted_and_of_what_is_in_the_way(seed):
    stages = random_stages(seed)
    is_obstacle_geom = mark_obstacle_geoms(stages.scene, stages.doors, stages.config)
    width = stages.lattice.width
    for number, level in enumerate(stages.floors.levels):
        rows = listed(stages, number)
        pairs = [(cell, geom) for cell, geom, _ in rows]
        assert pairs == sorted(set(pairs))
        for cell, geom, flags in rows:
            assert not np.isnan(level.floor.flat[cell])
            assert is_obstacle_geom[geom]
            assert flags
        for number_of_band, band in enumerate(stages.occupants.entries[number]):
            assert (band.cell // (ROWS_PER_CHUNK * width) == number_of_band).all()


@pytest.mark.parametrize("seed", range(12))
def test_cells_are_occupied_by_what_stands_or_blocks_them(seed):
    stages = random_stages(seed)
    for number, standing in enumerate(stages.occupancy.levels):
        expected = standing.copy()
        for cell, _, flags in listed(stages, number):
            if flags & BLOCKING:
                expected.flat[cell] = True
        np.testing.assert_array_equal(stages.occupants.blocked[number], expected)


@pytest.mark.parametrize("seed", range(12))
def test_a_body_takes_the_cells_that_it_blocks_and_nothing_standing_does(seed):
    stages = random_stages(seed)
    mover_of_geom = stages.scene.mover_of_geom
    taken = set()
    for number, standing in enumerate(stages.occupancy.levels):
        for cell, geom, flags in listed(stages, number):
            if flags & BLOCKING and not standing.flat[cell]:
                taken.add((number, cell, int(mover_of_geom[geom])))
    expected = np.zeros(len(stages.occupants.num_free_cells_blocked), dtype=np.int64)
    for _, _, mover in taken:
        expected[mover] += 1
    np.testing.assert_array_equal(stages.occupants.num_free_cells_blocked, expected)


@pytest.mark.parametrize("seed", range(6))
def test_what_moves_is_found_as_if_it_stood(seed):
    """The same boxes, welded to the world, over the same floors."""
    rng = np.random.default_rng(seed)
    things = []
    for number in range(5):
        x, y, z = rng.uniform([-1.8, -1.8, 0], [1.3, 1.3, 1.5])
        wide, deep, high = rng.uniform(0.1, 0.5, 3)
        things.append(box(f"thing {number}", x, y, z, x + wide, y + deep, z + high))
    moving = "".join(free(f"body {k}", thing) for k, thing in enumerate(things))
    model = mujoco.MjModel.from_xml_string(world(FLOOR + moving))
    standing = mujoco.MjModel.from_xml_string(world(FLOOR + "".join(things)))
    one = navbake.bake(model)
    other = navbake.bake(standing, grid={"bounds": [-2, -2, 2, 2]})
    # low tops are floors there
    same = other.floor_height == 0.0
    assert same.mean() > 0.95
    np.testing.assert_array_equal(one.occupancy[same], other.occupancy[same])


def test_a_cup_on_a_table_that_stands_takes_nothing(tmp_path: Path):
    table = box("table", 0, 0, 0, 1, 1, 0.7)
    cup = free("cup", box("cup", 0.3, 0.3, 0.7, 0.5, 0.5, 0.9))
    stages = stages_of_xml(tmp_path, world(FLOOR + table + cup))
    assert not stages.occupants.num_free_cells_blocked.any()
    assert listed(stages, 0)


def test_nothing_is_looked_for_where_nothing_moves(tmp_path: Path):
    stages = stages_of_xml(tmp_path, world(FLOOR + box("table", 0, 0, 0, 1, 1, 0.7)))
    occupants = stages.occupants
    assert not occupants.num_free_cells_blocked.any()
    assert listed(stages, 0) == []
    # and the layers are copies of those of what stands, as updates write to them
    assert np.array_equal(occupants.blocked[0], stages.occupancy.levels[0])
    assert not np.shares_memory(occupants.blocked[0], stages.occupancy.levels[0])


def test_both_ways_to_cast_columns_find_the_same(monkeypatch):
    for seed in range(4):
        stages = random_stages(seed)
        is_obstacle_geom = mark_obstacle_geoms(stages.scene, stages.doors, stages.config)
        found = []
        for most in (0.0, 2.0):
            monkeypatch.setattr("navbake.baker.occupants.movable.MAX_SHARE_OF_SINGLE_CELLS", most)
            found.append(
                find_movable_occupants(stages.movable_inputs, stages.scene.shapes, is_obstacle_geom)
            )
        one, other = found
        for number in range(len(stages.floors.levels)):
            np.testing.assert_array_equal(one.blocked[number], other.blocked[number])
            for left, right in zip(one.entries[number], other.entries[number], strict=True):
                assert all(map(np.array_equal, left, right))
        np.testing.assert_array_equal(one.num_free_cells_blocked, other.num_free_cells_blocked)
