"""The page of a batch, for a browser without a server or the network.

`page.html` and `page.js` show the data of `describe_batch`, names as text only.
"""

from __future__ import annotations

import json
import math
import os
import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from urllib.parse import quote

import numpy as np

from navbake.batch import store
from navbake.batch.index import read_index
from navbake.batch.job import FAILED, LEFT_OUT, OK, read_record, stamp, write_record
from navbake.batch.products import GRID_NAME, MEASURE_CLASSES, THUMBNAIL_NAME
from navbake.errors import NavbakeError, count_of, printable
from navbake.formats.navgrid import read_navgrid
from navbake.formats.source import write_bytes
from navbake.types import Json
from navbake.views.layers import nice_step
from navbake.views.notebook import draw_thumbnail
from navbake.views.page import make_page, to_text

PAGE_NAME = "index.html"
PICTURE_POLICY = "'self' file: data:"  # thumbnails are beside the page
MIN_WRITE_INTERVAL = 15.0  # least interval of writing a running batch's page [s]
MAX_WRITE_SHARE = 0.01  # of the time for this, at most

STATUSES = (OK, FAILED, LEFT_OUT)
CHARTS = ("free_area", "cells", "rooms", "seconds")
ROW_KEYS = ("id", "status", "source", "version", "ended", "levels", "doors", *CHARTS)  # as it is
NUM_BINS = 24  # bars of a chart, about
SKEWED_RATIO = 20  # ratio of maximum and median from which bars have equal ratios, not widths
GROUPED_TEXTS = ("failures", "warnings", "audit")  # grouped by `fold`

# a setting, what is quoted, and words
FOLDED_PART = re.compile(
    r"""(?P<setting>`[^`]*`)|(?<!\w)'[^']*'(?!\w)|(?<!\w)"[^"]*"(?!\w)"""
    r"""|(?P<word>[^\s`'"(),;:=<>\[\]{}]+)"""
)
THOUSANDS = re.compile(r"(?<=\d),(?=\d{3}(?!\d))")  # commas within a number
# with a unit: 5cm, 30%
NUMBER = re.compile(r"[-+±]?(\d+(\.\d+)*|\.\d+)([eE][-+]?\d+)?[a-zA-Z%²³°]{0,3}")
# In a path, a file's name or a numbered name
PATH_OR_NAME = re.compile(r"[/\\\d]|\.[a-zA-Z]\w{1,4}$")


def write_page(
    folder: store.Folder, path: Path | None = None, *, progress: tuple[int, int] | None = None
) -> None:
    """Write the page of a batch to `path`, or into the batch's folder, whole or not at all.

    `progress` is the number of ended scenes of a running batch, and the number of all scenes.
    """
    base = "."
    if path is not None:
        try:  # lexically, as browsers don't resolve links of a file system
            base = os.path.relpath(folder, path.parent).replace(os.sep, "/")
        except ValueError:  # another drive on Windows
            base = Path(folder).absolute().as_posix()
    name = (folder.resolve() if isinstance(folder, Path) else Path(store.shown(folder))).name
    content = describe_batch(read_index(folder).values(), _find_thumbnails(folder))
    # browsers expect the bytes of a name that is no UTF-8
    content |= {"made": stamp(), "progress": progress, "base": quote(os.fsencode(base))}
    title = f"Batch {printable(name)}: {count_of(len(content['scenes']), 'scene')}"
    packed = to_text(json.dumps(content).encode())  # names may be no UTF-8
    page = make_page(title, {"packed": packed}, "navbake.batch", "page", PICTURE_POLICY)
    if path is None:
        store.write_file(folder, PAGE_NAME, page)
    else:
        write_bytes(page, path)


def _find_thumbnails(folder: store.Folder) -> Callable[[str], bool]:
    """A predicate whether a scene has a thumbnail, by its id; a store is listed once."""
    if isinstance(folder, Path):
        return lambda id: os.path.isfile(folder / id / THUMBNAIL_NAME)
    sizes = store.sizes_below(folder)
    return lambda id: f"{id}/{THUMBNAIL_NAME}" in sizes


def draw_thumbnails(folder: store.Folder, show: Callable[[float], None]) -> int:
    """Draw missing thumbnails from the grids; return how many are still missing.

    `show` is called with the fraction that is done. Raises FullError if the folder has no room.
    """
    has_thumbnail = _find_thumbnails(folder)
    num_failed = 0
    done = [id for id, row in read_index(folder).items() if row.get("status") == OK]
    missing = [id for id in done if not has_thumbnail(id)]
    for number, id in enumerate(missing):
        show(number / len(missing))
        place = store.as_folder(store.join(folder, id))
        try:
            store.check_inside(folder, place)
            picture = draw_thumbnail(read_navgrid(store.read_file(store.join(place, GRID_NAME))))
            if record := read_record(place):  # for its removal with the grid
                write_record(place, {**record, "more": [THUMBNAIL_NAME]})
            store.write_file(place, THUMBNAIL_NAME, picture)
        except NavbakeError as error:  # no grid, a broken one, or a folder that can't be written
            if (why := store.why_full(error)) is not None:
                raise store.refused(
                    f"thumbnails into {store.shown(os.fspath(folder))}", why
                ) from error
            num_failed += 1
    return num_failed


