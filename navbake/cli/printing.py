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

if TYPE_CHECKING:
    from navbake.baker.scene.scene import GeomReport
    from navbake.navgrid.doors import Door
    from navbake.navgrid.rooms import Room
    from navbake.types import Json
    from navbake.verifier.report import VerifyReport

LOG = logging.getLogger("navbake")
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
    width = shutil.get_terminal_size().columns if is_terminal(sys.stdout) else PIPE_WIDTH
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


# --- tables as text: as wide as the terminal, and no name broken ---------------------------------


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


def lay_out(table: Table, width: int) -> list[str]:
    """The lines of a table that is at most so many characters wide.

    Where it is too wide, the widest columns are narrowed first, and their cells are broken at
    spaces, never within a word. Where even that is too wide, each row becomes a block of lines
    with a heading and a value each, and only a value longer than a line goes beyond the width.
    """
    shown = [list(table.headings)] if any(table.headings) else []
    rows = [*shown, *(list(row) for row in table.rows)]
    columns = [list(column) for column in zip(*rows, strict=True)]
    least = [max(_longest_word(cell) for cell in column) for column in columns]
    most = [max(text_width(cell) for cell in column) for column in columns]
    if not shown and least:
        least[0] = most[0]  # what each row is called stays on one line
    space = width - table.gap * (len(columns) - 1)
    if sum(least) > space:
        return _as_blocks(table, width) if shown else _as_rows(table, rows, least)
    cap = max(most, default=0)
    while sum(_narrowed(least, most, cap)) > space:
        cap -= 1
    return _as_rows(table, rows, _narrowed(least, most, cap))


def text_width(text: str) -> int:
    """How many columns of a terminal a text takes: a Chinese character takes two."""
    if text.isascii():
        return len(text)
    from rich.cells import cell_len  # without rich, --help starts a fifth sooner

    return cell_len(text)


def _narrowed(least: list[int], most: list[int], cap: int) -> list[int]:
    return [max(low, min(high, cap)) for low, high in zip(least, most, strict=True)]


def _as_rows(table: Table, rows: list[list[str]], widths: list[int]) -> list[str]:
    lines = []
    for row in rows:
        cells = [_wrap(cell, width) for cell, width in zip(row, widths, strict=True)]
        for number in range(max(map(len, cells))):
            parts = []
            for heading, cell, width in zip(table.headings, cells, widths, strict=True):
                text = cell[number] if number < len(cell) else ""
                blank = " " * (width - text_width(text))
                parts.append(blank + text if heading in table.numbers else text + blank)
            lines.append((" " * table.gap).join(parts).rstrip())
    return lines


def _as_blocks(table: Table, width: int) -> list[str]:
    margin = max(text_width(heading) for heading in table.headings) + table.gap
    lines: list[str] = []
    for row in table.rows:
        lines += [""] if lines else []
        for heading, cell in zip(table.headings, row, strict=True):
            for number, text in enumerate(_wrap(cell, max(width - margin, 1))):
                begin = heading if number == 0 else ""
                lines.append(f"{begin}{' ' * (margin - text_width(begin))}{text}".rstrip())
    return lines


def _wrap(text: str, width: int) -> list[str]:
    """Lines of at most so many columns, broken after commas where that does, else at spaces.

    A word that is longer has a line of its own.
    """
    if text_width(text) <= width:
        return [text]
    pieces = text.replace(", ", ",\n").split("\n")
    if max(map(text_width, pieces)) > width:
        pieces = text.split(" ")
    lines: list[str] = []
    for word in pieces:
        if lines and text_width(lines[-1]) + 1 + text_width(word) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def _longest_word(text: str) -> int:
    return max(map(text_width, text.split(" ")))
