"""Lists scenes from paths, URLs, patterns and lists of scenes, and merges each scene's settings."""

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

from navbake import files, samples
from navbake.batch import store
from navbake.batch.products import PRODUCT_FILE_PATTERN
from navbake.config.field_types import find_unknown_key, show_value
from navbake.config.keywords import overlay_settings
from navbake.config.settings import (
    SECTIONS,
    YAML_SUFFIXES,
    BakeConfig,
    find_scene_path,
    is_settings,
    parse_config,
)
from navbake.errors import ConfigError, shorten
from navbake.formats.scene_files import SCENE_SUFFIXES
from navbake.formats.source import import_extra, unpack
from navbake.known_names import append_hint
from navbake.types import Json
from navbake.yaml_text import apply_overrides, decode_yaml, split_override_key

LIST_SUFFIXES = (".txt", ".csv", ".jsonl", ".parquet")
SCENE_KEYS = ("scene", "config")  # keys of which a row of a list has exactly one
TEXT_COLUMNS = ("id", *SCENE_KEYS)  # columns of a CSV whose values stay text, such as `001`
UNIQUE_SCENE_KEYS = ("path", "id")  # settings of the section `scene` that scenes can't share
LINE_END_PATTERN = re.compile(r"\r\n?|\n")
# characters that some file system forbids or drops, and names that begin with a dot
UNPORTABLE_PATTERN = re.compile(r'[\\:*?"<>|]|^[.\s]|[.\s]$')
RESERVED_NAME_PATTERN = re.compile(
    r"(?i)(con|prn|aux|nul|com\d|lpt\d|index\.(jsonl|parquet|html))(\..*)?"
    r"|index-\d+-of-\d+\.jsonl|shard-\d+\.tar"
)
NO_COLUMNS: Mapping[str, str] = MappingProxyType({})
MAX_ID_PART_LENGTH = 200  # longest part of an id between slashes [bytes]; file systems take 255
EXPECTED_SCENE_TEXT = "expected a scene, settings, a list or a pattern, got"


class Job(NamedTuple):
    """One scene that a batch bakes: where it is, and its own settings."""

    #: Unique in the batch; also the scene's folder in the output folder, maybe with slashes. Empty
    #: while `list_jobs` hasn't yet given it one.
    id: str
    source: str  #: The path or URL of the scene, or of its settings (YAML).
    settings: Json  #: The scene's own settings by section; they override those of the batch.
    place: str  #: Where the user named the scene, for messages: ``list.csv, line 3``.
    list_url: str = ""  #: The URL of the list that names the scene; empty if there is none.
    twin: str = ""  #: The id of an equal scene whose grid is copied; empty if the scene is baked.


def list_jobs(sources: Iterable[str], columns: Mapping[str, str] = NO_COLUMNS) -> list[Job]:
    """List the scenes that the sources of a batch name, in order.

    A source is one of these, as a path or as a URL that fsspec knows:

    - a scene, or settings (YAML);
    - a pattern with ``*``, ``?`` or ``[``; its files are sorted by name;
    - a list: ``.txt`` with a path in each line; or ``.csv``, ``.jsonl`` or ``.parquet`` with a row
      for each scene. All but Parquet may be compressed (``.gz``).

    Paths in a list are relative to the list's folder. A row has the path of the scene (``scene``)
    or of its settings (``config``). It may have ``id``, and settings by their keys, such as
    ``agent.radius``; in JSON lines and Parquet also as ``"settings": {"agent": {"radius": 0.3}}``.
    Empty values are ignored.

    The id of a row also becomes the grid's id, in place of the id in the scene's settings. Without
    it, a scene's id in the batch is the file's name without its ending, with as many parent folders
    as it takes to be unique.

    Args:
        sources: the sources.
        columns: for a list of another program: navbake's name of a column -> its name in the list.
            A dot leads into an object: ``files.mjcf``. Other columns of the list are ignored.

    Returns:
        A job for each scene.

    Raises:
        ConfigError: a source is empty, a list is broken, or ids are not unique. Scenes of a list
            and URLs aren't looked for: a missing one fails later, by itself.
        NavbakeError: a list can't be read, or a dependency for it is not installed.
    """
    listed_jobs = [
        job
        for source in sources
        for job in _list_scenes_of(store.strip_file_scheme(source), columns)
    ]
    if not listed_jobs:
        raise ConfigError("expected at least one scene, got none")
    for job in listed_jobs:
        if not files.can_be_path(job.source):
            raise ConfigError(
                f"expected a path, got {shorten(repr(job.source))} at {job.place}: no file can "
                "have that name",
                value=job.source,
                expected="a path",
                place=job.place,
            )
    jobs = []
    for scene_id, job in zip(_choose_ids(listed_jobs), listed_jobs, strict=True):
        check_id(scene_id, job.place)
        job_settings = (
            overlay_settings(job.settings, make_id_settings(scene_id), job.place)
            if job.id
            else job.settings
        )
        jobs.append(job._replace(id=scene_id, settings=job_settings))
    job_of_folded_id: dict[str, Job] = {}  # by the id as file systems compare it
    for job in jobs:
        earlier_job = job_of_folded_id.setdefault(fold_for_comparison(job.id), job)
        if earlier_job is job:
            continue
        if (earlier_job.id, earlier_job.source) == (job.id, job.source):
            raise ConfigError(
                f"expected each scene once, got {shorten(job.source)} at {earlier_job.place} and "
                f"at {job.place}: name it once, or give each an `id` of its own in a list"
            )
        first_text = f"{shorten(repr(earlier_job.id))} at {earlier_job.place}"
        second_text = f"{shorten(repr(job.id))} at {job.place}"
        raise ConfigError(
            f"expected unique ids, got {first_text} and {second_text}: give each an `id` of its own"
        )
    return jobs


