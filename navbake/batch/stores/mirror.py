"""Brings a scene and all that it names from stores into a temporary folder."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from xml.parsers import expat

from navbake.batch.file_states import Places, describe_files
from navbake.batch.stores.store import (
    Entry,
    Listing,
    fetch_files,
    hide_secrets,
    list_folder,
    state_of,
    write_file,
)
from navbake.batch.stores.urls import is_url, join, parent, shown, split_url
from navbake.config.yaml_text import read_yaml
from navbake.errors import ConfigError, SceneError
from navbake.formats.scene_files import find_inputs
from navbake.types import Json


class Mirror:
    """A folder in which files of stores have the places that they have there.

    It is what `find_inputs` takes as the files of a scene: it has what the store has, and copies
    a file when it is to be read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._roots: list[str] = []
        self._listing = Listing()
        self._found: dict[Path, Entry] = {}  # by place
        self._left: dict[Path, str] = {}  # what is found and not copied yet
        self._read: set[Path] = set()  # what was copied to be read

    def place(self, url: str) -> Path:
        """Where a file of a store is, or would be, in the folder."""
        parts = split_url(url)
        if parts.root not in self._roots:
            self._roots.append(parts.root)
        return self._folder.joinpath(str(self._roots.index(parts.root)), *parts.path)

    def url_of(self, path: str | os.PathLike[str]) -> str | None:
        """The URL of a place in the folder; None of one outside."""
        inside = os.path.relpath(path, self._folder).split(os.sep)
        if inside[0] == os.pardir or not inside[0].isdecimal() or len(inside) < 2:
            return None
        number = int(inside[0])
        return "/".join((self._roots[number], *inside[1:])) if number < len(self._roots) else None

    def has(self, path: Path) -> bool:
        """Whether the store has the file that would be at a place."""
        path = Path(os.path.abspath(path))
        url = self.url_of(path)
        if url is None:
            return False
        if path not in self._found:
            entry = self._listing.entry(url)
            if entry is None:
                return False
            self._found[path], self._left[path] = entry, url
        return True

    def bring(self, path: Path) -> None:
        """Copy a file that is to be read."""
        path = Path(os.path.abspath(path))
        self._read.add(path)
        if path in self._left:
            fetch_files({self._left.pop(path): path})

    def fetch(self, url: str) -> Path:
        """Copy a file, and say where it is.

        Raises:
            NavbakeError: it isn't there, or can't be read.
        """
        path = self.place(url)
        entry = self._listing.entry(url)
        if entry is not None:
            self._found[path] = entry
        fetch_files({url: path})
        return path

    def fetch_scene(self, url: str) -> Path:
        """Copy a scene and all that it names, and say where it is.

        Raises:
            SceneError: it names a file of this machine, or MJCF can't be read by Python's parser,
                so that nobody knows what it names.
            NavbakeError: it isn't there, or can't be read.
        """
        scene = self.fetch(url)
        find_inputs(scene, self, looks=True)
        fetch_files({url: path for path, url in self._left.items()})
        self._left.clear()
        for path in self._read:
            _check_xml(path)
        for path in find_inputs(scene, looks=True):  # as the bake finds them
            if self.url_of(path) is None:
                raise SceneError(
                    f"{shown(url)} names the file {os.path.normpath(path)} of this machine: what "
                    "is on a store names no file elsewhere"
                )
        return scene

    def fetch_settings(self, url: str) -> Path:
        """Copy settings (YAML), the scene that they name and its files, and outlines of rooms.

        Raises:
            ConfigError: they are no YAML, or name a file that is elsewhere.
        """
        path = self.fetch(url)
        settings = read_yaml(path)
        for section, key in (("scene", "path"), ("rooms", "polygons")):
            inside = settings.get(section) if isinstance(settings, Mapping) else None
            name = inside.get(key) if isinstance(inside, Mapping) else None
            if not isinstance(name, str):
                continue
            named = join(parent(url), name, shown(url))
            if is_url(name):
                raise ConfigError(
                    f"expected a path from the folder of {shown(url)} as `{section}.{key}`, got "
                    f"{shown(name)}: put settings for it into a row of a list"
                )
            if key == "path":
                self.fetch_scene(named)
            else:
                self.fetch(named)
        return path

    def entry(self, path: str | os.PathLike[str]) -> Entry | None:
        """What the store said of the file at a place, before it was copied."""
        return self._found.get(Path(os.path.abspath(path)))

    def state(self, url: str) -> Json:
        """What the index notes of a file that was copied."""
        path = self.place(url)
        (content,) = describe_files([path], Places(self._folder)).values()
        return state_of(self._found.get(path, Entry(None, None)), content)

    def told(self, text: str) -> str:
        """A text about files in the folder, as one about those on the stores."""
        for number, root in reversed([*enumerate(self._roots)]):
            text = text.replace(os.path.join(self._folder, str(number)), shown(root))
        return hide_secrets(text, self._roots)


def _check_xml(path: Path) -> None:
    if path.suffix.lower() == ".gltf":
        return
    try:
        with path.open("rb") as file:
            expat.ParserCreate().ParseFile(file)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise SceneError(f"broken XML in {path}: {error}") from error


def upload(files: Mapping[str, Path], folder: str) -> dict[str, Entry]:
    """Write files into a folder of a store, in this order; what the store says of them.

    Args:
        files: paths on this machine, by name.
        folder: the URL.
    """
    for name, path in files.items():
        write_file(f"{folder}/{name}", path.read_bytes())
    there = list_folder(folder, is_own=True)
    return {name: there[name] for name in files}
