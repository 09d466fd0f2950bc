"""Files read and written whole: paths, bytes or streams; JSON plain or gzipped, and bounded."""

import gzip
import io
import logging
import os
import stat
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import orjson

from navbake.errors import FormatError
from navbake.files import FileState, write_together, write_whole
from navbake.formats.json_path import JsonPath, shown

Source: TypeAlias = str | os.PathLike[str] | bytes | BinaryIO
"""A path, a file's content, or a file opened in binary mode."""
Files: TypeAlias = dict[Path, bytes | Iterable[bytes]]
"""Files to be written, in this order: content, or pieces of it, by path."""

LOG = logging.getLogger("navbake")
MAX_BYTES = 4 << 30  # of JSON
UNPACKED_BYTES = 64 << 20  # what any gzipped file may unpack to; beyond it, UNPACKED_RATIO counts
UNPACKED_RATIO = 200
CHUNK = 1 << 20
BOM = b"\xef\xbb\xbf"  # which some editors put before UTF-8
HEADER_LIMIT = 65536  # longest header, comments included [bytes]


def read_source(source: Source) -> tuple[bytes, JsonPath]:
    """Read a JSON file whole, and unpack it if it is gzipped (which its content tells).

    Returns:
        Its content without a byte order mark, and the place that errors name for it.
    """
    with open_source(source) as (stream, name):
        top = JsonPath(name)
        return _read_bytes(stream, top).removeprefix(BOM), top


def path_name(path: str | os.PathLike[str]) -> str:
    """A path as an error shows it, on one line."""
    name = os.fsdecode(path)
    return name if name.isprintable() else repr(name)


def check_path(path: object) -> str:
    """A path as text; a FormatError if it is none."""
    if not isinstance(path, str | os.PathLike):
        raise FormatError(f"expected a path, got {shown_type(path)}")
    return os.fsdecode(path)


def shown_type(value: object) -> str:
    """What a value is, where it is not even of the right type."""
    return "None" if value is None else f"one of Python's type {type(value).__name__}"


def os_message(error: Exception) -> str:
    """The operating system's message of an error, without its number."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


@contextmanager
def open_source(source: Source) -> Iterator[tuple[BinaryIO, str]]:
    """Open a source; what the system refuses becomes a FormatError."""
    if isinstance(source, bytes | bytearray | memoryview):
        yield io.BytesIO(source), "the bytes given"
    elif isinstance(source, str | os.PathLike):
        try:
            with open(source, "rb") as file:
                LOG.debug("reading %s", os.fsdecode(source))
                yield file, os.fsdecode(source)
        except (OSError, ValueError) as error:  # ValueError: a path with a NUL
            raise FormatError(f"cannot read {path_name(source)}: {os_message(error)}") from error
    elif callable(getattr(source, "read", None)):
        name = str(getattr(source, "name", "the stream given"))
        try:
            yield source, name
        except (OSError, ValueError) as error:  # ValueError: it is closed
            raise FormatError(f"cannot read {path_name(name)}: {os_message(error)}") from error
    else:
        expected = "a path, a file's content or a file opened in binary mode"
        raise FormatError(f"expected {expected}, got {shown_type(source)}")


def _read_bytes(stream: BinaryIO, top: JsonPath) -> bytes:
    """Read and unpack a file, up to what such a file may hold."""
    head, taken = _read_head(stream, top)
    is_packed = head.startswith(b"\x1f\x8b")
    if not is_packed:
        _check_head(head, top)
    content = _read_rest(taken, stream, MAX_BYTES, top)
    return _unpack(content, top) if is_packed else content


def _read_head(stream: BinaryIO, top: JsonPath) -> tuple[bytes, bytes]:
    """How a stream begins, and what of that is read already."""
    is_buffered = isinstance(stream, io.BufferedReader)
    head = stream.peek(1) if is_buffered else stream.read(CHUNK)  # type: ignore[attr-defined]
    if not isinstance(head, bytes):
        top.fail(f"expected a file opened in binary mode, got {_text_or_type(head)}")
    return head, b"" if is_buffered else head


def _text_or_type(value: object) -> str:
    return "text" if isinstance(value, str) else shown_type(value)


def _unpack(packed: bytes, top: JsonPath) -> bytes:
    # a small file that unpacks to gigabytes is an attack or an accident
    limit = min(MAX_BYTES, max(UNPACKED_BYTES, UNPACKED_RATIO * len(packed)))
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(packed)) as unpacked:
            head = unpacked.read(CHUNK)
            _check_head(head, top)
            return _read_rest(head, unpacked, limit, top)
    except (EOFError, OSError, zlib.error) as error:
        raise FormatError(f"broken gzip data in {top.file}: {os_message(error)}") from error


def _check_head(head: bytes, top: JsonPath) -> None:
    """Refuse what does not begin like a JSON object before reading on: a device never ends."""
    if not head:
        top.fail("expected a NavGrid JSON object, got nothing")
    if not _begins_object(head):
        top.fail(
            f"expected a NavGrid JSON object, got {_shown_head(head)}; navbake convert makes "
            "one of a map or an archive, navbake bake of a scene"
        )


def _begins_object(head: bytes) -> bool:
    """Whether a file that begins so may hold a JSON object: all that is seen may be spaces."""
    text = _text_of(head)
    return not text or text.startswith(b"{")


def _shown_head(head: bytes) -> str:
    return f"{shown(_text_of(head)[:8])[1:]}…"


def _text_of(head: bytes) -> bytes:
    return head.removeprefix(BOM).lstrip(b" \t\r\n")


def _read_rest(head: bytes, stream: BinaryIO | gzip.GzipFile, limit: int, top: JsonPath) -> bytes:
    pieces, size = [head] if head else [], len(head)  # one piece alone is not copied
    left = _bytes_left(stream)
    if left > limit:  # known before anything is read
        top.fail(f"more than {_shown_limit(limit)} of data")
    step = max(CHUNK, left)  # all that is left of a file at once
    while chunk := stream.read(min(step, limit + 1)):  # not more at once, it would be reserved
        pieces.append(chunk)
        size += len(chunk)
        step = CHUNK
        if size > limit:
            remedy = "" if limit == MAX_BYTES else "unpack it first if that is meant"
            top.fail(f"more than {_shown_limit(limit)} of data", remedy)
    return b"".join(pieces)


def _shown_limit(limit: int) -> str:
    return f"{limit >> 20} MiB" if limit >> 20 else f"{limit:,} bytes"


def _bytes_left(stream: BinaryIO | gzip.GzipFile) -> int:
    """How many bytes a plain file still has; 0 if the stream isn't one."""
    if not isinstance(stream, io.BufferedReader):
        return 0
    try:
        status = os.fstat(stream.fileno())
        return max(0, status.st_size - stream.tell()) if stat.S_ISREG(status.st_mode) else 0
    except OSError:  # a stream over no file, or one that can't tell where it is
        return 0


