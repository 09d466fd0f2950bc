"""Tables and progress bars of the command line."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

if TYPE_CHECKING:
    from navbake.baker.scene.scene import GeomReport
    from navbake.navgrid.doors import Door
    from navbake.navgrid.rooms import Neighbour, Room

PIPE_WIDTH = 10_000  # columns of what is no terminal: nothing is cut or wrapped there


class StageProgress:
    """A bar for each stage on the terminal's stderr; nothing where stderr is no terminal."""

    def __init__(self, title: str, hidden: bool = False) -> None:
        console = Console(stderr=True, markup=False, highlight=False, emoji=False)
        self._progress = Progress(
            TextColumn(f"{title} {{task.description}}", markup=False),
            BarColumn(),
            TimeElapsedColumn(),
            console=console,
            transient=True,
        )
        self._is_shown = console.is_terminal and not hidden
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> StageProgress:
        if self._is_shown:
            self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._is_shown:
            self._progress.stop()

    def __call__(self, stage: str, fraction: float) -> None:
        if stage not in self._tasks:
            self._tasks[stage] = self._progress.add_task(stage, total=1.0)
        self._progress.update(self._tasks[stage], completed=fraction)


def print_tables(*tables: Table) -> None:
    """Print tables on stdout, one under the other."""
    width = None if sys.stdout.isatty() else PIPE_WIDTH
    console = Console(width=width, markup=False, highlight=False, emoji=False)
    for index, table in enumerate(tables):
        if index:
            console.print()
        console.print(table)


def geom_table(geoms: Iterable[GeomReport]) -> Table:
    """One row a geom: whether it counts, as what, why."""
    rows = (
        (
            str(geom.id),
            geom.name,
            geom.body,
            geom.type,
            "yes" if geom.counted else "no",
            geom.shape,
            geom.reason,
        )
        for geom in geoms
    )
    return _table(("id", "geom", "body", "type", "counted", "as", "why"), rows, numbers={"id"})


def fact_table(facts: dict[str, Any]) -> Table:
    """One row a fact of the whole grid, from `navbake.views.info.describe`."""
    rows = [
        ("type", facts["type"]),
        ("scene", facts["scene_id"] or "not named"),
        ("cell size [m]", f"{facts['cell_size']:g}"),
        *((f"agent {name.replace('_', ' ')}", str(v)) for name, v in facts["agent"].items()),
        *(("inflated to [m]", _inflation(entry)) for entry in facts["inflated"]),
        ("islands", str(facts["num_islands"])),
        ("links", str(facts["num_links"])),
        ("doors", str(len(facts["doors"]))),
        *((name.replace("_", " "), str(value)) for name, value in facts["made_by"].items()),
    ]
    table = _table(("", ""), rows)
    table.show_header = False
    return table


def _inflation(entry: dict[str, Any]) -> str:
    return f"{entry['radius']}, clearance {entry['clearance']} ({entry['mode']})"


def level_table(facts: dict[str, Any]) -> Table:
    """One row a level, from `navbake.views.info.describe`; rooms only where there are any."""
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


def room_table(rooms: Iterable[Room], levels: Sequence[str]) -> Table:
    """One row a room, see `navbake.navgrid.rooms.Room`.

    Args:
        rooms: the rooms.
        levels: the levels' names.
    """
    rows = (
        (
            room.id,
            room.name or "",
            levels[room.level],
            str(room.index),
            f"{room.area:.2f}",
            " ".join(f"{value:.2f}" for value in room.centroid),
            room.source or "",
            ", ".join(_neighbour(neighbour) for neighbour in room.neighbours),
        )
        for room in rooms
    )
    headings = ("id", "name", "level", "index", "m2", "centroid x y z m", "from", "opens to")
    return _table(headings, rows, numbers={"index", "m2"})


def door_table(doors: Iterable[Door], levels: Sequence[str]) -> Table:
    """One row a door, see `navbake.navgrid.doors.Door`.

    Args:
        doors: the doors.
        levels: the levels' names.
    """
    rows = (
        (
            door.id,
            door.joint or "none",
            ", ".join(levels[level] for level in door.levels),
            _joined(door.rooms),
            f"{door.state} ({door.like})" if door.like else door.state,
            ", ".join(door.states),
        )
        for door in doors
    )
    return _table(("door", "joint", "level", "joins", "is", "can be"), rows)


def why_table(facts: dict[str, Any]) -> Table:
    """One row a fact of a place, from `navbake.views.why.describe_cell`."""
    room, weight = facts["room"], facts["weight"]
    verdict = "an agent can stand here"
    if not facts["free"]:
        verdict = "blocked" if facts["floor"] is not None else "no floor here"
    rows = [
        ("verdict", verdict),
        ("blocked by", ", ".join(facts["blockers"]) or "-"),
        ("level", str(facts["level"])),
        ("cell", f"{facts['cell']} (row {facts['row']}, col {facts['col']})"),
        ("center [m]", ", ".join(f"{v:.3f}" for v in facts["center"])),
        ("floor [m]", "none" if facts["floor"] is None else f"{facts['floor']:.3f}"),
        ("weight", "infinite" if weight is None else f"{weight:g}"),
        ("room", "none" if room is None else str(room["id"] if isinstance(room, dict) else room)),
        ("island", "none" if facts["island"] is None else str(facts["island"])),
        *((key, ", ".join(facts[key]) or "-") for key in ("doors", "objects", "walls")),
    ]
    table = _table(("", ""), rows)
    table.show_header = False
    return table


def _joined(rooms: Sequence[str | None]) -> str:
    """What a door joins; nothing if a pattern made a door of what stands anywhere."""
    names = ["outside" if room is None else room for room in rooms]
    return " - ".join(names) if any(rooms) else "nothing"


def _neighbour(neighbour: Neighbour) -> str:
    how = neighbour.door or ("steps" if neighbour.kind == "link" else "")
    return f"{neighbour.room} ({how})" if how else neighbour.room


def _height_range(level: dict[str, Any]) -> str:
    if level["floor_min"] is None:
        return "none"
    return f"{level['floor_min']:.3f} to {level['floor_max']:.3f}"


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
