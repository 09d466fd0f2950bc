"""An update keeps what stands; where that has changed, the whole scene is baked, and told why."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import navbake
from differences import first_difference, fresh
from navbake.baker.live import baker as module
from navbake.baker.live import update

sys.path.insert(0, str(Path(__file__).parents[3] / "scripts"))

from sweep_moves import ROOM

pytestmark = pytest.mark.filterwarnings("ignore::navbake.BakeWarning")

FLOOR = '<geom name="floor" type="box" pos="3 3 -0.1" size="3 3 0.1"/>'
CHAIR = (
    '<body name="chair" pos="1 1 0.4"><freejoint/>'
    '<geom name="seat" type="box" size="0.2 0.2 0.4"/></body>'
)
GROUND = '<geom name="ground" type="plane" size="0 0 1" pos="0 0 -0.2"/>'
CEILING = '<geom name="ceiling" type="box" pos="3 3 2.6" size="3 3 0.1"/>'
UPPER = (
    '<geom name="upper" type="box" pos="3 3 2.9" size="3 3 0.1"/>'
    '<geom type="box" pos="3 0.05 4" size="3 0.05 1"/><geom type="box" pos="3 5.95 4" '
    'size="3 0.05 1"/><geom type="box" pos="0.05 3 4" size="0.05 3 1"/>'
    '<geom type="box" pos="5.95 3 4" size="0.05 3 1"/>'
)
UPPER_SLAB = '<geom type="box" pos="5 3 1.9" size="1 3 0.1"/>'
# The car of a lift between the floor and that slab
CAR = (
    '<body name="car" pos="3.3 3 0.05"><joint name="car" type="slide" axis="0 0 1" '
    'range="0 1.95" limited="true"/><geom type="box" size="0.6 0.6 0.05"/></body>'
)
# It only marks a room, as it can't collide; of a half width [m]
CARPET = (
    '<geom name="carpet" type="box" pos="1.5 3 0.001" size="{} 2.9 0.001" contype="0" '
    'conaffinity="0"/>'
)
# It is drawn, and can't collide, so that it counts nowhere
DECORATION = '<geom name="decoration" type="box" size="0.4 0.4 0.3" contype="0" conaffinity="0"/>'
CARPET_ROOM = {"rooms": {"geoms": ["carpet"], "sources": ["geoms", "auto"]}}
WIDER = {"grid": {"bounds": [-1, -1, 7, 7]}}


def make(content: str, assets: str = "") -> mujoco.MjModel:
    """A floor of 6 x 6 m, and what is on it."""
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{assets}</asset><worldbody>{FLOOR}{content}</worldbody></mujoco>"
    )


def check(baker: navbake.Baker, settings: dict[str, Any], **moves: Any) -> navbake.Changes:
    """Update, and hold the grid against a fresh bake."""
    changes = baker.update(**moves)
    assert first_difference(changes.grid, fresh(baker, **settings)) is None
    return changes


def check_local(baker: navbake.Baker, settings: dict[str, Any], **moves: Any) -> None:
    """Update near what moved alone: floors and rooms are the arrays that they were."""
    before = baker.grid
    changes = check(baker, settings, **moves)
    assert changes.reason == ""
    assert not changes.is_new
    for one, other in zip(before.levels, changes.grid.levels, strict=True):
        assert np.shares_memory(one.floor_height, other.floor_height)
        assert np.shares_memory(one.room_index, other.room_index)


# ---------------------------------------------------------------- updates stay local

SCENES = {
    "bare": (CHAIR, {}),
    "with a ceiling": (CHAIR + CEILING, {}),
    "ground beyond the floor": (CHAIR + GROUND, WIDER),
    "ground and ceiling": (CHAIR + GROUND + CEILING, WIDER),
    "two storeys": (CHAIR + UPPER, {}),
    "two storeys with ground and a roof": (
        CHAIR + UPPER + GROUND + CEILING.replace("2.6", "5.1").replace('"ceiling"', '"roof"'),
        WIDER,
    ),
    "a part of the scene": (CHAIR, {"grid": {"bounds": [2, 2, 5, 5]}}),
    "reached by steps": (CHAIR + UPPER, {"floors": {"reach": "steps"}}),
    "kept roofs and tops": (CHAIR + CEILING, {"floors": {"roofs": True, "tops": True}}),
    "without names": (CHAIR + CEILING, {"names": False}),
    "without rooms": (CHAIR + CEILING, {"rooms": "none"}),
    "with neither": (CHAIR + CEILING, {"rooms": "none", "names": False}),
    "a wide agent": (CHAIR + CEILING, {"agent": {"radius": 0.6}}),
    "with layers": (CHAIR + CEILING, {"attributes": ["island", "clearance"]}),
}
PLACES = ([3.0, 3.0, 0.4], [2.0, 2.5, 0.4], [5.5, 5.5, 0.4], [3.0, 3.0, 3.4], [2.0, 2.0, 2.6])


@pytest.mark.parametrize("kind", SCENES)
def test_a_chair_changes_nothing_that_stands(kind, monkeypatch):
    content, settings = SCENES[kind]
    standings = []
    build = module.build_grid

    def build_and_keep(config, standing, moving):
        standings.append(standing)
        return build(config, standing, moving)

    monkeypatch.setattr(module, "build_grid", build_and_keep)
    baker = navbake.Baker(make(content), **settings)
    levels = 2 if "two storeys" in kind or "roofs" in kind else 1
    assert len(baker.grid.levels) == levels
    for place in PLACES:
        check_local(baker, settings, bodies={"chair": place})
    assert len(standings) == 1 + len(PLACES)
    assert all(standing is standings[0] for standing in standings)


def test_no_stage_of_what_stands_runs_again(monkeypatch):
    baker = navbake.Baker(mujoco.MjModel.from_xml_string(ROOM.format(bodies=CHAIR)))
    with monkeypatch.context() as patch:
        # each would raise
        patch.setattr("navbake.baker.live.baker.open_stages", None)
        for name in (
            "find_scene_floors",
            "find_standing_cells",
            "classify_occupants",
            "find_rooms",
        ):
            patch.setattr(f"navbake.baker.bake.stages.{name}", None)
        for update in (
            {"bodies": {"chair": [2.0, 2.0, 0.4]}},
            {"bodies": {"mocap": [4.0, 3.0, 0.6]}},
            {"joints": {"hinge": 0.7}},
            {},
        ):
            assert baker.update(**update).reason == ""
    assert first_difference(baker.grid, fresh(baker)) is None


# ---------------------------------------------------------------- whatever moves, near it alone

HINGED = (
    '<body name="cupboard" pos="4 4 1"><geom type="box" size="0.2 0.4 1"/>'
    '<body name="cupboard_door" pos="-0.22 -0.4 0"><joint name="flap" axis="0 0 1" '
    'range="0 1.6"/><geom type="box" pos="0 0.4 0" size="0.02 0.4 0.95"/></body></body>'
)
BASE = (
    '<body name="base" pos="1 1 0"><joint name="x" type="slide" axis="1 0 0"/>'
    '<joint name="y" type="slide" axis="0 1 0"/><joint name="yaw" axis="0 0 1"/>'
    '<geom type="box" pos="0 0 0.3" size="0.4 0.2 0.3"/>'
    '<body pos="0.4 0 0.5"><joint name="arm" axis="0 1 0"/>'
    '<geom type="capsule" fromto="0 0 0 0.6 0 0" size="0.05"/></body></body>'
)
PERSON = (
    '<body name="person" mocap="true" pos="2 2 0.6">'
    '<geom name="trunk" type="capsule" size="0.2 0.4"/></body>'
)
WEDGE = '<mesh name="wedge" vertex="0 0 0 1 0 0 1 .8 0 0 .8 0 1 0 .4 1 .8 .4"/>'
# a mesh whose hull hides room, once it is large enough
ARCH = (
    '<mesh name="arch" inertia="shell" vertex="0 0 0 .1 0 0 .1 2 0 0 2 0 0 0 2 .1 0 2 .1 2 2 0 2 2 '
    '1.9 0 0 2 0 0 2 2 0 1.9 2 0 1.9 0 2 2 0 2 2 2 2 1.9 2 2" '
    'face="0 1 5 0 5 4 1 2 6 1 6 5 2 3 7 2 7 6 3 0 4 3 4 7 '
    '8 9 13 8 13 12 9 10 14 9 14 13 10 11 15 10 15 14 11 8 12 11 12 15"/>'
)
BALL = (
    '<body name="ball" pos="3 3 0.5"><joint name="b" type="ball"/>'
    '<geom type="box" size=".4 .1 .3"/></body>'
)


def test_mocap_bodies_are_followed():
    baker = navbake.Baker(make(PERSON + CHAIR + CEILING))
    for pose in (
        [3.0, 3.0, 0.6],
        [1.0, 1.0, 0.6],  # into the chair
        [3.0, 3.0, 3.6],  # onto the ceiling
        [3.0, 3.0, 0.3, 0.7071, 0.7071, 0.0, 0.0],  # lies down
        [9.0, 3.0, 0.6],  # leaves the box
        [2.0, 2.0, 0.6, 1.0, 0.0, 0.0, 0.0],
    ):
        check_local(baker, {}, bodies={"person": pose})


def test_a_planar_base_is_followed():
    baker = navbake.Baker(make(BASE + CHAIR + CEILING))
    for joints in (
        {"x": 1.5, "y": 1.0},
        {"yaw": 0.8},
        {"arm": 0.7},
        {"x": 0.0, "y": 0.0, "yaw": 3.0, "arm": 0.0},
        {"x": 40.0},
        {"x": 2.0},
    ):
        check_local(baker, {}, joints=joints)


def test_a_ball_joint_is_followed():
    baker = navbake.Baker(make(BALL + CHAIR))
    data = mujoco.MjData(baker.model)
    address = int(baker.model.jnt_qposadr[baker.model.joint("b").id])
    for quat in ([0.9, 0.1, 0.3, 0.3], [1.0, 0.0, 0.0, 0.0]):
        data.qpos[address : address + 4] = np.array(quat) / np.linalg.norm(quat)
        check_local(baker, {}, data=data)


def test_things_are_stacked():
    boxes = "".join(
        f'<body name="box_{k}" pos="{1 + k} 1 0.3"><freejoint/>'
        f'<geom type="box" size="0.4 0.4 0.3"/></body>'
        for k in range(4)
    )
    baker = navbake.Baker(make(boxes + CEILING))
    for k in range(1, 4):
        check_local(baker, {}, bodies={f"box_{k}": [1.0, 1.0, 0.3 + 0.6 * k]})
    check_local(baker, {}, bodies={"box_0": [4.0, 4.0, 0.3]})
    check_local(baker, {}, bodies={f"box_{k}": [1.0 + k, 3.0, 0.3] for k in range(4)})


@pytest.mark.parametrize("settings", [{}, WIDER])
def test_a_body_leaves_the_box_and_comes_back(settings):
    baker = navbake.Baker(make(CHAIR + GROUND), **settings)
    lattice = baker.grid.lattice
    for place in (
        [6.0, 3.0, 0.4],
        [7.5, 3.0, 0.2],
        [500.0, -500.0, 0.4],
        [3.0, 3.0, 800.0],
        [3.0, 3.0, -800.0],
        [2.0, 2.0, 0.4],
    ):
        check_local(baker, settings, bodies={"chair": place})
        assert baker.grid.lattice == lattice


def test_a_body_vanishes_and_appears():
    baker = navbake.Baker(make(CHAIR + PERSON + CEILING))
    occupied = np.count_nonzero(baker.grid.occupancy)
    for name in ("seat", "trunk"):
        geom = baker.model.geom(name).id
        for shown in (0, 1):
            baker.model.geom_contype[geom] = shown
            baker.model.geom_conaffinity[geom] = shown
            check_local(baker, {})
            assert (np.count_nonzero(baker.grid.occupancy) == occupied) == bool(shown)


def test_a_body_grows_and_shrinks():
    baker = navbake.Baker(make(CHAIR + CEILING))
    geom = baker.model.geom("seat").id
    for size in ([0.5, 0.5, 0.4], [1.0, 0.1, 0.05], [0.2, 0.2, 0.4]):
        baker.model.geom_size[geom] = size
        check_local(baker, {})
        check_local(baker, {}, bodies={"chair": [1.0 + size[0], 1.0, 0.4]})


def test_a_door_is_followed():
    baker = navbake.Baker(mujoco.MjModel.from_xml_string(ROOM.format(bodies=CHAIR)))
    for angle in (0.4, 1.6, 0.0):
        check_local(baker, {}, joints={"hinge": angle})
        assert [door.id for door in baker.grid.doors] == ["door"]
    # what stands in the doorway takes cells of the door
    for place in ([3.0, 2.4, 0.4], [3.4, 2.4, 0.4], [1.0, 1.0, 0.4]):
        check_local(baker, {}, bodies={"chair": place})


@pytest.mark.parametrize("settings", [{}, {"doors": {"state": "open"}}, {"doors": {"find": False}}])
def test_the_leaf_of_a_cupboard_is_followed(settings):
    baker = navbake.Baker(make(HINGED + CHAIR + CEILING), **settings)
    assert baker.grid.doors == ()
    for angle in (0.4, 1.6, 0.0):
        check_local(baker, settings, joints={"flap": angle})
        check_local(baker, settings, bodies={"chair": [3.5, 4.0 + angle / 10, 0.4]})


@pytest.mark.parametrize("meshes", ["auto", "hull", "surface", "shell"])
def test_meshes_are_followed(meshes):
    settings = {"scene": {"meshes": meshes}}
    body = '<body name="rock" pos="2 2 0"><freejoint/><geom type="mesh" mesh="wedge"/></body>'
    baker = navbake.Baker(make(body + CHAIR + CEILING, WEDGE), **settings)
    for pose in ([3.0, 3.0, 0.0], [3.0, 3.0, 0.5, 0.8, 0.3, 0.4, 0.3], [1.0, 1.0, 0.2]):
        check_local(baker, settings, bodies={"rock": pose})


@pytest.mark.parametrize("geoms", ["collision", "all"])
def test_a_mesh_that_hides_room_is_followed(geoms):
    """Its pose says whether it counts as a hull or as a surface."""
    settings = {"scene": {"geoms": geoms}}
    body = '<body name="arch" pos="2 2 0"><freejoint/><geom type="mesh" mesh="arch"/></body>'
    baker = navbake.Baker(make(body + CHAIR, ARCH), **settings)
    for pose in (
        [3.0, 3.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        [3.0, 3.0, 1.0, 0.7071, 0.7071, 0.0, 0.0],
        [2.0, 2.0, 0.0, 1.0, 0.0, 0.0, 0.0],
    ):
        check_local(baker, settings, bodies={"arch": pose})
    assert check(baker, settings, bodies={"chair": [3.0, 1.0, 0.4]}).reason == ""


def test_exclude_movable_leaves_doors_that_are_followed():
    settings = {"scene": {"exclude": {"movable": True}}}
    baker = navbake.Baker(mujoco.MjModel.from_xml_string(ROOM.format(bodies=CHAIR)), **settings)
    occupied = baker.grid.with_doors("removed").occupancy
    check_local(baker, settings, bodies={"chair": [2.0, 2.0, 0.4]})
    check_local(baker, settings, joints={"hinge": 0.8})
    np.testing.assert_array_equal(baker.grid.with_doors("removed").occupancy, occupied)


def test_warnings_follow_what_moves():
    platform = (
        '<body name="platform" pos="3 3 -0.05"><freejoint/>'
        '<geom type="box" size="1 1 0.05"/></body>'
    )
    baker = navbake.Baker(make(platform), **WIDER)
    told = []
    for place in ([3.0, 3.0, -0.05], [6.5, 3.0, -0.05], [6.5, 6.5, -0.05], [3.0, 3.0, -0.05]):
        check_local(baker, WIDER, bodies={"platform": place})
        told.append(any("carries no floor" in warning for warning in baker.grid.warnings))
    assert told == [False, True, True, False]


def is_uncounted_told(baker: navbake.Baker) -> bool:
    """Whether a warning names drawn geoms on the floor that don't count."""
    return any(text.startswith("drawn on free floor") for text in baker.grid.warnings)


