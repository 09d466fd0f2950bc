"""Kernels: functions that numba compiles when they are first called, and keeps on disk.

`kernel` makes what Python calls, `part` what only kernels call: it becomes code of theirs, and a
call from Python would crash. Both are `numba.njit` with options.

Compiled code lies in a folder for each state of a module's source and of all that it imports from
the package, so that no change leaves old code in use; see `cache_folder` for where. Where nothing
can be written, kernels are compiled in memory.

The first kernel of a bake that is compiled has all others that bakes call compiled, too, in some
processes: ``kernels.json``, which `scripts/list_kernels.py` writes, has the types of their
arguments. An entry that is out of date costs time, and nothing else.
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
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numba
from numba.core import event

from navbake.lazy import lazy

filelock = lazy("filelock")  # for what is compiled alone

LOGGER = logging.getLogger(__name__)
PACKAGE = __name__.partition(".")[0]
ROOT = Path(__file__).parent
LIST = ROOT / "kernels.json"
REMEDY = "set NUMBA_CACHE_DIR to a folder that can be written"
PATIENCE = 300.0  # how long to wait for another process that compiles the same kernels [s]
MOST_PROCESSES = 4  # that compile side by side: parts of the work build on each other
KERNELS: list[Any] = []
"""All kernels that have been imported; of numba's, as `njit` returned them."""

# Functions that allocate no arrays do without reference counts, which cost a fifth of a bake of
# 100 rooms: an option that numba has but does not document. Their callers keep the arrays alive.
UNCOUNTED: Any = {"_nrt": False}
# As in numpy, a division by zero raises nothing; no function is called by ctypes
OPTIONS: Any = {"error_model": "numpy", "no_cfunc_wrapper": True}
part: Any = partial(numba.njit, no_cpython_wrapper=True, **OPTIONS)

_config_lock = threading.Lock()


def kernel(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Compile a function that Python calls; kernels may call it, too.

    Args:
        options: of `numba.njit`.
    """
    if function is None:
        return partial(kernel, **options)
    place = cache_folder()
    name = function.__module__
    own = place and str(place / f"{name.removeprefix(PACKAGE + '.')}-{digest_sources(name)}")
    with _config_lock:  # numba reads where its cache is when a function is made
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, own
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
    """A kernel of the list.

    Attributes:
        name: its module and name, without the package's.
        seconds: how long compiling it took where the list was made [s].
        types: of its arguments: "float64 2 C" for an array, a list for a tuple, an object with the
            name of its class for a named one.
    """

    name: str
    seconds: float
    types: list[Any]

    def find(self) -> Any:
        """Import the kernel."""
        module, _, name = self.name.rpartition(".")
        return getattr(importlib.import_module(f"{PACKAGE}.{module}"), name)

    def compile(self) -> None:
        """Compile the kernel, or load what is on disk; entries that are out of date do nothing."""
        try:
            self.find().compile(tuple(map(decode_type, self.types)))
        except Exception as error:  # whoever calls the kernel compiles it, and says what is wrong
            LOGGER.debug(f"{LIST.name} is out of date: {self.name}: {error}")


@cache
def read_list() -> tuple[list[Entry], list[Entry]]:
    """Read the list of kernels: those that bakes call, in the order of first calls, and others."""
    found = json.loads(LIST.read_text(encoding="utf-8"))
    return [Entry(*entry) for entry in found["bake"]], [Entry(*entry) for entry in found["others"]]


def decode_type(value: Any) -> Any:
    """Make one of numba's types of what the list has for it."""
    types = numba.types
    if isinstance(value, dict):
        ((path, fields),) = value.items()
        module, _, name = path.rpartition(".")
        cls = getattr(importlib.import_module(f"{PACKAGE}.{module}"), name)
        return types.BaseTuple.from_types([decode_type(field) for field in fields], cls)
    if isinstance(value, list):
        return types.BaseTuple.from_types([decode_type(each) for each in value])
    name, *rest = value.split()
    scalar = types.boolean if name == "bool" else getattr(types, name)
    return types.Array(scalar, int(rest[0]), rest[1], "readonly" in rest) if rest else scalar


def list_cold(entries: Iterable[Entry]) -> list[Entry]:
    """The entries of kernels that lack code on disk for some of their types."""
    entries = list(entries)
    # a function that stands there twice with the same types has code on disk once
    kinds = {(entry.name, json.dumps(entry.types)) for entry in entries}
    asked, cold = Counter(name for name, _ in kinds), set()
    for entry in {entry.name: entry for entry in entries}.values():
        with suppress(ImportError, AttributeError):  # the list is out of date
            found = entry.find()
            kept = Path(found.stats.cache_path or "").glob(f"*.{found.__name__}-*.nbc")
            if found.stats.cache_path is None or len(list(kept)) < asked[entry.name]:
                cold.add(entry.name)
    return [entry for entry in entries if entry.name in cold]


def warm_up(everything: bool = False, watch: Callable[[int, int], None] | None = None) -> list[str]:
    """Compile what bakes call, or all kernels, unless that is done; one process at a time does it.

    Args:
        watch: is called with how many kernels of how many are done.

    Returns:
        The names of the kernels that have no code on disk after all.
    """
    bake, others = read_list()
    entries = [*bake, *(others if everything else [])]
    if cache_folder() is not None:
        _compile(entries, watch)
    return sorted({entry.name for entry in list_cold(entries)})


def _compile(entries: list[Entry], watch: Callable[[int, int], None] | None = None) -> None:
    """Compile what is cold: this process the first entries, others the rest, in the same time."""
    place, cold = cache_folder(), list_cold(entries)
    if place is None or not cold:
        _announce(cold, 1)
        return
    # an executable that holds Python is none
    is_python = Path(sys.executable or "").name.lower().startswith("python")
    count = (
        min(numba.config.NUMBA_DEFAULT_NUM_THREADS, MOST_PROCESSES, len(cold)) if is_python else 1
    )
    _announce(cold, count)
    # modules are found where this process finds them, and not in the current folder first
    path = [*filter(None, sys.path), str(ROOT.parent)]
    code = f"import sys; sys.path[:] = {path!r}; from {__name__} import serve; serve()"
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(place.parent),
        # messages are made and dropped by the hundred, and colouring them takes a tenth of the time
        "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1",
    }
    lock = filelock.FileLock(place / "compiling.lock", timeout=PATIENCE)
    with suppress(filelock.Timeout, OSError, NotImplementedError), lock:
        cold = list_cold(cold)  # another process may have compiled some
        shares: list[list[Entry]] = [[] for _ in range(count)]
        before, each = 0.0, sum(entry.seconds for entry in cold) / count
        for entry in cold:
            shares[min(int(before / each), count - 1)].append(entry)
            before += entry.seconds
        helpers = []
        _first.depth += 1
        try:
            for share in shares[1:]:
                helper = subprocess.Popen(
                    [sys.executable, "-c", code], env=environment,
                    stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )  # fmt: skip
                helpers.append(helper)
                assert helper.stdin is not None
                with helper.stdin as names:
                    names.write(json.dumps(share).encode())
            for done, entry in enumerate(shares[0], 1):
                entry.compile()
                if watch is not None:
                    watch(done, len(shares[0]))
            for helper in helpers:
                helper.wait()
            for entry in list_cold(cold):  # what a helper could not
                entry.compile()
        finally:
            _first.depth -= 1
            for helper in helpers:
                helper.kill()  # after an error here, as by Ctrl-C
                helper.wait()


