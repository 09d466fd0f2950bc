"""Writes the page of a batch, from the index in its folder."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

import orjson

from navbake.batch.full import no_room, why_full
from navbake.batch.journal import stamp
from navbake.batch.page.content import Progress, describe_batch, is_row, is_safe
from navbake.batch.page.files import files_of
from navbake.batch.stores.urls import Folder, shown
from navbake.errors import NavbakeError
from navbake.formats.source import write_bytes
from navbake.types import Json
from navbake.views.report.packing import to_text
from navbake.views.report.page import make_page

NAME = "index.html"
HERE = "navbake.batch.page"
SCRIPTS = ("common.js", "charts.js", "scenes.js", "page.js")
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
    files_of(folder).write(NAME, _render(folder, ".", progress))


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
    base = quote(os.fsencode(base))
    write_bytes(_render(folder, base, None), path)


def _render(folder: Folder, base: str, progress: Progress | None) -> bytes:
    """The page; `base` is the link that leads to the folder."""
    files = files_of(folder)
    content = describe_batch(files.read_rows().values(), files.find_thumbnails(), progress)
    content["title"] = files.name() or "batch"
    content["made"] = stamp()
    content["base"] = base
    packed = {"title": f"{content['title']}: batch", "packed": to_text(orjson.dumps(content))}
    return make_page(packed, HERE, SCRIPTS)


def draw_thumbnails(folder: Folder, show: Callable[[float], None]) -> int:
    """Draw the thumbnails that are missing, from the grids; returns how many are missing still.

    Args:
        show: is told which share of them is done.

    Raises:
        FullError: the folder has no room for one; the others are not tried.
    """
    files = files_of(folder)
    has_thumbnail, num_failed = files.find_thumbnails(), 0
    missing = [id for id, row in files.read_rows().items() if _is_done(id, row)]
    missing = [id for id in missing if not has_thumbnail(id)]
    for number, id in enumerate(missing):
        show(number / len(missing))
        try:
            files.draw_thumbnail(id)
        except NavbakeError as error:  # no grid, a broken one, or a folder that can't be written
            why = why_full(error)
            if why is not None:
                raise no_room(f"thumbnails into {shown(os.fspath(folder))}", why) from error
            num_failed += 1
    return num_failed


def _is_done(id: str, row: Json) -> bool:
    return is_row(row) and row["status"] == "ok" and is_safe(id)


class LivePage:
    """The page of a batch that runs: it is written now and then, for a small share of the time.

    On a store, where the index is in parts until the batch ends, it is written then only.
    """

    def __init__(self, folder: Folder, total: int) -> None:
        self._folder, self._total = folder, total
        self._next = time.monotonic() + EVERY if isinstance(folder, Path) else float("inf")

    def refresh(self, done: int) -> None:
        """Write it if it is time; `done` is how many of the batch's scenes have ended."""
        begin = time.monotonic()
        if begin < self._next:
            return
        with suppress(NavbakeError):  # told at the end, if it can't be written then
            write_page(self._folder, progress=Progress(done, self._total))
        end = time.monotonic()
        self._next = end + max(EVERY, (end - begin) / SHARE)
