"""Compiled kernels in one file, to hand them on to other machines.

An archive holds the code of each kernel under the names of its folder of kernels and its file, and
of which sources, for which processor and by which numba it is. So it serves any machine that has
the same of these, wherever navbake is installed there. Packing the same code gives the same bytes.

What is in an archive runs as a program, as does the package itself: unpack those that you trust.
"""

# numba has few types
# mypy: disable-error-code="attr-defined,no-untyped-call"

from __future__ import annotations

import gzip
import io
import json
import platform
import sys
import tarfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
from numba.core.registry import cpu_target

from navbake.digests import digest_folder
from navbake.dispatch import KERNELS, Kernel, KernelCache
from navbake.errors import FormatError
from navbake.folder_lock import folder_lock

HEADER = "navbake-kernels.json"
LEVEL = 6  # of gzip
MOST_BYTES = 1 << 28  # of what is unpacked; all kernels take 20 MB
MOST_FILES = 10_000  # all kernels have 400
Sources = dict[str, dict[str, str]]  # digests of modules by folder of kernels, see `digest_folder`


@dataclass(frozen=True)
class Unpacked:
    """What became of an archive.

    Attributes:
        kernels: how many kernels it gave code to.
        why_not: why nothing of it is of use here; None if it is.
    """

    kernels: int
    why_not: str | None


def describe_machine() -> dict[str, str]:
    """What compiled code depends on besides its sources."""
    processor = cpu_target.target_context.codegen().magic_tuple()
    return {
        "numba": str(numba.__version__),
        "Python": sys.implementation.cache_tag or platform.python_version(),
        "processor": " ".join(map(str, processor)),
    }


def pack_kernels() -> bytes:
    """Put the code on disk of the kernels imported so far into an archive, a ``.tar.gz``."""
    files: dict[str, bytes] = {}
    sources: Sources = {}
    for folder, kernels in _by_folder(KERNELS):
        sources[folder] = digest_folder(folder)
        for kernel in kernels:
            for path in _files_of(kernel._cache):
                files[f"{folder}/{path.name}"] = path.read_bytes()
    header = {"machine": describe_machine(), "sources": sources}
    packed = io.BytesIO()
    # no name, no time: the same code, the same bytes
    with (
        gzip.GzipFile("", "wb", LEVEL, packed, mtime=0) as zipped,
        tarfile.open(fileobj=zipped, mode="w", format=tarfile.PAX_FORMAT) as archive,
    ):
        _add(archive, HEADER, json.dumps(header, sort_keys=True).encode())
        for name in sorted(files):
            _add(archive, name, files[name])
    return packed.getvalue()


def unpack_kernels(archive: bytes, name: str) -> Unpacked:
    """Give code to the kernels imported so far that have none on disk, where it is theirs.

    It is theirs if their sources are the same, and numba, Python and processor. The folders of the
    archive are no places: each kernel's code goes where this machine keeps it.

    Args:
        archive: what `pack_kernels` returned.
        name: what the archive is called, for messages.

    Raises:
        FormatError: it is no archive of kernels, or damaged.
        OSError: a file can't be written.
    """
    files = _read(archive, name)
    try:
        header = json.loads(files.pop(HEADER))
        machine, sources = header["machine"], header["sources"]
        why_not = _differs(dict(machine))
        same = {
            f"{folder}.{module}"
            for folder, digests in dict(sources).items()
            for module, digest in dict(digests).items()
            if digest_folder(folder).get(module) == digest
        }
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise FormatError(f"expected an archive of navbake warm-up, got another {name}") from error
    if why_not is not None:
        return Unpacked(0, why_not)
    count = 0
    for folder, kernels in _by_folder(KERNELS):
        for kernel in kernels:
            if str(kernel.__module__) in same and kernel.is_cold():
                count += _give(kernel._cache, folder, files)
    if not same:
        return Unpacked(0, "it was made by another version of navbake")
    return Unpacked(count, None)


def _by_folder(kernels: Iterable[Kernel]) -> Iterator[tuple[str, list[Kernel]]]:
    """Kernels whose code is kept on disk, by the folder of kernels that they are in."""
    found: dict[str, list[Kernel]] = {}
    for kernel in kernels:
        if isinstance(kernel._cache, KernelCache):
            found.setdefault(kernel.folder, []).append(kernel)
    yield from sorted(found.items())


def _files_of(cache: KernelCache) -> list[Path]:
    """The files of a kernel's code, those with code first; [] where there is none."""
    kept: Any = cache._cache_file
    index = Path(kept._index_path)
    place = index.parent
    codes = [place / name for name in sorted(set(kept._load_index().values()))]
    codes = [path for path in codes if path.is_file()]
    return [*codes, index] if codes else []


def _give(cache: KernelCache, folder: str, files: dict[str, bytes]) -> bool:
    """Write the code of one kernel, its index last: what the index names is there."""
    kept: Any = cache._cache_file
    index = Path(kept._index_path)
    place, base = index.parent, index.name.removesuffix(".nbi")
    found = {
        name: content
        for name in (index.name, *(f"{base}.{number}.nbc" for number in range(1, 10)))
        if (content := files.get(f"{folder}/{name}")) is not None
    }
    if index.name not in found:
        return False
    place.mkdir(parents=True, exist_ok=True)
    with folder_lock(place).hold(base):
        for name in sorted(found, key=lambda name: name == index.name):
            with kept._open_for_write(str(place / name)) as file:  # and then renames it
                file.write(found[name])
    return True


def _differs(machine: dict[str, str]) -> str | None:
    """What of this machine is not what an archive was made for; None if nothing is."""
    for what, here in describe_machine().items():
        if machine.get(what) != here:
            return f"it is for {what} {str(machine.get(what))[:80]}, and here is {what} {here[:80]}"
    return None


def _add(archive: tarfile.TarFile, name: str, content: bytes) -> None:
    entry = tarfile.TarInfo(name)
    entry.size = len(content)
    archive.addfile(entry, io.BytesIO(content))


def _read(archive: bytes, name: str) -> dict[str, bytes]:
    """The files of an archive by their names; nothing is written."""
    expected = "expected an archive of navbake warm-up, got"
    files: dict[str, bytes] = {}
    try:
        with gzip.open(io.BytesIO(archive)) as zipped:
            unzipped = zipped.read(MOST_BYTES + 1)  # before tarfile sees any of it
        if len(unzipped) > MOST_BYTES:
            raise FormatError(f"{expected} more than {MOST_BYTES:,} bytes unpacked in {name}")
        with tarfile.open(fileobj=io.BytesIO(unzipped), mode="r:") as reader:
            for number, entry in enumerate(reader):
                content = reader.extractfile(entry) if entry.isreg() else None
                if content is None or entry.issparse() or number >= MOST_FILES:
                    raise FormatError(f"{expected} files that it never has in {name}")
                files[entry.name] = content.read()
    except (tarfile.TarError, EOFError, OSError, zlib.error, ValueError, RecursionError) as error:
        raise FormatError(f"{expected} a damaged or another file: {name}") from error
    return files
