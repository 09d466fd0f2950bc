"""A base that follows a path: where it gets, what it keeps away from, when it stops."""

from __future__ import annotations

import math

import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from
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


# the next grid in place of the ring's: its upper left corner [m], and how many cells of wall it has
# round the ring
NEXT_GRIDS = {"same cells": (0.0, 0), "moved cells": (0.03, 0), "more cells": (-0.5, 5)}


def ring_with_box(rows, cols, cells="same cells"):
    shift, num_cells = NEXT_GRIDS[cells]
    ring = np.array([list(line) for line in RING.strip("\n").split("\n")])
    for row in rows:
        ring[row, list(cols)] = "#"
    ring = np.pad(ring, num_cells, constant_values="#")
    return level_from("\n".join(map("".join, ring)), x=shift, y_max=-shift)


@pytest.mark.parametrize("cells", NEXT_GRIDS)
@pytest.mark.parametrize("agent", [None, navbake.Agent("robot", radius=0.1)])
def test_it_goes_by_the_grid_that_its_finder_uses_now(cells, agent):
    level = level_from(RING)
    finder = PathFinder(level if agent else level.inflate(0.1), agent=agent)
    start, goal = (0.35, -0.35, 0.0), (2.45, -0.35, 0.0)
    follower = finder.follow(finder.find_path(start, goal))
    base = Base(finder, start)
    drive(follower, base, 1.0, until="driving")
    grid = ring_with_box(range(0, 6), (14, 15), cells)
    finder.use(grid if agent else grid.inflate(0.1))
    drive(follower, base)
    assert follower.num_replans == 1 and follower.path.positions[:, 1].min() < -1.0
    assert finder.clearance(np.array(base.track)).min() >= 0.06


@pytest.mark.parametrize("cells", NEXT_GRIDS)
def test_it_waits_where_the_grid_used_now_has_no_path_and_goes_on_by_the_next(cells):
    finder = PathFinder(level_from(RING).inflate(0.1))
    start, goal = (0.35, -0.35, 0.0), (2.45, -0.35, 0.0)
    follower = finder.follow(finder.find_path(start, goal))
    base = Base(finder, start)
    drive(follower, base, 0.5, until="driving")
    finder.use(ring_with_box(range(0, 16), (14, 15), cells).inflate(0.1))
    drive(follower, base, until="waiting")
    assert base.position[0] < 1.4 and follower.num_replans == 0
    np.testing.assert_array_equal(
        follower.command(base.position, base.heading).waypoint, base.position
    )
    finder.use(ring_with_box((), (), cells).inflate(0.1))
    drive(follower, base)


def test_it_keeps_its_path_where_the_grid_used_now_allows_it():
    finder = PathFinder(level_from(RING).inflate(0.1))
    start, goal = (0.35, -0.35, 0.0), (2.45, -0.35, 0.0)
    path = finder.find_path(start, goal)
    follower = finder.follow(path)
    base = Base(finder, start)
    for col in (5, 10, 20):  # beside the path
        finder.use(ring_with_box((13, 14), (col, col + 1)).inflate(0.1))
        drive(follower, base, 0.5, until="driving")
    drive(follower, base)
    assert follower.num_replans == 0 and follower.path is path


def test_a_grid_of_fewer_levels_has_no_part_of_the_path():
    lower, upper = level_from("." * 30), level_from("." * 30, ground=3.0)
    stairs = [((0, 0, 29), (1, 0, 29))]
    finder = PathFinder(house_from([lower, upper], stairs))
    follower = finder.follow(finder.find_path((2.45, -0.05, 3.0), (0.05, -0.05, 0.0)))
    position = np.array([2.45, -0.05, 3.0])
    assert follower.command(position, 0.0).forward > 0.0
    finder.use(level_from("." * 30))
    follower.command(position, math.pi)
    assert follower.state == "driving" and follower.path.levels.max() == 0


def test_it_waits_where_the_storey_of_its_goal_is_gone():
    """The goal's x and y are on the storey below, too: it ended there, and never arrived."""
    lower, upper = level_from("." * 30), level_from("." * 30, ground=3.0)
    house = house_from([lower, upper], [((0, 0, 29), (1, 0, 29))])
    finder = PathFinder(house)
    start, goal = (0.35, -0.05, 0.0), (0.05, -0.05, 3.0)
    follower = finder.follow(finder.find_path(start, goal))
    finder.use(level_from("." * 30))
    assert follower.command(start, 0.0).forward == 0.0
    assert (follower.state, follower.num_replans) == ("waiting", 0)
    assert not follower.replan(start)
    finder.use(house)
    assert follower.command(start, 0.0).forward > 0.0


ROOMS = """
##############################
#.............##.............#
#.............##.............#
#.............##.............#
#.............##.............#
#.............##.............#
#............................#
#............................#
#............................#
##############################
"""


