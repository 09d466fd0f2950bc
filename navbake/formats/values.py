"""Values of a JSON file, checked, and where in the file they stand: errors name the place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain
from numbers import Real
from typing import TYPE_CHECKING, Any, NoReturn

from navbake.errors import FormatError

if TYPE_CHECKING:  # the command line lists formats before it loads numpy
    from navbake.types import Json, Vector3

SHOWN_LENGTH = 40  # characters of a culprit that an error shows
MAX_DEPTH = 64  # of metadata, userData, timings and unknown fields
LEAVES = {str, int, bool, type(None)}  # what JSON holds as it is
NODES = {dict, list, tuple}


class _Missing:
    """Stands for a field that is not there."""


MISSING = _Missing()


def shown(value: object) -> str:
    """Format a value for an error message: short, on one line."""
    if isinstance(value, _Missing):
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
            step = f"[{shown(key)}]"
        return JsonPath(self.file, self.path + step)

    def fail(self, what: str, remedy: str = "") -> NoReturn:
        """Raise a FormatError that says what is wrong, where, and what helps."""
        where = f"at `{self.path}` in" if self.path else "in"
        file = self.file if self.file.isprintable() else repr(self.file)
        raise FormatError(f"{what} {where} {file}" + (f"; {remedy}" if remedy else ""))

    def refuse(self, expected: str, value: object) -> NoReturn:
        """Raise a FormatError that says what was expected here and what is there instead."""
        self.fail(f"expected {expected}, got {shown(value)}")


def whole_number(value: object, place: JsonPath, minimum: int) -> int:
    """Read an integer; 59.0 is one, true is none."""
    integral = type(value) is int or (isinstance(value, float) and value.is_integer())
    if not integral or int(value) < minimum:  # type: ignore[call-overload]
        place.refuse(f"a whole number >= {minimum}", value)
    return int(value)  # type: ignore[call-overload,no-any-return]


def json_object(value: object, place: JsonPath) -> Json:
    """Check that a value is an object."""
    if not isinstance(value, dict):
        place.refuse("an object", value)
    return value


def optional_object(content: Json, key: str, place: JsonPath) -> Json:
    """Read an object that may be missing or null."""
    value = content.get(key)
    return {} if value is None else json_object(plain(value, place[key]), place[key])


def number(value: object, place: JsonPath, *, positive: bool = False) -> float:
    """Check a finite number; whole ones become int, so that JSON has no .0."""
    try:
        is_number = isinstance(value, Real) and not isinstance(value, bool)
        checked = float(value) if is_number else math.nan  # type: ignore[arg-type]
    except OverflowError:  # YAML has whole numbers beyond all floats
        checked = math.nan
    if not math.isfinite(checked) or (positive and checked <= 0):
        place.refuse("a number > 0" if positive else "a finite number", value)
    return int(checked) if checked.is_integer() and abs(checked) < 2**53 else checked


def vector(value: object, place: JsonPath) -> Vector3:
    """Check three finite numbers."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        place.refuse("three numbers", value)
    x, y, z = (float(number(entry, place[i])) for i, entry in enumerate(value))
    return x, y, z


def plain(value: Any, place: JsonPath) -> Any:
    """Check that a value is JSON and not too deep; layer by layer, which is fast."""
    layer = [value]
    for _ in range(MAX_DEPTH):
        if set(map(type, layer)) <= LEAVES:
            return value
        odd = [v for v in layer if type(v) not in LEAVES and type(v) not in NODES]
        if not all(map(_is_json, odd)):
            _refuse_leaf(value, place)
        # all keys, then all children, of one depth: no Python call for each value
        objects = [v for v in layer if isinstance(v, dict)]
        if not set(map(type, chain.from_iterable(objects))) <= {str}:
            place.fail("expected strings as keys of objects, got others")
        lists = [v for v in layer if isinstance(v, list | tuple)]
        layer = list(chain.from_iterable([*map(dict.values, objects), *lists]))
    place.fail(f"nested deeper than {MAX_DEPTH} levels")


def _is_json(value: object) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    return value is None or isinstance(value, str | int | dict | list | tuple)


def _refuse_leaf(value: Any, place: JsonPath) -> None:
    """Find the first value that is not JSON, and name it."""
    if isinstance(value, dict):
        for key in value:
            _refuse_leaf(value[key], place[str(key)])
    elif isinstance(value, list | tuple):
        for i, child in enumerate(value):
            _refuse_leaf(child, place[i])
    elif isinstance(value, float) and not math.isfinite(value):
        place.refuse("a finite number", value)
    elif not _is_json(value):
        place.fail(f"expected a JSON value, got one of Python's type {type(value).__name__}")
