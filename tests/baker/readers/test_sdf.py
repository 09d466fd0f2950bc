"""Worlds of Gazebo: frames, includes, geometry, joints, and what is missing."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image

import navbake
from navbake.baker.readers import parsed_scene
from navbake.baker.readers.sdf_shapes import extrude_outlines
from navbake.baker.scene.model import CompileLimits
from navbake.baker.scene.scene import Scene
from navbake.config.settings import SceneSettings
from navbake.errors import SceneError
from navbake.formats.scene_files import MODEL_PATHS, find_inputs
from scene_files import WEDGE, leads_through, write_dae
from scenes_alone import load_alone
from sdf_scenes import write_world

SHARED = Path(__file__).parents[4] / "shared" / "data"
REPORTS = SHARED / "reports"
BOX = "<geometry><box><size>1 2 4</size></box></geometry>"


@pytest.fixture(autouse=True)
def _without_model_paths(monkeypatch):
    for name in MODEL_PATHS:
        monkeypatch.delenv(name, raising=False)


def write(folder: Path, content: str, name: str = "w.sdf") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'<?xml version="1.0"?><sdf version="1.9">{content}</sdf>')
    return path


def load(path: Path, **settings: Any) -> Scene:
    return load_alone(SceneSettings(path=path, **settings))


def link(content: str, name: str = "l", more: str = "") -> str:
    return f'<link name="{name}">{more}<collision name="c">{content}</collision></link>'


def model(content: str, name: str = "m", more: str = "<static>true</static>") -> str:
    return f'<model name="{name}">{more}{content}</model>'


@pytest.mark.parametrize(
    ("scene", "settings"),
    [
        ("turtlebot3_world/scene.xml", {}),
        ("aws_small_house/scene.xml", {}),
        ("unitree_go2/scene_terrain.xml", {"geoms": "all"}),
    ],
)
@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_real_scenes(tmp_path, scene, settings):
    """Scenes of others as worlds bake as the MJCF that they are written from."""
    if not (SHARED / scene).exists():
        pytest.skip(f"{SHARED / scene} is not there")
    world = write_world(mujoco.MjModel.from_xml_path(str(SHARED / scene)), tmp_path)
    found = navbake.bake({"scene": {"path": str(world), **settings}})
    mjcf = {"path": str(SHARED / scene), "meshes": "surface", **settings}
    expected = navbake.bake({"scene": mjcf})
    assert len(found.levels) == len(expected.levels)
    has_heights = "unitree" in scene  # of 16 bits
    for one, other in zip(found.levels, expected.levels, strict=True):
        assert np.array_equal(one.occupancy, other.occupancy)
        assert np.array_equal(one.room_index, other.room_index)
        assert np.array_equal(one.weights, other.weights)
        atol = 2e-6 if has_heights else 1e-12
        assert np.allclose(one.floor_height, other.floor_height, 0, atol, equal_nan=True)
        assert has_heights or one.user_data == other.user_data


def test_geometry_and_poses(tmp_path):
    """Poses nest; roll, pitch, yaw are about fixed axes; degrees and quaternions are read."""
    geometry = {
        "sphere": "<sphere><radius>0.5</radius></sphere>",
        "cylinder": "<cylinder><radius>0.5</radius><length>2</length></cylinder>",
        "capsule": "<capsule><radius>0.5</radius><length>2</length></capsule>",
        "ellipsoid": "<ellipsoid><radii>1 2 3</radii></ellipsoid>",
        "mesh": "<cone><radius>0.5</radius><length>2</length></cone>",
    }
    links = "".join(link(f"<geometry>{shape}</geometry>", name) for name, shape in geometry.items())
    turned = link(f'<pose degrees="true">0 0 1 90 0 90</pose>{BOX}', "turned")
    scene = load(write(tmp_path, model(links + turned, more="<pose>10 0 0 0 0 0</pose>")))
    types = {geom.name.split("::")[1]: geom.type for geom in scene.geoms}
    assert types == {**{kind: kind for kind in geometry}, "turned": "box"}
    (box,) = [geom.id for geom in scene.geoms if geom.type == "box"]
    # roll turns y to z, then yaw x to y: sides 1, 2, 4 lie along y, z, x
    only = scene.shapes.only(np.arange(len(scene.geoms)) == box)
    assert np.allclose(only.bounds, [[8, -0.5, 0], [12, 0.5, 2]], atol=1e-9)


def test_frames(tmp_path):
    """Frames on frames, placement frames of includes, and frames of nested models."""
    inner = model(
        '<frame name="foot"><pose>0 0 -2 0 0 0</pose></frame>' + link(BOX, more=""), "inner"
    )
    write(tmp_path, inner, "models/inner/model.sdf")
    world = write(
        tmp_path,
        '<world name="w"><frame name="corner"><pose>5 0 0 0 0 1.5707963267948966</pose></frame>'
        "<include><uri>model://inner</uri><name>a</name><placement_frame>foot</placement_frame>"
        '<pose relative_to="corner">3 0 0 0 0 0</pose></include>'
        + model(
            "<include><uri>model://inner</uri><name>in</name><pose>1 0 0 0 0 0</pose></include>"
            + link(BOX, more='<pose relative_to="in::foot">0 1 0 0 0 0</pose>'),
            "b",
        )
        + "</world>",
    )
    scene = load(world)
    places = {geom.name: scene.data.geom_xpos[geom.id] for geom in scene.geoms}
    assert np.allclose(places["a::l::c"], [5, 3, 2])
    assert np.allclose(places["b::in::l::c"], [1, 0, 0])
    assert np.allclose(places["b::l::c"], [1, 1, -2])
    assert {geom.body for geom in scene.geoms} == {"a", "b", "b::in"}


def test_meshes_bring_their_units_and_axes(tmp_path):
    """A DAE in centimetres, whose axis isn't read; an STL by <scale>, a submesh, a mirror."""
    turned = WEDGE.copy()
    turned.vertices = WEDGE.vertices[:, [0, 2, 1]] * [1, 1, -1] * 100
    write_dae(tmp_path / "a.dae", turned, 0.01, "Y_UP")
    WEDGE.copy().apply_scale(1000).export(tmp_path / "a.stl")
    two = "o one\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\no two\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf 4 5 6\n"
    (tmp_path / "two.obj").write_text(two)
    scale = "<scale>0.001 0.001 0.001</scale>"
    meshes = {
        "dae": "<uri>a.dae</uri>", "stl": f"<uri>file://a.stl</uri>{scale}",
        "mirror": "<uri>a.stl</uri><scale>-0.001 0.001 0.001</scale>",
        "two": "<uri>two.obj</uri><submesh><name>two</name></submesh>",
    }  # fmt: skip
    links = (
        link(f"<geometry><mesh>{each}</mesh></geometry>", name) for name, each in meshes.items()
    )
    scene = load(write(tmp_path, model("".join(links))))
    ids = {geom.name.split("::")[1]: geom.id for geom in scene.geoms}
    bounds = {name: np.array([(v := scene.exact_meshes[k].vertices).min(0), v.max(0)])
              for name, k in ids.items()}  # fmt: skip
    assert np.allclose(bounds["dae"], [[0, 0, -2], [3, 1, 0]], atol=1e-6)
    assert np.allclose(bounds["stl"], [[0, 0, 0], [3, 2, 1]], atol=1e-6)
    assert np.allclose(bounds["mirror"], [[-3, 0, 0], [0, 2, 1]], atol=1e-6)
    assert np.allclose(bounds["two"][:, 2], 5)
    shapes = {geom.name.split("::")[1]: geom.shape for geom in scene.geoms}
    assert [shapes[key] for key in ("dae", "stl", "mirror")] == ["closed surface"] * 3
    text = "<mesh><uri>two.obj</uri><submesh><name>three</name></submesh></mesh>"
    path = write(tmp_path, model(link(f"<geometry>{text}</geometry>")))
    with pytest.raises(SceneError, match=r"no submesh 'three' in .*two\.obj.*: it has one, two"):
        load(path)


