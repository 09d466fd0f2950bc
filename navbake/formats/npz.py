"""NumPy files: archives of grids and of voxels, and single arrays. Nothing is unpickled.

A grid is stored completely. ``numpy.load("house.npz")`` has the layers of level 0 as
``0/weights``, ``0/floorHeight``, ``0/roomIndex`` and so on, shape (height, width), with the dtypes
that they have in memory. The array ``grid`` holds the other fields of a NavGrid file, and
``0/userData`` the level's user data; both are bytes of JSON in UTF-8.

An archive of voxels has ``values`` (nx, ny, nz), ``origin`` (3,) [m], ``res`` [m], ``ids`` and
``names``; and ``known`` if some voxels are unknown.
"""

from __future__ import annotations

import io
import re
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.formats import navgrid
from navbake.formats.allowance import (
    ABSENT,
    Allowance,
    JsonPath,
    check_json,
    check_number,
    check_object,
    check_optional_object,
    check_whole_number,
)
from navbake.formats.source import Files, parse_json, read_bytes, write_bytes
from navbake.navgrid.grid import MultiLevelGrid, NavGrid, SceneGrid2D
from navbake.navgrid.islands import with_current_islands
from navbake.types import Json
from navbake.voxels.distances import DistanceField
from navbake.voxels.grid import VoxelGrid

PathOrBytes: TypeAlias = str | PathLike[str] | bytes
"""A path, or a file's content."""

VERSION = 1  # of both kinds of archives
ZIP_MAGIC = b"PK"
NPY_MAGIC = b"\x93NUMPY"
GRID_MARKER = "grid"  # the array that marks archives of grids
# an attribute with such a name has an array of the same name
PLAIN_NAME = re.compile(r"(?!(weights|userData)$)[A-Za-z0-9_.-]{1,100}")


# ---------------------------------------------------------------- arrays of an archive


class Archive:
    """The arrays of an archive, read one by one within an `Allowance`.

    Attributes:
        allowance: what the arrays' memory is taken from.
        root_place: the archive's location, for errors.
    """

    def __init__(
        self, archive: zipfile.ZipFile, allowance: Allowance, root_place: JsonPath
    ) -> None:
        self._archive = archive
        self.allowance = allowance
        self.root_place = root_place
        self._members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}

    def __contains__(self, name: str) -> bool:
        return name in self._members

    def read(self, name: str, place: JsonPath, *, is_text: bool = False) -> NDArray[Any]:
        """Read an array of the archive, after subtracting its size from the allowance.

        Args:
            name: the array's name in the archive.
            place: the array's location, for errors.
            is_text: whether it counts as text, see `Allowance.take_text`, and not as an array.

        Raises:
            FormatError: there is no such array, or it is too large.
        """
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

    def read_text(self, name: str, place: JsonPath) -> bytes:
        """Read an array of bytes that holds a text; return the text.

        Args:
            name: the array's name in the archive.
            place: its location, for errors.

        Raises:
            FormatError: there is no such array, or it holds no bytes.
        """
        array = self.read(name, place, is_text=True)
        if array.dtype != np.uint8 or array.ndim != 1:
            place.fail(f"expected text as bytes, got {array.dtype} of {array.shape}")
        return array.tobytes()

    def read_layer(self, name: str, shape: tuple[int, int], place: JsonPath) -> NDArray[Any]:
        """Read an array that has a number for each cell.

        Args:
            name: the array's name in the archive.
            shape: height and width of the level.
            place: the array's location, for errors.

        Raises:
            FormatError: there is no such array, or its shape or kind is wrong.
        """
        array = self.read(name, place)
        if array.shape != shape or array.dtype.kind not in "biuf":
            actual_text = f"{array.dtype} of {array.shape}"
            place.fail(f"expected numbers of shape {shape}, got {actual_text}")
        return array


