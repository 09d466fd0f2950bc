"""The tables that commands print."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from navbake.types import Json

if TYPE_CHECKING:
    from navbake.baker.scene.scene import GeomReport
    from navbake.navgrid.doors import Door
    from navbake.navgrid.rooms import Room

PIPE_WIDTH = 10_000  # columns where stdout is no terminal, so that nothing is cut or wrapped


def print_tables(*tables: Table) -> None:
    """Print tables on stdout, one under the other."""
    width = None if sys.stdout.isatty() else PIPE_WIDTH
    console = Console(width=width, markup=False, highlight=False, emoji=False)
    for index, table in enumerate(tables):
        if index:
            console.print()
        console.print(table)


def geom_table(geoms: Iterable[GeomReport]) -> Table:
    """A row for each geom: whether it counts, as what, and why."""
    rows = (
        (str(g.id), g.name, g.body, g.type, "yes" if g.counted else "no", g.shape, g.reason)
        for g in geoms
    )
    return _table(("id", "geom", "body", "type", "counted", "as", "why"), rows, numbers={"id"})


def summary_table(facts: Json) -> Table:
    """A row for each fact about the whole grid, from `navbake.views.info.describe`."""
    rows = [
        ("type", facts["type"]),
        ("scene", facts["scene_id"] or "not named"),
        ("cell size [m]", f"{facts['cell_size']:g}"),
        *((f"agent {name.replace('_', ' ')}", str(v)) for name, v in facts["agent"].items()),
    ]
    for entry in facts["inflated"]:
        how = f"{entry['radius']}, clearance {entry['clearance']} ({entry['mode']})"
        rows.append(("inflated to [m]", how))
    rows += [
        ("islands", str(facts["num_islands"])),
        ("links", str(facts["num_links"])),
        ("doors", str(len(facts["doors"]))),
        *((name.replace("_", " "), str(value)) for name, value in facts["made_by"].items()),
    ]
    return _facts_table(rows)


def level_table(facts: Json) -> Table:
    """A row for each level, from `navbake.views.info.describe`; rooms only if there are any."""
    levels = facts["levels"]
    columns = {
        "#": [str(index) for index in range(len(levels))],
        "name": [level["name"] for level in levels],
        "cells": [f"{level['width']} x {level['height']}" for level in levels],
        "ground m": [f"{level['ground']:.3f}" for level in levels],
        "floor m": [_height_range(level) for level in levels],
        "floor m2": [f"{level['floor_area']:.2f}" for level in levels],
        "free m2": [f"{level['free_area']:.2f}" for level in levels],
        "islands": [str(level["num_islands"]) for level in levels],
        "largest m2": [f"{level['largest_island_area']:.2f}" for level in levels],
    }
    if any(level["num_rooms"] for level in levels):
        columns["rooms"] = [str(level["num_rooms"]) for level in levels]
    rows = zip(*columns.values(), strict=True)
    return _table(tuple(columns), rows, numbers=set(columns) - {"name"}, gap=1)


def _height_range(level: Json) -> str:
    if level["floor_min"] is None:
        return "none"
    return f"{level['floor_min']:.3f} to {level['floor_max']:.3f}"


def room_table(rooms: Iterable[Room], levels: Sequence[str]) -> Table:
    """A row for each room; `levels` are the levels' names."""
    rows = []
    for room in rooms:
        opens_to = []
        for neighbour in room.neighbours:
            how = neighbour.door or ("steps" if neighbour.kind == "link" else "")
            opens_to.append(f"{neighbour.room} ({how})" if how else neighbour.room)
        centroid = " ".join(f"{value:.2f}" for value in room.centroid)
        measured = (str(room.index), f"{room.area:.2f}", centroid)
        named = (room.id, room.name or "", levels[room.level])
        rows.append((*named, *measured, room.source or "", ", ".join(opens_to)))
    headings = ("id", "name", "level", "index", "m2", "centroid x y z m", "from", "opens to")
    return _table(headings, rows, numbers={"index", "m2"})


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
    room, weight = facts["room"], facts["weight"]
    verdict = "an agent can stand here"
    if not facts["free"]:
        verdict = "blocked" if facts["floor"] is not None else "no floor here"
    return _facts_table(
        [
            ("verdict", verdict),
            ("blocked by", ", ".join(facts["blockers"]) or "-"),
            ("level", str(facts["level"])),
            ("cell", f"{facts['cell']} (row {facts['row']}, col {facts['col']})"),
            ("center [m]", ", ".join(f"{v:.3f}" for v in facts["center"])),
            ("floor [m]", "none" if facts["floor"] is None else f"{facts['floor']:.3f}"),
            ("weight", "infinite" if weight is None else f"{weight:g}"),
            ("room", str(room["id"]) if isinstance(room, dict) else str(room or "none")),
            ("island", str(facts["island"] or "none")),
            *((key, ", ".join(facts[key]) or "-") for key in ("doors", "objects", "walls")),
        ]
    )


def _facts_table(rows: Iterable[Sequence[str]]) -> Table:
    table = _table(("", ""), rows)
    table.show_header = False
    return table


def _table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    numbers: Iterable[str] = (),
    gap: int = 2,
) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, gap, 0, 0))
    for heading in headings:
        table.add_column(
            heading, justify="right" if heading in numbers else "left", overflow="fold"
        )
    for row in rows:
        table.add_row(*row)
    return table
