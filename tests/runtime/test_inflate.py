"""Inflation against the rules' words, cell by cell, on random grids and on small ones to read."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy import ndimage

import navbake
from differences import first_difference
from grid_maps import random_house
from level_maps import AGENT, level_of, make_level, shown, stack, stairs
from map_grids import sample
from navbake.errors import QueryError
from navbake.formats.navgrid import dumps_navgrid
from navbake.navgrid.grid import MultiLevelGrid
from navbake.navgrid.islands import find_islands
from navbake.navgrid.user_data import UserData
from navbake.runtime import inflation as inflation_module
from navbake.runtime.inflation import nav2_costs
from navbake.runtime.search import Search
from navbake.runtime.surroundings import look_up_by_distance, stack_levels
from oracles import inflation
from project_paths import SHARED_DATA

# One level


def test_a_disc_that_only_touches_a_square_is_free():
    level = level_of("0000000", "0000000", "0000000", "000#000", "0000000", "0000000", "0000000")
    touching = [".......", ".......", "..###..", "..###..", "..###..", ".......", "......."]
    meeting = [".......", "...#...", "..###..", ".#####.", "..###..", "...#...", "......."]
    assert shown(level.inflate(0.15)) == touching
    assert shown(level.inflate(0.1501)) == meeting


@pytest.mark.parametrize("seed", range(80))
def test_free_is_what_meets_no_occupied_square(seed):
    rng = np.random.default_rng(seed)
    occupied = rng.random(rng.integers(1, 25, 2)) < rng.choice([0.01, 0.05, 0.2])
    floor = np.where(occupied & (rng.random(occupied.shape) < 0.5), np.nan, 0.0)
    cell = rng.choice([0.05, 0.1, 0.23])
    level = make_level(occupied, floor, cell=cell, unit=rng.choice([1.0, 0.5]))
    steps = level.lattice.cell_size / 2 * rng.integers(0, 12)
    radius = float(rng.choice([steps, rng.uniform(0, 8 * cell)]))
    np.testing.assert_array_equal(level.inflate(radius).free, inflation.exact_free(level, radius))


@pytest.mark.parametrize("seed", range(20))
def test_a_larger_radius_frees_nothing(seed):
    rng = np.random.default_rng(seed)
    shape = rng.integers(5, 30, 2)
    floor = np.where(rng.random(shape) < 0.1, np.nan, rng.choice([0, 0.1, 0.3, 0.9], shape))
    lower = make_level(rng.random(shape) < 0.05, floor)
    upper = make_level(rng.random(shape) < 0.05, rng.choice([0.8, 1.2, np.nan], shape), col=3)
    for grid in (lower, stack(lower, upper)):
        before = [level.free for level in grid.levels]
        for radius in np.sort(rng.uniform(0, 1, 8)):
            after = [level.free for level in grid.inflate(radius).levels]
            assert all((a <= b).all() for a, b in zip(after, before, strict=True))
            before = after


def test_nothing_is_changed_at_radius_0():
    level = level_of("00#", "0 9", "000")
    assert shown(level.inflate(0)) == shown(level)
    assert shown(level.inflate(0.0, clearance=0.2)) == shown(level)


def test_the_grid_of_one_level_ends_at_nothing():
    assert level_of("000", "000").inflate(5).free.all()


def test_a_radius_beyond_the_grid_is_no_trouble():
    assert not level_of("000000", "00000#").inflate(9999).free.any()


def test_a_square_is_farther_at_its_corners():
    level = level_of("00000", "0#000", "00000")
    assert shown(level.inflate(0.06)) == [".#...", "###..", ".#..."]
    assert shown(level.inflate(0.08)) == ["###..", "###..", "###.."]


# Floors


def test_a_higher_floor_is_a_wall_from_below_and_an_edge_from_above():
    level = level_of("0000555", "0000555")
    assert shown(level.inflate(0.2)) == ["..####.", "..####."]
    assert shown(level.inflate(0.2, ledges="ignore")) == ["..##...", "..##..."]


def test_a_step_is_no_wall_but_the_next_one_is():
    level = level_of("000222444666")
    assert shown(level.inflate(0.2)) == ["............"]
    assert shown(level.inflate(0.34)) == ["............"]
    assert shown(level.inflate(0.36)) == ["..#..##..#.."]
    assert shown(level.inflate(0.46)) == [".##.####.##."]
    assert shown(level.inflate(0.36, ledges="ignore")) == ["..#..#......"]


def test_the_bake_has_seen_to_steps_up_to_its_radius():
    level = level_of("000555")
    level.metadata["agentRadius"] = 0.12
    assert shown(level.inflate(0.12)) == ["...#.."]  # of drops the bake knows nothing
    assert shown(level.inflate(0.12, ledges="ignore")) == ["......"]
    assert shown(level.inflate(0.16)) == [".####."]


def test_the_side_of_a_stair_is_a_wall_beside_it():
    rows = ["0000000", "0000000", "0246800", "0246800", "0246800", "0000000"]
    level = level_of(*rows)
    beside = [".......", "..###..", ".....#.", ".....#.", ".....#.", "..###.."]
    assert shown(level.inflate(0.06, ledges="ignore")) == beside
    both = [".......", "..###..", "..####.", "....##.", "..####.", "..###.."]
    assert shown(level.inflate(0.06)) == both


def test_holes_that_are_not_occupied_count_as_in_the_original():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        shape = rng.integers(2, 14, 2)
        level = make_level(rng.random(shape) < 0.03, np.where(rng.random(shape) < 0.15, np.nan, 0))
        radius = rng.uniform(0, 0.6)
        expected = inflation.exact_free(level, radius) & inflation.enough_floor(level, radius)
        np.testing.assert_array_equal(level.inflate(radius).free, expected)


# Several levels


def assert_free_as_the_oracle_says(grid: MultiLevelGrid, radius: float, extent: int) -> None:
    """Compare the free cells of all levels, with ledges and without; the oracle has `extent`."""
    for ledges in ("avoid", "ignore"):
        expected = inflation.stacked_free(grid, radius, extent, ledges)
        inflated = grid.inflate(radius, ledges=ledges)
        for level, free in zip(inflated.levels, expected, strict=True):
            np.testing.assert_array_equal(level.free, free)


@pytest.mark.parametrize("seed", range(24))
def test_levels_see_each_other_as_the_rules_say(seed):
    rng = np.random.default_rng(seed)
    levels = []
    for base in (0.0, rng.choice([0.4, 0.8, 1.3, 2.5])):
        shape = rng.integers(3, 12, 2)
        floor = base + rng.choice([0, 0.2, 0.6, np.nan], shape, p=[0.6, 0.2, 0.1, 0.1])
        occupied = (rng.random(shape) < 0.06) | np.isnan(floor)
        levels.append(make_level(occupied, floor, *rng.integers(-4, 5, 2)))
    grid = stack(*levels)
    radius = rng.uniform(0, 0.45)
    assert_free_as_the_oracle_says(grid, radius, 6)


def test_a_gallery_ends_at_its_edge_and_the_hall_below_is_no_drop():
    hall = level_of(*["0" * 12] * 6)
    gallery = level_of(*["0" * 6] * 6)
    gallery.attributes["floorHeight"] += np.float32(2.8)
    below, above = stack(hall, gallery).inflate(0.16).levels
    assert shown(below)[3] == "." * 12
    assert shown(above)[3] == "....##"


def test_the_edge_of_a_grid_does_not_block_on_one_level_or_several():
    hall = level_of(*["0" * 9] * 9)
    office = level_of(*["0" * 4] * 4, row=2, col=5)
    office.attributes["floorHeight"] += np.float32(2.8)
    alone = hall.inflate(0.16)
    below, above = stack(hall, office).inflate(0.16).levels
    assert shown(below) == shown(alone) == ["." * 9] * 9
    # the office ends at the grid's edge in the east, and where the hall goes on elsewhere
    assert shown(above) == ["####", "####", "####", "####"]
    wide_office = level_of(*["0" * 6] * 9, col=3)
    wide_office.attributes["floorHeight"] += np.float32(2.8)
    _, above = stack(hall, wide_office).inflate(0.16).levels
    assert shown(above) == ["##...."] * 9


def test_off_its_centres_an_agent_keeps_from_the_edge_of_its_level_too():
    hall = level_of(*["0" * 12] * 9)
    gallery = level_of(*["0" * 6] * 9)
    gallery.attributes["floorHeight"] += np.float32(2.8)
    search = Search(stack(hall, gallery).inflate(0.18))
    masks = search.off_center
    row = 9 * 12 + 4 * 6 + np.arange(6)  # a row of the gallery, which is free but for its last two
    assert search.flat.free[row].tolist() == [True] * 4 + [False] * 2
    assert masks.anywhere[row].tolist() == [True] * 3 + [False] * 3
    assert masks.sweepable[row].tolist() == [True] * 3 + [False] * 3


def test_the_stair_beside_a_landing_is_a_drop():
    lower = level_of(*["2222222222"] * 3)  # treads of a stair that turns, 0.6 m under the landing
    landing = level_of(*["8888888888"] * 4, row=3)
    _, above = stack(lower, landing).inflate(0.06).levels
    assert shown(above)[:2] == ["#" * 10, "." * 10]
    _, hangs = stack(lower, landing).inflate(0.06, ledges="ignore").levels
    assert shown(hangs)[:2] == ["." * 10] * 2


def test_a_stair_leads_to_the_level_above_it():
    lower, top = stairs(*["000000"] * 5).inflate(0.12).levels
    assert shown(lower)[2] == ".........###"
    assert shown(top)[2] == "......"
    assert find_islands(stairs(*["000000"] * 5).inflate(0.12))[1][2, 0] == 1


def test_a_wall_on_the_landing_is_in_the_way_on_the_stair():
    lower, top = stairs(*["000000"] * 2, "#00000", *["000000"] * 2).inflate(0.12).levels
    assert shown(lower)[2] == "........####"
    assert shown(top)[2] == "##...."


def test_what_is_under_the_landing_is_not_in_the_way_on_the_stair():
    grid = stairs(*["000000"] * 5)
    lower, _ = grid.inflate(0.12).levels
    assert lower.free[2, 8]
    alone = level_of("0" * 9 + "#" * 3).inflate(0.12)
    assert not alone.free[0, 8]


def flights_over_each_other(lower_floor: float, next_flight: float, occupied=()) -> MultiLevelGrid:
    """A flight goes on from the lower level to the upper one, halfway, under the next flight.

    Args:
        lower_floor: the tread of the lower level where it ends [m].
        next_flight: the upper level's floor over that tread [m].
        occupied: columns of the lower level that are occupied.
    """
    lower = level_of(*["0" * 12] * 5)
    lower.attributes["floorHeight"][:, :6] = lower_floor
    lower.attributes["occupancy"][:, list(occupied)] = 1
    lower.weights = np.where(lower.occupancy == 0, 1.0, np.inf)
    upper = level_of(*["0" * 12] * 5)
    upper.attributes["floorHeight"][:, :6] = next_flight
    upper.attributes["floorHeight"][:, 6:] = 1.2
    return stack(lower, upper)


@pytest.mark.parametrize("ledges", ["avoid", "ignore"])
def test_a_flight_that_changes_its_level_goes_on_under_the_next_flight(ledges):
    grid = flights_over_each_other(1.0, 4.0)
    lower, upper = grid.inflate(0.16, ledges=ledges).levels
    assert shown(lower)[2] == "......######"  # the ground under the upper treads is too low
    assert shown(upper)[2][6:] == "......"
    low = flights_over_each_other(1.0, 1.2 + 1.14 + 0.25 + 0.29)  # leaves no step and slab
    assert shown(low.inflate(0.16, ledges=ledges).levels[1])[2][6:] == "##...."
    high = flights_over_each_other(1.0, 1.2 + 1.14 + 0.25 + 0.31)
    assert shown(high.inflate(0.16, ledges=ledges).levels[1])[2][6:] == "......"
    # no tread of the flight is a step lower: the next one may be solid down to any
    gap = flights_over_each_other(0.9, 4.0)
    assert shown(gap.inflate(0.16, ledges=ledges).levels[1])[2][6:] == "##...."


def test_what_stands_on_the_lower_flight_is_in_the_way_under_the_next_one():
    grid = flights_over_each_other(1.0, 4.0, occupied=[4])
    assert shown(grid.inflate(0.16).levels[1])[2][6:] == "#....."
    grid = flights_over_each_other(1.0, 4.0)
    on_next_flight = grid.levels[1]
    on_next_flight.attributes["occupancy"][:, 4] = 1
    on_next_flight.weights = np.where(on_next_flight.occupancy == 0, 1.0, np.inf)
    assert shown(grid.inflate(0.16).levels[1])[2][6:] == "......"


@pytest.mark.parametrize("seed", range(24))
def test_flights_over_each_other_see_each_other_as_the_rules_say(seed):
    rng = np.random.default_rng(seed)
    num_levels = 3
    shape = (int(rng.integers(4, 8)), int(rng.integers(6, 12)))
    storey_height = rng.choice([1.5, 1.8, 2.1, 2.8])
    tread_width = int(rng.integers(1, 4))
    tread_z = np.arange(shape[1]) // tread_width * rng.choice([0.1, 0.2, 0.3])
    storeys = np.arange(num_levels)[:, None, None] * storey_height
    floors = (
        storeys + tread_z + rng.choice([0, 0.1, 0.6], (num_levels, *shape), p=[0.9, 0.05, 0.05])
    )
    floors[rng.random(floors.shape) < 0.05] = np.nan
    # beyond a column, each flight is on the next level, and the uppermost one on the lowest
    seam = int(rng.integers(1, shape[1]))
    floors[:, :, seam:] = np.roll(floors, 1, axis=0)[:, :, seam:]
    levels = [make_level((rng.random(shape) < 0.03) | np.isnan(floor), floor) for floor in floors]
    grid = stack(*levels)
    radius = rng.uniform(0.05, 0.35)
    assert_free_as_the_oracle_says(grid, radius, 5)


def test_levels_off_the_others_lattice_are_looked_at_alone():
    grid = stack(level_of("0000", "0000"), level_of("000#", "0000", col=0.5))
    assert shown(grid.inflate(0.06).levels[1]) == ["..##", "...#"]
    assert shown(grid.inflate(0.04).levels[1]) == ["...#", "...."]


@pytest.mark.parametrize("edge", range(12, 22))
def test_wherever_an_edge_is_it_is_seen(edge):  # floors are compared in squares of 16 cells first
    ledge = level_of("0" * edge + "5" * 20)
    assert shown(ledge.inflate(0.16)) == ["." * (edge - 2) + "####" + "." * 18]
    down = level_of("5" * edge + "0" * 20)
    assert shown(down.inflate(0.16)) == ["." * (edge - 2) + "####" + "." * 18]
    beside = stack(level_of(*["0" * edge] * 9), level_of(*["0#000"] * 9, col=edge))
    seen = shown(beside.inflate(0.26).levels[0])[4]
    assert seen == "." * (edge - 2) + "##"


# The result


def test_metadata_tell_what_was_done_and_all_else_stays():
    level = level_of("00#", "000", "000")
    level.user_data = {2: {"walls": ["w"]}}
    inflated = level.inflate(0.06).inflate(0.16, clearance=0.3)
    assert inflated.metadata["inflation"] == [
        {"radius": 0.06, "clearance": 0.0, "mode": "exact", "ledges": "avoid"},
        {"radius": 0.16, "clearance": 0.3, "mode": "exact", "ledges": "avoid", "costs": "step"},
    ]
    assert "inflation" not in level.metadata
    assert level.free.sum() == 8
    np.testing.assert_array_equal(inflated.occupancy, level.occupancy)
    assert inflated.user_data == level.user_data
    again = navbake.load(dumps_navgrid(inflated))
    assert first_difference(again, inflated) is None


def test_a_grid_that_is_inflated_for_a_point_has_no_radius():
    level = level_of("0000#0000")
    level.metadata["agentRadius"] = 0.2
    assert level.describe_radius() == "baked for a radius of 0.2 m"
    point = level.inflate(0.0)
    assert (point.radius, point.agent_radius) == (0.0, 0.2)
    assert point.describe_radius() == "inflated for a radius of 0 m"
    for radius in (None, "0.3", -1.0, math.nan):  # of another program: none that can be read
        level.metadata["inflation"] = [{"mode": "exact", "radius": radius}]
        assert (level.radius, level.inflated_radius) == (0.2, 0.0)


def test_a_grid_that_stays_inflated_for_more_says_so(recwarn):
    level = level_of("0000#0000")
    level.metadata["sceneId"] = "hall"
    wide = level.inflate(0.16)
    assert wide.inflate(0.16).radius == 0.16 and not recwarn
    stays = wide.inflate(0.06)
    assert shown(stays) == shown(wide) != shown(level.inflate(0.06)) and stays.radius == 0.16
    (warning,) = recwarn
    expected = "'hall' stays inflated for 0.16 m, not 0.06 m: inflate the grid as it was baked"
    assert (warning.filename, expected in str(warning.message)) == (__file__, True)
    assert warning.category is navbake.InflationWarning
    wide.inflate(0.06, mode="minos")  # which is not compared with other modes
    assert len(recwarn) == 1


def test_a_finder_says_where_a_new_grid_lacks_its_inflation(recwarn):
    level = level_of("0000#0000")
    level.metadata = {**level.metadata, "sceneId": "hall", "agentRadius": 0.05}
    finder = navbake.PathFinder(level.inflate(0.16))
    finder.use(level.inflate(0.06))  # that was meant
    finder.use(level)  # a radius of 0.06 m became the baked one
    (warning,) = recwarn
    expected = "'hall' isn't inflated: the finder's radius was 0.06 m and is now 0.05 m. Inflate"
    assert (warning.filename, expected in str(warning.message)) == (__file__, True)
    assert warning.category is navbake.InflationWarning
    assert finder.grid is level
    finder.use(level)
    by_agent = navbake.PathFinder(level, agent=navbake.Agent("robot", radius=0.16))
    by_agent.use(level)
    assert by_agent.grid.radius == 0.16 and len(recwarn) == 1


def test_levels_share_the_metadata_of_the_whole():
    grid = stack(level_of("00", "00"), level_of("00", "00"))
    grid.levels[1].metadata = {"sceneId": "attic", **AGENT}
    inflated = grid.inflate(0.1)
    assert inflated.inherits_metadata(0, inflated.levels[0])
    assert not inflated.inherits_metadata(1, inflated.levels[1])
    assert inflated.levels[1].metadata["sceneId"] == "attic"
    assert inflated.levels[1].metadata["inflation"] == inflated.metadata["inflation"]


def test_layers_follow_the_weights_where_navbake_wrote_them():
    level = level_of("00000", "0#000", "00000")
    layers = {"island": np.ones((3, 5), np.uint16), "clearance": np.ones((3, 5), np.float32)}
    level.attributes |= layers
    assert level.inflate(0.08).attributes["island"].all()  # another's, whatever it means
    level.metadata["navbake"] = {"version": "1"}
    inflated = level.inflate(0.08)
    assert inflated.attributes["island"].tolist() == [[0, 0, 0, 1, 1]] * 3
    assert inflated.attributes["clearance"][0, 3] == pytest.approx(0.05)
    assert level.attributes["island"].all()


def test_user_data_stay_unread():
    def read():
        raise AssertionError

    level = level_of("00", "00")
    level.user_data = UserData(read)
    assert not level.inflate(0.1).user_data.is_read


def test_doors_are_changed_before_not_after():
    level = level_of("00", "00")
    door = {"id": "a", "state": "closed", "cells": {"closed": [[0, [0, 1]]], "open": []}}
    level.metadata["navbake"] = {"doors": [door]}
    assert level.with_doors("open").inflate(0.1)
    with pytest.raises(QueryError, match="was inflated: change doors on the grid as it was baked"):
        level.inflate(0.1).with_doors("open")


# Bad input


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        ({"radius": -0.1}, r"0 to 10,000 m as radius, got -0.1"),
        ({"radius": np.nan}, "as radius, got nan"),
        ({"radius": np.inf}, "as radius, got inf"),
        ({"radius": 1e5}, "as radius, got 100000"),
        ({"radius": "0.3"}, "as radius, got '0.3'"),
        ({"radius": True}, "as radius, got True"),
        ({"radius": 0.1, "clearance": -1}, "as clearance, got -1"),
        ({"radius": 0.1, "clearance": np.nan}, "as clearance, got nan"),
        ({"radius": 0.1, "mode": "nav2"}, "exact or minos as mode, got 'nav2'"),
        ({"radius": 0.1, "costs": "minos"}, "step or nav2 as costs, got 'minos'"),
        ({"radius": 0.1, "costs": "nav2", "scaling": 0}, "> 0 .* as scaling, got 0"),
        ({"radius": 0.1, "costs": "nav2", "scaling": np.nan}, "as scaling, got nan"),
        ({"radius": 0.1, "costs": "nav2", "mode": "minos"}, "costs of its own"),
        ({"radius": 0.1, "ledges": "none"}, "avoid or ignore as ledges, got 'none'"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments, culprit):
    with pytest.raises(QueryError, match=culprit):
        level_of("00").inflate(**arguments)


@pytest.mark.parametrize("without", [["occupancy"], ["floorHeight"], ["occupancy", "floorHeight"]])
def test_a_file_that_tells_less_can_be_inflated_again(without):
    level = level_of("0000000000", "000#000000", "0000000000", "0000000000", "0000000000")
    for name in without:
        del level.attributes[name]
    again = level.inflate(0.1).inflate(0.15)
    np.testing.assert_array_equal(again.free, level.inflate(0.15).free)
    np.testing.assert_array_equal(again.occupancy, level.occupancy)


CASES = SHARED_DATA / "minos_refine" / "cases.json"


def unpack(runs: list) -> np.ndarray:
    return np.repeat([np.inf if v is None else v for v in runs[::2]], runs[1::2])


@pytest.mark.skipif(not CASES.is_file(), reason=f"no {CASES}")
def test_minos_gives_what_the_original_gave():
    cases = json.loads(CASES.read_text())
    assert len(cases) == 12
    for case in cases:
        grid = navbake.load(json.dumps(case["grid"]).encode())
        inflated = grid.inflate(case["radius"], case["clearance"], mode="minos")
        expected = unpack(case["expected_weights"]).reshape(grid.levels[0].shape)
        np.testing.assert_array_equal(inflated.levels[0].weights, expected)


@pytest.mark.parametrize("seed", range(16))
def test_minos_is_refine_in_plain_words(seed):
    rng = np.random.default_rng(seed)
    shape = rng.integers(1, 16, 2)
    floor = np.where(rng.random(shape) < 0.1, np.nan, 0.0)
    level = make_level(rng.random(shape) < 0.06, floor, unit=rng.choice([1.0, 0.5]))
    radius, clearance = rng.choice([0, 0.04, 0.05, 0.1, 0.2, 0.27, 2.5], 2)
    weights = level.inflate(radius, clearance, mode="minos").weights
    np.testing.assert_array_equal(weights, inflation.refine(level, radius, clearance))


def test_minos_divides_the_sum():
    level = level_of("0" * 20, "0" * 9 + "#" + "0" * 10, *["0" * 20] * 3)
    steps = [0.05 * k for k in range(1, 20, 2)]
    differ = 0
    for radius in steps:
        for clearance in steps:
            weights = level.inflate(radius, clearance, mode="minos").weights
            np.testing.assert_array_equal(weights, inflation.refine(level, radius, clearance))
            differ += radius / 0.1 + clearance / 0.1 != (radius + clearance) / 0.1
    assert differ > 10  # the sum of the quotients would be another number


def test_the_window_is_lopsided():
    level = level_of(*["0" * 9] * 4, "0000#0000", *["0" * 9] * 4)
    weights = level.inflate(0.25, mode="minos").weights
    assert np.isinf(weights[4]).tolist() == [False] * 3 + [True] * 4 + [False] * 2
    assert np.isinf(weights[:, 4]).tolist() == [False] * 3 + [True] * 4 + [False] * 2


@pytest.mark.parametrize("seed", range(20))
def test_step_costs_lie_within_the_clearance(seed):
    rng = np.random.default_rng(seed)
    level = make_level(rng.random(rng.integers(3, 25, 2)) < 0.03)
    level.weights[level.free] = rng.choice([-0.5, 0.5, 1.0, 20.0], level.free.sum())
    radius, clearance = rng.uniform(0, 0.4, 2)
    inflated = level.inflate(radius, clearance)
    free = inflation.exact_free(level, radius)
    near = free & ~inflation.exact_free(level, radius + clearance)
    expected = np.where(free, level.weights, np.inf)
    expected[near] = np.maximum(level.weights, 10)[near]
    np.testing.assert_array_equal(inflated.weights, expected)


@pytest.mark.parametrize("seed", range(20))
def test_nav2_costs_are_its_formula(seed):
    rng = np.random.default_rng(seed)
    level = make_level(rng.random(rng.integers(2, 20, 2)) < 0.02, cell=0.05)
    radius, scaling, inflation_radius = rng.uniform(0.05, 0.4), rng.choice([3.0, 10.0]), 0.55
    costs = nav2_costs(level, radius, inflation_radius, scaling)
    occupied = np.argwhere(level.occupancy)
    for row, col in np.ndindex(level.shape):
        d = min([0.05 * math.hypot(r - row, c - col) for r, c in occupied], default=math.inf)
        expected = math.floor(252 * math.exp(-scaling * (d - radius))) if d < 9 else 0
        expected = 0 if d > inflation_radius + 1e-9 else expected
        expected = 254 if d == 0 else 253 if d <= radius else expected
        assert costs[row, col] == expected


def test_nav2_costs_are_the_same_when_tabulated_in_slices(monkeypatch):
    level = make_level(np.random.default_rng(0).random((20, 30)) < 0.01, cell=0.05)
    costs = nav2_costs(level, 0.2, 2.0, 1.0)
    monkeypatch.setattr(inflation_module, "SQUARES_AT_ONCE", 7)
    np.testing.assert_array_equal(nav2_costs(level, 0.2, 2.0, 1.0), costs)


def test_costs_of_a_wide_reach_end_where_their_squares_would_overflow(monkeypatch):
    """The cells of a corridor longer than the limit, which the test lowers to 30 cells."""
    level = make_level(np.arange(60)[None] == 0, cell=0.05)
    costs = nav2_costs(level, 0.2, 9000.0, 0.001)
    assert (costs > 200).all()
    monkeypatch.setattr(inflation_module, "MAX_SQUARED_DISTANCE", 30**2 + 1)
    np.testing.assert_array_equal(
        nav2_costs(level, 0.2, 9000.0, 0.001), np.where(np.arange(60) <= 30, costs, 0)
    )
    farthest_step = 2 * 46_341  # the kernel adds it to the largest squared distance
    monkeypatch.undo()
    assert inflation_module.MAX_SQUARED_DISTANCE + farthest_step <= np.iinfo(np.int32).max


@pytest.mark.parametrize("radius", [0.2, 0.25, 0.3, 0.4])
def test_nav2_costs_measure_from_what_blocks_the_inflation(radius):
    """At the top of the house's stair, 24 free cells cost as much as those within the radius."""
    house = sample("house")
    for number in range(2):
        free = house.inflate(radius).levels[number].free
        costs = nav2_costs(house, radius, radius + 0.35, level=number)
        assert (costs[free] < 253).all()
        assert costs[free].max() > 1


