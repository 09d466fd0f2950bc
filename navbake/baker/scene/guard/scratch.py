"""Temporary folders and files that don't outlive their process for long, even if that is killed."""

from __future__ import annotations

import errno
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from navbake.errors import NavbakeError
from navbake.files import OLD, TEMPORARY, create_temporary, modified, remove_leftovers

FOLDER = re.compile(r"navbake-[0-9a-f]{16}")
TOO_MANY_OPEN = (errno.EMFILE, errno.ENFILE)  # of which no folder is the cause
_swept: set[Path] = set()  # places that this process has removed abandoned folders from


@contextmanager
def scratch_folder(place: Path | None = None) -> Iterator[Path]:
    """Make a temporary folder, and remove it at the end.

    Beside it is a temporary file that its process keeps locked, which is there before the folder
    and after it. So `remove_abandoned` knows the folder of a process that was killed. What such
    processes left is removed first, once a process and place.

    Args:
        place: the folder that it is in; None for the system's folder for such things.

    Raises:
        NavbakeError: it can't be made there.
    """
    where = _system_place() if place is None else place
    if where not in _swept:
        _swept.add(where)
        _sweep(where)
    lock, path = _create(where, is_system=place is None)
    folder = _folder_of(path)
    try:
        with lock:
            try:
                folder.mkdir(0o700)
            except OSError as error:
                raise _refused(where, error, is_system=place is None) from error
            try:
                yield folder
            finally:
                shutil.rmtree(folder, ignore_errors=True)
    finally:
        path.unlink(missing_ok=True)


def scratch_file() -> tuple[BinaryIO, Path]:
    """Open a new file in the system's folder for temporary files; see `files.create_temporary`.

    Raises:
        NavbakeError: it can't be made there.
    """
    return _create(_system_place(), is_system=True)


def short_place() -> Path | None:
    """A folder for temporary folders whose paths must be short, as those of sockets; or None.

    The system's folder for such things is not always short.
    """
    place = Path("/tmp")
    return place if sys.platform != "win32" and place.is_dir() else None


def remove_abandoned(place: Path | None = None) -> None:
    """Remove temporary folders and files of processes that were killed.

    They are those whose file nobody has locked, see `remove_leftovers`. Where nothing can be
    locked, or a folder's file is gone, as what cleans up temporary folders may remove it, that is
    known when nothing in the folder has changed for a day. What other users left stays.

    Args:
        place: where they are; None for all places where `scratch_folder` makes them.
    """
    if place is not None:
        _sweep(place)
        return
    places = {short_place()}
    with suppress(NavbakeError):  # no folder takes temporary files
        places.add(_system_place())
    for found in places:
        if found is not None:
            _sweep(found)


def _system_place() -> Path:
    """The system's folder for temporary files."""
    try:
        return Path(tempfile.gettempdir())
    except FileNotFoundError as error:  # it names those that take no file
        raise NavbakeError(
            f"cannot write temporary files: {error.strerror}: free space, or set TMPDIR to a "
            "folder that has room"
        ) from error


def _create(place: Path, *, is_system: bool) -> tuple[BinaryIO, Path]:
    try:
        return create_temporary(place, 0o600)
    except OSError as error:
        if error.errno in TOO_MANY_OPEN:
            raise
        raise _refused(place, error, is_system=is_system) from error


def _refused(place: Path, error: OSError, *, is_system: bool) -> NavbakeError:
    remedy = "free space, or set TMPDIR to a folder that has room" if is_system else "free space"
    return NavbakeError(f"cannot write temporary files into {place}: {error.strerror}: {remedy}")


def _sweep(place: Path) -> None:
    locked = [folder for folder in _folders_in(place) if os.path.lexists(_lock_of(folder))]
    remove_leftovers(place, _last_change)
    for folder in _folders_in(place):
        # in this order: the folder of a process that is at work is seen after its file was made
        if not os.path.lexists(_lock_of(folder)):
            with suppress(OSError):
                if folder in locked or time.time() - _last_change(_lock_of(folder)) > OLD:
                    _remove(folder)


def _folders_in(place: Path) -> list[Path]:
    with suppress(OSError), os.scandir(place) as entries:
        return [Path(entry.path) for entry in entries if FOLDER.fullmatch(entry.name)]
    return []


def _remove(folder: Path) -> None:
    if not hasattr(os, "getuid") or os.lstat(folder).st_uid == os.getuid():
        shutil.rmtree(folder, ignore_errors=True)


def _last_change(lock: Path) -> float:
    """When a temporary file, its folder or anything in that was written last [s since 1970]."""
    folder, latest = _folder_of(lock), 0.0
    inside = (Path(top, name) for top, _, names in os.walk(folder) for name in (".", *names))
    for path in (lock, *inside):
        with suppress(OSError):  # it is gone meanwhile, or there is none
            latest = max(latest, modified(path))
    return latest


def _folder_of(lock: Path) -> Path:
    assert TEMPORARY.fullmatch(lock.name), "files.py names it"
    return lock.with_name(lock.name.removeprefix(".").removesuffix(".tmp"))


def _lock_of(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.tmp")
