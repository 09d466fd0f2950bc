"""The command that makes a page of grids: `navbake report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, BadParameter, Option

import navbake
from navbake.cli.options import STDOUT, check_output, write_stdout
from navbake.cli.printing import say_unless_quiet

# Functions import what they need when they run: --help loads no numpy.


def report(
    grids: Annotated[list[Path], Argument(metavar="GRID...", help="NavGrid files.")],
    output: Path = Option(
        ..., "-o", "--output", metavar="HTML", help="Page to write; - for stdout."
    ),
    with_audit: bool = Option(False, "--audit", help="Audit the grids, and add what is found."),
    verifications: list[Path] | None = Option(
        None,
        "--verify",
        metavar="JSON",
        help="Add what `navbake verify --json` printed of a grid. Once for each GRID, in order.",
    ),
) -> None:
    """Make a page that shows grids in a browser, without a server or the network.

    It shows each level's layers, tells of the cell under the pointer, and lists rooms, doors,
    links, settings and timings. Of two grids it shows what differs, too.

    Example: navbake report before.grid.json after.grid.json -o report.html
    """
    from navbake.auditor.audit import audit
    from navbake.formats.source import write_bytes
    from navbake.views.report.report import render_report
    from navbake.views.report.verification import read_verification

    if verifications and len(verifications) != len(grids):
        raise BadParameter(
            f"expected one for each GRID, {len(grids)}, got {len(verifications)}",
            param_hint="--verify",
        )
    check_output(output, ".html", ".htm", inputs=[*grids, *(verifications or ())])
    read = [read_verification(path) for path in verifications or ()]
    contents = [navbake.load(path) for path in grids]
    page = render_report(
        contents,
        names=[_short_name(path) for path in grids],
        audits=[audit(content) for content in contents] if with_audit else None,
        verifications=read or None,
    )
    if output == STDOUT:
        write_stdout(page)
    else:
        write_bytes(page, output)
        say_unless_quiet(output)


def _short_name(path: Path) -> str:
    """A file's name without the endings of grids."""
    name = path.name
    for suffix in (".gz", ".json", ".grid"):
        name = name.removesuffix(suffix)
    return name or path.name
