"""Audits: nothing to say about the samples, and each planted fault is named."""

from __future__ import annotations

import copy
import json
import pickle
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from
from navbake.auditor.audit import CHECKS, run_check
from navbake.auditor.facts import ERROR, REMARK, Facts, Remark
from navbake.errors import FormatError
from navbake.navgrid.islands import add_layers, find_islands, measure_clearance
from navbake.navgrid.links import Agent
from navbake.testing import assert_sound
from project_paths import GOLDEN

SAMPLES = sorted(path.name for path in GOLDEN.glob("*.grid.json.gz"))
Where = Callable[[Any], list[tuple[int, int]]]


class Plant(NamedTuple):
    """A fault that is planted into a sample's grid, and what is said of it.

    Attributes:
        sample: the sample.
        change: what plants it.
        severity, text: of what is said.
        where: the levels and cells, one of which is named; None for those whose layers change.
            The number of a level that is named without a place; -1 for neither.
    """

    sample: str
    change: Callable[[Any], Any]
    severity: str
    text: str
    where: Where | int | None


PLANTS: dict[str, Plant] = {}
"""The faults by their names."""


def plant(
    sample: str, severity: str, text: str, where: Where | int | None = None
) -> Callable[[Any], Any]:
    """Register a function that plants a fault into a sample's grid; see `Plant`."""

    def register(change: Any) -> Any:
        PLANTS[change.__name__] = Plant(sample, change, severity, text, where)
        return change

    return register


def changed_cells(name: str, grid: Any) -> list[tuple[int, int]]:
    """The levels and cells where a layer of a sample was changed."""
    found = []
    for number, (level, old) in enumerate(zip(grid.levels, load(name).levels, strict=True)):
        changed = level.weights != old.weights
        for key, values in level.attributes.items():
            before = old.attributes.get(key)
            if before is not None:
                changed |= (values != before) & ~((values != values) & (before != before))
        if "clearance" in level.attributes and "clearance" not in old.attributes:
            changed |= level.attributes["clearance"] != measure_clearance(old)
        if "island" in level.attributes and "island" not in old.attributes:
            changed |= level.attributes["island"] != find_islands(old)[0]
        found += [(number, cell) for cell in np.flatnonzero(changed).tolist()]
    return found


def of_level(number: int) -> Where:
    """All free cells of a level."""
    return lambda grid: [(number, int(k)) for k in np.flatnonzero(grid.levels[number].free)]


def of_room(name: str) -> Where:
    """The cells of a room on the lowest level."""

    def find(grid: Any) -> list[tuple[int, int]]:
        index = next(room.index for room in grid.rooms if room.name == name)
        return [(0, int(k)) for k in np.flatnonzero(grid.levels[0].room_index == index)]

    return find


def of_door(name: str) -> Where:
    """The cells that a door blocks in any state."""

    def find(grid: Any) -> list[tuple[int, int]]:
        door = next(door for door in grid.doors if door.id == name)
        states = [door.cells_in(state, len(grid.levels)) for state in door.cells]
        return [(k, int(c)) for levels in states for k, cells in enumerate(levels) for c in cells]

    return find


def of_first_link(grid: Any) -> list[tuple[int, int]]:
    """Where the first link begins."""
    return [(grid.steps[0].level, grid.steps[0].cell)]


def load(sample: str) -> Any:
    """A sample's grid whose layers and metadata can be changed."""
    grid: Any = navbake.load(GOLDEN / f"{sample}.grid.json.gz")
    metadata = copy.deepcopy(grid.metadata)
    levels = [
        level.with_layers(
            weights=level.weights.copy(),
            attributes={name: array.copy() for name, array in level.attributes.items()},
            metadata={} if len(grid.levels) > 1 else metadata,
        )
        for level in grid.levels
    ]
    return grid.with_levels(levels, metadata)


def block(level: Any, where: Any) -> None:
    level.weights[where], level.attributes["occupancy"][where] = np.inf, 1


def free_cell(level: Any, number: int = 200) -> tuple[int, int]:
    row, col = np.argwhere(level.free)[number].tolist()
    return row, col


