"""Feeds broken files to navbake's readers: only errors of ours may leave, soon, and in one line.

Inputs are good files with changes that know the format, by a seed and a number, so that each can
be made again. They are used in child processes: what kills one, takes more time or memory than
`fuzzing.measure.exceeds` allows, or contradicts itself once it is read, is a finding. MuJoCo's
compiler may crash or take long (docs/limits.md): what MuJoCo does with the file by itself is
measured apart then, and only what is left of the time and the memory is navbake's. Findings are
printed, and kept as files if a folder is given.

    python scripts/fuzz.py --count 1000                     # of each kind
    python scripts/fuzz.py --inputs 1000000 --state f.json  # of all kinds together; may be resumed
    python scripts/fuzz.py --only yaml --only ply --seconds 60
    python scripts/fuzz.py --only yaml --first 123 --count 1   # one of them again
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from fuzzing.kind import Input, check_message
from fuzzing.kinds import KINDS, SKIPPED
from fuzzing.measure import Cost, Meter, exceeds, measures_memory
from navbake.errors import NavbakeError
from navbake.files import write_whole
from navbake.processes import end_with_parent, limit_memory

LOADING = 300.0  # in which a child is ready; kernels may have to be compiled [s]
PATIENCE = 300.0  # in which an input is done, where others use the processor, too [s]
ALONE_PATIENCE = 60.0  # what MuJoCo alone doesn't end in that time, navbake can't help [s]
CHECK_SECONDS = 5.0  # of the processor, for what is done with what was read
MOST_GIB = 4.0  # that a child may reserve beyond what it starts with
CHUNK = 1000  # inputs of a kind before it is another one's turn, and the state is written
READY, DONE, SPENT = "ready", "done", "spent"
READ, REFUSED, NATIVE = "read", "refused", "native"
FINE = (READ, REFUSED, NATIVE)
SHOWN = 10  # findings of a kind that are printed in full


class Chunk(NamedTuple):
    """Inputs that one child uses one by one; if `is_alone`, MuJoCo uses them without navbake."""

    kind: str
    seed: int
    numbers: range
    is_alone: bool = False


@dataclass
class Tally:
    """What became of the inputs of a kind.

    Attributes:
        next: the number of the first input that was not used yet.
        counts: how many were ``read``, ``refused``, a ``finding``, or (``native``) more than
            MuJoCo could take without navbake.
        findings: what was wrong, by number.
        seconds: how long it took; with several processes, of each.
    """

    next: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    findings: dict[int, str] = field(default_factory=dict)
    seconds: float = 0.0


def main() -> None:
    """Run the kinds that were asked for, print counts and findings, and exit with 1 for any."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", choices=sorted(KINDS), help="may be repeated")
    parser.add_argument("--count", type=int, help="inputs of each kind  [default: 1000]")
    parser.add_argument("--inputs", type=int, help="of all kinds together, in place of --count")
    parser.add_argument("--seconds", type=float, help="time for each kind, in place of --count")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument(
        "--patience", type=float, default=PATIENCE, help="for one input [s]  [default: 300]"
    )
    parser.add_argument("--state", type=Path, help="file by which a run goes on where one ended")
    parser.add_argument("--keep", type=Path, help="folder for the inputs of findings")
    given = parser.parse_args()
    kinds = given.only or list(KINDS)
    if given.inputs is not None:
        given.count = -(-given.inputs // len(kinds))
    count = given.count or (1000 if given.seconds is None else 10**9)
    tallies = _read_state(given.state, given.seed)
    for kind in kinds:
        tallies.setdefault(kind, Tally(next=given.first))
    for kind, reason in SKIPPED.items():
        print(f"{kind} is skipped: {reason}", flush=True)
    if not measures_memory():
        print("memory is not checked: /proc/self/clear_refs can't be written", flush=True)
    run = Run(given.seed, given.state, tallies, given.first + count, given.seconds)
    run.patience = given.patience
    run.all(kinds, given.processes)
    sys.exit(1 if _report(run, kinds, given) else 0)


def _report(run: Run, kinds: list[str], given: argparse.Namespace) -> int:
    total: Counter[str] = Counter()
    for kind in kinds:
        tally = run.tallies[kind]
        total += tally.counts
        _print_tally(kind, tally, run.seed, given.first)
        for position, (at, what) in enumerate(sorted(tally.findings.items())):
            if position < SHOWN:
                print(f"--- {kind} {at}\n{what.rstrip()}", flush=True)
            if given.keep is not None:
                _keep(given.keep / f"{kind}-{run.seed}-{at}", make_input(kind, run.seed, at))
    if len(kinds) > 1:
        print(f"in all: {_shown(total)}")
    return total["finding"]


def _print_tally(kind: str, tally: Tally, seed: int, first: int) -> None:
    where = f"(seed {seed}, from {first} on) in {tally.seconds:.0f} s"
    print(f"{kind}: {_shown(tally.counts, where)}", flush=True)


def _shown(counts: Counter[str], where: str = "") -> str:
    native = f"{counts[NATIVE]} beyond MuJoCo, " if counts[NATIVE] else ""
    return (
        f"{sum(counts.values())} inputs{' ' if where else ''}{where}: {counts[READ]} read, "
        f"{counts[REFUSED]} refused, {native}{counts['finding']} findings"
    )


def _keep(folder: Path, made: Input) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    _write_input(made, folder)


def make_input(kind: str, seed: int, number: int) -> Input:
    """An input: always the same for a seed and a number."""
    return KINDS[kind].make(Random(f"{kind} {seed} {number}"))


def use_input(kind: str, made: Input, folder: Path) -> str:
    """Use an input as users do: how it went, and a traceback for what may not happen.

    Returns:
        "read", "refused", or what was wrong.
    """
    path = _write_input(made, folder)
    value: Any = None
    meter = Meter()
    cost = Cost(0.0, 0)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", module="navbake")
            try:
                value = KINDS[kind].read(path)
            finally:
                cost = meter.read()
    except NavbakeError as error:
        try:
            check_message(error)
        except AssertionError as problem:
            return str(problem)
        return _judge_cost(kind, path, made, value, cost) or REFUSED
    except Exception:
        return traceback.format_exc()
    return _check(kind, value) or _judge_cost(kind, path, made, value, cost) or READ


def _judge_cost(kind: str, path: Path, made: Input, value: Any, cost: Cost) -> str:
    """What took too much, "" for nothing; "native" if it didn't without MuJoCo's own part.

    MuJoCo's part is what it takes for the same file by itself. It is measured only now, so that it
    costs nothing in the usual case.
    """
    what, native = exceeds(cost, made, value), KINDS[kind].native
    if not what or native is None:
        return what
    meter = Meter()
    native(path)
    alone = meter.read()
    own = Cost(cost.seconds - alone.seconds, cost.memory - alone.memory)
    return exceeds(own, made, value) or NATIVE


def _check(kind: str, value: Any) -> str:
    """Do with what was read what users do; says what was wrong, "" for nothing.

    What was read has to be good for that: an error of ours is a finding, too, unless the check
    allows it, see `fuzzing.kind.attempt`.
    """
    check = KINDS[kind].check
    if check is None:
        return ""
    meter = Meter()
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", module="navbake")
            check(value)
    except Exception:
        return traceback.format_exc()
    seconds = meter.read().seconds
    return f"took {seconds:.1f} s to be checked" if seconds > CHECK_SECONDS else ""


def _write_input(made: Input, folder: Path) -> Path:
    for name, content in made.beside.items():
        (folder / name).write_bytes(content)
    path = folder / f"input{made.suffix}"
    path.write_bytes(made.data)
    return path


class Run:
    """Inputs of several kinds in child processes, and what became of them."""

    def __init__(
        self, seed: int, state: Path | None, tallies: dict[str, Tally], stop: int,
        seconds: float | None,
    ) -> None:  # fmt: skip
        self.seed, self.tallies = seed, tallies
        self._state, self._stop, self._seconds = state, stop, seconds
        self._lock, self._busy = threading.Lock(), set[str]()
        self.patience = PATIENCE

    def all(self, kinds: list[str], processes: int) -> None:
        """Use inputs of all kinds, chunk by chunk, until all are or the time is up."""
        workers = [threading.Thread(target=self._work, args=(kinds,)) for _ in range(processes)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()

    def _take_chunk(self, kinds: list[str]) -> Chunk | None:
        """A chunk of the kind that is least far; a kind is one process's at a time."""
        free = [kind for kind in kinds if kind not in self._busy and not self._is_done(kind)]
        if not free:
            return None
        kind = min(free, key=lambda kind: self.tallies[kind].next)
        self._busy.add(kind)
        begin = self.tallies[kind].next
        return Chunk(kind, self.seed, range(begin, min(self._stop, begin + CHUNK)))

    def _is_done(self, kind: str) -> bool:
        tally = self.tallies[kind]
        is_late = self._seconds is not None and tally.seconds > self._seconds
        return is_late or tally.next >= self._stop

    def _work(self, kinds: list[str]) -> None:
        child: Child | None = None
        while True:
            with self._lock:
                chunk = self._take_chunk(kinds)
            if chunk is None:
                break
            begin, numbers = time.monotonic(), chunk.numbers
            counts: Counter[str] = Counter()
            findings: dict[int, str] = {}
            while len(numbers):
                child = child or Child(self.patience)
                ending = child.use(Chunk(chunk.kind, chunk.seed, numbers), counts, findings)
                numbers = numbers[child.num_done :]
                if ending or child.is_spent:
                    child.end()
                    child = None
                if ending:
                    one = Chunk(chunk.kind, chunk.seed, numbers[:1])
                    what = judge_ending(one, ending, min(self.patience, ALONE_PATIENCE))
                    _count(what, numbers[0], counts, findings)
                    numbers = numbers[1:]
            self._add(chunk, counts, findings, time.monotonic() - begin)
        if child is not None:
            child.end()

    def _add(
        self, chunk: Chunk, counts: Counter[str], findings: dict[int, str], seconds: float
    ) -> None:
        with self._lock:
            tally = self.tallies[chunk.kind]
            tally.counts += counts
            tally.findings |= findings
            tally.seconds += seconds
            tally.next = chunk.numbers.stop
            self._busy.remove(chunk.kind)
            if self._state is not None:
                kinds = {kind: vars(tally) for kind, tally in self.tallies.items()}
                text = json.dumps({"seed": self.seed, "kinds": kinds}, indent=1)
                write_whole(text.encode(), self._state)


def _count(what: str, number: int, counts: Counter[str], findings: dict[int, str]) -> None:
    counts[what if what in FINE else "finding"] += 1
    if what not in FINE:
        findings[number] = what


def judge_ending(chunk: Chunk, ending: str, patience: float = ALONE_PATIENCE) -> str:
    """What it is that an input ended its process: "native" if MuJoCo alone does so as well."""
    if KINDS[chunk.kind].native is None:
        return ending
    child = Child(patience)
    try:
        return NATIVE if child.use(Chunk(*chunk[:3], is_alone=True), Counter(), {}) else ending
    finally:
        child.end()


def _read_state(path: Path | None, seed: int) -> dict[str, Tally]:
    if path is None or not path.exists():
        return {}
    state = json.loads(path.read_text(encoding="utf-8"))
    if state["seed"] != seed:
        sys.exit(f"{path} is of seed {state['seed']}")
    tallies = {kind: Tally(**told) for kind, told in state["kinds"].items()}
    for tally in tallies.values():
        tally.counts = Counter(tally.counts)
        tally.findings = {int(number): what for number, what in tally.findings.items()}
    return tallies


class Child:
    """A process that uses inputs, until one ends it; it ends with the thread that made it."""

    def __init__(self, patience: float = PATIENCE) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=run_child, args=(theirs, os.getpid()))
        self._process.start()
        theirs.close()
        self.num_done, self.is_spent = 0, False
        self._patience, self._limit = LOADING, patience

    def use(self, chunk: Chunk, counts: Counter[str], findings: dict[int, str]) -> str:
        """Use a chunk's inputs, `num_done` of them; says what ended the process, "" for nothing.

        That came of the input after these. A process that is spent uses no more.
        """
        self.num_done = 0
        self._pipe.send(chunk)
        while True:
            is_alive, what = self._next()
            if not is_alive:
                return what
            if what in (DONE, SPENT):
                self.is_spent = what == SPENT
                return ""
            if what != READY:
                _count(what, chunk.numbers[self.num_done], counts, findings)
                self.num_done += 1

    def _next(self) -> tuple[bool, str]:
        if not self._pipe.poll(self._patience):
            return False, f"not done after {self._patience:g} s"
        self._patience = self._limit
        try:
            return True, self._pipe.recv()
        except (EOFError, ConnectionResetError):
            return False, "the process died"

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()


def run_child(pipe: Connection, parent: int) -> None:
    """Use the inputs of chunks one by one, and send how each went."""
    end_with_parent(parent)
    limit_memory(MOST_GIB)
    warm: set[str] = set()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pipe.send(READY)
        while True:
            try:
                chunk = pipe.recv()
            except EOFError:
                return
            for number in range(3) if chunk.kind not in warm else ():
                if KINDS[chunk.kind].native is None:  # loads what is loaded lazily
                    _make_and_use(chunk.kind, -1, number, folder)
            warm.add(chunk.kind)
            pipe.send(READY)
            for number in chunk.numbers:
                if chunk.is_alone:
                    what = _use_alone(chunk.kind, chunk.seed, number, folder)
                else:
                    what = _make_and_use(chunk.kind, chunk.seed, number, folder)
                took = what.startswith("took")
                if took:  # a second time, when all is loaded
                    what = _make_and_use(chunk.kind, chunk.seed, number, folder)
                pipe.send(what)
                if what == NATIVE or (took and KINDS[chunk.kind].native is not None):
                    pipe.send(SPENT)  # MuJoCo keeps what it reserved before it gave up
                    return
            pipe.send(DONE)


def _use_alone(kind: str, seed: int, number: int, folder: Path) -> str:
    native = KINDS[kind].native
    if native is not None:
        native(_write_input(make_input(kind, seed, number), folder))
    return READ


def _make_and_use(kind: str, seed: int, number: int, folder: Path) -> str:
    try:
        made = make_input(kind, seed, number)
    except Exception:  # a fault of the kind itself
        return traceback.format_exc()
    return use_input(kind, made, folder)


if __name__ == "__main__":
    main()
