"""Rooms, walkable areas and doors as shapes, of the samples and of odd grids."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

import navbake
from grid_maps import house_from, level_from
from level_maps import level_of
from navbake.errors import QueryError
from navbake.navgrid.door_states import find_leaf_ends
from project_paths import GOLDEN

SAMPLES = ("apartment", "clutter", "house", "terrain", "warehouse")


def centers(level):
    return np.meshgrid(level.lattice.center_x(), level.lattice.center_y())


@pytest.mark.parametrize("name", SAMPLES)
def test_polygons_of_samples_are_their_cells(name):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    shapes = grid.to_polygons()
    for number, level in enumerate(grid.levels):
        x, y = centers(level)
        room = np.zeros(level.shape, dtype=int)
        index = {r.id: r.index for r in grid.rooms if r.level == number}
        for shape in (s for s in shapes if s.level == number and s.kind != "door"):
            geometry = shape.geometry
            assert geometry.is_valid
            assert geometry.area == pytest.approx(shape.area, abs=1e-6)
            inside = shapely.contains_xy(geometry, x, y)
            if shape.kind == "walkable":
                np.testing.assert_array_equal(inside, level.free)
            else:
                assert not room[inside].any()
                room[inside] = index[shape.id]
        np.testing.assert_array_equal(room, level.room_index)
    rooms = [s for s in shapes if s.kind == "room"]
    assert [(s.id, s.name, s.level, s.area) for s in rooms] == [
        (r.id, r.name, r.level, pytest.approx(r.area)) for r in grid.rooms
    ]
    assert [bool(s.more.get("outdoors")) for s in rooms] == [r.outdoors for r in grid.rooms]
    doors = [s for s in shapes if s.kind == "door"]
    assert {s.id for s in doors} == {d.id for d in grid.doors}
    for shape in doors:
        assert 0.7 < shape.geometry.length < 1.0  # all of them are 0.8 to 0.9 m wide
        assert shape.properties["state"] == "modelled" and len(shape.properties["rooms"]) == 2


def door_entry(state="closed", **cells):
    return {"id": "d", "joint": None, "rooms": ["a", None], "state": state, "cells": cells}


def grid_with_door(cells, width=8, height=6, **entry):
    level = level_of(*["0" * width] * height)
    level.metadata["agentRadius"] = 0.0
    ids = sorted(row * width + col for row, col in cells)
    runs = [number for cell in ids for number in (cell, 1)]
    level.metadata["navbake"] = {"doors": [door_entry(closed=[[0, runs]], **entry)]}
    return level


@pytest.mark.parametrize(
    ("cells", "ends"),
    [
        ([(2, c) for c in range(1, 5)], [[0.1, -0.25], [0.5, -0.25]]),
        ([(r, 3) for r in range(1, 6)], [[0.35, -0.6], [0.35, -0.1]]),
        ([(r, c) for r in (1, 2) for c in range(2, 8)], [[0.2, -0.2], [0.8, -0.2]]),
        # a cell too many at one end doesn't slant it
        ([(1, c) for c in range(1, 8)] + [(2, 7)], [[0.1, -0.1625], [0.8, -0.1625]]),
        ([(4, 4)], [[0.45, -0.5], [0.45, -0.4]]),
    ],
)
def test_a_door_is_a_line_through_its_cells(cells, ends):
    grid = grid_with_door(cells)
    line = np.array(find_leaf_ends(grid, grid.doors[0], 0))
    assert sorted(line.tolist()) == pytest.approx(np.array(ends))


@pytest.mark.parametrize("is_turned", [False, True])
def test_a_door_runs_from_wall_to_wall_however_deep_its_cells_are(is_turned):
    # 2 cells wide and 4 deep, as a radius of 0.2 m leaves of a door of 0.6 m
    cells = [(row, col) for row in range(1, 5) for col in (3, 4)]
    walls = np.zeros((6, 8), dtype=bool)
    walls[1:5] = True
    walls[1:5, 3:5] = False
    if is_turned:
        cells, walls = [(col, row) for row, col in cells], walls.T
    grid = grid_with_door(cells, *walls.shape[::-1])
    grid.weights[walls] = np.inf
    grid.metadata["agentRadius"] = 0.2
    line = np.array(find_leaf_ends(grid, grid.doors[0], 0))
    along = [0.0, 0.6] if is_turned else [0.6, 0.0]
    assert np.abs(line[1] - line[0]) == pytest.approx(np.array(along))


def test_a_slanting_door_is_a_slanting_line():
    grid = grid_with_door([(k, k) for k in range(5)])
    line = np.array(find_leaf_ends(grid, grid.doors[0], 0))
    assert sorted(line.tolist()) == pytest.approx(np.array([[0.0, 0.0], [0.5, -0.5]]))


def test_a_door_without_closed_cells_is_where_it_is_now():
    grid = grid_with_door([(2, 1), (2, 2)], state="open")
    doors = grid.metadata["navbake"]["doors"]
    doors[0]["cells"] = {"open": doors[0]["cells"]["closed"], "closed": []}
    assert find_leaf_ends(grid, grid.doors[0], 0) is not None
    doors[0]["cells"] = {}
    grid.metadata["navbake"]["doors"] = list(doors)
    assert find_leaf_ends(grid, grid.doors[0], 0) is None
    assert grid.to_polygons(["door"]) == []


def test_grids_without_rooms_or_free_cells():
    assert level_from("##\n##").to_polygons() == []
    (only,) = level_from(".").to_polygons()
    assert (only.kind, only.area, only.id, only.height) == ("walkable", 0.01, None, 0.0)
    assert only.geometry.equals(shapely.box(0, -0.1, 0.1, 0))
    upper = level_from("..\n#.", ground=3.0, x=1.0)
    both = house_from([level_from(".#\n#."), upper]).to_polygons()
    assert [(s.level, s.level_name, s.height, s.geometry.geom_type) for s in both] == [
        (0, "level 0", 0.0, "MultiPolygon"), (1, "level 1", 3.0, "Polygon"),
    ]  # fmt: skip


def test_refuses_unknown_kinds():
    for kinds in (["room", "wall"], "room"):
        with pytest.raises(QueryError, match="expected some of room, walkable, door as kinds, got"):
            level_from(".").to_polygons(kinds)
        with pytest.raises(QueryError, match="expected some of room, walkable, door as kinds, got"):
            level_from(".").to_geojson(kinds)
