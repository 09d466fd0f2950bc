"""Sets of episodes in files: which format a file has, and navbake's own two.

JSON lines (``.jsonl``, ``.jsonl.gz``): the header, then an episode a line, UTF-8. Parquet
(``.parquet``): a row an episode, with columns to sort and filter by and all of it in ``episode``
as JSON; the header is the schema's metadata ``navbake``. The same set gives the same bytes.
"""

from __future__ import annotations

import bz2
import gzip
import io
import os
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import msgspec

from navbake.episodes.episode import FORMAT, TASKS, VERSION, Episode, EpisodeSet, Header
from navbake.episodes.formats import (
    decode,
    encode_habitat,
    encode_minos,
    encode_molmospaces,
    make_set,
    read_habitat,
    read_minos,
    read_molmospaces,
)
from navbake.errors import FormatError, MissingDependencyError
from navbake.formats.allowance import Allowance, JsonPath
from navbake.formats.source import path_name, read_bytes, unpack, write_bytes
from navbake.known_names import suggest

NAME = b"navbake"  # of the header in a Parquet file's metadata
PACKERS: dict[str, Callable[[bytes], bytes]] = {
    ".gz": partial(gzip.compress, compresslevel=6, mtime=0),
    ".bz2": bz2.compress,
}


class Format(NamedTuple):
    """A format of sets: how names of its files end, its tasks, and what encodes a set."""

    ending: str
    tasks: tuple[str, ...]
    encode: Callable[[EpisodeSet], bytes]


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
    text, (ending, _) = unpack(packed, name), _endings(path)
    if ending == ".parquet":
        return _read_parquet(text, name)
    if ending in (".csv", ".json"):
        is_list = text.lstrip()[:1] == b"["
        read = read_minos if ending == ".csv" else read_molmospaces if is_list else read_habitat
        return _rename(read(text, name), {there: here for here, there in (scenes or {}).items()})
    lines = text.splitlines()
    header = decode(lines[0] if lines else b"", Header, f"{name}, line 1")
    if header.format != FORMAT or header.version > VERSION:
        got = f"{header.format!r} of version {header.version}"
        raise FormatError(f"expected {FORMAT!r} up to version {VERSION}, got {got} in {name}")
    episodes = [
        decode(line, Episode, f"{name}, line {number}")
        for number, line in enumerate(lines[1:], start=2)
    ]
    return make_set(header, episodes, name)


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
        form: one of `FORMATS`; the first that fits the ending and the tasks unless given.
        scenes: what another program calls scenes, by their ids here.

    Returns:
        The fields that some episode has and the file doesn't hold.

    Raises:
        FormatError: no format has such an ending, or it can't hold the set.
    """
    if form is not None and form not in FORMATS:
        raise FormatError(f"no format {form!r}: {suggest(form, FORMATS)}")
    known = FORMATS if form is None else {form: FORMATS[form]}
    ending, packing = _endings(path)
    fitting = {name: one for name, one in known.items() if one.ending == ending}
    if not fitting:
        endings = ", ".join(dict.fromkeys(one.ending for one in known.values()))
        raise FormatError(f"expected a name that ends in {endings}, got {path_name(path)}")
    tasks = {e.task: e.id for e in reversed(content.episodes)}
    chosen = next((n for n, one in fitting.items() if tasks.keys() <= {*one.tasks}), None)
    if chosen is None:
        task = next(task for task in tasks if task not in next(iter(fitting.values())).tasks)
        names = " or ".join(fitting)
        raise FormatError(f"no task {task!r} in {names}, as of episode {tasks[task]!r}")
    written = content if chosen in OWN else _rename(content, scenes or {})
    write_bytes(PACKERS.get(packing, bytes)(FORMATS[chosen].encode(written)), path)
    return [] if chosen in OWN else _lost(content, read_episodes(path, scenes))


def _endings(path: str | os.PathLike[str]) -> tuple[str, str]:
    """How a file's name ends, without what packs it, and that."""
    stem, packing = os.path.splitext(os.fspath(path).lower())
    return (os.path.splitext(stem)[1], packing) if packing in PACKERS else (packing, "")


def _rename(content: EpisodeSet, names: Mapping[str, str]) -> EpisodeSet:
    """The set with other names of scenes in its episodes."""
    renamed = (
        msgspec.structs.replace(e, scene=names.get(e.scene, e.scene)) for e in content.episodes
    )
    return EpisodeSet(content.header, tuple(renamed)) if names else content


def _lost(content: EpisodeSet, written: EpisodeSet) -> list[str]:
    """Fields that are there before a set is written, and no longer when it is read again."""
    lost = {"agent"} if content.header.agent and not written.header.agent else set()
    for before, after in zip(content.episodes, written.episodes, strict=True):
        pairs = [(before, after), *zip(before.goals, after.goals, strict=False)]
        lost |= {
            k for a, b in pairs for k in a.__struct_fields__ if getattr(a, k) and not getattr(b, k)
        }
        lost |= {"further goals"} if len(before.goals) > len(after.goals) else set()
    return sorted(lost)


def _encode_lines(content: EpisodeSet) -> bytes:
    lines = [msgspec.json.encode(part) for part in (content.header, *content.episodes)]
    return b"\n".join([*lines, b""])


# ---------------------------------------------------------------- Parquet


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow  # the extra `batch`
        from pyarrow import parquet  # the extra `batch`
    except ImportError as error:
        message = 'Parquet needs pyarrow: pip install "navbake[batch]"'
        raise MissingDependencyError(message) from error
    return pyarrow, parquet


def _encode_parquet(content: EpisodeSet) -> bytes:
    pyarrow, parquet = _pyarrow()
    text, number = pyarrow.string(), pyarrow.float64()
    columns = {"id": text, "scene": text, "task": text, "split": text, "room": text}
    columns |= {"heading": number, "distance": number, "straight": number, "ratio": number}
    rows = [{name: getattr(e, name) for name in columns} for e in content.episodes]
    for row, episode in zip(rows, content.episodes, strict=True):
        row |= dict(zip("xyz", episode.start, strict=True))
        row["episode"] = msgspec.json.encode(episode).decode()
    columns |= {"x": number, "y": number, "z": number, "episode": text}
    schema = pyarrow.schema(
        list(columns.items()), metadata={NAME: msgspec.json.encode(content.header)}
    )
    file = io.BytesIO()
    parquet.write_table(pyarrow.Table.from_pylist(rows, schema=schema), file, compression="zstd")
    return file.getvalue()


def _read_parquet(data: bytes, name: str) -> EpisodeSet:
    pyarrow, parquet = _pyarrow()
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
    return make_set(decode(header, Header, name), episodes, name)


OWN = {
    "jsonl": Format(".jsonl", TASKS, _encode_lines),
    "parquet": Format(".parquet", TASKS, _encode_parquet),
}
FORMATS = OWN | {
    "habitat-pointnav": Format(".json", ("point",), partial(encode_habitat, kind="pointnav")),
    "habitat-objectnav": Format(".json", ("object",), partial(encode_habitat, kind="objectnav")),
    "habitat-vln": Format(".json", ("point",), partial(encode_habitat, kind="vln")),
    "molmospaces": Format(".json", ("object",), encode_molmospaces),
    "minos": Format(".csv", ("point", "object", "room"), encode_minos),
}
"""Formats of sets by their names; other programs' after navbake's own."""
