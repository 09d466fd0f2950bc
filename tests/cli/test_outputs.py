"""Outputs: their endings, what they must not overwrite, stdout, and names of several."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

import navbake
from command_line import run_command
from navbake.formats.navgrid import dumps_navgrid
from project_paths import GOLDEN

HOUSE = str(GOLDEN / "house.grid.json.gz")
COARSE = ("--set", "grid.cell_size=0.5")
ROOMS = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"name": "hall"},
            "geometry": {"type": "Polygon", "coordinates": [[[-3, -2], [3, -2], [3, 2], [-3, 2]]]},
        }
    ],
}


@pytest.fixture
def scenes(folder):
    """Three folders, each with a scene.xml."""
    paths = []
    for name in ("hall", "attic", "deep/cellar"):
        path = folder / "scenes" / name / "scene.xml"
        path.parent.mkdir(parents=True)
        path.write_text((folder / "room.xml").read_text())
        paths.append(path)
    return paths


@pytest.mark.parametrize("name", ["map.pgm", "map", "map.yaml", "map.jsonl", "map.gz"])
def test_unknown_endings_are_refused(folder, run, names, name):
    for command in (("bake", "room.yaml"), ("inflate", HOUSE, "--radius", 1)):
        status, out, err = run(*command, "-o", name)
        assert (status, out) == (2, "")
        assert f".json, .json.gz, got {name}" in " ".join(err.split())
    status, _, err = run("bake", "room.yaml", "--set", f"output={name}")
    assert status == 1 and f"got {name}" in err
    assert names(folder) == ["room.xml", "room.yaml"]


def test_endings_may_be_in_capitals(folder, run):
    assert run("bake", "room.yaml", "-q", "-o", "a.JSON.GZ") == (0, "", "")
    assert Path("a.JSON.GZ").read_bytes().startswith(b"\x1f\x8b")


def test_no_input_is_overwritten(folder, run):
    rooms = json.dumps(ROOMS)
    (folder / "rooms.json").write_text(rooms)
    (folder / "room.yaml").write_text("scene: {path: room.xml}\nrooms: {polygons: rooms.json}\n")
    os.link(folder / "rooms.json", folder / "linked.json")
    os.symlink("rooms.json", folder / "soft.json")
    for name in ("rooms.json", "./rooms.json", "linked.json", "soft.json"):
        status, _, err = run("bake", "room.yaml", *COARSE, "-o", name)
        assert status == 1 and "expected an output apart from the inputs" in err
    status, _, err = run("bake", "room.yaml", *COARSE, "--set", "output=rooms.json")
    assert status == 1 and "apart from the inputs" in err
    assert (folder / "rooms.json").read_text() == rooms


def test_a_picture_does_not_overwrite_its_grid(folder, run):
    (folder / "a.png").write_bytes(Path(HOUSE).read_bytes())
    assert run("plot", "a.png", "-o", "a.png")[0] == 1
    assert run("path", "a.png", "--from", "0,0", "--to", "1,1", "-o", "a.png")[0] == 1
    assert (folder / "a.png").read_bytes() == Path(HOUSE).read_bytes()


def test_a_grid_on_stdout(folder, capfdbinary, names):
    status, out, err = run_command(capfdbinary, "bake", "room.yaml", "--no-timings", "-o", "-")
    assert status == 0
    grid = navbake.load(out)
    assert out == dumps_navgrid(grid)
    assert b"12 x 8" in err  # what is said goes beside it
    status, out, err = run_command(capfdbinary, "bake", "room.yaml", "-q", "-o", "-")
    assert (status, err) == (0, b"") and navbake.load(out).scene_id == "room"
    status, out, err = run_command(capfdbinary, "inflate", HOUSE, "--radius", 0.2, "-o", "-")
    assert status == 0 and navbake.load(out).scene_id == "house" and b"0.2 m" in err
    assert names(folder) == ["room.xml", "room.yaml"]


def test_a_closed_stdout_takes_no_grid(folder, capsys, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("sys.stdout", None)
        status, _, err = run_command(capsys, "inflate", HOUSE, "--radius", 0.2, "-o", "-", "-q")
    assert (status, err) == (1, "navbake: cannot write to stdout: it is closed\n")


def test_pictures_and_settings_on_stdout(folder, capfdbinary, names):
    status, out, _ = run_command(capfdbinary, "plot", HOUSE, "-o", "-")
    assert status == 0 and out.startswith(b"\x89PNG")
    ends = ("--from", "0,-4.8,L0", "--to", "1,-5,L0")
    status, out, err = run_command(capfdbinary, "path", HOUSE, *ends, "-o", "-")
    assert status == 0 and out.startswith(b"\x89PNG") and b"length" in err
    status, out, _ = run_command(capfdbinary, "init", "room.xml", "-o", "-")
    assert status == 0
    assert names(folder) == ["room.xml", "room.yaml"]
    (folder / "again.yaml").write_bytes(out)
    assert run_command(capfdbinary, "geoms", "again.yaml")[0] == 0


def test_names_of_several_scenes(folder, scenes, run, names):
    assert run("bake", *scenes, *COARSE, "-q", "-o", "a/", "--name", "{parent}") == (0, "", "")
    assert names(folder / "a") == ["attic.grid.json", "cellar.grid.json", "hall.grid.json"]
    name = "{parent}/{stem}-{id}"
    assert run("bake", *scenes[:2], *COARSE, "-q", "-o", "b/", "--name", name) == (0, "", "")
    assert names(folder / "b") == ["attic/scene-scene.grid.json", "hall/scene-scene.grid.json"]
    status, _, err = run("bake", *scenes[:2], *COARSE, "-q", "-o", "c/", "--name", "{id}")
    assert status == 1 and "--name '{parent}-{stem}'" in err
    assert run("bake", "room.xml", scenes[0], *COARSE, "-q", "-o", "flat/") == (0, "", "")
    assert names(folder / "flat") == ["room.grid.json", "scene.grid.json"]


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        (("--name", "{scene}"), "{id}, {stem}, {parent}, got {scene}"),
        (("--name", "../{id}"), "got '../{id}'"),
        (("--name", "/tmp/{id}"), "got '/tmp/{id}'"),
        (("--name", ""), "got ''"),
        (("--name", "a", "-o", "b.json"), "--name: does nothing here: it is for files in a folder"),
    ],
)
def test_wrong_names_are_refused(folder, run, arguments, culprit):
    status, _, err = run("bake", "room.yaml", *arguments)
    assert status == 2
    assert culprit in " ".join(err.split())


def test_two_bakes_without_timings_are_the_same_bytes(folder, run):
    for name in ("a.json", "b.json"):
        assert run("bake", "room.yaml", "-q", "--no-timings", "-o", name) == (0, "", "")
    assert Path("a.json").read_bytes() == Path("b.json").read_bytes()
    assert navbake.load("a.json").timings == {}
    run("bake", "room.yaml", "-q", "-o", "c.json")
    timed = navbake.load("c.json")
    assert timed.timings
    timed.timings = {}
    assert dumps_navgrid(timed) == Path("a.json").read_bytes()


def test_a_descriptor_that_is_decoded_takes_no_options_of_grids(run):
    for option in (("--level", 1), ("--square", 0.2), ("--corner", 0, 0), ("--explored", "a.npy")):
        status, _, err = run("mdf", "--decode", "F", "F", *option)
        assert status == 2
        assert f"{option[0]}: does nothing here: it is for a GRID" in " ".join(err.split())
