"""Kernels: functions that numba compiles once for a machine, and stores on disk.

`kernel` decorates what Python calls, `subkernel` what only kernels call: numba compiles it into
them, and a call from Python would crash. Both are `numba.njit` with options.

Compiled code is stored in `cache_folder`. There, a module has a folder for each state of its source
and of all modules of the package that it imports. So after a change, old code isn't used any more.
If no folder can be written, kernels are compiled in memory.

numba unpickles what it finds in a cache, so whoever writes there runs code as the user. Therefore
only folders are used that the user or root owns and nobody else may write, see `navbake.owners`.

A bake, and any other code that calls many kernels, begins with `ensure_compiled`: it compiles the
kernels without code on disk in a few processes. ``kernels.json``, which `scripts/list_kernels.py`
writes, has the types of the kernels' arguments. An entry that doesn't fit the sources is skipped;
its kernel is compiled when it is first called, which only takes longer.
"""

# numba has few type annotations
# mypy: disable-error-code="no-untyped-call,attr-defined"

from __future__ import annotations

import atexit
import gc
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
from typing import Any, NamedTuple, TypeVar, cast, overload

import numba

from navbake.lazy import lazy
from navbake.owners import ROOT_ID, find_other_writer, find_other_writer_inside
from navbake.processes import end_with_parent

filelock = lazy("filelock")  # only needed to compile

LOG = logging.getLogger(__name__)
PACKAGE = __name__.partition(".")[0]
PACKAGE_FOLDER = Path(__file__).parent
PACKAGE_CACHE = PACKAGE_FOLDER / "__pycache__"
CACHE_NAME = f"{PACKAGE}-kernels"  # of the folder for compiled code
KERNEL_LIST = PACKAGE_FOLDER / "kernels.json"
CACHE_REMEDY = "set NUMBA_CACHE_DIR to a folder that can be written"
REFUSAL_MESSAGE = (
    "compiled code in {} is not used, as {}, and would run as you; it is kept {}: "
    "set NUMBA_CACHE_DIR to a folder that only you can write, or remove the refused one"
)
# in a module's folder, numba makes a folder for each place of the package; files are in these
CACHE_DEPTH = 2
MAX_PROCESSES = 4  # the most processes that compile at the same time
GARBAGE_THRESHOLD = 200_000  # a process that compiles looks for garbage after so many new objects
# Time until the first message on progress. The time to each later one is twice as long, up to the
# second value [s]
FIRST_PROGRESS_DELAY = 5.0
MAX_PROGRESS_DELAY = 20.0
# How long the rest takes is only said once this share of the functions is compiled
LEAST_DONE_SHARE = 0.2
KERNELS: list[Any] = []
"""The kernels of all modules imported so far; each is the dispatcher that `njit` returned."""

# An option that numba has but does not document: no reference counts, which cost a fifth of a bake
# of 100 rooms. It is for functions that allocate no arrays; their callers keep the arrays alive.
_OPTIONS = getattr(getattr(numba.core, "options", None), "DefaultOptions", None)
NO_REFCOUNT: dict[str, Any] = {"_nrt": False} if hasattr(_OPTIONS, "_nrt") else {}
# as in numpy, a division by zero raises no error; no wrapper is made for calls by ctypes
OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
SUBKERNEL_OPTIONS: dict[str, Any] = {"no_cpython_wrapper": True, **OPTIONS}

Result = TypeVar("Result")
_config_lock = threading.Lock()
_refused_folders: set[Path] = set()  # of which a warning has told


@overload
def kernel(function: Callable[..., Result], /) -> Callable[..., Result]: ...


@overload
def kernel(
    **options: Any,
) -> Callable[[Callable[..., Result]], Callable[..., Result]]: ...


def kernel(function: Callable[..., Any] | None = None, /, **options: Any) -> Callable[..., Any]:
    """Make a kernel of a function: Python code and other kernels may call it.

    Use it as a decorator, with or without options. The function is compiled when it is first
    called, or by `ensure_compiled`.

    Args:
        function: The function; None if the decorator has options.
        **options: Options of `numba.njit`.

    Returns:
        The kernel; a decorator if `function` is None.
    """
    if function is None:
        return partial(kernel, **options)
    folder = _module_folder(function.__module__)
    with _config_lock:  # numba reads the folder of its cache when a function is decorated
        folder_before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = None if folder is None else str(folder)
        try:
            dispatcher = numba.njit(cache=folder is not None, **OPTIONS, **options)(function)
            # if numba can't write there, it takes a folder that nobody has checked
            if folder is not None and not _is_kept_in(folder, dispatcher):
                dispatcher = numba.njit(**OPTIONS, **options)(function)
        finally:
            numba.config.CACHE_DIR = folder_before
    KERNELS.append(dispatcher)
    return cast("Callable[..., Any]", dispatcher)


