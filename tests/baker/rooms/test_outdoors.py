"""What is outdoors: open floor at the edge of the scene, as rooms, files and commands tell it."""

from __future__ import annotations

import json

import numpy as np
import pytest

import navbake
from box_worlds import box, stages_of_xml, world
from navbake.cli.main import main

HIGH = 2.6  # of walls [m]


def wall(x0, y0, x1, y1, doors=()):
    """A wall, drawn in pieces between its doors, which are ranges along its longer side."""
    along_x = x1 - x0 > y1 - y0
    ends = [x0 if along_x else y0, *(v for door in doors for v in door), x1 if along_x else y1]
    return "".join(
        box("", a, y0, 0, b, y1, HIGH) if along_x else box("", x0, a, 0, x1, b, HIGH)
        for a, b in zip(ends[::2], ends[1::2], strict=True)
    )


def house(x0, y0, x1, y1, doors=()):
    """Four walls of 0.2 m; doors are in the lower one."""
    return (
        wall(x0, y0, x1, y0 + 0.2, doors)
        + wall(x0, y1 - 0.2, x1, y1)
        + wall(x0, y0 + 0.2, x0 + 0.2, y1 - 0.2)
        + wall(x1 - 0.2, y0 + 0.2, x1, y1 - 0.2)
    )


def slab(x0, y0, x1, y1, z=0.0):
    return box("", x0, y0, z - 0.1, x1, y1, z)


GARDEN = slab(0, 0, 12, 10) + house(3, 3, 9, 8, [(5, 5.9)])


@pytest.fixture
def rooms(tmp_path):
    """Returns a function that finds the rooms of a scene: area and whether outdoors, by area."""

    def find(content, **settings):
        stages = stages_of_xml(tmp_path, world(content), **settings)
        return sorted((round(room.area), room.outdoors) for room in stages.rooms.table)

    return find


@pytest.mark.parametrize("roof", ["", slab(3, 3, 9, 8, HIGH + 0.1)])
def test_a_house_in_its_garden(rooms, roof):
    """Outdoors is one region round it, a roof or none."""
    assert rooms(GARDEN + roof) == [(26, False), (90, True)]


def test_what_lies_beyond_nothing_reaches_the_edge(rooms):
    """The scene is larger than the garden: a mast stands away from it."""
    assert rooms(GARDEN + box("", 20, 5, 0, 20.1, 5.1, 3)) == [(26, False), (90, True)]


def test_doors_at_the_edge_open_no_room_to_outdoors(rooms):
    """A hall without a ceiling; its doors together are wider than what is outdoors reaches."""
    doors = [(1, 2), (4.5, 5.5), (8, 9)]
    assert rooms(slab(0, 0, 10, 8) + house(0, 0, 10, 8, doors)) == [(74, False)]


def test_pillars_between_doors_make_no_wide_opening(rooms):
    """The pillars are too short for walls, so the room goes on under them."""
    doors = [(5.6, 6.5), (7.0, 7.9), (8.3, 9.2)]
    scene = slab(4, 0, 12, 8) + house(4, 0, 12, 8, doors)
    assert [is_out for _, is_out in rooms(scene)] == [False]
    wide = slab(4, 0, 12, 8) + house(4, 0, 12, 8, [(5.6, 9.2)])
    assert [is_out for _, is_out in rooms(wide)] == [True]


def test_rooms_without_ceiling_are_not_one_through_their_doors(rooms):
    doors = [(0.5, 1.4), (2, 2.9), (3.5, 4.4), (5.6, 6.5), (7, 7.9), (8.5, 9.4)]
    scene = slab(0, 0, 10, 8) + house(0, 0, 10, 8, doors) + wall(4.9, 0.2, 5.1, 7.8)
    assert rooms(scene) == [(36, False), (37, False)]


