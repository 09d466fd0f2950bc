"""Runs jobs that may hang, crash or take too much memory, in worker processes.

The workers run on this machine or on a Ray cluster. On a cluster, each job is a Ray task with a
worker process of its own; limits, retries and the reasons of failures are the same. Ray repeats a
task if it loses the node.
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
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple, TypeVar

from pebble import ProcessExpired, ProcessPool

from navbake._version import __version__
from navbake.errors import NavbakeError, printable
from navbake.files import scratch_folder
from navbake.formats.source import import_extra
from navbake.processes import describe_exit, end_with_parent, limit_memory

POLL_INTERVAL = 0.5  # how often the parent checks which jobs have begun [s]
# A wait that lasts this much longer than `POLL_INTERVAL` shows that this process was suspended [s].
MAX_OVERSLEEP = 1.0
JOBS_PER_WORKER = 3  # jobs submitted ahead for each worker, so that no worker waits for the parent
# an error is raised after this many pools in a row broke before any job was done
MAX_BROKEN_POOLS = 3
MAX_STDERR_TEXT = 200  # characters of a worker's stderr that are quoted in a reason
# how a job ended
DONE = "done"
CRASHED = "crashed"
TOO_LONG = "too long"
TOO_LARGE = "too large"
# events that `on_event` receives
SCENE_BEGUN = "scene-begin"
RETRIED = "retry"
# settings of a Ray cluster
MAX_RAY_RETRIES = 3  # how often a task is retried whose node or process was lost
CLUSTER_CHECK_INTERVAL = 5.0  # how often the cluster's number of CPUs is read [s]
CONNECTION_TIMEOUT = 10.0  # longest wait for a connection to a cluster [s]
OBJECT_STORE_SIZE = 80 << 20  # object store of a cluster that is started here [bytes]
# Ray reads these when it is imported. With them, its processes listen on the loopback device only,
# and send no usage statistics.
RAY_ENVIRONMENT = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}

AnyJob = TypeVar("AnyJob")


class JobLimits(NamedTuple):
    """The time and memory that one job may take, and how often it is retried."""

    seconds: float | None = None  #: Time for one attempt [s]; None for no limit.
    #: Memory in addition to what the process has at its start [GiB]; None for no limit. Linux only.
    memory: float | None = None
    retries: int = 0  #: How often a job is retried that crashed or exceeded a limit.


class JobEnd(NamedTuple):
    """The end of a job or of one attempt at it, with its result or the reason of its failure."""

    number: int  #: The job's index in the sequence of jobs.
    how: str  #: ``done``, ``crashed``, ``too long`` or ``too large``; empty if it has just begun.
    result: Any = None  #: What the job returned, if it is done.
    reason: str = ""  #: Why it failed, if it did.
    seconds: float = 0.0  #: Duration of the last attempt [s].
    worker: int = 0  #: The process id of its worker, 0 if unknown.


OnJobEvent = Callable[[str, JobEnd], None]
"""A function that is called with `SCENE_BEGUN` when a job begins, with `RETRIED` before a retry."""


class _RecordingContext(SpawnContext):
    """Starts processes anew, as `multiprocessing` does by ``spawn``, and remembers them."""

    def __init__(self) -> None:
        super().__init__()
        self._processes: list[SpawnProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]
        """Make a process that isn't started yet, as `multiprocessing.Process` does."""
        process = SpawnProcess(*args, **kwargs)
        self._processes.append(process)
        return process

    def end_processes(self) -> None:
        """End all processes that are running, and forget all."""
        for process in self._processes:
            if process.pid is not None:  # it is started
                process.terminate()
        self._processes.clear()