@contextmanager
def _convert_errors(expected: str, name: str) -> Iterator[None]:
    """Turn errors of zipfile, zlib and numpy into a FormatError: the content is broken."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about Python syntax in broken headers
            yield
    except FormatError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        message = f"expected {expected}, {name} can't be read: {reason}"
        raise FormatError(message, path=name, expected=expected) from error


def read_npy(source: PathOrBytes) -> NDArray[Any]:
    """Read a single array (``.npy``).

    Args:
        source: a path, or the file's content.

    Returns:
        The array, of the file's shape and dtype.

    Raises:
        FormatError: the file is no such array.
    """
    expected = "an array (.npy)"
    content, name = read_bytes(source, beginnings=NPY_MAGIC, expected=expected)
    with _convert_errors(expected, name):
        array: NDArray[Any] = np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    return array


@contextmanager
def open_archive(
    source: PathOrBytes, expected: str, keyword: str = "", limit: int | None = None
) -> Iterator[Archive]:
    """Open an archive whose arrays are read within an `Allowance` of memory.

    Args:
        source: a path, or the archive's content.
        expected: a description of the expected archive, for errors.
        keyword: the argument by which callers raise the limits, see `Allowance`.
        limit: the caller's value of that argument, None for the default limits.

    Yields:
        The archive.

    Raises:
        FormatError: the file can't be read or is broken, also while the archive is open.
    """
    content, name = read_bytes(source, beginnings=ZIP_MAGIC, expected=expected)
    with _convert_errors(expected, name), zipfile.ZipFile(io.BytesIO(content)) as zip_file:
        yield Archive(zip_file, Allowance(len(content), keyword, limit), JsonPath(name))


def _pack_arrays(arrays: Mapping[str, Any]) -> bytes:
    """Encode an archive; `arrays` maps the name of each array to it."""
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


# ---------------------------------------------------------------- voxels


def write_distances(field: DistanceField, path: str | PathLike[str]) -> None:
    """Write a distance field as ``.npz``: `DistanceField.save`.

    Args:
        field: the field.
        path: the file, which ends in ``.npz``.

    Raises:
        FormatError: the name has another ending, or the file cannot be written.
    """
    if not str(path).lower().endswith(".npz"):
        expected = "a name that ends in .npz"
        raise FormatError(f"expected {expected}, got {path}", value=path, expected=expected)
    arrays = {
        "distances": field.values,
        "origin": np.array(field.origin),
        "res": np.array(field.res),
        "is_signed": np.array(field.is_signed),
    }
    write_bytes(_pack_arrays(arrays), path)


def encode_npz(grid: VoxelGrid) -> bytes:
    """Encode voxels as ``.npz``: the arrays that the module's docstring lists.

    `VoxelGrid.notes` are not written.

    Raises:
        FormatError: the name of an ID ends in a null character, which the format drops.
    """
    voxel_ids = sorted(grid.names)
    if any(name.endswith("\0") for name in grid.names.values()):  # numpy pads texts with these
        raise FormatError("expected names of IDs that do not end in the character 0, got one")
    arrays: dict[str, NDArray[Any]] = {
        "version": np.array(VERSION, dtype=np.int64),
        "values": grid.values,
        "origin": np.array(grid.origin),
        "res": np.array(grid.res, dtype=np.float64),
        "ids": np.array(voxel_ids, dtype=np.uint32),
        "names": np.array([grid.names[voxel_id] for voxel_id in voxel_ids], dtype=np.str_),
    }
    if grid.known is not None:
        arrays["known"] = grid.known
    return _pack_arrays(arrays)


def read_npz(source: PathOrBytes, *, max_voxels: int | None = None) -> VoxelGrid:
    """Read voxels that `encode_npz` wrote.

    Args:
        source: a path, or the file's content.
        max_voxels: the largest number of voxels; None for 2**31, as far as memory allows, see
            `navbake.load_voxels`.

    Returns:
        The voxels.

    Raises:
        FormatError: the file holds no voxels, is broken, or needs too much memory.
    """
    with open_archive(source, "a .npz of voxels", "max_voxels", max_voxels) as archive:
        root_place = archive.root_place
        if GRID_MARKER in archive and "values" not in archive:
            message = f"{root_place.file} holds a grid, no voxels: navbake.from_npz reads it"
            raise FormatError(message, path=root_place.file, hint="navbake.from_npz reads it")
        values = archive.read("values", root_place)
        origin = archive.read("origin", root_place)
        res = archive.read("res", root_place)
        archive.allowance.take_cells(values.shape, root_place)
        ids = archive.read("ids", root_place) if "ids" in archive else np.zeros(0)
        names = archive.read("names", root_place) if "names" in archive else np.zeros(0)
        is_known = archive.read("known", root_place) if "known" in archive else None
        if ids.shape != names.shape or ids.ndim != 1:
            raise ValueError(f"expected as many names as IDs, got {names.shape} for {ids.shape}")
        id_name_pairs = zip(ids.tolist(), names.tolist(), strict=True)
        try:
            return VoxelGrid(
                values=values,
                origin=tuple(origin.tolist()),
                res=float(res),
                names={int(voxel_id): str(name) for voxel_id, name in id_name_pairs},
                known=is_known,
            )
        except FormatError as error:
            raise FormatError(f"{root_place.file}: {error}", path=root_place.file) from error


# ---------------------------------------------------------------- grids


def encode_grid_npz(grid: NavGrid, path: Path) -> Files:
    """Encode a grid as a lossless archive; equal grids have equal bytes.

    Args:
        grid: the grid.
        path: the path of the file.

    Returns:
        The file's content by its path.

    Raises:
        FormatError: a layer has no numbers, or the metadata, user data or extra fields have
            values that JSON lacks.
    """
    root_place = JsonPath("the grid to be written")
    grid = with_current_islands(grid)
    arrays: dict[str, NDArray[Any]] = {}
    document: Json = {
        "version": VERSION,
        "type": type(grid).__name__,
        **_encode_fields(grid, grid.metadata, root_place),
        "levels": [],
    }
    for level_number, level in enumerate(grid.levels):
        has_own_metadata = isinstance(grid, MultiLevelGrid) and not grid.inherits_metadata(
            level_number, level
        )
        place = root_place["levels"][level_number]
        # attribute -> name of its array: the same one if a zip file may contain it
        array_names = {
            name: name if PLAIN_NAME.fullmatch(name) else f"attribute {index}"
            for index, name in enumerate(level.attributes)
        }
        document["levels"].append(
            {
                **_encode_fields(level, level.metadata if has_own_metadata else None, place),
                "width": level.width,
                "height": level.height,
                "attributes": array_names,
                "min": level.min_yup,
                "bbox": level.bbox_yup,
            }
        )
        arrays[f"{level_number}/weights"] = level.weights
        for name, array in level.attributes.items():
            arrays[f"{level_number}/{array_names[name]}"] = array
        user_data = navgrid.encode_user_data(level, place["userData"])
        arrays[f"{level_number}/userData"] = np.frombuffer(user_data, dtype=np.uint8)
    for name, array in arrays.items():
        if array.dtype.kind not in "biuf":
            root_place[name].fail(f"expected numbers, got an array of {array.dtype}")
    try:
        text = orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY)
    except orjson.JSONEncodeError as error:
        raise FormatError(f"cannot write the grid as JSON: {error}") from error
    return {path: _pack_arrays({GRID_MARKER: np.frombuffer(text, dtype=np.uint8), **arrays})}


def _encode_fields(grid: NavGrid, metadata: Json | None, place: JsonPath) -> Json:
    """Encode the fields that a grid and its levels have in common."""
    navgrid.check_extra(grid.extra, type(grid), place["extra"])
    return {
        "cellSize": check_number(grid.cell_size, place["cellSize"], must_be_positive=True),
        "unit": check_number(grid.unit, place["unit"], must_be_positive=True),
        "metadata": check_json(metadata, place["metadata"]),
        "timings": check_json(grid.timings, place["timings"]),
        "extra": check_json(grid.extra, place["extra"]),
    }


def read_grid_npz(source: PathOrBytes, *, max_cells: int | None = None) -> NavGrid:
    """Read a grid from an archive that `encode_grid_npz` wrote.

    Args:
        source: a path, or the file's content.
        max_cells: the largest number of cells of all levels together; None for 100 million, as far
            as memory allows, see `navbake.load`.

    Returns:
        The grid, equal to the one that was written.

    Raises:
        FormatError: the file is no such archive, broken, or needs too much memory.
    """
    expected = "a .npz of a grid"
    with open_archive(source, expected, "max_cells", max_cells) as archive:
        root_place = archive.root_place
        allowance = archive.allowance
        if GRID_MARKER not in archive:
            hint = ": it holds voxels, navbake.load_voxels reads them"
            hint = hint if "values" in archive else ""
            message = f"expected {expected}, {root_place.file} has no array `{GRID_MARKER}`{hint}"
            raise FormatError(message, path=root_place.file, expected=expected)
        document = check_object(
            parse_json(archive.read_text(GRID_MARKER, root_place), root_place), root_place
        )
        version = check_whole_number(document.get("version", ABSENT), root_place["version"], 1)
        level_entries = document.get("levels", ABSENT)
        grid_type = document.get("type", ABSENT)
        if not isinstance(level_entries, list) or not level_entries:
            root_place["levels"].refuse("a list of levels", level_entries)
        levels = [
            _decode_level(archive, level_number, level_entry)
            for level_number, level_entry in enumerate(level_entries)
        ]
        if grid_type == "MultiLevelGrid":
            content = {**_merge_extra(document, MultiLevelGrid, root_place), "grids": levels}
            grid = navgrid.read_multi_level_grid(content, root_place, allowance, "levels")
            return navgrid.warn_of_newer_version(grid, root_place, version > VERSION)
        if grid_type != "SceneGrid2D" or len(level_entries) != 1:
            root_place["type"].refuse("'SceneGrid2D' of one level, or 'MultiLevelGrid'", grid_type)
        _check_extra_fields(document, SceneGrid2D, root_place)
        defaults = {"metadata": navgrid.read_metadata(document, root_place)}
        level = navgrid.read_level(levels[0], root_place["levels"][0], allowance, defaults)
        return navgrid.warn_of_newer_version(
            navgrid.check_grid(level, root_place), root_place, version > VERSION
        )


def _decode_level(archive: Archive, level_number: int, value: object) -> Json:
    """Return a level as in a NavGrid file; in place of its arrays are functions that read them."""
    place = archive.root_place["levels"][level_number]
    entry = check_object(value, place)
    array_names = check_object(entry.get("attributes", ABSENT), place["attributes"])
    corners = entry.get("bbox")
    if corners is not None and not (isinstance(corners, list) and len(corners) == 2):
        place["bbox"].refuse("two corners", corners)

    def make_reader(name: str) -> Callable[[tuple[int, int], JsonPath], NDArray[Any]]:
        return lambda shape, place: archive.read_layer(f"{level_number}/{name}", shape, place)

    return {
        **_merge_extra(entry, SceneGrid2D, place),
        "bbox": None if corners is None else {"min": corners[0], "max": corners[1]},
        "weights": make_reader("weights"),
        "tileAttributes": {attribute: make_reader(name) for attribute, name in array_names.items()},
        "userData": memoryview(archive.read_text(f"{level_number}/userData", place["userData"])),
    }


def _check_extra_fields(entry: Json, grid_class: type[NavGrid], place: JsonPath) -> Json:
    """Return an entry's extra fields, after a check that none is a field of the format."""
    extra = check_optional_object(entry, "extra", place)
    navgrid.check_extra(extra, grid_class, place["extra"])
    return extra


def _merge_extra(entry: Json, grid_class: type[NavGrid], place: JsonPath) -> Json:
    """Return an entry's fields and its extra fields in one object, as in a NavGrid file."""
    extra = _check_extra_fields(entry, grid_class, place)
    archive_fields = ("version", "extra", "levels", "attributes")
    fields = {key: value for key, value in entry.items() if key not in archive_fields}
    return {**extra, **fields}
