"""Keeps what MuJoCo's compiler prints from C off the user's screen."""

import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

STDERR = 2  # the file descriptor that C writes to
_LOCK = threading.Lock()  # a process has one stderr, whatever the thread
# Qhull, which makes MuJoCo's hulls, numbers its messages QH6154 or names itself in them
QHULL = re.compile(rb"\bQH\d{4}\b|\bqhull\b", re.IGNORECASE)
# What the lines speak of that go on with such a message: hulls, and Qhull's options, 'Qt'
QHULL_GOES_ON = re.compile(
    rb"'[A-Z][A-Za-z0-9:]{0,8}'|dimension|simplex|facet|vertex|vertices|convex|coplanar|hyperplane"
    rb"|roundoff|precision|triangula|joggle|determinant|overflow|\bangle\b|coordinate|topology"
    rb"|difference=|\boptions?\b|\bpoints?\b|\bp\d+\b|\bf\d+\b|maxoutside|_[a-z]+-[a-z]+|run-id",
    re.IGNORECASE,
)


@contextmanager
def catch_chatter() -> Iterator[list[str]]:
    """Collect the lines that Qhull prints to stderr, dozens a mesh, while MuJoCo compiles.

    MuJoCo itself tells in one warning or error what came of them. Every other line that was
    printed meanwhile, by this thread or another, goes to stderr afterwards. Threads take turns.
    """
    lines: list[str] = []
    with _LOCK, ExitStack() as stack:
        with suppress(AttributeError, OSError, ValueError):
            sys.stderr.flush()
        shown, file = STDERR, None
        with suppress(OSError):  # there is no stderr, or no folder has room for a file
            shown = os.dup(STDERR)
            stack.callback(os.close, shown)
            file = stack.enter_context(tempfile.TemporaryFile())
        if file is None:
            yield lines
            return
        os.dup2(file.fileno(), STDERR)
        try:
            yield lines
        finally:
            with suppress(AttributeError, OSError, ValueError):
                sys.stderr.flush()
            os.dup2(shown, STDERR)
            file.seek(0)
            chatter, others = _split(file.read())
            lines += chatter
            if others:
                os.write(STDERR, others)


def _split(printed: bytes) -> tuple[list[str], bytes]:
    """Tell Qhull's lines, empty ones left out, from everything else."""
    chatter, others = [], []
    goes_on = False
    for line in printed.splitlines(keepends=True):
        if QHULL.search(line) or (goes_on and (not line.strip() or QHULL_GOES_ON.search(line))):
            goes_on = True
            text = line.decode("utf-8", errors="replace").strip()
            chatter += [text] if text else []
        else:
            goes_on = False
            others.append(line)
    return chatter, b"".join(others)
