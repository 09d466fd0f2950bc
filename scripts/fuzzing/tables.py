"""Lists of scenes as Parquet: odd columns and types, broken pages and footers, bombs."""

from __future__ import annotations

import io
from functools import cache
from random import Random
from typing import Any

import pyarrow
from pyarrow import parquet

from fuzzing.kind import Input
from fuzzing.mutations import WORDS, cut, mutate_bytes, odd_value
from fuzzing.settings import IDS, ROWS

MAGIC = 4  # bytes at the beginning, and at the end behind the length of the footer
# lengths, counts and offsets of the footer and of pages are such numbers
NUMBERS = (
    *(b"\0", b"\1", b"\2", b"\x7e", b"\xfe\x01", b"\xfe\xff\xff\xff\x0f", b"\xff\xff\xff\xff\x0f"),
    *(b"\x80\x80\x80\x80\x10", b"\x80\x89\x7a", b"\xfe\xff\xff\xff\xff\xff\xff\xff\xff\x01"),
)
FIELDS = tuple(bytes([byte]) for byte in (0x15, 0x16, 0x18, 0x19, 0x1C, 0x25, 0x28, 0x2C, 0xFC))
CODECS = ("none", "snappy", "gzip", "zstd", "lz4", "brotli")
ENCODINGS = ("PLAIN", "DELTA_BYTE_ARRAY", "DELTA_LENGTH_BYTE_ARRAY")
LONG = "a" * 1_000_000
BOMBS = 11  # kinds of them
NAMES = (*WORDS, "scene", "agent", "agent.radius.x", "scene.path", "a.b", "__index_level_0__")


def make_parquet(rng: Random) -> Input:
    """A list of scenes whose columns, pages or footer are odd; now and then a bomb."""
    data = make_bomb(rng.randrange(BOMBS)) if rng.random() < 0.02 else _write(_make_table(rng), rng)
    chance = rng.random()
    if chance < 0.3:
        data = _change_footer(data, rng)
    elif chance < 0.45:
        data = mutate_bytes(data, rng)
    elif chance < 0.6:  # the pages
        size = max(MAGIC + 1, len(data) - _footer_size(data) - 8)
        pages = mutate_bytes(data[:size], rng, MAGIC)
        data = pages + data[size:]
    elif chance < 0.7:  # the header of the first page
        at = MAGIC + rng.randrange(20)
        data = data[:at] + rng.choice(NUMBERS) + data[at + 1 :]
    return Input(cut(data, rng), ".parquet")


def _make_table(rng: Random) -> Any:
    rows: list[dict[str, Any]] = [dict(row) for row in rng.choices(ROWS, k=rng.choice((1, 2, 8)))]
    if rng.random() < 0.5:  # good ones
        rows = [{"scene": f"a{k}.xml", "agent.radius": 0.2} for k in range(rng.choice((1, 9, 99)))]
    for _ in range(rng.choice((0, 1, 1, 2))):
        row = rng.choice(rows)
        row[rng.choice((*row, *NAMES))] = rng.choice((odd_value(rng), rng.choice(IDS), LONG))
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = [_make_column([row.get(name) for row in rows], rng) for name in names]
    if rng.random() < 0.2:
        names.append(rng.choice((*NAMES, *names)))
        columns.append(_odd_column(len(rows), rng))
    return pyarrow.Table.from_arrays(columns, names=[_plain(name) for name in names])


def _plain(text: str) -> str:
    return text.encode(errors="replace").decode()


def _make_column(values: list[Any], rng: Random) -> Any:
    try:
        column = pyarrow.array(values)
    except Exception:  # values of several types, or too large
        column = pyarrow.array([None if value is None else _plain(str(value)) for value in values])
    if rng.random() < 0.05 and pyarrow.types.is_string(column.type):
        return column.dictionary_encode()
    return column


def _odd_column(count: int, rng: Random) -> Any:
    kind = rng.randrange(10)
    if kind == 0:
        return pyarrow.nulls(count, rng.choice((pyarrow.string(), pyarrow.null())))
    if kind == 1:
        units = ("s", "ms", "us", "ns")
        zone = rng.choice((None, "UTC", "No/Where", "+07:30"))
        number = rng.choice((0, 2**62, -(2**62)))
        return pyarrow.array([number] * count, pyarrow.timestamp(rng.choice(units), tz=zone))
    if kind == 2:
        return pyarrow.array([0] * count, pyarrow.decimal128(38, rng.choice((0, 2, 37))))
    if kind == 3:
        return pyarrow.array([b"\xff\xfe"] * count, rng.choice((pyarrow.binary(),
                             pyarrow.binary(2), pyarrow.large_binary())))  # fmt: skip
    if kind == 4:
        pairs = [[("a", 1), (rng.choice(("a", "b")), 2)]] * count
        return pyarrow.array(pairs, pyarrow.map_(pyarrow.string(), pyarrow.int64()))
    if kind == 5:
        value: Any = rng.choice((1, "a", None))
        for _ in range(rng.choice((1, 5, 40, 97))):
            value = rng.choice(([value], {"agent": value}, {"a": value, "b": 1}))
        return pyarrow.array([value] * count)
    if kind == 6:
        one = pyarrow.array([float("nan")] * count)
        return pyarrow.StructArray.from_arrays([one, one], names=["radius", "radius"])
    if kind == 7:
        return pyarrow.array([2**64 - 1] * count, pyarrow.uint64())
    if kind == 8:
        return pyarrow.array([0] * count, rng.choice((pyarrow.date32(), pyarrow.time64("ns"),
                             pyarrow.duration("ns"), pyarrow.date64())))  # fmt: skip
    return pyarrow.array([rng.choice((float("inf"), 1e308, -0.0))] * count)


