"""What commands print: tables and JSON on stdout, warnings and errors on stderr."""

from __future__ import annotations

import json
import logging
import shutil
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from navbake.errors import printable
from navbake.lazy import lazy

if TYPE_CHECKING:
    from navbake.baker.scene.scene import GeomReport
    from navbake.navgrid.doors import Door
    from navbake.navgrid.rooms import Room
    from navbake.types import Json
    from navbake.verifier.report import VerifyReport

rich_console = lazy("rich.console")  # which take 0.1 s: only what is too wide needs them
rich_table = lazy("rich.table")

LOG = logging.getLogger("navbake")
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


@dataclass
class Volume:
    """How much commands print: `quiet` and `verbose` are what --quiet and --verbose ask for."""

    quiet: bool = False
    verbose: bool = False


VOLUME = Volume()
"""Of the command that runs; `volume` sets it."""


@contextmanager
def volume(*, quiet: bool, verbose: bool) -> Iterator[None]:
    """Print less or more inside.

    With `verbose`, the records of the logger ``navbake`` go to stderr, but for warnings, which
    commands print anyway, and then how long it took.
    """
    VOLUME.quiet, VOLUME.verbose = quiet, verbose
    if not verbose:
        yield
        return
    begin, level = time.perf_counter(), LOG.level
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("navbake: %(message)s"))
    handler.addFilter(_is_for_the_terminal)
    LOG.addHandler(handler)
    LOG.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        LOG.debug("%.2f s in all", time.perf_counter() - begin)
        LOG.removeHandler(handler)
        LOG.setLevel(level)


def _is_for_the_terminal(record: logging.LogRecord) -> bool:
    """Whether a record is to be printed; then control characters in it are escaped."""
    record.msg, record.args = printable(record.getMessage()), ()
    return record.levelno < logging.WARNING


def print_json_line(value: Any) -> None:
    """Print a value as one line of JSON, at once: others may read along."""
    print(json.dumps(value, separators=(",", ":"), allow_nan=False), flush=True)


