"""Sets of episodes in files: which format a file has, and navbake's own two.

JSON lines (``.jsonl``, ``.jsonl.gz``): the header, then an episode a line, UTF-8. Parquet
(``.parquet``): a row an episode, with columns to sort and filter by and all of it in ``episode``
as JSON; the header is the schema's metadata ``navbake``. The same set gives the same bytes.
"""

from __future__ import annotations

import bz2
import csv
import gzip
import io
import os
from collections.abc import Callable, Mapping
from functools import partial

import msgspec

from navbake.episodes.episode import FORMAT, TASKS, VERSION, Episode, EpisodeSet, Header
from navbake.episodes.formats import SIMULATOR_FORMATS, Fields, SetFormat, decode
from navbake.errors import FormatError
from navbake.formats.allowance import Allowance, JsonPath
from navbake.formats.source import format_path, import_extra, read_bytes, unpack, write_bytes
from navbake.known_names import suggest

NAME = b"navbake"  # of the header in a Parquet file's metadata
TEXTS = ("id", "scene", "task", "split", "room")  # fields with a column of their own there
NUMBERS = ("heading", "distance", "straight", "ratio")
PACKERS: dict[str, Callable[[bytes], bytes]] = {
    ".gz": partial(gzip.compress, compresslevel=6, mtime=0),
    ".bz2": bz2.compress,
}


def read_episodes(
    path: str | os.PathLike[str], scenes: Mapping[str, str] | None = None
) -> EpisodeSet:
    """Read a set in any format, which the ending and the content tell.

    Args:
        path: of the file, plain or packed.
        scenes: what another program calls scenes, by their ids here.

    Raises:
        FormatError: the file can't be read, or holds no set; file, line and field are named.
        MissingDependencyError: it is Parquet, and pyarrow is missing.
    """
    packed, name = read_bytes(path)
    text = unpack(packed, name)
    ending, _ = _endings(path)
    is_list = ending == ".json" and text.lstrip()[:1] == b"["
    fitting = [one for one in EPISODE_FORMATS.values() if one.ending == ending] or [
        EPISODE_FORMATS["jsonl"]
    ]
    chosen = EPISODE_FORMATS["molmospaces"] if is_list else fitting[0]
    try:
        header, episodes = chosen.read(text, name)
        content = EpisodeSet(header, msgspec.convert(episodes, tuple[Episode, ...]))
    except (msgspec.ValidationError, csv.Error, ValueError, TypeError) as error:
        raise FormatError(f"{error} in {name}") from error
    there = {} if chosen in NAVBAKE_FORMATS.values() else scenes or {}
    return _rename(content, {name: here for here, name in there.items()})


def write_episodes(
    content: EpisodeSet,
    path: str | os.PathLike[str],
    form: str | None = None,
    scenes: Mapping[str, str] | None = None,
) -> list[str]:
    """Write a set; the same set gives the same bytes.

    Args:
        content: the set.
        path: of the file; ``.gz`` and ``.bz2`` pack it.
        form: one of `EPISODE_FORMATS`; the first that fits the ending and the tasks unless given.
        scenes: what another program calls scenes, by their ids here.

    Returns:
        The fields that some episode has and the file doesn't hold.

    Raises:
        FormatError: no format has such an ending, or it can't hold the set.
    """
    if form is not None and form not in EPISODE_FORMATS:
        raise FormatError(f"no format {form!r}: {suggest(form, EPISODE_FORMATS)}")
    known = [form] if form else list(EPISODE_FORMATS)
    ending, packing = _endings(path)
    fitting = [name for name in known if EPISODE_FORMATS[name].ending == ending]
    if not fitting:
        endings = ", ".join(dict.fromkeys(EPISODE_FORMATS[name].ending for name in known))
        raise FormatError(f"expected a name that ends in {endings}, got {format_path(path)}")
    tasks = {e.task: e.id for e in reversed(content.episodes)}
    chosen = next(
        (name for name in fitting if tasks.keys() <= {*EPISODE_FORMATS[name].tasks}), None
    )
    if chosen is None:
        task = next(task for task in tasks if task not in EPISODE_FORMATS[fitting[0]].tasks)
        names = " or ".join(fitting)
        raise FormatError(f"no task {task!r} in {names}, as of episode {tasks[task]!r}")
    written = content if chosen in NAVBAKE_FORMATS else _rename(content, scenes or {})
    write_bytes(PACKERS.get(packing, bytes)(EPISODE_FORMATS[chosen].encode(written, chosen)), path)
    if chosen in NAVBAKE_FORMATS:
        return []
    again = read_episodes(path, scenes)
    lost = {"agent"} if content.header.agent and not again.header.agent else set()
    for before, after in zip(content.episodes, again.episodes, strict=True):
        pairs = [(before, after), *zip(before.goals, after.goals, strict=False)]
        lost |= {
            k for a, b in pairs for k in a.__struct_fields__ if getattr(a, k) and not getattr(b, k)
        }
        lost |= {"further goals"} if len(before.goals) > len(after.goals) else set()
    return sorted(lost)


