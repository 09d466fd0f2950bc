"""Solids told by their shape, against the iteration that knows nothing of shapes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import Generator

from kernel_parts import callable_part
from navbake.baker.core.arrays import Prism, Solids
from navbake.baker.core.constants import (
    APART,
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    MEETS,
    SPHERE,
)
from navbake.baker.geometry.gjk_kernels import allocate_simplex, gjk_meets_prism
from navbake.baker.geometry.solid_kernels import solid_meets_prism

# parts of kernels as functions that Python can call
allocate_simplex = callable_part(allocate_simplex)
gjk_meets_prism = callable_part(gjk_meets_prism)
solid_meets_prism = callable_part(solid_meets_prism)

SIMPLEX = allocate_simplex()
KINDS = {"sphere": SPHERE, "capsule": CAPSULE, "cylinder": CYLINDER, "box": BOX}
KINDS["ellipsoid"] = ELLIPSOID


def random_matrix(rng: Generator) -> np.ndarray:
    """Upright, lying on a side, or anyhow."""
    turn = np.eye(3)[rng.permutation(3)] if rng.random() < 0.5 else np.eye(3)
    angle = rng.uniform(0, 2 * np.pi)
    yaw = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    if rng.random() < 0.3:
        return np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.array(yaw) @ turn


def bounds_of(kind, pos, mat, size):
    """A box around a solid; loose ones only cost time."""
    if kind == BOX:
        reach = np.abs(mat) @ size
    elif kind == CYLINDER:
        reach = np.sqrt(1 - np.minimum(mat[:, 2] ** 2, 1)) * size[0] + abs(mat[:, 2]) * size[1]
    elif kind == CAPSULE:
        reach = abs(mat[:, 2]) * size[1] + size[0]
    else:
        reach = np.sqrt((mat**2) @ (size**2)) if kind == ELLIPSOID else np.full(3, size[0])
    return np.concatenate([pos - reach, pos + reach])


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("is_round", [False, True])
def test_agrees_with_the_iteration(name, is_round):
    kind, rng = KINDS[name], np.random.default_rng(len(name) + is_round)
    seen = set()
    for _ in range(1500):
        pos, size = rng.uniform(-1.2, 1.2, 3), rng.uniform(0.05, 1.0, 3)
        mat = np.ascontiguousarray(random_matrix(rng))
        half, half_z = rng.uniform(0.02, 0.6, 2)
        solids = Solids(
            np.zeros(1, np.int32), np.array([kind], np.int32), pos[None], mat.reshape(1, 9),
            size[None], bounds_of(kind, pos, mat, size)[None],
        )  # fmt: skip
        prism = Prism(0.0, 0.0, -half_z, half_z, half, is_round)
        found = solid_meets_prism(solids, 0, prism, SIMPLEX)
        expected = gjk_meets_prism(solids, 0, prism, SIMPLEX)
        assert found == expected, (pos, mat, size, half, half_z)
        seen.add(expected)
    assert seen == {APART, MEETS}
