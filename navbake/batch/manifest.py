"""The scenes of a batch: from files, folders, patterns, and lists of them."""

from __future__ import annotations

import csv
import glob
import io
import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from navbake.batch.job import Job, check_id, check_unique
from navbake.errors import ConfigError, MissingDependencyError
from navbake.formats.source import read_bytes
from navbake.types import Json

LISTS = (".txt", ".csv", ".jsonl", ".parquet")
SETTINGS = (".yaml", ".yml")
MAX_BYTES = 1 << 30  # of a list
SCENE_KEYS = ("scene", "config")  # of a row; one of them


def list_jobs(sources: Iterable[str]) -> list[Job]:
    """List the scenes that some sources name, in their order.

    A source is a scene or settings (YAML); a pattern with ``*``, ``?`` or ``[``, whose files come
    sorted; or a list: ``.txt`` with a source a line, ``.csv``, ``.jsonl`` or ``.parquet`` with a
    row for each scene. A row has ``scene`` or ``config``, relative to the list; it may have ``id``,
    and settings under their keys (``agent.radius``); in JSON lines also as ``settings: {agent:
    {radius: 0.3}}``. An empty value is none.

    An id that isn't given is the scene's name without its ending; of names that several share,
    with the folders that tell them apart.

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


Entry = tuple[str | None, str, Json, str]  # id if it is given, source, settings, place


def _expand(source: str) -> Iterator[Entry]:
    if source.lower().endswith(LISTS):
        yield from _read_list(source)
    elif glob.has_magic(source):
        paths = sorted(glob.glob(source, recursive=True))
        if not paths:
            raise ConfigError(f"expected files that match {source}, got none")
        for path in paths:
            yield None, path, {}, path
    else:
        yield None, source, {}, source


def _read_list(source: str) -> Iterator[Entry]:
    kind = source.lower().rpartition(".")[2]
    folder = os.path.dirname(source)
    rows = {"txt": _text_rows, "csv": _csv_rows, "jsonl": _json_rows, "parquet": _parquet_rows}
    for place, row in rows[kind](source):
        yield _entry(row, folder, place)


def _entry(row: Json, folder: str, place: str) -> Entry:
    row = {key: value for key, value in row.items() if value not in (None, "")}
    given = [key for key in SCENE_KEYS if key in row]
    if len(given) != 1 or not isinstance(row[given[0]], str):
        raise ConfigError(f"expected a path as `scene` or as `config` at {place}")
    name = row.pop("id", None)
    path = row.pop(given[0])
    nested = row.pop("settings", {})
    if not isinstance(nested, dict):
        raise ConfigError(f"expected an object as `settings` at {place}, got {nested!r}")
    return None if name is None else str(name), _join(folder, path), {**nested, **row}, place


def _join(folder: str, path: str) -> str:
    return path if "://" in path else os.path.join(folder, path)


def _text_rows(source: str) -> Iterator[tuple[str, Json]]:
    for number, line in enumerate(_text_of(source).splitlines(), 1):
        if line.strip() and not line.startswith("#"):
            yield f"{source}, line {number}", {"scene": line.strip()}


def _csv_rows(source: str) -> Iterator[tuple[str, Json]]:
    reader = csv.DictReader(io.StringIO(_text_of(source), newline=""), strict=True)
    try:
        for row in reader:
            place = f"{source}, line {reader.line_num}"
            if None in row:
                raise ConfigError(f"expected as many values as columns at {place}")
            yield place, {key: _plain(value) for key, value in row.items()}
    except csv.Error as error:
        raise ConfigError(f"broken CSV in {source}, line {reader.line_num}: {error}") from error


def _plain(text: str | None) -> Any:
    """A cell of a CSV: a number, true, false, a list or an object as JSON has it, else text."""
    try:
        return json.loads(text or '""')
    except ValueError:
        return text


def _json_rows(source: str) -> Iterator[tuple[str, Json]]:
    for number, line in enumerate(_text_of(source).splitlines(), 1):
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


def _parquet_rows(source: str) -> Iterator[tuple[str, Json]]:
    try:
        import pyarrow.parquet as parquet
    except ImportError as error:
        message = 'Parquet needs pyarrow: pip install "navbake[batch]"'
        raise MissingDependencyError(message) from error
    content, _ = read_bytes(source, limit=MAX_BYTES)
    try:
        rows = parquet.read_table(io.BytesIO(content)).to_pylist()
    except Exception as error:  # pyarrow's errors have no common base
        raise ConfigError(f"broken Parquet in {source}: {error}") from error
    for number, row in enumerate(rows):
        yield f"{source}, row {number}", row


def _text_of(source: str) -> str:
    content, name = read_bytes(source, limit=MAX_BYTES)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"expected UTF-8 in {name}: {error.reason}") from error


def _name(found: list[Entry]) -> list[str]:
    """The id of each entry: its own, or the end of its path that no other has."""
    paths = [PurePosixPath(Path(source).with_suffix("").as_posix()) for _, source, _, _ in found]
    names = [given or path.name for (given, *_), path in zip(found, paths, strict=True)]
    depth = 1
    while True:
        count: dict[str, int] = {}
        for name in names:
            count[name.casefold()] = count.get(name.casefold(), 0) + 1
        depth += 1
        longer = [
            "/".join(path.parts[-depth:])
            if given is None and count[name.casefold()] > 1 and depth <= len(path.parts)
            else name
            for (given, *_), path, name in zip(found, paths, names, strict=True)
        ]
        if longer == names:
            return names
        names = longer
