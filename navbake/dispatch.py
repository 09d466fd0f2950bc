"""How the kernels are compiled, kept on disk, and called.

numba compiles a kernel when it is first called, and keeps the code on disk. Some things that
numba leaves to its users are settled here, for navbake's kernels and no others:

- Where no folder can be written, or a disk is full, code is compiled in memory. A folder that can
  only be read is used where its code is fresh, as in a container that was warmed up.
- Broken files of the cache are replaced.
- Of several processes that need the same code, one compiles it and the others wait. Where there is
  more than one core and much to compile, the first process starts others that compile what it
  will need later on, see `kernel_list`; they end when it does.
- What takes long is told to the logger ``navbake.compiled`` before it begins.

Source: numba's `Dispatcher.enable_caching` is what ``@njit(cache=True)`` calls on what it made;
`FunctionCache` loads and saves. Both are as they are from numba 0.61 to 0.68.
"""

# numba has few types, and they know nothing of what is set on its objects here
# mypy: disable-error-code="attr-defined,arg-type,assignment,call-arg,misc,no-untyped-call"

from __future__ import annotations

import atexit
import hashlib
import json
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import caching
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher

from navbake.compiler.shortcuts import shortcuts
from navbake.digests import digest_folder, read_stamp
from navbake.folder_lock import folder_lock
from navbake.kernel_list import PREFIX, read_list
from navbake.loading import few_environments, loads_light, rebuild

LOGGER = logging.getLogger("navbake.compiled")  # bakes log their own warnings to its parent
REMEDY = "set NUMBA_CACHE_DIR to a folder that can be written"
SECONDS = 0.7  # how long a kernel that is not in the list takes to compile, on average
PATIENCE = 60.0  # how long to wait for another process that compiles a kernel; most take 5 s [s]
WORTH_HELP = 4.0  # work for which other processes are started; one takes 1 s to begin [s]
MOST_PROCESSES = 4  # that compile side by side: parts of the work build on each other
IS_HELPER = "NAVBAKE_COMPILES_BESIDE"  # in the environment of processes that compile for another

PLACEHOLDER = "_cached"  # what each folder of kernels has to find its cache; nobody calls it

_told: set[str] = set()  # lines that are told once a process
_helpers: list[subprocess.Popen[bytes]] = []
watch: Callable[[int, int], None] | None = None  # is told how many kernels of how many are compiled
KERNELS: list[Kernel] = []
"""All kernels that have been imported, in the order in which they were made."""


class Kernel(CPUDispatcher):
    """A compiled function of navbake."""

    _is_counted = False  # whether a line has said that it will be compiled

    def compile(self, sig: Any) -> Any:
        """Compile for a signature, or load what was compiled for it."""
        with global_compiler_lock:  # until the lock of the file is given back, too
            lean = shortcuts(self.targetctx.codegen()) if loads_light() else nullcontext()
            try:
                with lean:
                    return super().compile(sig)
            finally:
                self._cache.release()
                _tell_progress()

    def compile_if_free(self, sig: Any) -> None:
        """Compile for a signature, unless that is done or another process is doing it."""
        cache = self._cache
        if isinstance(cache, KernelCache) and cache.try_lock():
            self.compile(sig)

    @property
    def full_name(self) -> str:
        """Its module and name, without the package's."""
        return f"{self.__module__.removeprefix(PREFIX)}.{self.__name__}"

    @property
    def folder(self) -> str:
        """The folder of kernels that it is in, as a package's name."""
        return _package_of(self.py_func)

    def is_cold(self) -> bool:
        """Whether it has never been compiled for this machine, as far as files tell."""
        if self.__name__ == PLACEHOLDER:
            return False
        if isinstance(self._cache, MemoryCache):
            return not self.overloads
        return not self._cache.has_files()


class _OrReadOnly:
    """A folder of the cache counts, too, where it can only be read and its code is fresh.

    Code is fresh where its source has the same content, as with numba 0.68. Older ones ask for the
    same time of change, too, which no other installation has.
    """

    def get_source_stamp(self) -> Any:
        """What of a source is kept beside its code."""
        path = self._py_file
        try:
            status = os.stat(path)
            return _digest_source(path, status.st_mtime_ns, status.st_size)
        except OSError:  # Python is frozen into a program
            return super().get_source_stamp()

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        locator = super().from_function(py_func, py_file)
        if locator is not None:
            return locator
        if issubclass(cls, caching.UserProvidedCacheLocator) and not numba.config.CACHE_DIR:
            return None
        found: Any = cls(py_func, py_file)
        package = _package_of(py_func)
        is_fresh = read_stamp(found.get_cache_path()) == digest_folder(package)
        return found if is_fresh else None


@cache
def _digest_source(path: str, modified_ns: int, size: int) -> bytes:
    """Hash a file; its time and size tell whether that was done before."""
    return hashlib.sha256(Path(path).read_bytes()).digest()