def test_height_maps(tmp_path):
    """The brightest pixel is as high as <size> says; the first row is at the largest y."""
    pixels = np.full((5, 9), 51, np.uint8)
    pixels[0, :] = 204
    Image.fromarray(pixels).save(tmp_path / "hills.png")
    text = "<heightmap><uri>hills.png</uri><size>8 4 2</size><pos>0 0 1</pos></heightmap>"
    scene = load(write(tmp_path, model(link(f"<geometry>{text}</geometry>"))))
    corners = scene.shapes.triangles.corners.reshape(-1, 3)
    top = corners[corners[:, 2] > 1.4]
    assert np.allclose(top[top[:, 1] > 1.9][:, 2].max(), 3.0)
    assert np.allclose(top[top[:, 1] < 0.9][:, 2], 1.5)
    assert np.allclose(scene.bounds[:, :2], [[-4, -2], [4, 2]])


def test_joints(tmp_path):
    """A door in its frame: axes are the joint's, the parent's on request, links are bodies."""
    axis = "<axis><xyz{}>0 0 1</xyz><limit><lower>0</lower><upper>1.5</upper></limit></axis>"
    endless = axis.format(' expressed_in="__model__"').replace("1.5", "1e16")
    joints = (
        '<joint name="hinge" type="revolute"><pose>0.5 0 0 1.5707963267948966 0 0</pose>'
        f"<parent>frame</parent><child>leaf</child>{axis.format('')}</joint>"
        '<joint name="root" type="fixed"><parent>world</parent><child>frame</child></joint>'
        '<joint name="slide" type="prismatic"><parent>leaf</parent><child>bolt</child>'
        f"{endless}</joint>"
        '<joint name="odd" type="screw"><parent>frame</parent><child>knob</child></joint>'
    )
    links = link(BOX, "frame") + link(BOX, "leaf", "<pose>2 0 0 0 0 0</pose>")
    links += link(BOX, "bolt") + link(BOX, "knob")
    scene = load(write(tmp_path, model(links + joints, "door", more="<pose>0 0 7 0 0 0</pose>")
                       + model(link(BOX), "chair", more="")))  # fmt: skip
    compiled = scene.model
    hinge, slide = (compiled.joint(f"door::{name}") for name in ("hinge", "slide"))
    assert np.allclose(hinge.range, [0, 1.5]) and not compiled.jnt_limited[slide.id]
    data = scene.data
    mujoco.mj_kinematics(compiled, data)
    assert np.allclose(data.xanchor[hinge.id], [2.5, 0, 7])
    assert np.allclose(data.xaxis[hinge.id], [0, -1, 0])
    assert np.allclose(data.xaxis[slide.id], [0, 0, 1])
    assert compiled.joint(int(compiled.body("chair").jntadr[0])).type[0] == 0  # free
    assert {geom.body for geom in scene.geoms} == {
        "door", "door::leaf", "door::bolt", "door::knob", "chair"
    }  # fmt: skip
    assert any("'door::odd'" in text and "screw" in text for text in scene.warnings)


