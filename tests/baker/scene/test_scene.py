"""Scenes of MuJoCo's own formats: loading, posing, geometry, reports."""

from __future__ import annotations

import gc
import itertools
import os
import threading
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image

from navbake.baker.scene import scene as scene_module
from navbake.config.settings import SceneSettings
from navbake.errors import ConfigError, SceneError
from oracles.rays import first_hit
from scene_files import WEDGE
from scenes_alone import load_alone

TETRAHEDRON = 'vertex="0 0 0 1 0 0 0 1 0 0 0 1"'


@pytest.fixture
def load(tmp_path, monkeypatch):
    """Returns a function that loads MJCF, given what is in its <worldbody> and before it."""
    monkeypatch.chdir(tmp_path)

    def call(world, before="", name="scene.xml", **settings):
        text = f"<mujoco>{before}<worldbody>{world}</worldbody></mujoco>"
        Path(name).write_text(text, encoding="utf-8")
        return load_alone(SceneSettings(path=tmp_path / name, **settings))

    return call


def corners_of(scene, geom):
    triangles = scene.shapes.triangles
    return triangles.corners[triangles.geom == geom]


# ---------------------------------------------------------------- files


def test_includes_meshdir_defaults_and_textures(load, tmp_path):
    (tmp_path / "parts/meshes").mkdir(parents=True)
    WEDGE.export(tmp_path / "parts/meshes/wedge.obj")
    (tmp_path / "parts/wall.xml").write_text(
        '<mujoco><geom name="wall" class="far" size="1 1 1"/></mujoco>'
    )
    before = """
      <compiler meshdir="parts/meshes" angle="degree"/>
      <default><default class="far"><geom type="box" pos="7 0 0"/></default></default>
      <asset><mesh file="wedge.obj" scale="2 2 2"/></asset>
    """
    scene = load('<geom type="mesh" mesh="wedge"/><include file="parts/wall.xml"/>', before)
    assert [(geom.name, geom.shape) for geom in scene.geoms] == [
        ("geom 0", "hull"),
        ("wall", "solid"),
    ]
    np.testing.assert_allclose(scene.bounds, [[0, -1, -1], [8, 4, 2]], atol=1e-6)


@pytest.mark.parametrize("suffix", [".xml", ".XML", ".mjcf", ".urdf"])
def test_the_root_tells_mjcf_from_urdf(load, suffix):
    assert load('<geom size="1"/>', name=f"scene{suffix}").id == "scene"


def test_ground_is_added_to_files_that_end_in_xml(load, tmp_path):
    (tmp_path / "scene.mjcf").write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(ConfigError, match=r"can't be added to .*scene\.mjcf: let its name end in"):
        load_alone(SceneSettings(path=tmp_path / "scene.mjcf", ground=0.0))


def test_mujoco_s_parser_is_the_judge_of_mjcf(load, tmp_path):
    (tmp_path / "lax.xml").write_text(
        '\n <?xml version="1.0"?><mujoco><worldbody><geom size="1"/></worldbody></mujoco>'
    )
    assert len(load_alone(SceneSettings(path=tmp_path / "lax.xml")).geoms) == 1


def test_what_mujoco_warns_of_is_kept(load, tmp_path):
    text = (
        '<mujoco><compiler settotalmass="3"/><worldbody><body><freejoint/><geom size="1"/></body>'
    )
    (tmp_path / "scene.xml").write_text(text + "</worldbody></mujoco>")
    if not hasattr(mujoco.MjsMesh, "octree_maxdepth"):
        pytest.skip("older MuJoCos don't warn of it")
    scene = load_alone(SceneSettings(path=tmp_path / "scene.xml"))
    assert ["settotalmass" in warning for warning in scene.warnings].count(True) == 1


def test_mjb_is_the_same_scene(load, tmp_path):
    world = '<geom size="1"/><body name="b" pos="2 0 0"><geom type="mesh" mesh="m"/></body>'
    scene = load(world, f'<asset><mesh name="m" {TETRAHEDRON}/></asset>')
    mujoco.mj_saveModel(scene.model, str(tmp_path / "scene.mjb"))
    again = load_alone(SceneSettings(path=tmp_path / "scene.mjb"))
    assert again.geoms == scene.geoms
    assert again.digest == scene.digest
    np.testing.assert_array_equal(again.shapes.triangles.corners, scene.shapes.triangles.corners)


