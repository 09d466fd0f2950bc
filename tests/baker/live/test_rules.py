"""What updates rest on, each by a scene in which it would not hold if a rule were forgotten."""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import navbake
from differences import first_difference, fresh
from navbake.baker.live import baker as module

sys.path.insert(0, str(Path(__file__).parents[3] / "scripts"))

from sweep_moves import ROOM

pytestmark = pytest.mark.filterwarnings("ignore::navbake.BakeWarning")

FLOOR = '<geom name="floor" type="box" pos="3 3 -0.1" size="3 3 0.1"/>'
# the highest thing, so that nothing that moves is
MAST = '<geom name="mast" type="box" pos="0.1 0.1 1.6" size="0.1 0.1 1.6"/>'


def make(bodies: str, assets: str = "") -> mujoco.MjModel:
    """A floor of 6 x 6 m with some bodies."""
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{assets}</asset><worldbody>{FLOOR}{MAST}{bodies}</worldbody></mujoco>"
    )


def check(baker: navbake.Baker, settings: dict, **moves) -> str:
    """Update, and hold the grid against a fresh bake; gives why all was baked again."""
    changes = baker.update(**moves)
    assert first_difference(changes.grid, fresh(baker, **settings)) is None
    return changes.reason


@pytest.mark.parametrize("named", [False, True])
def test_many_geoms_appear(named):
    plates = "".join(
        f'<geom type="box" size="0.4 0.4 0.005" pos="{x} {y} {0.1 + 0.02 * k}"/>'
        for x in (1.5, 3.0, 4.5)
        for y in (1.5, 3.0, 4.5)
        for k in range(60)
    )
    model = make(f'<body name="racks" mocap="true">{plates}</body>')
    own = model.geom_bodyid == model.body("racks").id
    model.geom_contype[own] = model.geom_conaffinity[own] = 0
    settings = {"names": {"enabled": named}} | ({} if named else {"rooms": {"sources": []}})
    baker = navbake.Baker(model, **settings)
    before, names = baker.grid, dict(navbake.Baker(model, **settings).grid.user_data)
    model.geom_contype[own] = 1
    assert check(baker, settings) == ""
    assert dict(before.user_data) == names  # read only now


def test_boxes_as_large_as_floors_move_over_one_another():
    bodies = "".join(
        f'<body name="box_{k}" pos="{1 + k} 2 0.1"><freejoint/>'
        f'<geom type="box" size="0.5 0.4 {0.05 + 0.05 * k}"/></body>'
        for k in range(4)
    )
    baker, rng = navbake.Baker(make(bodies)), np.random.default_rng(0)
    for _ in range(12):
        place = [*rng.uniform(0.5, 5.5, 2), rng.choice([0.05, 0.1, 0.3])]
        assert check(baker, {}, bodies={f"box_{rng.integers(4)}": place}) == ""
        assert (baker.grid.floor_height == 0.0).all()


def test_a_platform_that_is_lifted_is_named_as_before():
    bodies = "".join(
        f'<body name="platform_{x}" pos="{x} 3 0.05"><freejoint/>'
        f'<geom type="box" size="0.75 0.75 0.05"/></body>'
        for x in (2.25, 3.75)
    )
    baker = navbake.Baker(make(bodies))
    for z in (0.07, 0.05, 0.09):
        assert check(baker, {}, bodies={"platform_2.25": [2.25, 3, z]}) == ""


def test_tables_that_are_put_together_are_no_floor():
    # of what stands, they would be one: 9 rows of 5, 5 and 10 cells
    parks = ((1.0, 5.2), (3.0, 5.2), (3.0, 1.0))
    lengths = (0.5, 0.5, 1.0)
    plates = "".join(
        f'<body name="plate_{k}" pos="{x} {y} 0.4"><freejoint/>'
        f'<geom type="box" size="{length / 2} 0.45 0.05"/></body>'
        for k, ((x, y), length) in enumerate(zip(parks, lengths, strict=True))
    )
    settings = {"floors": {"shrink": 0.1, "tops": True}}
    baker, x = navbake.Baker(make(plates), **settings), 0.7
    for k, length in enumerate(lengths):
        reason = check(baker, settings, bodies={f"plate_{k}": [x + length / 2, 3.05, 0.4]})
        assert reason == ""
        assert len(baker.grid.levels) == 1
        assert (baker.grid.floor_height == 0.0).all()
        x += length


