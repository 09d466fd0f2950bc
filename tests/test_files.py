"""Files are written whole or not at all."""

import os

import pytest

from navbake.files import check_writable, write_whole


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


def test_a_check_leaves_nothing(tmp_path):
    check_writable(tmp_path / "a")
    assert list(tmp_path.iterdir()) == []
