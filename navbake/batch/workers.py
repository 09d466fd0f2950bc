"""Worker processes that do jobs, each of which may hang, crash or take too much memory."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, TimeoutError, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from pebble import ProcessExpired, ProcessPool

from navbake.errors import NavbakeError, printable
from navbake.files import scratch_folder
from navbake.processes import end_with_parent, ending_of, limit_memory

TICK = 0.5  # how long the parent waits at most, to see which jobs have begun [s]
LATE = 1.0  # how much longer a wait takes only where this process was stopped [s]
AHEAD = 3  # jobs that are handed out for each worker: none waits for the parent
MOST_BREAKS = 3  # of pools in a row in which no job ended, before the batch gives up
MOST_TEXT = 200  # of what a worker wrote on stderr, characters
DONE, CRASHED, TOO_LONG, TOO_LARGE = "done", "crashed", "too long", "too large"
BEGUN, AGAIN = "scene-begin", "retry"  # what happens besides that jobs end


class JobLimits(NamedTuple):
    """What one job may take.

    Attributes:
        seconds: time [s]; None for no limit.
        memory: what its process may reserve beyond what it starts with [GiB]; None for no limit.
            Kept on Linux only.
        retries: how often a job that crashed, or took too long or too much, is tried again.
    """

    seconds: float | None = None
    memory: float | None = None
    retries: int = 0


class Ended(NamedTuple):
    """How a job ended, or why a try at it did.

    Attributes:
        number: the job's place among the jobs.
        how: ``done``, ``crashed``, ``too long`` or ``too large``.
        value: what the work returned, if it is done; else why it isn't.
        seconds: how long it took, at the last try.
        worker: the id of its process, 0 where that isn't known.
    """

    number: int
    how: str
    value: Any
    seconds: float = 0.0
    worker: int = 0


OnEvent = Callable[[str, Ended], None]


def do_jobs(
    jobs: Sequence[Any],
    work: Callable[[Any], Any],
    count: int,
    *,
    on_event: OnEvent = lambda event, ended: None,
    **options: Any,
) -> Generator[Ended, None, None]:
    """Do jobs in at most `count` worker processes; see `Workers` for the arguments and errors.

    The workers are gone when the iterator is closed, or at the end.
    """
    with Workers(work, min(count, len(jobs)), **options) as workers:
        yield from workers.do(jobs, on_event)


class Workers:
    """Worker processes, which are started when they are needed and kept for many jobs."""

    def __init__(
        self,
        work: Callable[[Any], Any],
        count: int,
        *,
        limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
        prepare: Callable[[], None] | None = None,
    ) -> None:
        """Set up workers.

        Args:
            work: a function of a module, which returns what can be pickled.
            count: how many workers, >= 1.
            limits: of each job.
            prepare: a function of a module that each worker calls before its first job.
        """
        self._work, self._count, self._limits, self._prepare = work, count, limits, prepare
        self._closing = ExitStack()
        self._pool: ProcessPool | None = None

    def __enter__(self) -> Workers:
        # of temporary files, and of what each worker wrote on stderr, by its id
        self._folder = self._closing.enter_context(scratch_folder())
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
        self._closing.close()

    def do(self, jobs: Sequence[Any], on_event: OnEvent) -> Iterator[Ended]:
        """Do jobs, which can be pickled, and yield how each ended, in the order in which they end.

        `on_event` is called when a job begins, and when it will be tried again.
        A job that ended its worker, or took too much memory, is tried again at the end, in a
        process of its own: what another job left behind may have been the cause.

        Raises:
            NavbakeError: no worker starts.
        """
        tries, breaks, alone = [0] * len(jobs), 0, False
        left, again = deque(range(len(jobs))), deque[int]()
        while left:
            for ended in self._in_pool(jobs, left, alone, on_event):
                breaks = 0
                is_blamed = alone or ended.how == TOO_LONG
                tries[ended.number] += is_blamed and ended.how != DONE
                if ended.how == DONE or tries[ended.number] > self._limits.retries:
                    yield ended
                else:
                    on_event(AGAIN, ended)
                    again.append(ended.number)
            if left or again or alone:
                self._stop()
            if left:
                breaks += 1
            else:
                left, again, alone = again, left, True
            if breaks == MOST_BREAKS:
                why = self._last_words(None)
                raise NavbakeError(f"cannot start a worker process{f': {why}' if why else ''}")

    def _stop(self) -> None:
        """End the workers."""
        if self._pool is not None:
            self._pool.stop()  # type: ignore[no-untyped-call]
            self._pool.join()
            self._pool = None

    def _in_pool(
        self, jobs: Sequence[Any], left: deque[int], alone: bool, on_event: OnEvent
    ) -> Iterator[Ended]:
        """Do jobs in a pool until none is left or it breaks; those that it had are left then.

        A process does one job if they are to be `alone`.
        """
        if self._pool is None:
            self._pool = ProcessPool(
                max_workers=min(self._count, len(left)) if alone else self._count,
                max_tasks=1 if alone else 0,
                initializer=_settle,
                initargs=(os.getpid(), self._folder, self._limits.memory, self._prepare),
                context=get_context("spawn"),
            )
        number_of: dict[Future[Any], int] = {}
        begun: dict[Future[Any], float] = {}
        limit = self._limits.seconds
        seconds = None if limit == float("inf") else limit
        excused: set[Future[Any]] = set()  # this process, and so its workers, was stopped meanwhile
        while left or number_of:
            while left and len(number_of) < AHEAD * self._count:
                arguments = self._work, jobs[left[0]], alone, self._limits.memory
                try:
                    with _ctrl_c_waits():  # the first one starts the workers
                        future: Future[Any] = self._pool.schedule(_do, arguments, timeout=seconds)
                except RuntimeError:  # it is broken
                    left.extendleft(number_of.values())
                    return
                number_of[future] = left.popleft()
            before = time.time()  # by which the pool measures, too
            done, _ = wait(number_of, TICK, FIRST_COMPLETED)
            if time.time() - before > TICK + LATE:
                excused.update(number_of)
            for future in number_of.keys() - begun.keys():
                if future.running() or future in done:
                    begun[future] = before
                    on_event(BEGUN, Ended(number_of[future], "", ""))
            for future in done:
                number = number_of.pop(future)
                taken = time.time() - begun.pop(future)
                error = future.exception()
                if isinstance(error, BrokenProcessPool):
                    left.extendleft([number, *number_of.values()])
                    return
                if isinstance(error, TimeoutError) and future in excused:
                    left.append(number)
                else:
                    yield self._ended(number, future, error, taken)

    def _ended(
        self, number: int, future: Future[Any], error: BaseException | None, seconds: float
    ) -> Ended:
        if error is None:
            worker, how, value = future.result()
            return Ended(number, how, value, seconds, worker)
        if isinstance(error, TimeoutError):
            why = f"it took more than {self._limits.seconds:g} s"
            return Ended(number, TOO_LONG, why, seconds)
        if isinstance(error, ProcessExpired):
            text = self._last_words(error.pid)
            how = f"{'with' if error.exitcode >= 0 else 'by'} {ending_of(error.exitcode)}"
            why = f"its process ended {how}{f': {text}' if text else ''}"
            return Ended(number, CRASHED, why, seconds, error.pid)
        why = printable(f"{type(error).__name__}: {error}".strip())
        return Ended(number, CRASHED, why, seconds)

    def _last_words(self, pid: int | None) -> str:
        """The last line that a worker, or any, wrote on stderr, where libraries say why."""
        text = b""
        with suppress(OSError):
            for path in self._folder.glob(str(pid or "[0-9]*")):
                text = path.read_bytes()[-16 * MOST_TEXT :] or text
        lines = [line.strip() for line in text.decode(errors="replace").splitlines()]
        return printable(next((line for line in reversed(lines) if line), "")[:MOST_TEXT])


@contextmanager
def _ctrl_c_waits() -> Iterator[None]:
    """Let Ctrl-C wait: processes and threads that start inside hear of none until they want to.

    Without it, Ctrl-C prints the traceback of each worker that is still importing modules.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    from multiprocessing import resource_tracker  # Windows has none

    resource_tracker.ensure_running()  # its start would let the signal through
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# ---------------------------------------------------------------- in the worker


def _settle(
    parent: int, folder: Path, memory: float | None, prepare: Callable[[], None] | None
) -> None:
    """Leave Ctrl-C, the terminal and the end of the parent to the parent; get ready."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    end_with_parent(parent)
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    words = os.open(folder / str(os.getpid()), os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
    os.dup2(words, 2)
    tempfile.tempdir = str(folder)  # so what a killed worker leaves there is removed
    if prepare is not None:
        prepare()
    global _unlimited
    _unlimited = limit_memory(memory)


_unlimited: Callable[[], None] = lambda: None  # noqa: E731 ends this worker's limit of memory


def _do(
    work: Callable[[Any], Any], job: Any, alone: bool, memory: float | None
) -> tuple[int, str, Any]:
    """Do a job; returns the process, how it ended, and the result or why there is none."""
    os.ftruncate(2, 0)
    try:
        return os.getpid(), DONE, work(job)
    except MemoryError as error:
        if not alone:
            os._exit(1)  # who knows in which state this process is
        _unlimited()  # or there may be no memory to say so
        most = "there is" if memory is None else f"{memory:g} GiB"
        text = f" ({printable(str(error))})" if str(error) else ""
        return os.getpid(), TOO_LARGE, f"it took more memory than {most}{text}"
