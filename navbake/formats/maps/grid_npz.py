"""A grid as a NumPy archive: each array as it is, and all else as JSON in one of them.

``numpy.load("house.npz")`` finds the layers of level 0 as ``0/weights``, ``0/floorHeight``,
``0/roomIndex`` and so on, shape (height, width), in the dtypes that they have in memory. ``grid``
holds what is no array: UTF-8 JSON, as bytes, with the fields of a NavGrid file. ``0/userData``
holds the level's user data in the same way. Nothing is pickled.
"""

from __future__ import annotations

import io
import math
import re
import warnings
import zipfile
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.formats.arrays import Allowance
from navbake.formats.json_path import MISSING, JsonPath
from navbake.formats.navgrid import check_extra
from navbake.formats.npz import GRID, ZIP, packed_names, read_array_header
from navbake.formats.source import UNPACKED_BYTES, UNPACKED_RATIO, Files, read_bytes
from navbake.formats.user_data import UnreadPiece, encode_user_data, parse_json, read_user_data
from navbake.formats.values import json_object, number, plain, vector, whole_number
from navbake.navgrid.grid import MultiLevelGrid, NavGrid, SceneGrid2D
from navbake.navgrid.lattice import FARTHEST, LEAST_EDGE
from navbake.types import Json, Vector3

VERSION = 1
MAX_JSON = 256 << 20  # of what is no array, each [bytes]
MAX_LEVELS = 10_000
PLAIN_NAME = re.compile(r"[A-Za-z0-9_.-]{1,100}")
RESERVED = ("weights", "userData")


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
    file = io.BytesIO()
    members: Any = {GRID: np.frombuffer(text, dtype=np.uint8), **arrays}
    np.savez_compressed(file, **members)
    return {path: file.getvalue()}


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


def read_grid_npz(source: str | PathLike[str] | bytes, *, max_cells: int | None = None) -> NavGrid:
    """Read a grid from an archive that `encode_grid_npz` made.

    Args:
        source: the file, or its content.
        max_cells: as of `navbake.load`.

    Raises:
        FormatError: it is no such file, broken, or needs more memory than it may.
    """
    data, name = read_bytes(source, begins=ZIP, expected="a .npz of a grid")
    if GRID not in (names := packed_names(data)):
        hint = ": it holds voxels, navbake.load_voxels reads them" if "values" in names else ""
        raise FormatError(f"expected a .npz of a grid, {name} has no array `{GRID}`{hint}")
    top, allowance = JsonPath(name), Allowance.of_file(len(data), max_cells)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy takes an array's header for Python, which warns
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            most_text = max(UNPACKED_BYTES, UNPACKED_RATIO * len(data))
            return _read_grid(_Archive(archive, members, allowance, most_text), top)
    except FormatError:
        raise
    except Exception as error:  # a broken archive raises whatever zipfile, zlib and numpy raise
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(f"expected a .npz of a grid, {name} can't be read: {why}") from error


class _Archive:
    """The arrays of an archive, read one by one within what it may fill."""

    def __init__(
        self,
        archive: zipfile.ZipFile,
        members: dict[str, zipfile.ZipInfo],
        allowance: Allowance,
        most_text: int,
    ) -> None:
        self._archive, self._members, self.allowance = archive, members, allowance
        self._text_left = most_text

    def text(self, name: str, place: JsonPath) -> bytes:
        """The text that an array of bytes holds."""
        shape, dtype = self._header(name, place)
        if dtype != np.uint8 or len(shape) != 1 or shape[0] > MAX_JSON:
            place.fail(f"expected text of at most {MAX_JSON:,} bytes, got {dtype} of {shape}")
        self._text_left -= shape[0]
        if self._text_left < 0:
            place.fail("more text than a file of this size may unpack to")
        return self._read(name).tobytes()

    def layer(self, name: str, shape: tuple[int, int], place: JsonPath) -> NDArray[Any]:
        """An array with a value for each cell."""
        found, dtype = self._header(name, place)
        if found != shape or dtype.kind not in "biuf":
            place.fail(f"expected numbers of shape {shape}, got {dtype} of {found}")
        self.allowance.take_values(math.prod(shape), place)
        return self._read(name)

    def _header(self, name: str, place: JsonPath) -> tuple[tuple[int, ...], np.dtype[Any]]:
        if name not in self._members:
            place.fail(f"expected an array `{name}`, got nothing")
        return read_array_header(self._archive, self._members[name])

    def _read(self, name: str) -> NDArray[Any]:
        with self._archive.open(self._members[name]) as file:
            return np.lib.format.read_array(file, allow_pickle=False)


