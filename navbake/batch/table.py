"""Parquet: lists of scenes as tables, and the index as one. Only this module loads pyarrow."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from importlib.util import find_spec
from typing import Any

from navbake.batch.stores.store import INSTALL
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError
from navbake.types import Json

NAME = "index.parquet"
MAX_UNPACKED = 4 << 30  # of a list [bytes]
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
        ConfigError: it is no Parquet, or too large.
        MissingDependencyError: pyarrow is not installed.
    """
    check_pyarrow()
    import pyarrow  # the extra `batch`
    from pyarrow import parquet  # the extra `batch`

    try:
        file = parquet.ParquetFile(io.BytesIO(content))
        groups = range(file.metadata.num_row_groups)
        size = sum(file.metadata.row_group(group).total_byte_size for group in groups)
        if size > MAX_UNPACKED:
            raise ConfigError(f"{name} is too large: expected {MAX_UNPACKED:,} bytes unpacked")
        number = 0
        for batch in file.iter_batches(ROWS_AT_ONCE):
            for row in batch.to_pylist():
                number += 1
                yield f"{name}, row {number}", _without_nulls(row)
    except (pyarrow.ArrowException, ArithmeticError, OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ConfigError(f"broken Parquet in {name}: {reason}") from error


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

    schema = _schema(pyarrow)
    cells = [_cells(row) for row in rows]
    try:
        table = pyarrow.Table.from_pylist(cells, schema=schema)
    except (pyarrow.ArrowException, TypeError, ValueError) as error:
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
    if isinstance(row.get("stages"), Mapping):
        cells["stages"] = [*row["stages"].items()]
    for key in ("inputs", "files"):
        if isinstance(row.get(key), Mapping):
            cells[key] = [_file_of(path, state) for path, state in row[key].items()]
    return cells


def _file_of(path: str, state: Any) -> Json:
    known = state if isinstance(state, Mapping) else {}
    return {"path": path, "size": known.get("size"), "sha256": known.get("sha256")}
