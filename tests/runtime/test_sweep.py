"""Discs along lines, against the distance of the line from every solid square."""

import math

import numba
import numpy as np
import pytest

from navbake.runtime.kernels.arrays import Rect
from navbake.runtime.kernels.lines import disc_passes

# parts of kernels as functions that Python can call
disc_passes = numba.njit(disc_passes.py_func)

# parts of kernels as functions that Python can call
disc_passes = numba.njit(disc_passes.py_func)

WIDTH, HEIGHT = 12, 9


def distance(a, b, row, col):
    """From a line to a square; 0 where they meet."""
    enter, leave = 0.0, 1.0
    for start, end, low in ((a[0], b[0], col), (a[1], b[1], row)):
        if start == end:
            leave = leave if low <= start <= low + 1 else -1.0
            continue
        one, other = sorted(((low - start) / (end - start), (low + 1 - start) / (end - start)))
        enter, leave = max(enter, one), min(leave, other)
    if enter <= leave:
        return 0.0
    ends = [to_square(p, row, col) for p in (a, b)]
    corners = [to_line((c, r), a, b) for r in (row, row + 1) for c in (col, col + 1)]
    return min(ends + corners)


def to_square(p, row, col):
    return math.hypot(max(col - p[0], p[0] - col - 1, 0), max(row - p[1], p[1] - row - 1, 0))


def to_line(p, a, b):
    du, dv = b[0] - a[0], b[1] - a[1]
    square = du * du + dv * dv
    t = ((p[0] - a[0]) * du + (p[1] - a[1]) * dv) / square if square else 0.0
    t = min(max(t, 0.0), 1.0)
    return math.hypot(p[0] - a[0] - t * du, p[1] - a[1] - t * dv)


@pytest.mark.parametrize("seed", range(40))
def test_a_disc_passes_where_no_square_is_nearer_than_its_radius(seed):
    rng = np.random.default_rng(seed)
    solid = rng.random((HEIGHT, WIDTH)) < 0.06
    first = int(rng.integers(0, 5))  # cells of a level before it
    before = np.append(0, np.cumsum(np.append(np.ones(first), solid))).astype(np.int32)
    rect = Rect(first, WIDTH, HEIGHT)
    for _ in range(60):
        step = rng.choice([0.0, 0.5])  # centres, edges and corners, where discs just touch
        ends = rng.uniform(0, (WIDTH, HEIGHT), (2, 2))
        ends = np.round(ends / step) * step if step else ends
        a, b = (tuple(map(float, end)) for end in ends)
        radius = float(rng.choice([rng.uniform(0.1, 3), 0.5, 1.5, 2.0]))
        near = min((distance(a, b, *cell) for cell in np.argwhere(solid)), default=math.inf)
        expected = near >= radius * (1 - 1e-9)
        if abs(near - radius) < 1e-12 or abs(near - radius) > 1e-6:
            assert disc_passes(a, b, rect, before, radius, False) == expected
        reach = np.array([min(a[0], b[0]), min(a[1], b[1])]) - radius
        far = np.array([max(a[0], b[0]) - WIDTH, max(a[1], b[1]) - HEIGHT]) + radius
        inside = bool((reach >= -1e-9).all() and (far <= 1e-9).all())
        assert disc_passes(a, b, rect, before, radius, True) == (expected and inside)
