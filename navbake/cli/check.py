"""The commands that check grids and an installation: `verify`, `audit`, `doctor`."""

from __future__ import annotations

import os
import platform
import re
import sys
import time
from collections.abc import Iterator
from ctypes.util import find_library
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import TYPE_CHECKING

from typer import BadParameter, Exit

import navbake
from navbake import samples
from navbake._version import __version__
from navbake.cli import options
from navbake.cli.options import (
    PICTURE_OPTION,
    SCENE_OPTION,
    GridFile,
    ModelPath,
    argument,
    flag,
    option,
)
from navbake.cli.printing import add_facts, print_tables, say
from navbake.errors import NavbakeError, count_of
from navbake.formats.convert import read_as
from navbake.formats.format_table import GRID_FORMATS
from navbake.lazy import lazy
from navbake.lengths import format_length
from navbake.views.tables import make_table

if TYPE_CHECKING:
    from navbake.verifier.report import VerifyReport

compiled = lazy("navbake.compiled")  # numba loads slowly
config = lazy("navbake.config.settings")
pipeline = lazy("navbake.baker.bake.pipeline")
threads = lazy("navbake.threads")

VERIFY_COLUMNS = {
    "level": "name",
    "cells": "cells",
    "free, free": "free_free",
    "blocked, blocked": "blocked_blocked",
    "free, touches": "free_touches",
    "blocked, apart": "blocked_apart",
    "disputed": "disputed",
    "floors": "floors",
    "in cracks": "in_cracks",
    "floors off": "floors_off",
    "places lost": "lost",
}
"""Heading of a column -> the attribute of `LevelCounts` in it.

In a heading such as ``free, touches``, the first word is the grid's verdict on the cells, the
second the scene's.
"""
SAMPLED_CELLS = 100_000  # how many cells `verify` looks at by default
MAX_LISTED_FINDINGS = 20  # how many disagreements `verify`, and remarks `audit`, print
# endings of graphs of routes that no grid has that is read
ROUTE_ENDINGS = (".geojson", ".graphml", ".gml", ".lif")
# endings of grids of other programs, which `audit` reads as `convert` does
MAP_ENDINGS = tuple(
    ending
    for form in GRID_FORMATS
    if form.read and form.name != "navgrid"
    for ending in form.endings
)
CHECKED_SAMPLE = "apartment"  # the sample that `doctor` bakes
# a bake of the sample takes longer only if something is wrong: usual are 0.05 to 0.2 s [s]
USUAL_BAKE_SECONDS = 0.5
# a requirement of a package: its name, and the extra that needs it
REQUIREMENT = re.compile(r"""([\w.-]+)[^;]*(?:;.*?extra == ["'](?P<extra>[\w-]+)["'])?""")


def verify(
    grid: GridFile,
    sample: int = option("N", "How many cells to look at.", default=SAMPLED_CELLS, min=1),
    all_cells: bool = flag("--all", "Look at all cells."),
    seed: int = option("N", "Seed of the sample and of the paths.", default=0, min=0),
    scene: Path | None = SCENE_OPTION,
    radius: float | None = option(
        "METRES", "Agent's radius [m]; inflates the grid, if need be.  [default: the grid's]"
    ),
    paths: int = option("N", "Sweep the agent along this many paths.", default=0, min=0),
    tolerance: float = option(
        "METRES",
        "What touches by less than this is free [m], > 0, at most a quarter of a cell.",
        default=1e-4,
    ),
    model_path: ModelPath = None,
    output: Path | None = PICTURE_OPTION,
    force: bool = flag("--force", "Compare with a scene that isn't the one that was baked."),
) -> None:
    """Compare a grid with its scene by MuJoCo and FCL.

    The exit status is 1 if they disagree.

    Example: navbake verify house.grid.json --all
    """
    if all_cells and sample != SAMPLED_CELLS:
        raise BadParameter("expected one of them", param_hint="--sample, --all")
    if output is not None:
        options.check_output(
            output, *options.PICTURE_SUFFIXES, inputs=[grid, *([scene] if scene else [])]
        )
    from navbake.verifier.verify import verify as compare_with_scene  # loads MuJoCo

    report = compare_with_scene(
        grid,
        scene,
        sample=None if all_cells else sample,
        seed=seed,
        radius=radius,
        paths=paths,
        tolerance=tolerance,
        force=force,
        model_path=options.list_model_folders(model_path),
    )
    add_facts(**report.to_json())
    with options.keep_stdout_for(output):
        _print_report(report)
    if output is not None:
        marks = [
            (finding.level, *finding.position[:2], finding.kind) for finding in report.findings
        ]
        nav_grid = navbake.load(grid)
        options.write_picture(nav_grid, output, layers=("occupancy",), marks=marks)
    if not report.ok:
        raise Exit(1)


