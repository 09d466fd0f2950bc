"""Does jobs that may hang, crash or take too much memory, in worker processes.

They are on this machine, or on a Ray cluster: there each job is a Ray task with a worker of its
own, with the same limits, retries and reasons. Ray repeats a task whose node is lost.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, TimeoutError, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pebble import ProcessExpired, ProcessPool

from navbake._version import __version__
from navbake.errors import NavbakeError, printable
from navbake.files import scratch_folder
from navbake.formats.source import import_extra
from navbake.processes import end_with_parent, ending_of, limit_memory

POLL_INTERVAL = 0.5  # interval at which the parent looks for begun jobs [s]
MAX_OVERSLEEP = 1.0  # excess of a wait that shows that this process was stopped [s]
JOBS_PER_WORKER = 3  # submitted jobs per worker, so that none waits for the parent
MAX_BROKEN_POOLS = 3  # of consecutive pools without a finished job, before an error
MAX_STDERR_TEXT = 200  # characters of a worker's stderr
DONE = "done"
CRASHED = "crashed"
TOO_LONG = "too long"
TOO_LARGE = "too large"
# events besides the ends of jobs
SCENE_BEGUN = "scene-begin"
RETRIED = "retry"
# of a cluster
MAX_RAY_RETRIES = 3  # retries of a task whose node or process was lost
CLUSTER_CHECK_INTERVAL = 5.0  # between checks of the cluster's size [s]
CONNECTION_TIMEOUT = 10.0  # for a connection to a cluster [s]
OBJECT_STORE_SIZE = 80 << 20  # of the object store in a cluster of one's own [bytes]
# Read by Ray as it is imported: its processes listen on the loopback device only, and send no usage
# statistics.
RAY_ENVIRONMENT = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}

Job = TypeVar("Job")
Result = TypeVar("Result")


class JobLimits(NamedTuple):
    """The limits of time and memory of one job, and how often it is retried."""

    seconds: float | None = None  #: Time [s]; None for no limit.
    #: Beyond the process's own at its start [GiB]; None for no limit. On Linux only.
    memory: float | None = None
    retries: int = 0  #: Of a job that crashed or exceeded a limit.


class Ended(NamedTuple):
    """The end of a job, or of an attempt at it."""

    number: int  #: The job's place among the jobs.
    how: str  #: ``done``, ``crashed``, ``too long`` or ``too large``.
    value: Any  #: The job's result, of any type, if it is done; else the reason.
    seconds: float = 0.0  #: Duration of the last attempt.
    worker: int = 0  #: The id of its process, 0 if unknown.


OnEvent = Callable[[str, Ended], None]


def do_jobs(
    jobs: Sequence[Any],
    work: Callable[[Any], Any],
    count: int,
    *,
    on_event: OnEvent = lambda event, ended: None,
    **options: Any,
) -> Generator[Ended, None, None]:
    """Run jobs in at most `count` worker processes; see `Workers` for the arguments and errors.

    The workers end when the iterator is closed or exhausted.
    """
    with Workers(work, min(count, len(jobs)), **options) as workers:
        yield from workers.do(jobs, on_event)


class Workers:
    """Worker processes, started on demand and kept for many jobs."""

    def __init__(
        self,
        work: Callable[[Any], Any],
        count: int,
        *,
        limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
        prepare: Callable[[], None] | None = None,
    ) -> None:
        """Set up `count` workers, >= 1, that call `work` for each job.

        `work` is a module's function with a picklable result. `limits` apply to each job. Each
        worker calls `prepare`, a module's function, before its first job.
        """
        self._work = work
        self._count = count
        self._limits = limits
        self._prepare = prepare
        self._closing = ExitStack()
        self._pool: ProcessPool | None = None

    def __enter__(self) -> Workers:
        # temporary files, and each worker's stderr by its id
        self._folder = self._closing.enter_context(scratch_folder())
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
        self._closing.close()

    def do(self, jobs: Sequence[Any], on_event: OnEvent) -> Iterator[Ended]:
        """Run picklable jobs, and yield their results in the order of completion.

        `on_event` is called when a job begins, and when it will be retried. A job that crashed its
        worker, or took too much memory, is retried after the other jobs, in a process of its own,
        in case an earlier job in the process was the cause. Raises a NavbakeError if no worker
        starts.
        """
        num_failures = [0] * len(jobs)
        num_breaks = 0  # of the pool, in a row
        alone = False
        waiting = deque(range(len(jobs)))
        retried = deque[int]()
        while waiting:
            for ended in self._in_pool(jobs, waiting, alone, on_event):
                num_breaks = 0
                is_to_blame = alone or ended.how == TOO_LONG
                num_failures[ended.number] += is_to_blame and ended.how != DONE
                if ended.how == DONE or num_failures[ended.number] > self._limits.retries:
                    yield ended
                else:
                    on_event(RETRIED, ended)
                    retried.append(ended.number)
            if waiting or retried or alone:
                self._stop()
            if waiting:
                num_breaks += 1
            else:
                waiting = retried
                retried = deque()
                alone = True
            if num_breaks == MAX_BROKEN_POOLS:
                reason = self._last_words(None)
                details = f": {reason}" if reason else ""
                raise NavbakeError(f"cannot start a worker process{details}")

    def _stop(self) -> None:
        if self._pool is not None:
            self._pool.stop()  # type: ignore[no-untyped-call]
            self._pool.join()
            self._pool = None

    def _in_pool(
        self, jobs: Sequence[Any], waiting: deque[int], alone: bool, on_event: OnEvent
    ) -> Iterator[Ended]:
        """Do the waiting jobs in a pool until all are done, or it breaks.

        Unfinished jobs of a pool that breaks go back to `waiting`. If `alone`, each job has a new
        process.
        """
        if self._pool is None:
            self._pool = ProcessPool(
                max_workers=min(self._count, len(waiting)) if alone else self._count,
                max_tasks=1 if alone else 0,
                initializer=_settle,
                initargs=(os.getpid(), self._folder, self._limits.memory, self._prepare),
                context=get_context("spawn"),
            )
        number_of: dict[Future[Any], int] = {}
        begun: dict[Future[Any], float] = {}
        limit = self._limits.seconds
        seconds = None if limit == float("inf") else limit
        excused: set[Future[Any]] = set()  # not late: this process, and so its workers, was stopped
        while waiting or number_of:
            while waiting and len(number_of) < JOBS_PER_WORKER * self._count:
                arguments = (self._work, jobs[waiting[0]], alone, self._limits.memory)
                try:
                    with _ctrl_c_waits():  # the first one starts the workers
                        future: Future[Any] = self._pool.schedule(_do, arguments, timeout=seconds)
                except RuntimeError:  # it is broken
                    waiting.extendleft(number_of.values())
                    return
                number_of[future] = waiting.popleft()
            before = time.time()  # the pool's clock
            done, _ = wait(number_of, POLL_INTERVAL, FIRST_COMPLETED)
            if time.time() - before > POLL_INTERVAL + MAX_OVERSLEEP:
                excused.update(number_of)
            for future in number_of.keys() - begun.keys():
                if future.running() or future in done:
                    begun[future] = before
                    on_event(SCENE_BEGUN, Ended(number_of[future], "", ""))
            for future in done:
                number = number_of.pop(future)
                duration = time.time() - begun.pop(future)
                error = future.exception()
                if isinstance(error, BrokenProcessPool):
                    waiting.extendleft([number, *number_of.values()])
                    return
                if isinstance(error, TimeoutError) and future in excused:
                    waiting.append(number)
                else:
                    yield self._ended(number, future, error, duration)

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
        """The last line of stderr of a worker, or of any, where libraries print reasons."""
        text = b""
        with suppress(OSError):
            for path in self._folder.glob(str(pid or "[0-9]*")):
                text = path.read_bytes()[-16 * MAX_STDERR_TEXT :] or text
        lines = [line.strip() for line in text.decode(errors="replace").splitlines()]
        return printable(next((line for line in reversed(lines) if line), "")[:MAX_STDERR_TEXT])


@contextmanager
def _ctrl_c_waits() -> Iterator[None]:
    """Block Ctrl-C inside; processes and threads that start inside keep it blocked.

    Without it, Ctrl-C prints the traceback of each worker that is still importing modules.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    from multiprocessing import resource_tracker  # Windows has none

    resource_tracker.ensure_running()  # its start would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# ---------------------------------------------------------------- in the worker


