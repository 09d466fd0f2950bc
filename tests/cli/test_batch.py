"""`navbake batch`: what it prints, its exit status, and what is left after it was ended."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import navbake
from batch_in_process import run_sources, stay_in_process
from batch_processes import PATIENCE, Watcher, digests, start, wait_for_grids, wait_until_gone
from batch_scenes import write_scenes
from navbake import files
from navbake.batch import index, store
from navbake.errors import NavbakeError
from navbake.files import TEMPORARY_NAME
from navbake.formats.navgrid import read_navgrid
from report_pages import content_of_batch

linux = pytest.mark.skipif(sys.platform != "linux", reason="how Linux ends processes")
COUNT = 12
OVERRIDES = ("grid.cell_size=0.1",)
COARSE = ("--set", *OVERRIDES)


@pytest.fixture
def here(monkeypatch):
    """Jobs are done in this process, one after another."""
    stay_in_process(monkeypatch)


def test_a_batch_prints_a_summary_and_what_failed(folder, run, here):
    (folder / "bad.xml").write_text("<mujoco>")
    status, out, err = run("batch", "*.xml", "-o", "out", *COARSE)
    assert status == 1
    first, cost = out.splitlines()
    assert first.startswith("1 baked, 1 failed, 1 with warnings in ")
    assert first.endswith(str(Path("out/index.jsonl"))) and cost.startswith("a scene: ")
    assert err.startswith("navbake: bad: error: broken XML in bad.xml") and err.count("\n") == 1
    status, out, err = run("batch", "room.xml", "-o", "out", *COARSE)
    assert (status, err) == (0, "") and out.startswith("1 skipped, 1 with warnings in ")
    assert run("batch", "room.xml", "-o", "out", "-q", *COARSE) == (0, "", "")
    status, out, err = run("batch", "bad.xml", "room.xml", "-o", "2", "--max-failures", "0")
    assert status == 1 and out.startswith("1 failed, 1 left in ")
    assert "navbake: stopped: 1 scenes failed, more than 0" in err


def test_scenes_whose_episodes_make_no_set_are_summed_up(folder, run, here):
    (folder / "list.csv").write_text("scene,id,agent.radius\nroom.xml,a,0.1\nroom.xml,b,0.2\n")
    made = ("--make", "episodes:point:uniform:3")
    status, out, err = run("batch", "list.csv", "-o", "out", *COARSE, *made)
    assert status == 1 and out.startswith("2 baked, ")
    before, after = err.splitlines()  # the bakes may take hours
    sizes = "agents differ in size (0.1 x 1.14 m in 'a' and 0.2 x 1.14 m in 'b')"
    assert "warning: no common set of episodes will be written, as " + sizes in before
    assert "stopped: no common set of episodes was written, as " + sizes in after
    status, out, err = run("batch", "list.csv", "-o", "out", *COARSE, *made, "--plan")
    assert status == 0 and sizes in err
    one_size = ("--set", "agent.radius=0.1")
    assert run("batch", "list.csv", "-o", "2", *COARSE, *made, "--plan", *one_size)[2] == ""


def test_scenes_that_slices_baked_are_merged(folder, run, here):
    (folder / "list.csv").write_text("scene,id\nroom.xml,a\nroom.xml,b\n")
    for slice_text in ("1/2", "2/2"):
        arguments = ("list.csv", "-o", "out", *COARSE, "--slice", slice_text, "-q")
        assert run("batch", *arguments)[0] == 0
    status, out, _ = run("batch", "list.csv", "-o", "out", *COARSE, "--merge")
    assert status == 0 and out.startswith("2 merged")


def test_products_that_a_run_removes_are_named(folder, run, here):
    made = ("--make", "nav2", "--make", "inflated:0.2")
    assert run("batch", "room.xml", "-o", "out", *COARSE, *made, "-q")[0] == 0
    status, out, _ = run("batch", "room.xml", "-o", "out", *COARSE, "--plan")
    assert status == 0 and "products: 1 scene" in out
    assert "room (removes inflated:0.2 nav2)" in out
    status, out, _ = run("batch", "room.xml", "-o", "out", *COARSE)
    assert status == 0 and out.startswith("1 baked")
    removed = "removed, as no --make asks for them: inflated-0.2.json.gz, nav2.pgm, nav2.yaml"
    assert f"{removed} of 1 scene" in out
    assert "removed" not in run("batch", "room.xml", "-o", "out", *COARSE)[1]


def test_lists_and_patterns_that_name_no_scene_say_what_does(folder, run, here):
    (folder / "deep" / "er").mkdir(parents=True)
    (folder / "room.xml").rename(folder / "deep" / "er" / "room.xml")
    for source in ("deep", "deep/*.xml"):
        status, _, err = run("batch", source, "-o", "out")
        assert status == 1 and "'deep/**/*.xml'" in err.replace("\\", "/")
    (folder / "list.csv").write_text("scene,id,split\ndeep/er/room.xml,a,train\n")
    status, _, err = run("batch", "list.csv", "-o", "out", *COARSE)
    assert status == 1 and "got `split`" in err and "`--column scene=scene --column id=id`" in err
    columns = ("--column", "scene=scene", "--column", "id=id")
    assert run("batch", "list.csv", "-o", "out", *COARSE, *columns, "-q")[0] == 0


def test_lines_of_json_tell_of_each_scene(folder, run, here):
    (folder / "bad.xml").write_text("<mujoco>")
    status, out, err = run("batch", "room.xml", "room.yaml", "-o", "out", *COARSE)
    assert (status, out) == (1, "") and "unique ids" in err
    status, out, err = run("batch", "*.xml", "-o", "out", "--json", *COARSE)
    assert (status, err) == (1, "")
    begin, bad, room, end = map(json.loads, out.splitlines())
    del begin["time"], end["time"], end["seconds"]
    told = {"level": "info", "event": "begin", "scenes": 2, "skipped": 0}
    assert begin == told | {"version": navbake.__version__}
    assert (bad["event"], bad["status"], bad["how"]) == ("scene", "failed", "error")
    assert room["id"] == "room" and room["status"] == "ok" and room["seconds"] > 0
    assert "inputs" not in room  # which may be long
    counts = {"baked": 1, "skipped": 0, "failed": 1, "left": 0}
    assert end == {"level": "error", "event": "end", **counts, "stopped": None}


def test_lines_of_json_need_no_stdout(folder, run, here, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("sys.stdout", None)  # as Python has it after `>&-`
        status, _, _ = run("batch", "room.xml", "-o", "out", "--json", *COARSE)
    assert status == 0
    (row,) = map(json.loads, Path("out/index.jsonl").read_text().splitlines())
    assert row["status"] == "ok"


def test_a_log_has_the_lines_that_json_prints(folder, run, here):
    (folder / "bad.xml").write_text("<mujoco>")
    _, out, _ = run("batch", "*.xml", "-o", "out", "--json", "--log", "logs/batch.jsonl", *COARSE)
    log = folder / "logs" / "batch.jsonl"
    assert log.read_text() == out
    run("batch", "room.xml", "-o", "out", "--log", log, *COARSE)
    again = json.loads(log.read_text().splitlines()[-1])
    assert log.read_text().startswith(out) and again["event"] == "end" and again["skipped"] == 1
    status, out, err = run("batch", "room.xml", "-o", "out", "--log", "room.xml/log", *COARSE)
    assert (status, out) == (1, "") and "cannot write room.xml" in err


def test_a_batch_that_cannot_go_on_says_so_in_its_log_and_page(folder, run, monkeypatch):
    def fail():
        raise NavbakeError("cannot start a worker process: no memory")

    stay_in_process(monkeypatch, after=fail)
    shutil.copy("room.xml", "second.xml")
    options = ("-o", "out", "--log", "log.jsonl", "--page", *COARSE)
    assert run("batch", "room.xml", "second.xml", *options)[0] == 1
    end = json.loads((folder / "log.jsonl").read_text().splitlines()[-1])
    assert (end["baked"], end["left"], end["level"]) == (1, 1, "error")
    assert end["stopped"] == "cannot start a worker process: no memory"
    made = content_of_batch("out/index.html")["scenes"]
    assert [scene["status"] for scene in made] == ["ok", "left"]


def test_a_page_is_written_as_the_batch_ends_and_from_its_folder(folder, run, here, monkeypatch):
    (folder / "bad.xml").write_text("<mujoco>")
    status, out, _ = run("batch", "*.xml", "-o", "out", "--page", *COARSE)
    files = f": {Path('out/index.jsonl')}, {Path('out/index.html')}"
    assert status == 1 and out.splitlines()[0].endswith(files)
    made = content_of_batch("out/index.html")
    made = [(scene["id"], scene["thumbnail"]) for scene in made["scenes"]]
    assert made == [("bad", False), ("room", True)]
    thumbnail = Path("out/room/thumbnail.png")
    drawn = thumbnail.read_bytes()
    # it is none of the products: a batch without pages takes the scene for done
    assert run("batch", "room.xml", "-o", "out", *COARSE)[1].startswith("1 skipped")
    thumbnail.unlink()
    assert run("batch", "room.xml", "-o", "out", "--page", *COARSE)[1].startswith("1 skipped")
    assert thumbnail.read_bytes() == drawn
    thumbnail.unlink()
    assert run("report", "out", "-o", "elsewhere.html") == (0, "elsewhere.html\n", "")
    assert thumbnail.read_bytes() == drawn
    assert content_of_batch("elsewhere.html")["base"] == "out"
    # baked again without a page, the old thumbnail is gone
    run("batch", "room.xml", "-o", "out", "--set", "grid.cell_size=0.2")
    assert not thumbnail.exists()


def test_sizes_have_options_of_their_own(folder, run, monkeypatch):
    stay_in_process(monkeypatch)
    run("batch", "room.xml", "-o", "out", "--cell-size", "0.2", "--radius", "0.3")
    (path,) = (folder / "out").rglob("grid.json*")
    grid = navbake.load(path)
    assert (grid.levels[0].cell_size, grid.agent_radius) == (0.2, 0.3)


def test_a_page_is_written_while_the_batch_goes_on(folder, run, monkeypatch):
    shutil.copy("room.xml", "second.xml")
    seen = []

    def look():
        made = content_of_batch("out/index.html")
        seen.append((made["progress"], [s["id"] for s in made["scenes"]]))

    stay_in_process(monkeypatch, after=look)
    monkeypatch.setattr("navbake.batch.page.MIN_WRITE_INTERVAL", 0.0)
    monkeypatch.setattr("navbake.batch.page.MAX_WRITE_SHARE", 1e9)
    run("batch", "room.xml", "second.xml", "-o", "out", "--page", *COARSE)
    assert seen == [([1, 2], ["room"]), ([2, 2], ["room", "second"])]
    assert content_of_batch("out/index.html")["progress"] is None


def test_settings_and_products_reach_the_scenes(folder, run, here):
    (folder / "all.yaml").write_text("grid: {cell_size: 0.25}\n")
    given = ("--config", "all.yaml", "--make", "inflated:0.3", "--set", "agent.radius=0.1")
    assert run("batch", "room.xml", "-o", "out", *given)[0] == 0
    grid = read_navgrid(Path("out/room/grid.json.gz"))
    assert grid.cell_size == 0.25 and grid.agent_radius == 0.1
    assert Path("out/room/inflated-0.3.json.gz").is_file()


def test_a_cluster_is_asked_for_by_name(folder, run, monkeypatch):
    assert run("batch", "room.xml", "-o", "out", "--ray-address", "a:1")[0] == 2
    assert run("batch", "room.xml", "-o", "out", "--executor", "slurm")[0] == 2
    monkeypatch.setitem(sys.modules, "ray", None)
    status, _, err = run("batch", "room.xml", "-o", "out", "--executor", "ray", *COARSE)
    assert status == 1 and 'pip install "navbake[ray]"' in err and err.count("\n") == 1


def test_what_is_cold_is_compiled_once_before_workers_start(folder, run, here, monkeypatch):
    compiled = []
    monkeypatch.setattr("navbake.compiled.ensure_compiled", lambda: compiled.append(1))
    run("batch", "room.xml", "-o", "out", *COARSE)
    assert compiled == [1]
    run("batch", "room.xml", "-o", "out", *COARSE)
    assert compiled == [1]  # there was nothing to bake
    monkeypatch.setattr("navbake.compiled.cache_folder", lambda: None)
    assert "each worker compiles its own" in run("batch", "room.xml", "-o", "third", *COARSE)[2]


@linux
def test_on_a_terminal_a_line_tells_how_far_it_is(folder):
    import pty

    reading, writing = pty.openpty()
    arguments = ["batch", "room.xml", "-o", "out", *COARSE]
    with start(*arguments, stdout=subprocess.PIPE, stderr=writing) as process:
        os.close(writing)
        seen = b""
        with contextlib.suppress(OSError):
            while chunk := os.read(reading, 4096):
                seen += chunk
        assert process.stdout is not None
        assert process.stdout.read().startswith(b"1 baked, ")
    os.close(reading)
    assert b"0/1" in seen and b"0 failed" in seen


# ---------------------------------------------------------------- ended from outside


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """A folder with scenes and their list, and what an undisturbed batch makes of them."""
    folder = tmp_path_factory.mktemp("scenes")
    write_scenes(folder / "scenes", COUNT)
    with pytest.MonkeyPatch.context() as patch:
        stay_in_process(patch)  # what workers make is held against what this process makes
        sources = str(folder / "scenes" / "list.jsonl")
        options = {"settings": {}, "overrides": OVERRIDES, "out": folder / "whole"}
        _, result = run_sources(sources, **options)
    assert result.count("ok") == COUNT
    return folder, digests(folder / "whole")


@linux
@pytest.mark.parametrize(
    ("number", "whole_group", "status"),
    [(signal.SIGINT, True, 130), (signal.SIGTERM, True, 143), (signal.SIGTERM, False, 143)],
)
def test_a_signal_ends_workers_and_leaves_a_true_index(
    scenes, tmp_path, number, whole_group, status
):
    folder, expected = scenes
    options = ("scenes/list.jsonl", "-o", tmp_path, "--jobs", "2", *COARSE)
    with start("batch", *options, cwd=folder, stdout=-1, stderr=-1) as process:
        wait_for_grids(tmp_path)
        os.killpg(process.pid, number) if whole_group else process.send_signal(number)
        _, err = process.communicate(timeout=PATIENCE)
        assert process.returncode in (0, status)
        assert b"Traceback" not in err
    wait_until_gone(process.pid)  # what cleans up after multiprocessing hears late
    assert not [path for path in tmp_path.rglob("*") if TEMPORARY_NAME.fullmatch(path.name)]
    rows = [json.loads(line) for line in (tmp_path / "index.jsonl").read_text().splitlines()]
    listed = (folder / "scenes" / "list.jsonl").read_text().splitlines()
    assert [f"{row['id']}.xml" for row in rows] == [json.loads(line)["scene"] for line in listed]
    assert {row["status"] for row in rows} <= {"ok", "left"}
    made = digests(tmp_path)
    for row in rows:
        name = f"{row['id']}/grid.json.gz"
        assert row["status"] == "left" or made[name] == expected[name]


@linux
def test_killed_at_random_and_started_again_it_makes_the_same(scenes, tmp_path):
    folder, expected = scenes
    out, random_ = tmp_path / "out", random.Random(0)
    options = ("batch", "scenes/list.jsonl", "-o", out, "--jobs", "2", "-q", *COARSE)

    def kill_after(count):
        """Kill a batch when it has so many grids; False if it has ended before."""
        with start(*options, cwd=folder) as process:
            wait_for_grids(out, count)
            time.sleep(random_.uniform(0.0, 0.05))
            is_running = process.poll() is None
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        return is_running

    with Watcher(out, expected) as watcher:
        for count in (1, 6):
            for _ in range(20):
                if kill_after(count):
                    break
                shutil.rmtree(out)  # too late, once more
            else:
                pytest.fail("each batch had ended before it was killed")
        with start(*options, "--jobs", "1", cwd=folder) as process:  # any number goes on
            assert process.wait(PATIENCE) == 0
    assert watcher.looks and not watcher.torn
    assert digests(out) == expected
    rows = map(json.loads, (out / "index.jsonl").read_text().splitlines())
    assert {row["status"] for row in rows} == {"ok"}


def test_a_full_disk_ends_the_batch_with_one_line(folder, run, here, monkeypatch):
    def refuse(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    shutil.copy("room.xml", "second.xml")
    with monkeypatch.context() as patch:
        patch.setattr(files, "create_temporary", refuse)
        status, out, err = run("batch", "room.xml", "second.xml", "-o", "out", *COARSE)
    why = "No space left on device: free space and run the same command again"
    assert status == 1 and out.startswith("2 left in ")
    assert err == f"navbake: stopped: cannot write into {Path('out/room')}: {why}\n"
    assert run("batch", "room.xml", "second.xml", "-o", "out", *COARSE)[0] == 0


NO_ROOM = "No space left on device: free space and run the same command again"


def refuse_room(*arguments, **options):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_disk_that_is_full_before_the_batch_begins(folder, run, here, monkeypatch):
    options = ("batch", "room.xml", "-o", "out", *COARSE)
    with monkeypatch.context() as patch:
        patch.setattr(index.os, "open", refuse_room)
        assert run(*options) == (1, "", f"navbake: cannot write into out: {NO_ROOM}\n")
    assert run(*options)[0] == 0
    with monkeypatch.context() as patch:  # no file can be made, and no line be added
        patch.setattr(store, "write_whole", refuse_room)
        status, out, err = run(*options)
        assert (status, err) == (1, f"navbake: stopped: cannot write into out: {NO_ROOM}\n")
        assert out.startswith("1 skipped")


def test_a_batch_without_a_table_removes_that_of_another(folder, run, here):
    pytest.importorskip("pyarrow")
    assert run("batch", "room.xml", "-o", "out", "--parquet", *COARSE)[0] == 0
    assert Path("out/index.parquet").exists()
    assert run("batch", "room.xml", "-o", "out", *COARSE)[0] == 0
    assert not Path("out/index.parquet").exists()


def test_no_folder_for_temporary_files_ends_the_batch_with_one_line(folder, run, monkeypatch):
    def refuse():
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']")

    with monkeypatch.context() as patch:
        patch.setattr("tempfile.gettempdir", refuse)
        patch.setattr("navbake.compiled.ensure_compiled", lambda *rooms: None)
        status, out, err = run("batch", "room.xml", "-o", "out", *COARSE)
    assert (status, out) == (1, "") and err == (
        "navbake: cannot write temporary files: No usable temporary directory found in ['/tmp']: "
        "free space, or set TMPDIR to a folder that has room\n"
    )
    (row,) = map(json.loads, Path("out/index.jsonl").read_text().splitlines())
    assert row["status"] == "left"


@pytest.mark.parametrize("lines", [0, 2])
def test_a_log_without_room_does_not_hide_what_the_batch_came_to(
    folder, run, here, monkeypatch, lines
):
    count = iter(range(lines))

    def write(file, data):
        if next(count, None) is None:
            refuse_room()

    options = ("batch", "room.xml", "-o", "out", "--log", "log.jsonl", *COARSE)
    with monkeypatch.context() as patch:
        patch.setattr(index, "write_all", write)
        status, out, err = run(*options)
    assert (status, err) == (1, f"navbake: stopped: cannot write the log log.jsonl: {NO_ROOM}\n")
    assert out.startswith("1 baked" if lines else "1 left in ")
    count = iter(())
    with monkeypatch.context() as patch:
        patch.setattr(index, "write_all", write)
        status, out, err = run(*options, "--json", "--set", "grid.cell_size=0.2")
    assert (status, err) == (1, f"navbake: cannot write the log log.jsonl: {NO_ROOM}\n")
    assert json.loads(out.splitlines()[-1])["event"] == "end"


def test_thumbnails_without_room_are_no_fault_of_the_grids(folder, run, here, monkeypatch):
    options = ("batch", "room.xml", "-o", "out", "--page", *COARSE)
    assert run(*options)[0] == 0
    Path("out/room/thumbnail.png").unlink()
    real = files.create_temporary

    def create(folder):
        return real(folder) if folder.name != "room" else refuse_room()

    with monkeypatch.context() as patch:
        patch.setattr(files, "create_temporary", create)
        status, _, err = run(*options)
    assert status == 0 and err == f"navbake: warning: cannot write thumbnails into out: {NO_ROOM}\n"
    Path("out/room/grid.json.gz").write_bytes(b"")
    lacking = "1 thumbnails can't be made of their grids"
    assert run("report", "out")[2] == f"navbake: warning: {lacking}\n"
