"""URDF scenes: links, visuals, and where their meshes are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

import navbake
from navbake.baker.scene.scene import load_scene
from navbake.config.settings import SceneSettings, load_config
from navbake.errors import SceneError
from navbake.formats.scene_files import find_inputs
from scene_files import WEDGE, write_dae
from scenes_alone import load_alone

REPORTS = Path(__file__).parents[4] / "shared" / "data" / "reports"
ROOM = """
<robot name="room">
  <material name="red"><color rgba="1 0 0 1"/><texture filename="package://none/a.png"/></material>
  <link name="base">
    <visual name="look"><geometry><mesh filename="{mesh}" scale="2 2 2"/></geometry></visual>
    <collision name="touch"><geometry><box size="4 6 0.2"/></geometry></collision>
  </link>
  <link name="shelf">
    <visual><geometry><mesh filename="{mesh}"/></geometry><material name="red"/></visual>
    <collision>
      <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/>
      <geometry><mesh filename="{mesh}" scale="1 1 3"/></geometry>
    </collision>
  </link>
  <link name="door"><collision><geometry><sphere radius="0.5"/></geometry></collision></link>
  <joint name="fix" type="fixed">
    <parent link="base"/><child link="shelf"/><origin xyz="10 0 5"/>
  </joint>
  <joint name="hinge" type="revolute">
    <parent link="base"/><child link="door"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1" effort="1" velocity="1"/>
  </joint>
  {more}
</robot>
"""


@pytest.fixture
def load(tmp_path):
    """Returns a function that writes the URDF to pkg/urdf/ and loads it."""

    def call(mesh="meshes/wedge.stl", more="", text=ROOM, **settings):
        folder = tmp_path / "pkg" / "urdf"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "room.urdf").write_text(text.format(mesh=mesh, more=more))
        return load_alone(SceneSettings(path=folder / "room.urdf", **settings))

    return call


@pytest.fixture
def wedge(tmp_path):
    """Returns a function that writes the wedge under the URDF's package."""

    def call(name):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".dae":
            write_dae(path, WEDGE.copy().apply_scale(100), unit=0.01)
        else:
            WEDGE.export(path)
        return path

    return call


def corners_of(scene, geom):
    triangles = scene.shapes.triangles
    return triangles.corners[triangles.geom == geom].reshape(-1, 3)


def test_links_and_names_stay(load, wedge):
    wedge("pkg/urdf/meshes/wedge.stl")
    scene = load(geoms="all")
    assert [(geom.name, geom.body, geom.type) for geom in scene.geoms] == [
        ("look", "base", "mesh"),
        ("touch", "base", "box"),
        ("geom 2", "shelf", "mesh"),
        ("geom 3", "shelf", "mesh"),
        ("geom 4", "door", "sphere"),
    ]
    assert scene.warnings == []


def test_collision_visual_and_auto(load, wedge):
    wedge("pkg/urdf/meshes/wedge.stl")
    for geoms, counted in {
        "collision": [1, 3, 4],
        "auto": [1, 3, 4],
        "visual": [0, 2, 4],
        "all": [0, 1, 2, 3, 4],
    }.items():
        scene = load(geoms=geoms)
        assert [geom.id for geom in scene.geoms if geom.counted] == counted, geoms
    shapes = {geom.id: geom.shape for geom in scene.geoms}
    assert shapes == {0: "closed surface", 1: "solid", 2: "closed surface", 3: "hull", 4: "solid"}
    settings = load(geoms="visual").geoms
    assert settings[1].reason == "stands in for its body's visual geoms"
    assert settings[4].reason == "is drawn"


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb", "dae"])
def test_meshes_of_every_format_with_scale(load, wedge, suffix):
    wedge(f"pkg/urdf/meshes/wedge.{suffix}")
    scene = load(f"meshes/wedge.{suffix}", geoms="all")
    expected = WEDGE.bounds
    found = corners_of(scene, 0)
    np.testing.assert_allclose([found.min(axis=0), found.max(axis=0)], 2 * expected, atol=1e-5)
    found = corners_of(scene, 3)  # turned by 90 degrees, moved, scaled along z, on its link
    low, high = [10 - 2, 0, 6], [10, 3, 9]
    np.testing.assert_allclose([found.min(axis=0), found.max(axis=0)], [low, high], atol=1e-5)