def test_a_step_that_is_brought_leads_to_no_floor():
    """One that stood would make a floor of the tables' tops."""
    tables = "".join(
        f'<geom name="table_{k}" type="box" pos="{x} 3 {top / 2}" size="0.45 1.6 {top / 2}"/>'
        for k, (x, top) in enumerate(((2.55, 0.7), (3.45, 1.0)))
    )
    step = '<body name="step" pos="5 5 0.05"><freejoint/><geom type="box" size="0.1 0.1 0.05"/>'
    settings = {
        "floors": {"min_area": 2.5, "tops": True},
        "agent": {"traversable_floor_height": 0.2},
    }
    baker = navbake.Baker(make(f"{tables}{step}</body>"), **settings)
    floor = baker.grid.floor_height.copy()
    for place in ([2.9, 4.5, 0.8], [5.0, 5.0, 0.05]):
        assert check(baker, settings, bodies={"step": place}) == ""
        np.testing.assert_array_equal(baker.grid.floor_height, floor)


def test_a_door_sees_as_far_as_its_agent_is_wide():
    door = '<body name="door" pos="3 2.5 1"><joint name="hinge" axis="0 0 1" range="0 1.5"/>'
    door += '<geom type="box" pos="0 0.5 0" size="0.02 0.5 1"/></body>'
    box = '<body name="box" pos="5.5 5.5 0.3"><freejoint/><geom type="box" size="0.05 0.05 0.3"/>'
    settings = {"agent": {"radius": 1.2}, "doors": {"patterns": ["door"]}}
    baker = navbake.Baker(make(f"{door}{box}</body>"), **settings)
    assert [found.id for found in baker.grid.doors] == ["door"]
    for x in (5.3, 5.25, 5.2, 5.5):
        check(baker, settings, bodies={"box": [x, 3.0, 0.3]})


def test_how_a_door_turns_is_written_into_the_model():
    door = '<body name="door" pos="3 2.5 1"><joint name="hinge" axis="0 0 1" range="0 1.5"/>'
    door += '<geom type="box" pos="0 0.5 0" size="0.02 0.5 1"/></body>'
    settings = {"doors": {"patterns": ["door"]}}
    baker = navbake.Baker(make(door), **settings)
    before = baker.grid.doors
    baker.model.jnt_range[0] = -1.5, 0.0
    check(baker, settings)
    assert baker.grid.doors != before
    baker.model.jnt_axis[0] = 0, 0, -1
    baker.model.jnt_pos[0] = 0, 1.0, 0
    check(baker, settings)


def test_a_marker_that_grows_makes_its_room_larger():
    site = '<site name="room_a" type="box" pos="1.5 3 1" size="1 1 1"/>'
    settings = {"rooms": {"sites": ["room_*"], "sources": ["sites", "auto"]}}
    baker = navbake.Baker(make(site), **settings)
    rooms = baker.grid.room_index.copy()
    baker.model.site_size[0, 0] = 1.4
    assert check(baker, settings) == "what marks rooms has changed"
    assert (baker.grid.room_index != rooms).any()


SHELL = (
    '<mesh name="house" vertex="0 0 0 3 0 0 3 3 0 0 3 0 0 0 2.4 3 0 2.4 3 3 2.4 0 3 2.4" '
    'face="0 1 5 0 5 4 1 2 6 1 6 5 2 3 7 2 7 6 3 0 4 3 4 7"/>'
)


def test_a_building_that_appears_is_one():
    house = '<geom name="house" type="mesh" mesh="house" pos="2 2 0" contype="0" conaffinity="0"/>'
    settings = {"scene": {"meshes": "shell"}, "grid": {"bounds": [0, 0, 6, 6]}}
    box = '<body name="box" pos="1 5 0.3"><freejoint/><geom type="box" size="0.2 0.2 0.3"/></body>'
    baker = navbake.Baker(make(house + box, SHELL), **settings)
    geom = baker.model.geom("house").id
    for shown in (1, 0, 1):
        baker.model.geom_contype[geom] = shown
        check(baker, settings)
        check(baker, settings, bodies={"box": [1.0 + shown, 5.0, 0.3]})


def test_a_scene_may_become_endless():
    strip = '<geom name="strip" type="plane" pos="3 3 0" size="0 3 1"/>'
    box = '<body name="box" pos="3 3 0.3"><freejoint/><geom type="box" size="0.3 0.3 0.3"/></body>'
    settings = {"grid": {"bounds": [0, 0, 6, 6]}}
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{strip}{box}</worldbody></mujoco>")
    baker = navbake.Baker(model, **settings)
    geom = int(model.body_geomadr[model.body("box").id])
    for shown in (0, 1):
        model.geom_contype[geom] = model.geom_conaffinity[geom] = shown
        check(baker, settings)
        check(baker, settings, bodies={"box": [2.0 + shown, 3.0, 0.3]})