def test_warnings_of_drawn_things_follow_a_body_that_carries_floor():
    stage = f'<body name="stage" pos="20 20 0.35"><freejoint/>{DECORATION}</body>'
    settings = {"floors": {"movable": ["stage"]}}
    baker = navbake.Baker(make(CHAIR + stage), **settings)
    told = []
    for place in ([3.0, 3.0, 0.35], [4.0, 3.0, 0.35], [20.0, 20.0, 0.35], [3.0, 3.0, 0.35]):
        check_local(baker, settings, bodies={"stage": place})
        told.append(is_uncounted_told(baker))
        check_local(baker, settings, bodies={"chair": [2.0, 2.0, 0.4]})
        assert is_uncounted_told(baker) == told[-1]
    assert told == [True, True, False, True]


@pytest.mark.parametrize("settings", [{}, {"scene": {"exclude": {"movable": True}}}], ids=str)
def test_warnings_of_drawn_things_follow_what_is_written_to_the_model(settings):
    model = make(CHAIR + f'<body name="decor" pos="3 3 0.35">{DECORATION}</body>')
    baker = navbake.Baker(model, **settings)
    model = baker.model
    body = model.body("decor").id
    geom = model.geom("decoration").id
    assert is_uncounted_told(baker)
    model.body_pos[body] = [20.0, 20.0, 0.35]
    check_local(baker, settings)
    assert not is_uncounted_told(baker)
    model.body_pos[body] = [4.05, 3.05, 0.35]
    check_local(baker, settings)
    assert is_uncounted_told(baker)
    model.body_pos[body] = [4.05, 3.05, 3.35]
    check_local(baker, settings)
    assert not is_uncounted_told(baker)
    model.body_pos[body] = [4.05, 3.05, 0.35]
    model.geom_rgba[geom, 3] = 0.0
    check_local(baker, settings)
    assert not is_uncounted_told(baker)
    model.geom_rgba[geom, 3] = 1.0
    check_local(baker, settings)
    assert is_uncounted_told(baker)
    model.geom_size[geom] = [0.04, 0.04, 0.3]
    check_local(baker, settings)
    assert not is_uncounted_told(baker)


