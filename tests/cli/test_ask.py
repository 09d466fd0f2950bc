"""The commands `info`, `rooms`, `path`, `plot` and `report`; `why` is tested with its view."""

from __future__ import annotations

import json
import re
from functools import partial

import numpy as np
import pytest
from PIL import Image
from typer import BadParameter

import navbake
from door_scenes import LEAF, ROOMS, world
from grid_maps import level_from, room
from link_towers import DROP, LIFT, tower
from navbake.cli.options import parse_place
from project_paths import GOLDEN

HOUSE = GOLDEN / "house.grid.json.gz"

HOUSE, APARTMENT = (str(GOLDEN / f"{name}.grid.json.gz") for name in ("house", "apartment"))


@pytest.fixture
def plan(run):
    """Returns a function that runs `navbake path`: status, stdout, stderr."""
    return partial(run, "path")


def test_prints_the_path_that_the_finder_finds(plan):
    status, out, err = plan(HOUSE, "--from", "0,-4.8,L0", "--to", "room:1:1", "--json")
    assert (status, err) == (0, "")
    told = json.loads(out)["path"]
    path = navbake.PathFinder(navbake.load(HOUSE)).find_path((0, -4.8, 0), "room:1:1")
    assert told["length"] == path.length
    assert told["cost"] == path.cost
    assert told["rooms"] == path.rooms
    assert told["doors"] == path.doors
    assert told["positions"] == path.positions.tolist()
    assert told["levels"] == path.levels.tolist()


def test_prints_text(plan):
    status, out, _ = plan(HOUSE, "--from", "0,-4.8,L0", "--to", "room:1:1")
    lines = out.splitlines()
    assert status == 0
    assert lines[0].startswith("length  ") and lines[0].endswith(" m")
    assert re.fullmatch(r"time    \d+\.\d s \(at 1 m/s\)", lines[2])
    assert lines[3].endswith("1:1")
    assert lines[6].split() == ["0.000", "-4.800", "-0.050", "0"]
    assert lines[-1].endswith("  1")


def test_the_nearest_of_several_and_heights(plan):
    out = plan(HOUSE, "--from", "0,-4.8,0", "--to", "-6,5,L0", "--to", "1,-5,0", "--json")[1]
    assert json.loads(out)["path"]["positions"][-1][:2] == [1.0, -5.0]


def test_goals_on_one_level_may_be_typed_with_and_without_z(plan):
    near, far = "0.6,0.6", "-1,-1"
    for goals in ((near, f"{far},0"), (f"{far},0", near)):
        ends = ("--from", "0.5,0.5", "--to", goals[0], "--to", goals[1])
        status, out, err = plan(APARTMENT, *ends, "--json")
        assert (status, err) == (0, "")
        assert json.loads(out)["path"]["positions"][-1][:2] == [0.6, 0.6]
    beside = plan(APARTMENT, "--from", "0.5,0.5", "--to", "99,99", "--to", f"{near},0", "--json")
    assert json.loads(beside[1])["path"]["positions"][-1][:2] == [0.6, 0.6]


def test_places_far_from_the_origin_are_told_to_a_centimetre(run, tmp_path):
    house = navbake.load(HOUSE)
    for level in house.levels:
        x, ground, z = level.min_yup
        level.min_yup = (x + 448_262.0, ground, z - 5_411_932.0)
    house.save(tmp_path / "far.json")
    status, _, err = run(
        "path", tmp_path / "far.json", "--from", "448262.25,5411930.75", "--to", "0,0"
    )
    assert status == 2
    assert "write 448262.25,5411930.75,L0 or 448262.25,5411930.75,L1" in err
    status, _, err = run("why", tmp_path / "far.json", "--at", "0,5411930.75,0")
    assert "lies beside the grid, x 4482" in err and "y 54119" in err and "e+06" not in err


def test_a_path_may_keep_to_the_centres(plan):
    smooth, rough = (
        json.loads(plan(APARTMENT, "--from", "0,0", "--to", "room:bedroom", "--json", *option)[1])
        for option in ([], ["--no-smooth"])
    )
    assert len(rough["path"]["positions"]) > len(smooth["path"]["positions"])


