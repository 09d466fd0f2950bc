"""Writes a report on grids: one page, which a browser opens without a server or the network.

`maps.py` has what it shows of each level, `difference.py` what differs between two grids;
`report.html` and `report.js` show it.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import msgspec
import numpy as np

from navbake.errors import FormatError, QueryError, printable
from navbake.formats.source import read_object, write_bytes
from navbake.navgrid.grid import NavGrid
from navbake.types import Json
from navbake.views.describe import describe
from navbake.views.page.page import make_page, table
from navbake.views.report.difference import describe_changes, flatten
from navbake.views.report.maps import describe_map

if TYPE_CHECKING:
    from navbake.auditor.report import AuditReport

WAYS = {"link": "steps"}  # as `navbake rooms` has it
PRINTED = "what `navbake verify --json` prints"
Place = tuple[float, float, float]
Remarked = tuple[str, int | None, Place | None, str | None, str]
"""What was found: its kind, level, place [m], a further fact, and in words."""


class Finding(TypedDict):
    kind: str
    level: int
    position: Place
    text: str


class Verification(TypedDict):
    ok: bool
    checked: int
    cells: int
    findings: list[Finding]


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
    clearances are rounded to a millimetre. Of levels of more than `maps.MAX_SHOWN` cells, every
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
    num = len(grids)
    if not grids:
        raise QueryError("expected at least one grid to report on, got none")
    for what, given in (("names", names), ("audits", audits), ("verifications", verifications)):
        if given is not None and len(given) != num:
            raise QueryError(f"expected as many {what} as grids, {num}, got {len(given)}")
    audits, verifications = audits or [None] * num, verifications or [None] * num
    called = [printable(name) for name in names or [grid.scene_id or "grid" for grid in grids]]
    called = [  # numbered where two are the same
        name if called.count(name) == 1 else f"{name} ({called[: i + 1].count(name)})"
        for i, name in enumerate(called)
    ]
    sheets = [
        _describe_grid(*each) for each in zip(grids, called, audits, verifications, strict=True)
    ]
    if num == 2:
        sheets.append(describe_changes(grids[0], grids[1], called))
    return make_page(", ".join(called), {"sheets": sheets}, "navbake.views.report", "report")


def read_verification(path: str | os.PathLike[str]) -> Json:
    """Read a verification's JSON, see `navbake.verifier.report.VerifyReport.to_json`.

    Raises:
        FormatError: it is none, or can't be read.
    """
    report, name = read_object(path, expected=PRINTED)
    try:
        msgspec.convert(report, Verification)
    except msgspec.ValidationError as error:
        raise FormatError(f"expected {PRINTED} in {name}: {error}") from error
    checked: Json = report
    return checked


def _describe_grid(
    grid: NavGrid, name: str, audit: AuditReport | None, verification: Json | None
) -> Json:
    """A sheet of the page: everything that it shows of a grid."""
    facts = describe(grid)
    names = {room.id: room.name or room.id for room in grid.rooms}
    remarks: list[tuple[list[Json], Json]] = []
    if audit is not None:
        found: list[Remarked] = [
            (each.check, each.level, each.place, each.severity, each.text) for each in audit.remarks
        ]
        otherwise = f"{len(audit.checks)} checks, nothing to say"
        remarks.append(_show_remarks("audit", "Audit", "how bad", found, otherwise))
    if verification is not None:
        _check_is_of(grid, verification)
        keys = ("kind", "level", "position", "geom", "text")
        found = [tuple(map(each.get, keys)) for each in verification["findings"]]
        looked_at = f"{verification['checked']:,} of {verification['cells']:,} cells looked at"
        title = f"Verification: {'agrees' if verification['ok'] else 'disagrees'}, {looked_at}"
        remarks.append(_show_remarks("verify", title, "geom", found, looked_at))
    marks = [mark for of_one, _ in remarks for mark in of_one]
    levels = [
        {
            **describe_map(grid, number),
            "marks": [mark for mark in marks if mark["level"] in (number, None)],
            "rooms": {str(r.index): names[r.id] for r in grid.rooms if r.level == number},
        }
        for number in range(len(grid.levels))
    ]
    timings = [
        (key.removesuffix("Millis"), f"{value:.1f}")
        for key, value in grid.timings.items()
        if isinstance(value, int | float)
    ]
    settings = [*flatten(grid.navbake.get("settings")).items()]
    tables = [
        _levels_table(facts),
        _rooms_table(grid, names),
        _doors_table(grid, names),
        _links_table(grid),
        *(made for _, made in remarks),
        table("Settings", ("setting", "value"), settings),
        table("Timings", ("stage", "ms"), timings, numbers=(1,)),
        table("Made by", ("what", "version or digest"), list(facts["made_by"].items())),
    ]
    area = sum(level["free_area"] for level in facts["levels"])
    shown = [
        ("scene", facts["scene_id"] or "not named"),
        ("levels", str(len(levels))),
        ("cells", f"{sum(level.free.size for level in grid.levels):,}"),
        ("cell size", f"{facts['cell_size']:g} m"),
        ("free", f"{area:.2f} m²"),
        *((key, str(len(getattr(grid, key)))) for key in ("rooms", "doors")),
        ("islands", str(facts["num_islands"])),
        ("agent", f"{grid.agent_radius:g} m radius, {grid.agent_height:g} m high"),
        ("highest step", f"{grid.max_step:g} m"),
    ]
    shown += [
        ("inflated to", "{radius:g} m, clearance {clearance:g} m ({mode})".format_map(entry))
        for entry in facts["inflated"]
        if all(isinstance(entry[key], int | float) for key in ("radius", "clearance"))
    ]
    return {
        "name": name,
        "facts": shown,
        "warnings": facts["warnings"],
        "levels": levels,
        "tables": [made for made in tables if made["rows"]],
    }


def _levels_table(facts: Json) -> Json:
    columns = ("level", "name", "cells", "ground [m]", "floors [m]", "floor [m²]", "free [m²]")
    rows = []
    for number, level in enumerate(facts["levels"]):
        floors = "{floor_min:.3f} to {floor_max:.3f}" if level["floor_min"] is not None else "none"
        shown = (
            "{width} x {height}",
            "{ground:.3f}",
            floors,
            "{floor_area:.2f}",
            "{free_area:.2f}",
        )
        counts = level["num_islands"], level["num_rooms"]
        rows.append((number, level["name"], *(text.format_map(level) for text in shown), *counts))
    return table("Levels", (*columns, "islands", "rooms"), rows, numbers=(0, 2, 3, 5, 6, 7, 8))


def _rooms_table(grid: NavGrid, names: dict[str, str]) -> Json:
    rows = []
    for room in grid.rooms:
        opens_to = [
            f"{names.get(near.room, near.room)} ({near.door or WAYS.get(near.kind, near.kind)})"
            for near in room.neighbours
        ]
        level = grid.level_names[room.level] if len(grid.levels) > 1 else ""
        where, kind = _place(room.centroid), "outdoors" if room.outdoors else ""
        facts = (level, f"{room.area:.2f}", where, room.source, kind, ", ".join(opens_to))
        rows.append((room.id, room.name, *facts))
    columns = ("id", "name", "level", "m²", "centre x, y, z [m]", "from", "", "opens to")
    return table("Rooms", columns, rows, numbers=(3,))


def _doors_table(grid: NavGrid, names: dict[str, str]) -> Json:
    rows = []
    for door in grid.doors:
        joins = " - ".join(names.get(room, room) if room else "outside" for room in door.rooms)
        state = f"{door.state} ({door.like})" if door.like else door.state
        levels = ", ".join(grid.level_names[level] for level in door.levels)
        rows.append((door.id, levels if len(grid.levels) > 1 else "", joins, state, door.joint))
    return table("Doors", ("id", "levels", "joins", "is", "joint"), rows)


def _links_table(grid: NavGrid) -> Json:
    """How many steps lead from level to level, and where their middle is."""
    links = grid.link_array
    rows = []
    for level, other in np.unique(links[:, ::2], axis=0).tolist():
        own = links[(links[:, 0] == level) & (links[:, 2] == other)]
        lattice = grid.levels[level].lattice
        middle = lattice.positions(*np.divmod(own[:, 1], lattice.width)).mean(axis=0).tolist()
        names = grid.level_names[level], grid.level_names[other]
        rows.append((*names, len(own), _place(middle)))
    columns = ("from", "to", "steps", "mean place x, y [m]")
    return table("Links between levels", columns, rows, numbers=(2,))


def _place(position: Iterable[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in position)


def _check_is_of(grid: NavGrid, verification: Json) -> None:
    cells, num = sum(level.free.size for level in grid.levels), len(grid.levels)
    stated = verification.get("sceneId"), verification["cells"]
    if stated != (grid.scene_id, cells):
        raise QueryError(
            f"expected the verification of {grid.scene_id!r}, {cells} cells, got one of "
            f"{stated[0]!r}, {stated[1]} cells: give them in the order of the grids"
        )
    for level in (finding["level"] for finding in verification["findings"]):
        if not 0 <= level < num:
            raise FormatError(f"expected levels below {num} in the verification, got {level}")


def _show_remarks(
    source: str, title: str, more: str, found: list[Remarked], otherwise: str
) -> tuple[list[Json], Json]:
    """Marks on the map, and a table; `more` names a remark's further fact."""
    marks = [
        {"level": level, "x": place[0], "y": place[1], "kind": f"{source}: {kind}", "text": text}
        for kind, level, place, _, text in found
        if place is not None
    ]
    rows = [(kind, level, _place(at or ()), fact, text) for kind, level, at, fact, text in found]
    columns = ("kind", "level", "x, y, z [m]", more, "what")
    return marks, table(title, columns, rows or [("none", None, "", "", otherwise)])