def serve() -> None:
    """Compile the entries that stdin has."""
    _first.depth = 1  # each is given for the sake of another process
    for entry in json.load(sys.stdin):
        Entry(*entry).compile()


_announced: set[str] = set()  # rooms of the package


def _announce(cold: Sequence[Entry], processes: int) -> None:
    """Log how long compiling takes, unless that is less than a second or was said of the room."""
    seconds = sum(entry.seconds for entry in cold) / (1 + 0.8 * (processes - 1))
    about = f"about {seconds:.0f} s" if processes > 1 else f"up to {seconds:.0f} s"
    line = f"compiling for this machine, once: {about}"
    if cache_folder() is None:
        line = (
            f"compiling in memory: {about}, in each process anew, as no folder for compiled "
            f"code can be written: {REMEDY}"
        )
    room = cold[0].name.partition(".")[0] if cold else ""
    if seconds >= 1 and room not in _announced:
        _announced.add(room)
        LOGGER.warning(line)


class _FirstCompile(event.Listener):
    """Has all kernels that a bake will call compiled when the first one is."""

    depth = 0  # how many functions are being compiled, one for the sake of another

    def on_start(self, event: Any) -> None:
        """Runs before numba compiles a function, whoever's it is."""
        self.depth += 1
        own = "{0.__module__}.{0.__name__}".format(event.data["dispatcher"])
        if self.depth > 1 or not own.startswith(f"{PACKAGE}."):
            return
        (bake, others), own = read_list(), own.removeprefix(f"{PACKAGE}.")
        if any(entry.name == own for entry in bake):
            _compile([entry for entry in bake if entry.name != own])
        else:
            room = own.partition(".")[0] + "."
            _announce(list_cold(each for each in others if each.name.startswith(room)), 1)

    def on_end(self, event: Any) -> None:
        """Runs after numba compiled a function, or failed to."""
        self.depth -= 1


_first = _FirstCompile()
event.register("numba:compile", _first)
# what may take minutes is printed where nobody has set up logging
if not LOGGER.handlers:
    _printer = logging.StreamHandler()
    _printer.addFilter(lambda record: not logging.getLogger().handlers)
    _printer.setFormatter(logging.Formatter("navbake: %(message)s"))
    LOGGER.addHandler(_printer)
