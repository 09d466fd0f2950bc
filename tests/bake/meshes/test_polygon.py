"""Polygons into triangles."""

import numpy as np
import pytest

from navbake.bake.meshes.polygon import triangulate

# an L, a comb, a square with a point on its edge, counter-clockwise in x, y
L = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
COMB = [
    (0, 0),
    (5, 0),
    (5, 3),
    (4, 3),
    (4, 1),
    (3, 1),
    (3, 3),
    (2, 3),
    (2, 1),
    (1, 1),
    (1, 3),
    (0, 3),
]
SEAM = [(0, 0), (1, 0), (2, 0), (2, 2), (0, 2)]
ARROW = [(0, 0), (2, 1), (0, 2), (1, 1)]
PENTAGON = [(np.cos(turn), np.sin(turn)) for turn in np.arange(5) * 2 * np.pi / 5]
FRAMES = [
    np.eye(3),
    np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    np.diag([1, -1, -1]),
    np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0],
]


def area(flat):
    x, y = np.transpose(flat)
    return (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2


def contains(flat, x, y):
    """Even-odd rule."""
    inside = np.zeros(len(x), bool)
    for (x0, y0), (x1, y1) in zip(flat, [*flat[1:], flat[0]], strict=True):
        if y0 != y1:
            inside ^= ((y0 <= y) != (y1 <= y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return inside


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("shift", range(3))
@pytest.mark.parametrize("polygon", [L, COMB, SEAM, ARROW, PENTAGON])
def test_covers_the_polygon_once(polygon, shift, frame):
    flat = np.roll(np.array(polygon, float), shift, axis=0)
    points = np.column_stack([flat, np.zeros(len(flat))]) @ frame.T + 7
    faces = triangulate(points, np.arange(len(flat)), np.array([len(flat)]))
    assert len(faces) == len(flat) - 2
    pieces = [flat[face] for face in faces]
    assert all(area(piece) >= 0 for piece in pieces)  # turning as the polygon
    x, y = np.random.default_rng(0).uniform(-1.1, 5.1, size=(2, 3000))
    cover = sum(contains([tuple(p) for p in piece], x, y).astype(int) for piece in pieces)
    np.testing.assert_array_equal(cover, contains([tuple(p) for p in flat], x, y))


def test_keeps_the_order_of_mixed_polygons():
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [5, 5, 5]], float)
    corners = np.array([0, 1, 2, 0, 1, 2, 3, 0, 1, 4, 3, 2, 1, 0])
    faces = triangulate(points, corners, np.array([3, 4, 2, 1, 4]))
    assert faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3], [3, 2, 1], [3, 1, 0]]


@pytest.mark.parametrize("sizes", [[], [2], [0, 1]])
def test_nothing_comes_of_nothing(sizes):
    corners = np.zeros(sum(sizes), np.int64)
    assert triangulate(np.zeros((1, 3)), corners, np.array(sizes, np.int64)).shape == (0, 3)


@pytest.mark.parametrize(
    "points", [np.zeros((6, 3)), np.arange(18.0).reshape(6, 3), np.full((6, 3), np.nan)]
)
def test_polygons_without_area_end(points):
    assert len(triangulate(points, np.arange(6), np.array([6]))) == 4
