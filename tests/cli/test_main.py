"""The command line: exit status, what goes to stdout and what to stderr."""

import os
import re
import subprocess
import sys

import pytest

import navbake
from navbake.cli.main import COMMANDS, main
from project_paths import GOLDEN

HOUSE = str(GOLDEN / "house.grid.json.gz")


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
def test_wrong_usage(folder, run, names, arguments):
    status, _, err = run(*arguments)
    assert status == 2
    assert err
    assert names(folder) == ["room.xml", "room.yaml"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no full device here")
@pytest.mark.parametrize("arguments", [["--help"], ["geoms", "room.yaml"]])
def test_a_full_stdout_is_one_line(folder, arguments):
    command = [sys.executable, "-m", "navbake", *arguments]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "navbake: cannot write to stdout: No space left on device\n"


def test_bugs_keep_their_traceback(folder, monkeypatch):
    import navbake.baker.pipeline

    def fail(*args, **kwargs):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(navbake.baker.pipeline, "run_bake", fail)
    with pytest.raises(ZeroDivisionError, match="a bug"):
        main(["bake", "room.yaml"])


@pytest.mark.parametrize(
    ("arguments", "answer"),
    [
        (["export", "a.grid.json", "a.yaml"], "No such command 'export': write `navbake convert"),
        (["extrude", "map.yaml", "-o", "a.xml"], "write `navbake convert MAP scene.xml`"),
        (["bake", "x.grid.json"], "x.grid.json is a grid, not a scene: `navbake info x.grid.json`"),
        (["geoms", "x.json.gz"], "x.json.gz is a grid, not a scene"),
        (["init", "x.grid.json"], "is a grid, not a scene"),
        (["voxelize", "x.grid.json", "-o", "a.npz"], "is a grid, not a scene"),
        (["why", HOUSE], "expected one place"),
        (["why", HOUSE, "1,1", "--at", "1,1"], "expected one place"),
        (["inflate", HOUSE, "-o", "a.json"], "expected one radius"),
    ],
)
def test_first_guesses_are_answered(folder, run, arguments, answer):
    status, out, err = run(*arguments)
    assert (status, out) == (2, "") and answer in " ".join(err.replace("│", " ").split())


@pytest.mark.parametrize(
    ("guess", "meant"),
    [
        (["why", HOUSE, "-4.95,0"], ["why", HOUSE, "--at", "-4.95,0"]),
        (["why", "--json", HOUSE, "1,1,L1"], ["why", HOUSE, "--at", "1,1,L1", "--json"]),
        (
            ["path", HOUSE, "--start", "1,1,L0", "--goal", "-3,1,L0"],
            ["path", HOUSE, "--from", "1,1,L0", "--to", "-3,1,L0"],
        ),
        (
            ["inflate", HOUSE, "0.3", "-o", "a.json"],
            ["inflate", HOUSE, "--radius", "0.3", "-o", "a.json"],
        ),
        (["mdf", HOUSE], ["map-descriptor", HOUSE]),
    ],
)
def test_first_guesses_work(folder, run, guess, meant):
    assert run(*guess)[:2] == run(*meant)[:2]  # a kernel may be compiled
    assert run(*guess)[0] == 0


def test_help_lists_the_commands_in_groups(run):
    _, out, _ = run("--help")
    groups = re.findall(r"^(\w+):\n((?:  .+\n)+)", out, flags=re.MULTILINE)
    named = {title: re.findall(r"^  (\S+)", text, flags=re.MULTILINE) for title, text in groups}
    assert list(named) == ["Options", *COMMANDS]
    assert named["Ask"] == ["info", "rooms", "why", "path"]
    assert "map-descriptor" in named["Exchange"] and "mdf" not in out and "extrude" not in out


def test_version_and_help(run):
    assert run("--version") == (0, f"navbake {navbake.__version__}\n", "")
    status, out, _ = run("--help")
    assert status == 0
    assert all(command in out for command in ("bake", "init", "geoms", "info", "plot"))


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
def test_errors_of_the_others(folder, run, names, arguments, culprit):
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
