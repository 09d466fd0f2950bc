"""Does the jobs of a batch on a Ray cluster: a Ray task for each, in a worker process beside it.

The worker processes are those of `workers.py`, so limits, retries and reasons are the same as on
one machine. A task whose node is lost is done again by Ray.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, NamedTuple

from navbake._version import __version__
from navbake.batch.workers import AGAIN, BEGUN, CRASHED, Ended, JobLimits, OnEvent, Workers
from navbake.errors import NavbakeError, printable
from navbake.files import scratch_folder
from navbake.formats.source import import_extra

MOST_LOSSES = 3  # how often Ray does a task again whose node or process was lost
LOOK = 5.0  # after which it is seen whether the cluster has grown [s]
PATIENCE = 10.0  # within which a cluster takes a connection [s]
STORE = 80 << 20  # of memory for what tasks are handed, in a cluster of one's own [bytes]
# Read by Ray as it is imported. With the first, which is meant for other systems, its processes
# listen on the loopback device only. Usage is told to nobody.
PRIVATE = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}


class _Terms(NamedTuple):
    """What all tasks of a batch are to do."""

    work: Callable[[Any], Any]
    limits: JobLimits
    prepare: Callable[[], None] | None
    folder: str  # the current one of whoever runs the batch
    witness: str | None
    version: str


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
    """Do jobs on a Ray cluster, as `workers.do_jobs` does them on one machine.

    All nodes have to be able to import `work`; see `workers.Workers` for other arguments.

    Args:
        count: how many tasks run at once at most; None for the CPUs of the cluster. With a number,
            CPUs that it hasn't are asked for, which makes a cluster grow that can.
        address: of the cluster; ``local`` for one that is started on this machine, listens on the
            loopback device only, and ends with the batch; None for what ``RAY_ADDRESS`` says, else
            ``local``.
        witness: a file where the jobs write, which all nodes must see; None for no such check.

    Raises:
        MissingDependencyError: ray isn't installed.
        NavbakeError: there is no cluster, or a node can't do the jobs.
    """
    if not jobs:
        return
    seen = None if witness is None else os.path.abspath(witness)
    terms = _Terms(work, limits, prepare, os.getcwd(), seen, __version__)
    with _connected(address, min(count or os.cpu_count() or 1, len(jobs))) as ray:
        do = ray.remote(num_cpus=1, max_retries=MOST_LOSSES, scheduling_strategy="SPREAD")(_do)
        shared = ray.put(terms)
        left, number_of = iter(range(len(jobs))), dict[Any, int]()
        while True:
            # twice the CPUs: no node waits for this process
            most = count or 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))
            while len(number_of) < most and (number := next(left, None)) is not None:
                number_of[do.remote(shared, number, jobs[number])] = number
                on_event(BEGUN, Ended(number, "", ""))
            if not number_of:
                return
            for task in ray.wait([*number_of], timeout=LOOK)[0]:
                number = number_of.pop(task)
                try:
                    ended, tries = ray.get(task)
                except ray.exceptions.RayTaskError as error:
                    raise NavbakeError(_last_line(error.cause or error)) from error
                except ray.exceptions.RayError as error:
                    why = f"it was lost {MOST_LOSSES + 1} times, as {_last_line(error)}"
                    ended, tries = Ended(number, CRASHED, why), []
                for each in tries:
                    on_event(AGAIN, each)
                yield ended


def _do(terms: _Terms, number: int, job: Any) -> tuple[Ended, list[Ended]]:
    """Do a job on a node; returns how it ended, and tries at it that failed before."""
    why = None
    if terms.version != __version__:
        why = f"it has navbake {__version__}, and the batch is one of {terms.version}"
    elif not os.path.isdir(terms.folder):
        why = f"it lacks {terms.folder}: run the batch in a folder that all nodes have"
    elif terms.witness is not None and not os.path.exists(terms.witness):
        why = f"it lacks {terms.witness}: write into a folder that all nodes share"
    if why is not None:
        node = socket.gethostname()
        raise NavbakeError(printable(f"no worker can work on node {node}: {why}"))
    os.chdir(terms.folder)
    # or each process that is started here would begin with importing Ray's own main module
    vars(sys.modules["__main__"]).pop("__file__", None)
    global _workers
    if _workers is None:
        _workers = Workers(terms.work, 1, limits=terms.limits, prepare=terms.prepare).__enter__()
    tries: list[Ended] = []
    (ended,) = _workers.do([job], lambda event, each: tries.extend([each] * (event == AGAIN)))
    return ended._replace(number=number), [each._replace(number=number) for each in tries]


_workers: Workers | None = None  # of this Ray process, which Ray keeps for many tasks of a batch


@contextmanager
def _connected(address: str | None, num_cpus: int) -> Iterator[Any]:
    """Be connected to a Ray cluster inside; a process that is connected already stays so."""
    address = address or os.environ.get("RAY_ADDRESS") or "local"
    is_own = address == "local"
    if is_own:
        for name, value in PRIVATE.items():
            os.environ.setdefault(name, value)
    ray = import_extra("ray", "ray", "--executor ray")
    if ray.is_initialized():
        yield ray
        return
    _check_reachable(address)
    handler = signal.getsignal(signal.SIGTERM)
    with scratch_folder(Path("/tmp")) if is_own else nullcontext() as folder:
        own = {
            "num_cpus": num_cpus,
            "include_dashboard": False,
            "object_store_memory": STORE,
            "_temp_dir": str(folder),
        }
        options = own if is_own else {}
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
    """Find out at once that nobody listens at an address, which takes Ray minutes."""
    host, _, port = address.rpartition(":")
    if "/" in address or not port.isdigit():
        return  # one that Ray looks up, as "auto"
    try:
        with socket.create_connection((host.strip("[]"), int(port)), PATIENCE):
            pass
    except (OSError, OverflowError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise NavbakeError(f"cannot connect to a Ray cluster at {address}: {why}") from error


def _last_line(error: BaseException) -> str:
    """What Ray says of a task that it lost: the first sentence of the last line says most."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return printable((lines or [type(error).__name__])[-1].partition(". ")[0][:200])
