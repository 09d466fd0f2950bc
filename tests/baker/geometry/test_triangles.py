"""Normals, areas and spans of triangles, against numpy over all of them at once."""

from __future__ import annotations

import numpy as np
import pytest

from kernel_parts import callable_part
from navbake.baker.core.arrays import Facets
from navbake.baker.geometry.extents import NUM_DIRECTIONS, FacingAreas
from navbake.baker.geometry.shapes import (
    bounding_box,
    boxes_in_batches,
    drop_unused_vertices,
    triangle_areas,
)
from navbake.baker.geometry.triangle_kernels import (
    describe_triangles,
    find_nearest_axes,
    measure_spans,
    unit_normal,
)
from navbake.baker.readers.orientation import MAX_AXIS_DISTANCE, list_axes

# parts of kernels as functions that Python can call
unit_normal = callable_part(unit_normal)


@pytest.fixture(params=range(10))
def mesh(request):
    """Vertices on a lattice, and faces of which some have no area."""
    rng = np.random.default_rng(request.param)
    vertices = rng.integers(-4, 5, (40, 3)) * 0.3
    return vertices, rng.integers(0, 30, (100, 3)).astype(np.int32)


def cross_of(vertices, faces):
    a, b, c = np.swapaxes(vertices[faces], 0, 1)
    return np.cross(b - a, c - a)


def facets_of(vertices, faces):
    """The triangles of a mesh, of geom 0."""
    geom, closed = np.zeros(len(faces), np.int32), np.zeros(len(faces), np.uint8)
    return Facets(vertices, faces, geom, geom, closed)


def test_normals(mesh):
    corners = mesh[0][mesh[1]]
    normal = np.array([unit_normal(*triangle) for triangle in corners])
    cross = cross_of(*mesh)
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    expected = np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)
    expected[np.abs(expected[:, 2]) < 1e-9, 2] = 0.0
    np.testing.assert_array_equal(normal, expected)


def test_areas(mesh):
    np.testing.assert_array_equal(
        triangle_areas(*mesh), np.linalg.norm(cross_of(*mesh), axis=1) / 2
    )


def test_descriptions(mesh):
    center, normal, area = describe_triangles(*mesh)
    cross, size = cross_of(*mesh), 2 * triangle_areas(*mesh)
    np.testing.assert_array_equal(center, mesh[0][mesh[1]].mean(axis=1))
    np.testing.assert_array_equal(normal, cross / np.maximum(size, 1e-300)[:, None])
    np.testing.assert_array_equal(area, size / 2)


def test_boxes(mesh):
    own = np.tile(mesh[0], (1000, 1))
    np.testing.assert_array_equal(bounding_box(own), [*own.min(axis=0), *own.max(axis=0)])
    for value in (np.inf, -np.inf, np.nan):
        own[7, 1] = value
        assert not np.isfinite(bounding_box(own)).all()


def test_boxes_around_triangles(mesh):
    """They come in batches, of some of the triangles."""
    vertices, faces = mesh[0], np.tile(mesh[1], (300, 1))
    facets = facets_of(vertices, faces)
    corners = vertices[faces]
    expected = np.hstack([corners.min(axis=1), corners.max(axis=1)])
    batches = [(batch, boxes.copy()) for batch, boxes in boxes_in_batches(facets, 7, 29_000)]
    assert len(batches) > 2
    assert [batch.start for batch, _ in batches[1:]] == [batch.stop for batch, _ in batches[:-1]]
    np.testing.assert_array_equal(
        np.concatenate([boxes for _, boxes in batches]), expected[7:29_000]
    )


def test_used_vertices(mesh):
    vertices, faces = mesh[0], np.tile(mesh[1], (1000, 1))
    used, index = drop_unused_vertices(vertices, faces)
    assert len(used) == len(np.unique(faces)) < len(vertices)
    np.testing.assert_array_equal(used[index], vertices[faces])


def test_nearest_directions():
    axes = list_axes()
    normal = np.random.default_rng(0).normal(size=(20_000, 3))
    normal[:5000, 2] *= 0.01  # of walls
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    nearest = np.empty(len(normal), dtype=np.int64)
    find_nearest_axes(normal, axes, MAX_AXIS_DISTANCE, nearest, 0, len(normal))
    np.testing.assert_array_equal(nearest, np.abs(normal @ axes.T).argmax(axis=1))


def test_facing_and_spans(mesh):
    corners = mesh[0][mesh[1]]
    group = np.repeat(np.arange(4, dtype=np.int32), 25)
    step = np.pi / 2 / NUM_DIRECTIONS
    facing = FacingAreas(4)
    for batch in (slice(0, 37), slice(37, 100)):  # in any batches
        facing.add(facets_of(mesh[0], mesh[1][batch]), group[batch])
    angles = facing.find_angles()
    low, high = np.full((4, 3), np.inf), np.full((4, 3), -np.inf)
    way = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    measure_spans(*mesh, group, way, low, high)
    for k, angle in enumerate(angles):
        own = group == k
        cross = cross_of(*mesh)[own]
        facing = np.mod(np.arctan2(cross[:, 1], cross[:, 0]), np.pi / 2)
        bins = np.floor(facing / step + 0.5).astype(int) % NUM_DIRECTIONS
        votes = np.bincount(bins, np.hypot(cross[:, 0], cross[:, 1]), NUM_DIRECTIONS)
        off = np.mod(angle - np.arange(NUM_DIRECTIONS) * step + np.pi / 4, np.pi / 2) - np.pi / 4
        assert votes[np.abs(off) <= step / 2 + 1e-12].max() == pytest.approx(votes.max())
        points = corners[own].reshape(-1, 3)
        along = points[:, :2] @ [np.cos(angle), np.sin(angle)]
        left = points[:, :2] @ [-np.sin(angle), np.cos(angle)]
        spans = np.stack([along, left, points[:, 2]])
        np.testing.assert_allclose(low[k], spans.min(axis=1), atol=1e-12)
        np.testing.assert_allclose(high[k], spans.max(axis=1), atol=1e-12)
