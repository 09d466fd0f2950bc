"""Atomic writes, temporary folders, and CSV."""

import csv
import errno
import io
import logging
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

from navbake.errors import NavbakeError, printable

LOG = logging.getLogger("navbake")
TEMPORARY = re.compile(r"\.navbake-[0-9a-f]{16}\.tmp|navbake-\w{8}")  # files; folders by `tempfile`
OLD = 86400.0  # age of leftovers: no write takes a day [s]
_swept: set[Path] = set()  # folders without leftovers since this process began


def write_whole(data: bytes | Iterable[bytes], path: str | PathLike[str]) -> None:
    """Write a file atomically, given as bytes or pieces: under another name, then renamed.

    A link's target is replaced. A device or a pipe is written to directly. Raises an OSError if the
    path can't be written; an existing file is unchanged.
    """
    write_together({Path(path): data})


def write_together(contents: Mapping[Path, bytes | Iterable[bytes]]) -> None:
    """Write several files, each as `write_whole`; all or, as far as the system allows, none.

    All are written before the first is renamed, in the order given, so put a file that names others
    after them. After an OSError no file has changed, unless a renaming failed.
    """
    with ExitStack() as stack:
        for commit in [stack.enter_context(_beside(data, path)) for path, data in contents.items()]:
            commit()


@contextmanager
def _beside(data: bytes | Iterable[bytes], path: Path) -> Iterator[Callable[[], None]]:
    """Write a file under another name; yields a commit function that renames it."""
    pieces = [data] if isinstance(data, bytes) else data
    if not _is_replaceable(path):

        def write_device() -> None:
            with open(path, "wb") as device:
                device.writelines(pieces)

        yield write_device
        return
    target = Path(os.path.realpath(path))
    if target.parent not in _swept:  # once per process, as listing a large folder is slow
        _swept.add(target.parent)
        remove_leftovers(target.parent)
    file, temporary = create_temporary(target.parent)
    try:
        with file:
            file.writelines(pieces)
        yield lambda: os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    LOG.debug("wrote %s, %d bytes", path, os.path.getsize(target))


def create_temporary(folder: Path) -> tuple[BinaryIO, Path]:
    path = folder / f".navbake-{os.urandom(8).hex()}.tmp"
    return open(path, "xb"), path


def write_all(file: int, data: bytes) -> None:
    """Write all data to a file; raises an OSError if the disk gets full."""
    written = os.write(file, data)
    while written < len(data):
        written += os.write(file, data[written:])


def encode_csv(rows: Iterable[Iterable[Any]]) -> bytes:
    """Encode rows as CSV (RFC 4180) in UTF-8; None and NaN are empty cells.

    Text that a spreadsheet would evaluate as a formula gets an apostrophe in front, and control
    characters are escaped. Source: OWASP, "CSV Injection".
    """

    def plain(cell: Any) -> Any:
        if isinstance(cell, str):
            return printable(f"'{cell}" if cell.startswith(("=", "+", "-", "@")) else cell)
        return cell if cell == cell else None

    text = io.StringIO()
    # with other line ends, csv doesn't quote names that contain them
    csv.writer(text, lineterminator="\r\n").writerows(map(plain, row) for row in rows)
    return text.getvalue().encode()


def check_writable(path: str | PathLike[str]) -> None:
    """Raise an OSError for a path that `write_whole` can't write, before any work is done."""
    if _is_replaceable(path):
        with tempfile.TemporaryFile(dir=os.path.dirname(os.path.realpath(path))):
            pass


def readable_stem(path: str | PathLike[str]) -> str:
    """The stem of a file's name, bytes that are not UTF-8 as U+FFFD."""
    return os.fsencode(Path(path).stem).decode(errors="replace")


def check_regular(path: str | PathLike[str]) -> None:
    """Raise an OSError for a pipe or a device, which may block its reader for ever.

    For files named by other files; users' own arguments may be pipes. Folders and missing files
    pass.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, "expected a file, got a pipe or a device", os.fspath(path))


def remove_leftovers(folder: Path, age: float = OLD) -> None:
    """Remove this user's temporary files and folders of killed processes from a folder.

    Only those last changed at least `age` [s] ago; 0 if nobody else writes. Failures are ignored.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            status = entry.stat(follow_symlinks=False)
            is_mine = not hasattr(os, "getuid") or status.st_uid == os.getuid()
            if not (TEMPORARY.fullmatch(entry.name) and is_mine):
                continue
            if time.time() - status.st_mtime < age:
                continue
            if stat.S_ISREG(status.st_mode) and entry.name.startswith("."):
                os.unlink(entry.path)
            elif stat.S_ISDIR(status.st_mode) and not entry.name.startswith("."):
                shutil.rmtree(entry.path, ignore_errors=True)


def _is_replaceable(path: str | PathLike[str]) -> bool:
    """Whether the path is a regular file or missing."""
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        return True
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(0, "it is a folder")
    return stat.S_ISREG(mode)


@contextmanager
def scratch_folder(place: Path | None = None) -> Iterator[Path]:
    """Make a temporary folder in `place`, else the system's, and remove it at the end.

    Leftovers of killed processes are removed first. Raises a NavbakeError if it can't be made.
    """
    where: Path | str = "" if place is None else place
    try:
        where = where or tempfile.gettempdir()
        if Path(where) not in _swept:
            _swept.add(Path(where))
            remove_leftovers(Path(where))
        folder = tempfile.TemporaryDirectory(
            prefix="navbake-", dir=where, ignore_cleanup_errors=True
        )
    except OSError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE):  # not the folder's fault
            raise
        into = f" into {where}" if where else ""
        text = f"cannot write temporary files{into}: {error.strerror}: free space"
        raise NavbakeError(f"{text}, or set TMPDIR to a folder that has room") from error
    with folder:
        yield Path(folder.name)
