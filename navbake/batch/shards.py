"""Packs what a batch made into tar files, as WebDataset reads them.

A sample is a scene. Its key is the scene's id, with ``%2E`` for a dot and ``%25`` for a percent
sign, because a key ends at the first dot of a file's name. Its members are the scene's files
(``0001.grid.json.gz`` for the key ``0001``) and its row of the index, without times
(``0001.json``). Shards hold equally many scenes, in the batch's order, and equal scenes give equal
bytes: members have no time, no owner and one mode.
"""

from __future__ import annotations

import re
import tarfile
from collections.abc import Iterator, Sequence

from navbake.batch.index import line_of
from navbake.batch.job import OK, read_record, write_record
from navbake.batch.products import RECORD
from navbake.batch.store import Folder, join, read_file, remove_files, write_file
from navbake.types import Json

SHARD = re.compile(r"shard-\d{6,}\.tar")
TIMES = ("seconds", "stages", "ended")  # keys of a row that differ each time


def write_shards(folder: Folder, rows: Sequence[Json], count: int | None) -> None:
    """Write ``shard-000000.tar`` and on, `count` of them, or one a scene if there are fewer scenes.

    `rows` are those of the index; scenes that aren't ``ok`` are left out. Shards are recorded as
    the files of a scene are. Outdated ones are removed, all of them if `count` is None; other files
    of such a name are left alone.
    """
    packed = [row for row in rows if row["status"] == OK] if count else []
    number = min(count or 0, len(packed))
    names = [f"shard-{k:06}.tar" for k in range(number)]
    before = {*filter(SHARD.fullmatch, read_record(folder).get("files", ()))}
    if names:
        write_record(folder, {"files": dict.fromkeys(sorted({*before, *names}))})
    for k, name in enumerate(names):
        some = packed[len(packed) * k // number : len(packed) * (k + 1) // number]
        write_file(folder, name, _encode(folder, some))
    remove_files(folder, sorted(before - {*names}))
    if names:
        write_record(folder, {"files": dict.fromkeys(names)})
    elif before:
        remove_files(folder, [RECORD])


def _encode(folder: Folder, rows: Sequence[Json]) -> Iterator[bytes]:
    """The pieces of a tar file."""
    for row in rows:
        key = row["id"].replace("%", "%25").replace(".", "%2E")
        for name in sorted(row["files"]):
            yield from _member(f"{key}.{name}", read_file(join(folder, f"{row['id']}/{name}")))
        kept = {name: value for name, value in row.items() if name not in TIMES}
        yield from _member(f"{key}.json", line_of(kept))
    yield bytes(2 * tarfile.BLOCKSIZE)


def _member(name: str, content: bytes) -> Iterator[bytes]:
    info = tarfile.TarInfo(name)
    info.size = len(content)
    yield info.tobuf(tarfile.PAX_FORMAT)
    yield content
    yield bytes(-len(content) % tarfile.BLOCKSIZE)
