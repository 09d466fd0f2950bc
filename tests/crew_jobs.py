"""What workers do in the tests of batches: jobs that work, and jobs that end them."""

from __future__ import annotations

import os
import signal
import sys
import time
from typing import Any

PATIENCE = 60.0  # longer than anything takes on a machine with much else to do [s]
done: list[Any] = []  # in this process


def work(job: tuple[str, Any]) -> Any:
    """Do what a job says."""
    what, value = job
    done.append(job)
    if what == "double":
        return 2 * value
    if what == "sleep":
        time.sleep(value)
    elif what == "kill":
        os.kill(os.getpid(), value)
    elif what == "exit":
        os.write(2, b"first line\nno such thing: qh6154\n\n")
        os._exit(value)
    elif what == "raise":
        raise ValueError(value)
    elif what == "take":
        return len(bytearray(value))
    elif what == "if alone":  # crashes where another job was done before
        if len(done) > 1:
            os.kill(os.getpid(), signal.SIGSEGV)
    elif what == "once":  # crashes the first time
        if not os.path.exists(value):
            with open(value, "x"):
                os._exit(3)
    elif what == "lose":  # ends whoever watches this process, each time or once
        if value is None or not os.path.exists(value):
            if value is not None:
                open(value, "x").close()
            os.kill(os.getppid(), signal.SIGKILL)
            time.sleep(60)
    elif what == "meet":  # there are so many workers at such a job at once
        folder, count = value
        open(os.path.join(folder, str(os.getpid())), "x").close()
        end = time.monotonic() + PATIENCE
        while len(os.listdir(folder)) < count:
            if time.monotonic() > end:
                raise TimeoutError("nobody else came")
            time.sleep(0.005)
    elif what == "print":
        print("hello")
        os.write(1, b"hello")
        sys.stdin.read()
    return os.getpid()


def refuse() -> None:
    """Get no worker ready."""
    raise RuntimeError("no library")


def end() -> None:
    """End the worker before it is ready."""
    os.kill(os.getpid(), signal.SIGKILL)
