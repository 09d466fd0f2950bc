"""Checks of values in untrusted files, and limits on the cells and memory that reading them takes.

A few bytes of runs or packed data may expand to more than memory holds. So a reader makes one
`Allowance` for the file, and takes each array from it before it is reserved. Users' own files
(settings, lists, outlines of rooms) have no such limit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from numbers import Real
from typing import TYPE_CHECKING, Any, NoReturn

from navbake.errors import ConfigError, FormatError

if TYPE_CHECKING:  # the command line lists formats before it loads numpy
    from navbake.types import Json, Vector3

MAX_BYTES = 4 << 30  # of any file
MAX_CELLS = 100_000_000  # of all levels together
MAX_VOXELS = 1 << 31  # 1290 along each axis
MAX_PIXELS = 80_000_000  # below the number from which Pillow warns of a decompression bomb
MAX_DEPTH = 64  # of metadata, userData, timings and unknown fields
MAX_HEADER = 65536  # text before the voxels of a binvox or octree, comments included [bytes]
FREE_BYTES = 256 << 20  # of memory that any file may fill
# and for each of its bytes; a campus as an octree takes 400, house-100 as JSON 40
BYTES_PER_BYTE = 512
BYTES_PER_CELL = 128  # of all arrays together, with a caller's `max_cells`
TEXT_COST = 4  # bytes of memory for one of packed JSON, whose values take more
PIXEL_COST = 6  # bytes of memory for a pixel: an image, a copy, and values
SHOWN_LENGTH = 40  # characters of a culprit that an error shows
LEAVES = {str, int, bool, type(None)}  # JSON's values without children
ALL = LEAVES | {dict, list, tuple}
JSON = (str, int, float, dict, list, tuple)


# ---------------------------------------------------------------- values and their locations


MISSING: Any = object()  # stands for a missing field


def format_value(value: object) -> str:
    """Format a value for an error message: short, on one line."""
    if value is MISSING:
        return "nothing"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return f"an object of {len(value)} fields"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, str):
        value = value[: SHOWN_LENGTH + 1]
    elif isinstance(value, int) and abs(value) > 10**SHOWN_LENGTH:
        return f"{value:.3e}" if abs(value) < 10**300 else "an integer of over 300 digits"
    text = repr(value)
    return text if len(text) <= SHOWN_LENGTH else text[:SHOWN_LENGTH] + "…"


@dataclass(frozen=True)
class JsonPath:
    """A location in a file, as errors name it."""

    file: str
    path: str = ""  # as in ``grids[1].weights.data[17]``; "" for the top

    def __getitem__(self, key: str | int) -> JsonPath:
        if isinstance(key, int):
            step = f"[{key}]"
        elif key.isidentifier():
            step = f".{key}" if self.path else key
        else:
            step = f"[{format_value(key)}]"
        return JsonPath(self.file, self.path + step)

    def fail(
        self, what: str, remedy: str = "", *, expected: str | None = None, value: object = None
    ) -> NoReturn:
        """Raise a FormatError with the fault and its location.

        Args:
            what: The fault, the beginning of the message.
            remedy: What to do, the end of the message.
            expected: What was expected, for the attribute of the error alone.
            value: What was there, for the attribute of the error alone.
        """
        where = f"at `{self.path}` in" if self.path else "in"
        file = self.file if self.file.isprintable() else repr(self.file)
        raise FormatError(
            f"{what} {where} {file}" + (f"; {remedy}" if remedy else ""),
            path=self.file,
            value=value,
            expected=expected,
            place=self.path or None,
            hint=remedy or None,
        )

    def refuse(self, expected: str, value: object) -> NoReturn:
        """Raise a FormatError with the expected and the actual value."""
        actual = None if value is MISSING else value
        self.fail(
            f"expected {expected}, got {format_value(value)}", expected=expected, value=actual
        )


def check_whole_number(value: object, place: JsonPath, minimum: int) -> int:
    """Read an integer; 59.0 is valid, true is not."""
    integral = type(value) is int or (isinstance(value, float) and value.is_integer())
    if not integral or int(value) < minimum:  # type: ignore[call-overload]
        place.refuse(f"a whole number >= {minimum}", value)
    return int(value)  # type: ignore[call-overload,no-any-return]


def check_number(value: object, place: JsonPath, *, positive: bool = False) -> float:
    """Check a finite number; whole ones become int, so that JSON has no .0."""
    try:
        is_number = isinstance(value, Real) and not isinstance(value, bool)
        checked = float(value) if is_number else math.nan  # type: ignore[arg-type]
    except OverflowError:  # YAML has whole numbers beyond all floats
        checked = math.nan
    if not math.isfinite(checked) or (positive and checked <= 0):
        place.refuse("a number > 0" if positive else "a finite number", value)
    return int(checked) if checked.is_integer() and abs(checked) < 2**53 else checked


def check_vector(value: object, place: JsonPath) -> Vector3:
    """Check three finite numbers."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        place.refuse("three numbers", value)
    x, y, z = (float(check_number(entry, place[i])) for i, entry in enumerate(value))
    return x, y, z


