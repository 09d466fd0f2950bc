"""Starts the command line; handles Ctrl-C already while slow modules are imported.

``python -m navbake`` is the same as ``navbake``.
"""

from __future__ import annotations

import atexit
import gc
import os
import signal
import socket
import sys
import threading
import time
from contextlib import suppress
from types import FrameType

# after a signal, the process ends at the latest after this time, whatever it still does [s]
SIGNAL_TIMEOUT = 1.5
GARBAGE_THRESHOLD = 500_000
"""Python collects garbage after this many new objects.

It is more than by default, because imports and compilers make many objects that stay: with fewer,
a bake whose kernels are loaded from disk would spend a tenth of its time looking for garbage.
"""
_exit_status: int | None = None
"""The exit status once a signal was raised: 128 + its number, as in shells. None before that."""
_is_ending = False  # whether the command has ended, so that only Python's own end is left


def main() -> None:
    """Run the command line of this process; after Ctrl-C, exit with status 130 and no traceback.

    Ctrl-C raises SystemExit wherever Python is, so that temporary files are removed. SIGTERM does
    the same, with status 143. A library may turn SystemExit into an error of its own, as numpy does
    while it is imported, so any error after a signal counts as its effect. KeyboardInterrupt is not
    used: after one that passed through `exec`, ``python -m`` ignores the exit status.

    SystemExit doesn't always end the process. While code in C runs, it isn't raised; a library may
    catch it; and it may interrupt code that holds a lock or starts a thread, so that Python waits
    for ever at its end. Therefore a thread, see `_watch_signals`, ends the process SIGNAL_TIMEOUT
    after the first signal, and at once at another Ctrl-C.
    """
    global _is_ending
    gc.set_threshold(GARBAGE_THRESHOLD)
    # numba makes hundreds of messages that nobody sees: colouring them takes a tenth of the time
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
    try:
        _install_signal_handlers()
        from navbake.cli.main import main as run_command_line  # now that Ctrl-C is expected

        run_command_line()
    except BaseException as error:
        _is_ending = True
        has_succeeded = isinstance(error, SystemExit) and error.code in (None, 0)
        if _exit_status is not None and not (has_succeeded and _exit_status == 128 + signal.SIGINT):
            sys.exit(_exit_status)
        raise
    finally:
        _is_ending = True
        # as it ends, Python collects garbage several times: 0.3 s for memory that the system
        # frees at once
        gc.disable()
        gc.freeze()


def _install_signal_handlers() -> None:
    """Set up the handlers of Ctrl-C and SIGTERM, and the thread that watches both."""
    # where Ctrl-C is ignored already (for example in the background of a script), it stays so
    for signal_number, default_handler in (
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGTERM, signal.SIG_DFL),
    ):
        if signal.getsignal(signal_number) is default_handler:
            signal.signal(signal_number, _handle_signal)
            # Python calls it last. Without it, a signal while Python frees its modules would end
            # the process as if it had failed.
            atexit.register(signal.signal, signal_number, signal.SIG_IGN)
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    signal.set_wakeup_fd(sender.detach(), warn_on_full_buffer=False)
    sys.unraisablehook = _exit_if_stopped
    threading.Thread(target=_watch_signals, args=(receiver,), name="signals", daemon=True).start()


def _handle_signal(signal_number: int, stack_frame: FrameType | None) -> None:
    """Raise SystemExit for the first signal; do nothing if the process is ending already."""
    global _exit_status
    if _exit_status is None and not _is_ending:
        _exit_status = 128 + signal_number
        raise SystemExit(_exit_status)


def _exit_if_stopped(unraisable: sys.UnraisableHookArgs) -> None:
    """End the process if a signal's exception can't be raised, for example in a callback from C."""
    if _exit_status is not None:
        os._exit(_exit_status)
    sys.__unraisablehook__(unraisable)


def _watch_signals(receiver: socket.socket) -> None:
    """End the process SIGNAL_TIMEOUT after the first signal, or at another Ctrl-C before that.

    Another SIGTERM changes nothing, because service managers may send several.

    Args:
        receiver: the socket that receives the number of each signal when it arrives.
    """
    signal_number = 0
    while signal_number not in (signal.SIGINT, signal.SIGTERM):
        signal_number = receiver.recv(1)[0]
    exit_status = 128 + signal_number
    deadline = time.monotonic() + SIGNAL_TIMEOUT
    is_interrupted_again = False
    while not is_interrupted_again and (remaining_time := deadline - time.monotonic()) > 0:
        receiver.settimeout(remaining_time)
        with suppress(TimeoutError):
            is_interrupted_again = receiver.recv(1)[0] == signal.SIGINT
    os._exit(exit_status)


if __name__ == "__main__":
    main()
