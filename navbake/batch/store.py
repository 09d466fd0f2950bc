"""Files of a batch, on this machine or on a store of fsspec; errors name the file."""

from __future__ import annotations

import errno
import hashlib
import os
import posixpath
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import urljoin, urlsplit

from navbake.errors import ConfigError, MissingDependencyError, NavbakeError, printable
from navbake.files import check_regular, scratch_folder, write_whole
from navbake.formats.source import import_extra
from navbake.types import Json

Folder: TypeAlias = Path | str
"""A folder: a Path of this machine, or the URL of one on a store."""

URL_PATTERN = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://(.*)", re.DOTALL)  # `C://` is none
URL_IN_TEXT = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://[^\s'\"<>]+")
LOCAL_SCHEMES = ("file", "local")  # schemes of this machine's own files
WEB_SCHEMES = ("http", "https")  # a query (`?…`) may follow the path; folders have no listing
# Schemes with atomic uploads. Elsewhere a file is written under another name and moved, which on an
# object store would be a second upload.
OBJECT_STORES = ("s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oss", "oci", "obs", "memory")
# a store's fingerprints of a file: a digest or a version, else a time of change
VERSION_KEYS = (
    *("etag", "md5hash", "md5", "content_md5", "content-md5", "sha", "digest", "generation"),
    *("lastmodified", "last_modified", "last-modified", "mtime", "modified", "updated", "created"),
)
# errors of a full file system, and what is missing
FULL_DISK_REMEDIES = {
    errno.ENOSPC: "free space",
    getattr(errno, "EDQUOT", errno.ENOSPC): "free space",  # Windows has no quotas
    errno.EROFS: "make it writable",
}


_hosts: set[str] = set()  # see `allow_hosts`


class FullError(NavbakeError):
    """Raised when an output folder has no room for more files."""


class MissingFileError(NavbakeError):
    """Raised for a missing file."""


# ---------------------------------------------------------------- URLs


def is_url(path: object) -> bool:
    """Return whether a path is the URL of a file on a store; ``file://`` URLs are local."""
    match = URL_PATTERN.match(path) if isinstance(path, str) else None
    return match is not None and match[1].lower() not in LOCAL_SCHEMES


def _is_web(url: str) -> bool:
    return is_url(url) and url.partition("://")[0].lower() in WEB_SCHEMES


def plain_path(path: str) -> str:
    """Return the path of a URL such as ``file:///a/b``; other paths and URLs stay as they are."""
    match = URL_PATTERN.match(path)
    return match[2] if match is not None and match[1].lower() in LOCAL_SCHEMES else path


def as_folder(path: str | os.PathLike[str]) -> Folder:
    """Return a folder as a URL without a slash at its end, or as a Path if it is local."""
    text = plain_path(os.fspath(path))
    return text.rstrip("/") if is_url(text) else Path(text)


def parent(path: str) -> Folder:
    """Return the folder of a file."""
    if not is_url(path):
        return Path(path).parent
    return _without_query(path).rpartition("/")[0]


def join(folder: Folder, name: str) -> str:
    """Return the path of a name in a folder; a URL or an absolute path stays as it is.

    Raises a ConfigError if the name leads out of the folder's store.
    """
    name = plain_path(name)
    if is_url(name) or os.path.isabs(name):
        return name
    if isinstance(folder, Path):
        return str(folder / name)
    scheme, _, path = folder.partition("://")
    host = path.partition("/")[0]
    path = posixpath.normpath(posixpath.join(path, name))
    if path.partition("/")[0] != host:
        raise ConfigError(f"expected a path within {shown(folder)}, got {name}")
    return f"{scheme}://{path}"


def shown(url: str) -> str:
    """Return a URL without its password and query, to show in messages and the index."""
    match = URL_PATTERN.match(url)
    if match is None:
        return url
    authority, slash, path = _without_query(url).partition("://")[2].partition("/")
    user, at, host = authority.rpartition("@")
    # web services use tokens as users
    user = "" if match[1].lower() in WEB_SCHEMES or not at else f"{user.partition(':')[0]}@"
    return f"{match[1]}://{user}{host}{slash}{path}"


