"""Steps stay on free cells, go through no wall, and slide along what is in the way."""

from __future__ import annotations

import heapq
import math

import numpy as np
import pytest

from grid_maps import house_from, level_from, random_house
from navbake.errors import QueryError
from navbake.runtime.path_finder import PathFinder


def step(grid, start, end, **options):
    return PathFinder(grid).try_step(start, end, **options)


def test_a_free_way_is_walked_to_its_end():
    level = level_from("....\n....\n....")
    np.testing.assert_allclose(step(level, (0.03, -0.02), (0.37, -0.28)), (0.37, -0.28, 0.0))


def test_a_wall_is_not_crossed_however_thin_and_however_long_the_step():
    level = level_from("...#....\n" * 5)
    for slide in (False, True):
        x, y, _ = step(level, (0.05, -0.25), (0.75, -0.25), slide=slide)
        assert (x, y) == (pytest.approx(0.3, abs=1e-6), pytest.approx(-0.25))
        assert x < 0.3


def test_the_edge_of_the_grid_is_a_wall():
    level = level_from("...")
    x, y, _ = step(level, (0.05, -0.05), (-5.0, -0.05))
    assert (x, y) == (pytest.approx(0.0, abs=1e-6), pytest.approx(-0.05))


def test_sliding_goes_along_a_wall():
    level = level_from("########\n" + "........\n" * 4)
    straight = step(level, (0.05, -0.15), (0.55, 0.0), slide=False)
    slid = step(level, (0.05, -0.15), (0.55, 0.0))
    assert slid[0] == pytest.approx(0.55) and slid[1] == pytest.approx(-0.1, abs=1e-6)
    assert straight[0] < 0.25


def test_sliding_goes_along_a_wall_that_is_not_parallel_to_the_cells():
    rows = ["." * max(0, 20 - col) + "#" * min(20, col) for col in range(20)]
    level = level_from("\n".join(row[:20] for row in rows))
    start, end = np.array((1.05, -0.65)), np.array((1.75, -0.65))
    slid = step(level, start, end)
    stuck = step(level, start, end, slide=False)
    assert stuck[0] == pytest.approx(1.4, abs=0.11)
    # the nearest point of the slope: halfway between the two axes
    assert math.hypot(*(slid[:2] - end)) < 0.75 * math.hypot(*(stuck[:2] - end))
    assert slid[1] > -0.65 + 0.1


def test_sliding_does_not_go_round_the_end_of_a_wall_that_is_far_away():
    level = level_from("..........\n" + "....#.....\n" * 9)
    x, _, _ = step(level, (0.35, -0.85), (0.65, -0.85))
    assert x < 0.4


def test_a_step_up_is_limited():
    level = level_from("00222555")
    assert step(level, (0.05, -0.05), (0.75, -0.05))[0] == pytest.approx(0.5, abs=1e-6)
    assert step(level, (0.05, -0.05), (0.45, -0.05))[2] == pytest.approx(0.2)


def stairs():
    """Up to 1 m in steps of 0.2 on level 0; level 1 at 1.2 m goes on to the right, over it."""
    lower = level_from("02468.....")
    lower.floor_height[0, 5:] = 0.0
    lower.floor_height[0, 4] = 1.0
    lower.floor_height[0, 3] = 0.8
    upper = level_from("#    .....", ground=1.2)
    return house_from([lower, upper], [((0, 0, 4), (1, 0, 5))])


def test_links_lead_up_and_down():
    house = stairs()
    lower = house.levels[0]
    lower.floor_height[0] = (0.0, 0.25, 0.5, 0.75, 1.0, 0, 0, 0, 0, 0)
    up = step(house, (0.05, -0.05, 0.0), (0.85, -0.05))
    np.testing.assert_allclose(up, (0.85, -0.05, 1.2), atol=1e-6)
    down = step(house, up, (0.05, -0.05, 0.0))
    np.testing.assert_allclose(down, (0.05, -0.05, 0.0), atol=1e-6)
    under = step(house, (0.85, -0.05, 0.0), (0.05, -0.05))
    np.testing.assert_allclose(under, (0.5, -0.05, 0.0), atol=1e-6)
    slid = step(house, (0.15, -0.09, 0.25), (0.85, 0.3))
    assert slid[2] == pytest.approx(1.2)  # sliding uses links too


