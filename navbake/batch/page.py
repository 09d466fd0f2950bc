"""Writes the page of a batch, which a browser shows without a server or the network.

`page.html` and `page.js` show the data of `describe_batch`. Names appear as text, never as HTML.
"""

from __future__ import annotations

import json
import math
import os
import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from navbake.batch import store
from navbake.batch.index import read_index
from navbake.batch.job import FAILED, LEFT, OK, current_time, read_record, write_record
from navbake.batch.products import GRID_NAME, MEASURE_CLASSES, THUMBNAIL_NAME
from navbake.errors import NavbakeError, count_of, printable
from navbake.formats.navgrid import read_navgrid
from navbake.formats.source import write_bytes
from navbake.types import Json
from navbake.views.layers import round_up_step
from navbake.views.notebook import draw_thumbnail
from navbake.views.page import compress_to_text, make_page

PAGE_NAME = "index.html"
PICTURE_POLICY = "'self' file: data:"  # thumbnails are beside the page
MIN_WRITE_INTERVAL = 15.0  # shortest time between two writes of a running batch's page [s]
MAX_WRITE_SHARE = 0.01  # largest share of the batch's time that goes into writing its page

SHOWN_STATUSES = (OK, FAILED, LEFT)
CHART_KEYS = ("free_area", "cells", "rooms", "seconds")
# keys of a row that the page's data has unchanged
ROW_KEYS = ("id", "status", "source", "version", "ended", "levels", "doors", *CHART_KEYS)
NUM_BINS = 24  # approximate number of a chart's bars
# If the maximum is more than this many times the median, bars have equal ratios, not equal widths.
SKEWED_RATIO = 20
GROUPED_TEXTS = ("failures", "warnings", "audit")  # kinds of texts that `fold_text` groups

# one of: a setting in backticks, a quoted text, a word
FOLDED_PART_PATTERN = re.compile(
    r"""(?P<setting>`[^`]*`)|(?<!\w)'[^']*'(?!\w)|(?<!\w)"[^"]*"(?!\w)"""
    r"""|(?P<word>[^\s`'"(),;:=<>\[\]{}]+)"""
)
# a comma between digits, as in 1,000
THOUSANDS_COMMA_PATTERN = re.compile(r"(?<=\d),(?=\d{3}(?!\d))")
# a number, maybe with a unit: 5cm, 30%
NUMBER_PATTERN = re.compile(
    r"(?P<sign>[-+])?±?(?P<digits>(\d+(\.\d+)*|\.\d+)([eE][-+]?\d+)?)[a-zA-Z%²³°]{0,3}"
)
# where an audit found something, as in: level 0 (1.00, 2.00, 0.00):
AUDIT_PLACE_PATTERN = re.compile(r"\blevel \d+( \([^()]*\))?: ")
# matches within a path, a file's name or a name with a digit
PATH_OR_NAME_PATTERN = re.compile(r"[/\\\d]|\.[a-zA-Z]\w{1,4}$")


def write_page(
    folder: store.Folder,
    path: Path | None = None,
    *,
    progress: tuple[int, int] | None = None,
) -> None:
    """Write the page of a batch, whole or not at all.

    Args:
        folder: the batch's output folder.
        path: the file to write; None for `PAGE_NAME` in the folder.
        progress: the number of scenes that ended, and of all scenes, while the batch runs; None for
            a batch that has ended.
    """
    relative_folder = "."
    if path is not None:
        try:  # links of the file system stay unresolved, since browsers don't resolve them either
            relative_folder = os.path.relpath(folder, path.parent).replace(os.sep, "/")
        except ValueError:  # another drive on Windows
            relative_folder = Path(folder).absolute().as_posix()
    folder_name = (
        folder.resolve() if isinstance(folder, Path) else Path(store.without_secrets(folder))
    ).name
    page_data = describe_batch(read_index(folder).values(), _find_thumbnails(folder))
    # of a name that isn't UTF-8, browsers expect the bytes
    page_data |= {
        "made": current_time(),
        "progress": progress,
        "base": quote(os.fsencode(relative_folder)),
    }
    title = f"Batch {printable(folder_name)}: {count_of(len(page_data['scenes']), 'scene')}"
    # in ASCII: names may not be UTF-8
    packed_content = compress_to_text(json.dumps(page_data).encode())
    page = make_page(title, {"packed": packed_content}, "navbake.batch", "page", PICTURE_POLICY)
    if path is None:
        store.write_file(folder, PAGE_NAME, page)
    else:
        write_bytes(page, path)


def _find_thumbnails(folder: store.Folder) -> Callable[[str], bool]:
    """Return a function that says whether the scene with an id has a thumbnail.

    A store is listed once, now; a local folder is looked at in each call.
    """
    if isinstance(folder, Path):
        return lambda id: os.path.isfile(folder / id / THUMBNAIL_NAME)
    size_of_file = store.list_file_sizes(folder)
    return lambda id: f"{id}/{THUMBNAIL_NAME}" in size_of_file


