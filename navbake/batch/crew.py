"""Worker processes that do jobs, each of which may hang, crash or take too much memory.

The parent gives each worker a job and watches it. A worker that takes too long is killed, one that
died is replaced, so a job costs at most itself. Workers stay for many jobs: starting one takes as
long as many bakes. Where jobs are short, a worker has the next one before it is done with its own,
so that it need not wait for the parent.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import tempfile
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NamedTuple

from navbake.errors import NavbakeError, printable
from navbake.files import create_temporary
from navbake.processes import end_with_parent, ending_of, limit_memory

START_SECONDS = 300.0  # what a worker may take until it is ready; machines are busy
MOST_FAILED_STARTS = 3  # in a row, before the crew gives up
TICK = 1.0  # the longest wait, so that this process notices when it was stopped [s]
LATE = 1.0  # how much longer a wait takes only where this process was stopped [s]
PAUSE = 0.5  # after which this process hears of a SIGTERM that its whole group was sent [s]
SHORT = 0.25  # what a worker's last job took at most, if the next is given to it ahead [s]
MOST_AHEAD = 4096  # bytes of such a job: what any system's pipe takes while nobody reads it
NO_START = "cannot start a worker process"
MOST_TEXT = 200  # of what a worker wrote on stderr, characters
READY, DONE, CRASHED, TOO_LONG, TOO_LARGE = "ready", "done", "crashed", "too long", "too large"
BEGUN, AGAIN, LOST = "begun", "again", "lost"  # what happens besides, see `Event`
TAKEN = "taken"  # what a worker says when its first job has reached it


class JobLimits(NamedTuple):
    """What one job may take.

    Attributes:
        seconds: time [s]; None for no limit.
        memory: what its process may reserve beyond what it starts with [GiB]; None for no limit.
            Kept on Linux only.
    """

    seconds: float | None = None
    memory: float | None = None


class Ended(NamedTuple):
    """How a job ended.

    Attributes:
        number: the job's place among the jobs.
        how: ``done``, ``crashed``, ``too long`` or ``too large``.
        value: what the work returned, if it is done; else why it isn't.
        seconds: how long it took, at the last try.
    """

    number: int
    how: str
    value: Any
    seconds: float


class Event(NamedTuple):
    """What happens to workers and jobs, besides that jobs end.

    Attributes:
        what: ``ready``, a worker waits for its first job; ``begun``, it was given a job; ``lost``,
            it is gone; or ``again``, the job that it had will be given to another.
        worker: which one, from 1; one that replaces another has a number of its own.
        number: the job's place among the jobs; None where the worker has none.
        how: as `Ended` has it, of a worker that is gone.
        why: in words, likewise.
        seconds: how long the worker took to start, or was at the job that it lost.
    """

    what: str
    worker: int
    number: int | None = None
    how: str = ""
    why: str = ""
    seconds: float = 0.0


def _ignore(event: Event) -> None:
    """What hears of events where nobody wants to."""


class _Task:
    """A job, and how often it was tried."""

    def __init__(self, number: int, job: Any) -> None:
        self.number, self.job, self.tries = number, job, 0

    @cached_property
    def packed(self) -> bytes:
        """The job, as it goes through a pipe."""
        return pickle.dumps(self.job)


class _Worker:
    """A worker process, seen from the parent."""

    def __init__(self, number: int, work: bytes, limits: JobLimits) -> None:
        self.number = number
        context = multiprocessing.get_context("spawn")
        self.connection, self._theirs = context.Pipe()
        self._stderr, self._stderr_path = create_temporary(Path(tempfile.gettempdir()), 0o600)
        given = (self._theirs, work, limits.memory, os.getpid(), str(self._stderr_path))
        self.process = context.Process(target=_serve, args=given, daemon=True)
        self.is_ready = False
        self.has_taken = False  # whether it has ever taken a job
        self.is_used = False  # whether it has done a job
        self.is_quick = False  # whether the last one was short
        self.tasks: deque[_Task] = deque()  # it is at the first; another one was given ahead
        self.begun = time.monotonic()

    def start(self) -> None:
        with _signals_wait():
            self.process.start()
        self._theirs.close()

    @property
    def task(self) -> _Task | None:
        """What it does now."""
        return self.tasks[0] if self.tasks else None

    def give(self, task: _Task) -> None:
        """Give it a task, which it begins when it is done with its own."""
        if not self.tasks:
            self.begun = time.monotonic()
        self.tasks.append(task)
        self.connection.send_bytes(task.packed)

    def take_back(self) -> None:
        """Note that it is done with its task."""
        self.tasks.popleft()
        self.is_used, self.is_quick = True, self.age < SHORT
        self.begun = time.monotonic()

    @property
    def age(self) -> float:
        """How long it is at its task, or at starting [s]."""
        return time.monotonic() - self.begun

    def kill(self) -> None:
        """End the process, whatever state it is in."""
        if self.process.pid is not None:
            self.process.kill()
            self.process.join()
        self.connection.close()
        self._theirs.close()
        self._stderr.close()
        self.forget_stderr()

    def forget_stderr(self) -> None:
        """Remove the name of the file, which both have open, so that nothing can leave it behind.

        Windows removes it when the worker is gone. What this process leaves if it is killed before,
        the next batch removes: the file was locked, see `files.remove_leftovers`.
        """
        with suppress(OSError):
            os.unlink(self._stderr_path)

    def how_it_ended(self) -> str:
        """Why its process is gone."""
        self.process.join(PAUSE)
        status = self.process.exitcode
        if status is None:
            return "it closed its connection"
        if status == -signal.SIGTERM:
            time.sleep(PAUSE)  # if this process was sent one, too, that ends the batch here
        text = self._last_line()
        how = f"{'with' if status >= 0 else 'by'} {ending_of(status)}"
        return f"its process ended {how}{f': {text}' if text else ''}"

    def _last_line(self) -> str:
        """The last line that it wrote on stderr during its task, where libraries say why."""
        size = self._stderr.seek(0, os.SEEK_END)
        self._stderr.seek(max(0, size - 16 * MOST_TEXT))
        text = self._stderr.read(16 * MOST_TEXT).decode(errors="replace")
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return printable(lines[-1][:MOST_TEXT]) if lines else ""


def do_jobs(
    jobs: Sequence[Any],
    work: Callable[[Any], Any],
    count: int,
    *,
    limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
    retries: int = 0,
    prepare: Callable[[], None] | None = None,
    on_event: Callable[[Event], None] = _ignore,
) -> Generator[Ended, None, None]:
    """Do jobs in worker processes, and yield how each ended, in the order in which they end.

    A job is blamed for a crash, or for taking too much memory, only where its worker had done none
    before it: else it is given to a new worker, as what another job left behind may be the cause.

    Args:
        jobs: what `work` is called with; can be pickled.
        work: a function of a module, which returns what can be pickled.
        count: how many workers, >= 1.
        limits: of each job.
        retries: how often a job that crashed, or took too long or too much, is tried again.
        prepare: a function of a module that each worker calls before its first job.
        on_event: is called in this process with what happens meanwhile.

    Raises:
        NavbakeError: no worker starts, or none comes to begin a job.

    The workers are gone when the iterator is closed, or at the end.
    """
    crew = _Crew(jobs, pickle.dumps((work, prepare)), count, limits, retries, on_event)
    try:
        yield from crew.run()
    finally:
        crew.end()


class SingleWorker:
    """One worker process, which does jobs that come one after another.

    Limits, crashes and retries are those of `do_jobs`, whose arguments it takes.
    """

    def __init__(
        self,
        work: Callable[[Any], Any],
        limits: JobLimits,
        retries: int,
        prepare: Callable[[], None] | None,
    ) -> None:
        self._crew = _Crew([], pickle.dumps((work, prepare)), 1, limits, retries, _ignore)

    def do(self, number: int, job: Any) -> Ended:
        """Do a job; the process is started if there is none.

        Raises:
            NavbakeError: no process starts, or none comes to begin the job.
        """
        self._crew.add(_Task(number, job))
        (ended,) = self._crew.run()
        return ended

    def end(self) -> None:
        """End the process."""
        self._crew.end()


class _Crew:
    """The workers, and the tasks that are left."""

    def __init__(
        self,
        jobs: Sequence[Any],
        work: bytes,
        count: int,
        limits: JobLimits,
        retries: int,
        on_event: Callable[[Event], None],
    ) -> None:
        self._work, self._count, self._limits, self._retries = work, count, limits, retries
        self._on_event = on_event
        self._num_started = 0
        self._left = deque(_Task(number, job) for number, job in enumerate(jobs))
        self._again: deque[_Task] = deque()  # of workers that are gone
        self._workers: list[_Worker] = []
        self._failed_starts = 0

    def add(self, task: _Task) -> None:
        self._left.append(task)

    def run(self) -> Iterator[Ended]:
        while self._hand_out():
            for worker in self._heard():
                yield from self._hear(worker)
            for worker in [*self._workers]:
                # one that has said something meanwhile is heard first
                if worker.age > self._allowed(worker) and not worker.connection.poll():
                    why = f"it took more than {self._allowed(worker):g} s"
                    yield from self._lose(worker, TOO_LONG, why)

    def end(self) -> None:
        for worker in self._workers:
            worker.kill()

    def _hand_out(self) -> bool:
        """Give tasks to workers that have none, and start workers; False if all is done."""
        for worker in [*self._workers]:
            if worker.is_ready and worker.task is None:
                self._give(worker)
        for worker in self._workers:
            if len(worker.tasks) == 1 and worker.is_quick:
                self._give_ahead(worker)
        waiting = len(self._left) + len(self._again)
        starting = sum(not worker.is_ready for worker in self._workers)
        while len(self._workers) < self._count and starting < waiting:
            if not self._start():
                break
            starting += 1
        return waiting > 0 or any(worker.task is not None for worker in self._workers)

    def _give(self, worker: _Worker) -> None:
        """Give a worker the next task; a used one makes room for a new one if that is needed."""
        waiting = self._again if self._again and not worker.is_used else self._left
        if not waiting:
            if self._again:
                self._remove(worker)
            return
        try:
            worker.give(waiting[0])
        except OSError:  # it died meanwhile
            worker.tasks.clear()
            self._lose_unbegun(worker, CRASHED, worker.how_it_ended())
            return
        self._on_event(Event(BEGUN, worker.number, waiting.popleft().number))

    def _give_ahead(self, worker: _Worker) -> None:
        """Give a worker that is at a task the next one, unless idle workers may soon want it."""
        if len(self._left) <= self._count or len(self._left[0].packed) > MOST_AHEAD:
            return
        try:
            worker.give(self._left[0])
        except OSError:  # it died at its task, which is heard of later
            worker.tasks.pop()
            return
        self._left.popleft()

    def _start(self) -> bool:
        """Start a worker; False if that must wait, while others work."""
        try:
            self._num_started += 1
            worker = _Worker(self._num_started, self._work, self._limits)
            self._workers.append(worker)  # before it starts: then `end` knows of it
            worker.start()
        except OSError as error:
            if self._workers and self._workers[-1].process.pid is None:
                self._remove(self._workers[-1])
            if any(worker.has_taken for worker in self._workers):
                return False
            self._count_failed_start(f"{NO_START}: {error.strerror}")
        return True

    def _remove(self, worker: _Worker) -> None:
        self._workers.remove(worker)
        worker.kill()

    def _heard(self) -> list[_Worker]:
        """The workers that have something to say; [] when one's time is up, or after a `TICK`."""
        by_connection: dict[Any, _Worker] = {w.connection: w for w in self._workers}
        left = [self._allowed(worker) - worker.age for worker in self._workers]
        timeout = min(max(0.0, min(left, default=PAUSE)), TICK)
        begin = time.monotonic()
        if not by_connection:
            time.sleep(timeout)
        ready = wait(list(by_connection), timeout)
        self._forgive(time.monotonic() - begin - timeout)
        return [by_connection[connection] for connection in ready]

    def _forgive(self, late: float) -> None:
        """Let time not count in which this process was stopped: its workers were, too.

        That is so after Ctrl-Z, where a container is frozen, and where a machine sleeps.

        Args:
            late: how much longer a wait took than it was to [s].
        """
        if late > LATE:
            for worker in self._workers:
                worker.begun += late

    def _allowed(self, worker: _Worker) -> float:
        """How long a worker may take for what it does now [s]."""
        if not worker.is_ready:
            return START_SECONDS
        if worker.task is None or self._limits.seconds is None:
            return float("inf")
        return self._limits.seconds

    def _hear(self, worker: _Worker) -> Iterator[Ended]:
        try:
            message = worker.connection.recv_bytes()
        except (EOFError, OSError):
            yield from self._lose(worker, CRASHED, worker.how_it_ended())
            return
        try:
            how, value = pickle.loads(message)
        except Exception as error:  # bytes of a process in any state raise anything
            why = f"what it answered can't be read: {_last_line(error)}"
            yield from self._lose(worker, CRASHED, why)
            return
        if how == READY:
            worker.is_ready = True
            worker.forget_stderr()
            self._on_event(Event(READY, worker.number, seconds=worker.age))
        elif how == TAKEN:
            worker.has_taken = True
        elif how == DONE and worker.task is not None:
            ended = Ended(worker.task.number, DONE, value, worker.age)
            worker.take_back()
            self._failed_starts = 0
            yield ended
            if worker.task is not None:  # it was given one ahead
                self._on_event(Event(BEGUN, worker.number, worker.task.number))
        elif how in (CRASHED, TOO_LARGE):
            yield from self._lose(worker, how, value)
        else:
            why = f"it answered {printable(repr(how))[:MOST_TEXT]}"
            yield from self._lose(worker, CRASHED, why)

    def _lose(self, worker: _Worker, how: str, why: str) -> Iterator[Ended]:
        """Replace a worker, and see what becomes of its task; one given ahead was not begun."""
        if worker.task is None or (how == CRASHED and not worker.has_taken):
            self._lose_unbegun(worker, how, why)
            return
        seconds, (task, *ahead) = worker.age, worker.tasks
        self._remove(worker)
        lost = Event(LOST, worker.number, task.number, how, why, seconds)
        self._on_event(lost)
        self._left.extendleft(ahead)
        self._failed_starts = 0
        if worker.is_used and how != TOO_LONG:
            self._again.append(task)
            self._on_event(lost._replace(what=AGAIN))
            return
        task.tries += 1
        if task.tries <= self._retries:
            self._again.append(task)
            self._on_event(lost._replace(what=AGAIN))
        else:
            yield Ended(task.number, how, why, seconds)

    def _lose_unbegun(self, worker: _Worker, how: str, why: str) -> None:
        """Replace a worker that has no task, or did not begin the one that it has."""
        seconds, task = worker.age, worker.task
        self._remove(worker)
        lost = Event(LOST, worker.number, None if task is None else task.number, how, why, seconds)
        self._on_event(lost)
        if task is not None:
            self._left.appendleft(task)
            self._on_event(lost._replace(what=AGAIN))
        if not worker.has_taken:
            what = "worker processes end before they begin a scene"
            self._count_failed_start(f"{what}: {why}" if worker.is_ready else f"{NO_START}: {why}")

    def _count_failed_start(self, why: str) -> None:
        """Count workers that did nothing, and give up after several in a row."""
        self._failed_starts += 1
        if self._failed_starts >= MOST_FAILED_STARTS:
            raise NavbakeError(why)


