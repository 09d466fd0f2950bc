"""What processes that do risky work for another one have in common."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable

from navbake.errors import NavbakeError

try:
    import resource
except ImportError:  # Windows limits no process that way
    resource = None  # type: ignore[assignment]

GIB = 1 << 30  # bytes
END_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)
# What errors say, whatever their type, of memory that the system refused: MuJoCo of its own
# allocations, then of those of C++; and what the system says itself, of a library, for example
NO_MEMORY = ("could not allocate memory", "unknown exception", "cannot allocate memory")


def end_with_parent(parent: int | None = None) -> None:
    """Ask the system to end this process when its parent ends, however that happens; on Linux.

    Args:
        parent: the parent's id; if it is given and the parent has ended already, this process ends
            at once.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(END_WITH_PARENT, signal.SIGKILL)
        if parent is not None and os.getppid() != parent:
            os._exit(1)


def limit_memory(gib: float | None) -> Callable[[], None]:
    """Limit what this process may reserve from now on, on Linux, and let it leave no core dump.

    Args:
        gib: how much more than it has now [GiB]; None, or more than a process can have, for no
            limit.

    Returns:
        What ends the limit of memory.
    """
    if resource is None:
        return lambda: None
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if gib is None or gib * GIB >= sys.maxsize:
        return lambda: None
    try:
        with open("/proc/self/statm", "rb") as file:
            pages = int(file.read().split()[0])
    except OSError:  # no Linux: such limits are not kept there
        return lambda: None
    before = resource.getrlimit(resource.RLIMIT_AS)
    most, hard = pages * resource.getpagesize() + int(gib * GIB), before[1]
    if most < (sys.maxsize if hard == resource.RLIM_INFINITY else hard):
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    return lambda: resource.setrlimit(resource.RLIMIT_AS, before)


def lacked_memory(error: BaseException) -> bool:
    """Whether a limit of this process' memory led to an error.

    Libraries turn that into errors of their own. So where there is a limit, what an error came
    from counts, too, and so do its words, as MuJoCo has no error of a type of its own for this.

    Returns:
        Without a limit, whether it is a MemoryError: then sizes that a broken file states may
        lead to the others.
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
        # navbake's own errors say the same of their cause, and name files besides
        if not isinstance(cause, NavbakeError) and any(words in text for words in NO_MEMORY):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def ending_of(status: int) -> str:
    """How a process ended, from the exit status that Python gives: a number, or a signal's name."""
    if status >= 0:
        return f"exit status {status}"
    try:
        return signal.Signals(-status).name
    except ValueError:  # a number without a name
        return f"signal {-status}"