def _print_report(report: VerifyReport) -> None:
    levels = [*report.levels, report.total] if report.levels[1:] else report.levels
    rows = [[getattr(level, key) for key in VERIFY_COLUMNS.values()] for level in levels]
    print_tables(make_table(tuple(VERIFY_COLUMNS), rows, numbers=VERIFY_COLUMNS.keys() - {"level"}))
    if report.sweeps is not None:
        sweeps = report.sweeps
        say(
            f"{sweeps.paths} paths of {sweeps.length:.0f} m in all swept with {sweeps.radius:g} m: "
            f"{sweeps.touching} touch, {sweeps.beside} meet what lies within a step of their ends"
        )
    for note in report.notes:
        say(f"note: {note}")
    for finding in report.findings[:MAX_LISTED_FINDINGS]:
        position_text = ", ".join(format_length(value, 3) for value in finding.position)
        cell_text = (
            "" if finding.cell is None else f", row {finding.cell[0]}, col {finding.cell[1]}"
        )
        place_text = f"level {finding.level}{cell_text} ({position_text})"
        say(f"{finding.kind}: {place_text}: {finding.text}")
    if len(report.findings) > MAX_LISTED_FINDINGS:
        say(f"and {len(report.findings) - MAX_LISTED_FINDINGS} more: --json lists them")
    verdict = "agree" if report.ok else f"disagree at {len(report.findings)} places"
    say(f"grid and scene {verdict}, at {report.checked:,} of {report.num_cells:,} cells")


def audit(
    grid: Path = argument("GRID", "A NavGrid file, a map, or with --grid a graph of routes."),
    output: Path | None = PICTURE_OPTION,
    routes_grid: Path | None = option(
        "FILE", "GRID is a graph of routes on this grid or map.", "--grid"
    ),
    radius: float | None = option(
        "METRES", "Radius that lanes have to be free for [m].  [default: that of the graph]"
    ),
) -> None:
    """Check a grid of any program, or a graph of routes, for faults that a person would notice.

    The scene is not needed. The exit status is 1 if there are errors, 0 if there are only remarks.

    Example: navbake audit house.grid.json -o remarks.png
    """
    options.refuse_unused(
        "--radius", radius is not None, has_effect=routes_grid is not None, purpose="--grid"
    )
    if routes_grid is None and grid.name.lower().endswith(ROUTE_ENDINGS):
        raise BadParameter(f"{grid} is a graph of routes: add --grid GRID", param_hint="GRID")
    if output is not None:
        inputs = [grid] if routes_grid is None else [grid, routes_grid]
        options.check_output(output, *options.PICTURE_SUFFIXES, inputs=inputs)
    from navbake.auditor.audit import audit as audit_grid  # loads numpy

    if routes_grid is None:
        is_map = grid.name.lower().endswith(MAP_ENDINGS)
        nav_grid = read_as(grid) if is_map else navbake.load(grid)
        report = audit_grid(nav_grid)
    else:
        from navbake.auditor.routes import audit_routes  # loads it too

        nav_grid = read_as(routes_grid)
        report = audit_routes(grid, nav_grid, radius=radius)
    add_facts(**report.to_json())
    with options.keep_stdout_for(output):
        for remark in report.remarks[:MAX_LISTED_FINDINGS]:
            say(remark)
        if len(report.remarks) > MAX_LISTED_FINDINGS:
            say(f"and {len(report.remarks) - MAX_LISTED_FINDINGS} more: --json lists them")
        if routes_grid is not None and radius is None and not report.ok and not nav_grid.radius:
            say(f"{routes_grid} states no radius: --radius 0 if its cells are inflated already")
        errors_text = count_of(len(report.errors), "error")
        remarks_text = count_of(len(report.remarks) - len(report.errors), "remark")
        say(f"{len(report.checks)} checks: {errors_text}, {remarks_text}")
    if output is not None:
        marks = [
            (-1 if remark.level is None else remark.level, *remark.place[:2], remark.check)
            for remark in report.remarks
            if remark.place is not None
        ]
        options.write_picture(nav_grid, output, layers=("occupancy",), marks=marks)
    if not report.ok:
        raise Exit(1)


