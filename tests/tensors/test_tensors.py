"""Tensors answer as PathFinder does, on every library, to the last cell."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given as given_by
from hypothesis import settings
from hypothesis import strategies as st

import navbake
from grid_maps import level_from, random_house
from level_maps import level_of, stack, stairs
from navbake import tensors
from navbake.errors import QueryError
from navbake.navgrid.islands import measure_clearance
from navbake.runtime.flat_grid import flatten
from navbake.runtime.path_finder import PathFinder
from oracles.beams import beam_ranges
from project_paths import GOLDEN
from tensors.libraries import ON_ALL, compiled, given, library, positions_over, shown

pytest.importorskip("array_api_compat")


class Oracle:
    """What the run time says of positions, in float64."""

    def __init__(self, grid, positions):
        self.grid, self.finder, self.flat = grid, PathFinder(grid), flatten(grid)
        self.positions, self.known = positions, np.isfinite(positions).all(axis=-1)
        self.cell = np.full(len(positions), -1)
        self.cell[self.known] = self.flat.cells_at(positions[self.known])

    def layer(self, values, outside):
        return np.where(self.cell >= 0, values[self.cell], outside)

    def navigable(self):
        found = np.zeros(len(self.positions), dtype=bool)
        found[self.known] = self.finder.is_navigable(self.positions[self.known])
        return found

    def level(self):
        return np.where(self.cell >= 0, self.flat.level_of(self.cell), -1)

    def room(self):
        numbers = [self.finder.rooms.number]
        return self.layer(np.concatenate(numbers), 0)

    def clearance(self):
        values = np.concatenate([measure_clearance(level).ravel() for level in self.grid.levels])
        return self.layer(values.astype(np.float64), np.nan)


def grid_of(seed):
    return random_house(np.random.default_rng(seed), num_levels=1 + seed % 3)


def with_bad_ones(positions):
    positions = positions.copy()
    for k, bad in enumerate(np.ndindex(3, 3)):
        positions[k, bad[0]] = (np.nan, np.inf, -np.inf)[bad[1]]
    return positions


@ON_ALL
@pytest.mark.parametrize("seed", range(6))
def test_every_layer_is_the_run_times(case, seed):
    name, dtype = case
    xp, grid = library(name), grid_of(seed)
    positions = positions_over(grid, np.random.default_rng(seed), 3000, dtype)
    positions = with_bad_ones(positions)
    oracle, t = Oracle(grid, positions), grid.tensors(xp, dtype=dtype)
    p = given(xp, positions, dtype)
    np.testing.assert_array_equal(shown(tensors.level_at(t, p)), oracle.level())
    np.testing.assert_array_equal(shown(tensors.is_navigable(t, p)), oracle.navigable())
    np.testing.assert_array_equal(shown(tensors.room(t, p)), oracle.room())
    floors = oracle.layer(oracle.flat.floors.z, np.nan).astype(dtype)
    np.testing.assert_array_equal(shown(tensors.floor(t, p)), floors)
    nearest = shown(tensors.clearance(t, p, mode="nearest"))
    np.testing.assert_array_equal(nearest.astype(np.float32), oracle.clearance().astype(np.float32))


@settings(max_examples=25, deadline=None)
@given_by(seed=st.integers(0, 10_000), dtype=st.sampled_from(["float32", "float64"]))
def test_no_position_is_put_into_a_wrong_cell(seed, dtype):
    rng = np.random.default_rng(seed)
    grid = random_house(rng, num_levels=int(rng.integers(1, 4)))
    shift = rng.choice([0.0, 1e-7, 12.34, -1234.5, 30_000.0])
    for level in grid.levels:
        x, y, z = level.min_yup
        level.min_yup = (x + shift, y, z - shift)
    positions = positions_over(grid, rng, 2000, dtype)
    oracle, t = Oracle(grid, positions), grid.tensors(dtype=dtype)
    p = positions.astype(dtype)
    np.testing.assert_array_equal(tensors.level_at(t, p), oracle.level())
    np.testing.assert_array_equal(tensors.is_navigable(t, p), oracle.navigable())


def test_large_batches_are_answered_in_pieces_and_alike():
    grid = grid_of(2)
    t = grid.tensors()
    positions = positions_over(grid, np.random.default_rng(0), 120_000)
    whole = tensors.is_navigable(t, positions.reshape(4, 300, 100, 3))
    assert whole.shape == (4, 300, 100)
    parts = [tensors.is_navigable(t, part) for part in positions.reshape(120, 1000, 3)]
    np.testing.assert_array_equal(whole.ravel(), np.concatenate(parts))
    steps = tensors.clearance(t, positions)
    parts = [tensors.clearance(t, part) for part in positions.reshape(120, 1000, 3)]
    np.testing.assert_array_equal(steps, np.concatenate(parts))


@ON_ALL
def test_distances_and_steps_lead_to_goals(case):
    name, dtype = case
    xp, grid = library(name), stairs("##00", "0000", "0000", "0000", "00##")
    finder = PathFinder(grid)
    goals = [finder.random_point(np.random.default_rng(0), level=k) for k in (0, 1)]
    t = grid.tensors(xp, dtype=dtype, goals=goals)
    starts = finder.random_point(np.random.default_rng(1), 200, anywhere=True).astype(dtype)
    for k, goal in enumerate(goals):
        ask = compiled(xp, lambda p, k=k: tensors.distance_to_goal(t, p, k))
        ask_step = compiled(xp, lambda p, k=k: tensors.path_step(t, p, k))
        found = shown(ask(given(xp, starts, dtype)))
        expected = finder.distances(starts.astype(np.float64), goal)
        np.testing.assert_allclose(found, expected, rtol=1e-6)
        # whoever takes the steps arrives, and has gone no farther than the field says
        at = starts.astype(np.float64)
        for _ in range(400):
            step = shown(ask_step(given(xp, at, dtype))).astype(np.float64)
            assert np.isfinite(step).all()
            lengths = np.hypot(*step.T)
            assert np.all((lengths < 1e-12) | (np.abs(lengths - 1) < 1e-5))
            at[:, :2] += 0.02 * step
            at[:, 2] = finder.snap(at)[:, 2]
        arrived = shown(ask(given(xp, at, dtype)))
        assert (arrived < 0.15).all()


def test_beside_the_grid_and_off_the_way():
    grid = level_from("..#..\n..#..\n..#..")
    t = grid.tensors(goals=[(0.05, -0.05, 0.0)])
    p = np.array([[0.35, -0.05, 0.1], [5.0, 5.0, 0.1], [np.nan, 0, 0], [0.05, -0.25, 0.1]])
    distance, step = tensors.distance_to_goal(t, p), tensors.path_step(t, p)
    assert distance[0] == np.inf and np.isnan(distance[1:3]).all()
    assert distance[3] == pytest.approx(0.2)
    assert np.isnan(step[:3]).all()
    np.testing.assert_allclose(step[3], [0.0, 1.0], atol=1e-9)
    assert (tensors.path_step(t, np.array([0.02, -0.02, 0.1])) == 0).all()


@ON_ALL
def test_bilinear_clearance(case):
    name, dtype = case
    xp, grid = library(name), level_from("....\n....\n....\n...#")
    t = grid.tensors(xp, dtype=dtype)
    ask = compiled(xp, lambda p: tensors.clearance(t, p))
    values = measure_clearance(grid).astype(np.float64)
    at_centers = [[0.05 + 0.1 * c, -0.05 - 0.1 * r, 0.0] for r, c in np.ndindex(4, 4)]
    found = shown(ask(given(xp, at_centers, dtype)))
    np.testing.assert_allclose(found, values.ravel(), atol=1e-6)
    between = shown(ask(given(xp, [[0.175, -0.22, 0.0]], dtype)))
    rows = values[1:3, 1:3] @ [0.75, 0.25]
    np.testing.assert_allclose(between, [rows @ [0.3, 0.7]], atol=1e-6)
    corner = shown(ask(given(xp, [[0.001, -0.001, 0.0]], dtype)))
    np.testing.assert_allclose(corner, values[0, 0], atol=1e-6)
    assert np.isnan(shown(ask(given(xp, [[-0.01, 0.0, 0.0]], dtype)))).all()


@ON_ALL
def test_heights_and_patches_turn_with_the_agent(case):
    name, dtype = case
    # world x to the right, y up: 0 to 3 tenths of a metre high
    xp, grid = library(name), level_from("0123\n0123\n0123\n0123")
    t = grid.tensors(xp, dtype=dtype)
    agent = given(xp, [[0.15, -0.15, 1.0]] * 2, dtype)
    yaw = given(xp, [0.0, np.pi / 2], dtype)
    pattern = given(xp, [[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [9.0, 0.0]], dtype)
    scan = compiled(xp, lambda p, yaw: tensors.heights(t, p, yaw, pattern))
    found = shown(scan(agent, yaw))
    expected = [[0.1, 0.2, 0.1, np.nan], [0.1, 0.1, 0.0, np.nan]]
    np.testing.assert_allclose(found, expected, atol=1e-6)
    # looking along x: what is ahead, x larger, is in the first row; left is y larger
    crop = compiled(xp, lambda p, yaw: tensors.patch(t, p, yaw, (3, 5), 0.1, "floor"))
    cut = shown(crop(agent, yaw))
    assert cut.shape == (2, 3, 5)
    np.testing.assert_allclose(cut[0, :, 2], [0.2, 0.1, 0.0], atol=1e-6)
    np.testing.assert_allclose(cut[0, 1], [np.nan, 0.1, 0.1, 0.1, 0.1], atol=1e-6)
    np.testing.assert_allclose(cut[1, 1], [np.nan, 0.0, 0.1, 0.2, 0.3], atol=1e-6)
    free = shown(compiled(xp, lambda p, yaw: tensors.patch(t, p, yaw, (1, 1)))(agent, yaw))
    assert free.dtype == bool and free.shape == (2, 1, 1)


def test_a_scan_sees_the_agents_own_storey():
    grid = stairs(*["0000"] * 5)
    t = grid.tensors()
    pattern = np.array([[0.0, 0.0]])
    under, over = np.array([1.05, -0.25, 0.1]), np.array([1.05, -0.25, 1.5])
    heights = tensors.heights(t, np.stack([under, over]), np.zeros(2), pattern)
    np.testing.assert_allclose(heights[:, 0], [0.0, 1.4], atol=1e-6)


@ON_ALL
@pytest.mark.parametrize("seed", range(4))
def test_ranges_are_those_to_the_squares(case, seed):
    name, dtype = case
    rng = np.random.default_rng(seed)
    xp, grid = library(name), random_house(rng, num_levels=1 + seed % 2, share=0.9)
    positions = positions_over(grid, rng, 60, dtype)
    yaw = rng.uniform(-np.pi, np.pi, 60).astype(dtype).astype(np.float64)
    yaw[::4] = 0.0  # along the lines between cells
    angles = np.array([0.0, 0.25, 0.5, -0.75, 1.0, 0.1, 0.7, -1.3]) * np.pi
    angles = angles.astype(dtype).astype(np.float64)
    t = grid.tensors(xp, dtype=dtype)
    scan = compiled(xp, lambda p, yaw: tensors.ranges(t, p, yaw, given(xp, angles, dtype), 0.9))
    found = shown(scan(given(xp, positions, dtype), given(xp, yaw, dtype)))
    assert found.shape == (60, 8)
    level_numbers = Oracle(grid, positions).level()
    margin = 1e-9 if dtype == "float64" else 1e-5
    for distances, position, heading, number in zip(
        found, positions, yaw, level_numbers, strict=True
    ):
        if number < 0:
            assert np.isnan(distances).all()
            continue
        x, y, _ = position
        level = grid.levels[number]
        # what touches a square, or ends at one, may fall either way
        nearest = beam_ranges(level, x, y, heading + angles, 0.9 + margin, margin)
        farthest = beam_ranges(level, x, y, heading + angles, 0.9 - margin, -margin)
        slack = 100 * margin  # grazing beams cross a moved edge later
        assert ((nearest - slack <= distances) & (distances <= farthest + slack)).all()
    assert np.isfinite(found).any() and np.isinf(found).any()


@ON_ALL
def test_no_beam_passes_between_squares_that_share_a_corner(case):
    name, dtype = case
    xp, grid = library(name), level_from("...#\n..#.\n.#..\n#...")
    t = grid.tensors(xp, dtype=dtype)
    centers = [(0.05, -0.05, 0.0), (0.15, -0.15, 0.0), (0.25, -0.25, 0.0), (0.35, -0.35, 0.0)]
    yaw = np.deg2rad([-45.0, -45.0, 135.0, 135.0])
    scan = compiled(xp, lambda p, yaw: tensors.ranges(t, p, yaw, given(xp, [0.0], dtype), 5.0))
    found = scan(given(xp, centers, dtype), given(xp, yaw, dtype))
    half_diagonal = 0.05 * 2**0.5
    expected = np.array([3, 1, 1, 3]) * half_diagonal
    np.testing.assert_allclose(shown(found)[:, 0], expected, atol=1e-6)


def test_ranges_end_at_max_range_and_beyond_the_level():
    grid = level_from("......#\n.......")
    t = grid.tensors()
    lidar = np.array([0.05, -0.05, 0.0])
    scan = tensors.ranges(t, lidar, 0.0, [0.0, np.pi / 2, np.pi], 0.6)
    np.testing.assert_allclose(scan, [0.55, np.inf, np.inf])
    assert tensors.ranges(t, lidar, 0.0, [0.0], 0.5) == np.inf
    in_a_wall = np.array([0.65, -0.05, 0.0])
    np.testing.assert_array_equal(tensors.ranges(t, in_a_wall, 0.0, [0.0, np.pi], 5.0), [0, 0])
    assert np.isnan(tensors.ranges(t, np.array([-0.1, 0.0, 0.0]), 0.0, [0.0], 5.0)).all()
    assert np.isnan(tensors.ranges(t, lidar, 0.0, [np.nan, np.inf], 5.0)).all()
    with grid.block(disc=((0.25, -0.05, 0.0), 0.04)):
        np.testing.assert_allclose(tensors.ranges(grid.tensors(), lidar, 0.0, [0.0], 5.0), 0.15)


def test_ranges_of_an_inflated_grid_are_those_to_what_was_baked():
    grid = navbake.load(GOLDEN / "apartment.grid.json.gz")
    places = PathFinder(grid).random_point(np.random.default_rng(0), 50)
    yaw = np.zeros(50)
    angles = np.linspace(-3.0, 3.0, 13)
    scan = tensors.ranges(grid.tensors(), places, yaw, angles, 4.0)
    inflated_scan = tensors.ranges(grid.inflate(0.3).tensors(), places, yaw, angles, 4.0)
    np.testing.assert_array_equal(inflated_scan, scan)
    # a beam ends where the line of sight does
    finder = PathFinder(grid)
    for place, distances in zip(places, scan, strict=True):
        for angle, distance in zip(angles, np.minimum(distances, 4.0), strict=True):
            end = place + (distance - 1e-3) * np.array([np.cos(angle), np.sin(angle), 0.0])
            assert finder.line_of_sight(place, end)


def test_ranges_of_several_scenes():
    near, far = level_from("...#."), level_from(".....#")
    t = tensors.make_tensors([near, far])
    lidars = np.array([[0.05, -0.05, 0.0]] * 3)
    scan = tensors.ranges(t, lidars, np.zeros(3), [0.0], 5.0, scene_id=np.array([0, 1, 2]))
    np.testing.assert_allclose(scan[:, 0], [0.25, 0.45, np.nan])


@ON_ALL
@pytest.mark.parametrize("seed", range(3))
def test_samples_are_where_they_were_asked_for(case, seed):
    name, dtype = case
    xp, grid = library(name), grid_of(seed)
    finder, rng = PathFinder(grid), np.random.default_rng(seed)
    t = grid.tensors(xp, dtype=dtype)
    u = given(xp, np.nextafter(rng.random((500, 3)).astype(dtype), np.asarray(0, dtype)), dtype)
    draw = compiled(xp, lambda u: tensors.sample(t, u))
    drawn = shown(draw(u)).astype(np.float64)
    assert finder.is_navigable(drawn).all()
    starts = given(xp, finder.random_point(rng, 500), dtype)
    draw_near = compiled(xp, lambda u, starts: tensors.sample(t, u, reachable_from=starts))
    ask_island = compiled(xp, lambda p: tensors.island(t, p))
    drawn = draw_near(u, starts)
    np.testing.assert_array_equal(shown(ask_island(drawn)), shown(ask_island(starts)))
    draw_wide = compiled(xp, lambda u: tensors.sample(t, u, min_clearance=0.15))
    ask_clearance = compiled(xp, lambda p: tensors.clearance(t, p, mode="nearest"))
    cleared = shown(ask_clearance(draw_wide(u)))
    expected = shown(t.clearance).max() >= 0.15
    assert (cleared >= 0.15).all() if expected else np.isnan(cleared).all()


def test_samples_cover_the_free_cells_evenly_and_no_others():
    grid = level_from("..#.\n....\n#...")
    t = grid.tensors()
    num = int(grid.free.sum())
    u = np.full((num, 1), 0.0)
    u[:, 0] = (np.arange(num) + 0.5) / num
    cells = grid.cells_at(tensors.sample(t, u))
    assert sorted(zip(cells.row, cells.col, strict=True)) == [
        tuple(v) for v in np.argwhere(grid.free)
    ]
    ends = tensors.sample(t, np.array([[0.0, 0.0, 0.0], [1 - 1e-16, 1 - 1e-16, 1 - 1e-16]]))
    assert grid.cells_at(ends).col.tolist() == [0, 3]


def test_samples_of_a_room_that_is_not_there_are_not_of_another_island_or_scene():
    grid = level_from("..#..\n..#..\n..#..")
    grid.attributes["roomIndex"] = np.array([[1, 1, 0, 2, 2]] * 3, dtype=np.uint16)
    t = tensors.make_tensors([grid, grid])
    u = np.full((5, 1), 0.5)
    drawn = tensors.sample(t, u, room=[1, 2, 3, -1, 4], scene_id=0)
    assert np.isnan(drawn[:, 0]).tolist() == [False, False, True, True, True]
    left = np.array([0.05, -0.05, 0.0])
    drawn = tensors.sample(t, u, room=[1, 2, 3, -1, 4], scene_id=0, reachable_from=left)
    assert np.isnan(drawn[:, 0]).tolist() == [False, True, True, True, True]
    assert np.isnan(tensors.sample(t, u, room=3, scene_id=0)).all()


def test_where_no_place_is_samples_are_nan():
    grid = level_from("..#.\n..#.\n..#.")
    t = grid.tensors()
    u = np.random.default_rng(0).random((7, 3))
    assert np.isnan(tensors.sample(t, u, room=1)).all()
    assert np.isnan(tensors.sample(t, u, min_clearance=5.0)).all()
    beside = np.array([9.0, 9.0, 0.0])
    assert np.isnan(tensors.sample(t, u, reachable_from=beside)).all()
    nobody = level_from("###").tensors()
    assert np.isnan(tensors.sample(nobody, u)).all()
    bad = [[np.nan, 0.5, 0.5], [0.5, np.nan, 0.5], [0.5, 0.5, np.nan]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(tensors.sample(t, np.array(bad))).all()


@ON_ALL
def test_many_scenes_at_once(case):
    name, dtype = case
    xp, grids = library(name), [grid_of(seed) for seed in (0, 1, 2)]
    rng = np.random.default_rng(0)
    goals = [[PathFinder(g).random_point(rng)] for g in grids]
    t = tensors.make_tensors(grids, xp, dtype=dtype, goals=goals)
    scene = np.repeat([2, 0, 1], 400)
    positions = np.concatenate([positions_over(grids[k], rng, 400, dtype) for k in (2, 0, 1)])
    p, ids = given(xp, positions, dtype), xp.asarray(scene)
    found = shown(compiled(xp, lambda p, ids: tensors.distances(t, p, scene_id=ids))(p, ids))
    ask = compiled(xp, lambda p, ids: tensors.distance_to_goal(t, p, 0, ids))
    np.testing.assert_array_equal(found[:, 0], shown(ask(p, ids)))
    # each grid alone, in numpy
    alone = [g.tensors(dtype=dtype, goals=own) for g, own in zip(grids, goals, strict=True)]
    for function in (
        tensors.level_at, tensors.floor, tensors.room, tensors.is_navigable, tensors.clearance,
    ):  # fmt: skip
        ask = compiled(xp, lambda p, ids, ask=function: ask(t, p, scene_id=ids))
        found = shown(ask(p, ids))
        for k, single in enumerate(alone):
            here = scene == k
            expected = function(single, positions[here].astype(dtype))
            np.testing.assert_allclose(found[here], expected, rtol=0, atol=1e-6)
    for k in range(3):  # one number for all
        own = given(xp, positions[scene == k], dtype)
        floors = compiled(xp, lambda p, k=k: tensors.floor(t, p, scene_id=k))(own)
        expected = tensors.floor(alone[k], positions[scene == k].astype(dtype))
        np.testing.assert_array_equal(shown(floors), expected)
    ask = compiled(xp, lambda p: tensors.distance_to_goal(t, p, 0, scene_id=ids))
    ask_step = compiled(xp, lambda p: tensors.path_step(t, p, 0, scene_id=ids))
    found, steps = shown(ask(p)), shown(ask_step(p))
    for k, single in enumerate(alone):
        own = positions[scene == k].astype(dtype)
        np.testing.assert_array_equal(found[scene == k], tensors.distance_to_goal(single, own))
        expected = tensors.path_step(single, own)
        np.testing.assert_allclose(steps[scene == k], expected, atol=1e-5)
    u = given(xp, rng.random((1200, 3)), dtype)
    draw = compiled(xp, lambda u, ids: tensors.sample(t, u, scene_id=ids))
    is_free = compiled(xp, lambda p, ids: tensors.is_navigable(t, p, scene_id=ids))
    drawn = draw(u, ids)
    assert shown(is_free(drawn, ids)).all()
    draw_near = compiled(
        xp, lambda u, ids, starts: tensors.sample(t, u, scene_id=ids, reachable_from=starts)
    )
    assert shown(is_free(draw_near(u, ids, drawn), ids)).all()


@ON_ALL
def test_unknown_scenes_and_goals_are_nowhere(case):
    name, dtype = case
    xp, grid = library(name), level_from("...\n...")
    here = (0.05, -0.05, 0.0)
    t = tensors.make_tensors([grid] * 2, xp, dtype=dtype, goals=[[here, (0.25, -0.05, 0.0)]] * 2)
    p, ids = given(xp, [here] * 5, dtype), xp.asarray([0, 1, 2, -1, 99])
    known = [True, True, False, False, False]

    def ask_all(p, ids):
        return {
            "navigable": tensors.is_navigable(t, p, ids),
            "level": tensors.level_at(t, p, ids),
            "floor": tensors.floor(t, p, ids),
            "clearance": tensors.clearance(t, p, ids),
            "heights": tensors.heights(t, p, p[:, 0] * 0, p[:1, :2] * 0, ids),
            "drawn": tensors.sample(t, p[:, :1], scene_id=ids),
            "distance": tensors.distance_to_goal(t, p, ids, scene_id=0),
            "steps": tensors.path_step(t, p, ids, scene_id=0),
        }

    answers = {name: shown(answer) for name, answer in compiled(xp, ask_all)(p, ids).items()}
    assert answers["navigable"].tolist() == known
    assert (answers["level"] == 0).tolist() == known
    assert (~np.isnan(answers["floor"])).tolist() == known
    assert (~np.isnan(answers["clearance"])).tolist() == known
    assert (~np.isnan(answers["heights"][:, 0])).tolist() == known
    assert (~np.isnan(answers["drawn"][:, 0])).tolist() == known
    np.testing.assert_allclose(answers["distance"], [0.0, 0.2, np.nan, np.nan, np.nan], atol=1e-6)
    assert (~np.isnan(answers["steps"][:, 0])).tolist() == known


@ON_ALL
def test_numbers_are_taken_as_lists_and_as_numpys(case):
    name, dtype = case
    xp, grids = library(name), [level_from("...\n..."), level_from("...\n...", ground=1.0)]
    here = (0.05, -0.05, 1.5)
    t = tensors.make_tensors(grids, xp, dtype=dtype, goals=[[here, here]] * 2)
    for ids in ([0, 1], (0, 1), np.array([0, 1]), np.array([0, 1], dtype=np.int16)):

        def ask_of_two(ids=ids):
            return (
                tensors.floor(t, [here] * 2, ids),
                tensors.distance_to_goal(t, [here] * 2, ids, scene_id=1),
                tensors.sample(t, [[0.5]] * 2, room=np.array([0, 0]), scene_id=ids),
                tensors.heights(t, [here] * 2, [0.0, 0.0], [(0.0, 0.0)], ids),
            )

        floor, distance, drawn, scan = map(shown, compiled(xp, ask_of_two)())
        np.testing.assert_allclose(floor, [0.0, 1.0])
        assert (distance == 0).all()
        np.testing.assert_allclose(drawn[:, 2], [0.0, 1.0])
        np.testing.assert_allclose(scan, [[0.0], [1.0]])

    def ask_of_one():
        return (
            tensors.floor(t, here, np.int64(1)),
            tensors.distance_to_goal(t, here, np.int32(1), scene_id=np.int64(1)),
            tensors.sample(t, [[0.5]] * 2, reachable_from=here, scene_id=1),
            tensors.patch(t, here, np.float64(0.0), (1, 2), np.float64(0.1), scene_id=1),
        )

    floor, distance, drawn, patch = map(shown, compiled(xp, ask_of_one)())
    assert floor == 1.0
    assert distance == 0.0
    np.testing.assert_allclose(drawn[:, 2], 1.0)
    assert patch.all()


def test_everything_stays_on_the_tensors_device():
    torch = pytest.importorskip("torch")
    # arrays of this device have no numbers, and fail beside those of another
    t = tensors.make_tensors([grid_of(0), grid_of(1)], torch, device="meta", goals=[[], []])
    p = torch.zeros((4, 3), device="meta")
    asked = [
        tensors.level_at(t, p, 1),
        tensors.clearance(t, [[0.0, 0.0, 0.0]], [1]),
        tensors.heights(t, p, p[:, 0], [[0.0, 0.0]], [0, 1, 1, 0]),
        tensors.patch(t, p, p[:, 0], (2, 2), scene_id=1),
        tensors.sample(t, p, scene_id=1),
        tensors.sample(t, p, room=1, min_clearance=0.1, reachable_from=p, scene_id=[0, 1, 0, 1]),
        tensors.sample(grid_of(0).tensors(torch, device="meta"), p),
    ]
    assert {a.device.type for a in asked} == {"meta"}


@pytest.mark.parametrize("rise", [-1e-9, 0.0, 1e-9])
def test_floors_that_float32_cannot_tell_apart_are_told_apart(rise):
    grid = stack(level_of("000"), level_of("000"))
    for level, z in zip(grid.levels, (3.2, 3.2 + rise), strict=True):
        level.min_yup = (level.min_yup[0], z, level.min_yup[2])
        del level.attributes["floorHeight"]
    p = np.array([[0.05, -0.05, 3.3]], dtype=np.float32)
    expected = PathFinder(grid).cell_at(p[0].astype(float)).level
    assert expected == int(rise > 0)
    assert tensors.level_at(grid.tensors(dtype="float32"), p) == expected


def test_arrays_are_shared_by_dlpack():
    t = grid_of(0).tensors()
    np.testing.assert_array_equal(np.from_dlpack(t.floor), t.floor)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (
            lambda t: tensors.floor(t, np.zeros(2)),
            r"positions of shape \(..., 3\) \[m\], got \(2,\)",
        ),
        (lambda t: tensors.floor(t, np.zeros(3, np.float32)), "an array of float64, .* float32"),
        (lambda t: tensors.floor(t, np.zeros(3), scene_id=1), "no scene 1: expected 0 to 0"),
        (lambda t: tensors.clearance(t, np.zeros(3), mode="cubic"), "a mode of nearest, bilinear"),
        (lambda t: tensors.distance_to_goal(t, np.zeros(3)), "the tensors know no goals"),
        (lambda t: tensors.distances(t, np.zeros(3)), "the tensors know no goals"),
        (lambda t: tensors.heights(t, np.zeros((4, 3)), np.zeros(3), np.zeros((1, 2))), "a yaw of"),
        (lambda t: tensors.heights(t, np.zeros(3), np.zeros(()), np.zeros(2)), "a pattern of"),
        (lambda t: tensors.patch(t, np.zeros(3), np.zeros(()), layer="smell"), "no layer 'smell'"),
        (lambda t: tensors.patch(t, np.zeros(3), np.zeros(()), (0, 4)), "rows, columns and a cell"),
        (lambda t: tensors.patch(t, np.zeros(3), np.zeros(()), 64), r"a shape \(rows, columns\)"),
        (lambda t: tensors.patch(t, np.zeros(3), np.zeros(()), (1, 1), np.inf), "a cell > 0"),
        (lambda t: tensors.ranges(t, np.zeros(3), 0.0, 0.5, 5.0), r"angles of shape \(k,\)"),
        (lambda t: tensors.ranges(t, np.zeros(3), [0.0], [0.5], 5.0), r"a yaw of shape \(\)"),
        (lambda t: tensors.ranges(t, np.zeros(3), 0.0, [0.5], np.inf), "a max_range > 0, one num"),
        (lambda t: tensors.ranges(t, np.zeros(3), 0.0, [0.5], [5.0]), "a max_range > 0, one num"),
        (lambda t: tensors.sample(t, np.zeros((4, 2))), "u of shape"),
        (
            lambda t: tensors.sample(t, np.zeros((4, 3)), reachable_from=np.zeros((2, 3))),
            r"a reachable_from that fits the shape \(4,\), got one of shape \(2,\)",
        ),
        (
            lambda t: tensors.sample(t, np.zeros((4, 3)), room="hall"),
            "an integer or integers as room",
        ),
        (
            lambda t: tensors.sample(t, np.zeros((4, 3)), min_clearance=np.zeros(4)),
            "one number as min_clearance",
        ),
        (
            lambda t: tensors.floor(t, np.zeros((2, 3)), np.array([0.0, 0.9])),
            "an integer or integers as scene, got float64",
        ),
        (lambda t: tensors.floor(t, "here"), "expected numbers, got 'here'"),
    ],
)
def test_questions_that_cannot_be_answered(ask, message):
    with pytest.raises(QueryError, match=message):
        ask(level_from("...\n...").tensors())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"xp": "torch"}, "expected numpy, torch, jax.numpy or another module"),
        ({"dtype": "float16"}, 'a dtype "float32" or "float64", got \'float16\''),
        ({"device": "warp-drive"}, "on the device 'warp-drive'"),
        ({"goals": ["room:cellar"]}, "no room 'cellar'"),
        ({"max_drop": -1.0}, "max_drop"),
    ],
)
def test_tensors_that_cannot_be_made(options, message):
    with pytest.raises(QueryError, match=message):
        level_from("...\n...").tensors(**options)


def test_far_from_the_origin_float32_is_refused():
    grid = level_from("...\n...", x=5e6)
    with pytest.raises(QueryError, match=r"float32 can't tell cells of 0.1 m apart .* use float64"):
        grid.tensors(dtype="float32")
    assert tensors.is_navigable(grid.tensors(), np.array([5e6 + 0.05, -0.05, 0.0]))


def test_several_grids_need_a_scene_and_goals_for_each():
    grids = [level_from("..."), level_from("....")]
    with pytest.raises(QueryError, match=r"expected a scene_id, 0 to 1"):
        tensors.floor(tensors.make_tensors(grids), np.zeros(3))
    with pytest.raises(QueryError, match="a list of goals for each of 2 grids"):
        tensors.make_tensors(grids, goals=[[(0, 0, 0)]])
    with pytest.raises(QueryError, match="at least one grid"):
        tensors.make_tensors([])
    with pytest.raises(QueryError, match="a grid or several, got 5"):
        tensors.make_tensors(5)
    with pytest.raises(QueryError, match="expected grids"):
        tensors.make_tensors(["house.grid.json"])


def test_the_method_of_the_grid_is_in_the_public_package():
    assert navbake.tensors is tensors


def test_a_goal_that_no_cell_is_free_for_is_refused_with_the_reason():
    house = navbake.load(GOLDEN / "house.grid.json.gz")
    with pytest.raises(QueryError, match=r"goal 1 in 'house': .*lies beside the grid"):
        house.tensors(goals=["room:0:1", (99.0, 0.0, 0.0)])


def test_a_goal_moves_without_new_tensors():
    house = navbake.load(GOLDEN / "house.grid.json.gz")
    finder = navbake.PathFinder(house)
    points = finder.random_point(np.random.default_rng(1), 40)
    before = house.tensors(goals=[points[0]])
    moved = navbake.tensors.with_goals(before, [points[1], points[2]])
    fresh = house.tensors(goals=[points[1], points[2]])
    np.testing.assert_array_equal(
        tensors.distances(moved, points), tensors.distances(fresh, points)
    )
    assert moved.floor is before.floor and moved.goals == fresh.goals and "\n" not in repr(moved)
    with pytest.raises(QueryError, match="lies beside the grid"):
        navbake.tensors.with_goals(before, [(99.0, 0.0, 0.0)])