@overload
def subkernel(function: Callable[..., Result], /) -> Callable[..., Result]: ...


@overload
def subkernel(
    **options: Any,
) -> Callable[[Callable[..., Result]], Callable[..., Result]]: ...


def subkernel(function: Callable[..., Any] | None = None, /, **options: Any) -> Callable[..., Any]:
    """Make a function that only kernels may call: it is compiled into them.

    Use it as a decorator, with or without options.

    Args:
        function: The function; None if the decorator has options.
        **options: Options of `numba.njit`.

    Returns:
        The function for kernels; a decorator if `function` is None.
    """
    if function is None:
        return partial(subkernel, **options)
    return cast("Callable[..., Any]", numba.njit(**SUBKERNEL_OPTIONS, **options)(function))


@cache
def cache_folder() -> Path | None:
    """Return the folder that holds all compiled code; None if no folder can be written.

    The folder is in NUMBA_CACHE_DIR. If that is not set, it is in the package's ``__pycache__``, or
    in the user's cache if that can't be written. If the folder exists but can only be read (for
    example in a container with compiled kernels), a temporary folder with links to its files is
    returned.

    A folder that another user may write is not used, and a warning says so, see `_private_folder`.
    """
    numba_folder = os.environ.get("NUMBA_CACHE_DIR")
    user_folder = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    parent_folders = [Path(numba_folder)] if numba_folder else [PACKAGE_CACHE, Path(user_folder)]
    problem_of_folder: dict[Path, str] = {}
    folder = _find_folder(parent_folders, problem_of_folder)
    if folder is None and problem_of_folder:
        folder = _private_folder()
    for refused_folder, problem in list(problem_of_folder.items())[:1]:
        _warn_of_refusal(refused_folder, problem, folder)
    return folder


def _find_folder(parent_folders: list[Path], problem_of_folder: dict[Path, str]) -> Path | None:
    """Return the first folder for compiled code that can be used; None if none can be.

    Args:
        parent_folders: The folders that it may be in.
        problem_of_folder: Receives the folders that another user may write, and who that is.
    """
    readable_folder: Path | None = None
    for parent in parent_folders:
        folder = Path(os.path.realpath(parent / CACHE_NAME))
        # nobody has asked for a new folder in the package, and looks for code there
        is_awaited = os.path.isdir(folder) or parent != PACKAGE_CACHE
        problem = _claim(folder)
        if problem and is_awaited:
            problem_of_folder[folder] = problem
        if problem:
            continue
        if _is_writable(folder):
            return folder
        if os.path.isdir(folder):
            readable_folder = readable_folder or folder
    return None if readable_folder is None else _link_files(readable_folder)


def _warn_of_refusal(refused_folder: Path, problem: str, folder: Path | None) -> None:
    """Warn once that compiled code in a folder is not used, and say where it is kept instead."""
    if refused_folder in _refused_folders:
        return
    _refused_folders.add(refused_folder)
    storage_text = "in memory" if folder is None else f"in {folder}"
    LOG.warning(REFUSAL_MESSAGE.format(refused_folder, problem, storage_text))


def _claim(folder: Path) -> str:
    """Make a folder for compiled code if that is possible, and no other user may write there.

    Returns:
        Which other user may write there, as `find_other_writer` says; "" if none.
    """
    if problem := find_other_writer(folder):
        return problem
    with suppress(OSError):
        for parent in reversed(folder.parents):
            parent.mkdir(mode=0o755, exist_ok=True)
        is_of_plain_user = hasattr(os, "geteuid") and os.geteuid() != ROOT_ID
        # root compiles for all users
        folder.mkdir(mode=0o700 if is_of_plain_user else 0o755, exist_ok=True)
    return find_other_writer(folder)  # another user may have made it in the meantime


