"""What a kind of inputs is, and what every reader has to keep to."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random
from types import MappingProxyType
from typing import Any, NamedTuple

from navbake.errors import NavbakeError

NOTHING: Mapping[str, bytes] = MappingProxyType({})


class Input(NamedTuple):
    """A file for a reader.

    Attributes:
        data: its content.
        suffix: how its name ends.
        beside: further files in its folder, by name.
    """

    data: bytes
    suffix: str
    beside: Mapping[str, bytes] = NOTHING


class Kind(NamedTuple):
    """A kind of input.

    Attributes:
        make: the input of a generator of random numbers.
        read: reads the file, and gives what it holds; raises what users would see.
        check: does with it what users do, and raises an AssertionError where it contradicts
            itself; None for nothing.
        native: what MuJoCo does with the file, by MuJoCo alone, where its compiler is a part of
            reading it; that may end the process or take its time, see `navbake.baker.scene.guard`.
            None for files that only navbake reads.
    """

    make: Callable[[Random], Input]
    read: Callable[[Path], Any]
    check: Callable[[Any], None] | None = None
    native: Callable[[Path], object] | None = None


def is_one_in(number: int, data: bytes) -> bool:
    """A draw that is the same whenever a file is used."""
    return zlib.crc32(data) % number == 0


def attempt(action: Callable[[], object]) -> None:
    """A question may have no answer, if that is said."""
    try:
        action()
    except NavbakeError as error:
        check_message(error)


def check_message(error: NavbakeError) -> None:
    """Errors are one line that fits a terminal."""
    message = str(error)
    if "\n" in message or not message or len(message) > 1500:
        raise AssertionError(f"not one line: {message[:300]!r}")
