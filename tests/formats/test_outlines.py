"""Outlines of any cells are valid polygons that hold the centres of these cells and no others."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from navbake.formats.shapes import trace_polygons
from navbake.navgrid.lattice import Lattice, cover_cells, find_outline_fault

SIDES = st.tuples(st.integers(1, 9), st.integers(1, 9))
LABELS = arrays(np.int32, SIDES, elements=st.integers(0, 3))
MASKS = arrays(np.int32, SIDES, elements=st.integers(0, 1))


def lattice_of(labels, cell=0.1):
    height, width = labels.shape
    return Lattice(-42.707, 0.3, cell, width, height)


def count_parts(mask):
    """Parts of cells that share edges, by a flood fill."""
    left, parts = {(int(r), int(c)) for r, c in np.argwhere(mask)}, 0
    while left:
        parts += 1
        stack = [left.pop()]
        while stack:
            row, col = stack.pop()
            for near in ((row + 1, col), (row - 1, col), (row, col + 1), (row, col - 1)):
                if near in left:
                    left.remove(near)
                    stack.append(near)
    return parts


@settings(deadline=None)
@given(st.one_of(LABELS, MASKS))
def test_outlines_hold_the_cells_of_their_label(labels):
    lattice = lattice_of(labels)
    found = trace_polygons(labels, lattice)
    x, y = np.meshgrid(lattice.center_x(), lattice.center_y())
    for label in range(1, 4):
        own = found.get(label, [])
        assert len(own) == count_parts(labels == label)
        polygons = [shapely.Polygon(rings[0], rings[1:]) for rings in own]
        joined = shapely.MultiPolygon(polygons)
        assert all(p.is_valid for p in polygons) and joined.is_valid
        inside = shapely.contains_xy(joined, x, y)
        np.testing.assert_array_equal(inside, labels == label)
        # by the rule of the settings, too
        rings = [ring for part in own for ring in part]
        np.testing.assert_array_equal(cover_cells(rings, lattice), labels == label)
        assert not any(find_outline_fault(ring) for ring in rings)
        assert joined.area == pytest.approx(np.count_nonzero(labels == label) * 0.01)


@settings(deadline=None)
@given(LABELS)
def test_rings_turn_as_geojson_demands_and_have_corners_only(labels):
    found = trace_polygons(labels, lattice_of(labels))
    assert list(found) == sorted(found)
    for rings in (rings for parts in found.values() for rings in parts):
        for number, ring in enumerate(rings):
            assert shapely.LinearRing(ring).is_ccw == (number == 0)
            steps = np.roll(ring, -1, axis=0) - ring
            is_along_x = np.abs(steps[:, 1]) < 1e-9
            assert (is_along_x != np.roll(is_along_x, 1)).all()  # each corner is a turn
            assert len(np.unique(ring, axis=0)) == len(ring)


@pytest.mark.parametrize(
    ("cells", "sizes"),
    [
        # corners of each ring, by part
        (["##", "##"], [[4]]),
        (["#.", ".#"], [[4], [4]]),
        (["###", "#.#", "###"], [[4, 4]]),
        (["####", "#..#", "#.##", "####"], [[4, 6]]),
        # two holes that touch at a corner
        (["####", "#.##", "##.#", "####"], [[4, 4, 4]]),
        # a hole that touches the outer ring
        ([".###", "#.##", "####"], [[6, 4]]),
        # one that opens to the outside at a corner only, the cells round it connected elsewhere
        (["###", "#.#", "##."], [[6, 4]]),
        # an island in a hole
        (["#####", "#...#", "#.#.#", "#...#", "#####"], [[4, 4], [4]]),
        (["."], []),
    ],
)
def test_holes_and_corners_that_touch(cells, sizes):
    mask = np.array([[c == "#" for c in row] for row in cells])
    parts = trace_polygons(mask, lattice_of(mask)).get(1, [])
    assert [[len(ring) for ring in part] for part in parts] == sizes


def test_coordinates_are_round_where_cells_are_not_tiny():
    (ring,) = trace_polygons(np.ones((3, 2)), Lattice(0.1, 0.3, 0.1, 2, 3))[1][0]
    assert sorted(ring.tolist()) == [[0.1, 0.0], [0.1, 0.3], [0.3, 0.0], [0.3, 0.3]]
    (tiny,) = trace_polygons(np.ones((1, 1)), Lattice(0.0, 0.0, 3e-8, 1, 1))[1][0]
    assert tiny[:, 0].max() == 3e-8


def test_many_cells_take_a_moment():
    labels = np.random.default_rng(0).integers(0, 3, size=(500, 500))
    found = trace_polygons(labels, lattice_of(labels, 1.0))
    doubled = 0
    for ring in (ring for parts in found.values() for part in parts for ring in part):
        x, y = ring.T
        doubled += (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()
    assert round(doubled) == 2 * np.count_nonzero(labels)
