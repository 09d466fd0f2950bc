"""Files that a bake reads, and whether they have changed on disk since."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable
from pathlib import Path

PERIOD = 0.5  # between two looks [s]
XML_SUFFIXES = (".xml", ".mjcf", ".urdf")
FOLDERS = ("meshdir", "texturedir", "assetdir")  # of MJCF's <compiler>
SIDES = ("right", "left", "up", "down", "front", "back")
FILES = ("file", "filename", *(f"file{side}" for side in SIDES))
PACKAGE = "package://"
MOST_BYTES = 64 << 20  # of an XML file that is looked into

State = dict[Path, tuple[int, int] | None]


def find_files(paths: Iterable[Path]) -> list[Path]:
    """Files and, of MJCF and URDF among them, the files that these name: includes, meshes, ….

    A broken file names none. Names are taken by the folders that MuJoCo may look into, so that
    some of what is listed may not be there.
    """
    found: dict[Path, None] = {}
    waiting = [(Path(path), Path(path).parent) for path in paths]
    folders: dict[str, None] = {"": None}
    named: list[tuple[Path, str]] = []
    while waiting:
        path, home = waiting.pop(0)
        if path in found:
            continue
        found[path] = None
        for element in _elements_of(path):
            folders |= dict.fromkeys(element.get(key, "") for key in FOLDERS)
            for name in filter(None, map(element.get, FILES)):
                if element.tag == "include":
                    waiting.append((home / name, home))
                else:
                    named.append((home, name.removeprefix(PACKAGE)))
    for home, name in named:
        found |= dict.fromkeys(home / folder / name for folder in folders)
    return list(found)


def _elements_of(path: Path) -> Iterable[ElementTree.Element]:
    try:
        if path.suffix.lower() not in XML_SUFFIXES or path.stat().st_size > MOST_BYTES:
            return ()
        return list(ElementTree.parse(path).iter())
    except (OSError, ElementTree.ParseError, ValueError):
        return ()


def read_state(paths: Iterable[Path]) -> State:
    """When each file was written, and its size; None for one that isn't there."""
    state: State = {}
    for path in paths:
        try:
            status = os.stat(path)
        except (OSError, ValueError):  # ValueError: a name with a NUL
            state[path] = None
        else:
            state[path] = status.st_mtime_ns, status.st_size
    return state


class Watch:
    """Tells when files have changed and rest again: whoever writes them may take some time.

    Args:
        list_files: the files; asked again after each change, for a scene may name others then.
    """

    def __init__(self, list_files: Callable[[], Iterable[Path]]) -> None:
        self._list_files = list_files
        self._files = list(list_files())
        self._known = self._last = read_state(self._files)

    def look(self) -> bool:
        """Whether the files are others than when this was last true, and as at the last look."""
        now = read_state(self._files)
        rests, self._last = now == self._last, now
        if not rests or now == self._known:
            return False
        self._files = list(self._list_files())
        self._known = self._last = read_state(self._files)
        return True
