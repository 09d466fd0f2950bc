"""Reads and writes sets of episodes in files, in navbake's own two formats and in others.

JSON lines (``.jsonl``, ``.jsonl.gz``), UTF-8, have the header in the first line, then one episode
per line. Parquet (``.parquet``) has one row per episode: columns to sort and filter by, and the
whole episode as JSON in ``episode``; the header is the schema's metadata ``navbake``. Equal sets
give equal bytes.
"""

from __future__ import annotations

import bz2
import csv
import gzip
import io
import os
import re
from collections.abc import Callable, Iterable, Mapping
from functools import partial

import msgspec

from navbake.episodes.episode import FORMAT, TASKS, VERSION, Episode, EpisodeSet, Header
from navbake.episodes.formats import SIMULATOR_FORMATS, ParsedSet, SetFormat, decode
from navbake.errors import FormatError
from navbake.formats.allowance import Allowance, JsonPath
from navbake.formats.source import format_path, import_extra, read_bytes, unpack, write_bytes
from navbake.known_names import suggest

SCENE_FIELD = "{id}"  # in a name of scenes: stands for the id of each
TRAJECTORY_LINE = re.compile(rb'\s*\{\s*"(episode|positions)"\s*:')  # see `read_trajectories`
METADATA_KEY = b"navbake"  # key of a Parquet file's metadata that has the header
TEXT_COLUMNS = ("id", "scene", "task", "split", "room")  # in a Parquet file, besides ``episode``
NUMBER_COLUMNS = ("heading", "distance", "straight", "ratio")
COMPRESSORS: dict[str, Callable[[bytes], bytes]] = {
    ".gz": partial(gzip.compress, compresslevel=6, mtime=0),
    ".bz2": bz2.compress,
}


def read_episodes(
    path: str | os.PathLike[str], scenes: Mapping[str, str] | None = None
) -> EpisodeSet:
    """Read a set of episodes in any format, which is found by the file's ending and content.

    Args:
        path: the path of the file, plain or packed.
        scenes: for a file of another program: navbake's id of a scene -> its name in the file. The
            id ``{id}`` stands for all others: its name has ``{id}`` in it, as ``data/{id}.glb``.

    Returns:
        The set.

    Raises:
        FormatError: the file can't be read, or has no set; the message names file, line and field.
            Or a name with ``{id}`` fits no scene of the file.
        MissingDependencyError: the file is Parquet, and pyarrow is not installed.
    """
    packed_content, name = read_bytes(path)
    text = unpack(packed_content, name)
    ending, _ = _split_endings(path)
    set_format = _find_format(text, ending)
    try:
        header, episodes = set_format.read(text, name)
        episode_set = EpisodeSet(header, msgspec.convert(episodes, tuple[Episode, ...]))
    except (msgspec.ValidationError, csv.Error, ValueError, TypeError) as error:
        raise FormatError(f"{error} in {name}") from error
    if set_format in NAVBAKE_FORMATS.values() or scenes is None:
        return episode_set
    names = {episode.scene for episode in episode_set.episodes}
    scene_of_name = {foreign_name: scene for scene, foreign_name in scenes.items()}
    scene_of_name |= _match_template(scenes, names - scene_of_name.keys(), name)
    return _rename_scenes(episode_set, scene_of_name)


def _find_format(text: bytes, ending: str) -> SetFormat:
    """Return the format of a file with this content and ending; JSON lines if no other fits."""
    if ending == ".json" and text.lstrip()[:1] == b"[":
        return EPISODE_FORMATS["molmospaces"]
    fitting_formats = [
        set_format for set_format in EPISODE_FORMATS.values() if set_format.ending == ending
    ]
    return fitting_formats[0] if fitting_formats else EPISODE_FORMATS["jsonl"]


