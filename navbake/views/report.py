"""Writes a report on grids: one page, which a browser opens without a server or the network."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, TypedDict

import msgspec
import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError, QueryError, printable
from navbake.formats.source import read_json, write_bytes
from navbake.lengths import format_length
from navbake.navgrid.colors import color_rooms
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import islands_of, measure_clearance
from navbake.navgrid.user_data import NAME_KEYS, UserData, names_in
from navbake.types import Int, Json
from navbake.views import tables
from navbake.views.describe import describe, make_stair_table
from navbake.views.difference import describe_changes, describe_extent, encode_png_url, flatten_json
from navbake.views.layers import LAYERS, make_panel, paint
from navbake.views.page import describe_table, make_page, pack_json
from navbake.views.tables import Table, list_grid_facts, make_table

if TYPE_CHECKING:
    from navbake.auditor.facts import AuditReport

VERIFY_REPORT_TEXT = "what `navbake verify --json` prints"
Position: TypeAlias = tuple[float, float, float]
NAME_KINDS = (*NAME_KEYS, "blockers")  # keys of a cell's user data that list names
DECIMALS = 3  # decimals of floors and clearances [m]
NO_NAMES = -1  # stands for the list of names of a cell that has no names
FOLDED_TABLES = ("Timings", "Made by")  # tables of which only the title shows at first
NUM_BAR_COLORS = 64  # number of colours of a color scale's bar


class VerifiedFinding(TypedDict):
    """A finding in the JSON of `VerifyReport.to_json`, with only the fields that a page shows."""

    kind: str  # kind of disagreement
    level: int  # number of the level, 0 is the lowest
    position: Position  # world x, y, z [m]
    text: str  # what is wrong


class Verification(TypedDict):
    """The JSON of `VerifyReport.to_json`, with only the fields that a page shows."""

    ok: bool  # whether grid and scene agree
    checked: int  # number of cells that were checked
    cells: int  # number of cells of the grid
    findings: list[VerifiedFinding]


def write_report(
    grids: NavGrid | Sequence[NavGrid],
    path: str | PathLike[str],
    *,
    names: Sequence[str] | None = None,
    audits: Sequence[AuditReport | None] | None = None,
    verifications: Sequence[Json | None] | None = None,
) -> Path:
    """Write the page that `render_report` makes; if an error is raised, no file is written.

    Args:
        grids: one or more grids.
        path: the path of the HTML file.
        names: the names of the grids on the page; None for the names of their scenes.
        audits: for each grid a report of `navbake.audit`, or None.
        verifications: for each grid the result of `VerifyReport.to_json`, or None.

    Returns:
        The path.

    Raises:
        FormatError: the file can't be written, or a verification names a level that its grid
            doesn't have.
        QueryError: there is no grid; there are more or fewer names, audits or verifications than
            grids; or a verification is of another scene.
    """
    page_content = render_report(grids, names=names, audits=audits, verifications=verifications)
    write_bytes(page_content, path)
    return Path(path)


def render_report(
    grids: NavGrid | Sequence[NavGrid],
    *,
    names: Sequence[str] | None = None,
    audits: Sequence[AuditReport | None] | None = None,
    verifications: Sequence[Json | None] | None = None,
) -> bytes:
    """Make a report as one HTML page of maps and tables. Equal arguments give equal bytes.

    Floors and clearances are rounded to a millimetre. Of a level with more than `MAX_PAGE_CELLS`
    cells, only every n-th row and column is shown. Each grid has a sheet (tab); if there are two
    grids, a third sheet shows their differences.

    Args:
        grids: one or more grids.
        names: the names of the grids on the page; their scenes' names if None.
        audits: for each grid a report of `navbake.audit`, or None.
        verifications: for each grid the result of `VerifyReport.to_json`, or None.

    Raises:
        QueryError: there is no grid; there are more or fewer names, audits or verifications than
            grids; or a verification is of another scene, or of another number of cells.
        FormatError: a verification names a level that its grid doesn't have.
    """
    grids = list(grids) if isinstance(grids, Sequence) else [grids]
    num_grids = len(grids)
    if not grids:
        raise QueryError("expected at least one grid to report on, got none")
    for argument_name, values in (
        ("names", names),
        ("audits", audits),
        ("verifications", verifications),
    ):
        if values is not None and len(values) != num_grids:
            raise QueryError(
                f"expected as many {argument_name} as grids, {num_grids}, got {len(values)}"
            )
    audits = audits or [None] * num_grids
    verifications = verifications or [None] * num_grids
    titles = _number_duplicates(
        [printable(name) for name in names or [grid.scene_id or "grid" for grid in grids]]
    )
    sheets = list(map(_describe_grid, grids, titles, audits, verifications))
    if num_grids == 2:
        sheets.append(describe_changes(grids[0], grids[1], titles))
    return make_page(", ".join(titles), {"sheets": sheets}, "navbake.views", "report")


def _number_duplicates(names: Sequence[str]) -> list[str]:
    """Return names, with a number appended to those that occur more than once."""
    return [
        name if names.count(name) == 1 else f"{name} ({names[: i + 1].count(name)})"
        for i, name in enumerate(names)
    ]


def read_verification(path: str | PathLike[str]) -> Json:
    """Read the JSON file of a verification, see `VerifyReport.to_json`.

    Args:
        path: the path of the file.

    Raises:
        FormatError: the file can't be read, or isn't a verification.
    """
    report, name = read_json(path, expected=VERIFY_REPORT_TEXT)
    try:
        msgspec.convert(report, Verification)
    except msgspec.ValidationError as error:
        raise FormatError(f"expected {VERIFY_REPORT_TEXT} in {name}: {error}") from error
    verification: Json = report
    return verification


class ListedFinding(NamedTuple):
    """A finding of an audit or a verification, as a page shows it."""

    kind: str  # name of the audit's check, or kind of disagreement of the verification
    level: int | None  # number of the level, 0 is the lowest; None for the whole grid
    position: Position | None  # world x, y, z [m]
    detail: str | None  # of an audit, how severe it is; of a verification, the name of the geom
    text: str


def _describe_grid(
    grid: NavGrid, name: str, audit_report: AuditReport | None, verification: Json | None
) -> Json:
    """Return the sheet of a grid as JSON: its facts, warnings, maps and tables."""
    facts = describe(grid)
    map_marks: list[Json] = []
    finding_tables: dict[str, Table] = {}
    if audit_report is not None:
        findings = [
            ListedFinding(remark.check, remark.level, remark.place, remark.severity, remark.text)
            for remark in audit_report.remarks
        ]
        no_findings_text = f"{len(audit_report.checks)} checks, nothing to say"
        map_marks += _list_marks("audit", findings)
        finding_tables["Audit"] = _tabulate_findings("how bad", findings, no_findings_text)
    if verification is not None:
        _check_verification(grid, verification)
        findings = [
            ListedFinding(
                finding["kind"],
                finding["level"],
                finding["position"],
                finding.get("geom"),
                finding["text"],
            )
            for finding in verification["findings"]
        ]
        sample_text = f"{verification['checked']:,} of {verification['cells']:,} cells looked at"
        verdict = "agrees" if verification["ok"] else "disagrees"
        map_marks += _list_marks("verify", findings)
        finding_tables[f"Verification: {verdict}, {sample_text}"] = _tabulate_findings(
            "geom", findings, sample_text
        )
    levels = []
    for level_number in range(len(grid.levels)):
        level_marks = [mark for mark in map_marks if mark["level"] in (level_number, None)]
        rooms = {
            str(room.index): room.name or room.id
            for room in grid.rooms
            if room.level == level_number
        }
        levels.append({**describe_map(grid, level_number), "marks": level_marks, "rooms": rooms})
    timings = [
        (key.removesuffix("Millis"), f"{value:.1f}")
        for key, value in grid.timings.items()
        if isinstance(value, int | float)
    ]
    settings = flatten_json(grid.navbake.get("settings")).items()
    named_tables = {
        "Levels": tables.make_level_table(facts),
        "Rooms": tables.make_room_table(grid.rooms, grid.level_names),
        "Doors": tables.make_door_table(grid.doors, grid.level_names),
        "Stairs and steep ramps": make_stair_table(grid),
        "Links": tables.make_link_table(grid.links, grid.level_names),
        "Areas": tables.make_area_table(facts["areas"]),
        "Agents": tables.make_agent_table(facts["agents"]),
        **finding_tables,
        "Settings": make_table(("setting", "value"), settings),
        "Timings": make_table(("stage", "ms"), timings, numbers=("ms",)),
        "Made by": make_table(("what", "version or digest"), facts["made_by"].items()),
    }
    free_area = sum(level["free_area"] for level in facts["levels"])
    num_cells = sum(level.free.size for level in grid.levels)
    return {
        "name": name,
        "facts": [
            ("free area", f"{free_area:.2f} m²"),
            ("rooms", str(len(grid.rooms))),
            ("levels", str(len(levels))),
            *list_grid_facts(facts),
            ("cells", f"{num_cells:,}"),
        ],
        "warnings": facts["warnings"],
        "levels": levels,
        "tables": [
            describe_table(title, table, is_folded=title in FOLDED_TABLES)
            for title, table in named_tables.items()
            if table.rows
        ],
    }


def _list_marks(source: str, findings: Sequence[ListedFinding]) -> list[Json]:
    """Return a mark on the map for each finding that has a position.

    Args:
        source: ``audit`` or ``verify``.
        findings: the findings.
    """
    return [
        {
            "level": finding.level,
            "x": finding.position[0],
            "y": finding.position[1],
            "kind": f"{source}: {finding.kind}",
            "text": finding.text,
        }
        for finding in findings
        if finding.position is not None
    ]


def _tabulate_findings(
    detail_heading: str, findings: Sequence[ListedFinding], no_findings_text: str
) -> Table:
    """Make a table of findings.

    Args:
        detail_heading: the heading over the findings' details.
        findings: the findings.
        no_findings_text: the text of the only row if there are no findings.
    """
    rows = []
    for finding in findings:
        position = ", ".join(map(format_length, finding.position or ()))
        rows.append((finding.kind, finding.level, position, finding.detail, finding.text))
    headings = ("kind", "level", "x, y, z [m]", detail_heading, "what")
    return make_table(headings, rows or [("none", None, "", "", no_findings_text)])


def _check_verification(grid: NavGrid, verification: Json) -> None:
    """Raise an error unless a verification has the scene, number of cells and levels of a grid."""
    num_cells = sum(level.free.size for level in grid.levels)
    num_levels = len(grid.levels)
    scene_id = verification.get("scene_id", verification.get("sceneId"))  # as until 0.3
    if (scene_id, verification["cells"]) != (grid.scene_id, num_cells):
        raise QueryError(
            f"expected the verification of {grid.scene_id!r}, {num_cells} cells, got one of "
            f"{scene_id!r}, {verification['cells']} cells: give them in the order of the grids"
        )
    for finding in verification["findings"]:
        level = finding["level"]
        if not 0 <= level < num_levels:
            raise FormatError(
                f"expected levels below {num_levels} in the verification, got {level}"
            )


def describe_map(grid: NavGrid, level_number: int) -> Json:
    """Describe the map of a level: where it lies in the world, its layers, and its cells.

    Args:
        grid: a grid of one or several levels.
        level_number: the number of the level, 0 is the lowest.

    Returns:
        JSON. ``cells`` is compressed by `pack_json`. For each property of cells, such as ``floor``,
        it has a list with the value of each cell, row by row; null where there is none. The
        property ``names`` is an index into the list ``nameLists``, -1 for none. An entry of that
        list has the names of a cell's occupants and blockers, by the keys in `NAME_KINDS`.
    """
    level = grid.levels[level_number]
    map_extent = describe_extent(grid.level_names[level_number], level.lattice)
    names, name_lists = _collect_name_lists(level)
    cell_properties: dict[str, NDArray[np.generic]] = {
        "floor": np.round(level.floor, DECIMALS),
        "clearance": np.round(np.where(level.free, measure_clearance(level), np.nan), DECIMALS),
        "weight": np.where(level.free, level.weights, np.nan),
        "room": level.room_index,
        "island": islands_of(grid)[level_number],
        "names": names,
    }
    stride = map_extent["every"]
    shown_properties = {
        key: property_values[::stride, ::stride].ravel()
        for key, property_values in cell_properties.items()
    }
    drawn_layers = [
        _draw_layer(grid, level_number, layer, stride)
        for layer in LAYERS
        if layer != "area" or grid.areas
    ]
    return {
        **map_extent,
        "cells": pack_json({**shown_properties, "nameLists": name_lists}),
        "layers": drawn_layers,
    }


def _collect_name_lists(level: SceneGrid2D) -> tuple[Int, list[Json]]:
    """Collect the different sets of names that the cells of a level have.

    Returns:
        For each cell the index of its names in the list, `NO_NAMES` for none, shape
        (height, width); and the list: names by the keys in `NAME_KINDS`.
    """
    # JSON of a cell's user data, which most cells share -> index of its names
    index_of_encoded_data: dict[bytes, int] = {}
    name_lists: list[Json] = []

    def find_list_index(cell_user_data: Json) -> int:
        encoded_data = orjson.dumps(cell_user_data, default=str)
        if encoded_data not in index_of_encoded_data:
            names = {kind: sorted(names_in(cell_user_data, kind)) for kind in NAME_KINDS}
            names = {kind: names_of_kind for kind, names_of_kind in names.items() if names_of_kind}
            index_of_encoded_data[encoded_data] = len(name_lists) if names else NO_NAMES
            if names:
                name_lists.append(names)
        return index_of_encoded_data[encoded_data]

    list_indices = np.full(level.height * level.width, NO_NAMES, dtype=np.int64)
    cell_ids, entry_of_cell, user_data_entries = UserData.of(level.user_data).shared_entries()
    list_indices[cell_ids] = np.array(
        [find_list_index(cell_user_data) for cell_user_data in user_data_entries], np.int64
    )[entry_of_cell]
    return list_indices.reshape(level.shape), name_lists


def _draw_layer(grid: NavGrid, level_number: int, layer: str, stride: int) -> Json:
    """Describe a layer of a level as JSON; its picture has each `stride`-th row and column."""
    panel = make_panel(grid, layer, level_number)
    scale_json = None
    room_legend = []
    if layer == "rooms":
        room_colors = color_rooms(grid, level_number)
        for room in grid.rooms:
            if room.level == level_number and not room.outdoors and room.index < len(room_colors):
                room_legend.append(
                    (room.name or room.id, f"#{bytes(room_colors[room.index]).hex()}")
                )
    if panel.scale is not None:
        scale_json = {
            "label": panel.scale.label,
            "colors": [f"#{bytes(color).hex()}" for color in panel.scale.bar(NUM_BAR_COLORS)],
            "ticks": [tick._asdict() for tick in panel.scale.ticks],
        }
    return {
        "name": layer,
        "title": panel.title.removeprefix(f"{grid.level_names[level_number]}: "),
        "png": encode_png_url(paint(panel)[::stride, ::stride]),
        "legend": [*room_legend, *panel.legend],
        "scale": scale_json,
        "labels": [label._asdict() for label in panel.labels],
        "doors": [door._asdict() for door in panel.doors],
        "keepClear": panel.keep_clear,
        "ways": [
            {
                # in order; null for a stop on another level
                "stops": [
                    [x, y] if level == level_number else None for level, x, y, _ in connection.stops
                ],
                "link": connection.link is not None,
                "closed": connection.is_closed,
                "oneWay": connection.is_one_way,
            }
            for connection in panel.connections
        ],
    }
