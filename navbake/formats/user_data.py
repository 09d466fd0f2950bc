"""The ``userData`` of a level: cut out of the file unread where they are long, read when needed.

They are read and checked with the rest of the file up to `DEFER_BYTES`, and when first used, or
written, beyond.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.formats.json_path import Place, shown
from navbake.formats.values import json_object, plain
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.user_data import SharedUserData, StoredUserData, collector_off, held_user_data
from navbake.types import Json

DEFER_BYTES = 1 << 16
KEY = b'"userData":'


@dataclass(frozen=True)
class Span:
    """A piece of a file's JSON that was not parsed.

    Attributes:
        text: the piece, one whole value; a view, as a copy of so much takes its time.
        line: where it starts, from 1.
        column: likewise.
    """

    text: bytes | memoryview
    line: int
    column: int

    def __reduce__(self) -> tuple[type[Span], tuple[bytes, int, int]]:
        return Span, (bytes(self.text), self.line, self.column)  # views can't be pickled


class SpanUserData(StoredUserData):
    """User data as the piece of a file that holds them."""

    def __init__(self, span: Span, place: Place, num_cells: int) -> None:
        self._span = span
        self._place = place
        self._num_cells = num_cells
        self._resolved: dict[int, Json] | None = None

    def resolve(self) -> dict[int, Json]:
        """Read and check them; the same dictionary each time."""
        if self._resolved is None:
            with collector_off():
                self._resolved = check_user_data(self._parse(), self._place, self._num_cells)
        return self._resolved

    def encode(self, num_cells: int) -> bytes | None:
        """The piece itself, if it is what would be written for a level of so many cells.

        Returns:
            None if it isn't, or if somebody may have changed what was read from it.

        Raises:
            FormatError: it doesn't follow the format.
        """
        if self._resolved is not None or num_cells != self._num_cells:
            return None
        with collector_off():
            parsed = self._parse()
            ids = np.fromiter(check_user_data(parsed, self._place, num_cells), dtype=np.int64)
            is_own = (ids[1:] > ids[:-1]).all() and orjson.dumps(parsed) == self._span.text
        return bytes(self._span.text) if is_own else None

    def _parse(self) -> Json:
        parsed = parse_json(self._span.text, self._place, self._span.line, self._span.column)
        return json_object(plain(parsed, self._place), self._place)


def parse_file(content: bytes, top: Place) -> Json:
    """Parse a NavGrid file, with a `Span` in the place of each long ``userData`` of a level."""
    spans = find_spans(content)
    parsed = _parse_around(content, spans) if spans else None
    return json_object(parse_json(content, top), top) if parsed is None else parsed


def parse_json(content: bytes | memoryview, place: Place, line: int = 1, column: int = 1) -> Any:
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
            if (
                not _separates_entries(text, closing[first:last])
                or content.find(b"\\", start, end) >= 0
            ):
                return []
            spans.append((start, end))
        start = content.find(KEY + b'{"', end)
    return spans


def _separates_entries(text: NDArray[np.uint8], closing: NDArray[np.int64]) -> bool:
    """Whether the next entry's cell id follows on each of these brackets."""
    is_digit = text[closing + 3] - np.uint8(ord("0")) < 10  # uint8: below 0 wraps around
    follows = (text[closing + 1] == ord(",")) & (text[closing + 2] == ord('"')) & is_digit
    return bool(follows.all())


def _parse_around(content: bytes, spans: list[tuple[int, int]]) -> Json | None:
    """Parse a file with marks for the spans, and put the spans where the marks are.

    Returns:
        None where the rest is no JSON, or a mark is not where a level has its user data.
    """
    mark = f"span {os.urandom(16).hex()} "  # nobody can have written this into the file
    edges = [0, *(edge for span in spans for edge in span), len(content)]
    pieces = [content[edges[i] : edges[i + 1]] for i in range(0, len(edges), 2)]
    marked = pieces[0] + b"".join(
        b'"%b%d"%b' % (mark.encode(), i, piece) for i, piece in enumerate(pieces[1:])
    )
    try:
        parsed = orjson.loads(marked)
    except orjson.JSONDecodeError:
        return None
    levels = _levels(parsed)
    marks = {level["userData"]: level for level in levels if _is_mark(level, mark)}
    if len(marks) != len(spans):
        return None
    for i, (start, end) in enumerate(spans):
        line = content.count(b"\n", 0, start) + 1
        before = content[content.rfind(b"\n", 0, start) + 1 : start]
        column = len(before.decode(errors="replace")) + 1
        marks[f"{mark}{i}"]["userData"] = Span(memoryview(content)[start:end], line, column)
    return parsed if isinstance(parsed, dict) else None


