"""Odd meshes: thin, tiny, open, degenerate, far away, tilted, inverted, as strangers' files are."""

from __future__ import annotations

import numpy as np
import trimesh


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


def slats(rng):
    """Boards with gaps, in which centres of cells may lie."""
    gap, width = rng.uniform(0.01, 0.1, 2)
    places = np.arange(30) * (gap + width)
    return trimesh.util.concatenate([box((0, y, -0.02), (3, y + width, 0)) for y in places])


def empty(rng):
    """All triangles are without an area."""
    points = rng.uniform(0, 3, (4, 1)) * (1.0, 1.0, 0.0)
    return trimesh.Trimesh(points, [[0, 1, 2], [1, 2, 3]], process=False)


def soup(rng):
    """Triangles that have nothing to do with each other."""
    points = rng.uniform(0, 4, (90, 3)) * (1.0, 1.0, rng.uniform(0.0, 0.5))
    return trimesh.Trimesh(points, np.arange(90).reshape(30, 3), process=False)


KINDS = [open_room, degenerate, duplicated, turned, wound_down, nested, far, tilted, tiny, thin,
         rugged, millimetres, slats, empty, soup]  # fmt: skip
"""Functions that make a mesh of a kind, from a numpy Generator."""
LOWERED = {"floors": {"min_area": 0.01, "shrink": 0.0, "fill": 1000.0}}
"""Settings that keep as many floors as can be, and fill all holes."""