@pytest.mark.parametrize("seed", range(12))
def test_steps_on_random_houses(seed):
    """Never off free cells; straight ones as dense samples say; sliding ends no farther away."""
    rng = np.random.default_rng(seed)
    house = random_house(rng, num_levels=1 + seed % 3, share=rng.uniform(0.5, 0.95))
    finder = PathFinder(house)
    flat = finder.search.flat
    cells = rng.choice(np.flatnonzero(flat.free), size=60)
    for cell in cells:
        start = flat.positions(cell) + np.append(rng.uniform(-0.049, 0.049, size=2), 0.0)
        end = start[:2] + rng.normal(size=2) * rng.choice([0.05, 0.3, 1.0])
        straight = finder.try_step(start, end, slide=False)
        slid = finder.try_step(start, end)
        for found in (straight, slid):
            there = flat.cells_at(found)
            assert flat.free[there]
            assert found[2] == pytest.approx(flat.positions(np.array(there))[2])
            assert math.dist(found[:2], start[:2]) <= math.dist(end, start[:2]) + 1e-6
        assert math.dist(slid[:2], end) <= math.dist(straight[:2], end) + 1e-6
        np.testing.assert_allclose(straight[:2], plain_straight(flat, cell, start, end), atol=2e-4)
        assert way_between(flat, int(cell), int(flat.cells_at(slid)), math.dist(end, start[:2]))


def plain_straight(flat, cell, start, end, samples=20000):
    """The last of many points on the way that cells still let one reach."""
    points = start[:2] + np.linspace(0, 1, samples)[:, None] * (end - start[:2])
    cell = int(cell)
    corner = flat.positions(np.array(cell))[:2] - 0.05
    at = np.floor((points - corner) / 0.1).astype(int)
    for i in np.flatnonzero((at[1:] != at[:-1]).any(axis=1)):
        right, up = at[i + 1] - at[i]
        following = plain_neighbours(flat, cell).get((right, -up))
        if following is None:
            return points[i]
        cell = following
    return points[-1]


def plain_neighbours(flat, cell):
    """Cells over the edges of a cell by (columns to the right, rows down)."""
    level = int(flat.level_of(np.array(cell)))
    row, col = divmod(cell - int(flat.layout.start[level]), int(flat.layout.width[level]))
    found = {}
    slot = np.flatnonzero(flat.steps.cell == cell)
    if len(slot):
        here = flat.positions(np.array(cell))
        for other in flat.steps.target[flat.steps.start[slot[0]] : flat.steps.start[slot[0] + 1]]:
            if flat.free[other]:
                offset = np.round((flat.positions(other) - here)[:2] / 0.1 * [1, -1])
                found[tuple(offset.astype(int))] = int(other)
    for right, down in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        height, width = int(flat.layout.height[level]), int(flat.layout.width[level])
        inside = 0 <= row + down < height and 0 <= col + right < width
        other, z = cell + down * width + right, flat.floors.z
        if inside and flat.free[other] and abs(z[other] - z[cell]) <= 0.2501:
            found[(right, down)] = other
    return found


def way_between(flat, start, goal, length):
    """Whether a walk over edges leads there within a window that the step can reach."""
    seen, queue = {start}, [start]
    places = flat.positions(np.arange(flat.num_cells))[:, :2]
    is_near = np.linalg.norm(places - places[start], axis=1) <= 2 * length + 0.5
    while queue:
        cell = queue.pop()
        if cell == goal:
            return True
        for other in plain_neighbours(flat, cell).values():
            if other not in seen and is_near[other]:
                seen.add(other)
                queue.append(other)
    return False


