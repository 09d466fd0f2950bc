"""The scenes of a batch: from files, folders, patterns, and lists of them."""

from __future__ import annotations

import csv
import glob
import io
import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import PurePath
from typing import Any

from navbake.batch.job import Job, check_id, check_unique
from navbake.batch.settings import check_shared, nest
from navbake.config.settings import BakeConfig
from navbake.errors import ConfigError, FormatError
from navbake.formats.source import read_bytes
from navbake.types import Json

LISTS = (".txt", ".csv", ".jsonl")
MAX_BYTES = 1 << 30  # of a list
SCENE_KEYS = ("scene", "config")  # of a row; one of them
TEXTS = ("id", *SCENE_KEYS)  # of which `001` is text
SECTIONS = tuple(BakeConfig.model_fields)

Entry = tuple[str | None, str, Json, str]  # id if it is given, source, settings, place


def list_jobs(sources: Iterable[str]) -> list[Job]:
    """List the scenes that some sources name, in their order.

    A source is a scene or settings (YAML); a pattern with ``*``, ``?`` or ``[``, whose files come
    sorted; or a list: ``.txt`` with a path a line, ``.csv`` or ``.jsonl`` with a row a scene. Paths
    in a list are relative to it. A row has ``scene`` or ``config``; it may have ``id``, and
    settings under their keys (``agent.radius``), in JSON lines also as ``"settings": {"agent":
    {"radius": 0.3}}``. An empty value is none.

    An id that isn't given is the file's name without its ending; of names that several share,
    with as many of the folders above as tell them apart.

    Raises:
        ConfigError: a source names nothing, a list is broken, or ids can't be told apart.
    """
    found = [entry for source in sources for entry in _expand(source)]
    if not found:
        raise ConfigError("expected at least one scene, got none")
    names = _name(found)
    jobs = [Job(name, *entry[1:]) for name, entry in zip(names, found, strict=True)]
    for job in jobs:
        check_id(job.id, job.place)
    check_unique(jobs)
    return jobs


def _expand(source: str) -> Iterator[Entry]:
    if source.lower().endswith(LISTS):
        yield from _read_list(source)
    elif glob.has_magic(source) and not os.path.exists(source):
        paths = sorted(glob.glob(source, recursive=True))
        if not paths:
            raise ConfigError(f"expected files that match {source}, got none")
        for path in paths:
            yield None, path, {}, path
    elif os.path.isdir(source):
        raise ConfigError(
            f"expected a scene, settings, a list or a pattern, got the folder {source}: name what "
            f"is in it, as '{os.path.join(source, '*.xml')}'"
        )
    else:
        yield None, source, {}, source


def _read_list(source: str) -> Iterator[Entry]:
    kind = source.lower().rpartition(".")[2]
    rows = {"txt": _text_rows, "csv": _csv_rows, "jsonl": _json_rows}
    for place, row in rows[kind](source):
        yield _entry(row, os.path.dirname(source), place)


def _entry(row: Json, folder: str, place: str) -> Entry:
    row = {key: value for key, value in row.items() if value not in (None, "")}
    given = [key for key in SCENE_KEYS if key in row]
    if len(given) != 1 or not isinstance(row[given[0]], str):
        raise ConfigError(f"expected a path as `scene` or as `config` at {place}")
    name, path = row.pop("id", None), row.pop(given[0])
    nested = row.pop("settings", {})
    if not isinstance(nested, dict):
        raise ConfigError(f"expected an object as `settings` at {place}, got {nested!r}")
    settings = nest({**nested, **row}, folder)
    check_shared(settings, place)
    for key in settings:
        if key not in SECTIONS:
            raise ConfigError(
                f"expected `id`, `scene`, `config` or a setting such as `agent.radius`, got "
                f"`{key}` at {place}"
            )
    return None if name is None else str(name), os.path.join(folder, path), settings, place


def _text_rows(source: str) -> Iterator[tuple[str, Json]]:
    for number, line in enumerate(_text_of(source).split("\n"), 1):
        if line.strip() and not line.startswith("#"):
            yield f"{source}, line {number}", {"scene": line.strip()}


def _csv_rows(source: str) -> Iterator[tuple[str, Json]]:
    reader = csv.DictReader(io.StringIO(_text_of(source), newline=""), strict=True)
    try:
        for row in reader:
            place = f"{source}, line {reader.line_num}"
            if None in row:
                raise ConfigError(f"expected as many values as columns at {place}")
            named = {key: value for key, value in row.items() if key in TEXTS}
            yield place, {key: _plain(value) for key, value in row.items()} | named
    except csv.Error as error:
        raise ConfigError(f"broken CSV in {source}, line {reader.line_num}: {error}") from error


def _plain(text: str | None) -> Any:
    """A cell of a CSV: a number, true, false, a list or an object as JSON has it, else text."""
    try:
        return json.loads(text or '""')
    except ValueError:
        return text


def _json_rows(source: str) -> Iterator[tuple[str, Json]]:
    for number, line in enumerate(_text_of(source).split("\n"), 1):
        place = f"{source}, line {number}"
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"broken JSON at {place}: {error}") from error
        if not isinstance(row, dict):
            raise ConfigError(f"expected an object at {place}")
        yield place, row


def _text_of(source: str) -> str:
    try:
        content, name = read_bytes(source, limit=MAX_BYTES)
    except FormatError as error:
        raise ConfigError(str(error)) from error
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"expected UTF-8 in {name}: {error.reason}") from error


def _name(found: list[Entry]) -> list[str]:
    """The id of each entry: its own, or the end of its path that no other has."""
    # absolute, so that ids hold no `..`
    paths = [PurePath(os.path.splitext(os.path.abspath(source))[0]) for _, source, _, _ in found]
    depths = [1] * len(found)
    while True:
        names = [
            given or "/".join(path.parts[-depth:])
            for (given, *_), path, depth in zip(found, paths, depths, strict=True)
        ]
        counts = Counter(name.casefold() for name in names)
        # the first part is the root, which is no name
        longer = [
            depth + (given is None and counts[name.casefold()] > 1 and depth < len(path.parts) - 1)
            for (given, *_), path, depth, name in zip(found, paths, depths, names, strict=True)
        ]
        if longer == depths:
            return names
        depths = longer
