"""The files of a batch's folder that its page is made of: on this machine, or on a store."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from navbake.batch.index import NAME as INDEX
from navbake.batch.index import parse_rows, read_index
from navbake.batch.products import GRID, NOTE, THUMBNAIL, read_note, write_note
from navbake.batch.stores.notes import read_note_at, write_note_at
from navbake.batch.stores.store import list_tree, read_file, write_file
from navbake.batch.stores.urls import Folder, split_url
from navbake.errors import FormatError, printable
from navbake.formats.navgrid import read_navgrid
from navbake.formats.source import write_bytes
from navbake.navgrid.grid import NavGrid
from navbake.types import Json
from navbake.views.thumbnail import draw_thumbnail

MAX_BYTES = 4 << 30  # of an index, and of a grid


class BatchFiles(Protocol):
    """What a page asks of a batch's folder; ids are safe, see `content.is_safe`."""

    def name(self) -> str:
        """What the folder is called."""

    def read_rows(self) -> dict[str, Json]:
        """The rows of the index, by id."""

    def find_thumbnails(self) -> Callable[[str], bool]:
        """Returns what says whether a scene has a thumbnail."""

    def draw_thumbnail(self, id: str) -> None:
        """Draw a scene's thumbnail from its grid; a NavbakeError says why that can't be."""

    def write(self, name: str, content: bytes) -> None:
        """Write a file beside the index; a NavbakeError says why that can't be."""


class LocalFiles:
    """Those of a folder on this machine.

    The folder may come from a stranger: nothing is written through a link that leads out of it.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def name(self) -> str:
        """What the folder is called."""
        return printable(self._folder.resolve().name)

    def read_rows(self) -> dict[str, Json]:
        """The rows of the index, by id."""
        return read_index(self._folder)

    def find_thumbnails(self) -> Callable[[str], bool]:
        """Returns what says whether a scene has a thumbnail."""
        return lambda id: os.path.isfile(self._folder / id / THUMBNAIL)

    def draw_thumbnail(self, id: str) -> None:
        """Draw a scene's thumbnail from its grid."""
        place, note = self._own(f"{id}/{THUMBNAIL}"), self._own(f"{id}/{NOTE}")
        grid: NavGrid = read_navgrid(self._folder / id / GRID)
        drawn = draw_thumbnail(grid)
        write_note(note.parent, {*read_note(note.parent), THUMBNAIL})
        write_bytes(drawn, place)

    def write(self, name: str, content: bytes) -> None:
        """Write a file beside the index."""
        write_bytes(content, self._own(name))

    def _own(self, name: str) -> Path:
        """The path of a file that is to be written."""
        path = self._folder / name
        real = Path(os.path.realpath(path))
        if not real.is_relative_to(os.path.realpath(self._folder)):
            raise FormatError(
                f"expected a file in {self._folder}, got {path}, which leads to {real}: remove the "
                "link"
            )
        return path


class RemoteFiles:
    """Those of a folder on a store."""

    def __init__(self, folder: str) -> None:
        self._folder = folder

    def name(self) -> str:
        """What the folder is called; a password has no part in it."""
        path = split_url(self._folder).path
        return printable(path[-1]) if path else ""

    def read_rows(self) -> dict[str, Json]:
        """The rows of the index, by id."""
        return parse_rows(read_file(f"{self._folder}/{INDEX}", MAX_BYTES))

    def find_thumbnails(self) -> Callable[[str], bool]:
        """Returns what says whether a scene has a thumbnail, from one listing."""
        found = list_tree(self._folder, is_own=True)
        return lambda id: f"{id}/{THUMBNAIL}" in found

    def draw_thumbnail(self, id: str) -> None:
        """Draw a scene's thumbnail from its grid."""
        place = f"{self._folder}/{id}"
        grid: NavGrid = read_navgrid(read_file(f"{place}/{GRID}", MAX_BYTES))
        drawn = draw_thumbnail(grid)
        write_note_at(place, {*read_note_at(place), THUMBNAIL})
        write_file(f"{place}/{THUMBNAIL}", drawn)

    def write(self, name: str, content: bytes) -> None:
        """Write a file beside the index."""
        write_file(f"{self._folder}/{name}", content)


def files_of(folder: Folder) -> BatchFiles:
    """The files of a folder, wherever it is."""
    return LocalFiles(folder) if isinstance(folder, Path) else RemoteFiles(folder)
