"""Why there is no path, in one sentence."""

import numpy as np
import pytest

import navbake
from navbake.navgrid.cells import Cells
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.rooms import to_runs
from navbake.runtime.path_finder import PathFinder
from oracles.ways import make_level, stack
from project_paths import GOLDEN


def from_map(rows, **kwargs):
    """``#`` occupied, a dot free, a space without floor."""
    cells = np.array([list(row) for row in rows])
    level = make_level(cells == ".", np.where(cells == " ", np.nan, 0.0), **kwargs)
    level.attributes["occupancy"] = (cells != ".").astype(np.uint8)
    return level


@pytest.fixture(scope="module")
def house():
    return navbake.load(GOLDEN / "house.grid.json.gz")


def assert_says(reason, *parts):
    assert reason is not None
    assert "\n" not in reason
    for part in parts:
        assert part in reason, reason


def test_nothing_to_say_when_there_is_a_path():
    assert PathFinder(from_map(["..."])).why_not((0.05, -0.05), (0.25, -0.05)) is None


def test_places_that_are_not_free():
    grid = from_map([".# .", "...."])
    grid.user_data = {1: {"objects": ["table"]}}
    finder = PathFinder(grid)
    good = (0.05, -0.05)
    assert_says(
        finder.why_not((0.15, -0.04), good),
        "the start (0.15, -0.04) is where something stands (table)",
        "the nearest free cell is at (0.05, -0.05, 0.00), 0.10 m away",
    )
    assert_says(finder.why_not(good, (0.25, -0.05)), "the goal (0.25, -0.05) is on no floor")
    assert_says(
        finder.why_not(good, (7.0, -0.05)),
        "the goal (7.00, -0.05) lies beside the grid, x 0 to 0.4, y -0.2 to 0",
        "(0.35, -0.05, 0.00), 6.65 m away",
    )
    assert_says(finder.why_not((0.05, -0.05, -3.0), good), "lies below every floor", "z up")
    assert_says(
        finder.why_not(good, [(0.15, -0.05), (0.25, -0.05)]),
        "none of the 2 goals is free: the first (0.15, -0.05) is where something stands",
    )
    with grid.block(cells=grid.cell_at(good)):
        assert_says(finder.why_not(good, (0.35, -0.05)), "the start", "blocked for now")


def test_too_near_for_the_radius():
    finder = PathFinder(from_map(["........", "........", "........", "....#..."]).inflate(0.2))
    assert_says(
        finder.why_not((0.45, -0.25), (0.05, -0.05)),
        "is too near to what stands beside it for a radius of 0.2 m; the nearest free cell",
    )


def test_nothing_free_at_all():
    grid = from_map(["##", "##"])
    assert_says(PathFinder(grid).why_not((0.05, -0.05), (0.15, -0.05)), "no cell is free at all")


def test_islands_and_what_is_between():
    grid = from_map(["...#..", "...#.."])
    grid.user_data = {3: {"walls": ["partition"]}, 9: {"walls": ["partition"]}}
    assert_says(
        PathFinder(grid).why_not((0.05, -0.05), (0.55, -0.05)),
        "the goal is in island 2 (0.04 m²), the start in island 1 (0.06 m²)",
        "their nearest cells are 0.20 m apart, at (0.25, -0.05, 0.00) and (0.45, -0.05, 0.00)",
        "between them: partition",
    )


def test_the_width_of_a_gap():
    rows = ["." * 21] * 8 + ["." * 10 + "#" + "." * 10] * 4
    rows += ["." * 21] * 4 + ["." * 10 + "#" + "." * 10] * 20
    rows[:8] = ["." * 10 + "#" + "." * 10] * 8
    finder = PathFinder(from_map(rows).inflate(0.25))
    reason = finder.why_not((0.35, -1.55), (1.75, -1.55))
    assert_says(reason, "is 0.40 m wide, the agent 0.50 m", "the gap between, at (1.05, -1.")
    assert PathFinder(from_map(rows).inflate(0.15)).find_path((0.35, -1.55), (1.75, -1.55))