def test_what_is_drawn_and_what_collides(tmp_path):
    """Visuals don't count beside collisions; where all meshes are missing, nothing is left."""
    mesh = "<geometry><mesh><uri>model://chair/seat.dae</uri></mesh></geometry>"
    visual = f'<visual name="v">{BOX}</visual><visual name="lost">{mesh}</visual>'
    path = write(tmp_path, model(link(BOX).replace("</link>", f"{visual}</link>")))
    scene = load(path)
    assert {geom.name: geom.counted for geom in scene.geoms} == {"m::l::c": True, "m::l::v": False}
    assert any("seat.dae" in text and "'m::l::lost'" in text for text in scene.warnings)
    shown = load(path, geoms="visual").geoms
    assert {geom.name: geom.counted for geom in shown} == {"m::l::c": False, "m::l::v": True}
    with pytest.raises(SceneError, match=r"seat\.dae' of collision 'm::l::c'.*--model-path"):
        load(write(tmp_path, model(link(mesh))))


def test_where_models_are_looked_for(tmp_path, monkeypatch):
    """In `scene.model_path`, in Gazebo's variables, in folders above; its own ground is known."""
    far = tmp_path / "far"
    write(far, model(link(BOX), "chair"), "chair/model.sdf")
    include = "<include><uri>model://chair</uri><pose>1 0 0 0 0 0</pose></include>"
    ground = "<include><uri>model://ground_plane</uri></include>"
    ground += "<include><uri>model://sun</uri></include>"
    path = write(tmp_path / "near" / "worlds", f'<world name="w">{ground}{include}</world>')
    with pytest.raises(
        SceneError, match=r"w\.sdf names model 'model://chair', not found in .*models"
    ):
        load(path, strict=True)
    scene = load(path, model_path=[far])
    assert {geom.name for geom in scene.geoms} == {"ground_plane", "chair::l::c"}
    # it comes with Gazebo, so that nothing is missing
    assert not any("model://ground_plane" in text for text in scene.warnings)
    expected = {path, far / "chair" / "model.sdf"}
    assert set(find_inputs(path, folders=[far])) == expected
    monkeypatch.setenv("GAZEBO_MODEL_PATH", f"/nowhere:{far}")
    assert len(load(path).geoms) == 2
    assert set(find_inputs(path)) == expected
    assert load(path, model_path=[far]).digest == load(path).digest
    settings = SceneSettings(path=path)
    assert load_alone(settings, limits=CompileLimits()).digest == load(path).digest


def test_broken_worlds(tmp_path):
    def fails(text: str, match: str) -> None:
        with pytest.raises(SceneError, match=match):
            load(write(tmp_path, text))

    fails("<world", r"broken XML in .*w\.sdf")
    (tmp_path / "x.sdf").write_text("<mujoco/>")
    with pytest.raises(SceneError, match=r"expected <sdf> in .*x\.sdf, got <mujoco>"):
        load(tmp_path / "x.sdf")
    fails("<world name='w'><light name='s'/></world>", r"no geometry in .*w\.sdf")
    bad = BOX.replace("1 2 4", "1 2")
    fails(model(link(bad)), r"expected 3 numbers at <size> of collision 'm::l::c'.*got '1 2'")
    fails(model(link(f"<pose>1 2</pose>{BOX}")), r"expected 6 numbers at <pose> of .*got '1 2'")
    lost = link(BOX, more='<pose relative_to="roof">0 0 0 0 0 0</pose>')
    fails(model(lost), r"no frame 'roof' of m in .*w\.sdf: it has l")
    loop = '<frame name="a" attached_to="b"/><frame name="b" attached_to="a"/>'
    fails(model(lost.replace("roof", "a") + loop), r"frame 'a' of m .*relative to itself")
    joint = '<joint name="j" type="fixed"><parent>l</parent><child>no</child></joint>'
    fails(model(link(BOX) + joint, more=""), r"no frame 'no' of m in .*w\.sdf: it has j, l")
    write(tmp_path, model("<include><uri>model://self</uri></include>"), "self/model.sdf")
    fails("<include><uri>model://self</uri></include>", r"self/model\.sdf includes itself")


def positions(scene: Scene) -> dict[str, list[float]]:
    return {geom.name: np.round(scene.data.geom_xpos[geom.id], 6).tolist() for geom in scene.geoms}


