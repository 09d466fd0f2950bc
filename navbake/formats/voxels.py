"""Voxel files by their suffix, and the table of their IDs beside them."""

import json
import os
from os import PathLike
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from navbake.errors import FormatError
from navbake.formats.binvox import IdMapping, encode_binvox, read_binvox, with_mapping
from navbake.formats.convert import OCTREES, VOXELS
from navbake.formats.npz import encode_npz, read_npz
from navbake.formats.octomap import encode_octomap, read_octomap
from navbake.formats.source import check_path, path_name, read_bytes, write_bytes
from navbake.voxels.grid import VoxelGrid

RULE = "0 is empty; where several meet a voxel, the least ID is its"


def write_voxels(
    grid: VoxelGrid,
    path: str | PathLike[str],
    *,
    free: bool = False,
    layout: Literal["binvox", "airsim"] = "binvox",
    mapping: IdMapping | None = None,
) -> None:
    """Write a voxel file, and the table of its IDs' names beside it if it has any.

    `path` ends in ``.binvox``, ``.bt``, ``.ot`` or ``.npz``; the table of `a.npz` is
    `a.npz.names.json`. `free` is for octrees, see `encode_octomap`; `layout` and `mapping` for
    binvox, see `encode_binvox` and `with_mapping`. Raises a FormatError if the format can't hold
    the grid.
    """
    suffix = _check_suffix(path)
    if suffix in OCTREES:
        write_bytes(encode_octomap(grid, suffix[1:], free=free), path)
        return
    if suffix == ".binvox":
        mapped = with_mapping(grid, mapping)
        write_bytes(encode_binvox(mapped, layout), path)
        grid = mapped
    else:
        write_bytes(encode_npz(grid), path)
    if grid.is_segmented:
        ids = {str(number): grid.names[number] for number in sorted(grid.names)}
        table = json.dumps({"rule": RULE, "ids": ids}, indent=2, ensure_ascii=False)
        write_bytes(f"{table}\n".encode(), names_path(path))


def read_voxels(path: str | PathLike[str], *, max_voxels: int | None = None) -> VoxelGrid:
    """Read a voxel file, with the table of its IDs if it lies beside it.

    `path` ends in ``.binvox``, ``.bt``, ``.ot`` or ``.npz``. The grid has `max_voxels` at most; if
    None, 2**31, and no more memory than 256 MiB and 512 bytes for each byte of the file. Raises a
    FormatError if the file is broken, of an unknown format, or needs too much memory.
    """
    suffix = _check_suffix(path)
    if suffix == ".npz":
        return read_npz(path, max_voxels=max_voxels)
    if suffix != ".binvox":
        return read_octomap(path, max_voxels=max_voxels)
    grid, beside = read_binvox(path, max_voxels=max_voxels), names_path(path)
    if grid.is_segmented and os.path.lexists(beside):
        content, name = read_bytes(beside)
        try:
            grid.names = msgspec.json.decode(content, type=_Names).ids
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            message = f"expected a table of IDs, {path_name(name)} can't be read: {error}"
            raise FormatError(message) from error
    return grid


class _Names(msgspec.Struct):
    """The table of IDs' names in a file."""

    ids: dict[Annotated[int, msgspec.Meta(ge=0, lt=2**32)], str]


def _check_suffix(path: str | PathLike[str]) -> str:
    suffix = Path(check_path(path)).suffix.lower()
    if suffix not in VOXELS:
        raise FormatError(f"expected a name that ends in {', '.join(VOXELS)}, got {path}")
    return suffix


def names_path(path: str | PathLike[str]) -> Path:
    """The path of the table of a file's IDs: ``a.npz.names.json`` beside ``a.npz``."""
    return Path(f"{path}.names.json")
