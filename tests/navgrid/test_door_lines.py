"""Doors are marked from jamb to jamb."""

import numpy as np
import pytest

import navbake
from navbake.navgrid.door_states import find_door_lines
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.rooms import to_runs
from project_paths import ROOT


def level_with_door(rows, cells, state="closed", solid=None, radius=0.0):
    """Cells of 0.1 m; ``#`` is blocked."""
    free = np.array([[letter != "#" for letter in row] for row in rows])
    pack = lambda places: [[0, to_runs(np.sort([r * free.shape[1] + c for r, c in places]))]]  # noqa: E731
    door = {"id": "d", "state": state, "cells": {"closed": pack(cells), "open": []}}
    if solid is not None:
        door["solid"] = {"closed": pack(solid)}
    return SceneGrid2D(
        width=free.shape[1],
        height=free.shape[0],
        cell_size=0.1,
        min_yup=(0.0, 0.0, -0.1 * free.shape[0]),
        weights=np.where(free, 1.0, np.inf),
        metadata={"agentRadius": radius, "navbake": {"doors": [door]}},
    )


def test_a_mark_runs_along_the_leaf():
    solid = [(2, col) for col in range(3, 9)]
    level = level_with_door(["." * 12] * 6, solid, solid=solid)
    [mark] = find_door_lines(level, 0)
    assert mark.start == pytest.approx((0.3, 0.35)) and mark.end == pytest.approx((0.9, 0.35))
    assert mark.width == pytest.approx(0.6) and mark.middle == pytest.approx((0.6, 0.35))
    assert mark.state == "closed"


def test_a_slanted_leaf():
    solid = [(n, n) for n in range(2, 9)]
    [mark] = find_door_lines(level_with_door(["." * 12] * 12, solid, solid=solid), 0)
    (x0, y0), (x1, y1) = mark.start, mark.end
    assert (y1 - y0) / (x1 - x0) == pytest.approx(-1)  # rows run against y
    assert mark.width == pytest.approx(0.7 * 2**0.5)  # from corner to corner


def test_without_the_leaf_it_runs_from_wall_to_wall():
    # 2 cells wide and 4 deep, as a radius of 0.2 m leaves of a door of 0.6 m
    rows = ["..........", "####..####", "####..####", "####..####", "####..####", ".........."]
    cells = [(row, col) for row in range(1, 5) for col in (4, 5)]
    [mark] = find_door_lines(level_with_door(rows, cells, radius=0.2), 0)
    assert mark.start == pytest.approx((0.2, 0.3)) and mark.end == pytest.approx((0.8, 0.3))
    turned = ["".join(column) for column in zip(*rows, strict=True)]
    cells = [(col, row) for row, col in cells]
    [mark] = find_door_lines(level_with_door(turned, cells, radius=0.2), 0)
    assert mark.start[0] == pytest.approx(mark.end[0]) and mark.width == pytest.approx(0.6)


def test_one_cell_and_none():
    [mark] = find_door_lines(level_with_door(["...."] * 3, [(1, 1)], solid=[(1, 1)]), 0)
    assert mark.width == pytest.approx(0.1)
    assert find_door_lines(level_with_door(["...."] * 3, []), 0) == ()


def test_doors_of_a_house_are_as_wide_as_they_are():
    grid = navbake.load(ROOT / "tests" / "golden" / "house.grid.json.gz")
    marks = [mark for number in range(2) for mark in find_door_lines(grid, number)]
    assert {mark.id for mark in marks} == {door.id for door in grid.doors}
    assert all(mark.state == "open" for mark in marks)
    assert all(0.75 <= mark.width <= 1.05 for mark in marks)