def restated(grid: Any, **changes: Any) -> Any:
    """The grid with other entries in navbake's metadata."""
    own = {**grid.navbake, **changes}
    return grid.with_levels(grid.levels, {**grid.metadata, "navbake": own})


# ---------------------------------------------------------------- faults


@plant("apartment", REMARK, "all 8000 cells are free", -1)
def everything_free(grid):
    grid.weights[:], grid.attributes["occupancy"][:] = 1.0, 0
    return restated(grid, rooms=None, doors=[])


@plant("house", ERROR, "no cell is free, on any level", -1)
def everything_blocked(grid):
    for level in grid.levels:
        block(level, np.s_[:])


@plant("house", ERROR, r"level 1: none of its \d+ cells with a floor is free", 1)
def upper_level_blocked(grid):
    block(grid.levels[1], np.s_[:])


@plant("house", ERROR, "level 1: no floor", 1)
def upper_level_empty(grid):
    block(grid.levels[1], np.s_[:])
    grid.levels[1].attributes["floorHeight"][:] = np.nan


@plant("apartment", ERROR, "1 cell is free by weight, but occupied")
def free_and_occupied(grid):
    grid.attributes["occupancy"][free_cell(grid)] = 1


@plant("apartment", ERROR, "1 cell is blocked by weight, but not occupied")
def blocked_and_empty(grid):
    grid.weights[free_cell(grid)] = np.inf


@plant("apartment", ERROR, "1 cell has a weight that is no cost")
def negative_weight(grid):
    grid.weights[free_cell(grid)] = -1.0


@plant("apartment", ERROR, "1 cell is free without a floor")
def free_without_floor(grid):
    grid.attributes["floorHeight"][free_cell(grid)] = np.nan


@plant("apartment", ERROR, "1 cell is farther than 10000 m from 0")
def floor_far_away(grid):
    grid.attributes["floorHeight"][np.unravel_index(0, grid.shape)] = 5e6


@plant("apartment", ERROR, r"0.01 m² of floor \(1 cell\) lies 0\.80 m above all round it")
def floor_jumps(grid):
    row, col = np.argwhere(eroded(grid.free))[50].tolist()
    grid.attributes["floorHeight"][row, col] += 0.8


