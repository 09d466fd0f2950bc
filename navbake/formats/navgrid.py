"""The NavGrid format: SceneGrid2D and MultiLevelGrid JSON, read and written.

Unknown fields of a grid, of its levels and of its metadata, and further tile attributes, are kept
and written back; unknown fields inside an array or a bbox are dropped.

``userData`` (for each cell, the names of objects) are most of a large file and rarely needed. So in
files of `SPLIT_BYTES` and more, msgspec splits each level into its fields, and all fields but the
user data are parsed; these stay text until they are first used.
"""

import gzip
import io
import logging
import math
import os
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

import msgspec
import numpy as np
import orjson
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.errors import FormatError, printable
from navbake.formats.allowance import (
    ABSENT,
    Allowance,
    JsonPath,
    check_depth,
    check_json,
    check_number,
    check_object,
    check_optional_object,
    check_vector,
    check_whole_number,
    format_value,
)
from navbake.formats.arrays import decode_array, encode_array
from navbake.formats.format_table import GRID_FORMATS
from navbake.formats.source import (
    Files,
    Source,
    check_path,
    parse_json,
    read_navgrid_text,
    write_files,
)
from navbake.navgrid.grid import MultiLevelGrid, NavGrid, SceneGrid2D
from navbake.navgrid.islands import with_current_islands
from navbake.navgrid.lattice import LEAST_EDGE, MAX_COORDINATE
from navbake.navgrid.user_data import SharedEntries, UserData, without_garbage_collection
from navbake.types import Json, JsonValue

LOG = logging.getLogger("navbake.formats")

ReadLayer: TypeAlias = Callable[[tuple[int, int], JsonPath], NDArray[Any]]
"""A function of a layer's shape and location that returns its array."""

SCENE_GRID_FIELDS = (
    "type", "metadata", "weights", "userData", "tileAttributes", "width", "height", "cellSize",
    "min", "unit", "bbox", "timings",
)  # fmt: skip
MULTI_LEVEL_GRID_FIELDS = ("type", "metadata", "cellSize", "unit", "grids", "timings")
# attributes of a grid that hold parsed tables of its metadata
LINK_TABLES = ("step_array", "links")
METADATA_TABLES = (*LINK_TABLES, "areas", "agents", "doors", "stated_rooms")
SPLIT_BYTES = 1 << 20  # smaller files are parsed at once, user data and all
CELLS_AT_ONCE = 1 << 16  # cells whose user data are encoded at once, to limit memory


# ---------------------------------------------------------------- reading


def read_navgrid(source: Source, *, max_cells: int | None = None) -> NavGrid:
    """Read a NavGrid file, plain or gzipped (detected by its content).

    ``type``, ``width``, ``height``, ``cellSize`` and ``min`` are required. A level without
    ``cellSize`` or ``unit`` has the value of its MultiLevelGrid. In a file without ``weights``, a
    cell that is occupied or has no floor height weighs infinity, any other cell 1. (A file may also
    lack the occupancy or the floor heights; then the other one decides.) ``null`` is infinity in
    weights, and NaN in attributes of floats.

    The ``userData`` of a file of 1 MiB and more are parsed when they are first used or saved; their
    faults raise a FormatError only then.

    Args:
        source: a path, a file's content, or a file opened in binary mode.
        max_cells: the largest number of cells of all levels together; their arrays may take 128
            bytes per cell. If None: 100 million cells, and at most 256 MiB of memory plus 512 bytes
            for each byte of the file.

    Returns:
        The grid: a `SceneGrid2D` or a `MultiLevelGrid`.

    Raises:
        FormatError: the file can't be read or does not follow the format.

    Example:
        >>> grid = navbake.load("house.grid.json")
        >>> grid.levels[0].shape
        (117, 126)
    """
    text, num_bytes, root_place = read_navgrid_text(source)
    # not while the file is read, which may be a slow stream
    with without_garbage_collection():
        grid = _decode_grid(text, root_place, Allowance(num_bytes, "max_cells", max_cells))
    return warn_of_newer_version(grid, root_place)