def _is_writable(folder: Path) -> bool:
    """Whether files can be made in a folder."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _link_files(folder: Path) -> Path | None:
    """Return a temporary folder with links to the compiled code in a folder that can't be written.

    None if no temporary folder can be made.
    """
    temporary_folder = _make_temporary_folder()
    if temporary_folder is not None:
        with suppress(OSError):
            for path in folder.rglob("*.nb[ic]"):
                link = temporary_folder / path.relative_to(folder)
                link.parent.mkdir(parents=True, exist_ok=True)
                link.symlink_to(path)
    return temporary_folder


def _make_temporary_folder() -> Path | None:
    """Make a folder for compiled code that is removed when this process ends; None if it can't."""
    try:
        temporary_folder = Path(tempfile.mkdtemp(prefix=f"{CACHE_NAME}-"))
    except OSError:
        return None
    atexit.register(_remove_folder, temporary_folder, os.getpid())
    folder = Path(os.path.realpath(temporary_folder)) / CACHE_NAME
    return None if _claim(folder) else folder


@cache
def _private_folder(refused_folder: Path | None = None) -> Path | None:
    """Return a folder for compiled code where another one is refused.

    It is in the user's home, or else a temporary one; None if there is no such folder.

    Args:
        refused_folder: The refused one, which may be that in the user's home.
    """
    with suppress(RuntimeError):  # no home is known
        folder = Path(os.path.realpath(Path("~/.cache").expanduser() / CACHE_NAME))
        if folder != refused_folder and not _claim(folder) and _is_writable(folder):
            return folder
    return _make_temporary_folder()


@cache
def _module_folder(module: str) -> Path | None:
    """Return the folder for a module's compiled code; None to compile it in memory."""
    folder_name = f"{module.removeprefix(PACKAGE + '.')}-{digest_sources(module)}"
    folder = cache_folder()
    if folder is None:
        return None
    problem = find_other_writer_inside(folder / folder_name, CACHE_DEPTH)
    if not problem:
        return folder / folder_name
    private_folder = _private_folder(folder)
    _warn_of_refusal(folder, problem, private_folder)
    if private_folder is None or find_other_writer_inside(
        private_folder / folder_name, CACHE_DEPTH
    ):
        return None
    return private_folder / folder_name


def _is_kept_in(folder: Path, dispatcher: Any) -> bool:
    """Whether numba keeps a kernel's compiled code in a folder, and not in one of its choice."""
    if not hasattr(dispatcher, "stats"):  # the user has switched numba off
        return True
    path: str | None = dispatcher.stats.cache_path
    return path is not None and path.startswith(f"{folder}{os.sep}")


def _remove_folder(folder: Path, process_id: int) -> None:
    """Remove a folder if this is the process that made it, and not a fork of that process."""
    if os.getpid() == process_id:
        shutil.rmtree(folder, ignore_errors=True)


@cache
def _read_module(name: str) -> tuple[bytes, frozenset[str]]:
    """Return a module's source, and the names of the package's modules that it imports.

    Indented imports don't count: kernels use no names of them.
    """
    path = PACKAGE_FOLDER.parent.joinpath(*name.split("."))
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    source = path.read_bytes()
    pattern = rb"^(?:from|import) (" + PACKAGE.encode() + rb"[\w.]*)"
    imported_names = re.findall(pattern, source, re.M)
    return source, frozenset(module.decode() for module in imported_names)


def read_sources(module: str) -> dict[str, bytes]:
    """Read the source of a module, and those of all package modules that it needs.

    These are the modules that it imports, those that they import, and so on.

    Returns:
        Name of a module -> its source.
    """
    sources: dict[str, bytes] = {}
    pending_modules = [module]
    while pending_modules:
        name = pending_modules.pop()
        if name not in sources:
            sources[name], imported_names = _read_module(name)
            pending_modules += imported_names
    return sources


@cache
def digest_sources(module: str) -> str:
    """Return a hash of the sources of a module and of those that it needs, see `read_sources`."""
    digest = hashlib.sha256()
    for name, source in sorted(read_sources(module).items()):
        digest.update(b"%s\0%s\0" % (name.encode(), source))
    return digest.hexdigest()[:16]


class KernelEntry(NamedTuple):
    """A kernel in the list ``kernels.json``, with one choice of types of its arguments."""

    name: str  #: The kernel's module and name, without the name of the package.
    seconds: float  #: About how long it takes to compile [s].
    #: The types of its arguments: text such as "float64" for a number and "float64 2 C" for an
    #: array; a list of types for a tuple; ``{"class's name": types}`` for a NamedTuple.
    types: list[Any]

    def compile(self) -> None:
        """Compile the kernel for these types, or load its code from disk.

        An entry that doesn't fit the present sources is skipped, with a debug message.
        """
        try:
            import_object(self.name).compile(tuple(map(decode_type, self.types)))
        except Exception as error:  # a call of the kernel compiles it, and raises what is wrong
            LOG.debug(f"{KERNEL_LIST.name} is out of date: {self.name}: {error}")