def test_walls_part_two_gardens(rooms):
    """A row of houses from edge to edge, gardens on both sides."""
    row = house(0, 4, 6, 8, [(2, 2.9)]) + house(5.8, 4, 12, 8, [(8, 8.9)])
    assert rooms(slab(0, 0, 12, 12) + row) == [(20, False), (21, False), (48, True), (48, True)]
    # on endless ground one walks round the row
    endless = '<geom type="plane" size="0 0 1"/>'
    front = box("post", 6, 0, 0, 6.1, 0.1, 1) + box("post 2", 6, 11.9, 0, 6.1, 12, 1)
    assert [area for area, is_out in rooms(endless + row + front) if is_out] == [96]


def test_a_ditch_parts_no_outdoors(rooms):
    """A trench with steep banks through a field, from edge to edge; its bottom is outdoors, too."""
    bank = '<geom type="box" pos="{x} 5 -.6" size=".9 5 .05" euler="0 {turn} 0"/>'
    banks = bank.format(x=4.5, turn=60) + bank.format(x=7.5, turn=-60)
    field = slab(0, 0, 4, 10) + slab(8, 0, 12, 10) + box("", 5, 0, -1.5, 7, 10, -1.4)
    found = rooms(field + banks)
    assert len(found) == 1 and found[0][1] and found[0][0] >= 80


def test_what_is_under_eaves_is_outdoors(rooms):
    """A house with its roof 0.9 m over its walls, up to the edge; a roof over a deep porch."""
    around = slab(0, 0, 10, 8) + house(0.9, 0.9, 9.1, 7.1, [(4, 4.9)])
    assert rooms(around + slab(0, 0, 10, 8, HIGH + 0.1)) == [(29, True), (45, False)]
    porch = slab(0, 0, 10, 8) + wall(0, 7.8, 10, 8) + wall(0, 0, 0.2, 7.8) + wall(9.8, 0, 10, 7.8)
    assert [is_out for _, is_out in rooms(porch + slab(0, 0, 10, 8, HIGH + 0.1))] == [False]
    assert [is_out for _, is_out in rooms(porch)] == [True]


def test_a_window_of_the_scene_makes_no_room_outdoors(rooms):
    """A strip of a hall under its ceiling is cut out; the hall goes on beyond it."""
    hall = slab(0, 0, 10, 8) + house(0, 0, 10, 8) + slab(0, 0, 10, 8, HIGH + 0.1)
    assert rooms(hall) == [(73, False)]
    given = {"grid": {"bounds": [1, 3, 9, 5]}, "levels": [{"ground": 0.0, "top": 2.0}]}
    assert [is_out for _, is_out in rooms(hall, **given)] == [False]


def test_outdoors_in_the_file_and_in_the_commands(tmp_path, capsys):
    """Stated where it is true, and nowhere else; written and read again."""

    def run(*arguments):
        with pytest.raises(SystemExit) as caught:
            main([str(argument) for argument in arguments])
        assert not caught.value.code
        return capsys.readouterr().out

    stages = stages_of_xml(tmp_path, world(GARDEN))
    table = {room.outdoors: room for room in stages.rooms.table}
    assert sorted(table) == [False, True]
    path = tmp_path / "garden.grid.json"
    navbake.bake({"scene": {"path": str(tmp_path / "scene.xml")}}).save(path)
    metadata = json.loads(path.read_text())["metadata"]["navbake"]["rooms"]
    assert {entry["id"]: entry.get("outdoors") for entry in metadata} == {
        table[False].id: None,
        table[True].id: True,
    }
    grid = navbake.load(path)
    assert {room.id: room.outdoors for room in grid.rooms} == {
        room.id: room.outdoors for room in stages.rooms.table
    }
    again = tmp_path / "again.grid.json"
    grid.save(again)
    assert navbake.load(again).rooms == grid.rooms
    listed = {line.split()[0]: line for line in run("rooms", path).splitlines()}
    assert "auto, outdoors" in listed[table[True].id]
    assert "outdoors" not in listed[table[False].id]
    by_id = {entry["id"]: entry for entry in json.loads(run("rooms", path, "--json"))["rooms"]}
    assert by_id[table[True].id]["outdoors"] is True
    assert "outdoors" not in by_id[table[False].id]
    (level,) = json.loads(run("info", path, "--json"))["levels"]
    assert level["num_rooms"] == 2
    assert np.unique(grid.room_index).tolist() == [0, 1, 2]