def test_a_frame_may_be_that_of_a_later_model(tmp_path):
    at = '<pose relative_to="{}">{} 0 0 0 0 0</pose>'
    early = model(link(BOX), "early", f"<static>1</static>{at.format('late', 1)}")
    late = model(link(BOX), "late", "<static>1</static><pose>5 0 0 0 0 0</pose>")
    found = positions(load(write(tmp_path, early + late)))
    assert found == {"early::l::c": [6, 0, 0], "late::l::c": [5, 0, 0]}
    inner = model(link(BOX), "in", "<pose>0 3 0 0 0 0</pose>")
    held = model(inner, "out", "<static>1</static><pose>7 0 0 0 0 0</pose>").replace(
        'name="out"', 'name="out" placement_frame="in::l"'
    )
    assert positions(load(write(tmp_path, held))) == {"out::in::l::c": [7, 0, 0]}
    loop = model(link(BOX), "a", at.format("b", 1)) + model(link(BOX), "b", at.format("a", 1))
    with pytest.raises(SceneError, match="relative to itself"):
        load(write(tmp_path, loop))


def test_long_chains_of_frames_are_one_line(tmp_path):
    chain = "".join(f'<frame name="f{k}" attached_to="f{k + 1}"/>' for k in range(1500))
    box = link(BOX, more='<pose relative_to="f0">0 0 0 0 0 0</pose>')
    path = write(tmp_path, model(box + chain + '<frame name="f1500"/>'))
    with pytest.raises(SceneError, match=r"cannot read .*w\.sdf: RecursionError"):
        load(path)


def test_merged_includes(tmp_path):
    """Links of a merged model are the outer one's, in the place of the include."""
    leaf = link(BOX, "leaf", '<pose relative_to="hinges">1 0 0 0 0 0</pose>')
    leaf += '<frame name="hinges"><pose>0 2 0 0 0 0</pose></frame>'
    write(tmp_path, model(leaf, "part", ""), "part/model.sdf")
    include = '<include merge="true"><uri>model://part</uri><pose>0 0 3 0 0 0</pose></include>'
    joint = (
        '<joint name="j" type="revolute"><parent>base</parent><child>leaf</child><axis/></joint>'
    )
    scene = load(write(tmp_path, model(link(BOX, "base") + include + joint, "door", "")))
    assert positions(scene) == {"door::base::c": [0, 0, 0], "door::leaf::c": [1, 2, 3]}
    assert scene.model.joint("door::j").type[0] == mujoco.mjtJoint.mjJNT_HINGE
    assert {geom.body for geom in scene.geoms} == {"door", "door::leaf"}


@pytest.mark.parametrize(
    ("version", "more", "axis"),
    [
        ("1.4", "", [1, 0, 0]),
        ("1.5", "", [0, 1, 0]),
        ("1.6", "<use_parent_model_frame>1</use_parent_model_frame>", [1, 0, 0]),
    ],
)
def test_axes_of_old_versions(tmp_path, version, more, axis):
    """Until 1.4, axes are in the model's frame; later on in the joint's, unless they say so."""
    links = link(BOX, "a") + link(BOX, "b", "<pose>0 0 0 0 0 1.5707963267948966</pose>")
    joint = '<joint name="j" type="revolute"><parent>a</parent><child>b</child>'
    joint += f"<axis><xyz>1 0 0</xyz>{more}</axis></joint>"
    path = write(tmp_path, model(links + joint, more=""))
    path.write_text(path.read_text().replace("1.9", version))
    scene = load(path)
    mujoco.mj_kinematics(scene.model, scene.data)
    assert np.allclose(scene.data.xaxis[scene.model.joint("m::j").id], axis, atol=1e-9)


def test_ends_of_joints(tmp_path):
    """A model stands for its canonical link; a world has joints of its own, to the world, too."""
    arm = model(link(BOX, "x") + link(BOX, "y"), "arm", "").replace(
        'name="arm"', 'name="arm" canonical_link="y"'
    )
    joint = '<joint name="{}" type="{}"><parent>{}</parent><child>{}</child><axis/></joint>'
    joints = joint.format("j", "revolute", "world", "arm")
    scene = load(write(tmp_path, f'<world name="w">{arm}{joints}</world>'))
    turned = scene.model.body(scene.model.joint("j").bodyid[0]).name
    assert {geom.name for geom in scene.geoms if geom.body == turned} == {"arm::y::c"}
    outer = model(link(BOX, "base") + arm + joint.format("j", "fixed", "base", "arm::y"), "m", "")
    scene = load(write(tmp_path, outer))
    assert scene.model.body("m::arm").parentid[0] == scene.model.body("m").id


def test_the_latest_version_of_a_model_is_taken(tmp_path):
    for name in ("new", "old"):
        write(tmp_path, model(link(BOX), name), f"chair/{name}.sdf")
    files = '<sdf version="1.10">new.sdf</sdf><sdf version="1.9">old.sdf</sdf>'
    (tmp_path / "chair" / "model.config").write_text(f"<model>{files}</model>")
    scene = load(write(tmp_path, "<include><uri>model://chair</uri></include>"))
    assert {geom.name for geom in scene.geoms} == {"new::l::c"}


