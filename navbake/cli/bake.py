"""The command `navbake bake`."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from typer import Argument, BadParameter, Exit, Option

from navbake.cli.options import Overrides, check_output
from navbake.cli.printing import level_table, print_error, print_tables, print_warnings
from navbake.cli.warm_up import tell_if_cold
from navbake.errors import ConfigError, NavbakeError

if TYPE_CHECKING:
    from navbake.config.settings import BakeConfig

# Functions import the baker and the settings when they run: --help loads neither MuJoCo nor numpy.


def bake(
    configs: list[Path] = Argument(
        ..., metavar="CONFIG", help="Settings (YAML), or a scene file for default settings."
    ),
    output: str | None = Option(
        None,
        "-o",
        "--output",
        metavar="OUT",
        help="File to write, or a folder: one that exists, or a new one that ends in /.  "
        "[default: the settings' output, or <id>.grid.json in the current folder]",
    ),
    overrides: Overrides = None,
    threads: int | None = Option(None, min=1, help="Number of threads.  [default: all cores]"),
    quiet: bool = Option(False, "--quiet", "-q", help="Print only warnings and errors."),
) -> None:
    """Bake scenes into navigation grids.

    Of several CONFIGs, each is baked even if another one fails.
    """
    if len(configs) > 1 and output is not None and not _is_folder(output):
        raise BadParameter(
            f"with several CONFIGs, expected a folder, got {output} (a new one ends in /)",
            param_hint="-o",
        )
    written: set[Path] = set()
    num_failed = 0
    for path in configs:
        try:
            config, target = _check(path, output, overrides or [], written)
            _bake_one(config, target, threads, quiet)
        except NavbakeError as error:
            if len(configs) == 1:
                raise
            num_failed += 1
            culprit = "" if str(path) in str(error) else f"{path}: "
            print_error(f"{culprit}{error}")
        else:
            written.add(target.resolve())
    if num_failed:
        print_error(f"{num_failed} of {len(configs)} failed")
        raise Exit(1)


def _check(
    path: Path, output: str | None, overrides: Sequence[str], written: set[Path]
) -> tuple[BakeConfig, Path]:
    """Read the settings, and refuse an output that can't be written, before any work is done."""
    from navbake.config.settings import load_config

    config = load_config(path, overrides)
    target = config.output or Path(f"{config.scene.id}.grid.json")
    is_in_folder = output is not None and _is_folder(output)
    if output is not None:
        target = Path(output, f"{config.scene.id}.grid.json") if is_in_folder else Path(output)
    check_output(target, may_make_folder=is_in_folder)
    if target.resolve() in written:
        raise ConfigError(f"{target} was written for another scene: give each its own `scene.id`")
    if target.resolve() in (path.resolve(), config.scene.path.resolve()):
        raise ConfigError(f"expected an output apart from the inputs, got {target}")
    return config, target


def _is_folder(output: str) -> bool:
    return output.endswith(("/", os.sep)) or os.path.isdir(output)


def _bake_one(config: BakeConfig, target: Path, threads: int | None, quiet: bool) -> None:
    from navbake.baker.pipeline import run_bake
    from navbake.cli.progress import stage_progress
    from navbake.views.info import describe

    if not quiet:
        tell_if_cold()
    with stage_progress(title=config.scene.id, hidden=quiet) as progress:
        result = run_bake(config, threads=threads, progress=progress)
    begin = time.perf_counter()
    target.parent.mkdir(parents=True, exist_ok=True)
    result.grid.save(target)
    result.timings["write"] = time.perf_counter() - begin
    if quiet:
        print_warnings(result.warnings)
        return
    print(target)
    print_tables(level_table(describe(result.grid)))
    for warning in result.warnings:
        print(f"warning: {warning}")
    stages = ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in result.timings.items())
    print(f"{sum(result.timings.values()):.2f} s: {stages}")
