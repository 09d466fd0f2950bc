"""Which files a scene is made of, and whether they changed."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from unittest.mock import patch

import mujoco
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from navbake.batch import file_states
from navbake.batch.file_states import Places, are_unchanged, describe_files, has_no_other, path_from
from navbake.formats import scene_files
from navbake.formats.scene_files import FilesHere, Folders, Search, find_inputs

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
    with patch.object(scene_files, "MOST_FILES", 100):
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
    stated = describe_files([folder / "mesh" / "a.obj"], Places(folder))
    (folder / "mesh" / "a.obj").unlink()
    os.mkfifo(folder / "mesh" / "a.obj")
    assert not are_unchanged(stated, folder)


def test_content_is_read_where_size_and_time_prove_nothing(folder, monkeypatch):
    path = folder / "mesh" / "a.obj"
    old = time.time() - 100
    os.utime(path, (old, old))
    stated = describe_files([path], Places(folder))
    assert list(stated) == ["mesh/a.obj"] and stated["mesh/a.obj"]["modified"] > 0
    monkeypatch.setattr(file_states, "_digest", lambda path: pytest.fail("it was read"))
    assert are_unchanged(stated, folder)
    monkeypatch.undo()
    monkeypatch.setattr(file_states, "RECENT", 60_000_000_000)  # however slow this machine is
    path.write_text("V 0 0 0\n")
    assert not are_unchanged(stated, folder)
    path.write_text(OBJ)
    assert are_unchanged(stated, folder)  # by its content
    assert describe_files([path], Places(folder))["mesh/a.obj"]["modified"] == 0
    assert describe_files([path], Places(folder), may_change=False)["mesh/a.obj"]["modified"] > 0
    path.unlink()
    assert not are_unchanged(stated, folder)


PARTS = ("a", "b", "A", "mesh", "no", "é", "e\u0301", "..", "..", ".", "")
PATHS = st.lists(st.sampled_from(PARTS), min_size=1, max_size=4).map("/".join)


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A folder of folders and files, with links among them and out of it."""
    top = tmp_path_factory.mktemp("tree")
    for name in ("a/mesh/a", "a/mesh/b", "a/b/mesh/a", "b/a", "mesh/b", "mesh/a/é", "b/A/b", "é"):
        (top / "at" / name).parent.mkdir(parents=True, exist_ok=True)
        (top / "at" / name).write_text(OBJ)
    (top / "a").write_text(OBJ)
    (top / "far" / "mesh").mkdir(parents=True)
    (top / "far" / "mesh" / "a").write_text(OBJ)
    (top / "at" / "b" / "mesh").symlink_to(top / "far" / "mesh")
    (top / "at" / "a" / "A").symlink_to(top / "at" / "b")
    (top / "out").symlink_to(top / "far" / "mesh" / "out")
    (top / "far" / "mesh" / "out").mkdir()
    return top


@given(folders=st.lists(PATHS, min_size=1, max_size=4), names=st.lists(PATHS, max_size=5))
@example(folders=["a", ""], names=["mesh//a", "../b/mesh/../mesh/a", "A"])
@example(folders=["b/mesh"], names=["a/../../a"])
@example(folders=["no"], names=["../no/../a/mesh/a"])
@settings(deadline=None)
def test_names_are_found_in_folders_as_if_each_were_looked_for(tree, folders, names):
    folders = [os.path.normpath(os.path.join("at", folder.strip("/"))) for folder in folders]
    names = [name.rstrip("/.") or "a" for name in names]
    names = [str(tree / "at" / name.strip("/")) if name[0] == "/" else name for name in names]
    search = Search(tuple(folders), tuple(names))
    found = {tree / place for place in search.present(Folders(tree)) if (tree / place).is_file()}
    slow = Search(tuple(str(tree / folder) for folder in folders), search.names)
    each = (place for name in names for place in slow.places_of(name))
    expected = {os.path.realpath(path) for path in each if path.is_file()}
    files = {os.path.realpath(path) for path in found}
    assert files >= expected
    # more only where MuJoCo drops one folder of a path and the system follows a link of it
    assert files == expected or any(os.pardir in name for name in names)


