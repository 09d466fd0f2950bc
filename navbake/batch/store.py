"""Accesses the files of a batch, on this machine or on a store that fsspec knows.

Errors name the file.
"""

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

from navbake.batch.scene_row import FileState
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError, printable
from navbake.files import check_regular, scratch_folder, write_whole
from navbake.formats.source import import_extra
from navbake.types import Json

Folder: TypeAlias = Path | str
"""A folder: a Path of this machine, or the URL of one on a store."""

# a URL's scheme, of at least two letters (`C://` is a path of Windows), and the rest
URL_PATTERN = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://(.*)", re.DOTALL)
URL_IN_TEXT = re.compile(r"[A-Za-z][A-Za-z0-9+.-]{1,40}://[^\s'\"<>]+")
LOCAL_SCHEMES = ("file", "local")  # schemes of this machine's own files
WEB_SCHEMES = ("http", "https")  # a query (`?…`) may follow the path; folders have no listing
# Schemes whose uploads are atomic. On other stores, a file is written under a temporary name and
# then moved; on an object store, that would be a second upload.
OBJECT_STORES = ("s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oss", "oci", "obs", "memory")
# where a store's entry of a file has a fingerprint: a digest or a version, else a time of change
VERSION_KEYS = (
    *("etag", "md5hash", "md5", "content_md5", "content-md5", "sha", "digest", "generation"),
    *("lastmodified", "last_modified", "last-modified", "mtime", "modified", "updated", "created"),
)
# number of an operating system's error if there is no room for a file -> what a user can do
FULL_DISK_REMEDIES = {
    errno.ENOSPC: "free space",
    getattr(errno, "EDQUOT", errno.ENOSPC): "free space",  # Windows has no quotas
    errno.EROFS: "make it writable",
}


_allowed_hosts: set[str] = set()  # allowed hosts in lower case, see `allow_hosts`


class DiskFullError(NavbakeError):
    """Raised when an output folder has no room for more files."""


class MissingFileError(NavbakeError):
    """Raised when a file is missing."""


# ---------------------------------------------------------------- URLs


def is_url(path: object) -> bool:
    """Return whether a path is the URL of a file on a store.

    A ``file://`` URL isn't one, since its file is on this machine.
    """
    match = URL_PATTERN.match(path) if isinstance(path, str) else None
    return match is not None and match[1].lower() not in LOCAL_SCHEMES


def _is_web(url: str) -> bool:
    return is_url(url) and url.partition("://")[0].lower() in WEB_SCHEMES


def strip_file_scheme(path: str) -> str:
    """Return the path in a URL such as ``file:///a/b``; other paths and URLs stay as they are."""
    url_match = URL_PATTERN.match(path)
    return url_match[2] if url_match is not None and url_match[1].lower() in LOCAL_SCHEMES else path


def as_folder(path: str | os.PathLike[str]) -> Folder:
    """Convert a path or URL to a `Folder`; a slash at the end of a URL is dropped."""
    plain_path = strip_file_scheme(os.fspath(path))
    return plain_path.rstrip("/") if is_url(plain_path) else Path(plain_path)


def parent(path: str) -> Folder:
    """Return the folder that a file is in; `path` is a path or a URL."""
    if not is_url(path):
        return Path(path).parent
    return _without_query(path).rpartition("/")[0]


def join(folder: Folder, name: str) -> str:
    """Join a name to a folder; a name that is a URL or an absolute path stays as it is.

    Raises a ConfigError if the name leads out of the folder's store.
    """
    name = strip_file_scheme(name)
    if is_url(name) or os.path.isabs(name):
        return name
    if isinstance(folder, Path):
        return str(folder / name)
    scheme, _, store_path = folder.partition("://")
    store_host = store_path.partition("/")[0]
    store_path = posixpath.normpath(posixpath.join(store_path, name))
    if store_path.partition("/")[0] != store_host:
        raise ConfigError(f"expected a path within {without_secrets(folder)}, got {name}")
    return f"{scheme}://{store_path}"


def without_secrets(url: str) -> str:
    """Return a URL without its password and query, for messages and the index.

    On the web, the user is left out, too. A path stays as it is.
    """
    url_match = URL_PATTERN.match(url)
    if url_match is None:
        return url
    authority, slash, path = _without_query(url).partition("://")[2].partition("/")
    user, at_sign, host = authority.rpartition("@")
    # on the web, the user may be a secret token
    user = (
        "" if url_match[1].lower() in WEB_SCHEMES or not at_sign else f"{user.partition(':')[0]}@"
    )
    return f"{url_match[1]}://{user}{host}{slash}{path}"


def _without_query(url: str) -> str:
    return url.partition("?")[0] if _is_web(url) else url


