"""What the tests of the commands share: a folder with a small scene, and a way to run them."""

from __future__ import annotations

from functools import partial

import pytest

from command_line import run_command

ROOM = """
<mujoco>
  <worldbody>
    <geom name="floor" type="box" size="3 2 .1" pos="0 0 -.1"/>
    <geom name="wall [b]" type="box" size=".1 2 1" pos="1 0 1"/>
    <body name="lamp">
      <geom name="shade" type="sphere" size=".1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>
"""
ARENA = """
<mujoco>
  <worldbody>
    <geom name="floor" type="box" size=".75 1 .05" pos=".75 1 -.05"/>
    <geom name="block" type="box" size=".1 .05 .2" pos="1.2 .25 .2"/>
    <body name="cart" pos=".3 1.6 .3"><geom type="sphere" size=".15"/></body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with room.xml and room.yaml in it."""
    (tmp_path / "room.xml").write_text(ROOM)
    (tmp_path / "room.yaml").write_text("scene: {path: room.xml}\ngrid: {cell_size: 0.5}\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def arena(tmp_path, monkeypatch):
    """The current folder, with arena.xml and arena.yaml in it."""
    (tmp_path / "arena.xml").write_text(ARENA)
    (tmp_path / "arena.yaml").write_text(
        "scene: {path: arena.xml}\nagent: {height: 0.4, traversable_floor_height: 0.05}\n"
        "floors: {min_area: 0.1, shrink: 0.1}\n"
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(capsys):
    """Returns a function that runs a command: its status, stdout and stderr."""
    return partial(run_command, capsys)


@pytest.fixture
def names():
    """Returns a function that lists the files below a folder."""

    def call(folder):
        return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())

    return call