def test_drawn_things_are_looked_at_only_where_one_moved(monkeypatch):
    calls = []
    warn = update.warn_uncounted

    def warn_and_count(*given):
        calls.append(given)
        return warn(*given)

    monkeypatch.setattr(update, "warn_uncounted", warn_and_count)
    stage = f'<body name="stage" pos="3 3 0.35"><freejoint/>{DECORATION}</body>'
    baker = navbake.Baker(make(CHAIR + stage), floors={"movable": ["stage"]})
    baker.update(bodies={"chair": [2.0, 2.0, 0.4]})
    assert calls == []
    baker.update(bodies={"stage": [4.0, 3.0, 0.35]})
    assert len(calls) == 1


# ---------------------------------------------------------------- where structure moved


def test_a_geom_that_stands_is_written_to():
    baker = navbake.Baker(make(CHAIR + CEILING))
    geom = baker.model.geom("ceiling").id
    baker.model.geom_pos[geom] = [3.0, 3.0, 2.2]
    assert check(baker, {}).reason == "'ceiling', which stands, has changed"
    check_local(baker, {}, bodies={"chair": [3.0, 3.0, 0.4]})


def test_a_body_that_stands_is_written_to():
    shelf = (
        '<body name="shelf" pos="4 4 0.5"><geom name="boards" type="box" size=".4 .2 .5"/></body>'
    )
    baker = navbake.Baker(make(CHAIR + shelf))
    baker.model.body_pos[baker.model.body("shelf").id] = [4.0, 3.0, 0.5]
    assert check(baker, {}).reason == "'boards', which stands, has changed"


