"""What reading one input takes: time of the processor, and memory beside its honest size."""

from __future__ import annotations

import dataclasses
import gzip
import io
import sys
import time
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzzing.kind import Input

CLEAR, STATUS = Path("/proc/self/clear_refs"), Path("/proc/self/status")
RESET_PEAK = b"5"  # what makes Linux forget the most memory that a process had
FACTOR = 10  # of an input's honest size that reading it may take
# and this much more, for what an interpreter takes for itself: buffers, modules that load late
FREE_BYTES = 32 << 20
FREE_SECONDS = 1.0
# and a second more for each of these bytes of honest size: 32 million cells are no hang
BYTES_PER_SECOND = 32 << 20
PNG = b"\x89PNG"
MOST = 1 << 30  # that is unpacked to see how much it is


class Cost(NamedTuple):
    """What something took: seconds of the processor, and bytes of memory at its peak."""

    seconds: float
    memory: int


def measures_memory() -> bool:
    """Whether this system tells how much memory a process had at most since it was asked last."""
    return _reset_peak() != sys.maxsize


class Meter:
    """Measures from where it is made to `read`; memory on Linux only, where it is 0 else."""

    def __init__(self) -> None:
        self._before = _reset_peak()
        self._begin = time.process_time()

    def read(self) -> Cost:
        """What it took since."""
        seconds = time.process_time() - self._begin
        return Cost(seconds, max(0, _status("VmHWM:") - self._before))


def _reset_peak() -> int:
    try:
        CLEAR.write_bytes(RESET_PEAK)
    except OSError:
        return sys.maxsize  # so that nothing ever exceeds it
    return _status("VmRSS:")


def _status(name: str) -> int:
    try:
        text = STATUS.read_text(encoding="ascii")
    except OSError:
        return 0
    return int(text.split(name, 1)[1].split(None, 1)[0]) << 10


def exceeds(cost: Cost, made: Input, value: Any) -> str:
    """Say what took too much for an input, "" where nothing did.

    The honest size of an input is the most of

    - the bytes of its files,
    - the bytes that they unpack to, where they are packed (gzip, zip, PNG, Parquet), and
    - the bytes of what reading gives: arrays, texts, objects. Few bytes of runs, or of an octree,
      may rightly stand for millions of cells, as far as docs/files.md says how many.

    Reading may take ten times as much memory, and 32 MiB; a second, and one more for each 32 MiB.
    """
    if cost.seconds <= FREE_SECONDS and cost.memory <= FREE_BYTES:  # which is so nearly always
        return ""
    honest = honest_size(made, value)
    if cost.seconds > FREE_SECONDS + honest / BYTES_PER_SECOND:
        return f"took {cost.seconds:.1f} s for {honest:,} bytes"
    if cost.memory > FREE_BYTES + FACTOR * honest:
        return f"took {cost.memory >> 20} MiB for {honest:,} bytes"
    return ""


def honest_size(made: Input, value: Any) -> int:
    """See `exceeds`."""
    files = [made.data, *made.beside.values()]
    return max(sum(map(len, files)), sum(map(_unpacked, files)), _held(value, set()))


def _unpacked(data: bytes) -> int:
    """How many bytes a file unpacks to, as far as it does; its own where it is not packed."""
    if data.startswith(b"\x1f\x8b"):
        return _length(gzip.GzipFile(fileobj=io.BytesIO(data)))
    if data.startswith(PNG):
        place, packed = 8, []
        while place + 8 <= len(data):
            length = int.from_bytes(data[place : place + 4])
            if data[place + 4 : place + 8] == b"IDAT":
                packed.append(data[place + 8 : place + 8 + length])
            place += 12 + length
        return _inflated(b"".join(packed))
    if data.startswith(b"PAR1"):
        return _table_bytes(data)
    if data.startswith(b"PK"):
        try:
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                return sum(_length(archive.open(info)) for info in archive.infolist())
        except Exception:  # broken, in any of many ways
            return len(data)
    return len(data)


def _table_bytes(data: bytes) -> int:
    """What the pages of Parquet unpack to; texts that rows share count once."""
    from pyarrow import BufferReader, parquet  # where there is none, no input is Parquet

    size = 0
    try:
        schema = parquet.ParquetFile(BufferReader(data)).schema
        texts = [one.path for one in map(schema.column, range(len(schema)))
                 if one.physical_type == "BYTE_ARRAY"]  # fmt: skip
        file = parquet.ParquetFile(BufferReader(data), read_dictionary=texts)
        for batch in file.iter_batches(1000):
            size += batch.nbytes
            if size > MOST:
                break
    except Exception:  # broken there
        pass
    return max(size, len(data))


def _length(file: Any) -> int:
    size = 0
    try:
        while size < MOST and (piece := file.read(1 << 20)):
            size += len(piece)
    except Exception:  # broken there
        pass
    return size


def _inflated(packed: bytes) -> int:
    unpack, size = zlib.decompressobj(), 0
    try:
        while size < MOST and (piece := unpack.decompress(packed, 1 << 20)):
            size, packed = size + len(piece), unpack.unconsumed_tail
    except zlib.error:
        pass
    return size


def _held(value: Any, seen: set[int]) -> int:
    """The bytes of a value and all that it holds."""
    if id(value) in seen:
        return 0
    seen.add(id(value))
    own = value.nbytes if isinstance(value, np.ndarray) else sys.getsizeof(value, 0)
    inner: Iterable[Any] = ()
    if isinstance(value, Mapping):
        inner = (*value.keys(), *value.values())
    elif isinstance(value, list | tuple | set | frozenset):
        inner = value
    elif dataclasses.is_dataclass(value) or hasattr(value, "__dict__"):
        inner = vars(value).values() if hasattr(value, "__dict__") else ()
    return own + sum(_held(one, seen) for one in inner)
