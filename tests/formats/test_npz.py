"""Voxels as NumPy archives: nothing is lost, and what is wrong is said."""

import io
import zipfile

import numpy as np
import pytest

from navbake.errors import FormatError
from navbake.formats.npz import encode_npz, read_npz
from navbake.voxels.grid import VoxelGrid


def grid_of(dtype=np.uint32):
    values = np.zeros((3, 4, 5), dtype=dtype)
    values[1, 2, 3], values[0, 0, 0] = np.iinfo(np.uint32).max if dtype == np.uint32 else 1, 1
    known = np.ones((3, 4, 5), dtype=bool)
    known[2] = False
    return VoxelGrid(
        values=values, origin=(0.1, -2, 3e5), res=1 / 3, names={1: "Tür", 4294967295: "x"},
        known=known,
    )  # fmt: skip


@pytest.mark.parametrize("dtype", [np.bool_, np.uint8, np.uint16, np.uint32])
def test_what_is_written_is_read(tmp_path, dtype):
    grid = grid_of(dtype)
    (tmp_path / "a.npz").write_bytes(encode_npz(grid))
    back = read_npz(tmp_path / "a.npz")
    assert back.values.dtype == dtype
    np.testing.assert_array_equal(back.values, grid.values)
    np.testing.assert_array_equal(back.known, grid.known)
    assert (back.origin, back.res, back.names) == (grid.origin, grid.res, grid.names)


def test_the_same_grid_gives_the_same_bytes(tmp_path):
    (tmp_path / "a.npz").write_bytes(encode_npz(grid_of()))
    (tmp_path / "b.npz").write_bytes(encode_npz(grid_of()))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_ids_are_exchanged_however_great_they_are():
    grid = grid_of()
    assert grid.ids() == [1, 4294967295]
    other = grid.with_ids({1: 0, 4294967295: 9})
    assert other.values.dtype == np.uint8 and other.ids() == [9] and other.names == {9: "x"}


def archive(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def ones(**changed):
    whole = {"values": np.ones((1, 1, 1), np.uint8), "origin": np.zeros(3), "res": 1.0}
    return archive(**whole | changed)


def packed(**members):
    """An archive of files that are no arrays."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as target:
        for name, content in members.items():
            target.writestr(name, content)
    return file.getvalue()


@pytest.mark.parametrize(
    ("data", "culprit"),
    [
        (b"", "expected a .npz of voxels, got"),
        (b"PK\x03\x04 no archive", "can't be read"),
        (archive(values=np.zeros((2, 2, 2), bool)), "expected an array `origin`, got nothing"),
        (archive(values=np.array([None]), origin=np.zeros(3), res=1.0), "can't be read"),
        (archive(values=np.zeros(5), origin=np.zeros(3), res=1.0), r"shape \(nx, ny, nz\)"),
        (archive(values=np.zeros((2, 2, 2)), origin=np.zeros(3), res=1.0), "dtype bool"),
        (archive(values=np.zeros((2, 2, 2), bool), origin=np.zeros(2), res=1.0), "lower corner"),
        (archive(values=np.zeros((2, 2, 2), bool), origin=np.zeros(3), res=0.0), "edge > 0"),
        (archive(values=np.zeros((2, 2, 2), bool), origin=np.zeros(3), res=np.zeros(2)), "a.npz"),
        (packed(values=b"hello", origin=b"", res=b"1"), "can't be read: .*magic"),
        (ones(ids=np.array([np.inf]), names=np.array(["a"])), "infinity"),
        (ones(ids=np.ones(1), names=np.full(1, 2**31 - 1, "u4").view("U1")), "a.npz"),
        (ones(ids=np.int64(3), names=np.array("a")), "as many names as IDs"),
        (ones(ids=np.zeros(2), names=np.array(["a"])), "as many names as IDs"),
        (ones(ids=np.zeros(2, "c16"), names=np.zeros(2)), "a.npz"),
        (ones(known=np.ones((1, 1, 1))), "`known` of dtype bool, got float64"),
        (ones(res=1e-300), "voxels of 1e-09 m or more"),
        (ones(res=1e308), r"within 1e\+10 m of the origin"),
        (ones(origin=np.array([0, 1e308, 0])), r"within 1e\+10 m of the origin"),
    ],
)
def test_broken_archives_say_what_is_wrong(tmp_path, data, culprit):
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(FormatError, match=culprit) as caught:
        read_npz(tmp_path / "a.npz")
    assert "\n" not in str(caught.value) and "a.npz" in str(caught.value)