def _decode_grid(text: bytes, root_place: JsonPath, allowance: Allowance) -> NavGrid:
    """Parse the text of a file, and make its grid.

    What was parsed is gone when this returns: the collector, which is paused, would go through it.
    """
    content = _parse_file(text, root_place)
    grid_type = content.get("type", ABSENT)
    if grid_type == "MultiLevelGrid":
        return read_multi_level_grid(content, root_place, allowance)
    if grid_type != "SceneGrid2D":
        root_place["type"].refuse("'SceneGrid2D' or 'MultiLevelGrid'", grid_type)
    return check_grid(read_level(content, root_place, allowance), root_place)


def _parse_file(content: bytes, root_place: JsonPath) -> Json:
    """Parse a file; in a long one, each level's ``userData`` stay text."""
    if len(content) >= SPLIT_BYTES:
        with suppress(msgspec.DecodeError, RecursionError, orjson.JSONDecodeError):
            fields = msgspec.json.decode(content, type=dict[str, msgspec.Raw])
            grid_type = orjson.loads(memoryview(fields.get("type", b"null")))
            if grid_type != "MultiLevelGrid" or "grids" not in fields:
                return _parse_level(fields)
            levels = msgspec.json.decode(fields["grids"], type=list[dict[str, msgspec.Raw]])
            other_fields = {
                key: orjson.loads(memoryview(text))
                for key, text in fields.items()
                if key != "grids"
            }
            return {**other_fields, "grids": [_parse_level(level) for level in levels]}
    return check_object(parse_json(content, root_place), root_place)  # names the line of the fault


def _parse_level(fields: dict[str, msgspec.Raw]) -> Json:
    """Parse the fields of a level, except its ``userData``, which stay text."""
    level: Json = {}
    for key, raw_value in fields.items():
        text = memoryview(raw_value)
        level[key] = text if key == "userData" else orjson.loads(text)
    return level


def read_multi_level_grid(
    content: Json, root_place: JsonPath, allowance: Allowance, key: str = "grids"
) -> MultiLevelGrid:
    """Make a MultiLevelGrid from the content of a file.

    Args:
        content: the parsed file. In place of a layer's array, it may hold a `ReadLayer`, a function
            that reads the array from elsewhere.
        root_place: the location of the whole file, for errors.
        allowance: what the arrays' memory is taken from.
        key: the key of the levels in the file, for errors.

    Returns:
        The grid.

    Raises:
        FormatError: the file does not follow the format, or is too large.
    """
    level_contents = content.get("grids", ABSENT)
    if not isinstance(level_contents, list) or not level_contents:
        root_place[key].refuse("a list of at least one level", level_contents)
    defaults: Json = {}  # fields that count for levels without them
    for name in ("cellSize", "unit"):
        if content.get(name) is not None:
            check_number(content[name], root_place[name], must_be_positive=True)
            defaults[name] = content[name]
    metadata = read_metadata(content, root_place)
    defaults["metadata"] = metadata
    levels = []
    for level_number, level_content in enumerate(level_contents):
        level_fields = check_object(level_content, root_place[key][level_number])
        if level_fields.get("type", "SceneGrid2D") != "SceneGrid2D":
            root_place[key][level_number]["type"].refuse("'SceneGrid2D'", level_fields["type"])
        levels.append(read_level(level_fields, root_place[key][level_number], allowance, defaults))
    grid = MultiLevelGrid(
        grids=levels,
        cell_size=float(defaults.get("cellSize", levels[0].cell_size)),
        unit=float(defaults.get("unit", 1)),
        metadata=metadata,
        timings=_read_object(content, "timings", root_place),
        extra=_find_unknown_fields(content, MULTI_LEVEL_GRID_FIELDS, root_place),
    )
    check_grid(grid, root_place, key)
    return grid


