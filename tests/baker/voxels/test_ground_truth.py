"""Voxels of random scenes against exact geometry that shares nothing with navbake.

``NAVBAKE_EXAMPLES=3000 pytest tests/baker/voxels/test_ground_truth.py`` tries more, other scenes.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from navbake.baker.core.constants import CLOSED_SURFACE
from navbake.baker.voxels.voxelize import Voxelizer
from navbake.voxels.grid import Placement
from oracles.prisms import FREE, OCCUPIED, UNKNOWN, Prisms
from oracles.scene import Thing, cross_part, part_meets_prisms, part_of, scene_xml
from oracles.surfaces import Surface, surface_meets_prisms

MORE = int(os.environ.get("NAVBAKE_EXAMPLES", "0"))
FOLDER = tempfile.TemporaryDirectory()
KINDS = ("sphere", "capsule", "ellipsoid", "cylinder", "box")

# a tetrahedron with a dent: not convex
DENTED = Thing(
    "closed", (), (0.0, 0.0, 0.0),
    vertices=((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.2, 0.2, 0.15)),
    faces=((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 4), (2, 3, 4), (3, 1, 4)),
)  # fmt: skip


def examples(number: int) -> settings:
    return settings(
        max_examples=MORE or number,
        derandomize=not MORE,
        database=None,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow],
    )


def hundredths(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers that often make faces lie on voxels' faces."""
    return st.integers(round(low * 100), round(high * 100)).map(lambda n: n / 100)


@st.composite
def quats(draw: st.DrawFn) -> tuple[float, float, float, float]:
    """As modelled, a yaw, a lying pose, or any rotation."""
    kind = draw(st.integers(0, 3))
    half = np.pi / 4 if kind == 2 else draw(st.integers(-314, 314)) / 200
    if kind == 0:
        return (1.0, 0.0, 0.0, 0.0)
    axis = {
        1: (0.0, 0.0, 1.0),
        2: draw(st.sampled_from([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])),
        3: draw(st.tuples(*[st.integers(-9, 9)] * 3).filter(any)),
    }[kind]
    way = np.array(axis, dtype=float) / np.linalg.norm(axis)
    return tuple(float(v) for v in (np.cos(half), *(np.sin(half) * way)))


@st.composite
def things(draw: st.DrawFn) -> Thing:
    kind = draw(st.sampled_from([*KINDS, *KINDS, "hull", "closed", "open", "plane"]))
    pos = tuple(draw(hundredths(-0.5, 0.5)) for _ in range(3))
    quat = draw(quats())
    if kind in KINDS:
        count = {"sphere": 1, "capsule": 2, "cylinder": 2}.get(kind, 3)
        size = tuple(draw(hundredths(0.02, 0.5)) for _ in range(count))
        return Thing(kind, size, pos, quat)
    if kind == "plane":
        return Thing(kind, (), pos, quat)
    vertices = DENTED.vertices
    if kind == "hull":
        spots = draw(st.lists(st.tuples(*[hundredths(-0.5, 0.5)] * 3), min_size=6, max_size=9))
        hull = np.array(spots)
        if np.linalg.matrix_rank(hull - hull[0], tol=0.02) == 3:
            return Thing(kind, (), pos, quat, tuple(spots))
        kind = "closed"
    faces = DENTED.faces[:-1] if kind == "open" else DENTED.faces
    return Thing(kind, (), pos, quat, vertices, faces)


@st.composite
def placements(draw: st.DrawFn) -> Placement:
    res = draw(st.sampled_from([0.1, 0.13, 0.25]))
    shape = tuple(draw(st.integers(1, 9)) for _ in range(3))
    origin = np.array([draw(hundredths(-0.8, 0.3)) for _ in range(3)])
    return Placement(origin, res, shape)


def voxelizer_of(scene: list[Thing]) -> Voxelizer:
    path = Path(FOLDER.name) / "scene.xml"
    path.write_text(scene_xml(scene), encoding="utf-8")
    settings = {"path": str(path), "geoms": "all"}
    modes = {f"m{i}": "surface" for i, t in enumerate(scene) if t.kind in ("closed", "open")}
    if modes:
        settings["meshes"] = modes
    return Voxelizer({"scene": settings})


def truth(scene: list[Thing], place: Placement) -> np.ndarray:
    """FREE, OCCUPIED or UNKNOWN of each thing and voxel, shape (n, nx, ny, nz)."""
    middles = (np.indices(place.shape).reshape(3, -1).T + 0.5) * place.res + place.origin
    low, high = middles[:, 2] - place.res / 2, middles[:, 2] + place.res / 2
    prisms = Prisms(middles[:, 0], middles[:, 1], low, high, place.res / 2, False)
    states = []
    for thing in scene:
        part = part_of(thing)
        column = cross_part(part, prisms.x, prisms.y)
        state = part_meets_prisms(part, column, prisms)
        if isinstance(part, Surface):
            state = surface_meets_prisms(part, prisms)
            if part.closed:  # what its surface leaves alone is in or out as any point of it is
                aside = cross_part(part, prisms.x + 0.0137 * place.res, prisms.y)
                within = (aside.low < middles[:, 2]) & (aside.high > middles[:, 2])
                inside = np.where(np.isinf(aside.z).any(axis=0), UNKNOWN, FREE)
                inside[within.any(axis=0)] = OCCUPIED
                state = np.where(state == FREE, inside, state)
        states.append(state.reshape(place.shape))
    return np.array(states)


@examples(120)
@given(scene=st.lists(things(), min_size=1, max_size=3), place=placements())
def test_voxels_are_those_that_geoms_meet(scene, place):
    states = truth(scene, place)
    grid = voxelizer_of(scene).fill(place)
    assert grid.values.dtype == np.bool_
    assert grid.occupied[(states == OCCUPIED).any(axis=0)].all()
    assert not grid.occupied[(states == FREE).all(axis=0)].any()