def test_plans_over_links_for_an_agent(plan, run, tmp_path):
    file = tmp_path / "tower.grid.json"
    tower(LIFT, DROP, storeys=3, areas=[(2, 12, 12, 1)]).save(file)
    ends = "--from", "0.25,-0.05,L1", "--to", "0.25,-0.05,L0"
    found = json.loads(plan(file, *ends, "--agent", "person", "--by", "time", "--json")[1])["path"]
    assert (found["links"], found["seconds"]) == (["dock"], pytest.approx(2.6 / 2.0 + 2.0))
    text = plan(file, *ends, "--agent", "person", "--close", "dock")[1]
    assert "links   A\n" in text and "time    " in text
    status, text, _ = plan(file, *ends, "--close", "A", "--close", "dock")
    assert (status, text.endswith("the link 'A' (lift) is closed\n")) == (1, True)
    assert plan(file, *ends, "--close", "A", "--close", "dock", "--open", "A")[0] == 1
    assert "no link 'B' in 'house': it has A, dock" in plan(file, *ends, "--open", "B")[2]
    assert "no agent 'robto'" in plan(file, *ends, "--agent", "robto")[2]
    words = run("info", file)[1].split()
    assert {"links", "areas", "agents", "dock", "drop", "lab", "mud", "person"} <= set(words)
    assert "area" in run("why", file, "1.25,-0.05,L2")[1]
    cell = json.loads(run("why", file, "0.55,-0.05,L0", "--json")[1])["cells"][0]
    assert (cell["links"], cell["area"]) == (["A"], None)


def test_a_radius_replaces_that_of_the_agent(plan, tmp_path):
    file = tmp_path / "tower.grid.json"
    corridor = ["#" * 30, *["." * 30] * 7, "#" * 30]  # an agent of up to 0.35 m fits
    grid = tower(storeys=1, row="\n".join(corridor))
    grid.metadata["navbake"]["agents"] = {"robot": {"radius": 0.4}}
    grid.save(file)
    ends = "--from", "0.5,-0.45", "--to", "2.5,-0.45", "--agent", "robot"
    for option in (), ("--radius", 0.5):
        status, out, err = plan(file, *ends, *option)
        assert (status, err) == (1, "") and "too near" in out
    for radius in (0.0, 0.3):
        assert plan(file, *ends, "--radius", radius)[0] == 0


def test_no_path_is_status_1_with_the_reason(plan):
    status, out, err = plan(HOUSE, "--from", "0,-4.8,L0", "--to", "room:1:1", "--radius", 0.4)
    assert (status, err) == (1, "")
    assert out.startswith("no path: ")
    out = plan(HOUSE, "--from", "99,0,0", "--to", "room:1:1", "--json")[1]
    assert json.loads(out)["path"] is None
    assert "lies beside the grid" in json.loads(out)["reason"]


def test_draws_a_picture(plan, tmp_path):
    picture = tmp_path / "path.png"
    status, out, _ = plan(HOUSE, "--from", "0,-4.8,L0", "--to", "room:1:1", "-o", picture)
    assert status == 0 and out.endswith(f"\n{picture}\n")
    assert picture.read_bytes().startswith(b"\x89PNG")
    empty = tmp_path / "none.png"
    assert plan(HOUSE, "--from", "99,0,0", "--to", "room:1:1", "-o", empty)[0] == 1
    assert empty.read_bytes() != picture.read_bytes()


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
    assert [place["level"] for place in json.loads(out)["cells"]] == [level]
    status, out, _ = run("path", HOUSE, "--from", at, "--to", at, "--json")
    assert status == 0
    assert json.loads(out)["path"]["levels"][0] == level


def test_a_place_without_a_level_is_on_the_only_floor_there(run):
    goal = ("--to", "-2.2,-3.2,L1")
    with_level, without = (
        run("path", HOUSE, "--from", start, *goal, "--json") for start in ("0,-4.8,L0", "0,-4.8")
    )
    assert with_level[0] == 0 and with_level == without


def test_info_and_plot(folder, run):
    run("bake", "room.yaml", "-q")
    status, out, _ = run("info", "room.grid.json")
    assert status == 0
    digest = navbake.load("room.grid.json").navbake["settingsDigest"]
    assert digest in out  # nothing is cut in a pipe
    assert "12 x 8" in out
    status, out, _ = run("info", "room.grid.json", "--json")
    assert (status, json.loads(out)["scene_id"]) == (0, "room")
    status, out, _ = run("plot", "room.grid.json", "-o", "room.png", "--level", "0")
    assert (status, out) == (0, "room.png\n")
    assert (folder / "room.png").read_bytes().startswith(b"\x89PNG")


