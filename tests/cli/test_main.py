"""The command line: exit status, what goes to stdout and what to stderr."""

import os
import subprocess
import sys

import pytest

import navbake
from navbake.cli.main import main


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
