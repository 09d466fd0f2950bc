"""What a Parquet file claims to unpack to, by the headers of its pages, before any is unpacked.

pyarrow reserves what a page's header says. The footer repeats the sums, but need not tell the
truth; and pyarrow ends the process where the footer contradicts itself on what it tells of pages
(`row_group(0).column(0)`). Both are structs in Thrift's compact protocol, of which this reads as
much as it needs.

Source: https://github.com/apache/parquet-format (README.md and parquet.thrift), and
https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

STOP, TRUE, FALSE, BYTE, INT16, INT32, INT64, DOUBLE, BINARY, LIST, SET, MAP, STRUCT = range(13)
LONG_LIST = 15  # the count of a list that stands behind its header
MOST_NESTED = 16  # structs and lists in each other
MAGIC = 4  # bytes at the end, behind the size of the footer
# Fields are named by their number and type, as parquet.thrift has them: those of another type are
# none. Of the footer, a group of rows, a column of that:
GROUPS, COLUMNS, METADATA = (4, LIST), (1, LIST), (3, STRUCT)
NUM_VALUES = (5, INT64)
PACKED_SIZE, DATA_PLACE, DICTIONARY_PLACE = (7, INT64), (9, INT64), (11, INT64)
# of the header of a page, of the header of a data page in it, and of that of version 2:
UNPACKED, PACKED = (2, INT32), (3, INT32)
DATA, DATA_V2 = (5, STRUCT), (8, STRUCT)
COUNT, ENCODING = (1, INT32), {DATA: (2, INT32), DATA_V2: (4, INT32)}
# Encodings of texts: those of a dictionary share whole texts, and DELTA_BYTE_ARRAY their
# beginnings; PLAIN and DELTA_LENGTH_BYTE_ARRAY have each in full.
DICTIONARY, DELTA_LENGTH_BYTE_ARRAY, DELTA_BYTE_ARRAY = {2, 8}, 6, 7

Struct = dict[tuple[int, int], Any]


class Page(NamedTuple):
    """What the header of a page says.

    Attributes:
        unpacked: its size once it is unpacked [bytes].
        values: how many values it has, nulls counted; 0 for the values of a dictionary.
        encodings: of its values, by number; none for the values of a dictionary.
    """

    unpacked: int
    values: int
    encodings: tuple[int, ...]


def footer_size(content: bytes) -> int:
    """The bytes of the footer with what follows it: its size, and the magic number."""
    return int.from_bytes(content[-4 - MAGIC : -MAGIC], "little") + 4 + MAGIC


def read_chunks(content: bytes) -> list[list[Struct]]:
    """What the footer says of the columns of each group of rows.

    Raises:
        ValueError: it is broken.
    """
    begin = max(len(content) - footer_size(content), 0)
    try:
        footer, _ = _read_struct(content, begin, 0)
        return [[column[METADATA] for column in group[COLUMNS]] for group in footer[GROUPS]]
    except (LookupError, TypeError) as error:
        raise ValueError("the footer is broken") from error


def list_pages(content: bytes, chunk: Struct) -> Iterator[Page]:
    """The pages of a column of a group of rows.

    Raises:
        ValueError: a header is broken or claims less than nothing.
    """
    try:
        at, size, dictionary = chunk[DATA_PLACE], chunk[PACKED_SIZE], chunk.get(DICTIONARY_PLACE, 0)
        if 0 < dictionary < at:
            at = dictionary
        # of a column without values no page is read, and there need be none
        end = min(at + size, len(content)) if chunk[NUM_VALUES] > 0 else 0
        while 0 <= at < end:
            header, at = _read_struct(content, at, 0)
            unpacked, packed = header[UNPACKED], header[PACKED]
            data = [(header[key], ENCODING[key]) for key in ENCODING if key in header]
            values = sum(page[COUNT] for page, _ in data)
            if min(unpacked, packed, values) < 0:
                raise ValueError("the header of a page has negative sizes")
            yield Page(unpacked, values, tuple(page[encoding] for page, encoding in data))
            at += packed
    except LookupError as error:
        raise ValueError("the header of a page is broken") from error


def _read_struct(data: bytes, at: int, depth: int) -> tuple[Struct, int]:
    """The numbers, structs and lists of a struct, and where it ends."""
    found: Struct = {}
    field = 0
    while True:
        kind, step = data[at] & 15, data[at] >> 4
        at += 1
        if kind == STOP:
            return found, at
        if step:
            field += step
        else:
            field, at = _read_number(data, at)
        if kind not in (TRUE, FALSE):  # these are all that a field of them has
            found[field, kind], at = _read_value(data, at, kind, depth + 1)


def _read_value(data: bytes, at: int, kind: int, depth: int) -> tuple[Any, int]:
    """A value, None for what nobody needs, and where it ends."""
    if depth > MOST_NESTED:
        raise ValueError("the footer or the header of a page is nested too deeply")
    if kind in (INT16, INT32, INT64):
        return _read_number(data, at)
    if kind == BINARY:
        length, at = _read_varint(data, at)
        return None, at + length
    if kind == STRUCT:
        return _read_struct(data, at, depth)
    if kind in (LIST, SET):
        return _read_list(data, at, depth)
    if kind in (TRUE, FALSE, BYTE, DOUBLE):
        return None, at + (8 if kind == DOUBLE else 1)
    raise ValueError("the footer or the header of a page has values of no type")


def _read_list(data: bytes, at: int, depth: int) -> tuple[list[Any], int]:
    kind, count = data[at] & 15, data[at] >> 4
    at += 1
    if count == LONG_LIST:
        count, at = _read_varint(data, at)
    values = []
    for _ in range(count):
        value, at = _read_value(data, at, kind, depth + 1)
        values.append(value)
        if at > len(data):
            raise ValueError("the footer or the header of a page is cut off")
    return values, at


def _read_number(data: bytes, at: int) -> tuple[int, int]:
    """A signed number: its sign is its last bit."""
    number, at = _read_varint(data, at)
    return (number >> 1) ^ -(number & 1), at


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of seven bits a byte, the lowest first; the last byte has no eighth bit."""
    number = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        number |= (byte & 127) << shift
        if byte < 128:
            return number, at
    raise ValueError("the footer or the header of a page has a number of too many bytes")
