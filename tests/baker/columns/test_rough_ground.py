"""Rough ground carries an agent; a smooth slope over its limit doesn't, at any size of cells."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import navbake


def terrain(spacing, height, size=3.0):
    """Triangles over a square; `height` is a function of x and y [m]."""
    count = round(size / spacing) + 1
    x, y = np.meshgrid(np.linspace(0, size, count), np.linspace(0, size, count))
    index = np.arange(count * count).reshape(count, count)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, :-1].ravel(), index[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
    points = np.stack([x.ravel(), y.ravel(), height(x, y).ravel()], axis=1)
    return trimesh.Trimesh(points, faces, process=False)


def bake(mesh, **settings):
    return navbake.bake(mesh, scene={"up": "z"}, **settings)


@pytest.mark.parametrize(("spacing", "sigma"), [(0.01, 0.005), (0.02, 0.01), (0.05, 0.02)])
def test_a_floor_with_a_scanners_noise_is_free(spacing, sigma):
    rng = np.random.default_rng(0)
    mesh = terrain(spacing, lambda x, y: rng.normal(0, sigma, x.shape))
    up = mesh.face_normals[:, 2]
    assert (up < np.cos(np.radians(45))).mean() > 0.1 or sigma == 0.02
    grid = bake(mesh)
    assert grid.free.all()
    assert navbake.verify(grid, mesh, sample=200).ok


@pytest.mark.parametrize("cell_size", [0.05, 0.1, 0.3])
@pytest.mark.parametrize(("degrees", "is_floor"), [(43, True), (47, False)])
def test_a_smooth_slope_keeps_its_limit(cell_size, degrees, is_floor):
    mesh = terrain(0.1, lambda x, y: x * np.tan(np.radians(degrees)))
    if is_floor:
        assert bake(mesh, grid={"cell_size": cell_size}).free.mean() > 0.9
    else:
        with pytest.raises(navbake.NavbakeError, match="no floor"):
            bake(mesh, grid={"cell_size": cell_size})


def test_bumps_of_more_than_a_third_of_a_step_are_no_ground():
    """Saw teeth of 60°: low ones are gravel, high ones are not."""

    def teeth(height):
        return terrain(0.01, lambda x, y: height * np.abs((x / 0.06) % 2 - 1) + 0 * y)

    assert bake(teeth(0.08)).free.mean() > 0.9
    settings = {"agent": {"traversable_floor_height": 0.1}}
    with pytest.raises(navbake.NavbakeError):
        bake(teeth(0.11), **settings)
