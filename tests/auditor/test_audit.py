"""Audits: nothing to say about the samples, and each planted fault is named."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from
from navbake.auditor.audit import CHECKS
from navbake.auditor.report import ERROR, REMARK
from navbake.testing import assert_sound
from project_paths import GOLDEN

SAMPLES = sorted(path.name for path in GOLDEN.glob("*.grid.json.gz"))
PLANTS: dict[str, tuple[str, Callable[[Any], Any], str, str]] = {}
"""A sample, the fault that is planted into it, how bad it is, and what is said of it."""


def plant(sample: str, severity: str, text: str) -> Callable[[Any], Any]:
    """Register a function that plants a fault into a sample's grid."""

    def register(change: Any) -> Any:
        PLANTS[change.__name__] = (sample, change, severity, text)
        return change

    return register


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


@plant("apartment", REMARK, "all 8000 cells are free")
def everything_free(grid):
    grid.weights[:], grid.attributes["occupancy"][:] = 1.0, 0
    return restated(grid, rooms=None, doors=[])


@plant("house", ERROR, "no cell is free, on any level")
def everything_blocked(grid):
    for level in grid.levels:
        block(level, np.s_[:])


@plant("house", ERROR, r"level 1: none of its \d+ cells with a floor is free")
def upper_level_blocked(grid):
    block(grid.levels[1], np.s_[:])


@plant("house", ERROR, "level 1: no floor")
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


@plant("apartment", ERROR, r"the floor of one free cell jumps by 0\.80 m")
def floor_jumps(grid):
    row, col = np.argwhere(eroded(grid.free))[50].tolist()
    grid.attributes["floorHeight"][row, col] += 0.8


@plant("apartment", ERROR, "the layer `island` isn't what is connected")
def wrong_islands(grid):
    grid.attributes["island"] = grid.free.astype(np.uint16)
    grid.attributes["island"][free_cell(grid)] = 2


@plant("apartment", ERROR, "1 cell has a wrong `clearance`")
def wrong_clearance(grid):
    from navbake.navgrid.islands import clearance

    grid.attributes["clearance"] = clearance(grid)
    grid.attributes["clearance"][free_cell(grid)] += 0.5


@plant("house", ERROR, "cells are in room 40, which no entry describes")
def room_without_entry(grid):
    index = grid.levels[0].attributes["roomIndex"]
    index[index == 2] = 40


@plant("apartment", ERROR, "room 'cellar' has no cells")
def entry_without_cells(grid):
    room = {**grid.navbake["rooms"][0], "index": 9, "id": "cellar", "name": "cellar"}
    return restated(grid, rooms=[*grid.navbake["rooms"], room])


@plant("apartment", ERROR, r"room 'kitchen' has 8\.00 m², not 12\.00")
def wrong_area(grid):
    rooms = [{**r, "area": 12.0} if r["name"] == "kitchen" else r for r in grid.navbake["rooms"]]
    return restated(grid, rooms=rooms)


@plant("apartment", REMARK, r"room 'kitchen' of .* m² has no door")
def walled_up_room(grid):
    kitchen = next(room for room in grid.rooms if room.name == "kitchen")
    inside = grid.room_index == kitchen.index
    rim = inside & ~eroded(inside)
    block(grid, rim)
    return restated(grid, doors=[])


@plant("apartment", REMARK, "door 'door_kitchen' joins room 'kitchen' to itself")
def door_to_itself(grid):
    doors = [
        {**door, "rooms": ["kitchen", "kitchen"]} if door["id"] == "door_kitchen" else door
        for door in grid.navbake["doors"]
    ]
    return restated(grid, doors=doors)


@plant("apartment", ERROR, "door 'door_kitchen' joins room 'sauna', which there isn't")
def door_to_nowhere(grid):
    doors = [
        {**door, "rooms": ["kitchen", "sauna"]} if door["id"] == "door_kitchen" else door
        for door in grid.navbake["doors"]
    ]
    return restated(grid, doors=doors)


@plant("apartment", ERROR, r"door 'door_kitchen' is closed, but \d+ of its cells aren't occupied")
def door_of_another_state(grid):
    doors = [
        {**door, "state": "closed"} if door["id"] == "door_kitchen" else door
        for door in grid.navbake["doors"]
    ]
    return restated(grid, doors=doors)


