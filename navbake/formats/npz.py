"""NumPy archives of grids, of voxels, and single arrays, read without unpickling.

A grid is stored completely. ``numpy.load("house.npz")`` has the layers of level 0 as
``0/weights``, ``0/floorHeight``, ``0/roomIndex`` and so on, shape (height, width), in their dtypes
in memory. ``grid`` is UTF-8 JSON, as bytes, with the other fields of a NavGrid file, and
``0/userData`` likewise the level's user data.

Voxels are ``values`` (nx, ny, nz), ``origin`` (3,) [m], ``res`` [m], ``ids`` and ``names``, and
``known`` if some are unknown.
"""

from __future__ import annotations

import io
import re
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.formats import navgrid
from navbake.formats.allowance import (
    MISSING,
    Allowance,
    JsonPath,
    check_json,
    check_number,
    check_object,
    check_optional_object,
    check_whole_number,
)
from navbake.formats.source import Files, parse_json, read_bytes
from navbake.navgrid.grid import MultiLevelGrid, NavGrid, SceneGrid2D
from navbake.types import Json
from navbake.voxels.grid import VoxelGrid

Content = str | PathLike[str] | bytes  # a file, or its content

VERSION = 1  # of both kinds of archives
ZIP = b"PK"
NPY = b"\x93NUMPY"
GRID = "grid"  # the array that marks archives of grids
REQUIRED = ("values", "origin", "res")  # of archives of voxels
PLAIN_NAME = re.compile(r"(?!(weights|userData)$)[A-Za-z0-9_.-]{1,100}")


# ---------------------------------------------------------------- arrays of an archive


class _Archive:
    """The arrays of an archive, read one by one within an allowance."""

    def __init__(self, archive: zipfile.ZipFile, allowance: Allowance, top: JsonPath) -> None:
        self._archive = archive
        self.allowance = allowance
        self.top = top
        self._members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}

    def __contains__(self, name: str) -> bool:
        return name in self._members

    def read(self, name: str, place: JsonPath, *, is_text: bool = False) -> NDArray[Any]:
        """Read an array within the allowance for arrays or for text."""
        if name not in self:
            place.fail(f"expected an array `{name}`, got nothing")
        member = self._members[name]
        if is_text:
            self.allowance.take_text(member.file_size, place)
        else:
            self.allowance.take_array((member.file_size,), 1, place)
        with self._archive.open(member) as file:
            array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
            return array

    def text(self, name: str, place: JsonPath) -> bytes:
        """The text in an array of bytes."""
        array = self.read(name, place, is_text=True)
        if array.dtype != np.uint8 or array.ndim != 1:
            place.fail(f"expected text as bytes, got {array.dtype} of {array.shape}")
        return array.tobytes()

    def layer(self, name: str, shape: tuple[int, int], place: JsonPath) -> NDArray[Any]:
        """An array with a value for each cell."""
        array = self.read(name, place)
        if array.shape != shape or array.dtype.kind not in "biuf":
            got = f"{array.dtype} of {array.shape}"
            place.fail(f"expected numbers of shape {shape}, got {got}")
        return array


