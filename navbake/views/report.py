"""Writes a report on grids: one page, which a browser opens without a server or the network."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import msgspec
import numpy as np
import orjson

from navbake.errors import FormatError, QueryError, printable
from navbake.formats.source import read_json, write_bytes
from navbake.navgrid.colors import color_rooms
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import clearance, islands_of
from navbake.navgrid.user_data import NAMES, UserData, names_in
from navbake.types import Int, Json
from navbake.views import tables
from navbake.views.describe import describe, stair_table
from navbake.views.difference import describe_changes, describe_extent, flatten, png_url
from navbake.views.layers import LAYERS, make_panel, paint
from navbake.views.page import make_page, pack, show_table
from navbake.views.tables import Table, make_table, summarize

if TYPE_CHECKING:
    from navbake.auditor.facts import AuditReport

PRINTED = "what `navbake verify --json` prints"
Place = tuple[float, float, float]
Remarked = tuple[str, int | None, Place | None, str | None, str]
"""What was found: its kind, level, place [m], a further fact, and in words."""
KINDS = (*NAMES, "blockers")  # keys of a cell's user data that list names
DIGITS = 3  # floors and clearances are rounded to millimetres
NONE = -1  # the entry of cells in which nothing stands
FOLDED = ("Timings", "Made by")  # tables that few readers need
BAR = 64  # colours of the bar beside a layer


class VerifiedFinding(TypedDict):
    """The part of a `Finding` in JSON that a page needs."""

    kind: str
    level: int
    position: Place
    text: str


class Verification(TypedDict):
    """The part of `VerifyReport.to_json` that a page shows."""

    ok: bool
    checked: int
    cells: int
    findings: list[VerifiedFinding]


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

    Floors and clearances are rounded to a millimetre. Of levels of more than `MAX_SHOWN` cells,
    every n-th row and column is shown. With two grids, a third sheet shows what differs.

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
    audits = audits or [None] * num
    verifications = verifications or [None] * num
    called = [printable(name) for name in names or [grid.scene_id or "grid" for grid in grids]]
    called = [  # numbered where two are the same
        name if called.count(name) == 1 else f"{name} ({called[: i + 1].count(name)})"
        for i, name in enumerate(called)
    ]
    sheets = list(map(_describe_grid, grids, called, audits, verifications))
    if num == 2:
        sheets.append(describe_changes(grids[0], grids[1], called))
    return make_page(", ".join(called), {"sheets": sheets}, "navbake.views", "report")


def read_verification(path: str | PathLike[str]) -> Json:
    """Read a verification's JSON, see `VerifyReport.to_json`; raises a FormatError."""
    report, name = read_json(path, expected=PRINTED)
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
    marks = list[Json]()
    noted = dict[str, Table]()

    def note(source: str, title: str, more: str, found: list[Remarked], otherwise: str) -> None:
        """Mark what was found on the map, and list it; `more` names a remark's further fact."""
        rows: list[Any] = []
        for kind, level, place, fact, text in found:
            if place is not None:
                mark = {"level": level, "x": place[0], "y": place[1]}
                marks.append({**mark, "kind": f"{source}: {kind}", "text": text})
            at = ", ".join(f"{value:.2f}" for value in place or ())
            rows.append((kind, level, at, fact, text))
        columns = ("kind", "level", "x, y, z [m]", more, "what")
        noted[title] = make_table(columns, rows or [("none", None, "", "", otherwise)])

    if audit is not None:
        found: list[Remarked] = [
            (each.check, each.level, each.place, each.severity, each.text) for each in audit.remarks
        ]
        otherwise = f"{len(audit.checks)} checks, nothing to say"
        note("audit", "Audit", "how bad", found, otherwise)
    if verification is not None:
        cells = sum(level.free.size for level in grid.levels)
        num = len(grid.levels)
        stated = verification.get("sceneId"), verification["cells"]
        if stated != (grid.scene_id, cells):
            raise QueryError(
                f"expected the verification of {grid.scene_id!r}, {cells} cells, got one of "
                f"{stated[0]!r}, {stated[1]} cells: give them in the order of the grids"
            )
        for level in (finding["level"] for finding in verification["findings"]):
            if not 0 <= level < num:
                raise FormatError(f"expected levels below {num} in the verification, got {level}")
        keys = ("kind", "level", "position", "geom", "text")
        found = [tuple(map(each.get, keys)) for each in verification["findings"]]
        looked_at = f"{verification['checked']:,} of {verification['cells']:,} cells looked at"
        title = f"Verification: {'agrees' if verification['ok'] else 'disagrees'}, {looked_at}"
        note("verify", title, "geom", found, looked_at)
    levels = []
    for number in range(len(grid.levels)):
        own = [mark for mark in marks if mark["level"] in (number, None)]
        rooms = {str(r.index): r.name or r.id for r in grid.rooms if r.level == number}
        levels.append({**describe_map(grid, number), "marks": own, "rooms": rooms})
    timings = [
        (key.removesuffix("Millis"), f"{value:.1f}")
        for key, value in grid.timings.items()
        if isinstance(value, int | float)
    ]
    settings = flatten(grid.navbake.get("settings")).items()
    named_tables = {
        "Levels": tables.level_table(facts),
        "Rooms": tables.room_table(grid.rooms, grid.level_names),
        "Doors": tables.door_table(grid.doors, grid.level_names),
        "Stairs and steep ramps": stair_table(grid),
        "Links": tables.link_table(grid.links, grid.level_names),
        "Areas": tables.area_table(facts["areas"]),
        "Agents": tables.agent_table(facts["agents"]),
        **noted,
        "Settings": make_table(("setting", "value"), settings),
        "Timings": make_table(("stage", "ms"), timings, numbers=("ms",)),
        "Made by": make_table(("what", "version or digest"), facts["made_by"].items()),
    }
    area = sum(level["free_area"] for level in facts["levels"])
    cells = sum(level.free.size for level in grid.levels)
    shown = [*summarize(facts), ("rooms", str(len(grid.rooms))), ("levels", str(len(levels)))]
    return {
        "name": name,
        "facts": [*shown, ("cells", f"{cells:,}"), ("free", f"{area:.2f} m²")],
        "warnings": facts["warnings"],
        "levels": levels,
        "tables": [
            show_table(*one, folded=one[0] in FOLDED) for one in named_tables.items() if one[1].rows
        ],
    }


