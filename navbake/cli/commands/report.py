"""The command that makes a page of grids: `navbake report`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from typer import Argument, BadParameter, Option

import navbake
from navbake.cli.commands.batch import INDEX, draw_missing_thumbnails
from navbake.cli.options import STDOUT, check_output, refuse_unused, write_stdout
from navbake.cli.printing import say_unless_quiet
from navbake.errors import ConfigError

# Functions import what they need when they run: --help loads no numpy.


def report(
    grids: Annotated[
        list[Path], Argument(metavar="GRID|FOLDER", help="NavGrid files, or the folder of a batch.")
    ],
    output: Path | None = Option(
        None,
        "-o",
        "--output",
        metavar="HTML",
        help="Page to write; - for stdout. Of a batch, index.html in its folder unless given.",
    ),
    with_audit: bool = Option(False, "--audit", help="Audit the grids, and add what is found."),
    verifications: list[Path] | None = Option(
        None,
        "--verify",
        metavar="JSON",
        help="Add what `navbake verify --json` printed of a grid. Once for each GRID, in order.",
    ),
) -> None:
    """Make a page that shows grids in a browser.

    It needs neither a server nor the network. It shows each level's layers, tells of the cell
    under the pointer, and lists rooms, doors, links, settings and timings. Of two grids it shows
    what differs, too. Of a batch's folder it shows all scenes, failures by reason, and
    distributions of free areas and times.

    Example: navbake report before.grid.json after.grid.json -o report.html
    """
    from navbake.auditor.audit import audit
    from navbake.formats.source import write_bytes
    from navbake.views.report.report import read_verification, render_report

    if any(os.path.isdir(path) for path in grids):
        refuse_unused(
            ("--audit", with_audit, False, "grids: a batch audits its grids itself"),
            ("--verify", bool(verifications), False, "grids"),
        )
        _report_on_batch(grids, output)
        return
    if output is None:
        raise BadParameter("expected a page to write", param_hint="-o")
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


def _report_on_batch(folders: list[Path], output: Path | None) -> None:
    """Write the page of a batch from its index; thumbnails that are missing are drawn."""
    from navbake.batch.page.page import NAME, write_page, write_page_beside

    if len(folders) > 1 or not os.path.isfile(folders[0] / INDEX):
        named = ", ".join(map(str, folders))
        raise ConfigError(f"expected grids, or one folder of a batch with {INDEX}, got {named}")
    page = folders[0] / NAME if output is None else output
    if page == STDOUT:
        raise BadParameter("expected a file: the page of a batch has links", param_hint="-o")
    check_output(page, ".html", ".htm", inputs=[folders[0] / INDEX])
    draw_missing_thumbnails(folders[0])
    if output is None:
        write_page(folders[0])
    else:
        write_page_beside(folders[0], page)
    say_unless_quiet(page)


def _short_name(path: Path) -> str:
    """A file's name without the endings of grids."""
    name = path.name
    for suffix in (".gz", ".json", ".grid"):
        name = name.removesuffix(suffix)
    return name or path.name
