"""Tensors inside what JAX and PyTorch make of functions: compiled, batched, differentiated."""

from __future__ import annotations

import numpy as np
import pytest

from grid_maps import random_house
from navbake import tensors
from navbake.runtime.path_finder import PathFinder
from tensors.libraries import positions_over

pytest.importorskip("array_api_compat")


@pytest.fixture(scope="module")
def house():
    return random_house(np.random.default_rng(2), num_levels=2)


@pytest.fixture(scope="module")
def positions(house):
    return positions_over(house, np.random.default_rng(0), 500, "float32").astype(np.float32)


def questions(t):
    """The functions of positions alone."""
    turned = {"yaw": t.xp.asarray(0.3, dtype=t.dtype)}
    pattern = t.xp.asarray([[0.1, 0.0], [0.0, 0.2]], dtype=t.dtype)
    return {
        "level_at": lambda p: tensors.level_at(t, p),
        "floor": lambda p: tensors.floor(t, p),
        "room": lambda p: tensors.room(t, p),
        "is_navigable": lambda p: tensors.is_navigable(t, p),
        "clearance": lambda p: tensors.clearance(t, p),
        "distance_to_goal": lambda p: tensors.distance_to_goal(t, p),
        "path_step": lambda p: tensors.path_step(t, p),
        "heights": lambda p: tensors.heights(t, p, pattern=pattern, **turned),
        "ranges": lambda p: tensors.ranges(t, p, angles=pattern[:, 1], max_range=0.5, **turned),
        "patch": lambda p: tensors.patch(t, p, shape=(2, 3), **turned),
    }


def goals_of(grid):
    return [PathFinder(grid).random_point(np.random.default_rng(0))]


def test_jax_compiles_and_batches(house, positions):
    jax = pytest.importorskip("jax")
    t = house.tensors(jax.numpy, goals=goals_of(house))
    positions = positions[:150]
    p = jax.numpy.asarray(positions)
    in_numpy = questions(house.tensors(dtype="float32", goals=goals_of(house)))
    for name, ask in questions(t).items():
        # numpy takes one position a time, since a yaw is as many as positions
        expected = np.stack([in_numpy[name](one) for one in positions])
        ask_one = jax.jit(ask)
        one_by_one = np.stack([np.asarray(ask_one(one)) for one in p[:20]])
        np.testing.assert_allclose(one_by_one, expected[:20], atol=1e-5, err_msg=name)
        batched = jax.jit(jax.vmap(ask))(p)
        np.testing.assert_allclose(batched, expected, atol=1e-5, err_msg=name)
    # not compiled, operations are compiled one by one: slow, so one question stands for all
    floors = jax.vmap(questions(t)["floor"])(p)
    np.testing.assert_array_equal(floors, np.stack([in_numpy["floor"](one) for one in positions]))


def test_jax_takes_tensors_as_an_argument(house, positions):
    jax = pytest.importorskip("jax")
    t = house.tensors(jax.numpy)
    again = house.tensors(jax.numpy)
    assert jax.tree_util.tree_structure(t) == jax.tree_util.tree_structure(again)
    u = jax.numpy.asarray(np.random.default_rng(0).random((50, 3), dtype=np.float32))
    draw = jax.jit(lambda t, u: tensors.sample(t, u, min_clearance=0.05))
    in_numpy = tensors.sample(house.tensors(dtype="float32"), np.asarray(u), min_clearance=0.05)
    np.testing.assert_allclose(draw(t, u), in_numpy, atol=1e-5)
    np.testing.assert_array_equal(draw(again, u), draw(t, u))


def differences(ask, p, step=1e-3):
    """Central differences of a function of positions by x and y."""
    found = np.zeros((len(p), 2))
    for axis in range(2):
        low, high = p.copy(), p.copy()
        low[:, axis] -= step
        high[:, axis] += step
        found[:, axis] = (ask(high) - ask(low)) / (2 * step)
    return found


def smooth(grid, p, step=2e-3):
    """Positions whose surroundings lie between the same four centres, in the grid."""
    lattice = grid.levels[0].lattice
    cells = (
        np.stack([p[:, 0] - lattice.x_min, lattice.y_max - p[:, 1]], axis=-1) / lattice.cell_size
    )
    to_line = np.abs((cells - 0.5) - np.round(cells - 0.5)) * lattice.cell_size
    to_edge = np.abs(cells - np.round(cells)) * lattice.cell_size
    t = grid.tensors()
    return (to_line > step).all(-1) & (to_edge > step).all(-1) & ~np.isnan(tensors.clearance(t, p))


def test_gradients_of_clearance_are_those_of_differences():
    grid = random_house(np.random.default_rng(1), num_levels=1, steps=False)
    p = positions_over(grid, np.random.default_rng(1), 4000)
    p[:, 2] = 0.1
    p = p[smooth(grid, p)]
    assert len(p) > 300
    expected = differences(lambda q: tensors.clearance(grid.tensors(), q), p)
    checked = 0
    for name in ("jax", "torch"):
        try:
            module = __import__(name)
        except ImportError:
            continue
        if name == "jax":
            t, q = grid.tensors(module.numpy), module.numpy.asarray(p.astype(np.float32))
            slope = module.grad(lambda one, t=t: tensors.clearance(t, one))
            found = module.jit(module.vmap(slope))(q)
        else:
            t, q = grid.tensors(module), module.tensor(p.astype(np.float32), requires_grad=True)
            tensors.clearance(t, q).sum().backward()
            found = q.grad
        np.testing.assert_allclose(np.asarray(found)[:, :2], expected, atol=2e-4)
        checked += 1
    if not checked:
        pytest.skip("neither jax nor torch is installed")


def test_torch_batches(house, positions):
    torch = pytest.importorskip("torch")
    t = house.tensors(torch, goals=goals_of(house))
    p = torch.asarray(positions)
    for name, ask in questions(t).items():
        one_by_one = torch.stack([ask(one) for one in p[:20]])
        torch.testing.assert_close(torch.vmap(ask)(p)[:20], one_by_one, equal_nan=True, msg=name)


def test_torch_compiles(house, positions):
    torch = pytest.importorskip("torch")
    t = house.tensors(torch, goals=goals_of(house))
    p = torch.asarray(positions)
    for name, ask in questions(t).items():
        torch.compiler.reset()
        # `aot_eager` traces as the default does, and needs no C++ compiler
        compiled = torch.compile(torch.vmap(ask), fullgraph=True, backend="aot_eager")
        torch.testing.assert_close(compiled(p), torch.vmap(ask)(p), equal_nan=True, msg=name)
    u = torch.rand((50, 3), generator=torch.Generator().manual_seed(0))
    draw = torch.compile(lambda u: tensors.sample(t, u, reachable_from=p[0]), backend="aot_eager")
    torch.testing.assert_close(draw(u), tensors.sample(t, u, reachable_from=p[0]), equal_nan=True)


def test_gradients_stay_finite_beside_the_grid(house):
    torch = pytest.importorskip("torch")
    p = torch.tensor([[99.0, 99.0, 0.0], [float("nan"), 0.0, 0.0]], requires_grad=True)
    value = tensors.clearance(house.tensors(torch), p)
    value.nansum().backward()
    assert torch.isfinite(p.grad).all()