def test_rooms_and_their_picture(folder, run):
    run("bake", "room.yaml", "-q")
    status, out, _ = run("rooms", "room.grid.json")
    assert status == 0
    header, *rows, last = out.splitlines()
    assert " ".join(header.split()) == "id m2 centroid x y z m from"
    assert last == f"{len(rows)} room{'' if len(rows) == 1 else 's'}"
    status, out, _ = run("rooms", "room.grid.json", "--json")
    listed = json.loads(out)
    assert listed["scene_id"] == "room"
    assert listed["rooms"] == navbake.load("room.grid.json").navbake["rooms"]
    layers = ("--layer", "rooms", "--layer", "clearance")
    status, out, _ = run("plot", "room.grid.json", "-o", "rooms.png", *layers)
    assert (status, out) == (0, "rooms.png\n")
    assert (folder / "rooms.png").read_bytes().startswith(b"\x89PNG")


def test_pictures_end_as_they_are(folder, run):
    run("bake", "room.yaml", "-q")
    status, out, _ = run("plot", "room.grid.json", "-o", "room.svg", "--layer", "doors")
    assert (status, out) == (0, "room.svg\n")
    assert b"<svg" in (folder / "room.svg").read_bytes()
    status, _, err = run("plot", "room.grid.json", "-o", "room.png", "--layer", "heat")
    assert status == 2
    assert all(layer in " ".join(err.split()) for layer in ("occupancy", "doors", "links", "heat"))


def test_pictures_for_papers(folder, run):
    run("bake", "room.yaml", "-q")
    (folder / "places.json").write_text(run("sample", "room.grid.json", "--json", "-n", "3")[1])
    lattice = navbake.load("room.grid.json").lattice
    x_min, y_min, x_max, y_max = lattice.bounds
    bounds = f"{x_min},{y_min},{(x_min + x_max) / 2},{(y_min + y_max) / 2}"
    points = ("--points", "places.json", "--points", f"{x_min + 0.1},{y_min + 0.1}")
    status, _, err = run(
        "plot", "room.grid.json", "-o", "a.pdf", "--bounds", bounds, "--no-title", *points
    )
    assert (status, err) == (0, "")
    assert (folder / "a.pdf").read_bytes().startswith(b"%PDF")
    for dpi in ("100", "200"):
        assert run("plot", "room.grid.json", "-o", f"{dpi}.png", "--dpi", dpi)[0] == 0
    sizes = [Image.open(folder / f"{dpi}.png").size for dpi in (100, 200)]
    assert sizes[1] == pytest.approx((2 * sizes[0][0], 2 * sizes[0][1]), abs=2)
    marked, plain = (
        run("plot", "room.grid.json", "-o", "b.png", "--layer", "rooms", *more)[0]
        or (folder / "b.png").read_bytes()
        for more in (points, ())
    )
    assert marked != plain
    status, _, err = run("plot", "room.grid.json", "-o", "a.png", "--bounds", "1,2,3")
    assert status == 2 and "X0,Y0,X1,Y1" in err
    (folder / "other.json").write_text("{}")
    status, _, err = run("plot", "room.grid.json", "-o", "a.png", "--points", "other.json")
    assert status == 1 and "expected what `navbake sample --json` prints in other.json" in err
    assert run("plot", "room.grid.json", "-o", "a.gif")[0] == 2


def test_doors_are_listed_with_their_states(folder, run):
    box = '<body name="box" pos="1.5 1.5 0.5"><geom type="box" size="0.1 0.1 0.1"/></body>'
    (folder / "doors.xml").write_text(world(ROOMS, LEAF, box))
    run("bake", "doors.xml", "-q", "--set", "doors.state=open", "--set", "doors.patterns=[box]")
    expected = {
        "id": "leaf",
        "joint": "leaf",
        "rooms": ["0:1", "0:2"],
        "levels": [0],
        "state": "open",
        "like": None,
        "states": ["modelled", "open", "closed", "removed"],
        "width": 0.86,
    }
    for command in ("info", "rooms"):
        status, out, _ = run(command, "doors.grid.json", "--json")
        assert (status, json.loads(out)["doors"][0]) == (0, expected)
        *_, header, row, other = run(command, "doors.grid.json")[1].splitlines()
        assert header.split() == ["door", "joint", "joins", "is", "can", "be"]
        cells = "leaf leaf 0:1 - 0:2 open modelled, open, closed, removed"
        assert " ".join(row.split()) == cells
        expected_other = "box none nothing open modelled, open, closed, removed"
        assert " ".join(other.split()) == expected_other