def doctor(no_bake: bool = flag("--no-bake", "Leave out the bake.")) -> None:
    """Print what is installed and whether it works, to paste into an issue.

    Versions, the folder of compiled code, cores, OpenGL, extras with the command that installs
    each, and the time of a sample's bake. The first bake on a machine compiles for half a minute.
    The exit status is 1 if the bake fails.

    Example: navbake doctor
    """
    text_by_name: dict[str, str] = {}
    name = ""
    for line_name, line_text in _describe_installation():
        say(f"{line_name:<12} {line_text}")
        if line_name:
            name = line_name
            text_by_name[name] = line_text
        else:  # the line goes on with the one above
            text_by_name[name] += f"; {line_text}"
    add_facts(version=__version__, installation=text_by_name, bake=None)
    if no_bake:
        return
    settings = config.load_config(samples.path(CHECKED_SAMPLE))
    bake_seconds = []
    try:
        for _ in range(2):  # the first bake may compile
            start_time = time.perf_counter()
            grid = pipeline.bake(settings)
            bake_seconds.append(time.perf_counter() - start_time)
    except NavbakeError as error:
        raise NavbakeError(f"the sample {CHECKED_SAMPLE!r} can't be baked: {error}") from error
    num_free = sum(int(level.free.sum()) for level in grid.levels)
    is_slow = bake_seconds[1] > USUAL_BAKE_SECONDS
    speed_text = f"SLOW: usually below {USUAL_BAKE_SECONDS} s" if is_slow else "as usual"
    first_seconds, second_seconds = bake_seconds
    times_text = f"{first_seconds:.2f} s, again {second_seconds:.2f} s ({speed_text})"
    line_text = f"{CHECKED_SAMPLE}: {times_text}, {num_free} free cells"
    say(f"{'bake':<12} {line_text}")
    bake_facts = {
        "scene_id": CHECKED_SAMPLE,
        "seconds": bake_seconds,
        "is_slow": is_slow,
        "num_free": num_free,
    }
    add_facts(bake=bake_facts)


def _installed_version(package: str) -> str | None:
    """Return the version of an installed package; None if it isn't installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _describe_installation() -> Iterator[tuple[str, str]]:
    """Yield the lines that `doctor` prints on versions, the machine, compiled code and extras.

    Each is a pair of a name and a text.
    """
    # extra -> packages that it needs; "" -> packages that navbake always needs
    packages_by_extra: dict[str, list[str]] = {"": []}
    for requirement in requires("navbake") or ():
        match = REQUIREMENT.match(requirement)
        assert match is not None
        packages_by_extra.setdefault(match["extra"] or "", []).append(match[1])
    yield "navbake", f"{__version__} in {Path(samples.__file__).parent}"
    yield "python", f"{platform.python_version()} in {sys.executable}"
    yield "system", f"{platform.platform()}, {platform.machine()}"
    yield (
        "packages",
        ", ".join(
            f"{name} {_installed_version(name) or 'MISSING'}" for name in packages_by_extra[""]
        ),
    )
    num_usable_cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    )
    yield (
        "cores",
        f"{os.cpu_count()}, usable {num_usable_cores}, threads of a bake {threads.num_threads()}",
    )
    libraries_text = ", ".join(filter(find_library, ("EGL", "OSMesa", "GL"))) or "none"
    display_name = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or "none"
    yield (
        "OpenGL",
        f"libraries {libraries_text}, display {display_name}; the browser of `view` draws by it",
    )
    if (folder := compiled.cache_folder()) is None:
        yield (
            "compiled",
            f"NO FOLDER CAN BE WRITTEN: each process compiles anew; {compiled.CACHE_REMEDY}",
        )
    else:
        kernel_entries = [entry for group in compiled.read_kernel_list() for entry in group]
        num_compiled = len(kernel_entries) - len(compiled.list_uncompiled(kernel_entries))
        compiled_files = [path for path in folder.rglob("*.nb?") if path.is_file()]
        state_text = f"{num_compiled} of {len(kernel_entries)} functions are compiled"
        yield "compiled", f"{folder}, {_format_megabytes(compiled_files)} MB: {state_text}"
        used_folders = {Path(kernel.stats.cache_path).parent for kernel in compiled.KERNELS}
        unused_files = [path for path in compiled_files if path.parent.parent not in used_folders]
        if unused_files:
            num_folders = len({path.parent.parent for path in unused_files})
            yield (
                "",
                f"{_format_megabytes(unused_files)} MB in {num_folders} folders are of other "
                "sources: not used",
            )
    packages_by_extra.pop("")
    for extra in ("test", "bench", "docs", "tensors-test"):  # of developers
        packages_by_extra.pop(extra, None)
    for extra, packages in sorted(packages_by_extra.items()):
        version_by_package = {name: _installed_version(name) for name in packages}
        installed_text = ", ".join(
            f"{name} {version_text}"
            for name, version_text in version_by_package.items()
            if version_text
        )
        missing_text = ", ".join(
            name for name, version_text in version_by_package.items() if not version_text
        )
        install_hint = (
            f'missing {missing_text}: pip install "navbake[{extra}]"' if missing_text else ""
        )
        yield f"[{extra}]", "; ".join(filter(None, [installed_text, install_hint]))


def _format_megabytes(files: list[Path]) -> str:
    """Return the total size of files [MB] as text."""
    return f"{sum(path.stat().st_size for path in files) / 1e6:.1f}"