def read_level(
    content: Json, place: JsonPath, allowance: Allowance, defaults: Json | None = None
) -> SceneGrid2D:
    """Make a level from its content in a file.

    Args:
        content: the parsed level. In place of a layer's array, it may hold a `ReadLayer`, a
            function that reads the array from elsewhere.
        place: its location in the file, for errors.
        allowance: what the arrays' memory is taken from.
        defaults: ``cellSize``, ``unit`` and ``metadata`` of the MultiLevelGrid, which count where
            the level has no such field.

    Returns:
        The level.

    Raises:
        FormatError: the level does not follow the format, or is too large.
    """
    defaults = defaults or {}
    metadata = read_metadata(content, place) or defaults.get("metadata", {})
    stated_fields = {key: value for key, value in content.items() if value is not None}
    fields = {"unit": 1, **defaults, **stated_fields}
    cell_size = float(
        check_number(fields.get("cellSize", ABSENT), place["cellSize"], must_be_positive=True)
    )
    unit = float(check_number(fields.get("unit", ABSENT), place["unit"], must_be_positive=True))
    width = check_whole_number(content.get("width", ABSENT), place["width"], 1)
    height = check_whole_number(content.get("height", ABSENT), place["height"], 1)
    allowance.take_cells((width, height), place)

    def read_layer(
        layer: ReadLayer | JsonValue,
        layer_place: JsonPath,
        default_datatype: object = None,
        null_value: float = math.nan,
    ) -> NDArray[Any]:
        if callable(layer):
            array: NDArray[Any] = layer((height, width), layer_place)
            return array
        return decode_array(
            layer,
            layer_place,
            (height, width),
            allowance,
            default_datatype=default_datatype,
            null_value=null_value,
        )

    datatype_of_layer = {
        entry["name"]: entry.get("type") for entry in metadata.get("cellAttributes") or []
    }
    attributes_place = place["tileAttributes"]
    layers = check_object(fields.get("tileAttributes", {}), attributes_place)
    attributes = {
        name: read_layer(
            layer, attributes_place[name], default_datatype=datatype_of_layer.get(name)
        )
        for name, layer in layers.items()
    }
    if "weights" in fields:
        weights = read_layer(fields["weights"], place["weights"], null_value=math.inf)
        if not callable(fields["weights"]):
            weights = weights.astype(np.float64, copy=False)
    else:
        allowance.take_array((height, width), 8, place["weights"])
        weights = np.ones((height, width))
        if "occupancy" in attributes:
            weights[attributes["occupancy"] != 0] = np.inf
        if "floorHeight" in attributes:
            weights[~np.isfinite(attributes["floorHeight"])] = np.inf
    bbox = None
    if content.get("bbox") is not None:
        bbox_place = place["bbox"]
        corners = check_object(content["bbox"], bbox_place)
        lower_corner = check_vector(corners.get("min", ABSENT), bbox_place["min"])
        upper_corner = check_vector(corners.get("max", ABSENT), bbox_place["max"])
        bbox = (lower_corner, upper_corner)
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=cell_size,
        min_yup=check_vector(content.get("min", ABSENT), place["min"]),
        bbox_yup=bbox,
        unit=unit,
        weights=weights,
        attributes=attributes,
        user_data=_read_user_data(content.get("userData"), place["userData"], width * height),
        metadata=metadata,
        timings=_read_object(content, "timings", place),
        extra=_find_unknown_fields(content, SCENE_GRID_FIELDS, place),
    )


def read_metadata(content: Json, place: JsonPath) -> Json:
    """Return the metadata of a grid or level, after a check of the parts that readers use.

    Args:
        content: the parsed grid or level.
        place: its location in the file, for errors.

    Raises:
        FormatError: the metadata are no object, or ``navbake`` or ``cellAttributes`` are broken.
    """
    metadata = _read_object(content, "metadata", place)
    if metadata.get("navbake") is not None:
        check_object(metadata["navbake"], place["metadata"]["navbake"])
    entries = metadata.get("cellAttributes")
    place = place["metadata"]["cellAttributes"]
    if not isinstance(entries, list | None):
        place.refuse("a list", entries)
    for i, entry in enumerate(entries or []):
        name = check_object(entry, place[i]).get("name", ABSENT)
        if not isinstance(name, str):
            place[i]["name"].refuse("a string", name)
    return metadata


def _read_object(content: Json, key: str, place: JsonPath) -> Json:
    """Return the object in a field of parsed JSON; {} if the field is missing or null."""
    value = content.get(key)
    return {} if value is None else check_object(check_depth(value, place[key]), place[key])


def _find_unknown_fields(content: Json, format_fields: tuple[str, ...], place: JsonPath) -> Json:
    """Return the fields of a file that the format doesn't have; they are kept and written back."""
    return {
        key: check_depth(content[key], place[key]) for key in content if key not in format_fields
    }


