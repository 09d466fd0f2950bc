"""The command `navbake audit`."""

from __future__ import annotations

from pathlib import Path

from typer import Exit, Option

import navbake
from navbake.cli.options import AsJson, GridFile, beside_output, check_output
from navbake.cli.pictures import write_marked
from navbake.cli.printing import print_json


def audit(
    grid: GridFile,
    as_json: AsJson = False,
    output: Path | None = Option(
        None, "-o", "--output", metavar="PNG", help="Draw the places; - for stdout."
    ),
) -> None:
    """Look at a grid of any program for what a person would notice, without its scene.

    The exit status is 1 if there are errors, 0 if there are only remarks.
    """
    if output is not None:
        check_output(output, ".png", inputs=[grid])
    from navbake.auditor.audit import audit as look_at  # loads numpy

    content = navbake.load(grid)
    report = look_at(content)
    with beside_output(output):
        if as_json:
            print_json(report.to_json())
        else:
            for remark in report.remarks:
                print(remark)
            num_errors = len(report.errors)
            others = len(report.remarks) - num_errors
            print(f"{len(report.checks)} checks: {num_errors} errors, {others} remarks")
    if output is not None:
        placed = [r for r in report.remarks if r.place is not None]
        marks = [(-1 if r.level is None else r.level, *r.place[:2], r.check) for r in placed]
        write_marked(content, output, marks)
    if not report.ok:
        raise Exit(1)
