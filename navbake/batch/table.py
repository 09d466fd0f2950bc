"""Parquet: lists of scenes as tables, and the index as one. Only this module loads pyarrow."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from importlib.util import find_spec
from itertools import chain
from typing import Any

from navbake.batch.parquet_sizes import list_pages, read_chunks
from navbake.batch.stores.store import INSTALL
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError
from navbake.types import Json

NAME = "index.parquet"
# What a list may unpack to, as its pages say: few bytes of a dictionary, of runs or of zstd stand
# for any number of values. Lists of many scenes have names that differ, so they have bytes.
FREE_UNPACKED, UNPACKED_PER_BYTE = 64 << 20, 200  # [bytes], whichever is more
FREE_VALUES, VALUES_PER_BYTE = 1_000_000, 4  # of all columns, nulls counted; per unpacked byte
FREE_ROWS, BYTES_PER_ROW = 10_000, 4  # unpacked
FREE_TEXT, TEXT_PER_BYTE = 16 << 20, 8  # [bytes] of all rows, where rows share a text; unpacked
MAX_COLUMNS = 1000  # settings are fewer
FREE_PAGES, BYTES_PER_PAGE = 1000, 8  # packed
FREE_PARTS, BYTES_PER_PART = 100, 4  # elements of a list in the footer; packed
ROWS_AT_ONCE = 1024
PANDAS_INDEX = re.compile(r"__index_level_\d+__")  # a column that nobody asked for


def check_pyarrow() -> None:
    """Raise a MissingDependencyError where Parquet can be neither read nor written."""
    if find_spec("pyarrow") is None:
        raise MissingDependencyError(f"Parquet needs pyarrow: {INSTALL}")


def read_table(content: bytes, name: str) -> Iterator[tuple[str, Json]]:
    """The rows of a Parquet file, each with its place for messages.

    What is null, or NaN as pandas has it, is left out, also in structs.

    Raises:
        ConfigError: it is no Parquet, or stands for more than its size allows.
        MissingDependencyError: pyarrow is not installed.
    """
    check_pyarrow()
    import pyarrow  # the extra `batch`
    from pyarrow import parquet  # the extra `batch`

    limits = {
        "thrift_string_size_limit": len(content) + 1,
        "thrift_container_size_limit": FREE_PARTS + len(content) // BYTES_PER_PART,
    }
    try:
        metadata = parquet.ParquetFile(pyarrow.BufferReader(content), **limits).metadata
        unpacked, rows_at_once, texts = _check_claims(metadata, content, name)
        # texts that rows share stay shared until it is known how much they are
        file = parquet.ParquetFile(
            pyarrow.BufferReader(content), metadata=metadata, read_dictionary=texts, **limits
        )
        number = num_bytes = 0
        # group by group: each has its own texts to share, and pyarrow can't join these in structs
        groups = range(metadata.num_row_groups)
        for batch in chain.from_iterable(
            file.iter_batches(rows_at_once, [group], use_threads=False) for group in groups
        ):
            num_bytes += sum(map(_text_bytes, batch.columns))
            _check_size(num_bytes, FREE_TEXT + TEXT_PER_BYTE * unpacked, "bytes of text", name)
            _check_size(number + len(batch), FREE_ROWS + unpacked // BYTES_PER_ROW, "rows", name)
            for row in batch.to_pylist():
                number += 1
                yield f"{name}, row {number}", _without_nulls(row)
    except NavbakeError:
        raise
    except Exception as error:  # pyarrow raises its own, and what Python has for odd values
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ConfigError(f"broken Parquet in {name}: {reason}") from error


def _check_claims(metadata: Any, content: bytes, name: str) -> tuple[int, int, list[str]]:
    """Check what the headers of pages claim, before anything is unpacked.

    Returns:
        What all pages unpack to [bytes], how many rows may be read at once, and the columns whose
        texts can be read without a copy for each row that has them.

    Raises:
        ConfigError: it is too much.
    """
    most_unpacked = max(FREE_UNPACKED, UNPACKED_PER_BYTE * len(content))
    most_pages = FREE_PAGES + len(content) // BYTES_PER_PAGE
    unpacked = values = pages = fixed = longest = 0
    texts = []
    _check_size(metadata.num_columns, MAX_COLUMNS, "columns", name)
    groups = read_chunks(content)
    for number in range(metadata.num_columns):
        column = metadata.schema.column(number)
        length = column.length if column.physical_type == "FIXED_LEN_BYTE_ARRAY" else 0
        column_longest, is_delta = 0, False
        for page in (page for group in groups for page in list_pages(content, group[number])):
            unpacked, values, pages = unpacked + page.unpacked, values + page.values, pages + 1
            fixed += page.values * length
            column_longest = max(column_longest, page.unpacked)
            is_delta |= page.is_delta
            _check_size(unpacked, most_unpacked, "bytes unpacked", name)
            _check_size(pages, most_pages, "pages", name)
        if column.physical_type != "BYTE_ARRAY":
            continue
        if not is_delta:
            texts.append(column.path)
        elif column.max_repetition_level:
            raise ConfigError(
                f"{name} has lists of texts in an encoding of differences: save it as PLAIN"
            )
        else:  # pyarrow copies these for each row, and each may be as long as a page
            longest = max(longest, column_longest)
    _check_size(values, FREE_VALUES + VALUES_PER_BYTE * unpacked, "values", name)
    _check_size(fixed, FREE_TEXT + TEXT_PER_BYTE * unpacked, "bytes of fixed length", name)
    return unpacked, max(1, min(ROWS_AT_ONCE, FREE_TEXT // 4 // max(longest, 1))), texts


def _check_size(size: int, most: int, what: str, name: str) -> None:
    if size > most:
        raise ConfigError(
            f"{name} is too large: expected at most {most:,} {what} for its size, got {size:,} or "
            "more"
        )


def _text_bytes(array: Any) -> int:
    """What the texts of an array of Arrow take where each value has its own [bytes]."""
    import pyarrow  # the extra `batch`
    from pyarrow import compute  # the extra `batch`

    kind = array.type
    if pyarrow.types.is_dictionary(kind):
        lengths = compute.binary_length(array.dictionary)
        return int(compute.sum(lengths.take(array.indices)).as_py() or 0)
    if pyarrow.types.is_struct(kind):
        return sum(map(_text_bytes, array.flatten()))
    if pyarrow.types.is_string(kind) or pyarrow.types.is_binary(kind):
        return int(array.nbytes)
    if pyarrow.types.is_map(kind):
        return _text_bytes(array.keys) + _text_bytes(array.items)
    if pyarrow.types.is_list(kind) or pyarrow.types.is_large_list(kind):
        return _text_bytes(array.flatten())
    return 0


def _without_nulls(row: Mapping[str, Any]) -> Json:
    found = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            value = _without_nulls(value) or None
        is_nan = isinstance(value, float) and math.isnan(value)
        if value is not None and not is_nan and not PANDAS_INDEX.fullmatch(key):
            found[key] = value
    return found


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
