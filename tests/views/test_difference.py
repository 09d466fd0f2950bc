"""What differs between two grids, against a plain loop over positions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from door_scenes import LEAF, ROOMS, world
from grid_maps import house_from, level_from, random_house
from navbake import bake
from navbake.views.difference import (
    CHANGE_COLORS,
    MAX_SAME_FLOOR_GAP,
    compare_levels,
    list_changed_rooms,
    list_differences,
    match_levels,
    read_settings,
)

NAMES = tuple(CHANGE_COLORS)


def with_rooms(level, text):
    level.attributes["roomIndex"] = np.array(
        [list(map(int, row)) for row in text.split("\n")], dtype=np.uint16
    )
    return level


def changes(first, second):
    found = compare_levels(first, second, (0, 0))
    return [[NAMES[k] for k in row] for row in found.change_of_cell.tolist()]


def test_each_change_has_its_name():
    first = level_from("..#1 .\n......")
    second = level_from("#.. ..\n......")
    second.weights[1, 0] = 10.0
    assert changes(first, second) == [
        [
            "became blocked",
            "free in both",
            "became free",
            "became blocked",
            "became free",
            "free in both",
        ],
        ["other weight", *["free in both"] * 5],
    ]
    assert changes(level_from("# "), level_from("# ")) == [["blocked in both", "no floor in both"]]


def test_a_floor_that_moved_and_another_room():
    first = with_rooms(level_from("...."), "1122")
    second = with_rooms(level_from("..1."), "1122")
    assert changes(first, second)[0][2] == "floor moved"
    second = with_rooms(level_from("...."), "2221")
    # room 1 became room 2, and 2 became 1: only the cell that changed sides changed
    assert changes(first, second) == [["free in both"] * 2 + ["other room", "free in both"]]


def test_a_room_that_only_one_has():
    first, second = with_rooms(level_from(".."), "12"), with_rooms(level_from(".."), "10")
    assert changes(first, second) == [["free in both", "other room"]]
    assert changes(second, first) == [["free in both", "other room"]]


def test_cells_that_only_one_has():
    first = level_from("..", x=0.0, y_max=0.0)
    second = level_from(" .\n..", x=-0.1, y_max=0.1)
    assert changes(first, second) == [
        ["no floor in both", "only in the second", "no floor in both"],
        ["only in the second", "free in both", "only in the first"],
    ]


def look(level, x, y):
    """The cell at a position, by arithmetic: floor, free, weight; None beside the level."""
    row = math.floor((level.lattice.y_max - y) / level.lattice.cell_size)
    col = math.floor((x - level.lattice.x_min) / level.lattice.cell_size)
    if not (0 <= row < level.height and 0 <= col < level.width):
        return None
    return level.floor[row, col], bool(level.free[row, col]), level.weights[row, col]


def name_of(one, other):
    """What became of a cell without rooms, by the words of the names."""
    if one is None or other is None:
        there, kind = (one, "first") if other is None else (other, "second")
        if there is None or (not there[1] and np.isnan(there[0])):
            return "no floor in both"
        return f"only in the {kind}"
    if one[1] != other[1]:
        return "became free" if other[1] else "became blocked"
    gone = np.isnan(one[0]), np.isnan(other[0])
    if gone[0] != gone[1] or abs(one[0] - other[0]) > MAX_SAME_FLOOR_GAP:
        return "floor moved"
    if one[2] != other[2]:
        return "other weight"
    return "free in both" if one[1] else "no floor in both" if gone[0] else "blocked in both"


@settings(deadline=None)
@given(seed=st.integers(0, 10_000), coarser=st.sampled_from([1.0, 1.7]))
def test_changes_are_those_of_a_loop_over_positions(seed, coarser):
    rng = np.random.default_rng(seed)
    first, second = (random_house(rng, num_levels=1).levels[0] for _ in range(2))
    second.cell_size *= coarser
    found = compare_levels(first, second, (0, 0))
    x0, y0, x1, y1 = found.lattice.bounds
    bounds = np.array([first.lattice.bounds, second.lattice.bounds])
    assert (x0 <= bounds[:, 0] + 1e-9).all()
    assert (y0 <= bounds[:, 1] + 1e-9).all()
    assert (x1 >= bounds[:, 2] - 1e-9).all()
    assert (y1 >= bounds[:, 3] - 1e-9).all()
    for row, y in enumerate(found.lattice.center_y().tolist()):
        for col, x in enumerate(found.lattice.center_x().tolist()):
            expected = name_of(look(first, x, y), look(second, x, y))
            assert NAMES[found.change_of_cell[row, col]] == expected, (row, col)


def test_levels_are_paired_by_their_grounds():
    def house(*grounds):
        return house_from([level_from("..", ground=ground) for ground in grounds])

    assert match_levels(house(0.0, 3.0), house(0.02, 2.9, 6.0)) == [(0, 0), (1, 1)]
    assert match_levels(house(0.0, 3.0), house(2.9)) == [(1, 0)]
    assert match_levels(house(0.0), house(1.6)) == []


@pytest.fixture(scope="module")
def doors(tmp_path_factory):
    """A grid with a door, and the same with the door closed."""
    path = tmp_path_factory.mktemp("doors") / "rooms.xml"
    path.write_text(world(ROOMS, LEAF))
    grid = bake({"scene": {"path": str(path)}, "grid": {"cell_size": 0.1}})
    [door] = grid.doors
    return grid, grid.with_doors({door.id: "closed"}), door.id


def test_a_door_in_another_state(doors):
    first, second, name = doors
    states = lambda grid: {door.id: door.state for door in grid.doors}  # noqa: E731
    assert list_differences(*map(states, (first, first))) == []
    assert list_differences(*map(states, (first, second))) == [(name, "modelled", "closed")]
    level = compare_levels(first.levels[0], second.levels[0], (0, 0))
    blocked = np.count_nonzero(first.levels[0].free & ~second.levels[0].free)
    assert np.count_nonzero(level.change_of_cell == NAMES.index("became blocked")) == blocked


def test_rooms_that_changed_are_listed():
    def grid(name, text):
        level = with_rooms(level_from("...."), text)
        numbers = sorted({int(c) for c in text} - {0})
        rooms = [
            {
                "index": k,
                "id": f"0:{k}",
                "name": f"{name}{k}",
                "level": 0,
                "area": 1.0,
                "centroid": [0, 0, 0],
                "neighbours": [],
            }
            for k in numbers
        ]
        return house_from([level], rooms=rooms)

    def listed(first, second):
        return list_changed_rooms(
            first, second, [compare_levels(first.levels[0], second.levels[0], (0, 0))]
        )

    assert listed(grid("a", "1122"), grid("a", "1122")) == []
    [row] = listed(grid("a", "1111"), grid("b", "1111"))
    assert row == ("renamed", "a1, 1.00 m²", "b1, 1.00 m²")
    rows = listed(grid("a", "1123"), grid("a", "1122"))
    assert [row[0] for row in rows] == ["50.0% of their cells are common", "only in the first"]


def test_settings_that_changed_are_listed(doors):
    grid, _, _ = doors
    other = grid.inflate(0.3)
    assert list_differences(read_settings(grid), read_settings(grid)) == []
    changed = {
        what: second for what, _, second in list_differences(*map(read_settings, (grid, other)))
    }
    assert changed["inflation.0.radius"] == "0.3"
    assert all(key.startswith("inflation.0.") for key in changed)


def test_levels_that_no_map_can_show_together_are_no_pair():
    near, beside = level_from("..\n.."), level_from("..\n..", x=5.0, y_max=-3.0)
    assert match_levels(near, beside) == [(0, 0)]
    far = level_from("..\n..", x=1e7, y_max=1e7)
    assert match_levels(near, far) == match_levels(far, near) == []
    # as many cells of the first as cover the second
    coarse = level_from("..\n..", cell_size=1000.0)
    assert match_levels(near, coarse) == []
    assert match_levels(coarse, near) == [(0, 0)]
