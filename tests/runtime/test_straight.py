"""Paths of inflated grids are as straight as others, and keep the radius all along."""

from __future__ import annotations

import numpy as np
import pytest

import navbake
from box_worlds import box, world
from level_maps import CELL, level_of, make_level
from navbake.runtime.path_finder import PathFinder
from project_paths import ROOT, SHARED_DATA

HARD_CASES = SHARED_DATA / "hard_cases"


def bake_case(name: str, **settings):
    path = HARD_CASES / name
    if not path.is_file():
        pytest.skip(f"no {path}")
    return navbake.bake({"scene": {"path": str(path)}, **settings})


def in_line(positions: np.ndarray) -> int:
    """How many waypoints are on the straight line between those before and after, in space."""
    before, here, after = positions[:-2], positions[1:-1], positions[2:]
    one, two = here - before, after - here
    off = np.linalg.norm(np.cross(one, two), axis=1)
    ahead = (one * two).sum(axis=1) > 0
    return int((ahead & (off < 1e-9)).sum())


def test_a_path_round_a_corner_has_no_waypoints_in_line():
    finder = PathFinder(bake_case("15_corner.xml").inflate(0.3))
    path = finder.find_path((-5, -1, 0), (5, -1, 0))
    assert in_line(path.positions) == 0
    assert len(path.positions) == 4


def test_nobody_comes_near_the_edge_of_the_dock_but_the_ramp_is_used():
    grid = bake_case("6_dock.xml")
    (level,) = grid.inflate(0.4).levels
    x, y = level.lattice.center_x()[None], level.lattice.center_y()[:, None]
    on_dock = (np.abs(x - 3) < 2) & (np.abs(y) < 2)
    within = np.minimum(2 - np.abs(x - 3), 2 - np.abs(y)) < 0.4
    lands = (x < 1.5) & (np.abs(y) < 0.6)  # the ramp ends there
    assert not (level.free & on_dock & within & ~lands).any()
    assert (level.free & on_dock & ~within).any()
    path = PathFinder(grid.inflate(0.4)).find_path((-5, 0, 0), (4, 0, 1))
    assert path.positions[-1][2] == pytest.approx(1.0)
    (hangs,) = grid.inflate(0.4, ledges="ignore").levels
    assert (hangs.free & on_dock & within & ~lands).any()


ROOM, DEPTH, CORRIDOR, DOOR, WALL = 3.6, 4.2, 2.2, 1.1, 0.15  # [m]
NUM_ROOMS = 6  # on each side


def hospital(rng) -> str:
    """A corridor with rooms on both sides, each with a door somewhere and a few beds."""
    length, half = NUM_ROOMS * ROOM, CORRIDOR / 2
    parts = [box("floor", -WALL, -half - DEPTH, -0.1, length, half + DEPTH, 0)]
    parts += [box("", -WALL, -half - DEPTH, 0, 0, half + DEPTH, 2.5)]
    parts += [box("", length - WALL, -half - DEPTH, 0, length, half + DEPTH, 2.5)]
    for side in (-1, 1):

        def wall(x0, x1, near, far, top, side=side):
            y0, y1 = sorted((side * near, side * far))
            return box("", x0, y0, 0, x1, y1, top)

        for k in range(NUM_ROOMS):
            start, end = k * ROOM, (k + 1) * ROOM
            door = start + rng.uniform(0.3, ROOM - DOOR - 0.45)
            parts += [wall(start, door, half, half + WALL, 2.5)]
            parts += [wall(door + DOOR, end, half, half + WALL, 2.5)]
            parts += [wall(end - WALL, end, half, half + DEPTH, 2.5)]
            bed = start + rng.uniform(0.2, ROOM - 1.4)
            parts += [wall(bed, bed + 0.9, half + 1.6, half + 3.6, 0.6)]
        parts += [wall(-WALL, length, half + DEPTH - WALL, half + DEPTH, 2.5)]
    return "".join(parts)


@pytest.mark.parametrize("seed", range(2))
def test_paths_of_a_hospital_are_straight_and_short(tmp_path, seed):
    rng = np.random.default_rng(seed)
    path = tmp_path / "hospital.xml"
    path.write_text(world(hospital(rng)), encoding="utf-8")

    def bake(radius):
        return navbake.bake({"scene": {"path": str(path)}, "agent": {"radius": radius}})

    inflated, native = PathFinder(bake(0.05).inflate(0.3)), PathFinder(bake(0.3))
    middle = CORRIDOR / 2 + 0.9
    ends = [
        np.array([k * ROOM + ROOM / 2, side * middle, 0.0])
        for k in range(NUM_ROOMS)
        for side in (-1, 1)
    ]
    num_waypoints = []
    for _ in range(30):
        a, b = (ends[k] for k in rng.choice(len(ends), 2, replace=False))
        one, other = inflated.find_path(a, b), native.find_path(a, b)
        assert one is not None
        assert in_line(one.positions) == in_line(other.positions) == 0
        # a cell at each bend: the bake knows the disc, the inflation the squares that it meets
        assert one.length <= other.length + CELL * (len(one.positions) - 2)
        num_waypoints.append(len(one.positions))
    assert max(num_waypoints) <= 10