def test_id_is_the_stem_unless_given(load):
    assert load('<geom size="1"/>').id == "scene"
    assert load('<geom size="1"/>', id="hall").id == "hall"


def test_settings_for_meshes_do_nothing_here(load):
    assert load('<geom size="1"/>', up="y", unit=0.01).warnings == [
        "`scene.up` is for mesh files and does nothing here",
        "`scene.unit` is for mesh files and does nothing here",
    ]


def test_settings_for_sdf_and_urdf_do_nothing_here(load, tmp_path):
    strict = "`scene.strict` (`--strict`) is for SDF and does nothing here"
    paths = "`scene.model_path` (`--model-path`) is for SDF and URDF and does nothing here"
    for_models = {"strict": True, "model_path": [tmp_path]}
    assert load('<geom size="1"/>', **for_models).warnings == [strict, paths]
    mesh = tmp_path / "a.obj"
    mesh.write_text("v 0 0 0\nv 4 0 0\nv 0 4 0\nf 1 2 3\n")
    warnings = load_alone(SceneSettings(path=mesh, up="z", **for_models)).warnings
    assert strict in warnings and paths in warnings
    shape = "<collision><geometry><box size='4 4 1'/></geometry></collision>"
    for name in ("a.urdf", "urdf.xml"):
        (tmp_path / name).write_text(f"<robot name='r'><link name='l'>{shape}</link></robot>")
        settings = SceneSettings(path=tmp_path / name, **for_models)
        assert load_alone(settings).warnings == [strict]


def test_flex_and_skin_are_named(load):
    world = """<geom size="1"/><body name="b"><geom size=".1"/></body>
      <flexcomp name="cloth" type="grid" count="4 4 1" spacing=".1 .1 .1" dim="2" radius=".01"
                mass="1"><edge equality="true"/></flexcomp>"""
    skin = """<deformable><skin name="coat" vertex="0 0 0 1 0 0 0 1 0" face="0 1 2"><bone body="b"
      bindpos="0 0 0" bindquat="1 0 0 0" vertid="0 1 2" vertweight="1 1 1"/></skin></deformable>"""
    warnings = load(world, skin).warnings
    assert "flex can't be baked and is left out: cloth" in warnings
    assert "skin can't be baked and is left out: coat" in warnings


def test_numbers_whose_squares_are_none_are_refused(load):
    solid = '<geom size="1"/><geom type="ellipsoid" pos="2 0 0" size="1e200 1 1"/>'
    with pytest.raises(SceneError, match=r"geom 'geom 1' has a pose or size that is no number, or"):
        load(solid)
    field = '<asset><hfield name="h" nrow="2" ncol="2" size="1e200 1 1 1"/></asset>'
    with pytest.raises(SceneError, match=r"geom 'geom 0' has a pose or size that is no number, or"):
        load('<geom type="hfield" hfield="h"/>', field)


def test_warnings_of_mujoco_become_ours(load, capfd, tmp_path):
    before = mujoco.get_mju_user_warning()
    world = '<geom size="1"/><body><geom size="1" pos="nan 0 0"/></body>'
    with pytest.raises(SceneError, match=r"geom 'geom 1' has a pose or size that is no number, or"):
        load(world)
    scene = load(world, exclude={"geoms": ["geom 1"]})
    assert scene.warnings == ["MuJoCo: XML contains a 'NaN'. Please check it carefully."]
    assert capfd.readouterr().err == ""
    assert os.listdir(tmp_path) == ["scene.xml"]  # no MUJOCO_LOG.TXT
    assert mujoco.get_mju_user_warning() is before


