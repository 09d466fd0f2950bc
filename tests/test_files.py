"""Files are written whole or not at all."""

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from navbake import files
from navbake.files import (
    check_writable,
    wait_for_disk,
    without_waiting,
    write_together,
    write_whole,
)


def test_replaces_the_file(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"long before")
    write_whole(b"now", path)
    assert path.read_bytes() == b"now"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays(tmp_path):
    (tmp_path / "target").write_bytes(b"before")
    (tmp_path / "link").symlink_to("target")
    write_whole(b"now", tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_bytes() == b"now"


def test_a_failure_leaves_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / "a"
    path.write_bytes(b"before")

    def fail(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="No space left"):
        write_whole(b"now", path)
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("act", [lambda path: write_whole(b"", path), check_writable])
def test_refuses_folders_and_missing_ones(tmp_path, act):
    with pytest.raises(OSError, match="it is a folder"):
        act(tmp_path)
    with pytest.raises(FileNotFoundError):
        act(tmp_path / "none" / "a")
    assert list(tmp_path.iterdir()) == []


def test_a_device_is_written_to():
    check_writable(os.devnull)
    write_whole(b"now", os.devnull)
    assert os.path.exists(os.devnull)
    assert not os.path.isfile(os.devnull)


def test_a_writer_waits_for_the_disk_unless_told_otherwise(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", synced.append)
    with without_waiting():
        write_whole(b"now", tmp_path / "a")
        write_together({tmp_path / "b": b"now"})
    assert synced == []
    wait_for_disk(tmp_path)
    assert [(tmp_path / name).read_bytes() for name in "ab"] == [b"now"] * 2
    write_whole(b"then", tmp_path / "a")
    assert len(synced) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="other systems know no folder's disk")
def test_waiting_for_the_disk_of_no_folder_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        wait_for_disk(tmp_path / "none")


def test_a_check_leaves_nothing(tmp_path):
    check_writable(tmp_path / "a")
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------- what killed writers leave

KILLED = """
import os, signal, sys
from pathlib import Path
from navbake import files
os.fsync = lambda number: os.kill(os.getpid(), signal.SIGKILL)
files.write_whole(b"x" * 1000, sys.argv[1])
"""
AT_WORK = """
import os, sys
from navbake import files
os.fsync = lambda number: (print("writing", flush=True), sys.stdin.read())
files.write_whole(b"theirs", sys.argv[1])
"""
needs_locks = pytest.mark.skipif(files.fcntl is None, reason="files can't be locked here")


def temporary_files(folder):
    return sorted(path.name for path in folder.iterdir() if files.TEMPORARY.fullmatch(path.name))


@needs_locks
def test_the_next_write_removes_what_a_killed_one_left(tmp_path):
    for _ in range(2):
        subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "a")], check=False)
    assert len(temporary_files(tmp_path)) == 1  # the second one removed what the first one left
    assert not (tmp_path / "a").exists()
    write_whole(b"now", tmp_path / "b")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b"]


@needs_locks
def test_a_writer_at_work_is_left_alone(tmp_path):
    command = [sys.executable, "-c", AT_WORK, str(tmp_path / "a")]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "writing\n"
        write_whole(b"ours", tmp_path / "b")
        files.remove_leftovers(tmp_path)
        assert len(temporary_files(tmp_path)) == 1
        other.stdin.close()
    assert other.returncode == 0
    assert (tmp_path / "a").read_bytes() == b"theirs"
    assert temporary_files(tmp_path) == []


def test_a_folder_is_listed_once(tmp_path, monkeypatch):
    """Ten thousand grids in one folder would be a hundred million entries."""
    listed, real = [], os.scandir
    monkeypatch.setattr(os, "scandir", lambda path: (listed.append(path), real(path))[1])
    (tmp_path / "other").mkdir()
    for number in range(3):
        write_whole(b"now", tmp_path / f"{number}")
        write_whole(b"now", tmp_path / "other" / f"{number}")
    assert listed == [tmp_path, tmp_path / "other"]


def test_only_files_of_ours_are_removed(tmp_path):
    ours = tmp_path / f".navbake-{'0' * 16}.tmp"
    names = [".navbake-1.tmp", "navbake-0000000000000000.tmp", ".navbake-0000000000000000.tmp.json"]
    for name in names:
        (tmp_path / name).touch()
    ours.symlink_to(tmp_path / names[0])
    (tmp_path / f".navbake-{'1' * 16}.tmp").mkdir()
    write_whole(b"now", tmp_path / "a")
    assert len(list(tmp_path.iterdir())) == len(names) + 3


def test_without_locks_only_old_files_are_leftovers(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "fcntl", None)
    old, new = (tmp_path / f".navbake-{digit * 16}.tmp" for digit in "01")
    old.touch()
    new.touch()
    os.utime(old, (0, time.time() - files.OLD - 60))
    write_whole(b"now", tmp_path / "a")
    assert temporary_files(tmp_path) == [new.name]
    assert (tmp_path / "a").read_bytes() == b"now"


@needs_locks
def test_many_writers_of_one_folder(tmp_path):
    def write(number):
        for turn in range(40):
            write_whole(b"%d %d" % (number, turn), tmp_path / f"file {number % 3}")

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(8)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file 0", "file 1", "file 2"]
    assert all(path.read_bytes().endswith(b" 39") for path in tmp_path.iterdir())


@needs_locks
def test_a_file_that_is_taken_for_a_leftover_is_made_again(tmp_path, monkeypatch):
    real, taken = files.fcntl.flock, []

    def flock(file, how):
        real(file, how)
        if not taken:  # another writer was quicker, just before
            taken.append(file.name)
            os.unlink(file.name)

    monkeypatch.setattr(files.fcntl, "flock", flock)
    write_whole(b"now", tmp_path / "a")
    assert len(taken) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_tries_again_where_a_reader_is_in_the_way(tmp_path, monkeypatch):
    """Windows replaces no file while it is open elsewhere."""
    target, real, failures = tmp_path / "grid.json", os.replace, [1, 2]

    def replace(source, to):
        if failures:
            failures.pop()
            raise PermissionError(13, "Access is denied")
        real(source, to)

    monkeypatch.setattr("navbake.files.fcntl", None)
    monkeypatch.setattr("navbake.files.os.replace", replace)
    write_whole(b"new", target)
    assert target.read_bytes() == b"new" and failures == []


# ---------------------------------------------------------------- several files together


def test_files_are_put_in_order_and_after_all_are_written(tmp_path, monkeypatch):
    seen, replace = [], os.replace

    def watch(source, target):
        seen.append((os.path.basename(target), len(temporary_files(tmp_path))))
        replace(source, target)

    monkeypatch.setattr(os, "replace", watch)
    write_together({tmp_path / "b.pgm": b"image", tmp_path / "a.yaml": [b"image: ", b"b.pgm"]})
    assert seen == [("b.pgm", 2), ("a.yaml", 1)]
    assert (tmp_path / "a.yaml").read_bytes() == b"image: b.pgm"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.yaml", "b.pgm"]


def test_where_one_file_fails_none_is_written(tmp_path):
    (tmp_path / "a").write_bytes(b"before")

    def fail():
        yield b"x"
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        write_together({tmp_path / "a": b"now", tmp_path / "b": fail()})
    assert (tmp_path / "a").read_bytes() == b"before"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
