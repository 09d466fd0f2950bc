"""Writes files as a whole or not at all, makes temporary folders, and encodes CSV.

A process holds a lock on each temporary file or folder that it needs. The system releases the lock
when the process ends, however it ends. So a temporary file that nobody holds is a leftover. Where
there are no such locks (Windows, some network file systems), it is a leftover after a day.
"""

import csv
import errno
import filecmp
import io
import logging
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

from navbake.errors import NavbakeError, printable
from navbake.known_names import find_similar_names

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LOG = logging.getLogger("navbake")
# names of the files of `create_temporary` and of the folders of `scratch_folder`
TEMPORARY_NAME = re.compile(r"\.navbake-[0-9a-f]{16}\.tmp|navbake-scratch-\w{8}")
# where there are no locks, an older temporary file is a leftover: no write takes a day [s]
LEFTOVER_AGE = 86400.0
MAX_HINT_NAMES = 2000  # most names of a folder that a hint compares, one after the other
cleaned_folders: set[Path] = set()  # folders from which this process has removed leftovers


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
    """Write several files whole: all of them or, as far as the system allows, none.

    All files are written under other names before the first one is renamed. If two or more existing
    files change, the old ones are put aside before that, the last one first. So a process that is
    killed in between leaves some of the files missing, but never a new file beside an old one.

    Args:
        contents: Path -> the content of the file, or its pieces in order. Files are renamed in the
            order of the mapping; so put a file that names others after them.

    Raises:
        OSError: A path cannot be written; no file has changed.
    """
    device_contents = {path: data for path, data in contents.items() if not _is_replaceable(path)}
    with ExitStack() as stack:
        new_files = [
            stack.enter_context(_write_temporary(data, path))
            for path, data in contents.items()
            if path not in device_contents
        ]
        for path, data in device_contents.items():
            with open(path, "wb") as device:
                device.writelines([data] if isinstance(data, bytes) else data)
        try:
            if len(new_files) > 1:
                changing_files = [file for file in new_files if file.changes_target()]
                if len(changing_files) > 1:
                    for file in reversed(changing_files):
                        file.put_aside()
            for file in new_files:
                os.replace(file.temporary_path, file.target_path)
        except BaseException:
            for file in new_files:
                file.restore()
            raise
        for file in new_files:
            LOG.debug("wrote %s, %d bytes", file.path, os.path.getsize(file.target_path))


@dataclass
class _NewFile:
    """A file that is written under a temporary name first, and the file that it will replace."""

    path: Path  #: The path that the caller passed.
    target_path: Path  #: The same path with all links resolved.
    temporary_path: Path  #: The path under which the content is written first.
    is_new: bool  #: Whether no file was at the target path before.
    aside_path: Path | None = None  #: Where the old file lies until all new files are in place.
    aside_descriptor: int | None = None  #: A descriptor of the old file, which holds its lock.

    def changes_target(self) -> bool:
        """Whether a file with different content is at the target path."""
        try:
            return not self.is_new and not filecmp.cmp(
                self.temporary_path, self.target_path, shallow=False
            )
        except OSError:  # it can't be read
            return True

    def put_aside(self) -> None:
        """Rename the old file to a temporary name."""
        aside_path = _make_temporary_name(self.target_path.parent)
        if fcntl is not None:
            with suppress(OSError):  # it can't be read
                self.aside_descriptor = os.open(self.target_path, os.O_RDONLY)
                hold_lock(self.aside_descriptor, self.target_path)
        os.replace(self.target_path, aside_path)
        self.aside_path = aside_path

    def restore(self) -> None:
        """Put the old file back, or remove the new one if there was none, as far as possible."""
        with suppress(OSError):
            if self.aside_path is not None:
                os.replace(self.aside_path, self.target_path)
            elif self.is_new and not self.temporary_path.exists():
                self.target_path.unlink()

    def clear(self) -> None:
        """Remove the files that still have temporary names."""
        self.temporary_path.unlink(missing_ok=True)
        if self.aside_path is not None:
            self.aside_path.unlink(missing_ok=True)
        if self.aside_descriptor is not None:
            os.close(self.aside_descriptor)


@contextmanager
def _write_temporary(data: bytes | Iterable[bytes], path: Path) -> Iterator[_NewFile]:
    """Write a file under a temporary name; it is removed at the end if it still has that name."""
    target_path = Path(os.path.realpath(path))
    _remove_leftovers_once(target_path.parent)
    with ExitStack() as stack:
        open_file, temporary_path = create_temporary(target_path.parent)
        new_file = _NewFile(path, target_path, temporary_path, is_new=not target_path.exists())
        stack.callback(new_file.clear)
        if fcntl is not None:  # the lock is held until the last copy of the descriptor is closed
            stack.callback(os.close, os.dup(open_file.fileno()))
        with open_file:
            if not new_file.is_new:
                _copy_mode(target_path, temporary_path)
            open_file.writelines([data] if isinstance(data, bytes) else data)
        yield new_file


def _copy_mode(source: Path, target: Path) -> None:
    """Give a file the mode of another one, and its owner and group if this user may."""
    source_status = source.stat()
    if hasattr(os, "chown"):  # not on Windows
        for user_id, group_id in ((source_status.st_uid, -1), (-1, source_status.st_gid)):
            with suppress(OSError):
                os.chown(target, user_id, group_id)
    with suppress(OSError):  # of a file system without modes
        target.chmod(stat.S_IMODE(source_status.st_mode))


def _make_temporary_name(folder: Path) -> Path:
    return folder / f".navbake-{os.urandom(8).hex()}.tmp"


