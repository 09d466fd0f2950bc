"""What of a scene stands, what can move, and what a lift or a setting makes a floor of."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from box_worlds import body, box, world
from door_scenes import LEAF, ROOMS
from door_scenes import world as door_world
from navbake.baker.scene.roles import find_actuated_bodies
from navbake.baker.scene.scene import Scene, load_scene
from navbake.config.settings import load_config, parse_config
from project_paths import CONFIGS

FLOOR = box("floor", -2, -2, -0.1, 2, 2, 0)
THING = box("thing", 0, 0, 0, 0.5, 0.5, 0.5)
FRAME = box("frame", 0, 0, 0, 0.1, 0.1, 0.5)
INERTIA = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
PLANAR = (
    '<joint name="x" type="slide" axis="1 0 0"/>'
    '<joint name="y" type="slide" axis="0 1 0"/>'
    '<joint name="yaw" axis="0 0 1"/>'
)


def load(folder: Path, text: str, name: str = "scene.xml", **settings) -> Scene:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    scene = {"path": str(path), **settings.pop("scene", {})}
    return load_scene(parse_config({"scene": scene, **settings}))


def roles(scene: Scene) -> dict[str, str]:
    return {geom.name: geom.role for geom in scene.geoms}


# ---------------------------------------------------------------- what is movable

MOVABLE = {
    "free joint": body("b", "<freejoint/>" + THING),
    "hinge": body("b", '<joint type="hinge"/>' + THING),
    "slide": body("b", '<joint type="slide"/>' + THING),
    "ball": body("b", '<joint type="ball"/>' + THING),
    "planar base": body("b", PLANAR + THING),
    "mocap body": body("b", THING, 'mocap="true"'),
    "jointless body on a movable one": body("b", "<freejoint/>" + body("c", THING)),
    "jointless body on a mocap body": body("b", body("c", body("d", THING)), 'mocap="true"'),
    "jointed body on a movable one": body(
        "b", "<freejoint/>" + INERTIA + body("c", '<joint type="hinge"/>' + THING)
    ),
}
STANDING = {
    "geom of the world": THING,
    "jointless body": body("b", THING),
    "jointless body on a jointless one": body("b", body("c", THING)),
}


@pytest.mark.parametrize("kind", MOVABLE)
def test_what_has_a_joint_or_is_mocap_is_movable(tmp_path, kind):
    scene = load(tmp_path, world(FLOOR + MOVABLE[kind]))
    assert roles(scene) == {"floor": "structure", "thing": "movable"}


@pytest.mark.parametrize("kind", STANDING)
def test_all_else_is_structure(tmp_path, kind):
    scene = load(tmp_path, world(FLOOR + STANDING[kind]))
    assert set(roles(scene).values()) == {"structure"}


def test_a_hinged_child_leaves_its_parent_standing(tmp_path):
    cupboard = body("b", FRAME + body("c", '<joint type="hinge"/>' + THING))
    scene = load(tmp_path, world(FLOOR + cupboard))
    assert roles(scene) == {"floor": "structure", "frame": "structure", "thing": "movable"}


def test_what_does_not_count_has_no_role(tmp_path):
    ghost = THING.replace("/>", ' contype="0" conaffinity="0"/>')
    scene = load(tmp_path, world(FLOOR + body("b", "<freejoint/>" + ghost)))
    assert roles(scene) == {"floor": "structure", "thing": ""}


def test_leaves_are_neither(tmp_path):
    scene = load(tmp_path, door_world(ROOMS, LEAF))
    assert roles(scene)["leaf"] == "leaf"
    assert roles(scene)["wall_1"] == "structure"


@pytest.mark.parametrize("name", ["apartment", "house", "warehouse", "terrain", "clutter"])
def test_samples_by_mujoco_s_own_words(name):
    scene = load_scene(load_config(CONFIGS / f"{name}.yaml"))
    model = scene.model
    for geom in scene.geoms:
        above = int(model.geom_bodyid[geom.id])
        moves = False
        while above > 0:
            moves |= model.body_jntnum[above] > 0 or model.body_mocapid[above] >= 0
            above = int(model.body_parentid[above])
        if geom.counted:
            assert geom.role in (("movable", "leaf") if moves else ("structure", "leaf"))


def test_links_and_models_of_sdf(tmp_path):
    shape = "<geometry><box><size>1 1 1</size></box></geometry>"

    def link(name: str) -> str:
        return f'<link name="{name}"><collision name="c">{shape}</collision></link>'

    joints = (
        '<joint name="root" type="fixed"><parent>world</parent><child>frame</child></joint>'
        '<joint name="hinge" type="revolute"><parent>frame</parent><child>arm</child>'
        "<axis><xyz>0 0 1</xyz></axis></joint>"
    )
    models = (
        f'<model name="house"><static>true</static>{link("l")}</model>'
        f'<model name="chair">{link("l")}</model>'
        f'<model name="crane">{link("frame")}{link("arm")}{joints}</model>'
    )
    text = f'<?xml version="1.0"?><sdf version="1.9"><world name="w">{models}</world></sdf>'
    scene = load(tmp_path, text, "world.sdf")
    by_link = {name.rpartition("::")[0]: role for name, role in roles(scene).items()}
    assert by_link == {
        "house::l": "structure",
        "chair::l": "movable",
        "crane::frame": "structure",
        "crane::arm": "movable",
    }


def test_rigid_bodies_of_usd(tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import UsdGeom, UsdPhysics

    from usd_scenes import new_stage, place

    stage = new_stage(tmp_path / "a.usda")
    cubes = {}
    for number, name in enumerate(("Wall", "Ball", "Held")):
        cubes[name] = UsdGeom.Cube.Define(stage, f"/World/{name}")
        place(cubes[name], (3 * number, 0, 1))
    for name in ("Ball", "Held"):
        UsdPhysics.RigidBodyAPI.Apply(cubes[name].GetPrim())
    UsdPhysics.RigidBodyAPI(cubes["Held"].GetPrim()).CreateKinematicEnabledAttr(True)
    stage.Save()
    scene = load_scene(parse_config({"scene": {"path": str(tmp_path / "a.usda")}}))
    assert roles(scene) == {
        "/World/Wall": "structure",
        "/World/Ball": "movable",
        "/World/Held": "structure",
    }


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb"])
def test_meshes_stand(tmp_path, suffix):
    path = tmp_path / f"room.{suffix}"
    trimesh.creation.box((4, 3, 1)).export(path)
    scene = load_scene(parse_config({"scene": {"path": str(path), "up": "z"}}))
    assert {geom.role for geom in scene.geoms if geom.counted} == {"structure"}
    assert scene.warnings == []


# ---------------------------------------------------------------- what moves and carries floors


def test_a_pattern_makes_structure_of_a_body_and_what_hangs_on_it(tmp_path):
    stage = body("stage", "<freejoint/>" + THING + body("rail", '<joint type="hinge"/>' + FRAME))
    other = body("other", "<freejoint/>" + box("crate", 1, 1, 0, 1.5, 1.5, 0.5))
    content = world(FLOOR + stage + other)
    scene = load(tmp_path, content, floors={"movable": ["stag?"]})
    assert roles(scene) == {
        "floor": "structure",
        "thing": "structure that moves",
        "frame": "structure that moves",
        "crate": "movable",
    }
    assert scene.warnings == []


def test_a_pattern_that_names_no_body_is_told_with_near_names(tmp_path):
    stage = body("stage", "<freejoint/>" + THING)
    scene = load(tmp_path, world(FLOOR + stage), floors={"movable": ["stagge"]})
    (warning,) = scene.warnings
    assert warning == "`floors.movable` pattern 'stagge' matches no body; near names are stage"
    assert roles(scene)["thing"] == "movable"


CAR = body(
    "car",
    '<joint name="car" type="slide" axis="0 0 1" range="0 3" limited="true"/>{geoms}',
)
PLATE = box("plate", -0.5, -0.5, 0, 0.5, 0.5, 0.1)


@pytest.mark.parametrize(
    ("geoms", "joint", "links", "is_car"),
    [
        (PLATE, "", [{"auto": "lift"}], True),
        (PLATE, "", [{"auto": "lift", "patterns": ["ca*"]}], True),
        (PLATE, "", [{"auto": "lift", "patterns": ["hoist"]}], False),
        (PLATE, "", [{"auto": "drop"}], False),
        (PLATE, "", [], False),
        (box("plate", 0, 0, 0, 0.4, 0.4, 0.1), "", [{"auto": "lift"}], False),  # too small
        (PLATE, 'axis="1 0 0"', [{"auto": "lift"}], False),
        (PLATE, 'limited="false"', [{"auto": "lift"}], False),
    ],
)
def test_cars_of_lifts_carry_floors_where_lifts_are_looked_for(
    tmp_path, geoms, joint, links, is_car
):
    text = CAR.format(geoms=geoms)
    if joint:
        key = joint.partition("=")[0]
        before = {"axis": 'axis="0 0 1"', "limited": 'limited="true"'}[key]
        assert before in text
        text = text.replace(before, joint)
    scene = load(tmp_path, world(FLOOR + text), links=links)
    assert roles(scene)["plate"] == ("structure that moves" if is_car else "movable")
    assert [scene.model.body(car).name for car in scene.car_bodies] == ["car"] * is_car


# ---------------------------------------------------------------- where nothing stands


def test_where_nothing_stands_all_is_structure_and_told(tmp_path):
    slab = body("slab", "<freejoint/>" + FLOOR)
    crate = body("crate", "<freejoint/>" + THING)
    scene = load(tmp_path, world(slab + crate))
    assert roles(scene) == {"floor": "structure", "thing": "structure"}
    (warning,) = scene.warnings
    assert "nothing stands" in warning
    assert "`floors.movable`" in warning


def test_one_thing_that_stands_is_enough(tmp_path):
    crate = body("crate", "<freejoint/>" + THING)
    scene = load(tmp_path, world('<geom name="ground" type="plane" size="0 0 1"/>' + crate))
    assert roles(scene) == {"ground": "structure", "thing": "movable"}
    assert scene.warnings == []


# ---------------------------------------------------------------- what moves together


def test_what_moves_a_body_is_the_topmost_that_can(tmp_path):
    arm = body("arm", '<joint type="hinge"/>' + THING + body("hand", FRAME))
    lid = '<joint type="hinge"/>' + INERTIA
    robot = body("robot", "<freejoint/>" + box("base", 1, 1, 0, 1.2, 1.2, 0.2) + arm)
    desk = body("desk", box("top", -1, -1, 0, 0, 0, 0.7) + body("lid", lid))
    scene = load(tmp_path, world(FLOOR + desk + robot))
    model = scene.model
    movers = {
        model.body(number).name: model.body(mover).name
        for number, mover in enumerate(scene.mover_of_body.tolist())
    }
    assert movers == {
        "world": "world",
        "desk": "desk",
        "lid": "lid",
        "robot": "robot",
        "arm": "robot",
        "hand": "robot",
    }


ACTUATED = """
<mujoco>
  <worldbody>
    <body name="hinged"><joint name="hinge"/><geom size=".1"/><site name="tip"/></body>
    <body name="pushed"><freejoint/><geom size=".1"/><site name="jet"/></body>
    <body name="pulled"><joint name="pulled"/><geom size=".1"/></body>
    <body name="strung"><joint name="strung"/><geom size=".1"/><site name="eye"/></body>
    <body name="idle"><joint name="idle"/><geom size=".1"/></body>
    <site name="hook"/>
  </worldbody>
  <tendon>
    <fixed name="rope"><joint joint="pulled" coef="1"/></fixed>
    <spatial name="string"><site site="hook"/><site site="eye"/></spatial>
  </tendon>
  <actuator>{actuator}</actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("actuator", "expected"),
    [
        ("", set()),
        ('<motor joint="hinge"/>', {"hinged"}),
        ('<motor jointinparent="hinge"/>', {"hinged"}),
        ('<general site="jet" gear="1 0 0 0 0 0"/>', {"pushed"}),
        ('<motor tendon="rope"/>', {"pulled"}),
        ('<motor tendon="string"/>', {"strung", "world"}),
        ('<motor joint="hinge"/><motor tendon="rope"/>', {"hinged", "pulled"}),
    ],
)
def test_bodies_that_actuators_move(actuator, expected):
    model = mujoco.MjModel.from_xml_string(ACTUATED.format(actuator=actuator))
    assert {model.body(body).name for body in find_actuated_bodies(model)} == expected


