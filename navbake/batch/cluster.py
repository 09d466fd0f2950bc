"""Runs the jobs of a batch on a Ray cluster, each as a Ray task with a worker process of its own.

Workers are those of `workers.py`, with the same limits, retries and reasons. Ray repeats a task
whose node is lost.
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

MOST_LOSSES = 3  # retries of a task whose node or process was lost
LOOK = 5.0  # between checks of the cluster's size [s]
PATIENCE = 10.0  # for a connection to a cluster [s]
STORE = 80 << 20  # of the object store in a cluster of one's own [bytes]
# Read by Ray as it is imported: its processes listen on the loopback device only, and send no usage
# statistics.
PRIVATE = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}


class _Terms(NamedTuple):
    """The common parameters of a batch's tasks."""

    work: Callable[[Any], Any]
    limits: JobLimits
    prepare: Callable[[], None] | None
    folder: str  # the batch's current one
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
    """Do jobs on a Ray cluster, as `workers.do_jobs` on one machine.

    All nodes must be able to import `work`; see `workers.Workers` for other arguments.

    Args:
        count: the most tasks at once; None for the cluster's CPUs. More than these are requested,
            so that an autoscaling cluster grows.
        address: of the cluster; ``local`` starts one on this machine's loopback device for the
            batch; None for ``RAY_ADDRESS``, else ``local``.
        witness: a file in the output folder, which all nodes must see; None for no such check.

    Raises:
        NavbakeError: there is no cluster, or a node can't do the jobs; or ray isn't installed.
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
    """Do a job on a node; returns how it ended, and earlier failed attempts."""
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
    # else each process started here imports Ray's main module first
    vars(sys.modules["__main__"]).pop("__file__", None)
    global _workers
    if _workers is None:
        _workers = Workers(terms.work, 1, limits=terms.limits, prepare=terms.prepare).__enter__()
    tries: list[Ended] = []
    (ended,) = _workers.do([job], lambda event, each: tries.extend([each] * (event == AGAIN)))
    return ended._replace(number=number), [each._replace(number=number) for each in tries]


_workers: Workers | None = None  # kept for all tasks of a batch in this Ray process


@contextmanager
def _connected(address: str | None, num_cpus: int) -> Iterator[Any]:
    """Connect to a Ray cluster inside; an existing connection is kept."""
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
    """Fail at once if nobody listens at an address, which takes Ray minutes."""
    host, _, port = address.rpartition(":")
    if "/" in address or not port.isdigit():
        return  # looked up by Ray, as "auto"
    try:
        with socket.create_connection((host.strip("[]"), int(port)), PATIENCE):
            pass
    except (OSError, OverflowError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise NavbakeError(f"cannot connect to a Ray cluster at {address}: {why}") from error


def _last_line(error: BaseException) -> str:
    """Ray's reason for a lost task: the first sentence of the message's last line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return printable((lines or [type(error).__name__])[-1].partition(". ")[0][:200])
