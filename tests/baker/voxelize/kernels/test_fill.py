"""Filling closed surfaces where rounding loses a crossing."""

from fractions import Fraction

import numpy as np
import pytest
import trimesh

from navbake.baker.voxelize.kernels.fill import fill_voxels
from navbake.baker.voxelize.kernels.tiles import CLOSED, bin_items, box_triangles


def fill(corners, origin, res, shape):
    """The voxels of one closed surface."""
    geom, mode = np.zeros(len(corners), np.int32), np.array([CLOSED], np.uint8)
    none, ids = np.zeros(0, np.int32), np.ones(1, np.uint8)
    solids = (none, np.zeros((0, 3)), np.zeros((0, 9)), np.zeros((0, 3)), np.zeros((0, 6)))
    boxes = box_triangles(corners, geom, mode)
    values = np.zeros(shape, np.uint8)
    fill_voxels(
        solids, ids[:0], *bin_items(np.zeros((0, 6)), origin, res, shape),
        (np.zeros((0, 3)), np.zeros((0, 9))), ids[:0],
        corners, geom, *bin_items(boxes, origin, res, shape), mode, ids,
        values, origin, res, 5e-7,
    )  # fmt: skip
    return values


@pytest.mark.parametrize("number", range(12))
@pytest.mark.parametrize("gap", [1e-13, -1e-13])
def test_a_gap_that_rounding_tore_leaves_no_streak(number, gap):
    """One triangle of a box is moved by a hair, so that lines over its edges run through."""
    corners = trimesh.creation.box((1.0, 1.0, 1.0)).triangles.copy()
    corners[number, :, 0] += gap
    corners[number, :, 1] -= gap / 3
    values = fill(corners, np.full(3, -1.0), 0.125, (16, 16, 16))
    assert values[4:12, 4:12, 4:12].all() and values.sum() == 8**3
    values = fill(corners, np.full(3, -0.5625), 0.125, (9, 9, 9))  # lines along all diagonals
    assert values.all()
    far = fill(corners, np.array([-0.5625, -0.5625, 0.6]), 0.125, (9, 9, 9))
    assert not far.any()


def test_without_the_second_line_there_would_be_a_streak():
    """The gap is one that matters: some of the moved boxes lose a crossing."""
    lost = 0
    for number in range(12):
        corners = trimesh.creation.box((1.0, 1.0, 1.0)).triangles.copy()
        corners[number, :, 0] += 1e-13
        lost += crossings(corners, 0.0, 0.0) % 2
    assert lost > 0


def crossings(corners, x, y):
    """How many triangles an upright line crosses, calculated exactly.

    A line that meets an edge counts as moved by a hair along x, and by a hair of that along y.
    """
    exact = [[[Fraction(v) for v in vertex[:2]] for vertex in triangle] for triangle in corners]
    return sum(is_inside(triangle, Fraction(x), Fraction(y)) for triangle in exact)


def is_inside(triangle, x, y):
    sides = set()
    for (ax, ay), (bx, by) in zip(triangle, triangle[1:] + triangle[:1], strict=True):
        cross = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
        sides.add(np.sign(cross or ay - by or bx - ax))
    return sides in ({1}, {-1})
