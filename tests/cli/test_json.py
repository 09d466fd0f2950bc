"""`--json` of all commands, and their exit statuses: as docs/command_line.md lists them."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from grid_maps import level_from
from navbake import PathFinder, compiled, load
from navbake.cli.main import COMMANDS
from navbake.cli.printing import print_json
from navbake.episodes import read_episodes
from project_paths import GOLDEN, ROOT

PAGE = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
TABLE, _, INNER_TABLE = PAGE.partition("## JSON")[2].partition("\n## ")[0].partition("\n### ")
NAMES = [function.__name__.replace("_", "-") for group in COMMANDS.values() for function in group]
LINES = {  # command -> its arguments, in a folder with what they name
    "samples": "samples house -o try",
    "init": "init room.xml -o new.yaml",
    "schema": "schema -o schema.json",
    "geoms": "geoms room.yaml",
    "bake": "bake room.yaml -o room.grid.json --radius 0.2",
    "voxelize": "voxelize room.yaml --res 0.5 --segment geom -o room.binvox -o room.npz",
    "info": "info house.json.gz",
    "rooms": "rooms house.json.gz",
    "why": "why house.json.gz 1,1",
    "path": "path house.json.gz --from 0,-4.8,L0 --to room:1:1",
    "sample": "sample house.json.gz -n 2",
    "stand": "stand house.json.gz object:sofa -n 2 -o poses.json",
    "fly": "fly room.yaml --from 0,0,4 --to 1,1,4 --radius 0.2 --margin 3 -o path.json",
    "plot": "plot house.json.gz -o house.png --level 0",
    "report": "report house.json.gz -o house.html",
    "view": "view house.json.gz --port 0 --no-open",
    "convert": "convert house.json.gz map.yaml --level 0",
    "inflate": "inflate house.json.gz 0.3 -o wide.json",
    "routes": "routes house.json.gz -o routes.gml",
    "map-descriptor": "map-descriptor house.json.gz --square 0.2",
    "episodes": "episodes house.json.gz -o set.jsonl --count 3",
    "score": "score set.jsonl runs.jsonl -o scores.csv",
    "verify": "verify room.grid.json --scene room.yaml --sample 20",
    "audit": "audit house.json.gz -o remarks.png",
    "doctor": "doctor --no-bake",
    "warm-up": "warm-up",
}
WRITTEN = {
    "samples": ["try/house.yaml", "try/scenes/house.xml"],
    "init": ["new.yaml"],
    "schema": ["schema.json"],
    "bake": ["room.grid.json"],
    "voxelize": ["room.binvox", "room.binvox.names.json", "room.npz", "room.npz.names.json"],
    "stand": ["poses.json"],
    "fly": ["path.json"],
    "plot": ["house.png"],
    "report": ["house.html"],
    "convert": ["map.pgm", "map.yaml"],
    "inflate": ["wide.json"],
    "routes": ["routes.gml"],
    "episodes": ["set.jsonl"],
    "score": ["scores.csv"],
    "audit": ["remarks.png"],
}


@pytest.fixture
def house(folder, monkeypatch):
    """The current folder, with a house, a room, and nothing that compiles for minutes."""
    shutil.copy(GOLDEN / "house.grid.json.gz", folder / "house.json.gz")
    monkeypatch.setattr(compiled, "warm_up", list)
    return folder


def list_keys(command: str) -> set[str]:
    """The keys that the page lists for a command, with those of all commands."""
    [row] = re.findall(rf"^\| `{command}` \| (.*) \|$", TABLE, flags=re.MULTILINE)
    return {"files", "warnings", *re.findall(r"`(\w+)`", row)}


def prepare(run, command: str) -> None:
    """Make what the command reads."""
    if command == "score":
        run(*LINES["episodes"].split())
        finder = PathFinder(load("house.json.gz"))
        runs = [
            {"episode": episode.id, "positions": path.positions.tolist()}
            for episode in read_episodes("set.jsonl").episodes
            if (path := finder.find_path(episode.start, episode.goals[0].position))
        ]
        Path("runs.jsonl").write_text("".join(json.dumps(line) + "\n" for line in runs))
    if command == "verify":
        run(*LINES["bake"].split())


def write_grids_with_faults(run) -> None:
    """Write a grid that disagrees with its scene, and one that audit finds errors in."""
    run("bake", "room.yaml")
    grid = load("room.grid.json")
    grid.with_layers(weights=np.ones(grid.shape)).save("wrong.grid.json")
    level = level_from("...")
    level.attributes["floorHeight"] = np.full((1, 3), np.nan)
    level.save("free.grid.json")


@pytest.mark.parametrize("command", [name for name in NAMES if name != "batch"])
def test_each_command_prints_one_object_with_the_keys_of_the_page(house, run, monkeypatch, command):
    if command == "view":
        viewer = pytest.importorskip("navbake.views.viewer.view")
        monkeypatch.setattr(viewer.Viewer, "wait", lambda self: None)
    prepare(run, command)
    status, out, _ = run(*LINES[command].split(), "--json")
    facts = json.loads(out)
    assert status == 0
    assert facts.keys() == list_keys(command)
    assert facts["files"] == WRITTEN.get(command, [])
    assert all(Path(name).is_file() for name in facts["files"])
    assert facts.get("scene_id", "house") in ("house", "room")
    for scene in facts.get("scenes", []):
        assert scene["scene_id"] in ("house", "room")


def test_flights_are_a_path_or_episodes_with_keys_of_their_own(house, run):
    words = "fly room.yaml --radius 0.2 --margin 1 --episodes 2 -o set.jsonl --json"
    status, out, _ = run(*words.split())
    [row] = re.findall(r"^\| `fly` of episodes \| (.*) \|$", TABLE, flags=re.MULTILINE)
    facts = json.loads(out)
    assert status == 0 and facts.keys() == {"files", "warnings", *re.findall(r"`(\w+)`", row)}
    assert (facts["scene_id"], facts["num_episodes"]) == ("room", 2)
    assert facts["files"] == ["set.jsonl"]


@pytest.mark.parametrize("command", NAMES)
def test_each_command_has_the_option_once(run, command):
    _, out, _ = run(command, "--help")
    assert len(re.findall(r"^  +--json ", out, flags=re.MULTILINE)) == 1


@pytest.mark.parametrize(
    ("words", "key", "row_title"),
    [
        (LINES["path"], "path", "`path` of `path`"),
        (LINES["fly"], "path", "`path` of `fly`"),
        (LINES["sample"], "places", "`places`"),
        (LINES["stand"], "poses", "`poses`"),
        (LINES["rooms"], "rooms", "`rooms`"),
        ("audit free.grid.json", "remarks", "`remarks`"),
        ("verify wrong.grid.json --scene room.yaml --all", "findings", "`findings`"),
    ],
)
def test_the_page_has_the_keys_inside_of_objects(house, run, words, key, row_title):
    write_grids_with_faults(run)
    facts = json.loads(run(*words.split(), "--json")[1])
    objects = facts[key] if isinstance(facts[key], list) else [facts[key]]
    [row] = re.findall(rf"^\| {row_title} \| (.*) \|$", INNER_TABLE, flags=re.MULTILINE)
    assert {name for item in objects for name in item} <= {*re.findall(r"`(\w+)`", row)}
    assert objects[0].keys() >= {*re.findall(r"`(\w+)`", row)} - {
        "outdoors", "checks", "error", "remark", "from"
    }  # fmt: skip
    if key == "remarks":
        assert {remark["check"] for remark in objects} <= {*facts["checks"]}


def test_quiet_prints_the_same_object(house, run):
    _, out, _ = run("inflate", "house.json.gz", "0.3", "-o", "wide.json", "--json", "-q")
    assert out == run("inflate", "house.json.gz", "0.3", "-o", "wide.json", "--json")[1]


def test_warnings_are_in_the_object_and_on_stderr(house, run):
    _, out, err = run(*LINES["convert"].split(), "--json")
    [warning] = json.loads(out)["warnings"]
    assert warning.startswith("nav2 has no place for ") and warning in err
    _, out, err = run("inflate", "house.json.gz", "0.6", "-o", "wide.json", "--json")
    [warning] = json.loads(out)["warnings"]
    assert " closes " in warning and f"warning: {warning}\n" in err


def test_a_file_on_stdout_leaves_the_object_to_stderr(house, run):
    _, out, err = run("schema", "--json")
    assert "properties" in json.loads(out)
    assert json.loads(err) == {"files": [], "warnings": []}
    _, out, err = run("init", "room.xml", "-o", "-", "--json")
    assert "scene:" in out and json.loads(err)["scene_id"] == "room"
    _, out, err = run("bake", "room.yaml", "-o", "-", "--json")
    Path("again.json").write_text(out)
    assert load("again.json").scene_id == "room"
    assert json.loads(err)["scenes"][0]["file"] == "-"


def test_an_error_prints_no_object_and_a_no_does(house, run):
    status, out, err = run("info", "none.json", "--json")
    assert (status, out) == (1, "") and err.startswith("navbake: ")
    status, out, _ = run("path", "house.json.gz", "--from", "99,0,0", "--to", "1,1,L0", "--json")
    assert status == 1 and json.loads(out)["path"] is None


def test_of_several_bakes_those_that_fail_are_listed(house, run):
    (house / "bad.yaml").write_text("scene: {path: none.xml}\n")
    status, out, _ = run("bake", "bad.yaml", "room.yaml", "-o", "grids/", "--json")
    facts = json.loads(out)
    assert status == 1
    assert facts["files"] == ["grids/room.grid.json"]
    assert [(scene["config"], scene["scene_id"]) for scene in facts["scenes"]] == [
        ("room.yaml", "room")
    ]
    assert [failure["config"] for failure in facts["failures"]] == ["bad.yaml"]
    assert "none.xml" in facts["failures"][0]["error"]


def test_a_pipe_of_another_encoding_gets_json(capsys, monkeypatch):
    """As a pipe on Windows does."""
    pipe = io.TextIOWrapper(io.BytesIO(), encoding="cp1252", errors="backslashreplace")
    monkeypatch.setattr(sys, "stdout", pipe)
    print_json({"name": "Küche 厨房"})
    pipe.flush()
    assert json.loads(pipe.buffer.getvalue()) == {"name": "Küche 厨房"}


# ---------------------------------------------------------------- exit statuses

STATUSES = {  # status -> commands that end with it
    0: [
        "--version",
        "samples",
        "bake room.yaml -o again.grid.json",
        "path house.json.gz --from 0,-4.8,L0 --to room:1:1",
        "verify room.grid.json --sample 20",
        "audit house.json.gz",
    ],
    1: [
        "info none.json",
        "samples nonsense",
        "bake bad.yaml room.yaml -o grids/",
        "batch bad.yaml -o out",
        "path house.json.gz --from 99,0,0 --to 1,1,L1",
        "path house.json.gz --from 0,-4.8,L0 --to 1,1,L1 --radius 2",
        "fly room.yaml --from 0,0,4 --to 1,1,4 --radius 0.2 --res 0",
        "fly room.yaml --from 0,0,-4 --to 1,1,4 --radius 0.2",
        "stand house.json.gz object:sofa --reach 0.8,0.3",
        "stand house.json.gz object:sofa --height 9",
        "verify wrong.grid.json --scene room.yaml --all",
        "audit free.grid.json",
    ],
    2: [
        "info",
        "nonsense",
        "info house.json.gz --nonsense",
        "bake room.yaml --radius wide",
        "plot house.json.gz -o house.txt",
        "why house.json.gz here",
        "fly room.yaml --from 0,0,4 --to 1,1,4 --radius 0.2 --margin -1",
        "stand house.json.gz object:sofa --reach near",
    ],
}
SIGNALLED = """
import os, signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests may run in the background
from navbake import __main__ as start
import navbake.cli.main as command_line
command_line.main = lambda: os.kill(os.getpid(), signal.{name})
start.main()
"""


def test_the_page_lists_all_statuses():
    table = PAGE.partition("## Exit status")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| ([\d, ]+) \|", table, flags=re.MULTILINE)
    listed = {int(status) for row in rows for status in row.split(",")}
    assert listed == {*STATUSES, 130, 143}
    for command in ("path", "fly", "stand", "verify", "audit", "bake", "batch"):
        assert f"`{command}`" in table
        assert any(line.startswith(command) for line in STATUSES[1])


@pytest.mark.parametrize(
    ("status", "line"), [(status, line) for status, lines in STATUSES.items() for line in lines]
)
def test_a_command_ends_with_the_status_of_the_page(house, run, status, line):
    (house / "bad.yaml").write_text("scene: {path: none.xml}\n")
    write_grids_with_faults(run)
    assert run(*line.split())[0] == status


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as on POSIX")
@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_signal_ends_a_command_with_the_status_of_the_page(name, status):
    code = SIGNALLED.format(name=name)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert done.returncode == status