def check_id(scene_id: str, place: str) -> None:
    r"""Check that an id can be a folder in the output folder on any operating system.

    Args:
        scene_id: the id; its parts are separated by slashes.
        place: where the scene is named, for errors.

    Raises:
        ConfigError: a part is empty (also in an absolute path); begins with a dot or a space; ends
            with one; is longer than `MAX_ID_PART_LENGTH`; has one of ``\:*?"<>|`` or an unprintable
            character; or is a name that Windows reserves or navbake writes.
    """
    for part in scene_id.split("/"):
        is_valid = part.isprintable() and 0 < len(part.encode()) <= MAX_ID_PART_LENGTH
        if not is_valid or UNPORTABLE_PATTERN.search(part) or RESERVED_NAME_PATTERN.fullmatch(part):
            expected_text = (
                "that can be the name of a folder on any system, or several between slashes"
            )
        elif PRODUCT_FILE_PATTERN.fullmatch(part.casefold()):
            expected_text = f"without names of files that navbake writes, as {part}"
        else:
            continue
        actual_text = f"got {shorten(repr(scene_id))} at {place}: give it another `id`"
        raise ConfigError(f"expected an id {expected_text}, {actual_text}")


def fold_for_comparison(name: str) -> str:
    """Fold a name so that names become equal if some file system takes them for the same.

    This is the canonical caseless matching of Unicode.
    """
    return unicodedata.normalize("NFD", unicodedata.normalize("NFD", name).casefold())


def _choose_ids(jobs: list[Job]) -> list[str]:
    """Return the id of each scene: the id that its job has, or else the end of its path.

    The end of a path has as many folders as it takes to differ from the other ids.
    """
    parts_of_paths = [_split_path(job.source) for job in jobs]
    num_parts_of_ids = [1] * len(jobs)  # how many parts of its path each id has
    while True:
        scene_ids = []
        for job, parts, num_parts in zip(jobs, parts_of_paths, num_parts_of_ids, strict=True):
            scene_ids.append(job.id or "/".join(parts[-num_parts:]))
        count_of_name = Counter(map(fold_for_comparison, scene_ids))
        is_final = True
        for job_index, (job, parts, scene_id) in enumerate(
            zip(jobs, parts_of_paths, scene_ids, strict=True)
        ):
            is_repeated = count_of_name[fold_for_comparison(scene_id)] > 1
            if not job.id and is_repeated and num_parts_of_ids[job_index] < len(parts):
                num_parts_of_ids[job_index] += 1
                is_final = False
        if is_final:
            return scene_ids


def _split_path(source: str) -> tuple[str, ...]:
    """Return the parts of a path or URL that an id may have: no root or host, and no ending."""
    if store.is_url(source):
        url_path = PurePosixPath(
            "/", store.without_secrets(source).partition("://")[2].rpartition("@")[2]
        )
        return url_path.with_suffix("").parts[1:] if url_path.name else ("",)
    return Path(os.path.splitext(os.path.abspath(source))[0]).parts[1:]