def _read_user_data(value: JsonValue, place: JsonPath, num_cells: int) -> UserData:
    """Make a level's user data: parsed ones are checked now, ones that are text on first use."""

    def check_entries(value: JsonValue) -> dict[int, Json]:
        entries: Json = {} if value is None else check_object(check_depth(value, place), place)
        cell_ids = [int(key) if key.isdecimal() and len(key) <= 15 else -1 for key in entries]
        for key, cell_id in zip(entries, cell_ids, strict=True):
            if not 0 <= cell_id < num_cells or str(cell_id) != key:
                expected = f"a cell's id from 0 to {num_cells - 1} as key"
                message = f"expected {expected}, got {format_value(key)}"
                place.fail(message)
        if not set(map(type, entries.values())) <= {dict}:
            for key, entry in entries.items():
                if not isinstance(entry, dict):
                    place[int(key)].refuse("an object", entry)
        return dict(zip(cell_ids, entries.values(), strict=True))

    if isinstance(value, memoryview):
        return UserData(lambda: check_entries(parse_json(value, place)))
    return UserData(check_entries(value))


def check_grid(grid: NavGrid, root_place: JsonPath, key: str = "") -> NavGrid:
    """Check a grid's levels, their sizes and places, and all its tables; return the grid.

    Args:
        grid: the grid that a reader made of a file.
        root_place: the location of the whole file, for errors.
        key: the key of the levels in the file, "" if the file is a single level.

    Raises:
        FormatError: cells are too small, a level lies too far from the origin, or the table of
            steps, links, areas, agents, doors or rooms is broken.
    """
    for level_number, level in enumerate(grid.levels):
        place = root_place[key][level_number] if key else root_place
        cell_size = level.lattice.cell_size
        if not cell_size >= LEAST_EDGE:  # sizes and areas of smaller cells can't be computed
            place.fail(f"expected cells of {LEAST_EDGE:g} m or more, got {cell_size:g} m")
        if not all(abs(value) <= MAX_COORDINATE for value in (*level.lattice.bounds, level.ground)):
            place.fail(
                f"expected a level within {MAX_COORDINATE:g} m of the origin, got {level.width} × "
                f"{level.height} cells of {cell_size:g} m from {level.min_yup} on"
            )
    try:
        check_tables(grid, METADATA_TABLES)
    except FormatError as error:
        raise FormatError(f"{error} in {root_place.file}", path=root_place.file) from None
    return grid


def check_tables(grid: NavGrid, attributes: Iterable[str]) -> None:
    """Check tables of a grid's metadata by parsing them; the grid keeps the parsed tables.

    Args:
        grid: the grid.
        attributes: the attributes that hold the parsed tables, see `METADATA_TABLES`.

    Raises:
        FormatError: a table is broken.
    """
    for attribute in attributes:
        getattr(grid, attribute)


def warn_of_newer_version(
    grid: NavGrid, root_place: JsonPath, is_newer_format: bool = False
) -> NavGrid:
    """Log a warning if a newer navbake wrote a grid's file; return the grid.

    Args:
        grid: the grid, whose metadata state a version.
        root_place: the location of the whole file, for the warning.
        is_newer_format: whether the version of the file's format is newer than this navbake's.
    """

    def parse_version(version: str) -> list[int]:
        return [int(part) for part in re.findall("[0-9]{1,9}", version)[:3]]

    version = grid.navbake.get("version")
    states_newer_version = isinstance(version, str) and parse_version(version) > parse_version(
        __version__
    )
    if is_newer_format or states_newer_version:
        writer_text = (
            f"navbake {format_value(version)[1:-1]}" if states_newer_version else "a newer navbake"
        )
        LOG.warning(
            "%s is by %s, this is %s: parts of it may be unknown here",
            printable(root_place.file),
            writer_text,
            __version__,
        )
    return grid


# ---------------------------------------------------------------- writing


def write_navgrid(grid: NavGrid, path: str | os.PathLike[str]) -> None:
    """Write a NavGrid file, gzipped if its name ends in ``.gz``, as a whole or not at all.

    Args:
        grid: the grid.
        path: the file, by its usual ending ``.json`` or ``.json.gz``.

    Raises:
        FormatError: the format can't hold the grid, the name has the ending of a different format,
            or the file can't be written.
    """
    name = check_path(path)
    hints = []
    for file_format in GRID_FORMATS:
        if file_format.name != "navgrid" and name.lower().endswith(file_format.endings):
            hints.append(f"grid.convert(path) writes {file_format.name}")
            break
    if name.lower().endswith((".png", ".svg")):
        hints.append("grid.plot(path) draws a picture")
    if hints:
        expected = "a name that ends in .json or .json.gz, which grid.save writes"
        hint = ", ".join(hints)
        message = f"expected {expected}, got {name}: {hint}"
        raise FormatError(message, path=name, expected=expected, hint=hint)
    write_files(encode_files(grid, Path(name)))