def _levels(parsed: Any) -> list[Json]:
    """The objects of a parsed file that are levels."""
    if not isinstance(parsed, dict):
        return []
    if parsed.get("type") == "SceneGrid2D":
        return [parsed]
    levels = parsed.get("grids") if parsed.get("type") == "MultiLevelGrid" else None
    return [level for level in levels if isinstance(level, dict)] if levels else []


def _is_mark(level: Json, mark: str) -> bool:
    value = level.get("userData")
    return isinstance(value, str) and value.startswith(mark)


def read_user_data(value: Any, place: Place, num_cells: int) -> Any:
    """Read user data, or keep them for later.

    Args:
        value: what the file has, as `parse_file` gives it.
        place: where in the file.
        num_cells: of the level.

    Returns:
        A dictionary by cell id, or a `StoredUserData`.

    Raises:
        FormatError: they don't follow the format.
    """
    if isinstance(value, Span):
        return SpanUserData(value, place, num_cells)
    stored = {} if value is None else json_object(plain(value, place), place)
    return check_user_data(stored, place, num_cells)


def check_user_data(stored: Json, place: Place, num_cells: int) -> dict[int, Json]:
    """Turn the keys of user data into cell ids.

    Raises:
        FormatError: a key is not a cell's id, or an entry not an object.
    """
    ids = [int(key) if key.isdecimal() and len(key) <= 15 else -1 for key in stored]
    for key, cell_id in zip(stored, ids, strict=True):
        if not 0 <= cell_id < num_cells or str(cell_id) != key:
            place.fail(f"expected a cell's id from 0 to {num_cells - 1} as key, got {shown(key)}")
    user_data = dict(zip(ids, stored.values(), strict=True))
    if not set(map(type, stored.values())) <= {dict}:
        cell_id = next(i for i in ids if not isinstance(user_data[i], dict))
        place[cell_id].refuse("an object", user_data[cell_id])
    return user_data


def encode_user_data(grid: SceneGrid2D, place: Place) -> orjson.Fragment:
    """User data by ascending cell id; entries that cells share are checked and encoded once."""
    num_cells = grid.width * grid.height
    held = held_user_data(grid)
    if isinstance(held, SpanUserData):
        text = held.encode(num_cells)
        if text is not None:
            return orjson.Fragment(text)
    if isinstance(held, SharedUserData) and not held.is_resolved:
        return _encode_shared(held, num_cells, place)
    user_data: dict[int, Json] = held.resolve() if isinstance(held, StoredUserData) else held
    distinct: dict[int, tuple[int, Json]] = {}
    for cell_id, value in user_data.items():
        if not isinstance(cell_id, int | np.integer) or not 0 <= cell_id < num_cells:
            place.fail(f"expected cell ids from 0 to {num_cells - 1}, got {shown(cell_id)}")
        if not isinstance(value, dict):
            place[int(cell_id)].refuse("an object", value)
        distinct.setdefault(id(value), (int(cell_id), value))
    plain({str(cell_id): value for cell_id, value in distinct.values()}, place)
    encoded = {key: orjson.dumps(value) for key, (_, value) in distinct.items()}
    entries = [
        b'"%d":%b' % (cell_id, encoded[id(user_data[cell_id])]) for cell_id in sorted(user_data)
    ]
    return orjson.Fragment(b"{%b}" % b",".join(entries))


def _encode_shared(held: SharedUserData, num_cells: int, place: Place) -> orjson.Fragment:
    if len(held.cells) and not 0 <= held.cells[0] <= held.cells[-1] < num_cells:
        place.fail(f"expected cell ids from 0 to {num_cells - 1}, got {held.cells[[0, -1]]}")
    plain(list(held.entries), place)
    encoded = [orjson.dumps(entry) for entry in held.entries]
    entries = map(
        b'"%d":%b'.__mod__,
        zip(held.cells.tolist(), map(encoded.__getitem__, held.number.tolist()), strict=True),
    )
    return orjson.Fragment(b"{%b}" % b",".join(entries))