def check_object(value: object, place: JsonPath) -> Json:
    if not isinstance(value, dict):
        place.refuse("an object", value)
    return value


def check_optional_object(content: Json, key: str, place: JsonPath) -> Json:
    """Read an object that may be missing or null."""
    value = content.get(key)
    return {} if value is None else check_object(check_json(value, place[key]), place[key])


def check_json(value: Any, place: JsonPath) -> Any:
    """Check that a value is JSON and not nested too deep; layer by layer, which is fast."""
    layer = [value]
    for _ in range(MAX_DEPTH):
        if set(map(type, layer)) <= LEAVES:
            return value
        for other in (v for v in layer if type(v) not in ALL):
            if not (math.isfinite(other) if isinstance(other, float) else isinstance(other, JSON)):
                _find_odd(value, place)
        # all keys, then all children, of one depth: no Python call for each value
        objects = [v for v in layer if isinstance(v, dict)]
        if not set(map(type, chain.from_iterable(objects))) <= {str}:
            place.fail("expected strings as keys of objects, got others")
        lists = [v for v in layer if isinstance(v, list | tuple)]
        layer = list(chain.from_iterable([*map(dict.values, objects), *lists]))
    place.fail(f"nested deeper than {MAX_DEPTH} levels")


def _find_odd(value: Any, place: JsonPath) -> None:
    """Refuse the first value that is not JSON."""
    if isinstance(value, dict | list | tuple):
        for key, child in value.items() if isinstance(value, dict) else enumerate(value):
            _find_odd(child, place[key if isinstance(key, int) else str(key)])
    elif isinstance(value, float) and not math.isfinite(value):
        place.refuse("a finite number", value)
    elif value is not None and not isinstance(value, JSON):
        place.fail(f"expected a JSON value, got one of Python's type {type(value).__name__}")


# ---------------------------------------------------------------- memory


class Allowance:
    """The cells, memory and text [bytes] that reading a file of some size may still reserve.

    Callers raise the limits by a keyword: ``max_cells`` of grids, or ``max_voxels`` of voxels,
    which then only free memory limits. Images have none.
    """

    def __init__(self, num_bytes: int, keyword: str = "", most: int | None = None) -> None:
        if most is not None and not (isinstance(most, int) and most >= 1):
            message = f"expected {keyword} to be a whole number >= 1, got {most!r}"
            expected = "a whole number >= 1"
            raise FormatError(message, key=keyword, value=most, expected=expected)
        self._keyword = keyword
        self._remedy = f"pass {keyword} if that is meant" if keyword else ""
        rule = FREE_BYTES + BYTES_PER_BYTE * num_bytes
        self._rule = f"a file of {num_bytes:,} bytes may fill ({rule:,} bytes)"
        self._cells = {"max_cells": MAX_CELLS, "max_voxels": MAX_VOXELS, "": MAX_PIXELS}[keyword]
        self._memory: float = rule
        self._text = rule // TEXT_COST
        self._num_bytes = num_bytes
        if most is not None:
            self._rule = f"{keyword} = {most} allows"
            self._cells = most
            self._memory = BYTES_PER_CELL * most if keyword == "max_cells" else math.inf

    def take_cells(self, shape: Sequence[int], place: JsonPath) -> None:
        """Count the cells, voxels or pixels of a shape; raises a FormatError for too many."""
        if math.prod(shape) > self._cells:
            unit = self._keyword.removeprefix("max_") or "pixels"
            counts = " × ".join(format_value(int(n)) for n in shape)
            what = f"too many {unit} ({counts}, expected {self._cells:,} at most)"
            place.fail(what, self._remedy)
        self._cells -= math.prod(shape)

    def take_array(self, shape: Sequence[int], itemsize: int, place: JsonPath) -> None:
        """Count the memory of an array; raises a FormatError for too much."""
        self._memory -= math.prod(shape) * itemsize
        if self._memory < 0:
            place.fail(f"more memory than {self._rule}", self._remedy)
        if self._keyword == "max_voxels":
            from navbake.voxels.grid import check_memory  # loads numpy

            try:
                check_memory(shape, itemsize)
            except ConfigError as error:
                raise FormatError(f"{place.file}: {error}") from None

    def take_text(self, num_bytes: int, place: JsonPath) -> None:
        """Count unpacked JSON; raises a FormatError for too much."""
        self._text -= num_bytes
        if self._text < 0:
            what = f"more text than a file of {self._num_bytes:,} bytes may unpack to"
            place.fail(what, "unpack it first if that is meant")
