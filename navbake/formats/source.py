"""Reads and writes whole files: paths, bytes or streams; system errors become FormatErrors."""

from __future__ import annotations

import bz2
import gzip
import importlib
import io
import logging
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import orjson

from navbake.errors import ConfigError, FormatError, MissingDependencyError
from navbake.files import write_together
from navbake.formats.allowance import MAX_BYTES, Allowance, JsonPath, shown

Source: TypeAlias = str | os.PathLike[str] | bytes | BinaryIO
"""A path, a file's content, or a file opened in binary mode."""
Files: TypeAlias = dict[Path, bytes]
"""Files to be written, in this order: content by path."""

LOG = logging.getLogger("navbake")
CHUNK = 1 << 20  # read first [bytes]
BOM = b"\xef\xbb\xbf"  # byte order mark of UTF-8
GZIP = b"\x1f\x8b"
PACKED: dict[bytes, tuple[str, Any]] = {GZIP: ("gzip", gzip.open), b"BZ": ("bzip2", bz2.open)}
NAVGRID = "a NavGrid JSON object"
NAVGRID_REMEDY = "navbake convert makes one of a map or an archive, navbake bake of a scene"


def path_name(path: str | os.PathLike[str]) -> str:
    """A path for messages, on one line."""
    name = os.fsdecode(path)
    return name if name.isprintable() else repr(name)


def check_path(path: object) -> str:
    """A path as text; a FormatError if it is none."""
    if not isinstance(path, str | os.PathLike):
        raise FormatError(f"expected a path, got {shown_type(path)}")
    return os.fsdecode(path)


def shown_type(value: object) -> str:
    """Describe a value of a wrong type."""
    return "None" if value is None else f"one of Python's type {type(value).__name__}"


