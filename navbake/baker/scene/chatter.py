"""Keeps what MuJoCo's compiler prints from C off the user's screen."""

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress

STDERR = 2  # the file descriptor that C writes to
# What Qhull, which makes MuJoCo's hulls, prints about itself: its messages are numbered QH6154
QHULL = re.compile(r"\bQH\d{4}\b|\bqhull\b", re.IGNORECASE)


@contextmanager
def catch_chatter() -> Iterator[list[str]]:
    """Collect the lines that Qhull prints to stderr, dozens a mesh, while MuJoCo compiles.

    MuJoCo itself tells in one warning or error what came of them. Anything else that was
    printed meanwhile, by this thread or another, goes to stderr afterwards. One thread at a time.
    """
    lines: list[str] = []
    with suppress(AttributeError, OSError, ValueError):
        sys.stderr.flush()
    try:
        shown = os.dup(STDERR)
    except OSError:  # there is no stderr
        yield lines
        return
    try:
        with tempfile.TemporaryFile() as file:
            os.dup2(file.fileno(), STDERR)
            try:
                yield lines
            finally:
                with suppress(AttributeError, OSError, ValueError):
                    sys.stderr.flush()
                os.dup2(shown, STDERR)
                file.seek(0)
                printed = file.read()
                text = printed.decode("utf-8", errors="replace")
                if QHULL.search(text):
                    lines += [line for line in text.splitlines() if line.strip()]
                elif printed:
                    os.write(STDERR, printed)
    finally:
        os.close(shown)
