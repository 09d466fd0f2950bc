"""Feeds broken files to navbake's readers: only errors of ours may leave, soon, and in one line.

Inputs are good files with changes that know the format, by a seed and a number, so that each can
be made again. They are used in a child process: what kills it, takes too long or too much memory
is a finding, too. Findings are printed, and kept as files if a folder is given.

    python scripts/fuzz.py --count 1000                     # of each kind
    python scripts/fuzz.py --only yaml --only mesh --seconds 60
    python scripts/fuzz.py --only yaml --first 123 --count 1   # one of them again
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import NamedTuple

from fuzzing.kinds import KINDS, check_message
from navbake.errors import NavbakeError

try:
    import resource
except ImportError:  # Windows measures no memory
    resource = None  # type: ignore[assignment]

LOADING = 300.0  # in which a child is ready; kernels may have to be compiled [s]
SLOW = 8.0  # times the limit, where others use the processor, too
READY = "ready"
SHOWN = 10  # findings of a kind that are printed in full


class Limits(NamedTuple):
    """What one input may take."""

    seconds: float  # of the processor
    megabytes: int  # by which it may raise the most memory that the process ever had


def main() -> None:
    """Run the kinds that were asked for, print counts and findings, and exit with 1 for any."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", choices=sorted(KINDS), help="may be repeated")
    parser.add_argument("--count", type=int, help="inputs of each kind  [default: 1000]")
    parser.add_argument("--seconds", type=float, help="time for each kind, in place of --count")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--limit-seconds", type=float, default=5.0, help="for one input")
    parser.add_argument("--limit-mb", type=int, default=1024, help="memory for one input")
    parser.add_argument("--keep", type=Path, help="folder for the inputs of findings")
    given = parser.parse_args()
    limits = Limits(given.limit_seconds, given.limit_mb)
    count = given.count or (1000 if given.seconds is None else 10**9)
    num_findings = 0
    for kind in given.only or KINDS:
        end = time.monotonic() + (given.seconds or 10**9)
        numbers = range(given.first, given.first + count)
        num_findings += run_kind(kind, given.seed, numbers, end, limits, given.keep)
    sys.exit(1 if num_findings else 0)


def make_input(kind: str, seed: int, number: int) -> tuple[bytes, str]:
    """The content and the ending of an input: always the same for a seed and a number."""
    return KINDS[kind].make(Random(f"{kind} {seed} {number}"))


def use_input(kind: str, data: bytes, suffix: str, folder: Path) -> str:
    """Use an input as users do: how it went, and a traceback for what may not happen.

    Returns:
        "read", "refused", or the traceback.
    """
    path = folder / f"input{suffix}"
    path.write_bytes(data)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", module="navbake")
            KINDS[kind].use(path)
    except NavbakeError as error:
        try:
            check_message(error)
        except AssertionError as problem:
            return str(problem)
        return "refused"
    except Exception:
        return traceback.format_exc()
    return "read"


def run_kind(
    kind: str, seed: int, numbers: range, end: float, limits: Limits, keep: Path | None
) -> int:
    """Run inputs of a kind in children until they or the time are used up; count the findings."""
    counts: Counter[str] = Counter()
    findings: dict[int, str] = {}
    begin, number = time.monotonic(), numbers.start
    context = multiprocessing.get_context("spawn")
    while number < numbers.stop and time.monotonic() < end:
        ours, theirs = context.Pipe()
        todo = range(number, numbers.stop)
        child = context.Process(target=_run_child, args=(theirs, kind, seed, todo, end, limits))
        child.start()
        theirs.close()
        number = _listen(ours, todo, limits, counts, findings)
        child.kill()
        child.join()
    seconds = time.monotonic() - begin
    done = sum(counts.values())
    print(
        f"{kind}: {done} inputs (seed {seed}, from {numbers.start} on) in {seconds:.0f} s: "
        f"{counts['read']} read, {counts['refused']} refused, {len(findings)} findings",
        flush=True,
    )
    for position, (at, what) in enumerate(sorted(findings.items())):
        if position < SHOWN:
            print(f"--- {kind} {at}\n{what.rstrip()}", flush=True)
        if keep is not None:
            data, suffix = make_input(kind, seed, at)
            keep.mkdir(parents=True, exist_ok=True)
            (keep / f"{kind}-{seed}-{at}{suffix}").write_bytes(data)
    return len(findings)


def _listen(
    pipe: Connection, todo: range, limits: Limits, counts: Counter[str], findings: dict[int, str]
) -> int:
    """Take a child's reports until it ends or hangs; the number of the input that comes next."""
    number, patience = todo.start, LOADING
    while True:
        what: str | None = f"not done after {SLOW * limits.seconds:g} s"
        is_alive = pipe.poll(patience)
        if is_alive:
            try:
                what = pipe.recv()
            except EOFError:
                is_alive, what = False, "the process died"
        if what is None:
            return todo.stop
        patience = SLOW * limits.seconds
        if what == READY:
            continue
        counts[what if what in ("read", "refused") else "finding"] += 1
        if what not in ("read", "refused"):
            findings[number] = what
        number += 1
        if not is_alive or what.startswith("took"):  # the most memory never falls again
            return number


def _run_child(
    pipe: Connection, kind: str, seed: int, todo: range, end: float, limits: Limits
) -> None:
    """Use inputs one by one, and send how each went; None after the last one."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(3):  # loads what is loaded lazily
            use_input(kind, *make_input(kind, -1, number), folder)
        pipe.send(READY)
        base = _peak_megabytes()
        for number in todo:
            if time.monotonic() > end:
                break
            data, suffix = make_input(kind, seed, number)
            begin = time.process_time()
            what = use_input(kind, data, suffix, folder)
            seconds, used = time.process_time() - begin, _peak_megabytes() - base
            if seconds > limits.seconds or used > limits.megabytes:
                what = f"took {seconds:.1f} s and {used} MiB\n{what}"
            pipe.send(what)
        pipe.send(None)


def _peak_megabytes() -> int:
    """The most memory that this process ever had [MiB]; 0 where nothing says so."""
    if resource is None:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak >> (20 if sys.platform == "darwin" else 10))


if __name__ == "__main__":
    main()
