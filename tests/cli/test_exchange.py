"""The commands `convert`, `inflate` and `map-descriptor`."""

from __future__ import annotations

import json
import shutil
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import navbake
from cli_scenes import P1, P2
from differences import first_difference
from navbake import files
from navbake.errors import FormatError
from navbake.formats.format_table import GRID_FORMATS, find_format
from navbake.lazy import resolve
from project_paths import GOLDEN

HOUSE = GOLDEN / "house.grid.json.gz"


@pytest.fixture
def house(tmp_path, monkeypatch):
    """The current folder, with a house in it."""
    shutil.copy(HOUSE, tmp_path / "house.json.gz")
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def convert(run, house):
    return partial(run, "convert")


@pytest.fixture
def inflate(run, house):
    return partial(run, "inflate")


def test_converts_by_ending_or_by_name(convert):
    assert convert("house.json.gz", "a.json") == (0, "a.json\n", "")
    shutil.copy("a.json", "b.dat")
    assert convert("b.dat", "c.dat", "--from", "navgrid", "--to", "navgrid") == (0, "c.dat\n", "")
    house = navbake.load("house.json.gz")
    assert first_difference(navbake.load("c.dat"), house) is None
    assert house.convert("d.dat", "navgrid") == [Path("d.dat")]
    assert Path("d.dat").read_bytes() == Path("c.dat").read_bytes()
    with pytest.raises(FormatError, match="navgrid takes no option 'radius', it takes: none"):
        house.convert("e.json", radius=1.0)


def test_doors_are_converted_in_a_state(convert, run):
    assert convert("house.json.gz", "a.json", "--doors", "closed")[0] == 0
    house = navbake.load("house.json.gz").with_doors("closed")
    assert first_difference(navbake.load("a.json"), house) is None
    assert run("routes", "house.json.gz", "-o", "a.gml", "--doors", "closed")[0] == 0
    house.routes().save("b.gml")
    assert Path("a.gml").read_bytes() == Path("b.gml").read_bytes()


@pytest.mark.parametrize(
    "key",
    sorted({key for form in GRID_FORMATS for key in (*form.write_options, *form.read_options)}),
)
def test_each_option_of_a_format_is_an_option_of_convert(convert, key):
    option = f"--{key.replace('_', '-')}"
    words = {"mode": "raw", "image": "png", "rules": "main", "stairs": "free", "unknown": "free"}
    words["up"] = "z"
    values = [] if key in ("absolute", "flat", "cut_corners") else [words.get(key, "1")]
    status, _, err = convert("a.jsonl", "b.jsonl", option, *values)
    assert status == 2 and option in err and "grids" in err


def test_never_writes_over_its_input_and_an_output_is_whole_or_as_before(convert, monkeypatch):
    before = Path("house.json.gz").read_bytes()
    for output in ("house.json.gz", "./house.json.gz"):
        status, out, err = convert("house.json.gz", output)
        assert (status, out) == (1, "") and "apart from the inputs" in err
    Path("big.json").write_text("{}")

    def fail(*_args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "replace", fail)
    status, out, err = convert("house.json.gz", "big.json")
    assert (status, out) == (1, "")
    assert "No space left" in err
    assert Path("big.json").read_text() == "{}"
    assert Path("house.json.gz").read_bytes() == before


def test_the_table_names_functions_that_are_there():
    for form in GRID_FORMATS:
        for where in (form.encode, form.read):
            assert where is None or callable(resolve(f"navbake.formats.{where}"))


def test_the_longest_ending_decides():
    assert find_format("a.json.gz", writing=True).name == "navgrid"
    assert find_format("A.JSON", writing=False).name == "navgrid"
    with pytest.raises(FormatError, match=r"got json"):
        find_format("json", writing=False)


# ---------------------------------------------------------------- maps


