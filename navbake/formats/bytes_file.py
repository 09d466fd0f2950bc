"""Reads and writes files whole, with the system's errors as FormatErrors; reads text headers."""

import os
from os import PathLike

from navbake.errors import FormatError
from navbake.files import write_whole
from navbake.formats.source import open_source, os_message, path_name

HEADER_LIMIT = 65536  # longest header, comments included [bytes]


def read_bytes(source: str | PathLike[str] | bytes) -> tuple[bytes, str]:
    """Read a file whole, if it isn't given already: its content, and its name for messages."""
    with open_source(source) as (file, name):
        return file.read(), name


def write_bytes(data: bytes, path: str | PathLike[str]) -> None:
    """Write a file as a whole or not at all, with the system's errors as FormatErrors."""
    try:
        write_whole(data, path)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        why = os_message(error)
        if isinstance(error, FileNotFoundError):
            why = f"there is no folder {path_name(os.path.dirname(os.path.realpath(path)))}"
        raise FormatError(f"cannot write {path_name(path)}: {why}") from error


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
