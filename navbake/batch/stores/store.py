"""Files on stores that fsspec knows: what is there, read, written, removed.

Only this module loads fsspec. All that a store refuses is a NavbakeError that names the file.
"""

from __future__ import annotations

import logging
import os
import re
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from navbake.batch.file_states import digest_rest
from navbake.batch.full import no_room, why_full
from navbake.batch.stores.urls import WEB, parent, secrets_of, shown, split_url
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError, printable
from navbake.types import Json

INSTALL = 'pip install "navbake[batch]"'
# Schemes whose files appear whole when their upload ends. On others, a file is written under
# another name and moved: on an object store, that would be a second upload.
OBJECT_STORES = ("s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oss", "oci", "obs", "memory")
# What proves that a file has not changed: a digest or a version that the store keeps, else a time
TAGS = ("etag", "md5hash", "md5", "content_md5", "content-md5", "digest", "generation")
TIMES = (
    *("lastmodified", "last_modified", "last-modified"),
    *("mtime", "modified", "updated", "modify", "created"),
)
RECENT = 60.0  # age below which a time proves nothing: it may be coarse, and clocks differ [s]
FEW = 3  # files of a folder that are asked for one by one, before the folder is listed
MANY = 16  # folders in a folder that are asked for, from which on that one is listed with all in it
AT_ONCE = 16  # calls
MISSING = "there is no such file"
URL_IN_TEXT = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://[^\s'\"<>]+")
LOG = logging.getLogger("navbake")
MAGIC = re.compile(r"[*?\[]")
Value = TypeVar("Value")


class Entry(NamedTuple):
    """What a store says of a file.

    Attributes:
        size: bytes; None where the store doesn't say.
        tag: what is another when the content is; None where nothing proves that.
    """

    size: int | None
    tag: str | None


def read_file(url: str, limit: int) -> bytes:
    """The content of a file of at most `limit` bytes."""
    content = read_if_there(url, limit)
    if content is None:
        raise NavbakeError(f"cannot read {shown(url)}: {MISSING}")
    return content


def read_if_there(url: str, limit: int) -> bytes | None:
    """As `read_file`; None where there is no such file."""
    with _telling("read", url):
        system, path = _open(url)
        try:
            with system.open(path, "rb") as file:
                content = bytes(file.read(limit + 1))
        except FileNotFoundError:
            return None
    if len(content) > limit:
        raise ConfigError(f"{shown(url)} is too large: expected {limit:,} bytes at most")
    return content


def read_files(urls: Sequence[str]) -> list[bytes]:
    """The contents of small files of one store, read several at once where the store can."""
    return _do_at_once("read", urls, lambda system, path: bytes(system.cat_file(path)))


def digest_file(url: str) -> str:
    """The sha256 of a file's content."""
    with _telling("read", url):
        system, path = _open(url)
        with system.open(path, "rb") as file:
            return digest_rest(file)


def fetch_files(places: Mapping[str, Path]) -> None:
    """Copy files of stores to paths, several at once where the store can."""
    by_root: dict[str, list[str]] = defaultdict(list)
    for url in places:
        by_root[split_url(url).root].append(url)
    for urls in by_root.values():
        with _telling("read", urls[0]):
            system, _ = _open(urls[0])
            paths = [_open(url)[1] for url in urls]
            for url in urls:
                places[url].parent.mkdir(parents=True, exist_ok=True)
            system.get(paths, [str(places[url]) for url in urls])


def write_file(url: str, content: bytes) -> None:
    """Write a file whole: others see the old content or the new, and nothing between."""
    with _telling("write", url):
        system, path = _open(url)
        if split_url(url).scheme in OBJECT_STORES:
            system.pipe_file(path, content)
            return
        folder = path.rpartition("/")[0]
        beside = f"{folder}/.navbake-{os.urandom(8).hex()}.tmp"
        system.makedirs(folder, exist_ok=True)
        try:
            system.pipe_file(beside, content)
            try:
                system.mv(beside, path)
            except OSError:  # some move nothing over what is there
                if not system.exists(path):
                    raise
                system.rm_file(path)
                system.mv(beside, path)
        except BaseException:
            with suppress(Exception):
                system.rm_file(beside)
            raise


def write_first(url: str, content: bytes) -> bool:
    """Write a file unless there is one; whether it was written.

    Of several writers, one is told True where the store can decide that; else it may be several.
    """
    with _telling("write", url):
        system, path = _open(url)
        if system.exists(path):
            return False
        if split_url(url).scheme in OBJECT_STORES:
            try:
                system.pipe_file(path, content, mode="create")
                return True
            except FileExistsError:
                return False
            except Exception as error:  # a store without such uploads says so in its own way
                LOG.debug("%s takes no exclusive upload: %s", shown(url), _text(error, url))
    write_file(url, content)
    return True