class Workers:
    """Worker processes for many jobs: started by the first job, stopped by the with statement."""

    def __init__(
        self,
        work: Callable[[Any], Any],
        num_workers: int,
        *,
        limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
        prepare: Callable[[], None] | None = None,
    ) -> None:
        """Set up the workers; none is started yet.

        Args:
            work: a function at module level that does one job; its result must be picklable.
            num_workers: number of worker processes, >= 1.
            limits: the limits of each job.
            prepare: a function at module level that each worker calls before its first job.
        """
        self._work = work
        self._count = num_workers
        self._limits = limits
        self._prepare = prepare
        self._closing = ExitStack()
        self._pool: ProcessPool | None = None
        self._context = _RecordingContext()

    def __enter__(self) -> Workers:
        # for the workers' temporary files, and each worker's stderr in a file named by its pid
        self._folder = self._closing.enter_context(scratch_folder())
        return self

    def __exit__(self, *_: object) -> None:
        self._stop_pool()
        self._closing.close()

    def run(
        self, jobs: Sequence[Any], on_event: OnJobEvent = lambda event, job_end: None
    ) -> Generator[JobEnd, None, None]:
        """Run jobs, and yield the end of each as it ends.

        Each job has ``limits.retries + 1`` attempts. A job that crashed its worker or took too much
        memory is run again after all other jobs, in a process of its own: an earlier job in the
        same process may have been the cause, so this first failure doesn't count as an attempt. A
        job that took too long has used up an attempt.

        Args:
            jobs: the jobs, which must be picklable.
            on_event: is called when a job begins, and when it will be run again.

        Yields:
            The end of each job, in the order in which the jobs end.

        Raises:
            NavbakeError: no worker process starts.
        """
        num_failures_of_job = [0] * len(jobs)
        num_broken_pools = 0  # in a row
        is_isolated = False  # whether each job has a process of its own
        waiting_job_numbers = deque(range(len(jobs)))
        failed_job_numbers = deque[int]()
        while waiting_job_numbers:
            for job_end in self._run_in_pool(jobs, waiting_job_numbers, is_isolated, on_event):
                num_broken_pools = 0
                if job_end.how != DONE and (is_isolated or job_end.how == TOO_LONG):
                    num_failures_of_job[job_end.number] += 1
                if (
                    job_end.how == DONE
                    or num_failures_of_job[job_end.number] > self._limits.retries
                ):
                    yield job_end
                else:
                    on_event(RETRIED, job_end)
                    failed_job_numbers.append(job_end.number)
            if waiting_job_numbers or failed_job_numbers or is_isolated:
                self._stop_pool()
            if waiting_job_numbers:  # the pool broke
                num_broken_pools += 1
            else:
                waiting_job_numbers = failed_job_numbers
                failed_job_numbers = deque()
                is_isolated = True
            if num_broken_pools == MAX_BROKEN_POOLS:
                reason = self._last_stderr_line(None)
                details = f": {reason}" if reason else ""
                raise NavbakeError(f"cannot start a worker process{details}")

    def _stop_pool(self) -> None:
        if self._pool is not None:
            self._pool.stop()  # type: ignore[no-untyped-call]
            # The pool closes its channels before it ends its workers. One that is still starting
            # would print a traceback when it finds them closed.
            self._context.end_processes()
            self._pool.join()
            self._pool = None

    def _start_pool(self, num_jobs: int, is_isolated: bool) -> ProcessPool:
        """Make a pool; its workers start with its first job."""
        return ProcessPool(
            max_workers=min(self._count, num_jobs) if is_isolated else self._count,
            max_tasks=1 if is_isolated else 0,
            initializer=_set_up_worker,
            initargs=(os.getpid(), self._folder, self._limits.memory, self._prepare),
            context=self._context,
        )

    def _run_in_pool(
        self,
        jobs: Sequence[Any],
        waiting_job_numbers: deque[int],
        is_isolated: bool,
        on_event: OnJobEvent,
    ) -> Iterator[JobEnd]:
        """Run the waiting jobs in a pool until all have ended, or the pool breaks.

        Args:
            jobs: all jobs.
            waiting_job_numbers: the indices of the jobs to run. They are taken out when they are
                submitted; if the pool breaks, unfinished jobs are put back.
            is_isolated: whether each job gets a new process.
            on_event: is called when a job begins.

        Yields:
            The end of each job that ended.
        """
        if self._pool is None:
            self._pool = self._start_pool(len(waiting_job_numbers), is_isolated)
        number_of_future: dict[Future[Any], int] = {}  # of submitted jobs
        begin_time_of_future: dict[Future[Any], float] = {}  # by the pool's clock [s]
        time_limit = self._limits.seconds
        timeout = None if time_limit == float("inf") else time_limit
        # While this process was suspended, its workers were, too: these jobs took no longer.
        suspended_futures: set[Future[Any]] = set()
        while waiting_job_numbers or number_of_future:
            while waiting_job_numbers and len(number_of_future) < JOBS_PER_WORKER * self._count:
                arguments = (
                    self._work,
                    jobs[waiting_job_numbers[0]],
                    is_isolated,
                    self._limits.memory,
                )
                try:
                    with _block_ctrl_c(), _defer_sigterm():  # the first job starts the workers
                        future: Future[Any] = self._pool.schedule(
                            _run_job, arguments, timeout=timeout
                        )
                except RuntimeError:  # the pool is broken
                    waiting_job_numbers.extendleft(number_of_future.values())
                    return
                number_of_future[future] = waiting_job_numbers.popleft()
            wait_begin = time.time()  # the pool's clock
            ended_futures, _ = wait(number_of_future, POLL_INTERVAL, FIRST_COMPLETED)
            if time.time() - wait_begin > POLL_INTERVAL + MAX_OVERSLEEP:
                suspended_futures.update(number_of_future)
            for future in number_of_future.keys() - begin_time_of_future.keys():
                if future.running() or future in ended_futures:
                    begin_time_of_future[future] = wait_begin
                    on_event(SCENE_BEGUN, JobEnd(number_of_future[future], how=""))
            for future in ended_futures:
                job_number = number_of_future.pop(future)
                duration = time.time() - begin_time_of_future.pop(future)
                error = future.exception()
                if isinstance(error, BrokenProcessPool):
                    waiting_job_numbers.extendleft([job_number, *number_of_future.values()])
                    return
                if isinstance(error, TimeoutError) and future in suspended_futures:
                    waiting_job_numbers.append(job_number)
                elif error is None:
                    job_end = future.result()
                    yield job_end._replace(number=job_number, seconds=duration)
                else:
                    yield self._describe_failure(job_number, error, duration)

    def _describe_failure(self, number: int, error: BaseException, seconds: float) -> JobEnd:
        """Describe the end of a job for which the pool reports an error.

        Args:
            number: the job's index.
            error: the pool's error.
            seconds: how long the job ran [s].
        """
        if isinstance(error, TimeoutError):
            reason = f"it took more than {self._limits.seconds:g} s"
            return JobEnd(number, TOO_LONG, reason=reason, seconds=seconds)
        if isinstance(error, ProcessExpired):
            preposition = "with" if error.exitcode >= 0 else "by"
            reason = f"its process ended {preposition} {describe_exit(error.exitcode)}"
            stderr_line = self._last_stderr_line(error.pid)
            if stderr_line:
                reason += f": {stderr_line}"
            return JobEnd(number, CRASHED, reason=reason, seconds=seconds, worker=error.pid)
        reason = printable(f"{type(error).__name__}: {error}".strip())
        return JobEnd(number, CRASHED, reason=reason, seconds=seconds)

    def _last_stderr_line(self, pid: int | None) -> str:
        """Return the last line that a worker wrote to stderr, where libraries print reasons.

        Args:
            pid: the worker's process id; None for any worker.
        """
        content = b""
        with suppress(OSError):
            for path in self._folder.glob(str(pid or "[0-9]*")):
                content = path.read_bytes()[-16 * MAX_STDERR_TEXT :] or content
        lines = [line.strip() for line in content.decode(errors="replace").splitlines()]
        return printable(next((line for line in reversed(lines) if line), "")[:MAX_STDERR_TEXT])


