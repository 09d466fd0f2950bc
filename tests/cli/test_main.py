"""The command line: exit status, what goes where, what is written and what is not."""

import json
import os
import subprocess
import sys

import pytest

import navbake
from door_scenes import LEAF, ROOMS, world
from navbake.cli.main import main
from navbake.config.settings import load_config

ROOM = """
<mujoco>
  <worldbody>
    <geom name="floor" type="box" size="3 2 .1" pos="0 0 -.1"/>
    <geom name="wall [b]" type="box" size=".1 2 1" pos="1 0 1"/>
    <body name="lamp">
      <geom name="shade" type="sphere" size=".1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with room.xml and room.yaml in it."""
    (tmp_path / "room.xml").write_text(ROOM)
    (tmp_path / "room.yaml").write_text("scene: {path: room.xml}\ngrid: {cell_size: 0.5}\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(capsys):
    """Returns a function that runs a command: its status, stdout and stderr."""

    def call(*arguments):
        with pytest.raises(SystemExit) as caught:
            main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return caught.value.code or 0, out, err

    return call


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


# ---------------------------------------------------------------- bake


def test_bakes_a_yaml(folder, run):
    status, out, err = run("bake", "room.yaml")
    assert (status, err) == (0, "")
    grid = navbake.load("room.grid.json")
    assert (grid.width, grid.height, grid.cell_size) == (12, 8, 0.5)
    lines = out.splitlines()
    assert lines[0] == "room.grid.json"
    assert "level 0" in lines[2]
    assert "12 x 8" in lines[2]
    assert all(stage in lines[-1] for stage in ("scene", "columns", "floors", "occupancy"))


def test_bakes_a_scene_with_settings_on_the_command_line(folder, run):
    arguments = ("--set", "grid.cell_size=1", "--set", "scene.id=hall", "--threads", "1")
    status, _, _ = run("bake", "room.xml", *arguments)
    assert status == 0
    grid = navbake.load("hall.grid.json")
    assert (grid.scene_id, grid.cell_size) == ("hall", 1.0)


def test_output_of_the_settings_and_of_the_command_line(folder, run):
    (folder / "grids").mkdir()
    assert run("bake", "room.yaml", "--set", "output=grids/a.json")[0] == 0
    assert run("bake", "room.yaml", "--set", "output=grids/c.json", "-o", "grids/b.json")[0] == 0
    assert run("bake", "room.yaml", "-o", "grids")[0] == 0
    assert run("bake", "room.yaml", "-o", "new/deep/")[0] == 0
    assert names(folder) == [
        "grids/a.json",
        "grids/b.json",
        "grids/room.grid.json",
        "new/deep/room.grid.json",
        "room.xml",
        "room.yaml",
    ]


def test_quiet(folder, run):
    assert run("bake", "room.yaml", "--quiet") == (0, "", "")


def test_one_failure_does_not_stop_the_others(folder, run):
    (folder / "bad.yaml").write_text("scene: {path: room.xml}\ngrid: {cell_size: 0}")
    (folder / "last.yaml").write_text("scene: {path: room.xml, id: last}\ngrid: {cell_size: 0.5}")
    status, out, err = run("bake", "room.yaml", "bad.yaml", "last.yaml", "-o", "grids/")
    assert status == 1
    assert err.splitlines() == [
        "navbake: expected a number > 0, got 0 at `grid.cell_size` in bad.yaml",
        "navbake: 1 of 3 failed",
    ]
    assert "grids/room.grid.json" in out
    assert names(folder / "grids") == ["last.grid.json", "room.grid.json"]


def test_several_scenes_do_not_overwrite_each_other(folder, run):
    status, _, err = run("bake", "room.yaml", "room.xml")
    assert status == 1
    assert "room.xml: room.grid.json was written for another scene" in err


def test_several_scenes_need_a_folder(folder, run):
    status, _, err = run("bake", "room.yaml", "room.xml", "-o", "one.json")
    assert status == 2
    assert "expected a folder, got one.json" in err


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        (["none.yaml"], "none.yaml"),
        (["none.xml"], "none.xml"),
        (["room.yaml", "--set", "grid.cell_size=5cm"], "`grid.cell_size`"),
        (["room.yaml", "--set", "grid.cellsize=1"], "`grid.cell_size`"),
        (["room.yaml", "--set", "grid.max_cells=10"], "`grid.max_cells`"),
        (["room.yaml", "--set", "scene.geoms=visual", "-o", "none/a.json"], "none/a.json"),
        (["room.yaml", "-o", "room.yaml"], "got room.yaml"),
        (["room.yaml", "-o", "room.xml"], "got room.xml"),
        (["room.yaml", "-o", "room.xml/"], "room.xml/room.grid.json"),
        (["room.yaml", "--set", "output=."], "cannot write .: it is a folder"),
    ],
)
def test_errors_are_one_line_and_nothing_is_written(folder, run, arguments, culprit):
    status, out, err = run("bake", *arguments)
    assert (status, out) == (1, "")
    assert err.startswith("navbake: ")
    assert err.count("\n") == 1
    assert culprit in err
    assert names(folder) == ["room.xml", "room.yaml"]
    assert (folder / "room.xml").read_text() == ROOM


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_takes_no_files(folder, run):
    (folder / "locked").mkdir(mode=0o500)
    status, _, err = run("bake", "room.yaml", "-o", "locked/a.json")
    assert (status, "Permission denied" in err) == (1, True)


