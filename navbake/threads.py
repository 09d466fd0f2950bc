"""Runs compiled kernels on Python threads, each with ranges of the work.

Kernels release the GIL. They compile in a fraction of the time of numba's own parallel loops, and
work after a fork and from any thread.
"""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

import numba
import numpy as np

from navbake.errors import ConfigError

Result = TypeVar("Result")

LEAST_CELLS = 4096  # so many cells are worth a call on another thread
BANDS = 8  # ranges per thread: enough to balance them
_limit = threading.local()  # `count`: the most threads for kernels that this thread starts
_pool: ThreadPoolExecutor | None = None
_pool_lock = threading.Lock()


def run_in_chunks(
    kernel: Callable[..., Any], count: int, *args: Any, least: int = 1, begin: int = 0
) -> None:
    """Call a kernel for ``range(begin, begin + count)``, by ranges, on as many threads as allowed.

    The threads take the ranges in order, each its next one when done. The result must not depend on
    that: each range writes data that no other one reads or writes.

    Args:
        kernel: ``kernel(*args, first, last)`` does the work of ``range(first, last)``; compiled
            with ``nogil=True``.
        count: size of the work, >= 0.
        args: of all calls.
        least: smallest range that is worth a call, >= 1; less work runs on this thread.
        begin: start of the work.
    """
    threads = num_threads()
    size = max(least, -(-count // (threads * BANDS)))
    end = begin + count
    if threads == 1 or count <= size:
        if count:
            kernel(*args, begin, end)
        return
    bands = iter([(first, min(first + size, end)) for first in range(begin, end, size)])
    others = min(threads, -(-count // size)) - 1
    started = [_get_pool().submit(_work, kernel, args, bands) for _ in range(others)]
    try:
        _work(kernel, args, bands)
    finally:
        deque(bands, maxlen=0)  # after an error, no further range begins
        # the ranges are used up
        for future in [future for future in started if not future.cancel()]:
            future.result()


def run_beside(task: Callable[..., Result], *args: Any) -> Callable[[], Result]:
    """Start a function on another thread; returns a function that waits for its result or error.

    Its kernels may take as many threads as this thread's. If it hasn't begun when the result is
    needed, as with one thread or if all are busy, it runs on the waiting thread.
    """
    count = num_threads()
    if count == 1:
        return partial(task, *args)
    future = _get_pool().submit(_run_limited, count, task, args)
    return lambda: _run_limited(count, task, args) if future.cancel() else future.result()


def _run_limited(count: int, task: Callable[..., Result], args: tuple[Any, ...]) -> Result:
    with limit_threads(count):  # limits are per thread
        return task(*args)


def _work(kernel: Callable[..., Any], args: tuple[Any, ...], bands: Iterator[Any]) -> None:
    # `next` of a list's iterator is atomic
    for first, last in bands:
        kernel(*args, first, last)


def num_threads() -> int:
    """The most threads for kernels that this Python thread starts."""
    return int(getattr(_limit, "count", None) or numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


@contextmanager
def limit_threads(count: int | None) -> Iterator[None]:
    """Limit kernels inside to `count` threads; None changes nothing. Raises a ConfigError."""
    before = getattr(_limit, "count", None)
    if count is not None:
        is_whole = isinstance(count, int | np.integer) and not isinstance(count, bool)
        if not is_whole or count < 1:
            raise ConfigError(f"expected a number of threads >= 1, got {count!r}")
        _limit.count = min(int(count), int(numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]
    try:
        yield
    finally:
        _limit.count = before


def _get_pool() -> ThreadPoolExecutor:
    global _pool
    with _pool_lock:
        if _pool is None:
            most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
            _pool = ThreadPoolExecutor(most, "navbake")
        return _pool


def _after_fork() -> None:
    """Reset a forked child, which has no threads and maybe a locked lock."""
    global _pool, _pool_lock
    _pool = None
    _pool_lock = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