class _UserProvided(_OrReadOnly, caching.UserProvidedCacheLocator):
    pass


class _InTree(_OrReadOnly, caching.InTreeCacheLocator):
    pass


class _UserWide(_OrReadOnly, caching.UserWideCacheLocator):
    pass


class _KernelCacheImpl(caching.CompileResultCacheImpl):
    _locator_classes = (_UserProvided, _InTree, _UserWide)

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """Make a kernel of what was read."""
        own = rebuild if loads_light() else super().rebuild
        return own(target_context, payload)


class KernelCache(caching.FunctionCache):
    """The compiled code of a kernel on disk, which may fail without harm."""

    _impl_class = _KernelCacheImpl

    def __init__(self, kernel: Kernel) -> None:
        super().__init__(kernel.py_func)
        self._kernel = kernel
        self._is_locked = False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the code for a signature; wait where another process compiles it; else None."""
        found = self._try_load(sig, target_context)
        if found is None:
            announce(self._kernel)
            if not self._is_locked:
                self._is_locked = self._lock.wait(self._name_of_lock, PATIENCE)
                if not self._is_locked:
                    tell_once(
                        f"another process has been compiling {self._kernel.full_name} for "
                        f"{PATIENCE:g} s, or is stopped: this one compiles it, too"
                    )
            found = self._try_load(sig, target_context)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code for a signature, if that can be."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            tell_once(
                f"cannot keep compiled code in {self.cache_path} ({error.strerror or error}), so "
                f"each process compiles it anew: free some space there, or {REMEDY}"
            )

    def try_lock(self) -> bool:
        """Keep other processes from compiling it, unless one does so now."""
        self._is_locked = self._lock.try_acquire(self._name_of_lock)
        return self._is_locked

    def release(self) -> None:
        """Let other processes compile it."""
        if self._is_locked:
            self._is_locked = False
            self._lock.release(self._name_of_lock)

    def has_files(self) -> bool:
        """Whether code for some signature is there, whole or not."""
        base = Path(self.cache_path, self._impl.filename_base)
        return any(os.path.isfile(f"{base}.{number}.nbc") for number in (1, 2))

    @property
    def _lock(self) -> Any:
        return folder_lock(Path(self.cache_path))

    @property
    def _name_of_lock(self) -> str:
        return str(self._impl.filename_base)

    def _try_load(self, sig: Any, target_context: Any) -> Any:
        try:
            if not loads_light():
                return super().load_overload(sig, target_context)
            with self._guard_against_spurious_io_errors(), few_environments():
                return self._load_overload(sig, target_context)  # see `navbake.loading`
            return None
        except MemoryError:
            raise
        except Exception:  # a broken file makes the reader raise whatever it happens to run into
            base = Path(self.cache_path, self._impl.filename_base)
            for path in base.parent.glob(f"{base.name}.*nb[ic]"):
                with suppress(OSError):
                    path.unlink()
            return None


class MemoryCache(caching.NullCache):
    """What a kernel has where no folder can be written."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel

    def load_overload(self, sig: Any, target_context: Any) -> None:
        """Find nothing."""
        announce(self._kernel)

    def release(self) -> None:
        """Do nothing: no other process waits."""


def install() -> None:
    """Take over the compiling of navbake's kernels from numba, once a process."""
    if numba.config.DISABLE_JIT:
        # they call MuJoCo by the addresses of its functions, which plain Python cannot
        numba.config.DISABLE_JIT = 0
        tell_once("NUMBA_DISABLE_JIT is set, but navbake's kernels run compiled only: unset it")
    if getattr(Dispatcher.enable_caching, "is_of_navbake", False):
        return
    Dispatcher.enable_caching = _wrap(Dispatcher.enable_caching)
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_after_fork)


def _wrap(enable_caching: Callable[[Any], None]) -> Callable[[Any], None]:
    def enable(dispatcher: Any) -> None:
        function = dispatcher.py_func
        if type(dispatcher) is not CPUDispatcher or not function.__module__.startswith("navbake."):
            enable_caching(dispatcher)
            return
        dispatcher.__class__ = Kernel
        dispatcher.targetoptions["no_cfunc_wrapper"] = True  # what only ctypes would call
        if function.__name__.startswith("_") and function.__name__ != PLACEHOLDER:
            # only kernels call it: to unpack Python's tuples takes long to compile
            dispatcher.targetoptions["no_cpython_wrapper"] = True
        try:
            dispatcher._cache = KernelCache(dispatcher)
        except (RuntimeError, OSError):  # no folder can be written
            dispatcher._cache = MemoryCache(dispatcher)
        KERNELS.append(dispatcher)

    enable.is_of_navbake = True
    return enable


