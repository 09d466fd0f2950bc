"""Rooms by name, and the room of each cell."""

from __future__ import annotations

import numpy as np
import pytest

from navbake.errors import QueryError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.runtime.flat_grid import map_rooms


def make_level(index):
    index = np.array(index, dtype=np.uint16)
    height, width = index.shape
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=0.5,
        min_yup=(0.0, 0.0, 0.0),
        weights=np.ones(index.shape),
        attributes={"roomIndex": index},
    )


def room(level, index, id, name=None):
    return {
        "level": level,
        "index": index,
        "id": id,
        "name": name,
        "area": 1.0,
        "centroid": [0.0, 0.0, 0.0],
        "neighbours": [],
    }


def make_house(rooms):
    grids = [make_level([[1, 1, 0], [2, 2, 2]]), make_level([[0, 1]])]
    metadata = {"sceneId": "house", "navbake": {"rooms": rooms}}
    return MultiLevelGrid(grids=grids, cell_size=0.5, metadata=metadata)


TABLE = [room(0, 1, "a", "kitchen"), room(0, 2, "b", "bath"), room(1, 1, "c", "bath")]


def test_rooms_go_by_id_and_by_a_name_that_is_theirs_alone():
    rooms = map_rooms(make_house(TABLE))
    assert rooms.number.tolist() == [1, 1, 0, 2, 2, 2, 0, 3]
    assert rooms.number.dtype == np.int32
    assert [rooms.find(name) for name in ("a", "kitchen", "b", "c")] == [1, 1, 2, 3]
    assert rooms.cells("c").tolist() == [7]
    assert [rooms.id_of(number) for number in range(4)] == [None, "a", "b", "c"]


def test_a_name_of_several_rooms_is_refused_with_their_ids():
    with pytest.raises(QueryError, match=r"2 rooms in 'house' have the name 'bath': .* b, c$"):
        map_rooms(make_house(TABLE)).find("bath")


def test_an_unknown_room_is_refused_with_a_near_one():
    with pytest.raises(QueryError, match=r"no room 'kichen' in 'house': did you mean 'kitchen'\?"):
        map_rooms(make_house(TABLE)).find("kichen")
    many = [room(0, index, f"room {index}") for index in range(1, 20)]
    with pytest.raises(QueryError, match=r"room 12, and 8 more$"):
        map_rooms(make_house(many)).find("?")


def test_without_a_table_rooms_go_by_level_and_index():
    house = make_house(TABLE)
    del house.metadata["navbake"]
    rooms = map_rooms(house)
    assert [entry.id for entry in rooms.rooms] == ["0:1", "0:2", "1:1"]
    assert rooms.find("1:1") == 3


def test_rooms_that_a_table_leaves_out_and_cells_that_a_room_leaves_out():
    rooms = map_rooms(make_house([room(0, 9, "nowhere"), TABLE[1]]))
    assert rooms.find("0:1") != rooms.find("1:1")
    assert rooms.cells("0:1").tolist() == [0, 1]
    assert rooms.cells("nowhere").tolist() == []


def test_no_rooms_at_all():
    level = make_level([[0, 0]])
    rooms = map_rooms(level)
    assert rooms.number.tolist() == [0, 0]
    with pytest.raises(QueryError, match="no room 'a' in None: it has none"):
        rooms.find("a")