@pytest.mark.parametrize("seed", range(12))
def test_nav2_costs_of_levels_are_those_of_the_nearest_cell_that_blocks(seed):
    """The distance to the nearest cell that a disc may not overlap, cell by cell."""
    rng = np.random.default_rng(seed)
    grid = random_house(rng, share=0.93, steps=False)
    if seed % 2:  # both levels at one height, as the landings of a stair are
        upper = grid.levels[1]
        upper.attributes["floorHeight"] -= np.float32(1.9)
    radius = 0.1
    for number, level in enumerate(grid.levels):
        costs = nav2_costs(grid, radius, 0.6, 3.0, level=number)
        free = level.free & (level.solid == 0)
        stack, window = stack_levels(grid, number, 8)
        overlap = stack.height - stack.max_step
        for row, col in np.argwhere(free):
            height = level.floor[row, col]
            near = np.abs(stack.floor - height) < overlap
            others = near.copy()
            others[stack.level] = False
            own_counts = ~others.any(axis=0) | near[stack.level]
            counts = (others & (stack.occupied != 0)).any(axis=0)
            counts |= own_counts & (stack.occupied[stack.level] != 0)
            rows, cols = np.nonzero(counts)
            at_row, at_col = window[0].start + row, window[1].start + col
            d = 0.1 * np.hypot(rows - at_row, cols - at_col).min(initial=9.0)
            expected = math.floor(252 * math.exp(-3.0 * (d - radius)) + 1e-9)
            expected = 253 if d <= radius + 1e-9 else 0 if d > 0.6 + 1e-9 else expected
            assert costs[row, col] == (254 if d == 0 else expected)