def floor_patch(grid: Any, size: int) -> Any:
    """A square of free cells, with free cells all round it."""
    inside = grid.free
    for _ in range(size // 2 + 1):
        inside = eroded(inside)
    row, col = np.argwhere(inside)[len(np.argwhere(inside)) // 2].tolist()
    row, col = row - size // 2, col - size // 2
    return np.s_[row : row + size, col : col + size]


@plant("apartment", ERROR, r"0\.09 m² of floor \(9 cells\) lies 0\.80 m above all round it")
def raised_patch(grid):
    grid.attributes["floorHeight"][floor_patch(grid, 3)] += 0.8


@plant("apartment", ERROR, r"0\.09 m² of floor \(9 cells\) lies 0\.30 m below all round it")
def sunken_patch(grid):
    grid.attributes["floorHeight"][floor_patch(grid, 3)] -= 0.3


@plant("warehouse", REMARK, r"1\.21 m² of floor \(121 cells\) lies 1\.00 m above all round it")
def platform_without_steps(grid):
    grid.levels[0].attributes["floorHeight"][floor_patch(grid.levels[0], 11)] += 1.0


@plant("apartment", REMARK, r"lies 0\.80 m above most of what is round it")
def raised_corner_of_a_room(grid):
    corners = grid.free.copy()
    for away in ((-1, 0), (0, -1)):
        corners &= ~np.roll(grid.free, (-away[0], -away[1]), (0, 1))
    for row, col in np.argwhere(corners).tolist():
        if grid.free[row : row + 4, col : col + 4].all():
            grid.attributes["floorHeight"][row : row + 3, col : col + 3] += 0.8
            return


@plant("apartment", REMARK, r"a gap 0\.10 m wide is blocked by one cell, and cuts off \d\.\d m²")
def one_cell_between_two_halves(grid):
    kitchen = np.argwhere(
        grid.room_index == next(r.index for r in grid.rooms if r.name == "kitchen")
    )
    col = int(np.median(kitchen[:, 1]))
    rows = kitchen[kitchen[:, 1] == col][:, 0]
    block(grid, (rows, col))
    row = next(r for r in rows[3:] if grid.free[r, col - 1] and grid.free[r, col + 1])
    grid.attributes["occupancy"][row, col] = 0
    return grid


@plant("apartment", REMARK, r"only 5 of \d+ cells are free", of_level(0))
def hardly_any_cell_is_free(grid):
    where = np.nonzero(grid.free)
    block(grid, (where[0][5:], where[1][5:]))


@plant("apartment", ERROR, "1 cell has a number in the layer `island` that isn't what is connected")
def wrong_islands(grid):
    grid.attributes["island"] = find_islands(grid)[0].astype(np.uint16)
    grid.attributes["island"][free_cell(grid)] = 9


@plant("apartment", ERROR, "1 cell has a wrong `clearance`")
def wrong_clearance(grid):
    grid.attributes["clearance"] = measure_clearance(grid)
    grid.attributes["clearance"][free_cell(grid)] += 0.5


@plant("house", ERROR, "cells are in room 40, which no entry describes")
def room_without_entry(grid):
    index = grid.levels[0].attributes["roomIndex"]
    index[index == 2] = 40


@plant(
    "apartment", ERROR, "room 'cellar' has no cells", lambda grid: of_room(grid.rooms[0].name)(grid)
)
def entry_without_cells(grid):
    room = {**grid.navbake["rooms"][0], "index": 9, "id": "cellar", "name": "cellar"}
    return restated(grid, rooms=[*grid.navbake["rooms"], room])


@plant(
    "apartment", ERROR, r"room 'kitchen' lies 0\.07 m from where its entry says", of_room("kitchen")
)
def shifted_by_half_a_cell(grid):
    x, y, z = grid.min_yup
    grid.min_yup = (x + grid.cell_size / 2, y, z + grid.cell_size / 2)


@plant(
    "apartment",
    ERROR,
    r"room 'kitchen' lies \d\.\d\d m from where its entry says",
    of_room("kitchen"),
)
def mirrored_map(grid):
    layers = {name: array[:, ::-1].copy() for name, array in grid.attributes.items()}
    return grid.with_layers(weights=grid.weights[:, ::-1].copy(), attributes=layers)


@plant("apartment", ERROR, r"room 'kitchen' has 8\.00 m², not 12\.00", of_room("kitchen"))
def wrong_area(grid):
    rooms = [{**r, "area": 12.0} if r["name"] == "kitchen" else r for r in grid.navbake["rooms"]]
    return restated(grid, rooms=rooms)


@plant("apartment", REMARK, r"nothing leads out of room 'kitchen' \(.* m²\)", of_room("kitchen"))
def walled_up_room(grid):
    kitchen = next(room for room in grid.rooms if room.name == "kitchen")
    inside = grid.room_index == kitchen.index
    rim = inside & ~eroded(inside)
    block(grid, rim)
    return restated(grid, doors=[])


def with_door(grid: Any, **changes: Any) -> Any:
    """The grid with other entries of the kitchen's door."""
    doors = grid.navbake["doors"]
    is_kitchens = [door["id"] == "door_kitchen" for door in doors]
    changed = [
        {**door, **changes} if k else door for door, k in zip(doors, is_kitchens, strict=True)
    ]
    return restated(grid, doors=changed)


KITCHENS_DOOR = of_door("door_kitchen")


@plant("apartment", REMARK, "'door_kitchen' joins room 'kitchen' to itself", KITCHENS_DOOR)
def door_to_itself(grid):
    return with_door(grid, rooms=["kitchen", "kitchen"])


@plant("apartment", ERROR, "'door_kitchen' joins room 'sauna', which there isn't", KITCHENS_DOOR)
def door_to_nowhere(grid):
    return with_door(grid, rooms=["kitchen", "sauna"])


@plant("apartment", ERROR, r"is closed, but \d+ of its cells aren't occupied", KITCHENS_DOOR)
def door_of_another_state(grid):
    return with_door(grid, state="closed")


@plant("apartment", ERROR, r"removed, but \d+ cells are occupied that it blocks in", KITCHENS_DOOR)
def door_that_was_not_removed(grid):
    return with_door(grid, state="removed")


@plant("house", REMARK, r"level 1 .*no link leads to its \d+\.\d m²", of_level(1))
def level_without_links(grid):
    return restated(grid, links=[])


@plant("house", ERROR, r"\d+ free cells a step away from level 0 have no link to it", of_level(1))
def stairs_without_links(grid):
    return restated(grid, links=[])


@plant("house", ERROR, "its ground, .* is below that of the level before", 1)
def levels_upside_down(grid):
    return grid.with_levels(grid.levels[::-1], {**grid.metadata, "navbake": {}})


@plant("house", ERROR, r"its cells lie 0\.400 of a cell beside", 1)
def levels_on_two_lattices(grid):
    x, y, z = grid.levels[1].min_yup
    grid.levels[1].min_yup = (x + 0.04, y, z)


@plant("house", ERROR, "its corner is at infinite or NaN coordinates", 1)
def level_at_no_place(grid):
    grid.levels[1].min_yup = (0.0, float("nan"), 0.0)


@plant("apartment", ERROR, "its cells have a size of -0.1 m", 0)
def cells_without_size(grid):
    grid.cell_size = -0.1


@plant("apartment", ERROR, r"8000 cells are farther than 10000 m from 0")
def floors_without_end(grid):
    grid.attributes["floorHeight"][:] = np.inf


@plant("house", ERROR, "its floors are those of the level before, cell by cell", 1)
def level_twice(grid):
    first = grid.levels[0]
    return grid.with_levels([first, first.with_layers()], {**grid.metadata, "navbake": {}})


@plant("house", ERROR, r"\d+ free cells lie outside of its box", of_level(0))
def box_without_its_cells(grid):
    low, high = grid.levels[0].bbox_yup
    grid.levels[0].bbox_yup = (low[0], 1.0, low[2]), high


@plant("house", REMARK, r"\d+ free cells lie in the box of a lower level, too", of_level(1))
def boxes_that_overlap(grid):
    low, high = grid.levels[0].bbox_yup
    grid.levels[0].bbox_yup = low, (high[0], 50.0, high[2])


@plant("house", ERROR, "expected an existing cell, got cell 99999999", -1)
def link_to_no_cell(grid):
    return restated(grid, links=[[0, 99999999, 1, 0]])


@plant("house", ERROR, "1 link leads to cells that aren't neighbours", of_first_link)
def link_that_is_far(grid):
    links = [list(link) for link in grid.navbake["links"]]
    level = grid.levels[1]
    links[0][3] = int(np.flatnonzero(level.free)[-1])
    return restated(grid, links=links)


@plant("house", ERROR, r"1 link leads up by more than 0\.25 m: 3\.00 m", of_first_link)
def link_up_a_storey(grid):
    above, below = grid.levels[1].lattice, grid.levels[0].lattice
    row, col = np.argwhere(grid.levels[1].free)[300].tolist()
    under = below.rows_cols(above.positions(row, col))
    links = [[0, int(under[0] * below.width + under[1]), 1, row * above.width + col]]
    return restated(grid, links=links + grid.navbake["links"])


@plant("house", REMARK, r"its storey is 26\.00 m high: is the unit right\?", 1)
def high_storeys(grid):
    """As of a house whose lengths are ten times too large."""
    low, high = grid.levels[1].bbox_yup
    grid.levels[1].bbox_yup = (low, (high[0], low[1] + 26.0, high[2]))


@plant("apartment", ERROR, r"the agent of 1\.14 m takes steps of 2 m", -1)
def giant_steps(grid):
    grid.metadata["traversableFloorHeight"] = 2.0


@plant("apartment", ERROR, r"`agentHeight` is 2 m, but its settings say .* for 1\.14 m", -1)
def another_agent(grid):
    grid.metadata["agentHeight"] = 2.0


@plant("apartment", ERROR, "`agentRadius` is -1, which is no length >= 0: it counts as 0 m", -1)
def negative_radius(grid):
    grid.metadata["agentRadius"] = -1


@plant("apartment", ERROR, "`agentHeight` is 0, which is no length > 0: it counts as 1.14 m", -1)
def agent_without_height(grid):
    grid.metadata["agentHeight"] = 0


@plant("apartment", ERROR, r"`inflation\[0\]` is .*None.*, expected its radius", -1)
def inflation_without_radius(grid):
    grid.metadata["inflation"] = [{"radius": None, "mode": "exact"}]


@plant("apartment", ERROR, "1 cell is blocked by weight, but not occupied$")
def blocked_by_a_broken_inflation(grid):
    grid.metadata["inflation"] = "x"
    grid.weights[free_cell(grid)] = np.inf


@plant(
    "apartment", ERROR, r"1 cell is blocked .* nothing that an inflation avoids is within 0\.1 m"
)
def blocked_farther_than_inflated(grid):
    inflated = grid.inflate(0.1)
    middle = np.argmax(np.where(inflated.free, measure_clearance(grid), 0))
    inflated.weights.ravel()[middle] = np.inf
    return inflated


@plant("apartment", ERROR, "expected .* at `metadata.navbake.rooms", -1)
def broken_room_table(grid):
    return restated(grid, rooms=[{"index": "one"}])


@plant(
    "tower",
    REMARK,
    "all 2 stops of lift 'lift_b' are on one level",
    lambda grid: [(0, grid.links[1].stops[0].cell)],
)
def lift_without_storeys(grid: Any) -> None:
    link = next(e for e in grid.metadata["navbake"]["links"] if "lift_b" in str(e))
    link["stops"][1] = [0, link["stops"][0][1] - 300]


@plant("tower", REMARK, "area 'lab' covers no cell of any level", -1)
def area_without_cells(grid: Any) -> None:
    for level in grid.levels:
        level.attributes["area"][level.attributes["area"] == 2] = 0


def eroded(mask: Any) -> Any:
    """A mask without the cells at its outline."""
    wide = np.pad(mask, 1)
    return wide[1:-1, 1:-1] & wide[2:, 1:-1] & wide[:-2, 1:-1] & wide[1:-1, 2:] & wide[1:-1, :-2]


# ---------------------------------------------------------------- tests


@pytest.mark.parametrize("name", SAMPLES)
def test_has_nothing_to_say_about_the_samples(name):
    report = assert_sound(GOLDEN / name)
    assert report.checks == [name for name, _ in CHECKS.values()]
    assert len(set(report.checks)) == len(report.checks)
    assert report.ok


@pytest.mark.parametrize("name", PLANTS)
def test_names_what_was_planted(name):
    """With its place, and nothing that the sample's grid has already."""
    sample, change, severity, text, where = PLANTS[name]
    grid = load(sample)
    grid = change(grid) or grid
    report = navbake.audit(grid)
    said = [r for r in report.remarks if r.severity == severity and re.search(text, str(r))]
    assert len(said) == 1, [str(r) for r in report.remarks]
    (found,) = said
    if isinstance(where, int):
        assert (found.level, found.place) == (None if where < 0 else where, None)
    else:
        cell = grid.cell_at(found.place, found.level)
        width = grid.levels[cell.level].width
        cells = changed_cells(sample, grid) if where is None else where(grid)
        assert (cell.level, cell.row * width + cell.col) in cells
    assert report.ok == (not report.errors)
    assert json.loads(json.dumps(report.to_json(), allow_nan=False))["ok"] == report.ok


def test_faults_of_many_kinds_are_planted():
    """At least twenty, and each check sees one."""
    assert len({(plant.sample, plant.text) for plant in PLANTS.values()}) == len(PLANTS) >= 20
    blind = dict(CHECKS)
    for plant in PLANTS.values():
        grid = load(plant.sample)
        facts = Facts(plant.change(grid) or grid)
        for name, (_, check) in list(blind.items()):
            said = [str(Remark("", *f)) for f in run_check(check, facts) if f[0] == plant.severity]
            if any(re.search(plant.text, text) for text in said):
                del blind[name]
    assert not blind


@pytest.mark.parametrize("name", SAMPLES)
def test_has_no_errors_to_say_about_what_is_made_of_samples(name):
    """Inflated in all ways, with doors in all states, and blocked for a while."""
    grid = navbake.load(GOLDEN / name)
    ways: list[dict[str, Any]] = [
        {"radius": 0.3},
        {"radius": 0.2, "ledges": "ignore"},
        {"radius": 0.2, "clearance": 0.3, "mode": "minos"},
        {"radius": 1.5, "clearance": 0.3},
    ]
    made = [grid.inflate(**way) for way in ways]
    made += [grid.with_doors({d.id: state}) for d in grid.doors for state in d.states]
    for agent in (Agent("low", step=0.1), Agent("wide", step=0.1, radius=0.3)):
        made.append(navbake.PathFinder(grid, agent=agent).grid)
    for other in made:
        assert_sound(other, remarks=False)
    with grid.block(disc=(grid.rooms[0].centroid, 0.5)):
        assert_sound(grid)
        assert_sound(grid.inflate(0.2), remarks=False)


@pytest.mark.parametrize("name", ["apartment", "tower"])
def test_has_no_errors_to_say_about_layers_of_grids_while_something_is_blocked(name, tmp_path):
    """Of the grid itself, of those made of it, and of those read from files of it."""
    grid = load(name)
    add_layers(grid, ["island", "clearance"])
    level = grid.levels[0]
    row, col = free_cell(level)
    with grid.block(disc=(level.lattice.positions(row, col), 0.5), level=0):
        finder = navbake.PathFinder(grid, agent=Agent("low", step=0.1))
        grid.save(tmp_path / "blocked.grid.json")
        grid.to_npz(tmp_path / "blocked.npz")
        made = {
            "itself": grid,
            "without obstacles": grid.without_obstacles(),
            "inflated": grid.inflate(0.2),
            "with other doors": grid.with_doors("open"),
            "of a finder": finder.grid,
            "a copy": copy.deepcopy(grid),
            "unpickled": pickle.loads(pickle.dumps(grid)),
            "from a file": navbake.load(tmp_path / "blocked.grid.json"),
            "from an archive": navbake.from_npz(tmp_path / "blocked.npz"),
        }
        for kind, other in made.items():
            assert navbake.audit(other).errors == [], kind
    for kind in ("a copy", "unpickled", "from a file", "from an archive"):
        assert not made[kind].levels[0].free[row, col], kind
    assert finder.grid.levels[0].free[row, col]
    assert_sound(finder.grid, remarks=False)
    assert_sound(grid, remarks=False)


def test_a_step_higher_than_that_of_the_settings_is_told_and_a_lower_one_is_not():
    grid = load("apartment")
    grid.metadata["traversableFloorHeight"] = 0.3
    (error,) = navbake.audit(grid).errors
    assert error.check == "agent"
    text = "`traversableFloorHeight` is 0.3 m, but its settings say that it was baked for 0.25 m"
    assert error.text == text
    grid.metadata["traversableFloorHeight"] = 0.05
    assert navbake.audit(grid).errors == []


@pytest.mark.parametrize(
    ("broken", "radius"),
    [("x", "x"), (3, True), ({}, np.nan), ([None], None), ([{}], -1), ([[1]], [1]), ([True], {})],
)
def test_a_broken_note_on_an_inflation_is_told(broken, radius):
    """It counts for nothing, also beside one that is whole."""
    grid = load("apartment")
    whole = {"radius": 0.1, "clearance": 0.0, "mode": "exact"}
    for stated in (broken, [{**whole, "radius": radius}], [whole, {**whole, "radius": radius}]):
        grid.metadata["inflation"] = stated
        (error,) = navbake.audit(grid).errors
        assert error.check == "inflation" and "expected" in error.text
    grid.metadata["inflation"] = broken
    grid.weights[free_cell(grid)] = np.inf
    assert {error.check for error in navbake.audit(grid).errors} == {"inflation", "weights"}
    foreign = {key: value for key, value in grid.metadata.items() if key != "navbake"}
    said = navbake.audit(grid.with_levels([grid], foreign)).remarks
    assert [r.severity for r in said if r.check == "inflation"] == [REMARK]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("agentHeight", value) for value in (-1, "1.14", True, np.nan, np.inf, 1e11, [1])),
        *((key, value) for key in ("agentRadius", "traversableFloorHeight") for value in (-1, [1])),
    ],
)
def test_sizes_of_an_agent_that_are_none(key, value):
    grid = load("apartment")
    grid.metadata[key] = value
    (error,) = navbake.audit(grid).errors
    assert error.check == "agent" and f"`{key}` is {value!r}, which is no length" in error.text


