"""Voxels as a NumPy archive: ``values``, ``origin``, ``res``, and what the IDs stand for."""

import io
from os import PathLike

import numpy as np

from navbake.errors import FormatError
from navbake.formats.source import read_bytes
from navbake.types import Json
from navbake.voxels.grid import VoxelGrid

VERSION = 1


def encode_npz(grid: VoxelGrid) -> bytes:
    """Encode voxels as ``.npz``: everything but the notes is kept.

    It holds ``values`` (nx, ny, nz), ``origin`` (3,) [m], ``res`` [m], ``ids`` and ``names``,
    and ``known`` where not all is.
    """
    ids = sorted(grid.names)
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


def read_npz(path: str | PathLike[str]) -> VoxelGrid:
    """Read voxels from a ``.npz`` that `encode_npz` made."""
    data, _ = read_bytes(path)
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception as error:  # a broken archive raises whatever zipfile, zlib and numpy raise
        raise FormatError(f"expected a .npz of voxels, {path} can't be read: {error}") from error
    for name in ("values", "origin", "res"):
        if name not in arrays:
            raise FormatError(f"expected voxels in {path}, it has no array `{name}`")
    try:
        ids, names = arrays.get("ids", np.zeros(0)), arrays.get("names", np.zeros(0))
        table = {int(i): str(n) for i, n in zip(ids.tolist(), names.tolist(), strict=True)}
        return VoxelGrid(
            values=arrays["values"],
            origin=tuple(arrays["origin"].tolist()),
            res=float(arrays["res"]),
            names=table,
            known=arrays.get("known"),
        )
    except (FormatError, TypeError, ValueError) as error:
        raise FormatError(f"{path}: {error}") from error