def test_a_body_that_carries_floors_moves():
    bridge = (
        '<body name="bridge" pos="7 3 -0.1"><freejoint/>'
        '<geom name="boards" type="box" size="1 0.8 0.1"/></body>'
    )
    settings = WIDER | {"floors": {"movable": ["bridge"]}}
    baker = navbake.Baker(make(CHAIR + bridge), **settings)
    row, col = baker.grid.lattice.rows_cols([6.5, 3.0])
    assert baker.grid.floor_height[row, col] == 0.0
    reason = check(baker, settings, bodies={"bridge": [20.0, 3.0, -0.1]}).reason
    assert reason == "'boards', which carries floor, has changed"
    assert np.isnan(baker.grid.floor_height[row, col])
    check_local(baker, settings, bodies={"chair": [3.0, 3.0, 0.4]})
    # without the setting it is in the way, and no floor
    baker = navbake.Baker(make(CHAIR + bridge), **WIDER)
    assert np.isnan(baker.grid.floor_height[row, col])
    check_local(baker, WIDER, bodies={"bridge": [20.0, 3.0, -0.1]})


def test_a_car_of_a_lift_moves():
    car = (
        '<body name="car" pos="6.9 3 0"><joint name="car" type="slide" axis="0 0 1" range="0 3" '
        'limited="true"/><geom name="plate" type="box" pos="0 0 -0.05" size="0.8 0.8 0.05"/></body>'
    )
    settings = {"grid": {"bounds": [0, 0, 8, 6]}, "links": [{"auto": "lift"}]}
    baker = navbake.Baker(make(CHAIR + car), **settings)
    assert check(baker, settings, joints={"car": 1.0}).reason == (
        "'plate', which carries floor, has changed"
    )
    check_local(baker, settings, bodies={"chair": [3.0, 3.0, 0.4]})
    # where no lifts are looked for, it is a thing
    settings = {"grid": {"bounds": [0, 0, 8, 6]}}
    baker = navbake.Baker(make(CHAIR + car), **settings)
    check_local(baker, settings, joints={"car": 1.0})


