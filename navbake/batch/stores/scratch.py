"""Temporary folders that don't outlive their process for long, even if that is killed."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from navbake.files import OLD

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

PREFIX = "navbake-batch-"
LOCK = "lock"


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a temporary folder, and remove it at the end.

    Its process holds a lock in it. So `remove_abandoned` knows the folder of one that was killed.
    """
    # under another name until it is locked, or it would seem abandoned
    new = Path(tempfile.mkdtemp(prefix="navbake-new-"))
    folder = new.with_name(new.name.replace("navbake-new-", PREFIX, 1))
    try:
        with open(new / LOCK, "wb") as lock:
            if fcntl is not None:
                with suppress(OSError):  # a file system without locks
                    fcntl.flock(lock, fcntl.LOCK_EX)
                new.rename(folder)
            else:  # Windows renames no folder of open files
                folder = new
            yield folder
    finally:
        for path in (new, folder):
            shutil.rmtree(path, ignore_errors=True)


def remove_abandoned() -> None:
    """Remove the folders of processes that were killed; on Windows, those of a day ago."""
    with suppress(OSError), os.scandir(tempfile.gettempdir()) as entries:
        for entry in entries:
            if entry.name.startswith(PREFIX):
                with suppress(OSError):
                    _remove_abandoned(entry)


def _remove_abandoned(entry: os.DirEntry[str]) -> None:
    status = entry.stat(follow_symlinks=False)
    if not entry.is_dir(follow_symlinks=False):
        return
    if fcntl is None:
        is_abandoned = time.time() - status.st_mtime > OLD
    elif status.st_uid != os.getuid():
        return
    else:
        with open(Path(entry.path, LOCK), "rb") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                is_abandoned = True
            except BlockingIOError:  # its process is at work
                is_abandoned = False
    if is_abandoned:
        shutil.rmtree(entry.path, ignore_errors=True)
