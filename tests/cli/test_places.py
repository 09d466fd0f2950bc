"""Places are spelled one way in all commands."""

import json

import pytest
from typer import BadParameter

from navbake.cli.options import parse_place
from project_paths import GOLDEN

HOUSE = str(GOLDEN / "house.grid.json.gz")


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("1.5,-2", (1.5, -2.0, None, None)),
        ("-1.5,+2,1", (-1.5, 2.0, 1.0, None)),
        (".5,2.,-1e-3", (0.5, 2.0, -0.001, None)),
        ("0,0,L0", (0.0, 0.0, None, 0)),
        ("0,0,L12", (0.0, 0.0, None, 12)),
    ],
)
def test_the_three_spellings(text, place):
    assert parse_place(text, "--at") == place


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("1.5 -2", "1.5,-2"),
        ("1.5, -2, 1", "1.5,-2,1"),
        ("(1.5,-2)", "1.5,-2"),
        ("[1, 2, 3]", "1,2,3"),
        ("1;2;L1", "1,2,L1"),
        ("1,2,l1", "1,2,L1"),
        ("1,2,level 1", "1,2,L1"),
        ("1,2,level1", "1,2,L1"),
    ],
)
def test_other_spellings_mean_the_same(text, plain):
    assert parse_place(text, "--at") == parse_place(plain, "--at")


@pytest.mark.parametrize(
    "text", ["", "here", "1", "1,2,3,4", "1,2,Lx", "1,2,L-1", "nan,0", "inf,0", "1,2,L1.5"]
)
def test_what_is_no_place_is_refused(text):
    with pytest.raises(BadParameter, match="expected X,Y"):
        parse_place(text, "--at")


def test_numbers_beyond_floats_are_refused():
    with pytest.raises(BadParameter, match="finite"):
        parse_place("1e999,0", "--at")


@pytest.mark.parametrize(("at", "level"), [("1,1,1", 0), ("1,1,3.5", 1), ("1,1,L1", 1)])
def test_why_and_path_mean_the_same(run, at, level):
    status, out, _ = run("why", HOUSE, "--at", at, "--json")
    assert status == 0
    assert [place["level"] for place in json.loads(out)] == [level]
    status, out, _ = run("path", HOUSE, "--from", at, "--to", at, "--json")
    assert status == 0
    assert json.loads(out)["path"]["levels"][0] == level


def test_a_place_without_a_level_is_on_the_only_floor_there(run):
    goal = ("--to", "-2.2,-3.2,L1")
    with_level, without = (
        run("path", HOUSE, "--from", start, *goal, "--json") for start in ("0,-4.8,L0", "0,-4.8")
    )
    assert with_level[0] == 0 and with_level == without


@pytest.mark.parametrize(
    ("option", "other", "at", "message"),
    [
        ("--from", "--to", "1,1", "levels have a floor: write 1,1,L0 or 1,1,L1"),
        ("--to", "--from", "1,1", "levels have a floor: write 1,1,L0 or 1,1,L1"),
        ("--from", "--to", "99,0", "no level has a floor at 99, 0"),
    ],
)
def test_a_place_without_a_level_on_several_floors_or_none(run, option, other, at, message):
    status, _, err = run("path", HOUSE, option, at, other, "0,-4.8,L0")
    assert status == 2
    assert f"{option}: " in err and message in " ".join(err.split())


def test_why_of_a_place_below_all_floors(run):
    status, _, err = run("why", HOUSE, "--at", "1,1,-30")
    assert status == 1
    assert "1,1,-30 is in no cell" in err
