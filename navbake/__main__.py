"""Starts the command line, ready for Ctrl-C before anything slow is imported.

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
from typing import Any

PATIENCE = 2.0  # how long code in C may keep Python from a signal before the process ends [s]
BETWEEN_COLLECTIONS = 200_000
"""Python looks for garbage after so many objects; imports and compilers make many that stay."""
_status: int | None = None
"""The exit status after the first signal, as shells have it: 128 and the signal's number."""


def main() -> None:
    """Run the command line of this process; after Ctrl-C, exit with status 130 and no traceback.

    Ctrl-C raises KeyboardInterrupt wherever Python is. Libraries may turn that into an error of
    their own, as numpy does while it is imported, so whatever ends a process after Ctrl-C is taken
    for its effect. Another Ctrl-C ends the process at once. SIGTERM is like Ctrl-C, with status
    143, so that temporary files are removed; but another SIGTERM changes nothing, as what ends
    services may send several. While MuJoCo compiles, Python hears of neither: then a thread ends
    the process after PATIENCE.
    """
    gc.set_threshold(BETWEEN_COLLECTIONS)
    # messages of numba are made and dropped by the hundred: their colours take a tenth of the time
    os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
    try:
        # where Ctrl-C is ignored, as in the background of a script, it stays so
        for number, default in (
            (signal.SIGINT, signal.default_int_handler),
            (signal.SIGTERM, signal.SIG_DFL),
        ):
            if signal.getsignal(number) is default:
                signal.signal(number, _stop)
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        sys.unraisablehook = _end
        threading.Thread(target=_watch, args=(reading,), name="signals", daemon=True).start()
        from navbake.cli.main import main as run  # now that Ctrl-C is expected

        run()
    except BaseException as error:
        # what is done is done: a signal would end the process by force while Python cleans up
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        is_done = isinstance(error, SystemExit) and error.code in (None, 0)
        if _status is not None and not (is_done and _status == 128 + signal.SIGINT):
            sys.exit(_status)
        raise
    finally:
        # Python looks for garbage again and again as it ends: in 0.3 s it finds what the system
        # takes back at once
        gc.disable()
        gc.freeze()


def _stop(number: int, frame: FrameType | None) -> None:
    global _status
    if _status is None:
        _status = 128 + number
        raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(_status)
    if number == signal.SIGINT:
        os._exit(_status)


def _end(unraisable: Any) -> None:
    """End the process where a signal's exception can't be raised, as in callbacks from C."""
    if _status is not None:
        os._exit(_status)
    sys.__unraisablehook__(unraisable)


def _watch(reading: int) -> None:
    """End the process where `_stop` isn't called in time: code in C runs on the main thread."""
    while True:
        number = os.read(reading, 1)[0]
        if number in (signal.SIGINT, signal.SIGTERM):
            time.sleep(PATIENCE)
            if _status is None:
                os._exit(128 + number)


if __name__ == "__main__":
    main()