def test_an_empty_folder_hides_no_later_place(tmp_path):
    (tmp_path / "chair").mkdir()
    path = write(tmp_path, "<include><uri>model://chair</uri></include>")
    with pytest.raises(SceneError, match=r"'model://chair', .*chair has no model\.sdf"):
        load(path)
    write(tmp_path, model(link(BOX), "chair"), "models/chair/model.sdf")
    assert {geom.name for geom in load(path).geoms} == {"chair::l::c"}


def test_a_drawn_plane_may_move(tmp_path):
    plane = '<visual name="v"><geometry><plane><size>2 4</size></plane></geometry></visual>'
    moving = link(BOX).replace("</link>", f"{plane}</link>")
    scene = load(write(tmp_path, model(moving, more="")), geoms="visual")
    assert np.allclose(sorted(np.ptp(scene.model.mesh_vert, axis=0)), [0, 2, 4])


def test_models_are_bounded(tmp_path, monkeypatch):
    """Includes that double each other, of which a few kilobytes make millions."""
    monkeypatch.setattr(parsed_scene, "MAX_GEOMS", 1000)
    for k in range(40):
        twice = "".join(
            f"<include><uri>model://m{k + 1}</uri><name>{side}</name></include>" for side in "ab"
        )
        write(tmp_path, model(twice, f"m{k}"), f"m{k}/model.sdf")
    write(tmp_path, model(link(BOX), "m40"), "m40/model.sdf")
    with pytest.raises(SceneError, match=r"w\.sdf has more than 1,000 pieces and models"):
        load(write(tmp_path, "<include><uri>model://m0</uri></include>"))


def test_an_open_door_frees_its_doorway(tmp_path):
    def box(name: str, at: str, size: str, joint: str = "", static: str = "1") -> str:
        shape = f"<geometry><box><size>{size}</size></box></geometry>"
        return model(link(shape) + joint, name, f"<static>{static}</static><pose>{at}</pose>")

    hinge = (
        '<joint name="hinge" type="revolute"><pose>0 0.58 0 0 0 0</pose><parent>world</parent>'
        "<child>l</child><axis><xyz>0 0 1</xyz><limit><lower>0</lower><upper>1.5708</upper></limit>"
        "</axis></joint>"
    )
    world = box("floor", "0 0 -0.05 0 0 0", "8 4 0.1") + box("a", "0 1.3 1 0 0 0", "0.2 1.4 2")
    world += box("b", "0 -1.3 1 0 0 0", "0.2 1.4 2")
    leads_through(write(tmp_path, world + box("door", "0 0 1.05 0 0 0", "0.06 1.16 2", hinge, "0")))


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_a_world_bakes_and_is_verified(tmp_path):
    """A room of boxes: verify, `geoms` and updates need no reader of their own."""
    walls = {"floor": (0, 0, -0.05, 6, 6, 0.1), "wall": (0, 3, 1, 6, 0.1, 2)}
    links = "".join(
        link(f"<pose>{x} {y} {z} 0 0 0</pose><geometry><box><size>{a} {b} {c}</size></box>"
             "</geometry>", name)
        for name, (x, y, z, a, b, c) in walls.items()
    )  # fmt: skip
    chair = link("<pose>0 0 0.5 0 0 0</pose><geometry><box><size>1 1 1</size></box></geometry>")
    path = write(tmp_path, f'<world name="w">{model(links, "room")}{model(chair, "chair", "")}'
                 "</world>")  # fmt: skip
    grid = navbake.bake(path)
    assert navbake.verify(grid, path).ok
    baker = navbake.Baker(path)
    assert baker.grid.occupancy[30, 30] == 1
    baker.update(bodies={"chair": [2, 2, 0]})
    assert baker.grid.occupancy[30, 30] == 0


def test_trimesh_agrees_on_tessellated_solids():
    from navbake.baker.geometry.shapes import tessellate

    sizes = {"sphere": (1.0,), "capsule": (0.5, 2.0), "cylinder": (1.0, 2.0), "cone": (1.0, 2.0),
             "ellipsoid": (1.0, 2.0, 3.0), "box": (1.0, 2.0, 3.0)}  # fmt: skip
    volumes = {"sphere": 4 / 3, "capsule": 4 / 3 * 0.125 + 0.25 * 4, "cylinder": 4.0,
               "cone": 4 / 3, "ellipsoid": 8.0, "box": 48 / np.pi}  # fmt: skip
    for kind, size in sizes.items():
        solid = trimesh.Trimesh(*tessellate(kind, size), process=True)
        solid.update_faces(solid.nondegenerate_faces())
        assert solid.is_watertight
        assert solid.volume == pytest.approx(volumes[kind] * np.pi, rel=0.03)


# ---------------------------------------------------------------- as Gazebo reads it

FLOOR = model(link("<geometry><box><size>6 4 0.1</size></box></geometry>"), "floor")


def include(uri: str, name: str = "") -> str:
    stated_name = f"<name>{name}</name>" if name else ""
    return f"<include><uri>{uri}</uri>{stated_name}</include>"


