"""Kernels: functions that numba compiles once for a machine, and keeps on disk.

`kernel` makes what Python calls, `subkernel` what only kernels call: it becomes code of theirs, and
a call from Python would crash. Both are `numba.njit` with options.

Compiled code lies in a folder for each state of a module's source and of all that it imports from
the package, so that no change leaves old code in use; see `cache_folder` for where. Where nothing
can be written, kernels are compiled in memory.

A bake, or whatever else calls many kernels, begins with `ensure_compiled`: what is cold is compiled
in a few processes. ``kernels.json``, which `scripts/list_kernels.py` writes, has the types of the
kernels' arguments. An entry that is out of date costs time, and nothing else.
"""

# numba has few types
# mypy: disable-error-code="no-untyped-call,attr-defined"

from __future__ import annotations

import atexit
import hashlib
import importlib
import json
import logging
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numba

from navbake.lazy import lazy

filelock = lazy("filelock")  # for what is compiled alone

LOGGER = logging.getLogger(__name__)
PACKAGE = __name__.partition(".")[0]
ROOT = Path(__file__).parent
LIST = ROOT / "kernels.json"
REMEDY = "set NUMBA_CACHE_DIR to a folder that can be written"
MOST_PROCESSES = 4  # that compile side by side: kernels that share code are one's
STEP = 5.0  # until the first line that says how far compiling is; then twice as long each [s]
KERNELS: list[Any] = []
"""All kernels that have been imported; of numba's, as `njit` returned them."""

# Functions that allocate no arrays do without reference counts, which cost a fifth of a bake of
# 100 rooms: an option that numba has but does not document. Their callers keep the arrays alive.
_OPTIONS = getattr(getattr(numba.core, "options", None), "DefaultOptions", None)
NO_REFCOUNT: Any = {"_nrt": False} if hasattr(_OPTIONS, "_nrt") else {}
# As in numpy, a division by zero raises nothing; no function is called by ctypes
OPTIONS: Any = {"error_model": "numpy", "no_cfunc_wrapper": True}
subkernel: Any = partial(numba.njit, no_cpython_wrapper=True, **OPTIONS)

_config_lock = threading.Lock()