def _without_query(url: str) -> str:
    return url.partition("?")[0] if _is_web(url) else url


def allow_hosts(hosts: Iterable[str]) -> None:
    """Allow lists, settings and redirects on the web to lead to these hosts, in this process."""
    _hosts.update(map(str.lower, hosts))


def check_host(url: str, trusted_urls: Iterable[str]) -> None:
    """Check that a URL that a list or settings on the web name is on a trusted host.

    Args:
        url: the URL that they name.
        trusted_urls: URLs that the user gave. Their hosts are allowed, and those of `allow_hosts`.

    Raises:
        NavbakeError: the URL is on the web, and on a host that isn't allowed.
    """
    host = _host(url)
    hosts = {*map(_host, trusted_urls), *_hosts}
    if _is_web(url) and host not in hosts:
        expected = " or ".join(sorted(filter(None, hosts))) or "no host"
        raise NavbakeError(
            f"expected a file of {expected}, got "
            f"{shown(url)}: --allow-hosts {host} lets lists and redirects lead there"
        )


def _host(url: str) -> str:
    return (urlsplit(url).hostname or "") if _is_web(url) else ""


@cache
def _client_options() -> Json:
    """Options that keep a web client on allowed hosts."""
    import aiohttp  # for fsspec's web client; in no extra

    async def check_redirect(
        session: aiohttp.ClientSession,
        context: object,
        request: aiohttp.TraceRequestRedirectParams,
    ) -> None:
        target = urljoin(str(request.url), request.response.headers.get("Location", ""))
        check_host(target, [str(request.url)])

    trace = aiohttp.TraceConfig()
    trace.on_request_redirect.append(check_redirect)
    return {"trace_configs": [trace]}


# ---------------------------------------------------------------- files, here and on stores


def check_inside(folder: Folder, path: Folder) -> None:
    """Raise a NavbakeError if a path in a local output folder is a link that leads out of it."""
    if isinstance(folder, Path):
        real = Path(os.path.realpath(path))
        if not real.is_relative_to(os.path.realpath(folder)):
            got = f"got a link to {real}: remove it, or choose another folder"
            raise NavbakeError(f"expected {path} in the output folder {folder}, {got}")


def read_file(path: str | Path) -> bytes:
    """Read a whole file; raises a NavbakeError if it can't be read."""
    with _naming("read", path):
        if isinstance(path, str) and is_url(path):
            system, inner = _open_store(path)
            return bytes(system.cat_file(inner))
        check_regular(path)
        return Path(path).read_bytes()


def write_file(folder: Folder, name: str, content: bytes | Iterable[bytes]) -> None:
    """Write a file atomically from bytes, or from pieces of bytes.

    Raises a FullError if the folder has no room, and a NavbakeError if the file can't be written
    for another reason.
    """
    with _naming("write", folder):
        if isinstance(folder, Path):
            check_inside(folder, folder / name)
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            write_whole(content, folder / name)
            return
        content = content if isinstance(content, bytes) else b"".join(content)
        system, path = _open_store(f"{folder}/{name}")
        if folder.partition("://")[0].lower() in OBJECT_STORES:
            system.pipe_file(path, content)
            return
        above = path.rpartition("/")[0]
        beside = f"{above}/.navbake-{os.urandom(8).hex()}.tmp"
        system.makedirs(above, exist_ok=True)
        try:
            system.pipe_file(beside, content)
            with suppress(FileNotFoundError):  # some stores don't move over existing files
                system.rm_file(path)
            system.mv(beside, path)
        except BaseException:
            with suppress(Exception):
                system.rm_file(beside)
            raise


def remove_files(folder: Folder, names: Iterable[str]) -> None:
    """Remove files in the given order; missing files are skipped."""
    with _naming("write", folder):
        for name in names:
            with suppress(FileNotFoundError, NotADirectoryError):
                if isinstance(folder, Path):
                    (folder / name).unlink()
                else:
                    system, path = _open_store(f"{folder}/{name}")
                    system.rm_file(path)