def test_all_groups_of_an_obj(load, tmp_path):
    path = tmp_path / "pkg/urdf/two.obj"
    path.parent.mkdir(parents=True)
    box, ball = trimesh.creation.box(), trimesh.creation.icosphere(subdivisions=1)
    trimesh.Scene([box, ball.apply_translation([5, 0, 0])]).export(path)
    assert path.read_text().count("\no ") == 2
    found = corners_of(load("two.obj", geoms="all"), 2)
    assert found[:, 0].max() == pytest.approx(10 + 6)


@pytest.mark.parametrize(
    ("file", "mesh"),
    [
        ("pkg/meshes/wedge.stl", "package://pkg/meshes/wedge.stl"),
        ("pkg/meshes/wedge.stl", "../meshes/wedge.stl"),
        ("pkg/meshes/wedge.stl", "model://whatever/meshes/wedge.stl"),
        ("pkg/urdf/my mesh.stl", "my mesh.stl"),
        ("other/meshes/wedge.stl", "package://other/meshes/wedge.stl"),
        ("abs/wedge.stl", "{tmp}/abs/wedge.stl"),
        ("abs/wedge.stl", "file://{tmp}/abs/wedge.stl"),
    ],
)
def test_where_meshes_are_found(load, wedge, tmp_path, file, mesh):
    wedge(file)
    assert len(load(mesh.format(tmp=tmp_path)).geoms) == 5


def test_the_longest_tail_wins(load, wedge, tmp_path):
    wedge("pkg/meshes/wedge.stl")
    WEDGE.copy().apply_scale(9).export(wedge("pkg/urdf/wedge.stl"))
    found = corners_of(load("package://pkg/meshes/wedge.stl", geoms="all"), 0)
    assert found[:, 0].max() == pytest.approx(6, abs=1e-5)


def test_two_files_of_one_name(load, wedge, tmp_path):
    wedge("pkg/urdf/a/part.stl")
    WEDGE.copy().apply_scale(0.5).export(wedge("pkg/urdf/b/part.stl"))
    extra = (
        '<link name="extra"><visual><geometry><mesh filename="b/part.stl"/></geometry></visual>'
        '</link><joint name="x" type="fixed"><parent link="base"/><child link="extra"/></joint>'
    )
    scene = load("a/part.stl", more=extra, geoms="all")
    widths = [corners_of(scene, geom)[:, 0].max() for geom in (0, 5)]
    assert widths == pytest.approx([6, 1.5], abs=1e-5)


def test_the_file_s_own_compiler_settings_stay(load, wedge):
    wedge("pkg/urdf/meshes/wedge.stl")
    more = '<mujoco><compiler discardvisual="true" meshdir="elsewhere" strippath="true"/></mujoco>'
    scene = load(more=more, geoms="all")
    assert [geom.type for geom in scene.geoms] == ["box", "mesh", "sphere"]


def test_joints_pose_links(load, wedge):
    wedge("pkg/urdf/meshes/wedge.stl")
    scene = load(joints={"hinge": 0.5})
    assert scene.data.qpos[0] == 0.5


