"""The command `navbake convert`, and the table of formats behind it."""

import shutil
from functools import partial
from pathlib import Path

import pytest

import navbake
from differences import first_difference
from navbake import files
from navbake.errors import FormatError
from navbake.formats.convert import FORMATS, find_format
from navbake.navgrid.operations import resolve
from project_paths import GOLDEN


@pytest.fixture
def run(run, tmp_path, monkeypatch):
    """Returns a function that runs the command in a folder with a house: status, stdout, stderr."""
    shutil.copy(GOLDEN / "house.grid.json.gz", tmp_path / "house.json.gz")
    monkeypatch.chdir(tmp_path)
    return partial(run, "convert")


def test_converts_by_ending_or_by_name(run):
    assert run("house.json.gz", "a.json") == (0, "a.json\n", "")
    shutil.copy("a.json", "b.dat")
    assert run("b.dat", "c.dat", "--from", "navgrid", "--to", "navgrid") == (0, "c.dat\n", "")
    house = navbake.load("house.json.gz")
    assert first_difference(navbake.load("c.dat"), house) is None
    assert house.convert("d.dat", "navgrid") == [Path("d.dat")]
    assert Path("d.dat").read_bytes() == Path("c.dat").read_bytes()
    with pytest.raises(FormatError, match="navgrid takes no option 'radius', it takes: none"):
        house.convert("e.json", radius=1.0)


def test_writes_to_stdout_what_is_one_file(run):
    status, _, err = run("house.json.gz", "-")
    assert status == 2 and "--to" in err


@pytest.mark.parametrize(
    ("arguments", "culprits"),
    [
        (["house.json.gz", "a.tif"], ["OUT", ".json.gz (navgrid)", "got a.tif"]),
        (["house.tif", "a.json"], ["IN", ".json.gz (navgrid)", "got house.tif"]),
        (["house.json.gz", "a.json", "--to", "tiff"], ["--to", "navgrid", "got tiff"]),
        (["house.json.gz", "a.json", "--from", "tiff"], ["--from", "navgrid", "got tiff"]),
        (["house.json.gz", "a.json", "--level", "0"], ["--level", "does nothing here"]),
    ],
)
def test_wrong_usage_says_what_there_is(run, arguments, culprits):
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert all(culprit in err for culprit in culprits)
    assert len(err.strip().splitlines()) <= 4


def test_never_writes_over_its_input_and_an_output_is_whole_or_as_before(run, monkeypatch):
    before = Path("house.json.gz").read_bytes()
    for output in ("house.json.gz", "./house.json.gz"):
        status, out, err = run("house.json.gz", output)
        assert (status, out) == (1, "") and "apart from the inputs" in err
    Path("big.json").write_text("{}")

    def fail(*_args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "replace", fail)
    status, out, err = run("house.json.gz", "big.json")
    assert (status, out) == (1, "")
    assert "No space left" in err
    assert Path("big.json").read_text() == "{}"
    assert Path("house.json.gz").read_bytes() == before


def test_help_shows_an_example_and_all_formats(run):
    status, out, _ = run("--help")
    assert status == 0 and "navbake convert house.grid.json map.yaml" in out
    assert all(form.name in out for form in FORMATS)


def test_the_table_names_functions_that_are_there():
    for form in FORMATS:
        for where in (form.encode, form.read):
            assert where is None or callable(resolve(f"navbake.formats.{where}"))


def test_the_longest_ending_decides():
    assert find_format("a.json.gz", writing=True).name == "navgrid"
    assert find_format("A.JSON", writing=False).name == "navgrid"
    with pytest.raises(FormatError, match=r"got json"):
        find_format("json", writing=False)


# ---------------------------------------------------------------- maps


def test_each_way_there_and_back(run):
    house = navbake.load("house.json.gz")
    assert run("house.json.gz", "a.npz") == (0, "a.npz\n", "")
    assert run("a.npz", "a.json")[0] == 0
    assert first_difference(navbake.load("a.json"), house) is None
    status, out, err = run("house.json.gz", "map.yaml", "--level", 1, "--radius", 0.3)
    assert (status, out, err) == (0, "map.pgm\nmap.yaml\n", "")
    assert run("map.yaml", "top.png")[0] == 0 and run("top.png", "top.json")[0] == 0
    expected = house.inflate(0.3).levels[1].free
    assert (navbake.load("top.json").free == expected).all()
    assert run("house.json.gz", "stay.yml", "--to", "nav2-keepout", "--zone", "1")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "status", "culprit"),
    [
        (["map.yaml", "--inflation", 1], 1, "mode trinary has no costs"),
        (["map.yaml", "--flat"], 2, "it is for mjcf as OUT"),
        (["a.png", "--mode", "raw"], 2, "it is for nav2 as OUT"),
        (["-", "--to", "nav2", "--level", 0], 2, "nav2 is 2 files"),
        (["map.yaml", "--to", "nav2-keepout", "--zones", "map.yaml"], 1, "apart from the inputs"),
    ],
)
def test_options_that_do_nothing_are_refused(run, arguments, status, culprit):
    got, out, err = run("house.json.gz", *arguments)
    assert (got, out) == (status, "") and culprit in err
    assert not Path("map.pgm").exists()


def test_an_image_is_never_written_over_an_input(run):
    run("house.json.gz", "map.yaml", "--level", 1, "--image", "png")
    run("house.json.gz", "plan.png", "--level", 1)
    status, _, err = run("plan.png", "plan.yaml", "--image", "png")
    assert status == 1 and "apart from the inputs" in err and not Path("plan.yaml").exists()
    before = Path("map.png").read_bytes()
    status, _, err = run("map.yaml", "map.png")
    assert status == 1 and "apart from the inputs" in err and Path("map.png").read_bytes() == before


def test_any_map_becomes_a_scene(run):
    run("house.json.gz", "map.yaml", "--level", 1)
    for source in ("map.yaml", "house.json.gz"):
        assert run(source, "scene.xml")[0] == 0
        assert Path("scene.xml").exists() and Path("scene.yaml").exists()
    for arguments in (["-", "--to", "mjcf"], ["a.xml", "--level", "7"]):
        assert run("house.json.gz", *arguments)[0]
    assert not Path("a.xml").exists()