def test_nav2_costs_become_weights_and_open_nothing():
    level = level_of("0" * 14 + "#", cell=0.1)
    level.weights[0, 0] = np.inf
    weights = level.inflate(0.22, costs="nav2", clearance=0.5).weights[0]
    falling = [math.floor(252 * math.exp(-10 * (d / 10 - 0.22))) for d in range(3, 8)]
    assert falling == [113, 41, 15, 5, 2]
    assert weights.tolist() == [np.inf, *[1.0] * 6, *falling[::-1], *[np.inf] * 3]
    everywhere = level.inflate(0.22, costs="nav2").weights[0]
    np.testing.assert_array_equal(everywhere, weights)  # where it would be below 1, it is 1
    slow = level.inflate(0.22, costs="nav2", scaling=3.0).weights[0]
    assert slow[1] == math.floor(252 * math.exp(-3 * (1.3 - 0.22)))


def test_costs_that_hardly_fall_reach_everywhere():
    level = level_of("0000000000", "000#000000")
    weights = level.inflate(0.1, costs="nav2", scaling=1e-320).weights
    assert (weights[np.isfinite(weights)] == 252).all()


@pytest.mark.parametrize("seed", range(40))
def test_costs_are_those_of_distances_by_scipy(seed):
    rng = np.random.default_rng(seed)
    share = rng.choice([0.0, 0.01, 0.2, 0.9, 1.0])
    occupied = rng.random(rng.integers(1, 90, 2)) < share
    cost_of_square = rng.integers(0, 255, rng.choice([1, 2, 30, 300, 20_000])).astype(np.uint8)
    costs = look_up_by_distance(make_level(occupied), 0, cost_of_square)
    expected = np.zeros(occupied.shape)
    if occupied.any():
        squares = np.rint(ndimage.distance_transform_edt(~occupied) ** 2).astype(np.int64)
        expected = np.append(cost_of_square, 0)[np.minimum(squares, len(cost_of_square))]
    np.testing.assert_array_equal(costs, expected)