@pytest.mark.parametrize(
    "place",
    [
        (1.85, -0.35, 0.0),  # behind the wall beside the path, nearer to it than the lookahead
        (2.65, -0.15, 0.0),  # in the corner of the other room
        (1.35, -0.35, 0.0),  # at the wall, nearer to it than the base's radius
    ],
)
@pytest.mark.parametrize("seconds", [0.1, 1.5])
def test_a_base_that_was_carried_off_gets_a_path_from_where_it_is(place, seconds):
    finder = PathFinder(level_from(ROOMS).inflate(0.15))
    start, goal = (1.15, -0.25, 0.0), (0.35, -0.65, 0.0)
    follower = finder.follow(finder.find_path(start, goal), speed=0.2)
    base = Base(finder, start, math.pi)
    drive(follower, base, seconds, until="driving")
    base = Base(finder, place)
    drive(follower, base)
    is_free = finder.is_navigable(place)
    assert follower.num_replans <= 1 and (follower.num_replans == 1 or not is_free)
    assert finder.clearance(np.array(base.track)).min() >= (0.11 if is_free else 0.0)
    assert finder.is_navigable(base.position)


def test_a_base_that_was_carried_where_no_path_leads_on_waits():
    text = ROOMS.replace("#............................#", "#.............##.............#")
    finder = PathFinder(level_from(text).inflate(0.15))
    start, goal = (0.35, -0.25, 0.0), (1.15, -0.65, 0.0)
    path = finder.find_path(start, goal)
    follower = finder.follow(path)
    for place in ((9.0, 9.0, 0.0), (1.85, -0.35, 0.0), (2.65, -0.75, 0.0), (9.0, 9.0, 0.0)):
        command = follower.command(place, 0.0)
        assert (follower.state, command.forward, command.turn) == ("waiting", 0.0, 0.0)
        np.testing.assert_array_equal(command.waypoint, place)
        assert follower.num_replans == 0
    drive(follower, Base(finder, start))  # carried back


def test_a_base_that_loses_its_path_in_the_cell_where_the_grid_has_changed_plans_anew():
    finder = PathFinder(level_from(ROOMS).inflate(0.15))
    start, goal = (1.15, -0.25, 0.0), (2.6, -0.35, 0.0)
    follower = finder.follow(finder.find_path(start, goal))
    follower.command(start, 0.0)
    with finder.grid.block(box=((0.2, -0.9), (0.3, -0.8))):  # beside the path
        follower.command((0.78, -0.24, 0.0), 0.0)
        assert follower.num_replans == 0
        follower.command((0.74, -0.22, 0.0), 0.0)  # no point ahead is in reach
        assert follower.num_replans == 1


@pytest.mark.parametrize("place", [(0.45, -0.85, 0.0), (0.35, -0.71, 0.0)])
def test_a_base_that_was_pushed_beside_the_end_of_its_path_drives_there(place):
    finder = PathFinder(level_from(ROOMS).inflate(0.15))
    start, goal = (1.15, -0.65, 0.0), (0.35, -0.65, 0.0)
    follower = finder.follow(finder.find_path(start, goal))
    base = Base(finder, start, math.pi)
    drive(follower, base, 1.4, until="driving")
    follower.command((0.42, -0.65, 0.0), math.pi)
    drive(follower, Base(finder, place))
    assert follower.num_replans == 0


def test_a_base_on_another_storey_than_its_path_has_lost_it():
    finder = PathFinder(navbake.load(GOLDEN / "house.grid.json.gz"))
    rng = np.random.default_rng(1)
    goal = finder.random_point(rng, level=0, island=1)
    place = finder.random_point(rng, level=1, reachable_from=goal)
    below = finder.snap((*place[:2], 0.0))
    follower = finder.follow(finder.find_path(below, goal))
    follower.command(place, 0.0)
    assert follower.num_replans == 1 and follower.path.levels[0] == 1

    apart = house_from([level_from("." * 30), level_from("." * 30, ground=3.0)])
    finder = PathFinder(apart)
    follower = finder.follow(finder.find_path((0.05, -0.05, 0.0), (2.45, -0.05, 0.0)))
    for x in (0.05, 2.45):  # over the start, and over the goal
        follower.command((x, -0.05, 3.0), 0.0)
        assert follower.state == "waiting"


def test_a_path_of_another_grid_is_checked_on_that_of_the_finder():
    narrow = level_from(RING.replace("#######.......#", "############..#"))
    finders = {radius: PathFinder(narrow.inflate(radius)) for radius in (0.05, 0.18)}
    path = finders[0.05].find_path((2.0, -0.35, 0.0), (2.0, -1.25, 0.0))
    assert path.positions[:, 0].max() > 2.4  # through the gap, which is 0.2 m wide
    follower = finders[0.18].follow(path)
    base = Base(finders[0.18], path.positions[0])
    drive(follower, base)
    assert follower.num_replans == 1
    assert finders[0.18].clearance(np.array(base.track)).min() >= 0.14
    wide_path = finders[0.18].find_path((2.0, -0.35, 0.0), (2.3, -0.35, 0.0))
    follower = finders[0.05].follow(wide_path)
    drive(follower, Base(finders[0.05], wide_path.positions[0]))
    assert follower.num_replans == 0 and follower.path is wide_path


def test_what_was_blocked_before_it_began_is_gone_round():
    finder = PathFinder(level_from(RING).inflate(0.1))
    start, goal = (0.35, -0.35, 0.0), (2.45, -0.35, 0.0)
    path = finder.find_path(start, goal)
    with finder.grid.block(box=((1.4, -0.6), (1.5, 0.0))):
        follower = finder.follow(path)
        drive(follower, Base(finder, start))
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
