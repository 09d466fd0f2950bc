"""Flights in a small grid that follows a robot: as in a grid of the whole scene, and refreshed."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import navbake
from navbake.errors import QueryError

# a corridor of 6 m with a wall across it, in which a slide opens a window of 1 m
CORRIDOR = """
<mujoco><worldbody>
  <geom type="box" size="3 1 0.1" pos="3 0 -0.1"/>
  <geom type="box" size="3 0.1 1" pos="3 1.1 1"/>
  <geom type="box" size="3 0.1 1" pos="3 -1.1 1"/>
  <geom type="box" size="3 1.2 0.1" pos="3 0 2.1"/>
  <geom type="box" size="0.1 1 0.5" pos="3 0 0.5"/>
  <geom type="box" size="0.1 0.5 0.5" pos="3 0.5 1.5"/>
  <body name="slide" pos="3 -0.5 1.5">
    <joint name="slide" type="slide" axis="0 1 0"/>
    <geom type="box" size="0.1 0.5 0.5"/>
  </body>
  <body name="drone" pos="0.5 0 1"><joint type="free"/><geom size="0.1"/></body>
</worldbody></mujoco>
"""
GOAL = (5.5, 0.0, 1.0)


@pytest.fixture
def scene():
    model = mujoco.MjModel.from_xml_string(CORRIDOR)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def move_slide(model, data, offset):
    data.joint("slide").qpos[0] = offset
    mujoco.mj_forward(model, data)


def test_it_flies_on_to_a_goal_beyond_the_grid_when_a_window_opens(scene):
    model, data = scene
    voxelizer = navbake.Voxelizer(model, data, ignore=["drone"])
    local = navbake.LocalFlight(voxelizer, (30, 30, 24), res=0.1, radius=0.2)
    position = np.array([0.5, 0.0, 1.0])
    for _ in range(12):  # closed: up to the wall, and no further
        path = local.update(position, GOAL, data=data)
        position = path.at(0.4)
    assert 2.5 < position[0] < 2.9 - 0.2 + 1e-6
    move_slide(model, data, 1.0)
    for _ in range(20):
        path = local.update(position, GOAL, data=data)
        assert local.finder.voxels.shape == (30, 30, 24)
        assert (path.positions[0] == position).all()
        position = path.at(0.4)
    assert position == pytest.approx(GOAL)


def test_its_paths_are_those_of_a_finder_made_anew(scene):
    model, data = scene
    voxelizer = navbake.Voxelizer(model, data, ignore=["drone"])
    local = navbake.LocalFlight(voxelizer, (40, 30, 24), res=0.1, radius=0.2, max_height=1.6)
    for offset, x in ((0.0, 1.0), (1.0, 2.2), (0.5, 3.8)):
        move_slide(model, data, offset)
        position = (x, 0.1, 1.0)
        goal = (x + 1.2, -0.5, 1.2)
        path = local.update(position, goal, data=data)
        voxels = voxelizer.create(position, (40, 30, 24), res=0.1, align=True)
        fresh = navbake.VoxelFinder(voxels, 0.2, max_height=1.6)
        assert (fresh.islands.labels == local.finder.islands.labels).all()
        expected = fresh.find_path(position, goal)
        if expected is not None:
            assert (path.positions == expected.positions).all() and path.cost == expected.cost


def test_a_robot_that_is_too_near_to_something_gets_no_path(scene):
    local = navbake.LocalFlight(navbake.Voxelizer(*scene), (20, 20, 20), res=0.1, radius=0.2)
    assert local.update((1.0, 0.95, 1.0), GOAL) is None
    assert "nearest occupied voxel" in local.finder.why_not((1.0, 0.95, 1.0), GOAL)
    with pytest.raises(QueryError, match=r"expected voxels of 0\.1 m, got 0\.2 m"):
        local.finder.use(navbake.Voxelizer(*scene).create(res=0.2))
