"""The index of a batch: a line of JSON for each scene, and the same as Parquet.

A slice of a batch writes its own part, ``index-3-of-64.jsonl``, and has a lock of its own. The next
run of the whole batch merges the parts into the index.
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
from typing import NamedTuple

import filelock

from navbake.batch import store
from navbake.batch.products import MEASURE_CLASSES
from navbake.errors import NavbakeError
from navbake.files import write_all
from navbake.formats.source import import_extra
from navbake.types import Json

INDEX_NAME = "index.jsonl"
TABLE_NAME = "index.parquet"
LOCK_NAME = ".navbake-batch.lock"
SLICE_INDEX_PATTERN = re.compile(r"index-(\d+)-of-(\d+)\.jsonl")
SLICE_LOCK_PATTERN = re.compile(r"\.navbake-batch-\d+-of-\d+\.lock")
LOCK_TIMEOUT = 5.0  # for a slice that looks whether the whole batch runs [s]


class Slice(NamedTuple):
    """A slice of a batch: every `total`-th scene, from scene `number` on, counted from 1."""

    number: int
    total: int

    @property
    def file(self) -> str:
        """The file name of the slice's part of the index."""
        return f"index-{self.number}-of-{self.total}.jsonl"


@contextmanager
def only_batch(folder: Path, part: Slice | None = None) -> Iterator[None]:
    """Hold the lock of an output folder; the system releases it when the process ends.

    A whole batch excludes all others. A slice excludes whole batches and other runs of the same
    slice. Raises a NavbakeError if another batch holds a lock, or the folder can't be made or
    written.
    """
    if folder.is_file():
        raise NavbakeError(f"expected a folder to write into, got {folder}, which is a file")
    name = INDEX_NAME if part is None else part.file
    for name_in_folder in (LOCK_NAME, name, TABLE_NAME):
        store.check_inside(folder, folder / name_in_folder)
    slices: list[str] = []
    with ExitStack() as stack:

        def hold(name: str) -> filelock.BaseFileLock:
            lock = filelock.FileLock(folder / name, timeout=LOCK_TIMEOUT if part else 0)
            return stack.enter_context(lock.acquire())

        try:
            folder.mkdir(parents=True, exist_ok=True)
            batch_lock = hold(LOCK_NAME)
            if part is None:
                slices = [*filter(SLICE_LOCK_PATTERN.fullmatch, os.listdir(folder))]
                for name_in_folder in slices:
                    hold(name_in_folder)
            else:
                hold(f".navbake-batch-{part.number}-of-{part.total}.lock")
                batch_lock.release()
        except filelock.Timeout:
            raise NavbakeError(
                f"another batch writes into {folder}: wait for it, or choose another folder"
            ) from None
        except NotImplementedError:  # a file system without locks
            pass
        except OSError as error:
            raise store.refused(f"into {folder}", error) from error
        yield
        store.remove_files(folder, slices)


class LineFile:
    """A file of JSON lines, to which several processes may append at once.

    Each line is added in one write. The file is created if it is missing. If it can't be written, a
    NavbakeError calls it `what`.
    """

    def __init__(self, path: Path, what: str) -> None:
        self._what = what
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
            if path.is_file() and path.stat().st_size:
                with path.open("rb") as file:
                    file.seek(-1, os.SEEK_END)
                    if file.read() != b"\n":  # a truncated line
                        os.write(self._file, b"\n")
        except OSError as error:
            raise store.refused(what, error) from error

    def add(self, line: Json) -> None:
        try:
            write_all(self._file, line_of(line))
        except OSError as error:
            raise store.refused(self._what, error) from error

    def close(self) -> None:
        with suppress(OSError):
            os.close(self._file)