@contextmanager
def _reading(expected: str, name: str) -> Iterator[None]:
    """Turn the errors of zipfile, zlib and numpy about broken content into a FormatError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of Python syntax in broken headers
            yield
    except FormatError:
        raise
    except Exception as error:
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(f"expected {expected}, {name} can't be read: {why}") from error


def read_npy(source: Content) -> NDArray[Any]:
    """Read a single array (``.npy``), a file or its content; raises a FormatError if it is none."""
    expected = "an array (.npy)"
    data, name = read_bytes(source, begins=NPY, expected=expected)
    with _reading(expected, name):
        array: NDArray[Any] = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    return array


@contextmanager
def open_archive(
    source: Content, expected: str, keyword: str = "", most: int | None = None
) -> Iterator[_Archive]:
    """Open an archive whose arrays are read within an allowance; faults are FormatErrors."""
    data, name = read_bytes(source, begins=ZIP, expected=expected)
    with _reading(expected, name), zipfile.ZipFile(io.BytesIO(data)) as packed:
        yield _Archive(packed, Allowance(len(data), keyword, most), JsonPath(name))


def _pack(arrays: Json) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


# ---------------------------------------------------------------- voxels


def encode_npz(grid: VoxelGrid) -> bytes:
    """Encode voxels as ``.npz``, without their notes; see the module's head."""
    ids = sorted(grid.names)
    if any(name.endswith("\0") for name in grid.names.values()):  # numpy pads texts with these
        raise FormatError("expected names of IDs that do not end in the character 0, got one")
    arrays: Json = {
        "version": np.int64(VERSION),
        "values": grid.values,
        "origin": np.array(grid.origin),
        "res": np.float64(grid.res),
        "ids": np.array(ids, dtype=np.uint32),
        "names": np.array([grid.names[number] for number in ids], dtype=np.str_),
    }
    return _pack(arrays if grid.known is None else {**arrays, "known": grid.known})


def read_npz(source: Content, *, max_voxels: int | None = None) -> VoxelGrid:
    """Read voxels of `encode_npz`; `max_voxels` is that of `navbake.load_voxels`."""
    with open_archive(source, "a .npz of voxels", "max_voxels", max_voxels) as archive:
        top = archive.top
        if GRID in archive and "values" not in archive:
            raise FormatError(f"{top.file} holds a grid, no voxels: navbake.from_npz reads it")
        values, origin, res = (archive.read(key, top) for key in REQUIRED)
        archive.allowance.take_cells(values.shape, top)
        ids = archive.read("ids", top) if "ids" in archive else None
        names = archive.read("names", top) if "names" in archive else None
        known = archive.read("known", top) if "known" in archive else None
        ids = np.zeros(0) if ids is None else ids
        names = np.zeros(0) if names is None else names
        if ids.shape != names.shape or ids.ndim != 1:
            raise ValueError(f"expected as many names as IDs, got {names.shape} for {ids.shape}")
        try:
            return VoxelGrid(
                values=values,
                origin=tuple(origin.tolist()),
                res=float(res),
                names={int(i): str(n) for i, n in zip(ids.tolist(), names.tolist(), strict=True)},
                known=known,
            )
        except FormatError as error:
            raise FormatError(f"{top.file}: {error}") from error


# ---------------------------------------------------------------- grids


def encode_grid_npz(grid: NavGrid, path: Path) -> Files:
    """Encode a grid as a lossless archive; equal grids have equal bytes."""
    top = JsonPath("the grid to be written")
    arrays: dict[str, NDArray[Any]] = {}
    document: Json = {
        "version": VERSION,
        "type": type(grid).__name__,
        **_facts(grid, grid.metadata, top),
        "levels": [],
    }
    for k, level in enumerate(grid.levels):
        is_own = isinstance(grid, MultiLevelGrid) and not grid.inherits_metadata(k, level)
        place = top["levels"][k]
        # arrays have their attributes' names if zip allows them
        names = {
            name: name if PLAIN_NAME.fullmatch(name) else f"attribute {i}"
            for i, name in enumerate(level.attributes)
        }
        document["levels"].append(
            _facts(level, level.metadata if is_own else None, place)
            | {"width": level.width, "height": level.height, "attributes": names}
            | {"min": level.min_yup, "bbox": level.bbox_yup}
        )
        arrays[f"{k}/weights"] = level.weights
        arrays |= {f"{k}/{names[name]}": array for name, array in level.attributes.items()}
        text = navgrid.encode_user_data(level, place["userData"])
        arrays[f"{k}/userData"] = np.frombuffer(text, dtype=np.uint8)
    for name, array in arrays.items():
        if array.dtype.kind not in "biuf":
            top[name].fail(f"expected numbers, got an array of {array.dtype}")
    try:
        text = orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY)
    except orjson.JSONEncodeError as error:
        raise FormatError(f"cannot write the grid as JSON: {error}") from error
    return {path: _pack({GRID: np.frombuffer(text, dtype=np.uint8), **arrays})}


