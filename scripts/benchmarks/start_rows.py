"""Rows of whole commands: on a machine that has compiled nothing yet, and on one that has."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from benchmarks.measure import Job, Row, Sample, run_process
from benchmarks.scenes import APARTMENT

NAVBAKE = [sys.executable, "-m", "navbake"]


def make_rows(folder: Path) -> dict[str, Callable[[], Row]]:
    """The rows by name, each made when it is asked for."""
    grid = folder / "apartment.grid.json"
    bake = [*NAVBAKE, "bake", str(APARTMENT), "-o", str(grid), "--quiet"]

    def cold_row() -> Row:
        return Row(Job("navbake bake, nothing compiled", lambda: run_cold(bake)), limit=20)

    def warm_row() -> Row:
        return Row(Job("navbake bake, all compiled", lambda: run_process(bake)), limit=0.8)

    def info_row() -> Row:
        def measure() -> Sample:
            if not grid.exists():
                run_process(bake)
            return run_process([*NAVBAKE, "info", str(grid)])

        return Row(Job("navbake info GRID", measure), limit=0.3)

    def import_row() -> Row:
        command = [sys.executable, "-c", "import navbake"]
        bare = [sys.executable, "-c", "pass"]
        return Row(
            Job("import navbake", lambda: run_process(command)),
            [Job("bare Python", lambda: run_process(bare))],
        )

    return {"cold": cold_row, "warm": warm_row, "info": info_row, "import": import_row}


def run_cold(command: list[str]) -> Sample:
    """Run a command with an empty folder for compiled code."""
    with tempfile.TemporaryDirectory() as folder:
        return run_process(command, {**os.environ, "NUMBA_CACHE_DIR": folder})