def _read_grid(archive: _Archive, top: JsonPath) -> NavGrid:
    document = json_object(parse_json(archive.text(GRID, top), top), top)
    version = whole_number(document.get("version", MISSING), top["version"], 1)
    if version > VERSION:
        top["version"].refuse(f"{VERSION} at most: a newer navbake wrote it", version)
    stated = document.get("levels", MISSING)
    if not isinstance(stated, list) or not 1 <= len(stated) <= MAX_LEVELS:
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
        grid: NavGrid = levels[0]
    else:
        grid = MultiLevelGrid(grids=levels, **facts)
    try:
        _ = grid.link_array, grid.doors, grid.stated_rooms  # checks them
    except FormatError as error:
        raise FormatError(f"{error} in {top.file}") from None
    return grid


def _read_level(archive: _Archive, k: int, entry: Json, place: JsonPath) -> SceneGrid2D:
    width = whole_number(entry.get("width", MISSING), place["width"], 1)
    height = whole_number(entry.get("height", MISSING), place["height"], 1)
    archive.allowance.take_cells(width * height, place)
    shape = height, width
    members = json_object(entry.get("attributes", MISSING), place["attributes"])
    archive.allowance.check_values((len(members) + 1) * width * height, place["attributes"])
    text = archive.text(f"{k}/userData", place["userData"])
    level = SceneGrid2D(
        width=width,
        height=height,
        min_yup=vector(entry.get("min", MISSING), place["min"]),
        bbox_yup=_read_bbox(entry.get("bbox"), place["bbox"]),
        weights=archive.layer(f"{k}/weights", shape, place["weights"]),
        attributes={
            name: archive.layer(f"{k}/{member}", shape, place["attributes"][name])
            for name, member in members.items()
        },
        user_data=read_user_data(
            UnreadPiece(text, 1, 1, place["userData"]), place["userData"], width * height
        ),
        **_read_facts(entry, SceneGrid2D, place),
    )
    edge = level.lattice.cell_size
    if not edge >= LEAST_EDGE:
        place.fail(f"expected cells of {LEAST_EDGE:g} m or more, got {edge:g} m")
    if not all(abs(value) <= FARTHEST for value in (*level.lattice.bounds, level.ground)):
        place.fail(f"expected a level within {FARTHEST:g} m of the origin, got one beyond")
    return level


def _read_facts(entry: Json, kind: type[NavGrid], place: JsonPath) -> Json:
    facts: Json = {
        "cell_size": float(
            number(entry.get("cellSize", MISSING), place["cellSize"], positive=True)
        ),
        "unit": float(number(entry.get("unit", MISSING), place["unit"], positive=True)),
    }
    for key in ("metadata", "timings", "extra"):
        value = entry.get(key)
        facts[key] = json_object({} if value is None else plain(value, place[key]), place[key])
    check_extra(facts["extra"], kind, place["extra"])
    own = facts["metadata"].get("navbake")
    if own is not None:
        json_object(own, place["metadata"]["navbake"])
    return facts


def _read_bbox(value: object, place: JsonPath) -> tuple[Vector3, Vector3] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2:
        place.refuse("two corners", value)
    return vector(value[0], place[0]), vector(value[1], place[1])
