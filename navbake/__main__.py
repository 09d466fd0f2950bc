"""Starts the command line, ready for Ctrl-C before anything slow is imported.

``python -m navbake`` is the same as ``navbake``.
"""

from __future__ import annotations

import _thread
import gc
import os
import select
import signal
import sys
import threading
from types import FrameType
from typing import Any

INTERRUPTED = 130
"""The exit status after Ctrl-C, as shells have it: 128 and the signal's number."""

TERMINATED = 143
"""The exit status after SIGTERM, likewise."""

PATIENCE = 2.0  # how long Python may take to hear of a signal, before the process is ended [s]
BETWEEN_COLLECTIONS = 200_000
"""Python looks for garbage after so many objects; imports and compilers make many that stay."""
DELAY = 0.05  # after which a Ctrl-C that was dropped comes again [s]
_heard = 0  # how many times Python has heard of Ctrl-C
_pressed = 0  # how many times Ctrl-C has not taken effect yet
_is_terminated = False  # whether Python has heard of a SIGTERM


def main() -> None:
    """Run the command line of this process; after Ctrl-C, exit with status 130 and no traceback.

    Ctrl-C raises KeyboardInterrupt wherever Python is. Libraries may turn that into an error of
    their own, as numpy does while it is imported, or drop it, as callbacks from C must; so
    whatever ends a process after Ctrl-C is taken for its effect, and what was dropped is raised
    again. Another Ctrl-C ends the process at once. While MuJoCo compiles, Python hears of nothing;
    then the first one ends the process after PATIENCE, too. SIGTERM is like Ctrl-C, so that files
    and processes that only help are removed; but another SIGTERM changes nothing, as whatever ends
    services may send several.
    """
    gc.set_threshold(BETWEEN_COLLECTIONS)
    # messages of numba are made and dropped by the hundred: their colours take a tenth of the time
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
    try:
        _listen()
        from navbake.cli.main import main as run  # now that Ctrl-C is expected

        run()
    except BaseException as error:
        done = isinstance(error, SystemExit) and error.code in (None, 0)
        # what is done is done: a signal would end the process by force while Python cleans up
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if _is_terminated:
            sys.exit(TERMINATED)
        if _pressed and not done:
            sys.exit(INTERRUPTED)
        raise
    finally:
        # Python looks for garbage again and again as it ends: in 0.3 s it finds what the system
        # takes back at once
        gc.disable()
        gc.freeze()


def _listen() -> None:
    """Hear of signals; where Ctrl-C is ignored, as in the background of a script, it stays so."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _terminate)
    sys.unraisablehook = _raise_again
    _start_watch()


def _start_watch() -> None:
    """Watch signals from a thread: code in C lets no Python run on the main one, but others."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(reading,), name="signals", daemon=True).start()


def _watch(reading: int) -> None:
    came: dict[int, int] = {signal.SIGINT: 0, signal.SIGTERM: 0}

    def unheard() -> tuple[int, int]:
        return came[signal.SIGINT] - _heard, 0 if _is_terminated else came[signal.SIGTERM]

    while True:
        number = os.read(reading, 1)[0]
        if number in came:
            came[number] += 1
        patience = PATIENCE if sum(unheard()) < 2 else PATIENCE / 10
        is_next, _, _ = select.select([reading], [], [], patience)
        interrupts, terminations = unheard()
        if not is_next and interrupts + terminations > 0:
            os._exit(INTERRUPTED if interrupts > 0 else TERMINATED)


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _heard, _pressed
    _heard += 1
    _pressed += 1
    if _pressed > 1:
        os._exit(INTERRUPTED)
    raise KeyboardInterrupt


def _terminate(number: int, frame: FrameType | None) -> None:
    global _is_terminated
    if not _is_terminated:
        _is_terminated = True
        raise SystemExit(TERMINATED)


def _raise_again(unraisable: Any) -> None:
    """Raise what a signal raised again, a little later, if it was dropped where it came."""
    global _pressed, _is_terminated
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        _pressed = 0
        number = signal.SIGINT
    elif issubclass(unraisable.exc_type, SystemExit) and _is_terminated:
        _is_terminated = False
        number = signal.SIGTERM
    else:
        sys.__unraisablehook__(unraisable)
        return
    # not here: what a hook raises is dropped, too
    again = threading.Timer(DELAY, _signal_main, [number])
    again.daemon = True
    again.start()


def _signal_main(number: signal.Signals) -> None:
    """Send a signal to the main thread, whose waits it ends, but on Windows."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        _thread.interrupt_main(number)


if __name__ == "__main__":
    main()
