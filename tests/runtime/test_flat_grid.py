"""The flat view of a grid, and its rooms by name."""

from __future__ import annotations

import numpy as np
import pytest

from grid_maps import room
from navbake.errors import QueryError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.islands import STEP_SLACK
from navbake.runtime.flat_grid import flatten, map_rooms


def make_level(free, floor, x=0.0, z=0.0, ground=0.0, unit=1.0, cell_size=0.5):
    free, floor = np.array(free, bool), np.array(floor, np.float32)
    height, width = free.shape
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=cell_size,
        min_yup=(x, ground, z),
        unit=unit,
        weights=np.where(free, 2.0, np.inf),
        attributes={"floorHeight": floor},
        metadata={"traversableFloorHeight": 0.25},
    )


def two_levels(links):
    lower = make_level([[1, 1, 0], [0, 1, 1]], [[0, 0.1, 0.2], [0, 0, np.nan]], x=1.0, z=2.0)
    upper = make_level([[1, 1]], [[3.0, 3.1]], x=2.5, z=2.5, ground=3.0)
    metadata = {"traversableFloorHeight": 0.25, "navbake": {"links": links}}
    return MultiLevelGrid(grids=[lower, upper], cell_size=0.5, metadata=metadata)


def test_levels_follow_one_another():
    flat = flatten(two_levels([[0, 5, 1, 0]]))
    assert flat.num_levels == 2
    assert flat.num_cells == 8
    assert flat.layout.start.tolist() == [0, 6, 8]
    assert flat.layout.width.tolist() == [3, 2]
    assert flat.layout.height.tolist() == [2, 1]
    assert flat.free.tolist() == [True, True, False, False, True, True, True, True]
    assert flat.weight[flat.free].tolist() == [2.0] * 6
    assert np.isinf(flat.weight[~flat.free]).all()
    assert flat.level_of(np.array([0, 5, 6, 7])).tolist() == [0, 0, 1, 1]


def test_positions_are_on_the_floor_or_the_ground():
    flat = flatten(two_levels([]))
    found = flat.positions(np.array([1, 5, 7]))
    expected = [[1.75, -2.25, 0.1], [2.25, -2.75, 0.0], [3.25, -2.75, 3.1]]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_links_go_both_ways_once():
    links = [[0, 5, 1, 0], [1, 0, 0, 5], [0, 4, 1, 0], [0, 2, 0, 2]]
    flat = flatten(two_levels(links))
    lists = {
        int(cell): flat.steps.target[flat.steps.start[i] : flat.steps.start[i + 1]].tolist()
        for i, cell in enumerate(flat.steps.cell)
    }
    assert lists == {4: [6], 5: [6], 6: [4, 5]}


def test_without_links_the_lists_are_empty():
    flat = flatten(make_level([[1]], [[0.0]]))
    assert flat.steps.cell.tolist() == []
    assert flat.steps.start.tolist() == [0]
    assert flat.steps.target.tolist() == []


def test_everything_is_in_metres():
    level = make_level([[1, 1]], [[0.0, 20.0]], x=100.0, z=200.0, unit=0.01, cell_size=50.0)
    flat = flatten(level)
    assert flat.layout.x_min.tolist() == [1.0]
    assert flat.layout.y_max.tolist() == [-2.0]
    assert flat.layout.cell_size.tolist() == [0.5]
    assert flat.floors.z.tolist() == [0.0, 0.2]
    rounding = float(np.spacing(np.float32(20.0))) * 0.01
    expected = 0.25 * 0.01 + STEP_SLACK + rounding
    np.testing.assert_allclose(flat.floors.max_step, expected, rtol=1e-12)


def test_a_walk_is_a_copy():
    level = make_level([[1, 1]], [[0.0, 0.0]])
    flat = flatten(level)
    level.weights[0, 0] = np.inf
    assert flat.free.tolist() == [True, True]


def level_of(index):
    level = make_level(np.ones(np.shape(index)), np.zeros(np.shape(index)))
    level.attributes["roomIndex"] = np.array(index, dtype=np.uint16)
    return level


def house_of(rooms):
    grids = [level_of([[1, 1, 0], [2, 2, 2]]), level_of([[0, 1]])]
    metadata = {"sceneId": "house", "navbake": {"rooms": rooms}}
    return MultiLevelGrid(grids=grids, cell_size=0.5, metadata=metadata)


TABLE = [room(0, 1, "a", "kitchen"), room(0, 2, "b", "bath"), room(1, 1, "c", "bath")]


def test_rooms_go_by_id_and_by_a_name_that_is_theirs_alone():
    rooms = map_rooms(house_of(TABLE))
    assert rooms.number.tolist() == [1, 1, 0, 2, 2, 2, 0, 3]
    assert rooms.number.dtype == np.int32
    assert [rooms.find(name) for name in ("a", "kitchen", "b", "c")] == [1, 1, 2, 3]
    assert rooms.cells("c").tolist() == [7]
    assert [rooms.id_of(number) for number in range(4)] == [None, "a", "b", "c"]


def test_a_name_of_several_rooms_is_refused_with_their_ids():
    with pytest.raises(QueryError, match=r"2 rooms in 'house' have the name 'bath': .* b, c$"):
        map_rooms(house_of(TABLE)).find("bath")


def test_an_unknown_room_is_refused_with_a_near_one():
    with pytest.raises(QueryError, match=r"no room 'kichen' in 'house': did you mean 'kitchen'\?"):
        map_rooms(house_of(TABLE)).find("kichen")
    many = [room(0, index, f"room {index}") for index in range(1, 20)]
    with pytest.raises(QueryError, match=r"room 12, and 8 more$"):
        map_rooms(house_of(many)).find("?")


def test_without_a_table_rooms_go_by_level_and_index():
    house = house_of(TABLE)
    del house.metadata["navbake"]
    rooms = map_rooms(house)
    assert [entry.id for entry in rooms.rooms] == ["0:1", "0:2", "1:1"]
    assert rooms.find("1:1") == 3


def test_rooms_that_a_table_leaves_out_and_cells_that_a_room_leaves_out():
    rooms = map_rooms(house_of([room(0, 9, "nowhere"), TABLE[1]]))
    assert rooms.find("0:1") != rooms.find("1:1")
    assert rooms.cells("0:1").tolist() == [0, 1]
    assert rooms.cells("nowhere").tolist() == []


def test_no_rooms_at_all():
    level = level_of([[0, 0]])
    rooms = map_rooms(level)
    assert rooms.number.tolist() == [0, 0]
    with pytest.raises(QueryError, match="no room 'a' in None: it has none"):
        rooms.find("a")