def write_index(
    folder: store.Folder, rows: Iterable[Json], has_table: bool, part: Slice | None = None
) -> None:
    """Write the index: a batch's rows in its order, then the existing rows of other scenes.

    The existing rows include those of slices, whose parts of the index are then removed. A slice
    writes only its own rows.
    """
    row_of_scene = {row["id"]: row for row in rows}
    if part is not None:
        store.write_file(folder, part.file, b"".join(map(line_of, row_of_scene.values())))
        return
    parts = find_parts(folder)
    earlier_rows = merge_rows(folder, (*parts, INDEX_NAME))
    row_of_scene |= {id: row for id, row in earlier_rows.items() if id not in row_of_scene}
    store.write_file(folder, INDEX_NAME, b"".join(map(line_of, row_of_scene.values())))
    if has_table:
        store.write_file(folder, TABLE_NAME, encode_rows(row_of_scene.values()))
    else:
        store.remove_files(folder, [TABLE_NAME])  # outdated
    store.remove_files(folder, parts)


def find_parts(folder: store.Folder) -> list[str]:
    """Return the file names of the parts of the index that slices wrote, sorted.

    They are sorted by the number of slices, then by the slice's number.
    """
    names = store.sizes_below(folder) if isinstance(folder, str) else os.listdir(folder)
    matches = [match for match in map(SLICE_INDEX_PATTERN.fullmatch, names) if match]
    return [match[0] for match in sorted(matches, key=lambda match: (int(match[2]), int(match[1])))]


def read_index(folder: store.Folder, name: str = INDEX_NAME) -> dict[str, Json]:
    """Read an index: the last row of each scene, by the scene's id; {} without an index.

    A truncated line, which a killed batch may leave, is skipped.
    """
    rows: dict[str, Json] = {}
    content = b""
    with suppress(store.MissingFileError):
        content = store.read_file(store.join(folder, name))
    for line in content.split(b"\n"):
        try:
            # orjson refuses halves of surrogates, which names that aren't UTF-8 have
            row = json.loads(line, parse_constant=_refuse)
        except (ValueError, RecursionError):
            continue
        if isinstance(row, dict) and isinstance(row.get("id"), str):
            rows[row["id"]] = row
    return rows


def merge_rows(folder: store.Folder, names: Iterable[str]) -> dict[str, Json]:
    """Merge the rows of several index files; return the latest row of each scene, by its id."""
    rows: dict[str, Json] = {}
    for name in names:
        for id, row in read_index(folder, name).items():
            # ISO 8601; a scene that is ``left`` has not ended
            if id not in rows or str(row.get("ended", "")) > str(rows[id].get("ended", "")):
                rows[id] = row
    return rows


def line_of(row: Json) -> bytes:
    """Return a row as a line of JSON."""
    return json.dumps(row, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _refuse(word: str) -> float:
    """Refuse NaN and Infinity, which are no JSON."""
    raise ValueError(word)


# ---------------------------------------------------------------- as Parquet


def encode_rows(rows: Iterable[Json]) -> bytes:
    """Encode rows as Parquet with the fixed columns of `_schema`; equal rows give equal bytes.

    Raises a NavbakeError if a value has a type other than its column's, as in an edited index.
    """
    parquet = import_extra("pyarrow.parquet", "batch", "Parquet")
    pyarrow = import_extra("pyarrow", "batch", "Parquet")
    try:
        table = pyarrow.Table.from_pylist([_cells(row) for row in rows], schema=_schema(pyarrow))
    except (pyarrow.ArrowException, ArithmeticError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise NavbakeError(f"a row of the index doesn't fit into {TABLE_NAME}: {reason}") from error
    file = io.BytesIO()
    parquet.write_table(table, file, compression="zstd")
    return file.getvalue()


def _schema(pyarrow: ModuleType) -> object:
    """A pyarrow.Schema of the columns: name and type, in the order of docs/batch.md."""
    text = pyarrow.string()
    texts = pyarrow.list_(pyarrow.string())
    number = pyarrow.float64()
    count = pyarrow.int32()
    wide = pyarrow.int64()
    file = pyarrow.struct([("path", text), ("size", wide), ("sha256", text)])
    counts = pyarrow.struct([(measure, pyarrow.list_(wide)) for measure in MEASURE_CLASSES])
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
