"""Lists scenes from paths, patterns, files of rows and URLs, and merges the settings of each."""

from __future__ import annotations

import csv
import glob
import io
import json
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

from navbake import samples
from navbake.batch import store
from navbake.batch.products import PRODUCT_FILE_PATTERN
from navbake.config.field_types import find_unknown_key, show_value
from navbake.config.keywords import merge
from navbake.config.settings import SECTIONS, BakeConfig, is_settings, parse_config
from navbake.errors import ConfigError, shorten
from navbake.formats.source import import_extra, unpack
from navbake.types import Json
from navbake.yaml_text import apply_overrides, decode_yaml, override_key

LIST_SUFFIXES = (".txt", ".csv", ".jsonl", ".parquet")
SCENE_KEYS = ("scene", "config")  # of a row; one of them
TEXT_COLUMNS = ("id", *SCENE_KEYS)  # whose `001` is text
UNIQUE_SCENE_KEYS = ("path", "id")  # keys of the settings' `scene` that are unique
LINE_END = re.compile(r"\r\n?|\n")
# characters that some file system forbids, or drops at the end of a name
UNPORTABLE = re.compile(r'[\\:*?"<>|]|^[.\s]|[.\s]$')
RESERVED_NAMES = re.compile(
    r"(?i)(con|prn|aux|nul|com\d|lpt\d|index\.(jsonl|parquet|html))(\..*)?"
    r"|index-\d+-of-\d+\.jsonl|shard-\d+\.tar"
)
NO_ROW_COLUMNS: Mapping[str, str] = MappingProxyType({})
MAX_ID_PART = 200  # of a part of an id; file systems take 255
EXPECTED_SCENE = "expected a scene, settings, a list or a pattern, got"


class Job(NamedTuple):
    """One scene of a batch."""

    id: str  #: Unique in the batch; the output folder, parts between slashes. Empty until known.
    source: str  #: The path or URL of the scene, or of its settings (YAML).
    settings: Json  #: Override the batch's settings for it, by section.
    place: str  #: Its place in a list, for messages.
    list: str = ""  #: The URL of its list; empty for local lists and sources given by the user.
    twin: str = ""  #: The id of an equal scene, whose grid serves for this one; empty without one.


def list_jobs(sources: Iterable[str], columns: Mapping[str, str] = NO_ROW_COLUMNS) -> list[Job]:
    """List the scenes of sources, in their order.

    A source is a scene or settings (YAML); a pattern with ``*``, ``?`` or ``[``, whose files come
    sorted; or a list: ``.txt`` with a path a line, ``.csv``, ``.jsonl`` or ``.parquet`` with a row
    a scene; all but Parquet also with ``.gz``. Each may be a URL that fsspec knows. Paths in a list
    are relative to it. A row has ``scene`` or ``config``; it may have ``id``, and settings under
    their keys (``agent.radius``), in JSON lines and Parquet also as ``"settings": {"agent":
    {"radius": 0.3}}``. Empty values are ignored. A given id is the grid's, too, and overrides the
    scene's own settings; the default is the file's name without its ending, and with the parent
    folders needed to make it unique.

    With `columns`, lists of other programs are read: the names of their columns by those above.
    Their other columns are ignored. A dot leads into an object: ``files.mjcf``.

    Raises:
        ConfigError: a source is empty, a list is broken, or ids are not unique. Missing scenes of
            lists and URLs fail later, each by itself.
        NavbakeError: a list can't be read, or a dependency for it is not installed.
    """
    listed = [entry for source in sources for entry in _expand(store.plain_path(source), columns)]
    if not listed:
        raise ConfigError("expected at least one scene, got none")
    jobs = []
    for name, job in zip(_name(listed), listed, strict=True):
        check_id(name, job.place)
        job_settings = merge(job.settings, of_id(name), job.place) if job.id else job.settings
        jobs.append(job._replace(id=name, settings=job_settings))
    by_folder: dict[str, Job] = {}  # by folders that are the same on some file system
    for job in jobs:
        twin = by_folder.setdefault(fold_name(job.id), job)
        if twin is job:
            continue
        if (twin.id, twin.source) == (job.id, job.source):
            raise ConfigError(
                f"expected each scene once, got {shorten(job.source)} at {twin.place} and at "
                f"{job.place}: name it once, or give each an `id` of its own in a list"
            )
        first = f"{shorten(repr(twin.id))} at {twin.place}"
        second = f"{shorten(repr(job.id))} at {job.place}"
        raise ConfigError(
            f"expected unique ids, got {first} and {second}: give each an `id` of its own"
        )
    return jobs


