"""Distances of voxels, against brute force and scipy's interpolation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import navbake
from navbake.errors import FormatError, QueryError
from navbake.voxels.grid import VoxelGrid
from oracles.flights import measure_distances

ORIGIN = (1.0, -2.0, 3.5)


def scatter(shape, share, seed=0):
    occupied = np.random.default_rng(seed).random(shape) < share
    occupied.flat[3] = True
    occupied.flat[4] = False
    return VoxelGrid(values=occupied, origin=ORIGIN, res=0.1)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.1, 0.6])
@pytest.mark.parametrize("shape", [(9, 7, 11), (1, 6, 8), (5, 1, 1), (20, 3, 4)])
def test_distances_are_those_to_the_nearest_cube(shape, share):
    voxels = scatter(shape, share)
    expected = measure_distances(voxels.occupied, 0.1)
    assert np.abs(voxels.distances().values - expected).max() <= 1e-12
    expected -= measure_distances(~voxels.occupied, 0.1)
    assert np.abs(voxels.distances(signed=True).values - expected).max() <= 1e-12


def test_an_empty_grid_is_infinitely_far_and_a_full_one_infinitely_deep():
    empty = VoxelGrid(values=np.zeros((3, 4, 5), dtype=bool), origin=ORIGIN, res=0.1)
    field = empty.distances(signed=True)
    assert np.isposinf(field.values).all()
    position = empty.bounds.mean(axis=0)
    assert np.isposinf(field.at(position)) and (field.gradients_at(position) == 0.0).all()
    full = VoxelGrid(values=np.ones((3, 4, 5), dtype=bool), origin=ORIGIN, res=0.1)
    assert np.isneginf(full.distances(signed=True).values).all()
    assert (full.distances().values == 0.0).all()


def test_unknown_voxels_count_if_that_is_asked_for():
    voxels = VoxelGrid(
        values=np.zeros((3, 1, 1), dtype=bool),
        origin=ORIGIN,
        res=0.1,
        known=np.array([True, True, False]).reshape(3, 1, 1),
    )
    assert np.isinf(voxels.distances().values).all()
    distances = voxels.distances(unknown_occupied=True).values.ravel()
    assert distances == pytest.approx([0.15, 0.05, 0.0])


def test_ids_count_as_occupied():
    voxels = scatter((6, 6, 6), 0.1)
    ids = VoxelGrid(values=voxels.values.astype(np.uint8) * 7, origin=ORIGIN, res=0.1)
    assert (ids.distances().values == voxels.distances().values).all()


def test_values_and_gradients_are_those_of_scipys_trilinear_interpolation():
    voxels = scatter((8, 9, 10), 0.1)
    field = voxels.distances(signed=True)
    axes = [ORIGIN[axis] + (np.arange(voxels.shape[axis]) + 0.5) * 0.1 for axis in range(3)]
    reference = RegularGridInterpolator(axes, field.values, bounds_error=False, fill_value=None)
    rng = np.random.default_rng(1)
    points = np.array(ORIGIN) + rng.random((4, 50, 3)) * voxels.shape * 0.1
    assert field.at(points) == pytest.approx(reference(points), abs=1e-12)
    points = points.clip(voxels.bounds[0] + 1e-3, voxels.bounds[1] - 1e-3)
    gradients = field.gradients_at(points)
    assert gradients.shape == (4, 50, 3)
    for axis in range(3):
        nudge = np.eye(3)[axis] * 1e-7
        slope = (reference(points + nudge) - reference(points - nudge)) / 2e-7
        assert gradients[..., axis] == pytest.approx(slope, abs=1e-6)


def test_a_signed_field_is_zero_on_a_flat_face():
    occupied = np.zeros((6, 6, 6), dtype=bool)
    occupied[:, :, :3] = True
    field = VoxelGrid(values=occupied, origin=(0, 0, 0), res=0.2).distances(signed=True)
    heights = [0.55, 0.6, 0.65, 0.9]
    assert field.at([(0.6, 0.6, z) for z in heights]) == pytest.approx(np.array(heights) - 0.6)
    assert field.gradients_at((0.6, 0.6, 0.7)) == pytest.approx([0, 0, 1])


@pytest.mark.parametrize("position", [(0.0, 0.0, 0.0), (np.nan, 0, 0), (1.0, 2.0), "kitchen"])
def test_positions_that_are_none_in_the_grid_are_refused(position):
    field = scatter((4, 4, 4), 0.1).distances()
    with pytest.raises(QueryError, match=r"no voxel at|expected finite positions"):
        field.at(position)


def test_a_field_is_written_and_read_by_numpy(tmp_path):
    field = scatter((4, 5, 6), 0.1).distances(signed=True)
    field.save(tmp_path / "esdf.npz")
    with np.load(tmp_path / "esdf.npz") as archive:
        assert (archive["distances"] == field.values).all()
        assert tuple(archive["origin"]) == field.origin
        assert archive["res"] == 0.1 and archive["is_signed"]
    with pytest.raises(FormatError, match=r"expected a name that ends in \.npz"):
        field.save(tmp_path / "esdf.txt")


def test_it_says_how_far_in_one_line():
    field = navbake.VoxelGrid(values=np.eye(4, dtype=bool)[None], origin=ORIGIN, res=0.1)
    assert repr(field.distances()) == "DistanceField(1 × 4 × 4 distances, 0 to 0.158 m)"