def print_json(value: Any) -> None:
    """Print a value as JSON; NaN and infinity are refused, as JSON has neither."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    # JSON escapes what is below a space; other characters may control a terminal, too
    print("".join(c if c.isprintable() or c == "\n" else json.dumps(c)[1:-1] for c in text))


def say(text: object) -> None:
    """Print one line, control characters escaped: names may hold what moves a cursor."""
    print(printable(str(text)))


def say_unless_quiet(text: object) -> None:
    """Print one line that nobody asked for; with --quiet nothing."""
    if not VOLUME.quiet:
        say(text)


def print_error(message: str) -> None:
    """Print one line on stderr."""
    if sys.stderr is not None:  # else print would take stdout
        print(f"navbake: {printable(message)}", file=sys.stderr)


def print_causes(error: BaseException) -> None:
    """Print on stderr what led to an error, one line each; without --verbose nothing."""
    cause = error.__cause__ if VOLUME.verbose else None
    while cause is not None:
        print_error(f"because of {type(cause).__name__}: {cause}")
        cause = cause.__cause__


def print_warnings(warnings: Iterable[str]) -> None:
    """Print warnings on stderr, one a line."""
    for warning in warnings:
        print_error(f"warning: {warning}")


def is_terminal(stream: TextIO | None) -> bool:
    """Whether a stream is one of a terminal; None is a closed one."""
    return stream is not None and stream.isatty()


def print_tables(*tables: Table) -> None:
    """Print tables on stdout, one under the other, at most as wide as the terminal."""
    width = shutil.get_terminal_size().columns if is_terminal(sys.stdout) else None
    for index, table in enumerate(tables):
        print("\n" * (index > 0) + "\n".join(lay_out(table, width)))


def geom_table(geoms: Iterable[GeomReport]) -> Table:
    """A row for each geom: whether it counts, as what, and why."""
    rows = (
        (g.id, g.name, g.body, g.type, "yes" if g.counted else "no", g.shape, g.reason)
        for g in geoms
    )
    return make_table(("id", "geom", "body", "type", "counted", "as", "why"), rows, numbers=("id",))


def summary_table(facts: Json) -> Table:
    """A row for each fact about the whole grid, from `navbake.views.describe.describe`."""
    return make_table(
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
    """A row for each level, from `navbake.views.describe.describe`; rooms only if there are any."""
    columns = dict(LEVEL_COLUMNS)
    if any(level["num_rooms"] for level in facts["levels"]):
        columns["rooms"] = "{num_rooms}"
    rows = []
    for index, level in enumerate(facts["levels"]):
        has_floor = level["floor_min"] is not None
        floor = "{floor_min:.3f} to {floor_max:.3f}".format_map(level) if has_floor else "none"
        known = {**level, "index": index, "floor": floor}
        rows.append([text.format_map(known) for text in columns.values()])
    return make_table(tuple(columns), rows, numbers=columns.keys() - {"name"}, gap=1)


def room_table(rooms: Sequence[Room], levels: Sequence[str]) -> Table:
    """A row for each room; `levels` are the levels' names. Columns that say nothing are left out.

    That is the level where there is but one, and the index of rooms whose ids hold it.
    """
    rows = []
    for room in rooms:
        opens_to = []
        for neighbour in room.neighbours:
            how = neighbour.door or ("steps" if neighbour.kind == "link" else "")
            opens_to.append(f"{neighbour.room} ({how})" if how else neighbour.room)
        index = "" if room.id == f"{room.level}:{room.index}" else room.index
        named = (room.id, room.name or "", levels[room.level] if len(levels) > 1 else "", index)
        centroid = " ".join(f"{value:.2f}" for value in room.centroid)
        source = f"{room.source or ''}{', outdoors' if room.outdoors else ''}"
        rows.append((*named, f"{room.area:.2f}", centroid, source, ", ".join(opens_to)))
    headings = ("id", "name", "level", "index", "m2", "centroid x y z m", "from", "opens to")
    return without_empty_columns(make_table(headings, rows, numbers=("index", "m2")))


def door_table(doors: Iterable[Door], levels: Sequence[str]) -> Table:
    """A row for each door; `levels` are the levels' names. Columns that say nothing are left out.

    That is the level where there is but one, and the joints where they are called as the doors.
    """
    doors = list(doors)
    is_joint_told = any(door.joint != door.id for door in doors)
    rows = []
    for door in doors:
        joined = " - ".join("outside" if room is None else room for room in door.rooms)
        rows.append(
            (
                door.id,
                (door.joint or "none") if is_joint_told else "",
                ", ".join(levels[level] for level in door.levels) if len(levels) > 1 else "",
                # a body that a pattern made a door may stand anywhere
                joined if any(door.rooms) else "nothing",
                f"{door.state} ({door.like})" if door.like else door.state,
                ", ".join(door.states),
            )
        )
    headings = ("door", "joint", "level", "joins", "is", "can be")
    return without_empty_columns(make_table(headings, rows))


def cell_table(facts: Json) -> Table:
    """A row for each fact about a cell, from `navbake.views.describe.describe_cell`."""
    room, weight, floor = facts["room"], facts["weight"], facts["floor"]
    blocked = "no floor here" if floor is None else "blocked"
    return make_table(
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
    return make_table(tuple(VERIFY_COLUMNS), rows, numbers=VERIFY_COLUMNS.keys() - {"level"})


# --- tables as text -------------------------------------------------------------------------------


class Table(NamedTuple):
    """What is printed as a table.

    Attributes:
        headings: one a column; all empty for a table without a line of them.
        rows: as many cells each.
        numbers: headings of the columns that are aligned on the right.
        gap: spaces between columns.
    """

    headings: Sequence[str]
    rows: Sequence[Sequence[Any]]
    numbers: frozenset[str] = frozenset()
    gap: int = 2


def make_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[Any]],
    numbers: Iterable[str] = (),
    gap: int = 2,
) -> Table:
    """A table of cells as text, control characters escaped: names may hold what moves a cursor."""
    cells = [[printable(str(cell)) for cell in row] for row in rows]
    return Table(headings, cells, frozenset(numbers), gap)


def without_empty_columns(table: Table) -> Table:
    """The table without the columns in which no row has anything."""
    kept = [i for i in range(len(table.headings)) if any(row[i] for row in table.rows)]
    rows = [[row[i] for i in kept] for row in table.rows]
    return table._replace(headings=[table.headings[i] for i in kept], rows=rows)


def lay_out(table: Table, width: int | None = None) -> list[str]:
    """The lines of a table; of one that is wider than `width` characters, rich wraps the cells."""
    shown = [table.headings, *table.rows] if any(table.headings) else table.rows
    widths = [max(map(text_width, column)) for column in zip(*shown, strict=True)]
    if width is not None and sum(widths) + table.gap * (len(widths) - 1) > width:
        return _wrap(table, width)
    lines = []
    for row in shown:
        cells = []
        for heading, cell, most in zip(table.headings, row, widths, strict=True):
            blank = " " * (most - text_width(cell))
            cells.append(blank + cell if heading in table.numbers else cell + blank)
        lines.append((" " * table.gap).join(cells).rstrip())
    return lines


def _wrap(table: Table, width: int) -> list[str]:
    wrapped = rich_table.Table(
        box=None,
        pad_edge=False,
        padding=(0, table.gap, 0, 0),
        show_header=any(table.headings),
        header_style="",
    )
    for heading in table.headings:
        is_number = heading in table.numbers
        wrapped.add_column(
            heading, justify="right" if is_number else "left", overflow="fold", no_wrap=is_number
        )
    for row in table.rows:
        wrapped.add_row(*row)
    screen = rich_console.Console(
        width=width, color_system=None, markup=False, highlight=False, emoji=False
    )
    with screen.capture() as captured:
        screen.print(wrapped)
    return [line.rstrip() for line in captured.get().splitlines()]


def text_width(text: str) -> int:
    """How many columns of a terminal a text takes: a Chinese character takes two."""
    if text.isascii():
        return len(text)
    from rich.cells import cell_len  # without rich, --help starts a fifth sooner

    return cell_len(text)
