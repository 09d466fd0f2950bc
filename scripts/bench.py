"""Measures navbake next to what others take, in one table.

    python scripts/bench.py [--only house soup ...] [--repeats 5] [--json results.json]

Each row is a job of ours and a peer's, run in turns, with minimum and median of the repeats, and
the ratio of the medians. Bakes run in processes of their own, warm. Peers that aren't installed
are left out, with the reason: `pip install -e ".[bench]"` and, for Recast, Debian's librecast-dev
and g++. A machine that does something else at the same time says nothing about limits.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import bake_rows, run_rows, voxel_rows
from benchmarks.measure import Result, Row, measure_row
from benchmarks.scenes import ROOMS, Scenes

HEADER = f"{'row':<18}{'job':<42}{'min':>10}{'median':>10}{'ratio':>9}{'peak':>10}  asked for"


def make_rows(scenes: Scenes) -> dict[str, Callable[[], Row]]:
    """All rows by name, in the order in which they are measured."""
    return {
        **bake_rows.make_rows(scenes),
        **run_rows.make_rows(scenes),
        **voxel_rows.make_rows(scenes.folder),
    }


def format_row(name: str, row: Row, results: list[Result]) -> str:
    """Format a row as lines: our job, then the peers with our median over theirs."""
    own, *others = results
    lines = [_format_job(name, own, "", _limits(row, results))]
    for other in others:
        lines.append(_format_job("", other, f"{own.median / other.median:.3g} ×", ""))
    if row.missing:
        lines.append(f"{'':<18}{row.missing}")
    return "\n".join(lines)


def _format_job(name: str, result: Result, ratio: str, limits: str) -> str:
    peak = "" if result.peak is None else f"{result.peak:,.0f} MiB"
    times = f"{_duration(result.least):>10}{_duration(result.median):>10}"
    return f"{name:<18}{result.name:<42}{times}{ratio:>9}{peak:>10}  {limits}".rstrip()


def _duration(seconds: float) -> str:
    return f"{seconds * 1e3:.1f} ms" if seconds < 1 else f"{seconds:.2f} s"


def _limits(row: Row, results: list[Result]) -> str:
    """What is asked for, and whether it is met."""
    own, *others = results
    ratio = own.median / others[0].median if others else None
    asked = (
        (row.ratio, ratio, f"{row.ratio or 0:g} ×"),
        (row.limit, own.median, _duration(row.limit or 0)),
        (row.peak, own.peak, f"{row.peak or 0:,.0f} MiB"),
    )
    said = []
    for limit, value, text in asked:
        if limit is not None:
            met = "not compared" if value is None else "met" if value <= limit else "NOT MET"
            said.append(f"{text}: {met}")
    return ", ".join(said)


def to_json(name: str, row: Row, results: list[Result]) -> dict[str, Any]:
    """A row for a program: seconds, MiB, and what each job tells of itself."""
    jobs = [
        {"name": own.name, "min": own.least, "median": own.median, "peak": own.peak}
        | {"facts": own.samples[-1].facts or {}}
        for own in results
    ]
    limits = {"seconds": row.limit, "ratio": row.ratio, "peak": row.peak}
    return {"row": name, "job": jobs[0], "peers": jobs[1:], "limits": limits}


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure navbake next to what others take.")
    parser.add_argument("--repeats", type=int, default=5, help="runs of each job")
    parser.add_argument("--only", nargs="+", metavar="ROW", help="rows to measure")
    parser.add_argument("--list", action="store_true", help="name the rows and end")
    parser.add_argument("--rooms", type=int, default=ROOMS, help="of the main house")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the scenes here")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures here")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        rows = make_rows(Scenes(folder, given.rooms))
        if given.list:
            print("\n".join(rows))
            return
        unknown = [name for name in given.only or () if name not in rows]
        if unknown:
            parser.error(f"--only: unknown row {unknown[0]}; expected one of {', '.join(rows)}")
        print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
        print(HEADER)
        written = []
        for name in given.only or rows:
            row = rows[name]()
            results = measure_row(row, given.repeats)
            print(format_row(name, row, results), flush=True)
            written.append(to_json(name, row, results))
        if given.json:
            given.json.write_text(json.dumps(written, indent=2), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
