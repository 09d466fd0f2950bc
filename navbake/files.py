"""Files that are written as a whole or not at all, temporary folders, and CSV."""

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
OLD = 86400.0  # age at which what a writer left is a leftover: no write takes a day [s]
_swept: set[Path] = set()  # folders that this process has removed leftovers from


def write_whole(data: bytes | Iterable[bytes], path: str | PathLike[str]) -> None:
    """Write a file, given as bytes or pieces, under another name beside its place and rename it.

    Of a link, the file that it points to is replaced. A device or a pipe is written to directly.

    Raises:
        OSError: the path can't be written; a file that was there is unchanged.
    """
    write_together({Path(path): data})


def write_together(contents: Mapping[Path, bytes | Iterable[bytes]]) -> None:
    """Write several files, each as `write_whole` does; all or, as far as the system allows, none.

    All are written beside their places before the first is renamed, in the order given: a file
    that names others comes after them.

    Raises:
        OSError: a path can't be written. No file has changed, unless it was a renaming that failed.
    """
    with ExitStack() as stack:
        for commit in [stack.enter_context(_beside(data, path)) for path, data in contents.items()]:
            commit()


@contextmanager
def _beside(data: bytes | Iterable[bytes], path: Path) -> Iterator[Callable[[], None]]:
    """Write a file under another name; yields the function that puts it into its place."""
    pieces = [data] if isinstance(data, bytes) else data
    if not _is_replaceable(path):

        def write_device() -> None:
            with open(path, "wb") as device:
                device.writelines(pieces)

        yield write_device
        return
    target = Path(os.path.realpath(path))
    if target.parent not in _swept:  # once a process: a folder of many files takes long to list
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
    """Open a new temporary file in a folder."""
    path = folder / f".navbake-{os.urandom(8).hex()}.tmp"
    return open(path, "xb"), path


def write_all(file: int, data: bytes) -> None:
    """Write to a file, in one write where the system takes it all.

    It takes less where the disk is getting full. Then the rest is written after it, or an OSError
    says why it can't be: what comes next never follows half of this unnoticed.
    """
    written = os.write(file, data)
    while written < len(data):
        written += os.write(file, data[written:])


def encode_csv(rows: Iterable[Iterable[Any]]) -> bytes:
    """Encode rows as CSV (RFC 4180) in UTF-8; None and NaN are empty cells.

    Text that a spreadsheet would take for a formula begins with an apostrophe, and control
    characters are escaped. Source: OWASP, "CSV Injection".
    """

    def plain(cell: Any) -> Any:
        if isinstance(cell, str):
            return printable(f"'{cell}" if cell.startswith(("=", "+", "-", "@")) else cell)
        return cell if cell == cell else None

    text = io.StringIO()
    # with other ends of lines, csv leaves a name with such an end unquoted
    csv.writer(text, lineterminator="\r\n").writerows(map(plain, row) for row in rows)
    return text.getvalue().encode()


def check_writable(path: str | PathLike[str]) -> None:
    """Raise an OSError for a path that `write_whole` could not write, before any work is done."""
    if _is_replaceable(path):
        with tempfile.TemporaryFile(dir=os.path.dirname(os.path.realpath(path))):
            pass


def readable_stem(path: str | PathLike[str]) -> str:
    """The stem of a file's name as UTF-8 can hold it; bytes that are not UTF-8 become U+FFFD."""
    return os.fsencode(Path(path).stem).decode(errors="replace")


def check_regular(path: str | PathLike[str]) -> None:
    """Raise an OSError for a pipe or a device, which may keep whoever reads it for ever.

    For files that another file names: what users name themselves may be a pipe. What isn't there
    passes, and folders do: whoever opens them says so.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, "expected a file, got a pipe or a device", os.fspath(path))


def remove_leftovers(folder: Path, age: float = OLD) -> None:
    """Remove the temporary files and folders of this user that killed processes left in a folder.

    Args:
        folder: where they are; what can't be removed stays.
        age: how long ago they were changed last, at least [s]; 0 where nobody else writes.
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
    """Whether the path is a file, or nothing yet."""
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        return True
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(0, "it is a folder")
    return stat.S_ISREG(mode)


@contextmanager
def scratch_folder(place: Path | None = None) -> Iterator[Path]:
    """Make a temporary folder, and remove it at the end; what killed processes left goes first.

    Args:
        place: the folder that it is in; None for the system's folder for such things.

    Raises:
        NavbakeError: it can't be made there.
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
        if error.errno in (errno.EMFILE, errno.ENFILE):  # of which no folder is the cause
            raise
        into = f" into {where}" if where else ""
        raise NavbakeError(
            f"cannot write temporary files{into}: {error.strerror}: free space, or set TMPDIR to a "
            "folder that has room"
        ) from error
    with folder:
        yield Path(folder.name)
