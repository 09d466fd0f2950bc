"""Checks of values in untrusted files, and limits on the cells and memory that reading them takes.

A few bytes of runs or packed data may expand to more than memory holds. So a reader makes an
`Allowance` for each file. Before it reserves memory for an array, it subtracts the array's size
from the allowance, which raises an error if too little is left. Users' own files (settings, lists,
outlines of rooms) have no such limit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from numbers import Real
from typing import TYPE_CHECKING, NoReturn

from navbake.errors import ConfigError, FormatError

if TYPE_CHECKING:  # the command line lists formats before it loads numpy
    from navbake.types import Json, JsonValue, Vector3

MAX_BYTES = 4 << 30  # of any file
MAX_CELLS = 100_000_000  # of all levels together
MAX_VOXELS = 1 << 31  # 1290 along each axis
MAX_PIXELS = 80_000_000  # below the number from which Pillow warns of a decompression bomb
MAX_DEPTH = 64  # of nested metadata, userData, timings and unknown fields
MAX_HEADER_BYTES = 65536  # text before the voxels of a binvox or octree, comments included [bytes]
BASE_MEMORY = 256 << 20  # that a file of any size may fill [bytes]
# that a file may fill in addition, for each of its own bytes [bytes]; a campus as an octree takes
# 400, house-100 as JSON 40
MEMORY_PER_FILE_BYTE = 512
BYTES_PER_CELL = 128  # of memory for all arrays together, if the caller gives `max_cells`
BYTES_PER_TEXT_BYTE = 4  # of memory that counts for a byte of unpacked JSON
BYTES_PER_PIXEL = 6  # of memory: an image, a copy, and values
MAX_SHOWN_CHARACTERS = 40  # characters of a wrong value that an error shows
LEAF_TYPES = {str, int, bool, type(None)}  # of JSON values without children, except floats
JSON_CLASSES = (str, int, float, dict, list, tuple, type(None))  # subclasses count as well


# ---------------------------------------------------------------- values and their locations


ABSENT: object = object()  # stands for a missing field


def format_value(value: object) -> str:
    """Format a value for an error message: short, on one line."""
    if value is ABSENT:
        return "nothing"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return f"an object of {len(value)} fields"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, str):
        value = value[: MAX_SHOWN_CHARACTERS + 1]
    elif isinstance(value, int) and abs(value) > 10**MAX_SHOWN_CHARACTERS:
        return f"{value:.3e}" if abs(value) < 10**300 else "an integer of over 300 digits"
    text = repr(value)
    return text if len(text) <= MAX_SHOWN_CHARACTERS else text[:MAX_SHOWN_CHARACTERS] + "…"


@dataclass(frozen=True)
class JsonPath:
    """The location of a value in a file, for errors; indexing it returns an entry's location.

    Attributes:
        file: the file's name, or what the content was read from.
        path: the location in the file, such as ``grids[1].weights.data[17]``; "" for the top.

    Example:
        >>> JsonPath("house.grid.json")["grids"][1]["weights"].path
        'grids[1].weights'
    """

    file: str
    path: str = ""

    def __getitem__(self, key: str | int) -> JsonPath:
        if isinstance(key, int):
            key_text = f"[{key}]"
        elif key.isidentifier():
            key_text = f".{key}" if self.path else key
        else:
            key_text = f"[{format_value(key)}]"
        return JsonPath(self.file, self.path + key_text)

    def fail(
        self, fault: str, remedy: str = "", *, expected: str | None = None, value: object = None
    ) -> NoReturn:
        """Raise a FormatError with the fault and its location.

        Args:
            fault: what is wrong, the beginning of the message.
            remedy: what to do, the end of the message.
            expected: what was expected; it becomes an attribute of the error.
            value: the wrong value; it becomes an attribute of the error.

        Raises:
            FormatError: always.
        """
        place_text = f"at `{self.path}` in" if self.path else "in"
        file = self.file if self.file.isprintable() else repr(self.file)
        message = f"{fault} {place_text} {file}"
        raise FormatError(
            f"{message}; {remedy}" if remedy else message,
            path=self.file,
            value=value,
            expected=expected,
            place=self.path or None,
            hint=remedy or None,
        )

    def refuse(self, expected: str, value: object) -> NoReturn:
        """Raise a FormatError with the expected and the actual value.

        Args:
            expected: what was expected, such as ``a list``.
            value: the actual value, `ABSENT` if there is none.

        Raises:
            FormatError: always.
        """
        message = f"expected {expected}, got {format_value(value)}"
        self.fail(message, expected=expected, value=None if value is ABSENT else value)


def check_whole_number(value: object, place: JsonPath, minimum: int) -> int:
    """Check that a value is a whole number, and return it as an int; 59.0 is one, true is not.

    Args:
        value: the number as parsed.
        place: its location, for errors.
        minimum: the least valid number.

    Returns:
        The number as int.

    Raises:
        FormatError: the value is not a whole number, or below the minimum.
    """
    is_whole = type(value) is int or (isinstance(value, float) and value.is_integer())
    if not is_whole or int(value) < minimum:  # type: ignore[call-overload]
        place.refuse(f"a whole number >= {minimum}", value)
    return int(value)  # type: ignore[call-overload,no-any-return]


def check_number(value: object, place: JsonPath, *, must_be_positive: bool = False) -> float:
    """Check that a value is a finite number, and return it; 59.0 becomes the int 59.

    Args:
        value: the number as parsed.
        place: its location, for errors.
        must_be_positive: whether 0 and negative numbers are refused.

    Returns:
        The number, an int if it is whole and below 2**53.

    Raises:
        FormatError: the value is not a finite number, or not positive though it has to be.
    """
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    try:
        number = float(value) if is_number else math.nan  # type: ignore[arg-type]
    except OverflowError:  # YAML has whole numbers beyond all floats
        number = math.nan
    if not math.isfinite(number) or (must_be_positive and number <= 0):
        place.refuse("a number > 0" if must_be_positive else "a finite number", value)
    return int(number) if number.is_integer() and abs(number) < 2**53 else number


def check_vector(value: object, place: JsonPath) -> Vector3:
    """Check that a value is a list of three finite numbers, and return them as floats.

    Args:
        value: the list as parsed.
        place: its location, for errors.

    Raises:
        FormatError: the value is not a list of three finite numbers.
    """
    if not isinstance(value, list | tuple) or len(value) != 3:
        place.refuse("three numbers", value)
    x = float(check_number(value[0], place[0]))
    y = float(check_number(value[1], place[1]))
    z = float(check_number(value[2], place[2]))
    return x, y, z


def check_object(value: object, place: JsonPath) -> Json:
    """Check that a value is a JSON object, and return it.

    Args:
        value: the object as parsed.
        place: its location, for errors.

    Raises:
        FormatError: the value is not an object.
    """
    if not isinstance(value, dict):
        place.refuse("an object", value)
    return value


def check_depth(value: JsonValue, place: JsonPath) -> JsonValue:
    """Check that a value that was parsed from JSON isn't nested too deep, and return it.

    A parser of JSON makes nothing that JSON lacks, so the rest of what `check_json` checks holds.

    Args:
        value: the parsed value.
        place: its location, for errors.

    Raises:
        FormatError: the value holds more than 64 lists and objects in each other.
    """

    def check_children(container: Json | list[JsonValue], num_containers: int) -> None:
        if num_containers > MAX_DEPTH:
            place.fail(f"nested deeper than {MAX_DEPTH} levels")
        for child in container.values() if isinstance(container, dict) else container:
            if type(child) is list or type(child) is dict:
                check_children(child, num_containers + 1)

    if isinstance(value, dict | list):
        check_children(value, 1)
    return value


def check_optional_object(content: Json, key: str, place: JsonPath) -> Json:
    """Return the object in a field of a JSON object; {} if the field is missing or null.

    Args:
        content: the object with the field.
        key: the field's name.
        place: the location of `content`, for errors.

    Raises:
        FormatError: the field is not an object, or has values that are no JSON.
    """
    value = content.get(key)
    if value is None:
        return {}
    return check_object(check_json(value, place[key]), place[key])


def check_json(value: JsonValue, place: JsonPath) -> JsonValue:
    """Check that a value can be written as JSON and isn't nested too deep, and return it.

    All values of one depth are checked at once: that is faster than a Python call for each.

    Args:
        value: any value. Keys of objects must be strings, floats finite.
        place: its location, for errors.

    Returns:
        The value itself.

    Raises:
        FormatError: the value holds something that JSON lacks, or more than 64 lists and objects
            in each other.
    """
    values_at_depth = [value]
    for _ in range(MAX_DEPTH + 1):
        value_types = set(map(type, values_at_depth))
        if value_types <= LEAF_TYPES:
            return value
        floats = [entry for entry in values_at_depth if isinstance(entry, float)]
        if not all(issubclass(value_type, JSON_CLASSES) for value_type in value_types) or not all(
            map(math.isfinite, floats)
        ):
            _refuse_first_invalid(value, place)
        container_types = {
            value_type for value_type in value_types if issubclass(value_type, dict | list | tuple)
        }
        containers = [entry for entry in values_at_depth if type(entry) in container_types]
        if not containers:
            return value
        objects = [entry for entry in containers if isinstance(entry, dict)]
        if not set(map(type, chain.from_iterable(objects))) <= {str}:
            place.fail("expected strings as keys of objects, got others")
        lists = [entry for entry in containers if not isinstance(entry, dict)]
        values_at_depth = list(chain.from_iterable([*map(dict.values, objects), *lists]))
    place.fail(f"nested deeper than {MAX_DEPTH} levels")


def _refuse_first_invalid(value: JsonValue, place: JsonPath) -> None:
    """Raise a FormatError for the first value that is not JSON, in reading order."""
    if isinstance(value, dict | list | tuple):
        for key, child in value.items() if isinstance(value, dict) else enumerate(value):
            _refuse_first_invalid(child, place[key if isinstance(key, int) else str(key)])
    elif isinstance(value, float) and not math.isfinite(value):
        place.refuse("a finite number", value)
    elif not isinstance(value, JSON_CLASSES):
        place.fail(f"expected a JSON value, got one of Python's type {type(value).__name__}")


# ---------------------------------------------------------------- memory


class Allowance:
    """The cells, and the bytes of memory and of text, that reading a file may still take.

    By default this depends on the file's size. The caller of a reader may set a different limit, by
    an argument: ``max_cells`` for grids, ``max_voxels`` for voxels. With ``max_voxels``, the memory
    is limited only by what is free. Images have no such argument.
    """

    def __init__(self, num_bytes: int, keyword: str = "", limit: int | None = None) -> None:
        """Make the allowance of a file.

        Args:
            num_bytes: the size of the file [bytes].
            keyword: the argument by which callers change the limits: ``max_cells``,
                ``max_voxels``, or "" for an image.
            limit: the caller's value of that argument, at least 1; None for the default limits.

        Raises:
            FormatError: the limit is not a whole number of at least 1.
        """
        if limit is not None and not (isinstance(limit, int) and limit >= 1):
            message = f"expected {keyword} to be a whole number >= 1, got {limit!r}"
            expected = "a whole number >= 1"
            raise FormatError(message, key=keyword, value=limit, expected=expected)
        self._keyword = keyword
        self._remedy = f"pass {keyword} if that is meant" if keyword else ""
        num_memory_bytes = BASE_MEMORY + MEMORY_PER_FILE_BYTE * num_bytes
        self._rule = f"a file of {num_bytes:,} bytes may fill ({num_memory_bytes:,} bytes)"
        self._cells = {"max_cells": MAX_CELLS, "max_voxels": MAX_VOXELS, "": MAX_PIXELS}[keyword]
        self._memory: float = num_memory_bytes
        self._text = num_memory_bytes // BYTES_PER_TEXT_BYTE
        self._num_bytes = num_bytes
        if limit is not None:
            self._rule = f"{keyword} = {limit} allows"
            self._cells = limit
            self._memory = BYTES_PER_CELL * limit if keyword == "max_cells" else math.inf

    def take_cells(self, shape: Sequence[int], place: JsonPath) -> None:
        """Subtract the cells, voxels or pixels of an array from those that are left.

        Args:
            shape: the array's shape.
            place: its location in the file, for errors.

        Raises:
            FormatError: too few cells are left.
        """
        if math.prod(shape) > self._cells:
            noun = self._keyword.removeprefix("max_") or "pixels"
            shape_text = " × ".join(format_value(int(count)) for count in shape)
            fault = f"too many {noun} ({shape_text}, expected {self._cells:,} at most)"
            place.fail(fault, self._remedy, expected=f"{self._cells:,} at most", value=tuple(shape))
        self._cells -= math.prod(shape)

    def take_array(self, shape: Sequence[int], itemsize: int, place: JsonPath) -> None:
        """Subtract the memory of an array from the memory that is left.

        Args:
            shape: the array's shape.
            itemsize: the size of an element [bytes].
            place: the array's location in the file, for errors.

        Raises:
            FormatError: the array takes too much memory.
        """
        self._memory -= math.prod(shape) * itemsize
        if self._memory < 0:
            place.fail(f"more memory than {self._rule}", self._remedy)
        if self._keyword == "max_voxels":
            from navbake.voxels.grid import check_memory  # loads numpy

            try:
                check_memory(shape, itemsize)
            except ConfigError as error:
                raise FormatError(f"{place.file}: {error}", path=place.file) from None

    def take_text(self, num_bytes: int, place: JsonPath) -> None:
        """Subtract unpacked JSON from the text that is left.

        Args:
            num_bytes: the size of the text [bytes].
            place: its location in the file, for errors.

        Raises:
            FormatError: the text is too long.
        """
        self._text -= num_bytes
        if self._text < 0:
            fault = f"more text than a file of {self._num_bytes:,} bytes may unpack to"
            place.fail(fault, "unpack it first if that is meant")