def remove_files(urls: Iterable[str]) -> None:
    """Remove files, one after another; one that isn't there is removed already."""
    for url in urls:
        with _telling("remove", url):
            _remove(*_open(url))


def remove_all(urls: Sequence[str]) -> None:
    """Remove files of one store, in any order, several at once where the store can."""
    _do_at_once("remove", urls, _remove)


def _remove(system: Any, path: str) -> None:
    with suppress(FileNotFoundError):
        system.rm_file(path)


def match_files(pattern: str) -> list[str]:
    """The URLs of the files that a pattern with ``*``, ``?`` or ``[`` matches, sorted.

    ``**`` between slashes stands for any number of folders. What begins with a dot is hidden.
    All that is below the pattern's fixed part is listed at once: fsspec's own search asks for
    each folder by itself.
    """
    parts = split_url(pattern)
    fixed = next(n for n, name in enumerate(parts.path) if MAGIC.search(name))
    base = parts._replace(path=parts.path[:fixed]).text
    wanted = parts.path[fixed:]
    is_flat = len(wanted) == 1 and wanted[0] != "**"
    names = list_folder(base) if is_flat else list_tree(base)
    with _telling("list", pattern):
        from fsspec.utils import glob_translate  # the extra `batch`

        matches = re.compile(glob_translate("/".join(wanted))).match
    is_hidden = re.compile(r"(^|/)\.").search
    return [f"{base}/{name}" for name in sorted(names) if matches(name) and not is_hidden(name)]


def is_pattern(url: str) -> bool:
    """Whether a URL has what makes a pattern in its path, and no file is called so."""
    parts = split_url(url)
    if not any(MAGIC.search(name) for name in parts.path):
        return False
    with _telling("read", url):
        system, path = _open(url)
        return not system.exists(path)


def list_tree(url: str, *, is_own: bool = False) -> dict[str, Entry]:
    """All files in a folder and the folders in it, by their paths from it; {} if it isn't there.

    Args:
        is_own: nobody else writes into it, so that the time of a recent change counts.
    """
    with _telling("list", url):
        system, path = _open(url)
        try:
            found = system.find(path, detail=True)
        except FileNotFoundError:
            return {}
        return {_below(path, name): _entry(info, is_own) for name, info in found.items()}


def list_folder(url: str, *, is_own: bool = False) -> dict[str, Entry]:
    """The files in a folder by their names; {} if it isn't there. See `list_tree`."""
    with _telling("list", url):
        system, path = _open(url)
        return _list_folder(system, path, is_own)


class Listing:
    """What stores say of files, each asked for once, and by folder where there are many."""

    def __init__(self) -> None:
        self._folders: dict[str, dict[str, Entry]] = {}
        self._trees: dict[str, dict[str, Entry]] = {}
        self._single: dict[str, Entry | None] = {}
        self._asked: Counter[str] = Counter()

    def entry(self, url: str) -> Entry | None:
        """What there is to say of a file; None where there is none."""
        folder, name = parent(url), split_url(url).path[-1]
        for above in _folders_above(folder) if self._trees else ():
            if above in self._trees:
                return self._trees[above].get(url[len(above) + 1 :])
        if folder not in self._folders and self._asked[folder] >= FEW:
            self.load([folder])
        if folder in self._folders:
            return self._folders[folder].get(name)
        if url not in self._single:
            self._asked[folder] += split_url(url).scheme not in WEB  # which have no listings
            self._single[url] = self._info(url)
        return self._single[url]

    def load(self, folders: Collection[str]) -> None:
        """List folders, several at once; one in which many are is listed with all in it.

        Folders of the web have no listings.
        """
        folders = [url for url in folders if split_url(url).scheme not in WEB]
        inside = Counter(parent(url) for url in folders if split_url(url).path)
        trees = {url for url, count in inside.items() if count >= MANY}
        trees = {url for url in trees if not trees & {*_folders_above(parent(url))} - {url}}
        for url in sorted(trees):
            self._trees[url] = list_tree(url)
        left = [url for url in folders if not trees & {*_folders_above(url)}]
        self._folders |= dict(zip(left, _do_at_once("list", left, _list_folder), strict=True))

    def _info(self, url: str) -> Entry | None:
        with _telling("read", url):
            system, path = _open(url)
            try:
                info = system.info(path)
            except FileNotFoundError:
                return None
            return _entry(info) if info.get("type", "file") == "file" else None


