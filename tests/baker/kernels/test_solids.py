"""Solids told by their shape, against the iteration that knows nothing of shapes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import Generator

from navbake.baker.kernels.overlap import (
    APART,
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    MEETS,
    SPHERE,
    solid_meets_prism,
)
from navbake.baker.kernels.solids import solid_part

SCRATCH = (np.empty((4, 3)), np.empty(4, bool), np.empty(4, bool), np.empty(3), np.empty(3))
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
        solids = (
            np.array([kind]), pos[None], mat.reshape(1, 9), size[None],
            bounds_of(kind, pos, mat, size)[None],
        )  # fmt: skip
        found = solid_part(0, solids, 0.0, 0.0, -half_z, half_z, half, is_round, SCRATCH)
        expected = solid_meets_prism(
            kind, pos, mat.ravel(), size, 0.0, 0.0, 0.0, half, half_z, is_round, *SCRATCH
        )
        assert found == expected, (pos, mat, size, half, half_z)
        seen.add(expected)
    assert seen == {APART, MEETS}


def test_a_prism_of_no_width_meets_nothing():
    solids = (
        np.array([SPHERE]), np.zeros((1, 3)), np.eye(3).reshape(1, 9), np.ones((1, 3)),
        np.array([[-1.0, -1, -1, 1, 1, 1]]),
    )  # fmt: skip
    assert solid_part(0, solids, 0.0, 0.0, -0.1, 0.1, 0.0, True, SCRATCH) == APART
