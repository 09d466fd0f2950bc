"""NumPy archives: of grids, of voxels, and single arrays. Nothing is ever unpickled.

A grid is kept whole, each array as it is and all else as JSON in one of them.
``numpy.load("house.npz")`` finds the layers of level 0 as ``0/weights``, ``0/floorHeight``,
``0/roomIndex`` and so on, shape (height, width), in the dtypes that they have in memory. ``grid``
holds what is no array: UTF-8 JSON, as bytes, with the fields of a NavGrid file. ``0/userData``
holds the level's user data in the same way.

Voxels are ``values``, ``origin``, ``res``, and what the IDs stand for.
"""

from __future__ import annotations

import io
import math
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
from navbake.formats.allowance import Allowance
from navbake.formats.navgrid import check_extra, checked_grid
from navbake.formats.source import Files, parse_json, read_bytes
from navbake.formats.user_data import encode_user_data, read_user_data
from navbake.formats.values import (
    MISSING,
    JsonPath,
    json_object,
    number,
    optional_object,
    plain,
    vector,
    whole_number,
)
from navbake.navgrid.grid import MultiLevelGrid, NavGrid, SceneGrid2D
from navbake.types import Json, Vector3
from navbake.voxels.grid import VoxelGrid

Content = str | PathLike[str] | bytes  # a file, or its content

VERSION = 1  # of both kinds of archives
ZIP, NPY = b"PK", b"\x93NUMPY"
GRID = "grid"  # the array that only archives of grids have
REQUIRED = ("values", "origin", "res")  # that only archives of voxels have
MAX_IDS = 1 << 20  # entries of the table of IDs
PLAIN_NAME = re.compile(r"[A-Za-z0-9_.-]{1,100}")
RESERVED = ("weights", "userData")


# ---------------------------------------------------------------- arrays of an archive


class _Archive:
    """The arrays of an archive, read one by one within what it may fill."""

    def __init__(self, archive: zipfile.ZipFile, allowance: Allowance, top: JsonPath) -> None:
        self._archive, self.allowance, self.top = archive, allowance, top
        self._members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}

    def __contains__(self, name: str) -> bool:
        return name in self._members

    def header(self, name: str, place: JsonPath) -> tuple[tuple[int, ...], np.dtype[Any]]:
        """Shape and dtype of an array; a ValueError if the archive has less than they need."""
        if name not in self:
            place.fail(f"expected an array `{name}`, got nothing")
        member = self._members[name]
        with self._archive.open(member) as file:
            return _read_header(file, member.file_size, f"`{member.filename}`")

    def read(self, name: str, place: JsonPath) -> NDArray[Any]:
        """Read an array within the allowance."""
        shape, dtype = self.header(name, place)
        self.allowance.take_array(shape, dtype.itemsize, place)
        return self._load(name)

    def text(self, name: str, place: JsonPath) -> bytes:
        """The text that an array of bytes holds."""
        shape, dtype = self.header(name, place)
        if dtype != np.uint8 or len(shape) != 1:
            place.fail(f"expected text as bytes, got {dtype} of {shape}")
        self.allowance.take_text(shape[0], place)
        return self._load(name).tobytes()

    def layer(self, name: str, shape: tuple[int, int], place: JsonPath) -> NDArray[Any]:
        """An array with a value for each cell."""
        found, dtype = self.header(name, place)
        if found != shape or dtype.kind not in "biuf":
            place.fail(f"expected numbers of shape {shape}, got {dtype} of {found}")
        return self.read(name, place)

    def _load(self, name: str) -> NDArray[Any]:
        with self._archive.open(self._members[name]) as file:
            array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
            return array


