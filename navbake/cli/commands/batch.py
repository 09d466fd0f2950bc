"""The command `navbake batch`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from typer import Argument, Exit, Option

from navbake.cli.commands.warm_up import cold_kernels, compile_all, load_kernels
from navbake.cli.options import Overrides
from navbake.cli.printing import (
    VOLUME,
    print_error,
    print_json_line,
    print_warnings,
    say_unless_quiet,
)

if TYPE_CHECKING:
    from navbake.batch.batch import BatchResult
    from navbake.types import Json

# Functions import the baker and the settings when they run: --help loads neither MuJoCo nor numpy.

INDEX = "index.jsonl"


class PerScene(NamedTuple):
    """What one scene may take."""

    time_limit: float | None = Option(
        None, "--time-limit", metavar="S", min=0.0, help="How long a scene may take [s]."
    )
    memory_limit: float | None = Option(
        None,
        "--memory-limit",
        metavar="GIB",
        min=0.0,
        help="How much memory a scene may take, on Linux [GiB].",
    )
    retries: int = Option(
        0, min=0, help="How often a scene that crashed or exceeded a limit is tried again."
    )


class Wholly(NamedTuple):
    """What concerns the whole batch."""

    jobs: int = Option(1, "-j", "--jobs", min=1, help="Number of worker processes.")
    max_failures: int | None = Option(
        None, "--max-failures", metavar="N", min=0, help="Stop when more than N scenes failed."
    )
    as_json: bool = Option(False, "--json", help="Print a line of JSON for each scene as it ends.")
    parquet: bool = Option(False, "--parquet", help="Write the index as index.parquet as well.")


def batch(
    per_scene: PerScene,
    wholly: Wholly,
    sources: list[str] = Argument(
        ...,
        metavar="SOURCE",
        help="Scenes or settings (YAML), patterns in quotes, or lists: .txt, .csv, .jsonl or "
        ".parquet; paths or URLs such as s3://.",
    ),
    output: str = Option(
        ..., "-o", "--output", metavar="FOLDER", help="Folder to write into, a folder a scene."
    ),
    config: str | None = Option(
        None, "--config", metavar="YAML", help="Settings that all scenes share."
    ),
    make: list[str] | None = Option(
        None,
        "--make",
        metavar="WHAT",
        help="What to make of each scene besides its grid: inflated:RADIUS[:CLEARANCE], "
        "nav2[:RADIUS], "
        "voxels:EDGE[:ENDING], picture[:LAYER...], report. May be repeated.",
    ),
    overrides: Overrides = None,
) -> None:
    """Bake many scenes in several processes; what is done already is skipped.

    What became of each scene is in FOLDER/index.jsonl. A scene that fails, hangs or crashes costs
    itself alone. The exit status is 1 if any failed.

    Example: navbake batch "scenes/*.xml" -o grids --jobs 8 --time-limit 300
    """
    from navbake.batch.batch import Batch, Means, run_batch
    from navbake.batch.crew import JobLimits
    from navbake.batch.manifest import list_jobs
    from navbake.batch.settings import read_shared
    from navbake.batch.stores.urls import as_folder, shown

    jobs = list_jobs(sources)
    settings = {} if config is None else read_shared(config)
    limits = JobLimits(per_scene.time_limit, per_scene.memory_limit)
    means = Means(wholly.jobs, limits, per_scene.retries, wholly.max_failures)
    begin = time.perf_counter()
    with ExitStack() as stack:
        teller = _Teller(stack, wholly.as_json)
        folder = as_folder(output)
        todo = Batch(jobs, folder, settings, overrides or [], make or [], wholly.parquet)
        result = run_batch(todo, means, teller)
    index = str(folder / INDEX) if isinstance(folder, Path) else f"{shown(folder)}/{INDEX}"
    _summarise(result, time.perf_counter() - begin, wholly.as_json, index)
    if result.count("failed") or result.stopped:
        raise Exit(1)


class _Teller:
    """Tells how a batch goes on: lines of JSON, or a bar and what failed."""

    def __init__(self, stack: ExitStack, as_json: bool) -> None:
        self._stack, self._as_json = stack, as_json
        self._done, self._failed, self._total = 0, 0, 0
        self._show: Callable[[int, int, int], None]

    def begin(self, total: int, skipped: int) -> None:
        """Compile what all workers need, once, and begin the bar."""
        from navbake.cli.progress import batch_progress

        _warm_up()
        self._total = total - skipped
        if self._as_json:
            print_json_line({"event": "begin", "scenes": total, "skipped": skipped})
        # on a terminal, lines and a bar would run into each other
        hidden = VOLUME.quiet or (self._as_json and sys.stdout.isatty())
        self._show = self._stack.enter_context(batch_progress(hidden))
        self._show(0, 0, self._total)

    def end_scene(self, row: Json) -> None:
        """Print what became of a scene, if it failed or if all are asked for."""
        is_failed = row["status"] == "failed"
        self._done += 1
        self._failed += is_failed
        self._show(self._done, self._failed, self._total)
        if self._as_json:
            print_json_line({"event": "scene", **row})
        elif is_failed:
            print_error(f"{row['id']}: {row['how']}: {row['error']}")


def _warm_up() -> None:
    """Compile the kernels, unless all that any bake calls are: workers find them on disk."""
    from navbake.cli.progress import stage_progress
    from navbake.dispatch import REMEDY, can_keep
    from navbake.kernel_list import PREFIX, read_list

    load_kernels()
    known = read_list()
    common = {PREFIX + entry.name for entry in known.entries[: known.num_common]}
    if common.isdisjoint(cold_kernels()):
        return
    if not can_keep():
        why = f"no folder for compiled code can be written: each worker compiles its own: {REMEDY}"
        print_warnings([why])
        return
    with stage_progress(title="compiling", hidden=VOLUME.quiet) as show:
        compile_all(show)


def _summarise(result: BatchResult, seconds: float, as_json: bool, index: str) -> None:
    skipped = result.skipped
    counts = {
        "baked": result.count("ok") - skipped,
        "skipped": skipped,
        "failed": result.count("failed"),
        "left": result.count("left"),
    }
    if as_json:
        end = {"event": "end", **counts, "stopped": result.stopped, "seconds": round(seconds, 3)}
        print_json_line(end)
        return
    if result.stopped:
        print_error(f"stopped: {result.stopped}")
    told = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    warned = sum(bool(row.get("warnings")) for row in result.rows)
    notes = f", {warned} with warnings" if warned else ""
    say_unless_quiet(f"{told}{notes} in {seconds:.1f} s: {index}")