def _settle(
    parent: int, folder: Path, memory: float | None, prepare: Callable[[], None] | None
) -> None:
    """Prepare a worker: signals, terminal, end with the parent, and memory limit."""
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
    tempfile.tempdir = str(folder)  # removed after a killed worker
    if prepare is not None:
        prepare()
    global _unlimited
    _unlimited = limit_memory(memory)


_unlimited: Callable[[], None] = lambda: None  # noqa: E731 ends this worker's limit of memory


def _do(
    work: Callable[[Job], Result], job: Job, alone: bool, memory: float | None
) -> tuple[int, str, Result | str]:
    """Do a job; return the process, how it ended, and the result or the reason."""
    os.ftruncate(2, 0)
    try:
        return os.getpid(), DONE, work(job)
    except MemoryError as error:
        if not alone:
            os._exit(1)  # its state is unknown
        _unlimited()  # the message needs memory
        most = "there is" if memory is None else f"{memory:g} GiB"
        text = f" ({printable(str(error))})" if str(error) else ""
        return os.getpid(), TOO_LARGE, f"it took more memory than {most}{text}"


# ---------------------------------------------------------------- on a Ray cluster


def do_on_ray(
    jobs: Sequence[Any],
    work: Callable[[Any], Any],
    count: int | None,
    *,
    address: str | None,
    witness: Path | None = None,
    limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
    prepare: Callable[[], None] | None = None,
    on_event: OnEvent = lambda event, ended: None,
) -> Generator[Ended, None, None]:
    """Run jobs on a Ray cluster, as `do_jobs` does on one machine.

    All nodes must be able to import `work`; see `Workers` for the arguments that aren't listed
    here.

    Args:
        count: the largest number of tasks at once; None for the cluster's number of CPUs. More
            tasks than CPUs are requested, so that an autoscaling cluster grows.
        address: the cluster's address; ``local`` starts a cluster on this machine's loopback device
            for the batch; None for ``RAY_ADDRESS``, else ``local``.
        witness: a file in the output folder, by which each node checks that it sees the folder;
            None for no such check.

    Raises:
        NavbakeError: there is no cluster, a node can't do the jobs, or ray isn't installed.
    """
    if not jobs:
        return
    seen = None if witness is None else os.path.abspath(witness)
    enter = partial(_enter_node, os.getcwd(), seen, __version__)
    make = partial(Workers, work, 1, limits=limits, prepare=prepare)
    with _connected(address, min(count or os.cpu_count() or 1, len(jobs))) as ray:
        do = ray.remote(num_cpus=1, max_retries=MAX_RAY_RETRIES, scheduling_strategy="SPREAD")(
            _do_task
        )
        shared = ray.put((enter, make))
        numbers = iter(range(len(jobs)))
        number_of = dict[Any, int]()
        while True:
            # twice the CPUs: no node waits for this process
            most = count or 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))
            while len(number_of) < most and (number := next(numbers, None)) is not None:
                number_of[do.remote(shared, number, jobs[number])] = number
                on_event(SCENE_BEGUN, Ended(number, "", ""))
            if not number_of:
                return
            for task in ray.wait([*number_of], timeout=CLUSTER_CHECK_INTERVAL)[0]:
                number = number_of.pop(task)
                try:
                    ended, tries = ray.get(task)
                except ray.exceptions.RayTaskError as error:
                    raise NavbakeError(_last_line(error.cause or error)) from error
                except ray.exceptions.RayError as error:
                    why = f"it was lost {MAX_RAY_RETRIES + 1} times, as {_last_line(error)}"
                    ended = Ended(number, CRASHED, why)
                    tries = []
                for each in tries:
                    on_event(RETRIED, each)
                yield ended