@contextmanager
def _reading(expected: str, name: str) -> Iterator[None]:
    """Turn whatever zipfile, zlib and numpy raise about broken content into a FormatError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy takes an array's header for Python, which warns
            yield
    except FormatError:
        raise
    except Exception as error:
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(f"expected {expected}, {name} can't be read: {why}") from error


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


def read_npy(source: Content) -> NDArray[Any]:
    """Read a single array (``.npy``).

    Args:
        source: the file, or its content.

    Raises:
        FormatError: it is no such file, broken, or holds objects.
    """
    expected = "an array (.npy)"
    data, name = read_bytes(source, begins=NPY, expected=expected)
    file = io.BytesIO(data)
    with _reading(expected, name):
        _read_header(file, len(data), "the array")
        file.seek(0)
        array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return array


def _pack(arrays: Json) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


# ---------------------------------------------------------------- voxels


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
    return _pack(arrays if grid.known is None else {**arrays, "known": grid.known})


def read_npz(source: Content, *, max_voxels: int | None = None) -> VoxelGrid:
    """Read voxels from a ``.npz`` that `encode_npz` made.

    Args:
        source: the file, or its content.
        max_voxels: see `navbake.formats.voxels.read_voxels`.

    Raises:
        FormatError: it is no such file, broken, or needs more memory than it may.
    """
    expected = "a .npz of voxels"
    data, name = read_bytes(source, begins=ZIP, expected=expected)
    top, allowance = JsonPath(name), Allowance.of_voxels(len(data), max_voxels)
    with _reading(expected, name), zipfile.ZipFile(io.BytesIO(data)) as packed:
        archive = _Archive(packed, allowance, top)
        if GRID in archive and "values" not in archive:
            raise FormatError(f"{name} holds a grid, no voxels: navbake.from_npz reads it")
        allowance.take_cells(archive.header("values", top)[0], top)
        arrays = {key: archive.read(key, top) for key in REQUIRED}
        arrays |= {key: archive.read(key, top) for key in ("ids", "names") if key in archive}
        known = archive.read("known", top) if "known" in archive else None
        try:
            return VoxelGrid(
                values=arrays["values"],
                origin=tuple(arrays["origin"].tolist()),
                res=float(arrays["res"]),
                names=_name_table(arrays),
                known=known,
            )
        except FormatError as error:
            raise FormatError(f"{name}: {error}") from error


def _name_table(arrays: dict[str, NDArray[Any]]) -> dict[int, str]:
    """The names by ID; arrays of any dtype, as other programs may have them."""
    ids, names = arrays.get("ids", np.zeros(0)), arrays.get("names", np.zeros(0))
    if ids.shape != names.shape or ids.ndim != 1 or len(ids) > MAX_IDS:
        raise ValueError(f"expected as many names as IDs, got {names.shape} for {ids.shape}")
    return {int(i): str(n) for i, n in zip(ids.tolist(), names.tolist(), strict=True)}


# ---------------------------------------------------------------- grids


def encode_grid_npz(grid: NavGrid, path: Path) -> Files:
    """Make the archive of a grid: nothing is lost, and the same grid gives the same bytes.

    Raises:
        FormatError: metadata, user data or extra fields hold what JSON has not, or an extra field
            has the name of one of the format's own.
    """
    top = JsonPath("the grid to be written")
    arrays: dict[str, NDArray[Any]] = {}
    document: Json = {
        "version": VERSION,
        "type": type(grid).__name__,
        **_facts(grid, grid.metadata, top),
        "levels": [],
    }
    for k, level in enumerate(grid.levels):
        is_own = isinstance(grid, MultiLevelGrid) and not grid.takes_over(k, level)
        place = top["levels"][k]
        names = {name: _member(name, i) for i, name in enumerate(level.attributes)}
        document["levels"].append(
            _facts(level, level.metadata if is_own else None, place)
            | {"width": level.width, "height": level.height, "attributes": names}
            | {"min": level.min_yup, "bbox": level.bbox_yup}
        )
        arrays[f"{k}/weights"] = level.weights
        arrays |= {f"{k}/{names[name]}": array for name, array in level.attributes.items()}
        text = b"".join(encode_user_data(level, place["userData"]))
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
    check_extra(grid.extra, type(grid), place["extra"])
    return {
        "cellSize": number(grid.cell_size, place["cellSize"], positive=True),
        "unit": number(grid.unit, place["unit"], positive=True),
        "metadata": plain(metadata, place["metadata"]),
        "timings": plain(grid.timings, place["timings"]),
        "extra": plain(grid.extra, place["extra"]),
    }


def _member(name: str, index: int) -> str:
    """What an attribute's array is called in the archive: as itself where zip allows it."""
    is_plain = PLAIN_NAME.fullmatch(name) and name not in RESERVED
    return name if is_plain else f"attribute {index}"


