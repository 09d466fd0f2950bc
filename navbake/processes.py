"""The memory of this process and of the machine, and how worker processes ended."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from navbake.errors import NavbakeError

try:
    import resource
except ImportError:  # on Windows
    resource = None  # type: ignore[assignment]

BYTES_PER_GIB = 1 << 30  # bytes
PR_SET_PDEATHSIG = 1  # PR_SET_PDEATHSIG of prctl(2)
# messages of failed allocations: of MuJoCo's own, of C++'s in MuJoCo, and of the system
NO_MEMORY_TEXTS = ("could not allocate memory", "unknown exception", "cannot allocate memory")


def end_with_parent(parent_id: int | None = None) -> None:
    """On Linux, make the system kill this process when its parent ends.

    Args:
        parent_id: Process id of the parent: if it has ended already, this process ends at once.
            None to leave out that check.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if parent_id is not None and os.getppid() != parent_id:
            os._exit(1)


def give_back_memory() -> None:
    """Return memory to the system that this process has freed but glibc still keeps; on Linux."""
    if sys.platform != "linux":
        return
    library = ctypes.CDLL(None)
    if hasattr(library, "malloc_trim"):
        library.malloc_trim(0)


def measure_free_memory() -> int:
    """Return how much memory is available without swapping [bytes]; 2**62 if that is unknown."""
    free_bytes = 2**62
    # ValueError: a container's limit may be "max"; IndexError: a line may have no number
    with suppress(OSError, ValueError):
        free_bytes = int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii"))
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return min(free_bytes, int(line.split()[1]) * 1024)
    with suppress(AttributeError, ValueError, OSError):  # there is no sysconf on Windows
        free_bytes = min(free_bytes, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return free_bytes


def limit_memory(gib: float | None) -> Callable[[], None]:
    """Limit the memory that this process may reserve, on Linux, and disable core dumps.

    Args:
        gib: Memory beyond what the process has now [GiB]; None, or more than a process can have,
            for no limit.

    Returns:
        A function that removes the limit.
    """
    if resource is None:
        return lambda: None
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if gib is None or gib * BYTES_PER_GIB >= sys.maxsize:
        return lambda: None
    try:
        with open("/proc/self/statm", "rb") as file:
            num_pages = int(file.read().split()[0])
    except OSError:  # limits are kept on Linux only
        return lambda: None
    limits_before = resource.getrlimit(resource.RLIMIT_AS)
    hard_limit = limits_before[1]
    max_bytes = num_pages * resource.getpagesize() + int(gib * BYTES_PER_GIB)
    if max_bytes < (sys.maxsize if hard_limit == resource.RLIM_INFINITY else hard_limit):
        resource.setrlimit(resource.RLIMIT_AS, (max_bytes, hard_limit))
    return lambda: resource.setrlimit(resource.RLIMIT_AS, limits_before)


def is_lack_of_memory(error: BaseException) -> bool:
    """Whether a lack of memory caused an error.

    A MemoryError counts always. If the process has a memory limit, the error's causes and messages
    count as well, because libraries like MuJoCo raise errors of their own. Without a limit these
    don't count: huge sizes in a broken file may cause the same messages.
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
        if not isinstance(cause, NavbakeError) and any(
            memory_text in text for memory_text in NO_MEMORY_TEXTS
        ):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def describe_exit(exit_status: int) -> str:
    """Describe how a process ended, such as ``exit status 1`` or ``SIGKILL``.

    Args:
        exit_status: The exit status as Python states it: negative for a signal.
    """
    if exit_status >= 0:
        return f"exit status {exit_status}"
    try:
        return signal.Signals(-exit_status).name
    except ValueError:  # unnamed signal
        return f"signal {-exit_status}"
