"""Temporary folders: those of processes that were killed are removed, and no others."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from navbake import files
from navbake.baker.scene.guard import scratch
from navbake.baker.scene.guard.scratch import remove_abandoned, scratch_folder
from project_paths import ROOT

locking = pytest.mark.skipif(files.fcntl is None, reason="nothing can be locked")
AT_WORK = """
import os, signal, sys
sys.path.insert(0, {root!r})
from navbake.baker.scene.guard import scratch
{before}
with scratch.scratch_folder() as folder:
    (folder / "model").write_bytes(b"large")
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The folder of temporary files."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(scratch, "_swept", set())
    return tmp_path


def start(before=""):
    """Another process that has a folder, or ends with what is done before."""
    script = AT_WORK.format(root=str(ROOT), before=before)
    return subprocess.Popen([sys.executable, "-c", script], stdin=-1, stdout=-1, stderr=-1)


def test_a_folder_is_gone_when_it_is_left(place):
    with scratch_folder() as folder:
        (folder / "a").mkdir()
        remove_abandoned()  # it is in use
        assert folder.parent == place and (folder / "a").is_dir()
        assert len(os.listdir(place)) == 2
    assert os.listdir(place) == []
    with pytest.raises(ZeroDivisionError), scratch_folder() as folder:
        folder.joinpath("b").write_bytes(b"" * (1 // 0))
    assert os.listdir(place) == []


@locking
def test_the_folder_of_a_process_that_was_killed_is_removed_by_the_next(place, monkeypatch):
    with start() as process, scratch_folder() as own:
        assert process.stdout.readline().strip().startswith(bytes(place))
        remove_abandoned()
        assert len(os.listdir(place)) == 4  # two at work
        process.kill()
        process.wait()
        assert len(os.listdir(place)) == 4
        monkeypatch.setattr(scratch, "_swept", set())
        with scratch_folder():  # looks first
            assert len(os.listdir(place)) == 4
        assert (own / "..").samefile(place) and len(os.listdir(place)) == 2
    assert os.listdir(place) == []


@locking
@pytest.mark.parametrize(
    "moment", ["scratch.Path.mkdir", "scratch.shutil.rmtree", "scratch.Path.unlink"]
)
def test_nothing_stays_of_a_process_that_is_killed_between_two_steps(place, moment):
    die = f"{moment} = lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)"
    with start(die) as process:
        process.communicate(b"", timeout=60)
    assert process.returncode == -9 and os.listdir(place)
    remove_abandoned()
    assert os.listdir(place) == []


def test_what_others_have_there_is_left_alone(place):
    for name in ("navbake-plans", "navbake-0123456789abcdef.txt", "x-navbake-0123456789abcdef"):
        (place / name).mkdir()
    (place / "navbake-0123456789abcdef").symlink_to(place / "navbake-plans")
    (place / "navbake-plans" / "kept").touch()
    before = sorted(os.listdir(place))
    remove_abandoned()
    assert sorted(os.listdir(place)) == before and (place / "navbake-plans" / "kept").exists()
