"""The NavGrid format: SceneGrid2D and MultiLevelGrid JSON, read and written.

Unknown fields of a grid, of its levels and of its metadata, and further tile attributes, are kept
and written back; unknown fields inside an array or a bbox are not.

``userData`` (names of objects by cell) are most of a large file and rarely needed. In files of
`SPLIT_BYTES` and more, msgspec splits levels into fields without parsing these, and user data stay
text until first use.
"""

import gzip
import io
import logging
import math
import os
import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.errors import FormatError, printable
from navbake.formats.allowance import (
    MISSING,
    Allowance,
    JsonPath,
    check_json,
    check_number,
    check_object,
    check_optional_object,
    check_vector,
    check_whole_number,
    format_value,
)
from navbake.formats.arrays import decode_array, encode_array
from navbake.formats.convert import GRID_FORMATS
from navbake.formats.source import (
    Files,
    Source,
    check_path,
    parse_json,
    read_navgrid_text,
    write_files,
)
from navbake.lazy import lazy
from navbake.navgrid.grid import MultiLevelGrid, NavGrid, SceneGrid2D
from navbake.navgrid.lattice import FARTHEST, LEAST_EDGE
from navbake.navgrid.user_data import Shared, UserData
from navbake.types import Json

if TYPE_CHECKING:
    import msgspec
else:
    msgspec = lazy("msgspec")

LOG = logging.getLogger("navbake.formats")

SCENE_FIELDS = (
    *("type", "metadata", "weights", "userData", "tileAttributes", "width", "height"),
    *("cellSize", "min", "unit", "bbox", "timings"),
)
MULTI_FIELDS = ("type", "metadata", "cellSize", "unit", "grids", "timings")
SPLIT_BYTES = 1 << 20  # below, all is parsed at once and msgspec stays unloaded
ENTRIES = 1 << 16  # cells whose user data are encoded at once, to limit memory


# ---------------------------------------------------------------- reading


def read_navgrid(source: Source, *, max_cells: int | None = None) -> NavGrid:
    """Read a NavGrid file, plain or gzipped (detected by its content).

    ``type``, ``width``, ``height``, ``cellSize`` and ``min`` are required (a level takes
    ``cellSize`` and ``unit`` over from its MultiLevelGrid). Without ``weights``, a cell weighs 1
    if its occupancy is 0 and its floor is known, as far as the file has these attributes. ``null``
    is infinity in weights and NaN in float attributes, in raw data too, where the original client
    keeps it.

    The ``userData`` of a file of 1 MiB and more are parsed on first use or on saving; only then
    their faults raise a FormatError.

    Args:
        source: a path, a file's content, or a file opened in binary mode.
        max_cells: most cells of all levels together, whose arrays may take 128 bytes a cell. If
            None: 100 million cells, and no more memory than 256 MiB and 512 bytes for each byte
            of the file.

    Raises:
        FormatError: the file can't be read or does not follow the format.
    """
    text, num_bytes, top = read_navgrid_text(source)
    content = _parse(text, top)
    allowance = Allowance(num_bytes, "max_cells", max_cells)
    kind = content.get("type", MISSING)
    if kind == "MultiLevelGrid":
        return warn_of_newer(read_multi_level_grid(content, top, allowance), top)
    if kind != "SceneGrid2D":
        top["type"].refuse("'SceneGrid2D' or 'MultiLevelGrid'", kind)
    return warn_of_newer(check_grid(read_level(content, top, allowance), top), top)


def _parse(content: bytes, top: JsonPath) -> Json:
    """Parse a file; in a long one, each level's ``userData`` stay text."""
    if len(content) >= SPLIT_BYTES:
        with suppress(msgspec.DecodeError, RecursionError, orjson.JSONDecodeError):
            fields = msgspec.json.decode(content, type=dict[str, msgspec.Raw])
            is_house = orjson.loads(memoryview(fields.get("type", b"null"))) == "MultiLevelGrid"
            if not is_house or "grids" not in fields:
                return _parse_level(fields)
            levels = msgspec.json.decode(fields["grids"], type=list[dict[str, msgspec.Raw]])
            house = {key: key == "grids" or orjson.loads(memoryview(fields[key])) for key in fields}
            return {**house, "grids": [_parse_level(level) for level in levels]}
    return check_object(parse_json(content, top), top)  # names the line of the fault


def _parse_level(fields: Json) -> Json:
    views = {key: memoryview(raw) for key, raw in fields.items()}
    return {key: view if key == "userData" else orjson.loads(view) for key, view in views.items()}


