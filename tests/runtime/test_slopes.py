"""Inflation on ramps that are one walk by their slopes, and beside them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import navbake
from level_maps import make_level
from navbake.navgrid.grid import MultiLevelGrid
from navbake.navgrid.islands import find_islands
from project_paths import SHARED_DATA

STEP = 0.25
RAMP = SHARED_DATA / "hard_cases" / "7_ramp15.xml"


@pytest.mark.skipif(not RAMP.exists(), reason="no shared data")
def test_a_ramp_stays_one_walk_but_not_beside_its_drop():
    agent = {"traversable_floor_height": 0.02}
    grid = navbake.bake({"scene": {"path": str(RAMP)}, "agent": agent})
    finder = navbake.PathFinder(grid.inflate(0.2))
    path = finder.find_path((-5, 0, 0), (8, 0, 1))
    assert path is not None
    assert path.length == pytest.approx(13.0, abs=0.05)
    low, high = grid.inflate(0.2), grid.inflate(0.2, ledges="ignore")
    np.testing.assert_array_equal(low.free, high.free)  # both ends of each way are free
    assert find_islands(low)[0].max() == 1
    box = [(0.2, 0.2), (-0.2, 0.2), (-0.2, -0.2), (0.2, -0.2)]
    mask = grid.inflate_footprint(box, 4)[0]
    assert (mask == low.free).mean() > 0.97


def with_links(floor, pairs, shape=None):
    """A level with links between cells (row, col)."""
    level = make_level(np.zeros(np.shape(floor), dtype=bool), np.asarray(floor, dtype=np.float32))
    width = np.shape(floor)[1]
    ids = [[0, a[0] * width + a[1], 0, b[0] * width + b[1]] for a, b in pairs]
    level.metadata.setdefault("navbake", {})["links"] = ids
    return level


def steep_pairs(floor, columns):
    """Neighbours along the rows, in some columns, that are more than a step apart."""
    rows, cols = np.shape(floor)
    return [
        ((r, c), (r, c + 1))
        for r in range(rows)
        for c in columns
        if c + 1 < cols and abs(floor[r][c] - floor[r][c + 1]) > STEP
    ]


def test_a_slope_is_no_ledge_and_a_drop_beside_it_is_one():
    row = [0.0, 0.0, 0.0, 0.3, 0.6, 0.9, 0.9, 0.9]
    floor = [[0.0] * 8] * 3 + [row] * 5
    level = with_links(floor, steep_pairs(floor, range(8)))
    free = level.inflate(0.2).free
    # two cells and a half from the side of the ramp, all along it
    assert free[6:].all()
    assert not free[3:5, 4:].any()
    assert not free[1:3, 4:].any()
    without = with_links(floor, [])
    assert not without.inflate(0.2).free[6:, 2:6].any()
    # the upper half of the ramp is a drop where no link leads down it
    half = with_links(floor, steep_pairs(floor, range(4)))
    assert not half.inflate(0.2).free[6:, 4:6].any()


def test_a_ramp_that_leads_to_another_level():
    lower = make_level(np.zeros((3, 5), dtype=bool), np.float32([[0, 0, 0, 0.3, 0.6]] * 3))
    upper = make_level(np.zeros((3, 4), dtype=bool), np.full((3, 4), 0.9, np.float32), col=5)
    links = [[0, 5 * r + c, 0, 5 * r + c + 1] for r in range(3) for c in (2, 3)]
    links += [[0, 5 * r + 4, 1, 4 * r] for r in range(3)]
    metadata = {"traversableFloorHeight": STEP, "agentHeight": 1.14, "navbake": {"links": links}}

    def free(metadata):
        grid = MultiLevelGrid(grids=[lower, upper], cell_size=lower.cell_size, metadata=metadata)
        return [level.free[1].tolist() for level in grid.inflate(0.06).levels]

    assert free(metadata) == [[True, True, True, True, True], [True, True, True, True]]
    unlinked = free({**metadata, "navbake": {"links": []}})
    assert unlinked == [[True, True, False, False, False], [False, True, True, True]]


def plain_free(floor, pairs, radius, cell):
    """Cells that stay free on a level, by the rule's words: every cell against every other."""
    joined = {frozenset(pair) for pair in pairs}
    rows, cols = floor.shape
    free = np.ones(floor.shape, dtype=bool)
    for a in np.ndindex(rows, cols):
        for b in np.ndindex(rows, cols):
            away = [max(abs(i - j) - 0.5, 0.0) for i, j in zip(a, b, strict=True)]
            if np.hypot(*away) * cell >= radius * (1 - 1e-9):
                continue
            if abs(float(floor[a]) - float(floor[b])) > STEP + 1e-5:
                free[a] &= is_walk(floor, joined, a, b)
    return free


def is_walk(floor, joined, a, b):
    """Over steps and at least one link along the line: of diagonals, round either corner."""
    count = max(abs(a[0] - b[0]), abs(a[1] - b[1]))
    line = [
        tuple(
            i + int(np.sign(j - i) * np.floor(abs(j - i) * k / count + 0.5))
            for i, j in zip(a, b, strict=True)
        )
        for k in range(count + 1)
    ]
    num_links = 0
    for p, q in pairwise(line):
        corners = [(p[0], q[1]), (q[0], p[1])]
        ways = [[p, c, q] for c in corners] if p[0] != q[0] and p[1] != q[1] else [[p, q]]
        found = [n for way in ways if (n := num_of_links(floor, joined, way)) is not None]
        if not found:
            return False
        num_links += max(found)
    return num_links > 0


def num_of_links(floor, joined, way):
    """How many links a way takes; None where something is neither a step nor a link."""
    num = 0
    for p, q in pairwise(way):
        if abs(float(floor[p]) - float(floor[q])) > STEP + 1e-5:
            if frozenset((p, q)) not in joined:
                return None
            num += 1
    return num


@pytest.mark.parametrize("seed", range(30))
def test_slopes_are_as_the_rule_says(seed):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(3, 9, 2))
    if seed % 2:  # mostly a plane
        a, b = rng.uniform(-0.4, 0.4, 2)
        floor = a * np.arange(shape[0])[:, None] + b * np.arange(shape[1])[None]
    else:
        floor = rng.choice([0.0, 0.2, 0.4, 0.9], shape)
    floor = floor.astype(np.float32)
    steep = [
        ((r, c), (r + dr, c + dc))
        for r, c in np.ndindex(shape)
        for dr, dc in ((0, 1), (1, 0))
        if r + dr < shape[0]
        and c + dc < shape[1]
        and abs(float(floor[r, c]) - float(floor[r + dr, c + dc])) > STEP + 1e-5
    ]
    pairs = [pair for pair in steep if rng.random() < 0.9]
    level = with_links(floor, pairs)
    for radius in (0.06, 0.16, 0.27):
        expected = plain_free(floor, pairs, radius, level.lattice.cell_size)
        np.testing.assert_array_equal(level.inflate(radius).free, expected)
