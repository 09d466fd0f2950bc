"""Polygons: which cells they cover, against a plain even-odd rule, and their faults."""

import re

import numpy as np
import pytest

from navbake.navgrid.lattice import Lattice, cover_cells, find_outline_fault

LATTICE = Lattice(x_min=-1.03, y_max=2.1, cell_size=0.1, width=40, height=33)


def even_odd(rings, lattice):
    x, y = np.meshgrid(lattice.center_x(), lattice.center_y())
    inside = np.zeros(lattice.shape, dtype=bool)
    for ring in rings:
        for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            crosses = (a[1] <= y) != (b[1] <= y)
            with np.errstate(divide="ignore", invalid="ignore"):
                at = a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1])
                inside ^= crosses & (at <= x)
    return inside


def test_covers_what_the_plain_rule_covers():
    rng = np.random.default_rng(0)
    for _ in range(100):
        rings = [rng.uniform(-2, 4, (rng.integers(3, 9), 2)) for _ in range(rng.integers(1, 3))]
        np.testing.assert_array_equal(cover_cells(rings, LATTICE), even_odd(rings, LATTICE))


def test_holes_and_parts():
    lattice = Lattice(0.0, 4.0, 1.0, 6, 4)
    outline, hole = [[0, 0], [4, 0], [4, 4], [0, 4]], [[1, 1], [3, 1], [3, 3], [1, 3]]
    part = [[5, 0], [6, 0], [6, 1], [5, 1]]
    covered = cover_cells([outline, hole, part], lattice)
    assert covered.astype(int).tolist() == [
        [1, 1, 1, 1, 0, 0],
        [1, 0, 0, 1, 0, 0],
        [1, 0, 0, 1, 0, 0],
        [1, 1, 1, 1, 0, 1],
    ]


def test_a_centre_on_a_common_side_is_in_one_polygon():
    lattice = Lattice(0.0, 4.0, 1.0, 4, 4)
    total = np.zeros(lattice.shape, dtype=int)
    for x in (-1.5, 0.5, 2.5):
        for y in (-1.5, 0.5, 2.5):
            square = [[x, y], [x + 2, y], [x + 2, y + 2], [x, y + 2]]
            total += cover_cells([square], lattice)
    assert (total == 1).all()
    # two triangles, the side between them through centres, given in opposite directions
    one = cover_cells([[[0, 0], [4, 4], [0, 4]]], lattice)
    other = cover_cells([[[4, 4], [0, 0], [4, 0]]], lattice)
    assert (one ^ other).all()


@pytest.mark.parametrize(
    ("points", "fault"),
    [
        ([[0, 0], [1, 1], [1, 0], [0, 1]], r"sides that cross: \[0, 0\] to \[1, 1\] and \[1, 0\]"),
        ([[0, 0], [1, 1], [2, 2]], "in a line"),
        ([[0, 0], [0, 0], [0, 0]], "in a line"),
        # the last side crosses the second
        ([[0, 0], [2, 0], [2, 2], [1, -1]], r"\[2, 0\] to \[2, 2\]|\[0, 0\] to \[2, 0\]"),
    ],
)
def test_faults(points, fault):
    found = find_outline_fault(points)
    assert found is not None

    assert re.search(fault, found)


@pytest.mark.parametrize(
    "points",
    [
        [[0, 0], [1, 0], [0, 1]],
        [[0, 0], [1, 0], [1, 0], [1, 1], [0, 1]],  # a corner twice
        [[0, 0], [2, 0], [2, 2], [1, 0], [0, 2]],  # a corner that touches a side
        [[500000, 0], [500001, 0], [500001, 1e-3]],
    ],
)
def test_no_fault(points):
    assert find_outline_fault(points) is None


def crossing(points):
    """The plain way to find the first two sides that cross."""
    ends = list(zip(points, np.roll(points, -1, axis=0).tolist(), strict=True))

    def turn(a, b, c):
        return np.sign((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))

    for i, (a, b) in enumerate(ends):
        for c, d in ends[i + 1 :]:
            if turn(a, b, c) * turn(a, b, d) < 0 and turn(c, d, a) * turn(c, d, b) < 0:
                return [a, b, c, d]
    return None


@pytest.mark.parametrize("seed", range(60))
def test_crossings_are_those_that_comparing_all_sides_finds(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 9)) if seed % 2 else 40
    angle = np.sort(rng.uniform(0, 6, count))
    points = np.stack([np.cos(angle), np.sin(angle)], axis=1).round(2)  # crosses only by rounding
    if seed % 3:
        points = rng.integers(0, 5, (count, 2)).astype(float)
    found, expected = find_outline_fault(points), crossing(points.tolist())
    if expected is None:
        assert found is None or "in a line" in found
    else:
        named = [f"[{x:g}, {y:g}]" for x, y in expected]
        assert found == "sides that cross: {} to {} and {} to {}".format(*named)
    monkeypatch.setattr("navbake.navgrid.lattice.MAX_PAIRS", 3 * len(points))
    assert find_outline_fault(points) == found  # three sides at once


def comb(teeth, slant):
    """An outline of long teeth, each beside all others along an axis; with slant, along both."""
    x = np.repeat(np.arange(2 * teeth), 2)[1:-1].astype(float)
    y = np.tile([0.0, 0.0, 1e4, 1e4], teeth)[1:-1]
    points = np.stack([x, y], axis=1)
    return np.vstack([points, [[2 * teeth, -1e4], [-1, -1e4]]]) @ np.array([[1, 0], [slant, 1]])


def test_outlines_of_many_long_sides_are_refused_before_they_are_compared():
    assert find_outline_fault(comb(2400, 0)) is None
    assert find_outline_fault(comb(400, 1)) is None
    assert find_outline_fault(comb(2400, 1)) is None
    assert "10001 corners" in find_outline_fault(np.ones((10_001, 2)))
