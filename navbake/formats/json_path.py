"""Locations in a JSON file, and how errors name them and show what is there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

from navbake.errors import FormatError

SHOWN_LENGTH = 40  # characters of a culprit that an error shows


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
