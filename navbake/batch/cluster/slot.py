"""What runs on the nodes of a cluster: an actor that keeps one worker process beside itself.

The worker is one of `crew`, so limits, crashes and retries are those of a batch on one machine.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from navbake._version import __version__
from navbake.batch.crew import DONE, Ended, JobLimits, SingleWorker, do_jobs
from navbake.errors import NavbakeError, printable

CODE = "NUMBA_"  # how the variables begin that say which compiled code is used, and where it is
CACHE = "NUMBA_CACHE_DIR"


@dataclass(frozen=True)
class Terms:
    """What all slots of a batch are to do.

    Attributes:
        work: done with each job, see `crew.do_jobs`.
        limits: of each job.
        retries: how often a job that failed by a crash or a limit is tried again.
        prepare: what a worker calls before its first job.
        folder: the current folder of whoever runs the batch: relative paths begin there.
        witness: a file that the batch has made where it writes; None for no such check.
        version: of navbake.
        variables: of the environment, see `CODE`.
    """

    work: Callable[[Any], Any]
    limits: JobLimits
    retries: int
    prepare: Callable[[], None] | None
    folder: str
    witness: str | None
    version: str
    variables: dict[str, str]


@dataclass(frozen=True)
class Settled:
    """Where a slot is.

    Attributes:
        node: the node's id.
        name: its host's name, for messages.
        why_not: why the slot can't do its work there; None if it can.
    """

    node: str
    name: str
    why_not: str | None


class Slot:
    """A place on a node that does one job at a time."""

    def __init__(self, terms: Terms) -> None:
        self._terms = terms
        # or each process that is started here would begin with importing Ray's own main module
        vars(sys.modules["__main__"]).pop("__file__", None)
        self._worker = SingleWorker(terms.work, terms.limits, terms.retries, terms.prepare)

    def settle(self) -> Settled:
        """See whether this node will do, and take up the batch's folder and environment."""
        import ray  # an extra; there is one where this runs

        node = ray.get_runtime_context().get_node_id()
        return Settled(node, socket.gethostname(), self._why_not())

    def hand_over(self, take: Callable[[bytes | None], str | None], code: bytes | None) -> str:
        """Give compiled code to this node, in a process of its own; what is to be told of that.

        Args:
            take: what does that; it returns what is to be told.
            code: the code; None where there is none.
        """
        (ended,) = do_jobs([code], take, 1)
        if ended.how == DONE:
            return str(ended.value or "")
        return f"compiled code can't be handed on: {ended.value}"

    def do(self, number: int, job: Any) -> Ended | str:
        """Do a job; a text if no process here comes to do it, and why."""
        try:
            return self._worker.do(number, job)
        except NavbakeError as error:
            return str(error)

    def _why_not(self) -> str | None:
        terms = self._terms
        if terms.version != __version__:
            return f"it has navbake {__version__}, and the batch is one of {terms.version}"
        try:
            os.chdir(terms.folder)
        except OSError as error:
            return printable(
                f"the batch runs in {terms.folder}, which can't be entered there "
                f"({error.strerror}): run it in a folder that all nodes have"
            )
        if terms.witness is not None and not os.path.exists(terms.witness):
            return printable(
                f"what the batch has written into {os.path.dirname(terms.witness)} isn't seen "
                "there: write into a folder that all nodes share"
            )
        for name, value in terms.variables.items():
            if name != CACHE or os.path.isdir(value):  # else this node has a place of its own
                os.environ.setdefault(name, value)
        return None