def check_id(name: str, place: str) -> None:
    r"""Refuse an id that may lead out of the output folder, or that some file system refuses.

    Raises a ConfigError if the id is empty, is absolute, or names a file that navbake writes for
    another scene. Raises it as well if a part of the id begins with a dot, ends with a dot or a
    space, is too long, is a name that Windows reserves, or has one of ``\:*?"<>|`` or an
    unprintable character.
    """
    for part in name.split("/"):
        is_fit = part.isprintable() and 0 < len(part.encode()) <= MAX_ID_PART
        if not is_fit or UNPORTABLE.search(part) or RESERVED_NAMES.fullmatch(part):
            wanted = "that can be the name of a folder on any system, or several between slashes"
        elif PRODUCT_FILE_PATTERN.fullmatch(part.casefold()):
            wanted = f"without names of files that navbake writes, as {part}"
        else:
            continue
        got = f"got {shorten(repr(name))} at {place}: give it another `id`"
        raise ConfigError(f"expected an id {wanted}, {got}")


def fold_name(name: str) -> str:
    """Fold a name by Unicode's canonical caseless matching, as some file systems compare names."""
    return unicodedata.normalize("NFD", unicodedata.normalize("NFD", name).casefold())


def _name(listed: list[Job]) -> list[str]:
    """The ids of entries: their own, or the unique ends of their paths."""
    paths = [_parts_of(entry.source) for entry in listed]
    depths = [1] * len(listed)
    while True:
        rows = [*zip(listed, paths, depths, strict=True)]
        names = [entry.id or "/".join(parts[-depth:]) for entry, parts, depth in rows]
        counts = Counter(map(fold_name, names))
        depths = [
            depth + (not entry.id and counts[fold_name(name)] > 1 and depth < len(parts))
            for (entry, parts, depth), name in zip(rows, names, strict=True)
        ]
        if depths == [depth for *_, depth in rows]:
            return names


def _parts_of(source: str) -> tuple[str, ...]:
    """The parts of a path that can be an id: without its ending and the root."""
    if store.is_url(source):
        path = PurePosixPath("/", store.shown(source).partition("://")[2].rpartition("@")[2])
        return path.with_suffix("").parts[1:] if path.name else ("",)
    return Path(os.path.splitext(os.path.abspath(source))[0]).parts[1:]


def _expand(source: str, columns: Mapping[str, str]) -> Iterator[Job]:
    """The scenes of a source."""
    name = store.shown(source)
    is_pattern = glob.has_magic(name) and not os.path.exists(source)
    if not store.is_url(source) and not is_pattern and not os.path.exists(source):
        settings = str(samples.find(source))
        hint = "" if settings == source else f"; the settings of that name are {settings}"
        raise ConfigError(f"{EXPECTED_SCENE} {source}: there is no such file{hint}")
    if _list_ending(name) in LIST_SUFFIXES:
        yield from _read_list(source, columns)
    elif source.endswith("/") or os.path.isdir(source):
        folder = name.rstrip("/")
        raise ConfigError(
            f"{EXPECTED_SCENE} the folder {folder}: name its files, as '{folder}/*.xml'"
        )
    elif is_pattern:
        if store.is_url(source):
            paths = store.match_files(source)
        else:
            # a folder is no scene; one that can't be read, as by a broken link, will fail
            matches = sorted(glob.glob(source, recursive=True))
            paths = [path for path in matches if os.path.isfile(path) or not os.path.exists(path)]
        if not paths:
            raise ConfigError(f"expected files that match {name}, got none")
        for path in paths:
            yield Job("", path, {}, store.shown(path))
    else:
        yield Job("", source, {}, name)