def read_bytes(
    source: str | os.PathLike[str] | bytes,
    *,
    begins: bytes | tuple[bytes, ...] = b"",
    expected: str = "",
    limit: int = MAX_BYTES,
) -> tuple[bytes, str]:
    """Read a file whole: its content, and its name for messages.

    Args:
        source: a path, or a file's content.
        begins: how such a file begins, or in which ways. Nothing else of it is read if it doesn't:
            what is no such file may be a device that never ends.
        expected: what was expected then, for the message.
        limit: most bytes that such a file may have.

    Raises:
        FormatError: it can't be read, is too large, or does not begin so.
    """
    with open_source(source) as (stream, name):
        top = JsonPath(name)
        head, taken = _read_head(stream, top)
        if not head.startswith(begins):
            raise FormatError(f"expected {expected}, got {path_name(name)}")
        return _read_rest(taken, stream, limit, top), name


def read_object(path: str | os.PathLike[str], *, expected: str, limit: int) -> tuple[Any, str]:
    """Read a file that holds a JSON object: that, and the file's name for messages.

    Args:
        expected: what was expected, for the message.
        limit: most bytes that such a file may have. Nothing more is read of what doesn't begin as
            an object does: it may be a device that never ends.

    Raises:
        FormatError: it can't be read, is too large, or holds no JSON object.
    """
    with open_source(path) as (stream, name):
        top = JsonPath(name)
        head, taken = _read_head(stream, top)
        if not _begins_object(head):
            raise FormatError(f"expected {expected} in {path_name(name)}, got {_shown_head(head)}")
        content = _read_rest(taken, stream, limit, top).removeprefix(BOM)
    try:
        return orjson.loads(content), name
    except orjson.JSONDecodeError as error:
        raise FormatError(
            f"expected {expected}, {path_name(name)} can't be read: {error}"
        ) from error


def write_bytes(
    data: bytes | Iterable[bytes],
    path: str | os.PathLike[str],
    *,
    unless_changed: FileState | None = None,
) -> None:
    """Write a file as a whole or not at all, with the system's errors as FormatErrors.

    Args:
        data: the content, or pieces of it.
    """
    check_path(path)
    try:
        write_whole(data, path, unless_changed=unless_changed)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        why = os_message(error)
        if isinstance(error, FileNotFoundError):
            why = f"there is no folder {path_name(os.path.dirname(os.path.realpath(path)))}"
        raise FormatError(f"cannot write {path_name(path)}: {why}") from error


def write_files(files: Mapping[Path, bytes | Iterable[bytes]]) -> list[Path]:
    """Write several files that belong together: all, or none where one can't be written.

    Returns:
        Their paths.

    Raises:
        FormatError: the system refuses one of them.
    """
    try:
        write_together(files)
    except (OSError, ValueError) as error:
        names = " and ".join(path_name(path) for path in files)
        why = os_message(error)
        if isinstance(error, FileNotFoundError):
            folders = {os.path.dirname(os.path.realpath(path)) for path in files}
            missing = sorted(folder for folder in folders if not os.path.isdir(folder))
            why = f"there is no folder {path_name(missing[0])}" if missing else why
        raise FormatError(f"cannot write {names}: {why}") from error
    return list(files)


def read_header(data: bytes, source: str) -> tuple[dict[str, list[str]], int]:
    """Read the lines of text that stand before the data of a voxel file.

    Returns:
        The further words of each line by its first word, comments (``#``) included; and where the
        data begin, after the line ``data``.
    """
    lines: dict[str, list[str]] = {}
    start = 0
    while True:
        end = data.find(b"\n", start, HEADER_LIMIT)
        if end < 0:
            raise FormatError(f"no line `data` ends the header of {source}")
        first, *words = data[start:end].decode("ascii", errors="replace").split() or [""]
        start = end + 1
        if first == "data":
            return lines, start
        lines[first] = words