def read_multi_level_grid(
    content: Json, top: JsonPath, allowance: Allowance, key: str = "grids"
) -> MultiLevelGrid:
    """Read a grid of several levels; `key` is the file's name for its ``grids``."""
    grids = content.get("grids", MISSING)
    if not isinstance(grids, list) or not grids:
        top[key].refuse("a list of at least one level", grids)
    whole = {name: content[name] for name in ("cellSize", "unit") if content.get(name) is not None}
    for name in whole:
        check_number(whole[name], top[name], positive=True)
    metadata = read_metadata(content, top)
    levels = []
    for i, value in enumerate(grids):
        level = check_object(value, top[key][i])
        if level.get("type", "SceneGrid2D") != "SceneGrid2D":
            top[key][i]["type"].refuse("'SceneGrid2D'", level["type"])
        levels.append(read_level(level, top[key][i], allowance, {**whole, "metadata": metadata}))
    house = MultiLevelGrid(
        grids=levels,
        cell_size=float(whole.get("cellSize", levels[0].cell_size)),
        unit=float(whole.get("unit", 1)),
        metadata=metadata,
        timings=check_optional_object(content, "timings", top),
        extra=_unknown(content, MULTI_FIELDS, top),
    )
    check_grid(house, top, key)
    return house


def read_level(
    content: Json, place: JsonPath, allowance: Allowance, whole: Json | None = None
) -> SceneGrid2D:
    """Read a level, which takes missing fields over from the `whole` grid.

    A layer may be a function of its shape and place that returns its array, in place of JSON.
    """
    metadata = read_metadata(content, place) or (whole or {}).get("metadata", {})
    stated = {"unit": 1, **(whole or {}), **{k: v for k, v in content.items() if v is not None}}
    size = float(check_number(stated.get("cellSize", MISSING), place["cellSize"], positive=True))
    unit = float(check_number(stated.get("unit", MISSING), place["unit"], positive=True))
    width = check_whole_number(content.get("width", MISSING), place["width"], 1)
    height = check_whole_number(content.get("height", MISSING), place["height"], 1)
    allowance.take_cells((width, height), place)

    def layer(value: Any, at: JsonPath, **given: Any) -> NDArray[Any]:
        if callable(value):
            read: NDArray[Any] = value((height, width), at)
            return read
        return decode_array(value, at, (height, width), allowance, **given)

    types = {entry["name"]: entry.get("type") for entry in metadata.get("cellAttributes") or []}
    stored = stated.get("tileAttributes", {})
    at = place["tileAttributes"]
    attributes = {
        name: layer(value, at[name], default=types.get(name))
        for name, value in check_object(stored, at).items()
    }
    if "weights" in stated:
        weights = layer(stated["weights"], place["weights"], null=math.inf)
        weights = weights if callable(stated["weights"]) else weights.astype(np.float64, copy=False)
    else:
        allowance.take_array((height, width), 8, place["weights"])
        weights = np.ones((height, width))
        if "occupancy" in attributes:
            weights[attributes["occupancy"] != 0] = np.inf
        if "floorHeight" in attributes:
            weights[~np.isfinite(attributes["floorHeight"])] = np.inf
    bbox = content.get("bbox")
    at = place["bbox"]
    if bbox is not None:
        low = check_object(bbox, at).get("min", MISSING)
        high = check_object(bbox, at).get("max", MISSING)
        bbox = check_vector(low, at["min"]), check_vector(high, at["max"])
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=size,
        min_yup=check_vector(content.get("min", MISSING), place["min"]),
        bbox_yup=bbox,
        unit=unit,
        weights=weights,
        attributes=attributes,
        user_data=_read_user_data(content.get("userData"), place["userData"], width * height),
        metadata=metadata,
        timings=check_optional_object(content, "timings", place),
        extra=_unknown(content, SCENE_FIELDS, place),
    )


def read_metadata(content: Json, place: JsonPath) -> Json:
    """Read the metadata of a grid or level, and check the parts that readers rely on."""
    metadata = check_optional_object(content, "metadata", place)
    check_optional_object(metadata, "navbake", place["metadata"])
    entries = metadata.get("cellAttributes")
    place = place["metadata"]["cellAttributes"]
    if not isinstance(entries, list | None):
        place.refuse("a list", entries)
    for i, entry in enumerate(entries or []):
        name = check_object(entry, place[i]).get("name", MISSING)
        if not isinstance(name, str):
            place[i]["name"].refuse("a string", name)
    return metadata


def _unknown(content: Json, known: tuple[str, ...], place: JsonPath) -> Json:
    return {key: check_json(content[key], place[key]) for key in content if key not in known}


