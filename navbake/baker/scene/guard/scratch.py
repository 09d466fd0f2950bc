"""Temporary folders and files that don't outlive their process for long, even if that is killed."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from navbake.files import TEMPORARY, create_temporary, remove_leftovers

FOLDER = re.compile(r"navbake-[0-9a-f]{16}")
_swept: set[Path] = set()  # places that this process has removed abandoned folders from


@contextmanager
def scratch_folder(place: Path | None = None) -> Iterator[Path]:
    """Make a temporary folder, and remove it at the end.

    Beside it is a temporary file that its process keeps locked, which is there before the folder
    and after it. So `remove_abandoned` knows the folder of a process that was killed. What such
    processes left is removed first, once a process and place.

    Args:
        place: the folder that it is in; None for the system's folder for such things.
    """
    place = Path(place or tempfile.gettempdir())
    if place not in _swept:
        _swept.add(place)
        remove_abandoned(place)
    lock, path = create_temporary(place, 0o600)
    folder = _folder_of(path)
    try:
        with lock:
            folder.mkdir(0o700)
            try:
                yield folder
            finally:
                shutil.rmtree(folder, ignore_errors=True)
    finally:
        path.unlink(missing_ok=True)


def remove_abandoned(place: Path | None = None) -> None:
    """Remove temporary folders and files of processes that were killed.

    They are those that nobody has locked, see `remove_leftovers`: where nothing can be locked, that
    is known a day later. What other users left stays.
    """
    place = Path(place or tempfile.gettempdir())
    remove_leftovers(place)
    with suppress(OSError), os.scandir(place) as entries:
        for entry in entries:
            if FOLDER.fullmatch(entry.name):
                with suppress(OSError):
                    _remove_abandoned(Path(entry.path))


def _remove_abandoned(folder: Path) -> None:
    # in this order: the folder of a process that is at work is seen after its file was made
    status = os.lstat(folder)
    is_own = not hasattr(os, "getuid") or status.st_uid == os.getuid()
    if is_own and not os.path.lexists(_lock_of(folder)):
        shutil.rmtree(folder, ignore_errors=True)


def _folder_of(lock: Path) -> Path:
    assert TEMPORARY.fullmatch(lock.name), "files.py names it"
    return lock.with_name(lock.name.removeprefix(".").removesuffix(".tmp"))


def _lock_of(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.tmp")