def encode_files(grid: NavGrid, path: Path) -> Files:
    """Encode a NavGrid file; a writer for `navbake.formats.format_table`.

    Args:
        grid: the grid.
        path: the file; the content is gzipped if it ends in ``.gz``.

    Returns:
        The file's content by its path.

    Raises:
        FormatError: the format can't hold the grid: a number outside of arrays is NaN or infinite,
            or an array's dtype or a value is none of JSON's.
    """
    content = dumps_navgrid(grid)
    if path.name.lower().endswith(".gz"):
        packed_file = io.BytesIO()
        with gzip.GzipFile("", "wb", compresslevel=6, fileobj=packed_file, mtime=0) as file:
            file.write(content)
        content = packed_file.getvalue()
    return {path: content}


def dumps_navgrid(grid: NavGrid) -> bytes:
    """Encode a grid as NavGrid JSON, with run-length encoded arrays.

    NaN and infinity in arrays become ``null``. ``cellAttributes`` lists the existing attributes. A
    level's metadata are left out if they equal those of its MultiLevelGrid. What added obstacles
    block is written as blocked.

    Raises:
        FormatError: a number outside of arrays is NaN or infinite, the format lacks an array's
            dtype, or JSON can't hold a value in the metadata, user data or extra fields.
    """
    root_place = JsonPath("the grid to be written")
    grid = with_current_islands(grid)
    if isinstance(grid, SceneGrid2D):
        fields = _level_fields(grid, root_place, grid.metadata)
    else:
        check_tables(grid, LINK_TABLES)
        grid_attributes = grid.cell_attributes
        levels = []
        for level_number, level in enumerate(grid.grids):
            # metadata that equal the grid's, with all dtypes, are left out
            inherits_metadata = grid.inherits_metadata(level_number, level)
            inherits_metadata &= all(entry in grid_attributes for entry in level.cell_attributes)
            metadata = None if inherits_metadata else level.metadata
            levels.append(_level_fields(level, root_place["grids"][level_number], metadata))
        fields = {
            "type": "MultiLevelGrid",
            "metadata": _encode_metadata(grid, root_place),
            "cellSize": check_number(grid.cell_size, root_place["cellSize"], must_be_positive=True),
            "unit": check_number(grid.unit, root_place["unit"], must_be_positive=True),
            "grids": levels,
            "timings": check_json(grid.timings, root_place["timings"]),
            **_extra_fields(grid, root_place),
        }

    try:  # OPT_SERIALIZE_NUMPY only because of np.float64
        options = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_APPEND_NEWLINE
        return orjson.dumps(fields, option=options)
    except orjson.JSONEncodeError as error:  # an integer of over 64 bits, half a surrogate
        raise FormatError(f"cannot write the grid as JSON: {error}") from error


def _level_fields(grid: SceneGrid2D, place: JsonPath, metadata: Json | None) -> Json:
    """Return the fields of a level as in a file; without metadata if `metadata` is None."""

    def encode_layer(
        array: NDArray[Any], layer_place: JsonPath, datatype: str | None = None
    ) -> Json:
        if array.shape != grid.shape:
            layer_place.fail(f"expected shape (height, width) = {grid.shape}, got {array.shape}")
        layer: Json = {"type": "array"}
        if datatype is not None:
            layer["datatype"] = datatype
        layer["length"] = array.size
        layer["encoding"] = "rle"
        layer["data"] = orjson.Fragment(encode_array(array, layer_place["data"]))
        return layer

    fields: Json = {"type": "SceneGrid2D"}
    if metadata is not None:
        fields["metadata"] = _encode_metadata(grid, place)
    fields |= {
        "weights": encode_layer(grid.weights.astype(np.float64, copy=False), place["weights"]),
        "userData": orjson.Fragment(encode_user_data(grid, place["userData"])),
        "tileAttributes": {
            name: encode_layer(array, place["tileAttributes"][name], datatype=array.dtype.name)
            for name, array in grid.attributes.items()
        },
        "width": check_whole_number(int(grid.width), place["width"], 1),
        "height": check_whole_number(int(grid.height), place["height"], 1),
        "cellSize": check_number(grid.cell_size, place["cellSize"], must_be_positive=True),
        "min": [check_number(value, place["min"][i]) for i, value in enumerate(grid.min_yup)],
        "unit": check_number(grid.unit, place["unit"], must_be_positive=True),
    }
    if grid.bbox_yup is not None:
        lower_corner, upper_corner = grid.bbox_yup
        fields["bbox"] = {
            "min": [
                check_number(value, place["bbox"]["min"][i]) for i, value in enumerate(lower_corner)
            ],
            "max": [
                check_number(value, place["bbox"]["max"][i]) for i, value in enumerate(upper_corner)
            ],
        }
    fields["timings"] = check_json(grid.timings, place["timings"])
    return fields | _extra_fields(grid, place)