# ---------------------------------------------------------------- lists


def _list_ending(name: str) -> str:
    """The ending of a list's name, without ``.gz``."""
    return PurePosixPath(name.lower().removesuffix(".gz")).suffix


def _read_list(source: str, columns: Mapping[str, str]) -> list[Job]:
    """The scenes of a list, each with the place of its row for messages."""
    name = store.shown(source)
    read = {".txt": _text_rows, ".csv": _csv_rows, ".jsonl": _json_rows, ".parquet": _table_rows}
    content = store.read_file(source)
    content = unpack(content, name) if name.lower().endswith(".gz") else content
    rows = read[_list_ending(name)](content, name, {*SCENE_KEYS, *columns.values()})
    on_web = source if store.is_url(source) else ""
    jobs = [
        _entry(_pick(row, columns, place), store.parent(source), place)._replace(list=on_web)
        for place, row in rows
    ]
    if not jobs:
        raise ConfigError(f"expected at least one scene in {name}, got none")
    return jobs


def _pick(row: Json, columns: Mapping[str, str], place: str) -> Json:
    """A row by navbake's keys, from columns of other names; the row itself without `columns`."""
    picked: Json = {}
    for key, column in columns.items():
        value: object = row.get(column)
        if column not in row:
            value = row
            for field in column.split("."):
                value = value.get(field) if isinstance(value, Mapping) else None
        if value is None and key in SCENE_KEYS:
            present = ", ".join(map(repr, row))
            raise ConfigError(f"expected a column {column!r} at {place}, got {shorten(present)}")
        picked[key] = value
    return picked if columns else row


def _entry(row: Json, folder: store.Folder, place: str) -> Job:
    row = _without_nones(row)
    sources = [row.pop(key) for key in SCENE_KEYS if key in row]
    if len(sources) != 1 or not isinstance(sources[0], str):
        hint = "; --column scene=NAME names the column that has it" if not sources and row else ""
        if {"rooms", "walls", "objects"} <= row.keys():  # without its objects' shapes
            hint = "; a house of ProcTHOR only names the assets in it: list an MJCF of it"
        raise ConfigError(f"expected a path as `scene` or as `config` at {place}{hint}")
    name = row.pop("id", None)
    nested = row.pop("settings", {})
    if not isinstance(nested, dict):
        raise ConfigError(f"expected an object as `settings` at {place}, got {show_value(nested)}")
    if isinstance(name, bool) or not isinstance(name, str | int | None):
        actual = show_value(name)
        raise ConfigError(f"expected text or a whole number as `id` at {place}, got {actual}")
    settings = nest([*nested.items(), *row.items()], folder, place)
    check_shared(settings, place)
    for key in settings.keys() - BakeConfig.model_fields:
        expected = "`id`, `scene`, `config` or a setting such as `agent.radius`"
        raise ConfigError(f"expected {expected}, got `{shorten(key)}` at {place}")
    unknown = find_unknown_key(settings, SECTIONS)
    if unknown is not None:
        raise ConfigError(f"{unknown} at {place}")
    return Job("" if name is None else str(name), store.join(folder, sources[0]), settings, place)


def _without_nones(row: Mapping[str, Any]) -> Json:
    """A row, or settings in it, without empty values."""
    cleaned = {}
    for key, value in row.items():
        cleaned_value = _without_nones(value) if isinstance(value, Mapping) else value
        if (
            cleaned_value not in (None, "", {}) and cleaned_value == cleaned_value
        ):  # NaN is none, too
            cleaned[key] = cleaned_value
    return cleaned


Rows: TypeAlias = Iterator[tuple[str, Json]]
"""The rows of a list, each with its place."""


