"""Files that are written as a whole or not at all."""

import os
import stat
import tempfile
from os import PathLike
from pathlib import Path


def write_whole(data: bytes, path: str | PathLike[str]) -> None:
    """Write a file under another name in the same folder, then rename it.

    Of a link, the file that it points to is replaced. A device or a pipe is written to directly.

    Raises:
        OSError: the path can't be written; a file that was there is unchanged.
    """
    if not _is_replaceable(path):
        Path(path).write_bytes(data)
        return
    target = Path(os.path.realpath(path))
    temporary = target.parent / f".navbake-{os.urandom(8).hex()}.tmp"
    try:
        with open(temporary, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def check_writable(path: str | PathLike[str]) -> None:
    """Raise an OSError for a path that `write_whole` could not write, before any work is done."""
    if _is_replaceable(path):
        with tempfile.TemporaryFile(dir=os.path.dirname(os.path.realpath(path))):
            pass


def _is_replaceable(path: str | PathLike[str]) -> bool:
    """Whether the path is a file, or nothing yet."""
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        return True
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(0, "it is a folder")
    return stat.S_ISREG(mode)
