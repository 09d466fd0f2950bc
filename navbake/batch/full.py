"""Tells a disk that takes no more files from a scene that is broken."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from navbake.errors import NavbakeError

# What the system says of a file system, whatever is written to it; and what helps. Readers are
# never told so.
REMEDIES = {
    errno.ENOSPC: "free space",
    getattr(errno, "EDQUOT", errno.ENOSPC): "free space",  # Windows has no quotas
    errno.EROFS: "make it writable",
}


class FullError(NavbakeError):
    """An output folder takes no more files, so that no scene can be kept in it."""


def no_room(what: str, error: OSError) -> FullError:
    """The FullError for what can't be written, from what `why_full` found."""
    remedy = REMEDIES[error.errno or 0]
    return FullError(
        f"cannot write {what}: {error.strerror or error}: {remedy} and run the same command again"
    )


def refused(what: str, error: OSError) -> NavbakeError:
    """The error for what the system refuses to write; a FullError where there is no room."""
    if why_full(error):
        return no_room(what, error)
    return NavbakeError(f"cannot write {what}: {error.strerror}")


@contextmanager
def telling_full(place: str | os.PathLike[str]) -> Iterator[None]:
    """Raise a FullError that names `place` where what is written inside finds no room there.

    Products may need the folder for temporary files, too: that one is full is another error.
    """
    try:
        yield
    except (OSError, NavbakeError) as error:
        why = why_full(error)
        if why is None or isinstance(error, FullError) or _is_temporary(why, place):
            raise
        raise no_room(f"into {os.fspath(place)}", why) from error


def _is_temporary(error: OSError, place: str | os.PathLike[str]) -> bool:
    """Whether an error is of a file in the folder for temporary files, in which `place` isn't."""
    if not isinstance(error.filename, str):
        return False
    folder = Path(os.path.realpath(tempfile.gettempdir()))
    file, place = (Path(os.path.realpath(path)) for path in (error.filename, place))
    return file.is_relative_to(folder) and not place.is_relative_to(folder)


def why_full(error: BaseException | None) -> OSError | None:
    """The system's error that says so, be it this one or a cause of it; None if there is none."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in REMEDIES:
            return error
        error = error.__cause__
    return None
