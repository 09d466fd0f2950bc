"""What files held when they were last looked at, and whether they still do."""

from __future__ import annotations

import hashlib
import os
import stat
import time
from collections.abc import Container, Iterable, Mapping
from pathlib import Path
from typing import BinaryIO

from navbake.types import Json

CHUNK = 1 << 20
RECENT = 2_000_000_000  # age below which a file may change again without a new time of change [ns]


def describe_files(
    paths: Iterable[Path], folder: Path, *, may_change: bool = True
) -> dict[str, Json]:
    """Size, time of change [ns] and sha256 of files, by their path from a folder.

    Args:
        may_change: whether others may be writing them now. Then the time of change is given as 0
            where it is too recent to prove that the content is the same later.

    Raises:
        OSError: one can't be read.
    """
    return {path_from(path, folder): _describe(path, may_change) for path in paths}


def are_unchanged(stated: Mapping[str, Json], folder: Path) -> bool:
    """Whether files have the content that `describe_files` stated.

    A file of the same size and time of change is taken for the same; of another one of that size,
    the content is read.
    """
    try:
        return all(_is_unchanged(known, folder / name) for name, known in stated.items())
    except OSError:  # it isn't there
        return False


def has_no_other(places: Iterable[str], known: Container[str], folder: Path) -> bool:
    """Whether there are files at none of some places but the known ones.

    Args:
        places: paths from the folder.
        known: paths of files from the folder, as `describe_files` gives them.
        folder: the folder.
    """
    for place in places:
        if os.path.normpath(place).replace(os.sep, "/") in known:  # as most are, and this is quick
            continue
        path = os.path.join(folder, place)
        if os.path.isfile(path) and path_from(path, folder) not in known:
            return False
    return True


def path_from(path: str | os.PathLike[str], folder: Path) -> str:
    """A path relative to a folder, with slashes; absolute where there is no such path."""
    try:
        return os.path.relpath(path, folder).replace(os.sep, "/")
    except ValueError:  # another drive on Windows
        return Path(path).absolute().as_posix()


def _is_unchanged(known: Json, path: Path) -> bool:
    now = os.stat(path)
    # who reads a pipe may wait for ever
    if not stat.S_ISREG(now.st_mode) or now.st_size != known["size"]:
        return False
    return bool(now.st_mtime_ns == known["modified"] or _digest(path) == known["sha256"])


def _describe(path: Path, may_change: bool) -> Json:
    status = os.stat(path)
    is_recent = may_change and time.time_ns() - status.st_mtime_ns < RECENT
    return {
        "size": status.st_size,
        "modified": 0 if is_recent else status.st_mtime_ns,
        "sha256": _digest(path),
    }


def digest_rest(file: BinaryIO) -> str:
    """The sha256 of what is left to read of a file."""
    digest = hashlib.sha256()
    while chunk := file.read(CHUNK):
        digest.update(chunk)
    return digest.hexdigest()


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return digest_rest(file)
