"""What the original client's ``refine`` gives, and costs near walls."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import navbake
from level_maps import level_of, make_level
from navbake.runtime.inflation import nav2_costs
from oracles import inflation
from project_paths import SHARED_DATA

CASES = SHARED_DATA / "minos_refine" / "cases.json"


def unpack(runs: list) -> np.ndarray:
    return np.repeat([np.inf if v is None else v for v in runs[::2]], runs[1::2])


@pytest.mark.skipif(not CASES.is_file(), reason=f"no {CASES}")
def test_minos_gives_what_the_original_gave():
    cases = json.loads(CASES.read_text())
    assert len(cases) == 12
    for case in cases:
        grid = navbake.load(json.dumps(case["grid"]).encode())
        inflated = grid.inflate(case["radius"], case["clearance"], mode="minos")
        expected = unpack(case["expected_weights"]).reshape(grid.levels[0].shape)
        np.testing.assert_array_equal(inflated.levels[0].weights, expected)


@pytest.mark.parametrize("seed", range(16))
def test_minos_is_refine_in_plain_words(seed):
    rng = np.random.default_rng(seed)
    shape = rng.integers(1, 16, 2)
    floor = np.where(rng.random(shape) < 0.1, np.nan, 0.0)
    level = make_level(rng.random(shape) < 0.06, floor, unit=rng.choice([1.0, 0.5]))
    radius, clearance = rng.choice([0, 0.04, 0.05, 0.1, 0.2, 0.27, 2.5], 2)
    weights = level.inflate(radius, clearance, mode="minos").weights
    np.testing.assert_array_equal(weights, inflation.refine(level, radius, clearance))


def test_minos_divides_the_sum():
    level = level_of("0" * 40, "0" * 19 + "#" + "0" * 20, *["0" * 40] * 8)
    steps = [0.05 * k for k in range(1, 20, 2)]
    differ = 0
    for radius in steps:
        for clearance in steps:
            weights = level.inflate(radius, clearance, mode="minos").weights
            np.testing.assert_array_equal(weights, inflation.refine(level, radius, clearance))
            differ += radius / 0.1 + clearance / 0.1 != (radius + clearance) / 0.1
    assert differ > 10  # the sum of the quotients would be another number


def test_the_window_is_lopsided():
    level = level_of(*["0" * 9] * 4, "0000#0000", *["0" * 9] * 4)
    weights = level.inflate(0.25, mode="minos").weights
    assert np.isinf(weights[4]).tolist() == [False] * 3 + [True] * 4 + [False] * 2
    assert np.isinf(weights[:, 4]).tolist() == [False] * 3 + [True] * 4 + [False] * 2


@pytest.mark.parametrize("seed", range(20))
def test_step_costs_lie_within_the_clearance(seed):
    rng = np.random.default_rng(seed)
    level = make_level(rng.random(rng.integers(3, 25, 2)) < 0.03)
    level.weights[level.free] = rng.choice([1.0, 20.0], level.free.sum())
    radius, clearance = rng.uniform(0, 0.4, 2)
    inflated = level.inflate(radius, clearance)
    free = inflation.exact_free(level, radius)
    near = free & ~inflation.exact_free(level, radius + clearance)
    expected = np.where(free, level.weights, np.inf)
    expected[near] = np.maximum(level.weights, 10)[near]
    np.testing.assert_array_equal(inflated.weights, expected)


@pytest.mark.parametrize("seed", range(20))
def test_nav2_costs_are_its_formula(seed):
    rng = np.random.default_rng(seed)
    level = make_level(rng.random(rng.integers(2, 20, 2)) < 0.02, cell=0.05)
    radius, scaling, inflation_radius = rng.uniform(0.05, 0.4), rng.choice([3.0, 10.0]), 0.55
    costs = nav2_costs(level, radius, inflation_radius, scaling)
    occupied = np.argwhere(level.occupancy)
    for row, col in np.ndindex(level.shape):
        d = min([0.05 * math.hypot(r - row, c - col) for r, c in occupied], default=math.inf)
        expected = math.floor(252 * math.exp(-scaling * (d - radius))) if d < 9 else 0
        expected = 0 if d > inflation_radius + 1e-9 else expected
        expected = 254 if d == 0 else 253 if d <= radius else expected
        assert costs[row, col] == expected


def test_nav2_costs_become_weights_and_open_nothing():
    level = level_of("0" * 14 + "#", cell=0.1)
    level.weights[0, 0] = np.inf
    weights = level.inflate(0.22, costs="nav2", clearance=0.5).weights[0]
    falling = [math.floor(252 * math.exp(-10 * (d / 10 - 0.22))) for d in range(3, 8)]
    assert falling == [113, 41, 15, 5, 2]
    assert weights.tolist() == [np.inf, *[1.0] * 6, *falling[::-1], *[np.inf] * 3]
    everywhere = level.inflate(0.22, costs="nav2").weights[0]
    np.testing.assert_array_equal(everywhere, weights)  # where it would be below 1, it is 1
    slow = level.inflate(0.22, costs="nav2", scaling=3.0).weights[0]
    assert slow[1] == math.floor(252 * math.exp(-3 * (1.3 - 0.22)))


def test_costs_that_hardly_fall_reach_everywhere():
    level = level_of("0000000000", "000#000000")
    weights = level.inflate(0.1, costs="nav2", scaling=1e-320).weights
    assert (weights[np.isfinite(weights)] == 252).all()