def missing_warnings(scene: Scene) -> list[str]:
    return [text for text in scene.warnings if "not found" in text]


@pytest.mark.parametrize(
    "content",
    [
        "<!-- gz sim --levels w.sdf -->" + FLOOR,
        '<plugin><gz-gui><property key="x"/></gz-gui></plugin><gz:system gz:type="a"/>' + FLOOR,
        "<description>boxes & walls &nbsp;</description>" + FLOOR,
        '<foo:state xmlns="http://else.where"/>' + FLOOR,
    ],
)
def test_xml_that_only_tinyxml_reads(tmp_path, content):
    """What Gazebo's parser passes over stops no bake."""
    path = write(tmp_path, content)
    assert {geom.name for geom in load(path).geoms} == {"floor::l::c"}
    text = path.read_text()
    namespace = text.replace("<sdf ", '<sdf xmlns="http://sdformat.org/schemas/root.xsd" ')
    path.write_text(f"\n  {namespace}")
    assert {geom.name for geom in load(path).geoms} == {"floor::l::c"}


def test_missing_files_are_left_out_with_one_warning(tmp_path):
    """All names are in it; strict settings refuse them; the rest of the world is there."""
    mesh = "<geometry><mesh><uri>model://sofa/{}.dae</uri></mesh></geometry>"
    world = include("model://chair", "a") + include("model://chair", "b") + include("model://bed")
    world += FLOOR + model(link(mesh.format("seat")), "sofa")
    hanging = '<joint name="j" type="fixed"><parent>a::leg</parent><child>floor</child></joint>'
    placed = model(link(BOX), "lamp", '<static>1</static><pose relative_to="a">1 0 0 0 0 0</pose>')
    path = write(tmp_path, f'<world name="w">{world}{placed}{hanging}</world>')
    scene = load(path)
    assert {geom.name for geom in scene.geoms} == {"floor::l::c", "lamp::l::c"}
    (warning,) = missing_warnings(scene)
    for item in (
        "'model://chair' (2 times)",
        "'model://bed'",
        "seat.dae' of collision 'sofa::l::c'",
    ):
        assert item in warning
    assert "--model-path" in warning and "\n" not in warning
    with pytest.raises(SceneError, match=r"'model://bed', .*seat\.dae.* not found in .*--strict"):
        load(path, strict=True)
    with pytest.raises(SceneError, match=r"'model://bed', not found in .*no geometry is left"):
        load(write(tmp_path, include("model://bed")))


def test_exclude_is_heard_before_files_are_read(tmp_path):
    """A missing, a broken and a far away model don't matter where settings leave them out."""
    mesh = "<geometry><mesh><uri>{}</uri></mesh></geometry>"
    (tmp_path / "torn.obj").write_text("v 0 0\nf 1 2 9\n")
    (tmp_path / "torn" / "model.sdf").parent.mkdir()
    (tmp_path / "torn" / "model.sdf").write_text("<sdf><model")
    names = ("chair", "sofa", "shelf", "torn")
    world = include("model://none", "chair") + model(link(mesh.format("torn.obj")), "sofa")
    world += model(link(mesh.format("none.obj")), "shelf") + include("model://torn")
    path = write(tmp_path, f'<world name="w">{world}{FLOOR}</world>')
    with pytest.raises(SceneError, match="torn"):
        load(path)
    scene = load(path, strict=True, exclude={"bodies": [f"{name[:3]}*" for name in names]})
    assert {geom.name for geom in scene.geoms} == {"floor::l::c"}
    assert not scene.warnings