def write_episodes(
    content: EpisodeSet,
    path: str | os.PathLike[str],
    form: str | None = None,
    scenes: Mapping[str, str] | None = None,
) -> list[str]:
    """Write a set of episodes to a file; equal sets give equal bytes.

    Args:
        content: the set.
        path: the path of the file; the endings ``.gz`` and ``.bz2`` pack it.
        form: a name of `EPISODE_FORMATS`; if None, the first that fits the ending and the tasks.
        scenes: for a file of another program: navbake's id of a scene -> its name in the file; see
            `read_episodes`.

    Returns:
        The names of the fields that some episode has, but that the file can't hold.

    Raises:
        FormatError: no format has such an ending, or the format can't hold the set.
    """
    format_name = _choose_format(content, path, form)
    set_format = EPISODE_FORMATS[format_name]
    _, packing_ending = _split_endings(path)
    is_navbake_format = format_name in NAVBAKE_FORMATS
    written_set = content
    if not is_navbake_format and scenes:
        template = scenes.get(SCENE_FIELD, SCENE_FIELD)
        names = {episode.scene for episode in content.episodes}
        name_of_scene = {name: template.replace(SCENE_FIELD, name) for name in names}
        written_set = _rename_scenes(content, name_of_scene | dict(scenes))
    compress = COMPRESSORS.get(packing_ending, bytes)
    write_bytes(compress(set_format.encode(written_set, format_name)), path)
    if is_navbake_format:
        return []
    return _list_lost_fields(content, read_episodes(path, scenes))


def _choose_format(episode_set: EpisodeSet, path: str | os.PathLike[str], form: str | None) -> str:
    """Return the name of the format to write: `form`, or the first that fits ending and tasks."""
    if form is not None and form not in EPISODE_FORMATS:
        raise FormatError(f"no format {form!r}: {suggest(form, EPISODE_FORMATS)}")
    format_names = [form] if form else list(EPISODE_FORMATS)
    ending, _ = _split_endings(path)
    fitting_names = [name for name in format_names if EPISODE_FORMATS[name].ending == ending]
    if not fitting_names:
        endings_text = ", ".join(
            dict.fromkeys(EPISODE_FORMATS[name].ending for name in format_names)
        )
        raise FormatError(f"expected a name that ends in {endings_text}, got {format_path(path)}")
    episode_id_of_task = {episode.task: episode.id for episode in reversed(episode_set.episodes)}
    for name in fitting_names:
        if episode_id_of_task.keys() <= {*EPISODE_FORMATS[name].tasks}:
            return name
    task = next(
        task for task in episode_id_of_task if task not in EPISODE_FORMATS[fitting_names[0]].tasks
    )
    formats_text = " or ".join(fitting_names)
    raise FormatError(
        f"no task {task!r} in {formats_text}, as of episode {episode_id_of_task[task]!r}"
    )


def _list_lost_fields(episode_set: EpisodeSet, reread_set: EpisodeSet) -> list[str]:
    """List the fields that an episode of a set has, but that it lacks when read again."""
    lost_field_names: set[str] = set()
    if episode_set.header.agent and not reread_set.header.agent:
        lost_field_names.add("agent")
    for episode_before, episode_after in zip(
        episode_set.episodes, reread_set.episodes, strict=True
    ):
        record_pairs = [
            (episode_before, episode_after),
            *zip(episode_before.goals, episode_after.goals, strict=False),
        ]
        for record_before, record_after in record_pairs:
            lost_field_names.update(
                name
                for name in record_before.__struct_fields__
                if getattr(record_before, name) and not getattr(record_after, name)
            )
        if len(episode_before.goals) > len(episode_after.goals):
            lost_field_names.add("further goals")
    return sorted(lost_field_names)


def _split_endings(path: str | os.PathLike[str]) -> tuple[str, str]:
    """Return the ending that tells a file's format, and the one that tells its packing or ""."""
    stem, last_ending = os.path.splitext(os.fspath(path).lower())
    if last_ending not in COMPRESSORS:
        return last_ending, ""
    return os.path.splitext(stem)[1], last_ending


def _rename_scenes(episode_set: EpisodeSet, new_name_of_scene: Mapping[str, str]) -> EpisodeSet:
    """Return a set with scenes renamed; `new_name_of_scene` has old name -> new name."""
    if not new_name_of_scene:
        return episode_set
    renamed_episodes = [
        msgspec.structs.replace(episode, scene=new_name_of_scene.get(episode.scene, episode.scene))
        for episode in episode_set.episodes
    ]
    return EpisodeSet(episode_set.header, tuple(renamed_episodes))