def test_levels_without_steps_between_them():
    level = from_map(["..."])
    grid = stack([level, from_map(["..."], col0=3)], [])
    assert_says(
        PathFinder(grid).why_not((0.05, -0.05, 0.0), (0.45, -0.05, 0.0)),
        "no steps lead from level 0 to another level",
    )


def test_steps_that_cannot_be_taken():
    grid = stack([from_map(["..#"]), from_map([".."], col0=3)], [[0, 2, 1, 0]])
    assert_says(
        PathFinder(grid).why_not((0.05, -0.05, 0.0), (0.45, -0.05, 0.0)),
        "the step from level 0 to level 1 leads to cells that aren't free",
    )


def link_cells(grid):
    links = grid.step_array[:, :2]
    widths = np.array([level.width for level in grid.levels])[links[:, 0]]
    return Cells(links[:, 0], *np.divmod(links[:, 1], widths))


def test_the_stairs_of_the_house_blocked(house):
    finder = PathFinder(house)
    start = next(room.centroid for room in house.rooms if room.level == 0)
    start = finder.snap(start, room=next(r.id for r in house.rooms if r.level == 0))
    above = [room.id for room in house.rooms if room.level == 1]
    assert all(finder.find_path(start, f"room:{room}") for room in above)
    with house.block(cells=link_cells(house)):
        for room in above:
            assert finder.find_path(start, f"room:{room}") is None
            assert_says(
                finder.why_not(start, f"room:{room}"),
                "the stairs at",
                f"all {len(house.steps)} steps from level 0 to level 1",
                "are blocked for now",
            )
    assert all(finder.find_path(start, f"room:{room}") for room in above)


def test_stairs_blocked_halfway_up(house):
    finder = PathFinder(house)
    start = finder.snap((0.0, 0.0, 0.0), same_level=True)
    above = next(f"room:{room.id}" for room in house.rooms if room.level == 1)
    blocks = []
    for _ in range(9):
        path = finder.find_path(start, above)
        if path is None:
            break
        middle = path.positions[np.argmin(np.abs(path.positions[:, 2] - 1.5))]
        blocks.append(house.block(disc=(middle, 0.3)))
    try:
        assert finder.find_path(start, above) is None
        assert_says(finder.why_not(start, above), "the stairs at", "level 1", "blocked for now")
    finally:
        for block in blocks:
            block.free()


def test_closed_doors_are_named(house):
    closed = house.with_doors("closed")
    finder = PathFinder(closed)
    start = finder.snap((0.0, -3.5, 0.0))
    rooms = [room.id for room in house.rooms]
    reasons = [finder.why_not(start, f"room:{room}") for room in rooms]
    told = [reason for reason in reasons if reason]
    assert told
    assert all("door" in reason and "(closed)" in reason for reason in told)
    inflated = closed.inflate(0.1)
    finder = PathFinder(inflated)
    reasons = [finder.why_not(finder.snap(start), f"room:{room}") for room in rooms]
    assert any(reason and "(closed)" in reason for reason in reasons)


def test_rooms_and_objects_without_a_free_cell(house):
    grid = house.inflate(1.0)
    finder = PathFinder(grid)
    free = np.flatnonzero(finder.search.flat.free)
    start = finder.search.flat.positions(free[0])
    reasons = [finder.why_not(start, f"room:{room.id}") for room in house.rooms]
    assert any(r and "no cell of room" in r and "radius of 1 m" in r for r in reasons)


def test_a_gap_beside_a_diagonal_step():
    finder = PathFinder(from_map(["#..", "...", "..#"]).inflate(0.1))
    reason = finder.why_not((0.05, -0.25), (0.25, -0.05))
    assert_says(reason, "the gap between", "0.10 m wide, the agent 0.20 m")


def with_letters_as_doors(rows):
    """A map whose letters are closed doors."""
    grid, letters = from_map(rows), np.array([list(row) for row in rows]).ravel()
    doors = []
    for name in sorted(set("".join(rows)) - set("#. ")):
        cells = [[0, to_runs(np.flatnonzero(letters == name))]]
        of_door = {"id": name, "joint": None, "rooms": [], "state": "closed"}
        doors.append({**of_door, "cells": {"closed": cells, "open": []}})
    grid.metadata["navbake"] = {"doors": doors}
    return grid


