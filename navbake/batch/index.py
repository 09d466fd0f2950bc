"""The index of a batch: a line of JSON for each scene, and the same as Parquet.

A batch may be baked in slices, for example on several machines. Each slice writes an index of its
own, such as ``index-3-of-64.jsonl``, and holds a lock of its own. The next run of the whole batch
merges them into the index.
"""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, cast

import filelock

from navbake.batch import store
from navbake.batch.products import MEASURE_CLASSES
from navbake.batch.scene_row import SceneRow
from navbake.errors import NavbakeError
from navbake.files import write_all
from navbake.formats.source import import_extra
from navbake.types import Json

INDEX_NAME = "index.jsonl"
TABLE_NAME = "index.parquet"
LOCK_NAME = ".navbake-batch.lock"
SLICE_INDEX_PATTERN = re.compile(r"index-(\d+)-of-(\d+)\.jsonl")
SLICE_LOCK_PATTERN = re.compile(r"\.navbake-batch-\d+-of-\d+\.lock")
LOCK_TIMEOUT = 5.0  # how long a slice waits for a lock, which another slice may hold briefly [s]


class Slice(NamedTuple):
    """One of `total` slices of a batch: every `total`-th scene, beginning with scene `number`."""

    number: int  #: 1 to `total`.
    total: int  #: Number of slices.

    @property
    def index_name(self) -> str:
        """The name of the file with the slice's index."""
        return f"index-{self.number}-of-{self.total}.jsonl"


@contextmanager
def lock_batch(folder: Path, batch_slice: Slice | None = None) -> Iterator[None]:
    """Hold the lock of an output folder within the with statement; make the folder if need be.

    A whole batch excludes all others. A slice excludes whole batches and other runs of the same
    slice. The operating system releases the lock when the process ends.

    Args:
        folder: the output folder.
        batch_slice: the slice that this process bakes; None for the whole batch.

    Raises:
        NavbakeError: another batch holds a lock, or the folder can't be made or written.
    """
    if folder.is_file():
        raise NavbakeError(f"expected a folder to write into, got {folder}, which is a file")
    index_name = INDEX_NAME if batch_slice is None else batch_slice.index_name
    for file_name in (LOCK_NAME, index_name, TABLE_NAME):
        store.check_inside(folder, folder / file_name)
    slice_lock_names: list[str] = []  # names of the files
    with ExitStack() as exit_stack:

        def acquire_lock(lock_name: str) -> filelock.BaseFileLock:
            lock = filelock.FileLock(folder / lock_name, timeout=LOCK_TIMEOUT if batch_slice else 0)
            return exit_stack.enter_context(lock.acquire())

        try:
            folder.mkdir(parents=True, exist_ok=True)
            batch_lock = acquire_lock(LOCK_NAME)
            if batch_slice is None:
                slice_lock_names = [*filter(SLICE_LOCK_PATTERN.fullmatch, os.listdir(folder))]
                for file_name in slice_lock_names:
                    acquire_lock(file_name)
            else:
                acquire_lock(f".navbake-batch-{batch_slice.number}-of-{batch_slice.total}.lock")
                batch_lock.release()
        except filelock.Timeout:
            raise NavbakeError(
                f"another batch writes into {folder}: wait for it, or choose another folder"
            ) from None
        except NotImplementedError:  # a file system without locks
            pass
        except OSError as error:
            raise store.make_write_error(f"into {folder}", error) from error
        yield
        store.remove_files(folder, slice_lock_names)


class LineFile:
    """A file of JSON lines, to which several processes may append at once.

    Each line is added in one write.
    """

    def __init__(self, path: Path, destination: str) -> None:
        """Open the file to append to; create it and its folder if they are missing.

        Args:
            path: the file.
            destination: completes the error's text ``cannot write …``: ``into out``, for example.

        Raises:
            NavbakeError: the file can't be written.
        """
        self._destination = destination
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
            if path.is_file() and path.stat().st_size:
                with path.open("rb") as file:
                    file.seek(-1, os.SEEK_END)
                    if file.read() != b"\n":  # the last line was truncated
                        os.write(self._file, b"\n")
        except OSError as error:
            raise store.make_write_error(destination, error) from error

    def add(self, line: Mapping[str, Any]) -> None:
        """Append a JSON object as a line; raise a NavbakeError if the file can't be written."""
        try:
            write_all(self._file, encode_json_line(line))
        except OSError as error:
            raise store.make_write_error(self._destination, error) from error

    def close(self) -> None:
        """Close the file."""
        with suppress(OSError):
            os.close(self._file)


def write_index(
    folder: store.Folder,
    rows: Iterable[SceneRow],
    writes_parquet: bool,
    batch_slice: Slice | None = None,
) -> None:
    """Write the index: the rows of a batch, then rows of other scenes that were in it before.

    The indexes of slices are merged into it and then removed.

    Args:
        folder: the output folder.
        rows: a row for each scene of the batch, in order.
        writes_parquet: whether the index is written as Parquet as well.
        batch_slice: write only the index of this slice, with `rows` alone; None for the whole.
    """
    row_of_scene = {row["id"]: row for row in rows}
    if batch_slice is not None:
        store.write_file(
            folder, batch_slice.index_name, b"".join(map(encode_json_line, row_of_scene.values()))
        )
        return
    slice_names = find_slice_indexes(folder)
    row_of_earlier_scene = merge_rows(folder, (*slice_names, INDEX_NAME))
    row_of_scene |= {id: row for id, row in row_of_earlier_scene.items() if id not in row_of_scene}
    store.write_file(folder, INDEX_NAME, b"".join(map(encode_json_line, row_of_scene.values())))
    if writes_parquet:
        store.write_file(folder, TABLE_NAME, encode_rows(row_of_scene.values()))
    else:
        store.remove_files(folder, [TABLE_NAME])  # it would not match the index
    store.remove_files(folder, slice_names)


