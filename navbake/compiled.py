"""Kernels: functions that numba compiles when they are first called, and keeps on disk.

`kernel` makes what Python calls, `part` what only kernels call: it becomes code of theirs, and a
call from Python would crash. Both are `numba.njit` with options.

Compiled code lies in a folder for each state of a module's source and of all that it imports from
the package, so that no change leaves old code in use; see `cache_folder` for where. Where nothing
can be written, kernels are compiled in memory.

The first kernel of a bake that is compiled has all others that bakes call compiled, too, in
two or more processes: ``kernels.json`` lists them with the types of their arguments, which numba
would know at the first call only. `scripts/list_kernels.py` writes it; an entry that is out of date
costs time, and nothing else. What takes long is announced by the logger ``navbake.compiled``.
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
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import contextmanager, suppress
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


class KernelList(NamedTuple):
    """The kernels that bakes call, in the order of their first calls, and all others."""

    bake: list[Entry]
    others: list[Entry]


@cache
def read_list() -> KernelList:
    """Read the list of kernels."""
    found = json.loads(LIST.read_text(encoding="utf-8"))
    return KernelList(*([Entry(*entry) for entry in found[key]] for key in KernelList._fields))


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
    if not rest:
        return scalar
    return types.Array(scalar, int(rest[0]), rest[1], readonly="readonly" in rest)


def list_cold(entries: Iterable[Entry]) -> list[Entry]:
    """The entries of kernels that lack code on disk for some of their types."""
    entries = list(entries)
    asked = Counter(entry.name for entry in entries)
    cold = set()
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
    found = read_list()
    entries = [*found.bake, *(found.others if everything else [])]
    if cache_folder() is not None:
        _first.compile(entries, watch)
    return sorted({entry.name for entry in list_cold(entries)})


class _FirstCompile(event.Listener):
    """Has all kernels that a bake will call compiled when the first one is, and says so."""

    def __init__(self) -> None:
        self.depth = 0  # how many functions are being compiled, one for the sake of another
        self._told: set[str] = set()  # the rooms of the package that a line has spoken of

    def on_start(self, event: Any) -> None:
        """Runs before numba compiles a function, whoever's it is."""
        self.depth += 1
        own = "{0.__module__}.{0.__name__}".format(event.data["dispatcher"])
        if self.depth > 1 or not own.startswith(f"{PACKAGE}."):
            return
        found = read_list()
        own = own.removeprefix(f"{PACKAGE}.")
        if any(entry.name == own for entry in found.bake):
            self.compile([entry for entry in found.bake if entry.name != own])
        else:
            room = own.partition(".")[0] + "."
            self.tell(list_cold(each for each in found.others if each.name.startswith(room)), 1)

    def on_end(self, event: Any) -> None:
        """Runs after numba compiled a function, or failed to."""
        self.depth -= 1

    def compile(
        self, entries: Sequence[Entry], watch: Callable[[int, int], None] | None = None
    ) -> None:
        """Compile what is cold: this process from the first entry on, others from the last."""
        place = cache_folder()
        cold = list_cold(entries)
        if place is None or not cold:
            self.tell(cold, 1)
            return
        is_python = Path(sys.executable or "").name.lower().startswith("python")
        count = min(num_cores(), MOST_PROCESSES, len(cold)) if is_python else 1
        self.tell(cold, count)
        with _locked(place / "compiling.lock"):
            left = deque(list_cold(cold))  # another process may have compiled some
            helpers = [threading.Thread(target=_help, args=(left,)) for _ in range(count - 1)]
            for helper in helpers:
                helper.daemon = True
                helper.start()
            self.depth += 1
            try:
                while left:
                    with suppress(IndexError):  # a helper took the last one
                        left.popleft().compile()
                    if watch is not None:
                        watch(len(cold) - len(left), len(cold))
            finally:
                left.clear()  # as after Ctrl-C
                self.depth -= 1
            for helper in helpers:
                helper.join()

    def tell(self, cold: Sequence[Entry], processes: int) -> None:
        """Log how long compiling takes, unless that is less than a second or was said."""
        seconds = sum(entry.seconds for entry in cold) / (1 + 0.8 * (processes - 1))
        about = f"about {seconds:.0f} s" if processes > 1 else f"up to {seconds:.0f} s"
        line = f"compiling for this machine, once: {about}"
        if cache_folder() is None:
            line = (
                f"compiling in memory: {about}, in each process anew, as no folder for compiled "
                f"code can be written: {REMEDY}"
            )
        room = cold[0].name.partition(".")[0] if cold else ""
        if seconds >= 1 and room not in self._told:
            self._told.add(room)
            LOGGER.warning(line)


# what may take minutes is printed where nobody has set up logging
if not LOGGER.handlers:
    _printer = logging.StreamHandler()
    _printer.addFilter(lambda record: not logging.getLogger().handlers)
    _printer.setFormatter(logging.Formatter("navbake: %(message)s"))
    LOGGER.addHandler(_printer)
_first = _FirstCompile()
event.register("numba:compile", _first)


@contextmanager
def _locked(path: Path) -> Any:
    """Hold a lock between processes, if that can be had."""
    lock = filelock.FileLock(path)
    with suppress(filelock.Timeout, OSError, NotImplementedError):
        lock.acquire(timeout=PATIENCE)
    try:
        yield
    finally:
        lock.release()


def _help(left: deque[Entry]) -> None:
    """Have another process compile entries from the last one on; it ends when this one does."""
    # modules are found where this process finds them, and not in the current folder first
    path = [*filter(None, sys.path), str(ROOT.parent)]
    code = f"import sys; sys.path[:] = {path!r}; from {__name__} import serve; serve()"
    place = cache_folder()
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(place and place.parent),
        # messages are made and dropped by the hundred, and colouring them takes a tenth of the time
        "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1",
    }
    with (
        suppress(OSError, IndexError),
        subprocess.Popen(
            [sys.executable, "-c", code],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        ) as process,
    ):
        assert process.stdin is not None and process.stdout is not None
        while True:
            process.stdin.write(json.dumps(left.pop()) + "\n")
            process.stdin.flush()
            if not process.stdout.readline():
                return


def serve() -> None:
    """Compile the entries that stdin has, one a line, and print a line after each."""
    _first.depth = 1  # each entry is given for the sake of another process
    for line in sys.stdin:
        Entry(*json.loads(line)).compile()
        print(flush=True)


def num_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