def import_object(name: str) -> Any:
    """Import a function or class of the package.

    Args:
        name: Its module and name, without the name of the package: ``runtime.search.Search``.
    """
    module, _, name = name.rpartition(".")
    return getattr(importlib.import_module(f"{PACKAGE}.{module}"), name)


@cache
def read_kernel_list() -> tuple[list[KernelEntry], list[KernelEntry]]:
    """Read ``kernels.json``; return the entries that bakes need, and all other entries."""
    entries = json.loads(KERNEL_LIST.read_text(encoding="utf-8"))
    bake_kernels = [KernelEntry(*entry) for entry in entries["bake"]]
    further_kernels = [KernelEntry(*entry) for entry in entries["others"]]
    return bake_kernels, further_kernels


def decode_type(encoded: Any) -> Any:
    """Convert an entry of `KernelEntry.types` to a type of numba's.

    Args:
        encoded: What ``kernels.json`` has for a type: a text such as ``float64`` or ``int32 2 C``
            (an array: dtype, dimensions, layout); a list of types for a tuple; or ``{name: types of
            its fields}`` for a NamedTuple.
    """
    if isinstance(encoded, dict):
        ((name, encoded_fields),) = encoded.items()
        field_types = [decode_type(field) for field in encoded_fields]
        return numba.types.BaseTuple.from_types(field_types, import_object(name))
    if isinstance(encoded, list):
        return numba.types.BaseTuple.from_types(
            [decode_type(encoded_item) for encoded_item in encoded]
        )
    name, *array_words = encoded.split()
    scalar = getattr(numba.types, "boolean" if name == "bool" else name)
    if not array_words:
        return scalar
    num_dimensions = int(array_words[0])
    order = array_words[1]
    return numba.types.Array(scalar, num_dimensions, order, "readonly" in array_words)


def list_uncompiled(entries: Iterable[KernelEntry]) -> list[KernelEntry]:
    """Return the entries whose kernels lack compiled code on disk for some of the entries' types.

    Files are only counted: a kernel with n entries needs n files.
    """
    entries = list(entries)
    uncompiled = set()
    for name, num_types in Counter(entry.name for entry in entries).items():
        with suppress(ImportError, AttributeError):  # the list is out of date
            dispatcher = import_object(name)
            folder = dispatcher.stats.cache_path
            pattern = f"*.{dispatcher.__name__}-*.nbc"
            if not folder or len(list(Path(folder).glob(pattern))) < num_types:
                uncompiled.add(name)
    return [entry for entry in entries if entry.name in uncompiled]


@cache
def ensure_compiled(*prefixes: str) -> None:
    """Compile the kernels that have no code on disk.

    A later call with the same arguments does nothing.

    Args:
        *prefixes: Beginnings of the names of the kernels to compile, such as ``formats.``. Without
            any, the kernels that bakes call are compiled.
    """
    bake_kernels, further_kernels = read_kernel_list()
    if not prefixes:
        _compile(bake_kernels)
        return
    all_kernels = [*bake_kernels, *further_kernels]
    _compile([entry for entry in all_kernels if entry.name.startswith(prefixes)])


def warm_up() -> list[str]:
    """Compile all kernels that have no code on disk.

    Returns:
        The names of kernels that still have none.
    """
    entries = [entry for listed_kernels in read_kernel_list() for entry in listed_kernels]
    _compile(entries)
    return sorted({entry.name for entry in list_uncompiled(entries)})