@contextmanager
def _block_ctrl_c() -> Iterator[None]:
    """Block Ctrl-C within the with statement; processes and threads started there keep it blocked.

    Without it, Ctrl-C prints the traceback of each worker that is still importing modules.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    from multiprocessing import resource_tracker  # Windows has none

    resource_tracker.ensure_running()  # its start would unblock the signal
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


@contextmanager
def _defer_sigterm() -> Iterator[None]:
    """Handle a SIGTERM that arrives within the with statement at its end.

    Otherwise the pool wouldn't know a worker that is just being started. The worker would not be
    ended, and would print a traceback when it finds that the pool is gone. SIGTERM isn't blocked,
    as processes started there would keep it blocked.
    """
    previous_handler = signal.getsignal(signal.SIGTERM)
    is_main_thread = threading.current_thread() is threading.main_thread()
    if not is_main_thread or previous_handler is None:  # a handler can't be set, or not set again
        yield
        return
    is_pending = False

    def remember_signal(signal_number: int, stack_frame: FrameType | None) -> None:
        nonlocal is_pending
        is_pending = True

    signal.signal(signal.SIGTERM, remember_signal)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous_handler)
        if is_pending:
            signal.raise_signal(signal.SIGTERM)


# ---------------------------------------------------------------- in the worker


def _set_up_worker(
    parent_pid: int,
    folder: Path,
    memory: float | None,
    prepare: Callable[[], None] | None,
) -> None:
    """Set up this worker process: its signals, streams, temporary folder and limit of memory.

    Args:
        parent_pid: the parent's process id; the worker ends when the parent ends.
        folder: gets the worker's temporary files, and its stderr in a file named by its process id.
        memory: how much memory the worker may take beyond what it has at its start [GiB]; None for
            no limit.
        prepare: is called before the limit is set; may be None.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    end_with_parent(parent_pid)
    null_device = os.open(os.devnull, os.O_RDWR)
    os.dup2(null_device, 0)
    os.dup2(null_device, 1)
    stderr_path = folder / str(os.getpid())
    stderr_file = os.open(stderr_path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
    os.dup2(stderr_file, 2)
    tempfile.tempdir = str(folder)  # the parent removes it, even if this worker is killed
    if prepare is not None:
        prepare()
    global _lift_memory_limit
    _lift_memory_limit = limit_memory(memory)


# takes this worker's limit of memory away
_lift_memory_limit: Callable[[], None] = lambda: None  # noqa: E731 as `limit_memory` returns one


def _run_job(
    work: Callable[[AnyJob], object], job: AnyJob, is_isolated: bool, memory: float | None
) -> JobEnd:
    """Do a job in this worker process.

    Args:
        work: does the job.
        job: the job.
        is_isolated: whether the process does this job only.
        memory: the limit of memory, for the reason [GiB].

    Returns:
        The end of the job; the worker doesn't know the job's number, and gives 0.
    """
    os.ftruncate(2, 0)
    try:
        return JobEnd(0, DONE, result=work(job), worker=os.getpid())
    except MemoryError as error:
        if not is_isolated:
            os._exit(1)  # after a failed allocation, its state is unknown
        _lift_memory_limit()  # the message needs memory
        available_text = "there is" if memory is None else f"{memory:g} GiB"
        details_text = f" ({printable(str(error))})" if str(error) else ""
        reason = f"it took more memory than {available_text}{details_text}"
        return JobEnd(0, TOO_LARGE, reason=reason, worker=os.getpid())


# ---------------------------------------------------------------- on a Ray cluster


def run_on_ray(
    jobs: Sequence[Any],
    work: Callable[[Any], Any],
    max_num_tasks: int | None,
    *,
    address: str | None,
    probe_file: Path | None = None,
    limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
    prepare: Callable[[], None] | None = None,
    on_event: OnJobEvent = lambda event, job_end: None,
) -> Generator[JobEnd, None, None]:
    """Run jobs on a Ray cluster, and yield the end of each as it ends, as `Workers.run` does.

    Args:
        jobs: the jobs, which must be picklable.
        work: a function at module level that does one job; its result must be picklable. All nodes
            must be able to import it.
        max_num_tasks: the largest number of tasks at once. None for twice the cluster's number of
            CPUs: tasks that wait for a CPU make an autoscaling cluster grow.
        address: the cluster's address; ``local`` starts a cluster on this machine's loopback device
            for the batch; None for ``RAY_ADDRESS``, else ``local``.
        probe_file: an existing file in the output folder. A node that doesn't see it doesn't share
            the folder, which is an error. None for no such check.
        limits: the limits of each job.
        prepare: a function at module level that each worker process calls before its job.
        on_event: is called when a job is submitted, and after it was retried.

    Yields:
        The end of each job, in the order in which the jobs end.

    Raises:
        NavbakeError: there is no cluster, a node can't do the jobs, or ray isn't installed.
    """
    if not jobs:
        return
    probe_path = None if probe_file is None else os.path.abspath(probe_file)
    enter_node = partial(_check_and_enter_node, os.getcwd(), probe_path, __version__)
    make_workers = partial(Workers, work, 1, limits=limits, prepare=prepare)
    with _ray_connection(address, min(max_num_tasks or os.cpu_count() or 1, len(jobs))) as ray:
        remote_options = {
            "num_cpus": 1,
            "max_retries": MAX_RAY_RETRIES,
            "scheduling_strategy": "SPREAD",
        }
        remote_task = ray.remote(**remote_options)(_run_task)
        node_functions = ray.put((enter_node, make_workers))
        remaining_job_numbers = iter(range(len(jobs)))
        number_of_task = dict[Any, int]()  # of submitted tasks
        while True:
            # twice the CPUs: no node waits for this process
            task_limit = max_num_tasks or 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))
            while len(number_of_task) < task_limit:
                job_number = next(remaining_job_numbers, None)
                if job_number is None:
                    break
                task = remote_task.remote(node_functions, job_number, jobs[job_number])
                number_of_task[task] = job_number
                on_event(SCENE_BEGUN, JobEnd(job_number, how=""))
            if not number_of_task:
                return
            ended_tasks, _ = ray.wait([*number_of_task], timeout=CLUSTER_CHECK_INTERVAL)
            for task in ended_tasks:
                job_number = number_of_task.pop(task)
                try:
                    job_end, failed_attempts = ray.get(task)
                except ray.exceptions.RayTaskError as error:
                    raise NavbakeError(_last_line(error.cause or error)) from error
                except ray.exceptions.RayError as error:
                    reason = f"it was lost {MAX_RAY_RETRIES + 1} times, as {_last_line(error)}"
                    job_end = JobEnd(job_number, CRASHED, reason=reason)
                    failed_attempts = []
                for failed_attempt in failed_attempts:
                    on_event(RETRIED, failed_attempt)
                yield job_end