def test_a_listing_decides_only_where_it_can(tmp_path, monkeypatch):
    (tmp_path / "Mesh").mkdir()
    (tmp_path / "Mesh" / "e\u0301.OBJ").write_text(OBJ)  # which some file systems take for another
    search = Search((".", "no", "Mesh/e\u0301.OBJ", "a\0"), ("Mesh/é.obj", "c\0.obj", "no.obj"))
    assert {*search.present(Folders(tmp_path))} == {"Mesh/é.obj"}

    def refuse(path):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "listdir", refuse)  # of what may be entered, but not read
    assert "Mesh/e\u0301.OBJ/no.obj" in {*search.present(Folders(tmp_path))}


def test_each_folder_is_listed_once(folder, monkeypatch):
    real, listed = os.listdir, []
    monkeypatch.setattr(os, "listdir", lambda path: listed.append(path) or real(path))
    folders = Folders(folder)
    for _ in range(2):
        search = Search(("mesh", ".", "no"), ("a.obj", "mesh/b.stl", "parts/own/c.obj"))
        places = [*search.present(folders)]
        assert sorted(places) == ["mesh/a.obj", "mesh/b.stl", "mesh/b.stl", "parts/own/c.obj"]
    assert sorted(listed) == sorted({*listed})


def test_what_is_found_is_what_a_slow_search_finds(folder):
    (folder / "scene.xml").write_text(
        '<mujoco><compiler meshdir="mesh"/><include file="parts/part.xml"/><asset>'
        '<mesh file="own/c.obj"/><mesh file="deep/a.obj"/><mesh file="../deep/mesh/e.obj"/>'
        f'<mesh file="{folder}/mesh/b.stl"/><hfield file="hill.png"/></asset></mujoco>'
    )
    (folder / "parts" / "part.xml").write_text("<mujoco/>")
    found = find_inputs(folder / "scene.xml")
    slow = find_inputs(folder / "scene.xml", FilesHere())
    assert {path.resolve() for path in found} == {path.resolve() for path in slow}
    assert len(found) == 7


@pytest.mark.parametrize("out", ["out", "far/mesh/out", "at", "at/a/A", "at/b/mesh"])
@given(path=PATHS)
@settings(deadline=None)
def test_a_path_from_a_folder_leads_to_its_place_through_links(tree, out, path):
    path, out = tree / "at" / path.strip("/"), tree / out
    name = path_from(path, out)
    assert os.path.realpath(out / name) == os.path.realpath(path)
    assert ".." not in name.split("/")[name.split("/").count("..") :]
    if path.is_file():
        assert Places(out).of_file(path) == name
        assert has_no_other([name], {name}, Places(out))
        assert not has_no_other([name], {}, Places(out))


def test_links_above_both_change_no_path_and_links_below_stay_in_it(tree, monkeypatch):
    assert path_from(tree / "at" / "b" / "mesh" / "a", tree / "at" / "out") == "../b/mesh/a"
    assert path_from(tree / "at" / "b" / "mesh" / "a", tree / "at" / "b" / "mesh") == "a"
    linked = tree / "at" / "a" / "A"
    assert path_from(linked / "mesh" / "a", linked / "no") == "../mesh/a"
    monkeypatch.chdir(tree)
    assert path_from("at/b/a", "out") == path_from(tree / "at/b/a", "out") == "../../../at/b/a"
    assert path_from("at/b/a", "far/mesh/out") == "../../../at/b/a"


def test_folders_and_includes_are_those_of_mujoco_where_the_scene_is_in_a_link(folder):
    (folder / "far" / "away").mkdir(parents=True)
    (folder / "link").symlink_to(folder / "far" / "away")
    (folder / "link" / "scene.xml").write_text(
        '<mujoco><compiler meshdir="../mesh"/><include file="../parts/part.xml"/>'
        '<asset><mesh file="a.obj"/></asset></mujoco>'
    )
    (folder / "parts" / "part.xml").write_text('<mujoco><mesh file="own/c.obj"/></mujoco>')
    assert names(folder, "link/scene.xml") == [
        *("link/scene.xml", "mesh/a.obj", "parts/own/c.obj", "parts/part.xml")
    ]