def _list_scenes_of(source: str, columns: Mapping[str, str]) -> Iterator[Job]:
    """Yield the scenes that a source names, see `list_jobs`."""
    shown_source = store.without_secrets(source)
    is_pattern = glob.has_magic(shown_source) and not os.path.exists(source)
    if not store.is_url(source) and not is_pattern and not os.path.exists(source):
        hint = files.hint_at_file(source, (*YAML_SUFFIXES, *SCENE_SUFFIXES, *LIST_SUFFIXES))
        sample_path = str(samples.find(source))
        if not hint and sample_path != source:
            hint = f"the settings of the sample are {sample_path}"
        message = append_hint(f"{EXPECTED_SCENE_TEXT} {source}: there is no such file", hint)
        raise ConfigError(message, hint=hint or None)
    if _list_ending(shown_source) in LIST_SUFFIXES:
        yield from _read_list(source, columns)
    elif source.endswith("/") or os.path.isdir(source):
        folder = shown_source.rstrip("/")
        pattern = _find_deeper_pattern(f"{folder}/*.xml") or f"{folder}/*.xml"
        raise ConfigError(
            f"{EXPECTED_SCENE_TEXT} the folder {folder}: name its files, as '{pattern}'"
        )
    elif is_pattern:
        if store.is_url(source):
            paths = store.match_files(source)
        else:
            # A folder is no scene. A broken link stays, so that its scene fails.
            matches = sorted(glob.glob(source, recursive=True))
            paths = [path for path in matches if os.path.isfile(path) or not os.path.exists(path)]
        if not paths:
            deeper_pattern = None if store.is_url(source) else _find_deeper_pattern(source)
            hint = f"; {deeper_pattern!r} matches some" if deeper_pattern else ""
            raise ConfigError(f"expected files that match {shown_source}, got none{hint}")
        for path in paths:
            yield Job("", path, {}, store.without_secrets(path))
    else:
        yield Job("", source, {}, shown_source)


def _find_deeper_pattern(pattern: str) -> str | None:
    """Return a pattern of the same files in all folders below; None if none matches, either."""
    folder, name = os.path.split(pattern)
    deeper_pattern = os.path.join(folder, "**", name)
    has_match = next(glob.iglob(deeper_pattern, recursive=True), None) is not None
    has_match_in_folder = next(glob.iglob(pattern), None) is not None
    return deeper_pattern if has_match and not has_match_in_folder else None


# ---------------------------------------------------------------- lists


def _list_ending(name: str) -> str:
    """Return the ending of a list's name in lower case, without ``.gz``."""
    return PurePosixPath(name.lower().removesuffix(".gz")).suffix


def _read_list(source: str, columns: Mapping[str, str]) -> list[Job]:
    """Read the scenes of a list; for `columns` see `list_jobs`."""
    list_name = store.without_secrets(source)
    reader_of_ending = {
        ".txt": _read_text_rows,
        ".csv": _read_csv_rows,
        ".jsonl": _read_json_rows,
        ".parquet": _read_parquet_rows,
    }
    content = store.read_file(source)
    content = unpack(content, list_name) if list_name.lower().endswith(".gz") else content
    read_rows = reader_of_ending[_list_ending(list_name)]
    list_url = source if store.is_url(source) else ""
    jobs = []
    for place, row in read_rows(content, list_name, {*SCENE_KEYS, *columns.values()}):
        job = _make_job(_select_columns(row, columns, place), store.parent(source), place)
        jobs.append(job._replace(list_url=list_url))
    if not jobs:
        raise ConfigError(f"expected at least one scene in {list_name}, got none")
    return jobs


def _select_columns(row: Json, columns: Mapping[str, str], place: str) -> Json:
    """Return a row of another program's list under navbake's keys.

    Args:
        row: the row, by the list's names of columns.
        columns: see `list_jobs`; if empty, the row is returned as it is.
        place: the place of the row, for errors.

    Raises:
        ConfigError: the row lacks the column with the scene.
    """
    value_of_key: Json = {}
    for key, column in columns.items():
        value: object = row.get(column)
        if column not in row:
            value = row
            for field_name in column.split("."):
                value = value.get(field_name) if isinstance(value, Mapping) else None
        if value is None and key in SCENE_KEYS:
            column_names = ", ".join(map(repr, row))
            raise ConfigError(
                f"expected a column {column!r} at {place}, got {shorten(column_names)}"
            )
        value_of_key[key] = value
    return value_of_key if columns else row


