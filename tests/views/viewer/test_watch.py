"""Files that a scene names are watched, and a change counts once they rest."""

import os

import pytest

from browser import wait_until
from grid_maps import level_from
from navbake.views.viewer.server import PageServer
from navbake.views.viewer.view import Viewer, Watch, find_watched_files, watch_grid
from navbake.views.viewer.view_state import ViewState


def write(path, text):
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    return path


def test_a_broken_or_missing_file_names_none(tmp_path):
    broken = write(tmp_path / "scene.xml", "<mujoco><include file=")
    assert find_watched_files([broken, tmp_path / "none.xml", tmp_path / "a.yaml"]) == [
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
    assert not watch.has_changed()
    touch(path, "ab")
    assert not watch.has_changed()  # may be written still
    touch(path, "abc")
    assert not watch.has_changed()
    assert watch.has_changed()
    assert not watch.has_changed()
    path.unlink()
    assert not watch.has_changed() and watch.has_changed()


def test_files_that_a_change_adds_are_watched_then(tmp_path):
    path, other = write(tmp_path / "a.yaml", "a"), write(tmp_path / "b", "b")
    watch = Watch(read_nothing, lambda: [path, other] if "b" in path.read_text() else [path])
    touch(path, "b")
    assert [watch.has_changed(), watch.has_changed()] == [False, True]
    touch(other, "changed")
    assert [watch.has_changed(), watch.has_changed()] == [False, True]


def test_what_changes_while_it_is_read_first_is_read_again(tmp_path):
    level_from("..").save(tmp_path / "a.grid.json")
    watch = watch_grid(tmp_path / "a.grid.json", None)
    level_from("..\n..").save(tmp_path / "a.grid.json")
    assert not watch.has_changed() and watch.has_changed()
    assert watch.read().grid.levels[0].shape == (2, 2)


def test_the_watch_goes_on_after_any_error(tmp_path, caplog):
    pytest.importorskip("viser")
    path, asked = write(tmp_path / "a.yaml", "a"), []

    def read():
        asked.append(path.read_text())
        raise MemoryError("no space")

    watch = Watch(read, lambda: [path])
    with Viewer(ViewState(level_from("..")), PageServer(port=0), watch=watch):
        for text in ("ab", "abc"):
            touch(path, text)
            wait_until(lambda text=text: asked[-1:] == [text], "another look")
    assert "the viewer failed" in caplog.text