def plain_slide(flat, start, stopped, end):
    """How near to the end a short walk on from where the straight one stopped can get."""
    left = math.dist(stopped[:2], end)
    limit = 1.09 * left + 0.15
    home = int(flat.cells_at(stopped))
    length, queue, nearest = {home: 0.0}, [(0.0, home)], math.inf
    while queue:
        here, cell = heapq.heappop(queue)
        if here > length[cell]:
            continue
        middle = flat.positions(np.array(cell))[:2]
        point = np.clip(end, middle - 0.05, middle + 0.05)
        if math.dist(point, stopped[:2]) <= left + 1e-6:
            nearest = min(nearest, math.dist(point, end))
        around = plain_neighbours(flat, cell)
        ways = [(other, 0.1) for other in around.values()]
        for one in ((1, 0), (-1, 0)):
            for other in ((0, 1), (0, -1)):
                if one in around and other in around:
                    a = plain_neighbours(flat, around[one]).get(other)
                    b = plain_neighbours(flat, around[other]).get(one)
                    if a is not None and a == b:
                        ways.append((a, 0.1 * math.sqrt(2)))
        for other, step in ways:
            there = here + step
            if there <= limit and there < length.get(other, math.inf) - 1e-9:
                length[other] = there
                heapq.heappush(queue, (there, other))
    return nearest


@pytest.mark.parametrize("seed", range(8))
def test_sliding_gets_as_near_as_a_short_walk_can(seed):
    rng = np.random.default_rng(100 + seed)
    finder = PathFinder(random_house(rng, num_levels=1 + seed % 2, share=0.75, size=(12, 18)))
    flat = finder.search.flat
    slid_on = 0
    for cell in rng.choice(np.flatnonzero(flat.free), size=40):
        start = flat.positions(cell) + np.append(rng.uniform(-0.049, 0.049, size=2), 0.0)
        end = start[:2] + rng.normal(size=2) * rng.choice([0.1, 0.4])
        stopped = finder.try_step(start, end, slide=False)
        if math.dist(stopped[:2], end) < 1e-5:
            continue
        found = math.dist(finder.try_step(start, end)[:2], end)
        assert found == pytest.approx(plain_slide(flat, start, stopped, end), abs=1e-5)
        slid_on += found < math.dist(stopped[:2], end) - 1e-3
    assert slid_on > 3


@pytest.mark.parametrize(
    ("start", "end", "message"),
    [
        ((0.35, -0.05), (0.0, 0.0), "no agent can stand at 0.35, -0.05: snap it"),
        ((9.0, 9.0), (0.0, 0.0), "no agent can stand at 9, 9"),
        ((0.05, np.nan), (0.0, 0.0), "finite numbers, got 0.05, nan"),
        ((0.05, -0.05), (0.0, np.inf), "finite numbers, got 0, inf"),
        ((0.05, -0.05), np.zeros((2, 3)), r"an end for each start, \(\) of them, got \(2,\)"),
    ],
)
def test_what_is_no_step_is_refused(start, end, message):
    with pytest.raises(QueryError, match=message):
        step(level_from("...#"), start, end)


def test_cells_of_many_ends_are_free():
    rng = np.random.default_rng(7)
    finder = PathFinder(random_house(rng, num_levels=2, share=0.8, size=(20, 30)))
    flat = finder.search.flat
    p = flat.positions(rng.choice(np.flatnonzero(flat.free)))
    visited = []
    for _ in range(400):
        p = finder.try_step(p, p[:2] + rng.normal(size=2) * 0.2)
        visited.append(p)
    assert flat.free[flat.cells_at(visited)].all()


@pytest.mark.parametrize("slide", [False, True])
def test_an_end_beyond_everything(slide):
    finder = PathFinder(level_from("...\n.#.\n..."))
    for far in (1e9, 1e300):
        found = finder.try_step((0.05, -0.05), (far, -0.05), slide=slide)
        np.testing.assert_allclose(found, (0.3, -0.05, 0.0), atol=1e-5)