def test_names_that_are_not_utf_8(load, tmp_path):
    scene = load('<body name="caf\xe9"><joint name="\xe9"/><geom name="t\xfcr" size="1"/></body>')
    path = tmp_path / "latin.xml"
    text = (tmp_path / "scene.xml").read_text(encoding="utf-8")
    path.write_bytes(('<?xml version="1.0" encoding="latin-1"?>' + text).encode("latin-1"))
    assert [(geom.name, geom.body) for geom in scene.geoms] == [("t\xfcr", "caf\xe9")]
    scene = load_alone(SceneSettings(path=path))  # MuJoCo takes the bytes as they are
    assert [(geom.name, geom.body) for geom in scene.geoms] == [("t\ufffdr", "caf\ufffd")]
    with pytest.raises(ConfigError, match="has \ufffd"):
        load_alone(SceneSettings(path=path, joints={"a": 1.0}))


def test_garbage_is_collected_while_a_file_is_compiled(load, monkeypatch):
    states = []
    load_model = scene_module.load_model

    def spy(*args):
        states.append(gc.isenabled())
        return load_model(*args)

    monkeypatch.setattr(scene_module, "load_model", spy)
    load('<geom type="box" size="1 1 1"/>')
    assert states == [True]


def test_loads_in_threads(load, tmp_path):
    load('<geom size="1"/>')
    found = []

    def work():
        found.append(load_alone(SceneSettings(path=tmp_path / "scene.xml")).digest)

    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 8
    assert len(set(found)) == 1


# ---------------------------------------------------------------- pose

JOINTS = """
  <body name="a" pos="1 0 0">
    <joint name="hinge" axis="0 0 1"/><geom name="a" size="1" pos="1 0 0"/>
  </body>
  <body name="b"><joint name="slide" type="slide" axis="0 1 0"/><geom name="b" size="1"/></body>
  <body name="c"><joint name="ball" type="ball"/><geom name="c" size="1" pos="1 0 0"/></body>
  <body name="d" pos="9 9 9"><freejoint name="free"/><geom name="d" size="1"/></body>
  <body name="e" mocap="true" pos="3 3 3"><geom name="e" size="1"/></body>
"""
KEYS = """<keyframe>
  <key qpos="0 5 1 0 0 0 1 2 3 1 0 0 0" mpos="4 4 4"/>
  <key name="open" qpos="1.5707963267948966 0 0 0 0 1 0 0 0 1 0 0 0"/>
</keyframe>"""


def positions(scene):
    return dict(zip("abcde", scene.shapes.solids.pos.round(6).tolist(), strict=True))


def test_rests_in_qpos0(load):
    assert positions(load(JOINTS)) == {
        "a": [2, 0, 0],
        "b": [0, 0, 0],
        "c": [1, 0, 0],
        "d": [9, 9, 9],
        "e": [3, 3, 3],
    }


def test_keyframe_by_index_or_name(load):
    first = positions(load(JOINTS, KEYS, keyframe=0))
    assert (first["b"], first["d"], first["e"]) == ([0, 5, 0], [1, 2, 3], [4, 4, 4])
    named = positions(load(JOINTS, KEYS, keyframe="open"))
    assert (named["a"], named["c"]) == ([1, 1, 0], [-1, 0, 0])
    assert named == positions(load(JOINTS, KEYS, keyframe=1))


@pytest.mark.parametrize(
    ("joint", "value", "expected"),
    [
        (
            'type="hinge" range="-.5 1"',
            1.2,
            "ranges from -0.5 to 1 rad, got 1.2 at `scene.joints.j`",
        ),
        ('type="slide" range="0 2"', -0.1, "ranges from 0 to 2 m, got -0.1"),
        ('type="slide" range="0 2"', 2.0, ""),
        ('type="slide" range="0 2"', 2.00005, ""),  # rounded
        ('type="hinge"', 9.0, ""),
        ('type="ball" range="0 1"', [0.0, 1.0, 0.0, 0.0], ""),
    ],
)
def test_a_joint_beyond_its_range_is_told(load, joint, value, expected):
    angles = '<compiler angle="radian"/>'
    body = f'<geom size="1"/><body><joint name="j" {joint}/><geom size="1"/></body>'
    warnings = load(body, angles, joints={"j": value}).warnings
    assert len(warnings) == bool(expected)
    assert all(f"joint 'j' {expected}" in text for text in warnings)