@pytest.mark.parametrize("seed", range(8))
def test_no_three_waypoints_are_in_line(seed):
    rng = np.random.default_rng(seed)
    occupied = rng.random((40, 40)) < 0.01
    occupied[10:30, rng.integers(10, 30)] = True  # a wall to go along
    grid = make_level(occupied).inflate(float(rng.choice([0.12, 0.2, 0.25])))
    finder = PathFinder(grid)
    for a, b in finder.random_point(rng, 40).reshape(20, 2, 3):
        path = finder.find_path(a, b)
        if path is not None:
            assert in_line(path.positions) == 0


def test_a_straight_way_beside_a_wall_is_one_line():
    level = level_of("#" * 40, *["0" * 40] * 8)
    plain, wide = PathFinder(level), PathFinder(level.inflate(0.25))
    start, end = (0.2, -0.36, 0.0), (3.8, -0.41, 0.0)  # 0.26 and 0.31 m from it
    for finder in (plain, wide):
        np.testing.assert_allclose(finder.find_path(start, end).positions, [start, end])
    near = (0.2, -0.34, 0.0)  # 0.24 m: the path begins at the centre of the cell
    np.testing.assert_allclose(wide.find_path(near, end).positions[0], [0.25, -0.35, 0])


def test_waypoints_on_stairs_tell_where_the_floor_rises():
    house = navbake.load(ROOT / "tests" / "golden" / "house.grid.json.gz")
    rooms = house.rooms
    for grid in (house, house.inflate(0.15)):
        finder = PathFinder(grid)
        start = finder.snap(next(r.centroid for r in rooms if r.level == 0))
        path = finder.find_path(start, f"room:{next(r.id for r in rooms if r.level == 1)}")
        rises = np.abs(np.diff(path.positions[:, 2]))
        assert rises.max() < 0.26
        assert (rises > 0.1).sum() > 8  # its treads
        # the last one is where the storey ends, wherever that is
        assert in_line(path.positions[path.levels == 0][:-1]) == 0


def test_objects_are_reached_whatever_the_baked_radius(tmp_path):
    content = (
        box("floor", -2, -2, -0.1, 2, 2, 0)
        + box("wall", -2, 1.9, 0, 2, 2, 2)
        + box("cabinet", -0.5, 1.3, 0, 0.5, 1.9, 0.6)
        + box("television", -0.3, 1.6, 0.6, 0.3, 1.7, 1.0)
        + box("stool", 1.2, -1.2, 0, 1.5, -0.9, 0.5)
    )
    path = tmp_path / "scene.xml"
    path.write_text(world(content), encoding="utf-8")
    for radius in (0.05, 0.2, 0.3):
        grid = navbake.bake({"scene": {"path": str(path)}, "agent": {"radius": radius}})
        for asked in (grid, grid.inflate(0.35)):
            finder = PathFinder(asked)
            for name in ("cabinet", "television", "stool"):
                found = finder.find_path((-1, -1, 0), f"object:{name}")
                assert found is not None, (radius, name)
                assert found.positions[-1][1] < 1.3


def test_the_ring_round_an_object_goes_through_no_wall(tmp_path):
    content = (
        box("floor", -2, -2, -0.1, 2, 2, 0)
        + box("wall", -2, 0, 0, 2, 0.1, 2)
        + "".join(
            box(f"shelf{k}", *sides, 0, *ends, 1.4)
            for k, (sides, ends) in enumerate(
                (
                    ((-2, 0.1), (2, 1)),
                    ((-2, 1), (-1.4, 2)),
                    ((-1.4, 1.9), (2, 2)),
                    ((1.9, 1), (2, 2)),
                )
            )
        )
        + box("lamp", -1.0, 0.3, 2, -0.9, 0.4, 2.1)
    )
    path = tmp_path / "scene.xml"
    path.write_text(world(content), encoding="utf-8")
    grid = navbake.bake({"scene": {"path": str(path)}, "agent": {"radius": 0.2, "height": 2.3}})
    found = PathFinder(grid).find_path((0, -1, 0), "object:lamp")
    assert found is None
    reason = PathFinder(grid).why_not((0, -1, 0), "object:lamp")
    assert "island" in reason
