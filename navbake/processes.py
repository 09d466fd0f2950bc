"""Limits and exit states of worker processes."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable

from navbake.errors import NavbakeError

try:
    import resource
except ImportError:  # on Windows
    resource = None  # type: ignore[assignment]

GIB = 1 << 30  # bytes
END_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)
# messages of failed allocations: of MuJoCo's own, of C++'s in MuJoCo, and of the system
NO_MEMORY = ("could not allocate memory", "unknown exception", "cannot allocate memory")


def end_with_parent(parent: int | None = None) -> None:
    """Let the system end this process with its parent, on Linux.

    Ends it at once if the process with the id `parent` has already ended.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(END_WITH_PARENT, signal.SIGKILL)
        if parent is not None and os.getppid() != parent:
            os._exit(1)


def give_back_memory() -> None:
    """Let the system have the memory that this process has freed, where glibc keeps it."""
    if sys.platform == "linux" and hasattr(library := ctypes.CDLL(None), "malloc_trim"):
        library.malloc_trim(0)


def limit_memory(gib: float | None) -> Callable[[], None]:
    """Limit the memory that this process may reserve, on Linux, and disable core dumps.

    The limit is `gib` beyond its current memory [GiB]; None, or more than a process can have, is no
    limit. Returns a function that removes it.
    """
    if resource is None:
        return lambda: None
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if gib is None or gib * GIB >= sys.maxsize:
        return lambda: None
    try:
        with open("/proc/self/statm", "rb") as file:
            pages = int(file.read().split()[0])
    except OSError:  # limits are kept on Linux only
        return lambda: None
    before = resource.getrlimit(resource.RLIMIT_AS)
    most = pages * resource.getpagesize() + int(gib * GIB)
    hard = before[1]
    if most < (sys.maxsize if hard == resource.RLIM_INFINITY else hard):
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    return lambda: resource.setrlimit(resource.RLIMIT_AS, before)


def lacked_memory(error: BaseException) -> bool:
    """Whether an error was caused by a memory limit of this process.

    With a limit, an error's causes and its message count, too, as libraries like MuJoCo raise
    errors of their own. Without one, only a MemoryError does, as sizes in a broken file may cause
    the others.
    """
    if isinstance(error, MemoryError):
        return True
    if resource is None or resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY:
        return False
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return True
        text = str(cause).lower()
        # navbake's own errors repeat their cause, and name files
        if not isinstance(cause, NavbakeError) and any(words in text for words in NO_MEMORY):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def ending_of(status: int) -> str:
    """Describe the end of a process from Python's exit status: a number, or a signal's name."""
    if status >= 0:
        return f"exit status {status}"
    try:
        return signal.Signals(-status).name
    except ValueError:  # unnamed signal
        return f"signal {-status}"
