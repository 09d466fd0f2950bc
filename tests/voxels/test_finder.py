"""Flights of a ball through voxels, against a plain graph, by definition, and in MuJoCo."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

import navbake
from navbake.errors import QueryError
from navbake.voxels.finder import VoxelFinder
from navbake.voxels.grid import VoxelGrid
from oracles.flights import (
    CapsuleProbe,
    distance_of_line,
    find_costs,
    fits,
    make_graph,
    make_large_graph,
    measure_distances,
)

ORIGIN = (-0.7, 2.0, 0.3)
SHAPE = (9, 7, 7)
# radius [m], cost of clearance [m], heights; edges of 0.1 m: also radii on multiples of half of it
CASES = [
    (0.04, 0.0, None),
    (0.05, 0.0, None),
    (0.08, 0.3, None),
    (0.15, 0.0, (0.5, 1.0)),
    (0.17, 0.1, None),
]


@cache
def scatter(seed, radius=0.08):
    """Some occupied voxels: the fewer, the larger the ball is that has to fit between them."""
    share = 0.06 if radius < 0.1 else 0.01
    occupied = np.random.default_rng(seed).random(SHAPE) < share
    return VoxelGrid(values=occupied, origin=ORIGIN, res=0.1)


def two_rooms(gap):
    """Two rooms of 1 × 1 × 1 m with a wall between, in which there is a square window."""
    occupied = np.zeros((21, 10, 10), dtype=bool)
    occupied[10] = True
    occupied[10, 5 - gap : 5 + gap, 5 - gap : 5 + gap] = False
    return VoxelGrid(values=occupied, origin=(0.0, 0.0, 0.0), res=0.1)


def make_finder(voxels, radius, cost=0.0, heights=None):
    low, high = heights or (None, None)
    return navbake.VoxelFinder(voxels, radius, low, high, cost)


@pytest.mark.parametrize(("radius", "cost", "heights"), CASES)
@pytest.mark.parametrize("seed", range(2))
def test_costs_are_those_of_dijkstra_on_all_moves(seed, radius, cost, heights):
    voxels = scatter(seed, radius)
    finder = make_finder(voxels, radius, cost, heights)
    is_free = fits(voxels, radius, heights)
    assert (finder.free == is_free).all()
    graph = make_graph(voxels, radius, cost, heights)
    free = np.flatnonzero(is_free)
    rng = np.random.default_rng(seed)
    starts = rng.choice(free, 4)
    expected = find_costs(graph, starts.tolist())
    centers = voxels.bounds[0] + (np.stack(np.unravel_index(free, SHAPE), -1) + 0.5) * 0.1
    for start, costs in zip(starts, expected, strict=True):
        position = centers[np.searchsorted(free, start)]
        field = finder.distance_field(position).ravel()
        assert (np.isinf(field) == np.isinf(costs)).all()
        reached = np.isfinite(costs)
        assert field[reached] == pytest.approx(costs[reached], rel=1e-9)
        for number in rng.choice(len(free), 12):
            path = finder.find_path(position, centers[number])
            if np.isinf(costs[free[number]]):
                assert path is None and "no way" in finder.why_not(position, centers[number])
                continue
            assert path.cost == pytest.approx(costs[free[number]], rel=1e-9, abs=1e-12)
            assert finder.why_not(position, centers[number]) is None


@pytest.mark.parametrize(("radius", "cost", "heights"), CASES[:3])
def test_the_graph_that_sweeps_of_large_grids_use_is_the_same(radius, cost, heights):
    voxels = scatter(2, radius)
    difference = make_graph(voxels, radius, cost) - make_large_graph(voxels, radius, cost)
    assert abs(difference).max() < 1e-12


@pytest.mark.parametrize(("radius", "cost", "heights"), CASES)
def test_islands_are_the_components_of_all_moves(radius, cost, heights):
    voxels = scatter(5, radius)
    finder = make_finder(voxels, radius, cost, heights)
    labels = finder.islands.labels
    _, expected = connected_components(make_graph(voxels, radius, cost, heights), directed=False)
    is_free = finder.free
    pairs = set(zip(labels[is_free].tolist(), expected[is_free.ravel()].tolist(), strict=True))
    assert len(pairs) == finder.islands.count
    assert (labels[~is_free] == 0).all()
    volumes = np.bincount(labels.ravel(), minlength=finder.islands.count + 1)[1:] * 0.1**3
    assert finder.islands.volumes == pytest.approx(volumes)
    assert (np.diff(volumes) <= 0).all()


@pytest.mark.parametrize("radius", [0.04, 0.05, 0.13, 0.2])
def test_sight_is_exact(radius):
    voxels = scatter(7, radius)
    finder = make_finder(voxels, radius)
    rng = np.random.default_rng(7)
    low, high = voxels.bounds
    starts, goals = low + radius + rng.random((2, 400, 3)) * (high - low - 2 * radius)
    seen = finder.sees(starts, goals)
    cubes = voxels.centers()
    for start, goal, is_seen in zip(starts, goals, seen, strict=True):
        distance = distance_of_line(start, goal, cubes, 0.1)
        assert is_seen == (distance >= radius) or abs(distance - radius) < 1e-6
    assert 10 < seen.sum() < 390
    assert not finder.sees(low + radius - 0.01, high - radius)  # out of the grid


@pytest.mark.parametrize(("radius", "cost", "heights"), CASES)
def test_paths_meet_nothing_and_cost_no_more_than_their_route(radius, cost, heights):
    voxels = scatter(11, radius)
    finder = make_finder(voxels, radius, cost, heights)
    cubes = voxels.centers()
    rng = np.random.default_rng(11)
    for start, goal in finder.random_point(rng, 40, island=1).reshape(20, 2, 3):
        path = finder.find_path(start, goal)
        assert (path.positions[0] == start).all() and (path.positions[-1] == goal).all()
        for begin, end in zip(path.positions, path.positions[1:], strict=False):
            assert distance_of_line(begin, end, cubes, 0.1) >= radius - 1e-6
            assert finder.sees(begin, end)
        lengths = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
        assert path.length == pytest.approx(lengths.sum())
        assert np.linalg.norm(goal - start) - 1e-9 <= path.length
        if not cost:
            assert path.length <= path.cost + 1e-9
        assert path.at([-1.0, path.length / 2, 99.0])[[0, 2]] == pytest.approx(
            path.positions[[0, -1]]
        )


def test_paths_keep_away_from_walls_where_nearness_costs():
    occupied = np.zeros((30, 12, 12), dtype=bool)
    occupied[:, 0] = True
    voxels = VoxelGrid(values=occupied, origin=(0, 0, 0), res=0.1)
    start, goal = (0.3, 0.3, 0.6), (2.7, 0.3, 0.6)
    short = make_finder(voxels, 0.1).find_path(start, goal)
    far = make_finder(voxels, 0.1, cost=0.5).find_path(start, goal)
    assert short.length == pytest.approx(2.4) and len(short.positions) == 2
    assert far.length > 2.5 and far.positions[:, 1].max() > 0.6


def test_snap_finds_the_nearest_centre_of_all():
    voxels = scatter(3)
    finder = make_finder(voxels, 0.08)
    rng = np.random.default_rng(3)
    low, high = voxels.bounds
    points = low - 0.3 + rng.random((200, 3)) * (high - low + 0.6)
    places = finder.snap(points)
    for island in (None, 1):
        labels = finder.islands.labels
        allowed = finder.free if island is None else labels == island
        centers = low + (np.argwhere(allowed) + 0.5) * 0.1
        places = finder.snap(points, island=island)
        for point, place in zip(points, places, strict=True):
            if island is None and finder.is_free(point):
                assert (place == point).all()
                continue
            nearest = np.linalg.norm(centers - point, axis=1).min()
            assert np.linalg.norm(place - point) == pytest.approx(nearest)
    nothing_near = low - 5.0
    assert finder.snap(nothing_near, max_distance=1.0) is None
    assert finder.snap(nothing_near) is not None


def test_random_points_are_free_spread_and_repeatable():
    finder = make_finder(scatter(4), 0.08)
    points = finder.random_point(np.random.default_rng(0), 300)
    assert finder.is_free(points).all()
    assert (points == finder.random_point(np.random.default_rng(0), 300)).all()
    assert (np.ptp(points, axis=0) > 0.4).all()
    assert finder.random_point(np.random.default_rng(0)).shape == (3,)


def test_several_goals_are_answered_by_the_cheapest():
    finder = make_finder(scatter(6), 0.08)
    start, *goals = finder.random_point(np.random.default_rng(6), 5, island=1)
    paths = [finder.find_path(start, goal) for goal in goals]
    best = min(paths, key=lambda path: path.cost)
    path = finder.find_path(start, goals)
    assert path.cost == pytest.approx(best.cost)
    assert (path.positions[-1] == best.positions[-1]).all()


@pytest.mark.parametrize(("gap", "radius"), [(1, 0.1), (2, 0.2), (3, 0.3)])
def test_a_ball_passes_a_window_that_is_as_wide_as_it(gap, radius):
    voxels = two_rooms(gap)
    start, goal = (0.5, 0.5, 0.5), (1.6, 0.5, 0.5)
    path = make_finder(voxels, radius - 0.05).find_path(start, goal)
    assert path.length == pytest.approx(1.1)
    # its middle lies on an edge of voxels, where no centre is: the ball sees through all the same
    assert make_finder(voxels, radius).sees(start, goal)
    finder = make_finder(voxels, radius + 0.01)
    assert not finder.sees(start, goal) and finder.find_path(start, goal) is None


def test_why_not_says_what_is_in_the_way():
    finder = make_finder(two_rooms(1), 0.2)
    here, there = (0.4, 0.5, 0.5), (1.6, 0.5, 0.5)
    assert finder.why_not(here, (0.5, 0.6, 0.6)) is None
    reason = finder.why_not(here, there)
    assert "no way for a radius of 0.2 m from island 1 (0." in reason
    smaller = float(reason.split("; a ball of ")[1].split()[0])
    assert 0.05 <= smaller < 0.1
    assert make_finder(two_rooms(1), smaller - 1e-3).find_path(here, there) is not None
    reason = finder.why_not((0.9, 0.5, 0.8), there)
    assert "the start (0.9, 0.5, 0.8) is 0.1 m from the nearest occupied voxel" in reason
    assert "nearest free place is (0.75, 0.45, 0.75)" in reason
    reason = finder.why_not(here, (5, 5, 5))
    assert "the goal (5, 5, 5) is outside of where the ball fits" in reason
    closed = make_finder(two_rooms(0), 0.2)
    assert "not even a ball of 0.05 m gets through" in closed.why_not(here, there)
    tiny = make_finder(two_rooms(0), 0.02).why_not(here, there)
    assert "no way for a radius of 0.02 m" in tiny and "gets through" not in tiny
    assert "fits nowhere" in make_finder(two_rooms(1), 0.6).why_not(here, there)


def test_unknown_voxels_are_occupied_unless_they_are_called_free():
    voxels = VoxelGrid(
        values=np.zeros((10, 10, 10), dtype=bool),
        origin=(0, 0, 0),
        res=0.1,
        known=np.zeros((10, 10, 10), dtype=bool),
    )
    reason = navbake.VoxelFinder(voxels, 0.1).why_not((0.5, 0.5, 0.5), (0.6, 0.6, 0.6))
    assert "100% of the voxels are unknown: `--unknown free` (unknown='free')" in reason
    finder = navbake.VoxelFinder(voxels, 0.1, unknown="free")
    assert finder.find_path((0.5, 0.5, 0.5), (0.6, 0.6, 0.6)) is not None


@pytest.mark.parametrize(
    ("options", "culprit"),
    [
        ({"radius": 0}, "radius"),
        ({"radius": "wide"}, "radius"),
        ({"cost_of_clearance": -1}, "cost_of_clearance"),
        ({"min_height": np.inf}, "min_height"),
        ({"unknown": "maybe"}, "unknown"),
    ],
)
def test_numbers_out_of_range_are_named(options, culprit):
    with pytest.raises(QueryError, match=culprit):
        navbake.VoxelFinder(two_rooms(1), **{"radius": 0.1, **options})


@pytest.mark.parametrize("kind", ["SceneGrid2D", "VoxelFinder", "ndarray", "str", "NoneType"])
def test_what_is_no_voxels_is_named(kind):
    weights = np.ones((3, 4))
    grid = navbake.SceneGrid2D(width=4, height=3, cell_size=0.1, min_yup=(0, 0, 0), weights=weights)
    finder = make_finder(two_rooms(1), 0.1)
    values = [grid, finder, weights, "house.xml", None]
    (value,) = (value for value in values if type(value).__name__ == kind)
    message = f"expected voxels, as `navbake.create_voxel_grid` makes them, got a {kind}$"
    with pytest.raises(QueryError, match=message):
        navbake.VoxelFinder(value, radius=0.3)
    with pytest.raises(QueryError, match=message):
        finder.use(value)


def test_positions_and_islands_that_are_none_are_named():
    finder = make_finder(two_rooms(1), 0.1)
    with pytest.raises(QueryError, match="expected finite positions"):
        finder.find_path((0, 0), (1, 1, 1))
    with pytest.raises(QueryError, match="one start of shape"):
        finder.find_path([(0, 0, 0), (1, 1, 1)], (1, 1, 1))
    with pytest.raises(QueryError, match="an island from 1 to"):
        finder.random_point(island=99)
    with pytest.raises(QueryError, match="fits nowhere"):
        make_finder(two_rooms(1), 0.7).random_point()


@pytest.mark.parametrize(("name", "radius"), [("house", 0.25), ("tower", 0.3)])
def test_the_swept_ball_meets_nothing_in_mujoco(name, radius):
    voxelizer = navbake.Voxelizer(navbake.samples.path(name))
    voxels = voxelizer.create(res=0.1)
    finder = VoxelFinder(voxels, radius)
    probe = CapsuleProbe(
        str(navbake.samples.path(name).parent / "scenes" / f"{name}.xml"),
        [geom.counted for geom in voxelizer.scene.geoms],
        voxelizer.scene.data.qpos,
    )
    pairs = finder.random_point(np.random.default_rng(0), 60, island=1).reshape(30, 2, 3)
    for start, goal in pairs:
        path = finder.find_path(start, goal)
        for begin, end in zip(path.positions, path.positions[1:], strict=False):
            assert probe.clearance(begin, end, radius) >= -1e-6
    # and it would tell: through a wall
    assert probe.clearance(voxels.bounds[0], voxels.bounds[1], radius) < 0


def test_distances_of_the_finder_are_those_of_its_voxels():
    voxels = scatter(1)
    expected = measure_distances(voxels.occupied, 0.1)
    assert np.abs(make_finder(voxels, 0.1).distances.values - expected).max() <= 1e-6
