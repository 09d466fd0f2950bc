"""A base that follows a path: where it gets, what it keeps away from, when it stops."""

from __future__ import annotations

import math

import numpy as np
import pytest

import navbake
from grid_maps import level_from
from navbake.errors import QueryError
from navbake.runtime.path_finder import PathFinder
from project_paths import GOLDEN

TICK = 0.05  # [s]
ABOVE = np.array([0.0, 0.0, 0.1])  # [m], so that it is found on a step that it climbs
CORRIDOR = "#" * 42 + "\n" + ("#" + "." * 40 + "#\n") * 7 + "#" * 42
RING = """
############################
#..........................#
#..........................#
#..........................#
#..........................#
#..........................#
#.....##############.......#
#.....##############.......#
#.....##############.......#
#.....##############.......#
#..........................#
#..........................#
#..........................#
#..........................#
#..........................#
############################
"""


class Base:
    """A base without mass: it moves as it is told to."""

    def __init__(self, finder, position, heading=0.0):
        self.finder, self.position, self.heading = finder, np.array(position, float), heading
        self.track = [self.position.copy()]

    def move(self, command):
        turned = self.heading + command.turn * TICK / 2
        self.position[:2] += command.forward * TICK * np.array([np.cos(turned), np.sin(turned)])
        self.heading += command.turn * TICK
        cell = self.finder.search.flat.cells_at(self.position + ABOVE)
        if cell >= 0:
            self.position[2] = self.finder.search.flat.positions(cell)[2]
        self.track.append(self.position.copy())


def drive(follower, base, seconds=120.0, until="arrived"):
    for _ in range(int(seconds / TICK)):
        base.move(follower.command(base.position, base.heading))
        if follower.state == until:
            return
    raise AssertionError(f"{follower.state} at {base.position}, {follower.left:.2f} m left")


@pytest.fixture(scope="module")
def apartment():
    return PathFinder(navbake.load(GOLDEN / "apartment.grid.json.gz").inflate(0.22))


@pytest.mark.parametrize("seed", range(8))
def test_it_arrives_and_keeps_to_its_path(apartment, seed):
    rng = np.random.default_rng(seed)
    start, goal = apartment.random_point(rng, 2, island=1)
    path = apartment.find_path(start, goal)
    follower = apartment.follow(path)
    base = Base(apartment, start, rng.uniform(-3, 3))
    drive(follower, base)
    assert np.hypot(*(base.position - path.positions[-1])[:2]) <= 0.05
    assert follower.num_replans == 0 and follower.path is path
    # 4 cm are left for the way it drives
    assert apartment.clearance(np.array(base.track)).min() >= 0.18


def test_it_gets_up_the_stairs():
    finder = PathFinder(navbake.load(GOLDEN / "house.grid.json.gz"))
    rng = np.random.default_rng(1)
    start = finder.random_point(rng, level=0, island=1)
    path = finder.find_path(start, finder.random_point(rng, level=1, reachable_from=start))
    follower, base = finder.follow(path, lookahead=0.2), Base(finder, start)
    with finder.grid.block(disc=(finder.random_point(rng, level=0, island=1), 0.01)):
        drive(follower, base, 300.0)  # the path is looked at again, links and steps too
    np.testing.assert_allclose(base.position, path.positions[-1], atol=0.06)
    assert follower.num_replans == 0


def test_it_stops_at_what_is_blocked_and_goes_on_when_it_is_free():
    finder = PathFinder(level_from(CORRIDOR).inflate(0.1))
    start = (0.45, -0.45, 0.0)
    follower = finder.follow(finder.find_path(start, (3.75, -0.45, 0.0)))
    base = Base(finder, start)
    drive(follower, base, 1.0, until="driving")
    wall = finder.grid.block(box=((2.0, -9.0), (2.1, 9.0)))
    drive(follower, base, until="waiting")
    assert 1.7 < base.position[0] <= 1.9 + 1e-6  # its radius before the wall, not sooner
    command = follower.command(base.position, base.heading)
    assert (command.forward, command.turn) == (0.0, 0.0)
    np.testing.assert_array_equal(follower.waypoint(base.position), base.position)
    assert follower.num_replans == 0
    wall.free()
    drive(follower, base)