def test_flat_and_open_visuals_are_no_obstacle_to_loading(load, tmp_path):
    folder = tmp_path / "pkg/urdf"
    folder.mkdir(parents=True)
    (folder / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    link = '<link name="a"><visual><geometry><mesh filename="flat.obj"/></geometry></visual></link>'
    scene = load(text=f'<robot name="r">{link}</robot>', geoms="visual")
    assert [geom.shape for geom in scene.geoms] == ["surface"]


def test_a_mesh_without_a_name_is_told_by_its_link(tmp_path):
    (tmp_path / "walls.obj").write_text(
        "v 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\nv 0 0 3\nv 9 0 3\nv 9 9 3\nv 0 9 3\n"
        "f 1 2 3 4\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
    )
    path = tmp_path / "room.urdf"
    path.write_text(
        '<robot name="room"><link name="base"/><joint name="j" type="fixed"><parent link="base"/>'
        '<child link="shell"/></joint><link name="shell"><collision><geometry>'
        '<mesh filename="walls.obj"/></geometry></collision></link></robot>'
    )
    scene = load_scene(load_config(path))
    assert any("'geom 0' (mesh 'walls' of body '" in text for text in scene.warnings)


def test_a_missing_mesh_is_named(load):
    with pytest.raises(
        SceneError, match=r"'package://pkg/meshes/none.dae' of .*room.urdf not found"
    ):
        load("package://pkg/meshes/none.dae")


LOOKS = """
<robot name="r">
  <link name="a">
    <visual><geometry><mesh filename="package://my/meshes/none.stl"/></geometry></visual>
    {collision}
  </link>
  {more}
</robot>
"""
TOUCH = "<collision><geometry><box size='4 4 1'/></geometry></collision>"


@pytest.mark.parametrize("geoms", ["auto", "collision"])
def test_a_missing_mesh_that_is_only_seen_gives_a_warning(load, geoms):
    scene = load(text=LOOKS.replace("{collision}", TOUCH), geoms=geoms)
    assert [(geom.type, geom.counted) for geom in scene.geoms] == [("box", True)]
    [warning] = scene.warnings
    assert "mesh 'package://my/meshes/none.stl' of" in warning and "left out" in warning


def test_a_missing_mesh_that_the_file_discards_gives_a_warning(load):
    discard = '<mujoco><compiler discardvisual="true"/></mujoco>'
    scene = load(text=LOOKS.replace("{collision}", TOUCH), more=discard, geoms="all")
    assert [geom.type for geom in scene.geoms] == ["box"] and len(scene.warnings) == 1


@pytest.mark.parametrize(("collision", "geoms"), [("", "auto"), (TOUCH, "visual"), (TOUCH, "all")])
def test_a_missing_mesh_that_counts_is_refused_with_where_it_was_looked_for(
    load, collision, geoms, tmp_path
):
    with pytest.raises(SceneError) as caught:
        load(text=LOOKS.replace("{collision}", collision), geoms=geoms)
    said = str(caught.value)
    assert f"in {tmp_path / 'pkg/urdf'} or in the folders above it" in said
    assert "'meshes/none.stl', 'none.stl'" in said
    assert "the folder that holds the package 'my' by `--model-path`" in said


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        ("<robot", "broken XML"),
        ("<robot><link></robot>", "broken XML"),
        ("<robot>" + "<a>" * 5000 + "</a>" * 5000 + "</robot>", "room.urdf"),
        ("<robot name='a'><link name='b'/><link name='b'/></robot>", "MuJoCo cannot load"),
        ("<robot><joint name='j'/></robot>", "MuJoCo cannot load"),
        ("<robot name='a'/>", "has no geoms"),
        ("<robot name='a'><link name='b'><visual><mesh/></visual></link></robot>", "mesh '' of"),
    ],
)  # fmt: skip
def test_broken_files(load, text, culprit):
    with pytest.raises(SceneError, match=culprit) as caught:
        load(text=text.replace("{", "{{").replace("}", "}}"))
    assert "room.urdf" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_path_is_not_needed_to_be_absolute(load, wedge, tmp_path, monkeypatch):
    wedge("pkg/meshes/wedge.stl")
    load("package://pkg/meshes/wedge.stl")
    monkeypatch.chdir(tmp_path / "pkg" / "urdf")
    scene = load_alone(SceneSettings(path=Path("room.urdf")))
    assert len(scene.geoms) == 5


PACKAGE_MESH = """
<robot name="two arms">
  <link name="world"/>
  <link name="arm"><collision><geometry>
    <mesh filename="package://other_pkg/meshes/wedge.stl"/>
  </geometry></collision></link>
  <joint name="j" type="fixed"><parent link="world"/><child link="arm"/></joint>
</robot>
"""


