"""The command `navbake verify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from typer import Exit, Option

import navbake
from navbake.cli.options import AsJson, GridFile, beside_output, check_output
from navbake.cli.pictures import write_marked
from navbake.cli.printing import print_json, print_tables, verify_table

if TYPE_CHECKING:
    from navbake.verifier.report import VerifyReport

SAMPLE = 100_000
SHOWN = 20  # disagreements that are printed one by one


def verify(
    grid: GridFile,
    scene: Path | None = Option(
        None,
        metavar="SCENE|CONFIG",
        help="The scene, or the settings of the bake (YAML).  [default: the file that the grid "
        "names, beside it or in the current folder]",
    ),
    sample: int = Option(SAMPLE, metavar="N", help="How many cells to look at, >= 1."),
    every: bool = Option(False, "--all", help="Look at all cells."),
    seed: int = Option(0, min=0, help="Seed of the sample and of the paths."),
    radius: float | None = Option(
        None,
        metavar="R",
        help="Radius of the agent on free cells and paths [m]; a grid that isn't inflated is "
        "inflated for it.  [default: that of the grid]",
    ),
    paths: int = Option(0, min=0, metavar="N", help="Sweep the agent along this many paths."),
    tolerance: float = Option(1e-4, help="What touches by less than this is free [m], > 0."),
    as_json: AsJson = False,
    output: Path | None = Option(
        None, "-o", "--output", metavar="PNG", help="Draw the disagreements; - for stdout."
    ),
    force: bool = Option(
        False, "--force", help="Compare with a scene that isn't the one that was baked."
    ),
) -> None:
    """Compare a grid with its scene by MuJoCo and FCL.

    The exit status is 1 if they disagree.
    """
    if output is not None:
        check_output(output, ".png", inputs=[grid, *([scene] if scene else [])])
    from navbake.verifier.verify import verify as compare  # loads MuJoCo

    report = compare(
        grid,
        scene,
        sample=None if every else sample,
        seed=seed,
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
        write_marked(navbake.load(grid), output, marks)
    if not report.ok:
        raise Exit(1)


def _print(report: VerifyReport) -> None:
    print_tables(verify_table(report))
    if report.sweeps is not None:
        swept = report.sweeps
        print(
            f"{swept.paths} paths of {swept.length:.0f} m in all swept with {swept.radius:g} m: "
            f"{swept.touching} touch, {swept.beside} meet what lies within a step of their ends"
        )
    for note in report.notes:
        print(f"note: {note}")
    for found in report.findings[:SHOWN]:
        x, y, z = found.position
        cell = "" if found.cell is None else f", row {found.cell[0]}, col {found.cell[1]}"
        print(f"{found.kind}: level {found.level}{cell} ({x:.3f}, {y:.3f}, {z:.3f}): {found.text}")
    if len(report.findings) > SHOWN:
        print(f"and {len(report.findings) - SHOWN} more: --json lists them")
    share = f"{report.checked:,} of {report.num_cells:,} cells"
    verdict = "agree" if report.ok else f"disagree at {len(report.findings)} places"
    print(f"grid and scene {verdict}, at {share}")