def _enter_node(folder: str, witness: str | None, version: str) -> None:
    """Enter the batch's current folder on a node, which has to see its files."""
    why = None
    if version != __version__:
        why = f"it has navbake {__version__}, and the batch is one of {version}"
    elif not os.path.isdir(folder):
        why = f"it lacks {folder}: run the batch in a folder that all nodes have"
    elif witness is not None and not os.path.exists(witness):
        why = f"it lacks {witness}: write into a folder that all nodes share"
    if why is not None:
        node = socket.gethostname()
        raise NavbakeError(printable(f"no worker can work on node {node}: {why}"))
    os.chdir(folder)


def _do_task(
    shared: tuple[Callable[[], None], Callable[[], Workers]], number: int, job: object
) -> tuple[Ended, list[Ended]]:
    """Do a job on a node; returns how it ended, and earlier failed attempts."""
    enter, make = shared
    enter()
    # else each process started here imports Ray's main module first
    vars(sys.modules["__main__"]).pop("__file__", None)
    global _workers
    if _workers is None:
        _workers = make().__enter__()
    tries: list[Ended] = []
    (ended,) = _workers.do([job], lambda event, each: tries.extend([each] * (event == RETRIED)))
    return ended._replace(number=number), [each._replace(number=number) for each in tries]