def _compile(entries: list[KernelEntry]) -> None:
    """Compile the kernels of `entries` that have no code on disk, in a few processes.

    Progress is logged. A lock lets only one process at a time do this. Where no folder can be
    written, or no further Python can be started, nothing is compiled here: each kernel is compiled
    when it is first called.
    """
    folder = cache_folder()
    uncompiled = list_uncompiled(entries)
    start_time = time.monotonic()
    # a program that embeds Python cannot start another Python
    is_python = Path(sys.executable or "").name.lower().startswith("python")
    num_processes = min(numba.config.NUMBA_DEFAULT_NUM_THREADS, MAX_PROCESSES) if is_python else 1
    duration = max(map(_total_seconds, _divide_by_time(uncompiled, num_processes)), default=0)
    if folder is None:
        reason = f"as no folder for compiled code can be written: {CACHE_REMEDY}"
        LOG.warning(f"compiling in memory: about {duration:.0f} s, in each process anew, {reason}")
    elif uncompiled:
        LOG.warning(
            f"compiling for this machine, once: about {duration:.0f} s, more where it is busy "
            "(`navbake warm-up` compiles what all commands need)"
        )
    if folder is None or not uncompiled or not is_python:
        return  # each kernel is compiled when it is first called

    timeout = FIRST_PROGRESS_DELAY

    def wait_with_progress(wait_function: Callable[..., object]) -> None:
        """Call a function with a timeout until it returns in time; log progress at each timeout."""
        nonlocal timeout
        while True:
            try:
                wait_function(timeout=timeout)
                return
            except (filelock.Timeout, subprocess.TimeoutExpired):
                pending = list_uncompiled(uncompiled)
                num_done = len(uncompiled) - len(pending)
                elapsed_time = time.monotonic() - start_time
                text = f"compiled {num_done} of {len(uncompiled)} functions"
                text += f" after {elapsed_time:.0f} s"
                pending_seconds = _total_seconds(pending)
                if num_done >= LEAST_DONE_SHARE * len(uncompiled):
                    # as fast as so far, whatever the list of kernels says of another machine
                    speed = (_total_seconds(uncompiled) - pending_seconds) / elapsed_time
                    text += f": about {pending_seconds / speed:.0f} s left"
                LOG.warning(text)
                timeout = min(2 * timeout, MAX_PROGRESS_DELAY)

    lock = filelock.FileLock(folder / "compiling.lock")
    compile_processes: list[subprocess.Popen[bytes]] = []
    try:
        with suppress(OSError, NotImplementedError):  # of a file system without locks
            wait_with_progress(lock.acquire)
        # another process may have compiled some while this one waited
        for group in _divide_by_time(list_uncompiled(uncompiled), num_processes):
            compile_processes.append(_start_compile_process(group, folder))
        for compile_process in compile_processes:
            wait_with_progress(compile_process.wait)
    finally:
        for compile_process in compile_processes:
            compile_process.kill()  # after an error here, as by Ctrl-C
            compile_process.wait()
        lock.release()


def _total_seconds(entries: list[KernelEntry]) -> float:
    return sum(entry.seconds for entry in entries)


def _divide_by_time(entries: list[KernelEntry], num_processes: int) -> list[list[KernelEntry]]:
    """Divide entries into at most `num_processes` groups that take about equally long to compile.

    The entries of a module stay together: they share code.
    """
    by_module: dict[str, list[KernelEntry]] = {}
    for entry in entries:
        by_module.setdefault(entry.name.rpartition(".")[0], []).append(entry)
    groups: list[list[KernelEntry]] = [[] for _ in range(num_processes)]
    # the slowest module first, each to the group with the least to do
    for module_entries in sorted(by_module.values(), key=_total_seconds, reverse=True):
        min(groups, key=_total_seconds).extend(module_entries)
    return [group for group in groups if group]


def _start_compile_process(entries: list[KernelEntry], folder: Path) -> subprocess.Popen[bytes]:
    """Start a process that compiles entries into a folder."""
    # modules are found where this process finds them, and not in the current folder first
    module_paths = [*filter(None, sys.path), str(PACKAGE_FOLDER.parent)]
    call_code = f"from {__name__} import compile_from_stdin; compile_from_stdin()"
    code = f"import sys; sys.path[:] = {module_paths!r}; {call_code}"
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(folder.parent),
        # numba makes hundreds of messages that nobody sees: colouring takes a tenth of the time
        "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1",
    }
    compile_process = subprocess.Popen(
        [sys.executable, "-c", code],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    assert compile_process.stdin is not None
    with compile_process.stdin as pipe:
        pipe.write(json.dumps(entries).encode())
    return compile_process


def compile_from_stdin() -> None:
    """Compile the entries that stdin holds as JSON, in a process of `_start_compile_process`."""
    end_with_parent()
    os.umask(0o022)  # no other user may write what is made here, see `cache_folder`
    # looking for garbage after each 700 new objects, Python's default, takes a tenth of the time
    gc.set_threshold(GARBAGE_THRESHOLD)
    for entry in json.load(sys.stdin):
        KernelEntry(*entry).compile()


# if the program has not set up logging, messages are printed: compiling may take minutes
if not LOG.handlers:
    _printer = logging.StreamHandler()
    _printer.addFilter(lambda record: not logging.getLogger().handlers)
    _printer.setFormatter(logging.Formatter("navbake: %(message)s"))
    LOG.addHandler(_printer)
