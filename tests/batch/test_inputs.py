"""Which files a scene is made of, and whether they changed."""

from __future__ import annotations

import json
import os
import time

import pytest

from navbake.batch import file_states
from navbake.batch.file_states import are_unchanged, describe_files
from navbake.batch.inputs import find_inputs

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


def test_looks_are_found_where_they_are_asked_for(folder):
    (folder / "scene.xml").write_text(
        '<mujoco><compiler texturedir="looks"/><asset><texture fileup="up.png" filedown="no.png"/>'
        '<texture file="wood.png"/><skin file="d.skn"/></asset></mujoco>'
    )
    (folder / "looks").mkdir()
    (folder / "looks" / "up.png").write_text("")
    assert names(folder, "scene.xml") == ["scene.xml"]
    found = find_inputs(folder / "scene.xml", looks=True)
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
    assert names(folder, "scene.xml") == ["scene.xml"]
    assert names(folder, "pipe.xml") == ["pipe.xml"]
    stated = describe_files([folder / "mesh" / "a.obj"], folder)
    (folder / "mesh" / "a.obj").unlink()
    os.mkfifo(folder / "mesh" / "a.obj")
    assert not are_unchanged(stated, folder)


def test_content_is_read_where_size_and_time_prove_nothing(folder, monkeypatch):
    path = folder / "mesh" / "a.obj"
    old = time.time() - 100
    os.utime(path, (old, old))
    stated = describe_files([path], folder)
    assert list(stated) == ["mesh/a.obj"] and stated["mesh/a.obj"]["modified"] > 0
    monkeypatch.setattr(file_states, "_digest", lambda path: pytest.fail("it was read"))
    assert are_unchanged(stated, folder)
    monkeypatch.undo()
    monkeypatch.setattr(file_states, "RECENT", 60_000_000_000)  # however slow this machine is
    path.write_text("V 0 0 0\n")
    assert not are_unchanged(stated, folder)
    path.write_text(OBJ)
    assert are_unchanged(stated, folder)  # by its content
    assert describe_files([path], folder)["mesh/a.obj"]["modified"] == 0
    assert describe_files([path], folder, may_change=False)["mesh/a.obj"]["modified"] > 0
    path.unlink()
    assert not are_unchanged(stated, folder)
