"""What a report says of one grid: facts, tables and marked places, in values that JSON can hold."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from navbake.errors import FormatError
from navbake.navgrid.grid import NavGrid
from navbake.types import Json
from navbake.views.info import describe
from navbake.views.report.cells import describe_cells
from navbake.views.report.pictures import draw_layers
from navbake.views.report.tables import flatten, table

if TYPE_CHECKING:
    from navbake.auditor.report import AuditReport

WAYS = {"link": "steps"}  # as `navbake rooms` has it


def describe_grid(
    grid: NavGrid, name: str, audit: AuditReport | None = None, verification: Json | None = None
) -> Json:
    """Everything that a page shows of a grid.

    Args:
        name: what the page calls it.
        audit: what an audit of it said.
        verification: what `VerifyReport.to_json` gave of it.
    """
    facts = describe(grid)
    marks = [*_audit_marks(audit), *verify_marks(verification, len(grid.levels))]
    levels = [
        {
            "name": grid.level_names[number],
            "width": level.width,
            "height": level.height,
            "cellSize": level.lattice.cell_size,
            "xMin": level.lattice.x_min,
            "yMax": level.lattice.y_max,
            "cells": describe_cells(grid, number),
            "layers": draw_layers(grid, number),
            "marks": [mark for mark in marks if mark["level"] in (number, None)],
            "rooms": {
                str(room.index): room.name or room.id for room in grid.rooms if room.level == number
            },
        }
        for number, level in enumerate(grid.levels)
    ]
    tables = [
        _levels_table(facts),
        _rooms_table(grid),
        _doors_table(grid),
        _links_table(grid),
        *_audit_tables(audit),
        *verify_tables(verification),
        table("Settings", ("setting", "value"), flatten(grid.navbake.get("settings"))),
        table("Timings", ("stage", "ms"), _timings(grid), numbers=(1,)),
        table("Made by", ("what", "version or digest"), list(facts["made_by"].items())),
    ]
    return {
        "name": name,
        "facts": _facts(grid, facts),
        "warnings": facts["warnings"],
        "levels": levels,
        "tables": [made for made in tables if made["rows"]],
    }


def _facts(grid: NavGrid, facts: Json) -> list[tuple[str, str]]:
    area = sum(level["free_area"] for level in facts["levels"])
    shown = [
        ("scene", facts["scene_id"] or "not named"),
        ("levels", str(len(facts["levels"]))),
        ("cells", f"{sum(lv['width'] * lv['height'] for lv in facts['levels']):,}"),
        ("cell size", f"{facts['cell_size']:g} m"),
        ("free", f"{area:.2f} m²"),
        ("rooms", str(len(grid.rooms))),
        ("doors", str(len(facts["doors"]))),
        ("islands", str(facts["num_islands"])),
        ("agent", f"{grid.agent_radius:g} m radius, {grid.agent_height:g} m high"),
        ("highest step", f"{grid.max_step:g} m"),
    ]
    shown += [
        ("inflated to", "{radius:g} m, clearance {clearance:g} m ({mode})".format_map(entry))
        for entry in facts["inflated"]
        if all(isinstance(entry[key], int | float) for key in ("radius", "clearance"))
    ]
    return shown


def _levels_table(facts: Json) -> Json:
    columns = ("level", "name", "cells", "ground [m]", "floors [m]", "floor [m²]", "free [m²]")
    rows = [
        (
            number,
            level["name"],
            f"{level['width']} x {level['height']}",
            f"{level['ground']:.3f}",
            "none"
            if level["floor_min"] is None
            else f"{level['floor_min']:.3f} to {level['floor_max']:.3f}",
            f"{level['floor_area']:.2f}",
            f"{level['free_area']:.2f}",
            level["num_islands"],
            level["num_rooms"],
        )
        for number, level in enumerate(facts["levels"])
    ]
    return table("Levels", (*columns, "islands", "rooms"), rows, numbers=(0, 2, 3, 5, 6, 7, 8))


def _rooms_table(grid: NavGrid) -> Json:
    names = {room.id: room.name or room.id for room in grid.rooms}
    rows = []
    for room in grid.rooms:
        opens_to = [
            f"{names.get(near.room, near.room)} ({near.door or WAYS.get(near.kind, near.kind)})"
            for near in room.neighbours
        ]
        where = ", ".join(f"{value:.2f}" for value in room.centroid)
        kind = "outdoors" if room.outdoors else ""
        level = grid.level_names[room.level] if len(grid.levels) > 1 else ""
        area = f"{room.area:.2f}"
        rows.append(
            (room.id, room.name, level, area, where, room.source, kind, ", ".join(opens_to))
        )
    columns = ("id", "name", "level", "m²", "centre x, y, z [m]", "from", "", "opens to")
    return table("Rooms", columns, rows, numbers=(3,))


def _doors_table(grid: NavGrid) -> Json:
    names = {room.id: room.name or room.id for room in grid.rooms}
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
        x, y = lattice.positions(*np.divmod(own[:, 1], lattice.width)).mean(axis=0).tolist()
        names = grid.level_names[level], grid.level_names[other]
        rows.append((*names, len(own), f"{x:.2f}, {y:.2f}"))
    columns = ("from", "to", "steps", "mean place x, y [m]")
    return table("Links between levels", columns, rows, numbers=(2,))


def _timings(grid: NavGrid) -> list[tuple[str, str]]:
    return [
        (key.removesuffix("Millis"), f"{value:.1f}")
        for key, value in grid.timings.items()
        if isinstance(value, int | float)
    ]


def _audit_marks(audit: AuditReport | None) -> Iterator[Json]:
    for remark in audit.remarks if audit else ():
        if remark.place is not None:
            yield {
                "level": remark.level,
                "x": remark.place[0],
                "y": remark.place[1],
                "kind": f"audit: {remark.check}",
                "text": remark.text,
            }


def _audit_tables(audit: AuditReport | None) -> Iterator[Json]:
    if audit is None:
        return
    rows = [
        (
            remark.severity,
            remark.check,
            "" if remark.level is None else remark.level,
            "" if remark.place is None else ", ".join(f"{v:.2f}" for v in remark.place),
            remark.text,
        )
        for remark in audit.remarks
    ]
    rows = rows or [("", "", "", "", f"{len(audit.checks)} checks, nothing to say")]
    yield table("Audit", ("how bad", "check", "level", "x, y, z [m]", "what"), rows)


def verify_marks(verification: Json | None, num_levels: int) -> Iterator[Json]:
    """What a verification found, as marks on the map."""
    for finding in (verification or {}).get("findings", ()):
        x, y, _ = finding["position"]
        if not 0 <= finding["level"] < num_levels:
            raise FormatError(
                f"expected levels below {num_levels} in the verification, got {finding['level']}"
            )
        yield {
            "level": finding["level"],
            "x": x,
            "y": y,
            "kind": f"verify: {finding['kind']}",
            "text": finding["text"],
        }


def verify_tables(verification: Json | None) -> Iterator[Json]:
    """What a verification found, as a table."""
    if verification is None:
        return
    rows = [
        (
            finding["kind"],
            finding["level"],
            ", ".join(f"{v:.3f}" for v in finding["position"]),
            finding.get("geom") or "",
            finding["text"],
        )
        for finding in verification["findings"]
    ]
    looked_at = f"{verification['checked']:,} of {verification['cells']:,} cells looked at"
    rows = rows or [("none", "", "", "", looked_at)]
    title = f"Verification: {'agrees' if verification['ok'] else 'disagrees'}, {looked_at}"
    yield table(title, ("disagreement", "level", "x, y, z [m]", "geom", "what"), rows)
