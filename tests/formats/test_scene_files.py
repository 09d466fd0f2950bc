"""Which files a scene is made of."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import mujoco
import pytest
import trimesh

from navbake.errors import SceneError
from navbake.formats.scene_files import find_inputs, find_model_file

OBJ = "v 0 0 0\n"


@pytest.fixture
def folder(tmp_path):
    """A folder with files; names that the XML of a test may have."""
    for name in (
        *("mesh/a.obj", "mesh/b.stl", "parts/part.xml", "parts/own/c.obj", "hill.png", "wood.png"),
        *("robot/meshes/arm.dae", "d.skn", "deep/mesh/e.obj"),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(OBJ)
    return tmp_path


def export_box(path):
    trimesh.creation.box().export(path)


def names(folder, scene):
    return [path.relative_to(folder).as_posix() for path in find_inputs(folder / scene)]


def test_of_mjcf_they_are_meshes_fields_includes_and_models_but_no_textures(folder):
    (folder / "scene.xml").write_text(
        '<mujoco><compiler meshdir="mesh"/><include file="parts/part.xml"/>'
        '<asset><mesh file="a.obj"/><hfield file="hill.png"/><texture file="wood.png"/>'
        '<skin file="d.skn"/><mesh file="no.obj"/><mesh file="deep/b.stl"/></asset></mujoco>'
    )
    (folder / "parts" / "part.xml").write_text(
        '<mujoco><compiler assetdir="own"/><asset><mesh file="c.obj"/></asset>'
        '<include file="parts/part.xml"/><include file="../scene.xml"/></mujoco>'
    )
    expected = {"mesh/a.obj", "mesh/b.stl", "hill.png", "parts/part.xml", "parts/own/c.obj"}
    found = names(folder, "scene.xml")
    assert found[0] == "scene.xml"
    assert {os.path.normpath(name) for name in found[1:]} - {"scene.xml"} == expected


def test_a_backslash_stands_between_folders_as_for_mujoco(folder):
    (folder / "scene.xml").write_text(
        '<mujoco><compiler meshdir="deep\\mesh"/><asset><mesh file="parts\\own\\c.obj"/>'
        '<mesh file="e.obj"/></asset></mujoco>'
    )
    assert names(folder, "scene.xml") == ["scene.xml", "deep/mesh/e.obj", "parts/own/c.obj"]


def test_what_is_included_is_mjcf_whatever_its_name(folder):
    (folder / "scene.xml").write_text('<mujoco><include file="part.txt"/></mujoco>')
    (folder / "part.txt").write_text('<mujoco><asset><mesh file="mesh/a.obj"/></asset></mujoco>')
    assert names(folder, "scene.xml") == ["scene.xml", "mesh/a.obj", "part.txt"]


@pytest.mark.parametrize(
    ("folders", "name"),
    [
        ("", "no/../mesh/a.obj"),
        ("", "mesh/a.obj/../a.obj"),
        ('meshdir="no"', "../mesh/a.obj"),
        ('meshdir="no/../mesh"', "a.obj"),
        ('meshdir="no/no"', "no/../../../mesh/a.obj"),
        ('meshdir="deep/link"', "../mesh/a.obj"),
    ],
)
def test_a_missing_folder_before_dots_is_dropped_as_by_mujoco(folder, folders, name):
    export_box(folder / "mesh" / "a.obj")
    export_box(folder / "deep" / "mesh" / "a.obj")
    (folder / "deep" / "link").symlink_to(folder / "robot" / "meshes")
    (folder / "part.xml").write_text(
        f'<mujoco><compiler {folders}/><asset><mesh name="a" file="{name}"/></asset></mujoco>'
    )
    (folder / "scene.xml").write_text('<mujoco><include file="no/../part.xml"/></mujoco>')
    mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    found = {os.path.realpath(path) for path in find_inputs(folder / "scene.xml")}
    files = {folder / "scene.xml", folder / "part.xml"}
    files.add(folder / ("deep/mesh" if "deep" in folders else "mesh") / "a.obj")
    assert found >= {os.path.realpath(path) for path in files}


ROBOT = (
    "<mujoco>%s<worldbody><body name='b'><geom type='mesh' mesh='m'/></body></worldbody></mujoco>"
)
MESH = '<asset><mesh name="m" file="a.obj"/></asset>'
URDF = (
    '<robot name="u"><link name="world"/><joint name="j" type="fixed"><parent link="world"/>'
    '<child link="b"/></joint><link name="b"><collision><geometry><mesh filename="%s"/>'
    "</geometry></collision></link></robot>"
)


@pytest.mark.parametrize(
    ("files", "mesh"),
    [
        ({"x/r.xml": ROBOT % MESH}, "x/a.obj"),
        (  # what an attached model includes counts from the model's folder
            {
                "x/r.xml": ROBOT % '<include file="inc/c.xml"/>',
                "x/inc/c.xml": f'<mujoco><compiler meshdir="own"/>{MESH}</mujoco>',
            },
            "x/own/a.obj",
        ),
        (
            {
                "x/r.xml": ROBOT % '<include file="inc/c.xml"/>',
                "x/inc/c.xml": '<mujoco><include file="y.xml"/></mujoco>',
                "x/y.xml": f"<mujoco>{MESH}</mujoco>",
            },
            "x/a.obj",
        ),
        ({"x/r.xml": URDF % "a.obj"}, "x/a.obj"),
        ({"x/r.xml": URDF % "own/a.obj"}, "x/own/a.obj"),
        # one that is reached by a link counts from where the link is
        ({"far/r.xml": ROBOT % MESH, "x/r.xml": Path("../far/r.xml")}, "x/a.obj"),
    ],
)
def test_files_of_attached_models_are_found_as_by_mujoco(folder, files, mesh):
    for name, content in {**files, mesh: None}.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if content is None:
            export_box(path)
        elif isinstance(content, Path):
            path.symlink_to(content)
        else:
            path.write_text(content)
    attach = '<attach model="r" body="b" prefix="p"/>'
    (folder / "scene.xml").write_text(
        f'<mujoco><asset><model name="r" file="x/r.xml"/></asset><worldbody><body>{attach}</body>'
        "</worldbody></mujoco>"
    )
    try:
        mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    except ValueError as error:
        pytest.fail(f"MuJoCo: {error}")
    assert {"x/r.xml", mesh, *files} - {"far/r.xml"} <= {*names(folder, "scene.xml")}


def test_links_to_their_own_folder_end(folder):
    (folder / "loop").symlink_to(folder)
    (folder / "again").symlink_to(folder)
    (folder / "scene.xml").write_text(
        '<mujoco><include file="loop/scene.xml"/><include file="again/scene.xml"/>'
        '<asset><mesh file="mesh/a.obj"/></asset></mujoco>'
    )
    assert "mesh/a.obj" in names(folder, "scene.xml")


def test_xml_that_python_refuses_names_its_files(folder):
    (folder / "scene.xml").write_bytes(
        b'<mujoco><!-- 45\xb0 -- --><asset><mesh file="mesh/a.obj"/></asset></mujoco>'
    )
    assert names(folder, "scene.xml") == ["scene.xml", "mesh/a.obj"]


def test_looks_are_found_where_they_are_asked_for(folder):
    (folder / "scene.xml").write_text(
        '<mujoco><compiler texturedir="looks"/><asset><texture fileup="up.png" filedown="no.png"/>'
        '<texture file="wood.png"/><skin file="d.skn"/></asset></mujoco>'
    )
    (folder / "looks").mkdir()
    (folder / "looks" / "up.png").write_text("")
    assert names(folder, "scene.xml") == ["scene.xml"]
    found = find_inputs(folder / "scene.xml", with_textures=True)
    assert [path.relative_to(folder).as_posix() for path in found] == [
        *("scene.xml", "d.skn", "looks/up.png", "wood.png")
    ]


def test_of_gltf_they_are_its_buffers(folder):
    buffers = [{"uri": "mesh/a%20b.bin"}, {"uri": "data:;base64,AA"}, {"uri": "no.bin"}, {}]
    (folder / "a.gltf").write_text(json.dumps({"buffers": buffers}))
    (folder / "mesh" / "a b.bin").write_text("")
    assert names(folder, "a.gltf") == ["a.gltf", "mesh/a b.bin"]
    (folder / "a.urdf").write_text(
        '<robot name="a"><link name="a"><visual><geometry><mesh filename="a.gltf"/></geometry>'
        "</visual></link></robot>"
    )
    assert names(folder, "a.urdf") == ["a.urdf", "a.gltf", "mesh/a b.bin"]
    for broken in ("", "[]", '{"buffers": 3}', '{"buffers": [{"uri": 3}]}', '{"buffers": [1]}'):
        (folder / "a.gltf").write_text(broken)
        assert names(folder, "a.gltf") == ["a.gltf"]


def test_of_urdf_they_are_meshes_found_as_the_bake_finds_them(folder):
    (folder / "robot" / "arm.urdf").write_text(
        '<robot name="arm"><link name="a"><visual><geometry>'
        '<mesh filename="package://robot/meshes/arm.dae"/></geometry></visual></link></robot>'
    )
    assert names(folder, "robot/arm.urdf") == ["robot/arm.urdf", "robot/meshes/arm.dae"]


def test_of_sdf_they_are_models_and_meshes_but_no_scripts_of_looks(folder):
    uris = ("file://mesh/a.obj", "file://looks.material", "model://chair")
    uris_ = "".join(f"<uri>{uri}</uri>" for uri in uris)
    (folder / "scene.sdf").write_text(f'<sdf version="1.9">{uris_}</sdf>')
    (folder / "looks.material").write_text("material wood {}")
    (folder / "chair").mkdir()
    (folder / "chair" / "model.sdf").write_text("<sdf><uri>mesh/b.stl</uri></sdf>")
    # a name is looked for beside the file that has it, then in folders above
    own = ["scene.sdf", "chair/model.sdf", "mesh/a.obj", "mesh/b.stl"]
    assert names(folder, "scene.sdf") == own
    looks = find_inputs(folder / "scene.sdf", with_textures=True)
    assert {path.name for path in looks} - {Path(name).name for name in own} == {"looks.material"}


def test_of_usd_they_are_layers_but_no_textures(folder):
    pytest.importorskip("pxr")
    (folder / "scene.usda").write_text(
        "#usda 1.0\n(subLayers = [@./sub.usda@])\n"
        'def "a" (references = @./asset.usda@)\n{\nasset image = @./wood.png@\n}\n'
    )
    for name in ("sub.usda", "asset.usda"):
        (folder / name).write_text("#usda 1.0\n")
    assert names(folder, "scene.usda") == ["scene.usda", "asset.usda", "sub.usda"]
    assert folder / "wood.png" in find_inputs(folder / "scene.usda", with_textures=True)


def test_a_mesh_that_a_urdf_lacks_hides_no_other(folder):
    meshes = '<mesh filename="no.obj"/><mesh filename="mesh/a.obj"/>'
    (folder / "arm.urdf").write_text(f'<robot name="arm">{meshes}</robot>')
    assert names(folder, "arm.urdf") == ["arm.urdf", "mesh/a.obj"]


@pytest.mark.parametrize("text", ["<mujoco>", "\xff", '<mujoco><mesh file=""/></mujoco>'])
def test_of_broken_xml_it_is_the_scene_itself(folder, text):
    (folder / "scene.xml").write_text(text)
    assert names(folder, "scene.xml") == ["scene.xml"]
    assert names(folder, "no.xml") == ["no.xml"]
    assert names(folder, "mesh/a.obj") == ["mesh/a.obj"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
def test_pipes_are_not_read(folder):
    os.mkfifo(folder / "pipe.xml")
    (folder / "scene.xml").write_text('<mujoco><include file="pipe.xml"/></mujoco>')
    for scene in ("scene.xml", "pipe.xml"):
        with pytest.raises(SceneError, match=r"pipe\.xml: expected a file, got a pipe"):
            find_inputs(folder / scene)


@pytest.mark.parametrize("suffix", [".xml", ".urdf", ".sdf"])
@pytest.mark.parametrize(
    "piece",
    ["<!--", "<a ", "<a>", "<a b='", "<uri>", "<uri> ", " ", "<", "&", "<![CDATA[", "<a b='' "],
)
def test_time_is_linear_in_the_size(folder, suffix, piece):
    tag = {".xml": "mujoco", ".urdf": "robot", ".sdf": "sdf"}[suffix]
    path = folder / f"scene{suffix}"
    for text in (f"<{tag}>{piece * 100_000}</{tag}>", f"<{tag}><!-- --><uri>{piece * 100_000}"):
        path.write_text(text)
        begin = time.process_time()
        assert find_inputs(path) == [path]
        assert time.process_time() - begin < 3


def test_a_file_is_read_once_however_often_it_is_included(folder):
    includes = "".join(f'<include file="no{k}/../scene.xml"/>' for k in range(100))
    (folder / "scene.xml").write_text(f"<mujoco>{includes * 10}</mujoco>")
    begin = time.process_time()
    assert names(folder, "scene.xml") == ["scene.xml"]
    assert time.process_time() - begin < 3


def test_names_that_may_be_in_very_many_folders_are_refused(folder):
    pieces = "".join(f'<compiler meshdir="{k}"/><mesh file="{k}.obj"/>' for k in range(1000))
    (folder / "scene.xml").write_text(f"<mujoco>{pieces}</mujoco>")
    with pytest.raises(SceneError, match="names 1,000 files, and 1,001 folders in which each may"):
        find_inputs(folder / "scene.xml")


def test_a_long_name_of_a_urdf_is_looked_for_as_it_is_written(folder):
    (folder / "arm.urdf").write_text(
        f'<robot name="arm"><mesh filename="{"a/" * 50_000}mesh/a.obj"/>'
        f'<mesh filename="{"a/" * 20}mesh/a.obj"/></robot>'
    )
    assert names(folder, "arm.urdf") == ["arm.urdf", "mesh/a.obj"]


def test_names_that_are_no_utf_8_are_found(folder):
    name = os.fsdecode(b"caf\xe9.obj")
    try:
        (folder / name).write_text(OBJ)
    except OSError:
        pytest.skip("the file system takes UTF-8 alone")
    (folder / "scene.xml").write_bytes(b'<mujoco><mesh file="caf\xe9.obj"/></mujoco>')
    assert names(folder, "scene.xml") == ["scene.xml", name]


def test_the_latest_of_a_model_counts_whatever_its_version_says(folder):
    model = folder / "chair"
    model.mkdir()
    versions = {"1.9": "a.sdf", "1.10": "b.sdf", "9" * 5000: "c.sdf", "x": "d.sdf"}
    entries = "".join(f"<sdf version='{key}'>{name}</sdf>" for key, name in versions.items())
    (model / "model.config").write_text(f"<!-- <sdf>e.sdf</sdf> --><model>{entries}</model>")
    assert find_model_file(model) == model / "b.sdf"
    (model / "model.config").write_text("<sdf" * 50_000)
    assert find_model_file(model) == model / "model.sdf"
