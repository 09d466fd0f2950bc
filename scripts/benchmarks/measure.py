"""What a row of the table is, and how it is measured.

The jobs of a row run in turns, so that a noisy machine is as noisy for all of them. Minimum and
median of the repeats are kept. What compiles or warms up runs once before.
"""

from __future__ import annotations

import importlib
import json
import os
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple


class SkipRow(Exception):
    """A row can't be measured on this machine; the text says why, and what to install."""


class Sample(NamedTuple):
    """One run of a job.

    Attributes:
        seconds: of the wall.
        peak: the most memory that its process had [MiB]; None where it shares a process.
        facts: what else it tells, by name, in the words of the JSON output.
    """

    seconds: float
    peak: float | None = None
    facts: dict[str, Any] | None = None


@dataclass(frozen=True)
class Job:
    """Something to be measured.

    Attributes:
        name: what it is.
        measure: runs it once.
        warms_up: whether the first run is slower, as it shares this process, and doesn't count.
    """

    name: str
    measure: Callable[[], Sample]
    warms_up: bool = False


@dataclass(frozen=True)
class Row:
    """A job, the others' way of doing it, and what is asked of the job.

    Attributes:
        job: ours.
        peers: what others take, or a slow way of our own; the limit's ratio is with the first.
        ratio: the most times the first peer's median.
        excess: the most seconds more than the first peer's median.
        peak: the most memory [MiB].
        missing: which peer is left out, and why.
    """

    job: Job
    peers: list[Job] = field(default_factory=list)
    ratio: float | None = None
    excess: float | None = None
    peak: float | None = None
    missing: str = ""


class Result(NamedTuple):
    """The samples of one job of a row."""

    name: str
    samples: list[Sample]

    @property
    def median(self) -> float:
        return statistics.median(sample.seconds for sample in self.samples)

    @property
    def least(self) -> float:
        return min(sample.seconds for sample in self.samples)

    @property
    def peak(self) -> float | None:
        peaks = [sample.peak for sample in self.samples if sample.peak is not None]
        return max(peaks) if peaks else None


def here(name: str, run: Callable[[], Any]) -> Job:
    """A job that runs in this process."""

    def measure() -> Sample:
        start = time.perf_counter()
        run()
        return Sample(time.perf_counter() - start)

    return Job(name, measure, warms_up=True)


def beside(
    job: Job, module: str, make: Callable[[Any], Job], *others: Job, **limits: float | None
) -> Row:
    """A row with a peer's job, made of its module, where that is installed."""
    try:
        peer = make(importlib.import_module(module))
    except ImportError:
        missing = why_missing(module)
        # what a limit compares with isn't there; other peers take no place of it
        return Row(job, [], limits.get("ratio"), missing=missing)
    return Row(job, [peer, *others], **limits)  # type: ignore[arg-type]


def why_missing(module: str) -> str:
    """Say that a peer is not installed, and how it can be."""
    return f'no {module} to compare with: pip install -e ".[bench]", or {module}'


def measure_row(row: Row, repeats: int) -> list[Result]:
    """Run a row's jobs in turns, ours first, after a run each that warms up and isn't counted."""
    jobs = [row.job, *row.peers]
    results = [Result(job.name, []) for job in jobs]
    for job in jobs:
        if job.warms_up:
            job.measure()
    for _ in range(repeats):
        for job, result in zip(jobs, results, strict=True):
            result.samples.append(job.measure())
    return results


def run_process(command: list[str], environment: dict[str, str] | None = None) -> Sample:
    """Run a command to its end, and measure it as a whole.

    Its stdout, if it is JSON, becomes the sample's facts. `seconds` and `peak` there come first:
    the program knows best what counts, and a child's peak as the system has it is never less than
    its parent's.

    Raises:
        subprocess.CalledProcessError: it failed.
    """
    with tempfile.TemporaryFile() as out:
        environment = dict(os.environ if environment is None else environment)
        # a command without stored bytecode compiles all of its modules, at each start
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        start = time.perf_counter()
        subprocess.run(command, stdout=out, env=environment, check=True)
        seconds = time.perf_counter() - start
        out.seek(0)
        text = out.read()
    facts = dict(json.loads(text)) if text.startswith(b"{") else {}
    return Sample(facts.pop("seconds", seconds), facts.pop("peak", None), facts)


def peak() -> float | None:
    """The most memory that this process has had [MiB]; None where the system doesn't tell."""
    status = Path("/proc/self/status")
    if not status.exists():
        return None
    lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
    return int(lines["VmHWM"].split()[0]) / 1024
