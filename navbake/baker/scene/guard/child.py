"""What processes that do risky work for another one have in common."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable

try:
    import resource
except ImportError:  # Windows limits no process that way
    resource = None  # type: ignore[assignment]

GIB = 1 << 30  # bytes
END_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)


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
        gib: how much more than it has now [GiB]; None for no limit.

    Returns:
        What ends the limit of memory.
    """
    if resource is None:
        return lambda: None
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if gib is None:
        return lambda: None
    try:
        with open("/proc/self/statm", "rb") as file:
            pages = int(file.read().split()[0])
    except OSError:  # no Linux: such limits are not kept there
        return lambda: None
    before = resource.getrlimit(resource.RLIMIT_AS)
    most, hard = pages * resource.getpagesize() + int(gib * GIB), before[1]
    if hard == resource.RLIM_INFINITY or most < hard:
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    return lambda: resource.setrlimit(resource.RLIMIT_AS, before)


def ending_of(status: int) -> str:
    """How a process ended, from the exit status that Python gives: a number, or a signal's name."""
    if status >= 0:
        return f"exit status {status}"
    try:
        return signal.Signals(-status).name
    except ValueError:  # a number without a name
        return f"signal {-status}"
