"""Lines over cells: what they and discs along them touch, and what they cost, cell by cell."""

import math

import numpy as np
import pytest

from kernel_parts import callable_part
from navbake.runtime import line_kernels as lines
from navbake.runtime.grid_arrays import EAST, SOUTH, FloorHeights, Graph, Layout, Links
from navbake.runtime.search_kernels import find_moves

# parts of kernels as functions that Python can call
crossed_cells, disc_passes, is_walkable, line_cost = (
    callable_part(part)
    for part in (
        lines.find_crossed_cells,
        lines.disc_passes,
        lines.is_walkable,
        lines.compute_line_cost,
    )
)

WIDTH, HEIGHT = 9, 7


def layout_of(cols, rows, first=0):
    """One level with cells of 1 m, whose corner is the origin of the lines' own units."""
    start = np.array([first, first + cols * rows])
    width, height = np.array([cols]), np.array([rows])
    return Layout(start, width, height, np.zeros(1), np.zeros(1), np.ones(1))


LAYOUT = layout_of(WIDTH, HEIGHT)


def touches(line, row, col):
    """Whether a line meets a closed square, by clipping it to the square's four sides."""
    u0, v0, u1, v1 = line
    enter, leave = 0.0, 1.0
    for start, end, low in ((u0, u1, col), (v0, v1, row)):
        low, high = low - 1e-9, low + 1 + 1e-9
        if start == end:
            if not low <= start <= high:
                return False
            continue
        a, b = sorted(((low - start) / (end - start), (high - start) / (end - start)))
        enter, leave = max(enter, a), min(leave, b)
    return enter <= leave


def random_line(rng):
    """Ends anywhere, or on centres, edges and corners, where lines are at their worst."""
    step = rng.choice([0.0, 0.5, 0.25])
    u, v = rng.uniform(0, WIDTH, 2), rng.uniform(0, HEIGHT, 2)
    if step:
        u, v = np.round(u / step) * step, np.round(v / step) * step
    return tuple(float(x) for x in (u[0], v[0], u[1], v[1]))


@pytest.mark.parametrize("seed", range(24))
def test_walkable_lines_touch_only_cells_that_hang_together(seed):
    rng = np.random.default_rng(seed)
    free = rng.random(WIDTH * HEIGHT) < rng.uniform(0.7, 1.0)
    anywhere = free & (rng.random(free.size) < 0.95)
    floor = rng.choice([0.0, 0.2, 0.4], free.size, p=[0.8, 0.1, 0.1])
    moves = np.zeros(free.size, np.uint8)
    no_slopes = np.zeros(0, dtype=np.uint8)
    floors, window = FloorHeights(floor, np.zeros(1), 0.25), (0, HEIGHT, 0, WIDTH)
    find_moves(free, free, floors, no_slopes, False, LAYOUT, 0, window, moves)
    answers = []
    for _ in range(40):
        line = random_line(rng)
        touched = {cell for cell in np.ndindex(HEIGHT, WIDTH) if touches(line, *cell)}
        outside = [
            cell
            for cell in [(r, c) for r in (-1, HEIGHT) for c in range(-1, WIDTH + 1)]
            + [(r, c) for r in range(HEIGHT) for c in (-1, WIDTH)]
            if touches(line, *cell)
        ]
        expected = not outside
        for row, col in touched:
            here = row * WIDTH + col
            expected &= bool(anywhere[here])
            for other, way in (((row, col + 1), EAST), ((row + 1, col), SOUTH)):
                if other in touched and free[here]:
                    expected &= bool(moves[here] & way)
        found = is_walkable(line[:2], line[2:], LAYOUT, 0, moves, anywhere)
        assert found == expected, line
        answers.append(found)
    assert seed > 0 or True in answers


@pytest.mark.parametrize("seed", range(12))
def test_costs_of_lines_are_those_of_their_parts(seed):
    rng = np.random.default_rng(seed)
    weight = rng.uniform(1, 9, WIDTH * HEIGHT)
    ends = rng.uniform(0.01, [WIDTH - 0.01, HEIGHT - 0.01], (2, 2))
    if seed % 3 == 0:
        ends = np.floor(ends) + 0.5
    (u0, v0), (u1, v1) = ends
    t = (np.arange(20_000) + 0.5) / 20_000
    u, v = u0 + t * (u1 - u0), v0 + t * (v1 - v0)
    parts = weight[np.floor(v).astype(int) * WIDTH + np.floor(u).astype(int)]
    expected = parts.mean() * np.hypot(u1 - u0, v1 - v0)
    no_links = Links(*np.zeros((3, 0), dtype=np.int64), *np.zeros((2, 0)), np.zeros(0, dtype=bool))
    graph = Graph(LAYOUT, no_links, np.zeros(0, np.uint8), weight, 0.0, 1.0, 1.0, 4)
    found = line_cost((u0, -v0), (u1, -v1), 0, graph)  # rows run against y
    assert found == pytest.approx(expected, abs=5e-3)


@pytest.mark.parametrize("seed", range(12))
def test_crossed_cells_follow_one_another(seed):
    rng = np.random.default_rng(seed)
    ends = rng.uniform(0.01, [WIDTH - 0.01, HEIGHT - 0.01], (2, 2))
    if seed % 2:
        ends = np.floor(ends) + 0.5
    cells, enter = crossed_cells(tuple(ends[0]), tuple(ends[1]), LAYOUT, 0)
    rows, cols = np.divmod(cells, WIDTH)
    assert (rows[0], cols[0]) == tuple(np.floor(ends[0][::-1]))
    assert (rows[-1], cols[-1]) == tuple(np.floor(ends[1][::-1]))
    assert np.abs(np.diff(rows)).max(initial=0) <= 1
    assert np.abs(np.diff(cols)).max(initial=0) <= 1
    assert enter[0] == 0.0
    assert enter[-1] == 1.0
    assert (np.diff(enter) >= 0).all()
    for k, (row, col) in enumerate(zip(rows, cols, strict=True)):
        middle = ends[0] + (enter[k] + enter[k + 1]) / 2 * (ends[1] - ends[0])
        assert (np.floor(middle[1]), np.floor(middle[0])) == (row, col)


COLS, ROWS = 12, 9  # of discs


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


@pytest.mark.parametrize("seed", range(16))
def test_a_disc_passes_where_no_square_is_nearer_than_its_radius(seed):
    rng = np.random.default_rng(seed)
    solid = rng.random((ROWS, COLS)) < 0.06
    first = int(rng.integers(0, 5))  # cells of a level before it
    before = np.append(0, np.cumsum(np.append(np.ones(first), solid))).astype(np.int32)
    layout = layout_of(COLS, ROWS, first)
    for _ in range(60):
        step = rng.choice([0.0, 0.5])  # centres, edges and corners, where discs just touch
        ends = rng.uniform(0, (COLS, ROWS), (2, 2))
        ends = np.round(ends / step) * step if step else ends
        a, b = (tuple(map(float, end)) for end in ends)
        radius = float(rng.choice([rng.uniform(0.1, 3), 0.5, 1.5, 2.0]))
        near = min((distance(a, b, *cell) for cell in np.argwhere(solid)), default=math.inf)
        expected = near >= radius * (1 - 1e-9)
        if abs(near - radius) < 1e-12 or abs(near - radius) > 1e-6:
            assert disc_passes(a, b, layout, 0, before, radius) == expected
