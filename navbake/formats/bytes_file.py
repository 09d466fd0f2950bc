"""Bytes of voxel files, from and to the disk, with errors of navbake's own."""

from __future__ import annotations

import os
from os import PathLike
from pathlib import Path

from navbake.errors import FormatError
from navbake.files import write_whole
from navbake.formats.source import path_name, reason


def read_bytes(path: str | PathLike[str]) -> bytes:
    """Read a file whole.

    Raises:
        FormatError: it can't be read.
    """
    try:
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        raise FormatError(f"cannot read {path_name(path)}: {reason(error)}") from error


def write_bytes(data: bytes, path: str | PathLike[str]) -> None:
    """Write a file as a whole or not at all.

    Raises:
        FormatError: it can't be written.
    """
    try:
        write_whole(data, path)
    except (OSError, ValueError) as error:
        why = reason(error)
        if isinstance(error, FileNotFoundError):
            why = f"there is no folder {path_name(os.path.dirname(os.path.realpath(path)))}"
        raise FormatError(f"cannot write {path_name(path)}: {why}") from error