# ---------------------------------------------------------------- what is left out

SHARED_BASE = Path(__file__).parents[4] / "shared/data/reports/planar_base/base.xml"
BASE = world(box("floor", -3, -3, -0.1, 3, 3, 0) + body("base", PLANAR + THING))


@pytest.mark.parametrize("which", ["inline", "of a report"])
def test_exclude_movable_leaves_out_a_planar_base(tmp_path, which):
    if which == "of a report" and not SHARED_BASE.exists():
        pytest.skip(f"{SHARED_BASE} is not there")
    text = BASE if which == "inline" else SHARED_BASE.read_text()
    assert "movable" in roles(load(tmp_path, text)).values()
    scene = load(tmp_path, text, scene={"exclude": {"movable": True}})
    assert [geom.name for geom in scene.geoms if geom.counted] == ["floor"]
    (left_out,) = [geom for geom in scene.geoms if not geom.counted]
    assert left_out.reason == "excluded: body 'base' can move"
    assert left_out.role == ""


def test_exclude_movable_keeps_doors_and_what_carries_floors(tmp_path):
    things = body("stage", "<freejoint/>" + box("boards", 1, 1, 0, 2, 2, 0.2))
    things += body("chair", "<freejoint/>" + box("seat", 4, 1, 0, 4.4, 1.4, 0.4))
    text = door_world(ROOMS, LEAF, things)
    settings = {"scene": {"exclude": {"movable": True}}, "floors": {"movable": ["stage"]}}
    scene = load(tmp_path, text, **settings)
    assert roles(scene)["leaf"] == "leaf"
    assert roles(scene)["boards"] == "structure that moves"
    assert roles(scene)["seat"] == ""
    np.testing.assert_array_equal(scene.is_movable_body, [False, True, False, True])
