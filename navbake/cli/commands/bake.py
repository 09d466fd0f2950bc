"""The command `navbake bake`."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from typer import Argument, BadParameter, Exit

from navbake.cli.options import (
    GRIDS,
    STDOUT,
    Overrides,
    beside_output,
    check_output,
    check_scene,
    flag,
    option,
    refuse_unused,
    write_stdout,
)
from navbake.cli.printing import VOLUME, print_error, print_tables, print_warnings, say
from navbake.errors import ConfigError, NavbakeError
from navbake.views.tables import level_table

if TYPE_CHECKING:
    from navbake.config.settings import BakeConfig

# Functions import the baker and the settings when they run: --help loads neither MuJoCo nor numpy.


FIELDS = ("id", "stem", "parent")  # of the names of grids
FIELD = re.compile(r"\{([^{}]*)\}")


class Isolation(NamedTuple):
    """Options that keep MuJoCo's compiler in a process of its own."""

    isolate: bool = flag(
        "--isolate", "Compile scenes in a process of its own: a crash of MuJoCo is an error then."
    )
    seconds: float | None = option(
        "SECONDS", "How long that may take [s].  [default: 60]", "--isolate-seconds", min=0.0
    )
    memory: float | None = option(
        "GIB",
        "How much memory it may take, on Linux [GiB].  [default: 4]",
        "--isolate-memory",
        min=0.0,
    )


def bake(
    configs: list[Path] = Argument(
        ...,
        metavar="CONFIG",
        callback=check_scene,
        help="Settings (YAML), or a scene file for default settings.",
    ),
    output: str | None = option(
        "FILE|FOLDER",
        "File to write (.json or .json.gz), - for stdout, or a folder: one that exists, or a "
        "new one that ends in /.  [default: the settings' output, or <id>.grid.json in the "
        "current folder]",
        "-o",
        "--output",
    ),
    name: str | None = option(
        "NAME",
        "What to call the files in the folder, without .grid.json: {id} is the scene's, "
        "{stem} CONFIG's, {parent} that of its folder.  [default: {id}]",
    ),
    overrides: Overrides = None,
    threads: int | None = option("N", "Number of threads.  [default: all cores]", min=1),
    no_timings: bool = flag(
        "--no-timings", "Leave out timings, so that two bakes give the same bytes."
    ),
    *,
    isolation: Isolation,
) -> None:
    """Bake scenes into navigation grids.

    Of several CONFIGs, each is baked even if another one fails.

    Example: navbake bake house.yaml --set grid.cell_size=0.05
    """
    is_file = output is not None and not is_folder(output)
    if len(configs) > 1 and is_file:
        raise BadParameter(
            f"with several CONFIGs, expected a folder, got {output} (a new one ends in /)",
            param_hint="-o",
        )
    if is_file and output != str(STDOUT) and not Path(output or "").suffix:
        raise BadParameter(
            f"expected a name that ends in {', '.join(GRIDS)}, got {output}: a new folder is "
            f"written {output}/",
            param_hint="-o",
        )
    refuse_unused(("--name", name is not None, not is_file, "files in a folder"))
    if name is not None:
        check_name(name)
    refuse_unused(
        ("--isolate-seconds", isolation.seconds is not None, isolation.isolate, "--isolate"),
        ("--isolate-memory", isolation.memory is not None, isolation.isolate, "--isolate"),
    )
    from navbake.config.settings import load_config

    jobs: list[tuple[Path, BakeConfig]] = []
    failed: list[Path] = []
    for path in configs:
        with _going_on(path, failed, len(configs)):
            jobs.append((path, load_config(path, overrides or [])))
    written: set[Path] = set()
    for (path, config), target in zip(jobs, lay_out(jobs, output, name), strict=True):
        with _going_on(path, failed, len(configs)):
            if target.resolve() in written:
                raise ConfigError(
                    f"{target} was written for another scene: give each its own `scene.id`, or "
                    "name files by --name, as in --name '{parent}-{stem}'"
                )
            is_own, inputs = target == config.output, (path, *config.inputs)
            suffixes, may_make = () if is_own else GRIDS, not (is_file or is_own)
            check_output(target, *suffixes, inputs=inputs, may_make_folder=may_make)
            if not target.name.lower().endswith(GRIDS) and target != STDOUT:
                endings = ", ".join(GRIDS)
                raise ConfigError(
                    f"expected a name that ends in {endings} as `output` in {path}, got {target}"
                )
            _bake_one(config, target, threads, isolation, not no_timings)
            written.add(target.resolve())
    if failed:
        print_error(f"{len(failed)} of {len(configs)} failed")
        raise Exit(1)


