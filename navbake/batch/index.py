"""What became of each scene of a batch: a line of JSON each, written as it goes."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from navbake.batch.full import refused
from navbake.errors import NavbakeError
from navbake.files import wait_for_disk, write_all, write_whole
from navbake.types import Json

try:
    import fcntl
except ImportError:  # Windows has no such locks: there, two batches in one folder are not noticed
    fcntl = None  # type: ignore[assignment]

NAME = "index.jsonl"
LOCK = ".navbake-batch.lock"
WAS = "was"  # of the row of a scene that is left: the one of when it was made last
CHUNK = 1 << 20  # bytes that are read at once


@contextmanager
def only_batch(folder: Path) -> Iterator[None]:
    """Be the only batch that writes into a folder; the system ends that with the process.

    Raises:
        NavbakeError: another one does, or the folder can't be made or written.
    """
    if folder.is_file():
        raise NavbakeError(f"expected a folder to write into, got {folder}, which is a file")
    with _naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        if fcntl is not None:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise NavbakeError(
                    f"another batch writes into {folder}: wait for it, or choose another folder"
                ) from None
            except OSError:  # a file system without locks
                pass
        yield
    finally:
        os.close(descriptor)


def read_index(folder: Path) -> dict[str, Json]:
    """The last line of each scene, by its id; {} where there is no index.

    A line that was cut off, as when a batch was killed, counts as none.
    """
    try:
        return parse_rows((folder / NAME).read_bytes())
    except FileNotFoundError:
        return {}


class Index:
    """The index of a folder, to which one batch adds lines.

    All that it does raises a NavbakeError where the folder can't be written, a FullError where that
    is for want of space.

    Attributes:
        known: the rows that were there before, by id.
        rows: all rows, once it is finished: those of the batch's scenes, then others.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / NAME
        self.rows: list[Json] = []
        with _naming(folder):
            self._file = os.open(self._path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
            content = self._read()
            self.known = parse_rows(content)
            if content and not content.endswith(b"\n"):
                os.write(self._file, b"\n")  # ends a line that was cut off
            self._begin = os.fstat(self._file).st_size

    def add(self, row: Json) -> None:
        """Add a scene's line, in one write."""
        with _naming(self._path.parent):
            write_all(self._file, line_of(row))

    def finish(
        self, ids: Iterable[str], skipped: Collection[str], left: Callable[[str], Json]
    ) -> None:
        """Replace the lines by one for each scene in the batch's order, then those of other scenes.

        Args:
            ids: of the batch's scenes.
            skipped: those whose rows stay as they were.
            left: makes the row of one that neither was skipped nor got a line.

        Where they can't be written, `rows` has them, and the lines stay as they were.
        """
        with _naming(self._path.parent):
            # from the file: Ctrl-C may come between any two statements of Python
            added = parse_rows(self._read()[self._begin :])
            own, others = order_rows(ids, self.known, added, skipped, left)
            self.rows = [*own, *others]
            write_whole(join_rows(self.rows), self._path)

    def write(self, name: str, content: bytes) -> None:
        """Write a file beside the index."""
        with _naming(self._path.parent):
            write_whole(content, self._path.with_name(name))

    def remove(self, name: str) -> None:
        """Remove a file beside the index, if it is there."""
        with _naming(self._path.parent):
            self._path.with_name(name).unlink(missing_ok=True)

    def wait_for_disk(self) -> None:
        """Wait until the folder's disk has all that was made: scenes don't wait for it."""
        with _naming(self._path.parent):
            wait_for_disk(self._path.parent)

    def _read(self) -> bytes:
        """All lines; also where somebody removed the file, of which this batch still has them."""
        os.lseek(self._file, 0, os.SEEK_SET)  # what is added goes to the end all the same
        pieces = iter(lambda: os.read(self._file, CHUNK), b"")
        return b"".join(pieces)

    def close(self) -> None:
        """Give the file back; its lines stay."""
        with suppress(OSError):
            os.close(self._file)


@contextmanager
def _naming(folder: Path) -> Iterator[None]:
    """Turn what the system refuses into an error that names the folder."""
    try:
        yield
    except OSError as error:
        raise refused(f"into {folder}", error) from error


def order_rows(
    ids: Iterable[str],
    known: Mapping[str, Json],
    added: Mapping[str, Json],
    skipped: Collection[str],
    left: Callable[[str], Json],
) -> tuple[list[Json], list[Json]]:
    """The rows of a batch's scenes in its order, and those of other scenes; see `Index.finish`."""
    own = {id: added.get(id) or (made_row(known[id]) if id in skipped else left(id)) for id in ids}
    return [*own.values()], [row for id, row in known.items() if id not in own]


def made_row(row: Json) -> Json:
    """What is known of a scene's making: its row, or the one that it keeps as `WAS`."""
    was = row.get(WAS)
    return was if isinstance(was, dict) and was.get("id") == row.get("id") else row


def parse_rows(content: bytes) -> dict[str, Json]:
    """The last row of each scene in lines of JSON, by its id; what is no row counts as none."""
    rows: dict[str, Json] = {}
    for line in content.split(b"\n"):
        try:
            row = json.loads(line, parse_constant=_refuse, parse_float=_finite)
        except (ValueError, RecursionError):
            continue
        if isinstance(row, dict) and isinstance(row.get("id"), str):
            rows[row["id"]] = row
    return rows


def _refuse(word: str) -> float:
    """NaN and Infinity are no JSON, and could not be written again."""
    raise ValueError(word)


def _finite(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _refuse(text)


def join_rows(rows: Iterable[Json]) -> bytes:
    """Rows as `parse_rows` reads them."""
    return b"".join(map(line_of, rows))


def line_of(row: Json) -> bytes:
    """A row as a line of JSON."""
    return json.dumps(row, separators=(",", ":"), allow_nan=False).encode() + b"\n"