def test_a_site_that_marks_a_room_moves():
    shelf = (
        '<body name="shelf" pos="4 4 0.5"><geom type="box" size=".4 .2 .5"/>'
        '<site name="room_a" type="box" pos="-1 -1 0" size="1 1 1"/></body>'
    )
    settings = {"rooms": {"sites": ["room_*"], "sources": ["sites", "auto"]}}
    baker = navbake.Baker(make(CHAIR + shelf), **settings)
    assert "room_a" in {room.name for room in baker.grid.rooms}
    baker.model.site_pos[0] = [-2.0, -2.0, 0.0]
    assert check(baker, settings).reason == "what marks rooms has changed"
    check_local(baker, settings, bodies={"chair": [3.0, 3.0, 0.4]})


def test_a_geom_that_marks_a_room_moves():
    """It only marks, as it can't collide."""
    baker = navbake.Baker(make(CHAIR + CARPET.format(1.4)), **CARPET_ROOM)
    rooms = baker.grid.room_index.copy()
    assert "carpet" in {room.name for room in baker.grid.rooms}
    baker.model.geom_pos[baker.model.geom("carpet").id, 0] = 4.0
    assert check(baker, CARPET_ROOM).reason == "what marks rooms has changed"
    assert (baker.grid.room_index != rooms).any()
    check_local(baker, CARPET_ROOM, bodies={"chair": [3.0, 3.0, 0.4]})


