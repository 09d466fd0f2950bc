"""The ``userData`` of a level: left unread in the file where they are long, read when needed.

They are read and checked with the rest of the file up to `DEFER_BYTES`, and when first used, or
written, beyond.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.formats.json_path import JsonPath, shown
from navbake.formats.values import json_object, plain
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.user_data import Shared, UserData, collector_off
from navbake.types import Int, Json

DEFER_BYTES = 1 << 16
ENTRIES = 1 << 16  # cells whose entries are written at once, for the memory that it takes
KEY = b'"userData":'


@dataclass(frozen=True)
class UnreadPiece:
    """The user data of a level as a piece of a file's JSON that was not parsed."""

    text: bytes | memoryview  # one whole value; a view, because copies of so much take long
    line: int  # where it starts, from 1
    column: int
    place: JsonPath
    num_cells: int = 0  # of its level

    def __reduce__(self) -> tuple[type[UnreadPiece], tuple[Any, ...]]:
        own = bytes(self.text), self.line, self.column, self.place, self.num_cells
        return UnreadPiece, own  # views can't be pickled

    def read(self) -> dict[int, Json]:
        return check_user_data(self._parse(), self.place, self.num_cells)

    def encode(self, num_cells: int) -> bytes | None:
        """The piece itself, None if it isn't what would be written for a level of so many cells."""
        if num_cells != self.num_cells:
            return None
        with collector_off():
            parsed = self._parse()
            ids = np.fromiter(check_user_data(parsed, self.place, num_cells), dtype=np.int64)
            is_own = (ids[1:] > ids[:-1]).all() and orjson.dumps(parsed) == self.text
        return bytes(self.text) if is_own else None

    def _parse(self) -> Json:
        parsed = parse_json(self.text, self.place, self.line, self.column)
        return json_object(plain(parsed, self.place), self.place)


def parse_file(content: bytes, top: JsonPath) -> Json:
    """Parse a NavGrid file, with an `UnreadPiece` in the place of each long ``userData``."""
    spans = find_spans(content)
    parsed = _parse_around(content, spans, top) if spans else None
    return json_object(parse_json(content, top), top) if parsed is None else parsed


def parse_json(content: bytes | memoryview, place: JsonPath, line: int = 1, column: int = 1) -> Any:
    """Parse JSON that starts at a line and column of the place's file."""
    try:
        return orjson.loads(content)
    except orjson.JSONDecodeError as error:
        near = error.doc[error.pos : error.pos + 9].lstrip("-")
        hint = "; NaN and Infinity are no JSON, write null" if near[:3] in ("NaN", "Inf") else ""
        at = error.colno + (column - 1 if error.lineno == 1 else 0)
        position = f"line {error.lineno + line - 1}, column {at}"
        raise FormatError(f"broken JSON in {place.file}, {position}: {error.msg}{hint}") from error


def find_spans(content: bytes) -> list[tuple[int, int]]:
    """Find where long user data may start and end, fast, if they are as written compactly.

    The end is taken to be the first ``}}``. Whether it is one shows when the rest is parsed:
    if it were within a string or deeper than the start, the rest would not be JSON. It can't
    be further out than the end, because every ``}`` before it has to be followed by ``,"`` and
    a digit, as after an entry of user data but the last; entries are objects.

    Returns:
        First byte and the one after the last of each; [] where anything looks unusual.
    """
    start = content.find(KEY + b'{"')
    if start < 0 or len(content) - start < DEFER_BYTES:
        return []
    # all closing brackets at once; numpy is ten times as fast here as one search after another
    text = np.frombuffer(content, dtype=np.uint8)
    closing = start + np.flatnonzero(text[start:] == ord("}"))
    double = np.flatnonzero(closing[1:] - closing[:-1] == 1)
    spans = []
    while start >= 0:
        start += len(KEY)
        first = int(np.searchsorted(closing, start))
        pair = int(np.searchsorted(double, first))
        if pair == len(double):
            return []
        last = int(double[pair])
        end = int(closing[last]) + 2
        if end - start >= DEFER_BYTES:
            # a backslash may hide a quote, so that a bracket is within a string
            has_backslash = content.find(b"\\", start, end) >= 0
            if has_backslash or not _separates_entries(text, closing[first:last]):
                return []
            spans.append((start, end))
        start = content.find(KEY + b'{"', end)
    return spans


def _separates_entries(text: NDArray[np.uint8], closing: Int) -> bool:
    """Whether the next entry's cell id follows on each of these brackets."""
    is_digit = text[closing + 3] - np.uint8(ord("0")) < 10  # uint8: below 0 wraps around
    follows = (text[closing + 1] == ord(",")) & (text[closing + 2] == ord('"')) & is_digit
    return bool(follows.all())


