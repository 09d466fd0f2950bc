"""Writes a report on grids: one page, which a browser opens without a server or the network."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from navbake.errors import QueryError, printable
from navbake.formats.source import write_bytes
from navbake.navgrid.grid import NavGrid
from navbake.types import Json
from navbake.views.report.changes import describe_changes
from navbake.views.report.content import describe_grid
from navbake.views.report.page import make_page

if TYPE_CHECKING:
    from navbake.auditor.report import AuditReport


def write_report(
    grids: NavGrid | Sequence[NavGrid],
    path: str | PathLike[str],
    *,
    names: Sequence[str] | None = None,
    audits: Sequence[AuditReport | None] | None = None,
    verifications: Sequence[Json | None] | None = None,
) -> Path:
    """Write what `render_report` makes, whole or not at all, and return the path.

    Raises:
        FormatError: it can't be written.
        QueryError: see `render_report`.
    """
    content = render_report(grids, names=names, audits=audits, verifications=verifications)
    write_bytes(content, path)
    return Path(path)


def render_report(
    grids: NavGrid | Sequence[NavGrid],
    *,
    names: Sequence[str] | None = None,
    audits: Sequence[AuditReport | None] | None = None,
    verifications: Sequence[Json | None] | None = None,
) -> bytes:
    """Make a report as one HTML page: maps to zoom, and tables. The same grids, the same bytes.

    Each level has its layers, and what is known of the cell under the pointer; floors and
    clearances are rounded to a millimetre. Of levels of more than `cells.MAX_SHOWN` cells, every
    n-th row and column is shown. With two grids, a third sheet shows what differs.

    Args:
        grids: one or more.
        names: what the page calls them; their scenes' names if None.
        audits: what an audit said of each, None for none.
        verifications: what `VerifyReport.to_json` gave of each, None for none.

    Raises:
        QueryError: there is no grid, or another number of names, audits or verifications, or a
            verification is of another grid, as far as its scene's name and the cells tell.
    """
    grids = [grids] if not isinstance(grids, Sequence) else list(grids)
    if not grids:
        raise QueryError("expected at least one grid to report on, got none")
    for what, given in (("names", names), ("audits", audits), ("verifications", verifications)):
        if given is not None and len(given) != len(grids):
            raise QueryError(f"expected as many {what} as grids, {len(grids)}, got {len(given)}")
    for grid, verification in zip(grids, verifications or (), strict=bool(verifications)):
        _check_is_of(grid, verification)
    shown = _tell_apart(names or [grid.scene_id or "grid" for grid in grids])
    sheets = [
        describe_grid(grid, name, audit, verification)
        for grid, name, audit, verification in zip(
            grids,
            shown,
            audits or [None] * len(grids),
            verifications or [None] * len(grids),
            strict=True,
        )
    ]
    if len(grids) == 2:
        sheets.append(describe_changes(grids[0], grids[1], shown))
    return make_page({"title": ", ".join(shown), "sheets": sheets})


def _check_is_of(grid: NavGrid, verification: Json | None) -> None:
    if verification is None:
        return
    cells = sum(level.width * level.height for level in grid.levels)
    stated = verification.get("sceneId"), verification["cells"]
    if stated != (grid.scene_id, cells):
        raise QueryError(
            f"expected the verification of {grid.scene_id!r}, {cells} cells, got one of "
            f"{stated[0]!r}, {stated[1]} cells: give them in the order of the grids"
        )


def _tell_apart(names: Sequence[str]) -> list[str]:
    """Names in print, numbered where two are the same."""
    shown = [printable(name) for name in names]
    return [
        name if shown.count(name) == 1 else f"{name} ({shown[: i + 1].count(name)})"
        for i, name in enumerate(shown)
    ]