def _encode_metadata(grid: NavGrid, place: JsonPath) -> Json:
    """Return the grid's metadata, in which ``cellAttributes`` lists the arrays that exist."""
    place = place["metadata"]
    check_optional_object(grid.metadata, "navbake", place)
    metadata = {**grid.metadata, "cellAttributes": grid.cell_attributes}
    return check_object(check_json(metadata, place), place)


def _extra_fields(grid: NavGrid, place: JsonPath) -> Json:
    """Return the grid's extra fields, after a check that they are JSON and not the format's own."""
    check_extra(grid.extra, type(grid), place)
    return {key: check_json(grid.extra[key], place[key]) for key in grid.extra}


def check_extra(extra: Json, grid_class: type[NavGrid], place: JsonPath) -> None:
    """Raise a FormatError if an extra field has the name of a field of the format.

    Args:
        extra: the extra fields.
        grid_class: the class of the grid that has them.
        place: the grid's location, for errors.

    Raises:
        FormatError: the format has a field of that name.
    """
    for key in MULTI_LEVEL_GRID_FIELDS if grid_class is MultiLevelGrid else SCENE_GRID_FIELDS:
        if key in extra:
            place[key].fail("extra fields can't stand in for one of the format's own")


def encode_user_data(grid: SceneGrid2D, place: JsonPath) -> bytes:
    """Encode a level's user data as JSON by ascending cell id.

    Args:
        grid: the level.
        place: the location of its user data, for errors.

    Returns:
        The text of a JSON object.

    Raises:
        FormatError: the level has no such cell, or an entry is no JSON object.
    """
    num_cells = grid.width * grid.height
    stored_entries = UserData.of(grid.user_data).source
    if isinstance(stored_entries, SharedEntries):
        cell_ids = stored_entries.cells.tolist()
        entry_numbers = stored_entries.entry_index.tolist()
        entries = stored_entries.entries
        check_json(list(entries), place)
    else:
        for cell_id, value in stored_entries.items():
            if not isinstance(cell_id, int | np.integer):
                place.fail(
                    f"expected cell ids from 0 to {num_cells - 1}, got {format_value(cell_id)}"
                )
            if not isinstance(value, dict):
                place[int(cell_id)].refuse("an object", value)
        cell_ids = sorted(map(int, stored_entries))
        entry_numbers = range(len(cell_ids))
        entries = [stored_entries[cell_id] for cell_id in cell_ids]
        cell_entry_pairs = zip(cell_ids, entries, strict=True)
        check_json({str(cell_id): entry for cell_id, entry in cell_entry_pairs}, place)
    if cell_ids and not 0 <= cell_ids[0] <= cell_ids[-1] < num_cells:
        wrong_id = cell_ids[0] if cell_ids[0] < 0 else cell_ids[-1]
        place.fail(f"expected cell ids from 0 to {num_cells - 1}, got {wrong_id}", value=wrong_id)
    entry_texts = [orjson.dumps(entry) for entry in entries]
    chunks = []
    for first_index in range(0, len(cell_ids), CELLS_AT_ONCE):
        chunk_slice = slice(first_index, first_index + CELLS_AT_ONCE)
        # map instead of a generator: there may be millions of cells
        chunk_texts = map(entry_texts.__getitem__, entry_numbers[chunk_slice])
        pairs = zip(cell_ids[chunk_slice], chunk_texts, strict=True)
        chunks.append(b",".join(map(b'"%d":%b'.__mod__, pairs)))
    return b"{%b}" % b",".join(chunks)
