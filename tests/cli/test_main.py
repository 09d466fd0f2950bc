"""The command line: help, exit status, what goes to stdout and what to stderr."""

from __future__ import annotations

import json
import logging
import os
import re
import shlex
import subprocess
import sys
from typing import Annotated, Any

import pytest
import typer

import navbake
from navbake import compiled
from navbake.cli.main import COMMANDS, app, main
from navbake.cli.options import check_output, prepare_command
from navbake.cli.printing import VERBOSITY
from navbake.errors import ConfigError
from project_paths import GOLDEN

HOUSE = str(GOLDEN / "house.grid.json.gz")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no full device here")
@pytest.mark.parametrize("arguments", [["--help"], ["geoms", "room.yaml"]])
def test_a_full_stdout_is_one_line(folder, arguments):
    command = [sys.executable, "-m", "navbake", *arguments]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "navbake: cannot write to stdout: No space left on device\n"


def test_bugs_keep_their_traceback(folder, monkeypatch):
    import navbake.baker.bake.pipeline

    def fail(*args, **kwargs):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(navbake.baker.bake.pipeline, "run_bake", fail)
    with pytest.raises(ZeroDivisionError, match="a bug"):
        main(["bake", "room.yaml"])


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
        (
            [
                "bake",
                "room.yaml",
                "--radius",
                "0.3",
                "--cell-size",
                "0.2",
                "--no-timings",
                "-o",
                "-",
            ],
            [
                *("bake", "room.yaml", "--no-timings", "-o", "-"),
                *("--set", "agent.radius=0.3", "--set", "grid.cell_size=0.2"),
            ],
        ),
        (["geoms", "apartment"], ["geoms", str(navbake.samples.path("apartment"))]),
    ],
)
def test_first_guesses_work(folder, run, guess, meant):
    assert run(*guess)[:2] == run(*meant)[:2]  # a kernel may be compiled
    assert run(*guess)[0] == 0


def test_a_path_may_start_in_a_room(folder, run):
    status, out, _ = run("path", HOUSE, "--from", "room:0:1", "--to", "room:0:2", "--json")
    assert status == 0
    rooms = json.loads(out)["path"]["rooms"]
    assert rooms[0] == "0:1"
    assert rooms[-1] == "0:2"


def test_help_lists_the_commands_in_groups(run):
    _, out, _ = run("--help")
    groups = re.findall(r"^(\w+):\n((?:  .+\n)+)", out, flags=re.MULTILINE)
    named = {title: re.findall(r"^  (\S+)", text, flags=re.MULTILINE) for title, text in groups}
    assert list(named) == ["Options", *COMMANDS]
    assert named["Ask"] == ["info", "rooms", "why", "path", "sample", "stand", "fly"]
    assert "map-descriptor" in named["Exchange"] and "mdf" not in out and "extrude" not in out


def test_version_and_help(run):
    assert run("--version") == (0, f"navbake {navbake.__version__}\n", "")
    status, out, _ = run("--help")
    assert status == 0
    assert all(command in out for command in ("bake", "init", "geoms", "info", "plot"))


def test_runs_as_a_module(tmp_path):
    path = tmp_path / "none.yaml"
    command = [sys.executable, "-m", "navbake", "bake", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, f"navbake: no such file: {path}\n")


HELPED: Any = typer.main.get_command(app)
EXAMPLE = re.compile(r"^Example: navbake (.+)$", re.MULTILINE)


@pytest.mark.parametrize("name", sorted(HELPED.commands))
def test_help_has_an_example_that_parses(name):
    command = HELPED.commands[name]
    [example] = EXAMPLE.findall(command.help)
    words = shlex.split(example)
    assert words[0] == name
    command.make_context(name, words[1:])


@pytest.mark.parametrize("name", sorted(HELPED.commands))
def test_help_is_printed_with_the_example_on_a_line_of_its_own(name, run):
    status, out, _ = run(name, "--help")
    assert status == 0
    assert re.search(rf"\n\n  Example: navbake {re.escape(name)}\b", out)


@pytest.mark.parametrize("name", sorted(HELPED.commands))
def test_help_says_what_values_are_and_no_types_of_python(name, run):
    _, out, _ = run(name, "--help")
    assert {*re.findall(r"<[^<>]*>", out)} <= {"<id>"}
    unnamed = [p.name for p in HELPED.commands[name].params if not (p.metavar or is_flag(p))]
    assert not unnamed


def is_flag(parameter):
    return getattr(parameter, "is_flag", False)


@pytest.mark.parametrize("name", sorted(HELPED.commands))
def test_help_lists_the_output_first(name, run):
    _, out, _ = run(name, "--help")
    if "--output" in out:
        assert re.search(r"\nOptions:\n +-o, --output ", out)


def test_a_prepared_command_takes_quiet_and_verbose_too(capsys):
    app = typer.Typer(rich_markup_mode=None)
    got = []

    @app.command()
    @prepare_command
    def draw(
        name: Annotated[str, typer.Argument(help="What.")],
        width: Annotated[int, typer.Option(help="Columns.")] = 3,
        fast: Annotated[bool, typer.Option("--fast")] = False,
    ) -> None:
        """Draw."""
        got.append((name, width, fast, VERBOSITY.quiet))

    app(["box", "--width", "4", "--fast"], standalone_mode=False)
    app(["box", "-q"], standalone_mode=False)
    assert got == [("box", 4, True, False), ("box", 3, False, True)]
    app(["--help"], standalone_mode=False)
    out = capsys.readouterr().out
    assert all(text in out for text in ("Draw.", "--width", "Columns.", "What.", "--verbose"))


def test_a_missing_folder_may_be_made_if_asked_for(tmp_path):
    path = tmp_path / "new" / "deep" / "a.png"
    with pytest.raises(ConfigError, match=r"cannot write .*a\.png"):
        check_output(path)
    check_output(path, ".png", may_make_folder=True)
    assert list(tmp_path.iterdir()) == []


def run_warm_up(*arguments: str) -> int:
    with pytest.raises(SystemExit) as done:
        main(["warm-up", *arguments])
    return int(done.value.code or 0)


def test_warm_up_says_what_has_no_code_on_disk(monkeypatch, capsys):
    monkeypatch.setattr(compiled, "warm_up", lambda: [])
    assert run_warm_up() == 0
    assert capsys.readouterr().out.startswith("compiled")
    monkeypatch.setattr(compiled, "warm_up", lambda: ["runtime.kernels.a.b"])
    assert (
        run_warm_up() == 0
        and "not compiled, or not kept: runtime.kernels.a.b" in capsys.readouterr().err
    )


def test_says_where_nothing_can_be_kept(monkeypatch, capsys):
    monkeypatch.setattr(compiled, "cache_folder", lambda: None)
    assert run_warm_up() == 0
    out, err = capsys.readouterr()
    assert out == "" and "nothing can be kept: set NUMBA_CACHE_DIR" in err


def test_commands_print_what_is_logged(monkeypatch, capsys):
    """A slow start is announced on stderr, whether it is a terminal or a pipe."""

    def warm_up() -> list[str]:
        logging.getLogger("navbake.compiled").warning("compiling")
        return []

    monkeypatch.setattr(compiled, "warm_up", warm_up)
    run_warm_up()
    assert "navbake: compiling\n" in capsys.readouterr().err
