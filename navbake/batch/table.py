"""Parquet: lists of scenes as tables, and the index as one. Only this module loads pyarrow."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from inspect import signature
from typing import Any, NamedTuple

from navbake.batch.parquet_sizes import (
    DELTA_BYTE_ARRAY,
    DELTA_LENGTH_BYTE_ARRAY,
    DICTIONARY,
    footer_size,
    list_pages,
    read_chunks,
)
from navbake.batch.stores.store import INSTALL
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError, shorten
from navbake.types import Json

NAME = "index.parquet"
# What a list may unpack to, as its pages say: few bytes of a dictionary, of runs or of zstd stand
# for any number of values. Lists of many scenes have names that differ, so they have bytes.
FREE_UNPACKED, UNPACKED_PER_BYTE = 64 << 20, 200  # [bytes], whichever is more
FREE_VALUES, VALUES_PER_BYTE = 1_000_000, 4  # of all columns, nulls counted; per unpacked byte
FREE_ROWS, BYTES_PER_ROW = 10_000, 4  # unpacked
FREE_TEXT, TEXT_PER_BYTE = 16 << 20, 8  # [bytes] of all rows, where rows share a text; unpacked
TEXT_PER_ROW = 512  # [bytes] a long path or two that all rows share, as one of settings
MAX_COLUMNS = 1000  # settings are fewer
FREE_PAGES, BYTES_PER_PAGE = 1000, 8  # packed
FREE_PARTS, BYTES_PER_PART = 100, 4  # elements of a list in the footer; packed
ROWS_AT_ONCE = 1024
# What pyarrow, pandas and polars note in the footer: which types of Arrow the columns were. Without
# it texts are of one type, which pyarrow can read without copies.
ARROW_TYPES = b"ARROW:schema"
PANDAS_INDEX = re.compile(r"__index_level_\d+__")  # a column that nobody asked for


class Reading(NamedTuple):
    """How a group of rows is read.

    Attributes:
        texts: the columns whose texts can be read without a copy for each row that has them.
        rows_at_once: how many rows may be read at once.
    """

    texts: tuple[str, ...]
    rows_at_once: int


class _Chunk(NamedTuple):
    """A column in a group of rows: what pyarrow has of it, encodings, longest page [bytes]."""

    column: Any
    encodings: set[int]
    longest_page: int


def check_pyarrow() -> None:
    """Raise a MissingDependencyError where Parquet can be neither read nor written."""
    if find_spec("pyarrow") is None:
        raise MissingDependencyError(f"Parquet needs pyarrow: {INSTALL}")


def read_table(content: bytes, name: str) -> Iterator[tuple[str, Json]]:
    """The rows of a Parquet file, each with its place for messages.

    What is not given is null, or NaN as pandas has it.

    Raises:
        ConfigError: it is no Parquet, or stands for more than its size allows.
        MissingDependencyError: pyarrow is not installed.
    """
    check_pyarrow()
    try:
        metadata = _read_metadata(content)
        unpacked, readings = check_claims(metadata, content, name)
        number = num_bytes = 0
        for batch in _read_batches(content, metadata, readings):
            _check_size(number + len(batch), FREE_ROWS + unpacked // BYTES_PER_ROW, "rows", name)
            num_bytes += sum(map(count_text_bytes, batch.columns))
            most = FREE_TEXT + TEXT_PER_BYTE * unpacked + TEXT_PER_ROW * (number + len(batch))
            _check_size(num_bytes, most, "bytes of text", name)
            _check_columns(batch.schema.names, name)
            for row in batch.to_pylist():
                number += 1
                asked = {k: value for k, value in row.items() if not PANDAS_INDEX.fullmatch(k)}
                yield f"{name}, row {number}", asked
    except NavbakeError:
        raise
    except Exception as error:  # pyarrow raises its own, and what Python has for odd values
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ConfigError(f"broken Parquet in {name}: {reason}") from error


def _read_metadata(content: bytes) -> Any:
    """What the footer says, without Arrow's own types: then all is read as Parquet's."""
    footer = content[-footer_size(content) :].replace(ARROW_TYPES, b"-" * len(ARROW_TYPES))
    return _open(footer, len(content)).metadata


def _open(content: bytes, size: int, **options: Any) -> Any:
    """A Parquet file of pyarrow; the size is that of the whole file [bytes]."""
    import pyarrow  # the extra `batch`
    from pyarrow import parquet  # the extra `batch`

    options["thrift_string_size_limit"] = size + 1
    options["thrift_container_size_limit"] = FREE_PARTS + size // BYTES_PER_PART
    # JSON as text, whose copies can be avoided; pyarrow before 21 has it so
    if "arrow_extensions_enabled" in signature(parquet.ParquetFile).parameters:
        options["arrow_extensions_enabled"] = False
    return parquet.ParquetFile(pyarrow.BufferReader(content), **options)


def _read_batches(content: bytes, metadata: Any, readings: list[Reading]) -> Iterator[Any]:
    """The rows, some at once; texts that they share stay shared.

    Group by group: each has its own texts to share, and pyarrow can't join these in structs.
    """
    file, texts = None, None
    for group, reading in zip(range(metadata.num_row_groups), readings, strict=True):
        if file is None or texts != reading.texts:
            texts = reading.texts
            file = _open(content, len(content), metadata=metadata, read_dictionary=texts)
        yield from file.iter_batches(reading.rows_at_once, [group], use_threads=False)


def check_claims(metadata: Any, content: bytes, name: str) -> tuple[int, list[Reading]]:
    """Check what the headers of pages claim, before anything is unpacked.

    Args:
        metadata: what pyarrow has of the footer.
        content: the file.
        name: what messages call it.

    Returns:
        What all pages unpack to [bytes], and how each group of rows is read.

    Raises:
        ConfigError: it is too much.
    """
    most_unpacked = max(FREE_UNPACKED, UNPACKED_PER_BYTE * len(content))
    most_pages = FREE_PAGES + len(content) // BYTES_PER_PAGE
    unpacked = values = pages = fixed = 0
    readings = []
    _check_size(metadata.num_columns, MAX_COLUMNS, "columns", name)
    columns = [metadata.schema.column(number) for number in range(metadata.num_columns)]
    for group in read_chunks(content):
        chunks = []
        for number, column in enumerate(columns):
            length = column.length if column.physical_type == "FIXED_LEN_BYTE_ARRAY" else 0
            encodings: set[int] = set()
            longest = 0
            for page in list_pages(content, group[number]):
                unpacked, values, pages = unpacked + page.unpacked, values + page.values, pages + 1
                fixed += page.values * length
                longest = max(longest, page.unpacked)
                encodings.update(page.encodings)
                _check_size(unpacked, most_unpacked, "bytes unpacked", name)
                _check_size(pages, most_pages, "pages", name)
            chunks.append(_Chunk(column, encodings, longest))
        readings.append(_plan_reading(chunks, name))
    _check_size(values, FREE_VALUES + VALUES_PER_BYTE * unpacked, "values", name)
    _check_size(fixed, FREE_TEXT + TEXT_PER_BYTE * unpacked, "bytes of fixed length", name)
    return unpacked, readings


def _plan_reading(chunks: list[_Chunk], name: str) -> Reading:
    """How a group of rows is read, by what is in its columns."""
    texts, longest = [], 0
    for column, encodings, longest_page in chunks:
        if column.physical_type != "BYTE_ARRAY":
            continue
        if not encodings & {DELTA_BYTE_ARRAY, DELTA_LENGTH_BYTE_ARRAY}:
            texts.append(column.path)
        elif DELTA_BYTE_ARRAY not in encodings and not encodings & DICTIONARY:
            continue  # its pages have each text in full
        elif column.max_repetition_level:
            raise ConfigError(
                f"{name} has lists of texts in an encoding of differences: save it as PLAIN"
            )
        else:  # pyarrow copies these for each row, and each may be as long as a page
            longest = max(longest, longest_page)
    return Reading(tuple(texts), max(1, min(ROWS_AT_ONCE, FREE_TEXT // 4 // max(longest, 1))))


def _check_size(size: int, most: int, what: str, name: str) -> None:
    if size > most:
        raise ConfigError(
            f"{name} is too large: expected at most {most:,} {what} for its size, got {size:,} or "
            "more"
        )


def count_text_bytes(array: Any) -> int:
    """What the texts of an array of Arrow take where each value has its own [bytes].

    Values of fixed length count nothing: pages say how many there are.

    Raises:
        TypeError: it has values of a type that Parquet hasn't.
    """
    from pyarrow import compute, types  # the extra `batch`

    kind = array.type
    if types.is_dictionary(kind):
        lengths = compute.binary_length(array.dictionary)
        return int(compute.sum(lengths.take(array.indices)).as_py() or 0)
    if types.is_struct(kind):
        return sum(map(count_text_bytes, array.flatten()))
    if types.is_string(kind) or types.is_binary(kind):
        return int(array.nbytes)
    if types.is_map(kind):
        return count_text_bytes(array.keys) + count_text_bytes(array.items)
    if types.is_list(kind):
        return count_text_bytes(array.flatten())
    if types.is_fixed_size_binary(kind) or types.is_decimal(kind):
        return 0
    if types.is_primitive(kind) or types.is_null(kind):
        return 0
    raise TypeError(f"values of the type {kind}")


def _check_columns(columns: Sequence[str], name: str) -> None:
    for column, count in Counter(columns).items():
        if count > 1:
            got = f"`{shorten(column)}` {count} times"
            raise ConfigError(f"expected each column once, got {got} in {name}")


def encode_rows(rows: Iterable[Json]) -> bytes:
    """Rows of an index as a Parquet file; the same rows, the same bytes.

    Its columns are those of `_schema`, whatever the rows hold: those of several batches can be
    joined.

    Raises:
        NavbakeError: a row has a value of another type, as of an index that somebody changed.
    """
    import pyarrow  # the extra `batch`
    from pyarrow import parquet  # the extra `batch`

    try:
        table = pyarrow.Table.from_pylist([_cells(row) for row in rows], schema=_schema(pyarrow))
    except (pyarrow.ArrowException, ArithmeticError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise NavbakeError(f"a row of the index doesn't fit into {NAME}: {reason}") from error
    file = io.BytesIO()
    parquet.write_table(table, file, compression="zstd")
    return file.getvalue()


def _schema(pyarrow: Any) -> Any:
    """The columns: name and type, in the order of docs/batch.md."""
    text, texts = pyarrow.string(), pyarrow.list_(pyarrow.string())
    number, count, wide = pyarrow.float64(), pyarrow.int32(), pyarrow.int64()
    file = pyarrow.struct([("path", text), ("size", wide), ("sha256", text)])
    return pyarrow.schema(
        [
            *(("id", text), ("source", text), ("status", text), ("how", text), ("error", text)),
            *(("levels", count), ("cells", wide), ("free_area", number)),
            *(("rooms", count), ("doors", count)),
            *(("warnings", texts), ("audit", texts)),
            *(("seconds", number), ("stages", pyarrow.map_(text, number)), ("ended", text)),
            *(("scene_digest", text), ("settings_digest", text), ("version", text), ("key", text)),
            *(("inputs", pyarrow.list_(file)), ("files", pyarrow.list_(file))),
        ]
    )


def _cells(row: Json) -> Json:
    cells = dict(row)
    stages = row.get("stages")
    if isinstance(stages, Mapping):
        cells["stages"] = [*stages.items()]
    elif stages is not None:  # pyarrow ends the process where such a list has nulls
        raise TypeError("expected an object as `stages`")
    for key in ("inputs", "files"):
        if isinstance(row.get(key), Mapping):
            cells[key] = [_file_of(path, state) for path, state in row[key].items()]
    return cells


def _file_of(path: str, state: Any) -> Json:
    known = state if isinstance(state, Mapping) else {}
    return {"path": path, "size": known.get("size"), "sha256": known.get("sha256")}