def test_over_endless_ground_a_move_that_changes_the_box_is_a_whole_bake():
    ground = '<geom name="ground" type="plane" size="0 0 1"/>'
    more = CHAIR.replace("chair", "post").replace("seat", "wood").replace("1 1 0.4", "5 5 0.4")
    xml = f"<mujoco><worldbody>{ground}{CHAIR}{more}</worldbody></mujoco>"
    baker = navbake.Baker(mujoco.MjModel.from_xml_string(xml))
    reason = check(baker, {}, bodies={"chair": [2.0, 2.0, 0.4]}).reason
    assert reason == "the grid is another one: the box round the scene has changed"
    # bounds prevent it
    settings = {"grid": {"bounds": [0, 0, 6, 6]}}
    baker = navbake.Baker(mujoco.MjModel.from_xml_string(xml), **settings)
    check_local(baker, settings, bodies={"chair": [2.0, 2.0, 0.4]})


def test_where_nothing_stands_each_move_is_a_whole_bake():
    slab = f'<body name="slab"><freejoint/>{FLOOR}</body>'
    xml = f"<mujoco><worldbody>{slab}{CHAIR}</worldbody></mujoco>"
    baker = navbake.Baker(mujoco.MjModel.from_xml_string(xml))
    reason = check(baker, {}, bodies={"chair": [2.0, 2.0, 0.4]}).reason
    assert reason == "'seat', which stands, has changed"