def _write(table: Any, rng: Random) -> bytes:
    options: dict[str, Any] = {
        "compression": rng.choice(CODECS),
        "data_page_version": rng.choice(("1.0", "2.0")),
        "row_group_size": rng.choice((1, 5, 1000)),
        "store_schema": rng.random() < 0.8,
    }
    if rng.random() < 0.3:
        options["use_dictionary"] = False
        if pyarrow.string() in [field.type for field in table.schema if field.name == "scene"]:
            options["column_encoding"] = {"scene": rng.choice(ENCODINGS)}
    file = io.BytesIO()
    try:
        parquet.write_table(table, file, **options)
    except Exception:  # a type that Parquet hasn't, or a name twice
        file = io.BytesIO()
        parquet.write_table(pyarrow.table({"scene": ["a.xml"]}), file)
    return file.getvalue()


def _footer_size(data: bytes) -> int:
    return int.from_bytes(data[-8:-MAGIC], "little")


def _change_footer(data: bytes, rng: Random) -> bytes:
    """The same pages with numbers, fields or any bytes of the footer changed."""
    size = _footer_size(data)
    pages, footer = data[: -8 - size], data[-8 - size : -8]
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(len(footer))
        kind = rng.randrange(4)
        if kind < 2:
            footer = footer[:at] + rng.choice(NUMBERS) + footer[at + 1 :]
        elif kind == 2:
            footer = footer[:at] + rng.choice(FIELDS) + footer[at + 1 :]
        else:
            footer = mutate_bytes(footer, rng) or b"\0"
    size = len(footer) if rng.random() < 0.95 else rng.choice((0, 1, 2**31 - 1, 2**32 - 1))
    return pages + footer + size.to_bytes(4, "little") + data[-MAGIC:]


@cache
def make_bomb(kind: int) -> bytes:
    """Few bytes that stand for many."""
    file = io.BytesIO()
    options: dict[str, Any] = {"compression": "zstd"}
    if kind == 0:  # a text that rows share
        columns = {"scene": pyarrow.array([LONG] * 40)}
    elif kind == 1:
        columns = {"scene": pyarrow.nulls(2_000_000, pyarrow.string())}
    elif kind == 2:
        columns = {"scene": pyarrow.array(["a.xml"]), "x": pyarrow.array([LONG * 70])}
        options["use_dictionary"] = False
    elif kind == 3:
        columns = {"scene": pyarrow.array([[None] * 2_000_000])}
    elif kind == 4:  # each text begins as the one before
        columns = {"scene": pyarrow.array([f"{LONG}{k}" for k in range(40)])}
        options |= {"use_dictionary": False, "column_encoding": {"scene": "DELTA_BYTE_ARRAY"}}
    elif kind == 5:
        columns = {"scene": pyarrow.array([LONG.encode()] * 40, pyarrow.binary(len(LONG)))}
    elif kind == 6:
        columns = {"scene": pyarrow.array(["a.xml"] * 2_000_000).dictionary_encode()}
    elif kind == 7:  # Arrow's own types, of texts that rows share
        columns = {"scene": pyarrow.array([LONG] * 40, pyarrow.large_string())}
        options |= {"use_dictionary": False, "column_encoding": {"scene": "DELTA_BYTE_ARRAY"}}
    elif kind == 8:
        texts = pyarrow.DictionaryArray.from_arrays(pyarrow.array([0] * 120, "int32"), [LONG])
        columns = {"scene": pyarrow.FixedSizeListArray.from_arrays(texts, 3)}
    elif kind == 9:
        texts = pyarrow.array([LONG] * 40)
        columns = {"scene": pyarrow.ExtensionArray.from_storage(pyarrow.json_(), texts)}
    else:
        texts = pyarrow.list_view(pyarrow.string())
        columns = {"scene": pyarrow.array([[LONG]] * 40, texts)}
    parquet.write_table(pyarrow.table(columns), file, **options)
    return file.getvalue()
