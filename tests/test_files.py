"""Files are written whole or not at all."""

import errno
import os
import signal
import stat
import subprocess
import sys
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


only_posix = pytest.mark.skipif(not hasattr(os, "fork"), reason="locks and signals of POSIX")


@only_posix
def test_what_a_killed_writer_left_goes_with_the_next_write_and_nothing_else(tmp_path):
    leftovers = [f".navbake-{digit * 16}.tmp" for digit in "01"]
    others = [
        ".navbake-1.tmp",
        "navbake-0000000000000000.tmp",
        f"{leftovers[0]}.json",
        "navbake-plans",
    ]
    for name in (*leftovers, *others):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (0, 0))
    (tmp_path / leftovers[1]).touch()
    (tmp_path / f".navbake-{'2' * 16}.tmp").symlink_to(tmp_path / others[0])
    write_whole(b"now", tmp_path / "a")
    assert temporary_files(tmp_path) == [f".navbake-{'2' * 16}.tmp"]
    assert all((tmp_path / name).exists() for name in others)


@pytest.mark.parametrize("fails", ["there is no fcntl", "its locks fail"])
def test_without_locks_a_leftover_is_removed_a_day_later(tmp_path, monkeypatch, fails):
    """As on Windows, and on some network file systems."""

    def refuse(descriptor, operation):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    if files.fcntl is not None and fails == "its locks fail":
        monkeypatch.setattr("fcntl.flock", refuse)
    else:
        monkeypatch.setattr(files, "fcntl", None)
    old, new = (tmp_path / f".navbake-{digit * 16}.tmp" for digit in "01")
    for path in (old, new):
        path.touch()
    os.utime(old, (0, 0))
    write_whole(b"now", tmp_path / "a")
    with scratch_folder(tmp_path):
        assert temporary_files(tmp_path)[0] == new.name
    assert sorted(path.name for path in tmp_path.iterdir()) == [new.name, "a"]
    remove_leftovers(tmp_path, min_age=0)
    assert not new.exists()