def test_two_doors_may_share_cells():
    """A cell that another door blocks, as it stands, is no fault of this one."""
    level = level_from("..........\n....##....\n..........", cell_size=0.5)
    leaf = {"joint": None, "rooms": [], "cells": {"closed": [[0, [14, 1]]], "open": [[0, [15, 1]]]}}
    other = {"joint": None, "rooms": [], "cells": {"closed": [[0, [14, 2]]]}}
    doors = [{"id": "a", "state": "open", **leaf}, {"id": "b", "state": "closed", **other}]
    level.metadata["navbake"] = {"doors": doors}
    assert not navbake.audit(level).errors
    doors[1]["state"] = "removed"
    level.metadata["navbake"] = {"doors": [*doors]}
    errors = navbake.audit(level).errors
    assert [e.text for e in errors] == [
        "door 'a' is open, but 1 cell is occupied that it blocks in other states only",
        "door 'b' is removed, but 1 cell is occupied that it blocks in other states only",
    ]


def test_a_terrace_is_no_patch():
    """Higher than one neighbour and lower than the other; so is a gallery that stairs lead to."""
    terraces = level_from("\n".join(["....4444....8888"] * 12).replace("....8", "4448"))
    assert not [r for r in navbake.audit(terraces).remarks if r.check == "jumps"]
    gallery = level_from("." * 9 + "\n" + "\n".join(["..99999.."] * 5) + "\n..97531..")
    assert not [r for r in navbake.audit(gallery).remarks if r.check == "jumps"]
    cut = level_from("." * 9 + "\n" + "\n".join(["..99999.."] * 5) + "\n" + "." * 9)
    assert [r.severity for r in navbake.audit(cut).remarks if r.check == "jumps"] == [ERROR]


