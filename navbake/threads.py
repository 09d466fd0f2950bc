"""Runs compiled kernels on several Python threads, each of which takes chunks of the work.

Kernels release the GIL. They are used in place of numba's own parallel loops: they compile in a
fraction of the time, and work after a fork and from any thread.
"""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

import numba
import numpy as np

from navbake.errors import ConfigError

Result = TypeVar("Result")

LEAST_CELLS = 4096  # work on fewer cells is not worth a call on another thread
CHUNKS_PER_THREAD = 8  # enough to balance the threads
# `_limit.count`: the most threads on which the kernels run that the present Python thread starts
_limit = threading.local()
_pool: ThreadPoolExecutor | None = None
_pool_lock = threading.Lock()


def run_in_chunks(
    kernel: Callable[..., object], count: int, *args: object, least: int = 1, begin: int = 0
) -> None:
    """Call a kernel for the indices ``range(begin, begin + count)``, in chunks, on several threads.

    A thread that has finished a chunk takes the next one. The result must not depend on that: each
    chunk writes data that no other chunk reads or writes.

    Args:
        kernel: ``kernel(*args, first, last)`` does the work for the indices ``range(first, last)``.
            It is compiled with ``nogil=True``.
        count: Number of indices, >= 0.
        *args: Arguments of all calls.
        least: Fewest indices that are worth a call, >= 1; if there are no more, only this thread
            works.
        begin: First index.
    """
    max_threads = num_threads()
    chunk_size = max(least, -(-count // (max_threads * CHUNKS_PER_THREAD)))
    end = begin + count
    if max_threads == 1 or count <= chunk_size:
        if count:
            kernel(*args, begin, end)
        return
    chunks = iter(
        [(first, min(first + chunk_size, end)) for first in range(begin, end, chunk_size)]
    )
    num_helpers = min(max_threads, -(-count // chunk_size)) - 1  # threads besides this one
    futures = [_get_pool().submit(_run_kernel, kernel, args, chunks) for _ in range(num_helpers)]
    try:
        _run_kernel(kernel, args, chunks)
    finally:
        deque(chunks, maxlen=0)  # after an error, no further chunk begins
        # cancel calls that have not begun: they would find no chunk
        begun = [future for future in futures if not future.cancel()]
        for future in begun:
            future.result()


def run_beside(task: Callable[..., Result], *args: object) -> Callable[[], Result]:
    """Start a function on another thread.

    The kernels that it starts may use as many threads as those that this thread starts. If the
    function has not begun when its result is needed (there is one thread, or all are busy), it runs
    on the waiting thread.

    Args:
        task: The function.
        *args: Its arguments.

    Returns:
        A function that waits, and returns the result of `task` or raises its error.
    """
    max_threads = num_threads()
    if max_threads == 1:
        return partial(task, *args)
    future = _get_pool().submit(_run_with_limit, max_threads, task, args)

    def wait() -> Result:
        if future.cancel():
            return _run_with_limit(max_threads, task, args)
        return future.result()

    return wait


def _run_with_limit(
    max_threads: int, task: Callable[..., Result], args: tuple[object, ...]
) -> Result:
    with limit_threads(max_threads):  # each Python thread has a limit of its own
        return task(*args)


def _run_kernel(
    kernel: Callable[..., object], args: tuple[object, ...], chunks: Iterator[tuple[int, int]]
) -> None:
    """Call a kernel for the next chunk, until none is left; other threads take chunks as well."""
    # `next` of a list's iterator is atomic
    for first, last in chunks:
        kernel(*args, first, last)


def num_threads() -> int:
    """Return the most threads on which the kernels run that this Python thread starts."""
    return int(getattr(_limit, "count", None) or numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


@contextmanager
def limit_threads(count: int | None) -> Iterator[None]:
    """In a with statement, limit the threads of the kernels that this Python thread starts.

    Args:
        count: The largest number of threads, >= 1; None changes nothing.

    Raises:
        ConfigError: The count is no whole number >= 1.
    """
    count_before = getattr(_limit, "count", None)
    if count is not None:
        is_whole = isinstance(count, int | np.integer) and not isinstance(count, bool)
        if not is_whole or count < 1:
            expected = "a number of threads >= 1"
            raise ConfigError(
                f"expected {expected}, got {count!r}", key="threads", value=count, expected=expected
            )
        _limit.count = min(int(count), int(numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]
    try:
        yield
    finally:
        _limit.count = count_before


def _get_pool() -> ThreadPoolExecutor:
    global _pool
    with _pool_lock:
        if _pool is None:
            max_threads = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
            _pool = ThreadPoolExecutor(max_threads, "navbake")
        return _pool


def _reset_pool() -> None:
    """Make a forked process start a new pool: it has no threads, and its lock may be locked."""
    global _pool, _pool_lock
    _pool = None
    _pool_lock = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_reset_pool)