def test_addresses_of_fuel(tmp_path, monkeypatch):
    """A model's folder in any case, or in Gazebo's cache: the latest version if none is said."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("GZ_FUEL_CACHE_PATH", raising=False)
    server = "https://fuel.gazebosim.org/1.0/OpenRobotics/models/Big Drawer"
    cache = tmp_path / "home/.gz/fuel/fuel.gazebosim.org/openrobotics/models/big drawer"
    worlds = tmp_path / "worlds"
    mesh = f"<geometry><mesh><uri>{server}/2/files/meshes/d.obj</uri></mesh></geometry>"
    by_mesh = write(worlds, FLOOR + model(link(mesh)), "mesh.sdf")
    by_model = write(worlds, FLOOR + include(server.replace(" ", "%20"), "d"), "model.sdf")
    saved = mesh.replace(
        f"{server}/2/files", "file:///home/user/.gz/fuel/fuel.gazebosim.org/openrobotics/models"
        "/big drawer/2",
    )  # fmt: skip
    by_cache = write(worlds, FLOOR + model(link(saved)), "saved.sdf")
    for path in (by_mesh, by_model, by_cache):
        assert len(missing_warnings(load(path))) == 1
    WEDGE.export(worlds / "models.obj")
    content = (worlds / "models.obj").read_bytes()
    for folder in (worlds / "models" / "big_Drawer", cache / "2"):
        (folder / "meshes").mkdir(parents=True)
        (folder / "meshes" / "d.obj").write_bytes(content)
        for path in (by_mesh, by_cache):
            assert len(load(path).geoms) == 2 and not load(path).warnings
            assert folder / "meshes" / "d.obj" in find_inputs(path)
        (folder / "meshes" / "d.obj").unlink()
    for version in (2, 10):
        write(cache / str(version), model(link(BOX), f"v{version}"), "model.sdf")
    scene = load(by_model)
    assert {geom.name for geom in scene.geoms} == {"floor::l::c", "d::l::c"}
    assert cache / "10" / "model.sdf" in find_inputs(by_model)


def test_outlines_are_prisms(tmp_path):
    """Concave outlines, holes and crossings: what an odd number of outlines encloses is solid."""
    points = "".join(f"<point>{x} {y}</point>" for x, y in
                     ((-2, -2), (2, -2), (2, 2), (0, 0), (-2, 2)))  # fmt: skip
    hole = "".join(f"<point>{x} {y}</point>" for x, y in
                   ((-0.5, -1.5), (0.5, -1.5), (0.5, -0.5), (-0.5, -0.5)))  # fmt: skip
    outline = "<polyline><height>1.5</height>{}</polyline>"
    shape = f"<geometry>{outline.format(points)}{outline.format(hole)}</geometry>"
    ground = model(link("<geometry><plane/></geometry>"), "ground")
    path = write(tmp_path, ground + model(link(shape)))
    grid = navbake.bake({"scene": {"path": str(path)}, "grid": {"bounds": [-4, -4, 4, 4]}})
    finder = navbake.PathFinder(grid)
    blocked = [(0, -0.3, 0), (-1.5, 1, 0), (1.5, 0, 0), (0, -1.8, 0)]
    free = [(0, 1, 0), (-3, 0, 0), (0, -1, 0)]
    assert not any(finder.is_navigable(position) for position in blocked)
    assert all(finder.is_navigable(position) for position in free)
    area = (grid.levels[0].occupancy == 1).sum() * 0.01
    assert area == pytest.approx(11, abs=2.5)  # 16 - 4 - 1, and the rim of cells that it meets


def test_outlines_that_enclose_nothing_are_told(tmp_path):
    flat = "<geometry><polyline><height>1</height><point>0 0</point><point>1 1</point></polyline>"
    scene = load(write(tmp_path, FLOOR + model(link(f"{flat}</geometry>"))))
    assert len(scene.geoms) == 1
    assert any("'m::l::c'" in text and "<polyline>" in text for text in scene.warnings)
    with pytest.raises(navbake.SceneError, match=r"no geometry in .*'m::l::c'.* <polyline>"):
        load(write(tmp_path, model(link(f"{flat}</geometry>"))))


@pytest.mark.parametrize("num_points", [80, 300, 2000])
def test_outline_that_crosses_itself_too_often_is_refused_at_once(tmp_path, num_points):
    """Each crossing takes prisms of its own: 300 points in any order took hours."""
    points = np.random.default_rng(0).uniform(-3, 3, (num_points, 2))
    text = "".join(f"<point>{x} {y}</point>" for x, y in points.tolist())
    shape = f"<geometry><polyline><height>1</height>{text}</polyline></geometry>"
    start = time.perf_counter()
    with pytest.raises(navbake.SceneError, match=r"'m::l::c'.* crosses itself at \d+ heights"):
        load(write(tmp_path, FLOOR + model(link(shape))))
    assert time.perf_counter() - start < 10


@pytest.mark.parametrize("is_crossing", [False, True])
def test_outline_takes_few_prisms(is_crossing):
    """About as many as corners and crossings, however many teeth stand side by side."""
    rng = np.random.default_rng(1)
    heights = np.where(np.arange(200) % 2, rng.uniform(1, 3, 200), rng.uniform(-1, 0, 200))
    outline = np.array([*zip(range(200), heights.tolist(), strict=True), (199, -2), (0, -2)])
    area = np.trapezoid(heights) + 2 * 199
    if is_crossing:  # what lies between the crossing outline and the first one is left
        outline = np.concatenate(
            [outline, [[0.0, -1.5], [199.0, -1.5], [199.0, -2.0], [0.0, -2.0]]]
        )
        area -= 199 * 0.5
    prisms = extrude_outlines([outline], 1.0)
    volume = sum(
        np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
        for corners in (prism.vertices[prism.faces] for prism in prisms)
    )
    assert abs(volume) == pytest.approx(area)
    assert len(prisms) < 600


def test_dark_pixels_of_images_are_boxes(tmp_path):
    """From the corner of the first pixel on, columns along x and rows along y."""
    pixels = np.full((4, 10), 255, np.uint8)
    pixels[1:3, 2:7] = 200
    pixels[3, 9] = 0
    Image.fromarray(pixels).save(tmp_path / "map.png")
    text = "<image><uri>map.png</uri><scale>0.5</scale><threshold>200</threshold><height>2</height>"
    scene = load(write(tmp_path, model(link(f"<geometry>{text}</image></geometry>"))))
    assert [geom.type for geom in scene.geoms] == ["box", "box"]
    assert np.allclose(scene.shapes.boxes, [[1, 0.5, 0, 3.5, 1.5, 2], [4.5, 1.5, 0, 5, 2, 2]])


def test_what_lies_beyond_all_limits_is_left_out(tmp_path):
    """A stray node of a mesh, a mesh of stray nodes, and a model at a stray pose."""
    near = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    far = "v 8e17 0 0\nv 9e17 0 0\nv 8e17 1e17 0\n"
    (tmp_path / "pot.obj").write_text(f"o pot\n{near}o stray\n{far}f 4 5 6\n")
    (tmp_path / "lost.obj").write_text(f"o lost\n{far}f 1 2 3\n")
    mesh = "<geometry><mesh><uri>{}.obj</uri></mesh></geometry>"
    world = model(link(mesh.format("pot")), "pot") + model(link(mesh.format("lost")), "lost")
    world += model(link(BOX), "away", "<static>1</static><pose>0 -1e17 0 0 0 0</pose>") + FLOOR
    scene = load(write(tmp_path, world))
    assert {geom.name for geom in scene.geoms} == {"pot::l::c", "floor::l::c"}
    for name in ("'stray'", "'lost::l::c'", "'away::l::c'"):
        assert any(name in text and "1e+10 m" in text for text in scene.warnings)
    assert np.abs(scene.bounds).max() < 10


def test_stray_node_is_told_of_where_its_mesh_counts(tmp_path):
    near = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    far = "v 8e17 0 0\nv 9e17 0 0\nv 8e17 1e17 0\n"
    (tmp_path / "pot.obj").write_text(f"o pot\n{near}o stray\n{far}f 4 5 6\n")
    (tmp_path / "lost.obj").write_text(f"o lost\n{far}f 1 2 3\n")
    mesh = "<geometry><mesh><uri>{}.obj</uri></mesh></geometry>"
    names = {"a": "pot", "b": "pot", "c": "lost"}
    models = [
        model(link(mesh.format(file)), name, "<static>1</static>") for name, file in names.items()
    ]
    path = write(tmp_path, "".join(models) + FLOOR)

    def stray_warnings(*excluded):
        warnings = load(path, exclude={"bodies": list(excluded)}).warnings
        assert not any("matches nothing" in text for text in warnings)
        return [name for name in ("'stray'", "'c::l::c'") if any(name in w for w in warnings)]

    assert stray_warnings() == ["'stray'", "'c::l::c'"]
    assert stray_warnings("a") == ["'stray'", "'c::l::c'"]
    assert stray_warnings("a", "b") == ["'c::l::c'"]
    assert stray_warnings("a", "b", "c") == []


def test_a_file_that_includes_itself_is_told(tmp_path):
    world_file = "<world name='w'><include><uri>{}</uri></include>" + FLOOR + "</world>"
    path = write(tmp_path, world_file.format("w.sdf"))
    (text,) = load(path).warnings
    assert text.startswith("<include> of 'w.sdf'") and text.endswith(
        "<model>, and is the file itself"
    )
    write(tmp_path, world_file.format("x.sdf"), "other.sdf")
    (text,) = load(write(tmp_path, world_file.format("other.sdf"))).warnings
    assert text.endswith("other.sdf has no <model>")
    path = write(tmp_path, model("<include><uri>m.sdf</uri></include>" + link(BOX)), "m.sdf")
    with pytest.raises(SceneError, match="includes itself, by model"):
        load(path)
    write(tmp_path, "<light type='point' name='l'/>", "lamp.sdf")
    assert not load(write(tmp_path, world_file.format("lamp.sdf"))).warnings


def test_image_with_a_broken_header_is_one_line_without_an_address(tmp_path):
    (tmp_path / "map.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(40))
    text = "<image><uri>map.png</uri><scale>0.5</scale><threshold>200</threshold><height>2</height>"
    path = write(tmp_path, model(link(f"<geometry>{text}</image></geometry>")))
    with pytest.raises(SceneError, match=r"map\.png is no image .*: its header is broken$"):
        load(path)


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
@pytest.mark.parametrize(
    ("name", "settings", "free"),
    [
        ("sdf_lenient_xml/comment.sdf", {}, 16.0),
        ("sdf_lenient_xml/prefix.sdf", {}, 16.0),
        ("stray_node/room.sdf", {}, 61.4),
        ("stray_node/room.sdf", {"scene": {"exclude": {"bodies": ["pot"]}}}, 62.4),
        ("sdf_polyline/poly.sdf", {"grid": {"bounds": [-8, -8, 8, 8]}}, 251.9),
    ],
)
def test_reported_worlds(name, settings, free):
    path = REPORTS / name
    if not path.exists():
        pytest.skip(f"{path} is not there")
    settings = {**settings, "scene": {**settings.get("scene", {}), "path": str(path)}}
    grid = navbake.bake(settings)
    assert sum(level.free.sum() for level in grid.levels) * 0.01 == pytest.approx(free)


def test_reported_fuel_mesh():
    path = REPORTS / "fuel_mesh_uri" / "world.sdf"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    scene = load(path, model_path=[path.parent / "models"])
    assert [geom.name for geom in scene.geoms] == ["drawer::l::c"] and not scene.warnings
