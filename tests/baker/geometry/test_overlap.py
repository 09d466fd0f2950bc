"""Solids, triangles and planes against prisms: closed forms down to 1e-6 m, FCL, separating axes.

Run ``NAVBAKE_EXAMPLES=100000 pytest tests/baker/geometry/test_overlap.py`` for more pairs.
"""

from __future__ import annotations

import os

import fcl
import numpy as np
import pytest
from numpy.random import Generator
from numpy.typing import NDArray

from kernel_parts import callable_part
from navbake.baker.core.arrays import Planes, Prism, Solids
from navbake.baker.core.constants import (
    APART,
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    MEETS,
    SPHERE,
    UNDECIDED,
)
from navbake.baker.geometry.gjk_kernels import allocate_simplex, gjk_meets_prism
from navbake.baker.geometry.overlap_kernels import (
    allocate_polygons,
    plane_meets_prism,
    triangle_meets_prism,
)
from navbake.baker.geometry.shapes import solid_bounds
from oracles.prisms import Prisms
from oracles.surfaces import disc_meets, square_meets

# parts of kernels as functions that Python can call
allocate_simplex = callable_part(allocate_simplex)
gjk_meets_prism = callable_part(gjk_meets_prism)
allocate_polygons = callable_part(allocate_polygons)
plane_meets_prism = callable_part(plane_meets_prism)
triangle_meets_prism = callable_part(triangle_meets_prism)

PAIRS = int(os.environ.get("NAVBAKE_EXAMPLES", "1500"))
KINDS = {
    "sphere": SPHERE,
    "capsule": CAPSULE,
    "ellipsoid": ELLIPSOID,
    "cylinder": CYLINDER,
    "box": BOX,
}
SIMPLEX = allocate_simplex()
FCL = {
    SPHERE: lambda s: fcl.Sphere(s[0]),
    CAPSULE: lambda s: fcl.Capsule(s[0], 2 * s[1]),
    ELLIPSOID: lambda s: fcl.Ellipsoid(*s),
    CYLINDER: lambda s: fcl.Cylinder(s[0], 2 * s[1]),
    BOX: lambda s: fcl.Box(*(2 * s)),
}


def prism_at(center: NDArray, half: float, half_z: float, is_round: bool) -> Prism:
    x, y, z = (float(v) for v in center)
    return Prism(x, y, z - half_z, z + half_z, float(half), bool(is_round))


def meets(kind: int, pos: NDArray, mat: NDArray, size: NDArray, prism: tuple) -> int:
    kinds, mats = np.array([kind], np.int32), np.ascontiguousarray(mat).reshape(1, 9)
    bounds = solid_bounds(kinds, pos[None], mats, size[None])
    solids = Solids(np.zeros(1, np.int32), kinds, pos[None], mats, size[None], bounds)
    return gjk_meets_prism(solids, 0, prism_at(*prism), SIMPLEX)


def random_turn(rng: Generator) -> NDArray:
    """Any rotation, a yaw, or quarter turns."""
    choice = rng.integers(4)
    if choice == 0:
        angle = rng.uniform(0, 2 * np.pi)
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    if choice == 1:
        axes = rng.permutation(3)
        turn = np.eye(3)[axes] * rng.choice([-1.0, 1.0], 3)
        return turn * np.sign(np.linalg.det(turn))
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def random_size(rng: Generator) -> NDArray:
    return np.exp(rng.uniform(np.log(0.005), np.log(100.0), 3))


def random_prism(rng: Generator, is_round: bool) -> tuple:
    half = np.exp(rng.uniform(np.log(0.01), np.log(0.5)))
    return rng.uniform(-5, 5, 3), half, rng.uniform(0.02, 1.0), is_round


