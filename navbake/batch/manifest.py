"""The scenes of a batch: from files, folders, patterns, and lists of them."""

from __future__ import annotations

import csv
import glob
import io
import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePath, PurePosixPath
from typing import Any

from navbake.batch.job import Job, check_id, check_unique
from navbake.batch.settings import check_shared, merge, nest, of_id
from navbake.batch.stores.store import is_pattern, match_files, read_file
from navbake.batch.stores.urls import Folder, is_url, join, parent, plain_path, shown, split_url
from navbake.batch.table import read_table
from navbake.config.errors import find_unknown_key, show_value
from navbake.config.settings import SECTIONS, BakeConfig
from navbake.errors import ConfigError, FormatError, shorten
from navbake.formats.scene_files import fold_name
from navbake.formats.source import read_bytes
from navbake.types import Json

LISTS = (".txt", ".csv", ".jsonl", ".parquet")
MAX_BYTES = 1 << 30  # of a list
SCENE_KEYS = ("scene", "config")  # of a row; one of them
TEXTS = ("id", *SCENE_KEYS)  # of which `001` is text
LINE_END = re.compile(r"\r\n?|\n")

Entry = tuple[str | None, str, Json, str]  # id if it is given, source, settings, place


def list_jobs(sources: Iterable[str]) -> list[Job]:
    """List the scenes that some sources name, in their order.

    A source is a scene or settings (YAML); a pattern with ``*``, ``?`` or ``[``, whose files come
    sorted; or a list: ``.txt`` with a path a line, ``.csv``, ``.jsonl`` or ``.parquet`` with a row
    a scene. Each may be a URL that fsspec knows. Paths in a list are relative to it. A row has
    ``scene`` or ``config``; it may have ``id``, and settings under their keys (``agent.radius``),
    in JSON lines and Parquet also as ``"settings": {"agent": {"radius": 0.3}}``. An empty value is
    none. An id that is given is the grid's, too, whatever the scene's own settings say.

    An id that isn't given is the file's name without its ending; of names that several share,
    with as many of the folders above as tell them apart.

    Raises:
        ConfigError: a source names nothing, a list is broken, or ids can't be told apart. Whether
            the scenes of lists and URLs are there is not asked: one that isn't fails by itself.
        NavbakeError: a store refuses a list or a pattern.
        MissingDependencyError: what a URL or Parquet needs is not installed.
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
    source = plain_path(source)
    if _ending(source) in LISTS:
        yield from _read_list(source)
    elif is_url(source):
        yield from ((None, url, {}, shown(url)) for url in _expand_url(source))
    elif glob.has_magic(source) and not os.path.exists(source):
        # a folder or a pipe is no scene; one that can't be read, as by a broken link, will fail
        found = sorted(glob.glob(source, recursive=True))
        paths = [path for path in found if os.path.isfile(path) or not os.path.exists(path)]
        if not paths:
            raise ConfigError(f"expected files that match {source}, got none")
        for path in paths:
            yield None, path, {}, path
    elif not os.path.exists(source):
        raise ConfigError(
            f"expected a scene, settings, a list or a pattern, got {source}: there is no such file"
        )
    elif os.path.isdir(source):
        raise ConfigError(
            f"expected a scene, settings, a list or a pattern, got the folder {source}: name what "
            f"is in it, as '{os.path.join(source, '*.xml')}'"
        )
    else:
        yield None, source, {}, source


def _expand_url(source: str) -> list[str]:
    if not split_url(source).path or source.endswith("/"):
        folder = shown(source).rstrip("/")
        raise ConfigError(
            f"expected a scene, settings, a list or a pattern, got the folder {folder}: name what "
            f"is in it, as '{folder}/*.xml'"
        )
    if not is_pattern(source):
        return [source]
    found = match_files(source)
    if not found:
        raise ConfigError(f"expected files that match {shown(source)}, got none")
    return found


def _ending(source: str) -> str:
    path = split_url(source).text if is_url(source) else source
    return os.path.splitext(path)[1].lower()


def _read_list(source: str) -> Iterator[Entry]:
    rows = {".txt": _text_rows, ".csv": _csv_rows, ".jsonl": _json_rows, ".parquet": read_table}
    folder = parent(source) if is_url(source) else Path(os.path.dirname(source))
    content, name = _content_of(source)
    is_empty = True
    for place, row in rows[_ending(source)](content, name):
        is_empty = False
        try:
            entry = _entry(row, folder, place)
        except RecursionError as error:
            raise ConfigError(f"the settings at {place} are nested too deeply") from error
        yield entry
    if is_empty:
        raise ConfigError(f"expected at least one scene in {name}, got none")


def _entry(row: Json, folder: Folder, place: str) -> Entry:
    row = _without_nones(row)
    given = [key for key in SCENE_KEYS if key in row]
    if len(given) != 1 or not isinstance(row[given[0]], str):
        raise ConfigError(f"expected a path as `scene` or as `config` at {place}")
    name, path = row.pop("id", None), row.pop(given[0])
    nested = row.pop("settings", {})
    if not isinstance(nested, dict):
        raise ConfigError(f"expected an object as `settings` at {place}, got {show_value(nested)}")
    if isinstance(name, bool) or not isinstance(name, str | int | None):
        got = show_value(name)
        raise ConfigError(f"expected text or a whole number as `id` at {place}, got {got}")
    settings = nest([*nested.items(), *row.items()], folder, place)
    check_shared(settings, place)
    for key in settings:
        if key not in BakeConfig.model_fields:
            raise ConfigError(
                f"expected `id`, `scene`, `config` or a setting such as `agent.radius`, got "
                f"`{shorten(key)}` at {place}"
            )
    unknown = find_unknown_key(settings, SECTIONS)
    if unknown is not None:
        raise ConfigError(f"{unknown} at {place}")
    source = join(folder, path, place)
    if name is None:
        return None, source, settings, place
    return str(name), source, merge(settings, of_id(str(name))), place


def _without_nones(row: Mapping[str, Any]) -> Json:
    """A row, or settings in it, without what counts as not given."""
    found = {}
    for key, value in row.items():
        given = _without_nones(value) if isinstance(value, Mapping) else value
        if given != {} and not _is_none(given):
            found[key] = given
    return found


def _is_none(value: Any) -> bool:
    return value is None or value == "" or (isinstance(value, float) and math.isnan(value))


def _text_rows(content: bytes, source: str) -> Iterator[tuple[str, Json]]:
    for place, line in _lines(content, source):
        path = line.strip()
        if not path.startswith("#"):
            yield place, {"scene": path}


def _csv_rows(content: bytes, source: str) -> Iterator[tuple[str, Json]]:
    """The rows, each under the line that it begins at: a value in quotes may have several."""
    text = io.StringIO(_text_of(content, source), newline="")
    reader = csv.reader(text, strict=True, skipinitialspace=True)
    names: list[str] | None = None
    place = f"{source}, line 1"
    try:
        for values in reader:
            if values and names is None:
                names = _columns(values, place)
            elif values and names is not None:
                yield place, _csv_row(names, values, place)
            place = f"{source}, line {reader.line_num + 1}"
    except csv.Error as error:
        raise ConfigError(f"broken CSV at {place}: {error}") from error


def _columns(names: list[str], place: str) -> list[str]:
    if not set(names) & {*SCENE_KEYS}:
        got = show_value(",".join(names))
        raise ConfigError(
            f"expected names of columns, `scene` or `config` among them, got {got} at {place}"
        )
    for name, count in Counter(names).items():
        if name and count > 1:
            raise ConfigError(f"expected each column once, got `{name}` {count} times at {place}")
    return names


def _csv_row(names: list[str], values: list[str], place: str) -> Json:
    if len(values) > len(names):
        raise ConfigError(
            f"expected as many values as columns at {place}: {len(names)}, got {len(values)}: "
            f"{show_value(','.join(values))}"
        )
    row = {
        name: value if name in TEXTS else _plain(value, place)
        for name, value in zip(names, values, strict=False)
        if value
    }
    scene = next((row[key] for key in SCENE_KEYS if key in row), "")
    if scene.startswith("#"):
        raise ConfigError(
            f"expected a scene, got {show_value(scene)} at {place}: a CSV has no comments, "
            "and a path that begins so is written with ./ before it"
        )
    return row


def _plain(text: str, place: str) -> Any:
    """A cell of a CSV: a number, true, false, a list or an object as JSON has it, else text."""
    try:
        return _parse_json(text, place)
    except (ValueError, RecursionError):
        return text


def _json_rows(content: bytes, source: str) -> Iterator[tuple[str, Json]]:
    for place, line in _lines(content, source):
        try:
            row = _parse_json(line, place)
        except json.JSONDecodeError as error:
            raise ConfigError(
                f"broken JSON at {place}, column {error.colno}: {error.msg}"
            ) from error
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"broken JSON at {place}: {error}") from error
        if not isinstance(row, dict):
            raise ConfigError(f"expected an object at {place}, got {show_value(row)}")
        yield place, row


def _parse_json(text: str, place: str) -> Any:
    """The value that JSON stands for; a ConfigError where an object has a key twice."""

    def take(pairs: list[tuple[str, Any]]) -> Json:
        found = dict(pairs)
        if len(found) < len(pairs):
            key, count = Counter(key for key, _ in pairs).most_common(1)[0]
            got = f"`{shorten(key)}` {count} times"
            raise ConfigError(f"expected each key once, got {got} at {place}")
        return found

    return json.loads(text, object_pairs_hook=take)


def _lines(content: bytes, source: str) -> Iterator[tuple[str, str]]:
    """Lines that aren't blank, each with its place for messages; they may end as on any system."""
    for number, line in enumerate(LINE_END.split(_text_of(content, source)), 1):
        if line.strip():
            yield f"{source}, line {number}", line


