"""How kernels run on several threads: threads of Python, each with a range of the work.

A kernel that lets go of Python's lock runs beside others of its kind. That takes a fraction of the
time to compile that numba's own parallel loops take, and works after a fork and from any thread.
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
BANDS = 8  # ranges for each thread: enough that all end at about the same time
_limit = threading.local()  # `count`: the most threads for what this thread starts
_pool: ThreadPoolExecutor | None = None
_pool_lock = threading.Lock()


def run_in_bands(
    kernel: Callable[..., Any], count: int, *args: Any, least: int = 1, begin: int = 0
) -> None:
    """Call a kernel for ``range(begin, begin + count)``, by ranges, on as many threads as allowed.

    The threads take the ranges in order, each the next one when it is done with its last. Which
    thread takes which must not matter: each range writes what no other one reads or writes.

    Args:
        kernel: ``kernel(*args, first, last)`` does the work of ``range(first, last)``; compiled
            with ``nogil=True``.
        count: how much work there is, >= 0.
        args: what all calls are given.
        least: how much work is worth a call, >= 1; less of it than that runs on this thread.
        begin: where the work begins.
    """
    threads = num_threads()
    size = max(least, -(-count // (threads * BANDS)))
    end = begin + count
    bands = iter([(first, min(first + size, end)) for first in range(begin, end, size)])
    if threads == 1 or count <= size:
        _work(kernel, args, iter([(begin, end)] if count else []))
        return
    others = min(threads, -(-count // size)) - 1
    started = [_get_pool().submit(_work, kernel, args, bands) for _ in range(others)]
    try:
        _work(kernel, args, bands)
    finally:
        deque(bands, maxlen=0)  # after an error here nothing more is begun
        # one that has not begun has nothing left to do
        for future in [future for future in started if not future.cancel()]:
            future.result()


def take_rows(source: Any, index: Any, out: Any, first: int, end: int) -> None:
    """Write the rows of an array that an index names: `numpy.take`, for `run_in_bands`."""
    np.take(source, index[first:end], axis=0, out=out[first:end], mode="clip")


def run_beside(task: Callable[..., Result], *args: Any) -> Callable[[], Result]:
    """Start a function on another thread; on one thread, it runs when its result is asked for.

    Kernels that it starts may take as many threads as those of this thread.

    Returns what waits for the result, and gives it or raises what the function raised. If no other
    thread has begun by then, because all are busy, the one that asks runs it.
    """
    count = num_threads()
    if count == 1:
        return partial(task, *args)
    future = _get_pool().submit(_run_limited, count, task, args)
    return lambda: _run_limited(count, task, args) if future.cancel() else future.result()


def _run_limited(count: int, task: Callable[..., Result], args: tuple[Any, ...]) -> Result:
    with limit_threads(count):  # a limit is known to its own thread alone
        return task(*args)


def _work(
    kernel: Callable[..., Any], args: tuple[Any, ...], bands: Iterator[tuple[int, int]]
) -> None:
    # `next` of a list's iterator is one step of Python's: two threads never get the same
    for first, last in bands:
        kernel(*args, first, last)


def num_threads() -> int:
    """How many threads the kernels that this thread of Python starts may take."""
    return int(getattr(_limit, "count", None) or numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


@contextmanager
def limit_threads(count: int | None) -> Iterator[None]:
    """Run what is inside on at most `count` threads, or a ConfigError; None changes nothing."""
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
    """A forked child has none of its parent's threads, and the lock may be held by one of them."""
    global _pool, _pool_lock
    _pool, _pool_lock = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
