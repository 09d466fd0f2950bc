"""The NavGrid format: SceneGrid2D and MultiLevelGrid JSON, read and written.

What the format does not know is kept and written back: fields of a grid, of its levels and of
its metadata, and further tile attributes; not so fields inside of an array or a bbox.
"""

import gzip
import io
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.formats.allowance import Allowance
from navbake.formats.arrays import decode_array, encode_array
from navbake.formats.source import Files, Source, check_path, read_json_text, write_bytes
from navbake.formats.user_data import encode_user_data, parse_file, read_user_data
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
from navbake.navgrid.lattice import FARTHEST, LEAST_EDGE
from navbake.types import Float, Json, Vector3

SCENE_FIELDS = (
    *("type", "metadata", "weights", "userData", "tileAttributes", "width", "height"),
    *("cellSize", "min", "unit", "bbox", "timings"),
)
MULTI_FIELDS = ("type", "metadata", "cellSize", "unit", "grids", "timings")

Shape = tuple[int, int]
Layers = dict[str, NDArray[Any]]


def read_navgrid(source: Source, *, max_cells: int | None = None) -> NavGrid:
    """Read a NavGrid file, plain or gzipped (which its content tells, not its name).

    ``type``, ``width``, ``height``, ``cellSize`` and ``min`` must be there (a level takes
    ``cellSize`` and ``unit`` over from its MultiLevelGrid); the rest may be missing. Without
    ``weights``, a cell weighs 1 where its occupancy is 0 and its floor is known, as far as the
    file has these attributes. ``null`` is infinity in weights and NaN in float attributes, in
    raw data too, where the original client leaves it as it is.

    The ``userData`` of a file of 1 MiB and more are parsed when they are first used, or the grid is
    saved; what is wrong in them is a FormatError then.

    Args:
        source: a path, a file's content, or a file opened in binary mode.
        max_cells: most cells that all levels together may have, whose arrays may take 128 bytes a
            cell. If None: 100 million cells, and no more memory than 256 MiB and 512 bytes for
            each byte of the file.

    Raises:
        FormatError: the file can't be read or does not follow the format.
    """
    text, num_bytes, top = read_json_text(source)
    content = parse_file(text, top)
    allowance = Allowance.of_grid(num_bytes, max_cells)
    kind = content.get("type", MISSING)
    if kind == "SceneGrid2D":
        grid: NavGrid = _read_level(content, top, allowance, {}, {})
    elif kind == "MultiLevelGrid":
        grid = _read_levels(content, top, allowance)
    else:
        top["type"].refuse("'SceneGrid2D' or 'MultiLevelGrid'", kind)
    return checked_grid(grid, top)


def checked_grid(grid: NavGrid, top: JsonPath) -> NavGrid:
    """Check what a file says of a whole grid: how large its cells are, links, doors and rooms."""
    for k, level in enumerate(grid.levels):
        place = top["grids"][k] if isinstance(grid, MultiLevelGrid) else top
        edge = level.lattice.cell_size
        if not edge >= LEAST_EDGE:  # for sizes and areas to be computed
            place.fail(f"expected cells of {LEAST_EDGE:g} m or more, got {edge:g} m")
        if not all(abs(value) <= FARTHEST for value in (*level.lattice.bounds, level.ground)):
            place.fail(
                f"expected a level within {FARTHEST:g} m of the origin, got {level.width} × "
                f"{level.height} cells of {edge:g} m from {level.min_yup} on"
            )
    try:
        _ = grid.link_array, grid.doors, grid.stated_rooms  # checks them
    except FormatError as error:
        raise FormatError(f"{error} in {top.file}") from None
    return grid


def write_navgrid(grid: NavGrid, path: str | os.PathLike[str]) -> None:
    """Write a NavGrid file, gzipped if its name ends in ``.gz``; the same grid, the same bytes.

    The file is there as a whole or not at all.

    Raises:
        FormatError: the grid holds what the format can't, or the path can't be written.
    """
    write_bytes(_encode_for(grid, check_path(path)), path)


def encode_files(grid: NavGrid, path: Path) -> Files:
    """The file that `write_navgrid` writes, as `navbake.formats.convert` takes it."""
    return {path: _encode_for(grid, path.name)}


def _encode_for(grid: NavGrid, name: str) -> Iterator[bytes]:
    pieces = _encode_navgrid(grid)
    return _gzip(pieces) if name.lower().endswith(".gz") else pieces


def dumps_navgrid(grid: NavGrid) -> bytes:
    """Encode a grid as NavGrid JSON, arrays as runs.

    NaN and infinity in arrays become ``null``, so that weights come back as finite or inf and
    floats of attributes as finite or NaN. ``cellAttributes`` lists the attributes that there
    are. A level that can take over the metadata of its MultiLevelGrid has none in the file.

    Raises:
        FormatError: NaN or infinity outside of arrays, a dtype that the format has not, or
            something in the metadata, user data or extra fields that JSON has not.
    """
    return b"".join(_encode_navgrid(grid))


