"""Files that a scene names are watched, and a change counts once they rest."""

import os

import pytest

from browser import wait_until
from grid_maps import level_from
from navbake.views.viewer.exhibit import Exhibit
from navbake.views.viewer.view import Viewer, Watch, find_files, watch_grid


def write(path, text):
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    return path


def test_includes_meshes_and_textures_are_found(tmp_path):
    scene = write(
        tmp_path / "scene.xml",
        '<mujoco><compiler meshdir="meshes" texturedir="pictures"/><include file="more.xml"/>'
        '<asset><mesh file="a.obj"/><texture file="b.png"/><texture fileright="c.png"/></asset>'
        "</mujoco>",
    )
    more = write(
        tmp_path / "more.xml",
        '<mujocoinclude><include file="scene.xml"/><asset><mesh file="d.stl"/></asset>'
        "</mujocoinclude>",
    )
    found = find_files([scene])
    expected = {"meshes/a.obj", "pictures/b.png", "pictures/c.png", "meshes/d.stl"}
    assert {scene, more, *(tmp_path / name for name in expected)} <= {*found}


def test_what_a_batch_notices_is_watched(tmp_path):
    scene = write(
        tmp_path / "scene.xml",
        '<mujoco><asset><model name="arm" file="arm\\arm.xml"/></asset></mujoco>',
    )
    arm = write(
        tmp_path / "arm" / "arm.xml",
        '<mujoco><asset><mesh file="a.obj"/><mesh file="later.obj"/></asset></mujoco>',
    )
    mesh = write(tmp_path / "arm" / "a.obj", "")
    found = find_files([scene])
    assert {scene, arm, mesh, tmp_path / "arm" / "later.obj"} <= {*found}
    assert tmp_path / "a.obj" not in found  # it is there


def test_meshes_of_a_urdf_are_watched_where_the_bake_finds_them(tmp_path):
    mesh = write(tmp_path / "meshes" / "a.gltf", '{"buffers": [{"uri": "a.bin"}]}')
    geometries = "".join(
        f'<visual><geometry><mesh filename="package://arm/meshes/{name}"/></geometry></visual>'
        for name in ("a.gltf", "later.obj")
    )
    urdf = write(
        tmp_path / "urdf" / "arm.urdf", f'<robot name="a"><link>{geometries}</link></robot>'
    )
    found = find_files([urdf])
    assert found[0] == urdf
    assert {mesh, mesh.with_name("a.bin"), mesh.with_name("later.obj")} <= {*found}


def test_a_broken_or_missing_file_names_none(tmp_path):
    broken = write(tmp_path / "scene.xml", "<mujoco><include file=")
    assert find_files([broken, tmp_path / "none.xml", tmp_path / "a.yaml"]) == [
        broken, tmp_path / "none.xml", tmp_path / "a.yaml",
    ]  # fmt: skip


def read_nothing():
    raise AssertionError


def touch(path, text):
    path.write_text(text)
    state = path.stat()
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns + 1_000_000))


def test_a_change_counts_once_when_it_rests(tmp_path):
    path = write(tmp_path / "a.yaml", "a")
    watch = Watch(read_nothing, lambda: [path])
    assert not watch.look()
    touch(path, "ab")
    assert not watch.look()  # may be written still
    touch(path, "abc")
    assert not watch.look()
    assert watch.look()
    assert not watch.look()
    path.unlink()
    assert not watch.look() and watch.look()


def test_files_that_a_change_adds_are_watched_then(tmp_path):
    path, other = write(tmp_path / "a.yaml", "a"), write(tmp_path / "b", "b")
    watch = Watch(read_nothing, lambda: [path, other] if "b" in path.read_text() else [path])
    touch(path, "b")
    assert [watch.look(), watch.look()] == [False, True]
    touch(other, "changed")
    assert [watch.look(), watch.look()] == [False, True]


def test_what_changes_while_it_is_read_first_is_read_again(tmp_path):
    level_from("..").save(tmp_path / "a.grid.json")
    watch = watch_grid(tmp_path / "a.grid.json", None)
    level_from("..\n..").save(tmp_path / "a.grid.json")
    assert not watch.look() and watch.look()
    assert watch.read().grid.levels[0].shape == (2, 2)


def test_the_watch_goes_on_after_any_error(tmp_path, caplog):
    pytest.importorskip("viser")
    path, asked = write(tmp_path / "a.yaml", "a"), []

    def read():
        asked.append(path.read_text())
        raise MemoryError("no space")

    watch = Watch(read, lambda: [path])
    with Viewer(Exhibit(level_from("..")), port=0, watch=watch):
        for text in ("ab", "abc"):
            touch(path, text)
            wait_until(lambda text=text: asked[-1:] == [text], "another look")
    assert "failed to read" in caplog.text
