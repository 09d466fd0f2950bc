"""The command `navbake path`."""

import json
from functools import partial

import pytest

import navbake
from project_paths import GOLDEN

HOUSE, APARTMENT = (str(GOLDEN / f"{name}.grid.json.gz") for name in ("house", "apartment"))


@pytest.fixture
def run(run):
    """Returns a function that runs the command: status, stdout, stderr."""
    return partial(run, "path")


def test_prints_the_path_that_the_finder_finds(run):
    status, out, err = run(HOUSE, "--from", "0,-4.8,L0", "--to", "room:1:1", "--json")
    assert (status, err) == (0, "")
    told = json.loads(out)["path"]
    path = navbake.PathFinder(navbake.load(HOUSE)).find_path((0, -4.8, 0), "room:1:1")
    assert told["length"] == path.length
    assert told["cost"] == path.cost
    assert told["rooms"] == path.rooms
    assert told["doors"] == path.doors
    assert told["positions"] == path.positions.tolist()
    assert told["levels"] == path.levels.tolist()


def test_prints_text(run):
    status, out, _ = run(HOUSE, "--from", "0,-4.8,L0", "--to", "room:1:1")
    lines = out.splitlines()
    assert status == 0
    assert lines[0].startswith("length  ") and lines[0].endswith(" m")
    assert lines[2].endswith("1:1")
    assert lines[5].split() == ["0.000", "-4.800", "-0.050", "0"]
    assert lines[-1].endswith("  1")


def test_the_nearest_of_several_and_heights(run):
    out = run(HOUSE, "--from", "0,-4.8,0", "--to", "-6,5,L0", "--to", "1,-5,0", "--json")[1]
    assert json.loads(out)["path"]["positions"][-1][:2] == [1.0, -5.0]


def test_a_path_may_keep_to_the_centres(run):
    smooth, rough = (
        json.loads(run(APARTMENT, "--from", "0,0", "--to", "room:bedroom", "--json", *option)[1])
        for option in ([], ["--no-smooth"])
    )
    assert len(rough["path"]["positions"]) > len(smooth["path"]["positions"])


def test_no_path_is_status_1_with_the_reason(run):
    status, out, err = run(HOUSE, "--from", "0,-4.8,L0", "--to", "room:1:1", "--radius", 0.4)
    assert (status, err) == (1, "")
    assert out.startswith("no path: ")
    out = run(HOUSE, "--from", "99,0,0", "--to", "room:1:1", "--json")[1]
    assert json.loads(out)["path"] is None
    assert "lies beside the grid" in json.loads(out)["reason"]


def test_draws_a_picture(run, tmp_path):
    picture = tmp_path / "path.png"
    assert run(HOUSE, "--from", "0,-4.8,L0", "--to", "room:1:1", "-o", picture)[0] == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    empty = tmp_path / "none.png"
    assert run(HOUSE, "--from", "99,0,0", "--to", "room:1:1", "-o", empty)[0] == 1
    assert empty.read_bytes() != picture.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["--from", "abc", "--to", "room:1:1"], 2, "--from"),
        (["--from", "0,0,0,0", "--to", "room:1:1"], 2, "--from"),
        (["--from", "0,0,0", "--to", "1,1,Lx"], 2, "--to"),
        (["--from", "0,0,0", "--to", "room:1:1", "--to", "0,0,0"], 2, "several goals"),
        (["--from", "0,0,0", "--to", "1,1,L7"], 1, "no level 7"),
        (["--from", "0,0", "--to", "room:1:1"], 2, "a level"),
        (["--from", "0,0,0", "--to", "room:nowhere"], 1, "no room 'nowhere'"),
        (["--from", "0,0,0", "--to", "room:1:1", "-o", "path.jpg"], 2, ".png"),
        (["--from", "0,0,0", "--to", "room:1:1", "--radius", "-1"], 1, "radius"),
    ],
)
def test_wrong_usage(run, arguments, status, message):
    found, _, err = run(HOUSE, *arguments)
    assert found == status
    assert message in err


def test_a_level_without_floor_there_is_refused(run):
    status, _, err = run(HOUSE, "--from", "0,-4.8,L1", "--to", "room:1:1")
    assert status == 2
    assert "level 1 has no floor at 0, -4.8" in err