def state_of(entry: Entry, content: Json) -> Json:
    """What the index notes of a file: its size and sha256, and the store's tag."""
    return {"size": content["size"], "tag": entry.tag, "sha256": content["sha256"]}


def is_unchanged(known: Json, entry: Entry | None, url: str) -> bool:
    """Whether a file has the content that `state_of` noted.

    One of the same size and tag is taken for the same; of another one of that size, the content
    is read.
    """
    if entry is None or entry.size not in (None, known["size"]):
        return False
    is_tagged = entry.tag is not None and entry.tag == known["tag"]
    return bool(is_tagged or digest_file(url) == known["sha256"])


def hide_secrets(text: str, urls: Iterable[str]) -> str:
    """A text of others without the passwords and queries of some URLs.

    Libraries write a URL in another spelling than it was given in, so all that look like one are
    shown as `shown` does.
    """
    text = URL_IN_TEXT.sub(lambda found: shown(found[0]), text)
    for url in urls:
        for secret in secrets_of(url):
            text = text.replace(secret, "…")
    return text


def _open(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path there."""
    parts = split_url(url)
    try:
        from fsspec.core import url_to_fs  # the extra `batch`
    except ImportError as error:
        raise MissingDependencyError(
            f"paths such as {parts.scheme}:// need fsspec: {INSTALL}"
        ) from (error)
    system, path = url_to_fs(parts.text + parts.query)
    system.invalidate_cache()  # fsspec keeps listings, and others may have written since
    return system, str(path)


@contextmanager
def _telling(doing: str, url: str) -> Iterator[None]:
    """Turn what a store refuses into an error that names the file, and no password."""
    try:
        yield
    except (NavbakeError, MemoryError):
        raise
    except Exception as error:  # file systems raise what their libraries raise
        why = why_full(error) if doing == "write" else None
        if why is not None:  # object stores are never full, and say other things of quotas
            raise no_room(shown(url), why) from (None if secrets_of(url) else error)
        is_package = isinstance(error, ImportError)  # fsspec's for such URLs
        kind = MissingDependencyError if is_package else NavbakeError
        # --verbose prints causes as they are
        cause = None if secrets_of(url) else error
        raise kind(f"cannot {doing} {shown(url)}: {_text(error, url)}") from cause


def _text(error: Exception, url: str) -> str:
    if isinstance(error, FileNotFoundError):
        return MISSING
    if isinstance(error, PermissionError) and not str(error):
        return "no permission"
    text = " ".join(str(error).split()) or type(error).__name__
    return printable(hide_secrets(text, [url])[:400])


def _do_at_once(doing: str, urls: Sequence[str], do: Callable[[Any, str], Value]) -> list[Value]:
    """Do something with each of some files or folders, in threads where the store can."""
    if not urls:
        return []
    with _telling(doing, urls[0]):
        opened = [_open(url) for url in urls]
        is_async = all(getattr(system, "async_impl", False) for system, _ in opened)
        with ThreadPoolExecutor(AT_ONCE if is_async else 1) as pool:
            return [*pool.map(lambda each: do(*each), opened)]


def _list_folder(system: Any, path: str, is_own: bool = False) -> dict[str, Entry]:
    try:
        found = system.ls(path, detail=True)
    except (FileNotFoundError, NotADirectoryError):
        return {}
    files = [info for info in found if info["type"] == "file"]
    # a store lists a file as a folder of itself
    return {
        _below(path, info["name"]): _entry(info, is_own)
        for info in files
        if info["name"].rstrip("/") != path.rstrip("/")
    }


def _below(folder: str, path: str) -> str:
    """A path of a file system, from a folder."""
    return path[len(folder.rstrip("/")) :].lstrip("/")


def _folders_above(url: str) -> Iterator[str]:
    """A folder and all that it is in."""
    parts = split_url(url)
    for end in range(len(parts.path), -1, -1):
        yield parts._replace(path=parts.path[:end]).text


def _entry(info: Mapping[str, Any], is_own: bool = False) -> Entry:
    facts = {key.lower(): value for key, value in info.items() if value not in (None, "")}
    size = facts.get("size")
    tag = next((f"{key}:{facts[key]}" for key in TAGS if key in facts), None)
    if tag is None:
        tag = next((_tag_of_time(facts[key], is_own) for key in TIMES if key in facts), None)
    return Entry(None if size is None else int(size), tag)


def _tag_of_time(value: Any, is_own: bool) -> str | None:
    if isinstance(value, datetime):
        value = value.timestamp()
    if not isinstance(value, int | float):
        return f"time:{value}"
    is_recent = not is_own and time.time() - value < RECENT
    return None if is_recent else f"time:{value:.6f}"
