"""The widest agent that gets somewhere, against a bisection over inflated grids.

``NAVBAKE_EXAMPLES=200 pytest tests/runtime/test_passage.py`` asks more grids.
"""

from __future__ import annotations

import math
import os

import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from, random_house
from navbake.errors import QueryError
from navbake.navgrid.grid import SceneGrid2D
from navbake.runtime.path_finder import PathFinder
from project_paths import GOLDEN

EXAMPLES = int(os.environ.get("NAVBAKE_EXAMPLES", "30"))
FINE = 1e-6  # [m]
ABOVE = np.array([0.0, 0.0, 1e-4])  # [m], so that rounding puts no place below its floor

ROOMS = """
#################
#.......#.......#
#.......#.......#
#...............#
#...............#
#...............#
#.......#.......#
#.......#.......#
#################
"""


def bisect(passes, high):
    """The largest radius that passes, which all smaller ones do; None if not even 0 does."""
    if not passes(0.0):
        return None
    if passes(high):
        return math.inf
    low = 0.0
    while high - low > FINE:
        middle = (low + high) / 2
        low, high = (middle, high) if passes(middle) else (low, middle)
    return low


def random_grid(rng):
    """Levels with steps, holes and links; of any baked radius, with and without `solid`."""
    num_levels = int(rng.integers(1, 4))
    share = rng.choice([0.8, 0.95, 0.98])
    grid = random_house(rng, num_levels, share, size=(8, 18), steps=bool(rng.random() < 0.4))
    for level in grid.levels:
        holes = rng.random(level.shape) < rng.choice([0.0, 0.02])  # not occupied
        level.attributes["floorHeight"][holes] = np.nan
    grid.metadata["agentHeight"] = 1.14
    grid.metadata["agentRadius"] = float(rng.choice([0.0, 0.05, 0.08, 0.17]))
    if num_levels == 1:
        grid = grid.levels[0]
        grid.metadata = {k: v for k, v in grid.metadata.items() if k != "navbake"}
    if rng.random() < 0.4:
        grid.metadata["navbake"] = {"version": "1", **grid.metadata.get("navbake", {})}
        for level in grid.levels:
            solid = (level.occupancy != 0) & (rng.random(level.shape) < 0.8)
            level.attributes["solid"] = solid.astype(np.uint8)
    return grid


@pytest.mark.parametrize("seed", range(EXAMPLES))
def test_it_equals_bisection_over_inflate(seed):
    rng = np.random.default_rng(seed)
    grid = random_grid(rng)
    cut_corners, ledges = bool(rng.random() < 0.3), str(rng.choice(["avoid", "ignore"]))
    for level in grid.levels:
        if rng.random() < 0.3:  # something stands there for now
            row, col = rng.integers(level.shape)
            here = level.lattice.positions(row, col)
            grid.block(disc=(here, rng.uniform(0.02, 0.2)), level=grid.levels.index(level))
    finder = PathFinder(grid, cut_corners=cut_corners)
    cells = np.concatenate([v.free_for_point.ravel() for v in grid.levels]).nonzero()[0]
    flat = finder.search.flat
    away = finder.clearance(flat.positions(cells) + ABOVE)
    drawn = rng.integers(len(cells), size=(2, 10))  # ends that are not at a wall
    ends = cells[drawn[[0, 1], np.argmax(away[drawn], axis=1)]]
    start, goal = flat.positions(ends) + ABOVE

    def passes(radius):
        other = PathFinder(grid.inflate(radius, ledges=ledges), cut_corners=cut_corners)
        return other.find_path(start, goal) is not None

    found = finder.max_radius(start, goal, ledges=ledges)
    expected = bisect(passes, 5.0)
    if expected is None or math.isinf(expected):
        assert found is None if expected is None else found.radius == math.inf
        return
    assert found.radius == pytest.approx(expected, abs=2 * FINE)
    assert passes(found.radius) and not passes(found.radius * (1 + 1e-6) + 1e-9)
    # a larger agent can't stand at the bottleneck, and this one can
    cell = int(finder.search.flat.cells_at(found.position))
    inflated = [
        np.concatenate([v.free.ravel() for v in grid.inflate(radius, ledges=ledges).levels])
        for radius in (found.radius, found.radius * (1 + 1e-6) + 1e-9)
    ]
    assert inflated[0][cell] and not inflated[1][cell]