def allow_hosts(hosts: Iterable[str]) -> None:
    """Allow lists, settings and redirects on the web to lead to these hosts, in this process."""
    _allowed_hosts.update(map(str.lower, hosts))


def check_host(url: str, trusted_urls: Iterable[str]) -> None:
    """Check that the host of a URL is allowed, so that a list on the web can't name any host.

    Args:
        url: a URL, or a path, which is always allowed.
        trusted_urls: URLs that the user gave. Allowed are their hosts and those of `allow_hosts`.

    Raises:
        NavbakeError: the URL is on the web, and on a host that isn't allowed.
    """
    url_host = _find_web_host(url)
    allowed_hosts = {*map(_find_web_host, trusted_urls), *_allowed_hosts}
    if _is_web(url) and url_host not in allowed_hosts:
        expected = " or ".join(sorted(filter(None, allowed_hosts))) or "no host"
        raise NavbakeError(
            f"expected a file of {expected}, got "
            f"{without_secrets(url)}: --allow-hosts {url_host} lets lists and redirects lead there"
        )


def _find_web_host(url: str) -> str:
    return (urlsplit(url).hostname or "") if _is_web(url) else ""


@cache
def _web_client_options() -> Json:
    """Return options for fsspec's web client, by which redirects lead to allowed hosts only."""
    import aiohttp  # fsspec's web client needs it; no extra of navbake installs it

    async def check_redirect(
        session: aiohttp.ClientSession,
        context: object,
        request: aiohttp.TraceRequestRedirectParams,
    ) -> None:
        target_url = urljoin(str(request.url), request.response.headers.get("Location", ""))
        check_host(target_url, [str(request.url)])

    trace_config = aiohttp.TraceConfig()
    trace_config.on_request_redirect.append(check_redirect)
    return {"trace_configs": [trace_config]}


# ---------------------------------------------------------------- files, here and on stores


def check_inside(folder: Folder, path: Folder) -> None:
    """Raise a NavbakeError if a path in a local output folder is a link that leads out of it."""
    if isinstance(folder, Path):
        real_path = Path(os.path.realpath(path))
        if not real_path.is_relative_to(os.path.realpath(folder)):
            actual_text = f"got a link to {real_path}: remove it, or choose another folder"
            raise NavbakeError(f"expected {path} in the output folder {folder}, {actual_text}")


def read_file(path: str | Path) -> bytes:
    """Read a whole file; raises a NavbakeError if it can't be read."""
    with _name_file_in_errors("read", path):
        if isinstance(path, str) and is_url(path):
            filesystem, store_path = _open_store(path)
            return bytes(filesystem.cat_file(store_path))
        check_regular(path)
        return Path(path).read_bytes()


def write_file(folder: Folder, name: str, content: bytes | Iterable[bytes]) -> None:
    """Write a file atomically from bytes, or from pieces of bytes.

    Raises:
        DiskFullError: the folder has no room.
        NavbakeError: the file can't be written for another reason.
    """
    with _name_file_in_errors("write", folder):
        if isinstance(folder, Path):
            check_inside(folder, folder / name)
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            write_whole(content, folder / name)
            return
        content = content if isinstance(content, bytes) else b"".join(content)
        filesystem, path = _open_store(f"{folder}/{name}")
        if folder.partition("://")[0].lower() in OBJECT_STORES:
            filesystem.pipe_file(path, content)
            return
        parent_path = path.rpartition("/")[0]
        temporary_path = f"{parent_path}/.navbake-{os.urandom(8).hex()}.tmp"
        filesystem.makedirs(parent_path, exist_ok=True)
        try:
            filesystem.pipe_file(temporary_path, content)
            with suppress(FileNotFoundError):  # some stores don't move over existing files
                filesystem.rm_file(path)
            filesystem.mv(temporary_path, path)
        except BaseException:
            with suppress(Exception):
                filesystem.rm_file(temporary_path)
            raise


def remove_files(folder: Folder, names: Iterable[str]) -> None:
    """Remove files from a folder, in the given order; missing files are skipped."""
    with _name_file_in_errors("write", folder):
        for name in names:
            with suppress(FileNotFoundError, NotADirectoryError):
                if isinstance(folder, Path):
                    (folder / name).unlink()
                else:
                    filesystem, path = _open_store(f"{folder}/{name}")
                    filesystem.rm_file(path)


def list_file_sizes(folder: str) -> dict[str, int]:
    """List the files in a folder of a store and its subfolders: path -> size [bytes].

    The paths are relative to the folder.
    """
    with _name_file_in_errors("list", folder):
        filesystem, folder_path = _open_store(folder)
        filesystem.invalidate_cache()  # another process may have written since the last listing
        try:
            store_entries = filesystem.find(folder_path, detail=True)
        except FileNotFoundError:
            return {}
        folder_path_length = len(folder_path.rstrip("/"))
        return {
            store_path[folder_path_length:].lstrip("/"): store_entry["size"]
            for store_path, store_entry in store_entries.items()
        }