def sizes_below(folder: str) -> dict[str, int]:
    """Return the size of each file below a folder of a store [bytes], by the file's path."""
    with _naming("list", folder):
        system, path = _open_store(folder)
        system.invalidate_cache()  # others may have written since
        try:
            infos = system.find(path, detail=True)
        except FileNotFoundError:
            return {}
        start = len(path.rstrip("/"))
        return {name[start:].lstrip("/"): info["size"] for name, info in infos.items()}


def match_files(pattern: str) -> list[str]:
    """Return the URLs of the files that a pattern with ``*``, ``?`` or ``[`` matches, sorted.

    If a file has exactly the pattern as its name, only this file is returned. Hidden files, whose
    names begin with a dot, are left out.
    """
    with _naming("list", pattern):
        system, path = _open_store(pattern)
        if system.exists(path):
            return [pattern]
        is_hidden = re.compile(r"/\.").search
        infos = system.glob(path, detail=True)
        names = sorted(name for name, info in infos.items() if info["type"] == "file")
        inner = path.lstrip("/")  # a store's paths have no host
        root = pattern.removesuffix(inner)
        urls = [root + name.lstrip("/") for name in names if not is_hidden(name)]
        return urls if pattern.endswith(inner) else [*map(system.unstrip_protocol, names)]


@lru_cache(maxsize=1 << 16)
def _digest(path: str, size: int, modified_ns: int) -> str:
    """The sha256 of a file, cached for scenes that share it."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while chunk := file.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()


def describe_file(path: Path) -> Json:
    """Return the size and the sha256 of a local file."""
    status = os.stat(path)
    digest = _digest(str(path), status.st_size, status.st_mtime_ns)
    return {"size": status.st_size, "sha256": digest}


# ---------------------------------------------------------------- scenes of stores


class Mirror(ExitStack):
    """A temporary folder for copies of stores' files, at their paths on the stores.

    It implements `scene_files.Files`: a file is copied when it is read. Local files stay in place.
    """

    def __init__(self, trusted_urls: Iterable[str] = ()) -> None:
        """Make an empty mirror; `trusted_urls` as in `check_host`."""
        super().__init__()
        self._trusted_urls = list(trusted_urls)
        self._folder: Path | None = None
        self._urls: dict[Path, str] = {}  # of roots of stores, and of files
        self._listed: dict[str, dict[str, Any]] = {}  # stores' entries by folder
        self.entries: dict[Path, Mapping[str, Any] | None] = {}  # of stores, by path

    def place(self, url: str) -> Path:
        """Return the path that a store's file has in the folder, whether or not it is copied."""
        if self._folder is None:
            self._folder = Path(os.path.realpath(self.enter_context(scratch_folder())))
        scheme, _, authority_path = shown(url).partition("://")
        authority, _, path = authority_path.partition("/")
        root = self._folder / scheme / authority
        self._urls[root] = "/".join(_without_query(url).split("/")[:3])
        self._urls[root / path] = url
        return root / path

    def url_of(self, path: Path) -> str | None:
        """Return the URL of a path in the folder; None for a path outside of it."""
        path = Path(os.path.abspath(path))
        for above in (path, *path.parents) if self._urls else ():
            if above in self._urls:
                inner = path.relative_to(above).parts
                return "/".join([self._urls[above], *inner])
        return None

    def has(self, path: Path) -> bool:
        return self._find(path) is not None

    def ensure_local(self, path: Path) -> None:
        """Copy a file from its store unless that is done already."""
        url = self.url_of(path)
        if url is not None and not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(read_file(url))

    def fetch(self, name: str) -> Path:
        """Return the local path of a file, after copying it if it is on a store.

        Raises the errors of `check_host`.
        """
        if not is_url(name):
            return Path(name)
        check_host(name, self._trusted_urls)
        path = self.place(name)
        self.ensure_local(path)
        return path

    def describe(self, path: Path) -> Json:
        """Return the size and a fingerprint of a file: the store's tag, or else its sha256."""
        info = self._find(path) or {}
        facts = {key.lower(): value for key, value in info.items() if value not in (None, "")}
        tag = next((f"{key}:{facts[key]}" for key in VERSION_KEYS if key in facts), None)
        if tag is None or facts.get("size") is None:
            self.ensure_local(path)
            return describe_file(path)
        return {"size": facts["size"], "tag": tag}

    def translate_paths(self, text: str) -> str:
        """Replace the mirror's local paths in a text by the URLs of the files on their stores."""
        return re.sub(re.escape(f"{self._folder}{os.sep}") + r"([\w+.-]+)[/\\]", r"\1://", text)

    def _find(self, path: Path) -> Mapping[str, Any] | None:
        """The store's entry of a file, {} for a local one; None if it doesn't exist."""
        url = self.url_of(path)
        if url is None:
            return {} if os.path.isfile(path) else None
        path = Path(os.path.abspath(path))
        if path not in self.entries:
            self.entries[path] = self._look(url)
        return self.entries[path]

    def _look(self, url: str) -> Mapping[str, Any] | None:
        with _naming("read", url):
            system, path = _open_store(url)
            folder, _, name = path.rpartition("/")
            info: Mapping[str, Any] | None = None
            with suppress(FileNotFoundError, NotADirectoryError):
                if _is_web(url):  # which has no listings
                    info = system.info(path)
                elif folder in self._listed:
                    info = self._listed[folder].get(name)
                else:
                    self._listed[folder] = {}  # where the folder is missing
                    infos = system.ls(folder, detail=True)
                    self._listed[folder] = {
                        posixpath.basename(info["name"]): info for info in infos
                    }
                    info = self._listed[folder].get(name)
            return info if info is not None and info.get("type", "file") == "file" else None