@plant("house", REMARK, r"level 1 .*no link leads to its \d+\.\d m²")
def level_without_links(grid):
    return restated(grid, links=[])


@plant("house", ERROR, "its ground, .* is below that of the level before")
def levels_upside_down(grid):
    return grid.with_levels(grid.levels[::-1], {**grid.metadata, "navbake": {}})


@plant("house", ERROR, r"its cells lie 0\.400 of a cell beside")
def levels_on_two_lattices(grid):
    x, y, z = grid.levels[1].min_yup
    grid.levels[1].min_yup = (x + 0.04, y, z)


@plant("house", ERROR, "its floors are those of the level before, cell by cell")
def level_twice(grid):
    first = grid.levels[0]
    return grid.with_levels([first, first.with_layers()], {**grid.metadata, "navbake": {}})


@plant("house", ERROR, r"\d+ free cells lie outside of its box")
def box_without_its_cells(grid):
    low, high = grid.levels[0].bbox_yup
    grid.levels[0].bbox_yup = (low[0], 1.0, low[2]), high


@plant("house", REMARK, r"\d+ free cells lie in the box of a lower level, too")
def boxes_that_overlap(grid):
    low, high = grid.levels[0].bbox_yup
    grid.levels[0].bbox_yup = low, (high[0], 50.0, high[2])


@plant("house", ERROR, "expected an existing cell, got 99999999")
def link_to_no_cell(grid):
    return restated(grid, links=[[0, 99999999, 1, 0]])


@plant("house", ERROR, "links join cells that aren't neighbours")
def link_that_is_far(grid):
    links = [list(link) for link in grid.navbake["links"]]
    level = grid.levels[1]
    links[0][3] = int(np.flatnonzero(level.free)[-1])
    return restated(grid, links=links)


@plant("apartment", ERROR, r"the agent of 1\.14 m takes steps of 2 m")
def giant_steps(grid):
    grid.metadata["traversableFloorHeight"] = 2.0


@plant("apartment", ERROR, "`agentRadius` is -1, which is no length")
def negative_radius(grid):
    grid.metadata["agentRadius"] = -1


@plant("apartment", ERROR, "expected .* at `metadata.navbake.rooms")
def broken_room_table(grid):
    return restated(grid, rooms=[{"index": "one"}])


def eroded(mask: Any) -> Any:
    """A mask without the cells at its outline."""
    wide = np.pad(mask, 1)
    return wide[1:-1, 1:-1] & wide[2:, 1:-1] & wide[:-2, 1:-1] & wide[1:-1, 2:] & wide[1:-1, :-2]


# ---------------------------------------------------------------- tests


@pytest.mark.parametrize("name", SAMPLES)
def test_has_nothing_to_say_about_the_samples(name):
    report = assert_sound(GOLDEN / name)
    assert report.checks == list(CHECKS)
    assert report.ok


@pytest.mark.parametrize("name", PLANTS)
def test_names_what_was_planted(name):
    sample, change, severity, text = PLANTS[name]
    grid = load(sample)
    grid = change(grid) or grid
    report = navbake.audit(grid)
    said = "\n".join(str(r) for r in report.remarks if r.severity == severity)
    assert re.search(text, said), said or [str(r) for r in report.remarks]
    assert report.ok == (not report.errors)
    assert json.loads(json.dumps(report.to_json(), allow_nan=False))["ok"] == report.ok


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
    assert [r.check for r in navbake.audit(blocked).errors] == ["all blocked"]


def test_levels_of_a_chain_of_links_are_reached():
    levels = [level_from("...\n...", ground=3.0 * k) for k in range(3)]
    linked = house_from(levels, [((0, 0, 0), (1, 0, 0)), ((1, 0, 1), (2, 0, 1))])
    assert not [r for r in navbake.audit(linked).remarks if r.check == "unreached"]
    cut = house_from(levels, [((0, 0, 0), (1, 0, 0))])
    (found,) = [r for r in navbake.audit(cut).remarks if r.check == "unreached"]
    assert found.level == 2
