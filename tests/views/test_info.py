"""What `navbake info` tells."""

import json

import numpy as np
import pytest

from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.views.info import describe


def make_level(free, floor, ground=0.0, rooms=None, metadata=None, unit=1.0):
    free = np.array(free, dtype=bool)
    return SceneGrid2D(
        width=free.shape[1],
        height=free.shape[0],
        cell_size=0.5,
        min_yup=(0.0, ground, 0.0),
        unit=unit,
        weights=np.where(free, 1.0, np.inf),
        attributes={
            "floorHeight": np.array(floor, dtype=np.float32),
            "roomIndex": np.array(rooms if rooms else np.zeros(free.shape), dtype=np.uint16),
        },
        metadata=metadata or {},
    )


HOUSE = {
    "sceneId": "house",
    "agentHeight": 1.5,
    "agentRadius": 0.2,
    "traversableFloorHeight": 0.25,
    "navbake": {
        "version": "0.1.0",
        "mujoco": "4.0.0",
        "sceneDigest": "ab",
        "settingsDigest": "cd",
        "maxSlope": 45.0,
        "levels": [{"name": "ground floor"}, {"name": None}],
        "links": [[0, 3, 1, 0]],
    },
}


@pytest.fixture
def house():
    nan = np.nan
    lower = make_level([[1, 1, 0, 1]], [[0, 0.2, 0.2, 0.2]], rooms=[[1, 1, 0, 7]])
    upper = make_level([[1, 1], [0, 0]], [[2.8, 2.9], [2.8, nan]], ground=2.8)
    return MultiLevelGrid(grids=[lower, upper], cell_size=0.5, metadata=HOUSE)


def test_describes_a_house(house):
    facts = describe(house)
    assert facts == {
        "type": "MultiLevelGrid",
        "scene_id": "house",
        "cell_size": 0.5,
        "agent": {
            "height": 1.5,
            "radius": 0.2,
            "traversable_floor_height": 0.25,
            "max_slope": 45.0,
        },
        "made_by": {
            "navbake": "0.1.0",
            "mujoco": "4.0.0",
            "scene_digest": "ab",
            "settings_digest": "cd",
        },
        "levels": [
            {
                "name": "ground floor",
                "width": 4,
                "height": 1,
                "ground": 0.0,
                "floor_min": 0.0,
                "floor_max": 0.2,
                "floor_area": 1.0,
                "free_area": 0.75,
                "num_islands": 2,
                "largest_island_area": 0.5,
                "num_rooms": 2,
            },
            {
                "name": "level 1",
                "width": 2,
                "height": 2,
                "ground": 2.8,
                "floor_min": 2.8,
                "floor_max": 2.9,
                "floor_area": 0.75,
                "free_area": 0.5,
                "num_islands": 1,
                "largest_island_area": 0.5,
                "num_rooms": 0,
            },
        ],
        "num_islands": 2,
        "num_links": 1,
        "doors": [],
        "inflated": [],
        "warnings": [],
    }
    assert json.loads(json.dumps(facts, allow_nan=False)) == facts


def test_tells_of_inflations(house):
    house.metadata = {**house.metadata, "inflation": "by hand"}
    assert describe(house)["inflated"] == []
    twice = house.inflate(0.1).inflate(0.2, clearance=0.3)
    assert describe(twice)["inflated"] == [
        {"radius": 0.1, "clearance": 0.0, "mode": "exact"},
        {"radius": 0.2, "clearance": 0.3, "mode": "exact"},
    ]


def test_describes_a_file_that_tells_little():
    facts = describe(make_level([[0, 0]], [[np.nan, np.nan]]))
    assert facts["scene_id"] is None
    assert facts["agent"] == facts["made_by"] == {}
    level = facts["levels"][0]
    assert (level["floor_min"], level["floor_max"], level["floor_area"]) == (None, None, 0.0)
    assert (level["num_islands"], level["largest_island_area"]) == (0, 0.0)
    json.dumps(facts, allow_nan=False)


def test_lengths_are_in_metres_whatever_the_unit():
    level = describe(make_level([[1, 1]], [[100.0, 110.0]], ground=100.0, unit=0.01))["levels"][0]
    assert (level["ground"], level["floor_min"], level["floor_max"]) == (1.0, 1.0, 1.1)
    assert level["free_area"] == pytest.approx(2 * 0.005**2)
