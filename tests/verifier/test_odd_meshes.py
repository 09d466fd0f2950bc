"""Odd meshes bake or are refused in one line, and verify agrees with what was baked.

The kinds are those of strangers' files: thin, tiny, open, degenerate, far away, tilted, inverted.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh

import navbake
from navbake.baker.core.constants import OPEN_SURFACE as BAKED_OPEN
from navbake.baker.geometry.mesh_parts import split_mesh
from navbake.verifier.mesh_parts import OPEN_SURFACE, split_mesh_parts

SEEDS = range(6)


def box(low, high):
    low, high = np.asarray(low, float), np.asarray(high, float)
    mesh = trimesh.creation.box(high - low)
    mesh.apply_translation((low + high) / 2)
    return mesh


def room(rng):
    width, depth = rng.uniform(2, 4, 2)
    thickness = rng.uniform(0.01, 0.4)
    parts = [box((0, 0, -thickness), (width, depth, 0))]
    parts.append(box((0, 0, 0), (thickness, depth, rng.uniform(0.3, 3))))
    for _ in range(rng.integers(1, 4)):
        low = rng.uniform(0, 1, 3) * (width, depth, 0.4)
        parts.append(box(low, low + rng.uniform(0.02, 1.5, 3)))
    return trimesh.util.concatenate(parts)


def with_faces(mesh, faces, vertices=None):
    points = mesh.vertices if vertices is None else vertices
    return trimesh.Trimesh(points, faces, process=False)


def open_room(rng):
    mesh = room(rng)
    return with_faces(mesh, mesh.faces[rng.random(len(mesh.faces)) < 0.8])


def degenerate(rng):
    mesh = room(rng)
    points = mesh.vertices.copy()
    points[rng.random(len(points)) < 0.1] = points[0]
    return with_faces(mesh, mesh.faces, points)


def duplicated(rng):
    mesh = room(rng)
    copies = mesh.faces[rng.random(len(mesh.faces)) < 0.5]
    return with_faces(mesh, np.concatenate([mesh.faces, copies]))


def turned(rng):
    mesh = room(rng)
    faces = mesh.faces.copy()
    is_turned = rng.random(len(faces)) < 0.2
    faces[is_turned] = faces[is_turned][:, ::-1]
    return with_faces(mesh, faces)


def wound_down(rng):
    """Closed shells that share edges, with their upper sides turned, as ifcopenshell makes some."""
    parts = [box((0, 0, -0.1), (4, 4, 0))]
    for _ in range(5):
        low = rng.integers(0, 5, 3) * (0.5, 0.5, 0.15)
        part = box(low, low + rng.integers(1, 4, 3) * (0.5, 0.5, 0.15))
        faces = part.faces.copy()
        is_up = part.face_normals[:, 2] > 0.5
        faces[is_up] = faces[is_up][:, ::-1]
        parts.append(with_faces(part, faces))
    mesh = trimesh.util.concatenate(parts)
    mesh.merge_vertices()
    return mesh


def nested(rng):
    size = np.array([4.0, 4.0, 2.0])
    parts = []
    for _ in range(3):
        part = box(-size / 2, size / 2)
        if rng.random() < 0.5:
            part.invert()
        parts.append(part)
        size = size * rng.uniform(0.5, 0.95)
    return trimesh.util.concatenate(parts)


def far(rng):
    mesh = room(rng)
    mesh.apply_translation((3e5, -5e4, 100.0))
    return mesh


def tilted(rng):
    mesh = room(rng)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.4, rng.normal(size=3)))
    return mesh


def tiny(rng):
    return trimesh.creation.icosphere(subdivisions=1, radius=10 ** rng.uniform(-6, -1))


def thin(rng):
    return box((0, 0, 0), 10 ** rng.uniform(-4, 1, 3))


def rugged(rng):
    """Nothing is flat."""
    x, y = np.meshgrid(np.arange(30) * 0.1, np.arange(30) * 0.1)
    z = x * 2 + rng.normal(0, 0.2, x.shape)
    index = np.arange(900).reshape(30, 30)
    a, b, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel()
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    return trimesh.Trimesh(points, np.stack([a, b, d], axis=1), process=False)


def millimetres(rng):
    mesh = room(rng)
    mesh.apply_scale(0.001)
    return mesh


KINDS = [open_room, degenerate, duplicated, turned, wound_down, nested, far, tilted, tiny, thin,
         rugged, millimetres]  # fmt: skip
LOWERED = {"floors": {"min_area": 0.01, "shrink": 0.0, "fill": 1000.0}}


def bake_or_refuse(mesh, settings):
    """The grid of a mesh; None where the bake refuses it."""
    try:
        return navbake.bake(mesh, **settings)
    except navbake.NavbakeError:
        return None


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
@pytest.mark.parametrize("settings", [{}, LOWERED], ids=["default", "lowered"])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_verify_agrees_wherever_it_bakes(kind, settings):
    for seed in SEEDS:
        mesh = kind(np.random.default_rng(seed))
        grid = bake_or_refuse(mesh, settings)
        if grid is None:
            continue
        report = navbake.verify(grid, mesh, sample=200)
        assert report.ok, (seed, report.findings[:2])


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_both_sides_agree_on_what_meshes_enclose(kind):
    for seed in SEEDS:
        mesh = kind(np.random.default_rng(seed))
        baked = split_mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        closed = baked.faces[baked.closed != BAKED_OPEN]
        parts = split_mesh_parts(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        enclosing = [part.faces for part in parts if part.kind != OPEN_SURFACE]
        faces = np.concatenate(enclosing) if enclosing else np.empty((0, 3), np.int64)
        assert rolled(faces) == rolled(closed)


def rolled(faces):
    """Triangles as a set, each from its lowest corner on."""
    return {min((a, b, c), (b, c, a), (c, a, b)) for a, b, c in faces.tolist()}


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
@pytest.mark.parametrize("height", [0.3, 0.6])
def test_a_plateau_of_a_height_field_is_ground(height):
    heights = np.zeros((101, 101))
    heights[40:60, 40:60] = 1.0
    spec = mujoco.MjSpec()
    spec.add_hfield(
        name="field", nrow=101, ncol=101, size=[5, 5, height, 0.5], userdata=heights.ravel()
    )
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="field", name="terrain")
    grid = navbake.bake(spec)
    place = grid.at((0, 0, 1))
    assert place.free
    assert place.floor == pytest.approx(height)
    assert navbake.verify(grid, spec, sample=2000).ok


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_a_box_on_a_height_field_is_no_ground():
    spec = mujoco.MjSpec()
    spec.add_hfield(name="field", nrow=3, ncol=3, size=[5, 5, 1, 0.5], userdata=np.zeros(9))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="field")
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.3], pos=[0, 0, 0.3])
    assert not navbake.bake(spec).at((0, 0, 1)).free