class _Later:
    """Parts of the JSON that are long: written piece by piece, when all else has been encoded."""

    def __init__(self) -> None:
        self._parts: list[Iterator[bytes]] = []

    def put(self, pieces: Iterator[bytes]) -> orjson.Fragment:
        """Return a placeholder for such a part: JSON never has the character 0 itself."""
        self._parts.append(pieces)
        return orjson.Fragment(b"\0%d\0" % (len(self._parts) - 1))

    def fill_in(self, text: bytes) -> Iterator[bytes]:
        """Yield the text with all parts where they belong."""
        for k, piece in enumerate(text.split(b"\0")):
            if k % 2:
                yield from self._parts[int(piece)]
            else:
                yield piece


def _encode_navgrid(grid: NavGrid) -> Iterator[bytes]:
    """See `dumps_navgrid`; in pieces, of which the first comes when all has been checked."""
    top, later = JsonPath("the grid to be written"), _Later()
    if isinstance(grid, SceneGrid2D):
        fields = _level_fields(grid, top, grid.metadata, later)
    else:
        _ = grid.link_array  # checks them
        fields = {
            "type": "MultiLevelGrid",
            "metadata": _metadata(grid, top),
            "cellSize": number(grid.cell_size, top["cellSize"], positive=True),
            "unit": number(grid.unit, top["unit"], positive=True),
            "grids": [
                _level_fields(level, top["grids"][i], _own_metadata(grid, i), later)
                for i, level in enumerate(grid.grids)
            ],
            "timings": plain(grid.timings, top["timings"]),
        } | _extra(grid, top)
    try:  # OPT_SERIALIZE_NUMPY for np.float64 alone
        option = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_APPEND_NEWLINE
        return later.fill_in(orjson.dumps(fields, option=option))
    except orjson.JSONEncodeError as error:  # an integer of over 64 bits, half a surrogate
        raise FormatError(f"cannot write the grid as JSON: {error}") from error


def _gzip(pieces: Iterator[bytes]) -> Iterator[bytes]:
    packed = io.BytesIO()
    with gzip.GzipFile("", "wb", compresslevel=6, fileobj=packed, mtime=0) as file:
        for piece in pieces:
            file.write(piece)
            yield packed.getvalue()
            packed.seek(0)
            packed.truncate()
    yield packed.getvalue()


def _read_levels(content: Json, top: JsonPath, allowance: Allowance) -> MultiLevelGrid:
    grids = content.get("grids", MISSING)
    if not isinstance(grids, list) or not grids:
        top["grids"].refuse("a list of at least one level", grids)
    metadata = _read_metadata(content, top)
    inherited = {key: content[key] for key in ("cellSize", "unit") if content.get(key) is not None}
    for key in inherited:
        number(inherited[key], top[key], positive=True)
    levels = []
    for i, value in enumerate(grids):
        place = top["grids"][i]
        level = json_object(value, place)
        if level.get("type", "SceneGrid2D") != "SceneGrid2D":
            place["type"].refuse("'SceneGrid2D'", level["type"])
        levels.append(_read_level(level, place, allowance, inherited, metadata))
    return MultiLevelGrid(
        grids=levels,
        cell_size=float(inherited.get("cellSize", levels[0].cell_size)),
        unit=float(inherited.get("unit", 1)),
        metadata=metadata,
        timings=optional_object(content, "timings", top),
        extra=_unknown(content, MULTI_FIELDS, top),
    )


def _read_level(
    content: Json, place: JsonPath, allowance: Allowance, inherited: Json, metadata: Json
) -> SceneGrid2D:
    own_metadata = _read_metadata(content, place) or metadata
    width = whole_number(content.get("width", MISSING), place["width"], 1)
    height = whole_number(content.get("height", MISSING), place["height"], 1)
    allowance.take_cells((width, height), place)
    shape = height, width
    attributes = _read_attributes(content, place, shape, allowance, own_metadata)
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=_inherit(content, "cellSize", inherited, MISSING, place),
        min_yup=vector(content.get("min", MISSING), place["min"]),
        bbox_yup=_read_bbox(content, place["bbox"]),
        unit=_inherit(content, "unit", inherited, 1, place),
        weights=_read_weights(content, place, shape, allowance, attributes),
        attributes=attributes,
        user_data=read_user_data(content.get("userData"), place["userData"], width * height),
        metadata=own_metadata,
        timings=optional_object(content, "timings", place),
        extra=_unknown(content, SCENE_FIELDS, place),
    )


def _inherit(content: Json, key: str, inherited: Json, default: object, place: JsonPath) -> float:
    value = content.get(key)
    if value is None:
        value = inherited.get(key, default)
    return float(number(value, place[key], positive=True))