@contextmanager
def _signals_wait() -> Iterator[None]:
    """Let signals wait: a process that starts inside hears of none until it is ready for them.

    Without it, Ctrl-C prints the traceback of each worker that is still importing modules.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    from multiprocessing import resource_tracker  # Windows has none

    resource_tracker.ensure_running()  # its start would let the signals through
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# ---------------------------------------------------------------- in the worker


def _serve(
    connection: Connection, work: bytes, memory: float | None, parent: int, stderr: str
) -> None:
    """What a worker does: jobs, one after another, until the parent is gone."""
    _settle(parent, stderr)
    try:
        do, prepare = pickle.loads(work)
        if prepare is not None:
            prepare()
        unlimited = limit_memory(memory)
    except BaseException as error:
        connection.send((CRASHED, _last_line(error)))
        return
    connection.send((READY, None))
    has_taken = False
    while True:
        try:
            packed = connection.recv_bytes()
        except EOFError:
            return
        if not has_taken:  # else it is known to be able to
            connection.send((TAKEN, None))
            has_taken = True
        os.ftruncate(2, 0)
        try:
            answer = DONE, do(pickle.loads(packed))
        except MemoryError as error:
            unlimited()  # or there may be no memory to say so
            most = "there is" if memory is None else f"{memory:g} GiB"
            answer = TOO_LARGE, f"it took more memory than {most}{_in_brackets(error)}"
        except Exception as error:
            answer = CRASHED, _last_line(error)
        connection.send(answer)
        if answer[0] != DONE:
            return  # who knows in which state this process is


def _settle(parent: int, stderr: str) -> None:
    """Leave Ctrl-C, the terminal and the end of the parent to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears of it and ends its workers
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    end_with_parent(parent)
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    os.dup2(os.open(stderr, os.O_WRONLY | os.O_APPEND), 2)


def _last_line(error: BaseException) -> str:
    return printable(traceback.format_exception_only(error)[-1].strip())


def _in_brackets(error: BaseException) -> str:
    return f" ({printable(str(error))})" if str(error) else ""