def _endings(path: str | os.PathLike[str]) -> tuple[str, str]:
    """The ending of a file's name that tells its format, and the one that tells its packing."""
    stem, packing = os.path.splitext(os.fspath(path).lower())
    return (os.path.splitext(stem)[1], packing) if packing in PACKERS else (packing, "")


def _rename(content: EpisodeSet, names: Mapping[str, str]) -> EpisodeSet:
    """The set with other names of scenes in its episodes."""
    renamed = (
        msgspec.structs.replace(e, scene=names.get(e.scene, e.scene)) for e in content.episodes
    )
    return EpisodeSet(content.header, tuple(renamed)) if names else content


def encode_lines(content: EpisodeSet, _: str) -> bytes:
    lines = [msgspec.json.encode(part) for part in (content.header, *content.episodes)]
    return b"\n".join([*lines, b""])


def read_lines(text: bytes, name: str) -> Fields:
    lines = text.splitlines()
    header = decode(lines[0] if lines else b"", Header, f"{name}, line 1")
    if header.format != FORMAT or header.version > VERSION:
        got = f"{header.format!r} of version {header.version}"
        raise FormatError(f"expected {FORMAT!r} up to version {VERSION}, got {got} in {name}")
    numbered = enumerate(lines[1:], start=2)
    return header, [decode(line, Episode, f"{name}, line {number}") for number, line in numbered]


def encode_parquet(content: EpisodeSet, _: str) -> bytes:
    pyarrow = import_extra("pyarrow", "batch")
    parquet = import_extra("pyarrow.parquet", "batch")
    episodes = content.episodes
    columns = {name: [getattr(e, name) for e in episodes] for name in (*TEXTS, *NUMBERS)}
    columns |= {axis: [e.start[k] for e in episodes] for k, axis in enumerate("xyz")}
    columns["episode"] = [msgspec.json.encode(e).decode() for e in episodes]
    kinds = {name: "string" if name in (*TEXTS, "episode") else "float64" for name in columns}
    schema = pyarrow.schema(kinds, metadata={NAME: msgspec.json.encode(content.header)})
    file = io.BytesIO()
    parquet.write_table(pyarrow.table(columns, schema=schema), file, compression="zstd")
    return file.getvalue()


def read_parquet(data: bytes, name: str) -> Fields:
    pyarrow = import_extra("pyarrow", "batch")
    parquet = import_extra("pyarrow.parquet", "batch")
    try:
        file = parquet.ParquetFile(io.BytesIO(data))
        groups = (file.metadata.row_group(k) for k in range(file.num_row_groups))
        size = file.metadata.num_rows + sum(group.total_byte_size for group in groups)
        Allowance(len(data), "max_cells").take_text(size, JsonPath(name))
        header = file.schema_arrow.metadata[NAME]
        texts = file.read(["episode"]).column("episode").to_pylist()
    except (pyarrow.ArrowException, KeyError, TypeError, ValueError, OSError) as error:
        raise FormatError(f"expected a set of episodes as Parquet in {name}") from error
    episodes = [decode(text or "", Episode, f"{name}, row {row}") for row, text in enumerate(texts)]
    return decode(header, Header, name), episodes


NAVBAKE_FORMATS = {
    "jsonl": SetFormat(".jsonl", TASKS, encode_lines, read_lines),
    "parquet": SetFormat(".parquet", TASKS, encode_parquet, read_parquet),
}
EPISODE_FORMATS = NAVBAKE_FORMATS | SIMULATOR_FORMATS
"""Formats of sets by their names; other programs' after navbake's own."""
