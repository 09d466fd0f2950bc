"""What the tests of the commands share: a folder with a small scene, and a way to run them."""

from __future__ import annotations

from functools import partial

import pytest

from cli_scenes import write_arena, write_room
from command_line import run_command


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with room.xml and room.yaml in it."""
    write_room(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def arena(tmp_path, monkeypatch):
    """The current folder, with arena.xml and arena.yaml in it."""
    write_arena(tmp_path)
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
