"""Writes the page of a batch, from the index in its folder."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import orjson

from navbake.batch.file_states import path_from
from navbake.batch.index import read_index
from navbake.batch.journal import stamp
from navbake.batch.page.content import Progress, describe_batch, is_row, is_safe
from navbake.batch.products import GRID, THUMBNAIL, write_thumbnail
from navbake.errors import NavbakeError, printable
from navbake.formats.navgrid import read_navgrid
from navbake.formats.source import write_bytes
from navbake.types import Json
from navbake.views.report.packing import to_text
from navbake.views.report.page import make_page

NAME = "index.html"
HERE = "navbake.batch.page"
SCRIPTS = ("common.js", "charts.js", "scenes.js", "page.js")
EVERY = 15.0  # how often the page of a batch that runs is written anew [s]
SHARE = 0.01  # of the time that this may take


def write_page(folder: Path, path: Path | None = None, *, progress: Progress | None = None) -> Path:
    """Write the page of a batch, whole or not at all, and return its path.

    Args:
        folder: of the batch.
        path: of the page; `NAME` in the folder if None. Its links lead from there.
        progress: how far the batch is, None if it has ended.

    Raises:
        FormatError: it can't be written.
    """
    path = folder / NAME if path is None else path
    content = describe_batch(
        read_index(folder).values(), lambda id: (folder / id / THUMBNAIL).is_file(), progress
    )
    content["title"] = printable(folder.resolve().name) or "batch"
    content["made"] = stamp()
    content["base"] = path_from(folder, path.parent)
    packed = {"title": f"{content['title']}: batch", "packed": to_text(orjson.dumps(content))}
    write_bytes(make_page(packed, HERE, SCRIPTS), path)
    return path


def draw_thumbnails(folder: Path, show: Callable[[float], None]) -> int:
    """Draw the thumbnails that are missing, from the grids; returns how many are missing still.

    Args:
        show: is told which share of them is done.
    """
    missing = [id for id, row in read_index(folder).items() if _lacks_thumbnail(folder, id, row)]
    num_failed = 0
    for number, id in enumerate(missing):
        show(number / len(missing))
        try:
            write_thumbnail(read_navgrid(folder / id / GRID), folder / id)
        except NavbakeError:  # no grid, a broken one, or a folder that can't be written
            num_failed += 1
    return num_failed


def _lacks_thumbnail(folder: Path, id: str, row: Json) -> bool:
    is_done = is_row(row) and row["status"] == "ok" and is_safe(id)
    return is_done and not (folder / id / THUMBNAIL).exists()


class LivePage:
    """The page of a batch that runs: it is written now and then, for a small share of the time."""

    def __init__(self, folder: Path, total: int) -> None:
        self._folder, self._total = folder, total
        self._next = time.monotonic() + EVERY

    def refresh(self, done: int) -> None:
        """Write it if it is time; `done` is how many of the batch's scenes have ended."""
        begin = time.monotonic()
        if begin < self._next:
            return
        write_page(self._folder, progress=Progress(done, self._total))
        end = time.monotonic()
        self._next = end + max(EVERY, (end - begin) / SHARE)