def test_joints_on_top_of_a_keyframe(load):
    joints = {
        "hinge": np.pi,
        "slide": [-2.0],
        "ball": [2, 0, 0, 2.0],  # is made a unit
        "free": [4, 5, 6, 1, 0, 0, 0.0],
    }
    assert positions(load(JOINTS, KEYS, keyframe=0, joints=joints)) == {
        "a": [0, 0, 0],
        "b": [0, -2, 0],
        "c": [0, 1, 0],
        "d": [4, 5, 6],
        "e": [4, 4, 4],
    }


@pytest.mark.parametrize(
    ("settings", "culprit"),
    [
        ({"keyframe": 2}, "no keyframe 2 for `scene.keyframe`: .*scene.xml has 2 of them"),
        ({"keyframe": "shut"}, "no keyframe 'shut' .* has open"),
        ({"joints": {"hinje": 1}}, "no joint 'hinje' .* has hinge, slide, ball, free"),
        ({"joints": {"a": 1}}, "no joint 'a' .*: 'a' is moved by its joint 'hinge'; "),
        ({"joints": {"hinge": [1, 2]}}, r"1 number \[rad\] at `scene.joints.hinge`, got 2"),
        ({"joints": {"slide": []}}, r"expected 1 number \[m\] at `scene.joints.slide`, got 0"),
        ({"joints": {"ball": 1}}, "expected 4 numbers .* at `scene.joints.ball`, got 1"),
        ({"joints": {"free": [1, 2, 3]}}, "expected 7 numbers .*, got 3"),
        ({"joints": {"ball": [0, 0, 0, 0]}}, "a quaternion that is not 0 at `scene.joints.ball`"),
        ({"joints": {"free": [1, 2, 3, 0, 0, 0, 0]}}, "a quaternion that is not 0"),
    ],
)  # fmt: skip
def test_poses_that_are_not_there(load, settings, culprit):
    with pytest.raises(ConfigError, match=culprit):
        load(JOINTS, KEYS, **settings)


def test_a_scene_without_names_says_so(load):
    with pytest.raises(ConfigError, match="has none with a name"):
        load("<body><joint/><geom size='1'/></body>", joints={"a": 1})
    with pytest.raises(ConfigError, match="has none with a name"):
        load("<geom size='1'/>", keyframe="a")


# ---------------------------------------------------------------- geometry


def test_every_type_of_geom(load):
    assets = f"""<asset><mesh name="m" {TETRAHEDRON}/>
      <hfield name="h" nrow="2" ncol="3" size="1 1 1 1"/></asset>"""
    world = """
      <geom type="plane" size="0 0 1"/> <geom type="plane" size="1 2 1"/>
      <geom type="plane" size="1 0 1" contype="0" conaffinity="0"/>
      <geom type="plane" size="1 2 1" contype="0" conaffinity="0"/>
      <geom type="hfield" hfield="h"/>
      <geom type="sphere" size="1"/> <geom type="capsule" size="1 1"/>
      <geom type="ellipsoid" size="1 1 1"/> <geom type="cylinder" size="1 1"/>
      <geom type="box" size="1 1 1"/> <geom type="mesh" mesh="m"/>
      <geom type="mesh" mesh="m" contype="0" conaffinity="0"/>
    """
    found = [(geom.type, geom.shape) for geom in load(world, assets, geoms="all").geoms]
    assert found == [
        ("plane", "half-space"),
        ("plane", "half-space"),
        ("plane", "strip"),
        ("plane", "rectangle"),
        ("hfield", "solid"),
        ("sphere", "solid"),
        ("capsule", "solid"),
        ("ellipsoid", "solid"),
        ("cylinder", "solid"),
        ("box", "solid"),
        ("mesh", "hull"),
        ("mesh", "closed surface"),
    ]


