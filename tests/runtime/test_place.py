"""What a grid holds at a position."""

from __future__ import annotations

import numpy as np
import pytest

from navbake.errors import QueryError
from navbake.navgrid.cells import LAYERS
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D

NAN = np.nan


def make_level(ground, unit=1.0):
    """Three by two cells: a free one, one that is blocked, one without floor; twice."""
    cell = np.array([[0, 1, 2], [0, 1, 2]])
    floor = np.where(cell == 2, NAN, ground + 0.1).astype(np.float32)
    return SceneGrid2D(
        width=3,
        height=2,
        cell_size=1.0 / unit,
        unit=unit,
        min_yup=(0.0, ground / unit, -2.0 / unit),
        weights=np.where(cell == 0, 3.0, np.inf),
        attributes={
            "floorHeight": floor / np.float32(unit),
            "occupancy": (cell > 0).astype(np.uint8),
            "roomIndex": np.array([[1, 1, 0], [2, 0, 0]], dtype=np.uint16),
        },
    )


def make_house():
    room = {"level": 1, "index": 1, "id": "x", "area": 2.0, "centroid": [1, 1, 3], "neighbours": []}
    grid = MultiLevelGrid(
        grids=[make_level(0.0), make_level(3.0)],
        cell_size=1.0,
        metadata={"sceneId": "house", "navbake": {"rooms": [room]}},
    )
    grid.levels[1].attributes["heat"] = np.full((2, 3), 7, dtype=np.int16)
    return grid


def test_a_free_place_tells_all():
    place = make_house().at((0.5, 1.5, 3.2))
    assert (place.cell, place.free, place.occupied) == ((1, 0, 0), True, False)
    assert place.floor == pytest.approx(3.1)
    assert (place.weight, place.room, place.island) == (3.0, "x", 2)


def test_a_blocked_place_and_one_without_floor():
    house = make_house()
    place = house.at((1.5, 1.5, 0.0))
    assert (place.free, place.occupied, place.weight) == (False, True, np.inf)
    assert (place.floor, place.room, place.island) == (pytest.approx(0.1), "0:1", None)
    place = house.at((2.5, 1.5, 0.0))
    assert (place.cell, place.floor, place.room) == ((0, 0, 2), None, None)


def test_no_cell_is_no_place():
    assert make_house().at((9.0, 0.0, 0.0)) is None
    assert make_house().at((0.5, 0.5, -2.0)) is None


def test_values_of_many_equal_places_one_by_one():
    house = make_house()
    rng = np.random.default_rng(0)
    positions = rng.uniform((-1, -1, -1), (4, 3, 5), size=(200, 3))
    values = {layer: house.values_at(layer, positions) for layer in LAYERS}
    for i, position in enumerate(positions):
        place = house.at(position)
        if place is None:
            found = [values[layer][i] for layer in LAYERS]
            np.testing.assert_array_equal(found, [NAN, False, 1, np.inf, 0, 0, 0])
            continue
        floor = NAN if place.floor is None else place.floor
        np.testing.assert_array_equal(values["floor"][i], floor)
        assert values["free"][i] == place.free
        assert values["occupancy"][i] == place.occupied
        assert values["weight"][i] == place.weight
        assert values["island"][i] == (place.island or 0)
        assert values["clearance"][i] == (0.5 if place.free else 0.0)
        part = house.levels[place.cell.level]
        assert values["room"][i] == part.room_index[place.cell.row, place.cell.col]


def test_attributes_go_by_their_names_in_the_file():
    house = make_house()
    positions = [[0.5, 0.5, 0.1], [0.5, 0.5, 3.1], [9.0, 0.5, 3.1]]
    assert house.values_at("heat", positions).tolist() == [0, 7, 0]
    found = house.values_at("floorHeight", positions)
    np.testing.assert_allclose(found, [0.1, 3.1, NAN], atol=1e-6)


def test_heights_are_metres_whatever_the_unit():
    level = make_level(0.0, unit=0.01)
    assert level.at((0.5, 0.5)).floor == pytest.approx(0.1)
    assert level.values_at("floor", [[0.5, 0.5]]).tolist() == [pytest.approx(0.1)]


def test_another_layer_is_refused_with_those_that_there_are():
    with pytest.raises(QueryError, match=r"no layer 'wieght' in 'house': did you mean 'weight'\?"):
        make_house().values_at("wieght", [0.0, 0.0, 0.0])