# ---------------------------------------------------------------- what is written to the model


def test_links_follow_how_far_a_lift_goes():
    settings = {"links": [{"auto": "lift"}], "floors": {"roofs": True}}
    baker = navbake.Baker(make(UPPER_SLAB + CAR), **settings)
    assert [link.name for link in baker.grid.links] == ["car"]
    baker.model.jnt_range[0] = [0.0, 0.5]
    check(baker, settings)
    assert baker.grid.links == ()


def test_links_follow_how_a_door_turns():
    """No link ends where a door is in any of its states."""
    dock = '<geom name="dock" type="box" pos="5 3 0.4" size="1 3 0.4"/>'
    door = (
        '<body name="door" pos="3.9 3 1"><joint name="hinge" axis="0 0 1" range="0 1.5"/>'
        '<geom type="box" pos="0 0.5 0" size="0.02 0.5 1"/></body>'
    )
    settings = {
        "doors": {"patterns": ["door"]},
        "links": [{"auto": "drop", "height": 1.2}],
        "floors": {"tops": True},
    }
    baker = navbake.Baker(make(dock + door), **settings)
    before = baker.grid.links
    baker.model.jnt_range[0] = [-1.5, 0.0]
    check(baker, settings)
    assert baker.grid.links != before


def test_an_area_follows_a_geom_that_only_marks_it():
    zone = (
        '<body name="zone" mocap="true" pos="2 2 0.5"><geom name="zone" type="box" '
        'size="0.5 0.5 0.5" contype="0" conaffinity="0"/></body>'
    )
    settings = {"areas": [{"name": "slow", "geoms": ["zone"], "cost": 2}]}
    baker = navbake.Baker(make(zone), **settings)
    before = baker.grid.levels[0].area_index.copy()
    check(baker, settings, bodies={"zone": [4.0, 4.0, 0.5]})
    assert (baker.grid.levels[0].area_index != before).any()


