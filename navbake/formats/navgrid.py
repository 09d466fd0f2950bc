"""The NavGrid format: SceneGrid2D and MultiLevelGrid JSON, read and written.

What the format does not know is kept and written back: fields of a grid, of its levels and of
its metadata, and further tile attributes; not so fields inside of an array or a bbox.
"""

from __future__ import annotations

import gzip
import io
import math
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from typing import Any, BinaryIO

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.doors import check_doors
from navbake.errors import FormatError
from navbake.files import write_whole
from navbake.formats.arrays import (
    MISSING,
    Allowance,
    Place,
    decode_array,
    encode_array,
    shown,
    whole_number,
)
from navbake.grid import MultiLevelGrid, NavGrid, SceneGrid2D, Vector3
from navbake.grid_base import Json
from navbake.rooms_table import describe_rooms

MAX_CELLS = 100_000_000
VALUES_PER_CELL = 16  # arrays that a grid of MAX_CELLS may have; a smaller one may have more
MAX_BYTES = 4 << 30  # of JSON
UNPACKED_BYTES = 64 << 20  # what any gzipped file may unpack to; beyond it, UNPACKED_RATIO counts
UNPACKED_RATIO = 200
MAX_DEPTH = 64  # of metadata, userData, timings and unknown fields
CHUNK = 1 << 20
LEAVES = {str, int, bool, type(None)}  # what JSON holds as it is
NODES = {dict, list, tuple}

SCENE_FIELDS = (
    *("type", "metadata", "weights", "userData", "tileAttributes", "width", "height"),
    *("cellSize", "min", "unit", "bbox", "timings"),
)
MULTI_FIELDS = ("type", "metadata", "cellSize", "unit", "grids", "timings")


def read_navgrid(
    source: str | os.PathLike[str] | bytes | BinaryIO, *, max_cells: int = MAX_CELLS
) -> NavGrid:
    """Read a NavGrid file, plain or gzipped (which its content tells, not its name).

    ``type``, ``width``, ``height``, ``cellSize`` and ``min`` must be there (a level takes
    ``cellSize`` and ``unit`` over from its MultiLevelGrid); the rest may be missing. Without
    ``weights``, a cell weighs 1 where its occupancy is 0 and its floor is known, as far as the
    file has these attributes. ``null`` is infinity in weights and NaN in float attributes, in
    raw data too, where the original client leaves it as it is.

    Args:
        source: a path, a file's content, or a file opened in binary mode.
        max_cells: most cells that all levels together may have.

    Raises:
        FormatError: the file can't be read or does not follow the format.
    """
    with _open(source) as (stream, name):
        top = Place(name)
        text = _read_bytes(stream, top)
    content = _parse(text, top)
    allowance = Allowance(max_cells, max_cells, VALUES_PER_CELL * max_cells)
    kind = content.get("type", MISSING)
    if kind == "SceneGrid2D":
        return _check_own(_read_level(content, top, allowance, {}, {}), top)
    if kind == "MultiLevelGrid":
        return _check_own(_read_levels(content, top, allowance), top)
    top["type"].refuse("'SceneGrid2D' or 'MultiLevelGrid'", kind)


def write_navgrid(grid: NavGrid, path: str | os.PathLike[str]) -> None:
    """Write a NavGrid file, gzipped if its name ends in ``.gz``; the same grid, the same bytes.

    The file is there as a whole or not at all: it is written under another name in the same
    folder and then renamed.

    Raises:
        FormatError: the grid holds what the format can't, or the path can't be written.
    """
    data = dumps_navgrid(grid)
    if os.fspath(path).lower().endswith(".gz"):
        packed = io.BytesIO()
        with gzip.GzipFile("", "wb", compresslevel=6, fileobj=packed, mtime=0) as file:
            file.write(data)
        data = packed.getvalue()
    try:
        write_whole(data, path)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        reason = _reason(error)
        if isinstance(error, FileNotFoundError):
            reason = f"there is no folder {_named(os.path.dirname(os.path.realpath(path)))}"
        raise FormatError(f"cannot write {_named(path)}: {reason}") from error