def _os_message(error: Exception) -> str:
    """The operating system's message of an error, without its number."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


@contextmanager
def _opened(source: Source) -> Iterator[tuple[BinaryIO, str]]:
    """Open a source; system errors become FormatErrors."""
    if isinstance(source, bytes | bytearray | memoryview):
        yield io.BytesIO(source), "the bytes given"
        return
    if not isinstance(source, str | os.PathLike) and not callable(getattr(source, "read", None)):
        expected = "a path, a file's content or a file opened in binary mode"
        raise FormatError(f"expected {expected}, got {shown_type(source)}")
    name = str(getattr(source, "name", "the stream given"))
    try:
        if isinstance(source, str | os.PathLike):
            name = os.fsdecode(source)
            LOG.debug("reading %s", name)
            if os.path.isdir(source):
                raise FormatError(f"expected a file, got the folder {path_name(name)}")
            with open(source, "rb") as file:
                yield file, name
        else:
            yield source, name
    except (OSError, ValueError) as error:  # ValueError: a NUL in a path, or the file is closed
        raise FormatError(f"cannot read {path_name(name)}: {_os_message(error)}") from error


def read_bytes(
    source: Source,
    *,
    begins: bytes | tuple[bytes, ...] = b"",
    expected: str = "",
    remedy: str = "",
) -> tuple[bytes, str]:
    """Read a file whole; returns its content, and its name for messages.

    `begins` are the possible beginnings of such a file. Of any other, at most 1 MiB is read: it
    may be a device that never ends.
    """
    with _opened(source) as (stream, name):
        data = stream.read(CHUNK)
        if not isinstance(data, bytes):
            got = "text" if isinstance(data, str) else shown_type(data)
            JsonPath(name).fail(f"expected a file opened in binary mode, got {got}")
        if not data.startswith(begins):
            JsonPath(name).fail(f"expected {expected}, got {_beginning(data)}", remedy)
        pieces, size = [data], len(data)
        while piece := stream.read(16 * CHUNK):
            pieces.append(piece)
            size += len(piece)
            if size > MAX_BYTES:
                JsonPath(name).fail(f"more than {MAX_BYTES >> 20} MiB of data")
        return b"".join(pieces), name


def _beginning(text: bytes) -> str:
    """The beginning of a text for messages."""
    begin = text[:CHUNK].removeprefix(BOM).lstrip(b" \t\r\n")[:8]
    return f"{shown(begin)[1:]}…" if begin else "nothing"


def unpack(data: bytes, name: str) -> bytes:
    """Unpack gzip or bzip2, detected by the content; other data are returned as they are."""
    kind, opened = PACKED.get(data[:2], ("", None))
    if opened is None:
        return data
    allowance, pieces = Allowance(len(data), "max_cells"), []
    try:
        with opened(io.BytesIO(data)) as unpacked:
            while piece := unpacked.read(16 * CHUNK):
                allowance.take_text(len(piece), JsonPath(name))
                pieces.append(piece)
    except (EOFError, OSError, zlib.error) as error:
        raise FormatError(f"broken {kind} data in {name}: {_os_message(error)}") from error
    return b"".join(pieces)


def read_json_text(source: Source) -> tuple[bytes, int, JsonPath]:
    """Read the JSON of a grid's file, plain or gzipped (detected by its content).

    Returns its text without a byte order mark, the file's size, and the place for errors.
    """
    begins = (b"{", GZIP, BOM, b" ", b"\t", b"\r", b"\n")
    remedy, file = NAVGRID_REMEDY, str(source) if isinstance(source, str | os.PathLike) else ""
    if file.lower().endswith((".yaml", ".yml")):
        made, shown_file = f"{Path(file).stem}.grid.json", path_name(file)
        remedy = f"of settings, `navbake bake {shown_file}` makes one, of a map of nav2, "
        remedy += f"`navbake convert {shown_file} {path_name(made)}`"
    text, name = read_bytes(source, begins=begins, expected=NAVGRID, remedy=remedy)
    num_bytes, top = len(text), JsonPath(name)
    text = unpack(text, name).removeprefix(BOM)
    if _beginning(text)[1:2] != "{":
        top.fail(f"expected {NAVGRID}, got {_beginning(text)}", remedy)
    return text, num_bytes, top


def parse_json(content: bytes | memoryview, place: JsonPath) -> Any:
    """Parse JSON; a FormatError names line and column."""
    try:
        return orjson.loads(content)
    except orjson.JSONDecodeError as error:
        near = error.doc[error.pos : error.pos + 9].lstrip("-")
        hint = "; NaN and Infinity are no JSON, write null" if near[:3] in ("NaN", "Inf") else ""
        file = f"`{place.path}` of {place.file}" if place.path else place.file
        where = f"{file}, line {error.lineno}, column {error.colno}"
        raise FormatError(f"broken JSON in {where}: {error.msg}{hint}") from error


def read_object(path: str | os.PathLike[str], *, expected: str) -> tuple[Any, str]:
    """Read a JSON file; also returns its name for messages, which name `expected`."""
    content, name = read_bytes(path)
    try:
        return parse_json(content.removeprefix(BOM), JsonPath(path_name(name))), name
    except FormatError as error:
        raise FormatError(f"expected {expected}: {error}") from error


def read_yaml(path: str | os.PathLike[str], *, expected: str) -> tuple[Any, str]:
    """Read a YAML file; also returns its name for messages, which name `expected`."""
    from navbake.yaml_text import decode_yaml  # PyYAML loads slowly

    content, name = read_bytes(path)
    try:
        return decode_yaml(content, path_name(name)), name
    except ConfigError as error:
        raise FormatError(f"expected {expected}: {error}") from error


def check_named(path: Path) -> None:
    """Refuse a file whose name isn't UTF-8, as another file is to contain it."""
    if path.name != os.fsencode(path.name).decode(errors="replace"):
        raise FormatError(f"expected a name in UTF-8, which another file can hold, got {path}")


def write_bytes(data: bytes, path: str | os.PathLike[str]) -> None:
    """Write a file as a whole or not at all."""
    write_files({Path(check_path(path)): data})


def write_files(files: Files) -> list[Path]:
    """Write files that belong together, all or none; returns their paths."""
    try:
        write_together(files)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        why = _os_message(error)
        if isinstance(error, FileNotFoundError):
            folders = {os.path.dirname(os.path.realpath(path)) for path in files}
            missing = sorted(folder for folder in folders if not os.path.isdir(folder))
            why = f"there is no folder {path_name(missing[0])}" if missing else why
        raise FormatError(f"cannot write {' and '.join(map(path_name, files))}: {why}") from error
    return list(files)


def import_extra(name: str, extra: str = "convert", what: str = "this") -> Any:
    """Import a library of an extra, or raise an error that says how to install it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        message = f'{what} needs {name.partition(".")[0]}: pip install "navbake[{extra}]"'
        raise MissingDependencyError(message) from error
