"""What is outdoors: open floor at the edge of the scene, as rooms, files and commands tell it."""

from __future__ import annotations

import json
from itertools import permutations

import numpy as np
import pytest

import navbake
from box_worlds import box, stages_of_xml, world
from navbake.baker.core import level_stacks
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


def bake_front_door(tmp_path, out, more="", width=6, **settings):
    """A house of 6 m by 4 m with a door, on a slab that sticks out of its walls."""
    leaf = (
        '<body name="door" pos="2.5 .1 0"><joint name="hinge" type="hinge" axis="0 0 1" '
        'range="0 86"/><geom type="box" pos=".5 0 1" size=".48 .02 1"/></body>'
    )
    ground = slab(-out, -out, width + out, 4 + out)
    content = ground + house(0, 0, width, 4, [(2.5, 3.5)]) + leaf + more
    path = tmp_path / "scene.xml"
    path.write_text(world(content), encoding="utf-8")
    return navbake.bake({"scene": {"path": str(path)}, **settings})


def doors_between(grid):
    """Which rooms doors join, as the doors, the table of rooms and the graph tell alike."""
    told = {(*ends, door.id) for door in grid.doors for ends in permutations(door.rooms)}
    neighbours = {(room.id, n.room, n.door) for room in grid.rooms for n in room.neighbours}
    assert neighbours == {way for way in told if None not in way} | {
        way for way in neighbours if way[2] is None
    }
    for state, passable in (("open", True), ("closed", False)):
        ways = [w for w in grid.with_doors(state).to_graph("rooms").ways if w.door]
        assert {(*ends, w.door) for w in ways for ends in permutations(w.rooms)} == told
        assert all(way.passable is passable for way in ways)
    return sorted(told)


@pytest.mark.parametrize("out", [0.2, 0.3, 0.5, 0.8])
def test_a_door_to_a_ledge_joins_it_to_the_room(tmp_path, out):
    grid = bake_front_door(tmp_path, out)
    assert [room.outdoors for room in grid.rooms] == [True, False]
    ledge = (6 + 2 * out) * (4 + 2 * out) - 24
    assert grid.rooms[0].area == pytest.approx(ledge + 0.1, abs=0.01)  # with half the doorway
    assert doors_between(grid) == [("0:1", "0:2", "door"), ("0:2", "0:1", "door")]


@pytest.mark.parametrize("mark", ["polygon", "site"])
def test_a_mark_in_a_room_leaves_its_door_and_outdoors(tmp_path, mark):
    """The ledge is nowhere half a metre wide, with the mark as without it."""
    before = bake_front_door(tmp_path, 0.3)
    site = '<site name="room_q" type="box" pos="4.5 2.5 1" size=".5 .5 1"/>'
    polygon = {"name": "room_q", "points": [[4, 2], [5, 2], [5, 3], [4, 3]]}
    if mark == "site":
        after = bake_front_door(tmp_path, 0.3, site)
    else:
        after = bake_front_door(tmp_path, 0.3, rooms={"polygons": [polygon]})
    assert doors_between(after) == doors_between(before)
    marked = after.rooms[-1]
    assert (marked.id, marked.area, marked.outdoors) == ("room_q", 1.0, False)
    index = np.where(after.room_index == marked.index, 2, after.room_index)
    np.testing.assert_array_equal(index, before.room_index)


def test_rooms_that_went_through_a_geojson_file_are_the_same(tmp_path):
    before = bake_front_door(tmp_path, 0.8)
    drawn = tmp_path / "rooms.geojson"
    drawn.write_text(json.dumps(before.to_geojson()), encoding="utf-8")
    after = bake_front_door(tmp_path, 0.8, rooms={"from": ["polygons", "auto"], "polygons": drawn})
    np.testing.assert_array_equal(after.room_index, before.room_index)
    assert [(room.source, room.outdoors) for room in after.rooms] == [
        ("polygons", True),
        ("polygons", False),
    ]
    assert doors_between(after) == doors_between(before)


@pytest.mark.parametrize("roof", ["", slab(0, 0, 6, 4, HIGH + 0.1)], ids=["open", "roofed"])
@pytest.mark.parametrize(("out", "cell"), [(0.1, 0.1), (0.1, 0.05), (0.05, 0.05)])
def test_a_ledge_of_a_cell_or_two_takes_no_room_outdoors(tmp_path, roof, out, cell):
    """Its four sides are each smaller than a room; the one before the door opens to the room."""
    grid = bake_front_door(tmp_path, out, roof, grid={"cell_size": cell})
    ledge = (6 + 2 * out) * (4 + 2 * out) - 24
    (area, is_out), (inside, is_in_out) = ((room.area, room.outdoors) for room in grid.rooms)
    assert (is_out, is_in_out) == (True, False)
    assert area == pytest.approx(ledge + 0.1, abs=0.06)
    assert inside == pytest.approx(5.6 * 3.6 + 0.1, abs=0.06)
    assert doors_between(grid) == [("0:1", "0:2", "door"), ("0:2", "0:1", "door")]


def test_a_ledge_that_is_too_small_for_a_room_is_none(tmp_path):
    """Less than 1 m² in all; the door leads outside."""
    grid = bake_front_door(tmp_path, 0.05, width=4, grid={"cell_size": 0.05})
    (room,) = grid.rooms
    assert (room.outdoors, room.area) == (False, pytest.approx(3.6 * 3.6 + 0.1, abs=0.06))
    (door,) = grid.doors
    assert set(door.rooms) == {None, "0:1"}


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


def test_rooms_of_levels_in_one_stack_are_those_of_each_level_alone(tmp_path, monkeypatch):
    """A house in its garden, with a shaft that is no room; and once more over it, under a roof."""
    shaft = house(5.8, 4.8, 7.4, 6.4)
    storey = GARDEN + shaft
    upper_storey = f'<body pos="0 0 {HIGH + 0.1}">{storey}</body>'
    content = world(storey + upper_storey + slab(0, 0, 12, 10, 2 * HIGH + 0.2))
    together = stages_of_xml(tmp_path, content).rooms
    monkeypatch.setattr(level_stacks, "MAX_STACK_CELLS", 1)
    apart = stages_of_xml(tmp_path, content).rooms
    for rooms in (together, apart):
        assert [room.outdoors for room in rooms.table] == 2 * [True, False, False]
        np.testing.assert_array_equal(rooms.index[0], rooms.index[1])
        assert rooms.index[0][44, 66] == 0  # in the shaft
    assert together.table == apart.table