def test_signed_distance_fields_count_by_their_mesh(load):
    before = """
      <extension><plugin plugin="mujoco.sdf.torus"><instance name="t"/></plugin></extension>
      <asset><mesh name="m"><plugin instance="t"/></mesh></asset>
    """
    ring = '<geom type="sdf" mesh="m"><plugin instance="t"/></geom>'
    scene = load(ring, before)
    assert (scene.geoms[0].type, scene.geoms[0].shape) == ("sdf", "closed surface")
    through = first_hit(corners_of(scene, 0), np.array([0, 0, 9.0]), np.array([0, 0, -1.0]))
    assert through == -1  # its hull would have no hole
    assert load(ring, before, meshes="hull").geoms[0].shape == "hull"


def random_pose(rng):
    quat = rng.normal(size=4)
    return f'pos="{rng.normal()} {rng.normal()} {rng.normal()}" quat="{" ".join(map(str, quat))}"'


@pytest.mark.parametrize("seed", range(3))
def test_meshes_are_where_mujoco_s_rays_see_them(load, tmp_path, seed):
    """Surfaces: MuJoCo re-centres and turns its meshes; ours stand where its rays hit them."""
    rng = np.random.default_rng(seed)
    shape = trimesh.creation.torus(1.0, 0.4, 8, 6).apply_translation([3, 2, 1])
    shape.export(tmp_path / "ring.obj")
    before = '<asset><mesh name="m" file="ring.obj" scale="1 -0.5 2"/></asset>'
    off = 'contype="0" conaffinity="0"'
    world = f'<body {random_pose(rng)}><geom type="mesh" mesh="m" {random_pose(rng)} {off}/></body>'
    scene = load(world, before)
    assert scene.geoms[0].shape == "closed surface"
    corners = corners_of(scene, 0)
    middle, num_hits = corners.reshape(-1, 3).mean(axis=0), 0
    for _ in range(300):
        way = rng.normal(size=3)
        start = middle - 10 * way + rng.normal(size=3)
        expected = mujoco.mj_rayMesh(scene.model, scene.data, 0, start, way, None)
        assert first_hit(corners, start, way) == pytest.approx(expected, abs=1e-4)
        num_hits += expected >= 0
    assert num_hits > 100


def touches(scene, box_geom):
    data = scene.data
    mujoco.mj_forward(scene.model, data)
    return any(
        box_geom in pair and d <= 0
        for pair, d in zip(data.contact.geom, data.contact.dist, strict=True)
    )


