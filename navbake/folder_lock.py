"""Locks between processes that compile into one folder.

Of several processes that need the same kernel, one compiles it and the others wait for its code.
"""

from __future__ import annotations

import errno
import hashlib
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: each process compiles for itself
    fcntl = None  # type: ignore[assignment]

LOCK = "navbake-kernels.lock"
PATIENCE = 10.0  # for what takes milliseconds [s]
WAIT = 0.05  # between two attempts [s]


@cache
def folder_lock(folder: Path) -> FolderLock:
    """Get the lock of a folder, one for the whole process."""
    return FolderLock(folder)


class FolderLock:
    """Named locks in a folder, held by a process; the system drops them when it ends.

    Each name is one byte of one file, so a folder gets one file for all of its kernels. Where the
    file system has no locks, or the folder can't be written, nothing is locked: then processes
    compile the same code twice, which is slower and no worse.

    Source: POSIX record locks, fcntl(2). A lock belongs to the process, whichever thread took it,
    and a child that was forked has none of its parent's.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK
        self._file: int | None = None  # stays open: closing it would drop all locks of the process

    @contextmanager
    def hold(self, name: str) -> Iterator[None]:
        """Hold a lock, and wait for it a while if another process has it."""
        self.wait(name, PATIENCE)
        try:
            yield
        finally:
            self.release(name)

    def wait(self, name: str, seconds: float) -> bool:
        """Take a lock, or wait until another process gives it back; False if that takes longer.

        A process that is stopped keeps its locks, so waiting has an end. Where there are no locks,
        nothing is waited for, and it counts as taken.
        """
        end = time.monotonic() + seconds
        while self._take(name) is False:
            if time.monotonic() > end:
                return False
            time.sleep(WAIT)
        return True

    def try_acquire(self, name: str) -> bool:
        """Take a lock, unless another process has it or there are no locks here."""
        return self._take(name) is True

    def _take(self, name: str) -> bool | None:
        """Take a lock; False if another process has it, None if there are no locks here."""
        if fcntl is None:
            return None
        try:
            file = self._open()
        except OSError:
            return None
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _place_of(name))
        except OSError as error:
            return False if error.errno in (errno.EACCES, errno.EAGAIN) else None
        return True

    def _open(self) -> int:
        if self._file is None:
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        return self._file

    def release(self, name: str) -> None:
        """Give a lock back."""
        if fcntl is not None and self._file is not None:
            with suppress(OSError):
                fcntl.lockf(self._file, fcntl.LOCK_UN, 1, _place_of(name))


def _place_of(name: str) -> int:
    """The byte of the file that stands for a name."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:3], "little")
