"""Poses from which bases reach things are drawn and tested as PathFinder does, on every library."""

from __future__ import annotations

import math

import numpy as np
import pytest

import navbake
from grid_maps import level_from
from level_maps import stairs
from navbake import tensors
from navbake.errors import QueryError
from navbake.runtime.path_finder import PathFinder
from tensors.libraries import ON_ALL, compiled, given, library, positions_over, shown

pytest.importorskip("array_api_compat")

REACH = (0.1, 0.6)
TARGETS = (["object:box", "category:cup"], ["category:cup", "object:box"])


def room(shift=0.0):
    """A room with a box and two cups, which share cells from which they are reached."""
    grid = level_from("\n".join(["." * 16] * 12))
    grid.occupancy[3:5, 3:6] = 1
    grid.weights[3:5, 3:6] = np.inf
    box = {row * 16 + col: {"objects": ["box"]} for row in (3, 4) for col in (3, 4, 5)}
    cups = {8 * 16 + 9: {"objects": ["cup_1"]}, 8 * 16 + 12: {"objects": ["cup_2"]}}
    grid.user_data = box | cups
    x, y, z = grid.min_yup
    grid.min_yup = (x + shift, y, z)
    grid.metadata["sceneId"] = f"room at {shift:g}"
    return grid


def poses_over(grid, finder, rng, dtype):
    """Poses all over a grid; half of them reach something, or would if they weren't turned."""
    positions = positions_over(grid, rng, 2000, dtype)
    yaw = rng.uniform(-7.0, 7.0, 2000)
    poses = finder.stand_poses(TARGETS[0], reach=REACH, count=None)
    pose_index = rng.integers(len(poses), size=1000)
    positions[:1000] = poses.positions[pose_index].astype(dtype)
    yaw[:1000] = poses.headings[pose_index] + rng.uniform(-0.8, 0.8, 1000)
    return positions, yaw.astype(dtype).astype(np.float64)


@ON_ALL
def test_poses_reach_what_the_run_time_says_and_those_drawn_do(case):
    name, dtype = case
    xp, grids = library(name), [room(), room(20.0)]
    finders = [PathFinder(grid) for grid in grids]
    rng = np.random.default_rng(0)
    t = tensors.with_stands(tensors.make_tensors(grids, xp, dtype=dtype), TARGETS, reach=REACH)
    assert t.targets == ("object:box", "category:cup") and "targets" in repr(t)
    draw = compiled(xp, lambda u, target, ids: tensors.sample_stand(t, u, target, ids))
    test = compiled(xp, lambda p, yaw, target, ids: tensors.can_reach(t, p, yaw, target, ids))
    test_any = compiled(xp, lambda p, yaw: tensors.can_reach(t, p, yaw, 1, 0, tolerance=None))
    scenes = np.repeat([0, 1], 2000)
    numbers = rng.integers(2, size=4000)
    over = [poses_over(g, finder, rng, dtype) for g, finder in zip(grids, finders, strict=True)]
    positions, yaw = map(np.concatenate, zip(*over, strict=True))
    p, a = given(xp, positions, dtype), given(xp, yaw, dtype)
    reaches = shown(test(p, a, xp.asarray(numbers), xp.asarray(scenes)))
    u = given(xp, rng.random(4000), dtype)
    drawn, drawn_yaw = map(shown, draw(u, xp.asarray(numbers), xp.asarray(scenes)))
    for scene, finder in enumerate(finders):
        for number in range(2):
            target = TARGETS[scene][number]
            is_of = (scenes == scene) & (numbers == number)
            expected = finder.can_reach(target, positions[is_of], yaw[is_of], reach=REACH)
            np.testing.assert_array_equal(reaches[is_of], expected)
            assert 0.05 < expected.mean() < 0.9
            here = drawn[is_of].astype(np.float64)
            assert finder.can_reach(
                target, here, drawn_yaw[is_of].astype(np.float64), reach=REACH, tolerance=1e-5
            ).all()
            poses = finder.stand_poses(target, reach=REACH, count=None)
            assert len(np.unique(here, axis=0)) > 0.8 * len(np.unique(poses.positions, axis=0))
    in_scene = scenes == 0
    expected = finders[0].can_reach(
        "category:cup", positions[in_scene], yaw[in_scene], reach=REACH, tolerance=None
    )
    found = test_any(given(xp, positions[in_scene], dtype), given(xp, yaw[in_scene], dtype))
    np.testing.assert_array_equal(shown(found), expected)


