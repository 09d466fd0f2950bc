"""Files are written whole or not at all."""

import errno
import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from navbake import files
from navbake.errors import NavbakeError
from navbake.files import (
    check_writable,
    encode_csv,
    remove_leftovers,
    scratch_folder,
    write_together,
    write_whole,
)


def test_no_cell_of_a_csv_is_a_formula():
    rows = [["a", "b"], ["=1+1", 'say "x"'], ["@x\n\x1b", -1.5], [None, float("nan")]]
    text = encode_csv(rows).decode()
    assert text.split("\r\n") == [
        "a,b",
        '\'=1+1,"say ""x"""',
        "'@x\\n\\x1b,-1.5",
        ",",
        "",
    ]


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


# ---------------------------------------------------------------- what killed writers leave


def temporary_files(folder):
    return sorted(
        path.name for path in folder.iterdir() if files.TEMPORARY_NAME.fullmatch(path.name)
    )


def test_what_a_killed_writer_left_is_removed_a_day_later_and_nothing_else(tmp_path):
    old, new = (tmp_path / f".navbake-{digit * 16}.tmp" for digit in "01")
    others = [".navbake-1.tmp", "navbake-0000000000000000.tmp", f"{old.name}.json", "navbake-plans"]
    for path in (old, new, *(tmp_path / name for name in others)):
        path.touch()
        os.utime(path, (0, 0))
    new.touch()
    (tmp_path / f".navbake-{'2' * 16}.tmp").symlink_to(tmp_path / others[0])
    write_whole(b"now", tmp_path / "a")
    assert temporary_files(tmp_path) == [new.name, f".navbake-{'2' * 16}.tmp"]
    assert all((tmp_path / name).exists() for name in others)
    remove_leftovers(tmp_path, age=0)
    assert not new.exists()


def test_a_folder_is_listed_once(tmp_path, monkeypatch):
    """Ten thousand grids in one folder would be a hundred million entries."""
    listed, real = [], os.scandir
    monkeypatch.setattr(os, "scandir", lambda path: (listed.append(path), real(path))[1])
    (tmp_path / "other").mkdir()
    for number in range(3):
        write_whole(b"now", tmp_path / f"{number}")
        write_whole(b"now", tmp_path / "other" / f"{number}")
    assert listed == [tmp_path, tmp_path / "other"]


def test_many_writers_of_one_folder(tmp_path):
    def write(number):
        for turn in range(40):
            write_whole(b"%d %d" % (number, turn), tmp_path / f"file {number % 3}")

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(8)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file 0", "file 1", "file 2"]
    assert all(path.read_bytes().endswith(b" 39") for path in tmp_path.iterdir())


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


# ---------------------------------------------------------------- temporary folders


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The folder of temporary files."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def test_a_folder_is_gone_when_it_is_left(place):
    with scratch_folder() as folder:
        (folder / "a").mkdir()
        assert folder.parent == place and files.TEMPORARY_NAME.fullmatch(folder.name)
    assert os.listdir(place) == []
    with pytest.raises(ZeroDivisionError), scratch_folder() as folder:
        folder.joinpath("b").write_bytes(b"" * (1 // 0))
    assert os.listdir(place) == []


def test_a_folder_of_yesterday_is_removed_by_the_next(place):
    for name in ("navbake-01234567", "navbake-abcdefgh"):
        (place / name).mkdir()
    (place / "navbake-01234567" / "model").write_bytes(b"large")
    os.utime(place / "navbake-01234567", (0, 0))
    with scratch_folder() as folder:
        assert sorted(os.listdir(place)) == sorted(["navbake-abcdefgh", folder.name])


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
    with pytest.raises(NavbakeError, match=r"No usable .*: free space, or set"), scratch_folder():
        pytest.fail("there is none")