def run_child(code, *arguments):
    """Start a process that runs code which has this module's names and the module `files`."""
    prefix = "import os, signal, sys\nfrom pathlib import Path\nfrom navbake import files\n"
    return subprocess.Popen(
        [sys.executable, "-c", prefix + code, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )


WRITE_SLOWLY = """
def pieces():
    yield b"first "
    print("writing", flush=True)
    sys.stdin.readline()
    yield b"second"
files.write_together({Path(sys.argv[1]): pieces()})
"""
HOLD_FOLDER = """
with files.scratch_folder(Path(sys.argv[1]).parent) as folder:
    (folder / "model").touch()
    print("writing", flush=True)
    sys.stdin.readline()
"""


@only_posix
@pytest.mark.parametrize("code", [WRITE_SLOWLY, HOLD_FOLDER])
@pytest.mark.parametrize("ends", ["by itself", "killed"])
def test_what_a_living_writer_has_stays_and_what_a_killed_one_left_goes(tmp_path, code, ends):
    with run_child(code, tmp_path / "a") as child:
        assert child.stdout.readline() == b"writing\n"
        (temporary,) = temporary_files(tmp_path)
        os.utime(tmp_path / temporary, (0, 0))  # its age says nothing
        write_whole(b"now", tmp_path / "b")
        remove_leftovers(tmp_path, min_age=0)
        assert temporary_files(tmp_path) == [temporary]
        if ends == "killed":
            child.kill()
        child.stdin.close()
    files.cleaned_folders.clear()  # as in another process
    write_whole(b"now", tmp_path / "b")
    assert temporary_files(tmp_path) == []
    if ends != "killed" and code == WRITE_SLOWLY:
        assert (tmp_path / "a").read_bytes() == b"first second"


def test_a_file_that_is_taken_for_a_leftover_before_it_is_locked_is_made_again(
    tmp_path, monkeypatch
):
    real, removed = files.hold_lock, []

    def hold(descriptor, path):
        if not removed:
            removed.append(path)
            os.unlink(path)
        return real(descriptor, path)

    monkeypatch.setattr(files, "hold_lock", hold)
    write_whole(b"now", tmp_path / "a")
    assert len(removed) == 1 and os.listdir(tmp_path) == ["a"]


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


# ---------------------------------------------------------------- modes


@only_posix
def test_a_file_keeps_its_mode_and_a_new_one_has_the_usual_one(tmp_path):
    path = tmp_path / "a"
    umask = os.umask(0o027)
    try:
        write_whole(b"first", path)
        assert stat.S_IMODE(path.stat().st_mode) == 0o640
        for mode in (0o600, 0o640, 0o664, 0o444):
            path.chmod(mode)
            (tmp_path / "b").touch(0o666)
            write_whole(b"now", path)
            assert stat.S_IMODE(path.stat().st_mode) == mode
            write_together({path: b"then", tmp_path / "b": b"then"})
            assert stat.S_IMODE(path.stat().st_mode) == mode
    finally:
        os.umask(umask)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives away")
def test_a_file_that_root_writes_stays_its_owners(tmp_path):
    path = tmp_path / "a"
    path.touch(0o640)
    os.chown(path, 54321, 54322)
    write_whole(b"now", path)
    status = path.stat()
    assert (status.st_uid, status.st_gid, stat.S_IMODE(status.st_mode)) == (54321, 54322, 0o640)


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


KILLED = """
calls = 0
def watch(name):
    real = getattr(os, name)
    def call(*arguments):
        global calls
        for moment in ("before", "after"):
            calls += 1
            if calls == int(sys.argv[2]):
                os.kill(os.getpid(), signal.SIGKILL)
            if moment == "before":
                result = real(*arguments)
        return result
    setattr(os, name, call)
watch("replace")
watch("unlink")
folder = Path(sys.argv[1])
files.write_together({folder / name: b"new " + name.encode() for name in sys.argv[3:]})
"""


def read_all(folder, names):
    """The first word of each file, None where it is missing."""
    return [
        (folder / name).read_bytes().split()[0].decode() if (folder / name).exists() else None
        for name in names
    ]


@only_posix
@pytest.mark.parametrize("names", [["a.pgm"], ["a.pgm", "a.yaml"], ["m.pgm", "m.yaml", "p.yaml"]])
def test_wherever_a_writer_is_killed_no_new_file_is_beside_an_old_one(tmp_path, names):
    states, status, point = [], -signal.SIGKILL, 0
    while status == -signal.SIGKILL:
        point += 1
        files.cleaned_folders.clear()  # as in another process
        write_together({tmp_path / name: b"old" for name in names})
        assert sorted(os.listdir(tmp_path)) == sorted(names)  # no leftovers
        with run_child(KILLED, tmp_path, point, *names) as child:
            pass
        status = child.returncode
        state = read_all(tmp_path, names)
        states.append(state)
        assert not {"old", "new"} <= {*state}
        # what names others is there only if they are
        assert state == sorted(state, key=lambda content: content is None)
    assert status == 0 and point > 2 * len(names)
    assert states[0] == ["old"] * len(names) and states[-1] == ["new"] * len(names)
    if len(names) == 1:
        assert [None] not in states


@only_posix
def test_where_one_file_changes_all_states_are_whole(tmp_path):
    """As a new image of the same size, beside the same YAML."""
    status, point = -signal.SIGKILL, 0
    while status == -signal.SIGKILL:
        point += 1
        write_together({tmp_path / "a.pgm": b"old", tmp_path / "a.yaml": b"new a.yaml"})
        with run_child(KILLED, tmp_path, point, "a.pgm", "a.yaml") as child:
            pass
        status = child.returncode
        assert read_all(tmp_path, ["a.pgm", "a.yaml"]) in (["old", "new"], ["new", "new"])
    assert status == 0


@pytest.mark.parametrize("failing_call", [1, 2, 3, 4])
def test_where_a_renaming_fails_what_was_there_is_put_back(tmp_path, monkeypatch, failing_call):
    write_together({tmp_path / "a.pgm": b"old", tmp_path / "a.yaml": b"old"})
    real, calls = os.replace, []

    def replace(source, target):
        calls.append(target)
        if len(calls) == failing_call:
            raise PermissionError(13, "a reader has it open, on Windows")
        real(source, target)

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(PermissionError):
        write_together(
            {tmp_path / "a.pgm": b"new", tmp_path / "b": b"new", tmp_path / "a.yaml": b"new"}
        )
    assert read_all(tmp_path, ["a.pgm", "a.yaml"]) == ["old", "old"]
    assert sorted(os.listdir(tmp_path)) == ["a.pgm", "a.yaml"]


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


@only_posix
def test_a_folder_of_a_killed_process_is_removed_by_the_next(place):
    for name in ("navbake-scratch-01234567", "navbake-abcdefgh", "navbake-scratch-mine"):
        (place / name).mkdir()
    (place / "navbake-scratch-01234567" / "model").write_bytes(b"large")
    with scratch_folder() as folder:
        names = ["navbake-abcdefgh", "navbake-scratch-mine", folder.name]
        assert sorted(os.listdir(place)) == sorted(names)


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


def test_no_hint_compares_the_names_of_a_very_full_folder(tmp_path):
    for number in range(files.MAX_HINT_NAMES - 1):
        (tmp_path / f"{number}.txt").touch()
    (tmp_path / "house.xml").touch()
    missing_path = tmp_path / "hoose.xml"
    assert files.hint_at_file(missing_path, [".xml"]) == f"did you mean {tmp_path / 'house.xml'}?"
    (tmp_path / "one more.txt").touch()
    assert files.hint_at_file(missing_path, [".xml"]) == ""