def _lines(content: bytes, name: str) -> list[str]:
    try:
        return LINE_END.split(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        number = 1 + len(LINE_END.findall(error.object[: error.start].decode()))
        raise ConfigError(f"expected UTF-8 in {name}, line {number}: {error.reason}") from error


def _text_rows(content: bytes, name: str, scenes: set[str]) -> Rows:
    for number, line in enumerate(_lines(content, name), 1):
        if line.strip() and not line.strip().startswith("#"):
            yield f"{name}, line {number}", {"scene": line.strip()}


def _json_rows(content: bytes, name: str, scenes: set[str]) -> Rows:
    for number, line in enumerate(_lines(content, name), 1):
        place = f"{name}, line {number}"
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"broken JSON at {place}: {error}") from error
        if not isinstance(row, dict):
            raise ConfigError(f"expected an object at {place}, got {show_value(row)}")
        yield place, row


def _csv_rows(content: bytes, name: str, scenes: set[str]) -> Rows:
    """The rows by their first line, as a quoted value may span several.

    One of the columns `scenes` is expected.
    """
    text = (f"{line}\n" for line in _lines(content, name))
    lines = csv.reader(text, strict=True, skipinitialspace=True)
    columns: list[str] = []
    place = f"{name}, line 1"
    try:
        for values in lines:
            if values and not columns:
                columns = values
                if not {*columns} & scenes:
                    expected = "expected names of columns, `scene` or `config` among them"
                    got = show_value(",".join(columns))
                    raise ConfigError(f"{expected}, got {got} at {place}")
            elif len(values) > len(columns):
                expected = f"expected as many values as columns at {place}: {len(columns)}"
                got = show_value(",".join(values))
                raise ConfigError(f"{expected}, got {len(values)}: {got}")
            elif values:
                cells = zip(columns, values, strict=False)
                yield place, {key: v if key in TEXT_COLUMNS else _plain(v) for key, v in cells if v}
            place = f"{name}, line {lines.line_num + 1}"
    except csv.Error as error:
        raise ConfigError(f"broken CSV at {place}: {error}") from error