def _make_job(row: Json, folder: store.Folder, place: str) -> Job:
    """Return the scene of a row of a list.

    Args:
        row: the row, by navbake's keys.
        folder: the list's folder; paths in the row are relative to it.
        place: the place of the row, for messages.

    Raises:
        ConfigError: the row names no scene or several, or has a wrong id or an unknown setting.
    """
    row = _without_empty_values(row)
    scene_sources = [row.pop(key) for key in SCENE_KEYS if key in row]
    if len(scene_sources) != 1 or not isinstance(scene_sources[0], str):
        hint = (
            "; --column scene=NAME names the column that has it"
            if not scene_sources and row
            else ""
        )
        if {"rooms", "walls", "objects"} <= row.keys():  # it lacks the shapes of its objects
            hint = "; a house of ProcTHOR only names the assets in it: list an MJCF of it"
        raise ConfigError(f"expected a path as `scene` or as `config` at {place}{hint}")
    scene_id = row.pop("id", None)
    nested_settings = row.pop("settings", {})
    if not isinstance(nested_settings, dict):
        raise ConfigError(
            f"expected an object as `settings` at {place}, got {show_value(nested_settings)}"
        )
    if isinstance(scene_id, bool) or not isinstance(scene_id, str | int | None):
        actual_text = show_value(scene_id)
        raise ConfigError(f"expected text or a whole number as `id` at {place}, got {actual_text}")
    settings = nest_settings([*nested_settings.items(), *row.items()], folder, place)
    check_selects_no_scene(settings, place)
    for key in settings.keys() - BakeConfig.model_fields:
        expected_text = "`id`, `scene`, `config` or a setting such as `agent.radius`"
        remedy = "`--column scene=scene --column id=id` names those that count, others are ignored"
        raise ConfigError(f"expected {expected_text}, got `{shorten(key)}` at {place}: {remedy}")
    unknown_key = find_unknown_key(settings, SECTIONS)
    if unknown_key is not None:
        raise ConfigError(f"{unknown_key} at {place}")
    return Job(
        "" if scene_id is None else str(scene_id),
        store.join(folder, scene_sources[0]),
        settings,
        place,
    )


def _without_empty_values(row: Mapping[str, Any]) -> Json:
    """Return a row, and the objects in it, without None, NaN, empty texts and empty objects."""
    nonempty_values = {}
    for key, value in row.items():
        nonempty_value = _without_empty_values(value) if isinstance(value, Mapping) else value
        is_nan = nonempty_value != nonempty_value
        if nonempty_value not in (None, "", {}) and not is_nan:
            nonempty_values[key] = nonempty_value
    return nonempty_values


Rows: TypeAlias = Iterator[tuple[str, Json]]
"""The rows of a list. Each is a pair: its place, such as ``list.csv, line 3``, and its values."""


def _split_lines(content: bytes, list_name: str) -> list[str]:
    """Decode a list and split it into lines; `list_name` is the list's name, for errors."""
    try:
        return LINE_END_PATTERN.split(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        line_number = 1 + len(LINE_END_PATTERN.findall(error.object[: error.start].decode()))
        raise ConfigError(
            f"expected UTF-8 in {list_name}, line {line_number}: {error.reason}"
        ) from error


def _read_text_rows(content: bytes, list_name: str, scene_columns: set[str]) -> Rows:
    for line_number, line in enumerate(_split_lines(content, list_name), 1):
        if line.strip() and not line.strip().startswith("#"):
            yield f"{list_name}, line {line_number}", {"scene": line.strip()}


def _read_json_rows(content: bytes, list_name: str, scene_columns: set[str]) -> Rows:
    for line_number, line in enumerate(_split_lines(content, list_name), 1):
        place = f"{list_name}, line {line_number}"
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"broken JSON at {place}: {error}") from error
        if not isinstance(row, dict):
            raise ConfigError(f"expected an object at {place}, got {show_value(row)}")
        yield place, row