def _content_of(source: str) -> tuple[bytes, str]:
    """A list's content, and its name for messages."""
    if is_url(source):
        return read_file(source, MAX_BYTES), shown(source)
    try:
        return read_bytes(source, limit=MAX_BYTES)
    except FormatError as error:
        raise ConfigError(str(error)) from error


def _text_of(content: bytes, name: str) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = error.object[: error.start].decode()  # without a mark at the beginning
        line = 1 + len(LINE_END.findall(before))
        raise ConfigError(f"expected UTF-8 in {name}, line {line}: {error.reason}") from error


def _name(found: list[Entry]) -> list[str]:
    """The id of each entry: its own, or the end of its path that no other has."""
    paths = [_path_of(source) for _, source, _, _ in found]
    depths = [1] * len(found)
    while True:
        names = [
            given or "/".join(path.parts[-depth:])
            for (given, *_), path, depth in zip(found, paths, depths, strict=True)
        ]
        folded = [fold_name(name) for name in names]
        counts = Counter(folded)
        # the first part is the root, which is no name
        longer = [
            depth + (given is None and counts[name] > 1 and depth < len(path.parts) - 1)
            for (given, *_), path, depth, name in zip(found, paths, depths, folded, strict=True)
        ]
        if longer == depths:
            return names
        depths = longer


def _path_of(source: str) -> PurePath:
    """The path whose parts can be an id: without an ending, and absolute, so that none is `..`."""
    if not is_url(source):
        return PurePath(os.path.splitext(os.path.abspath(source))[0])
    parts = split_url(source)
    host = parts.authority.rpartition("@")[2]
    path = PurePosixPath("/", host, *parts.path)
    return path.with_suffix("") if path.name else path
