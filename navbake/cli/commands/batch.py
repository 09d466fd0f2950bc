"""The command `navbake batch`."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from typer import Argument, Exit, Option

from navbake.cli.options import Overrides, check_overrides
from navbake.cli.printing import VOLUME, print_error, print_json, say

if TYPE_CHECKING:
    from navbake.batch.batch import BatchResult
    from navbake.types import Json

# Functions import the baker and the settings when they run: --help loads neither MuJoCo nor numpy.

EVERY = 0.2  # how often the progress line is drawn [s]
SHOWN = 20  # failures that are printed one by one


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


def batch(
    limits: PerScene,
    sources: list[str] = Argument(
        ...,
        metavar="SOURCE",
        help="Scenes or settings (YAML), patterns in quotes, or lists: .txt, .csv, .jsonl, "
        ".parquet.",
    ),
    output: Path = Option(
        ..., "-o", "--output", metavar="FOLDER", help="Folder to write into, a folder a scene."
    ),
    config: Path | None = Option(
        None, "--config", metavar="YAML", help="Settings of all scenes; `scene` may be missing."
    ),
    make: list[str] | None = Option(
        None,
        "--make",
        metavar="WHAT",
        help="What to make of each scene besides its grid. May be repeated.",
    ),
    jobs: int = Option(1, "-j", "--jobs", min=1, help="Number of worker processes."),
    max_failures: int | None = Option(
        None, "--max-failures", metavar="N", min=0, help="Stop when more than N scenes failed."
    ),
    as_json: bool = Option(False, "--json", help="Print a line of JSON for each scene as it ends."),
    overrides: Overrides = None,
) -> None:
    """Bake many scenes; what is done already is skipped.

    The folder gets an index, index.jsonl. A scene that fails, hangs or crashes costs itself
    alone. The exit status is 1 if any failed.

    Example: navbake batch "scenes/*.xml" -o grids --jobs 8 --time-limit 300
    """
    from navbake.batch.batch import run_batch
    from navbake.batch.crew import JobLimits
    from navbake.batch.manifest import list_jobs
    from navbake.config.yaml_text import read_yaml

    listed = list_jobs(sources)
    settings = None if config is None else read_yaml(config)
    with _progress(len(listed), as_json) as watch, _terminated_as_interrupted():
        result = run_batch(
            listed,
            output,
            settings=settings,
            overrides=check_overrides(overrides),
            products=make or (),
            workers=jobs,
            limits=JobLimits(limits.time_limit, limits.memory_limit),
            retries=limits.retries,
            max_failures=max_failures,
            watch=watch,
        )
    if not as_json:
        _summarise(result, output)
    if result.failed or result.stopped:
        raise Exit(1)