@pytest.mark.parametrize("way", ["--model-path", "AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH", "nested"])
def test_meshes_in_other_packages(tmp_path, monkeypatch, way):
    """Found by the settings, and by ROS's variables at any depth, down to a package.xml."""
    for variable in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"):
        monkeypatch.delenv(variable, raising=False)
    urdf = tmp_path / "ws" / "my_pkg" / "urdf" / "r.urdf"
    urdf.parent.mkdir(parents=True)
    urdf.write_text(PACKAGE_MESH)
    with pytest.raises(
        SceneError, match=r"other_pkg/meshes/wedge\.stl.*--model-path.*AMENT_PREFIX"
    ):
        load_alone(SceneSettings(path=urdf))
    far = tmp_path / "far"
    package = far / "share" / "other_pkg"
    if way == "nested":
        package = far / "a" / "b" / "checkout"
    mesh = package / "meshes" / "wedge.stl"
    mesh.parent.mkdir(parents=True)
    WEDGE.export(mesh)
    settings = SceneSettings(path=urdf)
    if way == "--model-path":
        settings = SceneSettings(path=urdf, model_path=[far / "share"])
    elif way == "AMENT_PREFIX_PATH":
        monkeypatch.setenv(way, f"/nowhere:{far}")
    elif way == "ROS_PACKAGE_PATH":
        monkeypatch.setenv(way, str(far / "share"))
    else:
        (package / "package.xml").write_text("<package><name>other_pkg</name></package>")
        monkeypatch.setenv("ROS_PACKAGE_PATH", str(far))
    assert [geom.body for geom in load_alone(settings).geoms] == ["arm"]
    assert find_inputs(urdf, folders=settings.model_path) == [urdf, mesh]


def test_all_missing_meshes_are_named(load):
    shape = "<geometry><mesh filename='{0}.stl'/></geometry>"
    link = f"<link name='{{0}}'><collision>{shape}</collision></link>"
    with pytest.raises(
        SceneError, match=r"mesh 'a\.stl' of .* not found there.*neither are 'b\.stl'"
    ):
        load(text=f"<robot name='r'>{link.format('a')}{link.format('b')}{link.format('a')}</robot>")


@pytest.mark.parametrize(
    "head",
    [
        "<!-- roslaunch a.launch --use-gui -->\n<robot name='r'>",
        "\n<?xml version='1.0'?>\n<robot name='r' xmlns:xacro='http://wiki.ros.org/xacro'>",
        "<robot name='r' xmlns='http://www.ros.org'><xacro:arg name='a'/><gazebo gz:type='b'/>",
        "<robot name='r'><xacro:include filename='x'/><author>R & D</author>",
    ],
)
def test_xml_that_only_tinyxml_reads(load, head):
    """What MuJoCo's and ROS's parser reads is a scene, with prefixes that are not declared."""
    box = "<link name='l'><collision><geometry><box size='4 4 1'/></geometry></collision></link>"
    assert [geom.type for geom in load(text=f"{head}{box}</robot>").geoms] == ["box"]


def test_reported_packages(monkeypatch):
    folder = REPORTS / "urdf_package_path" / "ros"
    if not folder.exists():
        pytest.skip(f"{folder} is not there")
    path = folder / "src" / "my_desc" / "urdf" / "r.urdf"
    with_paths = load_alone(SceneSettings(path=path, model_path=[folder / "share"]))
    assert len(with_paths.geoms) == 3
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(folder))
    assert load_alone(SceneSettings(path=path)).digest == with_paths.digest


def test_walls_without_ground_are_told_of_the_ground():
    """The remedy comes first: a scene of walls lacks its ground."""
    path = REPORTS / "urdf_no_ground" / "room.urdf"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    with pytest.raises(SceneError, match=r"no floor: if .* its ground, `scene\.ground=0` adds it;"):
        navbake.bake(path)
    grid = navbake.bake({"scene": {"path": str(path), "ground": 0.0}})
    assert grid.levels[0].free.sum() * 0.01 == pytest.approx(46.61)