def touching_point(rng: Generator, prism: tuple) -> tuple[NDArray, NDArray]:
    """A point of the prism's surface, and a unit normal of a plane that only touches it there."""
    center, half, half_z, is_round = prism
    way = rng.normal(size=3)
    way[rng.random(3) < 0.25] = 0.0
    if not way.any():
        way[2] = 1.0
    way /= np.linalg.norm(way)
    point = rng.uniform(-1, 1, 3)  # anywhere on the face or edge that faces that way
    if is_round:
        across = np.hypot(way[0], way[1])
        point[:2] *= 0.7
        if across > 0:
            point[:2] = way[:2] / across
    else:
        point[:2] = np.where(way[:2] != 0, np.sign(way[:2]), point[:2])
    point[2] = np.sign(way[2]) if way[2] != 0 else point[2]
    return center + point * [half, half, half_z], way


def support_point(kind: int, size: NDArray, way: NDArray, rng: Generator) -> NDArray:
    """A point of a solid at the origin, in its own frame, that is farthest along a way."""
    free = rng.uniform(-1, 1, 3)
    if kind == SPHERE:
        return way * size[0]
    if kind == CAPSULE:
        end = np.sign(way[2]) if abs(way[2]) > 1e-12 else free[2]
        return way * size[0] + np.array([0, 0, end * size[1]])
    if kind == ELLIPSOID:
        return size * size * way / np.linalg.norm(size * way)
    if kind == BOX:
        return np.where(np.abs(way) > 1e-12, np.sign(way), free) * size
    across = np.hypot(way[0], way[1])
    point = np.zeros(3)
    point[:2] = way[:2] / across * size[0] if across > 1e-12 else free[:2] * 0.7 * size[0]
    point[2] = size[1] * (np.sign(way[2]) if abs(way[2]) > 1e-12 else free[2])
    return point


@pytest.mark.parametrize("is_round", [False, True], ids=["square", "disc"])
@pytest.mark.parametrize("name", KINDS)
def test_gaps_known_in_closed_form(name: str, is_round: bool) -> None:
    """A solid's farthest point is put on a plane that touches the prism, or just off it.

    With a gap, that plane proves that they are as far apart; without, the point is common.
    """
    rng = np.random.default_rng(len(name) + 100 * is_round)
    kind = KINDS[name]
    open_ = {}
    for _ in range(PAIRS):
        prism, size, mat = random_prism(rng, is_round), random_size(rng), random_turn(rng)
        touch, way = touching_point(rng, prism)
        gap = rng.choice([1e-6, 1e-5, 1e-4, 1e-2]) * rng.choice([-1, 1])
        if -gap > 0.5 * min(prism[1], prism[2]):
            continue
        own = support_point(kind, size, -way @ mat, rng)
        pos = touch + way * gap - mat @ own
        answer = meets(kind, pos, mat, size, prism)
        expected = APART if gap > 0 else MEETS
        assert answer in (expected, UNDECIDED), f"gap {gap}: {kind}, {pos}, {mat}, {size}, {prism}"
        open_[gap] = open_.get(gap, 0) + (answer == UNDECIDED)
    assert sum(open_.values()) <= 0.005 * PAIRS, f"no proof: {open_}"


@pytest.mark.parametrize("is_round", [False, True], ids=["square", "disc"])
@pytest.mark.parametrize("name", KINDS)
def test_fcl_says_the_same(name: str, is_round: bool) -> None:
    rng = np.random.default_rng(len(name) + 200 * is_round)
    kind = KINDS[name]
    answers = []
    for _ in range(PAIRS):
        center, half, half_z, _ = prism = random_prism(rng, is_round)
        size, mat = random_size(rng), random_turn(rng)
        pos = center + rng.normal(size=3) * (size.max() + half + half_z) * rng.uniform(0, 0.5)
        solid = fcl.CollisionObject(FCL[kind](size), fcl.Transform(mat, pos))
        said = []
        for margin in (-2e-5, 2e-5):  # FCL is off by up to 1e-5
            a, b = half + margin, 2 * (half_z + margin)
            shape = fcl.Cylinder(a, b) if is_round else fcl.Box(2 * a, 2 * a, b)
            said.append(fcl.collide(fcl.CollisionObject(shape, fcl.Transform(center)), solid) > 0)
        if said[0] != said[1]:
            continue
        answer = meets(kind, pos, mat, size, prism)
        expected = MEETS if said[0] else APART
        assert answer == expected, f"{kind}, {pos}, {mat}, {size}, {prism}"
        answers.append(answer)
    assert 0.1 < np.mean(np.array(answers) == MEETS) < 0.9