def test_each_way_there_and_back(convert):
    house = navbake.load("house.json.gz")
    assert convert("house.json.gz", "a.npz") == (0, "a.npz\n", "")
    assert convert("a.npz", "a.json")[0] == 0
    assert first_difference(navbake.load("a.json"), house) is None
    status, out, err = convert("house.json.gz", "map.yaml", "--level", 1, "--radius", 0.3)
    assert (status, out) == (0, "map.pgm\nmap.yaml\n")
    lost = "steps between levels (20), doors (8, as they stand)"
    assert err.endswith(f"navbake: nav2 has no place for {lost}\n")
    assert convert("map.yaml", "top.png")[0] == 0 and convert("top.png", "top.json")[0] == 0
    expected = house.inflate(0.3).levels[1].free
    assert (navbake.load("top.json").free == expected).all()
    assert convert("house.json.gz", "stay.yml", "--to", "nav2-keepout", "--zone", "1")[0] == 0


def test_the_rules_of_nav2_are_an_option_of_maps_that_are_read(convert):
    convert("house.json.gz", "map.yaml", "--level", 1)
    text = Path("map.yaml").read_text()
    changed = text.replace("0.196", "0.003").replace("0.65", "1.0")
    Path("map.yaml").write_text(changed)  # black lies on the threshold
    assert convert("map.yaml", "a.json")[0] == 0
    assert convert("map.yaml", "b.json", "--rules", "main")[0] == 0
    assert convert("map.yaml", "c.json", "--rules", "humble")[0] == 0
    one, other, third = (navbake.load(f"{name}.json") for name in "abc")
    assert np.isnan(one.floor).sum() > np.isnan(other.floor).sum()
    assert first_difference(one, third) is None
    status, _, err = convert("house.json.gz", "d.json", "--rules", "main")
    assert status == 2 and "it is for nav2 as IN" in err


def test_the_maps_of_levels_are_named_where_there_is_none_of_the_whole(convert):
    assert convert("house.json.gz", "map.yaml", "--to", "nav2")[0] == 0
    status, _, err = convert("map.yaml", "a.json")
    assert status == 1 and "No such file" in err
    assert "map_0.yaml is there: each level has a file of its own" in err
    assert "map_0" not in convert("plan.yaml", "a.json")[2]


def test_an_image_is_never_written_over_an_input(convert):
    convert("house.json.gz", "map.yaml", "--level", 1, "--image", "png")
    convert("house.json.gz", "plan.png", "--level", 1)
    status, _, err = convert("plan.png", "plan.yaml", "--image", "png")
    assert status == 1 and "apart from the inputs" in err and not Path("plan.yaml").exists()
    before = Path("map.png").read_bytes()
    status, _, err = convert("map.yaml", "map.png")
    assert status == 1 and "apart from the inputs" in err and Path("map.png").read_bytes() == before


def test_any_map_becomes_a_scene(convert):
    convert("house.json.gz", "map.yaml", "--level", 1)
    for source in ("map.yaml", "house.json.gz"):
        assert convert(source, "scene.xml")[0] == 0
        assert Path("scene.xml").exists() and Path("scene.yaml").exists()
    for arguments in (["-", "--to", "mjcf"], ["a.xml", "--level", "7"]):
        assert convert("house.json.gz", *arguments)[0]
    assert not Path("a.xml").exists()


def test_writes_the_grid_that_inflate_gives(inflate):
    status, out, err = inflate(
        "house.json.gz", "--radius", 0.3, "--clearance", 0.2, "-o", "big.json"
    )
    assert status == 0 and "25 islands where there was 1" in err
    house = navbake.load("house.json.gz")
    inflated = house.inflate(0.3, 0.2)
    assert first_difference(navbake.load("big.json"), inflated) is None
    before, after = (sum(level.free.sum() for level in g.levels) / 100 for g in (house, inflated))
    assert out == (
        f"big.json: {after:.2f} of {before:.2f} m² free ({after / before:.1%}) "
        "for an agent of radius 0.3 m (exact)\n"
    )


