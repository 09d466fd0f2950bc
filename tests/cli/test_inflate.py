"""The command `navbake inflate`."""

import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import navbake
from differences import first_difference
from navbake import files
from project_paths import GOLDEN

HOUSE = GOLDEN / "house.grid.json.gz"


@pytest.fixture
def run(run, tmp_path, monkeypatch):
    """Returns a function that runs the command in a folder with a house: status, stdout, stderr."""
    shutil.copy(HOUSE, tmp_path / "house.json.gz")
    monkeypatch.chdir(tmp_path)
    return partial(run, "inflate")


def test_writes_the_grid_that_inflate_gives(run):
    status, out, err = run("house.json.gz", "--radius", 0.3, "--clearance", 0.2, "-o", "big.json")
    assert (status, err) == (0, "")
    house = navbake.load("house.json.gz")
    inflated = house.inflate(0.3, 0.2)
    assert first_difference(navbake.load("big.json"), inflated) is None
    before, after = (sum(level.free.sum() for level in g.levels) / 100 for g in (house, inflated))
    assert out == (
        f"big.json: {after:.2f} of {before:.2f} m² free ({after / before:.1%}) "
        "for an agent of radius 0.3 m (exact)\n"
    )


def test_takes_modes_and_costs(run):
    house = navbake.load("house.json.gz")
    assert run("house.json.gz", "--radius", 0.3, "--mode", "minos", "-o", "a.json")[0] == 0
    options = ("--costs", "nav2", "--scaling", 3)
    assert run("house.json.gz", "--radius", 0.3, *options, "-o", "b.json")[0] == 0
    for name, expected in (
        ("a.json", house.inflate(0.3, mode="minos")),
        ("b.json", house.inflate(0.3, costs="nav2", scaling=3.0)),
    ):
        for level, same in zip(navbake.load(name).levels, expected.levels, strict=True):
            np.testing.assert_array_equal(level.weights, same.weights)


def test_never_writes_over_its_input_and_an_output_is_whole_or_as_before(run, monkeypatch):
    before = Path("house.json.gz").read_bytes()
    for output in ("house.json.gz", "./house.json.gz"):
        status, out, err = run("house.json.gz", "--radius", 0.3, "-o", output)
        assert (status, out) == (1, "") and "apart from the inputs" in err
    Path("big.json").write_text("{}")

    def fail(*_args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "replace", fail)
    status, out, err = run("house.json.gz", "--radius", 0.3, "-o", "big.json")
    assert (status, out) == (1, "")
    assert "No space left" in err
    assert Path("big.json").read_text() == "{}"
    assert Path("house.json.gz").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        (["--radius", "-1", "-o", "a.json"], "0 to 10,000 m as radius, got -1.0"),
        (["--radius", "nan", "-o", "a.json"], "as radius, got nan"),
        (["--radius", "1", "--mode", "best", "-o", "a.json"], "exact or minos as mode"),
        (["--radius", "1", "--costs", "none", "-o", "a.json"], "step or nav2 as costs"),
        (["--radius", "1", "-o", "absent/a.json"], "cannot write absent/a.json"),
    ],
)
def test_errors_are_one_line_before_any_work(run, arguments, culprit):
    status, out, err = run("absent.json", *arguments)
    assert (status, out) == (1, "")
    assert culprit in err
    assert err.count("\n") == 1


def test_a_missing_grid_and_wrong_usage(run):
    status, _, err = run("absent.json", "--radius", 1, "-o", "a.json")
    assert status == 1
    assert "absent.json" in err
    assert run("house.json.gz", "-o", "a.json")[0] == 2
    for given in (("--radius", "30cm"), ("--radius=30cm",)):
        status, _, err = run("house.json.gz", *given, "-o", "a.json")
        assert status == 2 and "30cm" in err and "--radius" in err
    for options in (("--scaling", 3), ("--mode", "minos", "--ledges", "avoid")):
        status, _, err = run("house.json.gz", "--radius", 1, *options, "-o", "a.json")
        assert status == 2 and "does nothing here" in err
    status, _, err = run("house.json.gz", "--radius", 1, "-o", "a.pgm")
    assert status == 2 and ".json, .json.gz, got a.pgm" in err
    assert not Path("a.json").exists()