def test_it_slows_down_before_it_stops():
    finder = PathFinder(level_from(CORRIDOR))
    path = finder.find_path((3.25, -0.45, 0.0), (3.75, -0.45, 0.0))
    follower = finder.follow(path, acceleration=0.5)
    for left in (0.4, 0.1, 0.06):
        forward = follower.command((3.75 - left, -0.45, 0.0), 0.0).forward
        assert forward == pytest.approx(min(0.5, math.sqrt(2 * 0.5 * left)))
    assert follower.command((3.72, -0.45, 0.0), 0.0).forward == 0.0
    assert follower.state == "arrived"


def test_it_goes_round_what_blocks_its_path_and_back_when_that_has_gone():
    finder = PathFinder(level_from(RING).inflate(0.1))
    start, goal = (0.35, -0.35, 0.0), (2.45, -0.35, 0.0)
    follower = finder.follow(finder.find_path(start, goal))
    base = Base(finder, start)
    with finder.grid.block(box=((1.4, -0.6), (1.5, 0.0))):
        base.move(follower.command(base.position, base.heading))
        assert follower.num_replans == 1 and follower.path.length > 2.5
        assert follower.path.positions[:, 1].min() < -1.0
    base.move(follower.command(base.position, base.heading))
    assert follower.num_replans == 2  # the straight way is much shorter
    assert follower.path.length == pytest.approx(2.1, abs=0.05)
    with finder.grid.block(disc=((1.4, -1.4), 0.1)):  # beside the path
        drive(follower, base)
    assert follower.num_replans == 2


def test_a_base_that_something_has_come_near_to_moves_on():
    finder = PathFinder(level_from(RING).inflate(0.1))
    start, goal = (0.35, -0.35, 0.0), (2.45, -0.35, 0.0)
    follower = finder.follow(finder.find_path(start, goal))
    base = Base(finder, (0.35, -0.35, 0.0))
    with finder.grid.block(disc=((0.5, -0.3), 0.1)):
        assert not finder.is_navigable(base.position)
        drive(follower, base)
    assert follower.num_replans == 1


def test_waypoints_are_within_the_lookahead_and_lead_to_the_goal(apartment):
    start, goal = (-4.0, -2.0, 0.0), (3.5, 0.5, 0.0)
    follower = apartment.follow(apartment.find_path(start, goal), lookahead=0.3)
    p = np.array(start)
    for _ in range(2000):
        point = follower.waypoint(p)
        assert np.hypot(*(point - p)[:2]) <= 0.35
        p = p + np.clip(point - p, -0.02, 0.02)
        assert apartment.clearance(p) >= 0.2
        if follower.state == "arrived":
            break
    np.testing.assert_allclose(p, goal, atol=0.06)


def test_a_path_of_no_length_has_arrived(apartment):
    here = (-4.0, -2.0, 0.0)
    follower = apartment.follow(apartment.find_path(here, here))
    command = follower.command(here, 0.0)
    assert (follower.state, command.forward, command.turn) == ("arrived", 0.0, 0.0)


@pytest.mark.parametrize("name", ["speed", "acceleration", "turn_rate", "lookahead", "tolerance"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "fast", True])
def test_a_number_that_makes_no_sense_is_told(apartment, name, value):
    path = apartment.find_path((-4.0, -2.0, 0.0), (3.5, 0.5, 0.0))
    with pytest.raises(QueryError, match=f"expected a {name} > 0, got"):
        apartment.follow(path, **{name: value})


def test_what_is_no_path_or_no_pose_is_told(apartment):
    with pytest.raises(QueryError, match="expected a path that find_path has found, got None"):
        apartment.follow(apartment.find_path((-4.0, -2.0, 0.0), (99.0, 0.0, 0.0)))
    follower = apartment.follow(apartment.find_path((-4.0, -2.0, 0.0), (3.5, 0.5, 0.0)))
    with pytest.raises(QueryError, match="finite numbers"):
        follower.command((np.nan, 0.0, 0.0), 0.0)
    with pytest.raises(QueryError, match="finite heading"):
        follower.command((-4.0, -2.0, 0.0), np.nan)
    with pytest.raises(QueryError, match="one position"):
        follower.command(np.zeros((2, 3)), 0.0)