def test_a_path_may_be_planned_with_all_doors_open(folder, run, plan):
    (folder / "rooms.xml").write_text(world(ROOMS, LEAF))
    run("bake", "rooms.xml", "-q")
    through_the_door = ("rooms.grid.json", "--from", "1,1.5", "--to", "5,1.5", "--json")
    status, out, _ = plan(*through_the_door)
    assert status == 1
    hint = "is in the way; `--doors open` opens all doors, `--doors NAME=open` one"
    assert json.loads(out)["reason"].endswith(hint)
    status, out, _ = plan(*through_the_door, "--doors", "open", "--radius", "0.1")
    assert (status, json.loads(out)["path"]["doors"]) == (0, ["leaf"])
    reason = json.loads(plan(*through_the_door, "--doors", "closed")[1])["reason"]
    assert "(closed)" in reason and "--doors" not in reason
    too_wide = json.loads(plan(*through_the_door, "--radius", "0.6")[1])["reason"]
    assert "--doors" not in too_wide
    run("inflate", "rooms.grid.json", "0", "-o", "point.grid.json")
    status, out, _ = plan("point.grid.json", *through_the_door[1:])
    reason = json.loads(out)["reason"]
    assert status == 1 and "is in the way" in reason and "--doors" not in reason


def test_the_last_state_of_a_door_counts(folder, run, plan):
    (folder / "rooms.xml").write_text(world(ROOMS, LEAF))
    run("bake", "rooms.xml", "-q")
    through_the_door = ("rooms.grid.json", "--from", "1,1.5", "--to", "5,1.5", "--doors")
    assert plan(*through_the_door, "leaf=open")[0] == 0
    assert plan(*through_the_door, "closed", "--doors", "leaf=open")[0] == 0
    assert plan(*through_the_door, "open", "--doors", "leaf=closed")[0] == 1
    assert plan(*through_the_door, "leaf=closed", "--doors", "open")[0] == 0


def test_a_level_is_named_by_its_number_or_its_name(run, tmp_path):
    grid = navbake.load(GOLDEN / "house.grid.json.gz")
    grid.metadata["navbake"]["levels"][1]["name"] = "first floor"
    grid.save(tmp_path / "house.json")
    places = [
        run("sample", tmp_path / "house.json", "-n", 3, "--json", "--level", level)[1]
        for level in ("first floor", "1")
    ]
    assert places[0] == places[1]
    assert {place["level"] for place in json.loads(places[0])["places"]} == {1}


def test_why_names_what_is_lower_than_a_step(folder, run):
    crate = '<geom type="box" size="0.3 0.3 {half}" pos="1.5 1.5 {half}"/>'
    for name, half_height in (("low", 0.1), ("high", 0.2)):
        body = f'<body name="crate"><freejoint/>{crate.format(half=half_height)}</body>'
        (folder / f"{name}.xml").write_text(world(ROOMS, body))
        run("bake", f"{name}.xml", "-q")
    out = run("why", "low.grid.json", "1.5,1.5")[1]
    assert "verdict            an agent can stand here, as what is lower than a step is" in out
    assert "lower than a step  crate" in out.splitlines()
    assert "lower than a step" not in run("why", "high.grid.json", "1.5,1.5")[1]
    assert "lower than a step" not in run("why", "low.grid.json", "1,1")[1]


def test_a_door_between_closed_and_open_is_half_open(run):
    out = run("rooms", GOLDEN / "apartment.grid.json.gz")[1]
    states = {row.split()[0]: row for row in out.splitlines() if row.startswith("door_")}
    assert "modelled (half-open)" in states["door_kitchen"]
    assert "modelled (open)" in states["door_bedroom"]


def test_a_report_of_two_bakes(folder, run):
    run("bake", "room.yaml", "-q")
    run("bake", "room.yaml", "-o", "other.grid.json", "--set", "agent.radius=0.3", "-q")
    status, out, _ = run(
        "report", "room.grid.json", "other.grid.json", "-o", "report.html", "--audit"
    )
    assert (status, out) == (0, "report.html\n")
    assert b"<title>room, other</title>" in (folder / "report.html").read_bytes()


