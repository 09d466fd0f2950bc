"""Files that are written as a whole or not at all, and temporary folders."""

import errno
import logging
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from os import PathLike
from pathlib import Path
from typing import BinaryIO, NamedTuple

from navbake.errors import NavbakeError

try:
    import fcntl
except ImportError:  # Windows has no such locks; it refuses to remove a file that is open
    fcntl = None  # type: ignore[assignment]

LOG = logging.getLogger("navbake")
FOLDER = re.compile(r"navbake-\w{8}")  # as `tempfile.mkdtemp` names them
TEMPORARY = re.compile(r"\.navbake-[0-9a-f]{16}\.tmp")
RETRIES = 20  # how often Windows is asked within a second to replace a file that is being read
OLD = 86400.0  # age at which a temporary file is a leftover where nothing can be locked [s]
_swept: set[Path] = set()  # folders that this process has removed leftovers from
_waits = ContextVar("_waits", default=True)  # whether a writer waits for the disk


class FileState(NamedTuple):
    """Which file a path was at some time, and since when; all 0 where there was none."""

    device: int
    inode: int
    size: int
    modified_ns: int


def file_state(path: str | PathLike[str]) -> FileState:
    """Which file a path is now, for `write_whole` to see whether it is the same later."""
    try:
        status = os.stat(path)
    except OSError:
        return FileState(0, 0, 0, 0)
    return FileState(status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)


def write_whole(
    data: bytes | Iterable[bytes],
    path: str | PathLike[str],
    *,
    unless_changed: FileState | None = None,
) -> None:
    """Write a file under another name in the same folder, then rename it.

    Of a link, the file that it points to is replaced. A device or a pipe is written to directly.
    Temporary files that writers left in the folder when they were killed are removed first, once
    a process and folder: a folder of many files takes long to list.

    Args:
        data: the content, or pieces of it.
        unless_changed: what the path was when the work began. If another process wrote it since,
            it stays as that process left it. Processes on one machine take turns at this, where
            the system locks folders.

    Raises:
        OSError: the path can't be written, or was written by another process; a file that was
            there is unchanged.
    """
    with _beside(data, path, unless_changed) as put:
        put()


@contextmanager
def without_waiting() -> Iterator[None]:
    """Let what is written inside reach the disk when the system likes; for many small files.

    Each file is still there as a whole or not at all, however its writer ends. But a power cut may
    cut off those of the last seconds, unless `wait_for_disk` was called after them.
    """
    before = _waits.set(False)
    try:
        yield
    finally:
        _waits.reset(before)


def wait_for_disk(folder: Path) -> None:
    """Wait until the disk that a folder is on has all that was written to it.

    Raises:
        OSError: it can't have it.
    """
    if sys.platform == "linux":
        import ctypes  # readers of grids start without it

        descriptor = os.open(folder, os.O_RDONLY)
        try:
            system = ctypes.CDLL(None, use_errno=True)
            if system.syncfs(descriptor) != 0:  # which Python doesn't have
                code = ctypes.get_errno()
                raise OSError(code, os.strerror(code), str(folder))
        finally:
            os.close(descriptor)
    elif hasattr(os, "sync"):
        os.sync()


def write_together(contents: Mapping[Path, bytes | Iterable[bytes]]) -> None:
    """Write several files, each as `write_whole` does; all or, as far as the system allows, none.

    All are written beside their places before the first is renamed, in the order given: a file
    that names others comes after them.

    Raises:
        OSError: a path can't be written. No file has changed, unless it was a renaming that failed.
    """
    with ExitStack() as stack:
        puts = [stack.enter_context(_beside(data, path)) for path, data in contents.items()]
        for put in puts:
            put()


@contextmanager
def _beside(
    data: bytes | Iterable[bytes],
    path: str | PathLike[str],
    unless_changed: FileState | None = None,
) -> Iterator[Callable[[], None]]:
    """Write a file under another name; what it gives puts it into its place."""
    pieces = [data] if isinstance(data, bytes) else data
    if not _is_replaceable(path):

        def write_device() -> None:
            with open(path, "wb") as device:
                device.writelines(pieces)
            LOG.debug("wrote %s", path)

        yield write_device
        return
    target = Path(os.path.realpath(path))
    if target.parent not in _swept:
        _swept.add(target.parent)
        remove_leftovers(target.parent)
    file, temporary = create_temporary(target.parent)

    def put() -> None:
        if fcntl is None:  # Windows renames no file that is open
            file.close()
        _replace(temporary, target, unless_changed)

    try:
        with file:  # as long as it is open it is locked, and nobody takes it for a leftover
            file.writelines(pieces)
            file.flush()
            size = file.tell()
            if _waits.get():
                os.fsync(file.fileno())
            yield put
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    LOG.debug("wrote %s, %d bytes", path, size)


def _replace(temporary: Path, target: Path, unless_changed: FileState | None) -> None:
    if unless_changed is None:
        _rename(temporary, target)
        return
    with _only_writer(target.parent):
        if file_state(target) != unless_changed:
            why = "another process wrote it meanwhile, and that is kept"
            raise FileExistsError(errno.EEXIST, why, str(target))
        _rename(temporary, target)


def _rename(temporary: Path, target: Path) -> None:
    """Rename a file; on Windows, try again for a second where a process reads the old one."""
    if fcntl is None:
        for _ in range(RETRIES):
            with suppress(PermissionError):
                os.replace(temporary, target)
                return
            time.sleep(1.0 / RETRIES)
    os.replace(temporary, target)