def dumps_navgrid(grid: NavGrid) -> bytes:
    """Encode a grid as NavGrid JSON, arrays as runs.

    NaN and infinity in arrays become ``null``, so that weights come back as finite or inf and
    floats of attributes as finite or NaN. ``cellAttributes`` lists the attributes that there
    are. A level that can take over the metadata of its MultiLevelGrid has none in the file.

    Raises:
        FormatError: NaN or infinity outside of arrays, a dtype that the format has not, or
            something in the metadata, user data or extra fields that JSON has not.
    """
    top = Place("the grid to be written")
    if isinstance(grid, SceneGrid2D):
        fields = _level_fields(grid, top, grid.metadata)
    else:
        _ = grid.links  # checks them
        fields = {
            "type": "MultiLevelGrid",
            "metadata": _metadata(grid, top),
            "cellSize": _number(grid.cell_size, top["cellSize"], positive=True),
            "unit": _number(grid.unit, top["unit"], positive=True),
            "grids": [
                _level_fields(level, top["grids"][i], _own_metadata(level, grid))
                for i, level in enumerate(grid.grids)
            ],
            "timings": _plain(grid.timings, top["timings"]),
        } | _extra(grid.extra, MULTI_FIELDS, top)
    return _dump(fields, top) + b"\n"


# Reading


@contextmanager
def _open(source: str | os.PathLike[str] | bytes | BinaryIO) -> Iterator[tuple[BinaryIO, str]]:
    """Open a source; what the system refuses becomes a FormatError."""
    if isinstance(source, bytes | bytearray | memoryview):
        yield io.BytesIO(source), "the bytes given"
    elif isinstance(source, str | os.PathLike):
        try:
            with open(source, "rb") as file:
                yield file, os.fspath(source)
        except (OSError, ValueError) as error:  # ValueError: a path with a NUL
            raise FormatError(f"cannot read {_named(source)}: {_reason(error)}") from error
    else:
        yield source, str(getattr(source, "name", "the stream given"))


def _read_bytes(stream: BinaryIO, top: Place) -> bytearray:
    """Read and unpack a file, up to what such a file may hold."""
    head = stream.read(CHUNK)
    if not isinstance(head, bytes):
        top.fail("expected a file opened in binary mode, got text")
    if not head.startswith(b"\x1f\x8b"):
        _check_head(head, top)
        return _read_rest(head, stream, MAX_BYTES, top)
    packed = _read_rest(head, stream, MAX_BYTES, top)
    limit = min(MAX_BYTES, max(UNPACKED_BYTES, UNPACKED_RATIO * len(packed)))
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(packed)) as unpacked:
            head = unpacked.read(CHUNK)
            _check_head(head, top)
            return _read_rest(head, unpacked, limit, top)
    except (EOFError, OSError, zlib.error) as error:
        raise FormatError(f"broken gzip data in {top.file}: {_reason(error)}") from error