def _read_csv_rows(content: bytes, list_name: str, scene_columns: set[str]) -> Rows:
    """Read the rows of a CSV; the place of a row that spans several lines is its first line.

    Args:
        content: the file's content.
        list_name: the file's name, for errors.
        scene_columns: names of columns that may have the scene.

    Raises:
        ConfigError: the file is broken, or has none of `scene_columns`.
    """
    text_lines = (f"{line}\n" for line in _split_lines(content, list_name))
    csv_rows = csv.reader(text_lines, strict=True, skipinitialspace=True)
    columns: list[str] = []
    place = f"{list_name}, line 1"
    try:
        for values in csv_rows:
            if values and not columns:
                columns = values
                if not {*columns} & scene_columns:
                    expected_text = "expected names of columns, `scene` or `config` among them"
                    got_text = show_value(",".join(columns))
                    raise ConfigError(f"{expected_text}, got {got_text} at {place}")
            elif len(values) > len(columns):
                expected_text = f"expected as many values as columns at {place}: {len(columns)}"
                got_text = show_value(",".join(values))
                raise ConfigError(f"{expected_text}, got {len(values)}: {got_text}")
            elif values:
                row: Json = {}
                for key, text_value in zip(columns, values, strict=False):
                    if text_value:
                        row[key] = text_value if key in TEXT_COLUMNS else _parse_cell(text_value)
                yield place, row
            place = f"{list_name}, line {csv_rows.line_num + 1}"
    except csv.Error as error:
        raise ConfigError(f"broken CSV at {place}: {error}") from error


def _parse_cell(text: str) -> Any:
    """Return the value of a cell of a CSV: what it is in JSON, or else the text itself."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def _read_parquet_rows(content: bytes, file_name: str, scene_columns: set[str]) -> Rows:
    parquet = import_extra("pyarrow.parquet", "batch", "Parquet")
    try:
        rows = parquet.read_table(io.BytesIO(content)).to_pylist()
    except Exception as error:  # pyarrow raises many types
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ConfigError(f"broken Parquet in {file_name}: {reason}") from error
    for row_number, row in enumerate(rows, 1):
        # a column that pandas adds
        row_without_index = {
            key: value for key, value in row.items() if not key.startswith("__index_level_")
        }
        yield f"{file_name}, row {row_number}", row_without_index


# ---------------------------------------------------------------- settings


def read_shared_settings(path: str | os.PathLike[str]) -> Json:
    """Read the settings that all scenes share from a YAML file; its path may be a URL.

    Raises a NavbakeError if the file can't be read. Raises a ConfigError if it is broken, is no
    mapping, or selects a scene.
    """
    plain_path = store.strip_file_scheme(os.fspath(path))
    settings = nest_settings(
        _read_mapping(plain_path).items(),
        store.parent(plain_path),
        store.without_secrets(plain_path),
    )
    check_selects_no_scene(settings, store.without_secrets(plain_path))
    return settings


def check_selects_no_scene(settings: Mapping[str, Any], place: str) -> None:
    """Check that settings select no scene.

    Args:
        settings: the settings by section.
        place: where the settings are from, for the error.

    Raises:
        ConfigError: the settings have ``scene.path`` or ``scene.id``, or `scene` is no mapping.
    """
    scene_settings = {} if settings.get("scene") is None else settings["scene"]
    hint = "the batch's sources name the scenes"
    if not isinstance(scene_settings, Mapping):
        got_text = f"got {show_value(scene_settings)}: {hint}"
        raise ConfigError(f"expected settings as `scene` in {place}, {got_text}")
    for key in UNIQUE_SCENE_KEYS:
        if key in scene_settings:
            raise ConfigError(f"expected no `scene.{key}` in {place}: {hint}")


def check_settings(sources: Iterable[str], shared_settings: Json, overrides: Sequence[str]) -> None:
    """Check the shared settings and the overrides before any scene is baked.

    A file of room outlines must exist. It isn't checked if it is on a store, or if its path is
    relative and a source is a YAML file, because then it may be relative to that file.

    Args:
        sources: the paths of the scenes, or of their settings.
        shared_settings: the settings that all scenes share.
        overrides: settings as ``a.b=value``.

    Raises:
        ConfigError: a setting is wrong, or selects a scene.
    """
    for override in overrides:
        key_parts = split_override_key(override)
        if key_parts[0] == "scene" and (len(key_parts) == 1 or key_parts[1] in UNIQUE_SCENE_KEYS):
            raise ConfigError(f"expected no --set {override}: the batch's sources name the scenes")
    outlines_path = find_room_outlines_path(apply_overrides(shared_settings, overrides))
    is_relative = (
        outlines_path and not os.path.isabs(outlines_path) and any(map(is_settings, sources))
    )
    if is_relative or store.is_url(outlines_path):
        overrides = [*overrides, "rooms.polygons=[]"]
    merge_settings(Job("scene", "scene.xml", {}, "the batch"), shared_settings, overrides)


def merge_settings(
    job: Job,
    shared_settings: Json,
    overrides: Sequence[str],
    fetch: Callable[[str], Path] = Path,
) -> BakeConfig:
    """Merge the settings of a scene.

    They come from the batch's shared settings, the scene's YAML file, the scene's row in a list,
    and the overrides. Settings that come later in this order replace earlier ones. Paths in the
    YAML file and in overrides are relative to the YAML file's folder.

    Args:
        job: the scene.
        shared_settings: the settings that all scenes share.
        overrides: settings as ``a.b=value``.
        fetch: returns the local path of a file; it copies a file that is on a store.

    Returns:
        The settings, with local paths.

    Raises:
        ConfigError: a setting is wrong.
    """
    place = f"the settings of {job.place}"
    scene_settings: Mapping[str, Any] = {"scene": {"path": job.source}}
    outlines_path = find_room_outlines_path(apply_overrides({}, overrides))
    if is_settings(job.source):
        folder = store.parent(job.source)
        scene_settings = _replace_paths(
            _read_mapping(job.source), lambda name: store.join(folder, name)
        )
        outlines_path = outlines_path and store.join(folder, outlines_path)
    settings = dict(make_id_settings(job.id))
    for overriding_settings in (shared_settings, scene_settings, job.settings):
        settings = overlay_settings(settings, overriding_settings, place)
    is_path_of_file = is_settings(job.source) and (
        find_scene_path(settings) == find_scene_path(scene_settings)
    )
    settings = _replace_paths(settings, lambda name: str(fetch(name)))
    if outlines_path:  # quoted as in JSON, any path is valid YAML
        quoted_path = json.dumps(str(fetch(outlines_path)), ensure_ascii=False)
        overrides = [*overrides, f"rooms.polygons={quoted_path}"]
    settings_file = job.source if is_path_of_file else ""
    return parse_config(settings, place, overrides, settings_file=settings_file)


def make_id_settings(scene_id: str) -> Json:
    """Return settings whose `scene.id` is a scene's id, with ``_`` in place of slashes."""
    return {"scene": {"id": scene_id.replace("/", "_")}}