@pytest.mark.parametrize("name", KINDS)
def test_one_inside_the_other(name: str) -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        center, half, half_z, is_round = random_prism(rng, bool(rng.integers(2)))
        prism = center, half, half_z, is_round
        small, large = np.full(3, 1e-3) * half, np.full(3, 20.0)
        for size in (small, large):
            shift = rng.uniform(-0.5, 0.5, 3) * [half, half, half_z]
            for pos in (center, center + shift):
                assert meets(KINDS[name], pos, random_turn(rng), size, prism) == MEETS


def random_triangle(rng: Generator, center: NDArray, size: float) -> NDArray:
    corners = center + rng.normal(size=(3, 3)) * size * np.exp(rng.uniform(-3, 2))
    choice = rng.integers(6)
    if choice == 0:  # level
        corners[:, 2] = corners[0, 2]
    elif choice == 1:  # upright
        corners[1, :2] = corners[0, :2]
    elif choice == 2:  # a sliver
        corners[2] = corners[0] + rng.uniform(-1, 2) * (corners[1] - corners[0]) + 1e-5
    return corners


@pytest.mark.parametrize("is_round", [False, True], ids=["square", "disc"])
def test_triangles(is_round: bool) -> None:
    rng = np.random.default_rng(int(is_round))
    polygons = allocate_polygons()
    drawn = []
    for _ in range(4 * PAIRS):
        center, half, half_z, _ = random_prism(rng, is_round)
        drawn.append((random_triangle(rng, center, half + half_z), *center, half, half_z))
    corners, x, y, z, half, half_z = map(np.array, zip(*drawn, strict=True))
    low, high = z - half_z, z + half_z
    prisms = Prisms(x, y, low, high, half, is_round)
    test = disc_meets if is_round else square_meets
    inner, outer = (test(corners, prisms.shrunk(margin)) for margin in (1e-9, -1e-9))
    counts = {True: 0, False: 0}
    for k in np.flatnonzero(inner == outer).tolist():
        prism = Prism(x[k], y[k], low[k], high[k], half[k], is_round)
        answer = triangle_meets_prism(corners[k], prism, polygons)
        assert answer == inner[k], f"{corners[k]}, {prism}"
        counts[bool(inner[k])] += 1
    assert min(counts.values()) > PAIRS / 4


@pytest.mark.parametrize("is_round", [False, True], ids=["square", "disc"])
def test_planes(is_round: bool) -> None:
    rng = np.random.default_rng(9)
    for _ in range(PAIRS):
        prism = random_prism(rng, is_round)
        mat = random_turn(rng)
        touch, way = touching_point(rng, prism)
        if abs(way[2]) < 1e-9 and rng.integers(2):
            mat = np.column_stack([np.cross([0, 0, 1.0], way), [0, 0, 1.0], -way])
        else:
            other = np.linalg.svd(way[None])[2][1:]
            mat = np.column_stack([other[0], other[1], -way])
        gap = rng.choice([1e-6, 1e-3, 0.1]) * rng.choice([-1, 1])
        shift = mat[:, :2] @ rng.uniform(-3, 3, 2)  # anywhere on the plane
        pos = touch + way * gap + shift
        planes = Planes(np.zeros(1, np.int32), pos[None], np.ascontiguousarray(mat).reshape(1, 9))
        # the normal points at the prism, and what lies behind it is solid
        assert plane_meets_prism(planes, 0, prism_at(*prism)) == (gap < 0)