def _check_head(head: bytes, top: Place) -> None:
    """Turn away what is no JSON object before the rest is read; a device has no end."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip(b" \t\r\n")
    if not head:
        top.fail("expected a NavGrid JSON object, got nothing")
    if text and not text.startswith(b"{"):
        top.fail(f"expected a NavGrid JSON object, got {shown(text[:8])[1:]}…")


def _read_rest(head: bytes, stream: BinaryIO | gzip.GzipFile, limit: int, top: Place) -> bytearray:
    content = bytearray(head)
    while chunk := stream.read(CHUNK):
        content += chunk
        if len(content) > limit:
            remedy = "" if limit == MAX_BYTES else "unpack it first if that is meant"
            top.fail(f"more than {limit >> 20} MiB of data", remedy)
    return content


def _parse(content: bytearray, top: Place) -> Json:
    if content.startswith(b"\xef\xbb\xbf"):
        del content[:3]
    try:
        parsed = orjson.loads(content)
    except orjson.JSONDecodeError as error:
        near = error.doc[error.pos : error.pos + 9].lstrip("-")
        hint = "; NaN and Infinity are no JSON, write null" if near[:3] in ("NaN", "Inf") else ""
        position = f"line {error.lineno}, column {error.colno}"
        raise FormatError(f"broken JSON in {top.file}, {position}: {error.msg}{hint}") from error
    return _object(parsed, top)


def _read_levels(content: Json, top: Place, allowance: Allowance) -> MultiLevelGrid:
    grids = content.get("grids", MISSING)
    if not isinstance(grids, list) or not grids:
        top["grids"].refuse("a list of at least one level", grids)
    metadata = _read_metadata(content, top)
    inherited = {key: content[key] for key in ("cellSize", "unit") if content.get(key) is not None}
    for key in inherited:
        _number(inherited[key], top[key], positive=True)
    levels = []
    for i, value in enumerate(grids):
        place = top["grids"][i]
        level = _object(value, place)
        if level.get("type", "SceneGrid2D") != "SceneGrid2D":
            place["type"].refuse("'SceneGrid2D'", level["type"])
        levels.append(_read_level(level, place, allowance, inherited, metadata))
    grid = MultiLevelGrid(
        grids=levels,
        cell_size=float(inherited.get("cellSize", levels[0].cell_size)),
        unit=float(inherited.get("unit", 1)),
        metadata=metadata,
        timings=_optional(content, "timings", top),
        extra=_unknown(content, MULTI_FIELDS, top),
    )
    return grid


def _check_own(grid: NavGrid, top: Place) -> NavGrid:
    """Check what navbake itself adds to the metadata: links, rooms, doors."""
    try:
        _ = grid.links
        check_doors(grid.navbake.get("doors", []), [level.weights.size for level in grid.levels])
        if "rooms" in grid.navbake:
            describe_rooms(grid)
    except FormatError as error:
        raise FormatError(f"{error} in {top.file}") from None
    return grid


def _read_level(
    content: Json, place: Place, allowance: Allowance, inherited: Json, metadata: Json
) -> SceneGrid2D:
    own_metadata = _read_metadata(content, place) or metadata
    width = whole_number(content.get("width", MISSING), place["width"], 1)
    height = whole_number(content.get("height", MISSING), place["height"], 1)
    allowance.take_cells(width * height, place)
    cell_size = _inherit(content, "cellSize", inherited, MISSING, place)
    unit = _inherit(content, "unit", inherited, 1, place)
    attributes = _read_attributes(content, place, width, height, allowance, own_metadata)
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=cell_size,
        min_yup=_vector(content.get("min", MISSING), place["min"]),
        bbox_yup=_read_bbox(content, place),
        unit=unit,
        weights=_read_weights(content, place, width, height, allowance, attributes),
        attributes=attributes,
        user_data=_read_user_data(content, place, width * height),
        metadata=own_metadata,
        timings=_optional(content, "timings", place),
        extra=_unknown(content, SCENE_FIELDS, place),
    )


def _inherit(content: Json, key: str, inherited: Json, default: object, place: Place) -> float:
    value = content.get(key)
    if value is None:
        value = inherited.get(key, default)
    return float(_number(value, place[key], positive=True))


def _read_metadata(content: Json, place: Place) -> Json:
    metadata = _optional(content, "metadata", place)
    place = place["metadata"]
    _optional(metadata, "navbake", place)
    entries = metadata.get("cellAttributes")
    if entries is not None:
        if not isinstance(entries, list):
            place["cellAttributes"].refuse("a list", entries)
        for i, entry in enumerate(entries):
            where = place["cellAttributes"][i]
            name = _object(entry, where).get("name", MISSING)
            if not isinstance(name, str):
                where["name"].refuse("a string", name)
    return metadata


def _read_attributes(
    content: Json, place: Place, width: int, height: int, allowance: Allowance, metadata: Json
) -> dict[str, NDArray[Any]]:
    types = {entry["name"]: entry.get("type") for entry in metadata.get("cellAttributes") or []}
    stored = content.get("tileAttributes")
    place = place["tileAttributes"]
    return {
        name: decode_array(
            value,
            place[name],
            num_cells=width * height,
            allowance=allowance,
            default=types.get(name),
        ).reshape(height, width)
        for name, value in _object({} if stored is None else stored, place).items()
    }


def _read_weights(
    content: Json,
    place: Place,
    width: int,
    height: int,
    allowance: Allowance,
    attributes: dict[str, NDArray[Any]],
) -> NDArray[np.float64]:
    if content.get("weights") is not None:
        read = decode_array(
            content["weights"],
            place["weights"],
            num_cells=width * height,
            allowance=allowance,
            null=math.inf,
        )
        return read.astype(np.float64, copy=False).reshape(height, width)
    allowance.take_values(width * height, place)
    weights = np.ones((height, width))
    if "occupancy" in attributes:
        weights[attributes["occupancy"] != 0] = np.inf
    if "floorHeight" in attributes:
        weights[~np.isfinite(attributes["floorHeight"])] = np.inf
    return weights


def _read_bbox(content: Json, place: Place) -> tuple[Vector3, Vector3] | None:
    place = place["bbox"]
    value = content.get("bbox")
    if value is None:
        return None
    box = _object(value, place)
    return (
        _vector(box.get("min", MISSING), place["min"]),
        _vector(box.get("max", MISSING), place["max"]),
    )


def _read_user_data(content: Json, place: Place, num_cells: int) -> dict[int, Json]:
    stored = _optional(content, "userData", place)
    place = place["userData"]
    ids = [int(key) if key.isdecimal() and len(key) <= 15 else -1 for key in stored]
    for key, cell_id in zip(stored, ids, strict=True):
        if not 0 <= cell_id < num_cells or str(cell_id) != key:
            place.fail(f"expected a cell's id from 0 to {num_cells - 1} as key, got {shown(key)}")
    user_data = dict(zip(ids, stored.values(), strict=True))
    if not set(map(type, stored.values())) <= {dict}:
        cell_id = next(i for i in ids if not isinstance(user_data[i], dict))
        place[cell_id].refuse("an object", user_data[cell_id])
    return user_data


def _optional(content: Json, key: str, place: Place) -> Json:
    """Read an object that may be missing or null."""
    value = content.get(key)
    return {} if value is None else _object(_plain(value, place[key]), place[key])


def _unknown(content: Json, known: tuple[str, ...], place: Place) -> Json:
    return {key: _plain(content[key], place[key]) for key in content if key not in known}


# Both ways


def _object(value: object, place: Place) -> Json:
    if not isinstance(value, dict):
        place.refuse("an object", value)
    return value


def _number(value: object, place: Place, *, positive: bool = False) -> float:
    """Check a finite number; the whole ones come back as int, as they look best in JSON."""
    expected = "a number > 0" if positive else "a finite number"
    if isinstance(value, bool | np.bool_) or not isinstance(
        value, int | float | np.integer | np.floating
    ):
        place.refuse(expected, value)
    number = float(value)
    if not math.isfinite(number) or (positive and number <= 0):
        place.refuse(expected, value)
    return int(number) if number.is_integer() and abs(number) < 2**53 else number


def _vector(value: object, place: Place) -> Vector3:
    if not isinstance(value, list | tuple) or len(value) != 3:
        place.refuse("three numbers", value)
    x, y, z = (float(_number(number, place[i])) for i, number in enumerate(value))
    return x, y, z


def _plain(value: Any, place: Place) -> Any:
    """Check that a value is JSON and not too deep; layer by layer, which is fast."""
    layer = [value]
    for _ in range(MAX_DEPTH):
        if set(map(type, layer)) <= LEAVES:
            return value
        odd = [v for v in layer if type(v) not in LEAVES and type(v) not in NODES]
        if not all(map(_is_json, odd)):
            _refuse_leaf(value, place)
        objects = [v for v in layer if isinstance(v, dict)]
        if not set(map(type, chain.from_iterable(objects))) <= {str}:
            place.fail("expected strings as keys of objects, got others")
        lists = [v for v in layer if isinstance(v, list | tuple)]
        layer = list(chain.from_iterable([*map(dict.values, objects), *lists]))
    place.fail(f"nested deeper than {MAX_DEPTH} levels")


def _is_json(value: object) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    return value is None or isinstance(value, str | int | dict | list | tuple)


def _refuse_leaf(value: Any, place: Place) -> None:
    """Find the first value that is not JSON, and name it."""
    if isinstance(value, dict):
        for key in value:
            _refuse_leaf(value[key], place[str(key)])
    elif isinstance(value, list | tuple):
        for i, child in enumerate(value):
            _refuse_leaf(child, place[i])
    elif isinstance(value, float) and not math.isfinite(value):
        place.refuse("a finite number", value)
    elif not _is_json(value):
        place.fail(f"expected a JSON value, got one of Python's type {type(value).__name__}")


# Writing


def _level_fields(grid: SceneGrid2D, place: Place, metadata: Json | None) -> Json:
    fields: Json = {"type": "SceneGrid2D"}
    if metadata is not None:
        fields["metadata"] = _metadata(grid, place)
    attributes = place["tileAttributes"]
    fields |= {
        "weights": _runs(grid, grid.weights.astype(np.float64, copy=False), place["weights"]),
        "userData": _user_data(grid, place["userData"]),
        "tileAttributes": {
            name: _runs(grid, array, attributes[name], array.dtype.name)
            for name, array in grid.attributes.items()
        },
        "width": whole_number(int(grid.width), place["width"], 1),
        "height": whole_number(int(grid.height), place["height"], 1),
        "cellSize": _number(grid.cell_size, place["cellSize"], positive=True),
        "min": [_number(value, place["min"][i]) for i, value in enumerate(grid.min_yup)],
        "unit": _number(grid.unit, place["unit"], positive=True),
    }
    if grid.bbox_yup is not None:
        fields["bbox"] = {
            key: [_number(value, place["bbox"][key][i]) for i, value in enumerate(corner)]
            for key, corner in zip(("min", "max"), grid.bbox_yup, strict=True)
        }
    fields["timings"] = _plain(grid.timings, place["timings"])
    return fields | _extra(grid.extra, SCENE_FIELDS, place)


def _runs(
    grid: SceneGrid2D, array: NDArray[Any], place: Place, datatype: str | None = None
) -> Json:
    if array.shape != grid.shape:
        place.fail(f"expected shape (height, width) = {grid.shape}, got {array.shape}")
    data = orjson.Fragment(encode_array(array, place["data"]))
    stated = {} if datatype is None else {"datatype": datatype}
    return {"type": "array", **stated, "length": array.size, "encoding": "rle", "data": data}


def _user_data(grid: SceneGrid2D, place: Place) -> orjson.Fragment:
    """User data by ascending cell id; entries that cells share are checked and encoded once."""
    num_cells = grid.width * grid.height
    distinct: dict[int, tuple[int, Json]] = {}
    for cell_id, value in grid.user_data.items():
        if not isinstance(cell_id, int | np.integer) or not 0 <= cell_id < num_cells:
            place.fail(f"expected cell ids from 0 to {num_cells - 1}, got {shown(cell_id)}")
        if not isinstance(value, dict):
            place[int(cell_id)].refuse("an object", value)
        distinct.setdefault(id(value), (int(cell_id), value))
    _plain({str(cell_id): value for cell_id, value in distinct.values()}, place)
    encoded = {key: orjson.dumps(value) for key, (_, value) in distinct.items()}
    entries = [
        b'"%d":%b' % (cell_id, encoded[id(grid.user_data[cell_id])])
        for cell_id in sorted(grid.user_data)
    ]
    return orjson.Fragment(b"{%b}" % b",".join(entries))


def _metadata(grid: NavGrid, place: Place) -> Json:
    """The grid's metadata with ``cellAttributes`` of the arrays that are there."""
    place = place["metadata"]
    _optional(grid.metadata, "navbake", place)
    return _object(_plain({**grid.metadata, "cellAttributes": grid.cell_attributes}, place), place)


def _own_metadata(level: SceneGrid2D, grid: MultiLevelGrid) -> Json | None:
    """The metadata that a level can't take over from the whole, None if it can.

    It can't where an attribute of its own is of another dtype than on a level below.
    """
    described = grid.cell_attributes
    same = level.metadata == grid.metadata and all(e in described for e in level.cell_attributes)
    return None if same else level.metadata


def _extra(extra: Json, known: tuple[str, ...], place: Place) -> Json:
    for key in known:
        if key in extra:
            place[key].fail("extra fields can't stand in for one of the format's own")
    return {key: _plain(extra[key], place[key]) for key in extra}


def _dump(fields: Json, top: Place) -> bytes:
    try:
        return orjson.dumps(fields, option=orjson.OPT_SERIALIZE_NUMPY)  # for np.float64 alone
    except orjson.JSONEncodeError as error:  # an integer of over 64 bits, half a surrogate
        raise FormatError(f"cannot write the grid as JSON: {error}") from error


def _named(path: str | os.PathLike[str]) -> str:
    name = os.fspath(path)
    return name if name.isprintable() else repr(name)


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