def draw_thumbnails(folder: store.Folder, show_progress: Callable[[float], None]) -> int:
    """Draw the missing thumbnails of a batch from its grids.

    Args:
        folder: the batch's output folder.
        show_progress: is called with the fraction that is done, 0 to 1.

    Returns:
        How many thumbnails couldn't be drawn.

    Raises:
        DiskFullError: the folder has no room.
    """
    has_thumbnail = _find_thumbnails(folder)
    num_failed_thumbnails = 0
    baked_ids = [id for id, row in read_index(folder).items() if row.get("status") == OK]
    missing_ids = [id for id in baked_ids if not has_thumbnail(id)]
    for index, id in enumerate(missing_ids):
        show_progress(index / len(missing_ids))
        scene_folder = store.as_folder(store.join(folder, id))
        try:
            store.check_inside(folder, scene_folder)
            grid = read_navgrid(store.read_file(store.join(scene_folder, GRID_NAME)))
            picture = draw_thumbnail(grid)
            record = read_record(scene_folder)
            if record:  # so that the thumbnail is removed together with the grid
                write_record(scene_folder, {**record, "more": [THUMBNAIL_NAME]})
            store.write_file(scene_folder, THUMBNAIL_NAME, picture)
        except NavbakeError as error:  # no grid, a broken one, or a folder that can't be written
            disk_full_error = store.find_disk_full_error(error)
            if disk_full_error is not None:
                destination = f"thumbnails into {store.without_secrets(os.fspath(folder))}"
                raise store.make_write_error(destination, disk_full_error) from error
            num_failed_thumbnails += 1
    return num_failed_thumbnails


class LivePage:
    """Keeps the page of a running batch up to date, in a small share of the batch's time.

    On a store, the page isn't written while the batch runs.
    """

    def __init__(self, folder: store.Folder, num_scenes: int) -> None:
        self._folder = folder
        self._num_scenes = num_scenes
        self._next_write = (  # time.monotonic [s]
            time.monotonic() + MIN_WRITE_INTERVAL if isinstance(folder, Path) else float("inf")
        )

    def refresh(self, num_ended: int) -> None:
        """Write the page if enough time has passed since it was last written.

        Args:
            num_ended: the number of scenes that have ended.
        """
        begin_time = time.monotonic()
        if begin_time < self._next_write:
            return
        with suppress(NavbakeError):  # raised at the end, if it can't be written then
            write_page(self._folder, progress=(num_ended, self._num_scenes))
        end_time = time.monotonic()
        self._next_write = end_time + max(
            MIN_WRITE_INTERVAL, (end_time - begin_time) / MAX_WRITE_SHARE
        )


def describe_batch(rows: Iterable[Mapping[str, Any]], has_thumbnail: Callable[[str], bool]) -> Json:
    """Return the data that the page shows.

    Args:
        rows: the rows of an index, see `SceneRow`.
        has_thumbnail: says whether the scene with an id has a thumbnail.

    Returns:
        An object with these keys:

        - ``scenes``: a list with an object for each scene;
        - ``work``: see `measure_work` [s];
        - ``groups``: for ``status`` and each kind of `GROUPED_TEXTS`: text -> name of its group;
        - ``edges``: for each chart of `CHART_KEYS`: the edges of its bars, ascending;
        - ``classes``: for each measure of episodes: the lower edges of its classes.
    """
    scenes: list[Json] = []
    for row in rows:
        if row.get("status") in SHOWN_STATUSES:
            scene: Json = {key: row.get(key) for key in ROW_KEYS}
            failure = ": ".join(filter(None, (row.get("how"), row.get("error"))))
            scene["failures"] = [failure] if row["status"] == FAILED else []
            scene |= {key: row.get(key) or [] for key in ("warnings", "audit")}
            scene |= {"files": [*(row.get("files") or ())], "stages": row.get("stages") or {}}
            scene["thumbnail"] = row["status"] == OK and has_thumbnail(row["id"])
            scene["episodes"] = row.get("episodes")
            scenes.append(scene)
    return {
        "work": round(measure_work(scenes), 3),
        "scenes": scenes,
        "classes": MEASURE_CLASSES,
        "groups": {"status": {status: status for status in SHOWN_STATUSES}}
        | {
            kind: _group_texts(text for scene in scenes for text in scene[kind])
            for kind in GROUPED_TEXTS
        },
        "edges": {
            key: _histogram_edges([scene[key] for scene in scenes if scene[key] is not None])
            for key in CHART_KEYS
        },
    }


def measure_work(scenes: Iterable[Json]) -> float:
    """Return for how long at least one scene was being baked [s], over all runs of the batch.

    Args:
        scenes: objects with the keys ``seconds`` and ``ended`` of `SceneRow`, which may be None.
    """
    work_seconds = 0.0
    covered_until = -math.inf
    work_spans = []  # begin and end of each scene
    for scene in scenes:
        if scene["ended"] and scene["seconds"]:
            end = datetime.fromisoformat(scene["ended"].replace("Z", "+00:00")).timestamp()
            work_spans.append((end - scene["seconds"], end))
    for begin, end in sorted(work_spans):
        work_seconds += max(0.0, end - max(begin, covered_until))
        covered_until = max(covered_until, end)
    return work_seconds


