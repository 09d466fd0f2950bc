"""Refuses XML that would crash MuJoCo's compiler, or keep it busy for hours, before it runs.

MuJoCo compiles within this process: where it crashes, the process ends without a word, and while
it works, Ctrl-C waits. What it will have to make can be seen in the XML: pixels of textures,
copies by `replicate`, points of height fields and of composites. Python's parser looks for these;
what it cannot read, MuJoCo judges.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from navbake.errors import SceneError

MAX_TEXTURE = 1 << 30  # bytes of all textures; from 2**31 on, MuJoCo's own numbers overflow
CHANNELS = 3  # bytes of a pixel unless given
FACES = 6  # a cube's texture is as high as six squares
MAX_COPIES = 100_000  # of elements; the time grows with their square: 10,000 in a row take 5 s
MAX_POINTS = 100_000_000  # of a height field
MAX_FLEX = 1_000_000  # points of a flexcomp, parts of a composite
MAX_SIZE = 100_000_000  # of what <size> asks for, but for memory in bytes
# Tags that ask for something, or for another file; to find none in a file's bytes takes a small
# part of the time that parsing it takes. MuJoCo reads no encoding in which these look otherwise.
ASKING = re.compile(rb"<(?:texture|hfield|flexcomp|composite|size|replicate|include|model)\b")
SIZES = ("nkey", "nuserdata", "nuser_body", "nuser_geom", "nuser_jnt", "nuser_site", "nstack")


class Place(NamedTuple):
    """Where an element stands: its file, and how often `replicate` makes it."""

    file: Path
    copies: int


def refuse_oversized(path: Path) -> None:
    """Raise a SceneError where an MJCF file, or one that it includes, asks for too much.

    The message says what is too large, and where. What stands in a `replicate` counts as often
    as it is made, in nested ones by the product of their counts.
    """
    num_copies, num_bytes = 0, 0
    for element, place in _elements(path, path.parent, 1, set()):
        tag, where = element.tag, f"in {place.file}"
        if place.copies > 1:
            num_copies += place.copies
            _check("elements made by <replicate>", num_copies, MAX_COPIES, where)
        if tag == "texture":
            num_bytes += _texture_bytes(element)
            _check("bytes of textures", num_bytes, MAX_TEXTURE, _named(element, where))
        elif tag == "hfield":
            points = _number(element, "nrow", 0) * _number(element, "ncol", 0)
            _check("points of a height field", points, MAX_POINTS, _named(element, where))
        elif tag in ("flexcomp", "composite"):
            points = 1
            for count in _numbers(element, "count"):
                points *= max(count, 1)
            _check(f"points of a <{tag}>", points, MAX_FLEX, _named(element, where))
        elif tag == "size":
            for name in SIZES:
                _check(f"as `{name}` of <size>", _number(element, name, 0), MAX_SIZE, where)


def _elements(
    file: Path, home: Path, copies: int, seen: set[Path]
) -> Iterator[tuple[ElementTree.Element, Place]]:
    """The elements of files that ask for something, with how often each is made.

    A file counts once: MuJoCo includes none twice.
    """
    waiting = _root_of(file, copies, seen)
    while waiting:
        element, (file, copies) = waiting.pop()
        if element.tag in ("include", "model") and element.get("file"):
            # MuJoCo looks beside the main file; newer versions beside the including one, too
            beside = [folder / element.attrib["file"] for folder in (home, file.parent)]
            included = next((other for other in beside if other.is_file()), None)
            if included is not None and included.resolve() not in seen:
                waiting += _root_of(included, copies, seen)
        yield element, Place(file, copies)
        if element.tag == "replicate":
            copies *= max(_number(element, "count", 1), 1)
        waiting += [(child, Place(file, copies)) for child in reversed(element)]


def _root_of(file: Path, copies: int, seen: set[Path]) -> list[tuple[ElementTree.Element, Place]]:
    """The outermost element of a file; none if Python can't read it, or nothing in it asks.

    What is made several times asks always.
    """
    seen.add(file.resolve())
    try:
        data = file.read_bytes()
        if copies == 1 and not ASKING.search(data):
            return []
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError, OSError, RecursionError):
        return []  # MuJoCo says what is wrong with it
    return [(root, Place(file, copies))]


def _texture_bytes(element: ElementTree.Element) -> int:
    width, height = _number(element, "width", 0), _number(element, "height", 0)
    if element.get("type", "cube") != "2d" and "gridsize" not in element.attrib:
        height = width * FACES
    return width * height * _number(element, "nchannel", CHANNELS)


def _check(what: str, number: int, most: int, where: str) -> None:
    if number > most:
        raise SceneError(
            f"expected at most {most:,} {what}, got {number:,} {where}: MuJoCo would crash, or not "
            "end; make it smaller"
        )


def _named(element: ElementTree.Element, where: str) -> str:
    name = element.get("name")
    return f"at {name!r} {where}" if name else where


def _number(element: ElementTree.Element, name: str, default: int) -> int:
    """An attribute as MuJoCo reads it; the default where it is none or no number."""
    numbers = _numbers(element, name)
    return numbers[0] if numbers else default


def _numbers(element: ElementTree.Element, name: str) -> list[int]:
    try:
        return [int(float(word)) for word in element.get(name, "").split()]
    except (ValueError, OverflowError):
        return []