def announce(kernel: Kernel) -> None:
    """Say that this kernel and others like it are about to be compiled, and how long that takes.

    The time is that of all kernels that have been imported and that no line has spoken of. Where
    it is less than a second, nothing is said. Where it is long, other processes help.
    """
    if kernel._is_counted:
        return
    new = [k for k in KERNELS if k is kernel or (not k._is_counted and k.is_cold())]
    costs: dict[str, float] = {}
    for entry in read_list().cold(k.full_name for k in new)[0]:
        costs[entry.name] = costs.get(entry.name, 0.0) + entry.seconds
    # what only kernels call is part of the costs of those
    seconds = sum(costs.get(k.full_name, 0.0 if costs else SECONDS) for k in new)
    if seconds < 1:
        return
    for k in new:
        k._is_counted = True
    can_share = bool(costs) and isinstance(kernel._cache, KernelCache)
    helpers = _start_helpers(kernel, new, seconds) if can_share else 0
    seconds /= 1 + 0.8 * helpers
    about = f"about {seconds:.0f} s" if seconds < 60 else f"about {seconds / 60:.1f} minutes"
    if isinstance(kernel._cache, MemoryCache):
        LOGGER.warning(
            f"compiling in memory: {about}, in each process anew, as no folder for compiled code "
            f"can be written: {REMEDY}"
        )
    else:
        LOGGER.warning(f"compiling for this machine, once: {about}")


def _start_helpers(kernel: Kernel, new: list[Kernel], seconds: float) -> int:
    """Start processes that compile what this one will need; how many of them there are now.

    Of processes that start at once, one does so, as far as they use the same folder.
    """
    count = min(num_cores(), int(numba.config.NUMBA_NUM_THREADS), MOST_PROCESSES) - 1
    program = Path(sys.executable or "")  # other programs than Python may hold Python
    is_python = program.name.lower().startswith("python")
    if seconds < WORTH_HELP or count < 1 or not is_python or IS_HELPER in os.environ:
        return 0
    if any(helper.poll() is None for helper in _helpers):
        return 0
    if not folder_lock(Path(kernel._cache.cache_path)).try_acquire("helpers"):
        return 0
    cold = [k.full_name for k in new]
    root = str(Path(__file__).parents[1])
    # Modules are found where this process finds them, and not in the current folder first, as with
    # -c; after all others in the path: the folder that holds navbake may hold anything.
    path = [*(entry for entry in sys.path if entry), root]
    code = f"import sys; sys.path[:] = {path!r}; from navbake.kernel_list import main; main()"
    environment = {**os.environ, IS_HELPER: "1"}
    if numba.config.CACHE_DIR:
        environment["NUMBA_CACHE_DIR"] = numba.config.CACHE_DIR
    for number in range(count):
        task = {"cold": cold, "number": number, "count": count, "parent": os.getpid()}
        with suppress(OSError):
            _helpers.append(
                subprocess.Popen(
                    [program, "-c", code, json.dumps(task)],
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )
    return count


def num_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@atexit.register
def _stop_helpers() -> None:
    for helper in _helpers:
        if helper.poll() is None:
            helper.terminate()
            helper.wait()


def _tell_progress() -> None:
    if watch is not None:
        counted = [k for k in KERNELS if k._is_counted]
        if counted:
            watch(sum(not k.is_cold() for k in counted), len(counted))


def can_keep() -> bool:
    """Whether the kernels imported so far are kept on disk."""
    return not any(isinstance(kernel._cache, MemoryCache) for kernel in KERNELS)


def list_cold() -> list[str]:
    """Name the kernels imported so far that have no code on disk."""
    return [f"{kernel.__module__}.{kernel.__name__}" for kernel in KERNELS if kernel.is_cold()]


def tell_once(line: str) -> None:
    """Log a warning, unless this process has done so before."""
    if line not in _told:
        _told.add(line)
        LOGGER.warning(line)


class _ToStderr(logging.Handler):
    """Writes to stderr where nobody else handles records: what takes minutes must not be silent."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record, unless a handler of the user's has it."""
        logger: logging.Logger | None = LOGGER
        while logger is not None:
            others = [
                h for h in logger.handlers if not isinstance(h, _ToStderr | logging.NullHandler)
            ]
            if others:
                return
            logger = logger.parent if logger.propagate else None
        sys.stderr.write(f"navbake: {record.getMessage()}\n")


LOGGER.addHandler(_ToStderr(logging.WARNING))


def _package_of(function: Any) -> str:
    """The folder of kernels that a function is in."""
    module = str(function.__module__)
    is_folder = function.__code__.co_filename.endswith("__init__.py")
    return module if is_folder else module.rpartition(".")[0]


def _after_fork() -> None:
    """Start afresh in a forked child: the helpers are its parent's."""
    _helpers.clear()