@pytest.mark.parametrize(
    "arguments",
    [
        ["bake"],
        ["bake", "room.yaml", "--threads", "0"],
        ["bake", "room.yaml", "--set", "novalue"],
        ["bake", "room.yaml", "--nonsense"],
        ["nonsense"],
        ["plot", "room.grid.json"],
        ["plot", "room.grid.json", "-o", "room.pdf"],
        ["plot", "room.grid.json", "-o", "room.png", "--layer", "heat"],
    ],
)
def test_wrong_usage(folder, run, arguments):
    status, _, err = run(*arguments)
    assert status == 2
    assert err
    assert names(folder) == ["room.xml", "room.yaml"]


def test_bugs_keep_their_traceback(folder, monkeypatch):
    import navbake.baker.pipeline

    def fail(*args, **kwargs):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(navbake.baker.pipeline, "run_bake", fail)
    with pytest.raises(ZeroDivisionError, match="a bug"):
        main(["bake", "room.yaml"])


# ---------------------------------------------------------------- the others


def test_version_and_help(run):
    assert run("--version") == (0, f"navbake {navbake.__version__}\n", "")
    status, out, _ = run("--help")
    assert status == 0
    assert all(command in out for command in ("bake", "init", "geoms", "info", "plot"))


def test_init_writes_settings_that_bake_the_same(folder, run):
    status, out, _ = run("init", "room.xml", "-o", "made.yaml")
    assert (status, out.startswith("made.yaml")) == (0, True)
    made = load_config("made.yaml")
    assert made.scene.path.samefile("room.xml")
    assert run("init", "room.xml", "-o", "made.yaml")[0] == 1
    assert run("init", "room.xml", "-o", "made.yaml", "--force")[0] == 0
    assert run("init", "room.xml")[0] == 1  # room.yaml is there
    assert run("init", "none.xml")[2] == "navbake: no such file: none.xml\n"


@pytest.mark.parametrize("config", ["room.xml", "room.yaml"])
def test_geoms(folder, run, config):
    status, out, _ = run("geoms", config)
    assert status == 0
    lines = {line.split()[1]: line for line in out.splitlines()[1:-1]}
    assert "wall [b]" in lines["wall"]  # no markup
    assert " yes " in lines["floor"]
    assert " no " in lines["shade"]
    assert out.splitlines()[-1] == "2 geoms counted, 1 left out"