# ---------------------------------------------------------------- errors


def why_full(error: BaseException | None) -> OSError | None:
    """Return the system's "disk full" error among an error and its causes; None if none is."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in FULL_DISK_REMEDIES:
            return error
        error = error.__cause__
    return None


def refused(what: str, error: OSError) -> NavbakeError:
    """Return the error to raise for a failed write; a FullError if there is no room."""
    why = error.strerror or str(error)
    if error.errno in FULL_DISK_REMEDIES:
        remedy = FULL_DISK_REMEDIES[error.errno]
        return FullError(f"cannot write {what}: {why}: {remedy} and run the same command again")
    return NavbakeError(f"cannot write {what}: {why}")


def _open_store(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path there."""
    core = import_extra("fsspec.core", "batch", f"{url.partition('://')[0]}://")
    options: Json = {}
    if _is_web(url):
        try:
            options["client_kwargs"] = _client_options()
        except ImportError as error:
            raise MissingDependencyError("https:// needs aiohttp: pip install aiohttp") from error
    system, path = core.url_to_fs(url, **options)
    return system, str(path)


@contextmanager
def _naming(doing: str, path: Folder) -> Iterator[None]:
    """Turn errors of the system or a store into ones that name the file, without passwords."""
    name = shown(str(path))
    try:
        yield
    except (NavbakeError, MemoryError):
        raise
    except Exception as error:  # stores' libraries raise many types
        full = why_full(error) if doing == "write" else None
        if doing == "write" and not is_url(path) and isinstance(error, OSError):
            raise refused(f"into {name}", error) from error
        if full is not None:
            raise refused(f"into {name}", full) from error
        cause = None if name != str(path) else error  # it may contain the password
        if isinstance(error, FileNotFoundError):
            raise MissingFileError(f"cannot {doing} {name}: there is no such file") from cause
        if cause is None:
            why = type(error).__name__
        else:
            text = " ".join(str(error).split()) or type(error).__name__
            why = printable(URL_IN_TEXT.sub(lambda match: shown(match[0]), text)[:400])
        # fsspec names the missing package
        kind = MissingDependencyError if isinstance(error, ImportError) else NavbakeError
        raise kind(f"cannot {doing} {name}: {why}") from cause