def nest_settings(
    settings: Iterable[tuple[str, Any]], folder: store.Folder, place: str
) -> dict[str, Any]:
    """Nest settings with keys such as ``agent.radius`` into sections.

    Args:
        settings: pairs of a key and a value.
        folder: the folder that relative paths in the settings are joined to.
        place: where the settings are from, for errors.

    Raises:
        ConfigError: a key is no valid key, or continues below a key that has a value.
    """
    nested_settings: dict[str, Any] = {}
    for key, value in settings:
        try:
            key_parts = split_override_key(f"{key.replace('=', '..')}=")
        except ConfigError as error:
            message = f"expected a setting such as `agent.radius`, got `{shorten(key)}` at {place}"
            raise ConfigError(message) from error
        for section in reversed(key_parts):
            value = {section: value}
        nested_settings = overlay_settings(nested_settings, value, place)

    def resolve_path(name: str) -> str:
        path = store.join(folder, name)
        return path if store.is_url(path) else os.path.abspath(path)

    return _replace_paths(nested_settings, resolve_path)


def find_room_outlines_path(settings: Mapping[str, Any]) -> str | None:
    """Return the path of the file of room outlines (`rooms.polygons`); None if it isn't a path."""
    room_settings = settings.get("rooms")
    outlines_path = room_settings.get("polygons") if isinstance(room_settings, Mapping) else None
    return outlines_path if isinstance(outlines_path, str) else None


def _read_mapping(path: str) -> Mapping[str, Any]:
    """Read settings from a YAML file; {} if it is empty."""
    yaml_content = decode_yaml(store.read_file(path), store.without_secrets(path))
    shown_path = store.without_secrets(path)
    if yaml_content is None:
        return {}
    if not isinstance(yaml_content, Mapping) or not all(
        isinstance(key, str) for key in yaml_content
    ):
        raise ConfigError(f"expected a mapping of settings in {shown_path}")
    return yaml_content


def _replace_paths(
    settings: Mapping[str, Any], change_path: Callable[[str], str]
) -> dict[str, Any]:
    """Return settings in which `change_path` has replaced each path.

    Paths are those of the scene and of files with room outlines, areas and links.
    """
    changed_settings = dict(settings)
    for key in ("areas", "links"):
        if isinstance(changed_settings.get(key), str):
            changed_settings[key] = change_path(changed_settings[key])
    for section, key in (("scene", "path"), ("rooms", "polygons")):
        section_settings = settings.get(section)
        if isinstance(section_settings, Mapping) and isinstance(section_settings.get(key), str):
            changed_settings[section] = {
                **section_settings,
                key: change_path(section_settings[key]),
            }
    return changed_settings