def test_a_verification_is_added(folder, run):
    run("bake", "room.yaml", "-q")
    _, out, _ = run("verify", "room.grid.json", "--json")
    (folder / "verify.json").write_text(out)
    arguments = ("room.grid.json", "-o", "report.html", "--verify", "verify.json")
    assert run("report", *arguments)[0] == 0
    assert b"Verification: agrees" in (folder / "report.html").read_bytes()
    status, _, err = run("report", "room.grid.json", *arguments)
    assert status == 2
    assert "expected one for each GRID, 2, got 1" in err


def test_sample_draws_places_by_room_and_apart(run):
    arguments = "sample", HOUSE, "-n", 5, "--room", "0:2", "--spread", 0.8, "--json"
    status, out, _ = run(*arguments)
    assert status == 0 and run(*arguments)[1] == out
    facts = json.loads(out)
    assert facts["scene_id"] == "house"
    finder = navbake.PathFinder(navbake.load(HOUSE))
    positions = np.array([place["position"] for place in facts["places"]])
    assert finder.is_navigable(positions).all()
    assert {place["room"] for place in facts["places"]} == {"0:2"}
    gaps = np.linalg.norm(positions[:, None] - positions, axis=2)[~np.eye(5, dtype=bool)]
    assert gaps.min() >= 0.8 - 1e-9


def test_sample_keeps_indoors_and_prints_a_table(run):
    status, out, _ = run("sample", HOUSE, "-n", 60, "--no-outdoors", "--seed", 3)
    lines = out.splitlines()
    assert status == 0 and len(lines) == 61
    assert lines[0].split() == ["x", "m", "y", "m", "z", "m", "heading", "rad", "level", "room"]
    outdoors = {room.id for room in navbake.load(HOUSE).rooms if room.outdoors}
    assert not outdoors & {line.split()[-1] for line in lines[1:]}
    status, _, err = run("sample", HOUSE, "--room", "kitchn")
    assert status == 1 and "no room 'kitchn'" in err


def test_sample_keeps_indoors_and_apart(run):
    status, out, _ = run("sample", HOUSE, "-n", 20, "--no-outdoors", "--spread", 0.8, "--json")
    outdoors = {room.id for room in navbake.load(HOUSE).rooms if room.outdoors}
    assert status == 0
    assert not outdoors & {place["room"] for place in json.loads(out)["places"]}


def test_sample_keeps_indoors_of_grids_without_a_yard_or_without_a_house(run, tmp_path):
    """Nothing is outdoors without rooms: places are drawn with `--spread` as without."""
    field = level_from("....\n....", cell_size=0.5)
    field.save(tmp_path / "field.json")
    for spread in ((), ("--spread", 0.5)):
        status, out, err = run("sample", tmp_path / "field.json", "-n", 2, "--no-outdoors", *spread)
        assert (status, len(out.splitlines()), err) == (0, 3, "")
    field.attributes["roomIndex"] = np.ones(field.shape, dtype=np.uint16)
    yard = {"sceneId": "yard", "navbake": {"rooms": [{**room(0, 1, "yard"), "outdoors": True}]}}
    field.with_layers(metadata=yard).save(tmp_path / "yard.json")
    arguments = "sample", tmp_path / "yard.json", "--no-outdoors"
    assert "no room of 'yard' is indoors" in run(*arguments, "--spread", 0.5)[2]
    assert "no free cell in 'yard' with outdoors left out" in run(*arguments)[2]
    err = run(*arguments, "--level", 0)[2]
    assert "no free cell in 'yard' with level 0, outdoors left out" in err


def test_stand_prints_poses_from_which_a_base_reaches_a_thing(run):
    arguments = ["stand", APARTMENT, "object:vase", "--radius", 0.15, "--from", "0.5,0.4", "-n", 5]
    status, out, _ = run(*arguments, "--footprint", "0.4,0.3")
    assert status == 0
    finder = navbake.PathFinder(navbake.load(APARTMENT).inflate(0.15))
    base = [(0.2, 0.15), (-0.2, 0.15), (-0.2, -0.15), (0.2, -0.15)]
    poses = finder.stand_poses("object:vase", footprint=base, start=(0.5, 0.4), count=5)
    rows = [line.split() for line in out.splitlines()[1:]]
    assert [row[0] for row in rows] == ["vase"] * 5
    numbers = np.array([row[1:] for row in rows], dtype=float)
    np.testing.assert_allclose(numbers[:, :3], poses.positions, atol=6e-4)
    np.testing.assert_allclose(numbers[:, 3], poses.headings, atol=6e-4)
    np.testing.assert_allclose(numbers[:, 5], poses.path_lengths, atol=6e-4)


