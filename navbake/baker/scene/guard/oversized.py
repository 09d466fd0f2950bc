"""Refuses XML that would crash MuJoCo's compiler, or keep it busy for hours, before it runs.

MuJoCo compiles within this process: where it crashes, the process ends without a word, and while
it works, Ctrl-C waits. What it will have to make can be seen in the XML: pixels of textures,
copies by `replicate`, points of height fields and of composites. Of images (PNG) of textures and
height fields, the header is read: a few bytes may unpack to gigabytes.
"""

from __future__ import annotations

import math
import os
import re
import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from navbake.errors import SceneError
from navbake.formats.mjcf.xml_tree import read_elements
from navbake.formats.scene_files import LOOK_FOLDERS, places_from

MAX_TEXTURE = 1 << 30  # bytes of all textures; from 2**31 on, MuJoCo's own numbers overflow
CHANNELS = 3  # bytes of a pixel unless given
FACES = 6  # a cube's texture is as high as six squares
MAX_COPIES = 100_000  # of elements; the time grows with their square: 10,000 in a row take 5 s
MAX_POINTS = 100_000_000  # of a height field, pixels of an image
# Pixels that any image may unpack to, and how many more for each byte of its file. A point of a
# height field becomes two triangles of 144 bytes, a pixel of a texture three bytes.
MOST_PIXELS = {"texture": (32_000_000, 256), "hfield": (4_000_000, 16)}
PNG = b"\x89PNG\r\n\x1a\n"
PNG_SIZE = slice(16, 24)  # where a PNG has its width and height
MAX_FLEX = 1_000_000  # points of a flexcomp, parts of a composite
MAX_SIZE = 100_000_000  # of what <size> asks for, but for memory in bytes
# Tags that ask for something, or for another file; to find none in a file's bytes takes a small
# part of the time that parsing it takes. MuJoCo reads no encoding in which these look otherwise.
ASKING = re.compile(rb"<(?:texture|hfield|flexcomp|composite|size|replicate|include|model)\b")
SIZES = ("nkey", "nuserdata", "nuser_body", "nuser_geom", "nuser_jnt", "nuser_site", "nstack")


class Place(NamedTuple):
    """Where an element stands.

    Attributes:
        file: that it is in.
        home: the folder of the scene, or of the attached model that includes the file.
        copies: how often `replicate` makes it.
    """

    file: Path
    home: Path
    copies: int


def refuse_oversized(path: Path) -> None:
    """Raise a SceneError where an MJCF file, or one that it includes, asks for too much.

    The message says what is too large, and where. What stands in a `replicate` counts as often
    as it is made, in nested ones by the product of their counts.
    """
    num_copies, num_bytes = 0, 0
    elements = [*_elements(path)]
    folders = _asset_folders(path, elements)
    for element, place in elements:
        tag, where = element.tag, f"in {place.file}"
        if tag in MOST_PIXELS:
            _check_images(element, folders, _named(element, where))
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


def _elements(scene: Path) -> Iterator[tuple[ElementTree.Element, Place]]:
    """The elements of files that ask for something, with where each stands.

    A file counts once: MuJoCo includes none twice.
    """
    seen: set[Path] = set()
    waiting = _root_of(Place(scene, scene.parent, 1), seen)
    while waiting:
        element, place = waiting.pop()
        yield element, place
        if element.tag in ("include", "model") and element.get("file"):
            # which of these MuJoCo takes depends on its version
            bases = dict.fromkeys((scene.parent, place.home, place.file.parent))
            for file in places_from(bases, element.attrib["file"]):
                if os.path.isfile(file) and file.resolve() not in seen:
                    home = place.home if element.tag == "include" else file.parent
                    waiting += _root_of(Place(file, home, place.copies), seen)
        if element.tag == "replicate":
            place = place._replace(copies=place.copies * max(_number(element, "count", 1), 1))
        waiting += [(child, place) for child in reversed(element)]


def _root_of(place: Place, seen: set[Path]) -> list[tuple[ElementTree.Element, Place]]:
    """The outermost element of a file; none if it has none, or nothing in it asks.

    What is made several times asks always.
    """
    seen.add(place.file.resolve())
    try:
        data = place.file.read_bytes()
    except OSError:
        return []  # MuJoCo says what is wrong with it
    root = read_elements(data) if place.copies > 1 or ASKING.search(data) else None
    return [] if root is None else [(root, place)]


def _asset_folders(
    path: Path, elements: list[tuple[ElementTree.Element, Place]]
) -> dict[Path, None]:
    """Where the files of textures and height fields may be; which it is depends on MuJoCo."""
    places = (folder for _, place in elements for folder in (place.home, place.file.parent))
    homes = dict.fromkeys([path.parent, *places])
    named = (
        folder
        for element, _ in elements
        if element.tag == "compiler"
        for key in LOOK_FOLDERS
        if key in element.attrib
        for folder in places_from(homes, element.attrib[key])
    )
    return homes | dict.fromkeys(named)


def _check_images(element: ElementTree.Element, folders: Iterable[Path], where: str) -> None:
    """Refuse images with more pixels than files of their size may have."""
    for name in [value for key, value in element.attrib.items() if key.startswith("file")]:
        # `strippath` of a compiler leaves out the folders of names
        tails = (name, Path(name).name)
        files = [file for tail in tails for file in places_from(folders, tail)]
        pixels, num_bytes = max(map(_image_size, files))
        free, by_byte = MOST_PIXELS[element.tag]
        most = min(MAX_POINTS, free + by_byte * num_bytes)
        _check(f"pixels of an image of {num_bytes:,} bytes", pixels, most, where)


def _image_size(path: Path) -> tuple[int, int]:
    """The pixels that a PNG says it has, and the bytes of its file; 0 where it is none."""
    try:
        if not os.path.isfile(path):
            return 0, 0
        with path.open("rb") as file:
            head = file.read(PNG_SIZE.stop)
        size = head[PNG_SIZE]
        is_png = head.startswith(PNG) and len(size) == 8
        return math.prod(struct.unpack(">2I", size)) if is_png else 0, path.stat().st_size
    except (OSError, ValueError):  # MuJoCo says what is wrong with it
        return 0, 0


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
