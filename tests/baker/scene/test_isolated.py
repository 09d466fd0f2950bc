"""MuJoCo compiles in a child process: the same model, and its crashes are errors."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import navbake
from navbake.baker.scene import model
from navbake.baker.scene.model import CompileLimits, load_isolated, load_model
from navbake.cli.main import main
from navbake.config.settings import SceneSettings
from navbake.errors import ConfigError, NavbakeError, SceneError
from project_paths import CONFIGS, ROOT

ROOM = """<mujoco><worldbody>
  <geom name="floor" type="box" size="2 2 .1" pos="0 0 -.1"/>
  <geom name="wall" type="box" size=".1 2 1" pos="1 0 1"/>
</worldbody></mujoco>"""


@pytest.fixture
def room(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.xml").write_text(ROOM)
    return tmp_path / "room.xml"


@pytest.mark.parametrize("name", ["house.xml", "clutter.obj"])
def test_the_model_is_the_same(name):
    settings = SceneSettings(path=CONFIGS / "scenes" / name, ground=-1.0)
    isolated, parts, ground = load_isolated(settings, CompileLimits(), [])[:3]
    expected, expected_parts, expected_ground = load_model(settings, [])[:3]
    assert ground == expected_ground
    assert list(parts) == list(expected_parts)
    assert isolated.names == expected.names
    for array in ("geom_pos", "geom_size", "mesh_vert", "mesh_graph", "body_inertia"):
        np.testing.assert_array_equal(getattr(isolated, array), getattr(expected, array))


def test_errors_are_those_of_this_process(room):
    room.write_text("<mujoco><worldbody><geom/></worldbody></mujoco>")
    for settings in (SceneSettings(path=room), SceneSettings(path="none.xml")):
        messages = []
        for load in (load_model, lambda s, w: load_isolated(s, CompileLimits(), w)):
            with pytest.raises(SceneError) as caught:
                load(settings, [])
            messages.append(str(caught.value))
        assert messages[0] == messages[1]
    (room.parent / "a.mjb").write_bytes(b"")
    with pytest.raises(ConfigError, match="can't be added to an MJB"):
        load_isolated(SceneSettings(path="a.mjb", ground=0.0), CompileLimits(), [])


def crash(monkeypatch, code):
    """Let the child run some code in place of MuJoCo's compiler, with its limits."""
    begin = "from navbake.baker.scene import model\n"
    hook = f"def load(*_):\n    {code}\nmodel.load_model = load\n"
    run = "model.compile_job(sys.argv[1])"
    child = f"import sys; sys.path[:] = {{path!r}}\n{begin}{hook}{run}"
    monkeypatch.setattr(model, "CHILD_CODE", child)


@pytest.mark.skipif(os.name != "posix", reason="a signal ends a process on POSIX")
def test_a_crash_is_one_line_and_status_1(room, monkeypatch, capsys):
    crash(monkeypatch, "import ctypes; ctypes.string_at(0)")
    with pytest.raises(SystemExit) as caught:
        main(["bake", "room.xml", "--isolate"])
    assert caught.value.code == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    assert err.startswith("navbake: MuJoCo crashed as it compiled room.xml (SIGSEGV)")


def test_what_does_not_end_is_ended(room, monkeypatch):
    crash(monkeypatch, "import time; time.sleep(600)")
    with pytest.raises(SceneError, match=r"did not compile .*room\.xml within 0\.2 s"):
        load_isolated(SceneSettings(path=room), CompileLimits(seconds=0.2), [])


@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited on Linux")
def test_memory_is_limited(room, monkeypatch):
    crash(monkeypatch, "return bytearray(1 << 30)")
    with pytest.raises(SceneError, match=r"needs more than 0\.5 GiB of memory"):
        load_isolated(SceneSettings(path=room), CompileLimits(memory=0.5), [])