def _facts(grid: NavGrid, metadata: Json | None, place: JsonPath) -> Json:
    navgrid.check_extra(grid.extra, type(grid), place["extra"])
    return {
        "cellSize": check_number(grid.cell_size, place["cellSize"], positive=True),
        "unit": check_number(grid.unit, place["unit"], positive=True),
        "metadata": check_json(metadata, place["metadata"]),
        "timings": check_json(grid.timings, place["timings"]),
        "extra": check_json(grid.extra, place["extra"]),
    }


def read_grid_npz(source: Content, *, max_cells: int | None = None) -> NavGrid:
    """Read a grid from an archive of `encode_grid_npz`, a file or its content; see `navbake.load`.

    Raises a FormatError if the file is no such archive, broken, or needs too much memory.
    """
    expected = "a .npz of a grid"
    with open_archive(source, expected, "max_cells", max_cells) as archive:
        top = archive.top
        allowance = archive.allowance
        if GRID not in archive:
            hint = ": it holds voxels, navbake.load_voxels reads them"
            hint = hint if "values" in archive else ""
            raise FormatError(f"expected {expected}, {top.file} has no array `{GRID}`{hint}")
        document = check_object(parse_json(archive.text(GRID, top), top), top)
        version = check_whole_number(document.get("version", MISSING), top["version"], 1)
        stated = document.get("levels", MISSING)
        kind = document.get("type", MISSING)
        if not isinstance(stated, list) or not stated:
            top["levels"].refuse("a list of levels", stated)
        levels = [_content(archive, k, entry) for k, entry in enumerate(stated)]
        if kind == "MultiLevelGrid":
            whole = _with_extra(document, MultiLevelGrid, top)
            house = navgrid.read_multi_level_grid(
                {**whole, "grids": levels}, top, allowance, "levels"
            )
            return navgrid.warn_of_newer(house, top, version > VERSION)
        if kind != "SceneGrid2D" or len(stated) != 1:
            top["type"].refuse("'SceneGrid2D' of one level, or 'MultiLevelGrid'", kind)
        _ = _with_extra(document, SceneGrid2D, top)
        whole = {"metadata": navgrid.read_metadata(document, top)}
        level = navgrid.check_grid(
            navgrid.read_level(levels[0], top["levels"][0], allowance, whole), top
        )
        return navgrid.warn_of_newer(level, top, version > VERSION)


def _content(archive: _Archive, k: int, value: object) -> Json:
    """A level as in a NavGrid file, with functions that read its layers."""
    place = archive.top["levels"][k]
    entry = check_object(value, place)
    members = check_object(entry.get("attributes", MISSING), place["attributes"])
    corners = entry.get("bbox")
    if corners is not None and not (isinstance(corners, list) and len(corners) == 2):
        place["bbox"].refuse("two corners", corners)

    def reader(member: str) -> Any:
        return lambda shape, at: archive.layer(f"{k}/{member}", shape, at)

    return {
        **_with_extra(entry, SceneGrid2D, place),
        "bbox": corners and dict(zip(("min", "max"), corners, strict=True)),
        "weights": reader("weights"),
        "tileAttributes": {name: reader(member) for name, member in members.items()},
        "userData": memoryview(archive.text(f"{k}/userData", place["userData"])),
    }


def _with_extra(entry: Json, kind: type[NavGrid], place: JsonPath) -> Json:
    """An entry's fields and its extra fields in one object."""
    extra = check_optional_object(entry, "extra", place)
    navgrid.check_extra(extra, kind, place["extra"])
    other = ("version", "extra", "levels", "attributes")
    return {**extra, **{key: value for key, value in entry.items() if key not in other}}
