"""Verification of grids: it agrees with true ones, and says what it was asked."""

from __future__ import annotations

import json
import warnings

import mujoco
import numpy as np
import pytest
import trimesh

import navbake
from box_worlds import body, box, world
from door_scenes import LEAF, ROOMS
from door_scenes import world as door_world
from navbake.errors import ConfigError, QueryError
from navbake.testing import assert_true
from navbake.verifier import report as kinds
from navbake.verifier.probes import TOUCHES, ObstacleProbe
from verified_scenes import ROOM, copy_of, mesh_room, of_room, write

# attributes and joints of the body of a leaf that no single hinge or slide moves
LEAVES_WITHOUT_A_SINGLE_JOINT = {
    "no joint": ("", ""),
    "mocap": ('mocap="true"', ""),
    "free joint": ("", "<freejoint/>"),
    "ball": ("", '<joint type="ball"/>'),
    "two hinges": (
        "",
        '<joint name="a" axis="0 0 1" range="0 90"/>'
        '<joint name="b" axis="0 0 1" pos="0 0.88 0" range="0 90"/>',
    ),
}

# ---------------------------------------------------------------- what is true


@pytest.mark.parametrize("agent", [{}, {"radius": 0.2}, {"radius": 0.3, "height": 0.5}])
def test_agrees_with_a_room_of_all_solids(tmp_path, agent):
    grid, config = of_room(tmp_path, agent=agent)
    report = assert_true(grid, config)
    assert report.checked == grid.width * grid.height
    counts = report.levels[0]
    assert counts.free_free == int(grid.free.sum())
    assert counts.free_free + counts.blocked_blocked == report.checked
    assert counts.floors == int((~np.isnan(grid.floor_height)).sum())
    assert counts.disputed == 0


def test_agrees_with_stairs_and_with_paths_on_them(house):
    grid, config = house
    report = assert_true(grid, config, paths=5)
    assert report.sweeps.paths == 5 and report.sweeps.length > 5
    assert report.total.cells == sum(level.width * level.height for level in grid.levels)


@pytest.mark.parametrize("radius", [0.1, 0.25])
def test_agrees_with_inflated_grids(tmp_path, house, radius):
    for grid, config in (of_room(tmp_path), house):
        inflated = grid.inflate(radius)
        report = assert_true(inflated, config, paths=3)
        assert report.radius == radius == report.sweeps.radius
        # so does what is inflated for it
        again = assert_true(grid, config, radius=radius)
        assert again.levels == report.levels


@pytest.mark.parametrize("state", ["modelled", "open", "closed", "removed"])
def test_doors_stand_as_the_grid_says(tmp_path, state):
    path = write(tmp_path, door_world(ROOMS, LEAF))
    grid = navbake.bake({"scene": {"path": str(path)}})
    assert len(grid.doors) == 1
    turned = grid.with_doors(state)
    assert_true(turned, path)
    if state in ("open", "removed"):
        # the grid with the closed door isn't true of the open one
        metadata = turned.metadata
        wrong = grid.with_layers(metadata=metadata)
        found = navbake.verify(wrong, path)
        assert {kinds.BLOCKED_APART} <= {f.kind for f in found.findings}


@pytest.mark.parametrize("state", ["modelled", "open", "closed", "removed"])
@pytest.mark.parametrize("kind", LEAVES_WITHOUT_A_SINGLE_JOINT)
def test_open_doors_without_a_single_joint_are_taken_out_as_in_a_bake(kind, state):
    """As the warning of the bake says, too."""
    attributes, content = LEAVES_WITHOUT_A_SINGLE_JOINT[kind]
    leaf = f'<body name="leaf" pos="3 1.06 0" {attributes}>{content}'
    leaf += '<geom type="box" pos="0 0.44 1" size="0.02 0.43 1"/></body>'
    model = mujoco.MjModel.from_xml_string(door_world(ROOMS, leaf))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        grid = navbake.bake(model, doors={"patterns": ["leaf"], "state": state})
    assert [(door.id, door.joint, door.state) for door in grid.doors] == [("leaf", None, state)]
    is_way_free = state in ("open", "removed")
    assert grid.at((3.0, 1.5)).free == is_way_free
    is_told = any("not moved by exactly one hinge or slide" in str(text.message) for text in told)
    assert is_told == (state == "open")
    assert_true(grid, model)
    baked_as_modelled = navbake.bake(model, doors={"patterns": ["leaf"]})
    assert_true(baked_as_modelled.with_doors(state), model)


def test_meshes_count_as_they_are_baked(tmp_path):
    """A closed box is solid, the same without its lid is none; and a mesh file is a scene."""
    grid, config = mesh_room(tmp_path)
    report = assert_true(grid, config)
    assert any("by the surface" in note for note in report.notes)
    # inside of the closed part, the floor is blocked, though no surface is near
    for x, y, occupied in ((0.65, -0.9, 1), (-1.15, 0.75, 0)):
        assert grid.occupancy[tuple(grid.lattice.rows_cols([x, y]))] == occupied