def _parse_around(content: bytes, spans: list[tuple[int, int]], top: JsonPath) -> Json | None:
    """Parse a file with ``null`` for the spans, and put unread pieces there.

    In JSON, the quoted word ``"userData"`` is a key, or a string that says it. Where there are as
    many of these words as levels, and each level has the key, each word is the key of one level,
    in their order. So it is known whose each span is. None where it is not, or the rest is no JSON.
    """
    rest, pieces = bytearray(), {}
    end = 0
    for start, next_end in spans:
        rest += content[end:start]
        line = content.count(b"\n", 0, start) + 1
        before = content[content.rfind(b"\n", 0, start) + 1 : start]
        text = memoryview(content)[start:next_end]
        number = rest.count(KEY[:-1]) - 1
        pieces[number] = UnreadPiece(text, line, len(before.decode(errors="replace")) + 1, top)
        rest += b"null"
        end = next_end
    rest += content[end:]
    if b"\\u" in rest:  # the key may be spelt with escapes
        return None
    try:
        parsed = orjson.loads(rest)
    except orjson.JSONDecodeError:
        return None
    levels = _levels(parsed)
    if len(levels) != rest.count(KEY[:-1]) or any("userData" not in level for level in levels):
        return None
    for number, piece in pieces.items():
        levels[number]["userData"] = piece
    return parsed if isinstance(parsed, dict) else None


def _levels(parsed: Any) -> list[Json]:
    """The objects of a parsed file that are levels."""
    if not isinstance(parsed, dict):
        return []
    if parsed.get("type") == "SceneGrid2D":
        return [parsed]
    levels = parsed.get("grids") if parsed.get("type") == "MultiLevelGrid" else None
    return [level for level in levels if isinstance(level, dict)] if levels else []


def read_user_data(value: Any, place: JsonPath, num_cells: int) -> UserData:
    """Read user data as `parse_file` gives them; an `UnreadPiece` is kept for later."""
    if isinstance(value, UnreadPiece):
        return UserData(replace(value, place=place, num_cells=num_cells))
    stored = {} if value is None else json_object(plain(value, place), place)
    return UserData(check_user_data(stored, place, num_cells))


def check_user_data(stored: Json, place: JsonPath, num_cells: int) -> dict[int, Json]:
    """Turn the keys of user data into cell ids, and check that entries are objects."""
    ids = [int(key) if key.isdecimal() and len(key) <= 15 else -1 for key in stored]
    for key, cell_id in zip(stored, ids, strict=True):
        if not 0 <= cell_id < num_cells or str(cell_id) != key:
            place.fail(f"expected a cell's id from 0 to {num_cells - 1} as key, got {shown(key)}")
    user_data = dict(zip(ids, stored.values(), strict=True))
    if not set(map(type, stored.values())) <= {dict}:
        cell_id = next(i for i in ids if not isinstance(user_data[i], dict))
        place[cell_id].refuse("an object", user_data[cell_id])
    return user_data


def encode_user_data(grid: SceneGrid2D, place: JsonPath) -> Iterator[bytes]:
    """User data by ascending cell id, in pieces; entries that cells share are encoded once.

    All is checked before the first piece.
    """
    num_cells = grid.width * grid.height
    user_data = UserData.of(grid.user_data)
    source = user_data.source
    if isinstance(source, UnreadPiece) and (text := source.encode(num_cells)) is not None:
        return iter([text])
    if isinstance(source, Shared):
        cells, number, distinct = source
        plain(list(distinct), place)
    else:
        cells, number, distinct = _share(user_data, num_cells, place)
    if len(cells) and not 0 <= cells[0] <= cells[-1] < num_cells:
        place.fail(f"expected cell ids from 0 to {num_cells - 1}, got {cells[[0, -1]]}")
    return _encode_entries(cells, number, [orjson.dumps(entry) for entry in distinct])


def _encode_entries(cells: Int, number: Int, encoded: list[bytes]) -> Iterator[bytes]:
    yield b"{"
    for first in range(0, len(cells), ENTRIES):
        part = slice(first, first + ENTRIES)
        values = map(encoded.__getitem__, number[part].tolist())
        entries = map(b'"%d":%b'.__mod__, zip(cells[part].tolist(), values, strict=True))
        yield (b"," if first else b"") + b",".join(entries)
    yield b"}"


def _share(user_data: Mapping[int, Json], num_cells: int, place: JsonPath) -> Shared:
    """Number the distinct entries; a caller's user data may hold anything, so they are checked."""
    distinct: dict[int, tuple[int, int, Json]] = {}
    for cell_id, value in user_data.items():
        if not isinstance(cell_id, int | np.integer) or not 0 <= cell_id < num_cells:
            place.fail(f"expected cell ids from 0 to {num_cells - 1}, got {shown(cell_id)}")
        if not isinstance(value, dict):
            place[int(cell_id)].refuse("an object", value)
        distinct.setdefault(id(value), (len(distinct), int(cell_id), value))
    plain({str(cell_id): value for _, cell_id, value in distinct.values()}, place)
    cells: Int = np.array(sorted(user_data), dtype=np.int64)
    number: Int = np.array([distinct[id(user_data[cell])][0] for cell in cells.tolist()], np.int64)
    return Shared(cells, number, [value for _, _, value in distinct.values()])