def test_stand_writes_poses_and_draws_them(run, tmp_path):
    arguments = ["stand", APARTMENT, "category:dining_chair", "1.8,-1.0,0.5", "-n", 2]
    status, out, _ = run(*arguments, "--eye", 1.0, "--no-facing", "-o", tmp_path / "poses.json")
    content = json.loads((tmp_path / "poses.json").read_text())
    assert status == 0 and len(out.splitlines()) == 2 + len(content["poses"]) == 12
    assert out.endswith("poses.json\n")
    assert {pose["target"] for pose in content["poses"]} >= {"dining_chair_4", "1.8, -1, 0.5"}
    assert content["why_not"] == {} and content["poses"][0]["path_length"] is None
    status, out, _ = run(*arguments, "--no-sight", "--json", "-o", tmp_path / "poses.png")
    assert status == 0 and json.loads(out)["scene_id"] == "apartment"
    assert (tmp_path / "poses.png").read_bytes().startswith(b"\x89PNG")


def test_stand_says_in_a_line_why_there_is_no_pose(run):
    status, out, _ = run("stand", APARTMENT, "object:dining_lamp", "--radius", 0.2)
    reason = (
        "no cell at 0.3 to 0.8 m from dining_lamp is free for a radius of 0.2 m: the nearest free "
        "cell is at 0.88 m"
    )
    assert status == 1 and out == f"no pose: {reason}\n"
    status, out, _ = run("stand", APARTMENT, "object:dining_lamp", "object:sofa", "--radius", 0.2)
    assert status == 0 and out.endswith(f"no pose: {reason}\n")
    status, out, _ = run("stand", APARTMENT, "object:vase", "--height", 4)
    assert "to 0.8 m from vase, measured from a shoulder 4 m above the floor, is free" in out
    status, _, err = run("stand", APARTMENT, "object:sofa", "--from", "30,30")
    assert status == 1 and "the start (30.00, 30.00) lies beside the grid" in err
    assert "the nearest free cell is at" in err
    status, _, err = run("stand", APARTMENT, "object:sofaa")
    assert status == 1 and "did you mean 'sofa'" in err


def test_stand_tells_that_an_open_door_helps(run, tmp_path):
    navbake.load(APARTMENT).with_doors("closed").save(tmp_path / "closed.json")
    arguments = ["object:fridge", "--radius", 0.15, "--from", "0.5,0.4"]
    status, out, _ = run("stand", tmp_path / "closed.json", *arguments)
    assert status == 1 and out.startswith("no pose: no path leads from the start")
    assert out.endswith("`--doors open` opens all doors: then there is a pose\n")
    status, out, _ = run("stand", APARTMENT, *arguments, "--doors", "closed")
    assert status == 1 and "--doors" not in out
    assert run("stand", tmp_path / "closed.json", *arguments, "--doors", "open")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sofa"], "expected object:NAME, category:NAME or X,Y[,Z|,LEVEL], got 'sofa'"),
        (["object:sofa", "--reach", "0.8"], "expected two lengths in metres as in 0.3,0.8"),
        (["object:sofa", "--footprint", "0.4,x"], "expected two lengths in metres"),
        (["object:sofa", "-o", "poses.txt"], "expected a name that ends in .json, .png, .svg"),
    ],
)
def test_stand_refuses_what_it_does_not_understand(run, arguments, message):
    status, _, err = run("stand", APARTMENT, *arguments)
    assert status == 2 and message in err


def test_rooms_says_why_there_are_none_and_what_helps(folder, run):
    house = navbake.load(HOUSE)
    assert house.convert("map.yaml", level=0)
    assert run("convert", "map.yaml", "map.grid.json")[0] == 0
    status, out, _ = run("rooms", "map.grid.json")
    first, bake = re.findall(r"`navbake ([^`]+)`", out)
    assert status == 0 and out.startswith("no rooms: the grid was made of a map")
    assert run(*first.split())[0] == 0
    assert run(*bake.split(), "-o", "walls.grid.json", "-q")[0] == 0
    assert len(navbake.load("walls.grid.json").rooms) > 1
    assert json.loads(run("rooms", "map.grid.json", "--json")[1])["reason"] in out
    run("bake", "room.yaml", "--set", "rooms=none", "-q")
    assert "`rooms.polygons` in the settings draws rooms" in run("rooms", "room.grid.json")[1]
    assert json.loads(run("rooms", HOUSE, "--json")[1])["reason"] is None
