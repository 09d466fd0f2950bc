"""Connects to a Ray cluster, or starts one on this machine."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from navbake.errors import MissingDependencyError, NavbakeError
from navbake.files import scratch_folder

ADDRESS = "RAY_ADDRESS"  # the variable that names a cluster
LOCAL = "local"  # the address that stands for a cluster of one's own
MISSING = 'batches on a Ray cluster need ray: pip install "navbake[ray]"'
PRINT = "print_to_stdstream"  # Ray's function that prints what comes from nodes
ANSWER = 10.0  # within which a cluster takes a connection [s]
STORE = 80 << 20  # of memory for what slots are handed, in a cluster of one's own [bytes]
# Read by Ray as it is imported. With the first, which is meant for other systems, its processes
# listen on the loopback device only. Usage is told to nobody.
PRIVATE = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}
QUIET = {"RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}


@contextmanager
def connected(address: str | None, num_slots: int) -> Iterator[tuple[Any, bool]]:
    """Be connected to a Ray cluster inside.

    Args:
        address: of the cluster, as Ray has it; ``local`` for one that is started on this machine,
            listens on the loopback device only, and ends with the batch; None for what
            ``RAY_ADDRESS`` says, else ``local``. A process that is connected already stays so.
        num_slots: of a cluster that is started here.

    Gives:
        ray, and whether the cluster is this machine alone.

    Raises:
        MissingDependencyError: ray isn't installed.
        NavbakeError: there is no such cluster, or none can be started.
    """
    address = address or os.environ.get(ADDRESS) or LOCAL
    is_own = address == LOCAL
    with _variables({**QUIET, **(PRIVATE if is_own else {})}):
        try:
            import ray  # an extra
        except ImportError as error:
            raise MissingDependencyError(f"{MISSING} ({error})") from error
        if ray.is_initialized():
            yield ray, False
            return
        _check_reachable(address)
        with scratch_folder(Path("/tmp")) if is_own else nullcontext() as folder, _silent():
            try:
                _connect(ray, address, {} if folder is None else _own_options(folder, num_slots))
                yield ray, is_own
            finally:
                with suppress(Exception):
                    ray.shutdown()


@contextmanager
def _variables(wanted: dict[str, str]) -> Iterator[None]:
    """Have variables in the environment inside, unless the user has set them."""
    new = {name: value for name, value in wanted.items() if name not in os.environ}
    os.environ.update(new)
    try:
        yield
    finally:
        for name in new:
            os.environ.pop(name, None)


def _check_reachable(address: str) -> None:
    """Find out at once that nobody listens at an address, which takes Ray minutes."""
    host, _, port = address.rpartition(":")
    if "/" in address or not port.isdigit():
        return  # one that Ray looks up, as "auto"
    try:
        with socket.create_connection((host.strip("[]"), int(port)), ANSWER):
            pass
    except (OSError, OverflowError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise NavbakeError(f"cannot connect to a Ray cluster at {address}: {why}") from error


def _connect(ray: Any, address: str, options: dict[str, Any]) -> None:
    """Connect to a cluster; signals stay as they are."""
    is_main = threading.current_thread() is threading.main_thread()
    handler = signal.getsignal(signal.SIGTERM) if is_main else None
    try:
        ray.init(address=address, logging_level="ERROR", log_to_driver=False, **options)
    except Exception as error:  # of many kinds
        reason = " ".join(str(error).split())[:300] or type(error).__name__
        what = "start a Ray cluster" if options else f"connect to a Ray cluster at {address}"
        raise NavbakeError(f"cannot {what}: {reason}") from error
    finally:
        if handler is not None:
            signal.signal(signal.SIGTERM, handler)


@contextmanager
def _silent() -> Iterator[None]:
    """Keep the errors of nodes from stdout inside, where Ray prints them whatever it is told."""
    module: Any = sys.modules["ray._private.worker"]
    before = getattr(module, PRINT, None)
    setattr(module, PRINT, lambda *arguments, **options: None)
    try:
        yield
    finally:
        setattr(module, PRINT, before)


def _own_options(folder: Path, num_slots: int) -> dict[str, Any]:
    return {
        "num_cpus": num_slots,
        "include_dashboard": False,
        "object_store_memory": STORE,
        "_temp_dir": str(folder),
    }