def test_walls_may_stand_on_a_slab_of_their_own_mesh(tmp_path):
    """Their undersides lie on its top: of two faces in one place, a ray meets only one."""
    sides = [((0, 0, -0.1), (4, 3, 0)), ((0, 0, 0), (4, 0.5, 2)), ((1, 1, 0), (2, 2, 0.7))]
    parts = [trimesh.creation.box(bounds=bounds) for bounds in sides]
    # a slab on the wall, too: from inside of it, one leaves the wall where one enters the slab
    parts.append(trimesh.creation.box(bounds=((0, 0, 2), (4, 0.5, 2.2))))
    trimesh.util.concatenate(parts).export(tmp_path / "room.obj")
    config = {"scene": {"path": str(tmp_path / "room.obj")}}
    grid = navbake.bake(config)
    report = assert_true(grid, config)
    assert report.levels[0].floors == 40 * 30
    wrong = copy_of(grid)
    row, col = (int(v) for v in grid.lattice.rows_cols([2.05, 0.25]))
    assert not grid.free[row, col]
    wrong.weights[row, col] = 1.0
    (found,) = navbake.verify(wrong, config).findings
    assert (found.kind, found.cell) == (kinds.FREE_TOUCHES, (row, col))


def test_cracks_are_as_wide_as_the_settings_say(tmp_path):
    parts = box("floor", 0, 0, -0.1, 1.01, 2, 0) + box("other", 1.09, 0, -0.1, 3, 2, 0)
    config = {"scene": {"path": str(write(tmp_path, world(parts)))}, "floors": {"crack": 0.1}}
    grid = navbake.bake(config)
    assert assert_true(grid, config).levels[0].in_cracks == 20
    report = navbake.verify(grid, {**config, "floors": {}})
    assert {found.kind for found in report.findings} == {kinds.FLOOR_OFF}
    assert any("settings are others" in note for note in report.notes)


@pytest.mark.parametrize("tilt", [0, 25])
def test_a_crack_beside_a_slope_may_have_any_height(tmp_path, tilt):
    """The line that was baked lies at the crack's edge, of which no line here is sure to be."""
    slabs = "".join(
        f'<geom type="box" size="1 1.5 0.05" pos="{x} 0 0" euler="0 0 7"/>' for x in (-1.013, 1.012)
    )
    scene = world(f'<body euler="0 {tilt} 0">{slabs}</body>')
    path = write(tmp_path, scene.replace("<mujoco>", '<mujoco><compiler angle="degree"/>'))
    config = {"scene": {"path": str(path)}, "grid": {"cell_size": 0.05}}
    grid = navbake.bake(config)
    assert assert_true(grid, config).levels[0].in_cracks > 3
    raised = grid.with_layers(
        attributes={**grid.attributes, "floorHeight": grid.floor_height + np.float32(0.02)}
    )
    counts = navbake.verify(raised, config, sample=400).levels[0]
    assert counts.floors_off > 0.98 * counts.floors


def test_part_of_a_scene_and_movable_bodies(tmp_path):
    cart = body("cart", '<freejoint/><geom type="box" size="0.2 0.2 0.4" pos="0 0 0.5"/>')
    path = write(tmp_path, world(ROOM + cart))
    config = {
        "scene": {"path": str(path), "exclude": {"movable": True, "geoms": ["ball"]}},
        "grid": {"bounds": [-1.5, -1.5, 0.6, 1.2]},
    }
    grid = navbake.bake(config)
    assert_true(grid, config)
    # the grid states what was left out, so the scene's file alone will do
    assert_true(grid, path)
    assert not navbake.verify(grid, {"scene": {"path": str(path)}}).ok


@pytest.mark.parametrize("seed", range(3))
def test_paths_through_corners_of_cells_and_over_links(house, seed):
    """A line through a corner is in none of the cells beside, and a step up has no length."""
    grid, config = house
    report = navbake.verify(grid, config, sample=1, radius=0.1, paths=20, seed=seed)
    assert report.ok and report.sweeps.paths == 20


# ---------------------------------------------------------------- samples, reports


def test_a_sample_is_drawn_by_its_seed(room):
    grid, config = room
    one, same, other = (navbake.verify(grid, config, sample=100, seed=s) for s in (1, 1, 2))
    assert one.checked == 100 and one.to_json() == same.to_json() and one.digest == same.digest
    assert one.digest != other.digest
    assert json.loads(json.dumps(one.to_json(), allow_nan=False))["ok"] is True


def test_assert_true_says_where(room):
    grid, config = room
    wrong = copy_of(grid)
    wrong.levels[0].weights[grid.occupancy == 1] = 1.0
    with pytest.raises(AssertionError, match=r"(?s)free cell touches, level 0, .*and \d+ more"):
        assert_true(wrong, config)


