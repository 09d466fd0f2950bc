"""Does the jobs of a batch on a Ray cluster.

Each slot of the cluster is a Ray actor with one CPU, which keeps a worker process beside itself and
is given one job at a time. An actor that is lost, with its node or by itself, gives its job to
another one. Compiled code is given to each node once, before the first job runs there.
"""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from navbake._version import __version__
from navbake.batch.cluster.connection import connected
from navbake.batch.cluster.slot import CODE, Settled, Slot, Terms
from navbake.batch.crew import AGAIN, BEGUN, CRASHED, LOST, READY, Ended, Event, JobLimits
from navbake.compiled import num_cores
from navbake.errors import NavbakeError, printable

ALL = sys.maxsize  # as many slots as the cluster has CPUs
MOST_LOSSES = 3  # actors that a job may lose in a row, before it is taken for the cause
LOOK = 5.0  # after which it is seen whether the cluster has grown [s]
PATIENCE = 30.0  # after which it is told that no CPU is free [s]
FAREWELL = 10.0  # how long actors may take to end [s]
MOST_TEXT = 200  # of what Ray says of an actor that it lost, characters

SETTLING, WAITING, TAKING, IDLE, WORKING = "settling", "waiting", "taking", "idle", "working"


@dataclass(frozen=True)
class CodeHandover:
    """How compiled code gets to the nodes.

    Attributes:
        pack: returns this machine's code; None where there is none to give.
        take: gives it to the node that it runs on, and returns what is to be told, if anything.
    """

    pack: Callable[[], bytes | None]
    take: Callable[[bytes | None], str | None]


@dataclass(frozen=True)
class RayExecutor:
    """Does jobs on a Ray cluster, as `crew.do_jobs` does them on one machine.

    Attributes:
        address: of the cluster, see `connection.connected`.
        tell: is told lines that a user should know.
        code: how compiled code gets to nodes; None where they see to that.
        witness: a file where the jobs write, which all nodes must see; None for no such check.
    """

    address: str | None
    tell: Callable[[str], None]
    code: CodeHandover | None = None
    witness: Path | None = None

    def __call__(
        self,
        jobs: Sequence[Any],
        work: Callable[[Any], Any],
        count: int,
        *,
        limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
        retries: int = 0,
        prepare: Callable[[], None] | None = None,
        on_event: Callable[[Event], None] = lambda event: None,
    ) -> Generator[Ended, None, None]:
        """Do jobs, and yield how each ended, in the order in which they end.

        Args:
            jobs: what `work` is called with; can be pickled.
            work: a function of a module that all nodes can import.
            count: how many slots at most; `ALL` for the CPUs of the cluster. With a number, CPUs
                that it hasn't are asked for, which makes a cluster grow that can.
            limits: of each job.
            retries: how often a job that crashed, or took too long or too much, is tried again.
            prepare: a function of a module that each worker calls before its first job.
            on_event: is called with what happens to actors meanwhile, which count as workers; what
                happens to the worker processes beside them stays there.

        Raises:
            MissingDependencyError: ray isn't installed.
            NavbakeError: there is no cluster, or no node on which a worker starts.
        """
        if not jobs:
            return
        num_own = min(num_cores() if count == ALL else count, len(jobs))
        terms = Terms(
            work,
            limits,
            retries,
            prepare,
            os.getcwd(),
            None if self.witness is None else os.path.abspath(self.witness),
            __version__,
            {name: value for name, value in os.environ.items() if name.startswith(CODE)},
        )
        with connected(self.address, num_own) as (ray, is_own):
            # a cluster on this machine has this machine's code
            code = None if is_own else self.code
            fleet = _Fleet(ray, terms, count, code, self.tell, on_event)
            try:
                yield from fleet.run(jobs)
            finally:
                fleet.end()


class _Task:
    """A job, and how many actors in a row were lost at it."""

    def __init__(self, number: int, job: Any) -> None:
        self.number, self.job, self.losses = number, job, 0


class _Actor:
    """An actor, seen from here."""

    def __init__(self, handle: Any, number: int) -> None:
        self.handle, self.number = handle, number
        self.state = SETTLING
        self.where = Settled("", "", None)
        self.task: _Task | None = None
        self.started = self.begun = time.monotonic()
        self.answer: Any = None  # the reference to what it was asked last, which stays alive so


