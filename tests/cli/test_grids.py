"""The commands `navbake info`, `rooms` and `plot`; `why` is tested with its view."""

import json

import navbake
from door_scenes import LEAF, ROOMS, world


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
    }
    for command in ("info", "rooms"):
        status, out, _ = run(command, "doors.grid.json", "--json")
        assert (status, json.loads(out)["doors"][0]) == (0, expected)
        *_, header, row, other = run(command, "doors.grid.json")[1].splitlines()
        assert header.split() == ["door", "joint", "joins", "is", "can", "be"]
        cells = "leaf leaf 0:1 - 0:2 open modelled, open, closed, removed"
        assert " ".join(row.split()) == cells
        expected_other = "box none nothing modelled (closed) modelled, closed, removed"
        assert " ".join(other.split()) == expected_other
