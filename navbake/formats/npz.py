"""Voxels as a NumPy archive: ``values``, ``origin``, ``res``, and what the IDs stand for."""

import io
import math
import warnings
import zipfile
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.formats.source import read_bytes
from navbake.formats.voxel_allowance import VoxelAllowance
from navbake.types import Json
from navbake.voxels.grid import VoxelGrid

VERSION = 1
ZIP, NPY = b"PK", b"\x93NUMPY"
REQUIRED = ("values", "origin", "res")
OPTIONAL = ("ids", "names", "known")
GRID = "grid"  # the array that only archives of navigation grids have
GRIDS = ("values", "known")  # of all voxels
MAX_IDS = 1 << 20  # entries of the table of IDs
MAX_NPY = 1 << 30  # of a single array [bytes]


def encode_npz(grid: VoxelGrid) -> bytes:
    """Encode voxels as ``.npz``: everything but the notes is kept.

    It holds ``values`` (nx, ny, nz), ``origin`` (3,) [m], ``res`` [m], ``ids`` and ``names``,
    and ``known`` where not all is.

    Raises:
        FormatError: a name ends in the character 0.
    """
    ids = sorted(grid.names)
    if any(name.endswith("\0") for name in grid.names.values()):  # numpy fills texts up with these
        raise FormatError("expected names of IDs that do not end in the character 0, got one")
    arrays: Json = {
        "version": np.int64(VERSION),
        "values": grid.values,
        "origin": np.array(grid.origin),
        "res": np.float64(grid.res),
        "ids": np.array(ids, dtype=np.uint32),
        "names": np.array([grid.names[number] for number in ids], dtype=np.str_),
    }
    if grid.known is not None:
        arrays["known"] = grid.known
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def read_npz(path: str | PathLike[str] | bytes, *, max_voxels: int | None = None) -> VoxelGrid:
    """Read voxels from a ``.npz`` that `encode_npz` made.

    Args:
        path: the file, or its content.
        max_voxels: see `navbake.formats.voxels.read_voxels`.

    Raises:
        FormatError: it is no such file, broken, or needs more memory than it may.
    """
    data, source = read_bytes(path, begins=ZIP, expected="a .npz of voxels")
    allowance = VoxelAllowance.of_file(source, len(data), max_voxels)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy takes an array's header for Python, which warns
            arrays = _read_arrays(archive, allowance)
    except FormatError:
        raise
    except Exception as error:  # a broken archive raises whatever zipfile, zlib and numpy raise
        why = _why(error)
        raise FormatError(f"expected a .npz of voxels, {source} can't be read: {why}") from error
    for name in REQUIRED:
        if name not in arrays:
            if GRID in packed_names(data):
                raise FormatError(f"{source} holds a grid, no voxels: navbake.from_npz reads it")
            raise FormatError(f"expected voxels in {source}, it has no array `{name}`")
    try:
        return VoxelGrid(
            values=arrays["values"],
            origin=tuple(arrays["origin"].tolist()),
            res=float(arrays["res"]),
            names=_name_table(arrays),
            known=arrays.get("known"),
        )
    # SystemError: numpy makes text of code points beyond Unicode
    except (FormatError, OverflowError, SystemError, TypeError, ValueError) as error:
        raise FormatError(f"{source}: {error}") from error


def packed_names(data: bytes) -> set[str]:
    """The names of the arrays in an archive; none if it can't be read."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return {name.removesuffix(".npy") for name in archive.namelist()}
    except Exception:  # a broken archive raises whatever zipfile raises
        return set()


def _read_arrays(archive: zipfile.ZipFile, allowance: VoxelAllowance) -> dict[str, NDArray[Any]]:
    """The arrays that voxels have; what else is in the archive is not read."""
    members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
    arrays = {}
    for name in (*REQUIRED, *OPTIONAL):
        if name not in members:
            continue
        shape, dtype = read_array_header(archive, members[name])
        if name in GRIDS:
            allowance.take_voxels(shape, dtype.itemsize)
        elif math.prod(shape) > MAX_IDS:
            raise ValueError(f"`{name}` has {math.prod(shape)} entries")
        else:
            allowance.take_bytes(math.prod(shape) * dtype.itemsize)
        with archive.open(members[name]) as file:
            arrays[name] = np.lib.format.read_array(file, allow_pickle=False)
    return arrays


def read_npy(source: str | PathLike[str] | bytes) -> NDArray[Any]:
    """Read a single array (``.npy``) of at most 1 GiB. Nothing is unpickled: that could run code.

    Args:
        source: the file, or its content.

    Raises:
        FormatError: it is no such file, broken, or holds objects.
    """
    data, name = read_bytes(source, begins=NPY, expected="an array (.npy)", limit=MAX_NPY)
    file = io.BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy takes an array's header for Python, which warns
            _read_header(file, len(data), "the array")
            file.seek(0)
            array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
            return array
    except Exception as error:  # a broken header raises whatever Python's parser raises
        why = _why(error)
        raise FormatError(f"expected an array (.npy), {name} can't be read: {why}") from error


def read_array_header(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo
) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and dtype of an array; a ValueError if the archive has less than they need."""
    with archive.open(member) as file:
        return _read_header(file, member.file_size, f"`{member.filename}`")


def _read_header(file: Any, num_bytes: int, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and dtype of an array; a ValueError if they need more than so many bytes."""
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    elif version == (2, 0):
        shape, _, dtype = np.lib.format.read_array_header_2_0(file)
    else:
        raise ValueError(f"{name} has version {version} of the format")
    # numpy reserves what the header claims before it reads
    needed = math.prod(shape) * dtype.itemsize
    if any(n < 0 for n in shape) or dtype.hasobject or needed > num_bytes:
        raise ValueError(f"{name} does not hold {shape} values of {dtype}")
    return shape, dtype


def _why(error: Exception) -> str:
    """What an error says, on one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def _name_table(arrays: dict[str, NDArray[Any]]) -> dict[int, str]:
    """The names by ID; arrays of any dtype, as other programs may have them."""
    ids, names = arrays.get("ids", np.zeros(0)), arrays.get("names", np.zeros(0))
    if ids.shape != names.shape or ids.ndim != 1:
        raise ValueError(f"expected as many names as IDs, got {names.shape} for {ids.shape}")
    return {int(i): str(n) for i, n in zip(ids.tolist(), names.tolist(), strict=True)}