@contextmanager
def _only_writer(folder: Path) -> Iterator[None]:
    """Let one process at a time look at a folder's files and replace one; as far as it locks."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def write_all(file: int, data: bytes) -> None:
    """Write to a file, in one write where the system takes it all.

    It takes less where the disk is getting full. Then the rest is written after it, or an OSError
    says why it can't be: what comes next never follows half of this unnoticed.
    """
    written = os.write(file, data)
    while written < len(data):
        written += os.write(file, data[written:])


def check_writable(path: str | PathLike[str]) -> None:
    """Raise an OSError for a path that `write_whole` could not write, before any work is done."""
    if _is_replaceable(path):
        with tempfile.TemporaryFile(dir=os.path.dirname(os.path.realpath(path))):
            pass


def modified(path: Path) -> float:
    """When a file was written last [s since 1970]."""
    return os.lstat(path).st_mtime


def remove_leftovers(folder: Path, last_change: Callable[[Path], float] = modified) -> None:
    """Remove what writers that were killed left in a folder.

    A writer locks its temporary file for as long as it lives. So one that can be locked is a
    leftover, whichever process, thread or machine wrote it. Where files can't be locked, one is
    a leftover when it is a day old. What can't be removed stays.

    Args:
        folder: where they are.
        last_change: tells when a file was written last [s since 1970]; asked where files can't be
            locked.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if TEMPORARY.fullmatch(entry.name):
                with suppress(OSError):
                    _remove_leftover(entry, last_change)


def _remove_leftover(entry: os.DirEntry[str], last_change: Callable[[Path], float]) -> None:
    if not entry.is_file(follow_symlinks=False):
        return
    if fcntl is not None:
        with open(entry.path, "rb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:  # its writer is at work
                return
            except OSError:  # a file system without locks
                pass
            else:
                os.unlink(entry.path)
                return
    if time.time() - last_change(Path(entry.path)) > OLD:
        os.unlink(entry.path)


def create_temporary(folder: Path, mode: int = 0o666) -> tuple[BinaryIO, Path]:
    """Open a new temporary file in a folder, locked until it is closed; see `remove_leftovers`.

    Args:
        folder: where it is.
        mode: who may read and write it, as far as the system's mask lets.
    """
    while True:
        path = folder / f".navbake-{os.urandom(8).hex()}.tmp"
        # the caller closes it
        file = open(path, "x+b", opener=lambda name, flags: os.open(name, flags, mode))  # noqa: SIM115
        if fcntl is None:
            return file, path
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        # another writer may have taken it for a leftover before it was locked
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                return file, path
        file.close()


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
    """Make a temporary folder, and remove it at the end.

    It is locked as long as its process lives, so that `remove_abandoned` knows the folders of
    processes that were killed. Those are removed first.

    Args:
        place: the folder that it is in; None for the system's folder for such things.

    Raises:
        NavbakeError: it can't be made there.
    """
    remedy = "free space, or set TMPDIR to a folder that has room"
    try:
        where = Path(tempfile.gettempdir()) if place is None else place
    except FileNotFoundError as error:  # it names those that take no file
        raise NavbakeError(f"cannot write temporary files: {error.strerror}: {remedy}") from error
    remove_abandoned(where)
    while True:
        try:
            folder = Path(tempfile.mkdtemp(prefix="navbake-", dir=where))
        except OSError as error:
            if error.errno in (errno.EMFILE, errno.ENFILE):  # of which no folder is the cause
                raise
            why = f"cannot write temporary files into {where}: {error.strerror}"
            raise NavbakeError(f"{why}: {remedy}") from error
        with _locked_folder(folder):
            if not folder.is_dir():  # another process took it for abandoned before it was locked
                continue
            try:
                yield folder
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            return


def remove_abandoned(place: Path | None = None) -> None:
    """Remove the scratch folders and temporary files of this user's processes that were killed.

    Where folders can't be locked, one is abandoned when it is a day old.

    Args:
        place: where they are; None for the system's folder for such things.
    """
    with suppress(OSError):
        place = place or Path(tempfile.gettempdir())
        remove_leftovers(place)
        _remove_folders(place)


def _remove_folders(place: Path) -> None:
    with os.scandir(place) as entries:
        for entry in entries:
            own = entry.stat(follow_symlinks=False)
            is_mine = not hasattr(os, "getuid") or own.st_uid == os.getuid()
            if not (FOLDER.fullmatch(entry.name) and stat.S_ISDIR(own.st_mode) and is_mine):
                continue
            with suppress(OSError), _locked_folder(Path(entry.path), waits=False) as is_locked:
                if is_locked or time.time() - own.st_mtime > OLD:
                    shutil.rmtree(entry.path, ignore_errors=True)


@contextmanager
def _locked_folder(folder: Path, waits: bool = True) -> Iterator[bool]:
    """Lock a folder; gives whether that can be done at all, a BlockingIOError if others have it."""
    if fcntl is None:
        yield False
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except FileNotFoundError:
        yield False
        return
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if waits else fcntl.LOCK_NB))
            is_locked = True
        except BlockingIOError:
            raise
        except OSError:  # a file system without locks
            is_locked = False
        yield is_locked
    finally:
        os.close(descriptor)