def test_what_is_blocked_for_a_while_is_left_out(room):
    grid, config = room
    with grid.block(disc=((0.0, 0.0), 0.3)):
        report = assert_true(grid, config)
    assert "blocked at run time" in report.notes[0]


# ---------------------------------------------------------------- bad input


def test_a_scene_is_needed(tmp_path, monkeypatch):
    grid, _ = of_room(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert_true(grid)  # its file is here, by the name that the grid states
    grid.save(tmp_path / "room.grid.json")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert_true(tmp_path / "room.grid.json")  # or beside the grid
    with pytest.raises(
        QueryError, match=r"scene\.xml that scene was baked from isn't in the current folder"
    ):
        navbake.verify(grid)
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scene.xml").rename(tmp_path / "scenes" / "scene.xml")
    assert_true(tmp_path / "room.grid.json")  # or in a folder for scenes
    (tmp_path / "scenes" / "scene.xml").rename(tmp_path / "scene.xml")
    (tmp_path / "scene.xml").rename(tmp_path / "moved.xml")
    with pytest.raises(
        QueryError, match=r"isn't in .* or the current folder, nor in 'scenes' there: give its path"
    ):
        navbake.verify(tmp_path / "room.grid.json")
    with pytest.raises(QueryError, match=r"no scene at .*scene\.xml: it may have moved"):
        navbake.verify(grid, tmp_path / "scene.xml")
    del grid.metadata["navbake"]["settings"]
    with pytest.raises(QueryError, match="doesn't say which scene it was baked from"):
        navbake.verify(grid)


def test_another_scene_is_refused(tmp_path, room):
    grid, _ = room
    other = write(tmp_path, world(ROOM.replace("1.2 -1.3", "1.0 -1.1")), "other.xml")
    with pytest.raises(
        QueryError, match=r"other\.xml isn't the scene that the grid was baked from"
    ):
        navbake.verify(grid, other)
    report = navbake.verify(grid, other, force=True)
    assert not report.ok and "isn't the scene" in report.notes[0]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"sample": 0}, "a sample of at least 1 cell, got 0"),
        ({"sample": "x"}, "a sample of at least 1 cell, got 'x'"),
        ({"sample": True}, "a sample of at least 1 cell, got True"),
        ({"radius": -0.1}, "radius >= 0 m"),
        ({"radius": "0.1"}, "radius >= 0 m, got '0.1'"),
        ({"radius": np.nan}, "radius >= 0 m, got nan"),
        ({"radius": 20_000.0}, "0 to 10,000 m as radius"),
        ({"tolerance": 0.0}, "tolerance > 0 m"),
        ({"tolerance": None}, "tolerance > 0 m, got None"),
        ({"tolerance": 0.026}, r"at most 0\.025 m, got 0\.026: .* half of a cell's width"),
        ({"paths": -1}, "paths >= 0"),
        ({"paths": 1.5}, r"paths >= 0, got 1\.5"),
        ({"seed": -1}, "whole number >= 0 as seed, got -1"),
    ],
)
def test_options_have_ranges(options, text, room):
    grid, config = room
    with pytest.raises(QueryError, match=text):
        navbake.verify(grid, config, **options)


# ---------------------------------------------------------------- the setting of the bake


def test_a_bake_verifies_its_grid(tmp_path):
    grid, config = of_room(tmp_path, verify={"sample": 300})
    stated = grid.navbake["verified"]
    report = navbake.verify(grid, config, sample=300)
    assert stated == {"sample": 300, "cells": 300, "disagreements": 0, "digest": report.digest}
    without, _ = of_room(tmp_path)
    assert "verified" not in without.navbake
    assert without.navbake["settingsDigest"] == grid.navbake["settingsDigest"]
    np.testing.assert_array_equal(without.weights, grid.weights)


@pytest.mark.parametrize("sample", [0, 1.5, "all"])
def test_the_setting_has_a_range(tmp_path, sample):
    with pytest.raises(ConfigError, match=r"a whole number >= 1, or null, got .* `verify\.sample`"):
        of_room(tmp_path, verify={"sample": sample})


def test_a_bake_warns_where_it_disagrees(tmp_path, monkeypatch):
    """MuJoCo and FCL are made to find everything touching."""
    monkeypatch.setattr(ObstacleProbe, "find_contact", lambda *_: TOUCHES)
    with pytest.warns(
        navbake.BakeWarning, match=r"verify: MuJoCo and FCL disagree .* at \d+ places"
    ):
        grid, _ = of_room(tmp_path, verify={"sample": 300})
    assert grid.navbake["verified"]["disagreements"] > 0
    assert any("navbake verify lists them" in warning for warning in grid.warnings)
