"""Arrays in NavGrid files: JSON lists of a value for each cell, raw or run-length encoded.

Run-length encoding is ``[value, count, value, count, …]``. NaN and Infinity, which JSON lacks, are
``null``.
"""

from __future__ import annotations

import math
import struct
from contextlib import suppress
from typing import Any, NoReturn

import msgspec
import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.formats.allowance import ABSENT, Allowance, JsonPath, check_whole_number
from navbake.navgrid.metadata import datatype_name
from navbake.types import Float, Int, JsonValue

DATATYPES = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64")
EXPECTED_COUNT = "a count, a whole number >= 0"
CHUNK_LENGTH = 1 << 20  # cells or runs that are encoded at once, to limit memory


def decode_array(
    value: object,
    place: JsonPath,
    shape: tuple[int, int],
    allowance: Allowance,
    *,
    default_datatype: object = None,
    null_value: float = np.nan,
) -> NDArray[Any]:
    """Decode the array of a level's layer, such as its weights, from a NavGrid file.

    The file has an object ``{"datatype", "length", "encoding", "data"}``, of which only ``data`` is
    required, or the bare list of the cells' values. ``dataType`` is an alias of ``datatype``.

    Args:
        value: the array as parsed.
        place: its location in the file, for errors.
        shape: height and width of the level.
        allowance: what the array's memory is taken from.
        default_datatype: the datatype that the metadata state for the array; float64 if None.
        null_value: the number that replaces ``null`` in arrays of floats.

    Returns:
        The array, of this shape, with the datatype that the file states.

    Raises:
        FormatError: the array is broken or too large, or its length does not fit the shape.
    """
    data_place = place if isinstance(value, list) else place["data"]
    if isinstance(value, list):
        value = {"data": value}
    if not isinstance(value, dict):
        place.refuse("an array", value)
    if value.get("type") not in (None, "array"):
        place["type"].refuse("'array'", value["type"])
    datatype = "float64" if default_datatype is None else default_datatype
    datatype_place = place
    for key in ("dataType", "datatype"):  # ``datatype`` counts where a file has both
        if value.get(key) is not None:
            datatype = value[key]
            datatype_place = place[key]
    dtype_name = datatype_name(datatype) if isinstance(datatype, str) else ""
    if dtype_name not in DATATYPES:
        datatype_place.refuse(f"a datatype of {', '.join(DATATYPES)}", datatype)
    dtype = np.dtype(dtype_name)
    num_cells = math.prod(shape)
    if value.get("length") is not None:
        length = check_whole_number(value["length"], place["length"], 0)
        if length != num_cells:
            place["length"].refuse(f"{num_cells}, which is width × height", length)
    allowance.take_array(shape, dtype.itemsize, place)
    data = value.get("data", ABSENT)
    if not isinstance(data, list):
        data_place.refuse("a list", data)
    encoding = value.get("encoding")
    if encoding not in (None, "raw", "rle"):
        place["encoding"].refuse("'rle' or 'raw'", encoding)
    if encoding == "rle":
        if len(data) % 2:
            data_place.fail(
                f"expected pairs of value and count, got an odd number ({len(data)}) of entries"
            )
        try:
            # counts are whole numbers, also where the values are not, or are null
            values = _to_array(data[0::2])
            counts = _to_array(data[1::2])
        except msgspec.ValidationError:
            _refuse_first_invalid(data, data_place, (f"a value of {dtype}", EXPECTED_COUNT))
        run_lengths = _check_counts(counts, data, data_place, num_cells)
        run_values = _cast_values(values, data, data_place, dtype, null_value)
        return np.repeat(run_values, run_lengths).reshape(shape)
    if len(data) != num_cells:
        data_place.fail(f"expected {num_cells} values, one a cell, got {len(data)}")
    try:
        values = _to_array(data)
    except msgspec.ValidationError:
        _refuse_first_invalid(data, data_place, (f"a value of {dtype}",))
    return _cast_values(values, data, data_place, dtype, null_value).reshape(shape)


def _to_array(numbers: list[JsonValue]) -> Int | Float:
    """Convert a list of numbers and None to an array; None becomes NaN.

    Returns:
        int64 if all entries are whole numbers of 64 bits, else float64; it may be read-only.

    Raises:
        msgspec.ValidationError: an entry is neither a number nor None.
    """
    # msgspec checks types, and struct packs numbers, in half of the time that numpy takes for a
    # list; most arrays hold whole numbers alone, for which that is fastest
    with suppress(msgspec.ValidationError, struct.error):
        whole_numbers = msgspec.convert(numbers, tuple[int, ...])
        return np.frombuffer(struct.pack(f"{len(numbers)}q", *whole_numbers), np.int64)
    nan = math.nan
    floats = msgspec.convert(
        [nan if number is None else number for number in numbers], tuple[int | float, ...]
    )
    return np.frombuffer(struct.pack(f"{len(numbers)}d", *floats), np.float64)


def _refuse_first_invalid(
    data: list[JsonValue], place: JsonPath, expected: tuple[str, ...]
) -> NoReturn:
    """Raise a FormatError for the first entry of a list that is neither a number nor None.

    Args:
        data: the list, which has such an entry.
        place: its location in the file.
        expected: what the entries should be, in turn.
    """
    number_types = (int, float, type(None))  # as a type of its own, bool is no int
    index = next(index for index, entry in enumerate(data) if type(entry) not in number_types)
    place[index].refuse(expected[index % len(expected)], data[index])


