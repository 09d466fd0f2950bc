"""Arrays in NavGrid files: JSON lists, raw or run-length encoded, one value a cell.

Run-length encoding is ``[value, count, value, count, …]``. NaN and Infinity, which JSON lacks, are
``null``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.formats.allowance import MISSING, Allowance, JsonPath, check_whole_number
from navbake.navgrid.metadata import datatype_name
from navbake.types import Float, Int

DATATYPES = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")
PIECE = 1 << 20  # cells or runs encoded at once, to limit memory


def decode_array(
    value: object,
    place: JsonPath,
    shape: tuple[int, int],
    allowance: Allowance,
    *,
    default: object = None,
    null: float = np.nan,
) -> NDArray[Any]:
    """Read an array: an object with ``data``, or a bare list, which is raw.

    Of ``{"datatype", "length", "encoding", "data"}``, only ``data`` is required; ``dataType`` is an
    alias of ``datatype``, which defaults to the metadata's `default`, else float64. ``null``
    becomes `null`, in raw data, too, where the original client keeps it.
    """
    data_place = place if isinstance(value, list) else place["data"]
    if isinstance(value, list):
        value = {"data": value}
    if not isinstance(value, dict):
        place.refuse("an array", value)
    if value.get("type") not in (None, "array"):
        place["type"].refuse("'array'", value["type"])
    own = [key for key in ("datatype", "dataType") if value.get(key) is not None]
    stated = value[own[0]] if own else "float64" if default is None else default
    name = datatype_name(stated) if isinstance(stated, str) else ""
    if name not in DATATYPES:
        where = place[own[0]] if own else place
        where.refuse(f"a datatype of {', '.join(DATATYPES)}", stated)
    dtype = np.dtype(name)
    num_cells = math.prod(shape)
    if value.get("length") is not None:
        length = check_whole_number(value["length"], place["length"], 0)
        if length != num_cells:
            place["length"].refuse(f"{num_cells}, which is width × height", length)
    allowance.take_array(shape, dtype.itemsize, place)
    data = value.get("data", MISSING)
    if not isinstance(data, list):
        data_place.refuse("a list", data)
    encoding = value.get("encoding")
    if encoding not in (None, "raw", "rle"):
        place["encoding"].refuse("'rle' or 'raw'", encoding)
    if encoding == "rle":
        counts = _read_counts(data, data_place, num_cells)
        return np.repeat(_cast(data, data_place, 2, dtype, null), counts).reshape(shape)
    if len(data) != num_cells:
        data_place.fail(f"expected {num_cells} values, one a cell, got {len(data)}")
    return _cast(data, data_place, 1, dtype, null).reshape(shape)


def _read_counts(data: list[Any], place: JsonPath, num_cells: int) -> Int:
    """The lengths of runs, checked to cover all cells before any array of that size is made."""
    if len(data) % 2:
        place.fail(f"expected pairs of value and count, got an odd number ({len(data)}) of entries")
    expected = "a count, a whole number >= 0"
    counts = _to_float64(data, place, slice(1, None, 2), expected, (int, float))
    bad = (counts < 0) | (counts != np.floor(counts))
    if bad.any():
        index = 2 * int(np.argmax(bad)) + 1
        place[index].refuse(expected, data[index])
    if counts.sum() != num_cells:
        place.fail(f"expected runs over {num_cells} cells, got runs over {counts.sum():.15g}")
    return counts.astype(np.int64)


def _cast(
    data: list[Any], place: JsonPath, step: int, dtype: np.dtype[Any], null: float
) -> NDArray[Any]:
    """Convert every step-th entry to the dtype; raises for the first that does not fit."""
    kinds = (int, float, type(None)) if dtype.kind == "f" else (int, float)
    values = _to_float64(data, place, slice(0, None, step), f"a value of {dtype}", kinds)
    if dtype.kind == "f":
        # JSON has no infinity, so one comes from a number beyond the dtype
        with np.errstate(over="ignore"):
            bad = np.isinf(values.astype(dtype))
    else:
        info = np.iinfo(dtype)
        bad = (values < info.min) | (values > info.max) | (values != np.floor(values))
    if bad.any():
        index = step * int(np.argmax(bad))
        place[index].refuse(f"a value of {dtype}", data[index])
    if dtype.kind == "f" and not np.isnan(null):
        values[np.isnan(values)] = null
    return values.astype(dtype, copy=False)


def _to_float64(
    data: list[Any], place: JsonPath, part: slice, expected: str, kinds: tuple[type, ...]
) -> Float:
    """Convert a part of a list of numbers and None (NaN) to an array."""
    entries = data[part]
    if not set(map(type, entries)) <= set(kinds):  # bool is no int here
        index = next(i for i in range(len(data))[part] if type(data[i]) not in kinds)
        place[index].refuse(expected, data[index])
    return np.array(entries, dtype=np.float64)


def encode_array(array: NDArray[Any], place: JsonPath) -> bytes:
    """Encode an array as the JSON list of its runs, ``[value,count,value,count,…]``.

    NaN and infinities become ``null``, -0.0 becomes 0, whole floats lose their ".0", and a
    float32 gets its own shortest decimal.
    """
    if array.dtype.name not in DATATYPES:
        place.fail(f"expected a dtype of {', '.join(DATATYPES)}, got {array.dtype}")
    cells = array.reshape(-1)
    starts = [np.zeros(1, np.int64)]
    texts = []
    for first in range(1, len(cells), PIECE):
        piece = _as_written(cells[first - 1 : first + PIECE])
        differs = piece[1:] != piece[:-1]
        if piece.dtype.kind == "f":
            differs &= ~(np.isnan(piece[1:]) & np.isnan(piece[:-1]))
        starts.append(np.flatnonzero(differs) + first)
    start = np.concatenate(starts)
    count = np.diff(start, append=len(cells))
    for first in range(0, len(start), PIECE):
        values = _as_written(cells[start[first : first + PIECE]])
        counts = count[first : first + PIECE]
        if values.dtype.kind == "f":
            pieces = [b""] * (2 * len(counts))
            pieces[0::2] = _dump(values).split(b",")
            pieces[1::2] = _dump(counts).split(b",")
            texts.append(b",".join(pieces).replace(b".0,", b","))
        else:
            texts.append(_dump(np.stack([values.astype(np.int64), counts], axis=1).ravel()))
    return b"[%b]" % b",".join(texts)


def _as_written(cells: NDArray[Any]) -> NDArray[Any]:
    """Values in native byte order, infinities as NaN, and no -0.0."""
    cells = cells.astype(cells.dtype.newbyteorder("="), copy=False)
    if cells.dtype.kind != "f":
        return cells
    with np.errstate(invalid="ignore"):  # of NaNs that signal, as an archive may have them
        return np.where(np.isfinite(cells), cells + 0, cells.dtype.type(np.nan))


def _dump(array: NDArray[Any]) -> bytes:
    """Numbers as JSON, without brackets."""
    return orjson.dumps(array, option=orjson.OPT_SERIALIZE_NUMPY)[1:-1]