def test_inflate_names_the_stairs_that_it_closes_and_path_does_too(inflate, run):
    at = "(1.50, 3.25)", "(4.20, 1.85)"
    stairs = [f"the stairs between level 0 and 1 near {place}" for place in at]
    status, _, err = inflate("house.json.gz", "--radius", 0.3, "-o", "wide.json")
    warning = f"a radius of 0.3 m closes {', '.join(stairs)}: 25 islands where there was 1"
    assert status == 0 and err == f"navbake: warning: {warning}\n"
    ends = "--from", "0,-4.8", "--to", "-2.2,-3.2,L1"
    status, out, _ = run("path", "wide.json", *ends)
    hint = "if the agent can climb, a link in `links` joins their ends"
    because = f"{stairs[1]} are closed for a radius of 0.3 m, and 0.25 m passes; {hint}\n"
    assert status == 1 and out.endswith(because) and "gap" not in out
    assert run("path", "house.json.gz", "--radius", 0.3, *ends)[1] == out
    status, _, err = inflate("house.json.gz", "--radius", 0.25, "-o", "wide.json")
    assert (status, err) == (0, "")


@pytest.mark.parametrize("action", ["default", "ignore", "error"])
def test_a_grid_that_is_inflated_for_more_stays_so_and_that_is_said(inflate, run, action):
    warnings.simplefilter(action, UserWarning)  # commands say it all the same
    inflate("house.json.gz", 0.4, "-o", "a.json")
    status, out, err = inflate("a.json", 0.2, "-o", "b.json")
    warning = "the grid of 'house' stays inflated for 0.4 m, not 0.2 m"
    remedy = "inflate the grid as it was baked"
    assert status == 0 and err.startswith(f"navbake: warning: {warning}: {remedy}\n")
    assert "(100.0%) for an agent of radius 0.4 m" in out
    ends = ("--from", "0,-4.8,L0", "--to", "1,-4.8,L0", "--radius", 0.2)
    assert run("path", "a.json", *ends)[2] == f"navbake: warning: {warning}: {remedy}\n"
    assert inflate("a.json", 0.4, "-o", "b.json")[2] == ""
    assert inflate("a.json", 0.2, "--mode", "minos", "-o", "b.json")[2] == ""


def test_takes_modes_and_costs(inflate):
    house = navbake.load("house.json.gz")
    assert inflate("house.json.gz", "--radius", 0.3, "--mode", "minos", "-o", "a.json")[0] == 0
    options = ("--costs", "nav2", "--scaling", 3)
    assert inflate("house.json.gz", "--radius", 0.3, *options, "-o", "b.json")[0] == 0
    for name, expected in (
        ("a.json", house.inflate(0.3, mode="minos")),
        ("b.json", house.inflate(0.3, costs="nav2", scaling=3.0)),
    ):
        for level, same in zip(navbake.load(name).levels, expected.levels, strict=True):
            np.testing.assert_array_equal(level.weights, same.weights)


def test_a_baked_arena_as_a_descriptor(arena, run):
    run("bake", "arena.yaml", "-q")
    status, out, err = run("map-descriptor", "arena.grid.json")
    assert (status, err) == (0, "")
    part1, part2, *drawing = out.strip().split("\n")
    assert part1 == "F" * 76 and len(part2) == 76
    assert len(drawing) == 20 and {len(row) for row in drawing} == {15}
    assert drawing[17] == "...........##.." and drawing[3] == ".####.........."
    status, again, _ = run("mdf", "--decode", part1, part2)
    assert again.strip().split("\n") == drawing


def test_part_of_a_level_with_a_mask(arena, run):
    run("bake", "arena.yaml", "-q", "--set", "grid.cell_size=0.05")
    mask = np.zeros((4, 5), dtype=bool)
    mask[3, 3:] = True
    np.save("seen.npy", mask)
    status, out, _ = run(
        "mdf", "arena.grid.json", "--corner", 0.8, 0.2, "--rows", 4, "--cols", 5,
        "--explored", "seen.npy", "--json",
    )  # fmt: skip
    facts = json.loads(out)
    assert status == 0 and facts["map"] == ["?????", "?????", "?????", "???##"]
    assert (facts["rows"], facts["cols"]) == (4, 5)


def test_decodes_the_canonical_descriptor(run):
    status, out, _ = run("mdf", "--decode", P1, P2)
    assert status == 0 and out.count("?") == 92 and out.count("#") == 15