def _match_template(
    scenes: Mapping[str, str], foreign_names: Iterable[str], file_name: str
) -> dict[str, str]:
    """Find the ids of scenes whose names in a file fit the name with ``{id}``.

    Args:
        scenes: navbake's id of a scene -> its name in the file, see `read_episodes`.
        foreign_names: names of scenes in the file.
        file_name: the file's name, for the error.

    Returns:
        Name of a scene in the file -> its id; empty without a name with ``{id}``.

    Raises:
        FormatError: no scene of the file fits.
    """
    template = scenes.get(SCENE_FIELD)
    if template is None:
        return {}
    before, _, after = template.partition(SCENE_FIELD)
    pattern = re.compile(f"{re.escape(before)}(.+?){re.escape(after)}")
    matches = {name: pattern.fullmatch(name) for name in foreign_names}
    scene_of_name = {name: match[1] for name, match in matches.items() if match}
    if matches and not scene_of_name:
        example = min(matches)
        raise FormatError(f"no scene of {file_name} is called as {template}: one is {example!r}")
    return scene_of_name


def encode_lines(episode_set: EpisodeSet, _: str) -> bytes:
    """Encode a set as JSON lines; the second argument, the format's name, is not used."""
    json_lines = [
        msgspec.json.encode(record) for record in (episode_set.header, *episode_set.episodes)
    ]
    return b"\n".join([*json_lines, b""])


def read_lines(text: bytes, name: str) -> ParsedSet:
    """Read the header and the episodes of a set from JSON lines; errors name the line."""
    lines = text.splitlines()
    if lines and TRAJECTORY_LINE.match(lines[0]):
        problem = f"{name} has trajectories, not episodes"
        raise FormatError(f"{problem}: the set comes first, navbake score SET TRAJECTORIES")
    header = decode(lines[0] if lines else b"", Header, f"{name}, line 1")
    if header.format != FORMAT or header.version > VERSION:
        actual_format = f"{header.format!r} of version {header.version}"
        raise FormatError(
            f"expected {FORMAT!r} up to version {VERSION}, got {actual_format} in {name}"
        )
    episodes = [
        decode(line, Episode, f"{name}, line {line_number}")
        for line_number, line in enumerate(lines[1:], start=2)
    ]
    return header, episodes


def encode_parquet(episode_set: EpisodeSet, _: str) -> bytes:
    """Encode a set as Parquet; the second argument, the format's name, is not used."""
    pyarrow = import_extra("pyarrow", "batch")
    parquet = import_extra("pyarrow.parquet", "batch")
    episodes = episode_set.episodes
    columns: dict[str, list[object]] = {
        name: [getattr(episode, name) for episode in episodes]
        for name in (*TEXT_COLUMNS, *NUMBER_COLUMNS)
    }
    for axis, name in enumerate("xyz"):
        columns[name] = [episode.start[axis] for episode in episodes]
    columns["episode"] = [msgspec.json.encode(episode).decode() for episode in episodes]
    text_names = {*TEXT_COLUMNS, "episode"}
    column_types = {name: "string" if name in text_names else "float64" for name in columns}
    metadata = {METADATA_KEY: msgspec.json.encode(episode_set.header)}
    table = pyarrow.table(columns, schema=pyarrow.schema(column_types, metadata=metadata))
    file = io.BytesIO()
    parquet.write_table(table, file, compression="zstd")
    return file.getvalue()


def read_parquet(content: bytes, name: str) -> ParsedSet:
    """Read the header and the episodes of a set from Parquet; errors name the row."""
    pyarrow = import_extra("pyarrow", "batch")
    parquet = import_extra("pyarrow.parquet", "batch")
    try:
        file = parquet.ParquetFile(io.BytesIO(content))
        row_groups = (
            file.metadata.row_group(group_number) for group_number in range(file.num_row_groups)
        )
        num_text_bytes = file.metadata.num_rows + sum(
            row_group.total_byte_size for row_group in row_groups
        )
        Allowance(len(content), "max_cells").take_text(num_text_bytes, JsonPath(name))
        header = file.schema_arrow.metadata[METADATA_KEY]
        episode_texts = file.read(["episode"]).column("episode").to_pylist()
    except (pyarrow.ArrowException, KeyError, TypeError, ValueError, OSError) as error:
        raise FormatError(f"expected a set of episodes as Parquet in {name}") from error
    episodes = [
        decode(text or "", Episode, f"{name}, row {row}") for row, text in enumerate(episode_texts)
    ]
    return decode(header, Header, name), episodes


NAVBAKE_FORMATS = {
    "jsonl": SetFormat(".jsonl", TASKS, encode_lines, read_lines),
    "parquet": SetFormat(".parquet", TASKS, encode_parquet, read_parquet),
}
EPISODE_FORMATS = NAVBAKE_FORMATS | SIMULATOR_FORMATS
"""Name -> format of sets: navbake's own first, then those of other programs."""
