"""Filling closed surfaces where rounding loses a crossing."""

from fractions import Fraction

import numpy as np
import pytest
import trimesh

from navbake.baker.kernels.arrays import Tiles
from navbake.baker.kernels.constants import CLOSED_SURFACE, TOUCH
from navbake.baker.scene.shapes import Planes, Solids, Triangles
from navbake.baker.voxelize.kernels.fill import Voxels, fill_voxels
from navbake.baker.voxelize.kernels.tiles import bin_items, box_triangles


def fill(corners, origin, res, shape):
    """The voxels of one closed surface."""
    zeros, none = np.zeros(len(corners), np.int32), np.zeros(0, np.int32)
    triangles = Triangles(zeros, zeros, np.full(len(corners), CLOSED_SURFACE, np.uint8), corners)
    three, nine, six = (np.zeros((0, num)) for num in (3, 9, 6))
    solids, planes = Solids(none, none, three, nine, three, six), Planes(none, three, nine)
    boxes, place = box_triangles(triangles), (origin, res, shape)
    tiles = Tiles(*bin_items(solids.bounds, *place), *bin_items(boxes, *place))
    values = np.zeros(shape, np.uint8)
    voxels = Voxels(values, origin, res, TOUCH)
    num_tiles, ones = len(tiles.solid_start) - 1, np.ones(1, np.uint8)
    fill_voxels(voxels, solids, planes, triangles, tiles, ones, 0, num_tiles)
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