_workers: Workers | None = None  # kept for all tasks of a batch in this Ray process


@contextmanager
def _connected(address: str | None, num_cpus: int) -> Iterator[Any]:
    """Connect to a Ray cluster inside; an existing connection is kept."""
    address = address or os.environ.get("RAY_ADDRESS") or "local"
    is_own = address == "local"
    if is_own:
        for name, value in RAY_ENVIRONMENT.items():
            os.environ.setdefault(name, value)
    ray = import_extra("ray", "ray", "--executor ray")
    if ray.is_initialized():
        yield ray
        return
    _check_reachable(address)
    handler = signal.getsignal(signal.SIGTERM)
    with scratch_folder(Path("/tmp")) if is_own else nullcontext() as folder:
        local_options = {
            "num_cpus": num_cpus,
            "include_dashboard": False,
            "object_store_memory": OBJECT_STORE_SIZE,
            "_temp_dir": str(folder),
        }
        options = local_options if is_own else {}
        try:
            ray.init(address=address, logging_level="ERROR", log_to_driver=False, **options)
        except Exception as error:  # of many kinds
            what = "start a Ray cluster" if is_own else f"connect to a Ray cluster at {address}"
            raise NavbakeError(f"cannot {what}: {' '.join(str(error).split())[:300]}") from error
        finally:
            if threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGTERM, handler)  # Ray's own ends this process at once
        try:
            yield ray
        finally:
            with suppress(Exception):
                ray.shutdown()


def _check_reachable(address: str) -> None:
    """Fail at once if nobody listens at an address, which takes Ray minutes."""
    host, _, port = address.rpartition(":")
    if "/" in address or not port.isdigit():
        return  # looked up by Ray, as "auto"
    try:
        with socket.create_connection((host.strip("[]"), int(port)), CONNECTION_TIMEOUT):
            pass
    except (OSError, OverflowError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise NavbakeError(f"cannot connect to a Ray cluster at {address}: {why}") from error


def _last_line(error: BaseException) -> str:
    """Ray's reason for a lost task: the first sentence of the message's last line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return printable((lines or [type(error).__name__])[-1].partition(". ")[0][:200])