def kernel(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Compile a function that Python calls, and kernels may; `options` are those of `njit`."""
    if function is None:
        return partial(kernel, **options)
    place = cache_folder()
    name = function.__module__
    own = place and str(place / f"{name.removeprefix(PACKAGE + '.')}-{digest_sources(name)}")
    with _config_lock:  # numba reads where its cache is when a function is made
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = own
        try:
            made = numba.njit(cache=place is not None, **OPTIONS, **options)(function)
        finally:
            numba.config.CACHE_DIR = before
    KERNELS.append(made)
    return made


@cache
def cache_folder() -> Path | None:
    """The folder of compiled code, for all states of the sources; None where there is none.

    It is the first one that can be written of NUMBA_CACHE_DIR, or else the package's own
    ``__pycache__`` and the user's cache. A folder that can only be read, as in a container that was
    warmed up, is used by way of a temporary folder of links.
    """
    given = os.environ.get("NUMBA_CACHE_DIR")
    user = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    tops = [Path(given)] if given else [ROOT / "__pycache__", Path(user)]
    places = [top.absolute() / f"{PACKAGE}-kernels" for top in tops]
    filled = next((place for place in places if place.is_dir()), None)
    for place in places:
        with suppress(OSError):
            place.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=place):
                return place
    with suppress(OSError):
        if filled is not None:
            temporary = Path(tempfile.mkdtemp(prefix=f"{PACKAGE}-kernels-"))
            atexit.register(_remove, temporary, os.getpid())
            for path in filled.rglob("*.nb[ic]"):
                link = temporary / filled.name / path.relative_to(filled)
                link.parent.mkdir(parents=True, exist_ok=True)
                link.symlink_to(path)
            return temporary / filled.name
    return None


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:  # and no fork of it
        shutil.rmtree(folder, ignore_errors=True)


@cache
def _read_module(name: str) -> tuple[bytes, frozenset[str]]:
    """A module's source, and the modules of the package that it imports something from."""
    path = ROOT.parent.joinpath(*name.split("."))
    source = (path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_bytes()
    found = re.findall(rb"^\s*(?:from|import) (" + PACKAGE.encode() + rb"[\w.]*)", source, re.M)
    return source, frozenset(each.decode() for each in found)


@cache
def digest_sources(module: str) -> str:
    """Hash the sources of a module and of all that it imports from the package."""
    seen: dict[str, bytes] = {}
    left = [module]
    while left:
        name = left.pop()
        if name not in seen:
            seen[name], imported = _read_module(name)
            left += imported
    digest = hashlib.sha256()
    for name in sorted(seen):
        digest.update(b"%s\0%s\0" % (name.encode(), seen[name]))
    return digest.hexdigest()[:16]


class Entry(NamedTuple):
    """A kernel of the list."""

    name: str  # its module and name, without the package's
    seconds: float  # about how long compiling it takes [s]
    # of its arguments: "float64 2 C" for an array, a list for a tuple, an object with the name of
    # its class for a named one
    types: list[Any]

    def compile(self) -> None:
        """Compile the kernel, or load what is on disk; entries that are out of date do nothing."""
        try:
            find(self.name).compile(tuple(map(decode_type, self.types)))
        except Exception as error:  # whoever calls the kernel compiles it, and says what is wrong
            LOGGER.debug(f"{LIST.name} is out of date: {self.name}: {error}")


def find(name: str) -> Any:
    """Import what has a name in a module of the package."""
    module, _, name = name.rpartition(".")
    return getattr(importlib.import_module(f"{PACKAGE}.{module}"), name)


@cache
def read_list() -> tuple[list[Entry], list[Entry]]:
    """Read the list of kernels: those that bakes call, and others."""
    found = json.loads(LIST.read_text(encoding="utf-8"))
    return [Entry(*entry) for entry in found["bake"]], [Entry(*entry) for entry in found["others"]]


def decode_type(value: Any) -> Any:
    """Make one of numba's types of what the list has for it."""
    if isinstance(value, dict):
        ((name, fields),) = value.items()
        return numba.types.BaseTuple.from_types(
            [decode_type(field) for field in fields], find(name)
        )
    if isinstance(value, list):
        return numba.types.BaseTuple.from_types([decode_type(each) for each in value])
    name, *rest = value.split()
    scalar = getattr(numba.types, "boolean" if name == "bool" else name)
    return numba.types.Array(scalar, int(rest[0]), rest[1], "readonly" in rest) if rest else scalar


def list_cold(entries: Iterable[Entry]) -> list[Entry]:
    """The entries of kernels that lack code on disk for some of their types."""
    entries = list(entries)
    cold = set()
    for name, types in Counter(entry.name for entry in entries).items():
        with suppress(ImportError, AttributeError):  # the list is out of date
            stats = (found := find(name)).stats
            own = f"*.{found.__name__}-*.nbc"
            if not stats.cache_path or len(list(Path(stats.cache_path).glob(own))) < types:
                cold.add(name)
    return [entry for entry in entries if entry.name in cold]


@cache
def ensure_compiled(*rooms: str) -> None:
    """Compile what bakes call, or kernels whose names begin with `rooms`; once in a process."""
    bake, others = read_list()
    _compile([each for each in [*bake, *others] if each.name.startswith(rooms)] if rooms else bake)


def warm_up() -> list[str]:
    """Compile all kernels, unless that is done; returns names of those without code on disk."""
    entries = [entry for entries in read_list() for entry in entries]
    _compile(entries)
    return sorted({entry.name for entry in list_cold(entries)})


def _compile(entries: list[Entry]) -> None:
    """Compile what is cold in some processes, and log how far that is; one caller at a time."""
    place = cache_folder()
    cold = list_cold(entries)
    begin = time.monotonic()
    # an executable that holds Python is none
    is_python = Path(sys.executable or "").name.lower().startswith("python")
    count = min(numba.config.NUMBA_DEFAULT_NUM_THREADS, MOST_PROCESSES) if is_python else 1
    about = f"{max(map(_cost, _share(cold, count)), default=0):.0f} s"
    if place is None:
        why = f"as no folder for compiled code can be written: {REMEDY}"
        LOGGER.warning(f"compiling in memory: about {about}, in each process anew, {why}")
    elif cold:
        LOGGER.warning(f"compiling for this machine, once: about {about}")
    if place is None or not cold or not is_python:
        return  # what is cold is compiled when it is first called

    pause = STEP

    def wait(for_it: Callable[..., Any]) -> None:
        nonlocal pause
        while True:
            try:
                for_it(timeout=pause)
                return
            except (filelock.Timeout, subprocess.TimeoutExpired):
                done = len(cold) - len(list_cold(cold))
                taken = time.monotonic() - begin
                LOGGER.warning(f"compiled {done} of {len(cold)} functions after {taken:.0f} s")
                pause *= 2  # into a file or a pipe, each would be a line

    lock = filelock.FileLock(place / "compiling.lock")
    helpers = list[subprocess.Popen[bytes]]()
    try:
        with suppress(OSError, NotImplementedError):  # of a file system without locks
            wait(lock.acquire)
        for share in _share(list_cold(cold), count):  # another process may have compiled some
            helpers.append(_start(share, place))
        for helper in helpers:
            wait(helper.wait)
    finally:
        for helper in helpers:
            helper.kill()  # after an error here, as by Ctrl-C
            helper.wait()
        lock.release()


def _cost(entries: list[Entry]) -> float:
    return sum(entry.seconds for entry in entries)


def _share(entries: list[Entry], count: int) -> list[list[Entry]]:
    """Share entries out evenly; those of a module, which have code in common, stay together."""
    families: dict[str, list[Entry]] = {}
    for entry in entries:
        families.setdefault(entry.name.rpartition(".")[0], []).append(entry)
    shares: list[list[Entry]] = [[] for _ in range(count)]
    for family in sorted(families.values(), key=_cost, reverse=True):
        min(shares, key=_cost).extend(family)
    return [share for share in shares if share]


def _start(entries: list[Entry], place: Path) -> subprocess.Popen[bytes]:
    """Start a process that compiles entries."""
    # modules are found where this process finds them, and not in the current folder first
    path = [*filter(None, sys.path), str(ROOT.parent)]
    code = f"import sys; sys.path[:] = {path!r}; from {__name__} import serve; serve()"
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(place.parent),
        # messages are made and dropped by the hundred, and colouring them takes a tenth of the time
        "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1",
    }
    started = subprocess.Popen(
        [sys.executable, "-c", code], env=environment,
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    assert started.stdin is not None
    with started.stdin as names:
        names.write(json.dumps(entries).encode())
    return started


def serve() -> None:
    """Compile the entries that stdin has."""
    for entry in json.load(sys.stdin):
        Entry(*entry).compile()


# what may take minutes is printed where nobody has set up logging
if not LOGGER.handlers:
    _printer = logging.StreamHandler()
    _printer.addFilter(lambda record: not logging.getLogger().handlers)
    _printer.setFormatter(logging.Formatter("navbake: %(message)s"))
    LOGGER.addHandler(_printer)
