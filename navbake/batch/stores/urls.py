"""URLs of files: which path is one, what it is made of, and how it is shown."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import NamedTuple, TypeAlias

from navbake.errors import ConfigError

Folder: TypeAlias = Path | str
"""A folder: a Path of this machine, or the URL of one on a store."""

# `C://` is none; `simplecache::s3://` is one, to be refused
URL = re.compile(r"((?:[A-Za-z0-9+.-]+::)*[A-Za-z][A-Za-z0-9+.-]+)://(.*)", re.DOTALL)
HERE = ("file", "local")  # schemes of this machine's own files
WEB = ("http", "https")  # a query (`?…`) may follow the path, and nothing can be written


class Parts(NamedTuple):
    """What a URL is made of.

    Attributes:
        scheme: as `s3`.
        authority: the bucket, or the host; may hold a user and a password.
        path: the names of folders and of the file.
        query: of a URL of the web: what follows the path, ``?`` included.
    """

    scheme: str
    authority: str
    path: tuple[str, ...]
    query: str = ""

    @property
    def root(self) -> str:
        """The URL without its path: what no relative path leaves."""
        return f"{self.scheme}://{self.authority}"

    @property
    def text(self) -> str:
        """The URL, without its query."""
        return "/".join((self.root, *self.path))


def is_url(path: object) -> bool:
    """Whether something is the URL of a file on a store; `file://` is this machine's own."""
    found = URL.match(path) if isinstance(path, str) else None
    return found is not None and found[1].lower() not in HERE


def plain_path(path: str) -> str:
    """The path that a URL such as ``file:///a/b`` stands for, as fsspec reads it; others stay."""
    found = URL.match(path)
    if found is None or found[1].lower() not in HERE:
        return path
    has_drive = os.name == "nt" and re.match(r"/[A-Za-z]:", found[2])
    return found[2][1:] if has_drive else found[2]


def as_folder(path: str | os.PathLike[str]) -> Folder:
    """A folder as this package keeps it: the URL without a slash at its end, or a Path."""
    text = plain_path(os.fspath(path))
    return split_url(text).text if is_url(text) else Path(text)


def split_url(url: str) -> Parts:
    """Take a URL apart.

    Raises:
        ConfigError: it names several file systems (``zip://…::s3://…``), or its path has a part
            that is no name: empty, ``.``, ``..``.
    """
    found = URL.match(url)
    assert found is not None, "callers ask `is_url`"
    if "::" in url:
        raise ConfigError(
            f"expected a URL of one file system, got {shown(url)}: unpack archives, and leave "
            "caches to the system"
        )
    scheme, (rest, mark, query) = found[1].lower(), (found[2], "", "")
    if scheme in WEB:
        rest, mark, query = rest.partition("?")
    authority, _, path = rest.partition("/")
    names = tuple(path.rstrip("/").split("/")) if path.rstrip("/") else ()
    for name in names:
        if name in ("", ".", "..") or "\0" in name or (os.name == "nt" and "\\" in name):
            raise ConfigError(f"expected names between the slashes of {shown(url)}, got {name!r}")
    return Parts(scheme, authority, names, mark + query)


def parent(url: str) -> str:
    """The URL of the folder that a file is in."""
    parts = split_url(url)
    return parts._replace(path=parts.path[:-1]).text


def join(folder: Folder, name: str, place: str) -> str:
    """The path of what a file calls `name`, from the file's folder.

    What a file on a store names must be on a store, too: whoever wrote it may not read this
    machine's files, nor let it ask another kind of server.

    Args:
        folder: the file's folder.
        name: a path relative to it, or a URL; of a file on this machine also an absolute path.
        place: where the name stands, for the message.

    Raises:
        ConfigError: the name leads out of the store, or to another kind of store.
    """
    if isinstance(folder, Path):
        path = plain_path(name)
        return path if is_url(path) else os.path.join("" if folder == Path() else folder, path)
    base = split_url(folder)
    if is_url(name) and split_url(name).scheme == base.scheme:
        return name
    is_relative = URL.match(name) is None and not name.startswith(("/", "\\"))
    names = [*base.path]
    for part in name.split("/") if is_relative else ():
        if part == ".." and not names:
            is_relative = False
        elif part == "..":
            names.pop()
        elif part not in ("", "."):
            names.append(part)
    if not is_relative or re.match(r"[A-Za-z]:", name):
        raise ConfigError(
            f"expected a path from the folder of {place} or a {base.scheme}:// URL, got "
            f"{shown(name)!r}: what is on a store names no file elsewhere"
        )
    return base._replace(path=tuple(names)).text


def shown(url: str) -> str:
    """A URL as messages and the index show it: without a password, and without a query."""
    found = URL.match(url)
    if found is None:
        return url
    scheme, (authority, slash, path) = found[1], found[2].partition("/")
    user, at, host = authority.rpartition("@")
    if at and scheme.lower() in WEB:  # services take a token as the user
        authority = host
    elif at:
        authority = f"{user.partition(':')[0]}@{host}"
    if scheme.lower() in WEB:
        path = path.partition("?")[0]
    return f"{scheme}://{authority}{slash}{path}"


def secrets_of(url: str) -> list[str]:
    """What `shown` leaves out of a URL, for messages of others that hold it."""
    found = URL.match(url)
    if found is None:
        return []
    authority, _, path = found[2].partition("/")
    user = authority.rpartition("@")[0]
    secrets = [user if found[1].lower() in WEB else user.partition(":")[2]]
    if found[1].lower() in WEB:
        secrets.append(path.partition("?")[2])
    return [secret for secret in secrets if secret]