def _check_counts(
    run_lengths: Int | Float, data: list[JsonValue], place: JsonPath, num_cells: int
) -> Int:
    """Return the lengths of runs after a check that they cover all cells exactly.

    The check comes before any array of that size is made.
    """
    is_invalid = ~(run_lengths >= 0)
    if run_lengths.dtype.kind == "f":
        is_invalid |= run_lengths != np.floor(run_lengths)
    if is_invalid.any():
        index = 2 * int(np.argmax(is_invalid)) + 1
        place[index].refuse(EXPECTED_COUNT, data[index])
    num_covered = run_lengths.sum(dtype=np.float64)  # a sum of whole numbers could overflow
    if num_covered != num_cells:
        place.fail(f"expected runs over {num_cells} cells, got runs over {num_covered:.15g}")
    return run_lengths.astype(np.int64, copy=False)


def _cast_values(
    values: Int | Float,
    data: list[JsonValue],
    place: JsonPath,
    dtype: np.dtype[Any],
    null_value: float,
) -> NDArray[Any]:
    """Return a copy of values in a dtype; NaN becomes the number `null_value`.

    A FormatError is raised for the first value that the dtype can't hold. Values are all entries
    of `data`, or every second one.
    """
    if dtype.kind == "f":
        values = values.astype(np.float64)
        # JSON has no infinity, so one comes from a number beyond the dtype
        with np.errstate(over="ignore"):
            is_invalid = np.isinf(values.astype(dtype, copy=False))
    else:
        integer_range = np.iinfo(dtype)
        is_invalid = ~((values >= integer_range.min) & (values <= integer_range.max))
        if values.dtype.kind == "f":
            is_invalid |= values != np.floor(values)
    if is_invalid.any():
        index = len(data) // len(values) * int(np.argmax(is_invalid))
        place[index].refuse(f"a value of {dtype}", data[index])
    if dtype.kind == "f" and not np.isnan(null_value):
        values[np.isnan(values)] = null_value
    return values.astype(dtype, copy=False)


def encode_array(array: NDArray[Any], place: JsonPath) -> bytes:
    """Encode an array as the JSON list of its runs, ``[value,count,value,count,…]``.

    NaN and infinities become ``null``, -0.0 becomes 0, whole floats lose their ".0", and a
    float32 is written as the shortest decimal that identifies it as a float32.

    Args:
        array: an array of one of `DATATYPES`, of any shape; it is written row by row.
        place: its location in the file, for errors.

    Returns:
        The text of the list.

    Raises:
        FormatError: the array has none of these dtypes.
    """
    if array.dtype.name not in DATATYPES:
        place.fail(f"expected a dtype of {', '.join(DATATYPES)}, got {array.dtype}")
    cells = array.reshape(-1)
    run_start_chunks = []
    run_value_chunks = []
    for chunk_start in range(0, len(cells), CHUNK_LENGTH):
        # with the last cell of the chunk before
        first_cell = max(chunk_start - 1, 0)
        chunk = _normalize_values(cells[first_cell : chunk_start + CHUNK_LENGTH])
        is_run_start = np.empty(len(chunk), dtype=np.bool_)
        is_run_start[0] = chunk_start == 0
        np.not_equal(chunk[1:], chunk[:-1], out=is_run_start[1:])
        if chunk.dtype.kind == "f":
            is_run_start[1:] &= ~(np.isnan(chunk[1:]) & np.isnan(chunk[:-1]))
        run_indices = is_run_start.nonzero()[0]
        run_start_chunks.append(run_indices + first_cell)
        run_value_chunks.append(chunk[run_indices])
    run_bounds = np.concatenate([*run_start_chunks, [len(cells)]])
    run_lengths = run_bounds[1:] - run_bounds[:-1]
    run_values = np.concatenate(run_value_chunks)

    chunk_texts = []
    for chunk_start in range(0, len(run_values), CHUNK_LENGTH):
        values = run_values[chunk_start : chunk_start + CHUNK_LENGTH]
        counts = run_lengths[chunk_start : chunk_start + CHUNK_LENGTH]
        if values.dtype.kind == "f":
            number_texts = [b""] * (2 * len(counts))
            number_texts[0::2] = _dump_numbers(values).split(b",")
            number_texts[1::2] = _dump_numbers(counts).split(b",")
            chunk_texts.append(b",".join(number_texts).replace(b".0,", b","))
        else:
            pairs = np.empty((len(values), 2), dtype=np.int64)
            pairs[:, 0] = values
            pairs[:, 1] = counts
            chunk_texts.append(_dump_numbers(pairs.ravel()))
    return b"[%b]" % b",".join(chunk_texts)


def _normalize_values(cells: NDArray[Any]) -> NDArray[Any]:
    """Return values in native byte order, with NaN for infinities and 0 for -0.0."""
    cells = cells.astype(cells.dtype.newbyteorder("="), copy=False)
    if cells.dtype.kind != "f":
        return cells
    with np.errstate(invalid="ignore"):  # of NaNs that signal, as an archive may have them
        return np.where(np.isfinite(cells), cells + 0, cells.dtype.type(np.nan))


def _dump_numbers(array: NDArray[Any]) -> bytes:
    """Encode numbers as a JSON list without its brackets."""
    return orjson.dumps(array, option=orjson.OPT_SERIALIZE_NUMPY)[1:-1]
