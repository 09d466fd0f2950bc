"""Lists of boxes by tiles, by bands and near cells, against a plain loop over all boxes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from navbake.baker.columns.columns import (
    MIN_BOXES_PER_TILE_FOR_THREADS,
    list_by_tile,
    list_by_tile_row,
)
from navbake.baker.core.arrays import Facets
from navbake.baker.core.tiles import TILE
from navbake.navgrid.lattice import Lattice
from navbake.threads import limit_threads

LATTICE = Lattice(x_min=-1.0, y_max=2.0, width=21, height=13, cell_size=0.1)
GROW = 0.07
NUM = 9 * MIN_BOXES_PER_TILE_FOR_THREADS  # more than are worth counts of their own


@pytest.fixture(params=range(8))
def boxes(request):
    """Boxes of all sizes, some beside the lattice."""
    rng = np.random.default_rng(request.param)
    low = rng.uniform((-2.0, 0.0, 0.0), (2.0, 3.0, 1.0), (NUM, 3))
    return np.hstack([low, low + rng.choice([0.0, 0.05, 0.4, 2.0], (NUM, 3))])


def spans(boxes, grow):
    """First and last column and row of cells that grown boxes reach, as numbers with fractions."""
    cell = LATTICE.cell_size
    left, right = boxes[:, 0] - grow - LATTICE.x_min, boxes[:, 3] + grow - LATTICE.x_min
    top, bottom = LATTICE.y_max - boxes[:, 4] - grow, LATTICE.y_max - boxes[:, 1] + grow
    return left / cell, right / cell, top / cell, bottom / cell


def as_lists(start, item):
    return [item[first:end].tolist() for first, end in itertools.pairwise(start)]


@pytest.mark.parametrize("threads", [1, 2])
def test_boxes_over_each_tile(boxes, threads):
    left, right, top, bottom = spans(boxes, GROW)
    expected = [
        np.flatnonzero(
            (left < col + TILE)
            & (right >= col)
            & (top < row + TILE)
            & (bottom >= row)
            & (left <= LATTICE.width)
            & (top <= LATTICE.height)
        ).tolist()
        for row in range(0, LATTICE.height, TILE)
        for col in range(0, LATTICE.width, TILE)
    ]
    with limit_threads(threads):
        found = as_lists(*list_by_tile(boxes, GROW, LATTICE))
    assert found == expected
    assert any(found)


@pytest.mark.parametrize("threads", [1, 2])
def test_boxes_that_hold_a_centre_in_each_band(boxes, threads):
    left, right, top, bottom = spans(boxes, GROW)
    cols, rows = np.arange(LATTICE.width) + 0.5, np.arange(LATTICE.height) + 0.5
    holds_col = (left[:, None] <= cols) & (right[:, None] >= cols)
    holds_row = (top[:, None] <= rows) & (bottom[:, None] >= rows)
    with limit_threads(threads):
        found = as_lists(*list_by_tile_row(boxes, GROW, LATTICE))
    for band, listed in enumerate(found):
        in_band = holds_row[:, band * TILE : (band + 1) * TILE].any(axis=1) & holds_col.any(axis=1)
        assert listed == np.flatnonzero(in_band).tolist()


def test_counts_are_no_more_than_boxes(monkeypatch, boxes):
    expected = list_by_tile(boxes, GROW, LATTICE)
    counts = []

    def run(count_or_list, chunks):
        counts.append(chunks)
        count_or_list(0, chunks)

    monkeypatch.setattr("navbake.baker.columns.columns.num_threads", lambda: 64)
    monkeypatch.setattr("navbake.baker.columns.columns.run_in_chunks", run)
    for one, other in zip(list_by_tile(boxes, GROW, LATTICE), expected, strict=True):
        np.testing.assert_array_equal(one, other)
    num_tiles = len(expected[0]) - 1
    assert all(chunks > 1 and chunks * num_tiles <= NUM for chunks in counts)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("list_boxes", [list_by_tile, list_by_tile_row])
def test_triangles_are_listed_by_their_boxes(boxes, list_boxes, threads):
    low, high = boxes[:, :3], boxes[:, 3:]
    vertices = np.stack([low, high, (low + high) / 2], axis=1).reshape(-1, 3)
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    geom, closed = np.zeros(NUM, np.int32), np.zeros(NUM, np.uint8)
    with limit_threads(threads):
        listed = list_boxes(Facets(vertices, faces, geom, geom, closed), GROW, LATTICE)
    for array, expected in zip(listed, list_boxes(boxes, GROW, LATTICE), strict=True):
        np.testing.assert_array_equal(array, expected)
