"""Footprints against exact clipping of the polygon by each square."""

from __future__ import annotations

import math

import numpy as np
import pytest

from level_maps import level_of, make_level, stack, stairs
from navbake.errors import QueryError

L_SHAPE = [(-0.2, -0.2), (0.4, -0.2), (0.4, 0.0), (0.0, 0.0), (0.0, 0.3), (-0.2, 0.3)]
ARROW = [(0.35, 0.0), (-0.25, 0.22), (-0.1, 0.0), (-0.25, -0.22)]
CAR = [(0.33, 0.15), (-0.17, 0.15), (-0.17, -0.15), (0.33, -0.15)]


def overlap(polygon: np.ndarray, x: float, y: float, half: float) -> float:
    """Area that a polygon has in common with a square, by clipping it side by side."""
    points = polygon - (x, y)
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        depth = half - sign * points[:, axis]
        kept = []
        for k in range(len(points)):
            a, b, da, db = points[k - 1], points[k], depth[k - 1], depth[k]
            if (da < 0) != (db < 0):
                kept.append(a + (b - a) * da / (da - db))
            if db >= 0:
                kept.append(b)
        if not kept:
            return 0.0
        points = np.array(kept)
    ahead = np.roll(points, -1, axis=0)
    return abs((points[:, 0] * ahead[:, 1] - ahead[:, 0] * points[:, 1]).sum()) / 2


def free_by_clipping(level, polygon, angle) -> np.ndarray:
    cos, sin = math.cos(angle), math.sin(angle)
    turned = np.array([(cos * x - sin * y, sin * x + cos * y) for x, y in polygon])
    cell = level.lattice.cell_size
    free = level.free.copy()
    for row, col in np.argwhere(free):
        free[row, col] = not any(
            overlap(turned, (c - col) * cell, -(r - row) * cell, cell / 2) > 1e-9
            for r, c in np.argwhere(level.occupancy)
        )
    return free


@pytest.mark.parametrize("polygon", [L_SHAPE, ARROW, CAR])
@pytest.mark.parametrize("seed", range(6))
def test_free_is_where_the_polygon_meets_no_square(polygon, seed):
    rng = np.random.default_rng(seed)
    level = make_level(rng.random(rng.integers(5, 16, 2)) < 0.04)
    num_headings = int(rng.choice([1, 4, 5, 8]))
    polygon = polygon[::-1] if seed % 2 else polygon
    (masks,) = level.inflate_footprint(polygon, num_headings)
    assert masks.shape == (num_headings, level.height, level.width)
    assert masks.dtype == np.bool_
    for k in range(num_headings):
        expected = free_by_clipping(level, polygon, 2 * math.pi * k / num_headings)
        np.testing.assert_array_equal(masks[k], expected)


def test_headings_run_counter_clockwise_from_the_worlds_x():
    level = level_of(*["0" * 9] * 4, "0000#0000", *["0" * 9] * 4)
    nose = [(0.3, 0.04), (0.0, 0.04), (0.0, -0.04), (0.3, -0.04)]
    (masks,) = level.inflate_footprint(nose, 4)
    blocked = [np.argwhere(~mask).tolist() for mask in masks]
    assert blocked[0] == [[4, col] for col in (1, 2, 3, 4)]  # looks along x
    assert blocked[1] == [[row, 4] for row in (4, 5, 6, 7)]  # along y: row 5 is south of it
    assert blocked[2] == [[4, col] for col in (4, 5, 6, 7)]
    assert blocked[3] == [[row, 4] for row in (1, 2, 3, 4)]


def test_what_only_touches_does_not_meet():
    level = level_of("00000", "00000", "00#00", "00000", "00000")
    (masks,) = level.inflate_footprint([(0.05, 0.05), (-0.05, 0.05), (-0.05, -0.05), (0.05, -0.05)])
    assert (masks[0::4] == level.free).all()


def test_a_polygon_round_a_disc_is_free_nowhere_more_than_the_disc():
    rng = np.random.default_rng(0)
    flat = make_level(rng.random((30, 30)) < 0.02)
    angles = np.arange(16) / 16 * 2 * np.pi
    outside = 0.3 / math.cos(np.pi / 16) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    inside = 0.3 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ledges = make_level(rng.random((30, 30)) < 0.02, rng.choice([0, 0.8], (30, 30), p=[0.9, 0.1]))
    for grid in (flat, ledges, stairs(*["000000"] * 4, "0000#0"), stack(flat, ledges)):
        disc = [level.free for level in grid.inflate(0.3).levels]
        for mask, free in zip(grid.inflate_footprint(outside, 3), disc, strict=True):
            assert (mask <= free).all()
        for mask, free in zip(grid.inflate_footprint(inside, 3), disc, strict=True):
            assert (mask >= free).all()


@pytest.mark.parametrize(
    ("polygon", "headings", "culprit"),
    [
        ([(0, 0), (1, 0)], 4, r"n >= 3, got \(2, 2\)"),
        ([(0, 0, 0)] * 3, 4, r"got \(3, 3\)"),
        ("car", 4, "got 'car'"),
        ([(0, 0), (1, 0), (np.nan, 1)], 4, "finite numbers"),
        ([(0, 0), (1, 0), (2, 0)], 4, "in a line"),
        ([(0, 0), (1, 1), (1, 0), (0, 1)], 4, "sides that cross"),
        ([(0, 0), (1e6, 0), (0, 1)], 4, "within 1000 cells, got one of 10000001"),
        (CAR, 0, "1 to 720 headings, got 0"),
        (CAR, 4.5, "headings, got 4.5"),
    ],
)
def test_what_is_no_footprint_is_refused(polygon, headings, culprit):
    with pytest.raises(QueryError, match=culprit):
        level_of("00").inflate_footprint(polygon, headings)