@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited on Linux")
@pytest.mark.parametrize(
    "content",
    [
        "<asset><hfield name='h' nrow='6000' ncol='6000' size='3 3 1 1'/></asset>"
        "<worldbody><geom type='hfield' hfield='h'/></worldbody>",
        "<size memory='2G'/><worldbody><geom size='1'/></worldbody>",
    ],
    ids=["unknown exception", "could not allocate"],
)
def test_what_mujoco_says_where_memory_is_short_is_one_line_of_the_limit(room, content):
    room.write_text(f"<mujoco>{content}</mujoco>")
    with pytest.raises(SceneError, match=r"^\S*room\.xml needs more than 0\.06 GiB of memory$"):
        load_isolated(SceneSettings(path=room), CompileLimits(memory=0.06), [])


@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited on Linux")
@pytest.mark.parametrize(
    ("asset", "world"),
    [
        (
            '<texture name="t" type="2d" builtin="flat" width="18000" height="18000"/>',
            "<geom size='1'/>",
        ),
        ("", '<replicate count="90000" offset="1 0 0"><geom size=".1"/></replicate>'),
    ],
    ids=["texture", "replicate"],
)
def test_what_is_just_allowed_stays_within_limits(room, asset, world):
    room.write_text(f"<mujoco><asset>{asset}</asset><worldbody>{world}</worldbody></mujoco>")
    with pytest.raises(SceneError, match=r"within 1 s|GiB|allocate"):
        load_isolated(SceneSettings(path=room), CompileLimits(seconds=1.0, memory=0.5), [])


def test_isolated_or_not_the_grid_is_the_same(room):
    main_grid = navbake.bake("room.xml")
    child_grid = navbake.bake("room.xml", isolate=True)
    for grid, name in ((main_grid, "a.json"), (child_grid, "b.json")):
        grid.timings = {}
        grid.save(name)
    assert Path("a.json").read_bytes() == Path("b.json").read_bytes()


def test_limits_without_isolate_are_refused(room, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["bake", "room.xml", "--isolate-seconds", "3"])
    assert caught.value.code == 2
    assert "it is for --isolate" in capsys.readouterr().err


def test_the_current_folder_is_not_searched_for_modules(room, monkeypatch):
    for name in ("json", "ctypes", "numpy"):
        (room.parent / f"{name}.py").write_text("open('was_run', 'w')")
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    load_isolated(SceneSettings(path=room), CompileLimits(), [])
    assert not (room.parent / "was_run").exists()


def test_a_child_that_cannot_start_is_not_the_scenes_fault(room, monkeypatch):
    monkeypatch.setattr(model, "CHILD_CODE", "import sys; {path!r}; sys.exit(3)")
    with pytest.raises(NavbakeError, match=r"cannot start a process .* \(exit status 3\)"):
        load_isolated(SceneSettings(path=room), CompileLimits(), [])


@pytest.mark.skipif(sys.platform != "linux", reason="Linux ends a child with its parent")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_the_child_ends_with_its_parent(room, number):
    """Also where the parent can do nothing about it; its files go where it can."""
    busy = "<mujoco><worldbody><replicate count='60000'><geom size='1'/></replicate>"
    room.write_text(f"{busy}</worldbody></mujoco>")
    (room.parent / "temporary").mkdir()
    env = {**os.environ, "TMPDIR": str(room.parent / "temporary")}
    command = [sys.executable, "-m", "navbake", "bake", "room.xml", "--isolate", "-o", "o.json"]
    env["PYTHONPATH"] = os.pathsep.join([str(ROOT), env.get("PYTHONPATH", "")])
    with subprocess.Popen(command, env=env, cwd=room.parent) as parent:
        while not (started := list(room.parent.glob("temporary/*/started"))):
            assert parent.poll() is None
            time.sleep(0.05)
        children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()
        parent.send_signal(number)
        parent.wait(60)
    end = time.monotonic() + 60
    while any(is_running(child) for child in children):
        assert time.monotonic() < end
        time.sleep(0.05)
    assert children
    assert started[0].exists() == (number == signal.SIGKILL)


def is_running(process: str) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