@pytest.mark.parametrize("grid", [None, 5, [1], b"{}", np.zeros((3, 3))])
def test_what_is_no_grid_is_refused(grid):
    with pytest.raises(FormatError, match="expected a grid or the path of its file, got"):
        navbake.audit(grid)


CUT = """
###########
#.........#
#.........#
#.........#
#####+#####
#.........#
#.........#
#.........#
###########
"""


def test_names_an_island_that_one_cell_cuts_off():
    """The gap's place and width; a thin wall is none, nor is the gap once it is open."""
    level = level_from(CUT, cell_size=0.4, floors=True)
    cut = [r for r in navbake.audit(level).remarks if r.check == "cut off"]
    assert len(cut) == 1 and "0.40 m wide" in cut[0].text and "cuts off 4.3 m²" in cut[0].text
    x, y, _ = cut[0].place
    assert (round(x, 3), round(y, 3)) == (2.2, -1.8)
    thin = level_from(CUT.replace("#####+#####", "#" + "+" * 9 + "#"), cell_size=0.4)
    opened = level_from(CUT.replace("+", "."), cell_size=0.4)
    for other in (thin, opened):
        assert not [r for r in navbake.audit(other).remarks if r.check == "cut off"]


def test_grids_of_others_are_audited_too():
    """Without floors, occupancy, rooms, boxes or anything of navbake's."""
    free = np.ones((20, 20))
    free[5, :] = np.inf
    bare = navbake.SceneGrid2D(
        width=20, height=20, cell_size=0.5, min_yup=(0.0, 0.0, 0.0), weights=free
    )
    assert navbake.audit(bare).remarks == []
    blocked = bare.with_layers(weights=np.full((20, 20), np.inf))
    assert [r.check for r in navbake.audit(blocked).errors] == ["empty level"]


def test_levels_of_a_chain_of_links_are_reached():
    levels = [level_from("...\n...", ground=3.0 * k) for k in range(3)]
    linked = house_from(levels, [((0, 0, 0), (1, 0, 0)), ((1, 0, 1), (2, 0, 1))])
    assert not [r for r in navbake.audit(linked).remarks if r.check == "unreached"]
    cut = house_from(levels, [((0, 0, 0), (1, 0, 0))])
    (found,) = [r for r in navbake.audit(cut).remarks if r.check == "unreached"]
    assert found.level == 2
