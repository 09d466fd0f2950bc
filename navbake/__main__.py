"""Starts the command line, ready for Ctrl-C before anything slow is imported.

``python -m navbake`` is the same as ``navbake``.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from types import FrameType
from typing import Any

INTERRUPTED = 130
"""The exit status after Ctrl-C, as shells have it: 128 and the signal's number."""

# How many objects are made, net, before Python looks for garbage. Imports and loaded kernels make
# some 100 thousand, all of which stay: by default it looks through them again and again.
BETWEEN_COLLECTIONS = 50_000

_pressed = 0  # how many times


def main() -> None:
    """Run the command line of this process; after Ctrl-C, exit with status 130 and no traceback.

    Ctrl-C raises KeyboardInterrupt wherever Python is. Libraries may turn that into an error of
    their own, as numpy does while it is imported, or drop it, as callbacks from C must; so
    whatever ends a process after Ctrl-C is taken for its effect, and what was dropped is raised
    again. Another Ctrl-C ends the process at once.
    """
    gc.set_threshold(BETWEEN_COLLECTIONS, *gc.get_threshold()[1:])
    # where Ctrl-C is ignored, as in the background of a script, it stays ignored
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
        sys.unraisablehook = _raise_again
    try:
        from navbake.cli.main import main as run  # now that Ctrl-C is expected

        run()
    except BaseException as error:
        done = isinstance(error, SystemExit) and error.code in (None, 0)
        if _pressed and not done:
            sys.exit(INTERRUPTED)
        raise


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _pressed
    _pressed += 1
    if _pressed > 1:
        os._exit(INTERRUPTED)
    raise KeyboardInterrupt


def _raise_again(unraisable: Any) -> None:
    """Raise a KeyboardInterrupt again that Python could not raise where it came."""
    global _pressed
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        _pressed = 0
        signal.raise_signal(signal.SIGINT)
    else:
        sys.__unraisablehook__(unraisable)


if __name__ == "__main__":
    main()