def describe_map(grid: NavGrid, number: int) -> Json:
    """The map of one level: its place, its layers, and its cells.

    ``cells`` is JSON, packed by `pack`, with a list of all cells, row by row, for each fact; null
    stands for no floor and for blocked. ``names`` are numbers into the list ``nameLists``, -1 for
    none: the names of what stands in a cell, and of what blocks it, by `KINDS`.
    """
    level = grid.levels[number]
    place = describe_extent(grid.level_names[number], level.lattice)
    names, name_lists = _number_names(level)
    layers: dict[str, Any] = {
        "floor": np.round(level.floor, DIGITS),
        "clearance": np.round(np.where(level.free, clearance(level), np.nan), DIGITS),
        "weight": np.where(level.free, level.weights, np.nan),
        "room": level.room_index,
        "island": islands_of(grid)[number],
        "names": names,
    }
    every = place["every"]
    cells = {key: layer[::every, ::every].ravel() for key, layer in layers.items()}
    shown = [layer for layer in LAYERS if layer != "area" or grid.areas]
    drawn = [_draw_layer(grid, number, layer, every) for layer in shown]
    return {**place, "cells": pack({**cells, "nameLists": name_lists}), "layers": drawn}


def _number_names(level: SceneGrid2D) -> tuple[Int, list[Json]]:
    """Which entry of the list of names each cell has, -1 for none, shape (height, width)."""
    found: dict[bytes, int] = {}  # by an entry's JSON: most cells have the entry of others
    lists: list[Json] = []

    def number_of(entry: Json) -> int:
        key = orjson.dumps(entry, default=str)
        if key not in found:
            names = {kind: sorted(names_in(entry, kind)) for kind in KINDS}
            names = {kind: some for kind, some in names.items() if some}
            found[key] = len(lists) if names else NONE
            lists.extend([names] if names else [])
        return found[key]

    numbers = np.full(level.height * level.width, NONE, dtype=np.int64)
    cells, number, entries = UserData.of(level.user_data).shared()
    numbers[cells] = np.array([number_of(entry) for entry in entries], np.int64)[number]
    return numbers.reshape(level.shape), lists


def _draw_layer(grid: NavGrid, number: int, layer: str, every: int) -> Json:
    panel = make_panel(grid, layer, number)
    scale = None
    rooms = []
    if layer == "rooms":
        rgb = color_rooms(grid, number)
        for room in grid.rooms:
            if room.level == number and not room.outdoors and room.index < len(rgb):
                rooms.append((room.name or room.id, f"#{bytes(rgb[room.index]).hex()}"))
    if panel.scale is not None:
        scale = {
            "label": panel.scale.label,
            "colors": [f"#{bytes(color).hex()}" for color in panel.scale.bar(BAR)],
            "ticks": [tick._asdict() for tick in panel.scale.ticks],
        }
    return {
        "name": layer,
        "title": panel.title.removeprefix(f"{grid.level_names[number]}: "),
        "png": png_url(paint(panel)[::every, ::every]),
        "legend": [*rooms, *panel.legend],
        "scale": scale,
        "labels": [label._asdict() for label in panel.labels],
        "doors": [door._asdict() for door in panel.doors],
        "ways": [
            {
                # in order, null on another level
                "stops": [[x, y] if level == number else None for level, x, y, _ in way.stops],
                "link": way.link is not None,
                "closed": way.is_closed,
                "oneWay": way.one_way,
            }
            for way in panel.connections
        ],
    }
