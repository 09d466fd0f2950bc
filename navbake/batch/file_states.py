"""What files held when they were last looked at, and whether they still do."""

from __future__ import annotations

import hashlib
import os
import stat
import time
from collections.abc import Container, Iterable, Mapping
from pathlib import Path
from typing import BinaryIO

from navbake.formats.scene_files import Folders, Search, find_inputs
from navbake.types import Json

CHUNK = 1 << 20
RECENT = 2_000_000_000  # age below which a file may change again without a new time of change [ns]


def describe_files(
    paths: Iterable[Path], places: Places, *, may_change: bool = True
) -> dict[str, Json]:
    """Size, time of change [ns] and sha256 of files, by their path from a folder.

    Args:
        places: of the folder.
        may_change: whether others may be writing them now. Then the time of change is given as 0
            where it is too recent to prove that the content is the same later.

    Raises:
        OSError: one can't be read.
    """
    return {places.of_file(path): _describe(path, may_change) for path in paths}


def are_unchanged(stated: Mapping[str, Json], folder: Path) -> bool:
    """Whether files have the content that `describe_files` stated.

    A file of the same size and time of change is taken for the same; of another one of that size,
    the content is read.
    """
    try:
        return all(_is_unchanged(known, folder / name) for name, known in stated.items())
    except (OSError, ValueError):  # it isn't there; no file can be called so
        return False


def has_no_other(found: Iterable[str], known: Container[str], places: Places) -> bool:
    """Whether there are files at none of some paths but the known ones.

    Args:
        found: paths from the folder of the places.
        known: paths of files from that folder, as `describe_files` gives them.
        places: of the folder.
    """
    for name in found:
        if name not in known:  # as most are, and this is quick
            path = os.path.join(places.folder, name)
            if places.of_file(path) not in known and os.path.isfile(path):
                return False
    return True


def list_candidates(sought: Json, scene: str | os.PathLike[str], listed: Folders) -> Iterable[str]:
    """Paths at which a scene's files are now: one that is new may be meant instead of another.

    Args:
        sought: the names and the folders in which MJCF was looked for, as the index has them;
            without folders, of a scene of another kind, the scene is read again.
        scene: its path.
        listed: what is in the folders.
    """
    if sought["folders"]:
        return Search(tuple(sought["folders"]), tuple(sought["names"])).present(listed)
    return map(os.path.abspath, find_inputs(Path(scene)))


class Places:
    """Paths relative to a folder, with slashes; absolute where there is no such path.

    The system, too, finds a file by such a path, joined to the folder, whatever is a link. For it
    takes ``..`` from where a link leads to. So the folder counts as where it really is, and so does
    what a path has before its last ``..``. Links after that stay: if one leads elsewhere some day,
    the file is another one. What a path shares with the folder as it is written is followed for
    both, so that links above both don't matter.

    What links are is kept: make another object if they may have changed.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = os.path.abspath(folder)
        self._real = os.path.realpath(folder)
        self._known: dict[str, str] = {}

    def of_folder(self, path: str | os.PathLike[str]) -> str:
        """The path of a folder or a file."""
        text = os.fspath(path)
        if text not in self._known:
            self._known[text] = self._find(text)
        return self._known[text]

    def of_file(self, path: str | os.PathLike[str]) -> str:
        """The path of a file; quick where that of its folder was asked for."""
        above, name = os.path.split(path)
        if name in ("", os.curdir, os.pardir):  # no file
            return self.of_folder(path)
        folder = self.of_folder(above)
        return name if folder == os.curdir else f"{folder.rstrip('/')}/{name}"

    def _find(self, text: str) -> str:
        try:
            path = _without_turns(text)
            shared = os.path.commonpath([path, self.folder])
            path = os.path.join(os.path.realpath(shared), os.path.relpath(path, shared))
            return os.path.relpath(path, self._real).replace(os.sep, "/")
        except ValueError:  # another drive on Windows
            return Path(text).absolute().as_posix()


def path_from(path: str | os.PathLike[str], folder: str | os.PathLike[str]) -> str:
    """A path relative to a folder, see `Places`."""
    return Places(folder).of_folder(path)


def _without_turns(path: str) -> str:
    """The absolute path of the same place without ``..``."""
    parts = Path(path).parts
    if os.pardir not in parts:
        return os.path.abspath(path)
    last = len(parts) - parts[::-1].index(os.pardir)
    return os.path.abspath(os.path.join(os.path.realpath(Path(*parts[:last])), *parts[last:]))


def _is_unchanged(known: Json, path: Path) -> bool:
    now = os.stat(path)
    # who reads a pipe may wait for ever
    if not stat.S_ISREG(now.st_mode) or now.st_size != known["size"]:
        return False
    return bool(now.st_mtime_ns == known["modified"] or _digest(path) == known["sha256"])


def _describe(path: Path, may_change: bool) -> Json:
    status = os.stat(path)
    is_recent = may_change and time.time_ns() - status.st_mtime_ns < RECENT
    return {
        "size": status.st_size,
        "modified": 0 if is_recent else status.st_mtime_ns,
        "sha256": _digest(path),
    }


def digest_rest(file: BinaryIO) -> str:
    """The sha256 of what is left to read of a file."""
    digest = hashlib.sha256()
    while chunk := file.read(CHUNK):
        digest.update(chunk)
    return digest.hexdigest()


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return digest_rest(file)