class LivePage:
    """Keeps the page of a running batch up to date, in a small share of the batch's time.

    On a store, the page isn't written while the batch runs.
    """

    def __init__(self, folder: store.Folder, total: int) -> None:
        self._folder = folder
        self._total = total
        self._next = (
            time.monotonic() + MIN_WRITE_INTERVAL if isinstance(folder, Path) else float("inf")
        )

    def refresh(self, done: int) -> None:
        """Write the page if it is due; `done` is the number of ended scenes."""
        begin = time.monotonic()
        if begin < self._next:
            return
        with suppress(NavbakeError):  # raised at the end, if it can't be written then
            write_page(self._folder, progress=(done, self._total))
        end = time.monotonic()
        self._next = end + max(MIN_WRITE_INTERVAL, (end - begin) / MAX_WRITE_SHARE)


def describe_batch(rows: Iterable[Json], has_thumbnail: Callable[[str], bool]) -> Json:
    """Return the data that the page shows, from the rows of an index.

    Its keys are ``scenes``, a list of the scenes; ``work``, see `measure_work` [s]; ``groups``,
    which maps each status, and each text of the kinds in `GROUPED_TEXTS`, to the name of its group;
    ``edges``, the edges of each chart's bars; and ``classes``, the lower edges of the episodes'
    classes.
    """
    scenes: list[Json] = []
    for row in rows:
        if row.get("status") in STATUSES:
            scene: Json = {key: row.get(key) for key in ROW_KEYS}
            why = ": ".join(filter(None, (row.get("how"), row.get("error"))))
            scene["failures"] = [why] if row["status"] == FAILED else []
            scene |= {key: row.get(key) or [] for key in ("warnings", "audit")}
            scene |= {"files": [*(row.get("files") or ())], "stages": row.get("stages") or {}}
            scene["thumbnail"] = row["status"] == OK and has_thumbnail(row["id"])
            scene["episodes"] = row.get("episodes")
            scenes.append(scene)
    return {
        "work": round(measure_work(scenes), 3),
        "scenes": scenes,
        "classes": MEASURE_CLASSES,
        "groups": {"status": {status: status for status in STATUSES}}
        | {
            kind: _group(text for scene in scenes for text in scene[kind]) for kind in GROUPED_TEXTS
        },
        "edges": {key: _edges([s[key] for s in scenes if s[key] is not None]) for key in CHARTS},
    }


def measure_work(scenes: Iterable[Json]) -> float:
    """Return for how long at least one scene was being baked [s], over all runs of the batch."""
    work = 0.0
    reached = -math.inf
    spans = []
    for scene in scenes:
        if scene["ended"] and scene["seconds"]:
            end = datetime.fromisoformat(scene["ended"].replace("Z", "+00:00")).timestamp()
            spans.append((end - scene["seconds"], end))
    for begin, end in sorted(spans):
        work += max(0.0, end - max(begin, reached))
        reached = max(reached, end)
    return work


def _edges(values: Sequence[float]) -> list[float]:
    """The edges of a histogram: of equal widths, or equal ratios for skewed values."""
    if not values:
        return []
    least = float(min(values))
    most = float(max(values))
    if least > 0 and most > SKEWED_RATIO * float(np.median(values)):
        return [*np.geomspace(least, most, NUM_BINS + 1).tolist()[:-1], most]
    step = nice_step((most - least or abs(most) or 1) / (NUM_BINS - 4))
    if all(float(value).is_integer() for value in values):
        step = max(step, 1.0)
    first = math.floor(least / step + 1e-9)
    last = max(math.floor(most / step + 1e-9), first) + 1
    return [round(number * step, 12) for number in range(first, last + 1)]


def _group(texts: Iterable[str]) -> dict[str, str]:
    """The group of each text by `fold`, or the text itself if it is alone."""
    folded = {text: fold(text) for text in texts}
    count = Counter(folded.values())
    return {text: group if count[group] > 1 else text for text, group in folded.items()}


def fold(text: str) -> str:
    """Replace the scene-specific parts of a message, so that similar messages become equal.

    Quoted parts, paths, file names and words with digits become ``…``, and numbers become ``#``.
    Settings in backticks stay.
    """

    def replace(match: re.Match[str]) -> str:
        if match["word"] is None:
            return match["setting"] or "…"
        core = match["word"].rstrip(".!?")
        folded = "#" if NUMBER.fullmatch(core) else "…" if PATH_OR_NAME.search(core) else core
        return folded + match["word"][len(core) :]

    return FOLDED_PART.sub(replace, THOUSANDS.sub("", text))
