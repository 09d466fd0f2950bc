"""Measures navbake next to what others take, in one table.

    python scripts/bench.py [--only house soup ...] [--repeats 5] [--json results.json] [--write]

Each row is a job of ours and a peer's, run in turns, with minimum and median of the repeats, and
the ratio of the medians. Bakes run in processes of their own, warm. A row whose peer isn't
installed is skipped, and the table says what to install: `pip install -e ".[bench]"` and, for
Recast, Debian's librecast-dev and g++. A row that fails doesn't end the run. Below the table, the
rows are named that were missed, failed or skipped; the exit status is 1 where a row was missed or
failed. A machine that does something else at the same time says nothing about limits.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path

import navbake
from benchmarks import bake_rows, flight_rows, run_rows, voxel_rows
from benchmarks.measure import Row, SkipRow, measure_row
from benchmarks.scenes import ROOMS, ROOT, Scenes
from benchmarks.table import (
    HEADER,
    Outcome,
    exit_status,
    format_outcome,
    summarize,
    to_json,
    write_figures,
)
from navbake.errors import MissingDependencyError

COMPARE_PAGE = ROOT / "docs" / "compare.md"


def make_rows(scenes: Scenes) -> dict[str, Callable[[], Row]]:
    """All rows by name, in the order in which they are measured."""
    return {
        **bake_rows.make_rows(scenes),
        **run_rows.make_rows(scenes),
        **voxel_rows.make_rows(scenes.folder),
        **flight_rows.make_rows(),
    }


def measure(name: str, make_row: Callable[[], Row], repeats: int) -> Outcome:
    """Make a row and measure it; return why, if it is skipped or fails.

    Args:
        name: of the row.
        make_row: makes it.
        repeats: runs of each job.
    """
    try:
        row = make_row()
        return Outcome(name, row, measure_row(row, repeats))
    except SkipRow as reason:
        return Outcome(name, skipped=str(reason))
    except MissingDependencyError as error:
        return Outcome(name, skipped=str(error))
    except ModuleNotFoundError as error:
        command = 'pip install -e ".[bench,convert]"'
        return Outcome(name, skipped=f"no {error.name}: {command}")
    except Exception as error:  # other rows are measured nevertheless
        traceback.print_exc()
        return Outcome(name, error=f"{type(error).__name__}: {error}".splitlines()[0])


def main() -> int:
    parser = argparse.ArgumentParser(description="Measure navbake next to what others take.")
    parser.add_argument("--repeats", type=int, default=5, help="runs of each job")
    parser.add_argument("--only", nargs="+", metavar="ROW", help="rows to measure")
    parser.add_argument("--list", action="store_true", help="name the rows and end")
    parser.add_argument("--rooms", type=int, default=ROOMS, help="of the main house")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the scenes here")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures here")
    parser.add_argument("--write", action="store_true", help="write the figures of docs/compare.md")
    given = parser.parse_args()
    if given.write and given.only:
        parser.error("--write: the page has figures of many rows, leave out --only")
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        rows = make_rows(Scenes(folder, given.rooms))
        if given.list:
            print("\n".join(rows))
            return 0
        unknown = [name for name in given.only or () if name not in rows]
        if unknown:
            parser.error(f"--only: unknown row {unknown[0]}; expected one of {', '.join(rows)}")
        machine = (
            f"{os.cpu_count()} cores ({platform.machine()}, Python {platform.python_version()}"
        )
        print(f"{machine}, navbake {navbake.__version__})")
        print(HEADER)
        outcomes = []
        for name in given.only or rows:
            outcome = measure(name, rows[name], given.repeats)
            print(format_outcome(outcome), flush=True)
            outcomes.append(outcome)
    print(f"\n{summarize(outcomes)}")
    if given.json:
        content = json.dumps([to_json(outcome) for outcome in outcomes], indent=2)
        given.json.write_text(content, encoding="utf-8")
    if given.write:
        today = f"{datetime.date.today():%d %B %Y}"
        conditions = (
            f"Medians of {given.repeats} on {machine}, navbake {navbake.__version__}), {today}."
        )
        page = COMPARE_PAGE.read_text(encoding="utf-8")
        COMPARE_PAGE.write_text(write_figures(page, outcomes, conditions), encoding="utf-8")
    return exit_status(outcomes)


if __name__ == "__main__":
    sys.exit(main())
