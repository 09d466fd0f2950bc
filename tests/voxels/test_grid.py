"""What a voxel grid refuses, how it shows itself, and that its array may lie in any order."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

import navbake
from navbake.errors import FormatError
from navbake.formats.voxels import read_binvox
from navbake.voxels.grid import VoxelGrid


@pytest.mark.parametrize("value", [1 / 3, b"7" * 9, "x\n" * 99])
def test_a_corner_of_another_shape_is_told_in_one_short_line(value):
    many = tuple(np.full((5, 10, 3), value).tolist())
    with pytest.raises(FormatError, match="expected a lower corner") as caught:
        VoxelGrid(values=np.zeros((2, 2, 2), dtype=bool), origin=many, res=0.1)
    assert len(str(caught.value)) < 200 and "\n" not in str(caught.value)


NOTEBOOK = "_repr_png_"  # the method that Jupyter calls


def stairs():
    """A flight of 4 steps along x, without anything in the last column of y."""
    values = np.arange(4)[:, None, None] >= np.arange(4)[None, None, :]
    values = np.repeat(values, 3, axis=1)
    values[:, 2] = False
    return VoxelGrid(values=values, origin=(0.5, -1.0, 0.0), res=0.5)


@pytest.mark.parametrize("ending", ["bt", "ot", "binvox", "npz"])
@pytest.mark.parametrize("layout", [np.asfortranarray, lambda values: values[::-1][::-1]])
def test_arrays_in_any_memory_layout_are_saved(tmp_path, ending, layout):
    grid = stairs()
    grid.save(tmp_path / f"plain.{ending}")
    VoxelGrid(values=layout(grid.values), origin=grid.origin, res=grid.res).save(
        tmp_path / f"other.{ending}"
    )
    read = navbake.load_voxels(tmp_path / f"other.{ending}")
    assert read.values.sum() == grid.values.sum() == 20
    if ending != "npz":  # NumPy keeps the order
        plain, other = (tmp_path / f"{name}.{ending}" for name in ("plain", "other"))
        assert plain.read_bytes() == other.read_bytes()


def test_airsims_layout_is_saved(tmp_path):
    grid = VoxelGrid(values=np.ones((2, 4, 2), dtype=bool), origin=(-0.5, -1.0, -0.5), res=0.5)
    grid.save(tmp_path / "a.binvox", layout="airsim")
    read = read_binvox(tmp_path / "a.binvox")
    assert read.shape == grid.shape and "AirSim" in read.notes[0]


def test_it_is_one_line_and_a_picture_from_above():
    grid = stairs()
    expected = "VoxelGrid(4 × 3 × 4 voxels of 0.5 m from (0.5, -1, 0) on, 20 occupied)"
    assert repr(grid) == str(grid) == expected
    image = Image.open(io.BytesIO(getattr(grid, NOTEBOOK)())).convert("L")
    pixels = np.asarray(image)[:: image.height // 3, :: image.width // 4]
    assert (pixels[0] == 255).all()  # the largest y is on top
    assert (np.diff(pixels[2].astype(int)) > 0).all() and pixels[2, -1] < 255