@pytest.mark.parametrize("cell_size", [0.03, 0.07, 0.13])
def test_radii_of_whole_and_half_cells_pass(cell_size):
    # in line with a post, the radius is a number of half cells that a bisection meets, too, but
    # rounds otherwise
    num_cells = 70
    text = "." * num_cells + "#"
    grid = level_from(text, cell_size=cell_size)
    finder = PathFinder(grid)
    for distance in range(1, num_cells + 1):
        place = [*grid.lattice.positions(0, num_cells - distance), 0.0]
        widest = finder.max_radius(place, place)
        assert widest.radius == pytest.approx((distance - 0.5) * cell_size, rel=1e-12)
        np.testing.assert_allclose(widest.position, place)


def test_the_bottleneck_is_the_opening_between_two_rooms():
    grid = level_from(ROOMS)
    found = PathFinder(grid).max_radius((0.45, -0.45), (1.25, -0.45))
    assert found.radius == pytest.approx(0.15)
    np.testing.assert_allclose(found.position, (0.85, -0.45, 0.0))


def test_an_inflated_grid_answers_as_the_one_before():
    grid = level_from(ROOMS)
    plain = PathFinder(grid).max_radius((0.45, -0.45), (1.25, -0.45))
    larger = PathFinder(grid.inflate(0.2))
    assert larger.find_path((0.45, -0.45), (1.25, -0.45)) is None
    found = larger.max_radius((0.45, -0.45), (1.25, -0.45))
    assert found.radius == plain.radius
    np.testing.assert_array_equal(found.position, plain.position)


def test_a_stair_between_levels_is_a_bottleneck():
    lower = level_from("..........\n" * 7)
    upper = level_from("..........\n" * 7, x=1.0, ground=0.2)
    house = house_from([lower, upper], [((0, 3, 9), (1, 3, 0))])
    found = PathFinder(house).max_radius((0.55, -0.35, 0.0), (1.55, -0.35, 0.2))
    assert found.radius == pytest.approx(
        bisect(
            lambda r: PathFinder(house.inflate(r)).same_island(
                (0.55, -0.35, 0.0), (1.55, -0.35, 0.2)
            ),
            1.0,
        ),
        abs=2 * FINE,
    )


def test_higher_floors_count_beyond_the_baked_radius():
    grid = level_from("9999\n....\n9999")
    grid.metadata["agentRadius"] = 0.08
    found = PathFinder(grid).max_radius((0.05, -0.15), (0.35, -0.15), ledges="ignore")
    assert found.radius == 0.08


def test_what_is_blocked_counts():
    grid = level_from(ROOMS)
    finder = PathFinder(grid)
    a, b = (0.45, -0.45), (1.25, -0.45)
    with grid.block(cells=(0, 3, 8)):
        assert finder.max_radius(a, b).radius == pytest.approx(0.05)
    with grid.block(cells=(np.zeros(3, int), np.array([3, 4, 5]), np.full(3, 8))):
        assert finder.max_radius(a, b) is None
    assert finder.max_radius(a, b).radius == pytest.approx(0.15)


def test_no_radius_is_too_large_where_nothing_is_in_the_way():
    grid = SceneGrid2D(width=4, height=3, cell_size=0.1, min_yup=(0, 0, 0), weights=np.ones((3, 4)))
    found = PathFinder(grid).max_radius((0.05, -0.05), (0.35, -0.25))
    assert found.radius == math.inf and found.position is None


def test_a_room_is_a_goal():
    finder = PathFinder(navbake.load(GOLDEN / "apartment.grid.json.gz"))
    found = finder.max_radius((0.5, 0.4, 0.0), "room:kitchen")
    assert found.radius == pytest.approx(0.25)  # its door is half open
    np.testing.assert_allclose(found.position, (2.57, 1.27, 0.0), atol=0.45)


@pytest.mark.parametrize(
    ("start", "goal", "message"),
    [
        ((0.05, -0.05), (1.45, -0.45), "no way from 0.05, -0.05: no agent can stand there"),
        ((0.25, 9.0), (1.45, -0.45), "no way from 0.25, 9: it lies beside the grid"),
        ((0.25, -0.45), (0.85, -0.15), "no way to the goal: no agent can stand there"),
        ((0.25, -0.45), (99.0, 0.0), "no way to the goal: it lies beside the grid"),
        ((0.25, np.nan), (1.45, -0.45), "expected a position of finite numbers"),
        ((0.25, -0.45), "room:kitchen", "no room 'kitchen'"),
        ((0.25, -0.45), "object:sofa", "how near an agent gets to an object"),
    ],
)
def test_a_wrong_question_says_what_is_wrong(start, goal, message):
    with pytest.raises(QueryError, match=message):
        PathFinder(level_from(ROOMS)).max_radius(start, goal)


def test_ledges_are_avoided_or_ignored():
    with pytest.raises(QueryError, match="avoid or ignore as ledges"):
        PathFinder(level_from(ROOMS)).max_radius((0.45, -0.45), (1.25, -0.45), ledges="no")