def match_files(pattern: str) -> list[str]:
    """Return the URLs of the files that a pattern with ``*``, ``?`` or ``[`` matches, sorted.

    If a file has exactly the pattern as its name, only this file is returned. Hidden files, whose
    names begin with a dot, are left out.
    """
    with _name_file_in_errors("list", pattern):
        filesystem, path = _open_store(pattern)
        if filesystem.exists(path):
            return [pattern]
        find_hidden_part = re.compile(r"/\.").search
        store_entries = filesystem.glob(path, detail=True)
        store_paths = sorted(
            name for name, store_entry in store_entries.items() if store_entry["type"] == "file"
        )
        store_path = path.lstrip("/")  # fsspec's paths have no scheme, and often no host
        url_prefix = pattern.removesuffix(store_path)
        urls = [url_prefix + name.lstrip("/") for name in store_paths if not find_hidden_part(name)]
        return (
            urls
            if pattern.endswith(store_path)
            else [*map(filesystem.unstrip_protocol, store_paths)]
        )


@lru_cache(maxsize=1 << 16)
def _digest(path: str, size: int, modified_ns: int) -> str:
    """Return the sha256 of a file; it is cached, as scenes share files.

    The size and the time of change are arguments so that a changed file is read again.
    """
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while chunk := file.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()


def describe_file(path: Path) -> FileState:
    """Return the size and the sha256 of a local file."""
    file_status = os.stat(path)
    digest = _digest(str(path), file_status.st_size, file_status.st_mtime_ns)
    return {"size": file_status.st_size, "sha256": digest}


# ---------------------------------------------------------------- scenes of stores


class Mirror(ExitStack):
    """A temporary folder with copies of files on stores, each at its path on the store.

    It implements `scene_files.Files`: a file is copied when it is read. Local files aren't copied.
    """

    def __init__(self, trusted_urls: Iterable[str] = ()) -> None:
        """Make an empty mirror; for `trusted_urls` see `check_host`."""
        super().__init__()
        self._trusted_urls = list(trusted_urls)
        self._folder: Path | None = None  # made for the first file
        # path in the folder -> URL; for the root of each store, and for files
        self._urls: dict[Path, str] = {}
        # path of a listed folder on its store -> name of a file there -> the store's entry of it
        self._listings: dict[str, dict[str, Any]] = {}
        # path in the folder -> the store's entry of the file; None if the store doesn't have it
        self.entries: dict[Path, Mapping[str, Any] | None] = {}

    def local_path(self, url: str) -> Path:
        """Return the path of a store's file in the temporary folder; the file isn't copied yet."""
        if self._folder is None:
            self._folder = Path(os.path.realpath(self.enter_context(scratch_folder())))
        scheme, _, authority_path = without_secrets(url).partition("://")
        authority, _, path = authority_path.partition("/")
        store_root = self._folder / scheme / authority
        self._urls[store_root] = "/".join(_without_query(url).split("/")[:3])
        self._urls[store_root / path] = url
        return store_root / path

    def url_of(self, path: Path) -> str | None:
        """Return the URL of a path in the folder; None for a path outside of it."""
        path = Path(os.path.abspath(path))
        for ancestor_path in (path, *path.parents) if self._urls else ():
            if ancestor_path in self._urls:
                return "/".join([self._urls[ancestor_path], *path.relative_to(ancestor_path).parts])
        return None

    def has(self, path: Path) -> bool:
        """Return whether a file exists, on its store or on this machine."""
        return self._find_entry(path) is not None

    def ensure_local(self, path: Path) -> None:
        """Copy a file from its store, unless it is copied already or is on this machine."""
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
        path = self.local_path(name)
        self.ensure_local(path)
        return path

    def describe(self, path: Path) -> FileState:
        """Return the size and a fingerprint of a file: the store's tag, or else its sha256."""
        store_entry = self._find_entry(path) or {}
        entry_values = {
            key.lower(): value for key, value in store_entry.items() if value not in (None, "")
        }
        version_tag = next(
            (f"{key}:{entry_values[key]}" for key in VERSION_KEYS if key in entry_values), None
        )
        if version_tag is None or entry_values.get("size") is None:
            self.ensure_local(path)
            return describe_file(path)
        return {"size": entry_values["size"], "tag": version_tag}

    def translate_paths(self, text: str) -> str:
        """Replace the mirror's local paths in a text by the URLs of the files on their stores."""
        return re.sub(re.escape(f"{self._folder}{os.sep}") + r"([\w+.-]+)[/\\]", r"\1://", text)

    def _find_entry(self, path: Path) -> Mapping[str, Any] | None:
        """Return the store's entry of a file, {} for a local file; None if it doesn't exist."""
        url = self.url_of(path)
        if url is None:
            return {} if os.path.isfile(path) else None
        path = Path(os.path.abspath(path))
        if path not in self.entries:
            self.entries[path] = self._look_up(url)
        return self.entries[path]

    def _look_up(self, url: str) -> Mapping[str, Any] | None:
        """Ask a store for its entry of a file; None if the file doesn't exist.

        Except on the web, the file's whole folder is listed, and the listing is kept.
        """
        with _name_file_in_errors("read", url):
            filesystem, path = _open_store(url)
            folder, _, name = path.rpartition("/")
            store_entry: Mapping[str, Any] | None = None
            with suppress(FileNotFoundError, NotADirectoryError):
                if _is_web(url):  # the web has no listings
                    store_entry = filesystem.info(path)
                else:
                    if folder not in self._listings:
                        self._listings[folder] = {}  # it stays empty if the folder is missing
                        self._listings[folder] = {
                            posixpath.basename(file_entry["name"]): file_entry
                            for file_entry in filesystem.ls(folder, detail=True)
                        }
                    store_entry = self._listings[folder].get(name)
            return (
                store_entry
                if store_entry is not None and store_entry.get("type", "file") == "file"
                else None
            )


