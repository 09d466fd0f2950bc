"""The room table of a file, and what is told of files without one."""

import tracemalloc

import numpy as np
import pytest

from navbake.errors import FormatError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.rooms import Neighbour, Room, parse_rooms

ROOM = {
    "index": 1,
    "id": "hall",
    "name": "hall",
    "level": 0,
    "area": 2.0,
    "centroid": [1.0, 2.0, 0.0],
    "source": "geoms",
    "neighbours": [{"room": "0:2", "door": None, "kind": "open"}],
}


def make_level(index, ground=0.0, unit=1.0, **metadata):
    index = np.array(index, dtype=np.uint16)
    return SceneGrid2D(
        width=index.shape[1],
        height=index.shape[0],
        cell_size=0.5,
        unit=unit,
        min_yup=(0.0, ground, -1.0),
        weights=np.ones(index.shape),
        attributes={"roomIndex": index},
        metadata=metadata,
    )


def test_what_the_file_tells_by_level_and_index():
    other = {**ROOM, "index": 2, "id": "0:2", "name": None, "neighbours": []}
    grid = make_level([[1, 2]], navbake={"rooms": [other, ROOM]})
    assert [room.to_json() for room in grid.rooms] == [ROOM, other]
    assert grid.rooms[0] == Room(
        index=1,
        id="hall",
        name="hall",
        level=0,
        area=2.0,
        centroid=(1.0, 2.0, 0.0),
        source="geoms",
        neighbours=(Neighbour("0:2", "open", None),),
    )
    assert grid.rooms is grid.rooms  # parsed once


def test_another_table_is_parsed_anew():
    grid = make_level([[1, 2]], navbake={"rooms": [ROOM]})
    assert [room.id for room in grid.rooms] == ["hall"]
    grid.metadata["navbake"] = {"rooms": [{**ROOM, "id": "den"}]}
    assert [room.id for room in grid.rooms] == ["den"]


def test_what_entries_may_leave_out():
    ways = [{"room": "0:2"}, {"room": "0:3", "kind": "door", "door": "gate"}]
    stated = {key: value for key, value in ROOM.items() if key != "source"}
    (room,) = parse_rooms([{**stated, "neighbours": ways}], 1)
    assert room.source is None
    assert room.neighbours == (Neighbour("0:2", "open", None), Neighbour("0:3", "door", "gate"))


def test_files_without_a_table():
    low = make_level([[0, 3, 3], [0, 1, 3]], ground=-1.0, unit=2.0)
    grid = MultiLevelGrid(grids=[low, make_level([[2]], ground=3.0)], cell_size=0.5)
    one, three, two = grid.rooms
    assert (one.level, one.index, one.id, one.name) == (0, 1, "0:1", None)
    assert one.centroid == (1.5, 0.5, -2.0)  # cells of 1 m, as a unit is 2 m
    assert (three.area, three.neighbours, three.source) == (3.0, (), None)
    assert (two.id, two.centroid[2]) == ("1:2", 3.0)


def test_no_rooms():
    assert make_level([[0, 0]]).rooms == ()
    assert make_level([[1, 0]], navbake={"rooms": []}).rooms == ()


def test_a_large_map_without_rooms_takes_no_memory_for_them():
    level = make_level(np.zeros((1000, 1000)))
    assert not level.room_index.any()
    tracemalloc.start()
    try:
        assert level.rooms == ()
        assert tracemalloc.get_traced_memory()[1] < 3e6  # places of cells would take 24 MB
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("rooms", "culprit"),
    [
        ({}, "expected `array`, got `object` at `metadata.navbake.rooms`"),
        ([7], r"expected `object`, got `int` at `metadata.navbake.rooms\[0\]`"),
        ([{**ROOM, "index": True}], r"rooms\[0\].index"),
        ([{**ROOM, "index": 0}], r"a level of the grid and an index >= 1"),
        ([{**ROOM, "level": 1}], r"a level of the grid and an index >= 1"),
        (
            [ROOM, {**ROOM, "id": None}],
            r"`str`, got `null` at `metadata.navbake.rooms\[1\].id`",
        ),
        ([{**ROOM, "centroid": [1.0]}], r"rooms\[0\].centroid"),
        ([{**ROOM, "centroid": ["x", 0, 0]}], r"rooms\[0\].centroid"),
        ([{**ROOM, "neighbours": ["hall"]}], r"rooms\[0\].neighbours"),
        ([{**ROOM, "area": "2"}], r"rooms\[0\].area"),
    ],
)
def test_broken_tables(rooms, culprit):
    with pytest.raises(FormatError, match=culprit):
        _ = make_level([[1]], navbake={"rooms": rooms}).rooms


def test_a_room_may_lack_its_name():
    entry = {
        "index": 1, "id": "a", "level": 0, "area": 1, "centroid": [0, 0, 0], "neighbours": [],
    }  # fmt: skip
    (room,) = parse_rooms([entry], 1)
    assert room.name is None and room.to_json()["name"] is None
