"""The files that a scene is made of, and whether they are as they were."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree

from navbake.types import Json

XML_SUFFIXES = (".xml", ".mjcf", ".urdf")
FILES = ("file", "filename")  # attributes that name one
FOLDERS = ("meshdir", "assetdir")  # attributes of a compiler that say where they are
LOOKS = ("texture", "skin")  # what changes how a scene looks, and no cell
CHUNK = 1 << 20


def find_inputs(scene: Path) -> list[Path]:
    """The files that a scene is made of, as far as they are there: itself first, then sorted.

    In XML (MJCF, URDF) these are all that an element names as its ``file`` or ``filename``, in the
    files that it includes as well, but for textures and skins. Which folder a name counts from
    depends on the compiler's settings, so it is looked for in all of them. XML that is broken
    names nothing.
    """
    found = {scene}
    if scene.suffix.lower() in XML_SUFFIXES:
        found |= set(_named_files(scene))
    return [scene, *sorted(found - {scene})]


def _named_files(scene: Path) -> Iterator[Path]:
    names: set[str] = set()
    folders = {scene.parent}
    left, seen = [scene], {scene}
    while left:
        for element in _elements(left.pop()):
            folders |= {scene.parent / element.get(key, ".") for key in FOLDERS}
            if element.tag.lower() in LOOKS:
                continue
            for name in (element.get(key) for key in FILES):
                if not name:
                    continue
                names.add(name.removeprefix("package://").removeprefix("file://"))
                path = scene.parent / name
                if path.suffix.lower() in XML_SUFFIXES and path not in seen and path.is_file():
                    seen.add(path)
                    left.append(path)
    for name in names:
        for folder in folders:
            for path in (folder / name, folder / os.path.basename(name)):
                if path.is_file():
                    yield path


def _elements(path: Path) -> list[ElementTree.Element]:
    try:
        return list(ElementTree.parse(path).iter())
    except (OSError, ElementTree.ParseError, ValueError):
        return []


def describe_inputs(paths: list[Path], folder: Path) -> dict[str, Json]:
    """Size, time of change and sha256 of files, by their path from a folder."""
    return {os.path.relpath(path, folder): _describe(path) for path in paths}


def are_unchanged(stated: Mapping[str, Json], folder: Path) -> bool:
    """Whether files have the content that `describe_inputs` stated.

    A file of the same size and time of change is taken for the same; of another one, the content
    is read.
    """
    for name, known in stated.items():
        try:
            now = os.stat(folder / name)
        except OSError:
            return False
        if now.st_size != known["size"]:
            return False
        if now.st_mtime_ns != known["modified"] and _digest(folder / name) != known["sha256"]:
            return False
    return True


def _describe(path: Path) -> Json:
    status = os.stat(path)
    return {"size": status.st_size, "modified": status.st_mtime_ns, "sha256": _digest(path)}


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while chunk := file.read(CHUNK):
            digest.update(chunk)
    return digest.hexdigest()
