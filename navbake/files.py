"""Writes files as a whole or not at all, makes temporary folders, and encodes CSV."""

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
# names of the files of `create_temporary` and of the folders of `scratch_folder`
TEMPORARY_NAME = re.compile(r"\.navbake-[0-9a-f]{16}\.tmp|navbake-\w{8}")
LEFTOVER_AGE = 86400.0  # an older temporary file is a leftover: no write takes a day [s]
_cleaned_folders: set[Path] = set()  # whose leftovers this process has removed


def write_whole(data: bytes | Iterable[bytes], path: str | PathLike[str]) -> None:
    """Write a file as a whole or not at all: under a temporary name, then it is renamed.

    A link's target is replaced. A device or a pipe is written to directly.

    Args:
        data: The content, or its pieces in order.
        path: The path of the file.

    Raises:
        OSError: The path cannot be written; an existing file is unchanged.
    """
    write_together({Path(path): data})


def write_together(contents: Mapping[Path, bytes | Iterable[bytes]]) -> None:
    """Write several files like `write_whole`: all of them or, as far as the system allows, none.

    All files are written before the first one is renamed.

    Args:
        contents: Path -> the content of the file, or its pieces in order. Files are renamed in the
            order of the mapping; so put a file that names others after them.

    Raises:
        OSError: A path cannot be written; no file has changed, unless a renaming failed.
    """
    with ExitStack() as stack:
        commits = [
            stack.enter_context(_write_temporary(data, path)) for path, data in contents.items()
        ]
        for commit in commits:
            commit()


@contextmanager
def _write_temporary(data: bytes | Iterable[bytes], path: Path) -> Iterator[Callable[[], None]]:
    """Write a file under a temporary name; yield a function that renames it.

    For a device or a pipe, nothing is written yet: the function writes to it.
    """
    pieces = [data] if isinstance(data, bytes) else data
    if not _is_replaceable(path):

        def write_device() -> None:
            with open(path, "wb") as device:
                device.writelines(pieces)

        yield write_device
        return
    target = Path(os.path.realpath(path))
    _remove_leftovers_once(target.parent)
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
    """Create a temporary file in a folder; return it, open for writing, and its path."""
    path = folder / f".navbake-{os.urandom(8).hex()}.tmp"
    return open(path, "xb"), path


def write_all(descriptor: int, data: bytes) -> None:
    """Write all data to an open file; `os.write` alone may write a part of them.

    Args:
        descriptor: The descriptor of the file.
        data: The bytes to write.

    Raises:
        OSError: The system can't write them, for example because the disk is full.
    """
    num_written = os.write(descriptor, data)
    while num_written < len(data):
        num_written += os.write(descriptor, data[num_written:])


def encode_csv(rows: Iterable[Iterable[Any]]) -> bytes:
    """Encode rows as CSV (RFC 4180) in UTF-8; None and NaN are empty cells.

    Text that a spreadsheet would evaluate as a formula gets an apostrophe in front, and control
    characters are escaped. Source: OWASP, "CSV Injection".
    """
    text = io.StringIO()
    # with other line ends, csv doesn't quote names that contain them
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerows([_to_csv_cell(cell) for cell in row] for row in rows)
    return text.getvalue().encode()


def _to_csv_cell(cell: object) -> object:
    """Convert a value to a CSV cell: text made harmless as in `encode_csv`, None for NaN."""
    if isinstance(cell, str):
        return printable(f"'{cell}" if cell.startswith(("=", "+", "-", "@")) else cell)
    is_nan = cell != cell
    return None if is_nan else cell


def check_writable(path: str | PathLike[str]) -> None:
    """Raise an OSError if `write_whole` couldn't write a path.

    Call it before the work that makes the content.
    """
    if _is_replaceable(path):
        with tempfile.TemporaryFile(dir=os.path.dirname(os.path.realpath(path))):
            pass


def readable_stem(path: str | PathLike[str]) -> str:
    """Return a file's name without its folder and ending; bytes that aren't UTF-8 become U+FFFD."""
    return os.fsencode(Path(path).stem).decode(errors="replace")


def can_be_path(text: str) -> bool:
    """Whether a text can be the path of a file: it has no NUL, and the system can encode it."""
    try:
        os.fsencode(text)
    except UnicodeEncodeError:  # half of a surrogate pair, as in JSON
        return False
    return "\0" not in text


def check_regular(path: str | PathLike[str]) -> None:
    """Raise an OSError if a path is a pipe or a device, which may block its reader for ever.

    Call it for a path that stands in another file; a path that the user gives may be a pipe. A
    folder or a missing file raises no error.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, "expected a file, got a pipe or a device", os.fspath(path))


def _remove_leftovers_once(folder: Path) -> None:
    """Remove leftovers from a folder once in a process, because listing a large folder is slow."""
    if folder not in _cleaned_folders:
        _cleaned_folders.add(folder)
        remove_leftovers(folder)


def remove_leftovers(folder: Path, age: float = LEFTOVER_AGE) -> None:
    """Remove the temporary files and folders that this user's killed processes left in a folder.

    Errors are ignored.

    Args:
        folder: The folder.
        age: Remove only what has not changed for this long [s]. 0 is safe only if no other process
            writes there.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            status = entry.stat(follow_symlinks=False)
            is_of_user = not hasattr(os, "getuid") or status.st_uid == os.getuid()
            if not (TEMPORARY_NAME.fullmatch(entry.name) and is_of_user):
                continue
            if time.time() - status.st_mtime < age:
                continue
            if stat.S_ISREG(status.st_mode) and entry.name.startswith("."):
                os.unlink(entry.path)
            elif stat.S_ISDIR(status.st_mode) and not entry.name.startswith("."):
                shutil.rmtree(entry.path, ignore_errors=True)


def _is_replaceable(path: str | PathLike[str]) -> bool:
    """Whether the path is a regular file or missing; raise an IsADirectoryError for a folder."""
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        return True
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(0, "it is a folder")
    return stat.S_ISREG(mode)


@contextmanager
def scratch_folder(parent: Path | None = None) -> Iterator[Path]:
    """Make a temporary folder, and remove it at the end.

    Leftovers of killed processes are removed first.

    Args:
        parent: The folder to make it in; None for the system's folder of temporary files.

    Yields:
        The path of the folder.

    Raises:
        NavbakeError: The folder cannot be made.
    """
    try:
        if parent is None:
            parent = Path(tempfile.gettempdir())
        _remove_leftovers_once(parent)
        folder = tempfile.TemporaryDirectory(
            prefix="navbake-", dir=parent, ignore_cleanup_errors=True
        )
    except OSError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE):  # too many open files, in any folder
            raise
        into = "" if parent is None else f" into {parent}"
        hint = "free space, or set TMPDIR to a folder that has room"
        raise NavbakeError(
            f"cannot write temporary files{into}: {error.strerror}: {hint}",
            path=None if parent is None else str(parent),
            hint=hint,
        ) from error
    with folder:
        yield Path(folder.name)