def _histogram_edges(values: Sequence[float]) -> list[float]:
    """Return the edges of a histogram's bars, ascending; [] without values.

    The bars have equal widths; for skewed values, the ratio of each bar's edges is the same.
    """
    if not values:
        return []
    lowest_value = float(min(values))
    highest_value = float(max(values))
    if lowest_value > 0 and highest_value > SKEWED_RATIO * float(np.median(values)):
        return [
            *np.geomspace(lowest_value, highest_value, NUM_BINS + 1).tolist()[:-1],
            highest_value,
        ]
    bar_width = round_up_step(
        (highest_value - lowest_value or abs(highest_value) or 1) / (NUM_BINS - 4)
    )
    if all(float(value).is_integer() for value in values):
        bar_width = max(bar_width, 1.0)
    first_multiple = math.floor(lowest_value / bar_width + 1e-9)
    last_multiple = max(math.floor(highest_value / bar_width + 1e-9), first_multiple) + 1
    return [
        round(multiple * bar_width, 12) for multiple in range(first_multiple, last_multiple + 1)
    ]


def _group_texts(texts: Iterable[str]) -> dict[str, str]:
    """Group texts by `fold_text`: text -> name of its group, or the text if it is alone in it.

    The name of a group says in words what its texts have in common, see `_name_group`.
    """
    unique_texts = dict.fromkeys(texts)
    texts_of_group: dict[str, list[str]] = {}
    for text in unique_texts:
        texts_of_group.setdefault(fold_text(text), []).append(text)
    name_of_text: dict[str, str] = {}
    used_names: set[str] = set()
    for group_texts in texts_of_group.values():
        name = _name_group(group_texts)
        while name in used_names:  # two groups that differ in what names leave out
            name += " …"
        used_names.add(name)
        name_of_text |= dict.fromkeys(group_texts, name)
    return name_of_text


def _name_group(texts: Sequence[str]) -> str:
    """Return the name of a group of texts that `fold_text` makes equal.

    Numbers that differ become their range, as in ``a gap of 0.2 to 0.5 m``, other parts that differ
    become ``…``. The place where an audit found something is left out.

    Args:
        texts: the texts.
    """
    if len(texts) == 1:
        return texts[0]
    parts_of_text = [_split_text(AUDIT_PLACE_PATTERN.sub("", text)) for text in texts]
    if len(set(map(len, parts_of_text))) > 1:  # a text has a # or … of its own
        return fold_text(texts[0])
    return "".join(_name_part(parts) for parts in zip(*parts_of_text, strict=True))


def _split_text(text: str) -> list[str]:
    """Split a text into what `fold_text` keeps and what it replaces, in turns."""
    text = THOUSANDS_COMMA_PATTERN.sub("", text)
    parts = []
    position = 0  # where the next part begins
    for match in FOLDED_PART_PATTERN.finditer(text):
        if _fold_part(match) != match[0]:
            replaced = match[0].rstrip(".!?") if match["word"] else match[0]
            parts += [text[position : match.start()], replaced]
            position = match.start() + len(replaced)
    return [*parts, text[position:]]


def _name_part(parts: Sequence[str]) -> str:
    """Return what parts at one place of several texts have in common: themselves, a range, or …."""
    if len(set(parts)) == 1:
        return parts[0]
    matches = [NUMBER_PATTERN.fullmatch(part) for part in parts]
    value_of_part = {
        part: float(f"{match['sign'] or ''}{match['digits']}")
        for part, match in zip(parts, matches, strict=True)
        if match is not None and match["digits"].count(".") < 2
    }
    if len(value_of_part) < len(set(parts)):
        return "…"
    lowest = min(value_of_part, key=lambda part: value_of_part[part])
    highest = max(value_of_part, key=lambda part: value_of_part[part])
    return f"{lowest} to {highest}"


def fold_text(text: str) -> str:
    """Replace the scene-specific parts of a message, so that similar messages become equal.

    Quoted parts, paths, file names and words with digits become ``…``, and numbers become ``#``.
    Settings in backticks stay.
    """
    return FOLDED_PART_PATTERN.sub(_fold_part, THOUSANDS_COMMA_PATTERN.sub("", text))


def _fold_part(match: re.Match[str]) -> str:
    """Return what a match of `FOLDED_PART_PATTERN` becomes in a folded text."""
    if match["word"] is None:
        return match["setting"] or "…"
    word = match["word"].rstrip(".!?")
    placeholder = (
        "#"
        if NUMBER_PATTERN.fullmatch(word)
        else "…"
        if PATH_OR_NAME_PATTERN.search(word)
        else word
    )
    return placeholder + match["word"][len(word) :]