@pytest.mark.parametrize("radius", [0.0, 0.1, 0.2])
def test_only_doors_that_have_to_be_opened_are_named(radius):
    rooms, ways = ["....#....#...."] * 2, ["....a....b...."] * 5
    rows = [part.replace("....", "." * 9) for part in [*rooms, *ways, *rooms]]
    rows += [f"##ccccc{'#' * 13}{'.' * 9}", *["." * 29] * 7]
    grid = with_letters_as_doors(rows)
    start, goal = (0.45, -0.45), (2.45, -0.45)

    def reason(**states):
        changed = grid.with_doors(states)
        return PathFinder(changed.inflate(radius) if radius else changed).why_not(start, goal)

    # the short way leads through two doors, the way round through one
    assert_says(reason(), "; door 'c' (closed) is in the way")
    assert_says(reason(a="open"), "; door 'b' (closed) is in the way")
    assert reason(c="open") is None
    assert reason(a="open", b="open") is None


def test_the_distance_between_islands_counts_heights():
    floor = np.array([[0.0, 0.0, np.nan, 2.6, 2.6]], dtype=np.float32)
    grid = SceneGrid2D(
        width=5,
        height=1,
        cell_size=0.1,
        min_yup=(0.0, 0.0, 0.0),
        weights=np.where(np.isnan(floor), np.inf, 1.0),
        attributes={"floorHeight": floor},
    )
    reason = PathFinder(grid).why_not((0.05, -0.05, 0.0), (0.45, -0.05, 2.6))
    assert "nearest cells are 2.61 m apart" in reason


def test_a_link_opens_stairs_that_are_closed_for_a_radius_and_the_reason_says_so(house):
    start, goal = (0.0, -4.8, 0.0), (-2.2, -3.2, 3.0)
    robot = navbake.Agent("robot", radius=0.3)
    reason = PathFinder(house, agent=robot).why_not(start, goal)
    hint = "; if the agent can climb, a link in `links` joins their ends"
    assert reason.endswith("are closed for a radius of 0.3 m, and 0.25 m passes" + hint)
    # from the free floor before the foot of a stair to that behind its head
    stairs = {"name": "stairs", "kind": "stairs", "stops": [[4.2, -2.5, 0.0], [4.2, 2.4, 3.0]]}
    linked = navbake.bake(navbake.samples.path("house"), links=[stairs])
    assert PathFinder(linked, agent=robot).find_path(start, goal).links == ["stairs"]
    np.testing.assert_array_equal(linked.levels[0].occupancy, house.levels[0].occupancy)


def test_a_finder_keeps_its_radius_on_another_grid(house):
    finder = PathFinder(house, agent=navbake.Agent("robot", radius=0.3))
    closed = house.with_doors("closed")
    finder.use(closed)
    assert (finder.grid.radius, finder.agent.name) == (0.3, "robot")
    for level, expected in zip(finder.grid.levels, closed.inflate(0.3).levels, strict=True):
        np.testing.assert_array_equal(level.free, expected.free)


def test_steps_that_are_too_high_for_the_agent_are_the_reason(house):
    start, goal = (0.0, -4.8, 0.0), (-2.2, -3.2, 3.0)
    assert PathFinder(house, agent=navbake.Agent("robot", step=0.2)).find_path(start, goal)
    reason = PathFinder(house, agent=navbake.Agent("robot", step=0.05)).why_not(start, goal)
    assert reason.endswith(" rise up to 0.19 m a step, and 'robot' takes 0.05 m")
    assert "; the stairs at (" in reason
    level = from_map(["......"])
    level.attributes["floorHeight"][:, 3:] = 0.2
    ends = (0.05, -0.05, 0.0), (0.55, -0.05, 0.2)
    assert PathFinder(level).why_not(*ends) is None
    assert (
        PathFinder(level, agent=navbake.Agent("", step=0.1))
        .why_not(*ends)
        .endswith("the step at (0.25, -0.05, 0.00) rises 0.20 m, and the agent takes 0.1 m")
    )
