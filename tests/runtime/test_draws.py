"""Random places: even by area, reachable, where they are asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chisquare

import navbake
from grid_maps import house_from, level_from, random_house, room
from navbake.errors import QueryError
from navbake.navgrid.cells import Cell
from navbake.navgrid.grid import MultiLevelGrid
from navbake.runtime.path_finder import PathFinder
from project_paths import GOLDEN


def make_rng(seed=0):
    return np.random.default_rng(seed)


def random_sampler(seed, **options):
    return PathFinder(random_house(make_rng(seed), **options))


@pytest.mark.parametrize("anywhere", [False, True])
def test_cells_of_all_levels_are_as_likely_as_one_another(anywhere):
    sampler = random_sampler(3, num_levels=3)
    flat = sampler.search.flat
    points = sampler.random_point(make_rng(), 40000, anywhere=anywhere)
    cells = flat.cells_at(points)
    assert flat.free[cells].all()
    counts = np.bincount(cells, minlength=flat.num_cells)[flat.free]
    assert chisquare(counts).pvalue > 0.01
    offset = points - flat.positions(cells)
    assert np.all(offset[:, 2] == 0)
    if anywhere:
        for axis in (0, 1):
            parts = np.histogram(offset[:, axis], bins=10, range=(-0.05, 0.05))[0]
            assert chisquare(parts).pvalue > 0.01
    else:
        assert not offset.any()


def test_larger_cells_are_likelier_by_their_area():
    coarse, fine = level_from("..", cell_size=0.3), level_from("...", ground=3.0)
    sampler = PathFinder(MultiLevelGrid(grids=[coarse, fine], cell_size=0.3))
    cells = sampler.search.flat.cells_at(sampler.random_point(make_rng(), 20000))
    counts = np.bincount(cells, minlength=5)
    expected = np.array([9, 9, 1, 1, 1]) / 21 * 20000
    assert chisquare(counts, expected).pvalue > 0.01


def test_the_same_generator_draws_the_same():
    sampler = random_sampler(1)
    one, other = (sampler.random_point(make_rng(5), 10, anywhere=True) for _ in range(2))
    np.testing.assert_array_equal(one, other)
    assert sampler.random_point(make_rng(5)).shape == (3,)
    assert sampler.random_point(make_rng(5), 0).shape == (0, 3)


@pytest.mark.parametrize("seed", range(6))
def test_points_are_where_they_are_asked_for(seed):
    sampler = random_sampler(seed, num_levels=2, share=0.55)
    rng = make_rng(seed)
    numbers = sampler.islands.number
    flat = sampler.search.flat
    for island in range(1, min(sampler.islands.count, 5) + 1):
        points = sampler.random_point(rng, 50, island=island, anywhere=True)
        assert set(numbers[flat.cells_at(points)]) == {island}
        start = points[0]
        for found in (
            sampler.random_point(rng, 50, reachable_from=start, anywhere=True),
            sampler.random_point_near(rng, start, 1.0, 50, anywhere=True),
        ):
            assert set(numbers[flat.cells_at(found)]) == {island}
    points = sampler.random_point(rng, 50, level=1)
    assert set(flat.level_of(flat.cells_at(points))) == {1}


def test_in_a_room():
    level = level_from("....#....")
    level.attributes["roomIndex"] = np.array([[1, 1, 1, 1, 0, 2, 2, 2, 2]], dtype=np.uint16)
    sampler = PathFinder(house_from([level], rooms=[room(0, 1, "a"), room(0, 2, "b")]))
    points = sampler.random_point(make_rng(), 50, room="b", anywhere=True)
    assert points[:, 0].min() > 0.5
    with pytest.raises(QueryError, match="no room 'c' in 'house': it has a, b"):
        sampler.random_point(make_rng(), room="c")
    with pytest.raises(QueryError, match="no free cell in 'house' with room b, island 1"):
        sampler.random_point(make_rng(), room="b", island=1)
    near = sampler.random_point_near(make_rng(), (0.05, -0.05), 9.0, 50, straight=True, room="b")
    assert near[:, 0].min() > 0.5


@pytest.mark.parametrize("seed", range(4))
def test_near_by_the_length_of_the_path(seed):
    sampler = random_sampler(seed, num_levels=2, share=0.8)
    flat, rng = sampler.search.flat, make_rng(seed)
    start = sampler.random_point(rng, island=1)
    distance = sampler.search.compute_cost_field(flat.cells_at(start[None]), by="length")
    points = sampler.random_point_near(rng, start, 0.8, 4000, min_distance=0.35)
    cells = flat.cells_at(points)
    near = flat.free & (distance > 0.35 - 1e-9) & (distance < 0.8 + 1e-9)
    assert set(cells) == set(np.flatnonzero(near))
    assert chisquare(np.bincount(cells, minlength=flat.num_cells)[near]).pvalue > 0.001


@pytest.mark.parametrize("seed", range(4))
def test_in_an_annulus(seed):
    sampler = random_sampler(seed, num_levels=2, share=0.5)
    flat, rng = sampler.search.flat, make_rng(seed)
    for level in range(2):
        cells = np.arange(flat.layout.start[level], flat.layout.start[level + 1])
        centers = flat.positions(cells)[:, :2]
        for _ in range(40):
            p = centers[rng.integers(len(cells))] + rng.uniform(-0.04, 0.04, size=2)
            low, high = np.sort(rng.uniform(0, 0.6, size=2))
            distance = np.hypot(*(centers - p).T)
            expected = cells[flat.free[cells] & (distance >= low) & (distance <= high)]
            found = sampler.any_free_in_annulus(p, low, high, level=level)
            assert found == (len(expected) > 0)
            if found:
                points = sampler.random_point_near(
                    rng, p, high, 300, min_distance=low, straight=True, level=level
                )
                assert set(flat.cells_at(points)) <= set(expected)
                assert len(set(flat.cells_at(points))) >= 0.8 * len(expected) - 1
    assert sampler.any_free_in_annulus(p, 0.0, np.inf, level=level)


def test_a_pose_looks_at_its_target_past_no_wall():
    level = level_from(".....\n.....\n..#..\n#####\n.....")
    level.attributes["roomIndex"] = np.repeat([[1], [1], [1], [0], [2]], 5, 1).astype(np.uint16)
    sampler = PathFinder(level)
    target = np.array((0.25, -0.25, 0.7))  # in something
    rng = make_rng()
    for _ in range(100):
        pose = sampler.random_pose(rng, target, 0.3)
        assert sampler.is_navigable(pose.position)
        assert pose.position[1] > -0.3  # not behind the wall
        offset = target[:2] - pose.position[:2]
        assert math.hypot(*offset) <= 0.3 + 1e-9
        assert math.cos(pose.heading - math.atan2(offset[1], offset[0])) == pytest.approx(1.0)
    anywhere = [sampler.random_pose(rng, target, 0.3, in_sight=False) for _ in range(100)]
    assert min(pose.position[1] for pose in anywhere) < -0.4


def test_a_pose_without_target_looks_all_round():
    sampler = random_sampler(0)
    rng = make_rng()
    headings = [sampler.random_pose(rng).heading for _ in range(2000)]
    assert chisquare(np.histogram(headings, bins=8, range=(-math.pi, math.pi))[0]).pvalue > 0.01


def test_a_pose_in_the_room_of_its_target():
    level = level_from("...#....")
    level.attributes["roomIndex"] = np.array([[1, 1, 1, 1, 2, 2, 2, 2]], dtype=np.uint16)
    sampler = PathFinder(house_from([level], rooms=[room(0, 1, "a"), room(0, 2, "b")]))
    for seed in range(20):
        pose = sampler.random_pose(make_rng(seed), (0.35, -0.05), 1.0, same_room=True)
        assert pose.position[0] < 0.3
    with pytest.raises(QueryError, match=r"no free cell in 'house' with distance \[m\] 0 to 0.05"):
        sampler.random_pose(make_rng(), (0.35, -0.05), 0.05)


def test_live_obstacles_part_islands_and_take_places():
    sampler = PathFinder(level_from("....."))
    assert sampler.islands.count == 1
    block = sampler.grid.block(cells=Cell(0, 0, 2))
    assert sampler.islands.count == 2
    points = sampler.random_point(make_rng(), 50, reachable_from=(0.05, -0.05))
    assert points[:, 0].max() < 0.2
    assert not sampler.same_island((0.05, -0.05), (0.45, -0.05))
    block.free()
    assert sampler.same_island((0.05, -0.05), (0.45, -0.05))


def two_islands():
    return PathFinder(house_from([level_from("...#.")]))


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda s: s.random_point(3), "numpy.random.Generator, or None, got 3: make one with"),
        (lambda s: s.random_point(make_rng(), -1), "a count >= 0, got -1"),
        (lambda s: s.random_point(make_rng(), 1.5), "a count >= 0, got 1.5"),
        (lambda s: s.random_point(make_rng(), island=3), "no island 3: there are 1 to 2"),
        (lambda s: s.random_point(make_rng(), level=1), "no level 1: expected 0 to 0"),
        (
            lambda s: s.random_point(make_rng(), reachable_from=(0.35, -0.05)),
            "no agent can stand at 0.35, -0.05: snap",
        ),
        (
            lambda s: s.random_point(make_rng(), reachable_from=(0.05, -0.05), island=2),
            "island 2 can't be reached: the position is on 1",
        ),
        (
            lambda s: s.random_point_near(make_rng(), (0.05, -0.05), 1.0, min_distance=2.0),
            "min_distance <= max_distance .*, got 2.0 and 1.0",
        ),
        (
            lambda s: s.random_point_near(make_rng(), (0.05, -0.05), np.nan),
            "min_distance <= max_distance",
        ),
        (
            lambda s: s.random_point_near(make_rng(), (9.0, 0.0), 1.0),
            "9, 0 is in no cell of 'house'",
        ),
        (
            lambda s: s.random_point_near(make_rng(), (0.05, -0.05), 9.0, min_distance=5.0),
            r"no free cell in 'house' with distance \[m\] 5 to 9",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused(ask, message):
    with pytest.raises(QueryError, match=message):
        ask(two_islands())


def test_any_distance_leads_no_farther_than_paths_do():
    sampler = PathFinder(level_from("..#.\n..#."))
    points = sampler.random_point_near(make_rng(), (0.05, -0.05, 0.0), math.inf, 200)
    assert (points[:, 0] < 0.2).all()


def test_places_outdoors_are_left_out_on_request():
    house = navbake.load(GOLDEN / "house.grid.json.gz")
    finder = navbake.PathFinder(house)
    outdoors = {room.id for room in house.rooms if room.outdoors}
    assert outdoors
    for is_allowed in (True, False):
        rng = np.random.default_rng(0)
        near = house.rooms[0].centroid
        points = finder.random_point(rng, 400, outdoors=is_allowed)
        poses = [finder.random_pose(rng, outdoors=is_allowed) for _ in range(100)]
        facing = [
            finder.random_pose(rng, near, 50.0, in_sight=False, outdoors=is_allowed)
            for _ in range(100)
        ]
        pose_points = [pose.position for pose in poses]
        facing_points = [pose.position for pose in facing]
        for places in (points, pose_points, facing_points):
            rooms = {finder.room_at(place) for place in places}
            assert bool(rooms & outdoors) == is_allowed
