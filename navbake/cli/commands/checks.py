"""The commands that check a grid: `navbake verify` and `navbake audit`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from typer import BadParameter, Exit

import navbake
from navbake.cli.options import (
    AsJson,
    GridFile,
    beside_output,
    check_output,
    flag,
    option,
    write_picture,
)
from navbake.cli.printing import print_json, print_tables, say, verify_table

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.verifier.report import VerifyReport

SAMPLE = 100_000
SHOWN = 20  # disagreements that are printed one by one


class Sample(NamedTuple):
    """Which cells to look at."""

    sample: int = option("N", "How many cells to look at, >= 1.", default=SAMPLE)
    every: bool = flag("--all", "Look at all cells.")
    seed: int = option("N", "Seed of the sample and of the paths.", default=0, min=0)


def verify(
    grid: GridFile,
    which: Sample,
    scene: Path | None = option(
        "SCENE|CONFIG",
        "The scene, or the settings of the bake (YAML).  [default: the file that the grid "
        "names, beside it or in the current folder, or in `scenes` there]",
    ),
    radius: float | None = option(
        "METRES",
        "Radius of the agent on free cells and paths [m]; a grid that isn't inflated, or for "
        "less, is inflated for it.  [default: that of the grid]",
    ),
    paths: int = option("N", "Sweep the agent along this many paths.", default=0, min=0),
    tolerance: float = option(
        "METRES",
        "What touches by less than this is free [m], > 0, at most a quarter of a cell.",
        default=1e-4,
    ),
    as_json: AsJson = False,
    output: Path | None = option(
        "PNG|SVG", "Draw the disagreements; - for a PNG on stdout.", "-o", "--output"
    ),
    force: bool = flag("--force", "Compare with a scene that isn't the one that was baked."),
) -> None:
    """Compare a grid with its scene by MuJoCo and FCL.

    The exit status is 1 if they disagree.

    Example: navbake verify house.grid.json --all
    """
    if which.every and which.sample != SAMPLE:
        raise BadParameter("expected one of them", param_hint="--sample, --all")
    if output is not None:
        check_output(output, ".png", ".svg", inputs=[grid, *([scene] if scene else [])])
    from navbake.verifier.verify import verify as compare  # loads MuJoCo

    report = compare(
        grid,
        scene,
        sample=None if which.every else which.sample,
        seed=which.seed,
        radius=radius,
        paths=paths,
        tolerance=tolerance,
        force=force,
    )
    with beside_output(output):
        if as_json:
            print_json(report.to_json())
        else:
            _print(report)
    if output is not None:
        marks = [(found.level, *found.position[:2], found.kind) for found in report.findings]
        _write_marked(navbake.load(grid), output, marks)
    if not report.ok:
        raise Exit(1)


def _print(report: VerifyReport) -> None:
    print_tables(verify_table(report))
    if report.sweeps is not None:
        swept = report.sweeps
        say(
            f"{swept.paths} paths of {swept.length:.0f} m in all swept with {swept.radius:g} m: "
            f"{swept.touching} touch, {swept.beside} meet what lies within a step of their ends"
        )
    for note in report.notes:
        say(f"note: {note}")
    for found in report.findings[:SHOWN]:
        x, y, z = found.position
        cell = "" if found.cell is None else f", row {found.cell[0]}, col {found.cell[1]}"
        say(f"{found.kind}: level {found.level}{cell} ({x:.3f}, {y:.3f}, {z:.3f}): {found.text}")
    if len(report.findings) > SHOWN:
        say(f"and {len(report.findings) - SHOWN} more: --json lists them")
    share = f"{report.checked:,} of {report.num_cells:,} cells"
    verdict = "agree" if report.ok else f"disagree at {len(report.findings)} places"
    say(f"grid and scene {verdict}, at {share}")


def audit(
    grid: GridFile,
    as_json: AsJson = False,
    output: Path | None = option(
        "PNG|SVG", "Draw the places; - for a PNG on stdout.", "-o", "--output"
    ),
) -> None:
    """Look at a grid of any program for what a person would notice.

    It needs no scene. The exit status is 1 if there are errors, 0 if there are only remarks.

    Example: navbake audit house.grid.json -o remarks.png
    """
    if output is not None:
        check_output(output, ".png", ".svg", inputs=[grid])
    from navbake.auditor.audit import audit as look_at  # loads numpy
    from navbake.auditor.report import count_of  # loads it too

    content = navbake.load(grid)
    report = look_at(content)
    with beside_output(output):
        if as_json:
            print_json(report.to_json())
        else:
            for remark in report.remarks:
                say(remark)
            errors = count_of(len(report.errors), "error")
            others = count_of(len(report.remarks) - len(report.errors), "remark")
            say(f"{len(report.checks)} checks: {errors}, {others}")
    if output is not None:
        placed = [(-1 if r.level is None else r.level, r.place, r.check) for r in report.remarks]
        marks = [(level, *place[:2], kind) for level, place, kind in placed if place is not None]
        _write_marked(content, output, marks)
    if not report.ok:
        raise Exit(1)


def _write_marked(
    grid: NavGrid, output: Path, marks: Sequence[tuple[int, float, float, str]]
) -> None:
    """Draw a grid's occupancy with marks: level, world x and y [m], and what is there."""
    from navbake.views.plot import Mark  # loads numpy

    write_picture(grid, output, layers=("occupancy",), marks=[Mark(*mark) for mark in marks])