def _read_user_data(value: Any, place: JsonPath, num_cells: int) -> UserData:
    """Check user data: at once, or if still text, on first use."""

    def check(value: Any) -> dict[int, Json]:
        stored: Json = {} if value is None else check_object(check_json(value, place), place)
        ids = [int(key) if key.isdecimal() and len(key) <= 15 else -1 for key in stored]
        for key, cell_id in zip(stored, ids, strict=True):
            if not 0 <= cell_id < num_cells or str(cell_id) != key:
                expected = f"a cell's id from 0 to {num_cells - 1} as key"
                what = f"expected {expected}, got {format_value(key)}"
                place.fail(what)
        if not set(map(type, stored.values())) <= {dict}:
            key, odd = next((k, v) for k, v in stored.items() if not isinstance(v, dict))
            place[int(key)].refuse("an object", odd)
        return dict(zip(ids, stored.values(), strict=True))

    if isinstance(value, memoryview):
        return UserData(lambda: check(parse_json(value, place)))
    return UserData(check(value))


def check_grid(grid: NavGrid, top: JsonPath, key: str = "") -> NavGrid:
    """Check a file's cell size, and the tables of a whole grid."""
    for k, level in enumerate(grid.levels):
        place = top[key][k] if key else top
        edge = level.lattice.cell_size
        if not edge >= LEAST_EDGE:  # for sizes and areas to be computed
            place.fail(f"expected cells of {LEAST_EDGE:g} m or more, got {edge:g} m")
        if not all(abs(value) <= FARTHEST for value in (*level.lattice.bounds, level.ground)):
            place.fail(
                f"expected a level within {FARTHEST:g} m of the origin, got {level.width} × "
                f"{level.height} cells of {edge:g} m from {level.min_yup} on"
            )
    try:
        # checks them
        _ = grid.step_array, grid.links, grid.areas, grid.agents, grid.doors, grid.stated_rooms
    except FormatError as error:
        raise FormatError(f"{error} in {top.file}") from None
    return grid


def warn_of_newer(grid: NavGrid, top: JsonPath, is_newer: bool = False) -> NavGrid:
    """Return the grid; log a warning if its metadata, or its format, are of a newer navbake."""

    def numbers(version: str) -> list[int]:
        return [int(part) for part in re.findall("[0-9]{1,9}", version)[:3]]

    stated = grid.navbake.get("version")
    is_stated = isinstance(stated, str) and numbers(stated) > numbers(__version__)
    if is_newer or is_stated:
        by = f"navbake {format_value(stated)[1:-1]}" if is_stated else "a newer navbake"
        LOG.warning("%s is by %s, this is %s: parts of it may be unknown here",
                    printable(top.file), by, __version__)  # fmt: skip
    return grid


# ---------------------------------------------------------------- writing


def write_navgrid(grid: NavGrid, path: str | os.PathLike[str]) -> None:
    """Write a NavGrid file, gzipped if its name ends in ``.gz``, as a whole or not at all.

    Raises a FormatError if the format can't hold the grid, the name ends as one of another format,
    or the path can't be written.
    """
    name = check_path(path)
    others = [form.name for form in GRID_FORMATS[1:] if name.lower().endswith(form.endings)]
    ways = [f"grid.convert(path) writes {others[0]}"] if others else []
    ways += ["grid.plot(path) draws a picture"] if name.lower().endswith((".png", ".svg")) else []
    if ways:
        expected = "a name that ends in .json or .json.gz, which grid.save writes"
        raise FormatError(f"expected {expected}, got {name}: {', '.join(ways)}")
    write_files(encode_files(grid, Path(name)))


def encode_files(grid: NavGrid, path: Path) -> Files:
    """The file of `write_navgrid`, as a writer of `navbake.formats.convert`."""
    content = dumps_navgrid(grid)
    if path.name.lower().endswith(".gz"):
        packed = io.BytesIO()
        with gzip.GzipFile("", "wb", compresslevel=6, fileobj=packed, mtime=0) as file:
            file.write(content)
        content = packed.getvalue()
    return {path: content}


def dumps_navgrid(grid: NavGrid) -> bytes:
    """Encode a grid as NavGrid JSON, arrays as runs.

    NaN and infinity in arrays become ``null``. ``cellAttributes`` lists the existing attributes. A
    level's metadata are left out if it can take them over from its MultiLevelGrid. Raises a
    FormatError for NaN or infinity outside of arrays, a dtype that the format lacks, or values in
    the metadata, user data or extra fields that JSON lacks.
    """
    top = JsonPath("the grid to be written")
    if isinstance(grid, SceneGrid2D):
        fields = _level_fields(grid, top, grid.metadata)
    else:
        _ = grid.step_array, grid.links  # checks them
        described = grid.cell_attributes
        levels = []
        for k, level in enumerate(grid.grids):
            # a level that takes over the metadata of the whole, all dtypes included, has none
            is_same = grid.inherits_metadata(k, level)
            is_same &= all(entry in described for entry in level.cell_attributes)
            own = None if is_same else level.metadata
            levels.append(_level_fields(level, top["grids"][k], own))
        fields = {
            "type": "MultiLevelGrid",
            "metadata": _metadata(grid, top),
            "cellSize": check_number(grid.cell_size, top["cellSize"], positive=True),
            "unit": check_number(grid.unit, top["unit"], positive=True),
            "grids": levels,
            "timings": check_json(grid.timings, top["timings"]),
        } | _extra(grid, top)

    try:  # OPT_SERIALIZE_NUMPY for np.float64 alone
        option = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_APPEND_NEWLINE
        return orjson.dumps(fields, option=option)
    except orjson.JSONEncodeError as error:  # an integer of over 64 bits, half a surrogate
        raise FormatError(f"cannot write the grid as JSON: {error}") from error


