"""The array libraries that tests of tensors run on: those that are installed, in both dtypes."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

import numpy as np
import pytest

LIBRARIES = ("numpy", "array_api_strict", "torch", "jax.numpy")


def library(name):
    """The module of a library; the test is skipped where it isn't installed."""
    pytest.importorskip("array_api_compat")
    pytest.importorskip(name.split(".")[0])
    return import_module(name)


def compiled(xp, function):
    """A function as it is; of JAX, which compiles each operation for each shape, as a whole."""
    if xp.__name__ != "jax.numpy":
        return function
    return import_module("jax").jit(function)


def cases():
    """Library and dtype, by name."""
    for name in LIBRARIES:
        for dtype in ("float32", "float64"):
            if name == "jax.numpy" and dtype == "float64":
                continue  # JAX has none unless the whole process is told so
            missing = find_spec(name.split(".")[0]) is None
            marks = pytest.mark.skipif(missing, reason=f"{name} is not installed")
            yield pytest.param((name, dtype), marks=marks, id=f"{name}-{dtype}")


ON_ALL = pytest.mark.parametrize("case", list(cases()))


def positions_over(grid, rng, count, dtype="float64"):
    """Positions in and beside a grid, many of them on or next to the edges of cells and floors.

    World [m], shape (count, 3), float64, of numbers that the dtype holds exactly.
    """
    lattices = [level.lattice for level in grid.levels]
    low = np.array(
        [min(v.x_min for v in lattices), min(v.y_max - v.height * v.cell_size for v in lattices)]
    )
    high = np.array(
        [max(v.x_min + v.width * v.cell_size for v in lattices), max(v.y_max for v in lattices)]
    )
    floors = np.concatenate([v.floor_height[np.isfinite(v.floor_height)] for v in grid.levels])
    grounds = [v.ground for v in grid.levels]
    z_low, z_high = min(*floors, *grounds, 0.0) - 1, max(*floors, *grounds, 0.0) + 2
    p = rng.uniform([*(low - 0.3), z_low], [*(high + 0.3), z_high], size=(count, 3))
    lattice = lattices[int(rng.integers(len(lattices)))]
    edges = rng.integers(-1, lattice.width + 2, size=count) * lattice.cell_size + lattice.x_min
    p[::3, 0] = edges[::3]
    edges = lattice.y_max - rng.integers(-1, lattice.height + 2, size=count) * lattice.cell_size
    p[1::3, 1] = edges[1::3]
    if len(floors):
        offsets = rng.choice([0.0, 0.5, -grid.max_step, -grid.max_step - 1e-6], size=count)
        p[::2, 2] = (rng.choice(floors, size=count) + offsets)[::2]
    p = p.astype(dtype)
    for way in (-np.inf, np.inf):
        chosen = rng.random(p.shape) < 0.1
        p[chosen] = np.nextafter(p, np.asarray(way, dtype=dtype))[chosen]
    return p.astype(np.float64)


def given(xp, values, dtype):
    """Numbers as an array of a library."""
    return xp.asarray(np.asarray(values, dtype=dtype))


def shown(array):
    """An array of any library as numpy's."""
    return np.asarray(array)
