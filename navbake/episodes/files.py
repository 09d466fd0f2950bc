"""Sets of episodes in files: navbake's own, JSON lines and Parquet, and those of other programs.

JSON lines (``.jsonl``, ``.jsonl.gz``): the header, then an episode a line, UTF-8. Parquet
(``.parquet``): a row an episode, with columns to sort and filter by and all of it in ``episode``
as JSON; the header is the schema's metadata ``navbake``. The same set gives the same bytes.
"""

from __future__ import annotations

import gzip
import io
import os
import zlib
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from navbake.episodes.episode import FORMAT, VERSION, Episode, EpisodeSet, Header
from navbake.errors import FormatError, MissingDependencyError
from navbake.formats.allowance import Allowance, JsonPath
from navbake.formats.source import GZIP, path_name, read_bytes, write_bytes

Record = TypeVar("Record")
NAME = b"navbake"  # of the header in a Parquet file's metadata
JSON_LINES = (".jsonl", ".jsonl.gz")
PARQUET = ".parquet"
PIECE = 16 << 20  # of what is unpacked at once [bytes]


def read_episodes(path: str | os.PathLike[str]) -> EpisodeSet:
    """Read a set in navbake's own format.

    Raises:
        FormatError: the file can't be read, or isn't one; file, line and field are named.
        MissingDependencyError: it is Parquet, and pyarrow is missing.
    """
    if os.fspath(path).lower().endswith(PARQUET):
        return _read_parquet(path)
    data, name = read_text(path)
    lines = data.splitlines()
    header = decode(lines[0] if lines else b"", Header, f"{name}, line 1")
    if header.format != FORMAT or header.version > VERSION:
        got = f"{header.format!r} of version {header.version}"
        raise FormatError(f"expected {FORMAT!r} up to version {VERSION}, got {got} in {name}")
    decoder = msgspec.json.Decoder(Episode)
    episodes = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            episodes.append(decoder.decode(line))
        except msgspec.DecodeError as error:
            raise FormatError(f"{error} in {name}, line {number}") from error
    return make_set(header, episodes, name)


def write_episodes(content: EpisodeSet, path: str | os.PathLike[str]) -> None:
    """Write a set in navbake's own format, chosen by the ending; the same set, the same bytes."""
    name = os.fspath(path).lower()
    if name.endswith(PARQUET):
        write_bytes(_encode_parquet(content), path)
    elif name.endswith(JSON_LINES):
        lines = [msgspec.json.encode(part) for part in (content.header, *content.episodes)]
        data = b"\n".join([*lines, b""])
        write_bytes(pack(data) if name.endswith(".gz") else data, path)
    else:
        endings = ", ".join((*JSON_LINES, PARQUET))
        raise FormatError(f"expected a name that ends in {endings}, got {path_name(path)}")


def pack(data: bytes) -> bytes:
    """Pack by gzip; the same data, the same bytes."""
    return gzip.compress(data, 6, mtime=0)


def read_text(path: str | os.PathLike[str]) -> tuple[bytes, str]:
    """Read a file, gzipped or not, which its content tells: its text, and its name for messages."""
    data, name = read_bytes(path)
    if data.startswith(GZIP):
        allowance, pieces = Allowance(len(data), "max_cells"), []
        try:
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as unpacked:
                while piece := unpacked.read(PIECE):
                    allowance.take_text(len(piece), JsonPath(name))
                    pieces.append(piece)
        except (EOFError, OSError, zlib.error) as error:
            raise FormatError(f"broken gzip data in {name}: {error}") from error
        data = b"".join(pieces)
    return data, name


def decode(text: bytes | str, kind: type[Record], where: str) -> Record:
    """Decode JSON of a known structure; a FormatError names the field and where it stands."""
    try:
        return msgspec.json.decode(text, type=kind)
    except msgspec.DecodeError as error:
        raise FormatError(f"{error} in {where}") from error


def make_set(header: Header, episodes: list[Episode], where: str) -> EpisodeSet:
    """A set of what was read; what makes none of it is a FormatError."""
    try:
        return EpisodeSet(header, tuple(episodes))
    except ValueError as error:
        raise FormatError(f"{error} in {where}") from error


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


def _read_parquet(path: str | os.PathLike[str]) -> EpisodeSet:
    pyarrow, parquet = _pyarrow()
    name = str(Path(path))
    try:
        table = parquet.read_table(io.BytesIO(read_bytes(path)[0]))
        header = table.schema.metadata[NAME]
        texts = table.column("episode").to_pylist()
    except (pyarrow.ArrowException, KeyError, TypeError) as error:
        raise FormatError(
            f"expected a set of episodes as Parquet, got another in {name}"
        ) from error
    episodes = [decode(text or "", Episode, f"{name}, row {row}") for row, text in enumerate(texts)]
    return make_set(decode(header, Header, name), episodes, name)