def _read_metadata(content: Json, place: JsonPath) -> Json:
    metadata = optional_object(content, "metadata", place)
    optional_object(metadata, "navbake", place["metadata"])
    entries, place = metadata.get("cellAttributes"), place["metadata"]["cellAttributes"]
    if not isinstance(entries, list | None):
        place.refuse("a list", entries)
    for i, entry in enumerate(entries or []):
        name = json_object(entry, place[i]).get("name", MISSING)
        if not isinstance(name, str):
            place[i]["name"].refuse("a string", name)
    return metadata


def _read_attributes(
    content: Json, place: JsonPath, shape: Shape, allowance: Allowance, metadata: Json
) -> Layers:
    types = {entry["name"]: entry.get("type") for entry in metadata.get("cellAttributes") or []}
    stored, place = content.get("tileAttributes"), place["tileAttributes"]
    arrays = json_object({} if stored is None else stored, place)
    return {
        name: decode_array(value, place[name], shape, allowance, default=types.get(name))
        for name, value in arrays.items()
    }


def _read_weights(
    content: Json, place: JsonPath, shape: Shape, allowance: Allowance, attributes: Layers
) -> Float:
    stored, place = content.get("weights"), place["weights"]
    if stored is not None:
        read = decode_array(stored, place, shape, allowance, null=math.inf)
        return read.astype(np.float64, copy=False)
    allowance.take_array(shape, 8, place)
    weights = np.ones(shape)
    if "occupancy" in attributes:
        weights[attributes["occupancy"] != 0] = np.inf
    if "floorHeight" in attributes:
        weights[~np.isfinite(attributes["floorHeight"])] = np.inf
    return weights


def _read_bbox(content: Json, place: JsonPath) -> tuple[Vector3, Vector3] | None:
    if content.get("bbox") is None:
        return None
    low, high = (json_object(content["bbox"], place).get(key, MISSING) for key in ("min", "max"))
    return vector(low, place["min"]), vector(high, place["max"])


def _unknown(content: Json, known: tuple[str, ...], place: JsonPath) -> Json:
    return {key: plain(content[key], place[key]) for key in content if key not in known}


def _level_fields(grid: SceneGrid2D, place: JsonPath, metadata: Json | None, later: _Later) -> Json:
    fields: Json = {"type": "SceneGrid2D"}
    if metadata is not None:
        fields["metadata"] = _metadata(grid, place)
    weights, attributes = grid.weights.astype(np.float64, copy=False), place["tileAttributes"]
    fields |= {
        "weights": _runs(weights, grid.shape, place["weights"], later),
        "userData": later.put(encode_user_data(grid, place["userData"])),
        "tileAttributes": {
            name: _runs(array, grid.shape, attributes[name], later, datatype=array.dtype.name)
            for name, array in grid.attributes.items()
        },
        "width": whole_number(int(grid.width), place["width"], 1),
        "height": whole_number(int(grid.height), place["height"], 1),
        "cellSize": number(grid.cell_size, place["cellSize"], positive=True),
        "min": _vector(grid.min_yup, place["min"]),
        "unit": number(grid.unit, place["unit"], positive=True),
    }
    if grid.bbox_yup is not None:
        (low, high), box = grid.bbox_yup, place["bbox"]
        fields["bbox"] = {"min": _vector(low, box["min"]), "max": _vector(high, box["max"])}
    fields["timings"] = plain(grid.timings, place["timings"])
    return fields | _extra(grid, place)


def _vector(values: Vector3, place: JsonPath) -> list[float]:
    return [number(value, place[i]) for i, value in enumerate(values)]


def _runs(array: NDArray[Any], shape: Shape, place: JsonPath, later: _Later, **stated: str) -> Json:
    if array.shape != shape:
        place.fail(f"expected shape (height, width) = {shape}, got {array.shape}")
    data = later.put(encode_array(array, place["data"]))
    return {"type": "array", **stated, "length": array.size, "encoding": "rle", "data": data}


def _metadata(grid: NavGrid, place: JsonPath) -> Json:
    """The grid's metadata with ``cellAttributes`` of the arrays that are there."""
    place = place["metadata"]
    optional_object(grid.metadata, "navbake", place)
    metadata = {**grid.metadata, "cellAttributes": grid.cell_attributes}
    return json_object(plain(metadata, place), place)


def _own_metadata(grid: MultiLevelGrid, number: int) -> Json | None:
    """A level's metadata, None where it takes over those of the whole when it is read.

    It does not where one of its attributes has another dtype than on a level below.
    """
    level, described = grid.grids[number], grid.cell_attributes
    same = grid.takes_over(number, level) and all(e in described for e in level.cell_attributes)
    return None if same else level.metadata


def check_extra(extra: Json, kind: type[NavGrid], place: JsonPath) -> None:
    """Refuse extra fields of a grid of this kind that have the name of one of the format's own."""
    for key in MULTI_FIELDS if kind is MultiLevelGrid else SCENE_FIELDS:
        if key in extra:
            place[key].fail("extra fields can't stand in for one of the format's own")


def _extra(grid: NavGrid, place: JsonPath) -> Json:
    check_extra(grid.extra, type(grid), place)
    return {key: plain(grid.extra[key], place[key]) for key in grid.extra}
