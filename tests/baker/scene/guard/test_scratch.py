"""Temporary folders: those of processes that were killed are removed, and no others."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from navbake import files
from navbake.baker.scene.guard import scratch
from navbake.baker.scene.guard.scratch import remove_abandoned, scratch_file, scratch_folder
from navbake.errors import NavbakeError
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
    monkeypatch.setattr(scratch, "short_place", lambda: None)
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


def make_old(*paths):
    for path in paths:
        os.utime(path, (0, time.time() - files.OLD - 60))


@pytest.fixture
def long_lived(place):
    """A folder as one of yesterday's that is still in use, and its file."""
    folder, lock = place / f"navbake-{'0' * 16}", place / f".navbake-{'0' * 16}.tmp"
    (folder / "logs").mkdir(parents=True)
    lock.touch()
    written = folder / "logs" / "today"
    written.touch()
    make_old(lock, folder / "logs", folder)
    return folder, lock, written


def test_without_locks_a_folder_is_in_use_while_something_in_it_is_written(long_lived, monkeypatch):
    folder, lock, written = long_lived
    monkeypatch.setattr(files, "fcntl", None)
    remove_abandoned()
    assert written.exists() and lock.exists()
    make_old(written)
    remove_abandoned()
    assert not folder.exists() and not lock.exists()


def test_a_folder_whose_file_was_cleaned_up_is_in_use_while_something_in_it_is_written(long_lived):
    folder, lock, written = long_lived
    lock.unlink()
    remove_abandoned()
    assert written.exists()
    make_old(written)
    remove_abandoned()
    assert not folder.exists()


@locking
def test_all_places_of_folders_are_looked_at(place, monkeypatch):
    (place / "short").mkdir()
    monkeypatch.setattr(scratch, "short_place", lambda: place / "short")
    for parent in (place, place / "short"):
        (parent / f"navbake-{'0' * 16}").mkdir()
        (parent / f".navbake-{'0' * 16}.tmp").touch()
    remove_abandoned()
    assert os.listdir(place) == ["short"] and os.listdir(place / "short") == []


def refuse(*arguments):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def enter_folder(where=None):
    with scratch_folder(where):
        pytest.fail("there is none")


@pytest.mark.parametrize("make", [scratch_file, enter_folder])
def test_where_no_folder_takes_temporary_files_one_line_says_what_to_do(place, make, monkeypatch):
    def refuse_all():
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr("tempfile.gettempdir", refuse_all)
    remove_abandoned()
    with pytest.raises(NavbakeError, match=r"No usable .*: free space, or set TMPDIR") as caught:
        make()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("where", ["create_temporary", "Path.mkdir"])
def test_a_folder_without_room_is_one_line(place, where, monkeypatch):
    monkeypatch.setattr(f"{scratch.__name__}.{where}", refuse)
    why = f"cannot write temporary files into {place}: No space left on device: free space"
    with pytest.raises(NavbakeError) as caught:
        enter_folder()
    assert str(caught.value) == f"{why}, or set TMPDIR to a folder that has room"
    with pytest.raises(NavbakeError) as caught:
        enter_folder(Path(place))  # TMPDIR doesn't move that
    assert str(caught.value) == why
    assert os.listdir(place) == []
