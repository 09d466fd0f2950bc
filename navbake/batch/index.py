"""What became of each scene of a batch: a line of JSON each, and the same as Parquet."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import filelock

from navbake.batch.products import CLASSES
from navbake.batch.store import (
    Folder,
    MissingFileError,
    check_inside,
    join,
    read_file,
    refused,
    remove_files,
    write_file,
)
from navbake.errors import NavbakeError
from navbake.files import write_all
from navbake.formats.source import import_extra
from navbake.types import Json

NAME = "index.jsonl"
TABLE = "index.parquet"
LOCK = ".navbake-batch.lock"


@contextmanager
def only_batch(folder: Path) -> Iterator[None]:
    """Be the only batch that writes into a folder; the system ends that with the process.

    Raises:
        NavbakeError: another one does, or the folder can't be made or written.
    """
    if folder.is_file():
        raise NavbakeError(f"expected a folder to write into, got {folder}, which is a file")
    lock = filelock.FileLock(folder / LOCK, timeout=0)
    for name in (LOCK, NAME, TABLE):
        check_inside(folder, folder / name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except filelock.Timeout:
        raise NavbakeError(
            f"another batch writes into {folder}: wait for it, or choose another folder"
        ) from None
    except NotImplementedError:  # a file system without locks
        pass
    except OSError as error:
        raise refused(f"into {folder}", error) from error
    try:
        yield
    finally:
        lock.release()


class LineFile:
    """A file to which lines of JSON are added, each in one write: several may write and read it.

    Args:
        path: is made if it isn't there.
        what: how errors call it.

    Raises:
        NavbakeError: the file can't be written.
    """

    def __init__(self, path: Path, what: str) -> None:
        self._what = what
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
            if path.is_file() and path.stat().st_size:
                with path.open("rb") as file:
                    file.seek(-1, os.SEEK_END)
                    if file.read() != b"\n":  # a line that was cut off
                        os.write(self._file, b"\n")
        except OSError as error:
            raise refused(what, error) from error

    def add(self, line: Json) -> None:
        """Add a line."""
        try:
            write_all(self._file, line_of(line))
        except OSError as error:
            raise refused(self._what, error) from error

    def close(self) -> None:
        """Give the file back; its lines stay."""
        with suppress(OSError):
            os.close(self._file)


def write_index(folder: Folder, rows: Iterable[Json], has_table: bool) -> None:
    """Write a batch's rows in its order, then those of other scenes that are there."""
    own = {row["id"]: row for row in rows}
    own |= {id: row for id, row in read_index(folder).items() if id not in own}
    write_file(folder, NAME, b"".join(map(line_of, own.values())))
    if has_table:
        write_file(folder, TABLE, encode_rows(own.values()))
    else:
        remove_files(folder, [TABLE])  # it would say other than the index


def read_index(folder: Folder) -> dict[str, Json]:
    """The last row of each scene, by its id; {} where there is no index.

    A line that was cut off, as when a batch was killed, counts as none.
    """
    rows: dict[str, Json] = {}
    try:
        content = read_file(join(folder, NAME))
    except MissingFileError:
        return rows
    for line in content.split(b"\n"):
        try:
            row = json.loads(line, parse_constant=_refuse)
        except (ValueError, RecursionError):
            continue
        if isinstance(row, dict) and isinstance(row.get("id"), str):
            rows[row["id"]] = row
    return rows


def line_of(row: Json) -> bytes:
    """A row as a line of JSON."""
    return json.dumps(row, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _refuse(word: str) -> float:
    """NaN and Infinity are no JSON, and could not be written again."""
    raise ValueError(word)


# ---------------------------------------------------------------- as Parquet


def encode_rows(rows: Iterable[Json]) -> bytes:
    """Rows of an index as a Parquet file; the same rows, the same bytes.

    Its columns are those of `_schema`, whatever the rows hold: those of several batches can be
    joined.

    Raises:
        NavbakeError: a row has a value of another type, as of an index that somebody changed.
    """
    parquet = import_extra("pyarrow.parquet", "batch", "Parquet")
    pyarrow = import_extra("pyarrow", "batch", "Parquet")
    try:
        table = pyarrow.Table.from_pylist([_cells(row) for row in rows], schema=_schema(pyarrow))
    except (pyarrow.ArrowException, ArithmeticError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise NavbakeError(f"a row of the index doesn't fit into {TABLE}: {reason}") from error
    file = io.BytesIO()
    parquet.write_table(table, file, compression="zstd")
    return file.getvalue()


def _schema(pyarrow: Any) -> Any:
    """The columns: name and type, in the order of docs/batch.md."""
    text, texts = pyarrow.string(), pyarrow.list_(pyarrow.string())
    number, count, wide = pyarrow.float64(), pyarrow.int32(), pyarrow.int64()
    file = pyarrow.struct([("path", text), ("size", wide), ("sha256", text)])
    counts = pyarrow.struct([(measure, pyarrow.list_(wide)) for measure in CLASSES])
    return pyarrow.schema(
        [
            *(("id", text), ("source", text), ("status", text), ("how", text), ("error", text)),
            *(("levels", count), ("cells", wide), ("free_area", number)),
            *(("rooms", count), ("doors", count), ("episodes", counts)),
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
            cells[key] = [{"path": path, **(state or {})} for path, state in row[key].items()]
    return cells
