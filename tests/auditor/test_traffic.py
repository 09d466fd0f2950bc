"""Audits of links and areas: nothing to say of the tower, and each planted fault is named."""

from __future__ import annotations

import copy
import re
from typing import Any

import numpy as np
import pytest

import navbake
from navbake.auditor.facts import ERROR, REMARK, Facts
from navbake.navgrid.islands import find_islands
from navbake.testing import assert_sound
from project_paths import GOLDEN


@pytest.fixture(scope="module")
def tower() -> Any:
    return navbake.load(GOLDEN / "tower.grid.json.gz")


def link_of(grid: Any, name: str) -> Any:
    links = grid.metadata["navbake"]["links"]
    return next(link for link in links if isinstance(link, dict) and link["name"] == name)


def on_one_level(grid: Any) -> None:
    link = link_of(grid, "lift_b")
    link["stops"] = [link["stops"][0], [0, link["stops"][0][1] - 300]]


def blocked(grid: Any) -> None:
    level, (_, cell) = grid.levels[1], link_of(grid, "lift_a")["stops"][1]
    level.weights.flat[cell], level.attributes["occupancy"].flat[cell] = np.inf, 1


def dead_spot(grid: Any) -> None:
    level, (_, cell) = grid.levels[2], link_of(grid, "lift_a")["stops"][2]
    row, col = divmod(cell, level.width)
    around = np.zeros(level.shape, dtype=np.bool_)
    around[row - 4 : row + 5, col - 4 : col + 5] = True
    around[row - 3 : row + 4, col - 3 : col + 4] = False
    level.weights[around], level.attributes["occupancy"][around] = np.inf, 1


def twice(grid: Any) -> None:
    link_of(grid, "lift_b")["name"] = "lift_a"


def unknown_agent(grid: Any) -> None:
    del grid.metadata["navbake"]["agents"]["robot"]


def empty_area(grid: Any) -> None:
    for level in grid.levels:
        level.attributes["area"][level.attributes["area"] == 2] = 0


def unlisted_area(grid: Any) -> None:
    grid.levels[0].attributes["area"][50, 50] = 9


def area_of_nobody(grid: Any) -> None:
    grid.metadata["navbake"]["areas"][0]["agents"] = ["cleaner"]


def test_nothing_to_say_of_the_tower(tower: Any) -> None:
    assert_sound(tower)
    assert navbake.audit(tower).remarks == []


@pytest.mark.parametrize(
    ("plant", "severity", "text"),
    [
        (on_one_level, REMARK, "all 2 stops of lift 'lift_b' are on one level"),
        (blocked, ERROR, "blocked is a stop of lift 'lift_a'"),
        (dead_spot, REMARK, r"lift 'lift_a' leads to 0\.\d\d m² of floor, and nothing else does"),
        (twice, ERROR, "expected unique names, got 'lift_a' twice"),
        (unknown_agent, ERROR, "lift 'lift_b' is for agent 'robot', whom the grid doesn't list"),
        (empty_area, REMARK, "area 'lab' covers no cell of any level"),
        (unlisted_area, ERROR, "1 cell is in an area that the table doesn't list"),
        (area_of_nobody, ERROR, "area 'lobby' is for agent 'cleaner', whom the grid doesn't list"),
    ],
)
def test_each_fault_is_named(tower: Any, plant: Any, severity: str, text: str) -> None:
    grid = copy.deepcopy(tower)
    plant(grid)
    for level in grid.levels:
        level.metadata = {}
    grid = grid.with_levels(grid.levels)
    told = [remark for remark in navbake.audit(grid).remarks if re.search(text, remark.text)]
    assert [remark.severity for remark in told][:1] == [severity]


@pytest.mark.parametrize("states", [{}, {"lift_a": "closed"}, {"drop 1": "closed"}])
def test_the_audit_numbers_islands_as_the_grid_does(tower: Any, states: dict[str, str]) -> None:
    grid = tower.with_links(states)
    for mine, own in zip(Facts(grid).islands, find_islands(grid), strict=True):
        np.testing.assert_array_equal(mine, own)