def find_slice_indexes(folder: store.Folder) -> list[str]:
    """Return the names of the index files that slices wrote.

    They are sorted by the number of slices, then by the slice's number.
    """
    names = store.list_file_sizes(folder) if isinstance(folder, str) else os.listdir(folder)
    matches = [match for match in map(SLICE_INDEX_PATTERN.fullmatch, names) if match]
    return [match[0] for match in sorted(matches, key=lambda match: (int(match[2]), int(match[1])))]


def read_index(folder: store.Folder, name: str = INDEX_NAME) -> dict[str, SceneRow]:
    """Read an index as a mapping: scene's id -> its last row; {} if there is no index.

    A truncated line, which a killed batch may leave, is skipped. Of a row, only the id is checked.
    """
    row_of_scene: dict[str, SceneRow] = {}
    content = b""
    with suppress(store.MissingFileError):
        content = store.read_file(store.join(folder, name))
    for line in content.split(b"\n"):
        try:
            # not orjson: names that aren't UTF-8 have halves of surrogates, which it refuses
            row = json.loads(line, parse_constant=_refuse_constant)
        except (ValueError, RecursionError):
            continue
        if isinstance(row, dict) and isinstance(row.get("id"), str):
            row_of_scene[row["id"]] = cast(SceneRow, row)
    return row_of_scene


def merge_rows(folder: store.Folder, index_names: Iterable[str]) -> dict[str, SceneRow]:
    """Merge the rows of several index files.

    Args:
        folder: the output folder.
        index_names: the names of the files in it; missing files are skipped.

    Returns:
        Id of a scene -> its row; of several rows of a scene, the one that ended last.
    """
    row_of_scene: dict[str, SceneRow] = {}
    for index_name in index_names:
        for id, row in read_index(folder, index_name).items():
            # times in ISO 8601 compare as text; a scene that is ``left`` has none
            if id not in row_of_scene or str(row.get("ended", "")) > str(
                row_of_scene[id].get("ended", "")
            ):
                row_of_scene[id] = row
    return row_of_scene


def encode_json_line(json_object: Mapping[str, Any]) -> bytes:
    """Encode a JSON object as one line of JSON, with its line end."""
    return json.dumps(json_object, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _refuse_constant(name: str) -> float:
    """Raise a ValueError for NaN and Infinity, which aren't JSON."""
    raise ValueError(name)


# ---------------------------------------------------------------- as Parquet


def encode_rows(rows: Iterable[SceneRow]) -> bytes:
    """Encode rows as Parquet with the fixed columns of `_schema`; equal rows give equal bytes.

    Raises a NavbakeError if a value doesn't have its column's type, which may happen in an index
    that was edited by hand.
    """
    parquet = import_extra("pyarrow.parquet", "batch", "Parquet")
    pyarrow = import_extra("pyarrow", "batch", "Parquet")
    try:
        table_rows = [_to_table_row(row) for row in rows]
        table = pyarrow.Table.from_pylist(table_rows, schema=_schema(pyarrow))
    except (pyarrow.ArrowException, ArithmeticError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise NavbakeError(f"a row of the index doesn't fit into {TABLE_NAME}: {reason}") from error
    parquet_file = io.BytesIO()
    parquet.write_table(table, parquet_file, compression="zstd")
    return parquet_file.getvalue()


def _schema(pyarrow: ModuleType) -> object:
    """Return the pyarrow.Schema of the index: names and types of its columns, in their order."""
    text_type = pyarrow.string()
    texts_type = pyarrow.list_(pyarrow.string())
    number_type = pyarrow.float64()
    count_type = pyarrow.int32()
    large_count_type = pyarrow.int64()
    file_type = pyarrow.struct(
        [("path", text_type), ("size", large_count_type), ("sha256", text_type)]
    )
    counts_type = pyarrow.struct(
        [(measure, pyarrow.list_(large_count_type)) for measure in MEASURE_CLASSES]
    )
    return pyarrow.schema(
        [
            *(
                ("id", text_type),
                ("source", text_type),
                ("status", text_type),
                ("how", text_type),
                ("error", text_type),
            ),
            *(("levels", count_type), ("cells", large_count_type), ("free_area", number_type)),
            *(("rooms", count_type), ("doors", count_type), ("episodes", counts_type)),
            *(("warnings", texts_type), ("audit", texts_type)),
            *(
                ("seconds", number_type),
                ("stages", pyarrow.map_(text_type, number_type)),
                ("ended", text_type),
            ),
            *(
                ("scene_digest", text_type),
                ("settings_digest", text_type),
                ("version", text_type),
                ("key", text_type),
            ),
            *(("inputs", pyarrow.list_(file_type)), ("files", pyarrow.list_(file_type))),
            ("removed", texts_type),
        ]
    )


def _to_table_row(row: SceneRow) -> Json:
    """Return a row for the table: its mappings become lists, as the schema has them."""
    table_row: Json = dict(row)
    stages = row.get("stages")
    if isinstance(stages, Mapping):
        table_row["stages"] = [*stages.items()]
    elif stages is not None:  # pyarrow ends the process where such a list has nulls
        raise TypeError("expected an object as `stages`")
    for key in ("inputs", "files"):
        if isinstance(table_row.get(key), Mapping):
            table_row[key] = [
                {"path": path, **(file_state or {})} for path, file_state in table_row[key].items()
            ]
    return table_row