@contextmanager
def _going_on(path: Path, failed: list[Path], num_configs: int) -> Iterator[None]:
    """Print an error and note who failed, where others are to be baked; else raise it."""
    try:
        yield
    except NavbakeError as error:
        if num_configs == 1:
            raise
        failed.append(path)
        culprit = "" if str(path) in str(error) else f"{path}: "
        print_error(f"{culprit}{error}")


def _bake_one(
    config: BakeConfig, target: Path, threads: int | None, isolation: Isolation, with_timings: bool
) -> None:
    from navbake.baker.pipeline import run_bake
    from navbake.baker.scene.isolated import CompileLimits
    from navbake.cli.progress import progress_bars
    from navbake.formats.navgrid import dumps_navgrid, write_navgrid
    from navbake.views.describe import describe

    _, *given = isolation._asdict().items()
    stated = {name: value for name, value in given if value is not None}
    limits = CompileLimits(**stated) if isolation.isolate else None
    with progress_bars(str(config.scene.id), VOLUME.quiet) as progress:
        result = run_bake(config, threads=threads, progress=progress, limits=limits)
    if not with_timings:
        result.grid.timings = {}
    begin = time.perf_counter()
    if target == STDOUT:
        write_stdout(dumps_navgrid(result.grid))
    else:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_navgrid(result.grid, target)
    result.timings["write"] = time.perf_counter() - begin
    if VOLUME.quiet:
        print_warnings(result.warnings)
        return
    with beside_output(target):
        if target != STDOUT:
            say(target)
        print_tables(level_table(describe(result.grid)))
        for warning in result.warnings:
            say(f"warning: {warning}")
        stages = ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in result.timings.items())
        print(f"{sum(result.timings.values()):.2f} s: {stages}")


# --- where the grids of several scenes are written ------------------------------------------------


def is_folder(output: str) -> bool:
    """Whether an output is a folder: one that exists, or a new one that ends in a slash."""
    return output.endswith(("/", os.sep)) or os.path.isdir(output)


def check_name(name: str) -> None:
    """Refuse a name with unknown fields, or one that leads out of the folder."""
    message, unknown = "", [field for field in FIELD.findall(name) if field not in FIELDS]
    if unknown:
        known = ", ".join(f"{{{field}}}" for field in FIELDS)
        message = f"expected fields out of {known}, got {{{unknown[0]}}}"
    elif not name or Path(name).is_absolute() or ".." in Path(name).parts or name.endswith("/"):
        message = f"expected the name of a file in the folder, got {name!r}"
    if message:
        raise BadParameter(message, param_hint="--name")


def lay_out(
    jobs: Sequence[tuple[Path, BakeConfig]], output: str | None, name: str | None
) -> list[Path]:
    """Find the file that the grid of each CONFIG and its settings is written to.

    That is `output`, or a file in that folder, or what the settings say, or a file in the current
    folder. In a folder, files are called by `name`, see `check_name`; without one by the scene's
    id.
    """
    if output is not None and not is_folder(output):
        return [Path(output) for _ in jobs]
    targets = []
    for path, config in jobs:
        parent = path.resolve().parent.name
        values = {"id": str(config.scene.id), "stem": path.stem, "parent": parent}
        filled = FIELD.sub(lambda field, values=values: values[field[1]], name or "{id}")  # type: ignore[misc]
        if not filled:
            raise ConfigError(f"`--name {name}` gives {path} no name")
        own = config.output if output is None and name is None else None
        targets.append(own or Path(output or "") / f"{filled}.grid.json")
    return targets