def create_temporary(folder: Path) -> tuple[BinaryIO, Path]:
    """Create a temporary file in a folder; return it, open for writing and locked, and its path."""
    while True:
        path = _make_temporary_name(folder)
        with ExitStack() as stack:
            open_file = stack.enter_context(open(path, "x+b"))
            if hold_lock(open_file.fileno(), path):
                stack.pop_all()
                return open_file, path


def hold_lock(descriptor: int, path: str | PathLike[str]) -> bool:
    """Lock an open file or folder, so that no other process takes it for a leftover.

    The lock holds until the descriptor and its copies are closed, or the process ends.

    Args:
        descriptor: The descriptor of the open file or folder.
        path: Its path.

    Returns:
        Whether the path is still there: it may have been removed just before it was locked.
    """
    if fcntl is None:
        return True
    with suppress(OSError):  # a file system without locks
        fcntl.flock(descriptor, fcntl.LOCK_SH)
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False


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
    csv_text = io.StringIO()
    # with other line ends, csv doesn't quote names that contain them
    writer = csv.writer(csv_text, lineterminator="\r\n")
    writer.writerows([_to_csv_cell(cell) for cell in row] for row in rows)
    return csv_text.getvalue().encode()


def _to_csv_cell(cell: object) -> object:
    """Convert a value to a CSV cell: text made harmless as in `encode_csv`, None for NaN."""
    if isinstance(cell, str):
        return printable(f"'{cell}" if cell.startswith(("=", "+", "-", "@")) else cell)
    is_nan = cell != cell
    return None if is_nan else cell


def check_writable(path: str | PathLike[str]) -> None:
    """Raise an OSError if `write_whole` can't write a path.

    Call it before a long computation whose result is to be written there.
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


def hint_at_file(path: str | PathLike[str], suffixes: Iterable[str]) -> str:
    """Write a hint for a path without a file, such as ``did you mean scenes/house.xml?``.

    Args:
        path: The path that a user wrote.
        suffixes: The endings of the files that the user may have meant, in small letters.

    Returns:
        The hint at the file of the same folder whose name is the most similar, or is the same but
        for the ending; "" if there is none, or if the folder has more than `MAX_HINT_NAMES` names.
    """
    missing_path = Path(path)
    try:
        with os.scandir(missing_path.parent) as entries:
            file_names = sorted(entry.name for entry in islice(entries, MAX_HINT_NAMES + 1))
    except (OSError, ValueError):  # ValueError: a path with NUL
        return ""
    if len(file_names) > MAX_HINT_NAMES:
        return ""
    candidates = [
        name
        for name in file_names
        if name.lower().endswith(tuple(suffixes)) and name != missing_path.name  # a broken link
    ]
    stem = missing_path.name.partition(".")[0]
    near_names = find_similar_names(missing_path.name, candidates)
    near_names += [name for name in candidates if name.partition(".")[0] == stem]
    return f"did you mean {missing_path.parent / near_names[0]}?" if near_names else ""


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
    if folder not in cleaned_folders:
        cleaned_folders.add(folder)
        remove_leftovers(folder)


def remove_leftovers(folder: Path, min_age: float = LEFTOVER_AGE) -> None:
    """Remove the temporary files and folders that this user's killed processes left in a folder.

    Files and folders that a living process has locked by `hold_lock` stay. Errors are ignored.

    Args:
        folder: The folder.
        min_age: Where there are no locks, remove only files and folders that have not changed for
            this long [s]. 0 is safe only if no other process writes there.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if TEMPORARY_NAME.fullmatch(entry.name):
                with suppress(OSError):  # another process has removed it
                    _remove_leftover(entry.path, entry.stat(follow_symlinks=False), min_age)


def _remove_leftover(path: str, file_status: os.stat_result, min_age: float) -> None:
    """Remove a temporary file or folder if it is a leftover, as `remove_leftovers` does."""
    is_hidden = os.path.basename(path).startswith(".")
    is_file = is_hidden and stat.S_ISREG(file_status.st_mode)
    is_folder = not is_hidden and stat.S_ISDIR(file_status.st_mode)
    is_of_user = not hasattr(os, "getuid") or file_status.st_uid == os.getuid()
    if not is_of_user or not (is_file or is_folder):
        return
    is_leftover = time.time() - file_status.st_mtime >= min_age
    with ExitStack() as stack:
        if fcntl is not None:
            try:
                descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
                stack.callback(os.close, descriptor)
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                is_leftover = True
            except BlockingIOError:
                is_leftover = False
            except OSError:
                pass  # a file system without locks: its age decides
        if is_leftover and is_file:
            os.unlink(path)
        elif is_leftover:
            shutil.rmtree(path, ignore_errors=True)


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
        folder, descriptor = _make_scratch_folder(parent)
    except OSError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE):  # too many open files, in any folder
            raise
        folder_text = "" if parent is None else f" into {parent}"
        hint = "free space, or set TMPDIR to a folder that has room"
        raise NavbakeError(
            f"cannot write temporary files{folder_text}: {error.strerror}: {hint}",
            path=None if parent is None else str(parent),
            hint=hint,
        ) from error
    with ExitStack() as stack:
        if descriptor is not None:
            stack.callback(os.close, descriptor)
        yield Path(stack.enter_context(folder))


def _make_scratch_folder(
    parent: Path,
) -> tuple[tempfile.TemporaryDirectory[str], int | None]:
    """Make a temporary folder and lock it; return it, and the descriptor that holds the lock."""
    while True:
        folder = tempfile.TemporaryDirectory(
            prefix="navbake-scratch-", dir=parent, ignore_cleanup_errors=True
        )
        if fcntl is None:
            return folder, None
        with suppress(FileNotFoundError):  # removed before it was locked
            descriptor = os.open(folder.name, os.O_RDONLY)
            if hold_lock(descriptor, folder.name):
                return folder, descriptor
            os.close(descriptor)
        folder.cleanup()