def _check_and_enter_node(folder: str, probe_path: str | None, version: str) -> None:
    """Change to the batch's current folder on a node of the cluster.

    Args:
        folder: the folder, absolute.
        probe_path: a file in the output folder; a node that doesn't see it doesn't share the
            folder. None for no such check.
        version: navbake's version where the batch was started.

    Raises:
        NavbakeError: the node has another version of navbake, or doesn't see the folder or file.
    """
    problem = None
    if version != __version__:
        problem = f"it has navbake {__version__}, and the batch is one of {version}"
    elif not os.path.isdir(folder):
        problem = f"it lacks {folder}: run the batch in a folder that all nodes have"
    elif probe_path is not None and not os.path.exists(probe_path):
        problem = f"it lacks {probe_path}: write into a folder that all nodes share"
    if problem is not None:
        node_name = socket.gethostname()
        raise NavbakeError(printable(f"no worker can work on node {node_name}: {problem}"))
    os.chdir(folder)


def _run_task(
    node_functions: tuple[Callable[[], None], Callable[[], Workers]], job_number: int, job: object
) -> tuple[JobEnd, list[JobEnd]]:
    """Do a job on a node of the cluster, in a worker process.

    Args:
        node_functions: two functions: the first checks the node and enters the batch's folder, the
            second makes the workers.
        job_number: the job's index in the batch.
        job: the job.

    Returns:
        The job's end, and the ends of failed attempts that were retried.
    """
    enter_node, make_workers = node_functions
    enter_node()
    # without its path, worker processes don't import Ray's main module first
    vars(sys.modules["__main__"]).pop("__file__", None)
    global _workers
    if _workers is None:
        _workers = make_workers().__enter__()
    failed_attempts: list[JobEnd] = []

    def on_event(event: str, job_end: JobEnd) -> None:
        if event == RETRIED:
            failed_attempts.append(job_end._replace(number=job_number))

    (job_end,) = _workers.run([job], on_event)
    return job_end._replace(number=job_number), failed_attempts


