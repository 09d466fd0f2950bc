"""Writes the page of a batch, from the index in its folder: on this machine, or on a store."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

import orjson

from navbake.batch.index import read_index
from navbake.batch.job import read_record, stamp, write_record
from navbake.batch.page.content import Progress, describe_batch, is_row, is_safe
from navbake.batch.products import GRID, RECORD, THUMBNAIL
from navbake.batch.store import (
    Folder,
    as_folder,
    join,
    read_file,
    refused,
    shown,
    sizes_below,
    why_full,
    write_file,
)
from navbake.errors import FormatError, NavbakeError, printable
from navbake.formats.navgrid import read_navgrid
from navbake.formats.source import write_bytes
from navbake.navgrid.grid import NavGrid
from navbake.views.notebook import draw_thumbnail
from navbake.views.page.page import make_page, to_text

NAME = "index.html"
PACKAGE = "navbake.batch.page"  # where the page's script is
PICTURES = "'self' file: data:"  # thumbnails are beside the page
EVERY = 15.0  # how often the page of a batch that runs is written anew [s]
SHARE = 0.01  # of the time that this may take


def write_page(folder: Folder, *, progress: Progress | None = None) -> None:
    """Write the page of a batch into its folder, whole or not at all.

    Args:
        folder: of the batch.
        progress: how far the batch is, None if it has ended.

    Raises:
        NavbakeError: the index can't be read, or the page can't be written.
    """
    content = _render(folder, ".", progress)
    _check_own(folder, NAME)
    write_file(folder, NAME, content)


def write_page_beside(folder: Path, path: Path) -> None:
    """Write the page of a batch to another place; its links lead from there to the folder.

    A name that is no UTF-8 is its bytes in a link, as browsers have it.

    Raises:
        FormatError: it can't be written.
    """
    try:  # as it is written: browsers know nothing of links in a file system
        base = os.path.relpath(folder, path.parent).replace(os.sep, "/")
    except ValueError:  # another drive on Windows
        base = folder.absolute().as_posix()
    write_bytes(_render(folder, quote(os.fsencode(base)), None), path)


def _render(folder: Folder, base: str, progress: Progress | None) -> bytes:
    """The page; `base` is the link that leads to the folder."""
    name = (folder.resolve() if isinstance(folder, Path) else Path(shown(folder))).name
    content = describe_batch(read_index(folder).values(), _find_thumbnails(folder), progress)
    content |= {"title": printable(name) or "batch", "made": stamp(), "base": base}
    packed = {"title": f"{content['title']}: batch", "packed": to_text(orjson.dumps(content))}
    return make_page(packed, PACKAGE, "batch.js", PICTURES)


def _find_thumbnails(folder: Folder) -> Callable[[str], bool]:
    """Returns what says whether a scene has a thumbnail; of a store, from one listing."""
    if isinstance(folder, Path):
        return lambda id: os.path.isfile(folder / id / THUMBNAIL)
    found = sizes_below(folder)
    return lambda id: f"{id}/{THUMBNAIL}" in found


def draw_thumbnails(folder: Folder, show: Callable[[float], None]) -> int:
    """Draw the thumbnails that are missing, from the grids; returns how many are missing still.

    Args:
        show: is called with the share of them that is done.

    Raises:
        FullError: the folder has no room for one; the others are not tried.
    """
    has_thumbnail, num_failed = _find_thumbnails(folder), 0
    rows = {id: row for id, row in read_index(folder).items() if is_row(row) and is_safe(id)}
    missing = [id for id, row in rows.items() if row["status"] == "ok" and not has_thumbnail(id)]
    for number, id in enumerate(missing):
        show(number / len(missing))
        try:
            _draw_thumbnail(folder, id)
        except NavbakeError as error:  # no grid, a broken one, or a folder that can't be written
            why = why_full(error)
            if why is not None:
                raise refused(f"thumbnails into {shown(os.fspath(folder))}", why) from error
            num_failed += 1
    return num_failed


def _draw_thumbnail(folder: Folder, id: str) -> None:
    place = as_folder(join(folder, id))
    _check_own(folder, f"{id}/{THUMBNAIL}")
    _check_own(folder, f"{id}/{RECORD}")
    grid: NavGrid = read_navgrid(read_file(join(place, GRID)))
    record = read_record(place)
    if record:  # so that it is removed with the grid
        write_record(place, {**record, "more": [THUMBNAIL]})
    write_file(place, THUMBNAIL, draw_thumbnail(grid))


def _check_own(folder: Folder, name: str) -> None:
    """Refuse to write through a link that leads out of a folder, which may come from a stranger."""
    if not isinstance(folder, Path):
        return
    path, real = folder / name, Path(os.path.realpath(folder / name))
    if not real.is_relative_to(os.path.realpath(folder)):
        raise FormatError(
            f"expected a file in {folder}, got {path}, which leads to {real}: remove the link"
        )


class LivePage:
    """The page of a batch that runs: it is written now and then, for a small share of the time.

    On a store, which gets the index when the batch ends, it is written then only.
    """

    def __init__(self, folder: Folder, total: int) -> None:
        self._folder, self._total = folder, total
        self._next = time.monotonic() + EVERY if isinstance(folder, Path) else float("inf")

    def refresh(self, done: int) -> None:
        """Write it if it is time; `done` is how many of the batch's scenes have ended."""
        begin = time.monotonic()
        if begin < self._next:
            return
        with suppress(NavbakeError):  # raised at the end, if it can't be written then
            write_page(self._folder, progress=Progress(done, self._total))
        end = time.monotonic()
        self._next = end + max(EVERY, (end - begin) / SHARE)
