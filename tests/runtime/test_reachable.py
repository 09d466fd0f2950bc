"""Positions of a lattice that steps lead to, against a plain search step by step."""

from __future__ import annotations

import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from, random_house
from navbake.errors import QueryError
from navbake.runtime.path_finder import PathFinder
from project_paths import GOLDEN

ABOVE = np.array([0.0, 0.0, 1e-4])  # [m], so that rounding puts no place below its floor


def step_by_step(finder, start, spacing, radius):
    """The same positions by one `try_step` after another."""
    start = np.asarray(start, dtype=float)
    start = np.append(start[:2], finder.try_step(start, start)[2])
    todo, found = [((0, 0), start)], {}
    flat = finder.search.flat
    while todo:
        at, here = todo.pop(0)
        key = (*at, finder.cell_at(here).level)
        if key in found:
            continue
        center = flat.positions(flat.cells_at(here))
        off = np.abs(here - center)[:2].max()
        clear = off < 1e-6 or finder.clearance(here, max_distance=1.0 + 2 * radius) >= radius - 1e-9
        if at != (0, 0) and not clear:
            continue
        found[key] = here
        for step in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            there = (at[0] + step[0], at[1] + step[1])
            goal = start[:2] + np.array(there) * spacing
            end = finder.try_step(here, (*goal, 0.0), slide=False)
            if np.abs(end[:2] - goal).max() < 1e-5:
                todo.append((there, end))
    return np.array(list(found.values()))


def same_places(one, other):
    def ordered(p):
        return np.array(sorted(map(tuple, np.round(p, 5).tolist())))

    assert one.shape == other.shape
    np.testing.assert_allclose(ordered(one), ordered(other), atol=2e-5)


@pytest.mark.parametrize("seed", range(12))
def test_it_equals_a_search_step_by_step(seed):
    rng = np.random.default_rng(seed)
    finder = PathFinder(random_house(rng, 1 + seed % 3, 0.9, steps=seed % 2 == 0))
    spacing = float(rng.choice([0.1, 0.15, 0.25, 0.3]))
    start = finder.random_point(rng, anywhere=seed % 4 == 0) + ABOVE
    found = finder.reachable_positions(start, spacing)
    same_places(found, step_by_step(finder, start, spacing, finder.grid.agent_radius))
    np.testing.assert_allclose(found[0, :2], start[:2])


def test_the_apartment_is_covered_and_no_position_is_in_anything():
    grid = navbake.load(GOLDEN / "apartment.grid.json.gz").inflate(0.18)
    finder = PathFinder(grid)
    start = finder.snap((0.55, 0.45, 0.0))
    found = finder.reachable_positions(start, 0.2)
    same_places(found, step_by_step(finder, start, 0.2, 0.18))
    assert len(found) * 0.04 == pytest.approx(finder.island_area(1), rel=0.1)
    offset = (found - start)[:, :2] / 0.2
    np.testing.assert_allclose(offset, np.round(offset), atol=1e-4)
    assert finder.is_navigable(found).all()
    # between the cells' centres, where the agent would graze a wall, there is no position
    for p in finder.reachable_positions(start, 0.25):
        cell = finder.grid.position_of(finder.cell_at(p))
        assert np.allclose(cell[:2], p[:2]) or finder.clearance(p) >= 0.18 - 1e-6


def test_links_lead_to_other_levels():
    low, high = level_from("." * 6), level_from("." * 6, x=0.6, ground=0.2)
    finder = PathFinder(house_from([low, high], [((0, 0, 5), (1, 0, 0))]))
    found = finder.reachable_positions((0.05, -0.05, 0.0), 0.1)
    np.testing.assert_allclose(found[:, 0], np.arange(12) / 10 + 0.05)
    np.testing.assert_allclose(found[:, 2], [0.0] * 6 + [0.2] * 6)


@pytest.mark.parametrize("spacing", [0.0, -0.25, 0.05, np.nan, np.inf, "a"])
def test_a_wrong_spacing_is_told(spacing):
    finder = PathFinder(level_from("..."))
    with pytest.raises(QueryError, match=r"expected a spacing of a cell's 0\.1 m or more"):
        finder.reachable_positions((0.05, -0.05), spacing)


def test_the_start_must_be_free():
    finder = PathFinder(level_from("..#"))
    with pytest.raises(QueryError, match=r"no agent can stand at 0\.25, -0\.05"):
        finder.reachable_positions((0.25, -0.05))