def test_what_is_left_out_as_movable_may_become_a_leaf():
    """A flap that lies is left out by `exclude.movable`; where it stands, it is a door."""
    xml = ROOM.format(bodies="").replace('axis="0 0 1" range="0 1.6"', 'axis="0 1 0" range="0 1.6"')
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[0] = 1.5
    settings = {"scene": {"exclude": {"movable": True}}}
    baker = navbake.Baker(model, data, **settings)
    assert baker.grid.doors == ()
    for angle, doors in ((0.0, 1), (1.5, 0)):
        check(baker, settings, joints={"hinge": angle})
        assert len(baker.grid.doors) == doors


def test_a_platform_may_become_the_car_of_a_lift():
    lifter = (
        '<body name="lifter" pos="3 3 1" quat="0.7071 0.7071 0 0"><freejoint/>'
        '<geom type="box" size="0.1 0.1 0.1"/><body name="fork"><joint name="fork" type="slide" '
        'axis="0 0 1" range="0 2" limited="true"/><geom name="plate" type="box" pos="0 0 0.2" '
        'size="0.8 0.8 0.02"/></body></body>'
    )
    settings = {"links": [{"auto": "lift"}], "floors": {"tops": True}}
    baker = navbake.Baker(make(lifter), **settings)
    assert check(baker, settings, bodies={"lifter": [3, 3, 0.2, 1, 0, 0, 0]}).reason
    assert (baker.grid.floor_height > 0.1).any()
    assert check(baker, settings, bodies={"lifter": [3, 3, 1, 0.7071, 0.7071, 0, 0]}).reason
    assert not (baker.grid.floor_height > 0.1).any()


def test_an_endless_plane_that_moves_is_no_ground():
    plane = (
        '<body name="sea" mocap="true" pos="2 2 -0.5"><geom name="sea" type="plane" '
        'size="0 0 1"/></body>'
    )
    baker = navbake.Baker(make(plane + CHAIR))
    assert not any("'sea' is endless" in warning for warning in baker.grid.warnings)
    for height in (-0.8, 0.5, -0.5):
        check_local(baker, {}, bodies={"sea": [2.0, 2.0, height]})


def test_a_geom_that_marks_a_room_grows():
    baker = navbake.Baker(make(CHAIR + CARPET.format(0.7)), **CARPET_ROOM)
    rooms = baker.grid.room_index.copy()
    baker.model.geom_size[baker.model.geom("carpet").id, 0] = 1.4
    assert check(baker, CARPET_ROOM).reason == "what marks rooms has changed"
    assert (baker.grid.room_index != rooms).any()


def test_a_car_of_a_lift_loses_its_limits():
    settings = {"links": [{"auto": "lift"}], "floors": {"roofs": True, "tops": True}}
    baker = navbake.Baker(make(UPPER_SLAB + CAR), **settings)
    assert (baker.grid.levels[0].floor_height > 0.05).any()
    baker.model.jnt_limited[0] = 0
    assert check(baker, settings).reason
    assert not (baker.grid.levels[0].floor_height > 0.05).any()


@pytest.mark.parametrize("place", [[1.0, 1.0, 0.4], [9e4, 0.0, 0.4]])
def test_the_size_of_a_scene_is_that_of_what_stands(place):
    chair = CHAIR.replace("1 1 0.4", "0.005 0 0.4")
    floor = '<geom type="box" size="0.02 0.02 0.01"/>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{floor}{chair}</worldbody></mujoco>"
    )
    settings = {"grid": {"cell_size": 0.01}, "floors": {"min_area": 0.0001, "shrink": 0.0}}
    settings["floors"]["tops"] = True  # it is as narrow as the top of a wall
    baker = navbake.Baker(model, **settings)
    assert any("only 0.04 m large" in warning for warning in baker.grid.warnings)
    check_local(baker, settings, bodies={"chair": place})
