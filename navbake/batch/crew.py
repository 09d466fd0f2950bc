"""Worker processes that do jobs, each of which may hang, crash or take too much memory.

The parent gives each worker one job at a time and watches it. A worker that takes too long is
killed; one that dies is replaced. So a job costs at most itself. Workers stay for many jobs, because
starting one takes as long as many bakes.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

from navbake.errors import NavbakeError

GIB = 1 << 30
END_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)
POLL = 1.0  # how often memory is looked at [s]
START_SECONDS = 300.0  # what a worker may take until it is ready; it may have to compile kernels

DONE, CRASHED, TOO_LONG, TOO_LARGE = "done", "crashed", "too long", "too large"


class JobLimits(NamedTuple):
    """What one job may take.

    Attributes:
        seconds: time [s]; None for no limit.
        memory: what its process may hold beyond what it starts with [GiB]; None for no limit.
            Kept on Linux only.
    """

    seconds: float | None = None
    memory: float | None = None


class Ended(NamedTuple):
    """How a job ended.

    Attributes:
        number: the job's.
        how: ``done``, ``crashed``, ``too long`` or ``too large``.
        value: what the work returned, if it is done; else why it isn't.
        seconds: how long it took.
    """

    number: int
    how: str
    value: Any
    seconds: float


class _Worker:
    """A worker process, seen from the parent."""

    def __init__(self, work: Callable[[Any], Any], limits: JobLimits) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(
            target=_serve, args=(theirs, work, limits.memory, os.getpid()), daemon=True
        )
        self.process.start()
        theirs.close()
        self.is_ready = False
        self.number: int | None = None  # of its job
        self.begun = time.monotonic()
        self.memory = 0  # that it held when it was ready [bytes]

    def give(self, number: int, job: Any) -> None:
        self.number, self.begun = number, time.monotonic()
        self.connection.send(job)

    @property
    def age(self) -> float:
        """How long it is at its job, or at starting [s]."""
        return time.monotonic() - self.begun

    def kill(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()

    def how_it_ended(self) -> str:
        self.process.join(1.0)
        status = self.process.exitcode
        if status is None:
            return "it closed its connection"
        if status >= 0:
            return f"its process ended with exit status {status}"
        try:
            return f"its process was ended by {signal.Signals(-status).name}"
        except ValueError:  # a number without a name
            return f"its process was ended by signal {-status}"


def do_jobs(
    jobs: Iterable[tuple[int, Any]],
    work: Callable[[Any], Any],
    count: int,
    limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
    retries: int = 0,
) -> Iterator[Ended]:
    """Do jobs in worker processes, and yield how each ended, in the order in which they end.

    Args:
        jobs: numbers, and what `work` is called with, which can be pickled.
        work: a function of a module, which returns what can be pickled and raises nothing.
        count: how many workers, >= 1.
        limits: of each job.
        retries: how often a job that crashed, or took too long or too much, is tried again.

    The workers are gone when the iterator is closed, or at the end.
    """
    left = iter(jobs)
    again: deque[tuple[int, Any]] = deque()
    tried: dict[int, int] = {}
    given: dict[int, Any] = {}
    workers: list[_Worker] = []

    def next_job() -> tuple[int, Any] | None:
        return again.popleft() if again else next(left, None)

    def lost(worker: _Worker, how: str, why: str) -> Iterator[Ended]:
        """What becomes of the job of a worker that is gone."""
        number, seconds = worker.number, worker.age
        workers.remove(worker)
        worker.kill()
        if number is None:  # it never got ready
            raise NavbakeError(f"cannot start a worker process: {why}; is there memory left?")
        tried[number] = tried.get(number, 0) + 1
        if tried[number] <= retries:
            again.append((number, given[number]))
        else:
            yield Ended(number, how, why, seconds)

    try:
        pending = next_job()
        while pending is not None or any(worker.number is not None for worker in workers):
            idle = [worker for worker in workers if worker.is_ready and worker.number is None]
            while pending is not None and idle:
                number, job = pending
                given[number] = job
                idle.pop().give(number, job)
                pending = next_job()
            starting = sum(not worker.is_ready for worker in workers)
            busy = sum(worker.number is not None for worker in workers)
            if pending is not None and not idle and starting + busy < count:
                workers.append(_Worker(work, limits))
            for worker in _heard(workers, limits):
                try:
                    message = worker.connection.recv()
                except (EOFError, OSError):
                    yield from lost(worker, CRASHED, worker.how_it_ended())
                    continue
                if not worker.is_ready:
                    worker.is_ready, worker.memory = True, _memory_of(worker.process.pid)
                    continue
                ended = worker.number
                assert ended is not None
                seconds, worker.number = worker.age, None
                given.pop(ended, None)
                yield Ended(ended, DONE, message, seconds)
            for worker in [*workers]:
                if worker.number is not None and _is_late(worker, limits):
                    why = f"it took more than {limits.seconds:g} s"
                    yield from lost(worker, TOO_LONG, why)
                elif worker.number is not None and _is_large(worker, limits):
                    why = f"it took more than {limits.memory:g} GiB of memory"
                    yield from lost(worker, TOO_LARGE, why)
            if pending is None:
                pending = next_job()
    finally:
        for worker in workers:
            worker.kill()


def _heard(workers: list[_Worker], limits: JobLimits) -> list[_Worker]:
    """The workers that have something to say, after a wait of at most `POLL`."""
    timeout = POLL
    if limits.seconds is not None:
        ages = [worker.age for worker in workers if worker.number is not None]
        timeout = min([timeout, *(max(0.0, limits.seconds - age) for age in ages)])
    by_connection = {worker.connection: worker for worker in workers}
    return [by_connection[ready] for ready in wait(list(by_connection), timeout)]  # type: ignore[index]


def _is_late(worker: _Worker, limits: JobLimits) -> bool:
    return limits.seconds is not None and worker.age > limits.seconds


def _is_large(worker: _Worker, limits: JobLimits) -> bool:
    """Whether a worker holds more memory than it may, beyond what it had when it was ready."""
    if limits.memory is None:
        return False
    return _memory_of(worker.process.pid) - worker.memory > limits.memory * GIB


def _memory_of(pid: int | None) -> int:
    """What a process holds in memory [bytes]; 0 where the system doesn't tell."""
    try:
        with open(f"/proc/{pid}/statm", "rb") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0


def _serve(
    connection: Connection, work: Callable[[Any], Any], memory: float | None, parent: int
) -> None:
    """What a worker does: jobs, one after another, until the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears of Ctrl-C and ends its workers
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _end_with(parent)
    prepare = getattr(work, "prepare", None)
    if prepare is not None:
        prepare()
    _limit_memory(memory)
    connection.send(None)
    while True:
        try:
            job = connection.recv()
        except EOFError:
            return
        connection.send(work(job))


def _end_with(parent: int) -> None:
    """End this process when its parent ends, however that ends; on Linux."""
    if sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(END_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before it was asked for
        os._exit(1)


def _limit_memory(gib: float | None) -> None:
    """Let this process reserve only so much more than it has now, so that Python can say so."""
    if gib is None or sys.platform != "linux":
        return
    import resource  # there is none on Windows

    with open("/proc/self/statm", "rb") as file:
        reserved = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    most = reserved + int(gib * GIB)
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard == resource.RLIM_INFINITY or most < hard:
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
