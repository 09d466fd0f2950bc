"""Runs compiled kernels on several Python threads, each of which takes chunks of the work.

Kernels release the GIL, so they run in parallel. numba's own parallel loops are not used: they take
several times as long to compile, and fail after a fork, or when several threads start them.
"""

import _thread
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from queue import SimpleQueue
from typing import TypeVar

import numba
import numpy as np

from navbake.errors import ConfigError, NavbakeError

Result = TypeVar("Result")

LEAST_CELLS = 4096  # fewest cells in a chunk: for fewer, a call on another thread takes longer
CHUNKS_PER_THREAD = 8  # enough to balance the threads
# `_limit.count`: the most threads on which the kernels run that the present Python thread starts
_limit = threading.local()
_pool: ThreadPoolExecutor | None = None
_pool_lock = threading.Lock()
_baking_threads: list[int] = []  # ids of the threads that are inside of a `with baking()` block
_was_forked_midway = False  # whether another thread was baking as this process was forked


def run_in_chunks(
    kernel: Callable[..., object],
    count: int,
    *args: object,
    min_chunk_size: int = 1,
    begin: int = 0,
) -> None:
    """Call a kernel for the indices ``range(begin, begin + count)``, in chunks, on several threads.

    A thread that has finished a chunk takes the next one. The result must not depend on that: each
    chunk writes data that no other chunk reads or writes. If there are several chunks, what the
    kernel itself starts runs on the thread of its chunk alone, as other threads have chunks, too.

    Args:
        kernel: ``kernel(*args, begin, end)`` does the work for the indices ``range(begin, end)``.
            It is compiled with ``nogil=True``.
        count: Number of indices, >= 0.
        *args: Arguments of all calls.
        min_chunk_size: Fewest indices that are worth a call on another thread, >= 1; if `count` is
            no larger, only this thread works.
        begin: First index.

    Raises:
        NavbakeError: This process was forked while another thread was baking, see `baking`.
    """
    max_threads = num_threads()
    chunk_size = max(min_chunk_size, -(-count // (max_threads * CHUNKS_PER_THREAD)))
    end = begin + count
    if max_threads == 1 or count <= chunk_size:
        if count:
            kernel(*args, begin, end)
        return
    chunks = iter(
        [
            (first_index, min(first_index + chunk_size, end))
            for first_index in range(begin, end, chunk_size)
        ]
    )
    num_helpers = min(max_threads, -(-count // chunk_size)) - 1  # threads besides this one
    with baking():
        pool = _get_pool()
        futures = []
        try:
            for _ in range(num_helpers):
                futures.append(pool.submit(_run_kernel, kernel, args, chunks))
            _run_kernel(kernel, args, chunks)
        finally:
            deque(chunks, maxlen=0)  # after an error, no further chunk begins
            # cancel calls that have not begun: they would find no chunk
            begun_futures = [future for future in futures if not future.cancel()]
            for future in begun_futures:
                future.result()


def run_beside(task: Callable[..., Result], *args: object) -> Callable[[], Result]:
    """Start a function on another thread.

    Kernels that the function calls may use as many threads as those that this thread calls. If the
    function has not begun when its result is needed (all threads are busy, or there is only one),
    it runs on the thread that waits for it.

    Args:
        task: The function.
        *args: Its arguments.

    Returns:
        A function that waits, and returns the result of `task` or raises its error.

    Raises:
        NavbakeError: This process was forked while another thread was baking, see `baking`.
    """
    max_threads = num_threads()
    if max_threads == 1:
        return partial(task, *args)
    _check_fork()
    future = _get_pool().submit(_run_with_limit, max_threads, task, args)

    def wait() -> Result:
        if future.cancel():
            return _run_with_limit(max_threads, task, args)
        return future.result()

    return wait


def _run_with_limit(
    max_threads: int, task: Callable[..., Result], args: tuple[object, ...]
) -> Result:
    with baking(), limit_threads(max_threads):  # each Python thread has a limit of its own
        return task(*args)


def _run_kernel(
    kernel: Callable[..., object], args: tuple[object, ...], chunks: Iterator[tuple[int, int]]
) -> None:
    """Call a kernel for the next chunk, until none is left; other threads take chunks as well."""
    with limit_threads(1):
        # `next` of a list's iterator is atomic
        for begin, end in chunks:
            kernel(*args, begin, end)


def num_threads() -> int:
    """Return the largest number of threads for a kernel that this Python thread calls."""
    return int(getattr(_limit, "count", None) or numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


@contextmanager
def limit_threads(count: int | None) -> Iterator[None]:
    """In a with statement, limit the number of threads for kernels that this Python thread calls.

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


@contextmanager
def baking() -> Iterator[None]:
    """In a with statement, note that this Python thread is baking.

    If another thread forks the process meanwhile, the new process gets copies of all locks that
    this thread holds, in MuJoCo, in numba and in Python, but not the thread, so nothing unlocks
    them. A bake there would wait for ever; it gets an error in place of that.

    Raises:
        NavbakeError: This process was forked while another thread was baking.
    """
    _check_fork()
    thread_id = threading.get_ident()
    _baking_threads.append(thread_id)
    try:
        yield
    finally:
        _baking_threads.remove(thread_id)


def _check_fork() -> None:
    if _was_forked_midway:
        hint = (
            'start processes by multiprocessing.get_context("spawn"), or fork before another '
            "thread bakes"
        )
        raise NavbakeError(
            f"this process was forked while another thread was baking, so it can't bake: {hint}",
            hint=hint,
        )


def _get_pool() -> ThreadPoolExecutor:
    """Return the pool of threads; the first call starts all of them, on another thread.

    On the main thread, Ctrl-C could raise KeyboardInterrupt while a thread starts, and leave one
    that the pool doesn't know of: Python would wait for it at its end for ever.
    """
    with _pool_lock:
        if _pool is None:
            error_queue = SimpleQueue[BaseException | None]()
            _thread.start_new_thread(_start_pool, (error_queue,))
            start_error = error_queue.get()
            if start_error is not None:
                raise start_error
        assert _pool is not None
        return _pool


def _start_pool(error_queue: SimpleQueue[BaseException | None]) -> None:
    """Start the pool with all its threads.

    Args:
        error_queue: gets None at the end, or the error if the system starts no further thread.
    """
    global _pool
    max_threads = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    new_pool = ThreadPoolExecutor(max_threads, "navbake")
    are_started = threading.Event()
    try:
        for _ in range(max_threads):
            new_pool.submit(are_started.wait)  # while all threads wait, the pool starts another one
    except RuntimeError as error:
        error_queue.put(error)
    else:
        _pool = new_pool
        error_queue.put(None)
    finally:
        are_started.set()


def _adapt_to_fork() -> None:
    """Prepare a process that was just forked: it will start a new pool with a new lock.

    It has no threads but the one that forked it, and a copied lock may be locked for ever. Also
    note whether another thread was baking: then this process can't bake, see `baking`.
    """
    global _pool, _pool_lock, _was_forked_midway
    _pool = None
    _pool_lock = threading.Lock()
    entries_of_this_thread = [
        thread for thread in _baking_threads if thread == threading.get_ident()
    ]
    _was_forked_midway |= len(entries_of_this_thread) < len(_baking_threads)
    _baking_threads[:] = entries_of_this_thread


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_adapt_to_fork)