@examples(40)
@given(scene=st.lists(things(), min_size=2, max_size=4), place=placements())
def test_the_least_id_of_those_that_meet_wins(scene, place):
    states = truth(scene, place)
    values = voxelizer_of(scene).fill(place, segments="geom").values
    sure = (states != UNKNOWN).all(axis=0)
    meets = states == OCCUPIED
    least = np.where(meets.any(axis=0), meets.argmax(axis=0) + 1, 0)
    np.testing.assert_array_equal(values[sure], least[sure])


# ---------------------------------------------------------------- larger meshes


def torus(around=24, across=12, bumps=0.1):
    """A closed, bumpy ring that is neither convex nor star-shaped."""
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = 2 * np.pi * u / around, 2 * np.pi * v / across
    thick = 0.35 * (1 + bumps * np.sin(5 * a) * np.cos(3 * b))
    reach = 0.8 + thick * np.cos(b)
    vertices = np.stack([reach * np.cos(a), reach * np.sin(a), thick * np.sin(b)], axis=-1)
    number = u * across + v
    right, up = np.roll(number, -1, axis=0), np.roll(number, -1, axis=1)
    both = np.roll(right, -1, axis=1)
    faces = np.concatenate(
        [np.stack([number, right, both], -1), np.stack([number, both, up], -1)]
    ).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces


def mesh_thing(kind, vertices, faces, pos=(0.0, 0.0, 0.0), quat=(1.0, 0.0, 0.0, 0.0)):
    corners = tuple(tuple(v) for v in np.asarray(vertices).tolist())
    return Thing(kind, (), pos, quat, corners, tuple(tuple(f) for f in np.asarray(faces).tolist()))


@pytest.mark.parametrize("kind", ["closed", "open"])
@pytest.mark.parametrize("quat", [(1.0, 0.0, 0.0, 0.0), (0.8, 0.36, 0.48, 0.1)])
def test_a_ring_is_that_of_separating_axes_and_parity(kind, quat):
    vertices, faces = torus()
    faces = faces if kind == "closed" else faces[:-60]
    scene = [
        Thing(
            kind,
            (),
            (0.013, -0.021, 0.007),
            quat,
            tuple(map(tuple, vertices.tolist())),
            tuple(map(tuple, faces.tolist())),
        )
    ]
    place = Placement(np.array([-1.3, -1.3, -0.9]), 0.1, (26, 26, 18))
    (states,) = truth(scene, place)
    grid = voxelizer_of(scene).fill(place)
    sure = states != UNKNOWN
    assert sure.mean() > 0.99 and (states == OCCUPIED).sum() > 500
    np.testing.assert_array_equal(grid.values[sure], states[sure] == OCCUPIED)


def test_lines_through_edges_and_corners_leave_no_holes():
    """Voxels' middles lie over the edges, diagonals and corners of a closed mesh."""
    box = trimesh.creation.box((1.0, 1.0, 1.0)).subdivide().subdivide()
    scene = [mesh_thing("closed", box.vertices, box.faces)]
    place = Placement(np.full(3, -0.5625), 0.125, (9, 9, 9))
    assert voxelizer_of(scene).fill(place).values.all()
    place = Placement(np.full(3, -0.75), 0.125, (12, 12, 12))
    values = voxelizer_of(scene).fill(place).values
    assert values[2:10, 2:10, 2:10].all() and values.sum() == 8**3


@pytest.mark.parametrize("number", range(0, 12, 3))
def test_a_gap_that_rounding_tore_leaves_no_streak(number):
    """One triangle of a box is moved by a hair, so that lines over its edges run through."""
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    corners = box.vertices[box.faces].reshape(-1, 3)  # no triangle shares a vertex
    closed = mesh_thing("closed", corners, np.arange(len(corners)).reshape(-1, 3))
    voxelizer = voxelizer_of([closed])
    triangles = voxelizer.shapes.triangles
    assert (triangles.closed == CLOSED_SURFACE).all()
    assert len(np.unique(triangles.faces)) == triangles.faces.size
    triangles.vertices[triangles.faces[number], :2] += 1e-13, -4e-14
    values = voxelizer.fill(Placement(np.full(3, -1.0), 0.125, (16, 16, 16))).values
    assert values[4:12, 4:12, 4:12].all() and values.sum() == 8**3
    # lines along all diagonals
    assert voxelizer.fill(Placement(np.full(3, -0.5625), 0.125, (9, 9, 9))).values.all()
    far = Placement(np.array([-0.5625, -0.5625, 0.6]), 0.125, (9, 9, 9))
    assert not voxelizer.fill(far).values.any()


@pytest.mark.parametrize("kind", ["box", "cylinder"])
@pytest.mark.parametrize("lean", [3e-6, 1e-5, 1e-3])
def test_what_leans_by_a_hair_is_not_taken_for_upright(kind, lean):
    """A slab of 20 m whose top rises with y by a little, beside voxels' faces at half of that."""
    size = (10.0, 10.0, 0.5) if kind == "box" else (10.0, 0.5)
    slab = Thing(kind, size, (0.0, 0.0, 0.0), (np.cos(lean / 2), np.sin(lean / 2), 0.0, 0.0))
    place = Placement(np.array([-0.05, -10.0, 0.5 + 4.9 * lean - 0.1]), 0.1, (1, 200, 2))
    values = voxelizer_of([slab]).fill(place).values[0]
    assert values[180:199].all() and values[1:148, 0].all() and not values[1:148, 1].any()
