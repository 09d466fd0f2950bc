"""The ``userData`` of a level: parsed and checked when they are first asked for, and written.

Names of what stands in each cell are most of a file of a furnished house, and few who load a grid
ask for them. Of a file of `SPLIT_BYTES` and more, msgspec finds where each field of a level ends
without making objects of it, and what ``userData`` hold stays text.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import orjson

from navbake.formats.source import parse_json
from navbake.formats.values import JsonPath, json_object, plain, shown
from navbake.lazy import lazy
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.user_data import Shared, UserData
from navbake.types import Json

if TYPE_CHECKING:
    import msgspec
else:
    msgspec = lazy("msgspec")

SPLIT_BYTES = 1 << 20  # below, all is parsed at once and msgspec stays unloaded
ENTRIES = 1 << 16  # cells whose entries are written at once, for the memory that it takes


def parse_file(content: bytes, top: JsonPath) -> Json:
    """Parse a NavGrid file, with text in the place of each level's ``userData`` if it is long."""
    if len(content) >= SPLIT_BYTES:
        with suppress(msgspec.DecodeError, RecursionError, orjson.JSONDecodeError):
            return _split(content)
    return json_object(parse_json(content, top), top)  # which names the line of what is broken


def _split(content: bytes) -> Json:
    fields = msgspec.json.decode(content, type=dict[str, msgspec.Raw])
    is_house = orjson.loads(memoryview(fields.get("type", b"null"))) == "MultiLevelGrid"
    if not is_house or "grids" not in fields:
        return _parse_level(fields)
    levels = msgspec.json.decode(fields["grids"], type=list[dict[str, msgspec.Raw]])
    parsed = {key: key == "grids" or orjson.loads(memoryview(fields[key])) for key in fields}
    return {**parsed, "grids": [_parse_level(level) for level in levels]}


def _parse_level(fields: Json) -> Json:
    views = {key: memoryview(raw) for key, raw in fields.items()}
    return {key: view if key == "userData" else orjson.loads(view) for key, view in views.items()}


def read_user_data(value: Any, place: JsonPath, num_cells: int) -> UserData:
    """Read user data as `parse_file` gives them: at once, or from text on first use."""
    if isinstance(value, memoryview):
        return UserData(lambda: _check_user_data(parse_json(value, place), place, num_cells))
    return UserData(_check_user_data(value, place, num_cells))


def _check_user_data(value: Any, place: JsonPath, num_cells: int) -> dict[int, Json]:
    """Turn the keys of user data into cell ids, and check that entries are objects."""
    stored: Json = {} if value is None else json_object(plain(value, place), place)
    ids = [int(key) if key.isdecimal() and len(key) <= 15 else -1 for key in stored]
    for key, cell_id in zip(stored, ids, strict=True):
        if not 0 <= cell_id < num_cells or str(cell_id) != key:
            place.fail(f"expected a cell's id from 0 to {num_cells - 1} as key, got {shown(key)}")
    if not set(map(type, stored.values())) <= {dict}:
        key, odd = next((k, v) for k, v in stored.items() if not isinstance(v, dict))
        place[int(key)].refuse("an object", odd)
    return dict(zip(ids, stored.values(), strict=True))


def encode_user_data(grid: SceneGrid2D, place: JsonPath) -> Iterator[bytes]:
    """User data by ascending cell id, in pieces; entries that cells share are encoded once.

    All is checked before the first piece.
    """
    num_cells = grid.width * grid.height
    source = UserData.of(grid.user_data).source
    if isinstance(source, Shared):
        cells, number, entries = source.cells.tolist(), source.number.tolist(), source.entries
        plain(list(entries), place)
    else:
        for cell_id, value in source.items():
            if not isinstance(cell_id, int | np.integer):
                place.fail(f"expected cell ids from 0 to {num_cells - 1}, got {shown(cell_id)}")
            if not isinstance(value, dict):
                place[int(cell_id)].refuse("an object", value)
        cells = sorted(map(int, source))
        number, entries = range(len(cells)), [source[cell] for cell in cells]
        plain({str(cell): entry for cell, entry in zip(cells, entries, strict=True)}, place)
    if cells and not 0 <= cells[0] <= cells[-1] < num_cells:
        wrong = cells[0] if cells[0] < 0 else cells[-1]
        place.fail(f"expected cell ids from 0 to {num_cells - 1}, got {wrong}")
    return _encode_entries(cells, number, [orjson.dumps(entry) for entry in entries])


def _encode_entries(cells: list[int], number: Any, encoded: list[bytes]) -> Iterator[bytes]:
    yield b"{"
    for first in range(0, len(cells), ENTRIES):
        part = slice(first, first + ENTRIES)
        entries = zip(cells[part], map(encoded.__getitem__, number[part]), strict=True)
        yield (b"," if first else b"") + b",".join(map(b'"%d":%b'.__mod__, entries))
    yield b"}"