@pytest.mark.parametrize("limit", ["", 'maxhullvert="8"'])
def test_hulls_are_what_mujoco_collides(load, tmp_path, limit):
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.export(tmp_path / "ball.obj")
    before = f'<asset><mesh name="m" file="ball.obj" {limit}/></asset>'
    probe = '<body name="p"><freejoint name="p"/><geom size="0.01"/></body>'
    scene = load(f'<geom type="mesh" mesh="m"/>{probe}', before)
    hull = corners_of(scene, 0)
    normal = np.cross(hull[:, 1] - hull[:, 0], hull[:, 2] - hull[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offset = np.einsum("ij,ij->i", normal, hull[:, 0])
    assert len(hull) == (12 if limit else 320)
    rng = np.random.default_rng(0)
    for _ in range(200):
        way = rng.normal(size=3)
        point = way / np.linalg.norm(way) * rng.uniform(0.5, 1.1)
        outside = (normal @ point - offset).max()
        if abs(outside - 0.01) > 5e-3 and outside < 0.05:
            scene.data.qpos[:3] = point
            assert touches(scene, 1) == (outside < 0.01)


def test_a_geom_of_a_mesh_shared_by_many(load):
    before = f'<asset><mesh name="m" {TETRAHEDRON}/></asset>'
    world = "".join(f'<geom type="mesh" mesh="m" pos="{x} 0 0"/>' for x in range(5))
    scene = load(world, before)
    assert scene.shapes.triangles.geom.tolist() == [geom for geom in range(5) for _ in range(4)]
    first = corners_of(scene, 0)
    for geom in range(5):
        np.testing.assert_allclose(
            corners_of(scene, geom), first + np.array([geom, 0, 0]), atol=1e-12
        )


def test_a_flat_mesh_that_mujoco_makes_no_hull_of(load):
    corners = 'vertex="0 0 0 1 0 0 1 1 0 0 1 0" face="0 1 2 0 2 3"'
    square = f'<asset><mesh name="m" inertia="shell" {corners}/></asset>'
    off = 'contype="0" conaffinity="0"'
    scene = load(f'<geom name="rug" type="mesh" mesh="m" {off}/>', square, meshes="hull")
    assert scene.geoms[0].shape == "surface"
    assert scene.warnings == [
        "mesh 'm' of geom 'rug' is flat, so it has no convex hull: it counts by its triangles"
    ]
    # MuJoCo 4 and, below it, older ones
    with pytest.raises(SceneError, match=r"scene.xml: .*('m'.* coplanar|qhull error.*'m')"):
        load('<geom type="mesh" mesh="m"/>', square)


@pytest.mark.parametrize("size", ["2 3 1", "2 0 1", "0 3 1", "0 0 1"])
def test_planes_that_only_show_are_as_large_as_they_are_drawn(load, size):
    look = 'contype="0" conaffinity="0"'
    plane = f'<geom type="plane" size="{size}" pos="1 2 3" euler="20 30 40" {look}/>'
    box = '<geom type="box" size="9 9 9"/>'
    scene = load(plane + box, geoms="all")
    corners = corners_of(scene, 0)
    assert (len(corners) == 0) == (size == "0 0 1")
    if size == "0 0 1":
        assert scene.shapes.planes.geom.tolist() == [0]
    for x, y in itertools.product(np.linspace(-7, 7, 15) + 0.01, repeat=2):
        start, down = np.array([x, y, 20.0]), np.array([0, 0, -1.0])
        expected = mujoco.mju_rayGeom(
            scene.data.geom_xpos[0], scene.data.geom_xmat[0], scene.model.geom_size[0],
            start, down, 0, None,
        )  # fmt: skip
        if len(corners):
            assert first_hit(corners, start, down) == pytest.approx(expected, abs=1e-6)
    expected = [[-9] * 3, [9] * 3]
    if size == "2 3 1":
        finite = corners.reshape(-1, 3)
        expected = [np.minimum(finite.min(axis=0), -9), np.maximum(finite.max(axis=0), 9)]
    np.testing.assert_allclose(scene.bounds, expected)


@pytest.mark.parametrize("size", ["2 3 1", "2 0 1", "0 0 1"])
def test_planes_that_collide_are_endless_and_add_nothing_to_the_box(load, size):
    plane = f'<geom type="plane" size="{size}" pos="1 2 0"/>'
    scene = load(plane + '<geom type="box" size="1 1 1"/>')
    assert scene.geoms[0].shape == "half-space"
    np.testing.assert_allclose(scene.bounds, [[-1, -1, -1], [1, 1, 1]])


@pytest.mark.parametrize("place", ['euler="0 90 0"', 'euler="180 0 0"'])
def test_walls_and_ceilings_that_are_planes_are_as_large_as_they_are_drawn(load, place):
    scene = load(f'<geom type="plane" size="2 3 1" {place}/><geom type="box" size="1 1 1"/>')
    assert scene.geoms[0].shape == "rectangle"
    assert scene.bounds[1, 1] == pytest.approx(3)


def test_only_endless_planes_have_no_bounds(load):
    world = '<geom type="plane" size="0 0 1"/><geom type="plane" size="0 3 1"/>'
    assert load(world).bounds is None


def test_where_only_planes_count_their_drawn_size_is_the_box(load):
    ground = '<geom type="plane" size="2 3 1" pos="1 0 0"/><geom type="plane" size="0 0 1"/>'
    chair = '<body><freejoint/><geom type="box" size="9 9 1"/></body>'
    np.testing.assert_allclose(load(ground + chair).bounds, [[-1, -3, 0], [3, 3, 0]])


def test_large_scenes_keep_their_bounds(load):
    scene = load('<geom type="box" size="30000 20 1"/>')
    np.testing.assert_allclose(scene.bounds, [[-30000, -20, -1], [30000, 20, 1]])


# ---------------------------------------------------------------- digest

WORLD = """<geom name="a" size="1"/><site name="s" size=".1"/>
  <body name="b"><joint name="j" range="-90 90"/><geom name="c" size="1" pos="1 0 0"/></body>"""


def test_digest_is_of_the_scene_and_not_of_its_file(load):
    assert load(WORLD).digest == load(f"<!-- a comment -->{WORLD}", name="other.xml").digest
    assert load(WORLD).digest == load(WORLD, exclude={"geoms": ["a"]}, geoms="all").digest


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('size="1"', 'size="1.0001"'),
        ('name="a"', 'name="z"'),
        ('name="b"', 'name="z"'),
        ('pos="1 0 0"', 'pos="1 1 0"'),
        ('name="a"', 'name="a" contype="0"'),
        ('name="a"', 'name="a" group="4"'),
        ('name="a"', 'name="a" rgba="1 1 1 0"'),
        ('<joint name="j" range="-90 90"/>', '<freejoint name="j"/>'),
        ('range="-90 90"', 'range="-90 80"'),
        ('name="j"', 'name="z"'),
        ('name="j"', 'name="j" axis="1 0 0"'),
        ('name="s"', 'name="z"'),
        ('name="s"', 'name="s" pos="1 0 0"'),
        ('size=".1"', 'size=".2"'),
    ],
)
def test_digest_changes_with_the_scene(load, old, new):
    assert old in WORLD
    assert load(WORLD).digest != load(WORLD.replace(old, new, 1)).digest


