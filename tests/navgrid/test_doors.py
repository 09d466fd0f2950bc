"""Doors of a grid: runs, states, user data, and what a file may say of them."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import navbake
from navbake.errors import FormatError, QueryError
from navbake.navgrid.door_states import with_door_names
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.rooms import from_runs, parse_doors, to_runs
from navbake.navgrid.user_data import SharedEntries, UserData

GATE = {
    "id": "gate",
    "joint": "g",
    "rooms": ["hall", None],
    "state": "modelled",
    "cells": {"modelled": [[0, [1, 2]]], "open": [[0, [5, 1]]], "closed": [[0, [1, 2]]]},
}
HATCH = {"id": "hatch", "joint": None, "rooms": [None, None], "state": "removed"}
HATCH = {**HATCH, "cells": {"modelled": [[0, [2, 1]]], "closed": [[0, [2, 1]]]}}


def make_grid(user_data=None, names=None, doors=(GATE, HATCH)) -> SceneGrid2D:
    """Eight cells in a row, all free but for the doors."""
    navbake = {"doors": copy.deepcopy(list(doors))} | ({} if names is None else {"names": names})
    occupied = np.zeros((1, 8), dtype=np.uint8)
    for door in doors:
        for _, runs in door["cells"].get(door["state"], []):
            occupied[0, from_runs(runs)] = 1
    return SceneGrid2D(
        width=8,
        height=1,
        cell_size=0.5,
        min_yup=(0.0, 0.0, 0.0),
        weights=np.where(occupied, np.inf, 1.0),
        attributes={"occupancy": occupied},
        user_data=user_data or {},
        metadata={"sceneId": "yard", "navbake": navbake},
    )


@given(st.sets(st.integers(0, 200)))
def test_runs_there_and_back(cells):
    expected = np.array(sorted(cells), dtype=np.int64)
    runs = to_runs(expected)
    np.testing.assert_array_equal(from_runs(runs), expected)
    assert len(runs) == 2 * sum(cell - 1 not in cells for cell in cells)


def test_a_summary_of_the_doors():
    assert [door.to_json() for door in make_grid().doors] == [
        {
            "id": "gate",
            "joint": "g",
            "rooms": ["hall", None],
            "levels": [0],
            "state": "modelled",
            "like": "closed",
            "states": ["modelled", "open", "closed", "removed"],
            "width": None,
        },
        {
            "id": "hatch",
            "joint": None,
            "rooms": [None, None],
            "levels": [0],
            "state": "removed",
            "like": None,
            "states": ["modelled", "closed", "removed"],
            "width": None,
        },
    ]


def test_doors_that_overlap_block_until_both_are_open():
    grid = make_grid().with_doors({"gate": "open", "hatch": "closed"})
    assert np.flatnonzero(grid.occupancy).tolist() == [2, 5]
    grid = grid.with_doors({"hatch": "removed"})
    assert np.flatnonzero(grid.occupancy).tolist() == [5]
    assert np.flatnonzero(np.isinf(grid.weights)).tolist() == [5]


def test_names_follow_the_doors():
    things = {
        1: {"objects": ["lamp"]},
        5: {"walls": ["beam"]},
        7: {"objects": ["gate post"], "blockers": ["gate post", "ivy"]},
    }
    things = UserData(things)
    named = with_door_names(things, parse_doors([GATE, HATCH], [8]), 0, 1)
    assert named == {
        1: {"doors": ["gate"], "objects": ["gate", "lamp"], "blockers": ["gate"]},
        2: {"doors": ["gate", "hatch"], "objects": ["gate"], "blockers": ["gate"]},
        5: {"walls": ["beam"]},
        7: things[7],
    }
    opened = parse_doors([{**GATE, "state": "open"}, {**HATCH, "state": "closed"}], [8])
    expected = {
        1: {"doors": ["gate"], "objects": ["lamp"]},
        2: {"doors": ["gate", "hatch"], "objects": ["hatch"], "blockers": ["hatch"]},
        5: {"doors": ["gate"], "objects": ["gate"], "walls": ["beam"], "blockers": ["gate"]},
        7: things[7],
    }
    assert with_door_names(things, opened, 0, 1) == expected
    assert with_door_names(named, opened, 0, 1) == expected
    assert with_door_names(UserData(expected), parse_doors([GATE, HATCH], [8]), 0, 1) == named


@pytest.mark.parametrize("seed", range(20))
def test_names_follow_the_doors_where_cells_share_entries(seed):
    """Told apart only by how they are kept, user data get the same names."""
    rng = np.random.default_rng(seed)
    entries = [{"objects": ["lamp"]}, {"walls": ["beam"]}, {"doors": ["gate"], "objects": ["gate"]}]
    cells = np.sort(rng.choice(9, rng.integers(0, 10), replace=False))
    shared = UserData(SharedEntries(cells, rng.integers(0, 3, len(cells)), entries))
    plain = UserData(dict(UserData(shared.source)))
    before = copy.deepcopy(entries)
    doors = parse_doors([GATE, HATCH], [8])
    named = with_door_names(shared, doors, 0, 1)
    assert not shared.is_read and entries == before
    assert list(named.items()) == list(with_door_names(plain, doors, 0, 1).items())
    again = with_door_names(shared, doors, 0, 1)
    for state in ("open", "modelled") * 3:
        changed = parse_doors([{**GATE, "state": state}, HATCH], [8])
        again = with_door_names(again, changed, 0, 1)
    assert len(again.source.entries) <= len(again.source.cells)  # none is kept that no cell has
    assert again == named


@pytest.mark.parametrize("names", [None, True, False])
def test_a_grid_without_names_gets_none(names):
    grid = make_grid(names=names)
    assert bool(grid.with_doors("closed").user_data) == (names is not False)


@pytest.mark.parametrize(
    "entry",
    [
        {"doors": 5, "objects": 3},
        {"doors": ["gate"], "objects": 3, "walls": {}},
        {"doors": [1, {}, []], "objects": ["cup", {}, [], None, 7], "walls": [[]], "blockers": 3},
        {"doors": None, "objects": None},
    ],
    ids=repr,
)
def test_user_data_of_other_programs_may_hold_anything(entry):
    """What is no list of names counts as none, and stays where nothing is to be written there."""
    user_data = {cell: dict(entry) for cell in (1, 3, 5)}
    opened = make_grid(copy.deepcopy(user_data), doors=[GATE]).with_doors("open")
    assert opened.user_data[3].get("objects") in (entry["objects"], ["cup"])
    assert "gate" in opened.user_data[5]["objects"] and opened.user_data[5]["doors"] == ["gate"]
    closed = opened.with_doors("closed")
    assert closed.user_data[1]["doors"] == ["gate"] and "gate" in closed.user_data[1]["objects"]
    assert set(closed.user_data[1]["objects"]) <= {"cup", "gate"}


def test_what_a_door_cannot_be():
    with pytest.raises(QueryError, match="'hatch' can't be open: it can be modelled, closed, rem"):
        make_grid().with_doors("open")


@pytest.mark.parametrize(
    ("change", "culprit"),
    [
        ({"id": 5}, r"`str`, got `int` at `metadata.navbake.doors\[0\].id`"),
        ({"state": "ajar"}, r"'ajar' at `.*\[0\].state`"),
        ({"cells": None}, r"`object`, got `null` at `.*\[0\].cells`"),
        ({"joint": 3}, r"`str \| null`, got `int` at `.*\[0\].joint`"),
        ({"rooms": "hall"}, r"`array`, got `str` at `.*\[0\].rooms`"),
        ({"rooms": ["hall", 2]}, r"got `int` at `.*\[0\].rooms\[1\]`"),
        ({"cells": {"ajar": []}}, "'ajar' at `.*cells`"),
        ({"cells": {"open": [[0, [1, 1]], [0, [2, 1]]]}}, "each level once"),
        ({"cells": {"open": [[1, [0, 1]]]}}, "within the grid"),
        ({"cells": {"open": [[0, [7, 2]]]}}, "within the grid"),
        ({"cells": {"open": [[0, [1, 2, 2, 1]]]}}, "within the grid"),
        ({"cells": {"open": [[0, [1]]]}}, "within the grid"),
    ],
)
def test_what_a_file_may_not_say(change, culprit):
    parse_doors([GATE, HATCH], [8])
    with pytest.raises(FormatError, match=culprit):
        parse_doors([{**GATE, **change}], [8])


def test_the_width_of_a_leaf_is_a_length():
    [door] = make_grid(doors=[{**GATE, "width": 0.89}]).doors
    assert door.width == 0.89
    for width in (-1.0, 1e11, "wide"):
        with pytest.raises(FormatError, match=r"doors\[0\].*width|width"):
            parse_doors([{**GATE, "width": width}], [8])


def test_a_finder_says_which_doors_lose_their_states(recwarn):
    grid = make_grid()
    finder = navbake.PathFinder(grid.with_doors({"gate": "open"}))
    finder.use(grid.with_doors({"gate": "closed"}))  # that was meant
    finder.use(grid)  # as modelled, it is closed
    assert not recwarn
    finder = navbake.PathFinder(grid.with_doors({"gate": "open"}).inflate(0.1))
    finder.use(grid.inflate(0.1))
    (warning,) = recwarn
    expected = "doors of 'yard' are as modelled in the finder's new grid: gate was open. Set"
    assert (warning.filename, expected in str(warning.message)) == (__file__, True)
    assert str(warning.message).endswith("finder.use(grid.with_doors({'gate': 'open'}))")
    assert warning.category is navbake.DoorStateWarning
    finder.use(grid.inflate(0.1))
    finder.use(grid.with_doors({"gate": "open"}).inflate(0.1))
    other_scene = make_grid()
    other_scene.metadata["sceneId"] = "field"
    finder.use(other_scene.inflate(0.1))
    assert len(recwarn) == 1