_workers: Workers | None = None  # kept for all tasks of a batch in this Ray process


@contextmanager
def _ray_connection(address: str | None, num_cpus: int) -> Iterator[Any]:
    """Connect to a Ray cluster for a with statement; yield the module ``ray``.

    If this process has a connection already, it is used, and stays open.

    Args:
        address: the cluster's address; ``local`` starts a cluster on this machine; None for
            ``RAY_ADDRESS``, else ``local``.
        num_cpus: number of CPUs of a cluster that is started here.

    Raises:
        NavbakeError: there is no cluster at the address, or none can be started.
    """
    address = address or os.environ.get("RAY_ADDRESS") or "local"
    is_started_here = address == "local"
    if is_started_here:
        for name, value in RAY_ENVIRONMENT.items():
            os.environ.setdefault(name, value)
    ray = import_extra("ray", "ray", "--executor ray")
    if ray.is_initialized():
        yield ray
        return
    _check_reachable(address)
    previous_handler = signal.getsignal(signal.SIGTERM)
    with scratch_folder(Path("/tmp")) if is_started_here else nullcontext() as folder:
        local_options = {
            "num_cpus": num_cpus,
            "include_dashboard": False,
            "object_store_memory": OBJECT_STORE_SIZE,
            "_temp_dir": str(folder),
        }
        options = local_options if is_started_here else {}
        try:
            ray.init(address=address, logging_level="ERROR", log_to_driver=False, **options)
        except Exception as error:  # Ray raises many types
            action = (
                "start a Ray cluster"
                if is_started_here
                else f"connect to a Ray cluster at {address}"
            )
            raise NavbakeError(f"cannot {action}: {' '.join(str(error).split())[:300]}") from error
        finally:
            if threading.current_thread() is threading.main_thread():
                signal.signal(
                    signal.SIGTERM, previous_handler
                )  # Ray's handler ends this process at once
        try:
            yield ray
        finally:
            with suppress(Exception):
                ray.shutdown()


def _check_reachable(address: str) -> None:
    """Raise a NavbakeError at once if nobody listens at an address; Ray would take minutes.

    Addresses without a port, such as ``auto``, aren't checked: Ray looks them up.
    """
    host, _, port = address.rpartition(":")
    if "/" in address or not port.isdigit():
        return
    try:
        with socket.create_connection((host.strip("[]"), int(port)), CONNECTION_TIMEOUT):
            pass
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise NavbakeError(f"cannot connect to a Ray cluster at {address}: {reason}") from error


def _last_line(error: BaseException) -> str:
    """Return Ray's reason for a lost task: the first sentence of the message's last line.

    It is at most 200 characters long, and the error's type if there is no message.
    """
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    last_line = lines[-1] if lines else type(error).__name__
    first_sentence, _, _ = last_line.partition(". ")
    return printable(first_sentence[:200])
