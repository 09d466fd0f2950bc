"""A pipe or a device that a file names keeps nobody: it is an error at once."""

import os
import sys
from pathlib import Path

import pytest

from navbake.baker.scene.model import CompileLimits
from navbake.baker.scene.scene import load_scene_file
from navbake.batch.store import read_file
from navbake.config.settings import load_config
from navbake.errors import ConfigError, FormatError, NavbakeError, SceneError
from navbake.files import scratch_folder
from navbake.formats.nav2 import read_nav2

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")

FLOOR = '<worldbody><geom type="box" size="3 3 .1"/></worldbody>'
SCENES = {
    "mesh.xml": '<asset><mesh name="a" file="pipe.obj"/></asset>',
    "include.xml": '<include file="pipe.xml"/>',
    "texture.xml": '<asset><texture name="a" type="2d" file="pipe.png"/></asset>',
    "field.xml": '<asset><hfield name="a" file="pipe.png" size="1 1 1 1"/></asset>',
    "inner.xml": '<include file="mesh.xml"/>',
}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for ending in ("obj", "xml", "png", "json", "pgm", "stl", "yaml"):
        os.mkfifo(tmp_path / f"pipe.{ending}")
    for name, text in SCENES.items():
        (tmp_path / name).write_text(f"<mujoco>{text}{FLOOR}</mujoco>")
    (tmp_path / "robot.urdf").write_text(
        '<robot name="r"><link name="l"><collision><geometry><mesh filename="pipe.stl"/>'
        "</geometry></collision></link></robot>"
    )
    return tmp_path


@pytest.mark.parametrize("name", [*SCENES, "robot.urdf"])
def test_of_a_scene(name):
    with pytest.raises(SceneError, match=r"cannot read pipe\.\w+: expected a file, got a pipe"):
        load_scene_file(load_config(name))


def test_of_a_scene_that_is_compiled_apart():
    with pytest.raises(SceneError, match=r"cannot read pipe\.obj: expected a file, got a pipe"):
        load_scene_file(load_config("mesh.xml"), CompileLimits())


def test_of_settings(folder):
    (folder / "room.yaml").write_text("scene: {path: a.xml}\nrooms: {polygons: pipe.json}\n")
    with pytest.raises(ConfigError, match=r"pipe\.json: expected a file, got .*`rooms\.polygons`"):
        load_config("room.yaml")


def test_of_a_map(folder):
    (folder / "map.yaml").write_text(
        "{image: pipe.pgm, resolution: 0.1, origin: [0, 0, 0], occupied_thresh: 0.6, "
        "free_thresh: 0.2, negate: 0}"
    )
    with pytest.raises(FormatError, match=r"`image` in map\.yaml names: expected a file, got"):
        read_nav2("map.yaml")


def test_of_a_batch():
    with pytest.raises(NavbakeError, match=r"cannot read pipe\.yaml: .*expected a file, got"):
        read_file("pipe.yaml")


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
def test_a_link_among_temporary_folders_is_not_followed(folder, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    link = folder / "navbake-scratch-0123abcd"
    link.symlink_to("/")
    os.utime(link, (0, 0), follow_symlinks=False)
    seen, real = [], os.scandir
    monkeypatch.setattr(os, "scandir", lambda path=".": (seen.append(str(path)), real(path))[1])
    with scratch_folder() as made:
        assert made.parent == folder
    assert link.is_symlink() and not any(path.startswith(str(link)) for path in seen)