def test_digest_changes_with_the_pose(load):
    assert load(WORLD).digest != load(WORLD, joints={"j": 1.0}).digest


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e101])
def test_height_fields_without_a_size_are_refused(tmp_path, value):
    """As of a broken MJB."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><asset><hfield name="hill" nrow="2" ncol="2" size="1 1 1 0.1"/></asset>'
        '<worldbody><geom type="hfield" hfield="hill"/></worldbody></mujoco>'
    )
    model.hfield_size[0, 1] = value
    mujoco.mj_saveModel(model, str(tmp_path / "a.mjb"))
    with pytest.raises(SceneError, match="hfield 'hill' has heights or a size that are no numbers"):
        load_alone(SceneSettings(path=tmp_path / "a.mjb"))


def test_a_missing_texture_is_told_and_stops_nothing(load, tmp_path):
    (tmp_path / "pictures").mkdir()
    Image.new("RGB", (4, 4)).save(tmp_path / "pictures/there.png")
    before = """
      <compiler texturedir="pictures"/>
      <asset><texture name="a" type="2d" file="there.png"/>
      <texture name="b" type="2d" file="gone.png"/><texture name="c" type="cube" file="lost.png"/>
      <material name="m" texture="b"/></asset>"""
    scene = load('<geom name="box" material="m" size="1 1 1"/>', before)
    told = [text for text in scene.warnings if "texture" in text]
    assert len(told) == 1 and "'gone.png' and 1 more" in told[0] and "drawn plain" in told[0]


@pytest.mark.parametrize(("size", "is_told"), [(110.0, True), (40.0, False)])
def test_a_scene_that_is_far_too_large_is_told(load, size, is_told):
    """As one in inches, or centimetres: before the bake, which may take minutes."""
    scene = load(f'<geom name="box" size="{size} 1 {size / 2}"/>')
    assert scene.hints == scene.warnings and len(scene.hints) == is_told
    told = "high: MuJoCo's unit is the metre: check the lengths"
    assert all(told in hint and "`scene.unit: 1` silences" in hint for hint in scene.hints)


@pytest.mark.parametrize(("size", "is_told"), [(0.1, True), (1.0, False)])
def test_a_scene_that_is_far_too_small_is_told(load, size, is_told):
    scene = load(f'<geom name="box" size="{size} {size} {size}"/>')
    assert scene.hints == scene.warnings and len(scene.hints) == is_told
    assert all("the scene is only 0.2 m large: MuJoCo's unit" in hint for hint in scene.hints)