@ON_ALL
def test_unknown_targets_and_scenes_have_no_poses(case):
    name, dtype = case
    xp, grid = library(name), room()
    t = tensors.with_stands(grid.tensors(xp, dtype=dtype), ["object:box"], reach=REACH)
    numbers = xp.asarray([0, 1, -1])
    draw = compiled(xp, lambda u, target: tensors.sample_stand(t, u, target))
    test = compiled(xp, lambda p, yaw, target: tensors.can_reach(t, p, yaw, target))
    positions, yaw = draw(given(xp, [0.5, 0.5, 0.5], dtype), numbers)
    assert np.isnan(shown(positions)[:, 0]).tolist() == [False, True, True]
    assert np.isnan(shown(yaw)).tolist() == [False, True, True]
    known = test(xp.stack([positions[0, ...]] * 3), xp.stack([yaw[0]] * 3), numbers)
    assert shown(known).tolist() == [True, False, False]
    draw = compiled(xp, lambda u: tensors.sample_stand(t, u))
    positions, _ = draw(given(xp, [0.0, np.nan, 1.0 - 1e-7], dtype))
    assert np.isnan(shown(positions)[:, 0]).tolist() == [False, True, False]
    test = compiled(xp, lambda p, yaw: tensors.can_reach(t, p, yaw))
    assert not shown(test(positions[1:2, ...], yaw[:1])).any()


def test_jax_draws_for_each_environment_and_takes_tensors_as_an_argument():
    jax = pytest.importorskip("jax")
    grid = room()
    t = tensors.with_stands(grid.tensors(jax.numpy), ["object:box", "category:cup"], reach=REACH)

    @jax.jit
    def reset(t, key, target):
        positions, yaw = tensors.sample_stand(t, jax.random.uniform(key), target)
        return positions, yaw, tensors.can_reach(t, positions, yaw, target)

    keys = jax.random.split(jax.random.key(0), 64)
    numbers = jax.numpy.arange(64) % 2
    positions, yaw, reaches = jax.vmap(reset, (None, 0, 0))(t, keys, numbers)
    assert positions.shape == (64, 3) and yaw.shape == (64,) and bool(reaches.all())
    assert len(np.unique(np.asarray(positions), axis=0)) > 20


def test_footprints_goals_and_storeys_go_along():
    grid = stairs("##00", "0000", "0000", "0000", "00##")
    finder = PathFinder(grid)
    goal = finder.random_point(np.random.default_rng(0), level=1)
    t = tensors.with_stands(grid.tensors(goals=[goal]), [goal], reach=(0.0, 0.6), sight=False)
    positions, yaw = tensors.sample_stand(t, np.linspace(0, 1, 50, endpoint=False))
    np.testing.assert_array_equal(tensors.level_at(t, positions), np.ones(50))
    assert finder.can_reach(goal, positions, yaw, reach=(0.0, 0.6), sight=False).all()
    assert np.isfinite(tensors.distance_to_goal(t, positions)).any()
    moved = tensors.with_goals(t, [goal])
    assert tensors.can_reach(moved, positions, yaw).all()
    base = [(0.25, 0.1), (-0.1, 0.1), (-0.1, -0.1), (0.25, -0.1)]
    wide = tensors.with_stands(room().tensors(), ["object:box"], reach=REACH, footprint=base)
    poses = PathFinder(room()).stand_poses("object:box", reach=REACH, footprint=base, count=None)
    np.testing.assert_array_equal(wide.stand_yaw, poses.headings)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda t: tensors.sample_stand(t, [0.5]), "the tensors know no targets: with_stands"),
        (lambda t: tensors.with_stands(t, "object:box"), r"write targets=\['object:box'\]"),
        (lambda t: tensors.with_stands(t, ["object:bax"]), "no object 'bax' in 'room at 0'"),
        (
            lambda t: tensors.with_stands(t, ["object:box"], reach=(0.0, 0.01)),
            "no pose reaches target 0 in 'room at 0': no cell at 0 to 0.01 m from box",
        ),
        (
            lambda t: tensors.can_reach(
                tensors.with_stands(t, ["object:box"]), [(0.0, 0.0, 0.0)], [0.0, 0.0]
            ),
            r"expected a yaw of shape \(1,\), one for each position, got \(2,\)",
        ),
        (
            lambda t: tensors.sample_stand(tensors.with_stands(t, ["object:box"]), [0.5], 1),
            "no target 1: expected 0 to 0",
        ),
    ],
)
def test_what_is_wrong_is_one_clear_line(ask, message):
    with pytest.raises(QueryError, match=message):
        ask(room().tensors())


def test_targets_are_named_for_each_of_several_grids():
    t = tensors.make_tensors([room(), room(20.0)])
    with pytest.raises(
        QueryError, match=r"expected as many targets for each of 2 grids, got \[1, 2\]"
    ):
        tensors.with_stands(t, [["object:box"], ["object:box", "category:cup"]])
    assert math.isnan(
        tensors.sample_stand(tensors.with_stands(t, TARGETS, reach=REACH), [0.5], 0, [2])[1][0]
    )
    assert navbake.tensors.with_stands is tensors.with_stands
