"""Runs code in forks of a process that has loaded numba, which takes longer than most such code."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

# A fork goes on with the last lines, and ends as any other Python. It reads the environment anew,
# also for numba and for the folder of temporary files.
CODE = """
import json, os, signal, sys, tempfile
import numba
numba.njit(lambda: 1)()
for line in sys.stdin:
    order = json.loads(line)
    fork = os.fork()
    if not fork:
        break
    print(os.waitstatus_to_exitcode(os.waitpid(fork, 0)[1]), flush=True)
else:
    sys.exit()
signal.alarm(300)  # a fork that hangs is killed
os.environ.clear()
os.environ.update(order["environment"])
os.chdir(order["folder"])
sys.path.insert(0, order["folder"])
tempfile.tempdir = None
numba.config.reload_config()
for number, path in ((1, order["out"]), (2, order["err"])):
    os.dup2(os.open(path, os.O_WRONLY), number)
exec(order["code"], {"__name__": "__main__"})
"""


class NumbaForks:
    """A process that is started by the first run, and runs code in forks, one after another."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def run(self, code: str, folder: Path, environment: dict[str, str]) -> tuple[int, str, str]:
        """Run code; its exit status, stdout and stderr.

        Args:
            code: the code.
            folder: its current folder, where it finds its modules first.
            environment: all of its environment variables.
        """
        if self._process is None:
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
            self._process = subprocess.Popen([sys.executable, "-B", "-c", CODE], **pipes)
        order = {"code": code, "folder": str(folder), "environment": environment}
        with tempfile.NamedTemporaryFile() as out, tempfile.NamedTemporaryFile() as err:
            order |= {"out": out.name, "err": err.name}
            self._process.stdin.write(json.dumps(order) + "\n")
            self._process.stdin.flush()
            status = int(self._process.stdout.readline())
            return status, out.read().decode(), err.read().decode()

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.communicate()
            self._process = None
