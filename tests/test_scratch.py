"""Temporary folders: those of processes that were killed are removed, and no others."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time

import pytest

from navbake import files
from navbake.errors import NavbakeError
from navbake.files import remove_abandoned, scratch_folder
from project_paths import ROOT

locking = pytest.mark.skipif(files.fcntl is None, reason="nothing can be locked")
AT_WORK = """
import os, signal, sys
sys.path.insert(0, {root!r})
from navbake import files
{before}
with files.scratch_folder() as folder:
    (folder / "model").write_bytes(b"large")
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The folder of temporary files."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
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
    assert os.listdir(place) == []
    with pytest.raises(ZeroDivisionError), scratch_folder() as folder:
        folder.joinpath("b").write_bytes(b"" * (1 // 0))
    assert os.listdir(place) == []


@locking
def test_the_folder_of_a_process_that_was_killed_is_removed_by_the_next(place):
    with start() as process, scratch_folder() as own:
        assert process.stdout.readline().strip().startswith(bytes(place))
        remove_abandoned()
        assert len(os.listdir(place)) == 2  # both at work
        process.kill()
        process.wait()
        with scratch_folder() as other:
            assert sorted(os.listdir(place)) == sorted([own.name, other.name])
    assert os.listdir(place) == []


@locking
@pytest.mark.parametrize("moment", ["fcntl.flock", "shutil.rmtree"])
def test_nothing_stays_of_a_process_that_is_killed_between_two_steps(place, moment):
    die = f"files.{moment} = lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)"
    with start(die) as process:
        process.communicate(b"", timeout=60)
    assert process.returncode == -9 and os.listdir(place)
    remove_abandoned()
    assert os.listdir(place) == []


def test_what_others_have_there_is_left_alone(place):
    for name in ("navbake-plans", "navbake-01234567.txt", "x-navbake-01234567"):
        (place / name).mkdir()
    (place / "navbake-01234567").symlink_to(place / "navbake-plans")
    before = sorted(os.listdir(place))
    remove_abandoned()
    assert sorted(os.listdir(place)) == before


def test_without_locks_a_folder_of_yesterday_is_abandoned(place, monkeypatch):
    monkeypatch.setattr(files, "fcntl", None)
    for name, age in (("navbake-01234567", 0.0), ("navbake-abcdefgh", files.OLD + 60)):
        (place / name).mkdir()
        os.utime(place / name, (0, time.time() - age))
    remove_abandoned()
    assert os.listdir(place) == ["navbake-01234567"]


def test_where_no_folder_takes_temporary_files_one_line_says_what_to_do(place, monkeypatch):
    def refuse(*arguments, **options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("tempfile.mkdtemp", refuse)
        why = f"cannot write temporary files into {place}: No space left on device: free space"
        with pytest.raises(NavbakeError, match=f"^{why}, or set TMPDIR"), scratch_folder():
            pytest.fail("there is none")

    def refuse_all():
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr("tempfile.gettempdir", refuse_all)
    remove_abandoned()
    with pytest.raises(NavbakeError, match=r"No usable .*: free space, or set"), scratch_folder():
        pytest.fail("there is none")
