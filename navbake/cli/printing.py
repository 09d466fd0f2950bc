"""What commands print: tables and JSON on stdout, warnings and errors on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

# Functions import rich when they run: without it, --help starts a fifth sooner.
if TYPE_CHECKING:
    from rich.table import Table

    from navbake.baker.scene.scene import GeomReport
    from navbake.navgrid.doors import Door
    from navbake.navgrid.rooms import Room
    from navbake.types import Json
    from navbake.verifier.report import VerifyReport

PIPE_WIDTH = 10_000  # columns where stdout is no terminal, so that nothing is cut or wrapped
LEVEL_COLUMNS = {
    "#": "{index}",
    "name": "{name}",
    "cells": "{width} x {height}",
    "ground m": "{ground:.3f}",
    "floor m": "{floor}",
    "floor m2": "{floor_area:.2f}",
    "free m2": "{free_area:.2f}",
    "islands": "{num_islands}",
    "largest m2": "{largest_island_area:.2f}",
}
"""Headings, and how the cells under them are made from what is known of a level."""
VERIFY_COLUMNS = {
    "level": "name",
    "cells": "cells",
    "free, free": "free_free",
    "blocked, blocked": "blocked_blocked",
    "free, touches": "free_touches",
    "blocked, apart": "blocked_apart",
    "disputed": "disputed",
    "floors": "floors",
    "in cracks": "in_cracks",
    "floors off": "floors_off",
    "places lost": "lost",
}
"""Headings, and which of a level's counts stand under them: the grid first, then the scene."""


def print_json(value: Any) -> None:
    """Print a value as JSON; NaN and infinity are refused, as JSON has neither."""
    print(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False))


def print_error(message: str) -> None:
    """Print one line on stderr."""
    print(f"navbake: {message}", file=sys.stderr)


def print_warnings(warnings: Iterable[str]) -> None:
    """Print warnings on stderr, one a line."""
    for warning in warnings:
        print_error(f"warning: {warning}")


def print_tables(*tables: Table) -> None:
    """Print tables on stdout, one under the other."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else PIPE_WIDTH
    console = Console(width=width, markup=False, highlight=False, emoji=False)
    for index, table in enumerate(tables):
        if index:
            console.print()
        console.print(table)


def geom_table(geoms: Iterable[GeomReport]) -> Table:
    """A row for each geom: whether it counts, as what, and why."""
    rows = (
        (g.id, g.name, g.body, g.type, "yes" if g.counted else "no", g.shape, g.reason)
        for g in geoms
    )
    return _table(("id", "geom", "body", "type", "counted", "as", "why"), rows, numbers=("id",))


def summary_table(facts: Json) -> Table:
    """A row for each fact about the whole grid, from `navbake.views.info.describe`."""
    return _table(
        ("", ""),
        [
            ("type", facts["type"]),
            ("scene", facts["scene_id"] or "not named"),
            ("cell size [m]", f"{facts['cell_size']:g}"),
            *((f"agent {name.replace('_', ' ')}", value) for name, value in facts["agent"].items()),
            *(
                ("inflated to [m]", "{radius}, clearance {clearance} ({mode})".format_map(entry))
                for entry in facts["inflated"]
            ),
            ("islands", facts["num_islands"]),
            ("links", facts["num_links"]),
            ("doors", len(facts["doors"])),
            *((name.replace("_", " "), value) for name, value in facts["made_by"].items()),
        ],
    )


def level_table(facts: Json) -> Table:
    """A row for each level, from `navbake.views.info.describe`; rooms only if there are any."""
    columns = dict(LEVEL_COLUMNS)
    if any(level["num_rooms"] for level in facts["levels"]):
        columns["rooms"] = "{num_rooms}"
    rows = []
    for index, level in enumerate(facts["levels"]):
        has_floor = level["floor_min"] is not None
        floor = "{floor_min:.3f} to {floor_max:.3f}".format_map(level) if has_floor else "none"
        known = {**level, "index": index, "floor": floor}
        rows.append([text.format_map(known) for text in columns.values()])
    return _table(tuple(columns), rows, numbers=columns.keys() - {"name"}, gap=1)


def room_table(rooms: Iterable[Room], levels: Sequence[str]) -> Table:
    """A row for each room; `levels` are the levels' names."""
    rows = []
    for room in rooms:
        opens_to = []
        for neighbour in room.neighbours:
            how = neighbour.door or ("steps" if neighbour.kind == "link" else "")
            opens_to.append(f"{neighbour.room} ({how})" if how else neighbour.room)
        centroid = " ".join(f"{value:.2f}" for value in room.centroid)
        named = (room.id, room.name or "", levels[room.level], room.index)
        source = f"{room.source or ''}{', outdoors' if room.outdoors else ''}"
        rows.append((*named, f"{room.area:.2f}", centroid, source, ", ".join(opens_to)))
    headings = ("id", "name", "level", "index", "m2", "centroid x y z m", "from", "opens to")
    return _table(headings, rows, numbers=("index", "m2"))


def door_table(doors: Iterable[Door], levels: Sequence[str]) -> Table:
    """A row for each door; `levels` are the levels' names."""
    rows = []
    for door in doors:
        joined = " - ".join("outside" if room is None else room for room in door.rooms)
        rows.append(
            (
                door.id,
                door.joint or "none",
                ", ".join(levels[level] for level in door.levels),
                # a body that a pattern made a door may stand anywhere
                joined if any(door.rooms) else "nothing",
                f"{door.state} ({door.like})" if door.like else door.state,
                ", ".join(door.states),
            )
        )
    return _table(("door", "joint", "level", "joins", "is", "can be"), rows)


def cell_table(facts: Json) -> Table:
    """A row for each fact about a cell, from `navbake.views.why.describe_cell`."""
    room, weight, floor = facts["room"], facts["weight"], facts["floor"]
    blocked = "no floor here" if floor is None else "blocked"
    return _table(
        ("", ""),
        [
            ("verdict", "an agent can stand here" if facts["free"] else blocked),
            ("blocked by", ", ".join(facts["blockers"]) or "-"),
            ("level", facts["level"]),
            ("cell", "{cell} (row {row}, col {col})".format_map(facts)),
            ("center [m]", ", ".join(f"{v:.3f}" for v in facts["center"])),
            ("floor [m]", "none" if floor is None else f"{floor:.3f}"),
            ("weight", "infinite" if weight is None else f"{weight:g}"),
            ("room", room["id"] if isinstance(room, dict) else room or "none"),
            ("island", facts["island"] or "none"),
            *((key, ", ".join(facts[key]) or "-") for key in ("doors", "objects", "walls")),
        ],
    )


def verify_table(report: VerifyReport) -> Table:
    """A row for each level: how often grid and scene agree, and how often not."""
    rows = [
        [getattr(level, key) for key in VERIFY_COLUMNS.values()]
        for level in ([*report.levels, report.total] if report.levels[1:] else report.levels)
    ]
    return _table(tuple(VERIFY_COLUMNS), rows, numbers=VERIFY_COLUMNS.keys() - {"level"})


def _table(
    headings: Sequence[str],
    rows: Iterable[Sequence[Any]],
    numbers: Iterable[str] = (),
    gap: int = 2,
) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, gap, 0, 0), show_header=any(headings))
    for name in headings:
        table.add_column(name, justify="right" if name in numbers else "left", overflow="fold")
    for row in rows:
        table.add_row(*map(str, row))
    return table