def read_grid_npz(source: Content, *, max_cells: int | None = None) -> NavGrid:
    """Read a grid from an archive that `encode_grid_npz` made.

    Args:
        source: the file, or its content.
        max_cells: as of `navbake.load`.

    Raises:
        FormatError: it is no such file, broken, or needs more memory than it may.
    """
    expected = "a .npz of a grid"
    data, name = read_bytes(source, begins=ZIP, expected=expected)
    top = JsonPath(name)
    with _reading(expected, name), zipfile.ZipFile(io.BytesIO(data)) as packed:
        archive = _Archive(packed, Allowance.of_grid(len(data), max_cells), top)
        if GRID not in archive:
            hint = (
                ": it holds voxels, navbake.load_voxels reads them" if "values" in archive else ""
            )
            raise FormatError(f"expected {expected}, {name} has no array `{GRID}`{hint}")
        return checked_grid(_read_grid(archive, top), top)


def _read_grid(archive: _Archive, top: JsonPath) -> NavGrid:
    document = json_object(parse_json(archive.text(GRID, top), top), top)
    version = whole_number(document.get("version", MISSING), top["version"], 1)
    if version > VERSION:
        top["version"].refuse(f"{VERSION} at most: a newer navbake wrote it", version)
    stated = document.get("levels", MISSING)
    if not isinstance(stated, list) or not stated:
        top["levels"].refuse("a list of levels", stated)
    kind = document.get("type", MISSING)
    is_single = kind == "SceneGrid2D" and len(stated) == 1
    if not is_single and kind != "MultiLevelGrid":
        top["type"].refuse("'SceneGrid2D' of one level, or 'MultiLevelGrid'", kind)
    facts = _read_facts(document, SceneGrid2D if is_single else MultiLevelGrid, top)
    levels = [
        _read_level(archive, k, json_object(entry, top["levels"][k]), top["levels"][k])
        for k, entry in enumerate(stated)
    ]
    if is_single:
        levels[0].metadata = facts["metadata"]
        return levels[0]
    return MultiLevelGrid(grids=levels, **facts)


def _read_level(archive: _Archive, k: int, entry: Json, place: JsonPath) -> SceneGrid2D:
    width = whole_number(entry.get("width", MISSING), place["width"], 1)
    height = whole_number(entry.get("height", MISSING), place["height"], 1)
    archive.allowance.take_cells((width, height), place)
    shape = height, width
    members = json_object(entry.get("attributes", MISSING), place["attributes"])
    text = memoryview(archive.text(f"{k}/userData", place["userData"]))
    return SceneGrid2D(
        width=width,
        height=height,
        min_yup=vector(entry.get("min", MISSING), place["min"]),
        bbox_yup=_read_bbox(entry.get("bbox"), place["bbox"]),
        weights=archive.layer(f"{k}/weights", shape, place["weights"]),
        attributes={
            name: archive.layer(f"{k}/{member}", shape, place["attributes"][name])
            for name, member in members.items()
        },
        user_data=read_user_data(text, place["userData"], width * height),
        **_read_facts(entry, SceneGrid2D, place),
    )


def _read_facts(entry: Json, kind: type[NavGrid], place: JsonPath) -> Json:
    size, unit = entry.get("cellSize", MISSING), entry.get("unit", MISSING)
    facts: Json = {
        key: optional_object(entry, key, place) for key in ("metadata", "timings", "extra")
    }
    check_extra(facts["extra"], kind, place["extra"])
    optional_object(facts["metadata"], "navbake", place["metadata"])
    return {
        **facts,
        "cell_size": float(number(size, place["cellSize"], positive=True)),
        "unit": float(number(unit, place["unit"], positive=True)),
    }


def _read_bbox(value: object, place: JsonPath) -> tuple[Vector3, Vector3] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2:
        place.refuse("two corners", value)
    return vector(value[0], place[0]), vector(value[1], place[1])
