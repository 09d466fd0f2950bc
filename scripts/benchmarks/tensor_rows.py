"""Rows of `navbake.tensors`, on a grid of the main house, in numpy, PyTorch and JAX."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

import navbake
from benchmarks.measure import Job, Row, Sample, here
from benchmarks.run_rows import House, house_of
from benchmarks.scenes import Scenes

COUNT = 1_000_000
AGENTS, POINTS = 4096, 187  # a batch of environments, and the height scan that walkers use
CAST = 32  # agents whose rays are cast; all others are taken to cost as much
SEE_ABOVE = 0.6  # metres above an agent at which the rays begin


def make_rows(scenes: Scenes) -> dict[str, Callable[[], Row]]:
    """The rows by name, each made when it is asked for."""
    return {
        "tensors": lambda: navigable_row(house_of(scenes)),
        "tensor-heights": lambda: heights_row(house_of(scenes), scenes),
    }


def navigable_row(house: House) -> Row:
    """A million `is_navigable`, as arrays of each library that is installed."""
    level = house.grid.levels[0]
    x0, y0, x1, y1 = level.lattice.bounds
    low, high = (x0, y0, level.ground), (x1, y1, level.ground + 0.6)
    positions = np.random.default_rng(0).uniform(low, high, size=(COUNT, 3)).astype(np.float32)
    jobs = []
    for name, xp, compiled in libraries():
        t = house.grid.tensors(xp, dtype="float32")
        p = xp.asarray(positions)
        ask = compiled(lambda p, t=t: navbake.tensors.is_navigable(t, p))
        jobs.append(here(f"{name}: a million is_navigable", finished(lambda a=ask, p=p: a(p))))
    finder = navbake.PathFinder(house.grid)
    exact = positions.astype(np.float64)
    peer = here("PathFinder.are_navigable", lambda: finder.are_navigable(exact))
    return Row(jobs[0], [peer, *jobs[1:]], limit=0.02, missing=missing(jobs))


def heights_row(house: House, scenes: Scenes) -> Row:
    """Height scans of many agents at once, and MuJoCo's rays for the same points."""
    finder = navbake.PathFinder(house.grid)
    rng = np.random.default_rng(0)
    agents = finder.random_point(rng, AGENTS).astype(np.float32)
    yaw = rng.uniform(-np.pi, np.pi, AGENTS).astype(np.float32)
    ahead, left = np.meshgrid(np.linspace(-0.8, 0.8, 17), np.linspace(-0.5, 0.5, 11))
    pattern = np.stack([ahead.ravel(), left.ravel()], axis=1).astype(np.float32)
    assert len(pattern) == POINTS
    jobs = []
    for name, xp, compiled in libraries():
        t = house.grid.tensors(xp, dtype="float32")
        given = [xp.asarray(v) for v in (agents, yaw, pattern)]
        ask = compiled(lambda *v, t=t: navbake.tensors.heights(t, *v))
        job = finished(lambda a=ask, v=given: a(*v))
        jobs.append(here(f"{name}: {AGENTS:,} × {POINTS} heights", job))
    model = mujoco.MjModel.from_xml_path(str(scenes.main))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    few = slice(0, AGENTS, AGENTS // CAST)
    points = turned(agents[few], yaw[few], pattern)
    peer = Job("mj_multiRay, a ray a point, extrapolated", lambda: cast_all(model, data, points))
    return Row(jobs[0], [peer, *jobs[1:]], limit=0.025, missing=missing(jobs))


def turned(agents: np.ndarray, yaw: np.ndarray, pattern: np.ndarray) -> np.ndarray:
    """Where the rays begin, world [m], shape (agents * points, 3), float64."""
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x = agents[:, :1] + cos * pattern[:, 0] - sin * pattern[:, 1]
    y = agents[:, 1:2] + sin * pattern[:, 0] + cos * pattern[:, 1]
    z = np.broadcast_to(agents[:, 2:] + SEE_ABOVE, x.shape)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float64)


def cast_all(model: Any, data: Any, points: np.ndarray) -> Sample:
    """Find the height under each point by MuJoCo, whose rays of one call share their origin."""
    down = np.array([0.0, 0.0, -1.0])
    geom, distance, normal = np.zeros(1, np.int32), np.zeros(1), np.zeros(3)
    heights = np.empty(len(points))
    begin = time.perf_counter()
    for number, point in enumerate(points):
        mujoco.mj_multiRay(
            model, data, point, down, None, 1, -1, geom, distance, normal, 1, mujoco.mjMAXVAL
        )
        heights[number] = point[2] - distance[0]
    seconds = time.perf_counter() - begin
    return Sample(seconds * AGENTS / CAST, None, {"from agents": CAST})


def libraries() -> list[tuple[str, Any, Callable[[Any], Any]]]:
    """Name, module and compiler of numpy and of what is installed besides."""
    found: list[tuple[str, Any, Callable[[Any], Any]]] = [("numpy", np, lambda f: f)]
    try:
        import torch
    except ImportError:
        pass
    else:
        found.append(("torch", torch, lambda f: f))
    try:
        import jax
    except ImportError:
        pass
    else:
        found.append(("jax, jitted", jax.numpy, jax.jit))
    return found


def finished(ask: Callable[[], Any]) -> Callable[[], Any]:
    """The same question, waiting for the answer where a library computes behind one's back."""
    return lambda: np.asarray(ask())


def missing(jobs: list[Job]) -> str:
    """What is said where a library isn't there."""
    return "" if len(jobs) == 3 else "torch or jax is not installed: pip install torch jax"