def test_geoms_as_json(folder, run):
    status, out, _ = run("geoms", "room.yaml", "--json", "--set", "scene.geoms=all")
    assert status == 0
    facts = json.loads(out)
    assert facts["scene_id"] == "room"
    assert [geom["name"] for geom in facts["geoms"]] == ["floor", "wall [b]", "shade"]
    assert all(geom["counted"] for geom in facts["geoms"])
    assert set(facts["geoms"][0]) == {"id", "name", "body", "type", "counted", "shape", "reason"}


def test_info_and_plot(folder, run):
    run("bake", "room.yaml", "-q")
    status, out, _ = run("info", "room.grid.json")
    assert status == 0
    digest = navbake.load("room.grid.json").navbake["settingsDigest"]
    assert digest in out  # nothing is cut in a pipe
    assert "12 x 8" in out
    status, out, _ = run("info", "room.grid.json", "--json")
    assert (status, json.loads(out)["scene_id"]) == (0, "room")
    status, out, _ = run("plot", "room.grid.json", "-o", "room.png", "--level", "0")
    assert (status, out) == (0, "room.png\n")
    assert (folder / "room.png").read_bytes().startswith(b"\x89PNG")


def test_rooms_and_their_picture(folder, run):
    run("bake", "room.yaml", "-q")
    status, out, _ = run("rooms", "room.grid.json")
    assert status == 0
    header, *rows, last = out.splitlines()
    assert " ".join(header.split()) == "id name level index m2 centroid x y z m from opens to"
    assert last == f"{len(rows)} room{'' if len(rows) == 1 else 's'}"
    status, out, _ = run("rooms", "room.grid.json", "--json")
    listed = json.loads(out)
    assert listed["scene_id"] == "room"
    assert listed["rooms"] == navbake.load("room.grid.json").navbake["rooms"]
    layers = ("--layer", "rooms", "--layer", "clearance")
    status, out, _ = run("plot", "room.grid.json", "-o", "rooms.png", *layers)
    assert (status, out) == (0, "rooms.png\n")
    assert (folder / "rooms.png").read_bytes().startswith(b"\x89PNG")


def test_doors_are_listed_with_their_states(folder, run):
    box = '<body name="box" pos="1.5 1.5 0.5"><geom type="box" size="0.1 0.1 0.1"/></body>'
    (folder / "doors.xml").write_text(world(ROOMS, LEAF, box))
    run("bake", "doors.xml", "-q", "--set", "doors.state=open", "--set", "doors.patterns=[box]")
    expected = {
        "id": "leaf",
        "joint": "leaf",
        "rooms": ["0:1", "0:2"],
        "levels": [0],
        "state": "open",
        "like": None,
        "states": ["modelled", "open", "closed", "removed"],
    }
    for command in ("info", "rooms"):
        status, out, _ = run(command, "doors.grid.json", "--json")
        assert (status, json.loads(out)["doors"][0]) == (0, expected)
        *_, header, row, other = run(command, "doors.grid.json")[1].splitlines()
        assert header.split() == ["door", "joint", "level", "joins", "is", "can", "be"]
        cells = "leaf leaf level 0 0:1 - 0:2 open modelled, open, closed, removed"
        assert " ".join(row.split()) == cells
        expected_other = "box none level 0 nothing modelled (closed) modelled, closed, removed"
        assert " ".join(other.split()) == expected_other


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        (["info", "none.json"], "none.json"),
        (["rooms", "none.json"], "none.json"),
        (["info", "room.xml"], "room.xml"),
        (["plot", "none.json", "-o", "a.png"], "none.json"),
        (["plot", "room.xml", "-o", "none/a.png"], "none/a.png"),
        (["geoms", "none.xml"], "none.xml"),
        (["geoms", "none.yaml"], "none.yaml"),
    ],
)
def test_errors_of_the_others(folder, run, arguments, culprit):
    status, out, err = run(*arguments)
    assert (status, out) == (1, "")
    assert err.startswith("navbake: ")
    assert err.count("\n") == 1
    assert culprit in err
    assert names(folder) == ["room.xml", "room.yaml"]


def test_runs_as_a_module(tmp_path):
    path = tmp_path / "none.yaml"
    command = [sys.executable, "-m", "navbake", "bake", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, f"navbake: no such file: {path}\n")
