"""Starts the command line; handles Ctrl-C already while slow modules are imported.

``python -m navbake`` is the same as ``navbake``.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
import time
from types import FrameType

# how long code in C may keep Python from handling a signal; then the process ends [s]
SIGNAL_TIMEOUT = 2.0
GARBAGE_THRESHOLD = 200_000
"""Python collects garbage after this many new objects.

It is more than by default, because imports and compilers make many objects that stay.
"""
_exit_status: int | None = None
"""The exit status once a signal has come: 128 + its number, as in shells. None before that."""


def main() -> None:
    """Run the command line of this process; after Ctrl-C, exit with status 130 and no traceback.

    Ctrl-C raises KeyboardInterrupt wherever Python is. Libraries may turn that into an error of
    their own, as numpy does while it is imported, so any error after Ctrl-C counts as its effect.
    Another Ctrl-C ends the process at once.

    SIGTERM is handled like Ctrl-C, with status 143, so that temporary files are removed. A second
    SIGTERM changes nothing, because service managers may send several. While MuJoCo compiles,
    Python handles neither signal: then a thread ends the process after SIGNAL_TIMEOUT.
    """
    gc.set_threshold(GARBAGE_THRESHOLD)
    # numba makes hundreds of messages that nobody sees: colouring them takes a tenth of the time
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
    try:
        # where Ctrl-C is ignored already (for example in the background of a script), it stays so
        for number, default in (
            (signal.SIGINT, signal.default_int_handler),
            (signal.SIGTERM, signal.SIG_DFL),
        ):
            if signal.getsignal(number) is default:
                signal.signal(number, _handle_signal)
        read_end, write_end = os.pipe()
        os.set_blocking(write_end, False)
        signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
        sys.unraisablehook = _exit_if_stopped
        threading.Thread(
            target=_watch_signals, args=(read_end,), name="signals", daemon=True
        ).start()
        from navbake.cli.main import main as run  # now that Ctrl-C is expected

        run()
    except BaseException as error:
        # from here on, a signal would only end the process while Python cleans up
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        is_done = isinstance(error, SystemExit) and error.code in (None, 0)
        if _exit_status is not None and not (is_done and _exit_status == 128 + signal.SIGINT):
            sys.exit(_exit_status)
        raise
    finally:
        # as it ends, Python collects garbage several times: 0.3 s for memory that the system
        # frees at once
        gc.disable()
        gc.freeze()


def _handle_signal(number: int, frame: FrameType | None) -> None:
    """Handle a signal: raise an exception for the first; end the process at another Ctrl-C."""
    global _exit_status
    if _exit_status is None:
        _exit_status = 128 + number
        raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(_exit_status)
    if number == signal.SIGINT:
        os._exit(_exit_status)


def _exit_if_stopped(unraisable: sys.UnraisableHookArgs) -> None:
    """End the process if a signal's exception can't be raised, for example in a callback from C."""
    if _exit_status is not None:
        os._exit(_exit_status)
    sys.__unraisablehook__(unraisable)


def _watch_signals(read_end: int) -> None:
    """End the process if `_handle_signal` isn't called within SIGNAL_TIMEOUT after a signal.

    That happens while code in C runs on the main thread.

    Args:
        read_end: The reading end of a pipe into which Python writes the number of each signal.
    """
    while True:
        number = os.read(read_end, 1)[0]
        if number in (signal.SIGINT, signal.SIGTERM):
            time.sleep(SIGNAL_TIMEOUT)
            if _exit_status is None:
                os._exit(128 + number)


if __name__ == "__main__":
    main()