def _plain(text: str) -> Any:
    """A cell of a CSV: a number, true, false, a list or an object as in JSON, else text."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def _table_rows(content: bytes, name: str, scenes: set[str]) -> Rows:
    parquet = import_extra("pyarrow.parquet", "batch", "Parquet")
    try:
        rows = parquet.read_table(io.BytesIO(content)).to_pylist()
    except Exception as error:  # pyarrow raises many types
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ConfigError(f"broken Parquet in {name}: {reason}") from error
    for number, row in enumerate(rows, 1):
        # pandas adds an index column
        without_index = {
            key: value for key, value in row.items() if not key.startswith("__index_level_")
        }
        yield f"{name}, row {number}", without_index


# ---------------------------------------------------------------- settings


def read_shared(path: str | os.PathLike[str]) -> Json:
    """Read the settings that all scenes share from a YAML file; its path may be a URL.

    Raises a ConfigError for a missing file, no YAML, no mapping, or settings that select a scene.
    """
    text = store.plain_path(os.fspath(path))
    settings = nest(_read_mapping(text).items(), store.parent(text), store.shown(text))
    check_shared(settings, store.shown(text))
    return settings


def check_shared(settings: Mapping[str, Any], place: str) -> None:
    """Refuse shared settings that select a scene."""
    scene = {} if settings.get("scene") is None else settings["scene"]
    hint = "the batch's sources name the scenes"
    if not isinstance(scene, Mapping):
        got = f"got {show_value(scene)}: {hint}"
        raise ConfigError(f"expected settings as `scene` in {place}, {got}")
    for key in UNIQUE_SCENE_KEYS:
        if key in scene:
            raise ConfigError(f"expected no `scene.{key}` in {place}: {hint}")


def check_settings(sources: Iterable[str], shared: Json, overrides: Sequence[str]) -> None:
    """Check the shared settings and overrides before any scene is baked.

    A file of room outlines must exist. It isn't checked if it is on a store, or if an override
    names it relative to each scene's YAML. Raises a ConfigError.
    """
    for override in overrides:
        key = override_key(override)
        if key[0] == "scene" and (len(key) == 1 or key[1] in UNIQUE_SCENE_KEYS):
            raise ConfigError(f"expected no --set {override}: the batch's sources name the scenes")
    outlines = outlines_of(apply_overrides(shared, overrides))
    is_of_each = outlines and not os.path.isabs(outlines) and any(map(is_settings, sources))
    if is_of_each or store.is_url(outlines):
        overrides = [*overrides, "rooms.polygons=[]"]
    settings_of(Job("scene", "scene.xml", {}, "the batch"), shared, overrides)


def settings_of(
    job: Job,
    shared: Json,
    overrides: Sequence[str],
    fetch: Callable[[str], Path] = Path,
) -> BakeConfig:
    """Return a scene's settings, merged from four sources; each replaces those before it.

    In order: the batch's shared settings, the scene's YAML file, the scene's row in a list, and the
    overrides. Paths in the YAML and in overrides are relative to the YAML's folder. `fetch` returns
    the local path of a file, after copying it if it is on a store. Raises a ConfigError.
    """
    place = f"the settings of {job.place}"
    own_settings: Mapping[str, Any] = {"scene": {"path": job.source}}
    outlines = outlines_of(apply_overrides({}, overrides))
    if is_settings(job.source):
        folder = store.parent(job.source)
        own_settings = _with_files(_read_mapping(job.source), lambda name: store.join(folder, name))
        outlines = outlines and store.join(folder, outlines)
    settings = dict(of_id(job.id))
    for part in (shared, own_settings, job.settings):
        settings = merge(settings, part, place)
    settings = _with_files(settings, lambda name: str(fetch(name)))
    if outlines:  # JSON is YAML, whatever the path is
        overrides = [*overrides, f"rooms.polygons={json.dumps(str(fetch(outlines)))}"]
    return parse_config(settings, place, overrides)


def of_id(name: str) -> Json:
    """Return settings with a scene's id as `scene.id`, in which ``_`` replaces slashes."""
    return {"scene": {"id": name.replace("/", "_")}}


def nest(settings: Iterable[tuple[str, Any]], folder: store.Folder, place: str) -> dict[str, Any]:
    """Nest flat settings with keys such as ``agent.radius`` into sections.

    Relative paths are joined to `folder`. Raises a ConfigError, which names `place`, if a key is
    unknown, or continues below a key that has a value.
    """
    nested: dict[str, Any] = {}
    for key, value in settings:
        try:
            sections = override_key(f"{key.replace('=', '..')}=")
        except ConfigError as error:
            message = f"expected a setting such as `agent.radius`, got `{shorten(key)}` at {place}"
            raise ConfigError(message) from error
        for section in reversed(sections):
            value = {section: value}
        nested = merge(nested, value, place)

    def resolve(name: str) -> str:
        path = store.join(folder, name)
        return path if store.is_url(path) else os.path.abspath(path)

    return _with_files(nested, resolve)


def outlines_of(settings: Mapping[str, Any]) -> str | None:
    """Return the path of the file of room outlines in settings, None if there is none."""
    rooms = settings.get("rooms")
    name = rooms.get("polygons") if isinstance(rooms, Mapping) else None
    return name if isinstance(name, str) else None


def _read_mapping(path: str) -> Mapping[str, Any]:
    value = decode_yaml(store.read_file(path), store.shown(path))
    name = store.shown(path)
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ConfigError(f"expected a mapping of settings in {name}")
    return value


def _with_files(settings: Mapping[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """Settings with changed paths of their scene and files of room outlines, areas and links."""
    changed = dict(settings)
    for key in ("areas", "links"):
        if isinstance(changed.get(key), str):
            changed[key] = change(changed[key])
    for section, key in (("scene", "path"), ("rooms", "polygons")):
        inner = settings.get(section)
        if isinstance(inner, Mapping) and isinstance(inner.get(key), str):
            changed[section] = {**inner, key: change(inner[key])}
    return changed