# ---------------------------------------------------------------- errors


def find_disk_full_error(error: BaseException | None) -> OSError | None:
    """Find the error of a full disk among an error and its causes; None if there is none.

    That is an OSError whose `errno` is a key of `FULL_DISK_REMEDIES`.
    """
    while error is not None:
        if isinstance(error, OSError) and error.errno in FULL_DISK_REMEDIES:
            return error
        error = error.__cause__
    return None


def make_write_error(destination: str, error: OSError) -> NavbakeError:
    """Return the error to raise for a failed write; a DiskFullError if there is no room.

    Args:
        destination: completes the text ``cannot write …``: ``into out``, for example.
        error: the error of the operating system.
    """
    reason = error.strerror or str(error)
    message = f"cannot write {destination}: {reason}"
    if error.errno in FULL_DISK_REMEDIES:
        remedy = FULL_DISK_REMEDIES[error.errno]
        return DiskFullError(f"{message}: {remedy} and run the same command again")
    return NavbakeError(message)


def _open_store(url: str) -> tuple[Any, str]:
    """Return the fsspec file system of a URL, and the path in it."""
    fsspec_core = import_extra("fsspec.core", "batch", f"{url.partition('://')[0]}://")
    options: Json = {}
    if _is_web(url):
        try:
            options["client_kwargs"] = _web_client_options()
        except ImportError as error:
            raise MissingDependencyError("https:// needs aiohttp: pip install aiohttp") from error
    filesystem, path = fsspec_core.url_to_fs(url, **options)
    return filesystem, str(path)


@contextmanager
def _name_file_in_errors(action: str, path: Folder) -> Iterator[None]:
    """Turn errors of the with statement into NavbakeErrors that name the file, without passwords.

    Args:
        action: what is done to the file, for errors: ``read``, ``write`` or ``list``.
        path: the file or folder.

    Raises:
        DiskFullError: there is no room to write.
        MissingFileError: the file is missing.
        MissingDependencyError: fsspec needs a package that isn't installed.
        NavbakeError: another error; NavbakeErrors and MemoryErrors stay as they are.
    """
    shown_path = without_secrets(str(path))
    try:
        yield
    except (NavbakeError, MemoryError):
        raise
    except Exception as error:  # stores' libraries raise many types
        disk_full_error = find_disk_full_error(error) if action == "write" else None
        if action == "write" and not is_url(path) and isinstance(error, OSError):
            raise make_write_error(f"into {shown_path}", error) from error
        if disk_full_error is not None:
            raise make_write_error(f"into {shown_path}", disk_full_error) from error
        # if the URL has a password, the store's error may contain it, and isn't shown
        shown_cause = None if shown_path != str(path) else error
        if isinstance(error, FileNotFoundError):
            raise MissingFileError(
                f"cannot {action} {shown_path}: there is no such file"
            ) from shown_cause
        if shown_cause is None:
            reason = type(error).__name__
        else:
            error_text = " ".join(str(error).split()) or type(error).__name__
            error_text = URL_IN_TEXT.sub(lambda match: without_secrets(match[0]), error_text)
            reason = printable(error_text[:400])
        # an ImportError of fsspec names the missing package
        error_type = MissingDependencyError if isinstance(error, ImportError) else NavbakeError
        raise error_type(f"cannot {action} {shown_path}: {reason}") from shown_cause