class _Fleet:
    """The actors, and the tasks that are left."""

    def __init__(
        self,
        ray: Any,
        terms: Terms,
        count: int,
        code: CodeHandover | None,
        tell: Callable[[str], None],
        on_event: Callable[[Event], None],
    ) -> None:
        self._on_event, self._num_started = on_event, 0
        self._ray, self._count, self._code, self._tell = ray, count, code, tell
        # max_restarts: an actor that is lost is replaced here, where its task is known
        self._remote = ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(Slot)
        self._remote = self._remote.options(scheduling_strategy="SPREAD")
        self._terms = ray.put(terms)
        self._packed: Any = None  # the reference to the compiled code, once it is asked for
        self._warm: set[str] = set()  # nodes that were given code
        self._actors: list[_Actor] = []
        self._left: deque[_Task] = deque()
        self._num_open = 0  # tasks that have not ended
        self._events: SimpleQueue[tuple[_Actor, Any]] = SimpleQueue()
        self._num_cpus = 0  # of the cluster, when it was last looked at
        self._failed_starts = 0  # since then
        self._refusals = 0  # of actors that could not work, since a job ended
        self._has_worked = False  # whether a job ever ended
        self._begun = self._looked = time.monotonic()
        self._is_told = False

    def run(self, jobs: Sequence[Any]) -> Iterator[Ended]:
        """Do jobs."""
        self._left.extend(_Task(number, job) for number, job in enumerate(jobs))
        self._num_open = len(jobs)
        self._look_at_cluster()
        while self._num_open:
            with suppress(Empty):
                # waits in Python: signals are heard at once
                actor, future = self._events.get(timeout=LOOK)
                if actor in self._actors:
                    yield from self._hear(actor, future)
                    self._hand_out()
            if time.monotonic() - self._looked > LOOK:
                self._look_at_cluster()

    def end(self) -> None:
        """End the actors, which takes their workers with them, and wait until they are gone."""
        busy = [actor for actor in self._actors if actor.state in (SETTLING, TAKING, WORKING)]
        for actor in self._actors:
            self._kill(actor)
        limit = time.monotonic() + FAREWELL
        while busy and time.monotonic() < limit:
            with suppress(Empty):  # what an actor was asked fails when it is gone
                actor, _ = self._events.get(timeout=max(0.0, limit - time.monotonic()))
                if actor in busy:
                    busy.remove(actor)

    # ------------------------------------------------------------ actors come and go

    def _look_at_cluster(self) -> None:
        """Start as many actors as there should be now."""
        self._looked = time.monotonic()
        num_cpus = int(self._ray.cluster_resources().get("CPU", 0))
        if num_cpus != self._num_cpus or not self._actors:
            self._num_cpus, self._failed_starts = num_cpus, 0
        self._grow()
        is_late = self._looked - self._begun > PATIENCE
        if is_late and not self._is_told and all(a.state == SETTLING for a in self._actors):
            self._is_told = True
            self._tell(f"waiting until one of the Ray cluster's CPUs ({num_cpus}) is free")

    def _grow(self) -> None:
        """Start actors, but none in the place of those that could not start."""
        count = max(1, self._num_cpus) if self._count == ALL else self._count
        wanted = min(count - self._failed_starts, self._num_open)
        while len(self._actors) < wanted:
            self._num_started += 1
            actor = _Actor(self._remote.remote(self._terms), self._num_started)
            self._actors.append(actor)
            self._ask(actor, SETTLING, actor.handle.settle)

    def _ask(self, actor: _Actor, state: str, method: Any, *arguments: Any) -> None:
        actor.state, actor.begun = state, time.monotonic()
        future: Future[Any]
        try:
            actor.answer = method.remote(*arguments)
            future = actor.answer.future()
        except self._ray.exceptions.RayError as error:  # it is known to be lost
            future = Future()
            future.set_exception(error)
        future.add_done_callback(lambda done: self._events.put((actor, done)))

    def _kill(self, actor: _Actor) -> None:
        with suppress(Exception):  # it may be gone
            self._ray.kill(actor.handle, no_restart=True)

    def _remove(self, actor: _Actor) -> None:
        self._actors.remove(actor)
        self._kill(actor)
        if actor.state == TAKING:  # then another one of its node does it
            self._warm.discard(actor.where.node)

    def _refuse(self, actor: _Actor, why: str) -> None:
        """Do without an actor that can't work; end where there is none that can.

        Raises:
            NavbakeError: no actor is left, and none could work though enough were tried. Where jobs
                have ended before, more are tried: it may pass.
        """
        self._remove(actor)
        if actor.task is not None:
            self._left.appendleft(actor.task)
        self._failed_starts += 1
        self._refusals += 1
        where = f" on node {actor.where.name}" if actor.where.name else ""
        line = f"no worker can work{where}: {why}"
        wanted = max(1, min(self._num_cpus, self._count, self._num_open))
        enough = MOST_LOSSES * wanted if self._has_worked else min(MOST_LOSSES, wanted)
        if not self._actors and self._refusals >= enough:
            raise NavbakeError(line)
        if self._refusals == 1:
            self._tell(line)

    # ------------------------------------------------------------ what they say

    def _hear(self, actor: _Actor, future: Any) -> Iterator[Ended]:
        """Take an actor's answer, or see what becomes of its task if it is lost."""
        try:
            answer = future.result()
        except Exception as error:  # Ray's, of many kinds
            yield from self._lose(actor, _reason(error))
            return
        if actor.state == SETTLING:
            actor.where = answer
            if answer.why_not is not None:
                self._refuse(actor, answer.why_not)
            else:
                actor.state = WAITING
        elif actor.state == TAKING:
            self._make_idle(actor)
            if answer:
                self._tell(f"node {actor.where.name}: {answer}")
        elif isinstance(answer, Ended):
            actor.state, actor.task = IDLE, None
            self._refusals, self._has_worked = 0, True
            self._num_open -= 1
            yield answer
        else:
            self._refuse(actor, answer)

    def _lose(self, actor: _Actor, why: str) -> Iterator[Ended]:
        """Replace an actor that is lost; its task isn't blamed unless that goes on."""
        task, seconds = actor.task, time.monotonic() - actor.begun
        if task is None:
            self._refuse(actor, why)
            return
        self._remove(actor)
        lost = Event(LOST, actor.number, task.number, CRASHED, why, seconds)
        self._on_event(lost)
        task.losses += 1
        if task.losses < MOST_LOSSES:
            self._left.appendleft(task)
            self._on_event(lost._replace(what=AGAIN))
            return
        self._num_open -= 1
        reason = f"{task.losses} Ray actors in a row were lost at it, the last one as {why}"
        yield Ended(task.number, CRASHED, reason, seconds)

    def _hand_out(self) -> None:
        """Give code to nodes and tasks to actors, and see to their number."""
        self._grow()
        taking = {actor.where.node for actor in self._actors if actor.state == TAKING}
        for actor in [*self._actors]:
            node = actor.where.node
            if actor.state == WAITING and node not in taking:
                if self._code is None or node in self._warm:
                    self._make_idle(actor)
                else:
                    self._warm.add(node)
                    taking.add(node)
                    self._ask(actor, TAKING, actor.handle.hand_over, self._code.take, self._pack())
            if actor.state == IDLE and self._left:
                actor.task = self._left.popleft()
                self._on_event(Event(BEGUN, actor.number, actor.task.number))
                self._ask(actor, WORKING, actor.handle.do, actor.task.number, actor.task.job)
            elif actor.state == IDLE:
                self._remove(actor)  # its CPU is for others now

    def _make_idle(self, actor: _Actor) -> None:
        actor.state = IDLE
        seconds = time.monotonic() - actor.started
        self._on_event(Event(READY, actor.number, seconds=seconds))

    def _pack(self) -> Any:
        if self._packed is None and self._code is not None:
            self._packed = self._ray.put(self._code.pack())
        return self._packed


def _reason(error: BaseException) -> str:
    """What Ray says of an actor that it lost: the first sentence of the last line tells most."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    last = lines[-1] if lines else type(error).__name__
    return printable(last.partition(". ")[0][:MOST_TEXT])