def _level_fields(grid: SceneGrid2D, place: JsonPath, metadata: Json | None) -> Json:
    def runs(array: NDArray[Any], at: JsonPath, **stated: str) -> Json:
        if array.shape != grid.shape:
            at.fail(f"expected shape (height, width) = {grid.shape}, got {array.shape}")
        data = orjson.Fragment(encode_array(array, at["data"]))
        return {"type": "array", **stated, "length": array.size, "encoding": "rle", "data": data}

    fields: Json = {"type": "SceneGrid2D"}
    if metadata is not None:
        fields["metadata"] = _metadata(grid, place)
    fields |= {
        "weights": runs(grid.weights.astype(np.float64, copy=False), place["weights"]),
        "userData": orjson.Fragment(encode_user_data(grid, place["userData"])),
        "tileAttributes": {
            name: runs(array, place["tileAttributes"][name], datatype=array.dtype.name)
            for name, array in grid.attributes.items()
        },
        "width": check_whole_number(int(grid.width), place["width"], 1),
        "height": check_whole_number(int(grid.height), place["height"], 1),
        "cellSize": check_number(grid.cell_size, place["cellSize"], positive=True),
        "min": [check_number(value, place["min"][i]) for i, value in enumerate(grid.min_yup)],
        "unit": check_number(grid.unit, place["unit"], positive=True),
    }
    if grid.bbox_yup is not None:
        fields["bbox"] = {
            key: [check_number(value, place["bbox"][key][i]) for i, value in enumerate(corner)]
            for key, corner in zip(("min", "max"), grid.bbox_yup, strict=True)
        }
    fields["timings"] = check_json(grid.timings, place["timings"])
    return fields | _extra(grid, place)


def _metadata(grid: NavGrid, place: JsonPath) -> Json:
    """The grid's metadata with ``cellAttributes`` of the existing arrays."""
    place = place["metadata"]
    check_optional_object(grid.metadata, "navbake", place)
    metadata = {**grid.metadata, "cellAttributes": grid.cell_attributes}
    return check_object(check_json(metadata, place), place)


def _extra(grid: NavGrid, place: JsonPath) -> Json:
    check_extra(grid.extra, type(grid), place)
    return {key: check_json(grid.extra[key], place[key]) for key in grid.extra}


def check_extra(extra: Json, kind: type[NavGrid], place: JsonPath) -> None:
    """Refuse extra fields with the name of one of the format's own."""
    for key in MULTI_FIELDS if kind is MultiLevelGrid else SCENE_FIELDS:
        if key in extra:
            place[key].fail("extra fields can't stand in for one of the format's own")


def encode_user_data(grid: SceneGrid2D, place: JsonPath) -> bytes:
    """Encode user data as JSON by ascending cell id."""
    num_cells = grid.width * grid.height
    source = UserData.of(grid.user_data).source
    if isinstance(source, Shared):
        cells = source.cells.tolist()
        numbers = source.number.tolist()
        entries = source.entries
        check_json(list(entries), place)
    else:
        for cell_id, value in source.items():
            if not isinstance(cell_id, int | np.integer):
                place.fail(
                    f"expected cell ids from 0 to {num_cells - 1}, got {format_value(cell_id)}"
                )
            if not isinstance(value, dict):
                place[int(cell_id)].refuse("an object", value)
        cells = sorted(map(int, source))
        numbers = range(len(cells))
        entries = [source[cell] for cell in cells]
        check_json({str(cell): entry for cell, entry in zip(cells, entries, strict=True)}, place)
    if cells and not 0 <= cells[0] <= cells[-1] < num_cells:
        wrong = cells[0] if cells[0] < 0 else cells[-1]
        place.fail(f"expected cell ids from 0 to {num_cells - 1}, got {wrong}")
    encoded = [orjson.dumps(entry) for entry in entries]
    pieces = []
    for first in range(0, len(cells), ENTRIES):
        part = slice(first, first + ENTRIES)
        own = zip(cells[part], map(encoded.__getitem__, numbers[part]), strict=True)
        pieces.append(b",".join(map(b'"%d":%b'.__mod__, own)))
    return b"{%b}" % b",".join(pieces)
