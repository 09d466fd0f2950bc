"""Tables as text: as wide as the terminal, and no name broken."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from navbake.errors import printable


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