CHAIR = '<body name="chair" pos="1 1 0.4"><freejoint/><geom type="box" size="0.2 0.2 0.4"/></body>'


@pytest.mark.parametrize("levels", [1, 2])
def test_a_grid_of_a_part_of_the_scene_is_followed(levels):
    loft = "".join(f'<geom type="box" pos="4.5 3 {z}" size="1.5 3 0.1"/>' for z in (2.5, 5.0))
    settings = {"grid": {"bounds": [2, 2, 5, 5]}, "floors": {"reach": "all"}}
    baker = navbake.Baker(make(CHAIR + loft * (levels - 1)), **settings)
    assert len(baker.grid.levels) == levels
    for place in ([3.0, 3.0, 0.4], [2.0, 2.5, 0.4], [0.5, 0.5, 0.4], [5.0, 3.0, 0.8]):
        assert check(baker, settings, bodies={"chair": place}) == ""


def test_what_looks_like_a_door_may_look_like_none():
    """A flap does while it stands, and may close a room then: so all is baked."""
    joint, flap = 'axis="0 0 1" range="0 1.6"', 'axis="0 1 0" range="0 1.6"'
    room = ROOM.format(bodies=CHAIR).replace(joint, flap)
    alone = room.replace('pos="3 2 1"', 'pos="4.5 2 1"')  # in the middle of a room
    for xml, doors in ((room, 1), (alone, 0)):
        baker = navbake.Baker(mujoco.MjModel.from_xml_string(xml))
        assert len(baker.grid.doors) == doors
        reasons = [check(baker, {}, joints={"hinge": angle}) for angle in (1.5, 0.0, 0.3, 0.0)]
        changed = "other bodies than before look like leaves of doors"
        assert reasons == [changed, changed, changed, changed]
        assert len(baker.grid.doors) == doors


def test_on_a_slope_without_end_only_what_is_near_is_baked():
    slope = '<geom name="slope" type="plane" pos="3 3 -0.4" size="0 0 1" euler="3 5 0"/>'
    settings = {"grid": {"bounds": [-1, -1, 7, 7]}}
    baker = navbake.Baker(make(CHAIR + slope), **settings)
    for place in ([-0.5, 1.0, 0.4], [-0.5, 1.0, 3.4]):
        assert check(baker, settings, bodies={"chair": place}) == ""


@pytest.mark.parametrize("where", ["build_grid", "_find_changed_cells"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_an_update_that_ends_early_leaves_the_grid(monkeypatch, where, error):
    baker = navbake.Baker(make(CHAIR))
    grid, pose = baker.grid, baker.pose

    def fail(*args):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(module, where, fail)
        with pytest.raises(error):
            baker.update(bodies={"chair": [3.0, 3.0, 0.4]})
    assert baker.grid is grid
    assert all(np.array_equal(*pair) for pair in zip(baker.pose, pose, strict=True))
    # where it was for a moment nothing is left of it
    assert check(baker, {}, bodies={"chair": [1.0, 1.5, 0.4]}) == "the last update failed"
    assert check(baker, {}, bodies={"chair": [1.0, 2.0, 0.4]}) == ""


def test_a_pose_that_nobody_can_bake_leaves_the_grid():
    baker = navbake.Baker(make(CHAIR))
    grid = baker.grid
    with pytest.raises(navbake.QueryError):
        baker.update(bodies={"chair": [np.nan, 1.0, 0.4]})
    baker.model.geom_pos[baker.model.geom("floor").id, 0] = 1e12
    with pytest.raises(navbake.NavbakeError):  # a grid of too many cells
        baker.update()
    assert baker.grid is grid
    baker.model.geom_pos[baker.model.geom("floor").id, 0] = 3.0
    check(baker, {}, bodies={"chair": [2.0, 1.0, 0.4]})


def test_two_updates_that_undo_each_other_leave_the_first_grid():
    baker = navbake.Baker(make(CHAIR))
    first = baker.grid
    for place in ([2.0, 2.0, 0.4], [1.0, 1.0, 0.4]):
        baker.update(bodies={"chair": place})
    assert first_difference(baker.grid, first) is None
