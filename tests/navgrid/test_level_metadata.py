"""A level of several is a grid by itself: what it takes over of the whole, saved and planned on."""

from __future__ import annotations

import copy

import numpy as np
import pytest

import navbake
from differences import first_difference
from grid_maps import house_from, level_from
from navbake import PathFinder
from navbake.formats.navgrid import dumps_navgrid, read_navgrid
from navbake.navgrid.links import Step
from navbake.navgrid.metadata import split_metadata
from project_paths import ROOT

GOLDEN = ROOT / "tests" / "golden"
SAMPLES = {path.name.split(".")[0]: navbake.load(path) for path in sorted(GOLDEN.glob("*.gz"))}
LEVELS = [(name, k) for name, grid in SAMPLES.items() for k in range(len(grid.levels))]


def make_house():
    """A hall and a den below, a loft above, a stair from the den; a door below, one on both."""

    def room(index, name, level, ways):
        return {
            **{"index": index, "id": name, "name": name, "level": level, "area": 1.0},
            **{"centroid": [0.0, 0.0, 0.0], "source": "auto"},
            "neighbours": [{"room": to, "door": None, "kind": kind} for to, kind in ways],
        }

    rooms = [
        room(1, "hall", 0, [("den", "open")]),
        room(2, "den", 0, [("hall", "open"), ("loft", "link")]),
        room(1, "loft", 1, [("den", "link")]),
    ]
    links = [((0, 0, 3), (1, 0, 0))]
    house = house_from([level_from("...."), level_from("..", x=0.4)], links, rooms)
    doors = [
        {"id": name, "joint": None, "rooms": [], "state": "open", "cells": cells}
        for name, cells in {
            "gate": {"open": [], "closed": [[0, [1, 1]]]},
            "hatch": {"open": [[1, [0, 1]]], "closed": [[0, [2, 1]], [1, [1, 1]]]},
        }.items()
    ]
    names = [{"name": "ground"}, {"name": "attic"}]
    own = {**house.navbake, "doors": doors, "levels": names}
    return house.with_levels(house.levels, {**house.metadata, "navbake": own})


@pytest.mark.parametrize(("name", "number"), LEVELS)
def test_a_level_of_a_sample_is_a_grid_by_itself(name, number, tmp_path):
    whole = SAMPLES[name]
    level = whole.levels[number]
    level.save(tmp_path / "level.json")
    again = navbake.load(tmp_path / "level.json")
    assert first_difference(level, again) is None
    for grid in (level, again):
        assert [room.id for room in grid.rooms] == [r.id for r in whole.rooms if r.level == number]
        assert [door.id for door in grid.doors] == [d.id for d in whole.doors if number in d.levels]
        assert {room.level for room in grid.rooms} <= {0}
        assert grid.steps == ()
        finder = PathFinder(grid)
        start, goal = finder.random_point(np.random.default_rng(0), 2, island=1)
        path = finder.find_path(start, goal)
        assert path is not None
        assert set(path.rooms) <= {room.id for room in grid.rooms}
    assert dumps_navgrid(whole).count(b'"sceneId"') == 1  # levels have none of their own


def test_what_a_level_takes_over():
    house = make_house()
    assert house.steps == (Step(0, 3, 1, 0),)
    below, above = house.levels
    assert [[way.room for way in room.neighbours] for room in below.rooms] == [["den"], ["hall"]]
    assert [room.neighbours for room in above.rooms] == [()]
    assert [door.id for door in below.doors] == ["gate", "hatch"]
    assert [door.id for door in above.doors] == ["hatch"]
    assert [cells.tolist() for cells in above.doors[0].cells_in("closed", 1)] == [[1]]
    assert [one.navbake["levels"] for one in (below, above)] == [
        [{"name": "ground"}],
        [{"name": "attic"}],
    ]
    closed = above.with_doors("closed")
    assert closed.free.tolist() == [[True, False]]
    assert [room.id for room in house.rooms] == ["hall", "den", "loft"]  # the whole is as it was


def test_derived_grids_hand_down_their_own_metadata(tmp_path):
    house = make_house()
    for derived in (house.inflate(0.06), house.with_doors("closed")):
        assert all(derived.inherits_metadata(k, level) for k, level in enumerate(derived.levels))
        assert b'"metadata"' not in dumps_navgrid(derived).partition(b'"grids"')[2]
    assert [door.state for door in house.with_doors("closed").levels[1].doors] == ["closed"]


def test_a_level_keeps_what_was_written_to_its_own_metadata():
    house = make_house()
    house.levels[1].metadata["note"] = "leaks"
    again = read_navgrid(dumps_navgrid(house))
    assert "note" not in again.metadata
    assert "note" not in again.levels[0].metadata
    assert again.levels[1].metadata["note"] == "leaks"
    assert [room.id for room in again.levels[1].rooms] == ["loft"]


def test_levels_follow_what_was_written_to_the_whole_s_metadata_when_it_is_read_again():
    house = make_house()
    house.metadata["sceneId"] = "villa"
    house.metadata["navbake"]["rooms"][0]["name"] = "foyer"
    again = read_navgrid(dumps_navgrid(house))
    assert [level.scene_id for level in again.levels] == ["villa", "villa"]
    assert again.levels[0].rooms[0].name == "foyer"


@pytest.mark.parametrize(
    "broken",
    [
        {"rooms": 3},
        {"rooms": [3]},
        {"rooms": [{"level": 0, "neighbours": 5}]},
        {"doors": {}},
        {"doors": [{"cells": 3}]},
        {"doors": [{"cells": {"open": 3}}]},
        {"doors": [{"cells": {"open": [3, [1]]}}]},
        {"levels": 3, "links": 3},
    ],
)
def test_what_is_broken_is_left_to_the_whole(broken):
    metadata = {"navbake": broken}
    before = copy.deepcopy(metadata)
    cut, _ = split_metadata(metadata, 2)
    assert metadata == before
    assert cut.keys() == metadata.keys()


def test_metadata_without_navbake_s_part_are_shared():
    metadata = {"sceneId": "others"}
    assert all(part is metadata for part in split_metadata(metadata, 2))
